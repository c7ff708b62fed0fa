//! Films through ffmpeg: raw frames from one pipe, their times from the other.
//!
//! The filter `showinfo` tells each frame's time in the stream's own ticks, so that frames of variable length keep their
//! times exactly, and no ffprobe is needed.

use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::mpsc::{Receiver, Sender, channel};

use evis_core::format::FormatError;
use evis_core::limits::open_regular;

use crate::error::VideoError;
use crate::picture::{Picture, Values};

/// Names the ffmpeg to use; the Python package's `video` extra sets it.
pub const FFMPEG_VARIABLE: &str = "EVIS_FFMPEG";

/// Messages of ffmpeg that are kept.
const MOST_MESSAGES: usize = 8;

/// What a first look at a film tells.
#[derive(Clone, Debug, Default, PartialEq)]
struct About {
    /// Length that the container states.
    duration_us: Option<i64>,
    /// More than 8 bits per value.
    deep: bool,
    /// A transfer curve for high dynamic range.
    hdr: Option<&'static str>,
}

/// A running ffmpeg.
#[derive(Debug)]
pub(crate) struct Film {
    path: PathBuf,
    about: About,
    child: Child,
    pixels: BufReader<ChildStdout>,
    messages: Receiver<Message>,
    time_base: Option<(i64, i64)>,
    size: Option<(u32, u32)>,
    /// Frames that were read.
    read: u64,
    /// What ffmpeg complained about.
    pub warnings: Vec<String>,
}

/// A line of ffmpeg's messages.
#[derive(Debug)]
enum Message {
    TimeBase(i64, i64),
    Frame { pts: Option<i64>, size: (u32, u32) },
    Trouble(String),
}

fn program(named: Option<&Path>) -> OsString {
    if let Some(named) = named {
        return named.into();
    }
    std::env::var_os(FFMPEG_VARIABLE).filter(|name| !name.is_empty()).unwrap_or_else(|| "ffmpeg".into())
}

fn command(program: &OsString, path: &Path) -> Command {
    let mut command = Command::new(program);
    // `file:` keeps names with a colon from being taken for addresses.
    let mut input = OsString::from("file:");
    input.push(path);
    command.args(["-nostdin", "-hide_banner", "-nostats", "-loglevel", "level+info", "-i"]).arg(input);
    command.stdin(Stdio::null()).stderr(Stdio::piped());
    // Ctrl-C is for us: ffmpeg ends when its pipe closes.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    command
}

fn missing(program: &OsString, error: &std::io::Error) -> VideoError {
    VideoError::NoFfmpeg {
        program: Path::new(program).display().to_string(),
        reason: error.to_string(),
        variable: FFMPEG_VARIABLE,
    }
}

impl Film {
    /// Starts ffmpeg on the film at `path`.
    pub fn open(path: &Path, ffmpeg: Option<&Path>) -> Result<Self, VideoError> {
        open_regular(path).map_err(|error| FormatError::io(path, "read", error))?;
        let program = program(ffmpeg);
        let about = look(&program, path)?;
        Self::start(&program, path, about)
    }

    fn start(program: &OsString, path: &Path, about: About) -> Result<Self, VideoError> {
        // Before 5.1 the option had another name, which later versions are to drop.
        let spawn = |pass: [&str; 2]| -> Result<(Child, Receiver<Message>), VideoError> {
            let format = if about.deep { "rgb48le" } else { "rgb24" };
            let mut child = command(program, path)
                .args(["-map", "0:v:0", "-an", "-sn", "-dn", "-vf"])
                .arg(format!("showinfo,scale=flags=bicubic+accurate_rnd+full_chroma_int,format={format}"))
                .args(pass)
                // Fine ticks: coarse ones would make ffmpeg complain about frames that lie close together.
                .args(["-enc_time_base", "1:1000000", "-f", "rawvideo", "pipe:1"])
                .stdout(Stdio::piped())
                .spawn()
                .map_err(|error| missing(program, &error))?;
            let (send, messages) = channel();
            if let Some(stderr) = child.stderr.take() {
                std::thread::spawn(move || listen(BufReader::new(stderr), &send));
            }
            Ok((child, messages))
        };
        let (mut child, mut messages) = spawn(["-fps_mode", "passthrough"])?;
        let first = messages.recv().ok();
        if let Some(Message::Trouble(message)) = &first
            && message.contains("fps_mode")
        {
            let _ = child.wait();
            (child, messages) = spawn(["-vsync", "passthrough"])?;
        } else if let Some(first) = first {
            messages = again(first, messages);
        }
        let Some(stdout) = child.stdout.take() else {
            let what = "ffmpeg has no output";
            return Err(FormatError::corrupt(path, what, "report this as a defect").into());
        };
        Ok(Self {
            path: path.into(),
            about,
            child,
            pixels: BufReader::with_capacity(1 << 20, stdout),
            messages,
            time_base: None,
            size: None,
            read: 0,
            warnings: Vec::new(),
        })
    }

