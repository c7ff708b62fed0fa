//! How many events the walk's steps may have jumped over: a random part of the steps in which nothing fired is sampled
//! densely, and what is found there bounds what is missed elsewhere.

use evis_core::Truth;
use serde::{Deserialize, Serialize};

/// A step is sampled this many times as finely.
pub const FINER: u32 = 16;
/// The bounds hold with this probability.
const CONFIDENCE: f64 = 0.95;

/// What the audit of a truth found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Audit {
    /// Steps in which nothing fired, over all pixels that are not known to be still.
    pub intervals: u64,
    /// How many of them, chosen at random, were sampled densely.
    pub audited: u64,
    /// How many of these hide an excursion past a threshold: at least a pair of events.
    pub missed: u64,
    /// Probability with which the next two hold.
    pub confidence: f64,
    /// Steps that hide events, at most, over the whole truth (C. Clopper and E. Pearson, 1934).
    pub missed_at_most: f64,
    /// The same per event of the truth.
    pub missed_per_event_at_most: f64,
}

impl Audit {
    pub(crate) fn new(counts: Counts, events: u64) -> Self {
        let Counts { intervals, audited, missed } = counts;
        let missed_at_most = upper_bound(missed, audited) * intervals as f64;
        Self {
            intervals,
            audited,
            missed,
            confidence: CONFIDENCE,
            missed_at_most,
            missed_per_event_at_most: missed_at_most / events.max(1) as f64,
        }
    }

    /// The audit that `truth` holds; `None` where it was made otherwise.
    pub fn of(truth: &Truth) -> Option<Self> {
        let provenance: serde_json::Value = serde_json::from_str(&truth.provenance).ok()?;
        serde_json::from_value(provenance.get("audit")?.clone()).ok()
    }
}

/// What was seen in some pixels.
#[derive(Clone, Copy, Debug, Default)]
pub struct Counts {
    pub intervals: u64,
    pub audited: u64,
    pub missed: u64,
}

impl std::iter::Sum for Counts {
    fn sum<I: Iterator<Item = Self>>(all: I) -> Self {
        all.fold(Self::default(), |a, b| Self {
            intervals: a.intervals + b.intervals,
            audited: a.audited + b.audited,
            missed: a.missed + b.missed,
        })
    }
}

/// Whether the step of pixel (x, y) that begins at `t_us` is one of the part `share` to look at: a function of these
/// alone, in no step with any of them.
pub fn chosen(x: u16, y: u16, t_us: i64, share: f64) -> bool {
    // G. Steele et al., "Fast Splittable Pseudorandom Number Generators", 2014: the finalizer of SplitMix64, twice.
    let mix = |v: u64| {
        let v = (v ^ (v >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let v = (v ^ (v >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        v ^ (v >> 31)
    };
    let pixel = (u64::from(x) << 16 | u64::from(y)).wrapping_add(0x9e37_79b9_7f4a_7c15);
    let draw = mix(mix(pixel).wrapping_add(t_us as u64).wrapping_add(0x9e37_79b9_7f4a_7c15));
    ((draw >> 11) as f64) < share * (1_u64 << 53) as f64
}

/// The largest probability at which `found` or fewer of `tried` still come with probability 1 - [`CONFIDENCE`].
fn upper_bound(found: u64, tried: u64) -> f64 {
    if found >= tried {
        return 1.0;
    }
    let n = tried as f64;
    // Probability of `found` or fewer.
    let at_most = |p: f64| {
        let (mut log_choose, mut sum) = (0.0, 0.0);
        for i in 0..=found {
            let k = i as f64;
            if i > 0 {
                log_choose += ((n - k + 1.0) / k).ln();
            }
            sum += (log_choose + k * p.ln() + (n - k) * (-p).ln_1p()).exp();
        }
        sum
    };
    let (mut low, mut high) = (found as f64 / n, 1.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if at_most(middle) > 1.0 - CONFIDENCE { low = middle } else { high = middle }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_those_of_clopper_and_pearson() {
        // 1 - 0.05^(1/n) where nothing is found; the others from the quantiles of the beta distribution.
        for (found, tried, expected) in [(0, 100, 0.029_513), (1, 20, 0.216_106), (5, 50, 0.198_833)] {
            let bound = upper_bound(found, tried);
            assert!((bound - expected).abs() < 1e-5, "{found} of {tried}: {bound}");
        }
        assert_eq!((upper_bound(0, 0), upper_bound(3, 3)), (1.0, 1.0));
        assert!(upper_bound(1, 100) > upper_bound(0, 100) * 1.3, "canary");
    }

    #[test]
    fn steps_are_chosen_at_the_share_asked_for() {
        let all = (0..40_000_i64).map(|i| ((i % 200) as u16, (i / 200 % 20) as u16, i / 4000 * 128));
        let count = all.filter(|(x, y, t)| chosen(*x, *y, *t, 0.1)).count() as f64;
        // Five standard deviations.
        assert!((count - 4000.0).abs() < 300.0, "{count}");
        assert!(chosen(3, 4, 5, 1.0) && !chosen(3, 4, 5, 0.0));
    }
}
