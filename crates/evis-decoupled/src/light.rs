//! Light of surfaces: cells that live on facets, shaded when a tile first needs them.
//!
//! A facet has a grid of 2^i by 2^j cells over its (s, t); the level follows the facet's size on the screen, so that a
//! cell spans about a tile. A cell holds the surface's response to base colour, without shadows, at nodes as fine as
//! light bends; a texture is filtered, and shadows are found, when a pixel is evaluated. Cells whose light does not
//! depend on time or view are shaded once; all others at both ends of a block, and are linear between. What may throw
//! a shadow into a cell is found once, where lamp, surface and what throws it are still.

use std::collections::HashMap;
use std::hash::BuildHasher;
use std::sync::{Arc, Mutex, OnceLock};

use evis_scene::motion::{WaveShape, Waveform};
use evis_scene::{Light, LightFactors, Material, MaterialFactors, ShadingModel, TextureRef};
use glam::{DMat2, DMat3, DMat4, DVec2, DVec3};

use crate::Error;
use crate::blocks::{Block, Clock};
use crate::coverage::{Moments, Polygon, Polygons};
use crate::facets::{ALONE, Facet, bounding_box, wide};
use crate::fragment::{Line, Sight};
use crate::hash::Words;
use crate::keyframe::{self, Footprint, Keyframe, MOST_PLANES};
use crate::lists::{Entry, Record};
use crate::maps::{Map as TextureMap, MapReader, Maps};
use crate::material::{self, Around, Lamp, Point, Response, respond};
use crate::pages::{BEYOND_PX, Pages, Picture};
use crate::shadow::{Beam, Hull, Lit, Occluder, ScreenLamp, Tree, misses};
use crate::texture::{Cells, Textures};
use crate::tiles::{PIXELS, PixelFrame, TILE, TileView, change};
use crate::world::{Frame, World};

/// Most intervals of a facet's grid along an axis, as a power of two.
const MOST_LEVEL: u32 = 14;
/// A cell's nodes are made finer this often, where light bends between them.
const MOST_FINER: u32 = 3;
/// Part of the light by which the middle between nodes may be off.
const SMOOTH: f64 = 0.0015;
/// Part by which 1/depth may change over a pixel whose texture is averaged along edges that it shares with others.
const MOST_PERSPECTIVE: f64 = 0.015;
/// Places along either side of a footprint on a surface with maps, where there is no picture.
const PLACES: u32 = 4;
/// A tile as a pixel, where its side is the unit.
const WHOLE: PixelFrame = PixelFrame::square([0.0; 2]);
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
    /// Base colour changes along it.
    shaded: bool,
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
    /// Emitted luminance, and what it is multiplied by over time.
    glow: f64,
    waveform: Option<Waveform>,
    /// Then all of these vary from texel to texel.
    maps: Option<Mapped>,
}

/// What maps multiply.
#[derive(Clone, Debug)]
struct Mapped {
    maps: Maps,
    metallic: f64,
    roughness: f64,
    emissive: DVec3,
}

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
    /// Of cell `index` of a grid of 2^`level` cells along s and t.
    fn new(facet: u32, level: [u32; 2], index: [u32; 2], front: bool, border: u64) -> Self {
        let level = [level[0] as u8, level[1] as u8, u8::from(front)];
        Self { facet, level, index: index.map(|v| v as u16), border }
    }
}

type Map<T> = Mutex<HashMap<Key, Arc<T>, Words>>;

/// World corners and normals of a moving surface's vertices, at both ends of a block.
type Corners = Vec<(DVec3, DVec3)>;

/// Light of a cell of a facet's grid: responses at the nodes of a grid of its own.
struct Patch {
    /// Intervals along either side.
    intervals: u32,
    /// Row by row; at each node the response to unshadowed light, then to each lamp of [`Lighting::own`].
    nodes: Box<[[f32; 4]]>,
    /// Bits of the lamps of [`Lighting::own`] that light any of it.
    lit: u8,
}

/// What may throw shadows of one lamp into a cell of a still facet, of what is still.
struct Shadowed {
    /// One of them darkens all of it.
    dark: bool,
    facets: Box<[u32]>,
}

/// Light of a scene.
pub struct Lighting<'a> {
    world: &'a World<'a>,
    shared: Arc<Shared>,
    looks: Vec<Look>,
    answers: Vec<Answer>,
    /// Per material, as `looks` and `answers` have them.
    factors: Vec<MaterialFactors>,
    /// Per light, as kept cells were lit.
    lights: Vec<LightFactors>,
    /// Lamps and frames at both ends of the block.
    lamps: [Vec<Lamp>; 2],
    frames: Option<[Frame; 2]>,
    /// Indices of lamps whose light is kept apart: they throw shadows, or their strength changes.
    own: Vec<usize>,
    /// Per surface, vertices in the world at both ends; still ones are found once.
    corners: Vec<[Corners; 2]>,
    /// Per surface with maps, tangents and signs of bitangents, likewise.
    tangents: Vec<[Vec<(DVec3, f64)>; 2]>,
    borders: [u64; 2],
    patches: Vec<Map<Patch>>,
    shadowed: Vec<Map<Shadowed>>,
    /// Number of the block, from 1.
    block: u64,
    /// Nodes shaded so far.
    pub shaded: std::sync::atomic::AtomicU64,
    /// Per lamp of `own`, on the screen.
    screen_lamps: Vec<ScreenLamp>,
    /// Where it is in the world at the start, middle and end of the block.
    lamp_places: Vec<[DVec3; 3]>,
    /// Facets of still surfaces.
    still: Tree,
    /// Surfaces that move, and facets of each, within spheres that hold them throughout the block.
    moving: Tree,
    moving_facets: Vec<Tree>,
    /// Of each of them that keeps its shape, facets in its own space, and where that has lamps at the start, middle and end.
    own_facets: Vec<Tree>,
    own_lamps: Vec<Vec<[DVec3; 3]>>,
    /// Per facet, bits of lamps from which a solid's facet faces away: what it darkens, those that face the lamp darken.
    far: Vec<u8>,
    /// Per facet, bits of lamps that its front faces throughout the block, and of those that its back does.
    facing: Vec<[u8; 2]>,
    /// Per lamp of `own` and facet, made when they are first needed; of what is still.
    dark_spaces: [Vec<OnceLock<Box<Hull>>>; MOST_OWN],
    /// Per facet, made when it is first needed in a block.
    occluders: Vec<OnceLock<Box<Occluder>>>,
    /// Screen from world at the start, middle and end of the block, and of moving surfaces from their vertices.
    screen: [DMat4; 3],
    middle: Vec<Corners>,
    background: f64,
    camera_moves: bool,
}

/// Light of a tile's entries.
#[derive(Default)]
pub struct TileLight {
    slots: Vec<Slot>,
    patches: Vec<Arc<Patch>>,
    /// Facets of all slots and lamps, with the pixels that they may darken.
    occluders: Vec<(u64, u32)>,
    view: TileView,
    found: Vec<u32>,
    lit: Lit,
    /// By moment, slot and lamp: where in `lines` the half planes of its occluders begin, plus 1.
    line_starts: Vec<u32>,
    /// Half planes about the tile's centre.
    lines: Vec<[Line; 5]>,
    /// Whose pages are rendered, and these.
    pictures: Vec<Picture>,
    pages: Pages,
    /// The pixel in work is evaluated once: rendering pages would not pay.
    once: bool,
    /// By moment and slot: from the screen to its picture.
    warps: Vec<Option<DMat3>>,
    texels: CellMeans,
}

/// Means of a facet's texture over some pixels of a tile.
#[derive(Default)]
struct CellMeans {
    /// Corners of all pixels of a rectangle, on the texture.
    corners: Vec<DVec2>,
    /// Means over its pixels, row by row.
    cells: Cells,
    /// Which of them are wanted.
    pixels: u64,
    /// Column and row of the rectangle's first pixel in the tile.
    first: [usize; 2],
    columns: usize,
}

impl CellMeans {
    fn of(&self, pixel: usize) -> Option<[f32; 4]> {
        let [x, y] = [pixel % TILE, pixel / TILE];
        let known = self.pixels >> pixel & 1 == 1;
        known.then(|| self.cells.means[(y - self.first[1]) * self.columns + x - self.first[0]].to_array())
    }
}

