//! Light of a pixel over time: where it is evaluated, the path between, and the thresholds that it crosses.

pub mod events;
pub mod knots;
pub mod path;
pub mod pixel;
