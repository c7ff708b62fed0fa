//! The pixels of views: what they remember from block to block.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use evis_core::Event;
use evis_core::emulator::parts::ReadoutQueue;
use evis_core::emulator::tiled::TiledSensor;
use rayon::prelude::*;

use crate::Error;
use crate::packed::{self, Kept};
use crate::run::device::{Followed, Loaded, Packs, Stages, ViewRow, ViewSensor};
use crate::run::frames::{FrameSensor, Taken};
use crate::run::row::{Following, Row};
use crate::run::sensing::Sensing;
use crate::run::settings::{Report, Settings};
use crate::scene::tiles::{PIXELS, TILE};
use crate::scene::world::World;
use crate::shading::light::Lighting;
use crate::signal::events::Thresholds;
use crate::signal::path::PixelPath;
use crate::signal::pixel::{Evaluator, Work};
use crate::visibility::blocks::{Block, Clock};
use crate::visibility::lists::Lists;

/// The pixels of one view: what they remember from block to block.
pub(crate) struct Pixels {
    /// Index of the view, and what it is.
    view: usize,
    own: ViewSensor,
    /// They have begun on the device that has the sensor's stages, and what these have fired.
    begun: bool,
    fired: Vec<Event>,
    rows: Vec<Row>,
    /// Per thread of the pool, and one for whoever is none of them.
    rooms: Vec<Mutex<Work>>,
    following: Following,
    /// Where events wait for their turn on the bus, of a sensor with more stages than thresholds.
    queue: Option<ReadoutQueue>,
    /// A sensor that takes frames.
    frames: Option<FrameSensor>,
    /// Appearances of facets as a device has them, and the version of light that they are of.
    looks: Option<(u64, Kept)>,
    report: Report,
}

/// A view that goes through a block.
pub(crate) struct Turn<'t, 'w> {
    /// What it sees.
    pub world: &'w World<'w>,
    /// The light of that.
    pub lighting: &'t mut Lighting<'w>,
    /// Its pixels.
    pub pixels: &'t mut Pixels,
    /// The block.
    pub block: Block,
    /// Light may jump at its end.
    pub jumps_next: bool,
}

/// A view whose block is prepared.
struct Entered<'t> {
    pixels: &'t mut Pixels,
    evaluator: Evaluator<'t>,
    /// The frames of the block, of a sensor that takes them.
    taken: Option<Taken>,
}

/// What leaves the sensors of all views of `turns`, view by view, in canonical order, marked with causes and in stream time; pixels
/// of sensors of two thresholds by `device`, where there is one, and all views together. `None` where `stop` was set meanwhile:
/// then some of them are at the block's end and others are not.
///
/// # Errors
/// A camera without a pose, light that is no number, and a device that fails.
pub(crate) fn follow(
    mut turns: Vec<Turn>,
    mut device: Option<&mut Loaded>,
    stop: &AtomicBool,
) -> Result<Option<Vec<Vec<Event>>>, Error> {
    let lists: Vec<Lists> = turns.par_iter_mut().map(Turn::prepare).collect::<Result<_, _>>()?;
    let mut entered: Vec<Entered> =
        turns.into_iter().zip(&lists).map(|(turn, lists)| turn.enter(lists)).collect();
    let mut packs =
        |own: &Entered| device.as_mut().map(|device| device.packs(own.pixels.view, &own.pixels.own));
    let packs: Vec<Option<Packs>> = entered.iter().map(&mut packs).collect();
    entered.par_iter_mut().zip(&packs).with_max_len(1).for_each(|(own, packs)| own.follow(*packs, stop));
    if let Some(device) = device {
        follow_on(device, (&mut entered, &packs), stop)?;
        entered.par_iter_mut().with_max_len(1).for_each(|own| own.follow_failed(stop));
    }
    if stop.load(Ordering::Relaxed) {
        return Ok(None);
    }
    entered.iter_mut().map(Entered::leave).collect::<Result<_, _>>().map(Some)
}

