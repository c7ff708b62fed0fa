//! `chart`: settings are measured on scenes, drawn, and one is recommended.

use std::path::{Path, PathBuf};

use anyhow::Context;
use evis_chart::result::REAL_TIME_MS;
use evis_chart::{
    ChartError, ChartResult, ChartSettings, Criteria, Goal, LadderRequest, PictureKind, SceneChart, Stage,
    shell_quoted,
};
use evis_core::limits::{Budget, read_text};
use evis_render::Gpu;
use evis_scene::CameraMotion;
use evis_scene::source::Opening;

use crate::args::{ChartArgs, MeasuringArgs, to_us};
use crate::failure::bad_input;
use crate::interrupt::{EXIT_INTERRUPTED, Interrupt};
use crate::outputs::check_parent;
use crate::progress::{Progress, WHOLE};
use crate::{scene_source, text};

/// Events of truth from which F1 is known to about 0.01: its standard error at F1 0.95 is that of a share, 0.0097.
const ENOUGH_EVENTS: usize = 500;

/// F1 that is recommended for, unless another is asked for.
const TARGET_F1: f64 = 0.98;

/// Measures or reads, draws, and recommends. `program` is what the user called.
pub(crate) fn chart(args: &ChartArgs, program: &str) -> anyhow::Result<i32> {
    let criteria = Criteria {
        tolerance_us: args.f1.map_or(Criteria::default().tolerance_us, |f1| f1.micros()),
        render_ms: args.render_ms.unwrap_or(0.0),
    };
    for output in &args.output {
        PictureKind::of(output)?;
        check_parent(output, "--output")?;
    }
    if let Some(report) = &args.report {
        check_parent(report, "--report")?;
    }
    let (chart, ended) = if args.from.is_empty() { measure(args)? } else { (read(&args.from)?, None) };
    if chart.scenes.is_empty() {
        return ended.unwrap_or_else(|| Err(bad_input("no scene was measured; give at least one")));
    }

    // What was measured is kept first: whatever fails later can be done again from it.
    let say = |line: &str| {
        if !args.json {
            text::say(line);
        }
    };
    if let Some(path) = &args.report {
        let json = chart.to_json()? + "\n";
        evis_core::limits::write_whole(path, json.as_bytes())
            .with_context(|| format!("cannot write {}", path.display()))?;
        say(&format!("{}", path.display()));
    }
    if args.json {
        text::say(&chart.to_json()?);
    }
    for output in &args.output {
        evis_chart::draw::save(&chart, criteria, output)?;
        say(&format!("{}", output.display()));
    }
    let recommended = recommend(args, &chart, criteria, program, &say);
    ended.unwrap_or(recommended)
}

/// One sentence and one command per scene and goal. A goal that the user set and that is out of reach is an error.
fn recommend(
    args: &ChartArgs,
    chart: &ChartResult,
    criteria: Criteria,
    program: &str,
    say: &impl Fn(&str),
) -> anyhow::Result<i32> {
    let asked = [args.budget.map(Goal::Budget), args.target_f1.map(Goal::TargetF1)];
    let usual = [Goal::Budget(REAL_TIME_MS), Goal::TargetF1(TARGET_F1)];
    let goals: Vec<_> = asked.into_iter().flatten().collect();
    let (goals, asked) = if goals.is_empty() { (usual.to_vec(), false) } else { (goals, true) };
    let mut failed = None;
    for scene in &chart.scenes {
        if let Some(warning) = rough(scene) {
            text::warn(&warning);
        }
        say(&format!("{}: {}", scene.scene, measured(scene)));
        for goal in &goals {
            match scene.recommend(*goal, criteria) {
                Ok(found) => {
                    let command = found.command.replacen("evis ", &format!("{program} "), 1);
                    say(&format!("  {}\n    {command}", found.sentence));
                }
                Err(error @ ChartError::Unreachable(_)) if !asked => say(&format!("  {error}")),
                Err(error) => failed = Some(error),
            }
        }
    }
    failed.map_or(Ok(0), |error| Err(error.into()))
}

