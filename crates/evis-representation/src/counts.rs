//! Numbers of events.

use crate::array::Array;
use crate::error::Error;
use crate::slice::{Slice, plane};

/// Events per polarity and pixel, shape (2, height, width), OFF first.
///
/// A. Z. Zhu, L. Yuan, K. Chaney, K. Daniilidis, "EV-FlowNet: self-supervised optical flow estimation for event-based
/// cameras", RSS 2018; A. I. Maqueda et al., "Event-based vision meets deep learning on steering prediction for
/// self-driving cars", CVPR 2018. It is tonic's `ToImage`, and `ToFrame` of one window.
///
/// # Errors
/// See [`Error`]: an event that cannot be used, an array too large.
pub fn counts(slice: &Slice<'_>) -> Result<Array<i32>, Error> {
    let (width, pixels) = (slice.width(), slice.pixels());
    let mut counts = Array::zeros(&[2, slice.height(), width])?;
    let numbers = counts.data.as_mut_slice();
    slice.blocks(|block| {
        for event in block {
            let pixel = usize::from(event.y) * width + usize::from(event.x);
            numbers[plane(event) * pixels + pixel] += 1;
        }
    })?;
    Ok(counts)
}
