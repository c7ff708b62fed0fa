//! Events of an ideal sensor from a scene.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use evis_core::emulator::parts::ReadoutQueue;
use evis_core::emulator::tiled::{Losses, SensorTile, TiledSensor};
use evis_core::event::take_causes;
use evis_core::random::Key;
use evis_core::{ConfigError, Event, Sensor, SensorConfig, TimeGrid};
use evis_scene::{Scene, Variant};
use rayon::prelude::*;

use crate::Error;
use crate::packed;
use crate::run::device::{Devices, Loaded, event_at};
use crate::run::frames::{FrameSensor, Taken, block_us};
use crate::run::sensing::Sensing;
use crate::scene::holes::Holes;
use crate::scene::tiles::{PIXELS, TILE};
use crate::scene::world::World;
use crate::shading::light::packed::RowPacker;
use crate::shading::light::{Lighting, Shared};
use crate::signal::events::Thresholds;
use crate::signal::knots::{TileLuminance, TileSignal};
use crate::signal::path::{PixelPath, STEP_PX, stride};
use crate::signal::pixel::{Evaluator, PixelActivity, UNITS, Work};
use crate::visibility::blocks::{Block, Blocks, Clock, blocks};
use crate::visibility::lists::{Entry, Lists, TileList};

/// Limits of [`Settings::step_px`].
const LEAST_STEP_PX: f64 = 0.05;
const MOST_STEP_PX: f64 = 8.0;

/// Settings of a run.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The sensor.
    pub sensor: SensorConfig,
    /// Of all that is random in it.
    pub key: Key,
    /// Frames per second that a sensor takes whose stages are defined on them ([`SensorConfig::needs_frames`]).
    pub rate_hz: f64,
    /// Threads that such a sensor's pixels are shared among; 0: as many as there are cores.
    pub sensor_threads: usize,
    /// Index of the camera.
    pub camera: usize,
    /// Width and height in pixels; `None` takes the camera's own.
    pub size: Option<(u32, u32)>,
    /// Scene time at which the stream starts, in microseconds.
    pub start_us: i64,
    /// Length in microseconds.
    pub duration_us: i64,
    /// Length of a block in microseconds, a power of two.
    pub block_us: i64,
    /// Pixels by which anything that a pixel sees moves in an interval, at most: light is a quadratic there, and intervals
    /// in which a threshold may be crossed are halved as often as it takes.
    pub step_px: f64,
    /// `Y_ref`; `None` takes the luminance that brings the picture's log-mean at the start to 0.18.
    pub reference_luminance: Option<f64>,
    /// What follows pixels where it can; the processor's cores where this is `None`.
    pub devices: Option<Arc<dyn Devices>>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            sensor: SensorConfig::default(),
            key: Key::new(0, 0, 0),
            rate_hz: 1000.0,
            sensor_threads: 0,
            camera: 0,
            size: None,
            start_us: 0,
            duration_us: 250_000,
            block_us: 32_768,
            step_px: STEP_PX,
            reference_luminance: None,
            devices: None,
        }
    }
}

impl Settings {
    pub(crate) fn check(&self) -> Result<(), Error> {
        Sensor::new(self.sensor.clone())?;
        TimeGrid::new(self.rate_hz)?;
        if !(64..=1 << 20).contains(&self.block_us) || self.block_us.count_ones() != 1 {
            let remedy = "a power of two between 64 and 1048576 microseconds";
            return Err(ConfigError::new("block_us", self.block_us, remedy).into());
        }
        if !(LEAST_STEP_PX..=MOST_STEP_PX).contains(&self.step_px) {
            let remedy = format!("between {LEAST_STEP_PX} and {MOST_STEP_PX} pixels");
            return Err(ConfigError::new("adaptive_px", self.step_px, remedy).into());
        }
        if !(1..=86_400_000_000).contains(&self.duration_us) {
            return Err(ConfigError::new("duration_us", self.duration_us, "above 0 and at most a day").into());
        }
        if !(0..=86_400_000_000).contains(&self.start_us) {
            return Err(ConfigError::new("start_us", self.start_us, "between 0 and a day").into());
        }
        Ok(())
    }