/// What is said of a chart whose truth has so few events that one more or less moves its figures. Pixels stay where they are:
/// those that are chosen because they fire would see fewer of the events that a setting fires where nothing does.
fn rough(scene: &SceneChart) -> Option<String> {
    let truth = &scene.truth;
    if truth.events >= ENOUGH_EVENTS {
        return None;
    }
    let all = scene.width as usize * scene.height as usize;
    let times = ENOUGH_EVENTS as f64 / truth.events.max(1) as f64;
    let asked = (truth.pixels as f64 * times / 100.0).ceil() as usize * 100;
    let more = if truth.pixels >= all {
        String::new()
    } else if asked < all {
        format!(
            "--truth-pixels {asked} gives about {ENOUGH_EVENTS}, in {times:.0} times the time for truth; "
        )
    } else {
        let events = truth.events * all / truth.pixels.max(1);
        format!("--truth-pixels all gives about {}; ", rounded(events))
    };
    // The standard deviation of a share that so many independent events have.
    let deviation = (0.95 * 0.05 / truth.events.max(1) as f64).sqrt();
    Some(format!(
        "{}: figures are rough: truth has few events ({}, at {} of its {} pixels, which are spread evenly over the picture): F1 \
         0.95 would be known to ±{deviation:.2} at best; {more}a longer --duration or another --start may give more",
        scene.scene, truth.events, truth.firing, truth.pixels,
    ))
}

/// A count that is estimated, to two digits.
fn rounded(count: usize) -> usize {
    let unit = 10_usize.pow(count.max(1).ilog10().saturating_sub(1));
    (count + unit / 2) / unit * unit
}

fn measured(scene: &SceneChart) -> String {
    let clamped = scene.points.iter().filter(|p| p.clamped > 0).count();
    let lost = if clamped > 0 {
        format!("; {clamped} of them lost events at the limit per pixel, see `clamped` in the JSON")
    } else {
        String::new()
    };
    format!("{} settings measured on {}{lost}", scene.points.len(), scene.device.name)
}

fn read(paths: &[PathBuf]) -> anyhow::Result<ChartResult> {
    let mut scenes = Vec::new();
    for path in paths {
        let text =
            read_text(path, &Budget::default()).with_context(|| format!("cannot read {}", path.display()))?;
        scenes.extend(ChartResult::from_json(&text, path)?.scenes);
    }
    Ok(ChartResult::new(scenes))
}

/// The command's end where not every scene was measured: an exit code or an error.
type Ended = Option<anyhow::Result<i32>>;

/// Every scene in turn, up to the first that fails: those before it are kept.
fn measure(args: &ChartArgs) -> anyhow::Result<(ChartResult, Ended)> {
    let settings = settings(&args.measuring);
    settings.ladder.settings()?;
    let seed = args.measuring.seed.unwrap_or(0);
    let mut scenes = Vec::new();
    for name in &args.scenes {
        let opening = Opening {
            seed,
            animation: args.animation.animation.clone(),
            speed: args.measuring.speed,
            camera_motion: args.camera_motion.settings(settings.size, settings.camera.as_ref()),
        };
        let scene = scene_source::open(name, &opening)?;
        if let Some(camera) = &settings.camera {
            scene.camera(camera)?;
        }
        for warning in scene.warnings.iter().chain(&scene_source::at_rest(&scene, settings.camera.as_slice()))
        {
            text::warn(warning);
        }
        // What a chart is called says what was changed.
        let animation = args.animation.animation.as_ref().map(|animation| format!(", animation {animation}"));
        let speed = args.measuring.speed.map(|speed| format!(" at speed {speed}"));
        let title = [Some(name.clone()), animation, speed].into_iter().flatten().collect::<String>();
        scenes.push((title, run_as(name, args), scene));
    }
    let gpu = Gpu::open(args.measuring.device.as_deref()).map_err(|e| bad_input(e.to_string()))?;
    let interrupt = Interrupt::listen();
    let (mut charts, mut ended) = (Vec::new(), None);
    for (name, run_as, scene) in &scenes {
        let progress = Progress::new(WHOLE);
        let told = |stage: Stage, part: f64| {
            progress.part(&format!("{name}: {}", stage.name()), part);
            !interrupt.asked()
        };
        match evis_chart::chart(&gpu, name, scene, &settings, &told) {
            Ok(chart) => charts.push(SceneChart { run_as: Some(run_as.clone()), ..chart }),
            Err(ChartError::Stopped) => {
                drop(progress);
                text::complain(&format!("interrupted; {name} was not measured"));
                ended = Some(Ok(EXIT_INTERRUPTED));
                break;
            }
            Err(error) => {
                ended = Some(Err(anyhow::Error::new(error).context(format!("chart of {name}"))));
                break;
            }
        }
    }
    Ok((ChartResult::new(charts), ended))
}

