//! Scene files: TOML that composes glTF files, shapes, lights, trajectories and event cameras.
//!
//! `docs/scene-files.md` in the repository lists every table and key. Everything goes through
//! [`SceneBuilder`], so a file gives the same scene as the same calls in code.

mod keys;
mod motion;
mod rigid_body;
pub(crate) mod trajectory;

use std::path::Path;

use glam::DMat4;
use toml::{Table, Value};

use self::keys::{Keys, Place, Source, locate};
use crate::builder::{
    ColorSpace, EnvironmentSettings, EventCamera, Labels, Placement, Sampling, SceneBuilder, ShapeSettings,
};
use crate::distortion::Distortion;
use crate::error::SceneError;
use crate::factors::{LightChange, MaterialChange};
use crate::model::{
    AlphaMode, CameraSensor, Lens, Light, LightKind, Material, Scene, SensorKind, ShadingModel, TextureRef,
    Variant, Wrap,
};
use crate::primitive::Shape;
use crate::procedural::{PATTERNS, Procedural};
use crate::rig::Rig;

/// Most environments of one file.
const MAX_ENVIRONMENTS: u64 = 65_536;

/// The scene of the file at `path`; relative paths in it start from its folder.
///
/// # Errors
/// A file that cannot be read; a key that is unknown, missing, of the wrong type or out of range, named with its
/// table and what would work; a file that it names and that cannot be used.
pub fn load(path: impl AsRef<Path>) -> Result<Scene, SceneError> {
    let path = path.as_ref();
    let text = crate::file::text(path).map_err(|source| SceneError::Io { path: path.into(), source })?;
    let base = path.parent().unwrap_or(Path::new(""));
    let name = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
    scene(&Source { file: path, base, text: &text }, &name)
}

/// The scene of `text`; relative paths in it start from `base_dir`.
///
/// # Errors
/// See [`load`].
pub fn parse(text: &str, base_dir: impl AsRef<Path>) -> Result<Scene, SceneError> {
    scene(&Source { file: Path::new("scene text"), base: base_dir.as_ref(), text }, "scene")
}

fn scene(source: &Source<'_>, default_name: &str) -> Result<Scene, SceneError> {
    let syntax = |error: toml::de::Error| SceneError::invalid(source.file, error.to_string().trim_end());
    let table: Table = source.text.parse().map_err(syntax)?;
    let mut top = Keys::new(source, &table);
    let mut scene = SceneBuilder::new(top.text("name")?.unwrap_or(default_name));
    settings(&mut top, &mut scene)?;
    for keys in top.tables("textures")? {
        texture(keys, &mut scene)?;
    }
    for keys in top.tables("materials")? {
        material(keys, &mut scene)?;
    }
    let mut objects = Vec::new();
    for (key, read) in OBJECTS {
        for keys in top.tables(key)? {
            objects.push(object(keys, read)?);
        }
    }
    let environments = top.tables("environments")?;
    top.finish()?;
    add_objects(source, objects, &mut scene)?;
    for keys in environments {
        environment(keys, &mut scene)?;
    }
    scene.build().map_err(|error| locate(source, &Place::default(), error))
}

fn settings(top: &mut Keys<'_>, scene: &mut SceneBuilder) -> Result<(), SceneError> {
    if let Some(duration_s) = top.number("duration_s")? {
        scene.duration_s(duration_s).map_err(|e| top.locate(e))?;
    }
    if let Some(color) = top.color("background")? {
        scene.background(color).map_err(|e| top.locate(e))?;
    }
    if let Some(color) = top.color("ambient")? {
        scene.ambient(color).map_err(|e| top.locate(e))?;
    }
    for (name, id) in top.named_integers("classes", u32::MAX.into())? {
        scene.class_name(id as u32, name).map_err(|e| top.locate(e))?;
    }
    if let Some(keys) = top.table("dynamics")? {
        rigid_body::dynamics(keys, scene)?;
    }
    let Some(mut keys) = top.table("environment_map")? else { return Ok(()) };
    let file = keys.file("file")?;
    let settings = EnvironmentSettings {
        intensity: keys.number_or("intensity", 1.0)? as f32,
        rotation_degrees: keys.number_or("rotation_degrees", 0.0)? as f32,
        visible: keys.flag("visible")?.unwrap_or(true),
    };
    let file = keys.needs("file", file)?;
    scene.environment_file(&file, settings).map_err(|e| keys.locate(e))?;
    keys.finish()
}

