//! The command line, as a library: the binary `evis-rs` and the wheel's `evis` run the same code.

mod args;
mod calibrate;
mod chart;
mod compare;
mod completions;
mod convert;
mod extent;
mod failure;
mod flags;
mod from_v2e;
mod info;
mod interrupt;
mod label_picture;
mod list;
mod options;
mod outputs;
mod picture;
mod preview;
mod progress;
mod run;
mod scene_info;
mod scene_source;
mod score;
mod sensor_source;
mod still;
mod text;
mod trace;
mod truth;
mod tune;
mod undistort;
mod verify;
mod video;
mod warnings;

use std::path::Path;

use clap::FromArgMatches;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use evis_core::LabelKind;
use evis_video::{Upsampler, VideoError};

use crate::args::{Cli, Command};

/// Makes what `video --upsample` puts between frames: by the network in a file, or by optical flow.
pub type MakeUpsampler = dyn Fn(Option<&Path>) -> Result<Box<dyn Upsampler>, VideoError> + Sync;

/// Runs the command line `args` (program name first) and returns the exit code: 0 for success, 2 for bad
/// input (arguments, files, no usable device, no space), 1 for a failure, 130 when interrupted.
///
/// Help texts show the program name of `args[0]`. While it runs, SIGINT and SIGTERM end the stream in good
/// order: the file is finished; a second one ends the process.
pub fn run(args: Vec<String>) -> i32 {
    run_with(args, &|_| {
        let told = "evis-rs has no optical flow and runs no network; `evis video`, the command of the Python package, does";
        Err(VideoError::Between(told.into()))
    })
}

/// As [`run`], with `upsampler` for `video --upsample`.
pub fn run_with(args: Vec<String>, upsampler: &MakeUpsampler) -> i32 {
    let (cli, program) = match parse(args) {
        Ok(parsed) => parsed,
        Err(error) => {
            // A closed pipe leaves nobody to tell.
            let _ = error.print();
            return error.exit_code();
        }
    };
    if let Some(bytes) = cli.memory_limit {
        evis_core::limits::set_memory_limit(bytes);
    }
    if cli.allow_outside {
        evis_core::limits::set_allow_outside(true);
    }
    let done = match cli.command {
        Command::Run(args) => run::run(&args),
        Command::Tune(args) => tune::tune(&args),
        Command::Video(args) => video::video(&args, upsampler),
        Command::FromV2e(args) => from_v2e::from_v2e(&args, program),
        Command::Preview(args) => preview::preview(&args),
        Command::Chart(args) => chart::chart(&args, program),
        Command::Truth(args) => truth::truth(&args),
        Command::Verify(args) => verify::verify(&args),
        Command::Convert(args) => convert::convert(&args),
        Command::Info(args) => info::info(&args),
        Command::Score(args) => score::run(&args),
        Command::Calibrate(args) => calibrate::calibrate(&args),
        Command::Compare(args) => compare::compare(&args),
        Command::Scenes(args) => list::scenes(&args),
        Command::Sensors(args) => list::sensors(&args),
        Command::Devices(args) => list::devices(&args),
        Command::Completions(args) => completions::completions(&args, program),
    };
    match done {
        Ok(code) => code,
        Err(error) => {
            text::complain(&format!("error: {}", failure::describe(&error)));
            failure::exit_code(&error)
        }
    }
}

/// `error` with what was probably meant, where clap does not say it.
fn hinted(mut error: clap::Error, command: &clap::Command, args: &[String]) -> clap::Error {
    let is_label = |word: &&String| LabelKind::WORDS.iter().any(|(label, _)| label == word);
    let of_labels = args.iter().position(|arg| arg == "--labels").map(|at| &args[at + 1..]);
    let labels: Vec<_> = of_labels.into_iter().flatten().take_while(is_label).map(String::as_str).collect();
    let given = args.get(1).map_or("", String::as_str);
    let in_python = args::help::IN_PYTHON.map(|(name, _)| name);
    match error.kind() {
        ErrorKind::UnknownArgument if labels.len() > 1 => {
            let tip = format!("labels are one list: --labels {}", labels.join(","));
            error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
        }
        ErrorKind::InvalidSubcommand if in_python.contains(&given) => {
            error.remove(ContextKind::SuggestedSubcommand);
            let tip = format!("`evis {given}` is a command of the Python package");
            error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
        }
        ErrorKind::InvalidSubcommand => {
            let known = command.get_subcommands().map(clap::Command::get_name).chain(in_python);
            if let Some(near) = evis_core::limits::nearest(given, known) {
                let near = ContextValue::Strings(vec![near.to_owned()]);
                error.insert(ContextKind::SuggestedSubcommand, near);
            }
        }
        _ => {}
    }
    error
}

fn parse(args: Vec<String>) -> Result<(Cli, &'static str), clap::Error> {
    // The wheel installs the same program as `evis`; `--version` then says so too.
    let called_evis = args
        .first()
        .and_then(|program| std::path::Path::new(program).file_stem())
        .is_some_and(|stem| stem == "evis");
    let name = if called_evis { "evis" } else { "evis-rs" };
    let mut command = args::help::command(name);
    if args.iter().any(|arg| arg == "-h") {
        command = args::help::with_short_help(command);
    }
    let matches =
        command.clone().try_get_matches_from(&args).map_err(|error| hinted(error, &command, &args))?;
    Ok((Cli::from_arg_matches(&matches)?, name))
}
