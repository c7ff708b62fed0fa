//! Truths that were made before: a file per scene and settings.

use std::fmt::{self, Write as _};
use std::hash::{DefaultHasher, Hasher};
use std::path::Path;

use evis_core::Truth;
use evis_scene::Scene;

use crate::oracle::truth;
use crate::settings::{TruthError, TruthSettings};

/// Counts up with every change of the oracle that changes what it says: older files are then not found.
const ORACLE_VERSION: u32 = 5;

/// As [`truth`], kept in `folder` under a hash of scene and settings: asked for again, it is read. A folder that cannot be
/// read or written only costs the work.
///
/// # Errors
/// As [`truth`].
pub fn cached(
    folder: &Path,
    scene: &Scene,
    settings: &TruthSettings,
    progress: &(dyn Fn(f64) -> bool + Sync),
) -> Result<Truth, TruthError> {
    settings.check()?;
    let path = folder.join(format!("{}.h5", key(scene, settings)));
    if let Ok(known) = Truth::read(&path) {
        progress(1.0);
        return Ok(known);
    }
    let truth = truth(scene, settings, progress)?;
    // Under another name first: nobody ever reads half of one.
    let half = folder.join(format!("{}-{}.part.h5", key(scene, settings), std::process::id()));
    let kept = std::fs::create_dir_all(folder).is_ok()
        && truth.write(&half, true).is_ok()
        && std::fs::rename(&half, &path).is_ok();
    if !kept {
        // What is left of it is of no use; that it cannot be removed either changes nothing.
        let _ = std::fs::remove_file(&half);
    }
    Ok(truth)
}

/// Names a scene and settings by all of their content: whatever is added to either counts by itself.
fn key(scene: &Scene, settings: &TruthSettings) -> String {
    let mut digest = Digest([0, 1].map(|salt| {
        let mut hasher = DefaultHasher::new();
        hasher.write_u32(ORACLE_VERSION);
        hasher.write_u8(salt);
        hasher
    }));
    // Texels as bits: most of a scene, and slow to write in words.
    let mut rest = scene.clone();
    let maps = rest.environment.iter_mut().flat_map(|e| [&mut e.sky, &mut e.irradiance, &mut e.specular]);
    let levels = maps.flat_map(|map| map.levels.iter_mut());
    for texels in rest.images.iter_mut().map(|image| &mut image.texels).chain(levels) {
        digest.texels(&std::mem::take(texels));
    }
    // A digest takes everything.
    let _ = write!(digest, "{settings:?}\n{rest:?}");
    digest.0.iter().map(|h| format!("{:016x}", h.finish())).collect()
}

/// Two hashes of whatever is written into it.
struct Digest([DefaultHasher; 2]);

impl Digest {
    fn texels(&mut self, texels: &[[half::f16; 4]]) {
        for hasher in &mut self.0 {
            hasher.write_usize(texels.len());
            texels.iter().flatten().for_each(|v| hasher.write_u16(v.to_bits()));
        }
    }
}

impl fmt::Write for Digest {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.0.iter_mut().for_each(|h| h.write(text.as_bytes()));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_key_follows_every_change() {
        let scene = Scene::default();
        let settings = TruthSettings::default();
        let same = key(&scene, &settings);
        assert_eq!(same, key(&scene.clone(), &settings.clone()));
        let longer = TruthSettings { duration_us: settings.duration_us + 1, ..settings.clone() };
        let image = |grey: f32| evis_scene::Image {
            name: String::new(),
            width: 1,
            height: 1,
            texels: vec![[grey; 4].map(half::f16::from_f32)],
        };
        let painted = |grey| Scene { images: vec![image(grey)], ..scene.clone() };
        let colours = [same.clone(), key(&painted(0.5), &settings), key(&painted(0.25), &settings)];
        assert!(colours[0] != colours[1] && colours[1] != colours[2]);
        let brighter = Scene { ambient: [0.0, 0.0, 1e-7], ..scene.clone() };
        assert_ne!(same, key(&scene, &longer));
        assert_ne!(same, key(&brighter, &settings));
    }
}
