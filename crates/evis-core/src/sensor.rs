//! Sensor configuration: a value, checked once at the door, then trusted.

use serde::{Deserialize, Serialize};

/// A configuration value that cannot be used: which one, what it was, and what would work.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{what} is {value}; it must be {remedy}")]
pub struct ConfigError {
    /// Name of the setting, as the user wrote it.
    pub what: String,
    /// The refused value.
    pub value: String,
    /// What would work.
    pub remedy: String,
}

impl ConfigError {
    /// An error about setting `what` with `value`; `remedy` completes "it must be …".
    pub fn new(what: &str, value: impl std::fmt::Display, remedy: impl Into<String>) -> Self {
        Self { what: what.into(), value: value.to_string(), remedy: remedy.into() }
    }
}

/// How a pixel turns a change of log intensity into events (DESIGN: trigger).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TriggerRule {
    /// Every threshold crossing between two samples, each at its own time (default).
    #[default]
    Crossing,
    /// At most one event per pixel and sample, at the sample's time; the reference becomes the signal.
    Latch,
}

/// What is straight between two samples, where the trigger asks when a crossing lies (`crossing` only).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Interpolation {
    /// Log intensity: exact for exponentials (default).
    #[default]
    Log,
    /// Light: exact while an edge moves evenly through a pixel, but not where it enters or leaves within an interval.
    Light,
}

/// What a user asks of a sensor.
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
    /// What is straight between samples.
    pub interpolation: Interpolation,
}

impl Default for SensorConfig {
    fn default() -> Self {
        Self {
            threshold_on: 0.2,
            threshold_off: 0.2,
            log_eps: 1e-3,
            trigger: TriggerRule::Crossing,
            interpolation: Interpolation::Log,
        }
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
        Ok(Self { config })
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
    fn thresholds_must_be_positive() {
        assert!(Sensor::new(SensorConfig::default()).is_ok());
        for bad in [0.0, -0.1, f32::NAN, f32::INFINITY] {
            let error = Sensor::new(SensorConfig { threshold_on: bad, ..Default::default() }).unwrap_err();
            assert!(error.to_string().contains("threshold_on"), "{error}");
        }
    }
}
