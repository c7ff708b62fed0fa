//! NumPy's own file of one array, frame by frame.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

use evis_core::format::FormatError;
use evis_core::format::numpy::NpyHeader;
use evis_core::limits::{Budget, open_regular};
use half::f16;

use crate::error::VideoError;
use crate::picture::{Picture, Values};

/// What works.
const FORM: &str = "save an array of shape (T, H, W), (T, H, W, 3) or (T, H, W, 4) of uint8, uint16 or a float with numpy.save";

/// Type of the elements.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    U8,
    U16,
    F16,
    F32,
    F64,
}

impl Kind {
    const fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 | Self::F16 => 2,
            Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

/// A stack of frames in a `.npy` file.
#[derive(Debug)]
pub(crate) struct Stack {
    path: PathBuf,
    file: BufReader<File>,
    kind: Kind,
    big_endian: bool,
    /// Frames in all.
    pub frames: u64,
    read: u64,
    height: u32,
    width: u32,
    channels: usize,
}

impl Stack {
    /// Opens the file and understands its header.
    pub fn open(path: &Path) -> Result<Self, VideoError> {
        let file = open_regular(path).map_err(|error| FormatError::io(path, "read", error))?;
        let length = file.metadata().map_err(|error| FormatError::io(path, "read", error))?.len();
        let mut file = BufReader::with_capacity(1 << 20, file);
        let corrupt = |what: String| VideoError::from(FormatError::corrupt(path, what, FORM));
        let header = NpyHeader::read(&mut file).map_err(corrupt)?;
        let (order, kind) = header.descr.split_at_checked(1).unwrap_or_default();
        let kind = match kind {
            "u1" => Kind::U8,
            "u2" => Kind::U16,
            "f2" => Kind::F16,
            "f4" => Kind::F32,
            "f8" => Kind::F64,
            _ => return Err(corrupt(format!("its elements are of dtype '{}'", header.descr))),
        };
        if header.fortran_order {
            return Err(corrupt("its array is in Fortran's order".into()));
        }
        let shape = &header.shape;
        let (frames, height, width, channels) = match *shape.as_slice() {
            [t, h, w] => (t, h, w, 1),
            [t, h, w, c @ (1 | 3 | 4)] => (t, h, w, c as usize),
            _ => return Err(corrupt(format!("its shape is {shape:?}"))),
        };
        let side = |side: u64| u32::try_from(side).ok().filter(|side| (1..=65_536).contains(side));
        let (Some(height), Some(width)) = (side(height), side(width)) else {
            return Err(corrupt(format!("its shape is {shape:?}")));
        };
        // A frame, and beside it the bytes that it is read from.
        let frame = u64::from(width) * u64::from(height) * channels as u64 * kind.bytes() as u64;
        if frame.saturating_mul(frames) > length {
            let what = format!("its array of shape {shape:?} does not fit in its {length} bytes");
            return Err(corrupt(what));
        }
        Budget::default().take(frame.saturating_mul(2), "a frame").map_err(|e| corrupt(e.to_string()))?;
        let big_endian = order == ">";
        Ok(Self { path: path.into(), file, kind, big_endian, frames, read: 0, height, width, channels })
    }

    /// The next frame.
    pub fn next(&mut self) -> Result<Option<Picture>, VideoError> {
        if self.read == self.frames {
            return Ok(None);
        }
        let count = self.width as usize * self.height as usize * self.channels;
        let mut bytes = vec![0; count * self.kind.bytes()];
        self.file.read_exact(&mut bytes).map_err(|error| {
            if error.kind() != std::io::ErrorKind::UnexpectedEof {
                return FormatError::io(&self.path, "read", error);
            }
            let what = format!("frame {} of {} is cut off", self.read, self.frames);
            FormatError::corrupt(&self.path, what, "copy the file again from its source")
        })?;
        let big = self.big_endian;
        let mut values = match self.kind {
            Kind::U8 => Values::U8(bytes),
            Kind::U16 => {
                let (pairs, _) = bytes.as_chunks::<2>();
                let one = |b: &[u8; 2]| if big { u16::from_be_bytes(*b) } else { u16::from_le_bytes(*b) };
                Values::U16(pairs.iter().map(one).collect())
            }
            Kind::F16 => {
                let (pairs, _) = bytes.as_chunks::<2>();
                let bits = |b: &[u8; 2]| if big { u16::from_be_bytes(*b) } else { u16::from_le_bytes(*b) };
                Values::F32(pairs.iter().map(|b| f16::from_bits(bits(b)).to_f32()).collect())
            }
            Kind::F64 => {
                let (eights, _) = bytes.as_chunks::<8>();
                let one = |b: &[u8; 8]| if big { f64::from_be_bytes(*b) } else { f64::from_le_bytes(*b) };
                Values::F32(eights.iter().map(|b| one(b) as f32).collect())
            }
            Kind::F32 => {
                let (fours, _) = bytes.as_chunks::<4>();
                let one = |b: &[u8; 4]| if big { f32::from_be_bytes(*b) } else { f32::from_le_bytes(*b) };
                Values::F32(fours.iter().map(one).collect())
            }
        };
        self.read += 1;
        let mut channels = self.channels;
        if channels == 4 {
            values = values.without_alpha();
            channels = 3;
        }
        Ok(Some(Picture { width: self.width, height: self.height, channels, values }))
    }
}
