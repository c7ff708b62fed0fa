//! Scenes by code: the one way in which scene files, Python and the built-in scenes put a [`Scene`] together.
//!
//! ```
//! use evis_scene::builder::{EventCamera, Placement, SceneBuilder};
//! use evis_scene::primitive::Shape;
//! use evis_scene::procedural::{Pattern, Procedural};
//! use evis_scene::{Material, SceneError};
//!
//! # fn main() -> Result<(), SceneError> {
//! let mut scene = SceneBuilder::new("shelf");
//! let bricks = scene.procedural("bricks", &Procedural::new(Pattern::Bricks, 256, 1), Default::default())?;
//! let wall = scene.material(Material::diffuse("wall").textured(bricks))?;
//! scene.shape("wall", Shape::Card { size: [4.0, 3.0] }, wall, Placement::at([0.0, 0.0, -3.0]))?;
//! scene.ambient([1.0; 3])?;
//! scene.camera(EventCamera::new("left").size(320, 240), Placement::default())?;
//! let scene = scene.build()?;
//! # assert_eq!(scene.cameras.len(), 1);
//! # Ok(())
//! # }
//! ```

mod camera;
mod check;
mod placement;

use std::path::Path as FilePath;

use glam::DMat4;

use crate::environment::Environment;
use crate::error::SceneError;
use crate::factors::{light_color, within};
use crate::model::{
    Camera, Image, Light, LightKind, Material, Mesh, Node, Scene, ShadingModel, Texture, TextureRef, Trs,
    Variant, Wrap,
};
use crate::motion::Waveform;
use crate::primitive::Shape;
use crate::procedural::Procedural;
use crate::rigid_body::Dynamics;

pub use camera::EventCamera;
pub(crate) use check::check_camera;
use check::{
    check_body, check_light, check_material, check_primitive, check_trs, finite, finite_vector, in_object,
    not_negative, positive, rule, texture_references,
};
pub use placement::{Placement, look_rotation, still};

/// How a texture is read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sampling {
    /// Beyond the left and right edge.
    pub wrap_u: Wrap,
    /// Beyond the upper and lower edge.
    pub wrap_v: Wrap,
    /// Nearest texel instead of trilinear filtering.
    pub nearest: bool,
}

/// What the numbers of an image file mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ColorSpace {
    /// Colours as screens show them (IEC 61966-2-1); linearised when loaded.
    #[default]
    Srgb,
    /// Numbers as they are: normals, roughness, measured light.
    Linear,
}

/// How a glTF or other scene's nodes are labelled when it is included.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Labels {
    /// Semantic class of what has none of its own; 0 leaves it unlabelled.
    pub semantic_id: u32,
    /// Instance; 0 lets [`Scene::validate`] number it.
    pub instance_id: u32,
}

/// An environment map's settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnvironmentSettings {
    /// Factor on its light.
    pub intensity: f32,
    /// Turn about +Y, degrees.
    pub rotation_degrees: f32,
    /// Whether it is seen behind everything.
    pub visible: bool,
}

impl Default for EnvironmentSettings {
    fn default() -> Self {
        Self { intensity: 1.0, rotation_degrees: 0.0, visible: true }
    }
}

impl Material {
    /// Shows its colour, whatever the light.
    pub fn unlit(name: impl Into<String>) -> Self {
        Self { name: name.into(), model: ShadingModel::Unlit, metallic: 0.0, ..Self::default() }
    }

    /// Matt.
    pub fn diffuse(name: impl Into<String>) -> Self {
        Self { name: name.into(), model: ShadingModel::Diffuse, metallic: 0.0, ..Self::default() }
    }

    /// glTF's metallic-roughness.
    pub fn glossy(name: impl Into<String>, metallic: f32, roughness: f32) -> Self {
        Self { name: name.into(), metallic, roughness, ..Self::default() }
    }

    /// With this texture (index into [`Scene::textures`]) as its colour.
    pub fn textured(self, texture: usize) -> Self {
        Self { base_color_texture: Some(TextureRef::new(texture)), ..self }
    }

    /// With this linear colour, opaque.
    pub fn colored(self, [r, g, b]: [f32; 3]) -> Self {
        Self { base_color: [r, g, b, 1.0], ..self }
    }

