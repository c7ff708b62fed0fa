//! The scene as plain data. Indices refer to the vectors of [`Scene`]; parents come before children.

use std::collections::BTreeMap;

use glam::DMat4;
use half::f16;

use crate::distortion::Distortion;
use crate::error::SceneError;
use crate::factors::{LightFactors, MaterialFactors};
pub use crate::intrinsics::Lens;
use crate::motion::{Motion, Waveform};
use crate::steps::Steps;

pub use crate::factors::ShadingModel;
pub use crate::transform::Trs;

/// Everything that can be seen, and what moves it.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// Name for reports.
    pub name: String,
    /// Nodes, parents before children.
    pub nodes: Vec<Node>,
    /// Triangle meshes.
    pub meshes: Vec<Mesh>,
    /// Materials.
    pub materials: Vec<Material>,
    /// Textures: an image and how it is sampled.
    pub textures: Vec<Texture>,
    /// Decoded images, linear.
    pub images: Vec<Image>,
    /// Skins.
    pub skins: Vec<Skin>,
    /// Lights; a node places each.
    pub lights: Vec<Light>,
    /// Event cameras, in the order in which they are rendered.
    pub cameras: Vec<Camera>,
    /// Names of semantic classes, by [`Node::semantic_id`]; a class that is not in here has none.
    pub class_names: BTreeMap<u32, String>,
    /// Distortion of cameras, by name; a camera that is not in here is a pinhole.
    pub distortions: BTreeMap<String, Distortion>,
    /// Image-based light and sky.
    pub environment: Option<crate::environment::Environment>,
    /// Colour where nothing is hit and no environment is shown; linear RGB.
    pub background: [f32; 3],
    /// Constant light from everywhere, added to diffuse surfaces: irradiance / pi, linear RGB.
    pub ambient: [f32; 3],
    /// Seconds that the scene's motion lasts; `None` where it has no natural end.
    pub duration_s: Option<f64>,
    /// Which of a glTF file's animations plays, as [`crate::gltf::Options::animation`] asks for it; `None` where none does.
    pub animation: Option<String>,
    /// Animations of the glTF file, by the names that [`crate::gltf::Options::animation`] takes; none of a composed scene.
    pub animations: Vec<String>,
    /// How fast the scene's clock runs; `None` for 1. [`Scene::at_speed`] sets it.
    pub speed: Option<f64>,
    /// Variants of the scene, rendered side by side; empty means one, unchanged.
    pub variants: Vec<Variant>,
    /// What the only camera frames, where the scene brings none; `None` for cameras of the scene's own.
    pub framing: Option<Framing>,
    /// How [`Scene::move_cameras`] moved the cameras; `None` where they move as the scene says.
    pub camera_motion: Option<crate::motion::AppliedMotion>,
    /// What a host moves; `None` where everything moves by itself. [`Scene::drive`] sets it.
    pub host_poses: Option<std::sync::Arc<crate::host_poses::HostPoses>>,
    /// How rigid bodies are simulated.
    pub dynamics: crate::rigid_body::Dynamics,
    /// `(node, body)` of rigid bodies that are still to be simulated, which makes motion of them and leaves none here;
    /// [`Scene::check_simulated`] tells.
    pub rigid_bodies: Vec<(usize, crate::rigid_body::RigidBody)>,
    /// What the loader had to say: once each, for the user.
    pub warnings: Vec<String>,
}

/// What a camera frames that the loader has added.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Framing {
    /// All of a model, over its whole motion.
    Model,
    /// A flat picture in the plane z = 0 about the origin, facing +Z.
    Picture {
        /// Half its width and height in metres.
        half_size: [f64; 2],
    },
}

/// A node: a pose over time, and what hangs on it.
#[derive(Clone, Debug, Default)]
pub struct Node {
    /// Name; need not be unique.
    pub name: String,
    /// Index of the parent, always smaller than the node's own.
    pub parent: Option<usize>,
    /// `parent_from_node` over time.
    pub motion: Motion,
    /// Mesh drawn here.
    pub mesh: Option<usize>,
    /// Skin that deforms the mesh; the node's own pose is then ignored (glTF 2.0, 3.7.3.3).
    pub skin: Option<usize>,
    /// Light placed here; it shines along -Z.
    pub light: Option<usize>,
    /// Weights of the mesh's morph targets over time; `None` takes the mesh's own.
    pub morph: Option<crate::motion::Curve>,
    /// Label of what is drawn here; 0 means unlabelled. Instance ids are assigned by [`Scene::validate`] where 0.
    pub instance_id: u32,
    /// Semantic class; 0 means unlabelled.
    pub semantic_id: u32,
}

