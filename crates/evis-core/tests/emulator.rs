//! The emulator against closed forms, rates, and itself under other circumstances.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use evis_core::event::is_ordered;
use evis_core::sensor::{
    Bandwidth, Curve, FilterRule, LeakLaw, Noise, NoiseReference, PRESETS, Pattern, Photoreceptor, Readout,
    Refractory, RefractoryRule, Start,
};
use evis_core::{
    EmulatorConfig, Event, EventEmulator, FrameData, Frames, SensorConfig, Times, Transfer, TriggerRule,
};

fn emulator(width: u32, height: u32, sensor: &SensorConfig) -> EventEmulator {
    EventEmulator::new(EmulatorConfig {
        width,
        height,
        sensor: sensor.clone(),
        threads: 1,
        ..Default::default()
    })
    .unwrap()
}

/// Events of a light that is the same for all pixels at a time.
fn run(emulator: &mut EventEmulator, times: &[i64], light: impl Fn(f64) -> f64) -> Vec<Event> {
    let config = emulator.config();
    let pixels = (config.width * config.height) as usize;
    let mut events = Vec::new();
    for t_us in times {
        let frame = vec![light(*t_us as f64 * 1e-6) as f32; pixels];
        events.extend(emulator.push(&Frames::linear(&frame), *t_us).unwrap().remove(0));
    }
    assert!(is_ordered(&events));
    events
}

fn grid(step_us: i64, end_us: i64) -> Vec<i64> {
    (0..=end_us / step_us).map(|k| k * step_us).collect()
}

/// Steps from a hundred microseconds to a tenth of a second, in no order.
fn irregular(end_us: i64) -> Vec<i64> {
    common::irregular(end_us, 12_345, 100, 7)
}

/// Whether `count` is what a Poisson process of mean `expected` gives, within 4.5 standard deviations and `slack` of it.
fn meets(count: usize, expected: f64, slack: f64) -> bool {
    (count as f64 - expected).abs() < 4.5 * expected.sqrt() + slack * expected
}

/// The scene that peers were measured on.
fn drifting(width: u32, x: u32, t: f64) -> f64 {
    let _ = width;
    0.5 + 0.4 * (0.3 + std::f64::consts::TAU * (f64::from(x) / 41.7 - 9.7 * t)).sin()
}

/// Crossings of `log(light(t))` in closed form, by bisection on monotone pieces: (time, rises).
fn crossings(signal: impl Fn(f64) -> f64, turns: &[f64], end: f64, c: f64) -> Vec<(f64, bool)> {
    let mut edges = vec![0.0];
    edges.extend(turns.iter().copied().filter(|t| *t > 0.0 && *t < end));
    edges.push(end);
    let mut reference = signal(0.0);
    let mut found = Vec::new();
    for piece in edges.windows(2) {
        let (low, high) = (piece[0], piece[1]);
        loop {
            let change = signal(high) - reference;
            if change.abs() < c {
                break;
            }
            let level = reference + c * change.signum();
            let (mut a, mut b) = (low, high);
            for _ in 0..60 {
                let middle = 0.5 * (a + b);
                if (signal(middle) - level) * change.signum() >= 0.0 { b = middle } else { a = middle }
            }
            found.push((b, change > 0.0));
            reference = level;
        }
    }
    found
}

#[test]
fn the_scene_of_the_peers_is_met_in_closed_form() {
    let width = 346;
    let mut emulator = emulator(width, 1, &SensorConfig::default());
    let mut got = vec![Vec::new(); width as usize];
    for k in 0..200 {
        let frame: Vec<f32> = (0..width).map(|x| drifting(width, x, f64::from(k) * 1e-3) as f32).collect();
        for event in emulator.push(&Frames::linear(&frame), i64::from(k) * 1000).unwrap().remove(0) {
            got[usize::from(event.x)].push((event.t, event.p == 1));
        }
    }
    let (mut errors, mut total, mut equal) = (Vec::new(), 0, 0);
    for (x, got) in got.iter().enumerate() {
        let phase = 0.3 + std::f64::consts::TAU * x as f64 / 41.7;
        let omega = std::f64::consts::TAU * 9.7;
        // phase - omega t = pi / 2 + n pi
        let mut turns: Vec<f64> = (-100..100)
            .map(|n| (phase - std::f64::consts::FRAC_PI_2 - f64::from(n) * std::f64::consts::PI) / omega)
            .collect();
        turns.sort_by(f64::total_cmp);
        let signal = |t: f64| (drifting(width, x as u32, t) + 1e-3).ln();
        let expected = crossings(signal, &turns, 0.199, f64::from(0.2_f32));
        total += expected.len();
        let same = expected.len() == got.len() && expected.iter().zip(got).all(|(a, b)| a.1 == b.1);
        if same {
            equal += 1;
            errors.extend(expected.iter().zip(got).map(|(a, b)| (a.0 * 1e6 - b.0 as f64 - 0.5).abs()));
        }
    }
    errors.sort_by(f64::total_cmp);
    let median = errors[errors.len() / 2];
    // 260 rows like this one.
    assert!((3_415_000..3_440_000).contains(&(total * 260)), "{}", total * 260);
    assert!(equal >= 340, "{equal} of 346 pixels have the closed form's polarities");
    assert!(median < 3.3, "{median} us");
    assert!(median > 0.1, "canary: light that is not straight between samples costs something, {median}");
}

