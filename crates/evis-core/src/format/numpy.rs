//! NumPy's files: the header of `.npy`, its integers, and an event of them.

use std::io::Read;

use crate::event::{Event, Polarity};

/// Longest header that is read.
const MOST_HEADER: usize = 1 << 16;

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
            let rule =
                if polarity.is_none() { "polarities are 1, 0 or -1" } else { "x and y are 0 to 65535" };
            Err(format!("cannot be: t {t}, x {x}, y {y}, p {p}; {rule}"))
        }
    }
}
