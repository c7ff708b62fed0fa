//! `from-v2e`: v2e's command line goes in, ours comes out.
//!
//! v2e's options and their defaults: `v2ecore/v2e_args.py` of SensorsINI/v2e.

use std::path::{Path, PathBuf};

use evis_chart::shell_quoted;
use evis_core::SensorConfig;
use evis_core::limits::nearest;
use evis_core::sensor::NoiseLaw;

use crate::args::FromV2eArgs;
use crate::failure::bad_input;
use crate::text;

/// What one of v2e's options is to us.
#[derive(Clone, Copy, Debug)]
enum Meaning {
    /// A value of the sensor, times a factor.
    Set(&'static str, f64),
    /// An option of `video` with the same value.
    Same(&'static str),
    /// Something that is put together with others; see [`Line`].
    Part,
    /// What v2e shows or writes beside events: left out without a word.
    Left,
    /// Something that `video` does not have, and what to do instead.
    None(&'static str),
}

/// How many values an option takes.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Values {
    No,
    One,
    /// One, or none.
    Maybe,
    Many,
}

use Meaning::{Left, None as Missing, Part, Same, Set};
use Values::{Many, Maybe, No, One};

/// Mean of v2e's factor 10^(0.1 n) with normal n, by which its leak is above the rate that is asked for: e^((0.1 ln 10)²/2).
const LEAK_FACTOR: f64 = 1.026_864_4;

const NOT_IN_VIDEO: &str = "there is nothing like it";

/// v2e's options, what each takes and what it is to us.
const OPTIONS: [(&str, Values, Meaning); 60] = [
    ("--input", One, Part),
    ("-i", One, Part),
    ("--output_folder", One, Part),
    ("-o", One, Part),
    ("--dvs_h5", One, Part),
    ("--dvs_aedat2", One, Part),
    ("--dvs_aedat4", One, Part),
    ("--dvs_text", One, Part),
    ("--overwrite", No, Part),
    ("--dvs_params", One, Part),
    ("--pos_thres", One, Set("threshold_on", 1.0)),
    ("--neg_thres", One, Set("threshold_off", 1.0)),
    ("--sigma_thres", One, Set("pattern.sigma", 1.0)),
    ("--cutoff_hz", One, Set("photoreceptor.cutoff_hz", 1.0)),
    ("--leak_rate_hz", One, Set("noise.leak_hz", LEAK_FACTOR)),
    ("--shot_noise_rate_hz", One, Set("noise.shot_hz", 1.0)),
    ("--leak_jitter_fraction", One, Set("noise.leak_jitter", 1.0)),
    ("--noise_rate_cov_decades", One, Set("noise.leak_spread_decades", 1.0)),
    ("--refractory_period", One, Set("refractory.period_us", 1e6)),
    ("--photoreceptor_noise", No, Part),
    ("--dvs_emulator_seed", One, Same("--seed")),
    ("--output_width", One, Part),
    ("--output_height", One, Part),
    ("--dvs128", No, Part),
    ("--dvs240", No, Part),
    ("--dvs346", No, Part),
    ("--dvs640", No, Part),
    ("--dvs1024", No, Part),
    ("--input_frame_rate", One, Same("--fps")),
    ("--input_slowmotion_factor", One, Part),
    ("--start_time", One, Same("--start")),
    ("--stop_time", One, Part),
    ("--disable_slomo", No, Part),
    ("--crop", One, Missing("crop the film first, such as with ffmpeg's filter crop")),
    ("--hdr", No, Missing("frames are linear light here: give float frames, not their logarithm")),
    ("--synthetic_input", One, Missing("push its frames to evis.EventEmulator in Python")),
    ("--scidvs", No, Missing(NOT_IN_VIDEO)),
    ("--cs_lambda_pixels", One, Missing(NOT_IN_VIDEO)),
    ("--cs_tau_p_ms", One, Missing(NOT_IN_VIDEO)),
    ("--label_signal_noise", No, Missing("the label cause of `run` has it, for scenes")),
    ("--ddd_output", No, Missing(NOT_IN_VIDEO)),
    ("--davis_output", No, Missing(NOT_IN_VIDEO)),
    ("--record_single_pixel_states", One, Missing(NOT_IN_VIDEO)),
    ("--auto_timestamp_resolution", Maybe, Left),
    ("--timestamp_resolution", One, Left),
    ("--slomo_model", One, Left),
    ("--batch_size", One, Left),
    ("--vid_orig", One, Left),
    ("--vid_slomo", One, Left),
    ("--slomo_stats_plot", No, Left),
    ("--avi_frame_rate", One, Left),
    ("--output_in_place", Maybe, Left),
    ("--unique_output_folder", Maybe, Left),
    ("--skip_video_output", No, Left),
    ("--show_dvs_model_state", Many, Left),
    ("--save_dvs_model_state", No, Left),
    ("--dvs_exposure", Many, Left),
    ("--dvs_vid", One, Left),
    ("--dvs_vid_full_scale", One, Left),
    ("--no_preview", No, Left),
];

/// Prints our command line, and what it leaves out on standard error.
pub(crate) fn from_v2e(args: &FromV2eArgs, program: &str) -> anyhow::Result<i32> {
    let (words, notes) = translate(&args.line, program)?;
    let line: Vec<_> = words.iter().map(|word| shell_quoted(word)).collect();
    text::say(&format!("{program} {}", line.join(" ")));
    for note in notes {
        text::complain(&format!("note: {note}"));
    }
    Ok(0)
}

/// What is put together of several options.
#[derive(Debug, Default)]
struct Line {
    input: Option<String>,
    folder: Option<String>,
    files: Vec<String>,
    params: Option<String>,
    width: Option<String>,
    height: Option<String>,
    size: Option<&'static str>,
    stop: Option<String>,
    start: Option<String>,
    slow: Option<String>,
    fps: Option<String>,
    photoreceptor_noise: bool,
    without_slomo: bool,
    force: bool,
    /// Values of the sensor.
    set: Vec<String>,
    /// Options that stand as they are.
    same: Vec<String>,
    notes: Vec<String>,
}

/// Our arguments, and what they leave out.
fn translate(given: &[String], program: &str) -> anyhow::Result<(Vec<String>, Vec<String>)> {
    let mut line = Line::default();
    // `python v2e.py --input …`, `v2e -i …`: what comes before the first option is the program.
    let mut words = given.iter().skip_while(|word| !word.starts_with('-')).peekable();
    while let Some(word) = words.next() {
        let (name, joined) = match word.split_once('=') {
            Some((name, value)) if word.starts_with("--") => (name, Some(value.to_owned())),
            _ => (word.as_str(), None),
        };
        let &(name, values, meaning) = option(name)?;
        let is_value = |word: &&String| !word.starts_with('-') || word.parse::<f64>().is_ok();
        let mut value = joined;
        match values {
            One if value.is_none() => {
                let next = words.next_if(is_value);
                value = Some(
                    next.cloned().ok_or_else(|| bad_input(format!("v2e's {name} takes a value; add it")))?,
                );
            }
            Maybe if value.is_none() => value = words.next_if(is_value).cloned(),
            Many => while words.next_if(is_value).is_some() {},
            _ => {}
        }
        line.take(name, meaning, value.unwrap_or_default())?;
    }
    line.words(program)
}

/// The option that `name` is, in full or, as v2e takes it, by a beginning that no other option has.
fn option(name: &str) -> anyhow::Result<&'static (&'static str, Values, Meaning)> {
    if let Some(option) = OPTIONS.iter().find(|(known, ..)| *known == name) {
        return Ok(option);
    }
    let begins = |known: &str| name.len() > 2 && name.starts_with("--") && known.starts_with(name);
    let begun: Vec<_> = OPTIONS.iter().filter(|(known, ..)| begins(known)).collect();
    match begun.as_slice() {
        [] => Err(bad_input(format!("{name} is no option of v2e{}", hint(name)))),
        [option] => Ok(option),
        several => {
            let names: Vec<_> = several.iter().map(|(known, ..)| *known).collect();
            Err(bad_input(format!(
                "v2e has several options that begin with {name}; write one of {} in full",
                names.join(", ")
            )))
        }
    }
}

/// The option that `name` is like, or that alone has it as one of its words.
fn hint(name: &str) -> String {
    // Dashes, which all options begin with, would make any two of them alike.
    let bare = name.trim_start_matches('-').replace('-', "_").to_ascii_lowercase();
    let known = OPTIONS.iter().filter_map(|(known, ..)| known.strip_prefix("--"));
    // What comes to nothing here is not what was meant.
    let used = OPTIONS.iter().filter(|(.., meaning)| !matches!(meaning, Left));
    let used = used.filter_map(|(known, ..)| known.strip_prefix("--"));
    let mut of_word = used.filter(|known| known.split('_').any(|word| word == bare));
    let only = of_word.next().filter(|_| of_word.next().is_none());
    nearest(&bare, known)
        .or(only)
        .map_or_else(|| "; `v2e --help` lists them".to_owned(), |near| format!(" (did you mean '--{near}'?)"))
}

impl Line {
    fn take(&mut self, name: &str, meaning: Meaning, value: String) -> anyhow::Result<()> {
        match meaning {
            Left => {}
            Missing(instead) => self.notes.push(format!("{name} is left out: {instead}")),
            Set(key, factor) => {
                let number = number(name, &value)?;
                self.set.push(format!("{key}={}", rounded(number * factor)));
            }
            Same(option) => {
                number(name, &value)?;
                match option {
                    "--start" => self.start = Some(value),
                    "--fps" => self.fps = Some(value),
                    _ => self.same.extend([option.to_owned(), value]),
                }
            }
            Part => self.part(name, value)?,
        }
        Ok(())
    }

