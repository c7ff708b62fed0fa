//! Light that four places of a surface send at once, in 32 bits: glTF 2.0 metallic-roughness, as a linear function of base colour, at a
//! time of a block.
//!
//! Lamps, the eye and the corners of facets are quadratics of the block's time. About the middle of what a pixel sees of a facet
//! all is counted from there, which 64 bits find: 32 bits suffice for what is left. The twin of a device's `decoupled/maps.wgsl`.

use std::f32::consts::PI;

use evis_scene::{LightKind, ShadingModel};
use glam::{DVec3, Mat4, Vec4};

use crate::fours::{Four, parts};
use crate::image::maps::FacetMaps;
use crate::packed;
use crate::shading::material::{
    Around, LEAST_ALPHA, LEAST_COSINE, LUMINANCE, Lamp, Point, SPLIT_SUM, split_sums,
};
use crate::visibility::lists::powers;

/// A vector as a quadratic of the block's time.
#[derive(Clone, Copy, Debug, Default)]
pub struct OverTime([DVec3; 3]);

impl OverTime {
    /// The one that goes through what is there at the start, middle and end of a block.
    pub fn through(at: [DVec3; 3]) -> Self {
        Self(powers(at))
    }

    /// At part `u` of the block.
    #[inline(always)]
    pub fn at(&self, u: f64) -> DVec3 {
        let [a, b, c] = self.0;
        a + (b + c * u) * u
    }

    /// Rows of a device; `last` is the last number of the first one.
    pub fn rows(&self, last: f32) -> [[f32; 4]; 3] {
        let row = |v: DVec3, last: f32| [v.x as f32, v.y as f32, v.z as f32, last];
        let [a, b, c] = self.0;
        [row(a, last), row(b, 0.0), row(c, 0.0)]
    }
}

/// A lamp during a block.
#[derive(Clone, Copy, Debug)]
pub struct LampOverTime {
    position: OverTime,
    direction: OverTime,
    strength: OverTime,
    has_place: bool,
    range: Option<f64>,
    cone: Option<[f64; 2]>,
    /// Its number among those whose light is kept apart, plus 1.
    own: usize,
}

impl LampOverTime {
    /// A lamp that is this at the start, middle and end of the block; `own` is its number among those whose light is kept apart,
    /// plus 1.
    pub fn new(at: [&Lamp; 3], own: usize) -> Self {
        let of = |get: fn(&Lamp) -> DVec3| OverTime::through(at.map(get));
        let [first, ..] = at;
        Self {
            position: of(|lamp| lamp.position),
            direction: of(|lamp| lamp.direction),
            strength: of(|lamp| lamp.strength),
            has_place: first.kind != LightKind::Directional,
            range: first.range,
            cone: first.cone,
            own,
        }
    }

    /// Rows of a device, see [`packed::LIGHT_ROWS`].
    pub fn pack(&self) -> [[f32; 4]; packed::LIGHT_ROWS] {
        let [scale, shift] = self.cone.unwrap_or_default().map(|v| v as f32);
        let range = self.range.map_or(0.0, |range| range as f32);
        let mut rows = [[0.0; 4]; packed::LIGHT_ROWS];
        let own = f32::from_bits(self.own as u32);
        rows[..3].copy_from_slice(&self.position.rows(f32::from(u8::from(self.has_place))));
        rows[3..6].copy_from_slice(&self.direction.rows(range));
        rows[6..9].copy_from_slice(&self.strength.rows(own));
        rows[9] = [scale, shift, f32::from(u8::from(self.cone.is_some())), 0.0];
        rows
    }

    /// At part `u` of the block, seen from `middle`.
    #[inline(always)]
    pub fn at(&self, u: f64, middle: DVec3) -> LampAt {
        let to_light = -self.direction.at(u).normalize_or(DVec3::NEG_Z);
        LampAt {
            offset: self.has_place.then(|| Four::splat(self.position.at(u) - middle)),
            to_light: Four::splat(to_light),
            strength: Four::splat(self.strength.at(u)),
            inverse_range: self.range.map_or(0.0, |range| (1.0 / (range * range)) as f32),
            cone: self.cone.map(|cone| cone.map(|v| v as f32)),
            own: self.own,
        }
    }
}

