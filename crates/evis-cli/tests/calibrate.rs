//! Sensors from recordings, and recordings side by side.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use std::path::Path;

use common::{Folder, code, evis, json, stderr, stdout};
use evis_core::format::hdf5::{RecordingHeader, RecordingWriter};
use evis_core::sensor::Noise;
use evis_core::stats::static_scene;
use evis_core::{CameraInfo, EmulatorConfig, Event, EventEmulator, Frames, SensorConfig};

const SIZE: (u32, u32) = (64, 48);

fn save(path: &Path, events: &[Event], duration_us: i64) {
    let camera = CameraInfo::uncalibrated("camera", SIZE);
    let header = RecordingHeader {
        method: "test".into(),
        duration_us: Some(duration_us),
        ..RecordingHeader::of(vec![camera])
    };
    let mut writer = RecordingWriter::create(path, &header, true).unwrap();
    writer.write_events(0, events).unwrap();
    writer.finish(&format!("{{\"stream_s\": {}}}", duration_us as f64 * 1e-6)).unwrap();
}

fn noise(folder: &Folder, name: &str, noise: Noise, seconds: i64) {
    let sensor = SensorConfig { noise, ..SensorConfig::default() };
    let events = static_scene(&sensor, SIZE, seconds * 1_000_000, 0.2, 3).unwrap();
    save(&folder.file(name), &events, seconds * 1_000_000);
}

#[test]
fn a_still_scene_gives_a_sensor_that_run_by_itself_gives_the_same() {
    let folder = Folder::new("calibrate");
    noise(&folder, "a.h5", Noise { shot_hz: 2.0, on_share: 0.65, ..Noise::default() }, 4);
    let output = evis(&folder, "calibrate a.h5 -o s.toml --base dvxplorer-like");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert!(stdout(&output).contains("not to be had from such a recording"), "{}", stdout(&output));
    let made = SensorConfig::from_toml(&std::fs::read_to_string(folder.file("s.toml")).unwrap()).unwrap();
    assert!((made.noise.shot_hz / 2.0 - 1.0).abs() < 0.05, "{:?}", made.noise);
    assert!((made.noise.on_share - 0.65).abs() < 0.02, "{:?}", made.noise);
    let base = SensorConfig::preset("dvxplorer-like").unwrap();
    assert_eq!(made.threshold_on, base.threshold_on, "what a still scene cannot tell is the base's");

    // What the sensor makes of a still film is like the recording.
    let light = vec![128_u8; (SIZE.0 * SIZE.1 * 5) as usize];
    let mut npy = b"\x93NUMPY\x01\x00".to_vec();
    let header =
        format!("{{'descr': '|u1', 'fortran_order': False, 'shape': (5, {}, {})}}\n", SIZE.1, SIZE.0);
    npy.extend((header.len() as u16).to_le_bytes());
    npy.extend(header.as_bytes());
    npy.extend(light);
    std::fs::write(folder.file("still.npy"), npy).unwrap();
    let output = evis(&folder, "video still.npy -o b.h5 --fps 1 --sensor s.toml --seed 9");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let output = evis(&folder, "compare a.h5 b.h5 -o c.svg --json");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let told = json(&output);
    for (figure, share) in [("cold_rate_hz", 0.05), ("on_share", 0.05), ("fano", 0.1), ("alternation", 0.1)] {
        let of = |side: &str| told[side]["stats"][figure].as_f64().unwrap();
        assert!((of("b") / of("a") - 1.0).abs() < share, "{figure}: {} for {}", of("b"), of("a"));
    }
    assert!(std::fs::read_to_string(folder.file("c.svg")).unwrap().contains("Fano factor"));
    noise(&folder, "other.h5", Noise { shot_hz: 5.0, ..Noise::default() }, 4);
    let told = json(&evis(&folder, "compare a.h5 other.h5 --json"));
    let of = |side: &str| told[side]["stats"]["cold_rate_hz"].as_f64().unwrap();
    assert!(of("b") > 2.0 * of("a"), "canary: another recording has another rate");

    // Where one event makes a pixel hot, nothing is left to count: null, and a note beside the JSON.
    let short = evis(&folder, "compare a.h5 b.h5 --duration 0.03 --json");
    assert!(stderr(&short).contains("note: B: a recording of 0.030 s is too short"), "{}", stderr(&short));
    assert!(json(&short)["a"]["stats"]["on_share"].is_null());

    let table = evis(&folder, "compare a.h5 b.h5 --duration 1");
    assert!(stdout(&table).contains("Fano factor of counts") && stdout(&table).contains("a.h5"));
}

