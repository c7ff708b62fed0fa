//! CPU twins of the passes: the same algorithms, for tests.

pub mod trigger;
