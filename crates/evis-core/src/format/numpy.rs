//! NumPy's files: the header of `.npy`, and events in `.npy` (EventCD) and `.npz` (columns t, x, y, p).

use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use evis_limits::Budget;
use flate2::read::DeflateDecoder;

use super::{EventFile, FormatError};
use crate::event::{Event, Polarity};

/// Longest header that is read.
const MOST_HEADER: usize = 1 << 16;

/// Most events that are read: 64 GiB of them.
const MOST_EVENTS: u64 = 1 << 32;

/// Deflate expands at most 1032 times.
const MOST_EXPANSION: u64 = 1100;

/// Rows that are decoded at once.
const ROWS_AT_ONCE: usize = 1 << 12;

/// Most bytes of an element with fields.
const MOST_ROW: usize = 1 << 12;

/// What a `.npy` file says about its array (NEP 1).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NpyHeader {
    /// Type of the elements, such as `<u2`; of a structure, the text between its brackets.
    pub descr: String,
    /// Whether the first index runs fastest.
    pub fortran_order: bool,
    /// Lengths.
    pub shape: Vec<u64>,
}

impl NpyHeader {
    /// Reads a header; the elements follow in `file`.
    ///
    /// # Errors
    /// What is wrong with it, as the end of a sentence that begins with the file's name.
    pub fn read(file: &mut impl Read) -> Result<Self, String> {
        let short = |_| "it ends within its header".to_owned();
        let mut magic = [0; 8];
        file.read_exact(&mut magic).map_err(short)?;
        if magic[..6] != *b"\x93NUMPY" {
            return Err("it is no .npy file".into());
        }
        // Version 1 has a length of two bytes, later ones of four.
        let mut length = [0; 4];
        let bytes = if magic[6] == 1 { 2 } else { 4 };
        file.read_exact(&mut length[..bytes]).map_err(short)?;
        let length = u32::from_le_bytes(length) as usize;
        if length > MOST_HEADER {
            return Err(format!("its header would be {length} bytes long"));
        }
        let mut text = vec![0; length];
        file.read_exact(&mut text).map_err(short)?;
        let text = String::from_utf8_lossy(&text).into_owned();
        let descr = value(&text, "descr").unwrap_or_default().trim_matches(['\'', '"', '[', ']']).to_owned();
        let shape = value(&text, "shape").unwrap_or_default();
        let sides = shape.trim_matches(['(', ')']).split(',').map(str::trim).filter(|side| !side.is_empty());
        let sides: Option<Vec<u64>> = sides.map(|side| side.parse().ok()).collect();
        let Some(sides) = sides.filter(|_| shape.starts_with('(')) else {
            return Err(format!("its shape is '{shape}'"));
        };
        Ok(Self { descr, fortran_order: value(&text, "fortran_order") != Some("False"), shape: sides })
    }
}

/// The value of `key` in the header, which is a Python dictionary of texts, truths, a tuple and perhaps a list.
fn value<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let at = header.find(&format!("'{key}'"))?;
    let rest = header.get(at..)?.split_once(':')?.1.trim_start();
    let end = match rest.chars().next()? {
        '(' => rest.find(')')? + 1,
        '[' => rest.find(']')? + 1,
        _ => rest.find([',', '}'])?,
    };
    rest.get(..end).map(str::trim)
}

/// An integer type of `NumPy`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Integer {
    bytes: usize,
    signed: bool,
    big_endian: bool,
}

impl Integer {
    /// The type of a header's `descr`, such as `<u2`; `None` for anything but integers and booleans.
    #[must_use]
    pub fn of(descr: &str) -> Option<Self> {
        let (order, kind) = descr.split_at_checked(1)?;
        let (class, bytes) = kind.split_at_checked(1)?;
        let bytes: usize = bytes.parse().ok().filter(|bytes| matches!(bytes, 1 | 2 | 4 | 8))?;
        let signed = match class {
            "i" => true,
            "u" => false,
            "b" if bytes == 1 => false,
            _ => return None,
        };
        Some(Self { bytes, signed, big_endian: order == ">" })
    }

    /// Bytes of a value: 1, 2, 4 or 8.
    #[must_use]
    pub const fn bytes(self) -> usize {
        self.bytes
    }

    /// Element `index` of `data`.
    fn at(self, data: &[u8], index: usize) -> Option<i64> {
        let start = index.checked_mul(self.bytes)?;
        self.read(data.get(start..start.checked_add(self.bytes)?)?)
    }

