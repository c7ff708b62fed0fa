//! What a device is given of a block, as `shaders/decoupled/layout.wgsl` reads it: 32 bits, indices in the place of references.
//!
//! Indices of a row of tiles count from where that row's own arrays begin, so that rows are packed in parallel and joined by
//! copies. What stays from block to block, or is part of several rows, is kept by the device and goes up once ([`Kept`]). It prepares the
//! pixels of tiles ([`Tile`]), and what these remember stays there ([`Memory`]).

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

/// Pixels along each side of a tile.
pub const TILE: usize = 8;
/// Pixels of a tile, row by row.
pub const PIXELS: usize = TILE * TILE;
/// Most lamps whose light is kept apart, as there are bits in a byte; further ones throw no shadows.
pub const MOST_OWN: usize = 8;

/// [`Job::flags`]: light jumps where the block begins.
pub const JUMPS: u32 = 1;
/// [`Job::flags`]: the camera's rays are parallel.
pub const PARALLEL: u32 = 2;
/// [`Job::flags`]: light is wanted and nothing else.
pub const LIGHT_ALONE: u32 = 4;
/// [`Job::flags`]: light is wanted throughout the block, of a sensor with more stages than thresholds or one that takes frames.
pub const SENSES: u32 = 8;
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
/// [`Entry::flags`]: it has maps; then [`Entry::light`] is the first of [`MAPPED_ROWS`] rows of [`Row::points`].
pub const HAS_MAPS: u32 = 32;
/// [`Entry::flags`]: what a surface with maps sends itself changes.
pub const GLOWS_APART: u32 = 64;
/// [`Entry::flags`]: no polynomial tells its light, which is found at several places of each part of a pixel.
pub const SHARP: u32 = 128;
/// [`Entry::flags`]: its light has [`Entry::bounds`].
pub const BOUNDED: u32 = 256;
/// [`Memory::flags`]: there is light before the last.
pub const HAS_BEFORE: u32 = 1;
/// [`Memory::flags`]: it was not followed through the block before.
pub const RESTED: u32 = 2;
/// [`Memory::flags`]: it was never followed, and its reference is what it sees at the start.
pub const BEGINS: u32 = 4;
/// [`Pixel::flags`]: one facet fills it throughout, and no shadow comes into it.
pub const PLAIN: u32 = 8;
/// [`Pixel::flags`]: it is seen through a distorted lens.
pub const BENT: u32 = 16;
/// [`Pixel::flags`]: it may see a facet with maps.
pub const MAPPED: u32 = 32;
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

/// What all pixels of a view share during a block.
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
    /// [`JUMPS`] and what follows it.
    pub flags: u32,
    /// Row of [`Block::kept`]'s array at which appearances of facets begin.
    pub looks: u32,
    /// Number of the view's block, from 1; where light is all that is wanted, the unit of the block at which it is found.
    pub number: u32,
    /// Row of [`Block::kept`]'s array at which the sky begins, see [`Sky`].
    pub sky: u32,
    /// Its levels; 0 where `background` lies behind everything.
    pub sky_levels: u32,
    /// Its texels that a pixel in the middle of the picture is wide.
    pub sky_texels: f32,
    /// Directions on the sky from image points (x, y, 1) about the picture's centre as quadratics of the block's time: three
    /// columns for each power.
    pub seen: [[f32; 4]; 9],
    /// Lamps.
    pub own: [Lamp; MOST_OWN],
}

/// Rows of four numbers that a [`Job`] takes.
pub const JOB_ROWS: usize = size_of::<Job>() / size_of::<[f32; 4]>();

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
    /// First of [`GEOMETRY_ROWS`] rows of [`Row::points`]; of what is unlit 0.
    pub light: u32,
    /// Part of the block in which it holds.
    pub span: [f32; 2],
    /// Bits of lamps of which some arrives.
    pub lit: u32,
    /// First of [`SHADE_WORDS`] words per lamp.
    pub shades: u32,
    /// Emitted luminance; of an unlit surface the factor of its base colour.
    pub glow: Wave,
    /// Pixels of its tile that may see it, low and high word.
    pub touches: [u32; 2],
    /// Those that it fills throughout.
    pub covers: [u32; 2],
    /// Those into which a shadow of what moves may come.
    pub moved: [u32; 2],
    /// How often a pixel that sees it is evaluated, see [`strides`].
    pub strides: u32,
    /// The same of one into which such a shadow may come.
    pub moved_strides: u32,
    /// First word of its light's bounds, least and most luminance: of what no shadow falls on, then of each lamp that is kept apart.
    pub bounds: u32,
    /// Zero.
    pub pad: [u32; 3],
}

