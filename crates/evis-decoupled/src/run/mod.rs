//! The loop over blocks, tiles and pixels, and what runs it.

pub(crate) mod device;
pub(crate) mod frames;
pub(crate) mod limits;
pub(crate) mod pixels;
pub(crate) mod row;
pub(crate) mod sensing;
pub(crate) mod settings;
pub(crate) mod simulate;
pub(crate) mod stream;
