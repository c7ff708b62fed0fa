//! Writing a recording while it happens.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use evis_limits::{behind_links, draft_path};
use rayon::prelude::*;
use rust_hdf5::{FilterPipeline, H5File, Hdf5Error};

use super::column::{Column, compress};
use super::layout::{
    LATEST_US, check_header, creation_error, is_narrow, lay_out, lay_out_bodies, lay_out_imus, lay_out_states,
};
use super::store::{FileState, Store};
use super::{
    BodyInfo, BodySample, EVENTS_PER_CHUNK, LabelType, RecordingHeader, StateInfo, has_other_time,
    is_group_name,
};
use crate::event::{Cause, Event};
use crate::format::FormatError;
use crate::packet::{CameraInfo, ImuSample, LabelData, LabelFrame, LabelKind, PoseSample};

/// Time between automatic flushes; below the promised second by what a flush may take.
const FLUSH_EVERY: Duration = Duration::from_millis(800);
/// Full chunks per column that are compressed together: bounds memory, feeds every thread.
const CHUNKS_AT_ONCE: usize = 8;
/// Entries of `ms_to_idx` that one silence adds before they are stored: bounds memory.
const MILLIS_AT_ONCE: u64 = 1 << 18;

/// Writes a recording; see the module for the layout and for what survives a kill.
///
/// [`RecordingWriter::finish`] closes the file. A writer that is dropped stores what it holds and closes
/// the file as well as it can, but the recording then counts as incomplete.
pub struct RecordingWriter {
    store: Store,
    cameras: Vec<CameraColumns>,
    imus: Vec<ImuColumns>,
    states: Vec<StateColumns>,
    /// Where the writer was given any.
    bodies: Option<BodyColumns>,
    report: Column,
    last_flush: Instant,
    state: WriterState,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum WriterState {
    Writing,
    /// A write failed: nothing more is written, the file stays as the last commit left it.
    Failed,
    Finished,
}

struct CameraColumns {
    info: CameraInfo,
    x: Column,
    y: Column,
    t: Column,
    p: Column,
    /// Where the header announced it.
    cause: Option<Column>,
    /// `t` is u32.
    narrow: bool,
    ms_to_idx: Column,
    last_t: i64,
    labels: Vec<LabelColumns>,
    pose_t: Column,
    position: Column,
    rotation: Column,
}

/// What a recording may hold beside its cameras.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordingExtras {
    /// Names of inertial measurement units.
    pub imus: Vec<String>,
    /// Objects and cameras that are named, and followed where samples of them are written.
    pub bodies: Vec<BodyInfo>,
    /// What a host says of its own state: joints, commands, rewards.
    pub states: Vec<StateInfo>,
}

/// Most values of a [`StateInfo`].
const MOST_STATE_VALUES: usize = 4096;

struct BodyColumns {
    count: usize,
    t: Column,
    position: Column,
    rotation: Column,
    linear_velocity: Column,
    angular_velocity: Column,
    last_t: Option<i64>,
}

struct ImuColumns {
    t: Column,
    accelerometer: Column,
    gyroscope: Column,
    last_t: Option<i64>,
}

struct StateColumns {
    width: usize,
    t: Column,
    values: Column,
    last_t: Option<i64>,
}

struct LabelColumns {
    kind: LabelKind,
    data: Column,
    t: Column,
    t_other: Option<Column>,
    /// End of an exposure.
    t_end: Option<Column>,
    last_t: Option<i64>,
}

impl RecordingWriter {
    /// Creates the file at `path` with everything that `header` says, empty data sets included.
    ///
    /// # Errors
    /// An existing file without `overwrite`, a folder that cannot be written to, a full disk, and a
    /// header that makes no recording (no camera, a name that is taken or has a slash, an empty or huge
    /// image, a negative duration). Then the file at `path` is what it was before.
    pub fn create(path: &Path, header: &RecordingHeader, overwrite: bool) -> Result<Self, FormatError> {
        Self::create_with(path, header, overwrite, |_| Ok(()))
    }

