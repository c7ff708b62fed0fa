//! Sensors by name or by file.

use std::path::Path;

use evis_core::SensorConfig;
use evis_core::sensor::PRESETS;

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
            "{flag} {name}: neither a preset nor a file; presets are {}, or name a TOML file",
            names.join(", ")
        )));
    }
    let text = std::fs::read_to_string(path)
        .map_err(|error| bad_input(format!("{flag} {name}: cannot be read ({error}); name a TOML file")))?;
    SensorConfig::from_toml(&text).map_err(|error| bad_input(format!("{flag} {name}: {error}")))
}
