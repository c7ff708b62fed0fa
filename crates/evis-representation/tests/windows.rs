//! Windows are half-open, tile what they are asked for, and copy nothing.

use evis_core::{Event, Polarity};
use evis_representation::{Error, Window, windows};

fn events(times: &[i64]) -> Vec<Event> {
    times.iter().map(|t| Event::new(*t, 0, 0, Polarity::On)).collect()
}

fn shown<'a>(windows: impl Iterator<Item = Window<'a>>) -> Vec<(i64, i64, Vec<i64>)> {
    windows
        .map(|window| (window.start_us, window.end_us, window.events.iter().map(|e| e.t).collect()))
        .collect()
}

#[test]
fn by_time_they_tile_an_interval() {
    let events = events(&[5, 6, 10, 35]);
    let expected = [(0, 10, vec![5, 6]), (10, 20, vec![10]), (20, 30, vec![]), (30, 36, vec![35])];
    assert_eq!(shown(windows::by_time(&events, 10, 0, 36).unwrap()), expected);
    assert_eq!(shown(windows::by_time(&events, 10, 6, 6).unwrap()), []);
    assert_eq!(shown(windows::by_time(&[], 10, 0, 15).unwrap()), [(0, 10, vec![]), (10, 15, vec![])]);
    let first = windows::by_time(&events, 10, 0, 36).unwrap().next().unwrap();
    assert!(std::ptr::eq(first.events.as_ptr(), events.as_ptr()), "they are not copied");
}

#[test]
fn by_count_ties_may_be_parted() {
    let events = events(&[1, 2, 2, 2, 9]);
    let expected = [(1, 3, vec![1, 2]), (2, 3, vec![2, 2]), (9, 10, vec![9])];
    assert_eq!(shown(windows::by_count(&events, 2).unwrap()), expected);
    assert_eq!(shown(windows::by_count(&[], 2).unwrap()), []);
}

#[test]
fn edges_belong_to_the_window_that_they_open() {
    let events = events(&[1, 2, 2, 7, 9]);
    let expected = [(2, 7, vec![2, 2]), (7, 8, vec![7]), (8, 9, vec![])];
    assert_eq!(shown(windows::between(&events, &[2, 7, 8, 9]).unwrap()), expected);
    assert_eq!(shown(windows::between(&events, &[2]).unwrap()), []);
}

#[test]
fn what_cannot_be_is_refused() {
    let sorted = events(&[1, 2]);
    let unsorted = events(&[1, 3, 2]);
    let expected = Error::Unsorted { index: 2, t_us: 2, before_us: 3 };
    assert_eq!(windows::by_time(&unsorted, 1, 0, 9).err(), Some(expected.clone()));
    assert_eq!(windows::by_count(&unsorted, 1).err(), Some(expected.clone()));
    assert_eq!(windows::between(&unsorted, &[0, 9]).err(), Some(expected));
    let refusals = [
        (windows::by_time(&sorted, 0, 0, 9).err(), "length_us is 0"),
        (windows::by_time(&sorted, 1, i64::MIN, 9).err(), "start_us is -9223372036854775808"),
        (windows::by_count(&sorted, 0).err(), "count is 0"),
        (windows::between(&sorted, &[3, 3]).err(), "edges_us is 3; it must be after the edge before it, 3"),
        (windows::by_count(&events(&[i64::MAX]), 1).err(), "event 0 is at 9223372036854775807 us"),
    ];
    for (refusal, expected) in refusals {
        let text = refusal.unwrap().to_string();
        assert!(text.contains(expected), "{text}");
    }
}
