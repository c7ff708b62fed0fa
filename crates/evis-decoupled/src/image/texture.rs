//! The mean of a texture over a pixel's footprint.
//!
//! A texture's signal is the bilinear interpolant of its base level in linear light. Its integral over a parallelogram is
//! that of its integral along a line, from the line's beginning to either side of the parallelogram, over the height: along
//! the four edges sums of texels are read, interpolated by a quadratic B-spline along the line and linearly from line to
//! line, where an edge leans at two points of Gauss between two lines, else at one. Lines are rows or columns of texels,
//! whichever are fewer. Where many lie across, a smaller level of the mip chain is read: that adds its own blur, of variance
//! (m^2 - 1) / 4 for texels of m base texels (box (m^2 - 1) / 12, and tent m^2 / 6 in place of 1 / 6), so the parallelogram
//! is drawn together until the variance of both is that of the footprint. Pixels of a grid share their edges: two are
//! followed for each, and a level's blur is left. Of a texture without interpolation the signal is a step at each texel's
//! border: sums are linear along a line, and a line counts for its own height.

use std::sync::OnceLock;

use evis_scene::texture::mip_chain;
use evis_scene::{Scene, Texture, Wrap};
use glam::{DMat2, DVec2, DVec3, DVec4, Vec2, Vec3, Vec4};

use crate::fours::{Four, parts};
use crate::packed;

/// An edge is read at one place between two lines where its lean times the cube of its height there, over the footprint's
/// area, is at most this.
pub const ONE_PLACE: f32 = 0.01;
/// Texels between pairs of places, where an edge leans by more; and most pairs between two lines.
pub const SPACING: f32 = 2.0;
/// See there.
pub const MOST_PARTS: f32 = 8.0;
/// Distance of the two points of Gauss from the middle of an interval, over its length.
const GAUSS: f32 = 0.288_675_13;
/// Edges that lead down by less are level.
const FLAT: f32 = 1e-6;
/// A footprint is no longer than this many texels; a smaller level is read in its place.
pub const MOST_LINES: f64 = 128.0;
/// A grid that spans more texels than this is not read.
const MOST_EXTENT: f64 = 2048.0;
/// Texels beyond either end of a clamped line whose sums are kept.
const BORDER: i32 = 48;
/// A footprint of less than this many texels is a point.
pub const POINT: f64 = 0.02;
/// Places per texel along either axis, beyond one, where places are read.
pub const DENSITY: f64 = 2.5;
/// Places along either axis, at most.
pub const MOST: f64 = 16.0;

/// The images of a scene with their mip levels, in linear light.
pub struct Textures {
    chains: Vec<Vec<Level>>,
    textures: Vec<Texture>,
    /// Per image, least and greatest texels.
    ranges: Vec<[DVec3; 2]>,
    /// Per texture and level, sums along rows and along columns, made when they are first read.
    sums: Vec<Vec<[OnceLock<Sums>; 2]>>,
}

struct Level {
    width: i32,
    height: i32,
    texels: Vec<[f32; 4]>,
}

/// Sums of texels along lines, less the mean of all texels, which keeps them small.
struct Sums {
    /// Texels after which a line repeats, or ends if it is clamped.
    period: usize,
    /// Texels before the first one that are kept of clamped lines, and after the last one.
    border: i32,
    lines: i32,
    wrap: Wrap,
    /// Texels are not interpolated.
    steps: bool,
    mean: Vec4,
    /// Per line: of the first k texels, for k up to `period` + 2.
    sums: Vec<Vec4>,
}

impl Sums {
    /// Along rows of `level`, or along columns if `across`.
    fn new(level: &Level, texture: &Texture, across: bool, mean: [f32; 4]) -> Self {
        let (length, lines) = if across { (level.height, level.width) } else { (level.width, level.height) };
        let (along, wrap) =
            if across { (texture.wrap_v, texture.wrap_u) } else { (texture.wrap_u, texture.wrap_v) };
        let border = if along == Wrap::Clamp { BORDER } else { 0 };
        let period = match along {
            Wrap::Repeat => length,
            Wrap::Mirror => 2 * length,
            Wrap::Clamp => length + 2 * BORDER,
        };
        let mut sums = Vec::with_capacity(lines as usize * (period as usize + 3));
        for line in 0..lines {
            let mut sum = DVec4::ZERO;
            for k in 0..period + 3 {
                sums.push(sum.as_vec4());
                let k = wrap_index(k - border, length, along) as i32;
                let (x, y) = if across { (line, k) } else { (k, line) };
                let texel = &level.texels[(y * level.width + x) as usize];
                sum += DVec4::from_array(std::array::from_fn(|c| f64::from(texel[c]) - f64::from(mean[c])));
            }
        }
        let (steps, mean) = (texture.nearest, Vec4::from_array(mean));
        Self { period: period as usize, border, lines, wrap, steps, mean, sums }
    }

    /// Number of the sum before texel `column`, of which lines reach `extent` texels further; `None` where they do not.
    #[inline(always)]
    fn column(&self, column: i32, extent: f64) -> Option<usize> {
        if self.border == 0 {
            return Some(column.rem_euclid(self.period as i32) as usize);
        }
        let column = f64::from(column) + f64::from(self.border);
        (column >= 0.0 && column + extent < self.period as f64).then_some(column as usize)
    }

