//! What a device is given of a block, as `shaders/decoupled/layout.wgsl` reads it: 32 bits, indices in the place of references.
//!
//! Indices of a row of tiles count from where that row's own arrays begin, so that rows are packed in parallel and joined by
//! copies.

use bytemuck::{Pod, Zeroable};

/// Most lamps whose light is kept apart, as there are bits in a byte; further ones throw no shadows.
pub const MOST_OWN: usize = 8;

/// [`Job::flags`]: light jumps where the block begins.
pub const JUMPS: u32 = 1;
/// [`Job::flags`]: the camera's rays are parallel.
pub const PARALLEL: u32 = 2;
/// [`Job::flags`]: light is wanted and nothing else.
pub const LIGHT_ALONE: u32 = 4;
/// [`Entry::flags`]: both sides are drawn.
pub const DOUBLE_SIDED: u32 = 1;
/// [`Entry::flags`]: its pose mirrors.
pub const MIRRORED: u32 = 2;
/// [`Entry::flags`]: a corner comes nearer than the near plane.
pub const CROSSES_NEAR: u32 = 4;
/// [`Entry::flags`]: a corner goes farther than the far plane.
pub const CROSSES_FAR: u32 = 8;
/// [`Entry::flags`]: it sends its base colour.
pub const UNLIT: u32 = 16;
/// [`Pixel::flags`]: there is light before the last.
pub const HAS_BEFORE: u32 = 1;
/// [`Pixel::flags`]: it was not followed through the block before.
pub const RESTED: u32 = 2;
/// [`Pixel::flags`]: it was never followed, and its reference is what it sees at the start.
pub const BEGINS: u32 = 4;
/// [`Pixel::flags`]: one facet fills it throughout, and no shadow comes into it.
pub const PLAIN: u32 = 8;
/// Of a pixel's entry: it fills the pixel throughout.
pub const COVERS: u32 = 1 << 31;

/// A value over a block: middle, half of its range, and cycles at the start of the block and during it.
pub type Wave = [f32; 4];

/// A value that stays.
pub const fn steady(value: f32) -> Wave {
    [value, 0.0, 0.0, 0.0]
}

/// A lamp whose light is kept apart.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Lamp {
    /// Homogeneous image point about the picture's centre as a quadratic of the block's time, and its weight: 1 for a place, 0
    /// for a direction.
    pub points: [[f32; 4]; 3],
    /// Its strength.
    pub wave: Wave,
}

/// A block.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Job {
    /// Length in microseconds.
    pub length_us: f32,
    /// What it begins at beyond a whole microsecond.
    pub start_us: f32,
    /// ON threshold.
    pub threshold_on: f32,
    /// OFF threshold.
    pub threshold_off: f32,
    /// Added before the logarithm.
    pub log_eps: f32,
    /// `Y_ref`.
    pub reference_luminance: f32,
    /// 1 / depth of the near plane.
    pub near: f32,
    /// 1 / depth of the far plane.
    pub far: f32,
    /// Luminance of what lies behind everything.
    pub background: f32,
    /// Lamps in use.
    pub lamps: u32,
    /// Pixels.
    pub pixels: u32,
    /// [`JUMPS`] and what follows it.
    pub flags: u32,
    /// Events that fit; the device's.
    pub capacity: u32,
    /// Row of [`Scene::rows`] at which texture number 0 begins.
    pub textures: u32,
    /// Row at which sums of texels begin.
    pub sums: u32,
    /// Unit of the block at which light is found where it is all that is wanted.
    pub unit: u32,
    /// Workgroups per row of the dispatch; the device's.
    pub row: u32,
    /// Zero.
    pub pad_0: u32,
    /// Zero.
    pub pad_1: u32,
    /// Zero.
    pub pad_2: u32,
    /// Lamps.
    pub own: [Lamp; MOST_OWN],
}

/// A facet in a tile.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Entry {
    /// First of nine rows of [`Row::points`].
    pub points: u32,
    /// Index of the facet.
    pub facet: u32,
    /// [`DOUBLE_SIDED`] and what follows it.
    pub flags: u32,
    /// Zero.
    pub pad: u32,
    /// Part of the block in which it holds.
    pub span: [f32; 2],
    /// Cells of its grid along s and t.
    pub cells: [f32; 2],
    /// First cell that is kept.
    pub first: [f32; 2],
    /// How many are.
    pub count: [u32; 2],
    /// First word of where nodes of its patches begin, moment by moment.
    pub patches: u32,
    /// Intervals between moments; 0 where light does not change.
    pub intervals: u32,
    /// Bits of lamps of which some arrives.
    pub lit: u32,
    /// First of [`SHADE_WORDS`] words per lamp.
    pub shades: u32,
    /// Emitted luminance; of an unlit surface the factor of its base colour.
    pub glow: Wave,
}

/// Words of a lamp's shadows on an entry: pixels that are dark, pixels into which a shadow may come (low and high word of each),
/// and its casters' first word and the one after their last.
pub const SHADE_WORDS: usize = 6;

/// Words of a caster: pixels that its shadow may darken (low and high word), and the first of its nine rows of [`Row::points`].
pub const CASTER_WORDS: usize = 3;

/// Rows of a facet in [`Scene::rows`].
pub const LOOK_ROWS: usize = 4;

