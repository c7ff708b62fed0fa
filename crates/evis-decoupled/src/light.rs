//! Light of surfaces: cells that live on facets, shaded when a tile first needs them.
//!
//! A facet's cells are the nodes of a grid over its (s, t), of 2^i by 2^j intervals; the level follows the facet's size
//! on the screen, so that an interval spans about a tile. A node holds the surface's response to base colour, without
//! shadows; a texture is filtered, and shadows are found, when a pixel is evaluated. Nodes whose light does not depend
//! on time or view are shaded once; all others at both ends of a block, and are linear between.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};
use std::sync::Mutex;

use evis_core::random::mix;
use evis_scene::{ShadingModel, TextureRef};
use glam::{DMat4, DVec3};

use crate::Error;
use crate::blocks::{Block, Clock};
use crate::coverage::{Moments, Polygon, Region};
use crate::fragment::Fragment;
use crate::lists::{Entry, Record, TILE};
use crate::material::{self, Lamp, Point, Response, respond};
use crate::shadow::{Beam, Lit, Occluder, ScreenLamp, Tree};
use crate::texture::Textures;
use crate::world::{Frame, World, wide};

/// Most intervals of a facet's grid along an axis, as a power of two.
const MOST_LEVEL: u32 = 14;
/// A grid is made finer this often, where light bends within its cells.
const MOST_FINER: u32 = 3;
/// Part of the light by which the middle of a cell may be off.
const SMOOTH: f64 = 0.004;
/// Maps that share the work of a lock.
const SHARDS: usize = 64;

/// What never changes of a facet's looks.
#[derive(Clone, Debug)]
struct Look {
    texture: Option<usize>,
    /// In base texels: where (s, t) = 0 is, and change with s and t.
    origin: [f64; 2],
    along: [[f64; 2]; 2],
    /// Base colour, vertex colour included: at (s, t) = 0, and change with s and t.
    base: DVec3,
    base_along: [DVec3; 2],
}

/// What never changes of a surface's light.
#[derive(Clone, Debug)]
struct Answer {
    model: ShadingModel,
    metallic: f64,
    roughness: f64,
    occlusion: f64,
    mean_base: DVec3,
    /// It depends on where the camera is.
    follows_view: bool,
}

/// Light at a node: responses to unshadowed light, then to each lamp that throws shadows.
type Node = Box<[[f32; 4]]>;

#[derive(Clone, Copy, PartialEq, Eq, Hash)]
struct Key {
    facet: u32,
    /// Level along s and t, and whether the front is seen.
    level: [u8; 3],
    index: [u16; 2],
    /// A border of time; 0 for what does not change.
    border: u64,
}

impl Key {
    /// Of the node at `index` of a grid; in lowest terms, so that grids of all levels share their nodes.
    fn new(facet: u32, level: [u32; 2], index: [u32; 2], front: bool, border: u64) -> Self {
        let reduced = [0, 1].map(|k| {
            let shift = index[k].trailing_zeros().min(level[k]);
            (level[k] - shift, index[k] >> shift)
        });
        Self {
            facet,
            level: [reduced[0].0 as u8, reduced[1].0 as u8, u8::from(front)],
            index: reduced.map(|(_, index)| index as u16),
            border,
        }
    }
}

/// FNV-1a is slow on long keys; this mixes words (the finaliser of SplitMix64).
#[derive(Default)]
struct Mix(u64);

impl Hasher for Mix {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for chunk in bytes.chunks(8) {
            let mut word = [0; 8];
            word[..chunk.len()].copy_from_slice(chunk);
            self.write_u64(u64::from_le_bytes(word));
        }
    }

    fn write_u64(&mut self, word: u64) {
        self.0 = mix((self.0 ^ word).wrapping_add(0x9e37_79b9_7f4a_7c15));
    }

    fn write_u32(&mut self, word: u32) {
        self.write_u64(word.into());
    }
}

type Shard = Mutex<HashMap<Key, Node, BuildHasherDefault<Mix>>>;

/// World corners and normals of a moving surface's vertices, at both ends of a block.
type Corners = Vec<(DVec3, DVec3)>;

/// Centre, radius, and the facet in it.
type Sphere = (DVec3, f64, u32);

/// Light of a scene.
pub struct Lighting<'a> {
    world: &'a World<'a>,
    textures: Textures,
    looks: Vec<Look>,
    answers: Vec<Answer>,
    /// Lamps and frames at both ends of the block.
    lamps: [Vec<Lamp>; 2],
    frames: Option<[Frame; 2]>,
    /// Per surface, vertices in the world at both ends; still ones are found once.
    corners: Vec<[Corners; 2]>,
    borders: [u64; 2],
    shards: Vec<Shard>,
    /// Nodes shaded so far.
    pub shaded: std::sync::atomic::AtomicU64,
    shadow_lamps: usize,
    /// Lamps that throw shadows, on the screen.
    screen_lamps: Vec<ScreenLamp>,
    /// Facets of still surfaces.
    still: Tree,
    /// Per moving surface: facets within spheres that hold them throughout the block.
    moving: Vec<(DVec3, f64, Vec<Sphere>)>,
    /// Screen from world at the start, middle and end of the block, and of moving surfaces from their vertices.
    screen: [DMat4; 3],
    middle: Vec<Corners>,
    background: f64,
}

