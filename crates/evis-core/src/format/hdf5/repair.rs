//! Making a recording whose writer was killed readable for everyone.

use std::path::Path;

use super::store::{Column, FileState, Store, compress};
use super::{RESERVED_NAMES, Recording};
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
        let present = store.names(&format!("{camera}/events"))?;
        let all = ["x", "y", "t", "p", "cause"].into_iter();
        let events: Vec<String> = all
            .filter(|c| *c != "cause" || present.iter().any(|name| name == c))
            .map(|c| format!("{camera}/events/{c}"))
            .collect();
        let (count, mut columns) = align(&mut store, &events, &mut report)?;
        if let [_, _, t, ..] = columns.as_mut_slice() {
            complete_index(&mut store, &camera, t, &mut report)?;
        }
        report.events.push((camera.clone(), count));

        let poses = ["t_us", "position", "rotation_xyzw"].map(|c| format!("{camera}/poses/{c}"));
        align(&mut store, &poses, &mut report)?;
        let labels = store.names(&format!("{camera}/labels"))?;
        for kind in labels.iter().filter(|name| !name.ends_with("_us")) {
            let times = ["_t_us", "_t_other_us", "_t_end_us"].map(|ending| format!("{kind}{ending}"));
            let parts: Vec<String> = std::iter::once(kind.clone())
                .chain(times)
                .filter(|name| labels.contains(name))
                .map(|name| format!("{camera}/labels/{name}"))
                .collect();
            align(&mut store, &parts, &mut report)?;
        }
    }
    align(&mut store, &["evis/report_json".into()], &mut report)?;
    if !report.nothing_to_do() || store.is_truncated() {
        store.publish(FileState::Closed)?;
    }
    // Groups, names and texts cannot be rebuilt; whether they are there, the reader knows.
    Recording::open(path)?;
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
    let longest = columns.iter().map(Column::rows_published).max().unwrap_or(0);
    report.rows_dropped += longest.saturating_sub(rows);
    for column in &mut columns {
        column.resume(store, rows)?;
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
    let had = index.rows_published();
    let readable = index.readable_rows(store);
    index.resume(store, readable)?;

    let event_count = t.rows();
    let mut last_millis = None;
    t.for_each_chunk(store, event_count.saturating_sub(1), |bytes| last_millis = Some(millis(bytes)))?;
    let wanted = last_millis.map_or(0, |ms| ms + 1);
    if index.rows() > wanted {
        index.resume(store, wanted)?;
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
    report.millis_rebuilt += had.abs_diff(readable) + readable.abs_diff(index.rows());
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::event::{Event, Polarity};
    use crate::format::hdf5::{RecordingHeader, RecordingWriter};
    use crate::packet::CameraInfo;

    fn stored_index(path: &Path) -> Vec<u64> {
        let file = rust_hdf5::H5File::open(path).unwrap();
        file.dataset("cam/ms_to_idx").unwrap().read_raw::<u64>().unwrap()
    }

    #[test]
    fn columns_out_of_step_are_brought_together() {
        let path = std::env::temp_dir().join(format!("evis_repair_{}.h5", std::process::id()));
        let camera =
            CameraInfo { name: "cam".into(), width: 9, height: 9, fx: 1.0, fy: 1.0, cx: 1.0, cy: 1.0 };
        let header = RecordingHeader {
            cameras: vec![camera],
            seed: 0,
            method: "native".into(),
            environment: 0,
            config_toml: String::new(),
            duration_us: None,
            t_offset_us: 0,
            labels: Vec::new(),
        };
        let events: Vec<_> = (0..150_000).map(|i| Event::new(i * 137, 1, 2, Polarity::Off)).collect();
        let mut writer = RecordingWriter::create(&path, &header, true).unwrap();
        writer.write_events(0, &events).unwrap();
        writer.finish("{}").unwrap();
        let whole = stored_index(&path);
        assert!(repair(&path).unwrap().nothing_to_do());

        // What is left when the writer dies between the extents of two columns.
        let mut store = Store::open(&path).unwrap();
        store.publish(FileState::Open).unwrap();
        for (name, rows) in [("cam/events/p", 149_000), ("cam/ms_to_idx", 3)] {
            Column::open(&mut store, name).unwrap().resume(&mut store, rows).unwrap();
        }
        drop(store);
        assert_eq!(stored_index(&path).len(), 3, "canary: the damage is done");
        let report = repair(&path).unwrap();
        assert!(report.reopened);
        assert_eq!(report.rows_dropped, 1_000);
        assert_eq!(report.events, [("cam".to_string(), 149_000)]);
        let last_millis = usize::try_from(events[148_999].t / 1000).unwrap();
        assert_eq!(stored_index(&path), whole[..=last_millis]);
        assert!(Recording::open(&path).unwrap().events(0).unwrap() == events[..149_000]);

        // An index that is ahead of the events.
        let mut store = Store::open(&path).unwrap();
        for name in ["cam/events/x", "cam/events/y", "cam/events/t", "cam/events/p"] {
            Column::open(&mut store, name).unwrap().resume(&mut store, 100).unwrap();
        }
        drop(store);
        let report = repair(&path).unwrap();
        assert!(!report.reopened && report.rows_dropped == 0 && report.millis_rebuilt > 0);
        assert_eq!(stored_index(&path), whole[..=13]);
        std::fs::remove_file(&path).unwrap();
    }
}
