//! What a recording stores of its run.

use anyhow::Context;
use evis_core::CameraInfo;
use evis_core::format::hdf5::RecordingHeader;
use evis_render::{Imu, ImuConfig, ImuNoise, RunConfig};
use evis_scene::{AppliedMotion, Scene};
use serde::Serialize;

use crate::args::{ImuArgs, to_us};
use crate::failure::bad_input;

/// Packets are this long; the stream's bytes do not depend on it.
pub(super) const PACKET_US: i64 = 10_000;

/// Everything that made the stream what it is; stored in the file as TOML.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Settings {
    pub(super) evis: &'static str,
    pub(super) scene: String,
    pub(super) speed: f64,
    /// Which of a glTF file's animations plays.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) animation: Option<String>,
    pub(super) environments: usize,
    pub(super) duration_s: f64,
    pub(super) packet_us: i64,
    /// How cameras were moved that the scene leaves at rest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) camera_motion: Option<AppliedMotion>,
    /// Inertial measurement units.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) imus: Vec<ImuSettings>,
    pub(super) run: RunConfig,
}

/// An inertial measurement unit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct ImuSettings {
    /// Name of a camera, or of a node.
    pub(super) name: String,
    pub(super) rate_hz: f64,
    pub(super) noise: ImuNoise,
}

impl ImuSettings {
    /// Those that were asked for.
    pub(super) fn asked(args: &ImuArgs) -> anyhow::Result<Vec<Self>> {
        let mut values = ImuNoise::default().values();
        for (key, value) in &args.imu_noise {
            values[*key] = *value;
        }
        let rate_hz = args.imu_rate.unwrap_or(ImuConfig::new(0).rate_hz);
        for (number, name) in args.imu.iter().enumerate() {
            if name.contains('/') {
                return Err(bad_input(format!(
                    "--imu is '{name}', and a recording cannot store a unit with a slash in its name; rename the node"
                )));
            }
            if args.imu[..number].contains(name) {
                return Err(bad_input(format!("--imu is '{name}' twice; give each unit once")));
            }
        }
        let unit = |name: &String| Self { name: name.clone(), rate_hz, noise: ImuNoise::of(values) };
        Ok(args.imu.iter().map(unit).collect())
    }

    /// The unit in environment `environment` of a run.
    pub(super) fn unit(&self, scene: &Scene, run: &RunConfig, environment: usize) -> anyhow::Result<Imu> {
        let node = scene.camera_or_node(&self.name).map_err(|e| bad_input(format!("--imu: {e}")))?;
        let config = ImuConfig {
            environment,
            rate_hz: self.rate_hz,
            noise: self.noise,
            seed: run.seed,
            start_us: run.start_us,
            ..ImuConfig::new(node)
        };
        Ok(Imu::new(scene, config)?)
    }
}

/// One per environment, whose cameras `cameras` tells.
pub(super) fn headers(
    settings: &Settings,
    cameras: impl Fn(usize) -> Vec<CameraInfo>,
) -> anyhow::Result<Vec<RecordingHeader>> {
    let config_toml = toml::to_string(settings).context("the settings cannot be stored")?;
    let method = settings.run.method.name().to_owned();
    let header = |environment: u32| RecordingHeader {
        cameras: cameras(environment as usize),
        seed: settings.run.seed,
        method: method.clone(),
        environment,
        config_toml: config_toml.clone(),
        duration_us: Some(to_us(settings.duration_s)),
        t_offset_us: 0,
        labels: settings.run.carried(),
    };
    Ok((0..settings.environments).filter_map(|e| u32::try_from(e).ok()).map(header).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_settings_can_be_stored_and_read_back() {
        let mut config =
            RunConfig { size: Some((64, 48)), reference_luminance: Some(0.5), ..RunConfig::default() };
        config.cameras.push("left".into());
        config.labels.extend(evis_core::LabelKind::ALL);
        let settings = Settings {
            evis: "0",
            scene: "spinner".into(),
            speed: 1.0,
            animation: None,
            environments: 1,
            duration_s: 0.5,
            packet_us: PACKET_US,
            camera_motion: None,
            imus: vec![ImuSettings {
                name: "left".into(),
                rate_hz: 100.0,
                noise: ImuNoise::of([0.1, 0.0, 0.2, 0.0]),
            }],
            run: config.clone(),
        };
        let stored: toml::Table = headers(&settings, |_| Vec::new()).unwrap()[0].config_toml.parse().unwrap();
        let run: RunConfig = stored["run"].clone().try_into().unwrap();
        assert_eq!(run, config);
        assert_eq!(stored["imus"][0]["noise"]["gyroscope_noise_density"].as_float(), Some(0.2));
        assert_ne!(run, RunConfig::default(), "canary: the comparison must see a difference");
    }
}
