//! What each tile of pixels sees of the picture without distortion.
//!
//! Light, shadows and coverage are found where straight lines are straight. A pinhole's tiles lie side by side on its picture.
//! A distorted lens bends a tile by far less than a pixel beyond what a projective map does, so each tile has a map of its
//! own, which is to say a pinhole of its own: image points are linear in space, and stay so under it. What is left of the
//! bending moves pixels, and makes parallelograms of them.

use std::sync::Arc;

use evis_scene::{CalibratedLens, LensModel, PixelLens, Scene, Variant};
use glam::{DMat2, DMat3, DVec2, DVec3};
use rayon::prelude::*;

use crate::Error;
pub use crate::packed::{PIXELS, TILE};

/// Corners of a tile's pixels.
const CORNERS: usize = (TILE + 1) * (TILE + 1);

/// The farthest from its axis that a distorted lens may see, in degrees: the picture without distortion grows without bound.
const WIDEST_DEGREES: f64 = 75.0;
/// What a tile's map may miss a point by, in pixels, where a lens is bent as lenses are.
const MOST_BENT_PX: f64 = 2.0;
/// Corners of pixels that a tile's map is fitted to, at least.
const LEAST_POINTS: usize = 8;
const HALF: f64 = 0.5 * TILE as f64;

/// Centre of pixel number `pixel` of a tile, from the tile's.
fn centre_of(pixel: usize) -> [f64; 2] {
    [pixel % TILE, pixel / TILE].map(|v| v as f64 + 0.5 - 0.5 * TILE as f64)
}

/// How a projective map's image changes to the right and down at (x, y).
pub(crate) fn change(map: &DMat3, [x, y]: [f64; 2]) -> DMat2 {
    let h = *map * DVec3::new(x, y, 1.0);
    let place = DVec2::new(h.x, h.y) / h.z;
    let of = |c: DVec3| (DVec2::new(c.x, c.y) - place * c.z) / h.z;
    DMat2::from_cols(of(map.x_axis), of(map.y_axis))
}

/// Where a tile's map has the middles of its pixels and their corners, row by row, from the tile's centre.
#[derive(Clone, Debug)]
struct Bent {
    pixels: [PixelFrame; PIXELS],
    corners: [[f64; 2]; CORNERS],
}

/// A pixel in its tile. Its own coordinates are x and y in [-1/2, 1/2], to the right and down.
#[derive(Clone, Copy, Debug)]
pub struct PixelFrame {
    /// Its middle, from the tile's centre.
    pub middle: [f64; 2],
    /// What one to the right and one down are in the tile, where that is not the same.
    pub axes: Option<[[f64; 2]; 2]>,
}

impl PixelFrame {
    /// A square pixel.
    pub const fn square(middle: [f64; 2]) -> Self {
        Self { middle, axes: None }
    }

    /// A vector of its own coordinates, in the tile's.
    #[inline(always)]
    pub fn vector(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        match &self.axes {
            None => [x, y],
            Some([right, down]) => [0, 1].map(|k| right[k] * x + down[k] * y),
        }
    }

    /// A place in it, from the tile's centre.
    #[inline(always)]
    pub fn point(&self, at: [f64; 2]) -> [f64; 2] {
        let [x, y] = self.vector(at);
        [self.middle[0] + x, self.middle[1] + y]
    }
}

/// The pixels of a tile, as the picture without distortion has them.
#[derive(Clone, Debug)]
pub struct TileView {
    /// From homogeneous points of that picture to those about the tile's centre, in pixels of the camera.
    map: DMat3,
    /// The way back.
    inverse: DMat3,
    /// Of a lens that is distorted; else it only moves and scales.
    bent: Option<Arc<Bent>>,
    /// How far a pixel's corner lies from where it would be without bending, at most, along either axis and in pixels.
    pub margin: f64,
    /// Box around the tile on that picture: left, top, right, bottom.
    pub rect: [f64; 4],
    /// The camera's pixels per pixel of that picture, at most.
    pub scale: f64,
    /// Pixels in which the lens shows something.
    pub pixels: u64,
}

impl Default for TileView {
    fn default() -> Self {
        Self::of_pinhole([0; 2])
    }
}

/// Left, top, right and bottom of the tile at (column, row) of a pinhole.
pub fn rect(place: [usize; 2]) -> [f64; 4] {
    let [left, top] = place.map(|v| (v * TILE) as f64);
    [left, top, left + TILE as f64, top + TILE as f64]
}

