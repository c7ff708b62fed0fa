//! The examples run.

#[path = "../examples/callback.rs"]
mod callback;
#[path = "../examples/shared_device.rs"]
mod shared_device;

fn skipped() -> bool {
    let found = evis_render::Gpu::open(None).is_ok();
    assert!(found || std::env::var_os("EVIS_REQUIRE_GPU").is_none_or(|value| value != "1"), "no device");
    !found
}

#[test]
fn a_function_is_called_for_every_packet() {
    if !skipped() {
        callback::main().unwrap();
    }
}

#[test]
fn a_device_is_shared_with_another_renderer() {
    if !skipped() {
        shared_device::main().unwrap();
    }
}
