//! What happens in a pixel beside its light: how fast the image moves there, and in which region it lies.

use evis_core::Region;

use crate::clock::{Clock, Moment};
use crate::rays::caster::{Kind, seen_from};
use crate::rays::{Hit, Projection};
use crate::signal::at;

/// Rays per probe, along each side of the pixel.
const SIDE: usize = 4;
/// Half the time over which motion is measured, in microseconds: long enough for f64, short enough for any curve.
const HALF_US: f64 = 50.0;
/// What came into view within this time is disoccluded: a frame of 30 Hz, the longest gap between published keyframes.
const DISOCCLUSION_US: f64 = 33_333.0;
/// Part of the depth by which a surface is off the plane of its neighbour where one hides the other.
const DEPTH_JUMP: f64 = 0.02;

/// What a probe found.
#[derive(Clone, Copy, Debug, Default)]
pub struct Probe {
    /// Fastest image motion of anything seen in the pixel, in pixels per second.
    pub speed: f64,
    /// Where the pixel lies.
    pub region: Region,
}

/// Looks at pixel (x, y) at `t_us`; `now` is that moment.
pub fn probe(clock: &Clock, now: &Moment, t_us: f64, x: u16, y: u16) -> Probe {
    let points: Vec<[f64; 2]> = (0..SIDE * SIDE)
        .map(|i| [i % SIDE, i / SIDE].map(|k| (k as f64 + 0.5) / SIDE as f64 - 0.5))
        .collect();
    let rays: Vec<_> = points.iter().map(|o| now.camera.ray(at(x, y, *o))).collect();
    let hits: Vec<Option<Hit>> =
        points.iter().map(|o| now.caster.hit_at(&now.camera, at(x, y, *o))).collect();
    let kinds: Vec<Kind> = hits.iter().zip(&rays).map(|(hit, ray)| now.caster.kind_seen(*hit, ray)).collect();

    let (before, after) = (clock.at(t_us - HALF_US), clock.at(t_us + HALF_US));
    let speed = hits.iter().zip(&rays).map(|(hit, ray)| {
        let seen = |moment: &Moment| seen_from(*hit, ray, moment.caster.geometry(), &moment.camera);
        match (seen(&before), seen(&after)) {
            (Some(a), Some(b)) => (b[0] - a[0]).hypot(b[1] - a[1]) / (2.0 * HALF_US * 1e-6),
            _ => 0.0,
        }
    });
    let speed = speed.fold(0.0, f64::max);

    let outline = kinds.iter().any(|k| k.object != kinds[0].object)
        || hits.iter().zip(&rays).any(|(hit, ray)| {
            // Where the first sample's plane continues along this ray.
            let (Some(first), Some(hit)) = (hits[0], hit) else { return false };
            let [a, b, c] = now.caster.geometry().corners(first.triangle).map(|v| v.position);
            let normal = (b - a).cross(c - a);
            let expected = (a - ray.origin).dot(normal) / ray.direction.dot(normal);
            let [d, e, f] = now.caster.geometry().corners(hit.triangle).map(|v| v.position);
            let own = (e - d).cross(f - d);
            // Faces that meet in a ridge differ by less than a pixel's slope of either.
            let ridge = own.normalize_or_zero().dot(normal.normalize_or_zero()).abs() < 0.999;
            !ridge && (hit.distance - expected).abs() > DEPTH_JUMP * hit.distance
        });
    let shadow_edge = kinds
        .iter()
        .any(|k| kinds.iter().any(|o| o.object == k.object && o.face == k.face && o.shadows != k.shadows));

    // Whether what the middle shows was seen a moment ago.
    let middle = now.caster.hit_at(&now.camera, at(x, y, [0.0, 0.0]));
    let past = clock.at(t_us - DISOCCLUSION_US);
    let disoccluded = match middle {
        Some(hit) => {
            let target = past.caster.geometry().position(hit.triangle, hit.barycentric);
            !past.caster.sees(&past.camera, hit.triangle, target)
        }
        None => {
            let direction = now.camera.ray(at(x, y, [0.0, 0.0])).direction;
            past.camera.project_direction(direction).is_none_or(|[u, v]| {
                let inside = (0.0..past.camera.pinhole.lens.width.into()).contains(&u)
                    && (0.0..past.camera.pinhole.lens.height.into()).contains(&v);
                !inside || past.caster.hit_at(&past.camera, [u, v]).is_some()
            })
        }
    };
    let region = if disoccluded {
        Region::Disoccluded
    } else if shadow_edge {
        Region::ShadowEdge
    } else if outline {
        Region::Silhouette
    } else {
        Region::Interior
    };
    Probe { speed, region }
}