    /// The length of blocks: that asked for, or a shorter one that holds the frames of a sensor that takes them.
    pub(crate) fn most_us(&self) -> i64 {
        match self.sensor.needs_frames() {
            Some(_) => block_us(self.block_us, self.rate_hz),
            None => self.block_us,
        }
    }
}

/// What a run took. Seconds are of wall time, summed over threads.
#[derive(Clone, Copy, Debug, Default)]
pub struct Report {
    /// Records and tile lists.
    pub lists_s: f64,
    /// Light that is prepared per block.
    pub light_s: f64,
    /// All work on pixels.
    pub pixels_s: f64,
    /// Of that, coverage, extrapolated from every 64th evaluation.
    pub coverage_s: f64,
    /// Of that, shading, extrapolated likewise.
    pub shading_s: f64,
    /// Evaluations of a pixel.
    pub evaluations: u64,
    /// Entries of all pixels' lists, over all blocks.
    pub entries: u64,
    /// Pixels times blocks.
    pub pixel_blocks: u64,
    /// Of these, those in which something moves and light stays between a pixel's thresholds, as bounds say.
    pub quiet: u64,
    /// Of the evaluations, those on a device.
    pub on_device: u64,
    /// Pixels times blocks that a device left to the processor, since something of them did not fit.
    pub refollowed: u64,
    /// Evaluations of a pixel that one facet covers.
    pub plain: u64,
    /// Cells shaded.
    pub cells: u64,
    /// What the sensor lost.
    pub losses: Losses,
}

/// Events, and what they took.
pub struct Outcome {
    /// In canonical order.
    pub events: Vec<Event>,
    /// The `Y_ref` that they were made with.
    pub reference_luminance: f64,
    /// What it took.
    pub report: Report,
}

/// A row of tiles: its pixels' paths, and what they fired.
struct Row {
    /// Per pixel, of a sensor of thresholds.
    paths: Vec<Option<PixelPath>>,
    /// Per tile, of any other sensor: the light that it saw last.
    lights: Vec<Option<TileLuminance>>,
    /// Per tile, of one that is followed in continuous time.
    sensors: Vec<Option<SensorTile>>,
    /// Of one that takes frames: the columns of tiles that were followed through the block in work, and their light at all frames.
    columns: Vec<usize>,
    samples: Vec<f32>,
    events: Vec<Event>,
    report: Report,
    /// What a device is given of the block in work, and for each of its pixels the number among `paths`.
    packer: RowPacker,
    slots: Vec<usize>,
    /// Per tile, pixels that the device could not follow.
    failed: Vec<u64>,
}

/// How pixels are followed.
struct Following {
    thresholds: Thresholds,
    step_px: f64,
    start_us: i64,
    /// Which tiles are followed, row by row; all where it is empty.
    only: Vec<bool>,
    /// A sensor with more stages than thresholds, in continuous time.
    sensing: Option<Sensing>,
}

/// The pixels of one view: what they remember from block to block.
pub(crate) struct Pixels {
    rows: Vec<Row>,
    /// Per thread of the pool, and one for whoever is none of them.
    rooms: Vec<Mutex<Work>>,
    following: Following,
    /// Where events wait for their turn on the bus, of a sensor with more stages than thresholds.
    queue: Option<ReadoutQueue>,
    /// A sensor that takes frames.
    frames: Option<FrameSensor>,
    /// What follows pixels of a sensor of thresholds, where that is not the processor.
    device: Option<Loaded>,
    report: Report,
}

