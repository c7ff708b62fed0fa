//! Light between the ends of a block: at how many moments it is found, and facets at these.
//!
//! The number of moments follows from light at a few places of a facet: from the difference between light in the middle of the
//! block and the mean of its ends, which falls with the square of their number, and from how many times its own width a
//! highlight or the border of a lamp's cone moves.

use glam::{DMat4, DVec3, Vec4};

use super::Lighting;
use crate::fours::Four;
use crate::scene::facets::wide;
use crate::scene::world::{Frame, normal_under, tangent_under};
use crate::shading::material::{self, Lamp, Point};
use crate::shading::moments::{FacetAt, MOST_INTERVALS, Moment, cones, highlights, key};
use crate::shading::places::LitFacet;

/// Part of the light by which it may be off in the middle between moments.
const SMOOTH: f64 = 0.005;
/// Widths of a highlight between two moments.
const LOBES: f64 = 0.3;

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
    pub(super) fn scene_at(&self, u: f64) -> (Option<&Frame>, &[Lamp]) {
        let end = |end: usize| (self.frames.as_ref().map(|f| &f[end]), &self.lamps[end][..]);
        let found = self.times.at(u, |t_us| {
            let frame = self.world.frame(t_us).ok()?;
            let lamps = material::lamps(self.world.scene, &frame, &self.world.moving_nodes);
            Some(Moment { frame, lamps })
        });
        match found {
            None => end(usize::from(u > 0.5)),
            Some(None) => end(0),
            Some(Some(found)) => (Some(&found.frame), &found.lamps[..]),
        }
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

    /// Tangents of a rigid surface in the world, where it has maps.
    fn carried_tangents(&self, surface: u32, vertices: [usize; 3], pose: &DMat4) -> [(DVec3, f64); 3] {
        let tangents = self.world.primitive(surface).tangents.as_ref();
        let Some(tangents) = tangents.filter(|_| self.answers[surface as usize].maps.is_some()) else {
            return Default::default();
        };
        vertices.map(|v| tangent_under(pose, tangents.get(v).copied().unwrap_or_default()))
    }

    /// How many intervals of the block light of a facet whose light changes needs within a range of (s, t), a power of two; and
    /// how many widths of highlights, or of what bends light as much, go by there during the block.
    pub(super) fn intervals(&self, facet: u32, [low, high]: [[f64; 2]; 2], front: bool) -> (u32, f64) {
        let answer = &self.answers[self.world.facets[facet as usize].surface as usize];
        let base = answer.mean_base.max(DVec3::splat(0.05));
        let at = [0.0, 0.5, 1.0].map(|u| self.facet_at(facet, front, u));
        let middle = [0, 1].map(|k| 0.5 * (low[k] + high[k]));
        let places = [middle, low, high, [low[0], high[1]], [high[0], low[1]]];
        let points = places.map(|place| [0, 1, 2].map(|k| at[k].point(place)));
        let mut bend = 0.0_f32;
        // Light of maps is found at each evaluation.
        if answer.maps.is_none() {
            let facets = at.each_ref().map(|at| LitFacet::new(at, &self.own, middle));
            let base = Four::splat(base);
            let [middle, others @ ..] = places;
            for four in [others, [middle; 4]] {
                let light = facets.each_ref().map(|facet| {
                    let answers = facet.responses(&four, &self.shared.around);
                    answers.into_iter().take(1 + self.own.len()).fold(Vec4::ZERO, |sum, answer| {
                        let sent = answer.sent(base);
                        sum + sent.proportional + sent.constant
                    })
                });
                let off = (light[1] - 0.5 * (light[0] + light[2])).abs();
                let most = light.into_iter().fold(Vec4::splat(1e-9), Vec4::max);
                bend = bend.max((off / most).max_element());
            }
        }
        let lobes = highlights(&points, &at).max(cones(&points, &at));
        let wanted = (f64::from(bend) / SMOOTH).sqrt().max(lobes / LOBES);
        let most = MOST_INTERVALS.min(self.times.block.length_us() as u32).max(1);
        let wanted = wanted.clamp(1.0, f64::from(MOST_INTERVALS)).ceil() as u32;
        let intervals = wanted.next_power_of_two().min(1 << most.ilog2());
        (intervals, lobes)
    }
}
