//! Sharing events between the two bins that are nearest in time: what voxel grids and event spike tensors have in common.

use crate::array::Array;
use crate::error::Error;
use crate::slice::{Clock, Slice};

/// Adds all events of `slice` to `grid`, `bins` planes of pixels, or twice as many, OFF first, where `SPLIT`. An event at
/// `place`, from 0 to bins - 1, adds `worth(place, on)` times its nearness to the bins before and after it.
pub(crate) fn scatter<const SPLIT: bool>(
    slice: &Slice<'_>,
    bins: usize,
    grid: &mut [f32],
    worth: impl Fn(f64, bool) -> f32,
) -> Result<(), Error> {
    let (width, pixels, last) = (slice.width(), slice.pixels(), bins - 1);
    let clock = Clock::new(slice, last)?;
    let share = |t_us: i64, on: bool| {
        let place = clock.at(t_us);
        let bin = place as u32 as usize;
        let later = (place - bin as f64) as f32;
        let worth = worth(place, on);
        (bin, [worth * (1.0 - later), worth * later])
    };
    // Of few events, each goes to its two planes. Of many, those between two bins meet in one array first, where both parts
    // of a pixel are side by side: half the memory is waited for. Both planes are then added once.
    if slice.len() < pixels * last / 4 {
        return slice.blocks(|block| {
            for event in block {
                let on = event.p > 0;
                let (bin, [before, after]) = share(event.t, on);
                let plane = bin + usize::from(SPLIT && on) * bins;
                let voxel = plane * pixels + usize::from(event.y) * width + usize::from(event.x);
                grid[voxel] += before;
                if bin < last {
                    grid[voxel + pixels] += after;
                }
            }
        });
    }
    let mut pairs = Array::<[f32; 2]>::zeros(&[if SPLIT { 2 } else { 1 }, pixels])?.data;
    let mut current = 0;
    slice.blocks(|block| {
        for event in block {
            let on = event.p > 0;
            let (bin, [before, after]) = share(event.t, on);
            if bin != current {
                add(&mut pairs, current, bins, pixels, grid);
                current = bin;
            }
            let from = usize::from(SPLIT && on) * pixels;
            let pair = &mut pairs[from + usize::from(event.y) * width + usize::from(event.x)];
            *pair = [pair[0] + before, pair[1] + after];
        }
    })?;
    add(&mut pairs, current, bins, pixels, grid);
    Ok(())
}

/// Adds what met between `bin` and the next one to their planes, and leaves zeros.
fn add(pairs: &mut [[f32; 2]], bin: usize, bins: usize, pixels: usize, grid: &mut [f32]) {
    for (polarity, pairs) in pairs.chunks_mut(pixels).enumerate() {
        let (before, after) = grid[(polarity * bins + bin) * pixels..].split_at_mut(pixels);
        if bin + 1 < bins {
            for ((pair, before), after) in pairs.iter_mut().zip(before).zip(after) {
                *before += pair[0];
                *after += pair[1];
                *pair = [0.0; 2];
            }
        } else {
            // Nothing is after the last one.
            for (pair, before) in pairs.iter_mut().zip(before) {
                *before += pair[0];
                *pair = [0.0; 2];
            }
        }
    }
}

/// 1 for ON and -1 for OFF, as arithmetic: polarities are random, and a branch on them is often guessed wrong.
pub(crate) fn sign(on: bool) -> f32 {
    2.0 * f32::from(u8::from(on)) - 1.0
}
