//! Equirectangular maps: orientation, repair of unusable values, and exact solid-angle arithmetic.
//!
//! Orientation: +Y up; row 0 is the zenith; the middle of the image (u = 0.5) looks along +X and u grows towards
//! +Z, so u = 0.25 looks along -Z, where a glTF camera looks by default. This is the mapping of the Khronos glTF
//! Sample Viewer (`panorama_to_cubemap.frag`) and of three.js (`equirectUv`), so a map lies the same way here; a
//! viewer inside sees the image unmirrored.

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use half::f16;
use rayon::prelude::*;

/// Largest width that is read: the maps sold today end at 24k, and this one takes 6 GiB while it is read.
const MAX_WIDTH: usize = 32768;

/// Direction of the point (u, v) of an equirectangular map; u from left to right, v from top to bottom, 0 to 1.
pub fn direction_from_equirect(u: f64, v: f64) -> DVec3 {
    let (sin_azimuth, cos_azimuth) = ((u - 0.5) * TAU).sin_cos();
    let (sin_polar, cos_polar) = (v * PI).sin_cos();
    DVec3::new(sin_polar * cos_azimuth, cos_polar, sin_polar * sin_azimuth)
}

/// Point (u, v) of an equirectangular map that `direction` (any length but 0) looks at.
pub fn equirect_from_direction(direction: DVec3) -> (f64, f64) {
    let horizontal = direction.x.hypot(direction.z);
    (0.5 + direction.z.atan2(direction.x) / TAU, horizontal.atan2(direction.y) / PI)
}

/// A map of usable values: twice as wide as high, finite, within [0, 65504].
pub(super) struct Equirect {
    pub width: usize,
    pub height: usize,
    pub texels: Vec<[f32; 3]>,
}

/// Says whether `width` x `height` is a size that can be read.
pub(super) fn check_size(width: usize, height: usize) -> Result<(), String> {
    if width == 0 || height == 0 {
        return Err(format!("is empty ({width}x{height}); an equirectangular map of at least 2x1 is needed"));
    }
    if width > MAX_WIDTH || height > MAX_WIDTH {
        return Err(format!(
            "is {width}x{height}; maps up to {MAX_WIDTH}x{} are read: scale it down",
            MAX_WIDTH / 2
        ));
    }
    if width != 2 * height {
        let even = (width / 2).max(1);
        return Err(format!(
            "is {width}x{height}; an equirectangular map is twice as wide as high: resample it to {}x{even}",
            2 * even
        ));
    }
    Ok(())
}

impl Equirect {
    /// Checks the size and repairs the values; what was repaired is told once each.
    pub fn new(
        name: &str,
        width: usize,
        height: usize,
        mut texels: Vec<[f32; 3]>,
        warnings: &mut Vec<String>,
    ) -> Result<Self, String> {
        check_size(width, height)?;
        if texels.len() != width * height {
            return Err(format!("holds {} texels where {width}x{height} were announced", texels.len()));
        }
        let max = f16::MAX.to_f32();
        let repaired = texels
            .par_iter_mut()
            .map(|texel| {
                let mut count = [0_usize; 3];
                for value in texel {
                    if value.is_nan() {
                        (*value, count[0]) = (0.0, 1);
                    } else if *value < 0.0 {
                        (*value, count[1]) = (0.0, 1);
                    } else if *value > max {
                        (*value, count[2]) = (max, 1);
                    }
                }
                count
            })
            .reduce(|| [0; 3], |a, b| [a[0] + b[0], a[1] + b[1], a[2] + b[2]]);
        let reasons = [
            "are not a number: taken as 0",
            "are negative: taken as 0",
            "are above 65504, the largest 16-bit float: taken as 65504, their light beyond it is lost (a sun is \
             better given as a directional light)",
        ];
        for (count, reason) in repaired.into_iter().zip(reasons) {
            if count > 0 {
                warnings.push(format!("environment '{name}': {count} of {} texels {reason}", texels.len()));
            }
        }
        Ok(Self { width, height, texels })
    }

    /// Bilinear radiance at (u, v): wraps around, and continues over the poles on the far meridian.
    pub fn sample(&self, u: f64, v: f64) -> [f64; 3] {
        let (x, y) = (u * self.width as f64 - 0.5, v * self.height as f64 - 0.5);
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let mut sum = [0.0; 3];
        for (dy, wy) in [(0, 1.0 - fy), (1, fy)] {
            for (dx, wx) in [(0, 1.0 - fx), (1, fx)] {
                let texel = self.texels[self.index(x0 as isize + dx, y0 as isize + dy)];
                for (sum, value) in sum.iter_mut().zip(texel) {
                    *sum += wx * wy * f64::from(value);
                }
            }
        }
        sum
    }

    fn index(&self, x: isize, y: isize) -> usize {
        let (width, height) = (self.width as isize, self.height as isize);
        let (x, y) = if y < 0 {
            (x + width / 2, -1 - y)
        } else if y >= height {
            (x + width / 2, 2 * height - 1 - y)
        } else {
            (x, y)
        };
        let y = y.clamp(0, height - 1);
        (y * width + x.rem_euclid(width)) as usize
    }

    /// The map at `height` rows, if it has more: each texel is the mean radiance over its solid angle, so that the
    /// light of every part of the sky is kept.
    pub fn reduced(&self, height: usize) -> Option<Self> {
        if height == 0 || self.height <= height {
            return None;
        }
        let width = 2 * height;
        let columns: Vec<Vec<(usize, f64)>> =
            (0..width).map(|x| overlaps(self.width, width, x, |edge| edge)).collect();
        let mut texels = vec![[0.0_f32; 3]; width * height];
        texels.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            // Solid angle between two parallels goes with the difference of the cosines of their polar angles.
            let rows = overlaps(self.height, height, y, |edge| -(edge * PI).cos());
            let mut line = vec![[0.0_f64; 3]; self.width];
            for (source, weight) in rows {
                for (sum, texel) in line.iter_mut().zip(&self.texels[source * self.width..]) {
                    for (sum, value) in sum.iter_mut().zip(texel) {
                        *sum += weight * f64::from(*value);
                    }
                }
            }
            for (texel, column) in row.iter_mut().zip(&columns) {
                let mut sum = [0.0_f64; 3];
                for &(source, weight) in column {
                    for (sum, value) in sum.iter_mut().zip(line[source]) {
                        *sum += weight * value;
                    }
                }
                *texel = sum.map(|v| v as f32);
            }
        });
        Some(Self { width, height, texels })
    }
}

/// Which of `from` equal parts cover part `index` of `to`, and with what share (they sum to 1) of the `measure`
/// between two edges in [0, 1].
fn overlaps(from: usize, to: usize, index: usize, measure: impl Fn(f64) -> f64) -> Vec<(usize, f64)> {
    let (from_f, to_f) = (from as f64, to as f64);
    let (low, high) = (index as f64 / to_f, (index + 1) as f64 / to_f);
    let first = (low * from_f).floor() as usize;
    let last = ((high * from_f).ceil() as usize).min(from);
    let total = measure(high) - measure(low);
    (first..last)
        .map(|source| {
            let a = (source as f64 / from_f).max(low);
            let b = ((source + 1) as f64 / from_f).min(high);
            (source, ((measure(b.max(a)) - measure(a)) / total).max(0.0))
        })
        .collect()
}
