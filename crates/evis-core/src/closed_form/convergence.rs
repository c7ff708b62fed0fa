//! How the trigger on samples converges to the closed forms: error of the event times against the sampling interval.
//!
//! The signals are exact here; what is studied is the trigger alone, as the product has it (f32, whole microseconds).

use serde::{Deserialize, Serialize};

use super::{Bar, Edge, ExponentialRamp, Flicker, FlickerShape, Footprint, LinearRamp, PixelLight, Signal};
use super::{Sinusoid, Spokes, solve};
use crate::event::Polarity;
use crate::sensor::{ConfigError, SensorConfig, TriggerRule};
use crate::time::TimeGrid;
use crate::trigger::{PixelState, decide, fire_time_us};

/// Sampling rates of the study.
pub const RATES_HZ: [f64; 7] = [250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0, 16_000.0];

/// Errors up to this many microseconds are rounding: events carry whole microseconds.
pub const FLOOR_US: f64 = 1.0;

/// How the trigger turns samples into events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Variant {
    /// At most one event per sample, at its time.
    Latch,
    /// Crossings on a straight line of the logarithm.
    Crossing,
}

crate::words!(Variant {
    Self::Crossing => "crossing", "every crossing, by linear interpolation of log luminance";
    Self::Latch => "latch", "at most one event per pixel and sample, at the sample's time";
});

impl Variant {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Latch, Self::Crossing];

    /// Name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Latch => "latch",
            Self::Crossing => "crossing",
        }
    }

    fn apply(self, sensor: &SensorConfig) -> SensorConfig {
        let trigger = match self {
            Self::Latch => TriggerRule::Latch,
            Self::Crossing => TriggerRule::Crossing,
        };
        SensorConfig { trigger, ..sensor.clone() }
    }
}

/// Errors at one sampling interval.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Seconds between samples.
    pub interval_s: f64,
    /// Crossings of the closed form.
    pub expected: usize,
    /// Events of the trigger.
    pub fired: usize,
    /// Events missed or spurious: per pixel and rise or fall, the difference of the counts.
    pub count_error: usize,
    /// Events whose times are compared: in order within each rise or fall, in pixels that rise and fall as often as they
    /// should.
    pub matched: usize,
    /// Median of |time error| in microseconds; `None` where nothing is matched, as in the next two.
    pub median_us: Option<f64>,
    /// Root mean square of the time error.
    pub rms_us: Option<f64>,
    /// 95th percentile of |time error|.
    pub p95_us: Option<f64>,
}

/// How one trigger converges on one signal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Convergence {
    /// The signal's name.
    pub signal: String,
    /// The trigger.
    pub variant: Variant,
    /// From the longest interval to the shortest.
    pub rows: Vec<Row>,
    /// Power of the interval with which the median falls, by least squares on logarithms over the rows above
    /// [`FLOOR_US`]; `None` where fewer than three are: the trigger is exact there, or nothing is matched.
    pub order: Option<f64>,
    /// The same for the root mean square, which crossings close to a signal's turning points rule.
    pub order_rms: Option<f64>,
}

/// A signal and the part of it that is studied.
#[derive(Debug)]
pub struct Case {
    /// What is studied, in reports.
    pub name: &'static str,
    /// The pattern.
    pub signal: Box<dyn Signal>,
    /// Centres of the pixels that look at it.
    pub pixels: Vec<[f64; 2]>,
    /// How long.
    pub duration_us: i64,
}

