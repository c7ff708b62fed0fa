//! `preview`: a recording as a picture, an animation or a film, or a scene as a picture. The same input and options give the
//! same pixels.

use std::fs::File;
use std::io::{BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::thread::JoinHandle;

use anyhow::Context;
use evis_core::format::hdf5::Recording;
use evis_core::words::did_you_mean;
use evis_core::{CameraInfo, LabelKind};
use image::codecs::gif::{GifEncoder, Repeat};
use image::{Delay, ExtendedColorType, Frame, ImageEncoder, RgbaImage};

use crate::args::{PreviewArgs, Scale};
use crate::failure::bad_input;
use crate::label_picture::label_picture;
use crate::picture::{self, Canvas, GLYPH_STEP, Palette, TEXT_LINE};
use crate::progress::Progress;
use crate::{extent, scene_info, still, text};

/// Names the ffmpeg to use; the Python package's `video` extra sets it.
const FFMPEG_VARIABLE: &str = "EVIS_FFMPEG";

/// Pictures in a contact sheet.
const SHEET_TILES: usize = 6;
/// Pixels between pictures.
const GAP: usize = 8;
/// Larger pictures are refused.
const MAX_SIDE: usize = 16_384;
/// Longer films are refused.
const MAX_FRAMES: u64 = 1_000_000;

/// Window of a PNG where the user gives none, and the shortest one of a film.
const DEFAULT_WINDOW_US: i64 = 20_000;
const MIN_FILM_WINDOW_US: i64 = 10_000;

/// Draws a recording.
pub(crate) fn preview(args: &PreviewArgs) -> anyhow::Result<i32> {
    let kind = Kind::of(&args.output)?;
    if same_file(&args.input, &args.output) {
        return Err(bad_input("--output is the recording itself; choose another name"));
    }
    if scene_info::is_scene(&args.input) {
        if kind != Kind::Png {
            let output = args.output.display();
            return Err(bad_input(format!("--output {output}: a scene becomes a still picture, .png")));
        }
        let (canvas, shown) = still::still(args)?;
        write_png(&args.output, &canvas)?;
        text::say(&format!("{}  {}x{} pixels, {shown}", args.output.display(), canvas.width, canvas.height));
        return Ok(0);
    }
    for (flag, given) in
        [("--size", args.size.is_some()), ("--animation", args.animation.animation.is_some())]
    {
        if given {
            let input = args.input.display();
            return Err(bad_input(format!("{flag} is for scenes, and {input} is none; leave it out")));
        }
    }
    let mut show = Show::open(args)?;
    let drawn = match kind {
        Kind::Png => png(args, &mut show),
        Kind::Gif => film(args, &mut show, kind),
        Kind::Mp4 => film(args, &mut show, kind),
    }?;
    text::say(&format!("{}  {drawn}", args.output.display()));
    Ok(0)
}

/// Kind of picture, by the file's ending.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Png,
    Gif,
    Mp4,
}

impl Kind {
    fn of(path: &Path) -> anyhow::Result<Self> {
        let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        match ending.as_deref() {
            Some("png") => Ok(Self::Png),
            Some("gif") => Ok(Self::Gif),
            Some("mp4") => Ok(Self::Mp4),
            _ => Err(bad_input(format!(
                "--output {}: pictures are .png, .gif or .mp4; choose one of these endings",
                path.display()
            ))),
        }
    }

    const fn default_fps(self) -> f64 {
        match self {
            // GIF counts hundredths of a second: 20 frames per second are exact.
            Self::Gif => 20.0,
            Self::Png | Self::Mp4 => 30.0,
        }
    }
}

