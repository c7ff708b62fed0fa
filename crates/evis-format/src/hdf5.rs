//! HDF5: EVIS's own recordings, and the layouts of others.
//!
//! | layout | data sets |
//! |---|---|
//! | EVIS | `/<camera>/events/{x, y, t, p}` |
//! | DSEC, RVT | `/events/{x, y, t, p}`, `/t_offset` |
//! | `event_utils` | `/events/{xs, ys, ts, ps}`, ts in seconds |
//! | M3ED | `/prophesee/{left, right}/{x, y, t, p}` |
//! | v2e | `/events`, (N, 4): t, x, y, p |

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use evis_core::format::FormatError;
use evis_core::format::hdf5::{Recording, RecordingHeader, RecordingWriter};
use evis_core::limits::open_regular;
use evis_core::{CameraInfo, Event, Polarity};
use rust_hdf5::{H5Dataset, H5File, Hdf5Error};

use crate::check::refuse;
use crate::format::Format;
use crate::packet::Packet;
use crate::read::{EventReader, ReadOptions, StreamInfo};
use crate::write::{EventWriter, WriteOptions};

/// First bytes of an HDF5 file; its superblock may also lie at 512, 1024, 2048, ...
pub(crate) const SIGNATURE: &[u8; 8] = b"\x89HDF\r\n\x1a\n";
/// Rows that are read at once: four chunks of DSEC's.
const ROWS_AT_ONCE: u64 = 4 * 65_536;
/// Deflate expands at most 1032 times, and other filters little more on events: a data set that promises more
/// than this cannot be in the file.
const LARGEST_EXPANSION: u64 = 1 << 16;
/// Most rows of a file.
const MOST_ROWS: u64 = 1 << 40;

/// Where events lie.
#[derive(Clone, Debug, PartialEq)]
enum Layout {
    /// Data sets of t, x, y and p, and whether t is in seconds.
    Columns { names: [String; 4], seconds: bool },
    /// One data set of rows t, x, y, p.
    Rows(String),
}

/// Reads HDF5 files. The file is open during a read only.
pub(crate) struct Hdf5Reader {
    path: PathBuf,
    info: StreamInfo,
    layout: Layout,
    rows: u64,
    next: u64,
    failed: Option<String>,
}

/// Opens the file and runs `read`; what the decoder does with a damaged file, a panic included, comes out
/// as an error.
fn with_file<T>(path: &Path, read: impl FnOnce(&H5File) -> Result<T, Hdf5Error>) -> Result<T, FormatError> {
    // The system's own reason first.
    open_regular(path).map_err(|error| FormatError::io(path, "read", error))?;
    let attempt = catch_unwind(AssertUnwindSafe(|| {
        let file = H5File::options().no_locking().open(path)?;
        read(&file)
    }));
    match attempt {
        Ok(result) => result.map_err(|error| wrong(path, error.to_string())),
        Err(_) => Err(wrong(path, "the decoder of HDF5 gave up on it")),
    }
}

fn wrong(path: &Path, what: impl Into<String>) -> FormatError {
    FormatError::corrupt(
        path,
        what,
        "copy it again from its source, or open it with h5py and save what it holds",
    )
}

/// Length of the first axis, where the file can hold as much.
fn rows_of(path: &Path, dataset: &H5Dataset) -> Result<u64, Hdf5Error> {
    let bytes = std::fs::metadata(path).map_or(u64::MAX, |metadata| metadata.len());
    let shape = dataset.shape();
    let size = shape.iter().try_fold(dataset.element_size() as u64, |n, &d| n.checked_mul(d as u64));
    match (size, shape.first()) {
        (Some(size), Some(&rows)) if size / LARGEST_EXPANSION <= bytes && rows as u64 <= MOST_ROWS => {
            Ok(rows as u64)
        }
        _ => Err(Hdf5Error::InvalidState(format!(
            "a data set of shape {shape:?} promises more than the file holds"
        ))),
    }
}

impl Hdf5Reader {
    pub(crate) fn open(path: &Path, options: &ReadOptions) -> Result<Self, FormatError> {
        let mut info = StreamInfo::new(Format::Hdf5);
        info.size = options.size;
        let layout = match Recording::open(path) {
            Ok(recording) => {
                let camera = recording.find_camera(options.camera.as_deref())?;
                let header = recording.header();
                info.cameras = header.cameras.iter().map(|camera| camera.name.clone()).collect();
                let Some(camera) = header.cameras.get(camera) else {
                    return Err(wrong(path, "it has no camera"));
                };
                info.size = Some((camera.width, camera.height));
                info.camera = Some(camera.name.clone());
                info.t_offset_us = header.t_offset_us;
                info.properties.push(("layout".into(), "EVIS".into()));
                columns(&format!("{}/events", camera.name), ["t", "x", "y", "p"], false)
            }
            Err(_) => with_file(path, |file| Ok(find(path, file, &mut info, options)))??,
        };
        let rows = with_file(path, |file| match &layout {
            Layout::Columns { names, .. } => {
                let mut rows = u64::MAX;
                for name in names {
                    rows = rows.min(rows_of(path, &file.dataset(name)?)?);
                }
                Ok(rows)
            }
            Layout::Rows(name) => {
                let dataset = file.dataset(name)?;
                let shape = dataset.shape();
                match shape.get(1) {
                    Some(4) => rows_of(path, &dataset),
                    _ => Err(Hdf5Error::InvalidState(format!("{name} has shape {shape:?}, not (N, 4)"))),
                }
            }
        })?;
        info.events = Some(rows);
        Ok(Self { path: path.into(), info, layout, rows, next: 0, failed: None })
    }

