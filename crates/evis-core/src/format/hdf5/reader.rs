//! Reading a recording, complete or not.

use std::collections::BTreeSet;
use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use evis_limits::Budget;
use rust_hdf5::format::superblock::SuperblockV2V3;
use rust_hdf5::{H5Dataset, H5File, H5Type, Hdf5Error};

use super::{
    Bodies, BodyInfo, BodySample, LARGEST_EXPANSION, LabelType, RESERVED_NAMES, RecordingHeader, StateInfo,
    StateSamples, has_other_time, hash_text,
};
use crate::event::{Cause, Event, Polarity, slice_time, take_causes};
use crate::format::{FormatError, check_events};
use crate::packet::{CameraInfo, ImuSample, LabelData, LabelFrame, LabelKind, LensDistortion, PoseSample};
use crate::words::did_you_mean;

/// Events that are decoded at once: bounds what a read needs beside its result.
const EVENTS_AT_ONCE: u64 = 1 << 20;

/// A recording on disk. It holds no file open: every read sees what the writer has flushed by then.
#[derive(Clone, Debug)]
pub struct Recording {
    path: PathBuf,
    header: RecordingHeader,
}

impl Recording {
    /// Opens the recording at `path`, also while it is being written and after its writer was killed.
    ///
    /// # Errors
    /// A missing file, and one that is no recording, is cut short or damaged.
    pub fn open(path: &Path) -> Result<Self, FormatError> {
        let header = with_file(path, |source| source.header())?;
        Ok(Self { path: path.into(), header })
    }

    /// What the recording says about itself; `duration_us` is `None`.
    pub const fn header(&self) -> &RecordingHeader {
        &self.header
    }

    /// Whether the writer finished it: false while it is being written, after a kill, and after
    /// [`super::repair`] of a killed one.
    ///
    /// # Errors
    /// A file that can no longer be read.
    pub fn is_complete(&self) -> Result<bool, FormatError> {
        let complete = with_file(&self.path, |source| source.scalar::<u8>("evis/complete"))?;
        Ok(complete == 1 && superblock(&self.path)?.file_consistency_flags == 0)
    }

    /// Events of camera `camera`.
    ///
    /// # Errors
    /// No such camera, or a file that can no longer be read.
    pub fn event_count(&self, camera: usize) -> Result<u64, FormatError> {
        let camera = self.camera(camera)?;
        with_file(&self.path, |source| source.events(camera).map(|e| e.count))
    }

    /// All events of camera `camera`.
    ///
    /// # Errors
    /// As [`Recording::event_count`].
    pub fn events(&self, camera: usize) -> Result<Vec<Event>, FormatError> {
        let camera = self.camera(camera)?;
        with_file(&self.path, |source| source.all_events(camera))
    }

    /// Why each event of camera `camera` fired, as numbers of [`crate::Cause`], of those with `start_us <= t < end_us`
    /// where there are limits. `None` where the file does not say.
    ///
    /// # Errors
    /// As [`Recording::event_count`].
    pub fn causes(&self, camera: usize, limits: Option<(i64, i64)>) -> Result<Option<Vec<u8>>, FormatError> {
        if !self.header.labels.contains(&LabelKind::Cause) {
            return Ok(None);
        }
        let (start_us, end_us) = limits.unwrap_or((i64::MIN, i64::MAX));
        let mut events = self.between(camera, start_us, end_us, true)?;
        Ok(Some(take_causes(&mut events)))
    }

    /// The events of camera `camera` with `start_us <= t < end_us`. Only the chunks around them are read.
    ///
    /// # Errors
    /// As [`Recording::event_count`].
    pub fn events_between(
        &self,
        camera: usize,
        start_us: i64,
        end_us: i64,
    ) -> Result<Vec<Event>, FormatError> {
        self.between(camera, start_us, end_us, false)
    }

