//! One source for films, folders of pictures and arrays of frames.

use std::path::{Path, PathBuf};

use evis_core::format::FormatError;
use evis_core::{ConfigError, Transfer};

use crate::error::VideoError;
use crate::ffmpeg::{Film, unequal};
use crate::folder::{Folder, TIMES_NAME};
use crate::npy::Stack;
use crate::picture::{Picture, Values};
use crate::times::{Clock, Times, on_grid, read_times};

/// What is read, and which part of it.
#[derive(Clone, Debug, PartialEq)]
pub struct SourceConfig {
    /// A film, a folder of pictures, or a `.npy` file.
    pub path: PathBuf,
    /// When frames were taken.
    pub clock: Clock,
    /// The curve of integers: Rec. 709 for films and sRGB for all else, where it is not given.
    pub transfer: Option<Transfer>,
    /// Pixels of the frames that come out; those of the source where it is not given.
    pub size: Option<(u32, u32)>,
    /// First frame: the first one this long after the source's first, microseconds.
    pub start_us: i64,
    /// Frames are read up to so long after the first one that is used.
    pub duration_us: Option<i64>,
    /// The ffmpeg to start, else the one that `EVIS_FFMPEG` names, else the one on PATH.
    pub ffmpeg: Option<PathBuf>,
}

impl SourceConfig {
    /// All of the frames at `path`.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self {
            path: path.into(),
            clock: Clock::Source,
            transfer: None,
            size: None,
            start_us: 0,
            duration_us: None,
            ffmpeg: None,
        }
    }
}

/// A frame and its time.
#[derive(Clone, Debug, PartialEq)]
pub struct TimedFrame {
    /// Number of the frame in its source, from 0.
    pub index: u64,
    /// Microseconds after the first frame that is used.
    pub t_us: i64,
    /// The picture, of the size asked for.
    pub picture: Picture,
}

/// Frames, one after the other; memory does not depend on how many there are.
#[derive(Debug)]
pub struct FrameSource {
    config: SourceConfig,
    kind: Kind,
    times: Option<Times>,
    transfer: Transfer,
    index: u64,
    /// Time of the source's first frame.
    origin_us: Option<i64>,
    /// Time of the first frame that is used.
    start_us: Option<i64>,
    last_us: Option<i64>,
    size: Option<(u32, u32)>,
    ended: bool,
    warnings: Vec<String>,
}

#[derive(Debug)]
enum Kind {
    Film(Box<Film>),
    Folder(Folder),
    Stack(Box<Stack>),
}