#[test]
fn eight_bit_ties_lose_nothing() {
    // A staircase of equal values: the signal rests exactly on levels, where tests of the kind "does a crossing lie
    // inside the interval" lose events. Whatever the values, references stay within a threshold of the signal.
    let mut emulator =
        emulator(256, 1, &SensorConfig { threshold_on: 0.1, threshold_off: 0.1, ..Default::default() });
    let mut moved = [0_i64; 256];
    let mut frame = vec![0_u8; 256];
    for k in 0..600_usize {
        for (x, value) in frame.iter_mut().enumerate() {
            let phase = (k / 4 * (1 + x % 7) + x) % 510;
            *value = if phase < 256 { phase as u8 } else { (510 - phase) as u8 };
        }
        for event in emulator.push(&Frames::u8(&frame, Transfer::Linear), k as i64 * 1000).unwrap().remove(0)
        {
            moved[usize::from(event.x)] += if event.p == 1 { 1 } else { -1 };
        }
        for (x, value) in frame.iter().enumerate() {
            let log = |value: u8| (f64::from(value) / 255.0 + 1e-3).ln();
            let start = x % 510;
            let change = log(*value) - log(start as u8);
            let off = (change - 0.1 * moved[x] as f64).abs();
            assert!(off < 0.1 + 1e-4, "pixel {x}, frame {k}: {off}");
        }
    }
}

#[test]
fn times_stay_exact_after_hours() {
    // Float32 seconds lose 61 us after ten minutes; here a year has passed.
    let year = 365 * 86_400_000_000_i64;
    let mut emulator = emulator(1, 1, &SensorConfig::default());
    emulator.push(&Frames::linear(&[0.5]), year).unwrap();
    let events = emulator.push(&Frames::linear(&[0.7]), year + 1000).unwrap().remove(0);
    let expected = 0.2 / (0.701_f64 / 0.501).ln() * 1000.0;
    assert_eq!(events.len(), 1);
    assert_eq!(events[0].t - year, expected as i64);
}

#[test]
fn the_first_interval_is_like_all_others() {
    // Events soon after t = 0, and before it, are as good as any.
    for start in [-1000, 0] {
        let mut emulator = emulator(1, 1, &SensorConfig::default());
        let light = |t: f64| (t * 1e3).exp() - 1e-3;
        let events = run(&mut emulator, &[start, start + 1000, start + 2010], light);
        assert_eq!(events.len(), 10);
        assert!((events[0].t - start - 200).abs() <= 1);
    }
}

#[test]
fn frozen_thresholds_stay_frozen() {
    // Thresholds that are redrawn for each frame lose events: here, the count follows from the threshold that each
    // pixel showed with its first event.
    let sensor =
        SensorConfig { pattern: Pattern { sigma: 0.03, ..Pattern::default() }, ..Default::default() };
    let mut emulator = emulator(64, 64, &sensor);
    let ramp = |t: f64| (4.0 * t).exp();
    let events = run(&mut emulator, &grid(1000, 1_000_000), ramp);
    let mut first = vec![None; 4096];
    let mut count = vec![0; 4096];
    for event in &events {
        let pixel = usize::from(event.y) * 64 + usize::from(event.x);
        first[pixel].get_or_insert(event.t);
        count[pixel] += 1;
    }
    let (mut sum, mut squares) = (0.0, 0.0);
    for (first, count) in first.iter().zip(&count) {
        let threshold = ((4.0 * first.unwrap() as f64 * 1e-6).exp() + 1e-3).ln() - 1.001_f64.ln();
        let expected = 4.0 / threshold;
        assert!((f64::from(*count) - expected).abs() <= 1.01, "{count} for {expected}");
        sum += threshold;
        squares += threshold * threshold;
    }
    let mean = sum / 4096.0;
    let sigma = (squares / 4096.0 - mean * mean).sqrt();
    assert!((mean - 0.2).abs() < 5.0 * 0.03 / 64.0, "{mean}");
    assert!((sigma - 0.03).abs() < 5.0 * 0.03 / 90.0, "{sigma}");
}

#[test]
fn shot_noise_has_its_rate_at_every_frame_rate() {
    let noise = Noise { shot_hz: 20.0, on_share: 0.3, ..Noise::default() };
    let sensor = SensorConfig { noise, ..Default::default() };
    let end = 2_000_000;
    let mut counts = Vec::new();
    for times in [grid(33_333, end), grid(3_333, end), grid(333, end), irregular(end)] {
        let mut emulator = emulator(40, 30, &sensor);
        let events = run(&mut emulator, &times, |_| 0.5);
        let seconds = *times.last().unwrap() as f64 * 1e-6;
        let expected = 20.0 * 1200.0 * seconds;
        let on = events.iter().filter(|event| event.p == 1).count();
        assert!(meets(events.len(), expected, 0.0), "{} for {expected}", events.len());
        assert!(meets(on, 0.3 * expected, 0.0), "{on}");
        // Canary: 3 % more would be seen.
        assert!(!meets(events.len(), 1.03 * expected, 0.0));
        counts.push(events.iter().filter(|event| event.t <= 1_900_000).count());
    }
    // Not only the rate: the events themselves do not depend on the frames.
    assert!(counts.iter().all(|count| *count == counts[0]), "{counts:?}");
}

#[test]
fn leak_has_its_rate_at_every_frame_rate() {
    for law in [LeakLaw::Ramp, LeakLaw::Poisson] {
        let noise = Noise {
            leak_hz: 5.0,
            leak_law: law,
            leak_spread_decades: 0.1,
            leak_jitter: if law == LeakLaw::Ramp { 0.1 } else { 0.0 },
            ..Noise::default()
        };
        let pattern = Pattern { sigma: 0.03, start: Start::Phase, ..Pattern::default() };
        let sensor = SensorConfig { noise, pattern, ..Default::default() };
        for times in
            [grid(33_333, 4_000_000), grid(2_500, 4_000_000), grid(333, 1_000_000), irregular(4_000_000)]
        {
            let mut emulator = emulator(64, 48, &sensor);
            let events = run(&mut emulator, &times, |_| 0.5);
            let seconds = *times.last().unwrap() as f64 * 1e-6;
            // A ramp that starts anywhere between the thresholds is half an event behind.
            let behind = if law == LeakLaw::Ramp { 0.5 } else { 0.0 };
            let expected = (5.0 * seconds - behind) * 3072.0;
            assert!(events.iter().all(|event| event.p == 1));
            // The pixels' spread of 0.1 decades: 0.24 / sqrt(3072) is 0.4 %.
            assert!(meets(events.len(), expected, 0.013), "{law:?}: {} for {expected}", events.len());
        }
    }
}