/// The eye and lamps during a block.
#[derive(Default)]
pub struct LightsOverTime {
    /// Where the eye is, or the direction of its rays.
    pub eye: OverTime,
    /// Its rays are parallel.
    pub is_parallel: bool,
    /// Lamps.
    pub lamps: Vec<LampOverTime>,
}

/// A facet during a block.
pub struct FacetOverTime {
    /// World positions at (s, t) = (0, 0), (1, 0) and (0, 1).
    pub positions: [OverTime; 3],
    /// Normals there.
    pub normals: [OverTime; 3],
}

impl FacetOverTime {
    /// Rows of a device: by power of time positions, then normals.
    pub fn rows(&self) -> [[f32; 4]; packed::GEOMETRY_ROWS] {
        let mut rows = [[0.0; 4]; packed::GEOMETRY_ROWS];
        for (number, of) in self.positions.iter().chain(&self.normals).enumerate() {
            for (power, row) in of.rows(0.0).into_iter().enumerate() {
                rows[packed::GEOMETRY_ROWS / 3 * power + number] = row;
            }
        }
        rows
    }
}

/// What maps add to a facet during a block.
pub struct MappedFacet {
    /// Tangents at (s, t) = (0, 0), (1, 0) and (0, 1).
    pub tangents: [OverTime; 3],
    /// Signs of bitangents there.
    pub signs: [f64; 3],
    /// What varies on it.
    pub maps: FacetMaps,
}

/// A lamp at a time, seen from the middle of what a pixel sees of a facet.
#[derive(Clone, Copy)]
pub struct LampAt {
    /// The way to its place, where it has one.
    offset: Option<Four>,
    /// To where it comes from, or against its axis.
    to_light: Four,
    strength: Four,
    /// 1 / square of its range; 0 where it has none.
    inverse_range: f32,
    cone: Option<[f32; 2]>,
    /// Its number among those whose light is kept apart, plus 1.
    pub own: usize,
}

impl LampAt {
    /// Unit vectors to the lamp, and irradiances on surfaces that face it, at places this far from the middle.
    #[inline(always)]
    fn incident(&self, from_middle: Four) -> (Four, Four) {
        let Some(offset) = self.offset else { return (self.to_light, self.strength) };
        let way = offset - from_middle;
        let squared = way.dot(way);
        let to_light = way.normalize_or(self.to_light);
        // KHR_lights_punctual, "Range Property"; within a millimetre intensity stays what it is there.
        let part = squared * self.inverse_range;
        let mut attenuation =
            (1.0 - part * part).clamp(Vec4::ZERO, Vec4::ONE) / squared.max(Vec4::splat(1e-6));
        if let Some([scale, shift]) = self.cone {
            // KHR_lights_punctual, "Inner and Outer Cone Angles".
            let angular = (self.to_light.dot(to_light) * scale + shift).clamp(Vec4::ZERO, Vec4::ONE);
            attenuation *= angular * angular;
        }
        (to_light, self.strength * attenuation)
    }
}

/// Four places of a surface to be lit.
#[derive(Clone, Copy, Debug, Default)]
pub struct Points {
    /// From the middle of what the pixel sees.
    pub from_middle: Four,
    /// Unit normals towards the viewer's side.
    pub normal: Four,
    /// Unit vectors to the eye.
    pub to_eye: Four,
    /// Base colours.
    pub base: Four,
    /// 0 to 1.
    pub metallic: Vec4,
    /// Perceptual, 0 to 1.
    pub roughness: Vec4,
    /// Parts of the indirect light that arrive.
    pub occlusion: Vec4,
}

/// What four places send of some light, per channel: base colour times `linear`, and luminance that is `constant`. Exact for
/// dielectrics and metals, of what is between the secant at the base colour that is known.
#[derive(Clone, Copy, Debug, Default)]
pub struct Responses {
    /// Factors of base colour.
    pub linear: Four,
    /// What does not depend on it.
    pub constant: Vec4,
}

impl Responses {
    /// Luminances that places with these base colours send.
    #[inline(always)]
    pub fn sent(self, base: Four) -> Sent {
        Sent { proportional: (self.linear * base).luminance(), constant: self.constant }
    }

