//! Lamps and surface points at a time: from where light comes, how wide its highlights are, and the sky.

use std::sync::OnceLock;

use evis_core::luminance::LUMINANCE_WEIGHTS;
use evis_scene::environment::{Environment, brdf_lut};
use evis_scene::motion::Waveform;
use evis_scene::{LightKind, Scene, ShadingModel};
use glam::{DQuat, DVec3};

use crate::image::environment::Surroundings;
use crate::scene::facets::wide;
use crate::scene::world::Frame;

/// Rec. ITU-R BT.709-6, item 3.2.
pub const LUMINANCE: DVec3 = DVec3::from_array(LUMINANCE_WEIGHTS);
/// Smallest GGX width of a light without extent.
pub const LEAST_ALPHA: f64 = 0.002;
/// Smallest cosine between normal and view.
pub const LEAST_COSINE: f64 = 1e-4;
/// Least width of the border of a cone that counts, in radians.
const LEAST_BORDER: f64 = 1e-3;
/// Entries per side of the split-sum table.
pub const SPLIT_SUM: usize = 128;

/// A light at a time.
#[derive(Clone, Copy, Debug)]
pub struct Lamp {
    /// What it is.
    pub kind: LightKind,
    /// World position; meaningless for a directional light.
    pub position: DVec3,
    /// Unit vector along which it shines.
    pub direction: DVec3,
    /// Irradiance of a directional light, else intensity, per channel.
    pub strength: DVec3,
    /// How far it reaches.
    pub range: Option<f64>,
    /// Scale and shift of its cone, see KHR_lights_punctual.
    pub cone: Option<[f64; 2]>,
    /// Its shadows are looked for; point lights throw none.
    pub casts_shadow: bool,
    /// It may be elsewhere at another time.
    pub moves: bool,
    /// What its strength is to be multiplied by, where that changes.
    pub waveform: Option<Waveform>,
}

impl Lamp {
    /// Where it is as a homogeneous point: a position, or with a last component of 0 a direction to it.
    pub fn place(&self) -> (DVec3, f64) {
        if self.kind == LightKind::Directional { (-self.direction, 0.0) } else { (self.position, 1.0) }
    }

    /// Unit vector to the light, and irradiance on a surface that faces it.
    #[cfg(test)]
    fn incident(&self, position: DVec3) -> (DVec3, DVec3) {
        if self.kind == LightKind::Directional {
            return (-self.direction, self.strength);
        }
        let offset = self.position - position;
        let squared = offset.length_squared();
        let to_light = offset.normalize_or(-self.direction);
        // KHR_lights_punctual, "Range Property"; within a millimetre intensity stays what it is there.
        let window = self.range.map_or(1.0, |r| (1.0 - (squared / (r * r)).powi(2)).clamp(0.0, 1.0));
        let mut attenuation = window / squared.max(1e-6);
        if let Some([scale, shift]) = self.cone {
            // KHR_lights_punctual, "Inner and Outer Cone Angles".
            let angular = (scale * -self.direction.dot(to_light) + shift).clamp(0.0, 1.0);
            attenuation *= angular * angular;
        }
        (to_light, self.strength * attenuation)
    }
}

/// The lights of `scene` at `frame`, in node order.
pub fn lamps(scene: &Scene, frame: &Frame, moving: &[bool]) -> Vec<Lamp> {
    let mut out = Vec::new();
    for (index, node) in scene.nodes.iter().enumerate() {
        let Some((number, light)) = node.light.and_then(|l| Some((l, scene.lights.get(l)?))) else {
            continue;
        };
        let pose = frame.world_from_node(index);
        let waveform = light.waveform.filter(|w| !w.rests());
        let factor = match waveform {
            // It is applied at each evaluation.
            Some(_) => 1.0,
            None => frame.state.light_factor.get(number).copied().unwrap_or(1.0),
        };
        let own = frame.state.lights.get(number).copied().unwrap_or_else(|| light.factors());
        let cone = match light.kind {
            LightKind::Spot { inner, outer } => {
                let (inner, outer) = (f64::from(inner).cos(), f64::from(outer).cos());
                let scale = 1.0 / (inner - outer).max(0.001);
                Some([scale, -outer * scale])
            }
            LightKind::Directional | LightKind::Point => None,
        };
        out.push(Lamp {
            kind: light.kind,
            position: pose.w_axis.truncate(),
            direction: pose.transform_vector3(DVec3::NEG_Z).normalize_or(DVec3::NEG_Z),
            strength: wide(own.color) * f64::from(own.shining()) * f64::from(factor),
            range: light.range.map(f64::from).filter(|r| *r > 0.0),
            cone,
            casts_shadow: light.casts_shadow && light.kind != LightKind::Point,
            moves: moving[index],
            waveform,
        });
    }
    out
}

