//! Frames of a sensor's other output: the mean of linear light over an exposure, by its shape, stamped at its middle.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use evis_core::{ExposureShape, LabelData, LabelFrame, LabelKind, TimeGrid};

use crate::config::RunConfig;
use crate::engine::{Context, mean_luminance};
use crate::error::EngineError;
use crate::targets::{LayerUse, Layers};

/// Renders of an exposure, at least and at most.
const LOOKS: std::ops::RangeInclusive<i64> = 8..=64;

/// Everything that frames need; absent where none is asked for. Frames are rendered apart from what pixels feel, whatever
/// the method: so no frame depends on how events are sampled, and none costs anything where it is not wanted.
pub struct ExposureRoom {
    grid: TimeGrid,
    exposure_us: i64,
    /// Of each look: the shape's integral over its part of the exposure, in such parts; their mean is 1.
    weights: Vec<f64>,
    next: i64,
    /// Per size of a view.
    layers: Vec<Layers>,
}

impl ExposureRoom {
    /// `None` where no frame is asked for.
    pub fn new(context: &Context, config: &RunConfig, made: LayerUse) -> Result<Option<Self>, EngineError> {
        let Some(rate_hz) = config.frame_rate_hz else { return Ok(None) };
        let (grid, exposure_us) = (TimeGrid::new(rate_hz)?, config.exposure_us);
        let interval_us = config.sample_grid()?.longest_interval_us();
        // As dense as the instants that make events.
        let looks = ((exposure_us as f64 / interval_us).ceil() as i64).clamp(*LOOKS.start(), *LOOKS.end());
        let looks = looks.min(exposure_us);
        let mut layers: Vec<Layers> = Vec::new();
        for view in &context.views {
            let (width, height) = (view.lens.width, view.lens.height);
            if !layers.iter().any(|layers| (layers.width, layers.height) == (width, height)) {
                let samples = context.offsets.len() as u32;
                layers.push(Layers::new(&context.gpu.device, width, height, samples, made));
            }
        }
        Ok(Some(Self { grid, exposure_us, weights: weights(&config.exposure_shape, looks), next: 0, layers }))
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
            let lens = context.views[index].lens;
            let fits = |layers: &&Layers| (layers.width, layers.height) == (lens.width, lens.height);
            let Some(layers) = self.layers.iter().find(fits) else { continue };
            let mut sum = vec![0.0; lens.width as usize * lens.height as usize];
            let looks = self.weights.len() as i64;
            for (look, weight) in (0..).zip(&self.weights) {
                if stop.load(Ordering::Relaxed) {
                    return Err(EngineError::Stopped);
                }
                if *weight == 0.0 {
                    continue;
                }
                // The middle of each part.
                let at = start_us + (2 * look + 1) * self.exposure_us / (2 * looks);
                for (sum, y) in sum.iter_mut().zip(mean_luminance(context, layers, index, at)?) {
                    *sum += weight * y;
                }
            }
            let mean = sum.into_iter().map(|sum| (sum / looks as f64) as f32).collect();
            frames.push(LabelFrame {
                kind: LabelKind::Frame,
                t_us,
                t_other_us: start_us,
                data: LabelData::F32(mean),
            });
        }
        self.next += 1;
        Ok(Some(frames))
    }
}

/// Of each of `looks` looks: the integral of `shape` over its part of the exposure, in such parts.
fn weights(shape: &ExposureShape, looks: i64) -> Vec<f64> {
    let part = |look: i64| {
        let at = |look: i64| look as f64 / looks as f64;
        looks as f64 * shape.moments(at(look), at(look + 1))[0]
    };
    match shape {
        // Not but for rounding.
        ExposureShape::Box => vec![1.0; looks as usize],
        ExposureShape::Weights(_) => (0..looks).map(part).collect(),
    }
}
