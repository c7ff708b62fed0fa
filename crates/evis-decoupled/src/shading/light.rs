//! Light of surfaces.
//!
//! Of a facet's part that a tile sees, a polynomial tells how it responds to base colour, without shadows, wherever that is true
//! ([`crate::shading::patch`]); elsewhere, where light has an edge or a highlight, each part of a pixel is shaded at places of its own.
//! A texture is filtered, and shadows are found, when a pixel is evaluated. A facet has a grid of 2^i by 2^j cells over its (s, t); the
//! level follows the facet's size on the screen, so that a cell spans about a tile. What may throw a shadow into a cell is found once,
//! where lamp, surface and what throws it are still.

mod bounds;
mod maps;
pub mod packed;
mod patches;
mod shadows;

use std::sync::{Arc, OnceLock};

use evis_scene::motion::{WaveShape, Waveform};
use evis_scene::{Eye, Light, LightFactors, Material, MaterialFactors, ShadingModel, TextureRef};
use glam::{DMat3, DVec2, DVec3, Vec4};

use crate::Error;
use crate::image::maps::{Map as TextureMap, Maps};
use crate::image::texture::{Cells, Textures};
use crate::packed::MOST_OWN;
use crate::scene::facets::{Facet, bounding_box, wide};
use crate::scene::screen::{Depths, Screen};
use crate::scene::tiles::{PIXELS, PixelFrame, TILE, TileView, change};
use crate::scene::world::World;
use crate::shading::bounds::Bounds;
use crate::shading::cache::Cache;
use crate::shading::material::{self, Around, Lamp};
use crate::shading::patch::{NODES, Patch, STEPS};
use crate::shading::places::{FacetOverTime, LightsOverTime, LitFacet, MappedFacet};
use crate::shading::shadow::{Beam, Hull, Lit, Occluder, ScreenLamp, Tree};
use crate::visibility::blocks::Clock;
use crate::visibility::coverage::{Moments, Polygon, Polygons};
use crate::visibility::fragment::{Line, Sight};
use crate::visibility::lists::{Entry, Record};

/// Most intervals of a facet's grid along an axis, as a power of two.
const MOST_LEVEL: u32 = 14;
/// Square of the angle by which a camera with parallel rays turns, in radians, from which on it shows another sky.
const LEAST_TURN: f64 = 1e-12;
/// Part by which 1/depth may change over a pixel whose texture is averaged along edges that it shares with others.
const MOST_PERSPECTIVE: f64 = 0.015;
/// Where shadows leave such a part of an area, base colour is averaged over what they leave.
const PARTLY_LIT: std::ops::Range<f64> = 0.001..0.99;
/// Places per texel along either side of a footprint on the sky; and most of them.
pub const SKY_DENSITY: f64 = 3.0;
/// See there.
pub const SKY_PLACES: u32 = 6;
/// Of a texel of the sky, which it moves by between evaluations where pixels are smaller: there are so many in one.
const HALF_TEXELS: f64 = 2.0;
/// Where no polynomial tells light, it is found at two points of Gauss along either side of what a pixel sees: they lie so far from its
/// middle, as parts of the side.
pub const GAUSS: f64 = 0.288_675_134_594_812_9;
/// Places along either side of what a pixel sees of a surface with maps.
pub const PLACES: u32 = 4;
/// A tile as a pixel, where its side is the unit.
const WHOLE: PixelFrame = PixelFrame::square([0.0; 2]);

/// What never changes of a facet's appearance.
#[derive(Clone, Debug)]
struct Appearance {
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
    /// Level along s and t.
    level: [u8; 2],
    index: [u16; 2],
    /// Number of a lamp.
    lamp: u32,
}

impl Key {
    /// Of cell `index` of a grid of 2^`level` cells along s and t, and lamp number `lamp` of those whose light is kept apart.
    fn new(facet: u32, level: [u32; 2], index: [u32; 2], lamp: usize) -> Self {
        Self { facet, level: level.map(|v| v as u8), index: index.map(|v| v as u16), lamp: lamp as u32 }
    }

