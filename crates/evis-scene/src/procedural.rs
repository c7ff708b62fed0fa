//! Pictures made by code: surfaces with real detail down to the single texel, the same for the same seed anywhere.
//!
//! Colours are linear. Every pattern tiles, but for the pictures that are meant to be seen once (label, poster).

use half::f16;
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;

use crate::error::SceneError;
use crate::model::Image;

/// What a procedural picture shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Pattern {
    /// Octaves of noise between two colours.
    Noise,
    /// Eight by eight fields.
    Checker,
    /// Eight pairs of upright stripes.
    Stripes,
    /// A wall of bricks in mortar.
    Bricks,
    /// Planks with grain along u.
    Wood,
    /// Dark tar with bright grit.
    Asphalt,
    /// Poured slabs with joints and stains.
    Concrete,
    /// A carton's side: corrugation, tape, a printed label.
    Cardboard,
    /// Lines of print on paper.
    Label,
    /// Brushed sheet, scratches along u.
    Metal,
    /// Woven threads.
    Fabric,
    /// Rows of windows in a wall.
    Facade,
    /// A road along v: asphalt, edge lines, dashes in the middle.
    Road,
    /// Book spines side by side, with titles.
    Books,
    /// Large shapes and letters in strong colours.
    Poster,
}

/// Every pattern with the name that scene files use.
pub const PATTERNS: [(&str, Pattern); 15] = [
    ("noise", Pattern::Noise),
    ("checker", Pattern::Checker),
    ("stripes", Pattern::Stripes),
    ("bricks", Pattern::Bricks),
    ("wood", Pattern::Wood),
    ("asphalt", Pattern::Asphalt),
    ("concrete", Pattern::Concrete),
    ("cardboard", Pattern::Cardboard),
    ("label", Pattern::Label),
    ("metal", Pattern::Metal),
    ("fabric", Pattern::Fabric),
    ("facade", Pattern::Facade),
    ("road", Pattern::Road),
    ("books", Pattern::Books),
    ("poster", Pattern::Poster),
];

/// A picture to be made: square, `size` texels wide.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Procedural {
    /// What it shows.
    pub pattern: Pattern,
    /// Texels per edge, 16 to 4096.
    pub size: u32,
    /// Equal seeds give equal pictures.
    pub seed: u64,
    /// Linear RGB of the surface and of what is on it (mortar, print, second stripe); `None` takes the pattern's own.
    pub colors: [Option<[f32; 3]>; 2],
}

impl Procedural {
    /// `pattern` in its own colours.
    pub const fn new(pattern: Pattern, size: u32, seed: u64) -> Self {
        Self { pattern, size, seed, colors: [None; 2] }
    }

    /// The same in these colours.
    pub const fn with_colors(self, surface: [f32; 3], detail: [f32; 3]) -> Self {
        Self { colors: [Some(surface), Some(detail)], ..self }
    }

    /// Makes the picture.
    ///
    /// # Errors
    /// A size outside 16 to 4096, a colour that is negative or not finite.
    pub fn image(&self, name: impl Into<String>) -> Result<Image, SceneError> {
        if !(16..=4096).contains(&self.size) {
            return Err(SceneError::Rule(format!(
                "size of a procedural texture is {}; it takes 16 to 4096 texels",
                self.size
            )));
        }
        for color in self.colors.iter().flatten() {
            if !color.iter().all(|c| (0.0..=1e4).contains(c)) {
                return Err(SceneError::Rule(format!(
                    "colour of a procedural texture is {color:?}; it takes linear RGB between 0 and 1e4"
                )));
            }
        }
        let mut canvas = Canvas::new(self.size, self.seed);
        self.paint(&mut canvas);
        Ok(canvas.into_image(name.into()))
    }

    /// The two colours, or those given here as sRGB.
    fn colors_or(&self, surface: u32, detail: u32) -> [[f32; 3]; 2] {
        [self.colors[0].unwrap_or(srgb(surface)), self.colors[1].unwrap_or(srgb(detail))]
    }

