//! Shadow maps that follow what moves, environments that share them, and their size.

use std::sync::Arc;

use evis_scene::{Scene, Variant};
use glam::{DMat4, DVec3};

use super::built_in::{self, engine};
use crate::config::{RunConfig, Shadows};
use crate::engine::Engine;
use crate::gpu::Gpu;
use crate::tests::raster_scenes as scenes;

const CONFIG: fn() -> RunConfig = || RunConfig {
    size: Some((96, 72)),
    samples: 4,
    shadow_map: Some(512),
    reference_luminance: Some(1.0),
    ..RunConfig::default()
};

/// A box slides over a floor under a lamp; in the other environments the floor lies elsewhere, or the box starts later.
fn batch() -> Scene {
    let mut scene = scenes::moving_spotlight();
    let floor = scene.nodes.iter().position(|node| node.name == "floor").unwrap();
    let lower = Variant {
        node_offsets: vec![(floor, DMat4::from_translation(DVec3::new(0.0, -0.2, 0.0)))],
        ..Variant::default()
    };
    let later = Variant { time_offset_s: 0.02, ..Variant::default() };
    scene.variants = vec![Variant::default(), lower, later];
    scene
}

fn engine_of(gpu: &Gpu, scene: &Scene, config: &RunConfig) -> Engine {
    engine(gpu, &Arc::new(scene.clone()), config)
}

#[test]
fn a_map_shows_its_instant_and_environment_whatever_it_showed_before() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = batch();
    let mut one = engine_of(&gpu, &scene, &CONFIG());
    // Nothing is kept here: every map is drawn whole.
    let mut whole = engine_of(&gpu, &scene, &CONFIG());
    whole.parts().context.shadows.as_mut().unwrap().keep_nothing();
    let places = [(0, 0), (0, 20_000), (1, 20_000), (2, 0), (0, 30_000), (1, 0), (1, 30_000), (2, 10_000)];
    let pictures = places.map(|(view, t_us)| one.luminance(view, t_us).unwrap());
    for ((view, t_us), picture) in places.into_iter().zip(&pictures) {
        assert!(*picture == whole.luminance(view, t_us).unwrap(), "environment {view} at {t_us} us");
    }
    assert!(pictures[0] != pictures[1] && pictures[1] != pictures[2], "canary: they differ");
    assert!(pictures[1] == pictures[3], "the box that starts later is where the other one was");
}

#[test]
fn rays_see_in_cells_and_spheres_what_they_see_in_trees() {
    let Some(gpu) = crate::tests::device() else { return };
    let config = RunConfig { size: Some((128, 96)), shadows: Some(Shadows::Rays), ..CONFIG() };
    for (name, t_us) in [("desk", 100_000), ("street", 300_000), ("warehouse", 700_000)] {
        let scene = built_in::scene(name);
        let mut engine = engine(&gpu, &scene, &config);
        let listed = engine.luminance(0, t_us).unwrap();
        let mut without = |reach: f64| {
            let maps = engine.parts().context.shadows.as_mut().unwrap();
            maps.occluders.as_mut().unwrap().forget_cells(reach);
            engine.luminance(0, t_us).unwrap()
        };
        let off = |other: &[f64]| listed.iter().zip(other).filter(|(a, b)| a != b).count();
        // A ray that comes to no end in a tree is the map's.
        let walked = off(&without(1e4));
        assert!(walked <= 3, "{name}: {walked} pixels differ");
        let unseen = off(&without(0.0));
        assert!(unseen > 3, "{name}: canary: what moves throws no shadow, {unseen} pixels differ");
    }
}

#[test]
fn environments_that_stand_still_have_maps_of_their_own() {
    let Some(gpu) = crate::tests::device() else { return };
    let mut scene = scenes::sunlight();
    let floor = scene.nodes.iter().position(|node| node.name == "floor").unwrap();
    let alone = engine_of(&gpu, &scene, &CONFIG()).luminance(0, 0).unwrap();
    let lower = DMat4::from_translation(DVec3::new(0.0, -0.2, 0.0));
    let variant = |node_offsets| Variant { node_offsets, ..Variant::default() };
    scene.variants = vec![variant(vec![(floor, lower)]), variant(Vec::new())];
    let mut both = engine_of(&gpu, &scene, &CONFIG());
    let pictures = [0, 1].map(|view| both.luminance(view, 0).unwrap());
    assert!(pictures[0] != pictures[1]);
    scene.variants.truncate(1);
    assert!(engine_of(&gpu, &scene, &CONFIG()).luminance(0, 0).unwrap() == pictures[0]);
    // The world is larger with the lower floor, and a map spans it: as nearly as a texel.
    let off = alone.iter().zip(&pictures[1]).filter(|(a, b)| (*a - *b).abs() > 0.05 * **a).count();
    assert!(off < alone.len() / 50, "{off} pixels");
}

#[test]
fn the_finer_the_map_the_nearer_to_rays() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = scenes::moving_spotlight();
    let look = |config: RunConfig| engine_of(&gpu, &scene, &config).luminance(0, 10_000).unwrap();
    let rays = look(RunConfig { shadows: Some(Shadows::Rays), ..CONFIG() });
    let off = [256, 1024, 4096].map(|edge| {
        let maps = look(RunConfig { shadow_map: Some(edge), ..CONFIG() });
        let sum: f64 = maps.iter().zip(&rays).map(|(a, b)| (a - b).abs() / b.max(1e-3)).sum();
        sum / rays.len() as f64
    });
    assert!(
        off[0] > 2.0 * off[1] && off[1] > 2.0 * off[2] && off[2] > 0.0,
        "mean relative difference: {off:?}"
    );
}