/// Light of a tile's entries.
#[derive(Default)]
pub struct TileLight {
    slots: Vec<Slot>,
    nodes: Vec<[f32; 4]>,
    /// Of all slots and lamps.
    occluders: Vec<(u64, Occluder)>,
    centre: [f64; 2],
    found: Vec<u32>,
    lit: Lit,
}

/// Occluders of a slot and a lamp, as a range; or nothing of it is lit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Shade {
    from: usize,
    to: usize,
    /// Pixels of the tile that one of them darkens throughout the block.
    dark: u64,
}

/// Most lamps that throw shadows; further ones shine through everything.
pub const MOST_SHADOWS: usize = 4;

#[derive(Clone, Copy, Debug, Default)]
struct Slot {
    /// The rest is filled in.
    ready: bool,
    /// Of the facet's grid: intervals along s and t, and the first node that is kept.
    intervals: [f64; 2],
    first: [f64; 2],
    /// Nodes kept along s and t; 0 where light needs no node.
    count: [usize; 2],
    /// First node in [`TileLight::nodes`], of the block's start and of its end.
    at: [usize; 2],
    /// Response of unlit surfaces at both ends.
    unlit: [f64; 2],
    shades: [Shade; MOST_SHADOWS],
}

impl<'a> Lighting<'a> {
    /// Light of `world`.
    pub fn new(world: &'a World<'a>) -> Self {
        let scene = world.scene;
        let textures = Textures::new(scene);
        let looks = world.facets.iter().map(|f| look(world, &textures, f.surface, f.corners)).collect();
        let answers = world.surfaces.iter().map(|s| {
            let m = &scene.materials[s.material];
            let mean = m.base_color_texture.map_or([1.0; 4], |t| whole_mean(&textures, t));
            let of = |t: Option<TextureRef>| t.map_or([1.0; 4], |t| whole_mean(&textures, t));
            let (surface, occlusion) = (of(m.metallic_roughness_texture), of(m.occlusion_texture));
            let base = DVec3::from_slice(&m.base_color.map(f64::from)[..3]);
            Answer {
                model: m.model,
                metallic: f64::from(m.metallic * surface[2]).clamp(0.0, 1.0),
                roughness: f64::from(m.roughness * surface[1]).clamp(0.0, 1.0),
                occlusion: 1.0 + f64::from(m.occlusion_strength * (occlusion[0] - 1.0)),
                mean_base: base * DVec3::from_slice(&mean.map(f64::from)[..3]),
                follows_view: m.model == ShadingModel::MetallicRoughness,
            }
        });
        Self {
            world,
            looks,
            answers: answers.collect(),
            textures,
            lamps: Default::default(),
            frames: None,
            corners: Vec::new(),
            borders: [0; 2],
            shards: (0..SHARDS).map(|_| Shard::default()).collect(),
            shaded: Default::default(),
            shadow_lamps: 0,
            screen_lamps: Vec::new(),
            still: Tree::default(),
            moving: Vec::new(),
            screen: [DMat4::IDENTITY; 3],
            middle: Vec::new(),
            background: material::LUMINANCE.dot(wide(scene.background)),
        }
    }

    /// Moves on to the block of `clock`.
    ///
    /// # Errors
    /// A camera without a pose.
    pub fn prepare(&mut self, clock: &mut Clock, block: &Block) -> Result<(), Error> {
        let world = self.world;
        let frames = clock.ends()?;
        self.lamps = frames.each_ref().map(|f| material::lamps(world.scene, f, &world.moving_nodes));
        self.shadow_lamps = self.lamps[0].iter().filter(|l| l.casts_shadow).count();
        let first = self.corners.is_empty();
        for (index, surface) in world.surfaces.iter().enumerate() {
            let both = || frames.each_ref().map(|f| world.vertices(index as u32, f));
            if first {
                self.corners.push(both());
            } else if surface.moves {
                self.corners[index] = both();
            }
        }
        if self.shadow_lamps > 0 {
            self.prepare_shadows(clock, first)?;
        }
        self.frames = Some(frames);
        // At a jump, what held before the border does not hold after it.
        let key = |t: f64, after: bool| ((t * 16.0) as u64) << 1 | u64::from(after) | 1 << 63;
        self.borders = [key(block.start_us, block.jump), key(block.end_us, false)];
        for shard in &mut self.shards {
            let map = shard.get_mut().unwrap_or_else(std::sync::PoisonError::into_inner);
            map.retain(|key, _| key.border == 0 || self.borders.contains(&key.border));
        }
        Ok(())
    }

