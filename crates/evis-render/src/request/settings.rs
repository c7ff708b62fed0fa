//! Settings files: the settings of a run as TOML, from `evis tune`, from a recording, or by hand.

use std::path::Path;

use evis_core::ConfigError;
use evis_core::format::hdf5::Recording;
use evis_core::limits::{Budget, read_file};
use evis_core::words::{line_of, of_serde};
use evis_scene::camera_motion::{CameraMotionSettings, DEFAULT_SPEED_PX_PER_S};
use evis_scene::{AppliedMotion, CameraMotion};
use serde::{Deserialize, Serialize};

use crate::config::RunConfig;
use crate::error::EngineError;

/// What a settings file holds.
#[derive(Clone, Debug, PartialEq)]
pub struct SettingsFile {
    /// Settings that are given, as keys of [`RunConfig`].
    run: toml::Table,
    /// The same, with defaults for what is not given.
    config: RunConfig,
    /// What recordings store beside it.
    recorded: RecordedScene,
}

/// How a recording's scene was opened, and for how long it was simulated; nothing in a file that `evis tune` wrote.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub struct RecordedScene {
    /// A built-in name, a path, or the name of a scene in Python.
    scene: Option<String>,
    /// [`evis_scene::source::Opening::animation`].
    pub animation: Option<String>,
    /// [`evis_scene::source::Opening::speed`].
    pub speed: Option<f64>,
    /// Seconds.
    pub duration_s: Option<f64>,
    camera_motion: Option<AppliedMotion>,
}

impl RecordedScene {
    /// Itself where `scene` is the recording's, by a name or a file of that name; else nothing: what was chosen for one scene
    /// says nothing of another.
    #[must_use]
    pub fn of(&self, scene: &str) -> Self {
        let name = |scene: &str| Path::new(scene).file_stem().map(std::ffi::OsStr::to_owned);
        let same = self.scene.as_deref().is_some_and(|recorded| name(recorded) == name(scene));
        if same { self.clone() } else { Self::default() }
    }

    /// `asked`, and where it says nothing, how the recording's cameras were moved.
    ///
    /// # Errors
    /// A motion that is none.
    pub fn camera_motion(&self, asked: CameraMotionSettings) -> Result<CameraMotionSettings, ConfigError> {
        let Some(applied) = &self.camera_motion else { return Ok(asked) };
        if asked.motion.is_some() || asked.speed_px_per_s.is_some() {
            return Ok(asked);
        }
        if applied.by_default {
            // It comes by itself again.
            let speed_px_per_s = applied.speed_px_per_s.filter(|speed| *speed != DEFAULT_SPEED_PX_PER_S);
            return Ok(CameraMotionSettings { speed_px_per_s, ..asked });
        }
        let motion: CameraMotion = applied.motion.parse().map_err(|reason: String| {
            let remedy = reason.trim_start_matches("it must be ");
            ConfigError::new("camera_motion", format!("'{}'", applied.motion), remedy)
        })?;
        Ok(CameraMotionSettings { motion: Some(motion), speed_px_per_s: applied.speed_px_per_s, ..asked })
    }

    /// What is taken from it, in words; `None` where nothing is.
    pub fn in_words(&self) -> Option<String> {
        let moved = self.camera_motion.as_ref().filter(|applied| !applied.by_default);
        let words = [
            self.animation.as_ref().map(|animation| format!("animation '{animation}'")),
            self.speed.filter(|speed| *speed != 1.0).map(|speed| format!("speed {speed}")),
            moved.map(|applied| format!("camera motion {}", applied.motion)),
            self.duration_s.map(|seconds| format!("{seconds} s")),
        ];
        let words: Vec<_> = words.into_iter().flatten().collect();
        (!words.is_empty()).then(|| words.join(", "))
    }
}

