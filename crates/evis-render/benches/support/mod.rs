//! Scenes, clocks and tables for the benchmarks.

pub mod measure;
pub mod scenes;

/// Whatever ends a benchmark early.
pub type Failure = Box<dyn std::error::Error>;
