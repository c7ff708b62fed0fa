//! Statistics of streams, and sensors that are fitted to them.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use evis_core::random::{Key, StreamId, unit};
use evis_core::sensor::{Noise, Pattern, Photoreceptor};
use evis_core::stats::{Comparison, Named, Stimulus, calibrate, calibrate_flicker, static_scene, stats};
use evis_core::{EmulatorConfig, Event, EventEmulator, Frames, Polarity, SensorConfig};

fn near(got: f64, want: f64, share: f64) -> bool {
    (got - want).abs() <= share * want.abs()
}

/// A Poisson process of `hz` per pixel, alternating or of one polarity.
fn poisson(size: (u32, u32), seconds: f64, hz: f64, alternate: bool) -> Vec<Event> {
    let key = Key::new(5, 0, 0);
    let mut events = Vec::new();
    for pixel in 0..size.0 * size.1 {
        let (mut t, mut k) = (0.0, 0);
        loop {
            t -= unit(key.draw(pixel, StreamId::Noise, 0, k)[0]).ln() / hz;
            if t >= seconds {
                break;
            }
            let polarity = if alternate && k % 2 == 0 { Polarity::Off } else { Polarity::On };
            events.push(Event::new(
                (t * 1e6) as i64,
                (pixel % size.0) as u16,
                (pixel / size.0) as u16,
                polarity,
            ));
            k += 1;
        }
    }
    events.sort_by_key(Event::order);
    events
}

#[test]
fn a_poisson_process_has_the_statistics_of_one() {
    let size = (100, 80);
    let got = stats(&poisson(size, 4.0, 2.0, false), size, (0, 4_000_000)).unwrap();
    assert!(near(got.rate_hz, 2.0, 0.03) && near(got.cold_rate_hz.unwrap(), 2.0, 0.03), "{got:?}");
    assert!(near(got.fano.unwrap(), 1.0, 0.06), "{:?}", got.fano);
    assert!(got.fano_by_window.iter().all(|p| near(p[1], 1.0, 0.06)), "{:?}", got.fano_by_window);
    assert!(got.spectrum.iter().filter(|p| p[0] > 40.0).all(|p| near(p[1], 1.0, 0.4)), "{:?}", got.spectrum);
    assert!(got.spatial_correlation.iter().all(|c| c[1].abs() < 0.06), "{:?}", got.spatial_correlation);
    assert_eq!((got.hot_pixels, got.on_share, got.alternation), (0, Some(1.0), Some(0.0)));
    // Exponential intervals, cut at 4 s.
    assert!(near(got.regularity.unwrap(), 0.9, 0.2), "{:?}", got.regularity);
    assert!(got.burst_share.unwrap() < 0.01);

    let other = stats(&poisson(size, 4.0, 2.0, true), size, (0, 4_000_000)).unwrap();
    assert_eq!(other.alternation, Some(1.0), "canary: polarity matters");
    // One pixel in eight is hot.
    let hot = stats(&poisson((8, 1), 4.0, 60.0, true), (8, 8), (0, 4_000_000)).unwrap();
    assert_eq!((hot.hot_pixels, hot.cold_rate_hz, hot.silent_share), (8, Some(0.0), 0.875));
    assert!(near(hot.hot_hz.unwrap(), 60.0, 0.1) && hot.pairs == 0 && hot.alternation.is_none());
    let bursts: Vec<Event> = poisson(size, 4.0, 1.0, false)
        .into_iter()
        .flat_map(|e| [e, Event::new(e.t + 300, e.x, e.y, Polarity::On)])
        .filter(|e| e.t < 4_000_000)
        .collect();
    let mut bursts = bursts;
    bursts.sort_by_key(Event::order);
    let got = stats(&bursts, size, (0, 4_000_000)).unwrap();
    assert!(
        near(got.fano.unwrap(), 2.0, 0.1) && near(got.burst_interval_us.unwrap(), 300.0, 0.05),
        "{got:?}"
    );
}

#[test]
fn what_cannot_be_counted_is_refused() {
    let event = |t, x| Event::new(t, x, 0, Polarity::On);
    for (events, size, range) in [
        (vec![event(5, 0), event(4, 0)], (4, 4), (0, 10)),
        (vec![event(5, 4)], (4, 4), (0, 10)),
        (vec![event(10, 0)], (4, 4), (0, 10)),
        (vec![], (4, 4), (10, 10)),
        (vec![], (0, 4), (0, 10)),
    ] {
        assert!(stats(&events, size, range).is_err(), "{events:?} {size:?} {range:?}");
    }
    let empty = stats(&[], (4, 4), (0, 1000)).unwrap();
    assert_eq!((empty.events, empty.fano, empty.alternation), (0, None, None));
    assert!(calibrate(&[], (4, 4), (0, 1000), &SensorConfig::default(), 0).is_err());
}

