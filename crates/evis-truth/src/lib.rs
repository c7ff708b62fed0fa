//! The converged oracle: what an ideal event camera fires in a scene, computed without the engine.
//!
//! Rays in f64 against the scene's own triangles, a dense symmetric lattice of samples over each pixel's area,
//! thresholds crossed in continuous time. Slow, exact, and with a stated error of its own.

pub mod rays;