/// Keys of [`RunConfig`] that say how pixels are sampled.
const SAMPLING: [&str; 9] = [
    "method",
    "rate_hz",
    "adaptive_px",
    "rendered_tiles",
    "between",
    "antialias",
    "samples",
    "texture_taps",
    "shadows",
];

/// Keys beside `run` and `evis` that recordings store.
const BESIDE: [&str; 7] =
    ["scene", "speed", "animation", "environments", "duration_s", "packet_us", "camera_motion"];

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
        Self { run, config: config.clone(), recorded: RecordedScene::default() }
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
        let bytes = read_file(path, &Budget::default())
            .map_err(|source| EngineError::Read { path: path.into(), source })?;
        let source = path.display().to_string();
        let text = String::from_utf8(bytes).map_err(|_| no_settings(&source, "it is no text"))?;
        Ok(Self::parse(&text, &source)?)
    }

    /// From `text`; `source` names it in messages.
    ///
    /// # Errors
    /// As [`SettingsFile::read`].
    pub fn parse(text: &str, source: &str) -> Result<Self, ConfigError> {
        let refuse = |value: String, remedy: &str| ConfigError::new(source, value, remedy);
        let mut table: toml::Table = text.parse().map_err(|e: toml::de::Error| {
            let line =
                e.span().map_or_else(String::new, |span| format!("line {}: ", line_of(text, span.start)));
            no_settings(source, &format!("it is no TOML, {line}{}", of_serde(e.message())))
        })?;
        let Some(version) = table.get("evis").and_then(toml::Value::as_str) else {
            return Err(no_settings(source, "it has no key 'evis'"));
        };
        // Settings keep their meaning within a minor version.
        let minor = |version: &str| version.rsplit_once('.').map(|(minor, _)| minor.to_owned());
        if minor(version) != minor(env!("CARGO_PKG_VERSION")) {
            let remedy = concat!("made with version ", env!("CARGO_PKG_VERSION"), ": run `evis tune` again");
            return Err(refuse(format!("a settings file of version {version}"), remedy));
        }
        let unknown = |key: &&String| {
            key.as_str() != "evis" && key.as_str() != "run" && !BESIDE.contains(&key.as_str())
        };
        if let Some(key) = table.keys().find(unknown) {
            let told = format!("a settings file with the unknown key '{key}'");
            return Err(refuse(told, "without it: settings stand under [run]"));
        }
        let Some(toml::Value::Table(run)) = table.remove("run") else {
            return Err(no_settings(source, "it has no table [run]"));
        };
        let unusable = |e: toml::de::Error| {
            let told = format!("a settings file that cannot be used ({})", of_serde(e.message()));
            refuse(told, "keys and values as a recording stores them")
        };
        let config = RunConfig::deserialize(toml::Value::Table(run.clone())).map_err(unusable)?;
        let recorded = RecordedScene::deserialize(toml::Value::Table(table)).map_err(unusable)?;
        Ok(Self { run, config, recorded })
    }

    /// Whether it gives the key `key` of [`RunConfig`].
    pub fn gives(&self, key: &str) -> bool {
        self.run.contains_key(key)
    }

    /// The settings, with defaults for what the file does not give, and what a recording stores of its scene.
    pub fn into_parts(self) -> (RunConfig, RecordedScene) {
        (self.config, self.recorded)
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

/// The error of a file that holds no settings.
fn no_settings(source: &str, why: &str) -> ConfigError {
    ConfigError::new(source, format!("no settings file ({why})"), "as `evis tune` writes it, or a recording")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Antialias, Interpolation};

    fn tuned() -> RunConfig {
        RunConfig {
            adaptive_px: Some(0.4),
            between: Interpolation::Curve,
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
        let (config, recorded) = read.unwrap().into_parts();
        assert_eq!(config, RunConfig { seed: 0, ..tuned() });
        assert_eq!(recorded, RecordedScene::default());
    }

    #[test]
    fn what_is_no_settings_file_is_named_with_what_is_wrong() {
        let version = env!("CARGO_PKG_VERSION");
        for (text, wanted) in [
            ("\nnot = [toml".to_owned(), "it is no TOML, line 2: "),
            ("width = 3".to_owned(), "no key 'evis'"),
            ("evis = \"9.7.0\"\n[run]\n".to_owned(), "version 9.7.0"),
            (format!("evis = \"{version}\""), "no table [run]"),
            (format!("evis = \"{version}\"\nsample = 3\n[run]\n"), "key 'sample'"),
            (format!("evis = \"{version}\"\n[run]\nsample = 3\n"), "did you mean 'samples'"),
            (format!("evis = \"{version}\"\nspeed = \"fast\"\n[run]\n"), "fast"),
            (format!("evis = \"{version}\"\n[run]\nsamples = \"many\"\n"), "many"),
        ] {
            let error = SettingsFile::parse(&text, "x.toml").unwrap_err().to_string();
            assert!(error.contains(wanted) && error.contains("x.toml"), "{text}: {error}");
        }
        assert!(SettingsFile::parse(&format!("evis = \"{version}\"\n[run]\n"), "x.toml").is_ok());
        let path = std::env::temp_dir().join(format!("evis-no-settings-{}.toml", std::process::id()));
        std::fs::write(&path, [0x89, b'P', b'N', b'G', 0xff]).unwrap();
        let read = SettingsFile::read(&path);
        std::fs::remove_file(&path).unwrap();
        let error = read.unwrap_err();
        assert!(matches!(error, EngineError::Config(_)) && error.to_string().contains("no text"), "{error}");
    }

    #[test]
    fn what_was_chosen_for_a_recordings_scene_is_of_that_scene_alone() {
        let version = env!("CARGO_PKG_VERSION");
        let recorded = |motion: &str, speed: f64, by_default: bool| {
            let text = format!(
                "evis = \"{version}\"\nscene = \"models/Fox.glb\"\nspeed = 2.0\nanimation = \"Run\"\nduration_s = 0.5\n[run]\n\
                 [camera_motion]\nmotion = \"{motion}\"\nspeed_px_per_s = {speed:?}\nby_default = {by_default}\n\
                 description = \"\"\n"
            );
            SettingsFile::parse(&text, "x.h5").unwrap().into_parts().1
        };
        let moved = recorded("orbit", 50.0, false);
        for same in ["models/Fox.glb", "elsewhere/Fox.glb", "Fox"] {
            assert_eq!(moved.of(same), moved, "{same}");
        }
        for other in ["models/Wolf.glb", "spinner", "models"] {
            assert_eq!(moved.of(other), RecordedScene::default(), "{other}");
        }
        assert_eq!(moved.in_words().as_deref(), Some("animation 'Run', speed 2, camera motion orbit, 0.5 s"));
        assert_eq!(RecordedScene::default().in_words(), None);

        let nothing = CameraMotionSettings { size: Some((64, 48)), ..CameraMotionSettings::default() };
        let again = moved.camera_motion(nothing.clone()).unwrap();
        assert_eq!((again.motion, again.speed_px_per_s), (Some(CameraMotion::Orbit), Some(50.0)));
        assert_eq!(again.size, nothing.size);
        let shaken = CameraMotionSettings { motion: Some(CameraMotion::Shake), ..nothing.clone() };
        assert_eq!(moved.camera_motion(shaken.clone()).unwrap(), shaken, "what is asked for stands over it");
        let by_default =
            |speed| recorded("orbit", speed, true).camera_motion(nothing.clone()).unwrap().speed_px_per_s;
        assert_eq!((by_default(DEFAULT_SPEED_PX_PER_S), by_default(50.0)), (None, Some(50.0)));
        let error = recorded("orbt", 50.0, false).camera_motion(nothing).unwrap_err().to_string();
        assert!(error.contains("did you mean 'orbit'"), "{error}");
    }
}
