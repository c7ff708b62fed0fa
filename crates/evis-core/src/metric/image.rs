//! Distances between pictures.

use super::MetricError;

/// Side of the SSIM window and its standard deviation in pixels, and the constants K1 and K2.
/// Wang et al., Image Quality Assessment: From Error Visibility to Structural Similarity, 2004, section III.B and C.
const WINDOW: usize = 11;
const SIGMA: f64 = 1.5;
const K1: f64 = 0.01;
const K2: f64 = 0.03;

/// A picture of f32 values, row-major, channels innermost.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    values: &'a [f32],
    height: usize,
    width: usize,
    channels: usize,
}

impl<'a> Frame<'a> {
    /// `height` × `width` pixels of `channels` values each.
    ///
    /// # Errors
    /// No pixels, or another number of values than this makes.
    pub fn new(values: &'a [f32], height: usize, width: usize, channels: usize) -> Result<Self, MetricError> {
        let expected = height.checked_mul(width).and_then(|n| n.checked_mul(channels)).unwrap_or(0);
        if expected == 0 || expected != values.len() {
            return Err(MetricError::Image(format!(
                "a picture of {height}x{width} pixels with {channels} channels and {} values; give height * width * \
                 channels values, at least one",
                values.len()
            )));
        }
        Ok(Self { values, height, width, channels })
    }

    fn size(&self) -> String {
        format!("{} high, {} wide, {} channels", self.height, self.width, self.channels)
    }
}

/// Mean square error.
///
/// # Errors
/// Pictures of different size, and values that are not finite.
pub fn mse(picture: Frame<'_>, reference: Frame<'_>) -> Result<f64, MetricError> {
    check_pair(&picture, &reference)?;
    let squares =
        picture.values.iter().zip(reference.values).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2));
    Ok(squares.sum::<f64>() / picture.values.len() as f64)
}

/// Peak signal-to-noise ratio in decibels, 10 log10(`data_range`² / MSE); +inf for equal pictures.
///
/// # Errors
/// As [`mse`], and a range that is not above 0.
pub fn psnr(picture: Frame<'_>, reference: Frame<'_>, data_range: f64) -> Result<f64, MetricError> {
    check_range(data_range)?;
    Ok(10.0 * (data_range * data_range / mse(picture, reference)?).log10())
}

/// Structural similarity, 1 for equal pictures.
///
/// Gaussian window of 11×11 pixels with a standard deviation of 1.5, K1 = 0.01, K2 = 0.03, variances divided by the
/// sum of weights; the mean over all windows that lie inside the picture, and over channels (Wang et al. 2004).
/// `data_range` is the difference between the largest and smallest value that a pixel can have.
///
/// # Errors
/// As [`psnr`], and pictures smaller than the window.
pub fn ssim(picture: Frame<'_>, reference: Frame<'_>, data_range: f64) -> Result<f64, MetricError> {
    check_pair(&picture, &reference)?;
    check_range(data_range)?;
    if picture.height < WINDOW || picture.width < WINDOW {
        return Err(MetricError::Image(format!(
            "SSIM of pictures {}; each side must have at least {WINDOW} pixels",
            picture.size()
        )));
    }
    let kernel = gaussian();
    let (c1, c2) = ((K1 * data_range).powi(2), (K2 * data_range).powi(2));
    let mut sum = 0.0;
    for channel in 0..picture.channels {
        let plane = |frame: &Frame<'_>| -> Vec<f64> {
            frame.values.iter().skip(channel).step_by(frame.channels).map(|v| f64::from(*v)).collect()
        };
        let (a, b) = (plane(&picture), plane(&reference));
        let product = |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| a * b).collect() };
        let smooth = |values: &[f64]| blurred(values, picture.width, &kernel);
        let (mean_a, mean_b) = (smooth(&a), smooth(&b));
        let (aa, bb, ab) = (smooth(&product(&a, &a)), smooth(&product(&b, &b)), smooth(&product(&a, &b)));
        let windows = mean_a.iter().zip(&mean_b).zip(aa.iter().zip(&bb).zip(&ab));
        let similarities = windows.map(|((ma, mb), ((aa, bb), ab))| {
            let (var_a, var_b, covariance) = (aa - ma * ma, bb - mb * mb, ab - ma * mb);
            (2.0 * ma * mb + c1) * (2.0 * covariance + c2) / ((ma * ma + mb * mb + c1) * (var_a + var_b + c2))
        });
        sum += similarities.sum::<f64>() / mean_a.len() as f64;
    }
    Ok(sum / picture.channels as f64)
}

fn check_pair(picture: &Frame<'_>, reference: &Frame<'_>) -> Result<(), MetricError> {
    let size = |f: &Frame<'_>| (f.height, f.width, f.channels);
    if size(picture) != size(reference) {
        return Err(MetricError::Image(format!(
            "the picture is {}, the reference {}; give two of one size",
            picture.size(),
            reference.size()
        )));
    }
    for (name, frame) in [("picture", picture), ("reference", reference)] {
        if let Some(at) = frame.values.iter().position(|v| !v.is_finite()) {
            let pixel = at / frame.channels;
            return Err(MetricError::Image(format!(
                "the {name} is {} at x = {}, y = {}; give finite values",
                frame.values.get(at).copied().unwrap_or(f32::NAN),
                pixel % frame.width,
                pixel / frame.width
            )));
        }
    }
    Ok(())
}

