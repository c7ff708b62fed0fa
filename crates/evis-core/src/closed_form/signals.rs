//! The patterns.

use std::f64::consts::{PI, TAU};

use super::light::{Coverage, PixelLight, wrapped};
use super::{Footprint, Signal};
use crate::sensor::ConfigError;

/// `mean + swing sin(phase + 2 pi (k . x - f t))`, drifting in any direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sinusoid {
    /// Mean light.
    pub mean: f64,
    /// Amplitude before the footprint weakens it.
    pub swing: f64,
    /// k, cycles per pixel along x and y.
    pub cycles_per_px: [f64; 2],
    /// f, cycles per second; positive drifts along k.
    pub frequency_hz: f64,
    /// Phase at the image's corner at t = 0.
    pub phase_radians: f64,
    /// Over what a pixel takes its mean; the box weakens the swing by `sinc(pi k_x) sinc(pi k_y)`, exactly.
    pub footprint: Footprint,
}

/// Light that changes evenly: `start + rate t + gradient . x`, never below 0. A pixel's mean is its centre's value
/// (exact wherever the whole pixel is lit).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinearRamp {
    /// Light at the image's corner at t = 0.
    pub start: f64,
    /// Light per second.
    pub rate_per_s: f64,
    /// Light per pixel along x and y.
    pub gradient_per_px: [f64; 2],
}

/// Light that changes by the same factor in equal times: `start exp(growth t + gradient . x)`, at the pixel's centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExponentialRamp {
    /// Light at the image's corner at t = 0.
    pub start: f64,
    /// Natural logarithm of the factor per second.
    pub growth_per_s: f64,
    /// Natural logarithm of the factor per pixel along x and y.
    pub gradient_per_px: [f64; 2],
}

/// A straight edge under the box filter: the pixel's area on either side of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// Light on the side that the edge comes from.
    pub light_behind: f64,
    /// Light on the side that it moves towards (at positive speed).
    pub light_ahead: f64,
    /// Direction across the edge, from x towards y (down).
    pub angle_radians: f64,
    /// Where the edge is at t = 0: `x cos(angle) + y sin(angle)` of its points.
    pub position_px: f64,
    /// Speed along the direction.
    pub speed_px_per_s: f64,
}

/// A straight bar under the box filter; it may be narrower than a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bar {
    /// Light on the bar.
    pub light_bar: f64,
    /// Light beside it.
    pub light_beside: f64,
    /// Distance between its edges.
    pub width_px: f64,
    /// Direction across the bar, from x towards y (down).
    pub angle_radians: f64,
    /// Where the bar's middle line is at t = 0: `x cos(angle) + y sin(angle)` of its points.
    pub position_px: f64,
    /// Speed along the direction.
    pub speed_px_per_s: f64,
}

/// Shape of a [`Flicker`]; the conventions are those of scene waveforms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FlickerShape {
    /// At the mean and rising at phase 0.
    Sine,
    /// High in the first half of a cycle, low in the second.
    Square,
    /// High in the first `duty` of a cycle, low in the rest.
    Pwm {
        /// In (0, 1).
        duty: f64,
    },
}

/// A lamp: every pixel alike, between `mean (1 - depth)` and `mean (1 + depth)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Flicker {
    /// Shape over a cycle.
    pub shape: FlickerShape,
    /// Half-way between low and high.
    pub mean: f64,
    /// 0 is still, 1 goes down to black.
    pub depth: f64,
    /// Cycles per second.
    pub frequency_hz: f64,
    /// Part of a cycle by which it is ahead.
    pub phase_cycles: f64,
}

/// A turning star, sinusoidal in angle: `mean + swing sin(phase + spokes (angle - turn t))`.
///
/// Under the box filter a pixel's light is still a sinusoid in time: turning the star only turns the phase of the box's
/// mean of `exp(i spokes angle)`, an integral along the box's four sides, taken by Gauss-Legendre quadrature to about 1e-9.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spokes {
    /// Mean light.
    pub mean: f64,
    /// Amplitude.
    pub swing: f64,
    /// Bright spokes around the circle.
    pub spokes: u32,
    /// Where the star's centre is in the image, pixels.
    pub center_px: [f64; 2],
    /// Radians per second, from x towards y (down).
    pub turn_per_s: f64,
    /// Phase along x at t = 0.
    pub phase_radians: f64,
    /// Over what a pixel takes its mean.
    pub footprint: Footprint,
}