/// Leaves the pixels that views have packed to `device`.
fn follow_on(
    device: &mut Loaded,
    (entered, packs): (&mut [Entered], &[Option<Packs>]),
    stop: &AtomicBool,
) -> Result<(), Error> {
    let stays: Vec<bool> = packs.iter().map(|packs| packs.is_some_and(|packs| packs.stays)).collect();
    if let Some(stages) = device.stages() {
        let mut own = entered.iter_mut().zip(&stays).filter(|(_, stays)| **stays);
        own.try_for_each(|(own, _)| own.begin(stages))?;
    }
    let has_pixels = |row: &Row| !row.packed().is_empty();
    // Rows by view, row and job: a view in which nothing moves has none.
    let mut places = Vec::new();
    let mut jobs = Vec::new();
    for (view, Entered { pixels, evaluator, .. }) in entered.iter_mut().enumerate() {
        let rows = pixels.rows.iter().enumerate().filter(|(_, row)| has_pixels(row));
        places.extend(rows.map(|(row, _)| (view, row, jobs.len())));
        if places.last().is_none_or(|(last, ..)| *last != view) {
            continue;
        }
        let version = evaluator.lighting.version();
        let known = pixels.looks.take().filter(|(known, _)| *known == version);
        let (_, looks) = known.unwrap_or_else(|| (version, device.looks(evaluator.lighting)));
        pixels.looks = Some((version, looks.clone()));
        jobs.push((pixels.following.job(evaluator), looks));
    }
    let mut places = &places[..];
    while !places.is_empty() && !stop.load(Ordering::Relaxed) {
        let of = |&(view, row, job): &(usize, usize, usize)| {
            let (job, looks) = &jobs[job];
            let pixels = &entered[view].pixels;
            ViewRow { view: pixels.view, job, looks, row: pixels.rows[row].packed(), stays: stays[view] }
        };
        let rows: Vec<ViewRow> = places.iter().map(of).collect();
        let Followed { rows, pixels, found } = device.follow(&rows)?;
        let packed::Found { events, light, mut light_at, failed, evaluations, quiet } = found;
        let (mut first, mut pixels, mut light) = (pixels.len() as u32, pixels, &light[..]);
        let (mut events, mut failed) = (&events[..], &failed[..]);
        let own_rows = places.split_off(..rows).unwrap_or_default();
        // They are counted for all views together.
        if let Some(&(view, ..)) = own_rows.first() {
            let report = &mut entered[view].pixels.report;
            report.evaluations += evaluations;
            report.on_device += evaluations;
            report.quiet += quiet;
        }
        for &(view, row, _) in own_rows {
            let Entered { pixels: Pixels { rows, following, .. }, evaluator, .. } = &mut entered[view];
            let own = &mut rows[row];
            let packed = own.packed();
            let own_pixels = pixels.split_off(..packed.pixels.len()).unwrap_or_default();
            let count = packed.light;
            let own_light = light.split_off(..count).unwrap_or_default();
            own.take_light(own_pixels, own_light, stays[view].then_some(light_at));
            light_at += count as u32;
            let end = first + own.prepared_pixels() as u32;
            let fired = events.partition_point(|event| event.pixel < end);
            let fired = events.split_off(..fired).unwrap_or_default();
            let left = failed.partition_point(|failed| failed.pixel < end);
            let left = failed.split_off(..left).unwrap_or_default();
            own.take_events(evaluator, following, first, (fired, left), row);
            first = end;
        }
        // Before the next rows: light is long.
        entered.par_iter_mut().with_max_len(1).for_each(|own| own.sense(stop));
        if let Some(stages) = device.stages().filter(|stages| stages.is_full()) {
            take_stages(stages, (entered, &stays))?;
        }
    }
    if let Some(stages) = device.stages().filter(|_| !stop.load(Ordering::Relaxed) && stays.contains(&true)) {
        take_stages(stages, (entered, &stays))?;
    }
    Ok(())
}

/// Lets `stages` take the light of rows that have been followed since it was called last.
fn take_stages(stages: &mut dyn Stages, (entered, stays): (&mut [Entered], &[bool])) -> Result<(), Error> {
    let first = stages.light_count();
    let mut more = Vec::new();
    let staged = || stays.iter().enumerate().filter(|(_, stays)| **stays).map(|(view, _)| view);
    let seen: Vec<packed::Seen> = staged().map(|view| entered[view].seen(first, &mut more)).collect();
    let (events, losses) = stages.sense(&seen, &more)?;
    for (number, (view, mut events)) in staged().zip(events).enumerate() {
        let pixels = &mut entered[view].pixels;
        pixels.fired.append(&mut events);
        // What is lost is counted for all views together.
        if number == 0 {
            pixels.report.losses.add(losses);
        }
    }
    Ok(())
}

