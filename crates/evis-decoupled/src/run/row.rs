//! A row of tiles: its pixels' paths, and what they fire during a block.

use std::ops::Range;
use std::time::Instant;

use evis_core::Event;
use evis_core::emulator::tiled::SensorTile;

use crate::packed;
use crate::run::device::{Packs, event_at};
use crate::run::frames::Taken;
use crate::run::sensing::Sensing;
use crate::run::settings::Report;
use crate::scene::tiles::{PIXELS, TILE};
use crate::scene::world::World;
use crate::shading::light::bits;
use crate::shading::light::packed::{RowPacker, halves, whole};
use crate::shading::shadow::Beam;
use crate::signal::events::Thresholds;
use crate::signal::knots::{Knots, TileLuminance, TileSignal};
use crate::signal::path::{PixelPath, stride};
use crate::signal::pixel::{Evaluator, PixelActivity, Work};
use crate::visibility::blocks::Block;
use crate::visibility::lists::{Entry, TileList};

/// A row of tiles: its pixels' paths, and what they fired.
pub(crate) struct Row {
    /// Per pixel, of a sensor of thresholds: where it is, unless a device has followed it since.
    pub paths: Vec<Option<PixelPath>>,
    /// Per tile, pixels that a device keeps.
    kept: Vec<u64>,
    /// Per tile, of any other sensor: the light that it saw last.
    pub lights: Vec<Option<TileLuminance>>,
    /// Per tile, of one that is followed in continuous time.
    pub sensors: Vec<Option<SensorTile>>,
    /// Of one that takes frames: the columns of tiles that were followed through the block in work, and their light at all frames.
    pub columns: Vec<usize>,
    pub samples: Vec<f32>,
    pub events: Vec<Event>,
    pub report: Report,
    /// What a device is given of the block in work, and for each of its pixels the number in the row, tile by tile.
    packer: RowPacker,
    slots: Vec<usize>,
    /// Columns of the tiles that a device prepares.
    prepared: Vec<usize>,
    /// Per tile, pixels that the device could not follow.
    failed: Vec<u64>,
    /// Of sensors that take light throughout the block: tiles of which a device finds it, and what it has found.
    sampled: Vec<Sampled>,
    light: Vec<f32>,
    /// Of stages on a device: what its pixels have seen of the block in work.
    staged: Staged,
    /// Per tile: nothing of it changed in the block before.
    resting: Vec<Option<Resting>>,
}

/// A tile that shows what rests only: nothing of it changes until something that moves comes into it, or throws a shadow on it.
struct Resting {
    /// Of materials and lights.
    version: u64,
    /// See [`crate::shading::light::TileLight::beams`].
    beams: Box<[Option<Beam>]>,
    /// Its pixels that see anything, and how many facets these see, all together.
    pixels: u64,
    entries: u64,
}

/// A tile of which a device finds the light.
struct Sampled {
    column: usize,
    knots: Knots,
    /// Which of the row's pixels are its own.
    pixels: Range<usize>,
    /// Its pixels begin with this block.
    begins: bool,
}

/// Light of a row's pixels for stages on a device.
#[derive(Default)]
struct Staged {
    /// Tile by tile, see [`packed::Seen::pixels`]; of those in `own`, first numbers count from where that will lie.
    pixels: Vec<[u32; 2]>,
    own: Vec<bool>,
    /// What was found here.
    light: Vec<f32>,
    /// First light of tiles that begin and have gone on since.
    begun: Vec<(usize, TileLuminance)>,
    /// The device's number of the row's first light, once that is known.
    at: Option<u32>,
    /// All of it is there, and the stages have not taken it.
    ready: bool,
}

impl Staged {
    /// Nothing has changed, and nothing is known.
    fn clear(&mut self, columns: usize) {
        self.pixels.clear();
        self.pixels.resize(columns * PIXELS, [0, packed::LIGHT_RESTS]);
        self.own.clear();
        self.own.resize(columns * PIXELS, false);
        self.light.clear();
        self.begun.clear();
        (self.at, self.ready) = (None, false);
    }

