//! The ideal pixel at memory speed: no noise, no filter, one pair of thresholds for all.
//!
//! A pixel fires only when its light leaves the range that its reference allows. That range is kept beside the
//! reference, in the frame's own numbers, a little narrower than it is: a silent pixel costs some comparisons and no
//! logarithm. Those that leave it are gathered, and treated in full, 64 and more at a time. Of a range of light only the
//! lower end is kept, since the upper one is a fixed ratio above: what a silent pixel moves through memory is the frame,
//! that end, and the copy of the frame.

use super::blocks::Blocks;
use super::frames::{BLOCK, Codes, Source, copy, copy_plain, margin};
use super::numbering::Numbering;
use super::order::Record;
use crate::event::Polarity;
use crate::sensor::{ConfigError, SensorConfig, TriggerRule};
use crate::simd::{self, bits_of, dispatched};
use crate::trigger::{MAX_EVENTS_PER_INTERVAL, TIE};

/// A tile and an interval of time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Interval<'a> {
    pub sensor: &'a SensorConfig,
    /// Pixels per row.
    pub width: u32,
    /// The tile's first pixel.
    pub first: usize,
    /// One past its last pixel; what lies beyond in its last block is not there.
    pub end: usize,
    /// Numbers of its pixels within the image.
    pub numbering: Numbering,
    /// Length of the interval, at most [`super::order::MAX_INTERVAL_US`].
    pub us: u32,
}

/// What a pass over a tile counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Tally {
    /// Pixels whose value was NaN: they kept their state.
    pub unknown: u64,
    /// Pixels that would have fired more events than they may.
    pub clamped: u64,
    /// Events that the refractory period swallowed.
    pub suppressed: u64,
}

/// The type of a frame's numbers.
pub(crate) trait Value: Copy + PartialOrd + Default + std::fmt::Debug {
    /// The range of a pixel that has not been seen: nothing is in it.
    const NEVER: (Self, Self);
    /// Whether a value can be NaN.
    const HAS_UNKNOWN: bool;
    /// What stands for "nothing seen".
    const MISSING: Self;
    /// Whether the value is unknown (NaN).
    fn is_unknown(self) -> bool;
}

impl Value for f32 {
    const NEVER: (Self, Self) = (Self::NAN, Self::NAN);
    const HAS_UNKNOWN: bool = true;
    const MISSING: Self = Self::NAN;
    #[inline(always)]
    fn is_unknown(self) -> bool {
        self.is_nan()
    }
}

/// The numbers of a frame as the ideal pixel sees them.
pub(crate) trait Domain {
    /// One pixel.
    type Value: Value;
    /// Whether the upper end of a range is kept; else it follows from the lower one, which is then given for both.
    const UPPER: bool;
    /// Puts 64 pixels from `first` into `out`, [`Value::MISSING`] beyond the frame's end; gives as bits which are not in
    /// their range. NaN is in none, nor is what no light can be. `LANES`: how many floats one instruction of what the caller
    /// is compiled for takes: 8 with AVX2, 16 with AVX-512, 1 with neither.
    fn load<const LANES: usize>(
        &self,
        first: usize,
        low: &[Self::Value; BLOCK],
        high: &[Self::Value; BLOCK],
        out: &mut [Self::Value; BLOCK],
    ) -> u64;
    /// What was loaded can be read by every thread.
    fn finish<const LANES: usize>(&self) {}
    /// The first half of the way to the logarithm: a look-up, pixel by pixel.
    fn pick(&self, value: Self::Value) -> f32;
    /// The second half: arithmetic, many pixels at once.
    fn log(&self, picked: f32) -> f32;
    /// The range around `reference` within which nothing fires, narrower than it is by more than all rounding.
    fn range(&self, sensor: &SensorConfig, reference: f32) -> (Self::Value, Self::Value);
    /// Whether no light has this value (infinite or negative).
    fn is_impossible(value: Self::Value) -> bool;
    /// How far from a level a signal may be and still be on it; less than ranges are narrowed by.
    fn tie(&self) -> f32;
}

/// One channel of linear light.
pub(crate) struct Linear<'a> {
    pub values: &'a [f32],
    pub inverse_reference: f32,
}

/// Any source, as light.
pub(crate) struct Any<'a>(pub Source<'a>, pub f32);

/// Loads linear light.
pub(crate) trait Load {
    /// As [`Domain::tie`].
    fn tie(&self) -> f32;
    /// As [`Domain::finish`].
    fn finish<const LANES: usize>(&self) {}
    /// As [`Domain::load`]; `span` is `eps`, and the ratio of a range's ends.
    fn load<const LANES: usize>(
        &self,
        first: usize,
        low: &[f32; BLOCK],
        span: (f32, f32),
        out: &mut [f32; BLOCK],
    ) -> u64;
}

