//! The passes from luminance to events: what walks pixels, by class of views, and what gives events their places.

use std::sync::Arc;

use evis_core::{SensorConfig, TriggerRule};
use evis_representation::Polarities;

use crate::config::Interpolation;
use crate::config::dense::DenseKind;
use crate::pass::ComputePass;
use crate::pass::trigger::{
    BLOCK_BINDINGS, CHAIN_DENSE_BINDINGS, COUNT_BINDINGS, EMIT_BINDINGS, EMIT_DENSE_BINDINGS, SCAN_BINDINGS,
};
use crate::sensor::chain::{ChainPasses, ChainPlan};

/// Blocks of instants, within which tiles have rates of their own.
#[derive(Clone, Copy, Debug)]
pub struct Blocks {
    /// Of each; 1 where every pixel is sampled at every instant.
    pub instants: u32,
    /// How light runs between two samples within one.
    pub between: Interpolation,
}

impl Blocks {
    /// Every pixel is sampled at every instant.
    #[cfg(test)]
    pub const NONE: Self = Self { instants: 1, between: Interpolation::Line };
}

/// Whether pixels of both sensors go through the same passes: the sensors differ in numbers alone that each view has of its own
/// (thresholds and their spread, bandwidth, leak and noise, refractory period, latency and bus), and have the same stages.
pub fn share_passes(one: &SensorConfig, other: &SensorConfig) -> bool {
    let [host, other_host] = [one, other].map(SensorConfig::walks_on_host);
    let [ideal, other_ideal] = [one, other].map(SensorConfig::is_ideal);
    if (host, ideal) != (other_host, other_ideal) {
        return false;
    }
    if host {
        // An exposure is the schedule of what its views send to the host.
        return one.exposure == other.exposure;
    }
    if ideal {
        return one.is_alike(other);
    }
    let plan = |sensor: &SensorConfig| ChainPlan::new(sensor, 1, false, 1);
    plan(one) == plan(other) && one.readout.is_off() == other.readout.is_off()
}

/// What walks pixels over the instants of a submission, to count and to emit.
pub enum WalkPasses {
    /// Thresholds alone.
    Ideal {
        /// Events per pixel.
        count: ComputePass,
        /// Events to their places.
        emit: ComputePass,
    },
    /// Any stage.
    Chain(Box<ChainPasses>),
    /// The host walks them.
    Host,
}

impl WalkPasses {
    fn new(
        device: &wgpu::Device,
        sensor: &SensorConfig,
        samples: u32,
        unknown: bool,
        blocks: Blocks,
    ) -> Self {
        if sensor.walks_on_host() {
            return Self::Host;
        }
        if !sensor.is_ideal() {
            let plan = ChainPlan::new(sensor, samples, unknown, blocks.instants);
            return Self::Chain(Box::new(ChainPasses::new(device, plan)));
        }
        let constants = ideal_constants(sensor, unknown, blocks);
        let counting = [&[("SAMPLES", f64::from(samples))], &constants[..]].concat();
        Self::Ideal {
            count: ComputePass::new(device, "trigger/count.wgsl", COUNT_BINDINGS, &counting),
            emit: ComputePass::new(device, "trigger/emit.wgsl", EMIT_BINDINGS, &constants),
        }
    }
}

/// The trigger passes.
pub struct TriggerPasses {
    /// What walks pixels, by class of views.
    pub walks: Vec<Arc<WalkPasses>>,
    /// Prefix within blocks.
    pub block: ComputePass,
    /// Offsets of blocks and views.
    pub scan: ComputePass,
    /// What adds events to dense arrays, by class of views, where packets carry arrays; none where the host walks.
    pub dense: Vec<Option<ComputePass>>,
}

impl TriggerPasses {
    /// Builds them for the rules of `sensors`, one per class of views, each with its layers per instant.
    ///
    /// `unknown`: whether a luminance below 0 stands for one that is not known.
    pub fn new(
        device: &wgpu::Device,
        sensors: &[(&SensorConfig, u32)],
        unknown: bool,
        blocks: Blocks,
        dense: Option<&DenseKind>,
    ) -> Self {
        let mut walks: Vec<Arc<WalkPasses>> = Vec::with_capacity(sensors.len());
        for (sensor, samples) in sensors {
            // Classes of other sizes have the same rules.
            let alike = |other: &(&SensorConfig, u32)| other.1 == *samples && share_passes(other.0, sensor);
            let known = sensors.iter().zip(&walks).find(|(other, _)| alike(other));
            let walk = known.map(|(_, walk)| walk.clone());
            walks.push(
                walk.unwrap_or_else(|| Arc::new(WalkPasses::new(device, sensor, *samples, unknown, blocks))),
            );
        }
        let adding = |(sensor, _): &(&SensorConfig, u32)| {
            let kind = dense?;
            match (sensor.walks_on_host(), sensor.is_ideal()) {
                (true, _) => None,
                (_, true) => {
                    let constants =
                        [&ideal_constants(sensor, unknown, blocks)[..], &dense_constants(kind)].concat();
                    let file = "trigger/emit_dense.wgsl";
                    Some(ComputePass::new(device, file, EMIT_DENSE_BINDINGS, &constants))
                }
                _ => Some(chain_dense(device, kind)),
            }
        };
        Self {
            dense: sensors.iter().map(adding).collect(),
            walks,
            block: ComputePass::new(device, "trigger/block.wgsl", BLOCK_BINDINGS, &[]),
            scan: ComputePass::new(device, "trigger/scan.wgsl", SCAN_BINDINGS, &[]),
        }
    }

