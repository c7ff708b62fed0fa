//! Every representation equals its published definition, written here as sums over all events and all cells.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::collections::BTreeMap;

use evis_core::{Event, Polarity};
use evis_representation::{
    Array, Decay, Error, Measure, Polarities, Slice, averaged_timestamps, bina_rep, binary_stack, counts,
    event_frame, event_spike_tensor, normalize_nonzero, time_surfaces, voxel_grid,
};

const SIZE: (u32, u32) = (7, 5);

/// Random events with many ties of time and of place.
fn events(seed: u64, count: usize, span_us: u64) -> Vec<Event> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut random = |below: u64| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 16) % below
    };
    let mut made: Vec<_> = (0..count)
        .map(|_| {
            let polarity = if random(2) == 1 { Polarity::On } else { Polarity::Off };
            let (x, y) = (random(u64::from(SIZE.0)), random(u64::from(SIZE.1)));
            Event::new(random(span_us) as i64 - 20, x as u16, y as u16, polarity)
        })
        .collect();
    made.sort_by_key(Event::order);
    made
}

fn slice(events: &[Event]) -> Slice<'_> {
    Slice::new(events, SIZE).unwrap()
}

/// The sum over events of `worth` in the cell `index` of an array of `shape`.
fn sum(shape: &[usize], events: &[Event], worth: impl Fn(&Event, &[usize]) -> f64) -> Vec<f64> {
    let cells: usize = shape.iter().product();
    (0..cells)
        .map(|cell| {
            let mut index = vec![0; shape.len()];
            let mut rest = cell;
            for (place, length) in index.iter_mut().zip(shape).rev() {
                (*place, rest) = (rest % length, rest / length);
            }
            events.iter().map(|event| worth(event, &index)).sum()
        })
        .collect()
}

fn is_at(event: &Event, y: usize, x: usize) -> bool {
    (usize::from(event.y), usize::from(event.x)) == (y, x)
}

fn close<T: Copy + Into<f64>>(made: &Array<T>, expected: &[f64]) -> bool {
    made.data.len() == expected.len()
        && made.data.iter().zip(expected).all(|(a, b)| ((*a).into() - b).abs() <= 1e-5 * (1.0 + b.abs()))
}

/// Compares, and makes sure that another value is seen.
fn assert_close<T: Copy + Into<f64>>(made: &Array<T>, expected: &[f64]) {
    assert!(close(made, expected), "{:?}", made.shape);
    let mut wrong = expected.to_vec();
    wrong[expected.len() / 2] += 1e-3;
    assert!(!close(made, &wrong), "canary");
}

fn hat(distance: f64) -> f64 {
    (1.0 - distance.abs()).max(0.0)
}

fn sign(event: &Event) -> f64 {
    if event.p == 1 { 1.0 } else { -1.0 }
}

/// t*, from 0 to 1 between the first and the last event.
fn parts_of(events: &[Event]) -> impl Fn(&Event) -> f64 {
    let (first, last) = (events[0].t, events[events.len() - 1].t);
    move |event| (event.t - first) as f64 / (last - first).max(1) as f64
}

#[test]
fn voxel_grids_are_bilinear_in_time() {
    for (seed, count, bins) in
        [(1, 400, 5), (2, 400, 1), (3, 1, 5), (4, 2, 3), (5, 3000, 9), (6, 60, 9), (7, 400, 60)]
    {
        let events = events(seed, count, 60);
        let part = parts_of(&events);
        let signed = voxel_grid(&slice(&events), bins, Polarities::Signed).unwrap();
        assert_eq!(signed.shape, [bins, 5, 7]);
        let expected = sum(&signed.shape, &events, |event, i| {
            let weight = hat(part(event) * (bins - 1) as f64 - i[0] as f64);
            f64::from(u8::from(is_at(event, i[1], i[2]))) * sign(event) * weight
        });
        assert_close(&signed, &expected);
        let split = voxel_grid(&slice(&events), bins, Polarities::Split).unwrap();
        assert_eq!(split.shape, [2, bins, 5, 7]);
        let expected = sum(&split.shape, &events, |event, i| {
            let weight = hat(part(event) * (bins - 1) as f64 - i[1] as f64);
            f64::from(u8::from(is_at(event, i[2], i[3]) && event.p as usize == i[0])) * weight
        });
        assert_close(&split, &expected);
    }
}