/// Pixels of frames that are copied past the caches where they are silent: caches do not hold them until they are read again.
#[cfg(target_arch = "x86_64")]
const STREAMED: usize = 1 << 19;

#[cfg(target_arch = "x86_64")]
impl Linear<'_> {
    #[inline(always)]
    const fn streams(&self) -> bool {
        self.values.len() >= STREAMED
    }
}

impl Load for Linear<'_> {
    #[inline(always)]
    fn finish<const LANES: usize>(&self) {
        #[cfg(target_arch = "x86_64")]
        if LANES >= 16 && self.streams() {
            // SAFETY: every processor of this target has it.
            unsafe { std::arch::x86_64::_mm_sfence() };
        }
    }
    #[inline(always)]
    fn tie(&self) -> f32 {
        0.0
    }
    #[inline(always)]
    fn load<const LANES: usize>(
        &self,
        first: usize,
        low: &[f32; BLOCK],
        (eps, reach): (f32, f32),
        out: &mut [f32; BLOCK],
    ) -> u64 {
        let inverse = self.inverse_reference;
        #[cfg(target_arch = "x86_64")]
        if LANES > 1
            && let Some(values) = self.values.get(first..).and_then(|rest| rest.first_chunk())
        {
            // SAFETY: so many lanes are those of AVX-512, and of AVX2.
            return unsafe {
                match LANES {
                    16.. => widest::light_outside(values, (inverse, self.streams()), low, eps, reach, out),
                    _ => wide::light_outside(values, inverse, low, eps, reach, out),
                }
            };
        }
        copy(self.values, first, f32::NAN, out, |light| light * inverse);
        light_outside(out, low, eps, reach)
    }
}

impl Load for Any<'_> {
    #[inline(always)]
    fn tie(&self) -> f32 {
        self.0.tie()
    }
    #[inline(always)]
    fn load<const LANES: usize>(
        &self,
        first: usize,
        low: &[f32; BLOCK],
        (eps, reach): (f32, f32),
        out: &mut [f32; BLOCK],
    ) -> u64 {
        self.0.load_light(first, self.1, out);
        light_outside(out, low, eps, reach)
    }
}

/// Which values do not lie, with `eps`, between `low` and `reach` times that, or are negative.
#[inline(always)]
fn light_outside(values: &[f32; BLOCK], low: &[f32; BLOCK], eps: f32, reach: f32) -> u64 {
    let mut outside = [0; BLOCK];
    for i in 0..BLOCK {
        let shifted = values[i] + eps;
        let inside = (shifted >= low[i]) & (shifted <= low[i] * reach) & (values[i] >= 0.0);
        outside[i] = u8::from(!inside);
    }
    bits_of(&outside)
}

/// Linear light.
pub(crate) struct Light<L> {
    pub load: L,
    pub eps: f32,
    /// How far apart the ends of a range are, as a ratio of light: a little less than the thresholds allow.
    pub reach: f32,
    /// The lower end at most.
    most: f32,
}

impl<L> Light<L> {
    fn new(load: L, sensor: &SensorConfig) -> Self {
        // Twice the widest margin of `range`: logarithms of f32 end at 88.
        let reach = simd::exp(sensor.threshold_on + sensor.threshold_off - 2.0 * (2e-6 + 90.0 * 1e-6));
        Self { load, eps: sensor.log_eps, reach, most: 0.5 * f32::MAX / reach }
    }
}

impl<L: Load> Domain for Light<L> {
    type Value = f32;
    const UPPER: bool = false;
    #[inline(always)]
    fn load<const LANES: usize>(
        &self,
        first: usize,
        low: &[f32; BLOCK],
        _: &[f32; BLOCK],
        out: &mut [f32; BLOCK],
    ) -> u64 {
        self.load.load::<LANES>(first, low, (self.eps, self.reach), out)
    }
    #[inline(always)]
    fn finish<const LANES: usize>(&self) {
        self.load.finish::<LANES>();
    }
    #[inline(always)]
    fn pick(&self, value: f32) -> f32 {
        value
    }
    #[inline(always)]
    fn log(&self, picked: f32) -> f32 {
        simd::ln(picked + self.eps)
    }
    #[inline(always)]
    fn range(&self, sensor: &SensorConfig, reference: f32) -> (f32, f32) {
        let low = simd::exp(reference - sensor.threshold_off + margin(reference));
        // Infinite light is in no range.
        (if low < self.most { low } else { self.most }, 0.0)
    }
    #[inline(always)]
    #[allow(clippy::manual_range_contains, reason = "NaN is possible")]
    fn is_impossible(value: f32) -> bool {
        value < 0.0 || value > f32::MAX
    }
    #[inline(always)]
    fn tie(&self) -> f32 {
        self.load.tie()
    }
}

