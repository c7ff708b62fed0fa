//! A facet's light on the screen of one time, summed over rectangles.
//!
//! Of surfaces with normal, roughness or other maps, light is no product of what changes slowly and a texture. While a
//! facet moves by a few pixels, the footprint of a pixel on it hardly changes: only where it lies does. So light of such
//! a facet is rendered once per block, in cells finer than pixels, one value per lamp, and where it changes, at both ends
//! of the block; kept are the sums of all rectangles of cells from the first one. At any time of the block a homography
//! maps the screen to that picture, and the mean over a rectangle there follows from the sums at its four corners,
//! however many texels it holds. The picture is linear between the middles of cells: the integral up to a point is a
//! quadratic B-spline of nine sums.
//!
//! The level of the mip chain that is read, and the cells, add blur of their own. Its variance is taken from the
//! rectangle, so that all together has the second moments of the footprint.

use glam::{DMat2, DMat3, DVec2, DVec3};

use crate::scene::tiles::change;

/// Cells per texel of the level that is read, at least.
const PER_TEXEL: f64 = 3.0;
/// Cells along a pixel's side, at most: base colour is not read from them, but for how the light goes with it.
const DENSITY: f64 = 4.0;
/// Cells along a pixel's side where light changes slowly: it bends with the normals between vertices.
const LEAST_LIGHT_DENSITY: f64 = 3.0;
/// Cells of a picture, at most.
const MOST_CELLS: usize = 1 << 16;
/// Rectangles at most, side by side, in the place of a slanted footprint.
const MOST_SLICES: f64 = 6.0;
/// Correlation of x and y in a footprint below which one rectangle will do.
const SLANT: f64 = 0.05;
/// Values of four channels that a picture holds per cell, at most: of twelve channels, at both ends of a block.
pub const MOST_PLANES: usize = 6;
/// Least part of its greatest 1/depth that a facet has anywhere in its picture.
const LEAST_DEPTH_RATIO: f64 = 0.3;

/// A facet's light about a tile at a reference time.
#[derive(Clone, Debug)]
pub struct Keyframe {
    /// Image point of the first cell's middle.
    first: DVec2,
    /// Cells per pixel.
    density: f64,
    /// Sums per row, one more than cells.
    stride: usize,
    rows: usize,
    /// Where its sums begin.
    start: usize,
    /// Planes of sums, one after another.
    planes: usize,
    /// Second moments xx, xy and yy of the blur that it adds, in square pixels.
    blur: [f64; 3],
    /// What each cell was lessened by, per plane.
    means: [[f32; 4]; MOST_PLANES],
}

/// Lines of which a polygon with corners at (s, t), in order, is to the right, as image points have them: a x + b y + c is the
/// distance in pixels from each, less `margin_px` beyond the polygon.
pub fn outline(image_from_facet: &DMat3, corners: &[[f64; 2]], margin_px: f64) -> Vec<DVec3> {
    let transposed = image_from_facet.inverse().transpose();
    let next = corners.iter().cycle().skip(1);
    let lines = corners.iter().zip(next).filter_map(|(p, q)| {
        let [from, to] = [p, q].map(|p| DVec3::new(p[0], p[1], 1.0));
        let line = transposed * from.cross(to);
        let steepness = line.truncate().length();
        (steepness > 0.0).then(|| line / steepness + DVec3::Z * margin_px)
    });
    lines.collect()
}

/// From where to where the line at `y` lies within all `lines`.
fn within(lines: &[DVec3], y: f64) -> [f64; 2] {
    lines.iter().fold([f64::NEG_INFINITY, f64::INFINITY], |[from, to], line| {
        let rest = line.y * y + line.z;
        let x = -rest / line.x;
        if line.x > 1e-12 {
            [from.max(x), to]
        } else if line.x < -1e-12 {
            [from, to.min(x)]
        } else if rest < 0.0 {
            [f64::INFINITY, f64::NEG_INFINITY]
        } else {
            [from, to]
        }
    })
}

