//! `NumPy`'s files: `.npy`, an array of structures with the fields t, x, y and p, and `.npz`, a column each.

use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use evis_core::Event;
use evis_core::format::FormatError;
use evis_core::format::numpy::{self, Integer, NpyHeader};
use evis_core::limits::open_regular;
use flate2::read::DeflateDecoder;

use crate::check::Check;
use crate::files::{Input, Output, draft_path, refuse_existing};
use crate::format::Format;
use crate::packet::Packet;
use crate::read::{EventReader, ReadOptions, StreamInfo};
use crate::text::entry_options;
use crate::write::{EventWriter, WriteOptions};

/// Events per packet.
const EVENTS_AT_ONCE: usize = 32 << 10;
/// Most bytes of an element with fields.
const MOST_ROW: usize = 1 << 12;
/// Names of columns that other programs use, for t, x, y and p.
const NAMES: [&[&str]; 4] = [
    &["t", "ts", "timestamp", "timestamps"],
    &["x", "xs"],
    &["y", "ys"],
    &["p", "ps", "pol", "polarity", "polarities", "on"],
];

/// An event of t, x, y and p, or what is wrong with them.
fn event(values: [Option<i64>; 4]) -> Result<Event, String> {
    numpy::event(values).map_err(|what| format!("an event {what}"))
}

/// The four columns of a structure: where each lies, and of which type.
type Fields = [(usize, Integer); 4];

/// The fields of `('x', '<u2'), ('y', '<u2'), ...` and the bytes of a row. Two layouts are understood: a list
/// of fields, in which bytes that carry nothing have an empty name.
fn fields_of(descr: &str) -> Option<(Fields, usize)> {
    // A field of several values has a third entry, its shape.
    if descr.split("), (").any(|field| field.contains(", (")) {
        return None;
    }
    let words: Vec<&str> = descr.split('\'').skip(1).step_by(2).collect();
    let (mut width, mut found) = (0_usize, Vec::new());
    for pair in words.chunks_exact(2) {
        let &[name, kind] = pair else { continue };
        let bytes: usize = kind.get(2..)?.parse().ok().filter(|bytes| *bytes <= MOST_ROW)?;
        found.push((name, width, Integer::of(kind)));
        width += bytes;
    }
    if width > MOST_ROW {
        return None;
    }
    let field = |names: &[&str]| {
        let (_, at, integer) = found.iter().find(|(name, ..)| names.contains(name))?;
        Some((*at, (*integer)?))
    };
    let [t, x, y, p] = NAMES.map(field);
    Some(([t?, x?, y?, p?], width))
}

/// What `EventCD` is in a header.
const EVENT_CD: &str = "[('x', '<u2'), ('y', '<u2'), ('p', '<i2'), ('', '|V2'), ('t', '<i8')]";

/// Reads `.npy`.
pub(crate) struct NpyReader {
    input: Input,
    info: StreamInfo,
    start: u64,
    rows: u64,
    row: usize,
    fields: Fields,
    block: Vec<u8>,
    damage: Option<(u64, String)>,
}

impl NpyReader {
    pub(crate) fn open(path: &Path, options: &ReadOptions) -> Result<Self, FormatError> {
        let mut input = Input::open(path)?;
        let mut head = Vec::new();
        input.read_block(&mut head, 128 << 10)?;
        let mut rest = head.as_slice();
        let header = NpyHeader::read(&mut rest).map_err(|what| input.damaged(0, &what))?;
        let start = (head.len() - rest.len()) as u64;
        let wrong = |what: String| {
            FormatError::corrupt(
                path,
                what,
                "save an array of events with the fields t, x, y and p, whole numbers",
            )
        };
        let (fields, row) = fields_of(&header.descr)
            .ok_or_else(|| wrong(format!("its elements are of dtype '{}'", header.descr)))?;
        let &[rows] = header.shape.as_slice() else {
            return Err(wrong(format!("its shape is {:?}, not one row of events", header.shape)));
        };
        let mut info = StreamInfo::new(Format::Npy);
        info.size = options.size;
        info.events = Some(rows);
        input.seek(start)?;
        Ok(Self { input, info, start, rows, row, fields, block: Vec::new(), damage: None })
    }

    fn next_row(&self) -> u64 {
        (self.input.at() - self.start) / self.row as u64
    }

    fn read_row(row: &[u8], fields: &Fields) -> [Option<i64>; 4] {
        fields.map(|(at, integer)| row.get(at..at + integer.bytes()).and_then(|bytes| integer.read(bytes)))
    }

