//! Independent checks: dense sampling finds the same events, and light is the mean of the pattern's points.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use super::*;
use crate::event::Polarity;

/// Unequal thresholds without a small common multiple: no signal that returns meets a level by design.
fn sensor() -> SensorConfig {
    SensorConfig { threshold_on: 0.2, threshold_off: 0.2317, ..SensorConfig::default() }
}

const REFERENCE: f64 = 0.7;

fn log_of(sensor: &SensorConfig, light: f64) -> f64 {
    (light / REFERENCE + f64::from(sensor.log_eps)).ln()
}

/// The `crossing` trigger on samples `step` seconds apart, in f64: (time, ON), linear in log between samples.
fn sampled(light: &PixelLight, sensor: &SensorConfig, end_s: f64, step: f64) -> Vec<(f64, bool)> {
    let (on, off) = (f64::from(sensor.threshold_on), f64::from(sensor.threshold_off));
    let mut before = log_of(sensor, light.luminance(0.0));
    let mut reference = before;
    let mut events = Vec::new();
    for i in 1..=(end_s / step).round() as usize {
        let now = log_of(sensor, light.luminance(i as f64 * step));
        let (sign, threshold) = if now >= reference { (1.0, on) } else { (-1.0, off) };
        let count = (sign * (now - reference) / threshold).floor();
        for k in 1..=count as usize {
            let level = reference + sign * k as f64 * threshold;
            events.push(((i as f64 - 1.0 + (level - before) / (now - before)) * step, sign > 0.0));
        }
        reference += sign * count * threshold;
        before = now;
    }
    events
}

/// Same count and polarities, times within `tolerance_s`.
fn same(got: &[Crossing], expected: &[(f64, bool)], tolerance_s: f64) -> Result<(), String> {
    let ons = |c: &Crossing| c.polarity == Polarity::On;
    if !got.iter().map(ons).eq(expected.iter().map(|e| e.1)) {
        return Err(format!("{} events, expected {}", got.len(), expected.len()));
    }
    let worst = got.iter().zip(expected).map(|(g, e)| (g.t_s - e.0).abs()).fold(0.0, f64::max);
    if worst > tolerance_s { Err(format!("{worst:.2e} s off")) } else { Ok(()) }
}

/// Every kind of signal, with pixels that see different parts of it.
fn signals() -> Vec<Box<dyn Signal>> {
    let edge = |degrees: f64, speed, light: [f64; 2]| Edge {
        light_behind: light[0],
        light_ahead: light[1],
        angle_radians: degrees.to_radians(),
        position_px: if speed < 0.0 { 9.0 } else { 1.3 },
        speed_px_per_s: speed,
    };
    let bar = |degrees: f64, width_px, light_bar| Bar {
        light_bar,
        light_beside: 0.05,
        width_px,
        angle_radians: degrees.to_radians(),
        position_px: 1.1,
        speed_px_per_s: 120.0,
    };
    let spokes = |footprint, turn_per_s| Spokes {
        mean: 0.5,
        swing: 0.45,
        spokes: 12,
        center_px: [2.2, 2.6],
        turn_per_s,
        phase_radians: 0.4,
        footprint,
    };
    let flicker = |shape| Flicker { shape, mean: 0.6, depth: 0.75, frequency_hz: 37.0, phase_cycles: 0.105 };
    let wave = |k: [f64; 2], frequency_hz, footprint| Sinusoid {
        mean: 0.5,
        swing: 0.47,
        cycles_per_px: k,
        frequency_hz,
        phase_radians: 0.3,
        footprint,
    };
    vec![
        Box::new(wave([0.05, 0.02], 31.0, Footprint::Box)),
        Box::new(wave([-0.4, 0.3], -23.0, Footprint::Point)),
        // Beyond the first zero of the box: the swing is mirrored.
        Box::new(wave([1.3, 0.1], 19.0, Footprint::Box)),
        Box::new(LinearRamp { start: 0.9, rate_per_s: -12.0, gradient_per_px: [0.02, 0.01] }),
        Box::new(LinearRamp { start: -0.3, rate_per_s: 9.0, gradient_per_px: [0.02, 0.01] }),
        Box::new(ExponentialRamp { start: 0.02, growth_per_s: 61.3, gradient_per_px: [0.1, 0.03] }),
        Box::new(edge(0.0, 100.0, [0.05, 0.5])),
        Box::new(edge(90.0, 80.0, [0.5, 0.05])),
        Box::new(edge(20.0, 130.0, [0.9, 0.0])),
        Box::new(edge(-133.0, -150.0, [0.3, 0.1])),
        Box::new(bar(0.0, 1.7, 0.9)),
        Box::new(bar(31.0, 0.3, 0.9)),
        Box::new(bar(45.0, 0.02, 8.0)),
        Box::new(spokes(Footprint::Point, 20.0)),
        Box::new(spokes(Footprint::Box, -15.0)),
        Box::new(flicker(FlickerShape::Sine)),
        Box::new(flicker(FlickerShape::Square)),
        Box::new(flicker(FlickerShape::Pwm { duty: 0.3 })),
    ]
}