impl FrameSource {
    /// Opens what `config` names; nothing is decoded yet.
    ///
    /// # Errors
    /// A path that holds no frames, frames without times, a missing ffmpeg, a setting that cannot be.
    pub fn open(config: SourceConfig) -> Result<Self, VideoError> {
        let path = config.path.clone();
        config.transfer.unwrap_or_default().check()?;
        if let Clock::Rate(fps) = config.clock {
            Clock::rate(fps)?;
        }
        if let Some((width, height)) = config.size
            && !((1..=65_536).contains(&width) && (1..=65_536).contains(&height))
        {
            let size = format!("{width}x{height}");
            return Err(ConfigError::new("size", size, "between 1 and 65536 pixels a side").into());
        }
        if config.start_us < 0 {
            return Err(ConfigError::new("start", config.start_us, "0 or more").into());
        }
        if let Some(duration_us) = config.duration_us.filter(|us| *us <= 0) {
            return Err(ConfigError::new("duration", duration_us, "above 0").into());
        }
        let mut times = match &config.clock {
            Clock::List(times) => Some(times.clone()),
            Clock::Source | Clock::Rate(_) => None,
        };
        let mut warnings = Vec::new();
        let kind = if path.is_dir() {
            let own = path.join(TIMES_NAME);
            if config.clock == Clock::Source {
                if !own.is_file() {
                    let what = format!(
                        "a folder of pictures without {TIMES_NAME} does not say when they were taken"
                    );
                    let remedy = "give `fps` or `timestamps`";
                    return Err(FormatError::invalid(&path, what, remedy).into());
                }
                times = Some(read_times(&own)?);
            }
            Kind::Folder(Folder::open(&path, times.as_ref())?)
        } else if path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("npy")) {
            if config.clock == Clock::Source {
                let what = "an array of frames does not say when they were taken";
                let remedy = "give `fps` or `timestamps`";
                return Err(FormatError::invalid(&path, what, remedy).into());
            }
            Kind::Stack(Box::new(Stack::open(&path)?))
        } else {
            let film = Film::open(&path, config.ffmpeg.as_deref())?;
            if let (Some(curve), None) = (film.hdr(), config.transfer) {
                warnings.push(format!(
                    "{} is in high dynamic range ({curve}), whose curve is not known here: its values are read as Rec. \
                     709; convert it to standard range first, or choose with `transfer`",
                    path.display()
                ));
            }
            Kind::Film(Box::new(film))
        };
        if let (Some(times), Some(frames)) = (&times, kind.frames())
            && times.micros.len() as u64 != frames
        {
            let what = format!("it has {frames} frames, and there are {} times", times.micros.len());
            return Err(FormatError::invalid(&path, what, "give one time per frame").into());
        }
        let usual = if matches!(kind, Kind::Film(_)) { Transfer::Rec709 } else { Transfer::Srgb };
        let transfer = config.transfer.unwrap_or(usual);
        Ok(Self {
            config,
            kind,
            times,
            transfer,
            index: 0,
            origin_us: None,
            start_us: None,
            last_us: None,
            size: None,
            ended: false,
            warnings,
        })
    }

    /// What is read.
    pub const fn config(&self) -> &SourceConfig {
        &self.config
    }

    /// The curve through which integers are read; frames of 32-bit floats are light already.
    pub const fn transfer(&self) -> Transfer {
        self.transfer
    }

    /// Which kind of source this is: "film", "folder" or "stack".
    pub const fn kind(&self) -> &'static str {
        match self.kind {
            Kind::Film(_) => "film",
            Kind::Folder(_) => "folder",
            Kind::Stack(_) => "stack",
        }
    }

    /// Absolute time of the first frame that is used, as the source counts; 0 before it was read.
    pub fn offset_us(&self) -> i64 {
        self.start_us.unwrap_or(0)
    }

    /// How long the frames that are used will last, where that is known: for progress, and no promise.
    pub fn duration_us(&self) -> Option<i64> {
        let whole = match (&self.times, &self.config.clock, self.kind.frames(), &self.kind) {
            (Some(times), ..) => {
                times.micros.last().zip(times.micros.first()).map(|(last, first)| last - first)
            }
            (None, Clock::Rate(fps), Some(frames), _) => Some(on_grid(frames.saturating_sub(1), *fps)),
            (None, Clock::Source, _, Kind::Film(film)) => film.duration_us(),
            _ => None,
        };
        let left = whole.map(|whole| (whole - self.config.start_us).max(0));
        match (left, self.config.duration_us) {
            (Some(left), Some(asked)) => Some(left.min(asked)),
            (left, asked) => left.or(asked),
        }
    }

    /// What is allowed and probably not meant, and what ffmpeg complained about.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = self.warnings.clone();
        if let Kind::Film(film) = &self.kind {
            warnings.extend(film.warnings.iter().cloned());
        }
        warnings
    }

    /// The next frame; `None` after the last one.
    ///
    /// # Errors
    /// A frame that cannot be read, has another size than those before it, or a time that does not come after theirs;
    /// each names the frame.
    pub fn next_frame(&mut self) -> Result<Option<TimedFrame>, VideoError> {
        while !self.ended {
            let index = self.index;
            // Where times are known beforehand, nothing is decoded beyond the last one that is used.
            let known = self.known_time(index);
            if let Some(t_us) = known
                && self.is_beyond(t_us)
            {
                break;
            }
            let (own, picture) = match &mut self.kind {
                Kind::Film(film) => match film.next()? {
                    Some((own, picture)) => (own, picture),
                    None => break,
                },
                Kind::Folder(folder) => match folder.next()? {
                    Some(picture) => (None, picture),
                    None => break,
                },
                Kind::Stack(stack) => match stack.next()? {
                    Some(picture) => (None, picture),
                    None => break,
                },
            };
            self.index += 1;
            let t_us = self.time(index, known.or(own))?;
            let size = (picture.width, picture.height);
            let first = *self.size.get_or_insert(size);
            if first != size {
                return Err(unequal(&self.config.path, index, first, size));
            }
            let origin_us = *self.origin_us.get_or_insert(t_us);
            if let Some(last_us) = self.last_us
                && t_us <= last_us
            {
                let what = format!("frame {index} is at {t_us} us and the one before it at {last_us} us");
                let remedy = "times must increase; give `fps` or `timestamps`";
                return Err(FormatError::corrupt(&self.config.path, what, remedy).into());
            }
            self.last_us = Some(t_us);
            if t_us - origin_us < self.config.start_us {
                continue;
            }
            if self.is_beyond(t_us) {
                break;
            }
            let start_us = *self.start_us.get_or_insert(t_us);
            let picture = self.fit(picture, index)?;
            return Ok(Some(TimedFrame { index, t_us: t_us - start_us, picture }));
        }
        self.ended = true;
        Ok(None)
    }

    fn known_time(&self, index: u64) -> Option<i64> {
        match (&self.times, &self.config.clock) {
            (Some(times), _) => times.micros.get(usize::try_from(index).ok()?).copied(),
            (None, Clock::Rate(fps)) => Some(on_grid(index, *fps)),
            _ => None,
        }
    }

    fn time(&self, index: u64, told: Option<i64>) -> Result<i64, VideoError> {
        if let Some(t_us) = told {
            return Ok(t_us);
        }
        let (what, remedy) = match &self.times {
            Some(times) => (
                format!("it has a frame {index}, and there are {} times", times.micros.len()),
                "give one time per frame",
            ),
            None => (format!("frame {index} has no time"), "give `fps` or `timestamps`"),
        };
        Err(FormatError::corrupt(&self.config.path, what, remedy).into())
    }

    fn is_beyond(&self, t_us: i64) -> bool {
        self.start_us
            .zip(self.config.duration_us)
            .is_some_and(|(start_us, duration_us)| t_us - start_us > duration_us)
    }

    /// Brings the picture to the size asked for.
    fn fit(&self, picture: Picture, index: u64) -> Result<Picture, VideoError> {
        if let (Values::F32(_), Some(transfer)) = (&picture.values, self.config.transfer)
            && transfer != Transfer::Linear
        {
            let remedy = "linear, or left out: frames of 32-bit floats are light already";
            return Err(ConfigError::new("transfer", name(transfer), remedy).into());
        }
        if let Values::F32(values) = &picture.values
            && let Some(bad) = values.iter().position(|light| *light < 0.0 || light.is_infinite())
        {
            let pixel = bad / picture.channels;
            let (x, y) = (pixel % picture.width as usize, pixel / picture.width as usize);
            let value = values.get(bad).copied().unwrap_or_default();
            let what = format!("frame {index} has light {value} at pixel ({x}, {y})");
            let remedy = "light is finite and not negative; NaN is allowed and means unknown";
            return Err(FormatError::corrupt(&self.config.path, what, remedy).into());
        }
        match self.config.size {
            Some((width, height)) if (width, height) != (picture.width, picture.height) => {
                Ok(picture.resized(width, height, self.transfer)?)
            }
            _ => Ok(picture),
        }
    }
}

