//! Making a recording whose writer was killed readable for everyone.

use std::ops::Range;
use std::path::Path;

use super::column::Column;
use super::layout::LATEST_US;
use super::store::{FileState, Store};
use super::{RESERVED_NAMES, Recording};
use crate::format::FormatError;

/// What [`repair`] did.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RepairReport {
    /// The file was still marked as being written; the mark is gone.
    pub reopened: bool,
    /// The file ended before its content did.
    pub cut_short: bool,
    /// Cameras with the events that each has now.
    pub events: Vec<(String, u64)>,
    /// Events that the file promised and that could not be saved.
    pub events_dropped: u64,
    /// Entries of `ms_to_idx` that were added or dropped.
    pub millis_rebuilt: u64,
    /// Rows dropped because a column of their event, label or pose was missing or damaged; events among them.
    pub rows_dropped: u64,
    /// The writer's report was there and could not be saved.
    pub report_dropped: bool,
    /// What is missing between rows that were saved, numbered as they were before.
    pub holes: Vec<Hole>,
}

/// Rows in the middle of a table that cannot be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hole {
    /// The table: `left/events`, `left/poses`, `left/labels/depth`.
    pub part: String,
    /// First row.
    pub first: u64,
    /// The row after the last one.
    pub end: u64,
    /// Of events: the time of the one before it and of the one after it, where there are such, microseconds.
    pub between_us: Option<(i64, i64)>,
}

impl std::fmt::Display for Hole {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { part, first, end, between_us } = self;
        write!(f, "rows {first} to {} of {part}", end - 1)?;
        match between_us {
            Some((from, to)) => write!(f, " (between {from} and {to} us)"),
            None => Ok(()),
        }
    }
}

impl RepairReport {
    /// Whether the file was as it should be.
    pub fn nothing_to_do(&self) -> bool {
        !self.reopened
            && !self.cut_short
            && !self.report_dropped
            && self.millis_rebuilt == 0
            && self.rows_dropped == 0
    }
}

/// Clears the mark that a killed writer leaves, so that every HDF5 reader opens the file, and brings the
/// columns into step: rows of which a part is missing or damaged go, those after them stay, `ms_to_idx` is completed. The
/// file then no longer counts as complete, and everything in it can be read. A file that needs nothing is not touched, and
/// one that cannot be repaired stays what it was.
///
/// # Errors
/// A file that is no recording, is being written or read by another process, cannot be written to, is
/// damaged beyond its rows, or of whose events and label images none can be saved.
pub fn repair(path: &Path) -> Result<RepairReport, FormatError> {
    // Where the chunk index itself is damaged, what comes after the damage has no place to go to.
    match attempt(path, false) {
        Err(FormatError::Corrupt { .. }) => attempt(path, true),
        done => done,
    }
}

fn attempt(path: &Path, starts_only: bool) -> Result<RepairReport, FormatError> {
    let mut store = Store::open(path)?;
    store.lock_alone()?;
    store.remember();
    let repaired = save(&mut store, starts_only);
    if repaired.is_err() {
        store.take_back()?;
    }
    repaired
}

/// What [`repair`] would do; nothing is written. Everything that the file holds is read.
///
/// # Errors
/// A file that is no recording, that no repair can save, or that cannot be read although it needs no repair.
pub fn check(path: &Path) -> Result<RepairReport, FormatError> {
    let (report, ..) = survey(&mut Store::open_to_read(path)?, false)?;
    if report.nothing_to_do() {
        Recording::open(path)?.verify()?;
    }
    Ok(report)
}

fn survey(store: &mut Store, starts_only: bool) -> Result<(RepairReport, Vec<Camera>, Rows), FormatError> {
    let mut report = RepairReport {
        reopened: store.state() == FileState::Open,
        cut_short: store.missing().is_some(),
        ..Default::default()
    };
    // What there is, before anything is written.
    let mut cameras = Vec::new();
    for name in camera_names(store)? {
        cameras.push(Camera::survey(store, name, starts_only)?);
    }
    // Half a text is none.
    let text = Rows::survey(store, "evis", &["evis/report_json".into()], true)?;
    refuse_if_nothing_is_left(store, &cameras)?;

    for camera in &mut cameras {
        report.events.push((camera.name.clone(), camera.events.kept));
        report.events_dropped += camera.events.dropped();
        for rows in std::iter::once(&camera.events).chain(&camera.others) {
            report.rows_dropped += rows.dropped();
            report.holes.extend(rows.holes.iter().cloned());
        }
        report.millis_rebuilt += camera.index.survey(store, &mut camera.events)?;
    }
    report.report_dropped = text.dropped() > 0;
    Ok((report, cameras, text))
}

