//! What every test of the command needs: the program, a folder of its own, and a small recording.
#![allow(dead_code, clippy::unwrap_used, reason = "each test file uses its part of these helpers")]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use evis_core::format::hdf5::{RecordingExtras, RecordingHeader, RecordingWriter};
use evis_core::{CameraInfo, Event, ImuSample, LabelData, LabelFrame, LabelKind, Polarity, PoseSample};

/// A folder that goes with the test.
pub struct Folder(PathBuf);

impl Folder {
    pub fn new(test: &str) -> Self {
        let path = std::env::temp_dir().join(format!("evis-cli-{}-{test}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub fn path(&self) -> &Path {
        &self.0
    }

    pub fn file(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// Names of everything in it, sorted.
    pub fn names(&self) -> Vec<String> {
        let mut names: Vec<_> = std::fs::read_dir(&self.0)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// The program, run in `folder` (relative paths are looked up there).
pub fn program(folder: &Folder) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_evis-rs"));
    command.current_dir(folder.path());
    command
}

/// Runs `line`, split at spaces, in `folder`.
pub fn evis(folder: &Folder, line: &str) -> Output {
    program(folder).args(line.split_whitespace()).output().unwrap()
}

pub fn code(output: &Output) -> i32 {
    output.status.code().unwrap_or(-1)
}

pub fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

pub fn json(output: &Output) -> serde_json::Value {
    serde_json::from_slice(&output.stdout).unwrap()
}

pub const WIDTH: u32 = 48;
pub const HEIGHT: u32 = 32;
pub const ON_EVENTS: usize = 150;
pub const OFF_EVENTS: usize = 50;

/// 200 ms of a column of ON events that runs right, followed by a column of OFF events every fourth step.
pub fn events() -> Vec<Event> {
    (0..200_u16)
        .map(|k| {
            let polarity = if k % 4 == 3 { Polarity::Off } else { Polarity::On };
            Event::new(i64::from(k) * 1000, (k / 5) % WIDTH as u16, k % HEIGHT as u16, polarity)
        })
        .collect()
}

fn camera(name: &str) -> CameraInfo {
    CameraInfo {
        name: name.into(),
        width: WIDTH,
        height: HEIGHT,
        fx: 40.0,
        fy: 40.0,
        cx: f64::from(WIDTH) / 2.0,
        cy: f64::from(HEIGHT) / 2.0,
        distortion: None,
    }
}

/// Writes a recording of two cameras, `left` with events, poses and (where asked for) HDR frames, `right` silent.
pub fn write_recording(path: &Path, hdr: bool, finish: bool) {
    let header = RecordingHeader {
        cameras: vec![camera("left"), camera("right")],
        seed: 7,
        method: "native".into(),
        environment: 0,
        config_toml: "scene = \"test\"\n[run]\nreference_luminance = 1.0\n".into(),
        duration_us: Some(200_000),
        t_offset_us: 0,
        labels: if hdr { vec![LabelKind::Hdr] } else { vec![] },
    };
    let mut writer = RecordingWriter::create(path, &header, false).unwrap();
    writer.write_events(0, &events()).unwrap();
    for k in 0..4_i64 {
        let t_us = k * 50_000;
        let pose = PoseSample { t_us, position: [k as f64, 0.0, 0.0], rotation: [0.0, 0.0, 0.0, 1.0] };
        for index in [0, 1] {
            writer.write_pose(index, &pose).unwrap();
            if hdr {
                let level = 0.1 * (k + 1) as f32;
                let data = LabelData::F32(vec![level; (WIDTH * HEIGHT * 3) as usize]);
                let frame = LabelFrame { kind: LabelKind::Hdr, t_us, t_other_us: t_us, data };
                writer.write_label(index, &frame).unwrap();
            }
        }
    }
    if finish {
        writer.finish("{\"stream_s\": 0.2}").unwrap();
    } else {
        // What a kill would leave: everything flushed, nothing closed. The writer holds a lock on its own
        // file as long as this process lives, hence the copy.
        writer.flush().unwrap();
        let copy = path.with_extension("copy");
        std::fs::copy(path, &copy).unwrap();
        drop(writer);
        std::fs::rename(&copy, path).unwrap();
    }
}

/// A recording of 300 000 events of a camera named left, which fill many pages.
pub fn write_many_events(path: &Path) {
    let header =
        RecordingHeader { seed: 7, method: "native".into(), ..RecordingHeader::of(vec![camera("left")]) };
    let mut state = 1_u64;
    let mut random = |below: u64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % below
    };
    let mut event = |k: i64| {
        let (x, y) = (random(u64::from(WIDTH)) as u16, random(u64::from(HEIGHT)) as u16);
        Event::new(50 * k + random(50) as i64, x, y, Polarity::On)
    };
    let events: Vec<Event> = (0..300_000).map(&mut event).collect();
    let mut writer = RecordingWriter::create(path, &header, false).unwrap();
    writer.write_events(0, &events).unwrap();
    writer.finish("{}").unwrap();
}

/// A recording of 100 events of a camera named left, and 20 000 samples of an inertial unit named head, which fill many pages.
pub fn write_inertial_samples(path: &Path) {
    let header = RecordingHeader { method: "native".into(), ..RecordingHeader::of(vec![camera("left")]) };
    let extras = RecordingExtras { imus: vec!["head".into()], ..RecordingExtras::default() };
    let events: Vec<Event> = (0..100).map(|k| Event::new(50 * k, 1, 2, Polarity::On)).collect();
    let sample = |k: i64| ImuSample {
        t_us: 1000 * k,
        accelerometer: [0.1, 0.7, 0.3].map(|f| (f * k as f64).sin()),
        gyroscope: [0.2, 0.9, 0.4].map(|f| (f * k as f64).cos()),
    };
    let mut writer = RecordingWriter::create_with_extras(path, &header, &extras, false).unwrap();
    writer.write_events(0, &events).unwrap();
    writer.write_imu(0, &(0..20_000).map(sample).collect::<Vec<_>>()).unwrap();
    writer.finish("{}").unwrap();
}

/// Whether a test that needs a device may skip: only where no one insists on one.
pub fn no_device(folder: &Folder) -> bool {
    let listed = json(&evis(folder, "devices --json"));
    let none = listed.as_array().is_none_or(Vec::is_empty);
    assert!(
        !(none && std::env::var("EVIS_REQUIRE_GPU").is_ok_and(|v| v == "1")),
        "EVIS_REQUIRE_GPU=1, and there is no device; install libvulkan1 and mesa-vulkan-drivers"
    );
    if none {
        eprintln!("skipped: no device");
    }
    none
}
