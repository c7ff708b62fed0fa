//! Geometry made by code: plane, box, sphere, cylinder, capsule and card.
//!
//! Every shape is centred at the origin. Faces are counter-clockwise seen from outside; texture coordinates run
//! to the right (u) and down (v) as seen from the front, so a picture stands upright. Vertices that meet at a seam
//! have bit-equal positions, so closed shapes have no cracks.

use std::f64::consts::{PI, TAU};

use glam::{DMat4, DVec3, Vec3};

use crate::error::SceneError;
use crate::model::Primitive;
use crate::rigid_body::Collider;

/// A shape and its size in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// Lies in x and z, its front is +Y; a picture's top points to -Z.
    Plane {
        /// Along x and z.
        size: [f64; 2],
    },
    /// Axis-aligned; every face carries the whole picture, upright on the four sides.
    Box {
        /// Along x, y and z.
        size: [f64; 3],
    },
    /// The picture wraps around it once; its middle faces +Z, its top is at +Y.
    Sphere {
        /// Radius.
        radius: f64,
    },
    /// Stands along y; caps carry the picture as a box's top and bottom do.
    Cylinder {
        /// Radius.
        radius: f64,
        /// Along y.
        height: f64,
    },
    /// A cylinder along y with half a sphere on each end.
    Capsule {
        /// Radius.
        radius: f64,
        /// Distance between the centres of the two half spheres: the whole is `height + 2 radius` long.
        height: f64,
    },
    /// Stands in x and y, its front is +Z. Meant for materials that are double-sided: see [`Shape::is_double_sided`].
    Card {
        /// Along x and y.
        size: [f64; 2],
    },
}

/// Most segments along one direction.
pub const MAX_SEGMENTS: u32 = 1024;

impl Shape {
    /// Name as scene files write it.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Plane { .. } => "plane",
            Self::Box { .. } => "box",
            Self::Sphere { .. } => "sphere",
            Self::Cylinder { .. } => "cylinder",
            Self::Capsule { .. } => "capsule",
            Self::Card { .. } => "card",
        }
    }

    /// What a rigid body of this shape touches others with. Like MuJoCo's, a plane is seen as far as its size and touched
    /// without an end.
    pub const fn collider(&self) -> Collider {
        match *self {
            Self::Plane { .. } => Collider::HalfSpace,
            Self::Box { size } => Collider::Box { size },
            Self::Sphere { radius } => Collider::Sphere { radius },
            Self::Cylinder { radius, height } => Collider::Cylinder { radius, height },
            Self::Capsule { radius, height } => Collider::Capsule { radius, height },
            Self::Card { .. } => Collider::Mesh,
        }
    }

    /// Whether it has no inside and is to be seen from both sides.
    pub const fn is_double_sided(&self) -> bool {
        matches!(self, Self::Card { .. })
    }

    /// Segments where none are asked for: along u and v of a flat face; around and along the axis of a round one
    /// (a capsule's second number is per half sphere).
    pub const fn default_segments(&self) -> [u32; 2] {
        match self {
            Self::Plane { .. } | Self::Box { .. } | Self::Card { .. } => [1, 1],
            Self::Sphere { .. } => [32, 16],
            Self::Cylinder { .. } => [32, 1],
            Self::Capsule { .. } => [32, 8],
        }
    }

    /// Triangles of this shape: material 0, one set of texture coordinates multiplied by `uv_repeat`, tangents.
    ///
    /// # Errors
    /// A size that is not a positive number, too few or too many segments, a `uv_repeat` that is not finite.
    pub fn build(&self, segments: Option<[u32; 2]>, uv_repeat: [f64; 2]) -> Result<Primitive, SceneError> {
        self.check_sizes()?;
        let [nu, nv] = segments.unwrap_or(self.default_segments());
        let least = if self.is_round() { 3 } else { 1 };
        let least_v = if matches!(self, Self::Sphere { .. }) { 2 } else { 1 };
        for (n, least) in [(nu, least), (nv, least_v)] {
            if !(least..=MAX_SEGMENTS).contains(&n) {
                return Err(SceneError::Rule(format!(
                    "segments of a {} are [{nu}, {nv}]; each must be between {least} and {MAX_SEGMENTS}",
                    self.name()
                )));
            }
        }
        if !uv_repeat.iter().all(|r| r.is_finite() && *r != 0.0) {
            return Err(SceneError::Rule(format!(
                "uv_repeat is {uv_repeat:?}; it takes two finite numbers other than 0"
            )));
        }
        let mut out = Builder { uv_repeat, ..Builder::default() };
        match *self {
            Self::Plane { size: [x, z] } => {
                out.face([nu, nv], DVec3::ZERO, DVec3::X * (x / 2.0), DVec3::Z * (z / 2.0));
            }
            Self::Card { size: [x, y] } => {
                out.face([nu, nv], DVec3::ZERO, DVec3::X * (x / 2.0), DVec3::NEG_Y * (y / 2.0));
            }
            Self::Box { size } => {
                let [x, y, z] = size.map(|s| s / 2.0);
                let (x, y, z) = (DVec3::X * x, DVec3::Y * y, DVec3::Z * z);
                for (centre, u, v) in
                    [(x, -z, -y), (-x, z, -y), (y, x, z), (-y, x, -z), (z, x, -y), (-z, -x, -y)]
                {
                    out.face([nu, nv], centre, u, v);
                }
            }
            Self::Sphere { radius } => {
                let profile = (0..=nv).map(|j| Ring::on_sphere(radius, 0.0, j, nv)).collect::<Vec<_>>();
                out.lathe(nu, &profile);
            }
            Self::Cylinder { radius, height } => {
                let profile = (0..=nv).map(|j| {
                    let v = f64::from(j) / f64::from(nv);
                    Ring { radius, y: height * (0.5 - v), normal: [1.0, 0.0], v }
                });
                out.lathe(nu, &profile.collect::<Vec<_>>());
                out.cap(nu, radius, height / 2.0, 1.0);
                out.cap(nu, radius, -height / 2.0, -1.0);
            }
            Self::Capsule { radius, height } => {
                let length = PI * radius + height;
                let upper = (0..=nv).map(|j| {
                    let ring = Ring::on_sphere(radius, height / 2.0, j, 2 * nv);
                    Ring { v: ring.v * PI * radius / length, ..ring }
                });
                let lower = (nv..=2 * nv).map(|j| {
                    let ring = Ring::on_sphere(radius, -height / 2.0, j, 2 * nv);
                    Ring { v: (ring.v * PI * radius + height) / length, ..ring }
                });
                out.lathe(nu, &upper.chain(lower).collect::<Vec<_>>());
            }
        }
        out.finish()
    }

    fn is_round(&self) -> bool {
        matches!(self, Self::Sphere { .. } | Self::Cylinder { .. } | Self::Capsule { .. })
    }

    fn check_sizes(&self) -> Result<(), SceneError> {
        let sizes: &[(&str, f64)] = match self {
            Self::Plane { size: [a, b] } | Self::Card { size: [a, b] } => &[("size", *a), ("size", *b)],
            Self::Box { size: [a, b, c] } => &[("size", *a), ("size", *b), ("size", *c)],
            Self::Sphere { radius } => &[("radius", *radius)],
            Self::Cylinder { radius, height } | Self::Capsule { radius, height } => {
                &[("radius", *radius), ("height", *height)]
            }
        };
        for (what, value) in sizes {
            // Beyond these, single precision folds vertices together or overflows.
            if !(1e-6..=1e6).contains(value) {
                return Err(SceneError::Rule(format!(
                    "{what} of a {} is {value}; it takes metres between 1e-6 and 1e6",
                    self.name()
                )));
            }
        }
        Ok(())
    }
}

