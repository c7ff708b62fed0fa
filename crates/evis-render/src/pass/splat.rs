//! `splat/*.wgsl`: from a keyframe's pictures to the light of an instant. Twin: `cpu/splat.rs`.

use evis_core::WarpVariant;

use crate::pass::{Access, Binding, ComputePass, bind};

/// Invocations per workgroup along a row; `splat/layout.wgsl` has the same constant.
pub const SPLAT_WORKGROUP: u32 = 64;

/// Planes of 32 bits per pixel and side: depth keys, weight or index, light, its carries.
pub const SUM_PLANES: u64 = 4;

/// Target pixels along each axis that share a flag; `splat/layout.wgsl` has the same constant.
pub const HOLE_TILE: u32 = 16;

/// Planes of 32 bits per keyframe pixel and side: position, depth key.
pub const PLACED_PLANES: u64 = 3;

/// `splat/prepare.wgsl`.
pub const PREPARE_BINDINGS: &[Binding] = &[
    bind(0, "key", Access::Uniform),
    bind(1, "luminance_layers", Access::Layers),
    bind(2, "inverse_depths", Access::Picture),
    bind(3, "flows", Access::Picture),
    bind(4, "ids", Access::UintPicture),
    bind(5, "forward", Access::StorageLayersRgba),
    bind(6, "backward", Access::StorageLayersRgba),
    bind(7, "objects", Access::Write),
    bind(8, "largest", Access::Write),
    bind(9, "clipped", Access::Write),
];

/// `splat/place.wgsl`.
pub const PLACE_BINDINGS: &[Binding] = &[
    bind(0, "params", Access::DynamicUniform),
    bind(1, "sources", Access::Layers),
    bind(2, "objects", Access::Read),
    bind(3, "transforms", Access::Read),
    bind(4, "placed", Access::Write),
    bind(5, "sums", Access::Write),
    bind(6, "hole_tiles", Access::Read),
];

/// `splat/holes.wgsl`.
pub const HOLES_BINDINGS: &[Binding] = &[
    bind(0, "params", Access::DynamicUniform),
    bind(1, "sums", Access::Read),
    bind(2, "hole_tiles", Access::Write),
];

/// `splat/accumulate.wgsl`.
pub const ACCUMULATE_BINDINGS: &[Binding] = &[
    bind(0, "params", Access::DynamicUniform),
    bind(1, "sources", Access::Layers),
    bind(2, "largest", Access::Read),
    bind(3, "placed", Access::Read),
    bind(4, "sums", Access::Write),
];

/// `splat/index.wgsl`.
pub const INDEX_BINDINGS: &[Binding] = &[
    bind(0, "params", Access::DynamicUniform),
    bind(1, "placed", Access::Read),
    bind(2, "sums", Access::Write),
];

/// `splat/resolve.wgsl`.
pub const RESOLVE_BINDINGS: &[Binding] = &[
    bind(0, "params", Access::DynamicUniform),
    bind(1, "sums", Access::Read),
    bind(2, "forward", Access::Layers),
    bind(3, "placed", Access::Read),
    bind(4, "largest", Access::Read),
    bind(5, "layers", Access::StorageLayers),
];

/// `splat/show.wgsl`.
pub const SHOW_BINDINGS: &[Binding] = &[
    bind(0, "params", Access::DynamicUniform),
    bind(1, "forward", Access::Layers),
    bind(2, "layers", Access::StorageLayers),
];

/// The passes of one side of an instant.
pub struct SidePasses {
    /// Where each source is.
    pub place: ComputePass,
    /// What it brings: colour or index.
    pub carry: ComputePass,
}

/// The splat passes.
pub struct SplatPasses {
    /// Sources that one invocation adds up; the sums are the same whatever it is.
    pub run: u32,
    /// Keyframe pictures to sources.
    pub prepare: ComputePass,
    /// The newer keyframe, which comes first.
    pub newer: SidePasses,
    /// Where the newer one has holes; `None` where the older one is splatted everywhere.
    pub holes: Option<ComputePass>,
    /// The older keyframe: everywhere, or only in the newer one's holes.
    pub older: SidePasses,
    /// Both to one luminance.
    pub resolve: ComputePass,
    /// A keyframe itself.
    pub show: ComputePass,
}

impl SplatPasses {
    /// Builds them for `variant`, keyframes of `samples` samples, and `run` sources added up by one invocation.
    pub fn new(device: &wgpu::Device, variant: WarpVariant, samples: u32, run: u32) -> Self {
        let flag = |b: bool| f64::from(u8::from(b));
        let is_paper = variant == WarpVariant::EvisPaper;
        let paper = ("EVIS_PAPER", flag(is_paper));
        let side = |fill_holes: bool| {
            let fill = ("FILL_HOLES", flag(fill_holes));
            SidePasses {
                place: ComputePass::new(device, "splat/place.wgsl", PLACE_BINDINGS, &[paper, fill]),
                carry: match variant {
                    WarpVariant::EvisPaper => {
                        let add = [fill, ("RUN", f64::from(run))];
                        ComputePass::new(device, "splat/accumulate.wgsl", ACCUMULATE_BINDINGS, &add)
                    }
                    WarpVariant::Splat => ComputePass::new(device, "splat/index.wgsl", INDEX_BINDINGS, &[]),
                },
            }
        };
        let prepare = [("SAMPLES", f64::from(samples)), ("WITH_OBJECTS", flag(!is_paper))];
        Self {
            run,
            prepare: ComputePass::new(device, "splat/prepare.wgsl", PREPARE_BINDINGS, &prepare),
            newer: side(false),
            holes: is_paper.then(|| ComputePass::new(device, "splat/holes.wgsl", HOLES_BINDINGS, &[])),
            older: side(is_paper),
            resolve: ComputePass::new(device, "splat/resolve.wgsl", RESOLVE_BINDINGS, &[paper]),
            show: ComputePass::new(device, "splat/show.wgsl", SHOW_BINDINGS, &[paper]),
        }
    }
}
