//! Lights that throw shadows: where what moves may darken what is seen.

use evis_scene::{LightKind, Scene, SceneState};
use glam::DVec3;

use crate::shadow::plan::LightView;
use crate::world::image_bounds::{Corners, bounds, corners};

/// Texels around a shadow's border that it may reach (`raster/shadow.wgsl`): of a lookup of 2x2 texels, the farthest has its
/// centre within one along each axis, and a comparison is up to 1.1 off its place.
const MARGIN_TEXELS: f64 = 3.0;

/// The least and greatest of `points` along `axis`.
pub fn extent(points: &[DVec3], axis: DVec3) -> [f64; 2] {
    points.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], point| {
        let at = axis.dot(*point);
        [low.min(at), high.max(at)]
    })
}

/// A light that throws shadows. `texel`: world size of its map's texels, at a distance of 1 for a spot light.
#[derive(Clone, Copy)]
pub enum Lamp {
    /// From a place.
    Spot {
        /// In the world.
        position: DVec3,
        /// Metres per metre.
        texel: f64,
    },
    /// From everywhere the same way.
    Directional {
        /// The way light takes.
        along: DVec3,
        /// Metres.
        texel: f64,
    },
}

impl Lamp {
    /// The light at `node`, whose map sees `view`.
    pub fn new(scene: &Scene, state: &SceneState, node: usize, view: &LightView) -> Option<Self> {
        let light = &scene.lights[scene.nodes[node].light?];
        let world = &state.world_from_node[node];
        let texel = view.texel;
        Some(match light.kind {
            LightKind::Directional => {
                let along = (-world.z_axis.truncate()).normalize_or(DVec3::NEG_Z);
                Self::Directional { along, texel }
            }
            LightKind::Point | LightKind::Spot { .. } => {
                Self::Spot { position: world.w_axis.truncate(), texel }
            }
        })
    }

    /// The box of `caster`, grown by what a lookup in the map may reach; `None` where the light is in it.
    pub fn grown(&self, caster: &[DVec3]) -> Option<Corners> {
        let (low, high) = bounds(caster);
        let texels = match *self {
            // Along the axis a distance is no more than in space.
            Self::Spot { position, texel } => {
                texel * caster.iter().map(|c| c.distance(position)).fold(0.0, f64::max)
            }
            Self::Directional { texel, .. } => texel,
        };
        let grow = DVec3::splat(MARGIN_TEXELS * texels);
        let (low, high) = (low - grow, high + grow);
        let inside = matches!(*self, Self::Spot { position, .. }
            if (low - position).max(position - high).max_element() <= 0.0);
        (!inside).then(|| corners(low, high))
    }

    /// From where to where along its way light through the hull of `caster` may be where something receives it, whose least
    /// and greatest extents along axes are `receiver`: in distances from the light (spot) or metres (directional).
    pub fn reach(&self, caster: &Corners, receiver: &[(DVec3, [f64; 2])]) -> Option<[f64; 2]> {
        let (mut enter, mut leave) = match self {
            Self::Spot { .. } => (1.0_f64, f64::INFINITY),
            Self::Directional { .. } => (0.0, 1e6),
        };
        for (axis, [near, far]) in receiver {
            let (near, far) = (*near, *far);
            let [low, high] = extent(caster, *axis);
            let (first, last) = match *self {
                Self::Spot { position, .. } => {
                    let origin = axis.dot(position);
                    let (low, high, near, far) = (low - origin, high - origin, near - origin, far - origin);
                    if low > 0.0 {
                        (near / high, far / low)
                    } else if high < 0.0 {
                        (far / low, near / high)
                    } else {
                        // Where the sign is open, this axis says nothing.
                        continue;
                    }
                }
                // Lengths t with low + t step <= far and high + t step >= near.
                Self::Directional { along, .. } => {
                    let step = axis.dot(along);
                    let (a, b) = (near - high, far - low);
                    if step.abs() < 1e-12 {
                        if a > 0.0 || b < 0.0 {
                            return None;
                        }
                        continue;
                    }
                    if step > 0.0 { (a / step, b / step) } else { (b / step, a / step) }
                }
            };
            enter = enter.max(first);
            leave = leave.min(last);
        }
        let reach = [enter, leave].map(|s| if s.is_finite() { s } else { 1e6 });
        (enter <= leave).then_some(reach)
    }

