//! Sensors that are fitted to the first half of public recordings, and what they say of the second.
//!
//! Runs where `EVIS_ASSETS` names the folder that has them.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::path::PathBuf;

use evis_core::event::slice_time;
use evis_core::stats::{Stats, calibrate, static_scene, stats};
use evis_core::{ConfigError, Event, SensorConfig};
use evis_format::read_events;

const RECORDINGS: [(&str, (u32, u32), &str); 2] = [
    ("dvxplorer_dark_640x480.npz", (640, 480), "dvxplorer-like"),
    ("prophesee_static_1280x720.npz", (1280, 720), "gen4-like"),
];

/// Rate, share of hot pixels, ON share, Fano factor, alternation.
fn figures(stats: &Stats) -> [f64; 5] {
    let [rate_hz, on_share, fano, alternation] =
        [stats.cold_rate_hz, stats.on_share, stats.fano, stats.alternation].map(Option::unwrap);
    [rate_hz, stats.hot_share, on_share, fano, alternation]
}

/// What `sensor` does before a still scene, the mean of a few draws: forty hot pixels vary by a sixth.
fn expected(sensor: &SensorConfig, size: (u32, u32), duration_us: i64) -> Result<[f64; 5], ConfigError> {
    let mut sum = [0.0; 5];
    const DRAWS: u64 = 3;
    for seed in 100..100 + DRAWS {
        let events = static_scene(sensor, size, duration_us, None, seed)?;
        let of = figures(&stats(&events, size, (0, duration_us))?);
        sum.iter_mut().zip(of).for_each(|(sum, value)| *sum += value / DRAWS as f64);
    }
    Ok(sum)
}

/// Greatest relative difference.
fn apart(got: [f64; 5], want: [f64; 5]) -> f64 {
    got.iter().zip(want).map(|(got, want)| (got / want - 1.0).abs()).fold(0.0, f64::max)
}

#[test]
fn what_is_fitted_to_the_first_half_holds_for_the_second() {
    let Some(assets) = std::env::var_os("EVIS_ASSETS").map(PathBuf::from) else {
        eprintln!("skipped: EVIS_ASSETS names no folder with recordings");
        return;
    };
    for (name, size, preset) in RECORDINGS {
        let recording = read_events(&assets.join("recordings").join(name), None).unwrap();
        assert!(recording.events.len() > 50_000, "{name}");
        let (start_us, end_us) = recording.range;
        let middle_us = (start_us + end_us) / 2;
        let length_us = end_us - middle_us;
        let second = slice_time(&recording.events, middle_us, end_us);
        let want = figures(&stats(second, size, (middle_us, end_us)).unwrap());

        let preset = SensorConfig::preset(preset).unwrap();
        let made = calibrate(&recording.events, size, (start_us, middle_us), &preset, 0).unwrap();
        eprintln!("{name}: {:?}", made.sensor.noise);
        assert!(made.warnings.is_empty(), "{name}: {:?}", made.warnings);
        let fitted = expected(&made.sensor, size, length_us).unwrap();
        eprintln!("{name}: second half {want:.5?}, fitted {fitted:.5?}");
        assert!(apart(fitted, want) < 0.2, "{name}: {fitted:?} for {want:?}");

        let own = expected(&preset, size, length_us).unwrap();
        eprintln!("{name}: preset {own:.5?}");
        assert!(apart(own, want) < 0.2, "{name}: preset has {own:?} for {want:?}");

        // Noise that recovers: after an event, a pixel in the dark is nearly silent for a fifth of a second.
        assert_eq!(made.sensor.noise.shot_recovery_us > 0.0, preset.noise.burst_longest_us == 0.0, "{name}");
        if preset.noise.shot_recovery_us > 0.0 {
            let told = |events: &[Event], range| {
                let of = stats(events, size, range).unwrap().interval_quantiles_us.unwrap();
                [of[2], of[3]]
            };
            let near = |got: [f64; 2], want: [f64; 2]| {
                (got[0] / want[0] - 1.0).abs() < 0.1 && (got[1] / want[1] - 1.0).abs() < 0.1
            };
            let want = told(second, (middle_us, end_us));
            let before = |sensor: &SensorConfig| {
                told(&static_scene(sensor, size, length_us, 0.0, 100).unwrap(), (0, length_us))
            };
            for (what, sensor) in [("fitted", &made.sensor), ("preset", &preset)] {
                let got = before(sensor);
                eprintln!("{name}: median and 90 % of intervals {want:.0?} us, {what} {got:.0?}");
                assert!(near(got, want), "{name}: {what} {got:?} for {want:?}");
            }
            let mut forgets = preset.clone();
            forgets.noise.shot_recovery_us = 0.0;
            let forgets = before(&forgets);
            assert!(!near(forgets, want), "canary: noise without a memory has {forgets:?}");
        }

        // Bursts that last: the time between a pixel's events, and the Fano factor by window, are the recording's too.
        if preset.noise.burst_longest_us > 0.0 {
            let told = |events: &[Event], range| {
                let of = stats(events, size, range).unwrap();
                let fano: Vec<f64> = of.fano_by_window.iter().map(|point| point[1]).collect();
                (of.interval_quantiles_us.unwrap()[2], fano)
            };
            let near = |(median, fano): &(f64, Vec<f64>), (want_median, want): &(f64, Vec<f64>)| {
                let windows = fano.iter().zip(want).all(|(got, want)| (got / want - 1.0).abs() < 0.15);
                windows && fano.len() == want.len() && (median / want_median - 1.0).abs() < 0.3
            };
            let want = told(second, (middle_us, end_us));
            let own = told(&static_scene(&preset, size, length_us, 0.0, 100).unwrap(), (0, length_us));
            eprintln!("{name}: median interval and Fano factors by window {want:.3?}, preset {own:.3?}");
            assert!(near(&own, &want), "{own:?} for {want:?}");
            let mut short = preset.clone();
            (short.noise.burst_us, short.noise.burst_longest_us) = (2000.0, 0.0);
            let short = told(&static_scene(&short, size, length_us, 0.0, 100).unwrap(), (0, length_us));
            assert!(!near(&short, &want), "canary: bursts of 2 ms have {short:?}");
        }

        let other = expected(&SensorConfig::preset("v2e-noisy").unwrap(), size, length_us).unwrap();
        assert!(apart(other, want) > 0.5, "canary: {name}: another sensor has {other:?} for {want:?}");
    }
}

#[test]
fn a_board_that_moves_is_told_from_noise() {
    let Some(assets) = std::env::var_os("EVIS_ASSETS").map(PathBuf::from) else {
        eprintln!("skipped: EVIS_ASSETS names no folder with recordings");
        return;
    };
    // The two still recordings, which have no warnings, are the other side.
    let board = read_events(&assets.join("recordings/davis346_board_346x260.npz"), None).unwrap();
    let made = calibrate(&board.events, (346, 260), board.range, &SensorConfig::default(), 0).unwrap();
    let sign = "neighbouring pixels change together";
    assert!(made.warnings.iter().any(|warning| warning.contains(sign)), "{:?}", made.warnings);
}
