//! Two measures that do not mind the phase of a threshold: where a reference starts a fraction of a threshold higher,
//! every event moves, and the matching suffers, while the brightness that the events tell of is the same.

use super::by_pixel::{Known, Mark, stream_by_pixel, truth_by_pixel};
use super::{MetricError, check};
use crate::event::Event;
use crate::sensor::SensorConfig;
use crate::truth::Truth;

/// Length of a voxel grid, and time between the boundaries of the integrated brightness, in microseconds.
pub const WINDOW_US: i64 = 20_000;
/// Time bins of a voxel grid.
pub const VOXEL_BINS: usize = 5;

/// Spaces between the bins of a grid: the first bin lies at its start, the last one at its end.
const SPACES: i64 = VOXEL_BINS as i64 - 1;

/// Running sums over pixels.
pub(super) struct Phase {
    thresholds: [f64; 2],
    windows: i64,
    /// Sums of magnitudes, in units of 1 / [`WINDOW_US`].
    difference: u64,
    reference: u64,
    square_sum: f64,
}

/// One pixel's voxels in one window: events of the stream minus those of the truth, and the truth alone, in units of
/// 1 / [`WINDOW_US`].
#[derive(Default)]
struct Voxels {
    difference: [i64; VOXEL_BINS],
    reference: [i64; VOXEL_BINS],
}

impl Phase {
    pub fn new(sensor: &SensorConfig, duration_us: i64) -> Self {
        Self {
            thresholds: [f64::from(sensor.threshold_off), f64::from(sensor.threshold_on)],
            windows: duration_us.div_euclid(WINDOW_US) + i64::from(duration_us % WINDOW_US != 0),
            difference: 0,
            reference: 0,
            square_sum: 0.0,
        }
    }

    /// Adds a pixel's events, both in order of time.
    pub fn add(&mut self, stream: &[Mark], known: &[Known]) {
        let (mut stream, mut known) = (stream.iter().copied(), known.iter().map(|k| k.mark));
        let (mut next_event, mut next_known) = (stream.next(), known.next());
        // OFF and ON events of the stream so far, minus those of the truth.
        let mut ahead = [0_i64; 2];
        let window_of = |mark: Option<Mark>| mark.map(|m| m.t_us() / WINDOW_US);
        let mut before = 0;
        while let Some(window) = [window_of(next_event), window_of(next_known)].into_iter().flatten().min() {
            // The difference so far stood at the boundaries of the windows without events.
            self.hold(ahead, window - before);
            let mut voxels = Voxels::default();
            while let Some(mark) = next_event.filter(|m| m.t_us() / WINDOW_US == window) {
                spread(&mut voxels.difference, mark, 1);
                ahead[usize::from(mark.is_on())] += 1;
                next_event = stream.next();
            }
            while let Some(mark) = next_known.filter(|m| m.t_us() / WINDOW_US == window) {
                spread(&mut voxels.difference, mark, -1);
                spread(&mut voxels.reference, mark, 1);
                ahead[usize::from(mark.is_on())] -= 1;
                next_known = known.next();
            }
            self.difference += voxels.difference.iter().map(|v| v.unsigned_abs()).sum::<u64>();
            self.reference += voxels.reference.iter().map(|v| v.unsigned_abs()).sum::<u64>();
            before = window;
        }
        self.hold(ahead, self.windows - before);
    }

    /// The difference of polarity counts is `ahead` at the ends of `windows` windows.
    fn hold(&mut self, ahead: [i64; 2], windows: i64) {
        let [off, on] = ahead;
        if off != 0 || on != 0 {
            let error = self.thresholds[1] * on as f64 - self.thresholds[0] * off as f64;
            self.square_sum += error * error * windows as f64;
        }
    }

    pub fn voxel_l1(&self) -> Option<f64> {
        (self.reference > 0).then(|| self.difference as f64 / self.reference as f64)
    }

    pub fn integrated_log_rms(&self, pixels: u64) -> Option<f64> {
        let rms = (self.square_sum / (pixels as f64 * self.windows as f64)).sqrt();
        (self.thresholds.iter().all(|c| c.is_finite()) && rms.is_finite()).then_some(rms)
    }
}

/// Splits an event of this sign between the two bins next to it in time.
fn spread(bins: &mut [i64; VOXEL_BINS], mark: Mark, sign: i64) {
    let sign = if mark.is_on() { sign } else { -sign };
    let place = (mark.t_us() % WINDOW_US) * SPACES;
    let (bin, part) = ((place / WINDOW_US) as usize, place % WINDOW_US);
    if let Some([first, second]) = bins.get_mut(bin..bin + 2) {
        *first += sign * (WINDOW_US - part);
        *second += sign * part;
    }
}

/// Relative L1 distance of voxel grids of `events` and of the truth, at the truth's pixels over its interval.
///
/// Each 20 ms window from 0 on gives a grid of five bins: V(b, y, x) = Σ p · max(0, 1 − |b − 4 (t − t0) / 20 ms|) over
/// its events, p = ±1, t0 the window's start (Rebecq et al., High Speed and High Dynamic Range Video with an Event
/// Camera, 2019, with the window's bounds in place of its first and last event). The result is
/// Σ |V − V_truth| / Σ |V_truth|: 0 is perfect, an empty stream scores 1; None where all of V_truth is zero.
///
/// # Errors
/// As [`super::score`].
pub fn voxel_l1(events: &[Event], truth: &Truth) -> Result<Option<f64>, MetricError> {
    check::check_truth(truth)?;
    check::check_not_empty(truth, events)?;
    check::check_stream(events, truth)?;
    let (stream, known) = (stream_by_pixel(events, truth), truth_by_pixel(truth));
    let mut phase = Phase::new(&truth.sensor, truth.duration_us);
    for pixel in 0..truth.pixels.len() {
        phase.add(stream.pixel(pixel), known.pixel(pixel));
    }
    Ok(phase.voxel_l1())
}
