//! Frames in, events out: the sensor on its own, for light that somebody else made.

pub(crate) mod frames;
mod ideal;
mod order;

use rayon::prelude::*;

use crate::event::Event;
use crate::sensor::{ConfigError, Sensor, SensorConfig};
use crate::simd::Isa;

use frames::{Source, Tables};
use ideal::{Interval, Pixels, Tally};
use order::{MAX_INTERVAL_US, Record, append_sorted};

pub use frames::{FrameData, Frames, Transfer};

/// Pixels per tile: the unit of work of a thread. Its memory stays within a core's second cache.
const TILE: usize = 1 << 14;

/// What a user asks of an emulator.
#[derive(Clone, Debug, PartialEq)]
pub struct EmulatorConfig {
    /// Pixels per row, 1 to 65 536.
    pub width: u32,
    /// Rows, 1 to 65 536.
    pub height: u32,
    /// Environments that are pushed together; at least 1.
    pub batch: usize,
    /// Seed of everything random.
    pub seed: u64,
    /// Camera that this is, part of the key of everything random: two cameras of one environment differ.
    pub camera: u32,
    /// The sensor of every environment.
    pub sensor: SensorConfig,
    /// `Y_ref` in `ln(Y / Y_ref + eps)`; above 0.
    pub reference_luminance: f32,
    /// Threads that work on a push; 0: as many as there are cores. No event depends on it.
    pub threads: usize,
}

impl Default for EmulatorConfig {
    fn default() -> Self {
        Self {
            width: 640,
            height: 480,
            batch: 1,
            seed: 0,
            camera: 0,
            sensor: SensorConfig::default(),
            reference_luminance: 1.0,
            threads: 0,
        }
    }
}

/// What happened in one push, or in all of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EmulatorReport {
    /// Events that came out.
    pub events: u64,
    /// Pixel values that were NaN: those pixels kept their state.
    pub unknown: u64,
    /// Times that a pixel would have fired more than [`crate::trigger::MAX_EVENTS_PER_INTERVAL`] events in one interval.
    pub clamped: u64,
}

impl EmulatorReport {
    fn add(&mut self, other: &Self) {
        self.events += other.events;
        self.unknown += other.unknown;
        self.clamped += other.clamped;
    }
}

/// Turns frames of `batch` environments into events.
///
/// Between two frames the signal is what the sensor's interpolation says; events lie in `(t0, t1]`, sorted by
/// (t, y, x, firing order). Memory does not grow with the stream's length, and no event depends on the number of
/// threads, or on which other environments are in the batch.
#[derive(Debug)]
pub struct EventEmulator {
    config: EmulatorConfig,
    isa: Isa,
    pool: Option<rayon::ThreadPool>,
    tables: Tables,
    environments: Vec<Environment>,
    now_us: Option<i64>,
    last: EmulatorReport,
    total: EmulatorReport,
}

/// The pixels of one environment.
#[derive(Clone, Debug)]
struct Environment {
    /// Whether a frame has been seen since the start or the last reset.
    started: bool,
    tiles: Vec<Tile>,
    counts: Vec<u32>,
}

/// Pixels that one thread treats at a time, with their memory.
#[derive(Clone, Debug)]
struct Tile {
    first: usize,
    end: usize,
    /// Nothing before the first frame says of which kind frames are.
    pixels: Option<Pixels>,
    records: Vec<Record>,
    tally: Tally,
}

impl EventEmulator {
    /// Checks `config` and makes an emulator that has seen nothing yet.
    ///
    /// # Errors
    /// Names the first setting that cannot be used, its value, and what would work.
    pub fn new(config: EmulatorConfig) -> Result<Self, ConfigError> {
        Sensor::new(config.sensor.clone())?;
        for (what, value) in [("width", config.width), ("height", config.height)] {
            if !(1..=65_536).contains(&value) {
                return Err(ConfigError::new(what, value, "between 1 and 65536 pixels"));
            }
        }
        if config.batch == 0 {
            return Err(ConfigError::new("batch", 0, "at least 1"));
        }
        let y_ref = config.reference_luminance;
        // Their reciprocal must be a number as well.
        if !(y_ref >= 1e-30 && y_ref <= 1e30) {
            return Err(ConfigError::new("reference_luminance", y_ref, "between 1e-30 and 1e30"));
        }
        let threads = match config.threads {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            threads => threads,
        };
        let pool = if threads > 1 {
            let built = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            Some(built.map_err(|error| {
                ConfigError::new("threads", threads, format!("fewer, the system refused: {error}"))
            })?)
        } else {
            None
        };
        let pixels = config.width as usize * config.height as usize;
        let environment = Environment {
            started: false,
            tiles: (0..pixels).step_by(TILE).map(|first| Tile::new(first, (first + TILE).min(pixels))).collect(),
            counts: Vec::new(),
        };
        Ok(Self {
            isa: Isa::detect(),
            pool,
            tables: Tables::default(),
            environments: vec![environment; config.batch],
            now_us: None,
            last: EmulatorReport::default(),
            total: EmulatorReport::default(),
            config,
        })
    }

