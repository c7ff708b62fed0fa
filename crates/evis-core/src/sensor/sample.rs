//! Sensors drawn at random within ranges, for training.

use serde_json::Value;

use super::{ConfigError, Sensor, SensorConfig};
use crate::random::{Key, StreamId, unit};

/// `base` with every value that `ranges` names drawn uniformly between two ends, or by `seed` from a list.
///
/// `ranges` is an object whose keys are paths such as `"threshold_on"` or `"noise.leak_hz"`, and whose values are
/// `[low, high]` of numbers, or a list under `{"choices": […]}`. A value depends on its own path and `seed` only, so that
/// another range does not change it.
///
/// # Errors
/// A path that the sensor does not have, ends that are no numbers or in the wrong order, a sensor that cannot be. A value
/// that the sensor does not use: one with `diffusion` has no thresholds.
pub fn sample(base: &SensorConfig, ranges: &Value, seed: u64) -> Result<SensorConfig, ConfigError> {
    let refuse =
        |what: &str, value: &dyn std::fmt::Display, remedy: &str| ConfigError::new(what, value, remedy);
    let Some(ranges) = ranges.as_object() else {
        return Err(refuse("ranges", ranges, "an object of paths and ranges"));
    };
    // Stages at their defaults are not written, so that every path is there only in a value that is spelled out.
    let mut tree = base.spelled_out()?;
    for (path, range) in ranges {
        let pointer = format!("/{}", path.replace('.', "/"));
        let Some(target) = tree.pointer_mut(&pointer) else {
            return Err(refuse("range", path, "the path of a sensor's value, such as noise.leak_hz"));
        };
        // FNV-1a of the path: where this value's draw lies.
        let place = path
            .bytes()
            .fold(0x811c_9dc5_u32, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193));
        let part = unit(Key::new(seed, 0, 0).draw(place, StreamId::Sample, 0, 0)[0]);
        let choices = range.get("choices").and_then(Value::as_array);
        *target = match (choices, range.as_array().map(Vec::as_slice)) {
            (Some(choices), _) if !choices.is_empty() => {
                let index = ((part * choices.len() as f64) as usize).min(choices.len() - 1);
                choices[index].clone()
            }
            (None, Some([low, high])) => {
                let ends = low.as_f64().zip(high.as_f64()).filter(|(low, high)| low <= high);
                let Some((low, high)) = ends else {
                    return Err(refuse(path, range, "two numbers, the lower one first"));
                };
                let drawn = low + part * (high - low);
                // A whole number stays one.
                if target.is_u64() { Value::from(drawn.round() as u64) } else { Value::from(drawn as f32) }
            }
            _ => return Err(refuse(path, range, "[low, high] or {\"choices\": [...]}")),
        };
    }
    let drawn: SensorConfig = serde_json::from_value(tree)
        .map_err(|error| refuse("ranges", &error, "of the types that the sensor's values have"))?;
    ranges.keys().try_for_each(|path| drawn.check_uses(path))?;
    Sensor::new(drawn.clone())?;
    Ok(drawn)
}

impl SensorConfig {
    /// Refuses the path of a value that makes no difference here: where `diffusion` takes the place of the thresholds.
    pub(super) fn check_uses(&self, path: &str) -> Result<(), ConfigError> {
        let stage = path.split('.').next().unwrap_or(path);
        let used = matches!(stage, "diffusion" | "exposure" | "readout" | "most_events" | "log_eps")
            || path == "refractory.period_us";
        if used || self.diffusion.is_none() {
            return Ok(());
        }
        let remedy = "a value that a sensor with diffusion uses: it has Brownian motion in place of thresholds, filter, \
                      pattern and noise; give diffusion.k1 to diffusion.k6, or a sensor without diffusion";
        Err(ConfigError::new("sensor value", format!("'{path}'"), remedy))
    }

