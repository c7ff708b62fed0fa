//! The one door through which Python enters the engine.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};

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
}

impl EnterEngine for Python<'_> {
    fn enter_engine<T, E, F>(self, work: F) -> PyResult<T>
    where
        T: Send,
        E: Into<Failure>,
        F: FnOnce() -> Result<T, E> + Send,
    {
        let outcome = self.detach(|| match catch_unwind(AssertUnwindSafe(work)) {
            Ok(result) => result.map_err(Into::into),
            Err(panic) => Err(Failure::Engine(format!(
                "internal error: {}; this is a bug in EVIS, please report it with what led to it",
                panic_message(&*panic)
            ))),
        });
        self.check_signals()?;
        Ok(outcome?)
    }
}

fn panic_message(panic: &(dyn Any + Send)) -> &str {
    panic
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("a panic without a message")
}
