//! Whole streams on a device: what changes no byte, and what events must be.

mod adaptive;
mod built_in;
mod bytes;
mod chain;
mod crowds;
mod decoupled;
mod dense;
mod distorted;
mod environments;
mod frames;
mod gather;
mod host_walk;
mod lost;
mod sensors;
mod shadow;
mod shadow_rate;
mod skips;
mod splat;
mod still;
mod tune;
