//! One `wgpu` device for a program's own renderer and for EVIS: both take turns on its queue.
//!
//! `cargo run --release --workspace --locked --example shared_device`
//!
//! Both must use one version of `wgpu`, 30 now: `evis_render::wgpu` is that one.

use std::sync::Arc;

use evis_render::prelude::*;
use evis_render::wgpu;

/// Stands for a renderer of its own: it paints a picture in one colour.
struct Painter {
    device: wgpu::Device,
    queue: wgpu::Queue,
    picture: wgpu::Texture,
}

impl Painter {
    fn new(device: &wgpu::Device, queue: &wgpu::Queue) -> Self {
        let picture = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("painter"),
            size: wgpu::Extent3d { width: 64, height: 64, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rgba8Unorm,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
            view_formats: &[],
        });
        Self { device: device.clone(), queue: queue.clone(), picture }
    }

    fn paint(&self, red: f64) {
        let view = self.picture.create_view(&wgpu::TextureViewDescriptor::default());
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let color = wgpu::Color { r: red, g: 0.0, b: 0.0, a: 1.0 };
        let attachment = wgpu::RenderPassColorAttachment {
            view: &view,
            depth_slice: None,
            resolve_target: None,
            ops: wgpu::Operations { load: wgpu::LoadOp::Clear(color), store: wgpu::StoreOp::Store },
        };
        drop(encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("painter"),
            color_attachments: &[Some(attachment)],
            ..wgpu::RenderPassDescriptor::default()
        }));
        self.queue.submit([encoder.finish()]);
    }
}

/// Runs it.
pub fn main() -> Result<(), EngineError> {
    let failed = |what: &str, error: &dyn std::fmt::Display| EngineError::Device(format!("{what}: {error}"));
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let adapter = pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions::default()))
        .map_err(|e| failed("no adapter", &e))?;
    // WebGPU's default limits and no feature suffice for EVIS; what a program needs itself it adds.
    let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor::default()))
        .map_err(|e| failed("no device", &e))?;

    let painter = Painter::new(&device, &queue);
    let gpu = Gpu::from_device(device, queue);
    let scene = Arc::new(scene::builtin::load("spinner", 0)?);
    let config = RunConfig { size: Some((160, 120)), ..RunConfig::default() };
    let mut simulator = Simulator::new(&gpu, scene, config)?;

    let mut events = 0;
    for frame in 1..=5_i64 {
        painter.paint(0.2 * frame as f64);
        let packet = simulator.step(10_000 * frame)?;
        events += packet.views[0].events.len();
    }
    println!("5 pictures, {events} events");
    assert!(events > 0, "the scene moves");
    Ok(())
}
