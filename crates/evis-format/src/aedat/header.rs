//! The start of an AEDAT 4.0 file: which streams there are.

use super::compression::Compression;
use super::flatbuffer::{Builder, Table, sized};
use crate::files::u32_at;

/// First line of every file.
pub(super) const MAGIC: &[u8] = b"#!AER-DAT4.0\r\n";
/// Largest header that is read.
pub(super) const MOST_HEADER: usize = 4 << 20;

/// What a stream carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Events,
    Frames,
    Imu,
    Triggers,
    Other,
}

impl Kind {
    fn of(identifier: &str) -> Self {
        match identifier {
            "EVTS" => Self::Events,
            "FRME" => Self::Frames,
            "IMUS" => Self::Imu,
            "TRIG" => Self::Triggers,
            _ => Self::Other,
        }
    }

    /// Identifier of its packets, and what DV calls it.
    pub const fn identifier(self) -> &'static [u8; 4] {
        match self {
            Self::Frames => b"FRME",
            Self::Imu => b"IMUS",
            Self::Triggers => b"TRIG",
            _ => b"EVTS",
        }
    }
}

/// A stream of the file.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Stream {
    pub id: i32,
    pub kind: Kind,
    pub name: String,
    pub source: String,
    pub size: Option<(u32, u32)>,
}

/// The header of a file.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Header {
    pub compression: Compression,
    /// Where a table of packets lies, after the last packet; negative where there is none.
    pub table_at: i64,
    pub streams: Vec<Stream>,
    /// Bytes that it takes.
    pub length: usize,
}

impl Header {
    /// Reads the header at the start of `bytes`; the error is an offset and what is wrong there.
    pub fn parse(bytes: &[u8]) -> Result<Self, (u64, String)> {
        let at = MAGIC.len();
        if !bytes.starts_with(MAGIC) {
            return Err((0, "it does not start with #!AER-DAT4.0".into()));
        }
        let wrong = |what: &str| (at as u64, what.to_owned());
        let rest = bytes.get(at..).unwrap_or_default();
        let length = u32_at(rest, 0).ok_or_else(|| wrong("it ends within its header"))? as usize;
        let table = sized(rest).ok_or_else(|| wrong(&format!("its header would be {length} bytes long")))?;
        let table = Table::root(table, b"IOHE").ok_or_else(|| wrong("its header is no IOHE table"))?;
        let number = table.i32(0).unwrap_or(0);
        let compression = Compression::of(number)
            .ok_or_else(|| wrong(&format!("its compression {number} is not known")))?;
        let xml = table.text(2).ok_or_else(|| wrong("its header has no list of streams"))?;
        let streams = streams(xml);
        if streams.is_empty() {
            return Err(wrong("its header lists no streams"));
        }
        Ok(Self { compression, table_at: table.i64(1).unwrap_or(-1), streams, length: at + 4 + length })
    }
}

/// The streams of the XML tree: `outInfo`, then a node per stream with its attributes, in which a node
/// `info` has more.
fn streams(xml: &str) -> Vec<Stream> {
    let mut streams: Vec<Stream> = Vec::new();
    let mut path: Vec<String> = Vec::new();
    for tag in xml.split('<').skip(1) {
        let Some((tag, text)) = tag.split_once('>') else { break };
        if let Some(node) = tag.strip_prefix("node ") {
            let name = attribute(node, "name").unwrap_or_default().to_owned();
            if !node.ends_with('/') {
                path.push(name.clone());
            }
            let at_stream =
                path.len() >= 2 && path.iter().rev().nth(1).is_some_and(|parent| parent == "outInfo");
            if at_stream && let Ok(id) = name.parse() {
                let name = String::new();
                streams.push(Stream { id, kind: Kind::Other, name, source: String::new(), size: None });
            }
        } else if tag == "/node" {
            path.pop();
        } else if let Some(attr) = tag.strip_prefix("attr ")
            && path.iter().any(|node| node == "outInfo")
            && let Some(stream) = streams.last_mut()
        {
            let side = || text.trim().parse::<u32>().ok().filter(|side| (1..=1 << 15).contains(side));
            let (width, height) = stream.size.unwrap_or_default();
            match attribute(attr, "key").unwrap_or_default() {
                "typeIdentifier" => stream.kind = Kind::of(text.trim()),
                "originalOutputName" => stream.name = text.trim().to_owned(),
                "source" => stream.source = text.trim().to_owned(),
                "sizeX" => stream.size = side().map(|width| (width, height)),
                "sizeY" => stream.size = side().map(|height| (width, height)),
                _ => {}
            }
        }
    }
    for stream in &mut streams {
        stream.size = stream.size.filter(|(width, height)| *width > 0 && *height > 0);
    }
    streams
}

