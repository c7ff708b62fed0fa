//! A scene at one instant, seen ray by ray.

use evis_scene::{AlphaMode, Material, MaterialFactors, PixelLens, Primitive, Scene, SceneState, TextureRef};
use glam::{DVec2, DVec3, DVec4};
use rayon::prelude::*;

use super::bvh::enter_box;
use super::geometry::{Geometry, Hit, Object};
use super::pinhole::{Projection, Ray};
use super::shade::{self, Lamp, Surface, rgb};
use super::split_sum::{self, SplitSum};
use super::texture::{TextureFilter, Textures};

/// Rec. ITU-R BT.709-6, item 3.2.
pub const LUMINANCE_WEIGHTS: DVec3 = DVec3::new(0.2126, 0.7152, 0.0722);

/// What is computed beyond the plain picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// How textures are read.
    pub filter: TextureFilter,
    /// Lights that cast shadows do so, sharply: the limit that shadow maps approach.
    pub shadows: bool,
    /// How the split sum is found.
    pub split_sum: SplitSum,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            filter: TextureFilter::Mipmapped { samples: 1.0 },
            shadows: false,
            split_sum: SplitSum::Computed,
        }
    }
}

/// What a ray sees, told apart as its border would be seen: two rays with different kinds have an edge between them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Kind {
    /// 1 + index of the object; 0 for the sky.
    pub object: u32,
    /// Flat face of the object, 0 where it is smooth; see [`Object::face`].
    pub face: u32,
    /// Lamps in shadow, by bit.
    pub shadows: u32,
}

/// What rays of some part of the picture may meet, found once for all of them.
pub(super) trait Shortlist {
    /// The nearest hit at `near` or beyond that `accept` takes.
    fn nearest(&self, ray: &Ray, near: f64, accept: &mut dyn FnMut(&Hit) -> bool) -> Option<Hit>;

    /// Whether anything that `accept` takes lies in `[near, far]` of a ray from triangle `triangle` to `lamp`.
    fn any(
        &self,
        ray: &Ray,
        triangle: usize,
        lamp: &Lamp,
        range: [f64; 2],
        accept: &mut dyn FnMut(&Hit) -> bool,
    ) -> bool;
}

/// A scene at one instant, ready for rays.
pub struct RayCaster<'a> {
    scene: &'a Scene,
    textures: &'a Textures,
    options: Options,
    geometry: Geometry,
    lamps: Vec<Lamp>,
    emission_factor: Vec<f32>,
    /// Of materials, as a host has them then.
    factors: Vec<MaterialFactors>,
}

/// Labels, one sample at each pixel's centre, row-major from the top.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Labels {
    /// Planar z in metres, +inf where nothing.
    pub depth: Vec<f64>,
    /// Instance, 0 where nothing.
    pub instance: Vec<u32>,
    /// Semantic class, 0 where nothing.
    pub semantic: Vec<u32>,
    /// Interpolated world normal, towards the camera; zero where nothing.
    pub normal: Vec<DVec3>,
    /// Which triangle ([`Hit::triangle`]), to tell pixels near an edge.
    pub triangle: Vec<Option<usize>>,
}

impl<'a> RayCaster<'a> {
    /// Prepares `scene` as `state` has it; `textures` are those of `scene`.
    pub fn new(scene: &'a Scene, state: &SceneState, textures: &'a Textures, options: Options) -> Self {
        Self::with_geometry(scene, state, textures, options, Geometry::new(scene, state))
    }

    /// As [`RayCaster::new`], with the geometry of `scene` at `state` given.
    pub fn with_geometry(
        scene: &'a Scene,
        state: &SceneState,
        textures: &'a Textures,
        options: Options,
        geometry: Geometry,
    ) -> Self {
        let lamps = shade::lamps(scene, state);
        Self {
            scene,
            textures,
            options,
            geometry,
            lamps,
            emission_factor: state.emission_factor.clone(),
            factors: state.factors.clone(),
        }
    }