impl Pixels {
    /// Pixels that first see light at the start of `settings`; those of the tiles `only`, unless it is empty.
    ///
    /// # Errors
    /// A sensor that cannot be used.
    pub(crate) fn new(
        world: &World,
        settings: &Settings,
        reference_luminance: f64,
        only: &[bool],
    ) -> Result<Self, Error> {
        let rows = (world.lens.height as usize).div_ceil(TILE);
        let columns = (world.lens.width as usize).div_ceil(TILE);
        let thresholds = Thresholds::new(&settings.sensor, reference_luminance);
        let ideal = settings.sensor.is_ideal();
        let Settings { sensor, key, start_us, rate_hz, .. } = settings;
        let (mut sensing, mut frames) = (None, None);
        if sensor.needs_frames().is_some() {
            let size = [world.lens.width, world.lens.height];
            let stream = (reference_luminance, *start_us, *rate_hz);
            frames = Some(FrameSensor::new((sensor, *key), size, stream, settings.sensor_threads)?);
        } else if !ideal {
            sensing = Some(Sensing {
                sensor: TiledSensor::new(sensor, *key, world.lens.width)?,
                start_us: *start_us,
                reference: reference_luminance,
            });
        }
        let new_row = |_| Row {
            paths: if ideal { vec![None; columns * PIXELS] } else { Vec::new() },
            lights: if ideal { Vec::new() } else { vec![None; columns] },
            sensors: if sensing.is_some() { vec![None; columns] } else { Vec::new() },
            columns: Vec::new(),
            samples: Vec::new(),
            events: Vec::new(),
            report: Report::default(),
            packer: RowPacker::default(),
            slots: Vec::new(),
            failed: vec![0; columns],
        };
        let device = match settings.devices.as_ref().filter(|_| ideal) {
            Some(devices) => Some(Loaded::new(devices.open()?)),
            None => None,
        };
        Ok(Self {
            rows: (0..rows).map(new_row).collect(),
            rooms: (0..=rayon::current_num_threads()).map(|_| Mutex::default()).collect(),
            queue: sensing.as_ref().map(|sensing| sensing.sensor.queue()),
            following: Following {
                thresholds,
                step_px: settings.step_px,
                start_us: settings.start_us,
                only: only.to_vec(),
                sensing,
            },
            frames,
            device,
            report: Report::default(),
        })
    }

    /// Lets them all begin at `t_us` with what `picture` says of them, row by row.
    pub(crate) fn begin(&mut self, world: &World, picture: &[f64], t_us: f64) {
        let [width, height] = [world.lens.width, world.lens.height].map(|v| v as usize);
        let Following { thresholds, sensing, .. } = &self.following;
        for (row, of) in self.rows.iter_mut().enumerate() {
            let at = |slot: usize| {
                let (tile, pixel) = (slot / PIXELS, slot % PIXELS);
                let (x, y) = (tile * TILE + pixel % TILE, row * TILE + pixel / TILE);
                (x < width && y < height).then(|| picture[y * width + x])
            };
            for (slot, path) in of.paths.iter_mut().enumerate() {
                *path = at(slot).map(|luminance| PixelPath::new(t_us, luminance, thresholds));
            }
            for (column, light) in of.lights.iter_mut().enumerate() {
                let own = std::array::from_fn(|pixel| at(column * PIXELS + pixel).unwrap_or(f64::NAN));
                if let Some(sensing) = sensing {
                    of.sensors[column] = Some(sensing.begin([column, row], &own, t_us));
                }
                *light = Some(own);
            }
        }
    }

