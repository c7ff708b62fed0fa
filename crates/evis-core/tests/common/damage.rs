//! Mutants of a file, the same ones in every run.

use std::path::{Path, PathBuf};

/// A folder that goes away with the test.
pub struct Folder(PathBuf);

impl Folder {
    pub fn new(test: &str) -> Self {
        let path = std::env::temp_dir().join(format!("evis-damage-{test}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub fn file(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Puts a new file in the place of `path`. Writing over the old one would wait for the disk each time.
pub fn replace(path: &Path, bytes: &[u8]) {
    let _ = std::fs::remove_file(path);
    std::fs::write(path, bytes).unwrap();
}

/// Numbers and types that readers trip over, put in place of what a file holds.
const TOKENS: [&[u8]; 12] = [
    b"0",
    b"-1",
    b"99999999999999",
    b"18446744073709551615",
    b"18446744073709551616",
    b"4294967296",
    b"1e308",
    b"|V99999999",
    b"<f8",
    b">i8",
    b"(3, 4)",
    b"''",
];

/// Makes mutants of a file: flipped bits, extreme bytes and words, parts cut out, doubled, zeroed or swapped, the end cut
/// off, and words of `marks` replaced.
pub struct Damage<'a> {
    state: u64,
    whole: &'a [u8],
    /// Where the marks are, with their lengths.
    marks: Vec<(usize, usize)>,
}

impl<'a> Damage<'a> {
    pub fn new(seed: u64, whole: &'a [u8], marks: &[&str]) -> Self {
        let marks = marks.iter().flat_map(|mark| {
            let places = whole.windows(mark.len()).enumerate();
            places.filter(|(_, w)| *w == mark.as_bytes()).map(|(at, _)| (at, mark.len()))
        });
        Self { state: seed, whole, marks: marks.collect() }
    }

    fn below(&mut self, limit: usize) -> usize {
        self.state =
            self.state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.state >> 33) as usize % limit.max(1)
    }

    /// A mutant with one to four changes.
    pub fn next(&mut self) -> Vec<u8> {
        let mut bytes = self.whole.to_vec();
        if !self.marks.is_empty() && self.below(3) == 0 {
            let mark = self.below(self.marks.len());
            let (at, length) = self.marks[mark];
            bytes.splice(at..at + length, TOKENS[self.below(TOKENS.len())].iter().copied());
        }
        for _ in 0..1 + self.below(3) {
            if bytes.is_empty() {
                break;
            }
            let at = self.below(bytes.len());
            let end = (at + 1 + self.below(16)).min(bytes.len());
            match self.below(9) {
                0 | 1 => bytes[at] ^= 1 << self.below(8),
                2 => bytes[at] = [0, 0x7f, 0x80, 0xff][self.below(4)],
                3 => bytes[at..end].fill([0, 0xff][self.below(2)]),
                4 => drop(bytes.drain(at..end)),
                5 => {
                    let part = bytes[at..end].to_vec();
                    bytes.splice(at..at, part);
                }
                6 => {
                    let other = self.below(bytes.len());
                    bytes.swap(at, other);
                }
                7 => bytes[at] = b"0123456789-.,(){}[]'|<>"[self.below(23)],
                _ if self.below(4) == 0 => bytes.truncate(at),
                _ => bytes[at] = self.below(256) as u8,
            }
        }
        bytes
    }
}