    /// What may throw shadows during the block of `clock`; `first` of all blocks also what never moves.
    fn prepare_shadows(&mut self, clock: &mut Clock, first: bool) -> Result<(), Error> {
        let world = self.world;
        let frames = clock.thirds()?;
        self.screen = frames.each_ref().map(|f| f.screen_from_world);
        let lamps: [Vec<Lamp>; 3] =
            frames.each_ref().map(|f| material::lamps(world.scene, f, &world.moving_nodes));
        self.screen_lamps.clear();
        for (index, lamp) in lamps[0].iter().enumerate().filter(|(_, l)| l.casts_shadow) {
            let (_, weight) = lamp.place();
            let h = [0, 1, 2].map(|k| {
                let place = lamps[k][index].place().0;
                if weight == 0.0 {
                    self.screen[k].transform_vector3(place)
                } else {
                    self.screen[k].transform_point3(place)
                }
            });
            self.screen_lamps.push(ScreenLamp::new(h, weight));
        }
        if first {
            let still = world.facets.iter().enumerate().filter_map(|(index, f)| {
                let surface = f.surface as usize;
                (!world.surfaces[surface].moves).then(|| {
                    let p = f.corners.map(|c| self.corners[surface][0][c as usize].0);
                    let low = p.into_iter().fold(DVec3::INFINITY, DVec3::min);
                    let high = p.into_iter().fold(DVec3::NEG_INFINITY, DVec3::max);
                    (low, high, index as u32)
                })
            });
            self.still = Tree::new(still);
            self.middle = vec![Corners::new(); world.surfaces.len()];
        }
        self.moving.clear();
        for (index, surface) in world.surfaces.iter().enumerate().filter(|(_, s)| s.moves) {
            self.middle[index] = world.vertices(index as u32, &frames[1]);
            let places = [&self.corners[index][0], &self.middle[index], &self.corners[index][1]];
            let mut facets = Vec::new();
            for cluster in &world.clusters[surface.clusters.clone()] {
                for facet in cluster.facets.clone() {
                    let points = world.facets[facet].corners.map(|c| places.map(|p| p[c as usize].0));
                    let all = || points.iter().flatten();
                    let low = all().fold(DVec3::INFINITY, |a, p| a.min(*p));
                    let high = all().fold(DVec3::NEG_INFINITY, |a, p| a.max(*p));
                    // An arc between the three places bulges by less than a quarter of its chord.
                    let travel = points.iter().map(|p| p[0].distance(p[2])).fold(0.0, f64::max);
                    facets.push((
                        0.5 * (low + high),
                        0.5 * (high - low).length() + 0.25 * travel,
                        facet as u32,
                    ));
                }
            }
            let count = facets.len().max(1) as f64;
            let centre = facets.iter().map(|f| f.0).sum::<DVec3>() / count;
            let radius = facets.iter().map(|f| f.0.distance(centre) + f.1).fold(0.0, f64::max);
            self.moving.push((centre, radius, facets));
        }
        Ok(())
    }

    /// Finds what may throw a shadow of each lamp into the part of a facet that a tile sees.
    fn find_occluders(
        &self,
        tile: &mut TileLight,
        slot: &mut Slot,
        receivers: &[Option<Fragment>; 3],
        record: &Record,
        [low, high]: [[f64; 2]; 2],
    ) {
        let facet = record.facet;
        let f = &self.world.facets[facet as usize];
        let surface = f.surface as usize;
        let lamps = 1 + self.shadow_lamps;
        let nodes = slot.count[0] * slot.count[1];
        let casting = |end: usize| self.lamps[end].iter().filter(|l| l.casts_shadow);
        for (number, (a, b)) in casting(0).zip(casting(1)).enumerate().take(MOST_SHADOWS) {
            let lit = |start: usize| {
                (0..nodes).any(|n| tile.nodes[start + n * lamps + 1 + number].iter().any(|v| *v != 0.0))
            };
            slot.shades[number] = Shade::default();
            if !lit(slot.at[0]) && !lit(slot.at[1]) {
                continue;
            }
            // A sphere about the part of the facet, at both ends.
            let mut points = [DVec3::ZERO; 8];
            for end in 0..2 {
                let corners = &self.corners[surface][end];
                let [p, q, _, r] = f.corners.map(|c| corners[c as usize].0);
                for k in 0..4 {
                    let s = if k & 1 == 0 { low[0] } else { high[0] };
                    let t = if k & 2 == 0 { low[1] } else { high[1] };
                    points[4 * end + k] = p + (q - p) * s + (r - p) * t;
                }
            }
            let middle = points.iter().sum::<DVec3>() / 8.0;
            let (from, weight) = a.place();
            let moved = from.distance(b.place().0);
            let radius = points.iter().map(|p| p.distance(middle)).fold(0.0, f64::max) * 1.01 + moved + 1e-6;
            tile.found.clear();
            let mut add = |id: u32| tile.found.push(id);
            match Beam::new(from, weight, middle, radius) {
                Some(beam) => {
                    self.still.within(&beam, &mut add);
                    for (centre, radius, facets) in &self.moving {
                        if beam.meets(*centre, *radius) {
                            facets.iter().filter(|f| beam.meets(f.0, f.1)).for_each(|f| add(f.2));
                        }
                    }
                }
                None => {
                    self.still.all(&mut add);
                    self.moving.iter().flat_map(|m| &m.2).for_each(|f| add(f.2));
                }
            }
            tile.found.sort_unstable();
            let start = tile.occluders.len();
            for k in 0..tile.found.len() {
                let id = tile.found[k];
                if id == facet || self.is_far_side(id, [a, b]) {
                    continue;
                }
                let occluder = self.occluder(id);
                let (touches, darkens) =
                    occluder.pixels(&self.screen_lamps[number], receivers, record.u, tile.centre);
                slot.shades[number].dark |= darkens;
                if touches != 0 {
                    tile.occluders.push((touches, occluder));
                }
            }
            slot.shades[number].from = start;
            slot.shades[number].to = tile.occluders.len();
            if slot.shades[number].dark == u64::MAX {
                tile.occluders.truncate(start);
                slot.shades[number].to = start;
            }
        }
    }