fn texture(mut keys: Keys<'_>, scene: &mut SceneBuilder) -> Result<(), SceneError> {
    let name = keys.text("name")?;
    let name = keys.needs("name", name)?;
    if scene.find_texture(name).is_ok() {
        return Err(keys.error("there are two textures of this name; each needs its own"));
    }
    let wraps = [("repeat", Wrap::Repeat), ("mirror", Wrap::Mirror), ("clamp", Wrap::Clamp)];
    let wrap = keys.choice("wrap", &wraps)?.unwrap_or_default();
    let sampling = Sampling {
        wrap_u: keys.choice("wrap_u", &wraps)?.unwrap_or(wrap),
        wrap_v: keys.choice("wrap_v", &wraps)?.unwrap_or(wrap),
        nearest: keys.choice("filter", &[("linear", false), ("nearest", true)])?.unwrap_or(false),
    };
    keys.at_most_one(&["file", "pattern"])?;
    let added = if let Some(pattern) = keys.choice("pattern", &PATTERNS)? {
        let colors = keys.colors("colors")?;
        let procedural = Procedural {
            pattern,
            size: keys.integer("size", 4096)?.unwrap_or(512) as u32,
            seed: keys.integer("seed", i64::MAX as u64)?.unwrap_or(0),
            colors: colors.map_or([None; 2], |[a, b]| [Some(a), Some(b)]),
        };
        scene.procedural(name, &procedural, sampling)
    } else {
        let file = keys.file("file")?;
        let spaces = [("srgb", ColorSpace::Srgb), ("linear", ColorSpace::Linear)];
        let color_space = keys.choice("color_space", &spaces)?.unwrap_or_default();
        let file = keys.needs("file", file)?;
        scene.texture_file_as(name, &file, color_space, sampling)
    };
    added.map_err(|e| keys.locate(e))?;
    keys.finish()
}

fn material(mut keys: Keys<'_>, scene: &mut SceneBuilder) -> Result<(), SceneError> {
    let name = keys.text("name")?;
    let name = keys.needs("name", name)?;
    if scene.find_material(name).is_ok() {
        return Err(keys.error("there are two materials of this name; each needs its own"));
    }
    let models = [ShadingModel::Unlit, ShadingModel::Diffuse, ShadingModel::MetallicRoughness];
    let models = models.map(|model| (model.name(), model));
    let mut material = Material {
        name: name.into(),
        model: keys.choice("model", &models)?.unwrap_or(ShadingModel::Diffuse),
        metallic: 0.0,
        ..Material::default()
    };
    if let Some([r, g, b]) = keys.color("color")? {
        material.base_color = [r, g, b, 1.0];
    }
    material.base_color[3] = keys.number_or("alpha", 1.0)? as f32;
    material.base_color_texture = texture_reference(&mut keys, "texture", scene)?;
    if material.model == ShadingModel::MetallicRoughness {
        material.metallic = keys.number_or("metallic", 0.0)? as f32;
        material.roughness = keys.number_or("roughness", 1.0)? as f32;
        material.metallic_roughness_texture =
            texture_reference(&mut keys, "metallic_roughness_texture", scene)?;
    }
    if material.model != ShadingModel::Unlit {
        material.normal_texture = texture_reference(&mut keys, "normal_texture", scene)?;
        material.normal_scale = keys.number_or("normal_scale", 1.0)? as f32;
        material.occlusion_texture = texture_reference(&mut keys, "occlusion_texture", scene)?;
        material.occlusion_strength = keys.number_or("occlusion_strength", 1.0)? as f32;
        let strength = keys.number_or("emissive_strength", 1.0)? as f32;
        material.emissive = keys.color("emissive")?.unwrap_or_default().map(|c| c * strength);
        material.emissive_texture = texture_reference(&mut keys, "emissive_texture", scene)?;
    }
    material.emission_waveform = motion::waveform(&mut keys, "waveform")?;
    if let Some(cutoff) = keys.number("alpha_cutoff")? {
        material.alpha = AlphaMode::Mask(cutoff as f32);
    }
    material.double_sided = keys.flag("double_sided")?.unwrap_or(false);
    scene.material(material).map_err(|e| keys.locate(e))?;
    keys.finish()
}

fn texture_reference(
    keys: &mut Keys<'_>,
    key: &'static str,
    scene: &SceneBuilder,
) -> Result<Option<TextureRef>, SceneError> {
    let Some(name) = keys.text(key)? else { return Ok(None) };
    scene.find_texture(name).map(|index| Some(TextureRef::new(index))).map_err(|e| keys.locate(e))
}