    /// The value of exactly `self.bytes` bytes; `None` past 63 bits, and for another number of bytes.
    #[must_use]
    pub fn read(self, bytes: &[u8]) -> Option<i64> {
        let mut wide = [0_u8; 8];
        let value = wide.get_mut(..self.bytes).filter(|value| value.len() == bytes.len())?;
        value.copy_from_slice(bytes);
        if self.big_endian {
            value.reverse();
        }
        let value = u64::from_le_bytes(wide);
        if !self.signed {
            return i64::try_from(value).ok();
        }
        let unused = 64 - 8 * self.bytes as u32;
        Some(((value << unused) as i64) >> unused)
    }
}

/// What works.
const FORM: &str =
    "save events with evis.save, or the columns t, x, y and p as whole numbers with numpy.savez";

/// Events of `.npy` or `.npz`.
pub(super) fn read_events(path: &Path) -> Result<EventFile, FormatError> {
    let file = evis_limits::open_regular(path).map_err(|error| FormatError::io(path, "read", error))?;
    let length = file.metadata().map_err(|error| FormatError::io(path, "read", error))?.len();
    let mut file = BufReader::with_capacity(1 << 20, file);
    let budget = Budget::default();
    let corrupt = |what: String| FormatError::corrupt(path, what, FORM);
    let zipped = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("npz"));
    let read =
        if zipped { columns(&mut file, length, &budget) } else { structure(&mut file, length, &budget) };
    let (events, size) = read.map_err(corrupt)?;
    let size = size.unwrap_or_else(|| {
        let most = |of: fn(&Event) -> u16| events.iter().map(of).max().map_or(1, |most| u32::from(most) + 1);
        (most(|e| e.x), most(|e| e.y))
    });
    let range = match (events.first(), events.last()) {
        (Some(first), Some(last)) => (first.t, last.t.saturating_add(1)),
        _ => (0, 0),
    };
    Ok(EventFile { events, size, range })
}

type Columns = (Vec<Event>, Option<(u32, u32)>);

/// An event of t, x, y and p, where they can be one: 1 is ON, 0 and -1 are OFF.
///
/// # Errors
/// The four values, as the end of a sentence.
#[inline]
pub fn event([t, x, y, p]: [Option<i64>; 4]) -> Result<Event, String> {
    let side = |value: Option<i64>| value.and_then(|value| u16::try_from(value).ok());
    let polarity = match p {
        Some(1) => Some(Polarity::On),
        Some(0 | -1) => Some(Polarity::Off),
        _ => None,
    };
    match (t, side(x), side(y), polarity) {
        (Some(t), Some(x), Some(y), Some(polarity)) => Ok(Event::new(t, x, y, polarity)),
        _ => {
            let word = |value: Option<i64>| value.map_or("beyond 63 bits".into(), |value| value.to_string());
            let [t, x, y, p] = [t, x, y, p].map(word);
            Err(format!("cannot be: t {t}, x {x}, y {y}, p {p}"))
        }
    }
}

