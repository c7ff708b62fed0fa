//! What a surface point sends towards the eye: glTF 2.0 materials and KHR_lights_punctual, from their sources.

use std::f64::consts::PI;

use evis_scene::environment::Environment;
use evis_scene::{LightKind, Scene, SceneState, ShadingModel};
use glam::{DMat4, DVec3};

/// Smallest GGX width of a light without extent (perceptual roughness 0.045): narrower, its highlight is a point
/// that no sampling finds. The sources leave this to the implementation.
pub const ALPHA_MIN: f64 = 0.002;
/// Smallest cosine between normal and view; interpolated normals can turn away from the eye.
pub const N_DOT_V_MIN: f64 = 1e-4;

/// A surface point, ready to be lit.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// How it answers.
    pub model: ShadingModel,
    /// World position.
    pub position: DVec3,
    /// Unit shading normal on the side of the viewer.
    pub normal: DVec3,
    /// Unit vector to the eye.
    pub to_eye: DVec3,
    /// Linear base colour: factor, texture and vertex colour.
    pub base: DVec3,
    /// 0 to 1.
    pub metallic: f64,
    /// Perceptual, 0 to 1.
    pub roughness: f64,
    /// Part of the indirect light that arrives.
    pub occlusion: f64,
    /// Emitted radiance, waveform applied.
    pub emitted: DVec3,
    /// Factor of the waveform; the base colour of unlit surfaces takes it.
    pub emission_factor: f64,
}

/// A light at one instant.
#[derive(Clone, Copy, Debug)]
pub struct Lamp {
    kind: LightKind,
    position: DVec3,
    /// Where it shines.
    direction: DVec3,
    /// Colour times intensity times waveform.
    strength: DVec3,
    range: Option<f64>,
    /// Whether something in between darkens it; points never are (they have no shadow maps).
    pub casts_shadow: bool,
    /// One bit for each of the first 32 lamps that cast shadows, else 0.
    pub shadow_bit: u32,
    /// Its place in the list of all lamps.
    pub number: usize,
    /// For spots, scale and offset of the cone's cosine: KHR_lights_punctual, "Inner and Outer Cone Angles".
    cone: Option<[f64; 2]>,
}

/// Light that arrives at a point.
#[derive(Clone, Copy, Debug)]
pub struct Incident {
    /// Unit vector to the light.
    pub to_light: DVec3,
    /// Metres to the light; infinite for a directional one.
    pub distance: f64,
    /// Irradiance on a surface that faces the light.
    pub irradiance: DVec3,
}

/// The lights of `scene`, in node order.
pub fn lamps(scene: &Scene, state: &SceneState) -> Vec<Lamp> {
    let mut lamps: Vec<Lamp> = Vec::new();
    let mut next_bit = 1_u32;
    for (index, node) in scene.nodes.iter().enumerate() {
        let Some((number, light)) = node.light.and_then(|l| Some((l, scene.lights.get(l)?))) else {
            continue;
        };
        let world = state.world_from_node.get(index).copied().unwrap_or(DMat4::IDENTITY);
        let factor = state.light_factor.get(number).copied().unwrap_or(1.0);
        let own = state.lights.get(number).copied().unwrap_or_else(|| light.factors());
        let casts_shadow = light.casts_shadow && light.kind != LightKind::Point;
        let shadow_bit = if casts_shadow { next_bit } else { 0 };
        if casts_shadow {
            next_bit = next_bit.checked_mul(2).unwrap_or(0);
        }
        let cone = match light.kind {
            LightKind::Spot { inner, outer } => {
                let (inner, outer) = (f64::from(inner).cos(), f64::from(outer).cos());
                let scale = 1.0 / (inner - outer).max(0.001);
                Some([scale, -outer * scale])
            }
            _ => None,
        };
        lamps.push(Lamp {
            kind: light.kind,
            number: lamps.len(),
            cone,
            position: world.w_axis.truncate(),
            // KHR_lights_punctual: along the node's -Z; the node's scale does not count.
            direction: world.transform_vector3(DVec3::NEG_Z).normalize_or(DVec3::NEG_Z),
            strength: rgb(own.color) * f64::from(own.shining()) * f64::from(factor),
            range: light.range.map(f64::from).filter(|r| *r > 0.0),
            casts_shadow,
            shadow_bit,
        });
    }
    lamps
}

impl Lamp {
    /// Where it is; `None` for one that is infinitely far.
    pub fn place(&self) -> Option<DVec3> {
        (self.kind != LightKind::Directional).then_some(self.position)
    }

