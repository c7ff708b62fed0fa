//! The sensor's pixels in square tiles, each of which takes light at times of its own.

use super::chain::{Chain, Plan};
use super::frames::{BLOCK, Source};
use super::ideal::Interval;
use super::numbering::Numbering;
use super::order::Record;
use super::parts::ReadoutQueue;
use crate::event::{Cause, Event};
use crate::random::Key;
use crate::sensor::{ConfigError, Sensor, SensorConfig};
use crate::simd::Isa;

/// Pixels along a tile's side.
pub const SIDE: usize = 8;

/// The pixels of one tile, row by row.
pub type TilePixels<T> = [T; SIDE * SIDE];

const _: () = assert!(SIDE * SIDE == BLOCK);

/// A sensor whose pixels are treated in tiles of 8 by 8: the emulator's stages, for light that is known more often in one tile
/// than in another. Everything random is drawn by a pixel's place in the image, so that noise is that of
/// [`super::EventEmulator`] with the same key.
#[derive(Clone, Debug)]
pub struct TiledSensor {
    plan: Plan,
    isa: Isa,
    key: Key,
    width: u32,
}

/// What the pixels of a tile remember.
#[derive(Clone, Debug)]
pub struct SensorTile {
    chain: Chain,
    numbering: Numbering,
    /// Time of the light that they saw last.
    now_us: Option<i64>,
    records: Vec<Record>,
    causes: Vec<Cause>,
}

/// What a sensor lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Losses {
    /// See [`super::EmulatorReport::clamped`].
    pub clamped: u64,
    /// See [`super::EmulatorReport::suppressed`].
    pub suppressed: u64,
    /// See [`super::EmulatorReport::dropped`].
    pub dropped: u64,
}

impl Losses {
    /// Adds others.
    pub fn add(&mut self, other: Self) {
        self.clamped += other.clamped;
        self.suppressed += other.suppressed;
        self.dropped += other.dropped;
    }
}

impl TiledSensor {
    /// Of a camera with rows of `width` pixels; all that is random follows from `key`.
    ///
    /// # Errors
    /// A value out of range, and a stage that is defined on frames ([`SensorConfig::needs_frames`]).
    pub fn new(sensor: &SensorConfig, key: Key, width: u32) -> Result<Self, ConfigError> {
        Self::check(sensor)?;
        Ok(Self { plan: Plan::new(sensor), isa: Isa::detect(), key, width })
    }

    /// Whether a sensor can be followed in this way.
    ///
    /// # Errors
    /// As [`TiledSensor::new`].
    pub fn check(sensor: &SensorConfig) -> Result<(), ConfigError> {
        Sensor::new(sensor.clone())?;
        if let Some(stage) = sensor.needs_frames() {
            return Err(ConfigError::new(
                "sensor",
                format!("one with {stage}"),
                "one without: that is defined on frames, and decoupled sampling has none",
            ));
        }
        Ok(())
    }

    /// Pixels that have seen nothing, of the tile whose first one is at (x, y).
    pub fn tile(&self, x: u32, y: u32) -> SensorTile {
        let numbering = Numbering::square(y * self.width + x, self.width);
        let chain = Chain::new(&self.plan, self.key, numbering, BLOCK);
        SensorTile { chain, numbering, now_us: None, records: Vec::new(), causes: Vec::new() }
    }

    /// Where events wait for their turn on the bus.
    pub fn queue(&self) -> ReadoutQueue {
        ReadoutQueue::new(&self.plan.sensor.readout, self.key, self.width)
    }