#[test]
fn the_last_instant_is_all_in_the_last_bin() {
    let events = [Event::new(0, 0, 0, Polarity::On), Event::new(30, 3, 2, Polarity::On)];
    let grid = voxel_grid(&slice(&events), 4, Polarities::Signed).unwrap();
    assert_eq!(grid.data[3 * 35 + 2 * 7 + 3], 1.0);
    assert_eq!(grid.data.iter().sum::<f32>(), 2.0);
    // With an interval, the bins are on its limits, and what is outside does not count.
    let within = slice(&events).between(Some(0), Some(60)).unwrap();
    let grid = voxel_grid(&within, 4, Polarities::Signed).unwrap();
    assert_eq!((grid.data[35 + 17], grid.data[2 * 35 + 17]), (0.5, 0.5));
    let within = slice(&events).between(Some(0), Some(30)).unwrap();
    assert_eq!(voxel_grid(&within, 4, Polarities::Signed).unwrap().data.iter().sum::<f32>(), 1.0);
}

#[test]
fn values_that_are_not_zero_get_mean_0_and_variance_1() {
    let mut values = [0.0, 2.0, -1.0, 0.0, 5.0, 2.5];
    normalize_nonzero(&mut values);
    assert_eq!((values[0], values[3]), (0.0, 0.0));
    let left = [values[1], values[2], values[4], values[5]].map(f64::from);
    let mean = left.iter().sum::<f64>() / 4.0;
    let variance = left.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / 4.0;
    assert!(mean.abs() < 1e-6 && (variance - 1.0).abs() < 1e-6, "{mean} {variance}");
    let mut alike = [0.0, 3.0, 3.0];
    normalize_nonzero(&mut alike);
    assert_eq!(alike, [0.0; 3]);
    normalize_nonzero(&mut []);
}

#[test]
fn frames_and_counts_are_sums() {
    let events = events(7, 500, 60);
    let frame = event_frame(&slice(&events)).unwrap();
    let expected =
        sum(&frame.shape, &events, |event, i| if is_at(event, i[0], i[1]) { sign(event) } else { 0.0 });
    assert_close(&frame, &expected);
    let counts = counts(&slice(&events)).unwrap();
    assert_eq!(counts.shape, [2, 5, 7]);
    let expected = sum(&counts.shape, &events, |event, i| {
        f64::from(u8::from(is_at(event, i[1], i[2]) && event.p as usize == i[0]))
    });
    assert_close(&counts, &expected);
}

#[test]
fn event_spike_tensors_weigh_what_events_are_worth() {
    let events = events(8, 500, 60);
    let part = parts_of(&events);
    for measure in [Measure::Time, Measure::Count, Measure::Polarity] {
        let tensor = event_spike_tensor(&slice(&events), 4, measure).unwrap();
        let expected = sum(&tensor.shape, &events, |event, i| {
            let worth = match measure {
                Measure::Time => part(event),
                Measure::Count => 1.0,
                Measure::Polarity => sign(event),
            };
            let here = is_at(event, i[2], i[3]) && event.p as usize == i[0];
            f64::from(u8::from(here)) * worth * hat(3.0 * (part(event) - i[1] as f64 / 3.0))
        });
        assert_close(&tensor, &expected);
    }
}

#[test]
fn averaged_timestamps_are_means() {
    let events = events(9, 60, 60);
    let part = parts_of(&events);
    let means = averaged_timestamps(&slice(&events), -1.0).unwrap();
    let here = |event: &Event, i: &[usize]| {
        f64::from(u8::from(is_at(event, i[1], i[2]) && event.p as usize == i[0]))
    };
    let total = sum(&means.shape, &events, |event, i| here(event, i) * part(event));
    let number = sum(&means.shape, &events, here);
    let expected: Vec<f64> =
        total.iter().zip(number).map(|(t, n)| if n > 0.0 { t / n } else { -1.0 }).collect();
    assert!(expected.contains(&-1.0), "some pixels never fired");
    assert_close(&means, &expected);
}

#[test]
fn time_surfaces_fall_with_age() {
    let events = events(10, 80, 60);
    let at = [-30, -20, 5, 20, 100];
    for decay in [Decay::Exponential, Decay::Linear] {
        let surfaces = time_surfaces(&slice(&events), &at, 30.0, decay).unwrap();
        assert_eq!(surfaces.shape, [5, 2, 5, 7]);
        let mut expected = Vec::new();
        for t in at {
            let mut last = BTreeMap::new();
            for event in events.iter().filter(|event| event.t <= t) {
                last.insert((event.p as usize, usize::from(event.y), usize::from(event.x)), event.t);
            }
            for cell in 0..70 {
                let fired = last.get(&(cell / 35, cell / 7 % 5, cell % 7));
                expected.push(fired.map_or(0.0, |fired| {
                    let age = (t - fired) as f64 / 30.0;
                    if decay == Decay::Exponential { (-age).exp() } else { (1.0 - age).max(0.0) }
                }));
            }
        }
        assert!(expected[70..140].contains(&1.0), "an event at a time counts at that time");
        assert_close(&surfaces, &expected);
    }
}