/// Cells about a rectangle of the screen.
struct Grid {
    first: DVec2,
    columns: usize,
    rows: usize,
}

impl Grid {
    /// `density` cells per pixel about `rect`; `None` where these would be more than [`MOST_CELLS`].
    fn about([left, top, right, bottom]: [f64; 4], density: f64) -> Option<Self> {
        // A cell and a half beyond each side.
        let columns = ((right - left) * density).ceil() as usize + 3;
        let rows = ((bottom - top) * density).ceil() as usize + 3;
        let first = DVec2::new(left, top) - 1.0 / density;
        (columns.saturating_mul(rows) <= MOST_CELLS).then_some(Self { first, columns, rows })
    }
}

/// Corners of `rect`; `None` where the map's last component, 1/depth, differs too much over it.
fn corners(map: &DMat3, [left, top, right, bottom]: [f64; 4]) -> Option<[[f64; 2]; 4]> {
    let corners = [[left, top], [right, top], [left, bottom], [right, bottom]];
    let depths = corners.map(|[x, y]| (*map * DVec3::new(x, y, 1.0)).z);
    let (least, greatest) = depths.iter().fold((f64::INFINITY, 0.0_f64), |(a, b), d| (a.min(*d), b.max(*d)));
    (least > LEAST_DEPTH_RATIO * greatest).then_some(corners)
}

/// A part of the picture whose mean is wanted.
#[derive(Clone, Copy, Debug)]
pub struct Footprint {
    /// Centroid.
    pub at: DVec2,
    /// Second moments xx, xy and yy about it.
    pub moments: [f64; 3],
}

impl Footprint {
    /// Of a part of the screen about `at` with these second moments, in the picture that `warp` maps to; `None` beyond the
    /// horizon.
    #[inline(always)]
    pub fn under(warp: &DMat3, at: DVec2, [xx, xy, yy]: [f64; 3]) -> Option<Self> {
        let h = *warp * DVec3::new(at.x, at.y, 1.0);
        let inverse = 1.0 / h.z;
        let place = DVec2::new(h.x * inverse, h.y * inverse);
        let of = |column: DVec3| {
            DVec2::new((column.x - place.x * column.z) * inverse, (column.y - place.y * column.z) * inverse)
        };
        let (p, q) = (of(warp.x_axis), of(warp.y_axis));
        let moment = |i: f64, j: f64, k: f64, l: f64| i * k * xx + (i * l + j * k) * xy + j * l * yy;
        let moments = [moment(p.x, q.x, p.x, q.x), moment(p.x, q.x, p.y, q.y), moment(p.y, q.y, p.y, q.y)];
        (h.z > 0.0).then_some(Self { at: place, moments })
    }
}

