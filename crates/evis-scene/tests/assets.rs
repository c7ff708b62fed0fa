//! Real models. `EVIS_ASSETS` names the folder that holds them.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::io::Write;
use std::path::{Path, PathBuf};

use evis_scene::gltf::{Options, load};
use evis_scene::{Motion, Scene, SceneState, ShadingModel};
use glam::{DMat4, DVec3, Vec3, Vec4};

fn assets() -> Option<PathBuf> {
    let folder = std::env::var_os("EVIS_ASSETS").map(PathBuf::from);
    if folder.is_none() {
        // Straight to the stream: the test harness hides what its own macros print.
        let _ = writeln!(std::io::stderr(), "not run: EVIS_ASSETS is not set");
    }
    folder
}

fn open(path: &Path, animation: Option<&str>) -> Scene {
    let options = Options { animation: animation.map(str::to_owned), ..Options::default() };
    load(path, &options).unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn real_models_have_their_bounds_counts_and_durations() {
    let Some(folder) = assets() else { return };
    // Bounds from the minima and maxima that the files give; Cornell's box measures 556 x 548.8 x 559.2.
    type Row = (&'static str, [f64; 3], [f64; 3], usize, usize, Option<f64>);
    let rows: [Row; 14] = [
        ("gltf/AnimatedCube/AnimatedCube.gltf", [-1.0; 3], [1.0; 3], 12, 2, Some(2.0)),
        ("gltf/Avocado/Avocado.gltf", [-0.02128, 0.0, -0.01381], [0.02128, 0.06285, 0.01381], 682, 3, None),
        ("gltf/AnimatedMorphCube.glb", [-1.0; 3], [1.0; 3], 12, 0, Some(4.199_997_425_079_346)),
        ("gltf/BoxAnimated.glb", [-0.5; 3], [0.5; 3], 254, 0, Some(3.708_329_916_000_366)),
        ("gltf/BoxVertexColors.glb", [-0.5; 3], [0.5; 3], 12, 0, None),
        ("gltf/CornellBox.glb", [-556.0, 0.0, -559.2], [0.0, 548.8, 0.0], 36, 0, None),
        ("gltf/Fox.glb", [-29.9, -0.13, -84.34], [11.6, 74.64, 56.65], 576, 1, Some(3.416_666_746_139_526_4)),
        ("gltf/NormalTangentTest.glb", [-1.11, -1.2, -0.01], [1.11, 0.95, 0.0805], 7774, 3, None),
        ("warehouse/Bucket_01.glb", [-47.05, -60.72, 0.49], [47.05, 61.05, 140.91], 144, 1, None),
        ("warehouse/ClutteringA_01.glb", [-107.31, -99.14, 4.38], [107.31, 99.14, 110.14], 292, 3, None),
        ("warehouse/DeskC_01.glb", [-44.1, -77.77, 0.0], [44.1, 77.77, 143.66], 677, 4, None),
        ("warehouse/GroundB_01.glb", [-699.0, -1045.3, 0.0], [701.0, 1046.8, 12.4], 94, 2, None),
        ("warehouse/ShelfF_01.glb", [-105.8, -902.3, 0.0], [105.8, 902.3, 652.5], 2926, 3, None),
        ("warehouse/TrashCanC_01.glb", [-72.28, -44.58, 3.74], [72.28, 44.58, 130.57], 1031, 1, None),
    ];
    for (file, low, high, triangles, images, duration_s) in rows {
        let mut scene = open(&folder.join(file), None);
        let (got_low, got_high) = scene.bounds(0.0).unwrap_or_else(|| panic!("{file} is empty"));
        let tolerance = 1e-3 * (DVec3::from(high) - DVec3::from(low)).length();
        assert!((got_low - DVec3::from(low)).length() < tolerance, "{file}: {got_low}");
        assert!((got_high - DVec3::from(high)).length() < tolerance, "{file}: {got_high}");
        let count: usize = scene.meshes.iter().flat_map(|m| &m.primitives).map(|p| p.indices.len() / 3).sum();
        assert_eq!((count, scene.images.len(), scene.duration_s), (triangles, images, duration_s), "{file}");
        assert_eq!(scene.cameras.len(), 1, "{file}");
        assert!(scene.needs_light(), "{file}");
        assert!(scene.images.iter().all(|i| i.texels.iter().flatten().all(|v| v.is_finite())));
        for primitive in scene.meshes.iter().flat_map(|m| &m.primitives) {
            assert!(
                primitive.normals.iter().all(|n| (Vec3::from_array(*n).length() - 1.0).abs() < 1e-3),
                "{file}"
            );
        }
        scene.validate().unwrap_or_else(|e| panic!("{file}, a second time: {e}"));
    }
}

#[test]
fn an_emitter_keeps_its_strength() {
    let Some(folder) = assets() else { return };
    let scene = open(&folder.join("gltf/CornellBox.glb"), None);
    assert_eq!(scene.materials[0].emissive, [100.0; 3]);
    assert_eq!(scene.materials[0].model, ShadingModel::MetallicRoughness);
}

/// Largest distance of a joint matrix's entries from the identity.
fn from_identity(scene: &Scene) -> f64 {
    let mut state = SceneState::default();
    scene.evaluate(0.0, &mut state);
    let mut joints = Vec::new();
    scene.joint_matrices(0, &state, &mut joints);
    assert_eq!(joints.len(), 24);
    let far = |m: &DMat4| (*m - DMat4::IDENTITY).to_cols_array().iter().fold(0.0_f64, |a, v| a.max(v.abs()));
    joints.iter().map(far).fold(0.0, f64::max)
}

#[test]
fn the_fox_stands_as_it_was_bound_when_nothing_plays_and_runs_when_asked() {
    let Some(folder) = assets() else { return };
    let path = folder.join("gltf/Fox.glb");
    let fox = open(&path, None);
    let animated = from_identity(&fox);
    let mut still = fox.clone();
    for node in &mut still.nodes {
        if let Motion::Animated { rest, .. } = &node.motion {
            node.motion = Motion::Fixed(rest.matrix());
        }
    }
    let (bound, size) = (from_identity(&still), 150.0);
    println!("bind pose off by {bound:.2e}, first frame by {animated:.2e}");
    assert!(bound < 1e-3 * size, "{bound}");
    assert!(animated > 10.0 * bound, "the first frame of the animation is another pose");
    let (low, high) = still.bounds(0.0).unwrap_or_default();
    let (file_low, file_high) = (DVec3::new(-12.593, -0.122, -88.095), DVec3::new(12.593, 78.907, 66.625));
    assert!((low - file_low).length() < 0.1 && (high - file_high).length() < 0.1, "{low} {high}");

    for (name, end) in [("Survey", 3.4167), ("Walk", 0.7083), ("Run", 1.1583)] {
        let fox = open(&path, Some(name));
        assert!((fox.duration_s.unwrap_or_default() - end).abs() < 1e-3, "{name}: {:?}", fox.duration_s);
    }
}

#[test]
fn generated_tangents_agree_with_those_that_files_carry() {
    let Some(folder) = assets() else { return };
    let mut scene = open(&folder.join("gltf/Avocado/Avocado.gltf"), None);
    let given = scene.meshes[0].primitives[0].tangents.take().unwrap_or_default();
    scene.validate().unwrap_or_else(|e| panic!("{e}"));
    let primitive = &scene.meshes[0].primitives[0];
    let made = primitive.tangents.as_deref().unwrap_or_default();
    assert!(given.len() == 406 && made.len() >= given.len());
    let pairs = given.iter().zip(made).map(|(a, b)| (Vec4::from_array(*a), Vec4::from_array(*b)));
    let mut cosines: Vec<f32> = pairs.clone().map(|(a, b)| a.truncate().dot(b.truncate())).collect();
    cosines.sort_by(f32::total_cmp);
    let same_side = pairs.filter(|(a, b)| a.w * b.w > 0.0).count();
    println!(
        "cosines: 5 % {}, median {}; same side {same_side} of {}",
        cosines[20],
        cosines[203],
        given.len()
    );
    assert!(cosines[20] > 0.9 && cosines[203] > 0.99 && same_side > 400);

    let scene = open(&folder.join("gltf/NormalTangentTest.glb"), None);
    let primitive = &scene.meshes[0].primitives[0];
    let tangents = primitive.tangents.as_deref().unwrap_or_default();
    assert_eq!(tangents.len(), primitive.positions.len());
    for (t, n) in tangents.iter().zip(&primitive.normals) {
        let (t, n) = (Vec4::from_array(*t), Vec3::from_array(*n));
        assert!(
            (t.truncate().length() - 1.0).abs() < 1e-4
                && t.truncate().dot(n).abs() < 1e-3
                && t.w.abs() == 1.0
        );
    }
}

#[test]
fn the_morph_cube_grows_as_its_file_says() {
    let Some(folder) = assets() else { return };
    let scene = open(&folder.join("gltf/AnimatedMorphCube.glb"), None);
    let mut state = SceneState::default();
    let mut tallest = 0.0_f32;
    for k in 0..100 {
        scene.evaluate(0.042 * f64::from(k), &mut state);
        let node = scene.nodes.iter().position(|n| n.mesh.is_some()).unwrap_or_default();
        assert_eq!(state.morph_weights[node].len(), 2);
        tallest = state.morph_weights[node].iter().fold(tallest, |a, w| a.max(*w));
    }
    assert!((0.9..=1.1).contains(&tallest), "{tallest}");
}
