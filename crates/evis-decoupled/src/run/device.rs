//! Pixels that a device follows, in the place of the processor's cores.

use std::collections::HashMap;
use std::fmt::Debug;
use std::sync::{Arc, Weak};

use evis_core::emulator::tiled::Losses;
use evis_core::random::Key;
use evis_core::{Event, Polarity, SensorConfig};
use evis_scene::Scene;

use crate::Error;
use crate::hash::Words;
use crate::packed::{self, Kept, place_of};
use crate::shading::light::packed::pack_sky;
use crate::shading::light::{Lighting, Shared};

/// Opens devices: one for all views of a stream.
pub trait Devices: Debug + Send + Sync {
    /// Bytes that textures may take.
    fn texture_room(&self) -> usize;

    /// A device with these textures for these `views`, which keeps nothing yet.
    ///
    /// # Errors
    /// It cannot be opened, or they do not fit.
    fn open(&self, textures: &packed::Textures, views: &[ViewSensor]) -> Result<Box<dyn Device>, Error>;
}

/// What follows pixels through blocks as [`crate::signal::path::PixelPath::walk`] does, in 32 bits.
pub trait Device: Send {
    /// Bytes that arrays of a block may take, each, and all that is kept.
    fn room(&self) -> usize;

    /// Follows the pixels of `block` and writes into it what became of them. Returns their events, and light where that is wanted:
    /// those of pixels that failed count for nothing.
    ///
    /// # Errors
    /// The device is lost.
    fn follow(&mut self, block: &mut packed::Block) -> Result<packed::Found, Error>;

    /// Stages of sensors, where it has any: then light of these views stays.
    fn stages(&mut self) -> Option<&mut dyn Stages> {
        None
    }
}

/// Stages of sensors on a device, which take light that stays there.
pub trait Stages {
    /// Whether they are those of view `view` with this sensor.
    fn has(&self, view: usize, own: &ViewSensor) -> bool;

    /// How many numbers of light stay since [`Stages::sense`]: the number of the next one.
    fn light_count(&self) -> u32;

    /// Whether [`Stages::sense`] must take it before more is found.
    fn is_full(&self) -> bool;

    /// Lets the pixels of a view that it has begin with their first `light`, row by row, at a time of the stream in microseconds; all
    /// that is random in them follows from the sensor and key given here.
    ///
    /// # Errors
    /// The device is lost.
    fn begin(&mut self, view: usize, own: &ViewSensor, t_us: i64, light: &[f32]) -> Result<(), Error>;

    /// Takes `more` light, which follows that which stays, and gives sensors what `views` have seen of it, after which none stays.
    /// Returns what fires, view by view, by pixel and in firing order, marked with causes and in stream time; and what sensors lost.
    ///
    /// # Errors
    /// The device is lost.
    fn sense(&mut self, views: &[packed::Seen], more: &[f32]) -> Result<(Vec<Vec<Event>>, Losses), Error>;
}

/// What a view's pixels are.
#[derive(Clone, Debug)]
pub struct ViewSensor {
    /// The sensor.
    pub sensor: SensorConfig,
    /// Of all that is random in it.
    pub key: Key,
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// `Y_ref`.
    pub reference_luminance: f32,
}

/// A device, and what it keeps.
pub(crate) struct Loaded {
    device: Box<dyn Device>,
    /// Whether it has other maps than those of base colour.
    has_maps: bool,
    /// By where it is: what is kept, and from which row on.
    kept: HashMap<usize, (Kept, u32), Words>,
    /// Rows that are kept.
    rows: usize,
    /// What lies behind everything, where that is the sky.
    sky: Option<packed::Sky>,
    /// Appearances of facets that views have, or had.
    looks: Vec<Weak<[[f32; 4]]>>,
    /// What was followed last: its arrays have the room that the next one needs.
    block: packed::Block,
}

/// What may be packed for a device.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Packs {
    /// Facets with other maps than one of base colour.
    pub maps: bool,
    /// Light stays on the device, which has the sensor's stages.
    pub stays: bool,
}

/// A row of tiles of a view.
#[derive(Clone, Copy)]
pub(crate) struct ViewRow<'r> {
    /// Index of the view.
    pub view: usize,
    /// What all its rows share, but for where its appearances are.
    pub job: &'r packed::Job,
    /// Appearances of its facets.
    pub looks: &'r Kept,
    /// What the row needs.
    pub row: &'r packed::Row,
    /// Its light stays on the device.
    pub stays: bool,
}

/// What became of the pixels of some rows.
pub(crate) struct Followed<'f> {
    /// How many rows these are.
    pub rows: usize,
    /// Row by row.
    pub pixels: &'f [packed::Pixel],
    /// Events and what failed in the order of pixels; light row by row.
    pub found: packed::Found,
}