impl TileView {
    /// The tile at (column, row) of a pinhole.
    pub fn of_pinhole(place: [usize; 2]) -> Self {
        let rect = rect(place);
        Self { rect, ..Self::about([rect[0] + HALF, rect[1] + HALF]) }
    }

    /// Pixels about a point of the picture itself.
    fn about([x, y]: [f64; 2]) -> Self {
        Self {
            map: DMat3::from_translation(DVec2::new(-x, -y)),
            inverse: DMat3::from_translation(DVec2::new(x, y)),
            bent: None,
            margin: 0.0,
            rect: [x, y, x, y],
            scale: 1.0,
            pixels: u64::MAX,
        }
    }

    /// The same with squares of `size` pixels in the place of pixels.
    #[inline(always)]
    pub fn in_units_of(&self, size: f64) -> Self {
        let shrink = DMat3::from_diagonal(DVec3::new(1.0 / size, 1.0 / size, 1.0));
        let grow = DMat3::from_diagonal(DVec3::new(size, size, 1.0));
        Self { map: shrink * self.map, inverse: self.inverse * grow, ..self.clone() }
    }

    /// A homogeneous point of the picture without distortion, about the tile's centre.
    #[inline(always)]
    pub fn point(&self, x: f64, y: f64, z: f64) -> DVec3 {
        let m = &self.map;
        if self.bent.is_none() {
            return DVec3::new(m.x_axis.x * x + m.z_axis.x * z, m.y_axis.y * y + m.z_axis.y * z, z);
        }
        DVec3::new(
            m.x_axis.x * x + m.y_axis.x * y + m.z_axis.x * z,
            m.x_axis.y * x + m.y_axis.y * y + m.z_axis.y * z,
            m.x_axis.z * x + m.y_axis.z * y + m.z_axis.z * z,
        )
    }

    /// From homogeneous points of the picture without distortion, about its point `centre`, to those of pixel number `pixel`, and the
    /// way back.
    pub fn pixel_maps(&self, pixel: usize, centre: [f64; 2]) -> [DMat3; 2] {
        let PixelFrame { middle, axes } = self.pixel(pixel);
        let [right, down] = axes.unwrap_or([[1.0, 0.0], [0.0, 1.0]]).map(|v| DVec3::new(v[0], v[1], 0.0));
        let tile_from_pixel = DMat3::from_cols(right, down, DVec3::new(middle[0], middle[1], 1.0));
        let centre = DVec2::from_array(centre);
        let about = [centre, -centre].map(DMat3::from_translation);
        [tile_from_pixel.inverse() * self.map * about[0], about[1] * self.inverse * tile_from_pixel]
    }

    /// Whether its pixels are squares side by side.
    pub fn is_square(&self) -> bool {
        self.bent.is_none()
    }

    /// Where pixel number `pixel` is.
    #[inline(always)]
    pub fn pixel(&self, pixel: usize) -> PixelFrame {
        self.bent.as_ref().map_or_else(|| PixelFrame::square(centre_of(pixel)), |bent| bent.pixels[pixel])
    }

    /// The corner of pixels with `column` of them to its left and `row` above it, from the tile's centre.
    #[inline(always)]
    pub fn corner(&self, column: usize, row: usize) -> [f64; 2] {
        let plain = [column as f64 - HALF, row as f64 - HALF];
        self.bent.as_ref().map_or(plain, |bent| bent.corners[row * (TILE + 1) + column])
    }

    /// The point of the picture without distortion, homogeneous, that lies at (x, y) from the tile's centre.
    pub fn image_point(&self, [x, y]: [f64; 2]) -> DVec3 {
        self.inverse * DVec3::new(x, y, 1.0)
    }

    /// What lies at `depth` has this for the reciprocal of its depth along the tile's own axis: the value at (x, y) from the
    /// tile's centre is the product with (x, y, 1).
    pub fn inverse_of(&self, depth: f64) -> DVec3 {
        self.inverse.row(2) / depth
    }

    /// A line of the picture without distortion as a line about the tile's centre.
    #[inline(always)]
    pub fn line(&self, line: DVec3) -> DVec3 {
        let m = &self.inverse;
        if self.bent.is_none() {
            return DVec3::new(m.x_axis.x * line.x, m.y_axis.y * line.y, m.z_axis.dot(line));
        }
        m.transpose() * line
    }

    /// The way back.
    pub fn image_line(&self, line: DVec3) -> DVec3 {
        self.map.transpose() * line
    }

    /// Whether the tile may meet a box on the picture without distortion.
    pub fn meets(&self, [left, top, right, bottom]: [f64; 4]) -> bool {
        let own = &self.rect;
        left <= own[2] && right >= own[0] && top <= own[3] && bottom >= own[1]
    }
}

