//! Truth as a file: a recording of one camera with a group `/truth` beside it.
//!
//! ```text
//! /truth/duration_us          i64      attribute version
//! /truth/{threshold_on, threshold_off, log_eps} f32, reference_luminance f64      NaN where unknown
//! /truth/pixels               u16 (N, 2)   x, y; by y, then x
//! /truth/speed                f32 (E,)     pixels per second at each event
//! /truth/event_region         u8 (E,)      0 interior, 1 silhouette, 2 disoccluded, 3 shadow edge
//! /truth/span_start           u32 (N + 1,) spans of pixel i: span_start[i] to span_start[i + 1]
//! /truth/{span_t_us i64, span_region u8}   (S,)   from span_t_us on the pixel lies in span_region
//! /truth/provenance_json      string (1,)
//! ```
//! Arrays without entries are left out.

use std::path::Path;

use rust_hdf5::{FilterPipeline, H5File, H5Group, H5Type, Hdf5Error};

use super::layout::{scalar, strings};
use super::reader::{Source, with_file};
use super::units::describe;
use super::{EVENTS_PER_CHUNK, GZIP_LEVEL, Recording, RecordingHeader, RecordingWriter};
use crate::format::FormatError;
use crate::sensor::SensorConfig;
use crate::truth::{Region, RegionSpan, Truth};

/// Version of the group's layout, in the attribute `/truth@version`.
const TRUTH_VERSION: &str = "1";
/// Most pixels of a recording that is taken as truth: the list of them stays below 300 MB.
const MOST_PIXELS: u64 = 1 << 26;

impl Truth {
    /// Writes the truth to an HDF5 file at `path`, which also opens as a recording.
    ///
    /// # Errors
    /// As [`RecordingWriter::create`], and a truth that contradicts itself.
    pub fn write(&self, path: &Path, overwrite: bool) -> Result<(), FormatError> {
        self.check().map_err(|e| {
            FormatError::invalid(path, e.to_string(), "write a truth whose parts fit together")
        })?;
        let header = RecordingHeader {
            method: "truth".into(),
            config_toml: config_toml(self).map_err(|e| {
                FormatError::invalid(path, format!("the sensor cannot be stored: {e}"), "use finite settings")
            })?,
            duration_us: Some(self.duration_us),
            ..RecordingHeader::of(vec![self.camera.clone()])
        };
        let mut writer = RecordingWriter::create_with(path, &header, overwrite, |file| fill(file, self))?;
        writer.write_events(0, &self.events)?;
        writer.finish(&format!("{{\"stream_s\": {}}}", self.duration_us as f64 / 1.0e6))
    }

    /// Reads a truth that [`Truth::write`] wrote.
    ///
    /// # Errors
    /// A missing file, one that holds no truth, and one that is damaged.
    pub fn read(path: &Path) -> Result<Self, FormatError> {
        let recording = Recording::open(path)?;
        if !has_truth(path)? {
            return Err(FormatError::corrupt(
                path,
                "it has no group truth",
                "give a truth file, or take the recording itself as truth",
            ));
        }
        let truth = with_file(path, |source| read(source, recording.header()))?;
        let damaged = |e: &dyn std::fmt::Display| {
            FormatError::corrupt(
                path,
                e.to_string(),
                "make the truth again, or copy it again from its source",
            )
        };
        truth.check().map_err(|e| damaged(&e))?;
        Ok(truth)
    }

    /// Takes camera `camera` of a recording as truth: all its pixels, no image speeds, everything interior.
    ///
    /// Thresholds, `eps` and `Y_ref` are those of the settings that the recording stores, NaN where it stores none.
    /// The duration is what the writer's report says (`stream_s`), else one microsecond past the last event.
    ///
    /// # Errors
    /// No such camera, a file that can no longer be read, and events that are not sorted or lie outside the image.
    pub fn from_recording(recording: &Recording, camera: usize) -> Result<Self, FormatError> {
        let events = recording.events(camera)?;
        let info = recording.header().cameras.get(camera).cloned();
        let info = info.ok_or_else(|| recording.no_camera(&camera.to_string()))?;
        if u64::from(info.width) * u64::from(info.height) > MOST_PIXELS {
            return Err(FormatError::invalid(
                recording.path(),
                format!(
                    "camera {} has {}x{} pixels, too many for a truth",
                    info.name, info.width, info.height
                ),
                format!("use one of at most {MOST_PIXELS} pixels"),
            ));
        }
        let (sensor, reference_luminance) = stored_sensor(&recording.header().config_toml, &info.name);
        let after_last = events.last().map_or(1, |e| e.t.saturating_add(1));
        let duration_us = stated_duration(recording)?.map_or(after_last, |stated| stated.max(after_last));
        let truth = Self::from_events(events, info, sensor, reference_luminance, duration_us);
        truth.check().map_err(|e| {
            FormatError::corrupt(recording.path(), e.to_string(), "record it again, or copy it again")
        })?;
        Ok(truth)
    }

