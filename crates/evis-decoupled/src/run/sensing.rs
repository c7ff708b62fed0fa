//! Sensors with more stages than thresholds, tile by tile: each takes its light at times of its own.

use evis_core::Event;
use evis_core::emulator::tiled::{Losses, SensorTile, TiledSensor};

use crate::scene::tiles::TILE;
use crate::signal::knots::{TileLuminance, TileSignal};
use crate::visibility::blocks::Block;

const _: () = assert!(evis_core::emulator::tiled::SIDE == TILE);

/// A sensor, and what its pixels take light for.
#[derive(Clone, Debug)]
pub(crate) struct Sensing {
    pub sensor: TiledSensor,
    /// Scene time at which the stream starts.
    pub start_us: i64,
    /// `Y_ref`.
    pub reference: f64,
}

impl Sensing {
    /// The tile at (column, row), whose pixels see `luminance` first, at `t_us` of scene time.
    pub fn begin(&self, place: [usize; 2], luminance: &TileLuminance, t_us: f64) -> SensorTile {
        let [x, y] = place.map(|v| (v * TILE) as u32);
        let mut tile = self.sensor.tile(x, y);
        self.take(&mut tile, luminance, self.stream_us(t_us), &mut Vec::new());
        tile
    }

    fn stream_us(&self, t_us: f64) -> i64 {
        t_us.round() as i64 - self.start_us
    }

    fn take(
        &self,
        tile: &mut SensorTile,
        luminance: &TileLuminance,
        t_us: i64,
        events: &mut Vec<Event>,
    ) -> Losses {
        let light =
            luminance.map(|v| if v.is_nan() { f32::NAN } else { (v / self.reference).max(0.0) as f32 });
        self.sensor.advance(tile, &light, t_us, events)
    }

    /// Takes the light of the tile at (column, row) during `block`, and says what was lost.
    pub fn follow(
        &self,
        tile: &mut Option<SensorTile>,
        (block, place): (Block, [usize; 2]),
        signal: &TileSignal,
        events: &mut Vec<Event>,
    ) -> Losses {
        let mut losses = Losses::default();
        let begun = tile.is_some();
        let tile = tile.get_or_insert_with(|| self.begin(place, &signal.first, block.start_us));
        if begun && block.jump {
            // Light was as before until now.
            losses.add(self.take(tile, &signal.first, self.stream_us(block.start_us) + 1, events));
        }
        for (index, light) in signal.parts.iter().enumerate() {
            let u = (index + 1) as f64 / signal.parts.len() as f64;
            losses.add(self.take(tile, light, self.stream_us(block.at(u)), events));
        }
        losses
    }
}