    /// Every value, those at their defaults too.
    ///
    /// # Errors
    /// None that a user could cause.
    pub fn spelled_out(&self) -> Result<Value, ConfigError> {
        let broken = |error: serde_json::Error| ConfigError::new("sensor", error, "representable as JSON");
        let mut tree = serde_json::to_value(self).map_err(broken)?;
        if let Some(tree) = tree.as_object_mut() {
            for (name, stage) in [
                ("times", serde_json::to_value(self.times)),
                ("most_events", serde_json::to_value(self.most_events)),
                ("exposure", serde_json::to_value(&self.exposure)),
                ("photoreceptor", serde_json::to_value(self.photoreceptor)),
                ("pattern", serde_json::to_value(self.pattern)),
                ("noise", serde_json::to_value(self.noise)),
                ("refractory", serde_json::to_value(self.refractory)),
                ("readout", serde_json::to_value(self.readout)),
                ("diffusion", serde_json::to_value(self.diffusion)),
            ] {
                tree.insert(name.into(), stage.map_err(broken)?);
            }
        }
        shorten(&mut tree);
        Ok(tree)
    }
}

/// Gives numbers the decimals that a file would have: 0.2, and not what single precision makes of it.
fn shorten(value: &mut Value) {
    match value {
        Value::Object(fields) => fields.values_mut().for_each(shorten),
        Value::Number(number) if number.is_f64() => {
            let written = number.as_f64().and_then(|v| (v as f32).to_string().parse::<f64>().ok());
            if let Some(written) = written.and_then(serde_json::Number::from_f64) {
                *number = written;
            }
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_sample_lies_in_its_ranges_and_depends_on_its_seed() {
        let base = SensorConfig::default();
        let ranges = json!({
            "threshold_on": [0.05, 0.2], "noise.leak_hz": [0.0, 1.0], "refractory.period_us": [10, 1000],
            "photoreceptor.order": {"choices": [1, 2]},
        });
        let mut seen = Vec::new();
        for seed in 0..50 {
            let sensor = sample(&base, &ranges, seed).unwrap();
            assert!((0.05..=0.2).contains(&sensor.threshold_on));
            assert!((0.0..=1.0).contains(&sensor.noise.leak_hz));
            assert!((10..=1000).contains(&sensor.refractory.period_us));
            assert_eq!(sensor.threshold_off, base.threshold_off);
            assert_eq!(sample(&base, &ranges, seed).unwrap(), sensor);
            // One range less changes nothing else.
            let fewer = sample(&base, &json!({"threshold_on": [0.05, 0.2]}), seed).unwrap();
            assert_eq!(fewer.threshold_on, sensor.threshold_on);
            seen.push((sensor.threshold_on.to_bits(), sensor.photoreceptor.order));
        }
        assert!((1..=2).all(|order| seen.iter().any(|seen| seen.1 == order)));
        seen.sort_unstable();
        seen.dedup_by_key(|seen| seen.0);
        assert_eq!(seen.len(), 50);
        for bad in [
            json!({"noise.leek_hz": [0, 1]}),
            json!({"noise.leak_hz": [1, 0]}),
            json!({"noise.leak_hz": 3}),
            json!({"noise.leak_hz": [-2, -1]}),
            json!({"trigger": [0, 1]}),
            json!([1]),
        ] {
            assert!(sample(&base, &bad, 0).is_err(), "{bad}");
        }
    }

    #[test]
    fn ranges_of_what_a_sensor_with_diffusion_does_not_use_are_refused() {
        let base = SensorConfig::preset("davis346").unwrap();
        for used in ["diffusion.k1", "readout.latency_us", "refractory.period_us"] {
            let drawn = sample(&base, &json!({used: [1.0, 2.0]}), 3).unwrap();
            assert_ne!(drawn, base, "{used}");
        }
        for path in
            ["threshold_on", "threshold_off", "pattern.sigma", "noise.leak_hz", "photoreceptor.cutoff_hz"]
        {
            let ranges = json!({"diffusion.k1": [1.0, 2.0], path: [0.1, 0.2]});
            let error = sample(&base, &ranges, 3).unwrap_err().to_string();
            assert!(error.contains(path) && error.contains("diffusion.k1"), "{error}");
            assert!(
                sample(&SensorConfig::default(), &json!({path: [0.1, 0.2]}), 3).is_ok(),
                "canary: {path}"
            );
        }
    }
}