fn save(store: &mut Store, starts_only: bool) -> Result<RepairReport, FormatError> {
    let path = store.path().to_path_buf();
    let (report, mut cameras, mut text) = survey(store, starts_only)?;
    if report.nothing_to_do() {
        Recording::open(&path)?.verify()?;
        return Ok(report);
    }

    // First, so that a repair that is itself killed leaves no file that claims to be complete.
    store.write_contiguous("evis/complete", &[0])?;
    for camera in &mut cameras {
        for rows in std::iter::once(&mut camera.events).chain(&mut camera.others) {
            rows.keep(store)?;
        }
        camera.index.complete(store, &mut camera.events)?;
    }
    text.keep(store)?;
    store.publish(FileState::Closed)?;
    // Groups, names and texts cannot be rebuilt; whether they are there, the reader knows.
    Recording::open(&path)?.verify()?;
    Ok(report)
}

fn camera_names(store: &mut Store) -> Result<Vec<String>, FormatError> {
    let mut roots = store.names("")?;
    if !roots.iter().any(|name| name == "evis") {
        return Err(FormatError::corrupt(
            store.path(),
            "it has no group evis",
            "give a recording that EVIS wrote",
        ));
    }
    roots.retain(|name| !RESERVED_NAMES.contains(&name.as_str()));
    Ok(roots)
}

/// A file that would be emptied is better left to whoever has the rest of it.
fn refuse_if_nothing_is_left(store: &Store, cameras: &[Camera]) -> Result<(), FormatError> {
    let content = || cameras.iter().flat_map(|c| std::iter::once(&c.events).chain(c.others.iter().skip(1)));
    let (kept, promised) =
        content().fold((0, 0), |(kept, promised), rows| (kept + rows.kept, promised + rows.promised));
    if kept > 0 || promised == 0 {
        return Ok(());
    }
    let events: u64 = cameras.iter().map(|c| c.events.promised).sum();
    let extent = store.missing().map_or_else(String::new, |(found, promised)| {
        format!("it is cut short ({found} of {promised} bytes), and ")
    });
    let images = match promised - events {
        0 => String::new(),
        images => format!(" and {images} label images"),
    };
    Err(FormatError::corrupt(
        store.path(),
        format!("{extent}none of its {events} events{images} can be saved"),
        "it was left as it is: copy it again from its source, or record it again",
    ))
}

/// What a camera has.
struct Camera {
    name: String,
    events: Rows,
    index: Index,
    /// Poses, then a label each.
    others: Vec<Rows>,
}

impl Camera {
    fn survey(store: &mut Store, name: String, starts_only: bool) -> Result<Self, FormatError> {
        let present = store.names(&format!("{name}/events"))?;
        let all = ["x", "y", "t", "p", "cause"].into_iter();
        let columns: Vec<String> = all
            .filter(|c| *c != "cause" || present.iter().any(|name| name == c))
            .map(|c| format!("{name}/events/{c}"))
            .collect();
        let mut events = Rows::survey(store, &format!("{name}/events"), &columns, starts_only)?;
        events.find_times(store)?;
        let index = Index { column: Column::open(store, &format!("{name}/ms_to_idx"))?, kept: 0, wanted: 0 };

        let poses = ["t_us", "position", "rotation_xyzw"].map(|c| format!("{name}/poses/{c}"));
        let mut others = vec![Rows::survey(store, &format!("{name}/poses"), &poses, starts_only)?];
        let labels = store.names(&format!("{name}/labels"))?;
        for kind in labels.iter().filter(|name| !name.ends_with("_us")) {
            let times = ["_t_us", "_t_other_us", "_t_end_us"].map(|ending| format!("{kind}{ending}"));
            let parts: Vec<String> = std::iter::once(kind.clone())
                .chain(times)
                .filter(|part| labels.contains(part))
                .map(|part| format!("{name}/labels/{part}"))
                .collect();
            others.push(Rows::survey(store, &format!("{name}/labels/{kind}"), &parts, starts_only)?);
        }
        Ok(Self { name, events, index, others })
    }
}

