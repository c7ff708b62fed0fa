//! A sign of motion: pixels next to each other that change together.

use crate::event::Event;

/// Longest window in which events are summed, microseconds: things that move stay at a pixel and its neighbour for about
/// as long, and readout and time stamps are finer.
const LONGEST_WINDOW_US: i64 = 50_000;

/// Windows that a short recording is cut into at least.
const FEWEST_WINDOWS: i64 = 8;

/// Windows that a long recording is cut into at most: 58 hours of the longest ones. Beyond that they become longer, so that
/// their number cannot fill the memory.
const MOST_WINDOWS: i64 = 1 << 22;

/// Fewer pairs of neighbours say nothing: those of a quiet sensor have correlations that are seldom and large.
const FEWEST_PAIRS: u64 = 100;

/// Correlation beyond which a scene moves. Recordings of still scenes that are at hand have up to 0.03, for the pixels of a
/// real sensor are not quite independent; those of moving ones (from 0.35 s on, with a noisy sensor too) 0.1 and more.
const MOVES: f64 = 0.05;

/// How far beyond its own error a correlation must be.
const ERRORS: f64 = 4.0;

/// How alike neighbours are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Likeness {
    /// Mean correlation of a pixel that fires with its neighbours (sums of polarities by window), less that of any two.
    pub(super) correlation: f64,
    /// Its standard error, were pixels independent.
    pub(super) error: f64,
    /// Length of a window, microseconds.
    pub(super) window_us: i64,
}

impl Likeness {
    /// Whether noise cannot explain it.
    pub(super) fn moves(&self) -> bool {
        self.correlation > MOVES && self.correlation > ERRORS * self.error
    }
}

/// How alike neighbours are; `None` where too few pixels fired beside another.
///
/// A pixel's noise depends on nothing that its neighbour does, an edge that moves crosses both. ON counts 1 and OFF -1, as
/// neighbours at an edge change alike. Each pixel's mean is taken off, so rates that vary over the sensor do not count; all
/// pixels weigh the same, so neither do hot ones; and what any two pixels have in common is taken off, so a leak that
/// starts everywhere at once is not motion. Neighbours that never fire count as 0: else the few pixels where something moves in
/// a scene that is nearly still would decide alone, as elsewhere few that fire are neighbours.
pub(super) fn likeness(
    events: &[Event],
    (width, height): (usize, usize),
    (start_us, length_us): (i64, i64),
) -> Option<Likeness> {
    let window_us = (length_us / FEWEST_WINDOWS).clamp(1, LONGEST_WINDOW_US).max(length_us / MOST_WINDOWS);
    let windows = length_us / window_us;
    let cells = window_sums(events, width, (start_us, window_us, windows));
    let pixels: Vec<Series> = {
        let mut pixels = vec![Series::default(); width * height];
        let mut from = 0;
        for of_pixel in cells.chunk_by(|a, b| a.pixel == b.pixel) {
            let sum: f64 = of_pixel.iter().map(|cell| cell.sum).sum();
            let squares: f64 = of_pixel.iter().map(|cell| cell.sum * cell.sum).sum();
            let squares = squares - sum * sum / windows as f64;
            // A pixel that does the same in all windows is like none.
            let weight = if squares > 1e-9 { squares.sqrt().recip() } else { 0.0 };
            pixels[of_pixel[0].pixel] = Series { from, until: from + of_pixel.len(), sum, weight };
            from += of_pixel.len();
        }
        pixels
    };
    let correlation = |a: &Series, b: &Series| {
        let (mut left, mut right) = (&cells[a.from..a.until], &cells[b.from..b.until]);
        let mut product = -a.sum * b.sum / windows as f64;
        while let ([p, after_p @ ..], [q, after_q @ ..]) = (left, right) {
            if p.window == q.window {
                product += p.sum * q.sum;
            }
            let (step_left, step_right) = (p.window <= q.window, q.window <= p.window);
            left = if step_left { after_p } else { left };
            right = if step_right { after_q } else { right };
        }
        product * a.weight * b.weight
    };
    let (mut neighbours, mut pairs, mut sum, mut squares) = (0_u64, 0_u64, 0.0, 0.0);
    for (index, pixel) in pixels.iter().enumerate().filter(|(_, pixel)| pixel.weight > 0.0) {
        let right = (index % width + 1 < width).then(|| index + 1);
        for other in [right, Some(index + width)].into_iter().flatten().filter_map(|at| pixels.get(at)) {
            neighbours += 1;
            if other.weight > 0.0 {
                let of_pair = correlation(pixel, other);
                (pairs, sum, squares) = (pairs + 1, sum + of_pair, squares + of_pair * of_pair);
            }
        }
    }
    if pairs < FEWEST_PAIRS {
        return None;
    }
    let common = of_any_two(&pixels, &cells, windows) * pairs as f64;
    let per_neighbour = 1.0 / neighbours as f64;
    Some(Likeness {
        correlation: (sum - common) * per_neighbour,
        error: squares.sqrt() * per_neighbour,
        window_us,
    })
}

/// What a pixel's polarities add up to in a window; windows without events have none.
struct Cell {
    pixel: usize,
    window: usize,
    sum: f64,
}

/// By pixel, then by window.
fn window_sums(events: &[Event], width: usize, (start_us, window_us, windows): (i64, i64, i64)) -> Vec<Cell> {
    // The last bit is the polarity.
    let mut keys: Vec<i64> = events
        .iter()
        .filter_map(|event| {
            let window = (event.t - start_us) / window_us;
            let pixel = usize::from(event.y) * width + usize::from(event.x);
            (window < windows).then(|| (pixel as i64 * windows + window) * 2 + i64::from(event.p))
        })
        .collect();
    keys.sort_unstable();
    let cell = |same: &[i64]| Cell {
        pixel: (same[0] / 2 / windows) as usize,
        window: (same[0] / 2 % windows) as usize,
        sum: same.iter().map(|key| (key % 2 * 2 - 1) as f64).sum(),
    };
    keys.chunk_by(|a, b| a / 2 == b / 2).map(cell).collect()
}

/// Where a pixel's cells are, their sum, and what makes its deviations' squares add up to 1.
#[derive(Clone, Copy, Default)]
struct Series {
    from: usize,
    until: usize,
    sum: f64,
    weight: f64,
}

/// Mean correlation of any two pixels: all sums of their weighted deviations, squared, less each pixel with itself.
fn of_any_two(pixels: &[Series], cells: &[Cell], windows: i64) -> f64 {
    let mean: f64 = pixels.iter().map(|pixel| pixel.sum * pixel.weight).sum::<f64>() / windows as f64;
    let mut all = vec![-mean; windows as usize];
    for cell in cells {
        all[cell.window] += cell.sum * pixels[cell.pixel].weight;
    }
    let number = pixels.iter().filter(|pixel| pixel.weight > 0.0).count() as f64;
    (all.iter().map(|sum| sum * sum).sum::<f64>() - number) / (number * (number - 1.0))
}
