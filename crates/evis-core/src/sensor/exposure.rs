//! Exposures: how much the light of each moment counts, and frames of light in the place of light.

use serde::{Deserialize, Serialize};

use super::ConfigError;

/// Weights of a shape, at most.
const MOST_WEIGHTS: usize = 256;
/// Exposures and periods, at most: ten seconds.
const LONGEST_US: u32 = 10_000_000;

/// How much light counts from an exposure's start to its end. Written as `"box"` or as a list of weights.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Written", into = "Written")]
pub enum ExposureShape {
    /// All the same (default).
    #[default]
    Box,
    /// 2 to 256 weights, evenly from start to end and straight between each other; their scale does not matter. A shutter
    /// that opens and closes slowly is 0, 1, 1, 0.
    Weights(Vec<f64>),
}

/// As files and arguments have it.
#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum Written {
    Name(String),
    Weights(Vec<f64>),
}

impl From<ExposureShape> for Written {
    fn from(shape: ExposureShape) -> Self {
        match shape {
            ExposureShape::Box => Self::Name("box".into()),
            ExposureShape::Weights(weights) => Self::Weights(weights),
        }
    }
}

impl TryFrom<Written> for ExposureShape {
    type Error = ConfigError;

    fn try_from(written: Written) -> Result<Self, ConfigError> {
        match written {
            Written::Weights(weights) => Ok(Self::Weights(weights)),
            Written::Name(name) => name.parse(),
        }
    }
}

impl std::str::FromStr for ExposureShape {
    type Err = ConfigError;

    /// `box`, or weights between commas.
    fn from_str(text: &str) -> Result<Self, ConfigError> {
        if text == "box" {
            return Ok(Self::Box);
        }
        let weights: Result<Vec<f64>, _> = text.split(',').map(|weight| weight.trim().parse()).collect();
        match weights {
            Ok(weights) => Ok(Self::Weights(weights)),
            Err(_) => Err(ConfigError::new("shape of an exposure", text, "box, or weights such as 0,1,1,0")),
        }
    }
}

impl ExposureShape {
    /// Checks the weights; `what` names them.
    ///
    /// # Errors
    /// Fewer than 2 or more than 256 weights, one that is negative, above 1e9 or no number, and none of 1e-9 or more.
    pub fn check(&self, what: &str) -> Result<(), ConfigError> {
        let Self::Weights(weights) = self else { return Ok(()) };
        if !(2..=MOST_WEIGHTS).contains(&weights.len()) {
            let value = match weights.len() {
                1 => "a single weight".into(),
                n => format!("{n} weights"),
            };
            return Err(ConfigError::new(what, value, format!("box, or 2 to {MOST_WEIGHTS} weights")));
        }
        if let Some(bad) = weights.iter().find(|weight| !(0.0..=1e9).contains(*weight)) {
            return Err(ConfigError::new(what, format!("a weight of {bad}"), "weights from 0 to 1e9"));
        }
        if weights.iter().all(|weight| *weight < 1e-9) {
            return Err(ConfigError::new(what, "0 throughout", "weights of which one is 1e-9 or more"));
        }
        Ok(())
    }

    /// With w as the weight at s, s from 0 at an exposure's start to 1 at its end, and 1 as the integral of w over all of
    /// it: the integrals of w and of w (s - from) over `from..to`, exact but for rounding.
    pub fn moments(&self, from: f64, to: f64) -> [f64; 2] {
        let Self::Weights(weights) = self else {
            let length = to - from;
            return [length, 0.5 * length * length];
        };
        let pieces = weights.len() - 1;
        let (mut sums, mut whole) = ([0.0; 2], 0.0);
        for (i, pair) in weights.windows(2).enumerate() {
            whole += 0.5 * (pair[0] + pair[1]);
            // In pieces, from this one's start.
            let place = |s: f64| (s * pieces as f64 - i as f64).clamp(0.0, 1.0);
            let (a, b) = (place(from), place(to));
            let weight = |s: f64| pair[0] + (pair[1] - pair[0]) * s;
            let (length, w) = (b - a, [weight(a), weight(b)]);
            let before = i as f64 + a - from * pieces as f64;
            let area = 0.5 * length * (w[0] + w[1]);
            sums[0] += area;
            sums[1] += before * area + length * length * (w[0] + 2.0 * w[1]) / 6.0;
        }
        [sums[0] / whole, sums[1] / (whole * pieces as f64)]
    }
}

