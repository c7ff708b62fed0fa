//! The device: found, or given from outside.

pub mod buffer;
pub mod commands;
pub mod readback;
pub mod shader;
pub mod sizes;
pub mod texture;
pub mod uniforms;
pub mod variant;
pub mod work;

use std::sync::{Arc, OnceLock};

use crate::error::EngineError;
use crate::gpu::work::{Counters, Counts, DEVICE_TARGET, PassClock};

/// A device as a user chooses among them.
#[derive(Clone, Debug, serde::Serialize)]
pub struct DeviceSummary {
    /// Position in the list; `--device INDEX` takes it.
    pub index: usize,
    /// Name that the driver gives.
    pub name: String,
    /// `vulkan`, `metal` or `dx12`; `none` where a run needed no device.
    pub backend: String,
    /// `cpu`, `integrated`, `discrete`, `virtual` or `other`.
    pub kind: String,
    /// Driver name and version.
    pub driver: String,
}

/// A `wgpu` device and its queue.
#[derive(Clone)]
pub struct Gpu {
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    pub(crate) counters: Arc<Counters>,
    /// Where a trace takes the times of passes on the device.
    pub(crate) clock: Option<Arc<PassClock>>,
    summary: DeviceSummary,
    /// Why the driver gave the device up, once it has.
    pub(crate) lost: Arc<OnceLock<String>>,
}

/// The connection to the drivers, kept as long as the process lives: a driver that is unloaded with the last of them leaves
/// address space behind (Mesa 10 MiB for machine code), each time. A forked process does not touch what its parent has.
fn instance() -> wgpu::Instance {
    static KEPT: OnceLock<(u32, wgpu::Instance)> = OnceLock::new();
    let process = std::process::id();
    let open = || {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        descriptor.backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
        wgpu::Instance::new(descriptor)
    };
    let (owner, kept) = KEPT.get_or_init(|| (process, open()));
    if *owner == process { kept.clone() } else { open() }
}

fn adapters() -> Vec<wgpu::Adapter> {
    pollster::block_on(instance().enumerate_adapters(wgpu::Backends::all()))
}

fn summarise(index: usize, info: &wgpu::AdapterInfo) -> DeviceSummary {
    let kind = match info.device_type {
        wgpu::DeviceType::Cpu => "cpu",
        wgpu::DeviceType::IntegratedGpu => "integrated",
        wgpu::DeviceType::DiscreteGpu => "discrete",
        wgpu::DeviceType::VirtualGpu => "virtual",
        wgpu::DeviceType::Other => "other",
    };
    DeviceSummary {
        index,
        name: info.name.clone(),
        backend: info.backend.to_string(),
        kind: kind.to_owned(),
        driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
    }
}

/// The devices that can run EVIS, in the driver's order.
pub fn list_devices() -> Vec<DeviceSummary> {
    adapters().iter().enumerate().map(|(i, a)| summarise(i, &a.get_info())).collect()
}

impl DeviceSummary {
    /// What a run without a device has in its place.
    pub fn none() -> Self {
        let text = str::to_owned;
        Self {
            index: 0,
            name: text("no device"),
            backend: text("none"),
            kind: text("cpu"),
            driver: String::new(),
        }
    }
}

impl Gpu {
    /// As [`Gpu::open`]; `None` where the machine has no device and none is asked for by name: decoupled sampling does
    /// without.
    ///
    /// # Errors
    /// None matches, or it cannot be opened.
    pub fn open_any(selector: Option<&str>) -> Result<Option<Self>, EngineError> {
        if selector.is_none() && adapters().is_empty() {
            return Ok(None);
        }
        Self::open(selector).map(Some)
    }

    /// What `work` makes. The device's own complaints about it come as an error, not as a panic.
    pub(crate) fn guarded<T>(&self, work: impl FnOnce() -> Result<T, EngineError>) -> Result<T, EngineError> {
        let validation = self.device.push_error_scope(wgpu::ErrorFilter::Validation);
        let memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let made = work();
        for scope in [memory, validation] {
            if let Some(error) = pollster::block_on(scope.pop()) {
                return Err(EngineError::Device(format!("the device refused this scene: {error}")));
            }
        }
        made
    }

    /// Opens a device: by index, by a part of its name (case-insensitive), or the fastest kind where `None`.
    ///
    /// # Errors
    /// [`EngineError::NoDevice`] where there is none (says which package to install), [`EngineError::Device`] where none matches.
    pub fn open(selector: Option<&str>) -> Result<Self, EngineError> {
        let mut adapters = adapters();
        let summaries: Vec<_> =
            adapters.iter().enumerate().map(|(i, a)| summarise(i, &a.get_info())).collect();
        if summaries.is_empty() {
            return Err(EngineError::NoDevice);
        }
        let chosen = match selector {
            None => summaries.iter().min_by_key(|s| match s.kind.as_str() {
                "discrete" => 0,
                "integrated" => 1,
                "virtual" => 2,
                "cpu" => 3,
                _ => 4,
            }),
            Some(text) => match text.parse::<usize>() {
                Ok(index) => summaries.get(index),
                Err(_) => summaries.iter().find(|s| s.name.to_lowercase().contains(&text.to_lowercase())),
            },
        };
        let Some(summary) = chosen.cloned() else {
            let known: Vec<_> = summaries.iter().map(|s| format!("{}: {}", s.index, s.name)).collect();
            return Err(EngineError::Device(format!(
                "no device '{}'; there is {}",
                selector.unwrap_or_default(),
                known.join(", ")
            )));
        };
        let adapter = adapters.swap_remove(summary.index);
        Self::request(&adapter, required_limits(&adapter.limits()), summary)
    }

