//! Light as a device is given it.

use std::collections::HashMap;

use evis_scene::environment::FACES;
use evis_scene::motion::{WaveShape, Waveform};
use evis_scene::{Scene, ShadingModel};
use glam::{DMat3, DVec3};

use super::{Lighting, Mapped, Shared, TileLight, mapped, material};
use crate::hash::Words;
use crate::image::maps::Maps;
use crate::image::texture::Use;
use crate::packed::{self, Lamp, MOST_OWN, Wave, steady};
use crate::shading::places::{LampOverTime, LightsOverTime};
use crate::visibility::lists::{Record, powers, rows_about};

/// A row of tiles in work.
#[derive(Default)]
pub struct RowPacker {
    /// What there is of it.
    pub row: packed::Row,
    /// The picture's centre.
    centre: [f64; 2],
    /// Seconds of the scene at the start of the block, and during it.
    times_s: [f64; 2],
    /// By record, by facet that throws shadows, and by facet that is lit: its first row of points.
    records: HashMap<u32, u32, Words>,
    casters: HashMap<u32, u32, Words>,
    lit: HashMap<u32, u32, Words>,
    /// Whether the device has maps beside those of base colour.
    has_maps: bool,
}

impl RowPacker {
    /// Begins a row: the picture's centre, seconds of the scene at the start of the block and during it, and whether the device has
    /// other maps than those of base colour.
    pub fn begin(&mut self, centre: [f64; 2], times_s: [f64; 2], has_maps: bool) {
        (self.centre, self.times_s, self.has_maps) = (centre, times_s, has_maps);
        self.row.clear();
        self.records.clear();
        self.casters.clear();
        self.lit.clear();
    }

    /// Whether the device has other maps than those of base colour.
    pub fn has_maps(&self) -> bool {
        self.has_maps
    }

    /// The picture's centre.
    pub fn centre(&self) -> [f64; 2] {
        self.centre
    }

    /// Where the points of record `index` are.
    fn points_of(&mut self, record: &Record, index: u32) -> u32 {
        let points = &mut self.row.points;
        *self.records.entry(index).or_insert_with(|| append(points, rows_about(&record.points, self.centre)))
    }
}

/// Appends `rows`; the number of the first.
fn append(points: &mut Vec<[f32; 4]>, rows: [[f32; 4]; 9]) -> u32 {
    points.extend(rows);
    (points.len() - rows.len()) as u32
}

/// A waveform times `scale`, where the scene is at `start_s` and `length_s` long: between two edges what is no sine stays.
fn wave(waveform: Option<Waveform>, scale: f64, [start_s, length_s]: [f64; 2]) -> Wave {
    match waveform {
        None => steady(scale as f32),
        Some(w) if w.shape == WaveShape::Sine => {
            let cycle = (w.frequency_hz * start_s + w.phase).rem_euclid(1.0);
            [0.5 * (w.low + w.high) * scale, 0.5 * (w.high - w.low) * scale, cycle, w.frequency_hz * length_s]
                .map(|v| v as f32)
        }
        Some(w) => steady((w.factor(start_s + 0.5 * length_s) * scale) as f32),
    }
}

/// Low and high word.
pub fn halves(mask: u64) -> [u32; 2] {
    [mask as u32, (mask >> 32) as u32]
}

/// The mask of which these are the halves.
pub fn whole([low, high]: [u32; 2]) -> u64 {
    u64::from(low) | u64::from(high) << 32
}

/// Luminance of the sky of `scene`, where it is seen.
pub fn pack_sky(scene: &Scene) -> Option<packed::Sky> {
    let environment = scene.environment.as_ref().filter(|environment| environment.visible)?;
    let sky = &environment.sky;
    let (mut heads, mut values) = (Vec::new(), Vec::new());
    for level in 0..sky.levels.len() {
        let size = sky.level_size(level) as isize;
        heads.push(packed::as_floats([values.len() as u32, size as u32, 0, 0]));
        for face in 0..FACES {
            let texel = |x: isize, y: isize| -> Option<f64> {
                let color = sky.texel(level, face, x, y)?;
                let color = DVec3::from_array(std::array::from_fn(|k| color[k].to_f64()));
                Some(material::LUMINANCE.dot(color) * f64::from(environment.intensity))
            };
            for y in -1..=size {
                for x in -1..=size {
                    let [beside, across] = [x.clamp(0, size - 1), y.clamp(0, size - 1)];
                    let near = || [(beside, y), (x, across), (beside, across)].map(|(x, y)| texel(x, y));
                    let of_three = || near().into_iter().flatten().sum::<f64>() / 3.0;
                    values.push(texel(x, y).unwrap_or_else(of_three) as f32);
                }
            }
        }
    }
    values.resize(values.len().next_multiple_of(4), 0.0);
    let levels = heads.len() as u32;
    heads.extend_from_slice(bytemuck::cast_slice(&values));
    Some(packed::Sky { rows: heads.into(), levels })
}

