//! Cameras with a distorted lens: the pinhole picture that is rendered for them, and which of its samples lie in which
//! pixel.
//!
//! A rasteriser draws straight lines straight. So a picture without distortion is drawn, at least as dense everywhere as
//! the camera's own, and every sample of it is projected through the lens: a pixel is the mean of the samples that fall
//! into it, which is the box filter over the pixel's own, bent footprint.

use std::ops::Range;

use evis_scene::{CalibratedLens, LensModel, PixelLens, Rays, SceneError};
use glam::{DMat2, DVec2, Vec2};
use rayon::prelude::*;

/// The widest field of view that one pinhole picture serves, in degrees: beyond it the picture grows without bound.
const WIDEST_DEGREES: f64 = 150.0;

/// Pixels around the rendered picture, for samples whose places in their pixels differ.
const MARGIN_PX: f64 = 1.0;

/// The largest edge of a rendered picture: a sample's place in it takes 12 or 13 bits.
const LARGEST_EDGE: f64 = 4096.0;

/// A camera with a distorted lens.
#[derive(Clone, Debug, PartialEq)]
pub struct Distorted {
    /// Its lens.
    pub lens: CalibratedLens,
    /// Pixels per row, and rows.
    pub size: [u32; 2],
    /// The picture without distortion.
    pub picture: PixelLens,
}

/// The samples that are rendered of a picture: each stands for a cell of it, and the cells tile it.
#[derive(Clone, Debug, PartialEq)]
pub struct PictureSamples {
    /// In every texel.
    pub cells: Vec<Cell>,
    /// Texels along each side of a pixel.
    pub grid: u32,
    /// Bits of a texel's x and y in an entry.
    pub edge_bits: u32,
    /// Width and height of a cell, in pixels of the picture.
    pub size: [f64; 2],
}

/// Second moments of the area of a pixel.
const BOX: DMat2 = DMat2::from_cols_array(&[1.0 / 12.0, 0.0, 0.0, 1.0 / 12.0]);

/// A cell of a texel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Its middle, from the upper left corner of the texel, in texels.
    pub middle: [f64; 2],
    /// The layer that has its sample.
    pub index: u32,
}

/// The samples of every pixel: pixel p has the entries from `starts[p]` up to `starts[p + 1]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Footprints {
    /// One more than there are pixels.
    pub starts: Vec<u32>,
    /// Texel and layer, packed ([`pack`]), and the bits of the weight. The weights of a pixel have the sum 1, and the
    /// weighted mean of its samples' places is the pixel's centre.
    pub entries: Vec<[u32; 2]>,
}

impl Footprints {
    /// The same in bands of rows, each with at most `most_bytes` of entries: the band's first row and its starts, and where its
    /// entries are. `None` where one row has more.
    pub fn bands(&self, width: u32, most_bytes: u64) -> Option<Vec<(Vec<u32>, Range<usize>)>> {
        let (width, most) = (width as usize, (most_bytes / 8) as usize);
        let rows = (self.starts.len() - 1) / width;
        let at = |row: usize| self.starts[row * width] as usize;
        let mut bands = Vec::new();
        let mut first = 0;
        while first < rows {
            let fitting = (first + 1..=rows).take_while(|&end| at(end) - at(first) <= most).last()?;
            let own =
                self.starts[first * width..=fitting * width].iter().map(|start| start - at(first) as u32);
            bands.push((std::iter::once(first as u32).chain(own).collect(), at(first)..at(fitting)));
            first = fitting;
        }
        Some(bands)
    }
}

/// Bits of a texel's x and y in an entry; the layer has the others.
pub const EDGE_BITS: u32 = 12;

/// A texel of a picture whose texels are `1 / grid` pixels wide, and a layer, in one word.
pub const fn pack(x: u32, y: u32, index: u32, edge_bits: u32) -> u32 {
    x | y << edge_bits | index << (2 * edge_bits)
}