    /// Per place luminance as a function of base colour: factors of its channels, and what does not depend on it.
    #[inline(always)]
    pub fn rows(self) -> [[f32; 4]; 4] {
        let [r, g, b] = LUMINANCE.to_array().map(|w| w as f32);
        let Self { linear: Four { x, y, z }, constant } = self;
        Mat4::from_cols(x * r, y * g, z * b, constant).transpose().to_cols_array_2d()
    }

    /// Whether anything is sent back at any of the places.
    #[inline(always)]
    pub fn is_any(self) -> bool {
        let Self { linear: Four { x, y, z }, constant } = self;
        (x.abs() + y.abs() + z.abs() + constant.abs()).cmpgt(Vec4::ZERO).any()
    }

    /// The mean of that over the places.
    #[inline(always)]
    pub fn mean(self) -> Vec4 {
        let [a, b, c, d] = self.rows().map(Vec4::from_array);
        ((a + b) + (c + d)) * 0.25
    }
}

impl std::ops::AddAssign for Responses {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        self.linear = self.linear + other.linear;
        self.constant += other.constant;
    }
}

/// A facet without maps and its lamps at a time, seen from a place of it.
pub struct LitFacet {
    model: ShadingModel,
    /// (s, t) of that place.
    middle: [f64; 2],
    /// How positions change with s and t.
    along: [Four; 2],
    /// Normals at (s, t) = (0, 0), and their change with s and t.
    normals: [Four; 3],
    /// 1 from its front, -1 from behind.
    side: f32,
    /// From there to the eye, or against its rays where these are parallel.
    to_eye: Four,
    is_parallel: bool,
    /// What is the same everywhere on it.
    all: Points,
    lamps: Vec<LampAt>,
}

impl LitFacet {
    /// `facet` of a surface that is `all` at part `u` of the block, seen from (s, t) = `middle`; from its front, where `side` is 1, or
    /// from behind (-1).
    pub fn new(
        (facet, all, side): (&FacetOverTime, &Point, f64),
        lights: &LightsOverTime,
        u: f64,
        middle: [f64; 2],
    ) -> Self {
        let changes = |of: &[OverTime; 3]| {
            let [a, b, d] = of.each_ref().map(|v| v.at(u));
            [a, b - a, d - a]
        };
        let [first, along @ ..] = changes(&facet.positions);
        let place = first + along[0] * middle[0] + along[1] * middle[1];
        let eye = lights.eye.at(u);
        Self {
            model: all.model,
            middle,
            along: along.map(Four::splat),
            normals: changes(&facet.normals).map(Four::splat),
            side: side as f32,
            to_eye: Four::splat(if lights.is_parallel { -eye } else { eye - place }),
            is_parallel: lights.is_parallel,
            all: Points {
                base: Four::splat(all.mean_base),
                metallic: Vec4::splat(all.metallic as f32),
                roughness: Vec4::splat(all.roughness as f32),
                occlusion: Vec4::splat(all.occlusion as f32),
                ..Points::default()
            },
            lamps: lights.lamps.iter().map(|lamp| lamp.at(u, place)).collect(),
        }
    }

    /// Four places (s, t) of it.
    #[inline(always)]
    pub fn points(&self, places: &[[f64; 2]; 4]) -> Points {
        let [s, t] = [0, 1].map(|k| Vec4::from_array(places.map(|place| place[k] as f32)));
        let [ds, dt] =
            [0, 1].map(|k| Vec4::from_array(places.map(|place| (place[k] - self.middle[k]) as f32)));
        let from_middle = self.along[0] * ds + self.along[1] * dt;
        let up = Four { z: Vec4::ONE, ..Four::default() };
        let [normal, along @ ..] = self.normals;
        let normal = (normal + along[0] * s + along[1] * t).normalize_or(up) * self.side;
        let to_eye = if self.is_parallel { self.to_eye } else { self.to_eye - from_middle };
        Points { from_middle, normal, to_eye: to_eye.normalize_or(up), ..self.all }
    }

    /// How many lamps there are.
    pub fn lamp_count(&self) -> usize {
        self.lamps.len()
    }

