//! Scenes: loaded by the scene crate, held for the simulator.

use std::path::PathBuf;
use std::sync::Arc;

use pyo3::prelude::*;

use crate::door::EnterEngine;
use crate::engine;

/// A scene, shared by the simulators that render it.
#[pyclass(frozen, module = "evis._evis")]
pub(crate) struct Scene(Arc<evis_scene::Scene>);

impl Scene {
    pub(crate) fn shared(&self) -> Arc<evis_scene::Scene> {
        Arc::clone(&self.0)
    }
}

#[pymethods]
impl Scene {
    /// A built-in scene.
    #[staticmethod]
    fn builtin(py: Python<'_>, name: &str, seed: u64) -> PyResult<Self> {
        py.enter_engine(|| engine::builtin_scene(name, seed)).map(Self::new)
    }

    /// A `.toml`, `.gltf` or `.glb` file.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        py.enter_engine(|| engine::load_scene(&path)).map(Self::new)
    }

    /// A TOML text; relative paths in it start at `base`.
    #[staticmethod]
    fn from_toml(py: Python<'_>, text: &str, base: PathBuf) -> PyResult<Self> {
        py.enter_engine(|| engine::parse_scene(text, &base)).map(Self::new)
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

impl Scene {
    fn new(scene: evis_scene::Scene) -> Self {
        Self(Arc::new(scene))
    }
}