fn same_file(a: &Path, b: &Path) -> bool {
    a == b || matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// A recording seen through one camera.
struct Show {
    recording: Recording,
    index: usize,
    camera: CameraInfo,
    /// The label beside the events, and its times.
    label: Option<(LabelKind, Vec<i64>)>,
    /// The label drawn last, as films ask for the same one several times.
    label_drawn: Option<(usize, Canvas)>,
    reference: Option<f32>,
    palette: Palette,
    scale: Scale,
    from_us: i64,
    until_us: i64,
}

impl Show {
    fn open(args: &PreviewArgs) -> anyhow::Result<Self> {
        let recording = Recording::open(&args.input)?;
        let cameras = recording.header().cameras.clone();
        let index = match &args.camera {
            None => 0,
            Some(name) => cameras.iter().position(|c| c.name == *name).ok_or_else(|| {
                let known: Vec<_> = cameras.iter().map(|c| c.name.as_str()).collect();
                let hint = did_you_mean(name, known.iter().copied());
                bad_input(format!("no camera named '{name}' (--camera); there is {}{hint}", known.join(", ")))
            })?,
        };
        let camera = cameras
            .into_iter()
            .nth(index)
            .ok_or_else(|| bad_input(format!("{}: holds no camera", args.input.display())))?;
        let label = match label_beside(args.label.as_deref(), recording.label_kinds(index)?)? {
            Some(kind) => {
                let times = recording.label_times(index, kind)?;
                (!times.is_empty()).then_some((kind, times))
            }
            None => None,
        };
        let end_us = extent::end_us(&recording)?;
        let from_us = args.start.map_or(0, to_us);
        let until_us = args.duration.map_or(end_us, |s| from_us.saturating_add(to_us(s)).min(end_us));
        for (flag, at) in [("--start", args.start), ("--at", args.at)] {
            if let Some(at) = at
                && to_us(at) > end_us
            {
                return Err(bad_input(format!(
                    "{flag} {at} lies after the end of the recording; choose a time up to {}",
                    text::seconds(end_us)
                )));
            }
        }
        let reference = reference_luminance(&recording.header().config_toml);
        Ok(Self {
            recording,
            index,
            camera,
            label,
            label_drawn: None,
            reference,
            palette: Palette::new(args.background),
            scale: args.scale,
            from_us,
            until_us: until_us.max(from_us),
        })
    }

    /// Width and height of one picture: the event picture, and the label at its left where there is one.
    fn picture_size(&self) -> (usize, usize) {
        let (width, height) = (self.camera.width as usize, self.camera.height as usize);
        let (width, height) = (self.scale.length(width), self.scale.length(height));
        let width = if self.label.is_none() { width } else { 2 * width + GAP };
        (width.max(MIN_WIDTH), height + TEXT_LINE)
    }

    /// The events of `[until - window, until)`, beside the label that came last by then, with the time.
    fn picture(&mut self, until_us: i64, window_us: i64) -> anyhow::Result<Canvas> {
        let (width, height) = self.picture_size();
        let mut canvas = Canvas::new(width, height, self.palette.background);
        let events = self.recording.events_between(self.index, until_us - window_us, until_us)?;
        let (w, h) = (self.camera.width as usize, self.camera.height as usize);
        let drawn = picture::event_picture(&events, w, h, self.scale, &self.palette);
        let left = match self.label_at(until_us)? {
            Some(frame) => {
                canvas.paste(frame, 0, 0);
                frame.width + GAP
            }
            None => 0,
        };
        canvas.paste(&drawn, left, 0);
        let baseline = height - TEXT_LINE + 3;
        canvas.write(&format!("{:.3} s", until_us as f64 / 1.0e6), left + 2, baseline, self.palette.text);
        let legend = drawn.width.saturating_sub(6 * GLYPH_STEP);
        if legend > 9 * GLYPH_STEP {
            canvas.write("ON", left + legend, baseline, self.palette.on);
            canvas.write("OFF", left + legend + 3 * GLYPH_STEP, baseline, self.palette.off);
        }
        Ok(canvas)
    }

    fn label_at(&mut self, t_us: i64) -> anyhow::Result<Option<&Canvas>> {
        let Some((kind, times)) = &self.label else { return Ok(None) };
        let index = times.partition_point(|t| *t <= t_us).saturating_sub(1);
        if self.label_drawn.as_ref().is_none_or(|(drawn, _)| *drawn != index) {
            let label = self.recording.label(self.index, *kind, index)?;
            let size = (self.camera.width as usize, self.camera.height as usize);
            let drawn = label_picture(*kind, &label.data, size, self.scale, &mut self.reference);
            self.label_drawn = Some((index, drawn));
        }
        Ok(self.label_drawn.as_ref().map(|(_, canvas)| canvas))
    }
}

/// The label that `word` asks for; without one HDR frames, else frames, where they were `recorded`.
fn label_beside(word: Option<&str>, recorded: &[LabelKind]) -> anyhow::Result<Option<LabelKind>> {
    let Some(word) = word else {
        return Ok([LabelKind::Hdr, LabelKind::Frame].into_iter().find(|kind| recorded.contains(kind)));
    };
    let name = if word == "flow" { "flow_forward" } else { word };
    match recorded.iter().find(|kind| kind.name() == name) {
        Some(kind) => Ok(Some(*kind)),
        None if word == "none" => Ok(None),
        None => {
            let there: Vec<_> = recorded.iter().map(|kind| kind.name()).collect();
            let there = if there.is_empty() {
                format!("`run --labels {word}` records it")
            } else {
                format!("there is {}", there.join(", "))
            };
            Err(bad_input(format!("--label {word} was not recorded; {there}")))
        }
    }
}

/// Room for the time under very small pictures.
const MIN_WIDTH: usize = 9 * GLYPH_STEP;

fn to_us(seconds: f64) -> i64 {
    (seconds * 1.0e6).round() as i64
}

fn window_us(args: &PreviewArgs) -> Option<i64> {
    args.window_ms.map(|ms| ((ms * 1.0e3).round() as i64).max(1))
}

/// The run's reference luminance, where the recording tells it.
fn reference_luminance(config_toml: &str) -> Option<f32> {
    let settings: toml::Table = config_toml.parse().ok()?;
    let value = settings.get("run")?.get("reference_luminance")?.as_float()? as f32;
    (value.is_finite() && value > 0.0).then_some(value)
}

fn check_size(width: usize, height: usize) -> anyhow::Result<()> {
    if width.max(height) > MAX_SIDE {
        return Err(bad_input(format!(
            "the picture would have {width}x{height} pixels; choose a smaller --scale (at most {MAX_SIDE} a side)"
        )));
    }
    Ok(())
}

/// One window, or a contact sheet of windows spread evenly over the time shown.
fn png(args: &PreviewArgs, show: &mut Show) -> anyhow::Result<String> {
    let window_us = window_us(args).unwrap_or(DEFAULT_WINDOW_US);
    let canvas = match args.at {
        Some(at) => {
            let (width, height) = show.picture_size();
            check_size(width, height)?;
            show.picture(to_us(at), window_us)?
        }
        None => sheet(show, window_us)?,
    };
    write_png(&args.output, &canvas)?;
    Ok(format!("{}x{} pixels", canvas.width, canvas.height))
}

fn write_png(path: &Path, canvas: &Canvas) -> anyhow::Result<()> {
    let (width, height) = (canvas.width as u32, canvas.height as u32);
    write_file(path, |file| {
        let encoder = image::codecs::png::PngEncoder::new(file);
        encoder.write_image(&canvas.bytes(), width, height, ExtendedColorType::Rgb8)?;
        Ok(())
    })
}

fn sheet(show: &mut Show, window_us: i64) -> anyhow::Result<Canvas> {
    let length_us = show.until_us - show.from_us;
    let tiles = usize::try_from(length_us / window_us.max(1)).unwrap_or(0).clamp(1, SHEET_TILES);
    let columns = if show.label.is_none() { tiles.min(3) } else { tiles.min(2) };
    let rows = tiles.div_ceil(columns);
    let (width, height) = show.picture_size();
    let sheet_width = columns * (width + GAP) + GAP;
    let sheet_height = rows * (height + GAP) + GAP;
    check_size(sheet_width, sheet_height)?;
    let mut sheet = Canvas::new(sheet_width, sheet_height, show.palette.background);
    for tile in 0..tiles {
        // Windows end at the ends of equal parts: the last one shows the end of the stream.
        let until_us = show.from_us + length_us * (tile as i64 + 1) / tiles as i64;
        let picture = show.picture(until_us, window_us)?;
        sheet.paste(
            &picture,
            GAP + (tile % columns) * (width + GAP),
            GAP + (tile / columns) * (height + GAP),
        );
    }
    Ok(sheet)
}

/// GIF or MP4.
fn film(args: &PreviewArgs, show: &mut Show, kind: Kind) -> anyhow::Result<String> {
    let fps = args.fps.unwrap_or(kind.default_fps());
    let step_us = 1.0e6 / (fps * args.slow.unwrap_or(1.0));
    let window_us = window_us(args).unwrap_or((step_us.round() as i64).max(MIN_FILM_WINDOW_US));
    // A last frame that misses the end by rounding only is one.
    let frames = ((show.until_us - show.from_us) as f64 / step_us + 1.0e-6).floor().max(1.0) as u64;
    if frames > MAX_FRAMES {
        return Err(bad_input(format!(
            "the film would have {frames} frames; choose a shorter --duration, a lower --fps or a lower --slow \
             (at most {MAX_FRAMES})"
        )));
    }
    let (width, height) = show.picture_size();
    // yuv420p, which every player shows, wants even sides.
    let (width, height) = (width.next_multiple_of(2), height.next_multiple_of(2));
    check_size(width, height)?;
    let progress = Progress::new(frames);
    let background = show.palette.background;
    let mut draw = |k: u64| -> anyhow::Result<Canvas> {
        let until_us = show.from_us + ((k + 1) as f64 * step_us).round() as i64;
        let mut canvas = Canvas::new(width, height, background);
        canvas.paste(&show.picture(until_us, window_us)?, 0, 0);
        progress.count(k + 1, "frames");
        Ok(canvas)
    };
    match kind {
        Kind::Mp4 => mp4(&args.output, fps, frames, (width, height), &mut draw)?,
        Kind::Gif | Kind::Png => gif(&args.output, fps, frames, &mut draw)?,
    }
    Ok(format!("{width}x{height} pixels, {frames} frames at {fps} per second"))
}

type Draw<'a> = dyn FnMut(u64) -> anyhow::Result<Canvas> + 'a;

fn gif(path: &Path, fps: f64, frames: u64, draw: &mut Draw<'_>) -> anyhow::Result<()> {
    write_file(path, |file| {
        let mut encoder = GifEncoder::new_with_speed(file, 10);
        encoder.set_repeat(Repeat::Infinite)?;
        for k in 0..frames {
            let canvas = draw(k)?;
            let rgba = canvas.pixels.iter().flat_map(|[r, g, b]| [*r, *g, *b, 255]).collect();
            let picture = RgbaImage::from_raw(canvas.width as u32, canvas.height as u32, rgba)
                .context("a frame has the wrong size")?;
            // Rounded to the hundredth at each frame's end, so that the film as a whole keeps its speed.
            let end = |k: u64| (k as f64 * 100.0 / fps).round() as u32;
            let delay = Delay::from_numer_denom_ms((end(k + 1) - end(k)) * 10, 1);
            encoder.encode_frame(Frame::from_parts(picture, 0, 0, delay))?;
        }
        Ok(())
    })
}

fn mp4(
    path: &Path,
    fps: f64,
    frames: u64,
    (width, height): (usize, usize),
    draw: &mut Draw<'_>,
) -> anyhow::Result<()> {
    let part = part_path(path);
    let written = Ffmpeg::start(&part, fps, (width, height)).and_then(|mut ffmpeg| {
        for k in 0..frames {
            if !ffmpeg.write(&draw(k)?.bytes()) {
                break;
            }
        }
        ffmpeg.finish()
    });
    keep(written, &part, path)
}

/// A running ffmpeg that takes raw frames.
struct Ffmpeg {
    child: Child,
    frames: Option<ChildStdin>,
    messages: Option<JoinHandle<String>>,
}

impl Ffmpeg {
    fn start(path: &Path, fps: f64, (width, height): (usize, usize)) -> anyhow::Result<Self> {
        let program = std::env::var_os(FFMPEG_VARIABLE).filter(|v| !v.is_empty()).unwrap_or("ffmpeg".into());
        let mut child = Command::new(&program)
            .args(["-nostdin", "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"])
            .args(["-s", &format!("{width}x{height}"), "-r", &fps.to_string(), "-i", "pipe:0", "-an"])
            // The same frames give the same file: no date, no version, no thread-dependent decisions.
            .args(["-pix_fmt", "yuv420p", "-threads", "1", "-fflags", "+bitexact", "-flags:v", "+bitexact"])
            .args(["-map_metadata", "-1", "-movflags", "+faststart", "-f", "mp4"])
            .arg(path)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| {
                bad_input(format!(
                    "MP4 needs ffmpeg, and {} did not start ({error}). Install ffmpeg (apt-get install ffmpeg) or \
                     the Python package's extra (pip install 'evis[video]'), or name one in {FFMPEG_VARIABLE}. \
                     Without it, write a .gif instead",
                    Path::new(&program).display()
                ))
            })?;
        let frames = child.stdin.take();
        // Read on a thread of its own: a full pipe of messages would stop ffmpeg, and us with it.
        let messages = child.stderr.take().map(|mut stderr| {
            std::thread::spawn(move || {
                let mut bytes = Vec::new();
                let _ = stderr.read_to_end(&mut bytes);
                String::from_utf8_lossy(&bytes).into_owned()
            })
        });
        Ok(Self { child, frames, messages })
    }

    /// Sends one frame; `false` where ffmpeg has ended, `finish` then tells why.
    fn write(&mut self, frame: &[u8]) -> bool {
        self.frames.as_mut().is_some_and(|pipe| pipe.write_all(frame).is_ok())
    }

    fn finish(mut self) -> anyhow::Result<()> {
        self.frames = None;
        let status = self.child.wait().context("ffmpeg cannot be waited for")?;
        let messages = self.messages.take().and_then(|thread| thread.join().ok()).unwrap_or_default();
        if !status.success() {
            anyhow::bail!("ffmpeg failed ({status}): {}", messages.trim());
        }
        Ok(())
    }
}

