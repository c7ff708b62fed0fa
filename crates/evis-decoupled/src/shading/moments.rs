//! Moments between the ends of a block at which light is found, and a facet at such a moment.
//!
//! Light of a place of a surface is linear between two moments.

use std::sync::OnceLock;

use evis_scene::{Eye, ShadingModel};
use glam::DVec3;

use crate::scene::world::Frame;
use crate::shading::material::{self, Lamp, Point};
use crate::visibility::blocks::Block;

/// Most intervals of a block, a power of two.
pub const MOST_INTERVALS: u32 = 64;
/// Widths of a highlight that follow as finely as one of a cone's border, within which light goes from none to all.
const CONE_LOBES: f64 = 2.0;
/// Beyond so many of its widths a highlight is as good as dark.
const FAR_LOBES: f64 = 4.0;

/// The key of what was lit at `t_us`; `after` a jump at that time.
pub fn key(t_us: f64, after: bool) -> u64 {
    ((t_us * 16.0) as u64) << 1 | u64::from(after) | 1 << 63
}

/// The interval of a block that part `u` of it is in, and how far in it.
#[inline(always)]
pub fn interval_of(u: f64, intervals: u32) -> (u32, f64) {
    if intervals <= 1 {
        return (0, u);
    }
    let at = u * f64::from(intervals);
    let interval = (at as u32).min(intervals - 1);
    (interval, at - f64::from(interval))
}

/// Moments within a block, each evaluated when it is first needed.
#[derive(Default)]
pub struct Times {
    /// The block.
    pub block: Block,
    /// At whole parts of the block, both ends left out; `None` where the scene cannot be evaluated.
    known: Vec<OnceLock<Option<Moment>>>,
}

/// The scene and its lamps at a time.
pub struct Moment {
    /// The scene.
    pub frame: Frame,
    /// Its lamps.
    pub lamps: Vec<Lamp>,
}

impl Times {
    /// Those of `block`.
    pub fn new(block: Block) -> Self {
        Self { block, known: (1..MOST_INTERVALS).map(|_| OnceLock::new()).collect() }
    }

    /// What `evaluate` finds at part `u` of the block, a whole number of parts of [`MOST_INTERVALS`]. `None` at both ends.
    pub fn at(&self, u: f64, evaluate: impl FnOnce(f64) -> Option<Moment>) -> Option<&Option<Moment>> {
        let unit = (u * f64::from(MOST_INTERVALS)).round() as usize;
        let known = self.known.get(unit.checked_sub(1)?)?;
        Some(known.get_or_init(|| evaluate(self.block.at(u))))
    }
}

/// A facet at a moment.
pub struct FacetAt<'a> {
    /// The scene's lamps then.
    pub lamps: &'a [Lamp],
    /// World places and normals of its corners at (s, t) = (0, 0), (1, 0) and (0, 1).
    pub corners: [(DVec3, DVec3); 3],
    /// World tangents there, and signs of bitangents.
    pub tangents: [(DVec3, f64); 3],
    /// From where the camera looks.
    pub eye: Option<Eye>,
    /// 1 from its front, -1 from behind.
    pub side: f64,
    /// What is the same everywhere on it.
    pub all: Point,
}

impl FacetAt<'_> {
    /// A place (s, t), without what maps say.
    pub fn point(&self, [s, t]: [f64; 2]) -> Point {
        let blend = |[a, b, d]: [DVec3; 3]| a + (b - a) * s + (d - a) * t;
        let position = blend(self.corners.map(|c| c.0));
        Point {
            position,
            normal: blend(self.corners.map(|c| c.1)).normalize_or(DVec3::Z) * self.side,
            to_eye: self.eye.map_or(DVec3::Z, |eye| (-eye.toward(position)).normalize_or(DVec3::Z)),
            ..self.all
        }
    }
}

/// Widths of the highlight of any lamp that go by at places of a facet, each at the start, middle and end of a block.
pub fn highlights(points: &[[Point; 3]; 5], at: &[FacetAt; 3]) -> f64 {
    let first = &points[0][0];
    if first.model != ShadingModel::MetallicRoughness {
        return 0.0;
    }
    let width = material::lobe_width(first.roughness);
    let mut most = 0.0_f64;
    for lamp in 0..at[0].lamps.len() {
        // Where the half vector is, seen from the normal: the highlight is about 0.
        let offsets =
            points.map(|of| [0, 1, 2].map(|k| material::from_highlight(&of[k], &at[k].lamps[lamp])));
        let moved = offsets.iter().map(|[a, b, c]| a.distance(*b) + b.distance(*c)).fold(0.0, f64::max);
        let apart = offsets.iter().map(|o| o[1].distance(offsets[0][1])).fold(0.0, f64::max);
        let nearest = offsets.as_flattened().iter().map(|o| o.length()).fold(f64::INFINITY, f64::min);
        if nearest <= moved + apart + FAR_LOBES * width {
            most = most.max(moved / width);
        }
    }
    // What shines less than the diffuse light beside it matters less.
    most * material::lobe_weight(first)
}

/// Widths of the border of any lamp's cone that go by there.
pub fn cones(points: &[[Point; 3]; 5], at: &[FacetAt; 3]) -> f64 {
    let mut most = 0.0_f64;
    for lamp in 0..at[0].lamps.len() {
        let of = |points: &[Point; 3]| {
            let place = |k: usize| material::from_cone(points[k].position, &at[k].lamps[lamp]);
            Some([place(0)?, place(1)?, place(2)?])
        };
        let offsets = points.each_ref().map(of);
        let offsets = offsets.iter().flatten();
        let moved = offsets.clone().map(|[a, b, c]| (b - a).abs() + (c - b).abs()).fold(0.0, f64::max);
        let [least, greatest] = [f64::min, f64::max].map(|f| offsets.clone().flatten().copied().reduce(f));
        if let (Some(least), Some(greatest)) = (least, greatest)
            && least <= 0.5 + moved
            && greatest >= -0.5 - moved
        {
            most = most.max(CONE_LOBES * moved);
        }
    }
    most
}
