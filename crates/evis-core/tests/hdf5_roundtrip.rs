//! Recordings as files: what is written comes back, and what is wrong is refused with a reason.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::fs;
use std::panic::catch_unwind;
use std::path::{Path, PathBuf};

use evis_core::event::slice_time;
use evis_core::format::FormatError;
use evis_core::format::hdf5::{
    self, BodyInfo, Recording, RecordingExtras, RecordingHeader, RecordingWriter, StateInfo, repair,
};
use evis_core::{
    CameraInfo, Event, ImuSample, LabelData, LabelFrame, LabelKind, LensDistortion, Polarity, PoseSample,
};

/// A folder that goes away with the test.
struct Folder(PathBuf);

impl Folder {
    fn new(test: &str) -> Self {
        let path = std::env::temp_dir().join(format!("evis_hdf5_{test}_{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn file(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    fn names(&self) -> Vec<String> {
        fs::read_dir(&self.0).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn camera(name: &str, width: u32, height: u32) -> CameraInfo {
    CameraInfo { name: name.into(), width, height, fx: 50.5, fy: 51.0, cx: 8.25, cy: 4.0, distortion: None }
}

fn header(cameras: Vec<CameraInfo>) -> RecordingHeader {
    RecordingHeader {
        cameras,
        seed: u64::MAX - 3,
        method: "native".into(),
        environment: 5,
        config_toml: "# größe\nrate_hz = 1000.0\n".into(),
        duration_us: Some(10_000_000),
        t_offset_us: -77,
        labels: Vec::new(),
    }
}

fn random(state: &mut u64) -> u64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    *state >> 33
}

/// Sorted events with ties, bursts and silences.
fn events(count: usize, width: u64, height: u64, seed: u64) -> Vec<Event> {
    let mut state = seed;
    let mut t = 0;
    let mut stream = Vec::new();
    for _ in 0..count {
        t += match random(&mut state) % 100 {
            0 => 3_000 + random(&mut state) as i64 % 9_000,
            1..40 => random(&mut state) as i64 % 30,
            _ => 0,
        };
        let polarity = if random(&mut state).is_multiple_of(2) { Polarity::On } else { Polarity::Off };
        let (x, y) = (random(&mut state) % width, random(&mut state) % height);
        stream.push(Event::new(t, x as u16, y as u16, polarity));
    }
    stream
}

fn label(kind: LabelKind, t_us: i64, pixels: usize) -> LabelFrame {
    let n = pixels * kind.channels();
    let data = match kind {
        LabelKind::Instance | LabelKind::Semantic => {
            LabelData::U32((0..n).map(|i| i as u32 * 70_001 + t_us as u32).collect())
        }
        LabelKind::FlowForwardValid | LabelKind::FlowBackwardValid => {
            LabelData::U8((0..n).map(|i| (i % 2) as u8).collect())
        }
        LabelKind::Depth => LabelData::F32(
            (0..n).map(|i| if i % 5 == 0 { f32::INFINITY } else { t_us as f32 + i as f32 / 7.0 }).collect(),
        ),
        _ => LabelData::F32((0..n).map(|i| t_us as f32 - i as f32 * 0.125).collect()),
    };
    let flow = kind.name().starts_with("flow");
    LabelFrame { kind, t_us, t_other_us: if flow { t_us + 20_000 } else { t_us }, data }
}

/// `ms_to_idx` by its definition.
fn index_of(events: &[Event]) -> Vec<u64> {
    let last = events.last().map_or(-1, |e| e.t / 1000);
    (0..=last).map(|ms| events.partition_point(|e| e.t < ms * 1000) as u64).collect()
}

fn stored_index(path: &Path, camera: &str) -> Vec<u64> {
    let file = rust_hdf5::H5File::open(path).unwrap();
    file.dataset(&format!("{camera}/ms_to_idx")).unwrap().read_raw::<u64>().unwrap()
}

#[test]
fn two_cameras_with_every_label_come_back_as_written() {
    let folder = Folder::new("roundtrip");
    let path = folder.file("out.h5");
    let mut wanted = header(vec![camera("left", 16, 8), camera("right eye", 7, 5)]);
    wanted.labels = LabelKind::ALL.to_vec();
    let streams = [events(200_000, 16, 8, 1), events(1_000, 7, 5, 2)];
    let pose = |i: i64| PoseSample {
        t_us: i * 100,
        position: [i as f64, 0.1, -2.0],
        rotation: [0.0, 0.6, 0.0, 0.8],
    };
    let poses: Vec<_> = (0..3_000).map(pose).collect();

    let mut writer = RecordingWriter::create(&path, &wanted, false).unwrap();
    for (i, stream) in streams.iter().enumerate() {
        for part in stream.chunks(777) {
            writer.write_events(i, part).unwrap();
        }
    }
    for pose in &poses {
        writer.write_pose(1, pose).unwrap();
    }
    for t_us in [0, 20_000, 40_000] {
        for kind in LabelKind::ALL {
            writer.write_label(0, &label(kind, t_us, 128)).unwrap();
            writer.write_label(1, &label(kind, t_us, 35)).unwrap();
        }
    }
    writer.finish("{\"events\": 201000}").unwrap();

    let recording = Recording::open(&path).unwrap();
    wanted.duration_us = None;
    assert_eq!(recording.header(), &wanted);
    assert!(recording.is_complete().unwrap());
    assert_eq!(recording.report().unwrap().as_deref(), Some("{\"events\": 201000}"));
    for (i, stream) in streams.iter().enumerate() {
        assert_eq!(recording.event_count(i).unwrap(), stream.len() as u64);
        assert!(recording.events(i).unwrap() == *stream);
        assert_eq!(recording.label_kinds(i).unwrap(), LabelKind::ALL);
    }
    assert_eq!(recording.poses(1).unwrap(), poses);
    assert!(recording.poses(0).unwrap().is_empty());
    for kind in LabelKind::ALL {
        assert_eq!(recording.label_times(1, kind).unwrap(), [0, 20_000, 40_000]);
        assert_eq!(recording.label(1, kind, 2).unwrap(), label(kind, 40_000, 35));
        assert_eq!(recording.label(0, kind, 1).unwrap(), label(kind, 20_000, 128));
        assert_ne!(recording.label(0, kind, 1).unwrap(), label(kind, 0, 128), "canary: frames differ");
        assert!(recording.label(0, kind, 3).is_err());
    }
    assert_eq!(stored_index(&path, "left"), index_of(&streams[0]));
    assert_ne!(stored_index(&path, "left"), index_of(&streams[0][..199_000]), "canary");
    assert_eq!(stored_index(&path, "right eye"), index_of(&streams[1]));
    assert_eq!(folder.names(), ["out.h5"], "no draft is left");
}

#[test]
fn windows_of_time_are_half_open_and_exact() {
    let folder = Folder::new("windows");
    for (name, duration_us) in [("narrow.h5", Some(1_000_000_000)), ("wide.h5", None)] {
        let path = folder.file(name);
        let all = events(150_000, 16, 8, 3);
        let content = RecordingHeader { duration_us, ..header(vec![camera("cam", 16, 8)]) };
        let mut writer = RecordingWriter::create(&path, &content, false).unwrap();
        writer.write_events(0, &all).unwrap();
        writer.finish("{}").unwrap();
        let recording = Recording::open(&path).unwrap();
        let end = all.last().unwrap().t;
        let mut state = 9;
        let mut windows = vec![(-5, 1), (0, 0), (0, i64::MAX), (i64::MIN, i64::MAX), (end, end + 1), (9, 3)];
        windows.extend([(end - 2_500, end), (end + 5_000, end + 9_000), (0, end)]);
        for _ in 0..40 {
            let from = random(&mut state) as i64 % end;
            windows.push((from, from + random(&mut state) as i64 % 20_000));
        }
        let mut found = 0;
        for (from, to) in windows {
            let got = recording.events_between(0, from, to).unwrap();
            assert!(got == slice_time(&all, from, to), "{name}: {from}..{to}");
            found += got.len();
        }
        assert!(found > all.len(), "the windows were not empty");
        assert!(recording.events_between(1, 0, 9).unwrap_err().to_string().contains("camera 1"));
    }
}

#[test]
fn one_camera_is_linked_at_the_root_for_dsec_readers() {
    let folder = Folder::new("links");
    let path = folder.file("out.h5");
    let all = events(5_000, 16, 8, 4);
    let mut writer = RecordingWriter::create(&path, &header(vec![camera("cam", 16, 8)]), false).unwrap();
    writer.write_events(0, &all).unwrap();
    writer.finish("{}").unwrap();
    let file = rust_hdf5::H5File::open(&path).unwrap();
    let t = file.dataset("events/t").unwrap().read_raw::<u32>().unwrap();
    assert!(t.iter().map(|&t| i64::from(t)).eq(all.iter().map(|e| e.t)));
    assert_eq!(file.dataset("ms_to_idx").unwrap().read_raw::<u64>().unwrap(), index_of(&all));
    assert_eq!(file.dataset("t_offset").unwrap().read_raw::<i64>().unwrap(), [-77]);
    assert_eq!(file.dataset("events/width").unwrap().read_raw::<i64>().unwrap(), [16]);
    assert_eq!(file.dataset("events/x").unwrap().chunk_dims(), Some(vec![65_536]));
}

#[test]
fn a_long_silence_is_indexed_and_times_past_32_bits_are_kept() {
    let folder = Folder::new("silence");
    let path = folder.file("out.h5");
    let times = [5, 1_000, 6_000_000_000, 6_000_000_001];
    let all: Vec<_> = times.map(|t| Event::new(t, 1, 2, Polarity::On)).into();
    let wide = RecordingHeader { duration_us: Some(7_000_000_000), ..header(vec![camera("cam", 16, 8)]) };
    let mut writer = RecordingWriter::create(&path, &wide, false).unwrap();
    writer.write_events(0, &all).unwrap();
    writer.finish("{}").unwrap();
    let recording = Recording::open(&path).unwrap();
    assert_eq!(recording.events(0).unwrap(), all);
    assert_eq!(recording.events_between(0, 6_000_000_001, 6_000_000_002).unwrap(), all[3..]);
    assert_eq!(stored_index(&path, "cam"), index_of(&all));

    let narrow = header(vec![camera("cam", 16, 8)]);
    let mut writer = RecordingWriter::create(&path, &narrow, true).unwrap();
    let error = writer.write_events(0, &all).unwrap_err().to_string();
    assert!(error.contains("later than 4294967295") && error.contains("duration"), "{error}");
}

#[test]
fn events_that_make_no_stream_are_refused_whole() {
    let folder = Folder::new("refused");
    let path = folder.file("out.h5");
    let mut writer = RecordingWriter::create(&path, &header(vec![camera("cam", 16, 8)]), false).unwrap();
    let good = Event::new(100, 15, 7, Polarity::On);
    writer.write_events(0, &[good]).unwrap();
    let mut purple = good;
    purple.p = 2;
    for (bad, word) in [
        (Event::new(99, 0, 0, Polarity::On), "before"),
        (Event::new(-1, 0, 0, Polarity::On), "before"),
        (Event::new(200, 16, 0, Polarity::On), "outside"),
        (Event::new(200, 0, 8, Polarity::On), "outside"),
        (Event::new(i64::MAX, 0, 0, Polarity::On), "later"),
        (purple, "polarity"),
    ] {
        let error = writer.write_events(0, &[good, bad]).unwrap_err().to_string();
        assert!(error.contains(word) && error.contains("event 1 of camera cam"), "{error}");
    }
    assert!(writer.write_events(1, &[good]).is_err());
    assert!(writer.write_label(0, &label(LabelKind::Depth, 0, 128)).is_err(), "not announced");
    let pose = PoseSample { t_us: 0, position: [f64::NAN, 0.0, 0.0], rotation: [0.0; 4] };
    assert!(writer.write_pose(0, &pose).is_err());
    writer.write_events(0, &[good]).unwrap();
    writer.finish("{}").unwrap();
    assert_eq!(Recording::open(&path).unwrap().events(0).unwrap(), [good, good]);

    let announced = RecordingHeader { labels: vec![LabelKind::Depth], ..header(vec![camera("cam", 16, 8)]) };
    let mut writer = RecordingWriter::create(&path, &announced, true).unwrap();
    writer.write_label(0, &label(LabelKind::Depth, 50, 128)).unwrap();
    for (bad, word) in [
        (label(LabelKind::Depth, 60, 127), "127 values"),
        (LabelFrame { data: LabelData::U32(vec![0; 128]), ..label(LabelKind::Depth, 60, 128) }, "float32"),
        (label(LabelKind::Depth, 49, 128), "order of time"),
    ] {
        let error = writer.write_label(0, &bad).unwrap_err().to_string();
        assert!(error.contains(word), "{error}");
    }
    writer.finish("{}").unwrap();
    assert_eq!(Recording::open(&path).unwrap().label_times(0, LabelKind::Depth).unwrap(), [50]);
}

#[test]
fn headers_that_make_no_recording_are_refused() {
    let folder = Folder::new("headers");
    let path = folder.file("out.h5");
    let fine = header(vec![camera("cam", 16, 8)]);
    let with = |change: &dyn Fn(&mut RecordingHeader)| {
        let mut header = fine.clone();
        change(&mut header);
        header
    };
    for bad in [
        with(&|h| h.cameras.clear()),
        with(&|h| h.cameras[0].name = "a/b".into()),
        with(&|h| h.cameras[0].name = "events".into()),
        with(&|h| h.cameras[0].name = String::new()),
        with(&|h| h.cameras.push(camera("cam", 4, 4))),
        with(&|h| h.cameras[0].width = 0),
        with(&|h| h.cameras[0].height = 70_000),
        with(&|h| h.duration_us = Some(-1)),
        with(&|h| h.labels = vec![LabelKind::Depth, LabelKind::Depth]),
        with(&|h| {
            h.cameras[0] = camera("cam", 65_536, 65_536);
            h.labels = vec![LabelKind::Hdr];
        }),
    ] {
        let result = RecordingWriter::create(&path, &bad, false);
        assert!(matches!(result, Err(FormatError::Invalid { .. })), "{bad:?}");
        assert!(folder.names().is_empty());
    }
    drop(RecordingWriter::create(&path, &fine, false).unwrap());
}

#[test]
fn a_failed_creation_leaves_the_folder_as_it_was() {
    let folder = Folder::new("creation");
    let path = folder.file("out.h5");
    let fine = header(vec![camera("cam", 16, 8)]);
    fs::write(&path, b"precious").unwrap();
    assert!(matches!(RecordingWriter::create(&path, &fine, false), Err(FormatError::Exists { .. })));
    assert_eq!(fs::read(&path).unwrap(), b"precious");

    let error = match RecordingWriter::create(&folder.file("no/such/folder/out.h5"), &fine, true) {
        Err(error) => error.to_string(),
        Ok(_) => panic!("created in a folder that does not exist"),
    };
    assert!(error.contains("folder must exist") && error.contains("out.h5"), "{error}");
    assert!(RecordingWriter::create(&folder.0, &fine, true).is_err(), "a folder is no file");
    if Path::new("/dev/full").exists() {
        assert!(RecordingWriter::create(Path::new("/dev/full"), &fine, true).is_err());
    }
    assert_eq!(folder.names(), ["out.h5"]);

    RecordingWriter::create(&path, &fine, true).unwrap().finish("{}").unwrap();
    assert!(Recording::open(&path).unwrap().is_complete().unwrap());
    assert!(Recording::open(&path).unwrap().events(0).unwrap().is_empty());
}

#[test]
fn a_dropped_writer_leaves_a_plain_file_that_counts_as_incomplete() {
    let folder = Folder::new("dropped");
    let path = folder.file("out.h5");
    let all = events(70_000, 16, 8, 5);
    let mut writer = RecordingWriter::create(&path, &header(vec![camera("cam", 16, 8)]), false).unwrap();
    writer.write_events(0, &all).unwrap();
    drop(writer);
    let recording = Recording::open(&path).unwrap();
    assert!(!recording.is_complete().unwrap());
    assert_eq!(recording.report().unwrap(), None);
    assert!(recording.events(0).unwrap() == all);
    assert!(repair(&path).unwrap().nothing_to_do());
}

#[test]
fn a_copy_taken_while_writing_reads_and_can_be_repaired() {
    let folder = Folder::new("copy");
    let path = folder.file("out.h5");
    let all = events(300_000, 16, 8, 6);
    let mut writer = RecordingWriter::create(&path, &header(vec![camera("cam", 16, 8)]), false).unwrap();
    for (i, part) in all.chunks(30_000).enumerate() {
        writer.write_events(0, part).unwrap();
        writer.flush().unwrap();
        // What a kill at this point leaves behind.
        let copy = folder.file(&format!("copy{i}.h5"));
        fs::copy(&path, &copy).unwrap();
        let given = &all[..30_000 * (i + 1)];
        let recording = Recording::open(&copy).unwrap();
        assert!(!recording.is_complete().unwrap());
        assert!(recording.events(0).unwrap() == given);
        let report = repair(&copy).unwrap();
        assert!(report.reopened && report.rows_dropped == 0 && report.millis_rebuilt == 0, "{report:?}");
        assert_eq!(report.events, [("cam".to_string(), given.len() as u64)]);
        assert!(recording.events(0).unwrap() == given);
        assert_eq!(stored_index(&copy, "cam"), index_of(given));
        assert!(!recording.is_complete().unwrap(), "repair does not make it whole");
        assert!(repair(&copy).unwrap().nothing_to_do());
    }
    if cfg!(unix) {
        let error = repair(&path).unwrap_err().to_string();
        assert!(error.contains("another process"), "the file is being written: {error}");
    }
}

/// A small recording with everything in it, whole and as a killed writer leaves it.
fn specimens(folder: &Folder) -> [Vec<u8>; 2] {
    let path = folder.file("specimen.h5");
    let mut content = header(vec![camera("cam", 16, 8)]);
    content.labels = vec![LabelKind::Depth, LabelKind::FlowForward];
    let mut writer = RecordingWriter::create(&path, &content, false).unwrap();
    writer.write_events(0, &events(2_000, 16, 8, 7)).unwrap();
    for t_us in 0..12 {
        writer.write_label(0, &label(LabelKind::Depth, t_us, 128)).unwrap();
        writer.write_label(0, &label(LabelKind::FlowForward, t_us, 128)).unwrap();
    }
    let pose = PoseSample { t_us: 0, position: [1.0; 3], rotation: [0.0, 0.0, 0.0, 1.0] };
    writer.write_pose(0, &pose).unwrap();
    writer.flush().unwrap();
    let killed = fs::read(&path).unwrap();
    writer.finish("{\"a\": 1}").unwrap();
    [fs::read(&path).unwrap(), killed]
}

/// Reads all there is; how many of the reads gave an error.
fn read_everything(path: &Path) -> usize {
    let Ok(recording) = Recording::open(path) else { return 1 };
    let mut errors = 0;
    for camera in 0..recording.header().cameras.len().min(2) {
        errors += usize::from(recording.events(camera).is_err());
        errors += usize::from(recording.events_between(camera, 1_000, 30_000).is_err());
        errors += usize::from(recording.poses(camera).is_err());
        for kind in recording.header().labels.clone() {
            match recording.label_times(camera, kind) {
                Ok(times) => {
                    let bad = |i| recording.label(camera, kind, i).is_err();
                    errors += (0..times.len()).step_by(5).filter(|&i| bad(i)).count();
                }
                Err(_) => errors += 1,
            }
        }
    }
    errors + usize::from(recording.is_complete().is_err()) + usize::from(recording.report().is_err())
}

#[test]
fn a_file_cut_short_at_any_length_gives_an_error_and_no_panic() {
    let folder = Folder::new("cut");
    let path = folder.file("cut.h5");
    let mut saved = 0;
    for whole in specimens(&folder) {
        fs::write(&path, &whole).unwrap();
        assert_eq!(read_everything(&path), 0, "canary: the whole file reads");
        let step = whole.len() / 100;
        for length in (0..200).chain((200..whole.len()).step_by(step)).chain([whole.len() - 1]) {
            fs::write(&path, &whole[..length]).unwrap();
            let errors = catch_unwind(|| read_everything(&path)).expect("no panic");
            assert!(errors > 0, "{length} of {} bytes pass as whole", whole.len());
            if catch_unwind(|| repair(&path)).expect("no panic").is_ok() {
                saved += 1;
                let errors = catch_unwind(|| read_everything(&path)).expect("no panic");
                assert_eq!(errors, 0, "repaired at {length} of {} bytes", whole.len());
                let complete = Recording::open(&path).unwrap().is_complete().unwrap();
                assert!(!complete, "complete at {length} of {} bytes", whole.len());
            } else {
                assert!(fs::read(&path).unwrap() == whole[..length], "refused at {length}, and changed");
            }
        }
    }
    assert!(saved > 10, "repair saved {saved}");
}

#[test]
fn a_repair_says_how_much_of_a_cut_file_it_saved() {
    let folder = Folder::new("saved");
    let path = folder.file("cut.h5");
    // Three chunks and a part of one, stored as they fill.
    let all = events(220_000, 16, 8, 8);
    let mut writer = RecordingWriter::create(&path, &header(vec![camera("cam", 16, 8)]), false).unwrap();
    for part in all.chunks(55_000) {
        writer.write_events(0, part).unwrap();
    }
    writer.finish("{}").unwrap();
    let whole = fs::read(&path).unwrap();
    assert!(Recording::open(&path).unwrap().is_complete().unwrap(), "canary: it was complete");

    fs::write(&path, &whole[..whole.len() * 7 / 10]).unwrap();
    let report = repair(&path).unwrap();
    let kept = report.events[0].1;
    assert!(report.cut_short && !report.reopened && report.report_dropped, "{report:?}");
    assert!(kept > 0 && kept < 220_000 && kept + report.events_dropped == 220_000, "{report:?}");
    let recording = Recording::open(&path).unwrap();
    assert!(!recording.is_complete().unwrap());
    let kept = usize::try_from(kept).unwrap();
    assert!(recording.events(0).unwrap() == all[..kept]);
    assert_eq!(stored_index(&path, "cam"), index_of(&all[..kept]));
    assert!(repair(&path).unwrap().nothing_to_do());

    // Less than a chunk of each column.
    let head = &whole[..whole.len() / 10];
    fs::write(&path, head).unwrap();
    let error = repair(&path).unwrap_err().to_string();
    for words in ["cut short", "none of its 220000 events can be saved", "left as it is"] {
        assert!(error.contains(words), "the message lacks '{words}': {error}");
    }
    assert!(fs::read(&path).unwrap() == head);
}

#[test]
fn a_page_of_zeros_costs_the_rows_of_its_chunks_and_no_others() {
    const PAGE: usize = 4096;
    let folder = Folder::new("zeroed_page");
    let path = folder.file("out.h5");
    // Whole chunks of 65 536 rows: a page lies in two of them at most.
    let whole = events(6 * 65_536, 64, 48, 5);
    let mut writer = RecordingWriter::create(&path, &header(vec![camera("cam", 64, 48)]), false).unwrap();
    for part in whole.chunks(50_000) {
        writer.write_events(0, part).unwrap();
    }
    writer.finish("{}").unwrap();
    assert!(hdf5::check(&path).unwrap().nothing_to_do(), "canary: nothing is zeroed yet");
    let bytes = fs::read(&path).unwrap();
    let pages = bytes.len() / PAGE;
    assert!(pages > 150, "{pages} pages");
    let (mut tried, mut saved, mut holes) = (0, 0, 0);
    for page in (0..pages).step_by(pages / 40) {
        let mut damaged = bytes.clone();
        damaged[page * PAGE..(page + 1) * PAGE].fill(0);
        let _ = fs::remove_file(&path);
        fs::write(&path, &damaged).unwrap();
        tried += 1;
        let noticed = !hdf5::check(&path).is_ok_and(|report| report.nothing_to_do());
        assert!(noticed, "page {page} of zeros is not seen");
        let Ok(report) = repair(&path) else {
            assert!(fs::read(&path).unwrap() == damaged, "page {page}: a refused file was changed");
            continue;
        };
        saved += 1;
        let kept = Recording::open(&path).unwrap().events(0).unwrap();
        // In order, each kept event is one of the recording's.
        let mut left = whole.iter();
        assert!(kept.iter().all(|event| left.any(|other| other == event)), "page {page}: other events");
        let lost = whole.len() - kept.len();
        assert_eq!(lost as u64, report.events_dropped, "page {page}");
        assert!(lost <= 2 * 65_536, "page {page}: {lost} events are lost");
        // What is lost at the end is no hole.
        let told = report.holes.iter().any(|hole| hole.part == "cam/events");
        assert!(told || kept == whole[..kept.len()], "page {page}: {report:?}");
        holes += usize::from(told);
        assert!(hdf5::check(&path).unwrap().nothing_to_do(), "page {page}");
    }
    // Only the pages of the file's own index cannot be missed.
    assert!(
        saved * 10 >= tried * 9 && holes > tried / 2,
        "{saved} of {tried} are saved, {holes} with a hole"
    );
}

#[test]
fn flipped_bits_give_an_error_or_data_and_no_panic() {
    let folder = Folder::new("flips");
    let path = folder.file("flipped.h5");
    let mut state = 11;
    let mut noticed = 0;
    for whole in specimens(&folder) {
        for round in 0..150 {
            let mut bytes = whole.clone();
            for _ in 0..1 + round % 4 {
                let at = random(&mut state) as usize % bytes.len();
                bytes[at] ^= 1 << (random(&mut state) % 8);
            }
            fs::write(&path, &bytes).unwrap();
            noticed += usize::from(catch_unwind(|| read_everything(&path)).expect("no panic") > 0);
            let _ = catch_unwind(|| repair(&path)).expect("no panic");
        }
    }
    assert!(noticed > 75, "only {noticed} of 300 damaged files were noticed");
}

#[cfg(unix)]
#[test]
fn a_recording_that_is_removed_or_replaced_while_it_is_written_is_an_error() {
    let folder = Folder::new("lost");
    let path = folder.file("out.h5");
    let header = header(vec![camera("cam", 16, 8)]);
    for (change, message) in [
        ((|path| fs::remove_file(path).unwrap()) as fn(&Path), "removed"),
        (
            |path| {
                fs::remove_file(path).unwrap();
                fs::write(path, b"another").unwrap();
            },
            "another file took its place",
        ),
    ] {
        let mut writer = RecordingWriter::create(&path, &header, true).unwrap();
        writer.write_events(0, &events(100, 16, 8, 1)).unwrap();
        change(&path);
        let error = writer.finish("{}").unwrap_err();
        assert!(matches!(error, FormatError::Lost { .. }), "{error}");
        assert!(error.to_string().contains(message), "{error}");
        let _ = fs::remove_file(&path);
    }
}

#[cfg(unix)]
#[test]
fn a_recording_that_is_being_written_is_not_replaced() {
    let folder = Folder::new("busy");
    let path = folder.file("out.h5");
    let header = header(vec![camera("cam", 16, 8)]);
    let mut first = RecordingWriter::create(&path, &header, false).unwrap();
    first.write_events(0, &events(100, 16, 8, 1)).unwrap();
    let error = RecordingWriter::create(&path, &header, true).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("another process is writing or reading it"), "{error}");
    assert_eq!(folder.names(), ["out.h5"], "no draft is left");
    first.finish("{}").unwrap();
    assert_eq!(Recording::open(&path).unwrap().events(0).unwrap(), events(100, 16, 8, 1));
    // Once it is finished, it may be replaced.
    RecordingWriter::create(&path, &header, true).unwrap().finish("{}").unwrap();
    assert!(Recording::open(&path).unwrap().events(0).unwrap().is_empty());
}

#[cfg(unix)]
#[test]
fn a_recording_is_written_behind_a_link() {
    let folder = Folder::new("link");
    let header = header(vec![camera("cam", 16, 8)]);
    fs::create_dir(folder.file("disk")).unwrap();
    // Once to a file that is not there yet, once to one that is.
    std::os::unix::fs::symlink("disk/real.h5", folder.file("out.h5")).unwrap();
    for count in [10, 20] {
        let mut writer = RecordingWriter::create(&folder.file("out.h5"), &header, true).unwrap();
        writer.write_events(0, &events(count, 16, 8, 1)).unwrap();
        writer.finish("{}").unwrap();
        assert!(folder.file("out.h5").is_symlink());
        let real = Recording::open(&folder.file("disk/real.h5")).unwrap();
        assert_eq!(real.event_count(0).unwrap(), count as u64);
    }
}

#[test]
fn distortions_and_inertial_samples_come_back() {
    let folder = Folder::new("distorted");
    let path = folder.file("a.h5");
    let distortion = LensDistortion { model: "fisheye".into(), coefficients: vec![0.1, -0.02, 3e-3, 0.0] };
    let bent = CameraInfo { distortion: Some(distortion.clone()), ..camera("bent", 16, 8) };
    let header = header(vec![bent, camera("plain", 16, 8)]);
    let names = ["body".to_owned(), "head".to_owned()];
    let sample = |k: i64| ImuSample {
        t_us: 5000 * k,
        accelerometer: [0.1 * k as f64, 9.8, -1.5],
        gyroscope: [k as f64, 0.0, -0.25],
    };
    let samples: Vec<ImuSample> = (0..3000).map(sample).collect();
    let create = |path: &Path, imus: &[String]| {
        let extras = RecordingExtras { imus: imus.to_vec(), ..RecordingExtras::default() };
        RecordingWriter::create_with_extras(path, &header, &extras, false)
    };
    let mut writer = create(&path, &names).unwrap();
    writer.write_imu(1, &samples[..7]).unwrap();
    writer.write_events(0, &events(100, 16, 8, 3)).unwrap();
    writer.write_imu(1, &samples[7..]).unwrap();
    for (index, wrong) in
        [(2, sample(9000)), (1, sample(0)), (1, ImuSample { gyroscope: [f64::NAN; 3], ..sample(9000) })]
    {
        assert!(writer.write_imu(index, &[wrong]).is_err(), "{index} {wrong:?}");
    }
    writer.finish("{}").unwrap();
    let recording = Recording::open(&path).unwrap();
    assert_eq!(recording.header().cameras[0].distortion, Some(distortion));
    assert_eq!(recording.header().cameras[1].distortion, None);
    assert_eq!(recording.imus().unwrap(), names);
    assert_eq!(recording.imu("head").unwrap(), samples);
    assert_ne!(recording.imu("head").unwrap(), samples[1..], "canary");
    assert!(recording.imu("body").unwrap().is_empty());
    assert!(recording.imu("tail").unwrap_err().to_string().contains("body, head"));
    recording.verify().unwrap();
    for name in ["", "a/b"] {
        assert!(create(&folder.file("b.h5"), &[name.to_owned()]).is_err(), "{name:?}");
    }
    // A file without any has none.
    let plain = folder.file("plain.h5");
    RecordingWriter::create(&plain, &header, false).unwrap().finish("{}").unwrap();
    assert!(Recording::open(&plain).unwrap().imus().unwrap().is_empty());
}

#[test]
fn states_come_back_as_they_were_given() {
    let folder = Folder::new("states");
    let path = folder.file("a.h5");
    let header = header(vec![camera("cam", 16, 8)]);
    let state = |name: &str, values: &[&str]| StateInfo {
        name: name.into(),
        values: values.iter().map(|value| (*value).into()).collect(),
    };
    let create = |path: &Path, states: &[StateInfo]| {
        let extras = RecordingExtras { states: states.to_vec(), ..RecordingExtras::default() };
        RecordingWriter::create_with_extras(path, &header, &extras, false)
    };
    let states = [state("arm", &["shoulder", "elbow"]), state("idle", &["x"])];
    let mut writer = create(&path, &states).unwrap();
    let t_us: Vec<i64> = (0..5000).map(|k| 100 * k).collect();
    let values: Vec<f64> =
        (0..10_000).map(|k| if k == 77 { f64::INFINITY } else { 0.25 * f64::from(k) }).collect();
    writer.write_state(0, &t_us[..3], &values[..6]).unwrap();
    writer.write_events(0, &events(100, 16, 8, 3)).unwrap();
    writer.write_state(0, &t_us[3..], &values[6..]).unwrap();
    let refused = [
        writer.write_state(2, &[0], &[0.0]),
        writer.write_state(0, &[0], &[0.0, 0.0]),
        writer.write_state(0, &[600_000], &[0.0]),
        writer.write_state(1, &[7, 7], &[0.0, 0.0]),
    ];
    let remedies = ["index below 2", "order of time", "2 per time", "order of time"];
    for (refused, remedy) in refused.into_iter().zip(remedies) {
        let error = refused.unwrap_err().to_string();
        assert!(error.contains(remedy), "{error}");
    }
    writer.finish("{}").unwrap();
    let recording = Recording::open(&path).unwrap();
    recording.verify().unwrap();
    assert_eq!(recording.states().unwrap(), ["arm", "idle"]);
    let arm = recording.state("arm").unwrap();
    assert_eq!((arm.names.as_slice(), &arm.t_us, &arm.values), (&states[0].values[..], &t_us, &values));
    assert!(recording.state("idle").unwrap().t_us.is_empty());
    assert!(recording.state("leg").unwrap_err().to_string().contains("arm, idle"));
    for wrong in [state("", &["x"]), state("a/b", &["x"]), state("a", &[])] {
        assert!(create(&folder.file("b.h5"), &[wrong]).is_err());
    }
    assert!(create(&folder.file("b.h5"), &[states[0].clone(), states[0].clone()]).is_err());
}

#[test]
fn semantic_classes_have_names_beside_their_ids() {
    let folder = Folder::new("classes");
    let path = folder.file("out.h5");
    let mut content = header(vec![camera("cam", 16, 8)]);
    content.labels = vec![LabelKind::Instance, LabelKind::Semantic];
    let body = |name: &str, instance_id, semantic_id, semantic_name: &str| BodyInfo {
        name: name.into(),
        instance_id,
        semantic_id,
        semantic_name: semantic_name.into(),
        bounds: [[0.0; 3], [1.0; 3]],
    };
    let bodies = vec![
        body("ball", 2, 7, "toy"),
        body("floor", 1, 3, "ground"),
        body("leg", 2, 7, "toy"),
        body("rock", 3, 9, ""),
        body("cam", 0, 0, ""),
    ];
    assert_eq!(BodyInfo::instances(&bodies), [(1, "floor"), (2, "ball"), (3, "rock")]);
    assert_eq!(BodyInfo::classes(&bodies), [(3, "ground"), (7, "toy")]);
    let write = |bodies: &[BodyInfo]| {
        let extras = RecordingExtras { bodies: bodies.to_vec(), ..RecordingExtras::default() };
        RecordingWriter::create_with_extras(&path, &content, &extras, true).unwrap().finish("{}").unwrap();
        Recording::open(&path).unwrap()
    };
    let recording = write(&bodies);
    assert_eq!(recording.body_infos().unwrap(), bodies);
    assert_eq!(recording.bodies().unwrap().infos, bodies);
    let file = rust_hdf5::H5File::open(&path).unwrap();
    let names = file.dataset("cam/labels/semantic_names").unwrap().read_vlen_strings().unwrap();
    let ids: Vec<u32> = file.dataset("cam/labels/semantic_ids").unwrap().read_raw().unwrap();
    assert_eq!((ids, names), (vec![3, 7], vec!["ground".to_owned(), "toy".to_owned()]));
    drop(file);
    // Files of scenes without names have no such data sets, as those from before there were any.
    let unnamed: Vec<_> =
        bodies.iter().map(|body| BodyInfo { semantic_name: String::new(), ..body.clone() }).collect();
    assert_eq!(write(&unnamed).body_infos().unwrap(), unnamed);
    let file = rust_hdf5::H5File::open(&path).unwrap();
    assert!(
        file.dataset("cam/labels/semantic_names").is_err() && file.dataset("bodies/semantic_name").is_err()
    );
    assert!(file.dataset("cam/labels/instance_names").is_ok(), "canary");
}
