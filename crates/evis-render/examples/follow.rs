//! Pixels of decoupled sampling followed by compute passes and by the processor: how alike, and at what cost.
//!
//! `cargo run --release -p evis-render --example follow -- SCENE WIDTHxHEIGHT SECONDS [SENSOR] [DEVICE]`
//!
//! Cost is processor time, of a driver in software that of its threads: it is meaningless of a graphics card. A short run before that
//! is counted lets the driver compile.

#[path = "../../evis-decoupled/examples/clock/mod.rs"]
mod clock;

use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use evis_core::{Event, SensorConfig};
use evis_decoupled::packed::{self, Block};
use evis_decoupled::{Device, Devices, Error, Settings, Stages, ViewSensor, simulate};
use evis_render::{Followers, Gpu};

/// What blocks took on a device.
#[derive(Debug, Default)]
struct Taken {
    wall: Duration,
    /// Processor time in seconds.
    cpu: f64,
    blocks: u64,
    pixels: u64,
    bytes: u64,
    /// Beside these, of light that stays on the device.
    light: u64,
}

/// Devices that are timed.
#[derive(Debug)]
struct Timed(Followers, Arc<Mutex<Taken>>);

struct TimedDevice(Box<dyn Device>, Arc<Mutex<Taken>>);

impl Devices for Timed {
    fn texture_room(&self) -> usize {
        self.0.texture_room()
    }

    fn open(&self, textures: &packed::Textures, views: &[ViewSensor]) -> Result<Box<dyn Device>, Error> {
        Ok(Box::new(TimedDevice(self.0.open(textures, views)?, Arc::clone(&self.1))))
    }
}

impl Device for TimedDevice {
    fn room(&self) -> usize {
        self.0.room()
    }

    fn stages(&mut self) -> Option<&mut dyn Stages> {
        self.0.stages()
    }

    fn follow(&mut self, block: &mut Block) -> Result<packed::Found, Error> {
        let (started, before) = (Instant::now(), clock::cpu_seconds());
        let found = self.0.follow(block)?;
        let mut taken = self.1.lock().map_err(|_| Error::Device("a panic".into()))?;
        taken.wall += started.elapsed();
        taken.cpu += clock::cpu_seconds() - before;
        taken.blocks += 1;
        taken.pixels += block.pixel_count() as u64;
        let returned = [
            size_of_val(&block.pixels[..]),
            size_of_val(&found.light[..]),
            size_of_val(&found.events[..]),
            size_of_val(&found.failed[..]),
        ];
        taken.bytes += block.sent_bytes().into_iter().chain(returned).sum::<usize>() as u64;
        taken.light += if block.light_stays { 4 * block.light as u64 } else { 0 };
        Ok(found)
    }
}

/// Times and polarities of each pixel.
fn by_pixel(events: &[Event]) -> HashMap<(u16, u16), Vec<(i64, bool)>> {
    let mut out: HashMap<_, Vec<_>> = HashMap::new();
    for e in events {
        out.entry((e.x, e.y)).or_default().push((e.t, e.p > 0));
    }
    out
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let usage = "usage: follow SCENE WIDTHxHEIGHT SECONDS [SENSOR] [DEVICE]";
    let name = args.next().ok_or(usage)?;
    let size = args.next().ok_or(usage)?;
    let (w, h) = size.split_once('x').ok_or(usage)?;
    let size = Some((w.parse()?, h.parse()?));
    let duration_us = (args.next().ok_or(usage)?.parse::<f64>()? * 1e6).round() as i64;
    let sensor = args.next().map_or(Ok(SensorConfig::default()), |name| SensorConfig::preset(&name))?;
    let gpu = Gpu::open(args.next().as_deref())?;
    let scene = evis_scene::source::load(&name, 0)?;
    let usual = Settings { size, duration_us, sensor, ..Settings::default() };
    let taken = Arc::new(Mutex::new(Taken::default()));
    let devices = Some(Arc::new(Timed(Followers::new(&gpu)?, Arc::clone(&taken))) as Arc<dyn Devices>);
    let run = |settings: &Settings| {
        let started = Instant::now();
        simulate(&scene, settings).map(|out| (out, started.elapsed().as_secs_f64()))
    };
    let (own, own_s) = run(&usual)?;
    let with_device = Settings { devices, ..usual };
    run(&Settings { duration_us: 1000, ..with_device.clone() })?;
    *taken.lock().map_err(|_| "a panic")? = Taken::default();
    let (other, other_s) = run(&with_device)?;
    let (r, q) = (own.report, other.report);
    let taken = taken.lock().map_err(|_| "a panic")?;
    println!("{name} {w}x{h} on the processor: {} events, {own_s:.2} s", own.events.len());
    println!("on {}: {} events, {other_s:.2} s", gpu.summary().name, other.events.len());
    let each = |seconds: f64, evaluations: u64| 1e6 * seconds / evaluations.max(1) as f64;
    println!(
        "an evaluation takes {:.3} core-us on the processor ({} of them), {:.3} in the driver ({})",
        each(r.pixels_s, r.evaluations),
        r.evaluations,
        each(taken.cpu, q.on_device),
        q.on_device
    );
    println!(
        "in {} blocks on the device {:.2} s of {other_s:.2} s, {:.0} pixels and {:.2} MB per block, and {:.2} of light stay there; {} \
         pixels times blocks were left to the processor",
        taken.blocks,
        taken.wall.as_secs_f64(),
        taken.pixels as f64 / taken.blocks.max(1) as f64,
        taken.bytes as f64 / taken.blocks.max(1) as f64 * 1e-6,
        taken.light as f64 / taken.blocks.max(1) as f64 * 1e-6,
        q.refollowed
    );
    let (a, b) = (by_pixel(&own.events), by_pixel(&other.events));
    let (mut same, mut off) = (0, Vec::new());
    for (place, times) in &a {
        let Some(others) = b.get(place).filter(|o| o.iter().map(|e| e.1).eq(times.iter().map(|e| e.1)))
        else {
            continue;
        };
        same += 1;
        off.extend(times.iter().zip(others).map(|(a, b)| (a.0 - b.0).abs()));
    }
    off.sort_unstable();
    let at = |part: f64| off.get((part * off.len() as f64) as usize).copied().unwrap_or_default();
    println!(
        "{same} of {} pixels fire the same polarities; half of their {} events are within {} us, 90 % within {}, 99 % within {}",
        a.len(),
        off.len(),
        at(0.5),
        at(0.9),
        at(0.99)
    );
    Ok(())
}