    fn part(&mut self, name: &str, value: String) -> anyhow::Result<()> {
        match name {
            "--input" | "-i" => self.input = Some(value),
            "--output_folder" | "-o" => self.folder = Some(value),
            "--overwrite" => self.force = true,
            "--dvs_params" => self.params = Some(value).filter(|value| value != "None"),
            "--photoreceptor_noise" => self.photoreceptor_noise = true,
            "--disable_slomo" => self.without_slomo = true,
            "--output_width" => self.width = Some(value),
            "--output_height" => self.height = Some(value),
            "--dvs128" => self.size = Some("128x128"),
            "--dvs240" => self.size = Some("240x180"),
            "--dvs346" => self.size = Some("346x260"),
            "--dvs640" => self.size = Some("640x480"),
            "--dvs1024" => self.size = Some("1024x768"),
            "--stop_time" => self.stop = Some(value),
            "--input_slowmotion_factor" => self.slow = Some(value),
            _ if value.eq_ignore_ascii_case("none") => {}
            "--dvs_h5" => self.files.push(ending(&value, "h5")),
            "--dvs_aedat2" => self.files.push(ending(&value, "aedat")),
            "--dvs_aedat4" => self.files.push(ending(&value, "aedat4")),
            _ => self.files.push(ending(&value, "txt")),
        }
        Ok(())
    }

