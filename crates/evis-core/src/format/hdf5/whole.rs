//! A recording's events in one list.

use std::path::Path;

use super::Recording;
use super::truth::stated_duration;
use crate::format::{EventFile, FormatError};

/// The events of `camera` (the only one, where there is no name) of a recording, with its size and the length that the file
/// states.
///
/// # Errors
/// A file that cannot be read, a camera that is not there.
pub fn read_events(path: &Path, camera: Option<&str>) -> Result<EventFile, FormatError> {
    let recording = Recording::open(path)?;
    let index = recording.find_camera(camera)?;
    let events = recording.events(index)?;
    let size = recording.header().cameras.get(index).map_or((1, 1), |camera| (camera.width, camera.height));
    let past = events.last().map_or(0, |event| event.t.saturating_add(1));
    let end_us = stated_duration(&recording)?.unwrap_or(0).max(past);
    Ok(EventFile { range: (0.min(events.first().map_or(0, |event| event.t)), end_us), events, size })
}
