//! Light of entries without shadows: a polynomial over the part of a facet that a tile sees, or places of each part of a pixel.

use evis_scene::{Eye, ShadingModel};
use glam::{DVec3, Vec4};

use super::{GAUSS, Instant, Lighting, MOST_OWN, Part, Slot, TileLight};
use crate::fours::Four;
use crate::shading::lobes::{Lobes, cones, highlights};
use crate::shading::material::Point;
use crate::shading::patch::{NODES, Patch, STEPS, nodes_at, value, weights, weights_at};
use crate::shading::places::{
    FacetOverTime, LampOverTime, LightsOverTime, LitFacet, OverTime, Points, Responses,
};

/// Part of the light by which a polynomial may be off between its nodes.
const SMOOTH: f32 = 0.0015;
/// Widths of highlights that may go by or lie on a part of a facet: of more, nodes and what they are compared with may see none.
const MOST_LOBES: f64 = 2.0;
/// Part of its size by which a patch goes beyond the part of a facet that is seen at the start, middle and end of a block.
const BEYOND: f64 = 0.125;
/// Where between nodes a patch is compared with light itself, as parts of its sides.
const CHECKS: [[f64; 2]; 3] = [[0.25, 0.25], [0.75, 0.35], [0.4, 0.75]];
/// The same, and when: where light changes during the block.
const LATER_CHECKS: [[f64; 2]; 4] = [[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]];
/// See there.
const LATER: f64 = 0.25;

/// How a part of an entry responds to light.
#[expect(clippy::large_enum_variant, reason = "there is one at a time, for an evaluation")]
pub(super) enum Answers {
    /// By a patch: where its nodes at the moment begin, and how they count.
    Smooth(usize, [f32; NODES]),
    /// At places of a facet, its number in [`TileLight::facets`].
    Places(usize, Points),
}