/// A mesh: primitives that share morph weights.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Name.
    pub name: String,
    /// Parts, each with one material.
    pub primitives: Vec<Primitive>,
    /// Default morph weights.
    pub morph_weights: Vec<f32>,
}

/// Triangles with one material. Every per-vertex vector is as long as `positions`.
#[derive(Clone, Debug, Default)]
pub struct Primitive {
    /// Index into [`Scene::materials`].
    pub material: usize,
    /// Positions in metres.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals; always present (flat ones are generated by loaders).
    pub normals: Vec<[f32; 3]>,
    /// Tangents, w is the bitangent's sign; present where the material has a normal map.
    pub tangents: Option<Vec<[f32; 4]>>,
    /// Texture coordinates, v down (glTF): up to two sets.
    pub uvs: [Option<Vec<[f32; 2]>>; 2],
    /// Linear vertex colours.
    pub colors: Option<Vec<[f32; 4]>>,
    /// Joint indices into the node's skin, four per vertex.
    pub joints: Option<Vec<[u16; 4]>>,
    /// Joint weights, four per vertex, summing to 1.
    pub joint_weights: Option<Vec<[f32; 4]>>,
    /// Displacements of morph targets.
    pub morph_targets: Vec<MorphTarget>,
    /// Triangle list, counter-clockwise from the front.
    pub indices: Vec<u32>,
}

/// One morph target: displacements at weight 1.
#[derive(Clone, Debug, Default)]
pub struct MorphTarget {
    /// Position displacements.
    pub positions: Vec<[f32; 3]>,
    /// Normal displacements; zero where the file has none.
    pub normals: Vec<[f32; 3]>,
}

/// How alpha is read.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AlphaMode {
    /// Alpha is ignored.
    #[default]
    Opaque,
    /// Drawn where alpha reaches the cutoff. Blended materials become this at 0.5, with a warning.
    Mask(f32),
}

/// A material.
#[derive(Clone, Debug)]
pub struct Material {
    /// Name.
    pub name: String,
    /// Shading model.
    pub model: ShadingModel,
    /// Linear base colour and alpha.
    pub base_color: [f32; 4],
    /// Multiplies `base_color`.
    pub base_color_texture: Option<TextureRef>,
    /// 0 dielectric, 1 metal.
    pub metallic: f32,
    /// Perceptual roughness.
    pub roughness: f32,
    /// G roughness, B metallic.
    pub metallic_roughness_texture: Option<TextureRef>,
    /// Tangent-space normals, [0, 1] encoded.
    pub normal_texture: Option<TextureRef>,
    /// Scale of the normal map's x and y.
    pub normal_scale: f32,
    /// R occludes indirect light.
    pub occlusion_texture: Option<TextureRef>,
    /// Strength of the occlusion.
    pub occlusion_strength: f32,
    /// Emitted radiance, linear, strength included.
    pub emissive: [f32; 3],
    /// Multiplies `emissive`.
    pub emissive_texture: Option<TextureRef>,
    /// Multiplies what is emitted (for unlit: the base colour) over time.
    pub emission_waveform: Option<Waveform>,
    /// Alpha.
    pub alpha: AlphaMode,
    /// Back faces are drawn and lit with the flipped normal.
    pub double_sided: bool,
    /// Its factors differ between environments, or a host changes them while the scene runs: [`Scene::validate`] and
    /// [`Scene::leave_to_host`] set it.
    pub driven: bool,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            name: String::new(),
            model: ShadingModel::default(),
            base_color: [1.0; 4],
            base_color_texture: None,
            metallic: 1.0,
            roughness: 1.0,
            metallic_roughness_texture: None,
            normal_texture: None,
            normal_scale: 1.0,
            occlusion_texture: None,
            occlusion_strength: 1.0,
            emissive: [0.0; 3],
            emissive_texture: None,
            emission_waveform: None,
            alpha: AlphaMode::Opaque,
            double_sided: false,
            driven: false,
        }
    }
}

impl Material {
    /// Its factors.
    pub const fn factors(&self) -> MaterialFactors {
        let [r, g, b, _] = self.base_color;
        MaterialFactors {
            base_color: [r, g, b],
            metallic: self.metallic,
            emissive: self.emissive,
            roughness: self.roughness,
        }
    }
}

