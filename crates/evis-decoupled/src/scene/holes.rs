//! Surfaces with an alpha mask as surfaces without one: their holes are cut out, once.
//!
//! glTF 2.0, 3.9.4: a masked surface exists where alpha reaches its cutoff. On a facet, texture coordinates are affine, so that
//! part is bounded by the contour of the texture's alpha, bilinear between texels, times that of its vertices, which is affine,
//! too. It is cut into triangles, after which nothing needs to know of masks: coverage, occlusion and shadows are exact as for
//! any mesh. Where a mesh has a skeleton, new vertices follow those of the triangle that they lie in.

use std::collections::HashMap;
use std::sync::Arc;

use evis_scene::{
    AlphaMode, Image, Material, MorphTarget, PixelLens, Primitive, Scene, SceneState, Texture, Variant, Wrap,
    deformed,
};
use glam::{DMat2, DMat4, DVec2, DVec3};
use i_overlay::core::fill_rule::FillRule;
use i_overlay::core::overlay_rule::OverlayRule;
use i_overlay::float::single::SingleFloatOverlay;
use i_triangle::float::triangulatable::Triangulatable;

use crate::Error;
use crate::hash::Words;
use crate::image::maps::texels;
use crate::image::texture::wrap_index;
use crate::scene::contour::{Grid, Ring, area, simplified};
use crate::scene::facets::{Facet, bounding_box, facets, wide};

/// How far a hole's border may lie from the contour, in pixels of the camera that comes nearest, and in texels.
const TOLERANCE_PX: f64 = 0.03;
const TOLERANCE: [f64; 2] = [0.01, 1.0];
/// Between texels contours bend: they are sampled at up to so many places per texel along an axis, and up to so many per image.
const MOST_FINER: u32 = 8;
const MOST_PLACES: u32 = 2048;
/// Times at which is seen how near cameras come.
const TIMES: u32 = 5;
/// Seconds within which a scene of infinite length is sampled.
const SECONDS: f64 = 1.0;
/// Holes and specks of less than this many texels, or less than this part of their facet, are left out.
const LEAST_AREA: f64 = 0.02;
const LEAST_PART: f64 = 1e-3;
/// Corners that a scene's outlines have at most, and triangles.
const MOST_CORNERS: usize = 1 << 22;
const MOST_PIECES: usize = 1 << 20;

const TOO_MANY: &str = "holes (alpha mask) with more than 4 194 304 corners";
const TOO_MANY_PIECES: &str = "holes (alpha mask) that leave more than 1 048 576 triangles";

/// Between texels that are not interpolated, alpha changes within this part of a texel to either side.
const STEP: f64 = 1e-3;

/// The masked primitives of a scene, without their holes.
#[derive(Debug, Default)]
pub struct Holes {
    /// By mesh and number in it.
    cut: HashMap<(usize, usize), Cut, Words>,
}

/// A primitive without its holes.
#[derive(Debug)]
pub struct Cut {
    /// With all vertices of the whole one, and new ones after them.
    pub primitive: Primitive,
    /// Of each new vertex of a mesh with joints, the corners of its facet and their weights.
    pub blends: Vec<([u32; 3], [f64; 3])>,
}

impl Holes {
    /// Those of `scene`, whose cameras have `size` pixels or their own; as fine as these see them.
    ///
    /// # Errors
    /// Holes that cannot be cut out.
    pub fn of(scene: &Scene, size: Option<(u32, u32)>) -> Result<Arc<Self>, Error> {
        let mut holes = Self::default();
        let mut outlines = Outlines::default();
        let mut pieces = 0;
        let mut viewpoints = None;
        for (index, mesh) in scene.meshes.iter().enumerate() {
            let nodes = || scene.nodes.iter().filter(|node| node.mesh == Some(index));
            if nodes().next().is_none() {
                continue;
            }
            let skins: Vec<usize> = nodes().filter_map(|node| node.skin).collect();
            for (number, primitive) in mesh.primitives.iter().enumerate() {
                let Some(material) = scene.materials.get(primitive.material) else { continue };
                let AlphaMode::Mask(cutoff) = material.alpha else { continue };
                let refuse = |what: &str| {
                    Err(Error::Unsupported(format!("material {:?}: it has {what}", material.name)))
                };
                let room = MOST_PIECES.saturating_sub(pieces);
                let viewpoints = viewpoints.get_or_insert_with(|| Viewpoints::new(scene, size));
                let skins = if primitive.joints.is_some() { &skins[..] } else { &[] };
                let per_metre = viewpoints.pixels_per_metre(scene, index, primitive, skins);
                let merge = skins.is_empty() && primitive.morph_targets.is_empty();
                let facets = facets(primitive, 0, merge);
                let asked = (f64::from(cutoff), per_metre, room);
                match cut(scene, primitive, material, &facets, asked, &mut outlines) {
                    Ok(own) => {
                        pieces += own.primitive.indices.len() / 3;
                        holes.cut.insert((index, number), own);
                    }
                    Err(what) => return refuse(what),
                }
            }
        }
        Ok(Arc::new(holes))
    }

