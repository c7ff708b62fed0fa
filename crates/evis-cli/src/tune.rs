//! `tune`: the cheapest settings that are accurate enough on a scene.

use std::sync::Arc;

use evis_render::tune::{Goal, tune as search};
use evis_render::{EngineError, Gpu, RunConfig, scene_sensors};
use evis_scene::source::Opening;

use crate::args::{TuneArgs, to_us};
use crate::failure::bad_input;
use crate::interrupt::{EXIT_INTERRUPTED, Interrupt};
use crate::outputs::{check_free, check_parent};
use crate::progress::{Progress, WHOLE};
use crate::{scene_source, sensor_source, text};

/// Searches and writes.
pub(crate) fn tune(args: &TuneArgs) -> anyhow::Result<i32> {
    if !args.output.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("toml")) {
        return Err(bad_input(format!("--output {}: settings are a .toml file", args.output.display())));
    }
    check_parent(&args.output, "--output")?;
    check_free(&args.output, args.force)?;
    let goal = Goal { target_f1: args.target_f1, budget_ms: args.budget };
    goal.check()?;
    let asked = sensor_source::asked(&args.sensor)?;
    let for_all = asked.all.is_some();
    let mut config = RunConfig {
        sensor: asked.all.unwrap_or_default(),
        sensors: asked.of,
        shadows: args.shadows,
        cameras: args.camera.clone(),
        size: args.size,
        start_us: to_us(args.start.unwrap_or(0.0)),
        ..RunConfig::default()
    };
    let opening = Opening {
        seed: config.seed,
        animation: args.animation.animation.clone(),
        speed: args.speed,
        camera_motion: args.camera_motion.settings(config.size, config.cameras.first()),
    };
    let scene = scene_source::open(&args.scene, &opening)?;
    for warning in scene.warnings.iter().chain(&scene_source::at_rest(&scene, &config.cameras)) {
        text::warn(warning);
    }
    for name in config.cameras.iter().chain(config.sensors.keys()) {
        scene.camera(name)?;
    }
    if !for_all {
        for (camera, sensor) in scene_sensors(&scene, &config.cameras)? {
            config.sensors.entry(camera).or_insert(sensor);
        }
    }
    let gpu = Gpu::open(args.device.as_deref()).map_err(|e| bad_input(e.to_string()))?;
    let interrupt = Interrupt::listen();
    let progress = Progress::new(WHOLE);
    let report = |what: &str, part: f64| {
        progress.part(what, part);
        !interrupt.asked()
    };
    let tuned = match search(&gpu, &Arc::new(scene), &config, goal, &report) {
        Err(EngineError::Stopped) => {
            text::complain("interrupted; nothing was written");
            return Ok(EXIT_INTERRUPTED);
        }
        tuned => tuned?,
    };
    drop(progress);
    tuned.write(&args.output, &args.scene)?;
    if let Some(warning) = &tuned.warning {
        text::warn(warning);
    }
    let lines = tuned.tried.iter().enumerate().map(|(index, tried)| {
        let mark = if index == tuned.taken { "*" } else { " " };
        format!("{mark} {}\n", tried.line())
    });
    text::say(&format!(
        "{}beside {}, in {} tiles\nwrote {}",
        lines.collect::<String>(),
        tuned.reference,
        tuned.tiles,
        args.output.display()
    ));
    Ok(0)
}
