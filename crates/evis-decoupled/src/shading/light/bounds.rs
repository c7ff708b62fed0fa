//! Bounds of the light that entries of a tile send during a block.

use glam::DVec3;

use super::{Lighting, MOST_OWN, TileLight};
use crate::shading::bounds::{Bounds, luminances, product};
use crate::shading::material;
use crate::shading::patch::range;

impl TileLight {
    /// Luminances between which entry `slot` with these bounds sends light into a pixel, as far as is known which shadows it has
    /// there.
    pub fn range(&self, bounds: &Bounds<MOST_OWN>, slot: usize, pixel: usize) -> [f64; 2] {
        let slot = &self.slots[slot];
        let mut sum = bounds.steady;
        for (own, shade) in bounds.own.iter().zip(&slot.shades) {
            if shade.dark >> pixel & 1 == 1 {
                continue;
            }
            let whole = slot.shaded && shade.touched >> pixel & 1 == 0;
            sum[0] += if whole { own[0] } else { own[0].min(0.0) };
            sum[1] += if whole { own[1] } else { own[1].max(0.0) };
        }
        sum
    }
}

impl Lighting<'_> {
    /// Luminance of what lies behind everything, where that is the same everywhere and always.
    pub fn steady_background(&self) -> Option<f64> {
        self.sky.is_none().then_some(self.background)
    }

    /// Bounds of the light of `facet`, entry `slot` of its tile; `None` where no patch tells it, or its strength changes.
    pub fn bounds(&self, tile: &mut TileLight, facet: u32, slot: usize) -> Option<Bounds<MOST_OWN>> {
        tile.bounds.resize(tile.slots.len(), None);
        if tile.bounds[slot].is_none() {
            tile.bounds[slot] = Some(self.find_bounds(tile, facet, slot));
        }
        tile.bounds[slot].flatten()
    }

    fn find_bounds(&self, tile: &TileLight, facet: u32, slot: usize) -> Option<Bounds<MOST_OWN>> {
        let answer = &self.answers[self.world.facets[facet as usize].surface as usize];
        let slot = &tile.slots[slot];
        let lamps = self.own.iter().enumerate().filter(|(number, _)| slot.lit >> number & 1 == 1);
        let changes = |lamp: usize| self.lamps[0][lamp].waveform.is_some();
        if answer.maps.is_some() || answer.waveform.is_some() || lamps.clone().any(|(_, lamp)| changes(*lamp))
        {
            return None;
        }
        let base = self.base_range(facet);
        let mut own = [[0.0; 2]; MOST_OWN];
        if slot.unlit {
            return Some(Bounds { steady: base.map(|base| material::LUMINANCE.dot(base)), own });
        }
        let patch = slot.patch?;
        let of = |own: usize| {
            luminances(range(&tile.nodes[patch.first + patch.times * own..][..patch.times]), base)
        };
        let steady = of(0).map(|light| light + answer.glow);
        lamps.for_each(|(number, _)| own[number] = of(1 + number));
        Some(Bounds { steady, own })
    }

    /// Least and greatest base colour of a facet.
    fn base_range(&self, facet: u32) -> [DVec3; 2] {
        let look = &self.looks[facet as usize];
        let [s, t] = look.base_along;
        let corners = [look.base, look.base + s, look.base + t, look.base + s + t];
        let [low, high] = [DVec3::min, DVec3::max].map(|of| corners.into_iter().fold(look.base, of));
        let texels = look.texture.map_or([DVec3::ONE; 2], |texture| self.shared.textures.range(texture));
        let [r, g, b] = [0, 1, 2].map(|k| product([low[k], high[k]], texels.map(|t| t[k])));
        [0, 1].map(|end| DVec3::new(r[end], g[end], b[end]))
    }
}
