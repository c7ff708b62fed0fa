//! Decoupled sampling that leaves parts of a picture to rendering.

use std::sync::Arc;

use evis_core::{Cause, Event, LabelKind, SensorConfig};
use evis_scene::motion::Path;
use evis_scene::primitive::Shape;
use evis_scene::{Mesh, Motion, Node, Primitive, Scene, Trs};
use glam::DVec3;

use crate::config::{Antialias, Interpolation, Method, Quality, RenderedTiles, RunConfig};
use crate::engine::simulator::Simulator;
use crate::output::packet::Packet;
use crate::request::SamplingRequest;
use crate::request::settings::SettingsFile;
use crate::tests::streams::built_in;
use crate::world::crowds::{CrowdedViews, Crowds};
use crate::world::tiles::{tile_at, tiles_along};
use crate::world::view::views;

const SIZE: (u32, u32) = (96, 72);

const RENDERED: RenderedTiles = RenderedTiles { triangles_per_pixel: 1.0, step_px: 0.5 };

/// `spinner` for 0.2 s, with a ball of 51 200 triangles that turns in the lower right of the picture.
fn scene() -> Scene {
    let mut scene = (*built_in::scene("spinner")).clone();
    scene.duration_s = Some(0.2);
    let ball = Shape::Sphere { radius: 0.35 }.build(Some([160, 160]), [1.0; 2]).unwrap();
    let ball = Primitive { material: scene.materials.len() - 1, ..ball };
    let mesh = Some(scene.meshes.len());
    scene.meshes.push(Mesh { primitives: vec![ball], ..Mesh::default() });
    let start = Trs { translation: DVec3::new(0.8, -0.5, -2.4), ..Trs::default() };
    let motion = Motion::Path(Arc::new(Path::Spin { start, axis: DVec3::Y, rate: 6.0 }));
    scene.add_node(Node { mesh, motion, name: "ball".into(), ..Node::default() });
    scene
}

fn config() -> RunConfig {
    RunConfig {
        method: Method::Decoupled,
        size: Some(SIZE),
        rate_hz: 4000.0,
        samples: 16,
        antialias: Antialias::Edges,
        reference_luminance: Some(0.5),
        ..RunConfig::default()
    }
}

fn crowds(scene: &Scene, config: &RunConfig, per_pixel: f64) -> Crowds {
    let (views, cameras) = views(scene, config).unwrap();
    Crowds::of(scene, &views, &cameras, (config, per_pixel)).unwrap()
}

fn tiles(scene: &Scene, config: &RunConfig, per_pixel: f64) -> CrowdedViews {
    match crowds(scene, config, per_pixel) {
        Crowds::Tiles(found) => found,
        other => panic!("{other:?}"),
    }
}

fn joined(packets: impl IntoIterator<Item = Packet>) -> (Vec<Event>, Vec<u8>) {
    let (mut events, mut causes) = (Vec::new(), Vec::new());
    for packet in packets {
        assert_eq!(packet.report.events, packet.views[0].events.len() as u64);
        events.extend(&packet.views[0].events);
        causes.extend(&packet.views[0].causes);
    }
    (events, causes)
}

/// Each tile fires what its own way alone makes it fire, and packets change no byte.
#[test]
fn crowded_tiles_are_rendered_and_all_others_followed() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = Arc::new(scene());
    let mut noisy = SensorConfig::preset("dvxplorer-like").unwrap();
    noisy.readout = SensorConfig::default().readout;
    for sensor in [SensorConfig::default(), noisy] {
        let labels = vec![LabelKind::Cause, LabelKind::Depth];
        let frame_rate_hz = Some(50.0);
        let mixed = RunConfig { sensor, labels, frame_rate_hz, rendered_tiles: Some(RENDERED), ..config() };
        let followed = RunConfig { rendered_tiles: None, ..mixed.clone() };
        let rendered = RunConfig {
            method: Method::Native,
            adaptive_px: Some(0.5),
            between: Interpolation::Curve,
            ..followed.clone()
        };
        let new = |config: &RunConfig| Simulator::new(&gpu, scene.clone(), config.clone()).unwrap();
        let whole = |config: &RunConfig| joined([new(config).step(60_000).unwrap()]);
        let found = tiles(&scene, &mixed, 1.0);
        assert!((0.05..0.6).contains(&found.share) && found.small > 10_000, "{found:?}");
        let is_crowded = |event: &Event| found.tiles[0][tile_at(SIZE.0, event.x.into(), event.y.into())];
        let (events, causes) = whole(&mixed);
        for (way, crowded) in [(&followed, false), (&rendered, true)] {
            let (expected, expected_causes) = whole(way);
            let own = |events: &[Event], causes: &[u8]| -> Vec<(Event, u8)> {
                let all = events.iter().copied().zip(causes.iter().copied());
                all.filter(|(event, _)| is_crowded(event) == crowded).collect()
            };
            let (own, expected) = (own(&events, &causes), own(&expected, &expected_causes));
            assert!(own.len() > 1000, "{} events", own.len());
            assert!(own == expected, "crowded {crowded}: {} events, not {}", own.len(), expected.len());
        }
        assert!(events.is_sorted_by_key(Event::order));
        if !mixed.sensor.is_ideal() {
            assert!(causes.iter().any(|cause| *cause != Cause::Signal as u8));
        }
        let beside = new(&followed).step(60_000).unwrap();
        assert_eq!(beside.report.rendered_tiles, 0);
        let mut stepped = new(&mixed);
        let packets: Vec<Packet> =
            [1_000, 33_000, 33_001, 60_000].map(|until_us| stepped.step(until_us).unwrap()).into();
        // Depth and frames show all of the picture.
        let labels: Vec<_> = packets.iter().flat_map(|packet| packet.views[0].labels.clone()).collect();
        assert!(labels.len() == 6 && labels == beside.views[0].labels, "{} labels", labels.len());
        let count = found.tiles[0].iter().filter(|tile| **tile).count() as u64;
        assert!(packets.iter().all(|packet| packet.report.rendered_tiles == count));
        assert!(joined(packets) == (events, causes), "packets change nothing");
    }
}