    /// Sums of a line.
    #[inline(always)]
    fn line(&self, line: i32) -> &[Vec4] {
        let length = self.period + 3;
        &self.sums[wrap_index(line, self.lines, self.wrap) * length..][..length]
    }

    /// Mean over the parallelogram about `centre` with the half sides `p` and `q`, neither of which leads up.
    /// `None` beyond the lines of a clamped texture.
    fn mean_over(&self, centre: [f64; 2], p: [f64; 2], q: [f64; 2]) -> Option<Vec4> {
        // Texels from whole ones before its corner: 32 bits suffice for what is left.
        let corner = [centre[0] - p[0].abs() - q[0].abs(), centre[1] - p[1] - q[1]];
        let [column, row] = corner.map(floor);
        let within =
            Within { sums: self, column: self.column(column, 2.0 * (centre[0] - corner[0]) + 2.0)?, row };
        let top = [centre[0] - p[0] - q[0] - f64::from(column), corner[1] - f64::from(row)].map(|v| v as f32);
        let [p, q] = [p, q].map(|half| half.map(|v| 2.0 * v as f32));
        let area = p[0] * q[1] - p[1] * q[0];
        let scale = 1.0 / area.abs();
        let along = |from: [f32; 2], by: [f32; 2]| [from[0] + by[0], from[1] + by[1]];
        // Its two ways down from the upper corner to the lower one, along p first, and along q first.
        let edge = |from: [f32; 2], by: [f32; 2]| within.any_edge(from, by, scale);
        let one = edge(top, p) + edge(along(top, p), q);
        let other = edge(top, q) + edge(along(top, q), p);
        Some(self.mean + (one - other) * (1.0 / area))
    }
}

/// Lines about a footprint.
struct Within<'a> {
    sums: &'a Sums,
    /// Where its places count from.
    column: usize,
    row: i32,
}

impl Within<'_> {
    /// Integral over the height of an edge from `from` by `by`, which does not lead up, of what lies to the left of it;
    /// `scale` is 1 / area of the footprint.
    #[inline(always)]
    fn any_edge(&self, from: [f32; 2], by: [f32; 2], scale: f32) -> Vec4 {
        if self.sums.steps { self.edge::<true>(from, by, scale) } else { self.edge::<false>(from, by, scale) }
    }

    #[inline(always)]
    fn edge<const STEPS: bool>(&self, from: [f32; 2], by: [f32; 2], scale: f32) -> Vec4 {
        let mut sum = Vec4::ZERO;
        if by[1] < FLAT {
            return sum;
        }
        let slope = by[0] / by[1];
        let lean = slope.abs();
        let end = from[1] + by[1];
        let mut y = from[1];
        let mut row = y as i32;
        let mut below = self.sums.line(self.row + row);
        while y < end {
            let above = below;
            below = self.sums.line(self.row + row + 1);
            let next = ((row + 1) as f32).min(end);
            let height = next - y;
            let x = from[0] + slope * (y - from[1]);
            let v = y - row as f32;
            let at = |part: f32| self.at::<STEPS>([above, below], x + slope * part, v + part);
            if lean * height * height * height * scale < ONE_PLACE {
                sum += at(0.5 * height) * height;
            } else {
                let parts = (lean * height * (1.0 / SPACING)).min(MOST_PARTS) as u32 + 1;
                let part = height / parts as f32;
                for k in 0..parts {
                    let middle = part * (k as f32 + 0.5);
                    sum += (at(middle - GAUSS * part) + at(middle + GAUSS * part)) * (0.5 * part);
                }
            }
            y = next;
            row += 1;
        }
        sum
    }

    /// Integral of the signal from the beginning of its line to a place, `v` of the way from one line to the next: a
    /// quadratic B-spline of sums, or a linear one of steps.
    #[inline(always)]
    fn at<const STEPS: bool>(&self, lines: [&[Vec4]; 2], x: f32, v: f32) -> Vec4 {
        let k = x as u32;
        let w = x - k as f32;
        let u = 1.0 - w;
        let weights = if STEPS { [u, w, 0.0] } else { [0.5 * u * u, 0.5 + w * u, 0.5 * w * w] };
        let k = k as usize + self.column;
        let period = self.sums.period;
        let (k, turns) = if k < period { (k, 0.0) } else { (k % period, (k / period) as f32) };
        let upto = |line: &[Vec4]| {
            let sums = &line[k..k + 3];
            let sum = sums[0] * weights[0] + sums[1] * weights[1] + sums[2] * weights[2];
            if turns > 0.0 { sum + line[period] * turns } else { sum }
        };
        if STEPS { upto(lines[0]) } else { upto(lines[0]) * (1.0 - v) + upto(lines[1]) * v }
    }
}

/// Where a line's signal counts from, in texels from the border of the first one.
#[inline(always)]
fn first_texel(texture: &Texture) -> f64 {
    if texture.nearest { 0.0 } else { -0.5 }
}

