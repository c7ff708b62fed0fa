//! From an equirectangular map to the three cube maps that light a scene.

use std::f64::consts::{PI, TAU};

use glam::{DVec3, Vec3, Vec4};
use rayon::prelude::*;

use super::brdf::hammersley;
use super::cube::{CubeMap, FACES, cube_direction, cube_solid_angle, edge, resolve, texel, texel_direction};
use super::equirect::{Equirect, equirect_from_direction};

/// Edge of the irradiance cube.
pub const IRRADIANCE_SIZE: usize = 32;
/// Edge of level 0 of the specular cube.
pub const SPECULAR_SIZE: usize = 256;
/// Levels of the specular cube: perceptual roughness 0, 0.2, … 1 at 256, 128, … 8 texels. Smaller ones would not
/// hold even the lobe of roughness 1.
pub const SPECULAR_LEVELS: usize = 6;
/// Edges of the smallest and the largest sky.
const SKY_SIZES: [usize; 2] = [128, 512];
/// Points along each side of a sky texel: less than half a texel of the map apart.
const SKY_SUPERSAMPLES: usize = 3;
/// Directions per texel of the specular cube, by level: narrow lobes need few, and have many texels.
const SPECULAR_SAMPLES: [u32; SPECULAR_LEVELS] = [1, 64, 256, 512, 1024, 2048];
/// Columns of the patches by which the irradiance is summed, and patches along the side of a tile of them.
const PATCH_COLUMNS: usize = 256;
const PATCHES_PER_TILE: usize = 4;

/// What an environment shows, with a full mip chain, and what it lights with; see [`super::Environment`].
pub(super) struct Cubes {
    pub sky: CubeMap,
    pub irradiance: CubeMap,
    pub specular: CubeMap,
}

/// Filters `map`.
pub(super) fn build(map: &Equirect) -> Cubes {
    let size = sky_size(map.height);
    // Two by two texels of the map to one of the sky at most: the points then see every one of them.
    let reduced = map.reduced(2 * size);
    let map = reduced.as_ref().unwrap_or(map);
    let sky = Pyramid::from_map(map, size);
    Cubes { irradiance: irradiance(map), specular: specular(&sky), sky: sky.cube() }
}

/// Half the map's height, rounded to the nearest power of two (in the logarithm), within [`SKY_SIZES`].
fn sky_size(height: usize) -> usize {
    let exponent = (height.max(1) as f64 * 0.5).log2().round().max(0.0);
    (2f64.powf(exponent) as usize).clamp(SKY_SIZES[0], SKY_SIZES[1])
}

/// A cube in 32-bit floats, per level.
struct Pyramid {
    levels: Vec<Level>,
}

/// Six faces with a border of one texel that continues them across their edges, so that sampling needs no case
/// for them.
struct Level {
    size: usize,
    texels: Vec<Vec4>,
}

impl Level {
    /// `faces`: as [`CubeMap::levels`] has them.
    fn new(size: usize, faces: &[Vec4]) -> Self {
        let stride = size + 2;
        let mut texels = vec![Vec4::ZERO; FACES * stride * stride];
        for (i, texel) in texels.iter_mut().enumerate() {
            let (face, x, y) = (i / (stride * stride), i % stride, i / stride % stride);
            let (x, y) = (x as isize - 1, y as isize - 1);
            *texel = match resolve(size, face, x, y) {
                Some(index) => faces[index],
                // Beyond a corner: the mean of the three texels that meet there.
                None => {
                    let last = size as isize - 1;
                    let (inner_x, inner_y) = (x.clamp(0, last), y.clamp(0, last));
                    let around = [(inner_x, inner_y), (x, inner_y), (inner_x, y)];
                    around
                        .into_iter()
                        .filter_map(|(x, y)| resolve(size, face, x, y))
                        .map(|i| faces[i])
                        .sum::<Vec4>()
                        / 3.0
                }
            };
        }
        Self { size, texels }
    }

    /// The faces without their borders.
    fn faces(&self) -> impl Iterator<Item = Vec4> {
        let (size, stride) = (self.size, self.size + 2);
        (0..FACES * size * size).map(move |i| {
            self.texels[(i / (size * size) * stride + i / size % size + 1) * stride + i % size + 1]
        })
    }

