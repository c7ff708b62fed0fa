//! How fast events become dense arrays, beside a plain loop that scatters them.
//!
//! `cargo bench --profile release -p evis-representation` prints Markdown; `-- NAME` only what begins so. A million random events, sorted by time, at
//! 640 × 480. The plain loop trusts its events: it checks nothing, and allocates its array as the others do. Runs of all rows
//! take turns, and each row counts with its least time on the processor: what else shares the machine disturbs few of them.
#![allow(clippy::unwrap_used, reason = "a benchmark may panic")]

use std::hint::black_box;
use std::time::{Duration, Instant};

use evis_core::{Event, Polarity};
use evis_representation::{
    Decay, Measure, Polarities, Slice, averaged_timestamps, bina_rep, binary_stack, counts, event_frame,
    event_spike_tensor, normalize_nonzero, time_surfaces, voxel_grid,
};

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
const EVENTS: u64 = 1_000_000;
const BINS: usize = 5;
const REPETITIONS: usize = 10;

/// Runs between two looks at the clock, which some systems turn every 4 ms only.
const RUNS: u32 = 10;

/// A generator of numbers that look random (G. Marsaglia, "Xorshift RNGs", 2003).
fn xorshift(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}

fn events() -> Vec<Event> {
    let mut state = 0x9e37_79b9_7f4a_7c15;
    let mut event = |_| {
        let (t, place) = (xorshift(&mut state) % 50_000, xorshift(&mut state));
        let polarity = if place >> 63 == 1 { Polarity::On } else { Polarity::Off };
        let (x, y) = (place % WIDTH as u64, (place >> 20) % HEIGHT as u64);
        Event::new(t as i64, x as u16, y as u16, polarity)
    };
    let mut events: Vec<_> = (0..EVENTS).map(&mut event).collect();
    events.sort_by_key(|event| event.t);
    events
}

/// The voxel grid as one would write it down.
fn plain(events: &[Event]) -> Vec<f32> {
    let mut grid = vec![0.0_f32; BINS * HEIGHT * WIDTH];
    let (start, end) = (events[0].t, events[events.len() - 1].t);
    let span = (end - start) as f64;
    for event in events {
        let place = (event.t - start) as f64 * (BINS - 1) as f64 / span;
        let bin = place as usize;
        let later = (place - bin as f64) as f32;
        let sign = if event.p > 0 { 1.0 } else { -1.0 };
        let voxel = (bin * HEIGHT + usize::from(event.y)) * WIDTH + usize::from(event.x);
        grid[voxel] += sign * (1.0 - later);
        if bin + 1 < BINS {
            grid[voxel + HEIGHT * WIDTH] += sign * later;
        }
    }
    grid
}

/// Time that this thread was on the processor; wall time where the system does not say.
struct Clock(Instant);

impl Clock {
    fn now(&self) -> Duration {
        let stat = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
        let nanoseconds = stat.and_then(|stat| stat.split(' ').next()?.parse().ok());
        nanoseconds.map_or_else(|| self.0.elapsed(), Duration::from_nanos)
    }
}

struct Row<'a> {
    name: &'static str,
    run: Box<dyn FnMut() + 'a>,
    seconds: f64,
}

impl<'a> Row<'a> {
    fn new(name: &'static str, run: impl FnMut() + 'a) -> Self {
        Self { name, run: Box::new(run), seconds: f64::INFINITY }
    }
}

fn main() {
    let events = events();
    let slice = Slice::new(&events, (WIDTH as u32, HEIGHT as u32)).unwrap();
    let at: Vec<i64> = (1..=5).map(|k| k * 10_000).collect();
    let mut rows = vec![
        Row::new("plain scatter loop, 5 bins", || drop(black_box(plain(black_box(&events))))),
        Row::new("voxel grid, 5 bins", || {
            drop(black_box(voxel_grid(black_box(&slice), BINS, Polarities::Signed)));
        }),
        Row::new("voxel grid, 2 × 5 bins", || {
            drop(black_box(voxel_grid(black_box(&slice), BINS, Polarities::Split)));
        }),
        Row::new("voxel grid, 5 bins, normalized", || {
            let mut grid = voxel_grid(black_box(&slice), BINS, Polarities::Signed).unwrap();
            normalize_nonzero(&mut grid.data);
            black_box(grid);
        }),
        Row::new("event frame", || drop(black_box(event_frame(black_box(&slice))))),
        Row::new("counts", || drop(black_box(counts(black_box(&slice))))),
        Row::new("event spike tensor, 2 × 5 bins", || {
            drop(black_box(event_spike_tensor(black_box(&slice), BINS, Measure::Time)));
        }),
        Row::new("time surfaces, 5 times", || {
            drop(black_box(time_surfaces(black_box(&slice), &at, 1e4, Decay::Exponential)));
        }),
        Row::new("averaged timestamps", || drop(black_box(averaged_timestamps(black_box(&slice), 0.0)))),
        Row::new("binary stack, 8 parts", || drop(black_box(binary_stack(black_box(&slice), 8)))),
        Row::new("Bina-Rep, 1 frame of 8 bits", || drop(black_box(bina_rep(black_box(&slice), 1, 8)))),
    ];
    if let Some(wanted) = std::env::args().skip(1).find(|argument| !argument.starts_with('-')) {
        rows.retain(|row| row.name.starts_with("plain") || row.name.starts_with(&wanted));
    }
    let clock = Clock(Instant::now());
    for _ in 0..REPETITIONS {
        for row in &mut rows {
            let start = clock.now();
            for _ in 0..RUNS {
                (row.run)();
            }
            row.seconds = row.seconds.min((clock.now() - start).as_secs_f64() / f64::from(RUNS));
        }
    }
    let reference = rows[0].seconds;
    println!("| representation | time | million events/s | of the plain loop |\n|---|---|---|---|");
    for Row { name, seconds, .. } in &rows {
        let rate = EVENTS as f64 / seconds * 1e-6;
        println!("| {name} | {:.2} ms | {rate:.0} | {:.2} |", seconds * 1e3, seconds / reference);
    }
}
