//! Floors 0 to 3: declarations against shaders, pipelines on `noop`, passes against twins, whole intervals.

mod adaptive_streams;
mod floor0;
mod floor1;
mod floor2;
mod floor2_audit;
mod floor2_chain;
mod floor2_raster;
mod floor2_resample;
mod floor2_splat;
mod floor3;
mod floor3_adaptive;
mod floor3_bytes;
mod floor3_chain;
mod floor3_decoupled;
mod floor3_distorted;
mod floor3_frames;
mod floor3_host_walk;
mod floor3_lost;
mod floor3_sensors;
mod floor3_shadow;
mod floor3_shadow_rate;
mod floor3_splat;
mod floor3_still;
mod floor3_tune;
pub(crate) mod portability;
mod pushed;
mod random_scenes;
mod raster_scenes;
mod skips;

use crate::gpu::Gpu;
use crate::gpu::commands::Commands;

/// The device of floors 2 and 3. Where `EVIS_REQUIRE_GPU=1`, its absence is a failure; elsewhere it is said aloud.
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
