//! `verify`: events against truth, and whether the error falls as theory says.

use std::path::PathBuf;

use anyhow::Context;
use evis_chart::verify::failures::{NamedMethod, methods};
use evis_chart::verify::{
    FailureReport, FailureSettings, LightReport, LightSettings, SceneReport, SceneSettings, verify_failures,
    verify_forms, verify_light, verify_scene,
};
use evis_chart::{ChartError, PictureKind, Stage};
use evis_render::Gpu;
use evis_scene::Scene;
use evis_scene::source::Opening;

use crate::args::{VerifyArgs, to_us};
use crate::chart::cache_folder;
use crate::failure::bad_input;
use crate::interrupt::{EXIT_INTERRUPTED, Interrupt};
use crate::outputs::check_parent;
use crate::progress::{Progress, WHOLE};
use crate::{scene_source, text};

/// Exit code where theory and measurement differ.
const EXIT_FAILED: i32 = 1;

/// Measures, prints and draws.
pub(crate) fn verify(args: &VerifyArgs) -> anyhow::Result<i32> {
    for output in &args.output {
        PictureKind::of(output)?;
        check_parent(output, "--output")?;
    }
    let given = args.animation.given().or(args.camera_motion.given());
    if let (Some(flag), None, None) = (given, &args.what.scene, &args.what.light) {
        return Err(bad_input(format!("{flag} is for a scene; add --scene SCENE or --light SCENE")));
    }
    if args.what.failures {
        let Some(report) = survive(args)? else { return interrupted() };
        tell(args, &report, |r| r.to_json(), |r, path| r.save(path))?;
        return Ok(if report.passed() { 0 } else { EXIT_FAILED });
    }
    if let Some(name) = &args.what.light {
        let Some(report) = light(name, args)? else { return interrupted() };
        tell(args, &report, |r| r.to_json(), |r, path| r.save(path))?;
        return Ok(0);
    }
    let Some(name) = &args.what.scene else {
        let report = verify_forms()?;
        tell(args, &report, |r| r.to_json(), |r, path| r.save(path))?;
        return Ok(if report.passed() { 0 } else { EXIT_FAILED });
    };
    let Some(report) = measure(name, args)? else { return interrupted() };
    tell(args, &report, |r| r.to_json(), |r, path| r.save(path))?;
    Ok(0)
}

fn interrupted() -> anyhow::Result<i32> {
    text::complain("interrupted; nothing was written");
    Ok(EXIT_INTERRUPTED)
}

/// Prints `report` as it was asked for, and draws it.
fn tell<R: std::fmt::Display>(
    args: &VerifyArgs,
    report: &R,
    json: fn(&R) -> Result<String, ChartError>,
    save: fn(&R, &PathBuf) -> Result<(), ChartError>,
) -> anyhow::Result<()> {
    text::say(&if args.json { json(report)? } else { report.to_string() });
    for output in &args.output {
        save(report, output)?;
        if !args.json {
            text::say(&format!("{}", output.display()));
        }
    }
    Ok(())
}

/// Failure modes; `None` where it was interrupted.
fn survive(args: &VerifyArgs) -> anyhow::Result<Option<FailureReport>> {
    let named = args.methods.iter().map(|name| NamedMethod::named(name));
    let named = named.collect::<Result<Vec<_>, _>>()?;
    let settings = FailureSettings {
        methods: if named.is_empty() { methods() } else { named },
        failures: args.only.clone(),
        cache: None,
        compute: args.compute.unwrap_or_default(),
    };
    settings.check()?;
    let settings = FailureSettings { cache: cache_folder(args.common.cache.as_deref()), ..settings };
    let gpu = Gpu::open(args.common.device.as_deref()).map_err(|e| bad_input(e.to_string()))?;
    let interrupt = Interrupt::listen();
    let progress = Progress::new(WHOLE);
    let told = |stage: Stage, part: f64| {
        progress.part(&format!("failure modes: {}", stage.name()), part);
        !interrupt.asked()
    };
    match verify_failures(&gpu, &settings, &told) {
        Ok(report) => Ok(Some(report)),
        Err(ChartError::Stopped) => Ok(None),
        Err(error) => Err(error).context("the failure modes cannot be measured"),
    }
}