    /// Reads up to `wanted` rows, which are events as they lie in memory, to where events go. Returns how many there are,
    /// and whether one is wrong: then they are in the block, to be taken one by one.
    fn read_events(
        &mut self,
        wanted: usize,
        (width, height): (u32, u32),
        events: &mut Vec<Event>,
    ) -> Result<(usize, bool), FormatError> {
        events.resize(wanted, Event::default());
        let bytes = self.input.read_into(bytemuck::cast_slice_mut(events))?;
        events.truncate(bytes / size_of::<Event>());
        let (mut wrong, mut marked) = (false, 0);
        for [x, y, p, mark, ..] in bytemuck::cast_slice::<Event, [u16; 8]>(events) {
            wrong |= (*p > 1) | (u32::from(*x) >= width) | (u32::from(*y) >= height);
            marked |= mark;
        }
        if wrong {
            self.block.clear();
            self.block.extend_from_slice(bytemuck::cast_slice(events));
        } else if marked != 0 {
            // What other programs leave between p and t.
            bytemuck::cast_slice_mut::<Event, [u16; 8]>(events).iter_mut().for_each(|halves| halves[3] = 0);
        }
        Ok((events.len(), wrong))
    }

    /// Whether rows are events as they lie in memory.
    fn is_event_cd(&self) -> bool {
        let is = |(at, integer): (usize, Integer), place, descr| {
            at == place && Some(integer) == Integer::of(descr)
        };
        let [t, x, y, p] = self.fields;
        cfg!(target_endian = "little")
            && self.row == 16
            && is(t, 8, "<i8")
            && is(x, 0, "<u2")
            && is(y, 2, "<u2")
            && is(p, 4, "<i2")
    }
}

impl EventReader for NpyReader {
    fn info(&self) -> &StreamInfo {
        &self.info
    }

    fn read_packet(&mut self, packet: &mut Packet) -> Result<bool, FormatError> {
        packet.clear();
        if let Some((at, what)) = &self.damage {
            return Err(self.input.damaged(*at, what));
        }
        let at = self.input.at();
        let wanted = (self.rows - self.next_row().min(self.rows)).min(EVENTS_AT_ONCE as u64) as usize;
        if wanted == 0 {
            return Ok(false);
        }
        let (width, height) = self.info.size.unwrap_or((1 << 16, 1 << 16));
        let (whole, wrong) = if self.is_event_cd() {
            self.read_events(wanted, (width, height), &mut packet.events)?
        } else {
            self.input.read_block(&mut self.block, wanted * self.row)?;
            (self.block.len() / self.row, true)
        };
        let (fields, row) = (self.fields, self.row);
        let rows = self.block.chunks_exact(row);
        if wrong {
            packet.events.clear();
            for (index, bytes) in rows.enumerate() {
                let what = match event(Self::read_row(bytes, &fields)) {
                    Ok(e) if u32::from(e.x) < width && u32::from(e.y) < height => {
                        packet.events.push(e);
                        continue;
                    }
                    Ok(e) => format!("x {}, y {} lies outside of {width}x{height}", e.x, e.y),
                    Err(what) => what,
                };
                self.damage = Some((at + (index * row) as u64, what));
                break;
            }
        }
        if whole < wanted && self.damage.is_none() {
            let (first, of) = (self.next_row(), self.rows);
            self.damage = Some((self.input.at(), format!("it ends at event {first} of {of}")));
        }
        match &self.damage {
            Some((at, what)) if packet.is_empty() => Err(self.input.damaged(*at, what)),
            _ => Ok(true),
        }
    }

    fn part(&self) -> Option<f64> {
        Some(self.input.part())
    }

    fn seek(&mut self, t_us: i64) -> Result<(), FormatError> {
        self.damage = None;
        let held = self.input.length().saturating_sub(self.start) / self.row as u64;
        let (mut low, mut high) = (0, self.rows.min(held));
        while low < high {
            let middle = low + (high - low) / 2;
            self.input.seek(self.start + middle * self.row as u64)?;
            self.input.read_block(&mut self.block, self.row)?;
            let [t, ..] = Self::read_row(&self.block, &self.fields);
            if t.is_some_and(|t| t < t_us) {
                low = middle + 1;
            } else {
                high = middle;
            }
        }
        self.input.seek(self.start + low * self.row as u64)
    }
}

/// Writes `.npy`: an array of dtype `EventCD`, which can be mapped into memory.
pub(crate) struct NpyWriter {
    output: Output,
    check: Check,
    count: u64,
}