/// Columns that belong together.
struct Rows {
    columns: Vec<Column>,
    /// Number of rows that stay.
    kept: u64,
    /// Those that stay: all columns have them.
    ranges: Vec<Range<u64>>,
    /// What lies between them.
    holes: Vec<Hole>,
    /// Rows that the longest of them promises.
    promised: u64,
}

impl Rows {
    /// `part` names the table; with `starts_only`, nothing after a hole stays.
    fn survey(
        store: &mut Store,
        part: &str,
        names: &[String],
        starts_only: bool,
    ) -> Result<Self, FormatError> {
        let mut columns = names.iter().map(|n| Column::open(store, n)).collect::<Result<Vec<_>, _>>()?;
        let mut damaged: Vec<_> = columns.iter_mut().flat_map(|c| c.damaged_rows(store)).collect();
        damaged.sort_unstable_by_key(|rows| rows.start);
        let promised = columns.iter().map(Column::rows_published).max().unwrap_or(0);
        // Where a column ends, so do the others.
        let end = columns.iter().map(Column::rows_published).min().unwrap_or(0);
        let (mut ranges, mut at) = (Vec::new(), 0);
        for rows in damaged {
            if at < rows.start.min(end) {
                ranges.push(at..rows.start.min(end));
            }
            at = at.max(rows.end);
        }
        if at < end {
            ranges.push(at..end);
        }
        if starts_only {
            ranges.retain(|rows| rows.start == 0);
        }
        let mut holes = Vec::new();
        let mut before = 0;
        for rows in &ranges {
            if before < rows.start {
                holes.push(Hole { part: part.into(), first: before, end: rows.start, between_us: None });
            }
            before = rows.end;
        }
        let kept = ranges.iter().map(|rows| rows.end - rows.start).sum();
        Ok(Self { columns, kept, ranges, holes, promised })
    }

    /// Tells when the holes in a table of events are.
    fn find_times(&mut self, store: &mut Store) -> Result<(), FormatError> {
        let mut holes = std::mem::take(&mut self.holes);
        if let Some(times) = self.times() {
            for hole in holes.iter_mut().filter(|hole| hole.first > 0) {
                let (from, to) = (value(times, store, hole.first - 1)?, value(times, store, hole.end)?);
                hole.between_us = Some((from as i64, to as i64));
            }
        }
        self.holes = holes;
        Ok(())
    }

    const fn dropped(&self) -> u64 {
        self.promised.saturating_sub(self.kept)
    }

    fn keep(&mut self, store: &mut Store) -> Result<(), FormatError> {
        for column in &mut self.columns {
            column.keep(store, &self.ranges)?;
        }
        Ok(())
    }

    /// Times of events.
    fn times(&mut self) -> Option<&mut Column> {
        self.columns.get_mut(2)
    }
}

/// `ms_to_idx`: exactly one entry per millisecond up to the last event.
struct Index {
    column: Column,
    /// Entries that stay.
    kept: u64,
    /// Entries that there should be.
    wanted: u64,
}

impl Index {
    /// How many entries have to go or to be added.
    fn survey(&mut self, store: &mut Store, events: &mut Rows) -> Result<u64, FormatError> {
        let had = self.column.rows_published();
        let readable = self.column.readable_rows(store);
        let last = events.ranges.last().map(|rows| rows.end - 1);
        let has_holes = !events.holes.is_empty();
        if let (Some(last), Some(t)) = (last, events.times()) {
            let last = value(t, store, last)?;
            if last > LATEST_US.unsigned_abs() {
                return Err(FormatError::corrupt(
                    store.path(),
                    format!("its last event comes at {last} us, past 31 days"),
                    "record it again, or copy it again from its source",
                ));
            }
            self.wanted = last / 1000 + 1;
        }
        self.kept = readable.min(self.wanted);
        // An entry that leads nowhere makes the others suspect.
        let (mut before, mut fine) = (0, true);
        self.column.for_each_chunk(store, 0..self.kept, |bytes| {
            for entry in bytes.chunks_exact(8).map(little_endian) {
                fine &= before <= entry && entry < events.kept;
                before = entry;
            }
        })?;
        // Behind a hole all events have other numbers.
        if !fine || has_holes {
            self.kept = 0;
        }
        Ok(had.abs_diff(self.kept) + (self.wanted - self.kept))
    }