const PIXELS: [[f64; 2]; 2] = [[4.5, 2.5], [3.5, 6.5]];

#[test]
fn dense_sampling_finds_the_same_events() {
    let (sensor, end_s, step) = (sensor(), 0.1, 1e-7);
    for signal in signals() {
        signal.check().unwrap();
        let mut fired = 0;
        for [x, y] in PIXELS {
            let light = signal.pixel(x, y);
            let got = solve(&light, &sensor, REFERENCE, end_s).unwrap();
            let closest = got.turns.iter().map(|t| t.margin_log).fold(1.0, f64::min);
            assert!(closest > 1e-5, "{signal:?} at ({x}, {y}): a tie, {closest}");
            let expected = sampled(&light, &sensor, end_s, step);
            same(&got.crossings, &expected, step).unwrap_or_else(|e| panic!("{signal:?} at ({x}, {y}): {e}"));
            assert!(got.crossings.is_sorted_by_key(|c| c.t_s));
            fired += got.crossings.len();
            // Canaries: a missing event, a shift of two samples, another threshold.
            if let Some((_, rest)) = expected.split_first() {
                assert!(same(&got.crossings, rest, step).is_err());
                let late: Vec<_> = expected.iter().map(|e| (e.0 + 2.1 * step, e.1)).collect();
                assert!(same(&got.crossings, &late, step).is_err());
            }
        }
        assert!(fired >= 4, "{signal:?}: only {fired} events");
    }
}

#[test]
fn the_signal_at_each_crossing_is_a_whole_number_of_thresholds_from_the_start() {
    let sensor = sensor();
    let (on, off) = (f64::from(sensor.threshold_on), f64::from(sensor.threshold_off));
    let mut compared = 0;
    for signal in signals() {
        let jumps = matches!(signal.name(), "square flicker" | "pwm flicker");
        for [x, y] in PIXELS {
            let light = signal.pixel(x, y);
            let start = log_of(&sensor, light.luminance(0.0));
            let (mut ons, mut offs) = (0.0, 0.0);
            for c in solve(&light, &sensor, REFERENCE, 0.1).unwrap().crossings {
                *(if c.polarity == Polarity::On { &mut ons } else { &mut offs }) += 1.0;
                let level = start + ons * on - offs * off;
                assert!((c.level_log - level).abs() < 1e-12);
                if jumps {
                    let [before, after] = [-1e-9, 1e-9].map(|d| log_of(&sensor, light.luminance(c.t_s + d)));
                    assert!(
                        (before - level) * (after - level) < 0.0,
                        "{signal:?}: the jump passes the level"
                    );
                    continue;
                }
                let error = log_of(&sensor, light.luminance(c.t_s)) - level;
                assert!(error.abs() < 1e-9, "{signal:?} at ({x}, {y}), {} s: {error:.1e}", c.t_s);
                // Canary: a tenth of a microsecond later it is another value.
                compared += 1;
                let later = log_of(&sensor, light.luminance(c.t_s + 1e-7)) - level;
                assert!(later.abs() > 1e-9, "{signal:?}: {later:.1e}");
            }
        }
    }
    assert!(compared > 100, "{compared}");
}