    /// Reads `path` as truth: a truth file, or camera `camera` of a recording (the only one where none is named).
    ///
    /// # Errors
    /// As [`Truth::read`] and [`Truth::from_recording`]; several cameras and no name, or a name that is none.
    pub fn load(path: &Path, camera: Option<&str>) -> Result<Self, FormatError> {
        let recording = Recording::open(path)?;
        let index = recording.find_camera(camera)?;
        if has_truth(path)? { Self::read(path) } else { Self::from_recording(&recording, index) }
    }
}

/// What the settings in a recording say of the sensor of camera `camera`, and `Y_ref`; NaN where they say nothing. The
/// settings of a whole run have them under `run`: `sensors` by camera, and `sensor` for all that it does not name.
pub fn stored_sensor(config_toml: &str, camera: &str) -> (SensorConfig, f64) {
    let mut sensor = SensorConfig {
        threshold_on: f32::NAN,
        threshold_off: f32::NAN,
        log_eps: f32::NAN,
        ..SensorConfig::default()
    };
    let table = config_toml.parse::<toml::Table>().unwrap_or_default();
    let Some(run) = table.get("run") else { return (sensor, f64::NAN) };
    let own = run.get("sensors").and_then(|sensors| sensors.get(camera));
    if let Some(stored) = own.or(run.get("sensor")) {
        if let Ok(whole) = stored.clone().try_into() {
            sensor = whole;
        }
        // What is not written is not known, whatever the defaults are; and settings of another version may not
        // convert as a whole.
        let number =
            |name: &str| stored.get(name).and_then(toml::Value::as_float).map_or(f32::NAN, |v| v as f32);
        sensor.threshold_on = number("threshold_on");
        sensor.threshold_off = number("threshold_off");
        sensor.log_eps = number("log_eps");
    }
    (sensor, run.get("reference_luminance").and_then(toml::Value::as_float).unwrap_or(f64::NAN))
}

/// Length in microseconds that the writer's report states.
pub(super) fn stated_duration(recording: &Recording) -> Result<Option<i64>, FormatError> {
    let report = recording.report()?.and_then(|json| serde_json::from_str::<serde_json::Value>(&json).ok());
    let seconds = report.and_then(|r| r.get("stream_s")?.as_f64());
    Ok(seconds.filter(|s| (0.0..1.0e9).contains(s)).map(|s| (s * 1.0e6).round() as i64))
}

fn config_toml(truth: &Truth) -> Result<String, toml::ser::Error> {
    let mut run = toml::Table::new();
    run.insert("sensor".into(), toml::Value::try_from(&truth.sensor)?);
    if truth.reference_luminance.is_finite() {
        run.insert("reference_luminance".into(), truth.reference_luminance.into());
    }
    let mut table = toml::Table::new();
    table.insert("run".into(), run.into());
    toml::to_string(&table)
}

fn fill(file: &H5File, truth: &Truth) -> Result<(), Hdf5Error> {
    let group = file.create_group("truth")?;
    group.set_attr_string("version", TRUTH_VERSION)?;
    scalar(&group, "duration_us", truth.duration_us)?;
    scalar(&group, "threshold_on", truth.sensor.threshold_on)?;
    scalar(&group, "threshold_off", truth.sensor.threshold_off)?;
    scalar(&group, "log_eps", truth.sensor.log_eps)?;
    scalar(&group, "reference_luminance", truth.reference_luminance)?;
    column(&group, "pixels", truth.pixels.as_flattened(), 2)?;
    column(&group, "speed", &truth.speed, 1)?;
    let codes = |regions: &[Region]| regions.iter().map(|r| *r as u8).collect::<Vec<_>>();
    column(&group, "event_region", &codes(&truth.event_region), 1)?;
    column(&group, "span_start", &truth.span_start, 1)?;
    column(&group, "span_t_us", &truth.spans.iter().map(|s| s.t_us).collect::<Vec<_>>(), 1)?;
    column(&group, "span_region", &truth.spans.iter().map(|s| s.region as u8).collect::<Vec<_>>(), 1)?;
    strings(&group, "provenance_json", &[&truth.provenance])
}

