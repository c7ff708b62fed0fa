//! What tests of whole charts and reports share.

use evis_render::Gpu;

/// The device; `None`, and a word about it, where there is none and none is required.
pub fn gpu() -> Option<Gpu> {
    match Gpu::open(None) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            let required = std::env::var("EVIS_REQUIRE_GPU").is_ok_and(|v| v == "1");
            assert!(!required, "EVIS_REQUIRE_GPU=1, and {error}");
            eprintln!("skipped: {error}");
            None
        }
    }
}