impl<'t> Turn<'t, '_> {
    /// Finds what the block may show, and its light.
    fn prepare(&mut self) -> Result<Lists, Error> {
        let Self { world, lighting, pixels, block, .. } = self;
        let started = Instant::now();
        let mut clock = Clock::new(world, *block);
        let lists = Lists::new(world, &mut clock)?;
        pixels.report.lists_s += started.elapsed().as_secs_f64();
        let started = Instant::now();
        lighting.prepare(&mut clock)?;
        pixels.report.light_s += started.elapsed().as_secs_f64();
        Ok(lists)
    }

    fn enter(self, lists: &'t Lists) -> Entered<'t> {
        let Self { world, lighting, pixels, block, jumps_next } = self;
        pixels.following.number += 1;
        let taken = pixels.frames.as_mut().map(|frames| frames.taken(block, jumps_next));
        Entered { pixels, evaluator: Evaluator { world, lists, lighting, block }, taken }
    }
}

impl Entered<'_> {
    /// Follows rows of tiles, or packs them for a device.
    fn follow(&mut self, packs: Option<Packs>, stop: &AtomicBool) {
        let Self { pixels, evaluator, taken } = self;
        let Pixels { rows, rooms, following, .. } = &mut **pixels;
        each_row(rows, (rooms, stop), |row, work, index| {
            row.follow(work, evaluator, (following, taken.as_ref()), (index, packs));
        });
    }

    /// Lets the pixels of a view that `stages` are of begin, where they have not: rows know their first light.
    fn begin(&mut self, stages: &mut dyn Stages) -> Result<(), Error> {
        let Self { pixels, evaluator, .. } = self;
        if std::mem::replace(&mut pixels.begun, true) {
            return Ok(());
        }
        let light = |light: f64| if light.is_nan() { 0.0 } else { light as f32 };
        let tiles: Vec<_> = pixels.rows.iter().map(Row::first_light).collect();
        let of = |row: usize, slot: usize| light(tiles[row][slot / PIXELS][slot % PIXELS]);
        let picture = of_tiles(pixels.own.size, of);
        let t_us = evaluator.block.start_us.round() as i64 - pixels.following.start_us;
        stages.begin(pixels.view, &pixels.own, t_us, &picture)
    }

    /// What its pixels have seen of the block, as far as that is known and was not taken; light that was found here is appended to
    /// `more`, which will lie from number `first` on.
    fn seen(&mut self, first: u32, more: &mut Vec<f32>) -> packed::Seen {
        let Self { pixels, evaluator, .. } = self;
        let block = evaluator.block;
        let tiles: Vec<_> = pixels.rows.iter_mut().map(|row| row.staged(first, more)).collect();
        let resting = [0, packed::LIGHT_RESTS];
        let of = |row: usize, slot: usize| tiles[row].as_ref().map_or(resting, |row: &Vec<_>| row[slot]);
        packed::Seen {
            view: pixels.view,
            span_us: [block.start_us, block.end_us].map(|t_us| t_us - pixels.following.start_us as f64),
            pixels: of_tiles(pixels.own.size, of),
        }
    }

    /// Gives sensors the light that a device has found.
    fn sense(&mut self, stop: &AtomicBool) {
        let Self { pixels, evaluator, taken } = self;
        let Pixels { rows, rooms, following, .. } = &mut **pixels;
        each_row(rows, (rooms, stop), |row, work, index| {
            row.sense(work, evaluator, (following, taken.as_ref()), index);
        });
    }

    /// Follows what a device could not.
    fn follow_failed(&mut self, stop: &AtomicBool) {
        let Self { pixels, evaluator, .. } = self;
        let Pixels { rows, rooms, following, .. } = &mut **pixels;
        each_row(rows, (rooms, stop), |row, work, index| {
            row.follow_failed(work, evaluator, following, index);
        });
    }

    /// What has left the sensor.
    fn leave(&mut self) -> Result<Vec<Event>, Error> {
        let Pixels { rows, fired, following, queue, frames, report, .. } = &mut *self.pixels;
        if let (Some(frames), Some(taken)) = (frames, &self.taken) {
            let rows: Vec<_> = rows.iter().map(|row| (&row.samples[..], &row.columns[..])).collect();
            let mut events = Vec::new();
            report.losses.add(frames.take(taken, &rows, &mut events)?);
            return Ok(events);
        }
        let mut events = std::mem::take(fired);
        events.reserve(rows.iter().map(|row| row.events.len()).sum());
        rows.iter_mut().for_each(|row| events.append(&mut row.events));
        // Stable: events of one pixel at one microsecond keep their firing order.
        events.sort_by_key(Event::order);
        if let Some(queue) = queue {
            let end_us = self.evaluator.block.end_us.floor() as i64 - following.start_us;
            let mut left = Vec::new();
            report.losses.dropped += queue.take(&mut events, end_us, &mut left);
            events = left;
        }
        Ok(events)
    }
}