/// The largest integer that is not above `v`, where that fits.
#[inline(always)]
fn floor(v: f64) -> i32 {
    let k = v as i32;
    k.saturating_sub(i32::from(f64::from(k) > v))
}

impl Textures {
    /// Decodes the images of `scene`.
    pub fn new(scene: &Scene) -> Self {
        let chain = |image: &evis_scene::Image| -> Vec<Level> {
            if image.texels.is_empty() || image.texels.len() != image.width as usize * image.height as usize {
                return Vec::new();
            }
            mip_chain(image)
                .iter()
                .map(|level| Level {
                    width: level.width as i32,
                    height: level.height as i32,
                    texels: level.texels.iter().map(|t| t.map(half::f16::to_f32)).collect(),
                })
                .collect()
        };
        let chains: Vec<Vec<Level>> = scene.images.iter().map(chain).collect();
        let levels = |t: &Texture| chains.get(t.image).map_or(0, Vec::len);
        let sums = scene.textures.iter().map(|t| (0..levels(t)).map(|_| Default::default()).collect());
        let sums = sums.collect();
        let range = |chain: &Vec<Level>| {
            let texels = || chain.first().into_iter().flat_map(|level| &level.texels);
            let colors = || texels().map(|t| Vec3::new(t[0], t[1], t[2]));
            let of = |fold: fn(Vec3, Vec3) -> Vec3| colors().reduce(fold).unwrap_or(Vec3::ONE).as_dvec3();
            [of(Vec3::min), of(Vec3::max)]
        };
        let ranges = chains.iter().map(range).collect();
        Self { chains, textures: scene.textures.clone(), ranges, sums }
    }

    /// Least and greatest texels of texture `number`, per channel; white where there are none.
    pub fn range(&self, number: usize) -> [DVec3; 2] {
        let texture = self.textures.get(number);
        texture.and_then(|t| self.ranges.get(t.image)).copied().unwrap_or([DVec3::ONE; 2])
    }

    /// Width and height of texture `texture`; `None` where it has no texels.
    pub fn size(&self, texture: usize) -> Option<[f64; 2]> {
        let base = self.chains.get(self.textures.get(texture)?.image)?.first()?;
        Some([f64::from(base.width), f64::from(base.height)])
    }

    /// Mean of all texels of texture `texture`.
    pub fn overall(&self, texture: usize) -> [f32; 4] {
        let chain = self.textures.get(texture).and_then(|t| self.chains.get(t.image));
        chain.and_then(|c| c.last()?.texels.first()).copied().unwrap_or([1.0; 4])
    }

    /// Texture `number` about the place `at` in base texels, as far as a footprint with the `sides` reaches, of which a place that is
    /// read stands for `part`: on the level whose texels are as large as that or the next smaller one. `None` where there are no
    /// texels.
    #[inline(always)]
    pub fn about(&self, number: usize, at: DVec2, sides: DMat2, part: f64) -> Option<About<'_>> {
        let texture = self.textures.get(number)?;
        let chain = self.chains.get(texture.image).filter(|c| !c.is_empty())?;
        let area = sides.determinant().abs() * part;
        let smaller = if texture.nearest { 0 } else { half_log2(area).min(chain.len() - 1) };
        let level = &chain[smaller];
        let scale = DVec2::from_array(level.scale(&chain[0]));
        let middle = at * scale - 0.5;
        let sides = DMat2::from_diagonal(scale) * sides;
        let first = middle.to_array().map(floor);
        let rest = middle - DVec2::new(f64::from(first[0]), f64::from(first[1]));
        let turned = |k: usize, size: i32, wrap: Wrap| match wrap {
            Wrap::Repeat if !(0..size).contains(&first[k]) => first[k].rem_euclid(size),
            _ => first[k],
        };
        let first = [turned(0, level.width, texture.wrap_u), turned(1, level.height, texture.wrap_v)];
        // A texel more than what interpolation and rounding take.
        let reach = 0.5 * (sides.x_axis.abs() + sides.y_axis.abs()) + 2.0;
        let within = |first: i32, reach: f64, size: i32| {
            f64::from(first) - reach > 0.0 && f64::from(first) + 1.0 + reach < f64::from(size)
        };
        let inside = within(first[0], reach.x, level.width) && within(first[1], reach.y, level.height);
        let [rest, p, q] = [rest, sides.x_axis, sides.y_axis].map(DVec2::as_vec2);
        Some(About { level, texture, first, inside, rest, sides: [p, q] })
    }

    /// Mean of texture `texture` over the parallelogram about `at` with the sides `axes`, in base texels from the
    /// corner of the first one. White where there are no texels.
    #[inline(always)]
    pub fn mean(&self, number: usize, at: [f64; 2], axes: [[f64; 2]; 2]) -> [f32; 4] {
        let Some(texture) = self.textures.get(number) else { return [1.0; 4] };
        let Some(chain) = self.chains.get(texture.image).filter(|c| !c.is_empty()) else { return [1.0; 4] };
        let [p, q] = axes;
        let level = level_of(axes, chain.len());
        let source = &chain[level];
        let scale = source.scale(&chain[0]);
        let texel = 1.0 / scale[0].min(scale[1]).max(1e-9);
        // A level's own blur is taken from the footprint: twelve times its variance, as that of a unit square is 1/12.
        let own = if texture.nearest { 1.0 } else { 3.0 };
        let axes = [p, q].map(|axis| {
            let squared = axis[0] * axis[0] + axis[1] * axis[1];
            let kept = ((squared - own * (texel * texel - 1.0)).max(0.0) / squared.max(1e-30)).sqrt();
            [axis[0] * kept * scale[0], axis[1] * kept * scale[1]]
        });
        let middle = [0, 1].map(|k| at[k] * scale[k] - 0.5);
        let extent = [0, 1].map(|k| axes[0][k].abs() + axes[1][k].abs());
        if !texture.nearest && extent[0] < POINT && extent[1] < POINT {
            let mut sum = [0.0; 4];
            source.bilinear(middle[0], middle[1], texture, &mut sum);
            return sum;
        }
        let across = extent[0] < extent[1];
        let (x, y) = if across { (1, 0) } else { (0, 1) };
        let sums = self.sums(number, level, across);
        // Half of its sides, in the direction in which they lead down.
        let [p, q] = axes.map(|axis| {
            let half = 0.5_f64.copysign(axis[y]);
            [axis[x] * half, axis[y] * half]
        });
        let area = 4.0 * (p[0] * q[1] - p[1] * q[0]).abs();
        if area.is_nan() || area < 1e-6 || p[1] + q[1] > MOST_LINES {
            return source.places(middle, axes, texture);
        }
        let centre = [x, y].map(|k| at[k] * scale[k] + first_texel(texture));
        match sums.mean_over(centre, p, q) {
            Some(mean) => mean.to_array(),
            None => source.places(middle, axes, texture),
        }
    }
}

