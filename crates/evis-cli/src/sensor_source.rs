//! Sensors by name or by file.

use std::path::Path;

use anyhow::Context;
use evis_core::SensorConfig;
use evis_core::sensor::PRESETS;

use crate::failure::bad_input;

/// The preset `name`, or the sensor in the TOML file of that name.
pub(crate) fn load(name: &str) -> anyhow::Result<SensorConfig> {
    let path = Path::new(name);
    if PRESETS.iter().any(|preset| preset.name == name) {
        return Ok(SensorConfig::preset(name)?);
    }
    if !path.exists() {
        let names: Vec<_> = PRESETS.iter().map(|preset| preset.name).collect();
        return Err(bad_input(format!(
            "--sensor {name}: neither a preset nor a file; presets are {}, or name a TOML file",
            names.join(", ")
        )));
    }
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read --sensor {name}"))?;
    SensorConfig::from_toml(&text).with_context(|| format!("--sensor {name}"))
}