impl Kind {
    /// How many frames there are, where it is known.
    fn frames(&self) -> Option<u64> {
        match self {
            Self::Film(_) => None,
            Self::Folder(folder) => Some(folder.files.len() as u64),
            Self::Stack(stack) => Some(stack.frames),
        }
    }
}

/// A curve's name as users write it.
pub fn name(transfer: Transfer) -> String {
    match transfer {
        Transfer::Srgb => "srgb".into(),
        Transfer::Rec709 => "rec709".into(),
        Transfer::Gamma(gamma) => format!("gamma:{gamma}"),
        Transfer::Linear => "linear".into(),
    }
}

/// The curve of this name: srgb, rec709, linear, or gamma:G such as gamma:2.2.
///
/// # Errors
/// Another name, or a gamma that cannot be.
pub fn transfer(text: &str) -> Result<Transfer, ConfigError> {
    let refuse = || ConfigError::new("transfer", text, "srgb, rec709, linear, or gamma:G such as gamma:2.2");
    let curve = match text.split_once(':') {
        None => match text {
            "srgb" => Transfer::Srgb,
            "rec709" => Transfer::Rec709,
            "linear" => Transfer::Linear,
            _ => return Err(refuse()),
        },
        Some(("gamma", gamma)) => Transfer::Gamma(gamma.parse().map_err(|_| refuse())?),
        Some(_) => return Err(refuse()),
    };
    curve.check()?;
    Ok(curve)
}

/// A file of times, as [`Clock::List`].
///
/// # Errors
/// As [`read_times`].
pub fn clock_of(path: &Path) -> Result<Clock, VideoError> {
    Ok(Clock::List(read_times(path)?))
}
