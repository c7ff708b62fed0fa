//! From device records to events in canonical order.

use evis_core::{Cause, Event, Polarity};
use rayon::prelude::*;

/// Column and row take 13 bits each in a record's second word; then polarity, then cause.
const COORDINATE_BITS: u32 = 13;

/// One record of the device: microseconds since `base_us`, then the packed pixel; with `caused`, marked with its cause.
fn event(record: [u32; 2], base_us: i64, caused: bool) -> Event {
    let mask = (1 << COORDINATE_BITS) - 1;
    let x = (record[1] & mask) as u16;
    let y = (record[1] >> COORDINATE_BITS & mask) as u16;
    let polarity = if record[1] >> (2 * COORDINATE_BITS) & 1 == 1 { Polarity::On } else { Polarity::Off };
    let event = Event::new(base_us + i64::from(record[0]), x, y, polarity);
    let cause = (record[1] >> (2 * COORDINATE_BITS + 1)) as usize % Cause::ALL.len();
    if caused { event.with_cause(Cause::ALL[cause]) } else { event }
}

/// Splits `records` at `offsets` and hands each view's events, in canonical order, to `sink`.
///
/// Records come pixel by pixel (row-major) and in firing order within a pixel, so a stable sort by time alone
/// gives the order (t, y, x, firing).
pub fn views(
    records: &[[u32; 2]],
    offsets: &[u32],
    base_us: i64,
    span_us: u32,
    caused: bool,
    view_indices: impl Iterator<Item = usize>,
    mut sink: impl FnMut(usize, Vec<Event>),
) {
    let slices: Vec<&[[u32; 2]]> =
        offsets.windows(2).map(|w| &records[w[0] as usize..w[1] as usize]).collect();
    let sorted: Vec<Vec<Event>> = slices.par_iter().map(|s| sort(s, base_us, span_us, caused)).collect();
    for (view, events) in view_indices.zip(sorted) {
        sink(view, events);
    }
}

/// The events of `records`, as they come: pixel by pixel, in firing order.
pub fn events(records: &[[u32; 2]], base_us: i64, caused: bool) -> Vec<Event> {
    records.iter().map(|&record| event(record, base_us, caused)).collect()
}

/// Stable sort by time: counting sort where events are many for the span, comparison sort where few.
fn sort(records: &[[u32; 2]], base_us: i64, span_us: u32, caused: bool) -> Vec<Event> {
    let bins = span_us as usize + 1;
    if records.len() < bins / 16 {
        let mut events: Vec<_> = records.iter().map(|&r| event(r, base_us, caused)).collect();
        events.sort_by_key(|e| e.t);
        return events;
    }
    let mut starts = vec![0u32; bins + 1];
    for record in records {
        starts[(record[0] as usize).min(bins - 1) + 1] += 1;
    }
    for i in 0..bins {
        starts[i + 1] += starts[i];
    }
    let mut events = vec![Event::default(); records.len()];
    for &record in records {
        let at = &mut starts[(record[0] as usize).min(bins - 1)];
        events[*at as usize] = event(record, base_us, caused);
        *at += 1;
    }
    events
}

/// Appends sorted `new` to sorted `events`. An interval (t0, t1] may put events at the floor of t0, where the last
/// interval's final events may lie too: those of one microsecond are brought in order across the seam.
pub fn append(events: &mut Vec<Event>, new: Vec<Event>) {
    let seam = match (events.last(), new.first()) {
        (Some(last), Some(first)) if first.t <= last.t => Some((first.t, last.t)),
        _ => None,
    };
    events.extend(new);
    if let Some((from, to)) = seam {
        let start = events.partition_point(|e| e.t < from);
        // The tail after the seam is in order already.
        let end = start + events[start..].iter().rposition(|e| e.t <= to).map_or(0, |i| i + 1);
        events[start..end].sort_by_key(Event::order);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(t: u32, x: u32, y: u32, on: u32) -> [u32; 2] {
        [t, x | y << 13 | on << 26]
    }

    #[test]
    fn both_sorts_are_stable_and_agree() {
        // Pixel-major, as the device writes; pixel (1, 0) fires twice at one microsecond, OFF then ON.
        let records = [
            record(7, 0, 0, 1),
            record(3, 1, 0, 0),
            record(3, 1, 0, 1),
            record(3, 0, 1, 1),
            record(9, 8191, 8191, 0),
        ];
        let dense = sort(&records, 100, 20, false);
        let sparse = sort(&records, 100, 1_000_000, false);
        assert_eq!(dense, sparse);
        let got: Vec<_> = dense.iter().map(|e| (e.t, e.x, e.y, e.p)).collect();
        assert_eq!(
            got,
            [(103, 1, 0, 0), (103, 1, 0, 1), (103, 0, 1, 1), (107, 0, 0, 1), (109, 8191, 8191, 0)]
        );
    }

    #[test]
    fn a_seam_at_one_microsecond_is_ordered() {
        let e = |t, x, p| Event::new(t, x, 0, p);
        let mut events = vec![e(4, 9, Polarity::On), e(5, 3, Polarity::On)];
        append(&mut events, vec![e(5, 1, Polarity::Off), e(5, 3, Polarity::Off), e(6, 0, Polarity::On)]);
        let got: Vec<_> = events.iter().map(|e| (e.t, e.x, e.p)).collect();
        assert_eq!(got, [(4, 9, 1), (5, 1, 0), (5, 3, 1), (5, 3, 0), (6, 0, 1)]);
    }

    #[test]
    fn each_view_gets_its_own() {
        let records = [record(1, 0, 0, 1), record(2, 5, 5, 0), record(1, 2, 2, 1)];
        let mut got = Vec::new();
        views(&records, &[0, 1, 1, 3], 0, 10, false, [4, 7, 2].into_iter(), |v, e| got.push((v, e.len())));
        assert_eq!(got, [(4, 1), (7, 0), (2, 2)]);
    }
}
