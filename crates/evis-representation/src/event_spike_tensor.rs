//! The event spike tensor.

use crate::array::Array;
use crate::error::Error;
use crate::scatter::{scatter, sign};
use crate::slice::Slice;

/// What an event is worth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Measure {
    /// Its time, from 0 to 1, as in the paper's code.
    #[default]
    Time,
    /// 1.
    Count,
    /// 1 for ON, -1 for OFF.
    Polarity,
}

/// The event spike tensor (EST) with its trilinear kernel, shape (2, bins, height, width), OFF first.
///
/// V(p, b, y, x) is the sum of f · max(0, 1 - |t* (bins - 1) - b|) over the events of polarity p at pixel (x, y), with
/// t* = (t - t0) / (t1 - t0) and f by `measure`. t0 and t1 are the interval's limits where it has any, else the times of the
/// first and the last event. Reshaped to (2 · bins, height, width) it is the published code's order of channels; that code
/// divides times by the last one, which is t0 = 0.
///
/// D. Gehrig, A. Loquercio, K. G. Derpanis, D. Scaramuzza, "End-to-end learning of representations for asynchronous
/// event-based data", ICCV 2019. The kernel is the one that the paper's learned kernel starts from.
///
/// # Errors
/// See [`Error`]: less than two bins, an event that cannot be used, an array too large.
pub fn event_spike_tensor(slice: &Slice<'_>, bins: usize, measure: Measure) -> Result<Array<f32>, Error> {
    if bins < 2 {
        return Err(Error::setting(
            "bins",
            bins,
            "at least 2: the kernel is as wide as the distance of two bins",
        ));
    }
    let mut tensor = Array::zeros(&[2, bins, slice.height(), slice.width()])?;
    let share = 1.0 / (bins - 1) as f64;
    let grid = tensor.data.as_mut_slice();
    match measure {
        Measure::Time => scatter::<true>(slice, bins, grid, |place, _| (place * share) as f32),
        Measure::Count => scatter::<true>(slice, bins, grid, |_, _| 1.0),
        Measure::Polarity => scatter::<true>(slice, bins, grid, |_, plane| sign(plane)),
    }?;
    Ok(tensor)
}