    /// Length that the container states.
    pub fn duration_us(&self) -> Option<i64> {
        self.about.duration_us
    }

    /// The film's curve, where it is one for high dynamic range.
    pub fn hdr(&self) -> Option<&'static str> {
        self.about.hdr
    }

    /// The next frame, and its time in microseconds where the film has one.
    pub fn next(&mut self) -> Result<Option<(Option<i64>, Picture)>, VideoError> {
        let (pts, size) = loop {
            match self.messages.recv() {
                Ok(Message::TimeBase(numerator, denominator)) => {
                    self.time_base = Some((numerator, denominator))
                }
                Ok(Message::Trouble(message)) => self.complain(message),
                Ok(Message::Frame { pts, size }) => break (pts, size),
                Err(_) => return self.end().map(|()| None),
            }
        };
        let first = *self.size.get_or_insert(size);
        if first != size {
            return Err(unequal(&self.path, self.read, first, size));
        }
        let (width, height) = size;
        let count = width as usize * height as usize * 3;
        let mut bytes = vec![0; if self.about.deep { 2 * count } else { count }];
        if self.pixels.read_exact(&mut bytes).is_err() {
            self.end()?;
            let what = format!("frame {} cannot be read: ffmpeg ended within it", self.read);
            return Err(FormatError::corrupt(&self.path, what, "copy the film again from its source").into());
        }
        let values = if self.about.deep {
            let (pairs, _) = bytes.as_chunks::<2>();
            Values::U16(pairs.iter().map(|pair| u16::from_le_bytes(*pair)).collect())
        } else {
            Values::U8(bytes)
        };
        let t_us = pts.zip(self.time_base).and_then(|(pts, base)| micros(pts, base));
        self.read += 1;
        Ok(Some((t_us, Picture { width, height, channels: 3, values })))
    }

    fn complain(&mut self, message: String) {
        if self.warnings.len() < MOST_MESSAGES {
            self.warnings.push(format!("ffmpeg, near frame {}: {message}", self.read));
        }
    }

    /// After the last frame: whether it really was.
    fn end(&mut self) -> Result<(), VideoError> {
        while let Ok(message) = self.messages.recv() {
            if let Message::Trouble(text) = message {
                self.complain(text);
            }
        }
        let status = self.child.wait().map_err(|error| FormatError::io(&self.path, "read", error))?;
        if status.success() && self.read > 0 {
            return Ok(());
        }
        let last = self.warnings.last().map_or_else(|| format!("ffmpeg ended with {status}"), Clone::clone);
        let what = format!("frame {} cannot be read: {last}", self.read);
        Err(FormatError::corrupt(&self.path, what, "name a film that ffmpeg plays, or convert it first")
            .into())
    }
}

