//! Sensors whose pixels the host walks, those with `diffusion`, an `exposure` or noise of their photoreceptor: a
//! submission brings the light of its instants back instead of events, and each view's own emulator takes it, instant by
//! instant. The price is the way of every sample to the host.
//!
//! Brownian bridges need f64, and as many draws as the light asks for: on the device they would be the widest loop of
//! all, for the sensor that is asked for least. An exposure ends at any time between two instants, and what follows sees
//! its frames alone: on the device it would be a chain of passes of its own.

use evis_core::emulator::parts::emulator;
use evis_core::{Cause, ConfigError, EmulatorConfig, EmulatorReport, Event, EventEmulator, Frames};
use rayon::prelude::*;

use crate::error::EngineError;
use crate::gpu::Gpu;
use crate::gpu::commands::Commands;
use crate::raster::context::Context;
use crate::raster::readback::mean_of_layers;
use crate::sensor::group::{Group, Unit};
use crate::sensor::targets::Targets;
use crate::world::view::View;

/// Light is held below this; `chain/layout.wgsl` has the same constant.
const LIGHT_LIMIT: f64 = 1e30;

/// A submission whose light comes to the host.
pub struct LuminanceReadback {
    /// Which.
    pub unit: Unit,
    /// All of its layers.
    pub staging: wgpu::Buffer,
}

/// The pixels that the host walks.
pub struct HostWalk {
    /// By view, in the engine's order; none where the device walks.
    emulators: Vec<Option<EventEmulator>>,
    /// What they are made with, beside their views.
    settings: EmulatorConfig,
    /// Buffers that no submission uses.
    free: Vec<wgpu::Buffer>,
}

/// What a submission brought of one view.
pub struct HostEvents {
    /// Index of the view.
    pub view: usize,
    /// In canonical order.
    pub events: Vec<Event>,
    /// Of all instants.
    pub report: EmulatorReport,
}

impl HostWalk {
    /// For those of `views` whose sensor it walks. `causes`: whether events say why they fired.
    ///
    /// # Errors
    /// A sensor or size that the emulator cannot have.
    pub fn new(views: &[View], reference_luminance: f32, causes: bool) -> Result<Self, EngineError> {
        let walked = |view: &&View| view.sensor.walks_on_host();
        // Views go side by side; where they are few, each shares its own pixels out.
        let threads = rayon::current_num_threads().div_ceil(views.iter().filter(walked).count().max(1));
        let settings = EmulatorConfig { reference_luminance, threads, causes, ..EmulatorConfig::default() };
        let make = |view| Some(view).filter(walked).map(|view| walker(&settings, view)).transpose();
        let emulators = views.iter().map(make).collect::<Result<_, _>>()?;
        Ok(Self { emulators, settings, free: Vec::new() })
    }

    /// Resets the pixels of view `index`: the next light is their reference, and their noise that of `view`.
    ///
    /// # Errors
    /// None that [`HostWalk::new`] does not have.
    pub fn reset(&mut self, index: usize, view: &View) -> Result<(), EngineError> {
        if let Some(Some(emulator)) = self.emulators.get_mut(index) {
            *emulator = walker(&self.settings, view)?;
        }
        Ok(())
    }

    /// Records the way of the light of `unit` to the host.
    ///
    /// # Errors
    /// Layers that no buffer of the device holds.
    pub fn encode(
        &mut self,
        gpu: &Gpu,
        encoder: &mut Commands,
        targets: &Targets,
        group: &Group,
        unit: Unit,
    ) -> Result<LuminanceReadback, EngineError> {
        let (width, height) = (targets.width, targets.height);
        let layers = group.views.len() as u32 * unit.instants * targets.samples;
        let bytes = targets.layers.host_bytes(layers);
        let most = gpu.device.limits().max_buffer_size;
        if bytes > most {
            return Err(EngineError::Device(format!(
                "the light of {layers} samples of {width}x{height} pixels takes {bytes} bytes on its way to the \
                 host, which simulates this sensor, and this device's buffers hold {most}; choose a smaller `size` or fewer \
                 `samples`"
            )));
        }
        let staging = match self.free.iter().position(|buffer| buffer.size() >= bytes) {
            Some(index) => self.free.swap_remove(index),
            None => {
                self.free.clear();
                gpu.device.create_buffer(&wgpu::BufferDescriptor {
                    label: Some("light for the host"),
                    size: bytes,
                    usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
                    mapped_at_creation: false,
                })
            }
        };
        targets.layers.encode_read(encoder, &staging, layers);
        Ok(LuminanceReadback { unit, staging })
    }

