//! What we claim: one table, with the reason beside each limit.

use std::fmt::{Display, Formatter};

use serde::{Deserialize, Serialize};

use super::Cell;
use crate::ladder::number;

/// What a number must be.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Bound {
    /// This at most.
    AtMost(f64),
    /// This at least.
    AtLeast(f64),
    /// Between the two.
    Between(f64, f64),
    /// Its interval of confidence holds this, and is no wider than this many times it either way.
    Holds {
        /// What it must hold.
        value: f64,
        /// The widest that says anything, as a factor.
        factor: f64,
    },
    /// It is told, and nothing is claimed of it.
    Any,
}

impl Bound {
    /// What is wrong with `number`, where something is.
    fn fault(self, number: Option<f64>, interval: Option<[f64; 2]>) -> Option<String> {
        if self == Self::Any {
            return None;
        }
        let Some(x) = number.filter(|x| x.is_finite()) else {
            return Some(format!("no number, {self} is claimed"));
        };
        let kept = match self {
            Self::AtMost(most) => x <= most,
            Self::AtLeast(least) => x >= least,
            Self::Between(low, high) => (low..=high).contains(&x),
            Self::Holds { value, factor } => interval
                .is_some_and(|[low, high]| (low..=high).contains(&value) && high <= low * factor * factor),
            Self::Any => true,
        };
        match interval.filter(|_| matches!(self, Self::Holds { .. })) {
            _ if kept => None,
            Some([low, high]) => Some(format!("{x:.3} ({low:.3} to {high:.3}), {self} is claimed")),
            None => Some(format!("{x:.3}, {self} is claimed")),
        }
    }
}

impl Display for Bound {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match *self {
            Self::AtMost(most) => write!(f, "≤ {}", number(most)),
            Self::AtLeast(least) => write!(f, "≥ {}", number(least)),
            Self::Between(low, high) => write!(f, "{} to {}", number(low), number(high)),
            Self::Holds { value, .. } => write!(f, "{} within confidence", number(value)),
            Self::Any => write!(f, "anything"),
        }
    }
}

/// What is claimed of a cell. Of every cell with a limit it is also claimed that no event lies outside its packet.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Limit {
    /// Of the number.
    pub bound: Bound,
    /// Of F1; `None` where nothing is claimed of it.
    pub least_f1: Option<f64>,
    /// By how much F1 may lie below that of `native` in the same report; `None` where it is not compared.
    pub below_native: Option<f64>,
    /// Events at pixels whose light does not change, at most.
    pub most_at_still: u64,
    /// Whether it is no more than what is measured today, and not a promise.
    pub measured: bool,
    /// Why this limit.
    pub reason: String,
}

impl Limit {
    /// Which claims `cell` does not keep; `native_f1` is that of the method `native` on the same failure.
    pub fn faults(&self, cell: &Cell, native_f1: Option<f64>) -> Vec<String> {
        let mut faults: Vec<String> = self.bound.fault(cell.number, cell.interval).into_iter().collect();
        let told = |f1: Option<f64>| f1.map_or_else(|| "none".into(), |f1| format!("{f1:.3}"));
        if let Some(least) = self.least_f1
            && cell.f1.is_none_or(|f1| f1 < least)
        {
            faults.push(format!("F1 {}, ≥ {} is claimed", told(cell.f1), number(least)));
        }
        if let (Some(below), Some(native)) = (self.below_native, native_f1)
            && cell.f1.is_none_or(|f1| f1 < native - below)
        {
            faults.push(format!(
                "F1 {}, native's {native:.3} less {} is claimed",
                told(cell.f1),
                number(below)
            ));
        }
        if cell.at_still > self.most_at_still {
            let most = self.most_at_still;
            faults.push(format!(
                "{} events at pixels whose light does not change, {most} claimed",
                cell.at_still
            ));
        }
        if cell.outside > 0 {
            faults.push(format!("{} events outside their packet", cell.outside));
        }
        faults
    }
}

/// The limit of this failure and method; `None` where nothing is claimed.
pub fn limit(failure: &str, method: &str) -> Option<Limit> {
    let row = |failure| LIMITS.iter().find(|row| row.failure == failure && row.method == method);
    let row = row(failure).or_else(|| row(ANY))?;
    Some(Limit {
        bound: row.bound,
        least_f1: row.least_f1,
        below_native: row.below_native,
        most_at_still: row.most_at_still,
        measured: row.measured,
        reason: row.reason.into(),
    })
}

