use super::*;
use crate::event::{Polarity, is_ordered};
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
    let _ = Polarity::On;
}
