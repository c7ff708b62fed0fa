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
            Self::Holds { value, factor } => interval.is_some_and(|[low, high]| {
                (low..=high).contains(&value) && high <= low * factor * factor
            }),
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

/// What is claimed of a cell. Of every cell with a limit it is also claimed that no pixel fires whose light does not
/// change, and that no event lies outside its packet.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Limit {
    /// Of the number.
    pub bound: Bound,
    /// Of F1; `None` where nothing is claimed of it.
    pub least_f1: Option<f64>,
    /// Whether it is no more than what is measured today, and not a promise.
    pub measured: bool,
    /// Why this limit.
    pub reason: String,
}

impl Limit {
    /// Which claims `cell` does not keep.
    pub(super) fn faults(&self, cell: &Cell) -> Vec<String> {
        let mut faults: Vec<String> = self.bound.fault(cell.number, cell.interval).into_iter().collect();
        if let Some(least) = self.least_f1
            && cell.f1.is_none_or(|f1| f1 < least)
        {
            let told = cell.f1.map_or_else(|| "none".into(), |f1| format!("{f1:.3}"));
            faults.push(format!("F1 {told}, ≥ {} is claimed", number(least)));
        }
        for (count, what) in [(cell.at_still, "at pixels whose light does not change"), (cell.outside, "outside their packet")] {
            if count > 0 {
                faults.push(format!("{count} events {what}"));
            }
        }
        faults
    }
}

/// The limit of this failure and method; `None` where nothing is claimed.
pub(super) fn find(failure: &str, method: &str) -> Option<Limit> {
    let found = LIMITS.iter().find(|l| l.0 == failure && l.1 == method)?;
    let &(_, _, bound, least_f1, measured, reason) = found;
    Some(Limit { bound, least_f1, measured, reason: reason.into() })
}

/// Failure, method, bound of the number, least F1, whether this is no more than today's measurement, reason.
type Row = (&'static str, &'static str, Bound, Option<f64>, bool, &'static str);

const LIMITS: &[Row] = &[];
