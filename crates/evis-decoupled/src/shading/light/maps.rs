//! Light of surfaces with maps: shaded into pages, and read from them.

use glam::{DMat2, DVec2, DVec3};

use super::{Instant, Lighting, MOST_OWN, Mapped, PLACES, Part, TileLight};
use crate::image::maps::MapReader;
use crate::shading::keyframe::{self, Footprint, Keyframe, MOST_PLANES};
use crate::shading::material::{self, Response, respond};
use crate::shading::moments::{FacetAt, interval_of};
use crate::shading::pages::{BEYOND_PX, Picture};
use crate::visibility::lists::Record;

impl Lighting<'_> {
    /// Light of a facet with maps at (s, t): of all channels, at one moment or two.
    pub(super) fn shade_maps(
        &self,
        facet: u32,
        (mapped, maps): (&Mapped, &MapReader),
        place: [f64; 2],
        moments: &[FacetAt],
        out: &mut [[f32; 4]; MOST_PLANES],
    ) {
        let surface = self.world.facets[facet as usize].surface as usize;
        let look = &self.looks[facet as usize];
        let texels = maps.at(DVec2::from_array(place));
        let base = (look.base + look.base_along[0] * place[0] + look.base_along[1] * place[1]) * texels.base;
        let glow = material::LUMINANCE.dot(mapped.emissive * texels.emission);
        let (lamps, channels) = (self.own.len(), self.channels(surface));
        let planes = channels.div_ceil(4);
        for (end, moment) in moments.iter().enumerate() {
            self.shaded.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            let mut point = moment.point(place);
            point.metallic = (mapped.metallic * texels.metallic).clamp(0.0, 1.0);
            point.roughness = (mapped.roughness * texels.roughness).clamp(0.0, 1.0);
            (point.occlusion, point.mean_base) = (texels.occlusion, base);
            if let (Some(local), [tangent, bitangent]) =
                (texels.normal, tangent_frame(moment, place, point.normal))
                && tangent != DVec3::ZERO
            {
                let side = moment.side;
                let mapped = tangent * local.x + bitangent * local.y + point.normal * (side * local.z);
                point.normal = mapped.normalize_or(point.normal * side) * side;
            }
            let mut responses = [Response::default(); 1 + MOST_OWN];
            respond(&point, moment.lamps, &self.own, &self.shared.around, &mut responses);
            let mut set =
                |channel: usize, value: f64| out[end * planes + channel / 4][channel % 4] = value as f32;
            let mut diffuse = 0.0;
            for (channel, response) in responses[..=lamps].iter().enumerate() {
                let proportional = response.linear.dot(base);
                diffuse += proportional;
                set(channel, proportional + response.constant);
            }
            set(channels - 2, material::LUMINANCE.dot(base));
            set(channels - 1, diffuse);
            if channels > lamps + 3 {
                set(lamps + 1, glow);
            } else {
                out[end * planes][0] += glow as f32;
            }
        }
    }

    /// Values that light of a surface with maps has: of what no shadow falls on, of each of [`Lighting::own`], of its own glow
    /// where that changes, the luminance of its base colour, and what of all light is proportional to that.
    pub(super) fn channels(&self, surface: usize) -> usize {
        3 + self.own.len() + usize::from(self.answers[surface].waveform.is_some())
    }

    /// Where light of entry `slot`, which is `record`, number `index` of the block, is rendered, if it has maps: the number of
    /// the first of as many pictures as its light has `intervals`.
    pub(super) fn pictures(
        &self,
        tile: &mut TileLight,
        record: &Record,
        index: u32,
        intervals: u32,
    ) -> Option<u32> {
        let surface = self.world.facets[record.facet as usize].surface as usize;
        self.answers[surface].maps.as_ref()?;
        let picture = Picture::new(record, index, self.world.seen(), &self.depths)?;
        let first = tile.pictures.len() as u32;
        tile.pictures.extend((0..intervals.max(1)).map(|interval| picture.during(interval, intervals)));
        Some(first)
    }

    /// Where the part's footprint lies on its picture at a moment, and that picture; `None` where it has none.
    #[inline(always)]
    pub(super) fn footprint(
        &self,
        tile: &mut TileLight,
        part: &Part,
        at: &Instant,
    ) -> Option<(Footprint, Picture)> {
        let slot = &tile.slots[part.slot];
        let first = slot.picture.filter(|_| !tile.once)?;
        let picture = tile.pictures[(first + interval_of(at.u, slot.intervals).0) as usize];
        let index = at.moment * tile.slots.len() + part.slot;
        if tile.warps.len() <= index {
            tile.warps.resize((at.moment + 1) * tile.slots.len(), None);
        }
        let warp =
            tile.warps[index].get_or_insert_with(|| picture.image_from_facet * part.sight.facet_from_image());
        let (centre, moments) = part.moments.central();
        let place = DVec2::from_array(part.frame.point(centre));
        Some((Footprint::under(warp, place, part.frame.moments(moments))?, picture))
    }

    /// A facet at the moments between which its light is in an interval: one where it does not change.
    fn moments(&self, facet: u32, front: bool, interval: u32, intervals: u32) -> Vec<FacetAt<'_>> {
        let of = |time: u32| self.facet_at(facet, front, self.moment_of(time, intervals).1);
        if intervals == 0 { vec![of(0)] } else { vec![of(interval), of(interval + 1)] }
    }

    /// Renders a page of the light of a facet with maps.
    pub(super) fn light_page(
        &self,
        facet: u32,
        mapped: &Mapped,
        picture: &Picture,
        rect: [f64; 4],
        sums: &mut Vec<[f32; 4]>,
    ) -> Option<Keyframe> {
        let f = &self.world.facets[facet as usize];
        let maps = mapped.maps.on(&self.shared.textures, self.world.primitive(f.surface), f.corners);
        let moments = self.moments(facet, picture.front, picture.interval, picture.intervals);
        let planes = self.channels(f.surface as usize).div_ceil(4) * moments.len();
        // Footprints reach a little beyond the facet.
        let outline = f.outline(self.world.primitive(f.surface));
        let lines = keyframe::outline(&picture.image_from_facet, &outline, BEYOND_PX);
        let mut reader = None;
        let shade = |place: [f64; 2], area: f64, out: &mut [[f32; 4]; MOST_PLANES]| {
            let reader = reader.get_or_insert_with(|| maps.reader(&self.shared.textures, area));
            self.shade_maps(facet, (mapped, reader), place, &moments, out);
        };
        Keyframe::of_light(picture.image_from_facet, (maps.finest(), &lines), rect, planes, sums, shade)
    }

    /// Luminance per area of entry `part.slot` with maps over `part.moments`; `base` is the mean of its base colour there, where a
    /// texture says so.
    ///
    /// Cells are too few for the detail of a texture. So what they have of its luminance is replaced by its exact mean, in the
    /// part of the light that is proportional to it (a control variate).
    pub(super) fn of_maps(
        &self,
        tile: &mut TileLight,
        mapped: &Mapped,
        part: &Part,
        at: &Instant,
        base: Option<DVec3>,
    ) -> f64 {
        let facet = part.sight.facet;
        let surface = self.world.facets[facet as usize].surface as usize;
        let intervals = tile.slots[part.slot].intervals;
        let (ends, channels) = (if intervals == 0 { 1 } else { 2 }, self.channels(surface));
        let (interval, within) = interval_of(at.u, intervals);
        let groups = channels.div_ceil(4);
        let pictured = self.footprint(tile, part, at).and_then(|(footprint, picture)| {
            let render = |rect: [f64; 4], sums: &mut Vec<[f32; 4]>| {
                self.light_page(facet, mapped, &picture, rect, sums)
            };
            let (page, sums) = tile.pages.about(&picture, footprint.at, render)?;
            let mut planes = [[0.0; 4]; MOST_PLANES];
            match ends * groups {
                1 => planes[..1].copy_from_slice(&page.means::<1>(sums, &footprint)?),
                2 => planes[..2].copy_from_slice(&page.means::<2>(sums, &footprint)?),
                3 => planes[..3].copy_from_slice(&page.means::<3>(sums, &footprint)?),
                4 => planes[..4].copy_from_slice(&page.means::<4>(sums, &footprint)?),
                _ => planes = page.means::<MOST_PLANES>(sums, &footprint)?,
            }
            Some(planes)
        });
        let planes = pictured.unwrap_or_else(|| self.maps_in_places(mapped, part, [interval, intervals]));
        let value = |channel: usize| {
            let of = |end: usize| f64::from(planes[end * groups + channel / 4][channel % 4]);
            if ends == 1 { of(0) } else { of(0) + (of(1) - of(0)) * within }
        };
        let mut sum = value(0);
        let mut whole = sum;
        for number in 0..self.own.len() {
            let light = value(1 + number);
            whole += light;
            if light > 0.0 {
                sum += self.arriving(tile, part, at, number).0 * light;
            }
        }
        let [luma, diffuse] = [channels - 2, channels - 1].map(value);
        if let Some(base) = base
            && luma > 0.0
            && whole > 0.0
        {
            let off = (material::LUMINANCE.dot(base) / luma - 1.0).clamp(-0.5, 1.0);
            sum *= 1.0 + off * (diffuse / whole).clamp(0.0, 1.0);
        }
        if let Some(waveform) = self.answers[surface].waveform {
            sum += waveform.factor(at.t_s) * value(1 + self.own.len());
        }
        sum
    }

    /// The same where there is no picture: the mean over a grid of places.
    pub(super) fn maps_in_places(
        &self,
        mapped: &Mapped,
        part: &Part,
        [interval, intervals]: [u32; 2],
    ) -> [[f32; 4]; MOST_PLANES] {
        let facet = part.sight.facet;
        let moments = self.moments(facet, part.sight.front, interval, intervals);
        let f = &self.world.facets[facet as usize];
        let maps = mapped.maps.on(&self.shared.textures, self.world.primitive(f.surface), f.corners);
        let (centre, axes) = part.moments.footprint();
        let (place, change) = part.sight.parameters(part.frame.point(centre));
        let axes = axes.map(|axis| part.frame.vector(axis));
        let along = DMat2::from_cols_array_2d(&change) * DMat2::from_cols_array_2d(&axes);
        let count = f64::from(PLACES * PLACES);
        let maps = maps.reader(&self.shared.textures, along.determinant().abs() / count);
        let mut sum = [[0.0; 4]; MOST_PLANES];
        for k in 0..PLACES * PLACES {
            let step = |k: u32| (f64::from(k) + 0.5) / f64::from(PLACES) - 0.5;
            let at = DVec2::from_array(place) + along * DVec2::new(step(k % PLACES), step(k / PLACES));
            let mut planes = [[0.0; 4]; MOST_PLANES];
            self.shade_maps(facet, (mapped, &maps), at.to_array(), &moments, &mut planes);
            for (sum, value) in sum.as_flattened_mut().iter_mut().zip(planes.as_flattened()) {
                *sum += value / count as f32;
            }
        }
        sum
    }
}

/// Unit tangent and bitangent at a place of a facet with the unit normal `normal` to the viewer's side; zeros where it has
/// none.
fn tangent_frame(facet: &FacetAt, [s, t]: [f64; 2], normal: DVec3) -> [DVec3; 2] {
    let [a, b, d] = facet.tangents;
    let normal = normal * facet.side;
    let tangent = a.0 + (b.0 - a.0) * s + (d.0 - a.0) * t;
    let tangent = (tangent - normal * normal.dot(tangent)).normalize_or_zero();
    [tangent, normal.cross(tangent) * (a.1 + (b.1 - a.1) * s + (d.1 - a.1) * t)]
}
