//! One-to-one matching in order: most pairs, and among those the least sum of time errors.
//!
//! Windows of truth events around their times say which events of the stream they may take. Where windows overlap,
//! clusters form that are independent of each other. Most clusters are trivial (one event on either side, or as many
//! on both sides as pair up in order: an in-order matching of all of them can be no other). The rest is solved by
//! dynamic programming over the pairs within the windows.

use std::ops::Range;

/// Steps of the dynamic programme that are kept at a time; larger clusters are cut.
const MOST_CELLS: usize = 1 << 22;
/// Truth events in one piece: keeps the value of a matching, at most this, squared, times the largest error, in 63 bits.
const MOST_ROWS: usize = 1 << 18;

/// What the best matching does at a cell.
const LEAVE_TRUTH: u8 = 0;
const LEAVE_EVENT: u8 = 1;
const PAIR: u8 = 2;

/// Buffers that are used again, and the number of clusters that were cut.
#[derive(Default)]
pub(super) struct Matcher {
    low: Vec<i64>,
    high: Vec<i64>,
    row: Vec<i64>,
    steps: Vec<u8>,
    rows: Vec<Row>,
    pub cut_clusters: u64,
}

/// A truth event in the dynamic programme: the events `from..to` lie in its window, its steps start at `steps`.
#[derive(Clone, Copy)]
struct Row {
    from: usize,
    to: usize,
    steps: usize,
}

/// Event times, truth times and the tolerance of each truth event.
struct Sides<'a, F> {
    events: &'a [i64],
    truth: &'a [i64],
    tolerance: F,
}

impl<F: Fn(usize) -> i64> Sides<'_, F> {
    /// Error of a pair, stream minus truth, where it is within the tolerance.
    fn error(&self, event: usize, truth: usize) -> Option<i64> {
        let error = self.events.get(event)? - self.truth.get(truth)?;
        (error.abs() <= (self.tolerance)(truth)).then_some(error)
    }
}

impl Matcher {
    /// Matches the sorted times `events` and `truth`; `tolerance` gives that of a truth event by index. Calls
    /// `pair(event, truth, error)` for each pair.
    pub fn run(
        &mut self,
        events: &[i64],
        truth: &[i64],
        tolerance: impl Fn(usize) -> i64,
        mut pair: impl FnMut(usize, usize, i64),
    ) {
        if events.is_empty() || truth.is_empty() {
            return;
        }
        self.set_windows(truth, &tolerance);
        let sides = Sides { events, truth, tolerance };
        let (mut i, mut j) = (0, 0);
        while let (Some(&event), Some(&low), Some(&high)) = (events.get(i), self.low.get(j), self.high.get(j))
        {
            if event < low {
                i += 1;
            } else if high < event {
                j += 1;
            } else {
                let (events_end, truth_end) = self.cluster_end(events, i, j);
                self.solve(&sides, i..events_end, j..truth_end, &mut pair);
                (i, j) = (events_end, truth_end);
            }
        }
    }

    /// Windows of the truth events, widened so that neither end ever goes back: the order of pairs then follows from
    /// the windows alone, and a pair inside a widened window is checked against its own tolerance.
    fn set_windows(&mut self, truth: &[i64], tolerance: &impl Fn(usize) -> i64) {
        self.low.clear();
        self.high.clear();
        let mut furthest = i64::MIN;
        for (j, t) in truth.iter().enumerate() {
            let width = tolerance(j);
            furthest = furthest.max(t + width);
            self.low.push(t - width);
            self.high.push(furthest);
        }
        let mut earliest = i64::MAX;
        for low in self.low.iter_mut().rev() {
            earliest = earliest.min(*low);
            *low = earliest;
        }
    }

    /// Ends of the cluster that starts with event `i` and truth event `j`.
    fn cluster_end(&self, events: &[i64], mut i: usize, mut j: usize) -> (usize, usize) {
        loop {
            let start = (i, j);
            let high = self.high.get(j).copied().unwrap_or(i64::MIN);
            while events.get(i + 1).is_some_and(|e| *e <= high) {
                i += 1;
            }
            let last = events.get(i).copied().unwrap_or(i64::MIN);
            while self.low.get(j + 1).is_some_and(|low| *low <= last) {
                j += 1;
            }
            if (i, j) == start {
                return (i + 1, j + 1);
            }
        }
    }

