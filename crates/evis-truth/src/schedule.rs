//! How often each pixel is sampled: often enough for the fastest thing that can come through it meanwhile.

use std::sync::{Arc, OnceLock};

use glam::DVec3;
use rayon::prelude::*;

use crate::clock::{Clock, Moment};
use crate::rays::caster::seen_from;
use crate::rays::{Beam, Projection};
use crate::signal::at;

/// Pixels of motion between two samples of a pixel.
const MOTION_PER_STEP: f64 = 0.25;
/// Margin on speeds, for what lies between the places and times at which they are looked up.
const MARGIN: f64 = 1.5;
/// Longest and shortest step, in microseconds: steps are the longest one halved, so that pixels share their moments.
const STEP_US: [i64; 2] = [1024, 64];
/// Instants at which the fastest motion of all is looked for.
const INSTANTS: usize = 16;
/// Time over which speeds are measured, in microseconds.
const APART_US: f64 = 100.0;
/// A pixel's schedule is kept for this long, in microseconds, at most, and while nothing moves by more pixels than this.
const WINDOW_US: i64 = 8192;
const WINDOW_PX: f64 = 3.0;

/// A step that serves every pixel, and the image speed that it is for: that of the fastest thing, and no light goes
/// through much of a period.
pub fn shortest(clock: &Clock, duration_us: i64) -> (i64, f64) {
    let [width, height] = [clock.pinhole().lens.width, clock.pinhole().lens.height].map(|edge| edge as usize);
    let stride = (width / 40).max(1);
    let fastest = (0..INSTANTS)
        .map(|k| duration_us as f64 * (k as f64 + 0.5) / INSTANTS as f64)
        .map(|t| {
            let (now, later) = (clock.at(t), clock.at(t + APART_US));
            let columns = (0..width).step_by(stride);
            let places: Vec<[f64; 2]> = columns
                .flat_map(|x| (0..height).step_by(stride).map(move |y| [x as f64 + 0.5, y as f64 + 0.5]))
                .collect();
            let speed = |at: &[f64; 2]| {
                let (hit, ray) = (now.caster.hit_at(&now.camera, *at), now.camera.ray(*at));
                let there = seen_from(hit, &ray, later.caster.geometry(), &later.camera);
                there.map_or(0.0, |[x, y]| (x - at[0]).hypot(y - at[1]) / APART_US * 1e6)
            };
            places.par_iter().map(speed).reduce(|| 0.0, f64::max)
        })
        .fold(0.0, f64::max);
    let wanted = wanted_us(fastest).min(clock.shortest_period_us().map_or(f64::INFINITY, |p| p / 32.0));
    let mut step = STEP_US[0];
    while step as f64 > wanted && step > STEP_US[1] {
        step /= 2;
    }
    (step, fastest)
}

/// Times at which what bends or jumps is evaluated: the last microsecond up to it, and the first one after it. Motion to and
/// fro turns at its keys, where light touches a level that it misses a microsecond earlier and later.
pub fn break_samples(clock: &Clock, duration_us: i64) -> Vec<i64> {
    let breaks = clock.break_times(duration_us).into_iter();
    let sides = breaks.map(|t_us| t_us.floor() as i64).flat_map(|t_us| [t_us, t_us + 1]);
    sides.filter(|t_us| (0..=duration_us).contains(t_us)).collect()
}

/// Time between two samples where light moves this fast, in pixels per second.
fn wanted_us(speed: f64) -> f64 {
    1e6 * MOTION_PER_STEP / (MARGIN * speed).max(1.0)
}

/// When each pixel is sampled.
pub struct Schedule<'c, 'a> {
    clock: &'c Clock<'a>,
    shortest_us: i64,
    duration_us: i64,
    /// Times at both sides of which motion or light bends or jumps.
    breaks_us: Vec<i64>,
    /// `None`: all pixels are sampled equally often.
    local: Option<Local<'a>>,
}

/// Time is cut into windows, in each of which a pixel keeps its schedule.
struct Local<'a> {
    window_us: i64,
    /// How far from a pixel things may begin a window and come through it, in pixels.
    reach_px: f64,
    windows: Vec<OnceLock<Window<'a>>>,
}

