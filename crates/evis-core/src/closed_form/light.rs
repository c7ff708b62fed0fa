//! Light of one pixel as a function of time, with its monotone pieces and its inverse.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::sync::Arc;

use crate::sensor::ConfigError;

/// More monotone pieces than this are refused: their list would fill the memory.
const MOST_PIECES: f64 = 1e7;

/// Light of one pixel as a function of time in seconds, from 0 on.
#[derive(Clone)]
pub enum PixelLight {
    /// `mean + swing sin(phase + omega t)`.
    Sine {
        /// Mean over a cycle.
        mean: f64,
        /// Amplitude, of either sign.
        swing: f64,
        /// Radians per second, of either sign.
        omega: f64,
        /// Radians at t = 0.
        phase: f64,
    },
    /// `start + rate t`, and 0 where that is below 0.
    Linear {
        /// Light at t = 0.
        start: f64,
        /// Light per second.
        rate: f64,
    },
    /// `start exp(growth t)`.
    Exponential {
        /// Light at t = 0.
        start: f64,
        /// Per second.
        growth: f64,
    },
    /// `high` in the first `duty` of a cycle, `low` in the rest.
    Square {
        /// Light in the rest of a cycle.
        low: f64,
        /// Light in the first part of a cycle.
        high: f64,
        /// Cycles per second.
        frequency_hz: f64,
        /// Part of a cycle by which it is ahead.
        phase_cycles: f64,
        /// First part of a cycle, between 0 and 1.
        duty: f64,
    },
    /// The pixel's area on both sides of a moving edge or bar.
    Coverage(Coverage),
    /// Any continuous light whose turning points are known.
    Function {
        /// Light at a time in seconds.
        light: Arc<dyn Fn(f64) -> f64 + Send + Sync>,
        /// Times in ascending order; between two of them the light only rises or only falls.
        turns_s: Arc<[f64]>,
    },
}

/// Mean over a unit square that a straight edge, or a bar between two of them, passes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coverage {
    /// Light outside (behind the edge, or beside the bar).
    pub outside: f64,
    /// Light inside (ahead of the edge, or on the bar).
    pub inside: f64,
    /// Distance in pixels of the square's centre from the edge, or from the bar's middle line, at t = 0; positive
    /// inside an edge.
    pub start_px: f64,
    /// Pixels per second by which that distance falls.
    pub speed_px_per_s: f64,
    /// Cosine and sine of the direction across the edge.
    pub direction: [f64; 2],
    /// Width of the bar in pixels; `None` for an edge.
    pub width_px: Option<f64>,
}

/// A part of a pixel's time in which its light only rises, only falls, or rests.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Piece {
    /// First time in seconds.
    pub start_s: f64,
    /// Last time.
    pub end_s: f64,
    /// Light at the start.
    pub light_start: f64,
    /// Light at the end, before the jump that may follow.
    pub light_end: f64,
}

/// Share of a unit square that lies where its coordinate along (`cosine`, `sine`) is above `-s`: with `s` the distance
/// of its centre from an edge, the area on the edge's inner side.
pub fn half_plane_area(s: f64, [cosine, sine]: [f64; 2]) -> f64 {
    let (c, d) = (cosine.abs(), sine.abs());
    let outer = 0.5 * (c + d);
    let short = outer - s.abs();
    let small = if short <= 0.0 {
        0.0
    } else if short < c.min(d) {
        // A triangle in the corner.
        short * short / (2.0 * c * d)
    } else {
        0.5 - s.abs() / c.max(d)
    };
    if s < 0.0 { small } else { 1.0 - small }
}

/// Inverse of [`half_plane_area`] for areas in [0, 1].
fn half_plane_distance(area: f64, [cosine, sine]: [f64; 2]) -> f64 {
    let (c, d) = (cosine.abs(), sine.abs());
    let small = area.min(1.0 - area).max(0.0);
    // The triangle is full where the edge passes the nearer corner.
    let corner = c.min(d) / (2.0 * c.max(d));
    let distance =
        if small < corner { 0.5 * (c + d) - (2.0 * c * d * small).sqrt() } else { (0.5 - small) * c.max(d) };
    if area < 0.5 { -distance } else { distance }
}

impl Coverage {
    fn distance(&self, t_s: f64) -> f64 {
        self.start_px - self.speed_px_per_s * t_s
    }

    fn share(&self, s: f64) -> f64 {
        let area = |s| half_plane_area(s, self.direction);
        self.width_px.map_or_else(|| area(s), |w| area(s + 0.5 * w) - area(s - 0.5 * w))
    }

