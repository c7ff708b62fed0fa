//! Luminance read back to the host.

use crate::error::EngineError;
use crate::gpu::commands::Commands;
use crate::gpu::readback::{map, wait_mapped};
use crate::gpu::texture::row_bytes;
use crate::raster::context::Context;
use crate::raster::layers::{LayerUse, Layers};
use crate::raster::luminance::{encode_distorted, encode_luminance};
use crate::raster::shadows::MovingShadows;

/// Renders view `view` at stream time `t_us` and reads it back: mean over the samples, row-major from the top. `layers` has
/// its size, and a layer for every sample, or one where its lens is distorted.
pub fn mean_luminance(
    context: &mut Context,
    layers: &Layers,
    view: usize,
    t_us: i64,
) -> Result<Vec<f64>, EngineError> {
    let view = [context.views[view].clone()];
    let frame_group = context.upload_frames(&view, &[t_us]);
    let mut encoder = Commands::new(&context.gpu, "luminance");
    MovingShadows::new(&frame_group, &view, 1).show(context, &mut encoder, 0, 0);
    if let Some(resampler) = context.resampler(&view[0]) {
        encode_distorted(context, &mut encoder, resampler, &frame_group, 0, &layers.each[0]);
        let mean = read_layers(context, encoder, layers, 1)?;
        return Ok(mean.into_iter().flatten().map(f64::from).collect());
    }
    encode_luminance(context, &mut encoder, layers, &frame_group, 0, 0, None);
    read_mean(context, encoder, layers)
}

/// Runs `encoder` and reads the mean over the samples in `layers` back, row-major from the top.
pub fn read_mean(context: &Context, encoder: Commands, layers: &Layers) -> Result<Vec<f64>, EngineError> {
    let samples = context.offsets.len();
    let read = read_layers(context, encoder, layers, samples as u32)?;
    let pixels = layers.width as usize * layers.height as usize;
    let mean = |p: usize| read.iter().map(|layer| f64::from(layer[p])).sum::<f64>() / samples as f64;
    Ok((0..pixels).map(mean).collect())
}

/// Runs `encoder` and reads the first `count` of `layers` back, each row-major from the top.
pub fn read_layers(
    context: &Context,
    mut encoder: Commands,
    layers: &Layers,
    count: u32,
) -> Result<Vec<Vec<f32>>, EngineError> {
    let staging = context.gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("luminance for the host"),
        size: layers.host_bytes(count),
        usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    layers.encode_read(&mut encoder, &staging, count);
    let submission = encoder.submit(&context.gpu);
    let mapped = map(&staging);
    wait_mapped(&context.gpu, &submission, &mapped)?;
    let bytes = staging
        .get_mapped_range(..)
        .map_err(|e| EngineError::Device(format!("cannot read the luminance back: {e}")))?;
    let pixels = |row: &[u8]| -> Vec<f32> {
        row.chunks_exact(4).take(layers.width as usize).map(bytemuck::pod_read_unaligned).collect()
    };
    Ok(bytes
        .chunks_exact(layers.host_bytes(1) as usize)
        .map(|layer| layer.chunks_exact(row_bytes(layers.width) as usize).flat_map(pixels).collect())
        .collect())
}

/// `Y_ref` that brings the log-mean of the first camera's lit pixels at the start to 0.18 (Reinhard's middle grey).
pub fn measure_reference(context: &mut Context, samples: u32, made: LayerUse) -> Result<f32, EngineError> {
    let Some(view) = context.views.first() else { return Ok(1.0) };
    let (width, height) = view.size();
    let (samples, made) = if view.distorted.is_some() { (1, LayerUse::Computed) } else { (samples, made) };
    let layers = Layers::new(&context.gpu.device, width, height, samples, made);
    let image = mean_luminance(context, &layers, 0, 0)?;
    let (mut sum, mut lit) = (0.0, 0u64);
    for luminance in image {
        if luminance > 0.0 && luminance.is_finite() {
            sum += luminance.ln();
            lit += 1;
        }
    }
    if lit == 0 {
        return Ok(1.0);
    }
    let reference = ((sum / lit as f64).exp() / 0.18) as f32;
    Ok(if reference.is_finite() && reference > 0.0 { reference } else { 1.0 })
}
