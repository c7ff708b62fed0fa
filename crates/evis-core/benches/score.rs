//! Seconds to score ten million events at the default tolerances, on one core.
//!
//! `cargo bench --profile release --workspace --locked --bench score` prints Markdown; `-- MILLIONS` changes the size.
#![allow(clippy::unwrap_used, reason = "a benchmark may panic")]

use std::time::Instant;

use evis_core::metric::{ScoreSettings, score};
use evis_core::{CameraInfo, Event, Polarity, Region, RegionSpan, SensorConfig, Truth};

const SIZE: [u16; 2] = [640, 480];
const DURATION_US: i64 = 1_000_000;
const REPETITIONS: usize = 3;

/// SplitMix64.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: i64) -> i64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % limit.unsigned_abs()) as i64
    }
}

/// Bursts of eight events 400 µs apart, as edges make them, at random pixels; about `count` events.
fn bursts(count: usize, random: &mut Random) -> Vec<Event> {
    let mut events = Vec::with_capacity(count);
    while events.len() < count {
        let (x, y) = (random.below(SIZE[0].into()) as u16, random.below(SIZE[1].into()) as u16);
        let (start, step) = (random.below(DURATION_US - 6000), 200 + random.below(400));
        let polarity = if random.below(2) == 1 { Polarity::On } else { Polarity::Off };
        events.extend((0..8).map(|k| Event::new(start + k * step, x, y, polarity)));
    }
    events.sort_unstable_by_key(Event::order);
    events
}

/// A tenth left out, a tenth made up, the rest late or early by up to `jitter_us`.
fn imitated(truth: &[Event], jitter_us: i64, random: &mut Random) -> Vec<Event> {
    let mut events = Vec::with_capacity(truth.len() + truth.len() / 8);
    for e in truth {
        let polarity = if e.p == 1 { Polarity::On } else { Polarity::Off };
        let copies = [0, 1, 1, 1, 1, 1, 1, 1, 1, 2][random.below(10) as usize];
        for _ in 0..copies {
            let t = (e.t + random.below(2 * jitter_us + 1) - jitter_us).clamp(0, DURATION_US - 1);
            events.push(Event::new(t, e.x, e.y, polarity));
        }
    }
    events.sort_unstable_by_key(Event::order);
    events
}

/// Seconds that this thread has had a core, where the system tells (Linux); a busy machine adds to the others only.
fn cpu_seconds() -> f64 {
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    told.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).map_or(f64::NAN, |ns| ns / 1.0e9)
}

fn main() {
    let millions = std::env::args().skip(1).find_map(|a| a.parse::<f64>().ok()).unwrap_or(10.0);
    let count = (millions * 1.0e6) as usize;
    let mut random = Random(1);
    let events = bursts(count, &mut random);
    let pixels: Vec<[u16; 2]> = (0..SIZE[1]).flat_map(|y| (0..SIZE[0]).map(move |x| [x, y])).collect();
    let truth = Truth {
        camera: CameraInfo::uncalibrated("camera", (SIZE[0].into(), SIZE[1].into())),
        sensor: SensorConfig::default(),
        reference_luminance: 1.0,
        duration_us: DURATION_US,
        speed: events.iter().map(|_| random.below(300) as f32).collect(),
        event_region: events.iter().map(|_| Region::ALL[random.below(4) as usize]).collect(),
        span_start: (0..=pixels.len() as u32).map(|i| 2 * i).collect(),
        spans: pixels
            .iter()
            .flat_map(|_| [(0, Region::Interior), (500_000, Region::Silhouette)])
            .map(|(t_us, region)| RegionSpan { t_us, region })
            .collect(),
        pixels,
        events,
        provenance: String::new(),
    };
    println!(
        "| stream | events | truth | F1 (1 ms) | seconds, best of {REPETITIONS} | on the core |\n\
         |---|---|---|---|---|---|"
    );
    for (name, jitter_us) in [("close", 20), ("rough", 1500)] {
        let stream = imitated(&truth.events, jitter_us, &mut random);
        let (mut best, mut best_cpu, mut f1) = (f64::INFINITY, f64::INFINITY, 0.0);
        for _ in 0..REPETITIONS {
            let (start, cpu_start) = (Instant::now(), cpu_seconds());
            let score = score(&stream, &truth, &ScoreSettings::default()).unwrap();
            best = best.min(start.elapsed().as_secs_f64());
            best_cpu = best_cpu.min(cpu_seconds() - cpu_start);
            f1 = score.at(1000).unwrap().plain.f1;
        }
        println!(
            "| {name} | {} | {} | {f1:.3} | {best:.2} | {best_cpu:.2} |",
            stream.len(),
            truth.events.len()
        );
    }
}