    /// The same, with everything that a recording may hold beside its cameras.
    ///
    /// # Errors
    /// As [`RecordingWriter::create`]; names of inertial measurement units or states that are empty, taken or have a slash; a
    /// state without values or with more than 4096.
    pub fn create_with_extras(
        path: &Path,
        header: &RecordingHeader,
        extras: &RecordingExtras,
        overwrite: bool,
    ) -> Result<Self, FormatError> {
        let RecordingExtras { imus, bodies, states } = extras;
        check_names(
            path,
            ["an inertial measurement unit", "inertial measurement units"],
            &imus.iter().map(String::as_str).collect::<Vec<_>>(),
        )?;
        check_names(
            path,
            ["a state", "states"],
            &states.iter().map(|state| state.name.as_str()).collect::<Vec<_>>(),
        )?;
        if let Some(wrong) = states.iter().find(|s| !(1..=MOST_STATE_VALUES).contains(&s.values.len())) {
            let what = format!("the state {:?} has {} values", wrong.name, wrong.values.len());
            return Err(FormatError::invalid(path, what, format!("name 1 to {MOST_STATE_VALUES}")));
        }
        let lay_out = |file: &H5File| {
            lay_out_imus(file, imus)?;
            lay_out_states(file, states)?;
            lay_out_bodies(file, header, bodies)
        };
        let mut writer = Self::create_with(path, header, overwrite, lay_out)?;
        if !bodies.is_empty() {
            let mut column = |part: &str| Column::open(&mut writer.store, &format!("bodies/{part}"));
            writer.bodies = Some(BodyColumns {
                count: bodies.len(),
                t: column("t_us")?,
                position: column("position")?,
                rotation: column("rotation_xyzw")?,
                linear_velocity: column("linear_velocity")?,
                angular_velocity: column("angular_velocity")?,
                last_t: None,
            });
        }
        for name in imus {
            let mut column = |part: &str| Column::open(&mut writer.store, &format!("imus/{name}/{part}"));
            let (t, accelerometer, gyroscope) =
                (column("t_us")?, column("accelerometer")?, column("gyroscope")?);
            writer.imus.push(ImuColumns { t, accelerometer, gyroscope, last_t: None });
        }
        for StateInfo { name, values } in states {
            let mut column = |part: &str| Column::open(&mut writer.store, &format!("states/{name}/{part}"));
            let (t, width) = (column("t_us")?, values.len());
            writer.states.push(StateColumns { width, t, values: column("values")?, last_t: None });
        }
        Ok(writer)
    }

    /// The same for a file that has more than a recording, which `extra` lays out.
    pub(super) fn create_with(
        path: &Path,
        header: &RecordingHeader,
        overwrite: bool,
        extra: impl FnOnce(&H5File) -> Result<(), Hdf5Error>,
    ) -> Result<Self, FormatError> {
        check_header(path, header)?;
        if let Ok(existing) = fs::metadata(path) {
            if !existing.is_file() {
                return Err(FormatError::invalid(
                    path,
                    "the output is not a regular file",
                    "name a new file, or an old one to overwrite",
                ));
            }
            if !overwrite {
                return Err(FormatError::Exists { path: path.into() });
            }
        }
        // Laid out under another name and then moved, so that a failure leaves no half-written file and
        // an old file lives until its successor stands.
        let io = |e| FormatError::io(path, "create", e);
        let place = behind_links(path).map_err(io)?;
        let draft = draft_path(&place);
        let result = fs::File::create(&draft)
            .map_err(io)
            .and_then(|_| lay_out(&draft, header, extra).map_err(|e| creation_error(path, &e)))
            .and_then(|()| Self::attach(path, &draft, header))
            .and_then(|writer| take_place(path, &draft, &place, overwrite).map(|()| writer));
        if result.is_err() {
            // The first error is the one to report; the draft may not even exist.
            let _ = fs::remove_file(&draft);
        }
        let mut writer = result?;
        writer.store.moved_to(&place);
        Ok(writer)
    }

    /// Opens the laid-out file `draft`, which is to become `path`, for appending.
    fn attach(path: &Path, draft: &Path, header: &RecordingHeader) -> Result<Self, FormatError> {
        let mut store = Store::open(draft)?;
        // Before anybody can find it under its name.
        store.lock_shared();
        store.is_called(path);
        let narrow = is_narrow(header.duration_us);
        let cameras = header
            .cameras
            .iter()
            .map(|info| CameraColumns::open(&mut store, info, narrow, &header.labels))
            .collect::<Result<_, _>>()?;
        let report = Column::open(&mut store, "evis/report_json")?;
        store.publish(FileState::Open)?;
        Ok(Self {
            store,
            cameras,
            imus: Vec::new(),
            states: Vec::new(),
            bodies: None,
            report,
            last_flush: Instant::now(),
            state: WriterState::Writing,
        })
    }

    /// Appends `events` of camera `camera_index`, which continue those written before.
    ///
    /// # Errors
    /// Events that go back in time, lie outside the image, have a polarity other than 0 and 1, or a time
    /// that the file cannot hold; then none of `events` is written. A failed write (disk full) keeps what
    /// was flushed before, and every later call fails too.
    pub fn write_events(&mut self, camera_index: usize, events: &[Event]) -> Result<(), FormatError> {
        self.write_caused_events(camera_index, events, &[])
    }

