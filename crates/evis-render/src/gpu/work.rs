//! What a device was given to do, and when its passes ran.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::Receiver;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use crate::gpu::buffer::map;

/// Target of the events that say when a pass ran on the device.
pub const DEVICE_TARGET: &str = "evis_render::device";

/// What was submitted to a device so far.
#[derive(Debug, Default)]
pub struct Counters {
    submissions: AtomicU64,
    passes: AtomicU64,
    dispatches: AtomicU64,
}

/// [`Counters`] at some time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Command buffers.
    pub submissions: u64,
    /// Render and compute passes.
    pub passes: u64,
    /// Dispatches of compute passes.
    pub dispatches: u64,
}

impl Counters {
    /// Adds a command buffer of `passes` passes, which have `dispatches` dispatches.
    pub fn add(&self, passes: u64, dispatches: u64) {
        self.submissions.fetch_add(1, Ordering::Relaxed);
        self.passes.fetch_add(passes, Ordering::Relaxed);
        self.dispatches.fetch_add(dispatches, Ordering::Relaxed);
    }

    /// Their values now.
    pub fn read(&self) -> Counts {
        Counts {
            submissions: self.submissions.load(Ordering::Relaxed),
            passes: self.passes.load(Ordering::Relaxed),
            dispatches: self.dispatches.load(Ordering::Relaxed),
        }
    }
}

/// Times of passes on the device, on their way to the host.
#[derive(Debug)]
pub struct PassClock {
    period_ns: f64,
    began: Instant,
    state: Mutex<ClockState>,
}

#[derive(Debug, Default)]
struct ClockState {
    pending: VecDeque<Pending>,
    /// Nanoseconds from the device's clock to that of the host since `began`: the least that was seen between the end of a
    /// submission and the moment at which the host knew of it.
    lead_ns: Option<f64>,
}

#[derive(Debug)]
struct Pending {
    staging: wgpu::Buffer,
    labels: Vec<String>,
    mapped: Receiver<Result<(), wgpu::BufferAsyncError>>,
}

impl PassClock {
    /// The clock of a device whose ticks are `period_ns` nanoseconds.
    pub fn new(period_ns: f32) -> Self {
        Self { period_ns: f64::from(period_ns), began: Instant::now(), state: Mutex::default() }
    }

    /// Takes note of a submission that writes the times of the passes `labels` into `staging`.
    pub fn expect(&self, staging: wgpu::Buffer, labels: Vec<String>) {
        let pending = Pending { mapped: map(&staging), staging, labels };
        self.state.lock().unwrap_or_else(PoisonError::into_inner).pending.push_back(pending);
    }

    /// Emits the times that have arrived.
    pub fn report(&self) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        while let Some(Ok(Ok(()))) = state.pending.front().map(|pending| pending.mapped.try_recv()) {
            let Some(pending) = state.pending.pop_front() else { return };
            let Ok(bytes) = pending.staging.get_mapped_range(..) else { continue };
            let ticks: Vec<u64> = bytes.chunks_exact(8).map(bytemuck::pod_read_unaligned).collect();
            let now_ns = self.began.elapsed().as_nanos() as f64;
            let at = |tick: u64| tick as f64 * self.period_ns;
            let Some(end) = ticks.iter().copied().max() else { continue };
            let lead_ns = state.lead_ns.map_or(now_ns - at(end), |known| known.min(now_ns - at(end)));
            state.lead_ns = Some(lead_ns);
            for (label, times) in pending.labels.iter().zip(ticks.chunks_exact(2)) {
                let ago_ns = (now_ns - at(times[0]) - lead_ns).max(0.0) as u64;
                let length_ns = at(times[1].saturating_sub(times[0])) as u64;
                tracing::trace!(target: DEVICE_TARGET, pass = label.as_str(), ago_ns, length_ns);
            }
        }
    }
}
