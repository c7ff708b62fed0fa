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
    /// Rows dropped because a column of their event, label, pose, inertial sample or state was missing or damaged; events among them.
    pub rows_dropped: u64,
    /// The writer's report was there and could not be saved.
    pub report_dropped: bool,
    /// What cannot be read of each table, numbered as it was before.
    pub holes: Vec<Hole>,
}

/// Rows of a table that cannot be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hole {
    /// The table: `left/events`, `left/poses`, `left/labels/depth`, `imus/head`, `states/arm`, `bodies`.
    pub part: String,
    /// First row.
    pub first: u64,
    /// The row after the last one.
    pub end: u64,
    /// The time of the row before it and of the one after it, where there are both, microseconds.
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
    let (report, _) = survey(&mut Store::open_to_read(path)?, false)?;
    if report.nothing_to_do() {
        Recording::open(path)?.verify()?;
    } else if !report.cut_short {
        // Names and settings cannot be rebuilt: no repair is to be promised where they are damaged.
        Recording::open(path)?.body_infos()?;
    }
    Ok(report)
}

/// What a file has that a repair can shorten.
struct Tables {
    cameras: Vec<Camera>,
    /// What there is beside the cameras: tables of inertial samples and of states, and the poses of bodies.
    extras: Vec<Rows>,
    /// The writer's report.
    text: Rows,
}

fn survey(store: &mut Store, starts_only: bool) -> Result<(RepairReport, Tables), FormatError> {
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
    let extras = survey_extras(store, starts_only)?;
    // Half a text is none.
    let text = Rows::survey(store, "evis", &["evis/report_json".into()], true)?;
    refuse_if_nothing_is_left(store, &cameras)?;

    for camera in &mut cameras {
        report.events.push((camera.name.clone(), camera.events.kept));
        report.events_dropped += camera.events.dropped();
        report.millis_rebuilt += camera.index.survey(store, &mut camera.events)?;
    }
    let of_cameras = cameras.iter().flat_map(|c| std::iter::once(&c.events).chain(&c.others));
    for rows in of_cameras.chain(&extras) {
        report.rows_dropped += rows.dropped();
        report.holes.extend(rows.holes.iter().cloned());
    }
    report.report_dropped = text.dropped() > 0;
    Ok((report, Tables { cameras, extras, text }))
}