    fn light(&self, t_s: f64) -> f64 {
        self.outside + (self.inside - self.outside) * self.share(self.distance(t_s))
    }

    /// Distances at which the share's formula changes, or a bar's share turns.
    fn knots(&self) -> Vec<f64> {
        let (c, d) = (self.direction[0].abs(), self.direction[1].abs());
        let (outer, inner) = (0.5 * (c + d), 0.5 * (c - d).abs());
        let edge = [-outer, -inner, inner, outer];
        match self.width_px {
            None => edge.to_vec(),
            Some(w) => {
                let sides = [-0.5 * w, 0.5 * w];
                sides.iter().flat_map(|side| edge.map(|k| k + side)).chain([0.0]).collect()
            }
        }
    }

    /// Time in `piece` at which the light is `light`.
    fn time(&self, light: f64, piece: &Piece) -> f64 {
        let share = (light - self.outside) / (self.inside - self.outside);
        let Some(_) = self.width_px else {
            return (self.start_px - half_plane_distance(share, self.direction)) / self.speed_px_per_s;
        };
        // Between knots a bar's share is a parabola: F0 + c1 u + c2 u², which only rises or only falls for u in [0, 1].
        let (s0, s1) = (self.distance(piece.start_s), self.distance(piece.end_s));
        let (f0, f1, middle) = (self.share(s0), self.share(s1), self.share(0.5 * (s0 + s1)));
        let c2 = 2.0 * ((f0 - middle) + (f1 - middle));
        let c1 = (f1 - f0) - c2;
        let rise = share - f0;
        let root = (c1 * c1 + 4.0 * c2 * rise).max(0.0).sqrt();
        let below = c1 + root.copysign(f1 - f0);
        let u = if below == 0.0 { 0.0 } else { 2.0 * rise / below };
        piece.start_s + u * (piece.end_s - piece.start_s)
    }
}

impl PixelLight {
    /// Light at `t_s` seconds; after a jump at that very time.
    pub fn luminance(&self, t_s: f64) -> f64 {
        match self {
            Self::Sine { mean, swing, omega, phase } => mean + swing * (phase + omega * t_s).sin(),
            Self::Linear { start, rate } => (start + rate * t_s).max(0.0),
            Self::Exponential { start, growth } => start * (growth * t_s).exp(),
            Self::Square { low, high, frequency_hz, phase_cycles, duty } => {
                let cycle = (frequency_hz * t_s + phase_cycles).rem_euclid(1.0);
                if cycle < *duty { *high } else { *low }
            }
            Self::Coverage(coverage) => coverage.light(t_s),
            Self::Function { light, .. } => light(t_s),
        }
    }

    /// The monotone pieces of `[0, end_s]` in order of time. A jump lies where a piece starts with other light than the
    /// one before it ended with.
    ///
    /// # Errors
    /// Too many pieces for the memory.
    pub fn pieces(&self, end_s: f64) -> Result<Vec<Piece>, ConfigError> {
        match self {
            Self::Sine { mean, swing, omega, phase } => {
                few_enough(omega.abs() * end_s / PI)?;
                let turns = sine_turns(*omega, *phase, end_s);
                let turns = turns.map(|(t, sign)| (t, mean + swing * sign));
                Ok(self.between(turns, end_s))
            }
            Self::Linear { start, rate } => {
                let dark = -start / rate;
                let turn = (dark > 0.0 && dark < end_s).then_some((dark, 0.0));
                Ok(self.between(turn.into_iter(), end_s))
            }
            Self::Exponential { .. } => Ok(self.between(std::iter::empty(), end_s)),
            Self::Square { low, high, frequency_hz, phase_cycles, duty } => {
                few_enough(2.0 * frequency_hz * end_s)?;
                Ok(square_pieces(*low, *high, *frequency_hz, *phase_cycles, *duty, end_s))
            }
            Self::Coverage(coverage) => {
                let time = |s: f64| (coverage.start_px - s) / coverage.speed_px_per_s;
                let mut times: Vec<f64> = coverage.knots().into_iter().map(time).collect();
                times.retain(|t| *t > 0.0 && *t < end_s);
                times.sort_by(f64::total_cmp);
                times.dedup();
                Ok(self.between(times.into_iter().map(|t| (t, coverage.light(t))), end_s))
            }
            Self::Function { light, turns_s } => {
                let inside = turns_s.iter().filter(|t| **t > 0.0 && **t < end_s);
                Ok(self.between(inside.map(|&t| (t, light(t))), end_s))
            }
        }
    }

