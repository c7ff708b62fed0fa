//! How far highlights, and the borders of lamps' cones, move on a part of a facet during a block, and how narrow they are there.

use evis_scene::ShadingModel;
use glam::{DVec3, Vec4};

use crate::fours::Four;
use crate::shading::material::{self, Lamp, Point};
use crate::shading::places::{LitFacet, Points};

/// Widths of a highlight that follow as finely as one of a cone's border, within which light goes from none to all.
const CONE_LOBES: f64 = 2.0;
/// Beyond so many of its widths a highlight is as good as dark.
const FAR_LOBES: f32 = 4.0;
/// Of widths between the middle of a part and its corners: so many are one that goes by. Nodes of a patch lie closer.
const SPREAD: f32 = 0.5;

/// Widths of a highlight, or of what bends light as much, on a part of a facet that one may come into.
#[derive(Clone, Copy, Debug, Default)]
pub struct Lobes {
    /// Which go by during the block.
    pub moved: f64,
    /// Which lie beside each other on the part.
    pub spread: f64,
}

impl Lobes {
    /// The greater ones of both.
    pub fn max(self, other: Self) -> Self {
        Self { moved: self.moved.max(other.moved), spread: self.spread.max(other.spread) }
    }
}

/// Of the highlights of all lamps: `points` are four corners of the part, and its middle, each at the start, middle and end of the
/// block; `at` is the facet then.
pub fn highlights(all: &Point, at: &[LitFacet; 3], points: &[[Points; 3]; 2]) -> Lobes {
    let mut most = Lobes::default();
    if all.model != ShadingModel::MetallicRoughness {
        return most;
    }
    let width = material::lobe_width(all.roughness) as f32;
    // What shines less than the diffuse light beside it matters less.
    let weight = material::lobe_weight(all);
    let length = |v: Four| v.dot(v).sqrt();
    for lamp in 0..at[0].lamp_count() {
        // Where the half vector is, seen from the normal: the highlight is about 0.
        let offsets =
            points.each_ref().map(|of| [0, 1, 2].map(|time| at[time].from_highlight(&of[time], lamp)));
        let way = |[a, b, c]: [Four; 3]| length(b - a) + length(c - b);
        let moved = offsets.map(way).into_iter().fold(Vec4::ZERO, Vec4::max).max_element();
        let apart = length(offsets[0][1] - offsets[1][1]).max_element();
        let lengths = offsets.as_flattened().iter().map(|offset| length(*offset));
        let nearest = lengths.fold(Vec4::INFINITY, Vec4::min).min_element();
        if nearest <= moved + apart + FAR_LOBES * width {
            let of = |way: f32| weight * f64::from(way / width);
            most = most.max(Lobes { moved: of(moved), spread: of(SPREAD * apart) });
        }
    }
    most
}

/// Of the borders of all lamps' cones: `places` are the middle of the part and its corners, each at the start, middle and end of the
/// block, and `lamps` are those then.
pub fn cones(places: &[[DVec3; 3]; 5], lamps: &[Vec<Lamp>; 3]) -> Lobes {
    let mut most = Lobes::default();
    for (lamp, _) in lamps[0].iter().enumerate().filter(|(_, lamp)| lamp.cone.is_some()) {
        let of = |places: &[DVec3; 3]| {
            let place = |time: usize| material::from_cone(places[time], &lamps[time][lamp]);
            Some([place(0)?, place(1)?, place(2)?])
        };
        let [middle, corners @ ..] = places.each_ref().map(of);
        let Some(middle) = middle else { continue };
        let offsets = || corners.iter().flatten().chain([&middle]);
        let moved = offsets().map(|[a, b, c]| (b - a).abs() + (c - b).abs()).fold(0.0, f64::max);
        // Between the corners of the part lies what is as far from its middle at most.
        let apart = offsets().map(|[_, b, _]| (b - middle[1]).abs()).fold(0.0, f64::max);
        let [least, greatest] =
            [f64::min, f64::max].map(|of| offsets().flatten().copied().fold(middle[1], of));
        let reach = 0.5 + moved + apart;
        if least <= reach && greatest >= -reach {
            let [moved, spread] = [moved, apart].map(|way| CONE_LOBES * way);
            most = most.max(Lobes { moved, spread });
        }
    }
    most
}