    /// Primitive `number` of mesh `mesh`, without its holes.
    pub fn primitive<'p>(&'p self, scene: &'p Scene, mesh: usize, number: usize) -> &'p Primitive {
        let whole = || &scene.meshes[mesh].primitives[number];
        self.cut.get(&(mesh, number)).map_or_else(whole, |cut| &cut.primitive)
    }

    /// How new vertices of that primitive, which come last, follow others where it has joints.
    pub fn blends(&self, mesh: usize, number: usize) -> &[([u32; 3], [f64; 3])] {
        self.cut.get(&(mesh, number)).map_or(&[], |cut| &cut.blends)
    }
}

/// So many times in seconds, evenly spaced from `start_s` to the end of `scene`, or of one second where it has none left.
pub fn times(scene: &Scene, start_s: f64, count: u32) -> impl Iterator<Item = f64> {
    let left_s = scene.duration_s.map_or(SECONDS, |end_s| end_s - start_s);
    let span_s = if left_s > 0.0 { left_s } else { SECONDS };
    (0..count).map(move |k| start_s + span_s * f64::from(k) / f64::from(count - 1))
}

/// Where cameras and nodes are at some times, in all environments.
struct Viewpoints {
    moments: Vec<Moment>,
}

struct Moment {
    state: SceneState,
    cameras: Vec<Viewpoint>,
}

struct Viewpoint {
    eye: DVec3,
    lens: PixelLens,
}

impl Viewpoint {
    /// The most pixels that a metre has, `distance` away.
    fn pixels_per_metre(&self, distance: f64) -> f64 {
        self.lens.pixels_per_metre(distance.max(self.lens.near)).max_element()
    }
}

impl Viewpoints {
    fn new(scene: &Scene, size: Option<(u32, u32)>) -> Self {
        let variants: Vec<Option<&Variant>> =
            if scene.variants.is_empty() { vec![None] } else { scene.variants.iter().map(Some).collect() };
        let mut moments = Vec::new();
        for variant in variants {
            for t_s in times(scene, 0.0, TIMES) {
                let mut state = SceneState::default();
                scene.evaluate_variant(variant, t_s, &mut state);
                let cameras = (0..scene.cameras.len()).filter_map(|index| {
                    let camera = scene.camera_in(variant, index, f64::INFINITY)?;
                    let eye = state.world_from_node.get(camera.node)?.w_axis.truncate();
                    Some(Viewpoint { eye, lens: PixelLens::new(&camera, size) })
                });
                let cameras = cameras.collect();
                moments.push(Moment { state, cameras });
            }
        }
        Self { moments }
    }

