//! Poses from text files: TUM (`t x y z qx qy qz qw`, spaces, seconds) and its relatives with commas or nanoseconds.

use std::path::Path as FilePath;

use glam::{DQuat, DVec3};

use crate::error::SceneError;
use crate::motion::{Path, PathInterpolation};

/// How a file of poses is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Format {
    /// Seconds per unit of the time column.
    pub unit_s: f64,
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
    let text = crate::source::text(path).map_err(|source| SceneError::Io { path: path.into(), source })?;
    parse(&text, format).map_err(|reason| SceneError::invalid(path, reason))
}

fn parse(text: &str, format: Format) -> Result<Path, String> {
    let hermite = format.interpolation == PathInterpolation::Hermite;
    let columns = if hermite { 11 } else { 8 };
    let (mut times, mut positions, mut rotations, mut velocities) = (vec![], vec![], vec![], vec![]);
    let mut first: Option<Stamp> = None;
    let mut seen_numbers = false;
    for (number, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let number = number + 1;
        let line = line.trim();
        if line.is_empty() || line.starts_with(['#', '%']) {
            continue;
        }
        let fields: Vec<&str> = line.split([',', ';', ' ', '\t']).filter(|f| !f.is_empty()).collect();
        let values: Option<Vec<f64>> = fields.iter().map(|f| f.parse().ok()).collect();
        let Some(values) = values else {
            if !seen_numbers {
                continue; // A header of words.
            }
            return Err(format!("line {number}: '{}' is not a row of numbers", short(line)));
        };
        seen_numbers = true;
        let (&[t, x, y, z, qx, qy, qz, qw], more) =
            values.split_first_chunk::<8>().ok_or_else(|| too_few(number, values.len(), columns))?;
        if values.len() < columns {
            return Err(too_few(number, values.len(), columns));
        }
        if !values.iter().all(|v| v.is_finite()) {
            return Err(format!("line {number}: '{}' holds a number that is not finite", short(line)));
        }
        let rotation = DQuat::from_xyzw(qx, qy, qz, qw);
        if (rotation.length() - 1.0).abs() > 1e-2 {
            return Err(format!(
                "line {number}: the rotation ({qx}, {qy}, {qz}, {qw}) has length {:.4}; it takes a unit quaternion x y z w",
                rotation.length()
            ));
        }
        let stamp = Stamp { whole: fields.first().and_then(|f| f.parse().ok()), value: t };
        let first = *first.get_or_insert(stamp);
        let time = if format.from_zero { stamp.since(first) } else { t } * format.unit_s + format.offset_s;
        if let Some(last) = times.last()
            && time <= *last
        {
            return Err(format!(
                "line {number}: time {t} does not come after the row before; times must increase"
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

fn too_few(line: usize, found: usize, columns: usize) -> String {
    let takes = if columns == 11 { "t x y z qx qy qz qw vx vy vz (hermite)" } else { "t x y z qx qy qz qw" };
    format!("line {line}: {found} columns; it takes {columns}: {takes}")
}

fn short(line: &str) -> String {
    line.chars().take(60).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TUM: Format = Format {
        unit_s: 1.0,
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
        let nanoseconds = Format { unit_s: 1e-9, ..TUM };
        let text =
            "# timestamp, x\n1403636579763555584,1,2,3,0,0,0,1\n1403636579763555585, 1,2,3, 0,0,0,-1\n";
        assert_eq!(times(text, nanoseconds), [0.0, 1e-9], "a nanosecond since 1970 survives");
        assert_eq!(times("t x y z qx qy qz qw\n\n5 1 2 3 0 0 0 1\n5.5\t1 2 3 0 0 0 1", TUM), [0.0, 0.5]);
        assert_eq!(times("5 1 2 3 0 0 0 1", Format { from_zero: false, offset_s: 2.0, ..TUM }), [7.0]);
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
            ("0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1", TUM, "line 2: time 0"),
            ("0 0 0 0 0 0 1", TUM, "line 1: 7 columns; it takes 8"),
            ("0 0 0 0 0 0 0 1", hermite, "line 1: 8 columns; it takes 11"),
            ("0 0 0 0 0 0 0 2", TUM, "length 2.0000"),
            ("0 0 0 0 0 0 0 1\n1 0 0 x 0 0 0 1", TUM, "line 2: '1 0 0 x"),
            ("0 0 nan 0 0 0 0 1", TUM, "not finite"),
            ("# only a header", TUM, "no pose"),
        ] {
            let reason = parse(text, format).err().unwrap_or_default();
            assert!(reason.contains(expected), "{text:?}: {reason}");
        }
        // Canary: a good row passes.
        assert!(parse("0 0 0 0 0 0 0 1 5 6 7", hermite).is_ok());
    }
}
