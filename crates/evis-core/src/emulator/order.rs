//! Records in pixel order become events in the order (t, y, x, firing), by counting.

use std::mem::MaybeUninit;

use rayon::prelude::*;

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

/// A range of the interval that one thread sorts: counts per microsecond from its start on.
#[derive(Clone, Debug, Default)]
pub(crate) struct Span {
    first: usize,
    counts: Vec<u32>,
}

/// Appends the events of `parts`, each in pixel order and one after the other, to `out`, sorted by time.
/// All offsets lie in 1..=`interval_us`. There is a span per thread that may work on it; one is enough.
pub(crate) fn append_sorted(
    parts: &[&[Record]],
    start_us: i64,
    interval_us: u32,
    spans: &mut Vec<Span>,
    threads: usize,
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
    let threads = threads.clamp(1, total.div_ceil(4096)).min(buckets);
    spans.resize(threads, Span::default());
    let length = buckets.div_ceil(threads);
    for (i, span) in spans.iter_mut().enumerate() {
        span.first = i * length;
        span.counts.clear();
        span.counts.resize(length, 0);
    }
    out.reserve(total);
    let mut spare = &mut out.spare_capacity_mut()[..total];
    let single = threads == 1;
    if single {
        spans[0].count(parts);
    } else {
        spans.par_iter_mut().for_each(|span| span.count(parts));
    }
    let mut work = Vec::with_capacity(threads);
    for span in spans.iter_mut() {
        let own: usize = span.counts.iter().map(|count| *count as usize).sum();
        let (slots, rest) = spare.split_at_mut(own);
        spare = rest;
        work.push((span, slots));
    }
    // Each record was counted by exactly one span.
    assert!(spare.is_empty(), "an offset is outside of its interval");
    if single {
        for (span, slots) in work {
            span.place(parts, start_us, slots);
        }
    } else {
        work.into_par_iter().for_each(|(span, slots)| span.place(parts, start_us, slots));
    }
    // SAFETY: the spans' slots are all of the `total` slots, and the prefix sums give each record one of its own.
    unsafe { out.set_len(base + total) };
}

impl Span {
    fn count(&mut self, parts: &[&[Record]]) {
        for part in parts {
            for record in *part {
                let bucket = (record.offset_us() as usize).wrapping_sub(self.first);
                if let Some(count) = self.counts.get_mut(bucket) {
                    *count = count.wrapping_add(1);
                }
            }
        }
    }

    fn place(&mut self, parts: &[&[Record]], start_us: i64, slots: &mut [MaybeUninit<Event>]) {
        let mut next = 0_u32;
        for count in &mut self.counts {
            next = next.wrapping_add(std::mem::replace(count, next));
        }
        for part in parts {
            for record in *part {
                let bucket = (record.offset_us() as usize).wrapping_sub(self.first);
                if let Some(slot) = self.counts.get_mut(bucket) {
                    slots[*slot as usize].write(record.event(start_us));
                    *slot = slot.wrapping_add(1);
                }
            }
        }
    }
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
                append_sorted(&[first, second], 100, interval, &mut Vec::new(), threads, &mut got);
                assert_eq!(got[1..], expected);
            }
            // Canary: unsorted, they differ.
            let unsorted: Vec<Event> = records.iter().map(|record| record.event(100)).collect();
            assert!(interval == 1 || unsorted != expected);
        }
    }
}
