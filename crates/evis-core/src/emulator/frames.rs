//! Frames from elsewhere, and how 64 of their pixels become light or its logarithm.

use serde::{Deserialize, Serialize};

use crate::luminance::LUMINANCE_WEIGHTS;
use crate::sensor::{ConfigError, SensorConfig};
use crate::simd;
use crate::trigger::TIE;

/// Pixels that a kernel treats at once.
pub(crate) const BLOCK: usize = 64;

/// Pixels per tile, at most: the unit of work of a thread. Its memory stays within a core's second cache.
pub(crate) const TILE: usize = 1 << 14;

/// How integers became what they are: the curve between linear light and stored values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Transfer {
    /// IEC 61966-2-1: what cameras, images and screens call sRGB (default).
    #[default]
    Srgb,
    /// Rec. ITU-R BT.709-6, item 1.2: video.
    Rec709,
    /// A power: light = value^gamma.
    Gamma(f32),
    /// The value is the light.
    Linear,
}

impl Transfer {
    /// Linear light of `value`, both 0 to 1.
    pub fn light(self, value: f64) -> f64 {
        match self {
            Self::Srgb if value <= 0.040_45 => value / 12.92,
            Self::Srgb => ((value + 0.055) / 1.055).powf(2.4),
            Self::Rec709 if value < 0.081 => value / 4.5,
            Self::Rec709 => ((value + 0.099) / 1.099).powf(1.0 / 0.45),
            Self::Gamma(gamma) => value.powf(gamma.into()),
            Self::Linear => value,
        }
    }

    /// Checks the exponent.
    ///
    /// # Errors
    /// A gamma that is not above 0, or above 10.
    pub fn check(self) -> Result<(), ConfigError> {
        match self {
            Self::Gamma(gamma) if !(gamma > 0.0 && gamma <= 10.0) => {
                Err(ConfigError::new("gamma", gamma, "above 0 and at most 10"))
            }
            _ => Ok(()),
        }
    }
}

