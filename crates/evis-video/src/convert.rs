//! From frames to a recording.

use std::path::{Path, PathBuf};
use std::time::Instant;

use evis_core::format::hdf5::{RecordingHeader, RecordingWriter};
use evis_core::{
    CameraInfo, ConfigError, EmulatorConfig, Event, EventEmulator, Sensor, SensorConfig, Transfer,
};
use serde::Serialize;

use crate::error::VideoError;
use crate::picture::Picture;
use crate::source::{FrameSource, TimedFrame, name};

/// What makes events of frames.
#[derive(Clone, Debug, PartialEq)]
pub struct VideoConfig {
    /// The sensor.
    pub sensor: SensorConfig,
    /// Seed of everything random.
    pub seed: u64,
    /// `Y_ref` of the sensor's formula; white of integer frames is 1.
    pub reference_luminance: f32,
    /// Threads; 0: as many as there are cores. No event depends on it.
    pub threads: usize,
    /// Name of the camera in the recording.
    pub camera: String,
}

impl Default for VideoConfig {
    fn default() -> Self {
        Self {
            sensor: SensorConfig::default(),
            seed: 0,
            reference_luminance: 1.0,
            threads: 0,
            camera: "camera".into(),
        }
    }
}

/// Puts frames between frames: an optical flow, a network.
pub trait Upsampler: Send + std::fmt::Debug {
    /// What recordings call it.
    fn name(&self) -> String;

    /// Frames between `before` and `after`, of their size, with their times, in order: linear light, one channel. Integers are
    /// read through `transfer`.
    ///
    /// # Errors
    /// [`VideoError::Between`]: frames that it cannot use.
    fn between(
        &mut self,
        before: &TimedFrame,
        after: &TimedFrame,
        transfer: Transfer,
    ) -> Result<Vec<(i64, Picture)>, VideoError>;
}

/// Frames on their way through a sensor.
#[derive(Debug)]
pub struct VideoStream {
    source: FrameSource,
    config: VideoConfig,
    upsampler: Option<Box<dyn Upsampler>>,
    /// The last frame, where an upsampler needs it.
    before: Option<TimedFrame>,
    /// Frames that were put between those of the source.
    between: u64,
    /// Made when the first frame says how large it is.
    emulator: Option<EventEmulator>,
    frames: u64,
    end_us: i64,
    /// What is said of the first frame.
    doubt: Option<String>,
}

/// The events up to a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameEvents {
    /// Number of the frame in its source.
    pub index: u64,
    /// Microseconds after the first frame that is used.
    pub t_us: i64,
    /// Events since the frame before.
    pub events: Vec<Event>,
}

impl VideoStream {
    /// Puts a sensor behind `source`.
    ///
    /// # Errors
    /// A sensor that cannot be.
    pub fn new(source: FrameSource, config: VideoConfig) -> Result<Self, VideoError> {
        Sensor::new(config.sensor.clone())?;
        if !(1e-30..=1e30).contains(&config.reference_luminance) {
            let remedy = "between 1e-30 and 1e30";
            return Err(ConfigError::new("reference_luminance", config.reference_luminance, remedy).into());
        }
        Ok(Self {
            source,
            config,
            upsampler: None,
            before: None,
            between: 0,
            emulator: None,
            frames: 0,
            end_us: 0,
            doubt: None,
        })
    }

    /// With frames of `upsampler` between those of the source.
    #[must_use]
    pub fn upsampled(self, upsampler: Box<dyn Upsampler>) -> Self {
        Self { upsampler: Some(upsampler), ..self }
    }

    /// Where frames come from.
    pub const fn source(&self) -> &FrameSource {
        &self.source
    }

    /// Width and height, once a frame was read.
    pub fn size(&self) -> Option<(u32, u32)> {
        self.emulator.as_ref().map(|emulator| (emulator.config().width, emulator.config().height))
    }

    /// What is said of frames that come seldom, where nothing puts others between them.
    fn seldom(&self) -> Option<String> {
        let intervals = self.frames.saturating_sub(1) as f64;
        let rate_hz = intervals / (self.end_us as f64 / 1e6);
        (self.upsampler.is_none() && intervals > 0.0 && rate_hz <= SELDOM_HZ).then(|| {
            format!(
                "frames come at {} Hz: what moves by more than a pixel from one to the next fires in ramps, and not when its \
                 edges pass; `upsampler` puts frames between them by optical flow",
                (rate_hz * 10.0).round() / 10.0
            )
        })
    }

