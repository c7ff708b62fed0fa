//! Scenes that ask for more than they may take are refused before they take it.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::io::Cursor;
use std::path::{Path, PathBuf};

use evis_limits::Budget;
use evis_scene::gltf::{Options, load, read};
use evis_scene::image::{Transfer, decode_within};

struct Folder(PathBuf);

impl Folder {
    fn new(test: &str) -> Self {
        let path = std::env::temp_dir().join(format!("evis-scene-{test}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// A mesh of so many primitives, each on the same accessor, which has no view and so is all zero.
fn zeros(primitives: usize, count: usize) -> String {
    let primitive = r#"{"attributes": {"POSITION": 0, "NORMAL": 0}}"#;
    format!(
        r#"{{"asset": {{"version": "2.0"}}, "scenes": [{{"nodes": [0]}}], "scene": 0, "nodes": [{{"mesh": 0}}],
        "accessors": [{{"componentType": 5126, "type": "VEC3", "count": {count}, "min": [0,0,0], "max": [0,0,0]}}],
        "meshes": [{{"primitives": [{}]}}]}}"#,
        vec![primitive; primitives].join(",")
    )
}

#[test]
fn accessors_without_a_view_are_counted_each_time_that_they_are_used() {
    evis_limits::set_memory_limit(200 << 20);
    let options = Options { standalone: false, ..Options::default() };
    let few = read(zeros(3, 300).as_bytes(), Path::new(""), &options).unwrap();
    assert_eq!(few.meshes[0].primitives.len(), 3);
    let error = read(zeros(200, 1 << 22).as_bytes(), Path::new(""), &options).unwrap_err().to_string();
    assert!(error.contains("of memory") && error.contains("`memory_limit`"), "{error}");
}

#[test]
fn large_pictures_in_small_files_are_refused() {
    let mut bytes = Cursor::new(Vec::new());
    image::GrayImage::new(2048, 2048).write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    let bytes = bytes.into_inner();
    assert!(bytes.len() < 100_000, "the picture packs well: {} bytes", bytes.len());
    let decode = |limit: u64| decode_within("grey", &bytes, Transfer::Srgb, &Budget::of(limit));
    assert_eq!(decode(100 << 20).unwrap().texels.len(), 2048 * 2048);
    let error = decode(40 << 20).unwrap_err();
    assert!(error.contains("'grey' of 2048x2048") && error.contains("`memory_limit`"), "{error}");
}

#[test]
fn uris_that_leave_the_folder_of_the_scene_are_refused_until_they_are_allowed() {
    let folder = Folder::new("outside");
    std::fs::create_dir_all(folder.0.join("scene/sub")).unwrap();
    std::fs::write(folder.0.join("secret.bin"), [0; 12]).unwrap();
    std::fs::write(folder.0.join("scene/own.bin"), [0; 12]).unwrap();
    let scene = folder.0.join("scene/scene.gltf");
    let options = Options { standalone: false, ..Options::default() };
    let load = |uri: &str| {
        let text = format!(
            r#"{{"asset": {{"version": "2.0"}}, "buffers": [{{"byteLength": 12, "uri": "{uri}"}}]}}"#
        );
        std::fs::write(&scene, text).unwrap();
        load(&scene, &options).map_err(|error| error.to_string())
    };
    for uri in ["own.bin", "./own.bin", "sub/../own.bin"] {
        load(uri).unwrap();
    }
    let absolute = folder.0.join("secret.bin").display().to_string();
    let outside = ["../secret.bin", "%2e%2e/secret.bin", "sub/../../secret.bin", absolute.as_str()];
    for uri in outside {
        let error = load(uri).unwrap_err();
        assert!(error.contains("leaves the scene's folder") && error.contains("`allow_outside`"), "{error}");
    }
    evis_limits::set_allow_outside(true);
    for uri in outside {
        load(uri).unwrap();
    }
    evis_limits::set_allow_outside(false);
}

#[test]
fn turns_that_say_nothing_are_refused() {
    let scene = |rate: &str| {
        let text =
            format!("[[nodes]]\nname = \"a\"\nmotion = {{ kind = \"spin\", degrees_per_s = {rate} }}\n");
        evis_scene::toml_scene::parse(&text, ".").map_err(|error| error.to_string())
    };
    // Whatever else a scene lacks, the rate is not what is wrong with this one.
    assert!(!scene("1000000").err().unwrap_or_default().contains("degrees per second"));
    for rate in ["1e30", "-2e6"] {
        let error = scene(rate).unwrap_err();
        assert!(error.contains("up to 1000000 work"), "{error}");
    }
}

#[cfg(unix)]
#[test]
fn devices_and_pipes_are_not_read() {
    let folder = Folder::new("devices");
    let pipe = folder.0.join("pipe.bin");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    std::os::unix::fs::symlink("/dev/zero", folder.0.join("zero.bin")).unwrap();
    for name in ["pipe.bin", "zero.bin"] {
        let text = format!(
            r#"{{"asset": {{"version": "2.0"}}, "buffers": [{{"byteLength": 12, "uri": "{name}"}}]}}"#
        );
        let scene = folder.0.join("scene.gltf");
        std::fs::write(&scene, text).unwrap();
        let error = load(&scene, &Options::default()).unwrap_err().to_string();
        assert!(error.contains(name) && error.contains("only regular files"), "{error}");
    }
    let error = evis_scene::toml_scene::load(&pipe).unwrap_err();
    assert!(matches!(error, evis_scene::SceneError::Io { .. }), "{error}");
}