    /// As [`RecordingWriter::write_events`], with the cause of each event where the header's labels list
    /// [`LabelKind::Cause`]; without any where they do not.
    ///
    /// # Errors
    /// As [`RecordingWriter::write_events`], and a number of causes that is not asked for.
    pub fn write_caused_events(
        &mut self,
        camera_index: usize,
        events: &[Event],
        causes: &[u8],
    ) -> Result<(), FormatError> {
        self.check_usable()?;
        let camera = self.camera(camera_index)?;
        let last_t = self.cameras.get(camera).map_or(0, |c| c.last_t);
        self.check_events(camera, events, last_t)?;
        let wanted =
            if self.cameras.get(camera).is_some_and(|c| c.cause.is_some()) { events.len() } else { 0 };
        if causes.len() != wanted || causes.iter().any(|cause| usize::from(*cause) >= Cause::ALL.len()) {
            let what = format!("{} events came with {} causes", events.len(), causes.len());
            let remedy =
                format!("give {wanted}, each below 4: the header's labels say whether there is a column");
            return Err(FormatError::invalid(self.store.path(), what, remedy));
        }
        let (mut rest, mut causes) = (events, causes);
        while !rest.is_empty() {
            let part = rest.get(..EVENTS_PER_CHUNK * CHUNKS_AT_ONCE).unwrap_or(rest);
            let taken = self.cameras.get_mut(camera).map_or(part.len(), |c| c.push_events(part, causes));
            rest = rest.get(taken..).unwrap_or_default();
            causes = causes.get(taken..).unwrap_or_default();
            self.store_full_chunks()?;
            self.flush_if_due()?;
        }
        self.flush_if_due()
    }

    /// Appends one label image of camera `camera_index`.
    ///
    /// # Errors
    /// A kind that the header did not announce, a wrong number or type of values, a time that goes back;
    /// then nothing is written. Failed writes as in [`RecordingWriter::write_events`].
    pub fn write_label(&mut self, camera_index: usize, frame: &LabelFrame) -> Result<(), FormatError> {
        self.check_usable()?;
        let camera = self.camera(camera_index)?;
        let path = self.store.path().to_path_buf();
        let invalid = |what: String, remedy: &str| Err(FormatError::invalid(&path, what, remedy));
        let Some(columns) = self.cameras.get_mut(camera) else { return Ok(()) };
        let name = frame.kind.name();
        let Some(label) = columns.labels.iter_mut().find(|l| l.kind == frame.kind) else {
            return invalid(format!("label {name} was not announced"), "list it in the header's labels");
        };
        let pixels = columns.info.width as usize * columns.info.height as usize * frame.kind.channels();
        let given = match &frame.data {
            LabelData::F32(v) => v.len(),
            LabelData::U32(v) => v.len(),
            LabelData::U8(v) => v.len(),
        };
        if !LabelType::of(frame.kind).matches(&frame.data) || given != pixels {
            return invalid(
                format!("label {name} at {} us has {given} values of its type", frame.t_us),
                &format!("give {pixels} values of {}", LabelType::of(frame.kind).name()),
            );
        }
        if label.last_t.is_some_and(|last| frame.t_us < last) {
            return invalid(
                format!("label {name} at {} us comes before the last one", frame.t_us),
                "write labels in order of time",
            );
        }
        match &frame.data {
            LabelData::F32(v) => label.data.push(&little_endian(v, f32::to_le_bytes)),
            LabelData::U32(v) => label.data.push(&little_endian(v, u32::to_le_bytes)),
            LabelData::U8(v) => label.data.push(v),
        }
        label.t.push(&frame.t_us.to_le_bytes());
        if let Some(other) = &mut label.t_other {
            other.push(&frame.t_other_us.to_le_bytes());
        }
        if let Some(end) = &mut label.t_end {
            // The middle lies as far from the start as from the end.
            let length = frame.t_us.saturating_sub(frame.t_other_us);
            end.push(&frame.t_us.saturating_add(length).to_le_bytes());
        }
        label.last_t = Some(frame.t_us);
        self.store_full_chunks()?;
        self.flush_if_due()
    }

