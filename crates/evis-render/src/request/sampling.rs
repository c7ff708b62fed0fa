//! What a user asks of sampling.

use evis_core::{ConfigError, SensorConfig, Word};
use evis_scene::Scene;

use crate::config::{Antialias, Compute, Interpolation, Method, Quality, RunConfig, Shadows};
use crate::error::EngineError;
use crate::gpu::Gpu;
use crate::request::quality::SamplingSettings;

/// What a user may ask of sampling; `None` where nothing was said.
///
/// The base is a preset, a settings file (already in the configuration), or a method with its defaults; whatever is given by
/// hand stands over it. Without any of them it is [`Quality::Standard`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SamplingRequest {
    /// A preset.
    pub quality: Option<Quality>,
    /// Whether the configuration comes from a settings file.
    pub from_settings: bool,
    /// How instants are sampled.
    pub method: Option<Method>,
    /// [`RunConfig::rate_hz`].
    pub rate_hz: Option<f64>,
    /// [`RunConfig::adaptive_px`].
    pub adaptive_px: Option<f64>,
    /// [`RunConfig::samples`].
    pub samples: Option<u32>,
    /// [`RunConfig::antialias`].
    pub antialias: Option<Antialias>,
    /// [`RunConfig::texture_taps`].
    pub texture_taps: Option<u32>,
    /// [`RunConfig::shadows`].
    pub shadows: Option<Shadows>,
    /// [`RunConfig::compute`].
    pub compute: Option<Compute>,
}

const NO_INSTANTS: &str =
    "left out: decoupled sampling evaluates each pixel at its own times, and this sensor takes no frames";

impl SamplingRequest {
    /// The first setting that was given by hand, and its value.
    fn by_hand(&self) -> Option<(&'static str, String)> {
        let text = |value: Option<f64>| value.map(|value| value.to_string());
        let whole = |value: Option<u32>| value.map(|value| value.to_string());
        [
            ("rate_hz", text(self.rate_hz)),
            ("adaptive_px", text(self.adaptive_px)),
            ("samples", whole(self.samples)),
            ("antialias", self.antialias.map(|value| value.word().to_owned())),
            ("texture_taps", whole(self.texture_taps)),
        ]
        .into_iter()
        .find_map(|(name, value)| Some((name, value?)))
    }

    /// The first setting of rendered instants that was given by hand, and its value. Where sensors take frames, the rate is
    /// theirs, however light is sampled.
    fn of_instants(&self, framed: bool) -> Option<(&'static str, String)> {
        let rate_hz = self.rate_hz.filter(|_| !framed);
        Self { adaptive_px: None, rate_hz, ..self.clone() }.by_hand()
    }

    /// Checks what contradicts itself, without scene or device.
    ///
    /// # Errors
    /// Names what cannot be had together.
    pub fn check(&self) -> Result<(), ConfigError> {
        let keyframes = self.method.filter(|method| method.keyframes().is_some());
        if let (Some(quality), Some(method)) = (self.quality, keyframes) {
            let remedy = format!("left out: {} has settings of its own", method.name());
            return Err(ConfigError::new("quality", quality.name(), remedy));
        }
        if let (Some(quality), true) = (self.quality, self.from_settings) {
            let remedy = "left out: a settings file says how pixels are sampled";
            return Err(ConfigError::new("quality", quality.name(), remedy));
        }
        let decoupled = self.method == Some(Method::Decoupled);
        if let (Some(Compute::Gpu), Some(method), false) = (self.compute, self.method, decoupled) {
            let remedy = format!("left out: {} renders on the device", method.name());
            return Err(ConfigError::new("compute", "gpu", remedy));
        }
        if decoupled && let Some(quality) = self.quality {
            return Err(ConfigError::new(
                "quality",
                quality.name(),
                "left out: decoupled sampling has no presets",
            ));
        }
        // What the rate is of depends on the sensor.
        if decoupled && let Some((name, value)) = self.of_instants(true) {
            return Err(ConfigError::new(name, value, NO_INSTANTS));
        }
        if let (Some(method), Some(rate_hz)) = (keyframes, self.rate_hz) {
            let remedy = format!(
                "left out: {} samples `keyframe_hz` times `steps` instants per second; give those",
                method.name()
            );
            return Err(ConfigError::new("rate_hz", rate_hz, remedy));
        }
        Ok(())
    }