    /// Reads a frame; gives the events since the one before, none for the first. `None` after the last frame.
    ///
    /// # Errors
    /// As [`FrameSource::next_frame`] and [`Upsampler::between`], and frames that the sensor refuses.
    pub fn next_events(&mut self) -> Result<Option<FrameEvents>, VideoError> {
        let next = tracing::trace_span!("decode frame").in_scope(|| self.source.next_frame())?;
        let Some(frame) = next else { return Ok(None) };
        let (picture, transfer) = (&frame.picture, self.source.transfer());
        if self.emulator.is_none() {
            self.doubt = picture.values.hardly_light(self.config.reference_luminance);
        }
        let between = match (&mut self.upsampler, &self.before) {
            (Some(upsampler), Some(before)) => {
                tracing::trace_span!("upsample").in_scope(|| upsampler.between(before, &frame, transfer))?
            }
            _ => Vec::new(),
        };
        let emulator = match &mut self.emulator {
            Some(emulator) => emulator,
            none => none.insert(EventEmulator::new(EmulatorConfig {
                width: picture.width,
                height: picture.height,
                seed: self.config.seed,
                sensor: self.config.sensor.clone(),
                reference_luminance: self.config.reference_luminance,
                threads: self.config.threads,
                ..EmulatorConfig::default()
            })?),
        };
        let mut events = Vec::new();
        // A sensor sees frames of one kind: those between are light, of one channel.
        let light = match &self.upsampler {
            Some(_) => Some(picture.resized(picture.width, picture.height, transfer)?),
            None => None,
        };
        let between: Vec<_> =
            between.into_iter().map(|(t_us, made)| (t_us, made.repeated(picture.channels))).collect();
        let given = (frame.t_us, light.as_ref().unwrap_or(picture));
        for (t_us, picture) in between.iter().map(|(t_us, picture)| (*t_us, picture)).chain([given]) {
            let mut lists = [Vec::new()];
            tracing::trace_span!("emulate sensor", t_us)
                .in_scope(|| emulator.push_into(&picture.frames(transfer), t_us, &mut lists))?;
            let [fired] = lists;
            events.extend(fired);
        }
        self.frames += 1;
        self.between += between.len() as u64;
        self.end_us = frame.t_us;
        let (index, t_us) = (frame.index, frame.t_us);
        self.before = self.upsampler.is_some().then_some(frame);
        Ok(Some(FrameEvents { index, t_us, events }))
    }
}

/// Where a recording stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// Microseconds of the stream that are done.
    pub t_us: i64,
    /// How many there will be, where that is known.
    pub duration_us: Option<i64>,
    /// Frames that were read.
    pub frames: u64,
    /// Events that were written.
    pub events: u64,
}

/// What a conversion did.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VideoReport {
    /// The recording.
    pub output: PathBuf,
    /// What was read.
    pub input: PathBuf,
    /// "film", "folder" or "stack".
    pub kind: &'static str,
    /// Whether it was asked to stop before the last frame; the recording is complete up to there.
    pub interrupted: bool,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Frames that were used.
    pub frames: u64,
    /// Frames that were put between them.
    pub between: u64,
    /// Time of the first one as the source counts it, microseconds.
    pub offset_us: i64,
    /// From the first to the last one, seconds.
    pub stream_s: f64,
    /// Seconds of work.
    pub wall_s: f64,
    /// All events.
    pub events: u64,
    /// ON events.
    pub on: u64,
    /// OFF events.
    pub off: u64,
    /// Pixel values that were NaN.
    pub unknown: u64,
    /// Times that a pixel would have fired more events in one interval than it may.
    pub clamped: u64,
    /// Events that were lost to the refractory period.
    pub suppressed: u64,
    /// Events that were lost to the readout's rate limit.
    pub dropped: u64,
    /// Curve of the frames.
    pub transfer: String,
    /// What was probably not meant, and what ffmpeg complained about.
    pub warnings: Vec<String>,
}

/// Settings as they are stored in the recording.
#[derive(Serialize)]
struct Stored<'a> {
    evis: &'static str,
    video: StoredSource,
    run: StoredRun<'a>,
}

#[derive(Serialize)]
struct StoredSource {
    input: String,
    kind: &'static str,
    clock: String,
    transfer: String,
    /// What made frames between frames.
    #[serde(skip_serializing_if = "Option::is_none")]
    upsampler: Option<String>,
}

#[derive(Serialize)]
struct StoredRun<'a> {
    method: &'static str,
    seed: u64,
    reference_luminance: f32,
    sensor: &'a SensorConfig,
}

/// How films are called among the methods of sampling.
const METHOD: &str = "frames";

/// At this rate of frames, which cameras for people have, and below it, most motion is more than a pixel per frame.
const SELDOM_HZ: f64 = 60.5;

