//! The yardstick: the paper's warp as one would write it first, on planted data. Two keyframes, each splatted along its
//! own motion into its own buffers (largest depth, then weight and light), and a choice between them.

use wgpu::util::DeviceExt as _;

use crate::support::Failure;

/// WebGPU's guaranteed dynamic offset alignment.
const STRIDE: u64 = 256;

/// Buffers and pipelines.
pub struct BareSplat {
    device: wgpu::Device,
    queue: wgpu::Queue,
    pipelines: [wgpu::ComputePipeline; 3],
    /// Per side.
    groups: [wgpu::BindGroup; 2],
    sums: [wgpu::Buffer; 2],
    size: [u32; 2],
}

impl BareSplat {
    /// Plants a slanted, textured plane that slides by some pixels.
    pub fn new(device: &wgpu::Device, queue: &wgpu::Queue, size: [u32; 2]) -> Self {
        let pixels = size[0] * size[1];
        let module = device.create_shader_module(wgpu::include_wgsl!("splat.wgsl"));
        let storage = |read_only| wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Storage { read_only },
            has_dynamic_offset: false,
            min_binding_size: None,
        };
        let uniform = wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset: true,
            min_binding_size: None,
        };
        let entry = |(binding, ty)| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty,
            count: None,
        };
        let entries: Vec<_> =
            [(0, uniform), (1, storage(true)), (2, storage(false)), (3, storage(false)), (4, storage(false))]
                .map(entry)
                .to_vec();
        let layout = device
            .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: None, entries: &entries });
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let pipelines = ["depth", "add", "choose"].map(|entry_point| {
            device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: None,
                layout: Some(&pipeline_layout),
                module: &module,
                entry_point: Some(entry_point),
                compilation_options: Default::default(),
                cache: None,
            })
        });
        let init = |bytes: &[u8], usage| {
            device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: None,
                contents: bytes,
                usage,
            })
        };
        let buffer = |size: u64| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: None,
                size,
                usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        // Luminance, 1 / depth, motion.
        let sources: Vec<[f32; 4]> = (0..pixels)
            .map(|i| {
                let (x, y) = ((i % size[0]) as f32, (i / size[0]) as f32);
                let light = 0.5 + 0.3 * (0.7 * x).sin() * (0.5 * y).cos();
                [light, 0.2 + 1e-4 * x, 3.0 + 0.002 * y, -0.7 + 0.001 * x]
            })
            .collect();
        let sources = init(bytemuck::cast_slice(&sources), wgpu::BufferUsages::STORAGE);
        let mut params = vec![0u8; 64 * STRIDE as usize];
        for (k, entry) in params.chunks_exact_mut(STRIDE as usize).enumerate() {
            let elapsed = (k / 2) as f32 / 32.0;
            let moved = if k % 2 == 0 { elapsed } else { elapsed - 1.0 };
            let words = [size[0], size[1], moved.to_bits(), 12f32.to_bits()];
            entry[..16].copy_from_slice(bytemuck::cast_slice(&words));
        }
        let params = init(&params, wgpu::BufferUsages::UNIFORM);
        let sums = [0; 2].map(|_| buffer(u64::from(pixels) * 12));
        let out = buffer(u64::from(pixels) * 4);
        let groups = [0, 1].map(|side: usize| {
            let bound = wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                buffer: &params,
                offset: 0,
                size: std::num::NonZeroU64::new(16),
            });
            let resources = [
                bound,
                sources.as_entire_binding(),
                sums[side].as_entire_binding(),
                sums[1 - side].as_entire_binding(),
                out.as_entire_binding(),
            ];
            let entries: Vec<_> = (0..)
                .zip(resources)
                .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource })
                .collect();
            device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: None,
                layout: &layout,
                entries: &entries,
            })
        });
        Self { device: device.clone(), queue: queue.clone(), pipelines, groups, sums, size }
    }

    /// Runs `steps` steps, and waits.
    pub fn run(&mut self, steps: u32) -> Result<(), Failure> {
        let mut encoder = self.device.create_command_encoder(&Default::default());
        let [depth, add, choose] = &self.pipelines;
        for k in 0..steps {
            for sums in &self.sums {
                encoder.clear_buffer(sums, 0, None);
            }
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            let mut run = |pipeline, side: u32| {
                pass.set_pipeline(pipeline);
                let offset = (2 * k + side) * STRIDE as u32;
                pass.set_bind_group(0, &self.groups[side as usize], &[offset]);
                pass.dispatch_workgroups(self.size[0].div_ceil(64), self.size[1], 1);
            };
            for side in [1, 0] {
                run(depth, side);
                run(add, side);
            }
            run(choose, 1);
        }
        let submission = self.queue.submit([encoder.finish()]);
        self.device.poll(wgpu::PollType::Wait { submission_index: Some(submission), timeout: None })?;
        Ok(())
    }
}
