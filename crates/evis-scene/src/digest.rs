//! What a scene holds, as a number.

use std::fmt::{self, Write as _};
use std::hash::Hasher;

use crate::model::Scene;

/// Tells `hashers` all that `scene` holds, so that whatever is added to it counts by itself: texels as bits (most of a scene,
/// and slow to write in words), then `heading` on a line of its own, then the rest as `Debug` writes it.
pub fn digest<H: Hasher>(scene: &Scene, heading: &str, hashers: &mut [H]) {
    let mut rest = scene.clone();
    let maps = rest.environment.iter_mut().flat_map(|e| [&mut e.sky, &mut e.irradiance, &mut e.specular]);
    let levels = maps.flat_map(|map| map.levels.iter_mut());
    for texels in rest.images.iter_mut().map(|image| &mut image.texels).chain(levels) {
        let texels = std::mem::take(texels);
        for hasher in hashers.iter_mut() {
            hasher.write_usize(texels.len());
            texels.iter().flatten().for_each(|v| hasher.write_u16(v.to_bits()));
        }
    }
    // Hashers take everything.
    let _ = write!(Words(hashers), "{heading}\n{rest:?}");
}

/// Text into hashers.
struct Words<'a, H>(&'a mut [H]);

impl<H: Hasher> fmt::Write for Words<'_, H> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.0.iter_mut().for_each(|h| h.write(text.as_bytes()));
        Ok(())
    }
}
