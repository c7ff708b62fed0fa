//! The simulator: a scene, its cameras and a device; yields packets.

use std::sync::Arc;

use evis_core::CameraInfo;
use evis_scene::Scene;

use crate::config::RunConfig;
use crate::error::EngineError;
use crate::gpu::Gpu;
use crate::packet::Packet;

/// Renders a scene and streams its events.
pub struct Simulator {
    cameras: Vec<CameraInfo>,
    config: RunConfig,
}

impl Simulator {
    /// Prepares `scene` on `gpu`.
    ///
    /// # Errors
    /// A setting that cannot be used, a camera that does not exist, or a device that is too small.
    pub fn new(_gpu: &Gpu, _scene: Arc<Scene>, config: RunConfig) -> Result<Self, EngineError> {
        config.check()?;
        Ok(Self { cameras: Vec::new(), config })
    }

    /// The rendered cameras, in view order.
    pub fn cameras(&self) -> &[CameraInfo] {
        &self.cameras
    }

    /// Environments rendered side by side.
    pub fn environments(&self) -> usize {
        1
    }

    /// The settings in force, `reference_luminance` filled in.
    pub fn config(&self) -> &RunConfig {
        &self.config
    }

    /// Stream time up to which packets were delivered, in microseconds.
    pub fn now_us(&self) -> i64 {
        0
    }

    /// Runs to `until_us` (stream time) and yields everything in `[now, until_us)`.
    ///
    /// # Errors
    /// `until_us` must lie after [`Simulator::now_us`]; the device may fail.
    pub fn step(&mut self, _until_us: i64) -> Result<Packet, EngineError> {
        Err(EngineError::Device("not yet".into()))
    }

    /// Streams `duration_us` from now in packets of `packet_us`, rendering ahead on a thread of its own
    /// that ends with the stream. The last packet is shorter where the duration is no multiple.
    pub fn stream(self, _duration_us: i64, _packet_us: i64) -> Result<PacketStream, EngineError> {
        Err(EngineError::Device("not yet".into()))
    }
}

/// Packets in order; dropping it stops the engine after the interval in work.
pub struct PacketStream {}

impl Iterator for PacketStream {
    type Item = Result<Packet, EngineError>;

    fn next(&mut self) -> Option<Self::Item> {
        None
    }
}
