//! Sensors by name. Each says where its numbers come from, and what of its source it leaves out.

use super::stages::{
    Bandwidth, Curve, Diffusion, FilterRule, LeakLaw, Noise, NoiseReference, Pattern, Photoreceptor, Readout,
    Refractory, RefractoryRule, Start,
};
use super::{ConfigError, SensorConfig, Times, TriggerRule};
use crate::words::did_you_mean;

/// A named sensor.
#[derive(Clone, Copy, Debug)]
pub struct Preset {
    /// Its name.
    pub name: &'static str,
    /// Where it comes from, and what it leaves out.
    pub source: &'static str,
    make: fn() -> SensorConfig,
}

impl Preset {
    /// The sensor.
    pub fn sensor(&self) -> SensorConfig {
        (self.make)()
    }
}

/// All presets.
pub const PRESETS: [Preset; 13] = [
    Preset {
        name: "ideal",
        source: "every crossing of a threshold of 0.2 in ln(Y + 0.001); no noise",
        make: SensorConfig::default,
    },
    Preset {
        name: "evis",
        source: "the EVIS paper's plugin: threshold 0.15, latch, eps 1e-5 and its default noise; its low-pass is off by \
                 default. Different here: noise in continuous time with its own timestamps, where the plugin throws a coin \
                 per pixel and frame; times are integers, where its clock in float32 drops two fifths of the hot pixels' \
                 events at 1 kHz",
        make: evis,
    },
    Preset {
        name: "v2e-clean",
        source: "v2e --dvs_params clean: sigma 0.02, nothing else; times and lin-log as in v2e. Different here: times are \
                 integers, and light is Rec. 709 luminance (0.2126, 0.7152, 0.0722), where v2e has Rec. 601's (0.299, 0.587, \
                 0.114), of linear light unless the frames' transfer is linear, as v2e takes them",
        make: || v2e(0.02, 0.0, 0.0, 0.0, 0),
    },
    Preset {
        name: "v2e-noisy",
        source: "v2e --dvs_params noisy: sigma 0.05, 30 Hz, leak 0.1 Hz (0.103 Hz over all pixels, as in v2e), shot 5 Hz, \
                 after which light is memorised. Different here: shot events come at times of their own, as many as asked \
                 for, where v2e throws one coin per pixel and frame and stamps its end; the leak's jitter is drawn per \
                 event, not per frame; frames' transfer as for v2e-clean",
        make: || v2e(0.05, 30.0, 0.1, 5.0, 0),
    },
    Preset {
        name: "v2e",
        source: "v2e's command-line defaults: sigma 0.03, 300 Hz, leak 0.01 Hz (0.0103 Hz over all pixels, as in v2e), \
                 shot 0.001 Hz, after which light is memorised, refractory 0.5 ms. Different here: shot events as in \
                 v2e-noisy, and the refractory period holds for them too; it is asked of every event, where v2e leaves it \
                 out if events of one frame lie farther apart; frames' transfer as for v2e-clean",
        make: || v2e(0.03, 300.0, 0.01, 0.001, 500),
    },
    Preset {
        name: "esim",
        source: "rpg_esim's defaults: C 1.0, sigma 0.021, eps 0.001. Different here: each pixel's thresholds are drawn once, \
                 where ESIM draws them for every pixel and frame (pattern.redraw does so), and levels that a new threshold \
                 has put behind the last sample fire, where ESIM loses them; thresholds are at least 0.01; frames' transfer as \
                 for v2e-clean",
        make: esim,
    },
    Preset {
        name: "openeb",
        source: "OpenEB's batch video-to-event: eps 1e-7, C 0.1, sigma 0.022 within 0.01 to 1, refractory 10 us; two Euler \
                 poles whose bandwidth follows light, at 450 Hz, the middle of the range that it draws from; dead pixels, and \
                 pixels with thresholds of 0.001. Different here: such pixels are in every stream, where OpenEB has them in \
                 one video of a hundred; leak and shot noise, which it draws from 0 to 1 Hz, are off; a signal that ends exactly \
                 on a level fires, where OpenEB loses the event and what follows; frames' transfer as for v2e-clean",
        make: openeb,
    },
    Preset {
        name: "pix2nvs",
        source: "PIX2NVS: differences of ln I from frame to frame (its d = 1; trigger latch is its d = 2), threshold 0.4, at \
                 most 5 events per frame, each where a straight ln I crosses its level. Different here: the threshold \
                 does not adapt by 5 % a frame, no blocks (its default as well), light is Rec. 709 luminance, black is \
                 ln 1e-9 and not minus infinity, and times are not a frame late",
        make: pix2nvs,
    },
    Preset {
        name: "carla",
        source: "CARLA's DVS camera: C 0.3, eps 0.001, no noise. Different here: light is what is given, where CARLA takes \
                 8-bit tone-mapped frames for it (push those with transfer linear)",
        make: carla,
    },
    Preset {
        name: "davis346",
        source: "DVS-Voltmeter's constants for the DAVIS346. Different here: its light of 255 is Y_ref, in place of 8-bit \
                 frames (push those with transfer linear); a pixel's path is followed in steps so short that the frame rate does \
                 not matter, where DVS-Voltmeter takes one per frame; luminance as for v2e-clean",
        make: || voltmeter([5.265, 20.0, 1e-4, 1e-7, 5e-9, 1e-5]),
    },
    Preset {
        name: "davis240",
        source: "DVS-Voltmeter's constants for the DAVIS240; different as davis346 is",
        make: || voltmeter([4.424, 23.0, 2e-4, 1e-7, 5e-8, 1e-5]),
    },
    Preset {
        name: "dvxplorer-like",
        source: "noise fitted to the first second of one public recording of a dark, still scene by a 640x480 sensor, met \
                 within 20 % by its second one (0.43 Hz per pixel, ON share 0.54, hot pixels 0.073 %, Fano factor 1.04, \
                 alternation 0.30) and within 10 % (430 ms from event to event of a pixel, the median); its light and biases \
                 are unknown, the rest is a guess",
        make: dvxplorer_like,
    },
    Preset {
        name: "gen4-like",
        source: "noise fitted to the first half of 1.25 s of one public recording of a nearly still scene by a 1280x720 \
                 sensor, met within 20 % by the other half (0.07 Hz per pixel, ON share 0.5, hot pixels 0.005 %, Fano \
                 factor 3.3, alternation 0.97); its light and biases are unknown, the rest is a guess",
        make: gen4_like,
    },
];

