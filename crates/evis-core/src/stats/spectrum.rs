//! Power and autocorrelation of a row of counts.

/// Steps of a segment, at most.
const SEGMENT: usize = 4096;

/// Welch's estimate with Hann windows that overlap by half (IEEE Trans. Audio Electroacoust. 15, 1967), over the power of
/// a Poisson process of the same rate; means over third octaves.
pub(super) fn spectrum(counts: &[f64], step_s: f64) -> Vec<[f64; 2]> {
    let mut segment = SEGMENT;
    // Fifteen segments or more, so that a mean means something.
    while segment * 8 > counts.len() {
        segment /= 2;
    }
    let mean = counts.iter().sum::<f64>() / counts.len().max(1) as f64;
    if segment < 64 || mean <= 0.0 {
        return Vec::new();
    }
    let window = |i: usize| (std::f64::consts::PI * i as f64 / segment as f64).sin().powi(2);
    let norm: f64 = (0..segment).map(|i| window(i).powi(2)).sum();
    let mut power = vec![0.0; segment / 2];
    let mut segments = 0.0;
    for start in (0..=counts.len() - segment).step_by(segment / 2) {
        let mut real: Vec<f64> = (0..segment).map(|i| (counts[start + i] - mean) * window(i)).collect();
        let mut imaginary = vec![0.0; segment];
        transform(&mut real, &mut imaginary);
        for (k, power) in power.iter_mut().enumerate() {
            *power += (real[k].powi(2) + imaginary[k].powi(2)) / (norm * mean);
        }
        segments += 1.0;
    }
    let hz = 1.0 / (segment as f64 * step_s);
    let mut points = Vec::new();
    let mut from = 1;
    while from < power.len() {
        let to = ((from as f64 * 2_f64.powf(1.0 / 3.0)) as usize).max(from + 1).min(power.len());
        let sum: f64 = power[from..to].iter().sum();
        points.push([(from + to - 1) as f64 / 2.0 * hz, sum / (to - from) as f64 / segments]);
        from = to;
    }
    points
}

/// Discrete Fourier transform of a power of two, in place (Cooley and Tukey, Math. Comput. 19, 1965).
fn transform(real: &mut [f64], imaginary: &mut [f64]) {
    let n = real.len();
    let bits = n.trailing_zeros();
    for i in 0..n {
        let j = i.reverse_bits() >> (usize::BITS - bits);
        if i < j {
            real.swap(i, j);
            imaginary.swap(i, j);
        }
    }
    let mut half = 1;
    while half < n {
        for k in 0..half {
            let (sin, cos) = (-std::f64::consts::PI * k as f64 / half as f64).sin_cos();
            for i in (k..n).step_by(2 * half) {
                let j = i + half;
                let (re, im) = (real[j] * cos - imaginary[j] * sin, real[j] * sin + imaginary[j] * cos);
                (real[j], imaginary[j]) = (real[i] - re, imaginary[i] - im);
                (real[i], imaginary[i]) = (real[i] + re, imaginary[i] + im);
            }
        }
        half *= 2;
    }
}

/// Autocorrelation at steps that grow.
pub(super) fn autocorrelation(counts: &[f64], step_s: f64) -> Vec<[f64; 2]> {
    let n = counts.len();
    let mean = counts.iter().sum::<f64>() / n.max(1) as f64;
    let variance = counts.iter().map(|count| (count - mean).powi(2)).sum::<f64>() / n.max(1) as f64;
    if n < 64 || variance <= 0.0 {
        return Vec::new();
    }
    let lags = [1, 2, 3, 5, 7, 10, 20, 30, 50, 70, 100, 200, 300, 500, 700, 1000];
    let at = |lag: usize| {
        let sum: f64 = counts.iter().zip(&counts[lag..]).map(|(a, b)| (a - mean) * (b - mean)).sum();
        sum / (n - lag) as f64 / variance
    };
    let used = lags.into_iter().filter(|lag| lag * 4 <= n);
    used.map(|lag| [lag as f64 * step_s, at(lag)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sine_has_its_power_at_its_frequency() {
        let count = |i: usize| 100.0 + 20.0 * (std::f64::consts::TAU * 0.05 * i as f64).sin();
        let counts: Vec<f64> = (0..20_000).map(count).collect();
        let points = spectrum(&counts, 1e-3);
        let top = points.iter().max_by(|a, b| a[1].total_cmp(&b[1])).unwrap();
        assert!((40.0..60.0).contains(&top[0]), "{top:?}");
        let elsewhere = points.iter().filter(|p| p[0] > 100.0).map(|p| p[1]).fold(0.0, f64::max);
        assert!(elsewhere < 1e-3 * top[1], "{elsewhere} beside {}", top[1]);
        let lags = autocorrelation(&counts, 1e-3);
        let at = |ms: f64| lags.iter().find(|p| (p[0] - ms * 1e-3).abs() < 1e-9).unwrap()[1];
        assert!((at(20.0) - 1.0).abs() < 0.01 && (at(10.0) + 1.0).abs() < 0.01, "{lags:?}");
    }
}
