//! What another engine takes from this sensor: what is frozen about pixels, noise candidates, and the readout.
//!
//! A shader that walks pixels needs thresholds, candidates of noise and a readout that are the emulator's, bit for bit.

use rayon::prelude::*;

pub use super::keyframes::{Gap, Pictures, Scratch, Side};

pub use super::chain::{FixedPattern, JITTER_SHIFT};
use super::frames::TILE;
use super::noise::{Candidate, TileNoise};
use super::numbering::Numbering;
use super::readout::{self, delay_us};
use super::{EmulatorConfig, EventEmulator};
pub use crate::event::Cause;
use crate::event::{Event, Polarity};
use crate::random::Key;
use crate::sensor::{ConfigError, Readout, SensorConfig};
use crate::simd::Isa;

/// An emulator of one environment whose randomness is that of `key`; seed and camera of `config` are not read.
///
/// # Errors
/// As [`EventEmulator::new`].
pub fn emulator(config: EmulatorConfig, key: Key) -> Result<EventEmulator, ConfigError> {
    EventEmulator::keyed(EmulatorConfig { batch: 1, ..config }, |_| key)
}

/// A time at which noise may cause an event of a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseCandidate {
    /// Row-major index.
    pub pixel: u32,
    /// Microseconds of the stream.
    pub t_us: i64,
    /// It happens where the pixel's light, relative to `Y_ref`, is below this; infinite for always.
    pub light_below: f32,
    /// Its polarity; where `relative`, that of a pixel's first event.
    pub polarity: Polarity,
    /// Whether its polarity is that of the pixel's last event (`Off`) or the other one (`On`).
    pub relative: Option<Polarity>,
    /// Why.
    pub cause: Cause,
    /// It happens where the pixel's last event is at least so long ago, in units of 16 us; below 2^18.
    pub rest: u32,
}

/// The noise of one camera's pixels.
#[derive(Clone, Debug)]
pub struct NoiseSampler {
    sensor: SensorConfig,
    key: Key,
    isa: Isa,
    pixels: usize,
    tiles: Vec<TileNoise>,
}

impl NoiseSampler {
    /// The noise of the pixels whose thresholds these are; `None` without noise that has times of its own.
    pub fn new(sensor: &SensorConfig, key: Key, frozen: &FixedPattern) -> Option<Self> {
        let pixels = frozen.on.len();
        let noise = &sensor.noise;
        let poisson_leak = noise.leak_hz > 0.0 && !super::chain::ramps(sensor);
        if !(poisson_leak || noise.shot_hz > 0.0 || (noise.hot_share > 0.0 && noise.hot_hz > 0.0)) {
            return None;
        }
        let tile = |(i, (on, off)): (usize, (&[f32], &[f32]))| {
            TileNoise::new(sensor, key, Numbering::run(i * TILE), on, off)
        };
        let tiles = frozen.on.par_chunks(TILE).zip(frozen.off.par_chunks(TILE)).enumerate().map(tile);
        let tiles = tiles.collect();
        Some(Self { sensor: sensor.clone(), key, isa: Isa::detect(), pixels, tiles })
    }

    /// Candidates in `(start_us, end_us]`, by pixel and time.
    pub fn candidates(&mut self, start_us: i64, end_us: i64) -> impl Iterator<Item = NoiseCandidate> + '_ {
        let Self { sensor, key, isa, pixels, tiles } = self;
        let noise = &sensor.noise;
        tiles.par_iter_mut().enumerate().for_each(|(i, tile)| {
            let first = i * TILE;
            let numbering = Numbering::run(first);
            tile.gather(*isa, noise, *key, (numbering, (*pixels - first).min(TILE)), (start_us, end_us));
        });
        tiles.iter().enumerate().flat_map(move |(i, tile)| {
            let settled_at = move |candidate: &Candidate| {
                let settled = candidate.settle(noise, &tile.rates(candidate.pixel as usize));
                NoiseCandidate {
                    pixel: (i * TILE) as u32 + candidate.pixel,
                    t_us: candidate.t_us,
                    light_below: settled.light_below,
                    polarity: settled.polarity,
                    relative: settled.relative,
                    cause: settled.cause,
                    rest: settled.rest,
                }
            };
            tile.now.iter().map(settled_at)
        })
    }
}

/// Events of one camera on their way out.
#[derive(Clone, Debug)]
pub struct ReadoutQueue {
    readout: Readout,
    key: Key,
    width: u32,
    queue: readout::Queue,
}

impl ReadoutQueue {
    /// A bus with nothing on it, of a sensor with rows of `width` pixels.
    pub fn new(readout: &Readout, key: Key, width: u32) -> Self {
        Self { readout: *readout, key, width, queue: readout::Queue::default() }
    }

    /// Takes what left its pixel until `end_us`, in firing order per pixel; what leaves the sensor until then is appended
    /// to `out`, in canonical order. Gives how many the rate limit dropped.
    pub fn pass(&mut self, fired: &mut Vec<Event>, end_us: i64, out: &mut Vec<Event>) -> u64 {
        for event in fired.iter_mut() {
            let pixel = u32::from(event.y) * self.width + u32::from(event.x);
            event.t += i64::from(delay_us(&self.readout, self.key, pixel, event.t));
        }
        self.take(fired, end_us, out)
    }

    /// The same of what has been delayed already.
    pub fn take(&mut self, fired: &mut Vec<Event>, end_us: i64, out: &mut Vec<Event>) -> u64 {
        self.queue.pass(&self.readout, fired, end_us, out)
    }
}
