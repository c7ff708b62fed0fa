//! The trigger of a continuous signal.

use super::light::{Piece, PixelLight};
use crate::event::Polarity;
use crate::sensor::{ConfigError, SensorConfig};

/// A level counts as reached when the signal comes this close to it, in log units: a signal that in exact arithmetic
/// touches a threshold fires, whatever the rounding.
const TOUCH: f64 = 1e-12;

/// One event of a continuous signal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// When, in seconds.
    pub t_s: f64,
    /// When, floored to the microsecond as events are.
    pub t_us: i64,
    /// Which way.
    pub polarity: Polarity,
    /// The level crossed: the reference from then on.
    pub level_log: f64,
}

/// A place where the signal turns back or starts to rest, and how clear it is what it fired before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turn {
    /// When.
    pub t_s: f64,
    /// Log units by which a smaller or a larger swing would have fired one event less or more.
    pub margin_log: f64,
    /// The signal was half a threshold short of the level in question here; before this, the turn decides nothing.
    pub from_s: f64,
}

/// What one pixel fires.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PixelTruth {
    /// In firing order.
    pub crossings: Vec<Crossing>,
    /// In order of time.
    pub turns: Vec<Turn>,
}

impl PixelTruth {
    /// The crossings whose microsecond lies in `[start_us, end_us)`.
    pub fn within(&self, start_us: i64, end_us: i64) -> &[Crossing] {
        let from = self.crossings.partition_point(|c| c.t_us < start_us);
        let to = self.crossings.partition_point(|c| c.t_us < end_us).max(from);
        &self.crossings[from..to]
    }

    /// Until when the crossings are beyond dispute: no turn decided by less than `band_log` before, and no crossing
    /// within `margin_s` of it; at most `end_s`. Solve `margin_s` further than `end_s` for the latter to hold at the end.
    pub fn horizon_s(&self, end_s: f64, band_log: f64, margin_s: f64) -> f64 {
        let doubt = self.turns.iter().find(|t| t.margin_log < band_log);
        let mut horizon = doubt.map_or(end_s, |t| t.from_s.min(end_s));
        for crossing in self.crossings.iter().rev() {
            if (crossing.t_s - horizon).abs() < margin_s {
                horizon = crossing.t_s - 1.001 * margin_s;
            }
        }
        horizon.max(0.0)
    }
}

/// Seconds to the microsecond that holds them. What a rounding keeps short of a whole microsecond is that microsecond.
fn floor_us(t_s: f64) -> i64 {
    let us = t_s * 1e6;
    let whole = us.round();
    (if (us - whole).abs() < 1e-6 { whole } else { us.floor() }) as i64
}

/// The walk along a signal.
struct Walk<'a> {
    light: &'a PixelLight,
    threshold_on: f64,
    threshold_off: f64,
    eps: f64,
    reference_luminance: f64,
    /// ln of the light at t = 0, and net steps since: the reference without accumulated rounding.
    start_log: f64,
    on: i64,
    off: i64,
    /// The rise or fall under way: 1, -1, or 0 for rest.
    direction: f64,
    /// Whether it has fired.
    fired: bool,
    /// Its pieces.
    run: Vec<Piece>,
    out: PixelTruth,
}

