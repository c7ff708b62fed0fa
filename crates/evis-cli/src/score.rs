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
    // A file of one camera needs no name. Without a name, the truth's one camera is looked for in the stream.
    let cameras = &known.header().cameras;
    let only = match cameras.as_slice() {
        [only] => Some(only.name.as_str()),
        _ => None,
    };
    let named = args.camera.as_deref();
    let truth = Truth::load(&args.truth, only.or(named))?;
    let guessed = only.filter(|name| stream.header().cameras.iter().any(|c| c.name == *name));
    let camera = match stream.header().cameras.as_slice() {
        [_] if named.is_none() => 0,
        _ => stream.find_camera(named.or(guessed))?,
    };
    let info = stream.header().cameras.get(camera);
    let settings = ScoreSettings {
        tolerances_us: if args.tolerance_us.is_empty() {
            DEFAULT_TOLERANCES_US.to_vec()
        } else {
            args.tolerance_us.clone()
        },
        sensor: Some(stored_sensor(&stream.header().config_toml).0),
        size: info.map(|c| [c.width, c.height]),
    };
    let score = score(&stream.events(camera)?, &truth, &settings)?;
    if args.json {
        text::say_json(&Scored {
            events: args.events.display().to_string(),
            truth: args.truth.display().to_string(),
            camera: info.map_or("", |c| c.name.as_str()),
            score: &score,
        })?;
    } else {
        text::say(&score.to_string());
    }
    Ok(0)
}
