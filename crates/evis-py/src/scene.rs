//! Scenes: loaded by the scene crate, held for the simulator.

use std::path::PathBuf;
use std::sync::Arc;

use evis_core::ConfigError;
use evis_scene::camera_motion::{self, CameraMotionSettings};
use evis_scene::image::MAX_EDGE;
use half::f16;
use numpy::PyReadonlyArray3;
use pyo3::prelude::*;

use crate::engine::{self, Picture};
use crate::errors::Failure;
use crate::gil::Detach;

/// A scene, shared by the simulators that render it.
#[pyclass(frozen, module = "evis._evis")]
pub(crate) struct Scene(Arc<evis_scene::Scene>);

impl Scene {
    pub(crate) fn shared(&self) -> Arc<evis_scene::Scene> {
        Arc::clone(&self.0)
    }

    pub(crate) const fn of(scene: Arc<evis_scene::Scene>) -> Self {
        Self(scene)
    }

    /// The scene; one that brings neither a camera nor any motion has a moving camera for views of this size.
    pub(crate) fn moved_by_default(
        &self,
        py: Python<'_>,
        camera: Option<&String>,
        size: Option<(u32, u32)>,
    ) -> PyResult<Arc<evis_scene::Scene>> {
        let settings =
            CameraMotionSettings { camera: camera.cloned(), size, ..CameraMotionSettings::default() };
        py.detach_engine(|| camera_motion::moved(&self.0, &settings))
    }
}

#[pymethods]
impl Scene {
    /// A built-in scene.
    #[staticmethod]
    fn builtin(py: Python<'_>, name: &str, seed: u64) -> PyResult<Self> {
        py.detach_engine(|| engine::builtin_scene(name, seed)).map(Self::new)
    }

    /// A `.toml`, `.gltf` or `.glb` file, or a picture; `animation` of a glTF file plays, by name or by index in digits.
    #[staticmethod]
    #[pyo3(signature = (path, animation=None))]
    fn load(py: Python<'_>, path: PathBuf, animation: Option<&str>) -> PyResult<Self> {
        py.detach_engine(|| engine::load_scene(&path, animation)).map(Self::new)
    }

    /// A TOML text; relative paths in it start at `base`. `pictures` are linear RGBA pixels, f32 (H, W, 4),
    /// for the textures of these names.
    #[staticmethod]
    fn from_toml(
        py: Python<'_>,
        text: &str,
        base: PathBuf,
        pictures: Vec<(String, PyReadonlyArray3<'_, f32>)>,
    ) -> PyResult<Self> {
        let pictures = pictures.into_iter().map(|(name, pixels)| picture(name, &pixels));
        let pictures = pictures.collect::<PyResult<Vec<_>>>()?;
        py.detach_engine(|| engine::parse_scene(text, &base, pictures)).map(Self::new)
    }

    /// This scene with the cameras of a TOML text, each on the node that `parents` names.
    fn with_cameras(&self, py: Python<'_>, text: &str, parents: Vec<Option<String>>) -> PyResult<Self> {
        py.detach_engine(|| engine::with_cameras(&self.0, text, &parents)).map(Self::new)
    }

    /// Everything `speed` times as fast.
    fn at_speed(&self, speed: f64) -> PyResult<Self> {
        Ok(Self::new(evis_scene::Scene::clone(&self.0).at_speed(speed).map_err(Failure::from)?))
    }

    /// Cameras that rest, moved: a motion by its word or file, pixels per second, the view's camera and size. A scene that
    /// this leaves as it is comes back itself.
    #[pyo3(signature = (motion, speed, camera, size))]
    fn with_camera_motion(
        &self,
        py: Python<'_>,
        motion: Option<&str>,
        speed: Option<f64>,
        camera: Option<String>,
        size: Option<(u32, u32)>,
    ) -> PyResult<Self> {
        let motion = motion.map(engine::camera_motion).transpose()?;
        let settings = CameraMotionSettings { motion, speed_px_per_s: speed, camera, size };
        py.detach_engine(|| camera_motion::moved(&self.0, &settings)).map(Self)
    }

    /// Motion, pixels per second, whether nobody asked for it, and a description; None where cameras move as the scene
    /// says.
    #[getter]
    fn camera_motion(&self) -> Option<(String, Option<f64>, bool, String)> {
        let applied = self.0.camera_motion.clone()?;
        Some((applied.motion, applied.speed_px_per_s, applied.by_default, applied.description))
    }

    /// Whether nothing ever changes that these cameras (all, if none is named) see.
    fn rests(&self, cameras: Vec<String>) -> bool {
        self.0.rests(&cameras)
    }

    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    #[getter]
    fn cameras(&self) -> Vec<&str> {
        self.0.cameras.iter().map(|camera| camera.name.as_str()).collect()
    }

    #[getter]
    fn nodes(&self) -> Vec<&str> {
        self.0.nodes.iter().map(|node| node.name.as_str()).collect()
    }

    #[getter]
    fn environments(&self) -> usize {
        self.0.variants.len().max(1)
    }

    #[getter]
    fn duration_s(&self) -> Option<f64> {
        self.0.duration_s
    }

    #[getter]
    fn warnings(&self) -> Vec<&str> {
        self.0.warnings.iter().map(String::as_str).collect()
    }
}

fn picture(name: String, pixels: &PyReadonlyArray3<'_, f32>) -> PyResult<Picture> {
    let pixels = pixels.as_array();
    let (height, width, channels) = pixels.dim();
    let size = |count: usize| u32::try_from(count).ok().filter(|count| (1..=MAX_EDGE).contains(count));
    let (Some(width), Some(height), 4) = (size(width), size(height), channels) else {
        let shape = format!("{height} x {width} x {channels}");
        let remedy = format!("height x width x 4, each edge between 1 and {MAX_EDGE}");
        return Err(Failure::from(ConfigError::new(
            &format!("the shape of texture '{name}'"),
            shape,
            remedy,
        ))
        .into());
    };
    let texels: Vec<f16> = pixels.iter().map(|value| f16::from_f32(*value)).collect();
    Ok(Picture { name, width, height, texels: texels.as_chunks().0.to_vec() })
}

impl Scene {
    fn new(scene: evis_scene::Scene) -> Self {
        Self(Arc::new(scene))
    }
}
