//! Poses from text files: TUM (`t x y z qx qy qz qw`, spaces, seconds) and its relatives with commas or nanoseconds.

use std::path::Path as FilePath;

use glam::{DQuat, DVec3};

use crate::error::SceneError;
use crate::motion::{Path, PathInterpolation};

/// How a file of poses is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Format {
    /// Seconds per unit of the time column; `None` for seconds, or what a line `# unit: ns` says.
    pub unit_s: Option<f64>,
    /// Whether the first pose is at scene time 0; else the file's own times count.
    pub from_zero: bool,
    /// Added to every time, seconds.
    pub offset_s: f64,
    /// Rotations turn axes with x right, y down, z forward (OpenCV) instead of y up, -z forward.
    pub opencv_axes: bool,
    /// Rule between poses; Hermite takes velocities from three more columns.
    pub interpolation: PathInterpolation,
}

pub(super) fn load(path: &FilePath, format: Format) -> Result<Path, SceneError> {
    let text = crate::file::text(path).map_err(|source| SceneError::Io { path: path.into(), source })?;
    timed(&text, format).map_err(|reason| SceneError::invalid(path, reason))
}

/// Reads poses, whose unit of time the format or the text names; seconds that are none are refused.
fn timed(text: &str, format: Format) -> Result<Path, String> {
    let unit_s = format.unit_s.map_or_else(|| unit_of(text), |unit_s| Ok(Some(unit_s)))?;
    let path = parse(text, Format { unit_s, ..format })?;
    match &path {
        Path::Keys { times, .. } if unit_s.is_none() => check_spacing(times)?,
        _ => {}
    }
    Ok(path)
}

/// The poses of a file that nothing else describes: times in seconds, or in the unit that a line `# unit: ns` (s, ms, us,
/// ns) names, the first pose at time 0, cameras that look along -Z.
pub(crate) fn load_plain(path: &FilePath, interpolation: PathInterpolation) -> Result<Path, SceneError> {
    let text = crate::file::text(path).map_err(|source| SceneError::Io { path: path.into(), source })?;
    let format = Format { unit_s: None, from_zero: true, offset_s: 0.0, opencv_axes: false, interpolation };
    timed(&text, format).map_err(|reason| SceneError::invalid(path, reason))
}

/// Seconds per unit of time, where a comment names one.
fn unit_of(text: &str) -> Result<Option<f64>, String> {
    for (number, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let Some(unit) = line.trim().strip_prefix('#').and_then(|rest| rest.trim().strip_prefix("unit:"))
        else {
            continue;
        };
        let unit = unit.trim();
        return match UNITS.iter().find(|(name, _)| *name == unit) {
            Some((_, seconds)) => Ok(Some(*seconds)),
            None => Err(format!(
                "line {}, column {}: the unit of time is '{}'; it must be s, ms, us or ns",
                number + 1,
                column(line, unit),
                short(unit)
            )),
        };
    }
    Ok(None)
}

/// Refuses times that are probably not seconds.
fn check_spacing(times: &[f64]) -> Result<(), String> {
    let [first, .., last] = times else { return Ok(()) };
    let mean_s = (last - first) / (times.len() - 1) as f64;
    if mean_s > LONGEST_MEAN_STEP_S {
        return Err(format!(
            "its poses are {mean_s} s apart on average; is the first column in nanoseconds? A line '# unit: ns' (or us, ms), \
             or time_unit = \"ns\" in a scene file, says so; unit s confirms seconds"
        ));
    }
    Ok(())
}

/// Names of units of time, in seconds.
pub(super) const UNITS: [(&str, f64); 4] = [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)];

/// Poses that are farther apart on average are taken to be in another unit than seconds.
const LONGEST_MEAN_STEP_S: f64 = 10.0;

/// Column, from 1, at which `part`, a piece of `line`, starts.
fn column(line: &str, part: &str) -> usize {
    let offset = (part.as_ptr() as usize).saturating_sub(line.as_ptr() as usize);
    line.get(..offset).map_or(1, |before| before.chars().count() + 1)
}

fn parse(text: &str, format: Format) -> Result<Path, String> {
    let hermite = format.interpolation == PathInterpolation::Hermite;
    let columns = if hermite { 11 } else { 8 };
    let (mut times, mut positions, mut rotations, mut velocities) = (vec![], vec![], vec![], vec![]);
    let mut first: Option<Stamp> = None;
    let mut seen_numbers = false;
    for (number, whole) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let line = whole.trim();
        if line.is_empty() || line.starts_with(['#', '%']) {
            continue;
        }
        let fields: Vec<&str> = line.split([',', ';', ' ', '\t']).filter(|f| !f.is_empty()).collect();
        let at = |field: usize| {
            let field = fields.get(field).or(fields.last()).copied().unwrap_or(line);
            format!("line {}, column {}", number + 1, column(whole, field))
        };
        let mut values: Vec<f64> = Vec::with_capacity(fields.len());
        values.extend(fields.iter().map_while(|f| f.parse::<f64>().ok()));
        if let Some(bad) = fields.get(values.len()) {
            // A header is words, from the first one on.
            if !seen_numbers && values.is_empty() {
                continue;
            }
            return Err(format!("{}: '{}' is not a number", at(values.len()), short(bad)));
        }
        seen_numbers = true;
        let (&[t, x, y, z, qx, qy, qz, qw], more) =
            values.split_first_chunk::<8>().ok_or_else(|| too_few(&at(0), values.len(), columns))?;
        if values.len() < columns {
            return Err(too_few(&at(0), values.len(), columns));
        }
        if let Some(field) = values.iter().position(|v| !v.is_finite()) {
            return Err(format!("{}: '{}' is not finite", at(field), short(fields[field])));
        }
        let rotation = DQuat::from_xyzw(qx, qy, qz, qw);
        if (rotation.length() - 1.0).abs() > 1e-2 {
            return Err(format!(
                "{}: the rotation ({qx}, {qy}, {qz}, {qw}) has length {:.4}; it takes a unit quaternion x y z w",
                at(4),
                rotation.length()
            ));
        }
        let stamp = Stamp { whole: fields.first().and_then(|f| f.parse().ok()), value: t };
        let first = *first.get_or_insert(stamp);
        let time = if format.from_zero { stamp.since(first) } else { t } * format.unit_s.unwrap_or(1.0)
            + format.offset_s;
        if let Some(last) = times.last()
            && time <= *last
        {
            return Err(format!(
                "{}: time {t} does not come after the row before; times must increase",
                at(0)
            ));
        }
        times.push(time);
        positions.push(DVec3::new(x, y, z));
        // Half a turn about x: from y down, z forward to y up, z backward.
        let axes = if format.opencv_axes { DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0) } else { DQuat::IDENTITY };
        rotations.push(rotation.normalize() * axes);
        if hermite && let Some(v) = more.first_chunk::<3>() {
            velocities.push(DVec3::from(*v));
        }
    }
    if times.is_empty() {
        return Err("there is no pose in it; it takes rows of t x y z qx qy qz qw".into());
    }
    Ok(Path::Keys { times, positions, rotations, velocities, interpolation: format.interpolation })
}

