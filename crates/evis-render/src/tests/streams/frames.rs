//! Frames beside events: stamped at the middle of their exposure, the mean of light over it, and no reason for
//! any other byte to change.

use std::sync::Arc;

use evis_core::{LabelData, LabelFrame, LabelKind, Warp};
use evis_scene::Motion;

use super::gather::{batch, gather};
use crate::config::{Method, RunConfig};
use crate::engine::simulator::Simulator;
use crate::gpu::Gpu;

fn config() -> RunConfig {
    RunConfig {
        size: Some((40, 30)),
        rate_hz: 700.0,
        samples: 2,
        reference_luminance: Some(0.5),
        frame_rate_hz: Some(70.0),
        exposure_us: 8_000,
        labels: vec![LabelKind::Depth],
        label_rate_hz: 100.0,
        ..RunConfig::default()
    }
}

type Views = Vec<(Vec<evis_core::Event>, Vec<LabelFrame>)>;

fn stream(gpu: &Gpu, config: &RunConfig, packet_us: i64) -> Views {
    let simulator = Simulator::new(gpu, batch(&[0.0, 0.4]), config.clone()).unwrap();
    gather(simulator.stream(50_000, packet_us).unwrap().map(Result::unwrap))
}

fn frames(labels: &[LabelFrame]) -> Vec<&LabelFrame> {
    labels.iter().filter(|label| label.kind == LabelKind::Frame).collect()
}

/// The light that view `view` shows, mean over 32 times of an exposure from `start_us` on; then at its middle.
fn exposed(simulator: &mut Simulator, view: usize, start_us: i64, exposure_us: i64) -> [Vec<f64>; 2] {
    let mut at = |part: i64| simulator.luminance(view, start_us + exposure_us * part / 64).unwrap();
    let middle = at(32);
    let mut mean = vec![0.0; middle.len()];
    for look in 0..32 {
        mean.iter_mut().zip(at(2 * look + 1)).for_each(|(mean, light)| *mean += light / 32.0);
    }
    [mean, middle]
}

fn light(frame: &LabelFrame) -> Vec<f64> {
    let LabelData::F32(light) = &frame.data else { panic!("{frame:?}") };
    light.iter().copied().map(f64::from).collect()
}

/// How far `a` is from `b`, relative to that: the root of the mean of squares.
fn apart(a: &[f64], b: &[f64]) -> f64 {
    let sum: f64 = a.iter().zip(b).map(|(a, b)| (a / b - 1.0).powi(2)).sum();
    (sum / a.len() as f64).sqrt()
}

#[test]
fn a_frame_is_the_mean_of_light_over_its_exposure() {
    let Some(gpu) = crate::tests::device() else { return };
    // The spinner's picture moves by up to 4 pixels meanwhile.
    let config = RunConfig { size: Some((160, 120)), exposure_us: 14_000, samples: 16, ..config() };
    let scene = batch(&[0.0, 0.4]);
    let simulator = Simulator::new(&gpu, scene.clone(), config.clone()).unwrap();
    let views = gather(simulator.stream(50_000, 10_000).unwrap().map(Result::unwrap));
    let mut simulator = Simulator::new(&gpu, scene, config).unwrap();
    let mut compared = 0;
    for (view, (_, labels)) in views.iter().enumerate() {
        let frames = frames(labels);
        assert_eq!(frames.iter().map(|f| f.t_us).collect::<Vec<_>>(), [7_000, 21_286, 35_571, 49_857]);
        assert!(labels.is_sorted_by_key(|label| (label.t_us, label.kind)));
        for frame in frames {
            assert_eq!(frame.t_us - frame.t_other_us, 7_000);
            let [mean, middle] = exposed(&mut simulator, view, frame.t_other_us, 14_000);
            let (error, one_look) = (apart(&light(frame), &mean), apart(&middle, &mean));
            // The picture has 16 texels per pixel, which samples see the less of the fewer looks there are.
            assert!(error < 5e-3 && 3.0 * error < one_look, "{error} {one_look}");
            compared += 1;
        }
    }
    assert_eq!(compared, 8);
}

#[test]
fn what_is_still_while_a_frame_is_exposed_is_looked_at_once() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = Arc::new(evis_scene::builtin::load("desk", 0).unwrap());
    let exposure_us = 14_000;
    let config = RunConfig { size: Some((96, 72)), exposure_us, samples: 16, ..config() };
    let mut simulator = Simulator::new(&gpu, scene, config).unwrap();
    let labels = simulator.step(10_000).unwrap().views.remove(0).labels;
    let frame = light(frames(&labels)[0]);
    let [mean, middle] = exposed(&mut simulator, 0, 0, exposure_us);
    let (mut same, mut moved) = (0, 0);
    for ((frame, mean), middle) in frame.iter().zip(&mean).zip(&middle) {
        same += usize::from(*frame == f64::from(*middle as f32));
        moved += usize::from((mean / middle - 1.0).abs() > 0.01);
    }
    // A single look, bit for bit; a mean of several is not.
    assert!(same > frame.len() / 2 && moved > 20, "{same} the same, {moved} moved");
    let (error, one_look) = (apart(&frame, &mean), apart(&middle, &mean));
    assert!(4.0 * error < one_look, "{error} {one_look}");
}

