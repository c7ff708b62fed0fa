//! How fast frames become events, beside what memory allows.
//!
//! `cargo bench --profile release --workspace --locked --bench emulator` prints Markdown; `-- NAME` only what begins so.
//! The scene is
//! I = 0.5 + 0.4 sin(0.3 + 2 pi (x / 41.7 - 9.7 t)), 346 × 260, 200 frames at 1 kHz, C = 0.2, events sorted.
#![allow(clippy::unwrap_used, reason = "a benchmark may panic")]

use std::hint::black_box;
use std::time::Instant;

use evis_core::{EmulatorConfig, Event, EventEmulator, Frames, SensorConfig, Transfer};

const WIDTH: u32 = 346;
const HEIGHT: u32 = 260;
const FRAMES: usize = 200;
const REPETITIONS: usize = 7;

/// Light of one row; all rows are alike.
fn light(x: u32, t_us: i64) -> f64 {
    let phase = 0.3 + std::f64::consts::TAU * (f64::from(x) / 41.7 - 9.7 * t_us as f64 * 1e-6);
    0.5 + 0.4 * phase.sin()
}

fn frames<T: Copy>(value: impl Fn(f64) -> T) -> Vec<Vec<T>> {
    (0..FRAMES)
        .map(|k| {
            let row: Vec<T> = (0..WIDTH).map(|x| value(light(x, k as i64 * 1000))).collect();
            row.repeat(HEIGHT as usize)
        })
        .collect()
}

/// Seconds: of this thread's own work where the system tells them (a busy machine then disturbs less), else of the clock.
struct Watch(Instant, Option<f64>);

impl Watch {
    fn start(one_thread: bool) -> Self {
        Self(Instant::now(), if one_thread { cpu_seconds() } else { None })
    }

    fn seconds(&self) -> f64 {
        match (self.1, cpu_seconds()) {
            (Some(start), Some(now)) => now - start,
            _ => self.0.elapsed().as_secs_f64(),
        }
    }
}

/// Processor time of this thread.
#[cfg(target_os = "linux")]
fn cpu_seconds() -> Option<f64> {
    #[repr(C)]
    struct TimeSpec {
        seconds: i64,
        nanoseconds: i64,
    }
    unsafe extern "C" {
        fn clock_gettime(clock: i32, time: *mut TimeSpec) -> i32;
    }
    const THREAD_CPU_TIME: i32 = 3;
    let mut time = TimeSpec { seconds: 0, nanoseconds: 0 };
    // SAFETY: POSIX's function with POSIX's structure on a 64-bit system.
    let failed = unsafe { clock_gettime(THREAD_CPU_TIME, &mut time) } != 0;
    (!failed).then_some(time.seconds as f64 + time.nanoseconds as f64 * 1e-9)
}

#[cfg(not(target_os = "linux"))]
fn cpu_seconds() -> Option<f64> {
    None
}

/// Least seconds of several runs.
fn best(mut run: impl FnMut() -> f64) -> f64 {
    (0..REPETITIONS).map(|_| run()).fold(f64::INFINITY, f64::min)
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
    let seconds = best(|| {
        let (width, height) = size;
        let config = EmulatorConfig { width, height, threads, sensor: sensor.clone(), ..Default::default() };
        let mut emulator = EventEmulator::new(config).unwrap();
        events = 0;
        let mut start = Watch::start(threads == 1);
        for k in 0..count + usize::from(warm) {
            lists[0].clear();
            emulator.push_into(&frame(k), k as i64 * 1000, &mut lists).unwrap();
            events += lists[0].len();
            if warm && k == 0 {
                start = Watch::start(threads == 1);
            }
        }
        start.seconds()
    });
    Row { name: name.into(), seconds, events, pixels: (size.0 * size.1) as usize * count }
}

/// Bytes per second of `a = b + s c` over arrays that together are as large as an emulator's memory.
fn triad(pixels: usize) -> f64 {
    let (mut a, b, c) = (vec![0.0_f32; pixels], vec![1.0_f32; pixels], vec![2.0_f32; pixels]);
    let rounds = 20_000_000 / pixels;
    let seconds = best(|| {
        let start = Watch::start(true);
        for round in 0..rounds {
            let s = black_box(round as f32);
            for ((a, b), c) in a.iter_mut().zip(&b).zip(&c) {
                *a = b + s * c;
            }
            black_box(&mut a);
        }
        start.seconds()
    });
    (12 * pixels * rounds) as f64 / seconds
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

    for name in ["v2e", "v2e-noisy", "evis", "openeb", "gen4-like", "davis346"] {
        let sensor = SensorConfig::preset(name).unwrap();
        let frames = if name == "davis346" { 40 } else { 100 };
        print(&measure(&format!("{name}, float32, 1 thread"), &sensor, 1, linear, size, frames, false));
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
