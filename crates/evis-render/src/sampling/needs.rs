//! How often each tile of a picture must be sampled.

use crate::sampling::coverage::Cover;

/// Samples per instant that each tile requires: 0 where nothing changes, infinite where no bound is known.
pub struct Needs {
    /// Tiles per row.
    pub columns: u32,
    /// Rows of tiles.
    pub rows: u32,
    /// Per tile, row by row.
    pub tiles: Vec<f64>,
}

impl Needs {
    /// The same everywhere.
    pub fn everywhere(columns: u32, rows: u32, need: f64) -> Self {
        Self { columns, rows, tiles: vec![need; (columns * rows) as usize] }
    }

    /// In `tiles`, where something changes: never nothing.
    pub fn add(&mut self, tiles: impl Iterator<Item = (u32, u32)>, need: f64) {
        let need = if need > 0.0 { need } else { f64::MIN_POSITIVE };
        for (x, y) in tiles {
            let tile = &mut self.tiles[(y * self.columns + x) as usize];
            *tile = tile.max(need);
        }
    }

    /// Whether all tiles of `cover` require as much anyway.
    pub fn meets(&self, cover: &Cover, need: f64) -> bool {
        cover.tiles().all(|(x, y)| self.tiles[(y * self.columns + x) as usize] >= need)
    }
}
