//! The tiles of a picture: squares that have a sampling rate of their own.

use std::ops::Range;

/// Pixels along a tile's side; `common/tile.wgsl` has the same constant.
pub const TILE: u32 = 16;

/// Tiles along `pixels`.
pub const fn tiles_along(pixels: u32) -> u32 {
    pixels.div_ceil(TILE)
}

/// Which of `count` tiles in a row or column are touched by what lies from `low` to `high`, which are infinite and in reverse
/// where nothing does.
pub fn tile_range(low: f64, high: f64, count: u32) -> Range<u32> {
    let (tile, count) = (f64::from(TILE), f64::from(count));
    let from = (low / tile).floor().clamp(0.0, count);
    let to = (high / tile).floor().clamp(-1.0, count - 1.0) + 1.0;
    from as u32..to as u32
}
