//! Textures in f64: wrapping, bilinear and trilinear filtering as the Vulkan specification has them.

use evis_scene::{Image, Scene, Texture, Wrap};
use glam::{DVec2, DVec4, Vec4};
use half::f16;

/// How a texture is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TextureFilter {
    /// The bilinear interpolant of the base level: the signal itself.
    BaseLevel,
    /// Trilinear, by the footprint of a pixel: what the engine shows. Each of n samples stands for an n-th of the
    /// footprint's area, and n places along its longer axis need no finer level.
    Mipmapped {
        /// How many samples share a pixel.
        samples: f64,
    },
    /// What the engine shows by a sample that stands for a part of the pixel: of what light is proportional to, the mean
    /// over a grid of places on that part; of everything else, and where holes are cut, [`TextureFilter::at_a_place`].
    Averaged {
        /// From the sample to the part's middle, in pixels.
        shift: [f64; 2],
        /// Its width and height, in pixels.
        size: [f64; 2],
        /// Places along each side, at most.
        taps: f64,
    },
}

impl TextureFilter {
    /// How textures are read that light is not proportional to, at one place: by half of a sample's share, since a
    /// trilinear filter reaches over it.
    pub fn at_a_place(self) -> Self {
        match self {
            Self::Averaged { size: [1.0, 1.0], .. } => Self::Mipmapped { samples: 1.0 },
            Self::Averaged { size, .. } => Self::Mipmapped { samples: 2.0 / (size[0] * size[1]) },
            other => other,
        }
    }
}

/// The images of a scene, decoded, with their mip levels.
#[derive(Clone, Debug, Default)]
pub struct Textures {
    chains: Vec<Vec<Level>>,
}

#[derive(Clone, Debug)]
struct Level {
    width: usize,
    height: usize,
    /// 16-bit floats at the base: 32 bits hold them exactly.
    texels: Vec<Vec4>,
}

impl Textures {
    /// Decodes the images of `scene`. An image whose texels do not fill it is left empty, and reads as white.
    pub fn new(scene: &Scene) -> Self {
        Self { chains: scene.images.iter().map(chain).collect() }
    }

    /// Texture `texture` of `scene` at `uv`; `footprint` is the change of `uv` per pixel to the right and down.
    pub fn sample(
        &self,
        scene: &Scene,
        texture: usize,
        uv: DVec2,
        footprint: [DVec2; 2],
        filter: TextureFilter,
    ) -> DVec4 {
        let Some(texture) = scene.textures.get(texture) else { return DVec4::ONE };
        let Some(chain) = self.chains.get(texture.image).filter(|c| !c.is_empty()) else { return DVec4::ONE };
        let size = DVec2::new(chain[0].width as f64, chain[0].height as f64);
        match filter {
            TextureFilter::BaseLevel => trilinear(chain, texture, uv, 0.0),
            TextureFilter::Mipmapped { samples } => {
                let [dx, dy] = footprint.map(|d| d * size);
                let area = (dx.x * dy.y - dx.y * dy.x).abs();
                // One sample for the whole pixel gives Vulkan's own rule: 1.3, 16.5.3 "Scale Factor Operation, LOD
                // Operation and Image Level(s) Selection".
                let longer = dx.length_squared().max(dy.length_squared());
                trilinear(chain, texture, uv, 0.5 * (area / samples).max(longer / (samples * samples)).log2())
            }
            TextureFilter::Averaged { shift, size: part, taps } => {
                let share = [footprint[0] * part[0], footprint[1] * part[1]];
                let texels = share.map(|d| (d * size).length());
                let fine = (2.0 * texels[0].max(texels[1]) - 1.0).clamp(0.0, 1.0);
                let middle = uv + fine * (footprint[0] * shift[0] + footprint[1] * shift[1]);
                let count = texels.map(|t| t.ceil().max((2.0 * t).ceil().min(2.0)).clamp(1.0, taps));
                let level = (texels[0] / count[0]).max(texels[1] / count[1]).log2().floor();
                let place = |i: usize, n: f64| (i as f64 + 0.5) / n - 0.5;
                let mut sum = DVec4::ZERO;
                for row in 0..count[1] as usize {
                    for column in 0..count[0] as usize {
                        let at =
                            middle + share[0] * place(column, count[0]) + share[1] * place(row, count[1]);
                        sum += trilinear(chain, texture, at, level);
                    }
                }
                sum / (count[0] * count[1])
            }
        }
    }
}

