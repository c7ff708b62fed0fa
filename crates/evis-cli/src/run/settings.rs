//! What a recording stores of its run.

use anyhow::Context;
use evis_core::CameraInfo;
use evis_core::format::hdf5::RecordingHeader;
use evis_render::RunConfig;
use evis_scene::AppliedMotion;
use serde::Serialize;

use crate::args::to_us;

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
    pub(super) run: RunConfig,
}

/// One per environment.
pub(super) fn headers(settings: &Settings, cameras: &[CameraInfo]) -> anyhow::Result<Vec<RecordingHeader>> {
    let config_toml = toml::to_string(settings).context("the settings cannot be stored")?;
    let method = settings.run.method.name().to_owned();
    let header = |environment| RecordingHeader {
        cameras: cameras.to_vec(),
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
            run: config.clone(),
        };
        let stored: toml::Table = headers(&settings, &[]).unwrap()[0].config_toml.parse().unwrap();
        let run: RunConfig = stored["run"].clone().try_into().unwrap();
        assert_eq!(run, config);
        assert_ne!(run, RunConfig::default(), "canary: the comparison must see a difference");
    }
}
