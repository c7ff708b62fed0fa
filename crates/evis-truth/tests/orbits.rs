//! Scenes that bring no motion, orbited: fine texture at few pixels, where lattices have stairs.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use evis_scene::{CameraMotionSettings, toml_scene};
use evis_truth::{PixelChoice, TruthSettings, truth};

#[test]
fn an_event_just_after_a_step_is_no_reason_to_stop() {
    let text = r#"
        textures = [{ name = "t", pattern = "bricks", size = 128 }]
        materials = [{ name = "m", model = "unlit", texture = "t" }]
        primitives = [{ name = "cube", shape = "box", size = [100, 80, 60], material = "m" }]
    "#;
    let size = Some((32, 24));
    let mut scene = toml_scene::parse(text, "").unwrap();
    scene
        .move_cameras(&CameraMotionSettings {
            speed_px_per_s: Some(10.0),
            size,
            ..CameraMotionSettings::default()
        })
        .unwrap();
    let settings =
        TruthSettings { size, duration_us: 60_000, pixels: PixelChoice::All, ..TruthSettings::default() };
    let found = truth(&scene, &settings, &|_| true).unwrap();
    assert!(found.events.len() > 100, "{}", found.events.len());
    assert!(found.events.iter().all(|e| e.t >= 0 && e.t < 60_000));
}
