//! Repairs of primitives: flat normals, tangents, degenerate triangles, missing UV sets.

use glam::{DVec3, Vec2, Vec3};

use crate::model::{MorphTarget, Primitive, TextureRef};

impl Primitive {
    /// Corners of triangle `t`; its indices are in range once [`crate::Scene::validate`] has passed.
    fn corners(&self, t: usize) -> [usize; 3] {
        [0, 1, 2].map(|k| self.indices[3 * t + k] as usize)
    }

    fn triangle_count(&self) -> usize {
        self.indices.len() / 3
    }

    /// Cross product of two edges: twice the area, along the face's normal.
    fn face_cross(&self, corners: [usize; 3]) -> DVec3 {
        let [a, b, c] = corners.map(|i| Vec3::from_array(self.positions[i]).as_dvec3());
        (b - a).cross(c - a)
    }

    /// Takes vertex `source[i]` as the new vertex `i`.
    fn gather(&mut self, source: &[usize]) {
        fn pick<T: Copy>(values: &mut Vec<T>, source: &[usize]) {
            if !values.is_empty() {
                *values = source.iter().map(|&i| values[i]).collect();
            }
        }
        pick(&mut self.positions, source);
        pick(&mut self.normals, source);
        for values in self.uvs.iter_mut().flatten() {
            pick(values, source);
        }
        for values in [&mut self.tangents, &mut self.colors, &mut self.joint_weights].into_iter().flatten() {
            pick(values, source);
        }
        if let Some(values) = &mut self.joints {
            pick(values, source);
        }
        for target in &mut self.morph_targets {
            pick(&mut target.positions, source);
            pick(&mut target.normals, source);
        }
    }

    /// Gives every triangle its own vertices with the face's normal (glTF 2.0, 3.7.2.1: no normals means flat ones).
    pub(crate) fn make_flat(&mut self) {
        let corners: Vec<usize> = self.indices.iter().map(|&i| i as usize).collect();
        self.normals.clear();
        // Given tangents are ignored where there are no normals (glTF 2.0, 3.7.2.1).
        self.tangents = None;
        self.gather(&corners);
        self.indices = (0..corners.len() as u32).collect();
        let mut normals = vec![[0.0, 0.0, 1.0]; corners.len()];
        for t in 0..self.triangle_count() {
            let normal = self.face_cross(self.corners(t)).normalize_or(DVec3::Z).as_vec3().to_array();
            normals[3 * t..3 * t + 3].fill(normal);
        }
        self.normals = normals;
    }

    /// Brings normals to unit length; those without a direction take the mean of their faces.
    pub(crate) fn repair_normals(&mut self) {
        if self.normals.iter().all(|n| (Vec3::from_array(*n).length_squared() - 1.0).abs() < 1e-5) {
            return;
        }
        let mut faces = vec![DVec3::ZERO; self.positions.len()];
        for t in 0..self.triangle_count() {
            let corners = self.corners(t);
            let cross = self.face_cross(corners);
            for i in corners {
                faces[i] += cross;
            }
        }
        for (normal, face) in self.normals.iter_mut().zip(faces) {
            let given = Vec3::from_array(*normal).as_dvec3();
            *normal = given.try_normalize().unwrap_or(face.normalize_or(DVec3::Z)).as_vec3().to_array();
        }
    }

    /// Drops triangles that can never cover a pixel and returns how many.
    pub(crate) fn drop_degenerate(&mut self) -> usize {
        // Skinning and morphing can open a triangle that has no area at rest, unless it repeats a vertex.
        let deforms = self.joints.is_some() || !self.morph_targets.is_empty();
        let before = self.triangle_count();
        let keep: Vec<bool> = (0..before)
            .map(|t| {
                let [a, b, c] = self.corners(t);
                a != b && b != c && c != a && (deforms || self.face_cross([a, b, c]) != DVec3::ZERO)
            })
            .collect();
        let kept = keep.iter().filter(|k| **k).count();
        if kept < before {
            let indices = self.indices.chunks_exact(3).zip(keep).filter(|(_, keep)| *keep);
            self.indices = indices.flat_map(|(corner, _)| corner.iter().copied()).collect();
        }
        before - kept
    }