/// Stands for every failure that has no row of its own.
const ANY: &str = "*";

/// A row of the table.
struct Row {
    failure: &'static str,
    method: &'static str,
    bound: Bound,
    least_f1: Option<f64>,
    below_native: Option<f64>,
    most_at_still: u64,
    measured: bool,
    reason: &'static str,
}

/// A promise.
const fn claim(
    failure: &'static str,
    method: &'static str,
    bound: Bound,
    least_f1: f64,
    reason: &'static str,
) -> Row {
    let least_f1 = if least_f1 > 0.0 { Some(least_f1) } else { None };
    Row { failure, method, bound, least_f1, below_native: None, most_at_still: 0, measured: false, reason }
}

/// What is measured today, so that it gets no worse.
const fn today(
    failure: &'static str,
    method: &'static str,
    bound: Bound,
    least_f1: f64,
    reason: &'static str,
) -> Row {
    Row { measured: true, ..claim(failure, method, bound, least_f1, reason) }
}

/// The same where a few pixels fire that the scene never reaches.
const fn stray(
    failure: &'static str,
    method: &'static str,
    bound: Bound,
    least_f1: f64,
    reason: &'static str,
) -> Row {
    Row { most_at_still: 3, ..today(failure, method, bound, least_f1, reason) }
}

/// A promise relative to `native`.
const fn near_native(failure: &'static str, method: &'static str, bound: Bound) -> Row {
    let below_native = Some(0.02);
    Row {
        below_native,
        ..claim(failure, method, bound, 0.0, "it is within 0.02 F1 of converged native in each case")
    }
}

use Bound::{Any, AtLeast, AtMost, Between, Holds};

const NATIVE: &str = "native";
const SPLAT: &str = "splat";

/// An interval of confidence that holds 1.
const EVEN: Bound = Holds { value: 1.0, factor: 1.3 };