/// A data set of `width` values per row; none where there are no rows.
fn column<T: H5Type>(group: &H5Group, name: &str, values: &[T], width: usize) -> Result<(), Hdf5Error> {
    let rows = values.len() / width;
    if rows == 0 {
        return Ok(());
    }
    let with = |rows: usize| if width == 1 { vec![rows] } else { vec![rows, width] };
    let dataset = group
        .new_dataset::<T>()
        .shape(with(rows))
        .chunk(&with(rows.min(EVENTS_PER_CHUNK)))
        .filter_pipeline(FilterPipeline::shuffle_deflate(size_of::<T>() as u32, GZIP_LEVEL))
        .create(name)?;
    describe(&dataset, name)?;
    dataset.write_raw(values)
}

fn has_truth(path: &Path) -> Result<bool, FormatError> {
    with_file(path, |source| source.has("truth"))
}

fn read(source: &Source<'_>, header: &RecordingHeader) -> Result<Truth, FormatError> {
    let group = source.check("truth", source.file.root_group().group("truth"))?;
    let version = source.check("truth", group.attr_string("version"))?;
    if version != TRUTH_VERSION {
        return Err(FormatError::corrupt(
            source.path,
            format!("its truth has version {version:?}, and this program reads {TRUTH_VERSION}"),
            "make it again, or read it with the program that made it",
        ));
    }
    let [camera] = header.cameras.as_slice() else {
        return Err(source.damaged(format!("a truth of {} cameras, and not of one", header.cameras.len())));
    };
    let present = source.check("truth", group.dataset_names())?;
    let present = |name: &str| present.iter().any(|n| n == name);
    let (mut sensor, _) = stored_sensor(&header.config_toml, &camera.name);
    sensor.threshold_on = source.scalar("truth/threshold_on")?;
    sensor.threshold_off = source.scalar("truth/threshold_off")?;
    sensor.log_eps = source.scalar("truth/log_eps")?;
    let pixels: Vec<u16> = values(source, "pixels", 2, present("pixels"))?;
    let span_t_us: Vec<i64> = values(source, "span_t_us", 1, present("span_t_us"))?;
    let span_region = regions(source, "span_region", present("span_region"))?;
    if span_t_us.len() != span_region.len() {
        return Err(source.damaged("truth/span_t_us and truth/span_region differ in length"));
    }
    let spans = span_t_us.into_iter().zip(span_region);
    let provenance = source.dataset("truth/provenance_json")?.read_vlen_strings();
    Ok(Truth {
        camera: camera.clone(),
        sensor,
        reference_luminance: source.scalar("truth/reference_luminance")?,
        duration_us: source.scalar("truth/duration_us")?,
        pixels: pixels.as_chunks().0.to_vec(),
        events: source.all_events(camera)?,
        speed: values(source, "speed", 1, present("speed"))?,
        event_region: regions(source, "event_region", present("event_region"))?,
        span_start: values(source, "span_start", 1, present("span_start"))?,
        spans: spans.map(|(t_us, region)| RegionSpan { t_us, region }).collect(),
        provenance: source.check("truth/provenance_json", provenance)?.concat(),
    })
}

/// A data set of `width` values per row; empty where it is not present.
fn values<T: H5Type>(
    source: &Source<'_>,
    name: &str,
    width: usize,
    present: bool,
) -> Result<Vec<T>, FormatError> {
    if !present {
        return Ok(Vec::new());
    }
    let name = format!("truth/{name}");
    let dataset = source.dataset(&name)?;
    let rows = usize::try_from(source.rows(&dataset, &name)?).unwrap_or(usize::MAX);
    let shape = if width == 1 { vec![rows] } else { vec![rows, width] };
    if dataset.shape() != shape || dataset.element_size() != size_of::<T>() {
        return Err(source.damaged(format!("{name} has shape {:?} or another type", dataset.shape())));
    }
    source.fits((rows as u64).saturating_mul((width * size_of::<T>()) as u64), &name)?;
    source.check(&name, dataset.read_slice(&vec![0; shape.len()], &shape))
}

fn regions(source: &Source<'_>, name: &str, present: bool) -> Result<Vec<Region>, FormatError> {
    let codes: Vec<u8> = values(source, name, 1, present)?;
    let region = |code| {
        Region::from_code(code).ok_or_else(|| source.damaged(format!("truth/{name} holds region {code}")))
    };
    codes.into_iter().map(region).collect()
}