    /// What leaves the sensor during `block`, in canonical order, marked with causes and in stream time; `None` where `stop` was set meanwhile: then some of
    /// them are at its end and others are not. `jumps_next` says that light may jump at its end.
    ///
    /// # Errors
    /// A camera without a pose, and light that is no number.
    pub(crate) fn follow(
        &mut self,
        world: &World,
        lighting: &mut Lighting,
        (block, jumps_next): (Block, bool),
        stop: &AtomicBool,
    ) -> Result<Option<Vec<Event>>, Error> {
        let started = Instant::now();
        let mut clock = Clock::new(world, block);
        let lists = Lists::new(world, &mut clock)?;
        self.report.lists_s += started.elapsed().as_secs_f64();
        let started = Instant::now();
        lighting.prepare(&mut clock, &block)?;
        self.report.light_s += started.elapsed().as_secs_f64();
        let lighting = &*lighting;
        let taken = self.frames.as_mut().map(|frames| frames.taken(block, jumps_next));
        let (following, rooms, taken) = (&self.following, &self.rooms, taken.as_ref());
        let evaluator = Evaluator { world, lists: &lists, lighting, block, once: false };
        let each_row = |rows: &mut [Row], follow: &(dyn Fn(&mut Row, &mut Work, usize) + Sync)| {
            rows.par_iter_mut().enumerate().with_max_len(1).for_each(|(index, row)| {
                if !stop.load(Ordering::Relaxed) {
                    // Pages of pictures that rows share are found by the thread that rendered them.
                    let own = rayon::current_thread_index().unwrap_or(usize::MAX).min(rooms.len() - 1);
                    let mut work = rooms[own].lock().unwrap_or_else(PoisonError::into_inner);
                    follow(row, &mut work, index);
                }
            });
        };
        let packs = self.device.is_some();
        each_row(&mut self.rows, &|row, work, index| {
            row.follow(work, &evaluator, (following, taken), (index, packs));
        });
        if let Some(device) = self.device.as_mut().filter(|_| !stop.load(Ordering::Relaxed)) {
            let job = following.job(&evaluator);
            let mut from = 0;
            while from < self.rows.len() && !stop.load(Ordering::Relaxed) {
                let packed_rows =
                    |rows: &[Row]| packed::Row::that_fit(rows.iter().map(Row::packed), device.room());
                let until = from + packed_rows(&self.rows[from..]);
                let rows = &mut self.rows[from..until];
                let mut packed = packed::Block::new(job, rows.iter().map(Row::packed));
                let mut fired = device.follow(lighting, &mut packed)?;
                // Stable: those of one pixel are in firing order.
                fired.sort_by_key(|event| event.pixel);
                let (mut pixels, mut first) = (&packed.pixels[..], 0);
                for (index, row) in (from..).zip(rows) {
                    let own = pixels.split_off(..row.slots.len()).unwrap_or_default();
                    row.take(&evaluator, following, (first, own), &fired, index);
                    first += own.len();
                }
                from = until;
            }
            each_row(&mut self.rows, &|row, work, index| {
                row.follow_failed(work, &evaluator, following, index);
            });
        }
        if stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        if let (Some(frames), Some(taken)) = (&mut self.frames, taken) {
            let rows: Vec<_> = self.rows.iter().map(|row| (&row.samples[..], &row.columns[..])).collect();
            let mut events = Vec::new();
            self.report.losses.add(frames.take(taken, &rows, &mut events)?);
            return Ok(Some(events));
        }
        let mut events: Vec<Event> = self.rows.iter_mut().flat_map(|row| row.events.drain(..)).collect();
        // Stable: events of one pixel at one microsecond keep their firing order.
        events.sort_by_key(Event::order);
        if let Some(queue) = &mut self.queue {
            let end_us = block.end_us.floor() as i64 - following.start_us;
            let mut left = Vec::new();
            self.report.losses.dropped += queue.take(&mut events, end_us, &mut left);
            events = left;
        }
        Ok(Some(events))
    }

    /// Stream time before which all events are there, of a sensor that takes frames; of any other, that is where its last block
    /// ended.
    pub(crate) fn complete_us(&self) -> Option<i64> {
        self.frames.as_ref().map(FrameSensor::complete_us)
    }

    /// What it took so far.
    pub(crate) fn report(&self, lighting: &Lighting) -> Report {
        let mut report = self.report;
        for room in &self.rooms {
            let work = room.lock().unwrap_or_else(PoisonError::into_inner);
            report.plain += work.plain;
            report.coverage_s += work.coverage_s;
            report.shading_s += work.shading_s;
        }
        for Row { report: row, .. } in &self.rows {
            report.lists_s += row.lists_s;
            report.pixels_s += row.pixels_s;
            report.evaluations += row.evaluations;
            report.entries += row.entries;
            report.pixel_blocks += row.pixel_blocks;
            report.quiet += row.quiet;
            report.refollowed += row.refollowed;
            report.on_device += row.on_device;
            report.losses.add(row.losses);
        }
        report.cells = lighting.shaded.load(Ordering::Relaxed);
        report
    }
}