#[test]
fn v2e_shot_noise_falls_with_light_as_measured() {
    let mut sensor = SensorConfig::preset("v2e").unwrap();
    sensor.noise.shot_hz = 5.0;
    sensor.noise.leak_hz = 0.0;
    // Measured on v2e: 4.86 Hz in the dark, 1.28 Hz at white.
    for (light, expected) in [(0.0, 4.86), (1.0, 1.28)] {
        let mut emulator = emulator(200, 200, &sensor);
        let events = run(&mut emulator, &grid(10_000, 3_000_000), |_| light);
        let rate = events.len() as f64 / 40_000.0 / 3.0;
        assert!((rate / expected - 1.0).abs() < 0.012, "{rate} for {expected}");
    }
}

#[test]
fn hot_pixels_are_few_and_loud() {
    let noise = Noise { hot_share: 0.01, hot_hz: 300.0, ..Noise::default() };
    let mut emulator = emulator(200, 100, &SensorConfig { noise, ..Default::default() });
    let events = run(&mut emulator, &grid(20_000, 1_000_000), |_| 0.5);
    let mut pixels: Vec<_> = events.iter().map(|event| (event.x, event.y)).collect();
    pixels.sort_unstable();
    pixels.dedup();
    assert!(meets(pixels.len(), 200.0, 0.0), "{}", pixels.len());
    assert!(meets(events.len(), 300.0 * pixels.len() as f64, 0.0), "{}", events.len());
}

#[test]
fn bursts_and_alternation_are_what_was_asked_for() {
    let noise =
        Noise { shot_hz: 10.0, burst_events: 1.5, burst_us: 400.0, alternation: 0.9, ..Noise::default() };
    let mut emulator = emulator(50, 40, &SensorConfig { noise, ..Default::default() });
    let events = run(&mut emulator, &grid(5_000, 5_000_000), |_| 0.5);
    let expected = 10.0 * 2000.0 * 5.0;
    assert!(meets(events.len(), expected, 0.02), "{} for {expected}", events.len());
    let mut last = vec![None; 2000];
    let (mut other, mut pairs) = (0.0, 0.0);
    let mut per_window = vec![0.0_f64; 2000 * 50];
    for event in &events {
        let pixel = usize::from(event.y) * 50 + usize::from(event.x);
        if let Some(before) = last[pixel].replace(event.p) {
            pairs += 1.0;
            other += f64::from(u8::from(before != event.p));
        }
        per_window[pixel * 50 + ((event.t - 1) / 100_000) as usize] += 1.0;
    }
    assert!((other / pairs - 0.9).abs() < 0.01, "{}", other / pairs);
    let mean = per_window.iter().sum::<f64>() / per_window.len() as f64;
    let variance = per_window.iter().map(|n| (n - mean).powi(2)).sum::<f64>() / per_window.len() as f64;
    // Clusters of 1 + G, G geometric of mean m: Fano factor E[(1 + G)^2] / E[1 + G] = 1 + 2 m.
    let fano = variance / mean;
    assert!((fano - 4.0).abs() < 0.15, "{fano}");
}

#[test]
fn shot_noise_recovers_as_long_as_was_asked_at_any_frame_rate() {
    let recovery_s = 0.1_f64;
    let noise = Noise { shot_hz: 8.0, shot_recovery_us: 1e6 * recovery_s as f32, ..Noise::default() };
    let seconds = 20_i64;
    // Whether the time of the last event is kept for this alone, or for a refractory period too.
    for period_us in [0, 100] {
        let refractory = Refractory { period_us, ..Refractory::default() };
        let sensor = SensorConfig { noise, refractory, ..Default::default() };
        let events = run(&mut emulator(50, 40, &sensor), &grid(5_000, seconds * 1_000_000), |_| 0.5);
        // Times between events survive t with exp(-integral of the hazard 8 (1 - e^-(t / 0.1)^2)).
        let (mut survival, mut mean, mut within) = (1.0_f64, 0.0, [0.0; 3]);
        let step = 1e-4;
        for k in 0..100_000 {
            let t = (f64::from(k) + 0.5) * step;
            let share = survival * 8.0 * (1.0 - (-(t / recovery_s).powi(2)).exp()) * step;
            mean += survival * step;
            survival -= share;
            if let Some(part) = within.get_mut((t / 0.05) as usize) {
                *part += share;
            }
        }
        let expected = 2000.0 * seconds as f64 / mean;
        assert!(meets(events.len(), expected, 0.02), "{} for {expected}", events.len());
        let mut last = vec![None; 2000];
        let (mut pairs, mut got) = (0.0, [0.0; 3]);
        for event in &events {
            let pixel = usize::from(event.y) * 50 + usize::from(event.x);
            if let Some(before) = last[pixel].replace(event.t) {
                pairs += 1.0;
                if let Some(part) = got.get_mut(((event.t - before) / 50_000) as usize) {
                    *part += 1.0;
                }
            }
        }
        for (got, want) in got.iter().zip(within) {
            assert!((got / pairs - want).abs() < 0.01, "{got:?} of {pairs} for {within:?}");
        }
        assert!(within[0] < 0.05, "canary: without a recovery a third of all pairs are within 50 ms");
        let other = run(&mut emulator(50, 40, &sensor), &grid(33_333, seconds * 1_000_000), |_| 0.5);
        let until = other.last().unwrap().t;
        let first: Vec<_> = events.iter().filter(|event| event.t <= until).collect();
        assert!(first.len() >= other.len() && first.iter().zip(&other).all(|(a, b)| **a == *b));
    }
}

