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
        return read_mean(context, encoder, layers, 1);
    }
    encode_luminance(context, &mut encoder, layers, &frame_group, 0, 0, None);
    read_mean(context, encoder, layers, context.offsets.len())
}

/// Runs `encoder` and reads the mean of the first `samples` of `layers` back, row-major from the top.
pub fn read_mean(
    context: &Context,
    encoder: Commands,
    layers: &Layers,
    samples: usize,
) -> Result<Vec<f64>, EngineError> {
    Ok(read_means(context, encoder, layers, (1, samples))?.swap_remove(0))
}

/// Runs `encoder` and reads the means of the first `count` groups of `samples` layers back, each row-major from the top.
pub fn read_means(
    context: &Context,
    mut encoder: Commands,
    layers: &Layers,
    (count, samples): (usize, usize),
) -> Result<Vec<Vec<f64>>, EngineError> {
    let all = (count * samples) as u32;
    let staging = context.gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("luminance for the host"),
        size: layers.host_bytes(all),
        usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    layers.encode_read(&mut encoder, &staging, all);
    let submission = encoder.submit(&context.gpu);
    let mapped = map(&staging);
    wait_mapped(&context.gpu, &submission, &mapped)?;
    let bytes = staging
        .get_mapped_range(..)
        .map_err(|e| EngineError::Device(format!("cannot read the luminance back: {e}")))?;
    let group = layers.host_bytes(samples as u32) as usize;
    let mean = |bytes: &[u8]| mean_of_layers(bytes, [layers.width, layers.height], samples);
    Ok(bytes.chunks_exact(group).map(mean).collect())
}

/// Mean of the `samples` layers in `bytes`, as [`Layers::encode_read`] has them: row-major from the top.
pub fn mean_of_layers(bytes: &[u8], [width, height]: [u32; 2], samples: usize) -> Vec<f64> {
    let (width, height, row) = (width as usize, height as usize, row_bytes(width) as usize);
    let mut sums = vec![0.0; width * height];
    for layer in bytes.chunks_exact((row * height).max(1)).take(samples) {
        for (sums, bytes) in sums.chunks_exact_mut(width).zip(layer.chunks_exact(row)) {
            for (sum, value) in sums.iter_mut().zip(bytes.as_chunks::<4>().0) {
                *sum += f64::from(f32::from_le_bytes(*value));
            }
        }
    }
    sums.iter_mut().for_each(|sum| *sum /= samples as f64);
    sums
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
