//! Light of surfaces with maps: shaded at places of what a pixel sees, at the time of an evaluation.

use glam::{DMat2, DVec2, DVec3, Vec4};

use super::{Instant, Lighting, MOST_OWN, Mapped, PLACES, Part, TileLight};
use crate::fours::Four;
use crate::shading::material;
use crate::shading::places::{FacetOverTime, MappedFacet, OverTime, Points, Sent};

/// Where they are, as parts of the side from its middle.
const STEPS: [f32; PLACES as usize] = [-0.375, -0.125, 0.125, 0.375];

/// Means over what a pixel sees of a facet.
struct Means {
    /// Light of what no shadow falls on, and of each lamp that is kept apart.
    light: [f64; 1 + MOST_OWN],
    /// Luminance of base colour.
    base: f64,
    /// What of all light is proportional to that.
    proportional: f64,
    /// What it sends itself.
    glow: f64,
}

/// A vector that is linear on a facet: in the middle of a footprint, and its change along the footprint's sides.
struct Linear([Four; 3]);

impl Linear {
    /// Less `origin`, of values at (s, t) = (0, 0), (1, 0) and (0, 1).
    #[inline(always)]
    fn about([a, b, d]: [DVec3; 3], origin: DVec3, place: [f64; 2], sides: &DMat2) -> Self {
        let (along_s, along_t) = (b - a, d - a);
        let change = |side: DVec2| Four::splat(along_s * side.x + along_t * side.y);
        let middle = (a - origin) + along_s * place[0] + along_t * place[1];
        Self([Four::splat(middle), change(sides.x_axis), change(sides.y_axis)])
    }

    #[inline(always)]
    fn at(&self, s: Vec4, t: Vec4) -> Four {
        let [middle, p, q] = self.0;
        middle + p * s + q * t
    }
}