/// Adds an object to the scene, once its parent is there.
type Add = Box<dyn FnOnce(&mut SceneBuilder, Placement) -> Result<usize, SceneError>>;

/// Reads what is special about one kind of object.
type Read = fn(&mut Keys<'_>) -> Result<(String, Add), SceneError>;

const OBJECTS: [(&str, Read); 6] = [
    ("nodes", node),
    ("gltf", gltf),
    ("primitives", primitive),
    ("lights", light),
    ("cameras", camera),
    ("rigs", rig),
];

/// An object that has been read and not yet been added.
struct Object {
    place: Place,
    name: String,
    parent: Option<String>,
    placement: Placement,
    add: Add,
}

fn object(mut keys: Keys<'_>, read: Read) -> Result<Object, SceneError> {
    let mut placement = motion::placement(&mut keys)?;
    placement.rigid_body = rigid_body::rigid_body(&mut keys)?;
    let parent = keys.text("parent")?.map(str::to_owned);
    let (name, add) = read(&mut keys)?;
    let place = keys.place().clone();
    keys.finish()?;
    Ok(Object { place, name, parent, placement, add })
}

/// Adds parents before children, otherwise in the order of the file.
fn add_objects(
    source: &Source<'_>,
    mut objects: Vec<Object>,
    scene: &mut SceneBuilder,
) -> Result<(), SceneError> {
    while !objects.is_empty() {
        let mut waiting: Vec<Object> = Vec::new();
        let count = objects.len();
        let names: Vec<String> = objects.iter().map(|o| o.name.clone()).collect();
        for object in objects {
            let parent = match &object.parent {
                // A parent that the file names itself comes first, even if a glTF file has a node of that name.
                Some(name) if names.contains(name) && !scene.has_object(name) => {
                    waiting.push(object);
                    continue;
                }
                Some(name) => Some(scene.find(name).map_err(|e| locate(source, &object.place, e))?),
                None => None,
            };
            let placement = Placement { parent, ..object.placement };
            (object.add)(scene, placement).map_err(|e| locate(source, &object.place, e))?;
        }
        if let [first, ..] = waiting.as_slice()
            && waiting.len() == count
        {
            let parent = first.parent.as_deref().unwrap_or_default();
            let reason =
                format!("its parent '{parent}' hangs on it in turn; parents cannot go round in a circle");
            return Err(source.error(&first.place, reason));
        }
        objects = waiting;
    }
    Ok(())
}

fn needed_name(keys: &mut Keys<'_>) -> Result<String, SceneError> {
    let name = keys.text("name")?;
    Ok(keys.needs("name", name)?.to_owned())
}

/// Labels of an object, before the scene tells the ids of classes that it names.
struct LabelKeys {
    labels: Labels,
    /// Name of the class, where it is given instead of an id.
    class: Option<String>,
}

impl LabelKeys {
    fn read(keys: &mut Keys<'_>) -> Result<Self, SceneError> {
        let class = keys.get("semantic_id").and_then(Value::as_str).map(str::to_owned);
        let takes = format!("a whole number between 0 and {}, or the name of a class in [classes]", u32::MAX);
        let semantic_id = match class {
            Some(_) => None,
            None => keys.integer_or_else("semantic_id", u32::MAX.into(), &takes)?,
        };
        let instance_id = keys.integer("instance_id", u32::MAX.into())?;
        let [semantic_id, instance_id] = [semantic_id, instance_id].map(|id| id.unwrap_or(0) as u32);
        Ok(Self { labels: Labels { semantic_id, instance_id }, class })
    }

    fn of(self, scene: &SceneBuilder) -> Result<Labels, SceneError> {
        let Some(class) = self.class else { return Ok(self.labels) };
        Ok(Labels { semantic_id: scene.find_class(&class)?, ..self.labels })
    }
}

fn node(keys: &mut Keys<'_>) -> Result<(String, Add), SceneError> {
    let name = needed_name(keys)?;
    Ok((name.clone(), Box::new(move |scene, placement| scene.node(name, placement))))
}

fn gltf(keys: &mut Keys<'_>) -> Result<(String, Add), SceneError> {
    let name = needed_name(keys)?;
    let file = keys.file("file")?;
    let file = keys.needs("file", file)?;
    let animation = keys.text("animation")?.map(str::to_owned);
    let labels = LabelKeys::read(keys)?;
    let add: Add = {
        let name = name.clone();
        Box::new(move |scene, placement| {
            let labels = labels.of(scene)?;
            scene.gltf(name, &file, animation.as_deref(), labels, placement)
        })
    };
    Ok((name, add))
}

fn primitive(keys: &mut Keys<'_>) -> Result<(String, Add), SceneError> {
    let name = needed_name(keys)?;
    let kinds = [("plane", 0), ("box", 1), ("sphere", 2), ("cylinder", 3), ("capsule", 4), ("card", 5)];
    let kind = keys.choice("shape", &kinds)?;
    let number = |keys: &mut Keys<'_>, key| {
        let value = keys.number(key)?;
        keys.needs(key, value)
    };
    let shape = match keys.needs("shape", kind)? {
        kind @ (0 | 5) => {
            let size = keys.numbers::<2>("size")?;
            let size = keys.needs("size", size)?;
            if kind == 0 { Shape::Plane { size } } else { Shape::Card { size } }
        }
        1 => {
            let size = keys.numbers::<3>("size")?;
            Shape::Box { size: keys.needs("size", size)? }
        }
        2 => Shape::Sphere { radius: number(keys, "radius")? },
        kind => {
            let (radius, height) = (number(keys, "radius")?, number(keys, "height")?);
            if kind == 3 { Shape::Cylinder { radius, height } } else { Shape::Capsule { radius, height } }
        }
    };
    let settings = ShapeSettings {
        segments: keys.pair("segments")?,
        uv_repeat: keys.numbers::<2>("uv_repeat")?.unwrap_or([1.0; 2]),
        labels: Labels::default(),
    };
    let labels = LabelKeys::read(keys)?;
    let material = keys.text("material")?;
    let material = keys.needs("material", material)?.to_owned();
    let add: Add = {
        let name = name.clone();
        Box::new(move |scene, placement| {
            let material = scene.find_material(&material)?;
            let settings = ShapeSettings { labels: labels.of(scene)?, ..settings };
            scene.shape_with(name, shape, material, settings, placement)
        })
    };
    Ok((name, add))
}

