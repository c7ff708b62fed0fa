//! The stages of a sensor beside its thresholds. Each is off by default, and what is off costs nothing.

use serde::{Deserialize, Serialize};

use super::ConfigError;

/// How light becomes the signal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Curve {
    /// `ln(Y / Y_ref + eps)` (default).
    #[default]
    Log,
    /// Straight below a knee, a logarithm above it, as in v2e: with `I = full_scale · Y / Y_ref`, `I · ln(knee) / knee`
    /// up to the knee, else `ln I`.
    Linlog,
}

/// How the low-pass follows its input between two samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FilterRule {
    /// Its exact answer to a signal that is straight between samples (default).
    #[default]
    Exact,
    /// `y += min(1, 2 pi f dt) (x - y)` with the end sample, as in v2e and EVIS: an approximation for small steps. A second
    /// pole follows the first one's new value, as in OpenEB.
    Euler,
}

/// What a low-pass's cutoff depends on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Bandwidth {
    /// Nothing (default).
    #[default]
    Constant,
    /// Light: the cutoff is multiplied by `(Y / Y_ref + offset) / (1 + offset)`, kept within least and most.
    Light,
}

/// From light to the signal that the trigger sees.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Photoreceptor {
    /// How light becomes a signal.
    pub curve: Curve,
    /// `I` of `Y_ref` (`linlog` only).
    pub full_scale: f32,
    /// Where the logarithm begins, in units of `I` (`linlog` only); above 1.
    pub knee: f32,
    /// Dark current, as light that is added to `Y / Y_ref`.
    pub dark_light: f32,
    /// -3 dB frequency of one pole of the low-pass at `Y_ref`; 0: none.
    pub cutoff_hz: f32,
    /// Poles, all alike: 1 or 2.
    pub order: u32,
    /// How it is computed.
    pub filter: FilterRule,
    /// What its cutoff depends on.
    pub bandwidth: Bandwidth,
    /// `offset` of [`Bandwidth::Light`].
    pub bandwidth_offset: f32,
    /// Least factor of [`Bandwidth::Light`].
    pub bandwidth_least: f32,
    /// Greatest factor of [`Bandwidth::Light`].
    pub bandwidth_most: f32,
    /// Noise before the low-pass (`exact` only): its root mean square behind it, log units, at any light; 0: none.
    pub noise: f32,
}

impl Default for Photoreceptor {
    fn default() -> Self {
        Self {
            curve: Curve::Log,
            full_scale: 255.0,
            knee: 20.0,
            dark_light: 0.0,
            cutoff_hz: 0.0,
            order: 1,
            filter: FilterRule::Exact,
            bandwidth: Bandwidth::Constant,
            bandwidth_offset: 0.0,
            bandwidth_least: 0.01,
            bandwidth_most: 100.0,
            noise: 0.0,
        }
    }
}

/// Where a pixel's reference starts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Start {
    /// At the signal (default).
    #[default]
    Signal,
    /// Uniformly between the two thresholds, so that pixels do not fire in step.
    Phase,
}

/// What differs from pixel to pixel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Pattern {
    /// Standard deviation of each pixel's thresholds, log units; ON and OFF apart.
    pub sigma: f32,
    /// No pixel's threshold is less than this.
    pub least: f32,
    /// No pixel's threshold is more than this.
    pub most: f32,
    /// Share of pixels that never fire.
    pub dead_share: f32,
    /// Share of pixels whose thresholds are both `sensitive_threshold`, so that the least change fires them: the
    /// "crazy pixels" of OpenEB.
    pub sensitive_share: f32,
    /// See `sensitive_share`; at least 0.001, and not bound by `least`.
    pub sensitive_threshold: f32,
    /// Whether `sigma` is redrawn for every pixel and frame, as ESIM does, instead of once.
    pub redraw: bool,
    /// Where references start.
    pub start: Start,
}

impl Default for Pattern {
    fn default() -> Self {
        Self {
            sigma: 0.0,
            least: 0.01,
            most: 100.0,
            dead_share: 0.0,
            sensitive_share: 0.0,
            sensitive_threshold: 1e-3,
            redraw: false,
            start: Start::Signal,
        }
    }
}

