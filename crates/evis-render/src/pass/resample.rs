//! `resample/*.wgsl`: cameras with a distorted lens, out of a picture without distortion.

use crate::pass::{Access, Binding, ComputePass, bind};

/// `resample/samples.wgsl`.
pub const SAMPLES_BINDINGS: &[Binding] = &[
    bind(0, "starts", Access::Read),
    bind(1, "entries", Access::Read),
    bind(2, "pictures", Access::Layers),
    bind(3, "layer", Access::StorageLayer),
];

/// `resample/coverage.wgsl`.
pub const COVERAGE_BINDINGS: &[Binding] = &[
    bind(0, "starts", Access::Read),
    bind(1, "entries", Access::Read),
    bind(2, "pictures", Access::Multisampled),
    bind(3, "layer", Access::StorageLayer),
];

/// The mean of samples in layers, whose entries have `edge_bits` for an edge.
pub fn samples(device: &wgpu::Device, edge_bits: u32) -> ComputePass {
    let constants = [("EDGE_BITS", f64::from(edge_bits))];
    ComputePass::new(device, "resample/samples.wgsl", SAMPLES_BINDINGS, &constants)
}

/// The mean of coverage samples.
pub fn coverage(device: &wgpu::Device, edge_bits: u32) -> ComputePass {
    let constants = [("EDGE_BITS", f64::from(edge_bits))];
    ComputePass::new(device, "resample/coverage.wgsl", COVERAGE_BINDINGS, &constants)
}
