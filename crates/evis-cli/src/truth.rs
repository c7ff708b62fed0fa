//! `truth`: what an ideal sensor fires in a scene, as a file.

use evis_core::SensorConfig;
use evis_render::scene_sensors;
use evis_scene::Scene;
use evis_scene::source::Opening;
use evis_truth::{Audit, TruthError, TruthSettings};

use crate::args::{TruthArgs, to_us};
use crate::chart::cache_folder;
use crate::interrupt::{EXIT_INTERRUPTED, Interrupt};
use crate::outputs::{check_free, check_output};
use crate::progress::{Progress, WHOLE};
use crate::{scene_source, text};

/// Computes and writes.
pub(crate) fn truth(args: &TruthArgs) -> anyhow::Result<i32> {
    check_output(&args.output)?;
    check_free(&args.output, args.force)?;
    // What is wrong with the flags is said before a scene is read.
    settings(args, SensorConfig::default()).check()?;
    let opening = Opening {
        seed: args.seed.unwrap_or(0),
        animation: args.animation.animation.clone(),
        speed: args.speed,
        camera_motion: args.camera_motion.settings(args.size, args.camera.as_ref()),
    };
    let scene = scene_source::open(&args.scene, &opening)?;
    let rest = scene_source::at_rest(&scene, args.camera.as_slice());
    for warning in scene.warnings.iter().chain(&rest) {
        text::warn(warning);
    }
    let settings = settings(args, scene_sensor(&scene, args.camera.as_deref())?);
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
        "{}  ({} {}x{}, {} pixels: {} events in {}{})",
        args.output.display(),
        truth.camera.name,
        truth.camera.width,
        truth.camera.height,
        text::grouped(truth.pixels.len() as u64),
        text::grouped(truth.events.len() as u64),
        text::seconds(truth.duration_us),
        truth.sampled_hz().map_or_else(String::new, |hz| format!(", sampled at {hz} Hz")),
    ));
    if let Some(audit) = Audit::of(&truth) {
        text::say(&audit_line(&audit));
    }
    Ok(0)
}

/// What the audit says of the truth.
fn audit_line(audit: &Audit) -> String {
    let percent = 100.0 * audit.missed_per_event_at_most;
    // A bound above the number of events bounds nothing.
    let bound = if percent > 100.0 {
        "too few were looked at to bound what the others hide; a longer truth or more pixels give a bound"
            .into()
    } else {
        let confidence = 100.0 * audit.confidence;
        format!("with {confidence:.0} % confidence at most {percent:.2} % as many as there are events do")
    };
    format!(
        "audit: {} of {} quiet steps looked at 16 times as finely: {} hide events; {bound}",
        text::grouped(audit.audited),
        text::grouped(audit.intervals),
        audit.missed,
    )
}

/// What truth takes of the sensor that the scene gives the camera: thresholds, `eps` and trigger.
fn scene_sensor(scene: &Scene, camera: Option<&str>) -> anyhow::Result<SensorConfig> {
    // A camera that does not exist is an error of the truth's.
    let Some(camera) = camera.or_else(|| Some(scene.cameras.first()?.name.as_str())) else {
        return Ok(SensorConfig::default());
    };
    let sensor = scene_sensors(scene, &[camera.to_owned()])?.remove(camera).unwrap_or_default();
    let stages = sensor.stages();
    if !stages.is_empty() {
        text::complain(&format!(
            "warning: the sensor of camera '{camera}' has more than thresholds ({}), which truth leaves out: it is what an ideal \
             sensor with the same thresholds and log_eps fires",
            stages.join(", ")
        ));
    }
    let SensorConfig { threshold_on, threshold_off, log_eps, trigger, .. } = sensor;
    Ok(SensorConfig { threshold_on, threshold_off, log_eps, trigger, ..SensorConfig::default() })
}

/// Flags over `sensor` and defaults.
fn settings(args: &TruthArgs, sensor: SensorConfig) -> TruthSettings {
    let mut settings = TruthSettings { sensor, ..TruthSettings::default() };
    let set = |to: &mut f32, from: Option<f32>| *to = from.unwrap_or(*to);
    set(&mut settings.sensor.threshold_on, args.threshold_on);
    set(&mut settings.sensor.threshold_off, args.threshold_off);
    set(&mut settings.sensor.log_eps, args.log_eps);
    settings.sensor.trigger = args.trigger.unwrap_or(settings.sensor.trigger);
    settings.sampled_hz = args.sampled;
    settings.camera.clone_from(&args.camera);
    settings.size = args.size;
    settings.start_us = args.start.map_or(0, to_us);
    settings.duration_us = args.duration.map_or(settings.duration_us, |s| to_us(s).max(1));
    settings.pixels = args.crop.or(args.truth_pixels).unwrap_or(settings.pixels);
    settings.lattice = args.lattice.unwrap_or(settings.lattice);
    settings.reference_luminance = args.reference_luminance;
    settings
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bound_that_bounds_nothing_is_not_told_as_one() {
        let audit = |missed_per_event_at_most| Audit {
            intervals: 900,
            audited: 12,
            missed: 0,
            confidence: 0.95,
            missed_at_most: 199.0,
            missed_per_event_at_most,
        };
        assert!(
            audit_line(&audit(0.0123)).ends_with(
                "0 hide events; with 95 % confidence at most 1.23 % as many as there are events do"
            )
        );
        let line = audit_line(&audit(169.8773));
        assert!(line.contains("too few were looked at") && !line.contains("16987"), "{line}");
    }
}