    fn between(
        &self,
        camera: usize,
        start_us: i64,
        end_us: i64,
        marked: bool,
    ) -> Result<Vec<Event>, FormatError> {
        let camera = self.camera(camera)?;
        let name = &camera.name;
        with_file(&self.path, |source| {
            let mut columns = source.events(camera)?;
            if marked {
                let cause = source.dataset(&format!("{name}/events/cause"))?;
                columns.count = columns.count.min(source.rows(&cause, "events/cause")?);
                columns.cause = Some(cause);
            }
            let index = source.dataset(&format!("{name}/ms_to_idx"))?;
            let entries = source.rows(&index, "ms_to_idx")?;
            // Where the index has no entry, it has not got there yet, or no event is that late.
            let entry = |millis: u64| {
                let row = source.slice::<u64>(&index, millis, 1)?.first().copied();
                match row {
                    // While the file is written, the index may be newer than the count of events.
                    Some(row) if source.closed && row > columns.count => Err(source.out_of_step(format!(
                        "{name}/ms_to_idx leads to event {row} at {millis} ms, of {} events",
                        columns.count
                    ))),
                    row => Ok(row),
                }
            };
            let start_millis = u64::try_from(start_us).unwrap_or(0) / 1000;
            let end_millis = u64::try_from(end_us).unwrap_or(0).div_ceil(1000);
            let from = match entries.checked_sub(1) {
                Some(last) => entry(start_millis.min(last))?.unwrap_or(0),
                None => 0,
            };
            let to = if end_millis < entries {
                entry(end_millis)?.unwrap_or(columns.count)
            } else {
                columns.count
            };
            let mut events = source.event_list(to.min(columns.count).saturating_sub(from))?;
            columns.read(source, from.min(columns.count), to.min(columns.count), |block| {
                events.extend_from_slice(slice_time(block, start_us, end_us));
            })?;
            Ok(events)
        })
    }

    /// The kinds of label images of camera `camera`, in file order.
    ///
    /// # Errors
    /// No such camera.
    pub fn label_kinds(&self, camera: usize) -> Result<&[LabelKind], FormatError> {
        // What is no image comes last.
        let images = self.header.labels.partition_point(|kind| kind.is_image());
        self.camera(camera).map(|_| self.header.labels.get(..images).unwrap_or_default())
    }

    /// The times of a label, in microseconds; their number is the number of frames.
    ///
    /// # Errors
    /// No such camera or label, or a file that can no longer be read.
    pub fn label_times(&self, camera: usize, kind: LabelKind) -> Result<Vec<i64>, FormatError> {
        let name = self.label_path(camera, kind)?;
        with_file(&self.path, |source| {
            let times = source.dataset(&format!("{name}_t_us"))?;
            let count = source.rows(&times, &name)?.min(source.rows(&source.dataset(&name)?, &name)?);
            source.slice(&times, 0, count)
        })
    }

    /// Frame `index` of a label.
    ///
    /// # Errors
    /// No such camera, label or frame, or a file that can no longer be read.
    pub fn label(&self, camera: usize, kind: LabelKind, index: usize) -> Result<LabelFrame, FormatError> {
        let name = self.label_path(camera, kind)?;
        let info = self.camera(camera)?;
        let (height, width) = (info.height as usize, info.width as usize);
        with_file(&self.path, |source| {
            let frames = source.dataset(&name)?;
            let count = source.rows(&frames, &name)?;
            if index as u64 >= count {
                return Err(FormatError::invalid(
                    &self.path,
                    format!("label {} has no frame {index}", kind.name()),
                    format!("there are {count}"),
                ));
            }
            let mut counts = vec![1, height, width];
            if kind.channels() > 1 {
                counts.push(kind.channels());
            }
            if frames.shape().get(1..) != counts.get(1..) {
                return Err(source.damaged(format!("{name} does not have the size of its camera")));
            }
            let values = counts.iter().try_fold(4_usize, |n, &d| n.checked_mul(d)).unwrap_or(usize::MAX);
            source.fits(values as u64, "a label")?;
            let mut starts = vec![0; counts.len()];
            if let Some(first) = starts.first_mut() {
                *first = index;
            }
            let data = match LabelType::of(kind) {
                LabelType::F32 => LabelData::F32(source.check(&name, frames.read_slice(&starts, &counts))?),
                LabelType::U32 => LabelData::U32(source.check(&name, frames.read_slice(&starts, &counts))?),
                LabelType::U8 => LabelData::U8(source.check(&name, frames.read_slice(&starts, &counts))?),
            };
            let time = |suffix: &str| {
                let times = source.dataset(&format!("{name}{suffix}"))?;
                let value = source.slice::<i64>(&times, index as u64, 1)?;
                value.first().copied().ok_or_else(|| source.damaged(format!("{name} lacks a time")))
            };
            let t_us = time("_t_us")?;
            let t_other_us = if has_other_time(kind) { time("_t_other_us")? } else { t_us };
            Ok(LabelFrame { kind, t_us, t_other_us, data })
        })
    }

