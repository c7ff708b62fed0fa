//! From the pixel to the host: what waits for the bus, and when it leaves.

use std::collections::VecDeque;

use crate::event::Event;
use crate::random::{Key, StreamId, normals};
use crate::sensor::Readout;

/// Events that wait for a bus at most: what comes while so many wait is dropped, as a pixel whose request is not answered fires
/// no second time. A bus that is never free again would otherwise fill the memory.
pub(crate) const MOST_WAITING: usize = 1 << 18;

/// Events on their way, of one environment.
#[derive(Clone, Debug, Default)]
pub(crate) struct Queue {
    /// Events that have not left, in canonical order.
    pub waiting: Vec<Event>,
    /// When the bus is free, nanoseconds.
    pub free_ns: i64,
    /// The millisecond that is counted, and how many events left in it.
    pub window: i64,
    pub used: u64,
}

/// Delay of an event that left its pixel at `t_us`, whole microseconds.
pub(crate) fn delay_us(readout: &Readout, key: Key, pixel: u32, t_us: i64) -> u32 {
    let mut delay = f64::from(readout.latency_us);
    if readout.jitter_us > 0.0 {
        let [a, b, ..] = key.draw(pixel, StreamId::Latency, t_us >> 16, t_us as u32 & 0xffff);
        delay += f64::from(readout.jitter_us) * normals(a, b).0;
    }
    delay.clamp(0.0, 1e8) as u32
}

impl Queue {
    /// Takes what fired until `end_us`; what leaves until then goes to `out`. Gives how many were dropped.
    pub fn pass(
        &mut self,
        readout: &Readout,
        fired: &mut Vec<Event>,
        end_us: i64,
        out: &mut Vec<Event>,
    ) -> u64 {
        self.waiting.append(fired);
        self.waiting.sort_by_key(Event::order);
        let tick = i64::from(readout.tick_us.max(1));
        // The last tick that has come.
        let end_us = end_us.div_euclid(tick) * tick;
        let base = out.len();
        let mut dropped = 0;
        if readout.row_ns > 0 || readout.event_ns > 0 {
            dropped = self.arbitrate(readout, end_us, MOST_WAITING, out);
        } else {
            let left = self.waiting.partition_point(|event| event.t <= end_us);
            out.extend(self.waiting.drain(..left));
        }
        for event in &mut out[base..] {
            event.t = (event.t + tick - 1).div_euclid(tick) * tick;
        }
        out[base..].sort_by_key(Event::order);
        dropped + self.limit(readout, base, out)
    }

    /// Rows one after the other, the one that has waited longest first; a row's events carry the time of its turn. Of those
    /// that come while `most` wait, none is kept; gives how many these are.
    fn arbitrate(&mut self, readout: &Readout, end_us: i64, most: usize, out: &mut Vec<Event>) -> u64 {
        let rows = self.waiting.iter().map(|event| usize::from(event.y) + 1).max().unwrap_or(0);
        let mut queues: Vec<VecDeque<usize>> = vec![VecDeque::new(); rows];
        // Sent or dropped.
        let mut left = vec![false; self.waiting.len()];
        let (mut asked, mut waiting, mut dropped) = (0, 0_usize, 0);
        // Requests until a time join the queues, as long as there is room: whether there is follows from the turns before it,
        // and not from when this is called.
        let mut ask = |until_ns: i64,
                       waiting: &mut usize,
                       queues: &mut [VecDeque<usize>],
                       left: &mut [bool]| {
            while let Some(event) = self.waiting.get(asked).filter(|e| e.t.saturating_mul(1000) <= until_ns) {
                if *waiting < most {
                    queues[usize::from(event.y)].push_back(asked);
                    *waiting += 1;
                } else {
                    left[asked] = true;
                    dropped += 1;
                }
                asked += 1;
            }
        };
        for i in 0..self.waiting.len() {
            if left[i] {
                continue;
            }
            let oldest = self.waiting[i];
            let turn_ns = self.free_ns.max(oldest.t.saturating_mul(1000));
            let turn_us = turn_ns.div_euclid(1000) + i64::from(turn_ns.rem_euclid(1000) > 0);
            if turn_us > end_us {
                break;
            }
            ask(turn_ns, &mut waiting, &mut queues, &mut left);
            let queue = &mut queues[usize::from(oldest.y)];
            let mut count = 0;
            while let Some(next) = queue.front().copied() {
                let event = self.waiting[next];
                if event.t.saturating_mul(1000) > turn_ns {
                    break;
                }
                queue.pop_front();
                waiting -= 1;
                left[next] = true;
                let mut sent = event;
                sent.t = turn_us;
                out.push(sent);
                count += 1;
            }
            self.free_ns = turn_ns + i64::from(readout.row_ns) + count * i64::from(readout.event_ns);
        }
        // Those that the next turn finds before it begins.
        ask(end_us.saturating_mul(1000), &mut waiting, &mut queues, &mut left);
        let mut stays = left.into_iter();
        self.waiting.retain(|_| !stays.next().unwrap_or(false));
        dropped
    }

