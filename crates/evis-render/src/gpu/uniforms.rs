//! What host and shaders share, byte for byte. Tests compare each with naga's view of the WGSL struct.
//! No `vec3` in here: its alignment differs between the two sides.

use bytemuck::{Pod, Zeroable};

use crate::gpu::sizes::MAX_INSTANTS;

/// `Frame` in `common/frame.wgsl`, up to its lights: [`LightRecord`]s follow.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Frame {
    /// Camera's x axis; w: camera position x.
    pub world_from_camera_right: [f32; 4],
    /// Camera's y axis; w: camera position y.
    pub world_from_camera_up: [f32; 4],
    /// Camera's z axis (it looks along the opposite); w: camera position z.
    pub world_from_camera_back: [f32; 4],
    /// Direction = ndc * (x, y) + (z, w).
    pub ray: [f32; 4],
    /// Of central rays 1; of parallel rays 0, depth at z_ndc 0, and how much less it is at 1.
    pub depth: [f32; 4],
    /// Background radiance; w: factor of the environment.
    pub background: [f32; 4],
    /// Ambient irradiance / pi; w: environment rotation.
    pub ambient: [f32; 4],
    /// First shadow layer of the environment.
    pub shadow_layer_base: u32,
    /// Root of the tree of what never moves.
    pub occluder_root: u32,
    /// First record of what moves.
    pub occluder_first: u32,
    /// Records of what moves.
    pub occluder_count: u32,
}

/// `OccluderRecord` in `raster/occluders.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct OccluderRecord {
    /// Around it: middle in the world, and radius.
    pub sphere: [f32; 4],
    /// First row of `object_from_world`.
    pub object_row_0: [f32; 4],
    /// Second row.
    pub object_row_1: [f32; 4],
    /// Third row.
    pub object_row_2: [f32; 4],
    /// Root of its tree.
    pub root: u32,
    /// Zero.
    pub pad_0: u32,
    /// Zero.
    pub pad_1: u32,
    /// Zero.
    pub pad_2: u32,
}

/// `InstanceRecord` in `common/object.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct InstanceRecord {
    /// Columns of the matrix.
    pub clip_from_object: [[f32; 4]; 4],
    /// First row of `world_from_object`.
    pub world_row_0: [f32; 4],
    /// Second row.
    pub world_row_1: [f32; 4],
    /// Third row.
    pub world_row_2: [f32; 4],
}

/// `ObjectRecord` in `common/object.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ObjectRecord {
    /// First joint, in joints.
    pub joint_base: u32,
    /// First weight.
    pub morph_weight_base: u32,
    /// First float of the displacements, less six per vertex before the primitive's first (wrapping).
    pub morph_data_base: u32,
    /// Targets.
    pub morph_target_count: u32,
    /// Vertices of the primitive.
    pub morph_vertex_count: u32,
    /// Instance label.
    pub instance_id: u32,
    /// Semantic label.
    pub semantic_id: u32,
    /// Factor on emission.
    pub emission_factor: f32,
    /// Linear base colour; w: metallic. Read where a host changes the material.
    pub base_metallic: [f32; 4],
    /// Emitted radiance; w: roughness. Read where a host changes the material.
    pub emissive_roughness: [f32; 4],
}

/// `Material` in `raster/material.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct MaterialUniform {
    /// Linear colour and alpha.
    pub base_color: [f32; 4],
    /// Emitted radiance; w: alpha cutoff.
    pub emissive: [f32; 4],
    /// Metallic, roughness, normal scale, occlusion strength.
    pub factors: [f32; 4],
    /// Two rows per texture; w of a first row: uv set.
    pub uv_rows: [[f32; 4]; 10],
}

/// `Light` in `common/frame.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct LightRecord {
    /// Position; w: kind.
    pub position_kind: [f32; 4],
    /// Direction; w: 1 / range².
    pub direction_range: [f32; 4],
    /// Colour times intensity; w: shadow layer within the environment, -1 for none.
    pub radiance_shadow: [f32; 4],
    /// Angular scale and offset; world size of a shadow texel per unit of clip w; where its map's cells begin, 0 for none.
    pub spot: [f32; 4],
    /// Columns of the shadow map's matrix.
    pub shadow_clip_from_world: [[f32; 4]; 4],
}