    /// A device of `adapter` with `limits` and no optional feature, but for timestamps where a trace takes them.
    fn request(
        adapter: &wgpu::Adapter,
        limits: wgpu::Limits,
        summary: DeviceSummary,
    ) -> Result<Self, EngineError> {
        let traced = tracing::enabled!(target: DEVICE_TARGET, tracing::Level::TRACE);
        let wanted = if traced { wgpu::Features::TIMESTAMP_QUERY } else { wgpu::Features::empty() };
        let features = wanted & adapter.features();
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("evis"),
            required_features: features,
            required_limits: limits,
            experimental_features: wgpu::ExperimentalFeatures::disabled(),
            memory_hints: wgpu::MemoryHints::Performance,
            trace: wgpu::Trace::Off,
        }))
        .map_err(|e| EngineError::Device(format!("cannot open {}: {e}", summary.name)))?;
        let lost = Arc::new(OnceLock::new());
        let told = Arc::clone(&lost);
        device.set_device_lost_callback(move |reason, message| {
            let _ = told.set(format!("{reason:?}: {message}").trim_end_matches([':', ' ']).to_owned());
        });
        let is_lost = Arc::clone(&lost);
        device.on_uncaptured_error(Arc::new(move |error| {
            // Commands for a lost device are refused one after the other, and a step says why.
            assert!(is_lost.get().is_some(), "wgpu error: {error}");
        }));
        let timed = features.contains(wgpu::Features::TIMESTAMP_QUERY);
        let clock = timed.then(|| Arc::new(PassClock::new(queue.get_timestamp_period())));
        Ok(Self { device, queue, counters: Arc::default(), clock, summary, lost })
    }

    /// A device that executes nothing: builds pipelines and bind groups only, for tests without a driver. It has WebGPU's
    /// default limits and no optional feature.
    ///
    /// # Errors
    /// [`EngineError::Device`] where `wgpu` was built without its `noop` backend.
    pub fn noop() -> Result<Self, EngineError> {
        let adapter = noop_adapter(wgpu::Limits::default())?;
        Self::request(&adapter, adapter.limits(), summarise(0, &adapter.get_info()))
    }

    /// A device that executes nothing, opened as [`Gpu::open`] opens one whose adapter has `limits`.
    #[cfg(test)]
    pub(crate) fn noop_with(limits: wgpu::Limits) -> Result<Self, EngineError> {
        let adapter = noop_adapter(limits)?;
        Self::request(&adapter, required_limits(&adapter.limits()), summarise(0, &adapter.get_info()))
    }

    /// A device that executes nothing, with exactly `limits`.
    #[cfg(test)]
    pub(crate) fn noop_exactly(limits: wgpu::Limits) -> Result<Self, EngineError> {
        let adapter = noop_adapter(limits)?;
        Self::request(&adapter, adapter.limits(), summarise(0, &adapter.get_info()))
    }

    /// Runs on a device from outside. The engine keeps to the device's own limits; WebGPU's defaults suffice. What is
    /// called when the device is lost stays the caller's.
    pub fn from_device(device: wgpu::Device, queue: wgpu::Queue) -> Self {
        let summary = DeviceSummary {
            index: 0,
            name: "given device".into(),
            backend: String::new(),
            kind: "other".into(),
            driver: String::new(),
        };
        Self { device, queue, counters: Arc::default(), clock: None, summary, lost: Arc::default() }
    }

    /// An error where the device was lost: its driver was reset, or it was taken out. Nothing runs on it any more.
    pub(crate) fn check_not_lost(&self) -> Result<(), EngineError> {
        let Some(reason) = self.lost.get() else { return Ok(()) };
        Err(EngineError::Device(format!(
            "the device {} was lost ({reason}); everything delivered before stays valid, so keep it, and run again in a \
             new simulator, or on another `device`",
            self.summary.name
        )))
    }

    /// What was submitted to this device through this value and its clones.
    pub fn counts(&self) -> Counts {
        self.counters.read()
    }

    /// What this device is.
    pub fn summary(&self) -> &DeviceSummary {
        &self.summary
    }
}

/// The adapter of wgpu's `noop` backend, with `limits` and no optional feature.
fn noop_adapter(limits: wgpu::Limits) -> Result<wgpu::Adapter, EngineError> {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::NOOP;
    descriptor.backend_options.noop.enable = true;
    descriptor.backend_options.noop.limits = Some(limits);
    descriptor.backend_options.noop.features = Some(wgpu::Features::empty());
    let instance = wgpu::Instance::new(descriptor);
    pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions::default()))
        .map_err(|e| EngineError::Device(format!("no noop backend: {e}")))
}

/// WebGPU's default limits, with the sizes that help raised to what the adapter has.
fn required_limits(have: &wgpu::Limits) -> wgpu::Limits {
    wgpu::Limits {
        max_texture_dimension_2d: have.max_texture_dimension_2d,
        max_texture_array_layers: have.max_texture_array_layers,
        max_buffer_size: have.max_buffer_size,
        max_storage_buffer_binding_size: have.max_storage_buffer_binding_size,
        ..wgpu::Limits::default()
    }
}
