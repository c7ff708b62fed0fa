//! A recording goes into a ROS 2 bag and comes back, value for value; both ways can be stopped.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::fs;
use std::path::{Path, PathBuf};

use evis_core::format::hdf5::{Recording, RecordingExtras, RecordingHeader, RecordingWriter};
use evis_core::{
    CameraInfo, Event, ImuSample, LabelData, LabelFrame, LabelKind, LensDistortion, Polarity, PoseSample,
};
use evis_format::{
    Format, Packet, ReadOptions, Trigger, WriteOptions, create, export_dsec, export_mcap, import_mcap, open,
};

const SIZE: (u32, u32) = (12, 8);

/// A folder that goes with the test.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("evis-bags-{name}-{}", std::process::id()));
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn file(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// What lies in it, hidden files too.
    fn names(&self) -> Vec<String> {
        let entries = fs::read_dir(&self.0).unwrap();
        let mut names: Vec<_> =
            entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn camera(name: &str, distortion: Option<LensDistortion>) -> CameraInfo {
    let (width, height) = SIZE;
    CameraInfo { name: name.into(), width, height, fx: 9.5, fy: 9.25, cx: 6.125, cy: 4.0, distortion }
}

fn cameras() -> Vec<CameraInfo> {
    let radtan = [0.1, -0.02, 1e-3, 2e-3, 0.3, 0.0, 0.0, 0.0];
    let lens = |model: &str, coefficients: &[f64]| {
        Some(LensDistortion { model: model.into(), coefficients: coefficients.into() })
    };
    vec![
        camera("left", None),
        camera("right", lens("radtan", &radtan)),
        camera("wide", lens("fisheye", &[0.1, -0.2, 0.0, 0.0])),
    ]
}

fn events(camera: i64) -> Vec<Event> {
    let polarity = |i: i64| if (i + camera) % 3 == 0 { Polarity::Off } else { Polarity::On };
    (0..3000).map(|i| Event::new(i * 37, (i % 12) as u16, ((i + camera) % 8) as u16, polarity(i))).collect()
}

fn label(kind: LabelKind, index: i64) -> LabelFrame {
    let count = (SIZE.0 * SIZE.1) as usize * kind.channels();
    let value = |i: usize| i as f32 * 0.25 - index as f32;
    let data = match kind {
        LabelKind::FlowForwardValid | LabelKind::FlowBackwardValid => {
            LabelData::U8((0..count).map(|i| (i % 2) as u8).collect())
        }
        LabelKind::Instance | LabelKind::Semantic => {
            LabelData::U32((0..count).map(|i| u32::MAX - i as u32).collect())
        }
        LabelKind::Depth => {
            LabelData::F32((0..count).map(|i| if i == 3 { f32::INFINITY } else { value(i) }).collect())
        }
        _ => LabelData::F32((0..count).map(value).collect()),
    };
    let t_us = index * 20_000;
    let t_other_us = match kind {
        LabelKind::FlowForward | LabelKind::FlowForwardValid => t_us + 20_000,
        LabelKind::FlowBackward | LabelKind::FlowBackwardValid => (t_us - 20_000).max(0),
        _ => t_us,
    };
    LabelFrame { kind, t_us, t_other_us, data }
}

fn pose(index: i64) -> PoseSample {
    let angle = index as f64 * 0.3;
    let rotation = [0.6 * angle.sin(), 0.0, -0.8 * angle.sin(), angle.cos()];
    PoseSample { t_us: index * 20_000, position: [angle, -0.1, 1.0 / 3.0], rotation }
}

fn samples() -> Vec<ImuSample> {
    let sample = |i: i64| ImuSample {
        t_us: i * 5000,
        accelerometer: [i as f64 / 3.0, -9.81, 0.1],
        gyroscope: [0.2, i as f64 / 7.0, -1.0],
    };
    (0..20).map(sample).collect()
}

fn write_recording(path: &Path, cameras: Vec<CameraInfo>) -> Recording {
    let header = RecordingHeader {
        seed: 7,
        method: "native".into(),
        duration_us: Some(111_000),
        labels: LabelKind::ALL.to_vec(),
        ..RecordingHeader::of(cameras)
    };
    let extras = RecordingExtras { imus: vec!["body".into()], ..RecordingExtras::default() };
    let mut writer = RecordingWriter::create_with_extras(path, &header, &extras, true).unwrap();
    for camera in 0..header.cameras.len() {
        writer.write_events(camera, &events(camera as i64)).unwrap();
        for index in 0..5 {
            writer.write_pose(camera, &pose(index)).unwrap();
            for kind in LabelKind::ALL {
                writer.write_label(camera, &label(kind, index)).unwrap();
            }
        }
    }
    writer.write_imu(0, &samples()).unwrap();
    writer.finish("{}").unwrap();
    Recording::open(path).unwrap()
}

#[test]
fn a_recording_comes_back_from_a_bag_value_for_value() {
    let folder = Folder::new("back");
    let recording = write_recording(&folder.file("a.h5"), cameras());
    let bag = folder.file("a.mcap");
    let export = export_mcap(&recording, &bag, false, |_| true).unwrap().unwrap();
    assert_eq!((export.images, export.poses, export.imu), (150, 15, 20));
    let mut parts = Vec::new();
    let import = import_mcap(&bag, &folder.file("b.h5"), false, |part| {
        parts.push(part);
        true
    });
    let import = import.unwrap().unwrap();
    assert_eq!((import.events, import.images, import.poses, import.imu), (9000, 150, 15, 20));
    assert_eq!((&import.cameras, &import.left_out), (&export.cameras, &Vec::new()));
    assert!(parts.is_sorted() && parts.last().is_some_and(|part| *part > 0.9), "{parts:?}");

    let back = Recording::open(&folder.file("b.h5")).unwrap();
    assert!(back.is_complete().unwrap());
    assert_eq!(back.header().cameras, cameras());
    assert_eq!(back.imus().unwrap(), ["body"]);
    assert_eq!(back.imu("body").unwrap(), samples());
    for camera in 0..3 {
        assert_eq!(back.events(camera).unwrap(), events(camera as i64));
        assert_eq!(back.label_kinds(camera).unwrap(), LabelKind::ALL);
        for kind in LabelKind::ALL {
            for index in 0..5 {
                assert_eq!(
                    back.label(camera, kind, index).unwrap(),
                    label(kind, index as i64),
                    "{kind:?} {index}"
                );
            }
        }
        let poses = back.poses(camera).unwrap();
        assert_eq!(poses.len(), 5);
        for (index, got) in poses.iter().enumerate() {
            let want = pose(index as i64);
            assert_eq!((got.t_us, got.position), (want.t_us, want.position));
            // Two products of quaternions round.
            let error = got.rotation.iter().zip(&want.rotation).map(|(a, b)| (a - b).abs());
            assert!(error.fold(0.0, f64::max) < 1e-15, "{got:?} {want:?}");
        }
    }
    assert_ne!(back.label(0, LabelKind::Normal, 1).unwrap(), label(LabelKind::Normal, 2), "canary");
}

#[test]
fn a_lens_that_cannot_be_is_left_out_and_said() {
    let folder = Folder::new("lens");
    let k1 = 0.271_828_18_f64;
    let lens = LensDistortion { model: "fisheye".into(), coefficients: vec![k1, 0.0, 0.0, 0.0] };
    let recording = write_recording(&folder.file("a.h5"), vec![camera("wide", Some(lens))]);
    let bag = folder.file("a.mcap");
    export_mcap(&recording, &bag, false, |_| true).unwrap().unwrap();
    let mut bytes = fs::read(&bag).unwrap();
    let places: Vec<usize> =
        (0..bytes.len() - 8).filter(|at| bytes[*at..at + 8] == k1.to_le_bytes()).collect();
    assert!(!places.is_empty());
    for at in places {
        bytes[at..at + 8].copy_from_slice(&f64::NAN.to_le_bytes());
    }
    fs::write(&bag, bytes).unwrap();
    let import = import_mcap(&bag, &folder.file("b.h5"), false, |_| true).unwrap().unwrap();
    assert!(import.left_out.iter().any(|what| what.contains("NaN")), "{:?}", import.left_out);
    let back = Recording::open(&folder.file("b.h5")).unwrap();
    assert_eq!(back.header().cameras[0].distortion, None);
    assert_eq!(back.events(0).unwrap(), events(0));

    // And nothing is written that could not be read.
    let mut broken = cameras();
    broken[1].distortion.as_mut().unwrap().coefficients[2] = f64::INFINITY;
    let refused = RecordingWriter::create(&folder.file("c.h5"), &RecordingHeader::of(broken), false);
    let refused = refused.err().unwrap().to_string();
    assert!(refused.contains("right") && refused.contains("finite"), "{refused}");
    assert!(!folder.file("c.h5").exists());
}

#[test]
fn work_that_is_stopped_leaves_what_was_there() {
    let folder = Folder::new("stopped");
    let recording = write_recording(&folder.file("a.h5"), cameras()[..2].to_vec());
    let bag = folder.file("a.mcap");
    export_mcap(&recording, &bag, false, |_| true).unwrap().unwrap();
    fs::write(folder.file("old.h5"), "old").unwrap();
    let before = folder.names();
    // At the start, in the middle, and near the end.
    for most in [0.0, 0.3, 0.9] {
        let go_on = |part: f64| part < most;
        assert_eq!(export_mcap(&recording, &folder.file("b.mcap"), false, go_on).unwrap(), None);
        assert_eq!(export_mcap(&recording, &bag, true, go_on).unwrap(), None);
        assert_eq!(export_dsec(&recording, &folder.file("dsec"), false, go_on).unwrap(), None);
        assert_eq!(import_mcap(&bag, &folder.file("b.h5"), false, go_on).unwrap(), None);
        assert_eq!(import_mcap(&bag, &folder.file("old.h5"), true, go_on).unwrap(), None);
        assert_eq!(folder.names(), before);
    }
    assert_eq!(fs::read(folder.file("old.h5")).unwrap(), b"old");
    assert!(import_mcap(&bag, &folder.file("old.h5"), false, |_| true).is_err(), "it exists");
    // What goes on has its files; files of others in an old folder stay.
    let dsec = folder.file("dsec");
    fs::create_dir_all(dsec.join("events")).unwrap();
    fs::write(dsec.join("events/notes.txt"), "mine").unwrap();
    assert!(export_dsec(&recording, &dsec, false, |_| true).is_err(), "it exists");
    let export = export_dsec(&recording, &dsec, true, |_| true).unwrap().unwrap();
    assert_eq!((export.events, export.flows), (6000, 5));
    for name in
        ["events/left/events.h5", "events/right/events.h5", "flow/forward/000004.png", "events/notes.txt"]
    {
        assert!(dsec.join(name).is_file(), "{name}");
    }
    assert!(folder.names().iter().all(|name| !name.contains("draft")), "{:?}", folder.names());
}

#[test]
fn damaged_bags_are_refused_with_the_byte_and_leave_nothing() {
    let folder = Folder::new("damaged");
    let recording = write_recording(&folder.file("a.h5"), cameras());
    let bag = folder.file("a.mcap");
    export_mcap(&recording, &bag, false, |_| true).unwrap().unwrap();
    let whole = fs::read(&bag).unwrap();
    let find = |text: &[u8]| whole.windows(text.len()).position(|bytes| bytes == text).unwrap();
    let error = |bytes: &[u8]| {
        fs::write(folder.file("bad.mcap"), bytes).unwrap();
        let result = import_mcap(&folder.file("bad.mcap"), &folder.file("out.h5"), true, |_| true);
        result.map(|import| import.unwrap().left_out).map_err(|error| error.to_string())
    };
    assert_eq!(error(&whole), Ok(Vec::new()));
    fs::remove_file(folder.file("out.h5")).unwrap();
    let cut = error(&whole[..whole.len() / 2]).unwrap_err();
    assert!(cut.contains("at byte ") && cut.contains("bad.mcap"), "{cut}");
    // An encoding of events that nobody reads, and an image that says another width.
    let mut other = whole.clone();
    other[find(b"evt3\0") + 3] = b'9';
    let other = error(&other).unwrap_err();
    assert!(other.contains("'evt9'") && other.contains("at byte "), "{other}");
    let mut wide = whole.clone();
    wide[find(b"32FC1\0") - 8] = 13;
    let wide = error(&wide);
    assert!(
        wide.as_ref().is_ok_and(|left_out| left_out[0].contains("/left/depth (images of several sizes")),
        "{wide:?}"
    );
    fs::remove_file(folder.file("out.h5")).unwrap();
    assert!(error(b"\x89MCAP0\r\n").unwrap_err().contains("at byte 8"));
    assert!(folder.names().iter().all(|name| !name.contains("out.h5")), "{:?}", folder.names());
    // Triggers have no place in a recording.
    let path = folder.file("t.mcap");
    let mut writer = create(&path, Format::Mcap, &WriteOptions { size: SIZE, overwrite: true }).unwrap();
    let packet = Packet { events: events(0), triggers: vec![Trigger::new(5, 0, true)], ..Packet::default() };
    writer.write(&packet).unwrap();
    writer.finish().unwrap();
    let told = import_mcap(&path, &folder.file("out.h5"), true, |_| true).unwrap_err().to_string();
    assert!(told.contains("`events_only`"), "{told}");
    // The events of a bag with all that can be read as before.
    let options = ReadOptions { camera: Some("/right/events".into()), size: None };
    let mut reader = open(&bag, &options).unwrap();
    assert!(reader.info().properties.iter().any(|(_, topic)| topic.starts_with("/right/depth (sensor_msgs")));
    let (mut all, mut packet) = (Vec::new(), Packet::default());
    while reader.read_packet(&mut packet).unwrap() {
        assert!(packet.frames.is_empty() && packet.imu.is_empty());
        all.append(&mut packet.events);
    }
    assert_eq!(all, events(1));
}