/// How often a pixel is evaluated: units between evaluations, and above [`STRIDE_BITS`] those to which intervals are halved at most,
/// which are at least 1. 0 of what stays as it is.
pub const fn strides(stride: u32, least: u32) -> u32 {
    stride | least << STRIDE_BITS
}

/// Units between evaluations of such.
pub const fn stride_of(strides: u32) -> u32 {
    strides & ((1 << STRIDE_BITS) - 1)
}

/// See [`strides`].
pub const STRIDE_BITS: u32 = 16;

/// A tile whose pixels a device prepares from its entries, and keeps.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Tile {
    /// Its first pixel's middle, from the picture's centre.
    pub first: [f32; 2],
    /// Pixels to follow, low and high word.
    pub pixels: [u32; 2],
    /// Pixels in which nothing is seen of what lies behind everything.
    pub filled: [u32; 2],
    /// Pixels that were never followed.
    pub begins: [u32; 2],
    /// Pixels that the processor has followed since.
    pub given: [u32; 2],
    /// Pixels that are not followed, but given back.
    pub returned: [u32; 2],
    /// First word of what those remember that are given, [`MEMORY_WORDS`] each, from the lowest number on.
    pub memories: u32,
    /// First of its entries, and how many.
    pub entries: u32,
    /// See there.
    pub entry_count: u32,
    /// Word from which its row's bases are, as [`Pixel::bases`].
    pub bases: u32,
    /// Where in the block its pixels' lists of entries begin.
    pub own: u32,
    /// Index of the view, and the number of its first pixel there: tile by tile and row by row of tiles, [`PIXELS`] in each.
    pub view: u32,
    /// See there.
    pub place: u32,
    /// How often a pixel is evaluated that sees what lies behind everything, see [`strides`].
    pub background_strides: u32,
    /// Of a distorted lens: first of the rows of [`Row::points`] of its pixels, six each, as [`Pixel::frame`] has them; otherwise
    /// [`NO_FRAMES`].
    pub frames: u32,
    /// Zero.
    pub pad: u32,
}

/// [`Tile::frames`]: its pixels are squares.
pub const NO_FRAMES: u32 = u32::MAX;

/// What a pixel remembers between blocks.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Memory {
    /// Luminance at the end of the last block through which it was followed.
    pub last: f32,
    /// Microseconds from there, and luminance, of an evaluation before.
    pub before_us: f32,
    /// See there.
    pub before: f32,
    /// Logarithm of the reference.
    pub log: f32,
    /// Luminance of the next ON event.
    pub above: f32,
    /// Luminance of the next OFF event.
    pub below: f32,
    /// [`HAS_BEFORE`], [`RESTED`] and [`BEGINS`].
    pub flags: u32,
    /// [`Job::number`] of that block.
    pub number: u32,
}

/// Words of a [`Memory`].
pub const MEMORY_WORDS: usize = size_of::<Memory>() / size_of::<u32>();

/// A pixel that a device could not follow through a block.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Failed {
    /// Number of the pixel in the block.
    pub pixel: u32,
    /// What it remembers of those before.
    pub memory: Memory,
}

/// Words of a lamp's shadows on an entry: pixels that are dark, pixels into which a shadow may come (low and high word of each),
/// and its casters' first word and the one after their last.
pub const SHADE_WORDS: usize = 6;

/// Words of a caster: pixels that its shadow may darken (low and high word), and the first of its nine rows of [`Row::points`].
pub const CASTER_WORDS: usize = 3;

/// Rows of a facet's appearance: base colour, and its texture's number plus 1; change of base colour along s and along t, with the
/// texture's origin; change of texture coordinates; metallic, roughness, occlusion, and 0 of what has no highlights.
pub const LOOK_ROWS: usize = 5;