    /// Bilinear and seamless.
    fn sample(&self, direction: Vec3) -> Vec4 {
        let (ax, ay, az) = (direction.x.abs(), direction.y.abs(), direction.z.abs());
        let (face, major, s, t) = if az >= ax && az >= ay {
            let sign = direction.z.signum();
            (4 + usize::from(direction.z < 0.0), az, direction.x * sign, -direction.y)
        } else if ay >= ax {
            let sign = direction.y.signum();
            (2 + usize::from(direction.y < 0.0), ay, direction.x, direction.z * sign)
        } else {
            let sign = direction.x.signum();
            (usize::from(direction.x < 0.0), ax, -direction.z * sign, -direction.y)
        };
        // In the bordered face texel centres lie at whole numbers, the first inner one at 1.
        let (half, scale) = (0.5 * self.size as f32, 0.5 * self.size as f32 / major);
        let (u, v) = (s * scale + half + 0.5, t * scale + half + 0.5);
        let (x, y) = ((u as usize).min(self.size), (v as usize).min(self.size));
        let (fx, fy) = (u - x as f32, v - y as f32);
        let stride = self.size + 2;
        let first = (face * stride + y) * stride + x;
        let top = self.texels[first].lerp(self.texels[first + 1], fx);
        let bottom = self.texels[first + stride].lerp(self.texels[first + stride + 1], fx);
        top.lerp(bottom, fy)
    }

    /// The next level: means of 2x2 texels, weighted by their solid angles.
    fn halve(&self) -> Self {
        let (size, half, stride) = (self.size, self.size / 2, self.size + 2);
        let weights: Vec<f32> =
            (0..size * size).map(|i| texel_solid_angle(size, i % size, i / size) as f32).collect();
        let faces: Vec<Vec4> = (0..FACES * half * half)
            .map(|i| {
                let (face, x, y) = (i / (half * half), i % half, i / half % half);
                let (mut sum, mut total) = (Vec4::ZERO, 0.0);
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    let (x, y) = (2 * x + dx, 2 * y + dy);
                    let weight = weights[y * size + x];
                    sum += self.texels[(face * stride + y + 1) * stride + x + 1] * weight;
                    total += weight;
                }
                sum / total
            })
            .collect();
        Self::new(half, &faces)
    }
}

impl Pyramid {
    /// The sky: each texel is the mean radiance over its solid angle, at every level.
    fn from_map(map: &Equirect, size: usize) -> Self {
        let points = SKY_SUPERSAMPLES;
        let base: Vec<Vec4> = (0..FACES * size * size)
            .into_par_iter()
            .map(|i| {
                let (face, x, y) = (i / (size * size), i % size, i / size % size);
                let (mut sum, mut total) = ([0.0; 3], 0.0);
                for k in 0..points * points {
                    let at = |texel: usize, k: usize| {
                        2.0 * (texel as f64 + (k as f64 + 0.5) / points as f64) / size as f64 - 1.0
                    };
                    let (s, t) = (at(x, k % points), at(y, k / points));
                    // Solid angle per area of the face.
                    let distance2 = 1.0 + s * s + t * t;
                    let weight = 1.0 / (distance2 * distance2.sqrt());
                    let (u, v) = equirect_from_direction(cube_direction(face, s, t));
                    for (sum, value) in sum.iter_mut().zip(map.sample(u, v)) {
                        *sum += weight * value;
                    }
                    total += weight;
                }
                let [r, g, b] = sum.map(|v| (v / total) as f32);
                Vec4::new(r, g, b, 1.0)
            })
            .collect();
        let mut levels = vec![Level::new(size, &base)];
        while let Some(upper) = levels.last().filter(|lower| lower.size > 1).map(Level::halve) {
            levels.push(upper);
        }
        Self { levels }
    }

    fn cube(&self) -> CubeMap {
        let size = self.levels.first().map_or(0, |level| level.size) as u32;
        CubeMap { size, levels: self.levels.iter().map(|level| level.faces().map(texel).collect()).collect() }
    }
}

fn texel_solid_angle(size: usize, x: usize, y: usize) -> f64 {
    cube_solid_angle([edge(size, x), edge(size, x + 1)], [edge(size, y), edge(size, y + 1)])
}

/// Radiance convolved with GGX by importance sampling, under the split-sum's assumption that normal, view and
/// reflection coincide (B. Karis, "Real Shading in Unreal Engine 4", 2013).
fn specular(sky: &Pyramid) -> CubeMap {
    let levels = SPECULAR_SAMPLES
        .iter()
        .enumerate()
        .map(|(level, samples)| {
            let size = SPECULAR_SIZE >> level;
            let roughness = level as f64 / (SPECULAR_LEVELS - 1) as f64;
            let lobe = Lobe::new(roughness, *samples, sky, size);
            (0..FACES * size * size)
                .into_par_iter()
                .map(|i| {
                    let normal = texel_direction(size, i / (size * size), i % size, i / size % size);
                    texel(lobe.convolve(sky, normal))
                })
                .collect()
        })
        .collect();
    CubeMap { size: SPECULAR_SIZE as u32, levels }
}