#[test]
fn presets_render_what_is_crowded_and_say_how_much() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = scene();
    let settled = |scene: &Scene, base: RunConfig| {
        let request = SamplingRequest { quality: Some(Quality::High), ..Default::default() };
        let mut config = RunConfig { method: Method::Native, ..base };
        let notes = request.apply(Some(&gpu), scene, &mut config).unwrap();
        config.check().unwrap();
        (config, notes.join("; "))
    };
    let (high, notes) = settled(&scene, config());
    let expected = Some(RenderedTiles { triangles_per_pixel: 8.0, step_px: 0.3 });
    let share = tiles(&scene, &config(), 8.0).share;
    let part = format!("{:.0} % of the picture by rendering", (100.0 * share).ceil());
    assert!(notes.contains(&part), "{notes}");
    assert_eq!((high.method, high.rendered_tiles), (Method::Decoupled, expected));
    // A recording keeps it.
    let stored: RunConfig = serde_json::from_str(&serde_json::to_string(&high).unwrap()).unwrap();
    assert_eq!(stored.rendered_tiles, expected);
    // So do settings of sampling alone; a method by hand does not take it over.
    assert!(SettingsFile::sampling(&high).gives("rendered_tiles"));
    for (method, kept) in [(None, expected), (Some(Method::Native), None), (Some(Method::Decoupled), None)] {
        let request = SamplingRequest { method, from_settings: true, ..Default::default() };
        let mut config = stored.clone();
        request.apply(Some(&gpu), &scene, &mut config).unwrap();
        assert_eq!(config.rendered_tiles, kept, "{method:?}");
    }
    let without = built_in::scene("spinner");
    let (plain, notes) = settled(&without, config());
    assert_eq!((plain.method, plain.rendered_tiles), (Method::Decoupled, None), "{notes}");
    // Where tiles cannot be rendered alone, whole pictures are.
    let mut driven = scene.clone();
    driven.drive(&["ball".into()], 0).unwrap();
    let mut bus = SensorConfig::default();
    bus.readout.rate_limit_hz = 1e6;
    for (scene, base) in [(&driven, config()), (&scene, RunConfig { sensor: bus, ..config() })] {
        assert!(matches!(crowds(scene, &base, 1.0), Crowds::Whole(_)));
        let (whole, notes) = settled(scene, base);
        assert!(notes.contains("sampled by rendering"), "{notes}");
        assert_eq!((whole.method, whole.rendered_tiles), (Method::Native, None));
    }
    // And so it is where it is nearly all of the picture.
    let mut close = scene.clone();
    let finer = Shape::Sphere { radius: 0.35 }.build(Some([600, 600]), [1.0; 2]).unwrap();
    let own = close.meshes.last_mut().unwrap();
    own.primitives = vec![Primitive { material: own.primitives[0].material, ..finer }];
    let start = Trs { translation: DVec3::new(0.0, 0.0, -0.42), ..Trs::default() };
    let spin = Motion::Path(Arc::new(Path::Spin { start, axis: DVec3::Y, rate: 6.0 }));
    close.nodes.last_mut().unwrap().motion = spin;
    assert!(matches!(crowds(&close, &config(), 1.0), Crowds::Whole(_)));
    // By hand it is refused where it means nothing.
    let none = RenderedTiles { step_px: 0.0, ..RENDERED };
    let unknown = RenderedTiles { triangles_per_pixel: f64::NAN, ..RENDERED };
    for (method, tiles, value) in [
        (Method::Native, RENDERED, "decoupled only"),
        (Method::Decoupled, none, "step_px is 0"),
        (Method::Decoupled, unknown, "triangles_per_pixel is NaN"),
    ] {
        let config = RunConfig { method, rendered_tiles: Some(tiles), ..config() };
        let error = config.check().unwrap_err().to_string();
        assert!(error.contains("rendered_tiles") && error.contains(value), "{error}");
    }
}

/// What `tune` does: a stream that begins elsewhere, of some tiles alone.
#[test]
fn a_stream_that_restarts_keeps_both_ways() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = Arc::new(scene());
    let config = RunConfig { rendered_tiles: Some(RENDERED), ..config() };
    let found = tiles(&scene, &config, 1.0);
    let mut simulator = Simulator::new(&gpu, scene.clone(), config.clone()).unwrap();
    let first = simulator.step(20_000).unwrap().views.remove(0).events;
    simulator.restart(0, Vec::new(), false).unwrap();
    assert!(simulator.step(20_000).unwrap().views[0].events == first);
    // The right half.
    let columns = tiles_along(SIZE.0);
    let right: Vec<bool> =
        (0..found.tiles[0].len() as u32).map(|tile| tile % columns >= columns / 2).collect();
    simulator.restart(0, vec![right.clone()], false).unwrap();
    let own = simulator.step(20_000).unwrap().views.remove(0).events;
    let tile = |e: &Event| tile_at(SIZE.0, e.x.into(), e.y.into());
    let expected: Vec<Event> = first.iter().filter(|e| right[tile(e)]).copied().collect();
    let asked: Vec<Event> = own.iter().filter(|e| right[tile(e)]).copied().collect();
    assert!(expected.len() > 300 && expected.iter().any(|e| found.tiles[0][tile(e)]));
    assert!(asked == expected, "{} events, not {}", asked.len(), expected.len());
}