/// A structure with fields t, x, y and p.
fn structure(file: &mut impl Read, length: u64, budget: &Budget) -> Result<Columns, String> {
    let header = NpyHeader::read(file)?;
    let wrong = || format!("its elements are of dtype '{}'", header.descr);
    let [count] = header.shape.as_slice() else {
        return Err(format!("its shape is {:?}, not one row of events", header.shape));
    };
    // ('x', '<u2'), ('y', '<u2'), ... and bytes that carry nothing: ('', '|V2').
    let words: Vec<&str> = header.descr.split('\'').skip(1).step_by(2).collect();
    let (mut width, mut fields) = (0_usize, Vec::new());
    for pair in words.chunks_exact(2) {
        let &[name, descr] = pair else { continue };
        let bytes: usize = descr.get(2..).and_then(|bytes| bytes.parse().ok()).ok_or_else(wrong)?;
        fields.push((name, width, Integer::of(descr)));
        width = width
            .checked_add(bytes)
            .filter(|width| *width <= MOST_ROW)
            .ok_or_else(|| format!("{}; its elements have more than {MOST_ROW} bytes", wrong()))?;
    }
    // A field of several values has a third entry, its shape.
    if header.descr.split("), (").any(|field| field.contains(", (")) {
        return Err(wrong());
    }
    let mut found = Vec::new();
    for wanted in ["t", "x", "y", "p"] {
        let field = fields.iter().find(|(name, ..)| *name == wanted);
        let Some((_, offset, Some(integer))) = field else { return Err(wrong()) };
        found.push((*offset, *integer));
    }
    let [t, x, y, p] = found.as_slice() else { return Err(wrong()) };
    if *count > MOST_EVENTS || count.saturating_mul(width as u64) > length {
        return Err(format!(
            "it is cut off: {count} events of {width} bytes do not fit in its {length} bytes"
        ));
    }
    let is_event_cd = cfg!(target_endian = "little")
        && width == size_of::<Event>()
        && [(t, 8, 8, true), (x, 0, 2, false), (y, 2, 2, false), (p, 4, 2, true)].iter().all(
            |((offset, integer), at, bytes, signed)| {
                offset == at
                    && (integer.bytes, integer.signed, integer.big_endian) == (*bytes, *signed, false)
            },
        );
    let count = *count as usize;
    let mut events: Vec<Event> = budget.list(count, "its list of events")?;
    let mut block = vec![0; width * ROWS_AT_ONCE.min(count)];
    while events.len() < count {
        let first = events.len();
        let rows = ROWS_AT_ONCE.min(count - first);
        let block = &mut block[..rows * width];
        file.read_exact(block)
            .map_err(|_| format!("it ends within events {first} to {} of {count}", first + rows))?;
        if is_event_cd {
            for row in block.chunks_exact(width) {
                // What pads the row is not kept, and -1 is OFF.
                let Event { x, y, p, t, .. } = bytemuck::pod_read_unaligned(row);
                let mut event = Event::new(t, x, y, Polarity::Off);
                event.p = if p == -1 { 0 } else { p };
                events.push(event);
            }
            continue;
        }
        for (row, index) in block.chunks_exact(width).zip(first..) {
            let value = |(offset, integer): &(usize, Integer)| {
                row.get(*offset..offset + integer.bytes).and_then(|bytes| integer.read(bytes))
            };
            events.push(event([t, x, y, p].map(value)).map_err(|what| format!("event {index} {what}"))?);
        }
    }
    Ok((events, None))
}

/// Columns in an archive.
fn columns(file: &mut (impl Read + Seek), length: u64, budget: &Budget) -> Result<Columns, String> {
    let entries = entries(file).ok_or("its archive has no readable list of contents")?;
    let mut column = |name: &str| -> Result<Option<(Integer, Vec<u8>, u64)>, String> {
        let Some(entry) = entries.iter().find(|entry| entry.name == format!("{name}.npy")) else {
            return Ok(None);
        };
        let mut data = entry.open(file).ok_or_else(|| format!("its column {name} cannot be unpacked"))?;
        let header = NpyHeader::read(&mut data).map_err(|what| format!("column {name}: {what}"))?;
        let integer = Integer::of(&header.descr).ok_or_else(|| {
            format!("its column {name} is of dtype '{}', not of whole numbers", header.descr)
        })?;
        let count = match *header.shape.as_slice() {
            [] => 1,
            [count] if count <= MOST_EVENTS => count,
            _ => return Err(format!("its column {name} has shape {:?}", header.shape)),
        };
        let size = count * integer.bytes as u64;
        // Both: what is packed in this file, and what it becomes.
        if size / MOST_EXPANSION > entry.packed.min(length) || !entry.deflated && size > length {
            return Err(format!("its column {name} of {count} values does not fit in its {length} bytes"));
        }
        let what = format!("its column {name}");
        let mut bytes = budget.list(usize::try_from(size).unwrap_or(usize::MAX), &what)?;
        data.take(size).read_to_end(&mut bytes).map_err(|error| format!("column {name}: {error}"))?;
        if bytes.len() as u64 != size {
            return Err(format!("its column {name} is cut off"));
        }
        Ok(Some((integer, bytes, count)))
    };
    let mut parts = Vec::new();
    for name in ["t", "x", "y", "p"] {
        parts.push(column(name)?.ok_or_else(|| format!("it has no column {name}"))?);
    }
    let [t, x, y, p] = parts.as_slice() else { return Err("it has no columns".into()) };
    if [x, y, p].iter().any(|column| column.2 != t.2) {
        return Err("its columns differ in length".into());
    }
    let value = |(integer, bytes, _): &(Integer, Vec<u8>, u64), index| integer.at(bytes, index);
    let mut events = budget.list(t.2 as usize, "its list of events")?;
    for i in 0..t.2 as usize {
        let values = [t, x, y, p].map(|column| value(column, i));
        events.push(event(values).map_err(|what| format!("event {i} {what}"))?);
    }
    let mut side = |name| -> Result<Option<u32>, String> {
        let side = column(name)?.and_then(|(integer, bytes, _)| integer.at(&bytes, 0));
        Ok(side.and_then(|side| u32::try_from(side).ok()))
    };
    let size = side("width")?.zip(side("height")?);
    Ok((events, size))
}

