//! Which pixels of an image a tile has.

/// Row-major numbers, within the image, of a tile's pixels. All randomness is drawn by them, so that how an image is cut
/// into tiles changes nothing.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Numbering {
    first: u32,
    /// A row has `1 << shift` pixels.
    shift: u32,
    /// From one row to the next.
    stride: u32,
}

impl Numbering {
    /// Consecutive pixels from `first` on.
    pub const fn run(first: usize) -> Self {
        Self { first: first as u32, shift: 31, stride: 0 }
    }

    /// Rows of eight pixels from `first` on, in an image whose rows have `width`.
    pub const fn square(first: u32, width: u32) -> Self {
        Self { first, shift: 3, stride: width }
    }

    /// Number of the tile's pixel `i`.
    #[inline(always)]
    pub const fn of(self, i: u32) -> u32 {
        let row = (i >> self.shift).wrapping_mul(self.stride);
        self.first.wrapping_add(row).wrapping_add(i & ((1 << self.shift) - 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_number_the_pixels_of_their_image() {
        let run = Numbering::run(70);
        assert_eq!([0, 1, 5000].map(|i| run.of(i)), [70, 71, 5070]);
        let square = Numbering::square(2 * 346 + 8, 346);
        assert_eq!([0, 7, 8, 63].map(|i| square.of(i)), [700, 707, 700 + 346, 707 + 7 * 346]);
    }
}