/// `LabelFrame` in `labels/geometry.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct LabelFrame {
    /// Records from this instant to the next.
    pub next_offset: u32,
    /// Records from this instant to the last.
    pub last_offset: u32,
    /// Pixels per unit of ndc.
    pub half_size: [f32; 2],
}

/// `SkyFlow` in `labels/sky.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct SkyFlow {
    /// Rotation and projection at the next label.
    pub next_clip_from_world: [[f32; 4]; 4],
    /// The same at the last label.
    pub last_clip_from_world: [[f32; 4]; 4],
    /// Pixels per unit of ndc.
    pub half_size: [f32; 2],
    /// Zero.
    pub pad: [f32; 2],
}

/// `TriggerParams` in `trigger/layout.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct TriggerParams {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Row length of the per-pixel buffers.
    pub stride: u32,
    /// Views in the group.
    pub view_count: u32,
    /// Of the whole chain: lists of pixels that wake, per view.
    pub lists: u32,
    /// Instants in the submission.
    pub instants: u32,
    /// Events that fit.
    pub event_capacity: u32,
    /// 1: the first instant only sets the reference.
    pub first: u32,
    /// Per instant: microseconds from the submission's base to the instant before it, from there to it, and the instant
    /// before it in stream time, low and high word.
    pub spans: [[u32; 4]; MAX_INSTANTS as usize],
}

/// `WindowBounds` in `trigger/dense.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct WindowBounds {
    /// Microseconds from the submission's base to the first window's start.
    pub start: i32,
    /// And to its end, where the second begins.
    pub end: i32,
}

/// `ViewSensor` in `trigger/layout.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ViewSensor {
    /// ON threshold.
    pub threshold_on: f32,
    /// OFF threshold.
    pub threshold_off: f32,
    /// Added before the logarithm.
    pub log_eps: f32,
    /// 1 / Y_ref.
    pub inverse_reference_luminance: f32,
}

/// `PixelMemory` in `trigger/layout.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct PixelMemory {
    /// Reference of the next event.
    pub reference_log: f32,
    /// Log intensity at the last sample.
    pub log_luminance: f32,
}

/// `Status` in `trigger/layout.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct Status {
    /// 1: a submission did not fit.
    pub stalled: u32,
    /// Events of the last submission.
    pub event_count: u32,
    /// Pixel intervals that hit the limit.
    pub clamped: u32,
    /// Pixels whose emission differs from their count.
    pub mismatched: u32,
    /// Pixels and instants that a method left unknown.
    pub unknown: u32,
    /// Events that pixels lost to their refractory period.
    pub suppressed: u32,
}

/// `MeanJob` in `adaptive/mean.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct MeanJob {
    /// Number of its first tile.
    pub first: u32,
    /// Tiles.
    pub count: u32,
    /// Workgroups per row of the dispatch.
    pub row: u32,
    /// Where the means go.
    pub layer: u32,
}

/// `AuditJob` in `adaptive/audit.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct AuditJob {
    /// Pixels of the tile within the picture.
    pub size: [u32; 2],
    /// Where its change goes.
    pub slot: u32,
    /// Added to the luminance before the logarithm.
    pub offset: f32,
}

/// `ChainStep` in `chain/layout.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct ChainStep {
    /// 0 count, 1 wake, 2 emit.
    pub mode: u32,
    /// Of waking.
    pub instant: u32,
    /// Zero.
    pub pad: [u32; 2],
}