/// Logarithms of light.
pub(crate) struct Logs<'a>(pub &'a [f32]);

impl Domain for Logs<'_> {
    type Value = f32;
    const UPPER: bool = true;
    #[inline(always)]
    fn load<const LANES: usize>(
        &self,
        first: usize,
        low: &[f32; BLOCK],
        high: &[f32; BLOCK],
        out: &mut [f32; BLOCK],
    ) -> u64 {
        copy_plain(self.0, first, f32::NAN, out);
        floats_outside::<LANES>(out, low, high)
    }
    #[inline(always)]
    fn pick(&self, value: f32) -> f32 {
        value
    }
    #[inline(always)]
    fn log(&self, picked: f32) -> f32 {
        picked
    }
    #[inline(always)]
    fn range(&self, sensor: &SensorConfig, reference: f32) -> (f32, f32) {
        let margin = margin(reference);
        (reference - sensor.threshold_off + margin, reference + sensor.threshold_on - margin)
    }
    #[inline(always)]
    fn is_impossible(value: f32) -> bool {
        value.is_infinite()
    }
    #[inline(always)]
    fn tie(&self) -> f32 {
        0.0
    }
}

#[inline(always)]
fn floats_outside<const LANES: usize>(values: &[f32; BLOCK], low: &[f32; BLOCK], high: &[f32; BLOCK]) -> u64 {
    #[cfg(target_arch = "x86_64")]
    if LANES > 1 {
        // SAFETY: more than one lane promises AVX2.
        return unsafe { wide::floats_outside(values, low, high) };
    }
    let mut outside = [0; BLOCK];
    for i in 0..BLOCK {
        outside[i] = u8::from(!((values[i] >= low[i]) & (values[i] <= high[i])));
    }
    bits_of(&outside)
}

#[inline(always)]
fn bytes_outside<const LANES: usize>(values: &[u8; BLOCK], low: &[u8; BLOCK], high: &[u8; BLOCK]) -> u64 {
    #[cfg(target_arch = "x86_64")]
    if LANES > 1 {
        // SAFETY: more than one lane promises AVX2.
        return unsafe { wide::bytes_outside(values, low, high) };
    }
    let mut outside = [0; BLOCK];
    for i in 0..BLOCK {
        outside[i] = u8::from(values[i] < low[i]) | u8::from(values[i] > high[i]);
    }
    bits_of(&outside)
}

#[inline(always)]
fn words_outside<const LANES: usize>(values: &[u16; BLOCK], low: &[u16; BLOCK], high: &[u16; BLOCK]) -> u64 {
    let mut outside = [0; BLOCK];
    for i in 0..BLOCK {
        outside[i] = u8::from(values[i] < low[i]) | u8::from(values[i] > high[i]);
    }
    bits_of(&outside)
}

/// With AVX-512.
#[cfg(target_arch = "x86_64")]
mod widest {
    use std::arch::x86_64::{
        _CMP_GE_OQ, _CMP_LE_OQ, _mm512_add_ps, _mm512_cmp_ps_mask, _mm512_loadu_ps, _mm512_mask_cmp_ps_mask,
        _mm512_mul_ps, _mm512_set1_ps, _mm512_setzero_ps, _mm512_storeu_ps, _mm512_stream_ps,
    };

    use crate::emulator::frames::BLOCK;

    /// As [`super::wide::light_outside`]; past the caches where `streams`, `out` begins at a cache line, and all is inside. Then
    /// [`std::arch::x86_64::_mm_sfence`] must follow before another thread reads it.
    #[target_feature(enable = "avx512f")]
    #[inline]
    pub(super) fn light_outside(
        values: &[f32; BLOCK],
        (inverse, streams): (f32, bool),
        low: &[f32; BLOCK],
        eps: f32,
        reach: f32,
        out: &mut [f32; BLOCK],
    ) -> u64 {
        const PARTS: usize = BLOCK / 16;
        let (inverse, eps, reach) = (_mm512_set1_ps(inverse), _mm512_set1_ps(eps), _mm512_set1_ps(reach));
        let zero = _mm512_setzero_ps();
        let mut light = [zero; PARTS];
        let mut inside = 0_u64;
        for (i, light) in light.iter_mut().enumerate() {
            // SAFETY: each reads the 16 floats that are there: sixteens of arrays of 64, the last of which begins at 48.
            let (values, low) = unsafe {
                (_mm512_loadu_ps(values.as_ptr().add(16 * i)), _mm512_loadu_ps(low.as_ptr().add(16 * i)))
            };
            *light = _mm512_mul_ps(values, inverse);
            let shifted = _mm512_add_ps(*light, eps);
            let possible = _mm512_cmp_ps_mask::<_CMP_GE_OQ>(*light, zero);
            let above = _mm512_mask_cmp_ps_mask::<_CMP_GE_OQ>(possible, shifted, low);
            let all = _mm512_mask_cmp_ps_mask::<_CMP_LE_OQ>(above, shifted, _mm512_mul_ps(low, reach));
            inside |= u64::from(all) << (16 * i);
        }
        let out = out.as_mut_ptr();
        if streams && inside == u64::MAX && out.addr().is_multiple_of(64) {
            for (i, light) in light.into_iter().enumerate() {
                // SAFETY: it writes the 16 floats that are there, which begin at a cache line.
                unsafe { _mm512_stream_ps(out.add(16 * i), light) };
            }
        } else {
            for (i, light) in light.into_iter().enumerate() {
                // SAFETY: it writes the 16 floats that are there.
                unsafe { _mm512_storeu_ps(out.add(16 * i), light) };
            }
        }
        !inside
    }
}