/// The scene `name`, seen by `camera`, and what its loader has to say.
fn open(
    name: &str,
    args: &VerifyArgs,
    size: Option<(u32, u32)>,
    camera: Option<&String>,
) -> anyhow::Result<Scene> {
    let opening = Opening {
        seed: args.common.seed.unwrap_or(0),
        animation: args.animation.animation.clone(),
        speed: None,
        camera_motion: args.camera_motion.settings(size, camera),
    };
    let scene = scene_source::open(name, &opening)?;
    if let Some(camera) = camera {
        scene.camera(camera)?;
    }
    for warning in &scene.warnings {
        text::warn(warning);
    }
    Ok(scene)
}

/// Light at one instant; `None` where it was interrupted.
fn light(name: &str, args: &VerifyArgs) -> anyhow::Result<Option<LightReport>> {
    let common = &args.common;
    let default = LightSettings::default();
    let samples = match common.samples.as_slice() {
        [] => default.samples,
        [samples] => *samples,
        several => {
            let told = format!("--samples has {} numbers; --light takes one, such as 16", several.len());
            return Err(bad_input(told));
        }
    };
    let settings = LightSettings {
        samples,
        camera: common.camera.clone(),
        size: common.size.or(default.size),
        at_us: args.at.map_or(default.at_us, to_us),
        shadows: args.shadows.unwrap_or(default.shadows),
        worst: default.worst,
    };
    let scene = open(name, args, settings.size, settings.camera.as_ref())?;
    let gpu = Gpu::open(common.device.as_deref()).map_err(|e| bad_input(e.to_string()))?;
    let interrupt = Interrupt::listen();
    let progress = Progress::new(WHOLE);
    let told = |stage: Stage, part: f64| {
        progress.part(&format!("{name}: {}", stage.name()), part);
        !interrupt.asked()
    };
    match verify_light(&gpu, name, &scene, &settings, &told) {
        Ok(report) => Ok(Some(report)),
        Err(ChartError::Stopped) => Ok(None),
        Err(error) => Err(error).with_context(|| format!("the light of {name} cannot be verified")),
    }
}

/// `None` where it was interrupted.
fn measure(name: &str, args: &VerifyArgs) -> anyhow::Result<Option<SceneReport>> {
    let settings = settings(args);
    settings.settings()?;
    let scene = open(name, args, settings.size, settings.camera.as_ref())?;
    let settings = SceneSettings { cache: cache_folder(args.common.cache.as_deref()), ..settings };
    let gpu = Gpu::open(args.common.device.as_deref()).map_err(|e| bad_input(e.to_string()))?;
    let interrupt = Interrupt::listen();
    let progress = Progress::new(WHOLE);
    let told = |stage: Stage, part: f64| {
        progress.part(&format!("{name}: {}", stage.name()), part);
        !interrupt.asked()
    };
    match verify_scene(&gpu, name, &scene, &settings, &told) {
        Ok(report) => Ok(Some(report)),
        Err(ChartError::Stopped) => Ok(None),
        Err(error) => Err(error).with_context(|| format!("{name} cannot be verified")),
    }
}

/// Flags over defaults.
fn settings(args: &VerifyArgs) -> SceneSettings {
    let VerifyArgs { common, measuring: args, .. } = args;
    let default = SceneSettings::default();
    let or = |given: &[f64], usual: Vec<f64>| if given.is_empty() { usual } else { given.to_vec() };
    let mut sensor = default.sensor.clone();
    sensor.threshold_on = args.threshold_on.unwrap_or(sensor.threshold_on);
    sensor.threshold_off = args.threshold_off.unwrap_or(sensor.threshold_off);
    SceneSettings {
        sensor,
        rates_hz: or(&args.rates, default.rates_hz),
        samples: if common.samples.is_empty() { default.samples } else { common.samples.clone() },
        triggers: if args.triggers.is_empty() { default.triggers } else { args.triggers.clone() },
        camera: common.camera.clone(),
        size: common.size.or(default.size),
        duration_us: args.duration.map_or(default.duration_us, |s| to_us(s).max(1)),
        pixels: args.truth_pixels.unwrap_or(default.pixels),
        ..default
    }
}
