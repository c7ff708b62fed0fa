//! Binary frames, and numbers whose bits they are.

use crate::array::Array;
use crate::error::Error;
use crate::slice::{Slice, plane};

/// Most bits of a frame: what a float32 holds exactly.
pub const MOST_BITS: usize = 24;

/// Whether a polarity of a pixel fired in each of `bins` equal parts of time: 1 or 0, shape (bins, 2, height, width), OFF
/// first.
///
/// Part b is [t0 + b d, t0 + (b + 1) d) with d = (t1 - t0) / bins; t0 and t1 are the interval's limits where it has any, else
/// the first event's time and a microsecond after the last one's.
///
/// S. Barchid, J. Mennesson, C. Djéraba, "Bina-Rep event frames: a simple and effective representation for event-based
/// cameras", ICIP 2022.
///
/// # Errors
/// See [`Error`]: no bins, an event that cannot be used, an array too large.
pub fn binary_stack(slice: &Slice<'_>, bins: usize) -> Result<Array<u8>, Error> {
    if bins == 0 {
        return Err(Error::setting("bins", bins, "at least 1"));
    }
    let mut stack = Array::zeros(&[bins, 2, slice.height(), slice.width()])?;
    let plane = 2 * slice.pixels();
    for_each_part(slice, bins, |part, cell| stack.data[part * plane + cell] = 1)?;
    Ok(stack)
}

/// Bina-Rep: frames whose values are numbers of `bits` bits over 2^bits - 1, shape (frames, 2, height, width), OFF first.
///
/// The bits of frame f are parts f · bits to (f + 1) · bits - 1 of a [`binary_stack`] of frames · bits parts; the first of
/// them is the most significant one. It is tonic's `ToBinaRep`.
///
/// S. Barchid, J. Mennesson, C. Djéraba, ICIP 2022.
///
/// # Errors
/// See [`Error`]: no frames, bits that are not 1 to [`MOST_BITS`], an event that cannot be used, an array too large.
pub fn bina_rep(slice: &Slice<'_>, frames: usize, bits: usize) -> Result<Array<f32>, Error> {
    if frames == 0 {
        return Err(Error::setting("frames", frames, "at least 1"));
    }
    if !(1..=MOST_BITS).contains(&bits) {
        return Err(Error::setting("bits", bits, format!("between 1 and {MOST_BITS}")));
    }
    let shape = [frames, 2, slice.height(), slice.width()];
    let mut codes = Array::<u32>::zeros(&shape)?;
    let plane = 2 * slice.pixels();
    let parts = frames.checked_mul(bits).ok_or_else(|| Error::setting("frames", frames, "fewer"))?;
    for_each_part(slice, parts, |part, cell| {
        codes.data[part / bits * plane + cell] |= 1 << (bits - 1 - part % bits);
    })?;
    let most = ((1_u32 << bits) - 1) as f32;
    Ok(Array { shape: codes.shape, data: codes.data.iter().map(|code| *code as f32 / most).collect() })
}

/// Calls `mark` with the part of time and the cell, polarity and pixel, of each event.
fn for_each_part(slice: &Slice<'_>, parts: usize, mut mark: impl FnMut(usize, usize)) -> Result<(), Error> {
    let (width, pixels) = (slice.width(), slice.pixels());
    let (start_us, end_us) = slice.interval()?;
    // The first whole microsecond of a part, rounded up: parts are half-open, and events lie on whole ones.
    let first_us = |part: usize| {
        let (span, part, parts) = (i128::from(end_us - start_us), part as i128, parts as i128);
        i128::from(start_us) + (span * part + parts - 1) / parts
    };
    let (mut part, mut next_us) = (0, first_us(1));
    slice.blocks(|block| {
        for event in block {
            while i128::from(event.t) >= next_us && part + 1 < parts {
                part += 1;
                next_us = first_us(part + 1);
            }
            let pixel = usize::from(event.y) * width + usize::from(event.x);
            mark(part, plane(event) * pixels + pixel);
        }
    })
}
