//! Light from all around, laid out for many look-ups: faces of cubes in 32 bits, with a border of their neighbours' texels.

use evis_scene::environment::{CubeMap, Environment, FACES, cube_coordinates, cube_direction};
use glam::Vec4;

use crate::fours::{Four, parts, whole};
use crate::packed::as_floats;

/// What [`Environment::diffuse`] and [`Environment::reflection`] say.
pub struct Surroundings {
    irradiance: Cube,
    specular: Cube,
    /// Sine and cosine of the turn about +Y.
    turn: [f64; 2],
}

impl Surroundings {
    /// Those of `environment`.
    pub fn new(environment: &Environment) -> Self {
        let (sin, cos) = (-f64::from(environment.rotation)).sin_cos();
        Self {
            irradiance: Cube::new(&environment.irradiance, environment.intensity),
            specular: Cube::new(&environment.specular, environment.intensity),
            turn: [sin, cos],
        }
    }

    /// Irradiance / pi on surfaces with these world normals.
    #[inline(always)]
    pub fn diffuse_of_four(&self, normal: Four) -> Four {
        let Some(level) = self.irradiance.levels.first() else { return Four::default() };
        CubePlaces::new(self.four_turned(normal)).on([level; 4])
    }

    /// Radiance around world directions as surfaces of perceptual roughness `roughness` reflect it.
    #[inline(always)]
    pub fn reflection_of_four(&self, direction: Four, roughness: Vec4) -> Four {
        let levels = &self.specular.levels;
        let Some(last) = levels.len().checked_sub(1) else { return Four::default() };
        let places = CubePlaces::new(self.four_turned(direction));
        let (lower, blend) = parts(roughness.clamp(Vec4::ZERO, Vec4::ONE) * last as f32);
        let lower = lower.map(|number| (number as u32 as usize).min(last));
        let sharper = places.on(lower.map(|number| &levels[number]));
        let duller = places.on(lower.map(|number| &levels[(number + 1).min(last)]));
        sharper + (duller - sharper) * blend
    }

    #[inline(always)]
    fn four_turned(&self, v: Four) -> Four {
        let [sin, cos] = self.turn.map(|v| v as f32);
        Four { x: v.x * cos + v.z * sin, y: v.y, z: v.z * cos - v.x * sin }
    }
}

impl Surroundings {
    /// Appends what a device needs of it to `rows`, whose own begin at `first`, with three in front of these of which it fills in the
    /// first two; see [`crate::packed::Textures`].
    pub fn pack(&self, rows: &mut Vec<[f32; 4]>, first: usize) {
        let [sin, cos] = self.turn;
        rows[first + 1] = [sin as f32, cos as f32, 0.0, 0.0];
        let heads = rows.len();
        rows.resize(heads + self.specular.levels.len(), [0.0; 4]);
        let mut append = |level: &Level| {
            let at = (rows.len() - first) as u32;
            rows.extend(level.texels.iter().map(|texel| texel.to_array()));
            [at, level.size as u32]
        };
        let irradiance = self.irradiance.levels.first().map_or([0, 1], &mut append);
        let levels: Vec<[u32; 2]> = self.specular.levels.iter().map(&mut append).collect();
        let count = levels.len() as u32;
        rows[first] = as_floats([irradiance[0], irradiance[1], count, 0]);
        for (row, [at, size]) in rows[heads..].iter_mut().zip(levels) {
            *row = as_floats([at, size, 0, 0]);
        }
    }
}

struct Cube {
    levels: Vec<Level>,
}

struct Level {
    size: usize,
    /// Half of it.
    half: f32,
    /// Per face, rows of `size` + 2 texels.
    texels: Vec<Vec4>,
}

impl Cube {
    fn new(map: &CubeMap, intensity: f32) -> Self {
        let level = |(number, texels): (usize, &Vec<[half::f16; 4]>)| {
            let size = map.level_size(number);
            let value = |index: usize| {
                let texel = texels.get(index).copied().unwrap_or_default();
                Vec4::from_array(texel.map(|v| v.to_f32())) * intensity
            };
            Level::new(size, value)
        };
        Self { levels: map.levels.iter().enumerate().map(level).collect() }
    }
}