/// What `scene` makes an ideal sensor fire in [0, duration).
///
/// # Errors
/// A setting or a camera that cannot be used.
pub fn simulate(scene: &Scene, settings: &Settings) -> Result<Outcome, Error> {
    settings.check()?;
    let world = World::new(scene, settings.camera, settings.size)?;
    let mut lighting = Lighting::new(&world, &Shared::new(scene));
    let end_us = (settings.start_us + settings.duration_us) as f64;
    let mut blocks = Blocks::new(&world, settings.start_us, settings.most_us(), settings.block_us);
    let first = blocks.peek();
    let seen = match settings.reference_luminance {
        Some(_) => None,
        None => Some(picture(&world, &mut lighting, first, first.start_us)?),
    };
    let measured = || seen.as_deref().map_or(1.0, reference_luminance);
    let reference = settings.reference_luminance.unwrap_or_else(measured);
    let mut pixels = Pixels::new(&world, settings, reference, &[])?;
    if let Some(seen) = &seen {
        pixels.begin(&world, seen, first.start_us);
    }
    let mut events = Vec::new();
    while blocks.start_us() < end_us
        && let Some(block) = blocks.pop()
    {
        let found =
            pixels.follow(&world, &mut lighting, (block, blocks.next_jumps()), &AtomicBool::new(false))?;
        events.extend(found.into_iter().flatten());
    }
    events.retain(|e| (0..settings.duration_us).contains(&e.t));
    // Blocks may meet within a microsecond.
    events.sort_by_key(Event::order);
    take_causes(&mut events);
    Ok(Outcome { events, reference_luminance: reference, report: pixels.report(&lighting) })
}

impl Following {
    /// What all pixels of a block share.
    fn job(&self, evaluator: &Evaluator) -> packed::Job {
        let Evaluator { world, lists, lighting, block, .. } = evaluator;
        let [near, far] = [lists.depths.near, lists.depths.far].map(|depth| 1.0 / depth);
        let parallel = if lists.depths.far.is_finite() { packed::PARALLEL } else { 0 };
        let (own, lamps) = lighting.pack_lamps(centre_of(world), times_of(world, *block));
        packed::Job {
            length_us: block.length_us() as f32,
            start_us: (block.start_us - block.start_us.floor()) as f32,
            near: near as f32,
            far: far as f32,
            background: lighting.plain_background().unwrap_or(0.0) as f32,
            flags: parallel | if block.jump { packed::JUMPS } else { 0 },
            lamps,
            own,
            ..self.thresholds.pack()
        }
    }
}

/// The middle of the picture without distortion.
fn centre_of(world: &World) -> [f64; 2] {
    [world.lens.width, world.lens.height].map(|v| 0.5 * f64::from(v))
}

/// Seconds of the scene at the start of `block`, and during it.
fn times_of(world: &World, block: Block) -> [f64; 2] {
    let [start_s, end_s] = [block.start_us, block.end_us].map(|t_us| world.scene_seconds(t_us));
    [start_s, end_s - start_s]
}

impl Row {
    fn follow(
        &mut self,
        work: &mut Work,
        evaluator: &Evaluator,
        (following, taken): (&Following, Option<&Taken>),
        (row, packs): (usize, bool),
    ) {
        self.columns.clear();
        self.samples.clear();
        if packs {
            self.slots.clear();
            self.packer.begin(centre_of(evaluator.world), times_of(evaluator.world, evaluator.block));
        }
        let columns = evaluator.lists.columns;
        let only = following.only.get(row * columns..(row + 1) * columns).unwrap_or_default();
        if !only.is_empty() && !only.contains(&true) {
            return;
        }
        let started = Instant::now();
        let wanted = |column: usize| only.get(column) != Some(&false);
        let tiles = evaluator.lists.row_where(evaluator.world, row, wanted);
        self.report.lists_s += started.elapsed().as_secs_f64();
        let started = Instant::now();
        for (column, tile) in tiles.iter().enumerate().filter(|(column, _)| wanted(*column)) {
            self.tile(work, evaluator, (following, taken), tile, ([column, row], None, packs));
        }
        self.report.pixels_s += started.elapsed().as_secs_f64();
    }

