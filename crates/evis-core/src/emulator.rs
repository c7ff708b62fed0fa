//! Frames in, events out: the sensor on its own, for light that somebody else made.

mod blocks;
mod chain;
mod diffusion;
mod expose;
mod exposing;
pub(crate) mod frames;
mod ideal;
mod keyframes;
mod noise;
mod numbering;
mod order;
pub mod parts;
mod plain;
mod readout;
pub(crate) mod receptor;
mod shape;
mod state;
pub mod tiled;
mod workers;

use rayon::prelude::*;

use crate::event::{Cause, Event, MOST_T_US, take_causes};
use crate::random::Key;
use crate::sensor::{ConfigError, Sensor, SensorConfig};
use crate::simd::Isa;

use chain::{Chain, Plan, Scan};
use diffusion::Diffuse;
use exposing::Exposing;
use frames::{BLOCK, Source, TILE, Tables};
use ideal::{Interval, Pixels, Tally};
use keyframes::{Keyframe, ScratchPool};
use numbering::Numbering;
use order::{MAX_INTERVAL_US, Record, Span, append_sorted};
use readout::Queue;
use workers::{Threads, WorkerPool};

pub use frames::{FrameData, Frames, Transfer};
pub use keyframes::{
    Cut, KeyframeReport, Keyframes, MotionCheck, WARN_GAP_PX, Warp, WarpVariant, check_motion,
};

/// Most environments of an emulator.
const MOST_ENVIRONMENTS: usize = 1 << 16;

/// Most threads of an emulator.
const MOST_THREADS: usize = 1024;

/// What an ideal pixel remembers: its reference, the last value, and the range in which nothing fires.
const LEAST_PIXEL_BYTES: u64 = 12;

/// Pixels per tile of an image: alike, and of a number that two or four threads share evenly where they share it.
fn tile_pixels(pixels: usize) -> usize {
    const SHARED: usize = 4;
    if pixels <= TILE {
        return TILE;
    }
    let tiles = pixels.div_ceil(TILE).next_multiple_of(SHARED);
    pixels.div_ceil(tiles).next_multiple_of(BLOCK)
}

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
    /// Whether [`EventEmulator::causes`] tells why each event fired.
    pub causes: bool,
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
            causes: false,
        }
    }
}

/// What happened in one push, or in all of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EmulatorReport {
    /// Events that came out.
    pub events: u64,
    /// Pixel values that were NaN: those pixels kept their state. With an exposure, values of its frames: one is unknown
    /// where light was at any time of it.
    pub unknown: u64,
    /// Times that a pixel would have fired more events in one interval than it may.
    pub clamped: u64,
    /// Events that were lost to the refractory period.
    pub suppressed: u64,
    /// Events that the readout dropped: beyond its rate limit, or where too many waited for a bus.
    pub dropped: u64,
}

impl EmulatorReport {
    /// Adds another push's.
    pub fn add(&mut self, other: &Self) {
        self.events += other.events;
        self.unknown += other.unknown;
        self.clamped += other.clamped;
        self.suppressed += other.suppressed;
        self.dropped += other.dropped;
    }
}

/// Turns frames of `batch` environments into events.
///
/// Between two frames log luminance is straight, and a latched sensor sees only its ends; events lie in `(t0, t1]`,
/// sorted by (t, y, x, firing order). With an exposure, light is straight between pushes, and events come with the push that ends
/// the exposure of the frame that they lie before: late, but no later push brings earlier ones. Memory does not grow with
/// the stream's length, and no event depends on the number of threads, or on which other environments are in the batch.
#[derive(Debug)]
pub struct EventEmulator {
    config: EmulatorConfig,
    isa: Isa,
    workers: Option<WorkerPool>,
    tables: Tables,
    kernel: Kernel,
    environments: Vec<Environment>,
    now_us: Option<i64>,
    last: EmulatorReport,
    total: EmulatorReport,
    scratch_pool: ScratchPool,
    keyframe_reports: Vec<KeyframeReport>,
    /// Of the last push's events, per environment.
    causes: Vec<Vec<u8>>,
}