    fn complete(&mut self, store: &mut Store, events: &mut Rows) -> Result<(), FormatError> {
        let index = &mut self.column;
        index.resume(store, self.kept)?;
        let (true, count, Some(t)) = (self.kept < self.wanted, events.kept, events.times()) else {
            return Ok(());
        };
        // The last entry says where to go on; without one, at the first event.
        let mut row = match self.kept.checked_sub(1) {
            Some(last) => value(index, store, last)?,
            None => 0,
        };
        let (mut next, wanted) = (self.kept, self.wanted);
        let width = t.row_bytes();
        let mut entries: Vec<u64> = Vec::new();
        t.for_each_chunk(store, row..count, |bytes| {
            for t in bytes.chunks_exact(width) {
                while next < wanted.min(little_endian(t) / 1000 + 1) {
                    entries.push(row);
                    next += 1;
                }
                row += 1;
            }
        })?;
        index.push_each(entries.iter().map(|e| e.to_le_bytes()));
        index.commit(store)
    }
}

fn little_endian(bytes: &[u8]) -> u64 {
    bytes.iter().take(8).rev().fold(0, |value, &byte| value << 8 | u64::from(byte))
}

/// One value of a column of whole numbers.
fn value(column: &mut Column, store: &mut Store, row: u64) -> Result<u64, FormatError> {
    let mut value = 0;
    column.for_each_chunk(store, row..row + 1, |bytes| value = little_endian(bytes))?;
    Ok(value)
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

    /// 150 000 events of a camera named cam.
    fn record(path: &Path) -> Vec<Event> {
        let camera = CameraInfo::uncalibrated("cam", (9, 9));
        let header = RecordingHeader { method: "native".into(), ..RecordingHeader::of(vec![camera]) };
        let events: Vec<_> = (0..150_000).map(|i| Event::new(i * 137, 1, 2, Polarity::Off)).collect();
        let mut writer = RecordingWriter::create(path, &header, true).unwrap();
        writer.write_events(0, &events).unwrap();
        writer.finish("{}").unwrap();
        events
    }

    #[test]
    fn a_complete_file_whose_parts_do_not_fit_is_refused_until_repaired() {
        let path = std::env::temp_dir().join(format!("evis_unfit_{}.h5", std::process::id()));
        let events = record(&path);
        let whole = stored_index(&path);
        assert!(Recording::open(&path).unwrap().events(0).unwrap() == events, "canary: it reads");

        // An index that leads far past the events.
        let mut store = Store::open(&path).unwrap();
        let mut index = Column::open(&mut store, "cam/ms_to_idx").unwrap();
        index.resume(&mut store, 0).unwrap();
        index.push_each(whole.iter().map(|_| 1_000_000_000_000_u64.to_le_bytes()));
        index.commit(&mut store).unwrap();
        store.publish(FileState::Closed).unwrap();
        drop(store);
        let recording = Recording::open(&path).unwrap();
        assert!(recording.is_complete().unwrap());
        let error = recording.events_between(0, 0, 9_000).unwrap_err().to_string();
        assert!(error.contains("leads to event 1000000000000 at 0 ms, of 150000 events"), "{error}");
        let report = repair(&path).unwrap();
        assert_eq!((report.rows_dropped, report.millis_rebuilt), (0, 2 * whole.len() as u64));
        assert_eq!(stored_index(&path), whole);
        assert!(!recording.is_complete().unwrap(), "what was repaired does not count as complete");

        record(&path);
        let mut store = Store::open(&path).unwrap();
        Column::open(&mut store, "cam/events/x").unwrap().resume(&mut store, 10).unwrap();
        drop(store);
        let error = Recording::open(&path).unwrap().event_count(0).unwrap_err().to_string();
        assert!(error.contains("unlike lengths (x 10, y 150000, t 150000, p 150000)"), "{error}");
        let report = repair(&path).unwrap();
        assert_eq!((report.events_dropped, report.cut_short), (149_990, false));
        assert!(Recording::open(&path).unwrap().events(0).unwrap() == events[..10]);
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn columns_out_of_step_are_brought_together() {
        let path = std::env::temp_dir().join(format!("evis_repair_{}.h5", std::process::id()));
        let events = record(&path);
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

    /// Where chunk `chunk` of a column lies in the file.
    fn place(path: &Path, name: &str, chunk: u64) -> Range<usize> {
        let mut store = Store::open_to_read(path).unwrap();
        let (at, bytes) = Column::open(&mut store, name).unwrap().place(&mut store, chunk).unwrap();
        at as usize..(at + bytes) as usize
    }

    #[test]
    fn a_hole_in_the_middle_costs_its_own_rows_alone() {
        let path = std::env::temp_dir().join(format!("evis_hole_{}.h5", std::process::id()));
        let events = record(&path);
        let whole = std::fs::read(&path).unwrap();
        assert!(check(&path).unwrap().nothing_to_do());
        let mut damaged = whole.clone();
        damaged[place(&path, "cam/events/x", 1)].fill(0);
        std::fs::write(&path, &damaged).unwrap();
        assert!(Recording::open(&path).unwrap().events(0).is_err(), "canary: it is damaged");

        let report = check(&path).unwrap();
        let hole = Hole {
            part: "cam/events".into(),
            first: 65_536,
            end: 131_072,
            between_us: Some((65_535 * 137, 131_072 * 137)),
        };
        assert_eq!((report.holes.as_slice(), report.events_dropped), ([hole.clone()].as_slice(), 65_536));
        assert_eq!(hole.to_string(), "rows 65536 to 131071 of cam/events (between 8978295 and 17956864 us)");
        assert!(std::fs::read(&path).unwrap() == damaged, "a check writes nothing");

        assert_eq!(repair(&path).unwrap().events, [("cam".to_string(), 150_000 - 65_536)]);
        let kept = [&events[..65_536], &events[131_072..]].concat();
        let recording = Recording::open(&path).unwrap();
        assert!(recording.events(0).unwrap() == kept);
        let index: Vec<u64> = (0..=kept.last().unwrap().t / 1000)
            .map(|ms| kept.partition_point(|e| e.t < ms * 1000) as u64)
            .collect();
        assert_eq!(stored_index(&path), index);
        assert!(!recording.is_complete().unwrap());
        assert!(repair(&path).unwrap().nothing_to_do(), "once is enough");
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn whatever_is_damaged_a_repair_leaves_a_file_that_reads_or_the_file_as_it_was() {
        let path = std::env::temp_dir().join(format!("evis_zeros_{}.h5", std::process::id()));
        record(&path);
        let whole = std::fs::read(&path).unwrap();
        let mut state = 5_u64;
        let mut random = |below: usize| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize % below
        };
        let (mut repaired, mut refused) = (0, 0);
        for round in 0..120 {
            let mut damaged = whole.clone();
            let at = random(damaged.len());
            match round % 3 {
                // A page that never reached the disk.
                0 => {
                    let page = at / 4096 * 4096;
                    let end = (page + 4096).min(damaged.len());
                    damaged[page..end].fill(0);
                }
                1 => damaged[at] ^= 1 << random(8),
                _ => damaged.truncate(at),
            }
            // Writing over the old file would wait for the disk each time.
            std::fs::remove_file(&path).unwrap();
            std::fs::write(&path, &damaged).unwrap();
            match repair(&path) {
                Ok(_) => {
                    repaired += 1;
                    Recording::open(&path).unwrap().verify().unwrap();
                }
                Err(_) => {
                    refused += 1;
                    assert!(
                        std::fs::read(&path).unwrap() == damaged,
                        "round {round} changed a file it refused"
                    );
                }
            }
        }
        assert!(repaired > 40 && refused > 10, "{repaired} repaired, {refused} refused");
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn changed_scalars_are_noticed() {
        let path = std::env::temp_dir().join(format!("evis_scalars_{}.h5", std::process::id()));
        record(&path);
        let whole = std::fs::read(&path).unwrap();
        let intrinsic = whole.windows(8).position(|w| w == 9_i64.to_le_bytes()).unwrap();
        for (at, bit) in [(intrinsic, 1), (intrinsic + 1, 4)] {
            let mut damaged = whole.clone();
            damaged[at] ^= 1 << bit;
            std::fs::write(&path, &damaged).unwrap();
            // Sizes stand in two places; one of them is for DSEC's readers and is not read.
            if let Ok(recording) = Recording::open(&path) {
                assert_eq!(recording.header().cameras[0].width, 9);
            }
        }
        let seed = whole.windows(6).position(|w| w == b"native").unwrap();
        let mut damaged = whole.clone();
        damaged[seed] ^= 1;
        std::fs::write(&path, &damaged).unwrap();
        assert!(Recording::open(&path).is_err());
        std::fs::remove_file(&path).unwrap();
    }
}
