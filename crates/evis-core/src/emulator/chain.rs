//! The whole pixel: photoreceptor, thresholds of its own, noise, refractory period.
//!
//! Modules import those above them only:
//!
//! | module | what it does |
//! |---|---|
//! | `plan` | says which stages are on |
//! | `pattern` | draws thresholds and leaks of each pixel |
//! | `memory` | keeps what pixels remember: [`Chain`] |
//! | **first pass** | over 64 pixels at a time |
//! | `photoreceptor` | filters the logarithm of light |
//! | `scan` | finds the pixels that could fire by the interval's end |
//! | **second pass** | over those and the ones that noise may reach, one at a time and in continuous time |
//! | `pixel` | a pixel's signal in the interval |
//! | `leak` | adds the leak's ramp |
//! | `refractory` | silences and holds a pixel after an event |
//! | `emit` | gives an event its time and its place among the others |
//! | `noise_event` | decides what a candidate of noise becomes |
//! | `crossing`, `sampled` | fire where the signal reaches a threshold: in continuous time, or at samples |
//! | `blocks` | treats 64 pixels together where light alone moves them |
//! | `fire` | takes each pixel through the interval |

mod blocks;
mod crossing;
mod emit;
mod fire;
mod leak;
mod memory;
mod noise_event;
mod pattern;
mod photoreceptor;
mod pixel;
mod plan;
mod refractory;
mod sampled;
mod scan;

pub use leak::JITTER_SHIFT;
pub(crate) use memory::{Chain, LONG_AGO, REBASE_US};
pub use pattern::FixedPattern;
pub(crate) use plan::{Plan, ramps};
pub(crate) use scan::Scan;
