//! Device buffers that a submission's [`FrameData`] goes into; they grow and never shrink.

use wgpu::util::DeviceExt as _;

use crate::frame::FrameData;
use crate::gpu::Gpu;
use crate::pass::raster::{self, FRAME_BINDINGS, SurfaceLayouts};
use crate::pass::{self};
use crate::pattern::Share;

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

/// Entries of a uniform buffer, [`raster::UNIFORM_ALIGNMENT`] apart; room for one where there are none.
pub fn aligned<T: bytemuck::Pod>(entries: &[T]) -> Vec<u8> {
    let mut bytes = vec![0; entries.len().max(1) * raster::UNIFORM_ALIGNMENT as usize];
    for (slot, entry) in bytes.chunks_exact_mut(raster::UNIFORM_ALIGNMENT as usize).zip(entries) {
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

/// Buffers of group 0, and the instances' matrices.
pub struct FrameBuffers {
    frames: GrowingBuffer,
    /// [`crate::uniforms::InstanceRecord`]s: vertex attributes, and storage for labels.
    pub instances: GrowingBuffer,
    objects: GrowingBuffer,
    joints: GrowingBuffer,
    morph_weights: GrowingBuffer,
    occluders: GrowingBuffer,
    /// [`Share`]s, [`raster::UNIFORM_ALIGNMENT`] apart: the whole pixel, then one per sample.
    shares: wgpu::Buffer,
    frame_bytes: u64,
    group: Option<wgpu::BindGroup>,
}

impl FrameBuffers {
    /// Empty ones, for frames of `light_count` lights and samples with `shares`.
    pub fn new(device: &wgpu::Device, light_count: u32, shares: &[Share]) -> Self {
        let storage = |label| GrowingBuffer::new(device, label, wgpu::BufferUsages::STORAGE);
        let instances = wgpu::BufferUsages::VERTEX | wgpu::BufferUsages::STORAGE;
        let shares = [&[Share::WHOLE], shares].concat();
        Self {
            shares: device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some("shares"),
                contents: &aligned(&shares),
                usage: wgpu::BufferUsages::UNIFORM,
            }),
            frames: GrowingBuffer::new(device, "frames", wgpu::BufferUsages::UNIFORM),
            instances: GrowingBuffer::new(device, "instances", instances),
            objects: storage("objects"),
            joints: storage("joints"),
            morph_weights: storage("morph weights"),
            occluders: storage("occluders"),
            frame_bytes: raster::frame_bytes(light_count),
            group: None,
        }
    }

    /// Uploads `data` and returns group 0.
    pub fn upload(
        &mut self,
        gpu: &Gpu,
        layouts: &SurfaceLayouts,
        morph_data: &wgpu::Buffer,
        data: &FrameData,
    ) -> wgpu::BindGroup {
        let (device, queue) = (&gpu.device, &gpu.queue);
        self.instances.write(device, queue, bytemuck::cast_slice(&data.instances));
        let mut stale = self.frames.write(device, queue, &data.frames);
        stale |= self.objects.write(device, queue, bytemuck::cast_slice(&data.objects));
        stale |= self.joints.write(device, queue, bytemuck::cast_slice(&data.joints));
        stale |= self.morph_weights.write(device, queue, bytemuck::cast_slice(&data.morph_weights));
        stale |= self.occluders.write(device, queue, bytemuck::cast_slice(&data.occluders));
        let group = match self.group.take().filter(|_| !stale) {
            Some(group) => group,
            None => {
                let frame = wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                    buffer: self.frames.get(),
                    offset: 0,
                    size: std::num::NonZeroU64::new(self.frame_bytes),
                });
                let resources = vec![
                    frame,
                    self.objects.get().as_entire_binding(),
                    self.joints.get().as_entire_binding(),
                    self.morph_weights.get().as_entire_binding(),
                    morph_data.as_entire_binding(),
                    self.occluders.get().as_entire_binding(),
                    pass::part(&self.shares, 0, size_of::<Share>() as u64),
                ];
                pass::group(device, "frame", &layouts.frame, FRAME_BINDINGS, resources)
            }
        };
        self.group = Some(group.clone());
        group
    }
}
