//! Light between the ends of a block: how finely it follows from moments, and a facet at such a moment.
//!
//! Light of a place of a surface is linear between two moments. How many a block needs is told from a few places of a facet:
//! how far light in the middle of the block is from the mean of its ends, which falls with the square of their number, and
//! how many times its own width a highlight or the border of a lamp's cone goes by.

use std::sync::OnceLock;

use evis_scene::ShadingModel;
use glam::{DMat4, DVec3};

use super::{Lighting, MOST_OWN};
use crate::scene::facets::wide;
use crate::scene::world::{Frame, normal_under};
use crate::shading::material::{self, Lamp, Point, Response, respond};
use crate::visibility::blocks::Block;

/// Most intervals of a block, a power of two.
const MOST_INTERVALS: u32 = 64;
/// Part of the light by which it may be off in the middle between moments.
const SMOOTH: f64 = 0.005;
/// Widths of a highlight between two moments.
const LOBES: f64 = 0.3;
/// Widths of a highlight that follow as finely as one of a cone's border, within which light goes from none to all.
const CONE_LOBES: f64 = 2.0;
/// Beyond so many of its widths a highlight is as good as dark.
const FAR_LOBES: f64 = 4.0;

/// The key of what was lit at `t_us`; `after` a jump at that time.
pub(super) fn key(t_us: f64, after: bool) -> u64 {
    ((t_us * 16.0) as u64) << 1 | u64::from(after) | 1 << 63
}

/// The interval of a block that part `u` of it is in, and how far in it.
#[inline(always)]
pub(super) fn interval_of(u: f64, intervals: u32) -> (u32, f64) {
    if intervals <= 1 {
        return (0, u);
    }
    let at = u * f64::from(intervals);
    let interval = (at as u32).min(intervals - 1);
    (interval, at - f64::from(interval))
}

/// Moments within a block, each evaluated when it is first needed.
#[derive(Default)]
pub(super) struct Times {
    block: Block,
    /// At whole parts of the block, both ends left out; `None` where the scene cannot be evaluated.
    known: Vec<OnceLock<Option<Moment>>>,
}

/// The scene and its lamps at a time.
struct Moment {
    frame: Frame,
    lamps: Vec<Lamp>,
}

impl Times {
    pub(super) fn new(block: Block) -> Self {
        Self { block, known: (1..MOST_INTERVALS).map(|_| OnceLock::new()).collect() }
    }
}

/// A facet at a moment.
pub(super) struct FacetAt<'a> {
    /// The scene's lamps then.
    pub lamps: &'a [Lamp],
    /// World places and normals of its corners at (s, t) = (0, 0), (1, 0) and (0, 1).
    corners: [(DVec3, DVec3); 3],
    /// World tangents there, and signs of bitangents.
    pub tangents: [(DVec3, f64); 3],
    eye: Option<DVec3>,
    /// 1 from its front, -1 from behind.
    pub side: f64,
    /// What is the same everywhere on it.
    all: Point,
}

impl FacetAt<'_> {
    /// A place (s, t), without what maps say.
    pub(super) fn point(&self, [s, t]: [f64; 2]) -> Point {
        let blend = |[a, b, d]: [DVec3; 3]| a + (b - a) * s + (d - a) * t;
        let position = blend(self.corners.map(|c| c.0));
        Point {
            position,
            normal: blend(self.corners.map(|c| c.1)).normalize_or(DVec3::Z) * self.side,
            to_eye: self.eye.map_or(DVec3::Z, |eye| (eye - position).normalize_or(DVec3::Z)),
            ..self.all
        }
    }
}