/// What the compiler does not find: comparisons straight to bits.
#[cfg(target_arch = "x86_64")]
mod wide {
    use std::arch::x86_64::{
        __m256i, _CMP_GE_OQ, _CMP_LE_OQ, _mm256_add_ps, _mm256_and_ps, _mm256_and_si256, _mm256_cmp_ps,
        _mm256_cmpeq_epi8, _mm256_loadu_ps, _mm256_loadu_si256, _mm256_max_epu8, _mm256_min_epu8,
        _mm256_movemask_epi8, _mm256_movemask_ps, _mm256_mul_ps, _mm256_set1_ps, _mm256_setzero_ps,
        _mm256_storeu_ps,
    };

    use crate::emulator::frames::BLOCK;

    /// `out` becomes `values` times `inverse`; the rest as [`super::light_outside`].
    #[target_feature(enable = "avx2")]
    #[inline]
    pub(super) fn light_outside(
        values: &[f32; BLOCK],
        inverse: f32,
        low: &[f32; BLOCK],
        eps: f32,
        reach: f32,
        out: &mut [f32; BLOCK],
    ) -> u64 {
        let (inverse, eps, reach) = (_mm256_set1_ps(inverse), _mm256_set1_ps(eps), _mm256_set1_ps(reach));
        let zero = _mm256_setzero_ps();
        let mut inside = [0_u8; BLOCK / 8];
        for (i, inside) in inside.iter_mut().enumerate() {
            // SAFETY: eights of arrays of 64, the last of which begins at 56.
            let (values, low, out) =
                unsafe { (values.as_ptr().add(8 * i), low.as_ptr().add(8 * i), out.as_mut_ptr().add(8 * i)) };
            // SAFETY: each reads the 8 floats that are there.
            let (values, low) = unsafe { (_mm256_loadu_ps(values), _mm256_loadu_ps(low)) };
            let light = _mm256_mul_ps(values, inverse);
            // SAFETY: it writes the 8 floats that are there.
            unsafe { _mm256_storeu_ps(out, light) };
            let shifted = _mm256_add_ps(light, eps);
            let above = _mm256_cmp_ps::<_CMP_GE_OQ>(shifted, low);
            let below = _mm256_cmp_ps::<_CMP_LE_OQ>(shifted, _mm256_mul_ps(low, reach));
            let possible = _mm256_cmp_ps::<_CMP_GE_OQ>(light, zero);
            let all = _mm256_and_ps(_mm256_and_ps(above, below), possible);
            *inside = _mm256_movemask_ps(all) as u8;
        }
        !u64::from_le_bytes(inside)
    }

    #[target_feature(enable = "avx2")]
    #[inline]
    pub(super) fn floats_outside(values: &[f32; BLOCK], low: &[f32; BLOCK], high: &[f32; BLOCK]) -> u64 {
        let mut inside = 0;
        let parts = values.as_chunks::<8>().0.iter().zip(low.as_chunks::<8>().0).zip(high.as_chunks::<8>().0);
        for (i, ((values, low), high)) in parts.enumerate() {
            // SAFETY: each reads the 8 floats that the array has.
            let (values, low, high) = unsafe {
                (
                    _mm256_loadu_ps(values.as_ptr()),
                    _mm256_loadu_ps(low.as_ptr()),
                    _mm256_loadu_ps(high.as_ptr()),
                )
            };
            let above = _mm256_cmp_ps::<_CMP_GE_OQ>(values, low);
            let below = _mm256_cmp_ps::<_CMP_LE_OQ>(values, high);
            inside |= u64::from(_mm256_movemask_ps(_mm256_and_ps(above, below)) as u32) << (8 * i);
        }
        !inside
    }

