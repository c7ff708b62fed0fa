//! The methods that the suite asks: a table of named settings.

use evis_core::{ConfigError, TriggerRule, Warp};
use evis_render::{Antialias, Quality};
use serde::{Deserialize, Serialize};

use crate::ladder::Setting;

/// Samples per pixel where edges and textures are not what is asked about.
const SAMPLES: u32 = 16;

/// A setting, and the name by which limits and tables know it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NamedMethod {
    /// Unique, short.
    pub name: String,
    /// What runs.
    pub setting: Setting,
}

impl NamedMethod {
    /// `setting`, called `name`.
    pub fn new(name: impl Into<String>, setting: Setting) -> Self {
        Self { name: name.into(), setting }
    }

    /// The method called `name`.
    ///
    /// # Errors
    /// Lists the methods that exist.
    pub fn named(name: &str) -> Result<Self, ConfigError> {
        let all = methods();
        let known: Vec<_> = all.iter().map(|m| m.name.clone()).collect();
        all.into_iter()
            .find(|m| m.name == name)
            .ok_or_else(|| ConfigError::new("method", name, format!("one of {}", known.join(", "))))
    }

    /// The same with `keyframe_hz` keyframes per second and about as many instants; a method without keyframes stays as it is.
    pub(super) fn with_keyframes(&self, keyframe_hz: f64) -> Self {
        let Some(splat) = self.setting.splat else { return self.clone() };
        let steps = (self.setting.rate_hz / keyframe_hz).round().max(1.0) as u32;
        let splat = splat.at(keyframe_hz, steps);
        let setting = Setting {
            splat: Some(splat),
            rate_hz: keyframe_hz * f64::from(steps),
            rendered_hz: keyframe_hz,
            ..self.setting.clone()
        };
        Self { setting, ..self.clone() }
    }

    /// Keyframes per second; those of the others where it has none, so that the same windows are compared.
    pub(super) fn keyframe_hz(&self) -> f64 {
        self.setting.splat.map_or(KEYFRAME_HZ, |splat| splat.scene_keyframe_hz())
    }
}

/// Keyframes per second of every method that has them.
const KEYFRAME_HZ: f64 = 125.0;

/// Every method that exists, in the order of the table's columns.
pub fn methods() -> Vec<NamedMethod> {
    let crossing = TriggerRule::Crossing;
    let native = |samples| Setting::native(1000.0, samples, Antialias::Samples, crossing);
    let splat = Warp::default().at(KEYFRAME_HZ, 8);
    let paper = Warp::evis_paper(8).at(KEYFRAME_HZ, 8);
    vec![
        NamedMethod::new("native", native(SAMPLES)),
        NamedMethod::new("high", Setting::quality(Quality::High)),
        NamedMethod::new("splat", Setting::splat(splat, SAMPLES, crossing)),
        NamedMethod::new("no-aa", native(1)),
        NamedMethod::new("evis-paper", Setting::splat(paper, 4, TriggerRule::Latch)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_the_engine_has_every_method() {
        let all = methods();
        for (i, method) in all.iter().enumerate() {
            assert!(method.setting.engine_method().is_some(), "{method:?}");
            assert!(all[..i].iter().all(|m| m.name != method.name), "{method:?}");
            assert_eq!(NamedMethod::named(&method.name).unwrap(), *method);
        }
        let error = NamedMethod::named("teleport").unwrap_err().to_string();
        assert!(error.contains("teleport") && error.contains("evis-paper"), "{error}");
    }

    #[test]
    fn other_keyframes_keep_the_rate_of_instants() {
        let splat = NamedMethod::named("splat").unwrap().with_keyframes(30.0);
        let inner = splat.setting.splat.unwrap();
        assert_eq!((inner.scene_keyframe_hz(), inner.scene_steps(), splat.keyframe_hz()), (30.0, 33, 30.0));
        assert_eq!((splat.setting.rate_hz, splat.setting.rendered_hz), (990.0, 30.0));
        let native = NamedMethod::named("native").unwrap();
        assert_eq!(native.with_keyframes(30.0), native);
    }
}
