//! When frames were taken.

use std::path::Path;

use evis_core::ConfigError;
use evis_core::format::FormatError;

use crate::error::VideoError;

/// Longest stream: 31 days, the most that a recording holds.
const LATEST_US: f64 = 31.0 * 86_400.0 * 1e6;

/// Where the times of frames come from.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Clock {
    /// What the source says: a film's own times, or a folder's `timestamps.txt` (default).
    #[default]
    Source,
    /// So many frames per second, whatever the source says.
    Rate(f64),
    /// A list, read from a file by [`read_times`].
    List(Times),
}

impl Clock {
    /// So many frames per second.
    ///
    /// # Errors
    /// A rate that is not above 0, or above 1 MHz.
    pub fn rate(fps: f64) -> Result<Self, ConfigError> {
        if fps > 0.0 && fps <= 1e6 {
            return Ok(Self::Rate(fps));
        }
        Err(ConfigError::new("fps", fps, "above 0 and at most 1000000 frames per second"))
    }
}

/// Times of frames, and their names where the file has them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Times {
    /// Microseconds.
    pub micros: Vec<i64>,
    /// A name per time, or none at all.
    pub names: Vec<String>,
}

/// Microseconds of frame `index` at this rate, on an absolute grid.
pub(crate) fn on_grid(index: u64, fps: f64) -> i64 {
    (index as f64 * 1e6 / fps).round() as i64
}

/// What a number of a file counts.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Unit {
    Seconds,
    Millis,
    Micros,
    Nanos,
}

impl Unit {
    fn of(word: &str) -> Option<Self> {
        Some(match word {
            "s" | "sec" | "second" | "seconds" => Self::Seconds,
            "ms" | "millisecond" | "milliseconds" => Self::Millis,
            "us" | "µs" | "microsecond" | "microseconds" => Self::Micros,
            "ns" | "nanosecond" | "nanoseconds" => Self::Nanos,
            _ => return None,
        })
    }

    /// Microseconds of `text`. Whole numbers stay whole: as floating point, a date in nanoseconds would lose some.
    fn micros(self, text: &str) -> Option<i64> {
        if let Ok(whole) = text.parse::<i64>() {
            return match self {
                Self::Seconds => whole.checked_mul(1_000_000),
                Self::Millis => whole.checked_mul(1000),
                Self::Micros => Some(whole),
                Self::Nanos => Some(whole.div_euclid(1000) + i64::from(whole.rem_euclid(1000) >= 500)),
            };
        }
        let value = match self {
            // A date in seconds with six decimals has more digits than a float: its parts have not.
            Self::Seconds => return seconds(text),
            Self::Millis => text.parse::<f64>().ok()? * 1e3,
            Self::Micros => text.parse::<f64>().ok()?,
            Self::Nanos => text.parse::<f64>().ok()? * 1e-3,
        };
        (value.abs() < 9e18).then(|| value.round() as i64)
    }
}

/// `1700000000.123456` in microseconds, exactly.
fn seconds(text: &str) -> Option<i64> {
    if let Some((whole, part)) = text.split_once('.')
        && !part.is_empty()
        && part.bytes().all(|digit| digit.is_ascii_digit())
        && let Ok(whole) = whole.parse::<u32>()
    {
        let micros = (format!("0.{part}").parse::<f64>().ok()? * 1e6).round() as i64;
        return Some(i64::from(whole) * 1_000_000 + micros);
    }
    let value = text.parse::<f64>().ok()? * 1e6;
    (value.abs() < 9e18).then(|| value.round() as i64)
}