    fn solve<F: Fn(usize) -> i64>(
        &mut self,
        sides: &Sides<'_, F>,
        events: Range<usize>,
        truth: Range<usize>,
        pair: &mut impl FnMut(usize, usize, i64),
    ) {
        if events.len() == truth.len() {
            let all = || events.clone().zip(truth.clone()).map(|(i, j)| (i, j, sides.error(i, j)));
            if all().all(|(_, _, error)| error.is_some()) {
                all().for_each(|(i, j, error)| pair(i, j, error.unwrap_or_default()));
                return;
            }
        }
        let (mut first_event, mut first_truth) = (events.start, truth.start);
        while first_truth < truth.end && first_event < events.end {
            let rows_end = self.lay_rows(sides.events, first_event..events.end, first_truth..truth.end);
            self.cut_clusters += u64::from(first_truth == truth.start && rows_end < truth.end);
            let last = self.rows.last().map_or(first_event, |row| row.to);
            self.fill(sides, first_event..last, first_truth);
            let used = self.trace(sides, first_truth, pair);
            first_event = used.map_or(first_event, |i| i + 1);
            first_truth = rows_end;
        }
    }

    /// Lays out as many truth events of a cluster as fit; tells where they end.
    fn lay_rows(&mut self, times: &[i64], events: Range<usize>, truth: Range<usize>) -> usize {
        self.rows.clear();
        let (mut from, mut to, mut steps) = (events.start, events.start, 0);
        for j in truth.clone() {
            let low = self.low.get(j).copied().unwrap_or(i64::MAX);
            let high = self.high.get(j).copied().unwrap_or(i64::MIN);
            while from < events.end && times.get(from).is_some_and(|t| *t < low) {
                from += 1;
            }
            to = to.max(from);
            while to < events.end && times.get(to).is_some_and(|t| *t <= high) {
                to += 1;
            }
            if !self.rows.is_empty() && (steps + (to - from) > MOST_CELLS || self.rows.len() >= MOST_ROWS) {
                return j;
            }
            self.rows.push(Row { from, to, steps });
            steps += to - from;
        }
        truth.end
    }

    /// Fills in what the best matching of the laid rows does at each of their cells.
    ///
    /// `row[c - first]` is the value of the best matching of the events before c with the truth events so far. A row
    /// changes it only within its window; after the window it stays what it is at the window's end.
    fn fill<F: Fn(usize) -> i64>(&mut self, sides: &Sides<'_, F>, events: Range<usize>, first_truth: usize) {
        let Self { row: values, steps, rows, .. } = self;
        let worst = (first_truth..first_truth + rows.len()).map(&sides.tolerance).max().unwrap_or(0);
        // One more pair outweighs all time errors together.
        let reward = (rows.len().min(events.len()) as i64 + 1) * worst + 1;
        values.clear();
        values.resize(events.len() + 1, 0);
        steps.clear();
        let mut reached = events.start;
        for (j, row) in (first_truth..).zip(rows.iter()) {
            let at = |c: usize| c - events.start;
            let end = values.get(at(reached)).copied().unwrap_or(0);
            if let Some(fresh) = values.get_mut(at(reached)..=at(row.to.max(reached))) {
                fresh.fill(end);
            }
            reached = row.to.max(reached);
            let Some(window) = values.get_mut(at(row.from)..=at(row.to)) else { continue };
            let mut diagonal = window.first().copied().unwrap_or(0);
            let mut left = diagonal;
            for (i, value) in (row.from..row.to).zip(window.iter_mut().skip(1)) {
                let up = *value;
                let (mut best, mut step) = if left > up { (left, LEAVE_EVENT) } else { (up, LEAVE_TRUTH) };
                if let Some(error) = sides.error(i, j) {
                    let paired = diagonal + reward - error.abs();
                    if paired > best {
                        (best, step) = (paired, PAIR);
                    }
                }
                steps.push(step);
                *value = best;
                diagonal = up;
                left = best;
            }
        }
    }

    /// Walks back through the steps; tells the last event that was paired.
    fn trace<F: Fn(usize) -> i64>(
        &self,
        sides: &Sides<'_, F>,
        first_truth: usize,
        pair: &mut impl FnMut(usize, usize, i64),
    ) -> Option<usize> {
        let mut last = None;
        let mut end = usize::MAX;
        for (j, row) in self.rows.iter().enumerate().rev() {
            end = end.min(row.to);
            while end > row.from {
                match self.steps.get(row.steps + (end - 1 - row.from)) {
                    Some(&LEAVE_EVENT) => end -= 1,
                    Some(&PAIR) => {
                        end -= 1;
                        last = last.or(Some(end));
                        let error = sides.error(end, first_truth + j).unwrap_or_default();
                        pair(end, first_truth + j, error);
                        break;
                    }
                    _ => break,
                }
            }
        }
        last
    }
}