impl Distorted {
    /// The picture that serves `lens` with `size` pixels, for camera `name`. Along each side, a pixel of the camera meets at
    /// least `density` of its pixels, or as many as a large picture can have.
    ///
    /// # Errors
    /// A lens too wide for one picture.
    pub fn new(
        name: &str,
        lens: CalibratedLens,
        size: [u32; 2],
        near: f64,
        density: f64,
    ) -> Result<Self, SceneError> {
        let refuse = |text: String| SceneError::Rule(format!("camera '{name}': {text}"));
        let corners: Vec<DVec2> =
            (0..=size[1]).flat_map(|y| (0..=size[0]).map(move |x| DVec2::new(x.into(), y.into()))).collect();
        // Of every corner of a pixel: where a plane at distance 1 is seen, and how many pixels it moves per unit of it.
        let seen: Vec<(DVec2, f64)> = corners
            .par_iter()
            .filter_map(|corner| {
                let seen = lens.unproject(*corner)?;
                let angle = (-seen.z).acos();
                if angle > 0.5 * WIDEST_DEGREES.to_radians() {
                    return Some((DVec2::NAN, angle));
                }
                let ray = seen / -seen.z;
                let (_, [dx, dy, _]) = lens.project_with_jacobian(ray)?;
                Some((ray.truncate(), largest_scale(DMat2::from_cols(dx, dy))))
            })
            .collect();
        let widest = seen.iter().filter(|(at, _)| at.is_nan()).map(|(_, angle)| *angle).fold(0.0, f64::max);
        if widest > 0.0 {
            return Err(refuse(format!(
                "its lens sees {:.0} degrees from its axis; a rendered lens sees {:.0} degrees at most, a field of view of \
                 {WIDEST_DEGREES:.0}: choose a smaller picture or a longer focal length",
                widest.to_degrees(),
                0.5 * WIDEST_DEGREES
            )));
        }
        if seen.is_empty() {
            return Err(refuse(
                "its lens sees nothing in the picture; check its intrinsics and distortion".into(),
            ));
        }
        let focal = seen.iter().map(|(_, scale)| *scale).fold(0.0, f64::max);
        let low = seen.iter().fold(DVec2::INFINITY, |low, (at, _)| low.min(*at));
        let high = seen.iter().fold(DVec2::NEG_INFINITY, |high, (at, _)| high.max(*at));
        let largest = (high - low).max_element() * focal + 2.0 * MARGIN_PX + 1.0;
        let focal = focal * density.min(LARGEST_EDGE / largest).max(1.0);
        // y points up in the scene and down in the picture.
        let center = DVec2::new(-low.x, high.y) * focal + MARGIN_PX;
        let extent = ((high - low) * focal + 2.0 * MARGIN_PX).ceil();
        if extent.max_element() > LARGEST_EDGE {
            return Err(refuse(format!(
                "its distortion takes a picture of {}x{} pixels without it; {LARGEST_EDGE} along each edge is the most: \
                 choose a smaller picture or a narrower field of view",
                extent.x, extent.y
            )));
        }
        let picture = PixelLens {
            width: extent.x as u32,
            height: extent.y as u32,
            focal: [focal; 2],
            center: center.into(),
            near,
            rays: Rays::Central,
        };
        Ok(Self { lens, size, picture })
    }

    /// Where the camera shows what lies at `at` in the rendered picture.
    pub fn pixel(&self, at: [f64; 2]) -> Option<DVec2> {
        self.lens.project(self.picture.pinhole().ray(at.into()))
    }

    /// Where in the rendered picture the camera sees its own `pixel`.
    pub fn source(&self, pixel: DVec2) -> Option<[f64; 2]> {
        let seen = self.lens.unproject(pixel)?;
        self.picture.pinhole().project(seen).map(Into::into)
    }