fn save(store: &mut Store, starts_only: bool) -> Result<RepairReport, FormatError> {
    let path = store.path().to_path_buf();
    let (report, mut tables) = survey(store, starts_only)?;
    if report.nothing_to_do() {
        Recording::open(&path)?.verify()?;
        return Ok(report);
    }

    // First, so that a repair that is itself killed leaves no file that claims to be complete.
    store.write_contiguous("evis/complete", &[0])?;
    for camera in &mut tables.cameras {
        for rows in std::iter::once(&mut camera.events).chain(&mut camera.others) {
            rows.keep(store)?;
        }
        camera.index.complete(store, &mut camera.events)?;
    }
    for rows in tables.extras.iter_mut().chain(std::iter::once(&mut tables.text)) {
        rows.keep(store)?;
    }
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

fn survey_extras(store: &mut Store, starts_only: bool) -> Result<Vec<Rows>, FormatError> {
    let mut extras = Vec::new();
    for name in store.names("imus")? {
        let part = format!("imus/{name}");
        let columns = ["t_us", "accelerometer", "gyroscope"].map(|c| format!("{part}/{c}"));
        extras.push(Rows::survey(store, &part, &columns, starts_only)?);
    }
    for name in store.names("states")? {
        let part = format!("states/{name}");
        let columns = ["t_us", "values"].map(|c| format!("{part}/{c}"));
        extras.push(Rows::survey(store, &part, &columns, starts_only)?);
    }
    if store.find("bodies")?.is_some() {
        let columns = ["t_us", "position", "rotation_xyzw", "linear_velocity", "angular_velocity"];
        extras.push(Rows::survey(store, "bodies", &columns.map(|c| format!("bodies/{c}")), starts_only)?);
    }
    Ok(extras)
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
        let events = Rows::survey(store, &format!("{name}/events"), &columns, starts_only)?;
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
    /// Which of them has the times of the rows.
    time_column: Option<usize>,
    /// Number of rows that stay.
    kept: u64,
    /// Those that stay: all columns have them.
    ranges: Vec<Range<u64>>,
    /// What cannot be read before, between and after them.
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
        let kept = ranges.iter().map(|rows| rows.end - rows.start).sum();
        let time_column = names.iter().position(|name| name.ends_with("/t") || name.ends_with("t_us"));
        let mut rows = Self { columns, time_column, kept, ranges, holes: Vec::new(), promised };
        rows.holes = rows.find_holes(store, part, end)?;
        Ok(rows)
    }

    /// The holes among the first `end` rows, and when they are.
    fn find_holes(&mut self, store: &mut Store, part: &str, end: u64) -> Result<Vec<Hole>, FormatError> {
        let (mut holes, mut before) = (Vec::new(), 0);
        for rows in self.ranges.iter().chain([&(end..end)]) {
            if before < rows.start {
                holes.push(Hole { part: part.into(), first: before, end: rows.start, between_us: None });
            }
            before = rows.end;
        }
        if let Some(times) = self.times() {
            for hole in holes.iter_mut().filter(|hole| 0 < hole.first && hole.end < end) {
                let (from, to) = (value(times, store, hole.first - 1)?, value(times, store, hole.end)?);
                hole.between_us = Some((from as i64, to as i64));
            }
        }
        Ok(holes)
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

    /// The times of the rows.
    fn times(&mut self) -> Option<&mut Column> {
        self.columns.get_mut(self.time_column?)
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
        let renumbered = last.is_some_and(|last| last >= events.kept);
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
        if !fine || renumbered {
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
    use crate::format::hdf5::{
        BodyInfo, BodySample, RecordingExtras, RecordingHeader, RecordingWriter, StateInfo,
    };
    use crate::packet::{CameraInfo, ImuSample, LabelData, LabelFrame, LabelKind, PoseSample};

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

    /// Rows of each table beside the events: three chunks where a chunk has 1024 rows.
    const SAMPLES: i64 = 2500;

    /// 20 000 events of a camera named cam, its poses and depth images, a state, poses of two bodies and samples of two
    /// inertial units. The second unit has a single chunk.
    fn record_all_kinds(path: &Path) -> Vec<Event> {
        let labels = vec![LabelKind::Depth];
        let header = RecordingHeader {
            labels,
            method: "native".into(),
            ..RecordingHeader::of(vec![CameraInfo::uncalibrated("cam", (9, 9))])
        };
        let body = |name: &str, instance_id| BodyInfo {
            name: name.into(),
            instance_id,
            semantic_id: 7,
            semantic_name: "toy".into(),
            bounds: [[-1.5; 3], [1.5; 3]],
        };
        let extras = RecordingExtras {
            imus: vec!["head".into(), "foot".into()],
            bodies: vec![body("ball", 1), body("block", 2)],
            states: vec![StateInfo { name: "arm".into(), values: vec!["shoulder".into(), "elbow".into()] }],
        };
        let mut state = 3_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let events: Vec<_> = (0..20_000).map(|i| Event::new(i * 137, 1, 2, Polarity::Off)).collect();
        let mut writer = RecordingWriter::create_with_extras(path, &header, &extras, true).unwrap();
        writer.write_events(0, &events).unwrap();
        for k in 0..SAMPLES {
            let t_us = 1000 * k;
            let mut vector = || [random(), random(), random()];
            let pose = PoseSample { t_us, position: vector(), rotation: [0.0, 0.0, 0.0, 1.0] };
            writer.write_pose(0, &pose).unwrap();
            writer.write_state(0, &[t_us], &vector()[..2]).unwrap();
            let mut sample = || ImuSample { t_us, accelerometer: vector(), gyroscope: vector() };
            writer.write_imu(0, &[sample()]).unwrap();
            if k < 400 {
                writer.write_imu(1, &[sample()]).unwrap();
            }
            let mut body = || BodySample {
                position: vector(),
                rotation: [0.0, 0.0, 0.0, 1.0],
                linear_velocity: vector(),
                angular_velocity: vector(),
            };
            writer.write_bodies(t_us, &[body(), body()]).unwrap();
            if k % 100 == 0 {
                let data = LabelData::F32((0..81).map(|_| random() as f32).collect());
                let label = LabelFrame { kind: LabelKind::Depth, t_us, t_other_us: t_us, data };
                writer.write_label(0, &label).unwrap();
            }
        }
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
    fn a_hole_in_poses_labels_or_samples_costs_no_event() {
        let path = std::env::temp_dir().join(format!("evis_extras_{}.h5", std::process::id()));
        let events = record_all_kinds(&path);
        assert!(check(&path).unwrap().nothing_to_do());
        let before = Recording::open(&path).unwrap();
        let (poses, head, bodies) =
            (before.poses(0).unwrap(), before.imu("head").unwrap(), before.bodies().unwrap());
        let whole = std::fs::read(&path).unwrap();
        let cases = [
            ("cam/poses/position", 1, "rows 1024 to 2047 of cam/poses (between 1023000 and 2048000 us)"),
            ("cam/labels/depth", 3, "rows 3 to 3 of cam/labels/depth (between 200000 and 400000 us)"),
            ("imus/head/gyroscope", 1, "rows 1024 to 2047 of imus/head (between 1023000 and 2048000 us)"),
            ("imus/foot/accelerometer", 0, "rows 0 to 399 of imus/foot"),
            ("states/arm/values", 1, "rows 1024 to 2047 of states/arm (between 1023000 and 2048000 us)"),
            ("bodies/angular_velocity", 1, "rows 1024 to 2047 of bodies (between 1023000 and 2048000 us)"),
            ("bodies/t_us", 2, "rows 2048 to 2499 of bodies"),
        ];
        for (column, chunk, hole) in cases {
            let mut damaged = whole.clone();
            damaged[place(&path, column, chunk)].fill(0);
            std::fs::write(&path, &damaged).unwrap();
            assert!(Recording::open(&path).unwrap().verify().is_err(), "canary: {column} is damaged");
            let report = check(&path).unwrap();
            let holes: Vec<_> = report.holes.iter().map(ToString::to_string).collect();
            assert_eq!(holes, [hole], "{column}");
            assert!(std::fs::read(&path).unwrap() == damaged, "a check writes nothing");
            assert_eq!(repair(&path).unwrap(), report, "{column}");
            assert_eq!((report.events_dropped, report.millis_rebuilt), (0, 0), "{column}");
            assert!(Recording::open(&path).unwrap().events(0).unwrap() == events, "{column}");
            assert!(check(&path).unwrap().nothing_to_do(), "{column}: once is enough");
            std::fs::write(&path, &whole).unwrap();
        }

        // All at once.
        let mut damaged = whole;
        for (column, chunk, _) in &cases[..6] {
            damaged[place(&path, column, *chunk)].fill(0);
        }
        std::fs::write(&path, &damaged).unwrap();
        assert_eq!(repair(&path).unwrap().rows_dropped, 4 * 1024 + 400 + 1);
        let recording = Recording::open(&path).unwrap();
        assert!(recording.events(0).unwrap() == events);
        assert_eq!(recording.poses(0).unwrap(), [&poses[..1024], &poses[2048..]].concat());
        assert_eq!(recording.imu("head").unwrap(), [&head[..1024], &head[2048..]].concat());
        assert!(recording.imu("foot").unwrap().is_empty());
        let kept = recording.bodies().unwrap();
        assert_eq!(kept.infos, bodies.infos);
        assert_eq!(kept.t_us, [&bodies.t_us[..1024], &bodies.t_us[2048..]].concat());
        assert_eq!(kept.samples, [&bodies.samples[..1024], &bodies.samples[2048..]].concat());
        assert_eq!(recording.label_times(0, LabelKind::Depth).unwrap().len(), 24);
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn samples_without_an_event_are_no_reason_to_drop_all_events() {
        let path = std::env::temp_dir().join(format!("evis_no_events_{}.h5", std::process::id()));
        record_all_kinds(&path);
        let mut damaged = std::fs::read(&path).unwrap();
        damaged[place(&path, "cam/events/x", 0)].fill(0);
        for frame in 0..25 {
            damaged[place(&path, "cam/labels/depth", frame)].fill(0);
        }
        std::fs::write(&path, &damaged).unwrap();
        let error = repair(&path).unwrap_err().to_string();
        assert!(error.contains("none of its 20000 events and 25 label images can be saved"), "{error}");
        assert!(std::fs::read(&path).unwrap() == damaged, "it is left as it was");
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn a_check_promises_no_repair_where_the_list_of_bodies_is_damaged() {
        let path = std::env::temp_dir().join(format!("evis_bodies_{}.h5", std::process::id()));
        record_all_kinds(&path);
        let mut damaged = std::fs::read(&path).unwrap();
        damaged[place(&path, "imus/head/gyroscope", 1)].fill(0);
        std::fs::write(&path, &damaged).unwrap();
        assert!(!check(&path).unwrap().nothing_to_do(), "canary: the hole alone can be repaired");
        let low = [-1.5_f64; 6].map(f64::to_le_bytes).concat();
        let at = damaged.windows(low.len()).position(|w| w == low).unwrap();
        damaged[at] ^= 1;
        std::fs::write(&path, &damaged).unwrap();
        for error in [check(&path).unwrap_err(), repair(&path).unwrap_err()] {
            assert!(error.to_string().contains("not those that were written (bodies_hash)"), "{error}");
        }
        assert!(std::fs::read(&path).unwrap() == damaged, "it is left as it was");
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn whatever_is_damaged_a_repair_leaves_a_file_that_reads_or_the_file_as_it_was() {
        let [events_alone, all_kinds] = [
            (record as fn(&Path) -> Vec<Event>, "evis_zeros"),
            (record_all_kinds, "evis_zeros_of_all_kinds"),
        ]
        .map(|(record, name)| damage_and_repair(record, name));
        println!("repaired and refused: {events_alone:?} of events alone, {all_kinds:?} of all kinds");
        assert!(events_alone[0] > 40 && events_alone[1] > 10, "{events_alone:?}");
        assert!(all_kinds[0] > 40 && all_kinds[1] > 10, "{all_kinds:?}");
    }

    /// How many of 120 damaged files were repaired, and how many refused.
    fn damage_and_repair(record: fn(&Path) -> Vec<Event>, name: &str) -> [u32; 2] {
        let path = std::env::temp_dir().join(format!("{name}_{}.h5", std::process::id()));
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
            let checked = check(&path);
            match repair(&path) {
                Ok(_) => {
                    repaired += 1;
                    Recording::open(&path).unwrap().verify().unwrap();
                }
                Err(error) => {
                    refused += 1;
                    assert!(checked.is_err(), "round {round}: {checked:?}, and {error}");
                    assert!(
                        std::fs::read(&path).unwrap() == damaged,
                        "round {round} changed a file it refused"
                    );
                }
            }
        }
        std::fs::remove_file(&path).unwrap();
        [repaired, refused]
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