/// What a device does with a texture.
#[derive(Clone, Copy, Debug, Default)]
pub struct Use {
    /// It finds means of it.
    pub means: bool,
    /// It reads it at places.
    pub places: bool,
}

/// Red, green and blue in 16 bits each, as parts of `most`, in two words.
fn packed_texel(texel: [f32; 4], most: f32) -> [u32; 2] {
    let part = |k: usize| ((texel[k] / most).clamp(0.0, 1.0) * f32::from(u16::MAX)).round() as u32;
    [part(0) | part(1) << 16, part(2)]
}

/// The whole part of half of the logarithm of `v` to the base 2, 0 where that is less: bits say it on every machine alike.
#[inline(always)]
fn half_log2(v: f64) -> usize {
    let exponent = (v.to_bits() >> 52) as usize & 0x7ff;
    exponent.saturating_sub(1023) / 2
}

/// A level of a texture about a place, to be read at four places at once.
#[derive(Clone, Copy)]
pub struct About<'a> {
    level: &'a Level,
    texture: &'a Texture,
    /// The texel from which places count, and whether all that are near lie within the level.
    first: [i32; 2],
    inside: bool,
    /// Where the middle is from there, and what the sides of the footprint are, in texels.
    rest: Vec2,
    sides: [Vec2; 2],
}

impl About<'_> {
    /// Red, green and blue at four places: `s` and `t` are parts of the sides from the middle, -1/2 to 1/2.
    #[inline(always)]
    pub fn at(&self, s: Vec4, t: Vec4) -> Four {
        let [p, q] = self.sides;
        let mut x = self.rest.x + s * p.x + t * q.x;
        let mut y = self.rest.y + s * p.y + t * q.y;
        if self.texture.nearest {
            (x, y) = ((x + 0.5).floor(), (y + 0.5).floor());
        }
        let ((columns, wx), (rows, wy)) = (parts(x), parts(y));
        let (wx, wy) = (wx.to_array(), wy.to_array());
        let mut each = [Vec4::ZERO; 4];
        for (k, texel) in each.iter_mut().enumerate() {
            let [column, row] = [self.first[0].wrapping_add(columns[k]), self.first[1].wrapping_add(rows[k])];
            let [a, b, c, d] = self.around(column, row);
            let [a, b, c, d] = [a, b, c, d].map(|texel| Vec4::from_array(*texel));
            let (upper, lower) = (a + (b - a) * wx[k], c + (d - c) * wx[k]);
            *texel = upper + (lower - upper) * wy[k];
        }
        Four::of(each)
    }

    /// The texel at (column, row), the one after it in its line, and those of the next line.
    #[inline(always)]
    fn around(&self, column: i32, row: i32) -> [&[f32; 4]; 4] {
        let texels = &self.level.texels;
        if self.inside {
            let width = self.level.width as usize;
            let at = (row as u32 as usize).wrapping_mul(width).wrapping_add(column as u32 as usize);
            let (upper, lower) = (&texels[at..][..2], &texels[at.wrapping_add(width)..][..2]);
            return [&upper[0], &upper[1], &lower[0], &lower[1]];
        }
        self.wrapped(column, row)
    }

    #[inline(never)]
    fn wrapped(&self, column: i32, row: i32) -> [&[f32; 4]; 4] {
        let Level { width, height, texels } = self.level;
        let columns = [column, column.wrapping_add(1)].map(|x| wrap_index(x, *width, self.texture.wrap_u));
        let rows =
            [row, row.wrapping_add(1)].map(|y| wrap_index(y, *height, self.texture.wrap_v) * *width as usize);
        [0, 1, 2, 3].map(|k| &texels[rows[k / 2] + columns[k % 2]])
    }
}

