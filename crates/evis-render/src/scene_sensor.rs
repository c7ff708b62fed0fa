//! The sensor that a scene gives its cameras.

use evis_core::SensorConfig;
use evis_scene::Scene;
use evis_scene::model::{CameraSensor, SensorKind};

use crate::error::EngineError;

/// The sensor of the cameras that are to be rendered, `names` (all, where there are none), as the scene gives it; `None`
/// where it leaves it to the run. Thresholds of a single camera are no part of it.
///
/// # Errors
/// A sensor that cannot be used, named with its place in the scene; cameras of different sensors, of which one simulator has
/// one.
pub fn scene_sensor(scene: &Scene, names: &[String]) -> Result<Option<SensorConfig>, EngineError> {
    let chosen = scene.cameras.iter().filter(|camera| names.is_empty() || names.contains(&camera.name));
    let mut first: Option<(&str, Option<SensorConfig>)> = None;
    for camera in chosen {
        let sensor = camera.sensor.as_ref().map(read).transpose()?;
        match &first {
            None => first = Some((&camera.name, sensor)),
            Some((name, other)) if *other != sensor => {
                let text = format!(
                    "cameras '{name}' and '{}' have different sensors, and one run has one: choose one of them, or give \
                     a sensor for both",
                    camera.name
                );
                return Err(evis_scene::SceneError::Rule(text).into());
            }
            Some(_) => {}
        }
    }
    Ok(first.and_then(|(_, sensor)| sensor))
}

fn read(sensor: &CameraSensor) -> Result<SensorConfig, EngineError> {
    let read = match &sensor.kind {
        SensorKind::Preset(name) => SensorConfig::preset(name),
        SensorKind::Toml(text) => SensorConfig::from_toml(text),
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
    fn cameras_bring_their_sensor() {
        let none = scene("[[cameras]]\nname = \"a\"\n");
        assert!(scene_sensor(&none, &[]).unwrap().is_none());
        let two = scene(TWO);
        assert_eq!(
            scene_sensor(&two, &["a".into()]).unwrap(),
            Some(SensorConfig::preset("davis346").unwrap())
        );
        assert!(scene_sensor(&two, &["b".into()]).unwrap().is_none());
        let error = scene_sensor(&two, &[]).unwrap_err().to_string();
        assert!(error.contains("'a'") && error.contains("'b'") && error.contains("one"), "{error}");
        let table = scene(
            "[[cameras]]\nname = \"a\"\n[cameras.sensor]\nthreshold_on = 0.31\nnoise = { shot_hz = 2 }\n",
        );
        let sensor = scene_sensor(&table, &[]).unwrap().unwrap();
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
            let error = scene_sensor(&scene, &[]).unwrap_err().to_string();
            assert!(told.iter().all(|word| error.contains(word)), "{error}");
        }
    }
}
