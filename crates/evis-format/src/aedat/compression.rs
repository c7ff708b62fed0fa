//! Compression of AEDAT 4.0's packets.

use std::io::Read;

/// Largest packet, unpacked: the size of a packet is 31 bits in the file, and none of iniVation's comes near.
pub(super) const MOST_PACKET: u64 = 256 << 20;

/// How packets are compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Compression {
    None,
    Lz4,
    Zstd,
}

impl Compression {
    /// Of the number in the header; levels do not matter to readers.
    pub const fn of(number: i32) -> Option<Self> {
        Some(match number {
            0 => Self::None,
            1 | 2 => Self::Lz4,
            3 | 4 => Self::Zstd,
            _ => return None,
        })
    }

    /// Unpacks `packed` into `unpacked`.
    pub fn unpack(self, packed: &[u8], unpacked: &mut Vec<u8>) -> Result<(), String> {
        unpacked.clear();
        let read = match self {
            Self::None => (&mut &packed[..]).take(MOST_PACKET).read_to_end(unpacked),
            Self::Lz4 => lz4_flex::frame::FrameDecoder::new(packed).take(MOST_PACKET).read_to_end(unpacked),
            Self::Zstd => rust_zstd::DecompressReader::new(packed).take(MOST_PACKET).read_to_end(unpacked),
        };
        read.map(|_| ()).map_err(|error| format!("a packet cannot be unpacked ({error})"))
    }

    /// `plain`, packed; files are written plain.
    #[cfg(test)]
    pub fn packed(self, plain: &[u8]) -> Vec<u8> {
        match self {
            Self::None => plain.to_vec(),
            Self::Lz4 => {
                use std::io::Write;
                let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
                encoder.write_all(plain).unwrap();
                encoder.finish().unwrap()
            }
            Self::Zstd => rust_zstd::compress_to_vec(plain),
        }
    }
}