fn light(keys: &mut Keys<'_>) -> Result<(String, Add), SceneError> {
    let name = needed_name(keys)?;
    let kind = keys.choice("kind", &[("directional", 0), ("point", 1), ("spot", 2)])?;
    let kind = match keys.needs("kind", kind)? {
        0 => LightKind::Directional,
        1 => LightKind::Point,
        _ => LightKind::Spot {
            inner: (keys.number_or("inner_degrees", 0.0)? as f32).to_radians(),
            outer: (keys.number_or("outer_degrees", 45.0)? as f32).to_radians(),
        },
    };
    let intensity = keys.number("intensity")?;
    let light = Light {
        name: name.clone(),
        kind,
        color: keys.color("color")?.unwrap_or([1.0; 3]),
        intensity: keys.needs("intensity", intensity)? as f32,
        range: keys.number("range")?.map(|r| r as f32),
        casts_shadow: keys.flag("casts_shadow")?.unwrap_or(false),
        waveform: motion::waveform(keys, "waveform")?,
    };
    Ok((name, Box::new(move |scene, placement| scene.light(light, placement))))
}

/// Cameras on one body: of a calibration file, or two that are parallel.
fn rig(keys: &mut Keys<'_>) -> Result<(String, Add), SceneError> {
    let name = needed_name(keys)?;
    keys.at_most_one(&["calibration", "baseline"])?;
    let names: Option<Vec<String>> = keys.texts("cameras")?;
    let mut rig = if let Some(baseline) = keys.number("baseline")? {
        let camera = lens_and_sensor(keys, EventCamera::new("camera"))?;
        let rig = Rig::stereo(baseline, &camera).map_err(|e| keys.locate(e))?;
        (rig, camera)
    } else {
        let file = keys.file("calibration")?;
        let file = keys.needs("calibration", file)?;
        let mut camera = EventCamera::new("camera");
        camera.near = keys.number_or("near", camera.near)?;
        camera.sensor = sensor(keys)?;
        (Rig::load(&file)?, camera)
    };
    if let Some(names) = names {
        if names.len() != rig.0.cameras.len() {
            return Err(keys.error(format!(
                "cameras has {} names; the rig has {} cameras",
                names.len(),
                rig.0.cameras.len()
            )));
        }
        rig.0.cameras.iter_mut().zip(names).for_each(|(camera, name)| camera.name = name);
    }
    let (rig, like) = rig;
    Ok((name.clone(), Box::new(move |scene, placement| scene.rig_like(name, &rig, &like, placement))))
}

