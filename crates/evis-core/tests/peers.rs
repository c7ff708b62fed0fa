//! Presets against their sources: each peer's formula, written down again in f64 from its published code, on random frames.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use evis_core::emulator::parts::FixedPattern;
use evis_core::random::Key;
use evis_core::sensor::{FilterRule, NoiseReference, Pattern, Refractory, RefractoryRule};
use evis_core::{
    Cause, EmulatorConfig, Event, EventEmulator, Frames, SensorConfig, Times, Transfer, TriggerRule,
};

const WIDTH: usize = 64;
const PIXELS: usize = 40 * WIDTH;
const SEED: u64 = 7;

/// Uniform in [0, 1), in no order.
struct Dice(u64);

impl Dice {
    fn roll(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Eight-bit frames: pixels wander, some jump, some stay; never black where `least` is above 0.
fn frames(count: usize, least: i32, seed: u64) -> Vec<Vec<u8>> {
    let mut dice = Dice(seed);
    let mut now: Vec<i32> =
        (0..PIXELS).map(|_| least + (dice.roll() * f64::from(256 - least)) as i32).collect();
    let mut all = Vec::new();
    for _ in 0..count {
        for (i, value) in now.iter_mut().enumerate() {
            *value = match i % 4 {
                0 => *value,
                1 if dice.roll() < 0.2 => (dice.roll() * 256.0) as i32,
                _ => *value + (dice.roll() * 31.0) as i32 - 15,
            }
            .clamp(least, 255);
        }
        all.push(now.iter().map(|value| *value as u8).collect());
    }
    all
}

/// Times that are not even.
fn times(count: usize) -> Vec<i64> {
    let mut dice = Dice(99);
    let mut t = 0;
    (0..count)
        .map(|_| {
            let now = t;
            t += 700 + (dice.roll() * 900.0) as i64;
            now
        })
        .collect()
}

/// An event of one pixel: time, whether it is ON, whether light is its cause.
type Fired = (i64, bool, bool);

/// What the product fires, per pixel.
fn ours(sensor: &SensorConfig, frames: &[Vec<u8>], times: &[i64]) -> Vec<Vec<Fired>> {
    let mut emulator = EventEmulator::new(EmulatorConfig {
        width: WIDTH as u32,
        height: (PIXELS / WIDTH) as u32,
        seed: SEED,
        sensor: sensor.clone(),
        threads: 1,
        causes: true,
        ..Default::default()
    })
    .unwrap();
    let mut all = vec![Vec::new(); PIXELS];
    for (frame, t_us) in frames.iter().zip(times) {
        let events: Vec<Event> =
            emulator.push(&Frames::u8(frame, Transfer::Linear), *t_us).unwrap().remove(0);
        for (event, cause) in events.iter().zip(&emulator.causes()[0]) {
            let pixel = usize::from(event.y) * WIDTH + usize::from(event.x);
            all[pixel].push((event.t, event.p == 1, *cause == Cause::Signal as u8));
        }
    }
    all
}

/// Each pixel's thresholds, ON and OFF, which peers draw in their own ways.
fn thresholds(sensor: &SensorConfig) -> Vec<(f64, f64)> {
    let frozen = FixedPattern::draw(sensor, Key::new(SEED, 0, 0), 0, PIXELS);
    frozen.on.iter().zip(&frozen.off).map(|(on, off)| (f64::from(*on), f64::from(*off))).collect()
}

/// Share of pixels with the same events, in number, order and polarity, and times that are at most `slack_us` apart.
fn alike(got: &[Vec<Fired>], expected: &[Vec<(f64, bool)>], slack_us: f64) -> f64 {
    let same = got.iter().zip(expected).filter(|(got, expected)| {
        got.len() == expected.len()
            && got.iter().zip(*expected).all(|(a, b)| a.1 == b.1 && (a.0 as f64 - b.0).abs() <= slack_us)
    });
    same.count() as f64 / got.len() as f64
}

fn total<T>(events: &[Vec<T>]) -> usize {
    events.iter().map(Vec::len).sum()
}

/// `print_event.cpp` and `generate_events.cpp` of PIX2NVS with d = 1, blocks of 1 and a threshold that does not adapt; its
/// first interval is the one from frame 1 to frame 2, and begins at one frame's duration: here at 0.
fn pix2nvs(logs: &[Vec<f32>], times: &[i64], threshold: f32, n_max: i32) -> Vec<Vec<(f64, bool)>> {
    let mut all = vec![Vec::new(); logs[0].len()];
    for k in 1..logs.len() {
        let gap = (times[k] - times[k - 1]) as f64;
        for (pixel, events) in all.iter_mut().enumerate() {
            let delta = logs[k][pixel] - logs[k - 1][pixel];
            if delta.abs() > threshold {
                let number = ((delta.abs() / threshold) as i32).min(n_max);
                for e in 0..number {
                    let part = f64::from(e + 1) * f64::from(threshold) / f64::from(delta.abs());
                    events.push((times[k - 1] as f64 + gap * part, delta > 0.0));
                }
            }
        }
    }
    all
}

#[test]
fn pix2nvs_fires_where_its_source_does() {
    let sensor = SensorConfig::preset("pix2nvs").unwrap();
    let (frames, times) = (frames(40, 1, 11), times(40));
    let logs: Vec<Vec<f32>> =
        frames.iter().map(|frame| frame.iter().map(|code| f32::from(*code).ln()).collect()).collect();
    let expected = pix2nvs(&logs, &times, 0.4, 5);
    let got = ours(&sensor, &frames, &times);
    assert!(total(&expected) > 5000, "{}", total(&expected));
    assert_eq!(alike(&got, &expected, 1.0), 1.0);
    // Canaries: evenly spread, and with a reference that keeps its residual.
    let even = SensorConfig { times: Times::Even, ..sensor.clone() };
    assert!(alike(&ours(&even, &frames, &times), &expected, 1.0) < 0.9);
    let kept = SensorConfig { trigger: TriggerRule::Crossing, ..sensor.clone() };
    assert!(alike(&ours(&kept, &frames, &times), &expected, 1.0) < 0.5);
    // A change of exactly a threshold is none; twice that is two.
    let sensor = SensorConfig {
        threshold_on: std::f32::consts::LN_2,
        threshold_off: std::f32::consts::LN_2,
        ..SensorConfig::preset("pix2nvs").unwrap()
    };
    let mut emulator =
        EventEmulator::new(EmulatorConfig { width: 4, height: 1, sensor, ..Default::default() }).unwrap();
    let next = [2.0, 2.000_001, 0.5, 4.0];
    emulator.push(&Frames::linear(&[1.0; 4]), 0).unwrap();
    let events = emulator.push(&Frames::linear(&next), 1000).unwrap().remove(0);
    let logs = vec![vec![0.0; 4], next.iter().map(|light: &f32| light.ln()).collect()];
    let expected = pix2nvs(&logs, &[0, 1000], std::f32::consts::LN_2, 5);
    let counts: Vec<usize> = (0..4).map(|x| events.iter().filter(|event| event.x == x).count()).collect();
    assert_eq!(counts, expected.iter().map(Vec::len).collect::<Vec<_>>());
    assert_eq!(counts, [0, 1, 0, 2]);
}

/// The two kernels of OpenEB's batch simulator, the cutoff kernels and the event kernels, without leak and shot noise.
fn openeb(
    frames: &[Vec<u8>],
    times: &[i64],
    thresholds: &[(f64, f64)],
    (cutoff_hz, period_us): (f64, i64),
) -> Vec<Vec<(f64, bool)>> {
    let rate = std::f64::consts::TAU * cutoff_hz;
    let log = |code: u8| (f64::from(code) / 255.0 + 1e-7).ln();
    let fire = |pixel: usize| {
        let (mut state0, mut state1) = (log(frames[0][pixel]), log(frames[0][pixel]));
        // Pictures of logarithms are float32.
        let mut it = state1 as f32;
        let mut reference = f64::from(it);
        let (on, off) = thresholds[pixel];
        let (mut events, mut last_ts) = (Vec::new(), 0_i64);
        for k in 1..frames.len() {
            let code = frames[k][pixel];
            let delta_t = (times[k] - times[k - 1]) as f64;
            let eps = ((f64::from(code) + 20.0) / 275.0 * (1e-6 * delta_t) * rate).clamp(0.0, 1.0);
            state0 = (1.0 - eps) * state0 + eps * log(code);
            state1 = (1.0 - eps) * state1 + eps * state0;
            let itdt = state1 as f32;
            let (polarity, c) = if itdt >= it { (1.0, on) } else { (-1.0, off) };
            let (from, to) = (f64::from(it), f64::from(itdt));
            if (to - reference).abs() > c {
                let mut level = reference;
                loop {
                    level += polarity * c;
                    let inside = (polarity > 0.0 && level > from && level <= to)
                        || (polarity < 0.0 && level < from && level >= to);
                    if !inside {
                        break;
                    }
                    let ts = times[k - 1] + ((level - from) * delta_t / (to - from)) as i64;
                    if ts - last_ts >= period_us || last_ts == 0 {
                        events.push((ts as f64, polarity > 0.0));
                        last_ts = ts;
                    }
                    reference = level;
                }
            }
            it = itdt;
        }
        events
    };
    (0..PIXELS).map(fire).collect()
}

#[test]
fn openeb_fires_where_its_source_does() {
    let preset = SensorConfig::preset("openeb").unwrap();
    let (frames, times) = (frames(60, 0, 12), times(60));
    // Dead pixels have thresholds of 1000 there, "crazy" ones of 0.001.
    let own = thresholds(&preset);
    let dead = own.iter().filter(|(on, _)| on.is_infinite()).count();
    assert!((3..40).contains(&dead), "{dead}");
    let many = Pattern { sensitive_share: 0.02, ..preset.pattern };
    for (cutoff_hz, period_us) in [(450.0, 10), (30.0, 10), (450.0, 300)] {
        let mut sensor = preset.clone();
        sensor.photoreceptor.cutoff_hz = cutoff_hz;
        sensor.refractory.period_us = period_us;
        sensor.pattern = many;
        let own = thresholds(&sensor);
        let crazy = own.iter().filter(|(on, off)| (*on, *off) == (f64::from(1e-3_f32), f64::from(1e-3_f32)));
        assert!((20..90).contains(&crazy.count()));
        let expected = openeb(&frames, &times, &own, (f64::from(cutoff_hz), i64::from(period_us)));
        let got = ours(&sensor, &frames, &times);
        assert!(total(&expected) > 20_000, "{}", total(&expected));
        // Where the filtered signal moves little, its rounding is some microseconds.
        let share = alike(&got, &expected, 5.0);
        // Pixels that fire a thousand times and more wander by a rounding in some of them.
        let calm: Vec<usize> = (0..PIXELS).filter(|i| own[*i].0 > 0.002).collect();
        let of = |events: &[Vec<Fired>]| calm.iter().map(|i| events[*i].clone()).collect::<Vec<_>>();
        let calm_expected: Vec<_> = calm.iter().map(|i| expected[*i].clone()).collect();
        let calm_share = alike(&of(&got), &calm_expected, 5.0);
        // A long refractory period ends between two microseconds now and then.
        let least = if period_us > 100 { 0.997 } else { 0.999 };
        assert!(share > 0.97 && calm_share >= least, "{cutoff_hz} {period_us}: {share} {calm_share}");
        let (a, b) = (total(&got) as f64, total(&expected) as f64);
        assert!((a / b - 1.0).abs() < 1e-3, "{a} {b}");
        // Canaries: one pole, a bandwidth that light does not change, the exact answer.
        for wrong in 0..3 {
            let mut other = sensor.clone();
            match wrong {
                0 => other.photoreceptor.order = 1,
                1 => other.photoreceptor.bandwidth = Default::default(),
                _ => other.photoreceptor.filter = FilterRule::Exact,
            }
            assert!(alike(&ours(&other, &frames, &times), &expected, 5.0) < 0.8, "{wrong}");
        }
    }
}

/// generate_events of v2e: lin-log, low-pass, leak without jitter, counts, shared times, the refractory filter where it is
/// on, and light that is memorised after a shot event; `shots` says in which frames a pixel has one.
fn v2e(
    sensor: &SensorConfig,
    frames: &[Vec<u8>],
    times: &[i64],
    leak_hz: f64,
    shots: impl Fn(usize, usize) -> bool,
) -> Vec<Vec<(f64, bool)>> {
    let lin_log = |code: u8| {
        let x = f64::from(code);
        let y = if x <= 20.0 { x * (20.0_f64.ln() / 20.0) } else { x.ln() };
        f64::from(((y * 1e8).round() / 1e8) as f32)
    };
    let own = thresholds(sensor);
    let tau = 1.0 / (std::f64::consts::TAU * f64::from(sensor.photoreceptor.cutoff_hz));
    let period = f64::from(sensor.refractory.period_us) * 1e-6;
    let mut lp: Vec<f64> = frames[0].iter().map(|code| lin_log(*code)).collect();
    let mut base = lp.clone();
    let mut stamps = vec![-period; PIXELS];
    let mut all = vec![Vec::new(); PIXELS];
    for k in 1..frames.len() {
        let (t, delta) = (times[k] as f64 * 1e-6, (times[k] - times[k - 1]) as f64 * 1e-6);
        let mut counts = vec![0_i64; PIXELS];
        for i in 0..PIXELS {
            let eps = if sensor.photoreceptor.cutoff_hz > 0.0 {
                ((f64::from(frames[k][i]) + 20.0) / 275.0 * (delta / tau)).min(1.0)
            } else {
                1.0
            };
            lp[i] = (1.0 - eps) * lp[i] + eps * lin_log(frames[k][i]);
            base[i] -= delta * leak_hz * own[i].0;
            let diff = lp[i] - base[i];
            counts[i] = if diff > 0.0 { (diff / own[i].0).floor() } else { (diff / own[i].1).ceil() } as i64;
        }
        let most = counts.iter().map(|count| count.abs()).max().unwrap().max(1);
        let step = delta / most as f64;
        for i in 0..PIXELS {
            let mut kept = 0;
            for e in 1..=counts[i].abs() {
                let ts = t - delta + step * e as f64;
                if period > step {
                    // On the product's clock of whole microseconds.
                    if ts - stamps[i] <= period {
                        continue;
                    }
                    stamps[i] = (ts * 1e6 + 1e-6).floor() * 1e-6;
                }
                kept += 1;
                all[i].push((ts * 1e6, counts[i] > 0));
            }
            base[i] += kept as f64 * if counts[i] > 0 { own[i].0 } else { -own[i].1 };
            if shots(k, i) {
                base[i] = lp[i];
            }
        }
    }
    all
}

/// v2e with leak and shot noise as asked, without what it draws per frame.
fn plain_v2e(name: &str) -> SensorConfig {
    let mut sensor = SensorConfig::preset(name).unwrap();
    sensor.noise.leak_jitter = 0.0;
    sensor.noise.leak_spread_decades = 0.0;
    sensor
}

#[test]
fn v2e_fires_where_its_source_does() {
    // More than two events of some pixel in every frame: the refractory filter is on throughout.
    let (frames, times) = (frames(50, 0, 13), times(50));
    for (name, leak_hz, period_us) in
        [("v2e-clean", 0.0, 0), ("v2e", 20.0, 0), ("v2e-noisy", 0.1, 0), ("v2e", 0.01, 473)]
    {
        let mut sensor = plain_v2e(name);
        sensor.noise.shot_hz = 0.0;
        sensor.noise.leak_hz = leak_hz;
        sensor.refractory = Refractory { period_us, rule: RefractoryRule::Defer };
        let expected = v2e(&sensor, &frames, &times, f64::from(leak_hz), |_, _| false);
        let got = ours(&sensor, &frames, &times);
        assert!(total(&expected) > 5000, "{name}: {}", total(&expected));
        let share = alike(&got, &expected, 1.001);
        assert!(share >= 0.999, "{name} {period_us}: {share}");
        // Canary: each event at its own crossing.
        let other = SensorConfig { times: Times::Crossing, ..sensor };
        assert!(alike(&ours(&other, &frames, &times), &expected, 1.001) < 0.5);
    }
}

#[test]
fn v2e_memorises_light_after_a_shot_event() {
    let (frames, times) = (frames(50, 0, 14), times(50));
    let mut sensor = plain_v2e("v2e-noisy");
    sensor.noise.leak_hz = 0.0;
    // Some three per pixel.
    sensor.noise.shot_hz = 60.0;
    assert_eq!(sensor.noise.reference, NoiseReference::Signal);
    let run = |sensor: &SensorConfig| {
        let got = ours(sensor, &frames, &times);
        // A shot event of the interval that frame k ends.
        let struck = |k: usize, i: usize| {
            got[i].iter().any(|(t, _, signal)| !signal && *t > times[k - 1] && *t <= times[k])
        };
        let expected = v2e(sensor, &frames, &times, 0.0, struck);
        let light: Vec<Vec<Fired>> =
            got.iter().map(|events| events.iter().copied().filter(|event| event.2).collect()).collect();
        (total(&got) - total(&light), alike(&light, &expected, 1.001))
    };
    let (shots, share) = run(&sensor);
    assert!(shots > PIXELS && share >= 0.999, "{shots} {share}");
    // Canary: what the preset did before, a reference that stays.
    sensor.noise.reference = NoiseReference::Keep;
    let (shots, share) = run(&sensor);
    assert!(shots > PIXELS && share < 0.7, "{shots} {share}");
}

#[test]
fn the_leak_of_v2e_has_its_mean() {
    // noise_rate_array is 10^(0.1 n), and is not divided by its mean; measured over normal numbers of another generator.
    let mut dice = Dice(5);
    let mut normal = || (0..12).map(|_| dice.roll()).sum::<f64>() - 6.0;
    let count = 400_000;
    let mean = (0..count).map(|_| 10_f64.powf(0.1 * normal())).sum::<f64>() / f64::from(count);
    for (name, nominal) in [("v2e", 0.01), ("v2e-noisy", 0.1)] {
        let sensor = SensorConfig::preset(name).unwrap();
        let frozen = FixedPattern::draw(&sensor, Key::new(SEED, 0, 0), 0, 200_000);
        let rates = frozen.slope.iter().zip(&frozen.on).map(|(slope, on)| f64::from(slope * 1e6 / on));
        let rate = rates.sum::<f64>() / 200_000.0;
        assert!((rate / nominal / mean - 1.0).abs() < 4e-3, "{name}: {rate}, {mean}");
        // Canary: the nominal rate is not it.
        assert!((rate / nominal - 1.0).abs() > 0.02);
    }
}

/// `imageCallback` of ESIM, with thresholds that the caller draws.
fn esim(
    frames: &[Vec<u8>],
    times: &[i64],
    eps: f32,
    thresholds: impl Fn(usize, usize) -> (f64, f64),
) -> Vec<Vec<(f64, bool)>> {
    let log = |code: u8| f64::from((eps + f32::from(code) / 255.0).ln());
    let fire = |pixel: usize| {
        let mut it = log(frames[0][pixel]);
        let mut reference = it;
        let mut events = Vec::new();
        for k in 1..frames.len() {
            let itdt = log(frames[k][pixel]);
            if (itdt - it).abs() > 1e-6 {
                let (on, off) = thresholds(k, pixel);
                let (polarity, c) = if itdt >= it { (1.0, on) } else { (-1.0, off) };
                let mut level = reference;
                loop {
                    level += polarity * c;
                    let inside = (polarity > 0.0 && level > it && level <= itdt)
                        || (polarity < 0.0 && level < it && level >= itdt);
                    if !inside {
                        break;
                    }
                    let part = (level - it) / (itdt - it);
                    events.push((
                        times[k - 1] as f64 + part * (times[k] - times[k - 1]) as f64,
                        polarity > 0.0,
                    ));
                    reference = level;
                }
            }
            it = itdt;
        }
        events
    };
    (0..PIXELS).map(fire).collect()
}

#[test]
fn esim_fires_where_its_source_does() {
    let sensor =
        SensorConfig { threshold_on: 0.3, threshold_off: 0.25, ..SensorConfig::preset("esim").unwrap() };
    let (frames, times) = (frames(60, 0, 15), times(60));
    let own = thresholds(&sensor);
    let expected = esim(&frames, &times, 1e-3, |_, pixel| own[pixel]);
    assert!(total(&expected) > 20_000, "{}", total(&expected));
    let got = ours(&sensor, &frames, &times);
    // Where light changes little, its logarithm's rounding is some microseconds.
    let share = alike(&got, &expected, 5.0);
    assert!(share >= 0.999, "{share}");
    // Canary: another draw of thresholds.
    let nominal = esim(&frames, &times, 1e-3, |_, _| (0.3, 0.25));
    assert!(alike(&ours(&sensor, &frames, &times), &nominal, 1.0) < 0.5);
}

#[test]
fn redrawn_thresholds_are_normal_and_forget() {
    let sigma = 0.05_f64;
    let fired = |redraw: bool, step: f32| -> Vec<Vec<bool>> {
        let mut sensor = SensorConfig { threshold_on: 0.5, threshold_off: 0.5, ..Default::default() };
        sensor.pattern = Pattern { sigma: sigma as f32, redraw, ..Pattern::default() };
        let (width, height) = (256, 64);
        let mut counts = Vec::new();
        for frame in 0..3 {
            let config =
                EmulatorConfig { width, height, seed: 3, sensor: sensor.clone(), ..Default::default() };
            let mut emulator = EventEmulator::new(config).unwrap();
            let pixels = (width * height) as usize;
            let mut fires = vec![false; pixels];
            emulator.push(&Frames::log(&vec![0.0; pixels]), 1000 * frame).unwrap();
            let light = vec![step; pixels];
            for event in emulator.push(&Frames::log(&light), 1000 * frame + 777).unwrap().remove(0) {
                fires[usize::from(event.y) * width as usize + usize::from(event.x)] = true;
            }
            counts.push(fires);
        }
        counts
    };
    // Shares of a normal distribution below -1.5, 0 and 0.8 standard deviations.
    for (z, share) in [(-1.5, 0.066_807), (0.0, 0.5), (0.8, 0.788_145)] {
        let step = (0.5 + sigma * z) as f32;
        let runs = fired(true, step);
        let count = runs[0].len() as f64;
        for fires in &runs {
            let got = fires.iter().filter(|fires| **fires).count() as f64 / count;
            assert!((got - share).abs() < 4.5 * (share * (1.0 - share) / count).sqrt(), "{z}: {got}");
        }
        // Frames at different times say nothing of one another.
        let both = runs[0].iter().zip(&runs[1]).filter(|(a, b)| **a && **b).count() as f64 / count;
        assert!((both - share * share).abs() < 4.5 * (share / count).sqrt(), "{z}: {both}");
        // Canary: what is drawn once stays.
        let kept = fired(false, step);
        assert!(kept[0] == kept[1] && kept[1] == kept[2]);
    }
}

/// Counts of the ladder whose steps are exact: whole multiples of 2^-60.
fn ladder(logs: &[Vec<f32>], on: f32, off: f32) -> Vec<u64> {
    let exact = |value: f32| (f64::from(value) * (1_u64 << 60) as f64) as i128;
    let (on, off) = (exact(on), exact(off));
    let count = |pixel: usize| {
        let mut reference = exact(logs[0][pixel]);
        let mut count = 0;
        for frame in &logs[1..] {
            let change = exact(frame[pixel]) - reference;
            let (step, c) = if change >= 0 { (change / on, on) } else { (change / off, off) };
            reference += step * c;
            count += step.unsigned_abs() as u64;
        }
        count
    };
    (0..logs[0].len()).map(count).collect()
}

#[test]
fn eight_bit_pixels_that_come_back_to_a_level_fire() {
    let count = 240;
    let mut dice = Dice(21);
    // Waves that come back to where they were, and walks that do by chance.
    let waves: Vec<(f64, f64, f64)> = (0..PIXELS)
        .map(|_| (20.0 + 100.0 * dice.roll(), (4.0 + 56.0 * dice.roll()).floor(), dice.roll() * 6.0))
        .collect();
    let wave = |k: usize| -> Vec<u8> {
        let value = |(size, period, phase): &(f64, f64, f64)| {
            127.0 + size * (phase + std::f64::consts::TAU * k as f64 / period).sin()
        };
        waves.iter().map(|wave| value(wave).round() as u8).collect()
    };
    let waves: Vec<Vec<u8>> = (0..count).map(wave).collect();
    let times: Vec<i64> = (0..count as i64).map(|k| 1000 * k).collect();
    for (what, frames) in [("waves", waves), ("walks", frames(count, 0, 22))] {
        for (kind, sensor) in [
            ("ideal", SensorConfig::default()),
            ("v2e", {
                let mut sensor = SensorConfig::preset("v2e-clean").unwrap();
                sensor.pattern = Pattern::default();
                sensor
            }),
            ("chain", {
                // A stage that never does anything: the whole chain in continuous time.
                let mut sensor = SensorConfig::default();
                sensor.pattern.least = 0.1;
                sensor
            }),
            ("asymmetric", SensorConfig { threshold_on: 0.3, threshold_off: 0.15, ..Default::default() }),
        ] {
            let log = |code: u8| match kind {
                "v2e" if code <= 20 => f32::from(code) * (20_f32.ln() / 20.0),
                "v2e" => f32::from(code).ln(),
                _ => (f32::from(code) / 255.0 + 1e-3).ln(),
            };
            let logs: Vec<Vec<f32>> =
                frames.iter().map(|frame| frame.iter().map(|code| log(*code)).collect()).collect();
            let expected = ladder(&logs, sensor.threshold_on, sensor.threshold_off);
            let share = |got: &[Vec<Fired>]| {
                let same = got.iter().zip(&expected).filter(|(got, expected)| got.len() as u64 == **expected);
                same.count() as f64 / PIXELS as f64
            };
            let got = share(&ours(&sensor, &frames, &times));
            assert!(got >= 0.999, "{what}, {kind}: {got}");
        }
    }
    // Canary: as light, the same frames miss events at ties.
    let frames = frames(count, 0, 22);
    let mut emulator = EventEmulator::new(EmulatorConfig {
        width: WIDTH as u32,
        height: (PIXELS / WIDTH) as u32,
        ..Default::default()
    })
    .unwrap();
    let mut got = vec![0_u64; PIXELS];
    let mut logs = Vec::new();
    for (frame, t_us) in frames.iter().zip(&times) {
        let light: Vec<f32> = frame.iter().map(|code| f32::from(*code) / 255.0).collect();
        logs.push(light.iter().map(|light| (light + 1e-3).ln()).collect::<Vec<f32>>());
        for event in emulator.push(&Frames::linear(&light), *t_us).unwrap().remove(0) {
            got[usize::from(event.y) * WIDTH + usize::from(event.x)] += 1;
        }
    }
    let expected = ladder(&logs, 0.2, 0.2);
    let same = got.iter().zip(&expected).filter(|(a, b)| a == b).count() as f64 / PIXELS as f64;
    assert!(same < 0.99, "{same}");
}