    /// Emitting this radiance, changing with `waveform`.
    pub fn emitting(self, emissive: [f32; 3], waveform: Option<Waveform>) -> Self {
        Self { emissive, emission_waveform: waveform, ..self }
    }
}

impl Light {
    /// Parallel light, white, without shadows.
    pub fn directional(name: impl Into<String>, lux: f32) -> Self {
        Self::new(name, LightKind::Directional, lux)
    }

    /// Light from a point, white.
    pub fn point(name: impl Into<String>, candela: f32) -> Self {
        Self::new(name, LightKind::Point, candela)
    }

    /// A cone of light, white, without shadows; half angles in degrees.
    pub fn spot(name: impl Into<String>, candela: f32, inner_degrees: f32, outer_degrees: f32) -> Self {
        let kind = LightKind::Spot { inner: inner_degrees.to_radians(), outer: outer_degrees.to_radians() };
        Self::new(name, kind, candela)
    }

    /// With this linear colour.
    pub fn colored(self, color: [f32; 3]) -> Self {
        Self { color, ..self }
    }

    /// Throwing shadows.
    pub fn with_shadow(self) -> Self {
        Self { casts_shadow: true, ..self }
    }

    /// Changing with `waveform`.
    pub fn flickering(self, waveform: Waveform) -> Self {
        Self { waveform: Some(waveform), ..self }
    }
}

/// Puts a [`Scene`] together; every call checks what it is given.
#[derive(Clone, Debug, Default)]
pub struct SceneBuilder {
    scene: Scene,
    /// Nodes that were added by name, for [`SceneBuilder::find`].
    named: Vec<(String, usize)>,
    shapes: Vec<(ShapeKey, usize)>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct ShapeKey {
    shape: Shape,
    segments: Option<[u32; 2]>,
    uv_repeat: [f64; 2],
    material: usize,
}

/// Everything about a shape that is not its size or place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShapeSettings {
    /// See [`Shape::default_segments`].
    pub segments: Option<[u32; 2]>,
    /// How often the picture repeats along u and v.
    pub uv_repeat: [f64; 2],
    /// Labels.
    pub labels: Labels,
}

impl Default for ShapeSettings {
    fn default() -> Self {
        Self { segments: None, uv_repeat: [1.0; 2], labels: Labels::default() }
    }
}

impl ShapeSettings {
    /// Of the semantic class `id`.
    pub fn semantic(id: u32) -> Self {
        Self { labels: Labels { semantic_id: id, instance_id: 0 }, ..Self::default() }
    }

    /// With the picture repeated.
    pub fn repeat(self, u: f64, v: f64) -> Self {
        Self { uv_repeat: [u, v], ..self }
    }

    /// Cut into so many segments.
    pub fn segments(self, u: u32, v: u32) -> Self {
        Self { segments: Some([u, v]), ..self }
    }
}

impl SceneBuilder {
    /// An empty scene.
    pub fn new(name: impl Into<String>) -> Self {
        Self { scene: Scene { name: name.into(), ..Scene::default() }, ..Self::default() }
    }

    /// The scene as it stands.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Seconds that the scene lasts.
    ///
    /// # Errors
    /// A duration that is not a positive number.
    pub fn duration_s(&mut self, duration_s: f64) -> Result<&mut Self, SceneError> {
        positive("duration_s", duration_s, "seconds")?;
        self.scene.duration_s = Some(duration_s);
        Ok(self)
    }

    /// Calls the semantic class `id` `name`: recordings with semantic labels store it.
    ///
    /// # Errors
    /// An empty name, the id 0 (which labels nothing), an id that has another name, a name that another id has.
    pub fn class_name(&mut self, id: u32, name: &str) -> Result<&mut Self, SceneError> {
        if id == 0 || name.is_empty() {
            return rule(format!("class '{name}' has the id {id}; a class takes a name, and an id above 0"));
        }
        let names = &mut self.scene.class_names;
        if let Some((other, _)) = names.iter().find(|(other, known)| *known == name && **other != id) {
            return rule(format!("class '{name}' has the ids {other} and {id}; each name takes one id"));
        }
        match names.insert(id, name.to_owned()) {
            Some(other) if other != name => {
                rule(format!("the classes '{other}' and '{name}' both have the id {id}; each takes its own"))
            }
            _ => Ok(self),
        }
    }

