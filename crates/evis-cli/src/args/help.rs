//! Help texts: the command with its examples, and the short help of `-h`.

use clap::builder::{Resettable, StyledStr};
use clap::{Command, CommandFactory};

use super::Cli;

/// Width that help texts are wrapped to, columns.
const COLUMNS: usize = 100;

/// Lines that the short help of a command has at most.
#[cfg(test)]
const SHORT_LINES: usize = 30;

/// Commands of the wheel's `evis` that are written in Python, and what they do.
pub(crate) const IN_PYTHON: [(&str, &str); 4] = [
    ("evaluate", "Ask networks whether they accept a recording's events: reconstruction, flow, matching"),
    ("view", "Show a recording in the viewer Rerun, or write a file for it"),
    ("plot", "Draw event rates, intervals, thumbnails, x-y-t clouds, and films"),
    ("dataset", "Simulate a data set of many recordings, on several processes or a Ray cluster"),
];

/// Examples of the whole program, without its name.
const FIRST_EXAMPLES: [&str; 4] = [
    "run warehouse -o events.h5 --duration 0.25",
    "preview events.h5 -o events.png",
    "video in.mp4 -o events.h5 --like v2e",
    "info scene.glb",
];

/// Examples of each command, without the program's name. The last thing that a help text shows.
const EXAMPLES: [(&str, &[&str]); 17] = [
    (
        "run",
        &[
            "run warehouse -o events.h5 --duration 0.25",
            "run model.glb -o events.h5 --camera-motion orbit --quality draft",
            "run spinner -o events.h5 --labels depth,flow,instance --label-rate 100",
            "run scene.toml -o events.h5 --sensor v2e --size 346x260 --seed 7",
        ],
    ),
    ("tune", &["tune scene.glb -o settings.toml", "run scene.glb -o events.h5 --settings settings.toml"]),
    (
        "video",
        &[
            "video in.mp4 -o events.h5",
            "video in.mp4 -o events.h5 --like v2e --size 346x260",
            "video in.mp4 -o events.h5 --upsample",
            "video frames/ -o events.h5 -o events.raw --fps 240 --sensor davis346",
        ],
    ),
    ("from-v2e", &["from-v2e -- --input in.mp4 --pos_thres 0.15 --cutoff_hz 30 --dvs346"]),
    (
        "preview",
        &[
            "preview events.h5 -o sheet.png",
            "preview events.h5 -o film.mp4 --slow 4 --background dark",
            "preview model.glb -o still.png --at 0.5",
        ],
    ),
    (
        "chart",
        &[
            "chart spinner -o chart.png --quick",
            "chart scene.glb -o chart.svg --report chart.json",
            "chart --from chart.json -o heavy.png --render-ms 10",
        ],
    ),
    (
        "truth",
        &[
            "truth spinner -o truth.h5 --size 160x120 --duration 0.1 --truth-pixels 300",
            "score events.h5 --truth truth.h5",
        ],
    ),
    (
        "verify",
        &["verify", "verify --scene spinner -o verify.png", "verify --light spinner --at 0.02 -o light.png"],
    ),
    (
        "convert",
        &[
            "convert events.h5 events.raw",
            "convert recording.aedat4 events.h5 --start 1 --end 3 --rebase",
            "convert in.raw flat.raw --undistort --calibration camchain.yaml",
        ],
    ),
    ("info", &["info events.h5", "info scene.glb", "info cut.h5 --repair"]),
    ("score", &["score events.h5 --truth truth.h5 --tolerance-us 1000,100"]),
    (
        "calibrate",
        &[
            "calibrate dark.h5 -o sensor.toml --base dvxplorer-like",
            "calibrate a.h5 b.h5 --stimulus 1,0.5 --stimulus 10,0.5",
        ],
    ),
    ("compare", &["compare recorded.h5 simulated.h5 -o figure.png"]),
    ("sensors", &["sensors", "run spinner -o events.h5 --sensor dvxplorer-like"]),
    ("scenes", &["scenes"]),
    ("devices", &["devices", "run spinner -o events.h5 --device 0"]),
    ("completions", &["completions bash"]),
];

