//! `truth`: what an ideal sensor fires in a scene, as a file.

use evis_render::RunConfig;
use evis_truth::{Audit, TruthError, TruthSettings};

use crate::args::TruthArgs;
use crate::chart::cache_folder;
use crate::interrupt::{EXIT_INTERRUPTED, Interrupt};
use crate::progress::{Progress, WHOLE};
use crate::run::{check_free, check_output, to_us};
use crate::{scene_source, text};

/// Computes and writes.
pub(crate) fn truth(args: &TruthArgs) -> anyhow::Result<i32> {
    check_output(&args.output)?;
    check_free(&args.output, args.force)?;
    let settings = settings(args);
    settings.check()?;
    let scene = scene_source::load(&args.scene, args.seed.unwrap_or(0))?;
    for warning in &scene.warnings {
        text::complain(&format!("warning: {warning}"));
    }
    let cache = cache_folder(args.cache.as_deref());
    let interrupt = Interrupt::listen();
    let progress = Progress::new(WHOLE);
    let told = |part: f64| {
        progress.part("truth", part);
        !interrupt.asked()
    };
    let made = match &cache {
        Some(folder) => evis_truth::cached(folder, &scene, &settings, &told),
        None => evis_truth::truth(&scene, &settings, &told),
    };
    drop(progress);
    let truth = match made {
        Ok(truth) => truth,
        Err(TruthError::Stopped) => {
            text::complain("interrupted; nothing was written");
            return Ok(EXIT_INTERRUPTED);
        }
        Err(error) => return Err(error.into()),
    };
    truth.write(&args.output, args.force)?;
    text::say(&format!(
        "{}  ({} {}x{}, {} pixels: {} events in {})",
        args.output.display(),
        truth.camera.name,
        truth.camera.width,
        truth.camera.height,
        text::grouped(truth.pixels.len() as u64),
        text::grouped(truth.events.len() as u64),
        text::seconds(truth.duration_us),
    ));
    if let Some(audit) = Audit::of(&truth) {
        text::say(&format!(
            "audit: {} of {} quiet steps looked at 16 times as finely: {} hide events; with {:.0} % confidence at most {:.2} % as many \
             as there are events do",
            text::grouped(audit.audited),
            text::grouped(audit.intervals),
            audit.missed,
            100.0 * audit.confidence,
            100.0 * audit.missed_per_event_at_most,
        ));
    }
    Ok(0)
}

/// Flags over defaults.
fn settings(args: &TruthArgs) -> TruthSettings {
    let mut settings = TruthSettings { sensor: RunConfig::default().sensor, ..TruthSettings::default() };
    let set = |to: &mut f32, from: Option<f32>| *to = from.unwrap_or(*to);
    set(&mut settings.sensor.threshold_on, args.threshold_on);
    set(&mut settings.sensor.threshold_off, args.threshold_off);
    set(&mut settings.sensor.log_eps, args.log_eps);
    settings.camera.clone_from(&args.camera);
    settings.size = args.size;
    settings.start_us = args.start.map_or(0, to_us);
    settings.duration_us = args.duration.map_or(settings.duration_us, |s| to_us(s).max(1));
    settings.pixels = args.crop.or(args.pixels).unwrap_or(settings.pixels);
    settings.lattice = args.lattice.map_or(settings.lattice, Into::into);
    settings.reference_luminance = args.reference_luminance;
    settings
}
