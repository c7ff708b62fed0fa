//! Distance between flow fields.

use serde::{Deserialize, Serialize};

use super::MetricError;

/// Endpoint errors of a flow field over the pixels where both sides are defined.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EndpointError {
    /// Pixels that were compared.
    pub pixels: u64,
    /// Mean distance in pixels.
    pub mean: f64,
    /// Median distance in pixels.
    pub median: f64,
    /// Share of pixels with a distance below 1 pixel.
    pub below_1px: f64,
    /// Below 3 pixels.
    pub below_3px: f64,
    /// Below 5 pixels.
    pub below_5px: f64,
}

/// Endpoint error of `flow` against `reference`, vectors in pixels, at the pixels where `mask` is true (everywhere
/// without a mask).
///
/// # Errors
/// Fields or a mask of different length, a mask that leaves nothing, and vectors that are not finite where they are
/// compared.
pub fn endpoint_error(
    flow: &[[f32; 2]],
    reference: &[[f32; 2]],
    mask: Option<&[bool]>,
) -> Result<EndpointError, MetricError> {
    let masked = mask.map_or(flow.len(), <[bool]>::len);
    if flow.len() != reference.len() || masked != flow.len() {
        return Err(MetricError::Image(format!(
            "the flow has {} pixels, the reference {}, the mask {masked}; give three of one size",
            flow.len(),
            reference.len()
        )));
    }
    let wanted = |i: &usize| mask.is_none_or(|m| m.get(*i).copied().unwrap_or(false));
    let mut distances = Vec::new();
    for (i, (a, b)) in flow.iter().zip(reference).enumerate().filter(|(i, _)| wanted(i)) {
        let distance = f64::from(a[0] - b[0]).hypot(f64::from(a[1] - b[1]));
        if !distance.is_finite() {
            return Err(MetricError::Image(format!(
                "pixel {i} (row by row) has flow {a:?} and reference {b:?}; mask out what is not finite"
            )));
        }
        distances.push(distance);
    }
    if distances.is_empty() {
        return Err(MetricError::Image(
            "no pixel of the flow is to be looked at; give a mask that keeps some".into(),
        ));
    }
    distances.sort_unstable_by(f64::total_cmp);
    let count = distances.len();
    let at = |i: usize| distances.get(i).copied().unwrap_or(f64::NAN);
    let below = |limit: f64| distances.partition_point(|d| *d < limit) as f64 / count as f64;
    Ok(EndpointError {
        pixels: count as u64,
        mean: distances.iter().sum::<f64>() / count as f64,
        median: (at((count - 1) / 2) + at(count / 2)) / 2.0,
        below_1px: below(1.0),
        below_3px: below(3.0),
        below_5px: below(5.0),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endpoint_errors_are_distances() {
        let reference = [[1.0, -1.0]; 4];
        let flow = [0.0, 2.0, 4.0, 6.0].map(|d: f32| [1.0 + 0.6 * d, -1.0 - 0.8 * d]);
        let error = endpoint_error(&flow, &reference, None).unwrap();
        assert!((error.mean - 3.0).abs() < 1e-6 && (error.median - 3.0).abs() < 1e-6, "{error:?}");
        assert_eq!((error.below_1px, error.below_3px, error.below_5px, error.pixels), (0.25, 0.5, 0.75, 4));
        // What the mask leaves out may be anything.
        let mut broken = flow;
        broken[3] = [f32::NAN, f32::INFINITY];
        let masked = endpoint_error(&broken, &reference, Some(&[true, true, true, false])).unwrap();
        assert!((masked.mean - 2.0).abs() < 1e-6 && masked.pixels == 3);
        assert!(endpoint_error(&broken, &reference, None).unwrap_err().to_string().contains("pixel 3"));
        assert!(endpoint_error(&flow, &reference, Some(&[false; 4])).is_err());
        assert!(
            endpoint_error(&flow, &reference, Some(&[true; 3])).unwrap_err().to_string().contains("mask 3")
        );
        assert!(
            endpoint_error(&flow, &reference[..3], None).is_err() && endpoint_error(&[], &[], None).is_err()
        );
    }
}
