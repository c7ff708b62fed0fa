use super::*;
use crate::event::is_ordered;
use crate::trigger::{self, PixelState};

/// The scene that peers were measured on: I = 0.5 + 0.4 sin(0.3 + 2 pi (x / 41.7 - 9.7 t)).
fn drifting(width: u32, height: u32, t_us: i64) -> Vec<f32> {
    let row: Vec<f32> = (0..width)
        .map(|x| {
            let phase = 0.3 + std::f64::consts::TAU * (f64::from(x) / 41.7 - 9.7 * t_us as f64 * 1e-6);
            (0.5 + 0.4 * phase.sin()) as f32
        })
        .collect();
    row.repeat(height as usize)
}

fn emulator(config: EmulatorConfig) -> EventEmulator {
    EventEmulator::new(config).unwrap()
}

#[test]
fn the_ideal_kernel_is_the_trigger() {
    let (width, height) = (67, 5);
    let config = EmulatorConfig { width, height, ..Default::default() };
    let mut emulator = emulator(config.clone());
    let mut states: Vec<PixelState> = Vec::new();
    let mut before = 0;
    let mut count = 0;
    for t_us in [0, 1000, 2500, 2501, 40_000] {
        let frame = drifting(width, height, t_us);
        let got = emulator.push(&Frames::linear(&frame), t_us).unwrap().remove(0);
        let logs: Vec<f32> =
            frame.iter().map(|light| crate::simd::ln(light + config.sensor.log_eps)).collect();
        let mut expected = Vec::new();
        if states.is_empty() {
            states = logs.iter().map(|l| PixelState { reference_log: *l, log_luma: *l }).collect();
        }
        let interval = (t_us - before) as u32;
        for (i, (state, log)) in states.iter_mut().zip(&logs).enumerate() {
            let decision = trigger::decide(&config.sensor, *state, *log);
            for k in 1..=decision.count {
                let offset = trigger::fire_time_us(&config.sensor, &decision, k, interval).max(1);
                let (x, y) = (i as u32 % width, i as u32 / width);
                expected.push(Event::new(before + i64::from(offset), x as u16, y as u16, decision.polarity));
            }
            *state = PixelState { reference_log: decision.reference_log, log_luma: *log };
        }
        expected.sort_by_key(Event::order);
        assert_eq!(got, expected, "at {t_us}");
        assert!(is_ordered(&got) && got.iter().all(|e| e.t > before && e.t <= t_us || t_us == 0));
        count += got.len();
        before = t_us;
    }
    assert!(count > 500, "{count}");
}

#[test]
fn instruction_sets_agree_bit_for_bit() {
    let (width, height) = (67, 41);
    let pixels = (width * height) as usize;
    let times: Vec<i64> = (0..12).map(|k| k * 1300).collect();
    // All values at once, 0 and NaN among them.
    let light = |k: usize, i: usize| match (i * 31 + k * k * 7) % 97 {
        0 => f32::NAN,
        1 => 0.0,
        n => (n as f32 / 96.0).powi(3),
    };
    for name in ["ideal", "v2e-noisy", "openeb", "evis"] {
        let mut streams = Vec::new();
        for isa in Isa::supported() {
            let sensor = SensorConfig::preset(name).unwrap();
            let config = EmulatorConfig { width, height, sensor, seed: 2, ..Default::default() };
            let make = || EventEmulator { isa, ..emulator(config.clone()) };
            let (mut floats, mut bytes, mut words, mut logs) = (make(), make(), make(), make());
            let mut events = Vec::new();
            for (k, t_us) in times.iter().enumerate() {
                let frame: Vec<f32> = (0..pixels).map(|i| light(k, i)).collect();
                let eight: Vec<u8> = frame.iter().map(|light| (light * 255.0) as u8).collect();
                let sixteen: Vec<u16> = frame.iter().map(|light| (light * 65535.0) as u16).collect();
                let log: Vec<f32> = frame.iter().map(|light| (light + 1e-3).ln()).collect();
                events.extend(floats.push(&Frames::linear(&frame), *t_us).unwrap().remove(0));
                events.extend(bytes.push(&Frames::u8(&eight, Transfer::Srgb), *t_us).unwrap().remove(0));
                events.extend(words.push(&Frames::u16(&sixteen, Transfer::Linear), *t_us).unwrap().remove(0));
                events.extend(logs.push(&Frames::log(&log), *t_us).unwrap().remove(0));
            }
            assert!(events.len() > 10_000, "{name} {isa:?}: {}", events.len());
            streams.push((events, floats.state(), bytes.state(), words.state(), logs.state()));
        }
        assert!(streams.windows(2).all(|pair| pair[0] == pair[1]), "{name}");
        // Canary: one pixel more makes another stream.
        assert!(streams[0].0 != streams[0].0[1..]);
    }
}