/// Longest length that is believed to fit 32 bits of microseconds (4295 s): containers may err.
const NARROW_US: i64 = 2_000_000_000;

/// Reads all frames of `stream` and writes a recording to `output`. `going` hears of each frame, and says whether to
/// go on; the recording is whole up to where it ends.
///
/// # Errors
/// As [`VideoStream::next_events`], and a file that cannot be written. A recording that was begun stays readable, and
/// counts as incomplete.
pub fn convert(
    mut stream: VideoStream,
    output: &Path,
    overwrite: bool,
    mut going: impl FnMut(&Progress) -> bool,
) -> Result<VideoReport, VideoError> {
    let started = Instant::now();
    let duration_us = stream.source.duration_us();
    let mut writer: Option<RecordingWriter> = None;
    let (mut on, mut events) = (0_u64, 0_u64);
    let mut interrupted = false;
    while let Some(part) = stream.next_events()? {
        // Made with the first frame: an input that cannot be read leaves no file.
        let writer = match &mut writer {
            Some(writer) => writer,
            none => none.insert(RecordingWriter::create(output, &header(&stream, duration_us)?, overwrite)?),
        };
        tracing::trace_span!("write").in_scope(|| {
            writer.write_events(0, &part.events)?;
            writer.flush_if_due()
        })?;
        events += part.events.len() as u64;
        on += part.events.iter().filter(|event| event.p == 1).count() as u64;
        if !going(&Progress { t_us: part.t_us, duration_us, frames: stream.frames, events }) {
            interrupted = true;
            break;
        }
    }
    let (Some(writer), Some(emulator)) = (writer, &stream.emulator) else {
        let config = stream.source.config();
        let start_s = config.start_us as f64 / 1e6;
        return Err(ConfigError::new("start", format!("{start_s} s"), "before the last frame").into());
    };
    let total = *emulator.total_report();
    let mut warnings = stream.source.warnings();
    warnings.extend(stream.config.sensor.warnings());
    warnings.extend(stream.doubt.clone());
    warnings.extend(stream.seldom());
    if stream.frames == 1 && !interrupted {
        warnings.push("there is only one frame, and events come from changes between frames".into());
    }
    let report = VideoReport {
        output: output.into(),
        input: stream.source.config().path.clone(),
        kind: stream.source.kind(),
        interrupted,
        width: emulator.config().width,
        height: emulator.config().height,
        frames: stream.frames,
        between: stream.between,
        offset_us: stream.source.offset_us(),
        stream_s: stream.end_us as f64 / 1e6,
        wall_s: started.elapsed().as_secs_f64(),
        events,
        on,
        off: events - on,
        unknown: total.unknown,
        clamped: total.clamped,
        suppressed: total.suppressed,
        dropped: total.dropped,
        transfer: name(stream.source.transfer()),
        warnings,
    };
    let json = serde_json::to_string_pretty(&report)
        .map_err(|error| ConfigError::new("report", error, "representable as JSON"))?;
    writer.finish(&json)?;
    Ok(report)
}

fn header(stream: &VideoStream, duration_us: Option<i64>) -> Result<RecordingHeader, VideoError> {
    let (width, height) = stream.size().unwrap_or_default();
    let (config, source) = (&stream.config, stream.source.config());
    let clock = match &source.clock {
        crate::Clock::Source => "source".to_owned(),
        crate::Clock::Rate(fps) => format!("{fps} Hz"),
        crate::Clock::List(times) => format!("list of {}", times.micros.len()),
    };
    let stored = Stored {
        evis: env!("CARGO_PKG_VERSION"),
        video: StoredSource {
            input: source.path.display().to_string(),
            kind: stream.source.kind(),
            clock,
            transfer: name(stream.source.transfer()),
            upsampler: stream.upsampler.as_ref().map(|upsampler| upsampler.name()),
        },
        run: StoredRun {
            method: METHOD,
            seed: config.seed,
            reference_luminance: config.reference_luminance,
            sensor: &config.sensor,
        },
    };
    let config_toml = toml::to_string(&stored)
        .map_err(|error| ConfigError::new("settings", error, "representable as TOML"))?;
    // The lens of a film is not known.
    let camera = CameraInfo::uncalibrated(config.camera.clone(), (width, height));
    Ok(RecordingHeader {
        cameras: vec![camera],
        seed: config.seed,
        method: METHOD.into(),
        environment: 0,
        config_toml,
        duration_us: duration_us.filter(|us| *us <= NARROW_US),
        t_offset_us: stream.source.offset_us(),
        labels: Vec::new(),
    })
}
