//! Time surfaces: how long ago each pixel fired.

use evis_core::event::MOST_T_US;

use crate::array::Array;
use crate::error::Error;
use crate::slice::{Slice, plane};

/// How a time surface falls with the age of a pixel's last event.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Decay {
    /// exp(-age / tau).
    #[default]
    Exponential,
    /// max(0, 1 - age / tau).
    Linear,
}

impl Decay {
    /// Of a pixel that fired `age_us` microseconds ago.
    pub fn value(self, age_us: f64, tau_us: f64) -> f64 {
        match self {
            Self::Exponential => (-age_us / tau_us).exp(),
            Self::Linear => (1.0 - age_us / tau_us).max(0.0),
        }
    }
}

/// When a pixel fired last; no event has a time this far from 0.
const NEVER: i64 = i64::MIN;

/// Time surfaces at the times `at_us`, which ascend, shape (times, 2, height, width), OFF first: 1 where a pixel fires at that
/// very time, less the longer ago its last event of the polarity is, 0 where it has had none. Events after a time do not count
/// in its surface; what is before the interval's start counts in none.
///
/// X. Lagorce, G. Orchard, F. Galluppi, B. E. Shi, R. Benosman, "HOTS: a hierarchy of event-based time-surfaces for pattern
/// recognition", TPAMI 2017, over the whole sensor. Linear decay: S. Afshar, T. J. Hamilton, J. Tapson,
/// A. van Schaik, G. Cohen, "Investigation of event-based surfaces for high-speed detection, unsupervised feature extraction,
/// and object recognition", Frontiers in Neuroscience 12, 2019. tonic's `ToTimesurface` counts events before a time, and not
/// those at it.
///
/// # Errors
/// See [`Error`]: a `tau_us` that is not above 0, times that do not ascend, an event that cannot be used, an array too large.
pub fn time_surfaces(
    slice: &Slice<'_>,
    at_us: &[i64],
    tau_us: f64,
    decay: Decay,
) -> Result<Array<f32>, Error> {
    if !(tau_us.is_finite() && tau_us > 0.0) {
        return Err(Error::setting("tau_us", tau_us, "a finite number of microseconds above 0"));
    }
    for (index, at) in at_us.iter().enumerate() {
        if at.unsigned_abs() > MOST_T_US.unsigned_abs() {
            return Err(Error::setting("at_us", at, format!("within {MOST_T_US} us of 0")));
        }
        if index > 0 && *at <= at_us[index - 1] {
            let remedy = format!("after the time before it, {} us", at_us[index - 1]);
            return Err(Error::setting("at_us", at, remedy));
        }
    }
    let (width, pixels) = (slice.width(), slice.pixels());
    let mut surfaces = Array::zeros(&[at_us.len(), 2, slice.height(), width])?;
    let mut last_us = Array::<i64>::zeros(&[2, slice.height(), width])?.data;
    last_us.fill(NEVER);
    let mut left = at_us.iter().copied().zip(surfaces.data.chunks_mut(2 * pixels)).peekable();
    let draw = |at: i64, surface: &mut [f32], last_us: &[i64]| {
        for (value, last) in surface.iter_mut().zip(last_us) {
            if *last != NEVER {
                *value = decay.value((at - last) as f64, tau_us) as f32;
            }
        }
    };
    slice.blocks(|block| {
        for event in block {
            while let Some((at, surface)) = left.next_if(|(at, _)| *at < event.t) {
                draw(at, surface, &last_us);
            }
            let pixel = usize::from(event.y) * width + usize::from(event.x);
            last_us[plane(event) * pixels + pixel] = event.t;
        }
    })?;
    for (at, surface) in left {
        draw(at, surface, &last_us);
    }
    Ok(surfaces)
}
