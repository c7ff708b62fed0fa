//! A device that is lost ends a run with an error that says so, and takes nothing that was delivered.

use std::sync::Arc;

use evis_core::LabelKind;
use evis_core::sensor::SensorConfig;

use super::gather::gather;
use crate::config::RunConfig;
use crate::engine::simulator::Simulator;
use crate::error::EngineError;

#[test]
fn a_lost_device_ends_a_run_with_its_name_and_takes_nothing_that_was_delivered() {
    let scene = Arc::new(evis_scene::builtin::load("spinner", 0).unwrap());
    let plain = RunConfig { size: Some((80, 60)), rate_hz: 700.0, samples: 2, ..Default::default() };
    let labels = RunConfig { labels: vec![LabelKind::Depth], label_rate_hz: 100.0, ..plain.clone() };
    let adaptive = RunConfig { adaptive_px: Some(0.5), ..plain.clone() };
    let chain = RunConfig { sensor: SensorConfig::preset("v2e-noisy").unwrap(), ..plain.clone() };
    for (name, config) in [("plain", plain), ("labels", labels), ("adaptive", adaptive), ("chain", chain)] {
        let Some(gpu) = crate::tests::device() else { return };
        let expected = gather(
            [20_000]
                .map(|t| Simulator::new(&gpu, scene.clone(), config.clone()).unwrap().step(t).unwrap())
                .into_iter(),
        );
        let mut simulator = Simulator::new(&gpu, scene.clone(), config.clone()).unwrap();
        let before = simulator.step(20_000).unwrap();
        gpu.device.destroy();
        // A driver that gives up says so before it refuses anything; after this call it is said when the device is asked.
        let _ = gpu.device.poll(wgpu::PollType::Poll);
        for _ in 0..2 {
            let Err(EngineError::Device(told)) = simulator.step(40_000) else { panic!("{name}: no error") };
            assert!(told.contains("was lost") && told.contains(&gpu.summary().name), "{name}: {told}");
            assert_eq!(simulator.now_us(), 20_000, "{name}");
        }
        assert!(gather([before].into_iter()) == expected, "{name}: what was delivered before");
        let Err(EngineError::Device(told)) = Simulator::new(&gpu, scene.clone(), config) else {
            panic!("{name}")
        };
        assert!(told.contains("was lost"), "{name}: {told}");
    }
}

#[test]
fn a_device_that_is_lost_during_a_stream_ends_it() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = Arc::new(evis_scene::builtin::load("spinner", 0).unwrap());
    let config = RunConfig { size: Some((80, 60)), rate_hz: 700.0, samples: 2, ..Default::default() };
    let mut stream = Simulator::new(&gpu, scene, config).unwrap().stream(10_000_000_000, 10_000).unwrap();
    for _ in 0..3 {
        stream.next().unwrap().unwrap();
    }
    gpu.lost.set("by this test".into()).unwrap();
    gpu.device.destroy();
    // Packets that were rendered already still come.
    let mut error = None;
    for _ in 0..100 {
        if let Err(one) = stream.next().expect("an error ends it") {
            error = Some(one.to_string());
            break;
        }
    }
    assert!(error.as_ref().is_some_and(|told| told.contains("was lost")), "{error:?}");
    assert!(stream.next().is_none(), "nothing comes after the error");
}

/// Address space that may be written and executed, bytes: where drivers put the code that they make.
#[cfg(target_os = "linux")]
fn executable_bytes() -> u64 {
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
    let heap = |line: &str| {
        let mut words = line.split_whitespace();
        let (from, to) = words.next()?.split_once('-')?;
        let number = |text| u64::from_str_radix(text, 16).ok();
        words.next()?.starts_with("rwx").then_some(number(to)? - number(from)?)
    };
    maps.lines().filter_map(heap).sum()
}

#[test]
#[cfg(target_os = "linux")]
fn simulators_one_after_the_other_take_no_more_address_space() {
    let scene = Arc::new(evis_scene::builtin::load("spinner", 0).unwrap());
    let config = RunConfig { size: Some((16, 12)), rate_hz: 200.0, samples: 1, ..Default::default() };
    let once = || {
        let gpu = crate::tests::device()?;
        Simulator::new(&gpu, scene.clone(), config.clone()).unwrap().step(5_000).unwrap();
        Some(executable_bytes())
    };
    let Some(first) = once() else { return };
    let most = (0..4).filter_map(|_| once()).max();
    assert!(most.is_some_and(|most| most <= first), "{first} bytes after the first, {most:?} after others");
}
