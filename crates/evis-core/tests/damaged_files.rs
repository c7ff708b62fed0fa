//! Mutated files: no reader panics, and what a reader hands out is what it promises.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;
#[path = "common/promised.rs"]
mod promised;
#[path = "common/watched.rs"]
mod watched;

use std::sync::atomic::Ordering;

use common::damage::{Damage, Folder, replace};
use evis_core::format::EventFile;
use evis_core::format::hdf5::{
    BodyInfo, Recording, RecordingExtras, RecordingHeader, RecordingWriter, StateInfo,
};
use evis_core::{CameraInfo, Event, LabelData, LabelFrame, LabelKind, Polarity, PoseSample};
use promised::check;
use watched::{LARGEST, LIMIT, within_the_limit};

fn events(count: i64) -> Vec<Event> {
    let polarity = |i: i64| if i % 3 == 0 { Polarity::Off } else { Polarity::On };
    (0..count).map(|i| Event::new(i * 37, (i * 7 % 40) as u16, (i * 5 % 30) as u16, polarity(i))).collect()
}

/// An object and a camera, which has no box.
fn bodies() -> Vec<BodyInfo> {
    let body = |name: &str, instance_id, semantic_id, semantic_name: &str, bounds| BodyInfo {
        name: name.into(),
        instance_id,
        semantic_id,
        semantic_name: semantic_name.into(),
        bounds,
    };
    vec![
        body("ball", 1, 7, "toy", [[-0.5, -0.25, -1.0], [0.5, 0.25, 1.0]]),
        body("camera", 0, 0, "", [[f64::NAN; 3]; 2]),
    ]
}

fn recording(path: &std::path::Path) {
    let camera = CameraInfo {
        name: "camera".into(),
        width: 40,
        height: 30,
        fx: 40.0,
        fy: 40.0,
        cx: 20.0,
        cy: 15.0,
        distortion: None,
    };
    let header = RecordingHeader {
        cameras: vec![camera],
        seed: 3,
        method: "native".into(),
        environment: 0,
        config_toml: "[run]\nrate_hz = 1000.0\n".into(),
        duration_us: Some(1_000_000),
        t_offset_us: 0,
        labels: vec![LabelKind::Depth, LabelKind::Cause],
    };
    let extras = RecordingExtras {
        imus: vec!["head".into()],
        bodies: bodies(),
        states: vec![StateInfo { name: "arm".into(), values: vec!["shoulder".into(), "elbow".into()] }],
    };
    let mut writer = RecordingWriter::create_with_extras(path, &header, &extras, true).unwrap();
    let all = events(600);
    writer.write_caused_events(0, &all, &vec![0; all.len()]).unwrap();
    for t_us in [0, 10_000] {
        let data = LabelData::F32((0..1200).map(|i| i as f32).collect());
        writer.write_label(0, &LabelFrame { kind: LabelKind::Depth, t_us, t_other_us: t_us, data }).unwrap();
        let pose = PoseSample { t_us, position: [0.0, 1.0, 2.0], rotation: [0.0, 0.0, 0.0, 1.0] };
        writer.write_pose(0, &pose).unwrap();
    }
    writer.finish("{\"stream_s\": 1.0}").unwrap();
}

/// Reads all that a recording holds.
fn read_recording(path: &std::path::Path) -> Result<(), evis_core::format::FormatError> {
    let recording = Recording::open(path)?;
    recording.is_complete()?;
    recording.report()?;
    for (index, camera) in recording.header().cameras.iter().enumerate() {
        let events = recording.events(index)?;
        check(&EventFile { events, size: (camera.width, camera.height), range: (0, 0) });
        recording.events_between(index, 5_000, 9_000)?;
        recording.causes(index, None)?;
        recording.poses(index)?;
        recording.bodies()?;
        for kind in recording.label_kinds(index)? {
            for k in 0..recording.label_times(index, *kind)?.len() {
                recording.label(index, *kind, k)?;
            }
        }
    }
    Ok(())
}

#[test]
fn a_flipped_bit_changes_nothing_that_a_recording_says_of_itself() {
    let folder = Folder::new("header");
    let path = folder.file("out.h5");
    recording(&path);
    let header = Recording::open(&path).unwrap().header().clone();
    // As text, for NaN equals nothing.
    let listed = format!("{:?}", bodies());
    let bytes = std::fs::read(&path).unwrap();
    let (mut opened, mut refused, mut lists_refused) = (0, 0, 0);
    for at in (0..bytes.len()).step_by(5) {
        let mut mutant = bytes.clone();
        mutant[at] ^= 1 << (at / 5 % 8);
        replace(&path, &mutant);
        match Recording::open(&path) {
            Ok(recording) => {
                opened += 1;
                assert_eq!(recording.header(), &header, "byte {at}");
                match recording.body_infos() {
                    Ok(infos) => assert_eq!(format!("{infos:?}"), listed, "byte {at}"),
                    Err(_) => lists_refused += 1,
                }
                if let Ok(state) = recording.state("arm") {
                    assert_eq!(state.names, ["shoulder", "elbow"], "byte {at}");
                }
                assert!(recording.imus().is_err() || recording.imus().unwrap() == ["head"], "byte {at}");
            }
            Err(_) => refused += 1,
        }
    }
    println!("{opened} opened, {refused} refused; of those opened, {lists_refused} lists of bodies refused");
    assert!(opened > 300 && refused > 300, "{opened} opened, {refused} refused");
    assert!(lists_refused > 100, "{lists_refused} lists of bodies refused");
}

#[test]
fn mutated_recordings_give_an_error_or_events_within_the_limit_of_memory() {
    within_the_limit(|| {
        let folder = Folder::new("recordings");
        let path = folder.file("out.h5");
        recording(&path);
        read_recording(&path).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let mut damage = Damage::new(11, &bytes, &[]);
        let (mut read, mut refused) = (0, 0);
        let mut try_it = |mutant: &[u8], what: &dyn Fn() -> String| {
            replace(&path, mutant);
            LARGEST.store(0, Ordering::Relaxed);
            match read_recording(&path) {
                Ok(()) => read += 1,
                Err(_) => refused += 1,
            }
            let largest = LARGEST.load(Ordering::Relaxed);
            assert!(largest as u64 <= LIMIT, "{} asks for a block of {largest} bytes", what());
        };
        for number in 0..600 {
            let mutant = damage.next();
            try_it(&mutant, &|| format!("mutant {number}"));
        }
        // Every byte of the headers, which are not packed, as the largest and as another number.
        for at in (0..bytes.len()).step_by(9) {
            let mut mutant = bytes.clone();
            mutant[at] = if at % 2 == 0 { 0xff } else { mutant[at] ^ 0x40 };
            try_it(&mutant, &|| format!("the file with byte {at} changed"));
        }
        assert!(read > 100 && refused > 300, "{read} read, {refused} refused");
    });
}
