//! Sensor configuration: a value, checked once when it is made, then trusted.

mod exposure;
mod noise_law;
mod preset;
mod sample;
mod stages;
mod text;

use serde::{Deserialize, Serialize};

pub use crate::error::ConfigError;
pub use exposure::Exposure;
pub use noise_law::NoiseLaw;
pub use preset::{PRESETS, Preset};
pub use sample::sample;
pub use stages::{
    Bandwidth, Curve, Diffusion, FilterRule, LeakLaw, Noise, NoiseReference, Pattern, Photoreceptor, Readout,
    Refractory, RefractoryRule, Start,
};

/// Most events that one pixel fires in one interval; more are clamped and reported, the reference then
/// moves to the signal. With thresholds of at least 0.001 only a step of e^65 gets here.
pub const MAX_EVENTS_PER_INTERVAL: u32 = 65_535;

/// How a pixel turns a change of log intensity into events.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TriggerRule {
    /// Every threshold crossing between two samples, each at its own time (default).
    #[default]
    Crossing,
    /// At most one event per pixel and sample, at the sample's time; the reference becomes the signal.
    Latch,
    /// Every crossing between two samples, counted from the first of them: what exceeds no threshold within one interval is
    /// forgotten (PIX2NVS).
    Difference,
}

crate::words!(TriggerRule {
    Self::Crossing => "crossing", "every threshold crossing, at its own time";
    Self::Latch => "latch", "at most one event per pixel and sample, at the sample's time";
    Self::Difference => "difference", "every crossing between two samples, counted from the first of them";
});

/// When the events of one interval happen (`crossing` only).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Times {
    /// When their thresholds are crossed (default).
    #[default]
    Crossing,
    /// With the sample that ends the interval.
    Sample,
    /// Evenly over the interval, each pixel by its own count; the last with the sample (AirSim, PIX2NVS).
    Even,
    /// Evenly over the interval, by the count of the pixel with most events; most events so carry its first share or,
    /// where no pixel fires twice, its end (v2e).
    Shared,
}

/// What a user asks of a sensor.
///
/// Beyond thresholds, all stages are off unless asked for: an ideal sensor. A file (TOML) has the values of this
/// structure first, then a table per stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorConfig {
    /// Rise of log intensity that fires an ON event; above 0.
    pub threshold_on: f32,
    /// Fall of log intensity that fires an OFF event; above 0 (a magnitude).
    pub threshold_off: f32,
    /// `eps` in `ln(Y / Y_ref + eps)`; above 0.
    pub log_eps: f32,
    /// Trigger rule.
    pub trigger: TriggerRule,
    /// When events happen.
    #[serde(skip_serializing_if = "is_default")]
    pub times: Times,
    /// Events of one pixel in one interval at most, 1 to 65 535; the rest is lost, and the reference moves to the signal.
    #[serde(skip_serializing_if = "is_most")]
    pub most_events: u32,
    /// What pixels see: light, or frames of it.
    #[serde(skip_serializing_if = "is_default")]
    pub exposure: Exposure,
    /// From light to the signal.
    #[serde(skip_serializing_if = "is_default")]
    pub photoreceptor: Photoreceptor,
    /// What differs from pixel to pixel.
    #[serde(skip_serializing_if = "is_default")]
    pub pattern: Pattern,
    /// Events without a cause in the scene.
    #[serde(skip_serializing_if = "is_default")]
    pub noise: Noise,
    /// Silence after an event.
    #[serde(skip_serializing_if = "is_default")]
    pub refractory: Refractory,
    /// From the pixel to the host.
    #[serde(skip_serializing_if = "is_default")]
    pub readout: Readout,
    /// Another trigger, which takes the place of thresholds, photoreceptor, leak and shot noise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub diffusion: Option<Diffusion>,
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde asks for a reference")]
const fn is_most(value: &u32) -> bool {
    *value == MAX_EVENTS_PER_INTERVAL
}

impl Default for SensorConfig {
    fn default() -> Self {
        Self {
            threshold_on: 0.2,
            threshold_off: 0.2,
            log_eps: 1e-3,
            trigger: TriggerRule::Crossing,
            times: Times::Crossing,
            most_events: MAX_EVENTS_PER_INTERVAL,
            exposure: Exposure::default(),
            photoreceptor: Photoreceptor::default(),
            pattern: Pattern::default(),
            noise: Noise::default(),
            refractory: Refractory::default(),
            readout: Readout::default(),
            diffusion: None,
        }
    }
}