    /// The most pixels that a metre of `primitive`, which is of mesh `mesh`, has, also where one of `skins` deforms it.
    fn pixels_per_metre(&self, scene: &Scene, mesh: usize, primitive: &Primitive, skins: &[usize]) -> f64 {
        let points = || primitive.positions.iter().map(|p| wide(*p));
        let [low, high] = bounding_box(points());
        let nodes = || scene.nodes.iter().enumerate().filter(|(_, node)| node.mesh == Some(mesh));
        let mut most = 0.0_f64;
        let mut joints = Vec::new();
        for Moment { state, cameras } in &self.moments {
            let distance = |eye: DVec3, low: DVec3, high: DVec3| eye.distance(eye.clamp(low, high));
            for skin in skins {
                scene.joint_matrices(*skin, state, &mut joints);
                let posed = (0..primitive.positions.len())
                    .filter_map(|v| deformed(primitive, v, &DMat4::IDENTITY, &[], &joints));
                let [posed_low, posed_high] = bounding_box(posed);
                let scale = (posed_high - posed_low).length() / (high - low).length().max(1e-12);
                for camera in cameras {
                    let distance = distance(camera.eye, posed_low, posed_high);
                    most = most.max(scale * camera.pixels_per_metre(distance));
                }
            }
            let rigid = nodes().filter(|(_, node)| node.skin.is_none() || skins.is_empty());
            for pose in rigid.filter_map(|(index, _)| state.world_from_node.get(index)) {
                let scale = pose.determinant().abs().cbrt();
                let inverse = pose.inverse();
                for camera in cameras {
                    let distance = scale * distance(inverse.transform_point3(camera.eye), low, high);
                    most = most.max(scale * camera.pixels_per_metre(distance));
                }
            }
        }
        if most.is_finite() { most } else { 0.0 }
    }
}

/// A facet's places (s, t), from its first corner to the second and the last one, on a texture, in texels.
struct Placed {
    origin: DVec2,
    along: DMat2,
    outline: Ring,
}

impl Placed {
    /// Where it is on no texture.
    fn alone(primitive: &Primitive, facet: &Facet) -> Self {
        let mut outline = facet.outline(primitive).to_vec();
        outline.dedup();
        Self { origin: DVec2::ZERO, along: DMat2::IDENTITY, outline }
    }

    /// It is more than a place of the texture, or a line.
    fn has_area(&self) -> bool {
        self.along.determinant().abs() >= 1e-9
    }

    fn middle(&self) -> [f64; 2] {
        let sum = self.outline.iter().fold(DVec2::ZERO, |sum, p| sum + DVec2::from_array(*p));
        (sum / self.outline.len() as f64).to_array()
    }

    /// What is affine, at a place; from its first, second, third and last corner.
    fn affine(&self, corners: [f64; 4]) -> impl Fn([f64; 2]) -> f64 {
        let (to_facet, origin) = (self.along.inverse(), self.origin);
        move |place| {
            let at = to_facet * (DVec2::from_array(place) - origin);
            corners[0] + at.x * (corners[1] - corners[0]) + at.y * (corners[3] - corners[0])
        }
    }

    /// Rings around all of it in which `map` times what its corners have reaches `level`; `None` where that has too much
    /// detail.
    fn rings(&self, map: &AlphaMap, corners: [f64; 4], level: f64, tolerance: f64) -> Option<Vec<Ring>> {
        let [low, high] = bounds(&self.outline);
        let size = [0, 1].map(|k| (high[k] - low[k]).ceil());
        let finer = finer(size[0].max(size[1]).min(1e6) as u32, tolerance);
        if size[0] * size[1] * (finer * finer) as f64 > MOST_CORNERS as f64 {
            return None;
        }
        let texels = |k: usize| low[k].floor() - 1.0..high[k].ceil() + 1.0;
        let lines = [0, 1].map(|k| Lines::new(texels(k), map.texture.nearest, finer));
        let of_corners = self.affine(corners);
        Some(rings(lines, level, tolerance, &|place, read| of_corners(place) * map.at(read)))
    }

    /// Rings around all of it in which what its corners have reaches `level`.
    fn rings_of_corners(&self, corners: [f64; 4], level: f64) -> Vec<Ring> {
        let [low, high] = bounds(&self.outline);
        let lines = [0, 1].map(|k| Lines { places: vec![low[k], high[k]], read: vec![0.0; 2] });
        let of_corners = self.affine(corners);
        rings(lines, level, 0.0, &|place, _| of_corners(place))
    }
}

/// Low and high ends along both axes.
fn bounds(ring: &Ring) -> [[f64; 2]; 2] {
    let of = |k: usize| ring.iter().map(move |p| p[k]);
    let end = |f: fn(f64, f64) -> f64, from: f64| [0, 1].map(|k| of(k).fold(from, f));
    [end(f64::min, f64::INFINITY), end(f64::max, f64::NEG_INFINITY)]
}