fn camera(keys: &mut Keys<'_>) -> Result<(String, Add), SceneError> {
    let camera = EventCamera::new(needed_name(keys)?);
    let camera = lens_and_sensor(keys, camera)?;
    Ok((camera.name.clone(), Box::new(move |scene, placement| scene.camera(camera, placement))))
}

/// Index of the light `name`.
fn light_named(scene: &Scene, name: &str) -> Result<usize, SceneError> {
    let mut found = scene.lights.iter().enumerate().filter(|(_, light)| light.name == name);
    match (found.next(), found.next()) {
        (Some((index, _)), None) => Ok(index),
        (Some(_), Some(_)) => Err(SceneError::Rule(format!("more than one light is named '{name}'"))),
        (None, _) => Err(SceneError::Unknown {
            what: "light",
            name: name.into(),
            known: scene.lights.iter().map(|light| light.name.clone()).collect(),
        }),
    }
}

/// What a table says of a material.
fn material_change(table: &mut Keys<'_>) -> Result<MaterialChange, SceneError> {
    Ok(MaterialChange {
        base_color: table.color("color")?,
        metallic: table.number("metallic")?.map(|v| v as f32),
        emissive: table.color("emissive")?,
        roughness: table.number("roughness")?.map(|v| v as f32),
    })
}

/// The lens that a table gives to a camera of `size` pixels; `None` where it says nothing of one.
fn lens(keys: &mut Keys<'_>, size: Option<[u32; 2]>) -> Result<Option<Lens>, SceneError> {
    let intrinsics = ["fx", "fy", "cx", "cy"];
    if intrinsics.iter().any(|key| keys.has(key)) {
        keys.at_most_one(&["fov_y_degrees", "fx", "orthographic_height"])?;
        let mut values = [0.0; 4];
        // Square pixels and a centred image are what most cameras have.
        let centre = size.map(|[w, h]| [f64::from(w) / 2.0, f64::from(h) / 2.0]);
        for (i, key) in intrinsics.into_iter().enumerate() {
            let default = match i {
                1 => Some(values[0]),
                2 | 3 => centre.map(|c| c[i - 2]),
                _ => None,
            };
            let value = keys.number(key)?.or(default);
            values[i] = keys.needs(key, value)?;
        }
        let [fx, fy, cx, cy] = values;
        return Ok(Some(Lens::Intrinsics { fx, fy, cx, cy }));
    }
    keys.at_most_one(&["fov_y_degrees", "orthographic_height"])?;
    if let Some(height) = keys.number("orthographic_height")? {
        let far = keys.number("far")?;
        return Ok(Some(Lens::Orthographic { height, far: keys.needs("far", far)? }));
    }
    if keys.has("far") {
        return Err(keys.error(
            "far is given without orthographic_height; a perspective camera sees as far as there is anything",
        ));
    }
    let degrees = keys.number("fov_y_degrees")?;
    Ok(degrees.map(|degrees| Lens::FieldOfView { fov_y: degrees.to_radians() }))
}

/// `camera` with what the table says of it.
fn lens_and_sensor(keys: &mut Keys<'_>, mut camera: EventCamera) -> Result<EventCamera, SceneError> {
    camera.size = keys.pair("size")?;
    camera.lens = lens(keys, camera.size)?.unwrap_or(camera.lens);
    camera.distortion = distortion(keys)?;
    camera.near = keys.number_or("near", camera.near)?;
    camera.thresholds =
        [keys.number("threshold_on")?.map(|c| c as f32), keys.number("threshold_off")?.map(|c| c as f32)];
    camera.sensor = sensor(keys)?;
    Ok(camera)
}

/// The table under `distortion`: a model and its coefficients.
fn distortion(keys: &mut Keys<'_>) -> Result<Option<Distortion>, SceneError> {
    let Some(mut table) = keys.table("distortion")? else { return Ok(None) };
    let model = table.choice("model", &[("radtan", "radtan"), ("fisheye", "fisheye")])?;
    let model = table.needs("model", model)?;
    let names = Distortion::names(model);
    let mut coefficients = Vec::with_capacity(names.len());
    for &name in names {
        coefficients.push(table.number_or(name, 0.0)?);
    }
    let distortion = Distortion::from_coefficients(model, &coefficients).map_err(|e| table.locate(e))?;
    table.finish()?;
    Ok(Some(distortion))
}

