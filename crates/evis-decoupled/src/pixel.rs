//! A pixel's luminance at a time: the sum over what it sees of area times mean light.

use std::time::Instant;

use crate::blocks::Block;
use crate::coverage::{Moments, Regions};
use crate::fragment::Fragment;
use crate::light::{Lighting, TileLight};
use crate::lists::{Entry, Lists, TILE};
use crate::world::World;

/// Every so many evaluations are timed.
const TIMED: u64 = 64;

/// What evaluations of one block need.
pub struct Evaluator<'a> {
    /// The scene.
    pub world: &'a World<'a>,
    /// What the block may show.
    pub lists: &'a Lists,
    /// What surfaces send.
    pub lighting: &'a Lighting<'a>,
    /// The block.
    pub block: Block,
}

/// Room for the work on one pixel after another.
#[derive(Default)]
pub struct Work {
    centre: [f64; 2],
    /// Indices into the tile's entries, and whether each covers the pixel throughout.
    entries: Vec<(usize, u32, bool)>,
    fragments: Vec<Fragment>,
    /// Per fragment, its index into the tile's entries.
    slots: Vec<usize>,
    regions: Regions,
    moments: Vec<Moments>,
    light: TileLight,
    count: u64,
    /// Evaluations that saw one facet only.
    pub plain: u64,
    /// Extrapolated seconds of coverage.
    pub coverage_s: f64,
    /// Extrapolated seconds of shading.
    pub shading_s: f64,
}

impl Work {
    /// Entries of the pixel in work.
    pub fn entry_count(&self) -> usize {
        self.entries.len()
    }
}

impl Evaluator<'_> {
    /// Fastest motion of what a tile may see, in pixels per microsecond.
    pub fn speed(&self, entries: &[Entry], [column, row]: [usize; 2]) -> f64 {
        let low = [column, row].map(|v| (v * TILE) as f64);
        let mut fastest = 0.0_f64;
        for entry in entries {
            let record = &self.lists.records[entry.record as usize];
            let at = [0, 1].map(|k| {
                let (from, to) = (record.rect[k].max(low[k]), record.rect[k + 2].min(low[k] + TILE as f64));
                0.5 * (from + to)
            });
            let moved = record.motion_px(at);
            let part = record.u[1] - record.u[0];
            fastest = fastest.max(moved / (part * self.block.length_us()));
        }
        // Margin for what lies elsewhere in the tile.
        1.25 * fastest
    }

    /// Prepares `work` for a tile.
    pub fn enter_tile(&self, work: &mut Work, entries: &[Entry], tile: [usize; 2]) {
        self.lighting.enter_tile(&mut work.light, entries, tile);
    }

    /// Prepares `work` for pixel `at`, number `pixel` of its tile.
    pub fn enter_pixel(&self, work: &mut Work, entries: &[Entry], at: [usize; 2], pixel: usize) {
        work.centre = at.map(|v| v as f64 + 0.5);
        work.entries.clear();
        for (slot, entry) in entries.iter().enumerate() {
            if entry.touches >> pixel & 1 == 1 {
                work.entries.push((slot, entry.record, entry.covers >> pixel & 1 == 1));
            }
        }
    }

    /// Mean luminance of the pixel at `t_us`.
    pub fn luminance(&self, work: &mut Work, t_us: f64) -> f64 {
        work.count += 1;
        let timer = work.count.is_multiple_of(TIMED).then(Instant::now);
        let u = ((t_us - self.block.start_us) / self.block.length_us()).clamp(0.0, 1.0);
        work.fragments.clear();
        work.slots.clear();
        for &(slot, index, _) in &work.entries {
            let record = &self.lists.records[index as usize];
            let [from, to] = record.u;
            // A span holds from its start up to its end; the last one also at the end of the block.
            if u < from || (u >= to && to < 1.0) {
                continue;
            }
            let v = (u - from) / (to - from);
            if let Some(fragment) = Fragment::new(record, index, work.centre, v, self.world.lens.near) {
                work.fragments.push(fragment);
                work.slots.push(slot);
            }
        }
        let whole = matches!(&work.fragments[..], [one] if one.edge_count == 0);
        if whole {
            work.plain += 1;
        } else {
            work.regions.cut(&work.fragments);
            work.moments.clear();
            work.moments.resize(work.fragments.len() + 1, Moments::default());
            for region in &work.regions.regions {
                let owner = region.fragment.unwrap_or(work.fragments.len());
                work.moments[owner].add(&region.polygon.moments());
            }
        }
        let covered = timer.map(|t| (t.elapsed().as_secs_f64(), Instant::now()));
        let mut sum = 0.0;
        if whole {
            sum = self.lighting.of_fragment(
                &mut work.light,
                &self.lists.records[work.fragments[0].record as usize],
                work.slots[0],
                &work.fragments[0],
                &Moments::PIXEL,
                None,
                work.centre,
                u,
            );
        } else {
            for (k, fragment) in work.fragments.iter().enumerate() {
                let moments = &work.moments[k];
                if moments.area > 1e-9 {
                    let own = Some((&work.regions.regions[..], k));
                    let (light, slot) = (&mut work.light, work.slots[k]);
                    let record = &self.lists.records[fragment.record as usize];
                    let at = work.centre;
                    sum += self.lighting.of_fragment(light, record, slot, fragment, moments, own, at, u);
                }
            }
            let rest = &work.moments[work.fragments.len()];
            if rest.area > 1e-9 {
                sum += rest.area * self.lighting.background(work.centre, rest, u);
            }
        }
        if let Some((coverage, since)) = covered {
            work.coverage_s += coverage * TIMED as f64;
            work.shading_s += since.elapsed().as_secs_f64() * TIMED as f64;
        }
        sum
    }
}