/// At how many places per texel, along either axis, contours are sampled in an image of `size` texels: a chord of a cell is off by
/// some tenth of it.
fn finer(size: u32, tolerance: f64) -> usize {
    let wanted = (4.0 * TOLERANCE_PX / tolerance).ceil() as u32;
    wanted.min(MOST_PLACES / size.max(1)).clamp(1, MOST_FINER) as usize
}

/// Alpha of a texture.
struct AlphaMap<'a> {
    texture: &'a Texture,
    image: &'a Image,
}

impl AlphaMap<'_> {
    fn texel(&self, x: i32, y: i32) -> f64 {
        let (width, height) = (self.image.width as usize, self.image.height as usize);
        let row = wrap_index(y, height as i32, self.texture.wrap_v);
        let column = wrap_index(x, width as i32, self.texture.wrap_u);
        let alpha = f64::from(self.image.texels[row * width + column][3].to_f32());
        if alpha.is_finite() { alpha } else { 0.0 }
    }

    /// At a place in texels from the corner of the first one.
    fn at(&self, [x, y]: [f64; 2]) -> f64 {
        if self.texture.nearest {
            return self.texel(x.floor() as i32, y.floor() as i32);
        }
        let [u, v] = [x - 0.5, y - 0.5];
        let (i, j) = (u.floor(), v.floor());
        let (a, b) = (u - i, v - j);
        let of = |right: i32, down: i32| self.texel(i as i32 + right, j as i32 + down);
        (1.0 - b) * ((1.0 - a) * of(0, 0) + a * of(1, 0)) + b * ((1.0 - a) * of(0, 1) + a * of(1, 1))
    }
}

/// Lines of a grid along an axis: their places, and where in the texture is read what holds there.
struct Lines {
    places: Vec<f64>,
    read: Vec<f64>,
}

impl Lines {
    /// Over a range of whole texels: from middle to middle, `finer` per texel; or both sides of each border of `steps`.
    fn new(texels: std::ops::Range<f64>, steps: bool, finer: usize) -> Self {
        let count = (texels.end - texels.start) as usize;
        if steps {
            let (mut places, mut read) = (Vec::new(), Vec::new());
            for k in 0..count {
                let at = texels.start + k as f64;
                places.extend([
                    if k == 0 { at } else { at + STEP },
                    if k + 1 == count { at + 1.0 } else { at + 1.0 - STEP },
                ]);
                read.extend([at + 0.5; 2]);
            }
            return Self { places, read };
        }
        let places: Vec<f64> =
            (0..=count * finer).map(|j| texels.start + 0.5 + j as f64 / finer as f64).collect();
        Self { read: places.clone(), places }
    }

    /// Adds lines before and after all others.
    fn extend(&mut self, first: f64, last: f64) {
        for lines in [&mut self.places, &mut self.read] {
            lines.insert(0, first);
            lines.push(last);
        }
    }
}

/// Rings around all in which a value, a function of place and of where in the texture is read, reaches `level`, to
/// `tolerance` texels. Nothing is beyond the first and last lines.
fn rings(
    [mut across, mut down]: [Lines; 2],
    level: f64,
    tolerance: f64,
    value: &dyn Fn([f64; 2], [f64; 2]) -> f64,
) -> Vec<Ring> {
    let ends = [&mut across, &mut down].map(|lines| {
        let [first, last] = [0, lines.places.len() - 1].map(|k| lines.places[k]);
        lines.extend(first, last);
        [first, last]
    });
    let last = [across.places.len() - 1, down.places.len() - 1];
    let at = |x: usize, y: usize| {
        if x == 0 || y == 0 || x == last[0] || y == last[1] {
            return level - 1.0;
        }
        value([across.places[x], down.places[y]], [across.read[x], down.read[y]])
    };
    let on_border = |p: [f64; 2]| (0..2).any(|k| ends[k].contains(&p[k]));
    let rings = Grid { lines: [across.places.clone(), down.places.clone()], value: &at }.rings(level);
    let rings = rings.iter().map(|ring| simplified(ring, tolerance, &on_border));
    rings.filter(|ring| ring.len() >= 3).collect()
}

/// Where alpha of a texture reaches a level: the rings of one period, with their bounds.
struct Outline {
    rings: Vec<(Ring, [[f64; 2]; 2])>,
    /// Texels after which it repeats, along both axes.
    periods: [Option<f64>; 2],
}