    /// Whether a facet of a solid faces away from a lamp outside of it: what it darkens, those that face the lamp darken.
    fn is_far_side(&self, facet: u32, lamps: [&Lamp; 2]) -> bool {
        let f = &self.world.facets[facet as usize];
        let surface = &self.world.surfaces[f.surface as usize];
        if !surface.closed || surface.masked {
            return false;
        }
        (0..2).all(|end| {
            let corners = &self.corners[f.surface as usize][end];
            let [p, q, _, r] = f.corners.map(|c| corners[c as usize].0);
            let (place, weight) = lamps[end].place();
            let inside = weight > 0.0 && {
                let pose = self.frames.as_ref().map(|f| f[end].world_from_node(surface.node));
                let own = pose.map_or(place, |p| p.inverse().transform_point3(place));
                surface.deforms || (own.cmpge(surface.bounds[0]) & own.cmple(surface.bounds[1])).all()
            };
            // Outwards, unless the pose mirrors.
            let normal = (q - p).cross(r - p);
            let mirrored = self.frames.as_ref().is_some_and(|f| {
                !surface.deforms && f[end].world_from_node(surface.node).determinant() < 0.0
            });
            let side = normal.dot(place - p * weight) * if mirrored { -1.0 } else { 1.0 };
            !inside && side < 0.0
        })
    }

    fn occluder(&self, facet: u32) -> Occluder {
        let f = &self.world.facets[facet as usize];
        let surface = f.surface as usize;
        let moves = self.world.surfaces[surface].moves;
        let ends = &self.corners[surface];
        let places = [&ends[0], if moves { &self.middle[surface] } else { &ends[0] }, &ends[1]];
        let h = f.corners.map(|c| {
            [0, 1, 2].map(|k| {
                let place = if moves { places[k] } else { places[0] };
                self.screen[k].transform_point3(place[c as usize].0)
            })
        });
        Occluder::new(facet, h)
    }

    /// Prepares `tile` for the tile at (column, row); an entry's light is gathered when a pixel first sees it.
    pub fn enter_tile(&self, tile: &mut TileLight, entries: &[Entry], [column, row]: [usize; 2]) {
        tile.slots.clear();
        tile.slots.resize(entries.len(), Slot::default());
        tile.nodes.clear();
        tile.occluders.clear();
        tile.centre = [column, row].map(|v| (v * TILE) as f64 + 0.5 * TILE as f64);
    }

