//! The stages of a sensor that are on, in the numbers that the passes need.

use crate::sensor::{Bandwidth, Curve, FilterRule, LeakLaw, SensorConfig, Times, TriggerRule};
use crate::simd;

/// The stages that are on, in the numbers that the passes need; made once.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    pub sensor: SensorConfig,
    /// 2 pi cutoff, per microsecond; 0: no low-pass.
    pub(super) rate: f32,
    pub(super) exact: bool,
    pub(super) two_poles: bool,
    /// Rms of the photoreceptor's noise; 0: none.
    pub(super) noise: f32,
    /// Whether the leak is a ramp.
    pub(super) ramp: bool,
    /// Whether events are decided at samples, with times given by a rule.
    pub(super) sampled: bool,
    /// Whether the reference of each interval is the sample at its start.
    pub(super) forgets: bool,
    /// Whether thresholds are drawn for every frame.
    pub(super) redraws: bool,
    /// Whether a pixel can come back to a level exactly: with thresholds that all have in common, and without a filter or a
    /// leak.
    pub(super) ties: bool,
    /// What linlog multiplies with below its knee.
    pub(super) below_knee: f32,
}

impl Plan {
    pub fn new(sensor: &SensorConfig) -> Self {
        let receptor = &sensor.photoreceptor;
        Self {
            rate: receptor.cutoff_hz * std::f32::consts::TAU * 1e-6,
            exact: receptor.filter == FilterRule::Exact,
            two_poles: receptor.order == 2,
            noise: receptor.noise,
            ramp: ramps(sensor),
            sampled: sensor.trigger != TriggerRule::Crossing || sensor.times != Times::Crossing,
            forgets: sensor.trigger == TriggerRule::Difference,
            redraws: sensor.pattern.redraw && sensor.pattern.sigma > 0.0,
            ties: sensor.trigger == TriggerRule::Crossing
                && receptor.cutoff_hz == 0.0
                && sensor.pattern.sigma == 0.0
                && !ramps(sensor),
            below_knee: receptor.knee.ln() / receptor.knee,
            sensor: sensor.clone(),
        }
    }

    /// Whether all tiles must be scanned before any event has its time.
    pub fn shares_times(&self) -> bool {
        self.sampled && self.sensor.times == Times::Shared
    }

    /// What multiplies the cutoff at this light.
    #[inline(always)]
    pub(super) fn bandwidth(&self, light: f32) -> f32 {
        let receptor = &self.sensor.photoreceptor;
        match receptor.bandwidth {
            Bandwidth::Constant => 1.0,
            Bandwidth::Light => {
                let relative = (light + receptor.bandwidth_offset) / (1.0 + receptor.bandwidth_offset);
                relative.max(receptor.bandwidth_least).min(receptor.bandwidth_most)
            }
        }
    }

    #[inline(always)]
    pub(super) fn curve(&self, light: f32) -> f32 {
        let receptor = &self.sensor.photoreceptor;
        match receptor.curve {
            Curve::Log => simd::ln(light + self.sensor.log_eps),
            Curve::Linlog => {
                let i = light * receptor.full_scale;
                let positive = if i > 1.0 { i } else { 1.0 };
                if i <= receptor.knee { i * self.below_knee } else { simd::ln(positive) }
            }
        }
    }
}

/// Whether the leak is a ramp.
pub(crate) fn ramps(sensor: &SensorConfig) -> bool {
    sensor.noise.leak_hz > 0.0 && sensor.noise.leak_law == LeakLaw::Ramp
}
