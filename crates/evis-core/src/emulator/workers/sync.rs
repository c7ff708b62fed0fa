//! What `table` is built on.

pub(super) use std::sync::atomic::{AtomicBool, AtomicPtr, AtomicUsize, Ordering};
pub(super) use std::thread::panicking as is_panicking;
use std::time::{Duration, Instant};

/// How long a helper waits for more: less than it takes to wake one.
pub(super) const LINGER: Duration = Duration::from_micros(20);

/// Waiting that begins without sleeping.
pub(super) struct Backoff(Instant);

impl Backoff {
    pub fn new() -> Self {
        Self(Instant::now())
    }

    /// Whether to go on without sleeping.
    pub fn spins(&self) -> bool {
        self.0.elapsed() < LINGER
    }

    /// Waits a moment, without sleeping.
    pub fn spin(&mut self) {
        std::hint::spin_loop();
    }

    /// Waits a moment, and lets others run once it has lasted.
    pub fn wait(&mut self) {
        if self.spins() { self.spin() } else { std::thread::yield_now() }
    }
}