fn finite(values: &[(&str, f64)]) -> Result<(), ConfigError> {
    values.iter().try_for_each(|(what, value)| {
        if value.is_finite() { Ok(()) } else { Err(ConfigError::new(what, value, "a finite number")) }
    })
}

fn lit(values: &[(&str, f64)]) -> Result<(), ConfigError> {
    values.iter().try_for_each(|(what, value)| {
        if value.is_finite() && *value >= 0.0 {
            Ok(())
        } else {
            Err(ConfigError::new(what, value, "a finite number, 0 or more"))
        }
    })
}

fn swings_above_black(mean: f64, swing: f64) -> Result<(), ConfigError> {
    lit(&[("mean", mean)])?;
    if swing.abs() <= mean {
        return Ok(());
    }
    Err(ConfigError::new("swing", swing, format!("at most the mean, {mean}: light is never negative")))
}

fn sinc(x: f64) -> f64 {
    if x == 0.0 { 1.0 } else { x.sin() / x }
}

impl Signal for Sinusoid {
    fn name(&self) -> &'static str {
        "sinusoid"
    }

    fn check(&self) -> Result<(), ConfigError> {
        swings_above_black(self.mean, self.swing)?;
        let [kx, ky] = self.cycles_per_px;
        finite(&[
            ("cycles_per_px", kx),
            ("cycles_per_px", ky),
            ("frequency_hz", self.frequency_hz),
            ("phase_radians", self.phase_radians),
        ])
    }

    fn pixel(&self, x: f64, y: f64) -> PixelLight {
        let [kx, ky] = self.cycles_per_px;
        let weaker = match self.footprint {
            Footprint::Point => 1.0,
            Footprint::Box => sinc(PI * kx) * sinc(PI * ky),
        };
        PixelLight::Sine {
            mean: self.mean,
            swing: self.swing * weaker,
            omega: -TAU * self.frequency_hz,
            phase: wrapped(self.phase_radians + TAU * (kx * x + ky * y)),
        }
    }

    fn speed_px_per_s(&self, _: f64, _: f64) -> f64 {
        let [kx, ky] = self.cycles_per_px;
        let wave = kx.hypot(ky);
        if wave == 0.0 { 0.0 } else { (self.frequency_hz / wave).abs() }
    }
}

impl Signal for LinearRamp {
    fn name(&self) -> &'static str {
        "linear ramp"
    }

    fn check(&self) -> Result<(), ConfigError> {
        let [gx, gy] = self.gradient_per_px;
        finite(&[("start", self.start), ("rate_per_s", self.rate_per_s), ("gradient", gx), ("gradient", gy)])
    }

    fn pixel(&self, x: f64, y: f64) -> PixelLight {
        let [gx, gy] = self.gradient_per_px;
        PixelLight::Linear { start: self.start + gx * x + gy * y, rate: self.rate_per_s }
    }
}

impl Signal for ExponentialRamp {
    fn name(&self) -> &'static str {
        "exponential ramp"
    }

    fn check(&self) -> Result<(), ConfigError> {
        lit(&[("start", self.start)])?;
        let [gx, gy] = self.gradient_per_px;
        finite(&[("growth_per_s", self.growth_per_s), ("gradient", gx), ("gradient", gy)])
    }

    fn pixel(&self, x: f64, y: f64) -> PixelLight {
        let [gx, gy] = self.gradient_per_px;
        PixelLight::Exponential { start: self.start * (gx * x + gy * y).exp(), growth: self.growth_per_s }
    }
}

/// Cosine and sine; of a direction along an axis, to a rounding, exactly that axis.
fn direction(angle: f64) -> [f64; 2] {
    let (sine, cosine) = angle.sin_cos();
    if sine.abs() < 1e-15 {
        [cosine.signum(), 0.0]
    } else if cosine.abs() < 1e-15 {
        [0.0, sine.signum()]
    } else {
        [cosine, sine]
    }
}