/// How the leak makes events.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LeakLaw {
    /// The reference falls evenly, and ON events come when it is a threshold away (default). Their reference is the
    /// signal then.
    #[default]
    Ramp,
    /// ON events at random times, that do what `noise.reference` says.
    Poisson,
}

/// What a noise event does to its pixel's reference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NoiseReference {
    /// Nothing (default).
    #[default]
    Keep,
    /// It becomes the signal.
    Signal,
}

/// Events without a cause in the scene; rates are means over pixels, in events per second.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Noise {
    /// Leak: ON events per second of a pixel that sees no change.
    pub leak_hz: f32,
    /// How the leak makes events.
    pub leak_law: LeakLaw,
    /// Standard deviation of the pixels' leak rates, in decades (log-normal).
    pub leak_spread_decades: f32,
    /// Standard deviation of the time between two leak events, as a share of it (`ramp` only); at most 0.2.
    pub leak_jitter: f32,
    /// Shot noise, ON and OFF together, before light takes its share.
    pub shot_hz: f32,
    /// Share of the shot noise that is gone at `Y_ref`: the rate is `1 - share · (Y / Y_ref + offset) / (1 + offset)`,
    /// with `Y / Y_ref` at most 1. EVIS: 1; v2e: 0.75.
    pub shot_light_share: f32,
    /// `offset` above. EVIS: 0; v2e: 20 / 255.
    pub shot_light_offset: f32,
    /// Whether a polarity's rate is inversely proportional to the pixel's own threshold, as in v2e.
    pub shot_per_threshold: bool,
    /// Standard deviation of the pixels' shot rates, in decades (log-normal).
    pub shot_spread_decades: f32,
    /// Share of ON events in the shot noise and of hot pixels.
    pub on_share: f32,
    /// What leak (`poisson`), shot noise and hot pixels do to the reference.
    pub reference: NoiseReference,
    /// Share of pixels that are hot.
    pub hot_share: f32,
    /// Events per second of a hot pixel.
    pub hot_hz: f32,
    /// Mean number of shot events that follow each shot event; the rate above counts them all.
    pub burst_events: f32,
    /// Mean delay of those that follow, microseconds; at most 2000. Where `burst_longest_us` is set, their shortest one.
    pub burst_us: f32,
    /// Longest delay of those that follow, microseconds, at most a million: delays are then as many per decade from
    /// `burst_us` to here. 0: delays are exponential.
    pub burst_longest_us: f32,
    /// Probability that a shot event's polarity is not that of its pixel's last event; below 0: polarities are
    /// independent, with `on_share`.
    pub alternation: f32,
    /// How long shot noise takes to come back after an event of its pixel, microseconds, at most a million: `t` after it the
    /// rate is `1 - e^-(t / this)^2` of what it was, as noise that is slower than that needs time to carry the signal across
    /// a threshold again. What follows in a burst comes nevertheless. 0: at once.
    pub shot_recovery_us: f32,
}

impl Default for Noise {
    fn default() -> Self {
        Self {
            leak_hz: 0.0,
            leak_law: LeakLaw::Ramp,
            leak_spread_decades: 0.0,
            leak_jitter: 0.0,
            shot_hz: 0.0,
            shot_light_share: 0.0,
            shot_light_offset: 0.0,
            shot_per_threshold: false,
            shot_spread_decades: 0.0,
            on_share: 0.5,
            reference: NoiseReference::Keep,
            hot_share: 0.0,
            hot_hz: 0.0,
            burst_events: 0.0,
            burst_us: 300.0,
            burst_longest_us: 0.0,
            alternation: -1.0,
            shot_recovery_us: 0.0,
        }
    }
}

/// What a refractory pixel does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RefractoryRule {
    /// Its events are lost, its reference moves as if they were not (ESIM, EVIS; default).
    #[default]
    Suppress,
    /// Its reference stays; what is a threshold away at the end of the period fires then (v2e).
    Defer,
    /// It is held, and its reference is the signal at the end of the period (hardware).
    Hold,
}

