//! Scale and bias of F0 for light from all around (B. Karis, "Real Shading in Unreal Engine 4", 2013).

use std::sync::OnceLock;

use evis_scene::environment::{brdf_lut, split_sum};

/// Points per evaluation where it is computed.
const SAMPLES: u32 = 256;
/// Entries per side of the table.
const SIZE: usize = 128;

/// How the split sum is found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SplitSum {
    /// Integrated at each point: what a table approximates.
    Computed,
    /// Read from a table of scene data, bilinearly: a thousand times as fast, smooth, within 2e-3 of the integral.
    #[default]
    Tabulated,
}

/// Scale and bias at `n_dot_v` and perceptual `roughness`.
pub fn at(kind: SplitSum, n_dot_v: f64, roughness: f64) -> [f64; 2] {
    static TABLE: OnceLock<Vec<[f32; 2]>> = OnceLock::new();
    if kind == SplitSum::Computed {
        return split_sum(n_dot_v, roughness, SAMPLES);
    }
    let table = TABLE.get_or_init(|| brdf_lut(SIZE));
    let place = |v: f64| {
        let at = (v * SIZE as f64 - 0.5).clamp(0.0, (SIZE - 1) as f64);
        let low = (at as usize).min(SIZE - 2);
        (low, at - low as f64)
    };
    let ((x, fx), (y, fy)) = (place(n_dot_v), place(roughness));
    let entry = |x: usize, y: usize| table[y * SIZE + x].map(f64::from);
    let (a, b, c, d) = (entry(x, y), entry(x + 1, y), entry(x, y + 1), entry(x + 1, y + 1));
    [0, 1].map(|k| (a[k] * (1.0 - fx) + b[k] * fx) * (1.0 - fy) + (c[k] * (1.0 - fx) + d[k] * fx) * fy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_follows_the_integral() {
        let mut worst: f64 = 0.0;
        for i in 0..40 {
            for j in 0..10 {
                let (n_dot_v, roughness) = ((f64::from(i) + 0.7) / 40.5, f64::from(j) / 9.0);
                let (a, b) =
                    (at(SplitSum::Tabulated, n_dot_v, roughness), split_sum(n_dot_v, roughness, 2048));
                worst = worst.max((a[0] - b[0]).abs()).max((a[1] - b[1]).abs());
            }
        }
        assert!(worst < 6e-3, "{worst}");
        let canary = at(SplitSum::Tabulated, 0.5, 0.5)[0] - split_sum(0.5, 0.9, 256)[0];
        assert!(canary.abs() > 6e-3, "another roughness is another value");
    }
}