impl Keyframe {
    /// Renders `planes` values that `shade` finds at places (s, t) of a facet about `rect`, with `texels` per (s, t) along
    /// either axis of its finest map, and appends their sums to `sums`. `shade` is told which area of (s, t) a cell is. Only
    /// cells within the `lines` of [`outline`] are shaded. `None` where there would be too many cells, or too much perspective.
    pub fn of_light(
        image_from_facet: DMat3,
        (texels, lines): (Option<DMat2>, &[DVec3]),
        rect: [f64; 4],
        planes: usize,
        sums: &mut Vec<[f32; 4]>,
        mut shade: impl FnMut([f64; 2], f64, &mut [[f32; 4]; MOST_PLANES]),
    ) -> Option<Self> {
        let facet_from_image = image_from_facet.inverse();
        if !facet_from_image.is_finite() {
            return None;
        }
        corners(&facet_from_image, rect)?;
        let [left, top, right, bottom] = rect;
        let middle = [0.5 * (left + right), 0.5 * (top + bottom)];
        // Texels per pixel: the longest of what a pixel is large there, and its geometric mean.
        let parameters = change(&facet_from_image, middle);
        let change = texels.unwrap_or(DMat2::ZERO) * parameters;
        let longest = change.x_axis.length().max(change.y_axis.length());
        let density = (PER_TEXEL * longest).ceil().clamp(LEAST_LIGHT_DENSITY, DENSITY);
        let Grid { first, columns, rows } = Grid::about(rect, density)?;
        let (step, stride, start) = (1.0 / density, columns + 1, sums.len());
        let plane = stride * (rows + 1);
        sums.resize(start + planes * plane, [0.0; 4]);
        let area = parameters.determinant().abs() * step * step;
        let mut value = [[0.0; 4]; MOST_PLANES];
        let mut at = |x: f64, y: f64, value: &mut [[f32; 4]; MOST_PLANES]| {
            let h = facet_from_image * DVec3::new(x, y, 1.0);
            shade([h.x / h.z, h.y / h.z], area, value);
        };
        at(middle[0], middle[1], &mut value);
        let means = value;
        for row in 0..rows {
            let mut sum = [[0.0_f32; 4]; MOST_PLANES];
            let y = first.y + row as f64 * step;
            let [from, to] = within(lines, y).map(|x| (x - first.x) / step);
            for column in 0..columns {
                if (from..=to).contains(&(column as f64)) {
                    at(first.x + column as f64 * step, y, &mut value);
                } else {
                    value = means;
                }
                for k in 0..planes {
                    let above = start + k * plane + row * stride + column + 1;
                    for c in 0..4 {
                        sum[k][c] += value[k][c] - means[k][c];
                        sums[above + stride][c] = sums[above][c] + sum[k][c];
                    }
                }
            }
        }
        let level = (change.determinant().abs().sqrt() * step).max(1.0).log2().floor().exp2();
        let blur = if change.determinant() == 0.0 {
            [step * step / 6.0, 0.0, step * step / 6.0]
        } else {
            blur(&change, [0.25 * (level * level - 1.0); 2], density)
        };
        Some(Self { first, density, stride, rows, start, planes, blur, means })
    }

    /// Means of the first `P` planes over `footprint`; `None` where that does not lie in the picture.
    #[inline(always)]
    pub fn means<const P: usize>(&self, sums: &[[f32; 4]], footprint: &Footprint) -> Option<[[f32; 4]; P]> {
        debug_assert!(P <= self.planes, "{P} of {} planes", self.planes);
        let [xx, xy, yy] = [0, 1, 2].map(|k| footprint.moments[k] - self.blur[k]);
        // No narrower than a hundredth of a pixel.
        let (xx, yy) = (xx.max(1e-5), yy.max(1e-5));
        let mut sum: [[f32; 4]; P] = std::array::from_fn(|k| self.means[k]);
        if xy * xy < SLANT * SLANT * xx * yy {
            let sides = DVec2::new((12.0 * xx).sqrt(), (12.0 * yy).sqrt());
            self.add(sums, footprint.at, sides, 1.0, &mut sum)?;
            return Some(sum);
        }
        // A parallelogram with two upright sides, in slices.
        let slope = xy / xx;
        let (width, rest) = ((12.0 * xx).sqrt(), (yy - slope * xy).max(1e-5));
        let count = (1.0 + slope.abs() * (xx / rest).sqrt()).ceil().min(MOST_SLICES);
        let part = 1.0 / count;
        let height = (12.0 * (rest + slope * xy * part * part)).sqrt();
        for k in 0..count as usize {
            let x = width * ((k as f64 + 0.5) * part - 0.5);
            let at = footprint.at + DVec2::new(x, x * slope);
            self.add(sums, at, DVec2::new(width * part, height), part as f32, &mut sum)?;
        }
        Some(sum)
    }

