//! What rendering needs of a lens: clip space, culling, motion in the picture.

use evis_scene::{PixelLens, Rays};
use glam::{DMat4, DVec2, DVec3, DVec4};

/// A lens as the rasteriser uses it.
pub trait RasterLens {
    /// Reverse z. Of central rays with an infinite far plane, z_ndc = near / depth; of parallel rays w = 1, and z_ndc falls from 1
    /// at the near plane to 0 at the far one.
    fn clip_from_camera(&self) -> DMat4;

    /// (x, y, 1 / depth, 1) of a pixel to clip space over depth, where rays are central.
    fn clip_from_pixels(&self) -> DMat4;

    /// Clip space to (x·w, y·w, _, w), in pixels.
    fn pixels_from_clip(&self) -> DMat4;

    /// Camera-space direction (x, y, -1) = ndc * (x, y) + (z, w).
    fn ray_from_ndc(&self) -> [f64; 4];

    /// Whether a sphere in camera space may touch the image. A pixel's margin covers sample offsets and rounding.
    fn may_see(&self, center: DVec3, radius: f64) -> bool;

    /// How the picture of `point` moves, in pixels per metre, when it goes along `way`, both in camera space. What is nearer
    /// than half of the near plane, or behind the camera, moves as it would there.
    fn image_motion(&self, point: DVec3, way: DVec3) -> DVec2;

    /// `point`, at half of the near plane where it is nearer or behind the camera.
    fn before_camera(&self, point: DVec3) -> DVec3;
}

impl RasterLens for PixelLens {
    fn clip_from_camera(&self) -> DMat4 {
        let (w, h) = (f64::from(self.width), f64::from(self.height));
        let [fx, fy] = self.focal;
        let [cx, cy] = self.center;
        if let Rays::Parallel { far } = self.rays {
            let depth = far - self.near;
            return DMat4::from_cols(
                DVec4::new(2.0 * fx / w, 0.0, 0.0, 0.0),
                DVec4::new(0.0, 2.0 * fy / h, 0.0, 0.0),
                DVec4::new(0.0, 0.0, 1.0 / depth, 0.0),
                DVec4::new(2.0 * cx / w - 1.0, 1.0 - 2.0 * cy / h, far / depth, 1.0),
            );
        }
        DMat4::from_cols(
            DVec4::new(2.0 * fx / w, 0.0, 0.0, 0.0),
            DVec4::new(0.0, 2.0 * fy / h, 0.0, 0.0),
            DVec4::new(1.0 - 2.0 * cx / w, 2.0 * cy / h - 1.0, 0.0, -1.0),
            DVec4::new(0.0, 0.0, self.near, 0.0),
        )
    }

    fn clip_from_pixels(&self) -> DMat4 {
        let (w, h) = (f64::from(self.width), f64::from(self.height));
        DMat4::from_cols(
            DVec4::new(2.0 / w, 0.0, 0.0, 0.0),
            DVec4::new(0.0, -2.0 / h, 0.0, 0.0),
            DVec4::new(0.0, 0.0, self.near, 0.0),
            DVec4::new(-1.0, 1.0, 0.0, 1.0),
        )
    }

    fn pixels_from_clip(&self) -> DMat4 {
        let (w, h) = (f64::from(self.width), f64::from(self.height));
        DMat4::from_cols(
            DVec4::new(w / 2.0, 0.0, 0.0, 0.0),
            DVec4::new(0.0, -h / 2.0, 0.0, 0.0),
            DVec4::new(0.0, 0.0, 1.0, 0.0),
            DVec4::new(w / 2.0, h / 2.0, 0.0, 1.0),
        )
    }

    fn ray_from_ndc(&self) -> [f64; 4] {
        if self.is_parallel() {
            return [0.0; 4];
        }
        let (w, h) = (f64::from(self.width), f64::from(self.height));
        let scale = [w / (2.0 * self.focal[0]), h / (2.0 * self.focal[1])];
        [
            scale[0],
            scale[1],
            (1.0 - 2.0 * self.center[0] / w) * scale[0],
            (2.0 * self.center[1] / h - 1.0) * scale[1],
        ]
    }

    fn may_see(&self, center: DVec3, radius: f64) -> bool {
        let [cx, cy] = self.center;
        let (w, h) = (f64::from(self.width), f64::from(self.height));
        let depth = -center.z;
        if let Rays::Parallel { far } = self.rays {
            let [fx, fy] = self.focal;
            // Metres from the axis to each side.
            let sides = [
                (center.x, (w - cx + 1.0) / fx),
                (-center.x, (cx + 1.0) / fx),
                (center.y, (cy + 1.0) / fy),
                (-center.y, (h - cy + 1.0) / fy),
            ];
            let beside = sides.into_iter().any(|(across, edge)| across - edge > radius);
            return !(depth + radius < self.near || depth - radius > far || beside);
        }
        // Tangents of the field to each side; the sphere is outside where it lies beyond one of the planes.
        let sides = [
            (center.x, (w - cx + 1.0) / self.focal[0]),
            (-center.x, (cx + 1.0) / self.focal[0]),
            (center.y, (cy + 1.0) / self.focal[1]),
            (-center.y, (h - cy + 1.0) / self.focal[1]),
        ];
        let outside = |(across, tangent): (f64, f64)| across - depth * tangent > radius * tangent.hypot(1.0);
        // The comparison is false for NaN: what cannot be placed is drawn.
        !(depth + radius < self.near || sides.into_iter().any(outside))
    }