    /// Half vectors of lamp number `lamp` less normals: its highlight is brightest where that is 0.
    pub fn from_highlight(&self, points: &Points, lamp: usize) -> Four {
        let to_light = self.lamps[lamp].incident(points.from_middle).0;
        (points.to_eye + to_light).normalize_or(points.normal) - points.normal
    }

    /// How they respond to everything but the lamps that are kept apart (0), or to one of these (its number plus 1) if nothing is in
    /// between.
    #[inline(always)]
    pub fn response(&self, points: &Points, own: usize, around: &Around) -> Responses {
        let mut response = if own == 0 { points.of_around(around, self.model) } else { Responses::default() };
        for lamp in self.lamps.iter().filter(|lamp| lamp.own == own) {
            response += points.of_lamp(lamp, self.model);
        }
        response
    }
}

/// Luminances that four places send: of what is proportional to base colour, and of the rest.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sent {
    /// What is proportional to base colour.
    pub proportional: Vec4,
    /// What is not.
    pub constant: Vec4,
}

impl Points {
    /// Diffuse light `diffuse (1 - m) (1 - F)` and mirrored light `specular F`, F = f f0 + g and f0 = 0.04 (1 - m) + m base.
    #[inline(always)]
    fn mixed(&self, diffuse: Four, specular: Four, f: Vec4, g: Vec4) -> Responses {
        let rest = 1.0 - self.metallic;
        let dielectric = rest * 0.04;
        let (flat, steep) = (rest * (1.0 - f * dielectric - g), rest * self.metallic * f);
        let constant = Four { x: flat, y: flat, z: flat } - self.base * steep;
        Responses {
            linear: diffuse * constant + specular * (self.metallic * f),
            constant: specular.luminance() * (f * dielectric + g),
        }
    }

    /// What of indirect light they send.
    #[inline(always)]
    pub fn of_around(&self, around: &Around, model: ShadingModel) -> Responses {
        let ambient = Four::splat(around.ambient) * self.occlusion;
        let surroundings = around.surroundings.as_ref();
        let irradiance =
            surroundings.map_or(Four::default(), |s| s.diffuse_of_four(self.normal) * self.occlusion);
        if model == ShadingModel::Diffuse {
            return Responses { linear: ambient + irradiance, constant: Vec4::ZERO };
        }
        // Ambient light meets diffuse colour and f0 alike: base (1 - m) + 0.04 (1 - m) + base m.
        let constant = ambient.luminance() * ((1.0 - self.metallic) * 0.04);
        let mut response = Responses { linear: ambient, constant };
        if let Some(surroundings) = surroundings {
            let cosine = self.normal.dot(self.to_eye);
            let [scale, bias] = split_sum(cosine.max(Vec4::splat(LEAST_COSINE as f32)), self.roughness);
            let mirror = (self.normal * (cosine * 2.0) - self.to_eye).normalize_or(self.normal);
            let reflected = surroundings.reflection_of_four(mirror, self.roughness) * self.occlusion;
            response += self.mixed(irradiance, reflected, scale, bias);
        }
        response
    }

    /// What of a lamp's light they send if nothing is in between.
    #[inline(always)]
    pub fn of_lamp(&self, lamp: &LampAt, model: ShadingModel) -> Responses {
        let (to_light, irradiance) = lamp.incident(self.from_middle);
        let n_dot_l = self.normal.dot(to_light);
        let reached = n_dot_l.cmpgt(Vec4::ZERO);
        if !reached.any() {
            return Responses::default();
        }
        // Of no light nothing comes back, whatever the rest is.
        let n_dot_l = n_dot_l.max(Vec4::ZERO);
        let light = irradiance * n_dot_l;
        let diffuse = light * (1.0 / PI);
        if model == ShadingModel::Diffuse {
            return Responses { linear: diffuse, constant: Vec4::ZERO };
        }
        // glTF 2.0, appendix B.3; height-correlated masking (E. Heitz, JCGT 2014).
        let half = (self.to_eye + to_light).normalize_or(self.normal);
        let n_dot_h = self.normal.dot(half);
        let n_dot_v = self.normal.dot(self.to_eye).max(Vec4::splat(LEAST_COSINE as f32));
        let alpha = (self.roughness * self.roughness).max(Vec4::splat(LEAST_ALPHA as f32));
        let alpha2 = alpha * alpha;
        let rest = 1.0 - alpha2;
        // 1 - n_dot_h^2, which cancels where a highlight is: by the difference of the vectors.
        let off = half - self.normal;
        let squared = off.dot(off);
        let sine2 = Vec4::select(n_dot_h.cmpgt(Vec4::ZERO), squared * (1.0 - squared * 0.25), Vec4::ONE);
        let narrow = alpha2 + sine2 * rest;
        let masked = |a: Vec4, b: Vec4| a * (b * b * rest + alpha2).sqrt();
        let shadowing = masked(n_dot_l, n_dot_v) + masked(n_dot_v, n_dot_l);
        let lobe = alpha2 / (narrow * narrow * shadowing * (2.0 * PI));
        let off_peak = 1.0 - self.to_eye.dot(half).clamp(Vec4::ZERO, Vec4::ONE);
        let squared = off_peak * off_peak;
        let grazing = squared * squared * off_peak;
        self.mixed(diffuse, light * lobe, 1.0 - grazing, grazing)
    }
}

