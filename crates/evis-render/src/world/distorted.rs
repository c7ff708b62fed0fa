//! Cameras with a distorted lens: the pinhole picture that is rendered for them, and which of its samples lie in which
//! pixel.
//!
//! A rasteriser draws straight lines straight. So a picture without distortion is drawn, at least as dense everywhere as
//! the camera's own, and every sample of it is projected through the lens: a pixel is the mean of the samples that fall
//! into it, which is the box filter over the pixel's own, bent footprint.

use evis_scene::{CalibratedLens, SceneError};
use glam::{DMat2, DVec2, DVec3};
use rayon::prelude::*;

use crate::world::view::PixelLens;

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

/// The samples that are rendered of a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct PictureSamples {
    /// In every texel.
    pub places: Vec<SamplePlace>,
    /// Texels along each side of a pixel.
    pub grid: u32,
    /// Bits of a texel's x and y in an entry.
    pub edge_bits: u32,
    /// Width and height of the area over which a sample reads textures, in pixels of the picture.
    pub cell: [f64; 2],
}

/// Second moments of the area of a pixel.
const BOX: DMat2 = DMat2::from_cols_array(&[1.0 / 12.0, 0.0, 0.0, 1.0 / 12.0]);

/// Where a sample lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SamplePlace {
    /// From the upper left corner of the texel, in texels.
    pub within: [f64; 2],
    /// The layer, or the number of the coverage sample.
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
        };
        Ok(Self { lens, size, picture })
    }

    /// Where the camera shows what lies at `at` in the rendered picture.
    pub fn pixel(&self, at: [f64; 2]) -> Option<DVec2> {
        let PixelLens { focal, center, .. } = &self.picture;
        self.lens.project(DVec3::new((at[0] - center[0]) / focal[0], (center[1] - at[1]) / focal[1], -1.0))
    }

    /// Where in the rendered picture the camera sees its own `pixel`.
    pub fn source(&self, pixel: DVec2) -> Option<[f64; 2]> {
        let seen = self.lens.unproject(pixel)?;
        self.picture.project(seen)
    }

    /// The samples of every pixel. A pixel that the lens shows nothing in has none.
    pub fn footprints(&self, rendered: &PictureSamples) -> Footprints {
        let PictureSamples { ref places, grid, edge_bits, cell } = *rendered;
        let [width, height] = self.size;
        let columns = self.picture.width * grid;
        let found = |y: u32| {
            let mut row = Vec::new();
            for (x, place) in (0..columns).flat_map(|x| places.iter().map(move |place| (x, place))) {
                let texel = [f64::from(x) + place.within[0], f64::from(y) + place.within[1]];
                let Some(at) = self.pixel(texel.map(|v| v / f64::from(grid))) else { continue };
                let inside = at.x >= 0.0 && at.y >= 0.0 && at.x < width.into() && at.y < height.into();
                if inside {
                    let (i, j) = (at.x as u32, at.y as u32);
                    let off = [at.x - f64::from(i) - 0.5, at.y - f64::from(j) - 0.5].map(|v| v as f32);
                    row.push((j * width + i, pack(x, y, place.index, edge_bits), off));
                }
            }
            row
        };
        let rows: Vec<Vec<(u32, u32, [f32; 2])>> =
            (0..self.picture.height * grid).into_par_iter().map(found).collect();
        let pixels = width as usize * height as usize;
        let mut starts = vec![0_u32; pixels + 1];
        for (pixel, ..) in rows.iter().flatten() {
            starts[*pixel as usize + 1] += 1;
        }
        for p in 0..pixels {
            starts[p + 1] += starts[p];
        }
        let mut next = starts.clone();
        let mut samples = vec![(0, [0.0; 2]); starts[pixels] as usize];
        for (pixel, texel, off) in rows.iter().flatten() {
            let slot = &mut next[*pixel as usize];
            samples[*slot as usize] = (*texel, *off);
            *slot += 1;
        }
        drop(rows);
        let mut footprints = Footprints { starts: vec![0], entries: Vec::with_capacity(samples.len()) };
        for p in 0..pixels {
            let own = &samples[starts[p] as usize..starts[p + 1] as usize];
            if own.is_empty() {
                let center = DVec2::new((p as u32 % width).into(), (p as u32 / width).into()) + 0.5;
                footprints.entries.extend(self.nearest(center, grid, places, edge_bits));
            } else {
                let center = DVec2::new((p as u32 % width).into(), (p as u32 / width).into()) + 0.5;
                let spread = BOX - self.cell_spread(center, cell);
                let weights = weights(own.iter().map(|(_, off)| *off), spread);
                footprints
                    .entries
                    .extend(own.iter().zip(weights).map(|((texel, _), w)| [*texel, w.to_bits()]));
            }
            footprints.starts.push(footprints.entries.len() as u32);
        }
        footprints
    }

    /// The second moments, in pixels of the camera, of the area of the picture over which a sample reads textures: `cell`
    /// pixels of it, around `pixel`.
    fn cell_spread(&self, pixel: DVec2, cell: [f64; 2]) -> DMat2 {
        let Some((_, [dx, dy])) = self.lens.planar_ray(pixel) else { return DMat2::ZERO };
        let scale = DVec2::new(self.picture.focal[0], -self.picture.focal[1]);
        let picture_per_pixel = DMat2::from_cols(scale * dx, scale * dy);
        let side = picture_per_pixel.inverse() * DMat2::from_diagonal(cell.into());
        side * side.transpose() * (1.0 / 12.0)
    }

    /// The first sample of the texel at a pixel's centre: what a pixel sees that no sample has met.
    fn nearest(&self, center: DVec2, grid: u32, places: &[SamplePlace], edge_bits: u32) -> Option<[u32; 2]> {
        let [x, y] = self.source(center)?.map(|v| (v * f64::from(grid)).max(0.0) as u32);
        let (x, y) = (x.min(self.picture.width * grid - 1), y.min(self.picture.height * grid - 1));
        places.first().map(|place| [pack(x, y, place.index, edge_bits), 1.0_f32.to_bits()])
    }
}