    /// The triangles that rays are cast against.
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// Mean linear RGB per pixel over samples at `offsets` from its centre, in pixels, row-major from the top.
    pub fn color(&self, camera: &dyn Projection, offsets: &[[f64; 2]]) -> Vec<DVec3> {
        self.for_pixels(camera, |center| {
            let sum: DVec3 =
                offsets.iter().map(|o| self.radiance_at(camera, [center[0] + o[0], center[1] + o[1]])).sum();
            sum / offsets.len().max(1) as f64
        })
    }

    /// Mean luminance per pixel; the mean is taken in linear light.
    pub fn luminance(&self, camera: &dyn Projection, offsets: &[[f64; 2]]) -> Vec<f64> {
        self.color(camera, offsets).into_iter().map(|c| c.dot(LUMINANCE_WEIGHTS)).collect()
    }

    /// Linear RGB at one image point.
    pub fn radiance_at(&self, camera: &dyn Projection, pixel: [f64; 2]) -> DVec3 {
        let ray = camera.ray(pixel);
        match self.visible(camera, &ray, None) {
            Some(hit) => self.shade(&hit, &ray, self.shadows_at(&hit, &ray), None),
            None => self.background(&ray),
        }
    }

    /// Luminance at one image point, and of what kind it is.
    pub fn look(&self, camera: &dyn Projection, pixel: [f64; 2]) -> (f64, Kind) {
        self.look_in(camera, pixel, None)
    }

    pub(super) fn look_in(
        &self,
        camera: &dyn Projection,
        pixel: [f64; 2],
        list: Option<&dyn Shortlist>,
    ) -> (f64, Kind) {
        let ray = camera.ray(pixel);
        match self.visible(camera, &ray, list) {
            Some(hit) => {
                let shadows = self.shadows_of(&hit, &ray, list);
                let color = self.shade(&hit, &ray, shadows, list);
                (color.dot(LUMINANCE_WEIGHTS), self.kind_of(&hit, shadows))
            }
            None => (self.background(&ray).dot(LUMINANCE_WEIGHTS), Kind::default()),
        }
    }

    /// Of what kind one image point is; the same as of [`RayCaster::look`], for less.
    pub fn kind(&self, camera: &dyn Projection, pixel: [f64; 2]) -> Kind {
        self.kind_in(camera, pixel, None)
    }

    pub(super) fn kind_in(
        &self,
        camera: &dyn Projection,
        pixel: [f64; 2],
        list: Option<&dyn Shortlist>,
    ) -> Kind {
        let ray = camera.ray(pixel);
        let hit = self.visible(camera, &ray, list);
        hit.map_or(Kind::default(), |hit| self.kind_of(&hit, self.shadows_of(&hit, &ray, list)))
    }

    /// Of what kind is what `ray` sees: `hit`, or the sky.
    pub fn kind_seen(&self, hit: Option<Hit>, ray: &Ray) -> Kind {
        hit.map_or(Kind::default(), |hit| self.kind_of(&hit, self.shadows_at(&hit, ray)))
    }

    fn kind_of(&self, hit: &Hit, shadows: u32) -> Kind {
        let face = self.object(hit).face(hit.triangle);
        Kind { object: hit.object as u32 + 1, face, shadows }
    }

    /// The lamps that throw shadows.
    pub(super) fn shadow_lamps(&self) -> impl Iterator<Item = &Lamp> {
        self.lamps.iter().filter(|lamp| self.options.shadows && lamp.casts_shadow)
    }

    fn background(&self, ray: &Ray) -> DVec3 {
        match &self.scene.environment {
            Some(environment) if environment.visible => environment.radiance(ray.direction),
            _ => rgb(self.scene.background),
        }
    }

    /// What is seen at one image point; the hit's distance is planar depth.
    pub fn hit_at(&self, camera: &dyn Projection, pixel: [f64; 2]) -> Option<Hit> {
        self.visible(camera, &camera.ray(pixel), None)
    }