/// Mean of `f` over the pixel about (x, y), on a fine grid of points.
fn mean_of_points(f: &dyn Fn(f64, f64) -> f64, x: f64, y: f64) -> f64 {
    const N: u32 = 600;
    let at = |i: u32| (f64::from(i) + 0.5) / f64::from(N) - 0.5;
    let sum: f64 = (0..N * N).map(|i| f(x + at(i % N), y + at(i / N))).sum();
    sum / f64::from(N * N)
}

#[test]
fn a_pixels_light_is_the_mean_of_the_patterns_points() {
    let t = 0.0437;
    let wave = Sinusoid {
        mean: 0.5,
        swing: 0.4,
        cycles_per_px: [0.31, -0.17],
        frequency_hz: 12.0,
        phase_radians: 0.8,
        footprint: Footprint::Box,
    };
    let wave_at = |x: f64, y: f64| 0.5 + 0.4 * (0.8 + TAU * (0.31 * x - 0.17 * y - 12.0 * t)).sin();
    let angle = 0.7_f64;
    let edge = Edge {
        light_behind: 0.2,
        light_ahead: 0.9,
        angle_radians: angle,
        position_px: 1.0,
        speed_px_per_s: 60.0,
    };
    let along = move |x: f64, y: f64| x * angle.cos() + y * angle.sin() - 1.0 - 60.0 * t;
    let edge_at = move |x: f64, y: f64| if along(x, y) > 0.0 { 0.9 } else { 0.2 };
    let bar = Bar {
        light_bar: 0.9,
        light_beside: 0.2,
        width_px: 0.4,
        angle_radians: angle,
        position_px: 1.0,
        speed_px_per_s: 60.0,
    };
    let bar_at = move |x: f64, y: f64| if along(x, y).abs() < 0.2 { 0.9 } else { 0.2 };
    let star = Spokes {
        mean: 0.5,
        swing: 0.4,
        spokes: 9,
        center_px: [2.3, 2.4],
        turn_per_s: 7.0,
        phase_radians: 0.4,
        footprint: Footprint::Box,
    };
    let star_at = |x: f64, y: f64| 0.5 + 0.4 * (0.4 + 9.0 * ((y - 2.4).atan2(x - 2.3) - 7.0 * t)).sin();
    // Signal, its points, and how well the grid of points knows the mean.
    type Case<'a> = (&'a dyn Signal, &'a dyn Fn(f64, f64) -> f64, f64);
    let cases: [Case; 4] =
        [(&wave, &wave_at, 2e-6), (&edge, &edge_at, 2e-3), (&bar, &bar_at, 2e-3), (&star, &star_at, 2e-5)];
    for (signal, points, tolerance) in cases {
        let mut told_apart = false;
        // The star's centre lies in the pixel (2.5, 2.5).
        for [x, y] in [[2.5, 2.5], [3.5, 1.5], [1.5, 3.5], [4.1, 2.2]] {
            let expected = mean_of_points(points, x, y);
            let got = signal.luminance(x, y, t);
            assert!((got - expected).abs() < tolerance, "{signal:?} at ({x}, {y}): {got}, points {expected}");
            // Canary: the centre's value is not the mean.
            told_apart |= (points(x, y) - expected).abs() > 10.0 * tolerance;
        }
        assert!(told_apart, "{signal:?}");
    }
    let point = Spokes { footprint: Footprint::Point, ..star };
    assert!((point.luminance(4.1, 2.2, t) - star_at(4.1, 2.2)).abs() < 1e-12);
    // Speed of a point on the star and of the wave's crests.
    assert!((star.speed_px_per_s(2.3, 5.4) - 21.0).abs() < 1e-12);
    assert!((wave.speed_px_per_s(0.0, 0.0) - 12.0 / 0.31_f64.hypot(0.17)).abs() < 1e-12);
}