/// A texture as a material uses it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureRef {
    /// Index into [`Scene::textures`].
    pub texture: usize,
    /// Which UV set, 0 or 1.
    pub uv_set: u32,
    /// KHR_texture_transform as rows of a 2x3 matrix: `uv' = [[m0 m1 m2] [m3 m4 m5]] (u, v, 1)`.
    pub transform: [f32; 6],
}

impl TextureRef {
    /// Texture `texture` on UV set 0, untransformed.
    pub const fn new(texture: usize) -> Self {
        Self { texture, uv_set: 0, transform: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0] }
    }
}

/// What lies beyond [0, 1].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Wrap {
    /// Tiles.
    #[default]
    Repeat,
    /// Tiles, mirrored each time.
    Mirror,
    /// Edge texels.
    Clamp,
}

/// An image and how it is sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Texture {
    /// Index into [`Scene::images`].
    pub image: usize,
    /// Horizontal wrap.
    pub wrap_u: Wrap,
    /// Vertical wrap.
    pub wrap_v: Wrap,
    /// Nearest texel instead of trilinear filtering.
    pub nearest: bool,
}

impl Texture {
    /// Image `image`, filtered, repeated in both directions.
    pub const fn new(image: usize) -> Self {
        Self { image, wrap_u: Wrap::Repeat, wrap_v: Wrap::Repeat, nearest: false }
    }
}