    #[target_feature(enable = "avx2")]
    #[inline]
    pub(super) fn bytes_outside(values: &[u8; BLOCK], low: &[u8; BLOCK], high: &[u8; BLOCK]) -> u64 {
        let mut inside = 0;
        let parts =
            values.as_chunks::<32>().0.iter().zip(low.as_chunks::<32>().0).zip(high.as_chunks::<32>().0);
        for (i, ((values, low), high)) in parts.enumerate() {
            // SAFETY: each reads the 32 bytes that the array has.
            let (values, low, high) = unsafe {
                (
                    _mm256_loadu_si256(values.as_ptr().cast::<__m256i>()),
                    _mm256_loadu_si256(low.as_ptr().cast::<__m256i>()),
                    _mm256_loadu_si256(high.as_ptr().cast::<__m256i>()),
                )
            };
            let above = _mm256_cmpeq_epi8(_mm256_max_epu8(values, low), values);
            let below = _mm256_cmpeq_epi8(_mm256_min_epu8(values, high), values);
            inside |= u64::from(_mm256_movemask_epi8(_mm256_and_si256(above, below)) as u32) << (32 * i);
        }
        !inside
    }
}

/// One channel of integers, through tables.
pub(crate) struct Integers<'a, T>(pub &'a [T], pub Codes<'a>);

macro_rules! integers {
    ($type:ty, $outside:ident) => {
        impl Value for $type {
            const NEVER: ($type, $type) = (<$type>::MAX, 0);
            const HAS_UNKNOWN: bool = false;
            const MISSING: $type = 0;
            #[inline(always)]
            fn is_unknown(self) -> bool {
                false
            }
        }

        impl Domain for Integers<'_, $type> {
            type Value = $type;
            const UPPER: bool = true;
            #[inline(always)]
            fn load<const LANES: usize>(
                &self,
                first: usize,
                low: &[$type; BLOCK],
                high: &[$type; BLOCK],
                out: &mut [$type; BLOCK],
            ) -> u64 {
                copy_plain(self.0, first, 0, out);
                $outside::<LANES>(out, low, high)
            }
            #[inline(always)]
            fn pick(&self, value: $type) -> f32 {
                self.1.log(value.into())
            }
            #[inline(always)]
            fn log(&self, picked: f32) -> f32 {
                picked
            }
            #[inline(always)]
            fn range(&self, _: &SensorConfig, reference: f32) -> ($type, $type) {
                let [low, high] = self.1.range(reference);
                (low as $type, high as $type)
            }
            #[inline(always)]
            fn is_impossible(_: $type) -> bool {
                false
            }
            #[inline(always)]
            fn tie(&self) -> f32 {
                TIE
            }
        }
    };
}
integers!(u8, bytes_outside);
integers!(u16, words_outside);

/// What the pixels of a tile remember; lengths are multiples of [`BLOCK`].
#[derive(Clone, Debug, Default)]
pub(crate) struct Memory<T> {
    /// Reference of the next event, log units; NaN where nothing was seen.
    pub reference: Blocks<f32>,
    /// The last value, and the new one while a frame is treated.
    pub last: Blocks<T>,
    next: Blocks<T>,
    /// Range of values at which nothing fires; no upper ends where they follow from the lower ones.
    pub low: Blocks<T>,
    pub high: Blocks<T>,
    /// Which pixels of each block left their range in this frame.
    masks: Vec<u64>,
}

impl<T: Value> Memory<T> {
    /// Memory of `length` pixels that have seen nothing; `upper`: with upper ends of ranges.
    pub fn new(length: usize, upper: bool) -> Self {
        let blocks = length.div_ceil(BLOCK);
        Self {
            reference: Blocks::filled(f32::NAN, blocks),
            last: Blocks::filled(T::MISSING, blocks),
            next: Blocks::filled(T::MISSING, blocks),
            low: Blocks::filled(T::NEVER.0, blocks),
            high: Blocks::filled(T::NEVER.1, if upper { blocks } else { 0 }),
            masks: vec![0; blocks],
        }
    }
}

/// Finds the pixels that left their range, and puts the frame beside the last one. Gives how many are NaN, and whether
/// one of them is impossible.
#[inline(always)]
fn scan_body<D: Domain, const LANES: usize>(
    domain: &D,
    at: &Interval<'_>,
    memory: &mut Memory<D::Value>,
) -> (u64, bool) {
    let mut first = at.first;
    let mut impossible = 0;
    let mut unknown = 0;
    let Memory { low, high, last, next, masks, .. } = memory;
    let low = low.as_chunks::<BLOCK>().0;
    let high = if D::UPPER { high.as_chunks::<BLOCK>().0 } else { low };
    let ranges = low.iter().zip(high);
    let values = last.as_chunks::<BLOCK>().0.iter().zip(next.as_chunks_mut::<BLOCK>().0);
    for (((low, high), (last, next)), mask) in ranges.zip(values).zip(masks) {
        *mask = domain.load::<LANES>(first, low, high, next);
        if *mask != 0 {
            for next in next.iter() {
                impossible |= u8::from(D::is_impossible(*next));
            }
            // Beyond the frame's end, nothing is there to leave anything.
            let seen = at.end.saturating_sub(first);
            if seen < BLOCK {
                *mask &= (1_u64 << seen).wrapping_sub(1);
            }
            if D::Value::HAS_UNKNOWN {
                unknown += keep_unknown(mask, last, next);
            }
        }
        first = first.wrapping_add(BLOCK);
    }
    domain.finish::<LANES>();
    (unknown, impossible != 0)
}