/// What `run` is given to open `scene` as `args` say.
fn run_as(scene: &str, args: &ChartArgs) -> String {
    let motion = &args.camera_motion;
    let options = [
        ("--animation", args.animation.animation.clone()),
        ("--speed", args.measuring.speed.map(|speed| speed.to_string())),
        ("--start", args.measuring.start.map(|start| start.to_string())),
        ("--seed", args.measuring.seed.map(|seed| seed.to_string())),
        ("--camera-motion", motion.camera_motion.as_ref().map(CameraMotion::name)),
        ("--camera-speed", motion.camera_speed.map(|speed| speed.to_string())),
    ];
    let given = options.into_iter().filter_map(|(flag, value)| Some((flag, value?)));
    given.fold(shell_quoted(scene), |line, (flag, value)| format!("{line} {flag} {}", shell_quoted(&value)))
}

/// Flags over defaults.
fn settings(args: &MeasuringArgs) -> ChartSettings {
    let given = |rates: &Vec<f64>| Some(rates.clone()).filter(|rates| !rates.is_empty());
    let ladder = LadderRequest {
        quick: args.quick,
        rates_hz: given(&args.rates),
        samples: Some(args.samples.clone()).filter(|samples| !samples.is_empty()),
        edges: args.no_edges.then_some(false),
        latch_hz: given(&args.latch_rates),
        no_published: args.no_published,
        no_splat: args.no_splat,
        no_adaptive: args.no_adaptive,
    };
    let default = ChartSettings::default();
    let mut sensor = default.sensor.clone();
    sensor.threshold_on = args.threshold_on.unwrap_or(sensor.threshold_on);
    sensor.threshold_off = args.threshold_off.unwrap_or(sensor.threshold_off);
    sensor.log_eps = args.log_eps.unwrap_or(sensor.log_eps);
    ChartSettings {
        ladder: ladder.into(),
        repetitions: args.repetitions.unwrap_or(default.repetitions),
        sensor,
        camera: args.camera.clone(),
        size: args.size.or(default.size),
        start_us: to_us(args.start.unwrap_or(0.0)),
        duration_us: args.duration.map_or(default.duration_us, |s| to_us(s).max(1)),
        pixels: args.truth_pixels.unwrap_or(default.pixels),
        reference_luminance: None,
        floor: !args.no_floor,
        cache: cache_folder(args.cache.as_deref()),
    }
}

/// Where truths are kept: where the user says, else in the user's own cache. One that cannot be had costs time, no
/// more.
pub(crate) fn cache_folder(asked: Option<&Path>) -> Option<PathBuf> {
    let folder = match asked {
        Some(folder) => folder.to_path_buf(),
        None => evis_chart::user_cache()?,
    };
    let usable = std::fs::create_dir_all(&folder).and_then(|()| {
        let probe = folder.join(format!(".probe-{}", std::process::id()));
        std::fs::write(&probe, [])?;
        std::fs::remove_file(&probe)
    });
    if let Err(error) = usable {
        text::complain(&format!(
            "warning: truths are not kept: cannot write to {} ({error}); --cache DIR takes another folder",
            folder.display()
        ));
        return None;
    }
    Some(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_keep_two_digits() {
        let counts = [0, 7, 84, 675, 1249, 99_600];
        assert_eq!(counts.map(rounded), [0, 7, 84, 680, 1200, 100_000]);
    }
}
