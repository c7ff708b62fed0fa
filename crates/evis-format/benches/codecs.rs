//! Events per second and core, each way, in time on the processor: `cargo bench -p evis-format`.
//!
//! Files lie in memory where the system has /dev/shm, so that the disk is not measured. The first row copies events as
//! they lie in memory to such a file and back: what memory allows. HDF5 works on all cores, so that it counts by the
//! clock, and by how many of them it keeps busy.

use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use evis_core::Polarity;
use evis_format::{Event, EventReader, Format, FormatError, Packet, ReadOptions, WriteOptions, create, open};

const SIZE: (u32, u32) = (1280, 720);

/// Time that this thread was on the processor; wall time where the system does not say.
struct Clock(Instant);

impl Clock {
    fn now(&self) -> Duration {
        let stat = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
        let nanoseconds = stat.and_then(|stat| stat.split(' ').next()?.parse().ok());
        nanoseconds.map_or_else(|| self.0.elapsed(), Duration::from_nanos)
    }
}

/// Scattered pixels, 50 events per microsecond group on average 0.4 us apart, or rows of neighbours.
fn stream(count: usize, rows: bool) -> Vec<Event> {
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    let mut below = |end: u64| {
        state ^= state >> 12;
        state ^= state << 25;
        state ^= state >> 27;
        (state.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 33) % end
    };
    let mut events = Vec::with_capacity(count);
    let mut t = 0;
    while events.len() < count {
        t += below(3) as i64;
        let y = below(u64::from(SIZE.1)) as u16;
        let polarity = if below(2) == 0 { Polarity::Off } else { Polarity::On };
        if rows {
            let x = below(1200) as u16;
            events.extend((0..24).filter(|k| k % 3 != 2).map(|k| Event::new(t, x + k, y, polarity)));
        } else {
            events.push(Event::new(t, below(u64::from(SIZE.0)) as u16, y, polarity));
        }
    }
    events.sort_by_key(Event::order);
    events
}

/// Time of all threads of this process on processors; nothing where the system does not say.
fn process_time() -> Option<Duration> {
    let mut total = Duration::ZERO;
    // A thread that ended is gone from here; the pool's stay.
    for thread in std::fs::read_dir("/proc/self/task").ok()? {
        let stat = std::fs::read_to_string(thread.ok()?.path().join("schedstat")).ok()?;
        total += Duration::from_nanos(stat.split(' ').next()?.parse().ok()?);
    }
    Some(total)
}

fn written(path: &Path, format: Format, events: &[Event]) -> Result<(), FormatError> {
    let mut writer = create(path, format, &WriteOptions { size: SIZE, overwrite: true })?;
    for part in events.chunks(100_000) {
        writer.write_events(part)?;
    }
    writer.finish()
}

fn read(path: &Path) -> Result<usize, FormatError> {
    let (mut packet, mut count) = (Packet::default(), 0);
    let mut reader = open(path, &ReadOptions { camera: None, size: Some(SIZE) })?;
    while reader.read_packet(&mut packet)? {
        count += packet.events.len();
    }
    Ok(count)
}

/// Copies events as they are to a file and back.
fn copied(path: &Path, events: &[Event]) -> std::io::Result<()> {
    let mut file = File::create(path)?;
    events.chunks(100_000).try_for_each(|part| file.write_all(bytemuck::cast_slice(part)))
}

fn copied_back(path: &Path) -> std::io::Result<usize> {
    let (mut file, mut block, mut count) = (File::open(path)?, vec![Event::default(); 32 << 10], 0);
    loop {
        match file.read(bytemuck::cast_slice_mut(&mut block))? {
            0 => return Ok(count / size_of::<Event>()),
            size => count += size,
        }
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let memory = PathBuf::from("/dev/shm");
    let folder = if memory.is_dir() { memory } else { std::env::temp_dir() };
    let path = folder.join(format!("evis-bench-{}", std::process::id()));
    let clock = Clock(Instant::now());
    let timed = |run: &mut dyn FnMut() -> Result<(), Box<dyn std::error::Error>>| {
        let mut least = f64::MAX;
        for _ in 0..5 {
            let start = clock.now();
            run()?;
            least = least.min((clock.now() - start).as_secs_f64());
        }
        Ok::<_, Box<dyn std::error::Error>>(least)
    };
    println!("million events per second of processor time; bytes per event");
    println!("{:<22}{:>8}{:>8}{:>8}", "format", "write", "read", "bytes");
    let row = |name: &str, events: &[Event], write: f64, read: f64| {
        let millions = events.len() as f64 / 1.0e6;
        let bytes = std::fs::metadata(&path).map_or(0, |file| file.len()) as f64 / events.len() as f64;
        println!("{name:<22}{:>8.0}{:>8.0}{bytes:>8.2}", millions / write, millions / read);
    };
    let events = stream(8_000_000, false);
    let write = timed(&mut || Ok(copied(&path, &events)?))?;
    let back = timed(&mut || {
        assert_eq!(copied_back(&path)?, events.len());
        Ok(())
    })?;
    row("copy of 16 bytes", &events, write, back);
    let cases = [
        (Format::Evt3, false),
        (Format::Evt3, true),
        (Format::Evt2, false),
        (Format::Dat, false),
        (Format::Npy, false),
        (Format::Aedat4, false),
        (Format::Es, false),
        (Format::Mcap, false),
        (Format::Text, false),
        (Format::Npz, false),
    ];
    for (format, rows) in cases {
        let slow = matches!(format, Format::Text | Format::Npz);
        let events = stream(if slow { 1_000_000 } else { 8_000_000 }, rows);
        let write = timed(&mut || Ok(written(&path, format, &events)?))?;
        let back = timed(&mut || {
            assert_eq!(read(&path)?, events.len());
            Ok(())
        })?;
        row(&format!("{}{}", format.name(), if rows { ", rows" } else { "" }), &events, write, back);
    }
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    println!("HDF5 with gzip by the clock, million events/s; cores in use of {cores}");
    for (name, rows) in [("hdf5", false), ("hdf5, rows", true)] {
        let events = stream(8_000_000, rows);
        let (mut best, mut busy) = (f64::MAX, 0.0);
        for _ in 0..3 {
            let (start, work) = (Instant::now(), process_time());
            written(&path, Format::Hdf5, &events)?;
            let wall = start.elapsed();
            if wall.as_secs_f64() < best {
                best = wall.as_secs_f64();
                let work = process_time()
                    .zip(work)
                    .map_or(0.0, |(after, before)| after.saturating_sub(before).as_secs_f64());
                busy = work / best;
            }
        }
        let back = timed(&mut || {
            assert_eq!(read(&path)?, events.len());
            Ok(())
        })?;
        let millions = events.len() as f64 / 1.0e6;
        println!("{name:<22}{:>8.1}{:>8.1}{busy:>8.2}", millions / best, millions / back);
    }
    std::fs::remove_file(&path)?;
    Ok(())
}
