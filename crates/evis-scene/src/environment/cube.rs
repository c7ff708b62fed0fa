//! Cube maps: the face table of WebGPU and Vulkan, and seamless trilinear sampling on the CPU.

use glam::{DVec3, Vec3, Vec4};
use half::f16;

/// Faces of a cube, in the order +X, -X, +Y, -Y, +Z, -Z.
pub const FACES: usize = 6;

/// A cube map: six square faces in the order +X, -X, +Y, -Y, +Z, -Z (the layout of Vulkan and WebGPU), per mip level.
///
/// Where texel (face, x, y) lies is said by [`cube_direction`].
#[derive(Clone, Debug, PartialEq)]
pub struct CubeMap {
    /// Edge of level 0, in texels.
    pub size: u32,
    /// Per level: six faces of `(size >> level)^2` linear RGBA texels, face after face.
    pub levels: Vec<Vec<[f16; 4]>>,
}

/// Direction (not normalised; its largest component is ±1) of the point (s, t) of `face`; s grows to the right of
/// the stored image and t down, both from -1 to 1. Faces above 5 are read as 5.
///
/// | face | direction |
/// |---|---|
/// | 0, +X | (1, -t, -s) |
/// | 1, -X | (-1, -t, s) |
/// | 2, +Y | (s, 1, t) |
/// | 3, -Y | (s, -1, -t) |
/// | 4, +Z | (s, -t, 1) |
/// | 5, -Z | (-s, -t, -1) |
///
/// Vulkan 1.3, 16.5.4 "Cube Map Face Selection and Transformations", solved for the direction; WebGPU and Direct3D
/// have the same table. Seen from inside the cube the faces are mirrored: the table is left-handed by history.
pub fn cube_direction(face: usize, s: f64, t: f64) -> DVec3 {
    match face {
        0 => DVec3::new(1.0, -t, -s),
        1 => DVec3::new(-1.0, -t, s),
        2 => DVec3::new(s, 1.0, t),
        3 => DVec3::new(s, -1.0, -t),
        4 => DVec3::new(s, -t, 1.0),
        _ => DVec3::new(-s, -t, -1.0),
    }
}

/// Face and (s, t) of a direction: the inverse of [`cube_direction`]. On ties Z is taken before Y before X, as
/// Vulkan prescribes.
pub fn cube_coordinates(direction: DVec3) -> (usize, f64, f64) {
    let DVec3 { x, y, z } = direction;
    let (ax, ay, az) = (x.abs(), y.abs(), z.abs());
    let (face, major, s, t) = if az >= ax && az >= ay {
        if z >= 0.0 { (4, az, x, -y) } else { (5, az, -x, -y) }
    } else if ay >= ax {
        if y >= 0.0 { (2, ay, x, z) } else { (3, ay, x, -z) }
    } else if x >= 0.0 {
        (0, ax, -z, -y)
    } else {
        (1, ax, z, -y)
    };
    let scale = if major > 0.0 { major.recip() } else { 0.0 };
    (face, s * scale, t * scale)
}

/// Solid angle in steradians of the rectangle [s0, s1] x [t0, t1] of a face: exact.
pub fn cube_solid_angle(s: [f64; 2], t: [f64; 2]) -> f64 {
    // Solid angle of [0, x] x [0, y] on the plane at distance 1.
    let corner = |x: f64, y: f64| (x * y).atan2((x * x + y * y + 1.0).sqrt());
    corner(s[1], t[1]) - corner(s[0], t[1]) - corner(s[1], t[0]) + corner(s[0], t[0])
}

/// Face coordinate of the left edge of texel `index` of `size`; the right edge is that of `index + 1`.
pub(super) fn edge(size: usize, index: usize) -> f64 {
    2.0 * index as f64 / size as f64 - 1.0
}

/// Face coordinate of the centre of texel `index` of `size`; `index` may lie outside the face.
fn centre(size: usize, index: isize) -> f64 {
    (2.0 * index as f64 + 1.0) / size as f64 - 1.0
}

/// Unit direction of the centre of texel (x, y).
pub(super) fn texel_direction(size: usize, face: usize, x: usize, y: usize) -> DVec3 {
    cube_direction(face, centre(size, x as isize), centre(size, y as isize)).normalize()
}

/// Index of the texel that continues `face` at (x, y); across an edge it lies on the neighbouring face, and beyond
/// a corner, where three faces meet and no fourth texel exists, there is none.
pub(super) fn resolve(size: usize, face: usize, x: isize, y: isize) -> Option<usize> {
    let n = size as isize;
    let (inside_x, inside_y) = ((0..n).contains(&x), (0..n).contains(&y));
    let (face, x, y) = match (inside_x, inside_y) {
        (true, true) => (face, x as usize, y as usize),
        (false, false) => return None,
        _ => {
            // The face's plane, continued by one texel and projected on the neighbour, meets its first row at the
            // texel beside ours: along the edge the projection moves a point by less than half a texel.
            let (face, s, t) = cube_coordinates(cube_direction(face, centre(size, x), centre(size, y)));
            let index = |c: f64| (((c + 1.0) * 0.5 * size as f64).max(0.0) as usize).min(size - 1);
            (face, index(s), index(t))
        }
    };
    Some((face * size + y) * size + x)
}

