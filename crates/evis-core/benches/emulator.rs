//! How fast frames become events, beside what memory allows.
//!
//! `cargo bench --profile release --workspace --locked --bench emulator` prints Markdown; `-- NAME` only what begins so.
//! The scene is
//! I = 0.5 + 0.4 sin(0.3 + 2 pi (x / 41.7 - 9.7 t)), 346 × 260, 200 frames at 1 kHz, C = 0.2, events sorted.
//! Each frame counts with the least time of all runs: what else shares the machine disturbs few of them.
#![allow(clippy::unwrap_used, reason = "a benchmark may panic")]

use std::hint::black_box;
use std::time::Instant;

use evis_core::sensor::{NoiseLaw, Photoreceptor};
use evis_core::{EmulatorConfig, Event, EventEmulator, Frames, SensorConfig, Transfer};

const WIDTH: u32 = 346;
const HEIGHT: u32 = 260;
const FRAMES: usize = 200;
const REPETITIONS: usize = 15;

/// Light of one row; all rows are alike.
fn light(x: u32, t_us: i64) -> f64 {
    let phase = 0.3 + std::f64::consts::TAU * (f64::from(x) / 41.7 - 9.7 * t_us as f64 * 1e-6);
    0.5 + 0.4 * phase.sin()
}

fn frames<T: Copy>(value: impl Fn(f64) -> T) -> Vec<Vec<T>> {
    frames_of((WIDTH, HEIGHT), FRAMES, value)
}

fn frames_of<T: Copy>((width, height): (u32, u32), count: usize, value: impl Fn(f64) -> T) -> Vec<Vec<T>> {
    (0..count)
        .map(|k| {
            let row: Vec<T> = (0..width).map(|x| value(light(x, k as i64 * 1000))).collect();
            row.repeat(height as usize)
        })
        .collect()
}

struct Row {
    name: String,
    seconds: f64,
    events: usize,
    pixels: usize,
}

/// `warm`: the first frame, which sets every reference, is no part of it.
fn measure<'a>(
    name: &str,
    sensor: &SensorConfig,
    threads: usize,
    frame: impl Fn(usize) -> Frames<'a>,
    size: (u32, u32),
    count: usize,
    warm: bool,
) -> Row {
    let wanted = std::env::args().skip(1).find(|argument| !argument.starts_with('-'));
    if wanted.is_some_and(|wanted| !name.starts_with(&wanted)) {
        return Row { name: name.into(), seconds: f64::NAN, events: 0, pixels: 0 };
    }
    let mut events = 0;
    let mut lists: Vec<Vec<Event>> = vec![Vec::new()];
    let mut least = vec![f64::INFINITY; count + usize::from(warm)];
    for _ in 0..REPETITIONS {
        let (width, height) = size;
        let config = EmulatorConfig { width, height, threads, sensor: sensor.clone(), ..Default::default() };
        let mut emulator = EventEmulator::new(config).unwrap();
        events = 0;
        for (k, least) in least.iter_mut().enumerate() {
            lists[0].clear();
            let start = Instant::now();
            emulator.push_into(&frame(k), k as i64 * 1000, &mut lists).unwrap();
            *least = least.min(start.elapsed().as_secs_f64());
            events += lists[0].len();
        }
    }
    let seconds = least[usize::from(warm)..].iter().sum();
    Row { name: name.into(), seconds, events, pixels: (size.0 * size.1) as usize * count }
}

/// Bytes per second of `a = b + s c` over arrays that together are as large as an emulator's memory.
fn triad(pixels: usize) -> f64 {
    let (mut a, b, c) = (vec![0.0_f32; pixels], vec![1.0_f32; pixels], vec![2.0_f32; pixels]);
    let rounds = 20_000_000 / pixels;
    let mut least = f64::INFINITY;
    for round in 0..rounds {
        let start = Instant::now();
        let s = black_box(round as f32);
        for ((a, b), c) in a.iter_mut().zip(&b).zip(&c) {
            *a = b + s * c;
        }
        black_box(&mut a);
        least = least.min(start.elapsed().as_secs_f64());
    }
    (12 * pixels) as f64 / least
}