/// The whole command line of `program`, which is `evis-rs` or `evis`.
pub(crate) fn command(program: &'static str) -> Command {
    let mut command = Cli::command().name(program).max_term_width(COLUMNS);
    for (name, examples) in EXAMPLES {
        command = command.mut_subcommand(name, |sub| sub.after_help(in_lines(program, examples)));
    }
    if program == "evis" {
        let help = listed(&command).render_long_help();
        command = command.override_help(help);
    }
    command
}

fn in_lines(program: &str, examples: &[&str]) -> String {
    let lines = examples.iter().map(|line| format!("\n  {program} {line}"));
    format!("Examples:{}", lines.collect::<String>())
}

/// `command` with all that its help lists: the wheel runs some commands itself, before this program sees them.
pub(crate) fn listed(command: &Command) -> Command {
    match command.get_name() {
        "evis" => command.clone().subcommands(IN_PYTHON.map(|(name, about)| Command::new(name).about(about))),
        _ => command.clone(),
    }
}

/// `command`, in which its help and that of every subcommand is the short one: one line per option, without the rare ones.
pub(crate) fn with_short_help(command: Command) -> Command {
    let overview = short_overview(&command);
    let command = command.override_help(overview);
    let mut built = command.clone();
    built.build();
    let names: Vec<_> = built.get_subcommands().map(|sub| sub.get_name().to_owned()).collect();
    names.into_iter().filter(|name| name != "help").fold(command, |command, name| {
        let Some(sub) = built.find_subcommand_mut(&name) else { return command };
        let short = short_help(sub);
        command.mut_subcommand(name, |sub| sub.override_help(short))
    })
}

/// The short help of the whole program.
fn short_overview(command: &Command) -> StyledStr {
    let program = command.get_name().to_owned();
    let mut listed = listed(command)
        .term_width(COLUMNS)
        .override_help(Resettable::Reset)
        .after_help(in_lines(&program, &FIRST_EXAMPLES))
        .disable_help_subcommand(true)
        .disable_version_flag(true)
        .mut_args(|arg| arg.hide(true));
    let more = format!(
        "{program} COMMAND -h shows a command's options, {program} --help what holds for all of them.\n"
    );
    let help = listed.render_help();
    StyledStr::from(dense(&help) + &more)
}

/// `help` without its empty lines, which would double its height: headings stand out by themselves. The line on `--help`
/// is left out as well, since who reads this has it.
fn dense(help: &StyledStr) -> String {
    let (styled, plain) = (help.ansi().to_string(), help.to_string());
    let shown = |line: &str| {
        let line = line.trim_start();
        !line.is_empty() && line != "Options:" && !line.starts_with("-h, --help")
    };
    let lines = styled.lines().zip(plain.lines()).filter(|(_, plain)| shown(plain));
    lines.map(|(styled, _)| format!("{styled}\n")).collect()
}

