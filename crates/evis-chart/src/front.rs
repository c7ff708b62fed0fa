//! What dominates what: the Pareto front of cost against error.

/// A setting's place: cost and error, both the lower the better.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Milliseconds of work per simulated second.
    pub cost: f64,
    /// Any error, 0 at best.
    pub error: f64,
}

/// Indices of `places` that no other one beats in both cost and error, by rising cost. Of equals the first counts;
/// what is not a number never does.
pub fn pareto(places: &[Place]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..places.len())
        .filter(|&i| places.get(i).is_some_and(|p| p.cost.is_finite() && p.error.is_finite()))
        .collect();
    order.sort_by(|&a, &b| {
        let (a, b) = (&places[a], &places[b]);
        a.cost.total_cmp(&b.cost).then(a.error.total_cmp(&b.error))
    });
    let mut best = f64::INFINITY;
    order.retain(|&i| {
        let better = places[i].error < best;
        best = best.min(places[i].error);
        better
    });
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    fn places(of: &[(f64, f64)]) -> Vec<Place> {
        of.iter().map(|&(cost, error)| Place { cost, error }).collect()
    }

    #[test]
    fn the_front_is_what_nothing_beats() {
        let all = places(&[(10.0, 0.1), (5.0, 0.5), (20.0, 0.2), (20.0, 0.01), (5.0, 0.6), (1.0, f64::NAN)]);
        assert_eq!(pareto(&all), [1, 0, 3]);
        assert_ne!(pareto(&all), [1, 0, 2], "canary: a beaten point is no part of it");
    }

    #[test]
    fn equals_count_once_and_nothing_has_no_front() {
        assert_eq!(pareto(&places(&[(3.0, 0.1), (3.0, 0.1), (4.0, 0.1)])), [0]);
        assert!(pareto(&[]).is_empty());
        assert!(pareto(&places(&[(f64::INFINITY, 0.1)])).is_empty());
    }
}