/// Means over the cells of a grid, and room for finding them.
#[derive(Default)]
pub struct Cells {
    /// Row by row.
    pub means: Vec<Vec4>,
    upper: Vec<[f32; 2]>,
    lower: Vec<[f32; 2]>,
    above: Vec<Vec4>,
}

impl Textures {
    /// Means of texture `number` over the cells of a grid with `columns` cells per row and corners at `places`, row by row,
    /// in base texels; `pixel` are the sides of a pixel's footprint there. `None` where single places are all that can be
    /// read.
    pub fn cells(
        &self,
        number: usize,
        places: &[DVec2],
        columns: usize,
        pixel: [[f64; 2]; 2],
        Cells { means, upper, lower, above }: &mut Cells,
    ) -> Option<()> {
        let texture = self.textures.get(number)?;
        let chain = self.chains.get(texture.image).filter(|c| !c.is_empty())?;
        let level = level_of(pixel, chain.len());
        let source = &chain[level];
        let scale = source.scale(&chain[0]);
        let [p, q] = pixel.map(|axis| [axis[0] * scale[0], axis[1] * scale[1]]);
        let extent = [0, 1].map(|k| p[k].abs() + q[k].abs());
        let across = extent[0] < extent[1];
        let axes = if across { [1, 0] } else { [0, 1] };
        let stride = columns + 1;
        let on_level = |place: &DVec2| axes.map(|k| place[k] * scale[k] + first_texel(texture));
        // Straight lines between corners keep all places within those of the grid.
        let outer = [0, columns, places.len() - stride, places.len() - 1].map(|k| on_level(&places[k]));
        let bound = |k: usize, least: fn(f64, f64) -> f64| outer.iter().map(|c| c[k]).reduce(least);
        let [low, high] = [f64::min, f64::max].map(|f| [0, 1].map(|k| bound(k, f).unwrap_or(f64::NAN)));
        let area = (p[0] * q[1] - p[1] * q[0]).abs();
        if !(area > 1e-6 && high[0] - low[0] < MOST_EXTENT && high[1] - low[1] < MOST_EXTENT) {
            return None;
        }
        let sums = self.sums(number, level, across);
        let [column, row] = [low[0] - 1.0, low[1] - 1.0].map(floor);
        let within = Within { sums, column: sums.column(column, high[0] - low[0] + 2.0)?, row };
        let base = [column, row].map(f64::from);
        let near = |place: &DVec2| {
            let at = on_level(place);
            [0, 1].map(|k| (at[k] - base[k]) as f32)
        };
        let scale_of_edges = (1.0 / area) as f32;
        let edge = |a: [f32; 2], b: [f32; 2]| {
            let by = [b[0] - a[0], b[1] - a[1]];
            if by[1] >= 0.0 {
                within.any_edge(a, by, scale_of_edges)
            } else {
                -within.any_edge(b, [-by[0], -by[1]], scale_of_edges)
            }
        };
        let mut corners = places.chunks_exact(stride);
        means.clear();
        upper.clear();
        upper.extend(corners.next()?.iter().map(near));
        above.clear();
        above.extend(upper.windows(2).map(|pair| edge(pair[0], pair[1])));
        for row in corners {
            lower.clear();
            lower.extend(row.iter().map(near));
            let mut left = edge(upper[0], lower[0]);
            for k in 0..columns {
                let [a, b, c, d] = [upper[k], upper[k + 1], lower[k + 1], lower[k]];
                let right = edge(b, c);
                let below = edge(d, c);
                let area = 0.5 * ((c[0] - a[0]) * (d[1] - b[1]) - (c[1] - a[1]) * (d[0] - b[0]));
                means.push(sums.mean + (above[k] + right - below - left) * (1.0 / area));
                left = right;
                above[k] = below;
            }
            std::mem::swap(upper, lower);
        }
        means.iter().all(|m| m.is_finite()).then_some(())
    }

