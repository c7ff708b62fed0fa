//! Floors 0 to 3: declarations against shaders, pipelines on `noop`, passes against twins, whole intervals.

mod floor0;
mod floor1;
mod floor2;
mod floor2_raster;
mod floor3;
mod raster_scenes;

use crate::gpu::Gpu;

/// The device of floors 2 and 3. Where `EVIS_REQUIRE_GPU=1`, its absence is a failure; elsewhere it is said aloud.
fn device() -> Option<Gpu> {
    match Gpu::open(None) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            assert!(std::env::var_os("EVIS_REQUIRE_GPU").is_none_or(|v| v != "1"), "{error}");
            eprintln!("NOT RUN: {error}");
            None
        }
    }
}
