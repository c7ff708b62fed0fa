//! `completions`: a script for a shell.

use clap::Command;

use crate::args::{CompletionsArgs, help};
use crate::text;

/// Commands of the wheel's `evis` that are written in Python, and what they do.
const IN_PYTHON: [(&str, &str); 4] = [
    ("dataset", "Simulate data sets from a specification, in sharded files"),
    ("evaluate", "Ask networks whether they accept a recording's events"),
    ("view", "Show a recording in the viewer Rerun"),
    ("plot", "Draw event rates, intervals, thumbnails, x-y-t clouds, and films"),
];

/// Prints the script for `program`.
pub(crate) fn completions(args: &CompletionsArgs, program: &'static str) -> anyhow::Result<i32> {
    let mut command = help::command(program);
    if program == "evis" {
        command = command.subcommands(IN_PYTHON.map(|(name, about)| Command::new(name).about(about)));
    }
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, program, &mut script);
    text::say(String::from_utf8(script)?.trim_end());
    Ok(0)
}
