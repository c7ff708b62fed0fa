//! Every format: what is written is read, exactly; damaged files are errors that name the byte.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::path::{Path, PathBuf};

use evis_core::Polarity;
use evis_format::{
    AedatImuSample, Between, ConvertOptions, Event, EventReader, Format, FormatError, Frame, Packet,
    ReadOptions, Trigger, WriteOptions, convert, create, measure, open, recognise,
};

const SIZE: (u32, u32) = (1280, 720);

/// A folder of its own, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("evis-format-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    /// No ending: the content tells the format.
    fn file(&self, format: Format) -> PathBuf {
        self.0.join(format!("{}-events", format.name()))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// A generator with a fixed sequence (xorshift64*, Vigna 2016).
struct Draws(u64);

impl Draws {
    fn below(&mut self, end: u64) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) % end
    }
}

/// Scattered events, full rows, runs with holes, pixels that fire twice in a microsecond, silences, the corners of the
/// sensor; from `start_us` on.
fn stream(start_us: i64, groups: usize) -> Vec<Event> {
    let mut draws = Draws(0x9E37_79B9 + groups as u64);
    let (width, height) = (SIZE.0 as u64, SIZE.1 as u64);
    let (mut events, mut t) = (Vec::new(), start_us);
    let polarity = |bit: u64| if bit == 0 { Polarity::Off } else { Polarity::On };
    for group in 0..groups {
        t += match group % 97 {
            0 => 17_000_000,
            50 => 5_000_000,
            _ => draws.below(300) as i64,
        };
        let y = draws.below(height) as u16;
        match draws.below(4) {
            0 => {
                // A row, with holes.
                let (from, keep) = (draws.below(width - 40), draws.below(4) + 1);
                for x in from..from + 40 {
                    if draws.below(5) < keep {
                        events.push(Event::new(t, x as u16, y, polarity(group as u64 & 1)));
                    }
                }
            }
            1 => {
                // The right edge, with both polarities.
                for x in width - 10..width {
                    events.push(Event::new(t, x as u16, y, polarity(draws.below(6))));
                }
            }
            2 => {
                for _ in 0..2 {
                    events.push(Event::new(t, 3, y, Polarity::On));
                }
            }
            _ => {
                for _ in 0..draws.below(6) {
                    let (x, y) = (draws.below(width) as u16, draws.below(height) as u16);
                    events.push(Event::new(t, x, y, polarity(draws.below(2))));
                }
            }
        }
    }
    for (x, y) in [(0, 0), (1279, 0), (0, 719), (1279, 719)] {
        events.push(Event::new(t, x, y, Polarity::On));
    }
    events
}

fn write(path: &Path, format: Format, packets: &[Packet]) -> Result<(), FormatError> {
    let mut writer = create(path, format, &WriteOptions { size: SIZE, overwrite: true })?;
    for packet in packets {
        writer.write(packet)?;
    }
    writer.finish()
}

/// Everything, up to the first error.
fn read_all(reader: &mut dyn EventReader) -> (Packet, Option<FormatError>) {
    let (mut all, mut packet) = (Packet::default(), Packet::default());
    loop {
        match reader.read_packet(&mut packet) {
            Ok(true) => {
                all.events.append(&mut packet.events);
                all.triggers.append(&mut packet.triggers);
                all.frames.append(&mut packet.frames);
                all.imu.append(&mut packet.imu);
            }
            Ok(false) => return (all, None),
            Err(error) => return (all, Some(error)),
        }
    }
}

fn read(path: &Path) -> Result<Packet, FormatError> {
    let (all, error) = read_all(&mut *open(path, &ReadOptions::default())?);
    error.map_or(Ok(all), Err)
}

fn packets(events: &[Event], size: usize) -> Vec<Packet> {
    events.chunks(size).map(|part| Packet { events: part.to_vec(), ..Packet::default() }).collect()
}

fn same(a: &[Event], b: &[Event]) -> bool {
    a == b
}