/// The sensor under `sensor`: a preset's name, a TOML file, or a table.
fn sensor(keys: &mut Keys<'_>) -> Result<Option<CameraSensor>, SceneError> {
    let Some(value) = keys.get("sensor") else { return Ok(None) };
    let place = |what: &str| format!("{}: {}: sensor{what}", keys.file_name(), keys.at());
    let unusable = || {
        keys.error(format!(
            "sensor is {value}; it takes the name of a preset, the path of a TOML file, or a table of a sensor's keys"
        ))
    };
    Ok(Some(match value {
        Value::String(name) if name.is_empty() => return Err(unusable()),
        Value::String(name) => {
            let path = Path::new(name);
            if path.extension().is_none() && path.components().count() == 1 {
                CameraSensor { kind: SensorKind::Preset(name.clone()), place: place("") }
            } else {
                let text = crate::file::text(&keys.base().join(path)).map_err(|error| {
                    keys.error(format!("sensor is \"{name}\", a file that cannot be read ({error})"))
                })?;
                CameraSensor { kind: SensorKind::Toml(text), place: place(&format!(" \"{name}\"")) }
            }
        }
        Value::Table(table) => CameraSensor { kind: SensorKind::Toml(table.to_string()), place: place("") },
        _ => return Err(unusable()),
    }))
}

fn environment(mut keys: Keys<'_>, scene: &mut SceneBuilder) -> Result<(), SceneError> {
    let count = keys.integer("count", MAX_ENVIRONMENTS)?.unwrap_or(1);
    if count == 0 {
        return Err(
            keys.error(format!("count is 0; it takes a whole number between 1 and {MAX_ENVIRONMENTS}"))
        );
    }
    // Without a word about it every environment has its own seed.
    let present = scene.scene().variants.len() as u64;
    let seed_offset = keys.integer("seed_offset", i64::MAX as u64)?.unwrap_or(present);
    let (time_offset_s, time_step_s) =
        (keys.number_or("time_offset_s", 0.0)?, keys.number_or("time_step_s", 0.0)?);
    let mut node_offsets: Vec<(usize, DMat4)> = Vec::new();
    for (name, mut pose_keys) in keys.named_tables("offsets")? {
        let node = scene.find(name).map_err(|e| pose_keys.locate(e))?;
        let pose = motion::pose(&mut pose_keys)?;
        node_offsets.push((node, crate::builder::offset(&pose).map_err(|e| pose_keys.locate(e))?));
        pose_keys.finish()?;
    }
    let mut same = Variant { node_offsets, ..Variant::default() };
    for (name, mut table) in keys.named_tables("materials")? {
        let change = material_change(&mut table)?;
        for index in scene.find_materials(name).map_err(|e| table.locate(e))? {
            let material = &scene.scene().materials[index];
            if let Some((factor, seen)) = change.unseen(material.model) {
                return Err(table.error(format!(
                    "{factor} is not seen of the {} material '{name}'; change {seen}",
                    material.model.name()
                )));
            }
            let factors = material.factors().with(&change);
            same = same.with_material(index, factors);
        }
        table.finish()?;
    }
    for (name, mut table) in keys.named_tables("lights")? {
        let index = light_named(scene.scene(), name).map_err(|e| table.locate(e))?;
        let change = LightChange {
            color: table.color("color")?,
            intensity: table.number("intensity")?.map(|v| v as f32),
            on: table.flag("on")?,
        };
        let own = scene.scene().lights[index].factors().with(&change);
        same = same.with_light(index, own);
        table.finish()?;
    }
    for (name, mut table) in keys.named_tables("cameras")? {
        let index = scene.scene().camera(name).map_err(|e| table.locate(e))?;
        let camera = &scene.scene().cameras[index];
        let size = camera.width.zip(camera.height).map(|(w, h)| [w, h]);
        let Some(lens) = lens(&mut table, size)? else {
            return Err(table.error(
                "it has no lens; it takes fov_y_degrees, or fx, fy, cx, cy, or orthographic_height and far",
            ));
        };
        same = same.with_lens(index, lens);
        table.finish()?;
    }
    for i in 0..count {
        let variant = Variant {
            seed_offset: seed_offset + i,
            time_offset_s: time_offset_s + i as f64 * time_step_s,
            ..same.clone()
        };
        scene.variant(variant).map_err(|e| keys.locate(e))?;
        if scene.scene().variants.len() as u64 > MAX_ENVIRONMENTS {
            return Err(keys.error(format!("there are more than {MAX_ENVIRONMENTS} environments")));
        }
    }
    keys.finish()
}