#[test]
fn a_calibration_finds_the_noise_that_was_put_in() {
    let size = (160, 120);
    let noise = Noise {
        shot_hz: 1.5,
        on_share: 0.6,
        shot_spread_decades: 0.3,
        hot_share: 2e-3,
        hot_hz: 120.0,
        burst_events: 0.4,
        burst_us: 400.0,
        ..Noise::default()
    };
    let truth = SensorConfig { noise, ..SensorConfig::default() };
    let events = static_scene(&truth, size, 4_000_000, 0.18, 11).unwrap();
    let made = calibrate(&events, size, (0, 4_000_000), &SensorConfig::default(), 0).unwrap();
    let got = made.sensor.noise;
    for (name, got, want) in [
        ("shot_hz", got.shot_hz, 1.5),
        ("on_share", got.on_share, 0.6),
        ("shot_spread_decades", got.shot_spread_decades, 0.3),
        ("hot_share", got.hot_share, 2e-3),
        ("hot_hz", got.hot_hz, 120.0),
        ("burst_events", got.burst_events, 0.4),
        ("burst_us", got.burst_us, 400.0),
    ] {
        // Forty hot pixels are known to a sixth.
        assert!(near(got.into(), want, 0.25), "{name}: {got} for {want}");
    }
    assert_eq!(got.alternation, -1.0, "polarities are independent");
    assert_eq!(got.shot_recovery_us, 0.0, "and times");
    assert!(made.warnings.is_empty(), "{:?}", made.warnings);
    assert!(made.to_string().contains("thresholds and their spread"), "{made}");
    assert_eq!(SensorConfig::from_toml(&made.sensor.to_toml()).unwrap(), made.sensor);
}

#[test]
fn a_recovery_of_shot_noise_is_found_again() {
    let (size, end_us) = ((160, 120), 4_000_000);
    let noise =
        Noise { shot_hz: 1.5, shot_spread_decades: 0.2, shot_recovery_us: 250_000.0, ..Noise::default() };
    let truth = SensorConfig { noise, ..SensorConfig::default() };
    let events = static_scene(&truth, size, end_us, 0.18, 11).unwrap();
    let made = calibrate(&events, size, (0, end_us), &SensorConfig::default(), 0).unwrap();
    let got = made.sensor.noise;
    for (name, got, want) in [
        ("shot_hz", got.shot_hz, 1.5),
        ("shot_spread_decades", got.shot_spread_decades, 0.2),
        ("shot_recovery_us", got.shot_recovery_us, 250_000.0),
    ] {
        assert!(near(got.into(), want, 0.2), "{name}: {got} for {want}");
    }
    assert!(made.warnings.is_empty(), "{:?}", made.warnings);
    assert!(made.to_string().contains("recovery of shot noise"), "{made}");
}

/// `waves` that drift to the right by `px_s` pixels per second, before a sensor with noise.
fn drifting(size: (u32, u32), px_s: f64, seconds: i64) -> Vec<Event> {
    let noise = Noise { shot_hz: 1.0, ..Noise::default() };
    let sensor = SensorConfig { noise, ..SensorConfig::default() };
    let config =
        EmulatorConfig { width: size.0, height: size.1, sensor, seed: 7, ..EmulatorConfig::default() };
    let mut emulator = EventEmulator::new(config).unwrap();
    let mut lists = [Vec::new()];
    for t_us in (0..=seconds * 1_000_000).step_by(2_000) {
        let moved = px_s * t_us as f64 * 1e-6;
        let light: Vec<f32> = (0..size.0 * size.1)
            .map(|at| (f64::from(at % size.0) - moved, f64::from(at / size.0)))
            .map(|(x, y)| {
                (0.3 * (1.0 + 0.3 * (0.5 * x + 0.7 * y).sin() + 0.3 * (0.3 * x - 0.9 * y).sin())) as f32
            })
            .collect();
        emulator.push_into(&Frames::linear(&light), t_us, &mut lists).unwrap();
    }
    let [mut events] = lists;
    events.retain(|event| event.t < seconds * 1_000_000);
    events
}

