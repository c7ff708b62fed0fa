//! Between which luminances the light of a facet stays during a block.
//!
//! A facet sends `linear * base + constant`, of the lamps that reach it: that lies between the least and the most that these and base
//! colours allow.

use glam::{DVec3, Vec4};

/// Light of a facet in a tile throughout a block, where no shadow falls: least and most.
#[derive(Clone, Copy, Debug)]
pub struct Bounds<const LAMPS: usize> {
    /// Of what no shadow falls on.
    pub steady: [f64; 2],
    /// Of each lamp that is kept apart.
    pub own: [[f64; 2]; LAMPS],
}

/// Least and greatest `linear * base + constant` of such factors between two, and base colours between two.
pub fn luminances([low, high]: [Vec4; 2], base: [DVec3; 2]) -> [f64; 2] {
    let node = |k: usize| [low[k], high[k]].map(f64::from);
    (0..3).fold(node(3), |sum, k| {
        let [least, most] = product(node(k), base.map(|b| b[k]));
        [sum[0] + least, sum[1] + most]
    })
}

/// Least and greatest product of a number between two, and another one between two.
pub fn product([a, b]: [f64; 2], [c, d]: [f64; 2]) -> [f64; 2] {
    let products = [a * c, a * d, b * c, b * d];
    [f64::min, f64::max].map(|of| products.into_iter().fold(products[0], of))
}
