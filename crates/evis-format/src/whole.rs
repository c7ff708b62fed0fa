//! All events of a file at once.

use std::path::Path;

use evis_core::format::{EventFile, FormatError, check_events, hdf5};
use evis_core::limits::Budget;

use crate::numpy::{NpyReader, NpzReader};
use crate::packet::Packet;
use crate::read::{EventReader, ReadOptions};

/// Deflate expands at most 1032 times, and an event takes no less than a byte.
const MOST_EXPANSION: u64 = 1100;

/// Reads the events of `camera` (the only one, where there is no name) from `.h5`, `.hdf5`, `.npz` or `.npy`.
///
/// # Errors
/// A file that cannot be read, another ending, a camera that is not there.
pub fn read_events(path: &Path, camera: Option<&str>) -> Result<EventFile, FormatError> {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    let options = ReadOptions::default();
    match ending.as_deref() {
        Some("h5" | "hdf5") => hdf5::read_events(path, camera),
        Some("npz") => collect(path, &mut NpzReader::open(path, &options)?),
        Some("npy") => collect(path, &mut NpyReader::open(path, &options)?),
        _ => {
            let remedy = "name a file that ends with .h5, .hdf5, .npz or .npy";
            Err(FormatError::invalid(path, "this kind of file is not read", remedy))
        }
    }
}

/// What is left in `reader`, of the file at `path`.
fn collect(path: &Path, reader: &mut dyn EventReader) -> Result<EventFile, FormatError> {
    let corrupt = |what: String| FormatError::corrupt(path, what, "copy it again from its source");
    let length = std::fs::metadata(path).map_err(|error| FormatError::io(path, "read", error))?.len();
    let count = reader.info().events.unwrap_or(0);
    if count / MOST_EXPANSION > length {
        return Err(corrupt(format!("its {count} events do not fit in its {length} bytes")));
    }
    let count = usize::try_from(count).unwrap_or(usize::MAX);
    let list = Budget::default().list(count, "its list of events");
    let mut events = list.map_err(|error| corrupt(error.to_string()))?;
    let mut packet = Packet::default();
    while reader.read_packet(&mut packet)? {
        events.append(&mut packet.events);
    }
    let most =
        |of: fn(&evis_core::Event) -> u16| events.iter().map(of).max().map_or(1, |most| u32::from(most) + 1);
    let size = reader.info().size.unwrap_or_else(|| (most(|e| e.x), most(|e| e.y)));
    let range = match (events.first(), events.last()) {
        (Some(first), Some(last)) => (first.t, last.t.saturating_add(1)),
        _ => (0, 0),
    };
    check_events(&events, size, 0, i64::MIN).map_err(corrupt)?;
    Ok(EventFile { events, size, range })
}
