//! `adaptive/mean.wgsl`: the mean of the samples in the tiles that were drawn. Twin: `cpu/trigger.rs`, `log_luminance`.

use crate::pass::{Access, Binding, ComputePass, bind};

/// `adaptive/mean.wgsl`.
pub const MEAN_BINDINGS: &[Binding] = &[
    bind(0, "job", Access::DynamicUniform),
    bind(1, "tiles", Access::Read),
    bind(2, "luminance_layers", Access::ReadLayers),
    bind(3, "layers", Access::StorageLayers),
];

/// The pass for `samples` per pixel.
pub fn mean(device: &wgpu::Device, samples: u32) -> ComputePass {
    let constants = [("SAMPLES", f64::from(samples))];
    ComputePass::new(device, "adaptive/mean.wgsl", MEAN_BINDINGS, &constants)
}

/// `adaptive/audit.wgsl`.
pub const AUDIT_BINDINGS: &[Binding] = &[
    bind(0, "job", Access::DynamicUniform),
    bind(1, "layers", Access::ReadLayers),
    bind(2, "changes", Access::Write),
];

/// The pass that compares a tile with the samples around it.
pub fn audit(device: &wgpu::Device) -> ComputePass {
    ComputePass::new(device, "adaptive/audit.wgsl", AUDIT_BINDINGS, &[])
}

/// `adaptive/resolve.wgsl`.
pub const TILE_RESOLVE_BINDINGS: &[Binding] = &[
    bind(0, "job", Access::DynamicUniform),
    bind(1, "tiles", Access::Read),
    bind(2, "samples", Access::Multisampled),
    bind(3, "layers", Access::StorageLayers),
];

/// The mean of four coverage samples at each of `grid` by `grid` places of a pixel.
pub fn resolve(device: &wgpu::Device, grid: u32) -> ComputePass {
    let constants = [("GRID", f64::from(grid))];
    ComputePass::new(device, "adaptive/resolve.wgsl", TILE_RESOLVE_BINDINGS, &constants)
}
