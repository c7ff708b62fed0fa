//! Settings files: the settings of a run as TOML, from `evis tune`, from a recording, or by hand.

use std::path::Path;

use evis_core::ConfigError;
use evis_core::format::hdf5::Recording;
use serde::{Deserialize, Serialize};

use crate::config::RunConfig;
use crate::error::EngineError;

/// What a settings file holds. Recordings store more beside it: which scene, how long, which device.
#[derive(Clone, Debug, PartialEq)]
pub struct SettingsFile {
    /// Settings that are given, as keys of [`RunConfig`].
    run: toml::Table,
    /// The same, with defaults for what is not given.
    config: RunConfig,
}

/// Keys of [`RunConfig`] that say how pixels are sampled.
const SAMPLING: [&str; 8] =
    ["method", "rate_hz", "adaptive_px", "between", "antialias", "samples", "texture_taps", "shadows"];

/// Keys beside `run` and `evis` that recordings store.
const BESIDE: [&str; 6] = ["scene", "speed", "environments", "duration_s", "packet_us", "camera_motion"];

/// The file as it is written.
#[derive(Serialize, Deserialize)]
struct Written {
    evis: String,
    run: toml::Table,
}

impl SettingsFile {
    /// The sampling of `config`, and nothing else.
    pub fn sampling(config: &RunConfig) -> Self {
        let mut run = toml::Table::try_from(config).unwrap_or_default();
        run.retain(|key, _| SAMPLING.contains(&key));
        Self { run, config: config.clone() }
    }

    /// Reads the settings in `path`: those that a recording (.h5, .hdf5) stores, or a file as [`SettingsFile::read`] does.
    ///
    /// # Errors
    /// As [`SettingsFile::read`]; a recording that cannot be read.
    pub fn open(path: &Path) -> Result<Self, EngineError> {
        let is_recording =
            |ending: &std::ffi::OsStr| ["h5", "hdf5"].iter().any(|known| ending.eq_ignore_ascii_case(known));
        if path.extension().is_some_and(is_recording) {
            let recording = Recording::open(path)?;
            return Ok(Self::parse(&recording.header().config_toml, &path.display().to_string())?);
        }
        Self::read(path)
    }

    /// Reads a file that [`SettingsFile::write`] wrote, or the settings that a recording stores.
    ///
    /// # Errors
    /// A file that cannot be read, is no settings file, was written by another version, or has unknown keys or values.
    pub fn read(path: &Path) -> Result<Self, EngineError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| EngineError::Read { path: path.into(), source })?;
        Ok(Self::parse(&text, &path.display().to_string())?)
    }

    /// From `text`; `source` names it in messages.
    ///
    /// # Errors
    /// As [`SettingsFile::read`].
    pub fn parse(text: &str, source: &str) -> Result<Self, ConfigError> {
        let refuse =
            |value: String, remedy: &str| ConfigError::new(&format!("settings file {source}"), value, remedy);
        let table: toml::Table = text
            .parse()
            .map_err(|e: toml::de::Error| refuse(e.message().to_owned(), "TOML, as `evis tune` writes it"))?;
        let Some(version) = table.get("evis").and_then(toml::Value::as_str) else {
            return Err(refuse("no key `evis`".into(), "a settings file, as `evis tune` writes it"));
        };
        // Settings keep their meaning within a minor version.
        let minor = |version: &str| version.rsplit_once('.').map(|(minor, _)| minor.to_owned());
        if minor(version) != minor(env!("CARGO_PKG_VERSION")) {
            let remedy = concat!("made with version ", env!("CARGO_PKG_VERSION"), ": run `evis tune` again");
            return Err(refuse(format!("version {version}"), remedy));
        }
        let unknown = |key: &&String| {
            key.as_str() != "evis" && key.as_str() != "run" && !BESIDE.contains(&key.as_str())
        };
        if let Some(key) = table.keys().find(unknown) {
            return Err(refuse(format!("key `{key}`"), "without it: settings stand under `[run]`"));
        }
        let Some(run) = table.get("run").and_then(toml::Value::as_table) else {
            return Err(refuse("no table `[run]`".into(), "a settings file, as `evis tune` writes it"));
        };
        let config = RunConfig::deserialize(toml::Value::Table(run.clone()))
            .map_err(|e| refuse(e.message().to_owned(), "keys and values as a recording stores them"))?;
        Ok(Self { run: run.clone(), config })
    }

    /// Whether it gives the key `key` of [`RunConfig`].
    pub fn gives(&self, key: &str) -> bool {
        self.run.contains_key(key)
    }

    /// The settings, with defaults for what the file does not give.
    pub fn into_config(self) -> RunConfig {
        self.config
    }

    /// Writes it, with `comment` before it.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn write(&self, path: &Path, comment: &str) -> Result<(), EngineError> {
        let written = Written { evis: env!("CARGO_PKG_VERSION").into(), run: self.run.clone() };
        let lines: String = comment.lines().map(|line| format!("# {line}\n")).collect();
        let text = toml::to_string_pretty(&written)
            .map_err(|e| EngineError::Device(format!("settings cannot be written as TOML: {e}")))?;
        evis_core::limits::write_whole(path, (lines + &text).as_bytes())
            .map_err(|source| EngineError::Write { path: path.into(), source })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Antialias, Between};

    fn tuned() -> RunConfig {
        RunConfig {
            adaptive_px: Some(0.4),
            between: Between::Curve,
            antialias: Antialias::Edges,
            samples: 64,
            rate_hz: 4000.0,
            seed: 7,
            ..RunConfig::default()
        }
    }

    #[test]
    fn sampling_is_read_as_it_was_written_and_nothing_else_is() {
        let path = std::env::temp_dir().join(format!("evis-settings-{}.toml", std::process::id()));
        SettingsFile::sampling(&tuned()).write(&path, "two\nlines").unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let read = SettingsFile::read(&path);
        std::fs::remove_file(&path).unwrap();
        assert!(text.starts_with("# two\n# lines\n"), "{text}");
        assert_eq!(read.unwrap().into_config(), RunConfig { seed: 0, ..tuned() });
    }

    #[test]
    fn what_is_no_settings_file_is_named_with_what_is_wrong() {
        let version = env!("CARGO_PKG_VERSION");
        for (text, wanted) in [
            ("not = [toml".to_owned(), "TOML"),
            ("width = 3".to_owned(), "no key `evis`"),
            ("evis = \"9.7.0\"\n[run]\n".to_owned(), "version 9.7.0"),
            (format!("evis = \"{version}\""), "no table `[run]`"),
            (format!("evis = \"{version}\"\nsample = 3\n[run]\n"), "key `sample`"),
            (format!("evis = \"{version}\"\n[run]\nsample = 3\n"), "sample"),
            (format!("evis = \"{version}\"\n[run]\nsamples = \"many\"\n"), "many"),
        ] {
            let error = SettingsFile::parse(&text, "x.toml").unwrap_err().to_string();
            assert!(error.contains(wanted) && error.contains("x.toml"), "{text}: {error}");
        }
        assert!(SettingsFile::parse(&format!("evis = \"{version}\"\n[run]\n"), "x.toml").is_ok());
    }
}
