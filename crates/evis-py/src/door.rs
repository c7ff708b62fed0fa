//! The one door through which Python enters the engine.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use pyo3::prelude::*;

use crate::errors::Failure;

/// Enters the engine: releases the GIL, turns panics and errors into Python exceptions, and looks for
/// Ctrl-C before coming back.
pub(crate) trait EnterEngine {
    /// Runs `work` without the GIL. `work` must take every lock that it needs itself: a lock taken
    /// with the GIL held could wait for a thread that waits for the GIL.
    fn enter_engine<T, E, F>(self, work: F) -> PyResult<T>
    where
        T: Send,
        E: Into<Failure>,
        F: FnOnce() -> Result<T, E> + Send;

    /// The same for work that may take long and ends soon after `stop` is set: Ctrl-C sets it.
    fn enter_engine_for_long<T, E, F>(self, stop: &AtomicBool, work: F) -> PyResult<T>
    where
        T: Send,
        E: Into<Failure>,
        F: FnOnce() -> Result<T, E> + Send;
}

/// How long the door waits before it looks for Ctrl-C.
pub(crate) const SIGNAL_PERIOD: Duration = Duration::from_millis(50);

impl EnterEngine for Python<'_> {
    fn enter_engine<T, E, F>(self, work: F) -> PyResult<T>
    where
        T: Send,
        E: Into<Failure>,
        F: FnOnce() -> Result<T, E> + Send,
    {
        let outcome = self.detach(|| caught(work));
        self.check_signals()?;
        Ok(outcome?)
    }

    fn enter_engine_for_long<T, E, F>(self, stop: &AtomicBool, work: F) -> PyResult<T>
    where
        T: Send,
        E: Into<Failure>,
        F: FnOnce() -> Result<T, E> + Send,
    {
        stop.store(false, Ordering::Relaxed);
        // Python delivers signals to its main thread, so the work goes to another one.
        let (outcome, interruption) = self.detach(|| {
            let (send, receive) = channel();
            std::thread::scope(|scope| {
                // The receiver waits for this message as long as the thread lives.
                scope.spawn(move || send.send(caught(work)));
                let mut interruption = None;
                loop {
                    match receive.recv_timeout(SIGNAL_PERIOD) {
                        Ok(outcome) => return (outcome, interruption),
                        Err(RecvTimeoutError::Disconnected) => {
                            let lost = Failure::Engine("internal error: the engine's thread is gone".into());
                            return (Err(lost), interruption);
                        }
                        Err(RecvTimeoutError::Timeout) => {}
                    }
                    if let Err(signal) = Python::attach(|py| py.check_signals()) {
                        stop.store(true, Ordering::Relaxed);
                        interruption = Some(signal);
                    }
                }
            })
        });
        if let Some(signal) = interruption {
            return Err(signal);
        }
        self.check_signals()?;
        Ok(outcome?)
    }
}

fn caught<T, E: Into<Failure>>(work: impl FnOnce() -> Result<T, E>) -> Result<T, Failure> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(result) => result.map_err(Into::into),
        Err(panic) => Err(Failure::Engine(format!(
            "internal error: {}; this is a bug in EVIS, please report it with what led to it",
            panic_message(&*panic)
        ))),
    }
}

fn panic_message(panic: &(dyn Any + Send)) -> &str {
    panic
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("a panic without a message")
}