impl Loaded {
    /// One of `devices`, for views of `scene`; `None` where there are no devices.
    ///
    /// # Errors
    /// As [`Devices::open`].
    pub(crate) fn open(
        devices: Option<&Arc<dyn Devices>>,
        (scene, shared): (&Scene, &Shared),
        views: &[ViewSensor],
    ) -> Result<Option<Self>, Error> {
        let Some(devices) = devices else { return Ok(None) };
        let (textures, has_maps) = shared.pack(scene, devices.texture_room());
        let device = devices.open(&textures, views)?;
        let (kept, looks, block) = (HashMap::default(), Vec::new(), packed::Block::default());
        Ok(Some(Self { device, has_maps, kept, rows: 0, sky: pack_sky(scene), looks, block }))
    }

    /// What may be packed for it of view `view`.
    pub(crate) fn packs(&mut self, view: usize, own: &ViewSensor) -> Packs {
        let stays = self.device.stages().is_some_and(|stages| stages.has(view, own));
        Packs { maps: self.has_maps, stays }
    }

    /// See [`Device::stages`].
    pub(crate) fn stages(&mut self) -> Option<&mut dyn Stages> {
        self.device.stages()
    }

    /// Appearances of the facets of `lighting`, those of another view where they are the same.
    pub(crate) fn looks(&mut self, lighting: &Lighting) -> Kept {
        let rows = lighting.pack_looks();
        self.looks.retain(|known| known.strong_count() > 0);
        let bits: &[u32] = bytemuck::cast_slice(&rows);
        let is_same = |known: &Kept| bytemuck::cast_slice::<_, u32>(known) == bits;
        let known = self.looks.iter().filter_map(Weak::upgrade).find(is_same);
        known.unwrap_or_else(|| {
            let looks = Kept::from(rows);
            self.looks.push(Arc::downgrade(&looks));
            looks
        })
    }

    /// Follows as many of `rows` as fit, one at least.
    ///
    /// # Errors
    /// As [`Device::follow`].
    pub(crate) fn follow(&mut self, rows: &[ViewRow]) -> Result<Followed<'_>, Error> {
        let mut block = std::mem::take(&mut self.block);
        let count = self.gather(rows, &mut block);
        self.block = block;
        let block = &mut self.block;
        let mut found = packed::Found::default();
        if block.pixel_count() > 0 {
            found = self.device.follow(block)?;
            // Stable: those of one pixel are in firing order.
            found.events.sort_by_key(|event| event.pixel);
            found.failed.sort_by_key(|failed| failed.pixel);
        }
        Ok(Followed { rows: count, pixels: &block.pixels, found })
    }

    /// Makes `block` of as many of `rows` as fit, one at least, side by side; how many these are.
    fn gather(&mut self, rows: &[ViewRow], block: &mut packed::Block) -> usize {
        let room = self.device.room();
        let light_stays = rows.first().is_some_and(|own| own.stays);
        block.begin(self.rows as u32, light_stays);
        let (mut count, mut view) = (0, None);
        for own in rows.iter().take_while(|own| own.stays == light_stays) {
            let new = self.missing(own) * size_of::<[f32; 4]>();
            let sums = block.bytes().into_iter().zip(own.row.bytes()).map(|(all, row)| all + row);
            let fits = sums.max().is_some_and(|most| most <= room);
            let keeps = self.rows * size_of::<[f32; 4]>() + new <= room;
            if count > 0 && !(fits && keeps) {
                break;
            }
            if !keeps {
                // Nothing of this block lies there yet.
                self.kept.clear();
                (self.rows, block.kept_from) = (0, 0);
            }
            if view.replace(own.view) != Some(own.view) {
                let mut job = packed::Job { looks: self.keep(own.looks, block), ..*own.job };
                if let Some(packed::Sky { rows, levels }) = self.sky.clone() {
                    (job.sky, job.sky_levels) = (self.keep(&rows, block), levels);
                }
                block.jobs.push(job);
            }
            block.add_row(own.row, own.view);
            count += 1;
        }
        count
    }

    /// Rows that must go up before a row of tiles is followed.
    fn missing(&self, own: &ViewRow) -> usize {
        let sky = self.sky.as_ref().map(|sky| &sky.rows);
        let parts = [own.looks].into_iter().chain(sky);
        parts.filter(|kept| !self.kept.contains_key(&place_of(kept))).map(|kept| kept.len()).sum()
    }

    /// The first of the rows where `kept` is, or will be after `block` has gone up.
    fn keep(&mut self, kept: &Kept, block: &mut packed::Block) -> u32 {
        let (_, first) = self.kept.entry(place_of(kept)).or_insert_with(|| {
            block.kept.extend_from_slice(kept);
            let first = self.rows;
            self.rows += kept.len();
            (Arc::clone(kept), first as u32)
        });
        *first
    }
}

/// An event of the pixel at (`x`, `y`), `start_us` being the whole microsecond of the stream in which the block begins.
pub(crate) fn event_at(event: packed::Event, start_us: i64, [x, y]: [u16; 2]) -> Event {
    let polarity = if event.word & 1 == 1 { Polarity::On } else { Polarity::Off };
    Event::new(start_us + i64::from(event.word >> 1), x, y, polarity)
}
