//! The scene on the device, and where its parts lie in a picture.

pub mod crowds;
pub mod distorted;
pub mod gpu_scene;
pub mod image_bounds;
pub mod raster_lens;
pub mod tiles;
pub mod transform;
pub mod view;