    fn image_motion(&self, point: DVec3, way: DVec3) -> DVec2 {
        let before = self.before_camera(point);
        let Some((_, [x, y, z])) = self.project_with_jacobian(before) else { return DVec2::NAN };
        x * way.x + y * way.y + z * way.z
    }

    fn before_camera(&self, point: DVec3) -> DVec3 {
        point.with_z(point.z.min(-0.5 * self.near))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens() -> PixelLens {
        let rays = Rays::Central;
        PixelLens { width: 640, height: 480, focal: [500.0, 510.0], center: [300.0, 250.0], near: 0.1, rays }
    }

    fn orthographic() -> PixelLens {
        let rays = Rays::Parallel { far: 7.0 };
        PixelLens { focal: [110.0, 100.0], rays, ..lens() }
    }

    #[test]
    fn clip_space_agrees_with_the_pinhole_formula() {
        let lens = lens();
        for point in [DVec3::new(0.3, -0.2, -2.0), DVec3::new(-1.0, 0.7, -5.0)] {
            let clip = lens.clip_from_camera() * point.extend(1.0);
            let ndc = clip / clip.w;
            let pixel = [(ndc.x + 1.0) / 2.0 * 640.0, (1.0 - ndc.y) / 2.0 * 480.0];
            let expected = lens.project(point).unwrap();
            assert!((pixel[0] - expected[0]).abs() < 1e-9 && (pixel[1] - expected[1]).abs() < 1e-9);
            assert!((clip.w + point.z).abs() < 1e-12, "w is planar depth");
            assert!((ndc.z - lens.near / -point.z).abs() < 1e-12, "reverse z");
        }
    }

    #[test]
    fn orthographic_clip_space_runs_from_the_near_plane_to_the_far_one() {
        let lens = orthographic();
        for (point, z) in [(DVec3::new(0.3, -0.2, -0.1), 1.0), (DVec3::new(-1.0, 0.7, -7.0), 0.0)] {
            let clip = lens.clip_from_camera() * point.extend(1.0);
            let pixel = [(clip.x + 1.0) / 2.0 * 640.0, (1.0 - clip.y) / 2.0 * 480.0];
            let expected = lens.project(point).unwrap();
            assert!((pixel[0] - expected[0]).abs() < 1e-9 && (pixel[1] - expected[1]).abs() < 1e-9);
            assert!(clip.w == 1.0 && (clip.z - z).abs() < 1e-12, "{clip}");
        }
        let way = DVec3::new(0.4, 0.1, 0.7);
        let motion = lens.image_motion(DVec3::new(0.3, -0.2, -2.0), way);
        assert!((motion - DVec2::new(44.0, -10.0)).length() < 1e-12, "{motion}");
    }

    #[test]
    fn image_motion_is_how_projections_differ() {
        let lens = lens();
        let (point, way) = (DVec3::new(0.3, -0.2, -2.0), DVec3::new(0.4, 0.1, 0.7));
        let difference = |point: DVec3, way: DVec3| {
            let at = |t: f64| lens.project(point + way * t).unwrap();
            (at(1e-6) - at(-1e-6)) / 2e-6
        };
        let motion = lens.image_motion(point, way);
        assert!((motion - difference(point, way)).length() < 1e-5 * motion.length());
        assert!((motion - difference(point, -way)).length() > 1.0, "canary");
        // Nearer than half of the near plane, and behind the camera: as at half of the near plane.
        let limit = lens.image_motion(point.with_z(-0.05), way);
        assert_eq!(lens.image_motion(point.with_z(-0.01), way), limit);
        assert_eq!(lens.image_motion(point.with_z(3.0), way), limit);
    }

    #[test]
    fn a_sphere_is_culled_only_where_no_pixel_sees_it() {
        for lens in [lens(), orthographic()] {
            let culled = (0..4000).filter(|i| is_culled(&lens, *i)).count();
            assert!(culled > 1000, "culls something: {culled}");
        }
    }

    /// Whether sphere number `i` is; fails where a pixel sees it.
    fn is_culled(lens: &PixelLens, i: i32) -> bool {
        let f = |k: i32| f64::from((i * k) % 997) / 997.0 * 2.0 - 1.0;
        let (center, radius) = (DVec3::new(f(31) * 4.0, f(17) * 4.0, f(7) * 4.0), 0.05 + f(3).abs());
        // Points on the sphere and inside it.
        let seen = (0..200).any(|j| {
            let (a, b) = (f64::from(j) * 2.399_963, 1.0 - f64::from(j) / 99.5);
            let ring = (1.0 - b * b).max(0.0).sqrt();
            let p = center + radius * DVec3::new(ring * a.cos(), b, ring * a.sin());
            let inside = |at: DVec2| (0.0..640.0).contains(&at.x) && (0.0..480.0).contains(&at.y);
            -p.z > lens.near && -p.z < lens.far() && lens.project(p).is_some_and(inside)
        });
        let kept = lens.may_see(center, radius);
        assert!(kept || !seen, "{center} {radius}");
        !kept
    }

    #[test]
    fn rays_go_through_their_pixels() {
        let lens = lens();
        let [sx, sy, ox, oy] = lens.ray_from_ndc();
        let point = DVec3::new(0.4, 0.1, -1.0);
        let clip = lens.clip_from_camera() * point.extend(1.0);
        let ndc = clip / clip.w;
        assert!((ndc.x * sx + ox - 0.4).abs() < 1e-12 && (ndc.y * sy + oy - 0.1).abs() < 1e-12);
    }
}