fn print(row: &Row) {
    let Row { name, seconds, events, pixels } = row;
    println!(
        "| {name} | {:.1} ms | {:.0} | {:.1} | {events} |",
        seconds * 1e3,
        *pixels as f64 / seconds * 1e-6,
        *events as f64 / seconds * 1e-6,
    );
}

fn main() {
    let float = frames(|light| light as f32);
    let bytes = frames(|light| (light * 255.0).round() as u8);
    let sensor = SensorConfig::default();
    let size = (WIDTH, HEIGHT);
    println!("| chain | time | Mpixel/s | million events/s | events |");
    println!("|---|---|---|---|---|");
    let linear = |k: usize| Frames::linear(&float[k]);
    print(&measure("ideal, float32, 1 thread", &sensor, 1, linear, size, FRAMES, false));
    print(&measure("ideal, float32, 2 threads", &sensor, 2, linear, size, FRAMES, false));
    let codes = |k: usize| Frames::u8(&bytes[k], Transfer::Linear);
    print(&measure("ideal, uint8, 1 thread", &sensor, 1, codes, size, FRAMES, false));
    print(&measure("ideal, uint8, 2 threads", &sensor, 2, codes, size, FRAMES, false));
    let large = (1280, 720);
    let many = frames_of(large, 20, |light| light as f32);
    let linear_of = |k: usize| Frames::linear(&many[k]);
    print(&measure("ideal, float32, 1280x720, 1 thread", &sensor, 1, linear_of, large, many.len(), false));

    for name in ["v2e", "v2e-noisy", "evis", "openeb", "gen4-like", "davis346"] {
        let sensor = SensorConfig::preset(name).unwrap();
        let frames = if name == "davis346" { 40 } else { 100 };
        print(&measure(&format!("{name}, float32, 1 thread"), &sensor, 1, linear, size, frames, false));
    }

    for order in [1, 2] {
        let photoreceptor = Photoreceptor { cutoff_hz: 200.0, order, ..Photoreceptor::default() };
        let mut noisy = SensorConfig { photoreceptor, ..SensorConfig::default() };
        noisy.photoreceptor.noise = noisy.photoreceptor_noise_for(1.0, NoiseLaw::Measured).unwrap();
        let name = format!("photoreceptor noise of 1 Hz, 200 Hz, order {order}, float32, 1 thread");
        print(&measure(&name, &noisy, 1, linear, size, 100, false));
        let still = vec![0.5; (WIDTH * HEIGHT) as usize];
        let name = format!("photoreceptor noise, still light, order {order}, float32, 1 thread");
        print(&measure(&name, &noisy, 1, |_| Frames::linear(&still), size, 100, true));
    }

    println!("\nSilent frames (distinct, nothing fires):\n");
    println!("| chain | time | Mpixel/s | million events/s | events | of the triad's bound |");
    println!("|---|---|---|---|---|---|");
    for size in [(WIDTH, HEIGHT), (1280, 720)] {
        let pixels = (size.0 * size.1) as usize;
        let few: Vec<Vec<f32>> = (0..8).map(|k| vec![0.5 + 0.002 * k as f32; pixels]).collect();
        let row = measure(
            &format!("float32 {}x{}", size.0, size.1),
            &sensor,
            1,
            |k| Frames::linear(&few[k % 8]),
            size,
            100,
            true,
        );
        // Read the frame, the reference and the signal, write the signal: 16 bytes; the triad moves 12 per element.
        let bound = triad(pixels) / 16.0;
        println!(
            "| {} | {:.1} ms | {:.0} | {:.1} | {} | {:.2} |",
            row.name,
            row.seconds * 1e3,
            row.pixels as f64 / row.seconds * 1e-6,
            0.0,
            row.events,
            row.pixels as f64 / row.seconds / bound
        );
        let few: Vec<Vec<u8>> = (0..8).map(|k| vec![127 + k as u8; pixels]).collect();
        let row = measure(
            &format!("uint8 {}x{}", size.0, size.1),
            &sensor,
            1,
            |k| Frames::u8(&few[k % 8], Transfer::Linear),
            size,
            100,
            true,
        );
        print(&row);
    }
}