impl Signal for Edge {
    fn name(&self) -> &'static str {
        "edge"
    }

    fn check(&self) -> Result<(), ConfigError> {
        lit(&[("light_behind", self.light_behind), ("light_ahead", self.light_ahead)])?;
        finite(&[
            ("angle_radians", self.angle_radians),
            ("position_px", self.position_px),
            ("speed_px_per_s", self.speed_px_per_s),
        ])
    }

    fn pixel(&self, x: f64, y: f64) -> PixelLight {
        let direction = direction(self.angle_radians);
        PixelLight::Coverage(Coverage {
            outside: self.light_behind,
            inside: self.light_ahead,
            start_px: x * direction[0] + y * direction[1] - self.position_px,
            speed_px_per_s: self.speed_px_per_s,
            direction,
            width_px: None,
        })
    }

    fn speed_px_per_s(&self, _: f64, _: f64) -> f64 {
        self.speed_px_per_s.abs()
    }
}

impl Signal for Bar {
    fn name(&self) -> &'static str {
        "bar"
    }

    fn check(&self) -> Result<(), ConfigError> {
        lit(&[
            ("light_bar", self.light_bar),
            ("light_beside", self.light_beside),
            ("width_px", self.width_px),
        ])?;
        finite(&[
            ("angle_radians", self.angle_radians),
            ("position_px", self.position_px),
            ("speed_px_per_s", self.speed_px_per_s),
        ])
    }

    fn pixel(&self, x: f64, y: f64) -> PixelLight {
        let direction = direction(self.angle_radians);
        PixelLight::Coverage(Coverage {
            outside: self.light_beside,
            inside: self.light_bar,
            start_px: x * direction[0] + y * direction[1] - self.position_px,
            speed_px_per_s: self.speed_px_per_s,
            direction,
            width_px: Some(self.width_px),
        })
    }

    fn speed_px_per_s(&self, _: f64, _: f64) -> f64 {
        self.speed_px_per_s.abs()
    }
}

impl Signal for Flicker {
    fn name(&self) -> &'static str {
        match self.shape {
            FlickerShape::Sine => "sine flicker",
            FlickerShape::Square => "square flicker",
            FlickerShape::Pwm { .. } => "pwm flicker",
        }
    }

    fn check(&self) -> Result<(), ConfigError> {
        lit(&[("mean", self.mean), ("frequency_hz", self.frequency_hz)])?;
        finite(&[("phase_cycles", self.phase_cycles)])?;
        if !(0.0..=1.0).contains(&self.depth) {
            return Err(ConfigError::new("depth", self.depth, "between 0 and 1"));
        }
        match self.shape {
            FlickerShape::Pwm { duty } if !(duty > 0.0 && duty < 1.0) => {
                Err(ConfigError::new("duty", duty, "between 0 and 1"))
            }
            _ => Ok(()),
        }
    }

    fn pixel(&self, _: f64, _: f64) -> PixelLight {
        let Self { mean, depth, frequency_hz, phase_cycles, .. } = *self;
        let duty = match self.shape {
            FlickerShape::Sine => {
                return PixelLight::Sine {
                    mean,
                    swing: mean * depth,
                    omega: TAU * frequency_hz,
                    phase: wrapped(TAU * phase_cycles),
                };
            }
            FlickerShape::Square => 0.5,
            FlickerShape::Pwm { duty } => duty,
        };
        let (low, high) = (mean * (1.0 - depth), mean * (1.0 + depth));
        PixelLight::Square { low, high, frequency_hz, phase_cycles, duty }
    }
}