    /// Feeds the views of `group` with what `readback` brought.
    ///
    /// # Errors
    /// The device may fail.
    pub fn take(
        &mut self,
        context: &Context,
        targets: &Targets,
        group: &Group,
        readback: LuminanceReadback,
    ) -> Result<Vec<HostEvents>, EngineError> {
        let LuminanceReadback { unit, staging } = readback;
        let (instants, samples) = (unit.instants as usize, targets.samples as usize);
        let layer_bytes = targets.layers.host_bytes(1) as usize;
        let fired = {
            let bytes = staging
                .get_mapped_range(..)
                .map_err(|e| EngineError::Device(format!("cannot read the luminance back: {e}")))?;
            let bytes: &[u8] = &bytes;
            // What is not of this group rests.
            let mut own: Vec<(usize, usize, &mut EventEmulator)> = self
                .emulators
                .iter_mut()
                .enumerate()
                .filter_map(|(view, emulator)| {
                    let place = group.views.iter().position(|v| *v == view)?;
                    // At a reset, the other views have taken this instant already.
                    let runs = group.beginning.get(place) != Some(&false);
                    Some((view, place, emulator.as_mut().filter(|_| runs)?))
                })
                .collect();
            let fire = |(view, place, emulator): &mut (usize, usize, &mut EventEmulator)| {
                let mut fired =
                    HostEvents { view: *view, events: Vec::new(), report: EmulatorReport::default() };
                for k in 0..instants {
                    let first = (*place * instants + k) * samples;
                    let layers = bytes.get(first * layer_bytes..(first + samples) * layer_bytes);
                    let light = mean(layers.unwrap_or_default(), targets, samples);
                    let t_us = context.grid.instant_us(unit.first + k as i64);
                    let before = fired.events.len();
                    let out = std::slice::from_mut(&mut fired.events);
                    emulator.push_into(&Frames::linear(&light), t_us, out)?;
                    // Marked, as the device's are on their way.
                    for (event, cause) in
                        fired.events[before..].iter_mut().zip(emulator.causes().iter().flatten())
                    {
                        *event = event.with_cause(Cause::ALL[usize::from(*cause)]);
                    }
                    fired.report.add(emulator.report());
                }
                Ok(fired)
            };
            own.par_iter_mut().map(fire).collect::<Result<Vec<HostEvents>, EngineError>>()?
        };
        staging.unmap();
        self.free.push(staging);
        Ok(fired)
    }
}

/// The emulator of a view's pixels.
fn walker(settings: &EmulatorConfig, view: &View) -> Result<EventEmulator, ConfigError> {
    let (width, height) = view.size();
    let config = EmulatorConfig { width, height, sensor: view.sensor.clone(), ..settings.clone() };
    emulator(config, view.key)
}

/// Mean of `samples` layers, row-major; NaN where it is not known. As [`crate::Simulator::luminance`] has it.
fn mean(layers: &[u8], targets: &Targets, samples: usize) -> Vec<f32> {
    let light = |mean: f64| if mean < 0.0 { f32::NAN } else { mean.min(LIGHT_LIMIT) as f32 };
    mean_of_layers(layers, [targets.width, targets.height], samples).into_iter().map(light).collect()
}