impl Level {
    /// Of faces of `size` texels a side, which `value` gives by their number.
    fn new(size: usize, value: impl Fn(usize) -> Vec4) -> Self {
        let n = size as i64;
        let stride = size + 2;
        let mut texels = vec![Vec4::ZERO; FACES * stride * stride];
        // Within a face, or on the neighbour that a place beyond an edge is projected on.
        let near = |face: usize, x: i64, y: i64| {
            let centre = |k: i64| (2 * k + 1) as f64 / size as f64 - 1.0;
            let (face, s, t) = cube_coordinates(cube_direction(face, centre(x), centre(y)));
            let index = |c: f64| (((c + 1.0) * 0.5 * size as f64) as usize).min(size - 1);
            value((face * size + index(t)) * size + index(s))
        };
        for face in 0..FACES {
            for y in -1..=n {
                for x in -1..=n {
                    let slot = (face * stride + (y + 1) as usize) * stride + (x + 1) as usize;
                    let inside = |k: i64| (0..n).contains(&k);
                    texels[slot] = match (inside(x), inside(y)) {
                        (true, true) => value((face * size + y as usize) * size + x as usize),
                        (false, false) => {
                            // Three faces meet there, and there is no fourth texel: it is their mean.
                            let (i, j) = (x.clamp(0, n - 1), y.clamp(0, n - 1));
                            (near(face, i, j) + near(face, x, j) + near(face, i, y)) / 3.0
                        }
                        _ => near(face, x, y),
                    };
                }
            }
        }
        Self { size, half: 0.5 * size as f32, texels }
    }

    /// Between the texels at (face, row, column) with its border and those after it, this far from the first.
    #[inline(always)]
    fn between(&self, [face, row, column]: [usize; 3], [fx, fy]: [f32; 2]) -> Vec4 {
        let stride = self.size + 2;
        let first = face.wrapping_mul(stride).wrapping_add(row).wrapping_mul(stride).wrapping_add(column);
        let (upper, lower) = (&self.texels[first..][..2], &self.texels[first.wrapping_add(stride)..][..2]);
        let (a, b) = (upper[0].lerp(upper[1], fx), lower[0].lerp(lower[1], fx));
        a.lerp(b, fy)
    }
}

/// Four places on the faces of a cube.
struct CubePlaces {
    face: [i32; 4],
    s: Vec4,
    t: Vec4,
}

impl CubePlaces {
    /// Where four directions meet it, as [`cube_coordinates`] has it.
    #[inline(always)]
    fn new(direction: Four) -> Self {
        let Four { x, y, z } = direction;
        let (ax, ay, az) = (x.abs(), y.abs(), z.abs());
        let on_z = az.cmpge(ax) & az.cmpge(ay);
        let on_y = ay.cmpge(ax);
        let of = |[on_x, on_y_face, on_z_face]: [Vec4; 3]| {
            Vec4::select(on_z, on_z_face, Vec4::select(on_y, on_y_face, on_x))
        };
        let major = of([x, y, z]);
        let behind = major.cmplt(Vec4::ZERO);
        let flipped = |v: Vec4| Vec4::select(behind, -v, v);
        let inverse = major.abs().max(Vec4::splat(f32::MIN_POSITIVE)).recip();
        let s = of([flipped(-z), x, flipped(x)]) * inverse;
        let t = of([-y, flipped(z), -y]) * inverse;
        let face = of([0.0, 2.0, 4.0].map(Vec4::splat)) + Vec4::select(behind, Vec4::ONE, Vec4::ZERO);
        Self { face: whole(face), s, t }
    }

    /// What each of four levels has there.
    #[inline(always)]
    fn on(&self, levels: [&Level; 4]) -> Four {
        let half = Vec4::from_array(levels.map(|level| level.half));
        // From the middle of the border's first texel.
        let place = |v: Vec4| parts((v + 1.0) * half + 0.5);
        let ((columns, fx), (rows, fy)) = (place(self.s), place(self.t));
        let (fx, fy) = (fx.to_array(), fy.to_array());
        let mut each = [Vec4::ZERO; 4];
        for (k, texel) in each.iter_mut().enumerate() {
            let at = [self.face[k], rows[k], columns[k]].map(|v| v as u32 as usize);
            *texel = levels[k].between(at, [fx[k], fy[k]]);
        }
        Four::of(each)
    }
}

/// The same at one place, in 64 bits: what tests hold four places at once to.
#[cfg(test)]
mod exact {
    use glam::DVec3;

    use super::*;

    impl Surroundings {
        /// Irradiance / pi on a surface with world normal `normal`.
        pub fn diffuse(&self, normal: DVec3) -> DVec3 {
            self.irradiance.levels.first().map_or(DVec3::ZERO, |level| wide(level.at(self.turned(normal))))
        }

        /// Radiance around world direction `direction` as a surface of perceptual roughness `roughness` reflects it.
        pub fn reflection(&self, direction: DVec3, roughness: f64) -> DVec3 {
            let levels = &self.specular.levels;
            let Some(last) = levels.len().checked_sub(1) else { return DVec3::ZERO };
            let at = roughness.clamp(0.0, 1.0) * last as f64;
            let (lower, blend) = (at as usize, at - at.floor());
            let direction = self.turned(direction);
            let value = levels[lower].at(direction);
            if blend == 0.0 {
                return wide(value);
            }
            wide(value.lerp(levels[lower + 1].at(direction), blend as f32))
        }

