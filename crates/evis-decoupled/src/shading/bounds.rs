//! Between which luminances the light of a facet stays during a block.
//!
//! A facet sends `linear * base + constant`, of the lamps that reach it, interpolated between the nodes of its cells: that lies
//! between the least and the most that nodes and base colours allow.

use glam::DVec3;

/// Light of a facet in a tile throughout a block, where no shadow falls: least and most.
#[derive(Clone, Copy, Debug)]
pub struct Bounds<const LAMPS: usize> {
    /// Of what no shadow falls on.
    pub steady: [f64; 2],
    /// Of each lamp that is kept apart.
    pub own: [[f64; 2]; LAMPS],
}

/// Least and greatest values of `nodes`, of which each has as many as there are `lamps`.
pub fn ranges(nodes: &[[f32; 4]], lamps: usize) -> Box<[[[f32; 4]; 2]]> {
    let of = |lamp: usize| {
        let values = || nodes.iter().skip(lamp).step_by(lamps);
        let fold = |of: fn(f32, f32) -> f32| {
            std::array::from_fn(|k| values().map(|v| v[k]).reduce(of).unwrap_or_default())
        };
        [fold(f32::min), fold(f32::max)]
    };
    (0..lamps).map(of).collect()
}

/// Least and greatest `linear * base + constant` of a node between two, and base colours between two.
pub fn luminances([low, high]: [[f32; 4]; 2], base: [DVec3; 2]) -> [f64; 2] {
    let [low, high] = [low, high].map(|v| v.map(f64::from));
    let mut range = [low[3], high[3]];
    for k in 0..3 {
        let products = [low[k] * base[0][k], low[k] * base[1][k], high[k] * base[0][k], high[k] * base[1][k]];
        range[0] += products.into_iter().fold(f64::INFINITY, f64::min);
        range[1] += products.into_iter().fold(f64::NEG_INFINITY, f64::max);
    }
    range
}