impl TileLight {
    /// Says whether the next pixel is evaluated once only, and returns what was said before.
    pub fn enter_pixel(&mut self, once: bool) -> bool {
        std::mem::replace(&mut self.once, once)
    }
}

/// Occluders of a slot and a lamp, as a range.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Shade {
    from: usize,
    to: usize,
    /// Pixels of the tile that one of them darkens throughout the block.
    dark: u64,
    /// Pixels into which a shadow may come.
    touched: u64,
}

/// Most lamps whose light is kept apart, as there are bits in a byte; further ones throw no shadows.
pub const MOST_OWN: usize = 8;

/// What may throw shadows.
#[derive(Clone, Copy)]
enum Casters {
    Moving,
    Still,
}

#[derive(Clone, Copy, Debug, Default)]
struct Slot {
    /// The rest is filled in.
    ready: bool,
    /// The response is 1.
    unlit: bool,
    /// Cells of the facet's grid along s and t.
    cells: [f64; 2],
    /// First cell that is kept, and how many along s and t.
    first: [f64; 2],
    count: [usize; 2],
    /// First patch in [`TileLight::patches`], of the block's start and of its end.
    at: [usize; 2],
    /// Lamps of which some arrives.
    lit: u8,
    shades: [Shade; MOST_OWN],
    /// The highest frequency of a sine by which its light changes, in hertz of the scene's clock.
    sine_hz: f64,
    /// How far a shadow's edge moves in it during the block, in pixels.
    motion: f64,
    /// Pixels into which a shadow of what moves may come.
    moved: u64,
    /// Nothing else of it changes during the block.
    still: bool,
    /// Occluders are found.
    shaded: bool,
    /// The part of the facet that the tile sees.
    range: [[f64; 2]; 2],
    level: [u32; 2],
    /// Pixels that may see it.
    touches: u64,
    /// Whether it was decided on its picture, and its number in [`TileLight::pictures`].
    pictured: bool,
    picture: Option<u32>,
}

/// What all views of a scene share: its textures and its indirect light.
pub struct Shared {
    textures: Textures,
    around: Around,
}

impl Shared {
    /// That of `scene`.
    pub fn new(scene: &evis_scene::Scene) -> Arc<Self> {
        Arc::new(Self { textures: Textures::new(scene), around: Around::new(scene) })
    }
}

impl<'a> Lighting<'a> {
    /// Light of `world`; `shared` is of its scene.
    pub fn new(world: &'a World<'a>, shared: &Arc<Shared>) -> Self {
        let factors = world.scene.materials.iter().map(Material::factors).collect();
        let lights = world.scene.lights.iter().map(Light::factors).collect();
        Self::with_factors(world, shared, factors, lights)
    }

    /// As [`Lighting::new`], with these factors of the scene's materials and lights.
    fn with_factors(
        world: &'a World<'a>,
        shared: &Arc<Shared>,
        factors: Vec<MaterialFactors>,
        lights: Vec<LightFactors>,
    ) -> Self {
        let scene = world.scene;
        let textures = &shared.textures;
        let look = |f: &Facet| {
            let own = &factors[world.surfaces[f.surface as usize].material];
            look(world, textures, f.surface, f.corners, own.base_color)
        };
        let looks = world.facets.iter().map(look).collect();
        let answers = world.surfaces.iter().map(|s| {
            let (m, own) = (&scene.materials[s.material], &factors[s.material]);
            let mean = m.base_color_texture.map_or([1.0; 4], |t| whole_mean(textures, t));
            let of = |t: Option<TextureRef>| t.map_or([1.0; 4], |t| whole_mean(textures, t));
            let (surface, occlusion) = (of(m.metallic_roughness_texture), of(m.occlusion_texture));
            let base = wide(own.base_color);
            let glow = wide(own.emissive) * DVec3::from_slice(&of(m.emissive_texture).map(f64::from)[..3]);
            Answer {
                model: m.model,
                metallic: f64::from(own.metallic * surface[2]).clamp(0.0, 1.0),
                roughness: f64::from(own.roughness * surface[1]).clamp(0.0, 1.0),
                occlusion: 1.0 + f64::from(m.occlusion_strength * (occlusion[0] - 1.0)),
                mean_base: base * DVec3::from_slice(&mean.map(f64::from)[..3]),
                follows_view: m.model == ShadingModel::MetallicRoughness,
                glow: material::LUMINANCE.dot(glow),
                waveform: m.emission_waveform.filter(|w| !w.rests()),
                maps: Maps::of(m).filter(|_| m.model != ShadingModel::Unlit).map(|maps| Mapped {
                    maps,
                    metallic: f64::from(own.metallic),
                    roughness: f64::from(own.roughness),
                    emissive: wide(own.emissive),
                }),
            }
        });
        let answers = answers.collect();
        Self {
            world,
            looks,
            answers,
            factors,
            lights,
            shared: Arc::clone(shared),
            lamps: Default::default(),
            frames: None,
            own: Vec::new(),
            corners: Vec::new(),
            tangents: Vec::new(),
            borders: [0; 2],
            patches: (0..SHARDS).map(|_| Map::default()).collect(),
            shadowed: (0..SHARDS).map(|_| Map::default()).collect(),
            block: 0,
            shaded: Default::default(),
            screen_lamps: Vec::new(),
            lamp_places: Vec::new(),
            still: Tree::default(),
            moving: Tree::default(),
            moving_facets: Vec::new(),
            own_facets: Vec::new(),
            own_lamps: Vec::new(),
            far: vec![0; world.facets.len()],
            facing: vec![[0; 2]; world.facets.len()],
            dark_spaces: Default::default(),
            occluders: Vec::new(),
            screen: [DMat4::IDENTITY; 3],
            middle: Vec::new(),
            background: material::LUMINANCE.dot(wide(scene.background)),
            camera_moves: world.moving_nodes[scene.cameras[world.camera].node],
        }
    }

