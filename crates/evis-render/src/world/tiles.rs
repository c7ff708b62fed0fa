//! The tiles of a picture: squares that have a sampling rate of their own.

use std::ops::Range;

use crate::world::image_bounds::Rect;

/// Pixels along a tile's side; `common/tile.wgsl` has the same constant.
pub const TILE: u32 = 16;

/// Tiles along `pixels`.
pub const fn tiles_along(pixels: u32) -> u32 {
    pixels.div_ceil(TILE)
}

/// Tiles of a picture of so many pixels.
pub const fn tile_count((width, height): (u32, u32)) -> usize {
    (tiles_along(width) * tiles_along(height)) as usize
}

/// The tile of a picture, `width` pixels wide, that holds the pixel at (`x`, `y`).
pub const fn tile_at(width: u32, x: u32, y: u32) -> usize {
    (y / TILE * tiles_along(width) + x / TILE) as usize
}

/// Which of `count` tiles in a row or column are touched by what lies from `low` to `high`, which are infinite and in reverse
/// where nothing does.
pub fn tile_range(low: f64, high: f64, count: u32) -> Range<u32> {
    let (tile, count) = (f64::from(TILE), f64::from(count));
    let from = (low / tile).floor().clamp(0.0, count);
    let to = (high / tile).floor().clamp(-1.0, count - 1.0) + 1.0;
    from as u32..to as u32
}

/// Rectangles that hold all squares of `side` pixels for which `active` is true and few others. `cost` is what drawing
/// one takes, in pixels.
pub fn rects(
    active: impl Fn(u32, u32) -> bool,
    side: u32,
    (width, height): (u32, u32),
    cost: impl Fn(&Rect) -> f64,
) -> Vec<Rect> {
    let (columns, rows) = (width.div_ceil(side), height.div_ceil(side));
    let mut open: Vec<[u32; 3]> = Vec::new();
    let mut found: Vec<[u32; 4]> = Vec::new();
    for y in 0..=rows {
        let mut runs: Vec<[u32; 2]> = Vec::new();
        for x in (0..columns).filter(|&x| y < rows && active(x, y)) {
            match runs.last_mut() {
                Some(run) if run[1] == x => run[1] += 1,
                _ => runs.push([x, x + 1]),
            }
        }
        // A run that goes on below makes its rectangle higher.
        let mut next = Vec::new();
        for [from, to, since] in open {
            match runs.iter().position(|run| *run == [from, to]) {
                Some(i) => {
                    runs.swap_remove(i);
                    next.push([from, to, since]);
                }
                None => found.push([from, since, to, y]),
            }
        }
        next.extend(runs.into_iter().map(|[from, to]| [from, to, y]));
        open = next;
    }
    let rect = |[x0, y0, x1, y1]: [u32; 4]| Rect {
        low: [x0 * side, y0 * side],
        high: [(x1 * side).min(width), (y1 * side).min(height)],
    };
    let mut all: Vec<(Rect, f64)> = Vec::new();
    for tiles in found {
        let mut now = rect(tiles);
        let mut own = cost(&now);
        // Joins with whatever is cheaper drawn together.
        while let Some((i, joined, price)) = all.iter().enumerate().find_map(|(i, (other, theirs))| {
            let joined = now.join(other);
            let price = cost(&joined);
            (price <= own + theirs).then_some((i, joined, price))
        }) {
            all.swap_remove(i);
            (now, own) = (joined, price);
        }
        all.push((now, own));
    }
    all.into_iter().map(|(rect, _)| rect).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rectangles_hold_what_is_active_and_join_where_that_is_cheaper() {
        // An L, and a tile apart.
        let active = |x: u32, y: u32| matches!((x, y), (0, 0..=3) | (1..=2, 3) | (5, 0));
        let exact = |rect: &Rect| rect.pixels() as f64 + 1e-3;
        let apart = rects(active, TILE, (90, 60), exact);
        assert_eq!(apart.iter().map(Rect::pixels).sum::<u64>(), 16 * 16 * 3 + 3 * 16 * 12 + 10 * 16);
        let cover = |rects: &[Rect], x: u32, y: u32| {
            rects.iter().any(|r| r.low[0] <= x && x < r.high[0] && r.low[1] <= y && y < r.high[1])
        };
        for (x, y) in (0..6).flat_map(|x| (0..4).map(move |y| (x, y))) {
            assert_eq!(cover(&apart, x * TILE, y * TILE), active(x, y), "{x} {y}");
        }
        let joined = rects(active, TILE, (90, 60), |rect| rect.pixels() as f64 + 1e6);
        assert_eq!(joined, [Rect::whole(90, 60)]);
    }
}
