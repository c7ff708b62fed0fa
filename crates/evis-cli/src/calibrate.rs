//! `calibrate`: a sensor from recordings.

use std::path::Path;

use anyhow::Context;
use evis_core::SensorConfig;
use evis_core::stats::{Calibration, FlickerFit, calibrate as fit, calibrate_flicker};

use crate::args::CalibrateArgs;
use crate::failure::bad_input;
use crate::outputs::{check_free, check_parent};
use crate::{extent, sensor_source, text};

/// Fits, tells and writes.
pub(crate) fn calibrate(args: &CalibrateArgs) -> anyhow::Result<i32> {
    if let Some(output) = &args.output {
        if !output.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("toml")) {
            return Err(bad_input(format!("--output {}: a sensor is a .toml file", output.display())));
        }
        check_parent(output, "--output")?;
        check_free(output, args.force)?;
    }
    let base = match &args.base {
        Some(name) => sensor_source::load("--base", name)?,
        None => SensorConfig::default(),
    };
    let names: Vec<String> = args.recordings.iter().map(|path| path.display().to_string()).collect();
    let read = |path: &Path| extent::part(path, args.camera.as_deref(), args.start, args.duration);
    if args.stimulus.is_empty() {
        let [path] = args.recordings.as_slice() else {
            return Err(bad_input(
                "several recordings need a --stimulus each; a still scene is calibrated from one recording",
            ));
        };
        let file = read(path)?;
        let made: Calibration = fit(&file.events, file.size, file.range, &base, args.seed.unwrap_or(0))?;
        for warning in &made.warnings {
            text::warn(warning);
        }
        return tell(args, &names, &made.sensor, &made, &made.to_string());
    }
    if args.stimulus.len() != args.recordings.len() {
        return Err(bad_input(format!(
            "there are {} recordings and {} --stimulus; give one HZ,CONTRAST per recording, in their order",
            args.recordings.len(),
            args.stimulus.len()
        )));
    }
    let files = args.recordings.iter().map(|path| read(path)).collect::<anyhow::Result<Vec<_>>>()?;
    let parts: Vec<_> = files
        .iter()
        .zip(&args.stimulus)
        .map(|(file, stimulus)| (file.events.as_slice(), file.size, *stimulus))
        .collect();
    let made: FlickerFit = calibrate_flicker(&parts, &base)?;
    tell(args, &names, &made.sensor, &made, &made.to_string())
}

fn tell(
    args: &CalibrateArgs,
    names: &[String],
    sensor: &SensorConfig,
    made: &impl serde::Serialize,
    table: &str,
) -> anyhow::Result<i32> {
    if let Some(output) = &args.output {
        let lines = table.lines().map(|line| format!("# {line}").trim_end().to_owned() + "\n");
        let head = format!("# evis calibrate {}\n", names.join(" ").replace(char::is_control, " "));
        let file = head + &lines.collect::<String>() + "\n" + &sensor.to_toml();
        evis_core::limits::write_whole(output, file.as_bytes())
            .with_context(|| format!("cannot write {}", output.display()))?;
    }
    if args.json {
        text::say_json(made)?;
    } else {
        text::say(table);
        match &args.output {
            Some(output) => text::say(&format!("{}", output.display())),
            None => text::say(&format!("\n{}", sensor.to_toml().trim_end())),
        }
    }
    Ok(0)
}