#[test]
fn long_bursts_last_as_long_as_was_asked_at_any_frame_rate() {
    let noise = Noise {
        shot_hz: 0.3,
        burst_events: 1.5,
        burst_us: 500.0,
        burst_longest_us: 300_000.0,
        ..Noise::default()
    };
    let sensor = SensorConfig { noise, ..Default::default() };
    let seconds = 20_i64;
    let events = run(&mut emulator(50, 40, &sensor), &grid(5_000, seconds * 1_000_000), |_| 0.5);
    let expected = 0.3 * 2000.0 * seconds as f64;
    // Clusters of 1 + G: the count's variance is its mean times 1 + 2 m.
    assert!((events.len() as f64 - expected).abs() < 3.5 * (4.0 * expected).sqrt(), "{}", events.len());
    // The same events, however frames cut their time.
    for step_us in [33_333, 700_000] {
        let other = run(&mut emulator(50, 40, &sensor), &grid(step_us, seconds * 1_000_000), |_| 0.5);
        let until = other.last().unwrap().t;
        let first: Vec<_> = events.iter().filter(|event| event.t <= until).collect();
        assert!(first.len() >= other.len() && first.iter().zip(&other).all(|(a, b)| **a == *b), "{step_us}");
    }
    let intervals = |events: &[Event]| {
        let mut last = vec![None; 2000];
        let mut decades = [0.0_f64; 4];
        for event in events {
            let pixel = usize::from(event.y) * 50 + usize::from(event.x);
            if let Some(before) = last[pixel].replace(event.t) {
                let interval = (event.t - before) as f64;
                // Half decades of 500 us to 50 ms.
                let place = (interval / 500.0).log10() * 2.0;
                if (0.0..4.0).contains(&place) {
                    decades[place as usize] += 1.0;
                }
            }
        }
        decades
    };
    // As many per decade, nearly: events between two of a burst part their interval.
    let long = intervals(&events);
    let (least, most) = long.iter().fold((f64::MAX, 0.0_f64), |(a, b), n| (a.min(*n), b.max(*n)));
    assert!(least > 500.0 && most < 1.5 * least, "{long:?}");
    // Canary: exponential delays are not.
    let noise = Noise { burst_us: 2000.0, burst_longest_us: 0.0, ..sensor.noise };
    let short = SensorConfig { noise, ..sensor };
    let short = intervals(&run(&mut emulator(50, 40, &short), &grid(5_000, seconds * 1_000_000), |_| 0.5));
    assert!(short[0].min(short[3]) < 0.3 * short[1].max(short[2]), "{short:?}");
}

/// Output of the chain read back by events of a tiny threshold: (time, level).
fn levels(photoreceptor: Photoreceptor, times: &[i64], light: impl Fn(f64) -> f64) -> Vec<(f64, f64)> {
    let c = 0.001;
    let sensor = SensorConfig {
        threshold_on: c,
        threshold_off: c,
        photoreceptor,
        log_eps: 1e-6,
        ..Default::default()
    };
    let start = (light(times[0] as f64 * 1e-6) + 1e-6).ln();
    let mut level = start;
    let mut out = Vec::new();
    for event in run(&mut emulator(1, 1, &sensor), times, light) {
        level += f64::from(c) * if event.p == 1 { 1.0 } else { -1.0 };
        out.push((event.t as f64 * 1e-6, level));
    }
    out
}

#[test]
fn the_low_pass_answers_a_step_at_any_step_size() {
    let (before, after) = (0.2_f64, 0.5_f64);
    let height = (after / before).ln();
    for order in [1, 2] {
        let cutoff = 40.0_f64;
        let tau = 1.0 / (std::f64::consts::TAU * cutoff);
        for step_us in [500, 2_000, 10_000, 33_000] {
            // A step within a microsecond, then frames of the step.
            let mut times = vec![0, 1];
            times.extend(grid(step_us, 60_000).into_iter().filter(|t| *t > 1));
            let photoreceptor = Photoreceptor { cutoff_hz: cutoff as f32, order, ..Photoreceptor::default() };
            let got = levels(photoreceptor, &times, |t| if t > 0.0 { after } else { before });
            assert!(got.len() > 800, "{}", got.len());
            for (t, level) in &got {
                let u = (t - 1e-6) / tau;
                let missing = if order == 1 { (-u).exp() } else { (1.0 + u) * (-u).exp() };
                let expected = before.ln() + height * (1.0 - missing);
                assert!((level - expected).abs() < 1e-3, "order {order}, {step_us}: {t} {level} {expected}");
            }
        }
    }
}

#[test]
fn the_low_pass_answers_a_sine_as_its_transfer_function_says() {
    let (cutoff, amplitude) = (50.0_f64, 0.4);
    for (order, frequency) in [(1, 20.0), (1, 100.0), (2, 20.0), (2, 100.0)] {
        for step_us in [100, 500] {
            let omega = std::f64::consts::TAU * frequency;
            let photoreceptor = Photoreceptor { cutoff_hz: cutoff as f32, order, ..Photoreceptor::default() };
            let signal = |t: f64| 0.3 * (amplitude * (omega * t).sin()).exp();
            let got = levels(photoreceptor, &grid(step_us, 200_000), signal);
            let settled: Vec<_> = got.iter().filter(|(t, _)| *t > 0.1).collect();
            let most = settled.iter().map(|(_, level)| level - 0.3_f64.ln()).fold(f64::MIN, f64::max);
            let least = settled.iter().map(|(_, level)| level - 0.3_f64.ln()).fold(f64::MAX, f64::min);
            let pole = 1.0 / (1.0 + (frequency / cutoff).powi(2));
            let gain = if order == 1 { pole.sqrt() } else { pole };
            let reached = 0.5 * (most - least) / amplitude;
            // A polygon through samples is a little lower than the sine, and events are whole thresholds of 0.001.
            assert!((reached - gain).abs() < 0.01, "{order} {frequency} {step_us}: {reached}, {gain}");
        }
    }
}