    /// Which of the lamps that throw shadows, by [`Lamp::shadow_bit`], are hidden from a hit that faces them.
    pub fn shadows_at(&self, hit: &Hit, ray: &Ray) -> u32 {
        self.shadows_of(hit, ray, None)
    }

    fn shadows_of(&self, hit: &Hit, ray: &Ray, list: Option<&dyn Shortlist>) -> u32 {
        if !self.options.shadows {
            return 0;
        }
        let position = ray.origin + ray.direction * hit.distance;
        let normal = self.interpolated_normal(hit);
        self.lamps.iter().filter(|l| l.shadow_bit != 0).fold(0, |mask, lamp| {
            let incident = lamp.incident(position);
            let faces = normal.dot(incident.to_light) > 0.0 && incident.irradiance != DVec3::ZERO;
            if faces && self.blocked(hit, position, lamp, &incident, list) {
                mask | lamp.shadow_bit
            } else {
                mask
            }
        })
    }

    /// Whether the ray through an image point, up to what it hits, or any ray from there to a lamp that throws shadows,
    /// passes one of `boxes` (low, high).
    pub fn passes(&self, camera: &dyn Projection, pixel: [f64; 2], boxes: &[(DVec3, DVec3)]) -> bool {
        let ray = camera.ray(pixel);
        let hit = self.visible(camera, &ray, None);
        let far = hit.map_or(f64::INFINITY, |h| h.distance);
        let meets = |origin: DVec3, direction: DVec3, far: f64| {
            let inverse = direction.recip();
            boxes.iter().any(|bounds| enter_box(*bounds, origin, inverse, 0.0, far).is_some())
        };
        if meets(ray.origin, ray.direction, far) {
            return true;
        }
        let Some(hit) = hit else { return false };
        let position = ray.origin + ray.direction * hit.distance;
        self.lamps.iter().filter(|l| l.casts_shadow).any(|lamp| {
            let incident = lamp.incident(position);
            meets(position, incident.to_light, incident.distance)
        })
    }

    /// Whether `target`, a point of triangle `triangle`, is seen from `camera`: inside the picture, in front of the
    /// near plane, with nothing before it.
    pub fn sees(&self, camera: &dyn Projection, triangle: usize, target: DVec3) -> bool {
        let Some([x, y]) = camera.project(target) else { return false };
        let PixelLens { width, height, .. } = camera.pinhole().lens;
        if !(0.0..width.into()).contains(&x) || !(0.0..height.into()).contains(&y) {
            return false;
        }
        let ray = camera.ray([x, y]);
        // What lies nearer than a part in a thousand is the surface itself, met again by rounding.
        self.visible(camera, &ray, None).is_none_or(|hit| {
            let depth = (target - ray.origin).dot(ray.direction) / ray.direction.length_squared();
            hit.triangle == triangle || hit.distance > depth * (1.0 - 1e-3)
        })
    }

    /// Labels of every pixel.
    pub fn labels(&self, camera: &dyn Projection) -> Labels {
        let mut labels = Labels::default();
        for hit in self.for_pixels(camera, |center| self.hit_at(camera, center)) {
            let object = hit.map(|hit| self.object(&hit));
            labels.depth.push(hit.map_or(f64::INFINITY, |hit| hit.distance));
            labels.instance.push(object.map_or(0, |o| o.instance_id));
            labels.semantic.push(object.map_or(0, |o| o.semantic_id));
            labels.normal.push(hit.map_or(DVec3::ZERO, |hit| self.interpolated_normal(&hit)));
            labels.triangle.push(hit.map(|hit| hit.triangle));
        }
        labels
    }

    /// Per pixel, how far in pixels (x right, y down) what is seen at its centre moves until `other` and
    /// `other_camera`, which are this scene at another time: the same point of the same triangle, projected.
    /// The sky moves with rotation. `None` where the point is then not in front of the camera.
    pub fn flow(
        &self,
        camera: &dyn Projection,
        other: &Geometry,
        other_camera: &dyn Projection,
    ) -> Vec<Option<[f64; 2]>> {
        self.for_pixels(camera, |center| {
            let ray = camera.ray(center);
            let there = seen_from(self.visible(camera, &ray, None), &ray, other, other_camera)?;
            Some([there[0] - center[0], there[1] - center[1]])
        })
    }

