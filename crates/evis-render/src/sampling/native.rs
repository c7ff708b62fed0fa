//! `native`: every instant of every view.

use crate::frame::changes::Change;
use crate::gpu::commands::Commands;
use crate::raster::context::{Context, Upload};
use crate::raster::luminance::{copy_layers, encode_distorted, encode_luminance};
use crate::raster::shadows::MovingShadows;
use crate::sensor::group::{Group, Unit};
use crate::sensor::targets::Targets;
use crate::world::image_bounds::Rect;

/// `native`: every instant of every view, sample by sample; of a view that stands still, only what changes.
#[derive(Default)]
pub struct NativeSampler {
    /// The layers of the last instant of the submission before, view by view.
    kept: Option<wgpu::Texture>,
    /// Pixels drawn since this was last asked.
    pub drawn_pixels: u64,
}

impl NativeSampler {
    /// Records what makes the luminance of `unit`.
    pub fn encode(
        &mut self,
        context: &mut Context,
        encoder: &mut Commands,
        targets: &Targets,
        group: &Group,
        unit: &Unit,
    ) {
        let views = context.views_at(&group.views);
        let times: Vec<i64> =
            (0..unit.instants).map(|k| context.grid.instant_us(unit.first + i64::from(k))).collect();
        let samples = targets.samples;
        let layers = &targets.layers;
        // Coverage samples are averaged over whole layers, and are few: not worth a way of their own.
        let distorted = views[0].distorted.is_some();
        let watches = context.skips_still && (distorted || layers.multisampled.is_none());
        let first_view = group.views[0];
        // Where everything is, at every instant.
        let watch = watches.then_some((first_view, unit.first));
        let frame_group = context.upload_frames_as(&views, &times, Upload { watch, ..Default::default() });
        let whole = Rect::whole(layers.width, layers.height);
        let mut shadows = MovingShadows::new(&frame_group, &views, unit.instants);
        for k in 0..unit.instants {
            for view in 0..views.len() as u32 {
                // What the lights see, where casters or lights move.
                shadows.show(context, encoder, view, k);
                // What the camera sees, one luminance layer per sample.
                let frame = view * unit.instants + k;
                let first = frame * samples;
                let before = match (&self.kept, k) {
                    (Some(kept), 0) => (kept, view * samples),
                    _ => (&layers.texture, first.saturating_sub(samples)),
                };
                let change = context.frame_data.changes.get(frame as usize).filter(|_| watches);
                // A distorted lens shows no rectangle as one: its pictures are drawn as a whole.
                if let Some(resampler) = context.resampler(&views[view as usize])
                    && !matches!(change, Some(Change::Nothing))
                {
                    let layer = &layers.each[first as usize];
                    encode_distorted(context, encoder, resampler, &frame_group, frame, layer);
                    self.drawn_pixels += resampler.picture.pixels();
                    continue;
                }
                let copied = match change {
                    None | Some(Change::All) => {
                        encode_luminance(context, encoder, layers, &frame_group, frame, first, None);
                        self.drawn_pixels += whole.pixels();
                        Vec::new()
                    }
                    Some(Change::Parts(parts)) => {
                        encode_luminance(context, encoder, layers, &frame_group, frame, first, Some(parts));
                        let rects: Vec<Rect> = parts.iter().map(|(rect, _)| *rect).collect();
                        self.drawn_pixels += rects.iter().map(Rect::pixels).sum::<u64>();
                        Rect::around(&rects, layers.width, layers.height)
                    }
                    Some(Change::Nothing) => vec![whole],
                };
                for rect in copied {
                    copy_layers(encoder, before, (&layers.texture, first), samples, rect);
                }
            }
        }
        if watches && context.frame_data.watch.any_static() {
            let count = views.len() as u32 * samples;
            let fits = |texture: &wgpu::Texture| {
                let size = texture.size();
                (size.width, size.height, size.depth_or_array_layers) == (layers.width, layers.height, count)
            };
            let kept = match self.kept.take().filter(fits) {
                Some(kept) => kept,
                None => layers.like(&context.gpu.device, count),
            };
            for view in 0..views.len() as u32 {
                let last = (view * unit.instants + unit.instants - 1) * samples;
                copy_layers(encoder, (&layers.texture, last), (&kept, view * samples), samples, whole);
            }
            self.kept = Some(kept);
            context.frame_data.watch.keep(first_view, unit.first + i64::from(unit.instants));
        }
    }
}