    /// Adds `scale` times what the means over a rectangle about `at` are above [`Keyframe::means`].
    #[inline(always)]
    fn add<const P: usize>(
        &self,
        sums: &[[f32; 4]],
        at: DVec2,
        sides: DVec2,
        scale: f32,
        out: &mut [[f32; 4]; P],
    ) -> Option<()> {
        let (low, high) = (at - 0.5 * sides, at + 0.5 * sides);
        // In cells from the middle of the first one.
        let place = |v: f64, k: usize| (v - self.first[k]) * self.density;
        let spline = |x: f64| {
            let k = x as i32 as usize;
            let w = (x - k as f64) as f32;
            (k, [0.5 * (1.0 - w) * (1.0 - w), 0.5 + w - w * w, 0.5 * w * w])
        };
        let ([x0, x1], [y0, y1]) = ([place(low.x, 0), place(high.x, 0)], [place(low.y, 1), place(high.y, 1)]);
        // Three sums from the one before, of `stride` and of `rows` + 1.
        let inside = x0 >= 0.0 && y0 >= 0.0 && x1 < (self.stride - 2) as f64 && y1 < (self.rows - 1) as f64;
        if !inside {
            return None;
        }
        let ((left, a), (right, b)) = (spline(x0), spline(x1));
        let scale = scale / ((x1 - x0) * (y1 - y0)) as f32;
        let plane = self.stride * (self.rows + 1);
        for (y, sign) in [(y0, -scale), (y1, scale)] {
            let (row, c) = spline(y);
            for (j, c) in c.into_iter().enumerate() {
                let c = c * sign;
                for (number, out) in out.iter_mut().enumerate() {
                    let from = self.start + number * plane + (row + j) * self.stride;
                    let (p, q) = (&sums[from + left..from + left + 3], &sums[from + right..from + right + 3]);
                    for k in 0..4 {
                        let upto = b[0] * q[0][k] + b[1] * q[1][k] + b[2] * q[2][k];
                        let before = a[0] * p[0][k] + a[1] * p[1][k] + a[2] * p[2][k];
                        out[k] += c * (upto - before);
                    }
                }
            }
        }
        Some(())
    }
}

/// Second moments on the screen of texels' own blur, of these variances along their axes, where texels change by `change`, and of
/// straight lines between cells, which add a sixth of their squares.
fn blur(change: &DMat2, [bx, by]: [f64; 2], density: f64) -> [f64; 3] {
    let inverse = change.inverse();
    let (x, y, cell) = (inverse.x_axis, inverse.y_axis, 1.0 / (6.0 * density * density));
    [
        x.x * x.x * bx + y.x * y.x * by + cell,
        x.x * x.y * bx + y.x * y.y * by,
        x.y * x.y * bx + y.y * y.y * by + cell,
    ]
}

#[cfg(test)]
mod tests {
    use half::f16;

    use super::*;
    use crate::image::texture::Textures;

    /// A texture of noise, 64 by 64 texels.
    fn noise() -> evis_scene::Scene {
        let value =
            |i: u32| f64::from(i.wrapping_mul(747_796_405).rotate_left(13).wrapping_mul(277_803_737) >> 8);
        let texels = (0..64 * 64).map(|i| [f16::from_f64(0.1 + value(i) / f64::from(1 << 24)); 4]).collect();
        let image = evis_scene::Image { name: "noise".into(), width: 64, height: 64, texels };
        let (wrap_u, wrap_v) = (evis_scene::Wrap::Repeat, evis_scene::Wrap::Mirror);
        let texture = evis_scene::Texture { image: 0, wrap_u, wrap_v, nearest: false };
        evis_scene::Scene { images: vec![image], textures: vec![texture], ..Default::default() }
    }

    /// A picture of light that is a texture; parameters of the facet are texels.
    fn picture(
        textures: &Textures,
        texels: DMat3,
        rect: [f64; 4],
        sums: &mut Vec<[f32; 4]>,
    ) -> Option<Keyframe> {
        let places = textures.places(0, 1.0).expect("a texture");
        let shade = |place: [f64; 2], _: f64, out: &mut [[f32; 4]; MOST_PLANES]| out[0] = places.at(place);
        Keyframe::of_light(texels.inverse(), (Some(DMat2::IDENTITY), &[]), rect, 1, sums, shade)
    }