/// Rows of a facet that is lit: by power of the block's time its world positions at (s, t) = (0, 0), (1, 0) and (0, 1), and normals.
pub const GEOMETRY_ROWS: usize = 18;
/// Rows of a facet with maps: those of its geometry; tangents by power of time, with the sign of the bitangent last in those of the
/// first power; then [`MAPS`] times a map's texture plus 1 and its origin in texels, and their change with s and t; metallic,
/// roughness, scale of normals and strength of occlusion; emitted luminance per channel, and 0 of what has no highlights.
pub const MAPPED_ROWS: usize = GEOMETRY_ROWS + TANGENT_ROWS + 2 * MAPS + 2;
/// See there.
pub const TANGENT_ROWS: usize = 9;
/// Maps of a facet: base colour, normals, metallic and roughness, occlusion, emission.
pub const MAPS: usize = 5;
/// Rows of lights, which are the first of a row's points, before the first lamp: by power of the block's time where the eye is; last
/// in the first of them 1 where that is the direction of parallel rays, and in the second how many lamps there are, as a word.
pub const EYE_ROWS: usize = 3;
/// Rows of a lamp: place (last: 1 if it has one), direction (last: its range, or 0) and strength (last: its number among those
/// whose light is kept apart, plus 1, or 0), each by power of time; scale and shift of its cone, and 1 if it has one.
pub const LIGHT_ROWS: usize = 10;

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
    /// Word from which its row's bases are: entries, words and points, the number of its view's job, and light.
    pub bases: u32,
    /// Units between evaluations; 0 of one that only jumps.
    pub stride: u32,
    /// Units to which intervals are halved; where light is wanted throughout the block ([`SENSES`]), its first number of
    /// [`Block::light`]: what it sees at the start and, unless that stays, at the end of each part of an interval.
    pub least: u32,
    /// What it remembers: at the start of the block, then as far as it is followed. Where light is wanted throughout, that it saw last
    /// counts alone.
    pub memory: Memory,
    /// [`PLAIN`], [`BENT`], [`MAPPED`].
    pub flags: u32,
    /// Evaluations.
    pub evaluations: u32,
    /// 1: something did not fit, and what became of it counts for nothing.
    pub failed: u32,
    /// Of a distorted lens: first of six rows of [`Row::points`], those of the matrix from image points about the picture's centre to
    /// points of the pixel, and of its inverse.
    pub frame: u32,
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

/// Rows that a device keeps, known by where they are: of a view, [`LOOK_ROWS`] per facet; of the sky, see [`Sky`].
pub type Kept = Arc<[[f32; 4]]>;

/// What `kept` is known by, as long as it is there.
pub fn place_of(kept: &Kept) -> usize {
    Arc::as_ptr(kept).cast::<[f32; 4]>() as usize
}

/// What a row of tiles needs.
#[derive(Clone, Debug, Default)]
pub struct Row {
    /// Facets, tile by tile.
    pub entries: Vec<Entry>,
    /// Lists of numbers.
    pub words: Vec<u32>,
    /// Lights; image points about the picture's centre as quadratics of time, nine rows each, by power and axis, of four corners; and
    /// geometry of facets that are lit.
    pub points: Vec<[f32; 4]>,
    /// Pixels to follow.
    pub pixels: Vec<Pixel>,
    /// Numbers of light that are wanted of them.
    pub light: usize,
    /// Tiles whose pixels a device prepares and keeps.
    pub tiles: Vec<Tile>,
    /// Entries of all pixels of these, together.
    pub own: usize,
}

impl Row {
    /// Empties it; its arrays keep their memory.
    pub fn clear(&mut self) {
        let Self { entries, words, points, pixels, light, tiles, own } = self;
        entries.clear();
        words.clear();
        points.clear();
        pixels.clear();
        tiles.clear();
        (*light, *own) = (0, 0);
    }

    /// Bytes of each of its arrays.
    pub fn bytes(&self) -> [usize; 4] {
        let Self { entries, words, points, pixels, light, tiles, own, .. } = self;
        bytes_of((entries, words, points), (pixels, *light), (tiles, *own))
    }

    /// Whether there is nothing to follow.
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty() && self.tiles.is_empty()
    }
}

/// Half of the bytes that a device may take for what it knows of a pixel of a tile while it follows a block: arrays of a block have half
/// of what a binding holds.
pub const PREPARED_BYTES: usize = 100;

