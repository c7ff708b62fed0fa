//! Buffers mapped for the host.

use std::sync::mpsc::{Receiver, TryRecvError};

use crate::error::EngineError;
use crate::gpu::Gpu;

pub(crate) use crate::gpu::buffer::map;

/// Waits until `submission` is done and its buffer mapped.
pub(crate) fn wait_mapped(
    gpu: &Gpu,
    submission: &wgpu::SubmissionIndex,
    mapped: &Receiver<Result<(), wgpu::BufferAsyncError>>,
) -> Result<(), EngineError> {
    loop {
        match mapped.try_recv() {
            Ok(Ok(())) => return Ok(()),
            Ok(Err(e)) => return Err(EngineError::Device(format!("cannot map what came back: {e}"))),
            Err(TryRecvError::Empty) => {
                gpu.device.poll(wgpu::PollType::Wait {
                    submission_index: Some(submission.clone()),
                    timeout: None,
                })?;
                // Of a lost device nothing comes back.
                gpu.check_not_lost()?;
            }
            Err(TryRecvError::Disconnected) => {
                return Err(EngineError::Device(
                    "the device was lost; run again, or choose another `device`".into(),
                ));
            }
        }
    }
}
