//! Records in pixel order become events in the order (t, y, x, firing), by counting.

use std::mem::MaybeUninit;
use std::ops::Range;

use super::workers::Threads;
use crate::event::{Event, Polarity};

/// An event on its way to its place: 8 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Record {
    /// Microseconds since the interval's start, at most [`MAX_INTERVAL_US`]; the top bit is the polarity.
    when: u32,
    /// Row and column.
    place: u32,
}

/// Longest interval between two frames.
pub(crate) const MAX_INTERVAL_US: i64 = 1 << 30;

impl Record {
    #[inline(always)]
    pub const fn new(offset_us: u32, x: u32, y: u32, polarity: Polarity) -> Self {
        let sign = match polarity {
            Polarity::On => 1 << 31,
            Polarity::Off => 0,
        };
        Self { when: offset_us | sign, place: (y << 16) | x }
    }

    #[inline(always)]
    pub const fn offset_us(self) -> u32 {
        self.when & 0x7fff_ffff
    }

    #[inline(always)]
    pub fn event(self, start_us: i64) -> Event {
        let polarity = if self.when >> 31 == 1 { Polarity::On } else { Polarity::Off };
        // Wrapping cannot happen: the caller checked that the interval's end is an i64.
        let t = start_us.wrapping_add(i64::from(self.offset_us()));
        Event::new(t, self.place as u16, (self.place >> 16) as u16, polarity)
    }
}

/// Above this, an interval has too many microseconds to count them all for every frame.
const COUNTED_US: usize = 1 << 17;

/// Consecutive records, and what sorting them takes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Span {
    range: Range<usize>,
    /// Per microsecond: records, then the end of its run.
    ends: Vec<u32>,
    /// By time.
    sorted: Vec<Record>,
}

/// Appends the events of `parts`, each in pixel order and one after the other, to `out`, sorted by time.
/// All offsets lie in 1..=`interval_us`.
pub(crate) fn append_sorted(
    parts: &[&[Record]],
    start_us: i64,
    interval_us: u32,
    spans: &mut Vec<Span>,
    threads: Threads<'_>,
    out: &mut Vec<Event>,
) {
    let total: usize = parts.iter().map(|part| part.len()).sum();
    if total == 0 {
        return;
    }
    let buckets = interval_us as usize + 1;
    let base = out.len();
    // Few events do not pay for many buckets.
    if buckets > COUNTED_US || buckets > 64 * total {
        out.extend(parts.iter().flat_map(|part| part.iter().map(|record| record.event(start_us))));
        out[base..].sort_by_key(|event| event.t);
        return;
    }
    // Nor for many threads.
    let count = threads.count().min(total / 4096).min(4 * total / buckets).max(1);
    spans.resize(count, Span::default());
    for (i, span) in spans.iter_mut().enumerate() {
        span.range = i * total / count..(i + 1) * total / count;
    }
    out.reserve(total);
    let slots = &mut out.spare_capacity_mut()[..total];
    if let [span] = &mut spans[..] {
        span.count(parts, buckets);
        span.place(parts, slots, |record| record.event(start_us));
    } else {
        // Threads write near themselves: each sorts what it fired, then they merge an interval of time each.
        threads.each(spans, |span| {
            span.count(parts, buckets);
            let mut sorted = std::mem::take(&mut span.sorted);
            sorted.clear();
            sorted.reserve(span.range.len());
            span.place(parts, &mut sorted.spare_capacity_mut()[..span.range.len()], |record| record);
            // SAFETY: `place` has written as many as it was given.
            unsafe { sorted.set_len(span.range.len()) };
            span.sorted = sorted;
        });
        threads
            .each(&mut shares(spans, buckets, slots), |(range, slots)| merge(spans, range, start_us, slots));
    }
    // SAFETY: `place` has written all, or `merge`, whose shares are all runs of all spans.
    unsafe { out.set_len(base + total) };
}

impl Span {
    fn count(&mut self, parts: &[&[Record]], buckets: usize) {
        self.ends.clear();
        self.ends.resize(buckets, 0);
        for records in slices(parts, &self.range) {
            for record in records {
                let count = &mut self.ends[record.offset_us() as usize];
                *count = count.wrapping_add(1);
            }
        }
    }

