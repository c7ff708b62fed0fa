//! Each pass equals its CPU twin, or what rays find, with planted boundary cases and a canary.

mod audit;
mod chain;
mod decoupled;
mod pushed;
mod raster;
mod resample;
mod splat;
mod trigger;