#[test]
fn dim_pixels_are_slow() {
    let photoreceptor = Photoreceptor {
        cutoff_hz: 100.0,
        bandwidth: Bandwidth::Light,
        bandwidth_least: 0.001,
        ..Photoreceptor::default()
    };
    let time_to_half = |light: f64| {
        let times: Vec<i64> =
            [0, 1].into_iter().chain(grid(1000, 900_000).into_iter().filter(|t| *t > 1)).collect();
        let got = levels(photoreceptor, &times, |t| if t > 0.0 { light * 1.02 } else { light });
        let half = got[0].1 + 0.5 * (1.02_f64.ln());
        got.iter().find(|(_, level)| *level >= half).unwrap().0
    };
    let ratio = time_to_half(0.01) / time_to_half(0.1);
    assert!((ratio - 10.0).abs() < 1.0, "{ratio}");
}

#[test]
fn each_refractory_rule_does_what_its_name_says() {
    // A ramp of one threshold per 100 us, period 350 us.
    let ramp = |t: f64| (2000.0 * t).exp() - 1e-3;
    let times = grid(70, 4200);
    let run_rule = |rule, period_us| {
        let refractory = Refractory { period_us, rule };
        let sensor = SensorConfig { refractory, ..Default::default() };
        let mut emulator = emulator(1, 1, &sensor);
        let events = run(&mut emulator, &times, ramp);
        let suppressed = emulator.total_report().suppressed;
        (events.iter().map(|event| event.t).collect::<Vec<_>>(), suppressed)
    };
    let near = |got: &[i64], expected: &[i64]| {
        // Times are floored, so that one period after the other may begin a little early.
        let close = |(i, (a, b)): (usize, (&i64, &i64))| (a - b).abs() <= 3 + i as i64 / 2;
        got.len() == expected.len() && got.iter().zip(expected).enumerate().all(close)
    };
    let (free, none) = run_rule(RefractoryRule::Suppress, 0);
    assert!(free.len() >= 41 && none == 0);
    // Crossings go on at 100, 200, ...; one in four is seen.
    let (suppress, lost) = run_rule(RefractoryRule::Suppress, 350);
    assert!(
        near(&suppress, &[100, 500, 900, 1300, 1700, 2100, 2500, 2900, 3300, 3700, 4100]),
        "{suppress:?}"
    );
    assert!(lost >= 30);
    // Whatever waits fires when the period is over.
    let (defer, _) = run_rule(RefractoryRule::Defer, 350);
    assert!(near(&defer[..5], &[100, 450, 800, 1150, 1500]), "{defer:?}");
    // The reference is the signal at the end of the period: the next event is a threshold, 100 us, later.
    let (hold, _) = run_rule(RefractoryRule::Hold, 350);
    assert!(near(&hold[..5], &[100, 550, 1000, 1450, 1900]), "{hold:?}");
}

#[test]
fn references_start_where_they_are_told() {
    let pattern = Pattern { start: Start::Phase, ..Pattern::default() };
    let ramp = |t: f64| (2.0 * t).exp();
    let first = |pattern| {
        let mut emulator = emulator(64, 64, &SensorConfig { pattern, ..Default::default() });
        let events = run(&mut emulator, &grid(10_000, 90_000), ramp);
        events.iter().map(|event| event.t as f64).collect::<Vec<_>>()
    };
    // 0.18 of change: nobody is a threshold away that started at the signal.
    assert!(first(Pattern::default()).is_empty());
    let phases = first(pattern);
    // A phase is uniform over 0.4; an ON event needs the last 0.18 of it, and comes at a uniform time.
    assert!(meets(phases.len(), 4096.0 * 0.18 / 0.4, 0.0), "{}", phases.len());
    let mean = phases.iter().sum::<f64>() / phases.len() as f64;
    assert!(
        (mean - 45_000.0).abs() < 4.5 * 90_000.0 / 12_f64.sqrt() / (phases.len() as f64).sqrt(),
        "{mean}"
    );
}

#[test]
fn latency_delays_and_dim_light_delays_more() {
    let readout = Readout { latency_us: 100.0, latency_light_us: 50.0, ..Readout::default() };
    let step = |light: f64, readout| {
        let mut emulator = emulator(1, 1, &SensorConfig { readout, ..Default::default() });
        let events = run(&mut emulator, &grid(1000, 10_000), |t| light * (30.0 * t).exp());
        events.iter().map(|event| event.t).collect::<Vec<_>>()
    };
    let (plain, bright, dim) = (step(0.5, Readout::default()), step(0.5, readout), step(0.05, readout));
    // 100 us, and 50 us over a light of 0.5 e^0.2.
    assert!((180..=183).contains(&(bright[0] - plain[0])), "{plain:?} {bright:?}");
    let dim_delay = dim[0] - step(0.05, Readout::default())[0];
    assert!((850..1100).contains(&dim_delay), "{dim_delay}");
    // Events are not lost: those of the end are still on their way.
    assert!(bright.len() + 1 >= plain.len());
}

/// Bytes of a run of frames through `config`, in pushes at `times`.
fn stream(config: &EmulatorConfig, frames: &[Vec<f32>], times: &[i64]) -> Vec<Vec<Event>> {
    let mut emulator = EventEmulator::new(config.clone()).unwrap();
    let mut out = vec![Vec::new(); config.batch];
    for (frame, t_us) in frames.iter().zip(times) {
        emulator.push_into(&Frames::linear(frame), *t_us, &mut out).unwrap();
    }
    out
}

fn moving(width: u32, height: u32, count: usize, seed: u32) -> Vec<Vec<f32>> {
    (0..count)
        .map(|k| {
            (0..width * height)
                .map(|i| {
                    let (x, y) = (i % width, i / width);
                    let phase = 0.13 * f64::from(x) + 0.07 * f64::from(y) + 0.4 * k as f64 + f64::from(seed);
                    (0.5 + 0.45 * phase.sin()) as f32
                })
                .collect()
        })
        .collect()
}

