//! Events per second and core, each way, in time on the processor: `cargo bench -p evis-format`.
//!
//! Files lie in memory where the system has /dev/shm, so that the disk is not measured.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use evis_core::Polarity;
use evis_format::{Event, EventReader, Format, Packet, ReadOptions, WriteOptions, create, open};

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

fn main() {
    let memory = PathBuf::from("/dev/shm");
    let folder = if memory.is_dir() { memory } else { std::env::temp_dir() };
    let path = folder.join(format!("evis-bench-{}", std::process::id()));
    let clock = Clock(Instant::now());
    println!("million events per second of processor time; bytes per event");
    println!("{:<22}{:>8}{:>8}{:>8}", "format", "write", "read", "bytes");
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
        let (mut write, mut read) = (f64::MAX, f64::MAX);
        for _ in 0..3 {
            let start = clock.now();
            let mut writer = match create(&path, format, &WriteOptions { size: SIZE, overwrite: true }) {
                Ok(writer) => writer,
                Err(error) => return eprintln!("{error}"),
            };
            for part in events.chunks(100_000) {
                if let Err(error) = writer.write_events(part) {
                    return eprintln!("{error}");
                }
            }
            if let Err(error) = writer.finish() {
                return eprintln!("{error}");
            }
            write = write.min((clock.now() - start).as_secs_f64());
            let start = clock.now();
            let mut packet = Packet::default();
            let mut count = 0;
            match open(&path, &ReadOptions { camera: None, size: Some(SIZE) }) {
                Ok(mut reader) => {
                    while reader.read_packet(&mut packet).unwrap_or(false) {
                        count += packet.events.len();
                    }
                }
                Err(error) => return eprintln!("{error}"),
            }
            assert_eq!(count, events.len());
            read = read.min((clock.now() - start).as_secs_f64());
        }
        let millions = events.len() as f64 / 1.0e6;
        let bytes = std::fs::metadata(&path).map_or(0, |file| file.len()) as f64 / events.len() as f64;
        let name = format!("{}{}", format.name(), if rows { ", rows" } else { "" });
        println!("{name:<22}{:>8.0}{:>8.0}{bytes:>8.2}", millions / write, millions / read);
    }
    let _ = std::fs::remove_file(&path);
}
