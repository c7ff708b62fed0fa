//! Validation of a scene: everything that the engine later trusts is checked, or filled in, once.

use std::collections::HashSet;

use crate::error::SceneError;
use crate::image::MAX_EDGE;
use crate::model::{Lens, LightKind, Material, Scene, TextureRef, Variant};

type Check = Result<(), String>;

impl Scene {
    /// Checks every rule that the engine relies on and fills in what may be left out: flat normals, tangents for
    /// normal maps, absent UV sets, morph weights, instance ids (1, 2, 3, … where 0) and unique camera names.
    /// Triangles without area are dropped, with a warning.
    ///
    /// # Errors
    /// Names the part that breaks a rule, the value, and the rule.
    pub fn validate(&mut self) -> Result<(), SceneError> {
        self.check_nodes()
            .and_then(|()| self.check_materials())
            .and_then(|()| self.check_meshes())
            .and_then(|()| self.check_lights_and_cameras())
            .and_then(|()| self.check_variants())
            .and_then(|()| self.check_rigid_bodies())
            .and_then(|()| self.check_not_empty())
            .map_err(SceneError::Rule)?;
        for (material, _) in self.variants.iter().flat_map(|variant| &variant.factors) {
            self.materials[*material].driven = true;
        }
        self.repair_meshes();
        self.assign_instance_ids();
        self.make_camera_names_unique();
        self.check_not_empty().map_err(SceneError::Rule)
    }

    fn node_label(&self, index: usize) -> String {
        match self.nodes.get(index) {
            Some(node) if !node.name.is_empty() => format!("node {index} '{}'", node.name),
            _ => format!("node {index}"),
        }
    }

    fn check_nodes(&self) -> Check {
        for (i, node) in self.nodes.iter().enumerate() {
            let label = self.node_label(i);
            if let Some(parent) = node.parent
                && parent >= i
            {
                return Err(self.parent_error(i, parent));
            }
            in_range(&label, "mesh", node.mesh, self.meshes.len())?;
            in_range(&label, "skin", node.skin, self.skins.len())?;
            in_range(&label, "light", node.light, self.lights.len())?;
            node.motion.check().map_err(|reason| format!("{label}: {reason}"))?;
            if let Some(curve) = &node.morph {
                curve.check().map_err(|reason| format!("{label}: morph weights: {reason}"))?;
            }
        }
        for (s, skin) in self.skins.iter().enumerate() {
            if skin.joints.len() != skin.inverse_bind.len() {
                let (joints, matrices) = (skin.joints.len(), skin.inverse_bind.len());
                return Err(format!(
                    "skin {s} has {joints} joints and {matrices} inverse bind matrices; these must agree"
                ));
            }
            for joint in &skin.joints {
                in_range(&format!("skin {s}"), "node", Some(*joint), self.nodes.len())?;
            }
            if let Some(j) = skin.inverse_bind.iter().position(|m| !m.is_finite()) {
                return Err(format!("skin {s}: inverse bind matrix {j} is not finite"));
            }
        }
        Ok(())
    }

    fn parent_error(&self, node: usize, parent: usize) -> String {
        let label = self.node_label(node);
        if parent >= self.nodes.len() {
            return format!("{label} has parent {parent}, but there are {} nodes", self.nodes.len());
        }
        // As many steps as there are nodes reach a root, or go round.
        let mut at = Some(node);
        for _ in 0..=self.nodes.len() {
            at = at.and_then(|n| self.nodes.get(n)).and_then(|n| n.parent);
        }
        if at.is_some() {
            format!("{label} is its own ancestor; nodes must form a tree")
        } else {
            format!("{label} comes before its parent, {}; parents come first", self.node_label(parent))
        }
    }