    /// Moves on to the block of `clock`.
    ///
    /// # Errors
    /// A camera without a pose.
    pub fn prepare(&mut self, clock: &mut Clock, block: &Block) -> Result<(), Error> {
        let world = self.world;
        self.block += 1;
        let frames = clock.ends()?;
        let state = &frames[0].state;
        if state.factors != self.factors || state.lights != self.lights {
            // What is kept of earlier blocks was lit as materials and lights were then.
            let (block, shaded) = (self.block, std::mem::take(&mut self.shaded));
            let (factors, lights) = (state.factors.clone(), state.lights.clone());
            let now = Self::with_factors(world, &Arc::clone(&self.shared), factors, lights);
            *self = Self { block, shaded, ..now };
        }
        self.lamps = frames.each_ref().map(|f| material::lamps(world.scene, f, &world.moving_nodes));
        let apart = |l: &Lamp| l.casts_shadow || l.waveform.is_some();
        self.own = (0..self.lamps[0].len()).filter(|k| apart(&self.lamps[0][*k])).take(MOST_OWN).collect();
        let first = self.corners.is_empty();
        for (index, surface) in world.surfaces.iter().enumerate() {
            let both = || frames.each_ref().map(|f| world.vertices(index as u32, f));
            let tangents = || match self.answers[index].maps {
                Some(_) => frames.each_ref().map(|f| world.tangents(index as u32, f)),
                None => Default::default(),
            };
            if first {
                self.corners.push(both());
                self.tangents.push(tangents());
            } else if surface.moves {
                self.corners[index] = both();
                self.tangents[index] = tangents();
            }
        }
        self.frames = Some(frames);
        self.prepare_shadows(clock, first)?;
        // At a jump, what held before the border does not hold after it.
        let key = |t: f64, after: bool| ((t * 16.0) as u64) << 1 | u64::from(after) | 1 << 63;
        self.borders = [key(block.start_us, block.jump), key(block.end_us, false)];
        for shard in &mut self.patches {
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
        self.lamp_places.clear();
        for &index in &self.own {
            let (_, weight) = lamps[0][index].place();
            let h = [0, 1, 2].map(|k| {
                let place = lamps[k][index].place().0;
                if weight == 0.0 {
                    self.screen[k].transform_vector3(place)
                } else {
                    self.screen[k].transform_point3(place)
                }
            });
            self.screen_lamps.push(ScreenLamp::new(h, weight));
            self.lamp_places.push([0, 1, 2].map(|k| lamps[k][index].place().0));
        }
        let shadows = self.own.iter().any(|k| self.lamps[0][*k].casts_shadow);
        if first {
            let still = world.facets.iter().enumerate().filter_map(|(index, f)| {
                let surface = f.surface as usize;
                (shadows && !world.surfaces[surface].moves).then(|| {
                    let (centre, radius) =
                        sphere(f.corners.map(|c| self.corners[surface][0][c as usize].0).into_iter());
                    (centre, radius, index as u32)
                })
            });
            self.still = Tree::new(still);
            for spaces in self.dark_spaces.iter_mut().take(if shadows { self.own.len() } else { 0 }) {
                spaces.resize_with(world.facets.len(), OnceLock::new);
            }
            self.middle = vec![Corners::new(); world.surfaces.len()];
            self.moving_facets.resize_with(world.surfaces.len(), Tree::default);
            self.own_facets.resize_with(world.surfaces.len(), Tree::default);
            self.own_lamps.resize_with(world.surfaces.len(), Vec::new);
        }
        self.moving = Tree::default();
        if !shadows {
            return Ok(());
        }
        self.occluders.clear();
        self.occluders.resize_with(world.facets.len(), OnceLock::new);
        let lamps_move = self.own.iter().any(|k| self.lamps[0][*k].moves);
        let mut moving = Vec::new();
        for (index, surface) in world.surfaces.iter().enumerate() {
            if first || lamps_move || surface.moves {
                self.find_far_sides(index);
            }
            if !surface.moves {
                continue;
            }
            self.middle[index] = world.vertices(index as u32, &frames[1]);
            let places = [&self.corners[index][0], &self.middle[index], &self.corners[index][1]];
            let facets = || world.clusters[surface.clusters.clone()].iter().flat_map(|c| c.facets.clone());
            let spheres = facets().map(|facet| {
                let points = world.facets[facet].corners.map(|c| places.map(|p| p[c as usize].0));
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
        Ok(())
    }

    /// Which sides of a surface's facets lamps see, and which facets of a solid face away from lamps outside of it.
    fn find_far_sides(&mut self, surface: usize) {
        let s = &self.world.surfaces[surface];
        let facets = self.world.clusters[s.clusters.clone()].iter().flat_map(|c| c.facets.clone());
        let Some(frames) = &self.frames else { return };
        let poses = [0, 1].map(|end| frames[end].world_from_node(s.node));
        let mirrored = poses.map(|p| !s.deforms && p.determinant() < 0.0);
        let inverse = poses.map(|p| p.inverse());
        let mut inside = 0_u8;
        for (number, &lamp) in self.own.iter().enumerate() {
            for (lamps, inverse) in self.lamps.iter().zip(&inverse) {
                let (place, weight) = lamps[lamp].place();
                let own = inverse.transform_point3(place);
                let within = s.deforms || (own.cmpge(s.bounds[0]) & own.cmple(s.bounds[1])).all();
                inside |= u8::from(weight > 0.0 && within) << number;
            }
        }
        for facet in facets {
            let mut facing = [0; 2];
            for (number, &lamp) in self.own.iter().enumerate() {
                let heights = [0, 1].map(|end| {
                    let corners = &self.corners[surface][end];
                    let [p, q, _, r] = self.world.facets[facet].corners.map(|c| corners[c as usize].0);
                    let (place, weight) = self.lamps[end][lamp].place();
                    // Outwards, unless the pose mirrors.
                    let normal = (q - p).cross(r - p);
                    normal.dot(place - p * weight) * if mirrored[end] { -1.0 } else { 1.0 }
                });
                facing[0] |= u8::from(heights.iter().all(|h| *h > 0.0)) << number;
                facing[1] |= u8::from(heights.iter().all(|h| *h < 0.0)) << number;
            }
            self.facing[facet] = facing;
            self.far[facet] = if s.closed { facing[1] & !inside } else { 0 };
        }
    }

    /// Bits of the edges of `facet` that are no silhouettes for lamp `number`: a neighbor that faces it alike continues the shadow.
    fn inner_edges(&self, facet: u32, number: usize) -> u8 {
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
    fn shadowed(&self, key: Key, number: usize) -> Arc<Shadowed> {
        let shard = &self.shadowed[shard_of(&key)];
        let lock = || shard.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if let Some(known) = lock().get(&key) {
            return known.clone();
        }
        let f = &self.world.facets[key.facet as usize];
        let surface = f.surface as usize;
        let corners = |facet: u32| {
            let f = &self.world.facets[facet as usize];
            f.corners.map(|c| self.corners[f.surface as usize][0][c as usize].0)
        };
        let [p, q, _, r] = f.corners.map(|c| self.corners[surface][0][c as usize].0);
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
        let middle = cell.iter().sum::<DVec3>() / 4.0;
        let radius = cell.iter().map(|c| c.distance(middle)).fold(0.0, f64::max) * 1.001 + 1e-6;
        let mut facets = Vec::new();
        let mut dark = false;
        let mut add = |id: u32| {
            if id == key.facet || self.far[id as usize] >> number & 1 == 1 {
                return;
            }
            let (touches, darkens) = crate::shadow::on_cell(corners(id), cell, place, weight);
            dark |= darkens;
            if touches {
                facets.push(id);
            }
        };
        match Beam::new(place, weight, middle, radius) {
            Some(beam) => self.still.within(|c, r| beam.meets(c, r), &mut add),
            None => self.still.all(&mut add),
        }
        facets.sort_unstable();
        if dark {
            facets.clear();
        }
        let found = Arc::new(Shadowed { dark, facets: facets.into() });
        lock().insert(key, found.clone());
        found
    }

    /// Finds which of the `casters` may throw a shadow of each lamp into the part of a facet that a tile sees. Those that
    /// move are asked for first.
    fn find_occluders(
        &self,
        tile: &mut TileLight,
        slot: &mut Slot,
        record: &Record,
        index: u32,
        casters: Casters,
    ) {
        let facet = record.facet;
        let f = &self.world.facets[facet as usize];
        let surface = f.surface as usize;
        let (mut receivers, mut tile_units, mut part) = (None, None, None);
        for (number, &lamp) in self.own.iter().enumerate() {
            let [a, b] = [0, 1].map(|end| &self.lamps[end][lamp]);
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
            // A sphere about the part of the facet, at both ends.
            let ends = [0, 1].map(|end| {
                let corners = &self.corners[surface][end];
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
            let hull = (resting && beam.is_some()).then(|| Hull::before(cell, from, weight));
            match casters {
                Casters::Moving => {
                    let meets = |centre: DVec3, radius: f64| {
                        beam.as_ref().is_none_or(|b| b.meets(centre, radius))
                            && hull.as_ref().is_none_or(|h| h.meets_sphere(centre, radius))
                    };
                    self.moving.within(meets, |other| {
                        let other = other as usize;
                        if other == surface && !self.own_facets[other].is_empty() {
                            self.find_own_occluders(facet, slot.range, number, weight, &mut tile.found);
                        } else {
                            self.moving_facets[other].within(meets, |id| tile.found.push(id));
                        }
                    });
                }
                Casters::Still => match (&hull, &beam) {
                    (Some(hull), _) => tile.found.retain(|id| {
                        let f = &self.world.facets[*id as usize];
                        let corners = &self.corners[f.surface as usize][0];
                        hull.meets(f.corners.map(|c| corners[c as usize].0))
                            && self.dark_space(*id, number).meets(cell)
                    }),
                    (None, _) if resting => {}
                    (None, Some(beam)) => {
                        self.still.within(|c, r| beam.meets(c, r), |id| tile.found.push(id))
                    }
                    (None, None) => self.still.all(|id| tile.found.push(id)),
                },
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
                if !resting {
                    let part = part.get_or_insert_with(|| self.part_of(facet, slot.range));
                    if misses(&self.places_of(id), part, &self.lamp_places[number], weight) {
                        continue;
                    }
                }
                let receivers = receivers.get_or_insert_with(|| {
                    // Where the tile does not see it, nothing is known.
                    let of = |s: Sight| s.at(index, &WHOLE, false).map(|f| f.inverse_depth);
                    self.receivers(record, &tile.view).map(|s| s.and_then(of))
                });
                let lamp = &self.screen_lamps[number];
                let view = tile_units.get_or_insert_with(|| tile.view.in_units_of(TILE as f64));
                let inner = self.inner_edges(id, number);
                let found = self.occluder(id).pixels(lamp, receivers, record.u, view, (slot.touches, inner));
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

    /// Finds which facets of a rigid surface may throw a shadow of lamp `number` on a part of another one of it: where nothing
    /// moves but the lamp.
    fn find_own_occluders(
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
    fn shadows_at_rest(
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
                let index = [slot.first[0] as u32 + i as u32, slot.first[1] as u32 + j as u32];
                let known = self.shadowed(Key::new(facet, slot.level, index, true, number as u64), number);
                all_dark &= known.dark;
                if let Casters::Still = casters {
                    tile.found.extend_from_slice(&known.facets);
                }
            }
        }
        all_dark
    }

    /// Pixels of a tile whose centres a facet covers at the start of its span.
    fn centres(&self, record: &Record, view: &TileView) -> u64 {
        Sight::new(record, view, 0.0, self.world.lens.near).map_or(0, |sight| sight.centres())
    }

    /// A facet as a tile sees it at the start, middle and end of its span, with the tile's side as unit.
    fn receivers(&self, record: &Record, view: &TileView) -> [Option<Sight>; 3] {
        let view = view.in_units_of(TILE as f64);
        [0.0, 0.5, 1.0].map(|v| Sight::new(record, &view, v, self.world.lens.near))
    }

    /// What a still facet hides from lamp `number`, which is still.
    fn dark_space(&self, facet: u32, number: usize) -> &Hull {
        self.dark_spaces[number][facet as usize].get_or_init(|| {
            let f = &self.world.facets[facet as usize];
            let corners = f.corners.map(|c| self.corners[f.surface as usize][0][c as usize].0);
            let (place, weight) = self.lamps[0][self.own[number]].place();
            Box::new(Hull::beyond(corners, place, weight))
        })
    }

    /// World corners of a facet at the start, middle and end of the block.
    fn places_of(&self, facet: u32) -> [[DVec3; 4]; 3] {
        let f = &self.world.facets[facet as usize];
        let surface = f.surface as usize;
        let ends = &self.corners[surface];
        let middle = if self.world.surfaces[surface].moves { &self.middle[surface] } else { &ends[0] };
        [&ends[0], middle, &ends[1]].map(|corners| f.corners.map(|c| corners[c as usize].0))
    }

    /// The same of the part of it in a range of (s, t).
    fn part_of(&self, facet: u32, range: [[f64; 2]; 2]) -> [[DVec3; 4]; 3] {
        let places = self.places_of(facet);
        let whole = range == [[0.0; 2], [1.0; 2]];
        if whole { places } else { places.map(|corners| part_between(corners, range)) }
    }

    fn occluder(&self, facet: u32) -> &Occluder {
        self.occluders[facet as usize].get_or_init(|| Box::new(self.new_occluder(facet)))
    }

    fn new_occluder(&self, facet: u32) -> Occluder {
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
    pub fn enter_tile(&self, tile: &mut TileLight, entries: &[Entry], place: [usize; 2]) {
        tile.slots.clear();
        tile.slots.extend(entries.iter().map(|e| Slot { touches: e.touches, ..Slot::default() }));
        tile.pictures.clear();
        tile.pages.enter_tile(self.block);
        tile.warps.clear();
        tile.patches.clear();
        tile.occluders.clear();
        tile.line_starts.clear();
        tile.lines.clear();
        tile.view = self.world.tile(place);
    }

    /// Gathers the light of entry `slot` of a tile, which is `record`, number `index` of the block.
    pub fn ready(&self, tile: &mut TileLight, record: &Record, index: u32, slot: usize) {
        if !tile.slots[slot].ready {
            tile.slots[slot] = self.gather(tile, record, index, tile.slots[slot].touches);
        }
    }

    /// Finds what throws shadows on entry `slot`, and where its light is rendered; before its light is asked for.
    #[inline(always)]
    pub fn shade_slot(&self, tile: &mut TileLight, record: &Record, index: u32, slot: usize) {
        if !tile.slots[slot].shaded {
            let mut own = tile.slots[slot];
            self.find_occluders(tile, &mut own, record, index, Casters::Still);
            own.shaded = true;
            tile.slots[slot] = own;
        }
        if !tile.slots[slot].pictured && !tile.once {
            tile.slots[slot].pictured = true;
            tile.slots[slot].picture = self.picture(tile, record, index);
        }
    }

    /// Whether nothing of entry `slot` changes during the block but for where it is seen, and by shadows of what moves; how
    /// far in pixels these move, and on which pixels.
    pub fn changes_of(&self, tile: &TileLight, slot: usize) -> (bool, f64, u64) {
        let slot = &tile.slots[slot];
        (slot.still, slot.motion, slot.moved)
    }

    /// The highest frequency of a sine by which light of entry `slot` changes, in hertz of the scene's clock.
    pub fn sine_hz(&self, tile: &TileLight, slot: usize) -> f64 {
        tile.slots[slot].sine_hz
    }

    fn gather(&self, tile: &mut TileLight, record: &Record, index: u32, touches: u64) -> Slot {
        let surface = self.world.facets[record.facet as usize].surface as usize;
        let answer = &self.answers[surface];
        let mut slot = Slot { ready: true, still: answer.waveform.is_none(), touches, ..Slot::default() };
        slot.sine_hz = sine_hz(answer.waveform);
        if answer.model == ShadingModel::Unlit {
            slot.unlit = true;
            slot.shaded = true;
            return slot;
        }
        // Where the tile sees the facet, in (s, t).
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        let mut front = true;
        for sight in self.receivers(record, &tile.view).into_iter().flatten() {
            let Some(fragment) = sight.at(index, &WHOLE, false) else { continue };
            front = sight.front;
            for corner in Polygon::within(fragment.crossing()).corners() {
                let place = sight.place(*corner);
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
        slot.cells = level.map(|l| f64::from(1_u32 << l));
        slot.first = [0, 1].map(|k| (low[k] * slot.cells[k]).floor().min(slot.cells[k] - 1.0));
        slot.count = [0, 1].map(|k| {
            let last = (high[k] * slot.cells[k]).ceil().min(slot.cells[k]) - 1.0;
            (last - slot.first[k]).max(0.0) as usize + 1
        });
        let changes = self.changes(surface);
        slot.still &= !changes;
        let mapped = answer.maps.is_some();
        if mapped {
            // A normal map may face any lamp.
            slot.lit = ((1_u16 << self.own.len()) - 1) as u8;
        }
        for end in 0..if mapped { 0 } else { self.ends(surface) } {
            slot.at[end] = tile.patches.len();
            let border = if changes { self.borders[end] } else { 0 };
            for j in 0..slot.count[1] {
                for i in 0..slot.count[0] {
                    let index = [slot.first[0] as u32 + i as u32, slot.first[1] as u32 + j as u32];
                    let patch = self.patch(Key::new(record.facet, level, index, front, border), end);
                    slot.lit |= patch.lit;
                    tile.patches.push(patch);
                }
            }
        }
        if !changes {
            slot.at[1] = slot.at[0];
        }
        for (number, &lamp) in self.own.iter().enumerate() {
            if slot.lit >> number & 1 == 1 {
                let waveform = self.lamps[0][lamp].waveform;
                slot.still &= waveform.is_none();
                slot.sine_hz = slot.sine_hz.max(sine_hz(waveform));
            }
        }
        (slot.range, slot.level) = ([low, high], level);
        slot.shaded = slot.lit == 0;
        if !slot.shaded && !self.moving.is_empty() {
            self.find_occluders(tile, &mut slot, record, index, Casters::Moving);
        }
        slot
    }

    /// Of how many ends of a block light is kept apart.
    fn ends(&self, surface: usize) -> usize {
        if self.changes(surface) { 2 } else { 1 }
    }

    fn changes(&self, surface: usize) -> bool {
        self.answers[surface].follows_view && self.camera_moves
            || self.world.surfaces[surface].moves
            || self.lamps[0].iter().any(|l| l.moves)
    }

    /// Light of a cell, shaded where nobody has.
    fn patch(&self, key: Key, end: usize) -> Arc<Patch> {
        let shard = &self.patches[shard_of(&key)];
        let lock = || shard.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if let Some(known) = lock().get(&key) {
            return known.clone();
        }
        // Whoever comes second computes the same: a cell's light depends on its key alone.
        let patch = Arc::new(self.shade_patch(&key, end));
        lock().insert(key, patch.clone());
        patch
    }

    /// Shades a cell at ever more nodes, until light in the middle between nodes is what these say.
    fn shade_patch(&self, key: &Key, end: usize) -> Patch {
        let lamps = 1 + self.own.len();
        let surface = self.world.facets[key.facet as usize].surface as usize;
        let base = self.answers[surface].mean_base.max(DVec3::splat(0.05));
        let luminance = |node: &[[f32; 4]]| -> f64 {
            let of = |v: &[f32; 4]| {
                base.dot(DVec3::new(f64::from(v[0]), f64::from(v[1]), f64::from(v[2]))) + f64::from(v[3])
            };
            node.iter().map(of).sum()
        };
        let shade = |x: f64, y: f64, out: &mut Vec<[f32; 4]>| {
            let place =
                [0, 1].map(|k| (f64::from(key.index[k]) + [x, y][k]) / f64::from(1_u32 << key.level[k]));
            self.shade(key.facet, place, key.level[2] == 1, end, out);
        };
        let (mut nodes, mut middles) = (Vec::new(), Vec::new());
        let mut intervals = 1_u32;
        for finer in 0..=MOST_FINER {
            intervals = 1 << finer;
            let step = 1.0 / f64::from(intervals);
            nodes.clear();
            for j in 0..=intervals {
                for i in 0..=intervals {
                    shade(f64::from(i) * step, f64::from(j) * step, &mut nodes);
                }
            }
            if finer == MOST_FINER {
                break;
            }
            middles.clear();
            let mut smooth = true;
            for cell in 0..intervals * intervals {
                let (i, j) = (cell % intervals, cell / intervals);
                middles.clear();
                shade((f64::from(i) + 0.5) * step, (f64::from(j) + 0.5) * step, &mut middles);
                let found = luminance(&middles);
                let row = intervals + 1;
                let around = [0, 1, row, row + 1].map(|o| {
                    let at = (j * row + i + o) as usize * lamps;
                    luminance(&nodes[at..at + lamps])
                });
                let expected = 0.25 * around.iter().sum::<f64>();
                if (found - expected).abs() > SMOOTH * found.abs() {
                    smooth = false;
                    break;
                }
            }
            if smooth {
                break;
            }
        }
        let mut lit = 0;
        for (k, value) in nodes.iter().enumerate() {
            if !k.is_multiple_of(lamps) && value.iter().any(|v| *v != 0.0) {
                lit |= 1 << (k % lamps - 1);
            }
        }
        Patch { intervals, nodes: nodes.into(), lit }
    }

    fn shade(&self, facet: u32, place: [f64; 2], front: bool, end: usize, out: &mut Vec<[f32; 4]>) {
        self.shaded.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        let point = self.point(facet, place, front, end);
        let pack =
            |r: &Response| [r.linear.x as f32, r.linear.y as f32, r.linear.z as f32, r.constant as f32];
        let mut responses = [Response::default(); 1 + MOST_OWN];
        respond(&point, &self.lamps[end], &self.own, &self.shared.around, &mut responses);
        out.extend(responses[..1 + self.own.len()].iter().map(pack));
    }

    /// A place (s, t) of a facet at an end of the block, without what maps say.
    fn point(&self, facet: u32, [s, t]: [f64; 2], front: bool, end: usize) -> Point {
        let f = &self.world.facets[facet as usize];
        let surface = f.surface as usize;
        let corners = &self.corners[surface][end];
        let [a, b, _, d] = f.corners.map(|c| corners[c as usize]);
        let blend = |a: DVec3, b: DVec3, d: DVec3| a + (b - a) * s + (d - a) * t;
        let position = blend(a.0, b.0, d.0);
        let side = if front { 1.0 } else { -1.0 };
        let answer = &self.answers[surface];
        let frame = self.frames.as_ref().map(|f| &f[end]);
        Point {
            model: answer.model,
            position,
            normal: blend(a.1, b.1, d.1).normalize_or(DVec3::Z) * side,
            to_eye: frame.map_or(DVec3::Z, |f| (f.eye - position).normalize_or(DVec3::Z)),
            metallic: answer.metallic,
            roughness: answer.roughness,
            occlusion: answer.occlusion,
            mean_base: answer.mean_base,
        }
    }

    /// Light of a facet with maps at (s, t): of all channels, at one end of the block or both.
    fn shade_maps(
        &self,
        facet: u32,
        (mapped, maps): (&Mapped, &MapReader),
        place: [f64; 2],
        front: bool,
        out: &mut [[f32; 4]; MOST_PLANES],
    ) {
        let f = &self.world.facets[facet as usize];
        let surface = f.surface as usize;
        let look = &self.looks[facet as usize];
        let texels = maps.at(DVec2::from_array(place));
        let base = (look.base + look.base_along[0] * place[0] + look.base_along[1] * place[1]) * texels.base;
        let glow = material::LUMINANCE.dot(mapped.emissive * texels.emission);
        let (lamps, channels) = (self.own.len(), self.channels(surface));
        let planes = channels.div_ceil(4);
        for end in 0..self.ends(surface) {
            self.shaded.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            let mut point = self.point(facet, place, front, end);
            point.metallic = (mapped.metallic * texels.metallic).clamp(0.0, 1.0);
            point.roughness = (mapped.roughness * texels.roughness).clamp(0.0, 1.0);
            (point.occlusion, point.mean_base) = (texels.occlusion, base);
            if let (Some(local), [tangent, bitangent]) =
                (texels.normal, self.tangent_frame(f, place, end, point.normal, front))
                && tangent != DVec3::ZERO
            {
                let side = if front { 1.0 } else { -1.0 };
                let mapped = tangent * local.x + bitangent * local.y + point.normal * (side * local.z);
                point.normal = mapped.normalize_or(point.normal * side) * side;
            }
            let mut responses = [Response::default(); 1 + MOST_OWN];
            respond(&point, &self.lamps[end], &self.own, &self.shared.around, &mut responses);
            let mut set =
                |channel: usize, value: f64| out[end * planes + channel / 4][channel % 4] = value as f32;
            let mut diffuse = 0.0;
            for (channel, response) in responses[..=lamps].iter().enumerate() {
                let proportional = response.linear.dot(base);
                diffuse += proportional;
                set(channel, proportional + response.constant);
            }
            set(channels - 2, material::LUMINANCE.dot(base));
            set(channels - 1, diffuse);
            if channels > lamps + 3 {
                set(lamps + 1, glow);
            } else {
                out[end * planes][0] += glow as f32;
            }
        }
    }

    /// Unit tangent and bitangent at a place of `facet` with the unit normal `normal` to the viewer's side; zeros where it has
    /// none.
    fn tangent_frame(
        &self,
        facet: &Facet,
        [s, t]: [f64; 2],
        end: usize,
        normal: DVec3,
        front: bool,
    ) -> [DVec3; 2] {
        let tangents = &self.tangents[facet.surface as usize][end];
        let of = |c: u32| tangents.get(c as usize).copied().unwrap_or_default();
        let [a, b, _, d] = facet.corners.map(of);
        let normal = if front { normal } else { -normal };
        let tangent = a.0 + (b.0 - a.0) * s + (d.0 - a.0) * t;
        let tangent = (tangent - normal * normal.dot(tangent)).normalize_or_zero();
        [tangent, normal.cross(tangent) * (a.1 + (b.1 - a.1) * s + (d.1 - a.1) * t)]
    }

    /// Values that light of a surface with maps has: of what no shadow falls on, of each of [`Lighting::own`], of its own glow
    /// where that changes, the luminance of its base colour, and what of all light is proportional to that.
    fn channels(&self, surface: usize) -> usize {
        3 + self.own.len() + usize::from(self.answers[surface].waveform.is_some())
    }

    /// Half planes of the shadows that fall on entry `slot` from lamp `number` at `moment` of the tile: a range.
    fn shadow_lines(
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

    /// Where light of entry `slot`, which is `record`, number `index` of the block, is rendered, if it has maps.
    fn picture(&self, tile: &mut TileLight, record: &Record, index: u32) -> Option<u32> {
        let surface = self.world.facets[record.facet as usize].surface as usize;
        self.answers[surface].maps.as_ref()?;
        tile.pictures.push(Picture::new(record, index, self.world.seen(), self.world.lens.near)?);
        Some(tile.pictures.len() as u32 - 1)
    }

    /// Where the part's footprint lies on its picture at a moment, and that picture; `None` where it has none.
    #[inline(always)]
    fn footprint(&self, tile: &mut TileLight, part: &Part, moment: usize) -> Option<(Footprint, Picture)> {
        let number = tile.slots[part.slot].picture.filter(|_| !tile.once)?;
        let picture = tile.pictures[number as usize];
        let index = moment * tile.slots.len() + part.slot;
        if tile.warps.len() <= index {
            tile.warps.resize((moment + 1) * tile.slots.len(), None);
        }
        let warp =
            tile.warps[index].get_or_insert_with(|| picture.image_from_facet * part.sight.facet_from_image());
        let (centre, moments) = part.moments.central();
        let place = DVec2::from_array(part.frame.point(centre));
        Some((Footprint::under(warp, place, part.frame.moments(moments))?, picture))
    }

    /// Renders a page of the light of a facet with maps.
    fn light_page(
        &self,
        facet: u32,
        mapped: &Mapped,
        picture: &Picture,
        rect: [f64; 4],
        sums: &mut Vec<[f32; 4]>,
    ) -> Option<Keyframe> {
        let f = &self.world.facets[facet as usize];
        let maps = mapped.maps.on(&self.shared.textures, self.world.primitive(f.surface), f.corners);
        let surface = f.surface as usize;
        let planes = self.channels(surface).div_ceil(4) * self.ends(surface);
        // Footprints reach a little beyond the facet.
        let outline = f.outline(self.world.primitive(f.surface));
        let lines = keyframe::outline(&picture.image_from_facet, &outline, BEYOND_PX);
        let mut reader = None;
        let shade = |place: [f64; 2], area: f64, out: &mut [[f32; 4]; MOST_PLANES]| {
            let reader = reader.get_or_insert_with(|| maps.reader(&self.shared.textures, area));
            self.shade_maps(facet, (mapped, reader), place, picture.front, out);
        };
        Keyframe::of_light(picture.image_from_facet, (maps.finest(), &lines), rect, planes, sums, shade)
    }

    /// Luminance per area of entry `part.slot` with maps over `part.moments`; `base` is the mean of its base colour there, where a
    /// texture says so.
    ///
    /// Cells are too few for the detail of a texture. So what they have of its luminance is replaced by its exact mean, in the
    /// part of the light that is proportional to it (a control variate).
    fn of_maps(
        &self,
        tile: &mut TileLight,
        mapped: &Mapped,
        part: &Part,
        at: &Instant,
        base: Option<DVec3>,
    ) -> f64 {
        let facet = part.sight.facet;
        let surface = self.world.facets[facet as usize].surface as usize;
        let (ends, channels) = (self.ends(surface), self.channels(surface));
        let groups = channels.div_ceil(4);
        let pictured = self.footprint(tile, part, at.moment).and_then(|(footprint, picture)| {
            let render = |rect: [f64; 4], sums: &mut Vec<[f32; 4]>| {
                self.light_page(facet, mapped, &picture, rect, sums)
            };
            let (page, sums) = tile.pages.about(&picture, footprint.at, render)?;
            let mut planes = [[0.0; 4]; MOST_PLANES];
            match ends * groups {
                1 => planes[..1].copy_from_slice(&page.means::<1>(sums, &footprint)?),
                2 => planes[..2].copy_from_slice(&page.means::<2>(sums, &footprint)?),
                3 => planes[..3].copy_from_slice(&page.means::<3>(sums, &footprint)?),
                4 => planes[..4].copy_from_slice(&page.means::<4>(sums, &footprint)?),
                _ => planes = page.means::<MOST_PLANES>(sums, &footprint)?,
            }
            Some(planes)
        });
        let planes = pictured.unwrap_or_else(|| self.maps_in_places(mapped, part));
        let value = |channel: usize| {
            let of = |end: usize| f64::from(planes[end * groups + channel / 4][channel % 4]);
            if ends == 1 { of(0) } else { of(0) + (of(1) - of(0)) * at.u }
        };
        let mut sum = value(0);
        let mut whole = sum;
        for number in 0..self.own.len() {
            let light = value(1 + number);
            whole += light;
            if light > 0.0 {
                sum += self.arriving(tile, part, at, number) * light;
            }
        }
        let [luma, diffuse] = [channels - 2, channels - 1].map(value);
        if let Some(base) = base
            && luma > 0.0
            && whole > 0.0
        {
            let off = (material::LUMINANCE.dot(base) / luma - 1.0).clamp(-0.5, 1.0);
            sum *= 1.0 + off * (diffuse / whole).clamp(0.0, 1.0);
        }
        if let Some(waveform) = self.answers[surface].waveform {
            sum += waveform.factor(at.t_s) * value(1 + self.own.len());
        }
        sum
    }

    /// The same where there is no picture: the mean over a grid of places.
    fn maps_in_places(&self, mapped: &Mapped, part: &Part) -> [[f32; 4]; MOST_PLANES] {
        let facet = part.sight.facet;
        let f = &self.world.facets[facet as usize];
        let maps = mapped.maps.on(&self.shared.textures, self.world.primitive(f.surface), f.corners);
        let (centre, axes) = part.moments.footprint();
        let (place, change) = part.sight.parameters(part.frame.point(centre));
        let axes = axes.map(|axis| part.frame.vector(axis));
        let along = DMat2::from_cols_array_2d(&change) * DMat2::from_cols_array_2d(&axes);
        let count = f64::from(PLACES * PLACES);
        let maps = maps.reader(&self.shared.textures, along.determinant().abs() / count);
        let mut sum = [[0.0; 4]; MOST_PLANES];
        for k in 0..PLACES * PLACES {
            let step = |k: u32| (f64::from(k) + 0.5) / f64::from(PLACES) - 0.5;
            let at = DVec2::from_array(place) + along * DVec2::new(step(k % PLACES), step(k / PLACES));
            let mut planes = [[0.0; 4]; MOST_PLANES];
            self.shade_maps(facet, (mapped, &maps), at.to_array(), part.sight.front, &mut planes);
            for (sum, value) in sum.as_flattened_mut().iter_mut().zip(planes.as_flattened()) {
                *sum += value / count as f32;
            }
        }
        sum
    }

    /// What of lamp `number`'s light arrives on a part: its strength times the part that no shadow reaches.
    #[inline(always)]
    fn arriving(&self, tile: &mut TileLight, part: &Part, at: &Instant, number: usize) -> f64 {
        let slot = part.slot;
        let lamp = &self.lamps[0][self.own[number]];
        let strength = lamp.waveform.map_or(1.0, |w| w.factor(at.t_s));
        let shade = tile.slots[slot].shades[number];
        if shade.dark >> part.pixel & 1 == 1 {
            return 0.0;
        }
        if shade.touched >> part.pixel & 1 == 0 {
            return strength;
        }
        let start = self.shadow_lines(tile, slot, number, at.moment, part.sight, at.u);
        let near = tile.occluders[shade.from..shade.to].iter().zip(&tile.lines[start..]);
        let near = near.filter(|(o, _)| o.0 >> part.pixel & 1 == 1).map(|(_, lines)| lines);
        strength * tile.lit.part(part.regions, near, &part.frame)
    }

    /// Mean of the texture of entry `part.slot` over `part.moments`.
    #[inline(always)]
    fn texel(&self, part: &Part, texture: usize) -> [f32; 4] {
        let look = &self.looks[part.sight.facet as usize];
        let (centre, axes) = part.moments.footprint();
        let (place, change) = part.sight.parameters(part.frame.point(centre));
        let to_texels = |v: [f64; 2]| [0, 1].map(|k| look.along[0][k] * v[0] + look.along[1][k] * v[1]);
        let at = to_texels(place);
        let at = [at[0] + look.origin[0], at[1] + look.origin[1]];
        let along =
            |axis: [f64; 2]| to_texels([0, 1].map(|k| change[0][k] * axis[0] + change[1][k] * axis[1]));
        self.shared.textures.mean(texture, at, axes.map(|axis| along(part.frame.vector(axis))))
    }

    /// Luminance of the `pixels` of a tile that see nothing but entry `slot`, which is `sight` at `at`.
    pub fn of_pixels(
        &self,
        tile: &mut TileLight,
        (slot, sight): (usize, &Sight),
        pixels: u64,
        at: &Instant,
        out: &mut [f64; PIXELS],
    ) {
        self.find_cells(tile, sight, pixels);
        for pixel in bits(pixels) {
            let frame = tile.view.pixel(pixel);
            let part = Part { slot, sight, moments: &Moments::PIXEL, regions: None, pixel, frame };
            let texel = tile.texels.of(pixel);
            out[pixel] = self.luminance(tile, &part, at, texel);
        }
    }

    /// Finds means of a facet's texture over `pixels`, which share their edges, unless it has none.
    fn find_cells(&self, tile: &mut TileLight, sight: &Sight, pixels: u64) {
        tile.texels.pixels = 0;
        let facet = sight.facet as usize;
        let look = &self.looks[facet];
        let Some(texture) = look.texture else { return };
        let columns_of = bits(pixels).fold(0_u64, |m, pixel| m | 1 << (pixel % TILE));
        let [left, right] = [columns_of.trailing_zeros(), 64 - columns_of.leading_zeros()];
        let [top, bottom] = [pixels.trailing_zeros(), 63 - pixels.leading_zeros()].map(|v| v / TILE as u32);
        let [columns, rows] = [right - left, bottom + 1 - top].map(|v| v as usize);
        if (pixels.count_ones() as usize) * 2 < columns * rows {
            return;
        }
        let [along_s, along_t] = look.along.map(|v| DVec3::new(v[0], v[1], 0.0));
        let texels = DMat3::from_cols(along_s, along_t, DVec3::new(look.origin[0], look.origin[1], 1.0));
        let texels_from_image = texels * sight.facet_from_image();
        let half = 0.5 * TILE as f64;
        let first = DVec2::new(f64::from(left), f64::from(top)) - half;
        let last = first + DVec2::new(columns as f64, rows as f64);
        // Pixels are smallest on the texture where it is nearest.
        let corners = [[first.x, first.y], [last.x, first.y], [first.x, last.y], [last.x, last.y]];
        let depth = &sight.inverse_depth;
        let [nearest, farthest] = [f64::total_cmp, |a: &f64, b: &f64| b.total_cmp(a)].map(|order| {
            corners.into_iter().max_by(|a, b| order(&depth.at(*a), &depth.at(*b))).unwrap_or_default()
        });
        // A mean over a part of the texture counts what is farther away more than one over the pixel does.
        if 2.0 * depth.reach() > MOST_PERSPECTIVE * depth.at(farthest) {
            return;
        }
        let pixel = change(&texels_from_image, nearest);
        let cells = &mut tile.texels;
        cells.corners.clear();
        for j in 0..=rows {
            for i in 0..=columns {
                let [x, y] = tile.view.corner(left as usize + i, top as usize + j);
                let h = texels_from_image * DVec3::new(x, y, 1.0);
                cells.corners.push(DVec2::new(h.x, h.y) / h.z);
            }
        }
        let axes = [pixel.x_axis.to_array(), pixel.y_axis.to_array()];
        let textures = &self.shared.textures;
        if textures.cells(texture, &cells.corners, columns, axes, &mut cells.cells).is_some() {
            (cells.pixels, cells.first, cells.columns) = (pixels, [left as usize, top as usize], columns);
        }
    }

    /// Luminance that a facet, entry `part.slot` of its tile, adds to a pixel.
    pub fn of_part(&self, tile: &mut TileLight, part: &Part, at: &Instant) -> f64 {
        self.luminance(tile, part, at, None)
    }

    /// The same; `texel` is the mean of its texture over the part, where that is known.
    #[inline(always)]
    fn luminance(&self, tile: &mut TileLight, part: &Part, at: &Instant, texel: Option<[f32; 4]>) -> f64 {
        let Part { slot, moments, .. } = *part;
        let inverse = 1.0 / moments.area;
        let place = part.sight.place(part.frame.point(moments.first.map(|v| v * inverse)));
        let facet = part.sight.facet as usize;
        let answer = &self.answers[self.world.facets[facet].surface as usize];
        let look = &self.looks[facet];
        let mut base = look.base;
        if look.shaded {
            base += look.base_along[0] * place[0] + look.base_along[1] * place[1];
        }
        if let Some(texture) = look.texture {
            let texel = texel.unwrap_or_else(|| self.texel(part, texture));
            base *= DVec3::new(f64::from(texel[0]), f64::from(texel[1]), f64::from(texel[2]));
        }
        if let Some(mapped) = &answer.maps {
            return moments.area * self.of_maps(tile, mapped, part, at, look.texture.map(|_| base));
        }
        let glow = answer.waveform.map_or(1.0, |w| w.factor(at.t_s));
        if tile.slots[slot].unlit {
            return moments.area * glow * material::LUMINANCE.dot(base);
        }
        let of = |r: [f64; 4]| base.x * r[0] + base.y * r[1] + base.z * r[2] + r[3];
        let mut sum = answer.glow * glow + of(self.interpolate(tile, slot, place, at.u, 0));
        for number in 0..self.own.len() {
            if tile.slots[slot].lit >> number & 1 == 0 {
                continue;
            }
            let strength = self.arriving(tile, part, at, number);
            if strength > 0.0 {
                sum += strength * of(self.interpolate(tile, slot, place, at.u, 1 + number));
            }
        }
        moments.area * sum
    }

    #[inline(always)]
    fn interpolate(&self, tile: &TileLight, slot: usize, place: [f64; 2], u: f64, lamp: usize) -> [f64; 4] {
        let slot = &tile.slots[slot];
        let lamps = 1 + self.own.len();
        let (mut cell, mut within) = ([0_usize; 2], [0.0; 2]);
        for k in 0..2 {
            let at = (place[k] * slot.cells[k] - slot.first[k]).clamp(0.0, slot.count[k] as f64);
            cell[k] = (at as usize).min(slot.count[k] - 1);
            within[k] = at - cell[k] as f64;
        }
        let number = cell[1] * slot.count[0] + cell[0];
        let at = |end: usize| {
            let patch = &tile.patches[slot.at[end] + number];
            let intervals = patch.intervals as usize;
            let node = |k: usize| {
                let at = within[k] * intervals as f64;
                let low = (at as usize).min(intervals - 1);
                (low, (at - low as f64) as f32)
            };
            let ((i, x), (j, y)) = (node(0), node(1));
            let row = intervals + 1;
            let corner = j * row + i;
            let weights = [(1.0 - x) * (1.0 - y), x * (1.0 - y), (1.0 - x) * y, x * y];
            let mut sum = [0.0_f32; 4];
            for (offset, weight) in [0, 1, row, row + 1].into_iter().zip(weights) {
                let node = &patch.nodes[(corner + offset) * lamps + lamp];
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

    /// Whether what lies behind everything is the same everywhere and always.
    pub fn background_rests(&self) -> bool {
        !self.camera_moves || !self.world.scene.environment.as_ref().is_some_and(|e| e.visible)
    }

    /// Mean luminance of what lies behind everything, over a part of a pixel of the tile `view`.
    pub fn background(&self, view: &TileView, frame: &PixelFrame, moments: &Moments, u: f64) -> f64 {
        let environment = self.world.scene.environment.as_ref().filter(|e| e.visible);
        let (Some(environment), Some(frames)) = (environment, &self.frames) else { return self.background };
        let (at, axes) = moments.footprint();
        let seen = view.image_point(frame.point(at));
        let of = |frame: &Frame| {
            // The direction whose homogeneous image point is (x, y, 1).
            let matrix = glam::DMat3::from_mat4(frame.screen_from_world).inverse();
            let direction = matrix * seen;
            let pixel = axes[0][0].max(axes[1][1]) / frame.lens.focal[0];
            material::sky(environment, direction, pixel)
        };
        let (a, b) = (of(&frames[0]), of(&frames[1]));
        a + (b - a) * u
    }
}

/// Numbers of the bits that are set.
pub fn bits(mut of: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let bit = of.trailing_zeros() as usize;
        of &= of.wrapping_sub(1);
        (bit < 64).then_some(bit)
    })
}

/// A time within a block.
#[derive(Clone, Copy, Debug)]
pub struct Instant {
    /// Its number in the tile.
    pub moment: usize,
    /// Part of the block.
    pub u: f64,
    /// Seconds of the scene's own time, its speed included.
    pub t_s: f64,
}

/// What a pixel sees of a facet.
#[derive(Clone, Copy)]
pub struct Part<'a> {
    /// Entry of the tile.
    pub slot: usize,
    /// The facet about the tile's centre.
    pub sight: &'a Sight,
    /// How much is seen.
    pub moments: &'a Moments,
    /// Where it is seen, and its number there; all of the pixel where this is `None`.
    pub regions: Option<(&'a Polygons, u32)>,
    /// Number of the pixel in its tile.
    pub pixel: usize,
    /// Where that is.
    pub frame: PixelFrame,
}

/// A sphere that holds the `points`.
fn sphere(points: impl Iterator<Item = DVec3> + Clone) -> (DVec3, f64) {
    let [low, high] = bounding_box(points);
    (0.5 * (low + high), 0.5 * (high - low).length())
}

/// The part of a facet with these corners in a range of (s, t).
fn part_between([p, q, _, r]: [DVec3; 4], [low, high]: [[f64; 2]; 2]) -> [DVec3; 4] {
    let corners = [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]];
    corners.map(|[s, t]| p + (q - p) * s + (r - p) * t)
}

fn shard_of(key: &Key) -> usize {
    (Words::default().hash_one(key) >> 32) as usize % SHARDS
}

fn whole_mean(textures: &Textures, texture: TextureRef) -> [f32; 4] {
    textures.overall(texture.texture)
}

/// Of a sine: square waves are constant between the blocks' borders.
fn sine_hz(waveform: Option<Waveform>) -> f64 {
    waveform.filter(|w| w.shape == WaveShape::Sine).map_or(0.0, |w| w.frequency_hz)
}

fn look(world: &World, textures: &Textures, surface: u32, corners: [u32; 4], factor: [f32; 3]) -> Look {
    let primitive = world.primitive(surface);
    let material = &world.scene.materials[world.surfaces[surface as usize].material];
    let [a, b, _, d] = corners.map(|c| c as usize);
    let base = |i: usize| {
        let color = primitive.colors.as_ref().and_then(|c| c.get(i)).copied().unwrap_or([1.0; 4]);
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
        shaded: base(b) != base(a) || base(d) != base(a),
    };
    let map = material.base_color_texture.and_then(|t| TextureMap::new(textures, primitive, corners, t));
    if let Some(map) = map {
        look.texture = Some(map.texture);
        look.origin = map.origin.to_array();
        look.along = map.along.to_cols_array_2d();
    }
    look
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contour::area;
    use crate::lists::Lists;

    /// `scene` with its solids dented: each vertex moves along its normal, those at one place as far.
    fn dented(mut scene: evis_scene::Scene) -> evis_scene::Scene {
        for primitive in scene.meshes.iter_mut().flat_map(|mesh| &mut mesh.primitives) {
            let [low, high] = bounding_box(primitive.positions.iter().map(|p| wide(*p)));
            let middle = 0.5 * (low + high);
            for position in &mut primitive.positions {
                let p = wide(*position);
                let wave =
                    (p * DVec3::new(61.0, 47.0, 53.0)).to_array().map(f64::sin).iter().product::<f64>();
                *position = (middle + (p - middle) * (1.0 + 0.1 * wave)).as_vec3().to_array();
            }
        }
        scene
    }

    #[test]
    fn no_facet_that_darkens_a_pixel_is_left_out() {
        let of = |name| evis_scene::builtin::load(name, 0).unwrap();
        nothing_that_darkens_is_left_out(&of("warehouse"), (96, 72), 630_784.0, 3);
        nothing_that_darkens_is_left_out(&of("desk"), (640, 480), 8_192.0, 16);
        nothing_that_darkens_is_left_out(&dented(of("desk")), (640, 480), 8_192.0, 16);
        let fast = evis_scene::Scene { speed: Some(4.0), ..dented(of("desk")) };
        nothing_that_darkens_is_left_out(&fast, (640, 480), 8_192.0, 16);
    }

    /// Compares every `tiles`-th tile in a block that begins at `start_us`.
    fn nothing_that_darkens_is_left_out(
        scene: &evis_scene::Scene,
        size: (u32, u32),
        start_us: f64,
        tiles: usize,
    ) {
        let world = World::new(scene, 0, Some(size)).unwrap();
        let end_us = start_us + world.block_us(8192) as f64;
        let block = Block { start_us, end_us, jump: false };
        let mut clock = Clock::new(&world, block);
        let lists = Lists::new(&world, &mut clock).unwrap();
        let mut lighting = Lighting::new(&world, &Shared::new(scene));
        lighting.prepare(&mut clock, &block).unwrap();
        let (mut compared, mut darkened, mut off, mut canary) = (0, 0, 0, 0);
        let mut tile = TileLight::default();
        let u = 0.3;
        for (row, column) in (0..lists.row_count()).flat_map(|r| (0..lists.columns).map(move |c| (r, c))) {
            let entries = &lists.row(row)[column];
            lighting.enter_tile(&mut tile, entries, [column, row]);
            for (number, entry) in entries.iter().enumerate() {
                let record = &lists.records[entry.record as usize];
                lighting.ready(&mut tile, record, entry.record, number);
                lighting.shade_slot(&mut tile, record, entry.record, number);
                let slot = tile.slots[number];
                let pixel = (entry.touches.trailing_zeros() as usize * 5 + 3 * row) % 64;
                if entry.touches >> pixel & 1 == 0 || slot.lit & 1 == 0 || (5 * row + column) % tiles > 0 {
                    continue;
                }
                let frame = tile.view.pixel(pixel);
                let Some(sight) = Sight::new(record, &tile.view, u, world.lens.near) else { continue };
                let Some(fragment) = sight.at(entry.record, &frame, false) else { continue };
                let lamp = &lighting.screen_lamps[0];
                let shade = slot.shades[0];
                let near = tile.occluders[shade.from..shade.to].iter().filter(|o| o.0 >> pixel & 1 == 1);
                let kept: Vec<u32> = near.map(|o| o.1).collect();
                let dark = shade.dark >> pixel & 1 == 1;
                // Only the facet's own part: beyond it its plane may run through anything.
                let polygon = Polygon::within(fragment.crossing());
                if area(polygon.corners()) < 0.05 {
                    continue;
                }
                let lines =
                    |id: &u32| lighting.occluder(*id).lines(lamp, &sight.inverse_depth, &tile.view, u);
                let darkens = |id: &u32| {
                    let shadow = crate::shadow::Shadow::at(&lines(id), &frame);
                    shadow.is_some_and(|s| {
                        let lines = fragment.crossing().iter().chain(s.lines());
                        area(Polygon::within(lines).corners()) > 1e-4
                    })
                };
                let others = || (0..world.facets.len() as u32).filter(|id| *id != record.facet);
                let missing: Vec<u32> = others()
                    .filter(|id| !dark && lighting.far[*id as usize] & 1 == 0)
                    .filter(|id| !kept.contains(id) && darkens(id))
                    .collect();
                assert!(missing.is_empty(), "facet {} at {frame:?} lacks {missing:?}", record.facet);
                // Both sides of solids darken what the near ones do.
                let part = |some: Vec<u32>| {
                    let mut regions = Polygons::default();
                    regions.push(0, polygon.corners());
                    let some: Vec<[Line; 5]> = some.iter().map(lines).collect();
                    Lit::default().part(Some((&regions, 0)), some.iter(), &frame)
                };
                let brute = part(others().collect());
                let found = if dark { 0.0 } else { part(kept.clone()) };
                off += usize::from((found - brute).abs() > 0.15);
                canary += usize::from(!dark && kept[..kept.len() / 2].iter().any(darkens));
                compared += 1;
                darkened += usize::from(brute < 1.0);
            }
        }
        println!("{compared} compared, {darkened} darkened, {off} off, {canary} notice a missing one");
        assert!(compared > 100 && darkened > 20 && canary > 3);
        // Areas of slivers are counted by few samples.
        assert!(off * 50 < compared, "{off} of {compared}");
    }
}