/// Light and lists count as pixels do: they lie beside what is known of them between evaluations.
fn bytes_of(
    (entries, words, points): (&[Entry], &[u32], &[[f32; 4]]),
    (pixels, light): (&[Pixel], usize),
    (tiles, own): (&[Tile], usize),
) -> [usize; 4] {
    let prepared = tiles.len() * PIXELS * PREPARED_BYTES + own * size_of::<u32>();
    let of_pixels = size_of_val(pixels) + light * size_of::<f32>() + prepared;
    [size_of_val(entries), size_of_val(words) + size_of_val(tiles), size_of_val(points), of_pixels]
}

/// A block of some views, or of some rows of their tiles.
#[derive(Clone, Debug, Default)]
pub struct Block {
    /// All rows' entries.
    pub entries: Vec<Entry>,
    /// All rows' words, each with [`BASE_WORDS`] in front: where its arrays begin, and the number of its job.
    pub words: Vec<u32>,
    /// All rows' points.
    pub points: Vec<[f32; 4]>,
    /// Rows that the device is to keep from now on.
    pub kept: Vec<[f32; 4]>,
    /// The row of the device's array at which these begin; what lies before stays.
    pub kept_from: u32,
    /// All rows' pixels.
    pub pixels: Vec<Pixel>,
    /// Numbers of light that are wanted of them, as [`Pixel::least`] says.
    pub light: usize,
    /// That light stays on the device, where the stages of sensors take it.
    pub light_stays: bool,
    /// Of each view.
    pub jobs: Vec<Job>,
    /// All rows' tiles. Their pixels have the numbers that follow those of `pixels`, [`PIXELS`] in each.
    pub tiles: Vec<Tile>,
    /// Entries of all pixels of these, together.
    pub own: usize,
}

/// What a device finds of a block, beside what becomes of its pixels.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// Events of its pixels, those of one in firing order.
    pub events: Vec<Event>,
    /// Light that is wanted, unless it stays.
    pub light: Vec<f32>,
    /// Number of the first of light that stays.
    pub light_at: u32,
    /// Pixels of tiles that it could not follow, or was to give back.
    pub failed: Vec<Failed>,
    /// Evaluations of all others.
    pub evaluations: u64,
    /// Pixels of tiles that bounds proved quiet.
    pub quiet: u64,
}

/// Light of a view during a block, for the stages of its sensor on a device.
#[derive(Clone, Debug, Default)]
pub struct Seen {
    /// Index of the view.
    pub view: usize,
    /// Start and end of the block, in microseconds of the stream.
    pub span_us: [f64; 2],
    /// Per pixel, row by row: number of its first light that stays, and of how many equal parts of the block it is known at the ends,
    /// with [`LIGHT_JUMPS`] and [`LIGHT_RESTS`]. The first is that at the start; of no parts, light stays as it is.
    pub pixels: Vec<[u32; 2]>,
}

/// [`Seen::pixels`]: light jumps to the first of it at the start.
pub const LIGHT_JUMPS: u32 = 1 << 16;
/// [`Seen::pixels`]: the pixel is left as it is.
pub const LIGHT_RESTS: u32 = 1 << 17;
/// [`Seen::pixels`]: the pixel sees its first light.
pub const LIGHT_BEGINS: u32 = 1 << 18;
/// [`Seen::pixels`]: how many parts.
pub const LIGHT_PARTS: u32 = LIGHT_JUMPS - 1;

impl Block {
    /// Empties it, before [`Block::add_row`]; what a device keeps from now on begins at row `kept_from`.
    pub fn begin(&mut self, kept_from: u32, light_stays: bool) {
        self.entries.clear();
        self.words.clear();
        self.points.clear();
        self.kept.clear();
        self.pixels.clear();
        self.jobs.clear();
        self.tiles.clear();
        (self.kept_from, self.light, self.light_stays, self.own) = (kept_from, 0, light_stays, 0);
    }

    /// Pixels that a device follows, or may.
    pub fn pixel_count(&self) -> usize {
        self.pixels.len() + self.tiles.len() * PIXELS
    }

    /// Adds a row of the last of its views, `view`.
    pub fn add_row(&mut self, row: &Row, view: usize) {
        let bases = self.words.len();
        let first = bases + BASE_WORDS;
        let job = self.jobs.len().saturating_sub(1);
        let own: [usize; BASE_WORDS] = [self.entries.len(), first, self.points.len(), job, self.light];
        self.words.extend(own.map(|at| at as u32));
        self.entries.extend_from_slice(&row.entries);
        self.words.extend_from_slice(&row.words);
        self.points.extend_from_slice(&row.points);
        let of = |pixel: &Pixel| Pixel { bases: bases as u32, ..*pixel };
        self.pixels.extend(row.pixels.iter().map(of));
        self.light += row.light;
        let own = self.own as u32;
        let of = |tile: &Tile| Tile { bases: bases as u32, own: own + tile.own, view: view as u32, ..*tile };
        self.tiles.extend(row.tiles.iter().map(of));
        self.own += row.own;
    }