/// The tiles of a distorted lens, row by row.
#[derive(Clone, Debug)]
pub struct LensTiles {
    tiles: Vec<TileView>,
    columns: usize,
    /// Box around all of them.
    pub seen: [f64; 4],
}

impl LensTiles {
    /// Those of camera `camera` in `variant`, whose picture without distortion is that of `lens`; `None` for a pinhole.
    ///
    /// # Errors
    /// A lens that sees farther from its axis than `WIDEST_DEGREES`, or nothing.
    pub fn new(
        scene: &Scene,
        variant: Option<&Variant>,
        camera: usize,
        lens: &PixelLens,
    ) -> Result<Option<Self>, Error> {
        let name = &scene.cameras[camera].name;
        if !scene.distortions.contains_key(name) {
            return Ok(None);
        }
        let refuse = |text: String| Error::Camera(format!("camera '{name}': {text}"));
        let own = scene
            .calibrated_lens_in(variant, camera, lens.width, lens.height)
            .map_err(|error| refuse(error.to_string()))?;
        let [columns, rows] = [lens.width, lens.height].map(|v| (v as usize).div_ceil(TILE));
        let found: Vec<(TileView, f64)> = (0..columns * rows)
            .into_par_iter()
            .map(|index| fit(&own, lens, [index % columns, index / columns]))
            .collect();
        let widest = found.iter().map(|(_, angle)| angle.to_degrees()).fold(0.0, f64::max);
        if widest > WIDEST_DEGREES {
            return Err(refuse(format!(
                "its lens sees {widest:.0} degrees from its axis; {WIDEST_DEGREES:.0} degrees at most work: choose a \
                 smaller picture or a longer focal length"
            )));
        }
        let tiles: Vec<TileView> = found.into_iter().map(|(tile, _)| tile).collect();
        let mut seen = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
        for tile in tiles.iter().filter(|tile| tile.pixels != 0) {
            for k in 0..2 {
                seen[k] = seen[k].min(tile.rect[k]);
                seen[k + 2] = seen[k + 2].max(tile.rect[k + 2]);
            }
        }
        if seen[0] > seen[2] {
            let text = "its lens sees nothing in the picture; check its intrinsics and distortion";
            return Err(refuse(text.into()));
        }
        Ok(Some(Self { tiles, columns, seen }))
    }

    /// The tile at (column, row).
    pub fn tile(&self, [column, row]: [usize; 2]) -> &TileView {
        &self.tiles[row * self.columns + column]
    }

    /// Those of a row, from left to right.
    pub fn row(&self, row: usize) -> &[TileView] {
        &self.tiles[row * self.columns..(row + 1) * self.columns]
    }
}

