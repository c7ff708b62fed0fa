//! Conversions between Python's names and dictionaries and the engine's types, and calls that are more than a method.

use std::path::Path;
use std::sync::Mutex;
use std::time::Duration;

use evis_core::{CameraInfo, ConfigError, Event, LabelKind, LensDistortion, Polarity};
use evis_render::{DeviceSummary, EngineError, RunConfig};
use evis_scene::{Image, SceneError};
use half::f16;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::errors::Failure;
use crate::gil::{Detach, lock_unpoisoned};
use crate::packet;

/// One kind of label by its name.
pub(crate) fn label(name: &str) -> Result<LabelKind, Failure> {
    LabelKind::ALL.into_iter().find(|kind| kind.name() == name).ok_or_else(|| {
        let known = LabelKind::ALL.map(|kind| format!("'{}'", kind.name()));
        ConfigError::new("label", format!("'{name}'"), known.join(" or ")).into()
    })
}

/// Label names of a recording; `flow` stands for both directions and their masks, `frame` for frames.
pub(crate) fn labels(names: &[String]) -> Result<Vec<LabelKind>, Failure> {
    let (frames, labels): (Vec<_>, Vec<_>) = names.iter().cloned().partition(|name| name == "frame");
    let mut kinds = LabelKind::asked(&labels)?;
    kinds.extend(frames.first().map(|_| LabelKind::Frame));
    kinds.sort();
    Ok(kinds)
}

/// A camera motion by its word, or a file of poses.
pub(crate) fn camera_motion(text: &str) -> Result<evis_scene::CameraMotion, Failure> {
    text.parse().map_err(|reason| Failure::Config(format!("camera_motion is '{text}'; {reason}")))
}

pub(crate) fn camera_dict<'py>(py: Python<'py>, camera: &CameraInfo) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("name", &camera.name)?;
    dict.set_item("width", camera.width)?;
    dict.set_item("height", camera.height)?;
    dict.set_item("fx", camera.fx)?;
    dict.set_item("fy", camera.fy)?;
    dict.set_item("cx", camera.cx)?;
    dict.set_item("cy", camera.cy)?;
    if let Some(distortion) = &camera.distortion {
        dict.set_item("distortion_model", &distortion.model)?;
        dict.set_item("distortion_coefficients", PyTuple::new(py, &distortion.coefficients)?)?;
    }
    Ok(dict)
}

pub(crate) fn camera_info(dict: &Bound<'_, PyDict>) -> PyResult<CameraInfo> {
    let coefficients = || -> PyResult<Vec<f64>> {
        dict.get_item("distortion_coefficients")?.map_or(Ok(Vec::new()), |v| v.extract())
    };
    let model: Option<String> = dict.get_item("distortion_model")?.map_or(Ok(None), |v| v.extract())?;
    let distortion = match model {
        Some(model) => Some(LensDistortion { model, coefficients: coefficients()? }),
        None => None,
    };
    Ok(CameraInfo {
        distortion,
        name: dict.as_any().get_item("name")?.extract()?,
        width: dict.as_any().get_item("width")?.extract()?,
        height: dict.as_any().get_item("height")?.extract()?,
        fx: dict.as_any().get_item("fx")?.extract()?,
        fy: dict.as_any().get_item("fy")?.extract()?,
        cx: dict.as_any().get_item("cx")?.extract()?,
        cy: dict.as_any().get_item("cy")?.extract()?,
    })
}

pub(crate) fn device_dict<'py>(py: Python<'py>, device: &DeviceSummary) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("index", device.index)?;
    dict.set_item("name", &device.name)?;
    dict.set_item("backend", &device.backend)?;
    dict.set_item("kind", &device.kind)?;
    dict.set_item("driver", &device.driver)?;
    Ok(dict)
}

pub(crate) fn builtin_scene(name: &str, seed: u64) -> Result<evis_scene::Scene, SceneError> {
    let mut scene = evis_scene::builtin::load(name, seed)?;
    evis_physics::simulate(&mut scene)?;
    Ok(scene)
}

pub(crate) fn load_scene(path: &Path, animation: Option<&str>) -> Result<evis_scene::Scene, Failure> {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    let is_scene = |ending: &str| {
        ["toml", "gltf", "glb"].contains(&ending) || evis_scene::picture::ENDINGS.contains(&ending)
    };
    match ending {
        Some(ending) if is_scene(&ending) => Ok(evis_physics::load(&path.to_string_lossy(), 0, animation)?),
        _ => Err(ConfigError::new(
            "path",
            format!("'{}'", path.display()),
            "a .toml, .gltf or .glb file, or a .png, .jpg, .hdr, .exr or .tif picture (built-in scenes: \
             Scene.builtin)",
        )
        .into()),
    }
}

/// The scene of a TOML text, in which textures of these names take these pixels.
pub(crate) fn parse_scene(
    text: &str,
    base: &Path,
    pictures: Vec<Picture>,
) -> Result<evis_scene::Scene, SceneError> {
    let mut scene = evis_scene::toml_scene::parse(text, base)?;
    evis_physics::simulate(&mut scene)?;
    for picture in pictures {
        let Picture { name, width, height, texels } = picture;
        // A scene file's textures come before those of the glTF files that it includes.
        let image = scene.images.iter_mut().find(|image| image.name == name).ok_or_else(|| {
            SceneError::Rule(format!("texture '{name}' has pixels and is not in the scene; declare it"))
        })?;
        *image = Image { name, width, height, texels };
    }
    Ok(scene)
}

