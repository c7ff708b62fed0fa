//! Device buffers that a submission's [`FrameData`] goes into; they grow and never shrink.

use wgpu::util::DeviceExt as _;

use crate::frame::FrameData;
use crate::frame::pattern::Share;
use crate::gpu::Gpu;
use crate::gpu::buffer::{GrowingBuffer, aligned};
use crate::gpu::sizes::UNIFORM_ALIGNMENT;
use crate::pass;
use crate::pass::raster::{self, FRAME_BINDINGS, SurfaceLayouts};

/// Buffers of group 0, and the instances' matrices.
pub struct FrameBuffers {
    frames: GrowingBuffer,
    /// [`crate::gpu::uniforms::InstanceRecord`]s: vertex attributes, and storage for labels.
    pub instances: GrowingBuffer,
    objects: GrowingBuffer,
    joints: GrowingBuffer,
    morph_weights: GrowingBuffer,
    occluders: GrowingBuffer,
    /// [`Share`]s, [`UNIFORM_ALIGNMENT`] apart: the whole pixel, then one per sample.
    shares: wgpu::Buffer,
    light_count: u32,
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
            light_count,
            group: None,
        }
    }

    /// Offsets of frame `frame` in its uniform buffer, and of what `sample` stands for; none stands for the whole pixel.
    pub fn offsets(&self, frame: u32, sample: Option<u32>) -> [u32; 2] {
        let share = sample.map_or(0, |sample| sample + 1);
        [frame * raster::frame_stride(self.light_count) as u32, share * UNIFORM_ALIGNMENT as u32]
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
                    size: std::num::NonZeroU64::new(raster::frame_bytes(self.light_count)),
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