    /// Those of sensors with more stages than thresholds in continuous time, one per class of views, for light that is known at
    /// times of each pixel's own.
    pub fn with_own_times(
        device: &wgpu::Device,
        sensors: &[&SensorConfig],
        dense: Option<&DenseKind>,
    ) -> Self {
        let walk = |sensor: &&SensorConfig| {
            let plan = ChainPlan::new(sensor, 1, false, 1).with_own_times();
            Arc::new(WalkPasses::Chain(Box::new(ChainPasses::new(device, plan))))
        };
        Self {
            walks: sensors.iter().map(walk).collect(),
            dense: sensors.iter().map(|_| Some(chain_dense(device, dense?))).collect(),
            block: ComputePass::new(device, "trigger/block.wgsl", BLOCK_BINDINGS, &[]),
            scan: ComputePass::new(device, "trigger/scan.wgsl", SCAN_BINDINGS, &[]),
        }
    }

    /// The chain of a class, where it has one.
    pub fn chain(&self, class: usize) -> Option<&ChainPasses> {
        match &*self.walks[class] {
            WalkPasses::Ideal { .. } | WalkPasses::Host => None,
            WalkPasses::Chain(chain) => Some(chain),
        }
    }
}

/// What adds the events of a chain to arrays.
fn chain_dense(device: &wgpu::Device, kind: &DenseKind) -> ComputePass {
    ComputePass::new(device, "chain/dense.wgsl", CHAIN_DENSE_BINDINGS, &dense_constants(kind))
}

/// What `trigger/dense.wgsl` is compiled with.
fn dense_constants(kind: &DenseKind) -> [(&'static str, f64); 2] {
    let (kind, bins) = match *kind {
        DenseKind::EventFrame | DenseKind::Counts => (0.0, 1),
        DenseKind::VoxelGrid { bins, polarities: Polarities::Signed, .. } => (1.0, bins),
        DenseKind::VoxelGrid { bins, polarities: Polarities::Split, .. } => (2.0, bins),
        DenseKind::TimeSurface { .. } => (3.0, 1),
    };
    [("KIND", kind), ("BINS", f64::from(bins))]
}

fn ideal_constants(sensor: &SensorConfig, unknown: bool, blocks: Blocks) -> [(&'static str, f64); 4] {
    let rule = match sensor.trigger {
        // The host walks pixels that forget.
        TriggerRule::Crossing | TriggerRule::Difference => 0.0,
        TriggerRule::Latch => 1.0,
    };
    // A latch knows light at samples alone.
    let curve = blocks.between == Interpolation::Curve && sensor.trigger == TriggerRule::Crossing;
    [
        ("TRIGGER_RULE", rule),
        ("MAY_BE_UNKNOWN", f64::from(u8::from(unknown))),
        ("BLOCK_INSTANTS", f64::from(blocks.instants)),
        ("CURVE", f64::from(u8::from(curve))),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sensors_share_passes_that_differ_in_numbers_of_views() {
        let preset = |name: &str| SensorConfig::preset(name).unwrap();
        let changed = |name: &str, change: fn(&mut SensorConfig)| {
            let mut sensor = preset(name);
            change(&mut sensor);
            assert_ne!(sensor, preset(name));
            share_passes(&preset(name), &sensor) && share_passes(&sensor, &preset(name))
        };
        assert!(changed("ideal", |s| s.threshold_on = 0.3));
        assert!(changed("v2e", |s| s.pattern.sigma = 0.01));
        assert!(changed("v2e", |s| s.photoreceptor.cutoff_hz = 50.0));
        assert!(changed("v2e", |s| s.refractory.period_us = 20));
        assert!(changed("v2e", |s| (s.noise.leak_hz, s.noise.shot_hz) = (0.3, 4.0)));
        assert!(changed("gen4-like", |s| s.readout.latency_us = 1.0));
        assert!(changed("davis346", |s| s.diffusion.as_mut().unwrap().k1 = 5.0));
        // What needs other passes, or is one number for all of them.
        assert!(!changed("ideal", |s| s.log_eps = 0.1));
        assert!(!changed("ideal", |s| s.pattern.sigma = 0.01));
        assert!(!changed("ideal", |s| s.exposure.time_us = 100));
        assert!(!changed("v2e", |s| s.log_eps = 0.1));
        assert!(!changed("v2e", |s| s.photoreceptor.cutoff_hz = 0.0));
        assert!(!changed("v2e", |s| s.refractory.period_us = 0));
        assert!(!changed("v2e", |s| s.noise.leak_hz = 0.0));
        assert!(!changed("v2e", |s| s.readout.latency_us = 5.0));
        assert!(!share_passes(&preset("v2e"), &preset("davis346")));
    }
}