/// What pixels see: frames of light, each the mean of linear light over an exposure, in the place of light itself. The
/// EVIS paper's option of letting events see motion-blurred frames; real pixels have a bandwidth
/// ([`super::Photoreceptor`]) and no exposure. Off by default.
///
/// Exposures begin at the multiples of their period. A frame is a sample of the light at its exposure's middle, rounded down
/// to a microsecond; between two of them a pixel's signal is what it is between any two samples.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Exposure {
    /// How long light is gathered, up to 10 000 000; 0: pixels see light itself.
    pub time_us: u32,
    /// From the start of one exposure to that of the next, `time_us` to 10 000 000; 0: one begins where another ends.
    pub period_us: u32,
    /// How much light counts meanwhile.
    pub shape: ExposureShape,
}

impl Exposure {
    /// Whether pixels see light itself.
    pub const fn is_off(&self) -> bool {
        self.time_us == 0
    }

    /// # Errors
    /// Names the first value that cannot be used.
    pub(super) fn check(&self) -> Result<(), ConfigError> {
        let (time_us, period_us) = (self.time_us, self.period_us);
        if self.is_off() && *self != Self::default() {
            let remedy = "above 0 where the exposure has a period or a shape";
            return Err(ConfigError::new("exposure.time_us", time_us, remedy));
        }
        if time_us > LONGEST_US {
            let remedy = format!("at most {LONGEST_US} (ten seconds)");
            return Err(ConfigError::new("exposure.time_us", time_us, remedy));
        }
        if period_us != 0 && !(time_us..=LONGEST_US).contains(&period_us) {
            let remedy =
                format!("0 (one exposure after the other) or from {time_us}, its time_us, to {LONGEST_US}");
            return Err(ConfigError::new("exposure.period_us", period_us, remedy));
        }
        self.shape.check("exposure.shape")
    }

    fn period(&self) -> i64 {
        i64::from(if self.period_us == 0 { self.time_us } else { self.period_us }).max(1)
    }

    /// Number of the first exposure that begins at `t_us` or later.
    pub(crate) fn first_from(&self, t_us: i64) -> i64 {
        t_us.div_euclid(self.period()) + i64::from(t_us.rem_euclid(self.period()) > 0)
    }

    /// When exposure `k` begins.
    pub(crate) fn start_us(&self, k: i64) -> i64 {
        k.saturating_mul(self.period())
    }

    /// When its frame is a sample of the light.
    pub(crate) fn middle_us(&self, k: i64) -> i64 {
        self.start_us(k).saturating_add(i64::from(self.time_us / 2))
    }

    /// When it ends.
    pub(crate) fn end_us(&self, k: i64) -> i64 {
        self.start_us(k).saturating_add(i64::from(self.time_us))
    }

    /// All events before this time are known once light is known until `t_us`, in a stream that begins at 0.
    pub fn known_us(&self, t_us: i64) -> i64 {
        let ended = t_us.saturating_sub(i64::from(self.time_us)).div_euclid(self.period());
        if self.is_off() { t_us } else { self.middle_us(ended).max(0) }
    }