    /// The samples of every pixel. A pixel that the lens shows nothing in has none.
    pub fn footprints(&self, rendered: &PictureSamples) -> Footprints {
        let PictureSamples { ref cells, grid, edge_bits, size } = *rendered;
        let [width, height] = self.size;
        let columns = self.picture.width * grid;
        let found = |y: u32| {
            let mut row = Vec::new();
            for (x, cell) in (0..columns).flat_map(|x| cells.iter().map(move |cell| (x, cell))) {
                let texel = [f64::from(x) + cell.middle[0], f64::from(y) + cell.middle[1]];
                let Some((at, spread)) = self.cell(texel.map(|v| v / f64::from(grid)), size) else {
                    continue;
                };
                let packed = pack(x, y, cell.index, edge_bits);
                let [across, down] = [spread.x_axis.x, spread.y_axis.y].map(|moment| (3.0 * moment).sqrt());
                for (j, part_y) in overlaps(at.y, down, height) {
                    for (i, part_x) in overlaps(at.x, across, width) {
                        let off = at - DVec2::new(i.into(), j.into()) - 0.5;
                        let (off, area) = (off.as_vec2(), (part_x * part_y) as f32);
                        row.push((j * width + i, CellPart { packed, off, area }));
                    }
                }
            }
            row
        };
        let rows: Vec<Vec<(u32, CellPart)>> =
            (0..self.picture.height * grid).into_par_iter().map(found).collect();
        let pixels = width as usize * height as usize;
        let mut starts = vec![0_usize; pixels + 1];
        for (pixel, _) in rows.iter().flatten() {
            starts[*pixel as usize + 1] += 1;
        }
        for p in 0..pixels {
            starts[p + 1] += starts[p];
        }
        let mut next = starts.clone();
        let none = CellPart { packed: 0, off: Vec2::ZERO, area: 0.0 };
        let mut parts = vec![none; starts[pixels]];
        for (pixel, part) in rows.into_iter().flatten() {
            let slot = &mut next[pixel as usize];
            parts[*slot] = part;
            *slot += 1;
        }
        let weighted = |p: usize| {
            let own = &parts[starts[p]..starts[p + 1]];
            let center = DVec2::new((p as u32 % width).into(), (p as u32 / width).into()) + 0.5;
            let cell = self.source(center).and_then(|at| self.cell(at, size));
            let spread = BOX - cell.map_or(DMat2::ZERO, |(_, spread)| spread);
            let entry = |(part, weight): (&CellPart, f32)| [part.packed, weight.to_bits()];
            own.iter().zip(weights(own, spread)).map(entry).collect::<Vec<_>>()
        };
        let entries: Vec<Vec<[u32; 2]>> = (0..pixels).into_par_iter().map(weighted).collect();
        let ends = entries.iter().scan(0, |end, own| {
            *end += own.len() as u32;
            Some(*end)
        });
        Footprints { starts: std::iter::once(0).chain(ends).collect(), entries: entries.concat() }
    }

    /// Where the camera shows the middle of a cell of `size` at `at`, and the second moments of the cell there, in its pixels.
    fn cell(&self, at: [f64; 2], size: [f64; 2]) -> Option<(DVec2, DMat2)> {
        let focal = self.picture.focal;
        let ray = self.picture.pinhole().ray(at.into());
        let (pixel, [dx, dy, _]) = self.lens.project_with_jacobian(ray)?;
        let sides = DMat2::from_cols(dx * (size[0] / focal[0]), dy * (size[1] / focal[1]));
        Some((pixel, sides * sides.transpose() * (1.0 / 12.0)))
    }
}

/// The part of a cell that lies in a pixel.
#[derive(Clone, Copy)]
struct CellPart {
    packed: u32,
    /// From the pixel's centre to the cell's.
    off: Vec2,
    /// The part of the cell's area that lies in the pixel.
    area: f32,
}

/// The pixels below `count` along an axis that an interval meets, from `middle` so far to both sides, and which part of it
/// each has.
fn overlaps(middle: f64, half: f64, count: u32) -> impl Iterator<Item = (u32, f64)> {
    let (low, high) = (middle - half, middle + half);
    let first = low.floor().max(0.0) as u32;
    let end = (high.ceil().max(0.0) as u32).min(count);
    (first..end).filter_map(move |i| {
        let part = (high.min(f64::from(i) + 1.0) - low.max(f64::from(i))) / (2.0 * half);
        (part > 0.0).then_some((i, part))
    })
}

/// The largest singular value.
fn largest_scale(m: DMat2) -> f64 {
    let (a, b) = (m.x_axis.length_squared(), m.y_axis.length_squared());
    let mean = 0.5 * (a + b);
    let spread = (0.5 * (a - b)).hypot(m.x_axis.dot(m.y_axis));
    (mean + spread).sqrt()
}

