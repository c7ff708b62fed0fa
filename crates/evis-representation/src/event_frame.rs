//! Sums of polarities.

use crate::array::Array;
use crate::error::Error;
use crate::slice::Slice;

/// The event frame: per pixel, ON events minus OFF events, shape (height, width).
///
/// The image of event polarities in the survey of D. Gehrig, A. Loquercio, K. G. Derpanis, D. Scaramuzza, "End-to-end
/// learning of representations for asynchronous event-based data", ICCV 2019, table 1, after H. Rebecq, T. Horstschaefer,
/// D. Scaramuzza, "Real-time visual-inertial odometry for event cameras using keyframe-based nonlinear optimization", BMVC
/// 2017, without its motion compensation.
///
/// # Errors
/// See [`Error`]: an event that cannot be used, an array too large.
pub fn event_frame(slice: &Slice<'_>) -> Result<Array<i32>, Error> {
    let width = slice.width();
    let mut frame = Array::zeros(&[slice.height(), width])?;
    let sums = frame.data.as_mut_slice();
    slice.blocks(|block| {
        for event in block {
            let pixel = usize::from(event.y) * width + usize::from(event.x);
            sums[pixel] += if event.p > 0 { 1 } else { -1 };
        }
    })?;
    Ok(frame)
}
