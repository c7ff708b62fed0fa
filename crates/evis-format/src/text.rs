//! Text: a line `width height`, then `t x y p` per event with t in seconds; and the same, zipped (rpg, E2VID).

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use evis_core::format::FormatError;
use evis_core::limits::open_regular;
use evis_core::{Event, Polarity};
use flate2::read::DeflateDecoder;

use crate::check::Check;
use crate::files::{Output, damaged, draft_path, refuse_existing};
use crate::format::Format;
use crate::packet::Packet;
use crate::read::{EventReader, ReadOptions, StreamInfo};
use crate::write::{EventWriter, WriteOptions};

/// Events per packet.
const EVENTS_AT_ONCE: usize = 32 << 10;
/// Longest line that is read.
const MOST_LINE: u64 = 4096;
/// Lines that may come before the first event: comments, names of columns.
const MOST_PREAMBLE: usize = 64;
/// Latest time: seconds as a double keep microseconds up to 2^53 of them.
const LATEST_US: i64 = 1 << 53;

/// What a line says.
#[derive(Debug, PartialEq)]
enum Line {
    Blank,
    Size(u32, u32),
    Event(Event),
}

/// Whether the start of a file is text of this kind.
pub(crate) fn looks_like_text(head: &[u8]) -> bool {
    if head.contains(&0) {
        return false;
    }
    let Ok(text) = std::str::from_utf8(head).or_else(|error| {
        // The head may end within a character.
        std::str::from_utf8(head.get(..error.valid_up_to()).unwrap_or_default())
    }) else {
        return false;
    };
    let mut lines = text.lines().take(MOST_PREAMBLE).map(parse);
    let first = lines.find(|line| !matches!(line, Ok(Line::Blank)));
    matches!(first, Some(Ok(Line::Size(..) | Line::Event(_))))
}

/// What a zip archive at `path` holds: columns of `NumPy`, or text.
pub(crate) fn archive_format(path: &Path, head: &[u8]) -> Option<Format> {
    if !head.starts_with(b"PK\x03\x04") {
        return None;
    }
    let archive = zip::ZipArchive::new(BufReader::new(open_regular(path).ok()?)).ok()?;
    let names: Vec<_> = archive.file_names().filter_map(Result::ok).collect();
    if names.iter().any(|name| name.ends_with(".npy")) {
        return Some(Format::Npz);
    }
    (archive.len() == 1 && names.iter().any(|name| is_text_name(name))).then_some(Format::TextZip)
}

fn is_text_name(name: &str) -> bool {
    let ending = Path::new(name).extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    matches!(ending.as_deref(), Some("txt" | "csv"))
}

fn parse(line: &str) -> Result<Line, String> {
    let line = line.trim();
    if line.is_empty() || line.starts_with('#') {
        return Ok(Line::Blank);
    }
    let mut fields = line.split([' ', '\t', ',', ';']).filter(|field| !field.is_empty());
    let fields = [(); 5].map(|()| fields.next());
    let side = |field: &str| field.parse::<u32>().ok();
    match fields {
        [Some(width), Some(height), None, ..] => match (side(width), side(height)) {
            (Some(width @ 1..=65_536), Some(height @ 1..=65_536)) => Ok(Line::Size(width, height)),
            _ => Err(format!("'{}' is no size of a sensor", shortened(line))),
        },
        [Some(t), Some(x), Some(y), Some(p), None] => {
            let wrong = |name: &str, field: &str| format!("{name} is '{}'", shortened(field));
            let t = microseconds(t).ok_or_else(|| wrong("the time", t))?;
            let x = x.parse().map_err(|_| wrong("x", x))?;
            let y = y.parse().map_err(|_| wrong("y", y))?;
            let polarity = match p {
                "1" | "+1" | "True" | "true" => Polarity::On,
                "0" | "-1" | "False" | "false" => Polarity::Off,
                _ => return Err(wrong("the polarity", p)),
            };
            Ok(Line::Event(Event::new(t, x, y, polarity)))
        }
        _ => Err(format!("'{}' is no line 't x y p'", shortened(line))),
    }
}

fn shortened(text: &str) -> String {
    text.chars().take(60).collect()
}

