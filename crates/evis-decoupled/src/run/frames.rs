//! Sensors whose stages are defined on frames: they take pictures of the light at a fixed rate.

use evis_core::emulator::parts::emulator;
use evis_core::emulator::tiled::Losses;
use evis_core::emulator::{EmulatorConfig, EventEmulator, Frames};
use evis_core::event::Cause;
use evis_core::random::Key;
use evis_core::{ConfigError, Event, SensorConfig, TimeGrid};
use rayon::prelude::*;

use crate::scene::tiles::{PIXELS, TILE};
use crate::signal::knots::TileSignal;
use crate::visibility::blocks::Block;

/// Most frames of a block: their pictures are all held.
const MOST_FRAMES: f64 = 64.0;
/// The shortest block, in microseconds.
const SHORTEST_US: i64 = 64;

/// The length of a block in which at most [`MOST_FRAMES`] frames are taken: `most_us` or a lesser power of two.
pub(crate) fn block_us(most_us: i64, rate_hz: f64) -> i64 {
    let mut block_us = most_us;
    while block_us > SHORTEST_US && block_us as f64 * 1e-6 * rate_hz > MOST_FRAMES {
        block_us /= 2;
    }
    block_us
}

/// A sensor that takes frames of all its pixels.
pub(crate) struct FrameSensor {
    emulator: EventEmulator,
    grid: TimeGrid,
    /// Number of the next frame; `None` before the first block.
    next: Option<i64>,
    /// Scene time at which the stream starts.
    start_us: i64,
    frame: Vec<f32>,
}

/// The frames that are taken during a block.
#[derive(Clone, Debug)]
pub(crate) struct Taken {
    /// Their stream times, in microseconds.
    pub times_us: Vec<i64>,
    /// Where they lie in the block, in [0, 1].
    places: Vec<f64>,
}

impl Taken {
    /// Light of a tile at all of them, one after another.
    pub fn sample(&self, signal: &TileSignal, out: &mut Vec<f32>) {
        for &u in &self.places {
            out.extend(signal.at(u).map(|v| if v.is_nan() { f32::NAN } else { v.max(0.0) as f32 }));
        }
    }
}

impl FrameSensor {
    /// Of a camera of `size` pixels, on `threads` threads (0: as many as there are cores), in a stream that starts at
    /// `start_us` of scene time and takes `rate_hz` frames per second.
    ///
    /// # Errors
    /// A value out of range.
    pub fn new(
        (sensor, key): (&SensorConfig, Key),
        [width, height]: [u32; 2],
        (reference_luminance, start_us, rate_hz): (f64, i64, f64),
        threads: usize,
    ) -> Result<Self, ConfigError> {
        let config = EmulatorConfig {
            width,
            height,
            sensor: sensor.clone(),
            reference_luminance: reference_luminance as f32,
            threads,
            causes: true,
            ..EmulatorConfig::default()
        };
        Ok(Self {
            emulator: emulator(config, key)?,
            grid: TimeGrid::new(rate_hz)?,
            next: None,
            start_us,
            frame: vec![f32::NAN; width as usize * height as usize],
        })
    }

    /// Which frames `block` has: those after its start and up to its end, and one at the start where that is the first of
    /// all. One at a border at which light jumps shows what comes after it: `block` jumps at its start, or what follows it
    /// does (`jumps_next`).
    pub fn taken(&mut self, block: Block, jumps_next: bool) -> Taken {
        let stream_us = |t_us: f64| t_us - self.start_us as f64;
        let (from, to) = (stream_us(block.start_us), stream_us(block.end_us));
        let mut next = self.next.unwrap_or_else(|| self.grid.first_at_or_after(from.ceil() as i64));
        let mut taken = Taken { times_us: Vec::new(), places: Vec::new() };
        loop {
            let t_us = self.grid.instant_us(next);
            let t = t_us as f64;
            if t > to || (t == to && jumps_next) {
                break;
            }
            taken.times_us.push(t_us);
            taken.places.push(((t - from) / (to - from)).clamp(0.0, 1.0));
            next += 1;
        }
        self.next = Some(next);
        taken
    }

    /// Takes the frames of a block: per row of tiles what [`Taken::sample`] has found, tile by tile, or nothing where no tile is
    /// followed, and the columns of those that are. Appends what fires, marked with causes.
    ///
    /// # Errors
    /// Light that is none.
    pub fn take(
        &mut self,
        taken: &Taken,
        rows: &[(&[f32], &[usize])],
        events: &mut Vec<Event>,
    ) -> Result<Losses, ConfigError> {
        let width = self.emulator.config().width as usize;
        let frames = taken.times_us.len();
        let mut losses = Losses::default();
        for (index, &t_us) in taken.times_us.iter().enumerate() {
            self.frame.par_chunks_mut(width * TILE).zip(rows).for_each(|(frame, (light, columns))| {
                for (light, column) in light.chunks_exact(frames * PIXELS).zip(*columns) {
                    let own = &light[index * PIXELS..(index + 1) * PIXELS];
                    for (line, own) in frame.chunks_exact_mut(width).zip(own.chunks_exact(TILE)) {
                        let left = column * TILE;
                        let right = width.min(left + TILE);
                        line[left..right].copy_from_slice(&own[..right - left]);
                    }
                }
            });
            let light = Frames::linear(&self.frame);
            let from = events.len();
            self.emulator.push_into(&light, t_us, std::slice::from_mut(events))?;
            if let [causes] = self.emulator.causes() {
                for (event, cause) in events[from..].iter_mut().zip(causes) {
                    *event = event.with_cause(Cause::ALL[usize::from(*cause)]);
                }
            }
            let report = self.emulator.report();
            losses.add(Losses {
                clamped: report.clamped,
                suppressed: report.suppressed,
                dropped: report.dropped,
            });
        }
        Ok(losses)
    }

    /// Stream time before which all events are there.
    pub fn complete_us(&self) -> i64 {
        let sensor = &self.emulator.config().sensor;
        self.emulator.now_us().map_or(0, |t_us| sensor.exposure.known_us(t_us))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_at_jumps_show_what_comes_after() {
        let sensor = SensorConfig::default();
        let new = || FrameSensor::new((&sensor, Key::new(0, 0, 0)), [8, 8], (1.0, 1000, 1000.0), 1).unwrap();
        let block = |from: f64, to: f64| Block { start_us: from, end_us: to, jump: false };
        let mut plain = new();
        assert_eq!(plain.taken(block(1000.0, 3000.0), false).times_us, [0, 1000, 2000]);
        assert_eq!(plain.taken(block(3000.0, 4500.0), false).times_us, [3000]);
        assert_eq!(plain.taken(block(4500.0, 4600.0), false).times_us, [0_i64; 0]);
        let mut jumping = new();
        assert_eq!(jumping.taken(block(1000.0, 3000.0), true).times_us, [0, 1000]);
        let after = jumping.taken(Block { jump: true, ..block(3000.0, 4000.0) }, false);
        assert_eq!((after.times_us, after.places), (vec![2000, 3000], vec![0.0, 1.0]));
    }

    #[test]
    fn blocks_hold_few_frames() {
        assert_eq!(block_us(32_768, 1000.0), 32_768);
        assert_eq!(block_us(32_768, 4000.0), 8192);
        assert_eq!(block_us(32_768, 1e6), 64);
    }
}
