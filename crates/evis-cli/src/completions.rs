//! `completions`: a script for a shell.

use crate::args::{CompletionsArgs, help};
use crate::text;

/// Prints the script for `program`.
pub(crate) fn completions(args: &CompletionsArgs, program: &'static str) -> anyhow::Result<i32> {
    let mut command = help::listed(&help::command(program));
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, program, &mut script);
    text::say(String::from_utf8(script)?.trim_end());
    Ok(0)
}
