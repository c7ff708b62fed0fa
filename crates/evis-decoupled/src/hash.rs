//! Hashes of short keys of numbers, for maps whose keys nobody chooses to collide.

use std::hash::{BuildHasherDefault, Hasher};

use evis_core::random::mix;

/// Of [`std::collections::HashMap`]s.
pub type Words = BuildHasherDefault<Mix>;

/// Mixes words by the finaliser of SplitMix64.
#[derive(Default)]
pub struct Mix(u64);

impl Hasher for Mix {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for chunk in bytes.chunks(8) {
            let mut word = [0; 8];
            word[..chunk.len()].copy_from_slice(chunk);
            self.write_u64(u64::from_le_bytes(word));
        }
    }

    fn write_u64(&mut self, word: u64) {
        self.0 = mix((self.0 ^ word).wrapping_add(0x9e37_79b9_7f4a_7c15));
    }

    fn write_u32(&mut self, word: u32) {
        self.write_u64(word.into());
    }
}