/// A decoded image: linear RGBA, 16-bit float, row-major from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Name or path, for messages.
    pub name: String,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` texels.
    pub texels: Vec<[f16; 4]>,
}

/// A skin.
#[derive(Clone, Debug, Default)]
pub struct Skin {
    /// Nodes that serve as joints.
    pub joints: Vec<usize>,
    /// One per joint.
    pub inverse_bind: Vec<DMat4>,
}

/// Kind of a punctual light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightKind {
    /// Parallel light along the node's -Z; intensity in lux.
    Directional,
    /// Intensity in candela.
    Point,
    /// Intensity in candela; half angles of the full and the zero cone, in radians.
    Spot {
        /// Inside: full intensity.
        inner: f32,
        /// Outside: nothing.
        outer: f32,
    },
}

/// A punctual light (KHR_lights_punctual).
#[derive(Clone, Debug)]
pub struct Light {
    /// Name.
    pub name: String,
    /// Kind.
    pub kind: LightKind,
    /// Linear colour.
    pub color: [f32; 3],
    /// Lux (directional) or candela.
    pub intensity: f32,
    /// Distance in metres beyond which it does not shine; `None` for no limit.
    pub range: Option<f32>,
    /// Whether it throws shadows (directional and spot lights only).
    pub casts_shadow: bool,
    /// Multiplies the intensity over time.
    pub waveform: Option<Waveform>,
}

impl Light {
    /// A steady white light without shadows and without a range.
    pub fn new(name: impl Into<String>, kind: LightKind, intensity: f32) -> Self {
        let name = name.into();
        Self { name, kind, color: [1.0; 3], intensity, range: None, casts_shadow: false, waveform: None }
    }

    /// What it gives.
    pub const fn factors(&self) -> LightFactors {
        LightFactors { color: self.color, intensity: self.intensity, on: true }
    }
}

/// An event camera on a node, looking along the node's -Z.
#[derive(Clone, Debug)]
pub struct Camera {
    /// Unique name.
    pub name: String,
    /// Node that carries it.
    pub node: usize,
    /// Lens.
    pub lens: Lens,
    /// Width in pixels; `None` leaves it to the caller (640).
    pub width: Option<u32>,
    /// Height in pixels; `None` leaves it to the caller (480).
    pub height: Option<u32>,
    /// Width over height that the file asks for, where it gives no size.
    pub aspect: Option<f64>,
    /// Near plane in metres.
    pub near: f64,
    /// ON threshold of this camera, where it differs from the run's.
    pub threshold_on: Option<f32>,
    /// OFF threshold of this camera, where it differs from the run's.
    pub threshold_off: Option<f32>,
    /// The sensor that the scene gives it; `None` leaves it to the run.
    pub sensor: Option<CameraSensor>,
}

impl Camera {
    /// A camera on node `node` that leaves size, thresholds and sensor to the run, with a near plane at 1 cm.
    pub fn new(name: impl Into<String>, node: usize, lens: Lens) -> Self {
        Self {
            name: name.into(),
            node,
            lens,
            width: None,
            height: None,
            aspect: None,
            near: 0.01,
            threshold_on: None,
            threshold_off: None,
            sensor: None,
        }
    }
}

/// A sensor as a scene names it: whoever knows sensors reads it.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraSensor {
    /// Which.
    pub kind: SensorKind,
    /// Where the scene says so, for messages: file, table and key.
    pub place: String,
}

/// How a scene names a sensor.
#[derive(Clone, Debug, PartialEq)]
pub enum SensorKind {
    /// A preset, by name.
    Preset(String),
    /// A sensor as TOML.
    Toml(String),
}

/// One environment of a batch: the same scene with some nodes moved, other materials, lights and lenses, and its own clock.
#[derive(Clone, Debug, Default)]
pub struct Variant {
    /// Added to the run's seed.
    pub seed_offset: u64,
    /// Added to the scene's time, in seconds.
    pub time_offset_s: f64,
    /// `(node, offset)`: the node's motion is taken as `offset * motion(t)`.
    pub node_offsets: Vec<(usize, DMat4)>,
    /// `(node, poses)` of nodes that a host moves.
    pub poses: Vec<(usize, std::sync::Arc<crate::track::Track>)>,
    /// `(material, factors)` of materials that are otherwise here, or that a host changes.
    pub factors: Vec<(usize, std::sync::Arc<Steps<MaterialFactors>>)>,
    /// `(light, factors)` of lights that are otherwise here, or that a host changes.
    pub lights: Vec<(usize, std::sync::Arc<Steps<LightFactors>>)>,
    /// `(camera, lens)` of cameras whose lens is another here, or that a host may give another one.
    pub lenses: Vec<(usize, std::sync::Arc<Steps<Lens>>)>,
}

impl Variant {
    /// With other factors of material `material` (an index).
    #[must_use]
    pub fn with_material(mut self, material: usize, factors: MaterialFactors) -> Self {
        self.factors.push((material, std::sync::Arc::new(Steps::new(factors))));
        self
    }

    /// With other factors of light `light` (an index).
    #[must_use]
    pub fn with_light(mut self, light: usize, factors: LightFactors) -> Self {
        self.lights.push((light, std::sync::Arc::new(Steps::new(factors))));
        self
    }

    /// With another lens of camera `camera` (an index). Intrinsics belong to the camera's own size.
    #[must_use]
    pub fn with_lens(mut self, camera: usize, lens: Lens) -> Self {
        self.lenses.push((camera, std::sync::Arc::new(Steps::new(lens))));
        self
    }
}

impl Scene {
    /// Appends `node` and returns its index.
    pub fn add_node(&mut self, node: Node) -> usize {
        self.nodes.push(node);
        self.nodes.len() - 1
    }

    /// Index of the camera `name`.
    ///
    /// # Errors
    /// Lists the cameras that exist.
    pub fn camera(&self, name: &str) -> Result<usize, SceneError> {
        self.cameras.iter().position(|c| c.name == name).ok_or_else(|| SceneError::Unknown {
            what: "camera",
            name: name.into(),
            known: self.cameras.iter().map(|c| c.name.clone()).collect(),
        })
    }

    /// Index of the node `name`.
    ///
    /// # Errors
    /// Lists the nodes that exist; several nodes of this name.
    pub fn node(&self, name: &str) -> Result<usize, SceneError> {
        let mut found = (0..self.nodes.len()).filter(|&i| self.nodes[i].name == name);
        match (found.next(), found.next()) {
            (Some(node), None) => Ok(node),
            (Some(_), Some(_)) => Err(SceneError::Rule(format!(
                "more than one node is named '{name}'; give the one that is meant a name of its own"
            ))),
            (None, _) => Err(SceneError::Unknown {
                what: "node",
                name: name.into(),
                known: self.nodes.iter().map(|n| n.name.clone()).filter(|n| !n.is_empty()).collect(),
            }),
        }
    }

    /// Node of the camera `name`, or where there is none, the node `name`.
    ///
    /// # Errors
    /// As [`Scene::node`].
    pub fn camera_or_node(&self, name: &str) -> Result<usize, SceneError> {
        let camera = self.cameras.iter().find(|camera| camera.name == name);
        camera.map_or_else(|| self.node(name), |camera| Ok(camera.node))
    }
}