impl SensorConfig {
    /// Whether `other` differs from this one in its thresholds at most.
    pub fn is_alike(&self, other: &Self) -> bool {
        let Self { threshold_on, threshold_off, .. } = *other;
        Self { threshold_on, threshold_off, ..self.clone() } == *other
    }

    /// Whether every stage but thresholds, `eps` and trigger is off.
    pub fn is_ideal(&self) -> bool {
        self.stages().is_empty()
    }

    /// What it has beyond thresholds, `eps` and the triggers `crossing` and `latch`, by the names of a sensor file.
    pub fn stages(&self) -> Vec<&'static str> {
        // Field by field, so that a new one is not forgotten.
        let Self {
            threshold_on: _,
            threshold_off: _,
            log_eps: _,
            trigger,
            times,
            most_events,
            exposure,
            photoreceptor,
            pattern,
            noise,
            refractory,
            readout,
            diffusion,
        } = self;
        let stages = [
            ("trigger", *trigger != TriggerRule::Difference),
            ("times", is_default(times)),
            ("most_events", is_most(most_events)),
            ("exposure", exposure.is_off()),
            ("photoreceptor", is_default(photoreceptor)),
            ("pattern", is_default(pattern)),
            ("noise", is_default(noise)),
            ("refractory", is_default(refractory)),
            ("readout", is_default(readout)),
            ("diffusion", diffusion.is_none()),
        ];
        stages.into_iter().filter(|(_, off)| !off).map(|(name, _)| name).collect()
    }

    /// What it models, in the terms of the field, with the numbers that say how much.
    pub fn models(&self) -> Vec<String> {
        if let Some(diffusion) = &self.diffusion {
            return vec![format!(
                "Brownian motion with drift and first-passage times (k1 {}, ...)",
                diffusion.k1
            )];
        }
        let Self { photoreceptor, pattern, noise, readout, .. } = self;
        let mut models = vec![format!("thresholds {} / {}", self.threshold_on, self.threshold_off)];
        let mut add = |on: bool, text: String| {
            if on {
                models.push(text);
            }
        };
        add(self.trigger == TriggerRule::Latch, "latch".into());
        add(self.trigger == TriggerRule::Difference, "frame differences".into());
        add(pattern.sigma > 0.0, format!("threshold mismatch (sigma {})", pattern.sigma));
        add(!self.exposure.is_off(), format!("exposure of {} us", self.exposure.time_us));
        let cutoff_hz = photoreceptor.cutoff_hz;
        add(cutoff_hz > 0.0, format!("photoreceptor bandwidth ({cutoff_hz} Hz)"));
        add(photoreceptor.noise > 0.0, "photoreceptor noise".into());
        add(noise.leak_hz > 0.0, format!("leak ({:.2} Hz)", noise.leak_hz));
        add(noise.shot_hz > 0.0, format!("shot noise ({} Hz)", noise.shot_hz));
        add(
            noise.hot_share > 0.0,
            format!("hot pixels ({} %)", (f64::from(noise.hot_share) * 1e8).round() / 1e6),
        );
        add(pattern.dead_share > 0.0, format!("dead pixels ({} %)", pattern.dead_share * 100.0));
        let period_us = self.refractory.period_us;
        add(period_us > 0, format!("refractory period ({period_us} us)"));
        add(readout.latency_us > 0.0 || readout.latency_light_us > 0.0, "latency".into());
        add(readout.has_bus(), "readout bus".into());
        models
    }

    /// Whether the engine leaves its pixels to the emulator: what they see has to come to the host.
    pub fn walks_on_host(&self) -> bool {
        self.diffusion.is_some()
            || !self.exposure.is_off()
            || self.photoreceptor.noise > 0.0
            || self.trigger == TriggerRule::Difference
            || (self.pattern.redraw && self.pattern.sigma > 0.0)
    }

    /// The first of its settings that is defined on frames, and has no meaning where light is known at all times; `None` where
    /// there is none.
    pub fn needs_frames(&self) -> Option<&'static str> {
        let stages = [
            ("trigger", self.trigger != TriggerRule::Crossing),
            ("times", self.times != Times::Crossing),
            ("exposure", !self.exposure.is_off()),
            ("photoreceptor.filter", {
                self.photoreceptor.cutoff_hz > 0.0 && self.photoreceptor.filter != FilterRule::Exact
            }),
            ("pattern.redraw", self.pattern.redraw && self.pattern.sigma > 0.0),
            ("diffusion", self.diffusion.is_some()),
        ];
        stages.into_iter().find_map(|(name, needed)| needed.then_some(name))
    }

    /// Whether it is ideal for light that frames have already been made of.
    pub(crate) fn is_ideal_behind_exposure(&self) -> bool {
        self.stages().iter().all(|stage| *stage == "exposure")
    }

    /// What is allowed and probably not meant.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        if self.readout.latency_light_us > 0.0 && self.photoreceptor.cutoff_hz > 0.0 {
            warnings.push(
                "readout.latency_light_us and photoreceptor.cutoff_hz are both set: the pixel's pole then delays \
                 events twice; set one of them to 0"
                    .into(),
            );
        }
        if !self.exposure.is_off() && self.photoreceptor.cutoff_hz > 0.0 {
            warnings.push(
                "exposure.time_us and photoreceptor.cutoff_hz are both set: light is averaged twice, and the low-pass sees \
                 no more than frames; set exposure.time_us to 0, real pixels have a bandwidth and no exposure"
                    .into(),
            );
        }
        warnings
    }
}