/// Outlines by texture; and level, reach and tolerance.
#[derive(Default)]
struct Outlines {
    known: HashMap<(usize, [u64; 3]), Outline, Words>,
    corners: usize,
}

impl Outlines {
    /// Counts the corners of `rings`.
    fn count(&mut self, rings: &[Ring]) -> Result<(), &'static str> {
        self.corners += rings.iter().map(Vec::len).sum::<usize>();
        if self.corners > MOST_CORNERS { Err(TOO_MANY) } else { Ok(()) }
    }

    /// That of `texture`, number `number` of the scene, to `tolerance` texels; what is clamped is wanted `reach` texels beyond its
    /// borders.
    fn of(
        &mut self,
        (number, texture, image): (usize, &Texture, &Image),
        level: f64,
        reach: f64,
        tolerance: f64,
    ) -> &Outline {
        let clamped = [texture.wrap_u, texture.wrap_v].contains(&Wrap::Clamp);
        let reach = if clamped { reach.max(1.0).log2().ceil().exp2() } else { 0.0 };
        self.known
            .entry((number, [level, reach, tolerance].map(f64::to_bits)))
            .or_insert_with(|| Outline::new(texture, image, level, reach, tolerance))
    }
}

impl Outline {
    fn new(texture: &Texture, image: &Image, level: f64, reach: f64, tolerance: f64) -> Self {
        let size = [image.width, image.height];
        let finer = finer(size[0].max(size[1]), tolerance);
        // One period, or all that is wanted, from the middle of the first texel on; or from its border, of steps.
        let axis = |k: usize| -> (Lines, Option<f64>) {
            let texels = size[k] as usize;
            let (period, wanted) = match [texture.wrap_u, texture.wrap_v][k] {
                Wrap::Repeat => (Some(texels), 0..texels),
                Wrap::Mirror => (Some(2 * texels), 0..2 * texels),
                Wrap::Clamp => (None, 0..texels - usize::from(!texture.nearest)),
            };
            let mut lines = Lines::new(wanted.start as f64..wanted.end as f64, texture.nearest, finer);
            if period.is_none() {
                lines.extend(-reach, texels as f64 + reach);
            }
            (lines, period.map(|period| period as f64))
        };
        let [(across, period_u), (down, period_v)] = [axis(0), axis(1)];
        let alpha = AlphaMap { texture, image };
        let rings = rings([across, down], level, tolerance, &|_, texel| alpha.at(texel));
        let with_bounds = rings.into_iter().map(|ring| {
            let bounds = bounds(&ring);
            (ring, bounds)
        });
        Self { rings: with_bounds.collect(), periods: [period_u, period_v] }
    }

    /// The rings that may meet a box, of all periods; `None` where these are too many.
    fn within(&self, [low, high]: [[f64; 2]; 2]) -> Option<Vec<Ring>> {
        let mut found = Vec::new();
        let mut corners = 0.0;
        for (ring, [from, to]) in &self.rings {
            let [across, down] = [0, 1].map(|k| {
                let Some(period) = self.periods[k] else {
                    return [0.0, if from[k] <= high[k] && to[k] >= low[k] { 0.0 } else { -1.0 }];
                };
                [((low[k] - to[k]) / period).ceil(), ((high[k] - from[k]) / period).floor()]
            });
            let [columns, rows] = [across, down].map(|[first, last]| (last - first + 1.0).max(0.0));
            corners += columns * rows * ring.len() as f64;
            if corners > MOST_CORNERS as f64 {
                return None;
            }
            for at in 0..(columns * rows) as usize {
                let number = [at % columns as usize, at / columns as usize];
                let shift = [0, 1].map(|k| {
                    self.periods[k].map_or(0.0, |period| ([across, down][k][0] + number[k] as f64) * period)
                });
                found.push(ring.iter().map(|[x, y]| [x + shift[0], y + shift[1]]).collect());
            }
        }
        Some(found)
    }
}

