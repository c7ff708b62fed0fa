//! A pixel's luminance at a time: the sum over what it sees of area times mean light.
//!
//! Times are whole parts of a block, so that the pixels of a tile share what its facets and shadows are at a time: a
//! pixel only moves their lines to its own centre. At times at which many pixels are evaluated, bits say which facets each
//! of them sees, and those that see one only are found together: neighbours share edges on its texture.

use std::time::Instant as Timer;

use crate::packed;
use crate::scene::tiles::{PIXELS, TileView};
use crate::scene::world::World;
use crate::shading::light::packed::{RowPacker, halves};
use crate::shading::light::{Instant, Lighting, Part, TileLight, bits};
use crate::shading::shadow::Beam;
use crate::visibility::blocks::Block;
use crate::visibility::coverage::{Moments, Regions};
use crate::visibility::fragment::{Fragment, Sight};
use crate::visibility::lists::{Entry, Lists, TileList};

/// Every so many evaluations are timed.
const TIMED: u64 = 64;
/// A pixel may be evaluated at multiples of this part of a block: it has thirds, and halves of them and of itself.
pub const UNITS: u32 = 3072;

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

/// A facet of a tile at a time.
#[derive(Clone, Copy)]
enum Known {
    /// Nobody asked.
    Not,
    /// It is not there.
    Absent,
    /// Its number among [`Work::sights`].
    Seen(u32),
}

/// An entry of a pixel.
#[derive(Clone, Copy)]
struct Own {
    slot: usize,
    record: u32,
    /// It fills the pixel throughout the block.
    covers: bool,
}

/// A tile at a time at which several of its pixels are evaluated.
struct Layer {
    /// Luminance of the pixels that see one facet only; NaN of others.
    luminance: [f64; PIXELS],
    /// Where in [`Work::touched`] its entries begin.
    touched: usize,
}

/// Room for the work on one tile after another.
pub struct Work {
    view: TileView,
    /// Per pixel, where in `own` its entries are.
    owns: [[u32; 2]; PIXELS],
    /// Pixels in which nothing is seen of what lies behind everything.
    filled: u64,
    /// Per pixel, every how many units it is surely evaluated; 0 for never.
    strides: [u32; PIXELS],
    layers: Vec<Layer>,
    /// Per moment, its number among `layers` plus 1.
    layer_of: Vec<u32>,
    /// Per layer and entry, pixels that see it.
    touched: Vec<u64>,
    /// Of the layer in work: entries that cover whole pixels, their sights, and these pixels.
    whole: Vec<(usize, u32, u64)>,
    /// By time: the number of the moment plus 1.
    numbers: Vec<u16>,
    moments: Vec<Instant>,
    /// By moment and entry.
    known: Vec<Known>,
    sights: Vec<Sight>,
    /// Per entry, how often a device evaluates pixels that see it, and those into which a shadow of what moves comes.
    entry_strides: Vec<[u32; 2]>,
    /// Per entry: motion during the block in pixels; and of what lies behind all.
    motion: Vec<f64>,
    background_motion: f64,
    slot_count: usize,
    pixel: usize,
    own: Vec<Own>,
    /// Of the pixel in work, as many as there are in `seen`; room beyond.
    fragments: Vec<Fragment>,
    /// Per fragment, its entry and sight.
    seen: Vec<(usize, u32)>,
    regions: Regions,
    light: TileLight,
    count: u64,
    /// Evaluations that saw one facet only.
    pub plain: u64,
    /// Extrapolated seconds of coverage.
    pub coverage_s: f64,
    /// Extrapolated seconds of shading.
    pub shading_s: f64,
}

impl Default for Work {
    fn default() -> Self {
        Self {
            view: TileView::default(),
            owns: [[0; 2]; PIXELS],
            filled: 0,
            strides: [0; PIXELS],
            layers: Vec::new(),
            layer_of: Vec::new(),
            touched: Vec::new(),
            whole: Vec::new(),
            numbers: vec![0; UNITS as usize + 1],
            moments: Vec::new(),
            known: Vec::new(),
            sights: Vec::new(),
            entry_strides: Vec::new(),
            motion: Vec::new(),
            background_motion: 0.0,
            slot_count: 0,
            pixel: 0,
            own: Vec::new(),
            fragments: Vec::new(),
            seen: Vec::new(),
            regions: Regions::default(),
            light: TileLight::default(),
            count: 0,
            plain: 0,
            coverage_s: 0.0,
            shading_s: 0.0,
        }
    }
}