/// A surface point to be lit.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    /// How it answers.
    pub model: ShadingModel,
    /// World position.
    pub position: DVec3,
    /// Unit normal towards the viewer's side.
    pub normal: DVec3,
    /// Unit vector to the eye.
    pub to_eye: DVec3,
    /// 0 to 1.
    pub metallic: f64,
    /// Perceptual, 0 to 1.
    pub roughness: f64,
    /// Part of the indirect light that arrives.
    pub occlusion: f64,
    /// Mean base colour of the surface.
    pub mean_base: DVec3,
}

/// Indirect light.
pub struct Around {
    /// Radiance from everywhere.
    pub ambient: DVec3,
    /// The environment's.
    pub surroundings: Option<Surroundings>,
}

impl Around {
    /// That of `scene`.
    pub fn new(scene: &Scene) -> Self {
        let surroundings = scene.environment.as_ref().map(Surroundings::new);
        Self { ambient: wide(scene.ambient), surroundings }
    }
}

impl Around {
    /// Appends what a device needs of it, see [`crate::packed::Textures::around`].
    pub fn pack(&self, rows: &mut Vec<[f32; 4]>) {
        let first = rows.len();
        let [r, g, b] = self.ambient.to_array().map(|v| v as f32);
        rows.extend([[0.0; 4], [0.0; 4], [r, g, b, 0.0]]);
        if let Some(surroundings) = &self.surroundings {
            surroundings.pack(rows, first);
            rows[first][3] = f32::from_bits((rows.len() - first) as u32);
            rows.extend(split_sums().chunks(2).map(|pair| [pair[0][0], pair[0][1], pair[1][0], pair[1][1]]));
        }
    }
}

/// Angle between normal and half vector at which a highlight has a quarter of its peak.
pub fn lobe_width(roughness: f64) -> f64 {
    (roughness * roughness).max(LEAST_ALPHA)
}

/// How far a place is from the middle of the border of a lamp's cone, in widths of the border; `None` of a lamp that has none.
pub fn from_cone(position: DVec3, lamp: &Lamp) -> Option<f64> {
    let LightKind::Spot { inner, outer } = lamp.kind else { return None };
    let (inner, outer) = (f64::from(inner), f64::from(outer));
    let angle = lamp.direction.angle_between(position - lamp.position);
    Some((angle - 0.5 * (inner + outer)) / (outer - inner).max(LEAST_BORDER))
}

/// How much a highlight counts beside diffuse light, as a factor on how finely it is to be followed: what is off falls with
/// its square.
pub fn lobe_weight(point: &Point) -> f64 {
    let dielectric = LUMINANCE.dot(point.mean_base) * (1.0 - point.metallic);
    let f0 = 0.04 * (1.0 - point.metallic) + LUMINANCE.dot(point.mean_base) * point.metallic;
    // At its peak, seen and lit along the normal: D = 1 / (pi alpha^2), V = 1 / 4.
    let peak = 0.25 * f0 / lobe_width(point.roughness).powi(2);
    (peak / (peak + dielectric).max(1e-9)).sqrt()
}

/// [`SPLIT_SUM`] squared pairs of the split sum.
pub fn split_sums() -> &'static [[f32; 2]] {
    static TABLE: OnceLock<Vec<[f32; 2]>> = OnceLock::new();
    TABLE.get_or_init(|| brdf_lut(SPLIT_SUM))
}

/// Luminance of the sky in `direction` (any length), over a footprint of so many `texels`.
pub fn sky(environment: &Environment, direction: DVec3, texels: f64) -> f64 {
    let turned = DQuat::from_rotation_y(-f64::from(environment.rotation)) * direction;
    let color = environment.sky.sample(turned, texels.max(1.0).log2());
    LUMINANCE.dot(wide(color)) * f64::from(environment.intensity)
}

/// Texels of the sky per radian in the middle of a face: one spans 2 / size there.
pub fn sky_texels(environment: &Environment) -> f64 {
    0.5 * f64::from(environment.sky.size)
}

/// How one place responds to light, in 64 bits: what tests hold four places at once to.
#[cfg(test)]
pub mod exact {
    use std::f64::consts::PI;

    use super::*;

