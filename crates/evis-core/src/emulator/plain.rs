//! Pixels that light alone moves in an interval, a block at a time: no noise reaches them, and nothing is held. What they fire is
//! what `chain::Pixel` has, by the same arithmetic; what all pixels share is taken out of the loop.

use super::frames::BLOCK;
use super::ideal::Tally;
use super::numbering::Numbering;
use super::order::Record;
use crate::event::{Cause, Polarity};
use crate::simd::{self, dispatched};

/// Times of a pixel's events within a frame that are known for all pixels.
const KNOWN_TIMES: usize = 16;

/// What all pixels share in an interval.
#[derive(Clone, Debug)]
pub(super) struct Shared {
    pub numbering: Numbering,
    /// Pixels per row of the image.
    pub width: u32,
    /// Length of the interval, microseconds.
    pub us: u32,
    /// When it starts, on the tile's clock.
    pub since_us: i32,
    /// Refractory period, microseconds; 0: none.
    pub period: f64,
    /// Whether the reference moves by events that the refractory period hides.
    pub hidden_moves: bool,
    /// Delay of every event, microseconds.
    pub delay_us: u32,
    pub most_events: u32,
    /// See `Chain::tie`.
    pub tie: f32,
    pub when: Moments,
}

/// When events happen that are decided at samples.
#[derive(Clone, Debug)]
pub(super) enum Moments {
    /// Where the line between two samples crosses the level.
    Crossing,
    /// At the sample.
    Sample,
    /// Evenly over the frame.
    Even,
    /// Evenly over the frame by the pixel that fires most, with the first times of so many.
    Common { most: u32, times: [f64; KNOWN_TIMES] },
}

impl Moments {
    /// [`Self::Common`] of an interval of `us` microseconds.
    pub fn common(most: u32, us: u32) -> Self {
        let time = |k: usize| f64::from(us) * (k + 1) as f64 / f64::from(most);
        Self::Common { most, times: std::array::from_fn(time) }
    }

    /// Of event `k` of `number`, from 1.
    #[inline(always)]
    fn of(&self, k: u32, number: u32, end: f64) -> f64 {
        match self {
            Self::Crossing | Self::Sample => end,
            Self::Even => end * f64::from(k) / f64::from(number),
            Self::Common { most, times } if number <= *most && k as usize <= KNOWN_TIMES => {
                times[k as usize - 1]
            }
            Self::Common { most, .. } => end * f64::from(k) / f64::from((*most).max(number)),
        }
    }
}

/// Pixels of a block; slices are empty where their stage is off.
pub(super) struct Pixels<'a> {
    /// Index of the first one in the tile.
    pub first: u32,
    pub on: &'a [f32],
    pub off: &'a [f32],
    /// Signal at the interval's start and end.
    pub before: &'a [f32],
    pub after: &'a [f32],
    pub reference: &'a mut [f32],
    pub fired: &'a mut [i32],
    pub polarity: &'a mut [u8],
    /// Of the leak.
    pub moved: &'a mut [i32],
    pub slope: &'a [f32],
}

/// Where events go.
pub(super) struct Sink<'a> {
    pub tally: &'a mut Tally,
    pub records: &'a mut Vec<Record>,
    pub causes: Option<&'a mut Vec<Cause>>,
    /// Pixels whose leak's jitter is drawn again at the interval's end; `None` where there is no jitter.
    pub moved_last: Option<&'a mut Vec<u32>>,
}

/// Where the pixels lie in the image, one after the other.
struct Places {
    width: u32,
    row: u32,
    start: u32,
}

impl Places {
    /// Column and row of a pixel; mostly it lies in the row of the one before.
    #[inline(always)]
    fn of(&mut self, pixel: u32) -> (u32, u32) {
        if pixel.wrapping_sub(self.start) >= self.width {
            self.row = pixel / self.width;
            self.start = self.row * self.width;
        }
        (pixel - self.start, self.row)
    }
}

impl Pixels<'_> {
    /// Whether the pixel's last event was less than the refractory period before `t`.
    #[inline(always)]
    fn is_refractory(&self, shared: &Shared, i: usize, t: f64) -> bool {
        match self.fired.get(i) {
            Some(fired) if shared.period > 0.0 => {
                let fired = (i64::from(*fired) - i64::from(shared.since_us)) as f64;
                t - fired < shared.period
            }
            _ => false,
        }
    }

    #[inline(always)]
    fn emit(
        &mut self,
        shared: &Shared,
        i: usize,
        (x, y): (u32, u32),
        t: f64,
        (polarity, cause): (Polarity, Cause),
        sink: &mut Sink<'_>,
    ) {
        let offset = (t as u32).clamp(1, shared.us.max(1));
        sink.records.push(Record::new(offset + shared.delay_us, x, y, polarity));
        if let Some(causes) = &mut sink.causes {
            causes.push(cause);
        }
        if let Some(fired) = self.fired.get_mut(i) {
            *fired = (i64::from(shared.since_us) + i64::from(offset)) as i32;
        }
        if let Some(last) = self.polarity.get_mut(i) {
            *last = u8::from(polarity == Polarity::On);
        }
    }

    /// Whether all pixels of `mask` have a reference.
    #[inline(always)]
    fn have_begun(&self, mask: u64) -> bool {
        let Some(reference) = self.reference.first_chunk::<BLOCK>() else { return false };
        let missing = simd::bits_of(&reference.map(|reference| u8::from(!reference.is_finite())));
        missing & mask == 0
    }
}

