//! Truth as a file: what is written comes back, it is also a recording, and what is wrong is refused with a reason.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::fs;
use std::panic::catch_unwind;
use std::path::{Path, PathBuf};

use evis_core::format::FormatError;
use evis_core::format::hdf5::{Recording, RecordingHeader, RecordingWriter, repair, stored_sensor};
use evis_core::{CameraInfo, Event, Polarity, Region, RegionSpan, SensorConfig, Truth};

/// A folder that goes away with the test.
struct Folder(PathBuf);

impl Folder {
    fn new(test: &str) -> Self {
        let path = std::env::temp_dir().join(format!("evis_truth_{test}_{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn file(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn camera() -> CameraInfo {
    CameraInfo {
        name: "left".into(),
        width: 40,
        height: 30,
        fx: 50.5,
        fy: 51.0,
        cx: 20.0,
        cy: 15.0,
        distortion: None,
    }
}

fn sensor() -> SensorConfig {
    SensorConfig { threshold_on: 0.21, threshold_off: 0.17, log_eps: 1e-5, ..SensorConfig::default() }
}

/// Known at every third pixel, with everything in it.
fn whole() -> Truth {
    let pixels: Vec<[u16; 2]> =
        (0..30).flat_map(|y| (0..40).map(move |x| [x, y])).filter(|[x, y]| (x + y) % 3 == 0).collect();
    let events: Vec<Event> = (0..5000_usize)
        .map(|k| {
            let [x, y] = pixels[k * 7 % pixels.len()];
            let polarity = if k % 5 < 2 { Polarity::On } else { Polarity::Off };
            Event::new(k as i64 * 97, x, y, polarity)
        })
        .collect();
    let region = |k: usize| Region::ALL[k % 4];
    let span = |t_us, k| RegionSpan { t_us, region: region(k) };
    Truth {
        camera: camera(),
        sensor: sensor(),
        reference_luminance: 0.4375,
        duration_us: 600_000,
        speed: (0..events.len()).map(|k| k as f32 * 0.25).collect(),
        event_region: (0..events.len()).map(region).collect(),
        // Pixels with one span and with two, by turns.
        span_start: (0..=pixels.len()).map(|i| (i + i / 2) as u32).collect(),
        spans: (0..pixels.len())
            .flat_map(|i| [span(0, i), span(300_000 + i as i64, i + 1)].into_iter().take(1 + i % 2))
            .collect(),
        pixels,
        events,
        provenance: "{\"scene\": \"spinner\", \"größe\": 1}".into(),
    }
}

#[test]
fn a_truth_comes_back_as_it_was() {
    let folder = Folder::new("round");
    let path = folder.file("truth.h5");
    let truth = whole();
    truth.write(&path, false).unwrap();
    assert!(Truth::read(&path).unwrap() == truth);
    assert!(Truth::load(&path, None).unwrap() == truth);
    assert!(Truth::load(&path, Some("left")).unwrap() == truth);
    let mut other = truth.clone();
    other.spans[2].t_us += 1;
    other.write(&path, true).unwrap();
    assert!(Truth::read(&path).unwrap() != truth, "canary: the comparison must see a difference");

    let error = truth.write(&path, false).unwrap_err();
    assert!(matches!(error, FormatError::Exists { .. }), "{error}");
    let error = Truth::load(&path, Some("right")).unwrap_err().to_string();
    assert!(error.contains("'right'") && error.contains("left"), "{error}");
}

#[test]
fn a_truth_without_extras_comes_back_too() {
    let folder = Folder::new("bare");
    let path = folder.file("truth.h5");
    let unknown = SensorConfig { threshold_on: f32::NAN, ..sensor() };
    let truth = Truth::from_events(Vec::new(), camera(), unknown, f64::NAN, 1);
    truth.write(&path, false).unwrap();
    let back = Truth::read(&path).unwrap();
    assert!(back.sensor.threshold_on.is_nan() && back.reference_luminance.is_nan());
    assert_eq!((back.sensor.threshold_off, back.pixels.len(), back.duration_us), (0.17, 1200, 1));
    assert!(back.events.is_empty() && back.speed.is_empty() && back.spans.is_empty());

    let mut nowhere = whole();
    nowhere.pixels.clear();
    nowhere.events.clear();
    nowhere.speed.clear();
    nowhere.event_region.clear();
    nowhere.span_start.clear();
    nowhere.spans.clear();
    nowhere.write(&path, true).unwrap();
    assert!(Truth::read(&path).unwrap() == nowhere);
}

#[test]
fn a_truth_file_is_a_recording() {
    let folder = Folder::new("recording");
    let path = folder.file("truth.h5");
    let truth = whole();
    truth.write(&path, false).unwrap();
    let recording = Recording::open(&path).unwrap();
    assert!(recording.is_complete().unwrap());
    assert_eq!(
        (recording.header().cameras.as_slice(), &*recording.header().method),
        (&[camera()][..], "truth")
    );
    assert!(recording.events(0).unwrap() == truth.events);
    assert_eq!(recording.events_between(0, 970, 1067).unwrap(), truth.events[10..11]);
    assert_eq!(stored_sensor(&recording.header().config_toml, "left"), (sensor(), 0.4375));
    assert!(repair(&path).unwrap().nothing_to_do());
    // Taken as a plain recording, it knows every pixel and nothing more.
    let plain = Truth::from_recording(&recording, 0).unwrap();
    assert_eq!((plain.pixels.len(), plain.duration_us, plain.speed.len()), (1200, 600_000, 0));
    assert_eq!((plain.sensor, plain.reference_luminance), (sensor(), 0.4375));
}

/// A recording of two cameras; the first one's last event is at 9999 µs.
fn record(path: &Path, config_toml: &str, report: Option<&str>) -> Recording {
    let right = CameraInfo { name: "right".into(), ..camera() };
    let header = RecordingHeader {
        method: "native".into(),
        config_toml: config_toml.into(),
        ..RecordingHeader::of(vec![camera(), right])
    };
    let mut writer = RecordingWriter::create(path, &header, true).unwrap();
    let events = [Event::new(3, 1, 2, Polarity::On), Event::new(9999, 39, 29, Polarity::Off)];
    writer.write_events(0, &events).unwrap();
    match report {
        Some(report) => writer.finish(report).unwrap(),
        None => drop(writer),
    }
    Recording::open(path).unwrap()
}

#[test]
fn a_plain_recording_can_be_truth() {
    let folder = Folder::new("plain");
    let path = folder.file("plain.h5");
    let config = "scene = \"x\"\n[run]\nreference_luminance = 2.5\n[run.sensor]\nthreshold_on = 0.3\nnew_setting = 1\n";
    let recording = record(&path, config, Some("{\"stream_s\": 0.25}"));
    let truth = Truth::from_recording(&recording, 0).unwrap();
    assert_eq!((truth.duration_us, truth.events.len(), truth.camera.name.as_str()), (250_000, 2, "left"));
    assert_eq!((truth.sensor.threshold_on, truth.reference_luminance), (0.3, 2.5));
    assert!(truth.sensor.threshold_off.is_nan() && truth.sensor.log_eps.is_nan());
    assert!(Truth::load(&path, Some("right")).unwrap().events.is_empty());

    let of_its_own =
        "[run.sensor]\nthreshold_on = 0.3\n[run.sensors.right]\nthreshold_on = 0.4\nlog_eps = 0.5\n";
    let recording = record(&path, of_its_own, None);
    let sensor = |camera| Truth::from_recording(&recording, camera).unwrap().sensor;
    assert_eq!((sensor(0).threshold_on, sensor(1).threshold_on, sensor(1).log_eps), (0.3, 0.4, 0.5));
    assert!(sensor(0).log_eps.is_nan(), "not what another camera's sensor has");

    let error = Truth::load(&path, None).unwrap_err().to_string();
    assert!(error.contains("2 cameras") && error.contains("left, right"), "{error}");
    assert!(Truth::from_recording(&recording, 2).is_err());
    let error = Truth::read(&path).unwrap_err().to_string();
    assert!(error.contains("no group truth"), "{error}");

    for (config, report) in
        [("", None), ("not toml [", Some("{}")), ("run = 3", Some("{\"stream_s\": \"x\"}"))]
    {
        let truth = Truth::from_recording(&record(&path, config, report), 0).unwrap();
        assert_eq!(truth.duration_us, 10_000);
        assert!(truth.sensor.threshold_on.is_nan() && truth.reference_luminance.is_nan());
    }
}

#[test]
fn a_truth_that_contradicts_itself_is_not_written() {
    let folder = Folder::new("refused");
    let path = folder.file("truth.h5");
    let with = |change: fn(&mut Truth)| {
        let mut truth = whole();
        change(&mut truth);
        truth
    };
    for (bad, words) in [
        (with(|t| t.duration_us = 1000), "outside its interval"),
        (with(|t| t.speed.truncate(4)), "4 speeds"),
        (with(|t| t.pixels.swap(0, 1)), "order"),
        (with(|t| t.camera.name = "truth".into()), "cannot name a camera"),
        (with(|t| t.duration_us = i64::MAX), "duration"),
    ] {
        let error = bad.write(&path, false).unwrap_err();
        assert!(matches!(error, FormatError::Invalid { .. }) && error.to_string().contains(words), "{error}");
        assert!(!path.exists());
    }
}

#[test]
fn a_damaged_truth_gives_an_error_and_no_panic() {
    let folder = Folder::new("damaged");
    let (good, path) = (folder.file("good.h5"), folder.file("bad.h5"));
    let truth = whole();
    truth.write(&good, false).unwrap();
    let bytes = fs::read(&good).unwrap();
    let step = bytes.len() / 60;
    for length in (0..bytes.len()).step_by(step) {
        fs::write(&path, &bytes[..length]).unwrap();
        assert!(catch_unwind(|| Truth::load(&path, None)).expect("no panic").is_err(), "{length} bytes");
    }
    let mut state = 11_u64;
    let mut noticed = 0;
    for _ in 0..200 {
        let mut bad = bytes.clone();
        for _ in 0..3 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let at = (state >> 33) as usize % bad.len();
            bad[at] ^= 1 << (state >> 60 & 7);
        }
        fs::write(&path, &bad).unwrap();
        let read = catch_unwind(|| Truth::load(&path, None)).expect("no panic");
        noticed += usize::from(!read.is_ok_and(|t| t == truth));
    }
    assert!(noticed > 50, "only {noticed} of 200 damaged files were noticed");
}