/// Of `evis-paper` and `no-aa` nothing is claimed: their failures are the point.
const LIMITS: &[Row] = &[
    // Every instant is rendered, 1000 a second, with 16 samples: what remains is the error of samples and of the rate.
    claim("keyframe-burst", NATIVE, EVEN, 0.98, "it has no keyframes"),
    claim("keyframe-burst-30", NATIVE, EVEN, 0.98, "it has no keyframes"),
    claim(
        "disocclusion",
        NATIVE,
        AtMost(2.0),
        0.98,
        "visibility is exact; what is left are 16 samples at the outline",
    ),
    claim("rotation", NATIVE, AtMost(0.01), 0.98, "poses are exact at every instant"),
    claim(
        "thin-fast",
        NATIVE,
        AtLeast(0.97),
        0.97,
        "the ball is seen in five instants, the rod in sixteen samples",
    ),
    claim("fringe-ghosts", NATIVE, AtMost(0.002), 0.9, "no pixel is carried from one instant to the next"),
    claim("edge-ramp", NATIVE, Between(0.93, 1.07), 0.9, "sixteen samples make sixteen steps of an edge"),
    claim("breathing", NATIVE, AtMost(0.02), 0.97, "texture is read where each sample is, at every instant"),
    claim("highlights", NATIVE, AtLeast(0.97), 0.97, "shading is computed at every instant"),
    claim("shadows", NATIVE, AtLeast(0.9), 0.9, "shadows are cast at every instant; here by rays"),
    claim("lights", NATIVE, AtLeast(0.98), 0.98, "light is read at every instant, 25 in a period"),
    claim("cones", NATIVE, AtLeast(0.97), 0.97, "light is read at every instant"),
    claim("sky", NATIVE, AtLeast(0.97), 0.97, "the sky is looked up at every instant"),
    claim("near", NATIVE, Between(0.97, 1.03), 0.97, "depth has no part in light"),
    claim("depth", NATIVE, Between(0.95, 1.05), 0.97, "depth has no part in light"),
    claim("cracks", NATIVE, AtMost(0.0), 0.98, "surfaces are closed at every instant"),
    claim("borders", NATIVE, AtLeast(0.98), 0.98, "nothing needs to be seen before"),
    claim("global-step", NATIVE, Between(1.0, 1.0), 0.95, "its rate is fixed"),
    claim("cut", NATIVE, AtMost(0.0), 0.98, "no instant knows of another"),
    claim("dark", NATIVE, AtLeast(0.98), 0.98, "light is a float of 32 bits until the logarithm"),
    claim("bright", NATIVE, AtLeast(0.98), 0.98, "light is a float of 32 bits until the logarithm"),
    claim(
        "low-threshold",
        NATIVE,
        AtLeast(0.97),
        0.97,
        "inside surfaces light is exact to a fraction of a percent",
    ),
    claim(
        "high-threshold",
        NATIVE,
        AtLeast(0.9),
        0.9,
        "one crossing late in an edge's ramp, told by sixteen samples",
    ),
    claim("refractory", NATIVE, AtMost(0.0), 0.7, "a pixel rests in continuous time, whatever the instants"),
    // 125 keyframes per second, eight instants each.
    claim(
        "keyframe-burst",
        SPLAT,
        EVEN,
        0.94,
        "both keyframes count, in log light and by their distance in time",
    ),
    // Of `keyframe-burst-30` nothing: its lamp bends by up to 1.7 thresholds within a gap.
    today(
        "disocclusion",
        SPLAT,
        AtMost(18.0),
        0.68,
        "what no keyframe shows is unknown; edges move in steps",
    ),
    claim("rotation", SPLAT, AtMost(0.05), 0.8, "points move by the exact matrices of the instant"),
    today("thin-fast", SPLAT, AtLeast(0.6), 0.7, "what is hidden at both keyframes is never drawn"),
    stray("fringe-ghosts", SPLAT, AtMost(0.01), 0.41, "a fringe's pixel has one depth and one motion"),
    stray(
        "edge-ramp",
        SPLAT,
        Between(0.9, 1.45),
        0.41,
        "an edge is read between the keyframe's pixels, once more blurred",
    ),
    today(
        "breathing",
        SPLAT,
        AtMost(0.25),
        0.6,
        "bilinear between keyframe pixels: half a pixel off, 2.5 pixels lose a fifth of contrast",
    ),
    today(
        "highlights",
        SPLAT,
        AtLeast(0.95),
        0.95,
        "between keyframes highlights fade from one place to the other",
    ),
    today("shadows", SPLAT, AtLeast(0.6), 0.55, "between keyframes shadows fade from one place to the other"),
    today("lights", SPLAT, AtLeast(0.5), 0.5, "between three keyframes per period light is straight"),
    today("cones", SPLAT, AtLeast(0.5), 0.5, "between keyframes cones fade from one place to the other"),
    today("sky", SPLAT, AtLeast(0.93), 0.93, "keyframes of the sky are read between their pixels"),
    claim("near", SPLAT, Between(0.95, 1.05), 0.7, "nearest depths are kept by integers; nothing overflows"),
    today("depth", SPLAT, Between(0.9, 1.15), 0.85, "what the near plane cuts is unknown for a gap"),
    claim("cracks", SPLAT, AtMost(0.0), 0.93, "the newer keyframe shrinks where the older one cracks"),
    claim(
        "borders",
        SPLAT,
        AtLeast(0.95),
        0.95,
        "keyframes see 32 pixels beyond the border; a gap moves by 2.4",
    ),
    claim("global-step", SPLAT, Between(1.0, 1.0), 0.65, "its rates are fixed"),
    claim(
        "cut",
        SPLAT,
        AtMost(0.0),
        0.75,
        "a gap with a cut in it shows both views; the next one knows nothing of it",
    ),
    today(
        "dark",
        SPLAT,
        AtLeast(0.93),
        0.93,
        "indices carry light in full precision; bilinear reading is what it loses",
    ),
    today(
        "bright",
        SPLAT,
        AtLeast(0.93),
        0.93,
        "indices carry light in full precision; bilinear reading is what it loses",
    ),
    today("low-threshold", SPLAT, AtLeast(0.92), 0.92, "bilinear reading between keyframe pixels"),
    today("high-threshold", SPLAT, AtLeast(0.4), 0.4, "edges move in steps"),
    stray("refractory", SPLAT, AtMost(0.0), 0.2, "a pixel rests in continuous time, whatever the instants"),
    // The project's own targets.
    near_native("keyframe-burst", "high", EVEN),
    near_native("keyframe-burst-30", "high", EVEN),
    near_native(ANY, "high", Any),
    today(
        "refractory",
        "high",
        AtMost(0.0),
        0.55,
        "a rest of three instants makes small errors of time large: not within 0.02 of native, itself at 0.78",
    ),
];
