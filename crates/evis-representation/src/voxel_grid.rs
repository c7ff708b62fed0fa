//! Voxel grids: bilinear in time.

use crate::array::Array;
use crate::error::Error;
use crate::slice::{Clock, Slice};

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
    let (width, pixels) = (slice.width(), slice.pixels());
    let split = polarities == Polarities::Split;
    let shape = [2, bins, slice.height(), width];
    let mut grid = Array::zeros(if split { &shape } else { &shape[1..] })?;
    let clock = Clock::new(slice, bins - 1)?;
    // What an event is worth, and where its polarity's part begins.
    let (off, on) = if split { ((1.0, 0), (1.0, bins * pixels)) } else { ((-1.0, 0), (1.0, 0)) };
    let last = bins - 1;
    slice.blocks(|block| {
        for event in block {
            let (sign, from) = if event.p > 0 { on } else { off };
            let place = clock.at(event.t);
            let bin = place as u32 as usize;
            let later = (place - bin as f64) as f32;
            let voxel = from + bin * pixels + usize::from(event.y) * width + usize::from(event.x);
            grid.data[voxel] += sign * (1.0 - later);
            if bin < last {
                grid.data[voxel + pixels] += sign * later;
            }
        }
    })?;
    Ok(grid)
}

/// Shifts and scales the values that are not 0 to mean 0 and variance 1, as E2VID does with its voxel grids.
///
/// The variance is that of the values themselves (divided by their number). Where they are all alike, it is 0, and they are
/// shifted only; E2VID divides by it. H. Rebecq et al., TPAMI 2021, and the published code (`EventPreprocessor`).
pub fn normalize_nonzero(values: &mut [f32]) {
    let nonzero = || values.iter().map(|value| f64::from(*value)).filter(|value| *value != 0.0);
    let count = nonzero().count().max(1) as f64;
    let mean = nonzero().sum::<f64>() / count;
    let deviation = (nonzero().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt();
    let scale = if deviation > 0.0 { 1.0 / deviation } else { 1.0 };
    for value in values.iter_mut().filter(|value| **value != 0.0) {
        *value = ((f64::from(*value) - mean) * scale) as f32;
    }
}
