//! `preview` of a scene: one picture of what a camera shows, without a run.

use std::sync::Arc;

use anyhow::Context;
use evis_core::{LabelData, LabelKind};
use evis_render::{Gpu, RunConfig, Simulator};
use evis_scene::source::Opening;
use evis_scene::{CameraMotionSettings, Scene};

use crate::args::{PreviewArgs, Scale, to_us};
use crate::failure::bad_input;
use crate::picture::{Canvas, hdr_picture};
use crate::{scene_source, text};

/// Samples of a pixel along each side: an HDR label has one at its centre, so that a larger one is rendered and averaged.
const SAMPLES_ALONG: u32 = 3;

/// Longest side of what is rendered, in pixels: what the weakest device of wgpu's defaults can.
const LONGEST_SIDE: u32 = 8192;

/// Renders the picture that `args` describe; also gives a line that says what it shows.
pub(crate) fn still(args: &PreviewArgs) -> anyhow::Result<(Canvas, String)> {
    refuse_options_of_recordings(args)?;
    let opening = Opening {
        animation: args.animation.animation.clone(),
        camera_motion: CameraMotionSettings {
            camera: args.camera.clone(),
            size: args.size,
            ..CameraMotionSettings::default()
        },
        ..Opening::default()
    };
    let mut scene = scene_source::open(&args.input.to_string_lossy(), &opening)?;
    // Of a batch, the first environment.
    scene.variants.truncate(1);
    for warning in scene.warnings.iter().chain(&scene.unlikely_size()) {
        text::warn(warning);
    }
    let index = args.camera.as_ref().map_or(Ok(0), |name| scene.camera(name))?;
    let at_s = args.at.unwrap_or(0.0);
    if let Some(warning) = scene.enclosed_camera(index, at_s) {
        text::warn(&warning);
    }
    if let Some(end_s) = scene_source::rests_before(&scene, at_s) {
        text::warn(&format!(
            "the scene's motion ends at {end_s} s; at {at_s} s everything rests where it was then"
        ));
    }
    let camera = scene.cameras.get(index).context("the scene has no camera")?;
    let (width, height) = camera.pixels(args.size);
    let name = camera.name.clone();
    let along = samples_along(&scene, &name, width.max(height));
    let config = RunConfig {
        cameras: vec![name.clone()],
        // A camera's own size keeps its own intrinsics.
        size: (along > 1).then_some((along * width, along * height)).or(args.size),
        start_us: to_us(at_s),
        samples: 1,
        labels: vec![LabelKind::Hdr],
        ..RunConfig::default()
    };
    let gpu = Gpu::open(None).map_err(|e| bad_input(e.to_string()))?;
    let mut simulator = Simulator::new(&gpu, Arc::new(scene), config)?;
    let reference = simulator.config().reference_luminance.unwrap_or(1.0);
    // The first label image lies at the start; the shortest step holds it.
    let packet = simulator.step(1)?;
    let label = packet.views.first().and_then(|view| view.labels.first());
    let Some(LabelData::F32(rgb)) = label.map(|label| &label.data) else {
        anyhow::bail!("the engine gave no picture of camera '{name}'");
    };
    let [fine_width, fine_height] = [width, height].map(|side| (along * side) as usize);
    let canvas = hdr_picture(rgb, fine_width, fine_height, Scale::Down(along), reference);
    Ok((canvas, format!("camera '{name}' at {at_s} s")))
}

/// How many samples a pixel has along each side, where the longest one has `longest` pixels.
fn samples_along(scene: &Scene, camera: &str, longest: u32) -> u32 {
    if scene.distortions.contains_key(camera) {
        // Its calibration holds for its own pixels.
        return 1;
    }
    (LONGEST_SIDE / longest.max(1)).clamp(1, SAMPLES_ALONG)
}

fn refuse_options_of_recordings(args: &PreviewArgs) -> anyhow::Result<()> {
    let given = [
        ("--label", args.label.is_some()),
        ("--start", args.start.is_some()),
        ("--duration", args.duration.is_some()),
        ("--window-ms", args.window_ms.is_some()),
        ("--fps", args.fps.is_some()),
        ("--slow", args.slow.is_some()),
        ("--scale", !matches!(args.scale, Scale::Up(1))),
    ];
    match given.into_iter().find(|(_, given)| *given) {
        Some((flag, _)) => Err(bad_input(format!(
            "{flag} is for recordings, and {} is a scene; --at, --camera, --size and --animation work",
            args.input.display()
        ))),
        None => Ok(()),
    }
}