/// The directions, weights and sky levels with which a texel is convolved; the same for every texel of a level.
struct Lobe {
    samples: Vec<(Vec3, f32, usize)>,
}

impl Lobe {
    fn new(roughness: f64, count: u32, sky: &Pyramid, size: usize) -> Self {
        let sky_size = sky.levels.first().map_or(1, |level| level.size);
        let last = sky.levels.len().saturating_sub(1);
        // A mirror sees the sky at the resolution at which it is stored.
        if roughness <= 0.0 {
            return Self { samples: vec![(Vec3::Z, 1.0, (sky_size / size).max(1).ilog2() as usize)] };
        }
        let alpha2 = roughness.powi(4);
        let sky_texel = 4.0 * PI / (FACES * sky_size * sky_size) as f64;
        let mut samples: Vec<(Vec3, f32, usize)> = (0..count)
            .filter_map(|i| {
                let [u, v] = hammersley(i, count);
                // Half vector: density D(h) n·h.
                let cos2 = (1.0 - u) / (1.0 + (alpha2 - 1.0) * u);
                let n_dot_l = 2.0 * cos2 - 1.0;
                let (sin_azimuth, cos_azimuth) = (v * TAU).sin_cos();
                let radius = 2.0 * (cos2 * (1.0 - cos2).max(0.0)).sqrt();
                let light = DVec3::new(radius * cos_azimuth, radius * sin_azimuth, n_dot_l);
                // Density of the light's direction: D n·h / (4 v·h), and v = n.
                let d = alpha2 / (PI * (cos2 * (alpha2 - 1.0) + 1.0).powi(2));
                // Each sample stands for 1 / (count * density) of solid angle and sees the level whose texels are
                // as large, or the next (J. Krivanek and M. Colbert, "Real-time Shading with Filtered Importance
                // Sampling", 2008).
                let solid_angle = 4.0 / (f64::from(count) * d);
                let level = (0.5 * (solid_angle / sky_texel).log2()).ceil().clamp(0.0, last as f64);
                (n_dot_l > 0.0).then_some((light.as_vec3(), n_dot_l as f32, level as usize))
            })
            .collect();
        let total: f32 = samples.iter().map(|(_, weight, _)| weight).sum();
        for (_, weight, _) in &mut samples {
            *weight /= total;
        }
        Self { samples }
    }

    fn convolve(&self, sky: &Pyramid, normal: DVec3) -> Vec4 {
        let normal = normal.as_vec3();
        let (right, up) = normal.any_orthonormal_pair();
        self.samples
            .iter()
            .map(|&(light, weight, level)| {
                sky.levels[level].sample(right * light.x + up * light.y + normal * light.z) * weight
            })
            .sum()
    }
}

/// Irradiance / pi by direction of the normal.
///
/// The map is cut into patches of which the vector moments ∫ L ω dω are exact, one per colour. Above a normal's
/// horizon a patch contributes n · moment, exactly; only those that the horizon cuts are approximated, by smaller
/// patches. The same sum over a white map divides it, so that constant light stays constant.
fn irradiance(map: &Equirect) -> CubeMap {
    let patches = Patches::new(map);
    let size = IRRADIANCE_SIZE;
    let texels = (0..FACES * size * size)
        .into_par_iter()
        .map(|i| {
            texel(patches.irradiance(texel_direction(size, i / (size * size), i % size, i / size % size)))
        })
        .collect();
    CubeMap { size: size as u32, levels: vec![texels] }
}

/// ∫ (r, g, b, 1) ω dω: one component of ω each.
#[derive(Clone, Copy, Default)]
struct Moment {
    x: Vec4,
    y: Vec4,
    z: Vec4,
}

impl Moment {
    fn add(&mut self, other: &Self) {
        self.x += other.x;
        self.y += other.y;
        self.z += other.z;
    }

    /// n · moment; never negative for what lies above the horizon, and clamped for what does not.
    fn towards(&self, normal: Vec3) -> Vec4 {
        (self.x * normal.x + self.y * normal.y + self.z * normal.z).max(Vec4::ZERO)
    }
}

/// Moments of tiles, and of the patches in each.
struct Patches {
    tiles: Vec<Tile>,
}

