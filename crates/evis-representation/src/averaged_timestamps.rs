//! Mean times of events.

use crate::array::Array;
use crate::error::Error;
use crate::slice::{Slice, plane};

/// The mean time of the events of each polarity and pixel, shape (2, height, width), OFF first: 0 at t0, 1 at t1, and
/// `empty` where there is none.
///
/// t0 and t1 are the interval's limits where it has any, else the times of the first and the last event. Sums are of whole
/// microseconds, and exact up to 2^53 of them.
///
/// A. Z. Zhu, L. Yuan, K. Chaney, K. Daniilidis, "Unsupervised event-based learning of optical flow, depth, and egomotion",
/// CVPR 2019: the image of average timestamps, of events that are not moved.
///
/// # Errors
/// See [`Error`]: an event that cannot be used, an array too large.
pub fn averaged_timestamps(slice: &Slice<'_>, empty: f32) -> Result<Array<f32>, Error> {
    let (width, pixels) = (slice.width(), slice.pixels());
    let shape = [2, slice.height(), width];
    let (start_us, end_us) = slice.span()?;
    let span_us = (end_us - start_us).max(1) as f64;
    let mut sums = Array::<(f64, u32)>::zeros(&shape)?;
    slice.blocks(|block| {
        for event in block {
            let pixel = usize::from(event.y) * width + usize::from(event.x);
            let (sum, count) = &mut sums.data[plane(event) * pixels + pixel];
            *count += 1;
            *sum += (event.t - start_us) as f64;
        }
    })?;
    let mean = |(sum, count): &(f64, u32)| match *count {
        0 => empty,
        count => (sum / f64::from(count) / span_us) as f32,
    };
    Ok(Array { shape: sums.shape, data: sums.data.iter().map(mean).collect() })
}