    /// Gathers the light of an entry: `record`, number `index` of the block.
    fn gather(&self, tile: &mut TileLight, record: &Record, index: u32) -> Slot {
        let size = TILE as f64;
        let surface = self.world.facets[record.facet as usize].surface as usize;
        let mut slot = Slot { ready: true, ..Slot::default() };
        if self.answers[surface].model == ShadingModel::Unlit {
            let material = self.world.surfaces[surface].material;
            slot.unlit = [0, 1].map(|k| {
                let factors = self.frames.as_ref().map(|f| &f[k].state.emission_factor);
                f64::from(factors.and_then(|f| f.get(material)).copied().unwrap_or(1.0))
            });
            return slot;
        }
        // Where the tile sees the facet, in (s, t).
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        let mut front = true;
        let mut receivers: [Option<Fragment>; 3] = [None; 3];
        for (k, receiver) in receivers.iter_mut().enumerate() {
            let (v, near) = (0.5 * k as f64, self.world.lens.near);
            *receiver = Fragment::of_area(record, index, tile.centre, size, v, near);
            let Some(fragment) = receiver else { continue };
            front = fragment.front;
            let mut polygon = Polygon::PIXEL;
            for edge in fragment.crossing() {
                polygon = polygon.split(edge).0;
            }
            for corner in polygon.corners() {
                let (place, _) = fragment.parameters(*corner);
                for k in 0..2 {
                    let p = place[k].clamp(0.0, 1.0);
                    low[k] = low[k].min(p);
                    high[k] = high[k].max(p);
                }
            }
        }
        if low[0] > high[0] {
            (low, high) = ([0.0; 2], [1.0; 2]);
        }
        let level = [0, 1].map(|k| {
            let wanted = (1.0 / (high[k] - low[k]).max(1e-6)).log2().floor();
            (wanted.max(0.0) as u32).min(MOST_LEVEL)
        });
        let changes = self.changes(surface);
        let ends = if changes { 2 } else { 1 };
        let start = tile.nodes.len();
        for finer in 0..=MOST_FINER {
            tile.nodes.truncate(start);
            let level = level.map(|l| (l + finer).min(MOST_LEVEL));
            slot.intervals = level.map(|l| f64::from(1_u32 << l));
            let first = [0, 1].map(|k| (low[k] * slot.intervals[k]).floor().max(0.0));
            let last = [0, 1].map(|k| (high[k] * slot.intervals[k]).ceil().min(slot.intervals[k]));
            slot.first = first;
            slot.count = [0, 1].map(|k| ((last[k] - first[k]) as usize + 1).max(2));
            for k in 0..2 {
                // A grid of one interval has both its ends.
                if slot.first[k] + slot.count[k] as f64 - 1.0 > slot.intervals[k] {
                    slot.first[k] = slot.intervals[k] + 1.0 - slot.count[k] as f64;
                }
            }
            for end in 0..ends {
                slot.at[end] = tile.nodes.len();
                let border = if changes { self.borders[end] } else { 0 };
                for j in 0..slot.count[1] {
                    for i in 0..slot.count[0] {
                        let index = [slot.first[0] as u32 + i as u32, slot.first[1] as u32 + j as u32];
                        self.node(Key::new(record.facet, level, index, front, border), end, &mut tile.nodes);
                    }
                }
            }
            if !changes {
                slot.at[1] = slot.at[0];
            }
            let fine = level.iter().all(|l| *l == MOST_LEVEL) || finer == MOST_FINER;
            if fine || self.is_smooth(tile, &slot, record.facet, level, front) {
                break;
            }
        }
        if self.shadow_lamps > 0 {
            self.find_occluders(tile, &mut slot, &receivers, record, [low, high]);
        }
        slot
    }

    /// Whether light in the middle of each cell is what its corners say.
    fn is_smooth(&self, tile: &mut TileLight, slot: &Slot, facet: u32, level: [u32; 2], front: bool) -> bool {
        let surface = self.world.facets[facet as usize].surface as usize;
        let border = if slot.at[0] == slot.at[1] { 0 } else { self.borders[0] };
        let base = self.answers[surface].mean_base.max(DVec3::splat(0.05));
        let lamps = 1 + self.shadow_lamps;
        let luminance = |node: &[[f32; 4]]| -> f64 {
            let of = |v: &[f32; 4]| {
                base.dot(DVec3::new(f64::from(v[0]), f64::from(v[1]), f64::from(v[2]))) + f64::from(v[3])
            };
            node.iter().map(of).sum()
        };
        for j in 0..slot.count[1] - 1 {
            for i in 0..slot.count[0] - 1 {
                let corner = slot.at[0] + (j * slot.count[0] + i) * lamps;
                let offsets = [0, 1, slot.count[0], slot.count[0] + 1];
                let around = offsets.map(|o| luminance(&tile.nodes[corner + o * lamps..][..lamps]));
                let expected = 0.25 * around.iter().sum::<f64>();
                let index =
                    [2 * (slot.first[0] as u32 + i as u32) + 1, 2 * (slot.first[1] as u32 + j as u32) + 1];
                let key = Key::new(facet, level.map(|l| l + 1), index, front, border);
                let end = tile.nodes.len();
                self.node(key, 0, &mut tile.nodes);
                let found = luminance(&tile.nodes[end..]);
                tile.nodes.truncate(end);
                if (found - expected).abs() > SMOOTH * found.abs() {
                    return false;
                }
            }
        }
        true
    }

    fn changes(&self, surface: usize) -> bool {
        self.answers[surface].follows_view
            || self.world.surfaces[surface].moves
            || self.lamps[0].iter().any(|l| l.changes)
            || self.world.scene.materials[self.world.surfaces[surface].material].emission_waveform.is_some()
    }

