//! CPU twins: what the passes should have produced, computed without them.
//!
//! The trigger's twin is the same algorithm in f32. The raster passes are held against `evis_truth::rays`, exact
//! geometry in f64, ray by ray.

pub mod audit;
pub mod resample;
pub mod splat;
pub mod trigger;