#[test]
fn every_format_returns_what_was_written() {
    let folder = Folder::new("round");
    // Past the wrap of EVT 3.0 at 16.8 s, past 2^31 us, and past 2^32 us where the format can.
    for (start_us, latest_us) in [(0, 1 << 32), ((1 << 32) - 1_000_000, i64::MAX)] {
        let events = stream(start_us, 2000);
        assert!(events.last().unwrap().t > start_us + 17_000_000);
        for format in Format::BOTH_WAYS {
            let path = folder.file(format);
            let written = write(&path, format, &packets(&events, 777));
            if format == Format::Dat && latest_us == i64::MAX {
                let error = written.unwrap_err().to_string();
                assert!(error.contains("from 0 to 4294967295 us"), "{error}");
                continue;
            }
            written.unwrap();
            assert_eq!(recognise(&path).unwrap(), Some(format));
            let got = read(&path).unwrap();
            assert!(same(&got.events, &events), "{format:?}");
            let mut wrong = events.clone();
            wrong[1000].t += 1;
            assert!(!same(&got.events, &wrong), "canary: an event a microsecond later must be seen");
            let reader = open(&path, &ReadOptions::default()).unwrap();
            assert_eq!(
                reader.info().size,
                if format == Format::Npy { None } else { Some(SIZE) },
                "{format:?}"
            );
        }
    }
}

#[test]
fn how_packets_are_cut_does_not_change_a_byte() {
    let folder = Folder::new("cut");
    let events = stream(0, 300);
    for format in Format::BOTH_WAYS {
        // AEDAT 4.0 has packets of its own.
        if format == Format::Aedat4 {
            continue;
        }
        let bytes = [1, 100, usize::MAX].map(|size| {
            let path = folder.file(format);
            // EVT 3.0 joins neighbours of a row into vectors, so a row stays in one packet here.
            let size = if format == Format::Evt3 && size < 1000 { 1 << 20 } else { size };
            write(&path, format, &packets(&events, size.min(events.len()))).unwrap();
            std::fs::read(path).unwrap()
        });
        assert!(bytes.iter().all(|other| *other == bytes[0]), "{format:?}");
    }
}

#[test]
fn an_empty_stream_is_a_stream() {
    let folder = Folder::new("empty");
    for format in Format::BOTH_WAYS {
        let path = folder.file(format);
        write(&path, format, &[]).unwrap();
        assert_eq!(recognise(&path).unwrap(), Some(format));
        assert!(read(&path).unwrap().is_empty(), "{format:?}");
    }
}

#[test]
fn triggers_travel_among_events() {
    let folder = Folder::new("triggers");
    let events = stream(0, 400);
    let last = events.last().unwrap().t;
    for (format, ids) in [(Format::Evt3, 16), (Format::Evt2, 32), (Format::Aedat4, 1), (Format::Mcap, 16)] {
        let triggers: Vec<Trigger> =
            (0..500).map(|k| Trigger::new(last / 500 * k, (k % ids) as i16, k % 2 == 0)).collect();
        let parts = [(0, last / 3), (last / 3, last / 2), (last / 2, i64::MAX)];
        let packets = parts.map(|(from, to)| {
            let mut packet =
                Packet { events: events.clone(), triggers: triggers.clone(), ..Packet::default() };
            packet.retain_between(from, to);
            packet
        });
        let path = folder.file(format);
        write(&path, format, &packets).unwrap();
        let got = read(&path).unwrap();
        assert_eq!((got.triggers, got.events), (triggers.clone(), events.clone()), "{format:?}");
        // A trigger before events that are written already, and an id that does not fit.
        for wrong in [Trigger::new(1, 0, true), Trigger::new(last, ids as i16, true)] {
            let mut writer = create(&path, format, &WriteOptions { size: SIZE, overwrite: true }).unwrap();
            writer.write_events(&events).unwrap();
            let late = Packet { triggers: vec![wrong], ..Packet::default() };
            let refused = writer.write(&late).is_err();
            // AEDAT 4.0 keeps triggers in a stream of their own, in which order is free.
            assert_eq!(refused, wrong.id != 0 || format != Format::Aedat4, "{format:?} {wrong:?}");
        }
    }
    for format in [Format::Dat, Format::Text, Format::TextZip, Format::Npy, Format::Npz, Format::Es] {
        let packet = Packet { triggers: vec![Trigger::new(0, 0, true)], ..Packet::default() };
        let error = write(&folder.file(format), format, &[packet]).unwrap_err().to_string();
        assert!(error.contains("holds no triggers"), "{error}");
    }
}