        fn turned(&self, v: DVec3) -> DVec3 {
            let [sin, cos] = self.turn;
            DVec3::new(cos * v.x + sin * v.z, v.y, cos * v.z - sin * v.x)
        }
    }

    fn wide(v: Vec4) -> DVec3 {
        v.truncate().as_dvec3()
    }

    impl Level {
        pub(super) fn at(&self, direction: DVec3) -> Vec4 {
            let (face, s, t) = cube_coordinates(direction);
            let half = 0.5 * self.size as f64;
            // From the middle of the border's first texel.
            let (u, v) = ((s + 1.0) * half + 0.5, (t + 1.0) * half + 0.5);
            let (x, y) = ((u as usize).min(self.size), (v as usize).min(self.size));
            let (fx, fy) = ((u - x as f64) as f32, (v - y as f64) as f32);
            self.between([face, y, x], [fx, fy])
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    #[test]
    fn at_a_corner_of_the_cube_light_is_the_mean_of_three_faces() {
        const SIZE: usize = 4;
        for corner in 0..8 {
            let signs = [0, 1, 2].map(|axis| if corner >> axis & 1 == 0 { 1.0 } else { -1.0 });
            let direction = DVec3::from_array(signs);
            // Of each face the texel at the corner has light of its own, which sums keep apart; the others have far more.
            let value = |index: usize| {
                let centre = |k: usize| (2 * k + 1) as f64 / SIZE as f64 - 1.0;
                let (face, s, t) = (index / SIZE.pow(2), centre(index % SIZE), centre(index / SIZE % SIZE));
                let nearest = cube_direction(face, s, t).normalize().dot(direction.normalize()) > 0.95;
                Vec4::splat(if nearest { (1 << face) as f32 } else { 1e6 })
            };
            let light = Level::new(SIZE, value).at(direction);
            let faces = (0..3).map(|axis| 2 * axis + (corner >> axis & 1));
            let mean = faces.map(|face| (1 << face) as f32).sum::<f32>() / 3.0;
            assert!((light - Vec4::splat(mean)).abs().max_element() < 1e-5, "{signs:?}: {light}, not {mean}");
        }
    }

    #[test]
    fn light_from_all_around_is_the_scenes() {
        // Noise, so that neighbours differ.
        let value =
            |i: u32| ((i.wrapping_mul(747_796_405) ^ 0x9e37_79b9).wrapping_mul(2_891_336_453) >> 8) as f32;
        let texels = (0..32 * 16).map(|i| [0, 1, 2].map(|c| value(3 * i + c) / (1 << 20) as f32)).collect();
        let mut environment = Environment::from_equirect("noise", 32, texels, &mut Vec::new()).unwrap();
        environment.rotation = 0.7;
        environment.intensity = 1.5;
        let found = Surroundings::new(&environment);
        let mut canary: f64 = 0.0;
        let mut four = [(DVec3::ZERO, 0.0); 4];
        for k in 0..4000 {
            let f = f64::from(k);
            let z = 2.0 * ((f * 0.618_033_988_7).fract()) - 1.0;
            let (sin, cos) = (f * 2.399_963).sin_cos();
            // Some along faces' edges and corners.
            let direction = match k % 8 {
                0 => DVec3::new(1.0, -1.0, z),
                1 => DVec3::new(1.0, 1.0, 0.99 + 0.01 * z),
                _ => DVec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z),
            }
            .normalize();
            let roughness = (f * 0.37).fract();
            for (found, wanted) in [
                (found.diffuse(direction), environment.diffuse(direction)),
                (found.reflection(direction, roughness), environment.reflection(direction, roughness)),
            ] {
                let off = (found - wanted).abs().max_element();
                assert!(
                    off <= 2e-6 * (1.0 + wanted.max_element()),
                    "{direction} {roughness}: {found}, not {wanted}"
                );
            }
            canary = canary.max((found.diffuse(direction) - found.diffuse(-direction)).length());
            // Four at once.
            four[k as usize % 4] = (direction, roughness);
            if k % 4 == 3 {
                let directions = Four::of(four.map(|(direction, _)| direction.as_vec3().extend(0.0)));
                let roughness = Vec4::from_array(four.map(|(_, roughness)| roughness as f32));
                let pair =
                    [found.diffuse_of_four(directions), found.reflection_of_four(directions, roughness)];
                for (number, (direction, roughness)) in four.iter().enumerate() {
                    let wanted = [found.diffuse(*direction), found.reflection(*direction, *roughness)];
                    for (found, wanted) in pair.iter().zip(wanted) {
                        let found = [found.x, found.y, found.z].map(|v| f64::from(v[number]));
                        let off = (DVec3::from_array(found) - wanted).abs().max_element();
                        assert!(
                            off < 1e-3 * (1.0 + wanted.max_element()),
                            "{direction}: {found:?}, not {wanted}"
                        );
                    }
                }
            }
        }
        assert!(canary > 0.1, "it is not the same all around: {canary}");
    }
}