impl Work {
    /// Entries of pixel number `pixel` of the tile, whose activity is known.
    pub fn entry_count(&self, pixel: usize) -> usize {
        let [from, to] = self.owns[pixel];
        (to - from) as usize
    }

    /// Pixels of the tile in which the lens shows something.
    pub fn pixels(&self) -> u64 {
        self.view.pixels
    }

    /// See [`TileLight::beams`], once activities are known.
    pub fn beams(&self) -> &[Option<Beam>] {
        &self.light.beams
    }
}

/// A tile that a device may prepare.
pub struct TileActivity {
    /// Nothing of any of its pixels changes.
    pub still: bool,
    /// Entries of all its pixels, together.
    pub entries: usize,
    /// See [`packed::strides`], of what lies behind everything.
    background_strides: u32,
}

/// What a pixel's light does during a block.
#[derive(Clone, Copy, Debug)]
pub struct PixelActivity {
    /// Nothing of it changes.
    pub still: bool,
    /// Fastest motion of what it may see and of shadows on it, in pixels during the block.
    pub motion_px: f64,
    /// Periods of the fastest sine that its light follows, during the block.
    pub periods: f64,
}

impl PixelActivity {
    /// Nothing changes.
    const STILL: Self = Self { still: true, motion_px: 0.0, periods: 0.0 };

    /// Adds what does `other`.
    fn join(&mut self, other: &Self) {
        self.still &= other.still;
        self.motion_px = self.motion_px.max(other.motion_px);
        self.periods = self.periods.max(other.periods);
    }
}