    /// Appends one pose of camera `camera_index`.
    ///
    /// # Errors
    /// Values that are not finite. Failed writes as in [`RecordingWriter::write_events`].
    pub fn write_pose(&mut self, camera_index: usize, pose: &PoseSample) -> Result<(), FormatError> {
        self.check_usable()?;
        let camera = self.camera(camera_index)?;
        if !pose.position.iter().chain(&pose.rotation).all(|v| v.is_finite()) {
            return Err(FormatError::invalid(
                self.store.path(),
                format!(
                    "the pose at {} us has position {:?} and rotation {:?}",
                    pose.t_us, pose.position, pose.rotation
                ),
                "give finite numbers",
            ));
        }
        if let Some(columns) = self.cameras.get_mut(camera) {
            columns.pose_t.push(&pose.t_us.to_le_bytes());
            columns.position.push(&little_endian(&pose.position, f64::to_le_bytes));
            columns.rotation.push(&little_endian(&pose.rotation, f64::to_le_bytes));
        }
        self.store_full_chunks()?;
        self.flush_if_due()
    }

    /// Appends samples of inertial measurement unit `index`, which continue those written before.
    ///
    /// # Errors
    /// No such unit, a time that goes back, values that are not finite; then none of `samples` is written. Failed writes as in
    /// [`RecordingWriter::write_events`].
    pub fn write_imu(&mut self, index: usize, samples: &[ImuSample]) -> Result<(), FormatError> {
        self.check_usable()?;
        let (count, path) = (self.imus.len(), self.store.path().to_path_buf());
        let Some(columns) = self.imus.get_mut(index) else {
            let what = format!("there is no inertial measurement unit {index}");
            return Err(FormatError::invalid(&path, what, format!("give an index below {count}")));
        };
        let mut last_t = columns.last_t;
        for sample in samples {
            let finite = sample.accelerometer.iter().chain(&sample.gyroscope).all(|v| v.is_finite());
            if !finite || last_t.is_some_and(|last| sample.t_us < last) {
                let what = format!("an inertial sample is {sample:?}");
                return Err(FormatError::invalid(&path, what, "give finite numbers in order of time"));
            }
            last_t = Some(sample.t_us);
        }
        for sample in samples {
            columns.t.push(&sample.t_us.to_le_bytes());
            columns.accelerometer.push(&little_endian(&sample.accelerometer, f64::to_le_bytes));
            columns.gyroscope.push(&little_endian(&sample.gyroscope, f64::to_le_bytes));
        }
        columns.last_t = last_t;
        self.store_full_chunks()?;
        self.flush_if_due()
    }

    /// Appends rows of state `index`, one per time, which continue those written before; `values` has them row by row.
    ///
    /// # Errors
    /// No such state, another number of values, a time that does not come after the one before; then nothing of it is written.
    /// Failed writes as in [`RecordingWriter::write_events`].
    pub fn write_state(&mut self, index: usize, t_us: &[i64], values: &[f64]) -> Result<(), FormatError> {
        self.check_usable()?;
        let (count, path) = (self.states.len(), self.store.path().to_path_buf());
        let Some(columns) = self.states.get_mut(index) else {
            let what = format!("there is no state {index}");
            return Err(FormatError::invalid(&path, what, format!("give an index below {count}")));
        };
        if values.len() != t_us.len() * columns.width {
            let what = format!("{} values were given for {} times", values.len(), t_us.len());
            return Err(FormatError::invalid(&path, what, format!("give {} per time", columns.width)));
        }
        let mut last_t = columns.last_t;
        for &t in t_us {
            if let Some(last) = last_t.filter(|last| t <= *last) {
                let what = format!("the state at {t} us comes after that at {last} us");
                return Err(FormatError::invalid(&path, what, "write them in order of time, each time once"));
            }
            last_t = Some(t);
        }
        for (t, row) in t_us.iter().zip(values.chunks_exact(columns.width)) {
            columns.t.push(&t.to_le_bytes());
            columns.values.push(&little_endian(row, f64::to_le_bytes));
        }
        columns.last_t = last_t;
        self.store_full_chunks()?;
        self.flush_if_due()
    }