    /// Pixel `slot` sees light on the device from number `first` on.
    fn refer(&mut self, slot: usize, first: u32, (parts, jumps): (usize, bool)) {
        let flags = if jumps { packed::LIGHT_JUMPS } else { 0 };
        self.pixels[slot] = [first, parts as u32 | flags];
    }

    /// Pixel `slot` sees the `signal` of its tile.
    fn put(&mut self, slot: usize, signal: &TileSignal, jumps: bool) {
        self.refer(slot, self.light.len() as u32, (signal.parts.len(), jumps));
        self.own[slot] = true;
        let all = std::iter::once(&signal.first).chain(&signal.parts);
        self.light.extend(all.map(|light| light[slot % PIXELS] as f32));
    }
}

/// How pixels are followed.
pub(crate) struct Following {
    pub thresholds: Thresholds,
    pub step_px: f64,
    pub start_us: i64,
    /// Number of the block in work, from 1.
    pub number: u32,
    /// Which tiles are followed, row by row; all where it is empty.
    pub only: Vec<bool>,
    /// A sensor with more stages than thresholds, in continuous time.
    pub sensing: Option<Sensing>,
    /// Whether light is wanted throughout a block: by that, or by one that takes frames.
    pub senses: bool,
    /// Whether tiles of which nothing changes are left out, which changes no event.
    pub rests: bool,
}

impl Following {
    /// What all pixels of a block share.
    pub fn job(&self, evaluator: &Evaluator) -> packed::Job {
        let Evaluator { world, lists, lighting, block, .. } = evaluator;
        let [near, far] = [lists.depths.near, lists.depths.far].map(|depth| 1.0 / depth);
        let parallel = if lists.depths.far.is_finite() { packed::PARALLEL } else { 0 };
        let jumps = if block.jump { packed::JUMPS } else { 0 };
        let (own, lamps) = lighting.pack_lamps(centre_of(world), times_of(world, *block));
        let mut job = packed::Job {
            length_us: block.length_us() as f32,
            start_us: (block.start_us - block.start_us.floor()) as f32,
            near: near as f32,
            far: far as f32,
            flags: parallel | jumps | if self.senses { packed::SENSES } else { 0 },
            lamps,
            own,
            number: self.number,
            ..self.thresholds.pack()
        };
        lighting.pack_background(centre_of(world), &mut job);
        job
    }
}

/// Pixels of a tile of which anything changes during `block`.
fn changing(block: Block, activities: &[Option<PixelActivity>; PIXELS]) -> u64 {
    let changes = |activity: &PixelActivity| !activity.still || block.jump;
    let pixels = activities.iter().enumerate().filter(|(_, a)| a.as_ref().is_some_and(changes));
    pixels.fold(0, |pixels, (pixel, _)| pixels | 1 << pixel)
}

/// Whether light jumps at the start of `block` for pixels that may begin with it.
fn jumps_of(block: Block, begins: bool) -> bool {
    block.jump && !begins
}