    /// Outgoing luminance as a function of base colour: `linear . base + constant`. Exact for dielectrics and metals, the secant at the
    /// surface's mean base colour for what is between.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    pub struct Response {
        /// Per channel, luminance weights applied.
        pub linear: DVec3,
        /// Luminance.
        pub constant: f64,
    }

    impl Response {
        fn add(&mut self, linear: DVec3, constant: DVec3) {
            self.linear += LUMINANCE * linear;
            self.constant += LUMINANCE.dot(constant);
        }
    }

    /// Responses to everything but the lamps of indices `own`, then to each of these if nothing is in between.
    pub fn respond(point: &Point, lamps: &[Lamp], own: &[usize], around: &Around, out: &mut [Response]) {
        let (open, apart) = out.split_at_mut(1);
        indirect(point, around, &mut open[0]);
        for (index, lamp) in lamps.iter().enumerate() {
            match own.iter().position(|o| *o == index) {
                Some(number) => direct(point, lamp, &mut apart[number]),
                None => direct(point, lamp, &mut open[0]),
            }
        }
    }

    /// `base (1 - F)` and `F` of a mixed material, linear in base: see [`Response`].
    struct Mix {
        metallic: f64,
        mean: DVec3,
    }

    impl Mix {
        /// Adds `diffuse (1 - m) base (1 - f f0 - g) + specular (f f0 + g)`, where f0 = 0.04 (1 - m) + m base.
        fn add(&self, out: &mut Response, diffuse: DVec3, specular: DVec3, f: f64, g: f64) {
            let (m, dielectric) = (self.metallic, 0.04 * (1.0 - self.metallic));
            let (linear, square) = (1.0 - m, -(1.0 - m) * m * f);
            let constant = 1.0 - f * dielectric - g;
            // The secant of base^2 between 0 and the mean is the mean.
            out.add(
                diffuse * (DVec3::splat(linear * constant) + self.mean * square) + specular * (m * f),
                specular * (f * dielectric + g),
            );
        }
    }

    fn direct(point: &Point, lamp: &Lamp, out: &mut Response) {
        let (to_light, irradiance) = lamp.incident(point.position);
        let n_dot_l = point.normal.dot(to_light);
        if n_dot_l <= 0.0 || irradiance == DVec3::ZERO {
            return;
        }
        let light = irradiance * n_dot_l;
        if point.model == ShadingModel::Diffuse {
            out.add(light / PI, DVec3::ZERO);
            return;
        }
        // glTF 2.0, appendix B.3; height-correlated masking (E. Heitz, JCGT 2014).
        let half = (point.to_eye + to_light).normalize_or(point.normal);
        let n_dot_h = point.normal.dot(half).max(0.0);
        let n_dot_v = point.normal.dot(point.to_eye).max(LEAST_COSINE);
        let alpha2 = (point.roughness * point.roughness).max(LEAST_ALPHA).powi(2);
        let distribution = alpha2 / (PI * (n_dot_h * n_dot_h * (alpha2 - 1.0) + 1.0).powi(2));
        let masked = |a: f64, b: f64| a * (b * b * (1.0 - alpha2) + alpha2).sqrt();
        let visibility = 0.5 / (masked(n_dot_l, n_dot_v) + masked(n_dot_v, n_dot_l));
        let grazing = (1.0 - point.to_eye.dot(half).clamp(0.0, 1.0)).powi(5);
        let mix = Mix { metallic: point.metallic, mean: point.mean_base };
        // F = f0 (1 - grazing) + grazing.
        mix.add(out, light / PI, light * (distribution * visibility), 1.0 - grazing, grazing);
    }

    fn indirect(point: &Point, around: &Around, out: &mut Response) {
        let ambient = around.ambient * point.occlusion;
        let environment = around.surroundings.as_ref();
        let around = environment.map_or(DVec3::ZERO, |e| e.diffuse(point.normal)) * point.occlusion;
        if point.model == ShadingModel::Diffuse {
            out.add(ambient + around, DVec3::ZERO);
            return;
        }
        let m = point.metallic;
        // Ambient light meets diffuse colour and f0 alike: base (1 - m) + 0.04 (1 - m) + base m.
        out.add(ambient, ambient * (0.04 * (1.0 - m)));
        if let Some(environment) = environment {
            let n_dot_v = point.normal.dot(point.to_eye).max(LEAST_COSINE);
            let [scale, bias] = split_sum(n_dot_v, point.roughness);
            let mirror = (2.0 * point.normal.dot(point.to_eye) * point.normal - point.to_eye)
                .normalize_or(point.normal);
            let reflected = environment.reflection(mirror, point.roughness) * point.occlusion;
            Mix { metallic: m, mean: point.mean_base }.add(out, around, reflected, scale, bias);
        }
    }

    /// Scale and bias of F0 under light from all around (B. Karis, 2013), read bilinearly from a table.
    fn split_sum(n_dot_v: f64, roughness: f64) -> [f64; 2] {
        let table = split_sums();
        let place = |v: f64| {
            let at = (v * SPLIT_SUM as f64 - 0.5).clamp(0.0, (SPLIT_SUM - 1) as f64);
            let low = (at as usize).min(SPLIT_SUM - 2);
            (low, at - low as f64)
        };
        let ((x, fx), (y, fy)) = (place(n_dot_v), place(roughness));
        [0, 1].map(|k| {
            let entry = |x: usize, y: usize| f64::from(table[y * SPLIT_SUM + x][k]);
            (entry(x, y) * (1.0 - fx) + entry(x + 1, y) * fx) * (1.0 - fy)
                + (entry(x, y + 1) * (1.0 - fx) + entry(x + 1, y + 1) * fx) * fy
        })
    }
}