    fn packed(&self) -> &packed::Row {
        &self.packer.row
    }

    /// Takes what a device made of the `pixels` of this row, number `row`, from number `first` of the block on, and of all that
    /// `fired`, pixel by pixel.
    fn take(
        &mut self,
        evaluator: &Evaluator,
        following: &Following,
        (first, pixels): (usize, &[packed::Pixel]),
        fired: &[packed::Event],
        row: usize,
    ) {
        let block = evaluator.block;
        let start_us = block.start_us.floor() as i64 - following.start_us;
        let mut fired = &fired[fired.partition_point(|event| (event.pixel as usize) < first)..];
        for ((index, pixel), &slot) in (first..).zip(pixels).zip(&self.slots) {
            let own = fired.iter().take_while(|event| event.pixel as usize == index).count();
            let own = fired.split_off(..own).unwrap_or_default();
            let (column, number) = (slot / PIXELS, slot % PIXELS);
            if pixel.failed != 0 {
                self.failed[column] |= 1 << number;
                continue;
            }
            let place = [column * TILE + number % TILE, row * TILE + number / TILE].map(|v| v as u16);
            self.events.extend(own.iter().map(|event| event_at(*event, start_us, place)));
            self.report.evaluations += u64::from(pixel.evaluations);
            self.report.on_device += u64::from(pixel.evaluations);
            if let Some(path) = &mut self.paths[slot] {
                path.unpack(block, pixel);
            }
        }
    }

    /// Follows what a device could not.
    fn follow_failed(&mut self, work: &mut Work, evaluator: &Evaluator, following: &Following, row: usize) {
        if self.failed.iter().all(|pixels| *pixels == 0) {
            return;
        }
        let failed = std::mem::take(&mut self.failed);
        let tiles = evaluator.lists.row_where(evaluator.world, row, |column| failed[column] != 0);
        for (column, tile) in tiles.iter().enumerate().filter(|(column, _)| failed[*column] != 0) {
            self.report.refollowed += u64::from(failed[column].count_ones());
            let place = ([column, row], Some(failed[column]), false);
            self.tile(work, evaluator, (following, None), tile, place);
        }
        self.failed = vec![0; failed.len()];
    }