/// Crossings of straight signals at their own times. Whether this was possible; else nothing has changed.
#[inline(always)]
fn lines_body(shared: &Shared, mut pixels: Pixels<'_>, mut mask: u64, mut sink: Sink<'_>) -> bool {
    if !pixels.have_begun(mask) {
        return false;
    }
    let end = f64::from(shared.us);
    let mut places = Places { width: shared.width, row: 0, start: 0 };
    while mask != 0 {
        let i = mask.trailing_zeros() as usize % BLOCK;
        mask &= mask.wrapping_sub(1);
        let place = places.of(shared.numbering.of(pixels.first + i as u32));
        let (on, off) = (f64::from(pixels.on[i]), f64::from(pixels.off[i]));
        let start = f64::from(pixels.before[i]);
        let slope = (f64::from(pixels.after[i]) - start) / end;
        let last = start + slope * end;
        let (mut t, mut count) = (0.0, 0);
        loop {
            let reference = f64::from(pixels.reference[i]);
            let (low, high) = (reference - off, reference + on);
            let begin = start + slope * t;
            let rises = begin >= high || (begin > low && last >= high);
            let (at, step) = if begin >= high || begin <= low {
                (t, if rises { on } else { -off })
            } else if last >= high || last <= low {
                let level = if rises { high } else { low };
                (((level - start) / slope).clamp(t, end), if rises { on } else { -off })
            } else {
                break;
            };
            t = at;
            count += 1;
            if pixels.is_refractory(shared, i, t) {
                sink.tally.suppressed += 1;
            } else {
                let polarity = if rises { Polarity::On } else { Polarity::Off };
                pixels.emit(shared, i, place, t, (polarity, Cause::Signal), &mut sink);
            }
            if count > shared.most_events {
                sink.tally.clamped += 1;
                pixels.reference[i] = pixels.after[i];
                break;
            }
            pixels.reference[i] = (reference + step) as f32;
        }
    }
    true
}

dispatched!(
    /// [`lines_body`].
    pub(super) fn lines(shared: &Shared, pixels: Pixels<'_>, mask: u64, sink: Sink<'_>) -> bool = lines_body
);

/// Events that are decided at samples, as v2e has them. Whether this was possible; else nothing has changed.
#[inline(always)]
fn samples_body(shared: &Shared, mut pixels: Pixels<'_>, mut mask: u64, mut sink: Sink<'_>) -> bool {
    if !pixels.have_begun(mask) {
        return false;
    }
    let end = f64::from(shared.us);
    let (mut leaked, mut change, mut steps) = ([0.0_f32; BLOCK], [0.0_f32; BLOCK], [0_u32; BLOCK]);
    if let (Some(moved), Some(slope)) =
        (pixels.moved.first_chunk::<BLOCK>(), pixels.slope.first_chunk::<BLOCK>())
    {
        for i in 0..BLOCK {
            let slope = f64::from(slope[i]);
            let at_start = -slope * f64::from(moved[i].wrapping_sub(shared.since_us));
            leaked[i] = (at_start + slope * end) as f32;
        }
    }
    let all = (
        pixels.on.first_chunk::<BLOCK>(),
        pixels.off.first_chunk::<BLOCK>(),
        pixels.after.first_chunk::<BLOCK>(),
        pixels.reference.first_chunk::<BLOCK>(),
    );
    let (Some(on), Some(off), Some(after), Some(reference)) = all else { return false };
    for i in 0..BLOCK {
        change[i] = after[i] - reference[i] + leaked[i];
        let step = if change[i] >= 0.0 { on[i] } else { off[i] };
        steps[i] = simd::whole((change[i].abs() + shared.tie) / step);
    }
    let mut places = Places { width: shared.width, row: 0, start: 0 };
    while mask != 0 {
        let i = mask.trailing_zeros() as usize % BLOCK;
        mask &= mask.wrapping_sub(1);
        let number = steps[i].min(shared.most_events);
        if number == 0 {
            continue;
        }
        let rises = change[i] >= 0.0;
        let polarity = if rises { Polarity::On } else { Polarity::Off };
        let is_leak = rises && leaked[i] > 0.0 && f64::from(leaked[i]) >= 0.5 * f64::from(change[i]);
        let cause = if is_leak { Cause::Leak } else { Cause::Signal };
        let place = places.of(shared.numbering.of(pixels.first + i as u32));
        let mut fired = 0;
        for k in 1..=number {
            let t = shared.when.of(k, number, end);
            let silent = pixels.is_refractory(shared, i, t);
            sink.tally.suppressed += u64::from(silent);
            if !silent {
                pixels.emit(shared, i, place, t, (polarity, cause), &mut sink);
            }
            fired += u32::from(!silent || shared.hidden_moves);
        }
        if steps[i] > number {
            sink.tally.clamped += 1;
            pixels.reference[i] = pixels.after[i];
        } else if fired > 0 {
            let moved = fired as f32 * if rises { pixels.on[i] } else { pixels.off[i] };
            let sign = if rises { 1.0 } else { -1.0 };
            let next = pixels.reference[i] + (sign * moved - leaked[i]);
            let is_tied = fired == steps[i] && (next - pixels.after[i]).abs() <= shared.tie;
            pixels.reference[i] = if is_tied { pixels.after[i] } else { next };
        } else {
            continue;
        }
        if let Some(moved) = pixels.moved.get_mut(i) {
            *moved = (i64::from(shared.since_us) + i64::from(shared.us)) as i32;
            if let Some(moved_last) = &mut sink.moved_last {
                moved_last.push(pixels.first + i as u32);
            }
        }
    }
    true
}

dispatched!(
    /// [`samples_body`].
    pub(super) fn samples(shared: &Shared, pixels: Pixels<'_>, mask: u64, sink: Sink<'_>) -> bool = samples_body
);