#[test]
fn binary_stacks_have_equal_half_open_parts() {
    let events = events(11, 200, 61);
    let (start, end) = (events[0].t, events[events.len() - 1].t + 1);
    for (frames, bits) in [(1, 8), (3, 2), (1, 1), (2, 24)] {
        let bins = frames * bits;
        let stack = binary_stack(&slice(&events), bins).unwrap();
        assert_eq!(stack.shape, [bins, 2, 5, 7]);
        let fired = sum(&stack.shape, &events, |event, i| {
            let part = (event.t - start) * bins as i64 / (end - start);
            let here = is_at(event, i[2], i[3]) && event.p as usize == i[1];
            f64::from(u8::from(here && part == i[0] as i64))
        });
        let expected: Vec<f64> = fired.iter().map(|number| number.min(1.0)).collect();
        assert_close(&stack, &expected);
        let rep = bina_rep(&slice(&events), frames, bits).unwrap();
        assert_eq!(rep.shape, [frames, 2, 5, 7]);
        let value = |cell: usize| {
            let bit = |k: usize| expected[(cell / 70 * bits + k) * 70 + cell % 70];
            let number: f64 = (0..bits).map(|k| bit(k) * 2_f64.powi((bits - 1 - k) as i32)).sum();
            number / (2_f64.powi(bits as i32) - 1.0)
        };
        assert_close(&rep, &(0..frames * 70).map(value).collect::<Vec<_>>());
    }
}

#[test]
fn nothing_makes_zeros() {
    for none in [slice(&[]), slice(&[]).between(Some(3), Some(9)).unwrap()] {
        let grid = voxel_grid(&none, 5, Polarities::Split).unwrap();
        assert_eq!((grid.shape, grid.data), (vec![2, 5, 5, 7], vec![0.0; 350]));
        assert_eq!(event_frame(&none).unwrap().data, [0; 35]);
        assert_eq!(time_surfaces(&none, &[7], 1.0, Decay::Linear).unwrap().data, [0.0; 70]);
        assert_eq!(time_surfaces(&none, &[], 1.0, Decay::Linear).unwrap().shape, [0, 2, 5, 7]);
        assert_eq!(averaged_timestamps(&none, 2.0).unwrap().data, [2.0; 70]);
        assert_eq!(binary_stack(&none, 3).unwrap().data, [0; 210]);
        assert_eq!(event_spike_tensor(&none, 2, Measure::Time).unwrap().data, [0.0; 140]);
    }
}

/// The error of every representation of `events`, which is the same.
fn refusal(events: &[Event]) -> Error {
    let slice = slice(events);
    let errors = [
        voxel_grid(&slice, 5, Polarities::Signed).err(),
        event_frame(&slice).err(),
        counts(&slice).err(),
        event_spike_tensor(&slice, 5, Measure::Time).err(),
        time_surfaces(&slice, &[3], 1.0, Decay::Linear).err(),
        averaged_timestamps(&slice, 0.0).err(),
        binary_stack(&slice, 5).err(),
        bina_rep(&slice, 2, 4).err(),
    ];
    let first = errors[0].clone().unwrap();
    assert!(errors.iter().all(|error| error.as_ref() == Some(&first)), "{errors:?}");
    first
}

#[test]
fn events_that_cannot_be_used_are_named() {
    let good = events(12, 3000, 60);
    let bad = |index: usize, event: Event| {
        let mut events = good.clone();
        events[index] = event;
        refusal(&events)
    };
    let t = good[1500].t;
    assert_eq!(
        bad(1500, Event::new(t, 7, 2, Polarity::On)),
        Error::OutsideSensor { index: 1500, x: 7, y: 2, size: SIZE }
    );
    assert_eq!(
        bad(2999, Event::new(good[2999].t, 0, 5, Polarity::On)),
        Error::OutsideSensor { index: 2999, x: 0, y: 5, size: SIZE }
    );
    assert_eq!(
        bad(1024, Event::new(-21, 0, 0, Polarity::On)),
        Error::Unsorted { index: 1024, t_us: -21, before_us: good[1023].t }
    );
    // Later than all others: the event after it goes back.
    assert_eq!(
        bad(1024, Event::new(99, 0, 0, Polarity::On)),
        Error::Unsorted { index: 1025, t_us: good[1025].t, before_us: 99 }
    );
    for polarity in [2, -2, i16::MIN, i16::MAX] {
        let mut event = good[5];
        event.p = polarity;
        assert_eq!(bad(5, event), Error::Polarity { index: 5, polarity });
    }
    for t_us in [i64::MIN, -(1 << 52) - 1, (1 << 52) + 1, i64::MAX] {
        for index in [0, 1500, 2999] {
            assert_eq!(bad(index, Event::new(t_us, 0, 0, Polarity::On)), Error::Time { index, t_us });
        }
    }
    let text = bad(1500, Event::new(t, 7, 2, Polarity::On)).to_string();
    assert!(text.contains("event 1500 lies at x = 7, y = 2, outside of the sensor of 7x5 pixels"), "{text}");
}