/// One ring of a solid of revolution about y.
#[derive(Clone, Copy)]
struct Ring {
    radius: f64,
    y: f64,
    /// Outwards and up.
    normal: [f64; 2],
    v: f64,
}

impl Ring {
    /// Ring `j` of `n`, counted from the upper pole, of a sphere about `(0, centre_y, 0)`.
    fn on_sphere(radius: f64, centre_y: f64, j: u32, n: u32) -> Self {
        let v = f64::from(j) / f64::from(n);
        // sin(pi) is not 0: the poles must be single points.
        let (out, up) = match j {
            0 => (0.0, 1.0),
            j if j == n => (0.0, -1.0),
            j if 2 * j == n => (1.0, 0.0),
            _ => (PI * v).sin_cos(),
        };
        Self { radius: radius * out, y: centre_y + radius * up, normal: [out, up], v }
    }
}

/// Sine and cosine of the `i`-th of `n` parts of a turn, starting at the back (-Z); equal for `i` and `i + n`.
fn around(i: u32, n: u32) -> (f64, f64) {
    (TAU * (f64::from(i % n) / f64::from(n) - 0.5)).sin_cos()
}

#[derive(Default)]
struct Builder {
    out: Primitive,
    tangents: Vec<[f32; 4]>,
    uvs: Vec<[f32; 2]>,
    uv_repeat: [f64; 2],
}

impl Builder {
    fn vertex(&mut self, position: DVec3, normal: DVec3, tangent: DVec3, uv: [f64; 2]) {
        self.out.positions.push(position.as_vec3().to_array());
        self.out.normals.push(normal.as_vec3().normalize_or(Vec3::Y).to_array());
        // No shape mirrors its picture, so the bitangent (up in the picture) is normal x tangent everywhere.
        self.tangents.push(tangent.as_vec3().normalize_or(Vec3::X).extend(1.0).to_array());
        self.uvs.push([(uv[0] * self.uv_repeat[0]) as f32, (uv[1] * self.uv_repeat[1]) as f32]);
    }

    fn next_index(&self) -> u32 {
        self.out.positions.len() as u32
    }