impl Lighting<'_> {
    /// What maps add to a facet during the block in work.
    pub(super) fn mapped_facet(&self, mapped: &Mapped, facet: u32) -> &MappedFacet {
        self.mapped[facet as usize].get_or_init(|| {
            let f = &self.world.facets[facet as usize];
            let surface = f.surface as usize;
            let [a, b, _, d] = f.corners.map(|c| c as usize);
            let moves = self.world.surfaces[surface].moves;
            let at = |time: usize, corner: usize| {
                let tangents = &self.tangents[surface][if moves { time } else { 0 }];
                tangents.get(corner).copied().unwrap_or_default()
            };
            let over_time = |corner: usize| OverTime::through([0, 1, 2].map(|time| at(time, corner).0));
            Box::new(MappedFacet {
                tangents: [a, b, d].map(over_time),
                signs: [a, b, d].map(|corner| at(0, corner).1),
                maps: mapped.maps.on(&self.shared.textures, self.world.primitive(f.surface), f.corners),
            })
        })
    }

    /// Luminance per area of entry `part.slot` with maps over `part.moments`; `base` is the mean of its base colour there, where a
    /// texture says so.
    ///
    /// Places are too few for the detail of a texture. So what they have of its luminance is replaced by its exact mean, in the
    /// part of the light that is proportional to it (a control variate).
    pub(super) fn of_maps(
        &self,
        tile: &mut TileLight,
        mapped: &Mapped,
        part: &Part,
        at: &Instant,
        base: Option<DVec3>,
    ) -> f64 {
        let means = self.shade_places(mapped, part, at.u);
        let (mut sum, mut whole) = (means.light[0], means.light[0]);
        for (number, light) in means.light[1..=self.own.len()].iter().enumerate() {
            whole += light;
            if *light > 0.0 {
                sum += self.arriving(tile, part, at, number).0 * light;
            }
        }
        let surface = self.world.facets[part.sight.facet as usize].surface as usize;
        let waveform = self.answers[surface].waveform;
        if waveform.is_none() {
            sum += means.glow;
            whole += means.glow;
        }
        if let Some(base) = base
            && means.base > 0.0
            && whole > 0.0
        {
            let off = (material::LUMINANCE.dot(base) / means.base - 1.0).clamp(-0.5, 1.0);
            sum *= 1.0 + off * (means.proportional / whole).clamp(0.0, 1.0);
        }
        sum + waveform.map_or(0.0, |waveform| waveform.factor(at.t_s) * means.glow)
    }

    /// What entry `part.slot` with maps sends, over a grid of places.
    fn shade_places(&self, mapped: &Mapped, part: &Part, u: f64) -> Means {
        let facet = part.sight.facet;
        let own = self.mapped_facet(mapped, facet);
        let (centre, axes) = part.moments.footprint();
        let (place, change) = part.sight.parameters(part.frame.point(centre));
        let axes = axes.map(|axis| part.frame.vector(axis));
        let sides = DMat2::from_cols_array_2d(&change) * DMat2::from_cols_array_2d(&axes);
        let count = STEPS.len() * STEPS.len();
        let maps = own.maps.about(&self.shared.textures, DVec2::from_array(place), sides, 1.0 / count as f64);

        let at_u = |of: &[OverTime; 3]| of.each_ref().map(|v| v.at(u));
        let FacetOverTime { positions, normals } = self.facet_over_time(facet);
        let corners = at_u(positions);
        let middle = corners[0] + (corners[1] - corners[0]) * place[0] + (corners[2] - corners[0]) * place[1];
        let linear = |of: [DVec3; 3], origin: DVec3| Linear::about(of, origin, place, &sides);
        let positions = linear(corners, middle);
        let normals = linear(at_u(normals), DVec3::ZERO);
        let tangents = linear(at_u(&own.tangents), DVec3::ZERO);
        let signs = linear(own.signs.map(DVec3::splat), DVec3::ZERO);
        let look = &self.looks[facet as usize];
        let corner_bases = [look.base, look.base + look.base_along[0], look.base + look.base_along[1]];
        let bases = linear(corner_bases, DVec3::ZERO);

        let lights = &self.lights_over_time;
        let eye = lights.eye.at(u);
        let to_eye = Four::splat(if lights.is_parallel { -eye } else { eye - middle });
        let model = self.answers[self.world.facets[facet as usize].surface as usize].model;
        let side = if part.sight.front { 1.0 } else { -1.0 };
        let glow = Four::splat(mapped.emissive);
        let (metallic, roughness) = (mapped.metallic as f32, mapped.roughness as f32);

        let up = Four::splat(DVec3::Z);
        let mut rows = [Points::default(); STEPS.len()];
        let (mut base, mut glowing) = (Vec4::ZERO, Vec4::ZERO);
        for (points, t) in rows.iter_mut().zip(STEPS) {
            let (s, t) = (Vec4::from_array(STEPS), Vec4::splat(t));
            let texels = maps.at(s, t);
            let from_middle = positions.at(s, t);
            let way = if lights.is_parallel { to_eye } else { to_eye - from_middle };
            // Towards its front, until a map has turned it.
            let mut normal = normals.at(s, t).normalize_or(up);
            if let Some(local) = texels.normal {
                let flat = tangents.at(s, t);
                let tangent = (flat - normal * normal.dot(flat)).normalize_or(Four::default());
                let bitangent = normal.cross(tangent) * (signs.at(s, t).x * local.y);
                let turned = tangent * local.x + bitangent + normal * local.z;
                let has_tangent = tangent.dot(tangent).cmpgt(Vec4::ZERO);
                normal = Four::select(has_tangent, turned.normalize_or(normal), normal);
            }
            *points = Points {
                from_middle,
                normal: normal * side,
                to_eye: way.normalize_or(up),
                base: bases.at(s, t) * texels.base,
                metallic: (texels.metallic * metallic).clamp(Vec4::ZERO, Vec4::ONE),
                roughness: (texels.roughness * roughness).clamp(Vec4::ZERO, Vec4::ONE),
                occlusion: texels.occlusion,
            };
            base += points.base.luminance();
            glowing += texels.emission.map_or(glow, |emission| glow * emission).luminance();
        }
        let mut light = [Vec4::ZERO; 1 + MOST_OWN];
        let mut proportional = Vec4::ZERO;
        let mut add = |own: usize, sent: Sent| {
            light[own] += sent.proportional + sent.constant;
            proportional += sent.proportional;
        };
        for points in &rows {
            add(0, points.of_around(&self.shared.around, model).sent(points.base));
        }
        for lamp in &lights.lamps {
            let lamp = lamp.at(u, middle);
            for points in &rows {
                add(lamp.own, points.of_lamp(&lamp, model).sent(points.base));
            }
        }
        let mean = |sum: Vec4| {
            let [a, b, c, d] = sum.to_array();
            f64::from((a + b) + (c + d)) / count as f64
        };
        Means {
            light: light.map(mean),
            base: mean(base),
            proportional: mean(proportional),
            glow: mean(glowing),
        }
    }
}