#[test]
fn an_interval_keeps_the_index_of_events() {
    let mut events = events(13, 100, 60);
    let within = (events[40].t, events[60].t + 1);
    events[50].x = 9;
    let slice = slice(&events).between(Some(within.0), Some(within.1)).unwrap();
    let error = counts(&slice).unwrap_err();
    assert!(matches!(error, Error::OutsideSensor { index: 50, x: 9, .. }), "{error}");
    // Also where what is wrong lies outside of the interval.
    events.swap(0, 99);
    let error = Slice::new(&events, SIZE).unwrap().between(Some(5), Some(6)).unwrap_err();
    assert!(matches!(error, Error::Unsorted { index: 1, .. }), "{error}");
}

#[test]
fn minus_one_is_off() {
    let mut events = events(14, 100, 60);
    let grid = voxel_grid(&slice(&events), 5, Polarities::Split);
    for event in events.iter_mut().filter(|event| event.p == 0) {
        event.p = -1;
    }
    assert_eq!(voxel_grid(&slice(&events), 5, Polarities::Split), grid);
}

#[test]
fn settings_that_cannot_be_used_are_refused() {
    let events = events(15, 10, 60);
    let slice = slice(&events);
    let huge = Slice::new(&events, (65_536, 65_536)).unwrap();
    let refusals = [
        (Slice::new(&events, (0, 5)).map(drop), "width is 0; it must be between 1 and 65536 pixels"),
        (Slice::new(&events, (5, 65_537)).map(drop), "height is 65537"),
        (slice.between(Some(5), Some(5)).map(drop), "end_us is 5; it must be after start_us, which is 5"),
        (slice.between(Some(i64::MIN), None).map(drop), "start_us is -9223372036854775808"),
        (voxel_grid(&slice, 0, Polarities::Signed).map(drop), "bins is 0; it must be at least 1"),
        (voxel_grid(&slice, usize::MAX, Polarities::Signed).map(drop), "too large"),
        (voxel_grid(&huge, 5, Polarities::Signed).map(drop), "5 x 65536 x 65536 values is too large"),
        (event_spike_tensor(&slice, 1, Measure::Time).map(drop), "bins is 1; it must be at least 2"),
        (time_surfaces(&slice, &[1], 0.0, Decay::Linear).map(drop), "tau_us is 0; it must be a finite"),
        (time_surfaces(&slice, &[1], f64::NAN, Decay::Linear).map(drop), "tau_us is NaN"),
        (time_surfaces(&slice, &[2, 2], 1.0, Decay::Linear).map(drop), "at_us is 2; it must be after"),
        (time_surfaces(&slice, &[i64::MAX], 1.0, Decay::Linear).map(drop), "at_us is 9223372036854775807"),
        (binary_stack(&slice, 0).map(drop), "bins is 0"),
        (bina_rep(&slice, 0, 8).map(drop), "frames is 0"),
        (bina_rep(&slice, usize::MAX, 8).map(drop), "18446744073709551615"),
        (bina_rep(&slice, 1, 0).map(drop), "bits is 0; it must be between 1 and 24"),
        (bina_rep(&slice, 1, 25).map(drop), "bits is 25"),
    ];
    for (refusal, expected) in refusals {
        let text = refusal.unwrap_err().to_string();
        assert!(text.contains(expected), "{text}");
    }
}

#[test]
fn large_sensors_and_distant_times_work() {
    let far = 1 << 52;
    let events = [Event::new(-far, 1279, 719, Polarity::On), Event::new(far, 0, 719, Polarity::Off)];
    let slice = Slice::new(&events, (1280, 720)).unwrap();
    let grid = voxel_grid(&slice, 5, Polarities::Signed).unwrap();
    assert_eq!(grid.data[720 * 1280 - 1], 1.0);
    assert_eq!(grid.data[4 * 720 * 1280 + 719 * 1280], -1.0);
    assert_eq!(grid.data.iter().filter(|value| **value != 0.0).count(), 2);
    assert_eq!(binary_stack(&slice, 3).unwrap().data.iter().filter(|value| **value != 0).count(), 2);
    assert!(averaged_timestamps(&slice, 0.0).unwrap().data.contains(&1.0));
}
