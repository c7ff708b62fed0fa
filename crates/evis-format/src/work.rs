//! Work that lasts: how much of it is done, and whether it should go on.

use evis_core::format::FormatError;

/// Why work ended early.
pub(crate) enum Halt {
    /// Whoever follows it said so.
    Stopped,
    Failed(FormatError),
}

impl From<FormatError> for Halt {
    fn from(error: FormatError) -> Self {
        Self::Failed(error)
    }
}

/// Work of a known number of parts.
pub(crate) struct Work<'a> {
    done: u64,
    total: u64,
    proceed: &'a mut dyn FnMut(f64) -> bool,
}

impl<'a> Work<'a> {
    /// `proceed` is told the part that is done, 0 to 1, and says whether to go on.
    pub fn new(total: u64, proceed: &'a mut dyn FnMut(f64) -> bool) -> Self {
        Self { done: 0, total: total.max(1), proceed }
    }

    /// `parts` more are done.
    pub fn advance(&mut self, parts: u64) -> Result<(), Halt> {
        self.done += parts;
        self.at(self.done as f64 / self.total as f64)
    }

    /// This part of it is done.
    pub fn at(&mut self, part: f64) -> Result<(), Halt> {
        if (self.proceed)(part.min(1.0)) { Ok(()) } else { Err(Halt::Stopped) }
    }
}

/// What `work` returned; `None` where it was stopped.
pub(crate) fn unless_stopped<T>(work: Result<T, Halt>) -> Result<Option<T>, FormatError> {
    match work {
        Ok(done) => Ok(Some(done)),
        Err(Halt::Stopped) => Ok(None),
        Err(Halt::Failed(error)) => Err(error),
    }
}