    fn check_materials(&self) -> Check {
        for (i, image) in self.images.iter().enumerate() {
            let (w, h) = (image.width, image.height);
            if w == 0 || h == 0 || w > MAX_EDGE || h > MAX_EDGE {
                return Err(format!(
                    "image {i} '{}' measures {w}x{h}; edges are 1 to {MAX_EDGE}",
                    image.name
                ));
            }
            if image.texels.len() != w as usize * h as usize {
                let n = image.texels.len();
                return Err(format!("image {i} '{}' of {w}x{h} holds {n} texels", image.name));
            }
        }
        for (i, texture) in self.textures.iter().enumerate() {
            in_range(&format!("texture {i}"), "image", Some(texture.image), self.images.len())?;
        }
        for (i, material) in self.materials.iter().enumerate() {
            let label = format!("material {i} '{}'", material.name);
            for texture in material_textures(material) {
                in_range(&label, "texture", Some(texture.texture), self.textures.len())?;
                if texture.uv_set > 1 {
                    return Err(format!("{label} uses UV set {}; there are sets 0 and 1", texture.uv_set));
                }
                if texture.transform.iter().any(|v| !v.is_finite()) {
                    return Err(format!("{label} has a texture transform that is not finite"));
                }
            }
            let m = material;
            let factors = [
                m.metallic,
                m.roughness,
                m.normal_scale,
                m.occlusion_strength,
                m.emissive[0],
                m.emissive[1],
                m.emissive[2],
            ];
            if let Some(v) = m.base_color.iter().chain(&factors).find(|v| !v.is_finite()) {
                return Err(format!("{label} has the factor {v}; factors must be finite"));
            }
            if let Some(v) = m.base_color.iter().chain(&m.emissive).find(|v| **v < 0.0) {
                return Err(format!("{label} has the colour value {v}; light cannot be negative"));
            }
            if let Some(wave) = &m.emission_waveform {
                wave.check().map_err(|reason| format!("{label}: waveform: {reason}"))?;
            }
        }
        let constant = self.background.iter().chain(&self.ambient);
        match constant.clone().find(|v| !(v.is_finite() && **v >= 0.0)) {
            Some(v) => Err(format!("background or ambient light holds {v}; it must be finite and 0 or more")),
            None => Ok(()),
        }
    }

    fn check_meshes(&self) -> Check {
        for (m, mesh) in self.meshes.iter().enumerate() {
            let label = format!("mesh {m} '{}'", mesh.name);
            let targets = mesh.primitives.first().map_or(0, |p| p.morph_targets.len());
            let weights = mesh.morph_weights.len();
            if weights > targets || mesh.morph_weights.iter().any(|w| !w.is_finite()) {
                return Err(format!(
                    "{label} has the morph weights {:?} for {targets} targets",
                    mesh.morph_weights
                ));
            }
            // The smallest skin that deforms the mesh decides which joints exist.
            let users = self.nodes.iter().filter(|n| n.mesh == Some(m));
            let joint_count = users.clone().filter_map(|n| Some(self.skins.get(n.skin?)?.joints.len())).min();
            for (p, primitive) in mesh.primitives.iter().enumerate() {
                let label = format!("{label}, primitive {p}");
                in_range(&label, "material", Some(primitive.material), self.materials.len())?;
                primitive.check(joint_count).map_err(|reason| format!("{label}: {reason}"))?;
                if primitive.morph_targets.len() != targets {
                    let n = primitive.morph_targets.len();
                    return Err(format!("{label} has {n} morph targets, the first primitive {targets}"));
                }
            }
            for curve in users.filter_map(|n| n.morph.as_ref()) {
                if curve.width != targets {
                    return Err(format!(
                        "{label} has {targets} morph targets, but is driven by {} weights",
                        curve.width
                    ));
                }
            }
        }
        Ok(())
    }

