//! The example runs.

#[path = "../examples/rapier_host.rs"]
mod rapier_host;

#[test]
fn a_loop_with_rapier_sees_its_ball() {
    let found = evis_render::Gpu::open(None).is_ok();
    assert!(found || std::env::var_os("EVIS_REQUIRE_GPU").is_none_or(|value| value != "1"), "no device");
    if found {
        rapier_host::main().unwrap();
    }
}