    /// The poses of camera `camera`.
    ///
    /// # Errors
    /// No such camera, or a file that can no longer be read.
    pub fn poses(&self, camera: usize) -> Result<Vec<PoseSample>, FormatError> {
        let name = &self.camera(camera)?.name;
        with_file(&self.path, |source| {
            let times = source.dataset(&format!("{name}/poses/t_us"))?;
            let position = source.dataset(&format!("{name}/poses/position"))?;
            let rotation = source.dataset(&format!("{name}/poses/rotation_xyzw"))?;
            let mut count = source.rows(&times, name)?;
            for (dataset, columns) in [(&position, 3), (&rotation, 4)] {
                if dataset.shape().get(1..) != Some([columns].as_slice()) {
                    return Err(source.damaged(format!("the poses of {name} have another shape")));
                }
                count = count.min(source.rows(dataset, name)?);
            }
            let rows = usize::try_from(count).unwrap_or(usize::MAX);
            source.fits(count.saturating_mul(2 * size_of::<PoseSample>() as u64), "its list of poses")?;
            let times: Vec<i64> = source.slice(&times, 0, count)?;
            let position: Vec<f64> = source.column(name, position.read_slice(&[0, 0], &[rows, 3]))?;
            let rotation: Vec<f64> = source.column(name, rotation.read_slice(&[0, 0], &[rows, 4]))?;
            let poses = times.iter().zip(position.as_chunks().0).zip(rotation.as_chunks().0);
            Ok(poses.map(|((&t_us, &position), &rotation)| PoseSample { t_us, position, rotation }).collect())
        })
    }

    /// Names of the inertial measurement units.
    ///
    /// # Errors
    /// A file that can no longer be read.
    pub fn imus(&self) -> Result<Vec<String>, FormatError> {
        with_file(&self.path, |source| source.names("imus"))
    }

    /// The samples of the inertial measurement unit `name`.
    ///
    /// # Errors
    /// No such unit, or a file that can no longer be read.
    pub fn imu(&self, name: &str) -> Result<Vec<ImuSample>, FormatError> {
        with_file(&self.path, |source| {
            source.find("imus", name, "inertial measurement unit")?;
            let at = format!("imus/{name}");
            let times = source.dataset(&format!("{at}/t_us"))?;
            let values = ["accelerometer", "gyroscope"].map(|part| source.dataset(&format!("{at}/{part}")));
            let [accelerometer, gyroscope] = values;
            let (accelerometer, gyroscope) = (accelerometer?, gyroscope?);
            let mut count = source.rows(&times, name)?;
            for dataset in [&accelerometer, &gyroscope] {
                if dataset.shape().get(1..) != Some([3].as_slice()) {
                    return Err(source.damaged(format!("the samples of {name} have another shape")));
                }
                count = count.min(source.rows(dataset, name)?);
            }
            let rows = usize::try_from(count).unwrap_or(usize::MAX);
            source.fits(count.saturating_mul(2 * size_of::<ImuSample>() as u64), "its list of samples")?;
            let times: Vec<i64> = source.slice(&times, 0, count)?;
            let force: Vec<f64> = source.column(&at, accelerometer.read_slice(&[0, 0], &[rows, 3]))?;
            let rate: Vec<f64> = source.column(&at, gyroscope.read_slice(&[0, 0], &[rows, 3]))?;
            let samples = times.iter().zip(force.as_chunks().0).zip(rate.as_chunks().0);
            let sample = |((&t_us, &accelerometer), &gyroscope)| ImuSample { t_us, accelerometer, gyroscope };
            Ok(samples.map(sample).collect())
        })
    }

    /// What a host said of its own state: the names of its states.
    ///
    /// # Errors
    /// A file that can no longer be read.
    pub fn states(&self) -> Result<Vec<String>, FormatError> {
        with_file(&self.path, |source| source.names("states"))
    }

    /// The state `name`: what its values are, its times, and the values row by row.
    ///
    /// # Errors
    /// No such state, or a file that can no longer be read.
    pub fn state(&self, name: &str) -> Result<StateSamples, FormatError> {
        with_file(&self.path, |source| {
            source.find("states", name, "state")?;
            let dataset = |part: &str| source.dataset(&format!("states/{name}/{part}"));
            let names = source.check(name, dataset("names")?.read_vlen_strings())?;
            let group = source.check(name, source.file.root_group().group(&format!("states/{name}")))?;
            if source.check(name, group.attr_string("names_hash"))? != hash_text(StateInfo::hash(&names)) {
                return Err(
                    source.damaged(format!("the names of states/{name} are not those that were written"))
                );
            }
            let (times, values) = (dataset("t_us")?, dataset("values")?);
            if names.is_empty() || values.shape().get(1..) != Some([names.len()].as_slice()) {
                return Err(source.damaged(format!("states/{name}/values has another shape")));
            }
            let count = source.rows(&times, name)?.min(source.rows(&values, name)?);
            let row = (names.len() as u64).saturating_add(1).saturating_mul(8);
            source.fits(count.saturating_mul(row).saturating_mul(2), "its states")?;
            let rows = usize::try_from(count).unwrap_or(usize::MAX);
            let t_us: Vec<i64> = source.slice(&times, 0, count)?;
            let values =
                source.column(&format!("states/{name}"), values.read_slice(&[0, 0], &[rows, names.len()]))?;
            Ok(StateSamples { names, t_us, values })
        })
    }