    /// Events `from..from + count`, and what is wrong with the one after them, if anything is.
    fn read(&self, from: u64, count: u64) -> Result<(Vec<Event>, Option<String>), FormatError> {
        let (start, rows) = (from as usize, count as usize);
        with_file(&self.path, |file| {
            let whole = |name: &str, seconds| {
                let dataset = file.dataset(name)?;
                column(&dataset, start, rows, seconds)
            };
            let (t, x, y, p) = match &self.layout {
                Layout::Columns { names: [t, x, y, p], seconds } => {
                    (whole(t, *seconds)?, whole(x, false)?, whole(y, false)?, whole(p, false)?)
                }
                Layout::Rows(name) => {
                    let values: Vec<i64> =
                        file.dataset(name)?.read_numeric_slice_as(&[start, 0], &[rows, 4])?;
                    let values = values.as_chunks::<4>().0;
                    let of =
                        |k: usize| values.iter().filter_map(|row| row.get(k).copied()).collect::<Vec<_>>();
                    (of(0), of(1), of(2), of(3))
                }
            };
            Ok(self.assemble(&t, &x, &y, &p))
        })
    }

    fn assemble(&self, t: &[i64], x: &[i64], y: &[i64], p: &[i64]) -> (Vec<Event>, Option<String>) {
        let (width, height) = self.info.size.unwrap_or((1 << 16, 1 << 16));
        let mut events = Vec::with_capacity(t.len());
        for (((&t, &x), &y), &p) in t.iter().zip(x).zip(y).zip(p) {
            if !(0..i64::from(width)).contains(&x) || !(0..i64::from(height)).contains(&y) {
                return (events, Some(format!("x {x}, y {y} lies outside of {width}x{height}")));
            }
            let polarity = match p {
                0 | -1 => Polarity::Off,
                1 => Polarity::On,
                _ => return (events, Some(format!("polarity {p}"))),
            };
            events.push(Event::new(t, x as u16, y as u16, polarity));
        }
        (events, None)
    }

    fn time_at(&self, row: u64) -> Result<i64, FormatError> {
        let row = row as usize;
        let times = with_file(&self.path, |file| match &self.layout {
            Layout::Columns { names: [t, ..], seconds } => column(&file.dataset(t)?, row, 1, *seconds),
            Layout::Rows(name) => file.dataset(name)?.read_numeric_slice_as(&[row, 0], &[1, 1]),
        })?;
        Ok(times.first().copied().unwrap_or(i64::MAX))
    }
}

fn columns(group: &str, names: [&str; 4], seconds: bool) -> Layout {
    Layout::Columns { names: names.map(|name| format!("{group}/{name}")), seconds }
}

/// Finds the events of a file that EVIS did not write.
fn find(
    path: &Path,
    file: &H5File,
    info: &mut StreamInfo,
    options: &ReadOptions,
) -> Result<Layout, FormatError> {
    let has = |name: &str| file.dataset(name).is_ok();
    let has_all = |group: &str, names: [&str; 4]| names.iter().all(|name| has(&format!("{group}/{name}")));
    let scalar = |name: &str| {
        let dataset = file.dataset(name).ok()?;
        let value = if dataset.ndims() == 0 { dataset.read_numeric_as::<i64>() } else { return None };
        value.ok()?.first().copied()
    };
    let side =
        |value: Option<i64>| value.and_then(|v| u32::try_from(v).ok()).filter(|v| (1..=1 << 16).contains(v));
    const SHORT: [&str; 4] = ["t", "x", "y", "p"];
    const LONG: [&str; 4] = ["ts", "xs", "ys", "ps"];
    let layout = if has_all("events", SHORT) {
        info.size = side(scalar("events/width")).zip(side(scalar("events/height"))).or(info.size);
        info.t_offset_us = scalar("t_offset").unwrap_or(0);
        info.properties.push(("layout".into(), "DSEC".into()));
        columns("events", SHORT, is_float(file, "events/t"))
    } else if has_all("events", LONG) {
        info.properties.push(("layout".into(), "event_utils".into()));
        columns("events", LONG, is_float(file, "events/ts"))
    } else if let Ok(events) = file.dataset("events")
        && events.ndims() == 2
    {
        info.properties.push(("layout".into(), "v2e".into()));
        Layout::Rows("events".into())
    } else {
        let eyes = ["left", "right"];
        let found = eyes.iter().filter(|eye| has_all(&format!("prophesee/{eye}"), SHORT));
        info.cameras = found.map(|eye| (*eye).to_owned()).collect();
        let camera = match (&options.camera, info.cameras.as_slice()) {
            (Some(camera), cameras) if cameras.contains(camera) => camera.clone(),
            (None, [camera]) => camera.clone(),
            (_, []) => {
                let codec = if has("CD/events") {
                    "; events compressed by Metavision's ECF codec need Metavision: save them as RAW there"
                } else {
                    ""
                };
                return Err(FormatError::corrupt(
                    path,
                    "it has none of the known layouts of events",
                    format!("give an HDF5 file of EVIS, DSEC, RVT, event_utils, M3ED or v2e{codec}"),
                ));
            }
            (wanted, cameras) => {
                let what = match wanted {
                    Some(camera) => format!("there is no camera {camera}"),
                    None => format!("there are {} cameras", cameras.len()),
                };
                return Err(FormatError::invalid(
                    path,
                    what,
                    format!("choose one of {}", cameras.join(", ")),
                ));
            }
        };
        info.size = info.size.or(Some((1280, 720)));
        info.properties.push(("layout".into(), "M3ED".into()));
        let layout = columns(&format!("prophesee/{camera}"), SHORT, false);
        info.camera = Some(camera);
        layout
    };
    Ok(layout)
}