/// Pixels that are NaN keep their value; gives how many there are.
#[inline(always)]
fn keep_unknown<T: Value>(mask: &mut u64, last: &[T; BLOCK], next: &mut [T; BLOCK]) -> u64 {
    let mut lost = [0_u8; BLOCK];
    for i in 0..BLOCK {
        lost[i] = u8::from(next[i].is_unknown());
    }
    let lost = bits_of(&lost);
    let mut rest = lost;
    while rest != 0 {
        let i = rest.trailing_zeros() as usize % BLOCK;
        rest &= rest.wrapping_sub(1);
        next[i] = last[i];
    }
    let unknown = (*mask & lost).count_ones();
    *mask &= !lost;
    u64::from(unknown)
}

/// Pixels that are treated at once.
const BATCH: usize = 128;

/// Pixels that left their range, gathered.
struct Gathered {
    count: usize,
    /// Index within the tile.
    pixel: [u32; BATCH],
    reference: [f32; BATCH],
    before: [f32; BATCH],
    now: [f32; BATCH],
}

/// Appends the events of the pixels that [`scan_body`] found; the frame becomes the last one.
#[inline(always)]
fn fire_body<D: Domain>(
    domain: &D,
    at: &Interval<'_>,
    memory: &mut Memory<D::Value>,
    records: &mut Vec<Record>,
) -> Tally {
    let mut tally = Tally::default();
    let mut row = Row::new(at);
    let mut gathered = Gathered {
        count: 0,
        pixel: [0; BATCH],
        reference: [0.0; BATCH],
        before: [0.0; BATCH],
        now: [0.0; BATCH],
    };
    for block in 0..memory.masks.len() {
        let mut mask = memory.masks[block];
        if mask == 0 {
            continue;
        }
        if gathered.count > BATCH - BLOCK {
            flush(domain, at, memory, &mut gathered, &mut row, records, &mut tally);
        }
        let start = block * BLOCK;
        let of = start..start + BLOCK;
        let (reference, last, now) =
            (&memory.reference[of.clone()], &memory.last[of.clone()], &memory.next[of]);
        while mask != 0 {
            let i = mask.trailing_zeros() as usize % BLOCK;
            mask &= mask.wrapping_sub(1);
            let slot = gathered.count % BATCH;
            gathered.pixel[slot] = start.wrapping_add(i) as u32;
            gathered.reference[slot] = reference[i];
            gathered.before[slot] = domain.pick(last[i]);
            gathered.now[slot] = domain.pick(now[i]);
            gathered.count = gathered.count.wrapping_add(1);
        }
    }
    flush(domain, at, memory, &mut gathered, &mut row, records, &mut tally);
    std::mem::swap(&mut memory.last, &mut memory.next);
    tally
}

/// Where a rising sequence of pixels is in the image.
struct Row {
    width: u32,
    y: u32,
    start: u32,
    /// The tile's first pixel.
    first: u32,
}

impl Row {
    fn new(at: &Interval<'_>) -> Self {
        let first = at.first as u32;
        let y = first / at.width;
        Self { width: at.width, y, start: y * at.width, first }
    }

    /// (x, y) of a pixel of the tile; never one before the last.
    #[inline(always)]
    fn place(&mut self, pixel: u32) -> (u32, u32) {
        let pixel = self.first.wrapping_add(pixel);
        while pixel.wrapping_sub(self.start) >= self.width {
            self.start = self.start.wrapping_add(self.width);
            self.y = self.y.wrapping_add(1);
        }
        (pixel.wrapping_sub(self.start), self.y)
    }
}

