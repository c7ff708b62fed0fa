//! Statistics of streams, and sensors that are fitted to them.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use evis_core::random::{Key, StreamId, unit};
use evis_core::sensor::{Noise, Pattern, Photoreceptor};
use evis_core::stats::{Stimulus, calibrate, calibrate_flicker, static_scene, stats};
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
    assert!(near(got.rate_hz, 2.0, 0.03) && near(got.cold_rate_hz, 2.0, 0.03), "{got:?}");
    assert!(near(got.fano, 1.0, 0.06), "{}", got.fano);
    assert!(got.fano_by_window.iter().all(|p| near(p[1], 1.0, 0.06)), "{:?}", got.fano_by_window);
    assert!(got.spectrum.iter().filter(|p| p[0] > 40.0).all(|p| near(p[1], 1.0, 0.4)), "{:?}", got.spectrum);
    assert!(got.spatial_correlation.iter().all(|c| c[1].abs() < 0.06), "{:?}", got.spatial_correlation);
    assert_eq!((got.hot_pixels, got.on_share, got.alternation), (0, 1.0, Some(0.0)));
    // Exponential intervals, cut at 4 s.
    assert!(near(got.regularity.unwrap(), 0.9, 0.2), "{:?}", got.regularity);
    assert!(got.burst_share < 0.01);

    let other = stats(&poisson(size, 4.0, 2.0, true), size, (0, 4_000_000)).unwrap();
    assert_eq!(other.alternation, Some(1.0), "canary: polarity matters");
    // One pixel in eight is hot.
    let hot = stats(&poisson((8, 1), 4.0, 60.0, true), (8, 8), (0, 4_000_000)).unwrap();
    assert_eq!((hot.hot_pixels, hot.cold_rate_hz, hot.silent_share), (8, 0.0, 0.875));
    assert!(near(hot.hot_hz, 60.0, 0.1) && hot.pairs == 0 && hot.alternation.is_none());
    let bursts: Vec<Event> = poisson(size, 4.0, 1.0, false)
        .into_iter()
        .flat_map(|e| [e, Event::new(e.t + 300, e.x, e.y, Polarity::On)])
        .filter(|e| e.t < 4_000_000)
        .collect();
    let mut bursts = bursts;
    bursts.sort_by_key(Event::order);
    let got = stats(&bursts, size, (0, 4_000_000)).unwrap();
    assert!(near(got.fano, 2.0, 0.1) && near(got.burst_interval_us.unwrap(), 300.0, 0.05), "{got:?}");
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
    assert_eq!((empty.events, empty.fano, empty.alternation), (0, 1.0, None));
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
    assert!(made.warnings.is_empty(), "{:?}", made.warnings);
    assert!(made.to_string().contains("thresholds and their spread"), "{made}");
    assert_eq!(SensorConfig::from_toml(&made.sensor.to_toml()).unwrap(), made.sensor);
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
