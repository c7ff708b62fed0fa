//! The device: found, or given from outside.

use crate::error::EngineError;

/// A device as a user chooses among them.
#[derive(Clone, Debug, serde::Serialize)]
pub struct DeviceSummary {
    /// Position in the list; `--device INDEX` takes it.
    pub index: usize,
    /// Name that the driver gives.
    pub name: String,
    /// `vulkan`, `metal` or `dx12`.
    pub backend: String,
    /// `cpu`, `integrated`, `discrete`, `virtual` or `other`.
    pub kind: String,
    /// Driver name and version.
    pub driver: String,
}

/// A `wgpu` device and its queue, with the limits that the engine may use.
#[derive(Clone)]
pub struct Gpu {
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    summary: DeviceSummary,
}

/// The devices that can run EVIS.
pub fn list_devices() -> Vec<DeviceSummary> {
    Vec::new()
}

impl Gpu {
    /// Opens a device: by index, by a part of its name (case-insensitive), or the fastest kind where `None`.
    ///
    /// # Errors
    /// [`EngineError::Device`] where there is none (says which package to install) or none matches.
    pub fn open(_selector: Option<&str>) -> Result<Self, EngineError> {
        Err(EngineError::Device("not yet".into()))
    }

    /// Runs on a device from outside; its limits must allow storage buffers and `Depth32Float` rendering.
    pub fn from_device(device: wgpu::Device, queue: wgpu::Queue) -> Self {
        let summary = DeviceSummary {
            index: 0,
            name: "given".into(),
            backend: String::new(),
            kind: "other".into(),
            driver: String::new(),
        };
        Self { device, queue, summary }
    }

    /// What this device is.
    pub fn summary(&self) -> &DeviceSummary {
        &self.summary
    }
}