/// A checked [`SensorConfig`].
#[derive(Clone, Debug, PartialEq)]
pub struct Sensor {
    config: SensorConfig,
}

impl Sensor {
    /// Checks `config`.
    ///
    /// # Errors
    /// Thresholds and `log_eps` must be finite and above 0.
    pub fn new(config: SensorConfig) -> Result<Self, ConfigError> {
        for (what, value) in [
            ("threshold_on", config.threshold_on),
            ("threshold_off", config.threshold_off),
            ("log_eps", config.log_eps),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return Err(ConfigError::new(what, value, "a finite number above 0"));
            }
        }
        // Below this, one full-range step would fire more events than a pixel's counter holds.
        for (what, value) in [("threshold_on", config.threshold_on), ("threshold_off", config.threshold_off)]
        {
            if value < 1e-3 {
                return Err(ConfigError::new(what, value, "at least 0.001"));
            }
        }
        if !(1..=MAX_EVENTS_PER_INTERVAL).contains(&config.most_events) {
            return Err(ConfigError::new("most_events", config.most_events, "between 1 and 65535"));
        }
        config.exposure.check()?;
        config.photoreceptor.check()?;
        config.pattern.check()?;
        config.noise.check()?;
        if config.refractory.period_us > 10_000_000 {
            let period = config.refractory.period_us;
            return Err(ConfigError::new("refractory.period_us", period, "at most 10000000 (ten seconds)"));
        }
        config.readout.check()?;
        if let Some(diffusion) = &config.diffusion {
            diffusion.check()?;
        }
        Ok(Self { config })
    }

    /// This sensor, if it has thresholds only; `who` cannot do more.
    ///
    /// # Errors
    /// A stage beyond the thresholds is on.
    pub fn thresholds_only(self, who: &str) -> Result<Self, ConfigError> {
        if self.config.is_ideal() {
            return Ok(self);
        }
        Err(ConfigError::new(
            "sensor",
            "more than thresholds",
            format!("thresholds, log_eps and trigger only: {who} has no other stage yet"),
        ))
    }

    /// The checked values.
    pub const fn config(&self) -> &SensorConfig {
        &self.config
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_are_named_as_in_a_file() {
        assert!(SensorConfig { threshold_on: 0.3, log_eps: 0.1, ..Default::default() }.is_ideal());
        let sensor = SensorConfig::from_toml(
            "most_events = 3\nnoise = { shot_hz = 2 }\n[refractory]\nperiod_us = 10\n",
        );
        assert_eq!(sensor.unwrap().stages(), ["most_events", "noise", "refractory"]);
        assert_eq!(SensorConfig::preset("davis346").unwrap().stages(), ["diffusion"]);
    }

    #[test]
    fn what_a_sensor_models_is_named() {
        let models = |name| SensorConfig::preset(name).unwrap().models().join(", ");
        assert_eq!(models("ideal"), "thresholds 0.2 / 0.2");
        assert!(
            models("evis").contains("latch") && models("evis").contains("hot pixels (0.01 %)"),
            "{}",
            models("evis")
        );
        assert!(
            models("v2e").contains("leak (0.01 Hz)") && models("v2e").contains("(500 us)"),
            "{}",
            models("v2e")
        );
        assert!(models("davis346").starts_with("Brownian"));
    }

    #[test]
    fn thresholds_must_be_positive() {
        assert!(Sensor::new(SensorConfig::default()).is_ok());
        for bad in [0.0, -0.1, f32::NAN, f32::INFINITY] {
            let error = Sensor::new(SensorConfig { threshold_on: bad, ..Default::default() }).unwrap_err();
            assert!(error.to_string().contains("threshold_on"), "{error}");
        }
    }
}