#[test]
fn aedat4_carries_frames_and_inertial_samples() {
    let folder = Folder::new("frames");
    let frame = |k: i64, channels: u8| Frame {
        start_us: k * 1000,
        end_us: k * 1000 + 300,
        width: 32,
        height: 20,
        channels,
        pixels: (0..32 * 20 * u32::from(channels)).map(|v| (v * 7 + k as u32) as u8).collect(),
    };
    let imu = |k: i64| AedatImuSample {
        t: k * 10,
        temperature: 20.5 + k as f32,
        acceleration: [0.1, -0.2, 9.0],
        rotation: [k as f32, 2.0, 3.0],
        magnetic: [4.0, 5.0, 6.0],
    };
    let packet = Packet {
        events: stream(0, 50),
        triggers: vec![Trigger::new(5, 0, true), Trigger::new(9, 0, false)],
        frames: vec![frame(0, 1), frame(1, 3), frame(2, 4)],
        imu: (0..3000).map(imu).collect(),
    };
    let path = folder.file(Format::Aedat4);
    write(&path, Format::Aedat4, std::slice::from_ref(&packet)).unwrap();
    let mut got = read(&path).unwrap();
    assert_eq!(got, packet);
    got.frames[1].pixels[3] ^= 1;
    assert_ne!(got, packet, "canary: one bit of one pixel must be seen");
    let extent = measure(&mut *open(&path, &ReadOptions::default()).unwrap()).unwrap();
    assert_eq!((extent.frames, extent.imu, extent.triggers), (3, 3000, 2));
}

#[test]
fn bags_carry_images_and_inertial_samples() {
    let folder = Folder::new("bag");
    let frame = |k: i64, channels: u8| Frame {
        start_us: k * 1000,
        end_us: k * 1000,
        width: 32,
        height: 20,
        channels,
        pixels: (0..32 * 20 * u32::from(channels)).map(|v| (v * 7 + k as u32) as u8).collect(),
    };
    let imu = |k: i64| AedatImuSample {
        t: k * 10,
        acceleration: [0.1 * k as f32, -0.2, 9.0],
        rotation: [k as f32 / 7.0, 2.0, 3.0],
        ..AedatImuSample::default()
    };
    let packet = Packet {
        events: stream(0, 50),
        triggers: vec![Trigger::new(5, 0, true), Trigger::new(9, 3, false)],
        frames: vec![frame(0, 1), frame(1, 3), frame(2, 4)],
        imu: (0..3000).map(imu).collect(),
    };
    let path = folder.file(Format::Mcap);
    write(&path, Format::Mcap, std::slice::from_ref(&packet)).unwrap();
    let mut got = read(&path).unwrap();
    assert_eq!(got, packet);
    got.imu[7].rotation[0] += 1e-6;
    assert_ne!(got, packet, "canary: a small difference must be seen");
    // Of an image with an exposure, the middle.
    let exposed = Frame { start_us: 1000, end_us: 1300, ..frame(1, 1) };
    write(&path, Format::Mcap, &[Packet { frames: vec![exposed], ..Packet::default() }]).unwrap();
    let got = open(&path, &ReadOptions { camera: Some("/event_camera/events".into()), size: None });
    let (got, error) = read_all(&mut *got.unwrap());
    assert!(error.is_none());
    assert_eq!(got.frames.iter().map(|f| (f.start_us, f.end_us)).collect::<Vec<_>>(), [(1150, 1150)]);
}

#[test]
fn a_seek_finds_every_event_of_a_part() {
    let folder = Folder::new("seek");
    let events = stream(0, 6000);
    let last = events.last().unwrap().t;
    for format in Format::BOTH_WAYS {
        let path = folder.file(format);
        write(&path, format, &packets(&events, 5000)).unwrap();
        let at = |k: usize| events[events.len() * k / 10].t;
        let parts = [
            (i64::MIN, i64::MAX),
            (at(3), at(7)),
            (at(9), at(9) + 1),
            (at(1) + 1, at(2)),
            (last, last + 1),
            (last + 1, i64::MAX),
            (-5, at(1)),
        ];
        let mut whole = open(&path, &ReadOptions::default()).unwrap();
        for (from, to) in parts {
            let want: Vec<Event> = events.iter().filter(|e| from <= e.t && e.t < to).copied().collect();
            let reader = open(&path, &ReadOptions::default()).unwrap();
            let (got, error) = read_all(&mut Between::new(reader, from, to).unwrap());
            assert!(error.is_none() && same(&got.events, &want), "{format:?} {from}..{to}");
            // One reader goes forth and back.
            whole.seek(from).unwrap();
            let (got, error) = read_all(&mut *whole);
            let tail: Vec<Event> = got.events.iter().filter(|e| from <= e.t && e.t < to).copied().collect();
            assert!(error.is_none() && same(&tail, &want), "{format:?} {from}..{to}, again");
        }
    }
}