/// `primitive`, which has these `facets`, where its alpha reaches `cutoff`, in at most `room` triangles; what is wrong where that
/// cannot be. A metre of it has up to `per_metre` pixels.
fn cut(
    scene: &Scene,
    primitive: &Primitive,
    material: &Material,
    facets: &[Facet],
    (cutoff, per_metre, room): (f64, f64, usize),
    outlines: &mut Outlines,
) -> Result<Cut, &'static str> {
    let mut out = Pieces::new(primitive);
    let map = material.base_color_texture.and_then(|map| {
        let texture = scene.textures.get(map.texture)?;
        let image = scene.images.get(texture.image).filter(|image| image.width > 0 && image.height > 0)?;
        primitive.uvs.get(map.uv_set as usize)?.as_ref()?;
        Some((map, texture, image))
    });
    let placed = |facet: &Facet| {
        let (map, _, image) = map.as_ref()?;
        let size = DVec2::new(image.width.into(), image.height.into());
        let [a, b, c, d] = texels(primitive, facet.corners, map, size)?;
        let mut outline: Ring = [a, b, c, d].map(|p| p.to_array()).to_vec();
        outline.dedup();
        Some(Placed { origin: a, along: DMat2::from_cols(b - a, d - a), outline })
    };
    let finite = |p: &Placed| p.outline.iter().flatten().all(|v| v.abs() < 1e7);
    let reach = facets.iter().filter_map(placed).filter(finite);
    let reach = reach.flat_map(|p| p.outline).flatten().fold(0.0, |m: f64, v| m.max(v.abs()));
    // Facets with equal detail share outlines.
    let metres = facets.iter().map(|facet| area_of(primitive, facet)).sum::<f64>();
    let texels =
        facets.iter().filter_map(placed).map(|own| area(&own.outline).abs()).filter(|a| a.is_finite());
    let per_texel = per_metre * (metres / texels.sum::<f64>().max(1e-12)).sqrt();
    let tolerance = (TOLERANCE_PX / per_texel).clamp(TOLERANCE[0], TOLERANCE[1]).log2().floor().exp2();
    for facet in facets {
        if cutoff <= 0.0 {
            out.keep(facet);
            continue;
        }
        let alphas = facet.corners.map(|c| {
            let colors = primitive.colors.as_ref().and_then(|colors| colors.get(c as usize));
            f64::from(material.base_color[3]) * colors.map_or(1.0, |color| f64::from(color[3]))
        });
        let differ = alphas.iter().any(|a| (a - alphas[0]).abs() > 1e-6);
        let on_map = map.as_ref().zip(placed(facet));
        let (own, rings) = match on_map {
            // Nothing is left of what has no usable texture coordinates.
            Some((_, own)) if !finite(&own) => continue,
            Some(((_, texture, image), own)) if differ && own.has_area() => {
                let rings = own.rings(&AlphaMap { texture, image }, alphas, cutoff, tolerance);
                (own, rings.ok_or(TOO_MANY)?)
            }
            Some(((map, texture, image), own)) if own.has_area() => {
                let level = cutoff / alphas[0];
                // Nor of what is transparent.
                if !level.is_finite() {
                    continue;
                }
                let outline = outlines.of((map.texture, texture, image), level, reach, tolerance);
                let rings = outline.within(bounds(&own.outline));
                (own, rings.ok_or(TOO_MANY)?)
            }
            // All of it shows one place of the texture, or a line of it; or there is none.
            flat => {
                let alpha = flat
                    .map_or(1.0, |((_, texture, image), own)| AlphaMap { texture, image }.at(own.middle()));
                let alphas = alphas.map(|own| own * alpha);
                if !differ {
                    if alphas[0] >= cutoff {
                        out.keep(facet);
                    }
                    continue;
                }
                let own = Placed::alone(primitive, facet);
                let rings = own.rings_of_corners(alphas, cutoff);
                (own, rings)
            }
        };
        outlines.count(&rings)?;
        out.add_within(facet, &own, &rings);
        if out.triangles() > room {
            return Err(TOO_MANY_PIECES);
        }
    }
    Ok(out.cut)
}

/// Area of a facet in square metres.
fn area_of(primitive: &Primitive, facet: &Facet) -> f64 {
    let [a, b, c, d] = facet.corners.map(|c| wide(primitive.positions[c as usize]));
    0.5 * (c - a).cross(d - b).length()
}

/// A primitive that grows by parts of another one.
struct Pieces<'a> {
    of: &'a Primitive,
    cut: Cut,
}