    fn limit(&mut self, readout: &Readout, base: usize, out: &mut Vec<Event>) -> u64 {
        if readout.rate_limit_hz == 0.0 {
            return 0;
        }
        let most = (readout.rate_limit_hz * 1e-3).max(1.0) as u64;
        let before = out.len();
        let mut kept = base;
        for i in base..before {
            let event = out[i];
            let window = event.t.div_euclid(1000);
            if window != self.window {
                (self.window, self.used) = (window, 0);
            }
            if self.used < most {
                self.used += 1;
                out[kept] = event;
                kept += 1;
            }
        }
        out.truncate(kept);
        (before - kept) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::event::Polarity;

    fn at(t: i64, x: u16, y: u16) -> Event {
        Event::new(t, x, y, Polarity::On)
    }

    #[test]
    fn rows_take_turns() {
        let readout = Readout { row_ns: 2000, event_ns: 500, ..Readout::default() };
        let mut queue = Queue::default();
        let mut out = Vec::new();
        // Row 1 waits for row 0: 2 us + 2 events of 0.5 us; the late event of row 0 for its next turn.
        let mut fired = vec![at(10, 0, 0), at(10, 1, 0), at(11, 5, 1), at(11, 7, 0)];
        assert_eq!(queue.pass(&readout, &mut fired, 100, &mut out), 0);
        assert_eq!(out, [at(10, 0, 0), at(10, 1, 0), at(13, 7, 0), at(16, 5, 1)]);
        assert!(queue.waiting.is_empty());
    }

    #[test]
    fn what_finds_a_full_bus_is_dropped_whatever_the_chunks() {
        // A row takes 10 us, and a pixel of each of 50 rows fires every 2 us.
        let readout = Readout { row_ns: 10_000, ..Readout::default() };
        let events: Vec<Event> = (0..5000).map(|i| at(i64::from(i) * 2, 0, (i * 7 % 50) as u16)).collect();
        let run = |cuts: &[i64]| {
            let (mut queue, mut out, mut start, mut dropped) = (Queue::default(), Vec::new(), -1, 0);
            for end in cuts {
                queue.waiting.extend(events.iter().filter(|event| event.t > start && event.t <= *end));
                dropped += queue.arbitrate(&readout, *end, 40, &mut out);
                assert!(queue.waiting.len() <= 40, "{} wait", queue.waiting.len());
                start = *end;
            }
            (out, dropped)
        };
        let (out, dropped) = run(&[20_000]);
        assert!(
            dropped > 1000 && out.len() as u64 + dropped == 5000,
            "{} left, {dropped} dropped",
            out.len()
        );
        assert_eq!(run(&[1000, 1004, 2222, 9000, 20_000]), (out.clone(), dropped));
        assert_eq!(run(&(0..=20_000).collect::<Vec<_>>()), (out, dropped));
    }

    #[test]
    fn chunks_do_not_matter() {
        let readout = Readout {
            row_ns: 3100,
            event_ns: 700,
            tick_us: 4,
            rate_limit_hz: 20_000.0,
            ..Readout::default()
        };
        let events: Vec<Event> = (0..300)
            .map(|i| at(i64::from(i * i * 7 % 4000) + 1, (i % 20) as u16, (i * 13 % 16) as u16))
            .collect();
        let run = |cuts: &[i64]| {
            let (mut queue, mut out, mut start, mut dropped) = (Queue::default(), Vec::new(), 0, 0);
            for end in cuts {
                let mut fired: Vec<Event> =
                    events.iter().copied().filter(|event| event.t > start && event.t <= *end).collect();
                let from = out.len();
                dropped += queue.pass(&readout, &mut fired, *end, &mut out);
                assert!(
                    out[from..].iter().all(|event| event.t > start && event.t <= *end && event.t % 4 == 0)
                );
                start = *end;
            }
            (out, dropped)
        };
        let whole = run(&[9000]);
        assert!(whole.1 > 0 && !whole.0.is_empty());
        assert_eq!(run(&[1000, 1004, 2222, 9000]), whole);
        assert_eq!(run(&(1..=9000).collect::<Vec<_>>()), whole);
    }
}