    /// Names, ids and boxes of what [`Self::bodies`] follows.
    ///
    /// # Errors
    /// A file that can no longer be read.
    pub fn body_infos(&self) -> Result<Vec<BodyInfo>, FormatError> {
        with_file(&self.path, body_infos)
    }

    /// Objects and cameras that the recording names and follows; none where it has no group `bodies`.
    ///
    /// # Errors
    /// A file that can no longer be read.
    pub fn bodies(&self) -> Result<Bodies, FormatError> {
        with_file(&self.path, |source| {
            let infos = body_infos(source)?;
            if infos.is_empty() {
                return Ok(Bodies::default());
            }
            let (at, count) = ("bodies", infos.len());
            let dataset = |part: &str| source.dataset(&format!("bodies/{part}"));
            let times = dataset("t_us")?;
            let mut rows = source.rows(&times, at)?;
            let mut columns = Vec::new();
            for (part, width) in
                [("position", 3), ("rotation_xyzw", 4), ("linear_velocity", 3), ("angular_velocity", 3)]
            {
                let column = dataset(part)?;
                if column.shape().get(1..) != Some([count, width].as_slice()) {
                    return Err(source.damaged(format!("bodies/{part} has another shape")));
                }
                rows = rows.min(source.rows(&column, at)?);
                columns.push((column, width));
            }
            let bytes = rows.saturating_mul((2 * count * size_of::<BodySample>()) as u64);
            source.fits(bytes, "its poses of bodies")?;
            let t_us: Vec<i64> = source.slice(&times, 0, rows)?;
            let rows = usize::try_from(rows).unwrap_or(usize::MAX);
            let mut read = columns.iter().map(|(column, width)| {
                source.column(at, column.read_slice::<f64>(&[0, 0, 0], &[rows, count, *width]))
            });
            let mut next = || read.next().unwrap_or_else(|| Ok(Vec::new()));
            let (position, rotation, linear, angular) = (next()?, next()?, next()?, next()?);
            let vectors = position.as_chunks().0.iter().zip(rotation.as_chunks().0);
            let twists = linear.as_chunks().0.iter().zip(angular.as_chunks().0);
            let samples: Vec<BodySample> = vectors
                .zip(twists)
                .map(|((&position, &rotation), (&linear_velocity, &angular_velocity))| BodySample {
                    position,
                    rotation,
                    linear_velocity,
                    angular_velocity,
                })
                .collect();
            let samples = samples.chunks(count.max(1)).map(<[_]>::to_vec).collect();
            Ok(Bodies { infos, t_us, samples })
        })
    }

    /// The report that the writer left at the end, as JSON; `None` where it never got there.
    ///
    /// # Errors
    /// A file that can no longer be read.
    pub fn report(&self) -> Result<Option<String>, FormatError> {
        let text = with_file(&self.path, |source| source.text("evis/report_json"))?;
        Ok(if text.is_empty() { None } else { Some(text) })
    }

    /// Reads everything that it holds, and keeps nothing of it.
    ///
    /// # Errors
    /// The first part that cannot be read, or that does not fit the others.
    pub fn verify(&self) -> Result<(), FormatError> {
        self.is_complete()?;
        self.report()?;
        for (index, camera) in self.header.cameras.iter().enumerate() {
            let name = &camera.name;
            with_file(&self.path, |source| {
                let mut columns = source.events(camera)?;
                if self.header.labels.contains(&LabelKind::Cause) {
                    columns.cause = Some(source.dataset(&format!("{name}/events/cause"))?);
                }
                columns.read(source, 0, columns.count, |_| {})?;
                let table = source.dataset(&format!("{name}/ms_to_idx"))?;
                let (entries, mut at, mut before) = (source.rows(&table, "ms_to_idx")?, 0, 0);
                while at < entries {
                    let count = EVENTS_AT_ONCE.min(entries - at);
                    for row in source.slice::<u64>(&table, at, count)? {
                        if row < before || row > columns.count {
                            let what = format!("{name}/ms_to_idx leads to event {row} of {}", columns.count);
                            return Err(source.out_of_step(what));
                        }
                        before = row;
                    }
                    at += count;
                }
                Ok(())
            })?;
            for kind in self.label_kinds(index)? {
                for frame in 0..self.label_times(index, *kind)?.len() {
                    self.label(index, *kind, frame)?;
                }
            }
            self.poses(index)?;
        }
        for name in self.imus()? {
            self.imu(&name)?;
        }
        for name in self.states()? {
            self.state(&name)?;
        }
        self.bodies()?;
        self.report().map(|_| ())
    }