/// A file of an archive (PKWARE's APPNOTE).
struct Entry {
    name: String,
    deflated: bool,
    packed: u64,
    at: u64,
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    bytes.get(at..)?.first_chunk().map(|b| u16::from_le_bytes(*b))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..)?.first_chunk().map(|b| u32::from_le_bytes(*b))
}

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    bytes.get(at..)?.first_chunk().map(|b| u64::from_le_bytes(*b))
}

/// The list at the archive's end.
fn entries(file: &mut (impl Read + Seek)) -> Option<Vec<Entry>> {
    let length = file.seek(SeekFrom::End(0)).ok()?;
    // The end record is followed by a comment of 64 KiB at most.
    let tail_at = length.saturating_sub(22 + 65_535);
    file.seek(SeekFrom::Start(tail_at)).ok()?;
    let mut tail = Vec::new();
    file.take(65_557).read_to_end(&mut tail).ok()?;
    let end = tail.windows(4).rposition(|window| window == b"PK\x05\x06")?;
    let size = u64::from(u32_at(&tail, end + 12)?);
    let at = u64::from(u32_at(&tail, end + 16)?);
    if size > 1 << 24 {
        return None;
    }
    file.seek(SeekFrom::Start(at)).ok()?;
    let mut list = Vec::new();
    file.take(size).read_to_end(&mut list).ok()?;
    let mut rest = list.as_slice();
    let mut entries = Vec::new();
    while rest.starts_with(b"PK\x01\x02") {
        let lengths = [u16_at(rest, 28)?, u16_at(rest, 30)?, u16_at(rest, 32)?].map(usize::from);
        let name = rest.get(46..46 + lengths[0])?;
        let extra = rest.get(46 + lengths[0]..46 + lengths[0] + lengths[1])?;
        let (mut packed, mut at) = (u64::from(u32_at(rest, 20)?), u64::from(u32_at(rest, 42)?));
        let unpacked = u32_at(rest, 24)?;
        // Sizes of 4 GiB and more stand in an extra field, in this order, those that do not fit.
        if u16_at(extra, 0) == Some(1) {
            let mut next = 4;
            let mut wide = || {
                let value = u64_at(extra, next);
                next += 8;
                value
            };
            if unpacked == u32::MAX {
                wide()?;
            }
            if packed == u64::from(u32::MAX) {
                packed = wide()?;
            }
            if at == u64::from(u32::MAX) {
                at = wide()?;
            }
        }
        let method = u16_at(rest, 10)?;
        if !matches!(method, 0 | 8) {
            return None;
        }
        entries.push(Entry {
            name: String::from_utf8_lossy(name).into_owned(),
            deflated: method == 8,
            packed,
            at,
        });
        rest = rest.get(46 + lengths.iter().sum::<usize>()..)?;
    }
    Some(entries)
}