    fn for_pixels<T: Send>(&self, camera: &dyn Projection, f: impl Fn([f64; 2]) -> T + Sync) -> Vec<T> {
        let lens = camera.pinhole().lens;
        let (width, height) = (lens.width as usize, lens.height as usize);
        (0..width * height)
            .into_par_iter()
            .map(|i| f([(i % width) as f64 + 0.5, (i / width) as f64 + 0.5]))
            .collect()
    }

    fn visible(&self, camera: &dyn Projection, ray: &Ray, list: Option<&dyn Shortlist>) -> Option<Hit> {
        let (near, far) = (camera.pinhole().lens.near, camera.pinhole().lens.far());
        let mut accept = |hit: &Hit| hit.distance <= far && self.accepts(hit, ray);
        match list {
            Some(list) => list.nearest(ray, near, &mut accept),
            None => self.geometry.nearest(ray.origin, ray.direction, near, far, accept),
        }
    }

    /// Whether what is hit from this side is there.
    pub(super) fn accepts(&self, hit: &Hit, ray: &Ray) -> bool {
        let Some((_, material)) = self.looks(hit) else { return false };
        // glTF 2.0, 3.9.6: without doubleSided, back faces are culled.
        (material.double_sided || hit.front) && self.solid(hit, ray)
    }

    /// Whether nothing behind it is seen past what is hit, wherever on its triangle.
    pub(super) fn closes(&self, hit: &Hit, ray: &Ray) -> bool {
        self.opaque(hit) && self.accepts(hit, ray)
    }

    /// Whether what is hit has no holes.
    pub(super) fn opaque(&self, hit: &Hit) -> bool {
        self.looks(hit).is_some_and(|(_, material)| material.alpha == AlphaMode::Opaque)
    }

    fn object(&self, hit: &Hit) -> &Object {
        &self.geometry.matter().objects[hit.object]
    }

    fn looks(&self, hit: &Hit) -> Option<(&Primitive, &Material)> {
        let object = self.object(hit);
        let primitive = &self.scene.meshes[object.mesh].primitives[object.primitive];
        Some((primitive, self.scene.materials.get(primitive.material)?))
    }

    /// glTF 2.0, 3.9.4: masked surfaces exist where alpha reaches the cutoff.
    fn solid(&self, hit: &Hit, ray: &Ray) -> bool {
        match self.looks(hit) {
            Some((primitive, material)) => match material.alpha {
                AlphaMode::Opaque => true,
                AlphaMode::Mask(cutoff) => {
                    self.base_color(primitive, material, hit, ray).w >= f64::from(cutoff)
                }
            },
            None => false,
        }
    }

    fn factors(&self, primitive: &Primitive, material: &Material) -> MaterialFactors {
        self.factors.get(primitive.material).copied().unwrap_or_else(|| material.factors())
    }

    fn base_color(&self, primitive: &Primitive, material: &Material, hit: &Hit, ray: &Ray) -> DVec4 {
        let factor = rgb(self.factors(primitive, material).base_color).extend(material.base_color[3].into());
        let vertex = primitive.colors.as_ref().map_or(DVec4::ONE, |colors| {
            let corners = self.object(hit).corners(hit.triangle);
            blend(
                hit,
                corners.map(|c| colors.get(c).map_or(DVec4::ONE, |v| DVec4::from_array(v.map(f64::from)))),
            )
        });
        // A hole's border lies where the texture is cut, not where its mean is.
        let filter = match material.alpha {
            AlphaMode::Opaque => self.options.filter,
            AlphaMode::Mask(_) => self.options.filter.at_a_place(),
        };
        let texel = self.texel(primitive, material.base_color_texture, hit, ray, filter);
        factor * vertex * texel.unwrap_or(DVec4::ONE)
    }

