//! Names the commit that the program is built from, for `--version`; sources without a repository have none.

use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-env-changed=EVIS_COMMIT");
    if let Some(log) = git(&["rev-parse", "--git-path", "logs/HEAD"])
        && std::path::Path::new(&log).exists()
    {
        println!("cargo::rerun-if-changed={log}");
    }
    // Who builds from an archive may name the commit.
    let commit = std::env::var("EVIS_COMMIT").ok().or_else(|| git(&["rev-parse", "--short=10", "HEAD"]));
    let of =
        commit.filter(|commit| !commit.is_empty()).map_or_else(String::new, |commit| format!(" ({commit})"));
    println!("cargo::rustc-env=EVIS_VERSION={}{of}", env!("CARGO_PKG_VERSION"));
}

/// What git answers, if it is there and this is a repository.
fn git(arguments: &[&str]) -> Option<String> {
    let output =
        Command::new("git").args(arguments).output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned())
}