    /// Our arguments, and what they leave out.
    fn words(mut self, program: &str) -> anyhow::Result<(Vec<String>, Vec<String>)> {
        let Some(input) = self.input.take() else {
            return Err(bad_input("v2e's command line names no input; add --input FILE to it"));
        };
        let like = match self.params.as_deref() {
            None => "v2e",
            Some("clean") => "v2e-clean",
            Some("noisy") => "v2e-noisy",
            Some(other) => {
                return Err(bad_input(format!(
                    "--dvs_params {other}: v2e has clean and noisy; take one of them"
                )));
            }
        };
        let mut words = vec!["video".to_owned(), input];
        if self.files.is_empty() {
            self.files.push("events.h5".into());
        }
        for file in &self.files {
            let folder = self.folder.as_deref().map(Path::new);
            let path = folder.map_or_else(|| PathBuf::from(file), |folder| folder.join(file));
            words.extend(["-o".to_owned(), path.display().to_string()]);
        }
        words.extend(["--like".to_owned(), like.to_owned()]);
        self.noise(like)?;
        if self.params.is_some() && !self.set.is_empty() {
            let set: Vec<_> = self.set.drain(..).collect();
            self.notes.push(format!("{} is left out, as v2e does with --dvs_params", set.join(", ")));
        }
        for assignment in &self.set {
            words.extend(["--set".to_owned(), assignment.clone()]);
        }
        let size = match (self.size, &self.width, &self.height) {
            (Some(size), ..) => Some(size.to_owned()),
            (None, Some(width), Some(height)) => Some(format!("{width}x{height}")),
            (None, None, None) => None,
            _ => return Err(bad_input("v2e's --output_width and --output_height go together; give both")),
        };
        let duration = match (&self.start, &self.stop) {
            (_, None) => None,
            (start, Some(stop)) => {
                let start = start.as_deref().map_or(Ok(0.0), |start| number("--start_time", start))?;
                Some(rounded(number("--stop_time", stop)? - start))
            }
        };
        let fps = self.frames_per_second()?;
        for (option, value) in
            [("--size", size), ("--fps", fps), ("--start", self.start), ("--duration", duration)]
        {
            words.extend(value.into_iter().flat_map(|value| [option.to_owned(), value]));
        }
        words.extend(self.same);
        if self.force {
            words.push("--force".into());
        }
        // Only the Python package can.
        if !self.without_slomo && program == "evis" {
            words.push("--upsample".into());
        } else if !self.without_slomo {
            self.notes.push(
                "v2e puts frames between the film's own unless --disable_slomo is given; `evis video --upsample`, the command of \
                 the Python package, does too"
                    .into(),
            );
        }
        Ok((words, self.notes))
    }