    /// Id of the semantic class `name`.
    ///
    /// # Errors
    /// Lists the classes that have a name.
    pub fn find_class(&self, name: &str) -> Result<u32, SceneError> {
        let names = &self.scene.class_names;
        names.iter().find(|(_, known)| *known == name).map(|(id, _)| *id).ok_or_else(|| SceneError::Unknown {
            what: "class",
            name: name.into(),
            known: names.values().cloned().collect(),
        })
    }

    /// Colour where nothing is.
    ///
    /// # Errors
    /// A colour that is negative or not finite.
    pub fn background(&mut self, color: [f32; 3]) -> Result<&mut Self, SceneError> {
        light_color("background", color)?;
        self.scene.background = color;
        Ok(self)
    }

    /// Light from everywhere: irradiance / pi.
    ///
    /// # Errors
    /// A colour that is negative or not finite.
    pub fn ambient(&mut self, color: [f32; 3]) -> Result<&mut Self, SceneError> {
        light_color("ambient", color)?;
        self.scene.ambient = color;
        Ok(self)
    }

    /// How rigid bodies are simulated.
    ///
    /// # Errors
    /// A gravity that is not finite, a rate or substeps out of range.
    pub fn dynamics(&mut self, dynamics: Dynamics) -> Result<&mut Self, SceneError> {
        finite_vector("gravity", dynamics.gravity)?;
        within("length of gravity", dynamics.gravity.length(), 0.0, 1000.0)?;
        within("rate_hz", dynamics.rate_hz, 100.0, 100_000.0)?;
        within("substeps", dynamics.substeps.into(), 1.0, 64.0)?;
        self.scene.dynamics = dynamics;
        Ok(self)
    }

    /// Image-based light.
    pub fn environment(&mut self, environment: Environment) -> &mut Self {
        self.scene.environment = Some(environment);
        self
    }

    /// Image-based light from an OpenEXR or Radiance file.
    ///
    /// # Errors
    /// A file that cannot be read, settings that are negative or not finite.
    pub fn environment_file(
        &mut self,
        path: &FilePath,
        settings: EnvironmentSettings,
    ) -> Result<&mut Self, SceneError> {
        not_negative("intensity", settings.intensity.into(), "a factor")?;
        finite("rotation_degrees", settings.rotation_degrees.into())?;
        let environment = load_environment(path, settings, &mut self.scene.warnings)?;
        Ok(self.environment(environment))
    }

    /// A texture from pixels; returns its index.
    ///
    /// # Errors
    /// An image without texels, or with another number of them than its size says.
    pub fn texture(&mut self, image: Image, sampling: Sampling) -> Result<usize, SceneError> {
        let expected = u64::from(image.width) * u64::from(image.height);
        if expected == 0 || image.texels.len() as u64 != expected {
            return rule(format!(
                "image '{}' is {} x {} and has {} texels; it takes width * height of them, at least 1",
                image.name,
                image.width,
                image.height,
                image.texels.len()
            ));
        }
        self.scene.images.push(image);
        let Sampling { wrap_u, wrap_v, nearest } = sampling;
        self.scene.textures.push(Texture { image: self.scene.images.len() - 1, wrap_u, wrap_v, nearest });
        Ok(self.scene.textures.len() - 1)
    }

    /// A texture made by code; returns its index.
    ///
    /// # Errors
    /// See [`Procedural::image`].
    pub fn procedural(
        &mut self,
        name: impl Into<String>,
        procedural: &Procedural,
        sampling: Sampling,
    ) -> Result<usize, SceneError> {
        let image = procedural.image(name)?;
        self.texture(image, sampling)
    }

    /// A texture from an image file; returns its index.
    ///
    /// # Errors
    /// A file that cannot be read or decoded.
    pub fn texture_file(
        &mut self,
        path: &FilePath,
        color_space: ColorSpace,
        sampling: Sampling,
    ) -> Result<usize, SceneError> {
        let image = load_image(path, color_space)?;
        self.texture(image, sampling)
    }