/// Pixels for a texture.
pub(crate) struct Picture {
    pub(crate) name: String,
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) texels: Vec<[f16; 4]>,
}

/// Something to draw: a scene without anything is refused, and a text of cameras alone is no scene.
const BACKDROP: &str = r#"
materials = [{ name = "backdrop" }]
primitives = [{ name = "backdrop", shape = "card", size = [1, 1], material = "backdrop" }]
"#;

/// `scene` with the cameras of a TOML text, each on the node of its name in `parents`.
pub(crate) fn with_cameras(
    scene: &evis_scene::Scene,
    text: &str,
    parents: &[Option<String>],
) -> Result<evis_scene::Scene, SceneError> {
    let added = evis_scene::toml_scene::parse(&format!("{BACKDROP}{text}"), Path::new(""))?;
    let mut scene = scene.clone();
    for (camera, parent) in added.cameras.into_iter().zip(parents) {
        if scene.cameras.iter().any(|known| known.name == camera.name) {
            let name = camera.name;
            return Err(SceneError::Rule(format!(
                "the scene has a camera named '{name}' already; give the new one another name"
            )));
        }
        let parent = parent.as_deref().map(|name| scene.node(name)).transpose()?;
        let node = added.nodes.get(camera.node).cloned().unwrap_or_default();
        let node = scene.add_node(evis_scene::Node { parent, ..node });
        if let Some(distortion) = added.distortions.get(&camera.name) {
            scene.distortions.insert(camera.name.clone(), *distortion);
        }
        scene.cameras.push(evis_scene::Camera { node, ..camera });
    }
    Ok(scene)
}

/// Linear light of every 8-bit sRGB value.
pub(crate) fn srgb_table() -> Vec<f32> {
    (0..=255).map(|code| evis_scene::image::linear_from_srgb(f64::from(code) / 255.0) as f32).collect()
}

/// Names and one-line descriptions.
pub(crate) fn builtin_names() -> Vec<(&'static str, &'static str)> {
    evis_scene::builtin::names().to_vec()
}

/// Per kind of label: name, NumPy dtype, values per pixel.
pub(crate) fn label_kinds() -> Vec<(&'static str, &'static str, usize)> {
    LabelKind::ALL.iter().map(|kind| (kind.name(), packet::dtype(*kind), kind.channels())).collect()
}

/// For tests: raises each exception, releases the GIL and hands out an array, without a device.
pub(crate) fn probe(py: Python<'_>, kind: &str) -> PyResult<Py<PyAny>> {
    let failure = match kind {
        "events" => {
            let events =
                (0..1000_u16).map(|k| Event::new(i64::from(k) * 10, k, k / 2, Polarity::On)).collect();
            return Ok(packet::events_with_address(py, events)?.into_any().unbind());
        }
        "wait" => {
            py.detach_engine(|| {
                std::thread::sleep(Duration::from_millis(300));
                Ok::<_, Failure>(())
            })?;
            return Ok(py.None());
        }
        "panic" => return py.detach_engine(|| -> Result<Py<PyAny>, Failure> { panic!("probe") }),
        "call after a panic" => {
            let object = Mutex::new(());
            // The first call breaks it, and says so; the second one must not go on with it.
            let first = py.detach_engine(|| -> Result<(), Failure> {
                let _held = lock_unpoisoned(&object)?;
                panic!("probe")
            });
            return py.detach_engine(|| lock_unpoisoned(&object).map(|_| first.is_ok())).map(|_| py.None());
        }
        "config" => ConfigError::new("rate", -1, "above 0").into(),
        "scene io" => {
            SceneError::Io { path: "missing.glb".into(), source: std::io::Error::from_raw_os_error(2) }.into()
        }
        "scene invalid" => SceneError::invalid("bad.glb", "wrong magic").into(),
        "scene unknown" => {
            SceneError::Unknown { what: "camera", name: "x".into(), known: vec!["left".into()] }.into()
        }
        "device" => EngineError::Device("no driver".into()).into(),
        other => Failure::Engine(format!("no probe named '{other}'")),
    };
    py.detach_engine(|| Err::<Py<PyAny>, _>(failure))
}

/// Everything that makes a stream what it is, as event files store it.
pub(crate) fn config_toml(
    scene: &evis_scene::Scene,
    environments: usize,
    config: &RunConfig,
) -> Result<String, Failure> {
    let unstorable =
        |error: toml::ser::Error| Failure::Config(format!("the settings cannot be stored: {error}"));
    let mut table = toml::Table::new();
    table.insert("evis".into(), env!("CARGO_PKG_VERSION").into());
    table.insert("scene".into(), scene.name.as_str().into());
    table.insert("speed".into(), scene.speed.unwrap_or(1.0).into());
    if let Some(animation) = &scene.animation {
        table.insert("animation".into(), animation.as_str().into());
    }
    table.insert("environments".into(), toml::Value::try_from(environments).map_err(unstorable)?);
    if let Some(moved) = &scene.camera_motion {
        table.insert("camera_motion".into(), toml::Value::try_from(moved).map_err(unstorable)?);
    }
    table.insert("run".into(), toml::Value::try_from(config).map_err(unstorable)?);
    toml::to_string(&table).map_err(unstorable)
}
