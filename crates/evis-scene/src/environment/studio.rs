//! The default light of scenes that bring none.

use glam::DVec3;
use rayon::prelude::*;

use super::equirect::{Equirect, direction_from_equirect};

/// A soft box: direction of its centre, tangents of its half width and half height, softness of its rim as a part
/// of those, and radiance.
struct SoftBox {
    centre: DVec3,
    half_size: [f64; 2],
    softness: f64,
    radiance: [f64; 3],
}

/// Rows of the map that is rendered.
const HEIGHT: usize = 256;
/// Points along each side of a texel.
const SUPERSAMPLES: usize = 2;

/// The studio as an equirectangular map.
pub(super) fn map() -> Equirect {
    let boxes = [
        SoftBox {
            centre: DVec3::new(0.8, 0.9, 0.9),
            half_size: [0.45, 0.32],
            softness: 0.25,
            radiance: [5.0, 4.8, 4.45],
        },
        SoftBox {
            centre: DVec3::new(-1.0, 0.35, 0.6),
            half_size: [0.35, 0.55],
            softness: 0.3,
            radiance: [1.5, 1.65, 1.85],
        },
        SoftBox {
            centre: DVec3::new(-0.3, 0.6, -1.0),
            half_size: [0.7, 0.16],
            softness: 0.3,
            radiance: [2.5, 2.5, 2.5],
        },
    ];
    let width = 2 * HEIGHT;
    let texels = (0..width * HEIGHT)
        .into_par_iter()
        .map(|i| {
            let (x, y) = (i % width, i / width);
            let mut sum = [0.0; 3];
            for k in 0..SUPERSAMPLES * SUPERSAMPLES {
                let offset = |k: usize| (k as f64 + 0.5) / SUPERSAMPLES as f64;
                let u = (x as f64 + offset(k % SUPERSAMPLES)) / width as f64;
                let v = (y as f64 + offset(k / SUPERSAMPLES)) / HEIGHT as f64;
                for (sum, value) in sum.iter_mut().zip(radiance(&boxes, direction_from_equirect(u, v))) {
                    *sum += value;
                }
            }
            sum.map(|v| (v / (SUPERSAMPLES * SUPERSAMPLES) as f64) as f32)
        })
        .collect();
    Equirect { width, height: HEIGHT, texels }
}

fn radiance(boxes: &[SoftBox], direction: DVec3) -> [f64; 3] {
    let mix =
        |a: [f64; 3], b: [f64; 3], t: f64| -> [f64; 3] { std::array::from_fn(|c| a[c] + (b[c] - a[c]) * t) };
    let (zenith, horizon) = ([0.25, 0.31, 0.42], [0.52, 0.53, 0.55]);
    let (ground_far, ground_near) = ([0.22, 0.21, 0.20], [0.13, 0.125, 0.12]);
    let up = direction.y;
    let sky = mix(horizon, zenith, up.max(0.0).sqrt());
    let ground = mix(ground_far, ground_near, (-up).max(0.0).sqrt());
    // A horizon some five degrees soft: a hard one would fire events of its own when the camera turns.
    let mut colour = mix(ground, sky, smoothstep(-0.05, 0.05, up));
    for soft_box in boxes {
        let light = soft_box.coverage(direction);
        for (value, radiance) in colour.iter_mut().zip(soft_box.radiance) {
            *value += light * radiance;
        }
    }
    colour
}

impl SoftBox {
    /// 1 inside, 0 outside, smooth between.
    fn coverage(&self, direction: DVec3) -> f64 {
        let forward = self.centre.normalize();
        let right = forward.cross(DVec3::Y).normalize();
        let up = right.cross(forward);
        let depth = direction.dot(forward);
        if depth <= 0.0 {
            return 0.0;
        }
        let side = |axis: DVec3, half: f64| {
            let distance = (direction.dot(axis) / depth).abs() / half;
            1.0 - smoothstep(1.0 - self.softness, 1.0 + self.softness, distance)
        };
        side(right, self.half_size[0]) * side(up, self.half_size[1])
    }
}

fn smoothstep(low: f64, high: f64, x: f64) -> f64 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