    /// How much longer what goes across the light is there.
    pub const fn growth(&self, by: f64) -> f64 {
        match self {
            Self::Spot { .. } => by,
            Self::Directional { .. } => 1.0,
        }
    }

    /// Which way light goes at `point`.
    pub fn direction(&self, point: DVec3) -> DVec3 {
        match *self {
            Self::Spot { position, .. } => (point - position).normalize_or_zero(),
            Self::Directional { along, .. } => along,
        }
    }

    /// Where light through `point` is, so far along its way as [`Self::reach`] counts it.
    pub fn carry(&self, point: DVec3, by: f64) -> DVec3 {
        match *self {
            Self::Spot { position, .. } => position + by * (point - position),
            Self::Directional { along, .. } => point + by * along,
        }
    }

    /// The hull of what `caster` may darken within `receiver`; `None` where nothing.
    pub fn shadow(&self, caster: &Corners, receiver: (DVec3, DVec3)) -> Option<Vec<DVec3>> {
        let Some(caster) = self.grown(caster) else {
            return Some(corners(receiver.0, receiver.1).to_vec());
        };
        let slabs = DVec3::AXES.map(|axis| (axis, [axis.dot(receiver.0), axis.dot(receiver.1)]));
        let reach = self.reach(&caster, &slabs)?;
        Some(reach.iter().flat_map(|by| caster.map(|c| self.carry(c, *by))).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shadows_fall_where_light_through_the_caster_falls() {
        // Points between a lamp and a receiver, through a caster, in a fixed order: each is inside the hull's bounds.
        let (low, high) = (DVec3::new(-0.3, 1.0, 0.2), DVec3::new(0.4, 1.6, 0.9));
        let receiver = (DVec3::new(-6.0, -0.1, -5.0), DVec3::new(7.0, 0.1, 8.0));
        for lamp in [
            Lamp::Spot { position: DVec3::new(1.0, 4.0, -0.5), texel: 0.0 },
            Lamp::Spot { position: DVec3::new(0.1, 1.9, 0.5), texel: 0.0 },
            Lamp::Directional { along: DVec3::new(0.3, -0.9, 0.4), texel: 0.0 },
        ] {
            let hull = bounds(&lamp.shadow(&corners(low, high), receiver).unwrap());
            let mut fallen = 0;
            for i in 0..1000 {
                let part = |digit: i32| f64::from(i / 10_i32.pow(digit as u32) % 10) / 9.0;
                let through = low + (high - low) * DVec3::new(part(0), part(1), part(2));
                let way = match lamp {
                    Lamp::Spot { position, .. } => through - position,
                    Lamp::Directional { along, .. } => along,
                };
                let ground = through - way * (through.y / way.y);
                if way.y < 0.0 && ground.cmpge(receiver.0).all() && ground.cmple(receiver.1).all() {
                    fallen += 1;
                    assert!((ground - hull.0).min_element() > -1e-9, "{ground} outside of {hull:?}");
                    assert!((hull.1 - ground).min_element() > -1e-9, "{ground} outside of {hull:?}");
                }
            }
            assert!(fallen > 300, "{fallen}");
        }
        // Behind the caster is no shadow.
        let above = (DVec3::new(-1.0, 4.5, -1.0), DVec3::new(1.0, 5.0, 1.0));
        let spot = Lamp::Spot { position: DVec3::new(1.0, 4.0, -0.5), texel: 0.0 };
        assert!(spot.shadow(&corners(low, high), above).is_none());
    }
}
