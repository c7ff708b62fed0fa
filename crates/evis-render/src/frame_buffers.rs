//! Device buffers that a submission's [`FrameData`] goes into; they grow and never shrink.

use crate::frame::FrameData;
use crate::pass;
use crate::pass::raster::{FRAME_BINDINGS, SurfaceLayouts};
use crate::uniforms::Frame;

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

    /// Writes `bytes` at 0; true where the buffer is a new one, and groups that bind it are stale.
    pub fn write(&mut self, device: &wgpu::Device, queue: &wgpu::Queue, bytes: &[u8]) -> bool {
        let grown = self.buffer.size() < bytes.len() as u64;
        if grown {
            let size = (bytes.len() as u64).next_power_of_two();
            self.buffer = create(device, self.label, self.usage, size);
        }
        if !bytes.is_empty() {
            queue.write_buffer(&self.buffer, 0, bytes);
        }
        grown
    }

    /// The buffer of now.
    pub fn get(&self) -> &wgpu::Buffer {
        &self.buffer
    }
}

fn create(device: &wgpu::Device, label: &str, usage: wgpu::BufferUsages, size: u64) -> wgpu::Buffer {
    device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size,
        usage: usage | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

/// Buffers of group 0, and the shadow matrices.
pub struct FrameBuffers {
    frames: GrowingBuffer,
    objects: GrowingBuffer,
    joints: GrowingBuffer,
    morph_weights: GrowingBuffer,
    lights: GrowingBuffer,
    /// Matrices of moving shadows.
    pub shadow_matrices: GrowingBuffer,
    group: Option<wgpu::BindGroup>,
}

impl FrameBuffers {
    /// Empty ones.
    pub fn new(device: &wgpu::Device) -> Self {
        let storage = |label| GrowingBuffer::new(device, label, wgpu::BufferUsages::STORAGE);
        Self {
            frames: GrowingBuffer::new(device, "frames", wgpu::BufferUsages::UNIFORM),
            objects: storage("objects"),
            joints: storage("joints"),
            morph_weights: storage("morph weights"),
            lights: storage("lights"),
            shadow_matrices: storage("shadow matrices"),
            group: None,
        }
    }

    /// Uploads `data` and returns group 0, and whether the shadow matrices moved to a new buffer.
    pub fn upload(
        &mut self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        layouts: &SurfaceLayouts,
        morph_data: &wgpu::Buffer,
        data: &FrameData,
    ) -> (wgpu::BindGroup, bool) {
        let mut stale = self.frames.write(device, queue, &data.frames);
        stale |= self.objects.write(device, queue, bytemuck::cast_slice(&data.objects));
        stale |= self.joints.write(device, queue, bytemuck::cast_slice(&data.joints));
        stale |= self.morph_weights.write(device, queue, bytemuck::cast_slice(&data.morph_weights));
        stale |= self.lights.write(device, queue, bytemuck::cast_slice(&data.lights));
        let shadows_moved =
            self.shadow_matrices.write(device, queue, bytemuck::cast_slice(&data.shadow_matrices));
        let group = match self.group.take().filter(|_| !stale) {
            Some(group) => group,
            None => {
                let frame = wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                    buffer: self.frames.get(),
                    offset: 0,
                    size: std::num::NonZeroU64::new(size_of::<Frame>() as u64),
                });
                let resources = vec![
                    frame,
                    self.objects.get().as_entire_binding(),
                    self.joints.get().as_entire_binding(),
                    self.morph_weights.get().as_entire_binding(),
                    morph_data.as_entire_binding(),
                    self.lights.get().as_entire_binding(),
                ];
                pass::group(device, "frame", &layouts.frame, FRAME_BINDINGS, resources)
            }
        };
        self.group = Some(group.clone());
        (group, shadows_moved)
    }
}