/// Weights of the cells of a pixel: as near to their parts in it as can be where their sum is 1, their mean place the centre,
/// and their second moments `spread`: those of a box, less those of a cell. An edge then passes at the time at which it passes
/// the pixel, and a texture keeps the contrast that the box leaves it, wherever the cells happen to lie.
fn weights(parts: &[CellPart], spread: DMat2) -> Vec<f32> {
    let total: f64 = parts.iter().map(|part| f64::from(part.area)).sum();
    let wanted = [1.0, 0.0, 0.0, spread.x_axis.x, spread.x_axis.y, spread.y_axis.y];
    let share = |part: &CellPart| f64::from(part.area) / total;
    let terms = |part: &CellPart| {
        let p = part.off.as_dvec2();
        [1.0, p.x, p.y, p.x * p.x, p.x * p.y, p.y * p.y]
    };
    // Of few cells, or cells on a line, fewer moments are asked for.
    for used in [6, 3] {
        let mut moments = [[0.0; 7]; 6];
        for part in parts {
            let terms = terms(part);
            for (row, a) in moments.iter_mut().zip(terms) {
                row.iter_mut().zip(terms).for_each(|(sum, b)| *sum += a * b * share(part));
            }
        }
        for (row, wanted) in moments.iter_mut().zip(wanted) {
            row[used] = wanted;
        }
        let Some(solution) = solved(&mut moments, used) else { continue };
        let factor = |part| terms(part).iter().zip(&solution).map(|(t, s)| t * s).sum::<f64>();
        let factors: Vec<f64> = parts.iter().map(factor).collect();
        if factors.iter().all(|factor| *factor > LEAST_FACTOR) {
            return factors.iter().zip(parts).map(|(f, part)| (f * share(part)) as f32).collect();
        }
    }
    parts.iter().map(|part| share(part) as f32).collect()
}

/// What a cell's part is multiplied by, at least: far below 0 it would ring.
const LEAST_FACTOR: f64 = -0.5;

/// The solution of `n` equations, whose right sides stand in column `n` (Gaussian elimination with pivots); `None` where they
/// are nearly dependent.
fn solved(rows: &mut [[f64; 7]; 6], n: usize) -> Option<[f64; 6]> {
    for k in 0..n {
        let pivot = (k..n).max_by(|&a, &b| rows[a][k].abs().total_cmp(&rows[b][k].abs()))?;
        rows.swap(k, pivot);
        let row = rows[k];
        if row[k].abs() < 1e-6 {
            return None;
        }
        for other in (0..n).filter(|other| *other != k) {
            let factor = rows[other][k] / row[k];
            rows[other].iter_mut().zip(row).for_each(|(value, own)| *value -= factor * own);
        }
    }
    let mut solution = [0.0; 6];
    (0..n).for_each(|k| solution[k] = rows[k][n] / rows[k][k]);
    Some(solution)
}

#[cfg(test)]
mod tests {
    use evis_scene::Distortion;

    use super::*;

    fn distorted(model: &str, coefficients: &[f64]) -> Distorted {
        let distortion = Distortion::from_coefficients(model, coefficients).unwrap();
        let lens = CalibratedLens::new([60.0, 58.0], [33.0, 23.0], Some(distortion)).unwrap();
        Distorted::new("eye", lens, [64, 48], 0.1, 1.0).unwrap()
    }

    fn grid(n: u32) -> PictureSamples {
        let at = |i: u32| (f64::from(i) + 0.5) / f64::from(n);
        let cells = (0..n * n).map(|i| Cell { middle: [at(i % n), at(i / n)], index: i }).collect();
        PictureSamples { cells, grid: 1, edge_bits: EDGE_BITS, size: [1.0 / f64::from(n); 2] }
    }

    #[test]
    fn the_picture_is_nowhere_coarser_than_the_camera() {
        for camera in [distorted("radtan", &[-0.3, 0.1, 1e-3, -1e-3]), distorted("fisheye", &[0.03, -0.01])] {
            let far = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
            let mut least = f64::INFINITY;
            for (x, y) in (0..48).flat_map(|y| (0..64).map(move |x| (x, y))) {
                let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
                let here = camera.source(pixel).unwrap();
                assert!(camera.pixel(here).unwrap().distance(pixel) < 1e-7);
                for way in [DVec2::X, DVec2::Y, DVec2::new(0.6, 0.8)] {
                    least = least.min(far(here, camera.source(pixel + way * 1e-3).unwrap()) * 1e3);
                }
                let inside = here[0] > 0.0 && here[1] > 0.0;
                assert!(
                    inside && here[0] < camera.picture.width.into() && here[1] < camera.picture.height.into()
                );
            }
            assert!((0.99..1.1).contains(&least), "{least}: neither coarser nor much finer than it must be");
        }
    }

