//! Buffers that grow, entries of uniform buffers, and buffers mapped for the host.

use std::sync::mpsc::{Receiver, channel};

use crate::gpu::sizes::UNIFORM_ALIGNMENT;

/// A buffer that grows to what is written into it.
pub struct GrowingBuffer {
    buffer: wgpu::Buffer,
    label: &'static str,
    usage: wgpu::BufferUsages,
}

impl GrowingBuffer {
    /// Starts small.
    pub fn new(device: &wgpu::Device, label: &'static str, usage: wgpu::BufferUsages) -> Self {
        Self { buffer: create(device, label, usage, 256), label, usage }
    }

    /// Has room for `bytes`; true where the buffer is a new one, with nothing in it, and groups that bind it are stale.
    pub fn reserve(&mut self, device: &wgpu::Device, bytes: u64) -> bool {
        let grows = self.buffer.size() < bytes;
        if grows {
            self.buffer = create(device, self.label, self.usage, bytes.next_power_of_two());
        }
        grows
    }

    /// Writes `bytes` at 0; true where the buffer is a new one, and groups that bind it are stale.
    pub fn write(&mut self, device: &wgpu::Device, queue: &wgpu::Queue, bytes: &[u8]) -> bool {
        let grown = self.reserve(device, bytes.len() as u64);
        if !bytes.is_empty() {
            queue.write_buffer(&self.buffer, 0, bytes);
        }
        grown
    }

    /// Writes `bytes` from byte `at` on. Where it grows, what lies before is in the buffer that is returned, and must be copied
    /// from there; then groups that bind it are stale.
    #[must_use]
    pub fn write_after(
        &mut self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        at: u64,
        bytes: &[u8],
    ) -> Option<wgpu::Buffer> {
        let old = self.buffer.clone();
        let grown = self.reserve(device, at + bytes.len() as u64);
        if !bytes.is_empty() {
            queue.write_buffer(&self.buffer, at, bytes);
        }
        (grown && at > 0).then_some(old)
    }

    /// The buffer of now.
    pub fn get(&self) -> &wgpu::Buffer {
        &self.buffer
    }
}

/// Entries of a uniform buffer, [`UNIFORM_ALIGNMENT`] apart; room for one where there are none.
pub fn aligned<T: bytemuck::Pod>(entries: &[T]) -> Vec<u8> {
    let mut bytes = vec![0; entries.len().max(1) * UNIFORM_ALIGNMENT as usize];
    for (slot, entry) in bytes.chunks_exact_mut(UNIFORM_ALIGNMENT as usize).zip(entries) {
        slot[..size_of::<T>()].copy_from_slice(bytemuck::bytes_of(entry));
    }
    bytes
}

fn create(device: &wgpu::Device, label: &str, usage: wgpu::BufferUsages, size: u64) -> wgpu::Buffer {
    device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size,
        usage: usage | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

/// Asks for `buffer` to be mapped once the work submitted so far is done.
pub(crate) fn map(buffer: &wgpu::Buffer) -> Receiver<Result<(), wgpu::BufferAsyncError>> {
    let (send, receive) = channel();
    buffer.slice(..).map_async(wgpu::MapMode::Read, move |result| {
        // The receiver is gone only when the engine is.
        let _ = send.send(result);
    });
    receive
}