impl<'a> Pieces<'a> {
    /// With all vertices of `of`, and no triangle.
    fn new(of: &'a Primitive) -> Self {
        let primitive = Primitive { indices: Vec::new(), ..of.clone() };
        Self { of, cut: Cut { primitive, blends: Vec::new() } }
    }

    fn triangles(&self) -> usize {
        self.cut.primitive.indices.len() / 3
    }

    /// Adds what of a facet lies within `rings`, but for specks.
    fn add_within(&mut self, facet: &Facet, own: &Placed, rings: &[Ring]) {
        let shapes = rings.overlay(&own.outline, OverlayRule::Intersect, FillRule::NonZero);
        let left: f64 = shapes.iter().flatten().map(|ring| area(ring)).sum::<f64>().abs();
        let whole = area(&own.outline).abs();
        let least = LEAST_AREA.min(LEAST_PART * whole);
        if (left - whole).abs() < least {
            self.keep(facet);
            return;
        }
        let large: Vec<Vec<Ring>> = shapes
            .into_iter()
            .map(|shape| shape.into_iter().filter(|r| area(r).abs() > least).collect::<Vec<_>>())
            .filter(|shape: &Vec<Ring>| !shape.is_empty())
            .collect();
        let mesh = large.triangulate().to_triangulation::<u32>();
        self.add(facet, own, &mesh.points, &mesh.indices);
    }

    /// Adds all of a facet.
    fn keep(&mut self, facet: &Facet) {
        let [a, b, c, d] = facet.corners;
        let indices = &mut self.cut.primitive.indices;
        indices.extend([a, b, c]);
        if d != c {
            indices.extend([a, c, d]);
        }
    }

    /// Adds triangles between `points` of the texture.
    fn add(&mut self, facet: &Facet, placed: &Placed, points: &[[f64; 2]], indices: &[u32]) {
        let first = self.cut.primitive.positions.len() as u32;
        let to_facet = placed.along.inverse();
        for point in points {
            let at = to_facet * (DVec2::from_array(*point) - placed.origin);
            self.corner(facet.corners, at);
        }
        let winding = placed.along.determinant() > 0.0;
        for &[a, b, c] in indices.as_chunks::<3>().0 {
            let corners = [a, b, c].map(|k| points[k as usize]);
            let same = (area(&corners) > 0.0) == winding;
            let (b, c) = if same { (b, c) } else { (c, b) };
            self.cut.primitive.indices.extend([a, b, c].map(|k| first + k));
        }
    }

    /// Adds a vertex at a place of a facet.
    fn corner(&mut self, [a, b, _, d]: [u32; 4], at: DVec2) {
        let own = [a, b, d].map(|c| c as usize);
        let weights = [1.0 - at.x - at.y, at.x, at.y];
        let (of, cut) = (self.of, &mut self.cut.primitive);
        if of.joints.is_some() {
            self.cut.blends.push(([a, b, d], weights));
        }
        blend(&of.positions, &mut cut.positions, own, weights);
        blend(&of.normals, &mut cut.normals, own, weights);
        let tangents = of.tangents.iter().zip(&mut cut.tangents);
        tangents.for_each(|(of, cut)| blend(of, cut, own, weights));
        for (of, cut) in of.uvs.iter().zip(&mut cut.uvs) {
            of.iter().zip(cut).for_each(|(of, cut)| blend(of, cut, own, weights));
        }
        of.colors.iter().zip(&mut cut.colors).for_each(|(of, cut)| blend(of, cut, own, weights));
        for (of, cut) in of.morph_targets.iter().zip(&mut cut.morph_targets) {
            let MorphTarget { positions, normals } = cut;
            blend(&of.positions, positions, own, weights);
            blend(&of.normals, normals, own, weights);
        }
    }
}

/// Adds the mean of three values.
fn blend<const N: usize>(of: &[[f32; N]], to: &mut Vec<[f32; N]>, corners: [usize; 3], weights: [f64; 3]) {
    if of.is_empty() {
        return;
    }
    let mut sum = [0.0; N];
    for (corner, weight) in corners.into_iter().zip(weights) {
        let value = of.get(corner).copied().unwrap_or([0.0; N]);
        (0..N).for_each(|k| sum[k] += f64::from(value[k]) * weight);
    }
    to.push(sum.map(|v| v as f32));
}