fn check_range(data_range: f64) -> Result<(), MetricError> {
    if data_range.is_finite() && data_range > 0.0 {
        return Ok(());
    }
    Err(MetricError::Setting {
        what: "data_range",
        value: data_range.to_string(),
        remedy:
            "a finite number above 0, the difference between white and black (1 for pictures from 0 to 1)"
                .into(),
    })
}

fn gaussian() -> [f64; WINDOW] {
    let centre = (WINDOW / 2) as f64;
    let weights: [f64; WINDOW] =
        std::array::from_fn(|i| (-(i as f64 - centre).powi(2) / (2.0 * SIGMA * SIGMA)).exp());
    let sum: f64 = weights.iter().sum();
    weights.map(|w| w / sum)
}

/// Weighted means over the windows inside a picture of this width.
fn blurred(values: &[f64], width: usize, kernel: &[f64; WINDOW]) -> Vec<f64> {
    let rows: Vec<f64> = values
        .chunks_exact(width)
        .flat_map(|row| row.windows(WINDOW).map(|w| w.iter().zip(kernel).map(|(v, k)| v * k).sum()))
        .collect();
    let inner = width - (WINDOW - 1);
    let tall = (WINDOW - 1) * inner;
    let column = |at: usize| rows.iter().skip(at).step_by(inner).zip(kernel).map(|(v, k)| v * k).sum();
    (0..rows.len().saturating_sub(tall)).map(column).collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::Random;
    use super::*;

    const SIZE: (usize, usize, usize) = (13, 17, 2);

    fn noise(seed: u64) -> Vec<f32> {
        let mut random = Random(seed);
        (0..SIZE.0 * SIZE.1 * SIZE.2).map(|_| random.below(1000) as f32 / 1000.0).collect()
    }

    fn frame(values: &[f32]) -> Frame<'_> {
        Frame::new(values, SIZE.0, SIZE.1, SIZE.2).unwrap()
    }

    /// One window at a time, with its own weights.
    fn slow_ssim(a: &[f32], b: &[f32]) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for (top, left, channel) in
            (0..3).flat_map(|y| (0..7).flat_map(move |x| (0..2).map(move |c| (y, x, c))))
        {
            let window = || {
                (0..121_usize).map(|k| {
                    let (dy, dx) = (k / 11, k % 11);
                    let far = (dy as f64 - 5.0).powi(2) + (dx as f64 - 5.0).powi(2);
                    let at = ((top + dy) * SIZE.1 + left + dx) * SIZE.2 + channel;
                    ((-far / 4.5).exp(), f64::from(a[at]), f64::from(b[at]))
                })
            };
            let total: f64 = window().map(|(w, ..)| w).sum();
            let mean =
                |of: &dyn Fn(f64, f64) -> f64| window().map(|(w, p, q)| w * of(p, q)).sum::<f64>() / total;
            let (ma, mb) = (mean(&|p, _| p), mean(&|_, q| q));
            let (va, vb) = (mean(&|p, _| (p - ma).powi(2)), mean(&|_, q| (q - mb).powi(2)));
            let covariance = mean(&|p, q| (p - ma) * (q - mb));
            sum += (2.0 * ma * mb + 1e-4) * (2.0 * covariance + 9e-4)
                / ((ma * ma + mb * mb + 1e-4) * (va + vb + 9e-4));
            count += 1.0;
        }
        sum / count
    }

    #[test]
    fn pictures_are_compared_by_their_formulas() {
        let (a, b) = (noise(1), noise(2));
        let ssim_of = |a: &[f32], b: &[f32]| ssim(frame(a), frame(b), 1.0).unwrap();
        assert!((ssim_of(&a, &b) - slow_ssim(&a, &b)).abs() < 1e-12);
        assert!((ssim_of(&a, &a) - 1.0).abs() < 1e-12);
        assert!(ssim_of(&a, &b) < 0.5, "canary: noise is not alike");
        let grey = vec![0.25; a.len()];
        let dark = vec![0.125; a.len()];
        assert_eq!(mse(frame(&grey), frame(&dark)), Ok(0.015_625));
        // 10 log10(4 / 0.015625) = 10 log10(256).
        assert!((psnr(frame(&grey), frame(&dark), 2.0).unwrap() - 24.082_399_653).abs() < 1e-6);
        assert_eq!(psnr(frame(&grey), frame(&grey), 2.0), Ok(f64::INFINITY));
    }

    #[test]
    fn pictures_that_cannot_be_compared_are_refused() {
        let (a, mut b) = (noise(1), noise(2));
        assert!(Frame::new(&a, 13, 17, 3).is_err() && Frame::new(&[], 0, 4, 1).is_err());
        assert!(Frame::new(&a, usize::MAX, 4, 1).is_err());
        let turned = Frame::new(&a, 17, 13, 2).unwrap();
        assert!(mse(frame(&a), turned).unwrap_err().to_string().contains("13 high, 17 wide"));
        let small = Frame::new(&a[..100], 10, 10, 1).unwrap();
        assert!(ssim(small, small, 1.0).unwrap_err().to_string().contains("at least 11"));
        for range in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(psnr(frame(&a), frame(&a), range).is_err() && ssim(frame(&a), frame(&a), range).is_err());
        }
        b[(2 * 17 + 5) * 2 + 1] = f32::NAN;
        assert!(mse(frame(&a), frame(&b)).unwrap_err().to_string().contains("NaN at x = 5, y = 2"));
    }
}