impl Evaluator<'_> {
    /// Prepares `work` for a tile.
    pub fn enter_tile(&self, work: &mut Work, list: &TileList, tile: [usize; 2]) {
        let entries = &list.entries[..];
        work.filled = list.filled;
        work.view = self.world.tile(tile);
        work.own.clear();
        work.strides.fill(0);
        work.layers.clear();
        work.layer_of.clear();
        work.touched.clear();
        work.numbers.fill(0);
        work.moments.clear();
        work.known.clear();
        work.sights.clear();
        work.slot_count = entries.len();
        work.motion.clear();
        let (rect, scale) = (work.view.rect, work.view.scale);
        work.motion.extend(entries.iter().map(|entry| {
            let record = &self.lists.records[entry.record as usize];
            let at = [0, 1].map(|k| {
                let (from, to) = (record.rect[k].max(rect[k]), record.rect[k + 2].min(rect[k + 2]));
                0.5 * (from + to)
            });
            if record.still {
                return 0.0;
            }
            let cut = Sight::cut_motion(record, &work.view, &self.lists.depths);
            // Margin for what lies elsewhere in the tile.
            (1.25 * scale * record.motion_px(at)).max(cut) / (record.u[1] - record.u[0])
        }));
        self.lighting.enter_tile(&mut work.light, entries, tile);
        work.background_motion = self.lighting.background_motion(&work.light);
    }

    /// Goes on to pixel number `pixel` of the tile, whose activity is known.
    pub fn enter_pixel(&self, work: &mut Work, pixel: usize) {
        work.pixel = pixel;
    }

    /// Says that pixel number `pixel` will be evaluated at all multiples of `stride` units.
    pub fn expect(&self, work: &mut Work, pixel: usize, stride: u32) {
        work.strides[pixel] = stride;
    }

    /// What pixel number `pixel` of the tile sees, and what that does; to be asked once for each pixel, before any is entered.
    pub fn activity(&self, work: &mut Work, entries: &[Entry], pixel: usize) -> PixelActivity {
        let from = work.own.len();
        let mut activity = PixelActivity::STILL;
        for (slot, entry) in entries.iter().enumerate().filter(|(_, entry)| entry.touches >> pixel & 1 == 1) {
            let covers = entry.covers >> pixel & 1 == 1;
            work.own.push(Own { slot, record: entry.record, covers });
            let (own, shadows, moved) = self.entry_activity(work, (slot, entry));
            activity.join(&own);
            if moved >> pixel & 1 == 1 {
                activity.join(&shadows);
            }
        }
        if work.filled >> pixel & 1 == 0 {
            activity.join(&self.background_activity(work));
        }
        work.owns[pixel] = [from, work.own.len()].map(|v| v as u32);
        activity
    }

    /// What a pixel's light does that sees entry `slot` of the tile, and what it does besides where shadows of what moves come, with
    /// the pixels into which these may come.
    fn entry_activity(
        &self,
        work: &mut Work,
        (slot, entry): (usize, &Entry),
    ) -> (PixelActivity, PixelActivity, u64) {
        let record = &self.lists.records[entry.record as usize];
        self.lighting.ready(&mut work.light, record, entry.record, slot);
        let (still, moved_px, moved) = self.lighting.changes_of(&work.light, slot);
        let block_s = self.block.length_us() * 1e-6 * self.world.scene.speed.unwrap_or(1.0);
        let own = PixelActivity {
            still: still && record.still,
            // A highlight bends light as an edge does in a pixel.
            motion_px: work.motion[slot].max(self.lighting.lobes(&work.light, slot)),
            periods: block_s * self.lighting.sine_hz(&work.light, slot),
        };
        (own, PixelActivity { still: false, motion_px: moved_px, periods: 0.0 }, moved)
    }

    /// What the light of a pixel does that sees what lies behind everything.
    fn background_activity(&self, work: &Work) -> PixelActivity {
        if self.lighting.background_rests() {
            return PixelActivity::STILL;
        }
        PixelActivity { still: false, motion_px: work.background_motion, periods: 0.0 }
    }

    /// What the `pixels` of the tile see all together, and what that does; `strides` says how often a device evaluates what is so
    /// active, see [`packed::strides`].
    pub fn tile_activity(
        &self,
        work: &mut Work,
        entries: &[Entry],
        pixels: u64,
        strides: impl Fn(&PixelActivity) -> u32,
    ) -> TileActivity {
        let strides = |activity: PixelActivity| if activity.still { 0 } else { strides(&activity) };
        work.entry_strides.clear();
        let (mut still, mut count) = (true, 0);
        for (slot, entry) in entries.iter().enumerate() {
            let touches = entry.touches & pixels;
            let (own, shadows, moved) = self.entry_activity(work, (slot, entry));
            let shadows = if moved & touches == 0 { PixelActivity::STILL } else { shadows };
            still &= touches == 0 || own.still && shadows.still;
            count += touches.count_ones() as usize;
            work.entry_strides.push([own, shadows].map(strides));
        }
        let sees_background = pixels & !work.filled != 0;
        let background = if sees_background { self.background_activity(work) } else { PixelActivity::STILL };
        still &= background.still;
        TileActivity { still, entries: count, background_strides: strides(background) }
    }

    /// Whether luminance of pixel number `pixel` surely stays between `low` and `high` throughout the block.
    ///
    /// It is a mean of what facets that the pixel may see send, weighted by their areas, so that it lies between the least and
    /// the most of these.
    pub fn stays_within(&self, work: &mut Work, pixel: usize, [low, high]: [f64; 2]) -> bool {
        let within = |[least, most]: [f64; 2]| low < least && most < high;
        if work.filled >> pixel & 1 == 0
            && !self.lighting.steady_background().is_some_and(|light| within([light; 2]))
        {
            return false;
        }
        let [from, to] = work.owns[pixel].map(|v| v as usize);
        work.own[from..to].iter().all(|own| {
            let (light, slot) = (&mut work.light, own.slot);
            let record = &self.lists.records[own.record as usize];
            let Some(bounds) = self.lighting.bounds(light, record.facet, slot) else { return false };
            if within(light.range(&bounds, slot, pixel)) {
                return true;
            }
            // What stands still may throw no shadow there.
            self.lighting.shade_slot(light, record, slot);
            within(light.range(&bounds, slot, pixel))
        })
    }

    /// Appends to `packer` a tile that a device prepares, of which the `pixels` are followed, once its `activity` is known: returned
    /// without what its pixels remember. `None` where a device cannot show it, and nothing is appended.
    pub fn pack_tile(
        &self,
        work: &mut Work,
        (entries, activity): (&[Entry], &TileActivity),
        pixels: u64,
        packer: &mut RowPacker,
    ) -> Option<packed::Tile> {
        self.can_pack(work, (entries, pixels), packer)?;
        let first = packer.row.entries.len();
        for (slot, entry) in entries.iter().enumerate().filter(|(_, entry)| entry.touches & pixels != 0) {
            let number = self.pack_entry(work, (slot, entry), packer);
            let facet = self.lists.records[entry.record as usize].facet;
            let bounds = self.lighting.pack_bounds(&mut work.light, (slot, facet), packer);
            let (_, _, moved) = self.lighting.changes_of(&work.light, slot);
            let packed = &mut packer.row.entries[number as usize];
            [packed.touches, packed.covers, packed.moved] =
                [entry.touches, entry.covers, moved].map(|mask| halves(mask & pixels));
            [packed.strides, packed.moved_strides] = work.entry_strides[slot];
            if let Some(bounds) = bounds {
                packed.bounds = bounds;
                packed.flags |= packed::BOUNDED;
            }
        }
        let centre = packer.centre();
        let row = &mut packer.row;
        let mut tile = packed::Tile {
            first: middle_of(work, 0, centre),
            pixels: halves(pixels),
            filled: halves(work.filled),
            entries: first as u32,
            entry_count: (row.entries.len() - first) as u32,
            own: row.own as u32,
            background_strides: activity.background_strides,
            frames: packed::NO_FRAMES,
            ..packed::Tile::default()
        };
        row.own += activity.entries;
        if !work.view.is_square() {
            tile.frames = row.points.len() as u32;
            (0..PIXELS).for_each(|pixel| row.points.extend(frame_rows(work, pixel, centre)));
        }
        Some(tile)
    }

    /// Those of the `pixels` of a tile that may see a facet with maps; `None` where a device cannot show it.
    fn can_pack(&self, work: &Work, (entries, pixels): (&[Entry], u64), packer: &RowPacker) -> Option<u64> {
        let facet = |entry: &Entry| self.lists.records[entry.record as usize].facet;
        let seen = entries.iter().filter(|entry| entry.touches & pixels != 0);
        let mapped = seen.filter(|entry| self.lighting.has_maps(facet(entry)));
        let mapped = mapped.fold(0, |mapped, entry| mapped | entry.touches);
        // Parameters of facets are linear before parallel rays, and projective behind a lens that bends them.
        let is_bent_and_parallel = !work.view.is_square() && self.lists.depths.far.is_finite();
        ((mapped == 0 || packer.has_maps()) && !is_bent_and_parallel).then_some(mapped)
    }

    /// Appends entry `slot` of a tile to `packer`; its number in the row.
    fn pack_entry(&self, work: &mut Work, (slot, entry): (usize, &Entry), packer: &mut RowPacker) -> u32 {
        let record = &self.lists.records[entry.record as usize];
        self.lighting.shade_slot(&mut work.light, record, slot);
        self.lighting.pack_entry(&work.light, slot, (record, entry.record), packer)
    }

    /// Appends to `packer` what the `pixels` of a tile may see, once their activities are known, and returns these, without their
    /// paths; `None` where a device cannot show it, and nothing is appended.
    pub fn pack(
        &self,
        work: &mut Work,
        entries: &[Entry],
        pixels: u64,
        packer: &mut RowPacker,
    ) -> Option<Vec<packed::Pixel>> {
        let lighting = self.lighting;
        let mapped = self.can_pack(work, (entries, pixels), packer)?;
        let bent = !work.view.is_square();
        let mut numbers = vec![0; entries.len()];
        for (slot, entry) in entries.iter().enumerate().filter(|(_, entry)| entry.touches & pixels != 0) {
            numbers[slot] = self.pack_entry(work, (slot, entry), packer);
        }
        let packed = |pixel: usize| {
            let own = &work.own[work.owns[pixel][0] as usize..work.owns[pixel][1] as usize];
            let first = packer.row.words.len() as u32;
            let of = |own: &Own| numbers[own.slot] | if own.covers { packed::COVERS } else { 0 };
            packer.row.words.extend(own.iter().map(of));
            let centre = middle_of(work, pixel, packer.centre());
            let (own_count, number) = (own.len() as u32, pixel as u32);
            let plain = |own: &Own| own.covers && !lighting.is_shadowed(&work.light, own.slot, pixel);
            let mut packed = packed::Pixel { centre, own: first, own_count, number, ..Default::default() };
            if bent {
                packed.flags |= packed::BENT;
                packed.frame = packer.row.points.len() as u32;
                let rows = frame_rows(work, pixel, packer.centre());
                packer.row.points.extend(rows);
            }
            if mapped >> pixel & 1 == 1 {
                packed.flags |= packed::MAPPED;
            } else if !bent && matches!(own, [own] if plain(own)) {
                packed.flags |= packed::PLAIN;
            }
            packed
        };
        Some(bits(pixels).map(packed).collect())
    }

    /// Number of the moment `unit` of [`UNITS`] of the block.
    fn moment(&self, work: &mut Work, unit: u32) -> usize {
        let number = work.numbers[unit as usize];
        if number > 0 {
            return usize::from(number) - 1;
        }
        let u = f64::from(unit) / f64::from(UNITS);
        let t_s = self.world.scene_seconds(self.block.at(u));
        let index = work.moments.len();
        work.moments.push(Instant { moment: index, u, t_s });
        work.numbers[unit as usize] = index as u16 + 1;
        work.known.resize(work.moments.len() * work.slot_count, Known::Not);
        work.layer_of.push(0);
        index
    }

    /// The number of what entry `slot`, record `index`, is at a time; `None` where it is not there.
    #[inline(always)]
    fn sight(&self, work: &mut Work, slot: usize, index: u32, at: &Instant) -> Option<u32> {
        let place = at.moment * work.slot_count + slot;
        match work.known[place] {
            Known::Seen(number) => Some(number),
            Known::Absent => None,
            Known::Not => {
                let found = self.find_sight(work, index, at);
                work.known[place] = found.map_or(Known::Absent, Known::Seen);
                found
            }
        }
    }

    #[inline(never)]
    fn find_sight(&self, work: &mut Work, index: u32, at: &Instant) -> Option<u32> {
        let record = &self.lists.records[index as usize];
        let [from, to] = record.u;
        // A span holds from its start up to its end; the last one also at the end of the block.
        if at.u < from || (at.u >= to && to < 1.0) {
            return None;
        }
        let v = (at.u - from) / (to - from);
        work.sights.push(Sight::new(record, &work.view, v, &self.lists.depths)?);
        Some(work.sights.len() as u32 - 1)
    }

    /// Mean luminance of a pixel that sees entry `slot`, record `index`, and nothing else.
    fn of_one(&self, work: &mut Work, slot: usize, index: u32, at: &Instant) -> f64 {
        let Some(sight) = self.sight(work, slot, index, at) else { return 0.0 };
        let sight = &work.sights[sight as usize];
        self.lighting.shade_slot(&mut work.light, &self.lists.records[index as usize], slot);
        let (pixel, frame) = (work.pixel, work.view.pixel(work.pixel));
        let part = Part { slot, sight, moments: &Moments::PIXEL, regions: None, pixel, frame };
        self.lighting.of_part(&mut work.light, &part, at)
    }

    /// The tile at a moment, `unit` of the block; `None` where the pixel in work is not surely evaluated then.
    fn layer(&self, work: &mut Work, entries: &[Entry], unit: u32, at: &Instant) -> Option<usize> {
        let expected = |stride: u32| stride > 0 && unit.is_multiple_of(stride);
        if !expected(work.strides[work.pixel]) {
            return None;
        }
        if work.layer_of[at.moment] == 0 {
            let pixels = (0..PIXELS).filter(|p| expected(work.strides[*p])).fold(0, |m, p| m | 1 << p);
            self.find_layer(work, entries, pixels, at);
        }
        Some(work.layer_of[at.moment] as usize - 1)
    }

    /// Finds what of the tile the `pixels` see at a time, and the light of those that see one facet only.
    fn find_layer(&self, work: &mut Work, entries: &[Entry], pixels: u64, at: &Instant) {
        let touched = work.touched.len();
        work.whole.clear();
        for (slot, entry) in entries.iter().enumerate() {
            let mut seen = 0;
            if entry.touches & pixels != 0
                && let Some(number) = self.sight(work, slot, entry.record, at)
            {
                let (some, whole) = work.sights[number as usize].pixels();
                seen = entry.touches & (some | entry.covers);
                let whole = entry.touches & (whole | entry.covers) & pixels;
                if whole != 0 {
                    work.whole.push((slot, number, whole));
                }
            }
            work.touched.push(seen);
        }
        let mut luminance = [f64::NAN; PIXELS];
        for k in 0..work.whole.len() {
            let (slot, number, mut alone) = work.whole[k];
            let sight = &work.sights[number as usize];
            for (other, seen) in work.touched[touched..].iter().enumerate() {
                if other != slot
                    && alone & seen != 0
                    && let Known::Seen(number) = work.known[at.moment * work.slot_count + other]
                {
                    alone &= !seen | sight.pixels_before(&work.sights[number as usize]);
                }
            }
            if alone != 0 {
                let index = entries[slot].record;
                self.lighting.shade_slot(&mut work.light, &self.lists.records[index as usize], slot);
                self.lighting.of_pixels(&mut work.light, (slot, sight), alone, at, &mut luminance);
            }
        }
        work.layers.push(Layer { luminance, touched });
        work.layer_of[at.moment] = work.layers.len() as u32;
    }

    /// Mean luminance of the pixel in work at `unit` of [`UNITS`] of the block; `entries` are those of its tile.
    pub fn luminance(&self, work: &mut Work, entries: &[Entry], unit: u32) -> f64 {
        work.count += 1;
        let timer = work.count.is_multiple_of(TIMED).then(Timer::now);
        let moment = self.moment(work, unit);
        let at = work.moments[moment];
        let layer = self.layer(work, entries, unit, &at);
        let touched = layer.map(|number| work.layers[number].touched);
        if let Some(luminance) = layer.map(|number| work.layers[number].luminance[work.pixel])
            && !luminance.is_nan()
        {
            work.plain += 1;
            work.shading_s += timer.map_or(0.0, |t| t.elapsed().as_secs_f64() * TIMED as f64);
            return luminance;
        }
        let frame = work.view.pixel(work.pixel);
        let [from, to] = work.owns[work.pixel].map(|v| v as usize);
        if let [Own { slot, record, covers: true }] = work.own[from..to] {
            work.plain += 1;
            let light = self.of_one(work, slot, record, &at);
            work.shading_s += timer.map_or(0.0, |t| t.elapsed().as_secs_f64() * TIMED as f64);
            return light;
        }
        work.seen.clear();
        for k in from..to {
            let Own { slot, record: index, covers } = work.own[k];
            if touched.is_some_and(|start| work.touched[start + slot] >> work.pixel & 1 == 0) {
                continue;
            }
            if let Some(sight) = self.sight(work, slot, index, &at) {
                let number = work.seen.len();
                if work.fragments.len() == number {
                    work.fragments.push(Fragment::default());
                }
                if work.sights[sight as usize].fill(&mut work.fragments[number], index, &frame, covers) {
                    work.seen.push((slot, sight));
                }
            }
        }
        let fragments = &work.fragments[..work.seen.len()];
        let whole = matches!(fragments, [one] if one.edge_count == 0);
        if whole {
            work.plain += 1;
        } else {
            let backdrop = Regions::backdrop(fragments);
            let plain = backdrop.is_none_or(|k| {
                let (slot, index) = (work.seen[k].0, fragments[k].record);
                let record = &self.lists.records[index as usize];
                self.lighting.shade_slot(&mut work.light, record, slot);
                !self.lighting.is_shadowed(&work.light, slot, work.pixel)
            });
            work.regions.find(fragments, &self.world.neighbors, (backdrop, plain));
        }
        let covered = timer.map(|t| (t.elapsed().as_secs_f64(), Timer::now()));
        let mut sum = 0.0;
        for (k, fragment) in fragments.iter().enumerate() {
            let moments = if whole { &Moments::PIXEL } else { &work.regions.areas[k] };
            if moments.area > 1e-9 {
                let (slot, sight) = (work.seen[k].0, &work.sights[work.seen[k].1 as usize]);
                let regions = (!whole).then_some((&work.regions.regions, k as u32));
                let pixel = work.pixel;
                let index = fragment.record;
                let record = &self.lists.records[index as usize];
                self.lighting.shade_slot(&mut work.light, record, slot);
                let part = Part { slot, sight, moments, regions, pixel, frame };
                sum += self.lighting.of_part(&mut work.light, &part, &at);
            }
        }
        if !whole {
            let rest = &work.regions.areas[fragments.len()];
            if rest.area > 1e-9 {
                sum += rest.area * self.lighting.background(&work.view, &frame, rest, at.u);
            }
        }
        if let Some((coverage, since)) = covered {
            work.coverage_s += coverage * TIMED as f64;
            work.shading_s += since.elapsed().as_secs_f64() * TIMED as f64;
        }
        sum
    }
}

