//! What the pixels of a tile remember between intervals.

use super::pattern::FixedPattern;
use super::plan::Plan;
use crate::emulator::frames::BLOCK;
use crate::emulator::noise::TileNoise;
use crate::emulator::numbering::Numbering;
use crate::random::Key;

/// A time long before any other, on a tile's clock.
pub(crate) const LONG_AGO: i32 = i32::MIN / 2;

/// On a tile's clock, beyond this its origin moves on.
pub(crate) const REBASE_US: i64 = 1 << 29;

/// What the pixels of a tile remember. Vectors are multiples of [`BLOCK`] long, or empty where their stage is off.
#[derive(Clone, Debug, Default)]
pub(crate) struct Chain {
    /// Log units; NaN where nothing was seen, infinite while the pixel is held.
    pub reference: Vec<f32>,
    /// Signal before the filter, filter, second filter, light: now, and at the interval's end.
    pub now: Samples,
    pub(super) next: Samples,
    /// When the reference last moved, microseconds after `base_us` (leak).
    pub moved: Vec<i32>,
    /// Rise of the signal per microsecond that the leak amounts to, since then.
    pub slope: Vec<f32>,
    /// Its mean.
    pub(super) steady: Vec<f32>,
    /// When the pixel last fired, microseconds after `base_us` (refractory, recovery).
    pub fired: Vec<i32>,
    /// Polarity of the last event: 0, 1, or 2 for none (alternation).
    pub polarity: Vec<u8>,
    /// Origin of the tile's clock.
    pub base_us: i64,
    /// Thresholds; infinite where the pixel is dead.
    pub(super) on: Vec<f32>,
    pub(super) off: Vec<f32>,
    pub noise: TileNoise,
    pub(super) masks: Vec<u64>,
    /// Pixels whose reference moved at the interval's end: their leak's jitter is drawn for many at once.
    pub(super) moved_last: Vec<u32>,
    /// How far from a level the signal of this interval's end may be and still be on it: no range is narrowed here, so
    /// twice what the ideal pixel allows.
    pub(super) tie: f32,
}

/// Values of a tile's pixels at one time.
#[derive(Clone, Debug, Default)]
pub(crate) struct Samples {
    pub input: Vec<f32>,
    pub first: Vec<f32>,
    pub second: Vec<f32>,
    pub light: Vec<f32>,
}

impl Samples {
    fn new(plan: &Plan, length: usize) -> Self {
        let filtered = plan.rate > 0.0;
        Self {
            input: vec![f32::NAN; length],
            first: vec![f32::NAN; if filtered { length } else { 0 }],
            second: vec![f32::NAN; if filtered && plan.two_poles { length } else { 0 }],
            light: vec![f32::NAN; length],
        }
    }

    /// What the trigger sees.
    #[inline]
    pub fn output(&self) -> &[f32] {
        if !self.second.is_empty() {
            &self.second
        } else if !self.first.is_empty() {
            &self.first
        } else {
            &self.input
        }
    }
}

impl Chain {
    /// Pixels that have seen nothing, with what is frozen about them.
    pub fn new(plan: &Plan, key: Key, numbering: Numbering, pixels: usize) -> Self {
        let length = pixels.next_multiple_of(BLOCK);
        let sensor = &plan.sensor;
        let noise = &sensor.noise;
        let FixedPattern { on, off, slope } = FixedPattern::of(sensor, key, numbering, length);
        let tile_noise = TileNoise::new(sensor, key, numbering, &on[..pixels], &off[..pixels]);
        let when = |wanted: bool, value: i32| vec![value; if wanted { length } else { 0 }];
        Self {
            reference: vec![f32::NAN; length],
            now: Samples::new(plan, length),
            next: Samples::new(plan, length),
            moved: when(plan.ramp, 0),
            steady: slope.clone(),
            slope,
            fired: when(sensor.refractory.period_us > 0 || noise.shot_recovery_us > 0.0, LONG_AGO),
            polarity: vec![2; if noise.alternation >= 0.0 { length } else { 0 }],
            base_us: 0,
            on,
            off,
            noise: tile_noise,
            masks: vec![0; length / BLOCK],
            moved_last: Vec::new(),
            tie: 0.0,
        }
    }

    /// Nothing seen, keeping what is frozen.
    pub fn clear(&mut self) {
        self.reference.fill(f32::NAN);
        for samples in [&mut self.now, &mut self.next] {
            samples.input.fill(f32::NAN);
            samples.first.fill(f32::NAN);
            samples.second.fill(f32::NAN);
            samples.light.fill(f32::NAN);
        }
        self.moved.fill(0);
        self.slope.copy_from_slice(&self.steady);
        self.fired.fill(LONG_AGO);
        self.polarity.fill(2);
        self.base_us = 0;
    }

    /// Moves the clock's origin on where it lies far back; what leaked until then goes into the reference.
    pub fn rebase(&mut self, start_us: i64, first_frame: bool) {
        if first_frame {
            self.base_us = start_us;
            return;
        }
        while start_us - self.base_us >= REBASE_US {
            self.base_us += REBASE_US;
            for (i, moved) in self.moved.iter_mut().enumerate() {
                let since = i64::from(*moved) - REBASE_US;
                if since < 0 && self.reference[i].is_finite() {
                    self.reference[i] += self.slope[i] * since as f32;
                }
                *moved = since.max(0) as i32;
            }
            for fired in &mut self.fired {
                *fired = (i64::from(*fired) - REBASE_US).max(LONG_AGO.into()) as i32;
            }
        }
    }
}

/// The block of `values` that starts at `start`; `missing` where its stage is off.
#[inline(always)]
pub(super) fn at<T: Copy>(values: &[T], start: usize, missing: T) -> [T; BLOCK] {
    values.get(start..).and_then(|values| values.first_chunk::<BLOCK>()).copied().unwrap_or([missing; BLOCK])
}

/// Writes a block, where there is memory for it.
#[inline(always)]
pub(super) fn put(values: &mut [f32], start: usize, block: &[f32; BLOCK]) {
    if let Some(values) = values.get_mut(start..).and_then(|values| values.first_chunk_mut::<BLOCK>()) {
        *values = *block;
    }
}