/// The short help of a built subcommand.
fn short_help(sub: &Command) -> StyledStr {
    let mut sub = sub.clone().term_width(COLUMNS).mut_args(|arg| arg.hide_possible_values(true));
    let name = sub.get_bin_name().unwrap_or_else(|| sub.get_name()).to_owned();
    // Switches count, --help does not.
    let all = sub.get_arguments().filter(|arg| !arg.is_positional() && arg.get_id() != "help").count();
    let help = sub.render_help();
    let more = match all {
        0 => String::new(),
        1 => format!("{name} --help explains its option.\n"),
        all => format!("{name} --help explains all {all} options.\n"),
    };
    StyledStr::from(dense(&help) + &more)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Short help of every subcommand, as plain text.
    fn short_helps(program: &'static str) -> Vec<(String, String)> {
        let mut built = command(program);
        built.build();
        let subs = built.get_subcommands().filter(|sub| sub.get_name() != "help");
        subs.map(|sub| (sub.get_name().to_owned(), short_help(sub).to_string())).collect()
    }

    /// What is wrong with a short help; `None` where it keeps its bounds.
    fn too_large(text: &str) -> Option<String> {
        let lines = text.lines().count();
        let wide = text.lines().find(|line| line.chars().count() > COLUMNS);
        match wide {
            _ if lines > SHORT_LINES => Some(format!("{lines} lines")),
            Some(line) => Some(format!("too wide: {line}")),
            None => None,
        }
    }

    #[test]
    fn short_help_keeps_its_bounds_and_names_the_program() {
        let mut helps = short_helps("evis");
        assert!(helps.len() > 10);
        let whole = |program| with_short_help(command(program)).render_help().to_string();
        helps.push(("evis".into(), whole("evis")));
        for (name, text) in helps {
            assert_eq!(too_large(&text), None, "{name}:\n{text}");
            assert!(!text.contains("evis-rs"), "{name}:\n{text}");
        }
        let of = |name: &str| short_helps("evis-rs").into_iter().find(|(known, _)| known == name).unwrap().1;
        for name in ["run", "video"] {
            assert_eq!(of(name).matches(&format!("\n  evis-rs {name} ")).count(), 4, "{}", of(name));
        }
        for program in ["evis", "evis-rs"] {
            let (short, long) = (whole(program), command(program).render_long_help().to_string());
            assert_eq!(short.matches(&format!("\n  {program} ")).count(), 4, "{short}");
            // The program of the package lists what it runs itself, everywhere, and no other program does.
            for (name, about) in IN_PYTHON {
                let is_listed = |text: &str| {
                    text.lines().any(|line| line.starts_with(&format!("  {name} ")) && line.ends_with(about))
                };
                assert_eq!([is_listed(&short), is_listed(&long)], [program == "evis"; 2], "{short}{long}");
            }
            assert!(!short.contains("Exit codes") && long.contains("Exit codes"), "{short}{long}");
        }
        for heading in ["Scene:", "Output:", "Labels:", "Sensor:", "Quality:", "Device:"] {
            assert!(of("run").lines().any(|line| line == heading), "{heading}\n{}", of("run"));
        }
        // --camera, --repair, --check, --json, and what hidden lines have besides: as many as the long help shows.
        for name in ["info", "run", "devices"] {
            let mut built = command("evis-rs");
            built.build();
            let sub = built.find_subcommand_mut(name).unwrap();
            let long = sub.render_long_help().to_string();
            let options = |line: &&str| line.trim_start().starts_with('-') && line.contains("--");
            let shown = long.lines().filter(options).filter(|line| !line.contains("--help")).count();
            let told = if shown == 1 { "its option".to_owned() } else { format!("all {shown} options") };
            assert!(of(name).contains(&told), "{name}: {shown}\n{}", of(name));
        }
        // Canaries: one line more, one column more.
        assert!(too_large(&"x\n".repeat(SHORT_LINES + 1)).is_some());
        assert!(too_large(&"x".repeat(COLUMNS + 1)).is_some());
    }

    /// Options of `command` that stand under no heading.
    fn without_heading(command: &Command) -> Vec<String> {
        let own = |arg: &&clap::Arg| !["help", "version"].contains(&arg.get_id().as_str());
        let none = command.get_opts().filter(own).filter(|arg| arg.get_help_heading().is_none());
        none.map(|arg| format!("{} {}", command.get_name(), arg.get_id())).collect()
    }

    #[test]
    fn every_option_stands_under_a_heading() {
        let mut built = command("evis-rs");
        built.build();
        for sub in built.get_subcommands().filter(|sub| sub.get_name() != "help") {
            assert_eq!(without_heading(sub), [""; 0]);
        }
        let canary = Command::new("x").arg(clap::Arg::new("lost").long("lost"));
        assert_eq!(without_heading(&canary), ["x lost"]);
    }

    #[test]
    fn examples_are_command_lines_that_are_taken() {
        let taken = |line: &str| command("evis-rs").try_get_matches_from(line.split_whitespace()).is_ok();
        let examples = EXAMPLES.iter().copied().chain([("the whole program", FIRST_EXAMPLES.as_slice())]);
        for (name, examples) in examples {
            for line in examples {
                assert!(taken(&format!("evis-rs {line}")), "{name}: {line}");
            }
        }
        assert!(!taken("evis-rs run spinner"), "canary: there is no output");
    }

    #[test]
    fn the_whole_help_has_what_the_short_one_hides() {
        let mut built = with_short_help(command("evis-rs"));
        built.build();
        let short = built.find_subcommand_mut("run").unwrap().render_long_help().to_string();
        let mut whole = command("evis-rs");
        whole.build();
        let long = whole.find_subcommand_mut("run").unwrap().render_long_help().to_string();
        for option in ["--texture-taps", "--keyframe-rate", "--memory-limit"] {
            assert!(long.contains(option) && !short.contains(option), "{option}\n{short}");
        }
    }
}
