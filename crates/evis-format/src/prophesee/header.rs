//! The header of RAW and DAT files: lines that start with `%`.

use std::path::Path;

use evis_core::format::FormatError;

use crate::files::damaged;
use crate::format::Format;

/// Longest header that is read.
pub(super) const MOST_HEADER: usize = 64 << 10;

/// Lines of a header.
pub(super) struct Header {
    /// `% key value`, in order; a line of one word has an empty value.
    pub lines: Vec<(String, String)>,
    /// Bytes that it takes.
    pub length: usize,
}

impl Header {
    /// Reads the header at the start of `bytes`; `None` where it does not end within them.
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        let mut lines = Vec::new();
        let mut at = 0;
        loop {
            let rest = bytes.get(at..)?;
            // Events may begin with the same byte, but not with the space after it.
            if !rest.starts_with(b"% ") && !rest.starts_with(b"%\n") {
                return (at > 0).then_some(Self { lines, length: at });
            }
            let end = rest.iter().position(|byte| *byte == b'\n')?;
            let line = String::from_utf8_lossy(rest.get(1..end)?).trim().to_owned();
            at += end + 1;
            if line == "end" {
                return Some(Self { lines, length: at });
            }
            let (key, value) = line.split_once([' ', ':']).unwrap_or((&line, ""));
            lines.push((key.to_owned(), value.trim_start_matches([':', ' ']).trim().to_owned()));
        }
    }

    /// The value of a key, in whatever case.
    pub fn get(&self, key: &str) -> Option<&str> {
        self.lines.iter().find(|(name, _)| name.eq_ignore_ascii_case(key)).map(|(_, value)| value.as_str())
    }

    /// `% geometry 1280x720`, `% format EVT3;height=720;width=1280`, or `% Width 1280` and `% Height 720`.
    pub fn size(&self) -> Option<(u32, u32)> {
        let number = |text: &str| text.trim().parse::<u32>().ok().filter(|side| (1..=1 << 14).contains(side));
        let geometry = || self.get("geometry")?.split_once('x').map(|(w, h)| (w.to_owned(), h.to_owned()));
        let of_format = || {
            let format = self.get("format")?;
            let part =
                |key| format.split(';').find_map(|part| part.trim().strip_prefix(key)).map(str::to_owned);
            Some((part("width=")?, part("height=")?))
        };
        let lines = || Some((self.get("width")?.to_owned(), self.get("height")?.to_owned()));
        let (width, height) = geometry().or_else(of_format).or_else(lines)?;
        Some((number(&width)?, number(&height)?))
    }

    /// The encoding of the events.
    pub fn format(&self) -> Option<Format> {
        if let Some(format) = self.get("format") {
            return match format.split(';').next()?.trim() {
                "EVT3" => Some(Format::Evt3),
                "EVT2" => Some(Format::Evt2),
                _ => None,
            };
        }
        if let Some(version) = self.get("evt") {
            return match version.split('.').collect::<Vec<_>>().as_slice() {
                ["3", ..] => Some(Format::Evt3),
                // EVT 2.1 is another encoding.
                ["2"] | ["2", "0"] => Some(Format::Evt2),
                _ => None,
            };
        }
        let data = self.get("data").is_some_and(|value| value.starts_with("file containing"));
        (data || self.get("version").is_some()).then_some(Format::Dat)
    }
}

/// The format that a header at the start of a file says.
pub(crate) fn format_of_header(head: &[u8]) -> Option<Format> {
    Header::parse(head)?.format()
}

/// The header of the file at `path`, which starts with `head`.
pub(super) fn read(path: &Path, head: &[u8]) -> Result<Header, FormatError> {
    let missing = || damaged(path, head.len() as u64, "its header of lines that start with % does not end");
    Header::parse(head).ok_or_else(missing)
}

/// The header of a RAW file that EVIS writes. The integrator's name chooses the decoder in Metavision.
pub(super) fn raw_header(format: Format, (width, height): (u32, u32)) -> String {
    let (version, name) = if format == Format::Evt2 { ("2.0", "EVT2") } else { ("3.0", "EVT3") };
    format!(
        "% camera_integrator_name Prophesee\n\
         % date 1970-01-01 00:00:00\n\
         % evt {version}\n\
         % format {name};height={height};width={width}\n\
         % generation 4.2\n\
         % geometry {width}x{height}\n\
         % integrator_name Prophesee\n\
         % plugin_integrator_name Prophesee\n\
         % sensor_generation 4.2\n\
         % serial_number 00000000\n\
         % system_ID 49\n\
         % end\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_tell_format_and_size() {
        for format in [Format::Evt3, Format::Evt2] {
            let text = raw_header(format, (1280, 720)) + "\x25\x20 events";
            let header = Header::parse(text.as_bytes()).unwrap();
            assert_eq!((header.format(), header.size()), (Some(format), Some((1280, 720))));
            assert!(text[header.length..].ends_with(" events"));
        }
        let of = |text: &str| Header::parse(text.as_bytes()).map(|h| (h.format(), h.size()));
        assert_eq!(of("% evt 2.0\n% system_ID 28\nxx"), Some((Some(Format::Evt2), None)));
        assert_eq!(of("% evt 2.1\n% end\n"), Some((None, None)));
        assert_eq!(
            of("% Data file containing CD events.\n% Version 2\n% Width 304\n% Height 240\n\x0c\x08"),
            Some((Some(Format::Dat), Some((304, 240))))
        );
        assert_eq!(of("% geometry 0x720\n% end\n"), Some((None, None)));
        assert_eq!(of("% evt 3.0"), None);
    }
}
