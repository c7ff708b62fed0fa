//! Numbers and vectors of four places at once.
//!
//! A number of each of four places is a component of a [`Vec4`], which every target adds, multiplies and divides in the same way,
//! place by place: results depend neither on the instruction set nor on the other three.

use std::ops::{Add, Mul, Sub};

use glam::{BVec4A, DVec3, Mat4, Vec4};

use evis_core::luminance::LUMINANCE_WEIGHTS;

/// Vectors shorter than this have no direction.
const NO_LENGTH: f32 = 1e-12;
/// What is added to a number rounds it to a whole one, which its last bits then are.
const WHOLE: f32 = 12_582_912.0;

/// A vector, or a colour, of each of four places.
#[derive(Clone, Copy, Debug, Default)]
pub struct Four {
    /// First components.
    pub x: Vec4,
    /// Second ones.
    pub y: Vec4,
    /// Third ones.
    pub z: Vec4,
}

impl Four {
    /// 1, 1, 1.
    pub const ONE: Self = Self { x: Vec4::ONE, y: Vec4::ONE, z: Vec4::ONE };

    /// The same at all of them.
    #[inline(always)]
    pub fn splat(v: DVec3) -> Self {
        let [x, y, z] = v.to_array().map(|v| Vec4::splat(v as f32));
        Self { x, y, z }
    }

    /// The first three components of a vector for each place.
    #[inline(always)]
    pub fn of(each: [Vec4; 4]) -> Self {
        let [a, b, c, d] = each;
        let turned = Mat4::from_cols(a, b, c, d).transpose();
        Self { x: turned.x_axis, y: turned.y_axis, z: turned.z_axis }
    }

    /// Inner products.
    #[inline(always)]
    pub fn dot(self, other: Self) -> Vec4 {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// Cross products.
    #[inline(always)]
    pub fn cross(self, other: Self) -> Self {
        Self {
            x: self.y * other.z - self.z * other.y,
            y: self.z * other.x - self.x * other.z,
            z: self.x * other.y - self.y * other.x,
        }
    }

    /// Of length 1; `other` where there is no direction.
    #[inline(always)]
    pub fn normalize_or(self, other: Self) -> Self {
        let length = self.dot(self).sqrt();
        let unit = self * length.max(Vec4::splat(NO_LENGTH)).recip();
        Self::select(length.cmpgt(Vec4::splat(NO_LENGTH)), unit, other)
    }

    /// `yes` where `mask` holds, else `no`.
    #[inline(always)]
    pub fn select(mask: BVec4A, yes: Self, no: Self) -> Self {
        Self {
            x: Vec4::select(mask, yes.x, no.x),
            y: Vec4::select(mask, yes.y, no.y),
            z: Vec4::select(mask, yes.z, no.z),
        }
    }

    /// Colours' luminances.
    #[inline(always)]
    pub fn luminance(self) -> Vec4 {
        let [r, g, b] = LUMINANCE_WEIGHTS.map(|w| w as f32);
        self.x * r + self.y * g + self.z * b
    }
}

impl Add for Four {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self { x: self.x + other.x, y: self.y + other.y, z: self.z + other.z }
    }
}

impl Sub for Four {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self { x: self.x - other.x, y: self.y - other.y, z: self.z - other.z }
    }
}

impl Mul for Four {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self { x: self.x * other.x, y: self.y * other.y, z: self.z * other.z }
    }
}

impl Mul<Vec4> for Four {
    type Output = Self;

    #[inline(always)]
    fn mul(self, by: Vec4) -> Self {
        Self { x: self.x * by, y: self.y * by, z: self.z * by }
    }
}

impl Mul<f32> for Four {
    type Output = Self;

    #[inline(always)]
    fn mul(self, by: f32) -> Self {
        Self { x: self.x * by, y: self.y * by, z: self.z * by }
    }
}

/// Whole numbers, far below a million, that are nearest to `v`.
#[inline(always)]
pub fn whole(v: Vec4) -> [i32; 4] {
    (v + WHOLE).to_array().map(|v| v.to_bits().wrapping_sub(WHOLE.to_bits()) as i32)
}

/// Whole numbers and rests of at least 0 and at most 1 that add up to `v`, which is far below a million.
#[inline(always)]
pub fn parts(v: Vec4) -> ([i32; 4], Vec4) {
    let lower = v - 0.5;
    (whole(lower), v - ((lower + WHOLE) - WHOLE))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_add_up() {
        for k in -4000..4000 {
            let v = k as f32 * 0.125;
            let (whole, rest) = parts(Vec4::new(v, v + 1e-3, v - 1e-3, v + 1e4));
            for (k, wanted) in [v, v + 1e-3, v - 1e-3, v + 1e4].into_iter().enumerate() {
                assert!((whole[k] as f32 + rest[k] - wanted).abs() < 1e-7 * (1.0 + wanted.abs()));
                assert!((0.0..=1.0).contains(&rest[k]), "{wanted}: {whole:?} {rest}");
            }
        }
        assert_ne!(parts(Vec4::splat(0.7)).0, parts(Vec4::splat(1.2)).0);
    }
}