    /// Appends where all bodies are at `t_us`, in their order.
    ///
    /// # Errors
    /// A recording without bodies, another number of them, a time that does not come after the last one, values that are not
    /// finite. Failed writes as in [`RecordingWriter::write_events`].
    pub fn write_bodies(&mut self, t_us: i64, samples: &[BodySample]) -> Result<(), FormatError> {
        self.check_usable()?;
        let path = self.store.path().to_path_buf();
        let count = self.bodies.as_ref().map_or(0, |columns| columns.count);
        let Some(columns) = self.bodies.as_mut().filter(|columns| columns.count == samples.len()) else {
            let what = format!("{} bodies were given, and the recording has {count}", samples.len());
            return Err(FormatError::invalid(&path, what, "name all of them when it is created"));
        };
        let finite = |s: &BodySample| {
            let values =
                s.position.iter().chain(&s.rotation).chain(&s.linear_velocity).chain(&s.angular_velocity);
            values.into_iter().all(|v| v.is_finite())
        };
        if let Some(wrong) = samples.iter().find(|s| !finite(s)) {
            let what = format!("a body at {t_us} us is {wrong:?}");
            return Err(FormatError::invalid(&path, what, "give finite numbers"));
        }
        if columns.last_t.is_some_and(|last| t_us <= last) {
            let what = format!("bodies at {t_us} us come after those at {} us", columns.last_t.unwrap_or(0));
            return Err(FormatError::invalid(&path, what, "write them in order of time, each time once"));
        }
        columns.last_t = Some(t_us);
        columns.t.push(&t_us.to_le_bytes());
        let bytes = |values: &[f64]| little_endian(values, f64::to_le_bytes);
        columns.position.push(&samples.iter().flat_map(|s| bytes(&s.position)).collect::<Vec<_>>());
        columns.rotation.push(&samples.iter().flat_map(|s| bytes(&s.rotation)).collect::<Vec<_>>());
        columns
            .linear_velocity
            .push(&samples.iter().flat_map(|s| bytes(&s.linear_velocity)).collect::<Vec<_>>());
        columns
            .angular_velocity
            .push(&samples.iter().flat_map(|s| bytes(&s.angular_velocity)).collect::<Vec<_>>());
        self.store_full_chunks()?;
        self.flush_if_due()
    }

    /// Flushes when the last flush is almost a second old. The write calls do this themselves; a caller
    /// that has nothing to write for a while calls it to keep the promise of one second.
    ///
    /// # Errors
    /// As [`RecordingWriter::flush`].
    pub fn flush_if_due(&mut self) -> Result<(), FormatError> {
        if self.state == WriterState::Writing && self.last_flush.elapsed() >= FLUSH_EVERY {
            self.flush()?;
        }
        Ok(())
    }

    /// Stores everything written so far: a reader, or a kill, finds all of it.
    ///
    /// The data reach the operating system, which survives the death of this process, not that of the
    /// machine.
    ///
    /// # Errors
    /// A failed write (disk full).
    pub fn flush(&mut self) -> Result<(), FormatError> {
        self.check_usable()?;
        self.guarded(|writer| {
            writer.commit()?;
            writer.store.check_place()
        })
    }

    /// Writes the report and closes the file.
    ///
    /// # Errors
    /// A failed write (disk full); the file is then closed as the last flush left it. A file that was removed or replaced
    /// meanwhile: what was written is lost.
    pub fn finish(mut self, report_json: &str) -> Result<(), FormatError> {
        self.check_usable()?;
        self.report.push(report_json.as_bytes());
        self.guarded(|writer| {
            writer.commit()?;
            writer.store.write_contiguous("evis/complete", &[1])?;
            writer.store.publish(FileState::Closed)?;
            writer.store.check_place()
        })?;
        self.state = WriterState::Finished;
        Ok(())
    }

    /// Runs a step that writes; after a failure nothing more is written.
    fn guarded(
        &mut self,
        step: impl FnOnce(&mut Self) -> Result<(), FormatError>,
    ) -> Result<(), FormatError> {
        let result = step(self);
        if result.is_err() {
            self.state = WriterState::Failed;
        }
        result
    }

    fn check_usable(&self) -> Result<(), FormatError> {
        if self.state == WriterState::Writing {
            return Ok(());
        }
        Err(FormatError::invalid(
            self.store.path(),
            "an earlier write failed, so nothing more is written",
            "start again after removing the cause",
        ))
    }

    fn camera(&self, index: usize) -> Result<usize, FormatError> {
        if index < self.cameras.len() {
            return Ok(index);
        }
        Err(FormatError::invalid(
            self.store.path(),
            format!("there is no camera {index}"),
            format!("give an index below {}", self.cameras.len()),
        ))
    }

    fn check_events(&self, camera: usize, events: &[Event], last_t: i64) -> Result<(), FormatError> {
        let Some(columns) = self.cameras.get(camera) else { return Ok(()) };
        let invalid = |i: usize, e: &Event, what: String, remedy: String| {
            let name = &columns.info.name;
            let what = format!("event {i} of camera {name} (t {}, x {}, y {}) {what}", e.t, e.x, e.y);
            Err(FormatError::invalid(self.store.path(), what, remedy))
        };
        let (width, height) = (columns.info.width, columns.info.height);
        let latest = if columns.narrow { i64::from(u32::MAX) } else { LATEST_US };
        let mut previous = last_t;
        for (i, e) in events.iter().enumerate() {
            if e.t < previous {
                let what = format!("comes before the one at {previous} us");
                return invalid(i, e, what, "write events in order of time, from 0".into());
            }
            if e.t > latest {
                let what = format!("is later than {latest} us");
                let remedy = if columns.narrow {
                    "give the true duration when creating the recording, or none".into()
                } else {
                    "count microseconds from the start; absolute time belongs in t_offset_us".into()
                };
                return invalid(i, e, what, remedy);
            }
            if u32::from(e.x) >= width || u32::from(e.y) >= height {
                return invalid(
                    i,
                    e,
                    "lies outside".into(),
                    format!("the image has {width}x{height} pixels"),
                );
            }
            if !(0..=1).contains(&e.p) {
                return invalid(i, e, format!("has polarity {}", e.p), "ON is 1, OFF is 0".into());
            }
            previous = e.t;
        }
        Ok(())
    }

