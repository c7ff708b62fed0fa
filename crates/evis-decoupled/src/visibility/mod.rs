//! What a tile and a pixel may see during a block of time, and how much of a pixel each facet covers at a time.

pub mod blocks;
pub mod coverage;
pub mod fragment;
pub mod lists;
pub mod mask;