    /// The same, under a name of its own.
    ///
    /// # Errors
    /// See [`SceneBuilder::texture_file`].
    pub fn texture_file_as(
        &mut self,
        name: impl Into<String>,
        path: &FilePath,
        color_space: ColorSpace,
        sampling: Sampling,
    ) -> Result<usize, SceneError> {
        let image = Image { name: name.into(), ..load_image(path, color_space)? };
        self.texture(image, sampling)
    }

    /// Index of the texture whose image is named `name`.
    ///
    /// # Errors
    /// Lists the textures that exist.
    pub fn find_texture(&self, name: &str) -> Result<usize, SceneError> {
        let image_name = |t: &Texture| self.scene.images.get(t.image).map_or("", |i| i.name.as_str());
        let textures = &self.scene.textures;
        textures.iter().position(|t| image_name(t) == name).ok_or_else(|| SceneError::Unknown {
            what: "texture",
            name: name.into(),
            known: textures.iter().map(|t| image_name(t).to_owned()).collect(),
        })
    }

    /// A material; returns its index.
    ///
    /// # Errors
    /// Numbers out of range, textures that do not exist.
    pub fn material(&mut self, material: Material) -> Result<usize, SceneError> {
        check_material(&material, self.scene.textures.len())?;
        self.scene.materials.push(material);
        Ok(self.scene.materials.len() - 1)
    }

    /// Index of the material `name`.
    ///
    /// # Errors
    /// Lists the materials that exist.
    pub fn find_material(&self, name: &str) -> Result<usize, SceneError> {
        let materials = &self.scene.materials;
        materials.iter().position(|m| m.name == name).ok_or_else(|| SceneError::Unknown {
            what: "material",
            name: name.into(),
            known: materials.iter().map(|m| m.name.clone()).collect(),
        })
    }

    /// Indices of the material that was added as `name`, and of what was made of it for flat shapes.
    ///
    /// # Errors
    /// As [`SceneBuilder::find_material`].
    pub fn find_materials(&self, name: &str) -> Result<Vec<usize>, SceneError> {
        let both = both_sides(name);
        let others = self.scene.materials.iter().enumerate().filter(|(_, m)| m.name == both);
        Ok(std::iter::once(self.find_material(name)?).chain(others.map(|(index, _)| index)).collect())
    }

    /// Whether a node was added as `name`.
    pub fn has_object(&self, name: &str) -> bool {
        self.named.iter().any(|(n, _)| n == name)
    }

    /// Index of the node that was added as `name`, else of the only node of an included scene with that name.
    ///
    /// # Errors
    /// Lists the nodes that were added.
    pub fn find(&self, name: &str) -> Result<usize, SceneError> {
        if let Some((_, node)) = self.named.iter().find(|(n, _)| n == name) {
            return Ok(*node);
        }
        let mut inner = self.scene.nodes.iter().enumerate().filter(|(_, n)| n.name == name);
        match (inner.next(), inner.next()) {
            (Some((node, _)), None) => Ok(node),
            (Some(_), Some(_)) => rule(format!(
                "more than one node is named '{name}'; give the one that is meant its own name, or use its parent"
            )),
            _ => Err(SceneError::Unknown {
                what: "object",
                name: name.into(),
                known: self.named.iter().map(|(n, _)| n.clone()).collect(),
            }),
        }
    }

    /// An empty node that others can hang on; returns its index.
    ///
    /// # Errors
    /// A name that is empty or taken, a pose or path that is not usable, a parent that does not exist.
    pub fn node(&mut self, name: impl Into<String>, placement: Placement) -> Result<usize, SceneError> {
        self.place(name.into(), &placement, Node::default())
    }

    /// `shape` with `material`; returns its node.
    ///
    /// # Errors
    /// See [`SceneBuilder::shape_with`].
    pub fn shape(
        &mut self,
        name: impl Into<String>,
        shape: Shape,
        material: usize,
        placement: Placement,
    ) -> Result<usize, SceneError> {
        self.shape_with(name, shape, material, ShapeSettings::default(), placement)
    }