struct Tile {
    centre: Vec3,
    sin_radius: f32,
    moment: Moment,
    patches: Vec<Moment>,
}

impl Patches {
    fn new(map: &Equirect) -> Self {
        // Small maps are cut finer than their texels.
        let (columns, rows) = (PATCH_COLUMNS, PATCH_COLUMNS / 2);
        let cuts = columns.div_ceil(map.width);
        let (width, height) = (map.width * cuts, map.height * cuts);
        let across = columns / PATCHES_PER_TILE;
        let tile_rows: Vec<Vec<Tile>> = (0..rows / PATCHES_PER_TILE)
            .into_par_iter()
            .map(|tile_y| {
                let mut row: Vec<Tile> = (0..across).map(|tile_x| Tile::empty(tile_x, tile_y)).collect();
                // A cell belongs to the patch that its centre lies in: (2 y + 1) / (2 height) in [r, r + 1) / rows.
                let first = |r: usize| (2 * height * r / rows).div_ceil(2).min(height);
                for patch_y in tile_y * PATCHES_PER_TILE..(tile_y + 1) * PATCHES_PER_TILE {
                    for y in first(patch_y)..first(patch_y + 1) {
                        for x in 0..width {
                            let patch_x = (2 * x + 1) * columns / (2 * width);
                            let rgb = map.texels[y / cuts * map.width + x / cuts];
                            let moment = cell_moment(rgb, [x, width], [y, height]);
                            let inside =
                                patch_y % PATCHES_PER_TILE * PATCHES_PER_TILE + patch_x % PATCHES_PER_TILE;
                            row[patch_x / PATCHES_PER_TILE].patches[inside].add(&moment);
                        }
                    }
                }
                row
            })
            .collect();
        let mut tiles: Vec<Tile> = tile_rows.into_iter().flatten().collect();
        for tile in &mut tiles {
            for patch in &tile.patches {
                tile.moment.add(patch);
            }
        }
        Self { tiles }
    }

    fn irradiance(&self, normal: DVec3) -> Vec4 {
        let normal = normal.as_vec3();
        let mut sum = Vec4::ZERO;
        for tile in &self.tiles {
            let height = tile.centre.dot(normal);
            if height >= tile.sin_radius {
                sum += tile.moment.towards(normal);
            } else if height > -tile.sin_radius {
                for patch in &tile.patches {
                    sum += patch.towards(normal);
                }
            }
        }
        sum / sum.w
    }
}

impl Tile {
    fn empty(x: usize, y: usize) -> Self {
        let step = TAU / (PATCH_COLUMNS / PATCHES_PER_TILE) as f64;
        let (azimuth, polar) = ((x as f64 + 0.5) * step - PI, (y as f64 + 0.5) * step);
        let centre = DVec3::new(polar.sin() * azimuth.cos(), polar.cos(), polar.sin() * azimuth.sin());
        Self {
            centre: centre.as_vec3(),
            // Half the diagonal, and a cell more: cells belong to the patch of their centre.
            sin_radius: (0.75 * step).sin() as f32 * std::f32::consts::SQRT_2,
            moment: Moment::default(),
            patches: vec![Moment::default(); PATCHES_PER_TILE * PATCHES_PER_TILE],
        }
    }
}

/// The moment of cell `x` of `width` by `y` of `height`, with colour `rgb`: the integral of ω over the rectangle of
/// azimuths and polar angles, in closed form.
fn cell_moment(rgb: [f32; 3], [x, width]: [usize; 2], [y, height]: [usize; 2]) -> Moment {
    let azimuth = |x: usize| (x as f64 / width as f64 - 0.5) * TAU;
    let polar = |y: usize| y as f64 / height as f64 * PI;
    let (a0, a1, p0, p1) = (azimuth(x), azimuth(x + 1), polar(y), polar(y + 1));
    // ∫ sin² and ∫ sin cos over the polar angle.
    let sin2 = 0.5 * (p1 - p0) - 0.25 * ((2.0 * p1).sin() - (2.0 * p0).sin());
    let sin_cos = 0.25 * ((2.0 * p0).cos() - (2.0 * p1).cos());
    let light = Vec4::new(rgb[0], rgb[1], rgb[2], 1.0);
    Moment {
        x: light * (sin2 * (a1.sin() - a0.sin())) as f32,
        y: light * (sin_cos * (a1 - a0)) as f32,
        z: light * (sin2 * (a0.cos() - a1.cos())) as f32,
    }
}
