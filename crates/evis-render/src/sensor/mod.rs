//! From luminance to events: thresholds alone or the whole sensor chain, on the device or on the host.

pub mod chain;
pub mod dense;
pub mod group;
pub mod host;
pub mod passes;
pub mod step;
pub mod targets;
pub mod trigger;
pub mod unpack;