    /// Where the recording is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Index of the camera of this name; of the only camera where no name is given.
    ///
    /// # Errors
    /// No such camera; several, and no name.
    pub fn find_camera(&self, name: Option<&str>) -> Result<usize, FormatError> {
        let cameras = &self.header.cameras;
        match name {
            Some(name) => cameras.iter().position(|c| c.name == name).ok_or_else(|| {
                let hint = did_you_mean(name, cameras.iter().map(|c| c.name.as_str()));
                FormatError::invalid(
                    &self.path,
                    format!("there is no camera '{name}'"),
                    format!("there is {}{hint}", self.camera_names()),
                )
            }),
            None if cameras.len() == 1 => Ok(0),
            None => Err(FormatError::invalid(
                &self.path,
                format!("there are {} cameras", cameras.len()),
                format!("choose one of {}", self.camera_names()),
            )),
        }
    }

    fn camera(&self, index: usize) -> Result<&CameraInfo, FormatError> {
        self.header.cameras.get(index).ok_or_else(|| self.no_camera(&index.to_string()))
    }

    pub(super) fn no_camera(&self, which: &str) -> FormatError {
        FormatError::invalid(
            &self.path,
            format!("there is no camera {which}"),
            format!("the cameras are {}, from 0", self.camera_names()),
        )
    }

    fn camera_names(&self) -> String {
        self.header.cameras.iter().map(|c| c.name.as_str()).collect::<Vec<_>>().join(", ")
    }

    fn label_path(&self, camera: usize, kind: LabelKind) -> Result<String, FormatError> {
        let name = &self.camera(camera)?.name;
        if self.header.labels.contains(&kind) {
            return Ok(format!("{name}/labels/{}", kind.name()));
        }
        let present: Vec<_> = self.header.labels.iter().map(|k| k.name()).collect();
        Err(FormatError::invalid(
            &self.path,
            format!("it has no label {}", kind.name()),
            if present.is_empty() {
                "it was recorded without labels".into()
            } else {
                format!("the labels are {}", present.join(", "))
            },
        ))
    }
}

/// An open file and what is needed to explain what is wrong with it.
pub(super) struct Source<'a> {
    pub path: &'a Path,
    pub file: H5File,
    bytes: u64,
    /// What the result of a read may take.
    budget: Budget,
    /// Nobody was writing it when it was opened, and no writer was killed.
    closed: bool,
}

/// The event columns of a camera.
struct EventColumns {
    /// Pixels per row, and rows.
    size: (u32, u32),
    x: H5Dataset,
    y: H5Dataset,
    t: H5Dataset,
    p: H5Dataset,
    /// Where it is asked for.
    cause: Option<H5Dataset>,
    count: u64,
}