    /// The settings in force.
    pub const fn config(&self) -> &EmulatorConfig {
        &self.config
    }

    /// Time of the last frame, if there was one since all environments were reset.
    pub const fn now_us(&self) -> Option<i64> {
        self.now_us
    }

    /// What happened in the last push.
    pub const fn report(&self) -> &EmulatorReport {
        &self.last
    }

    /// What happened since the emulator was made.
    pub const fn total_report(&self) -> &EmulatorReport {
        &self.total
    }

    /// Takes the frames of time `t_us`; gives the events since the last frames, one list per environment. An
    /// environment's first frame makes no events.
    ///
    /// # Errors
    /// A wrong number of values, a time that does not increase, light that is infinite or negative. Nothing has changed
    /// then.
    pub fn push(&mut self, frames: &Frames<'_>, t_us: i64) -> Result<Vec<Vec<Event>>, ConfigError> {
        let mut out = vec![Vec::new(); self.config.batch];
        self.push_into(frames, t_us, &mut out)?;
        Ok(out)
    }

    /// As [`Self::push`], but appends to `out`, one list per environment.
    ///
    /// # Errors
    /// As [`Self::push`], and a wrong number of lists.
    pub fn push_into(
        &mut self,
        frames: &Frames<'_>,
        t_us: i64,
        out: &mut [Vec<Event>],
    ) -> Result<(), ConfigError> {
        if out.len() != self.config.batch {
            return Err(ConfigError::new("number of event lists", out.len(), self.config.batch.to_string()));
        }
        let interval_us = self.check_time(t_us)?;
        let pixels = self.config.width as usize * self.config.height as usize;
        frames.check(pixels * self.config.batch)?;
        let inverse = 1.0 / self.config.reference_luminance;
        self.tables.prepare(frames, inverse, self.config.sensor.log_eps);
        let Self { config, isa, pool, tables, environments, .. } = self;
        let sources: Option<Vec<Source<'_>>> =
            (0..config.batch).map(|index| Source::new(frames, tables, inverse, index, pixels)).collect();
        // `check` counted the values.
        let sources = sources.ok_or_else(|| ConfigError::new("frames", "too short", "complete"))?;
        let work = Push { config, isa: *isa, start_us: t_us - i64::from(interval_us), interval_us };
        if let (Some(tile), Some(source)) = (environments.iter().find_map(Environment::begun), sources.first()) {
            tile.check(source)?;
        }
        let parallel = pool.is_some() && environments.len() * pixels > TILE;
        let mut run = || {
            // Nothing changes before all light has been found possible.
            let scan = |environment: &mut Environment, source: &Source<'_>| {
                if !environment.started {
                    environment.clear();
                }
                if parallel {
                    let tiles = environment.tiles.par_iter_mut();
                    tiles.map(|tile| tile.scan(&work, source)).reduce(|| false, |a, b| a | b)
                } else {
                    environment.tiles.iter_mut().fold(false, |found, tile| found | tile.scan(&work, source))
                }
            };
            let impossible = if parallel {
                let pairs = environments.par_iter_mut().zip(&sources);
                pairs.map(|(environment, source)| scan(environment, source)).reduce(|| false, |a, b| a | b)
            } else {
                let pairs = environments.iter_mut().zip(&sources);
                pairs.fold(false, |found, (environment, source)| found | scan(environment, source))
            };
            if impossible {
                return Err(impossible_light(frames, config));
            }
            let fire = |environment: &mut Environment, source: &Source<'_>, events: &mut Vec<Event>| {
                if parallel {
                    environment.tiles.par_iter_mut().for_each(|tile| tile.fire(&work, source));
                } else {
                    environment.tiles.iter_mut().for_each(|tile| tile.fire(&work, source));
                }
                environment.finish(&work, events);
            };
            if parallel {
                let all = environments.par_iter_mut().zip(&sources).zip(out.par_iter_mut());
                all.for_each(|((environment, source), events)| fire(environment, source, events));
            } else {
                for ((environment, source), events) in environments.iter_mut().zip(&sources).zip(out) {
                    fire(environment, source, events);
                }
            }
            Ok(())
        };
        match pool {
            Some(pool) => pool.install(run)?,
            None => run()?,
        }
        self.now_us = Some(t_us);
        self.last = EmulatorReport::default();
        for tile in self.environments.iter().flat_map(|environment| &environment.tiles) {
            self.last.add(&EmulatorReport {
                events: tile.records.len() as u64,
                unknown: tile.tally.unknown,
                clamped: tile.tally.clamped,
            });
        }
        let last = self.last;
        self.total.add(&last);
        Ok(())
    }

    /// Lets the environments `indices` (all, where there is no list) begin anew with their next frame. With all of them
    /// reset, time may start anywhere again.
    ///
    /// # Errors
    /// An index that is no environment's.
    pub fn reset(&mut self, indices: Option<&[usize]>) -> Result<(), ConfigError> {
        let batch = self.config.batch;
        match indices {
            Some(indices) => {
                if let Some(bad) = indices.iter().find(|index| **index >= batch) {
                    return Err(ConfigError::new("environment", bad, format!("below the batch of {batch}")));
                }
                for index in indices {
                    self.environments[*index].started = false;
                }
            }
            None => {
                for environment in &mut self.environments {
                    environment.started = false;
                }
            }
        }
        if self.environments.iter().all(|environment| !environment.started) {
            self.now_us = None;
        }
        Ok(())
    }

    /// Microseconds since the last frame; 0 for the first one.
    fn check_time(&self, t_us: i64) -> Result<u32, ConfigError> {
        let Some(now_us) = self.now_us else { return Ok(0) };
        if t_us <= now_us {
            return Err(ConfigError::new("t_us", t_us, format!("above {now_us}, the time of the last frame")));
        }
        match t_us.checked_sub(now_us) {
            Some(interval) if interval <= MAX_INTERVAL_US => Ok(interval as u32),
            _ => Err(ConfigError::new(
                "t_us",
                t_us,
                format!("at most {MAX_INTERVAL_US} microseconds after the last frame, {now_us}"),
            )),
        }
    }
}

