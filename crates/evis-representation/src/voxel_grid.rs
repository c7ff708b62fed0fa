//! Voxel grids: bilinear in time.

use crate::array::Array;
use crate::error::Error;
use crate::scatter::{scatter, sign};
use crate::slice::Slice;

/// What becomes of polarities.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Polarities {
    /// ON events count as 1, OFF events as -1.
    #[default]
    Signed,
    /// Each polarity has a grid of its own, in which its events count as 1.
    Split,
}

/// The voxel grid of `bins` bins: each event is shared between the two bins that are nearest in time, by
/// max(0, 1 - |b - t*|) with t* = (bins - 1) (t - t0) / (t1 - t0).
///
/// t0 and t1 are the interval's limits where it has any, else the times of the first and the last event. The first bin is
/// at t0, the last at t1; a single instant is all in the first. Shape (bins, height, width), or
/// (2, bins, height, width), OFF first, with [`Polarities::Split`].
///
/// A. Z. Zhu, L. Yuan, K. Chaney, K. Daniilidis, "Unsupervised event-based learning of optical flow, depth, and egomotion",
/// CVPR 2019; as in H. Rebecq et al., "High speed and high dynamic range video with an event camera" (E2VID),
/// TPAMI 2021. The first B bins of B + 1 are those of tonic's `ToVoxelGrid` with B bins, which scales by B.
///
/// # Errors
/// See [`Error`]: no bins, an event that cannot be used, an array too large.
pub fn voxel_grid(slice: &Slice<'_>, bins: usize, polarities: Polarities) -> Result<Array<f32>, Error> {
    if bins == 0 {
        return Err(Error::setting("bins", bins, "at least 1"));
    }
    let shape = [2, bins, slice.height(), slice.width()];
    let mut grid = Array::zeros(if polarities == Polarities::Split { &shape } else { &shape[1..] })?;
    match polarities {
        Polarities::Signed => scatter::<false>(slice, bins, &mut grid.data, |_, plane| sign(plane)),
        Polarities::Split => scatter::<true>(slice, bins, &mut grid.data, |_, _| 1.0),
    }?;
    Ok(grid)
}

/// Shifts and scales the values that are not 0 to mean 0 and variance 1, as E2VID does with its voxel grids.
///
/// The variance is that of the values themselves (divided by their number). Where they are all alike, it is 0, and they are
/// shifted only; E2VID divides by it. H. Rebecq et al., TPAMI 2021, and the published code (`EventPreprocessor`).
pub fn normalize_nonzero(values: &mut [f32]) {
    let nonzero = |value: f32| f64::from(u8::from(value != 0.0));
    let count = sum(values, nonzero).max(1.0);
    let mean = sum(values, f64::from) / count;
    let square = |value: f32| (f64::from(value) - mean).powi(2) * nonzero(value);
    let deviation = (sum(values, square) / count).sqrt();
    let scale = if deviation > 0.0 { 1.0 / deviation } else { 1.0 };
    for value in values {
        let scaled = ((f64::from(*value) - mean) * scale) as f32;
        // A choice of values and not of ways, which the compiler vectorises.
        *value = if *value == 0.0 { 0.0 } else { scaled };
    }
}

/// The sum of `term` over all values, in parts that the compiler adds side by side.
fn sum(values: &[f32], term: impl Fn(f32) -> f64) -> f64 {
    let (blocks, rest) = values.as_chunks::<8>();
    let mut sums = [0.0; 8];
    for block in blocks {
        for (sum, value) in sums.iter_mut().zip(block) {
            *sum += term(*value);
        }
    }
    sums.iter().sum::<f64>() + rest.iter().map(|value| term(*value)).sum::<f64>()
}
