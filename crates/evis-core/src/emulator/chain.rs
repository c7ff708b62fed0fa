//! The whole pixel: photoreceptor, thresholds of its own, noise, refractory period.
//!
//! A first pass ([`scan`]) over 64 pixels at a time computes each signal at the interval's end and finds the pixels that
//! could fire. A second pass ([`fire`]) treats those, one at a time and in continuous time: crossings of the signal and
//! candidates of noise in the order in which they happen ([`pixel`]).

mod fire;
mod frozen;
mod jitter;
mod memory;
mod pixel;
mod plan;
mod scan;

pub use frozen::Frozen;
pub use jitter::JITTER_SHIFT;
pub(crate) use memory::{Chain, LONG_AGO, REBASE_US};
pub(crate) use plan::{Plan, ramps};
pub(crate) use scan::Scan;