#[test]
fn nothing_depends_on_threads_or_on_the_rest_of_the_batch() {
    let (width, height) = (160, 130);
    let times = grid(1700, 17_000);
    let scenes: Vec<_> = (0..3).map(|seed| moving(width, height, times.len(), seed)).collect();
    for name in ["ideal", "v2e-noisy", "evis", "gen4-like", "davis346"] {
        let sensor = SensorConfig::preset(name).unwrap();
        let config = |batch, threads| EmulatorConfig {
            width,
            height,
            batch,
            threads,
            seed: 9,
            sensor: sensor.clone(),
            ..Default::default()
        };
        let together: Vec<Vec<f32>> =
            (0..times.len()).map(|k| scenes.iter().flat_map(|scene| scene[k].clone()).collect()).collect();
        let one = stream(&config(3, 1), &together, &times);
        assert!(one.iter().map(Vec::len).sum::<usize>() > 1000, "{name}");
        assert_eq!(stream(&config(3, 2), &together, &times), one, "{name}: threads");
        // The first environment alone has the same key.
        assert_eq!(stream(&config(1, 1), &scenes[0], &times)[0], one[0], "{name}: batch");
        // Another seed, canary: noise differs where there is any.
        let other = stream(&EmulatorConfig { seed: 10, ..config(3, 1) }, &together, &times);
        assert_eq!(other == one, name == "ideal", "{name}: seed");
    }
}

#[test]
fn a_saved_state_goes_on_as_if_nothing_had_happened() {
    let (width, height) = (70, 20);
    let times = grid(1300, 26_000);
    let frames = moving(width, height, times.len(), 0);
    for preset in &PRESETS {
        let config = EmulatorConfig { width, height, sensor: preset.sensor(), seed: 3, ..Default::default() };
        let whole = stream(&config, &frames, &times).remove(0);
        let mut first = EventEmulator::new(config.clone()).unwrap();
        let mut second = EventEmulator::new(EmulatorConfig { threads: 2, ..config.clone() }).unwrap();
        let mut events = Vec::new();
        for (k, (frame, t_us)) in frames.iter().zip(&times).enumerate() {
            if k == 9 {
                second.restore(&first.state()).unwrap();
                assert_eq!(second.state(), first.state());
            }
            let emulator = if k < 9 { &mut first } else { &mut second };
            events.extend(emulator.push(&Frames::linear(frame), *t_us).unwrap().remove(0));
        }
        assert_eq!(events, whole, "{}", preset.name);
        // What is no state of this emulator is refused.
        let state = first.state();
        assert!(first.restore(&state[..state.len() - 1]).is_err());
        assert!(first.restore(&[]).is_err());
        let mut other = EventEmulator::new(EmulatorConfig { seed: 4, ..config }).unwrap();
        assert!(other.restore(&state).is_err());
    }
}

#[test]
fn a_reset_environment_begins_anew_and_the_others_go_on() {
    let (width, height) = (40, 30);
    let sensor = SensorConfig::preset("v2e-noisy").unwrap();
    let config = EmulatorConfig { width, height, batch: 2, sensor, ..Default::default() };
    let times = grid(1500, 15_000);
    let scene = moving(width, height, times.len(), 1);
    let both: Vec<Vec<f32>> = scene.iter().map(|frame| [frame.clone(), frame.clone()].concat()).collect();
    let undisturbed = stream(&config, &both, &times);
    let mut emulator = EventEmulator::new(config).unwrap();
    let mut out = vec![Vec::new(); 2];
    for (k, (frame, t_us)) in both.iter().zip(&times).enumerate() {
        if k == 5 {
            emulator.reset(Some(&[1])).unwrap();
        }
        let before = out[1].len();
        emulator.push_into(&Frames::linear(frame), *t_us, &mut out).unwrap();
        assert!(k != 5 || out[1].len() == before, "a first frame makes no events");
    }
    assert_eq!(out[0], undisturbed[0]);
    assert_ne!(out[1], undisturbed[1]);
    assert!(emulator.reset(Some(&[2])).unwrap_err().to_string().contains('2'));
    // All reset: time may start again.
    emulator.reset(None).unwrap();
    emulator.push(&Frames::linear(&both[0]), 0).unwrap();
}

#[test]
fn nan_keeps_a_pixels_state_and_is_counted() {
    for name in ["ideal", "v2e", "openeb", "davis346"] {
        let mut emulator = emulator(2, 1, &SensorConfig::preset(name).unwrap());
        let mut push = |values: [f32; 2], t_us: i64| {
            let events = emulator.push(&Frames::linear(&values), t_us).unwrap().remove(0);
            (events, emulator.report().unknown)
        };
        assert_eq!(push([0.5, f32::NAN], 0).1, 1, "{name}");
        let (events, unknown) = push([f32::NAN, 0.5], 1000);
        assert!(unknown == 1 && events.is_empty(), "{name}: {events:?}");
        // As bright as before: nothing has happened to either.
        assert!(push([0.5, 0.5], 2000).0.is_empty(), "{name}");
    }
    // Canary: 0 in the place of NaN fires.
    let mut emulator = emulator(1, 1, &SensorConfig::default());
    emulator.push(&Frames::linear(&[0.5]), 0).unwrap();
    assert!(!emulator.push(&Frames::linear(&[0.0]), 1).unwrap()[0].is_empty());
}

