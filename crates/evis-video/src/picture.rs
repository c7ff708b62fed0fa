//! A frame as it was stored, and frames of another size.

use evis_core::{ConfigError, FrameData, Frames, Transfer};

/// Floats whose mean is so many times the reference are hardly linear light.
const MOST_MEAN: f64 = 16.0;

/// The numbers of a picture, row-major, channels innermost.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// 8 bits under a transfer curve.
    U8(Vec<u8>),
    /// 16 bits under a transfer curve.
    U16(Vec<u16>),
    /// Linear light.
    F32(Vec<f32>),
}

impl Values {
    /// How many there are.
    pub fn len(&self) -> usize {
        match self {
            Self::U8(values) => values.len(),
            Self::U16(values) => values.len(),
            Self::F32(values) => values.len(),
        }
    }

    /// R, G and B of R, G, B and alpha.
    pub(crate) fn without_alpha(self) -> Self {
        fn colors<T: Copy>(values: &[T]) -> Vec<T> {
            let (pixels, _) = values.as_chunks::<4>();
            pixels.iter().flat_map(|[r, g, b, _]| [*r, *g, *b]).collect()
        }
        match self {
            Self::U8(values) => Self::U8(colors(&values)),
            Self::U16(values) => Self::U16(colors(&values)),
            Self::F32(values) => Self::F32(colors(&values)),
        }
    }

    /// The mean of floats that are numbers, where they are floats.
    fn mean_of_floats(&self) -> Option<f64> {
        let Self::F32(values) = self else { return None };
        let (sum, count) = values
            .iter()
            .filter(|value| value.is_finite())
            .fold((0.0, 0_u64), |(sum, count), value| (sum + f64::from(*value), count + 1));
        (count > 0).then(|| sum / count as f64)
    }

    /// Asks whether floats are 0 to 255, where their mean is far beyond `reference_luminance`.
    pub(crate) fn hardly_light(&self, reference_luminance: f32) -> Option<String> {
        let mean = self.mean_of_floats()?;
        (mean > MOST_MEAN * f64::from(reference_luminance)).then(|| {
            format!(
                "the first frame's floats are {mean:.3} on average, more than {MOST_MEAN} times the reference luminance \
                 {reference_luminance}; are they 0 to 255? Floats are linear light with white at 1: divide them by 255 and decode \
                 their curve, or give integers"
            )
        })
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// One frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Values per pixel: 1, or 3 for R, G, B.
    pub channels: usize,
    /// The numbers.
    pub values: Values,
}

impl Picture {
    /// The picture as the emulator takes it; integers are read through `transfer`.
    pub fn frames(&self, transfer: Transfer) -> Frames<'_> {
        let data = match &self.values {
            Values::U8(values) => FrameData::U8(values, transfer),
            Values::U16(values) => FrameData::U16(values, transfer),
            Values::F32(values) => FrameData::Linear(values),
        };
        Frames { data, channels: self.channels }
    }

    /// The picture in linear light with `width` × `height` pixels: each the mean over its area where there are fewer,
    /// bilinear where there are more.
    ///
    /// # Errors
    /// A gamma that cannot be.
    pub fn resized(&self, width: u32, height: u32, transfer: Transfer) -> Result<Self, ConfigError> {
        transfer.check()?;
        let columns = weights(self.width as usize, width as usize);
        let rows = weights(self.height as usize, height as usize);
        let values = match &self.values {
            Values::U8(values) => {
                let light = table(transfer, 255);
                self.averaged(&columns, &rows, |i| light[usize::from(values[i])])
            }
            Values::U16(values) => {
                let light = table(transfer, 65_535);
                self.averaged(&columns, &rows, |i| light[usize::from(values[i])])
            }
            Values::F32(values) => self.averaged(&columns, &rows, |i| values[i]),
        };
        Ok(Self { width, height, channels: self.channels, values: Values::F32(values) })
    }

    /// A picture of one channel in each of `channels` channels.
    pub(crate) fn repeated(self, channels: usize) -> Self {
        fn all<T: Copy>(values: Vec<T>, channels: usize) -> Vec<T> {
            values.into_iter().flat_map(|value| std::iter::repeat_n(value, channels)).collect()
        }
        if self.channels != 1 || channels == 1 {
            return self;
        }
        let values = match self.values {
            Values::U8(values) => Values::U8(all(values, channels)),
            Values::U16(values) => Values::U16(all(values, channels)),
            Values::F32(values) => Values::F32(all(values, channels)),
        };
        Self { channels, values, ..self }
    }