/// Opens `path` and runs `read`. The only way to the decoder: what it does with a damaged file, a panic
/// included, comes out as an error.
pub(super) fn with_file<T>(
    path: &Path,
    read: impl FnOnce(&Source<'_>) -> Result<T, FormatError>,
) -> Result<T, FormatError> {
    let superblock = superblock(path)?;
    let bytes = std::fs::metadata(path).map_err(|e| FormatError::io(path, "read", e))?.len();
    if bytes < superblock.end_of_file_address {
        return Err(FormatError::corrupt(
            path,
            format!("it is cut short ({bytes} of {} bytes)", superblock.end_of_file_address),
            "copy it again, or keep what can be saved with the command `info --repair`",
        ));
    }
    let attempt = catch_unwind(AssertUnwindSafe(|| {
        let file = H5File::options().no_locking().open(path).map_err(|e| damaged(path, e.to_string()))?;
        let closed = superblock.file_consistency_flags == 0;
        read(&Source { path, file, bytes, budget: Budget::default(), closed })
    }));
    attempt.unwrap_or_else(|_| Err(damaged(path, "the decoder gave up on it")))
}

fn superblock(path: &Path) -> Result<SuperblockV2V3, FormatError> {
    let mut head = Vec::new();
    evis_limits::open_regular(path)
        .and_then(|file| file.take(256).read_to_end(&mut head))
        .map_err(|e| FormatError::io(path, "open", e))?;
    SuperblockV2V3::decode(&head).map_err(|e| {
        FormatError::corrupt(
            path,
            format!("it is no HDF5 file of the right kind ({e})"),
            "give a recording that EVIS wrote",
        )
    })
}

fn damaged(path: &Path, what: impl Into<String>) -> FormatError {
    FormatError::corrupt(
        path,
        what,
        "if its writer was killed, try the command `info --repair`; else record or copy it again",
    )
}

/// See [`Recording::body_infos`].
fn body_infos(source: &Source<'_>) -> Result<Vec<BodyInfo>, FormatError> {
    if !source.has("bodies")? {
        return Ok(Vec::new());
    }
    let at = "bodies";
    let dataset = |part: &str| source.dataset(&format!("bodies/{part}"));
    let ids: Vec<u32> = source.check(at, dataset("instance_id")?.read_raw())?;
    let semantic: Vec<u32> = source.check(at, dataset("semantic_id")?.read_raw())?;
    let names = source.check(at, dataset("name")?.read_vlen_strings())?;
    let low: Vec<f64> = source.check(at, dataset("box_min")?.read_raw())?;
    let high: Vec<f64> = source.check(at, dataset("box_max")?.read_raw())?;
    let count = ids.len();
    let group = source.check(at, source.file.root_group().group(at))?;
    let members = source.check(at, group.dataset_names())?;
    let classes = if members.iter().any(|name| name == "semantic_name") {
        source.check(at, dataset("semantic_name")?.read_vlen_strings())?
    } else {
        vec![String::new(); count]
    };
    if [semantic.len(), names.len(), classes.len()] != [count; 3] || [low.len(), high.len()] != [3 * count; 2]
    {
        return Err(source.damaged("its list of bodies has columns of unlike lengths".to_owned()));
    }
    let corners = low.as_chunks().0.iter().zip(high.as_chunks().0);
    let infos = names.into_iter().zip(ids).zip(semantic.into_iter().zip(classes)).zip(corners);
    let info = |(((name, instance_id), (semantic_id, semantic_name)), (&low, &high))| BodyInfo {
        name,
        instance_id,
        semantic_id,
        semantic_name,
        bounds: [low, high],
    };
    let infos: Vec<BodyInfo> = infos.map(info).collect();
    // Files from before there was one have none.
    if source.check(at, group.attr_names())?.iter().any(|name| name == "bodies_hash") {
        let hash = source.check(at, group.attr_string("bodies_hash"))?;
        if hash != hash_text(BodyInfo::hash(&infos)) {
            return Err(source.damaged(
                "the names, ids or boxes of its bodies are not those that were written (bodies_hash)",
            ));
        }
    }
    Ok(infos)
}

impl Source<'_> {
    pub fn damaged(&self, what: impl Into<String>) -> FormatError {
        damaged(self.path, what)
    }

    /// Parts that cannot be read or do not fit together, which a repair can put right.
    fn out_of_step(&self, what: impl Into<String>) -> FormatError {
        FormatError::corrupt(
            self.path,
            what,
            "copy it again from its source, or keep what can be saved with the command `info --repair`",
        )
    }

    pub fn check<T>(&self, name: &str, result: Result<T, Hdf5Error>) -> Result<T, FormatError> {
        result.map_err(|e| self.damaged(format!("{name}: {e}")))
    }

    /// What was read of rows, which a repair can drop.
    fn column<T>(&self, name: &str, result: Result<T, Hdf5Error>) -> Result<T, FormatError> {
        result.map_err(|e| self.out_of_step(format!("{name}: {e}")))
    }

    /// Whether the root group has `name`. A damaged group has a link, and is missing from the list of groups.
    pub fn has(&self, name: &str) -> Result<bool, FormatError> {
        let links = self.check("/", self.file.root_group().link_names())?;
        Ok(links.iter().any(|link| link == name))
    }

    /// Names of the groups in `folder` of the root group; none where it is not there.
    fn names(&self, folder: &str) -> Result<Vec<String>, FormatError> {
        if !self.has(folder)? {
            return Ok(Vec::new());
        }
        let group = self.check(folder, self.file.root_group().group(folder))?;
        self.check(folder, group.link_names())
    }

    /// Whether `folder` has the group `name`, `what` it is of.
    fn find(&self, folder: &str, name: &str, what: &str) -> Result<(), FormatError> {
        let known = self.names(folder)?;
        if known.iter().any(|other| other == name) {
            return Ok(());
        }
        let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
        let what = format!("there is no {what} {name:?}");
        Err(FormatError::invalid(self.path, what, format!("it has {known}")))
    }

    pub fn dataset(&self, name: &str) -> Result<H5Dataset, FormatError> {
        self.check(name, self.file.dataset(name))
    }

    /// Refuses what would take more memory than is left.
    pub fn fits(&self, bytes: u64, what: &str) -> Result<(), FormatError> {
        self.budget.take(bytes, what).map_err(|e| self.damaged(e.to_string()))?;
        self.budget.give_back(bytes);
        Ok(())
    }

    /// Length of the first axis; refused where the file is too small to hold it.
    pub fn rows(&self, dataset: &H5Dataset, name: &str) -> Result<u64, FormatError> {
        let shape = dataset.shape();
        let size = shape.iter().try_fold(dataset.element_size(), |n, &d| n.checked_mul(d));
        // A chunk is decoded as a whole, whatever is read of it.
        let chunk = dataset.chunk_dims().unwrap_or_default();
        let chunk = chunk.iter().try_fold(dataset.element_size(), |n, &d| n.checked_mul(d));
        self.fits(chunk.map_or(u64::MAX, |chunk| chunk as u64), &format!("a chunk of {name}"))?;
        match size {
            Some(size) if (size as u64) / LARGEST_EXPANSION <= self.bytes => {
                Ok(shape.first().copied().unwrap_or(0) as u64)
            }
            _ => Err(self.damaged(format!("{name} promises more than the file holds"))),
        }
    }

    fn slice<T: H5Type>(&self, dataset: &H5Dataset, from: u64, count: u64) -> Result<Vec<T>, FormatError> {
        let (Ok(from), Ok(count)) = (usize::try_from(from), usize::try_from(count)) else {
            return Err(self.damaged("a data set is larger than this machine's memory"));
        };
        if count == 0 {
            return Ok(Vec::new());
        }
        self.fits((count as u64).saturating_mul(size_of::<T>() as u64), "a data set")?;
        self.column("a column", dataset.read_slice(&[from], &[count]))
    }

    pub fn scalar<T: H5Type>(&self, name: &str) -> Result<T, FormatError> {
        let values = self.check(name, self.dataset(name)?.read_raw::<T>())?;
        values.first().copied().ok_or_else(|| self.damaged(format!("{name} has no value")))
    }

    fn text(&self, name: &str) -> Result<String, FormatError> {
        let dataset = self.dataset(name)?;
        let count = self.rows(&dataset, name)?;
        String::from_utf8(self.slice(&dataset, 0, count)?)
            .map_err(|_| self.damaged(format!("{name} is no UTF-8 text")))
    }

    /// The distortion of camera `camera`, where the file has one.
    fn distortion(&self, camera: &str) -> Result<Option<LensDistortion>, FormatError> {
        let group = self.check(camera, self.file.root_group().group(camera))?;
        let group = self.check(camera, group.group("intrinsics"))?;
        let names = self.check(camera, group.dataset_names())?;
        if !names.iter().any(|name| name == "distortion_model") {
            return Ok(None);
        }
        let place = format!("{camera}/intrinsics/distortion_model");
        let models = self.check(&place, self.dataset(&place)?.read_vlen_strings())?;
        let place = format!("{camera}/intrinsics/distortion_coefficients");
        let dataset = self.dataset(&place)?;
        let count = self.rows(&dataset, &place)?;
        let coefficients: Vec<f64> = self.slice(&dataset, 0, count)?;
        let [model] = models.as_slice() else {
            return Err(self.damaged(format!("camera {camera} has {} distortion models", models.len())));
        };
        let distortion = LensDistortion { model: model.clone(), coefficients };
        if !distortion.is_usable() {
            let coefficients = &distortion.coefficients;
            return Err(self.damaged(format!("camera {camera} has the distortion {coefficients:?}")));
        }
        Ok(Some(distortion))
    }

    fn header(&self) -> Result<RecordingHeader, FormatError> {
        let evis = self.file.root_group().group("evis").map_err(|_| {
            FormatError::corrupt(self.path, "it has no group evis", "give a recording that EVIS wrote")
        })?;
        let names = self.check("evis/cameras", self.dataset("evis/cameras")?.read_vlen_strings())?;
        let mut cameras = Vec::new();
        let mut labels = BTreeSet::new();
        let mut t_offset_us = 0;
        for name in names {
            if name.is_empty() || name.contains('/') || RESERVED_NAMES.contains(&name.as_str()) {
                return Err(self.damaged(format!("{name:?} cannot name a camera")));
            }
            let side = |which: &str| {
                let value: i64 = self.scalar(&format!("{name}/intrinsics/{which}"))?;
                u32::try_from(value)
                    .ok()
                    .filter(|v| (1..=65_536).contains(v))
                    .ok_or_else(|| self.damaged(format!("camera {name} has a {which} of {value}")))
            };
            let number = |which: &str| self.scalar::<f64>(&format!("{name}/intrinsics/{which}"));
            let distortion = self.distortion(&name)?;
            cameras.push(CameraInfo {
                distortion,
                width: side("width")?,
                height: side("height")?,
                fx: number("fx")?,
                fy: number("fy")?,
                cx: number("cx")?,
                cy: number("cy")?,
                name: name.clone(),
            });
            t_offset_us = self.scalar(&format!("{name}/t_offset"))?;
            let group = self.check(&name, self.file.root_group().group(&name))?;
            let group = self.check(&name, group.group("labels"))?;
            let present = self.check(&name, group.dataset_names())?;
            labels.extend(LabelKind::ALL.into_iter().filter(|k| present.iter().any(|n| n == k.name())));
            let events = self.check(&name, self.file.root_group().group(&name))?;
            let events = self.check(&name, events.group("events"))?;
            if self.check(&name, events.dataset_names())?.iter().any(|n| n == LabelKind::Cause.name()) {
                labels.insert(LabelKind::Cause);
            }
        }
        if cameras.is_empty() {
            return Err(self.damaged("it has no camera"));
        }
        let header = RecordingHeader {
            cameras,
            seed: self.scalar("evis/seed")?,
            method: self.check("evis", evis.attr_string("method"))?,
            environment: self.scalar("evis/environment")?,
            config_toml: self
                .check("evis/config_toml", self.dataset("evis/config_toml")?.read_vlen_strings())?
                .concat(),
            duration_us: None,
            t_offset_us,
            labels: labels.into_iter().collect(),
        };
        // Files from before there was one have none.
        let members = self.check("evis", evis.dataset_names())?;
        if members.iter().any(|name| name == "header_hash") {
            let hash: u64 = self.scalar("evis/header_hash")?;
            if hash != header.hash() {
                return Err(self.damaged(
                    "its seed, settings, intrinsics or names are not those that were written (evis/header_hash)",
                ));
            }
        }
        Ok(header)
    }

    /// An empty list with room for `count` events.
    fn event_list(&self, count: u64) -> Result<Vec<Event>, FormatError> {
        let list = self.budget.list(usize::try_from(count).unwrap_or(usize::MAX), "its list of events");
        list.map_err(|e| self.damaged(e.to_string()))
    }

    pub fn all_events(&self, camera: &CameraInfo) -> Result<Vec<Event>, FormatError> {
        let columns = self.events(camera)?;
        let mut events = self.event_list(columns.count)?;
        columns.read(self, 0, columns.count, |block| events.extend_from_slice(block))?;
        Ok(events)
    }

    fn events(&self, camera: &CameraInfo) -> Result<EventColumns, FormatError> {
        let size = (camera.width, camera.height);
        let camera = &camera.name;
        let column = |name: &str| self.dataset(&format!("{camera}/events/{name}"));
        let mut columns = EventColumns {
            size,
            x: column("x")?,
            y: column("y")?,
            t: column("t")?,
            p: column("p")?,
            cause: None,
            count: u64::MAX,
        };
        let mut rows = [0; 4];
        for (rows, dataset) in rows.iter_mut().zip([&columns.x, &columns.y, &columns.t, &columns.p]) {
            *rows = self.rows(dataset, "events")?;
            columns.count = columns.count.min(*rows);
        }
        // A killed writer, or one whose disk was full, may have extended some of the columns only.
        let uneven = rows.iter().any(|r| *r != columns.count);
        if uneven && self.closed && self.scalar::<u8>("evis/complete")? == 1 {
            let [x, y, t, p] = rows;
            return Err(self.out_of_step(format!(
                "the columns of {camera}/events have unlike lengths (x {x}, y {y}, t {t}, p {p})"
            )));
        }
        Ok(columns)
    }
}