    /// The preset that is in force before anything given by hand.
    pub fn preset(&self) -> Option<Quality> {
        let nothing = self.method.is_none() && self.by_hand().is_none() && !self.from_settings;
        self.quality.or(nothing.then_some(Quality::Standard))
    }

    /// Sets sampling in `config`, in which all else is set. Returns notes for the user: what a preset could not have. Without a
    /// device presets take decoupled sampling.
    ///
    /// # Errors
    /// What contradicts itself, cameras that do not exist or cannot be used.
    pub fn apply(
        &self,
        gpu: Option<&Gpu>,
        scene: &Scene,
        config: &mut RunConfig,
    ) -> Result<Vec<String>, EngineError> {
        self.check()?;
        if self.shadows.is_some() {
            config.shadows = self.shadows;
        }
        config.compute = self.compute.unwrap_or(config.compute);
        let mut notes = Vec::new();
        let takes_frames = |sensor: &SensorConfig| sensor.needs_frames().is_some();
        let framed = takes_frames(&config.sensor) || config.sensors.values().any(takes_frames);
        if let Some(quality) = self.preset() {
            let sampling = quality.sampling();
            let sampling = SamplingSettings { rate_hz: self.rate_hz.unwrap_or(sampling.rate_hz), ..sampling };
            notes = sampling.apply(gpu, scene, config)?;
            let renders = self.of_instants(framed).is_some() || self.method == Some(Method::Native);
            if config.method == Method::Decoupled && renders {
                // Settings of instants are for rendered ones.
                notes = sampling.rendered().apply(gpu, scene, config)?;
            }
            config.quality = self.by_hand().is_none().then_some(quality);
        } else if let Some(method) = self.method {
            config.method = method;
            // What a settings file has goes with its own method.
            config.rendered_tiles = None;
        }
        if config.method == Method::Decoupled
            && let Some((name, value)) = self.of_instants(framed)
        {
            return Err(ConfigError::new(name, value, NO_INSTANTS).into());
        }
        let set = |to: &mut f64, from: Option<f64>| *to = from.unwrap_or(*to);
        set(&mut config.rate_hz, self.rate_hz);
        if self.adaptive_px.is_some() {
            config.adaptive_px = self.adaptive_px;
            if config.method.has_adaptive_time() {
                config.between = Interpolation::Curve;
            }
        }
        config.antialias = self.antialias.unwrap_or(config.antialias);
        config.samples = self.samples.unwrap_or(config.samples);
        config.texture_taps = self.texture_taps.or(config.texture_taps);
        config.check()?;
        Ok(notes)
    }
}

#[cfg(test)]
mod tests {
    use evis_core::Warp;

    use super::*;

    #[test]
    fn what_is_given_by_hand_decides_whether_a_preset_is_in_force() {
        let nothing = SamplingRequest::default();
        assert_eq!(nothing.preset(), Some(Quality::Standard));
        let native = SamplingRequest { method: Some(Method::Native), ..nothing.clone() };
        assert_eq!(native.preset(), None);
        let by_hand = SamplingRequest { samples: Some(4), ..nothing.clone() };
        assert_eq!(by_hand.preset(), None);
        let over = SamplingRequest { quality: Some(Quality::High), ..by_hand };
        assert_eq!(over.preset(), Some(Quality::High));
        let shadows = SamplingRequest { shadows: Some(Shadows::Maps), ..nothing.clone() };
        assert_eq!(shadows.preset(), Some(Quality::Standard), "shadows alone leave the preset in force");
        let file = SamplingRequest { from_settings: true, ..nothing };
        assert_eq!(file.preset(), None);
    }

    #[test]
    fn contradictions_are_named() {
        let splat = Some(Method::Splat(Warp::default()));
        let refused = |request: SamplingRequest| request.check().unwrap_err().to_string();
        let quality = Some(Quality::High);
        assert!(refused(SamplingRequest { quality, method: splat, ..Default::default() }).contains("high"));
        assert!(
            refused(SamplingRequest { quality, from_settings: true, ..Default::default() })
                .contains("settings file")
        );
        let rate_hz = Some(500.0);
        assert!(refused(SamplingRequest { rate_hz, method: splat, ..Default::default() }).contains("500"));
    }
}