/// Silence after an event.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Refractory {
    /// Its length in microseconds; 0: none.
    pub period_us: u32,
    /// What the pixel does meanwhile.
    pub rule: RefractoryRule,
}

/// From the pixel to the host.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Readout {
    /// Delay of every event, microseconds.
    pub latency_us: f32,
    /// Further delay that is inversely proportional to light: this at `Y_ref`; at most a hundred times this.
    pub latency_light_us: f32,
    /// Standard deviation of the delay, microseconds; no delay is below 0.
    pub jitter_us: f32,
    /// Time that the bus takes to choose a row, nanoseconds. With this or `event_ns` above 0, rows are read one after
    /// the other, the one that has waited longest first, and a row's events carry the time at which it is chosen.
    pub row_ns: u32,
    /// Time that the bus takes per event, nanoseconds.
    pub event_ns: u32,
    /// Events per second at most, counted in windows of a millisecond; more are dropped and counted. 0: no limit.
    pub rate_limit_hz: f64,
    /// Times are multiples of this, rounded up; 0 and 1: microseconds.
    pub tick_us: u32,
}

impl Readout {
    /// Whether pixels share a bus, or a limit of its rate: then when an event leaves depends on those of other pixels.
    pub fn has_bus(&self) -> bool {
        self.row_ns > 0 || self.event_ns > 0 || self.rate_limit_hz > 0.0
    }

    /// Whether events leave as they were fired.
    pub fn is_off(&self) -> bool {
        let Self { latency_us, latency_light_us, jitter_us, row_ns, event_ns, rate_limit_hz, tick_us } =
            *self;
        latency_us == 0.0
            && latency_light_us == 0.0
            && jitter_us == 0.0
            && (row_ns, event_ns) == (0, 0)
            && rate_limit_hz == 0.0
            && tick_us <= 1
    }
}

/// Brownian motion with drift in place of thresholds on the signal: DVS-Voltmeter (ECCV 2022). With `I = 255 · Y / Y_ref`
/// and its change `İ` per microsecond, the drift is `k1 İ / (I + k2) + k4 + k5 I` and the volatility
/// `k3 sqrt(I) / (I + k2) + k6`, per microsecond; events where the sum is 1 away from the last.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Diffusion {
    /// See the formula.
    pub k1: f32,
    /// See the formula.
    pub k2: f32,
    /// See the formula.
    pub k3: f32,
    /// See the formula.
    pub k4: f32,
    /// See the formula.
    pub k5: f32,
    /// See the formula.
    pub k6: f32,
}

/// One rule for one number.
fn within(what: &str, value: f32, least: f32, most: f32) -> Result<(), ConfigError> {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    Err(ConfigError::new(what, value, format!("between {least} and {most}")))
}

impl Photoreceptor {
    /// # Errors
    /// Names the first value that cannot be used.
    pub(super) fn check(&self) -> Result<(), ConfigError> {
        within("photoreceptor.full_scale", self.full_scale, 1e-6, 1e6)?;
        within("photoreceptor.knee", self.knee, 1.01, 1e6)?;
        within("photoreceptor.dark_light", self.dark_light, 0.0, 1e6)?;
        if !(0.0..=500_000.0).contains(&self.cutoff_hz) {
            return Err(ConfigError::new(
                "photoreceptor.cutoff_hz",
                self.cutoff_hz,
                "0 (no low-pass) or up to 500000 Hz, the Nyquist frequency of microseconds",
            ));
        }
        if !(1..=2).contains(&self.order) {
            return Err(ConfigError::new("photoreceptor.order", self.order, "1 or 2"));
        }
        within("photoreceptor.bandwidth_offset", self.bandwidth_offset, 0.0, 1e3)?;
        within("photoreceptor.bandwidth_least", self.bandwidth_least, 1e-6, 1e6)?;
        within("photoreceptor.bandwidth_most", self.bandwidth_most, self.bandwidth_least, 1e6)?;
        within("photoreceptor.noise", self.noise, 0.0, 10.0)?;
        if self.noise > 0.0 && (self.cutoff_hz == 0.0 || self.filter == FilterRule::Euler) {
            let remedy = if self.cutoff_hz == 0.0 {
                "0 without a low-pass, which gives noise its bandwidth: set photoreceptor.cutoff_hz"
            } else {
                "0 with the filter euler, whose noise would depend on the frame rate: set photoreceptor.filter to exact"
            };
            return Err(ConfigError::new("photoreceptor.noise", self.noise, remedy));
        }
        Ok(())
    }
}

