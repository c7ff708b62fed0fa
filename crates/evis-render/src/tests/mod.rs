//! By what they prove: `layout` (declarations against shaders), `pipelines` (on `noop`), `passes` (against twins), `streams`.

mod layout;
mod passes;
mod pipelines;
pub(crate) mod portability;
mod random_scenes;
mod raster_scenes;
mod streams;

use crate::gpu::Gpu;
use crate::gpu::commands::Commands;

/// The device of `passes` and `streams`. Where `EVIS_REQUIRE_GPU=1`, its absence is a failure; elsewhere it is said aloud.
fn device() -> Option<Gpu> {
    match Gpu::open(None) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            assert!(std::env::var_os("EVIS_REQUIRE_GPU").is_none_or(|v| v != "1"), "{error}");
            eprintln!("NOT RUN: {error}");
            None
        }
    }
}

/// A device with WebGPU's default limits and no features: what any host's device has.
fn least_device() -> (wgpu::Device, wgpu::Queue) {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::PRIMARY;
    let instance = wgpu::Instance::new(descriptor);
    let adapter = pollster::block_on(instance.request_adapter(&Default::default())).unwrap();
    pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor::default())).unwrap()
}

/// The words of a buffer on the device.
fn read(gpu: &Gpu, buffer: &wgpu::Buffer) -> Vec<u32> {
    let staging = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: buffer.size(),
        usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    let mut encoder = Commands::new(gpu, "test");
    encoder.copy_buffer_to_buffer(buffer, 0, &staging, 0, buffer.size());
    let submission = encoder.submit(gpu);
    crate::gpu::readback::wait_mapped(gpu, &submission, &crate::gpu::readback::map(&staging)).unwrap();
    let bytes = staging.get_mapped_range(..).unwrap();
    bytes.chunks_exact(4).map(bytemuck::pod_read_unaligned).collect()
}
