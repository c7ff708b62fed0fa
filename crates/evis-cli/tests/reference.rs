//! The engine and the oracle bring the same picture to the same brightness.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use common::{Folder, code, evis, stderr};
use evis_core::Truth;
use evis_core::format::hdf5::Recording;

#[test]
fn run_and_truth_find_the_same_reference_luminance() {
    let folder = Folder::new("reference");
    let done = |line: &str| {
        let output = evis(&folder, line);
        assert_eq!(code(&output), 0, "{}", stderr(&output));
    };
    done("run desk --size 160x120 --duration 0.002 --samples 16 -o run.h5");
    let recording = Recording::open(&folder.file("run.h5")).unwrap();
    let settings: toml::Table = recording.header().config_toml.parse().unwrap();
    let engine = settings["run"]["reference_luminance"].as_float().unwrap();
    let apart = |size: &str| {
        let file = format!("{size}.h5");
        done(&format!("truth desk --size {size} --duration 0.001 --truth-pixels 1 --cache cache -o {file}"));
        engine / Truth::read(&folder.file(&file)).unwrap().reference_luminance - 1.0
    };
    let same = apart("160x120");
    assert!(same.abs() < 1e-3, "the engine says {engine}, the oracle differs by {same}");
    // Less of the scene has another mean.
    let canary = apart("64x120");
    assert!(canary.abs() > 1e-3, "canary: {canary}");
}
