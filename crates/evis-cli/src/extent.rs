//! How long a recording is, and its events piece by piece.

use evis_core::Event;
use evis_core::event::slice_time;
use evis_core::format::FormatError;
use evis_core::format::hdf5::Recording;
use evis_format::{EventFile, read_events};
use std::path::Path;

use crate::args::to_us;
use crate::failure::bad_input;

/// Events are read in pieces of this length, so that memory does not grow with the recording.
const PIECE_US: i64 = 1_000_000;

/// Hands all events of camera `camera` to `look`, in order, piece by piece.
pub(crate) fn for_each_piece(
    recording: &Recording,
    camera: usize,
    mut look: impl FnMut(&[Event]),
) -> Result<(), FormatError> {
    let count = recording.event_count(camera)?;
    let (mut seen, mut from_us, mut length_us) = (0_u64, 0_i64, PIECE_US);
    while seen < count && from_us < i64::MAX {
        let until_us = from_us.saturating_add(length_us);
        let piece = recording.events_between(camera, from_us, until_us)?;
        // Long silences are crossed in growing steps.
        length_us = if piece.is_empty() { length_us.saturating_mul(2) } else { PIECE_US };
        seen += piece.len() as u64;
        from_us = until_us;
        look(&piece);
    }
    Ok(())
}

/// End of the stream in microseconds: what its report says, else one past the last thing that it holds.
pub(crate) fn end_us(recording: &Recording) -> Result<i64, FormatError> {
    let told = recording
        .report()?
        .and_then(|json| serde_json::from_str::<serde_json::Value>(&json).ok())
        .and_then(|report| report.get("stream_s")?.as_f64())
        .filter(|s| s.is_finite() && (0.0..1.0e9).contains(s));
    if let Some(seconds) = told {
        return Ok((seconds * 1.0e6).round() as i64);
    }
    let mut end_us = 0;
    for camera in 0..recording.header().cameras.len() {
        for_each_piece(recording, camera, |piece| {
            end_us = end_us.max(piece.last().map_or(0, |e| e.t.saturating_add(1)));
        })?;
        let poses = recording.poses(camera)?;
        end_us = end_us.max(poses.last().map_or(0, |pose| pose.t_us.saturating_add(1)));
    }
    Ok(end_us)
}

/// A part of a recording, in any format that is read.
pub(crate) fn part(
    path: &Path,
    camera: Option<&str>,
    start_s: Option<f64>,
    duration_s: Option<f64>,
) -> anyhow::Result<EventFile> {
    let mut file = read_events(path, camera)?;
    let (first_us, end_us) = file.range;
    let from_us = first_us.saturating_add(to_us(start_s.unwrap_or(0.0)));
    if from_us >= end_us {
        return Err(bad_input(format!(
            "{}: it is {} long and nothing is left after --start; choose an earlier one",
            path.display(),
            crate::text::seconds(end_us - first_us)
        )));
    }
    let until_us = duration_s.map_or(end_us, |s| from_us.saturating_add(to_us(s)).min(end_us));
    if (from_us, until_us) != file.range {
        file.events = slice_time(&file.events, from_us, until_us).to_vec();
        file.range = (from_us, until_us);
    }
    Ok(file)
}
