//! Sensors as text: TOML files, and single settings `key=value`.

use serde_json::Value;
use toml::de::DeTable;

use super::{ConfigError, Sensor, SensorConfig};
use crate::words::{did_you_mean, line_of, of_serde};

/// What a text of a sensor must be.
const REMEDY: &str = "as docs/sensor-keys.md shows";

impl SensorConfig {
    /// Reads the TOML of a sensor. The key `base` names the preset that has what the text does not say; the ideal sensor
    /// where there is none.
    ///
    /// # Errors
    /// Text that is no TOML, a base that is no preset, an unknown key, a value that cannot be used; each with its line.
    pub fn from_toml(text: &str) -> Result<Self, ConfigError> {
        read(text, true)
    }

    /// The same of a part of a larger file, whose lines are others: messages leave them out.
    ///
    /// # Errors
    /// As [`Self::from_toml`].
    pub fn from_toml_part(text: &str) -> Result<Self, ConfigError> {
        read(text, false)
    }

    /// The sensor as TOML; [`Self::from_toml`] gives it back.
    pub fn to_toml(&self) -> String {
        // Plain numbers, names and tables: TOML has them all.
        toml::to_string(self).unwrap_or_default()
    }

    /// Sets a value of the sensor: `noise.shot_hz=1`, `trigger=latch`. What it then is, [`Sensor::new`] checks.
    ///
    /// # Errors
    /// An assignment without a key or value, a key that no sensor has, a value of another kind, or one that the sensor does
    /// not use: one with `diffusion` has no thresholds.
    pub fn set(&mut self, assignment: &str) -> Result<(), ConfigError> {
        let refuse = |remedy: String| ConfigError::new("set", format!("'{assignment}'"), remedy);
        let Some((key, text)) = assignment.split_once('=').map(|(key, text)| (key.trim(), text.trim()))
        else {
            return Err(refuse("KEY=VALUE, such as noise.shot_hz=1".into()));
        };
        let mut tree = self.spelled_out()?;
        let mut place = &mut tree;
        for part in key.split('.') {
            if !place.get(part).is_some_and(|_| place.is_object()) {
                let keys = keys(&self.spelled_out()?);
                // A key is also found by its last part alone.
                let last = |key: &str| key.rsplit('.').next().unwrap_or_default().to_owned();
                let near = keys.iter().find(|known| last(known) == last(key));
                let hint = match near {
                    Some(near) => format!(" (did you mean '{near}'?)"),
                    None => did_you_mean(key, keys.iter().map(String::as_str)),
                };
                return Err(refuse(format!("a key that docs/sensor-keys.md lists{hint}")));
            }
            place = &mut place[part];
        }
        if place.is_object() {
            return Err(refuse(format!(
                "a value of {key}, such as {}=...",
                keys_below(key, place).join("=..., ")
            )));
        }
        *place = value(text);
        let changed: Self = serde_json::from_value(tree).map_err(|error| {
            let told = of_serde(&error.to_string());
            refuse(format!("a value of the kind that {key} has ({told})"))
        })?;
        changed.check_uses(key)?;
        *self = changed;
        Ok(())
    }
}

/// The value that `text` writes: a number, true or false, else a word.
fn value(text: &str) -> Value {
    let word = || Value::String(text.trim_matches(['"', '\'']).to_owned());
    match serde_json::from_str::<Value>(text) {
        Ok(value @ (Value::Number(_) | Value::Bool(_))) => value,
        _ => word(),
    }
}

/// Every key of a sensor, dotted.
fn keys(tree: &Value) -> Vec<String> {
    let Value::Object(fields) = tree else { return Vec::new() };
    let below = |(key, value): (&String, &Value)| match value {
        Value::Object(_) => keys_below(key, value),
        _ => vec![key.clone()],
    };
    fields.iter().flat_map(below).collect()
}

fn keys_below(key: &str, tree: &Value) -> Vec<String> {
    keys(tree).into_iter().map(|below| format!("{key}.{below}")).collect()
}

fn read(text: &str, with_lines: bool) -> Result<SensorConfig, ConfigError> {
    let refuse = |line: Option<usize>, told: String| {
        let line = line.filter(|_| with_lines).map_or_else(String::new, |line| format!("line {line}: "));
        ConfigError::new("the sensor's TOML", format!("not usable ({line}{told})"), REMEDY)
    };
    let of_toml = |error: &toml::de::Error, source: &str| {
        refuse(error.span().map(|span| line_of(source, span.start)), of_serde(error.message()))
    };
    let mut table: toml::Table = text.parse().map_err(|error| of_toml(&error, text))?;
    // What no sensor can have is named with the line that says it, where the text does and not its base.
    let checked = |config: SensorConfig| match Sensor::new(config) {
        Ok(sensor) => Ok(sensor.config().clone()),
        Err(error) if with_lines => Err(match line_of_key(text, &error.what) {
            Some(line) => {
                ConfigError::new(&format!("line {line}: {}", error.what), error.value, error.remedy)
            }
            None => error,
        }),
        Err(error) => Err(error),
    };
    let Some(base) = table.remove("base") else {
        return checked(toml::from_str(text).map_err(|error| of_toml(&error, text))?);
    };
    // Without the line of the base the text has its lines still, and names what is wrong in them.
    let mut before_tables = true;
    let rest: String = text
        .split_inclusive('\n')
        .map(|line| {
            before_tables &= !line.trim_start().starts_with('[');
            let is_base =
                line.trim_start().strip_prefix("base").is_some_and(|l| l.trim_start().starts_with('='));
            if before_tables && is_base { "\n" } else { line }
        })
        .collect();
    toml::from_str::<SensorConfig>(&rest).map_err(|error| of_toml(&error, &rest))?;
    let line = text.lines().position(|line| line.trim_start().starts_with("base")).map(|index| index + 1);
    let Some(name) = base.as_str() else {
        return Err(refuse(line, format!("base is {base}, and no name of a preset")));
    };
    let base = SensorConfig::preset(name).map_err(|error| refuse(line, format!("base: {error}")))?;
    let mut tree = base.spelled_out()?;
    let given = serde_json::to_value(&table).map_err(|error| refuse(None, error.to_string()))?;
    merge(&mut tree, given);
    let config: SensorConfig =
        serde_json::from_value(tree).map_err(|error| refuse(None, of_serde(&error.to_string())))?;
    checked(config)
}