impl EventColumns {
    /// Calls `visit` with the events `from..to`, a block at a time.
    fn read(
        &self,
        source: &Source<'_>,
        from: u64,
        to: u64,
        mut visit: impl FnMut(&[Event]),
    ) -> Result<(), FormatError> {
        let (mut at, mut earlier_us) = (from, i64::MIN);
        while at < to {
            let count = EVENTS_AT_ONCE.min(to - at);
            let x: Vec<u16> = source.slice(&self.x, at, count)?;
            let y: Vec<u16> = source.slice(&self.y, at, count)?;
            let p: Vec<u8> = source.slice(&self.p, at, count)?;
            let t: Vec<i64> = match self.t.element_size() {
                4 => source.slice::<u32>(&self.t, at, count)?.into_iter().map(i64::from).collect(),
                _ => source.slice(&self.t, at, count)?,
            };
            let mut block: Vec<Event> = t
                .iter()
                .zip(&x)
                .zip(&y)
                .zip(&p)
                .map(|(((&t, &x), &y), &p)| {
                    let mut event = Event::new(t, x, y, Polarity::Off);
                    event.p = i16::from(p);
                    event
                })
                .collect();
            check_events(&block, self.size, at, earlier_us).map_err(|what| source.out_of_step(what))?;
            earlier_us = block.last().map_or(earlier_us, |e| e.t);
            if let Some(cause) = &self.cause {
                let causes: Vec<u8> = source.slice(cause, at, count)?;
                for (event, cause) in block.iter_mut().zip(causes) {
                    *event =
                        event.with_cause(Cause::ALL.get(usize::from(cause)).copied().unwrap_or_default());
                }
            }
            visit(&block);
            at += count;
        }
        Ok(())
    }
}
