//! Sub-pixel sample patterns.
//!
//! Each pattern is a permutation: sample `i` lies at `((i + 0.5) / n, (p(i) + 0.5) / n)`. Every row and every column
//! of the n x n grid holds one sample, so the centroid is exactly the pixel's centre and an axis-aligned edge meets
//! n equal steps; a regular sqrt(n) grid would give it only sqrt(n). Among the permutations the one is taken to which
//! edges of all other directions are nearly as kind. (A rank-1 lattice is not: sixteen samples on one meet an edge
//! along its own lines, 18 degrees off the axis, in four steps.)

use std::f64::consts::PI;

use bytemuck::{Pod, Zeroable};

/// Offsets from the pixel's centre, in pixels, each within (-0.5, 0.5); their mean is zero.
pub fn offsets(n: u32) -> Vec<[f32; 2]> {
    let mut order: Vec<u32> = (0..n).collect();
    let steps = EdgeSteps::new(n as usize);
    if n <= 6 {
        let mut best = (f64::INFINITY, order.clone());
        permute(&mut order, 0, &mut |candidate| {
            let error = steps.error(candidate);
            // A mirrored pattern is as good; rounding must not choose between them.
            if error < best.0 - 1e-9 {
                best = (error, candidate.to_vec());
            }
        });
        order = best.1;
    } else {
        order = lattice(n);
        steps.improve(&mut order);
    }
    order
        .iter()
        .enumerate()
        .map(|(i, &k)| [center(i, n as usize), center(k as usize, n as usize)])
        .map(|o| o.map(|v| v as f32))
        .collect()
}

/// Other offsets than `offsets`, as good and as many, with which an audit looks between them.
///
/// Mirrored, and moved by a quarter: one sample, or the grid of `--antialias edges`, is its own mirror image.
pub fn others(offsets: &[[f32; 2]]) -> Vec<[f32; 2]> {
    match offsets {
        [[x, y]] => vec![[x + 0.25, y + 0.25]],
        many => many.iter().map(|[x, y]| [-x, *y]).collect(),
    }
}

/// The part of a pixel's area by which a sample reads textures. `Share` in `common/frame.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Share {
    /// From the sample to the share's middle, in pixels.
    pub shift: [f32; 2],
    /// Width and height, in pixels.
    pub size: [f32; 2],
}

impl Share {
    /// The whole pixel, for a sample at its middle.
    pub const WHOLE: Self = Self { shift: [0.0; 2], size: [1.0; 2] };
}

/// Divides the pixel among samples at `places`, from its centre: a grid of equal cells that tile it, one for each.
///
/// What light is proportional to is averaged over the cell, not around the sample: so the samples of a pixel read all of
/// its area, and every part of it once. The cells are the columns into which samples fall by their x, as many as rows.
pub fn shares(places: &[[f32; 2]]) -> Vec<Share> {
    let [columns, rows] = grid(places.len());
    places
        .iter()
        .zip(cells(places))
        .map(|(place, [column, row])| {
            let middle = [center(column as usize, columns), center(row as usize, rows)];
            Share {
                shift: [0, 1].map(|axis| (middle[axis] - f64::from(place[axis])) as f32),
                size: [1.0 / columns as f32, 1.0 / rows as f32],
            }
        })
        .collect()
}

/// Columns and rows of the cells of `n` samples.
pub fn grid(n: usize) -> [usize; 2] {
    let rows = (1..=n).rev().find(|r| n.is_multiple_of(*r) && r * r <= n).unwrap_or(1);
    [n / rows, rows]
}

/// Per sample: column and row of its cell.
pub fn cells(places: &[[f32; 2]]) -> Vec<[u32; 2]> {
    let n = places.len();
    let [_, rows] = grid(n);
    let mut by_x: Vec<usize> = (0..n).collect();
    by_x.sort_by(|&a, &b| places[a][0].total_cmp(&places[b][0]));
    let mut cells = vec![[0, 0]; n];
    for (column, members) in by_x.chunks_exact_mut(rows).enumerate() {
        members.sort_by(|&a, &b| places[a][1].total_cmp(&places[b][1]));
        for (row, &i) in members.iter().enumerate() {
            cells[i] = [column as u32, row as u32];
        }
    }
    cells
}

