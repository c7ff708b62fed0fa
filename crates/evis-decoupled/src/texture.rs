//! The mean of a texture over a pixel's footprint.
//!
//! A texture's signal is the bilinear interpolant of its base level in linear light. Its mean over a parallelogram is
//! taken at a grid of places in it. Where many texels lie between two places, a smaller level of the mip chain is read:
//! that adds its own blur, of variance (m^2 - 1) / 4 for texels of m base texels (box (m^2 - 1) / 12, and tent m^2 / 6
//! in place of 1 / 6), so the grid is drawn together until the variance of both is that of the footprint.

use evis_scene::texture::mip_chain;
use evis_scene::{Scene, Texture, Wrap};

/// Places per texel along either axis, beyond one.
const DENSITY: f64 = 2.5;
/// Places along either axis, at most.
const MOST: f64 = 16.0;

/// The images of a scene with their mip levels, in linear light.
pub struct Textures {
    chains: Vec<Vec<Level>>,
    textures: Vec<Texture>,
}

struct Level {
    width: i32,
    height: i32,
    texels: Vec<[f32; 4]>,
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
        Self { chains: scene.images.iter().map(chain).collect(), textures: scene.textures.clone() }
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

    /// Mean of texture `texture` over the parallelogram about `at` with the sides `axes`, in base texels from the
    /// corner of the first one. White where there are no texels.
    #[inline(always)]
    pub fn mean(&self, texture: usize, at: [f64; 2], axes: [[f64; 2]; 2]) -> [f32; 4] {
        let Some(texture) = self.textures.get(texture) else { return [1.0; 4] };
        let Some(chain) = self.chains.get(texture.image).filter(|c| !c.is_empty()) else { return [1.0; 4] };
        let [p, q] = axes;
        // The shorter axis of the ellipse with the parallelogram's variance limits the blur that a level may add.
        let (xx, xy, yy) = (p[0] * p[0] + q[0] * q[0], p[0] * p[1] + q[0] * q[1], p[1] * p[1] + q[1] * q[1]);
        let shorter = 0.5 * (xx + yy) - (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
        let level = if texture.nearest { 0 } else { level_of(shorter, chain.len()) };
        let source = &chain[level];
        let scale = [
            f64::from(source.width) / f64::from(chain[0].width),
            f64::from(source.height) / f64::from(chain[0].height),
        ];
        let texel = 1.0 / scale[0].min(scale[1]).max(1e-9);
        let steps = [p, q].map(|axis| {
            let squared = axis[0] * axis[0] + axis[1] * axis[1];
            let length = squared.sqrt();
            let texels = length / texel;
            let count = if texels < 0.3 { 1.0 } else { (1.0 + DENSITY * texels).ceil().clamp(2.0, MOST) };
            if count == 1.0 {
                return (1, [0.0; 2]);
            }
            let kept = ((squared - 3.0 * (texel * texel - 1.0)).max(0.0) / squared.max(1e-30)).sqrt();
            // Places at the middles of equal parts have the variance (1 - 1 / n^2) of the whole.
            let step = kept / (1.0 - 1.0 / (count * count)).sqrt() / count;
            (count as usize, [axis[0] * step * scale[0], axis[1] * step * scale[1]])
        });
        let [(across, dx), (down, dy)] = steps;
        let start = [0, 1].map(|k| {
            at[k] * scale[k] - 0.5 - 0.5 * ((across as f64 - 1.0) * dx[k] + (down as f64 - 1.0) * dy[k])
        });
        let mut sum = [0.0_f32; 4];
        for row in 0..down {
            let mut x = start[0] + row as f64 * dy[0];
            let mut y = start[1] + row as f64 * dy[1];
            for _ in 0..across {
                if texture.nearest {
                    source.nearest(x, y, texture, &mut sum);
                } else {
                    source.bilinear(x, y, texture, &mut sum);
                }
                x += dx[0];
                y += dx[1];
            }
        }
        let inverse = 1.0 / (across * down) as f32;
        sum.map(|v| v * inverse)
    }
}

/// The smallest level whose blur is at most that of a footprint whose shorter axis squared is `shorter`.
#[inline(always)]
fn level_of(shorter: f64, levels: usize) -> usize {
    let texel = (shorter.max(0.0) * BLUR / 3.0 + 1.0).sqrt();
    let mut level = 0;
    let mut size = 2.0;
    while size <= texel && level + 1 < levels {
        level += 1;
        size *= 2.0;
    }
    level
}

/// Part of the footprint's variance that a level's own blur may be.
const BLUR: f64 = 0.25;

impl Level {
    #[inline(always)]
    fn bilinear(&self, x: f64, y: f64, texture: &Texture, sum: &mut [f32; 4]) {
        let (fx, fy) = (x.floor(), y.floor());
        let (wx, wy) = ((x - fx) as f32, (y - fy) as f32);
        let (x0, y0) = (fx as i32, fy as i32);
        let columns = [x0, x0.wrapping_add(1)].map(|x| wrap(x, self.width, texture.wrap_u));
        let rows =
            [y0, y0.wrapping_add(1)].map(|y| wrap(y, self.height, texture.wrap_v) * self.width as usize);
        let at = |row: usize, column: usize| &self.texels[rows[row] + columns[column]];
        let (a, b, c, d) = (at(0, 0), at(0, 1), at(1, 0), at(1, 1));
        let weights = [(1.0 - wx) * (1.0 - wy), wx * (1.0 - wy), (1.0 - wx) * wy, wx * wy];
        for k in 0..4 {
            sum[k] += weights[0] * a[k] + weights[1] * b[k] + weights[2] * c[k] + weights[3] * d[k];
        }
    }