    /// The textures that are `used`, as a device has them; of others it knows no texels.
    pub fn pack(&self, used: &[Use]) -> packed::Textures {
        let mut rows = vec![[0.0; 4]; 2 * self.textures.len()];
        let mut all_sums: Vec<&[Vec4]> = Vec::new();
        let (mut count, mut texels) = (0, Vec::new());
        for (number, texture) in self.textures.iter().enumerate() {
            let Use { means, places } = used[number];
            let Some(chain) = self.chains.get(texture.image).filter(|chain| !chain.is_empty()) else {
                continue;
            };
            if !means && !places {
                continue;
            }
            let wrap = |wrap: Wrap| match wrap {
                Wrap::Repeat => 0,
                Wrap::Clamp => 1,
                Wrap::Mirror => 2,
            };
            let flags = wrap(texture.wrap_u) | wrap(texture.wrap_v) << 2 | u32::from(texture.nearest) << 4;
            let levels = rows.len() as u32;
            rows[2 * number] = packed::as_floats([levels, chain.len() as u32, flags, 0]);
            let most = (self.range(number)[1].max_element() as f32).max(f32::MIN_POSITIVE);
            let [r, g, b, _] = self.overall(number);
            rows[2 * number + 1] = [r, g, b, most];
            for (index, level) in chain.iter().enumerate() {
                let first = texels.len() as u32;
                rows.push(packed::as_floats([level.width as u32, level.height as u32, first, 0]));
                if places {
                    texels.extend(level.texels.iter().map(|texel| packed_texel(*texel, most)));
                }
                if !means {
                    rows.push([0.0; 4]);
                    continue;
                }
                // Along rows only: columns would be as much again.
                let sums = self.sums(number, index, false);
                let words = [count, sums.period as u32, sums.border as u32, sums.lines as u32];
                rows.push(packed::as_floats(words));
                count += sums.sums.len() as u32;
                all_sums.push(&sums.sums);
            }
        }
        let sums = rows.len() as u32;
        rows.extend(all_sums.into_iter().flatten().map(|sum| sum.to_array()));
        let first = rows.len() as u32;
        rows.extend(texels.chunks(2).map(|pair| {
            let [a, b] = [pair[0], pair.get(1).copied().unwrap_or_default()];
            packed::as_floats([a[0], a[1], b[0], b[1]])
        }));
        packed::Textures { rows, sums, texels: first, around: 0 }
    }

    /// Bytes that these take, about.
    pub fn packed_bytes(&self, used: &[Use]) -> usize {
        let of = |(texture, used): (&Texture, &Use)| {
            let chain = self.chains.get(texture.image).map_or(&[][..], Vec::as_slice);
            let texels: usize = chain.iter().map(|level| level.texels.len()).sum();
            texels * (16 * usize::from(used.means) + 8 * usize::from(used.places))
        };
        self.textures.iter().zip(used).map(of).sum()
    }

    /// Sums of a level of texture `number` along rows, or along columns if `across`.
    fn sums(&self, number: usize, level: usize, across: bool) -> &Sums {
        let texture = &self.textures[number];
        let source = &self.chains[texture.image][level];
        self.sums[number][level][usize::from(across)]
            .get_or_init(|| Sums::new(source, texture, across, self.overall(number)))
    }
}

impl Level {
    /// Its texels per texel of `base`, along either axis.
    #[inline(always)]
    fn scale(&self, base: &Self) -> [f64; 2] {
        [f64::from(self.width) / f64::from(base.width), f64::from(self.height) / f64::from(base.height)]
    }

    /// Mean over a grid of places in the parallelogram about `middle`.
    fn places(&self, middle: [f64; 2], axes: [[f64; 2]; 2], texture: &Texture) -> [f32; 4] {
        let steps = axes.map(|axis| {
            let texels = axis[0].hypot(axis[1]);
            let count = if texels < POINT { 1.0 } else { (1.0 + DENSITY * texels).ceil().clamp(2.0, MOST) };
            if count == 1.0 {
                return (1, [0.0; 2]);
            }
            // Places at the middles of equal parts have the variance (1 - 1 / n^2) of the whole.
            let step = 1.0 / (1.0 - 1.0 / (count * count)).sqrt() / count;
            (count as usize, axis.map(|v| v * step))
        });
        let [(across, dx), (down, dy)] = steps;
        let start =
            [0, 1].map(|k| middle[k] - 0.5 * ((across as f64 - 1.0) * dx[k] + (down as f64 - 1.0) * dy[k]));
        let mut sum = [0.0_f32; 4];
        for row in 0..down {
            let mut x = start[0] + row as f64 * dy[0];
            let mut y = start[1] + row as f64 * dy[1];
            for _ in 0..across {
                if texture.nearest {
                    self.nearest(x, y, texture, &mut sum);
                } else {
                    self.bilinear(x, y, texture, &mut sum);
                }
                x += dx[0];
                y += dx[1];
            }
        }
        let inverse = 1.0 / (across * down) as f32;
        sum.map(|v| v * inverse)
    }
}