/// The signals of the report. Light is in units of `Y_ref`.
pub fn cases() -> Vec<Case> {
    let pixels: Vec<[f64; 2]> = (0..24).map(|i| [f64::from(i % 8) + 0.5, f64::from(i / 8) + 0.5]).collect();
    let case = |name, signal: Box<dyn Signal>, duration_us| Case {
        name,
        signal,
        pixels: pixels.clone(),
        duration_us,
    };
    let edge = |degrees: f64| Edge {
        light_behind: 0.5,
        light_ahead: 0.05,
        angle_radians: degrees.to_radians(),
        position_px: -0.7,
        speed_px_per_s: 23.0,
    };
    let bar = Bar {
        light_bar: 0.6,
        light_beside: 0.06,
        width_px: 0.6,
        angle_radians: 0.35,
        position_px: -1.1,
        speed_px_per_s: 23.0,
    };
    let flicker =
        |shape, frequency_hz| Flicker { shape, mean: 0.5, depth: 0.8, frequency_hz, phase_cycles: 0.137 };
    let sinusoid = Sinusoid {
        mean: 0.5,
        swing: 0.4,
        cycles_per_px: [0.043, 0.027],
        frequency_hz: 5.3,
        phase_radians: 0.3,
        footprint: Footprint::Box,
    };
    let spokes = Spokes {
        mean: 0.5,
        swing: 0.4,
        spokes: 9,
        center_px: [-6.3, -4.1],
        turn_per_s: 3.7,
        phase_radians: 0.2,
        footprint: Footprint::Box,
    };
    let linear = LinearRamp { start: 0.1, rate_per_s: 31.0, gradient_per_px: [0.004, 0.003] };
    let exponential = ExponentialRamp { start: 9.0, growth_per_s: -31.7, gradient_per_px: [0.11, 0.05] };
    vec![
        case("sinusoid", Box::new(sinusoid), 400_000),
        case("spokes", Box::new(spokes), 400_000),
        case("sine flicker", Box::new(flicker(FlickerShape::Sine, 5.3)), 400_000),
        case("linear ramp", Box::new(linear), 80_000),
        case("exponential ramp", Box::new(exponential), 100_000),
        case("edge along an axis", Box::new(edge(0.0)), 400_000),
        case("edge at 20 degrees", Box::new(edge(20.0)), 520_000),
        case("bar", Box::new(bar), 520_000),
        case("square flicker", Box::new(flicker(FlickerShape::Square, 9.7)), 400_000),
    ]
}

/// The thresholds of the report: unequal, so that no periodic signal returns to a level by design.
pub fn sensor() -> SensorConfig {
    SensorConfig { threshold_on: 0.2, threshold_off: 0.2317, ..SensorConfig::default() }
}

/// The report: every case with every trigger, at [`RATES_HZ`].
///
/// # Errors
/// As [`study`].
pub fn report() -> Result<Vec<Convergence>, ConfigError> {
    let mut out = Vec::new();
    for case in cases() {
        for variant in Variant::ALL {
            out.push(study(&case, variant, &sensor(), &RATES_HZ)?);
        }
    }
    Ok(out)
}

/// How `variant` converges on `case`, sampled at each of `rates_hz`, with `Y_ref` = 1.
///
/// # Errors
/// A signal, sensor, rate or duration that cannot be used.
pub fn study(
    case: &Case,
    variant: Variant,
    sensor: &SensorConfig,
    rates_hz: &[f64],
) -> Result<Convergence, ConfigError> {
    case.signal.check()?;
    let lights: Vec<PixelLight> = case.pixels.iter().map(|&[x, y]| case.signal.pixel(x, y)).collect();
    let rows = rates_hz.iter().map(|&rate| row(&lights, &lights, variant, sensor, rate, case.duration_us));
    let rows = rows.collect::<Result<Vec<_>, _>>()?;
    Ok(Convergence {
        signal: case.name.to_owned(),
        variant,
        order: order(rows.iter().map(|r| (r.interval_s, r.median_us))),
        order_rms: order(rows.iter().map(|r| (r.interval_s, r.rms_us))),
        rows,
    })
}

/// A rise or a fall: whether it rises, and its events' times in microseconds.
type Run = (bool, Vec<f64>);

fn runs(events: impl Iterator<Item = (bool, f64)>) -> Vec<Run> {
    let mut out: Vec<Run> = Vec::new();
    for (on, t_us) in events {
        match out.last_mut() {
            Some((last, times)) if *last == on => times.push(t_us),
            _ => out.push((on, vec![t_us])),
        }
    }
    out
}

/// What the trigger fires on samples of `light`.
fn sampled(light: &PixelLight, sensor: &SensorConfig, grid: &TimeGrid, last: i64) -> Vec<Run> {
    let log_luminance = |t_us: i64| (light.luminance(t_us as f64 * 1e-6) as f32 + sensor.log_eps).ln();
    let mut events = Vec::new();
    let start = log_luminance(0);
    let mut state = PixelState { reference_log: start, log_luminance: start };
    for k in 1..=last {
        let (before, now) = (grid.instant_us(k - 1), grid.instant_us(k));
        let log_luminance = log_luminance(now);
        let decision = decide(sensor, state, log_luminance);
        for i in 1..=decision.count {
            let after = fire_time_us(sensor, &decision, i, (now - before) as u32);
            // The middle of the microsecond that the time was floored to.
            let t_us = (before + i64::from(after)) as f64 + 0.5;
            events.push((decision.polarity == Polarity::On, t_us));
        }
        state = PixelState { reference_log: decision.reference_log, log_luminance };
    }
    runs(events.into_iter())
}