/// The four texels around `direction` and their weights; beyond a corner the weight goes to the other three.
fn bilinear_taps(size: usize, direction: DVec3) -> [(usize, f64); 4] {
    let (face, s, t) = cube_coordinates(direction);
    let (u, v) = ((s + 1.0) * 0.5 * size as f64 - 0.5, (t + 1.0) * 0.5 * size as f64 - 0.5);
    let (x0, y0) = (u.floor(), v.floor());
    let (fx, fy) = (u - x0, v - y0);
    let (x0, y0) = (x0 as isize, y0 as isize);
    let weights = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
    let last = size as isize - 1;
    if x0 >= 0 && y0 >= 0 && x0 < last && y0 < last {
        let first = (face * size + y0 as usize) * size + x0 as usize;
        return [
            (first, weights[0]),
            (first + 1, weights[1]),
            (first + size, weights[2]),
            (first + size + 1, weights[3]),
        ];
    }
    let found = [
        resolve(size, face, x0, y0),
        resolve(size, face, x0 + 1, y0),
        resolve(size, face, x0, y0 + 1),
        resolve(size, face, x0 + 1, y0 + 1),
    ];
    let count = found.iter().flatten().count().max(1) as f64;
    let missing: f64 = found.iter().zip(weights).filter(|(f, _)| f.is_none()).map(|(_, w)| w).sum();
    let mut taps = [(0, 0.0); 4];
    for ((tap, found), weight) in taps.iter_mut().zip(found).zip(weights) {
        if let Some(index) = found {
            *tap = (index, weight + missing / count);
        }
    }
    taps
}

impl CubeMap {
    /// The same colour everywhere: one texel per face.
    pub fn uniform(rgb: [f32; 3]) -> Self {
        Self { size: 1, levels: vec![vec![texel(Vec3::from_array(rgb).extend(1.0)); FACES]] }
    }

    /// Unit direction of the centre of texel (x, y) of `face` in `level`.
    pub fn direction(&self, level: usize, face: usize, x: usize, y: usize) -> DVec3 {
        texel_direction(self.level_size(level), face, x, y)
    }

    /// Edge of `level` in texels.
    pub fn level_size(&self, level: usize) -> usize {
        (self.size as usize >> level.min(31)).max(1)
    }

    /// The texel of `face` at (x, y), which may be one beyond the face's edge: then it is of the face that continues there; beyond
    /// a corner, where three faces meet, there is none.
    pub fn texel(&self, level: usize, face: usize, x: isize, y: isize) -> Option<[f16; 4]> {
        let index = resolve(self.level_size(level), face, x, y)?;
        self.levels.get(level)?.get(index).copied()
    }

    /// Linear RGB at `direction` (any length but 0): bilinear across face edges (seamless: where three faces meet,
    /// the absent fourth texel is their mean, as Vulkan recommends), linear between levels, clamped to the levels
    /// that exist.
    pub fn sample(&self, direction: DVec3, level: f64) -> [f32; 3] {
        let last = self.levels.len().saturating_sub(1);
        let level = if level.is_finite() { level.clamp(0.0, last as f64) } else { 0.0 };
        let lower = (level as usize).min(last);
        let blend = level - lower as f64;
        let mut sum = self.bilinear(direction, lower);
        if blend > 0.0 {
            let upper = self.bilinear(direction, (lower + 1).min(last));
            sum = std::array::from_fn(|c| sum[c] + (upper[c] - sum[c]) * blend);
        }
        sum.map(|v| v as f32)
    }

    fn bilinear(&self, direction: DVec3, level: usize) -> [f64; 3] {
        let mut sum = [0.0; 3];
        let Some(texels) = self.levels.get(level) else { return sum };
        for (index, weight) in bilinear_taps(self.level_size(level), direction) {
            let Some(texel) = texels.get(index) else { continue };
            for (sum, value) in sum.iter_mut().zip(texel) {
                *sum += weight * value.to_f64();
            }
        }
        sum
    }
}

/// A stored texel; alpha is 1.
pub(super) fn texel(rgb: Vec4) -> [f16; 4] {
    let [r, g, b] = rgb.truncate().to_array().map(|v| f16::from_f32(v.clamp(0.0, f16::MAX.to_f32())));
    [r, g, b, f16::ONE]
}