impl Shared {
    /// Textures of `scene`, whose textures these are, as a device has them, and whether all maps are among them: where they are
    /// and take more than `most` bytes, those of base colour alone.
    pub fn pack(&self, scene: &Scene, most: usize) -> (packed::Textures, bool) {
        let mut plain = vec![Use::default(); scene.textures.len()];
        let mut all = plain.clone();
        let mut has_maps = false;
        for material in &scene.materials {
            let maps = mapped(material);
            for texture in maps.iter().flat_map(Maps::textures) {
                (all[texture].places, has_maps) = (true, true);
            }
            if let Some(texture) = material.base_color_texture {
                all[texture.texture].means = true;
                plain[texture.texture].means |= maps.is_none();
            }
        }
        has_maps &= self.textures.packed_bytes(&all) <= most;
        let mut packed = self.textures.pack(if has_maps { &all } else { &plain });
        packed.around = packed.rows.len() as u32;
        self.around.pack(&mut packed.rows);
        (packed, has_maps)
    }
}

impl Lighting<'_> {
    /// Whether `facet` has other maps than one of base colour.
    pub fn has_maps(&self, facet: u32) -> bool {
        self.answers[self.world.facets[facet as usize].surface as usize].maps.is_some()
    }

    /// Begins a row's points with the eye and lamps.
    pub fn pack_lights(&self, packer: &mut RowPacker) {
        let LightsOverTime { eye, is_parallel, lamps } = &self.lights_over_time;
        let mut rows = eye.rows(f32::from(u8::from(*is_parallel)));
        rows[1][3] = f32::from_bits(lamps.len() as u32);
        packer.row.points.extend(rows);
        packer.row.points.extend(lamps.iter().flat_map(LampOverTime::pack));
    }

    /// Where the geometry of a facet is, and what a device needs of its maps.
    fn pack_lit(&self, facet: u32, packer: &mut RowPacker) -> u32 {
        let points = &mut packer.row.points;
        *packer.lit.entry(facet).or_insert_with(|| {
            let first = points.len() as u32;
            points.extend(self.facet_over_time(facet).rows());
            let answer = &self.answers[self.world.facets[facet as usize].surface as usize];
            if let Some(mapped) = &answer.maps {
                points.extend(self.pack_maps(mapped, facet));
            }
            first
        })
    }

    /// What a device needs of the maps of a facet.
    fn pack_maps(
        &self,
        mapped: &Mapped,
        facet: u32,
    ) -> [[f32; 4]; packed::MAPPED_ROWS - packed::GEOMETRY_ROWS] {
        let own = self.mapped_facet(mapped, facet);
        let (maps, [normal_scale, occlusion]) = own.maps.pack();
        let answer = &self.answers[self.world.facets[facet as usize].surface as usize];
        let mut rows = [[0.0; 4]; packed::MAPPED_ROWS - packed::GEOMETRY_ROWS];
        for (corner, over_time) in own.tangents.iter().enumerate() {
            for (power, row) in over_time.rows(own.signs[corner] as f32).into_iter().enumerate() {
                rows[3 * power + corner] = row;
            }
        }
        let (_, others) = rows.split_at_mut(packed::TANGENT_ROWS);
        others[..2 * packed::MAPS].copy_from_slice(maps.as_flattened());
        let glow = mapped.emissive * material::LUMINANCE;
        let shines = f32::from(u8::from(answer.model == ShadingModel::MetallicRoughness));
        others[2 * packed::MAPS..].copy_from_slice(&[
            [mapped.metallic as f32, mapped.roughness as f32, normal_scale, occlusion],
            [glow.x as f32, glow.y as f32, glow.z as f32, shines],
        ]);
        rows
    }

    /// Of what [`Lighting::pack_looks`] returns: another one where that is something else.
    pub fn version(&self) -> u64 {
        self.version
    }

    /// Appearances of all facets.
    pub fn pack_looks(&self) -> Vec<[f32; 4]> {
        let mut rows = Vec::with_capacity(self.looks.len() * packed::LOOK_ROWS);
        for (look, facet) in self.looks.iter().zip(&self.world.facets) {
            let answer = &self.answers[facet.surface as usize];
            let shines = f32::from(u8::from(answer.model == ShadingModel::MetallicRoughness));
            let texture = look.texture.map_or(0, |number| number as u32 + 1);
            let row = |v: glam::DVec3, w: f32| [v.x as f32, v.y as f32, v.z as f32, w];
            let [along_s, along_t] = if look.shaded { look.base_along } else { Default::default() };
            let [origin_s, origin_t] = look.origin.map(|v| v as f32);
            let own: [_; packed::LOOK_ROWS] = [
                row(look.base, f32::from_bits(texture)),
                row(along_s, origin_s),
                row(along_t, origin_t),
                std::array::from_fn(|k| look.along.as_flattened()[k] as f32),
                [answer.metallic as f32, answer.roughness as f32, answer.occlusion as f32, shines],
            ];
            rows.extend(own);
        }
        rows
    }

    /// Lamps whose light is kept apart, during the block that is `times_s` of the scene, and how many there are.
    pub fn pack_lamps(&self, centre: [f64; 2], times_s: [f64; 2]) -> ([Lamp; MOST_OWN], u32) {
        let mut lamps = [Lamp::default(); MOST_OWN];
        for ((packed, on_screen), &own) in lamps.iter_mut().zip(&self.screen_lamps).zip(&self.own) {
            packed.points = on_screen.rows_about(centre);
            packed.wave = wave(self.lamps[0][own].waveform, 1.0, times_s);
        }
        (lamps, self.own.len() as u32)
    }

    /// Adds what lies behind everything to `job`, but for the sky's texels.
    pub fn pack_background(&self, centre: [f64; 2], job: &mut packed::Job) {
        job.background = self.background as f32;
        let (Some(sky), Some(environment)) = (&self.sky, &self.world.scene.environment) else { return };
        let turned = DMat3::from_rotation_y(-f64::from(environment.rotation));
        let about = DMat3::from_translation(glam::DVec2::from_array(centre));
        let powers = powers(sky.world_from_screen.map(|m| turned * m * about));
        for (row, column) in job.seen.iter_mut().zip(powers.iter().flat_map(|m| m.to_cols_array_2d())) {
            *row = [column[0] as f32, column[1] as f32, column[2] as f32, 0.0];
        }
        job.sky_texels = (material::sky_texels(environment) / sky.focal) as f32;
    }

    /// Appends entry `slot` of a tile, which is `record`, number `index` of the block, once its shadows are known; its number in
    /// the row.
    pub fn pack_entry(
        &self,
        tile: &TileLight,
        slot: usize,
        (record, index): (&Record, u32),
        packer: &mut RowPacker,
    ) -> u32 {
        let surface = self.world.facets[record.facet as usize].surface as usize;
        let answer = &self.answers[surface];
        let light = &tile.slots[slot];
        let mut entry = packed::Entry {
            points: packer.points_of(record, index),
            facet: record.facet,
            span: record.u.map(|u| u as f32),
            lit: light.lit.into(),
            ..packed::Entry::default()
        };
        for (holds, flag) in [
            (record.double_sided, packed::DOUBLE_SIDED),
            (record.mirrored, packed::MIRRORED),
            (record.crosses_near, packed::CROSSES_NEAR),
            (record.crosses_far, packed::CROSSES_FAR),
            (light.unlit, packed::UNLIT),
            (light.patch.is_none(), packed::SHARP),
            (answer.maps.is_some(), packed::HAS_MAPS),
            (answer.maps.is_some() && answer.waveform.is_some(), packed::GLOWS_APART),
        ] {
            entry.flags |= if holds { flag } else { 0 };
        }
        let is_factor = light.unlit || answer.maps.is_some();
        let emitted = if is_factor { 1.0 } else { answer.glow };
        entry.glow = wave(answer.waveform, emitted, packer.times_s);
        if !light.unlit {
            entry.light = self.pack_lit(record.facet, packer);
        }
        let row = &mut packer.row;
        entry.shades = row.words.len() as u32;
        let mut lists = entry.shades as usize + packed::SHADE_WORDS * self.own.len();
        row.words.resize(lists, 0);
        for (number, shade) in light.shades.iter().take(self.own.len()).enumerate() {
            let from = lists as u32;
            for (touches, facet) in &tile.occluders[shade.from..shade.to] {
                let points = &mut row.points;
                let at = *packer
                    .casters
                    .entry(*facet)
                    .or_insert_with(|| append(points, self.occluder(*facet).rows_about(packer.centre)));
                let [low, high] = halves(*touches);
                let words: [u32; packed::CASTER_WORDS] = [low, high, at];
                row.words.extend(words);
            }
            lists = row.words.len();
            let [dark, touched] = [shade.dark, shade.touched].map(halves);
            let words = [dark[0], dark[1], touched[0], touched[1], from, lists as u32];
            row.words[entry.shades as usize + packed::SHADE_WORDS * number..][..words.len()]
                .copy_from_slice(&words);
        }
        row.entries.push(entry);
        row.entries.len() as u32 - 1
    }

    /// Appends bounds of the light of entry `slot` of a tile, of `facet`, where it has any: their first word.
    pub fn pack_bounds(
        &self,
        tile: &mut TileLight,
        (slot, facet): (usize, u32),
        packer: &mut RowPacker,
    ) -> Option<u32> {
        let bounds = self.bounds(tile, facet, slot)?;
        let words = &mut packer.row.words;
        let first = words.len() as u32;
        // Rounded outwards.
        let of =
            |[least, most]: [f64; 2]| [(least as f32).next_down(), (most as f32).next_up()].map(f32::to_bits);
        words.extend(of(bounds.steady));
        words.extend(bounds.own[..self.own.len()].iter().flat_map(|own| of(*own)));
        Some(first)
    }
}
