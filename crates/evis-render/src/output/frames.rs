//! Frames of a sensor's other output: the mean of linear light over an exposure, stamped at its middle.
//!
//! Each tile of a frame is sampled at a rate of its own: once where nothing moves while it is exposed.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use evis_core::{LabelData, LabelFrame, LabelKind, TimeGrid};

use crate::config::RunConfig;
use crate::error::EngineError;
use crate::gpu::commands::Commands;
use crate::raster::context::{Context, Upload};
use crate::raster::layers::{LayerUse, Layers};
use crate::raster::luminance::encode_luminance;
use crate::raster::readback::read_mean;
use crate::raster::shadows::MovingShadows;
use crate::sampling::draw_list::InView;
use crate::sampling::tile_rate::{STILL, TileRateEstimator};
use crate::sampling::view_motion::ViewMotion;
use crate::world::tiles::{TILE, tiles_along};
use crate::world::view::View;

/// Samples of a tile during an exposure, at most: not denser than the instants that make events, but for the least of these.
const SAMPLE_COUNTS: std::ops::RangeInclusive<i64> = 8..=64;

/// Pixels that anything may move between two samples. A pixel's own width smooths what they leave out.
const STEP_PX: f64 = 0.25;

/// Everything that frames need; absent where none is asked for. Frames are rendered apart from the light of events, whatever
/// the method: of how events are sampled, a frame knows the rate alone, and none costs anything where it is not wanted.
pub struct FrameRenderer {
    grid: TimeGrid,
    exposure_us: i64,
    estimator: TileRateEstimator,
    /// Samples of a tile, at most; a power of two.
    most: u32,
    made: LayerUse,
    next: i64,
    /// Per size of a view.
    layers: Vec<Layers>,
}

impl FrameRenderer {
    /// `None` where no frame is asked for.
    pub fn new(context: &Context, config: &RunConfig, made: LayerUse) -> Result<Option<Self>, EngineError> {
        let Some(rate_hz) = config.frame_rate_hz else { return Ok(None) };
        let (grid, exposure_us) = (TimeGrid::new(rate_hz)?, config.exposure_us);
        let most = most_samples(exposure_us, config.sample_grid()?.longest_interval_us());
        let mut layers: Vec<Layers> = Vec::new();
        for view in &context.views {
            let (width, height) = (view.lens.width, view.lens.height);
            if !layers.iter().any(|layers| (layers.width, layers.height) == (width, height)) {
                let samples = context.offsets.len() as u32;
                layers.push(Layers::new(&context.gpu.device, width, height, samples, made));
            }
        }
        let estimator = TileRateEstimator::new(&context.scene, &context.gpu_scene, STEP_PX, most);
        Ok(Some(Self { grid, exposure_us, estimator, most, made, next: 0, layers }))
    }

    /// The next frame of every view, in view order, if its middle lies before `until_us`.
    pub fn expose(
        &mut self,
        context: &mut Context,
        until_us: i64,
        stop: &Arc<AtomicBool>,
    ) -> Result<Option<Vec<LabelFrame>>, EngineError> {
        let start_us = self.grid.instant_us(self.next);
        let t_us = start_us + self.exposure_us / 2;
        if t_us >= until_us {
            return Ok(None);
        }
        let mut frames = Vec::new();
        for index in 0..context.views.len() {
            let view = [context.views[index].clone()];
            let lens = &view[0].lens;
            let fits = |layers: &&Layers| (layers.width, layers.height) == (lens.width, lens.height);
            let Some(layers) = self.layers.iter().find(fits) else { continue };
            let counts = self.sample_counts(context, &view, start_us);
            let mut mean = vec![0.0; lens.width as usize * lens.height as usize];
            // Tiles that are sampled equally often share their instants.
            for count in (0..=self.most.trailing_zeros()).map(|level| 1 << level) {
                if counts.contains(&count) {
                    self.add(context, &view, layers, start_us, (&counts, count), &mut mean, stop)?;
                }
            }
            frames.push(LabelFrame {
                kind: LabelKind::Frame,
                t_us,
                t_other_us: start_us,
                data: LabelData::F32(mean.into_iter().map(|mean| mean as f32).collect()),
            });
        }
        self.next += 1;
        Ok(Some(frames))
    }

