//! The simulator: a scene, its cameras and a device; yields packets.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::task::Poll;
use std::thread::JoinHandle;
use std::time::Duration;

use evis_core::{CameraInfo, ConfigError};
use evis_scene::Scene;

use crate::config::RunConfig;
use crate::engine::Engine;
use crate::error::EngineError;
use crate::gpu::Gpu;
use crate::output::packet::Packet;
use crate::world::view;

/// Packets that a stream renders ahead of its reader.
const AHEAD: usize = 4;

/// Renders a scene and streams its events.
pub struct Simulator {
    cameras: Vec<CameraInfo>,
    environments: usize,
    config: RunConfig,
    engine: Engine,
}

impl Simulator {
    /// Prepares `scene` on `gpu`.
    ///
    /// # Errors
    /// A setting that cannot be used, a camera that does not exist, or a device that is too small.
    pub fn new(gpu: &Gpu, scene: Arc<Scene>, mut config: RunConfig) -> Result<Self, EngineError> {
        config.check()?;
        let (views, cameras) = view::views(&scene, &config)?;
        // Each camera's first view has its sensor.
        config.tell_sensors(cameras.iter().map(|c| c.name.as_str()).zip(views.iter().map(|v| &v.sensor)));
        let environments = scene.variants.len().max(1);
        let engine = gpu.guarded(|| Engine::new(gpu, scene, views, &mut config))?;
        Ok(Self { cameras, environments, config, engine })
    }

    /// The rendered cameras, in view order.
    pub fn cameras(&self) -> &[CameraInfo] {
        &self.cameras
    }

    /// Environments rendered side by side.
    pub fn environments(&self) -> usize {
        self.environments
    }

    /// The settings in force, `reference_luminance` filled in.
    pub fn config(&self) -> &RunConfig {
        &self.config
    }

    /// Stream time up to which packets were delivered, in microseconds.
    pub fn now_us(&self) -> i64 {
        self.engine.now_us()
    }

    /// What view `view` shows at stream time `t_us`, as its pixels integrate it: mean linear luminance over the samples,
    /// row-major from the top. The stream is left as it is.
    ///
    /// # Errors
    /// A view that does not exist, or a device that fails.
    pub fn luminance(&mut self, view: usize, t_us: i64) -> Result<Vec<f64>, EngineError> {
        self.engine.luminance(view, t_us)
    }

    /// See [`Engine::restart`].
    pub(crate) fn restart(
        &mut self,
        start_us: i64,
        only: Vec<Vec<bool>>,
        every_instant: bool,
    ) -> Result<(), EngineError> {
        self.engine.restart(start_us, only, every_instant)
    }

    /// Set from another thread, it ends a step after the submission in work with [`EngineError::Stopped`].
    /// Nothing is lost: cleared, the next step delivers everything from [`Simulator::now_us`] on.
    pub fn stop(&self) -> &Arc<AtomicBool> {
        self.engine.stop()
    }

    /// Runs to `until_us` (stream time) and yields everything in `[now, until_us)`.
    ///
    /// # Errors
    /// `until_us` must lie after [`Simulator::now_us`]; the device may fail.
    pub fn step(&mut self, until_us: i64) -> Result<Packet, EngineError> {
        if until_us <= self.now_us() {
            let remedy = format!("after the stream's present, {} microseconds", self.now_us());
            return Err(ConfigError::new("until_us", until_us, remedy).into());
        }
        self.engine.deliver(until_us, until_us)
    }

    /// Streams `duration_us` from now in packets of `packet_us`, rendering ahead on a thread of its own
    /// that ends with the stream. The last packet is shorter where the duration is no multiple.
    ///
    /// # Errors
    /// Both times must be above 0.
    pub fn stream(self, duration_us: i64, packet_us: i64) -> Result<PacketStream, EngineError> {
        for (what, value) in [("duration_us", duration_us), ("packet_us", packet_us)] {
            if value <= 0 {
                return Err(ConfigError::new(what, value, "above 0 microseconds").into());
            }
        }
        let end = self.now_us().saturating_add(duration_us);
        let (send, receive) = sync_channel(AHEAD);
        let mut engine = self.engine;
        let stop = engine.stop().clone();
        let stopped = stop.clone();
        let thread = std::thread::Builder::new()
            .name("evis-stream".into())
            .spawn(move || {
                let mut now = engine.now_us();
                while now < end && !stopped.load(Ordering::Relaxed) {
                    let until = now.saturating_add(packet_us).min(end);
                    let packet = engine.deliver(until, end);
                    let failed = packet.is_err();
                    if send.send(packet).is_err() || failed {
                        return;
                    }
                    now = until;
                }
            })
            .map_err(|e| EngineError::Device(format!("cannot start the stream's thread: {e}")))?;
        Ok(PacketStream { receive: Some(receive), stop, thread: Some(thread) })
    }
}

/// Packets in order; dropping it stops the engine after the interval in work.
pub struct PacketStream {
    receive: Option<Receiver<Result<Packet, EngineError>>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Iterator for PacketStream {
    type Item = Result<Packet, EngineError>;

    fn next(&mut self) -> Option<Self::Item> {
        match self.receive.as_ref()?.recv() {
            Ok(packet) => Some(packet),
            Err(_) => self.ended(),
        }
    }
}

impl PacketStream {
    /// Waits for the next packet for at most `wait`; pending where it is not there yet, so that a host can
    /// look for an interruption meanwhile.
    pub fn poll_next(&mut self, wait: Duration) -> Poll<Option<Result<Packet, EngineError>>> {
        let Some(receive) = &self.receive else { return Poll::Ready(None) };
        match receive.recv_timeout(wait) {
            Ok(packet) => Poll::Ready(Some(packet)),
            Err(RecvTimeoutError::Timeout) => Poll::Pending,
            Err(RecvTimeoutError::Disconnected) => Poll::Ready(self.ended()),
        }
    }

    /// After the thread has gone: nothing, or the error that a panic there is. A stream that broke must not
    /// look like one that came to its end.
    fn ended(&mut self) -> Option<Result<Packet, EngineError>> {
        self.receive = None;
        match self.thread.take()?.join() {
            Ok(()) => None,
            Err(_) => Some(Err(EngineError::Device(
                "the stream's thread stopped with an internal error; please report what it printed".into(),
            ))),
        }
    }
}

impl Drop for PacketStream {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // The sender must not wait for a reader that is gone.
        self.receive = None;
        if let Some(thread) = self.thread.take() {
            // A panic there was a broken invariant; it has printed itself.
            let _ = thread.join();
        }
    }
}