    /// Compresses all full chunks, on every thread, and appends them.
    fn store_full_chunks(&mut self) -> Result<(), FormatError> {
        self.guarded(|writer| {
            let mut columns: Vec<&mut Column> =
                writer.cameras.iter_mut().flat_map(CameraColumns::all).collect();
            columns.extend(writer.imus.iter_mut().flat_map(ImuColumns::all));
            columns.extend(writer.states.iter_mut().flat_map(StateColumns::all));
            columns.extend(writer.bodies.iter_mut().flat_map(BodyColumns::all));
            columns.push(&mut writer.report);
            columns.retain(|c| c.full_chunks() > 0);
            if columns.is_empty() {
                return Ok(());
            }
            let path = writer.store.path().to_path_buf();
            let jobs: Vec<(FilterPipeline, Vec<Vec<u8>>)> =
                columns.iter_mut().map(|c| (c.pipeline().clone(), c.take_full())).collect();
            let all = |(pipeline, chunks): &(FilterPipeline, Vec<Vec<u8>>)| {
                chunks.par_iter().map(|chunk| compress(pipeline, chunk, &path)).collect()
            };
            let compressed: Vec<Vec<Vec<u8>>> = match jobs.as_slice() {
                // Not worth waking another thread.
                [(pipeline, chunks)] if chunks.len() == 1 => {
                    vec![chunks.iter().map(|c| compress(pipeline, c, &path)).collect::<Result<_, _>>()?]
                }
                jobs => jobs.par_iter().map(all).collect::<Result<_, FormatError>>()?,
            };
            for (column, chunks) in columns.into_iter().zip(&compressed) {
                column.append_compressed(&mut writer.store, chunks)?;
            }
            Ok(())
        })
    }

    /// Outside in: data, end of file, index, extent.
    fn commit(&mut self) -> Result<(), FormatError> {
        self.store_full_chunks()?;
        let store = &mut self.store;
        let path = store.path().to_path_buf();
        // `ms_to_idx` is the last to grow: what it points to is there.
        let mut columns: Vec<&mut Column> = self.cameras.iter_mut().flat_map(CameraColumns::all).collect();
        columns.extend(self.imus.iter_mut().flat_map(ImuColumns::all));
        columns.extend(self.states.iter_mut().flat_map(StateColumns::all));
        columns.extend(self.bodies.iter_mut().flat_map(BodyColumns::all));
        columns.push(&mut self.report);

        let tails = columns
            .par_iter()
            .map(|c| c.pending_tail().map(|tail| compress(c.pipeline(), &tail, &path)).transpose())
            .collect::<Result<Vec<Option<Vec<u8>>>, _>>()?;
        for (column, tail) in columns.iter_mut().zip(&tails) {
            if let Some(tail) = tail {
                column.store_tail(store, tail)?;
            }
        }
        store.publish_end()?;
        for column in &mut columns {
            column.write_index(store)?;
        }
        for column in &mut columns {
            column.write_extent(store)?;
        }
        self.last_flush = Instant::now();
        Ok(())
    }
}

impl Drop for RecordingWriter {
    fn drop(&mut self) {
        // Nobody is left to hear of an error; the last commit stands whatever happens here.
        if self.state == WriterState::Writing && self.flush().is_ok() {
            let _ = self.store.publish(FileState::Closed);
        } else if self.state == WriterState::Failed {
            let _ = self.store.close_as_committed();
        }
    }
}

/// Checks names of groups, each of which may stand once; `one` and `many` are what they are of.
fn check_names(path: &Path, [one, many]: [&str; 2], names: &[&str]) -> Result<(), FormatError> {
    for (i, name) in names.iter().enumerate() {
        if !is_group_name(name) {
            let what = format!("{name:?} cannot name {one}");
            return Err(FormatError::invalid(path, what, "use a name without slash"));
        }
        if names[..i].contains(name) {
            return Err(FormatError::invalid(
                path,
                format!("two {many} are named {name:?}"),
                "give each its own name",
            ));
        }
    }
    Ok(())
}

