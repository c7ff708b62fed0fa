//! Markers: a family of settings is told by its shape and by its colour, so that a grey print still tells it.

use plotters::backend::DrawingBackend;
use plotters::style::RGBColor;

use crate::error::ChartError;
use crate::plot::canvas::{Canvas, Colour};

/// Half of a marker's size.
pub(crate) const RADIUS: f64 = 4.6;

/// From the middle to the outside of a ring.
pub(crate) const RING: f64 = RADIUS + 4.2;

/// A family's colour and shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Style {
    pub(crate) colour: Colour,
    shape: Shape,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Shape {
    Disc,
    Square,
    Diamond,
    Up,
    Down,
    Pentagon,
    Star,
    Plus,
}

/// Okabe and Ito, "Color Universal Design" (2008), with grey for yellow, which white paper swallows; dark and light in turn.
const COLOURS: [Colour; 8] = [
    RGBColor(0xe6, 0x9f, 0x00),
    RGBColor(0x00, 0x72, 0xb2),
    RGBColor(0x00, 0x00, 0x00),
    RGBColor(0x00, 0x9e, 0x73),
    RGBColor(0xd5, 0x5e, 0x00),
    RGBColor(0x56, 0xb4, 0xe9),
    RGBColor(0xcc, 0x79, 0xa7),
    RGBColor(0x80, 0x80, 0x80),
];

const SHAPES: [Shape; 8] = [
    Shape::Disc,
    Shape::Square,
    Shape::Diamond,
    Shape::Up,
    Shape::Down,
    Shape::Pentagon,
    Shape::Star,
    Shape::Plus,
];

impl Style {
    /// The style of the `n`-th family: the first 8 differ in both, 64 in one.
    pub(crate) fn nth(n: usize) -> Self {
        let round = n / COLOURS.len();
        Self { colour: COLOURS[n % COLOURS.len()], shape: SHAPES[(n + round) % SHAPES.len()] }
    }
}

impl Default for Style {
    fn default() -> Self {
        Self { colour: RGBColor(0x5a, 0x5a, 0x5a), shape: Shape::Disc }
    }
}

/// The same hue, for lines that stay in the background.
pub(crate) fn pale(colour: Colour) -> Colour {
    let fade = |c: u8| (u16::from(c) * 2 / 5 + 153) as u8;
    RGBColor(fade(colour.0), fade(colour.1), fade(colour.2))
}

/// Draws a marker, filled or hollow.
pub(crate) fn draw<DB: DrawingBackend>(
    canvas: &Canvas<DB>,
    at: [f64; 2],
    style: Style,
    filled: bool,
) -> Result<(), ChartError> {
    // White around it keeps it apart from lines and neighbours.
    shape(canvas, at, style.shape, RADIUS + 1.3, plotters::style::WHITE)?;
    shape(canvas, at, style.shape, RADIUS, style.colour)?;
    if !filled {
        shape(canvas, at, style.shape, RADIUS * 0.58, plotters::style::WHITE)?;
    }
    Ok(())
}

/// A ring around a published setting.
pub(crate) fn ring<DB: DrawingBackend>(canvas: &Canvas<DB>, at: [f64; 2]) -> Result<(), ChartError> {
    canvas.disc(at, RING, RGBColor(0x22, 0x22, 0x22))?;
    canvas.disc(at, RING - 1.2, plotters::style::WHITE)
}

fn shape<DB: DrawingBackend>(
    canvas: &Canvas<DB>,
    [x, y]: [f64; 2],
    shape: Shape,
    radius: f64,
    colour: Colour,
) -> Result<(), ChartError> {
    let corner = |turns: f64, r: f64| {
        let angle = (turns - 0.25) * std::f64::consts::TAU;
        [x + r * angle.cos(), y + r * angle.sin()]
    };
    let regular = |n: u32, first: f64, r: f64| -> Vec<[f64; 2]> {
        (0..n).map(|k| corner(first + f64::from(k) / f64::from(n), r)).collect()
    };
    // Radii that give every shape about the same area.
    let corners = match shape {
        Shape::Disc => return canvas.disc([x, y], radius, colour),
        Shape::Square => regular(4, 0.125, radius * 1.25),
        Shape::Diamond => regular(4, 0.0, radius * 1.35),
        Shape::Up => regular(3, 0.0, radius * 1.45),
        Shape::Down => regular(3, 0.5, radius * 1.45),
        Shape::Pentagon => regular(5, 0.0, radius * 1.2),
        Shape::Star => (0..10)
            .map(|k| corner(f64::from(k) / 10.0, if k % 2 == 0 { radius * 1.5 } else { radius * 0.65 }))
            .collect(),
        Shape::Plus => {
            let (arm, half) = (radius * 1.25, radius * 0.45);
            [
                [-half, -arm],
                [half, -arm],
                [half, -half],
                [arm, -half],
                [arm, half],
                [half, half],
                [half, arm],
                [-half, arm],
                [-half, half],
                [-arm, half],
                [-arm, -half],
                [-half, -half],
            ]
            .map(|[dx, dy]| [x + dx, y + dy])
            .to_vec()
        }
    };
    canvas.fill(&corners, colour)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_families_differ_and_the_first_ones_in_shape_and_in_grey() {
        let styles: Vec<_> = (0..64).map(Style::nth).collect();
        for (i, a) in styles.iter().enumerate() {
            assert!(styles[..i].iter().all(|b| a != b), "{a:?}");
        }
        for (i, a) in styles[..8].iter().enumerate() {
            assert!(styles[..i].iter().all(|b| a.shape != b.shape && a.colour != b.colour), "{a:?}");
        }
        assert_eq!(Style::nth(0), Style::nth(64), "canary: they do repeat at last");
    }
}