#[test]
fn areas_equal_the_second_difference_of_a_quadratic() {
    // The mean over the square of a half-plane's indicator, from the indicator's second antiderivative.
    let second = |s: f64| 0.5 * s.max(0.0).powi(2);
    let mut told_apart = false;
    for degrees in [3.0, 20.0, 45.0, 100.0, 170.0, 301.0] {
        let (sine, cosine) = f64::to_radians(degrees).sin_cos();
        let (a, b) = (0.5 * cosine.abs(), 0.5 * sine.abs());
        for i in -80..=80 {
            let s = f64::from(i) * 0.01;
            let sum = second(s + a + b) - second(s + a - b) - second(s - a + b) + second(s - a - b);
            let (got, expected) = (half_plane_area(s, [cosine, sine]), sum / (4.0 * a * b));
            assert!((got - expected).abs() < 1e-12, "{degrees} degrees, {s}: {got}, {expected}");
            told_apart |= (half_plane_area(s, [1.0, 0.0]) - expected).abs() > 0.01;
        }
    }
    assert!(told_apart, "canary: another direction has other areas");
}

#[test]
fn a_pair_between_samples_is_found() {
    // A bar a hundredth of a pixel wide passes the pixel and is gone: no sample at 250 Hz sees it.
    let bar = Bar {
        light_bar: 50.0,
        light_beside: 0.2,
        width_px: 0.01,
        angle_radians: 0.3,
        position_px: 1.13,
        speed_px_per_s: 1000.0,
    };
    let (light, sensor) = (bar.pixel(2.5, 0.5), sensor());
    let got = solve(&light, &sensor, REFERENCE, 0.02).unwrap().crossings;
    assert!(sampled(&light, &sensor, 0.02, 4e-3).is_empty(), "canary: sampling misses it");
    let ons = got.iter().filter(|c| c.polarity == Polarity::On).count();
    assert!(ons >= 5 && got.len() - ons >= 4, "{got:?}");
}

#[test]
fn a_tie_fires_once_and_says_that_it_was_close() {
    // The light doubles and halves again; ln 2 is exactly one threshold of ln 2 to a rounding.
    let sensor =
        SensorConfig { log_eps: 1e-30, threshold_on: 0.25, threshold_off: 0.25, ..Default::default() };
    let light = PixelLight::Square {
        low: 1.0,
        high: 0.25_f64.exp(),
        frequency_hz: 10.0,
        phase_cycles: 0.5,
        duty: 0.5,
    };
    let got = solve(&light, &sensor, 1.0, 0.19).unwrap();
    let times: Vec<_> = got.crossings.iter().map(|c| (c.t_us, c.polarity)).collect();
    assert_eq!(times, [(50_000, Polarity::On), (100_000, Polarity::Off), (150_000, Polarity::On)]);
    assert!(got.turns.iter().all(|t| t.margin_log < 1e-9));
    assert_eq!(got.within(50_001, 150_000).len(), 1);
    // A horizon stops before the doubt, and keeps its distance from a crossing.
    assert!((got.horizon_s(0.19, 1e-6, 1e-3) - 0.048_999).abs() < 1e-9);
    let clear = PixelLight::Linear { start: 1.0, rate: 1.0 };
    let clear = solve(&clear, &sensor, 1.0, 2.0).unwrap();
    assert_eq!(clear.horizon_s(2.0, 1e-6, 1e-3), 2.0);
}

#[test]
fn a_turn_says_how_much_swing_was_missing() {
    // Rises by 0.63: three events, 0.03 above the third; falls by 0.60 to 0.17 above the start's OFF level.
    let light = PixelLight::Function {
        light: Arc::new(|t: f64| (0.63 * (PI * t).sin().powi(2)).exp()),
        turns_s: Arc::from([0.5, 1.0]),
    };
    let sensor = SensorConfig { threshold_off: 0.2, log_eps: 1e-30, ..Default::default() };
    let got = solve(&light, &sensor, 1.0, 1.2).unwrap();
    assert_eq!(got.crossings.iter().filter(|c| c.polarity == Polarity::On && c.t_s < 0.6).count(), 3);
    assert!((got.turns[0].margin_log - 0.03).abs() < 1e-6, "{:?}", got.turns);
    assert!((got.turns[0].t_s - 0.5).abs() < 1e-12);
    // Half a threshold before the third crossing.
    let from = got.turns[0].from_s;
    assert!((0.63 * (PI * from).sin().powi(2) - 0.5).abs() < 1e-6, "{from}");
    assert!(got.horizon_s(1.2, 0.04, 0.0) <= from && got.horizon_s(1.2, 0.02, 0.0) > 0.5);
}

