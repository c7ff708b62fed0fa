//! `score`: how close a stream comes to truth.

use evis_core::Truth;
use evis_core::format::hdf5::{Recording, stored_sensor};
use evis_core::metric::{DEFAULT_TOLERANCES_US, Score, ScoreSettings, score};
use serde::Serialize;

use crate::args::ScoreArgs;
use crate::text;

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
    let settings = ScoreSettings {
        tolerances_us: if args.tolerance_us.is_empty() {
            DEFAULT_TOLERANCES_US.to_vec()
        } else {
            args.tolerance_us.clone()
        },
        sensor: Some(stored_sensor(&stream.header().config_toml, name).0),
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