    /// `shape` with `material` and settings; returns its node. Equal shapes share their mesh.
    /// Shapes without an inside make their material double-sided.
    ///
    /// # Errors
    /// See [`Shape::build`] and [`SceneBuilder::node`]; a material that does not exist.
    pub fn shape_with(
        &mut self,
        name: impl Into<String>,
        shape: Shape,
        material: usize,
        settings: ShapeSettings,
        placement: Placement,
    ) -> Result<usize, SceneError> {
        let ShapeSettings { segments, uv_repeat, labels } = settings;
        let Some(found) = self.scene.materials.get(material) else {
            return rule(format!(
                "material {material} does not exist; there are {}",
                self.scene.materials.len()
            ));
        };
        let mut material = material;
        if shape.is_double_sided() && !found.double_sided {
            let both = Material { double_sided: true, name: both_sides(&found.name), ..found.clone() };
            let known = self.scene.materials.iter().position(|m| m.name == both.name && m.double_sided);
            material = match known {
                Some(index) => index,
                None => self.material(both)?,
            };
        }
        let key = ShapeKey { shape, segments, uv_repeat, material };
        let mesh = match self.shapes.iter().find(|(k, _)| *k == key) {
            Some((_, mesh)) => *mesh,
            None => {
                let mut primitive = shape.build(segments, uv_repeat)?;
                primitive.material = material;
                let mesh = self.mesh(Mesh {
                    name: shape.name().into(),
                    primitives: vec![primitive],
                    ..Mesh::default()
                })?;
                self.shapes.push((key, mesh));
                mesh
            }
        };
        let mut placement = placement;
        if let Some(body) = &mut placement.rigid_body {
            body.collider.get_or_insert(shape.collider());
        }
        self.object(name, mesh, labels, placement)
    }

    /// A mesh made elsewhere; returns its index. Tangents are dropped where no normal map needs them.
    ///
    /// # Errors
    /// A primitive whose material or vertices do not exist.
    pub fn mesh(&mut self, mut mesh: Mesh) -> Result<usize, SceneError> {
        for primitive in &mut mesh.primitives {
            check_primitive(primitive)?;
            match self.scene.materials.get(primitive.material) {
                Some(material) if material.normal_texture.is_none() => primitive.tangents = None,
                Some(_) => {}
                None => {
                    return rule(format!(
                        "mesh '{}' uses material {}; there are {}",
                        mesh.name,
                        primitive.material,
                        self.scene.materials.len()
                    ));
                }
            }
        }
        self.scene.meshes.push(mesh);
        Ok(self.scene.meshes.len() - 1)
    }

    /// A node that shows mesh `mesh`; returns its index.
    ///
    /// # Errors
    /// See [`SceneBuilder::node`]; a mesh that does not exist.
    pub fn object(
        &mut self,
        name: impl Into<String>,
        mesh: usize,
        labels: Labels,
        placement: Placement,
    ) -> Result<usize, SceneError> {
        if mesh >= self.scene.meshes.len() {
            return rule(format!("mesh {mesh} does not exist; there are {}", self.scene.meshes.len()));
        }
        let Labels { semantic_id, instance_id } = labels;
        self.place(
            name.into(),
            &placement,
            Node { mesh: Some(mesh), semantic_id, instance_id, ..Node::default() },
        )
    }

    /// A glTF file under a node of its own, playing `animation` (by name or index; `None` plays the first); returns
    /// that node.
    ///
    /// # Errors
    /// A file that cannot be used, an animation that does not exist; see [`SceneBuilder::include`].
    pub fn gltf(
        &mut self,
        name: impl Into<String>,
        path: &FilePath,
        animation: Option<&str>,
        labels: Labels,
        placement: Placement,
    ) -> Result<usize, SceneError> {
        let scene = load_gltf(path, animation)?;
        self.include(name, scene, labels, placement)
    }