    /// The texture's value at a hit; `None` where the material has none or the primitive lacks its coordinates.
    fn texel(
        &self,
        primitive: &Primitive,
        texture: Option<TextureRef>,
        hit: &Hit,
        ray: &Ray,
        filter: TextureFilter,
    ) -> Option<DVec4> {
        let texture = texture?;
        let uvs = primitive.uvs.get(texture.uv_set as usize)?.as_ref()?;
        let corners = self.object(hit).corners(hit.triangle);
        let [a, b, c] =
            corners.map(|i| uvs.get(i).map_or(DVec2::ZERO, |uv| DVec2::from_array(uv.map(f64::from))));
        // KHR_texture_transform.
        let [m0, m1, m2, m3, m4, m5] = texture.transform.map(f64::from);
        let turn = |v: DVec2| DVec2::new(m0 * v.x + m1 * v.y, m3 * v.x + m4 * v.y);
        let uv = turn(blend(hit, [a, b, c])) + DVec2::new(m2, m5);
        let footprint = match filter {
            TextureFilter::BaseLevel => [DVec2::ZERO; 2],
            TextureFilter::Mipmapped { .. } | TextureFilter::Averaged { .. } => [0, 1].map(|axis| {
                let [da, db, dc] = self.barycentric_change(hit, ray, axis);
                turn(a * da + b * db + c * dc)
            }),
        };
        Some(self.textures.sample(self.scene, texture.texture, uv, footprint, filter))
    }

    /// Change of the barycentrics of `hit` per pixel to the right (`axis` 0) or down (1): exact, on the triangle's plane.
    fn barycentric_change(&self, hit: &Hit, ray: &Ray, axis: usize) -> [f64; 3] {
        let (change, shift) = (ray.per_pixel[axis], ray.shift[axis]);
        let [a, b, c] = self.geometry.corners(hit.triangle).map(|v| v.position);
        let (ab, ac) = (b - a, c - a);
        let (s, q) = (ray.origin - a, (ray.origin - a).cross(ab));
        // u = U(s, d) / D(d), v = V(s, d) / D(d), each linear in origin and direction.
        let determinant = ab.dot(ray.direction.cross(ac));
        let slope = ab.dot(change.cross(ac));
        let u = (s.dot(change.cross(ac)) + shift.dot(ray.direction.cross(ac)) - hit.barycentric[1] * slope)
            / determinant;
        let v =
            (change.dot(q) + ray.direction.dot(shift.cross(ab)) - hit.barycentric[2] * slope) / determinant;
        [-u - v, u, v]
    }

    fn interpolated_normal(&self, hit: &Hit) -> DVec3 {
        let normal = blend(hit, self.geometry.corners(hit.triangle).map(|v| v.normal)).normalize_or(DVec3::Z);
        if hit.front { normal } else { -normal }
    }

    /// glTF 2.0, 3.9.3: tangent-space normals, x and y scaled; back faces turn the result (3.9.6).
    fn shading_normal(&self, primitive: &Primitive, material: &Material, hit: &Hit, ray: &Ray) -> DVec3 {
        let facing = self.interpolated_normal(hit);
        let filter = self.options.filter.at_a_place();
        let Some(texel) = self.texel(primitive, material.normal_texture, hit, ray, filter) else {
            return facing;
        };
        let side = if hit.front { 1.0 } else { -1.0 };
        let normal = facing * side;
        let corners = self.geometry.corners(hit.triangle);
        let tangent = blend(hit, corners.map(|v| v.tangent.0));
        let Some(tangent) = (tangent - normal * normal.dot(tangent)).try_normalize() else { return facing };
        let bitangent = normal.cross(tangent) * blend(hit, corners.map(|v| v.tangent.1));
        let local = texel.truncate() * 2.0 - 1.0;
        let scale = f64::from(material.normal_scale);
        let mapped = tangent * (local.x * scale) + bitangent * (local.y * scale) + normal * local.z;
        mapped.normalize_or(normal) * side
    }

