//! Floor 3: light of tiles that are followed against light that is rendered, and bytes.

use evis_core::SensorConfig;

use crate::config::{Method, RunConfig};
use crate::method::Sampling;

use super::adaptive_streams::{
    apart, assert_neighbours_change_no_byte, assert_packets_and_reruns_change_no_byte, engine, force, run,
    scene,
};

fn config(method: Method) -> RunConfig {
    RunConfig {
        size: Some((160, 120)),
        rate_hz: 1000.0,
        adaptive_px: Some(0.3),
        samples: 16,
        reference_luminance: Some(1.0),
        method,
        ..Default::default()
    }
}

#[test]
fn light_that_is_followed_is_the_light_that_would_be_rendered() {
    let Some(gpu) = super::device() else { return };
    for (name, least) in [("spinner", 0.5), ("street", 0.15), ("warehouse", 0.05)] {
        let scene = scene(name);
        // The block that begins at instant 17; paces 0 and keys every 8 instants.
        let at = |method: Method| {
            let mut engine = engine(&gpu, &scene, &config(method));
            force(&mut engine, 0);
            let light = engine.instants(17, 16).unwrap();
            let Sampling::Adaptive(room) = engine.parts().1 else { panic!("not in adaptive time") };
            (light, room.followed())
        };
        let ((rendered, _), (followed, told)) = (at(Method::Native), at(Method::March));
        let of_all = told[0] as f64 / (2.0 * 4.0 * 80.0);
        assert!(of_all > least && of_all < 1.0, "{name}: {of_all:.3} of quarters followed, {told:?}");
        // Between the keys at numbers 0, 8 and 16.
        for (k, number) in [(3, 4), (11, 12)] {
            let [median, most] = apart(&followed[k], &rendered[k], [0.5, 0.99]);
            assert!(median < 0.004 && most < 0.05, "{name} {number}: {median:.5}, {most:.4}");
        }
        // Keys are rendered, not followed.
        assert!(followed[7] == rendered[7] && followed[15] == rendered[15], "{name}");
        let [far] = apart(&followed[3], &rendered[7], [0.5]);
        assert!(far > 0.002, "{name}: canary {far:.5}");
    }
}

#[test]
fn packets_reruns_and_neighbours_change_no_byte() {
    let Some(gpu) = super::device() else { return };
    for (name, preset) in [("spinner", "evis"), ("street", "ideal")] {
        let alone = scene(name);
        let sensor = SensorConfig::preset(preset).unwrap();
        let config = RunConfig { samples: 4, sensor, ..config(Method::March) };
        let ran = run(&gpu, &alone, &config, 64_000);
        let (drawn, expected) = (ran.drawn_pixels, ran.events);
        let native = RunConfig { method: Method::Native, ..config.clone() };
        let all = run(&gpu, &alone, &native, 64_000).drawn_pixels;
        assert!(expected[0].len() > 100, "{name}");
        // In a picture as small as this, `street` is all edges.
        assert!(name == "street" || drawn < all, "{name}: {drawn} of {all} pixels");
        assert_packets_and_reruns_change_no_byte(&gpu, &alone, &config, &expected);
        if preset == "ideal" {
            assert_neighbours_change_no_byte(&gpu, &alone, &config, &expected[0]);
        }
    }
}

#[test]
fn what_does_not_change_is_never_felt() {
    let Some(gpu) = super::device() else { return };
    // One moving thing before a still camera: where nothing comes by, nothing fires, keys or not.
    let desk = scene("desk");
    let fires = |method: Method| {
        let events = run(&gpu, &desk, &config(method), 64_000).events;
        let mut pixels: Vec<(u16, u16)> = events[0].iter().map(|e| (e.x, e.y)).collect();
        pixels.sort_unstable();
        pixels.dedup();
        pixels
    };
    let (rendered, followed) = (fires(Method::Native), fires(Method::March));
    let more = followed.iter().filter(|pixel| rendered.binary_search(pixel).is_err()).count();
    assert!(more * 50 <= rendered.len(), "{more} pixels more than {}", rendered.len());
}

#[test]
fn settings_that_cannot_be_are_named() {
    let refused = |config: RunConfig| config.check().unwrap_err().to_string();
    let text = refused(RunConfig { samples: 128, ..config(Method::March) });
    assert!(text.contains("samples is 128") && text.contains("64 at most, for march"), "{text}");
    let text = refused(RunConfig { adaptive_px: None, ..config(Method::March) });
    assert!(text.contains("for march"), "{text}");
}
