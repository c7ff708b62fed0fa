//! Consecutive windows of events, half-open, without a copy.

use evis_core::Event;
use evis_core::event::{MOST_T_US, slice_time};

use crate::error::Error;

/// Events in `[start_us, end_us)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window<'a> {
    /// First microsecond.
    pub start_us: i64,
    /// One past the last microsecond.
    pub end_us: i64,
    /// What happened between.
    pub events: &'a [Event],
}

/// Windows of `length_us` microseconds from `start_us` to `end_us`, empty ones too; the last one may be shorter.
///
/// # Errors
/// A length or a limit that cannot be used, events that are not sorted by time.
pub fn by_time(
    events: &[Event],
    length_us: i64,
    start_us: i64,
    end_us: i64,
) -> Result<impl Iterator<Item = Window<'_>>, Error> {
    check_order(events)?;
    if !(1..=2 * MOST_T_US).contains(&length_us) {
        return Err(Error::setting("length_us", length_us, "at least 1 microsecond"));
    }
    for (what, limit) in [("start_us", start_us), ("end_us", end_us)] {
        check_time(what, limit)?;
    }
    let mut next_us = start_us;
    Ok(std::iter::from_fn(move || {
        let start_us = next_us;
        if start_us >= end_us {
            return None;
        }
        next_us = (start_us + length_us).min(end_us);
        Some(Window { start_us, end_us: next_us, events: slice_time(events, start_us, next_us) })
    }))
}

/// Windows of `count` events; the last one may have fewer. Each lasts from its first event to just after its last one.
///
/// # Errors
/// A count of 0, events that are not sorted by time.
pub fn by_count(events: &[Event], count: usize) -> Result<impl Iterator<Item = Window<'_>>, Error> {
    check_order(events)?;
    if count == 0 {
        return Err(Error::setting("count", count, "at least 1 event"));
    }
    Ok(events.chunks(count).map(|events| Window {
        start_us: events.first().map_or(0, |event| event.t),
        end_us: events.last().map_or(0, |event| event.t + 1),
        events,
    }))
}

/// The windows between neighbours of `edges_us`: one fewer than there are edges, empty ones too.
///
/// # Errors
/// Edges that do not ascend, events that are not sorted by time.
pub fn between<'a>(
    events: &'a [Event],
    edges_us: &'a [i64],
) -> Result<impl Iterator<Item = Window<'a>>, Error> {
    check_order(events)?;
    for (index, edge) in edges_us.iter().enumerate() {
        check_time("edges_us", *edge)?;
        if index > 0 && *edge <= edges_us[index - 1] {
            let remedy = format!("after the edge before it, {}", edges_us[index - 1]);
            return Err(Error::setting("edges_us", edge, remedy));
        }
    }
    Ok(edges_us.windows(2).map(|pair| Window {
        start_us: pair[0],
        end_us: pair[1],
        events: slice_time(events, pair[0], pair[1]),
    }))
}

fn check_time(what: &'static str, t_us: i64) -> Result<(), Error> {
    if t_us.unsigned_abs() > MOST_T_US.unsigned_abs() {
        return Err(Error::setting(what, t_us, format!("within {MOST_T_US} us of 0")));
    }
    Ok(())
}

fn check_order(events: &[Event]) -> Result<(), Error> {
    for (index, event) in events.iter().enumerate() {
        if event.t.unsigned_abs() > MOST_T_US.unsigned_abs() {
            return Err(Error::Time { index, t_us: event.t });
        }
        if index > 0 && event.t < events[index - 1].t {
            return Err(Error::Unsorted { index, t_us: event.t, before_us: events[index - 1].t });
        }
    }
    Ok(())
}
