//! Outlines of where a grid of values reaches a level.

use std::collections::HashMap;

use crate::hash::Words;

/// A closed polygon.
pub type Ring = Vec<[f64; 2]>;

/// Area of a polygon; positive to the left of a walker in a frame whose y leads up.
#[inline(always)]
pub fn area(corners: &[[f64; 2]]) -> f64 {
    let Some(&last) = corners.last() else { return 0.0 };
    let (mut area, mut a) = (0.0, last);
    for &b in corners {
        area += a[0] * b[1] - b[0] * a[1];
        a = b;
    }
    0.5 * area
}

/// Values at the crossings of grid lines.
pub struct Grid<'a> {
    /// Places of the lines across, and of the lines down; neighbours may be in one place.
    pub lines: [Vec<f64>; 2],
    /// The value where line `x` across and line `y` down cross.
    pub value: &'a dyn Fn(usize, usize) -> f64,
}

impl Grid<'_> {
    /// Rings around all in which the value reaches `level`, to the left of a walker in a frame whose y leads up; linear between
    /// neighbours (marching squares; where corners alone leave two ways, their mean decides). What lies at the border of the grid
    /// is below the level.
    pub fn rings(&self, level: f64) -> Vec<Ring> {
        let size = [self.lines[0].len(), self.lines[1].len()];
        // Edges of cells: two from each crossing, to the right and down.
        let edge = |x: usize, y: usize, down: usize| 2 * (y * size[0] + x) + down;
        let mut segments: Vec<(usize, usize)> = Vec::new();
        let row = |y: usize| -> Vec<f64> { (0..size[0]).map(|x| (self.value)(x, y) - level).collect() };
        let mut above = row(0);
        for y in 0..size[1].saturating_sub(1) {
            let below = row(y + 1);
            for x in 0..size[0].saturating_sub(1) {
                let corners = [above[x], above[x + 1], below[x + 1], below[x]];
                let bits = corners.iter().enumerate().fold(0, |m, (k, v)| m | u8::from(*v >= 0.0) << k);
                if bits == 0 || bits == 15 {
                    continue;
                }
                let [top, right, bottom, left] =
                    [edge(x, y, 0), edge(x + 1, y, 1), edge(x, y + 1, 0), edge(x, y, 1)];
                let joined = corners.iter().sum::<f64>() >= 0.0;
                let own: &[(usize, usize)] = match bits {
                    1 => &[(top, left)],
                    2 => &[(right, top)],
                    3 => &[(right, left)],
                    4 => &[(bottom, right)],
                    5 if joined => &[(top, right), (bottom, left)],
                    5 => &[(top, left), (bottom, right)],
                    6 => &[(bottom, top)],
                    7 => &[(bottom, left)],
                    8 => &[(left, bottom)],
                    9 => &[(top, bottom)],
                    10 if joined => &[(left, top), (right, bottom)],
                    10 => &[(right, top), (left, bottom)],
                    11 => &[(right, bottom)],
                    12 => &[(left, right)],
                    13 => &[(top, right)],
                    _ => &[(left, top)],
                };
                segments.extend_from_slice(own);
            }
            above = below;
        }
        let mut next: HashMap<usize, usize, Words> = segments.iter().copied().collect();
        let place = |edge: usize| {
            let (at, down) = (edge / 2, edge % 2);
            let from = [at % size[0], at / size[0]];
            let to = [from[0] + 1 - down, from[1] + down];
            let [a, b] = [from, to].map(|[x, y]| (self.value)(x, y) - level);
            let w = a / (a - b);
            [0, 1].map(|k| {
                let [p, q] = [from[k], to[k]].map(|line| self.lines[k][line]);
                p + w * (q - p)
            })
        };
        let mut rings = Vec::new();
        for (start, _) in segments {
            let mut ring = Ring::new();
            let mut at = start;
            while let Some(to) = next.remove(&at) {
                ring.push(place(at));
                at = to;
            }
            if ring.len() >= 3 {
                rings.push(ring);
            }
        }
        rings
    }
}

