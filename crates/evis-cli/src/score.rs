//! `score`: how close a stream comes to truth.

use evis_core::Truth;
use evis_core::format::hdf5::{Recording, stored_sensor};
use evis_core::metric::{DEFAULT_TOLERANCES_US, Score, ScoreSettings, score};
use serde::Serialize;

use crate::args::ScoreArgs;
use crate::text;

/// How far apart the Y_ref of one scene may lie, as a part of it. Both are means over a camera's first image: with one
/// sample a pixel, that of a scene of fine detail is off by 0.035.
const MOST_APART: f64 = 0.1;

#[derive(Serialize)]
struct Scored<'a> {
    events: String,
    truth: String,
    camera: &'a str,
    score: &'a Score,
}

/// Scores a recording against truth.
pub(crate) fn run(args: &ScoreArgs) -> anyhow::Result<i32> {
    let (stream, known) = (Recording::open(&args.events)?, Recording::open(&args.truth)?);
    let named = args.camera.as_deref();
    let camera = stream.find_camera(choose(named, &stream, &known))?;
    let truth = Truth::load(&args.truth, choose(named, &known, &stream))?;
    if let Some(hz) = truth.sampled_hz() {
        text::complain(&format!(
            "warning: {} is no truth but exact light sampled at {hz} Hz: this score leaves out what that rate costs",
            args.truth.display()
        ));
    }
    let info = stream.header().cameras.get(camera);
    let name = info.map_or("", |c| c.name.as_str());
    let (sensor, reference) = stored_sensor(&stream.header().config_toml, name);
    // Y_ref is that of the first camera, and of frames it is whatever their white is.
    if camera == 0
        && stream.header().method != "frames"
        && let Some(warning) = other_light(reference, truth.reference_luminance)
    {
        text::complain(&warning);
    }
    let settings = ScoreSettings {
        tolerances_us: if args.tolerance_us.is_empty() {
            DEFAULT_TOLERANCES_US.to_vec()
        } else {
            args.tolerance_us.clone()
        },
        sensor: Some(sensor),
        size: info.map(|c| [c.width, c.height]),
    };
    let score = score(&stream.events(camera)?, &truth, &settings)?;
    if args.json {
        text::say_json(&Scored {
            events: args.events.display().to_string(),
            truth: args.truth.display().to_string(),
            camera: name,
            score: &score,
        })?;
    } else {
        text::say(&score.to_string());
    }
    Ok(0)
}

/// A warning where the Y_ref of a rendered stream's first camera is too far from the truth's for one scene. NaN is
/// unknown.
fn other_light(stream: f64, truth: f64) -> Option<String> {
    let known = [stream, truth].iter().all(|y| y.is_finite() && *y > 0.0);
    let apart = stream.max(truth) / stream.min(truth) - 1.0;
    (known && apart > MOST_APART).then(|| {
        format!(
            "warning: Y_ref is {stream:.4} in the stream and {truth:.4} in the truth: unless one was set by hand \
             (--reference-luminance), they are of different scenes, cameras or starts, and this score says nothing"
        )
    })
}

/// Name of the camera to look for in `file`. A file of one camera needs no name: one that is given may be meant for the
/// `other`; and where none is given, the other's only camera may be among several here.
fn choose<'a>(named: Option<&'a str>, file: &'a Recording, other: &'a Recording) -> Option<&'a str> {
    let has = |recording: &Recording, name: &str| recording.header().cameras.iter().any(|c| c.name == name);
    let (cameras, others) = (file.header().cameras.as_slice(), other.header().cameras.as_slice());
    match (named, cameras, others) {
        (Some(name), [_], _) if !has(file, name) && has(other, name) => None,
        (None, [_, _, ..], [only]) if has(file, &only.name) => Some(&only.name),
        _ => named,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_of_another_scene_is_told() {
        assert!(
            other_light(6.15, 1.95).is_some_and(|told| told.contains("6.1500") && told.contains("1.9500"))
        );
        assert!(other_light(1.95, 6.15).is_some());
        for (stream, truth) in [(5.94, 6.15), (2.0, 2.0), (f64::NAN, 6.15), (6.15, f64::NAN), (0.0, 6.15)] {
            assert_eq!(other_light(stream, truth), None, "{stream} {truth}");
        }
    }
}
