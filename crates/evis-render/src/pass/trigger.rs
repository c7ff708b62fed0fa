//! `trigger/*.wgsl`: count, prefix, scan, emit; and the resolve of `--antialias edges`. Twin: `cpu/trigger.rs`. `chain/walk.wgsl`
//! counts and emits where the sensor is more than thresholds. Twin: the emulator of `evis_core`.

use crate::pass::{Access, Binding, ComputePass, bind};

/// `trigger/tile_rate.wgsl`, wherever pixels walk.
const TILE_RATES_BINDING: u32 = 12;

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
    bind(TILE_RATES_BINDING, "tile_rates", Access::UintLayers),
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
    bind(TILE_RATES_BINDING, "tile_rates", Access::UintLayers),
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
    bind(TILE_RATES_BINDING, "tile_rates", Access::UintLayers),
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

/// `trigger/emit_dense.wgsl`.
pub const EMIT_DENSE_BINDINGS: &[Binding] = &[
    bind(0, "params", Access::Uniform),
    bind(1, "sensors", Access::Picture),
    bind(2, "means", Access::ReadLayers),
    bind(3, "memory_in", Access::ReadLayersWords),
    bind(4, "memory_out", Access::ReadLayersWords),
    bind(7, "status", Access::Write),
    bind(9, "window", Access::Uniform),
    bind(10, "dense", Access::Write),
    bind(11, "dense_after", Access::Write),
    bind(TILE_RATES_BINDING, "tile_rates", Access::UintLayers),
];

/// `chain/dense.wgsl`.
pub const CHAIN_DENSE_BINDINGS: &[Binding] = &[
    bind(0, "params", Access::Uniform),
    bind(1, "counts", Access::Read),
    bind(2, "prefixes", Access::Read),
    bind(3, "block_offsets", Access::Read),
    bind(4, "status", Access::Write),
    bind(6, "events", Access::Read),
    bind(9, "window", Access::Uniform),
    bind(10, "dense", Access::Write),
    bind(11, "dense_after", Access::Write),
];

/// `trigger/resolve.wgsl`.
pub const RESOLVE_BINDINGS: &[Binding] =
    &[bind(0, "samples", Access::Multisampled), bind(1, "layer", Access::StorageLayer)];

/// The mean of four coverage samples at each of `grid` by `grid` places of every pixel.
pub fn resolve(device: &wgpu::Device, grid: u32) -> ComputePass {
    ComputePass::new(device, "trigger/resolve.wgsl", RESOLVE_BINDINGS, &[("GRID", f64::from(grid))])
}