struct Window<'a> {
    /// Its middle, and [`APART_US`] later.
    now: Arc<Moment<'a>>,
    later: Arc<Moment<'a>>,
    /// Boxes through which something moves in it.
    boxes: Vec<(DVec3, DVec3)>,
}

impl<'c, 'a> Schedule<'c, 'a> {
    /// The same step for all.
    pub fn even(clock: &'c Clock<'a>, step_us: i64, duration_us: i64) -> Self {
        let breaks_us = break_samples(clock, duration_us);
        Self { clock, shortest_us: step_us, duration_us, breaks_us, local: None }
    }

    /// Steps from the fastest motion near each pixel; `shortest_us` and `fastest` are what [`shortest`] says.
    pub fn local(clock: &'c Clock<'a>, (shortest_us, fastest): (i64, f64), duration_us: i64) -> Self {
        // A light that moves may sweep its shadows faster than anything else.
        if clock.lights_move() || clock.shortest_period_us().is_some_and(|p| p / 32.0 < STEP_US[0] as f64) {
            return Self::even(clock, shortest_us, duration_us);
        }
        let mut window_us = WINDOW_US;
        while window_us > STEP_US[0] && window_us as f64 * fastest > WINDOW_PX * 1e6 {
            window_us /= 2;
        }
        let count = duration_us.div_euclid(window_us) + 1;
        let windows = (0..count).map(|_| OnceLock::new()).collect();
        let reach_px = 1.0 + 0.5 * MARGIN * fastest * window_us as f64 * 1e-6;
        let local = Some(Local { window_us, reach_px, windows });
        Self { local, ..Self::even(clock, shortest_us, duration_us) }
    }

    /// When pixel (x, y) is sampled, from 0 to the end.
    pub fn times(&self, x: u16, y: u16) -> Vec<i64> {
        let mut times = vec![0];
        let mut fill = |step_us: i64, until_us: i64| {
            while let Some(&last) = times.last()
                && last < until_us
            {
                times.push((last + step_us).min(self.duration_us));
            }
        };
        match &self.local {
            None => fill(self.shortest_us, self.duration_us),
            Some(local) => {
                let mut steps: Vec<i64> =
                    (0..local.windows.len()).map(|k| self.step_in(local, k, x, y)).collect();
                // A step is not more than twice its neighbour, so that bends are known from three looks.
                for k in 1..steps.len() {
                    steps[k] = steps[k].min(2 * steps[k - 1]);
                }
                for k in (1..steps.len()).rev() {
                    steps[k - 1] = steps[k - 1].min(2 * steps[k]);
                }
                for (k, step) in steps.into_iter().enumerate() {
                    fill(step, ((k as i64 + 1) * local.window_us).min(self.duration_us));
                }
            }
        }
        if !self.breaks_us.is_empty() {
            times.extend(&self.breaks_us);
            times.sort_unstable();
            times.dedup();
        }
        times
    }

    fn step_in(&self, local: &Local<'a>, k: usize, x: u16, y: u16) -> i64 {
        let window = local.windows[k].get_or_init(|| {
            let start = k as f64 * local.window_us as f64;
            let [a, b, c] = [0.0, 0.5, 1.0].map(|part| self.clock.at(start + part * local.window_us as f64));
            let boxes = a.moving_boxes(0.1).into_iter().zip(c.moving_boxes(0.1)).zip(b.moving_boxes(0.1));
            let boxes = boxes.map(|((a, c), b)| (a.0.min(b.0).min(c.0), a.1.max(b.1).max(c.1))).collect();
            let later = self.clock.at(start + 0.5 * local.window_us as f64 + APART_US);
            Window { now: b, later, boxes }
        });
        let reach = 0.5 + local.reach_px;
        let beam =
            Beam::wide(&window.now.caster, &window.now.camera, at(x, y, [-reach; 2]), at(x, y, [reach; 2]));
        let later: (_, &dyn Projection) = (window.later.caster.geometry(), &window.later.camera);
        // What is too much to look through, or has a shadow that moves, is sampled as often as the fastest needs.
        let Some(moved) = beam.fastest(later, &window.boxes) else { return self.shortest_us };
        let wanted = wanted_us(moved / APART_US * 1e6);
        let mut step = STEP_US[0];
        while step as f64 > wanted && step > self.shortest_us {
            step /= 2;
        }
        step
    }
}