    fn check_lights_and_cameras(&self) -> Check {
        for (i, light) in self.lights.iter().enumerate() {
            let label = format!("light {i} '{}'", light.name);
            if !(light.intensity.is_finite() && light.intensity >= 0.0) {
                return Err(format!("{label} has intensity {}; it must be 0 or more", light.intensity));
            }
            if let Some(v) = light.color.iter().find(|v| !(v.is_finite() && **v >= 0.0)) {
                return Err(format!("{label} has the colour value {v}; it must be 0 or more"));
            }
            if let Some(range) = light.range.filter(|r| r.is_nan() || *r <= 0.0) {
                return Err(format!("{label} has range {range}; it must be above 0"));
            }
            if let LightKind::Spot { inner, outer } = light.kind
                && !(inner >= 0.0 && inner < outer && outer <= std::f32::consts::FRAC_PI_2)
            {
                return Err(format!(
                    "{label} has cone angles {inner} and {outer}; 0 <= inner < outer <= pi / 2 works"
                ));
            }
            if let Some(wave) = &light.waveform {
                wave.check().map_err(|reason| format!("{label}: waveform: {reason}"))?;
            }
        }
        for camera in &self.cameras {
            let label = format!("camera '{}'", camera.name);
            in_range(&label, "node", Some(camera.node), self.nodes.len())?;
            let positive = |v: f64| v.is_finite() && v > 0.0;
            match camera.lens {
                Lens::FieldOfView { fov_y } if !(positive(fov_y) && fov_y < std::f64::consts::PI) => {
                    return Err(format!(
                        "{label} has a field of view of {fov_y} rad; above 0 and below pi works"
                    ));
                }
                Lens::Intrinsics { fx, fy, cx, cy }
                    if !(positive(fx) && positive(fy) && cx.is_finite() && cy.is_finite()) =>
                {
                    return Err(format!("{label} has focal lengths {fx}, {fy} and centre {cx}, {cy}"));
                }
                Lens::Orthographic { height, far }
                    if !(positive(height) && positive(far) && far > camera.near) =>
                {
                    return Err(format!(
                        "{label} is orthographic, {height} m high and {far} m deep with its near plane at {} m; a height \
                         above 0 and a far plane beyond the near one work",
                        camera.near
                    ));
                }
                _ => {}
            }
            if !positive(camera.near) {
                return Err(format!("{label} has its near plane at {} m; it must be above 0", camera.near));
            }
            if let Some(edge) =
                [camera.width, camera.height].into_iter().flatten().find(|e| !(1..=8192).contains(e))
            {
                return Err(format!("{label} has an edge of {edge} pixels; 1 to 8192 works"));
            }
            if let Some(aspect) = camera.aspect.filter(|a| !positive(*a)) {
                return Err(format!("{label} has aspect {aspect}; it must be above 0"));
            }
            let thresholds = [camera.threshold_on, camera.threshold_off].into_iter().flatten();
            if let Some(c) = thresholds.into_iter().find(|c| !positive(f64::from(*c))) {
                return Err(format!("{label} has threshold {c}; it must be above 0"));
            }
        }
        self.check_distortions()?;
        match self.duration_s.filter(|d| !(d.is_finite() && *d >= 0.0)) {
            Some(d) => Err(format!("duration_s is {d}; it must be 0 or more")),
            None => Ok(()),
        }
    }

    fn check_distortions(&self) -> Check {
        for (name, distortion) in &self.distortions {
            let Some(camera) = self.cameras.iter().find(|camera| camera.name == *name) else {
                return Err(format!("there is a distortion for a camera '{name}', and no such camera"));
            };
            if !matches!(camera.lens, Lens::Intrinsics { .. }) {
                return Err(format!(
                    "camera '{name}' has a distortion and no focal lengths; give it intrinsics"
                ));
            }
            distortion.check().map_err(|error| format!("camera '{name}': {error}"))?;
        }
        Ok(())
    }

    fn check_variants(&self) -> Check {
        for (v, variant) in self.variants.iter().enumerate() {
            let label = format!("variant {v}");
            if !variant.time_offset_s.is_finite() {
                return Err(format!("{label} has time offset {}; it must be finite", variant.time_offset_s));
            }
            for (node, offset) in &variant.node_offsets {
                in_range(&label, "node", Some(*node), self.nodes.len())?;
                if !offset.is_finite() {
                    return Err(format!("{label}: the offset of {} is not finite", self.node_label(*node)));
                }
            }
            self.check_variant(variant).map_err(|error| format!("{label}: {error}"))?;
        }
        Ok(())
    }

    /// Whether the scene has what `variant` has otherwise, and may have it so.
    pub(crate) fn check_variant(&self, variant: &Variant) -> Result<(), SceneError> {
        let missing = |what: &str, index: usize, count: usize| {
            Err(SceneError::Rule(format!("an environment has {what} {index} otherwise; there are {count}")))
        };
        for (index, steps) in &variant.factors {
            let Some(material) = self.materials.get(*index) else {
                return missing("material", *index, self.materials.len());
            };
            let Some(own) = steps.at(f64::NEG_INFINITY) else { continue };
            own.check().map_err(|e| SceneError::Rule(format!("material '{}': {e}", material.name)))?;
        }
        for (index, steps) in &variant.lights {
            let Some(light) = self.lights.get(*index) else {
                return missing("light", *index, self.lights.len());
            };
            let Some(own) = steps.at(f64::NEG_INFINITY) else { continue };
            own.check().map_err(|e| SceneError::Rule(format!("light '{}': {e}", light.name)))?;
        }
        for (index, steps) in &variant.lenses {
            let Some(camera) = self.cameras.get(*index) else {
                return missing("camera", *index, self.cameras.len());
            };
            let Some(own) = steps.at(f64::NEG_INFINITY) else { continue };
            own.check().map_err(|e| SceneError::Rule(format!("camera '{}': {e}", camera.name)))?;
            if self.distortions.contains_key(&camera.name) && !matches!(own, Lens::Intrinsics { .. }) {
                return Err(SceneError::Rule(format!(
                    "camera '{}' has a distortion and no focal lengths; give it intrinsics",
                    camera.name
                )));
            }
        }
        Ok(())
    }

