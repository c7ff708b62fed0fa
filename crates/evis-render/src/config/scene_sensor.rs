//! The sensors that a scene gives its cameras.

use std::collections::BTreeMap;

use evis_core::SensorConfig;
use evis_scene::Scene;
use evis_scene::model::{CameraSensor, SensorKind};

use crate::error::EngineError;

/// The sensors that the scene gives the cameras that are to be rendered, `names` (all, where there are none), by name: what
/// [`crate::RunConfig::sensors`] takes. A camera that it gives none is not among them, and thresholds of a single camera are
/// no part of its sensor.
///
/// # Errors
/// A sensor that cannot be used, named with its place in the scene.
pub fn scene_sensors(scene: &Scene, names: &[String]) -> Result<BTreeMap<String, SensorConfig>, EngineError> {
    let chosen = scene.cameras.iter().filter(|camera| names.is_empty() || names.contains(&camera.name));
    chosen
        .filter_map(|camera| Some((camera.name.clone(), camera.sensor.as_ref()?)))
        .map(|(name, sensor)| Ok((name, read(sensor)?)))
        .collect()
}

fn read(sensor: &CameraSensor) -> Result<SensorConfig, EngineError> {
    let read = match &sensor.kind {
        SensorKind::Preset(name) => SensorConfig::preset(name),
        SensorKind::Toml(text) => SensorConfig::from_toml_part(text),
    };
    read.map_err(|error| {
        EngineError::Config(evis_core::ConfigError {
            what: format!("{}: {}", sensor.place, error.what),
            ..error
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(cameras: &str) -> Scene {
        let wall = "[[primitives]]\nname = \"wall\"\nshape = \"box\"\nsize = [1, 1, 1]\nmaterial = \"white\"\n[[materials]]\nname = \"white\"\n";
        evis_scene::toml_scene::parse(&format!("{wall}{cameras}"), ".").unwrap()
    }

    const TWO: &str = "[[cameras]]\nname = \"a\"\nsensor = \"davis346\"\n[[cameras]]\nname = \"b\"\n";

    #[test]
    fn each_camera_brings_its_own_sensor() {
        let davis = SensorConfig::preset("davis346").unwrap();
        let none = scene("[[cameras]]\nname = \"a\"\n");
        assert!(scene_sensors(&none, &[]).unwrap().is_empty());
        let two = scene(TWO);
        assert_eq!(scene_sensors(&two, &["a".into()]).unwrap(), [("a".to_owned(), davis.clone())].into());
        assert!(scene_sensors(&two, &["b".into()]).unwrap().is_empty());
        let v2e = SensorConfig::preset("v2e").unwrap();
        let three = scene(&format!("{TWO}[[cameras]]\nname = \"c\"\nsensor = \"v2e\"\n"));
        let each = [("a".to_owned(), davis), ("c".to_owned(), v2e)];
        assert_eq!(scene_sensors(&three, &[]).unwrap(), each.into());
        let table = scene(
            "[[cameras]]\nname = \"a\"\n[cameras.sensor]\nthreshold_on = 0.31\nnoise = { shot_hz = 2 }\n",
        );
        let sensor = &scene_sensors(&table, &[]).unwrap()["a"];
        assert!(sensor.threshold_on == 0.31 && sensor.noise.shot_hz == 2.0);
    }

    #[test]
    fn a_sensor_that_cannot_be_is_named_with_its_place() {
        for (cameras, told) in [
            ("sensor = \"davis345\"", ["'a'", "sensor", "davis345", "davis346"]),
            ("sensor = { threshold_on = 0 }", ["'a'", "sensor", "threshold_on", "above 0"]),
            ("sensor = { threshold = 0.2 }", ["'a'", "sensor", "threshold", "unknown"]),
        ] {
            let scene = scene(&format!("[[cameras]]\nname = \"a\"\n{cameras}\n"));
            let error = scene_sensors(&scene, &[]).unwrap_err().to_string();
            assert!(told.iter().all(|word| error.contains(word)), "{error}");
        }
    }
}
