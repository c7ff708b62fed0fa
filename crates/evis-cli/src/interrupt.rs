//! Ctrl-C and SIGTERM: the first asks the stream to end in good order, the second ends the process.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::SigId;
use signal_hook::consts::{SIGINT, SIGTERM};

/// Exit code of a run that was interrupted: 128 + SIGINT, as shells have it.
pub(crate) const EXIT_INTERRUPTED: i32 = 130;

/// Listens while it lives.
pub(crate) struct Interrupt {
    asked: Arc<AtomicBool>,
    handlers: Vec<SigId>,
}

impl Interrupt {
    /// Starts to listen. Where the system refuses a handler, its signal keeps its usual effect.
    pub(crate) fn listen() -> Self {
        let asked = Arc::new(AtomicBool::new(false));
        let mut handlers = Vec::new();
        for signal in [SIGINT, SIGTERM] {
            // In this order: the shutdown looks at the flag before the same signal raises it.
            handlers.extend(signal_hook::flag::register_conditional_shutdown(
                signal,
                EXIT_INTERRUPTED,
                Arc::clone(&asked),
            ));
            handlers.extend(signal_hook::flag::register(signal, Arc::clone(&asked)));
        }
        Self { asked, handlers }
    }

    /// Whether the stream should end.
    pub(crate) fn asked(&self) -> bool {
        self.asked.load(Ordering::Relaxed)
    }
}

impl Drop for Interrupt {
    fn drop(&mut self) {
        for handler in self.handlers.drain(..) {
            signal_hook::low_level::unregister(handler);
        }
    }
}