/// Reads a list of times: a line per frame, `time` or `name time`; empty lines and those that begin with `#` are
/// skipped, but `# unit: us` (or s, ms, ns) says what the numbers count. Without it, numbers with a decimal point are
/// seconds.
///
/// # Errors
/// A file that cannot be read, a line that is no time, whole numbers without a unit.
pub fn read_times(path: &Path) -> Result<Times, VideoError> {
    let text = evis_core::limits::read_text(path, &evis_core::limits::Budget::default())
        .map_err(|error| FormatError::io(path, "read", error))?;
    let refuse = |line: usize, what: String, remedy: &str| {
        VideoError::from(FormatError::corrupt(path, format!("line {}: {what}", line + 1), remedy))
    };
    const FORM: &str =
        "write one time per frame and line, such as 0.033333 (seconds), or 33333 below a line `# unit: us`";
    let mut unit = None;
    let mut times = Times::default();
    for (number, line) in text.lines().enumerate() {
        let line = line.trim_start_matches('\u{feff}').trim();
        if let Some(said) = line.strip_prefix('#') {
            let said = said.trim();
            let word = said
                .strip_prefix("unit")
                .map_or(said, |rest| rest.trim().trim_start_matches([':', '=']).trim());
            if let Some(found) = Unit::of(word) {
                unit = Some(found);
            } else if said.starts_with("unit") {
                return Err(refuse(number, format!("unit '{word}' is unknown"), "use s, ms, us or ns"));
            }
            continue;
        }
        if line.is_empty() {
            continue;
        }
        let words: Vec<_> = line.split([' ', '\t', ',', ';']).filter(|word| !word.is_empty()).collect();
        let (name, time) = match words.as_slice() {
            [time] => (None, *time),
            [name, time] => (Some(*name), *time),
            _ => return Err(refuse(number, format!("'{line}' is no time"), FORM)),
        };
        if time.parse::<f64>().is_ok_and(f64::is_finite)
            && unit.is_none()
            && !time.contains('.')
            && time != "0"
        {
            let what = format!("'{time}' has no unit");
            return Err(refuse(number, what, "begin the file with a line `# unit: us` (or s, ms, ns)"));
        }
        let micros = time.parse::<f64>().ok().filter(|value| value.is_finite());
        let micros = micros.and_then(|_| unit.unwrap_or(Unit::Seconds).micros(time));
        let Some(micros) = micros else {
            return Err(refuse(number, format!("'{line}' is no time"), FORM));
        };
        if let Some(last) = times.micros.last()
            && micros <= *last
        {
            let what = format!("frame {} at {micros} us does not come after {last} us", times.micros.len());
            return Err(refuse(number, what, "times must increase; sort the lines, or remove repeated ones"));
        }
        if let Some(first) = times.micros.first()
            && micros.saturating_sub(*first) as f64 > LATEST_US
        {
            let what = format!("'{time}' lies more than 31 days after the first time");
            return Err(refuse(number, what, "check the unit: `# unit: us` (or s, ms, ns)"));
        }
        times.micros.push(micros);
        if let Some(name) = name {
            times.names.push(name.into());
        }
    }
    if !times.names.is_empty() && times.names.len() != times.micros.len() {
        let (names, count) = (times.names.len(), times.micros.len());
        let what = format!("{names} of {count} lines have a name");
        return Err(FormatError::corrupt(path, what, "name every frame, or none").into());
    }
    if times.micros.is_empty() {
        return Err(FormatError::corrupt(path, "it has no times", FORM).into());
    }
    Ok(times)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(name: &str, text: &str) -> Result<Times, String> {
        let path = std::env::temp_dir().join(format!("evis-times-{}-{name}.txt", std::process::id()));
        std::fs::write(&path, text).unwrap();
        let read = read_times(&path).map_err(|error| error.to_string());
        std::fs::remove_file(&path).unwrap();
        read
    }

    #[test]
    fn units_are_stated_or_seconds_with_a_point() {
        let micros = |name, text| read(name, text).unwrap().micros;
        assert_eq!(micros("s", "0.0\n0.033333\n\n0.1\n"), [0, 33_333, 100_000]);
        assert_eq!(micros("us", "# unit: us\n0\n40\n"), [0, 40]);
        assert_eq!(
            micros("ns", "# ns\n1700000000000000499\n1700000000000001500\n"),
            [1_700_000_000_000_000, 1_700_000_000_000_002]
        );
        assert_eq!(
            micros("date", "1700000000.123456\n1700000000.123457"),
            [1_700_000_000_123_456, 1_700_000_000_123_457]
        );
        assert_eq!(micros("ms", "# unit = ms\n1\n2.5\n"), [1000, 2500]);
        let named = read("names", "# frame time\na.png 0.5\nb.png 0.75\n").unwrap();
        assert_eq!(
            (named.names, named.micros),
            (vec!["a.png".into(), "b.png".into()], vec![500_000, 750_000])
        );
    }

    #[test]
    fn what_cannot_be_meant_is_told_with_its_line() {
        for (name, text, told) in [
            ("whole", "0\n33333\n", "line 2: '33333' has no unit"),
            ("back", "0.1\n0.2\n0.2\n", "line 3: frame 2 at 200000 us does not come after 200000 us"),
            ("word", "0.1\nsoon\n", "line 2: 'soon' is no time"),
            ("nan", "# unit: s\nnan\n", "line 2: 'nan' is no time"),
            ("unit", "# unit: fortnights\n1\n", "unit 'fortnights' is unknown"),
            ("far", "# unit: s\n0\n33333333\n", "line 3: '33333333' lies more than 31 days"),
            ("some", "a 0.1\n0.2\n", "1 of 2 lines have a name"),
            ("none", "# nothing\n", "it has no times"),
        ] {
            let error = read(name, text).unwrap_err();
            assert!(error.contains(told), "{name}: {error}");
        }
    }

    #[test]
    fn a_rate_lies_on_an_absolute_grid() {
        assert_eq!(
            (on_grid(1, 30.0), on_grid(3, 30.0), on_grid(3_000_000, 30.0)),
            (33_333, 100_000, 100_000_000_000)
        );
        assert!(Clock::rate(0.0).is_err() && Clock::rate(f64::NAN).is_err() && Clock::rate(1e7).is_err());
    }
}