impl Walk<'_> {
    fn log(&self, light: f64) -> f64 {
        (light / self.reference_luminance + self.eps).ln()
    }

    fn light_at(&self, level: f64) -> f64 {
        (level.exp() - self.eps) * self.reference_luminance
    }

    fn reference(&self) -> f64 {
        self.start_log + self.on as f64 * self.threshold_on - self.off as f64 * self.threshold_off
    }

    fn threshold(&self) -> f64 {
        if self.direction > 0.0 { self.threshold_on } else { self.threshold_off }
    }

    /// Time within `piece` at which the signal passes `level`.
    fn time(&self, level: f64, piece: &Piece) -> f64 {
        if piece.start_s == piece.end_s {
            piece.start_s
        } else {
            self.light.time(self.light_at(level), piece)
        }
    }

    /// Closes the rise or fall under way, which ended at `t_s` with the signal at `log`.
    fn turn(&mut self, t_s: f64, log: f64) {
        if self.direction != 0.0 {
            let (direction, threshold, reference) = (self.direction, self.threshold(), self.reference());
            let distance = direction * (log - reference);
            let (margin, level) = if self.fired && distance < threshold - distance {
                (distance, reference)
            } else {
                (threshold - distance, reference + direction * threshold)
            };
            let half_way = level - 0.5 * direction * threshold;
            let short = |light: f64| direction * (self.log(light) - half_way) < 0.0;
            // The first piece that ends beyond the level; where the run starts beyond it, its start.
            let passing = self.run.iter().find(|p| !short(p.light_end));
            let from_s = match passing {
                Some(p) if short(p.light_start) => self.time(half_way, p),
                Some(p) => p.start_s,
                None => t_s,
            };
            self.out.turns.push(Turn { t_s, margin_log: margin.abs(), from_s });
        }
        self.run.clear();
        self.fired = false;
    }

    /// Takes a piece (a jump is one without length): fires what it crosses.
    fn take(&mut self, piece: Piece) {
        let (start, end) = (self.log(piece.light_start), self.log(piece.light_end));
        let direction = if (end - start).abs() < TOUCH { 0.0 } else { (end - start).signum() };
        if direction != self.direction {
            self.turn(piece.start_s, start);
            self.direction = direction;
        }
        if direction == 0.0 {
            return;
        }
        self.run.push(piece);
        let (threshold, sign) = (self.threshold(), direction);
        while sign * (end - self.reference()) >= threshold - TOUCH {
            *(if sign > 0.0 { &mut self.on } else { &mut self.off }) += 1;
            let level_log = self.reference();
            let t_s = self.time(level_log, &piece);
            let polarity = if sign > 0.0 { Polarity::On } else { Polarity::Off };
            self.out.crossings.push(Crossing { t_s, t_us: floor_us(t_s), polarity, level_log });
            self.fired = true;
        }
    }
}

/// What a pixel with this light fires in `[0, end_s]`: rule `crossing` on the continuous signal. The reference starts at
/// the signal at t = 0; whenever the signal stands a threshold from the reference, an event fires and the reference moves
/// by that threshold. A jump fires all it crosses at its own time.
///
/// # Errors
/// Thresholds, `eps` and `reference_luminance` must be above 0, `end_s` finite, light and signal finite.
pub fn solve(
    light: &PixelLight,
    sensor: &SensorConfig,
    reference_luminance: f64,
    end_s: f64,
) -> Result<PixelTruth, ConfigError> {
    crate::sensor::Sensor::new(sensor.clone())?;
    if !(reference_luminance.is_finite() && reference_luminance > 0.0) {
        return Err(ConfigError::new("reference_luminance", reference_luminance, "a finite number above 0"));
    }
    // Beyond this, f64 seconds no longer hold a microsecond.
    if !(0.0..=1e9).contains(&end_s) {
        return Err(ConfigError::new("duration", end_s, "between 0 and 1000000000 seconds"));
    }
    let mut walk = Walk {
        light,
        threshold_on: f64::from(sensor.threshold_on),
        threshold_off: f64::from(sensor.threshold_off),
        eps: f64::from(sensor.log_eps),
        reference_luminance,
        start_log: 0.0,
        on: 0,
        off: 0,
        direction: 0.0,
        fired: false,
        run: Vec::new(),
        out: PixelTruth::default(),
    };
    let mut before: Option<Piece> = None;
    for piece in light.pieces(end_s)? {
        for value in [piece.light_start, piece.light_end] {
            if !walk.log(value).is_finite() {
                return Err(ConfigError::new("light", value, "finite and 0 or more at every time"));
            }
        }
        match before {
            None => walk.start_log = walk.log(piece.light_start),
            Some(b) if b.light_end != piece.light_start => {
                let at = piece.start_s;
                walk.take(Piece {
                    start_s: at,
                    end_s: at,
                    light_start: b.light_end,
                    light_end: piece.light_start,
                });
            }
            Some(_) => {}
        }
        walk.take(piece);
        before = Some(piece);
    }
    Ok(walk.out)
}