impl BodyColumns {
    fn all(&mut self) -> impl Iterator<Item = &mut Column> {
        let values = [
            &mut self.position,
            &mut self.rotation,
            &mut self.linear_velocity,
            &mut self.angular_velocity,
            &mut self.t,
        ];
        values.into_iter()
    }
}

impl ImuColumns {
    /// All columns, in the order in which a commit extends them.
    fn all(&mut self) -> [&mut Column; 3] {
        [&mut self.accelerometer, &mut self.gyroscope, &mut self.t]
    }
}

impl StateColumns {
    fn all(&mut self) -> [&mut Column; 2] {
        [&mut self.values, &mut self.t]
    }
}

impl CameraColumns {
    fn open(
        store: &mut Store,
        info: &CameraInfo,
        narrow: bool,
        labels: &[LabelKind],
    ) -> Result<Self, FormatError> {
        let mut column = |name: &str| Column::open(store, &format!("{}/{name}", info.name));
        Ok(Self {
            info: info.clone(),
            x: column("events/x")?,
            y: column("events/y")?,
            t: column("events/t")?,
            p: column("events/p")?,
            cause: labels.contains(&LabelKind::Cause).then(|| column("events/cause")).transpose()?,
            narrow,
            ms_to_idx: column("ms_to_idx")?,
            last_t: 0,
            labels: labels
                .iter()
                .filter(|kind| kind.is_image())
                .map(|&kind| {
                    let name = kind.name();
                    Ok(LabelColumns {
                        kind,
                        data: column(&format!("labels/{name}"))?,
                        t: column(&format!("labels/{name}_t_us"))?,
                        t_other: has_other_time(kind)
                            .then(|| column(&format!("labels/{name}_t_other_us")))
                            .transpose()?,
                        t_end: (kind == LabelKind::Frame)
                            .then(|| column(&format!("labels/{name}_t_end_us")))
                            .transpose()?,
                        last_t: None,
                    })
                })
                .collect::<Result<_, FormatError>>()?,
            pose_t: column("poses/t_us")?,
            position: column("poses/position")?,
            rotation: column("poses/rotation_xyzw")?,
        })
    }

    /// All columns, in the order in which a commit extends them: what is pointed to before what points.
    fn all(&mut self) -> impl Iterator<Item = &mut Column> {
        let labels = self.labels.iter_mut().flat_map(|l| {
            let times = l.t_other.iter_mut().chain(&mut l.t_end);
            std::iter::once(&mut l.data).chain(times).chain(std::iter::once(&mut l.t))
        });
        [&mut self.x, &mut self.y, &mut self.p]
            .into_iter()
            .chain(&mut self.cause)
            .chain([&mut self.t, &mut self.ms_to_idx])
            .chain(labels)
            .chain([&mut self.position, &mut self.rotation, &mut self.pose_t])
    }

    /// Takes events from the front of `events` and says how many: a long silence fills so much of
    /// `ms_to_idx` that it must be stored in between.
    fn push_events(&mut self, events: &[Event], causes: &[u8]) -> usize {
        let before = self.t.rows();
        let mut taken = events.len();
        for (i, event) in events.iter().enumerate() {
            let millis = event.t.unsigned_abs() / 1000;
            let missing = (millis + 1).saturating_sub(self.ms_to_idx.rows());
            if missing == 0 {
                continue;
            }
            let now = missing.min(MILLIS_AT_ONCE);
            let entry = (before + i as u64).to_le_bytes();
            self.ms_to_idx.push_each((0..now).map(|_| entry));
            if now < missing {
                taken = i;
                break;
            }
        }
        let events = events.get(..taken).unwrap_or_default();
        self.x.push_each(events.iter().map(|e| e.x.to_le_bytes()));
        self.y.push_each(events.iter().map(|e| e.y.to_le_bytes()));
        self.p.push_each(events.iter().map(|e| [e.p.to_le_bytes()[0]]));
        if let Some(column) = &mut self.cause {
            column.push(causes.get(..taken).unwrap_or_default());
        }
        if self.narrow {
            // Checked on entry: times fit.
            self.t.push_each(events.iter().map(|e| u32::try_from(e.t).unwrap_or(u32::MAX).to_le_bytes()));
        } else {
            self.t.push_each(events.iter().map(|e| e.t.to_le_bytes()));
        }
        self.last_t = events.last().map_or(self.last_t, |e| e.t);
        taken
    }
}

