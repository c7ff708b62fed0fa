//! What in a request is probably a mistake.

use evis_scene::Scene;

use crate::config::{Method, RunConfig};

/// Pixels per interval beyond which a fixed rate is probably a mistake: more than the width of most event sensors.
const MOST_PX: f64 = 1000.0;

/// What stands out of a run of `config` on `scene`, before it begins: a scene whose unit is probably not the metre, a camera inside
/// a model, an image that moves by more than 1000 pixels between two instants of a fixed rate. Settings are named by the
/// fields of [`crate::RunRequest`], between backticks.
pub fn implausible(scene: &Scene, config: &RunConfig, duration_us: i64) -> Vec<String> {
    let mut doubts: Vec<String> = scene.unlikely_size().into_iter().collect();
    if scene.host_poses.is_some() {
        // Where cameras and models are is the host's to say, step by step.
        return doubts;
    }
    let start_s = config.start_us as f64 * 1e-6;
    let is_rendered = |name: &String| config.cameras.is_empty() || config.cameras.contains(name);
    for (index, camera) in scene.cameras.iter().enumerate().filter(|(_, camera)| is_rendered(&camera.name)) {
        doubts.extend(scene.enclosed_camera(index, start_s));
        let Some((interval_s, setting)) = fixed_interval(config) else { continue };
        let times = (start_s, duration_us as f64 * 1e-6);
        let moved_px = scene.image_motion_px(index, config.size, times, interval_s);
        if moved_px > MOST_PX {
            doubts.push(format!(
                "camera '{}': its image moves by up to {moved_px:.0} pixels between two instants, {:.3} ms apart, and what \
                 passes in between fires nothing; raise `{setting}`, or give a `quality` instead: presets sample by motion",
                camera.name,
                interval_s * 1e3
            ));
        }
    }
    doubts
}

/// Seconds between two rendered instants, where these have a fixed rate, and the setting that it comes from.
fn fixed_interval(config: &RunConfig) -> Option<(f64, &'static str)> {
    match (&config.method, config.method.keyframes()) {
        (_, Some((keyframe_hz, _))) => Some((1.0 / keyframe_hz, "keyframe_hz")),
        (Method::Native, None) if config.adaptive_px.is_none() => Some((1.0 / config.rate_hz, "rate_hz")),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use evis_scene::builder::{EventCamera, Placement, SceneBuilder};
    use evis_scene::motion::Path;
    use evis_scene::primitive::Shape;
    use evis_scene::{Material, Trs};
    use glam::DVec3;

    use super::*;

    #[test]
    fn motion_is_too_fast_for_a_fixed_rate_alone() {
        let mut s = SceneBuilder::new("fast");
        let white = s.material(Material::unlit("white")).unwrap();
        s.shape("wall", Shape::Card { size: [400.0, 4.0] }, white, Placement::at([0.0, 0.0, -2.0])).unwrap();
        let path = Path::ConstantVelocity { start: Trs::default(), velocity: DVec3::new(100.0, 0.0, 0.0) };
        s.camera(EventCamera::new("eye").fov_y_degrees(90.0), Placement::along(path)).unwrap();
        let scene = s.build().unwrap();
        // 240 px of focal length at 2 m: 12 000 px/s.
        let doubts = |rate_hz, adaptive_px| {
            let config = RunConfig { rate_hz, adaptive_px, size: Some((640, 480)), ..RunConfig::default() };
            implausible(&scene, &config, 100_000)
        };
        let told = doubts(10.0, None);
        assert!(told.len() == 1 && told[0].contains("up to 1200 pixels"), "{told:?}");
        assert!(told[0].contains("100.000 ms apart") && told[0].contains("`rate_hz`"), "{told:?}");
        assert_eq!(doubts(100.0, None), [""; 0]);
        assert_eq!(doubts(10.0, Some(1.0)), [""; 0], "sampled by motion");
    }
}