/// Scale and bias of F0 under light from all around, as [`crate::shading::material`] reads them.
#[inline(always)]
fn split_sum(n_dot_v: Vec4, roughness: Vec4) -> [Vec4; 2] {
    let table = split_sums();
    let place = |v: Vec4| {
        let most = Vec4::splat((SPLIT_SUM - 1) as f32);
        let (low, rest) = parts((v * SPLIT_SUM as f32 - 0.5).clamp(Vec4::ZERO, most));
        (low, rest.to_array())
    };
    let ((columns, fx), (rows, fy)) = (place(n_dot_v), place(roughness));
    let mut each = [Vec4::ZERO; 4];
    for (k, value) in each.iter_mut().enumerate() {
        let first = rows[k] as u32 as usize * SPLIT_SUM + columns[k] as u32 as usize;
        let (upper, lower) = (&table[first..][..2], &table[first + SPLIT_SUM..][..2]);
        let pair = |row: &[[f32; 2]]| Vec4::new(row[0][0], row[0][1], row[1][0], row[1][1]);
        let (upper, lower) = (pair(upper), pair(lower));
        *value = upper + (lower - upper) * fy[k];
    }
    let turned = Mat4::from_cols(each[0], each[1], each[2], each[3]).transpose();
    let fx = Vec4::from_array(fx);
    let [low, high] = [[turned.x_axis, turned.z_axis], [turned.y_axis, turned.w_axis]];
    [low, high].map(|[near, far]| near + (far - near) * fx)
}

#[cfg(test)]
mod tests {
    use evis_scene::environment::Environment;

    use evis_scene::{Eye, Scene};

    use super::*;
    use crate::scene::testing::numbers;
    use crate::shading::material::exact::{Response, respond};

    fn four(of: [DVec3; 4]) -> Four {
        Four::of(of.map(|v| v.as_vec3().extend(0.0)))
    }