/// Pixels of the tile in `work`, at (column, row), that are in the picture and see anything.
fn pixels_in_picture(world: &World, work: &Work, [column, row]: [usize; 2]) -> u64 {
    let [width, height] = [world.lens.width, world.lens.height].map(|v| v as usize);
    let inside = |pixel: &usize| column * TILE + pixel % TILE < width && row * TILE + pixel / TILE < height;
    bits(work.pixels()).filter(inside).fold(0, |pixels, pixel| pixels | 1 << pixel)
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
    /// One of `columns` tiles, of a sensor that is `ideal`, or one with more stages that is followed in continuous time.
    pub fn new(columns: usize, ideal: bool, senses: bool) -> Self {
        Self {
            paths: if ideal { vec![None; columns * PIXELS] } else { Vec::new() },
            kept: if ideal { vec![0; columns] } else { Vec::new() },
            lights: if ideal { Vec::new() } else { vec![None; columns] },
            sensors: if senses { vec![None; columns] } else { Vec::new() },
            columns: Vec::new(),
            samples: Vec::new(),
            events: Vec::new(),
            report: Report::default(),
            packer: RowPacker::default(),
            slots: Vec::new(),
            prepared: Vec::new(),
            failed: vec![0; columns],
            sampled: Vec::new(),
            light: Vec::new(),
            staged: Staged::default(),
            resting: std::iter::repeat_with(|| None).take(columns).collect(),
        }
    }

    /// No device keeps its pixels.
    pub fn begin(&mut self) {
        self.kept.fill(0);
    }

    /// Goes through the block of `evaluator`, but for pixels that a device can follow if it `packs`.
    pub fn follow(
        &mut self,
        work: &mut Work,
        evaluator: &Evaluator,
        (following, taken): (&Following, Option<&Taken>),
        (row, packs): (usize, Option<Packs>),
    ) {
        self.columns.clear();
        self.samples.clear();
        self.slots.clear();
        self.prepared.clear();
        self.sampled.clear();
        if let Some(packs) = packs {
            let times_s = times_of(evaluator.world, evaluator.block);
            self.packer.begin(centre_of(evaluator.world), times_s, packs.maps);
            evaluator.lighting.pack_lights(&mut self.packer);
        }
        let columns = evaluator.lists.columns;
        if packs.is_some_and(|packs| packs.stays) {
            self.staged.clear(columns);
        }
        let only = following.only.get(row * columns..(row + 1) * columns).unwrap_or_default();
        if !only.is_empty() && !only.contains(&true) {
            return;
        }
        let started = Instant::now();
        if following.rests {
            self.wake(evaluator, row);
        } else {
            self.resting.fill_with(|| None);
        }
        let wanted = |column: usize| only.get(column) != Some(&false);
        let moves = |column: usize| wanted(column) && self.resting[column].is_none();
        let tiles = evaluator.lists.row_where(evaluator.world, row, moves);
        self.report.lists_s += started.elapsed().as_secs_f64();
        let started = Instant::now();
        for (column, tile) in tiles.iter().enumerate().filter(|(column, _)| wanted(*column)) {
            if self.resting[column].is_some() {
                self.rest(evaluator.block, (following, taken), ([column, row], packs));
            } else if packs.is_some() && !following.senses {
                self.leave(work, evaluator, following, tile, [column, row]);
            } else {
                self.tile(work, evaluator, (following, taken), tile, ([column, row], None, packs));
            }
        }
        self.staged.ready = self.packer.row.pixels.is_empty();
        self.report.pixels_s += started.elapsed().as_secs_f64();
    }

    /// Ends the rest of tiles in which something may change during the block.
    fn wake(&mut self, evaluator: &Evaluator, row: usize) {
        let Evaluator { lists, lighting, block, .. } = evaluator;
        if self.resting.iter().all(Option::is_none) {
            return;
        }
        lists.moving_columns(row, |column| self.resting[column] = None);
        for resting in &mut self.resting {
            let stays = |own: &Resting| {
                !block.jump && own.version == lighting.version() && !lighting.is_approached(&own.beams)
            };
            *resting = resting.take().filter(stays);
        }
    }

    /// Goes through the block with a tile of which nothing changes.
    fn rest(
        &mut self,
        block: Block,
        (following, taken): (&Following, Option<&Taken>),
        ([column, row], packs): ([usize; 2], Option<Packs>),
    ) {
        let Some(Resting { pixels, entries, .. }) = &self.resting[column] else { return };
        let pixels = *pixels;
        self.report.entries += entries;
        self.report.pixel_blocks += u64::from(pixels.count_ones());
        self.report.resting += u64::from(pixels.count_ones());
        let Some(before) = self.lights.get(column).copied().flatten() else { return };
        if packs.is_some_and(|packs| packs.stays) {
            bits(pixels).for_each(|pixel| self.staged.refer(column * PIXELS + pixel, 0, (0, false)));
        } else {
            let signal = TileSignal::still(before, Knots::resting(block));
            self.sense_tile(block, (following, taken), &signal, [column, row]);
        }
    }

    /// What a device needs of it.
    pub fn packed(&self) -> &packed::Row {
        &self.packer.row
    }

    /// Takes what a device made of the `pixels` that this row has packed, and of their `light`, which it keeps for [`Row::sense`], or of
    /// which it knows where that `stays`.
    pub fn take_light(&mut self, pixels: &[packed::Pixel], light: &[f32], stays: Option<u32>) {
        self.light.clear();
        self.light.extend_from_slice(light);
        self.staged.at = stays;
        for (pixel, &slot) in pixels.iter().zip(&self.slots) {
            let (column, number) = (slot / PIXELS, slot % PIXELS);
            if pixel.failed != 0 {
                self.failed[column] |= 1 << number;
                continue;
            }
            self.report.evaluations += u64::from(pixel.evaluations);
            self.report.on_device += u64::from(pixel.evaluations);
            if stays.is_some()
                && let Some(Some(light)) = self.lights.get_mut(column)
            {
                light[number] = f64::from(pixel.memory.last);
            }
        }
    }

    /// Takes what the pixels of the tiles of this row, number `row`, that a device has prepared `fired`, pixel by pixel, and which of
    /// them it has `failed` to follow, all from number `first` of the block on.
    pub fn take_events(
        &mut self,
        evaluator: &Evaluator,
        following: &Following,
        first: u32,
        (fired, failed): (&[packed::Event], &[packed::Failed]),
        row: usize,
    ) {
        let block = evaluator.block;
        let start_us = block.start_us.floor() as i64 - following.start_us;
        let place = |pixel: u32| {
            let at = (pixel - first) as usize;
            (self.prepared[at / PIXELS], at % PIXELS)
        };
        for packed::Failed { pixel, memory } in failed {
            let (column, number) = place(*pixel);
            self.failed[column] |= 1 << number;
            self.kept[column] &= !(1 << number);
            // What was given for this block is known here in 64 bits.
            let path = &mut self.paths[column * PIXELS + number];
            *path = path.take().or_else(|| PixelPath::unpack(block, following.number, memory));
        }
        // Where the device has followed it, that is out of date.
        for (tile, &column) in self.packer.row.tiles.iter().zip(&self.prepared) {
            let given = whole(tile.given) & self.kept[column];
            bits(given).for_each(|number| self.paths[column * PIXELS + number] = None);
        }
        for event in fired {
            let (column, number) = place(event.pixel);
            if self.failed[column] >> number & 1 == 0 {
                let at = [column * TILE + number % TILE, row * TILE + number / TILE].map(|v| v as u16);
                self.events.push(event_at(*event, start_us, at));
            }
        }
    }

    /// How many pixels of its tiles a device prepares.
    pub fn prepared_pixels(&self) -> usize {
        self.prepared.len() * PIXELS
    }

    /// Gives sensors the light of the tiles of which a device has found it, or says where that stays: what it could not find is
    /// found here.
    pub fn sense(
        &mut self,
        work: &mut Work,
        evaluator: &Evaluator,
        (following, taken): (&Following, Option<&Taken>),
        row: usize,
    ) {
        let stays = self.staged.at.take();
        if self.light.is_empty() && stays.is_none() {
            return;
        }
        let mut failed = std::mem::take(&mut self.failed);
        let incomplete = failed.iter().any(|pixels| *pixels != 0);
        let missing = |column: usize| failed[column] != 0;
        let lists =
            if incomplete { evaluator.lists.row_where(evaluator.world, row, missing) } else { Vec::new() };
        let (light, sampled) = (std::mem::take(&mut self.light), std::mem::take(&mut self.sampled));
        for Sampled { column, knots, pixels, begins } in &sampled {
            let (column, missing) = (*column, failed[*column]);
            let Some(before) = self.lights[column] else { continue };
            let found =
                self.packer.row.pixels[pixels.clone()].iter().filter(|p| missing >> p.number & 1 == 0);
            let parts_of = |pixel: &packed::Pixel| if pixel.stride > 0 { knots.times() } else { 0 };
            if let Some(first) = stays {
                for pixel in found.clone() {
                    let slot = column * PIXELS + pixel.number as usize;
                    let of = (parts_of(pixel), jumps_of(evaluator.block, *begins));
                    self.staged.refer(slot, first + pixel.least, of);
                }
                if missing == 0 {
                    continue;
                }
            }
            let mut signal = TileSignal::still(before, *knots);
            for pixel in found.filter(|_| stays.is_none()) {
                let light = &light[pixel.least as usize..][..1 + parts_of(pixel)];
                signal.take(pixel.number as usize, light, evaluator.block.jump);
            }
            if missing != 0 {
                self.report.refollowed += u64::from(missing.count_ones());
                let list = &lists[column];
                evaluator.enter_tile(work, list, [column, row]);
                let entries = &list.entries[..];
                let activities = std::array::from_fn(|pixel| {
                    (missing >> pixel & 1 == 1).then(|| evaluator.activity(work, entries, pixel))
                });
                let accuracy = (*knots, following.thresholds.floor());
                let jumps = evaluator.block.jump;
                signal.follow((missing, jumps), (evaluator, work), (entries, &activities), accuracy);
            }
            if stays.is_some() {
                self.keep(&signal, (column, missing), jumps_of(evaluator.block, *begins));
            } else {
                self.sense_tile(evaluator.block, (following, taken), &signal, [column, row]);
            }
        }
        self.staged.ready = stays.is_some();
        failed.fill(0);
        (self.failed, self.light, self.sampled) = (failed, light, sampled);
        self.light.clear();
        self.sampled.clear();
    }

    /// Keeps the `pixels` of a tile's light for stages on a device.
    fn keep(&mut self, signal: &TileSignal, (column, pixels): (usize, u64), jumps: bool) {
        self.report.evaluations += signal.evaluations;
        for pixel in bits(pixels) {
            self.staged.put(column * PIXELS + pixel, signal, jumps);
            if let Some(light) = &mut self.lights[column] {
                light[pixel] = signal.last()[pixel];
            }
        }
    }

    /// First light of the row's pixels, tile by tile, in the block with which they begin; NaN of those that see nothing.
    pub fn first_light(&self) -> Vec<TileLuminance> {
        let mut all: Vec<_> = self.lights.iter().map(|light| light.unwrap_or([f64::NAN; PIXELS])).collect();
        self.staged.begun.iter().for_each(|(column, light)| all[*column] = *light);
        all
    }

    /// What the stages of a device take of pixel after pixel, tile by tile, now; light that was found here follows what is in `more`,
    /// which lies from number `first` on.
    pub fn staged(&mut self, first: u32, more: &mut Vec<f32>) -> Option<Vec<[u32; 2]>> {
        if !std::mem::take(&mut self.staged.ready) {
            return None;
        }
        let own = first + more.len() as u32;
        more.append(&mut self.staged.light);
        let of = |([at, word], is_own): (&[u32; 2], &bool)| [at + if *is_own { own } else { 0 }, *word];
        Some(self.staged.pixels.iter().zip(&self.staged.own).map(of).collect())
    }

    /// Gives the sensor the light of a tile.
    fn sense_tile(
        &mut self,
        block: Block,
        (following, taken): (&Following, Option<&Taken>),
        signal: &TileSignal,
        [column, row]: [usize; 2],
    ) {
        self.report.evaluations += signal.evaluations;
        if let Some(sensing) = &following.sensing {
            let (tile, at) = (&mut self.sensors[column], (block, [column, row]));
            self.report.losses.add(sensing.follow(tile, at, signal, &mut self.events));
        }
        if let Some(taken) = taken {
            self.columns.push(column);
            taken.sample(signal, &mut self.samples);
        }
        self.lights[column] = Some(*signal.last());
    }

    /// Follows what a device could not.
    pub fn follow_failed(
        &mut self,
        work: &mut Work,
        evaluator: &Evaluator,
        following: &Following,
        row: usize,
    ) {
        if self.failed.iter().all(|pixels| *pixels == 0) {
            return;
        }
        let failed = std::mem::take(&mut self.failed);
        let tiles = evaluator.lists.row_where(evaluator.world, row, |column| failed[column] != 0);
        for (column, tile) in tiles.iter().enumerate().filter(|(column, _)| failed[*column] != 0) {
            self.report.refollowed += u64::from(failed[column].count_ones());
            self.follow_here(work, evaluator, following, tile, ([column, row], failed[column]));
        }
        self.failed = vec![0; failed.len()];
    }

    /// Follows `pixels` of a tile here.
    fn follow_here(
        &mut self,
        work: &mut Work,
        evaluator: &Evaluator,
        following: &Following,
        list: &TileList,
        (place, pixels): ([usize; 2], u64),
    ) {
        if pixels != 0 {
            self.tile(work, evaluator, (following, None), list, (place, Some(pixels), None));
        }
    }

    /// Counts what a tile's `pixels` see, so many entries together, and lets it rest where all of them are `still`.
    fn count_tile(
        &mut self,
        work: &Work,
        evaluator: &Evaluator,
        column: usize,
        (still, pixels, entries): (bool, u64, u64),
    ) {
        self.report.entries += entries;
        self.report.pixel_blocks += u64::from(pixels.count_ones());
        let version = evaluator.lighting.version();
        self.resting[column] =
            still.then(|| Resting { version, beams: work.beams().into(), pixels, entries });
    }

    /// Leaves a tile to a device, which prepares its pixels and keeps them.
    fn leave(
        &mut self,
        work: &mut Work,
        evaluator: &Evaluator,
        following: &Following,
        list: &TileList,
        [column, row]: [usize; 2],
    ) {
        let Following { step_px, number, .. } = *following;
        let (block, entries) = (evaluator.block, &list.entries[..]);
        evaluator.enter_tile(work, list, [column, row]);
        let pixels = pixels_in_picture(evaluator.world, work, [column, row]);
        let strides = |activity: &PixelActivity| PixelPath::strides(block, step_px, activity);
        let activity = evaluator.tile_activity(work, entries, pixels, strides);
        self.count_tile(work, evaluator, column, (activity.still, pixels, activity.entries as u64));
        if pixels == 0 || activity.still && !block.jump {
            return;
        }
        let kept = self.kept[column];
        let packed = evaluator.pack_tile(work, (entries, &activity), pixels, &mut self.packer);
        let Some(mut tile) = packed else {
            let there = kept & pixels;
            if there != 0 {
                let masks = [there; 2].map(halves);
                let frames = packed::NO_FRAMES;
                let tile =
                    packed::Tile { pixels: masks[0], returned: masks[1], frames, ..Default::default() };
                self.prepare([column, row], tile);
            }
            self.follow_here(work, evaluator, following, list, ([column, row], pixels & !there));
            return;
        };
        let paths = &self.paths[column * PIXELS..][..PIXELS];
        let given =
            bits(pixels & !kept).filter(|pixel| paths[*pixel].is_some()).fold(0, |m, pixel| m | 1 << pixel);
        tile.memories = self.packer.row.words.len() as u32;
        for path in bits(given).filter_map(|pixel| paths[pixel].as_ref()) {
            let words: [u32; packed::MEMORY_WORDS] = bytemuck::cast(path.pack(block, number));
            self.packer.row.words.extend(words);
        }
        [tile.given, tile.begins] = [given, pixels & !kept & !given].map(halves);
        self.kept[column] |= pixels;
        self.prepare([column, row], tile);
    }

    /// Adds a tile that a device prepares.
    fn prepare(&mut self, [column, row]: [usize; 2], tile: packed::Tile) {
        let place = (row * self.kept.len() + column) * PIXELS;
        self.packer.row.tiles.push(packed::Tile { place: place as u32, ..tile });
        self.prepared.push(column);
    }

    fn tile(
        &mut self,
        work: &mut Work,
        evaluator: &Evaluator,
        (following, taken): (&Following, Option<&Taken>),
        list: &TileList,
        ([column, row], only, packs): ([usize; 2], Option<u64>, Option<Packs>),
    ) {
        let entries = &list.entries[..];
        let Following { thresholds, step_px, start_us, .. } = following;
        let block = evaluator.block;
        evaluator.enter_tile(work, list, [column, row]);
        let place = |pixel: usize| (column * TILE + pixel % TILE, row * TILE + pixel / TILE);
        let inside = pixels_in_picture(evaluator.world, work, [column, row]);
        // Of a tile whose others a device has followed.
        let (again, only) = (only.is_some(), only.unwrap_or(u64::MAX));
        let mut activities = [None; PIXELS];
        let (mut still, mut pixels, mut entry_count) = (true, 0_u64, 0);
        for pixel in bits(inside) {
            let activity = evaluator.activity(work, entries, pixel);
            activities[pixel] = Some(activity);
            still &= activity.still;
            pixels |= 1 << pixel;
            entry_count += work.entry_count(pixel) as u64;
        }
        if !again {
            self.count_tile(work, evaluator, column, (still, pixels, entry_count));
        }
        if following.senses {
            let begins = self.lights[column].is_none();
            let before = *self.lights[column].get_or_insert_with(|| {
                let (first, evaluations) = TileSignal::begin((evaluator, work), (entries, &activities));
                self.report.evaluations += evaluations;
                first
            });
            let stays = packs.is_some_and(|packs| packs.stays);
            if stays {
                let seen = (0..PIXELS).filter(|pixel| activities[*pixel].is_some());
                seen.for_each(|pixel| self.staged.refer(column * PIXELS + pixel, 0, (0, false)));
            }
            let of_tile = (&activities, &before, column);
            if packs.is_some() && self.pack_light(work, evaluator, following, entries, (of_tile, begins)) {
                return;
            }
            let knots = Knots::new(block, *step_px, &activities);
            let mut signal = TileSignal::still(before, knots);
            let (with, accuracy) = ((evaluator, work), (knots, thresholds.floor()));
            let pixels = if stays { changing(block, &activities) } else { u64::MAX };
            signal.follow((pixels, jumps_of(block, begins)), with, (entries, &activities), accuracy);
            if stays {
                if begins {
                    self.staged.begun.push((column, before));
                }
                self.keep(&signal, (column, pixels), jumps_of(block, begins));
            } else {
                self.sense_tile(block, (following, taken), &signal, [column, row]);
            }
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
        for (pixel, activity) in activities.iter().enumerate().filter(|(pixel, _)| follows >> pixel & 1 == 1)
        {
            let (Some(activity), (x, y)) = (activity, place(pixel)) else { continue };
            evaluator.enter_pixel(work, pixel);
            let slot = column * PIXELS + pixel;
            let path = self.paths[slot].get_or_insert_with(|| {
                PixelPath::new(block.start_us, evaluator.luminance(work, entries, 0), thresholds)
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

    /// Leaves a tile's light to a device; false where nothing of it changes, and where that cannot show it.
    fn pack_light(
        &mut self,
        work: &mut Work,
        evaluator: &Evaluator,
        following: &Following,
        entries: &[Entry],
        ((activities, before, column), begins): (
            (&[Option<PixelActivity>; PIXELS], &TileLuminance, usize),
            bool,
        ),
    ) -> bool {
        let block = evaluator.block;
        let pixels = changing(block, activities);
        if pixels == 0 {
            return false;
        }
        let knots = Knots::new(block, following.step_px, activities);
        let Some(packed) = evaluator.pack(work, entries, pixels, &mut self.packer) else { return false };
        let row = &mut self.packer.row;
        let first = row.pixels.len();
        for mut packed in packed {
            let pixel = packed.number as usize;
            let moves = activities[pixel].is_some_and(|activity| !activity.still);
            packed.stride = if moves { knots.stride } else { 0 };
            packed.least = row.light as u32;
            packed.memory.last = before[pixel] as f32;
            row.light += if moves { 1 + knots.times() } else { 1 };
            row.pixels.push(packed);
            self.slots.push(column * PIXELS + pixel);
        }
        self.sampled.push(Sampled { column, knots, pixels: first..row.pixels.len(), begins });
        true
    }
}