    fn check_not_empty(&self) -> Check {
        let sky = self.environment.as_ref().is_some_and(|e| e.visible);
        let drawn = self.nodes.iter().filter_map(|n| self.meshes.get(n.mesh?));
        if sky || drawn.flat_map(|m| &m.primitives).any(|p| !p.indices.is_empty()) {
            Ok(())
        } else {
            Err("there is nothing to draw: no node holds a mesh with a triangle, and no sky is shown".into())
        }
    }

    fn repair_meshes(&mut self) {
        for mesh in &mut self.meshes {
            let mut dropped = 0;
            for primitive in &mut mesh.primitives {
                dropped += primitive.drop_degenerate();
                let Some(material) = self.materials.get(primitive.material) else { continue };
                for texture in material_textures(material) {
                    // Without the set all vertices share one texel, so that the engine needs no third case.
                    if let Some(set) = primitive.uvs.get_mut(texture.uv_set as usize) {
                        set.get_or_insert_with(|| vec![[0.0; 2]; primitive.positions.len()]);
                    }
                }
                if primitive.normals.is_empty() {
                    primitive.make_flat();
                }
                primitive.repair_normals();
                if let Some(texture) = &material.normal_texture
                    && primitive.tangents.is_none()
                {
                    primitive.make_tangents(texture);
                }
                for weights in primitive.joint_weights.iter_mut().flatten() {
                    let sum: f32 = weights.iter().sum();
                    *weights = if sum > 0.0 { weights.map(|w| w / sum) } else { [1.0, 0.0, 0.0, 0.0] };
                }
            }
            let targets = mesh.primitives.first().map_or(0, |p| p.morph_targets.len());
            mesh.morph_weights.resize(targets, 0.0);
            if dropped > 0 {
                self.warnings
                    .push(format!("mesh '{}': {dropped} triangles without area are left out", mesh.name));
            }
        }
    }

    fn assign_instance_ids(&mut self) {
        let mut taken: HashSet<u32> = self.nodes.iter().map(|n| n.instance_id).collect();
        let mut next = 1;
        for node in self.nodes.iter_mut().filter(|n| n.mesh.is_some() && n.instance_id == 0) {
            while !taken.insert(next) {
                next += 1;
            }
            node.instance_id = next;
        }
    }

    fn make_camera_names_unique(&mut self) {
        let mut taken: HashSet<String> = self.cameras.iter().map(|c| c.name.clone()).collect();
        let mut seen = HashSet::new();
        for camera in &mut self.cameras {
            if camera.name.is_empty() {
                camera.name = "camera".into();
            }
            if !seen.insert(camera.name.clone()) {
                let base = camera.name.clone();
                let mut suffix = 2;
                while !taken.insert(format!("{base}_{suffix}")) {
                    suffix += 1;
                }
                camera.name = format!("{base}_{suffix}");
                seen.insert(camera.name.clone());
            }
        }
    }
}

fn in_range(label: &str, what: &str, index: Option<usize>, count: usize) -> Check {
    match index {
        Some(index) if index >= count => {
            Err(format!("{label} refers to {what} {index}, but there are {count}"))
        }
        _ => Ok(()),
    }
}

/// The textures that a material uses.
pub(crate) fn material_textures(material: &Material) -> impl Iterator<Item = &TextureRef> {
    [
        &material.base_color_texture,
        &material.metallic_roughness_texture,
        &material.normal_texture,
        &material.occlusion_texture,
        &material.emissive_texture,
    ]
    .into_iter()
    .flatten()
}