    fn averaged(&self, columns: &[Weights], rows: &[Weights], light: impl Fn(usize) -> f32) -> Vec<f32> {
        let (channels, wide) = (self.channels, columns.len() * self.channels);
        let mut out = vec![0.0_f32; wide * rows.len()];
        let mut line = vec![0.0_f32; self.width as usize * channels];
        for (row, out) in rows.iter().zip(out.chunks_exact_mut(wide)) {
            line.fill(0.0);
            for (y, weight) in row.at() {
                let start = y * line.len();
                for (i, sum) in line.iter_mut().enumerate() {
                    *sum += weight * light(start + i);
                }
            }
            for (column, out) in columns.iter().zip(out.chunks_exact_mut(channels)) {
                for (channel, out) in out.iter_mut().enumerate() {
                    *out = column.at().map(|(x, weight)| weight * line[x * channels + channel]).sum();
                }
            }
        }
        out
    }
}

/// Linear light of every integer.
fn table(transfer: Transfer, last: u32) -> Vec<f32> {
    (0..=last).map(|code| transfer.light(f64::from(code) / f64::from(last)) as f32).collect()
}

/// Which samples of a row make one of another length, and their shares, whose sum is 1.
#[derive(Clone, Debug)]
struct Weights {
    first: usize,
    shares: Vec<f32>,
}

impl Weights {
    fn at(&self) -> impl Iterator<Item = (usize, f32)> + '_ {
        self.shares.iter().enumerate().map(|(i, share)| (self.first + i, *share))
    }
}

fn weights(from: usize, to: usize) -> Vec<Weights> {
    let ratio = from as f64 / to as f64;
    (0..to)
        .map(|i| {
            if to > from {
                // Samples lie at the middle of their pixels; beyond the outer ones nothing is known.
                let place = ((i as f64 + 0.5) * ratio - 0.5).clamp(0.0, (from - 1) as f64);
                let first = (place as usize).min(from.saturating_sub(2));
                let part = (place - first as f64) as f32;
                let shares = if from == 1 { vec![1.0] } else { vec![1.0 - part, part] };
                return Weights { first, shares };
            }
            let (low, high) = (i as f64 * ratio, (i + 1) as f64 * ratio);
            let first = (low as usize).min(from - 1);
            let last = (high.ceil() as usize).clamp(first + 1, from);
            let overlap = |k: usize| (high.min((k + 1) as f64) - low.max(k as f64)).max(0.0);
            let whole: f64 = (first..last).map(overlap).sum();
            let shares = (first..last).map(|k| (overlap(k) / whole) as f32).collect();
            Weights { first, shares }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(width: u32, height: u32, values: Vec<f32>) -> Picture {
        Picture { width, height, channels: 1, values: Values::F32(values) }
    }

    #[test]
    fn a_smaller_picture_has_the_mean_of_the_light() {
        // Codes 0 and 255: half the light, which is not half the code.
        let picture = Picture { width: 2, height: 1, channels: 1, values: Values::U8(vec![0, 255]) };
        let small = picture.resized(1, 1, Transfer::Srgb).unwrap();
        assert_eq!(small.values, Values::F32(vec![0.5]));
        let wrong = Transfer::Srgb.light(127.5 / 255.0);
        assert!((wrong - 0.5).abs() > 0.2, "canary: a mean of codes would be {wrong}");

        let values: Vec<f32> = (0..35).map(|i| ((i * 37 + 11) % 17) as f32).collect();
        let mean = values.iter().sum::<f32>() / 35.0;
        for (width, height) in [(3, 2), (1, 1), (6, 5), (7, 5)] {
            let out = grey(7, 5, values.clone()).resized(width, height, Transfer::Linear).unwrap();
            let Values::F32(out) = out.values else { panic!("not linear") };
            assert_eq!(out.len(), (width * height) as usize);
            let got = out.iter().sum::<f32>() / out.len() as f32;
            assert!((got - mean).abs() < 1e-4, "{width}x{height}: {got}, not {mean}");
        }
    }

    #[test]
    fn a_larger_picture_keeps_a_ramp() {
        let out = grey(4, 1, vec![0.0, 1.0, 2.0, 3.0]).resized(8, 2, Transfer::Linear).unwrap();
        let row = [0.0, 0.25, 0.75, 1.25, 1.75, 2.25, 2.75, 3.0];
        assert_eq!(out.values, Values::F32(row.iter().chain(&row).copied().collect()));
        let one = grey(1, 1, vec![0.7]).resized(3, 1, Transfer::Linear).unwrap();
        assert_eq!(one.values, Values::F32(vec![0.7; 3]));
    }

    #[test]
    fn colours_stay_apart() {
        let values = Values::U16(vec![0, 65_535, 0, 65_535, 65_535, 0]);
        let picture = Picture { width: 2, height: 1, channels: 3, values };
        let out = picture.resized(1, 1, Transfer::Linear).unwrap();
        assert_eq!(out.values, Values::F32(vec![0.5, 1.0, 0.0]));
    }
}