    /// Of the cell of half the level along either side that holds this one; `None` of a whole facet.
    fn coarser(&self) -> Option<Self> {
        let halves = self.level.map(|level| u16::from(level > 0));
        let level = self.level.map(|level| level.saturating_sub(1));
        let index = [0, 1].map(|k| self.index[k] >> halves[k]);
        (halves != [0; 2]).then_some(Self { level, index, ..*self })
    }
}

/// World places and normals of a surface's vertices.
type Corners = Vec<(DVec3, DVec3)>;

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
    looks: Vec<Appearance>,
    answers: Vec<Answer>,
    /// Per material, as `looks` and `answers` have them.
    factors: Vec<MaterialFactors>,
    /// Per light.
    lights: Vec<LightFactors>,
    /// Lamps at the start, middle and end of the block, and from where the camera looks.
    lamps: [Vec<Lamp>; 3],
    eyes: [Eye; 3],
    /// Indices of lamps whose light is kept apart: they throw shadows, or their strength changes.
    own: Vec<usize>,
    /// Per surface, vertices in the world at the start, middle and end; still ones once.
    vertices: Vec<[Corners; 3]>,
    /// Per surface with maps, tangents and signs of bitangents, likewise.
    tangents: Vec<[Vec<(DVec3, f64)>; 3]>,
    /// The eye and lamps during the block, and facets, made when they are first needed; what maps add to them, where any surface has
    /// maps.
    lights_over_time: LightsOverTime,
    facets: Vec<OnceLock<Box<FacetOverTime>>>,
    mapped: Vec<OnceLock<Box<MappedFacet>>>,
    shadowed: Cache<Key, Shadowed>,
    /// Number of the block, from 1.
    block: u64,
    /// Of materials and lights: how often they were found to be others.
    version: u64,
    /// Places shaded so far, for patches.
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
    screen: [Screen; 3],
    depths: Depths,
    background: f64,
    /// Where light from all around is visible.
    sky: Option<Sky>,
    camera_moves: bool,
}

/// Light of a tile's entries.
#[derive(Default)]
pub struct TileLight {
    slots: Vec<Slot>,
    /// Of patches: those that are found of a block, and at moments.
    nodes: Vec<[Vec4; NODES]>,
    /// Of slots without patches, at moments.
    facets: Vec<LitFacet>,
    /// By moment and slot: where its nodes or its facet are, plus 1.
    moments: Vec<u32>,
    /// Facets of all slots and lamps, with the pixels that they may darken.
    occluders: Vec<(u64, u32)>,
    /// Per slot, bounds of its light, found when they are first asked for, and maybe none; empty until any are asked for.
    bounds: Vec<Option<Option<Bounds<MOST_OWN>>>>,
    view: TileView,
    /// The same with the tile's side as unit.
    whole: TileView,
    /// Where lamps that rest shine on parts of facets that do: what moves there throws a shadow on them, maybe. Without a beam it may
    /// be anywhere.
    pub beams: Vec<Option<Beam>>,
    found: Vec<u32>,
    lit: Lit,
    /// By moment, slot and lamp: where in `lines` the half planes of its occluders begin, plus 1.
    line_starts: Vec<u32>,
    /// Half planes about the tile's centre.
    lines: Vec<[Line; 5]>,
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
    /// First cell that the tile sees, and how many along s and t.
    first: [u32; 2],
    count: [u32; 2],
    /// Its light, where a polynomial tells it; of maps, and of what is unlit, there is none.
    patch: Option<Patch>,
    /// Widths of highlights that go by during the block.
    lobes: f64,
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
    /// 1/depth of its plane as the tile sees it at the start, middle and end of its span, with the tile's side as unit; `None` where it
    /// does not throughout.
    plane: Option<[Line; 3]>,
    level: [u32; 2],
    /// Pixels that may see it.
    touches: u64,
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
                maps: mapped(m).map(|maps| Mapped {
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
            eyes: [Eye::At(DVec3::ZERO); 3],
            own: Vec::new(),
            vertices: Vec::new(),
            tangents: Vec::new(),
            lights_over_time: LightsOverTime::default(),
            facets: Vec::new(),
            mapped: Vec::new(),
            shadowed: Cache::default(),
            block: 0,
            version: 0,
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
            screen: [Screen::default(); 3],
            depths: Depths { near: 0.0, far: f64::INFINITY },
            background: material::LUMINANCE.dot(wide(scene.background)),
            sky: None,
            camera_moves: world.moving_nodes[scene.cameras[world.camera].node],
        }
    }