/// Presets whose noise falls with light and was fitted to a recording, and that recording's light, `Y / Y_ref`.
const FITTED: [(&str, f32); 1] = [("dvxplorer-like", 0.0)];

impl SensorConfig {
    /// Light, `Y / Y_ref`, in which the noise of this sensor was fitted to a recording; `None` where its noise is not that of a
    /// preset which says so.
    pub fn fitted_light(&self) -> Option<f32> {
        let is_ours = |name: &str| Self::preset(name).is_ok_and(|preset| preset.noise == self.noise);
        FITTED.iter().find(|(name, _)| is_ours(name)).map(|(_, light)| *light)
    }

    /// The preset `name`.
    ///
    /// # Errors
    /// A name that is none; the message lists those that are.
    pub fn preset(name: &str) -> Result<Self, ConfigError> {
        PRESETS.iter().find(|preset| preset.name == name).map(Preset::sensor).ok_or_else(|| {
            let names = PRESETS.map(|preset| preset.name);
            let hint = did_you_mean(name, names.into_iter());
            ConfigError::new("preset", name, format!("one of {}{hint}", names.join(", ")))
        })
    }
}

fn evis() -> SensorConfig {
    SensorConfig {
        threshold_on: 0.15,
        threshold_off: 0.15,
        log_eps: 1e-5,
        trigger: TriggerRule::Latch,
        pattern: Pattern { sigma: 0.03, ..Pattern::default() },
        noise: Noise {
            leak_hz: 0.1,
            leak_law: LeakLaw::Poisson,
            shot_hz: 0.1,
            shot_light_share: 1.0,
            hot_share: 1e-4,
            hot_hz: 300.0,
            ..Noise::default()
        },
        refractory: Refractory { period_us: 1000, rule: RefractoryRule::Suppress },
        ..SensorConfig::default()
    }
}

/// 20 / 255: what v2e and OpenEB add to a relative intensity.
const V2E_OFFSET: f32 = 20.0 / 255.0;

fn v2e(sigma: f32, cutoff_hz: f32, leak_hz: f32, shot_hz: f32, refractory_us: u32) -> SensorConfig {
    SensorConfig {
        threshold_on: 0.2,
        threshold_off: 0.2,
        times: Times::Shared,
        photoreceptor: Photoreceptor {
            curve: Curve::Linlog,
            cutoff_hz,
            filter: FilterRule::Euler,
            bandwidth: Bandwidth::Light,
            bandwidth_offset: V2E_OFFSET,
            ..Photoreceptor::default()
        },
        pattern: Pattern { sigma, ..Pattern::default() },
        noise: Noise {
            // v2e's factor 10^(0.1 n) has a mean above 1, by which rates are divided here.
            leak_hz: leak_hz * (0.5 * (0.1 * std::f32::consts::LN_10).powi(2)).exp(),
            leak_spread_decades: if leak_hz > 0.0 { 0.1 } else { 0.0 },
            leak_jitter: if leak_hz > 0.0 { 0.1 } else { 0.0 },
            shot_hz,
            shot_light_share: 0.75,
            shot_light_offset: V2E_OFFSET,
            shot_per_threshold: true,
            reference: NoiseReference::Signal,
            ..Noise::default()
        },
        refractory: Refractory { period_us: refractory_us, rule: RefractoryRule::Defer },
        ..SensorConfig::default()
    }
}

fn esim() -> SensorConfig {
    SensorConfig {
        threshold_on: 1.0,
        threshold_off: 1.0,
        pattern: Pattern { sigma: 0.021, ..Pattern::default() },
        ..SensorConfig::default()
    }
}