/// A time as the file writes it; whole numbers are kept exact, because nanoseconds since 1970 do not fit a float.
#[derive(Clone, Copy)]
struct Stamp {
    whole: Option<i64>,
    value: f64,
}

impl Stamp {
    fn since(self, first: Self) -> f64 {
        let exact = self.whole.zip(first.whole).and_then(|(a, b)| a.checked_sub(b));
        exact.map_or(self.value - first.value, |d| d as f64)
    }
}

fn too_few(at: &str, found: usize, columns: usize) -> String {
    let takes = if columns == 11 { "t x y z qx qy qz qw vx vy vz (hermite)" } else { "t x y z qx qy qz qw" };
    format!("{at}: {found} columns; it takes {columns}: {takes}")
}

fn short(line: &str) -> String {
    line.chars().take(60).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TUM: Format = Format {
        unit_s: Some(1.0),
        from_zero: true,
        offset_s: 0.0,
        opencv_axes: false,
        interpolation: PathInterpolation::Linear,
    };

    fn times(text: &str, format: Format) -> Vec<f64> {
        match parse(text, format) {
            Ok(Path::Keys { times, .. }) => times,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn commas_spaces_headers_and_units_are_read() {
        let nanoseconds = Format { unit_s: Some(1e-9), ..TUM };
        let text =
            "# timestamp, x\n1403636579763555584,1,2,3,0,0,0,1\n1403636579763555585, 1,2,3, 0,0,0,-1\n";
        assert_eq!(times(text, nanoseconds), [0.0, 1e-9], "a nanosecond since 1970 survives");
        assert_eq!(times("t x y z qx qy qz qw\n\n5 1 2 3 0 0 0 1\n5.5\t1 2 3 0 0 0 1", TUM), [0.0, 0.5]);
        assert_eq!(times("5 1 2 3 0 0 0 1", Format { from_zero: false, offset_s: 2.0, ..TUM }), [7.0]);
    }

    #[test]
    fn seconds_that_are_hardly_seconds_are_asked_about() {
        let unsaid = Format { unit_s: None, ..TUM };
        let text = "0 0 0 0 0 0 0 1\n33333333 0 0 0 0 0 0 1\n";
        let told = timed(text, unsaid).unwrap_err();
        assert!(told.contains("33333333 s apart") && told.contains("nanoseconds?"), "{told}");
        for said in
            [format!("# unit: s\n{text}"), format!("# unit: ns\n{text}"), text.replace("33333333", "9.5")]
        {
            assert!(timed(&said, unsaid).is_ok(), "{said}");
        }
        assert!(timed(text, TUM).is_ok(), "a unit that the scene file names is taken");
    }

    #[test]
    fn opencv_axes_look_along_minus_z_afterwards() {
        let path = parse("0 0 0 0 0 0 0 1", Format { opencv_axes: true, ..TUM });
        let Ok(Path::Keys { rotations, .. }) = path else { panic!("{path:?}") };
        assert!((rotations[0] * DVec3::NEG_Z).distance(DVec3::Z) < 1e-12);
        assert!((rotations[0] * DVec3::Y).distance(DVec3::NEG_Y) < 1e-12);
    }

    #[test]
    fn bad_rows_are_named_by_their_line() {
        let hermite = Format { interpolation: PathInterpolation::Hermite, ..TUM };
        for (text, format, expected) in [
            ("0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1", TUM, "line 2, column 1: time 0"),
            ("0 0 0 0 0 0 1", TUM, "line 1, column 1: 7 columns; it takes 8"),
            ("0 0 0 0 0 0 0 1", hermite, "line 1, column 1: 8 columns; it takes 11"),
            ("0 0 0 0 0 0 0 2", TUM, "line 1, column 9: the rotation (0, 0, 0, 2) has length 2.0000"),
            ("0 0 0 0 0 0 0 1\n1 0 0 x 0 0 0 1", TUM, "line 2, column 7: 'x' is not a number"),
            ("0 0 nan 0 0 0 0 1", TUM, "line 1, column 5: 'nan' is not finite"),
            ("# only a header", TUM, "no pose"),
        ] {
            let reason = parse(text, format).err().unwrap_or_default();
            assert!(reason.contains(expected), "{text:?}: {reason}");
        }
        // Canary: a good row passes.
        assert!(parse("0 0 0 0 0 0 0 1 5 6 7", hermite).is_ok());
    }
}