    /// Moves on to the block of `clock`.
    ///
    /// # Errors
    /// A camera without a pose.
    pub fn prepare(&mut self, clock: &mut Clock) -> Result<(), Error> {
        let world = self.world;
        self.block += 1;
        let frames = clock.thirds()?;
        let state = &frames[0].state;
        if state.factors != self.factors || state.lights != self.lights {
            // What is known of earlier blocks is of materials and lights as they were then.
            let (block, version, shaded) = (self.block, self.version + 1, std::mem::take(&mut self.shaded));
            let (factors, lights) = (state.factors.clone(), state.lights.clone());
            let now = Self::with_factors(world, &Arc::clone(&self.shared), factors, lights);
            *self = Self { block, version, shaded, ..now };
        }
        self.lamps = frames.each_ref().map(|f| material::lamps(world.scene, f, &world.moving_nodes));
        let apart = |l: &Lamp| l.casts_shadow || l.waveform.is_some();
        self.own = (0..self.lamps[0].len()).filter(|k| apart(&self.lamps[0][*k])).take(MOST_OWN).collect();
        let first = self.vertices.is_empty();
        self.vertices.resize_with(world.surfaces.len(), Default::default);
        self.tangents.resize_with(world.surfaces.len(), Default::default);
        for (index, surface) in world.surfaces.iter().enumerate() {
            let times = match surface.moves {
                true => 3,
                false => usize::from(first),
            };
            for (time, frame) in frames.iter().enumerate().take(times) {
                self.vertices[index][time] = world.vertices(index as u32, frame);
                if self.answers[index].maps.is_some() {
                    self.tangents[index][time] = world.tangents(index as u32, frame);
                }
            }
        }
        self.eyes = frames.each_ref().map(|frame| frame.eye);
        self.lights_over_time = self.find_lights_over_time();
        self.facets.clear();
        self.facets.resize_with(world.facets.len(), OnceLock::new);
        if self.answers.iter().any(|answer| answer.maps.is_some()) {
            self.mapped.clear();
            self.mapped.resize_with(world.facets.len(), OnceLock::new);
        }
        self.prepare_shadows(&frames, first);
        let (parallel, focal) = (self.screen[0].is_parallel(), world.lens.focal[0]);
        let detail = |environment| (HALF_TEXELS * material::sky_texels(environment) / focal).min(1.0);
        self.sky = world.scene.environment.as_ref().filter(|e| e.visible).map(|environment| Sky {
            world_from_screen: self.screen.map(|screen| screen.directions()),
            // Parallel rays see one point of it.
            focal: if parallel { f64::INFINITY } else { focal },
            detail: if parallel { 1.0 } else { detail(environment) },
        });
        self.shadowed.retain(self.block);
        Ok(())
    }

    /// Prepares `tile` for the tile at (column, row); an entry's light is gathered when a pixel first sees it.
    pub fn enter_tile(&self, tile: &mut TileLight, entries: &[Entry], place: [usize; 2]) {
        tile.slots.clear();
        tile.slots.extend(entries.iter().map(|e| Slot { touches: e.touches, ..Slot::default() }));
        tile.nodes.clear();
        tile.facets.clear();
        tile.moments.clear();
        tile.bounds.clear();
        tile.occluders.clear();
        tile.beams.clear();
        tile.line_starts.clear();
        tile.lines.clear();
        tile.view = self.world.tile(place);
        tile.whole = tile.view.in_units_of(TILE as f64);
    }

