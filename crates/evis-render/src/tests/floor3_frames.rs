//! Floor 3 of frames beside events: stamped at the middle of their exposure, the mean of light over it, and no reason for
//! any other byte to change.

use evis_core::{LabelData, LabelFrame, LabelKind};

use super::floor3::{batch, gather};
use crate::config::{Method, RunConfig};
use crate::gpu::Gpu;
use crate::simulator::Simulator;
use crate::splat_config::SplatConfig;

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

#[test]
fn a_frame_is_the_mean_of_light_over_its_exposure() {
    let Some(gpu) = super::device() else { return };
    let config = config();
    let views = stream(&gpu, &config, 10_000);
    let mut simulator = Simulator::new(&gpu, batch(&[0.0, 0.4]), config).unwrap();
    let mut compared = 0;
    for (view, (_, labels)) in views.iter().enumerate() {
        let frames = frames(labels);
        assert_eq!(frames.iter().map(|f| f.t_us).collect::<Vec<_>>(), [4_000, 18_286, 32_571, 46_857]);
        assert!(labels.is_sorted_by_key(|label| (label.t_us, label.kind)));
        for frame in frames {
            assert_eq!(frame.t_us - frame.t_other_us, 4_000);
            let LabelData::F32(got) = &frame.data else { panic!("{frame:?}") };
            // Eight parts of the exposure, looked at in their middles.
            let looks: Vec<Vec<f64>> = (0..8)
                .map(|i| simulator.luminance(view, frame.t_other_us + 500 + 1_000 * i).unwrap())
                .collect();
            for (i, got) in got.iter().enumerate() {
                let mean = looks.iter().map(|look| look[i]).sum::<f64>() / 8.0;
                assert!((f64::from(*got) - mean).abs() <= 1e-6 * mean, "{got} {mean}");
            }
            let moved = got.iter().zip(&looks[0]).filter(|(a, b)| (f64::from(**a) - **b).abs() > 1e-3 * **b);
            assert!(moved.count() > 20, "canary: one look is not the mean");
            compared += 1;
        }
    }
    assert_eq!(compared, 8);
}

#[test]
fn frames_change_nothing_else_and_nothing_changes_them() {
    let Some(gpu) = super::device() else { return };
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
    let splat = Method::Splat(SplatConfig { keyframe_hz: 100.0, steps: 7, ..SplatConfig::default() });
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
    assert!(refused(RunConfig { labels, frame_rate_hz: None, ..config() }).contains("frame rate"));
}