fn little_endian<T: Copy, const N: usize>(values: &[T], bytes: fn(T) -> [u8; N]) -> Vec<u8> {
    values.iter().flat_map(|&v| bytes(v)).collect()
}

/// Moves `draft` to `place`, unless what is there is being written or read by another process.
fn take_place(path: &Path, draft: &Path, place: &Path, overwrite: bool) -> Result<(), FormatError> {
    // Between the check of what is there and the move, nobody else may do the same. A folder that cannot be locked is no reason
    // not to write.
    #[cfg(unix)]
    let _folder = {
        let folder = place.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        fs::File::open(folder).and_then(|folder| folder.lock().map(|()| folder))
    };
    match fs::File::open(place) {
        Ok(_) if !overwrite => return Err(FormatError::Exists { path: path.into() }),
        #[cfg(unix)]
        Ok(existing) if matches!(existing.try_lock(), Err(fs::TryLockError::WouldBlock)) => {
            return Err(FormatError::invalid(
                path,
                "another process is writing or reading it",
                "choose another name, or wait until that process is done",
            ));
        }
        _ => {}
    }
    fs::rename(draft, place).map_err(|e| FormatError::io(path, "create", e))
}

#[cfg(test)]
mod tests {
    use super::super::Recording;
    use super::*;
    use crate::event::Polarity;

    fn header() -> RecordingHeader {
        let camera = CameraInfo::uncalibrated("c", (40, 30));
        RecordingHeader {
            seed: 3,
            method: "native".into(),
            duration_us: Some(1_000_000),
            ..RecordingHeader::of(vec![camera])
        }
    }

    /// Each flush stores unfinished chunks again; flushes go by the clock, not by the stream.
    #[test]
    fn a_run_faster_than_real_time_does_not_write_its_events_many_times() {
        // 4 s of stream in packets of 10 ms, of events that compress little.
        let written = |every_packet: bool| {
            let name = format!("evis-written-{}-{every_packet}.h5", std::process::id());
            let path = std::env::temp_dir().join(name);
            let mut writer = RecordingWriter::create(&path, &header(), true).unwrap();
            let mut state = 1_u64;
            let mut random = |below: u64| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 33) % below
            };
            for packet in 0..400 {
                let events: Vec<Event> = (0..200)
                    .map(|k| {
                        let t = packet * 10_000 + k * 50 + random(50) as i64;
                        Event::new(t, random(40) as u16, random(30) as u16, Polarity::On)
                    })
                    .collect();
                writer.write_events(0, &events).unwrap();
                if every_packet {
                    writer.flush().unwrap();
                }
            }
            writer.flush().unwrap();
            let written = writer.store.written as f64;
            writer.finish("{}").unwrap();
            let size = fs::metadata(&path).unwrap().len() as f64;
            fs::remove_file(&path).unwrap();
            [written, size]
        };
        let ([by_the_clock, size], [each, larger]) = (written(false), written(true));
        println!("{by_the_clock} bytes for {size}; {each} for {larger} with a flush per packet");
        assert!(by_the_clock < 3.0 * size, "{by_the_clock} bytes for {size}");
        assert!(each > 10.0 * size, "canary: {each} bytes for {size}");
    }

    #[test]
    fn a_recording_with_events_that_cannot_be_is_refused() {
        let path = std::env::temp_dir().join(format!("evis-writer-{}.h5", std::process::id()));
        let header = header();
        let good: Vec<Event> =
            (0..600).map(|i| Event::new(i * 37, (i % 40) as u16, 3, Polarity::On)).collect();
        let read = |events: &[Event]| {
            let mut writer = RecordingWriter::create(&path, &header, true).unwrap();
            // Past the checks of `write_events`, as another program may write them.
            writer.cameras[0].push_events(events, &[]);
            writer.finish("{}").unwrap();
            let recording = Recording::open(&path).unwrap();
            let between = recording.events_between(0, 0, 1 << 40);
            recording.events(0).and_then(|all| between.map(|part| (all, part)))
        };
        assert_eq!(read(&good).unwrap(), (good.clone(), good.clone()));
        type Change = fn(&mut Event);
        let wrong: [(&str, Change); 3] = [
            ("event 300 has the polarity 7", |e| e.p = 7),
            ("event 300 (x 40, y 3, at 11100 us) lies outside of 40x30", |e| e.x = 40),
            ("event 300 is earlier than the one before it", |e| e.t = 3),
        ];
        for (message, change) in wrong {
            let mut events = good.clone();
            change(&mut events[300]);
            let error = read(&events).unwrap_err().to_string();
            assert!(error.contains(message), "{error}");
        }
        fs::remove_file(&path).unwrap();
    }
}