/// Treats the gathered pixels: the rules of [`crate::trigger::decide_within`] and [`crate::trigger::fire_time_us`], many at a time.
#[inline(always)]
fn flush<D: Domain>(
    domain: &D,
    at: &Interval<'_>,
    memory: &mut Memory<D::Value>,
    gathered: &mut Gathered,
    row: &mut Row,
    records: &mut Vec<Record>,
    tally: &mut Tally,
) {
    const MOST: f32 = MAX_EVENTS_PER_INTERVAL as f32;
    let sensor = at.sensor;
    let (on, off) = (sensor.threshold_on, sensor.threshold_off);
    let latch = sensor.trigger == TriggerRule::Latch;
    let interval = at.us as f32;
    let tie = if latch { 0.0 } else { domain.tie() };
    let Gathered { count, pixel, reference, before, now } = gathered;
    let used = count.next_multiple_of(8).min(BATCH);
    let (mut fires, mut offset) = ([0_u32; BATCH], [0_u32; BATCH]);
    let (mut level, mut run, mut threshold) = ([0_f32; BATCH], [0_f32; BATCH], [0_f32; BATCH]);
    for i in 0..used {
        let (l0, l1, r) = (domain.log(before[i]), domain.log(now[i]), reference[i]);
        let change = l1 - r;
        let rises = change >= 0.0;
        let sign = if rises { 1.0 } else { -1.0 };
        let c = if rises { on } else { off };
        let rise_end = change * sign;
        let rise_start = (l0 - r) * sign;
        let ratio = (rise_end + tie) / c;
        let ratio = if ratio < MOST + 1.0 { ratio } else { MOST + 1.0 };
        let steps = simd::whole(ratio) as i32 as f32;
        let number = if steps > MOST { MOST } else { steps };
        let reached = r + sign * (number * c);
        let is_tied = (steps >= 1.0) & ((reached - l1).abs() <= tie);
        let moved = if is_tied | (steps > MOST) { l1 } else { reached };
        let moved = if latch && steps >= 1.0 { l1 } else { moved };
        let moved = if latch && steps < 1.0 { r } else { moved };
        let seen = !r.is_nan();
        reference[i] = if seen { moved } else { l1 };
        let number = if latch && number > 1.0 { 1.0 } else { number };
        fires[i] = if seen { simd::whole(number) } else { 0 };
        threshold[i] = c;
        level[i] = rise_start;
        run[i] = rise_end - rise_start;
        let part = if run[i] > 0.0 { (c - rise_start) / run[i] } else { 1.0 };
        let part = if part > 0.0 { part } else { 0.0 };
        let part = if part < 1.0 { part } else { 1.0 };
        let first = simd::whole(part * interval);
        let first = if latch { at.us } else { first };
        // Within (start, end]: in f32, the product may round beyond the end.
        let first = if first < 1 { 1 } else { first };
        offset[i] = if first > at.us { at.us } else { first };
        // The sign travels in the top bit.
        fires[i] |= u32::from(rises) << 31;
    }
    let (mut low, mut high) = ([D::Value::MISSING; BATCH], [D::Value::MISSING; BATCH]);
    for i in 0..used {
        (low[i], high[i]) = domain.range(sensor, reference[i]);
    }
    let count = std::mem::take(count).min(BATCH);
    // The first event of each pixel, until one has a second.
    let mut firsts = [Record::new(0, 0, 0, Polarity::Off); BATCH];
    let mut waiting = 0_usize;
    for i in 0..count {
        let number = fires[i] & 0x7fff_ffff;
        let polarity = if fires[i] >> 31 == 1 { Polarity::On } else { Polarity::Off };
        let (x, y) = row.place(pixel[i]);
        firsts[waiting % BATCH] = Record::new(offset[i], x, y, polarity);
        // Without a branch: whether a pixel that left its range fires is hard to foretell.
        waiting = waiting.wrapping_add(usize::from(number != 0));
        if number <= 1 {
            continue;
        }
        records.extend_from_slice(&firsts[..waiting.min(BATCH)]);
        waiting = 0;
        let mut k = 1.0_f32;
        for _ in 1..number {
            k += 1.0;
            let part = if run[i] > 0.0 { (k * threshold[i] - level[i]) / run[i] } else { 1.0 };
            let offset = (part.clamp(0.0, 1.0) * interval) as u32;
            records.push(Record::new(offset.clamp(1, at.us.max(1)), x, y, polarity));
        }
        tally.clamped += u64::from(number == MAX_EVENTS_PER_INTERVAL);
    }
    records.extend_from_slice(&firsts[..waiting.min(BATCH)]);
    for i in 0..count {
        let index = pixel[i] as usize;
        memory.reference[index] = reference[i];
        memory.low[index] = low[i];
        if D::UPPER {
            memory.high[index] = high[i];
        }
    }
}

