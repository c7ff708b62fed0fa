//! What the processor does for a device that follows pixels: with one that leaves them as they are.
//!
//! `cargo run --release -p evis-decoupled --example host -- SCENE WIDTHxHEIGHT SECONDS`
//!
//! CPU time of the process while it simulates, from /proc/self/stat.

mod clock;

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use evis_decoupled::packed::{Block, Found, Textures};
use evis_decoupled::{Device, Devices, Error, Settings, ViewSensor, simulate};

/// Bytes that an array of a block may take, as those of real devices.
const ROOM: usize = 64 << 20;

/// Devices that count what they are given.
#[derive(Debug, Default)]
struct Idle(Arc<Given>);

#[derive(Debug, Default)]
struct Given {
    pixels: AtomicU64,
    /// See [`Block::sent_bytes`].
    bytes: [AtomicU64; 5],
}

struct IdleDevice(Arc<Given>);

impl Devices for Idle {
    fn texture_room(&self) -> usize {
        ROOM
    }

    fn open(&self, _: &Textures, _: &[ViewSensor]) -> Result<Box<dyn Device>, Error> {
        Ok(Box::new(IdleDevice(Arc::clone(&self.0))))
    }
}

impl Device for IdleDevice {
    fn room(&self) -> usize {
        ROOM
    }

    fn follow(&mut self, block: &mut Block) -> Result<Found, Error> {
        self.0.pixels.fetch_add(block.pixel_count() as u64, Ordering::Relaxed);
        for (sum, bytes) in self.0.bytes.iter().zip(block.sent_bytes()) {
            sum.fetch_add(bytes as u64, Ordering::Relaxed);
        }
        Ok(Found { light: vec![0.0; block.light], ..Found::default() })
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let usage = "usage: host SCENE WIDTHxHEIGHT SECONDS";
    let name = args.next().ok_or(usage)?;
    let size = args.next().ok_or(usage)?;
    let (w, h) = size.split_once('x').ok_or(usage)?;
    let size = Some((w.parse()?, h.parse()?));
    let seconds = args.next().ok_or(usage)?.parse::<f64>()?;
    let scene = evis_scene::source::load(&name, 0)?;
    let devices = Idle::default();
    let given = Arc::clone(&devices.0);
    let duration_us = (seconds * 1e6).round() as i64;
    // Nothing fires, so that pixels keep their first reference: they are quiet where light returns to it.
    let settings = Settings { size, duration_us, reference_luminance: Some(1.0), ..Settings::default() };
    let before = clock::cpu_seconds();
    let r = simulate(&scene, &Settings { devices: Some(Arc::new(devices)), ..settings })?.report;
    let cpu = clock::cpu_seconds() - before;
    let wall = r.lists_s + r.light_s + r.pixels_s;
    let share = |s: f64| cpu / seconds * s / wall;
    let per_block = 0.032_768 / seconds;
    let megabytes = given.bytes.each_ref().map(|sum| sum.load(Ordering::Relaxed) as f64 * per_block * 1e-6);
    let resting = 100.0 * r.resting as f64 / r.pixel_blocks.max(1) as f64;
    println!(
        "{name} {w}x{h}: {:.2} core-seconds per simulated second (lists {:.2}, light {:.2}, tiles {:.2}); {:.0} pixels per block, MB of \
         entries, words and tiles, points, pixels and what is kept: {megabytes:.1?}, {:.0} places shaded; {resting:.1} % of pixels' blocks rest",
        cpu / seconds,
        share(r.lists_s),
        share(r.light_s),
        share(r.pixels_s),
        given.pixels.load(Ordering::Relaxed) as f64 * per_block,
        r.places as f64 * per_block,
    );
    Ok(())
}