/// How pixels are computed: chosen once.
#[derive(Debug)]
enum Kernel {
    /// Thresholds alone.
    Ideal,
    /// Any stage.
    Chain(Box<Plan>),
    /// Brownian motion.
    Diffusion,
}

/// The pixels of one environment.
#[derive(Clone, Debug)]
struct Environment {
    key: Key,
    /// Whether its pixels have seen anything since the start or the last reset.
    started: bool,
    tiles: Vec<Tile>,
    spans: Vec<Span>,
    /// Events that have not left the sensor.
    queue: Queue,
    fired: Vec<Event>,
    report: EmulatorReport,
    /// What the last frame was, if it had depth and motion.
    keyframe: Option<Box<Keyframe>>,
    /// Where pixels see frames of light: what has not become one.
    exposing: Option<Box<Exposing>>,
}

/// Pixels that one thread treats at a time, with their memory.
#[derive(Clone, Debug)]
struct Tile {
    first: usize,
    end: usize,
    /// Nothing before the first frame says of which kind frames are.
    memory: Memory,
    records: Vec<Record>,
    /// Of the records, where they are asked for and can differ.
    causes: Vec<Cause>,
    /// What the first pass found.
    found: Scan,
    tally: Tally,
}

/// What a tile's pixels remember.
#[derive(Clone, Debug)]
enum Memory {
    /// No frame was seen.
    None,
    Ideal(Pixels),
    Chain(Box<Chain>),
    Diffusion(Diffuse),
}

impl EventEmulator {
    /// Checks `config` and makes an emulator that has seen nothing yet.
    ///
    /// # Errors
    /// Names the first setting that cannot be used, its value, and what would work.
    pub fn new(config: EmulatorConfig) -> Result<Self, ConfigError> {
        let (seed, camera) = (config.seed, config.camera);
        Self::keyed(config, |environment| Key::new(seed, environment, camera))
    }

