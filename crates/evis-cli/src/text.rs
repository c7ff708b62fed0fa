//! Output: text for people, JSON for machines; a closed pipe ends quietly.

use std::io::Write;
use std::path::Path;

use anyhow::Context;
use evis_core::limits::printable;
use serde::Serialize;

/// Writes `text` and a line break to standard output.
pub(crate) fn say(text: &str) {
    // The reader may have gone (`| head`): nobody is left to tell.
    let _ = writeln!(std::io::stdout().lock(), "{}", printable(text));
}

/// Writes `text` and a line break to standard error.
pub(crate) fn complain(text: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{}", printable(text));
}

/// Writes a warning of a library, with options in place of settings.
pub(crate) fn warn(warning: &str) {
    complain(&format!("warning: {}", crate::options::in_text(warning)));
}

/// Writes `value` as indented JSON to standard output.
pub(crate) fn say_json(value: &impl Serialize) -> anyhow::Result<()> {
    say(&serde_json::to_string_pretty(value)?);
    Ok(())
}

/// Writes `value` as indented JSON to the file `path`.
pub(crate) fn write_json(path: &Path, value: &impl Serialize) -> anyhow::Result<()> {
    let json = serde_json::to_string_pretty(value)? + "\n";
    evis_core::limits::write_whole(path, json.as_bytes())
        .with_context(|| format!("cannot write {}", path.display()))
}

/// `12 345 678`, with spaces that do not break.
pub(crate) fn grouped(n: u64) -> String {
    let digits = n.to_string();
    let mut out = String::with_capacity(digits.len() * 2);
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push('\u{a0}');
        }
        out.push(digit);
    }
    out
}

/// `1.23 M`, three significant digits.
pub(crate) fn short(value: f64) -> String {
    let (scaled, unit) = match value.abs() {
        v if v >= 1.0e9 => (value / 1.0e9, " G"),
        v if v >= 1.0e6 => (value / 1.0e6, " M"),
        v if v >= 1.0e3 => (value / 1.0e3, " k"),
        _ => (value, ""),
    };
    let decimals = if scaled.abs() >= 100.0 {
        0
    } else if scaled.abs() >= 10.0 {
        1
    } else {
        2
    };
    format!("{scaled:.decimals$}{unit}")
}

/// `text` in lines of 100 columns at most, each `indent` columns in.
pub(crate) fn wrapped(text: &str, indent: usize) -> String {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let last = lines.len() - 1;
        let line = &mut lines[last];
        if line.is_empty() {
            line.push_str(word);
        } else if indent + line.chars().count() + 1 + word.chars().count() <= 100 {
            line.push(' ');
            line.push_str(word);
        } else {
            lines.push(word.to_owned());
        }
    }
    let margin = " ".repeat(indent);
    lines.iter().map(|line| format!("{margin}{line}")).collect::<Vec<_>>().join("\n")
}

/// Microseconds as seconds, without trailing zeros.
pub(crate) fn seconds(t_us: i64) -> String {
    format!("{} s", t_us as f64 / 1.0e6)
}

/// A length of time as people say it: `45 s`, `3 min`, `2.5 h`.
pub(crate) fn about(time: std::time::Duration) -> String {
    match time.as_secs_f64() {
        s if s < 9.95 => format!("{s:.1} s"),
        s if s < 90.0 => format!("{s:.0} s"),
        s if s < 5400.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

/// What a length of time that is not known well will be.
pub(crate) fn roughly(time: std::time::Duration) -> String {
    match time.as_secs_f64() {
        s if s < 10.0 => "a few seconds".to_owned(),
        s if s < 87.5 => format!("about {:.0} s", (s / 5.0).round() * 5.0),
        _ => format!("about {}", about(time.max(std::time::Duration::from_secs(90)))),
    }
}

/// Two significant digits of what is below 10, else whole.
pub(crate) fn significant(value: f64) -> String {
    let decimals = if value > 0.0 { (1.0 - value.log10().floor()).clamp(0.0, 6.0) } else { 0.0 };
    format!("{value:.0$}", decimals as usize)
}

/// Measured seconds: tenths, and two digits of less than one.
pub(crate) fn measured(value: f64) -> String {
    if value < 1.0 { significant(value) } else { format!("{value:.1}") }
}

/// `part` of `whole` in percent.
pub(crate) fn percent(part: u64, whole: u64) -> f64 {
    if whole == 0 { 0.0 } else { part as f64 * 100.0 / whole as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_wrapped_at_100_columns() {
        let text = wrapped(&"word ".repeat(60), 4);
        assert!(text.lines().count() == 4 && text.lines().all(|line| line.len() <= 100), "{text}");
        assert_eq!(text.split_whitespace().count(), 60);
        assert_eq!(wrapped("a", 2), "  a");
    }

    #[test]
    fn lengths_of_time_read_well() {
        let of = |s: f64| about(std::time::Duration::from_secs_f64(s));
        assert_eq!([of(0.2), of(45.4), of(150.0), of(9000.0)], ["0.2 s", "45 s", "2 min", "2.5 h"]);
        let of = |s: f64| roughly(std::time::Duration::from_secs_f64(s));
        let told = ["a few seconds", "about 45 s", "about 85 s", "about 2 min", "about 2.5 h"];
        assert_eq!([of(9.0), of(45.4), of(87.0), of(88.0), of(9000.0)], told);
    }

    #[test]
    fn factors_have_two_digits() {
        let of = [0.0049, 0.123, 1.26, 34.5, 0.0].map(significant);
        assert_eq!(of, ["0.0049", "0.12", "1.3", "34", "0"]);
        assert_eq!([0.004_512, 0.046, 0.66, 34.56].map(measured), ["0.0045", "0.046", "0.66", "34.6"]);
    }

    #[test]
    fn numbers_read_well() {
        assert_eq!(grouped(12_345_678), "12\u{a0}345\u{a0}678");
        assert_eq!(
            (grouped(0), grouped(999), grouped(1000)),
            ("0".into(), "999".into(), "1\u{a0}000".into())
        );
        assert_eq!(
            (short(1_234_567.0), short(0.0), short(45_600.0)),
            ("1.23 M".into(), "0.00".into(), "45.6 k".into())
        );
        assert_eq!((seconds(1_500_000), seconds(10)), ("1.5 s".into(), "0.00001 s".into()));
        assert_eq!((percent(1, 4), percent(0, 0)), (25.0, 0.0));
    }
}