/// What the numbers of a frame are.
#[derive(Clone, Copy, Debug)]
pub enum FrameData<'a> {
    /// Linear, scene-referred light.
    Linear(&'a [f32]),
    /// The logarithm of light, ready for the trigger: `ln(Y / Y_ref + eps)` or any other; one channel.
    Log(&'a [f32]),
    /// 8-bit values under a transfer curve.
    U8(&'a [u8], Transfer),
    /// 16-bit values under a transfer curve.
    U16(&'a [u16], Transfer),
}

impl FrameData<'_> {
    fn len(&self) -> usize {
        match self {
            Self::Linear(values) | Self::Log(values) => values.len(),
            Self::U8(values, _) => values.len(),
            Self::U16(values, _) => values.len(),
        }
    }
}

/// One frame per environment, row-major, environments outermost, channels innermost.
#[derive(Clone, Copy, Debug)]
pub struct Frames<'a> {
    /// The numbers.
    pub data: FrameData<'a>,
    /// Values per pixel: 1, or 3 for R, G, B.
    pub channels: usize,
}

impl<'a> Frames<'a> {
    /// One channel of linear light.
    pub const fn linear(values: &'a [f32]) -> Self {
        Self { data: FrameData::Linear(values), channels: 1 }
    }

    /// One channel of 8-bit values.
    pub const fn u8(values: &'a [u8], transfer: Transfer) -> Self {
        Self { data: FrameData::U8(values, transfer), channels: 1 }
    }

    /// One channel of 16-bit values.
    pub const fn u16(values: &'a [u16], transfer: Transfer) -> Self {
        Self { data: FrameData::U16(values, transfer), channels: 1 }
    }

    /// One channel of logarithms.
    pub const fn log(values: &'a [f32]) -> Self {
        Self { data: FrameData::Log(values), channels: 1 }
    }

    /// The same numbers as R, G, B triples.
    pub const fn rgb(self) -> Self {
        Self { channels: 3, ..self }
    }

    /// Luminance per pixel; `None` of logarithms.
    pub(crate) fn luminance(&self) -> Option<Vec<f32>> {
        let of_codes = |codes: &mut dyn Iterator<Item = f64>, transfer: Transfer| -> Vec<f32> {
            codes.map(|code| transfer.light(code) as f32).collect()
        };
        Some(match self.data {
            FrameData::Linear(values) => linear_luminance(values, self.channels),
            FrameData::U8(codes, transfer) => {
                let codes = &mut codes.iter().map(|code| f64::from(*code) / f64::from(u8::MAX));
                linear_luminance(&of_codes(codes, transfer), self.channels)
            }
            FrameData::U16(codes, transfer) => {
                let codes = &mut codes.iter().map(|code| f64::from(*code) / f64::from(u16::MAX));
                linear_luminance(&of_codes(codes, transfer), self.channels)
            }
            FrameData::Log(_) => return None,
        })
    }

    /// Checks what does not depend on single pixels.
    pub(crate) fn check(&self, pixels: usize) -> Result<(), ConfigError> {
        if !matches!(self.channels, 1 | 3) {
            return Err(ConfigError::new("channels", self.channels, "1 (luminance) or 3 (R, G, B)"));
        }
        match self.data {
            FrameData::Log(_) if self.channels != 1 => {
                return Err(ConfigError::new("channels", self.channels, "1 where frames hold logarithms"));
            }
            FrameData::U8(_, transfer) | FrameData::U16(_, transfer) => transfer.check()?,
            _ => {}
        }
        if self.data.len() != pixels * self.channels {
            return Err(ConfigError::new(
                "number of values",
                self.data.len(),
                format!("{} (environments × height × width × channels)", pixels * self.channels),
            ));
        }
        Ok(())
    }
}

/// Luminance per pixel of linear light, R, G, B triples where there are three channels.
pub(crate) fn linear_luminance(values: &[f32], channels: usize) -> Vec<f32> {
    if channels == 1 {
        return values.to_vec();
    }
    let weights = LUMINANCE_WEIGHTS.map(|weight| weight as f32);
    let (triples, _) = values.as_chunks::<3>();
    triples.iter().map(|[r, g, b]| weights[0] * r + weights[1] * g + weights[2] * b).collect()
}

/// Bins of [`Tables::ranges`].
const BINS: usize = 4096;

/// What each integer value means, one table per channel; built once per transfer curve.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tables {
    built_for: Option<(bool, usize, Transfer)>,
    /// Thresholds that ranges are made for: ON, OFF.
    thresholds: [f32; 2],
    /// Light over `Y_ref`, weighted per channel where there are three.
    light: [Vec<f32>; 3],
    /// `ln(light + eps)` for one channel.
    log: Vec<f32>,
    /// From references back to values, coarsely: [`Codes`].
    ranges: Vec<[u16; 2]>,
    base: f32,
    bins_per_unit: f32,
}

/// A table of logarithms of one channel of integers, and what values references allow.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Codes<'a> {
    /// `ln(light + eps)` of each value, rising.
    log: &'a [f32],
    /// Per bin of references: the first and the last value at which no pixel of such a reference fires.
    ranges: &'a [[u16; 2]; BINS],
    base: f32,
    bins_per_unit: f32,
}

impl Codes<'_> {
    #[inline(always)]
    pub fn log(&self, code: usize) -> f32 {
        self.log[code]
    }

    /// `[low, high]`: values at which nothing fires, up to a bin fewer than there are; none where `low` is above `high`.
    #[inline(always)]
    pub fn range(&self, reference: f32) -> [u16; 2] {
        // The conversion stops at 0 and at 2^30.
        self.ranges[(simd::whole((reference - self.base) * self.bins_per_unit) as usize).min(BINS - 1)]
    }
}

impl Tables {
    /// Builds the tables that `frames` need, unless they are there already.
    pub fn prepare(&mut self, frames: &Frames<'_>, inverse_reference: f32, sensor: &SensorConfig) {
        let eps = sensor.log_eps;
        let (wide, transfer) = match frames.data {
            FrameData::U8(_, transfer) => (false, transfer),
            FrameData::U16(_, transfer) => (true, transfer),
            FrameData::Linear(_) | FrameData::Log(_) => return,
        };
        let wanted = Some((wide, frames.channels, transfer));
        if self.built_for == wanted {
            return;
        }
        let last = if wide { u32::from(u16::MAX) } else { u32::from(u8::MAX) };
        let table = |weight: f64| -> Vec<f32> {
            let light = |code| transfer.light(f64::from(code) / f64::from(last));
            (0..=last).map(|code| (weight * light(code)) as f32 * inverse_reference).collect()
        };
        self.light = match frames.channels {
            1 => [table(1.0), Vec::new(), Vec::new()],
            _ => LUMINANCE_WEIGHTS.map(table),
        };
        self.log = match frames.channels {
            1 => self.light[0].iter().map(|light| simd::ln(light + eps)).collect(),
            _ => Vec::new(),
        };
        self.thresholds = [sensor.threshold_on, sensor.threshold_off];
        self.invert();
        self.built_for = wanted;
    }