#[test]
fn bad_input_is_named_and_changes_nothing() {
    for name in ["ideal", "v2e", "davis346"] {
        let mut emulator = emulator(3, 2, &SensorConfig::preset(name).unwrap());
        let good = [0.5_f32; 6];
        emulator.push(&Frames::linear(&good), 1000).unwrap();
        let state = emulator.state();
        for (bad, said) in [(f32::INFINITY, "inf"), (-0.25, "-0.25"), (f32::NEG_INFINITY, "-inf")] {
            let mut frame = good;
            frame[4] = bad;
            let error = emulator.push(&Frames::linear(&frame), 2000).unwrap_err().to_string();
            assert!(error.contains(said) && error.contains("(1, 1)"), "{name}: {error}");
        }
        for t_us in [1000, 0, i64::MIN, i64::MAX] {
            let error = emulator.push(&Frames::linear(&good), t_us).unwrap_err().to_string();
            assert!(error.contains(&t_us.to_string()), "{error}");
        }
        let error = emulator.push(&Frames::linear(&good[..5]), 2000).unwrap_err().to_string();
        assert!(error.contains('5') && error.contains('6'), "{error}");
        assert!(emulator.push(&Frames::u8(&[0; 6], Transfer::Gamma(0.0)), 2000).is_err());
        assert!(emulator.push(&Frames { channels: 2, ..Frames::linear(&[0.5; 12]) }, 2000).is_err());
        assert_eq!(emulator.state(), state, "{name}");
        emulator.push(&Frames::linear(&good), 2000).unwrap();
    }
    let config = EmulatorConfig::default;
    for bad in [
        EmulatorConfig { width: 0, ..config() },
        EmulatorConfig { height: 70_000, ..config() },
        EmulatorConfig { batch: 0, ..config() },
        EmulatorConfig { reference_luminance: 0.0, ..config() },
        EmulatorConfig { sensor: SensorConfig { threshold_on: 0.0, ..Default::default() }, ..config() },
        EmulatorConfig {
            sensor: SensorConfig {
                photoreceptor: Photoreceptor { cutoff_hz: 600_000.0, ..Photoreceptor::default() },
                ..Default::default()
            },
            ..config()
        },
    ] {
        assert!(EventEmulator::new(bad).is_err());
    }
}

#[test]
fn integers_light_and_logarithms_agree() {
    let (width, height) = (96, 40);
    let times = grid(1000, 30_000);
    let codes: Vec<Vec<u8>> = moving(width, height, times.len(), 2)
        .iter()
        .map(|frame| frame.iter().map(|light| (light * 255.0) as u8).collect())
        .collect();
    for transfer in [Transfer::Srgb, Transfer::Rec709, Transfer::Gamma(2.2), Transfer::Linear] {
        let light = |code: u8| transfer.light(f64::from(code) / 255.0) as f32;
        let runs = |push: &dyn Fn(&mut EventEmulator, usize) -> Vec<Event>, sensor: &SensorConfig| {
            let mut emulator = emulator(width, height, sensor);
            (0..times.len()).flat_map(|k| push(&mut emulator, k)).collect::<Vec<_>>()
        };
        for name in ["ideal", "v2e"] {
            let sensor = SensorConfig::preset(name).unwrap();
            let bytes = runs(
                &|emulator, k| emulator.push(&Frames::u8(&codes[k], transfer), times[k]).unwrap().remove(0),
                &sensor,
            );
            let words = runs(
                &|emulator, k| {
                    let frame: Vec<u16> = codes[k].iter().map(|code| u16::from(*code) * 257).collect();
                    emulator.push(&Frames::u16(&frame, transfer), times[k]).unwrap().remove(0)
                },
                &sensor,
            );
            let floats = runs(
                &|emulator, k| {
                    let frame: Vec<f32> = codes[k].iter().map(|code| light(*code)).collect();
                    emulator.push(&Frames::linear(&frame), times[k]).unwrap().remove(0)
                },
                &sensor,
            );
            assert!(bytes.len() > 3000, "{}", bytes.len());
            assert_eq!(bytes, words, "{transfer:?} {name}");
            if name == "ideal" {
                // Integers that come back to a level are on it; light misses some of these by a rounding.
                let of = |events: &[Event]| {
                    let mut pixels = vec![Vec::new(); (width * height) as usize];
                    for event in events {
                        pixels[(u32::from(event.y) * width + u32::from(event.x)) as usize]
                            .push((event.t, event.p));
                    }
                    pixels
                };
                let (integers, light) = (of(&bytes), of(&floats));
                let apart: Vec<usize> = (0..integers.len()).filter(|p| integers[*p] != light[*p]).collect();
                for &pixel in &apart {
                    let mut codes: Vec<u8> = codes.iter().map(|frame| frame[pixel]).collect();
                    codes.dedup();
                    let count = codes.len();
                    codes.sort_unstable();
                    codes.dedup();
                    assert!(codes.len() < count, "{transfer:?}: pixel {pixel} differs, and never comes back");
                    assert!(integers[pixel].len() >= light[pixel].len(), "{transfer:?}: pixel {pixel}");
                }
                assert!(apart.len() * 20 < integers.len(), "{transfer:?}: {} pixels differ", apart.len());
            } else {
                assert!(bytes == floats, "{transfer:?} {name}");
            }
            let colours = runs(
                &|emulator, k| {
                    let frame: Vec<u8> = codes[k].iter().flat_map(|code| [*code; 3]).collect();
                    emulator.push(&Frames::u8(&frame, transfer).rgb(), times[k]).unwrap().remove(0)
                },
                &sensor,
            );
            // Three weights round otherwise than one.
            let share = colours.len() as f64 / floats.len() as f64;
            assert!((share - 1.0).abs() < 0.005, "{share}");
        }
        let logs = runs(
            &|emulator, k| {
                let frame: Vec<f32> = codes[k].iter().map(|code| (light(*code) + 1e-3).ln()).collect();
                emulator.push(&Frames::log(&frame), times[k]).unwrap().remove(0)
            },
            &SensorConfig::default(),
        );
        let light = runs(
            &|emulator, k| {
                let frame: Vec<f32> = codes[k].iter().map(|code| light(*code)).collect();
                emulator.push(&Frames::linear(&frame), times[k]).unwrap().remove(0)
            },
            &SensorConfig::default(),
        );
        assert!(logs.len().abs_diff(light.len()) < 20);
    }
}