/// Events on samples of `lights` against the closed forms of `truths`: two lists, so that a test can tell them apart.
fn row(
    lights: &[PixelLight],
    truths: &[PixelLight],
    variant: Variant,
    sensor: &SensorConfig,
    rate_hz: f64,
    duration_us: i64,
) -> Result<Row, ConfigError> {
    let grid = TimeGrid::new(rate_hz)?;
    let own = variant.apply(sensor);
    // The last instant within the duration; the closed form is asked up to there.
    let last = grid.first_at_or_after(duration_us.saturating_add(1)) - 1;
    let end_s = grid.instant_us(last.max(0)) as f64 * 1e-6;
    let (mut expected, mut fired, mut count_error, mut errors) = (0, 0, 0, Vec::new());
    for (light, truth) in lights.iter().zip(truths) {
        let truth = solve(truth, sensor, 1.0, end_s)?.crossings;
        let truth = runs(truth.iter().map(|c| (c.polarity == Polarity::On, c.t_s * 1e6)));
        let got = sampled(light, &own, &grid, last);
        let count = |runs: &[Run]| runs.iter().map(|r| r.1.len()).sum::<usize>();
        (expected, fired) = (expected + count(&truth), fired + count(&got));
        if truth.iter().map(|r| r.0).eq(got.iter().map(|r| r.0)) {
            for ((_, truth), (_, got)) in truth.iter().zip(&got) {
                count_error += truth.len().abs_diff(got.len());
                errors.extend(truth.iter().zip(got).map(|(truth, got)| got - truth));
            }
        } else {
            let of = |runs: &[Run], on| runs.iter().filter(|r| r.0 == on).map(|r| r.1.len()).sum::<usize>();
            let difference = |on| of(&truth, on).abs_diff(of(&got, on));
            count_error += (difference(true) + difference(false)).max(1);
        }
    }
    let mut sizes: Vec<f64> = errors.iter().map(|e: &f64| e.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let quantile = |q: f64| sizes.get((q * sizes.len() as f64) as usize).copied();
    let mean_square = sizes.iter().map(|e| e * e).sum::<f64>() / sizes.len() as f64;
    Ok(Row {
        interval_s: 1.0 / rate_hz,
        expected,
        fired,
        count_error,
        matched: sizes.len(),
        median_us: quantile(0.5),
        rms_us: (!sizes.is_empty()).then(|| mean_square.sqrt()),
        p95_us: quantile(0.95),
    })
}

/// Order with which errors fall with the interval, of those above [`FLOOR_US`].
fn order(rows: impl Iterator<Item = (f64, Option<f64>)>) -> Option<f64> {
    power(rows.filter_map(|(interval, error)| Some((interval, error.filter(|e| *e > FLOOR_US)?))))
}

/// The power p of y = c x^p that fits points (x, y) best: slope of ln y over ln x, by least squares. `None` for fewer
/// than three points, and where one of them has no logarithm.
pub fn power(points: impl IntoIterator<Item = (f64, f64)>) -> Option<f64> {
    let points: Vec<(f64, f64)> = points.into_iter().map(|(x, y)| (x.ln(), y.ln())).collect();
    if points.len() < 3 {
        return None;
    }
    let n = points.len() as f64;
    let (mean_x, mean_y) =
        (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n);
    let spread = points.iter().map(|p| (p.0 - mean_x).powi(2)).sum::<f64>();
    let slope = points.iter().map(|p| (p.0 - mean_x) * (p.1 - mean_y)).sum::<f64>() / spread;
    slope.is_finite().then_some(slope)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn find<'a>(report: &'a [Convergence], signal: &str, variant: Variant) -> &'a Convergence {
        report.iter().find(|c| c.signal == signal && c.variant == variant).unwrap()
    }

    fn is_about(order: Option<f64>, expected: f64, tolerance: f64) -> bool {
        order.is_some_and(|o| (o - expected).abs() < tolerance)
    }

    #[test]
    fn every_trigger_converges_at_its_order() {
        let report = report().unwrap();
        for c in &report {
            let medians: Vec<_> =
                c.rows.iter().map(|r| r.median_us.map(|m| (m * 10.0).round() / 10.0)).collect();
            println!(
                "{}, {}: order {:.2?}, rms {:.2?}; {medians:?}, {} of {}, counts off {:?}",
                c.signal,
                c.variant.name(),
                c.order,
                c.order_rms,
                c.rows[6].matched,
                c.rows[6].expected,
                c.rows.iter().map(|r| r.count_error).collect::<Vec<_>>()
            );
        }
        use Variant::{Crossing, Latch};
        let order = |signal, variant| find(&report, signal, variant).order;
        for signal in ["sinusoid", "spokes", "sine flicker"] {
            assert!(is_about(order(signal, Crossing), 2.0, 0.2), "{signal}");
            assert!(is_about(order(signal, Latch), 1.0, 0.15), "{signal}");
        }
        for case in cases() {
            // Whatever the signal, the crossings are counted right once samples are close.
            let c = find(&report, case.name, Crossing);
            assert!(c.rows[6].expected > 100 || c.signal == "square flicker", "{c:?}");
            assert_eq!((c.rows[6].count_error, c.rows[6].matched), (0, c.rows[6].expected), "{c:?}");
        }
        // What is straight between samples is exact: a ramp of the logarithm.
        let exact = |c: &Convergence| c.rows.iter().all(|r| r.rms_us.is_some_and(|e| e < FLOOR_US));
        assert!(exact(find(&report, "exponential ramp", Crossing)));
        assert!(is_about(order("linear ramp", Crossing), 2.0, 0.2));
        assert!(is_about(order("edge along an axis", Crossing), 2.0, 0.25));
    }

    #[test]
    fn canary_a_shifted_truth_does_not_converge() {
        let case = &cases()[0];
        let late = |light: &PixelLight| match light {
            PixelLight::Sine { mean, swing, omega, phase } => {
                PixelLight::Sine { mean: *mean, swing: *swing, omega: *omega, phase: phase - omega * 1e-3 }
            }
            other => other.clone(),
        };
        let lights: Vec<_> = case.pixels.iter().map(|&[x, y]| case.signal.pixel(x, y)).collect();
        let shifted: Vec<_> = lights.iter().map(late).collect();
        let row = |truths: &[PixelLight], rate| {
            row(&lights, truths, Variant::Crossing, &sensor(), rate, case.duration_us).unwrap()
        };
        let fit = |truths| order(RATES_HZ.iter().map(|&rate| (1.0 / rate, row(truths, rate).median_us)));
        assert!(is_about(fit(&lights), 2.0, 0.2));
        assert!(!is_about(fit(&shifted), 2.0, 0.5), "{:?}", fit(&shifted));
        // Another signal's events are not counted as this one's.
        let reversed: Vec<_> = lights.iter().rev().cloned().collect();
        assert!(row(&reversed, 16_000.0).count_error > 0);
        // Orders of made-up errors.
        let power = |p: i32| order((0..5).map(|i| (0.5_f64.powi(i), Some(1e6 * 0.5_f64.powi(i * p)))));
        assert!(is_about(power(1), 1.0, 1e-9) && is_about(power(3), 3.0, 1e-9));
        assert_eq!(order([(1.0, Some(8.0)), (0.5, Some(2.0)), (0.25, Some(0.5))].into_iter()), None);
    }

    #[test]
    fn the_report_survives_json() {
        let one = study(&cases()[3], Variant::Latch, &sensor(), &[250.0, 500.0]).unwrap();
        let text = serde_json::to_string(&one).unwrap();
        let mut back: Convergence = serde_json::from_str(&text).unwrap();
        // Decimals may cost the last digit.
        for (row, own) in back.rows.iter_mut().zip(&one.rows) {
            let pairs = [
                (&mut row.median_us, own.median_us),
                (&mut row.rms_us, own.rms_us),
                (&mut row.p95_us, own.p95_us),
            ];
            for (got, expected) in pairs {
                assert!((got.unwrap() / expected.unwrap() - 1.0).abs() < 1e-12);
                *got = expected;
            }
        }
        assert_eq!(back, one);
        assert!(study(&cases()[3], Variant::Latch, &sensor(), &[0.0]).is_err());
    }
}
