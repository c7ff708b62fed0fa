//! The split-sum factors of the glTF metallic-roughness surface under constant light.

use std::f64::consts::TAU;

use rayon::prelude::*;

/// Samples per entry of the table: its error, against ten thousand, stays below 1e-3.
const SAMPLES: u32 = 1024;

/// The split-sum table: `size * size` pairs (scale, bias), so that a surface with specular colour F0 reflects
/// `F0 * scale + bias` of constant light. Entry `y * size + x` holds n·v = (x + 0.5) / size and perceptual
/// roughness (y + 0.5) / size.
///
/// B. Karis, "Real Shading in Unreal Engine 4", 2013, with GGX, height-correlated Smith masking and Schlick's
/// Fresnel (glTF 2.0, appendix B.3).
pub fn brdf_lut(size: usize) -> Vec<[f32; 2]> {
    let at = |i: usize| (i as f64 + 0.5) / size as f64;
    let points = disc_points(SAMPLES);
    (0..size * size)
        .into_par_iter()
        .map(|i| split_sum_of(at(i % size), at(i / size), &points).map(|v| v as f32))
        .collect()
}

/// One pair (scale, bias) at `n_dot_v` and perceptual `roughness`, from `samples` points.
///
/// Visible normals are sampled (E. Heitz, "Sampling the GGX Distribution of Visible Normals", JCGT 2018), so each
/// weight is G2 / G1 <= 1 and scale + bias can never exceed 1.
pub fn split_sum(n_dot_v: f64, roughness: f64, samples: u32) -> [f64; 2] {
    split_sum_of(n_dot_v, roughness, &disc_points(samples))
}

/// `count` points on the unit disc, equally dense everywhere.
fn disc_points(count: u32) -> Vec<[f64; 2]> {
    let point = |i| {
        let [u, v] = hammersley(i, count);
        let (sin, cos) = (v * TAU).sin_cos();
        [cos, sin].map(|v| u.sqrt() * v)
    };
    (0..count).map(point).collect()
}

/// [`split_sum`] from `points` of the disc, which are the same for all its values.
fn split_sum_of(n_dot_v: f64, roughness: f64, points: &[[f64; 2]]) -> [f64; 2] {
    let alpha = roughness.clamp(0.0, 1.0).powi(2);
    let cos_v = n_dot_v.clamp(1e-6, 1.0);
    let view = [(1.0 - cos_v * cos_v).sqrt(), 0.0, cos_v];
    let lambda_v = smith_lambda(cos_v, alpha);
    // The view, stretched to where the surface is a hemisphere.
    let stretched = {
        let (x, z) = (alpha * view[0], view[2]);
        let length = x.hypot(z);
        [x / length, z / length]
    };
    let (mut scale, mut bias) = (0.0, 0.0);
    let share = 0.5 * (1.0 + stretched[1]);
    for &[across, height] in points {
        // A point on the disc seen by the view, warped to the visible half of the hemisphere. The view lies in
        // the plane y = 0, so its frame is (0, 1, 0), (-z, 0, x).
        let up = (1.0 - share) * (1.0 - across * across).max(0.0).sqrt() + share * height;
        let along = (1.0 - across * across - up * up).max(0.0).sqrt();
        let normal =
            [along * stretched[0] - up * stretched[1], across, along * stretched[1] + up * stretched[0]];
        let half = {
            let h = [alpha * normal[0], alpha * normal[1], normal[2].max(0.0)];
            let length = (h[0] * h[0] + h[1] * h[1] + h[2] * h[2]).sqrt();
            if length > 0.0 { h.map(|c| c / length) } else { [0.0, 0.0, 1.0] }
        };
        let v_dot_h = (view[0] * half[0] + view[2] * half[2]).clamp(0.0, 1.0);
        let cos_l = 2.0 * v_dot_h * half[2] - view[2];
        if cos_l <= 0.0 {
            continue;
        }
        let weight = (1.0 + lambda_v) / (1.0 + lambda_v + smith_lambda(cos_l, alpha));
        let fresnel = (1.0 - v_dot_h).powi(5);
        scale += (1.0 - fresnel) * weight;
        bias += fresnel * weight;
    }
    let count = points.len().max(1) as f64;
    [scale / count, bias / count]
}

/// Smith's Λ of GGX: masking is 1 / (1 + Λ(v) + Λ(l)) where heights are correlated.
fn smith_lambda(cosine: f64, alpha: f64) -> f64 {
    let cosine = cosine.clamp(1e-9, 1.0);
    let tangent2 = (1.0 - cosine * cosine) / (cosine * cosine);
    0.5 * ((1.0 + alpha * alpha * tangent2).sqrt() - 1.0)
}

/// Point `i` of `n` of the Hammersley set, centred in its strata: low discrepancy, mean near (1/2, 1/2).
pub(super) fn hammersley(i: u32, n: u32) -> [f64; 2] {
    [(f64::from(i) + 0.5) / f64::from(n.max(1)), (f64::from(i.reverse_bits()) + 0.5) / 2f64.powi(32)]
}