    #[test]
    fn means_from_a_picture_are_those_of_edges() {
        let scene = noise();
        let textures = Textures::new(&scene);
        let (mut squares, mut canary, mut count) = (0.0, 0.0, 0);
        for i in 0..40 {
            let f = f64::from(i);
            // Texels per pixel, turned, sheared, with some perspective.
            let (size, turn) = (0.2 + 0.025 * f, 0.37 * f);
            let (s, c) = turn.sin_cos();
            let texels = DMat3::from_cols(
                DVec3::new(size * c, size * s, 0.004),
                DVec3::new(-1.3 * size * s, 1.1 * size * c, -0.003),
                DVec3::new(2.3 * f, 5.0 - 1.1 * f, 1.0),
            );
            let mut sums = Vec::new();
            let picture = picture(&textures, texels, [-6.0, -6.0, 6.0, 6.0], &mut sums).expect("few cells");
            // Time went on: the screen lies a little turned, moved and grown on the picture.
            let (s, c) = (0.03 * (f - 20.0) / 20.0).sin_cos();
            let warp = DMat3::from_cols(
                DVec3::new(1.02 * c, s, 1e-3),
                DVec3::new(-s, 0.99 * c, 5e-4),
                DVec3::new(0.4, -0.7, 1.0),
            );
            for k in 0..25 {
                let at = DVec2::new(f64::from(k % 5) * 1.9 - 4.0, f64::from(k / 5) * 1.8 - 3.5);
                // A whole pixel, and a part of one.
                let (xx, yy) = if k % 3 == 0 { (1.0 / 12.0, 0.02) } else { (1.0 / 12.0, 1.0 / 12.0) };
                let footprint = Footprint::under(&warp, at, [xx, 0.0, yy]).expect("before the horizon");
                let found = picture.means::<1>(&sums, &footprint).expect("in the picture")[0][0];
                let exact = |at: DVec2, sides: [f64; 2]| {
                    let all = texels * warp;
                    let h = all * DVec3::new(at.x, at.y, 1.0);
                    let place = DVec2::new(h.x, h.y) / h.z;
                    let axis = |c: DVec3, l: f64| ((DVec2::new(c.x, c.y) - place * c.z) / h.z * l).to_array();
                    let axes = [axis(all.x_axis, sides[0]), axis(all.y_axis, sides[1])];
                    textures.mean(0, place.to_array(), axes)[0]
                };
                let sides = [(12.0 * xx).sqrt(), (12.0 * yy).sqrt()];
                let error = |exact: f32| f64::from(found / exact - 1.0).powi(2);
                squares += error(exact(at, sides));
                canary += error(exact(at + DVec2::new(0.3, 0.0), sides));
                count += 1;
            }
        }
        let [rms, canary] = [squares, canary].map(|v| (v / f64::from(count)).sqrt());
        println!("relative error {rms:.4} over {count} footprints, {canary:.4} at 0.3 px aside");
        assert!(rms < 0.012, "{rms}");
        assert!(canary > 3.0 * rms && canary > 0.03, "{canary}");
    }

    #[test]
    fn what_lies_outside_of_a_picture_is_not_answered() {
        let scene = noise();
        let textures = Textures::new(&scene);
        let mut sums = Vec::new();
        let new = |side: f64, sums: &mut Vec<_>| {
            picture(&textures, DMat3::IDENTITY, [-side, -side, side, side], sums)
        };
        assert!(new(60.0, &mut sums).is_none(), "too many cells");
        assert!(sums.is_empty());
        let picture = new(2.0, &mut sums).expect("few cells");
        let at = |x: f64, y: f64| {
            let moments = [1.0 / 12.0, 0.0, 1.0 / 12.0];
            picture.means::<1>(&sums, &Footprint { at: DVec2::new(x, y), moments })
        };
        assert!(at(1.4, -1.4).is_some());
        for (x, y) in [(1.9, 0.0), (-1.9, 0.0), (0.0, 1.9), (0.0, -1.9), (f64::NAN, 0.0), (1e300, 0.0)] {
            assert!(at(x, y).is_none(), "{x} {y}");
        }
    }
}