    /// The way from references back to values.
    fn invert(&mut self) {
        let (Some(first), Some(last)) = (self.log.first(), self.log.last()) else { return };
        let [on, off] = self.thresholds.map(f64::from);
        // No reference is farther from all values than a threshold. A hundredth of a bin makes up for rounding where a bin
        // is looked up, and the first and the last one have all that lies beyond.
        let (first, last) = (f64::from(*first) - on, f64::from(*last) + off);
        let bin = (last - first) / (BINS - 3) as f64;
        let base = first - 1.5 * bin;
        self.base = base as f32;
        self.bins_per_unit = (1.0 / bin) as f32;
        let margin = f64::from(margin(first.abs().max(last.abs()) as f32));
        let count = |log: f64| self.log.partition_point(|code| f64::from(*code) < log);
        let code = |index: usize| index.min(self.log.len() - 1) as u16;
        let range = |i: usize| {
            let (from, to) = (base + (i as f64 - 0.01) * bin, base + (i as f64 + 1.01) * bin);
            let (low, high) = (count(to - off + margin), count(from + on - margin));
            // No value of the scale may be between them.
            if low >= high || i == 0 || i == BINS - 1 { [u16::MAX, 0] } else { [code(low), code(high - 1)] }
        };
        self.ranges = (0..BINS).map(range).collect();
    }

    /// The table of one-channel integers.
    pub fn codes(&self) -> Option<Codes<'_>> {
        Some(Codes {
            log: &self.log,
            ranges: self.ranges.first_chunk()?,
            base: self.base,
            bins_per_unit: self.bins_per_unit,
        })
    }
}