    /// Everything of `scene` under a node of its own; returns that node. Its cameras come along as `name/camera`;
    /// its environment and background only where there is none yet; its variants do not.
    ///
    /// # Errors
    /// See [`SceneBuilder::node`].
    pub fn include(
        &mut self,
        name: impl Into<String>,
        scene: Scene,
        labels: Labels,
        placement: Placement,
    ) -> Result<usize, SceneError> {
        let name = name.into();
        let root = self.node(name.clone(), placement)?;
        let own = &mut self.scene;
        let [nodes, meshes, materials, textures, images, skins, lights] = [
            own.nodes.len(),
            own.meshes.len(),
            own.materials.len(),
            own.textures.len(),
            own.images.len(),
            own.skins.len(),
            own.lights.len(),
        ];
        own.images.extend(scene.images);
        own.textures.extend(scene.textures.into_iter().map(|t| Texture { image: t.image + images, ..t }));
        own.materials.extend(scene.materials.into_iter().map(|mut material| {
            for reference in texture_references(&mut material) {
                reference.texture += textures;
            }
            material
        }));
        own.meshes.extend(scene.meshes.into_iter().map(|mut mesh| {
            mesh.primitives.iter_mut().for_each(|p| p.material += materials);
            mesh
        }));
        own.skins.extend(scene.skins.into_iter().map(|mut skin| {
            skin.joints.iter_mut().for_each(|joint| *joint += nodes);
            skin
        }));
        own.lights.extend(scene.lights);
        own.rigid_bodies.extend(scene.rigid_bodies.into_iter().map(|(node, body)| (node + nodes, body)));
        own.nodes.extend(scene.nodes.into_iter().map(|mut node| {
            node.parent = Some(node.parent.map_or(root, |parent| parent + nodes));
            node.mesh = node.mesh.map(|mesh| mesh + meshes);
            node.skin = node.skin.map(|skin| skin + skins);
            node.light = node.light.map(|light| light + lights);
            if node.mesh.is_some() {
                node.semantic_id = if node.semantic_id == 0 { labels.semantic_id } else { node.semantic_id };
                node.instance_id =
                    if labels.instance_id == 0 { node.instance_id } else { labels.instance_id };
            }
            node
        }));
        for (id, class) in scene.class_names {
            let known = own.class_names.entry(id).or_insert_with(|| class.clone());
            if *known != class {
                own.warnings.push(format!(
                    "{name}: class {id} is '{class}' there and '{known}' in this scene; '{known}' counts"
                ));
            }
        }
        let distortions = scene.distortions.into_iter();
        own.distortions.extend(distortions.map(|(camera, of)| (format!("{name}/{camera}"), of)));
        own.cameras.extend(scene.cameras.into_iter().map(|mut camera| {
            camera.name = format!("{name}/{}", camera.name);
            camera.node += nodes;
            camera
        }));
        own.environment = own.environment.take().or(scene.environment);
        if own.background == [0.0; 3] {
            own.background = scene.background;
        }
        own.duration_s = match (own.duration_s, scene.duration_s) {
            (Some(a), Some(b)) => Some(a.max(b)),
            (a, b) => a.or(b),
        };
        own.warnings.extend(scene.warnings.into_iter().map(|w| format!("{name}: {w}")));
        Ok(root)
    }

    /// A light; returns its node. It shines along the node's -Z.
    ///
    /// # Errors
    /// See [`SceneBuilder::node`]; numbers out of range.
    pub fn light(&mut self, light: Light, placement: Placement) -> Result<usize, SceneError> {
        check_light(&light)?;
        let name = light.name.clone();
        let node = Node { light: Some(self.scene.lights.len()), ..Node::default() };
        let node = self.place(name, &placement, node)?;
        self.scene.lights.push(light);
        Ok(node)
    }

    /// An event camera; returns its node. It looks along the node's -Z.
    ///
    /// # Errors
    /// See [`SceneBuilder::node`]; numbers out of range.
    pub fn camera(&mut self, camera: EventCamera, placement: Placement) -> Result<usize, SceneError> {
        check_camera(&camera)?;
        if self.scene.cameras.iter().any(|c| c.name == camera.name) {
            return rule(format!("two cameras are named '{}'; each needs its own name", camera.name));
        }
        let node = self.place(camera.name.clone(), &placement, Node::default())?;
        if let Some(distortion) = camera.distortion {
            self.scene.distortions.insert(camera.name.clone(), distortion);
        }
        self.scene.cameras.push(Camera {
            width: camera.size.map(|s| s[0]),
            height: camera.size.map(|s| s[1]),
            near: camera.near,
            threshold_on: camera.thresholds[0],
            threshold_off: camera.thresholds[1],
            sensor: camera.sensor,
            ..Camera::new(camera.name, node, camera.lens)
        });
        Ok(node)
    }