/// The largest singular value.
fn largest_scale(m: DMat2) -> f64 {
    let (a, b) = (m.x_axis.length_squared(), m.y_axis.length_squared());
    let mean = 0.5 * (a + b);
    let spread = (0.5 * (a - b)).hypot(m.x_axis.dot(m.y_axis));
    (mean + spread).sqrt()
}

/// Weights of samples `off` from the centre of their pixel: as equal as can be where their sum is 1, their mean place the
/// centre, and their second moments `spread`. An edge then passes at the time at which it passes the pixel, and textures keep
/// the contrast that they have in the box of a pixel, wherever the samples happen to lie.
///
/// A sample is the mean of a texture over an area, so that the filter of a pixel is that of the weights, made wider by the area:
/// `spread` is what the box has beyond it.
fn weights(off: impl ExactSizeIterator<Item = [f32; 2]> + Clone, spread: DMat2) -> Vec<f32> {
    let count = off.len() as f64;
    let places = off.map(|o| DVec2::new(o[0].into(), o[1].into()));
    let terms = |p: DVec2| [1.0, p.x, p.y, p.x * p.x, p.x * p.y, p.y * p.y];
    let wanted = [1.0, 0.0, 0.0, spread.x_axis.x, spread.x_axis.y, spread.y_axis.y];
    // Beside too few samples, or samples on a line, fewer moments are asked for.
    for (used, least) in [(6, LEAST_WEIGHT), (3, 0.0)] {
        let mut moments = [[0.0; 7]; 6];
        for place in places.clone() {
            let terms = terms(place);
            for (row, a) in moments.iter_mut().zip(terms) {
                row.iter_mut().zip(terms).for_each(|(sum, b)| *sum += a * b / count);
            }
        }
        for (row, wanted) in moments.iter_mut().zip(wanted) {
            row[used] = wanted;
        }
        let Some(solution) = solved(&mut moments, used) else { continue };
        let weight = |p: DVec2| terms(p).iter().zip(&solution).map(|(t, s)| t * s).sum::<f64>();
        let own: Vec<f64> = places.clone().map(weight).collect();
        if own.iter().all(|w| *w > least) {
            return own.into_iter().map(|w| (w / count) as f32).collect();
        }
    }
    vec![(1.0 / count) as f32; places.len()]
}

/// A sample's weight over that of equal ones, at least.
const LEAST_WEIGHT: f64 = -0.5;

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
        let places = (0..n * n).map(|i| SamplePlace { within: [at(i % n), at(i / n)], index: i }).collect();
        PictureSamples { places, grid: 1, edge_bits: EDGE_BITS, cell: [1.0 / f64::from(n); 2] }
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
    fn every_pixel_has_samples_around_its_own_centre() {
        let camera = distorted("radtan", &[-0.3, 0.1, 1e-3, -1e-3]);
        let samples = grid(4);
        let footprints = camera.footprints(&samples);
        assert_eq!(footprints.starts.len(), 64 * 48 + 1);
        let mean = |p: usize, weighted: bool| {
            let own = &footprints.entries[footprints.starts[p] as usize..footprints.starts[p + 1] as usize];
            assert!(own.len() >= 9, "{p}: {}", own.len());
            let mut sum = (0.0, DVec2::ZERO);
            for [texel, bits] in own {
                let (x, y, s) = (texel & 0xFFF, texel >> 12 & 0xFFF, texel >> 24);
                let within = samples.places[s as usize].within;
                let at = camera.pixel([f64::from(x) + within[0], f64::from(y) + within[1]]).unwrap();
                let weight = if weighted { f64::from(f32::from_bits(*bits)) } else { 1.0 / own.len() as f64 };
                sum = (sum.0 + weight, sum.1 + at * weight);
            }
            sum
        };
        let mut worst = [0.0_f64; 2];
        for p in 0..64 * 48 {
            let center = DVec2::new((p % 64) as f64, (p / 64) as f64) + 0.5;
            for (worst, weighted) in worst.iter_mut().zip([true, false]) {
                let (sum, at) = mean(p, weighted);
                assert!((sum - 1.0).abs() < 1e-6);
                *worst = worst.max(at.distance(center));
            }
        }
        assert!(worst[0] < 1e-5, "{worst:?}");
        assert!(worst[1] > 0.01, "canary: equal weights {worst:?}");
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