/// The line of `text`, TOML, in which the dotted `key` gets its value.
fn line_of_key(text: &str, key: &str) -> Option<usize> {
    let root = DeTable::parse(text).ok()?;
    let mut table = root.get_ref();
    let mut parts = key.split('.').peekable();
    while let Some(part) = parts.next() {
        let (key, value) = table.iter().find(|(key, _)| key.get_ref() == part)?;
        if parts.peek().is_none() {
            return Some(line_of(text, key.span().start));
        }
        table = value.get_ref().as_table()?;
    }
    None
}

/// Puts the values of `given` over those of `tree`.
fn merge(tree: &mut Value, given: Value) {
    match (tree, given) {
        (Value::Object(tree), Value::Object(given)) => {
            for (key, value) in given {
                merge(tree.entry(key).or_insert(Value::Null), value);
            }
        }
        (tree, given) => *tree = given,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_base_has_what_the_text_does_not_say() {
        let text = "# mine\nbase = \"v2e\"\nthreshold_on = 0.3\n[noise]\nshot_hz = 2\n";
        let sensor = SensorConfig::from_toml(text).unwrap();
        let mut wanted = SensorConfig::preset("v2e").unwrap();
        (wanted.threshold_on, wanted.noise.shot_hz) = (0.3, 2.0);
        assert_eq!(sensor, wanted);
        assert_ne!(sensor.noise, SensorConfig::from_toml("[noise]\nshot_hz = 2\n").unwrap().noise, "canary");
        let diffusion = SensorConfig::from_toml("base = \"davis346\"\nlog_eps = 0.01\n").unwrap();
        assert!(diffusion.diffusion.is_some());
        let error = SensorConfig::from_toml("base = \"v2f\"").unwrap_err().to_string();
        assert!(error.contains("line 1") && error.contains("did you mean 'v2e'"), "{error}");
        assert!(SensorConfig::from_toml("base = 3").is_err());
    }

    #[test]
    fn what_is_wrong_has_its_line_and_the_nearest_key() {
        for (text, wanted) in [
            ("threshold_on = 0.2\n[noise]\nleek_hz = 1\n", ["line 3", "did you mean 'leak_hz'"]),
            ("base = \"v2e\"\n[noise]\nleek_hz = 1\n", ["line 3", "did you mean 'leak_hz'"]),
            ("threshold_on = \"high\"\n", ["line 1", "invalid type"]),
            ("threshold_on = \n", ["line 1", "not usable"]),
            ("[noise]\n\n[refractory]\nrule = \"wait\"\n", ["line 4", "hold"]),
            ("threshold_on = \"high\"\n", ["line 1", "expected a number"]),
            ("threshold_off = 0.2\nthreshold_on = -1\n", ["line 2: threshold_on is -1", "above 0"]),
            ("base = \"v2e\"\n[noise]\nleak_hz = -1\n", ["line 3: noise.leak_hz is -1", "must be"]),
            ("noise = { leak_hz = 1,\n shot_hz = -2 }\n", ["line 2: noise.shot_hz is -2", "must be"]),
        ] {
            let error = SensorConfig::from_toml(text).unwrap_err().to_string();
            assert!(wanted.iter().all(|word| error.contains(word)), "{text}: {error}");
            let part = SensorConfig::from_toml_part(text).unwrap_err().to_string();
            assert!(!part.contains("line "), "{part}");
        }
    }

    #[test]
    fn single_values_are_set_by_their_keys() {
        let mut sensor = SensorConfig::preset("v2e").unwrap();
        for assignment in
            ["noise.shot_hz=1", " threshold_on = 0.25", "trigger=latch", "noise.shot_per_threshold=false"]
        {
            sensor.set(assignment).unwrap();
        }
        let mut wanted = SensorConfig::preset("v2e").unwrap();
        (wanted.noise.shot_hz, wanted.noise.shot_per_threshold) = (1.0, false);
        (wanted.threshold_on, wanted.trigger) = (0.25, crate::TriggerRule::Latch);
        assert_eq!(sensor, wanted);
        for (assignment, told) in [
            ("noise.shot_rate_hz=1", "did you mean 'noise.shot_hz'"),
            ("shot_hz=1", "did you mean 'noise.shot_hz'"),
            ("noise=1", "noise.leak_hz"),
            ("noise.shot_hz", "KEY=VALUE"),
            ("noise.shot_hz=many", "many"),
            ("trigger=lazy", "crossing"),
        ] {
            let error = sensor.set(assignment).unwrap_err().to_string();
            assert!(error.contains(told) && error.contains(assignment), "{assignment}: {error}");
        }
        assert_eq!(sensor, wanted, "a refused value changes nothing");
        let mut diffusion = SensorConfig::preset("davis346").unwrap();
        let error = diffusion.set("threshold_on=0.3").unwrap_err().to_string();
        assert!(error.contains("threshold_on") && error.contains("diffusion.k1"), "{error}");
        assert_eq!(diffusion, SensorConfig::preset("davis346").unwrap());
        diffusion.set("diffusion.k1=6").unwrap();
    }
}