    /// A rectangle about `centre`; `u` and `v` point from it to the right and lower edges.
    fn face(&mut self, [nu, nv]: [u32; 2], centre: DVec3, u: DVec3, v: DVec3) {
        let base = self.next_index();
        let normal = v.cross(u).normalize();
        for j in 0..=nv {
            for i in 0..=nu {
                let [s, t] = [f64::from(i) / f64::from(nu), f64::from(j) / f64::from(nv)];
                let position = centre + u * (2.0 * s - 1.0) + v * (2.0 * t - 1.0);
                self.vertex(position, normal, u.normalize(), [s, t]);
            }
        }
        self.grid(base, nu, nv, false, false);
    }

    fn lathe(&mut self, nu: u32, profile: &[Ring]) {
        let base = self.next_index();
        let closed = |ring: Option<&Ring>| ring.is_some_and(|r| r.radius == 0.0);
        for ring in profile {
            // At a pole each triangle has its own vertex: half way between its neighbours in u.
            let shift = if ring.radius == 0.0 { 0.5 } else { 0.0 };
            for i in 0..=nu {
                let (sin, cos) = around(i, nu);
                self.vertex(
                    DVec3::new(ring.radius * sin, ring.y, ring.radius * cos),
                    DVec3::new(ring.normal[0] * sin, ring.normal[1], ring.normal[0] * cos),
                    DVec3::new(cos, 0.0, -sin),
                    [(f64::from(i) + shift) / f64::from(nu), ring.v],
                );
            }
        }
        let nv = (profile.len() as u32).saturating_sub(1);
        self.grid(base, nu, nv, closed(profile.first()), closed(profile.last()));
    }

    /// Indices of a grid of vertices; `top` and `bottom` say where a row has collapsed into a pole.
    fn grid(&mut self, base: u32, nu: u32, nv: u32, top: bool, bottom: bool) {
        for j in 0..nv {
            for i in 0..nu {
                let upper = base + j * (nu + 1) + i;
                let lower = upper + nu + 1;
                if !(bottom && j + 1 == nv) {
                    self.out.indices.extend([upper, lower, lower + 1]);
                }
                if !(top && j == 0) {
                    // At a lower pole the vertex of this triangle is the one with the half-shifted u.
                    let tip = if bottom && j + 1 == nv { lower } else { lower + 1 };
                    self.out.indices.extend([upper, tip, upper + 1]);
                }
            }
        }
    }

    fn cap(&mut self, nu: u32, radius: f64, y: f64, up: f64) {
        let base = self.next_index();
        let normal = DVec3::Y * up;
        self.vertex(DVec3::Y * y, normal, DVec3::X, [0.5, 0.5]);
        for i in 0..=nu {
            let (sin, cos) = around(i, nu);
            let uv = [0.5 + 0.5 * sin, 0.5 + 0.5 * cos * up];
            self.vertex(DVec3::new(radius * sin, y, radius * cos), normal, DVec3::X, uv);
        }
        for i in 1..=nu {
            self.out.indices.extend(if up > 0.0 {
                [base, base + i, base + i + 1]
            } else {
                [base, base + i + 1, base + i]
            });
        }
    }

    fn finish(self) -> Result<Primitive, SceneError> {
        Ok(Primitive { tangents: Some(self.tangents), uvs: [Some(self.uvs), None], ..self.out })
    }
}

/// Adds `part`, moved by `transform`, to `target`, so that static detail can share one draw.
/// Only positions, normals, tangents and the first set of texture coordinates are carried over, the last two
/// where both have them; `target`'s material stays.
pub fn append(target: &mut Primitive, part: &Primitive, transform: DMat4) {
    let base = target.positions.len() as u32;
    let normal_transform = transform.inverse().transpose();
    let mirrored = transform.determinant() < 0.0;
    let first = target.positions.is_empty();
    let place = |p: [f32; 3]| transform.transform_point3(Vec3::from(p).as_dvec3()).as_vec3().to_array();
    let turn = |n: [f32; 3]| {
        let n = normal_transform.transform_vector3(Vec3::from(n).as_dvec3());
        n.normalize_or(DVec3::Y).as_vec3().to_array()
    };
    target.positions.extend(part.positions.iter().copied().map(place));
    target.normals.extend(part.normals.iter().copied().map(turn));
    let tangents = part.tangents.as_ref().map(|tangents| {
        tangents.iter().map(|&[x, y, z, w]| {
            let t = transform.transform_vector3(DVec3::new(x.into(), y.into(), z.into()));
            t.normalize_or(DVec3::X).as_vec3().extend(if mirrored { -w } else { w }).to_array()
        })
    });
    match (&mut target.tangents, tangents) {
        (Some(all), Some(new)) => all.extend(new),
        (all, Some(new)) if first => *all = Some(new.collect()),
        (all, _) => *all = None,
    }
    match (&mut target.uvs[0], &part.uvs[0]) {
        (Some(all), Some(new)) => all.extend(new),
        (all, Some(new)) if first => *all = Some(new.clone()),
        (all, _) => *all = None,
    }
    let triangles = part.indices.chunks_exact(3).flat_map(|t| {
        let (a, b, c) = (t[0] + base, t[1] + base, t[2] + base);
        if mirrored { [a, c, b] } else { [a, b, c] }
    });
    target.indices.extend(triangles);
}