    #[inline(always)]
    fn nearest(&self, x: f64, y: f64, texture: &Texture, sum: &mut [f32; 4]) {
        let column = wrap((x + 0.5).floor() as i32, self.width, texture.wrap_u);
        let row = wrap((y + 0.5).floor() as i32, self.height, texture.wrap_v);
        let texel = &self.texels[row * self.width as usize + column];
        for k in 0..4 {
            sum[k] += texel[k];
        }
    }
}

/// Texel `index` brought into [0, size).
#[inline(always)]
fn wrap(index: i32, size: i32, wrap: Wrap) -> usize {
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
    fn means_over_footprints_are_those_of_many_places() {
        let scene = noise(64);
        let textures = Textures::new(&scene);
        let base = &textures.chains[0][0];
        let mut squares = [0.0; 4];
        let mut canary: f64 = 0.0;
        for (class, size) in [0.3, 1.0, 2.5, 8.0].into_iter().enumerate() {
            for i in 0..60 {
                let f = f64::from(i);
                let at = [f * 7.31, f * 3.77 - 40.0];
                let turn = f * 0.7;
                let p = [size * turn.cos(), size * turn.sin()];
                let q = [-0.8 * size * (turn + 0.3).sin(), 0.8 * size * (turn + 0.3).cos()];
                let mut exact = [0.0; 4];
                for k in 0..64 * 64 {
                    let (s, t) =
                        ((f64::from(k % 64) + 0.5) / 64.0 - 0.5, (f64::from(k / 64) + 0.5) / 64.0 - 0.5);
                    let x = at[0] + s * p[0] + t * q[0] - 0.5;
                    let y = at[1] + s * p[1] + t * q[1] - 0.5;
                    base.bilinear(x, y, &textures.textures[0], &mut exact);
                }
                let exact = f64::from(exact[0]) / 4096.0;
                let error = f64::from(textures.mean(0, at, [p, q])[0]) / exact - 1.0;
                squares[class] += error * error / 60.0;
                canary = canary.max((f64::from(textures.mean(0, at, [[0.0; 2]; 2])[0]) / exact - 1.0).abs());
            }
        }
        let rms = squares.map(f64::sqrt);
        println!("relative errors at 0.3, 1, 2.5 and 8 texels per pixel: {rms:.4?}");
        assert!(rms.iter().all(|e| *e < 0.012), "{rms:?}");
        assert!(canary > 0.2, "a point is no mean: {canary}");
    }
}
