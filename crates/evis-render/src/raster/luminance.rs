//! Luminance layers: samples rendered, coverage samples averaged, layers copied.

use crate::frame::draw::{Drawing, attachment, depth_attachment, draw_surfaces};
use crate::gpu::commands::Commands;
use crate::pass;
use crate::pass::trigger::RESOLVE_BINDINGS;
use crate::raster::context::Context;
use crate::raster::layers::Layers;
use crate::raster::resample::Resampler;
use crate::world::gpu_scene::{DrawItem, Part};
use crate::world::image_bounds::Rect;

/// Renders `frame`, or `parts` of it, sample by sample, into the layers from `first_layer` on; what lies outside of the
/// parts is left as cleared.
pub fn encode_luminance(
    context: &Context,
    encoder: &mut Commands,
    layers: &Layers,
    frame_group: &wgpu::BindGroup,
    frame: u32,
    first_layer: u32,
    parts: Option<&[Part]>,
) {
    let everything =
        || vec![(Rect::whole(layers.width, layers.height), &context.frame_data.visible[frame as usize][..])];
    let parts = parts.map_or_else(everything, borrowed);
    encode_samples(context, encoder, (layers, first_layer), frame_group, (frame, 0), &parts);
}

/// Renders the samples of `parts` of `frame`, from `first_sample` on, into the layers from `first_layer` on.
pub fn encode_samples(
    context: &Context,
    encoder: &mut Commands,
    (layers, first_layer): (&Layers, u32),
    frame_group: &wgpu::BindGroup,
    (frame, first_sample): (u32, u32),
    parts: &[(Rect, &[DrawItem])],
) {
    for (sample, layer) in (0..context.offsets.len() as u32).zip(&layers.each[first_layer as usize..]) {
        let into = (layers, first_layer + sample);
        encode_sample(context, encoder, into, frame_group, (frame, first_sample + sample), parts);
        if let Some(samples) = &layers.multisampled {
            encode_resolve(context, encoder, layers, samples, layer);
        }
    }
}

/// Renders sample `sample` of `parts` of `frame` into layer `layer` of `layers`, or its coverage samples.
pub fn encode_sample(
    context: &Context,
    encoder: &mut Commands,
    (layers, layer): (&Layers, u32),
    frame_group: &wgpu::BindGroup,
    (frame, sample): (u32, u32),
    parts: &[(Rect, &[DrawItem])],
) {
    let color = layers.multisampled.as_ref().unwrap_or(&layers.each[layer as usize]);
    let background = wgpu::Color { r: context.background_luminance, g: 0.0, b: 0.0, a: 0.0 };
    let mut color = attachment(color, background);
    let mut depth = depth_attachment(&layers.depth, wgpu::StoreOp::Discard);
    // Clearing takes a software driver as long as the whole picture is large, whatever is drawn of it then.
    let drawn: u64 = parts.iter().map(|(rect, _)| rect.pixels()).sum();
    let clears = 2 * drawn >= Rect::whole(layers.width, layers.height).pixels();
    if !clears {
        color.ops.load = wgpu::LoadOp::Load;
        depth.depth_ops = Some(wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store });
    }
    let mut pass = encoder.render("luminance", &[Some(color)], depth);
    // A shifted viewport samples the pixel elsewhere: no second set of matrices.
    let offset = context.sample_offset(sample);
    let grid = layers.grid;
    let [width, height] = [layers.width, layers.height].map(|edge| (grid * edge) as f32);
    pass.set_viewport(offset[0], offset[1], width, height, 0.0, 1.0);
    for (rect, items) in parts {
        let [width, height] = rect.size();
        pass.set_scissor_rect(grid * rect.low[0], grid * rect.low[1], grid * width, grid * height);
        if !clears {
            pass.set_pipeline(&context.background);
            pass.draw(0..3, 0..1);
        }
        let what = Drawing { items, frame, sample: Some(sample), first_record: context.object_base(frame) };
        let surroundings = Some(&context.surroundings);
        draw_surfaces(context.stage(frame_group), &mut pass, &context.luminance, surroundings, &what);
        if let Some(sky) = &context.sky {
            pass.set_pipeline(sky);
            pass.set_bind_group(0, frame_group, &context.frame_offsets(frame, Some(sample)));
            pass.set_bind_group(2, &context.surroundings, &[]);
            pass.draw(0..3, 0..1);
        }
    }
}

/// Renders `frame`, of a camera whose lens `resampler` distorts, into `layer`: the mean over the samples of each pixel.
pub fn encode_distorted(
    context: &Context,
    encoder: &mut Commands,
    resampler: &Resampler,
    frame_group: &wgpu::BindGroup,
    frame: u32,
    layer: &wgpu::TextureView,
) {
    let picture = &resampler.picture;
    let whole = Rect::whole(picture.width, picture.height);
    let parts = [(whole, &context.frame_data.visible[frame as usize][..])];
    for sample in 0..context.offsets.len() as u32 {
        encode_sample(context, encoder, (picture, sample), frame_group, (frame, sample), &parts);
    }
    resampler.encode_gather(&context.gpu.device, encoder, layer);
}

fn encode_resolve(
    context: &Context,
    encoder: &mut Commands,
    layers: &Layers,
    samples: &wgpu::TextureView,
    layer: &wgpu::TextureView,
) {
    let resolve = &context.resolve;
    let resources =
        vec![wgpu::BindingResource::TextureView(samples), wgpu::BindingResource::TextureView(layer)];
    let group = pass::group(&context.gpu.device, "resolve", &resolve.layout, RESOLVE_BINDINGS, resources);
    resolve.encode(encoder, &group, &[], (layers.width.div_ceil(8), layers.height.div_ceil(8), 1));
}

/// `parts`, as [`encode_sample`] takes them.
pub fn borrowed(parts: &[Part]) -> Vec<(Rect, &[DrawItem])> {
    parts.iter().map(|(rect, items)| (*rect, &items[..])).collect()
}

/// Copies `rect` of layers, from one texture's first to the other's: `count` of them.
pub fn copy_layers(
    encoder: &mut Commands,
    from: (&wgpu::Texture, u32),
    to: (&wgpu::Texture, u32),
    count: u32,
    rect: Rect,
) {
    let place = |(texture, layer): (_, u32)| wgpu::TexelCopyTextureInfo {
        texture,
        mip_level: 0,
        origin: wgpu::Origin3d { x: rect.low[0], y: rect.low[1], z: layer },
        aspect: wgpu::TextureAspect::All,
    };
    let [width, height] = rect.size();
    let size = wgpu::Extent3d { width, height, depth_or_array_layers: count };
    encoder.copy_texture_to_texture(place(from), place(to), size);
}