/// Seconds in decimals, as microseconds: exact for up to six decimals, rounded beyond.
fn microseconds(text: &str) -> Option<i64> {
    let (negative, digits) = match text.strip_prefix('-') {
        Some(rest) => (true, rest),
        None => (false, text),
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    let plain = |part: &str| part.bytes().all(|byte| byte.is_ascii_digit());
    if !plain(whole) || !plain(fraction) || whole.is_empty() && fraction.is_empty() {
        // 1.5e-05, as NumPy's savetxt writes it.
        let seconds: f64 = text.parse().ok().filter(|seconds: &f64| seconds.abs() < 9.0e9)?;
        return Some((seconds * 1.0e6).round() as i64);
    }
    let mut t: i64 = if whole.is_empty() { 0 } else { whole.parse().ok()? };
    let mut decimals = fraction.bytes().map(|byte| i64::from(byte - b'0'));
    for _ in 0..6 {
        t = t.checked_mul(10)?.checked_add(decimals.next().unwrap_or(0))?;
    }
    t += i64::from(decimals.next().is_some_and(|digit| digit >= 5));
    Some(if negative { -t } else { t })
}

/// Reads text, zipped or not.
pub(crate) struct TextReader {
    path: PathBuf,
    info: StreamInfo,
    lines: Lines,
    /// The first event, which was read with the header.
    ahead: Option<Event>,
    failed: Option<(u64, String)>,
}

/// The offset of a line, and what it says or what is wrong with it.
type Placed = (u64, Result<Line, String>);

/// Lines with their offsets in the text.
struct Lines {
    source: Box<dyn BufRead + Send>,
    at: u64,
    line: Vec<u8>,
}

impl Lines {
    fn open(path: &Path, format: Format) -> Result<Self, FormatError> {
        let failed = |error| FormatError::io(path, "read", error);
        let mut file = open_regular(path).map_err(failed)?;
        let source: Box<dyn BufRead + Send> = if format == Format::TextZip {
            let broken = |what: String| FormatError::corrupt(path, what, crate::files::COPY_AGAIN);
            let mut archive = zip::ZipArchive::new(BufReader::new(&file))
                .map_err(|error| broken(format!("its archive cannot be read ({error})")))?;
            let entry = archive
                .by_index_raw(0)
                .map_err(|error| broken(format!("its archive cannot be read ({error})")))?;
            let start = entry.data_start();
            let (size, method) = (entry.compressed_size(), entry.compression());
            drop(entry);
            file.seek(SeekFrom::Start(start.unwrap_or(0))).map_err(failed)?;
            match method {
                zip::CompressionMethod::Stored => {
                    Box::new(BufReader::with_capacity(1 << 18, file.take(size)))
                }
                zip::CompressionMethod::Deflated => {
                    let packed = BufReader::with_capacity(1 << 18, file.take(size));
                    Box::new(BufReader::with_capacity(1 << 18, DeflateDecoder::new(packed)))
                }
                method => {
                    return Err(FormatError::corrupt(
                        path,
                        format!("its archive is packed by {method}"),
                        "zip it again with deflate",
                    ));
                }
            }
        } else {
            Box::new(BufReader::with_capacity(1 << 18, file))
        };
        Ok(Self { source, at: 0, line: Vec::new() })
    }

    /// The next line and its offset; `None` at the end.
    fn next(&mut self, path: &Path) -> Result<Option<Placed>, FormatError> {
        self.line.clear();
        let read = (&mut self.source).take(MOST_LINE).read_until(b'\n', &mut self.line);
        let read = match read {
            Ok(read) => read as u64,
            // A damaged archive is no fault of the disk.
            Err(error)
                if error.kind() == std::io::ErrorKind::InvalidInput || error.raw_os_error().is_none() =>
            {
                return Ok(Some((self.at, Err(format!("the text cannot be unpacked ({error})")))));
            }
            Err(error) => return Err(FormatError::io(path, "read", error)),
        };
        if read == 0 {
            return Ok(None);
        }
        let at = self.at;
        self.at += read;
        let line = match std::str::from_utf8(&self.line) {
            Ok(_) if read == MOST_LINE => Err(format!("a line has more than {MOST_LINE} bytes")),
            Ok(line) => parse(line),
            Err(_) => Err("a line is no text".into()),
        };
        Ok(Some((at, line)))
    }
}

impl TextReader {
    /// `format` is [`Format::Text`] or [`Format::TextZip`].
    pub(crate) fn open(path: &Path, format: Format, options: &ReadOptions) -> Result<Self, FormatError> {
        let lines = Lines::open(path, format)?;
        let mut reader =
            Self { path: path.into(), info: StreamInfo::new(format), lines, ahead: None, failed: None };
        reader.begin()?;
        reader.info.size = reader.info.size.or(options.size);
        Ok(reader)
    }

    /// Reads up to the first event.
    fn begin(&mut self) -> Result<(), FormatError> {
        while let Some((at, line)) = self.lines.next(&self.path)? {
            match line {
                Ok(Line::Blank) => {}
                Ok(Line::Size(width, height)) => self.info.size = Some((width, height)),
                Ok(Line::Event(event)) => {
                    self.ahead = Some(event);
                    break;
                }
                Err(what) => return Err(damaged(&self.path, at, &what)),
            }
        }
        Ok(())
    }
}

impl EventReader for TextReader {
    fn info(&self) -> &StreamInfo {
        &self.info
    }

    fn read_packet(&mut self, packet: &mut Packet) -> Result<bool, FormatError> {
        packet.clear();
        if let Some((at, what)) = &self.failed {
            return Err(damaged(&self.path, *at, what));
        }
        let (width, height) = self.info.size.unwrap_or((1 << 16, 1 << 16));
        packet.events.extend(self.ahead.take());
        while packet.events.len() < EVENTS_AT_ONCE {
            let Some((at, line)) = self.lines.next(&self.path)? else { return Ok(!packet.is_empty()) };
            let what = match line {
                Ok(Line::Event(e)) if u32::from(e.x) < width && u32::from(e.y) < height => {
                    packet.events.push(e);
                    continue;
                }
                Ok(Line::Event(e)) => format!("x {}, y {} lies outside of {width}x{height}", e.x, e.y),
                Ok(Line::Blank) => continue,
                Ok(Line::Size(..)) => "a size stands among the events".into(),
                Err(what) => what,
            };
            self.failed = Some((at, what));
            break;
        }
        match &self.failed {
            Some((at, what)) if packet.is_empty() => Err(damaged(&self.path, *at, what)),
            _ => Ok(true),
        }
    }

    fn seek(&mut self, t_us: i64) -> Result<(), FormatError> {
        // Lines have no fixed length and archives no places to start from: from the start, up to the time.
        self.lines = Lines::open(&self.path, self.info.format)?;
        (self.ahead, self.failed) = (None, None);
        self.begin()?;
        while self.ahead.is_some_and(|event| event.t < t_us) {
            self.ahead = None;
            match self.lines.next(&self.path)? {
                Some((_, Ok(Line::Event(event)))) => self.ahead = Some(event),
                Some((at, Err(what))) => self.failed = Some((at, what)),
                Some(_) | None => {}
            }
        }
        Ok(())
    }
}

/// Appends events as lines.
fn put_lines(events: &[Event], text: &mut Vec<u8>) {
    for e in events {
        let sign = if e.t < 0 { "-" } else { "" };
        let (whole, fraction) = (e.t.unsigned_abs() / 1_000_000, e.t.unsigned_abs() % 1_000_000);
        // Writing to a vector cannot fail.
        let _ = writeln!(text, "{sign}{whole}.{fraction:06} {} {} {}", e.x, e.y, e.p);
    }
}

/// Writes text.
pub(crate) struct TextWriter {
    output: Output,
    check: Check,
    text: Vec<u8>,
}

fn check_of(path: &Path, format: Format, options: &WriteOptions) -> Check {
    Check::new(path, format, options.size, (-LATEST_US, LATEST_US), -1)
}

impl TextWriter {
    pub(crate) fn create(path: &Path, options: &WriteOptions) -> Result<Self, FormatError> {
        let mut output = Output::create(path, options.overwrite)?;
        let (width, height) = options.size;
        output.write(format!("{width} {height}\n").as_bytes())?;
        Ok(Self { output, check: check_of(path, Format::Text, options), text: Vec::new() })
    }
}

impl EventWriter for TextWriter {
    fn write(&mut self, packet: &Packet) -> Result<(), FormatError> {
        self.check.only_events(packet)?;
        self.write_events(&packet.events)
    }

    fn write_events(&mut self, events: &[Event]) -> Result<(), FormatError> {
        self.check.events(events)?;
        for part in events.chunks(EVENTS_AT_ONCE) {
            self.text.clear();
            put_lines(part, &mut self.text);
            self.output.write(&self.text)?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<(), FormatError> {
        self.output.finish()
    }
}

/// Writes zipped text.
pub(crate) struct ZipWriter {
    path: PathBuf,
    draft: PathBuf,
    archive: Option<zip::ZipWriter<File>>,
    check: Check,
    text: Vec<u8>,
}

impl ZipWriter {
    pub(crate) fn create(path: &Path, options: &WriteOptions) -> Result<Self, FormatError> {
        refuse_existing(path, options.overwrite)?;
        let draft = draft_path(path, "draft");
        let file = File::create(&draft).map_err(|error| FormatError::io(path, "create", error))?;
        let mut archive = zip::ZipWriter::new(file);
        let (width, height) = options.size;
        let begun = archive
            .start_file("events.txt", entry_options())
            .map_err(std::io::Error::other)
            .and_then(|()| archive.write_all(format!("{width} {height}\n").as_bytes()));
        let check = check_of(path, Format::TextZip, options);
        let writer = Self { path: path.into(), draft, archive: Some(archive), check, text: Vec::new() };
        begun.map_err(|error| FormatError::io(path, "write", error))?;
        Ok(writer)
    }
}

/// Deflated, larger than 4 GiB if need be, without the time of day.
pub(crate) fn entry_options() -> zip::write::SimpleFileOptions {
    zip::write::SimpleFileOptions::default()
        .compression_method(zip::CompressionMethod::Deflated)
        .compression_level(Some(4))
        .large_file(true)
}

impl EventWriter for ZipWriter {
    fn write(&mut self, packet: &Packet) -> Result<(), FormatError> {
        self.check.only_events(packet)?;
        self.write_events(&packet.events)
    }

    fn write_events(&mut self, events: &[Event]) -> Result<(), FormatError> {
        self.check.events(events)?;
        let Some(archive) = &mut self.archive else { return Ok(()) };
        for part in events.chunks(EVENTS_AT_ONCE) {
            self.text.clear();
            put_lines(part, &mut self.text);
            archive.write_all(&self.text).map_err(|error| FormatError::io(&self.path, "write", error))?;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<(), FormatError> {
        let Some(archive) = self.archive.take() else { return Ok(()) };
        let finished = archive.finish().map_err(std::io::Error::other);
        finished.and_then(|_| std::fs::rename(&self.draft, &self.path)).map_err(|error| {
            let _ = std::fs::remove_file(&self.draft);
            FormatError::io(&self.path, "write", error)
        })
    }
}

impl Drop for ZipWriter {
    fn drop(&mut self) {
        if self.archive.take().is_some() {
            let _ = std::fs::remove_file(&self.draft);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_exact_to_the_microsecond() {
        for (text, t) in [
            ("0.000001", Some(1)),
            ("1468940293.922985", Some(1_468_940_293_922_985)),
            ("1468940293.922985274", Some(1_468_940_293_922_985)),
            ("0.0000019999", Some(2)),
            ("-1.5", Some(-1_500_000)),
            ("12", Some(12_000_000)),
            (".25", Some(250_000)),
            ("1.234560000000000007e-01", Some(123_456)),
            ("9223372036855.0", None),
            ("nan", None),
            ("1e300", None),
            ("", None),
        ] {
            assert_eq!(microseconds(text), t, "{text}");
        }
    }

    #[test]
    fn lines_are_events_sizes_or_errors() {
        assert_eq!(parse("240 180"), Ok(Line::Size(240, 180)));
        assert_eq!(parse("0.5, 3, 4, -1"), Ok(Line::Event(Event::new(500_000, 3, 4, Polarity::Off))));
        assert_eq!(parse("  # t x y p"), Ok(Line::Blank));
        for (line, what) in [
            ("0.1 2 3", "no line"),
            ("0.1 2 3 4", "polarity is '4'"),
            ("0.1 -2 3 1", "x is '-2'"),
            ("0 1", "size"),
        ] {
            assert!(parse(line).unwrap_err().contains(what), "{line}");
        }
        assert!(looks_like_text(b"# a\n640 480\n0.1 2 3 1\n") && looks_like_text(b"0.1 2 3 1"));
        assert!(!looks_like_text(b"hello world\n") && !looks_like_text(b"") && !looks_like_text(&[0x89, 0]));
    }
}