/// The projective map that is nearest to what a lens does to the corners of a tile's pixels, and the angle from the axis, in
/// radians, up to which it sees there.
fn fit(own: &CalibratedLens, lens: &PixelLens, place: [usize; 2]) -> (TileView, f64) {
    let origin = DVec2::new((place[0] * TILE) as f64, (place[1] * TILE) as f64);
    let nothing = TileView { pixels: 0, ..TileView::of_pinhole(place) };
    let size = DVec2::new(lens.width.into(), lens.height.into());
    let mut widest = 0.0_f64;
    // Beyond the picture nobody asks, and the lens may see nothing.
    let mut image_of = |at: DVec2| {
        let seen = own.unproject(at).filter(|_| at.cmple(size).all())?;
        widest = widest.max((-seen.z).acos());
        if seen.z < -1e-3 { lens.pinhole().project(seen) } else { None }
    };
    let corner = |k: usize| DVec2::new((k % (TILE + 1)) as f64, (k / (TILE + 1)) as f64) - HALF;
    let corners: [_; CORNERS] = std::array::from_fn(|k| image_of(origin + HALF + corner(k)));
    let middle = |pixel: usize| DVec2::from_array(centre_of(pixel));
    let middles: [_; PIXELS] = std::array::from_fn(|pixel| image_of(origin + HALF + middle(pixel)));
    let pixels = (0..PIXELS).filter(|pixel| middles[*pixel].is_some()).fold(0, |m, pixel| m | 1 << pixel);
    let points: Vec<_> = (0..CORNERS).filter_map(|k| Some((corner(k), corners[k]?))).collect();
    if widest > WIDEST_DEGREES.to_radians() {
        return (nothing, widest);
    }
    let Some(inverse) = (points.len() >= LEAST_POINTS).then(|| homography(&points)).flatten() else {
        return (nothing, widest);
    };
    let map = inverse.inverse();
    let about = |image: Option<DVec2>, plain: DVec2| {
        let h = map * image?.extend(1.0);
        let own = DVec2::new(h.x, h.y) / h.z;
        (h.z > 0.0 && (own - plain).length() < MOST_BENT_PX).then_some(own)
    };
    let corners: [_; CORNERS] = std::array::from_fn(|k| about(corners[k], corner(k)).unwrap_or(corner(k)));
    let mut margin = 0.0_f64;
    let frame = |pixel: usize| {
        let [a, b, c, d] =
            [0, 1, TILE + 1, TILE + 2].map(|k| corners[pixel / TILE * (TILE + 1) + pixel % TILE + k]);
        let (right, down) = (0.5 * (b - a + d - c), 0.5 * (c - a + d - b));
        let at = about(middles[pixel], middle(pixel)).unwrap_or(middle(pixel));
        let off = (at - middle(pixel)).abs() + 0.5 * ((right - DVec2::X).abs() + (down - DVec2::Y).abs());
        margin = margin.max(off.max_element());
        PixelFrame { middle: at.to_array(), axes: Some([right, down].map(|v| v.to_array())) }
    };
    let bent = Bent { pixels: std::array::from_fn(frame), corners: corners.map(|v| v.to_array()) };
    let outline = [[-HALF, -HALF], [HALF, -HALF], [-HALF, HALF], [HALF, HALF]];
    let mut rect = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    let mut scale = 0.0_f64;
    // What is bent lies within a margin of it.
    for [x, y] in outline.map(|corner| corner.map(|v| v * (1.0 + margin / HALF))) {
        let h = inverse * DVec3::new(x, y, 1.0);
        if h.z <= 0.0 {
            return (nothing, widest);
        }
        for (k, v) in [h.x / h.z, h.y / h.z].into_iter().enumerate() {
            (rect[k], rect[k + 2]) = (rect[k].min(v), rect[k + 2].max(v));
        }
        scale = scale.max(largest_stretch(change(&inverse, [x, y]).inverse()));
    }
    (TileView { map, inverse, bent: Some(Arc::new(bent)), margin, rect, scale, pixels }, widest)
}

/// The largest singular value.
fn largest_stretch(m: DMat2) -> f64 {
    let (sum, determinant) = (m.x_axis.length_squared() + m.y_axis.length_squared(), m.determinant());
    (0.5 * (sum + (sum * sum - 4.0 * determinant * determinant).max(0.0).sqrt())).sqrt()
}

/// The projective map that takes the first point of each pair nearest to the second, by least squares; `None` where there is
/// none.
fn homography(points: &[(DVec2, DVec2)]) -> Option<DMat3> {
    let middle = points.iter().map(|(_, to)| *to).sum::<DVec2>() / points.len() as f64;
    let mut normal = [[0.0; 9]; 8];
    for (from, to) in points {
        let to = *to - middle;
        let rows = [
            [from.x, from.y, 1.0, 0.0, 0.0, 0.0, -from.x * to.x, -from.y * to.x, to.x],
            [0.0, 0.0, 0.0, from.x, from.y, 1.0, -from.x * to.y, -from.y * to.y, to.y],
        ];
        for row in rows {
            for (i, line) in normal.iter_mut().enumerate() {
                for (j, sum) in line.iter_mut().enumerate() {
                    *sum += row[i] * row[j];
                }
            }
        }
    }
    // Gauss elimination.
    for k in 0..8 {
        let pivot = (k..8).max_by(|a, b| normal[*a][k].abs().total_cmp(&normal[*b][k].abs()))?;
        normal.swap(k, pivot);
        if normal[k][k].abs() < 1e-12 {
            return None;
        }
        for i in (0..8).filter(|i| *i != k) {
            let factor = normal[i][k] / normal[k][k];
            let pivot = normal[k];
            for (to, of) in normal[i].iter_mut().zip(pivot).skip(k) {
                *to -= factor * of;
            }
        }
    }
    let [a, b, c, d, e, f, g, h] = std::array::from_fn(|k| normal[k][8] / normal[k][k]);
    let about = DMat3::from_cols_array(&[a, d, g, b, e, h, c, f, 1.0]);
    let map = DMat3::from_translation(middle) * about;
    map.is_finite().then_some(map)
}

#[cfg(test)]
mod tests {
    use evis_scene::{Camera, Distortion, Lens};

    use super::*;