/// What kind of frames `source` gives, in words.
pub(crate) const fn kind_of(source: &Source<'_>) -> &'static str {
    match source {
        Source::Log { .. } => "logarithms",
        Source::U8 { .. } => "8-bit integers of one channel",
        Source::U16 { .. } => "16-bit integers of one channel",
        _ => "light",
    }
}

/// A tile's memory, by the kind of frame that it was begun with.
#[derive(Clone, Debug)]
pub(crate) enum Pixels {
    Light(Memory<f32>),
    Log(Memory<f32>),
    U8(Memory<u8>),
    U16(Memory<u16>),
}

macro_rules! passes {
    ($scan:ident, $fire:ident, $domain:ty, $value:ty) => {
        dispatched!(
            fn $scan(domain: &$domain, at: &Interval<'_>, memory: &mut Memory<$value>) -> (u64, bool)
                = scan_body::<_, 1>, wide scan_body::<_, 8>, widest scan_body::<_, 16>
        );
        dispatched!(
            fn $fire(
                domain: &$domain,
                at: &Interval<'_>,
                memory: &mut Memory<$value>,
                records: &mut Vec<Record>,
            ) -> Tally = fire_body
        );
    };
}
passes!(scan_linear, fire_linear, Light<Linear<'_>>, f32);
passes!(scan_light, fire_light, Light<Any<'_>>, f32);
passes!(scan_log, fire_log, Logs<'_>, f32);
passes!(scan_u8, fire_u8, Integers<'_, u8>, u8);
passes!(scan_u16, fire_u16, Integers<'_, u16>, u16);

impl Pixels {
    /// Memory for `length` pixels of frames like `source`.
    pub fn new(source: &Source<'_>, length: usize) -> Self {
        let kind = match source {
            Source::Log { .. } => 2,
            Source::U8 { .. } => 3,
            Source::U16 { .. } => 4,
            _ => 1,
        };
        Self::of_kind(kind, length)
    }

    /// Memory for `length` pixels of the kinds 1 to 4: light, logarithms, 8 bits, 16 bits.
    pub fn of_kind(kind: u64, length: usize) -> Self {
        match kind {
            2 => Self::Log(Memory::new(length, true)),
            3 => Self::U8(Memory::new(length, true)),
            4 => Self::U16(Memory::new(length, true)),
            _ => Self::Light(Memory::new(length, false)),
        }
    }

    /// What kind of frames the memory is of, in words.
    pub const fn kind(&self) -> &'static str {
        match self {
            Self::Light(_) => "light",
            Self::Log(_) => "logarithms",
            Self::U8(_) => "8-bit integers of one channel",
            Self::U16(_) => "16-bit integers of one channel",
        }
    }

    /// First pass; changes nothing that outlives a push. How many values are NaN, whether one is impossible.
    pub fn scan(&mut self, isa: simd::Isa, source: Source<'_>, at: &Interval<'_>) -> (u64, bool) {
        match (self, source) {
            (Self::Log(memory), Source::Log { values }) => scan_log(isa, &Logs(values), at, memory),
            (Self::U8(memory), Source::U8 { values, codes, .. }) => {
                scan_u8(isa, &Integers(values, codes), at, memory)
            }
            (Self::U16(memory), Source::U16 { values, codes, .. }) => {
                scan_u16(isa, &Integers(values, codes), at, memory)
            }
            (Self::Light(memory), Source::Linear { values, inverse_reference }) => {
                let light = Light::new(Linear { values, inverse_reference }, at.sensor);
                scan_linear(isa, &light, at, memory)
            }
            (Self::Light(memory), source) => {
                scan_light(isa, &Light::new(Any(source, at.sensor.log_eps), at.sensor), at, memory)
            }
            // `check` was asked before.
            _ => (0, false),
        }
    }

    /// Second pass: events, and what is remembered.
    pub fn fire(
        &mut self,
        isa: simd::Isa,
        source: Source<'_>,
        at: &Interval<'_>,
        records: &mut Vec<Record>,
    ) -> Tally {
        match (self, source) {
            (Self::Log(memory), Source::Log { values }) => fire_log(isa, &Logs(values), at, memory, records),
            (Self::U8(memory), Source::U8 { values, codes, .. }) => {
                fire_u8(isa, &Integers(values, codes), at, memory, records)
            }
            (Self::U16(memory), Source::U16 { values, codes, .. }) => {
                fire_u16(isa, &Integers(values, codes), at, memory, records)
            }
            (Self::Light(memory), Source::Linear { values, inverse_reference }) => {
                let light = Light::new(Linear { values, inverse_reference }, at.sensor);
                fire_linear(isa, &light, at, memory, records)
            }
            (Self::Light(memory), source) => {
                fire_light(isa, &Light::new(Any(source, at.sensor.log_eps), at.sensor), at, memory, records)
            }
            _ => Tally::default(),
        }
    }

    /// Whether frames of `source` can follow the ones that were seen.
    ///
    /// # Errors
    /// Names both kinds.
    pub fn check(&self, source: &Source<'_>) -> Result<(), ConfigError> {
        let given = kind_of(source);
        if given == self.kind() {
            return Ok(());
        }
        let remedy = format!("as before, {}; or reset all environments first", self.kind());
        Err(ConfigError::new("kind of frames", given, remedy))
    }
}