/// The value of `name="value"` within a tag.
fn attribute<'a>(tag: &'a str, name: &str) -> Option<&'a str> {
    let start = tag.find(&format!("{name}=\""))? + name.len() + 2;
    tag.get(start..)?.split_once('"').map(|(value, _)| value)
}

/// The streams that are written, by id.
pub(super) const WRITTEN: [(Kind, &str, &str); 4] = [
    (Kind::Events, "events", "Array of events (polarity ON/OFF)."),
    (Kind::Frames, "frames", "Standard frame (8-bit image)."),
    (Kind::Imu, "imu", "Inertial Measurement Unit data samples."),
    (Kind::Triggers, "triggers", "External triggers and special signals."),
];

/// A header of these streams, without compression.
pub(super) fn build((width, height): (u32, u32), kinds: &[bool; 4]) -> Vec<u8> {
    let mut nodes = String::new();
    for (id, (kind, name, description)) in WRITTEN.iter().enumerate() {
        if !kinds[id] {
            continue;
        }
        let identifier = String::from_utf8_lossy(kind.identifier());
        let path = format!("/mainloop/Recorder/outInfo/{id}/");
        let size = match kind {
            Kind::Events | Kind::Frames => format!(
                "<attr key=\"sizeX\" type=\"int\">{width}</attr><attr key=\"sizeY\" type=\"int\">{height}</attr>"
            ),
            _ => String::new(),
        };
        nodes += &format!(
            "<node name=\"{id}\" path=\"{path}\">\
             <attr key=\"compression\" type=\"string\">NONE</attr>\
             <attr key=\"originalModuleName\" type=\"string\">evis</attr>\
             <attr key=\"originalOutputName\" type=\"string\">{name}</attr>\
             <attr key=\"typeDescription\" type=\"string\">{description}</attr>\
             <attr key=\"typeIdentifier\" type=\"string\">{identifier}</attr>\
             <node name=\"info\" path=\"{path}info/\">{size}\
             <attr key=\"source\" type=\"string\">EVIS</attr>\
             <attr key=\"tsOffset\" type=\"long\">0</attr></node></node>"
        );
    }
    let xml = format!(
        "<dv version=\"2.0\"><node name=\"outInfo\" path=\"/mainloop/Recorder/outInfo/\">{nodes}</node></dv>"
    );
    let (mut builder, places) = Builder::new(Vec::new(), b"IOHE", &[4, 8, 4]);
    builder.put(places[0], &0_i32.to_le_bytes());
    builder.put(places[1], &(-1_i64).to_le_bytes());
    builder.text(places[2], &xml);
    let mut bytes = MAGIC.to_vec();
    bytes.extend(builder.finish());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_header_tells_the_streams() {
        let bytes = build((1280, 720), &[true, true, false, true]);
        let header = Header::parse(&bytes).unwrap();
        assert_eq!(
            (header.compression, header.table_at, header.length),
            (Compression::None, -1, bytes.len())
        );
        let of = |stream: &Stream| (stream.id, stream.kind, stream.name.clone(), stream.size);
        assert_eq!(
            header.streams.iter().map(of).collect::<Vec<_>>(),
            [
                (0, Kind::Events, "events".into(), Some((1280, 720))),
                (1, Kind::Frames, "frames".into(), Some((1280, 720))),
                (3, Kind::Triggers, "triggers".into(), None)
            ]
        );
        for at in 0..bytes.len() {
            assert!(Header::parse(&bytes[..at]).is_err());
            let mut wrong = bytes.clone();
            wrong[at] ^= 0x10;
            let _ = Header::parse(&wrong);
        }
    }
}
