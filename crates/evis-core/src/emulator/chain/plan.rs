//! Which stages are on, and their settings in the units of the passes.

use crate::sensor::{
    Bandwidth, Curve, FilterRule, LeakLaw, Refractory, RefractoryRule, SensorConfig, Times, TriggerRule,
};
use crate::simd;

/// The stages that are on, in the numbers that the passes need; made once.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    pub sensor: SensorConfig,
    /// 2 pi cutoff, per microsecond; 0: no low-pass.
    pub rate: f32,
    pub exact: bool,
    pub two_poles: bool,
    /// Rms of the photoreceptor's noise; 0: none.
    pub noise: f32,
    /// Whether the leak is a ramp.
    pub ramp: bool,
    /// Whether events are decided at samples, with times given by a rule.
    pub sampled: bool,
    /// Whether the reference of each interval is the sample at its start.
    pub forgets: bool,
    /// Whether thresholds are drawn for every frame.
    pub redraws: bool,
    /// Whether a pixel can come back to a level exactly: with thresholds that all have in common, and without a filter or a
    /// leak.
    pub ties: bool,
    /// What linlog multiplies with below its knee.
    below_knee: f32,
    /// How blocks are treated that noise does not reach, where that can be done for all pixels alike.
    pub plain: Option<Plain>,
}

/// See [`Plan::plain`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plain {
    /// [`crate::emulator::plain::lines`].
    Lines,
    /// [`crate::emulator::plain::samples`].
    Samples,
}

impl Plan {
    pub fn new(sensor: &SensorConfig) -> Self {
        let receptor = &sensor.photoreceptor;
        let mut plan = Self {
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
            plain: None,
            sensor: sensor.clone(),
        };
        plan.plain = plan.to_plain();
        plan
    }

    /// What [`Plan::plain`] is.
    fn to_plain(&self) -> Option<Plain> {
        let Refractory { period_us, rule } = self.sensor.refractory;
        let may = |rules: &[RefractoryRule]| period_us == 0 || rules.contains(&rule);
        let readout = &self.sensor.readout;
        if readout.jitter_us > 0.0 || readout.latency_light_us > 0.0 {
            return None;
        }
        if self.sampled {
            let stays = self.sensor.trigger == TriggerRule::Crossing;
            return (stays && may(&[RefractoryRule::Suppress, RefractoryRule::Defer]))
                .then_some(Plain::Samples);
        }
        let straight = self.noise == 0.0 && (self.rate == 0.0 || !self.exact) && !self.ramp && !self.ties;
        (straight && may(&[RefractoryRule::Suppress])).then_some(Plain::Lines)
    }

    /// Whether all tiles must be scanned before any event has its time.
    pub fn shares_times(&self) -> bool {
        self.sampled && self.sensor.times == Times::Shared
    }

    /// What multiplies the cutoff at this light.
    #[inline(always)]
    pub fn bandwidth(&self, light: f32) -> f32 {
        let receptor = &self.sensor.photoreceptor;
        match receptor.bandwidth {
            Bandwidth::Constant => 1.0,
            Bandwidth::Light => {
                let relative = (light + receptor.bandwidth_offset) / (1.0 + receptor.bandwidth_offset);
                relative.max(receptor.bandwidth_least).min(receptor.bandwidth_most)
            }
        }
    }

    /// Log units of this light.
    #[inline(always)]
    pub fn curve(&self, light: f32) -> f32 {
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
