//! Making a recording whose writer was killed readable for everyone.

use std::path::Path;

use super::RESERVED_NAMES;
use super::store::{Column, FileState, Store, compress};
use crate::format::FormatError;

/// What [`repair`] did.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RepairReport {
    /// The file was still marked as being written; the mark is gone.
    pub reopened: bool,
    /// Cameras with the events that each has now.
    pub events: Vec<(String, u64)>,
    /// Entries of `ms_to_idx` that were added or dropped.
    pub millis_rebuilt: u64,
    /// Rows dropped because a column of their event, label or pose was missing or damaged.
    pub rows_dropped: u64,
}

impl RepairReport {
    /// Whether the file was as it should be.
    pub fn nothing_to_do(&self) -> bool {
        !self.reopened && self.millis_rebuilt == 0 && self.rows_dropped == 0
    }
}

/// Clears the mark that a killed writer leaves, so that every HDF5 reader opens the file, and brings the
/// columns into step: rows of which a part is missing go, `ms_to_idx` is completed. A file that needs
/// nothing is not touched.
///
/// # Errors
/// A file that is no recording, is being written or read by another process, cannot be written to, or is
/// damaged beyond its rows.
pub fn repair(path: &Path) -> Result<RepairReport, FormatError> {
    let mut store = Store::open(path)?;
    store.lock_alone()?;
    let mut report = RepairReport { reopened: store.state() == FileState::Open, ..Default::default() };
    let mut roots = store.names("")?;
    if !roots.iter().any(|name| name == "evis") {
        return Err(FormatError::corrupt(
            path,
            "it has no group evis",
            "give a recording that evis-rs wrote",
        ));
    }
    roots.retain(|name| !RESERVED_NAMES.contains(&name.as_str()));
    for camera in roots {
        let events = ["x", "y", "t", "p"].map(|c| format!("{camera}/events/{c}"));
        let (count, mut columns) = align(&mut store, &events, &mut report)?;
        if let [_, _, t, _] = columns.as_mut_slice() {
            complete_index(&mut store, &camera, t, &mut report)?;
        }
        report.events.push((camera.clone(), count));

        let poses = ["t_us", "position", "rotation_xyzw"].map(|c| format!("{camera}/poses/{c}"));
        align(&mut store, &poses, &mut report)?;
        let labels = store.names(&format!("{camera}/labels"))?;
        for kind in labels.iter().filter(|name| !name.ends_with("_us")) {
            let parts: Vec<String> = [kind.clone(), format!("{kind}_t_us"), format!("{kind}_t_other_us")]
                .into_iter()
                .filter(|name| labels.contains(name))
                .map(|name| format!("{camera}/labels/{name}"))
                .collect();
            align(&mut store, &parts, &mut report)?;
        }
    }
    if !report.nothing_to_do() || store.is_truncated() {
        store.publish(FileState::Closed)?;
    }
    Ok(report)
}

/// Shortens `names` to the rows that all of them have.
fn align(
    store: &mut Store,
    names: &[String],
    report: &mut RepairReport,
) -> Result<(u64, Vec<Column>), FormatError> {
    let mut columns = names.iter().map(|n| Column::open(store, n)).collect::<Result<Vec<_>, _>>()?;
    let rows = columns.iter_mut().map(|c| c.readable_rows(store)).min().unwrap_or(0);
    report.rows_dropped += columns.iter().map(|c| c.rows().saturating_sub(rows)).max().unwrap_or(0);
    for column in &mut columns {
        if column.rows() > rows {
            column.truncate(store, rows)?;
        }
    }
    Ok((rows, columns))
}

/// Brings `ms_to_idx` to exactly one entry per millisecond up to the last event.
fn complete_index(
    store: &mut Store,
    camera: &str,
    t: &mut Column,
    report: &mut RepairReport,
) -> Result<(), FormatError> {
    let mut index = Column::open(store, &format!("{camera}/ms_to_idx"))?;
    let readable = index.readable_rows(store);
    let had = index.rows();
    if readable < had {
        index.truncate(store, readable)?;
    }

    let event_count = t.rows();
    let mut last_millis = None;
    t.for_each_chunk(store, event_count.saturating_sub(1), |bytes| last_millis = Some(millis(bytes)))?;
    let wanted = last_millis.map_or(0, |ms| ms + 1);
    if index.rows() > wanted {
        index.truncate(store, wanted)?;
    } else if index.rows() < wanted {
        // The last entry says where to go on; without one, at the first event.
        let mut row = 0;
        let last = index.rows().saturating_sub(1);
        index.for_each_chunk(store, last, |bytes| row = little_endian(bytes))?;
        let mut next = index.rows();
        let width = t.row_bytes();
        let mut entries: Vec<u64> = Vec::new();
        t.for_each_chunk(store, row.min(event_count), |bytes| {
            for value in bytes.chunks_exact(width) {
                while next <= millis(value) {
                    entries.push(row);
                    next += 1;
                }
                row += 1;
            }
        })?;
        index.push_each(entries.iter().map(|e| e.to_le_bytes()));
        store_all(store, &mut index)?;
    }
    report.millis_rebuilt += had.abs_diff(index.rows());
    Ok(())
}

/// Commits one column.
fn store_all(store: &mut Store, column: &mut Column) -> Result<(), FormatError> {
    let path = store.path().to_path_buf();
    let full = column.take_full();
    let full = full.iter().map(|c| compress(column.pipeline(), c, &path)).collect::<Result<Vec<_>, _>>()?;
    column.append_compressed(store, &full)?;
    if let Some(tail) = column.pending_tail() {
        let tail = compress(column.pipeline(), &tail, &path)?;
        column.store_tail(store, &tail)?;
    }
    column.write_index(store)?;
    column.write_extent(store)
}

fn little_endian(bytes: &[u8]) -> u64 {
    bytes.iter().take(8).rev().fold(0, |value, &byte| value << 8 | u64::from(byte))
}

fn millis(t: &[u8]) -> u64 {
    little_endian(t) / 1000
}