    /// Gathers the light of entry `slot` of a tile, which is `record`, number `index` of the block.
    pub fn ready(&self, tile: &mut TileLight, record: &Record, index: u32, slot: usize) {
        if !tile.slots[slot].ready {
            tile.slots[slot] = self.gather(tile, record, index, tile.slots[slot].touches);
        }
    }

    /// Finds what throws shadows on entry `slot`; before its light is asked for.
    #[inline(always)]
    pub fn shade_slot(&self, tile: &mut TileLight, record: &Record, slot: usize) {
        if !tile.slots[slot].shaded {
            let mut own = tile.slots[slot];
            self.find_occluders(tile, &mut own, record, Casters::Still);
            own.shaded = true;
            tile.slots[slot] = own;
        }
    }

    /// Whether a shadow may come into a part of a pixel that sees entry `slot`; asked after [`Lighting::shade_slot`].
    pub fn is_shadowed(&self, tile: &TileLight, slot: usize, pixel: usize) -> bool {
        tile.slots[slot].shades.iter().any(|shade| shade.touched >> pixel & 1 == 1)
    }

    /// Whether nothing of entry `slot` changes during the block but for where it is seen, and by shadows of what moves; how
    /// far in pixels these move, and on which pixels.
    pub fn changes_of(&self, tile: &TileLight, slot: usize) -> (bool, f64, u64) {
        let slot = &tile.slots[slot];
        (slot.still, slot.motion, slot.moved)
    }

