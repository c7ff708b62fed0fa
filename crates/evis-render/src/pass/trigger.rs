//! `trigger/*.wgsl`: count, prefix, scan, emit; and the resolve of `--aa edges`. Twin: `cpu/trigger.rs`. `chain/walk.wgsl`
//! counts and emits where the sensor is more than thresholds. Twin: the emulator of `evis_core`.

use std::sync::Arc;

use evis_core::{SensorConfig, TriggerRule};

use super::{Access, Binding, ComputePass, bind};
use crate::chain::{ChainPasses, ChainPlan};
use crate::config::Between;

/// `trigger/pace.wgsl`, wherever pixels walk.
const PACES_BINDING: u32 = 12;

/// `trigger/count.wgsl`.
pub const COUNT_BINDINGS: &[Binding] = &[
    bind(0, "params", Access::Uniform),
    bind(1, "sensors", Access::Picture),
    bind(2, "luminance_layers", Access::ReadLayers),
    bind(3, "memory_in", Access::ReadLayersWords),
    bind(4, "memory_out", Access::StorageLayersWords),
    bind(5, "counts", Access::Write),
    bind(6, "status", Access::Write),
    bind(7, "means", Access::StorageLayers),
    bind(PACES_BINDING, "paces", Access::UintLayers),
];
/// `trigger/block.wgsl`.
pub const BLOCK_BINDINGS: &[Binding] = &[
    bind(0, "block_params", Access::Uniform),
    bind(1, "counts", Access::Read),
    bind(2, "prefixes", Access::Write),
    bind(3, "block_sums", Access::Write),
];
/// `trigger/scan.wgsl`.
pub const SCAN_BINDINGS: &[Binding] = &[
    bind(0, "scan_params", Access::Uniform),
    bind(1, "block_sums", Access::Write),
    bind(2, "view_offsets", Access::Write),
    bind(3, "status", Access::Write),
];
/// `trigger/emit.wgsl`.
pub const EMIT_BINDINGS: &[Binding] = &[
    bind(0, "params", Access::Uniform),
    bind(1, "sensors", Access::Picture),
    bind(2, "means", Access::ReadLayers),
    bind(3, "memory_in", Access::ReadLayersWords),
    bind(4, "memory_out", Access::ReadLayersWords),
    bind(5, "prefixes", Access::Read),
    bind(6, "block_offsets", Access::Read),
    bind(7, "status", Access::Write),
    bind(8, "events", Access::Write),
    bind(PACES_BINDING, "paces", Access::UintLayers),
];
/// `chain/walk.wgsl` and `chain/begin.wgsl`.
pub const CHAIN_BINDINGS: &[Binding] = &[
    bind(0, "params", Access::Uniform),
    bind(1, "job", Access::Uniform),
    bind(2, "sensor", Access::Uniform),
    bind(3, "luminance_layers", Access::ReadLayers),
    bind(4, "views", Access::Read),
    bind(5, "feed", Access::Read),
    bind(6, "memory_in", Access::ReadLayersWord),
    bind(7, "memory_out", Access::UpdateLayersWord),
    bind(8, "cells", Access::Write),
    bind(9, "block_offsets", Access::Read),
    bind(10, "report", Access::Write),
    bind(11, "events", Access::Write),
    bind(PACES_BINDING, "paces", Access::UintLayers),
    bind(13, "kept", Access::Write),
    bind(14, "lists", Access::Write),
    bind(15, "frozen", Access::ReadLayers),
];
/// `chain/emit.wgsl`.
pub const KEPT_BINDINGS: &[Binding] = &[
    bind(0, "params", Access::Uniform),
    bind(1, "counts", Access::Read),
    bind(2, "prefixes", Access::Read),
    bind(3, "block_offsets", Access::Read),
    bind(4, "status", Access::Write),
    bind(5, "kept", Access::Read),
    bind(6, "events", Access::Write),
];
/// `trigger/resolve.wgsl`.
pub const RESOLVE_BINDINGS: &[Binding] =
    &[bind(0, "samples", Access::Multisampled), bind(1, "layer", Access::StorageLayer)];

/// Blocks of instants, within which tiles have paces of their own.
#[derive(Clone, Copy, Debug)]
pub struct Blocks {
    /// Of each; 1 where every pixel is sampled at every instant.
    pub instants: u32,
    /// How light runs between two samples within one.
    pub between: Between,
}

impl Blocks {
    /// Every pixel is sampled at every instant.
    #[cfg(test)]
    pub const NONE: Self = Self { instants: 1, between: Between::Line };
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
    /// Mean of coverage samples.
    pub resolve: ComputePass,
}

impl TriggerPasses {
    /// Builds them for the rules of `sensors`, one per class of views, and `samples` layers per instant.
    ///
    /// `unknown`: whether a luminance below 0 stands for one that is not known.
    pub fn new(
        device: &wgpu::Device,
        sensors: &[&SensorConfig],
        samples: u32,
        unknown: bool,
        blocks: Blocks,
        grid: u32,
    ) -> Self {
        let mut walks: Vec<Arc<WalkPasses>> = Vec::with_capacity(sensors.len());
        for sensor in sensors {
            // Classes of other sizes have the same rules.
            let known = sensors.iter().zip(&walks).find(|(other, _)| other.is_alike(sensor));
            let walk = known.map(|(_, walk)| walk.clone());
            walks.push(
                walk.unwrap_or_else(|| Arc::new(WalkPasses::new(device, sensor, samples, unknown, blocks))),
            );
        }
        Self {
            walks,
            block: ComputePass::new(device, "trigger/block.wgsl", BLOCK_BINDINGS, &[]),
            scan: ComputePass::new(device, "trigger/scan.wgsl", SCAN_BINDINGS, &[]),
            resolve: ComputePass::new(
                device,
                "trigger/resolve.wgsl",
                RESOLVE_BINDINGS,
                &[("GRID", f64::from(grid))],
            ),
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

fn ideal_constants(sensor: &SensorConfig, unknown: bool, blocks: Blocks) -> [(&'static str, f64); 4] {
    let rule = match sensor.trigger {
        // The host walks pixels that forget.
        TriggerRule::Crossing | TriggerRule::Difference => 0.0,
        TriggerRule::Latch => 1.0,
    };
    // A latch knows light at samples alone.
    let curve = blocks.between == Between::Curve && sensor.trigger == TriggerRule::Crossing;
    [
        ("TRIGGER_RULE", rule),
        ("MAY_BE_UNKNOWN", f64::from(u8::from(unknown))),
        ("BLOCK_INSTANTS", f64::from(blocks.instants)),
        ("CURVE", f64::from(u8::from(curve))),
    ]
}