#[test]
fn a_scene_that_moves_is_told_from_noise() {
    let size = (48, 32);
    let warnings = |events: &[Event], seconds: i64| {
        let range = (0, seconds * 1_000_000);
        calibrate(events, size, range, &SensorConfig::default(), 0).unwrap().warnings
    };
    let told =
        |warnings: &[String]| warnings.iter().any(|w| w.contains("neighbouring pixels change together"));
    // Slow enough that few pixels count as hot, and as many events from one 50 ms to the next: nothing else shows it.
    let moving = drifting(size, 12.0, 2);
    let counted = stats(&moving, size, (0, 2_000_000)).unwrap();
    assert!(counted.hot_share < 0.05 && counted.unsteadiness.unwrap() < 0.15, "{counted:?}");
    let got = warnings(&moving, 2);
    assert!(told(&got) && !got.iter().any(|w| w.contains("hot") || w.contains("from 50 ms")), "{got:?}");

    // Canary: the same events of each pixel at the same times, but no pixel beside its neighbour.
    let pixels = size.0 * size.1;
    let scattered: Vec<Event> = moving
        .iter()
        .map(|e| (e, (u32::from(e.y) * size.0 + u32::from(e.x)) * 605 % pixels))
        .map(|(e, at)| {
            let polarity = if e.p == 1 { Polarity::On } else { Polarity::Off };
            Event::new(e.t, (at % size.0) as u16, (at / size.0) as u16, polarity)
        })
        .collect();
    let got = warnings(&scattered, 2);
    assert!(!told(&got), "{got:?}");

    // Noise alone: quiet, bursting and uneven, loud, and a leak that starts everywhere at once.
    for (noise, seconds) in [
        (Noise { shot_hz: 0.3, ..Noise::default() }, 4),
        (
            Noise {
                shot_hz: 2.0,
                shot_spread_decades: 0.3,
                burst_events: 1.0,
                burst_us: 2000.0,
                ..Noise::default()
            },
            1,
        ),
        (Noise { shot_hz: 10.0, alternation: 0.9, hot_share: 0.01, hot_hz: 300.0, ..Noise::default() }, 1),
        (Noise { leak_hz: 8.0, leak_jitter: 0.01, shot_hz: 0.1, ..Noise::default() }, 2),
    ] {
        let sensor = SensorConfig { noise, ..SensorConfig::default() };
        let events = static_scene(&sensor, size, seconds * 1_000_000, 0.18, 5).unwrap();
        let got = warnings(&events, seconds);
        assert!(!told(&got), "{noise:?}: {got:?}");
    }
    // Faster, many pixels are taken for hot ones.
    let got = warnings(&drifting(size, 60.0, 1), 1);
    assert!(told(&got) && got.iter().any(|w| w.contains("count as hot")), "{got:?}");
}

#[test]
fn a_recording_that_is_too_short_for_hot_pixels_says_so() {
    let size = (64, 48);
    let events = poisson(size, 1.0, 10.0, true);
    let part = |seconds: f64| {
        let end_us = (seconds * 1e6) as i64;
        let events: Vec<Event> = events.iter().copied().filter(|e| e.t < end_us).collect();
        let counted = stats(&events, size, (0, end_us)).unwrap();
        let made = calibrate(&events, size, (0, end_us), &SensorConfig::default(), 0);
        (Named { name: "a.h5".into(), stats: counted }, made)
    };
    let (short, made) = part(0.03);
    let told = &short.stats;
    // One event makes a pixel hot: nothing is left.
    assert!(told.events > 500 && told.hot_event_share == Some(1.0), "{told:?}");
    assert_eq!((told.cold_rate_hz, told.on_share, told.fano, told.burst_share), (None, None, None, None));
    assert_eq!((told.cold_on_hz, told.cold_off_hz, told.unsteadiness), (None, None, None));
    let error = made.unwrap_err().to_string();
    assert!(error.contains("at least 200: record 0.25 s or more"), "{error}");

    let (long, made) = part(1.0);
    let made = made.unwrap();
    assert!(long.stats.on_share.is_some() && long.stats.hot_note().is_none(), "canary: {long:?}");
    assert!(!made.warnings.iter().any(|w| w.contains("too short")), "{:?}", made.warnings);
    let (between, made) = part(0.2);
    assert!(between.stats.on_share.is_some());
    assert!(made.unwrap().warnings[0].contains("of 0.200 s is too short for a threshold of 20 Hz"));

    let both = Comparison { a: short, b: long };
    let table = both.to_string();
    for figure in
        ["ON share", "Fano factor of counts", "rate without hot pixels, Hz", "excess of intervals < 5 ms"]
    {
        let line = table.lines().find(|line| line.starts_with(figure)).unwrap();
        let cells: Vec<&str> = line[figure.len()..].split_whitespace().collect();
        assert!(cells[0] == "-" && cells[1] != "-" && cells[2] == "-", "{line}");
    }
    assert_eq!(both.notes().len(), 1, "{:?}", both.notes());
    assert!(
        table.contains("note: A: a recording of 0.030 s is too short") && table.contains("1 event makes"),
        "{table}"
    );
    let json = serde_json::to_value(&both).unwrap();
    assert!(json["a"]["stats"]["fano"].is_null() && json["b"]["stats"]["fano"].is_f64());
}