    /// Writes all of `slots`, which are as many as were counted.
    fn place<T>(&mut self, parts: &[&[Record]], slots: &mut [MaybeUninit<T>], make: impl Fn(Record) -> T) {
        let mut next = 0_u32;
        for count in &mut self.ends {
            next = next.wrapping_add(std::mem::replace(count, next));
        }
        for records in slices(parts, &self.range) {
            for record in records {
                let slot = &mut self.ends[record.offset_us() as usize];
                slots[*slot as usize].write(make(*record));
                *slot = slot.wrapping_add(1);
            }
        }
    }

    /// First and last of the records of microsecond `bucket`, plus one.
    fn run(&self, bucket: usize) -> Range<usize> {
        let start = if bucket == 0 { 0 } else { self.ends[bucket - 1] };
        start as usize..self.ends[bucket] as usize
    }
}

/// Microseconds, and the slots of what fired in them.
type Share<'a> = (Range<usize>, &'a mut [MaybeUninit<Event>]);

/// Divides time so that about as many events happened in each share.
fn shares<'a>(spans: &[Span], buckets: usize, mut slots: &'a mut [MaybeUninit<Event>]) -> Vec<Share<'a>> {
    let (total, threads) = (slots.len(), spans.len());
    let mut shares = Vec::with_capacity(threads);
    let (mut first, mut done) = (0, 0);
    for bucket in 0..buckets {
        let end: usize = spans.iter().map(|span| span.ends[bucket] as usize).sum();
        if end * threads >= (shares.len() + 1) * total {
            let (own, rest) = std::mem::take(&mut slots).split_at_mut(end - done);
            shares.push((first..bucket + 1, own));
            (first, done, slots) = (bucket + 1, end, rest);
        }
    }
    // The last bucket that holds something ended the last share.
    assert!(slots.is_empty(), "an offset is outside of its interval");
    shares
}

/// Writes the events of `range`, in the order of `spans` within a microsecond, into all of `slots`.
fn merge(spans: &[Span], range: &Range<usize>, start_us: i64, slots: &mut [MaybeUninit<Event>]) {
    let mut slots = slots.iter_mut();
    for bucket in range.clone() {
        for span in spans {
            let records = &span.sorted[span.run(bucket)];
            for (record, slot) in records.iter().zip(slots.by_ref()) {
                slot.write(record.event(start_us));
            }
        }
    }
    assert_eq!(slots.len(), 0, "as many events as were counted");
}

/// The records `range` of all `parts`.
fn slices<'a>(parts: &'a [&[Record]], range: &Range<usize>) -> impl Iterator<Item = &'a [Record]> + use<'a> {
    let Range { start, end } = *range;
    let mut first = 0;
    parts.iter().map(move |part| {
        let at = |place: usize| place.clamp(first, first + part.len()) - first;
        let own = &part[at(start)..at(end)];
        first += part.len();
        own
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::philox;

    #[test]
    fn counting_and_comparing_agree() {
        for (interval, count) in [(1000, 5000), (1000, 3), (33_333, 20_000), (1 << 20, 100), (1, 10)] {
            let mut records = Vec::new();
            for i in 0..count {
                let [offset, polarity, ..] = philox([i, 0, 0, 0], [1, 2]);
                let polarity = if polarity & 1 == 1 { Polarity::On } else { Polarity::Off };
                records.push(Record::new(offset % interval + 1, i % 40, i / 40, polarity));
            }
            let (first, second) = records.split_at(records.len() / 3);
            let mut expected: Vec<Event> = records.iter().map(|record| record.event(100)).collect();
            expected.sort_by_key(Event::order);
            for threads in [1, 2, 3] {
                let mut got = vec![Event::new(0, 0, 0, Polarity::On)];
                append_sorted(
                    &[first, &[], second],
                    100,
                    interval,
                    &mut Vec::new(),
                    Threads::Pool(threads),
                    &mut got,
                );
                assert_eq!(got[1..], expected);
            }
            // Canary: unsorted, they differ.
            let unsorted: Vec<Event> = records.iter().map(|record| record.event(100)).collect();
            assert!(interval == 1 || unsorted != expected);
        }
    }
}