    /// Takes the light of a tile's pixels at `t_us`, relative to `Y_ref` and NaN where there is no pixel; its logarithm was
    /// straight since the last call. A time that is not after the last one is left out. Appends what fires, marked with causes, by pixel and
    /// time.
    pub fn advance(
        &self,
        tile: &mut SensorTile,
        light: &TilePixels<f32>,
        t_us: i64,
        events: &mut Vec<Event>,
    ) -> Losses {
        let start_us = tile.now_us.unwrap_or(t_us);
        let Ok(us) = u32::try_from(t_us - start_us) else { return Losses::default() };
        if us == 0 && tile.now_us.is_some() {
            return Losses::default();
        }
        let source = Source::Linear { values: light, inverse_reference: 1.0 };
        let interval = Interval {
            sensor: &self.plan.sensor,
            width: self.width,
            first: 0,
            end: BLOCK,
            numbering: tile.numbering,
            us,
        };
        let SensorTile { chain, records, causes, now_us, .. } = tile;
        chain.rebase(start_us, now_us.is_none());
        chain.scan(self.isa, &self.plan, &source, &interval, self.key, start_us);
        records.clear();
        causes.clear();
        let tally =
            chain.fire(self.isa, &self.plan, &interval, self.key, (start_us, 0), records, Some(&mut *causes));
        *now_us = Some(t_us);
        events.extend(
            records.iter().zip(causes).map(|(record, cause)| record.event(start_us).with_cause(*cause)),
        );
        Losses { clamped: tally.clamped, suppressed: tally.suppressed, dropped: 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emulator::parts::emulator;
    use crate::emulator::{EmulatorConfig, Frames};
    use crate::event::take_causes;
    use crate::sensor::Start;

    const WIDTH: u32 = 20;
    const HEIGHT: u32 = 18;

    /// Light of the pixel (x, y): waves that come and go.
    fn light(x: u32, y: u32, t_us: i64) -> f32 {
        let phase = 0.3 * f64::from(x) + 0.2 * f64::from(y) + t_us as f64 * 4e-4;
        (0.5 + 0.45 * phase.sin()) as f32
    }

    fn sensors() -> Vec<SensorConfig> {
        let preset = |name| SensorConfig::preset(name).unwrap();
        let mut leaky = SensorConfig { log_eps: 1e-4, ..SensorConfig::default() };
        leaky.noise.leak_hz = 5.0;
        leaky.noise.leak_jitter = 0.2;
        leaky.noise.leak_spread_decades = 0.3;
        leaky.pattern.sigma = 0.03;
        leaky.pattern.dead_share = 0.05;
        leaky.pattern.start = Start::Phase;
        leaky.refractory.period_us = 700;
        leaky.readout.jitter_us = 30.0;
        leaky.readout.latency_us = 200.0;
        let mut grainy = preset("gen4-like");
        grainy.photoreceptor.noise = 0.05;
        let mut sensors = vec![preset("dvxplorer-like"), preset("gen4-like"), leaky, grainy];
        sensors.iter_mut().for_each(|sensor| sensor.noise.shot_hz = 20.0);
        sensors
    }

    #[test]
    fn tiles_fire_what_the_emulator_fires() {
        let times: Vec<i64> = (0..120).map(|k| 1000 + 250 * k + 40 * (k % 3)).collect();
        for (number, sensor) in sensors().into_iter().enumerate() {
            let key = Key::new(5, 1, 2);
            let (width, height) = (WIDTH, HEIGHT);
            let config = EmulatorConfig {
                width,
                height,
                sensor: sensor.clone(),
                threads: 1,
                causes: true,
                ..EmulatorConfig::default()
            };
            let mut whole = emulator(config, key).unwrap();
            let tiled = TiledSensor::new(&sensor, key, WIDTH).unwrap();
            let corners =
                (0..HEIGHT).step_by(SIDE).flat_map(|y| (0..WIDTH).step_by(SIDE).map(move |x| (x, y)));
            let mut tiles: Vec<_> = corners.map(|(x, y)| (x, y, tiled.tile(x, y))).collect();
            let mut queue = tiled.queue();
            let (mut expected, mut found) = (Vec::new(), Vec::new());
            let (mut expected_causes, mut found_causes) = (Vec::new(), Vec::new());
            let mut losses = [[0; 3]; 2];
            for t_us in &times {
                let frame: Vec<f32> =
                    (0..WIDTH * HEIGHT).map(|i| light(i % WIDTH, i / WIDTH, *t_us)).collect();
                expected.extend(whole.push(&Frames::linear(&frame), *t_us).unwrap().remove(0));
                expected_causes.extend_from_slice(&whole.causes()[0]);
                let mut fired = Vec::new();
                for (x, y, tile) in &mut tiles {
                    let own: TilePixels<f32> = std::array::from_fn(|i| {
                        let (x, y) = (*x + (i % SIDE) as u32, *y + (i / SIDE) as u32);
                        if x < WIDTH && y < HEIGHT { light(x, y, *t_us) } else { f32::NAN }
                    });
                    let lost = tiled.advance(tile, &own, *t_us, &mut fired);
                    losses[1][0] += lost.clamped;
                    losses[1][1] += lost.suppressed;
                }
                let mut left = Vec::new();
                losses[1][2] += queue.take(&mut fired, *t_us, &mut left);
                found_causes.extend(take_causes(&mut left));
                found.append(&mut left);
            }
            let report = whole.total_report();
            losses[0] = [report.clamped, report.suppressed, report.dropped];
            assert!(expected.len() > 2000, "sensor {number}: {} events", expected.len());
            assert!(found == expected, "sensor {number}: {} events, {}", found.len(), expected.len());
            assert_eq!(found_causes, expected_causes);
            assert_eq!(losses[0], losses[1]);
            assert!(
                found_causes.iter().any(|cause| *cause != Cause::Signal as u8),
                "sensor {number}: no noise"
            );
        }
    }

    #[test]
    fn stages_of_frames_are_refused_by_name() {
        for (name, stage) in [("evis", "trigger"), ("davis346", "diffusion"), ("v2e", "times")] {
            let sensor = SensorConfig::preset(name).unwrap();
            let error = TiledSensor::new(&sensor, Key::new(0, 0, 0), 8).unwrap_err().to_string();
            assert!(error.contains(stage), "{name}: {error}");
        }
        assert_eq!(SensorConfig::default().needs_frames(), None);
    }
}