    fn paint(&self, canvas: &mut Canvas) {
        match self.pattern {
            Pattern::Noise => noise(canvas, self.colors_or(0x30506e, 0xe8c890)),
            Pattern::Checker => checker(canvas, self.colors_or(0xd8d4c8, 0x404850)),
            Pattern::Stripes => stripes(canvas, self.colors_or(0xd8d4c8, 0x2a5d8f)),
            Pattern::Bricks => bricks(canvas, self.colors_or(0xa8553c, 0xbdb3a2)),
            Pattern::Wood => wood(canvas, self.colors_or(0xb07f4c, 0x5c3a1c)),
            Pattern::Asphalt => asphalt(canvas, self.colors_or(0x55565a, 0xb0aca4)),
            Pattern::Concrete => concrete(canvas, self.colors_or(0x9a9a94, 0x4c4c4a)),
            Pattern::Cardboard => cardboard(canvas, self.colors_or(0xb98d5c, 0x3d2c1c)),
            Pattern::Label => label(canvas, self.colors_or(0xe8e6de, 0x3c3c46)),
            Pattern::Metal => metal(canvas, self.colors_or(0x9aa0a8, 0x50555c)),
            Pattern::Fabric => fabric(canvas, self.colors_or(0x3f6f8c, 0x1e3a4a)),
            Pattern::Facade => facade(canvas, self.colors_or(0xc9a27c, 0x3a5068)),
            Pattern::Road => road(canvas, self.colors_or(0x5c5d60, 0xe6e2d4)),
            Pattern::Books => books(canvas, self.colors_or(0x3a2a20, 0xe8d8a8)),
            Pattern::Poster => poster(canvas, self.colors_or(0xf0e0c0, 0x1b2a49)),
        }
    }
}

/// Linear RGB of an sRGB colour written as 0xRRGGBB (IEC 61966-2-1).
pub fn srgb(hex: u32) -> [f32; 3] {
    [16, 8, 0].map(|shift| {
        let c = ((hex >> shift) & 0xff) as f32 / 255.0;
        if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
    })
}