    /// [`Self::new`], with the key that each environment is given.
    fn keyed(config: EmulatorConfig, key_of: impl Fn(u32) -> Key) -> Result<Self, ConfigError> {
        Sensor::new(config.sensor.clone())?;
        for (what, value) in [("width", config.width), ("height", config.height)] {
            if !(1..=65_536).contains(&value) {
                return Err(ConfigError::new(what, value, "between 1 and 65536 pixels"));
            }
        }
        if !(1..=MOST_ENVIRONMENTS).contains(&config.batch) {
            let remedy = format!("between 1 and {MOST_ENVIRONMENTS}");
            return Err(ConfigError::new("batch", config.batch, remedy));
        }
        if config.threads > MOST_THREADS {
            let remedy = format!("at most {MOST_THREADS}; 0 takes as many as there are cores");
            return Err(ConfigError::new("threads", config.threads, remedy));
        }
        // The least that a pixel remembers; what does not fit into the machine would end the process.
        let pixels = u64::from(config.width) * u64::from(config.height) * config.batch as u64;
        if let Some(bytes) = evis_limits::machine_memory().filter(|bytes| pixels > bytes / LEAST_PIXEL_BYTES)
        {
            let value = format!("{}x{} pixels, {} times", config.width, config.height, config.batch);
            let remedy = format!("smaller: this machine's {bytes} bytes of memory do not hold them");
            return Err(ConfigError::new("size", value, remedy));
        }
        let y_ref = config.reference_luminance;
        // Their reciprocal must be a number as well.
        if !(1e-30..=1e30).contains(&y_ref) {
            return Err(ConfigError::new("reference_luminance", y_ref, "between 1e-30 and 1e30"));
        }
        let threads = match config.threads {
            0 => std::thread::available_parallelism().map_or(1, usize::from),
            threads => threads,
        };
        let workers = if threads > 1 {
            let built = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            Some(WorkerPool::new(built.map_err(|error| {
                ConfigError::new("threads", threads, format!("fewer, the system refused: {error}"))
            })?))
        } else {
            None
        };
        let pixels = config.width as usize * config.height as usize;
        let tile = tile_pixels(pixels);
        let exposes = !config.sensor.exposure.is_off();
        let environment = |index: usize| Environment {
            key: key_of(index as u32),
            started: false,
            tiles: (0..pixels)
                .step_by(tile)
                .map(|first| Tile::new(first, (first + tile).min(pixels)))
                .collect(),
            spans: Vec::new(),
            queue: Queue::default(),
            fired: Vec::new(),
            report: EmulatorReport::default(),
            keyframe: None,
            exposing: exposes.then(|| Box::new(Exposing::new(pixels))),
        };
        let kernel = if config.sensor.diffusion.is_some() {
            Kernel::Diffusion
        } else if config.sensor.is_ideal_behind_exposure() {
            Kernel::Ideal
        } else {
            Kernel::Chain(Box::new(Plan::new(&config.sensor)))
        };
        let mut environments: Vec<Environment> = (0..config.batch).map(environment).collect();
        if let Kernel::Chain(plan) = &kernel {
            // What is frozen is drawn once, and not with the first frame.
            let make = |environment: &mut Environment| {
                for tile in &mut environment.tiles {
                    let numbering = Numbering::run(tile.first);
                    let chain = Chain::new(plan, environment.key, numbering, tile.end - tile.first);
                    tile.memory = Memory::Chain(Box::new(chain));
                }
            };
            match &workers {
                Some(workers) => workers.pool().install(|| environments.par_iter_mut().for_each(make)),
                None => environments.iter_mut().for_each(make),
            }
        }
        Ok(Self {
            isa: Isa::detect(),
            workers,
            tables: Tables::default(),
            environments,
            kernel,
            now_us: None,
            last: EmulatorReport::default(),
            total: EmulatorReport::default(),
            scratch_pool: ScratchPool::default(),
            keyframe_reports: Vec::new(),
            causes: Vec::new(),
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
        let before: Vec<usize> = out.iter().map(Vec::len).collect();
        let pixels = self.config.width as usize * self.config.height as usize;
        frames.check(pixels * self.config.batch)?;
        let inverse = 1.0 / self.config.reference_luminance;
        self.tables.prepare(frames, inverse, &self.config.sensor);
        let Self { config, isa, workers, tables, kernel, environments, .. } = self;
        let sources: Option<Vec<Source<'_>>> =
            (0..config.batch).map(|index| Source::new(frames, tables, inverse, index, pixels)).collect();
        // `check` counted the values.
        let sources = sources.ok_or_else(|| ConfigError::new("frames", "too short", "complete"))?;
        let exposes = !config.sensor.exposure.is_off();
        // Of frames that are made here, all are of one kind.
        let begun = environments.iter().find_map(Environment::begun).filter(|_| !exposes);
        if let (Some(tile), Some(source)) = (begun, sources.first()) {
            tile.check(source)?;
        }
        let start_us = t_us - i64::from(interval_us);
        let threads = match workers {
            Some(workers) if config.batch * pixels > TILE => Threads::Workers(workers),
            _ => Threads::One,
        };
        let work = Push { config, kernel, isa: *isa, threads, start_us, interval_us };
        // Nothing changes before all light has been found possible.
        if exposes {
            let eps = config.sensor.log_eps;
            let is_light = environments.iter_mut().zip(&sources).all(|(environment, source)| {
                environment.exposing.as_mut().is_none_or(|light| light.load(work.threads, source, eps))
            });
            if !is_light {
                return Err(impossible_light(frames, config));
            }
            let alone = Push { threads: Threads::One, ..work };
            let mut all: Vec<_> = environments.iter_mut().zip(&mut *out).collect();
            match all.as_mut_slice() {
                [(environment, events)] => environment.expose(&work, events),
                all => work.threads.each(all, |(environment, events)| environment.expose(&alone, events)),
            }
            self.pushed(t_us, out, &before);
            return Ok(());
        }
        let scans = scan(&work, environments, &sources);
        if scans.iter().any(|scan| scan.impossible) {
            return Err(impossible_light(frames, config));
        }
        fire(&work, environments, (&scans, &sources), out);
        self.pushed(t_us, out, &before);
        Ok(())
    }

    /// Ends a push of frames without depth and motion.
    fn pushed(&mut self, t_us: i64, out: &mut [Vec<Event>], before: &[usize]) {
        for environment in &mut self.environments {
            environment.keyframe = None;
        }
        self.keyframe_reports.clear();
        self.note(t_us);
        self.take_causes(out, before);
    }

    /// Takes the causes off the events of each list from `before` on.
    fn take_causes(&mut self, lists: &mut [Vec<Event>], before: &[usize]) {
        if self.config.causes {
            let news = lists.iter_mut().zip(before).filter_map(|(list, from)| list.get_mut(*from..));
            self.causes = news.map(take_causes).collect();
        }
    }

    /// Why each event of the last push fired, as numbers of [`Cause`]: a list per environment. Empty where
    /// [`EmulatorConfig::causes`] is off.
    pub fn causes(&self) -> &[Vec<u8>] {
        &self.causes
    }

    /// Adds up what a push to `t_us` did.
    fn note(&mut self, t_us: i64) {
        self.now_us = Some(t_us);
        self.last = EmulatorReport::default();
        for environment in &self.environments {
            self.last.add(&environment.report);
        }
        let last = self.last;
        self.total.add(&last);
    }

    /// Lets the environments `indices` (all, where there is no list) start again with their next frame. With all of them
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
                    self.environments[*index].restart();
                }
            }
            None => {
                for environment in &mut self.environments {
                    environment.restart();
                }
            }
        }
        if self.environments.iter().all(|environment| !environment.has_light()) {
            self.now_us = None;
        }
        Ok(())
    }

    /// Microseconds since the last frame; 0 for the first one.
    fn check_time(&self, t_us: i64) -> Result<u32, ConfigError> {
        if !(-MOST_T_US..=MOST_T_US).contains(&t_us) {
            return Err(ConfigError::new("t_us", t_us, format!("at most {MOST_T_US} microseconds from 0")));
        }
        let Some(now_us) = self.now_us else { return Ok(0) };
        if t_us <= now_us {
            return Err(ConfigError::new(
                "t_us",
                t_us,
                format!("above {now_us}, the time of the last frame"),
            ));
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
#[derive(Clone, Copy)]
struct Push<'a> {
    config: &'a EmulatorConfig,
    kernel: &'a Kernel,
    isa: Isa,
    threads: Threads<'a>,
    start_us: i64,
    interval_us: u32,
}

/// First pass: nothing that outlives a push changes. What it found, per environment.
fn scan(work: &Push<'_>, environments: &mut [Environment], sources: &[Source<'_>]) -> Vec<Scan> {
    let mut tiles = Vec::new();
    for (environment, source) in environments.iter_mut().zip(sources) {
        if !environment.started {
            environment.clear();
        }
        let (key, first_frame) = (environment.key, !environment.started);
        tiles.extend(environment.tiles.iter_mut().map(|tile| (tile, key, source, first_frame)));
    }
    work.threads.each(&mut tiles, |(tile, key, source, first_frame)| {
        tile.found = tile.scan(work, *key, source, *first_frame);
    });
    let of = |environment: &Environment| {
        environment.tiles.iter().map(|tile| tile.found).fold(Scan::default(), Scan::join)
    };
    environments.iter().map(of).collect()
}