    fn tile(
        &mut self,
        work: &mut Work,
        evaluator: &Evaluator,
        (following, taken): (&Following, Option<&Taken>),
        list: &TileList,
        ([column, row], only, packs): ([usize; 2], Option<u64>, bool),
    ) {
        let entries = &list.entries[..];
        let Following { thresholds, step_px, start_us, sensing, .. } = following;
        let block = evaluator.block;
        let lens = &evaluator.world.lens;
        evaluator.enter_tile(work, list, [column, row]);
        let (width, height) = (lens.width as usize, lens.height as usize);
        let place = |pixel: usize| (column * TILE + pixel % TILE, row * TILE + pixel / TILE);
        let seen = evaluator.world.tile([column, row]).pixels;
        let inside =
            |pixel: &usize| seen >> *pixel & 1 == 1 && place(*pixel).0 < width && place(*pixel).1 < height;
        // Of a tile whose others a device has followed.
        let (again, only) = (only.is_some(), only.unwrap_or(u64::MAX));
        let mut activities = [None; PIXELS];
        for pixel in (0..PIXELS).filter(inside) {
            activities[pixel] = Some(evaluator.activity(work, entries, pixel));
            if !again {
                self.report.entries += work.entry_count(pixel) as u64;
                self.report.pixel_blocks += 1;
            }
        }
        if sensing.is_some() || taken.is_some() {
            let (before, with) = (self.lights[column].as_ref(), (evaluator, &mut *work));
            let accuracy = (*step_px, thresholds.floor());
            let signal = TileSignal::follow(before, with, (entries, &activities), accuracy);
            self.report.evaluations += signal.evaluations;
            if let Some(sensing) = sensing {
                let (tile, at) = (&mut self.sensors[column], (block, [column, row]));
                self.report.losses.add(sensing.follow(tile, at, &signal, &mut self.events));
            }
            if let Some(taken) = taken {
                self.columns.push(column);
                taken.sample(&signal, &mut self.samples);
            }
            self.lights[column] = Some(*signal.last());
            return;
        }
        let mut resting = 0_u64;
        for (pixel, activity) in activities.iter().enumerate() {
            let Some(activity) = activity else { continue };
            let path = self.paths[column * PIXELS + pixel].as_mut();
            if !activity.still
                && only >> pixel & 1 == 1
                && let Some(path) = path
                && evaluator.stays_within(work, pixel, path.quiet(thresholds))
            {
                path.rest();
                self.report.quiet += 1;
                resting |= 1 << pixel;
                continue;
            }
            evaluator.expect(work, pixel, stride(block, *step_px, activity));
        }
        let follows = only & !resting;
        if packs && self.pack(work, evaluator, following, entries, (&activities, follows, column)) {
            return;
        }
        for (pixel, activity) in activities.iter().enumerate().filter(|(pixel, _)| follows >> pixel & 1 == 1)
        {
            let (Some(activity), (x, y)) = (activity, place(pixel)) else { continue };
            evaluator.enter_pixel(work, pixel);
            let slot = column * PIXELS + pixel;
            let path = self.paths[slot].get_or_insert_with(|| {
                PixelPath::new(block.start_us, evaluator.first_luminance(work, entries), thresholds)
            });
            let light = |unit: u32| evaluator.luminance(work, entries, unit);
            let events = &mut self.events;
            self.report.evaluations +=
                path.walk(thresholds, block, *step_px, activity, light, |t_us, polarity| {
                    let t = t_us.floor() as i64 - start_us;
                    events.push(Event::new(t, x as u16, y as u16, polarity));
                });
        }
    }

    /// Leaves those of the pixels `follows` of a tile of which anything changes to a device; false where that cannot show them.
    fn pack(
        &mut self,
        work: &mut Work,
        evaluator: &Evaluator,
        following: &Following,
        entries: &[Entry],
        (activities, follows, column): (&[Option<PixelActivity>; PIXELS], u64, usize),
    ) -> bool {
        let block = evaluator.block;
        let moves = |activity: &PixelActivity| !activity.still || block.jump;
        let pixels = activities.iter().enumerate().filter(|(_, a)| a.as_ref().is_some_and(moves));
        let pixels = follows & pixels.fold(0, |pixels, (pixel, _)| pixels | 1 << pixel);
        if pixels == 0 {
            return true;
        }
        let Following { thresholds, step_px, .. } = following;
        let Some(packed) = evaluator.pack(work, entries, pixels, &mut self.packer) else { return false };
        for mut packed in packed {
            let pixel = packed.number as usize;
            let (Some(activity), slot) = (&activities[pixel], column * PIXELS + pixel) else { continue };
            let path = self.paths[slot].get_or_insert_with(|| {
                evaluator.enter_pixel(work, pixel);
                PixelPath::new(block.start_us, evaluator.first_luminance(work, entries), thresholds)
            });
            packed.stride = stride(block, *step_px, activity);
            packed.least = PixelPath::least(*step_px, activity);
            path.pack(block, &mut packed);
            self.packer.row.pixels.push(packed);
            self.slots.push(slot);
        }
        true
    }
}