#[test]
fn a_seek_starts_near_its_time() {
    let folder = Folder::new("near");
    let events: Vec<Event> =
        (0..2_000_000).map(|t| Event::new(t, (t % 1280) as u16, (t % 719) as u16, Polarity::On)).collect();
    for format in [Format::Evt3, Format::Evt2, Format::Dat, Format::Aedat4, Format::Npy] {
        let path = folder.file(format);
        write(&path, format, &packets(&events, 1 << 20)).unwrap();
        let mut reader = open(&path, &ReadOptions::default()).unwrap();
        let mut packet = Packet::default();
        for t in [1_500_000, 500_000, 1_999_999] {
            reader.seek(t).unwrap();
            assert!(reader.read_packet(&mut packet).unwrap());
            let first = packet.events[0].t;
            assert!(first <= t && t - first < 100_000, "{format:?}: {first} for {t}");
        }
    }
}

#[test]
fn files_that_end_early_give_their_good_part_and_an_error() {
    let folder = Folder::new("short");
    let events = stream(0, 120);
    for format in Format::BOTH_WAYS {
        let path = folder.file(format);
        write(&path, format, &packets(&events, 100)).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let (mut errors, mut opened) = (0, 0);
        let step = (whole.len() / 400).max(1);
        for length in (0..whole.len()).step_by(step) {
            std::fs::write(&path, &whole[..length]).unwrap();
            let Ok(mut reader) = open(&path, &ReadOptions::default()) else {
                errors += 1;
                continue;
            };
            opened += 1;
            let (got, error) = read_all(&mut *reader);
            assert!(got.events.len() <= events.len(), "{format:?}, {length} bytes");
            let most = got.events.len();
            // The last line of a text may be cut within its last number.
            let sure =
                if matches!(format, Format::Text | Format::TextZip) { most.saturating_sub(1) } else { most };
            assert!(same(&got.events[..sure], &events[..sure]), "{format:?}, {length} bytes");
            if let Some(error) = error {
                errors += 1;
                let error = error.to_string();
                assert!(error.contains("at byte") || error.contains("at event"), "{error}");
            }
        }
        // An archive needs its end; the others are read up to where they end.
        let archive = matches!(format, Format::Npz | Format::TextZip);
        assert!(errors > 0 && (opened > 0) != archive, "{format:?}: {errors} errors, {opened} opened");
    }
}

#[test]
fn flipped_bits_never_break_the_reader() {
    let folder = Folder::new("flipped");
    let events = stream(0, 60);
    let packet = Packet {
        events,
        triggers: vec![Trigger::new(0, 0, true)],
        frames: vec![Frame { width: 8, height: 8, channels: 1, pixels: vec![1; 64], ..Frame::default() }],
        imu: vec![AedatImuSample::default(); 3],
    };
    for format in Format::BOTH_WAYS {
        let path = folder.file(format);
        let plain = Packet { events: packet.events.clone(), ..Packet::default() };
        write(&path, format, &[if format == Format::Aedat4 { packet.clone() } else { plain }]).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let (mut changed, mut refused) = (0, 0);
        let good = read(&path).unwrap();
        let step = (whole.len() / 500).max(1);
        for at in (0..whole.len()).step_by(step) {
            for mask in [1 << (at % 8), 0xFF, 0x80] {
                let mut bytes = whole.clone();
                bytes[at] ^= mask;
                std::fs::write(&path, bytes).unwrap();
                match read(&path) {
                    Ok(got) => changed += usize::from(got != good),
                    Err(error) => {
                        refused += 1;
                        assert!(!error.to_string().is_empty());
                    }
                }
            }
        }
        assert!(refused > 0 && changed > 0, "{format:?}: {refused} refused, {changed} changed");
    }
}