fn openeb() -> SensorConfig {
    SensorConfig {
        threshold_on: 0.1,
        threshold_off: 0.1,
        log_eps: 1e-7,
        photoreceptor: Photoreceptor {
            cutoff_hz: 450.0,
            order: 2,
            filter: FilterRule::Euler,
            bandwidth: Bandwidth::Light,
            bandwidth_offset: V2E_OFFSET,
            ..Photoreceptor::default()
        },
        pattern: Pattern {
            sigma: 0.022,
            most: 1.0,
            dead_share: 5e-3,
            sensitive_share: 5e-4,
            ..Pattern::default()
        },
        refractory: Refractory { period_us: 10, rule: RefractoryRule::Suppress },
        ..SensorConfig::default()
    }
}

fn pix2nvs() -> SensorConfig {
    SensorConfig {
        threshold_on: 0.4,
        threshold_off: 0.4,
        log_eps: 1e-9,
        trigger: TriggerRule::Difference,
        most_events: 5,
        ..SensorConfig::default()
    }
}

fn carla() -> SensorConfig {
    SensorConfig { threshold_on: 0.3, threshold_off: 0.3, ..SensorConfig::default() }
}

fn voltmeter([k1, k2, k3, k4, k5, k6]: [f32; 6]) -> SensorConfig {
    SensorConfig { diffusion: Some(Diffusion { k1, k2, k3, k4, k5, k6 }), ..SensorConfig::default() }
}

fn dvxplorer_like() -> SensorConfig {
    SensorConfig {
        threshold_on: 0.25,
        threshold_off: 0.25,
        photoreceptor: Photoreceptor {
            cutoff_hz: 300.0,
            bandwidth: Bandwidth::Light,
            bandwidth_offset: 0.02,
            ..Photoreceptor::default()
        },
        pattern: Pattern { sigma: 0.03, start: Start::Phase, ..Pattern::default() },
        noise: Noise {
            // `evis calibrate` of the first second; the scene was dark, how noise falls with light is a guess.
            shot_hz: 0.5266,
            shot_light_share: 0.9,
            shot_spread_decades: 0.3835,
            on_share: 0.5502,
            burst_events: 0.01093,
            burst_us: 657.0,
            alternation: 0.3031,
            shot_recovery_us: 347_600.0,
            hot_share: 7.26e-4,
            hot_hz: 155.5,
            ..Noise::default()
        },
        refractory: Refractory { period_us: 100, rule: RefractoryRule::Hold },
        readout: Readout { row_ns: 50, event_ns: 4, ..Readout::default() },
        ..SensorConfig::default()
    }
}

fn gen4_like() -> SensorConfig {
    SensorConfig {
        threshold_on: 0.25,
        threshold_off: 0.25,
        photoreceptor: Photoreceptor {
            cutoff_hz: 1000.0,
            bandwidth: Bandwidth::Light,
            bandwidth_offset: 0.02,
            ..Photoreceptor::default()
        },
        pattern: Pattern { sigma: 0.02, start: Start::Phase, ..Pattern::default() },
        noise: Noise {
            // `evis calibrate` of the first 0.626 s; the scene's light is unknown, so noise does not depend on light here.
            // The two ends of the delays are the ones of several that come nearest to its Fano factors by window.
            shot_hz: 0.0746,
            shot_spread_decades: 0.669,
            on_share: 0.539,
            burst_events: 1.22,
            burst_us: 1000.0,
            burst_longest_us: 600_000.0,
            alternation: 0.979,
            hot_share: 1.63e-5,
            hot_hz: 63.2,
            ..Noise::default()
        },
        refractory: Refractory { period_us: 50, rule: RefractoryRule::Hold },
        readout: Readout { row_ns: 20, event_ns: 2, ..Readout::default() },
        ..SensorConfig::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::Sensor;

    #[test]
    fn presets_are_usable_and_survive_toml() {
        for preset in &PRESETS {
            let sensor = preset.sensor();
            Sensor::new(sensor.clone()).unwrap();
            let text = sensor.to_toml();
            assert_eq!(SensorConfig::from_toml(&text).unwrap(), sensor, "{}: {text}", preset.name);
            assert_eq!(SensorConfig::preset(preset.name).unwrap(), sensor);
            assert_eq!(sensor.is_ideal(), ["ideal", "carla"].contains(&preset.name), "{}", preset.name);
        }
        let dark = SensorConfig::preset("dvxplorer-like").unwrap();
        assert_eq!(dark.fitted_light(), Some(0.0));
        let other = SensorConfig { noise: Noise { shot_hz: 1.0, ..dark.noise }, ..dark };
        assert_eq!(other.fitted_light(), None);
        for (name, _) in FITTED {
            SensorConfig::preset(name).unwrap();
        }
        let error = SensorConfig::preset("v2f").unwrap_err().to_string();
        assert!(error.contains("v2f") && error.contains("v2e-noisy"), "{error}");
        assert!(SensorConfig::from_toml("[noise]\nleek_hz = 1").is_err());
        let error = SensorConfig::from_toml("[noise]\nleak_hz = -1").unwrap_err().to_string();
        assert!(error.contains("leak_hz") && error.contains("-1"), "{error}");
    }
}
