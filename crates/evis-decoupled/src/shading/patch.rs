//! Light of a part of a facet as a polynomial: quadratic along either side of the part and in the block's time.

use glam::Vec4;

/// Values at the start, middle and end of either side tell a quadratic: so many nodes, row by row.
pub const NODES: usize = 9;
/// Where they are, as parts of a side.
pub const STEPS: [f64; 3] = [0.0, 0.5, 1.0];

/// Light of a part of a facet during a block.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    /// Its first (s, t).
    pub low: [f64; 2],
    /// 1 / its size along s and t.
    pub inverse: [f64; 2],
    /// Number of the first of its nodes: for what no shadow falls on and for each lamp that is kept apart those of a moment, or of the
    /// start, middle and end of the block.
    pub first: usize,
    /// How many of these.
    pub times: usize,
}

/// By how much values at [`STEPS`] count at `x`.
#[inline(always)]
pub fn weights(x: f32) -> [f32; 3] {
    [(1.0 - x) * (1.0 - 2.0 * x), 4.0 * x * (1.0 - x), x * (2.0 * x - 1.0)]
}

/// By how much nodes count at a place of the part, as parts of its sides.
#[inline(always)]
pub fn weights_at([x, y]: [f32; 2]) -> [f32; NODES] {
    let (across, down) = (weights(x), weights(y));
    std::array::from_fn(|k| across[k % 3] * down[k / 3])
}

/// The polynomial's value where nodes count by `weights`.
#[inline(always)]
pub fn value(nodes: &[Vec4; NODES], weights: &[f32; NODES]) -> Vec4 {
    let mut sum = nodes[0] * weights[0];
    for (node, weight) in nodes[1..].iter().zip(&weights[1..]) {
        sum += *node * *weight;
    }
    sum
}

/// Nodes at part `u` of the block, of those at [`STEPS`] of it.
#[inline(always)]
pub fn nodes_at(times: &[[Vec4; NODES]; 3], u: f32) -> [Vec4; NODES] {
    let [a, b, c] = weights(u);
    std::array::from_fn(|k| times[0][k] * a + times[1][k] * b + times[2][k] * c)
}

/// Values between which the polynomial stays: those of its Bernstein coefficients.
pub fn range(times: &[[Vec4; NODES]]) -> [Vec4; 2] {
    let of_rows = |nodes: &[Vec4; NODES]| {
        let mut rows = *nodes;
        for row in 0..3 {
            rows[3 * row + 1] = between(rows[3 * row], rows[3 * row + 1], rows[3 * row + 2]);
        }
        for column in 0..3 {
            rows[3 + column] = between(rows[column], rows[3 + column], rows[6 + column]);
        }
        rows
    };
    let mut all = [[Vec4::ZERO; NODES]; 3];
    for (own, nodes) in all.iter_mut().zip(times) {
        *own = of_rows(nodes);
    }
    if times.len() == 3 {
        all[1] = std::array::from_fn(|k| between(all[0][k], all[1][k], all[2][k]));
    }
    let coefficients = all[..times.len().min(3)].as_flattened();
    [Vec4::min, Vec4::max].map(|of| coefficients.iter().copied().reduce(of).unwrap_or_default())
}

/// The coefficient between those of both ends of a quadratic with these values at [`STEPS`].
fn between(start: Vec4, middle: Vec4, end: Vec4) -> Vec4 {
    middle * 2.0 - (start + end) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::numbers;

    #[test]
    fn a_patch_is_a_quadratic_along_its_sides_and_in_time_and_stays_in_its_range() {
        let mut next = numbers(3);
        let mut near = 0;
        for _ in 0..200 {
            // Coefficients of x^i y^j u^k.
            let powers: [[[Vec4; 3]; 3]; 3] = std::array::from_fn(|_| {
                std::array::from_fn(|_| {
                    std::array::from_fn(|_| Vec4::from_array([0; 4].map(|_| next() as f32 - 0.5)))
                })
            });
            let exact = |x: f32, y: f32, u: f32| {
                let mut sum = Vec4::ZERO;
                for (i, by_y) in powers.iter().enumerate() {
                    for (j, by_u) in by_y.iter().enumerate() {
                        for (k, power) in by_u.iter().enumerate() {
                            sum += *power * x.powi(i as i32) * y.powi(j as i32) * u.powi(k as i32);
                        }
                    }
                }
                sum
            };
            let step = STEPS.map(|step| step as f32);
            let times: [[Vec4; NODES]; 3] =
                step.map(|u| std::array::from_fn(|k| exact(step[k % 3], step[k / 3], u)));
            let [low, high] = range(&times);
            let [mut least, mut most] = [Vec4::INFINITY, Vec4::NEG_INFINITY];
            for _ in 0..50 {
                let [x, y, u] = [next(), next(), next()].map(|v| v as f32);
                let found = value(&nodes_at(&times, u), &weights_at([x, y]));
                let wanted = exact(x, y, u);
                assert!((found - wanted).abs().max_element() < 1e-4, "{found} {wanted} at {x} {y} {u}");
                assert!(found.cmpge(low - 1e-4).all() && found.cmple(high + 1e-4).all());
                (least, most) = (least.min(found), most.max(found));
            }
            near += usize::from(((high - low) / (most - least)).max_element() < 4.0);
            assert!(range(&times[..1])[1].cmple(high + 1e-4).all(), "that of its start lies within");
        }
        assert!(near > 100, "ranges are near in {near} of 200");
    }
}