/// Centre of cell `i` of `n`, from the pixel's centre.
fn center(i: usize, n: usize) -> f64 {
    (i as f64 + 0.5) / n as f64 - 0.5
}

/// A first guess: `i g mod n` with `g` near n over the golden ratio.
fn lattice(n: u32) -> Vec<u32> {
    let gcd = |mut a: u32, mut b: u32| {
        while b != 0 {
            (a, b) = (b, a % b);
        }
        a
    };
    let golden = (f64::from(n) * 0.618) as u32;
    let g = (golden..n).find(|&g| gcd(g, n) == 1).unwrap_or(1);
    (0..n).map(|i| i * g % n).collect()
}

/// How far edges of all directions step from where a pixel's area would put them.
struct EdgeSteps {
    n: usize,
    /// Per direction: its cosine and sine, and where an edge covers (j + 0.5) / n of a pixel, in pixels.
    directions: Vec<([f64; 2], Vec<f64>)>,
}

impl EdgeSteps {
    fn new(n: usize) -> Self {
        const DIRECTIONS: usize = 24;
        let directions = (0..DIRECTIONS)
            .map(|k| {
                let (sine, cosine) = (PI * (k as f64 + 0.5) / DIRECTIONS as f64).sin_cos();
                let places =
                    (0..n).map(|j| place_of_cover((j as f64 + 0.5) / n as f64, cosine, sine)).collect();
                ([cosine, sine], places)
            })
            .collect();
        Self { n, directions }
    }

    /// Mean square over directions and samples, in square pixels.
    fn error(&self, order: &[u32]) -> f64 {
        let mut sum = 0.0;
        let mut along = vec![0.0; self.n];
        for ([cosine, sine], places) in &self.directions {
            for (i, (slot, &k)) in along.iter_mut().zip(order).enumerate() {
                *slot = center(i, self.n) * cosine + center(k as usize, self.n) * sine;
            }
            along.sort_unstable_by(f64::total_cmp);
            sum += along.iter().zip(places).map(|(a, p)| (a - p) * (a - p)).sum::<f64>();
        }
        sum / (self.n * self.directions.len()) as f64
    }

    /// Swaps rows as long as that helps: the same swaps in every run.
    fn improve(&self, order: &mut [u32]) {
        // 50 ms at most; larger patterns are good enough sooner.
        let tries = 60_000 / self.n;
        let mut state = 1u64;
        let mut next = || {
            // Knuth, TAOCP volume 2, 3.3.4: the MMIX generator.
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize % self.n
        };
        let mut error = self.error(order);
        for _ in 0..tries {
            let (i, k) = (next(), next());
            order.swap(i, k);
            let swapped = self.error(order);
            if swapped <= error {
                error = swapped;
            } else {
                order.swap(i, k);
            }
        }
    }
}

/// Distance from a pixel's centre, along a direction, at which a straight edge has covered `cover` of the pixel.
fn place_of_cover(cover: f64, cosine: f64, sine: f64) -> f64 {
    let (a, b) = (cosine.abs().max(sine.abs()), cosine.abs().min(sine.abs()).max(1e-9));
    // The covered area grows quadratically over the corners, `b / 2a` of it each, and linearly between.
    let corner = 0.5 * b / a;
    let near = cover.min(1.0 - cover);
    let from_corner = if near < corner { (2.0 * a * b * near).sqrt() } else { 0.5 * b + a * near };
    let place = 0.5 * (a + b) - from_corner;
    if cover < 0.5 { -place } else { place }
}

