//! Sub-pixel sample patterns.
//!
//! Each pattern is a permutation lattice: sample `i` lies at `((i + 0.5) / n, (p(i) + 0.5) / n)`. Every row and
//! every column of the n x n grid holds one sample, so the centroid is exactly the pixel's centre and an
//! axis-aligned edge meets n equal steps; a regular sqrt(n) grid would give it only sqrt(n).

/// Offsets from the pixel's centre, in pixels, each within (-0.5, 0.5); their mean is zero.
pub fn offsets(n: u32) -> Vec<[f32; 2]> {
    let order = if n <= 8 { best_permutation(n) } else { best_korobov(n) };
    let at = |k: u32| ((f64::from(k) + 0.5) / f64::from(n) - 0.5) as f32;
    order.iter().enumerate().map(|(i, &k)| [at(i as u32), at(k)]).collect()
}

/// Squared smallest distance between two samples, in cells, where opposite pixel edges are joined.
fn spread(order: &[u32]) -> u32 {
    let n = order.len() as u32;
    let wrap = |a: u32, b: u32| a.abs_diff(b).min(n - a.abs_diff(b));
    let mut best = u32::MAX;
    for i in 0..order.len() {
        for j in i + 1..order.len() {
            let (dx, dy) = (wrap(i as u32, j as u32), wrap(order[i], order[j]));
            best = best.min(dx * dx + dy * dy);
        }
    }
    best
}

/// Whether the samples lie on one line of slope +-1, where a diagonal edge would meet one step only.
fn collinear(order: &[u32]) -> bool {
    let n = order.len() as u32;
    n > 2
        && (order.windows(2).all(|w| (w[0] + 1) % n == w[1])
            || order.windows(2).all(|w| (w[1] + 1) % n == w[0]))
}

fn best_permutation(n: u32) -> Vec<u32> {
    let mut order: Vec<u32> = (0..n).collect();
    let mut best = order.clone();
    let mut best_spread = 0;
    permute(&mut order, 0, &mut |candidate| {
        let spread = spread(candidate);
        if !collinear(candidate) && spread > best_spread {
            best_spread = spread;
            best = candidate.to_vec();
        }
    });
    best
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

fn best_korobov(n: u32) -> Vec<u32> {
    let gcd = |mut a: u32, mut b: u32| {
        while b != 0 {
            (a, b) = (b, a % b);
        }
        a
    };
    let lattice = |g: u32| (0..n).map(|i| i * g % n).collect::<Vec<_>>();
    (2..n)
        .filter(|&g| gcd(g, n) == 1)
        .map(lattice)
        .max_by_key(|order| spread(order))
        .unwrap_or_else(|| (0..n).collect())
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
    fn four_samples_are_no_grid_and_no_diagonal() {
        let offsets = offsets(4);
        let mut diagonal: Vec<_> = offsets.iter().map(|o| ((o[0] + o[1]) * 8.0).round() as i32).collect();
        diagonal.sort_unstable();
        diagonal.dedup();
        assert!(diagonal.len() >= 3, "{offsets:?}");
    }
}