fn is_float(file: &H5File, name: &str) -> bool {
    let datatype = file.dataset(name).and_then(|dataset| dataset.datatype());
    matches!(datatype, Ok(rust_hdf5::DatatypeMessage::FloatingPoint { .. }))
}

/// A part of a column as whole numbers; seconds become microseconds.
fn column(dataset: &H5Dataset, start: usize, rows: usize, seconds: bool) -> Result<Vec<i64>, Hdf5Error> {
    if seconds {
        let values: Vec<f64> = dataset.read_numeric_slice_as(&[start], &[rows])?;
        return Ok(values.into_iter().map(|seconds| (seconds * 1.0e6).round() as i64).collect());
    }
    if dataset.element_size() == 1 {
        // Booleans are enumerations, which have no numbers; -1 and 255 are the same byte.
        let values: Vec<u8> = dataset.read_slice(&[start], &[rows])?;
        return Ok(values.into_iter().map(|value| if value == 255 { -1 } else { value.into() }).collect());
    }
    dataset.read_numeric_slice_as(&[start], &[rows])
}

impl EventReader for Hdf5Reader {
    fn info(&self) -> &StreamInfo {
        &self.info
    }

    fn read_packet(&mut self, packet: &mut Packet) -> Result<bool, FormatError> {
        packet.clear();
        if let Some(what) = &self.failed {
            return Err(wrong(&self.path, what));
        }
        let count = ROWS_AT_ONCE.min(self.rows - self.next.min(self.rows));
        if count == 0 {
            return Ok(false);
        }
        let (events, failed) = match self.read(self.next, count) {
            Ok(read) => read,
            Err(FormatError::Corrupt { what, .. }) => {
                let end = self.next + count;
                return Err(wrong(
                    &self.path,
                    format!("events {} to {end} cannot be read ({what})", self.next),
                ));
            }
            Err(error) => return Err(error),
        };
        self.next += events.len() as u64;
        self.failed = failed.map(|what| format!("event {} has {what}", self.next));
        packet.events = events;
        match &self.failed {
            Some(what) if packet.is_empty() => Err(wrong(&self.path, what)),
            _ => Ok(true),
        }
    }

    fn part(&self) -> Option<f64> {
        Some(self.next as f64 / self.rows.max(1) as f64)
    }

    fn seek(&mut self, t_us: i64) -> Result<(), FormatError> {
        let (mut low, mut high) = (0, self.rows);
        while low < high {
            let middle = low + (high - low) / 2;
            if self.time_at(middle)? < t_us {
                low = middle + 1;
            } else {
                high = middle;
            }
        }
        (self.next, self.failed) = (low, None);
        Ok(())
    }
}

/// Writes EVIS's own recordings: DSEC's columns in the group of one camera, and at the root.
pub(crate) struct Hdf5Writer {
    path: PathBuf,
    writer: RecordingWriter,
}

impl Hdf5Writer {
    pub(crate) fn create(path: &Path, options: &WriteOptions) -> Result<Self, FormatError> {
        let camera = CameraInfo::uncalibrated("camera", options.size);
        let header = RecordingHeader::of(vec![camera]);
        let writer = RecordingWriter::create(path, &header, options.overwrite)?;
        Ok(Self { path: path.into(), writer })
    }
}

impl EventWriter for Hdf5Writer {
    fn write(&mut self, packet: &Packet) -> Result<(), FormatError> {
        refuse(&self.path, Format::Hdf5, packet.frames.len(), "frames beside events")?;
        refuse(&self.path, Format::Hdf5, packet.imu.len(), "inertial samples")?;
        refuse(&self.path, Format::Hdf5, packet.triggers.len(), "triggers")?;
        self.writer.write_events(0, &packet.events)
    }

    fn write_events(&mut self, events: &[Event]) -> Result<(), FormatError> {
        self.writer.write_events(0, events)
    }

    fn finish(self: Box<Self>) -> Result<(), FormatError> {
        self.writer.finish("{}")
    }
}