    /// Light must be known until then so that all events before `t_us` are: no earlier than `t_us`, and later by less than
    /// a period and an exposure.
    pub fn needed_us(&self, t_us: i64) -> i64 {
        if self.is_off() {
            t_us
        } else {
            self.end_us(self.first_from(t_us.saturating_sub(i64::from(self.time_us / 2))))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn weights(weights: &[f64]) -> ExposureShape {
        ExposureShape::Weights(weights.to_vec())
    }

    /// Mean of `light` under `shape`, from `parts` parts within which it is straight.
    fn mean(shape: &ExposureShape, parts: u32, light: impl Fn(f64) -> f64) -> f64 {
        let at = |k: u32| f64::from(k) / f64::from(parts);
        (0..parts)
            .map(|k| {
                let [area, lever] = shape.moments(at(k), at(k + 1));
                let (before, after) = (light(at(k)), light(at(k + 1)));
                area * before + lever * f64::from(parts) * (after - before)
            })
            .sum()
    }

    #[test]
    fn means_of_ramps_and_flicker_are_those_of_closed_forms() {
        // The centre of a trapezium's area, of a slow shutter and of a triangle.
        let (a, b) = (1.0, 0.2);
        let decay = (a + 2.0 * b) / (3.0 * (a + b));
        for (shape, centre) in [
            (ExposureShape::Box, 0.5),
            (weights(&[3.0, 3.0]), 0.5),
            (weights(&[a, b]), decay),
            (weights(&[0.0, 1.0, 1.0, 0.0]), 0.5),
            (weights(&[0.0, 0.0, 2.0]), 5.0 / 6.0),
        ] {
            for parts in [1, 2, 3, 7, 64] {
                let got = mean(&shape, parts, |s| 2.0 + 5.0 * s);
                assert!((got - (2.0 + 5.0 * centre)).abs() < 1e-12, "{shape:?} in {parts}: {got}");
                assert!((mean(&shape, parts, |_| 0.7) - 0.7).abs() < 1e-15, "{shape:?} in {parts}");
            }
        }
        // cos(pi f (2 s - 1)): sinc of f for the box, the square of sinc of f / 2 for the triangle.
        let sinc = |x: f64| (std::f64::consts::PI * x).sin() / (std::f64::consts::PI * x);
        for f in [0.3, 1.5, 3.0] {
            let wave = |s: f64| (std::f64::consts::PI * f * (2.0 * s - 1.0)).cos();
            let triangle = weights(&[0.0, 1.0, 0.0]);
            let (flat, peaked) = (mean(&ExposureShape::Box, 20_000, wave), mean(&triangle, 20_000, wave));
            assert!((flat - sinc(f)).abs() < 1e-7, "{f}: {flat}");
            assert!((peaked - sinc(f / 2.0).powi(2)).abs() < 1e-7, "{f}: {peaked}");
            assert!((flat - peaked).abs() > 1e-3, "canary: another shape");
        }
    }

    #[test]
    fn shapes_that_cannot_be_are_named() {
        for (shape, named) in [
            (weights(&[]), "0 weights"),
            (weights(&[1.0]), "a single weight"),
            (weights(&[1.0; 257]), "257 weights"),
            (weights(&[1.0, f64::NAN]), "NaN"),
            (weights(&[1.0, -0.5]), "-0.5"),
            (weights(&[1.0, f64::INFINITY]), "inf"),
            (weights(&[0.0, 0.0, 0.0]), "0 throughout"),
        ] {
            let error = shape.check("shape").unwrap_err().to_string();
            assert!(error.contains(named), "{error}");
        }
        for fine in [ExposureShape::Box, weights(&[0.0, 1.0]), weights(&[1.0; 256])] {
            assert!(fine.check("shape").is_ok(), "canary: {fine:?}");
        }
        assert_eq!("0, 1,1,0".parse(), Ok(weights(&[0.0, 1.0, 1.0, 0.0])));
        assert_eq!("box".parse(), Ok(ExposureShape::Box));
        let refused = |text: &str| text.parse::<ExposureShape>().unwrap_err().to_string();
        assert!(refused("bow").contains("bow") && refused("1,,2").contains("1,,2"));
    }

    #[test]
    fn what_is_known_is_what_is_needed() {
        for (time_us, period_us) in [(1, 0), (7, 0), (10, 0), (10, 33), (11, 12)] {
            let exposure = Exposure { time_us, period_us, ..Exposure::default() };
            for t in 0..200 {
                let needed = exposure.needed_us(t);
                let late = needed - t;
                assert!((0..exposure.period() + i64::from(time_us)).contains(&late), "{exposure:?} {t}");
                assert!(exposure.known_us(needed) >= t && exposure.known_us(needed - 1) < t.max(1), "{t}");
            }
        }
        assert_eq!((Exposure::default().needed_us(5), Exposure::default().known_us(5)), (5, 5));
    }
}
