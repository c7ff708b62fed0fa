//! Truths that were made before: a file per scene and settings.

use std::hash::{DefaultHasher, Hasher};
use std::path::Path;

use evis_core::Truth;
use evis_scene::Scene;

use crate::oracle::truth;
use crate::settings::{TruthError, TruthSettings};

/// Counts up with every change of the oracle that changes what it says: older files are then not found.
const ORACLE_VERSION: u32 = 6;

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
    let mut hashers = [0, 1].map(|salt| {
        let mut hasher = DefaultHasher::new();
        hasher.write_u32(ORACLE_VERSION);
        hasher.write_u8(salt);
        hasher
    });
    evis_scene::digest(scene, &format!("{settings:?}"), &mut hashers);
    hashers.iter().map(|h| format!("{:016x}", h.finish())).collect()
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
        let sampled = |hz| key(&scene, &TruthSettings { sampled_hz: Some(hz), ..settings.clone() });
        assert!(sampled(1000.0) != same && sampled(1000.0) != sampled(2000.0));
        assert_ne!(same, key(&brighter, &settings));
    }
}