impl Pattern {
    /// # Errors
    /// Names the first value that cannot be used.
    pub(super) fn check(&self) -> Result<(), ConfigError> {
        within("pattern.sigma", self.sigma, 0.0, 10.0)?;
        within("pattern.least", self.least, 1e-3, 100.0)?;
        within("pattern.most", self.most, self.least, 100.0)?;
        within("pattern.dead_share", self.dead_share, 0.0, 1.0)?;
        within("pattern.sensitive_share", self.sensitive_share, 0.0, 1.0)?;
        within("pattern.sensitive_threshold", self.sensitive_threshold, 1e-3, 100.0)
    }
}

impl Noise {
    /// # Errors
    /// Names the first value that cannot be used.
    pub(super) fn check(&self) -> Result<(), ConfigError> {
        within("noise.leak_hz", self.leak_hz, 0.0, 1e4)?;
        within("noise.leak_spread_decades", self.leak_spread_decades, 0.0, 1.0)?;
        within("noise.leak_jitter", self.leak_jitter, 0.0, 0.2)?;
        within("noise.shot_hz", self.shot_hz, 0.0, 1e4)?;
        within("noise.shot_light_share", self.shot_light_share, 0.0, 1.0)?;
        within("noise.shot_light_offset", self.shot_light_offset, 0.0, 1e3)?;
        within("noise.shot_spread_decades", self.shot_spread_decades, 0.0, 1.0)?;
        within("noise.on_share", self.on_share, 0.0, 1.0)?;
        within("noise.hot_share", self.hot_share, 0.0, 1.0)?;
        within("noise.hot_hz", self.hot_hz, 0.0, 1e4)?;
        within("noise.burst_events", self.burst_events, 0.0, 20.0)?;
        within("noise.burst_us", self.burst_us, 1.0, 2000.0)?;
        if self.burst_longest_us != 0.0 {
            within("noise.burst_longest_us", self.burst_longest_us, self.burst_us, 1e6)?;
        }
        within("noise.alternation", self.alternation, -1.0, 1.0)?;
        within("noise.shot_recovery_us", self.shot_recovery_us, 0.0, 1e6)
    }
}

impl Readout {
    /// # Errors
    /// Names the first value that cannot be used.
    pub(super) fn check(&self) -> Result<(), ConfigError> {
        within("readout.latency_us", self.latency_us, 0.0, 1e6)?;
        within("readout.latency_light_us", self.latency_light_us, 0.0, 1e4)?;
        within("readout.jitter_us", self.jitter_us, 0.0, 1e5)?;
        for (what, value) in [("readout.row_ns", self.row_ns), ("readout.event_ns", self.event_ns)] {
            if value > 1_000_000 {
                return Err(ConfigError::new(what, value, "at most 1000000"));
            }
        }
        let limit = self.rate_limit_hz;
        if limit != 0.0 && !(1e3..=1e12).contains(&limit) {
            return Err(ConfigError::new("readout.rate_limit_hz", limit, "0 (none) or between 1e3 and 1e12"));
        }
        if self.tick_us > 1_000_000 {
            return Err(ConfigError::new("readout.tick_us", self.tick_us, "at most 1000000"));
        }
        Ok(())
    }
}

impl Diffusion {
    /// # Errors
    /// Names the first value that cannot be used.
    pub(super) fn check(&self) -> Result<(), ConfigError> {
        let Self { k1, k2, k3, k4, k5, k6 } = *self;
        within("diffusion.k1", k1, -1e3, 1e3)?;
        within("diffusion.k2", k2, 1e-3, 1e6)?;
        within("diffusion.k3", k3, 0.0, 1e3)?;
        within("diffusion.k4", k4, -1.0, 1.0)?;
        within("diffusion.k5", k5, -1.0, 1.0)?;
        within("diffusion.k6", k6, 0.0, 1.0)
    }
}