#[test]
fn the_rules_of_peers_are_here_by_name() {
    // Three thresholds in one interval of 1000 us.
    let run_times = |times, trigger| {
        let sensor = SensorConfig { times, trigger, ..Default::default() };
        let mut emulator = emulator(2, 1, &sensor);
        emulator.push(&Frames::linear(&[1.0, 1.0]), 0).unwrap();
        let events = emulator.push(&Frames::linear(&[1.9, 1.3]), 1000).unwrap().remove(0);
        events.iter().map(|event| (event.t, event.x)).collect::<Vec<_>>()
    };
    let crossing = TriggerRule::Crossing;
    assert_eq!(run_times(Times::Sample, crossing), [(1000, 0), (1000, 0), (1000, 0), (1000, 1)]);
    assert_eq!(run_times(Times::Even, crossing), [(333, 0), (666, 0), (1000, 0), (1000, 1)]);
    // Shared: the pixel with one event gets the first of the frame's three instants.
    assert_eq!(run_times(Times::Shared, crossing), [(333, 0), (333, 1), (666, 0), (1000, 0)]);
    assert_eq!(run_times(Times::Shared, TriggerRule::Latch), [(1000, 0), (1000, 1)]);
    // v2e's filter: one Euler step with the end sample.
    let photoreceptor = Photoreceptor {
        cutoff_hz: 50.0,
        filter: FilterRule::Euler,
        curve: Curve::Linlog,
        ..Photoreceptor::default()
    };
    let sensor =
        SensorConfig { threshold_on: 0.01, photoreceptor, times: Times::Sample, ..Default::default() };
    let mut emulator = emulator(1, 1, &sensor);
    emulator.push(&Frames::linear(&[0.5]), 0).unwrap();
    let events = emulator.push(&Frames::linear(&[1.0]), 1000).unwrap().remove(0);
    let expected = 2_f64.ln() * std::f64::consts::TAU * 50.0 * 1e-3 / 0.01;
    assert_eq!(events.len(), expected as usize);
}

#[test]
fn noise_says_what_it_does_to_the_reference() {
    // The signal rests half a threshold above the reference; a shot event that takes the reference along moves it there.
    let run_reference = |reference| {
        let noise = Noise { shot_hz: 500.0, reference, ..Noise::default() };
        let mut emulator = emulator(30, 30, &SensorConfig { noise, ..Default::default() });
        let light = |t: f64| {
            if t < 0.01 {
                1.0
            } else if t < 0.1 {
                1.105
            } else {
                1.24
            }
        };
        let times = grid(1000, 110_000);
        let mut events = Vec::new();
        for t_us in &times {
            let frame = vec![light(*t_us as f64 * 1e-6) as f32; 900];
            events.extend(emulator.push(&Frames::linear(&frame), *t_us).unwrap().remove(0));
        }
        let noise_only = 500.0 * 900.0 * 0.11;
        events.len() as f64 - noise_only
    };
    // ln 1.24 is 0.215: a threshold above the start, but not above 1.105.
    assert!((run_reference(NoiseReference::Keep) - 900.0).abs() < 5.0 * 50_000_f64.sqrt());
    assert!(run_reference(NoiseReference::Signal).abs() < 5.0 * 50_000_f64.sqrt());
}

#[test]
fn davis_presets_fire_as_their_constants_say() {
    // A strong ramp: as many events as the drift crosses thresholds.
    let mut emulator = emulator(40, 40, &SensorConfig::preset("davis346").unwrap());
    let end = 0.1;
    let events = run(&mut emulator, &grid(1000, 100_000), |t| 0.2 * (8.0 * t).exp());
    let (low, high) = (255.0 * 0.2, 255.0 * 0.2 * (8.0_f64 * end).exp());
    let expected = 5.265 * ((high + 20.0) / (low + 20.0)).ln();
    let mean = events.iter().map(|event| if event.p == 1 { 1.0 } else { -1.0 }).sum::<f64>() / 1600.0;
    // Short of the integral by the mean of what has not fired yet.
    assert!((mean - (expected - 0.5)).abs() < 0.5, "{mean} {expected}");
}

#[test]
fn an_unknown_logarithm_is_unknown_to_every_sensor() {
    let refractory = Refractory { period_us: 100, ..Default::default() };
    for sensor in [SensorConfig::default(), SensorConfig { refractory, ..Default::default() }] {
        let mut emulator = emulator(2, 1, &sensor);
        let mut push =
            |logs: [f32; 2], t_us| emulator.push(&Frames::log(&logs), t_us).unwrap().remove(0).len();
        assert_eq!((push([-1.0; 2], 0), push([f32::NAN, -1.0], 1_000), push([-1.0; 2], 2_000)), (0, 0, 0));
        assert_eq!(push([-1.3, f32::NAN], 3_000), 1, "canary: a logarithm that is known");
        assert_eq!(emulator.total_report().unknown, 2);
    }
}

#[test]
fn sizes_that_no_machine_holds_are_refused_with_the_limit() {
    let refused = |config: EmulatorConfig| EventEmulator::new(config).map(|_| ()).unwrap_err().to_string();
    let small = EmulatorConfig { width: 8, height: 8, ..EmulatorConfig::default() };
    let error = refused(EmulatorConfig { batch: 1 << 31, ..small.clone() });
    assert!(error.contains("2147483648") && error.contains("between 1 and 65536"), "{error}");
    let error = refused(EmulatorConfig { threads: 5000, ..small.clone() });
    assert!(error.contains("5000") && error.contains("at most 1024"), "{error}");
    let error = refused(EmulatorConfig { width: 65_536, height: 65_536, batch: 60_000, ..small.clone() });
    assert!(error.contains("memory"), "{error}");
    let mut emulator = EventEmulator::new(small).unwrap();
    let light = [1.0; 64];
    let frames = Frames { data: FrameData::Linear(&light), channels: 1 };
    let error = emulator.push(&frames, 9_000_000_000_000_000).unwrap_err().to_string();
    assert!(error.contains("at most 4503599627370496 microseconds from 0"), "{error}");
    emulator.push(&frames, 4_503_599_627_370_496).unwrap();
}