/// A pixel, and what the device makes of it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Pixel {
    /// From the picture's centre.
    pub centre: [f32; 2],
    /// First word of its entries.
    pub own: u32,
    /// How many.
    pub own_count: u32,
    /// Number in its tile.
    pub number: u32,
    /// Word from which its row's bases are: entries, words, points and nodes.
    pub bases: u32,
    /// Units between evaluations; 0 of one that only jumps.
    pub stride: u32,
    /// Units to which intervals are halved.
    pub least: u32,
    /// Luminance at the start; then at the end.
    pub last: f32,
    /// Microseconds from the start, and luminance, of an evaluation before.
    pub before_us: f32,
    /// See there.
    pub before: f32,
    /// Logarithm of the reference.
    pub log: f32,
    /// Luminance of the next ON event.
    pub above: f32,
    /// Luminance of the next OFF event.
    pub below: f32,
    /// [`HAS_BEFORE`], [`RESTED`], [`BEGINS`], [`PLAIN`].
    pub flags: u32,
    /// Evaluations.
    pub evaluations: u32,
    /// 1: something did not fit, and what became of it counts for nothing.
    pub failed: u32,
    /// Zero.
    pub pad: u32,
}

/// An event of one of the pixels.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct Event {
    /// Number of the pixel in the block.
    pub pixel: u32,
    /// Whole microseconds from that in which the block begins, times two, and 1 of ON.
    pub word: u32,
}

/// What a row of tiles needs.
#[derive(Clone, Debug, Default)]
pub struct Row {
    /// Facets, tile by tile.
    pub entries: Vec<Entry>,
    /// Lists of numbers.
    pub words: Vec<u32>,
    /// Image points about the picture's centre as quadratics of time: nine rows each, by power and axis, of four corners.
    pub points: Vec<[f32; 4]>,
    /// Patches: a row whose first number is how many intervals there are along a side, then nodes, row by row, at each the
    /// response to unshadowed light and to each lamp.
    pub nodes: Vec<[f32; 4]>,
    /// Pixels to follow.
    pub pixels: Vec<Pixel>,
}

impl Row {
    /// Bytes of each of its arrays.
    fn bytes(&self) -> [usize; 5] {
        let Self { entries, words, points, nodes, pixels } = self;
        [
            size_of_val(&entries[..]),
            size_of_val(&words[..]),
            size_of_val(&points[..]),
            size_of_val(&nodes[..]),
            size_of_val(&pixels[..]),
        ]
    }

    /// How many of `rows`, one at least, have arrays of at most `room` bytes each when they are side by side.
    pub fn that_fit<'r>(rows: impl Iterator<Item = &'r Self>, room: usize) -> usize {
        let mut sums = [0; 5];
        let fits = |row: &Self| {
            for (sum, bytes) in sums.iter_mut().zip(row.bytes()) {
                *sum += bytes;
            }
            sums.iter().all(|sum| *sum <= room)
        };
        rows.map(fits).take_while(|fits| *fits).count().max(1)
    }
}

/// A block of a view, or of some rows of its tiles.
#[derive(Clone, Debug, Default)]
pub struct Block {
    /// What all pixels share.
    pub job: Job,
    /// All rows' entries.
    pub entries: Vec<Entry>,
    /// Four words per row, then all rows' words.
    pub words: Vec<u32>,
    /// All rows' points.
    pub points: Vec<[f32; 4]>,
    /// All rows' nodes.
    pub nodes: Vec<[f32; 4]>,
    /// All rows' pixels.
    pub pixels: Vec<Pixel>,
}

impl Block {
    /// `rows` side by side.
    pub fn new<'r>(job: Job, rows: impl Iterator<Item = &'r Row> + Clone) -> Self {
        let mut block = Self { job, words: vec![0; 4 * rows.clone().count()], ..Self::default() };
        for (number, row) in rows.enumerate() {
            let bases = [block.entries.len(), block.words.len(), block.points.len(), block.nodes.len()];
            block.words[4 * number..][..4].copy_from_slice(&bases.map(|at| at as u32));
            block.entries.extend_from_slice(&row.entries);
            block.words.extend_from_slice(&row.words);
            block.points.extend_from_slice(&row.points);
            block.nodes.extend_from_slice(&row.nodes);
            let of = |pixel: &Pixel| Pixel { bases: 4 * number as u32, ..*pixel };
            block.pixels.extend(row.pixels.iter().map(of));
        }
        block.job.pixels = block.pixels.len() as u32;
        block
    }
}

/// What stays from block to block.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// Four rows per facet: base colour and texture; its change along s and along t, with the texture's origin; change of texture
    /// coordinates. From `textures` on two rows for each texture, then two per level; from `sums` on sums of texels along rows.
    pub rows: Vec<[f32; 4]>,
    /// Where textures begin.
    pub textures: u32,
    /// Where sums begin.
    pub sums: u32,
}

/// Words as a row of numbers.
pub fn as_floats(words: [u32; 4]) -> [f32; 4] {
    words.map(f32::from_bits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_joined_as_far_as_they_fit() {
        let row = |words: usize| Row { words: vec![7; words], ..Row::default() };
        let rows = [row(10), row(20), row(30), row(100)];
        let fit = |from: usize, words: usize| Row::that_fit(rows[from..].iter(), 4 * words);
        assert_eq!([fit(0, 59), fit(0, 60), fit(0, 160), fit(0, 5), fit(3, 99)], [2, 3, 4, 1, 1]);
        let block = Block::new(Job::default(), rows[1..3].iter());
        // Four words per row, then their own.
        assert_eq!((block.words[1], block.words[5], block.words.len()), (8, 28, 58));
        assert!(block.words[8..].iter().all(|word| *word == 7));
    }
}