    fn shade(&self, hit: &Hit, ray: &Ray, shadows: u32, list: Option<&dyn Shortlist>) -> DVec3 {
        let Some((primitive, material)) = self.looks(hit) else { return DVec3::ZERO };
        let texel = |texture| self.texel(primitive, texture, hit, ray, self.options.filter.at_a_place());
        let emission_factor = self.emission_factor.get(primitive.material).map_or(1.0, |f| f64::from(*f));
        let emissive = self
            .texel(primitive, material.emissive_texture, hit, ray, self.options.filter)
            .map_or(DVec3::ONE, DVec4::truncate);
        let surface_map = texel(material.metallic_roughness_texture).unwrap_or(DVec4::ONE);
        let factors = self.factors(primitive, material);
        let occlusion = texel(material.occlusion_texture)
            .map_or(1.0, |t| 1.0 + f64::from(material.occlusion_strength) * (t.x - 1.0));
        let surface = Surface {
            model: material.model,
            position: ray.origin + ray.direction * hit.distance,
            normal: self.shading_normal(primitive, material, hit, ray),
            to_eye: -ray.direction.normalize(),
            base: self.base_color(primitive, material, hit, ray).truncate(),
            metallic: (f64::from(factors.metallic) * surface_map.z).clamp(0.0, 1.0),
            roughness: (f64::from(factors.roughness) * surface_map.y).clamp(0.0, 1.0),
            occlusion,
            emitted: rgb(factors.emissive) * emissive * emission_factor,
            emission_factor,
        };
        let environment = self.scene.environment.as_ref();
        let facing = self.interpolated_normal(hit);
        let split = |n_dot_v, roughness| split_sum::at(self.options.split_sum, n_dot_v, roughness);
        shade::radiance(
            &surface,
            &self.lamps,
            rgb(self.scene.ambient),
            environment,
            split,
            |lamp, incident| {
                // A lamp that only the normal map faces was not asked before.
                let unasked = lamp.shadow_bit == 0 || facing.dot(incident.to_light) <= 0.0;
                let dark = shadows & lamp.shadow_bit != 0
                    || self.options.shadows
                        && lamp.casts_shadow
                        && unasked
                        && self.blocked(hit, surface.position, lamp, incident, list);
                f64::from(u8::from(!dark))
            },
        )
    }

    /// Whether anything solid, from either side, lies between a surface and a light.
    /// Where a ray from a surface begins: away from it by a part of its distance that f64 resolves and nothing in a
    /// scene is as thin as.
    pub(super) fn start(position: DVec3) -> f64 {
        1e-7 * (1.0 + position.abs().max_element())
    }

    fn blocked(
        &self,
        hit: &Hit,
        position: DVec3,
        lamp: &Lamp,
        incident: &shade::Incident,
        list: Option<&dyn Shortlist>,
    ) -> bool {
        let start = Self::start(position);
        let none = [DVec3::ZERO; 2];
        let ray = Ray { origin: position, direction: incident.to_light, per_pixel: none, shift: none };
        let mut accept = |h: &Hit| h.triangle != hit.triangle && self.solid(h, &ray);
        match list {
            Some(list) => list.any(&ray, hit.triangle, lamp, [start, incident.distance], &mut accept),
            None => self.geometry.any(ray.origin, ray.direction, start, incident.distance, accept),
        }
    }
}

/// Image point, for `camera` and `geometry` of another time, of what `ray` sees: the same point of matter, or the same
/// direction of the sky. `None` where that is not in front of the camera.
pub fn seen_from(
    hit: Option<Hit>,
    ray: &Ray,
    geometry: &Geometry,
    camera: &dyn Projection,
) -> Option<[f64; 2]> {
    match hit {
        Some(hit) => camera.project(geometry.position(hit.triangle, hit.barycentric)),
        None => camera.project_direction(ray.direction),
    }
}

/// The value at a hit of what varies linearly over a triangle.
fn blend<T: std::ops::Mul<f64, Output = T> + std::ops::Add<Output = T>>(hit: &Hit, [a, b, c]: [T; 3]) -> T {
    let [u, v, w] = hit.barycentric;
    a * u + b * v + c * w
}
