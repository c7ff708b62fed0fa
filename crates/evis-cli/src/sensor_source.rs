//! Sensors by name or by file.

use std::collections::BTreeMap;
use std::path::Path;

use evis_core::SensorConfig;
use evis_core::limits::{Budget, read_text};
use evis_core::sensor::PRESETS;
use evis_core::words::did_you_mean;

use crate::failure::bad_input;

/// The preset `name`, or the sensor in the TOML file of that name; `flag` asked for it.
pub(crate) fn load(flag: &str, name: &str) -> anyhow::Result<SensorConfig> {
    let path = Path::new(name);
    if PRESETS.iter().any(|preset| preset.name == name) {
        return Ok(SensorConfig::preset(name)?);
    }
    let is_file = path.extension().is_some() || path.components().count() > 1 || path.is_file();
    if !is_file {
        let names: Vec<_> = PRESETS.iter().map(|preset| preset.name).collect();
        return Err(bad_input(format!(
            "{flag} {name}: neither a preset nor a file{}; presets are {}, or name a TOML file",
            did_you_mean(name, names.iter().copied()),
            names.join(", ")
        )));
    }
    let text = read_text(path, &Budget::default())
        .map_err(|error| bad_input(format!("{flag} {name}: cannot be read ({error}); name a TOML file")))?;
    SensorConfig::from_toml(&text).map_err(|error| bad_input(format!("{flag} {name}: {error}")))
}

/// What `--sensor` flags ask for.
#[derive(Debug, Default)]
pub(crate) struct Asked {
    /// For all cameras that are not named.
    pub(crate) all: Option<SensorConfig>,
    /// For single cameras.
    pub(crate) of: BTreeMap<String, SensorConfig>,
}

/// Reads `--sensor` flags: `PRESET|FILE`, once, and `CAMERA=PRESET|FILE`.
pub(crate) fn asked(flags: &[String]) -> anyhow::Result<Asked> {
    let mut asked = Asked::default();
    for flag in flags {
        // A file may have the sign in its name.
        let (camera, name) = match flag.split_once('=') {
            Some((camera, name)) if !Path::new(flag).is_file() => (Some(camera), name),
            _ => (None, flag.as_str()),
        };
        let sensor = load("--sensor", name)?;
        let before = match camera {
            Some(camera) => asked.of.insert(camera.to_owned(), sensor),
            None => asked.all.replace(sensor),
        };
        if before.is_some() {
            let whose = camera.map_or_else(|| "all cameras have".into(), |camera| format!("'{camera}' has"));
            return Err(bad_input(format!("--sensor {flag}: {whose} one already; give one of them")));
        }
    }
    Ok(asked)
}