#[test]
fn sizes_that_a_file_only_claims_are_not_allocated() {
    let folder = Folder::new("claims");
    // An array of 2^59 events; a packet of 2 GiB; a table of 2^30 elements.
    let npy = folder.file(Format::Npy);
    write(&npy, Format::Npy, &packets(&stream(0, 20), 100)).unwrap();
    let mut bytes = std::fs::read(&npy).unwrap();
    let at = bytes.windows(10).position(|text| text == b"'shape': (").unwrap() + 10;
    bytes[at..at + 18].copy_from_slice(b"576460752303423488");
    bytes[at + 18..at + 22].copy_from_slice(b",),}");
    std::fs::write(&npy, bytes).unwrap();
    let (got, error) = read_all(&mut *open(&npy, &ReadOptions::default()).unwrap());
    let error = error.unwrap().to_string();
    assert!(!got.events.is_empty() && error.contains("of 576460752303423488"), "{error}");

    let aedat = folder.file(Format::Aedat4);
    write(&aedat, Format::Aedat4, &packets(&stream(0, 20), 100)).unwrap();
    let whole = std::fs::read(&aedat).unwrap();
    let at = whole.windows(4).position(|bytes| bytes == b"EVTS").unwrap();
    let first = whole[at + 4..].windows(4).position(|bytes| bytes == b"EVTS").map_or(at, |k| at + 4 + k);
    for claim in [i32::MAX, -1, 1 << 30] {
        let mut bytes = whole.clone();
        // Size of the packet, 4 bytes before its length, 8 before its root and identifier.
        let size = first - 12;
        bytes[size..size + 4].copy_from_slice(&claim.to_le_bytes());
        std::fs::write(&aedat, bytes).unwrap();
        let error = read(&aedat).unwrap_err().to_string();
        assert!(error.contains("at byte") && error.contains("bytes long"), "{error}");
    }
}

#[test]
fn what_a_format_cannot_hold_is_refused() {
    let folder = Folder::new("refused");
    let on = |t, x, y| Event::new(t, x, y, Polarity::On);
    for format in Format::BOTH_WAYS {
        let path = folder.file(format);
        let signed = matches!(format, Format::Text | Format::TextZip | Format::Npz | Format::Npy);
        for (events, what) in [
            (vec![on(5, 0, 0), on(4, 0, 0)], "event 1 at 4 us is earlier than 5 us"),
            (vec![on(0, 1280, 0)], "event 0 x 1280, y 0 lies outside of 1280x720"),
            (vec![on(0, 0, 720)], "lies outside of 1280x720"),
            (vec![on(-1, 0, 0)], if signed { "" } else { "event 0 is at -1 us" }),
        ] {
            let written = write(&path, format, &packets(&events, 10));
            match written {
                Ok(()) => assert!(what.is_empty(), "{format:?} took {events:?}"),
                Err(error) => assert!(!what.is_empty() && error.to_string().contains(what), "{error}"),
            }
        }
        // A writer that is dropped leaves nothing, and an old file stays.
        std::fs::write(&path, b"old").unwrap();
        let options = WriteOptions { size: SIZE, overwrite: false };
        assert!(matches!(create(&path, format, &options), Err(FormatError::Exists { .. })));
        drop(create(&path, format, &WriteOptions { overwrite: true, ..options }).unwrap());
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(&folder.0).unwrap().count(), 1, "a draft was left behind");
        std::fs::remove_file(&path).unwrap();
    }
    let huge = WriteOptions { size: (4096, 2160), overwrite: true };
    let error = create(&folder.file(Format::Evt3), Format::Evt3, &huge).err().unwrap().to_string();
    assert!(error.contains("4096x2160") && error.contains("2048x2048"), "{error}");
    let error = create(&folder.file(Format::Aedat2), Format::Aedat2, &huge).err().unwrap().to_string();
    assert!(error.contains("no chip of 4096x2160"), "{error}");
}

#[test]
fn content_tells_the_format_and_names_do_not() {
    let folder = Folder::new("content");
    for (name, bytes, format) in [
        ("a.raw", &b"0.1 2 3 1\n"[..], Some(Format::Text)),
        ("b.txt", b"% evt 3.0\n% end\n", Some(Format::Evt3)),
        ("c.txt", b"% evt 2.0\n% geometry 4x4\n% end\n", Some(Format::Evt2)),
        ("d.npy", b"#!AER-DAT2.0\r\n", Some(Format::Aedat2)),
        ("e.npy", b"\x89PNG", None),
        ("f.raw", b"", None),
        ("g.raw", b"% evt 4.0\n% end\n", None),
    ] {
        let path = folder.0.join(name);
        std::fs::write(&path, bytes).unwrap();
        assert_eq!(recognise(&path).unwrap(), format, "{name}");
        if format.is_none() {
            let error = open(&path, &ReadOptions::default()).err().unwrap().to_string();
            assert!(error.contains("no known event format") && error.contains("EVT 3.0"), "{error}");
        }
    }
    assert!(open(Path::new("/nowhere/at-all"), &ReadOptions::default()).is_err());
}

