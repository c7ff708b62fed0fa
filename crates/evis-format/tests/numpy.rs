//! NumPy's files read whole: what they hold, what is refused, and mutants, within a limit of memory.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

#[path = "../../evis-core/tests/common/damage.rs"]
mod damage;
#[path = "../../evis-core/tests/common/promised.rs"]
mod promised;
#[path = "../../evis-core/tests/common/watched.rs"]
mod watched;

use std::io::{Cursor, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};

use damage::{Damage, Folder, replace};
use evis_core::event::MOST_T_US;
use evis_core::stats::stats;
use evis_core::{Event, Polarity};
use evis_format::{EventFile, read_events};
use promised::check;
use watched::within_the_limit;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

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
    zip(&files, deflated)
}

fn zip(files: &[(&str, Vec<u8>)], deflated: bool) -> Vec<u8> {
    let method = if deflated { CompressionMethod::Deflated } else { CompressionMethod::Stored };
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, data) in files {
        archive.start_file(*name, SimpleFileOptions::default().compression_method(method)).unwrap();
        archive.write_all(data).unwrap();
    }
    archive.finish().unwrap().into_inner()
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
        [(MOST_T_US + 1, 1, "up to 4503599627370496 us"), (i64::MIN, 1, "up to"), (0, 7, "p 7")]
    {
        let mut event = Event::new(t, 1, 1, Polarity::On);
        event.p = p;
        std::fs::write(&path, rows(&[event])).unwrap();
        let error = read_events(&path, None).unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
}

fn read(bytes: &[u8], name: &str) -> Result<EventFile, String> {
    let folder = Folder::new(name);
    let path = folder.file(name);
    std::fs::write(&path, bytes).unwrap();
    read_events(&path, None).map_err(|error| error.to_string())
}

fn files(t: [i64; 2], p: [i8; 2]) -> Vec<(&'static str, Vec<u8>)> {
    let le = |t: [i64; 2]| t.iter().flat_map(|t| t.to_le_bytes()).collect::<Vec<_>>();
    vec![
        ("t.npy", npy("'<i8'", "(2,)", &le(t))),
        ("x.npy", npy("'>u2'", "(2,)", &[0, 3, 1, 0])),
        ("y.npy", npy("'|u1'", "(2,)", &[7, 8])),
        ("p.npy", npy("'|i1'", "(2,)", &p.map(|p| p as u8))),
    ]
}

#[test]
fn columns_of_an_archive_are_events() {
    let want = vec![Event::new(5, 3, 7, Polarity::On), Event::new(9, 256, 8, Polarity::Off)];
    let got = read(&zip(&files([5, 9], [1, -1]), false), "a.npz").unwrap();
    assert_eq!((got.events, got.size, got.range), (want.clone(), (257, 9), (5, 10)));
    let mut sized = files([5, 9], [1, 0]);
    sized.push(("width.npy", npy("'<i8'", "()", &640_i64.to_le_bytes())));
    sized.push(("height.npy", npy("'<i8'", "()", &480_i64.to_le_bytes())));
    assert_eq!(read(&zip(&sized, true), "b.npz").unwrap().size, (640, 480));

    let rows: Vec<u8> = want.iter().flat_map(|e| bytemuck::bytes_of(e).to_vec()).collect();
    let descr = "[('x', '<u2'), ('y', '<u2'), ('p', '<i2'), ('', '|V2'), ('t', '<i8')]";
    assert_eq!(read(&npy(descr, "(2,)", &rows), "c.npy").unwrap().events, want);
}

#[test]
fn errors_name_what_is_wrong() {
    let whole = zip(&files([5, 9], [1, 0]), false);
    let mut missing = files([5, 9], [1, 0]);
    missing.remove(1);
    let mut float = files([5, 9], [1, 0]);
    float[0].1 = npy("'<f8'", "(2,)", &[0; 16]);
    for (name, bytes, message) in [
        ("back.npz", zip(&files([9, 5], [1, 0]), false), "event 1 is earlier"),
        ("polarity.npz", zip(&files([5, 9], [1, 2]), false), "at event 1, an event cannot be"),
        ("missing.npz", zip(&missing, false), "no column x"),
        ("float.npz", zip(&float, false), "dtype '<f8'"),
        ("cut.npz", whole[..whole.len() / 2].to_vec(), "archive cannot be read"),
        ("text.npy", b"t x y p".to_vec(), "ends within its header"),
        ("plain.npy", npy("'<u2'", "(2,)", &[0; 4]), "dtype '<u2'"),
    ] {
        let error = read(&bytes, name).unwrap_err();
        assert!(error.contains(message), "{name}: {error}");
    }
    // No byte that is wrong makes it panic.
    for at in 0..whole.len() {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x55;
        let _ = read(&bytes, "flipped.npz");
        let _ = read(&whole[..at], "flipped.npz");
    }
}