/// What tiles have of their pixels, `of` the row of tiles and the number of the pixel in it, row of pixels by row of pixels.
fn of_tiles<T>([width, height]: [u32; 2], of: impl Fn(usize, usize) -> T) -> Vec<T> {
    let [width, height] = [width, height].map(|v| v as usize);
    let slot = |x: usize, y: usize| x / TILE * PIXELS + y % TILE * TILE + x % TILE;
    (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| of(y / TILE, slot(x, y))).collect()
}

/// Calls `follow` for each of `rows`, with the room of the thread that does, until `stop` is set.
fn each_row(
    rows: &mut [Row],
    (rooms, stop): (&[Mutex<Work>], &AtomicBool),
    follow: impl Fn(&mut Row, &mut Work, usize) + Sync,
) {
    rows.par_iter_mut().enumerate().with_max_len(1).for_each(|(index, row)| {
        if !stop.load(Ordering::Relaxed) {
            // Pages of pictures that rows share are found by the thread that rendered them.
            let own = rayon::current_thread_index().unwrap_or(usize::MAX).min(rooms.len() - 1);
            let mut work = rooms[own].lock().unwrap_or_else(PoisonError::into_inner);
            follow(row, &mut work, index);
        }
    });
}

impl Pixels {
    /// Leaves out no tile, though nothing of it changes, unless it `rests`.
    pub(crate) fn set_rests(&mut self, rests: bool) {
        self.following.rests = rests;
    }

    /// Pixels that first see light at the start of `settings`; those of the tiles `only`, unless it is empty.
    ///
    /// # Errors
    /// A sensor that cannot be used.
    pub(crate) fn new(
        (world, view): (&World, usize),
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
        let new_row = |_| Row::new(columns, ideal, sensing.is_some());
        Ok(Self {
            view,
            own: ViewSensor {
                sensor: sensor.clone(),
                key: *key,
                size: [world.lens.width, world.lens.height],
                reference_luminance: reference_luminance as f32,
            },
            begun: false,
            fired: Vec::new(),
            rows: (0..rows).map(new_row).collect(),
            rooms: (0..=rayon::current_num_threads()).map(|_| Mutex::default()).collect(),
            queue: sensing.as_ref().map(|sensing| sensing.sensor.queue()),
            following: Following {
                thresholds,
                step_px: settings.step_px,
                start_us: settings.start_us,
                number: 0,
                only: only.to_vec(),
                senses: sensing.is_some() || frames.is_some(),
                rests: true,
                sensing,
            },
            frames,
            looks: None,
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
            of.begin();
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

    /// Stream time before which all events are there, of a sensor that takes frames; of any other, that is where its last block
    /// ended.
    pub(crate) fn complete_us(&self) -> Option<i64> {
        self.frames.as_ref().map(FrameSensor::complete_us)
    }

    /// What it is.
    pub(crate) fn own(&self) -> &ViewSensor {
        &self.own
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
            report.resting += row.resting;
            report.refollowed += row.refollowed;
            report.on_device += row.on_device;
            report.losses.add(row.losses);
        }
        report.places = lighting.shaded.load(Ordering::Relaxed);
        report
    }
}