impl Lighting<'_> {
    /// The key of moment `time` of a block that is cut into `intervals`, and where in the block that is; 0 of what does not
    /// change.
    pub(super) fn moment_of(&self, time: u32, intervals: u32) -> (u64, f64) {
        let u = f64::from(time) / f64::from(intervals.max(1));
        let border = match time {
            _ if intervals == 0 => 0,
            0 => self.borders[0],
            _ if time == intervals => self.borders[1],
            _ => key(self.times.block.at(u), false),
        };
        (border, u)
    }

    /// The scene and its lamps at part `u` of the block, a whole number of parts of [`MOST_INTERVALS`].
    fn scene_at(&self, u: f64) -> (Option<&Frame>, &[Lamp]) {
        let end = |end: usize| (self.frames.as_ref().map(|f| &f[end]), &self.lamps[end][..]);
        let unit = (u * f64::from(MOST_INTERVALS)).round() as usize;
        if unit == 0 {
            return end(0);
        }
        let Some(known) = self.times.known.get(unit - 1) else { return end(1) };
        let found = known.get_or_init(|| {
            let frame = self.world.frame(self.times.block.at(u)).ok()?;
            let lamps = material::lamps(self.world.scene, &frame, &self.world.moving_nodes);
            Some(Moment { frame, lamps })
        });
        found.as_ref().map_or_else(|| end(0), |found| (Some(&found.frame), &found.lamps[..]))
    }

    /// A facet at part `u` of the block, seen from its front or from behind.
    pub(super) fn facet_at(&self, facet: u32, front: bool, u: f64) -> FacetAt<'_> {
        let f = &self.world.facets[facet as usize];
        let index = f.surface as usize;
        let surface = &self.world.surfaces[index];
        let [a, b, _, d] = f.corners.map(|c| c as usize);
        let ends = &self.corners[index];
        let bent = &self.tangents[index];
        let (frame, lamps) = self.scene_at(u);
        let of = |end: usize| [a, b, d].map(|c| ends[end][c]);
        let tangents_of = |end: usize| [a, b, d].map(|c| bent[end].get(c).copied().unwrap_or_default());
        let (corners, tangents) = match frame {
            _ if !surface.moves || u == 0.0 => (of(0), tangents_of(0)),
            _ if u == 1.0 => (of(1), tangents_of(1)),
            Some(frame) if !surface.deforms => {
                let pose = frame.world_from_node(surface.node);
                (
                    self.carried(f.surface, [a, b, d], &pose),
                    self.carried_tangents(f.surface, [a, b, d], &pose),
                )
            }
            _ => {
                let between = |k: usize| {
                    let (p, q) = (of(0)[k], of(1)[k]);
                    (p.0.lerp(q.0, u), p.1.lerp(q.1, u))
                };
                let turned = |k: usize| {
                    let (p, q) = (tangents_of(0)[k], tangents_of(1)[k]);
                    (p.0.lerp(q.0, u), p.1)
                };
                ([0, 1, 2].map(between), [0, 1, 2].map(turned))
            }
        };
        let answer = &self.answers[index];
        FacetAt {
            lamps,
            corners,
            tangents,
            eye: frame.map(|f| f.eye),
            side: if front { 1.0 } else { -1.0 },
            all: Point {
                model: answer.model,
                position: DVec3::ZERO,
                normal: DVec3::Z,
                to_eye: DVec3::Z,
                metallic: answer.metallic,
                roughness: answer.roughness,
                occlusion: answer.occlusion,
                mean_base: answer.mean_base,
            },
        }
    }

    /// Vertices of a rigid surface in the world.
    fn carried(&self, surface: u32, vertices: [usize; 3], pose: &DMat4) -> [(DVec3, DVec3); 3] {
        let primitive = self.world.primitive(surface);
        vertices.map(|v| {
            let normal = primitive.normals.get(v).map_or(DVec3::Z, |n| wide(*n));
            (pose.transform_point3(wide(primitive.positions[v])), normal_under(pose, normal))
        })
    }

    fn carried_tangents(&self, surface: u32, vertices: [usize; 3], pose: &DMat4) -> [(DVec3, f64); 3] {
        let tangents = self.world.primitive(surface).tangents.as_ref();
        let mirrored = if pose.determinant() < 0.0 { -1.0 } else { 1.0 };
        vertices.map(|v| {
            let [x, y, z, w] = tangents.and_then(|t| t.get(v)).copied().unwrap_or_default();
            (pose.transform_vector3(wide([x, y, z])), f64::from(w) * mirrored)
        })
    }

    /// How many intervals of the block light of a facet whose light changes needs within a range of (s, t), a power of two; and
    /// how many widths of highlights, or of what bends light as much, go by there during the block.
    pub(super) fn intervals(&self, facet: u32, [low, high]: [[f64; 2]; 2], front: bool) -> (u32, f64) {
        let mean = self.answers[self.world.facets[facet as usize].surface as usize].mean_base;
        let base = mean.max(DVec3::splat(0.05));
        let at = [0.0, 0.5, 1.0].map(|u| self.facet_at(facet, front, u));
        let middle = [0, 1].map(|k| 0.5 * (low[k] + high[k]));
        let places = [middle, low, high, [low[0], high[1]], [high[0], low[1]]];
        let points = places.map(|place| [0, 1, 2].map(|k| at[k].point(place)));
        let mut bend = 0.0_f64;
        for point in &points {
            let mut light = [0.0; 3];
            for ((light, point), at) in light.iter_mut().zip(point).zip(&at) {
                let mut responses = [Response::default(); 1 + MOST_OWN];
                respond(point, at.lamps, &self.own, &self.shared.around, &mut responses);
                let of = |r: &Response| r.linear.dot(base) + r.constant;
                *light = responses[..1 + self.own.len()].iter().map(of).sum();
            }
            let off = (light[1] - 0.5 * (light[0] + light[2])).abs();
            bend = bend.max(off / light.into_iter().fold(1e-9, f64::max));
        }
        let lobes = highlights(&points, &at).max(cones(&points, &at));
        let wanted = (bend / SMOOTH).sqrt().max(lobes / LOBES);
        let most = MOST_INTERVALS.min(self.times.block.length_us() as u32).max(1);
        let wanted = wanted.clamp(1.0, f64::from(MOST_INTERVALS)).ceil() as u32;
        let intervals = wanted.next_power_of_two().min(1 << most.ilog2());
        (intervals, lobes)
    }
}

/// Widths of the highlight of any lamp that go by at places of a facet, each at the start, middle and end of a block.
fn highlights(points: &[[Point; 3]; 5], at: &[FacetAt; 3]) -> f64 {
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
fn cones(points: &[[Point; 3]; 5], at: &[FacetAt; 3]) -> f64 {
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