#[test]
fn a_regular_leak_is_told_from_shot_noise() {
    let size = (64, 48);
    let noise = Noise { leak_hz: 2.0, leak_jitter: 0.1, shot_hz: 0.2, ..Noise::default() };
    let truth = SensorConfig { noise, ..SensorConfig::default() };
    let events = static_scene(&truth, size, 8_000_000, 0.18, 3).unwrap();
    let made = calibrate(&events, size, (0, 8_000_000), &SensorConfig::default(), 0).unwrap();
    assert!(near(made.sensor.noise.leak_hz.into(), 2.0, 0.1), "{:?}", made.sensor.noise);
    assert!(near(made.sensor.noise.shot_hz.into(), 0.2, 0.2), "{:?}", made.sensor.noise);
    // Canary: the same rate at random times is no leak.
    let noise = Noise { shot_hz: 2.2, on_share: 0.95, ..Noise::default() };
    let events =
        static_scene(&SensorConfig { noise, ..SensorConfig::default() }, size, 8_000_000, 0.18, 3).unwrap();
    let made = calibrate(&events, size, (0, 8_000_000), &SensorConfig::default(), 0).unwrap();
    assert_eq!(made.sensor.noise.leak_hz, 0.0);
}

fn flicker(sensor: &SensorConfig, size: (u32, u32), stimulus: Stimulus, seconds: f64) -> Vec<Event> {
    let config = EmulatorConfig {
        width: size.0,
        height: size.1,
        sensor: sensor.clone(),
        seed: 4,
        ..EmulatorConfig::default()
    };
    let mut emulator = EventEmulator::new(config).unwrap();
    // Forty samples per period or more, and a phase that nobody told.
    let step_us = (1e6 / stimulus.hz / 40.0).min(1000.0) as i64;
    let mut lists = [Vec::new()];
    for k in 0..(seconds * 1e6) as i64 / step_us {
        let phase = std::f64::consts::TAU * stimulus.hz * (k * step_us) as f64 * 1e-6 + 1.1;
        let light = vec![(0.3 * (1.0 + stimulus.contrast * phase.sin())) as f32; (size.0 * size.1) as usize];
        emulator.push_into(&Frames::linear(&light), k * step_us, &mut lists).unwrap();
    }
    let [events] = lists;
    events
}

#[test]
fn flicker_shows_thresholds_and_bandwidth() {
    let size = (24, 16);
    let truth = SensorConfig {
        threshold_on: 0.15,
        threshold_off: 0.22,
        photoreceptor: Photoreceptor { cutoff_hz: 60.0, ..Photoreceptor::default() },
        pattern: Pattern { sigma: 0.02, ..Pattern::default() },
        noise: Noise { shot_hz: 0.5, ..Noise::default() },
        ..SensorConfig::default()
    };
    let stimuli = [Stimulus::new(5.0, 0.6).unwrap(), Stimulus::new(60.0, 0.6).unwrap()];
    let made = stimuli.map(|stimulus| flicker(&truth, size, stimulus, 3.0));
    let both = [(made[0].as_slice(), size, stimuli[0]), (made[1].as_slice(), size, stimuli[1])];
    let got = calibrate_flicker(&both, &SensorConfig::default()).unwrap();
    assert!(near(got.threshold_on, 0.15, 0.06) && near(got.threshold_off, 0.22, 0.06), "{got}");
    assert!(near(got.sigma, 0.02, 0.3), "{got}");
    assert!(near(got.cutoff_hz.unwrap(), 60.0, 0.15), "{got}");
    assert_eq!(got.sensor.threshold_on, got.threshold_on as f32);

    let one = calibrate_flicker(&both[..1], &SensorConfig::default()).unwrap();
    assert!(one.cutoff_hz.is_none() && one.unknown[0].contains("second frequency"), "{one}");
    // Canary: a wrong contrast is a wrong threshold.
    let wrong = Stimulus::new(5.0, 0.3).unwrap();
    let wrong = calibrate_flicker(&[(made[0].as_slice(), size, wrong)], &SensorConfig::default()).unwrap();
    assert!(wrong.threshold_on < 0.1, "{wrong}");
    let noise = Noise { shot_hz: 60.0, ..Noise::default() };
    let random = SensorConfig { noise, ..SensorConfig::default() };
    let still = static_scene(&random, size, 3_000_000, 0.2, 1).unwrap();
    let error = calibrate_flicker(&[(&still, size, stimuli[0])], &truth).unwrap_err();
    assert!(error.to_string().contains("in step with 5 Hz"), "{error}");
    let faint = flicker(&truth, size, Stimulus::new(5.0, 0.05).unwrap(), 1.0);
    let error = calibrate_flicker(&[(&faint, size, Stimulus::new(5.0, 0.05).unwrap())], &truth).unwrap_err();
    assert!(error.to_string().contains("raise the contrast"), "{error}");
    assert!(Stimulus::new(0.0, 0.5).is_err() && Stimulus::new(5.0, 1.0).is_err());
}