    /// `spinner`'s camera with a lens of `focal` pixels that is distorted.
    fn scene(model: &str, coefficients: &[f64], focal: f64, [width, height]: [u32; 2]) -> Scene {
        let mut scene = evis_scene::builtin::load("spinner", 0).unwrap();
        let (cx, cy) = (0.51 * f64::from(width), 0.48 * f64::from(height));
        scene.cameras[0] = Camera {
            lens: Lens::Intrinsics { fx: focal, fy: 1.01 * focal, cx, cy },
            width: Some(width),
            height: Some(height),
            ..scene.cameras[0].clone()
        };
        let name = scene.cameras[0].name.clone();
        scene.distortions.insert(name, Distortion::from_coefficients(model, coefficients).unwrap());
        scene
    }

    #[test]
    fn pixels_are_where_the_lens_has_them() {
        // Calibrations as of a DAVIS 346, a fisheye lens before it, a DVXplorer and DSEC's; and few pixels, which bend most.
        let lenses = [
            ("radtan", &[-0.37, 0.15, 4e-4, -3e-4][..], 250.0, [346, 260]),
            ("fisheye", &[-0.045, 0.012, -0.02, 0.009], 190.0, [346, 260]),
            ("radtan", &[-0.36, 0.2, 1e-3, -1e-3, -0.08], 520.0, [640, 480]),
            ("radtan", &[-0.09, 0.18, 1e-4, -1e-3], 553.0, [640, 480]),
            ("radtan", &[-0.33, 0.1, 1e-3, -2e-3], 55.0, [64, 48]),
        ];
        for (model, coefficients, focal, size) in lenses {
            let scene = scene(model, coefficients, focal, size);
            let world = crate::scene::world::World::new(&scene, 0, None).unwrap();
            let lens = scene.calibrated_lens(0, size[0], size[1]).unwrap();
            let (mut worst, mut squares, mut count, mut margin) = (0.0_f64, 0.0, 0.0, 0.0_f64);
            for (x, y) in (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (x, y))) {
                let [x, y] = [x, y].map(|v| v as usize);
                let tile = world.tile([x / TILE, y / TILE]);
                let pixel = y % TILE * TILE + x % TILE;
                assert_eq!(tile.pixels >> pixel & 1, 1);
                margin = margin.max(tile.margin);
                let frame = tile.pixel(pixel);
                let at = DVec2::new(x as f64, y as f64);
                for corner in [DVec2::ZERO, DVec2::X, DVec2::Y, DVec2::ONE, DVec2::splat(0.5)] {
                    let image = world.lens.pinhole().project(lens.unproject(at + corner).unwrap()).unwrap();
                    let own = tile.point(image.x, image.y, 1.0);
                    let expected = DVec2::from_array(frame.point((corner - 0.5).to_array()));
                    let off = DVec2::new(own.x, own.y) / own.z - expected;
                    assert!(corner != DVec2::splat(0.5) || off.length() < 1e-9, "{off}");
                    worst = worst.max(off.length());
                    squares += off.length_squared();
                    count += 1.0;
                }
                let [i, j] = [x % TILE, y % TILE];
                let image = world.lens.pinhole().project(lens.unproject(at).unwrap()).unwrap();
                let own = tile.point(image.x, image.y, 1.0);
                let off = DVec2::new(own.x, own.y) / own.z - DVec2::from_array(tile.corner(i, j));
                assert!(off.length() < 1e-9, "{off}");
            }
            let rms = (squares / count).sqrt();
            println!("{model} of {focal} px: corners off by {worst:.4} px, RMS {rms:.4}; margin {margin:.4}");
            assert!(worst < 0.01 && rms < 2e-3, "{model}: {worst}, {rms}");
        }
    }

    #[test]
    fn a_tile_of_a_pinhole_is_its_part_of_the_picture() {
        let tile = TileView::of_pinhole([2, 1]);
        assert_eq!(tile.point(21.0, 13.0, 1.0), DVec3::new(1.0, 1.0, 1.0));
        assert_eq!(tile.image_point([1.0, 1.0]), DVec3::new(21.0, 13.0, 1.0));
        assert_eq!(tile.in_units_of(8.0).point(42.0, 26.0, 2.0), DVec3::new(0.25, 0.25, 2.0));
        assert_eq!(tile.inverse_of(0.5), DVec3::new(0.0, 0.0, 2.0));
    }

    #[test]
    fn lenses_that_see_too_far_are_refused() {
        let scene = scene("fisheye", &[0.0], 60.0, [346, 260]);
        let error = crate::scene::world::World::new(&scene, 0, None).err().unwrap().to_string();
        assert!(error.contains("degrees from its axis"), "{error}");
    }
}