    /// What of this light arrives at `position`, if nothing is in between.
    pub fn incident(&self, position: DVec3) -> Incident {
        if self.kind == LightKind::Directional {
            // Lux: irradiance on a surface at right angles.
            return Incident {
                to_light: -self.direction,
                distance: f64::INFINITY,
                irradiance: self.strength,
            };
        }
        let offset = self.position - position;
        let distance = offset.length();
        let to_light = offset.normalize_or(-self.direction);
        // KHR_lights_punctual, "Range Property": max(min(1 - (d / range)^4, 1), 0) / d^2. Candela over distance
        // squared is irradiance; within a millimetre it stays what it is there.
        let window = self.range.map_or(1.0, |range| (1.0 - (distance / range).powi(4)).clamp(0.0, 1.0));
        let mut attenuation = window / (distance * distance).max(1e-6);
        if let Some([scale, offset]) = self.cone {
            let angular = (self.direction.dot(-to_light) * scale + offset).clamp(0.0, 1.0);
            attenuation *= angular * angular;
        }
        Incident { to_light, distance, irradiance: self.strength * attenuation }
    }
}

/// Radiance of `surface` towards the eye; `split_sum` gives scale and bias of F0 for n·v and roughness, `visible` says
/// what part of a lamp's light gets through.
///
/// Ambient light is EVIS's own: `ambient` is irradiance / pi, reflected by the diffuse colour and by F0 alike.
pub fn radiance(
    surface: &Surface,
    lamps: &[Lamp],
    ambient: DVec3,
    environment: Option<&Environment>,
    split_sum: impl Fn(f64, f64) -> [f64; 2],
    mut visible: impl FnMut(&Lamp, &Incident) -> f64,
) -> DVec3 {
    let s = surface;
    let mut direct = |brdf: &dyn Fn(DVec3) -> DVec3| -> DVec3 {
        lamps
            .iter()
            .map(|lamp| {
                let incident = lamp.incident(s.position);
                let n_dot_l = s.normal.dot(incident.to_light);
                if n_dot_l <= 0.0 || incident.irradiance == DVec3::ZERO {
                    return DVec3::ZERO;
                }
                brdf(incident.to_light) * incident.irradiance * (n_dot_l * visible(lamp, &incident))
            })
            .sum()
    };
    match s.model {
        // KHR_materials_unlit: the base colour; lights and emission do not count.
        ShadingModel::Unlit => s.base * s.emission_factor,
        ShadingModel::Diffuse => {
            let indirect = ambient + environment.map_or(DVec3::ZERO, |e| e.diffuse(s.normal));
            direct(&|_| s.base / PI) + s.base * indirect * s.occlusion + s.emitted
        }
        ShadingModel::MetallicRoughness => {
            let (diffuse, f0) = colors(s);
            let n_dot_v = s.normal.dot(s.to_eye).max(N_DOT_V_MIN);
            let mut indirect = ambient * (diffuse + f0);
            if let Some(environment) = environment {
                // B. Karis, "Real Shading in Unreal Engine 4", 2013; what is not reflected reaches the diffuse base.
                let [scale, bias] = split_sum(n_dot_v, s.roughness);
                let reflected = f0 * scale + bias;
                let mirror = (2.0 * s.normal.dot(s.to_eye) * s.normal - s.to_eye).normalize();
                indirect += environment.diffuse(s.normal) * diffuse * (1.0 - reflected)
                    + environment.reflection(mirror, s.roughness) * reflected;
            }
            direct(&|to_light| metallic_roughness(s, to_light)) + indirect * s.occlusion + s.emitted
        }
    }
}

/// Diffuse colour and F0: glTF 2.0, appendix B.3.5.
fn colors(s: &Surface) -> (DVec3, DVec3) {
    (s.base * (1.0 - s.metallic), DVec3::splat(0.04).lerp(s.base, s.metallic))
}

/// The BRDF of glTF 2.0, appendix B.3.5: `(1 - F) c_diff / pi + F D V`.
///
/// Masking is height-correlated (E. Heitz, "Understanding the Masking-Shadowing Function", JCGT 2014), as in the
/// Khronos Sample Viewer; the appendix prints the separable form and leaves the choice free.
pub fn metallic_roughness(s: &Surface, to_light: DVec3) -> DVec3 {
    let half = (s.to_eye + to_light).normalize();
    let (n_dot_l, n_dot_h) = (s.normal.dot(to_light), s.normal.dot(half).max(0.0));
    let n_dot_v = s.normal.dot(s.to_eye).max(N_DOT_V_MIN);
    let alpha2 = (s.roughness * s.roughness).max(ALPHA_MIN).powi(2);
    // Trowbridge-Reitz: appendix B.3.2.
    let distribution = alpha2 / (PI * (n_dot_h * n_dot_h * (alpha2 - 1.0) + 1.0).powi(2));
    // G / (4 n·l n·v).
    let masked = |a: f64, b: f64| a * (b * b * (1.0 - alpha2) + alpha2).sqrt();
    let visibility = 0.5 / (masked(n_dot_l, n_dot_v) + masked(n_dot_v, n_dot_l));
    // Schlick: appendix B.3.4.
    let (diffuse, f0) = colors(s);
    let fresnel = f0 + (1.0 - f0) * (1.0 - s.to_eye.dot(half).clamp(0.0, 1.0)).powi(5);
    (1.0 - fresnel) * diffuse / PI + fresnel * (distribution * visibility)
}

/// A colour in f64.
pub fn rgb(color: [f32; 3]) -> DVec3 {
    DVec3::from_array(color.map(f64::from))
}