/// The value at `uv`, of level `level`.
fn trilinear(chain: &[Level], texture: &Texture, uv: DVec2, level: f64) -> DVec4 {
    let level = level.clamp(0.0, (chain.len() - 1) as f64);
    let wraps = [texture.wrap_u, texture.wrap_v];
    if texture.nearest {
        return chain[level.round() as usize].nearest(uv, wraps);
    }
    let lower = level.floor();
    let sum = chain[lower as usize].bilinear(uv, wraps);
    let blend = level - lower;
    if blend > 0.0 { sum.lerp(chain[lower as usize + 1].bilinear(uv, wraps), blend) } else { sum }
}

/// The base level and all smaller ones: each texel is the mean of the area that it covers in the level above.
fn chain(image: &Image) -> Vec<Level> {
    let (width, height) = (image.width as usize, image.height as usize);
    if image.texels.is_empty() || image.texels.len() != width * height {
        return Vec::new();
    }
    let wide = |t: &[f16; 4]| Vec4::from_array(t.map(f16::to_f32));
    let mut levels = vec![Level { width, height, texels: image.texels.iter().map(wide).collect() }];
    while let Some(next) = levels.last().and_then(Level::halved) {
        levels.push(next);
    }
    levels
}

impl Level {
    /// Half the size, rounded down, at least 1; `None` at 1x1.
    fn halved(&self) -> Option<Self> {
        if self.width == 1 && self.height == 1 {
            return None;
        }
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let mut texels = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                let mut sum = DVec4::ZERO;
                for (row, down) in cover(self.height, height, y) {
                    for (column, across) in cover(self.width, width, x) {
                        sum += self.texels[row * self.width + column].as_dvec4() * (down * across);
                    }
                }
                texels.push(sum.as_vec4());
            }
        }
        Some(Self { width, height, texels })
    }

    fn texel(&self, x: f64, y: f64, wraps: [Wrap; 2]) -> DVec4 {
        let (x, y) = (wrap(x, self.width, wraps[0]), wrap(y, self.height, wraps[1]));
        self.texels[y * self.width + x].as_dvec4()
    }

    fn nearest(&self, uv: DVec2, wraps: [Wrap; 2]) -> DVec4 {
        let at = uv * DVec2::new(self.width as f64, self.height as f64);
        self.texel(at.x.floor(), at.y.floor(), wraps)
    }

    fn bilinear(&self, uv: DVec2, wraps: [Wrap; 2]) -> DVec4 {
        let at = uv * DVec2::new(self.width as f64, self.height as f64) - 0.5;
        let (low, f) = (at.floor(), at - at.floor());
        let row = |y: f64| self.texel(low.x, y, wraps).lerp(self.texel(low.x + 1.0, y, wraps), f.x);
        row(low.y).lerp(row(low.y + 1.0), f.y)
    }
}

/// Parts of `from` that part `index` of `to` covers, with weights that sum to 1.
fn cover(from: usize, to: usize, index: usize) -> impl Iterator<Item = (usize, f64)> {
    let ratio = from as f64 / to as f64;
    let (low, high) = (index as f64 * ratio, (index + 1) as f64 * ratio);
    (low as usize..(high.ceil() as usize).min(from)).map(move |i| {
        let covered = (i as f64 + 1.0).min(high) - (i as f64).max(low);
        (i, covered.max(0.0) / ratio)
    })
}

/// Texel `index`, a whole number, brought into [0, size). What is not finite reads texel 0.
fn wrap(index: f64, size: usize, wrap: Wrap) -> usize {
    let n = size as f64;
    if index >= 0.0 && index < n {
        return index as usize;
    }
    let inside = match wrap {
        Wrap::Repeat => index.rem_euclid(n),
        Wrap::Clamp => index.clamp(0.0, n - 1.0),
        Wrap::Mirror => {
            let i = index.rem_euclid(2.0 * n);
            if i < n { i } else { 2.0 * n - 1.0 - i }
        }
    };
    (inside as usize).min(size - 1)
}