    /// Appends the light of a node, shading it where nobody has.
    fn node(&self, key: Key, end: usize, out: &mut Vec<[f32; 4]>) {
        use std::hash::Hash;
        let mut hasher = Mix::default();
        key.hash(&mut hasher);
        let shard = &self.shards[(hasher.finish() >> 32) as usize % SHARDS];
        let lock = || shard.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if let Some(known) = lock().get(&key) {
            out.extend_from_slice(known);
            return;
        }
        let place = [0, 1].map(|k| f64::from(key.index[k]) / f64::from(1_u32 << key.level[k]));
        let node = self.shade(key.facet, place, key.level[2] == 1, end);
        out.extend_from_slice(&node);
        // Whoever comes second computes the same: nodes depend on their key alone.
        lock().insert(key, node);
    }

    fn shade(&self, facet: u32, [s, t]: [f64; 2], front: bool, end: usize) -> Node {
        self.shaded.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        let f = &self.world.facets[facet as usize];
        let surface = f.surface as usize;
        let corners = &self.corners[surface][end];
        let [a, b, _, d] = f.corners.map(|c| corners[c as usize]);
        let blend = |a: DVec3, b: DVec3, d: DVec3| a + (b - a) * s + (d - a) * t;
        let position = blend(a.0, b.0, d.0);
        let side = if front { 1.0 } else { -1.0 };
        let normal = blend(a.1, b.1, d.1).normalize_or(DVec3::Z) * side;
        let answer = &self.answers[surface];
        let material_index = self.world.surfaces[surface].material;
        let material = &self.world.scene.materials[material_index];
        let frame = self.frames.as_ref().map(|f| &f[end]);
        let factor = frame.and_then(|f| f.state.emission_factor.get(material_index)).copied().unwrap_or(1.0);
        let emissive = material.emissive_texture.map_or([1.0; 4], |t| whole_mean(&self.textures, t));
        let emission_factor = f64::from(factor);
        let point = Point {
            model: answer.model,
            position,
            normal,
            to_eye: frame.map_or(DVec3::Z, |f| (f.eye - position).normalize_or(DVec3::Z)),
            metallic: answer.metallic,
            roughness: answer.roughness,
            occlusion: answer.occlusion,
            emitted: wide(material.emissive)
                * DVec3::from_slice(&emissive.map(f64::from)[..3])
                * emission_factor,
            emission_factor,
            mean_base: answer.mean_base,
        };
        let mut responses = Vec::with_capacity(1 + self.shadow_lamps);
        respond(&point, &self.lamps[end], self.world.scene, &mut responses);
        let pack =
            |r: &Response| [r.linear.x as f32, r.linear.y as f32, r.linear.z as f32, r.constant as f32];
        responses.iter().map(pack).collect()
    }

    /// Luminance that `fragment`, entry `slot` of its tile, adds to a pixel by the part with `moments`, at `u` of the
    /// block.
    #[expect(clippy::too_many_arguments, reason = "a part of a pixel is three of them")]
    pub fn of_fragment(
        &self,
        tile: &mut TileLight,
        record: &Record,
        slot: usize,
        fragment: &Fragment,
        moments: &Moments,
        regions: Option<(&[Region], usize)>,
        pixel: [f64; 2],
        u: f64,
    ) -> f64 {
        let (centre, axes) = moments.footprint();
        let (place, change) = fragment.parameters(centre);
        let look = &self.looks[fragment.facet as usize];
        let mut base = look.base + look.base_along[0] * place[0] + look.base_along[1] * place[1];
        if let Some(texture) = look.texture {
            let to_texels = |v: [f64; 2]| [0, 1].map(|k| look.along[0][k] * v[0] + look.along[1][k] * v[1]);
            let at = to_texels(place);
            let at = [at[0] + look.origin[0], at[1] + look.origin[1]];
            let along =
                |axis: [f64; 2]| to_texels([0, 1].map(|k| change[0][k] * axis[0] + change[1][k] * axis[1]));
            let texel = self.textures.mean(texture, at, axes.map(along));
            base *= DVec3::new(f64::from(texel[0]), f64::from(texel[1]), f64::from(texel[2]));
        }
        if !tile.slots[slot].ready {
            tile.slots[slot] = self.gather(tile, record, fragment.record);
        }
        let slot = &tile.slots[slot].clone();
        if slot.count[0] == 0 {
            let factor = slot.unlit[0] + (slot.unlit[1] - slot.unlit[0]) * u;
            return moments.area * factor * material::LUMINANCE.dot(base);
        }
        let lamps = 1 + self.shadow_lamps;
        let mut sum = 0.0;
        for lamp in 0..lamps {
            let mut part = 1.0;
            if lamp > 0 && lamp <= MOST_SHADOWS {
                let shade = slot.shades[lamp - 1];
                let number = number_in_tile(pixel);
                if shade.dark >> number & 1 == 1 {
                    continue;
                }
                if shade.from < shade.to {
                    let occluders = &tile.occluders[shade.from..shade.to];
                    let screen = &self.screen_lamps[lamp - 1];
                    let near = occluders.iter().filter(|o| o.0 >> number & 1 == 1).map(|o| &o.1);
                    part = tile.lit.part(fragment, regions, near, screen, pixel, u);
                }
                if part == 0.0 {
                    continue;
                }
            }
            let r = self.interpolate(tile, slot, place, u, lamp, lamps).map(|v| v * part);
            sum += base.x * r[0] + base.y * r[1] + base.z * r[2] + r[3];
        }
        moments.area * sum
    }

