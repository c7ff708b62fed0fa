//! Mip chains, filtered on the CPU in linear light.

use half::f16;
use rayon::prelude::*;

use crate::model::Image;

/// Levels of a full mip chain: halved, rounded down, until both edges are 1 (as wgpu counts them).
pub fn mip_level_count(width: u32, height: u32) -> u32 {
    32 - width.max(height).max(1).leading_zeros()
}

/// The base level and all smaller ones. Each texel is the exact mean of the area that it covers in the level above,
/// also where an edge is odd (a 2x2 mean would then drift by up to a texel and drop the last row).
pub fn mip_chain(base: &Image) -> Vec<Image> {
    let mut chain = vec![base.clone()];
    let (mut width, mut height) = (base.width as usize, base.height as usize);
    if width == 0 || height == 0 || base.texels.len() != width * height {
        return chain;
    }
    // Levels are averaged in f32; rounding to f16 happens once per level and does not add up.
    let mut level: Vec<[f32; 4]> = base.texels.iter().map(|t| t.map(f16::to_f32)).collect();
    while width > 1 || height > 1 {
        let (w, h) = ((width / 2).max(1), (height / 2).max(1));
        level = halve(&level, width, height, w, h);
        (width, height) = (w, h);
        chain.push(Image {
            name: base.name.clone(),
            width: width as u32,
            height: height as u32,
            texels: level.par_iter().map(|t| t.map(f16::from_f32)).collect(),
        });
    }
    chain
}

/// Source texels that destination texel `i` of `n` covers out of `source`, with weights that sum to 1.
fn cover(i: usize, n: usize, source: usize) -> Vec<(usize, f32)> {
    // In units of 1 / n of a source texel everything is an integer.
    let (start, end) = (i * source, (i + 1) * source);
    (start / n..end.div_ceil(n))
        .map(|s| (s, ((end.min((s + 1) * n) - start.max(s * n)) as f32) / source as f32))
        .collect()
}

fn halve(level: &[[f32; 4]], width: usize, height: usize, w: usize, h: usize) -> Vec<[f32; 4]> {
    let columns: Vec<_> = (0..w).map(|x| cover(x, w, width)).collect();
    let rows: Vec<_> = (0..h).map(|y| cover(y, h, height)).collect();
    let mut out = vec![[0.0; 4]; w * h];
    out.par_chunks_mut(w).zip(&rows).for_each(|(line, rows)| {
        for (texel, columns) in line.iter_mut().zip(&columns) {
            for &(sy, wy) in rows {
                for &(sx, wx) in columns {
                    let source = level[sy * width + sx];
                    for (sum, value) in texel.iter_mut().zip(source) {
                        *sum += wx * wy * value;
                    }
                }
            }
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(width: u32, height: u32, f: impl Fn(u32, u32) -> [f32; 4]) -> Image {
        let texels = (0..height)
            .flat_map(|y| (0..width).map(move |x| (x, y)))
            .map(|(x, y)| f(x, y).map(f16::from_f32))
            .collect();
        Image { name: "test".into(), width, height, texels }
    }

    fn mean(image: &Image, channel: usize) -> f64 {
        image.texels.iter().map(|t| t[channel].to_f64()).sum::<f64>() / image.texels.len() as f64
    }

    #[test]
    fn levels_halve_rounding_down_and_keep_the_mean() {
        for (w, h) in [(8, 8), (7, 5), (13, 1), (1, 6), (1, 1), (100, 3)] {
            let base =
                image(w, h, |x, y| [(x * 7 % 5) as f32, (y * 3 % 4) as f32, ((x * y) % 3) as f32, 0.25]);
            let chain = mip_chain(&base);
            assert_eq!(chain.len() as u32, mip_level_count(w, h), "{w}x{h}");
            for (k, level) in chain.iter().enumerate() {
                assert_eq!((level.width, level.height), ((w >> k).max(1), (h >> k).max(1)));
                assert_eq!(level.texels.len() as u32, level.width * level.height);
                for c in 0..4 {
                    let (got, want) = (mean(level, c), mean(&base, c));
                    assert!((got - want).abs() < 2e-3 * (1.0 + want), "{w}x{h} level {k}: {got} {want}");
                }
            }
        }
    }

    #[test]
    fn an_odd_edge_is_weighted_by_area() {
        // Three texels onto one: a third each. Five onto two: 2.5 each, the middle one shared.
        let three = image(3, 1, |x, _| [[3.0, 0.0, 0.0][x as usize], 0.0, 0.0, 1.0]);
        assert_eq!(mip_chain(&three)[1].texels[0][0], f16::from_f32(1.0));
        let five = image(5, 1, |x, _| [[0.0, 0.0, 1.0, 0.0, 0.0][x as usize], 0.0, 0.0, 1.0]);
        let next = &mip_chain(&five)[1];
        assert_eq!([next.texels[0][0], next.texels[1][0]], [f16::from_f32(0.2); 2]);
    }

    #[test]
    fn a_plain_image_stays_plain() {
        let plain = image(37, 21, |_, _| [0.5, 0.25, 0.125, 1.0]);
        for level in mip_chain(&plain) {
            assert!(level.texels.iter().all(|t| *t == [0.5, 0.25, 0.125, 1.0].map(f16::from_f32)));
        }
    }
}
