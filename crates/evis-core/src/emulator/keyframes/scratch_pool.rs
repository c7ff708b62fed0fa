//! Memory of warps, for one gap after the other.

use std::sync::{Mutex, PoisonError};

use super::warp::Scratch;

/// Memory that threads take and give back.
#[derive(Debug, Default)]
pub(crate) struct ScratchPool(Mutex<Vec<(Scratch, Vec<f32>)>>);

impl ScratchPool {
    pub fn take(&self) -> (Scratch, Vec<f32>) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default()
    }

    pub fn give(&self, scratch: (Scratch, Vec<f32>)) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(scratch);
    }
}
