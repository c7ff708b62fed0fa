//! Twin of `adaptive/audit.wgsl`.

use crate::world::tiles::TILE;

/// Fixed point of an excursion; `adaptive/audit.wgsl` has the same constant.
pub const SCALE: f32 = 65536.0;

/// Bits of the pixel below it.
pub const PIXEL_BITS: u32 = 8;

/// The largest excursion, in fixed point.
const MOST: f32 = 16_777_215.0;

/// The largest excursion of a tile's log luminance beyond the interval between the samples before and after it, and the pixel:
/// as the shader packs them. `luminance(layer, x, y)`: at the instant, before, after, within the tile of `size` pixels.
pub fn change(size: [u32; 2], offset: f32, luminance: impl Fn(usize, u32, u32) -> f32) -> u32 {
    let mut most = 0;
    for (x, y) in (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (x, y))) {
        let at = |layer| (luminance(layer, x, y).max(0.0) + offset).ln();
        let (now, before, after) = (at(0), at(1), at(2));
        let beyond = (now - before.max(after)).max(before.min(after) - now);
        let fixed = (beyond * SCALE).clamp(0.0, MOST) as u32;
        most = most.max(fixed << PIXEL_BITS | (y * TILE + x));
    }
    most
}

/// The excursion, in log luminance, and the pixel within the tile.
pub fn unpack(change: u32) -> (f32, [u32; 2]) {
    let pixel = change & ((1 << PIXEL_BITS) - 1);
    ((change >> PIXEL_BITS) as f32 / SCALE, [pixel % TILE, pixel / TILE])
}