#[test]
fn aedat2_has_the_addresses_of_jaer() {
    let folder = Folder::new("aedat2");
    let path = folder.file(Format::Aedat2);
    for (size, event, address) in [
        ((346, 260), Event::new(7, 0, 0, Polarity::On), 345_u32 << 12 | 259 << 22 | 1 << 11),
        ((640, 480), Event::new(7, 639, 479, Polarity::Off), 0),
    ] {
        let mut writer = create(&path, Format::Aedat2, &WriteOptions { size, overwrite: true }).unwrap();
        writer.write_events(&[event]).unwrap();
        writer.finish().unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let mut want = address.to_be_bytes().to_vec();
        want.extend(7_u32.to_be_bytes());
        assert!(bytes.starts_with(b"#!AER-DAT2.0\r\n") && bytes.ends_with(&want));
        // The header ends with its last line: the byte after it is no '#'.
        let header = bytes.len() - 8;
        assert!(bytes[header - 2..header] == *b"\r\n");
    }
    // A row whose address starts with '#' would continue the header.
    let mut writer =
        create(&path, Format::Aedat2, &WriteOptions { size: (346, 260), overwrite: true }).unwrap();
    writer.write_events(&[Event::new(7, 0, 259 - 141, Polarity::On)]).unwrap();
    writer.finish().unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let rows: Vec<&[u8]> = bytes[bytes.len() - 16..].chunks(8).collect();
    assert_eq!((rows[1][0], rows[0][..4].to_vec()), (b'#', vec![0, 0, 4, 0]));
}

#[test]
fn a_conversion_cuts_crops_and_flips() {
    let folder = Folder::new("convert");
    let events = stream(0, 2000);
    let (from, to) = (folder.file(Format::Evt3), folder.file(Format::Npy));
    write(&from, Format::Evt3, &packets(&events, 1000)).unwrap();
    let options = ConvertOptions {
        start_us: 1_000_000,
        end_us: 100_000_000,
        crop: Some([100, 50, 800, 600]),
        flip_x: true,
        flip_y: true,
        shift_us: -1_000_000,
        ..ConvertOptions::default()
    };
    let size = options.size(SIZE);
    let writer = create(&to, Format::Npy, &WriteOptions { size, overwrite: true }).unwrap();
    let reader = open(&from, &ReadOptions::default()).unwrap();
    let converted = convert(reader, writer, SIZE, &options, |_| true).unwrap();
    let want: Vec<Event> = events
        .iter()
        .filter(|e| (1_000_000..100_000_000).contains(&e.t))
        .filter(|e| (100..900).contains(&e.x) && (50..650).contains(&e.y))
        .map(|e| {
            let polarity = if e.p == 1 { Polarity::On } else { Polarity::Off };
            Event::new(e.t - 1_000_000, 799 - (e.x - 100), 599 - (e.y - 50), polarity)
        })
        .collect();
    assert!(want.len() > 1000 && converted.events == want.len() as u64);
    assert!(same(&read(&to).unwrap().events, &want));
    assert!(!options.fits((899, 720)) && options.fits((900, 650)));
}

#[test]
fn what_comes_before_damage_is_kept_on_request() {
    let folder = Folder::new("damage");
    let events = stream(0, 500);
    for format in [Format::Evt3, Format::Dat, Format::Aedat4, Format::Text, Format::Npy] {
        let (from, to) = (folder.file(format), folder.0.join("kept"));
        write(&from, format, &packets(&events, 300)).unwrap();
        let bytes = std::fs::read(&from).unwrap();
        // An odd number of bytes is missing, so that no word and no row ends there.
        std::fs::write(&from, &bytes[..bytes.len() - ((bytes.len() / 2) | 1)]).unwrap();
        let attempt = |until_damage| {
            let options = ConvertOptions { until_damage, ..ConvertOptions::default() };
            let writer = create(&to, Format::Npz, &WriteOptions { size: SIZE, overwrite: true }).unwrap();
            let reader = open(&from, &ReadOptions::default()).unwrap();
            convert(reader, writer, SIZE, &options, |_| true)
        };
        // Without the request there is an error, and no file.
        assert!(attempt(false).is_err() && !to.exists(), "{format}");
        let converted = attempt(true).unwrap();
        assert!(converted.damage.is_some_and(|damage| damage.contains("at byte")), "{format}");
        let kept = read(&to).unwrap().events;
        assert!(kept.len() > events.len() / 4 && kept.len() < events.len(), "{format}: {}", kept.len());
        assert!(same(&kept, &events[..kept.len()]), "{format}");
        std::fs::remove_file(&to).unwrap();
    }
}