/// `ring` with fewer corners: none that is left out is farther than `tolerance` from what is left (U. Ramer, "An iterative
/// procedure for the polygonal approximation of plane curves", 1972). Those that are `kept` stay.
pub fn simplified(ring: &Ring, tolerance: f64, kept: &dyn Fn([f64; 2]) -> bool) -> Ring {
    let count = ring.len();
    let at = |k: usize| ring[k % count];
    let distance = |p: [f64; 2], q: [f64; 2]| (p[0] - q[0]).hypot(p[1] - q[1]);
    // Two corners that stay for sure: the lowest one, and that which is farthest from it.
    let first =
        (0..count).min_by(|a, b| ring[*a].partial_cmp(&ring[*b]).unwrap_or(std::cmp::Ordering::Equal));
    let first = first.unwrap_or(0);
    let far = (0..count).max_by(|a, b| {
        distance(at(first), ring[*a]).total_cmp(&distance(at(first), ring[*b])).then(b.cmp(a))
    });
    let far = (far.unwrap_or(0) + count - first) % count + first;
    let mut stays = vec![false; count];
    let mut open = vec![(first, far), (far, first + count)];
    stays[first] = true;
    stays[far % count] = true;
    while let Some((from, to)) = open.pop() {
        let (p, q) = (at(from), at(to));
        let length = distance(p, q);
        let off = |k: usize| {
            let r = at(k);
            if kept(r) {
                return f64::INFINITY;
            }
            let [x, y] = [r[0] - p[0], r[1] - p[1]];
            if length == 0.0 {
                return x.hypot(y);
            }
            ((q[0] - p[0]) * y - (q[1] - p[1]) * x).abs() / length
        };
        let worst =
            (from + 1..to).map(|k| (off(k), k)).fold((tolerance, 0), |a, b| if b.0 > a.0 { b } else { a });
        if worst.0 > tolerance {
            stays[worst.1 % count] = true;
            open.extend([(from, worst.1), (worst.1, to)]);
        }
    }
    (0..count).filter(|k| stays[*k]).map(|k| ring[k]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bilinear interpolant of `value` on whole numbers.
    fn between(value: &dyn Fn(usize, usize) -> f64, [x, y]: [f64; 2]) -> f64 {
        let [i, j] = [x, y].map(|v| v as usize);
        let [u, v] = [x - i as f64, y - j as f64];
        (1.0 - v) * ((1.0 - u) * value(i, j) + u * value(i + 1, j))
            + v * ((1.0 - u) * value(i, j + 1) + u * value(i + 1, j + 1))
    }

    #[test]
    fn rings_hold_the_area_where_the_level_is_reached() {
        for seed in 0..20_u64 {
            let value = |x: usize, y: usize| {
                if x == 0 || y == 0 || x == 20 || y == 16 {
                    return -1.0;
                }
                let word = evis_core::random::mix((seed << 32 | (x as u64) << 16 | y as u64) + 1);
                (word >> 11) as f64 / (1_u64 << 53) as f64
            };
            let lines = [21, 17].map(|n| (0..n).map(f64::from).collect());
            let grid = Grid { lines, value: &value };
            for level in [0.3, 0.5, 0.7] {
                let rings = grid.rings(level);
                let own: f64 = rings.iter().map(|r| area(r)).sum();
                let fine = 16;
                let inside = |k: usize| {
                    let at = [k % (20 * fine), k / (20 * fine)].map(|v| (v as f64 + 0.5) / fine as f64);
                    between(&value, at) >= level
                };
                let count = (0..20 * 16 * fine * fine).filter(|k| inside(*k)).count();
                let expected = count as f64 / (fine * fine) as f64;
                // Curves are chords in a cell; noise bends them as nothing else does.
                assert!((own - expected).abs() < 0.04 * 20.0 * 16.0, "{own} for {expected}");
                assert!(rings.len() > 3);
                for tolerance in [0.05, 0.5] {
                    let simple: Vec<Ring> =
                        rings.iter().map(|r| simplified(r, tolerance, &|_| false)).collect();
                    let corners = |rings: &[Ring]| rings.iter().map(Vec::len).sum::<usize>();
                    assert!(corners(&simple) < corners(&rings));
                    let off = |p: [f64; 2], ring: &Ring| {
                        let next = ring.iter().cycle().skip(1);
                        let to = |(a, b): (&[f64; 2], &[f64; 2])| {
                            let d = [b[0] - a[0], b[1] - a[1]];
                            let r = [p[0] - a[0], p[1] - a[1]];
                            let t = (r[0] * d[0] + r[1] * d[1]) / (d[0] * d[0] + d[1] * d[1]).max(1e-12);
                            let t = t.clamp(0.0, 1.0);
                            (r[0] - t * d[0]).hypot(r[1] - t * d[1])
                        };
                        ring.iter().zip(next).map(to).fold(f64::INFINITY, f64::min)
                    };
                    for (ring, simple) in rings.iter().zip(&simple) {
                        // A corner may lie beyond the end of the side that it is left out for.
                        assert!(ring.iter().all(|p| off(*p, simple) < 2.0 * tolerance + 0.1), "{tolerance}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_frame_has_an_outline_and_a_hole() {
        let value = |x: usize, y: usize| {
            let inside = (1..=5).contains(&x) && (1..=5).contains(&y) && !(x == 3 && y == 3);
            f64::from(inside)
        };
        let lines = [0, 1].map(|_| (0..7).map(f64::from).collect());
        let rings = Grid { lines, value: &value }.rings(0.5);
        let mut areas: Vec<f64> = rings.iter().map(|r| area(r)).collect();
        areas.sort_by(f64::total_cmp);
        assert_eq!(areas.len(), 2);
        assert!(areas[0] < 0.0 && areas[1] > 20.0, "{areas:?}");
    }
}