    /// Widths of highlights that go by on entry `slot` during the block.
    pub fn lobes(&self, tile: &TileLight, slot: usize) -> f64 {
        tile.slots[slot].lobes
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
        let mut planes = [None; 3];
        for (plane, sight) in planes.iter_mut().zip(self.sights(record, &tile.whole)) {
            let Some(sight) = sight else { continue };
            let Some(fragment) = sight.at(index, &WHOLE, false) else { continue };
            *plane = Some(fragment.inverse_depth);
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
        if let [Some(start), Some(middle), Some(end)] = planes {
            slot.plane = Some([start, middle, end]);
        }
        let level = [0, 1].map(|k| {
            let wanted = (1.0 / (high[k] - low[k]).max(1e-6)).log2().floor();
            (wanted.max(0.0) as u32).min(MOST_LEVEL)
        });
        for k in 0..2 {
            let cells = f64::from(1_u32 << level[k]);
            slot.first[k] = (low[k] * cells).floor().min(cells - 1.0) as u32;
            let last = ((high[k] * cells).ceil().min(cells) - 1.0).max(0.0) as u32;
            slot.count[k] = last.saturating_sub(slot.first[k]) + 1;
        }
        let (side, changes) = (if front { 1.0 } else { -1.0 }, self.changes(surface));
        slot.still &= !changes;
        (slot.range, slot.level) = ([low, high], level);
        let at = STEPS.map(|u| self.lit_facet((record.facet, side), u, slot.middle()));
        let lobes = self.lobes_of(record.facet, &at, slot.range);
        slot.lobes = if changes { lobes.moved } else { 0.0 };
        if answer.maps.is_some() || !record.one_side {
            // A normal map may face any lamp, and a facet that shows both its sides does.
            slot.lit = ((1_u16 << self.own.len()) - 1) as u8;
        } else {
            (slot.patch, slot.lit) =
                self.find_patch(&mut tile.nodes, ((record.facet, side), &at), slot.range, (changes, lobes));
        }
        for (number, &lamp) in self.own.iter().enumerate() {
            if slot.lit >> number & 1 == 1 {
                let waveform = self.lamps[0][lamp].waveform;
                slot.still &= waveform.is_none();
                slot.sine_hz = slot.sine_hz.max(sine_hz(waveform));
            }
        }
        slot.shaded = slot.lit == 0;
        if !slot.shaded && !self.moving.is_empty() {
            self.find_occluders(tile, &mut slot, record, Casters::Moving);
        }
        slot
    }

    /// World places and normals of a surface's vertices at the start, middle or end of the block.
    fn vertices_at(&self, surface: usize, time: usize) -> &Corners {
        &self.vertices[surface][if self.world.surfaces[surface].moves { time } else { 0 }]
    }

    /// Whether light of a surface depends on time, but for the strength of lamps.
    fn changes(&self, surface: usize) -> bool {
        self.answers[surface].follows_view && self.camera_moves
            || self.world.surfaces[surface].moves
            || self.lamps[0].iter().any(|l| l.moves)
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
        let depth = &sight.weight;
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
        let facet = part.sight.facet as usize;
        let answer = &self.answers[self.world.facets[facet].surface as usize];
        let look = &self.looks[facet];
        let (place, base) = self.base_color(part, texel);
        if let Some(mapped) = &answer.maps {
            return moments.area * self.of_maps(tile, mapped, part, at, look.texture.map(|_| base));
        }
        let glow = answer.waveform.map_or(1.0, |w| w.factor(at.t_s));
        if tile.slots[slot].unlit {
            return moments.area * glow * material::LUMINANCE.dot(base);
        }
        let of = |base: DVec3, r: Vec4| {
            let r = r.as_dvec4();
            base.x * r.x + base.y * r.y + base.z * r.z + r.w
        };
        let answers = self.answers(tile, part, place, at);
        let mut sum = answer.glow * glow + of(base, self.answer(tile, &answers, 0));
        for number in 0..self.own.len() {
            if tile.slots[slot].lit >> number & 1 == 0 {
                continue;
            }
            let (strength, lit) = self.arriving(tile, part, at, number);
            if strength <= 0.0 {
                continue;
            }
            sum += strength
                * match &lit {
                    // What the lamp reaches may look otherwise than the rest.
                    Some(lit) if PARTLY_LIT.contains(&(lit.area / moments.area)) => {
                        let part = Part { moments: lit, ..*part };
                        let (place, base) = self.base_color(&part, None);
                        let answers = self.answers(tile, &part, place, at);
                        of(base, self.answer(tile, &answers, 1 + number))
                    }
                    _ => of(base, self.answer(tile, &answers, 1 + number)),
                };
        }
        moments.area * sum
    }

    /// The (s, t) of a part's centroid, and the mean of base colour over the part; `texel` is that of its texture, where it is
    /// known.
    #[inline(always)]
    fn base_color(&self, part: &Part, texel: Option<[f32; 4]>) -> ([f64; 2], DVec3) {
        let moments = part.moments;
        let inverse = 1.0 / moments.area;
        let place = part.sight.place(part.frame.point(moments.first.map(|v| v * inverse)));
        let look = &self.looks[part.sight.facet as usize];
        let mut base = look.base;
        if look.shaded {
            base += look.base_along[0] * place[0] + look.base_along[1] * place[1];
        }
        if let Some(texture) = look.texture {
            let texel = texel.unwrap_or_else(|| self.texel(part, texture));
            base *= DVec3::new(f64::from(texel[0]), f64::from(texel[1]), f64::from(texel[2]));
        }
        (place, base)
    }

    /// Whether what lies behind everything is the same everywhere and always.
    pub fn background_rests(&self) -> bool {
        self.sky.is_none() || !self.camera_moves
    }

    /// How far what lies behind everything moves in a tile during the block, in pixels, or where these are smaller in halves of its
    /// texels, between which its light runs straight.
    pub fn background_motion(&self, tile: &TileLight) -> f64 {
        let Some(sky) = self.sky.as_ref().filter(|_| self.camera_moves) else { return 0.0 };
        let view = &tile.view;
        let half = 0.5 * TILE as f64;
        let moved = |at: [f64; 2]| -> f64 {
            let directions = [0.0, 0.5, 1.0].map(|u| sky.direction(view.image_point(at), u));
            if self.screen[0].is_parallel() {
                // Any turn exchanges what all pixels see.
                let turns = directions.iter().any(|d| d.distance_squared(directions[0]) > LEAST_TURN);
                return if turns { f64::from(u16::MAX) } else { 0.0 };
            }
            // Where the camera of the block's start sees them.
            let places = directions.map(|direction| {
                let h = self.screen[0].direction(direction);
                view.point(h.x, h.y, h.z)
            });
            // What is seen at its end and lies behind the camera at its start has gone by far.
            let [a, b, c] =
                places.map(|p| if p.z > 0.0 { DVec2::new(p.x, p.y) / p.z } else { DVec2::INFINITY });
            let way = a.distance(b) + b.distance(c);
            if way.is_finite() { way } else { f64::from(u16::MAX) }
        };
        let places = [[0.0; 2], [-half; 2], [half, -half], [-half, half], [half; 2]];
        places.map(moved).into_iter().fold(0.0, f64::max) * sky.detail
    }

    /// Mean luminance of what lies behind everything, over a part of a pixel of the tile `view`.
    pub fn background(&self, view: &TileView, frame: &PixelFrame, moments: &Moments, u: f64) -> f64 {
        let (Some(environment), Some(sky)) = (&self.world.scene.environment, &self.sky) else {
            return self.background;
        };
        let (at, axes) = moments.footprint();
        let pixel = axes[0][0].max(axes[1][1]) / sky.focal;
        let texels = pixel * material::sky_texels(environment);
        let count = (SKY_DENSITY * texels).ceil().clamp(1.0, f64::from(SKY_PLACES)) as u32;
        let step = |k: u32| (f64::from(k) + 0.5) / f64::from(count) - 0.5;
        let mut sum = 0.0;
        for k in 0..count * count {
            let (s, t) = (step(k % count), step(k / count));
            let place = [0, 1].map(|k| at[k] + s * axes[0][k] + t * axes[1][k]);
            let seen = view.image_point(frame.point(place));
            sum += material::sky(environment, sky.direction(seen, u), texels / f64::from(count));
        }
        sum / f64::from(count * count)
    }
}

/// How a camera sees the sky.
struct Sky {
    /// World directions from image points (x, y, 1), at the start, middle and end of a block.
    world_from_screen: [DMat3; 3],
    /// Pixels per radian in the middle of the picture.
    focal: f64,
    /// Halves of its texels that a pixel is wide there, at most 1.
    detail: f64,
}

impl Sky {
    /// The world direction of an image point at part `u` of the block.
    #[inline(always)]
    fn direction(&self, seen: DVec3, u: f64) -> DVec3 {
        // On a quadratic.
        let [a, b, c] = &self.world_from_screen;
        let (v, w) = (1.0 - u, 2.0 * u - 1.0);
        a * seen * (-v * w) + b * seen * (4.0 * u * v) + c * seen * (u * w)
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

/// Maps of `material` by which its light varies from texel to texel, where it has any.
fn mapped(material: &Material) -> Option<Maps> {
    Maps::of(material).filter(|_| material.model != ShadingModel::Unlit)
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

fn whole_mean(textures: &Textures, texture: TextureRef) -> [f32; 4] {
    textures.overall(texture.texture)
}

/// Of a sine: square waves are constant between the blocks' borders.
fn sine_hz(waveform: Option<Waveform>) -> f64 {
    waveform.filter(|w| w.shape == WaveShape::Sine).map_or(0.0, |w| w.frequency_hz)
}

fn look(world: &World, textures: &Textures, surface: u32, corners: [u32; 4], factor: [f32; 3]) -> Appearance {
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
    let mut look = Appearance {
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
mod tests;
