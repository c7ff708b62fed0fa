//! What gathers the samples of distorted lenses equals its twin.

use std::sync::Arc;

use evis_scene::{CalibratedLens, Distortion};

use crate::cpu::resample::resample;
use crate::frame::pattern;
use crate::gpu::Gpu;
use crate::gpu::commands::Commands;
use crate::gpu::sizes::DeviceLimits;
use crate::pass::raster::LUMINANCE_FORMAT;
use crate::raster::layers::{LayerUse, Layers};
use crate::raster::resample::{Resampler, picture_samples};
use crate::world::distorted::Distorted;

use crate::tests::random_scenes::Dice;

fn camera() -> Arc<Distorted> {
    let distortion = Distortion::from_coefficients("radtan", &[-0.35, 0.1, 2e-3, -1e-3]).unwrap();
    let lens = CalibratedLens::new([60.0, 61.0], [31.0, 25.5], Some(distortion)).unwrap();
    Arc::new(Distorted::new("eye", lens, [65, 49], 0.1, 1.0).unwrap())
}

/// Records `resampler`'s pixels and reads them back.
fn gathered(gpu: &Gpu, resampler: &Resampler, mut encoder: Commands) -> Vec<f32> {
    let [width, height] = resampler.camera.size;
    let layers = Layers::new(&gpu.device, width, height, 1, LayerUse::Computed);
    resampler.encode_gather(&gpu.device, &mut encoder, &layers.each[0]);
    let row = crate::gpu::texture::row_bytes(width);
    let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: layers.host_bytes(1),
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC,
        mapped_at_creation: false,
    });
    layers.encode_read(&mut encoder, &buffer, 1);
    encoder.submit(gpu);
    let words = crate::tests::read(gpu, &buffer);
    words
        .chunks_exact(row as usize / 4)
        .flat_map(|row| row[..width as usize].iter().map(|word| f32::from_bits(*word)))
        .collect()
}

/// The largest difference, relative to 1.
fn apart(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs() / (1.0 + b.abs())).fold(0.0, f32::max)
}

#[test]
fn gathered_samples_equal_their_twin() {
    let Some(gpu) = crate::tests::device() else { return };
    let (camera, offsets) = (camera(), pattern::offsets(7));
    // In several bands of rows.
    let limits = DeviceLimits { storage_binding: 50_000, ..DeviceLimits::of(&gpu.device) };
    let made = LayerUse::Rendered;
    let resampler = Resampler::new(&gpu.device, Arc::clone(&camera), &offsets, made, limits).unwrap();
    let (width, height) = (resampler.picture.width, resampler.picture.height);
    let mut dice = Dice(11);
    let count = (width * height) as usize;
    let light: Vec<Vec<f32>> =
        offsets.iter().map(|_| (0..count).map(|_| dice.between(-4.0, 3.0).exp() as f32).collect()).collect();
    for (layer, values) in (0..).zip(&light) {
        gpu.queue.write_texture(
            wgpu::TexelCopyTextureInfo {
                texture: &resampler.picture.texture,
                mip_level: 0,
                origin: wgpu::Origin3d { x: 0, y: 0, z: layer },
                aspect: wgpu::TextureAspect::All,
            },
            bytemuck::cast_slice(values),
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * width), rows_per_image: None },
            wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        );
    }
    let found = gathered(&gpu, &resampler, Commands::new(&gpu, "test"));
    let samples = picture_samples(&offsets, made);
    let (footprints, edge_bits) = (camera.footprints(&samples), samples.edge_bits);
    let twin = |shift: u32| {
        resample(&footprints, edge_bits, |x, y, s| {
            light[((s + shift) % 7) as usize][(y * width + x) as usize]
        })
    };
    assert!(apart(&found, &twin(0)) < 1e-5, "{}", apart(&found, &twin(0)));
    assert!(apart(&found, &twin(1)) > 0.1, "canary: another sample");
}

/// Draws, at every coverage sample, three times its x plus its y, in pixels of the target over its width.
const RAMP: &str = "
struct Varyings {
    @builtin(position) position: vec4<f32>,
    @location(0) @interpolate(perspective, sample) at: vec2<f32>,
};

@vertex
fn vs_main(@builtin(vertex_index) i: u32) -> Varyings {
    let uv = vec2<f32>(f32(i << 1u & 2u), f32(i & 2u));
    return Varyings(vec4<f32>(uv * vec2<f32>(2.0, -2.0) + vec2<f32>(-1.0, 1.0), 0.5, 1.0), uv);
}

@fragment
fn fs_main(v: Varyings) -> @location(0) vec4<f32> {
    return vec4<f32>(3.0 * v.at.x + v.at.y, 0.0, 0.0, 0.0);
}
";

#[test]
fn gathered_coverage_samples_equal_their_twin() {
    let Some(gpu) = crate::tests::device() else { return };
    let (camera, grid) = (camera(), 2);
    let (device, limits) = (&gpu.device, DeviceLimits::of(&gpu.device));
    let made = LayerUse::Resolved(grid);
    let resampler = Resampler::new(device, Arc::clone(&camera), &[[0.0; 2]], made, limits).unwrap();
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: None,
        source: wgpu::ShaderSource::Wgsl(RAMP.into()),
    });
    let pipeline = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: None,
        layout: None,
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("vs_main"),
            compilation_options: Default::default(),
            buffers: &[],
        },
        primitive: Default::default(),
        depth_stencil: None,
        multisample: wgpu::MultisampleState { count: 4, ..Default::default() },
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("fs_main"),
            compilation_options: Default::default(),
            targets: &[Some(LUMINANCE_FORMAT.into())],
        }),
        multiview_mask: None,
        cache: None,
    });
    let mut encoder = Commands::new(&gpu, "test");
    {
        let color = resampler.picture.multisampled.as_ref().unwrap();
        let color = crate::frame::draw::attachment(color, wgpu::Color::BLACK);
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            color_attachments: &[Some(color)],
            ..Default::default()
        });
        pass.set_pipeline(&pipeline);
        pass.draw(0..3, 0..1);
    }
    let found = gathered(&gpu, &resampler, encoder);
    let samples = picture_samples(&[[0.0; 2]], made);
    let (footprints, edge_bits) = (camera.footprints(&samples), samples.edge_bits);
    let size = [resampler.picture.width, resampler.picture.height].map(|edge| f64::from(edge * grid));
    // The mean of a ramp over the coverage samples of a texel is that in its middle.
    let twin = |shift: f64| {
        resample(&footprints, edge_bits, |x, y, _| {
            (3.0 * (f64::from(x) + 0.5 + shift) / size[0] + (f64::from(y) + 0.5) / size[1]) as f32
        })
    };
    assert!(apart(&found, &twin(0.0)) < 2e-5, "{}", apart(&found, &twin(0.0)));
    assert!(
        apart(&found, &twin(0.1)) > 2e-4,
        "canary: a tenth of a texel aside {}",
        apart(&found, &twin(0.1))
    );
    // The weighted mean place of a pixel's samples is its centre: the ramp is what the lens shows there.
    let [width, _] = camera.size;
    for (pixel, value) in found.iter().enumerate() {
        let center = [(pixel as u32 % width) as f64 + 0.5, (pixel as u32 / width) as f64 + 0.5];
        let [x, y] = camera.source(center.into()).unwrap();
        let g = f64::from(grid);
        let expected = 3.0 * x * g / size[0] + y * g / size[1];
        assert!((f64::from(*value) - expected).abs() < 2e-4, "{pixel}: {value} and {expected}");
    }
}
