//! Calls of the engine: without the GIL, with panics and errors as Python exceptions, and interruptible by Ctrl-C.

use std::any::Any;
use std::mem::ManuallyDrop;
use std::ops::Deref;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use pyo3::prelude::*;

use crate::errors::Failure;

/// Runs work of the engine without the GIL, turns panics and errors into Python exceptions, and checks for Ctrl-C before it
/// returns.
pub(crate) trait Detach {
    /// Runs `work`, which uses no thread, no device and no shared state, without the GIL. A forked process may do this too.
    fn detach_pure<T, E, F>(self, work: F) -> PyResult<T>
    where
        T: Send,
        E: Into<Failure>,
        F: FnOnce() -> Result<T, E> + Send;

    /// Runs `work` without the GIL. `work` must take every lock that it needs itself: a lock taken
    /// with the GIL held could wait for a thread that waits for the GIL.
    fn detach_engine<T, E, F>(self, work: F) -> PyResult<T>
    where
        T: Send,
        E: Into<Failure>,
        F: FnOnce() -> Result<T, E> + Send;

    /// As [`Self::detach_engine`], for work that may take long and ends soon after `stop` is set. Ctrl-C sets `stop`.
    fn detach_interruptible<T, E, F>(self, stop: &AtomicBool, work: F) -> PyResult<T>
    where
        T: Send,
        E: Into<Failure>,
        F: FnOnce() -> Result<T, E> + Send;
}

/// The process that has used threads or a device; 0 as long as none has.
static USED_IN: AtomicU32 = AtomicU32::new(0);

/// Refuses to use threads and devices of the process that this one was forked from: a fork copies one thread alone, so what
/// waits for another one waits for ever.
fn check_process() -> Result<(), Failure> {
    let process = std::process::id();
    match USED_IN.compare_exchange(0, process, Ordering::Relaxed, Ordering::Relaxed) {
        Ok(_) => Ok(()),
        Err(user) if user == process => Ok(()),
        Err(user) => Err(Failure::Engine(format!(
            "this process ({process}) was forked from one ({user}) that had used EVIS, whose threads and device it does not \
             have; start processes with multiprocessing's spawn or forkserver, or fork before the first call of EVIS"
        ))),
    }
}

/// A value that is dropped only in the process that made it: one that joins threads, releases a device or finishes a file
/// when it is dropped. A forked process leaks it.
pub(crate) struct ProcessBound<T> {
    value: ManuallyDrop<T>,
    process: u32,
}

impl<T> ProcessBound<T> {
    pub(crate) fn new(value: T) -> Self {
        Self { value: ManuallyDrop::new(value), process: std::process::id() }
    }
}

impl<T> Deref for ProcessBound<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

impl<T> Drop for ProcessBound<T> {
    fn drop(&mut self) {
        if std::process::id() == self.process {
            // SAFETY: it is dropped here alone, and never used again.
            unsafe { ManuallyDrop::drop(&mut self.value) }
        }
    }
}

/// Time between two checks for Ctrl-C.
pub(crate) const SIGNAL_PERIOD: Duration = Duration::from_millis(50);

impl Detach for Python<'_> {
    fn detach_pure<T, E, F>(self, work: F) -> PyResult<T>
    where
        T: Send,
        E: Into<Failure>,
        F: FnOnce() -> Result<T, E> + Send,
    {
        let outcome = self.detach(|| catch_panic(work));
        self.check_signals()?;
        Ok(outcome?)
    }

    fn detach_engine<T, E, F>(self, work: F) -> PyResult<T>
    where
        T: Send,
        E: Into<Failure>,
        F: FnOnce() -> Result<T, E> + Send,
    {
        check_process()?;
        let outcome = self.detach(|| catch_panic(work));
        self.check_signals()?;
        Ok(outcome?)
    }

    fn detach_interruptible<T, E, F>(self, stop: &AtomicBool, work: F) -> PyResult<T>
    where
        T: Send,
        E: Into<Failure>,
        F: FnOnce() -> Result<T, E> + Send,
    {
        check_process()?;
        stop.store(false, Ordering::Relaxed);
        // Python delivers signals to its main thread, so the work goes to another one.
        let (outcome, interruption) = self.detach(|| {
            let (send, receive) = channel();
            std::thread::scope(|scope| {
                // The receiver waits for this message as long as the thread lives.
                scope.spawn(move || send.send(catch_panic(work)));
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

fn catch_panic<T, E: Into<Failure>>(work: impl FnOnce() -> Result<T, E>) -> Result<T, Failure> {
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

/// Locks `mutex` even if a panic has poisoned it. For values that stay valid, such as an `Option`; the panic was reported.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

/// Locks `mutex`; refused where a panic has poisoned it: the value may be half changed.
pub(crate) fn lock_unpoisoned<T>(mutex: &Mutex<T>) -> Result<std::sync::MutexGuard<'_, T>, Failure> {
    mutex.lock().map_err(|_| {
        Failure::Engine(
            "this object is unusable since an internal error ended an earlier call; make a new one".into(),
        )
    })
}