    /// Bytes that go up: of entries, words and tiles, points, pixels, and what is kept from now on.
    pub fn sent_bytes(&self) -> [usize; 5] {
        let Self { entries, words, points, pixels, tiles, kept, .. } = self;
        let words = size_of_val(&words[..]) + size_of_val(&tiles[..]);
        [
            size_of_val(&entries[..]),
            words,
            size_of_val(&points[..]),
            size_of_val(&pixels[..]),
            size_of_val(&kept[..]),
        ]
    }

    /// Bytes of each of its arrays, as [`Row::bytes`] has them.
    pub fn bytes(&self) -> [usize; 4] {
        let Self { entries, words, points, pixels, light, tiles, own, .. } = self;
        bytes_of((entries, words, points), (pixels, *light), (tiles, *own))
    }
}

/// Words in front of a row's own.
pub const BASE_WORDS: usize = 5;

/// Luminance of the sky.
#[derive(Clone, Debug)]
pub struct Sky {
    /// Per level a row: its first number and the edge of a face, both as words. Then numbers, four in a row: level by level,
    /// face by face, row by row, with a texel more beyond each edge; beyond corners the mean of its three neighbours.
    pub rows: Kept,
    /// Levels.
    pub levels: u32,
}

/// Textures.
#[derive(Clone, Debug, Default)]
pub struct Textures {
    /// Two rows for each texture, then two per level; from `sums` on sums of texels along rows; then what maps need.
    pub rows: Vec<[f32; 4]>,
    /// Where sums begin.
    pub sums: u32,
    /// Where texels of maps begin, 16 bits per channel, two in a row; a level's first row has the number of its first one, a texture's
    /// second row the value of the greatest number.
    pub texels: u32,
    /// Where light from all around begins, whose rows count from there: irradiance's first row and edge, levels of the reflection
    /// and the split sum's first row; sine and cosine of the turn about +Y; ambient light; each level's first row and edge.
    pub around: u32,
}

/// Words as a row of numbers.
pub fn as_floats(words: [u32; 4]) -> [f32; 4] {
    words.map(f32::from_bits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_joined_and_pixels_know_where_their_own_begin() {
        let row = |words: &[u32], points: usize, columns: &[u32]| Row {
            words: words.to_vec(),
            points: vec![[0.0; 4]; points],
            pixels: vec![Pixel::default(); 2],
            light: 3,
            tiles: columns.iter().map(|k| Tile { own: 10 * k, ..Tile::default() }).collect(),
            own: if columns.is_empty() { 0 } else { 50 },
            ..Row::default()
        };
        let mut block = Block { jobs: vec![Job::default()], ..Block::default() };
        block.add_row(&row(&[7, 1, 0, 9], 3, &[]), 0);
        block.add_row(&row(&[], 0, &[0, 2]), 0);
        block.jobs.push(Job::default());
        block.add_row(&row(&[8, 0, 0], 1, &[1]), 1);
        assert_eq!(block.words, [0, 5, 0, 0, 0, 7, 1, 0, 9, 0, 14, 3, 0, 3, 0, 19, 3, 1, 6, 8, 0, 0]);
        assert_eq!(block.pixels.iter().map(|pixel| pixel.bases).collect::<Vec<_>>(), [0, 0, 9, 9, 14, 14]);
        assert_eq!((block.light, block.pixel_count()), (9, 6 + 192));
        let tiles: Vec<_> = block.tiles.iter().map(|tile| [tile.view, tile.own, tile.bases]).collect();
        assert_eq!(tiles, [[0, 0, 9], [0, 20, 9], [1, 50 + 10, 14]]);
        assert_eq!(block.own, 100);
        let (tile, pixel) = (size_of::<Tile>(), size_of::<Pixel>());
        assert_eq!(block.sent_bytes(), [0, 4 * block.words.len() + 3 * tile, 16 * 4, 6 * pixel, 0]);
    }
}