#[test]
fn a_folder_of_dsec_holds_the_events_of_any_file() {
    let folder = Folder::new("dsec");
    let events = stream(0, 500);
    let own = folder.0.join("sequence");
    write(&own, Format::Dsec, &packets(&events, 300)).unwrap();
    assert!(own.join("events/left/events.h5").is_file());
    assert_eq!(recognise(&own).unwrap(), Some(Format::Dsec));
    let mut reader = open(&own, &ReadOptions::default()).unwrap();
    assert_eq!(reader.info().size, Some(SIZE));
    let (packet, error) = read_all(&mut *reader);
    assert!(error.is_none() && same(&packet.events, &events));
    assert!(!same(&packet.events, &events[1..]), "the comparison can fail");
    // An old folder is not overwritten unasked.
    let again = create(&own, Format::Dsec, &WriteOptions { size: SIZE, overwrite: false });
    assert!(matches!(again, Err(FormatError::Exists { .. })));
}

#[test]
fn bags_hold_images_and_inertial_samples_beside_events() {
    let folder = Folder::new("bag");
    let path = folder.file(Format::Mcap);
    let events = stream(1_000_000, 200);
    let frame = Frame {
        start_us: 1_000_000,
        end_us: 1_000_400,
        width: 3,
        height: 2,
        channels: 1,
        pixels: vec![7, 77, 177, 201, 202, 203],
    };
    let sample = AedatImuSample { t: 1_000_007, acceleration: [1.0, 0.0, 0.0], ..AedatImuSample::default() };
    let mut parts = packets(&events, 100);
    parts[0].frames.push(frame.clone());
    parts[0].imu.push(sample);
    write(&path, Format::Mcap, &parts).unwrap();
    assert!(same(&read(&path).unwrap().events, &events));
    let bytes = std::fs::read(&path).unwrap();
    let holds = |part: &[u8]| bytes.windows(part.len()).any(|window| window == part);
    // Encoding, byte order, step and pixels as CDR has them: the text ends at an odd place.
    let image =
        [b"mono8\0\0\0".as_slice(), &3_u32.to_le_bytes(), &6_u32.to_le_bytes(), &frame.pixels].concat();
    assert!(holds(&image) && holds(b"/event_camera/image_raw"));
    assert!(holds(b"/event_camera/imu") && holds(&9.806_65_f64.to_le_bytes()));
    // Files of events alone have no such topics.
    write(&path, Format::Mcap, &packets(&events, 100)).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    assert!(!bytes.windows(9).any(|window| window == b"image_raw"));
    // What does not fit is refused.
    for wrong in [Frame { channels: 2, ..frame.clone() }, Frame { start_us: -1, ..frame }] {
        let part = Packet { frames: vec![wrong], ..Packet::default() };
        assert!(write(&path, Format::Mcap, &[part]).is_err());
    }
}

#[test]
fn bytes_that_carry_nothing_do_not_come_along_from_numpy() {
    let folder = Folder::new("padding");
    let path = folder.file(Format::Npy);
    let events = stream(0, 50);
    write(&path, Format::Npy, &packets(&events, 100)).unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    let start = bytes.len() - events.len() * size_of::<Event>();
    bytes[start + 6] = 0xAB;
    std::fs::write(&path, &bytes).unwrap();
    // Equal as bytes, as all streams are.
    assert!(read(&path).unwrap().events == events);
    // Polarities of -1 are OFF; others are none.
    let off = events.iter().position(|event| event.p == 0).unwrap();
    for (value, good) in [(-1_i16, true), (-2, false), (2, false)] {
        let at = start + off * size_of::<Event>() + 4;
        bytes[at..at + 2].copy_from_slice(&value.to_le_bytes());
        std::fs::write(&path, &bytes).unwrap();
        let (packet, error) = read_all(&mut *open(&path, &ReadOptions::default()).unwrap());
        assert_eq!(error.is_none(), good, "{value}");
        assert!(packet.events == events[..if good { events.len() } else { off }], "{value}");
    }
}