/// Mean luminance of every pixel at `t_us` of scene time (rounded to 1/3072 of a block), row by row: what [`simulate`] crosses thresholds with.
///
/// # Errors
/// As [`simulate`].
pub fn luminance(scene: &Scene, settings: &Settings, t_us: f64) -> Result<Vec<f64>, Error> {
    luminance_of(scene, None, settings, t_us)
}

/// As [`luminance`], in one of the scene's environments.
///
/// # Errors
/// As [`simulate`].
pub fn luminance_of(
    scene: &Scene,
    variant: Option<&Variant>,
    settings: &Settings,
    t_us: f64,
) -> Result<Vec<f64>, Error> {
    settings.check()?;
    let world = World::of_variant(
        scene,
        variant,
        settings.camera,
        settings.size,
        &Holes::of(scene, settings.size)?,
        &[],
    )?;
    let mut lighting = Lighting::new(&world, &Shared::new(scene));
    let length_us = world.block_us(settings.block_us);
    let length = length_us as f64;
    let from = (t_us / length).floor() * length;
    let around = blocks(scene, variant, from, from + length, length_us);
    let inside = around.into_iter().find(|b| (b.start_us..b.end_us).contains(&t_us));
    let block = inside.unwrap_or(Block { start_us: from, end_us: from + length, jump: false });
    picture(&world, &mut lighting, block, t_us)
}

/// Mean luminance of every pixel at `t_us`, which is in `block`, row by row.
///
/// # Errors
/// A camera without a pose.
pub(crate) fn picture(
    world: &World,
    lighting: &mut Lighting,
    block: Block,
    t_us: f64,
) -> Result<Vec<f64>, Error> {
    let mut clock = Clock::new(world, block);
    let lists = Lists::new(world, &mut clock)?;
    lighting.prepare(&mut clock, &block)?;
    let evaluator = Evaluator { world, lists: &lists, lighting, block, once: true };
    let part = (t_us - block.start_us) / block.length_us();
    let unit = (part.clamp(0.0, 1.0) * f64::from(UNITS)).round() as u32;
    let width = world.lens.width as usize;
    let mut out = vec![0.0; width * world.lens.height as usize];
    out.par_chunks_mut(width * TILE).enumerate().for_each(|(row, out)| {
        let mut work = Work::default();
        for (column, list) in lists.row(world, row).iter().enumerate() {
            let tile = &list.entries[..];
            evaluator.enter_tile(&mut work, list, [column, row]);
            let place = |pixel: usize| (column * TILE + pixel % TILE, pixel / TILE);
            let height = out.len() / width;
            let seen = world.tile([column, row]).pixels;
            let inside = |pixel: &usize| {
                seen >> *pixel & 1 == 1 && place(*pixel).0 < width && place(*pixel).1 < height
            };
            for pixel in (0..PIXELS).filter(inside) {
                evaluator.activity(&mut work, tile, pixel);
                evaluator.expect(&mut work, pixel, 1);
            }
            for pixel in (0..PIXELS).filter(inside) {
                let (x, y) = place(pixel);
                evaluator.enter_pixel(&mut work, pixel);
                out[y * width + x] = evaluator.luminance(&mut work, tile, unit);
            }
        }
    });
    Ok(out)
}

/// What sends less than this part of a picture's mean luminance is dark: what rounding leaves of areas that shadows cover.
const DARK: f64 = 1e-5;

/// `Y_ref` that brings the log-mean of what is lit in `picture` to 0.18.
pub(crate) fn reference_luminance(picture: &[f64]) -> f64 {
    let bright = || picture.iter().filter(|y| **y > 0.0 && y.is_finite());
    let mean = bright().sum::<f64>() / bright().count().max(1) as f64;
    let (sum, count) = bright()
        .filter(|y| **y > DARK * mean)
        .fold((0.0, 0_u64), |(sum, count), y| (sum + y.ln(), count + 1));
    let reference = (sum / count.max(1) as f64).exp() / 0.18;
    if count > 0 && reference.is_finite() && reference > 0.0 { reference } else { 1.0 }
}