    #[test]
    fn footprints_have_the_moments_of_their_pixels() {
        let camera = distorted("radtan", &[-0.3, 0.1, 1e-3, -1e-3]);
        let samples = grid(4);
        let footprints = camera.footprints(&samples);
        assert_eq!(footprints.starts.len(), 64 * 48 + 1);
        // Largest errors of the sum, the mean place and the second moments, by the weights and by equal ones.
        let mut worst = [[0.0_f64; 3]; 2];
        for p in 0..64 * 48 {
            let own = &footprints.entries[footprints.starts[p] as usize..footprints.starts[p + 1] as usize];
            assert!(own.len() >= 9, "{p}: {}", own.len());
            let center = DVec2::new((p % 64) as f64, (p / 64) as f64) + 0.5;
            for (worst, weighted) in worst.iter_mut().zip([true, false]) {
                let (mut sum, mut mean, mut spread) = (0.0, DVec2::ZERO, DMat2::ZERO);
                for [texel, bits] in own {
                    let (x, y, s) = (texel & 0xFFF, texel >> 12 & 0xFFF, texel >> 24);
                    let middle = samples.cells[s as usize].middle;
                    let (at, cell) = camera
                        .cell([f64::from(x) + middle[0], f64::from(y) + middle[1]], samples.size)
                        .unwrap();
                    let off = at - center;
                    let weight =
                        if weighted { f64::from(f32::from_bits(*bits)) } else { 1.0 / own.len() as f64 };
                    sum += weight;
                    mean += off * weight;
                    spread += (DMat2::from_cols(off * off.x, off * off.y) + cell) * weight;
                }
                let moments =
                    (spread - BOX).to_cols_array().into_iter().fold(0.0, |m: f64, v| m.max(v.abs()));
                for (worst, error) in worst.iter_mut().zip([(sum - 1.0).abs(), mean.length(), moments]) {
                    *worst = worst.max(error);
                }
            }
        }
        // Cells of a pixel differ by parts in a thousand.
        assert!(worst[0][0] < 1e-6 && worst[0][1] < 1e-5 && worst[0][2] < 1e-3, "{worst:?}");
        assert!(worst[1][1] > 0.01 && worst[1][2] > 0.01, "canary: equal weights {worst:?}");
    }

    #[test]
    fn bands_hold_every_entry_once() {
        let footprints = distorted("fisheye", &[0.01]).footprints(&grid(2));
        let whole = footprints.bands(64, u64::MAX).unwrap();
        assert_eq!((whole.len(), whole[0].1.clone()), (1, 0..footprints.entries.len()));
        let bands = footprints.bands(64, 8 * 3000).unwrap();
        assert!(bands.len() > 5);
        let (mut row, mut entry) = (0, 0);
        for (starts, range) in &bands {
            assert_eq!((starts[0], range.start), (row, entry));
            assert!(range.len() <= 3000 && *starts.last().unwrap() as usize == range.len());
            row += (starts.len() as u32 - 2) / 64;
            entry = range.end;
        }
        assert_eq!((row, entry), (48, footprints.entries.len()));
        assert_eq!(footprints.bands(64, 8), None);
    }

    #[test]
    fn a_lens_too_wide_for_one_picture_is_refused_with_the_limit() {
        let fisheye = Distortion::from_coefficients("fisheye", &[]).unwrap();
        let new = |focal: f64| {
            let lens = CalibratedLens::new([focal; 2], [32.0, 24.0], Some(fisheye)).unwrap();
            Distorted::new("wide", lens, [64, 48], 0.1, 1.0)
        };
        let error = new(20.0).unwrap_err().to_string();
        assert!(error.contains("'wide'") && error.contains("150"), "{error}");
        assert!(new(40.0).is_ok());
    }

    #[test]
    fn pixels_outside_of_the_region_of_the_lens_have_no_samples() {
        let barrel = Distortion::from_coefficients("radtan", &[-0.4]).unwrap();
        let lens = CalibratedLens::new([30.0; 2], [32.0, 24.0], Some(barrel)).unwrap();
        let camera = Distorted::new("eye", lens, [64, 48], 0.1, 1.0).unwrap();
        let footprints = camera.footprints(&grid(3));
        let count = |x: usize, y: usize| footprints.starts[y * 64 + x + 1] - footprints.starts[y * 64 + x];
        assert_eq!(count(0, 0), 0);
        assert!(count(32, 24) > 4);
    }
}
