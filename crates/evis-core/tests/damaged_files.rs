//! Mutated files: no reader panics, and what a reader hands out is what it promises.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};

use common::damage::{Damage, Folder, replace};
use evis_core::event::MOST_T_US;
use evis_core::format::hdf5::{Recording, RecordingHeader, RecordingWriter};
use evis_core::format::{EventFile, read_events};
use evis_core::stats::stats;
use evis_core::{CameraInfo, Event, LabelData, LabelFrame, LabelKind, Polarity, PoseSample};

/// The system's allocator, and the largest block that was asked of it.
struct Watched;

static LARGEST: AtomicUsize = AtomicUsize::new(0);

// SAFETY: the system's allocator does everything.
unsafe impl GlobalAlloc for Watched {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        LARGEST.fetch_max(layout.size(), Ordering::Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        LARGEST.fetch_max(layout.size(), Ordering::Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        LARGEST.fetch_max(size, Ordering::Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.realloc(block, layout, size) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(block, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Watched = Watched;

/// Memory that a file may take in these tests.
const LIMIT: u64 = 64 << 20;

/// One test at a time: they share the limit and the largest block.
static ALONE: Mutex<()> = Mutex::new(());

/// Runs `test` alone, and checks that it asked for no block beyond the limit.
fn within_the_limit(test: impl FnOnce()) {
    let _alone = ALONE.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    evis_core::limits::set_memory_limit(LIMIT);
    LARGEST.store(0, Ordering::Relaxed);
    test();
    let largest = LARGEST.load(Ordering::Relaxed);
    assert!(largest as u64 <= LIMIT, "a block of {largest} bytes was asked for");
}

fn events(count: i64) -> Vec<Event> {
    let polarity = |i: i64| if i % 3 == 0 { Polarity::Off } else { Polarity::On };
    (0..count).map(|i| Event::new(i * 37, (i * 7 % 40) as u16, (i * 5 % 30) as u16, polarity(i))).collect()
}

fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(data);
    bytes
}

fn rows(events: &[Event]) -> Vec<u8> {
    let descr = "[('x', '<u2'), ('y', '<u2'), ('p', '<i2'), ('', '|V2'), ('t', '<i8')]";
    npy(descr, &format!("({},)", events.len()), bytemuck::cast_slice(events))
}

/// An archive of columns, each deflated where `deflated`.
fn archive(events: &[Event], deflated: bool) -> Vec<u8> {
    let shape = format!("({},)", events.len());
    let column = |values: &dyn Fn(&Event) -> Vec<u8>| events.iter().flat_map(values).collect::<Vec<u8>>();
    let files = [
        ("t.npy", npy("'<i8'", &shape, &column(&|e| e.t.to_le_bytes().to_vec()))),
        ("x.npy", npy("'<u2'", &shape, &column(&|e| e.x.to_le_bytes().to_vec()))),
        ("y.npy", npy("'<u2'", &shape, &column(&|e| e.y.to_le_bytes().to_vec()))),
        ("p.npy", npy("'|u1'", &shape, &column(&|e| vec![e.p as u8]))),
        ("width.npy", npy("'<i8'", "()", &40_i64.to_le_bytes())),
        ("height.npy", npy("'<i8'", "()", &30_i64.to_le_bytes())),
    ];
    let (mut out, mut list) = (Vec::new(), Vec::new());
    for (name, data) in files {
        let packed = if deflated {
            let mut encoder = flate2::write::DeflateEncoder::new(Vec::new(), flate2::Compression::fast());
            encoder.write_all(&data).unwrap();
            encoder.finish().unwrap()
        } else {
            data.clone()
        };
        let at = out.len() as u32;
        let method = if deflated { 8_u16 } else { 0 }.to_le_bytes();
        let sizes = [(packed.len() as u32).to_le_bytes(), (data.len() as u32).to_le_bytes()].concat();
        let length = (name.len() as u16).to_le_bytes();
        let local = [&b"PK\x03\x04\x14\0\0\0"[..], &method, &[0; 8], &sizes, &length, &[0; 2]].concat();
        out.extend(local);
        out.extend(name.as_bytes());
        out.extend(&packed);
        let entry =
            [&b"PK\x01\x02\x14\0\x14\0\0\0"[..], &method, &[0; 8], &sizes, &length, &[0; 12]].concat();
        list.extend(entry);
        list.extend(at.to_le_bytes());
        list.extend(name.as_bytes());
    }
    let (at, length) = ((out.len() as u32).to_le_bytes(), (list.len() as u32).to_le_bytes());
    out.extend(&list);
    out.extend([&b"PK\x05\x06"[..], &[0; 8], &length, &at, &[0; 2]].concat());
    out
}

/// What every reader promises of events.
fn check(file: &EventFile) {
    let (width, height) = file.size;
    assert!(file.events.is_sorted_by_key(|e| e.t));
    for e in &file.events {
        assert!(u32::from(e.x) < width && u32::from(e.y) < height && (0..=1).contains(&e.p), "{e:?}");
        assert!((-MOST_T_US..=MOST_T_US).contains(&e.t), "{e:?}");
    }
}

#[test]
fn mutated_numpy_files_give_an_error_or_events_that_can_be_counted() {
    within_the_limit(mutated_numpy_files);
}

fn mutated_numpy_files() {
    let folder = Folder::new("numpy");
    let whole = events(60);
    let (mut read, mut refused) = (0, 0);
    for (name, bytes, marks) in [
        ("rows.npy", rows(&whole), &["<u2", "|V2", "<i8", "(60,)"][..]),
        ("stored.npz", archive(&whole, false), &["<i8", "<u2", "|u1", "(60,)", "()"]),
        ("deflated.npz", archive(&whole, true), &["t.npy"]),
    ] {
        let path = folder.file(name);
        std::fs::write(&path, &bytes).unwrap();
        assert_eq!(read_events(&path, None).unwrap().events, whole, "the file as it should be: {name}");
        let mut damage = Damage::new(7, &bytes, marks);
        for number in 0..1500 {
            let mutant = damage.next();
            replace(&path, &mutant);
            let outcome = catch_unwind(AssertUnwindSafe(|| {
                let Ok(file) = read_events(&path, None) else { return false };
                check(&file);
                let _ = stats(&file.events, file.size, file.range);
                true
            }));
            match outcome {
                Ok(true) => read += 1,
                Ok(false) => refused += 1,
                Err(_) => panic!("mutant {number} of {name} panics: {:?}", String::from_utf8_lossy(&mutant)),
            }
        }
    }
    // A campaign that reads nothing, or refuses nothing, has tried nothing.
    assert!(read > 200 && refused > 2000, "{read} read, {refused} refused");
}

#[test]
fn numpy_headers_that_no_memory_holds_are_refused() {
    within_the_limit(numpy_headers);
}

fn numpy_headers() {
    let folder = Folder::new("headers");
    let fields = |v: &str| format!("[('x', '<u2'), ('y', '<u2'), ('p', '<i2'), ('', '{v}'), ('t', '<i8')]");
    for (descr, shape) in [
        (fields("|V99999999999999"), "(2,)"),
        (fields("|V18446744073709551615"), "(2,)"),
        (fields("|V2"), "(4294967296,)"),
        (fields("|V2"), "(18446744073709551615,)"),
        (fields("|V2").replace("'<i2'", "'<i2', (2,)"), "(2,)"),
    ] {
        let path = folder.file("header.npy");
        std::fs::write(&path, npy(&descr, shape, &[0; 64])).unwrap();
        let error = read_events(&path, None).unwrap_err().to_string();
        assert!(error.contains("cannot be read"), "{descr} {shape}: {error}");
    }
    let path = folder.file("late.npy");
    std::fs::write(&path, rows(&[Event::new(MOST_T_US, 1, 1, Polarity::On)])).unwrap();
    assert_eq!(read_events(&path, None).unwrap().events.len(), 1, "the latest time that is read");
    for (t, p, message) in
        [(MOST_T_US + 1, 1, "up to 4503599627370496 us"), (i64::MIN, 1, "up to"), (0, 7, "polarity 7")]
    {
        let mut event = Event::new(t, 1, 1, Polarity::On);
        event.p = p;
        std::fs::write(&path, rows(&[event])).unwrap();
        let error = read_events(&path, None).unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
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
    let mut writer = RecordingWriter::create(path, &header, true).unwrap();
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
    let bytes = std::fs::read(&path).unwrap();
    let (mut opened, mut refused) = (0, 0);
    for at in (0..bytes.len()).step_by(2) {
        let mut mutant = bytes.clone();
        mutant[at] ^= 1 << (at / 2 % 8);
        replace(&path, &mutant);
        match Recording::open(&path) {
            Ok(recording) => {
                opened += 1;
                assert_eq!(recording.header(), &header, "byte {at}");
            }
            Err(_) => refused += 1,
        }
    }
    assert!(opened > 300 && refused > 300, "{opened} opened, {refused} refused");
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