impl Drop for Film {
    fn drop(&mut self) {
        // Where it has ended, nobody hears it.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Frames of one film differ in size.
pub(crate) fn unequal(path: &Path, index: u64, first: (u32, u32), size: (u32, u32)) -> VideoError {
    let what = format!(
        "frame {index} has {}x{} pixels, and those before it {}x{}",
        size.0, size.1, first.0, first.1
    );
    FormatError::corrupt(path, what, "bring all frames to one size first").into()
}

/// `pts` ticks of `numerator / denominator` seconds, to the nearest microsecond.
fn micros(pts: i64, (numerator, denominator): (i64, i64)) -> Option<i64> {
    let scaled = i128::from(pts) * i128::from(numerator) * 2_000_000 + i128::from(denominator);
    i64::try_from(scaled.div_euclid(2 * i128::from(denominator))).ok()
}

/// Puts `first` before what `rest` brings.
fn again(first: Message, rest: Receiver<Message>) -> Receiver<Message> {
    let (send, messages) = channel();
    std::thread::spawn(move || {
        if send.send(first).is_ok() {
            while let Ok(next) = rest.recv() {
                if send.send(next).is_err() {
                    break;
                }
            }
        }
    });
    messages
}

/// Asks ffmpeg about the film: it tells, and complains that it has nothing to do.
fn look(program: &OsString, path: &Path) -> Result<About, VideoError> {
    let output =
        command(program, path).stdout(Stdio::null()).output().map_err(|error| missing(program, &error))?;
    let text = String::from_utf8_lossy(&output.stderr);
    let mut about = About::default();
    let mut has_video = false;
    for line in text.lines() {
        if let Some((_, rest)) = line.split_once("Duration: ") {
            about.duration_us = rest.split(',').next().and_then(clock);
        }
        if let Some((_, rest)) = line.split_once("Video: ")
            && line.contains("Stream #")
            && !has_video
        {
            has_video = true;
            let ends = ["9", "10", "12", "14", "16", "48", "64", "f32"];
            about.deep = ends
                .iter()
                .any(|end| ["le", "be"].iter().any(|order| rest.contains(&format!("{end}{order}"))));
            about.hdr = ["smpte2084", "arib-std-b67"].into_iter().find(|curve| rest.contains(curve));
        }
    }
    if has_video {
        return Ok(about);
    }
    let trouble = |line: &&str| {
        (line.contains("[error]") || line.contains("[fatal]")) && !line.contains("At least one output file")
    };
    let said = text.lines().rfind(trouble).map_or("ffmpeg finds no pictures in it", plain);
    let remedy = "name a film that ffmpeg plays, a folder of pictures, or a .npy stack";
    Err(FormatError::corrupt(path, said.to_owned(), remedy).into())
}

/// `01:02:03.45` in microseconds.
fn clock(text: &str) -> Option<i64> {
    let mut seconds = 0.0;
    for part in text.trim().split(':') {
        seconds = seconds * 60.0 + part.parse::<f64>().ok()?;
    }
    Some((seconds * 1e6).round() as i64)
}

/// A message without where it comes from.
fn plain(line: &str) -> &str {
    let tail = |mark: &str| line.find(mark).and_then(|at| line.get(at + mark.len()..));
    tail("[error] ").or_else(|| tail("[fatal] ")).unwrap_or(line).trim()
}

fn listen(stderr: impl BufRead, send: &Sender<Message>) {
    for line in stderr.split(b'\n') {
        let Ok(line) = line else { return };
        let line = String::from_utf8_lossy(&line);
        let Some(message) = understand(&line) else { continue };
        // The listener must go on even where nobody cares: a full pipe would stop ffmpeg.
        let _ = send.send(message);
    }
}

fn understand(line: &str) -> Option<Message> {
    if line.contains("showinfo") {
        if let Some((_, base)) = line.split_once("config in time_base: ") {
            let (numerator, denominator) = base.split(',').next()?.split_once('/')?;
            let base: (i64, i64) = (numerator.trim().parse().ok()?, denominator.trim().parse().ok()?);
            return (base.0 > 0 && base.1 > 0).then_some(Message::TimeBase(base.0, base.1));
        }
        let (_, rest) = line.split_once(" pts:")?;
        let pts = rest.split_whitespace().next()?.parse().ok();
        let (_, rest) = line.split_once(" s:")?;
        let (width, height) = rest.split_whitespace().next()?.split_once('x')?;
        return Some(Message::Frame { pts, size: (width.parse().ok()?, height.parse().ok()?) });
    }
    let trouble = line.contains("[error]") || line.contains("[fatal]");
    trouble.then(|| Message::Trouble(plain(line).to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_understood() {
        let frame = "[Parsed_showinfo_0 @ 0x55] [info] n:  10 pts:  45045 pts_time:1.5015  pos: 1 fmt:yuv420p sar:1/1 \
                     s:64x48 i:P iskey:0 type:B";
        assert!(matches!(understand(frame), Some(Message::Frame { pts: Some(45_045), size: (64, 48) })));
        let none = "[Parsed_showinfo_0 @ 0x55] n: 0 pts: NOPTS pts_time:NOPTS fmt:gray sar:0/1 s:8x4 i:P";
        assert!(matches!(understand(none), Some(Message::Frame { pts: None, size: (8, 4) })));
        let base = "[Parsed_showinfo_0 @ 0x55] [info] config in time_base: 1001/30000, frame_rate: 30/1";
        assert!(matches!(understand(base), Some(Message::TimeBase(1001, 30_000))));
        let out = "[Parsed_showinfo_0 @ 0x55] [info] config out time_base: 0/0, frame_rate: 0/0";
        assert!(understand(out).is_none());
        let error = "[h264 @ 0x55] [error] error while decoding MB 3 4";
        assert!(
            matches!(understand(error), Some(Message::Trouble(text)) if text == "error while decoding MB 3 4")
        );
    }

    #[test]
    fn ticks_become_microseconds_exactly() {
        assert_eq!(micros(1, (1001, 30_000)), Some(33_367));
        // Six digits of a text would say 100000 s here.
        assert_eq!(micros(3_000_000_001, (1, 30_000)), Some(100_000_000_033));
        assert_eq!(micros(-1, (1, 2_000_000)), Some(0));
        assert_eq!(clock("01:02:03.45"), Some(3_723_450_000));
        assert_eq!(clock("N/A"), None);
    }
}
