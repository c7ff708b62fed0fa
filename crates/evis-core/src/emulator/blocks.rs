//! Memory of pixels in whole blocks that begin at a cache line, so that no vector is split between two lines.

use std::ops::{Deref, DerefMut};

use super::frames::BLOCK;

/// A number for each pixel of some blocks.
#[derive(Clone, Debug, Default)]
pub(crate) struct Blocks<T>(Vec<Block<T>>);

#[derive(Clone, Debug)]
#[repr(C, align(64))]
struct Block<T>([T; BLOCK]);

impl<T: Copy> Blocks<T> {
    /// So many blocks of `value`.
    pub fn filled(value: T, blocks: usize) -> Self {
        Self(vec![Block([value; BLOCK]); blocks])
    }
}

impl<T> Blocks<T> {
    /// Numbers follow each other without a gap.
    const DENSE: () = assert!(size_of::<Block<T>>() == size_of::<[T; BLOCK]>());
}

impl<T> Deref for Blocks<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        let () = Self::DENSE;
        // SAFETY: these are all numbers of all blocks, which are dense.
        unsafe { std::slice::from_raw_parts(self.0.as_ptr().cast(), self.0.len() * BLOCK) }
    }
}

impl<T> DerefMut for Blocks<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        let () = Self::DENSE;
        // SAFETY: as above; nobody else has them.
        unsafe { std::slice::from_raw_parts_mut(self.0.as_mut_ptr().cast(), self.0.len() * BLOCK) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_begin_at_a_cache_line_and_have_no_gaps() {
        let mut blocks = Blocks::filled(7_u8, 3);
        assert_eq!((blocks.len(), blocks.as_ptr().addr() % 64), (3 * BLOCK, 0));
        blocks[BLOCK] = 8;
        let of: Vec<usize> = (0..blocks.len()).filter(|i| blocks[*i] != 7).collect();
        assert_eq!(of, [BLOCK]);
        assert!(Blocks::<f32>::filled(0.0, 0).is_empty());
        assert_eq!(Blocks::filled(0.0_f32, 2).as_ptr().addr() % 64, 0);
    }
}