impl Lighting<'_> {
    /// The eye and lamps during the block in work.
    pub(super) fn find_lights_over_time(&self) -> LightsOverTime {
        let of = |way: Eye| match way {
            Eye::At(place) => place,
            Eye::Along(way) => way,
        };
        let lamp = |number: usize| {
            let own = self.own.iter().position(|own| *own == number).map_or(0, |own| own + 1);
            LampOverTime::new(self.lamps.each_ref().map(|lamps| &lamps[number]), own)
        };
        LightsOverTime {
            eye: OverTime::through(self.eyes.map(of)),
            is_parallel: matches!(self.eyes[0], Eye::Along(_)),
            lamps: (0..self.lamps[0].len()).map(lamp).collect(),
        }
    }

    /// A facet during the block in work.
    pub(super) fn facet_over_time(&self, facet: u32) -> &FacetOverTime {
        self.facets[facet as usize].get_or_init(|| {
            let at = [0, 1, 2].map(|time| self.corners_at(facet, time));
            let of = |get: fn((DVec3, DVec3)) -> DVec3| {
                [0, 1, 2].map(|corner| OverTime::through(at.map(|at| get(at[corner]))))
            };
            Box::new(FacetOverTime { positions: of(|corner| corner.0), normals: of(|corner| corner.1) })
        })
    }

    /// World places and normals of a facet's corners at (s, t) = (0, 0), (1, 0) and (0, 1), at the start, middle or end of the block.
    fn corners_at(&self, facet: u32, time: usize) -> [(DVec3, DVec3); 3] {
        let f = &self.world.facets[facet as usize];
        let [a, b, _, d] = f.corners.map(|c| c as usize);
        let corners = self.vertices_at(f.surface as usize, time);
        [a, b, d].map(|c| corners[c])
    }

    /// What is the same everywhere on a surface.
    fn matter(&self, surface: usize) -> Point {
        let answer = &self.answers[surface];
        Point {
            model: answer.model,
            position: DVec3::ZERO,
            normal: DVec3::Z,
            to_eye: DVec3::Z,
            metallic: answer.metallic,
            roughness: answer.roughness,
            occlusion: answer.occlusion,
            mean_base: answer.mean_base,
        }
    }

    /// A facet at part `u` of the block, seen from (s, t) = `middle`; from its front, where `side` is 1, or from behind (-1).
    pub(super) fn lit_facet(&self, (facet, side): (u32, f64), u: f64, middle: [f64; 2]) -> LitFacet {
        let all = self.matter(self.world.facets[facet as usize].surface as usize);
        LitFacet::new((self.facet_over_time(facet), &all, side), &self.lights_over_time, u, middle)
    }

    /// Highlights, and borders of lamps' cones, within a range of (s, t) of a facet, which `at` is at the start, middle and end of the
    /// block.
    pub(super) fn lobes_of(&self, facet: u32, at: &[LitFacet; 3], [low, high]: [[f64; 2]; 2]) -> Lobes {
        let all = self.matter(self.world.facets[facet as usize].surface as usize);
        let middle = [0, 1].map(|k| 0.5 * (low[k] + high[k]));
        let corners = [low, [high[0], low[1]], high, [low[0], high[1]]];
        let mut lobes = Lobes::default();
        if all.model == ShadingModel::MetallicRoughness {
            let points = [corners, [middle; 4]].map(|four| at.each_ref().map(|at| at.points(&four)));
            lobes = highlights(&all, at, &points);
        }
        if self.lamps[0].iter().any(|lamp| lamp.cone.is_some()) {
            let [a, b, c, d] = corners;
            let at = [0, 1, 2].map(|time| self.corners_at(facet, time).map(|corner| corner.0));
            let place = |[s, t]: [f64; 2]| at.map(|[a, b, d]| a + (b - a) * s + (d - a) * t);
            lobes = lobes.max(cones(&[middle, a, b, c, d].map(place), &self.lamps));
        }
        lobes
    }

    /// Finds light of a facet without maps within a range of (s, t), which `changes` during the block or does not: a patch, whose nodes
    /// are appended to `nodes`, unless that would be off, or `lobes` say that it may be; and bits of the lamps of which some arrives.
    pub(super) fn find_patch(
        &self,
        nodes: &mut Vec<[Vec4; NODES]>,
        ((facet, side), at): ((u32, f64), &[LitFacet; 3]),
        [low, high]: [[f64; 2]; 2],
        (changes, lobes): (bool, Lobes),
    ) -> (Option<Patch>, u8) {
        let lamps = 1 + self.own.len();
        let mean_base = self.answers[self.world.facets[facet as usize].surface as usize].mean_base;
        let (mut from, mut size) = ([0.0; 2], [0.0; 2]);
        for k in 0..2 {
            let beyond = BEYOND * (high[k] - low[k]).max(1e-6);
            from[k] = (low[k] - beyond).max(0.0);
            size[k] = (high[k] + beyond).min(1.0) - from[k];
        }
        let place = |part: [f64; 2]| [0, 1].map(|k| from[k] + part[k] * size[k]);
        let base = Four::splat(mean_base.max(DVec3::splat(0.05)));
        // Luminance of all light together.
        let sum = |answers: &[Responses]| {
            let sent = answers.iter().map(|answer| answer.sent(base));
            sent.fold(Vec4::ZERO, |sum, sent| sum + (sent.proportional + sent.constant))
        };
        let (mut lit, mut is_smooth) = (0_u8, lobes.moved.max(lobes.spread) <= MOST_LOBES);
        let mut shade = |facet: &LitFacet, places: &[[f64; 2]; 4]| {
            self.shaded.fetch_add(4, std::sync::atomic::Ordering::Relaxed);
            let points = facet.points(places);
            let mut answers = [Responses::default(); 1 + MOST_OWN];
            for (own, answer) in answers.iter_mut().enumerate().take(lamps) {
                *answer = facet.response(&points, own, &self.shared.around);
                if own > 0 && answer.is_any() {
                    lit |= 1 << (own - 1);
                }
            }
            answers
        };
        let first = nodes.len();
        let times = if changes { &at[..] } else { &at[..1] };
        nodes.resize(first + lamps * times.len(), [Vec4::ZERO; NODES]);
        // Luminance at nodes.
        let mut light = [[0.0_f32; NODES]; 3];
        let grid: [[f64; 2]; 12] = std::array::from_fn(|k| match k.checked_sub(NODES) {
            None => [STEPS[k % 3], STEPS[k / 3]],
            Some(check) => CHECKS[check],
        });
        let near = |found: f32, expected: f32| (found - expected).abs() <= SMOOTH * found.abs();
        let value_of = |light: &[f32; NODES], [x, y]: [f64; 2]| -> f32 {
            let weights = weights_at([x as f32, y as f32]);
            light.iter().zip(weights).map(|(light, weight)| light * weight).sum()
        };
        for (time, facet) in times.iter().enumerate() {
            let mut found = [0.0; 12];
            for (four, places) in grid.chunks_exact(4).enumerate() {
                let answers = shade(facet, &std::array::from_fn(|k| place(places[k])));
                sum(&answers[..lamps]).write_to_slice(&mut found[4 * four..][..4]);
                for (lamp, answer) in answers.iter().enumerate().take(lamps) {
                    for (k, row) in answer.rows().into_iter().enumerate() {
                        if let Some(node) = nodes[first + lamp * times.len() + time].get_mut(4 * four + k) {
                            *node = Vec4::from_array(row);
                        }
                    }
                }
            }
            light[time].copy_from_slice(&found[..NODES]);
            let mut checks = CHECKS.iter().zip(&found[NODES..]);
            is_smooth &= checks.all(|(at, found)| near(*found, value_of(&light[time], *at)));
        }
        if changes && is_smooth {
            let facet = self.lit_facet((facet, side), LATER, place([0.5; 2]));
            let answers = shade(&facet, &LATER_CHECKS.map(place));
            let by_time = weights(LATER as f32);
            let light = std::array::from_fn(|k| (0..3).map(|time| by_time[time] * light[time][k]).sum());
            let found = sum(&answers[..lamps]).to_array();
            let mut checks = LATER_CHECKS.iter().zip(found);
            is_smooth = checks.all(|(at, found)| near(found, value_of(&light, *at)));
        }
        if !is_smooth {
            nodes.truncate(first);
            // A cone may shine between all of them.
            let spots = self.own.iter().enumerate().filter(|(_, lamp)| self.lamps[0][**lamp].cone.is_some());
            return (None, spots.fold(lit, |lit, (number, _)| lit | 1 << number));
        }
        (Some(Patch { low: from, inverse: size.map(|v| 1.0 / v), first, times: times.len() }), lit)
    }

    /// How entry `part.slot` responds to light over `part`, whose centroid is at (s, t) = `place`.
    #[inline(always)]
    pub(super) fn answers(
        &self,
        tile: &mut TileLight,
        part: &Part,
        place: [f64; 2],
        at: &Instant,
    ) -> Answers {
        let slot = tile.slots[part.slot];
        if let Some(patch) = &slot.patch {
            let first = match patch.times {
                1 => patch.first,
                _ => self.enter_moment(tile, part.slot, at, |tile| self.patch_at(tile, patch, at.u)),
            };
            let within =
                [0, 1].map(|k| ((place[k] - patch.low[k]) * patch.inverse[k]).clamp(0.0, 1.0) as f32);
            return Answers::Smooth(first, weights_at(within));
        }
        let number = self.enter_moment(tile, part.slot, at, |tile| {
            let side = if part.sight.front { 1.0 } else { -1.0 };
            tile.facets.push(self.lit_facet((part.sight.facet, side), at.u, slot.middle()));
            tile.facets.len() - 1
        });
        let (centre, axes) = part.moments.footprint();
        let (place, change) = part.sight.parameters(part.frame.point(centre));
        let sides = axes.map(|axis| {
            let axis = part.frame.vector(axis);
            [0, 1].map(|k| GAUSS * (change[0][k] * axis[0] + change[1][k] * axis[1]))
        });
        let at = |[i, j]: [f64; 2]| [0, 1].map(|k| place[k] + i * sides[0][k] + j * sides[1][k]);
        let places = [[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]].map(at);
        Answers::Places(number, tile.facets[number].points(&places))
    }

    /// What [`Lighting::answers`] responds to what no shadow falls on (0) or to a lamp that is kept apart (its number plus 1), as a
    /// function of base colour: factors of its channels, and what does not depend on it.
    #[inline(always)]
    pub(super) fn answer(&self, tile: &TileLight, answers: &Answers, own: usize) -> Vec4 {
        match answers {
            Answers::Smooth(first, weights) => value(&tile.nodes[first + own], weights),
            Answers::Places(number, points) => {
                tile.facets[*number].response(points, own, &self.shared.around).mean()
            }
        }
    }

    /// What `find` found of entry `slot` at a moment, once.
    #[inline(always)]
    fn enter_moment(
        &self,
        tile: &mut TileLight,
        slot: usize,
        at: &Instant,
        find: impl FnOnce(&mut TileLight) -> usize,
    ) -> usize {
        let index = at.moment * tile.slots.len() + slot;
        if tile.moments.len() <= index {
            tile.moments.resize((at.moment + 1) * tile.slots.len(), 0);
        }
        if tile.moments[index] == 0 {
            tile.moments[index] = find(tile) as u32 + 1;
        }
        tile.moments[index] as usize - 1
    }

    /// Appends the nodes of `patch` at part `u` of the block; where they begin.
    fn patch_at(&self, tile: &mut TileLight, patch: &Patch, u: f64) -> usize {
        let first = tile.nodes.len();
        for own in 0..=self.own.len() {
            let from = patch.first + patch.times * own;
            let [a, b, c] = [0, 1, 2].map(|time| tile.nodes[from + time]);
            tile.nodes.push(nodes_at(&[a, b, c], u as f32));
        }
        first
    }
}

impl Slot {
    /// The middle of the part of the facet that the tile sees, in (s, t).
    pub(super) fn middle(&self) -> [f64; 2] {
        let [low, high] = self.range;
        [0, 1].map(|k| 0.5 * (low[k] + high[k]))
    }
}
