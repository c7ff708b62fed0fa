//! Colours and type of the picture.

use plotters::style::RGBColor;

use crate::plot::canvas::{Colour, Type};

pub(crate) const INK: Colour = RGBColor(0x22, 0x22, 0x22);
pub(crate) const SOFT_INK: Colour = RGBColor(0x5a, 0x5a, 0x5a);
pub(crate) const AXIS: Colour = RGBColor(0x80, 0x80, 0x80);
pub(crate) const GRID: Colour = RGBColor(0xdd, 0xdd, 0xdd);
pub(crate) const FINE_GRID: Colour = RGBColor(0xf1, 0xf1, 0xf1);
pub(crate) const FRONT: Colour = RGBColor(0x55, 0x55, 0x55);
pub(crate) const REAL_TIME: Colour = RGBColor(0x33, 0x33, 0x33);
pub(crate) const FLOOR: Colour = RGBColor(0x99, 0x99, 0x99);

pub(crate) const TITLE: Type = Type { em: 19.0, colour: INK };
pub(crate) const SUBTITLE: Type = Type { em: 12.5, colour: SOFT_INK };
pub(crate) const ROW_TITLE: Type = Type { em: 15.5, colour: INK };
pub(crate) const AXIS_TITLE: Type = Type { em: 13.0, colour: INK };
pub(crate) const TICK: Type = Type { em: 12.0, colour: SOFT_INK };
pub(crate) const LABEL: Type = Type { em: 12.0, colour: INK };
pub(crate) const HINT: Type = Type { em: 12.0, colour: SOFT_INK };
pub(crate) const LEGEND: Type = Type { em: 12.5, colour: INK };

/// Viewers of an SVG may have a wider font than ours.
pub(crate) const WIDER: f64 = 1.12;