    /// v2e's photoreceptor noise has the rate that shot noise is asked for, and takes its place.
    fn noise(&mut self, like: &str) -> anyhow::Result<()> {
        if !self.photoreceptor_noise || self.params.is_some() {
            return Ok(());
        }
        let mut sensor = SensorConfig::preset(like)?;
        for assignment in &self.set {
            sensor.set(assignment)?;
        }
        let rate_hz = f64::from(sensor.noise.shot_hz);
        let noise = sensor.photoreceptor_noise_for(rate_hz, NoiseLaw::V2e)?;
        self.set.retain(|assignment| !assignment.starts_with("noise.shot_hz="));
        self.set.extend(["noise.shot_hz=0".to_owned(), format!("photoreceptor.noise={noise}")]);
        Ok(())
    }

    /// Frames per second of a film that was slowed down, where both are known.
    fn frames_per_second(&mut self) -> anyhow::Result<Option<String>> {
        let slow = self.slow.as_deref().map_or(Ok(1.0), |slow| number("--input_slowmotion_factor", slow))?;
        if slow != 1.0 && self.fps.is_none() {
            self.notes.push(format!(
                "--input_slowmotion_factor {slow} is left out: give --fps, the film's own rate times {slow}"
            ));
        }
        Ok(self.fps.clone())
    }
}

/// `name` with `ending`, where it has none, as v2e has it.
fn ending(name: &str, ending: &str) -> String {
    if Path::new(name).extension().is_some() { name.to_owned() } else { format!("{name}.{ending}") }
}

fn number(name: &str, value: &str) -> anyhow::Result<f64> {
    let number = value.trim().parse::<f64>().ok().filter(|number| number.is_finite());
    number.ok_or_else(|| bad_input(format!("v2e's {name} is '{value}'; it must be a number")))
}

/// A number as text, without what rounding left of it.
fn rounded(value: f64) -> String {
    let text = format!("{value:.9}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(line: &str) -> (String, String) {
        let given: Vec<_> = line.split(' ').map(str::to_owned).collect();
        let (words, notes) = translate(&given, "evis-rs").unwrap();
        (words.join(" "), notes.join("\n"))
    }

    fn refused(line: &str) -> String {
        let given: Vec<_> = line.split(' ').map(str::to_owned).collect();
        translate(&given, "evis-rs").unwrap_err().to_string()
    }

    #[test]
    fn a_command_line_of_v2e_becomes_ours() {
        let (line, notes) = told(
            "v2e.py -i in.mp4 -o out --dvs_h5 events --dvs_text=None --pos_thres=.15 --neg_thres .25 --sigma_thres 0.03 \
             --cutoff_hz 30 --leak_rate_hz 0.1 --refractory_period 0.001 --dvs346 --start_time 1 --stop_time 3.5 \
             --disable_slomo --no_preview --dvs_exposure duration 0.005 --overwrite --dvs_emulator_seed 7",
        );
        assert_eq!(
            line,
            "video in.mp4 -o out/events.h5 --like v2e --set threshold_on=0.15 --set threshold_off=0.25 --set pattern.sigma=0.03 \
             --set photoreceptor.cutoff_hz=30 --set noise.leak_hz=0.10268644 --set refractory.period_us=1000 --size 346x260 \
             --start 1 --duration 2.5 --seed 7 --force"
        );
        assert_eq!(notes, "");
        let (line, notes) =
            told("--input in.avi --dvs_params noisy --pos_thres 0.3 --crop (1,1,0,0) --disable_slomo");
        assert_eq!(line, "video in.avi -o events.h5 --like v2e-noisy");
        assert!(
            notes.contains("threshold_on=0.3 is left out") && notes.contains("--crop is left out"),
            "{notes}"
        );
        assert!(told("-i in.mp4").1.contains("evis video --upsample"));
        let (words, notes) = translate(&["-i".to_owned(), "in.mp4".to_owned()], "evis").unwrap();
        assert_eq!(words.join(" "), "video in.mp4 -o events.h5 --like v2e --upsample");
        assert!(notes.is_empty(), "{notes:?}");
    }

    #[test]
    fn the_sensor_is_what_v2e_has() {
        let (line, _) =
            told("-i a --leak_rate_hz 0.01 --shot_noise_rate_hz 0.001 --refractory_period 0.0005");
        let mut sensor = SensorConfig::preset("v2e").unwrap();
        for assignment in line.split(" --set ").skip(1) {
            sensor.set(assignment).unwrap();
        }
        // v2e's defaults, spelled out, are the preset.
        let preset = SensorConfig::preset("v2e").unwrap();
        assert!((sensor.noise.leak_hz - preset.noise.leak_hz).abs() < 1e-6);
        sensor.noise.leak_hz = preset.noise.leak_hz;
        assert_eq!(sensor, preset);
        let (line, _) = told("-i a --photoreceptor_noise --shot_noise_rate_hz 1 --cutoff_hz 100");
        assert!(line.contains("noise.shot_hz=0") && line.contains("photoreceptor.noise=0."), "{line}");
        assert!(!line.contains("noise.shot_hz=1"), "{line}");
    }

    #[test]
    fn what_is_no_command_line_of_v2e_is_refused() {
        assert!(refused("-i a --pos_thresh 0.2").contains("did you mean '--pos_thres'"));
        assert!(refused("-i a --pos_thres high").contains("must be a number"));
        assert!(refused("-i a --pos_thres").contains("takes a value"));
        assert!(refused("--pos_thres 0.2").contains("no input"));
        assert!(refused("-i a --output_width 100").contains("go together"));
        assert!(refused("-i a --dvs_params dark").contains("clean and noisy"));
    }

    /// What is said of a command line whose dashes are written as `~`: it names options that neither program has.
    fn refused_of(line: &str) -> String {
        refused(&line.replace('~', "--"))
    }

    #[test]
    fn a_beginning_names_an_option_as_in_v2e() {
        let short = told(&"~input a ~disable ~pos 0.3 ~cutoff=9".replace('~', "--"));
        assert_eq!(short, told("-i a --disable_slomo --pos_thres 0.3 --cutoff_hz 9"));
        let several = refused_of("-i a ~output_f x ~dvs_a y");
        assert!(several.contains("--dvs_aedat2, --dvs_aedat4") && several.contains("in full"), "{several}");
        assert!(refused_of("-i a ~leak 1").contains("--leak_rate_hz, --leak_jitter_fraction"));
    }

    #[test]
    fn only_what_is_like_an_option_is_suggested() {
        for (word, near) in [
            ("pos_thresh", "--pos_thres"),
            ("dvs-h5", "--dvs_h5"),
            ("output_foldr", "--output_folder"),
            ("seed", "--dvs_emulator_seed"),
            ("preview", "--no_preview"),
            ("dvs_text_file", "--dvs_text"),
            ("leak_rate_Hz", "--leak_rate_hz"),
        ] {
            let told = refused_of(&format!("-i a ~{word} 1"));
            assert!(told.ends_with(&format!("is no option of v2e (did you mean '{near}'?)")), "{told}");
        }
        // By their dashes alone, each of these is like some option.
        for word in ["frobnicate", "verbose", "size", "fps", "duration", "gpu"] {
            let told = refused_of(&format!("-i a ~{word} 1"));
            assert!(told.ends_with("is no option of v2e; `v2e --help` lists them"), "{told}");
        }
    }

    #[test]
    fn what_comes_out_is_taken_by_video() {
        let (line, _) =
            told("-i in.mp4 --pos_thres 0.2 --output_width 64 --output_height 48 --dvs_aedat4 a --dvs_h5 b");
        let words = ["evis-rs"].into_iter().chain(line.split(' '));
        crate::args::help::command("evis-rs").try_get_matches_from(words).unwrap();
    }

    #[test]
    fn the_documents_list_every_option() {
        let page = include_str!("../../../docs/video.md");
        let listed = |name: &str| page.contains(&format!("`{name}`"));
        let ours = OPTIONS.iter().filter(|(.., meaning)| !matches!(meaning, Left));
        let missing: Vec<_> = ours.map(|(name, ..)| *name).filter(|name| !listed(name)).collect();
        assert_eq!(missing, [""; 0]);
        assert!(!listed("nothing at all"), "canary");
    }
}