    #[inline(always)]
    fn interpolate(
        &self,
        tile: &TileLight,
        slot: &Slot,
        place: [f64; 2],
        u: f64,
        lamp: usize,
        lamps: usize,
    ) -> [f64; 4] {
        let cell = |k: usize| {
            let at = (place[k] * slot.intervals[k] - slot.first[k]).clamp(0.0, (slot.count[k] - 1) as f64);
            let low = (at as usize).min(slot.count[k] - 2);
            (low, (at - low as f64) as f32)
        };
        let ((i, x), (j, y)) = (cell(0), cell(1));
        let corner = j * slot.count[0] + i;
        let weights = [(1.0 - x) * (1.0 - y), x * (1.0 - y), (1.0 - x) * y, x * y];
        let offsets = [0, 1, slot.count[0], slot.count[0] + 1];
        let at = |end: usize| {
            let mut sum = [0.0_f32; 4];
            for (offset, weight) in offsets.into_iter().zip(weights) {
                let node = &tile.nodes[(slot.at[end] + (corner + offset) * lamps) + lamp];
                for k in 0..4 {
                    sum[k] += weight * node[k];
                }
            }
            sum
        };
        let a = at(0);
        if slot.at[0] == slot.at[1] {
            return a.map(f64::from);
        }
        let b = at(1);
        [0, 1, 2, 3].map(|k| f64::from(a[k]) + (f64::from(b[k]) - f64::from(a[k])) * u)
    }

    /// Mean luminance of what lies behind everything, over a part of the pixel centred at `centre`.
    pub fn background(&self, centre: [f64; 2], moments: &Moments, u: f64) -> f64 {
        let environment = self.world.scene.environment.as_ref().filter(|e| e.visible);
        let (Some(environment), Some(frames)) = (environment, &self.frames) else { return self.background };
        let (at, axes) = moments.footprint();
        let at = [centre[0] + at[0], centre[1] + at[1]];
        let of = |frame: &Frame| {
            // The direction whose homogeneous image point is (x, y, 1).
            let matrix = glam::DMat3::from_mat4(frame.screen_from_world).inverse();
            let direction = matrix * DVec3::new(at[0], at[1], 1.0);
            let pixel = axes[0][0].max(axes[1][1]) / self.world.lens.focal[0];
            material::sky(environment, direction, pixel)
        };
        let (a, b) = (of(&frames[0]), of(&frames[1]));
        a + (b - a) * u
    }
}

/// Number in its tile of the pixel centred at `centre`.
fn number_in_tile([x, y]: [f64; 2]) -> usize {
    (y as usize % TILE) * TILE + x as usize % TILE
}

fn whole_mean(textures: &Textures, texture: TextureRef) -> [f32; 4] {
    textures.overall(texture.texture)
}

