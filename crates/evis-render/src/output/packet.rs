//! What a stream yields: everything of one time interval.

use evis_core::{Event, LabelFrame, PoseSample};
use evis_representation::Array;
use serde::Serialize;

use crate::sampling::audit::Finding;
use crate::sampling::clipped::ClippedLight;

/// Everything that happened in `[start_us, end_us)`, all environments and cameras.
#[derive(Clone, Debug, Default)]
pub struct Packet {
    /// First microsecond, stream time.
    pub start_us: i64,
    /// One past the last microsecond.
    pub end_us: i64,
    /// One per environment and camera, environment-major.
    pub views: Vec<ViewPacket>,
    /// Counts and measured times.
    pub report: PacketReport,
}

/// One camera of one environment.
#[derive(Clone, Debug, Default)]
pub struct ViewPacket {
    /// Environment index.
    pub environment: usize,
    /// Index into `Simulator::cameras`.
    pub camera: usize,
    /// In canonical order.
    pub events: Vec<Event>,
    /// Dense arrays of the windows of time that end in the packet, in order, where they are asked for; then there are no
    /// events.
    pub dense: Option<Vec<DenseWindow>>,
    /// Why each event fired, as numbers of [`evis_core::Cause`]; empty where that is not asked for.
    pub causes: Vec<u8>,
    /// Label images whose time lies in the packet, by time, then kind.
    pub labels: Vec<LabelFrame>,
    /// `world_from_camera` at every label instant (at the label rate, also where no label is asked for).
    pub poses: Vec<PoseSample>,
}

/// The array of a view's events in a window.
#[derive(Clone, Debug, PartialEq)]
pub struct DenseWindow {
    /// First microsecond, stream time.
    pub start_us: i64,
    /// One past the last microsecond.
    pub end_us: i64,
    /// Its values.
    pub values: DenseValues,
}

/// Values of a dense array, with its shape: rows and columns last.
#[derive(Clone, Debug, PartialEq)]
pub enum DenseValues {
    /// Of frames and counts.
    I32(Array<i32>),
    /// Of all others.
    F32(Array<f32>),
}

/// Counts and measured times of a packet. Times never reach the stream's own bytes.
#[derive(Clone, Debug, Default, Serialize)]
pub struct PacketReport {
    /// Events of all views; with dense arrays those of the instants that were sampled meanwhile.
    pub events: u64,
    /// Events that the readout dropped, beyond its rate limit or where too many waited for a bus; no other event is lost, or
    /// the run has failed.
    pub dropped: u64,
    /// Events that pixels lost to their refractory period.
    pub suppressed: u64,
    /// Pixels and intervals whose event count hit the limit.
    pub clamped: u64,
    /// Instants sampled.
    pub instants: u64,
    /// Pixels drawn for events, all views and instants, each by all of its samples; margins of keyframes too.
    pub drawn_pixels: u64,
    /// Of decoupled sampling: tiles of 16x16 pixels whose events are rendered, all views. See [`crate::RunConfig::rendered_tiles`].
    pub rendered_tiles: u64,
    /// Of decoupled sampling: how many of `drawn_pixels` compute passes have evaluated.
    pub on_device: u64,
    /// Pixels, counted in each block of time, that these could not follow and left to the processor.
    pub refollowed: u64,
    /// Of decoupled sampling: pixels, counted in each block of time, of tiles in which nothing changed, which cost nothing.
    pub resting: u64,
    /// Keyframes drawn, all views; 0 for a method without them.
    pub keyframes: u64,
    /// Pixels of keyframes, margins included, brighter than the method counts: `evis-paper` clips them to 65 536 Y_ref.
    pub clipped: u64,
    /// Which, one per camera and environment.
    pub clipped_light: Vec<ClippedLight>,
    /// Pixels and instants that the method could not know: there the pixel waits for its next known instant.
    pub unknown: u64,
    /// Tiles that were skipped or sampled less often, and were rendered once more to compare.
    pub audited: u64,
    /// Of those: tiles that were compared by samples at other places than those of the stream.
    pub audited_with_others: u64,
    /// Of the audited ones: tiles in which light had changed by more than half a threshold.
    pub changed: u64,
    /// What changed, and where.
    pub findings: Vec<Finding>,
    /// Submissions run again because a buffer was too small.
    pub reruns: u64,
    /// Measured milliseconds per stage.
    pub times: StageTimes,
}

/// Measured wall-clock milliseconds.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct StageTimes {
    /// Poses, matrices, uploads, recording commands.
    pub host_ms: f64,
    /// Waiting for the device.
    pub device_wait_ms: f64,
    /// Sorting and packing what came back.
    pub pack_ms: f64,
    /// From the packet's request to its delivery.
    pub total_ms: f64,
}