#[test]
fn flicker_gives_thresholds() {
    let folder = Folder::new("flicker");
    let sensor = SensorConfig { threshold_on: 0.12, threshold_off: 0.2, ..SensorConfig::default() };
    let config = EmulatorConfig { width: SIZE.0, height: SIZE.1, sensor, ..EmulatorConfig::default() };
    let mut emulator = EventEmulator::new(config).unwrap();
    let mut events = Vec::new();
    for k in 0..1000 {
        let phase = std::f64::consts::TAU * 5.0 * f64::from(k) * 1e-3;
        let light = vec![(0.4 * (1.0 + 0.5 * phase.sin())) as f32; (SIZE.0 * SIZE.1) as usize];
        events.extend(emulator.push(&Frames::linear(&light), i64::from(k) * 1000).unwrap().remove(0));
    }
    save(&folder.file("f.h5"), &events, 1_000_000);
    let output = evis(&folder, "calibrate f.h5 --stimulus 5,0.5 --json");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let told = json(&output);
    let of = |name: &str| told[name].as_f64().unwrap();
    assert!((of("threshold_on") / 0.12 - 1.0).abs() < 0.04, "{told}");
    assert!((of("threshold_off") / 0.2 - 1.0).abs() < 0.04, "{told}");
    assert!(told["cutoff_hz"].is_null());
}

#[test]
fn what_cannot_be_calibrated_is_told() {
    let folder = Folder::new("calibrate-bad");
    noise(&folder, "a.h5", Noise { shot_hz: 2.0, ..Noise::default() }, 2);
    noise(&folder, "few.h5", Noise { shot_hz: 0.01, ..Noise::default() }, 1);
    std::fs::write(folder.file("text.txt"), "t x y p").unwrap();
    std::fs::write(folder.file("old.toml"), "").unwrap();
    for (line, told) in [
        ("calibrate none.h5", "none.h5"),
        ("calibrate text.txt", "ends with .h5, .hdf5, .npz or .npy"),
        ("calibrate few.h5", "record longer"),
        ("calibrate a.h5 --duration 0.04", "record 0.25 s or more"),
        ("calibrate a.h5 --start 9", "choose an earlier one"),
        ("calibrate a.h5 a.h5", "a still scene is calibrated from one recording"),
        ("calibrate a.h5 --stimulus 5", "HZ,CONTRAST"),
        ("calibrate a.h5 --stimulus 5,2", "contrast"),
        ("calibrate a.h5 --stimulus 5,0.5 --stimulus 9,0.5", "1 recordings and 2 --stimulus"),
        ("calibrate a.h5 --stimulus 5,0.5", "5 Hz"),
        ("calibrate a.h5 --base davis346", "diffusion"),
        ("calibrate a.h5 -o s.txt", ".toml"),
        ("calibrate a.h5 -o old.toml", "exists already"),
        ("calibrate a.h5 --camera left", "left"),
        ("compare a.h5 none.h5", "none.h5"),
        ("compare a.h5 a.h5 -o c.gif", ".png or .svg"),
    ] {
        let output = evis(&folder, line);
        assert_eq!(code(&output), 2, "{line}: {}", stderr(&output));
        assert!(stderr(&output).contains(told), "{line}: {}", stderr(&output));
    }
}