impl Entry {
    fn open<'a>(&self, file: &'a mut (impl Read + Seek)) -> Option<Box<dyn Read + 'a>> {
        file.seek(SeekFrom::Start(self.at)).ok()?;
        let mut local = [0; 30];
        file.read_exact(&mut local).ok()?;
        if !local.starts_with(b"PK\x03\x04") {
            return None;
        }
        let skip = i64::from(u16_at(&local, 26)?) + i64::from(u16_at(&local, 28)?);
        file.seek(SeekFrom::Current(skip)).ok()?;
        let packed = file.take(self.packed);
        Some(if self.deflated { Box::new(DeflateDecoder::new(packed)) } else { Box::new(packed) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let header = format!("{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(data);
        bytes
    }

    /// An archive of stored files.
    fn zip(files: &[(&str, Vec<u8>)]) -> Vec<u8> {
        let (mut out, mut list) = (Vec::new(), Vec::new());
        for (name, data) in files {
            let (at, size) = (out.len() as u32, data.len() as u32);
            out.extend(b"PK\x03\x04");
            out.extend([0; 22]);
            out.extend((name.len() as u16).to_le_bytes());
            out.extend([0; 2]);
            out.extend(name.as_bytes());
            out.extend(data);
            list.extend(b"PK\x01\x02");
            list.extend([0; 16]);
            list.extend(size.to_le_bytes());
            list.extend(size.to_le_bytes());
            list.extend((name.len() as u16).to_le_bytes());
            list.extend([0; 12]);
            list.extend(at.to_le_bytes());
            list.extend(name.as_bytes());
        }
        let at = out.len() as u32;
        out.extend(&list);
        out.extend(b"PK\x05\x06");
        out.extend([0; 8]);
        out.extend((list.len() as u32).to_le_bytes());
        out.extend(at.to_le_bytes());
        out.extend([0; 2]);
        out
    }

    fn read(name: &str, bytes: &[u8]) -> Result<EventFile, String> {
        let path = std::env::temp_dir().join(format!("evis-numpy-{}-{name}", std::process::id()));
        std::fs::write(&path, bytes).unwrap();
        let read = crate::format::read_events(&path, None).map_err(|error| error.to_string());
        std::fs::remove_file(&path).unwrap();
        read
    }

    fn files(t: [i64; 2], p: [i8; 2]) -> Vec<(&'static str, Vec<u8>)> {
        let le = |t: [i64; 2]| t.iter().flat_map(|t| t.to_le_bytes()).collect::<Vec<_>>();
        vec![
            ("t.npy", npy("'<i8'", "(2,)", &le(t))),
            ("x.npy", npy("'>u2'", "(2,)", &[0, 3, 1, 0])),
            ("y.npy", npy("'|u1'", "(2,)", &[7, 8])),
            ("p.npy", npy("'|i1'", "(2,)", &p.map(|p| p as u8))),
        ]
    }

    #[test]
    fn columns_of_an_archive_are_events() {
        let want = vec![Event::new(5, 3, 7, Polarity::On), Event::new(9, 256, 8, Polarity::Off)];
        let got = read("a.npz", &zip(&files([5, 9], [1, -1]))).unwrap();
        assert_eq!((got.events, got.size, got.range), (want.clone(), (257, 9), (5, 10)));
        let mut sized = files([5, 9], [1, 0]);
        sized.push(("width.npy", npy("'<i8'", "()", &640_i64.to_le_bytes())));
        sized.push(("height.npy", npy("'<i8'", "()", &480_i64.to_le_bytes())));
        assert_eq!(read("b.npz", &zip(&sized)).unwrap().size, (640, 480));

        let rows: Vec<u8> = want.iter().flat_map(|e| bytemuck::bytes_of(e).to_vec()).collect();
        let descr = "[('x', '<u2'), ('y', '<u2'), ('p', '<i2'), ('', '|V2'), ('t', '<i8')]";
        assert_eq!(read("c.npy", &npy(descr, "(2,)", &rows)).unwrap().events, want);
    }

    #[test]
    fn damaged_files_are_told() {
        let whole = zip(&files([5, 9], [1, 0]));
        let mut missing = files([5, 9], [1, 0]);
        missing.remove(1);
        let mut float = files([5, 9], [1, 0]);
        float[0].1 = npy("'<f8'", "(2,)", &[0; 16]);
        for (name, bytes, told) in [
            ("back.npz", zip(&files([9, 5], [1, 0])), "event 1 is earlier"),
            ("polarity.npz", zip(&files([5, 9], [1, 2])), "event 1 cannot be"),
            ("missing.npz", zip(&missing), "no column x"),
            ("float.npz", zip(&float), "dtype '<f8'"),
            ("cut.npz", whole[..whole.len() / 2].to_vec(), "no readable list"),
            ("text.npy", b"t x y p".to_vec(), "ends within its header"),
            ("plain.npy", npy("'<u2'", "(2,)", &[0; 4]), "dtype '<u2'"),
        ] {
            let error = read(name, &bytes).unwrap_err();
            assert!(error.contains(told), "{name}: {error}");
        }
        // No byte that is wrong makes it panic.
        for at in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[at] ^= 0x55;
            let _ = read("flipped.npz", &bytes);
            let _ = read("flipped.npz", &whole[..at]);
        }
    }
}
