//! The progress bar: on standard error, where that is a terminal.

use std::io::IsTerminal;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::text;

/// Units of a bar that shows parts.
pub(crate) const WHOLE: u64 = 10_000;

/// Progress of a stream.
pub(crate) struct Progress {
    bar: ProgressBar,
}

impl Progress {
    /// A bar over `total` units; silent where standard error is no terminal.
    pub(crate) fn new(total: u64) -> Self {
        let bar = if std::io::stderr().is_terminal() {
            ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr_with_hz(10))
        } else {
            ProgressBar::hidden()
        };
        if let Ok(style) = ProgressStyle::with_template("{wide_bar} {percent:>3} %  {msg}  {eta} left") {
            bar.set_style(style);
        }
        bar.enable_steady_tick(Duration::from_millis(500));
        Self { bar }
    }

    /// The stream has reached `t_us` with `events` events after `wall` of work.
    pub(crate) fn stream(&self, t_us: i64, events: u64, wall: Duration) {
        let wall_s = wall.as_secs_f64().max(1.0e-9);
        self.bar.set_message(format!(
            "{}  {} events  {} events/s  {:.3}x real time",
            text::seconds(t_us),
            text::short(events as f64),
            text::short(events as f64 / wall_s),
            t_us as f64 / 1.0e6 / wall_s,
        ));
        self.bar.set_position(u64::try_from(t_us).unwrap_or(0));
    }

    /// `part` of `what` is done; for a bar over [`WHOLE`].
    pub(crate) fn part(&self, what: &str, part: f64) {
        self.bar.set_message(what.to_owned());
        self.bar.set_position((part.clamp(0.0, 1.0) * WHOLE as f64) as u64);
    }

    /// `done` units are done; `what` they are.
    pub(crate) fn count(&self, done: u64, what: &str) {
        self.bar.set_message(format!("{done} {what}"));
        self.bar.set_position(done);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
