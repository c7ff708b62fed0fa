//! The converged oracle: what an ideal event camera fires in a scene, computed without the engine.
//!
//! Rays in f64 against the scene's own triangles, a dense symmetric lattice of samples over each pixel's area, edges
//! found exactly, thresholds crossed in continuous time. Slow, and with a stated error of its own: truths from two
//! independent families of samples ([`Lattice`]) are scored against each other.

mod audit;
mod cache;
mod clock;
mod lattice;
mod oracle;
mod probe;
pub mod rays;
mod schedule;
mod settings;
mod signal;
mod walk;

pub use audit::Audit;
pub use cache::cached;
pub use lattice::Lattice;
pub use oracle::truth;
pub use settings::{PixelChoice, TruthError, TruthSettings};