    #[test]
    fn four_places_send_what_each_does_by_itself() {
        let mut next = numbers(1);
        let environment = Some(Environment { rotation: 0.7, ..Environment::studio() });
        let ambient = [0.1, 0.2, 0.05];
        let [dark, sky] = [None, environment]
            .map(|environment| Around::new(&Scene { ambient, environment, ..Scene::default() }));
        // Far from the origin: what 32 bits have counts from the middle.
        let middle = DVec3::new(250.0, -130.0, 75.0);
        let lamp = |kind: LightKind, range: Option<f64>, cone: Option<[f64; 2]>| Lamp {
            kind,
            position: middle + DVec3::new(0.8, 1.5, 1.1),
            direction: DVec3::new(-0.4, -0.7, -0.5).normalize(),
            strength: DVec3::new(2.0, 1.5, 1.0),
            range,
            cone,
            casts_shadow: false,
            moves: false,
            waveform: None,
        };
        let cone = LightKind::Spot { inner: 0.2, outer: 0.6 };
        let lamps = [
            lamp(LightKind::Directional, None, None),
            lamp(LightKind::Point, Some(3.0), None),
            lamp(cone, None, Some([4.0, -3.0])),
        ];
        let (mut lit, mut canary) = (0, 0);
        for k in 0..600 {
            let model = if k % 4 == 0 { ShadingModel::Diffuse } else { ShadingModel::MetallicRoughness };
            let (lamp, around) = (&lamps[k % 3], if k % 2 == 0 { &dark } else { &sky });
            let mut vector = |size: f64| DVec3::new(next() - 0.5, next() - 0.5, next() - 0.5) * size;
            let facing = DVec3::new(0.3, 0.8, 0.5);
            let points: [(Point, DVec3); 4] = std::array::from_fn(|_| {
                let normal = (facing + vector(1.6)).normalize();
                let base = vector(0.8) + 0.5;
                let rest = vector(1.0) + 0.5;
                let point = Point {
                    model,
                    position: middle + vector(0.2),
                    normal,
                    // Near a mirror's direction, so that there are highlights.
                    to_eye: (2.0 * normal.dot(facing) * normal - facing + vector(0.4)).normalize(),
                    metallic: rest.x,
                    roughness: rest.y,
                    occlusion: rest.z,
                    mean_base: base,
                };
                (point, base)
            });
            let each = |of: fn(&Point) -> DVec3| four(points.map(|(point, _)| of(&point)));
            let rest = each(|p| DVec3::new(p.metallic, p.roughness, p.occlusion));
            let together = Points {
                from_middle: four(points.map(|(point, _)| point.position - middle)),
                normal: each(|p| p.normal),
                to_eye: each(|p| p.to_eye),
                base: each(|p| p.mean_base),
                metallic: rest.x,
                roughness: rest.y,
                occlusion: rest.z,
            };
            let at = LampOverTime::new([lamp; 3], 0).at(0.3, middle);
            let sent = [together.of_around(around, model), together.of_lamp(&at, model)];
            let sent = sent.map(|response| response.sent(together.base));
            for (number, (point, base)) in points.iter().enumerate() {
                let mut wanted = [Response::default(); 2];
                respond(point, std::slice::from_ref(lamp), &[0], around, &mut wanted);
                for (sent, wanted) in sent.iter().zip(&wanted) {
                    let parts = [wanted.linear.dot(*base), wanted.constant];
                    let found = [sent.proportional, sent.constant].map(|v| v.to_array().map(f64::from));
                    for (found, wanted) in found.iter().zip(parts) {
                        let near = |found: f64| (found - wanted).abs() <= 1e-3 * wanted.abs() + 1e-5;
                        assert!(near(found[number]), "{k}: {} and not {wanted}", found[number]);
                        canary += usize::from(!near(found[(number + 1) % 4]));
                        lit += usize::from(wanted > 0.01);
                    }
                }
            }
        }
        assert!(lit > 2000 && canary > 2000, "{lit} lit, {canary} unlike their neighbours");
        assert!((Four::ONE.luminance().x - LUMINANCE.element_sum() as f32).abs() < 1e-6);
    }

    /// A facet at a time.
    struct Facet {
        /// World places and normals of its corners at (s, t) = (0, 0), (1, 0) and (0, 1).
        corners: [(DVec3, DVec3); 3],
        eye: Eye,
        side: f64,
        all: Point,
    }

    impl Facet {
        fn point(&self, [s, t]: [f64; 2]) -> Point {
            let blend = |[a, b, d]: [DVec3; 3]| a + (b - a) * s + (d - a) * t;
            let position = blend(self.corners.map(|c| c.0));
            Point {
                position,
                normal: blend(self.corners.map(|c| c.1)).normalize() * self.side,
                to_eye: -self.eye.toward(position).normalize(),
                ..self.all
            }
        }
    }

