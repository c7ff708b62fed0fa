//! Sharing events between the two bins that are nearest in time: what voxel grids and event spike tensors have in common.

use crate::array::Array;
use crate::error::Error;
use crate::slice::{Clock, Slice, plane};

/// Adds all events of `slice` to `grid`, zeros in `bins` planes of pixels, or twice as many, OFF first, where `SPLIT`. An event at
/// `place`, from 0 to bins - 1, adds `worth(place, plane)` times its nearness to the bins before and after it.
pub(crate) fn scatter<const SPLIT: bool>(
    slice: &Slice<'_>,
    bins: usize,
    grid: &mut [f32],
    worth: impl Fn(f64, usize) -> f32,
) -> Result<(), Error> {
    let (width, pixels, last) = (slice.width(), slice.pixels(), bins - 1);
    let clock = Clock::new(slice, last)?;
    // Events of a time share its place: many fire in the same microsecond.
    let mut before = Moment { t_us: i64::MIN, place: 0.0, bin: 0, later: 0.0 };
    let mut moment = move |t_us: i64| {
        if t_us != before.t_us {
            before = Moment::at(&clock, t_us);
        }
        before
    };
    // Of few events, each goes to its two planes. Of many, those between two bins meet in one array first, where both parts
    // of a pixel are side by side: half the memory is waited for. A plane is written once, when time has passed it.
    if slice.len() < pixels * last / 4 {
        return slice.blocks(|block| {
            for event in block {
                let polarity = plane(event);
                let Moment { place, bin, later, .. } = moment(event.t);
                let worth = worth(place, polarity);
                let first = bin + usize::from(SPLIT) * polarity * bins;
                let voxel = first * pixels + usize::from(event.y) * width + usize::from(event.x);
                grid[voxel] += worth * (1.0 - later);
                if bin < last {
                    grid[voxel + pixels] += worth * later;
                }
            }
        });
    }
    let mut pairs = Array::<[f32; 2]>::zeros(&[if SPLIT { 2 } else { 1 }, pixels])?.data;
    let mut current = 0;
    slice.blocks(|block| {
        for event in block {
            let polarity = plane(event);
            let Moment { place, bin, later, .. } = moment(event.t);
            while current < bin {
                pass(&mut pairs, current, bins, pixels, grid);
                current += 1;
            }
            let worth = worth(place, polarity);
            let from = usize::from(SPLIT) * polarity * pixels;
            let pair = &mut pairs[from + usize::from(event.y) * width + usize::from(event.x)];
            *pair = [pair[0] + worth * (1.0 - later), pair[1] + worth * later];
        }
    })?;
    for bin in current..bins.min(current + 2) {
        pass(&mut pairs, bin, bins, pixels, grid);
    }
    Ok(())
}

/// A time, and where it lies among the bins.
#[derive(Clone, Copy)]
struct Moment {
    t_us: i64,
    /// From 0 to bins - 1.
    place: f64,
    /// The bin before it.
    bin: usize,
    /// How far it is past that bin.
    later: f32,
}

impl Moment {
    fn at(clock: &Clock, t_us: i64) -> Self {
        let place = clock.at(t_us);
        let bin = place as u32 as usize;
        Self { t_us, place, bin, later: (place - bin as f64) as f32 }
    }
}

/// Writes the plane of `bin`, to which nothing more comes, and takes along what belongs to the next one.
fn pass(pairs: &mut [[f32; 2]], bin: usize, bins: usize, pixels: usize, grid: &mut [f32]) {
    for (polarity, pairs) in pairs.chunks_mut(pixels).enumerate() {
        let plane = &mut grid[(polarity * bins + bin) * pixels..][..pixels];
        for (pair, voxel) in pairs.iter_mut().zip(plane) {
            *voxel = pair[0];
            *pair = [pair[1], 0.0];
        }
    }
}

/// 1 for ON and -1 for OFF, of the [`plane`] of a polarity. Bits, and no choice, for the same reason.
pub(crate) fn sign(plane: usize) -> f32 {
    f32::from_bits(1.0_f32.to_bits() | ((plane as u32 ^ 1) << 31))
}