    /// One more environment of the batch.
    ///
    /// # Errors
    /// A time offset that is negative or not finite; nodes, materials, lights and cameras that do not exist, and values that these
    /// cannot have.
    pub fn variant(&mut self, variant: Variant) -> Result<&mut Self, SceneError> {
        not_negative("time_offset_s", variant.time_offset_s, "seconds")?;
        for (node, offset) in &variant.node_offsets {
            if *node >= self.scene.nodes.len() {
                return rule(format!("a variant moves node {node}; there are {}", self.scene.nodes.len()));
            }
            if !offset.is_finite() {
                return rule(format!("a variant's offset of node {node} is not finite"));
            }
        }
        self.scene.check_variant(&variant)?;
        self.scene.variants.push(variant);
        Ok(self)
    }

    /// The finished scene, validated; it gets a framing camera where it has none.
    ///
    /// # Errors
    /// Cameras that share a name; see [`Scene::validate`].
    pub fn build(self) -> Result<Scene, SceneError> {
        let mut scene = self.scene;
        let mut names: Vec<&str> = scene.cameras.iter().map(|c| c.name.as_str()).collect();
        names.sort_unstable();
        if let Some([name, _]) = names.array_windows().find(|[a, b]| a == b) {
            return rule(format!("two cameras are named '{name}'; each needs its own name"));
        }
        scene.validate()?;
        scene.frame_if_unseen();
        Ok(scene)
    }

    fn place(&mut self, name: String, placement: &Placement, node: Node) -> Result<usize, SceneError> {
        if name.is_empty() {
            return rule("an object has an empty name; give it one".into());
        }
        if self.named.iter().any(|(n, _)| *n == name) {
            return rule(format!("two objects are named '{name}'; each needs its own name"));
        }
        if let Some(parent) = placement.parent
            && parent >= self.scene.nodes.len()
        {
            return rule(format!("parent {parent} of '{name}' does not exist; parents come before children"));
        }
        let motion = placement.motion().map_err(|error| in_object(&name, error))?;
        if let Some(body) = &placement.rigid_body {
            let body = check_body(body, placement.path.is_some()).map_err(|error| in_object(&name, error))?;
            self.scene.rigid_bodies.push((self.scene.nodes.len(), body));
        }
        let index =
            self.scene.add_node(Node { name: name.clone(), parent: placement.parent, motion, ..node });
        self.named.push((name, index));
        Ok(index)
    }
}

// The three loaders live with their formats; this is the one place that calls them.

fn load_gltf(path: &FilePath, animation: Option<&str>) -> Result<Scene, SceneError> {
    let options = crate::gltf::Options { animation: animation.map(str::to_owned), standalone: false };
    crate::gltf::load(path, &options)
}

fn load_image(path: &FilePath, color_space: ColorSpace) -> Result<Image, SceneError> {
    let transfer = match color_space {
        ColorSpace::Srgb => crate::image::Transfer::Srgb,
        ColorSpace::Linear => crate::image::Transfer::Linear,
    };
    crate::image::load(path, transfer)
}

fn load_environment(
    path: &FilePath,
    settings: EnvironmentSettings,
    warnings: &mut Vec<String>,
) -> Result<Environment, SceneError> {
    let EnvironmentSettings { intensity, rotation_degrees, visible } = settings;
    let environment = Environment::load_with_warnings(path, warnings)?;
    Ok(Environment { intensity, rotation: rotation_degrees.to_radians(), visible, ..environment })
}

/// Name of what is made of material `name` for shapes that are drawn from both sides.
pub(crate) fn both_sides(name: &str) -> String {
    format!("{name} (both sides)")
}

/// The offset of a variant's node from a pose.
pub fn offset(pose: &Trs) -> Result<DMat4, SceneError> {
    check_trs(pose)?;
    Ok(pose.matrix())
}