fn camera() -> CameraInfo {
    CameraInfo::uncalibrated("camera", (8, 6))
}

#[test]
fn truth_is_in_canonical_order_and_knows_its_speed() {
    let signals = signals();
    let pixels = [[5, 2], [1, 2], [7, 0], [1, 2]];
    let truth = super::truth(&*signals[6], &camera(), &sensor(), REFERENCE, &pixels, 100_000).unwrap();
    assert_eq!(truth.pixels, [[7, 0], [1, 2], [5, 2]]);
    assert!(crate::event::is_ordered(&truth.events) && truth.events.len() > 10);
    assert!(truth.events.iter().all(|e| (0..100_000).contains(&e.t)));
    assert_eq!(truth.speed, vec![100.0; truth.events.len()]);
    serde_json::from_str::<serde_json::Value>(&truth.provenance).unwrap();
    // The edge starts at 1.3 and reaches the left side of pixel 5 after 37 ms.
    let first = truth.events.iter().find(|e| e.x == 5).unwrap().t;
    assert!((37_000..47_000).contains(&first), "{first}");
    // One pixel alone has the same events.
    let alone = super::truth(&*signals[6], &camera(), &sensor(), REFERENCE, &[[5, 2]], 100_000).unwrap();
    let of_pixel: Vec<_> = truth.events.iter().filter(|e| e.x == 5).copied().collect();
    assert_eq!(alone.events, of_pixel);
}

#[test]
fn bad_input_is_refused_with_its_value() {
    let wave = Sinusoid {
        mean: 0.5,
        swing: 0.4,
        cycles_per_px: [0.1, 0.0],
        frequency_hz: 10.0,
        phase_radians: 0.0,
        footprint: Footprint::Box,
    };
    let truth_of = |signal: &dyn Signal, pixel, duration_us| {
        super::truth(signal, &camera(), &sensor(), 1.0, &[pixel], duration_us).map_err(|e| e.to_string())
    };
    assert!(truth_of(&wave, [0, 0], 1000).is_ok());
    let refused = |signal: &dyn Signal, says: &str| {
        let error = truth_of(signal, [0, 0], 1_000_000).unwrap_err();
        assert!(error.contains(says), "{error}");
    };
    refused(&Sinusoid { swing: 0.6, ..wave }, "swing is 0.6");
    refused(&Sinusoid { mean: f64::NAN, ..wave }, "mean is NaN");
    refused(&Sinusoid { frequency_hz: 1e12, ..wave }, "turning points");
    refused(&ExponentialRamp { start: 1.0, growth_per_s: 1e6, gradient_per_px: [0.0; 2] }, "light is inf");
    let flicker = Flicker {
        shape: FlickerShape::Pwm { duty: 1.0 },
        mean: 1.0,
        depth: 0.5,
        frequency_hz: 1.0,
        phase_cycles: 0.0,
    };
    refused(&flicker, "duty is 1");
    refused(&Flicker { depth: 2.0, ..flicker }, "depth is 2");
    assert!(truth_of(&wave, [8, 0], 1000).unwrap_err().contains("(8, 0)"));
    assert!(truth_of(&wave, [0, 0], -1).unwrap_err().contains("duration is -1"));
    let light = wave.pixel(0.5, 0.5);
    assert!(solve(&light, &sensor(), 0.0, 1.0).unwrap_err().to_string().contains("reference_luminance is 0"));
    assert!(solve(&light, &sensor(), 1.0, f64::NAN).is_err());
    let zero = SensorConfig { threshold_on: 0.0, ..Default::default() };
    assert!(solve(&light, &zero, 1.0, 1.0).is_err());
}
