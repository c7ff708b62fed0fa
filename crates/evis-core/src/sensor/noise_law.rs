//! How much noise of the photoreceptor makes how many events.

use super::{ConfigError, SensorConfig};

/// From a rate of noise events to the photoreceptor's noise that makes them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NoiseLaw {
    /// Fitted to this pixel's own events, with one or two poles (default).
    #[default]
    Measured,
    /// v2e's formula (`compute_photoreceptor_noise_voltage` in its `emulator_utils.py`), fitted to a sampled simulation.
    V2e,
}

impl NoiseLaw {
    /// Threshold over rms for `x = log10(R / 2f)`.
    fn ratio(self, order: u32, x: f64) -> f64 {
        let polynomial = |c: [f64; 4]| c.into_iter().fold(0.0, |sum, c| sum * x + c);
        match (self, order) {
            (Self::V2e, _) => 10_f64.powf(polynomial([-0.0026, -0.036, -0.1949, 0.321])),
            // Least squares over what `cargo bench --bench receptor` measures, within 2 % of its rates: the logarithm of a
            // rate is nearly straight in the square of the ratio.
            (Self::Measured, 1) => polynomial([-0.0207, -0.2143, -5.4286, 3.2761]).sqrt(),
            (Self::Measured, _) => polynomial([-0.0074, -0.1101, -5.0727, 0.5917]).sqrt(),
        }
    }
}

impl SensorConfig {
    /// The `photoreceptor.noise` with which this sensor's pixels fire `rate_hz` events a second by noise, ON and OFF
    /// together, under constant light (at `Y_ref` where light sets the bandwidth), if thresholds are the mean of both.
    ///
    /// # Errors
    /// A sensor without a low-pass, and a rate that is not within 1e-4 to 0.8 of the cutoff.
    pub fn photoreceptor_noise_for(&self, rate_hz: f64, law: NoiseLaw) -> Result<f32, ConfigError> {
        let cutoff_hz = f64::from(self.photoreceptor.cutoff_hz);
        if cutoff_hz.is_nan() || cutoff_hz <= 0.0 {
            return Err(ConfigError::new(
                "photoreceptor.cutoff_hz",
                cutoff_hz,
                "above 0 for noise to have a rate",
            ));
        }
        let (least, most) = (1e-4 * cutoff_hz, 0.8 * cutoff_hz);
        if !(least..=most).contains(&rate_hz) {
            let remedy = format!("between {least} and {most} Hz with this cutoff, where it was measured");
            return Err(ConfigError::new("rate_hz", rate_hz, remedy));
        }
        let x = (rate_hz / (2.0 * cutoff_hz)).log10();
        let threshold = 0.5 * f64::from(self.threshold_on + self.threshold_off);
        Ok((threshold / law.ratio(self.photoreceptor.order, x)) as f32)
    }
}
