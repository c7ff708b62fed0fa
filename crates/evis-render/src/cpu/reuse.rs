//! Twin of `reuse/mean.wgsl`: mean light of a pixel around every corner of a keyframe's cells.

/// Last bits of a cell's key: the object's number.
const NUMBER_BITS: u32 = 0xff;

/// A keyframe's cells.
#[derive(Clone, Copy, Debug)]
pub struct Cells<'a> {
    /// Cells per row.
    pub width: usize,
    /// Light, row by row.
    pub lights: &'a [f32],
    /// Key: inverse depth and number.
    pub keys: &'a [u32],
}

impl Cells<'_> {
    /// The mean of the `side` x `side` cells around the upper left corner of cell (x, y); -1 where they show more than one
    /// surface: other objects, or depths that differ by more than the part `smooth`.
    pub fn mean_at(&self, x: usize, y: usize, side: usize, smooth: f32) -> f32 {
        let (half, height) = (side / 2, self.lights.len() / self.width);
        if x < half || y < half || x + half > self.width || y + half > height {
            return -1.0;
        }
        let cells =
            || (y - half..y + half).flat_map(|y| (x - half..x + half).map(move |x| y * self.width + x));
        let depth = |key: u32| f32::from_bits(key & !NUMBER_BITS);
        let first = self.keys[(y - half) * self.width + x - half];
        let one = |cell: usize| {
            let key = self.keys[cell];
            (key ^ first) & NUMBER_BITS == 0 && (depth(key) - depth(first)).abs() <= smooth * depth(first)
        };
        if depth(first) <= 0.0 || !cells().all(one) {
            return -1.0;
        }
        cells().fold(0.0, |sum, cell| sum + self.lights[cell]) / (side * side) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_that_shows_more_than_one_surface_has_no_mean() {
        let key = |number: u32, depth: f32| (depth.to_bits() & !NUMBER_BITS) | number;
        let lights: Vec<f32> = (0..16).map(|i| i as f32).collect();
        let mut keys = vec![key(3, 0.5); 16];
        let mean = |keys: &[u32], x, y| Cells { width: 4, lights: &lights, keys }.mean_at(x, y, 2, 0.02);
        assert_eq!(mean(&keys, 2, 1), (1.0 + 2.0 + 5.0 + 6.0) / 4.0);
        assert_eq!(mean(&keys, 0, 1), -1.0, "beyond the border");
        keys[5] = key(4, 0.5);
        assert_eq!(mean(&keys, 2, 1), -1.0, "another object");
        keys[5] = key(3, 0.505);
        assert_eq!(mean(&keys, 2, 1), 3.5, "a slanted surface");
        keys[5] = key(3, 0.53);
        assert_eq!(mean(&keys, 2, 1), -1.0, "another depth");
        keys.fill(0);
        assert_eq!(mean(&keys, 2, 1), -1.0, "the sky");
    }
}