    /// Pieces of `[0, end_s]` between `turns`, times with the light at them.
    fn between(&self, turns: impl Iterator<Item = (f64, f64)>, end_s: f64) -> Vec<Piece> {
        let mut from = (0.0, self.luminance(0.0));
        let last = (end_s, self.luminance(end_s));
        let piece = |to: (f64, f64)| {
            let (start, light) = std::mem::replace(&mut from, to);
            Piece { start_s: start, end_s: to.0, light_start: light, light_end: to.1 }
        };
        turns.chain([last]).map(piece).collect()
    }

    /// Time at which the light is `light`, a value between those of the ends of `piece`, one of [`PixelLight::pieces`].
    pub fn time(&self, light: f64, piece: &Piece) -> f64 {
        let time = match self {
            Self::Sine { mean, swing, omega, phase } => {
                // The branch of the arc sine in which the piece lies.
                let branch = ((phase + omega * 0.5 * (piece.start_s + piece.end_s)) / PI).round();
                let turned = if branch.rem_euclid(2.0) == 0.0 { 1.0 } else { -1.0 };
                let angle = ((light - mean) / swing).clamp(-1.0, 1.0).asin();
                (branch * PI + turned * angle - phase) / omega
            }
            Self::Linear { start, rate } => (light - start) / rate,
            Self::Exponential { start, growth } => (light / start).ln() / growth,
            Self::Square { .. } => piece.start_s,
            Self::Coverage(coverage) => coverage.time(light, piece),
            Self::Function { light: function, .. } => {
                let sign = if piece.light_end >= piece.light_start { 1.0 } else { -1.0 };
                bracketed_root(&|t| sign * (function(t) - light), piece.start_s, piece.end_s)
            }
        };
        time.clamp(piece.start_s, piece.end_s)
    }
}

/// Where `f`, negative at `a` and not at `b`, becomes 0: halved until no number lies between.
pub(crate) fn bracketed_root(f: &dyn Fn(f64) -> f64, mut a: f64, mut b: f64) -> f64 {
    loop {
        let middle = 0.5 * (a + b);
        if middle <= a || middle >= b {
            return b;
        }
        *(if f(middle) < 0.0 { &mut a } else { &mut b }) = middle;
    }
}

fn few_enough(pieces: f64) -> Result<(), ConfigError> {
    if pieces <= MOST_PIECES {
        return Ok(());
    }
    Err(ConfigError::new(
        "number of turning points",
        pieces,
        "at most 10000000: a lower frequency or a shorter time",
    ))
}

/// Times in (0, end) at which `sin(phase + omega t)` turns, and its sign there.
fn sine_turns(omega: f64, phase: f64, end_s: f64) -> impl Iterator<Item = (f64, f64)> {
    // Numbered along time: a falling phase is a rising one of the mirrored sine.
    let (rate, start, mirror) = if omega < 0.0 { (-omega, -phase, -1.0) } else { (omega, phase, 1.0) };
    let first = ((start - FRAC_PI_2) / PI).floor();
    let count = if rate == 0.0 { 0 } else { (rate * end_s / PI).ceil() as u64 + 2 };
    (0..count)
        .map(move |i| {
            let k = first + i as f64;
            let sign = if k.rem_euclid(2.0) == 0.0 { mirror } else { -mirror };
            ((FRAC_PI_2 + k * PI - start) / rate, sign)
        })
        .filter(move |(t, _)| *t > 0.0 && *t < end_s)
}

fn square_pieces(low: f64, high: f64, frequency_hz: f64, phase: f64, duty: f64, end_s: f64) -> Vec<Piece> {
    let mut out = Vec::new();
    let mut push = |from: f64, to: f64, light: f64| {
        let (start_s, stop) = (from.max(0.0), to.min(end_s));
        if start_s < stop {
            out.push(Piece { start_s, end_s: stop, light_start: light, light_end: light });
        }
    };
    if frequency_hz == 0.0 {
        let light = if phase.rem_euclid(1.0) < duty { high } else { low };
        push(0.0, end_s, light);
        return out;
    }
    let first = phase.floor();
    let cycles = (frequency_hz * end_s).ceil() as u64 + 2;
    for i in 0..cycles {
        let cycle = first + i as f64;
        let at = |part: f64| (cycle + part - phase) / frequency_hz;
        push(at(0.0), at(duty), high);
        // The next cycle's own start, to the last digit.
        push(at(duty), (cycle + 1.0 - phase) / frequency_hz, low);
    }
    out
}

/// The phase within one turn: large phases cost digits.
pub(crate) fn wrapped(phase: f64) -> f64 {
    phase.rem_euclid(TAU)
}