    /// Tangents for the normal map `texture`: along increasing u of the transformed UVs, weighted by angle, one side of
    /// a mirrored seam each. The bitangent, `w * cross(normal, tangent)`, points to decreasing v: up in the image.
    pub(crate) fn make_tangents(&mut self, texture: &TextureRef) {
        let Some(uvs) = self.uvs.get(texture.uv_set as usize).and_then(Option::as_ref) else { return };
        let m = texture.transform;
        let uv = |i: usize| {
            let [u, v] = uvs[i];
            Vec2::new(m[0] * u + m[1] * v, m[3] * u + m[4] * v).as_dvec2()
        };
        // Sums of unit tangents for faces whose UVs run the usual way (1) or mirrored (0).
        let mut sums = vec![[DVec3::ZERO; 2]; self.positions.len()];
        let mut face_side = Vec::with_capacity(self.triangle_count());
        for t in 0..self.triangle_count() {
            let corners = self.corners(t);
            let p = corners.map(|i| Vec3::from_array(self.positions[i]).as_dvec3());
            let q = corners.map(uv);
            let (p1, p2, q1, q2) = (p[1] - p[0], p[2] - p[0], q[1] - q[0], q[2] - q[0]);
            let area = q1.perp_dot(q2);
            // With v down and seen from the front, an image that is not mirrored turns the other way than u and v.
            let side = usize::from(area <= 0.0);
            face_side.push((side, area != 0.0));
            let along = (p1 * q2.y - p2 * q1.y) * area.signum();
            let Some(along) = along.try_normalize().filter(|_| area != 0.0) else { continue };
            for k in 0..3 {
                let (to_next, to_previous) = (p[(k + 1) % 3] - p[k], p[(k + 2) % 3] - p[k]);
                sums[corners[k]][side] += along * to_next.angle_between(to_previous);
            }
        }
        // A vertex used by both kinds of faces is split: no single tangent frame serves both.
        let mut source: Vec<usize> = (0..self.positions.len()).collect();
        let mut side_of: Vec<usize> =
            sums.iter().map(|s| usize::from(s[0] == DVec3::ZERO || s[1] != DVec3::ZERO)).collect();
        let mut mirrored_copy = vec![None; source.len()];
        for (t, &(side, has_uv)) in face_side.iter().enumerate() {
            for k in 0..3 {
                let i = self.indices[3 * t + k] as usize;
                if has_uv && side != side_of[i] && sums[i][side] != DVec3::ZERO {
                    let copy = *mirrored_copy[i].get_or_insert_with(|| {
                        source.push(i);
                        side_of.push(side);
                        source.len() - 1
                    });
                    self.indices[3 * t + k] = copy as u32;
                }
            }
        }
        if source.len() > self.positions.len() {
            self.gather(&source);
        }
        let tangents = source.iter().zip(&side_of).zip(&self.normals).map(|((&i, &side), normal)| {
            let n = Vec3::from_array(*normal).as_dvec3();
            let sum = sums[i][side];
            let tangent =
                (sum - n * n.dot(sum)).try_normalize().unwrap_or_else(|| n.any_orthonormal_vector());
            tangent.as_vec3().extend(if side == 1 { 1.0 } else { -1.0 }).to_array()
        });
        self.tangents = Some(tangents.collect());
    }

    /// Checks lengths, index ranges and finiteness; `joint_count` is that of the skin, where there is one.
    pub(crate) fn check(&self, joint_count: Option<usize>) -> Result<(), String> {
        let n = self.positions.len();
        let length = |what: &str, len: usize| {
            if len == n { Ok(()) } else { Err(format!("{len} {what} for {n} positions")) }
        };
        if !self.normals.is_empty() {
            length("normals", self.normals.len())?;
        }
        finite("position", &self.positions)?;
        finite("normal", &self.normals)?;
        for values in self.uvs.iter().flatten() {
            length("texture coordinates", values.len())?;
            finite("texture coordinate", values)?;
        }
        for (what, values) in
            [("tangent", &self.tangents), ("colour", &self.colors), ("joint weight", &self.joint_weights)]
        {
            if let Some(values) = values {
                length(&format!("{what}s"), values.len())?;
                finite(what, values)?;
            }
        }
        if self.joints.is_some() != self.joint_weights.is_some() {
            return Err("joints and joint weights must come together".into());
        }
        if let Some(joints) = &self.joints {
            length("joint sets", joints.len())?;
            if let Some(count) = joint_count
                && let Some(joint) = joints.iter().flatten().find(|j| usize::from(**j) >= count)
            {
                return Err(format!("joint {joint} of a skin that has {count}"));
            }
        }
        for (k, MorphTarget { positions, normals }) in self.morph_targets.iter().enumerate() {
            length(&format!("positions in morph target {k}"), positions.len())?;
            length(&format!("normals in morph target {k}"), normals.len())?;
            finite("morph displacement", positions)?;
            finite("morph displacement", normals)?;
        }
        if !self.indices.len().is_multiple_of(3) {
            return Err(format!("{} indices are no whole number of triangles", self.indices.len()));
        }
        match self.indices.iter().find(|i| **i as usize >= n) {
            Some(i) => Err(format!("index {i} for {n} vertices")),
            None => Ok(()),
        }
    }
}

fn finite<const N: usize>(what: &str, values: &[[f32; N]]) -> Result<(), String> {
    match values.iter().position(|v| v.iter().any(|c| !c.is_finite())) {
        Some(i) => Err(format!("{what} {i} is {:?}; all must be finite", values[i])),
        None => Ok(()),
    }
}
