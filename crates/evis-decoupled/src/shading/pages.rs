//! Pictures of facets' light, in pages that neighbouring tiles share.
//!
//! The picture of a facet with maps at the middle of a block ([`crate::shading::keyframe`]) is cut into squares as large as tiles. What moves
//! far during a block is seen by many tiles; a thread that works on one tile after another renders each page once.

use std::collections::HashMap;

use glam::{DMat3, DVec2};

use crate::hash::Words;
use crate::scene::screen::Depths;
use crate::scene::tiles::{TILE, TileView};
use crate::shading::keyframe::Keyframe;
use crate::visibility::fragment::Sight;
use crate::visibility::lists::Record;

/// Side of a page in pixels.
const SIDE: f64 = TILE as f64;
/// A facet no wider than this many pages has one.
const ALONE: f64 = 1.5;
/// How far a footprint reaches beyond its centroid, and beyond the facet that it lies on, in pixels: half of the diagonal of a
/// pixel that is turned.
pub const BEYOND_PX: f64 = 0.75;
/// Sums that a thread keeps before it forgets all pages, 16 bytes each.
const MOST_SUMS: usize = 3 << 20;

/// Which page of which record of the block.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Key {
    record: u32,
    /// Which interval of how many.
    interval: [u32; 2],
    index: [i32; 2],
}

/// The pages that a thread has rendered of a block.
#[derive(Default)]
pub struct Pages {
    /// What they are of.
    block: u64,
    known: HashMap<Key, Option<u32>, Words>,
    keyframes: Vec<Keyframe>,
    sums: Vec<[f32; 4]>,
}

impl Pages {
    /// Before a tile of block number `block`: forgets other blocks, and all pages where these have become too many.
    pub fn enter_tile(&mut self, block: u64) {
        if self.block != block || self.sums.len() > MOST_SUMS {
            self.block = block;
            self.known.clear();
            self.keyframes.clear();
            self.sums.clear();
        }
    }

    /// The page of `facet` about a place on its picture, and the sums of all pages; `render` makes it from a rectangle (left,
    /// top, right, bottom) where it is not known. `None` where it cannot be rendered.
    #[inline(always)]
    pub fn about(
        &mut self,
        facet: &Picture,
        place: DVec2,
        render: impl FnOnce([f64; 4], &mut Vec<[f32; 4]>) -> Option<Keyframe>,
    ) -> Option<(&Keyframe, &[[f32; 4]])> {
        let index = facet.index(place);
        let key = Key { record: facet.record, interval: [facet.interval, facet.intervals], index };
        let number = match self.known.get(&key) {
            Some(number) => *number,
            None => {
                let page = facet.rect(index).and_then(|rect| render(rect, &mut self.sums));
                let number = page.map(|page| {
                    self.keyframes.push(page);
                    self.keyframes.len() as u32 - 1
                });
                self.known.insert(key, number);
                number
            }
        };
        Some((&self.keyframes[number? as usize], &self.sums))
    }
}

/// Where a facet's pages are.
#[derive(Clone, Copy, Debug)]
pub struct Picture {
    record: u32,
    /// To image points at the middle of the block from the facet's (s, t, 1) over depth.
    pub image_from_facet: DMat3,
    /// The camera sees its outside.
    pub front: bool,
    /// The part of the block whose light it has, and of how many; the whole block's, of light that does not change, where there
    /// are none.
    pub interval: u32,
    /// How many parts of the block have pictures of their own.
    pub intervals: u32,
    /// Left top corner of the page 0, 0.
    origin: DVec2,
    /// What can be seen of it: left top and right bottom corners.
    seen: [DVec2; 2],
    /// There is one page along an axis.
    alone: [bool; 2],
}

impl Picture {
    /// Of `record`, number `index` of its block, on a picture of which the box `on_screen` (left, top, right, bottom) is seen;
    /// `None` where it is not seen at the middle.
    pub fn new(record: &Record, index: u32, on_screen: [f64; 4], depths: &Depths) -> Option<Self> {
        let sight = Sight::new(record, &TileView::about([0.0; 2]), 0.5, depths)?;
        let image_from_facet = sight.facet_from_image().inverse();
        if !image_from_facet.is_finite() {
            return None;
        }
        // What of it is beyond the screen is seen at no time that is near enough.
        let [left, top, right, bottom] = on_screen;
        let mut seen = [DVec2::new(left, top) - SIDE, DVec2::new(right, bottom) + SIDE];
        let mut origin = DVec2::ZERO;
        let mut alone = [false; 2];
        let corners = [0, 1, 2, 3].map(|k| record.point(k, 0.5));
        if corners.iter().all(|h| h.z >= depths.near) {
            let places = corners.map(|h| DVec2::new(h.x, h.y) / h.z);
            let low = places.into_iter().fold(DVec2::INFINITY, DVec2::min) - BEYOND_PX;
            let high = places.into_iter().fold(DVec2::NEG_INFINITY, DVec2::max) + BEYOND_PX;
            seen = [seen[0].max(low), seen[1].min(high)];
            let extent = high - low;
            origin = low;
            alone = [extent.x <= ALONE * SIDE, extent.y <= ALONE * SIDE];
        }
        Some(Self {
            record: index,
            image_from_facet,
            front: sight.front,
            interval: 0,
            intervals: 0,
            origin,
            seen,
            alone,
        })
    }

    /// The same, of the light of part `interval` of `intervals` of the block.
    pub fn during(self, interval: u32, intervals: u32) -> Self {
        Self { interval, intervals, ..self }
    }

    #[inline(always)]
    fn index(&self, place: DVec2) -> [i32; 2] {
        let at = (place - self.origin) * (1.0 / SIDE);
        [0, 1].map(|k| if self.alone[k] { 0 } else { at[k].floor() as i32 })
    }

    /// What a page shows; `None` where that is nothing.
    fn rect(&self, index: [i32; 2]) -> Option<[f64; 4]> {
        let mut rect = [0.0; 4];
        for k in 0..2 {
            let (mut low, mut high) = (self.seen[0][k], self.seen[1][k]);
            if !self.alone[k] {
                let from = self.origin[k] + SIDE * f64::from(index[k]);
                low = low.max(from - BEYOND_PX);
                high = high.min(from + SIDE + BEYOND_PX);
            }
            (rect[k], rect[k + 2]) = (low, high);
        }
        (rect[0] < rect[2] && rect[1] < rect[3]).then_some(rect)
    }
}