/// A header for `count` elements, whose length does not depend on their number.
fn npy_header(descr: &str, count: u64) -> Vec<u8> {
    let dictionary = format!("{{'descr': {descr}, 'fortran_order': False, 'shape': ({count},), }}");
    // The elements start at a multiple of 64 bytes; 20 digits hold every count.
    let length = (10 + dictionary.len() - count.to_string().len() + 20 + 1).next_multiple_of(64) - 10;
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((length as u16).to_le_bytes());
    bytes.extend(dictionary.as_bytes());
    bytes.resize(10 + length - 1, b' ');
    bytes.push(b'\n');
    bytes
}

impl NpyWriter {
    pub(crate) fn create(path: &Path, options: &WriteOptions) -> Result<Self, FormatError> {
        let mut output = Output::create(path, options.overwrite)?;
        output.write(&npy_header(EVENT_CD, 0))?;
        let check = Check::new(path, Format::Npy, options.size, (i64::MIN, i64::MAX), -1);
        Ok(Self { output, check, count: 0 })
    }
}

impl EventWriter for NpyWriter {
    fn write(&mut self, packet: &Packet) -> Result<(), FormatError> {
        self.check.only_events(packet)?;
        self.write_events(&packet.events)
    }

    fn write_events(&mut self, events: &[Event]) -> Result<(), FormatError> {
        self.check.events(events)?;
        self.count += events.len() as u64;
        if cfg!(target_endian = "little") {
            return self.output.write(bytemuck::cast_slice(events));
        }
        for e in events {
            let row =
                u128::from(e.x) | u128::from(e.y) << 16 | (e.p as u128) << 32 | (e.t as u64 as u128) << 64;
            self.output.write(&row.to_le_bytes())?;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<(), FormatError> {
        self.output.patch(0, &npy_header(EVENT_CD, self.count))?;
        self.output.finish()
    }
}

/// A column of an archive.
struct Column {
    source: Box<dyn Read + Send>,
    integer: Integer,
    block: Vec<u8>,
}

/// Reads `.npz`: four columns at once, each from its own place in the archive.
pub(crate) struct NpzReader {
    path: PathBuf,
    info: StreamInfo,
    columns: [Column; 4],
    rows: u64,
    next: u64,
    failed: Option<String>,
}

/// What works.
const COLUMNS: &str = "save the columns t, x, y and p as whole numbers with numpy.savez";

impl NpzReader {
    pub(crate) fn open(path: &Path, options: &ReadOptions) -> Result<Self, FormatError> {
        let wrong = |what: String| FormatError::corrupt(path, what, COLUMNS);
        let mut counts = Vec::new();
        let mut column = |names: &[&str]| {
            for name in names {
                if let Some((header, source)) = entry(path, name)? {
                    let integer = Integer::of(&header.descr).ok_or_else(|| {
                        wrong(format!(
                            "its column {name} is of dtype '{}', not of whole numbers",
                            header.descr
                        ))
                    })?;
                    let &[count] = header.shape.as_slice() else {
                        return Err(wrong(format!("its column {name} has shape {:?}", header.shape)));
                    };
                    counts.push(count);
                    return Ok(Column { source, integer, block: Vec::new() });
                }
            }
            Err(wrong(format!("it has no column {}", names.first().unwrap_or(&""))))
        };
        let columns = [column(NAMES[0])?, column(NAMES[1])?, column(NAMES[2])?, column(NAMES[3])?];
        let rows = counts.first().copied().unwrap_or(0);
        if counts.iter().any(|count| *count != rows) {
            return Err(wrong(format!("its columns t, x, y and p have {counts:?} rows")));
        }
        let side = |name: &str| -> Result<Option<u32>, FormatError> {
            let Some((header, mut source)) = entry(path, name)? else { return Ok(None) };
            let Some(integer) = Integer::of(&header.descr) else { return Ok(None) };
            let mut bytes = Vec::new();
            // Left out where it cannot be read: it is not needed.
            let read = (&mut source).take(integer.bytes() as u64).read_to_end(&mut bytes);
            let whole = read.is_ok_and(|read| read == integer.bytes());
            let side = if whole { integer.read(&bytes) } else { None };
            Ok(side.and_then(|side| u32::try_from(side).ok()).filter(|side| (1..=1 << 16).contains(side)))
        };
        let mut info = StreamInfo::new(Format::Npz);
        info.size = side("width")?.zip(side("height")?).or(options.size);
        info.events = Some(rows);
        Ok(Self { path: path.into(), info, columns, rows, next: 0, failed: None })
    }
}

/// The header of an array, and where its elements come from.
type Array = (NpyHeader, Box<dyn Read + Send>);

/// The array `name` of an archive, where it has one.
fn entry(path: &Path, name: &str) -> Result<Option<Array>, FormatError> {
    let failed = |error| FormatError::io(path, "read", error);
    let wrong = |what: String| FormatError::corrupt(path, what, COLUMNS);
    let mut file = open_regular(path).map_err(failed)?;
    let mut archive = zip::ZipArchive::new(BufReader::new(&file))
        .map_err(|error| wrong(format!("its archive cannot be read ({error})")))?;
    let Some(index) = archive.index_for_name(&format!("{name}.npy")) else { return Ok(None) };
    let found = archive
        .by_index_raw(index)
        .map_err(|error| wrong(format!("its column {name} cannot be read ({error})")))?;
    let (start, size, method) =
        (found.data_start().unwrap_or(0), found.compressed_size(), found.compression());
    drop(found);
    file.seek(SeekFrom::Start(start)).map_err(failed)?;
    let packed = BufReader::with_capacity(1 << 17, file.take(size));
    let mut source: Box<dyn Read + Send> = match method {
        zip::CompressionMethod::Stored => Box::new(packed),
        zip::CompressionMethod::Deflated => {
            Box::new(BufReader::with_capacity(1 << 16, DeflateDecoder::new(packed)))
        }
        method => return Err(wrong(format!("its column {name} is packed by {method}"))),
    };
    let header = NpyHeader::read(&mut source).map_err(|what| wrong(format!("column {name}: {what}")))?;
    Ok(Some((header, source)))
}

impl EventReader for NpzReader {
    fn info(&self) -> &StreamInfo {
        &self.info
    }

    fn read_packet(&mut self, packet: &mut Packet) -> Result<bool, FormatError> {
        packet.clear();
        let wrong = |what: &str| FormatError::corrupt(&self.path, what, COLUMNS);
        if let Some(what) = &self.failed {
            return Err(wrong(what));
        }
        let wanted = (self.rows - self.next).min(EVENTS_AT_ONCE as u64) as usize;
        if wanted == 0 {
            return Ok(false);
        }
        let mut whole = wanted;
        for column in &mut self.columns {
            column.block.clear();
            let size = column.integer.bytes();
            // An error of the decoder ends the column, as the file's end does.
            let _ = (&mut column.source).take((wanted * size) as u64).read_to_end(&mut column.block);
            whole = whole.min(column.block.len() / size);
        }
        let (width, height) = self.info.size.unwrap_or((1 << 16, 1 << 16));
        let mut failed = None;
        for index in 0..whole {
            let values = self.columns.each_ref().map(|column| {
                let size = column.integer.bytes();
                column
                    .block
                    .get(index * size..(index + 1) * size)
                    .and_then(|bytes| column.integer.read(bytes))
            });
            match event(values) {
                Ok(e) if u32::from(e.x) < width && u32::from(e.y) < height => packet.events.push(e),
                Ok(e) => {
                    failed = Some(format!("x {}, y {} lies outside of {width}x{height}", e.x, e.y));
                    break;
                }
                Err(what) => {
                    failed = Some(what);
                    break;
                }
            }
        }
        self.next += packet.events.len() as u64;
        if let Some(what) = failed {
            self.failed = Some(format!("at event {}, {what}", self.next));
        } else if whole < wanted {
            self.failed = Some(format!("a column ends at event {} of {}", self.next, self.rows));
        }
        match &self.failed {
            Some(what) if packet.is_empty() => Err(FormatError::corrupt(&self.path, what, COLUMNS)),
            _ => Ok(true),
        }
    }

    fn part(&self) -> Option<f64> {
        Some(self.next as f64 / self.rows.max(1) as f64)
    }

    fn seek(&mut self, _t_us: i64) -> Result<(), FormatError> {
        // A deflated column has no places to start from: from the start.
        let options = ReadOptions { size: self.info.size, camera: None };
        *self = Self::open(&self.path, &options)?;
        Ok(())
    }
}

/// Writes `.npz`: each column goes to a file beside it, since an archive holds one after the other.
pub(crate) struct NpzWriter {
    path: PathBuf,
    size: (u32, u32),
    check: Check,
    columns: Vec<(PathBuf, BufWriter<File>)>,
    count: u64,
    bytes: Vec<u8>,
}

/// Columns of the archive, with their types and bytes per element.
const WRITTEN: [(&str, &str); 4] = [("t", "'<i8'"), ("x", "'<u2'"), ("y", "'<u2'"), ("p", "'<i2'")];

impl NpzWriter {
    pub(crate) fn create(path: &Path, options: &WriteOptions) -> Result<Self, FormatError> {
        refuse_existing(path, options.overwrite)?;
        let check = Check::new(path, Format::Npz, options.size, (i64::MIN, i64::MAX), -1);
        let mut writer = Self {
            path: path.into(),
            size: options.size,
            check,
            columns: Vec::new(),
            count: 0,
            bytes: Vec::new(),
        };
        for (name, _) in WRITTEN {
            let draft = draft_path(path, &format!("{name}.draft"));
            let file = File::create(&draft).map_err(|error| FormatError::io(path, "create", error))?;
            writer.columns.push((draft, BufWriter::with_capacity(1 << 17, file)));
        }
        Ok(writer)
    }

    fn pack(&mut self, draft: &Path) -> std::io::Result<()> {
        let mut archive = zip::ZipWriter::new(File::create(draft)?);
        for (index, (name, descr)) in WRITTEN.iter().enumerate() {
            let Some((column, file)) = self.columns.get_mut(index) else { continue };
            file.flush()?;
            archive.start_file(format!("{name}.npy"), entry_options())?;
            archive.write_all(&npy_header(descr, self.count))?;
            std::io::copy(&mut BufReader::with_capacity(1 << 18, File::open(column)?), &mut archive)?;
        }
        for (name, side) in [("width", self.size.0), ("height", self.size.1)] {
            archive.start_file(format!("{name}.npy"), entry_options())?;
            archive.write_all(&scalar_header())?;
            archive.write_all(&i64::from(side).to_le_bytes())?;
        }
        archive.finish()?;
        Ok(())
    }
}

/// The header of a single `<i8`.
fn scalar_header() -> Vec<u8> {
    let mut bytes =
        b"\x93NUMPY\x01\x00\x76\x00{'descr': '<i8', 'fortran_order': False, 'shape': (), }".to_vec();
    bytes.resize(127, b' ');
    bytes.push(b'\n');
    bytes
}

impl EventWriter for NpzWriter {
    fn write(&mut self, packet: &Packet) -> Result<(), FormatError> {
        self.check.only_events(packet)?;
        self.write_events(&packet.events)
    }

    fn write_events(&mut self, events: &[Event]) -> Result<(), FormatError> {
        self.check.events(events)?;
        self.count += events.len() as u64;
        for part in events.chunks(EVENTS_AT_ONCE) {
            for (index, (_, file)) in self.columns.iter_mut().enumerate() {
                self.bytes.clear();
                match index {
                    0 => self.bytes.extend(part.iter().flat_map(|e| e.t.to_le_bytes())),
                    1 => self.bytes.extend(part.iter().flat_map(|e| e.x.to_le_bytes())),
                    2 => self.bytes.extend(part.iter().flat_map(|e| e.y.to_le_bytes())),
                    _ => self.bytes.extend(part.iter().flat_map(|e| e.p.to_le_bytes())),
                }
                file.write_all(&self.bytes).map_err(|error| FormatError::io(&self.path, "write", error))?;
            }
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<(), FormatError> {
        let draft = draft_path(&self.path, "draft");
        let packed = self.pack(&draft).and_then(|()| std::fs::rename(&draft, &self.path));
        packed.map_err(|error| {
            let _ = std::fs::remove_file(&draft);
            FormatError::io(&self.path, "write", error)
        })
    }
}

impl Drop for NpzWriter {
    fn drop(&mut self) {
        for (path, _) in &self.columns {
            let _ = std::fs::remove_file(path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_keep_their_length_and_say_what_follows() {
        let lengths = [0, 9, u64::MAX].map(|count| npy_header(EVENT_CD, count).len());
        assert!(lengths.iter().all(|length| *length == lengths[0] && length % 64 == 0));
        let header = NpyHeader::read(&mut npy_header(EVENT_CD, 12).as_slice()).unwrap();
        assert_eq!(header.shape, [12]);
        let (fields, row) = fields_of(&header.descr).unwrap();
        assert_eq!((fields.map(|(at, _)| at), row), ([8, 0, 2, 4], 16));
        let scalar = scalar_header();
        assert_eq!((NpyHeader::read(&mut scalar.as_slice()).unwrap().shape.len(), scalar.len()), (0, 128));
        assert!(fields_of("('x', '<u2'), ('y', '<u2'), ('p', '<i2'), ('t', '<f8')").is_none());
    }
}