impl Drop for Ffmpeg {
    /// After an error in between, the half film is of no use.
    fn drop(&mut self) {
        if self.frames.is_some() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}

/// Writes a file under another name first: a failure leaves neither a half file nor a damaged old one.
fn write_file(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let part = part_path(path);
    let written = File::create(&part).map_err(anyhow::Error::new).and_then(|file| {
        let mut file = BufWriter::new(file);
        write(&mut file)?;
        file.flush()?;
        Ok(())
    });
    keep(written, &part, path)
}

fn keep(written: anyhow::Result<()>, part: &Path, path: &Path) -> anyhow::Result<()> {
    let kept = written.and_then(|()| Ok(std::fs::rename(part, path)?));
    if kept.is_err() {
        // The first error is the one to tell.
        let _ = std::fs::remove_file(part);
    }
    kept.with_context(|| format!("cannot write {}", path.display()))
}

/// `X.png` becomes `X.png.part`.
fn part_path(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".part");
    PathBuf::from(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_label_is_the_one_asked_for_or_a_frame() {
        use LabelKind::{Depth, FlowForward, Frame, Hdr};
        let beside = |word, recorded: &[LabelKind]| label_beside(word, recorded).ok().flatten();
        assert_eq!(beside(None, &[Depth, Hdr, Frame]), Some(Hdr));
        assert_eq!(beside(None, &[Depth, Frame]), Some(Frame));
        assert_eq!(beside(None, &[Depth]), None);
        assert_eq!(beside(Some("flow"), &[Depth, FlowForward]), Some(FlowForward));
        assert_eq!(beside(Some("none"), &[Hdr]), None);
        let error = label_beside(Some("normal"), &[Depth, Hdr]).expect_err("it is not there").to_string();
        assert_eq!(error, "--label normal was not recorded; there is depth, hdr");
        let error = label_beside(Some("depth"), &[]).unwrap_err().to_string();
        assert_eq!(error, "--label depth was not recorded; `run --labels depth` records it");
    }
}