/// The smallest level whose blur is at most that of the shorter axis of a footprint with the sides `p` and `q`, unless its
/// longer one would have too many texels there.
#[inline(always)]
fn level_of([p, q]: [[f64; 2]; 2], levels: usize) -> usize {
    // Of the ellipse with the parallelogram's variance.
    let (xx, xy, yy) = (p[0] * p[0] + q[0] * q[0], p[0] * p[1] + q[0] * q[1], p[1] * p[1] + q[1] * q[1]);
    let (shorter, longer) = (0.5 * (xx + yy) - (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt(), xx + yy);
    let texel = (shorter.max(0.0) * BLUR / 3.0 + 1.0).max(longer / (MOST_LINES * MOST_LINES));
    let mut level = 0;
    let mut squared = 4.0;
    while squared <= texel && level + 1 < levels {
        level += 1;
        squared *= 4.0;
    }
    level
}

/// Part of the footprint's variance that a level's own blur may be.
pub const BLUR: f64 = 0.02;

impl Level {
    #[inline(always)]
    fn bilinear(&self, x: f64, y: f64, texture: &Texture, sum: &mut [f32; 4]) {
        let (x0, y0) = (floor(x), floor(y));
        let (wx, wy) = ((x - f64::from(x0)) as f32, (y - f64::from(y0)) as f32);
        let columns = [x0, x0.wrapping_add(1)].map(|x| wrap_index(x, self.width, texture.wrap_u));
        let rows = [y0, y0.wrapping_add(1)]
            .map(|y| wrap_index(y, self.height, texture.wrap_v) * self.width as usize);
        let at = |row: usize, column: usize| &self.texels[rows[row] + columns[column]];
        let (a, b, c, d) = (at(0, 0), at(0, 1), at(1, 0), at(1, 1));
        let weights = [(1.0 - wx) * (1.0 - wy), wx * (1.0 - wy), (1.0 - wx) * wy, wx * wy];
        for k in 0..4 {
            sum[k] += weights[0] * a[k] + weights[1] * b[k] + weights[2] * c[k] + weights[3] * d[k];
        }
    }

    #[inline(always)]
    fn nearest(&self, x: f64, y: f64, texture: &Texture, sum: &mut [f32; 4]) {
        let column = wrap_index((x + 0.5).floor() as i32, self.width, texture.wrap_u);
        let row = wrap_index((y + 0.5).floor() as i32, self.height, texture.wrap_v);
        let texel = &self.texels[row * self.width as usize + column];
        for k in 0..4 {
            sum[k] += texel[k];
        }
    }
}

/// Texel `index` brought into [0, size).
#[inline(always)]
/// The texel that is read for number `index` of a line of `size`.
pub fn wrap_index(index: i32, size: i32, wrap: Wrap) -> usize {
    if index >= 0 && index < size {
        return index as usize;
    }
    (match wrap {
        Wrap::Repeat => index.rem_euclid(size),
        Wrap::Clamp => index.clamp(0, size - 1),
        Wrap::Mirror => {
            let i = index.rem_euclid(2 * size);
            if i < size { i } else { 2 * size - 1 - i }
        }
    }) as usize
}

#[cfg(test)]
mod tests {
    use half::f16;

    use super::*;

    fn noise(size: u32) -> Scene {
        let value = |i: u32| {
            let v = i.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            let v = ((v >> ((v >> 28) + 4)) ^ v).wrapping_mul(277_803_737);
            f64::from((v >> 22) ^ v) / f64::from(u32::MAX)
        };
        let texels = (0..size * size).map(|i| [f16::from_f64(0.1 + 0.9 * value(i)); 4]).collect();
        let image = evis_scene::Image { name: "noise".into(), width: size, height: size, texels };
        let texture = Texture { image: 0, wrap_u: Wrap::Repeat, wrap_v: Wrap::Mirror, nearest: false };
        Scene { images: vec![image], textures: vec![texture], ..Scene::default() }
    }

    #[test]
    fn four_places_are_read_as_one_is() {
        let mut canary = 0;
        for (wrap_u, wrap_v, nearest) in [
            (Wrap::Repeat, Wrap::Mirror, false),
            (Wrap::Mirror, Wrap::Clamp, false),
            (Wrap::Clamp, Wrap::Repeat, true),
        ] {
            let mut scene = noise(64);
            (scene.textures[0].wrap_u, scene.textures[0].wrap_v) = (wrap_u, wrap_v);
            scene.textures[0].nearest = nearest;
            let textures = Textures::new(&scene);
            let read = if nearest { Level::nearest } else { Level::bilinear };
            for i in 0..200 {
                let f = f64::from(i);
                // From magnified to four texels per place, a few of them far beyond the borders.
                let size = [0.2, 1.0, 4.0, 16.0][i as usize % 4];
                let at = DVec2::new(f * 7.31, f * 3.77 - 400.0) * if i % 9 == 0 { 1e3 } else { 0.1 };
                let sides = DMat2::from_cols(DVec2::new(size, 0.3), DVec2::new(-0.4, 0.9 * size));
                let about = textures.about(0, at, sides, 1.0 / 16.0).expect("a texture");
                let number = if nearest { 0 } else { (0.24 * size).max(1.0).log2() as usize };
                let level = &textures.chains[0][number];
                let (s, t) = (Vec4::new(-0.5, -0.2, 0.1, 0.5), Vec4::new(0.3, -0.5, 0.5, 0.07));
                let found = about.at(s, t);
                for k in 0..4 {
                    let place = at + sides * DVec2::new(f64::from(s[k]), f64::from(t[k]));
                    let place = place * DVec2::from_array(level.scale(&textures.chains[0][0])) - 0.5;
                    let mut wanted = [0.0; 4];
                    read(level, place.x, place.y, &textures.textures[0], &mut wanted);
                    let near = |found: f32| (found - wanted[0]).abs() < 1e-4;
                    assert!(near(found.x[k]) && near(found.z[k]), "{i}, {k}: {} not {wanted:?}", found.x[k]);
                    canary += usize::from(!near(found.x[(k + 1) % 4]));
                }
            }
        }
        assert!(canary > 1500, "{canary} unlike their neighbours");
    }

    #[test]
    fn means_over_footprints_are_those_of_many_places() {
        for nearest in [false, true] {
            means_over_footprints(nearest);
        }
    }

    fn means_over_footprints(nearest: bool) {
        let mut scene = noise(64);
        scene.textures[0].nearest = nearest;
        let textures = Textures::new(&scene);
        let base = &textures.chains[0][0];
        let read = if nearest { Level::nearest } else { Level::bilinear };
        let mut squares = [0.0; 6];
        let mut canary: f64 = 0.0;
        // The last two are seen at grazing angles.
        for (class, (size, ratio)) in
            [(0.3, 0.8), (1.0, 0.8), (2.5, 0.8), (8.0, 0.8), (2.5, 6.0), (1.0, 20.0)].into_iter().enumerate()
        {
            for i in 0..60 {
                let f = f64::from(i);
                let at = [f * 7.31, f * 3.77 - 40.0];
                let turn = f * 0.7;
                let p = [size * turn.cos(), size * turn.sin()];
                let q = [-ratio * size * (turn + 0.3).sin(), ratio * size * (turn + 0.3).cos()];
                let mut exact = [0.0; 4];
                for k in 0..64 * 64 {
                    let (s, t) =
                        ((f64::from(k % 64) + 0.5) / 64.0 - 0.5, (f64::from(k / 64) + 0.5) / 64.0 - 0.5);
                    let x = at[0] + s * p[0] + t * q[0] - 0.5;
                    let y = at[1] + s * p[1] + t * q[1] - 0.5;
                    read(base, x, y, &textures.textures[0], &mut exact);
                }
                let exact = f64::from(exact[0]) / 4096.0;
                let error = f64::from(textures.mean(0, at, [p, q])[0]) / exact - 1.0;
                squares[class] += error * error / 60.0;
                canary = canary.max((f64::from(textures.mean(0, at, [[0.0; 2]; 2])[0]) / exact - 1.0).abs());
            }
        }
        let rms = squares.map(f64::sqrt);
        println!(
            "nearest {nearest}, relative errors at 0.3, 1, 2.5 and 8 texels per pixel, 2.5 by 15 and 1 by 20: {rms:.4?}"
        );
        assert!(rms.iter().all(|e| *e < 0.012), "{rms:?}");
        assert!(canary > 0.2, "a point is no mean: {canary}");
    }

    #[test]
    fn cells_of_a_grid_share_edges_and_have_the_means_of_many_places() {
        let mut scene = noise(64);
        for (wrap_u, nearest) in
            [(Wrap::Repeat, false), (Wrap::Clamp, false), (Wrap::Repeat, true), (Wrap::Clamp, true)]
        {
            scene.textures[0].wrap_u = wrap_u;
            scene.textures[0].nearest = nearest;
            let read = if nearest { Level::nearest } else { Level::bilinear };
            let textures = Textures::new(&scene);
            let base = &textures.chains[0][0];
            let (mut squares, mut canary, mut count) = (0.0, 0.0, 0);
            let mut cells = Cells::default();
            for i in 0..48 {
                // Texels per pixel, turned, with perspective; some beyond the border of a clamped texture.
                let (f, size) = (f64::from(i), [0.3, 1.0, 2.5, 6.0][i as usize % 4]);
                let (s, c) = (0.7 * f).sin_cos();
                let at = |x: f64, y: f64| {
                    let z = 1.0 + 0.01 * x - 0.02 * y;
                    let (x, y) = (size * (c * x - 1.2 * s * y) / z, size * (s * x + 1.2 * c * y) / z);
                    DVec2::new(x + 1.7 * f, y + 2.3 * f)
                };
                let corners: Vec<DVec2> =
                    (0..25).map(|k| at(f64::from(k % 5) - 2.0, f64::from(k / 5) - 2.0)).collect();
                let pixel = [(at(0.5, 0.0) - at(-0.5, 0.0)), (at(0.0, 0.5) - at(0.0, -0.5))];
                textures.cells(0, &corners, 4, pixel.map(|v| v.to_array()), &mut cells).expect("near");
                for (cell, mean) in cells.means.iter().enumerate() {
                    let (x, y) = ((cell % 4) as f64 - 2.0, (cell / 4) as f64 - 2.0);
                    let mut exact = [0.0; 4];
                    for k in 0..32 * 32 {
                        let [u, v] = [k % 32, k / 32].map(|v| (f64::from(v) + 0.5) / 32.0);
                        let place = at(x + u, y + v) - 0.5;
                        read(base, place.x, place.y, &textures.textures[0], &mut exact);
                    }
                    let exact = f64::from(exact[0]) / 1024.0;
                    squares += (f64::from(mean.x) / exact - 1.0).powi(2);
                    let next = cells.means[(cell + 1) % 16];
                    canary += (f64::from(next.x) / exact - 1.0).powi(2);
                    count += 1;
                }
            }
            let [rms, canary] = [squares, canary].map(|v| (v / f64::from(count)).sqrt());
            println!(
                "{wrap_u:?}, nearest {nearest}: relative error {rms:.4} over {count} cells, {canary:.4} of their neighbours"
            );
            assert!(rms < 0.005, "{wrap_u:?}: {rms}");
            assert!(canary > 0.1, "{wrap_u:?}: {canary}");
        }
    }
}
