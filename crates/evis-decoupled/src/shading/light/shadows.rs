//! What may throw a shadow where, and how much of a lamp's light arrives.

use std::cell::LazyCell;
use std::sync::{Arc, OnceLock};

use glam::DVec3;

use super::{
    Casters, Instant, Key, Lighting, MOST_OWN, Part, Shade, Shadowed, Slot, TileLight, part_between, sphere,
};
use crate::scene::facets::{ALONE, wide};
use crate::scene::tiles::TileView;
use crate::scene::world::Frame;
use crate::shading::shadow::{Beam, DarkSpace, Hull, Occluder, Reached, Receiver, ScreenLamp, Tree};
use crate::visibility::coverage::Moments;
use crate::visibility::fragment::Sight;
use crate::visibility::lists::Record;

/// The start and end of a block, among its start, middle and end.
const ENDS: [usize; 2] = [0, 2];

impl Lighting<'_> {
    /// What may throw shadows during the block of these `frames`; `first` of all blocks also what never moves.
    pub(super) fn prepare_shadows(&mut self, frames: &[Frame; 3], first: bool) {
        let world = self.world;
        self.depths = frames[0].depths;
        self.screen = frames.each_ref().map(|f| f.screen_from_world);
        let lamps = &self.lamps;
        self.screen_lamps.clear();
        self.lamp_places.clear();
        for &index in &self.own {
            let (_, weight) = lamps[0][index].place();
            let h = [0, 1, 2].map(|k| self.screen[k].place(lamps[k][index].place().0, weight));
            self.screen_lamps.push(ScreenLamp::new(h));
            self.lamp_places.push([0, 1, 2].map(|k| lamps[k][index].place().0));
        }
        let shadows = self.own.iter().any(|k| self.lamps[0][*k].casts_shadow);
        if first {
            let still = world.facets.iter().enumerate().filter_map(|(index, f)| {
                let surface = f.surface as usize;
                (shadows && !world.surfaces[surface].moves).then(|| {
                    let (centre, radius) =
                        sphere(f.corners.map(|c| self.vertices[surface][0][c as usize].0).into_iter());
                    (centre, radius, index as u32)
                })
            });
            self.still = Tree::new(still);
            for spaces in self.dark_spaces.iter_mut().take(if shadows { self.own.len() } else { 0 }) {
                spaces.resize_with(world.facets.len(), OnceLock::new);
            }
            self.moving_facets.resize_with(world.surfaces.len(), Tree::default);
            self.own_facets.resize_with(world.surfaces.len(), Tree::default);
            self.own_lamps.resize_with(world.surfaces.len(), Vec::new);
        }
        self.moving = Tree::default();
        if !shadows {
            return;
        }
        self.occluders.clear();
        self.occluders.resize_with(world.facets.len(), OnceLock::new);
        let lamps_move = self.own.iter().any(|k| self.lamps[0][*k].moves);
        let mut moving = Vec::new();
        for (index, surface) in world.surfaces.iter().enumerate() {
            if first || lamps_move || surface.moves {
                self.find_far_sides(index, frames);
            }
            if !surface.moves {
                continue;
            }
            let places = &self.vertices[index];
            let facets = || world.clusters[surface.clusters.clone()].iter().flat_map(|c| c.facets.clone());
            let spheres = facets().map(|facet| {
                let points = world.facets[facet].corners.map(|c| places.each_ref().map(|p| p[c as usize].0));
                let (centre, radius) = sphere(points.into_iter().flatten());
                // An arc between the three places bulges by less than a quarter of its chord.
                let travel = points.iter().map(|p| p[0].distance(p[2])).fold(0.0, f64::max);
                (centre, radius + 0.25 * travel, facet as u32)
            });
            self.moving_facets[index] = Tree::new(spheres);
            moving.extend(
                self.moving_facets[index].whole().map(|(centre, radius)| (centre, radius, index as u32)),
            );
            if surface.deforms {
                continue;
            }
            if first {
                let primitive = world.primitive(index as u32);
                let of = |facet: usize| {
                    let corners = world.facets[facet].corners.map(|c| wide(primitive.positions[c as usize]));
                    let (centre, radius) = sphere(corners.into_iter());
                    (centre, radius, facet as u32)
                };
                self.own_facets[index] = Tree::new(facets().map(of));
            }
            let inverse = frames.each_ref().map(|f| f.world_from_node(surface.node).inverse());
            self.own_lamps[index] = (self.own.iter().zip(&self.lamp_places))
                .map(|(&lamp, places)| {
                    let weight = self.lamps[0][lamp].place().1;
                    [0, 1, 2].map(|k| (inverse[k] * places[k].extend(weight)).truncate())
                })
                .collect();
        }
        self.moving = Tree::new(moving.into_iter());
    }

    /// Which sides of a surface's facets lamps see, and which facets of a solid face away from lamps outside of it.
    fn find_far_sides(&mut self, surface: usize, frames: &[Frame; 3]) {
        let s = &self.world.surfaces[surface];
        let facets = self.world.clusters[s.clusters.clone()].iter().flat_map(|c| c.facets.clone());
        let poses = ENDS.map(|end| frames[end].world_from_node(s.node));
        let mirrored = poses.map(|p| !s.deforms && p.determinant() < 0.0);
        let inverse = poses.map(|p| p.inverse());
        let mut inside = 0_u8;
        for (number, &lamp) in self.own.iter().enumerate() {
            for (end, inverse) in ENDS.into_iter().zip(&inverse) {
                let lamps = &self.lamps[end];
                let (place, weight) = lamps[lamp].place();
                let own = inverse.transform_point3(place);
                let within = s.deforms || (own.cmpge(s.bounds[0]) & own.cmple(s.bounds[1])).all();
                inside |= u8::from(weight > 0.0 && within) << number;
            }
        }
        for facet in facets {
            let mut facing = [0; 2];
            for (number, &lamp) in self.own.iter().enumerate() {
                let heights = [0, 1].map(|k| {
                    let corners = self.vertices_at(surface, ENDS[k]);
                    let [p, q, _, r] = self.world.facets[facet].corners.map(|c| corners[c as usize].0);
                    let (place, weight) = self.lamps[ENDS[k]][lamp].place();
                    // Outwards, unless the pose mirrors.
                    let normal = (q - p).cross(r - p);
                    normal.dot(place - p * weight) * if mirrored[k] { -1.0 } else { 1.0 }
                });
                facing[0] |= u8::from(heights.iter().all(|h| *h > 0.0)) << number;
                facing[1] |= u8::from(heights.iter().all(|h| *h < 0.0)) << number;
            }
            self.facing[facet] = facing;
            self.far[facet] = if s.closed { facing[1] & !inside } else { 0 };
        }
    }

    /// Bits of the edges of `facet` that are no silhouettes for lamp `number`: a neighbor that faces it alike continues the shadow.
    pub(super) fn inner_edges(&self, facet: u32, number: usize) -> u8 {
        let sides = |facet: u32| self.facing[facet as usize].map(|bits| bits >> number & 1);
        let own = sides(facet);
        let goes_on = |other: u32| {
            own != [0; 2]
                && other != ALONE
                && sides(other) == own
                && self.far[other as usize] >> number & 1 == 0
        };
        let edges = self.world.neighbors[facet as usize].into_iter().enumerate();
        edges.fold(0, |bits, (k, other)| bits | u8::from(goes_on(other)) << k)
    }

    /// What of everything still may throw a shadow of lamp `number` into a cell of a still facet.
    pub(super) fn shadowed(&self, key: Key, number: usize) -> Arc<Shadowed> {
        self.shadowed.get(key, self.block, |key| self.find_shadowed(key, number))
    }

    fn find_shadowed(&self, key: &Key, number: usize) -> Shadowed {
        let [p, q, _, r] = self.corners_of(key.facet);
        let at = |i: u32, j: u32| {
            let side = [0, 1].map(|k| 1.0 / f64::from(1_u32 << key.level[k]));
            let (s, t) = (
                f64::from(u32::from(key.index[0]) + i) * side[0],
                f64::from(u32::from(key.index[1]) + j) * side[1],
            );
            p + (q - p) * s + (r - p) * t
        };
        let cell = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
        let (place, weight) = self.lamps[0][self.own[number]].place();
        let before = Hull::before(cell, place, weight);
        let (mut dark, mut facets) = (false, Vec::new());
        if let Some(whole) = key.coarser() {
            // Nothing else throws a shadow into a part of it.
            let whole = self.shadowed(whole, number);
            (dark, facets) = (whole.dark, whole.facets.to_vec());
        } else {
            let add = |id: u32| facets.push(id);
            let middle = cell.iter().sum::<DVec3>() / 4.0;
            let radius = cell.iter().map(|c| c.distance(middle)).fold(0.0, f64::max) * 1.001 + 1e-6;
            match Beam::new(place, weight, middle, radius) {
                Some(beam) => self.still.within(|c, r| beam.meets(c, r), add),
                None => self.still.all(add),
            }
            facets.retain(|id| *id != key.facet && self.far[*id as usize] >> number & 1 == 0);
            facets.sort_unstable();
        }
        facets.retain(|id| self.may_darken(*id, number, (&before, &cell)));
        dark |= facets.iter().any(|id| self.dark_space(*id, number).holds(&cell));
        if dark {
            facets.clear();
        }
        Shadowed { dark, facets: facets.into() }
    }

    /// Finds which of the `casters` may throw a shadow of each lamp into the part of a facet that a tile sees. Those that
    /// move are asked for first.
    pub(super) fn find_occluders(
        &self,
        tile: &mut TileLight,
        slot: &mut Slot,
        record: &Record,
        casters: Casters,
    ) {
        let facet = record.facet;
        let f = &self.world.facets[facet as usize];
        let surface = f.surface as usize;
        let (mut receiver, mut part) = (None, None);
        for (number, &lamp) in self.own.iter().enumerate() {
            let [a, b] = ENDS.map(|end| &self.lamps[end][lamp]);
            if slot.lit >> number & 1 == 0 || !a.casts_shadow || slot.shades[number].dark == u64::MAX {
                continue;
            }
            tile.found.clear();
            let resting = !self.world.surfaces[surface].moves && !a.moves;
            if resting && self.shadows_at_rest(tile, slot, facet, number, casters) {
                slot.shades[number] = Shade { dark: u64::MAX, ..Shade::default() };
                continue;
            }
            if !resting {
                slot.still = false;
            }
            // Nothing that rests was found near it.
            if resting && matches!(casters, Casters::Still) && tile.found.is_empty() {
                continue;
            }
            // A sphere about the part of the facet, at both ends.
            let ends = ENDS.map(|end| {
                let corners = self.vertices_at(surface, end);
                part_between(f.corners.map(|c| corners[c as usize].0), slot.range)
            });
            let points = ends.as_flattened();
            let middle = points.iter().sum::<DVec3>() / 8.0;
            let (from, weight) = a.place();
            let moved = from.distance(b.place().0);
            let radius = points.iter().map(|p| p.distance(middle)).fold(0.0, f64::max) * 1.01 + moved + 1e-6;
            let beam = Beam::new(from, weight, middle, radius);
            // Where lamp and surface rest, what matters lies within flat walls.
            let cell = ends[0];
            let has_walls = resting && beam.is_some();
            let hull = LazyCell::new(|| has_walls.then(|| Hull::before(cell, from, weight)));
            match casters {
                Casters::Moving => {
                    if resting {
                        tile.beams.push(beam);
                    }
                    let sees_lamp = self.facing[facet as usize][0] >> number & 1 == 1;
                    let free_of_own = self.world.surfaces[surface].convex && sees_lamp;
                    let meets = |centre: DVec3, radius: f64| {
                        beam.as_ref().is_none_or(|b| b.meets(centre, radius))
                            && hull.as_ref().is_none_or(|h| h.meets_sphere(centre, radius))
                    };
                    self.moving.within(meets, |other| {
                        let other = other as usize;
                        if other == surface && free_of_own {
                            return;
                        }
                        if other == surface && !self.own_facets[other].is_empty() {
                            self.find_own_occluders(facet, slot.range, number, weight, &mut tile.found);
                        } else {
                            self.moving_facets[other].within(meets, |id| tile.found.push(id));
                        }
                    });
                }
                Casters::Still => match (&*hull, &beam) {
                    (Some(hull), _) => tile.found.retain(|id| self.may_darken(*id, number, (hull, &cell))),
                    (None, _) if resting => {}
                    (None, Some(beam)) => {
                        self.still.within(|c, r| beam.meets(c, r), |id| tile.found.push(id))
                    }
                    (None, None) => self.still.all(|id| tile.found.push(id)),
                },
            }
            if tile.found.is_empty() {
                continue;
            }
            tile.found.sort_unstable();
            tile.found.dedup();
            let start = tile.occluders.len();
            let (mut touched, mut inside, mut border) = (0, 0, 0);
            let shade = &mut slot.shades[number];
            // Those that were found before.
            tile.occluders.extend_from_within(shade.from..shade.to);
            let added = tile.occluders.len();
            for k in 0..tile.found.len() {
                let id = tile.found[k];
                if id == facet || self.far[id as usize] >> number & 1 == 1 {
                    continue;
                }
                let occluder = self.occluder(id);
                if !resting {
                    let part = part.get_or_insert_with(|| self.part_of(facet, slot.range));
                    let new = || DarkSpace::new(&self.places_of(id), &self.lamp_places[number], weight);
                    if occluder.dark_space(number, new).is_some_and(|space| space.misses(part)) {
                        continue;
                    }
                }
                let view = &tile.whole;
                // Where the tile does not see it, nothing is known.
                let plane = &slot.plane;
                let receiver = receiver.get_or_insert_with(|| plane.map(|lines| Receiver::new(lines, view)));
                let inner = self.inner_edges(id, number);
                let (lamp, receiver) = (&self.screen_lamps[number], (receiver.as_ref(), record.u));
                let found = occluder.pixels((number, lamp), receiver, view, (slot.touches, inner));
                if found.touches == 0 {
                    continue;
                }
                if let Casters::Moving = casters {
                    slot.motion = slot.motion.max(found.motion_px);
                }
                shade.dark |= found.darkens;
                touched |= found.touches;
                inside |= found.inside;
                border |= found.border;
                tile.occluders.push((found.touches, id));
            }
            // Where no border comes, the facet's part of a pixel is dark as a whole or not at all: as the pixel's centre at
            // first, if that is on the facet. Elsewhere facets beside it may be missing from the candidates.
            let centres = if tile.occluders.len() > added { self.centres(record, &tile.view) } else { 0 };
            let uniform = centres & !border;
            shade.dark |= inside & uniform;
            let mixed = touched & !uniform;
            shade.touched |= mixed;
            if let Casters::Moving = casters {
                slot.moved |= mixed & !shade.dark;
            }
            let mut kept = added;
            for k in added..tile.occluders.len() {
                let (touches, id) = tile.occluders[k];
                if touches & mixed & !shade.dark != 0 {
                    tile.occluders[kept] = (touches & mixed, id);
                    kept += 1;
                }
            }
            tile.occluders.truncate(kept);
            if slot.touches & !shade.dark == 0 {
                shade.dark = u64::MAX;
                tile.occluders.truncate(start);
            }
            shade.touched &= !shade.dark;
            (shade.from, shade.to) = (start, tile.occluders.len());
        }
    }

    /// Whether anything that moves during the block may throw a shadow within one of `beams`; without a beam it may.
    pub fn is_approached(&self, beams: &[Option<Beam>]) -> bool {
        beams.iter().any(|beam| {
            let meets = |centre: DVec3, radius: f64| beam.is_none_or(|beam| beam.meets(centre, radius));
            self.moving.any(meets, |surface| self.moving_facets[surface as usize].any(meets, |_| true))
        })
    }

    /// Finds which facets of a rigid surface may throw a shadow of lamp `number` on a part of another one of it: where nothing
    /// moves but the lamp.
    pub(super) fn find_own_occluders(
        &self,
        facet: u32,
        range: [[f64; 2]; 2],
        number: usize,
        weight: f64,
        found: &mut Vec<u32>,
    ) {
        let f = &self.world.facets[facet as usize];
        let surface = f.surface as usize;
        let primitive = self.world.primitive(f.surface);
        let corners = f.corners.map(|c| wide(primitive.positions[c as usize]));
        let (centre, own) = sphere(part_between(corners, range).into_iter());
        let to_lamp =
            self.own_lamps[surface][number].map(|place| (place - centre * weight).normalize_or(DVec3::Y));
        let axis = to_lamp[1];
        // How far the lamp's direction turns; an arc bulges by less than a quarter of its chord.
        let turn = 1.25 * to_lamp[0].distance(axis).max(to_lamp[2].distance(axis));
        if turn > 0.5 {
            self.own_facets[surface].all(|id| found.push(id));
            return;
        }
        // A point at distance s in a direction d with |d - axis| <= turn lies within s turn of the axis at s, which is at most
        // (along + reach) / (1 - turn) where a sphere meets it.
        let meets = |middle: DVec3, radius: f64| {
            let offset = middle - centre;
            let along = offset.dot(axis);
            let across = (offset - axis * along).length();
            let reach = own + radius;
            along >= -reach && across <= reach + turn / (1.0 - turn) * (along + reach)
        };
        self.own_facets[surface].within(meets, |id| found.push(id));
    }

    /// Finds what of everything still may throw a shadow of lamp `number` into a slot's cells, if `casters` are; says
    /// whether all of them are dark.
    pub(super) fn shadows_at_rest(
        &self,
        tile: &mut TileLight,
        slot: &Slot,
        facet: u32,
        number: usize,
        casters: Casters,
    ) -> bool {
        let mut all_dark = true;
        for j in 0..slot.count[1] {
            for i in 0..slot.count[0] {
                let index = [slot.first[0] + i, slot.first[1] + j];
                let known = self.shadowed(Key::new(facet, slot.level, index, number), number);
                all_dark &= known.dark;
                if let Casters::Still = casters {
                    tile.found.extend_from_slice(&known.facets);
                }
            }
        }
        all_dark
    }

    /// Pixels of a tile whose centres a facet covers at the start of its span.
    pub(super) fn centres(&self, record: &Record, view: &TileView) -> u64 {
        Sight::new(record, view, 0.0, &self.depths).map_or(0, |sight| sight.centres())
    }

    /// A facet as a tile sees it at the start, middle and end of its span.
    pub(super) fn sights(&self, record: &Record, view: &TileView) -> [Option<Sight>; 3] {
        [0.0, 0.5, 1.0].map(|v| Sight::new(record, view, v, &self.depths))
    }

    /// What a still facet hides from lamp `number`, which is still.
    pub(super) fn dark_space(&self, facet: u32, number: usize) -> &Hull {
        self.dark_spaces[number][facet as usize].get_or_init(|| {
            let (place, weight) = self.lamps[0][self.own[number]].place();
            Box::new(Hull::beyond(self.corners_of(facet), place, weight))
        })
    }

    /// World corners of a facet at the start of the block.
    fn corners_of(&self, facet: u32) -> [DVec3; 4] {
        let f = &self.world.facets[facet as usize];
        f.corners.map(|c| self.vertices[f.surface as usize][0][c as usize].0)
    }

    /// Whether still facet `id` may throw a shadow of lamp `number`, which is still, on a still `cell`, which lies beyond the walls `before`.
    fn may_darken(&self, id: u32, number: usize, (before, cell): (&Hull, &[DVec3; 4])) -> bool {
        before.meets(&self.corners_of(id)) && self.dark_space(id, number).meets(cell)
    }

    /// World corners of a facet at the start, middle and end of the block.
    pub(super) fn places_of(&self, facet: u32) -> [[DVec3; 4]; 3] {
        let f = &self.world.facets[facet as usize];
        let times = [0, 1, 2].map(|time| self.vertices_at(f.surface as usize, time));
        times.map(|corners| f.corners.map(|c| corners[c as usize].0))
    }

    /// The same of the part of it in a range of (s, t).
    pub(super) fn part_of(&self, facet: u32, range: [[f64; 2]; 2]) -> [[DVec3; 4]; 3] {
        let places = self.places_of(facet);
        let whole = range == [[0.0; 2], [1.0; 2]];
        if whole { places } else { places.map(|corners| part_between(corners, range)) }
    }

    pub(super) fn occluder(&self, facet: u32) -> &Occluder {
        self.occluders[facet as usize].get_or_init(|| Box::new(self.new_occluder(facet)))
    }

    pub(super) fn new_occluder(&self, facet: u32) -> Occluder {
        let places = self.places_of(facet);
        let of = |corner: usize| [0, 1, 2].map(|time| self.screen[time].point(places[time][corner]));
        Occluder::new(facet, [0, 1, 2, 3].map(of))
    }

    /// Half planes of the shadows that fall on entry `slot` from lamp `number` at `moment` of the tile: a range.
    pub(super) fn shadow_lines(
        &self,
        tile: &mut TileLight,
        slot: usize,
        number: usize,
        moment: usize,
        sight: &Sight,
        u: f64,
    ) -> usize {
        let index = (moment * tile.slots.len() + slot) * MOST_OWN + number;
        if tile.line_starts.len() <= index {
            tile.line_starts.resize((moment + 1) * tile.slots.len() * MOST_OWN, 0);
        }
        if tile.line_starts[index] == 0 {
            tile.line_starts[index] = tile.lines.len() as u32 + 1;
            let shade = tile.slots[slot].shades[number];
            for (_, id) in &tile.occluders[shade.from..shade.to] {
                let lamp = &self.screen_lamps[number];
                tile.lines.push(self.occluder(*id).lines(lamp, &sight.inverse_depth, &tile.view, u));
            }
        }
        tile.line_starts[index] as usize - 1
    }

    /// What of lamp `number`'s light arrives on a part: its strength times the part of the area that no shadow reaches, and
    /// where that is.
    #[inline(always)]
    pub(super) fn arriving(
        &self,
        tile: &mut TileLight,
        part: &Part,
        at: &Instant,
        number: usize,
    ) -> (f64, Option<Moments>) {
        let slot = part.slot;
        let lamp = &self.lamps[0][self.own[number]];
        let strength = lamp.waveform.map_or(1.0, |w| w.factor(at.t_s));
        let shade = tile.slots[slot].shades[number];
        if shade.dark >> part.pixel & 1 == 1 {
            return (0.0, None);
        }
        if shade.touched >> part.pixel & 1 == 0 {
            return (strength, None);
        }
        let start = self.shadow_lines(tile, slot, number, at.moment, part.sight, at.u);
        let near = tile.occluders[shade.from..shade.to].iter().zip(&tile.lines[start..]);
        let near = near.filter(|(o, _)| o.0 >> part.pixel & 1 == 1).map(|(_, lines)| lines);
        let Reached { part, lit } = tile.lit.part(part.regions, near, &part.frame);
        (strength * part, lit)
    }
}