    /// Per tile of `view`: how often it is sampled during the exposure from `start_us` on.
    fn sample_counts(&self, context: &mut Context, view: &[View], start_us: i64) -> Vec<u32> {
        let moments: Vec<i64> = (0..=i64::from(self.most))
            .map(|k| start_us + k * self.exposure_us / i64::from(self.most))
            .collect();
        context.build_frames(view, &moments, Upload { trail: true, ..Default::default() });
        let sky = context.sky.is_some();
        let passing = ViewMotion::new(&context.frame_data, 0..moments.len(), &view[0].lens, sky);
        let tile_rates = self.estimator.tile_rates(&context.gpu_scene, &passing).tiles;
        tile_rates
            .into_iter()
            .map(|log2_stride| if log2_stride == STILL { 1 } else { self.most >> log2_stride })
            .collect()
    }

    /// Adds to `mean` the light of all tiles that are sampled `count` times by `counts`.
    #[expect(clippy::too_many_arguments, reason = "a view of a frame, and the tiles of it that are sampled")]
    fn add(
        &self,
        context: &mut Context,
        view: &[View],
        layers: &Layers,
        start_us: i64,
        (counts, count): (&[u32], u32),
        mean: &mut [f64],
        stop: &Arc<AtomicBool>,
    ) -> Result<(), EngineError> {
        let (width, height) = (layers.width, layers.height);
        let columns = tiles_along(width);
        let wanted = |x: u32, y: u32| counts[(y * columns + x) as usize] == count;
        // Each for an equal part of the exposure, in its middle: exact where light changes evenly within each part.
        let share = 1.0 / f64::from(count);
        let time = |sample: u32| {
            start_us + ((f64::from(sample) + 0.5) * share * self.exposure_us as f64).round() as i64
        };
        let times: Vec<i64> = (0..count).map(time).collect();
        let frames = context.upload_frames_as(view, &times, Upload { trail: true, ..Default::default() });
        let mut shadows = MovingShadows::new(&frames, view, count);
        for sample in 0..count {
            if stop.load(Ordering::Relaxed) {
                return Err(EngineError::Stopped);
            }
            let in_view = InView::new(context, &view[0], sample);
            let parts = in_view.parts(wanted, TILE, (width, height), self.made.pixel_price());
            let mut encoder = Commands::new(&context.gpu, "frames");
            shadows.show(context, &mut encoder, 0, sample);
            encode_luminance(context, &mut encoder, layers, &frames, sample, 0, Some(&parts));
            let light = read_mean(context, encoder, layers, context.offsets.len())?;
            let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
            for ((mean, light), (x, y)) in mean.iter_mut().zip(light).zip(pixels) {
                if wanted(x / TILE, y / TILE) {
                    *mean += share * light;
                }
            }
        }
        Ok(())
    }
}

/// Samples of a tile during an exposure, at most, where instants are `interval_us` apart: a power of two, and no more than
/// there are microseconds.
fn most_samples(exposure_us: i64, interval_us: f64) -> u32 {
    let dense = ((exposure_us as f64 / interval_us).ceil() as i64)
        .clamp(*SAMPLE_COUNTS.start(), *SAMPLE_COUNTS.end());
    let most = (dense as u32).next_power_of_two();
    if i64::from(most) <= exposure_us { most } else { 1 << exposure_us.ilog2() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_as_dense_as_instants_at_most_and_never_denser_than_microseconds() {
        for (exposure_us, rate_hz, most) in [
            (10_000, 1000.0, 16),
            (10_000, 100.0, 8),
            (10_000, 4000.0, 64),
            (1_000_000, 4000.0, 64),
            (10, 1e6, 8),
            (6, 1000.0, 4),
            (2, 1000.0, 2),
        ] {
            assert_eq!(most_samples(exposure_us, 1e6 / rate_hz), most, "{exposure_us} us, {rate_hz} Hz");
        }
    }
}