impl Signal for Spokes {
    fn name(&self) -> &'static str {
        "spokes"
    }

    fn check(&self) -> Result<(), ConfigError> {
        swings_above_black(self.mean, self.swing)?;
        if self.spokes > 10_000 {
            return Err(ConfigError::new("spokes", self.spokes, "at most 10000"));
        }
        finite(&[
            ("center_px", self.center_px[0]),
            ("center_px", self.center_px[1]),
            ("turn_per_s", self.turn_per_s),
            ("phase_radians", self.phase_radians),
        ])
    }

    fn pixel(&self, x: f64, y: f64) -> PixelLight {
        let (dx, dy) = (x - self.center_px[0], y - self.center_px[1]);
        let spokes = f64::from(self.spokes);
        let [re, im] = match self.footprint {
            Footprint::Point => {
                let angle = spokes * dy.atan2(dx);
                [angle.cos(), angle.sin()]
            }
            Footprint::Box => box_mean_of_turn(spokes, [dx, dy]),
        };
        PixelLight::Sine {
            mean: self.mean,
            swing: self.swing * re.hypot(im),
            omega: -spokes * self.turn_per_s,
            phase: wrapped(self.phase_radians + im.atan2(re)),
        }
    }

    fn speed_px_per_s(&self, x: f64, y: f64) -> f64 {
        (self.turn_per_s * (x - self.center_px[0]).hypot(y - self.center_px[1])).abs()
    }
}

/// Positive nodes and weights of Gauss-Legendre quadrature with 12 points on [-1, 1] (Abramowitz and Stegun, table
/// 25.4).
const GAUSS_12: [(f64, f64); 6] = [
    (0.125_233_408_511_468_9, 0.249_147_045_813_402_77),
    (0.367_831_498_998_180_2, 0.233_492_536_538_354_8),
    (0.587_317_954_286_617_5, 0.203_167_426_723_065_92),
    (0.769_902_674_194_304_7, 0.160_078_328_543_346_22),
    (0.904_117_256_370_474_9, 0.106_939_325_995_318_43),
    (0.981_560_634_246_719_3, 0.047_175_336_386_511_83),
];

/// Mean of `exp(i n angle)` over the unit square about `center`, as real and imaginary part.
///
/// The field `exp(i n angle) p / 2` has the divergence `exp(i n angle)`: the mean over the square is the flux through
/// its sides, an integral along each.
fn box_mean_of_turn(n: f64, [x, y]: [f64; 2]) -> [f64; 2] {
    let (left, right, top, bottom) = (x - 0.5, x + 0.5, y - 0.5, y + 0.5);
    let sides = [
        (right, [right, top], [right, bottom]),
        (-left, [left, top], [left, bottom]),
        (bottom, [left, bottom], [right, bottom]),
        (-top, [left, top], [right, top]),
    ];
    sides.into_iter().filter(|(outward, ..)| *outward != 0.0).fold([0.0; 2], |sum, (outward, from, to)| {
        let mean = side_mean_of_turn(n, from, to, 30);
        [sum[0] + 0.5 * outward * mean[0], sum[1] + 0.5 * outward * mean[1]]
    })
}

/// Mean of `exp(i n angle)` along the side `from`..`to`, which runs along an axis.
fn side_mean_of_turn(n: f64, from: [f64; 2], to: [f64; 2], depth: u32) -> [f64; 2] {
    let nearest = [0, 1].map(|i| 0.0_f64.clamp(from[i].min(to[i]), from[i].max(to[i])));
    let length = (to[0] - from[0]).hypot(to[1] - from[1]);
    let middle = [0, 1].map(|i| 0.5 * (from[i] + to[i]));
    if nearest[0].hypot(nearest[1]) < length * (n / 3.0).max(1.0) {
        // The mean is at most 1, and what is left about the foot of a near side is shorter than 1e-9 pixels a piece.
        if depth == 0 {
            return [0.0; 2];
        }
        let halves =
            [side_mean_of_turn(n, from, middle, depth - 1), side_mean_of_turn(n, middle, to, depth - 1)];
        return [0, 1].map(|i| 0.5 * (halves[0][i] + halves[1][i]));
    }
    let mut sum = [0.0; 2];
    for (at, weight) in GAUSS_12 {
        for at in [-at, at] {
            let [x, y] = [0, 1].map(|i| middle[i] + 0.5 * at * (to[i] - from[i]));
            let (sine, cosine) = (n * y.atan2(x)).sin_cos();
            sum = [sum[0] + 0.5 * weight * cosine, sum[1] + 0.5 * weight * sine];
        }
    }
    sum
}