/// `ChainSensor` in `chain/layout.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ChainSensor {
    /// Added before the logarithm.
    pub log_eps: f32,
    /// Added to light.
    pub dark_light: f32,
    /// `I` of `Y_ref`.
    pub full_scale: f32,
    /// Where the logarithm begins.
    pub knee: f32,
    /// What `I` is multiplied with below it.
    pub below_knee: f32,
    /// Of a bandwidth that follows light.
    pub bandwidth_offset: f32,
    /// Its least factor.
    pub bandwidth_least: f32,
    /// Its greatest factor.
    pub bandwidth_most: f32,
    /// Of the leak.
    pub leak_jitter: f32,
    /// Delay at `Y_ref`.
    pub latency_light_us: f32,
}

/// `BlockParams` in `trigger/block.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct BlockParams {
    /// Blocks of the group.
    pub block_count: u32,
    /// Invocations per row of the dispatch.
    pub row: u32,
}

/// `ScanParams` in `trigger/scan.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct ScanParams {
    /// Blocks of the group.
    pub block_count: u32,
    /// Blocks of a view.
    pub blocks_per_view: u32,
    /// Views.
    pub view_count: u32,
    /// Events that fit.
    pub event_capacity: u32,
}

/// `Batch` in `decoupled/layout.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct Batch {
    /// Pixels that were given, and those of tiles.
    pub pixels: u32,
    /// Events that fit.
    pub capacity: u32,
    /// Workgroups per row of a dispatch.
    pub row: u32,
    /// Row of points at which jobs begin.
    pub jobs: u32,
    /// Row of textures at which sums of texels begin.
    pub sums: u32,
    /// Word at which light that is wanted throughout a block begins.
    pub light: u32,
    /// Row of textures at which texels of maps begin.
    pub texels: u32,
    /// Row of textures at which light from all around begins.
    pub around: u32,
    /// Pixels that were given.
    pub given: u32,
    /// Tiles.
    pub tiles: u32,
    /// Word at which these begin.
    pub tile_words: u32,
    /// Word at which begins what their pixels remember.
    pub memories: u32,
    /// Word at which their lists of entries begin.
    pub own: u32,
    /// Word at which those are listed that failed.
    pub failed: u32,
    /// Zero.
    pub pad_0: u32,
    /// Zero.
    pub pad_1: u32,
}

/// `Turn` in `decoupled/layout.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct Turn {
    /// Number of the round.
    pub round: u32,
    /// 1: the first of a block.
    pub first: u32,
    /// Zero.
    pub pad_0: u32,
    /// Zero.
    pub pad_1: u32,
}

/// `KeyParams` in `splat/prepare.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct KeyParams {
    /// Pixels per row of the keyframe, margins included.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// View within both slots.
    pub view: u32,
    /// Pixels beyond each border of the sensor.
    pub margin: u32,
    /// Light above this counts as this.
    pub brightest: f32,
    /// Zero.
    pub pad_0: u32,
    /// Zero.
    pub pad_1: u32,
    /// Zero.
    pub pad_2: u32,
}

/// `SplatParams` in `splat/layout.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct SplatParams {
    /// Target pixels per row.
    pub width: u32,
    /// Target rows.
    pub height: u32,
    /// Keyframe pixels per row.
    pub canvas_width: u32,
    /// Keyframe rows.
    pub canvas_height: u32,
    /// Keyframe pixels beyond each border.
    pub margin: u32,
    /// Views in the group.
    pub view_count: u32,
    /// First row of the transforms.
    pub transform_base: u32,
    /// Objects.
    pub objects: u32,
    /// 0 the older keyframe, 1 the newer one.
    pub side: u32,
    /// Half of the keyframe buffers.
    pub slot: u32,
    /// Part of the way to the other keyframe.
    pub moved: f32,
    /// Part of the gap that has passed.
    pub elapsed: f32,
    /// Layer of view 0.
    pub first_layer: u32,
    /// Layers from one view to the next.
    pub layers_per_view: u32,
    /// Bits of a splatted index.
    pub index_bits: u32,
    /// Added to luminance before a logarithm.
    pub log_floor: f32,
    /// Most light that colours can add up.
    pub brightest: f32,
    /// Zero.
    pub pad_0: u32,
    /// Zero.
    pub pad_1: u32,
    /// Zero.
    pub pad_2: u32,
}
