//! Buffers mapped for the host.

use std::ops::Range;
use std::sync::mpsc::{Receiver, TryRecvError};

use crate::error::EngineError;
use crate::gpu::Gpu;
use crate::gpu::commands::Commands;

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

/// Ranges of bytes of buffers, one after the other, once `commands` are done.
///
/// # Errors
/// The device may fail.
pub(crate) fn read(
    gpu: &Gpu,
    mut commands: Commands,
    parts: &[(&wgpu::Buffer, Range<u64>)],
) -> Result<Vec<u8>, EngineError> {
    let staging = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("what a device has found"),
        size: parts.iter().map(|(_, range)| range.end - range.start).sum(),
        usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    let mut at = 0;
    for (buffer, range) in parts {
        let bytes = range.end - range.start;
        commands.copy_buffer_to_buffer(buffer, range.start, &staging, at, bytes);
        at += bytes;
    }
    let submission = commands.submit(gpu);
    wait_mapped(gpu, &submission, &map(&staging))?;
    let mapped = staging.get_mapped_range(..);
    let bytes = mapped.map_err(|e| EngineError::Device(format!("cannot read what came back: {e}")))?;
    Ok(bytes.to_vec())
}
