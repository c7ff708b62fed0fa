//! Progress on standard error: one bar where that is a terminal, else a line every ten seconds.

use std::io::IsTerminal;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::text;

/// Units of a bar that shows parts.
pub(crate) const WHOLE: u64 = 10_000;

/// Time between two lines where there is no terminal.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// Work before a time left is shown: the first units are not representative.
const LEAST_WORK: Duration = Duration::from_secs(1);

/// Progress of work of known length.
pub(crate) struct Progress {
    bar: ProgressBar,
    is_terminal: bool,
    total: u64,
    started: Instant,
    state: Mutex<State>,
}

struct State {
    left: TimeLeft,
    line: Instant,
}

impl Progress {
    /// Progress over `total` units.
    pub(crate) fn new(total: u64) -> Self {
        let is_terminal = std::io::stderr().is_terminal();
        let bar = if is_terminal {
            ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr_with_hz(10))
        } else {
            ProgressBar::hidden()
        };
        if let Ok(style) = ProgressStyle::with_template("{wide_bar} {percent:>3} %  {msg}") {
            bar.set_style(style);
        }
        bar.enable_steady_tick(Duration::from_millis(500));
        let now = Instant::now();
        let state = Mutex::new(State { left: TimeLeft::default(), line: now });
        Self { bar, is_terminal, total, started: now, state }
    }

    /// The stream has reached `t_us` with `events` events after `wall` of work.
    pub(crate) fn stream(&self, t_us: i64, events: u64, wall: Duration) {
        let wall_s = wall.as_secs_f64().max(1.0e-9);
        let told = format!(
            "{}  {} events  {:.3}x real time",
            text::seconds(t_us),
            text::short(events as f64),
            t_us as f64 / 1.0e6 / wall_s,
        );
        self.at(u64::try_from(t_us).unwrap_or(0), &told);
    }

    /// `part` of `what` is done; for progress over [`WHOLE`].
    pub(crate) fn part(&self, what: &str, part: f64) {
        self.at((part.clamp(0.0, 1.0) * WHOLE as f64) as u64, what);
    }

    /// `done` units are done; `what` they are.
    pub(crate) fn count(&self, done: u64, what: &str) {
        self.at(done, &format!("{done} {what}"));
    }

    /// A line beside the bar.
    pub(crate) fn line(&self, line: &str) {
        self.bar.suspend(|| text::complain(line));
    }

    fn at(&self, done: u64, told: &str) {
        let elapsed = self.started.elapsed();
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let left = state.left.at(elapsed, share(done, self.total));
        let told = left.map_or_else(|| told.to_owned(), |left| format!("{told}  {} left", text::about(left)));
        self.bar.set_position(done);
        if !self.is_terminal && state.line.elapsed() >= LINE_EVERY {
            state.line = Instant::now();
            text::complain(&format!("{:.0} %  {told}", share(done, self.total) * 100.0));
        }
        self.bar.set_message(told);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

fn share(done: u64, total: u64) -> f64 {
    if total == 0 { 0.0 } else { (done as f64 / total as f64).min(1.0) }
}

/// The time left, which never rises: an estimate that grows stays where it was.
#[derive(Debug, Default)]
struct TimeLeft {
    least: Option<Duration>,
    /// The part that was done, and when it was first told.
    part: Option<f64>,
}

impl TimeLeft {
    /// After `elapsed`, of which `share` of the work is done; `None` as long as nothing is known.
    fn at(&mut self, elapsed: Duration, share: f64) -> Option<Duration> {
        if share < self.part.unwrap_or(0.0) {
            // Another part of the work has begun.
            self.least = None;
        }
        self.part = Some(share);
        if elapsed < LEAST_WORK || share <= 0.0 {
            return self.least;
        }
        let left = elapsed.mul_f64((1.0 - share) / share);
        self.least = Some(self.least.map_or(left, |least| least.min(left)));
        self.least
    }
}

/// The first measurement of a stream's speed: what a whole run will take.
#[derive(Debug, Default)]
pub(crate) struct Forecast {
    /// Stream time and work at the end of the first packet, which also sets up what the others use.
    first: Option<(i64, Duration)>,
    /// Stream time that is measured at least, in microseconds.
    least_us: i64,
    /// How long it takes has been said.
    pub(crate) told: bool,
}

/// Stream time that was measured, and the work of a whole stream at that speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Measured {
    pub(crate) from_us: i64,
    pub(crate) until_us: i64,
    pub(crate) total: Duration,
}

impl Forecast {
    /// One that measures `least_us` of the stream at least.
    pub(crate) fn over(least_us: i64) -> Self {
        Self { least_us, ..Self::default() }
    }

    /// The stream of `duration_us` has reached `t_us` after `elapsed` of work. `Some` once: at the end of a packet behind the
    /// first when a second of work and `least_us` are measured and the stream is not over.
    pub(crate) fn at(&mut self, t_us: i64, elapsed: Duration, duration_us: i64) -> Option<Measured> {
        let Some((first_us, first)) = self.first else {
            self.first = Some((t_us, elapsed));
            return None;
        };
        let measured = elapsed.saturating_sub(first);
        let enough = t_us > first_us && t_us - first_us >= self.least_us && measured >= LEAST_WORK;
        if self.told || !enough || t_us >= duration_us {
            return None;
        }
        self.told = true;
        let ahead = (duration_us - first_us) as f64 / (t_us - first_us) as f64;
        Some(Measured { from_us: first_us, until_us: t_us, total: first + measured.mul_f64(ahead) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: Duration = Duration::from_secs(1);

    #[test]
    fn the_time_left_never_rises() {
        let mut left = TimeLeft::default();
        assert_eq!(left.at(S / 2, 0.5), None, "too early");
        assert_eq!(left.at(2 * S, 0.5), Some(2 * S));
        assert_eq!(left.at(10 * S, 0.6), Some(2 * S), "a slower part does not raise it");
        assert_eq!(left.at(10 * S, 0.9), Some(S.mul_f64(10.0 / 9.0).min(2 * S)));
        assert_eq!(left.at(11 * S, 0.1), Some(99 * S), "another part has its own");
    }

    #[test]
    fn a_forecast_is_measured_behind_the_first_packet_and_told_once() {
        let mut forecast = Forecast::default();
        assert_eq!(forecast.at(10_000, 5 * S, 1_000_000), None, "the first packet also sets up");
        assert_eq!(forecast.at(20_000, 5 * S + S / 2, 1_000_000), None, "half a second says little");
        let measured = forecast.at(30_000, 7 * S, 1_000_000).unwrap();
        assert_eq!((measured.from_us, measured.until_us), (10_000, 30_000));
        assert_eq!(measured.total, 5 * S + 99 * S);
        assert_eq!(forecast.at(40_000, 8 * S, 1_000_000), None);
        let mut sparse = Forecast::over(30_000);
        assert_eq!(sparse.at(10_000, S, 1_000_000), None);
        assert_eq!(
            sparse.at(30_000, 9 * S, 1_000_000),
            None,
            "what comes every 30 ms is not in it for certain"
        );
        assert!(sparse.at(40_000, 10 * S, 1_000_000).is_some());
        let mut short = Forecast::default();
        assert_eq!(short.at(10_000, S, 20_000), None);
        assert_eq!(short.at(20_000, 3 * S, 20_000), None, "it is over");
    }

    #[test]
    fn shares_stay_within_a_whole() {
        assert_eq!((share(1, 4), share(5, 4), share(1, 0)), (0.25, 1.0, 0.0));
    }
}