/// What all tiles of a push share.
struct Push<'a> {
    config: &'a EmulatorConfig,
    isa: Isa,
    start_us: i64,
    interval_us: u32,
}

/// Names the first impossible value.
fn impossible_light(frames: &Frames<'_>, config: &EmulatorConfig) -> ConfigError {
    let (values, is_log) = match frames.data {
        FrameData::Linear(values) => (values, false),
        FrameData::Log(values) => (values, true),
        FrameData::U8(..) | FrameData::U16(..) => (&[][..], false),
    };
    let bad = |value: &f32| value.is_infinite() || (!is_log && *value < 0.0);
    let index = values.iter().position(bad).unwrap_or(0);
    let pixels = config.width as usize * config.height as usize;
    let pixel = index / frames.channels % pixels;
    let (x, y) = (pixel % config.width as usize, pixel / config.width as usize);
    let what = format!("light of pixel ({x}, {y}) of environment {}", index / (frames.channels * pixels));
    let value = values.get(index).copied().unwrap_or_default();
    let remedy = if is_log { "finite, or NaN where unknown" } else { "finite and at least 0, or NaN where unknown" };
    ConfigError::new(&what, value, remedy)
}

impl Environment {
    /// Memory of the frames that were seen, if any were.
    fn begun(&self) -> Option<&Pixels> {
        if self.started { self.tiles.first().and_then(|tile| tile.pixels.as_ref()) } else { None }
    }

    /// Forgets everything.
    fn clear(&mut self) {
        for tile in &mut self.tiles {
            tile.pixels = None;
        }
    }

    /// Sorts what the tiles fired.
    fn finish(&mut self, work: &Push<'_>, events: &mut Vec<Event>) {
        self.started = true;
        let parts: Vec<&[Record]> = self.tiles.iter().map(|tile| tile.records.as_slice()).collect();
        append_sorted(&parts, work.start_us, work.interval_us, &mut self.counts, events);
    }
}

impl Tile {
    const fn new(first: usize, end: usize) -> Self {
        Self { first, end, pixels: None, records: Vec::new(), tally: Tally { unknown: 0, clamped: 0 } }
    }

    const fn interval<'a>(&self, work: &Push<'a>) -> Interval<'a> {
        Interval {
            sensor: &work.config.sensor,
            width: work.config.width,
            first: self.first,
            end: self.end,
            us: work.interval_us,
        }
    }

    /// Whether a value is impossible.
    fn scan(&mut self, work: &Push<'_>, source: &Source<'_>) -> bool {
        let at = self.interval(work);
        let pixels = self.pixels.get_or_insert_with(|| Pixels::new(source, self.end - self.first));
        let (unknown, impossible) = pixels.scan(work.isa, *source, &at);
        self.tally.unknown = unknown;
        impossible
    }

    fn fire(&mut self, work: &Push<'_>, source: &Source<'_>) {
        let at = self.interval(work);
        self.records.clear();
        if let Some(pixels) = &mut self.pixels {
            self.tally.clamped = pixels.fire(work.isa, *source, &at, &mut self.records).clamped;
        }
    }
}

#[cfg(test)]
mod tests;