fn permute(order: &mut [u32], from: usize, visit: &mut impl FnMut(&[u32])) {
    if from + 1 >= order.len() {
        visit(order);
        return;
    }
    for i in from..order.len() {
        order.swap(from, i);
        permute(order, from + 1, visit);
        order.swap(from, i);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn centroid_is_the_pixel_centre_and_columns_are_distinct() {
        for n in 1..=64 {
            let offsets = offsets(n);
            assert_eq!(offsets.len(), n as usize);
            for axis in 0..2 {
                let sum: f64 = offsets.iter().map(|o| f64::from(o[axis])).sum();
                assert!(sum.abs() < 1e-5, "n {n}: centroid off by {sum}");
                let mut column: Vec<_> = offsets.iter().map(|o| o[axis]).collect();
                column.sort_by(f32::total_cmp);
                assert!(column.windows(2).all(|w| (w[1] - w[0] - 1.0 / n as f32).abs() < 1e-6), "n {n}");
            }
            assert!(offsets.iter().flatten().all(|o| o.abs() < 0.5));
        }
    }

    #[test]
    fn shares_tile_the_pixel() {
        for n in 1..=64 {
            let places = offsets(n);
            let shares = shares(&places);
            let area: f64 = shares.iter().map(|s| f64::from(s.size[0] * s.size[1])).sum();
            assert!((area - 1.0).abs() < 1e-6, "n {n}: {area}");
            // Every point of a fine grid lies in one of them, and samples are not far from theirs.
            for at in (0..4096).map(|k| [center(k % 64, 64), center(k / 64, 64)]) {
                let inside = |(place, share): &(&[f32; 2], &Share)| {
                    (0..2).all(|axis| {
                        let middle = f64::from(place[axis] + share.shift[axis]);
                        let from = at[axis] - middle;
                        let half = 0.5 * f64::from(share.size[axis]);
                        (-half - 1e-6..half - 1e-6).contains(&from)
                    })
                };
                assert_eq!(places.iter().zip(&shares).filter(inside).count(), 1, "n {n}: {at:?}");
            }
            assert!(shares.iter().all(|s| s.shift[0].abs() <= 0.5 * s.size[0]), "n {n}");
        }
        assert_eq!(shares(&offsets(1)), [Share::WHOLE]);
    }

    #[test]
    fn cover_is_the_area_behind_an_edge() {
        for (cosine, sine) in
            [(1.0, 0.0), (0.8, 0.6), (-0.6, 0.8), (0.28, 0.96), (0.5f64.sqrt(), -(0.5f64.sqrt()))]
        {
            for cover in [0.01, 0.1, 0.3, 0.5, 0.77, 0.99] {
                let place = place_of_cover(cover, cosine, sine);
                let cell = |i: u32| (f64::from(i) + 0.5) / 400.0 - 0.5;
                let behind = (0..160_000).filter(|i| cell(i % 400) * cosine + cell(i / 400) * sine < place);
                let area = behind.count() as f64 / 160_000.0;
                assert!((area - cover).abs() < 4e-3, "{cosine} {sine}: {cover} {area}");
            }
        }
    }

    #[test]
    fn no_direction_is_bad() {
        // Root mean square of an edge's steps away from the area, times n: an axis-aligned edge has none.
        let worst = |order: &[u32]| {
            let steps = EdgeSteps::new(order.len());
            let one = |d: &([f64; 2], Vec<f64>)| EdgeSteps { n: order.len(), directions: vec![d.clone()] };
            steps
                .directions
                .iter()
                .map(|d| one(d).error(order).sqrt() * order.len() as f64)
                .fold(0.0, f64::max)
        };
        let order =
            |n: u32| -> Vec<u32> { offsets(n).iter().map(|o| ((o[1] + 0.5) * n as f32) as u32).collect() };
        for n in [4, 8, 16, 32] {
            let worst = worst(&order(n));
            assert!(worst < 0.9, "{n} samples: {worst}");
        }
        let lattice: Vec<u32> = (0..16).map(|i| i * 13 % 16).collect();
        assert!(worst(&lattice) > 1.4, "canary: a lattice has bad directions");
    }

    #[test]
    fn four_samples_are_no_grid_and_no_diagonal() {
        let offsets = offsets(4);
        let mut diagonal: Vec<_> = offsets.iter().map(|o| ((o[0] + o[1]) * 8.0).round() as i32).collect();
        diagonal.sort_unstable();
        diagonal.dedup();
        assert!(diagonal.len() >= 3, "{offsets:?}");
    }
}