/// A random number per (seed, stream, x, y): a function, not a state.
pub(crate) fn hash(seed: u64, stream: u32, x: u32, y: u32) -> u64 {
    // The finaliser of splitmix64, over a key that no two inputs share but by chance.
    let key = (u64::from(x) << 32 | u64::from(y)) ^ seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mut z = key.wrapping_add(u64::from(stream).wrapping_mul(0xd1b5_4a32_d192_ed03));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// The same as a number in [0, 1).
pub(crate) fn uniform(seed: u64, stream: u32, x: u32, y: u32) -> f32 {
    (hash(seed, stream, x, y) >> 40) as f32 / (1u64 << 24) as f32
}

/// Pixels while a picture is being painted.
struct Canvas {
    size: u32,
    seed: u64,
    pixels: Vec<[f32; 3]>,
}

impl Canvas {
    fn new(size: u32, seed: u64) -> Self {
        Self { size, seed, pixels: vec![[0.0; 3]; size as usize * size as usize] }
    }

    fn random(&self, stream: u32, i: u32) -> f32 {
        uniform(self.seed, stream, i, 0)
    }

    /// Sets every pixel from its column, row and index.
    fn shade(&mut self, color: impl Fn(u32, u32, usize) -> [f32; 3] + Sync) {
        let size = self.size as usize;
        self.pixels.par_chunks_exact_mut(size).enumerate().for_each(|(y, row)| {
            for (x, pixel) in row.iter_mut().enumerate() {
                *pixel = color(x as u32, y as u32, y * size + x);
            }
        });
    }

    fn fill(&mut self, color: [f32; 3]) {
        self.pixels.fill(color);
    }

    /// A rectangle in parts of the edge, cut at the border.
    fn rect(&mut self, x: f32, y: f32, width: f32, height: f32, color: [f32; 3]) {
        let texel = |v: f32| (v * self.size as f32).round().clamp(0.0, self.size as f32) as usize;
        let (x0, x1, y0, y1) = (texel(x), texel(x + width), texel(y), texel(y + height));
        for row in self.pixels.chunks_exact_mut(self.size as usize).take(y1).skip(y0) {
            row[x0.min(x1)..x1].fill(color);
        }
    }

    fn disc(&mut self, x: f32, y: f32, radius: f32, color: [f32; 3]) {
        let size = self.size as f32;
        for (i, pixel) in self.pixels.iter_mut().enumerate() {
            let px = ((i as u32 % self.size) as f32 + 0.5) / size - x;
            let py = ((i as u32 / self.size) as f32 + 0.5) / size - y;
            if px * px + py * py < radius * radius {
                *pixel = color;
            }
        }
    }

    /// Text in a 3x5 face; `height` of a capital in parts of the edge. What does not fit is cut.
    fn text(&mut self, text: &str, x: f32, y: f32, height: f32, color: [f32; 3]) {
        let dot = height / 5.0;
        for (i, c) in text.bytes().enumerate() {
            let left = x + i as f32 * 4.0 * dot;
            for (row, bits) in glyph(c).into_iter().enumerate() {
                for column in 0..3 {
                    if bits >> (2 - column) & 1 == 1 {
                        // Edges are rounded to texels one by one, so that dots of a fraction of a texel leave no gaps.
                        self.rect(left + column as f32 * dot, y + row as f32 * dot, dot, dot, color);
                    }
                }
            }
        }
    }

    /// A paragraph of random words.
    fn print(&mut self, [x, y, width, height]: [f32; 4], line: f32, stream: u32, color: [f32; 3]) {
        let lines = (height / (line * 1.5)) as u32;
        let letters = (width / (line * 0.8)) as usize;
        for row in 0..lines {
            let used = if row + 1 == lines { letters * 2 / 3 } else { letters };
            let words: String = (0..used as u32)
                .map(|i| match hash(self.seed, stream, i, row) % 36 {
                    0..=5 => ' ',
                    n => char::from(b"ETAOINSRHLDCUMFPGWYB0123456789"[n as usize - 6]),
                })
                .collect();
            self.text(&words, x, y + row as f32 * line * 1.5, line, color);
        }
    }

    /// Multiplies every pixel by `exp(strength * grain)`.
    fn roughen(&mut self, cells: [u32; 2], gain: f32, strength: f32, stream: u32) {
        let grain = grain(self.size, cells, gain, hash(self.seed, stream, 0, 0));
        self.pixels
            .par_iter_mut()
            .zip(&grain)
            .for_each(|(pixel, n)| *pixel = scale(*pixel, (strength * n).exp()));
    }

    fn into_image(self, name: String) -> Image {
        let mut texels = vec![[f16::ZERO; 4]; self.pixels.len()];
        let size = self.size as usize;
        texels.par_chunks_exact_mut(size).zip(self.pixels.par_chunks_exact(size)).for_each(
            |(row, pixels)| {
                // Above the largest half float it would be infinite.
                let clamped = |c: f32| c.min(f16::MAX.to_f32_const());
                let floats: Vec<f32> =
                    pixels.iter().flat_map(|&[r, g, b]| [clamped(r), clamped(g), clamped(b), 1.0]).collect();
                row.as_flattened_mut().convert_from_f32_slice(&floats);
            },
        );
        Image { name, width: self.size, height: self.size, texels }
    }
}

/// Octaves of tiling value noise from `cells` per edge down to one per texel, each `gain` times the last;
/// mean about 0, deviation 1.
fn grain(size: u32, cells: [u32; 2], gain: f32, seed: u64) -> Vec<f32> {
    let mut octaves = Vec::new();
    let (mut cells, mut amplitude) = (cells.map(|c| c.clamp(1, size)), 1.0f32);
    loop {
        octaves.push((cells, amplitude));
        if cells == [size; 2] {
            break;
        }
        cells = cells.map(|c| (c * 2).min(size));
        amplitude *= gain;
    }
    // A value uniform in [-1, 1) has variance 1/3; blending between lattice points takes about half of it away.
    let variance: f32 = octaves.iter().map(|(_, a)| a * a / 5.0).sum();
    let norm = variance.sqrt().recip();
    // Which lattice points a column lies between is the same in every row, and costs divisions.
    let columns: Vec<Vec<_>> =
        octaves.iter().map(|([cx, _], _)| (0..size).map(|x| split(x, *cx, size)).collect()).collect();
    let mut out = vec![0.0; size as usize * size as usize];
    out.par_chunks_exact_mut(size as usize).enumerate().for_each(|(y, row)| {
        let mut lattice = Vec::new();
        for (octave, (&([cx, cy], amplitude), columns)) in octaves.iter().zip(&columns).enumerate() {
            let value = |x: u32, y: u32| 2.0 * uniform(seed, octave as u32, x, y % cy) - 1.0;
            let (y0, ty) = split(y as u32, cy, size);
            lattice.clear();
            lattice.extend((0..cx).map(|x| {
                let upper = value(x, y0);
                norm * amplitude * if ty == 0.0 { upper } else { upper + (value(x, y0 + 1) - upper) * ty }
            }));
            if cx == size {
                row.iter_mut().zip(&lattice).for_each(|(out, value)| *out += value);
                continue;
            }
            lattice.push(lattice[0]);
            for (out, &(x0, tx)) in row.iter_mut().zip(columns) {
                let (left, right) = (lattice[x0 as usize], lattice[x0 as usize + 1]);
                *out += left + (right - left) * tx;
            }
        }
    });
    out
}

/// Lattice cell of texel `i`, and the smoothed position within it.
fn split(i: u32, cells: u32, size: u32) -> (u32, f32) {
    let position = u64::from(i) * u64::from(cells);
    let cell = (position / u64::from(size)) as u32;
    let t = (position % u64::from(size)) as f32 / size as f32;
    (cell.min(cells - 1), t * t * (3.0 - 2.0 * t))
}

fn scale(color: [f32; 3], factor: f32) -> [f32; 3] {
    color.map(|c| c * factor)
}

fn mix(a: [f32; 3], b: [f32; 3], t: f32) -> [f32; 3] {
    let t = t.clamp(0.0, 1.0);
    [0, 1, 2].map(|i| a[i] + (b[i] - a[i]) * t)
}

/// Rows of a capital letter or digit, three bits each; anything else is blank.
fn glyph(c: u8) -> [u8; 5] {
    const LETTERS: &[u8; 130] = b"2575565656344436555674647746443455355755722271115255655444475775565555255526564425563656553421672222555575555255775552555522271247";
    const DIGITS: &[u8; 50] = b"75557262276124761216557117461634652711222525225316";
    let (table, index): (&[u8], usize) = match c {
        b'A'..=b'Z' => (LETTERS, usize::from(c - b'A')),
        b'0'..=b'9' => (DIGITS, usize::from(c - b'0')),
        _ => return [0; 5],
    };
    [0, 1, 2, 3, 4].map(|row| table.get(index * 5 + row).map_or(0, |d| d - b'0'))
}

fn noise(canvas: &mut Canvas, [a, b]: [[f32; 3]; 2]) {
    let coarse = grain(canvas.size, [5, 5], 0.55, hash(canvas.seed, 1, 0, 0));
    canvas.shade(|_, _, i| mix(a, b, 0.5 + 0.35 * coarse[i]));
    canvas.roughen([24, 24], 0.85, 0.4, 2);
}

fn checker(canvas: &mut Canvas, [a, b]: [[f32; 3]; 2]) {
    let size = canvas.size;
    canvas.shade(|x, y, _| if (x * 8 / size + y * 8 / size).is_multiple_of(2) { a } else { b });
    canvas.roughen([16, 16], 0.75, 0.2, 1);
}

fn stripes(canvas: &mut Canvas, [a, b]: [[f32; 3]; 2]) {
    let size = canvas.size;
    canvas.shade(|x, _, _| if (x * 16 / size).is_multiple_of(2) { a } else { b });
    canvas.roughen([16, 16], 0.75, 0.2, 1);
}

fn bricks(canvas: &mut Canvas, [brick, mortar]: [[f32; 3]; 2]) {
    let (size, seed) = (canvas.size, canvas.seed);
    let (rows, columns) = (16, 6);
    canvas.shade(|x, y, _| {
        let row = y * rows / size;
        let shifted = (x * 2 * columns / size + row % 2) % (2 * columns);
        let in_row = (y * rows) as f32 / size as f32 - row as f32;
        let along = ((x * columns) as f32 / size as f32 + 0.5 * (row % 2) as f32).fract();
        if in_row < 0.14 || along < 0.05 {
            return mortar;
        }
        let tone = uniform(seed, 3, shifted / 2, row);
        mix(scale(brick, 0.6 + 0.8 * tone), mortar, 0.25 * uniform(seed, 4, shifted / 2, row))
    });
    canvas.roughen([8, 8], 0.8, 0.28, 1);
}

fn wood(canvas: &mut Canvas, [light, dark]: [[f32; 3]; 2]) {
    let (size, seed) = (canvas.size, canvas.seed);
    let bend = grain(size, [2, 12], 0.5, hash(seed, 1, 0, 0));
    let fibre = grain(size, [8, size / 2], 0.7, hash(seed, 2, 0, 0));
    let planks = 6;
    canvas.shade(|x, y, i| {
        let plank = y * planks / size;
        let cut = uniform(seed, 5, plank, 0);
        let in_plank = (y * planks) as f32 / size as f32 - plank as f32;
        let along = (x as f32 / size as f32 + cut).fract();
        if in_plank < 0.025 || along < 0.004 {
            return scale(dark, 0.35);
        }
        let rings = (in_plank * 16.0 + 2.2 * bend[i] + 7.0 * cut).sin();
        let tone = 0.75 + 0.5 * uniform(seed, 6, plank, 0);
        scale(mix(light, dark, 0.35 + 0.25 * rings + 0.15 * fibre[i]), tone)
    });
    canvas.roughen([64, size], 0.9, 0.15, 3);
}

fn asphalt(canvas: &mut Canvas, [tar, grit]: [[f32; 3]; 2]) {
    let seed = canvas.seed;
    let fine = grain(canvas.size, [canvas.size / 4, canvas.size / 4], 1.0, hash(seed, 1, 0, 0));
    canvas.shade(|_, _, i| mix(scale(tar, 0.9), grit, 0.45 * (fine[i] - 0.8)));
    canvas.roughen([4, 4], 0.8, 0.3, 2);
}

fn concrete(canvas: &mut Canvas, [slab, joint]: [[f32; 3]; 2]) {
    let size = canvas.size;
    let seed = canvas.seed;
    canvas.shade(|x, y, _| {
        let [sx, sy] = [x, y].map(|v| (v * 2) as f32 / size as f32);
        if sx.fract() < 0.012 || sy.fract() < 0.012 {
            return joint;
        }
        scale(slab, 0.88 + 0.24 * uniform(seed, 3, sx as u32, sy as u32))
    });
    canvas.roughen([4, 4], 0.75, 0.22, 1);
    canvas.roughen([64, 64], 0.9, 0.16, 2);
}

fn cardboard(canvas: &mut Canvas, [card, ink]: [[f32; 3]; 2]) {
    let size = canvas.size;
    let seed = canvas.seed;
    canvas.shade(|x, _, _| {
        let flute = (x as f32 / size as f32 * 64.0 * std::f32::consts::TAU).sin();
        scale(card, 1.0 + 0.06 * flute)
    });
    // Tape along the middle, darker edges of the flaps.
    canvas.rect(0.0, 0.455, 1.0, 0.09, mix(card, [0.55, 0.42, 0.25], 0.7));
    canvas.rect(0.0, 0.497, 1.0, 0.006, scale(card, 0.4));
    for (x, y, w, h) in
        [(0.0, 0.0, 1.0, 0.012), (0.0, 0.988, 1.0, 0.012), (0.0, 0.0, 0.012, 1.0), (0.988, 0.0, 0.012, 1.0)]
    {
        canvas.rect(x, y, w, h, scale(card, 0.55));
    }
    // A shipping label with bars and an address; print and arrows on the carton itself.
    let [dx, dy] = [0.05 * canvas.random(5, 0), 0.05 * canvas.random(5, 1)];
    let paper = srgb(0xe4e0d4);
    canvas.rect(0.50 + dx, 0.60 + dy, 0.40, 0.30, paper);
    let mut x = 0.52 + dx;
    for bar in 0.. {
        let width = (1.0 + 3.0 * uniform(seed, 6, bar, 0)) / 180.0;
        if x + width > 0.88 + dx {
            break;
        }
        if bar % 2 == 0 {
            canvas.rect(x, 0.62 + dy, width, 0.10, srgb(0x18181a));
        }
        x += width;
    }
    canvas.print([0.53 + dx, 0.74 + dy, 0.34, 0.13], 0.020, 7, srgb(0x202024));
    canvas.rect(0.50 + dx, 0.595 + dy, 0.40, 0.012, srgb(0xc03028));
    canvas.text(
        ["EVIS", "FRAGILE", "THIS UP", "PARTS"][(hash(seed, 8, 0, 0) % 4) as usize],
        0.06,
        0.08,
        0.10,
        ink,
    );
    canvas.print([0.07, 0.24, 0.42, 0.16], 0.026, 9, ink);
    for i in 0..2 {
        let x = 0.12 + 0.12 * i as f32;
        canvas.rect(x, 0.68, 0.03, 0.18, ink);
        for step in 0..6 {
            let half = 0.008 * (step + 1) as f32;
            canvas.rect(x + 0.015 - half, 0.62 + 0.01 * step as f32, 2.0 * half, 0.011, ink);
        }
        canvas.rect(x - 0.03, 0.88, 0.09, 0.015, ink);
    }
    canvas.roughen([6, 6], 0.8, 0.16, 1);
}

fn label(canvas: &mut Canvas, [paper, ink]: [[f32; 3]; 2]) {
    canvas.fill(paper);
    canvas.print([0.06, 0.05, 0.88, 0.10], 0.08, 4, ink);
    canvas.print([0.06, 0.20, 0.88, 0.40], 0.024, 5, ink);
    canvas.print([0.06, 0.64, 0.88, 0.32], 0.036, 6, ink);
    canvas.roughen([8, 8], 0.8, 0.08, 1);
}

fn metal(canvas: &mut Canvas, [sheet, scratch]: [[f32; 3]; 2]) {
    let size = canvas.size;
    let lines = grain(size, [4, size], 0.8, hash(canvas.seed, 1, 0, 0));
    canvas.shade(|_, _, i| mix(sheet, scratch, 0.35 + 0.25 * lines[i]));
    canvas.roughen([4, 4], 0.7, 0.15, 2);
}

fn fabric(canvas: &mut Canvas, [warp, weft]: [[f32; 3]; 2]) {
    let size = canvas.size;
    let threads = (size / 8).max(4);
    canvas.shade(|x, y, _| {
        let [fx, fy] = [x, y].map(|v| (v * threads) as f32 / size as f32);
        let over = (fx as u32 + fy as u32).is_multiple_of(2);
        let across = if over { fx.fract() } else { fy.fract() };
        let round = 0.45 + 0.75 * (across * std::f32::consts::PI).sin();
        scale(if over { warp } else { weft }, round)
    });
    canvas.roughen([6, 6], 0.8, 0.25, 1);
}

fn facade(canvas: &mut Canvas, [wall, glass]: [[f32; 3]; 2]) {
    let (size, seed) = (canvas.size, canvas.seed);
    let cells = 4;
    let [white, lit, dim, curtain, blind] = [0xe6e0d2, 0xf2c878, 0xa86c30, 0xb8a898, 0xc8c4ba].map(srgb);
    canvas.shade(|x, y, _| {
        let [fx, fy] = [x, y].map(|v| (v * cells) as f32 / size as f32);
        let (cx, cy) = (fx as u32, fy as u32);
        let (u, v) = (fx.fract(), fy.fract());
        let sill = (0.16..0.84).contains(&u) && (0.80..0.86).contains(&v);
        let frame = (0.20..0.80).contains(&u) && (0.16..0.80).contains(&v);
        let pane = frame && (0.24..0.76).contains(&u) && (0.20..0.76).contains(&v);
        let bar = pane && ((u - 0.5).abs() < 0.02 || (v - 0.42).abs() < 0.02);
        if bar || (frame && !pane) || sill {
            return white;
        }
        if pane {
            // Some windows are lit, some have a curtain or a blind half way down.
            let kind = hash(seed, 3, cx, cy) % 5;
            let height = (v - 0.20) / 0.56;
            return match kind {
                0 => mix(lit, dim, height),
                1 if !(0.32..0.68).contains(&u) => curtain,
                2 if height < 0.55 => scale(blind, if (height * 24.0).fract() < 0.3 { 0.5 } else { 1.0 }),
                _ => mix(scale(glass, 1.8), scale(glass, 0.6), height + 0.4 * (u - 0.5)),
            };
        }
        // Courses of the wall, and a ledge below every storey.
        let course =
            (v * 12.0).fract() < 0.1 || (u * 5.0 + 0.5 * ((v * 12.0) as u32 % 2) as f32).fract() < 0.04;
        if v > 0.96 {
            return scale(wall, 1.25);
        }
        if v > 0.945 {
            return scale(wall, 0.35);
        }
        scale(
            wall,
            if course { 0.62 } else { 0.9 + 0.2 * uniform(seed, 4, (fx * 5.0) as u32, (fy * 12.0) as u32) },
        )
    });
    canvas.roughen([8, 8], 0.8, 0.17, 1);
}

fn road(canvas: &mut Canvas, [tar, paint]: [[f32; 3]; 2]) {
    asphalt(canvas, [tar, srgb(0xb0aca4)]);
    for y in 0..2 {
        canvas.rect(0.49, 0.5 * y as f32 + 0.08, 0.02, 0.26, paint);
    }
    canvas.rect(0.04, 0.0, 0.018, 1.0, paint);
    canvas.rect(0.942, 0.0, 0.018, 1.0, paint);
    canvas.roughen([8, 8], 0.85, 0.15, 5);
}

fn books(canvas: &mut Canvas, [back, gilt]: [[f32; 3]; 2]) {
    const COVERS: [u32; 8] = [0x8c2f2b, 0x2f5d8c, 0x3d7a4a, 0xc58b2a, 0x5a3d78, 0xd8cfb8, 0x2c6e74, 0xb5532f];
    canvas.fill(scale(back, 0.5));
    let mut x = 0.0;
    for book in 0.. {
        let width = 0.05 + 0.05 * canvas.random(3, book);
        let top = 0.16 * canvas.random(4, book);
        let cover = srgb(COVERS[(hash(canvas.seed, 5, book, 0) % 8) as usize]);
        if x + width > 1.0 {
            break;
        }
        canvas.rect(x, top, width - 0.004, 1.0 - top, cover);
        for band in [0.08, 0.12, 0.86, 0.90] {
            canvas.rect(x, top + band * (1.0 - top), width - 0.004, 0.01, gilt);
        }
        let ink = if cover[0] > 0.5 { srgb(0x282420) } else { gilt };
        // The title runs down the spine one letter below the other.
        for row in 0..10 {
            let letter = b'A' + (hash(canvas.seed, 6, book, row) % 26) as u8;
            let size = width * 0.55;
            let y = top + 0.18 + row as f32 * size * 1.25;
            if y + size < 0.84 {
                canvas.text(&char::from(letter).to_string(), x + width * 0.3, y, size, ink);
            }
        }
        x += width;
    }
    canvas.roughen([16, 8], 0.8, 0.15, 1);
}

fn poster(canvas: &mut Canvas, [paper, ink]: [[f32; 3]; 2]) {
    const COLORS: [u32; 6] = [0xd9482b, 0x4aa3c0, 0xf0b429, 0x5fae6a, 0xa487c4, 0xe07a9a];
    canvas.fill(paper);
    for i in 0..14 {
        let color = srgb(COLORS[(hash(canvas.seed, 3, i, 0) % 6) as usize]);
        let [x, y, s] = [0, 1, 2].map(|k| uniform(canvas.seed, 4, i, k));
        if i % 2 == 0 {
            canvas.disc(x, y, 0.05 + 0.15 * s, color);
        } else {
            canvas.rect(x - 0.1, y - 0.1, 0.08 + 0.2 * s, 0.08 + 0.2 * (1.0 - s), color);
        }
    }
    canvas.text("EVIS", 0.12, 0.36, 0.24, ink);
    canvas.print([0.08, 0.68, 0.84, 0.26], 0.034, 5, ink);
    canvas.rect(0.0, 0.0, 1.0, 0.02, ink);
    canvas.rect(0.0, 0.98, 1.0, 0.02, ink);
    canvas.rect(0.0, 0.0, 0.02, 1.0, ink);
    canvas.rect(0.98, 0.0, 0.02, 1.0, ink);
    canvas.roughen([16, 16], 0.8, 0.18, 1);
}
