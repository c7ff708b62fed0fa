//! Which tiles of a picture a convex part of its image plane touches.

use std::ops::Range;

use crate::world::image_bounds::{Area, MARGIN_PX};
use crate::world::tiles::{TILE, tile_range};

/// Tiles, row by row.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Cover {
    first: u32,
    rows: Vec<Range<u32>>,
}

impl Cover {
    /// What `area`, with a border of [`MARGIN_PX`], touches in a picture of `columns` x `rows` tiles.
    pub fn of(area: &Area, columns: u32, rows: u32) -> Self {
        if area.is_nothing() {
            return Self::default();
        }
        let range = |axis: usize, count: u32| {
            tile_range(area.low[axis] - MARGIN_PX, area.high[axis] + MARGIN_PX, count)
        };
        let (across, down) = (range(0, columns), range(1, rows));
        Self { first: down.start, rows: down.map(|_| across.clone()).collect() }
    }

    /// What the hull of `points`, with a border of [`MARGIN_PX`] and `border_px`, touches in a picture of `columns` x `rows`
    /// tiles.
    pub fn new(points: Vec<[f64; 2]>, border_px: f64, columns: u32, rows: u32) -> Self {
        if border_px == f64::INFINITY {
            return Self { first: 0, rows: vec![0..columns; rows as usize] };
        }
        let margin_px = MARGIN_PX + border_px;
        let tile = f64::from(TILE);
        let tiles = |low: f64, high: f64, count: u32| tile_range(low - margin_px, high + margin_px, count);
        let (low, high) = ends(points.iter().map(|p| p[1]));
        let range = tiles(low, high, rows);
        let corners = hull(points);
        let edges = || corners.iter().zip(corners.iter().cycle().skip(1));
        let first = range.start;
        let rows = range.map(|row| {
            let upper = f64::from(row) * tile - margin_px;
            let lower = upper + tile + 2.0 * margin_px;
            // The ends of what of each edge lies in the row.
            let within = |(a, b): (&[f64; 2], &[f64; 2])| {
                if a[1].max(b[1]) < upper || lower < a[1].min(b[1]) {
                    return None;
                }
                let at = |y: f64| a[0] + ((y - a[1]) / (b[1] - a[1])).clamp(0.0, 1.0) * (b[0] - a[0]);
                Some(if a[1] == b[1] { [a[0], b[0]] } else { [at(upper), at(lower)] })
            };
            let (left, right) = ends(edges().filter_map(within).flatten());
            tiles(left, right, columns)
        });
        Self { first, rows: rows.collect() }
    }

    /// What is in both.
    pub fn meet(&self, other: &Self) -> Self {
        let first = self.first.max(other.first);
        let skipped = |cover: &Self| (first - cover.first) as usize;
        let pairs = self.rows.iter().skip(skipped(self)).zip(other.rows.iter().skip(skipped(other)));
        Self { first, rows: pairs.map(|(a, b)| a.start.max(b.start)..a.end.min(b.end)).collect() }
    }

    /// How many tiles it has.
    pub fn count(&self) -> usize {
        self.rows.iter().map(Range::len).sum()
    }

    /// Columns and rows of its tiles.
    pub fn tiles(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        (self.first..).zip(&self.rows).flat_map(|(y, row)| row.clone().map(move |x| (x, y)))
    }
}

fn ends(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
}

/// The corners of the hull of `points`, in order (A. M. Andrew, "Another efficient algorithm for convex hulls in two
/// dimensions", 1979).
fn hull(mut points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    points.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let chain = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let mut chain: Vec<[f64; 2]> = Vec::new();
        for p in points {
            while let [.., a, b] = chain[..]
                && (b[0] - a[0]) * (p[1] - a[1]) <= (b[1] - a[1]) * (p[0] - a[0])
            {
                chain.pop();
            }
            chain.push(p);
        }
        // The other chain begins with it.
        chain.pop();
        chain
    };
    let mut corners = chain(&mut points.iter().copied());
    corners.extend(chain(&mut points.iter().rev().copied()));
    corners
}