    #[test]
    fn four_places_of_a_facet_respond_as_each_does_by_itself() {
        let mut next = numbers(7);
        let environment = Some(Environment { rotation: 0.7, ..Environment::studio() });
        let around = Around::new(&Scene { ambient: [0.1, 0.2, 0.05], environment, ..Scene::default() });
        let place = DVec3::new(250.0, -130.0, 75.0);
        let lamp = |kind: LightKind, offset: DVec3, cone: Option<[f64; 2]>| Lamp {
            kind,
            position: place + offset,
            direction: -offset.normalize(),
            strength: DVec3::new(2.0, 1.5, 1.0),
            range: Some(9.0),
            cone,
            casts_shadow: true,
            moves: false,
            waveform: None,
        };
        let lamps = [
            lamp(LightKind::Point, DVec3::new(0.5, 1.5, 0.2), None),
            lamp(LightKind::Directional, DVec3::new(0.2, 1.0, -0.4), None),
            lamp(LightKind::Spot { inner: 0.2, outer: 0.9 }, DVec3::new(-0.8, 1.2, 0.6), Some([2.6, -1.6])),
        ];
        let (mut lit, mut canary) = (0, 0);
        for k in 0..200 {
            let mut vector = |size: f64| DVec3::new(next() - 0.5, next() - 0.5, next() - 0.5) * size;
            let at = [DVec3::ZERO, DVec3::X, DVec3::Z].map(|offset| place + offset + vector(0.3));
            let corners = at.map(|position| (position, (DVec3::Y + vector(1.2)).normalize()));
            let rest = vector(1.0) + 0.5;
            let facet = Facet {
                corners,
                eye: match k % 3 {
                    0 => Eye::Along(DVec3::new(0.2, -0.9, 0.3).normalize()),
                    _ => Eye::At(place + DVec3::new(0.4, 2.0, 0.5) + vector(1.0)),
                },
                side: if k % 5 == 0 { -1.0 } else { 1.0 },
                all: Point {
                    model: if k % 4 == 0 { ShadingModel::Diffuse } else { ShadingModel::MetallicRoughness },
                    position: DVec3::ZERO,
                    normal: DVec3::Z,
                    to_eye: DVec3::Z,
                    metallic: rest.x,
                    roughness: rest.y,
                    occlusion: rest.z,
                    mean_base: vector(0.8) + 0.5,
                },
            };
            let places: [[f64; 2]; 4] = std::array::from_fn(|_| [next(), next()]);
            // The lamps in another order, and one with what no shadow falls on.
            let own = [2, 0];
            let still = |of: fn((DVec3, DVec3)) -> DVec3| corners.map(|c| OverTime::through([of(c); 3]));
            let over_time = FacetOverTime { positions: still(|c| c.0), normals: still(|c| c.1) };
            let number = |lamp: usize| own.iter().position(|own| *own == lamp).map_or(0, |number| number + 1);
            let eye = facet.eye;
            let lights = LightsOverTime {
                eye: OverTime::through(
                    [match eye {
                        Eye::At(v) | Eye::Along(v) => v,
                    }; 3],
                ),
                is_parallel: matches!(eye, Eye::Along(_)),
                lamps: (lamps.iter().enumerate())
                    .map(|(k, lamp)| LampOverTime::new([lamp; 3], number(k)))
                    .collect(),
            };
            let lit_facet = LitFacet::new((&over_time, &facet.all, facet.side), &lights, 0.4, [0.5, 0.25]);
            let points = lit_facet.points(&places);
            let found = [0, 1, 2, 3].map(|own| lit_facet.response(&points, own, &around).rows());
            for (number, place) in places.into_iter().enumerate() {
                let mut wanted = [Response::default(); 3];
                respond(&facet.point(place), &lamps, &own, &around, &mut wanted);
                for (found, wanted) in found.iter().zip(&wanted) {
                    let wanted = wanted.linear.extend(wanted.constant).to_array();
                    let size = wanted.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
                    let off = |row: [f32; 4]| {
                        row.iter().zip(wanted).map(|(f, w)| (f64::from(*f) - w).abs()).fold(0.0, f64::max)
                    };
                    let near = |number: usize| off(found[number]) <= 1e-3 * size + 1e-5;
                    assert!(near(number), "{k}: {:?} and not {wanted:?}", found[number]);
                    canary += usize::from(!near((number + 1) % 4));
                    lit += usize::from(size > 0.01);
                }
            }
            assert!(
                found[3..].as_flattened().iter().all(|row| *row == [0.0; 4]),
                "no more lamps are kept apart"
            );
        }
        assert!(lit > 1000 && canary > 1000, "{lit} lit, {canary} unlike their neighbours");
    }
}