#[test]
fn light_that_changes_is_looked_at_while_nothing_moves() {
    let Some(gpu) = crate::tests::device() else { return };
    let mut scene = evis_scene::builtin::load("desk", 0).unwrap();
    for node in &mut scene.nodes {
        if !matches!(node.motion, Motion::Fixed(_)) {
            node.motion = Motion::Fixed(glam::DMat4::IDENTITY);
        }
    }
    scene.lights[0].waveform = Some(evis_scene::motion::Waveform {
        shape: evis_scene::motion::WaveShape::Sine,
        frequency_hz: 100.0,
        phase: 0.0,
        low: 0.1,
        high: 1.0,
    });
    let exposure_us = 14_000;
    let config = RunConfig { size: Some((48, 36)), exposure_us, ..config() };
    let mut simulator = Simulator::new(&gpu, Arc::new(scene), config).unwrap();
    let labels = simulator.step(10_000).unwrap().views.remove(0).labels;
    let [mean, middle] = exposed(&mut simulator, 0, 0, exposure_us);
    let (error, one_look) = (apart(&light(frames(&labels)[0]), &mean), apart(&middle, &mean));
    assert!(error < 2e-3 && one_look > 0.1, "{error} {one_look}");
}

#[test]
fn frames_change_nothing_else_and_nothing_changes_them() {
    let Some(gpu) = crate::tests::device() else { return };
    let config = config();
    let expected = stream(&gpu, &config, 10_000);
    assert!(expected[0].0.len() > 100, "{}", expected[0].0.len());
    for packet_us in [777, 50_000] {
        assert!(stream(&gpu, &config, packet_us) == expected, "packets of {packet_us} us");
    }
    let without = stream(&gpu, &RunConfig { frame_rate_hz: None, ..config.clone() }, 10_000);
    for ((events, labels), (with_events, with_labels)) in without.iter().zip(&expected) {
        assert!(events == with_events && frames(labels).is_empty());
        assert_eq!(labels.len() + 4, with_labels.len());
    }
    // Whatever makes the events, frames are rendered.
    let splat = Method::Splat(Warp::default().at(100.0, 7));
    let splatted = stream(&gpu, &RunConfig { method: splat, ..config.clone() }, 10_000);
    assert!(frames(&splatted[1].1) == frames(&expected[1].1) && splatted[1].0 != expected[1].0);
    let longer = stream(&gpu, &RunConfig { exposure_us: 12_000, ..config }, 10_000);
    assert!(frames(&longer[0].1) != frames(&expected[0].1), "canary: another exposure");
}

#[test]
fn exposures_that_cannot_be_are_named() {
    let refused = |config: RunConfig| config.check().unwrap_err().to_string();
    for exposure_us in [0, -2, 7, 14_286] {
        assert!(refused(RunConfig { exposure_us, ..config() }).contains("exposure"));
    }
    assert!(RunConfig { exposure_us: 14_284, ..config() }.check().is_ok(), "canary");
    assert!(refused(RunConfig { frame_rate_hz: Some(0.0), ..config() }).contains("frame_rate"));
    let labels = vec![LabelKind::Frame];
    assert!(refused(RunConfig { labels, frame_rate_hz: None, ..config() }).contains("frame_rate_hz"));
}

#[test]
fn the_usual_exposure_fits_between_two_frames() {
    assert_eq!(RunConfig::usual_exposure_us(None), 10_000);
    for (rate_hz, exposure_us) in
        [(1e-300, 10_000), (30.0, 10_000), (100.0, 10_000), (300.0, 3_332), (5e5, 2)]
    {
        assert_eq!(RunConfig::usual_exposure_us(Some(rate_hz)), exposure_us, "{rate_hz} Hz");
    }
    let fast = |rate_hz| {
        let exposure_us = RunConfig::usual_exposure_us(Some(rate_hz));
        RunConfig { frame_rate_hz: Some(rate_hz), exposure_us, ..config() }.check()
    };
    assert!(fast(5e5).is_ok());
    assert!(fast(6e5).unwrap_err().to_string().contains("500000 frames per second at most"));
}
