//! Pixels that a device follows, in the place of the processor's cores.

use std::fmt::Debug;

use evis_core::{Event, Polarity};

use crate::Error;
use crate::packed;
use crate::shading::light::Lighting;

/// Opens devices: one for each view.
pub trait Devices: Debug + Send + Sync {
    /// A device that nothing was loaded to.
    ///
    /// # Errors
    /// It cannot be opened.
    fn open(&self) -> Result<Box<dyn Device>, Error>;
}

/// What follows pixels through blocks as [`crate::signal::path::PixelPath::walk`] does, in 32 bits.
pub trait Device: Send {
    /// Takes what stays from block to block, in the place of what it had.
    ///
    /// # Errors
    /// It does not fit, and why.
    fn load(&mut self, scene: &packed::Scene) -> Result<(), Error>;

    /// Bytes that arrays of a block may take, each.
    fn room(&self) -> usize;

    /// Follows the pixels of `block` and writes into them what became of them. Returns their events: those of one pixel in firing
    /// order, and those of pixels that failed for nothing.
    ///
    /// # Errors
    /// The device is lost.
    fn follow(&mut self, block: &mut packed::Block) -> Result<Vec<packed::Event>, Error>;
}

/// A device, and which version of a view's light it has.
pub(crate) struct Loaded {
    device: Box<dyn Device>,
    version: Option<u64>,
    /// Where its textures and sums begin.
    places: [u32; 2],
}

impl Loaded {
    pub(crate) fn new(device: Box<dyn Device>) -> Self {
        Self { device, version: None, places: [0; 2] }
    }

    /// See [`Device::room`].
    pub(crate) fn room(&self) -> usize {
        self.device.room()
    }

    /// As [`Device::follow`], with the light of `lighting`.
    pub(crate) fn follow(
        &mut self,
        lighting: &Lighting,
        block: &mut packed::Block,
    ) -> Result<Vec<packed::Event>, Error> {
        if block.pixels.is_empty() {
            return Ok(Vec::new());
        }
        if self.version != Some(lighting.version()) {
            let scene = lighting.pack_scene();
            self.device.load(&scene)?;
            (self.version, self.places) = (Some(lighting.version()), [scene.textures, scene.sums]);
        }
        [block.job.textures, block.job.sums] = self.places;
        self.device.follow(block)
    }
}

/// An event of the pixel at (`x`, `y`), `start_us` being the whole microsecond of the stream in which the block begins.
pub(crate) fn event_at(event: packed::Event, start_us: i64, [x, y]: [u16; 2]) -> Event {
    let polarity = if event.word & 1 == 1 { Polarity::On } else { Polarity::Off };
    Event::new(start_us + i64::from(event.word >> 1), x, y, polarity)
}
