//! `score` on files that the test has written.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use std::path::Path;

use common::{Folder, HEIGHT, WIDTH, code, events, evis, json, stderr, stdout, write_recording};
use evis_core::format::hdf5::{RecordingHeader, RecordingWriter};
use evis_core::{CameraInfo, Event, Polarity, Region, SensorConfig, Truth};

/// The events that `write_recording` writes, as truth of 200 ms with one region per polarity.
fn truth(change: impl FnOnce(&mut Truth)) -> Truth {
    let camera = CameraInfo::uncalibrated("left", (WIDTH, HEIGHT));
    let mut truth = Truth::from_events(events(), camera, SensorConfig::default(), 1.0, 200_000);
    let region = |e: &Event| if e.p == 1 { Region::Interior } else { Region::ShadowEdge };
    truth.event_region = truth.events.iter().map(region).collect();
    change(&mut truth);
    truth
}

/// A recording of one camera.
fn record(path: &Path, size: [u32; 2], config_toml: &str, events: &[Event]) {
    let camera = CameraInfo { name: "only".into(), width: size[0], height: size[1], ..truth(|_| ()).camera };
    let header = RecordingHeader {
        method: "native".into(),
        config_toml: config_toml.into(),
        ..RecordingHeader::of(vec![camera])
    };
    let mut writer = RecordingWriter::create(path, &header, false).unwrap();
    writer.write_events(0, events).unwrap();
    writer.finish("{}").unwrap();
}

#[test]
fn a_score_is_a_table_or_json() {
    let folder = Folder::new("score");
    write_recording(&folder.file("a.h5"), false, true);
    truth(|_| ()).write(&folder.file("truth.h5"), false).unwrap();
    // The truth's camera is found among the recording's two.
    let output = evis(&folder, "score a.h5 --truth truth.h5");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    for words in
        ["1000 us plain     1.0000", "100 us scaled    1.0000", "interior", "shadow_edge", "relative L1"]
    {
        assert!(stdout(&output).contains(words), "the table lacks '{words}':\n{}", stdout(&output));
    }
    let scored = json(&evis(&folder, "score a.h5 --truth truth.h5 --json --tolerance-us 500,50"));
    assert_eq!((&scored["camera"], &scored["score"]["truth_events"]), (&"left".into(), &200.into()));
    let levels = &scored["score"]["tolerances"];
    assert_eq!((&levels[0]["tolerance_us"], &levels[1]["tolerance_us"]), (&500.into(), &50.into()));
    assert_eq!(levels.as_array().unwrap().len(), 2);
    assert_eq!(levels[1]["plain"]["regions"][1]["region"], "shadow_edge");

    // Late by 400 us.
    let late: Vec<_> = events()
        .iter()
        .map(|e| Event::new(e.t + 400, e.x, e.y, if e.p == 1 { Polarity::On } else { Polarity::Off }))
        .collect();
    record(&folder.file("late.h5"), [WIDTH, HEIGHT], "", &late);
    let scored = json(&evis(&folder, "score late.h5 --truth truth.h5 --json"));
    let plain = |level: usize| &scored["score"]["tolerances"][level]["plain"];
    assert_eq!((&plain(0)["f1"], &plain(0)["time_error"]["bias_us"]), (&1.0.into(), &400.0.into()));
    assert_eq!((&plain(1)["f1"], &plain(1)["time_error"]), (&0.0.into(), &serde_json::Value::Null));
}

#[test]
fn a_recording_can_be_the_truth() {
    let folder = Folder::new("score-recording");
    write_recording(&folder.file("a.h5"), false, true);
    record(&folder.file("b.h5"), [WIDTH, HEIGHT], "", &events());
    // b.h5 has one camera, whose name is another: the name is meant for a.h5.
    for line in ["score b.h5 --truth a.h5 --camera left", "score a.h5 --truth a.h5 --camera left"] {
        let scored = json(&evis(&folder, &format!("{line} --json")));
        assert_eq!(scored["score"]["tolerances"][2]["plain"]["f1"], 1.0, "{line}");
    }
    // The other camera is silent.
    let scored = json(&evis(&folder, "score a.h5 --truth b.h5 --camera right --json"));
    assert_eq!((&scored["camera"], &scored["score"]["events"]), (&"right".into(), &0.into()));
    let scored = json(&evis(&folder, "score a.h5 --truth b.h5 --camera left --json"));
    assert_eq!((&scored["camera"], &scored["score"]["count_ratio"]), (&"left".into(), &1.0.into()));
}

#[test]
fn input_that_cannot_be_scored_is_told_why() {
    let folder = Folder::new("score-bad");
    truth(|_| ()).write(&folder.file("truth.h5"), false).unwrap();
    truth(|t| {
        t.events.clear();
        t.event_region.clear();
    })
    .write(&folder.file("silent.h5"), false)
    .unwrap();
    write_recording(&folder.file("a.h5"), false, true);
    record(&folder.file("small.h5"), [8, 4], "", &[]);
    record(&folder.file("other.h5"), [WIDTH, HEIGHT], "[run.sensor]\nthreshold_on = 0.3\n", &events());
    std::fs::write(folder.file("text.h5"), "not HDF5").unwrap();
    for (line, words) in [
        ("score small.h5 --truth truth.h5", ["8x4", "48x32"]),
        ("score other.h5 --truth truth.h5", ["threshold_on = 0.3", "0.2"]),
        ("score a.h5 --truth silent.h5", ["has no events", "200 events"]),
        ("score a.h5 --truth a.h5", ["2 cameras", "left, right"]),
        ("score a.h5 --truth truth.h5 --camera up", ["no camera 'up'", "there is left, right"]),
        ("score a.h5 --truth text.h5", ["text.h5", "HDF5"]),
        ("score text.h5 --truth truth.h5", ["text.h5", "HDF5"]),
        ("score missing.h5 --truth truth.h5", ["missing.h5", "No such file"]),
        ("score a.h5 --truth truth.h5 --tolerance-us 0", ["--tolerance-us", "1 to 1000000"]),
        ("score a.h5 --truth truth.h5 --tolerance-us 1e3", ["--tolerance-us", "whole number"]),
        ("score a.h5", ["--truth", "required"]),
    ] {
        let output = evis(&folder, line);
        assert_eq!(code(&output), 2, "{line}\n{}", stderr(&output));
        for word in words {
            assert!(
                stderr(&output).contains(word),
                "{line}: the message lacks '{word}':\n{}",
                stderr(&output)
            );
        }
    }
}