/// The middle of a pixel on the picture without distortion, from the picture's `centre`.
fn middle_of(work: &Work, pixel: usize, centre: [f64; 2]) -> [f32; 2] {
    let at = work.view.image_point(work.view.pixel(pixel).middle);
    [at.x - centre[0], at.y - centre[1]].map(|v| v as f32)
}

/// Rows of a pixel behind a distorted lens, see [`packed::Pixel::frame`]; `centre` is the picture's.
fn frame_rows(work: &Work, pixel: usize, centre: [f64; 2]) -> impl Iterator<Item = [f32; 4]> + use<> {
    let maps = work.view.pixel_maps(pixel, centre);
    let rows = maps.map(|map| map.transpose().to_cols_array_2d());
    rows.into_iter().flatten().map(|[x, y, z]| [x as f32, y as f32, z as f32, 0.0])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shading::light::Shared;
    use crate::visibility::blocks::Clock;

    /// Luminance of all pixels at `unit` of `block`: tile by tile, and each for itself.
    fn pictures(scene: &evis_scene::Scene, block: Block, unit: u32) -> (Vec<[f64; 2]>, usize) {
        let world = World::new(scene, 0, Some((100, 76))).unwrap();
        let mut clock = Clock::new(&world, block);
        let lists = Lists::new(&world, &mut clock).unwrap();
        let mut lighting = Lighting::new(&world, &Shared::new(scene));
        lighting.prepare(&mut clock).unwrap();
        let evaluator = Evaluator { world: &world, lists: &lists, lighting: &lighting, block };
        let mut work = Work::default();
        let (mut out, mut together) = (Vec::new(), 0);
        for row in 0..lists.row_count() {
            for (column, list) in lists.row(&world, row).iter().enumerate() {
                let entries = &list.entries[..];
                let from = out.len();
                for stride in [1, 0] {
                    evaluator.enter_tile(&mut work, list, [column, row]);
                    for pixel in 0..PIXELS {
                        evaluator.activity(&mut work, entries, pixel);
                        evaluator.expect(&mut work, pixel, stride);
                    }
                    for pixel in 0..PIXELS {
                        evaluator.enter_pixel(&mut work, pixel);
                        let luminance = evaluator.luminance(&mut work, entries, unit);
                        if stride == 1 {
                            out.push([luminance; 2]);
                        } else {
                            out[from + pixel][1] = luminance;
                        }
                    }
                    let layers = work.layers.iter().flat_map(|l| l.luminance);
                    together += layers.filter(|v| !v.is_nan()).count();
                }
            }
        }
        (out, together)
    }

    #[test]
    fn light_stays_between_its_bounds() {
        let names = ["spinner", "desk", "street", "warehouse"];
        let mut scenes: Vec<_> = names.map(|n| (n, evis_scene::builtin::load(n, 0).unwrap())).into();
        scenes.push(("solids", crate::scene::testing::solids()));
        let block = Block { start_us: 98_304.0, end_us: 131_072.0, jump: false };
        for (name, scene) in &scenes {
            let world = World::new(scene, 0, Some((100, 76))).unwrap();
            let mut clock = Clock::new(&world, block);
            let lists = Lists::new(&world, &mut clock).unwrap();
            let mut lighting = Lighting::new(&world, &Shared::new(scene));
            lighting.prepare(&mut clock).unwrap();
            let evaluator = Evaluator { world: &world, lists: &lists, lighting: &lighting, block };
            let mut work = Work::default();
            // Pixels that move, and those of them of which bounds say that light stays within a fifth of itself.
            let (mut count, mut near) = (0, 0);
            for row in 0..lists.row_count() {
                for (column, list) in lists.row(&world, row).iter().enumerate() {
                    evaluator.enter_tile(&mut work, list, [column, row]);
                    let still: [bool; PIXELS] = std::array::from_fn(|pixel| {
                        evaluator.activity(&mut work, &list.entries, pixel).still
                    });
                    for pixel in (0..PIXELS).filter(|pixel| !still[*pixel]) {
                        evaluator.enter_pixel(&mut work, pixel);
                        let at = |unit| evaluator.luminance(&mut work, &list.entries, unit);
                        let light: Vec<f64> = (0..=UNITS).step_by(UNITS as usize / 12).map(at).collect();
                        let [low, high] =
                            [f64::min, f64::max].map(|of| light.iter().copied().fold(light[0], of));
                        let (inside, tiny) = (f64::INFINITY, 1e-4 * high);
                        let mut within = |range| evaluator.stays_within(&mut work, pixel, range);
                        assert!(!within([low + tiny, inside]), "{name}, {column} {row} {pixel}: {light:?}");
                        assert!(!within([-inside, high - tiny]), "{name}, {column} {row} {pixel}: {light:?}");
                        near += usize::from(within([low / 1.2, high * 1.2]));
                        count += 1;
                    }
                }
            }
            println!("{name}: of {count} pixels that move {near} stay within a fifth");
            assert!(count > 500 && (*name != "solids" || 2 * near > count), "{near} of {count}");
        }
    }

    #[test]
    fn a_tile_at_once_sees_what_its_pixels_see() {
        let names = ["spinner", "desk", "street", "warehouse"];
        let scenes = names.map(|name| evis_scene::builtin::load(name, 0).unwrap());
        let block = Block { start_us: 98_304.0, end_us: 131_072.0, jump: false };
        let (mut all, mut together) = (0, 0);
        for (name, scene) in names.iter().zip(&scenes) {
            for unit in [0, UNITS / 3, UNITS] {
                let (found, alone) = pictures(scene, block, unit);
                let mean = found.iter().map(|v| v[1]).sum::<f64>() / found.len() as f64;
                let off = found.iter().map(|[a, b]| (a - b).abs() / (b + 0.05 * mean).max(1e-9));
                let worst = off.clone().fold(0.0, f64::max);
                let rms = (off.map(|v| v * v).sum::<f64>() / found.len() as f64).sqrt();
                println!(
                    "{name} at {unit}: {alone} of {} together, worst {worst:.4}, RMS {rms:.5}",
                    found.len()
                );
                assert!(worst < 0.08 && rms < 0.004, "{name} at {unit}: {worst} {rms}");
                all += found.len();
                together += alone;
            }
        }
        assert!(together * 2 > all, "{together} of {all} pixels were found together");
    }
}