/// Where a kernel reads an environment's pixels from: chosen once per push.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Source<'a> {
    Linear { values: &'a [f32], inverse_reference: f32 },
    LinearRgb { values: &'a [f32], weights: [f32; 3] },
    Log { values: &'a [f32] },
    U8 { values: &'a [u8], light: &'a [f32; 256], codes: Codes<'a> },
    U8Rgb { values: &'a [u8], light: [&'a [f32; 256]; 3] },
    U16 { values: &'a [u16], light: &'a [f32; 65536], codes: Codes<'a> },
    U16Rgb { values: &'a [u16], light: [&'a [f32; 65536]; 3] },
}

impl<'a> Source<'a> {
    /// The frame of environment `index`, of `pixels` pixels.
    pub fn new(
        frames: &Frames<'a>,
        tables: &'a Tables,
        inverse_reference: f32,
        index: usize,
        pixels: usize,
    ) -> Option<Self> {
        let range = index * pixels * frames.channels..(index + 1) * pixels * frames.channels;
        let rgb = frames.channels == 3;
        let [r, g, b] = &tables.light;
        Some(match frames.data {
            FrameData::Log(values) => Self::Log { values: values.get(range)? },
            FrameData::Linear(values) if rgb => Self::LinearRgb {
                values: values.get(range)?,
                weights: LUMINANCE_WEIGHTS.map(|weight| weight as f32 * inverse_reference),
            },
            FrameData::Linear(values) => Self::Linear { values: values.get(range)?, inverse_reference },
            FrameData::U8(values, _) if rgb => Self::U8Rgb {
                values: values.get(range)?,
                light: [r.first_chunk()?, g.first_chunk()?, b.first_chunk()?],
            },
            FrameData::U8(values, _) => {
                Self::U8 { values: values.get(range)?, light: r.first_chunk()?, codes: tables.codes()? }
            }
            FrameData::U16(values, _) if rgb => Self::U16Rgb {
                values: values.get(range)?,
                light: [r.first_chunk()?, g.first_chunk()?, b.first_chunk()?],
            },
            FrameData::U16(values, _) => {
                Self::U16 { values: values.get(range)?, light: r.first_chunk()?, codes: tables.codes()? }
            }
        })
    }

    /// How far from a level a signal of these frames may be and still be on it: integers come back to where they were.
    pub const fn tie(&self) -> f32 {
        match self {
            Self::Linear { .. } | Self::LinearRgb { .. } | Self::Log { .. } => 0.0,
            Self::U8 { .. } | Self::U8Rgb { .. } | Self::U16 { .. } | Self::U16Rgb { .. } => TIE,
        }
    }

    /// `Y / Y_ref` of up to 64 pixels from `first`; the rest of `out` becomes NaN. Of logarithms, `e^l - eps`.
    #[inline(always)]
    pub fn load_light(&self, first: usize, eps: f32, out: &mut [f32; BLOCK]) {
        match *self {
            Self::Linear { values, inverse_reference } => {
                copy(values, first, f32::NAN, out, |light| light * inverse_reference);
            }
            // Of NaN, `max` would make light.
            Self::Log { values } => copy(values, first, f32::NAN, out, |log| match log.exp() - eps {
                light if light < 0.0 => 0.0,
                light => light,
            }),
            Self::U8 { values, light, .. } => {
                copy(values, first, f32::NAN, out, |code| light[usize::from(code)])
            }
            Self::U16 { values, light, .. } => {
                copy(values, first, f32::NAN, out, |code| light[usize::from(code)])
            }
            Self::LinearRgb { values, weights: [r, g, b] } => {
                copy3(values, first, out, |[x, y, z]| r * x + g * y + b * z);
            }
            Self::U8Rgb { values, light: [r, g, b] } => {
                copy3(values, first, out, |[x, y, z]| {
                    r[usize::from(x)] + g[usize::from(y)] + b[usize::from(z)]
                });
            }
            Self::U16Rgb { values, light: [r, g, b] } => {
                copy3(values, first, out, |[x, y, z]| {
                    r[usize::from(x)] + g[usize::from(y)] + b[usize::from(z)]
                });
            }
        }
    }
}

#[inline(always)]
pub(crate) fn copy<T: Copy, U: Copy>(
    values: &[T],
    first: usize,
    missing: U,
    out: &mut [U; BLOCK],
    value: impl Fn(T) -> U,
) {
    let values = values.get(first..).unwrap_or(&[]);
    if let Some(block) = values.first_chunk::<BLOCK>() {
        for (out, from) in out.iter_mut().zip(block) {
            *out = value(*from);
        }
    } else {
        out.fill(missing);
        for (out, from) in out.iter_mut().zip(values) {
            *out = value(*from);
        }
    }
}

/// [`copy`] of the values as they are: one move of memory.
#[inline(always)]
pub(crate) fn copy_plain<T: Copy>(values: &[T], first: usize, missing: T, out: &mut [T; BLOCK]) {
    let values = values.get(first..).unwrap_or(&[]);
    if let Some(block) = values.first_chunk::<BLOCK>() {
        *out = *block;
    } else {
        out.fill(missing);
        out[..values.len()].copy_from_slice(values);
    }
}

#[inline(always)]
fn copy3<T: Copy>(values: &[T], first: usize, out: &mut [f32; BLOCK], value: impl Fn([T; 3]) -> f32) {
    let (triples, _) = values.as_chunks::<3>();
    copy(triples, first, f32::NAN, out, value);
}

/// How much narrower a range is kept on either side, in log units.
#[inline(always)]
pub(crate) fn margin(reference: f32) -> f32 {
    2e-6 + 1e-6 * reference.abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_meet_their_standards() {
        // IEC 61966-2-1 and BT.709-6: value 0.5, and the joints of the two pieces.
        let close = |a: f64, b: f64| (a - b).abs() < 1e-4;
        assert!(close(Transfer::Srgb.light(0.5), 0.214_04));
        assert!(close(Transfer::Rec709.light(0.5), 0.259_58));
        assert!(close(Transfer::Gamma(2.2).light(0.5), 0.217_64));
        assert!(close(Transfer::Linear.light(0.5), 0.5));
        for transfer in [Transfer::Srgb, Transfer::Rec709, Transfer::Gamma(2.2), Transfer::Linear] {
            assert!(close(transfer.light(0.0), 0.0) && close(transfer.light(1.0), 1.0));
            for joint in [0.040_45, 0.081] {
                let jump = transfer.light(joint + 1e-9) - transfer.light(joint - 1e-9);
                assert!(jump.abs() < 1e-4, "{transfer:?} jumps by {jump} at {joint}");
            }
        }
    }
}