fn look(world: &World, textures: &Textures, surface: u32, corners: [u32; 4]) -> Look {
    let primitive = world.primitive(surface);
    let material = &world.scene.materials[world.surfaces[surface as usize].material];
    let [a, b, _, d] = corners.map(|c| c as usize);
    let base = |i: usize| {
        let color = primitive.colors.as_ref().and_then(|c| c.get(i)).copied().unwrap_or([1.0; 4]);
        let factor = material.base_color;
        DVec3::new(
            f64::from(factor[0] * color[0]),
            f64::from(factor[1] * color[1]),
            f64::from(factor[2] * color[2]),
        )
    };
    let mut look = Look {
        texture: None,
        origin: [0.0; 2],
        along: [[0.0; 2]; 2],
        base: base(a),
        base_along: [base(b) - base(a), base(d) - base(a)],
    };
    let Some(texture) = material.base_color_texture else { return look };
    let uvs = primitive.uvs.get(texture.uv_set as usize).and_then(Option::as_ref);
    let (Some(uvs), Some(size)) = (uvs, textures.size(texture.texture)) else { return look };
    let [m0, m1, m2, m3, m4, m5] = texture.transform.map(f64::from);
    let place = |i: usize| {
        let [u, v] = uvs.get(i).copied().unwrap_or_default().map(f64::from);
        [(m0 * u + m1 * v + m2) * size[0], (m3 * u + m4 * v + m5) * size[1]]
    };
    let (p, q, r) = (place(a), place(b), place(d));
    look.texture = Some(texture.texture);
    look.origin = p;
    look.along = [[q[0] - p[0], q[1] - p[1]], [r[0] - p[0], r[1] - p[1]]];
    look
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lists::Lists;

    #[test]
    fn no_facet_that_darkens_a_pixel_is_left_out() {
        let scene = evis_scene::builtin::load("warehouse", 0).unwrap();
        let world = World::new(&scene, 0, Some((96, 72))).unwrap();
        let block = Block { start_us: 630_784.0, end_us: 638_976.0, jump: false };
        let mut clock = Clock::new(&world, block);
        let lists = Lists::new(&world, &mut clock).unwrap();
        let mut lighting = Lighting::new(&world);
        lighting.prepare(&mut clock, &block).unwrap();
        let (mut compared, mut darkened, mut off, mut canary) = (0, 0, 0, 0);
        let mut tile = TileLight::default();
        let everything: Vec<Occluder> =
            (0..world.facets.len() as u32).map(|f| lighting.occluder(f)).collect();
        for (row, column) in (0..lists.row_count()).flat_map(|r| (0..lists.columns).map(move |c| (r, c))) {
            let entries = &lists.row(row)[column];
            lighting.enter_tile(&mut tile, entries, [column, row]);
            for entry in entries {
                let record = &lists.records[entry.record as usize];
                let slot = lighting.gather(&mut tile, record, entry.record);
                let pixel = (entry.touches.trailing_zeros() as usize * 5 + 3 * row) % 64;
                let lit = (0..slot.count[0] * slot.count[1])
                    .any(|n| tile.nodes[slot.at[0] + 2 * n + 1].iter().any(|v| *v != 0.0));
                if entry.touches >> pixel & 1 == 0 || !lit || (row + column) % 3 > 0 {
                    continue;
                }
                let centre = [column * TILE + pixel % 8, row * TILE + pixel / 8].map(|v| v as f64 + 0.5);
                for u in [0.3] {
                    let Some(fragment) = Fragment::new(record, entry.record, centre, u, world.lens.near)
                    else {
                        continue;
                    };
                    let shade = slot.shades[0];
                    let lamp = &lighting.screen_lamps[0];
                    let kept: Vec<&Occluder> = tile.occluders[shade.from..shade.to]
                        .iter()
                        .filter(|o| o.0 >> pixel & 1 == 1)
                        .map(|o| &o.1)
                        .collect();
                    let dark = shade.dark >> pixel & 1 == 1;
                    // Only the facet's own part: beyond it its plane may run through anything.
                    let polygon = fragment.crossing().iter().fold(Polygon::PIXEL, |p, e| p.split(e).0);
                    if polygon.moments().area < 0.05 {
                        continue;
                    }
                    let darkens = |o: &Occluder| {
                        let shadow = o.shadow(lamp, &fragment.inverse_depth, centre, 1.0, u);
                        let cut =
                            |s: crate::shadow::Shadow| s.lines().iter().fold(polygon, |p, l| p.split(l).0);
                        shadow.is_some_and(|s| cut(s).moments().area > 1e-4)
                    };
                    let missing: Vec<u32> = everything
                        .iter()
                        .filter(|o| !dark && o.facet != record.facet)
                        .filter(|o| {
                            !lighting.is_far_side(o.facet, [&lighting.lamps[0][0], &lighting.lamps[1][0]])
                        })
                        .filter(|o| kept.iter().all(|k| k.facet != o.facet) && darkens(o))
                        .map(|o| o.facet)
                        .collect();
                    assert!(missing.is_empty(), "facet {} at {centre:?} lacks {missing:?}", record.facet);
                    // Both sides of solids darken what the near ones do.
                    let part = |some: &mut dyn Iterator<Item = &Occluder>| {
                        let regions = [Region { fragment: Some(0), polygon }];
                        let some: Vec<Occluder> = some.cloned().collect();
                        Lit::default().part(&fragment, Some((&regions, 0)), some.iter(), lamp, centre, u)
                    };
                    let brute = part(&mut everything.iter().filter(|o| o.facet != record.facet));
                    let found = if dark { 0.0 } else { part(&mut kept.iter().copied()) };
                    off += usize::from((found - brute).abs() > 0.15);
                    canary += usize::from(!dark && kept[..kept.len() / 2].iter().any(|o| darkens(o)));
                    compared += 1;
                    darkened += usize::from(brute < 1.0);
                }
            }
        }
        println!("{compared} compared, {darkened} darkened, {off} off, {canary} notice a missing one");
        assert!(compared > 100 && darkened > 20 && canary > 3);
        // Areas of slivers are counted by few samples.
        assert!(off * 50 < compared, "{off} of {compared}");
    }
}