/// Second pass, over light that was found possible: events, a list per environment.
fn fire(
    work: &Push<'_>,
    environments: &mut [Environment],
    (scans, sources): (&[Scan], &[Source<'_>]),
    out: &mut [Vec<Event>],
) {
    let mut tiles = Vec::new();
    for ((environment, scan), source) in environments.iter_mut().zip(scans).zip(sources) {
        let (key, most) = (environment.key, scan.most);
        tiles.extend(environment.tiles.iter_mut().map(|tile| (tile, key, source, most)));
    }
    work.threads.each(&mut tiles, |(tile, key, source, most)| tile.fire(work, *key, source, *most));
    // Environments are sorted side by side; one alone is shared out.
    if let ([environment], [scan], [events]) = (&mut *environments, scans, &mut *out) {
        environment.finish(work, scan, events);
    } else {
        let alone = Push { threads: Threads::One, ..*work };
        let mut all: Vec<_> = environments.iter_mut().zip(scans).zip(out).collect();
        work.threads.each(&mut all, |((environment, scan), events)| environment.finish(&alone, scan, events));
    }
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
    let remedy =
        if is_log { "finite, or NaN where unknown" } else { "finite and at least 0, or NaN where unknown" };
    ConfigError::new(&what, value, remedy)
}

impl Environment {
    /// Memory of the frames that were seen, if the kernel asks for frames of one kind.
    fn begun(&self) -> Option<&Pixels> {
        match self.tiles.first().map(|tile| &tile.memory) {
            Some(Memory::Ideal(pixels)) if self.started => Some(pixels),
            _ => None,
        }
    }

    /// Whether light has come since the start or the last reset.
    fn has_light(&self) -> bool {
        self.started || self.exposing.as_ref().is_some_and(|light| light.since_us.is_some())
    }

    /// Starts again with what comes next.
    fn restart(&mut self) {
        self.started = false;
        if let Some(light) = &mut self.exposing {
            light.since_us = None;
        }
    }

    /// Forgets everything but what is frozen.
    fn clear(&mut self) {
        self.queue = Queue::default();
        for tile in &mut self.tiles {
            match &mut tile.memory {
                // What a pixel is does not change.
                Memory::Chain(chain) => chain.clear(),
                memory => *memory = Memory::None,
            }
        }
    }

    /// Takes `light`, which was found possible, at the end of `work`'s interval.
    fn advance(&mut self, work: &Push<'_>, light: &[f32], events: &mut Vec<Event>) {
        let source =
            Source::Linear { values: light, inverse_reference: 1.0 / work.config.reference_luminance };
        match &mut self.exposing {
            Some(exposing) => {
                exposing.load(work.threads, &source, work.config.sensor.log_eps);
                self.expose(work, events);
            }
            None => self.sense(work, source, events),
        }
    }

    /// Both passes over light that was found possible.
    fn sense(&mut self, work: &Push<'_>, source: Source<'_>, events: &mut Vec<Event>) {
        let (environment, sources) = (std::slice::from_mut(self), [source]);
        let scans = scan(work, environment, &sources);
        fire(work, environment, (&scans, &sources), std::slice::from_mut(events));
    }

    /// Sorts what the tiles fired.
    fn finish(&mut self, work: &Push<'_>, scan: &Scan, events: &mut Vec<Event>) {
        self.started = true;
        let before = events.len();
        let parts: Vec<&[Record]> = self.tiles.iter().map(|tile| tile.records.as_slice()).collect();
        let readout = &work.config.sensor.readout;
        let mut dropped = 0;
        let marked = work.config.causes && matches!(work.kernel, Kernel::Chain(_));
        if readout.is_off() && !marked {
            append_sorted(&parts, work.start_us, work.interval_us, &mut self.spans, work.threads, events);
        } else {
            self.fired.clear();
            if marked {
                let all = self.tiles.iter().flat_map(|tile| tile.records.iter().zip(&tile.causes));
                let event =
                    |(record, cause): (&Record, &Cause)| record.event(work.start_us).with_cause(*cause);
                self.fired.extend(all.map(event));
            } else {
                let all = parts.iter().flat_map(|part| part.iter());
                self.fired.extend(all.map(|record| record.event(work.start_us)));
            }
            let end_us = work.start_us + i64::from(work.interval_us);
            if readout.is_off() {
                // Stable: by pixel and in firing order within a microsecond.
                self.fired.sort_by_key(|event| event.t);
                events.append(&mut self.fired);
            } else {
                dropped = self.queue.pass(readout, &mut self.fired, end_us, events);
            }
        }
        self.report = EmulatorReport {
            events: (events.len() - before) as u64,
            unknown: scan.unknown,
            dropped,
            ..EmulatorReport::default()
        };
        for tile in &self.tiles {
            self.report.clamped += tile.tally.clamped;
            self.report.suppressed += tile.tally.suppressed;
        }
    }
}

impl Tile {
    const fn new(first: usize, end: usize) -> Self {
        let tally = Tally { unknown: 0, clamped: 0, suppressed: 0 };
        let found = Scan { unknown: 0, impossible: false, most: 0 };
        Self { first, end, memory: Memory::None, records: Vec::new(), causes: Vec::new(), found, tally }
    }

    const fn interval<'a>(&self, work: &Push<'a>) -> Interval<'a> {
        Interval {
            sensor: &work.config.sensor,
            width: work.config.width,
            first: self.first,
            end: self.end,
            numbering: Numbering::run(self.first),
            us: work.interval_us,
        }
    }

    /// Memory that has seen nothing, for frames like `source`.
    fn begin(&mut self, kernel: &Kernel, key: Key, source: &Source<'_>) {
        let pixels = self.end - self.first;
        self.memory = match kernel {
            Kernel::Ideal => Memory::Ideal(Pixels::new(source, pixels)),
            Kernel::Chain(plan) => {
                Memory::Chain(Box::new(Chain::new(plan, key, Numbering::run(self.first), pixels)))
            }
            Kernel::Diffusion => Memory::Diffusion(Diffuse::new(pixels)),
        };
    }

    /// First pass: nothing that outlives a push changes.
    fn scan(&mut self, work: &Push<'_>, key: Key, source: &Source<'_>, first_frame: bool) -> Scan {
        let at = self.interval(work);
        if matches!(self.memory, Memory::None) {
            self.begin(work.kernel, key, source);
        }
        let (unknown, impossible) = match (&mut self.memory, work.kernel) {
            (Memory::Ideal(pixels), _) => pixels.scan(work.isa, *source, &at),
            (Memory::Chain(chain), Kernel::Chain(plan)) => {
                chain.rebase(work.start_us, first_frame);
                return chain.scan(work.isa, plan, source, &at, key, work.start_us);
            }
            (Memory::Diffusion(diffuse), _) => diffuse.scan(source, work.config.sensor.log_eps, &at),
            _ => (0, false),
        };
        Scan { unknown, impossible, most: 0 }
    }

    /// Second pass: events.
    fn fire(&mut self, work: &Push<'_>, key: Key, source: &Source<'_>, most: u32) {
        let at = self.interval(work);
        self.records.clear();
        self.causes.clear();
        let records = &mut self.records;
        self.tally = match (&mut self.memory, work.kernel) {
            (Memory::Ideal(pixels), _) => pixels.fire(work.isa, *source, &at, records),
            (Memory::Chain(chain), Kernel::Chain(plan)) => {
                let causes = work.config.causes.then_some(&mut self.causes);
                chain.fire(work.isa, plan, &at, key, (work.start_us, most), records, causes)
            }
            (Memory::Diffusion(diffuse), _) => {
                diffuse.fire(&work.config.sensor, &at, key, work.start_us, records)
            }
            _ => Tally::default(),
        };
    }
}

#[cfg(test)]
mod tests;
