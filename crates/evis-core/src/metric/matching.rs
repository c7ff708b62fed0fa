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

/// What the best matching does at a cell of the dynamic programme.
const LEAVE_TRUTH: u8 = 0;
const LEAVE_EVENT: u8 = 1;
const PAIR: u8 = 2;

/// Times of the truth events, and which times each may be matched with.
pub(super) trait Windows {
    /// Time of truth event `j`, and its tolerance.
    fn centre(&self, j: usize) -> Option<(i64, i64)>;
    /// First time in the window of `j` or of a later one.
    fn low(&self, j: usize) -> Option<i64>;
    /// Last time in the window of `j` or of an earlier one.
    fn high(&self, j: usize) -> Option<i64>;
}

/// One tolerance for all.
#[derive(Clone, Copy)]
pub(super) struct Plain<'a> {
    pub truth: &'a [i64],
    pub tolerance_us: i64,
}

/// A tolerance for each; buffers that are used again.
#[derive(Default)]
pub(super) struct Scaled {
    windows: Vec<Window>,
}

#[derive(Clone, Copy)]
struct Window {
    centre: (i64, i64),
    low: i64,
    high: i64,
}

impl Windows for Plain<'_> {
    fn centre(&self, j: usize) -> Option<(i64, i64)> {
        self.truth.get(j).map(|t| (*t, self.tolerance_us))
    }

    fn low(&self, j: usize) -> Option<i64> {
        self.truth.get(j).map(|t| t - self.tolerance_us)
    }

    fn high(&self, j: usize) -> Option<i64> {
        self.truth.get(j).map(|t| t + self.tolerance_us)
    }
}

impl Scaled {
    /// Takes times and tolerances. Windows are widened so that neither end ever goes back: the order of pairs then
    /// follows from the windows alone, and a pair inside a widened window is checked against its own tolerance.
    pub fn set(&mut self, centres: impl Iterator<Item = (i64, i64)>) {
        self.windows.clear();
        let mut furthest = i64::MIN;
        self.windows.extend(centres.map(|(t, tolerance)| {
            furthest = furthest.max(t + tolerance);
            Window { centre: (t, tolerance), low: t - tolerance, high: furthest }
        }));
        let mut earliest = i64::MAX;
        for window in self.windows.iter_mut().rev() {
            earliest = earliest.min(window.low);
            window.low = earliest;
        }
    }
}

impl Windows for Scaled {
    fn centre(&self, j: usize) -> Option<(i64, i64)> {
        self.windows.get(j).map(|w| w.centre)
    }

    fn low(&self, j: usize) -> Option<i64> {
        self.windows.get(j).map(|w| w.low)
    }

    fn high(&self, j: usize) -> Option<i64> {
        self.windows.get(j).map(|w| w.high)
    }
}

/// Error of a pair, stream minus truth, where it is within the tolerance.
fn error_us(events: &[i64], windows: &impl Windows, i: usize, j: usize) -> Option<i64> {
    let (t, tolerance) = windows.centre(j)?;
    let error = events.get(i)? - t;
    (error.abs() <= tolerance).then_some(error)
}

/// Pairs in the largest matching under one tolerance: there, that each truth event takes the first event that it can
/// is as good as any choice.
pub(super) fn count_pairs(events: &[i64], truth: Plain<'_>) -> u64 {
    let (mut i, mut j, mut pairs) = (0, 0, 0);
    while let (Some(event), Some(t)) = (events.get(i), truth.truth.get(j)) {
        let error = event - t;
        let (early, late) = (error < -truth.tolerance_us, error > truth.tolerance_us);
        i += usize::from(!late);
        j += usize::from(!early);
        pairs += u64::from(!early && !late);
    }
    pairs
}

/// Ends of the cluster that starts with event `i` and truth event `j`.
fn cluster_end(events: &[i64], windows: &impl Windows, mut i: usize, mut j: usize) -> (usize, usize) {
    loop {
        let start = (i, j);
        let high = windows.high(j).unwrap_or(i64::MIN);
        while events.get(i + 1).is_some_and(|e| *e <= high) {
            i += 1;
        }
        let last = events.get(i).copied().unwrap_or(i64::MIN);
        while windows.low(j + 1).is_some_and(|low| low <= last) {
            j += 1;
        }
        if (i, j) == start {
            return (i + 1, j + 1);
        }
    }
}

/// Buffers that are used again, and the number of clusters that were cut.
pub(super) struct Matcher {
    most_cells: usize,
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

impl Default for Matcher {
    fn default() -> Self {
        Self { most_cells: MOST_CELLS, row: Vec::new(), steps: Vec::new(), rows: Vec::new(), cut_clusters: 0 }
    }
}

impl Matcher {
    /// Matches the sorted times `events` with the truth events of `windows`. Calls `pair(event, truth, error)` for
    /// each pair.
    pub fn run(&mut self, events: &[i64], windows: &impl Windows, mut pair: impl FnMut(usize, usize, i64)) {
        let (mut i, mut j) = (0, 0);
        while let (Some(&event), Some(low), Some(high)) = (events.get(i), windows.low(j), windows.high(j)) {
            if event < low {
                i += 1;
            } else if high < event {
                j += 1;
            } else {
                let (events_end, truth_end) = cluster_end(events, windows, i, j);
                if (events_end, truth_end) == (i + 1, j + 1) {
                    if let Some(error) = error_us(events, windows, i, j) {
                        pair(i, j, error);
                    }
                } else {
                    self.solve(events, windows, i..events_end, j..truth_end, &mut pair);
                }
                (i, j) = (events_end, truth_end);
            }
        }
    }

    fn solve(
        &mut self,
        times: &[i64],
        windows: &impl Windows,
        events: Range<usize>,
        truth: Range<usize>,
        pair: &mut impl FnMut(usize, usize, i64),
    ) {
        if events.len() == truth.len() {
            let all =
                || events.clone().zip(truth.clone()).map(|(i, j)| (i, j, error_us(times, windows, i, j)));
            if all().all(|(_, _, error)| error.is_some()) {
                all().for_each(|(i, j, error)| pair(i, j, error.unwrap_or_default()));
                return;
            }
        }
        let (mut first_event, mut first_truth) = (events.start, truth.start);
        while first_truth < truth.end && first_event < events.end {
            let rows_end = self.lay_rows(times, windows, first_event..events.end, first_truth..truth.end);
            self.cut_clusters += u64::from(first_truth == truth.start && rows_end < truth.end);
            let last = self.rows.last().map_or(first_event, |row| row.to);
            self.fill(times, windows, first_event..last, first_truth);
            // The end of a cut piece only shows its start what will be asked for there.
            let rows = self.rows.len();
            let kept = if rows_end < truth.end { rows.div_ceil(2) } else { rows };
            let used = self.trace(times, windows, first_truth, kept, pair);
            first_event = used.map_or(first_event, |i| i + 1);
            first_truth += kept;
        }
    }

    /// Lays out as many truth events of a cluster as fit; returns where they end.
    fn lay_rows(
        &mut self,
        times: &[i64],
        windows: &impl Windows,
        events: Range<usize>,
        truth: Range<usize>,
    ) -> usize {
        self.rows.clear();
        let (mut from, mut to, mut steps) = (events.start, events.start, 0);
        for j in truth.clone() {
            let low = windows.low(j).unwrap_or(i64::MAX);
            let high = windows.high(j).unwrap_or(i64::MIN);
            while from < events.end && times.get(from).is_some_and(|t| *t < low) {
                from += 1;
            }
            to = to.max(from);
            while to < events.end && times.get(to).is_some_and(|t| *t <= high) {
                to += 1;
            }
            if !self.rows.is_empty()
                && (steps + (to - from) > self.most_cells || self.rows.len() >= MOST_ROWS)
            {
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
    fn fill(&mut self, times: &[i64], windows: &impl Windows, events: Range<usize>, first_truth: usize) {
        let Self { row: values, steps, rows, .. } = self;
        let worst = (first_truth..)
            .take(rows.len())
            .filter_map(|j| windows.centre(j))
            .map(|c| c.1)
            .max()
            .unwrap_or(0);
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
            let (Some((t, tolerance)), Some(inside)) = (windows.centre(j), times.get(row.from..row.to))
            else {
                continue;
            };
            let Some((first, window)) = window.split_first_mut() else { continue };
            let (mut diagonal, mut left) = (*first, *first);
            steps.extend(inside.iter().zip(window).map(|(event, value)| {
                let up = *value;
                let (mut best, mut step) = if left > up { (left, LEAVE_EVENT) } else { (up, LEAVE_TRUTH) };
                let distance = (event - t).abs();
                let paired = diagonal + reward - distance;
                if distance <= tolerance && paired > best {
                    (best, step) = (paired, PAIR);
                }
                *value = best;
                (diagonal, left) = (up, best);
                step
            }));
        }
    }

    /// Walks back through the steps and pairs the first `kept` rows; returns the last event that was paired.
    fn trace(
        &self,
        times: &[i64],
        windows: &impl Windows,
        first_truth: usize,
        kept: usize,
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
                        if j < kept {
                            last = last.or(Some(end));
                            let error = error_us(times, windows, end, first_truth + j).unwrap_or_default();
                            pair(end, first_truth + j, error);
                        }
                        break;
                    }
                    _ => break,
                }
            }
        }
        last
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::Random;
    use super::*;

    /// Pairs and sum of errors of the best matching of what is left, by trying everything.
    fn tried(events: &[i64], truth: &[(i64, i64)]) -> (usize, i64) {
        let (Some((event, events_left)), Some(((t, tolerance), truth_left))) =
            (events.split_first(), truth.split_first())
        else {
            return (0, 0);
        };
        let mut found = vec![tried(events_left, truth), tried(events, truth_left)];
        let error = (event - t).abs();
        if error <= *tolerance {
            let (pairs, errors) = tried(events_left, truth_left);
            found.push((pairs + 1, errors + error));
        }
        found.into_iter().max_by_key(|(pairs, errors)| (*pairs, -errors)).unwrap_or_default()
    }

    /// Pairs and sum of errors that `matcher` finds; the matching is checked to be one.
    fn found(matcher: &mut Matcher, events: &[i64], truth: &[(i64, i64)]) -> (usize, i64) {
        let times: Vec<i64> = truth.iter().map(|t| t.0).collect();
        let mut pairs = Vec::new();
        let mut pair = |i: usize, j: usize, error: i64| {
            assert_eq!(error, events[i] - times[j]);
            assert!(error.abs() <= truth[j].1);
            pairs.push((i, j));
        };
        let tolerance_us = truth.first().map_or(1, |t| t.1);
        if truth.iter().all(|t| t.1 == tolerance_us) {
            let windows = Plain { truth: &times, tolerance_us };
            matcher.run(events, &windows, pair);
            assert!(matcher.most_cells < MOST_CELLS || count_pairs(events, windows) == pairs.len() as u64);
        } else {
            let mut windows = Scaled::default();
            windows.set(truth.iter().copied());
            matcher.run(events, &windows, &mut pair);
        }
        pairs.sort_unstable();
        assert!(pairs.array_windows().all(|[a, b]| a.0 < b.0 && a.1 < b.1), "one to one, in order");
        (pairs.len(), pairs.iter().map(|(i, j)| (events[*i] - times[*j]).abs()).sum())
    }

    fn random_case(random: &mut Random, scaled: bool) -> (Vec<i64>, Vec<(i64, i64)>) {
        let span = 10 + random.below(120);
        let tolerance = 1 + random.below(15) as i64;
        let mut sorted = |count: u64| {
            let mut times: Vec<i64> = (0..count).map(|_| random.below(span) as i64).collect();
            times.sort_unstable();
            times
        };
        let (events, truth) = (sorted(7), sorted(7));
        let scale = |random: &mut Random| if scaled { 1 + random.below(6) as i64 } else { 1 };
        let (n, m) = (random.below(8) as usize, random.below(8) as usize);
        (events[..n].to_vec(), truth[..m].iter().map(|t| (*t, tolerance * scale(random))).collect())
    }

    #[test]
    fn matching_equals_trying_everything() {
        let mut random = Random(3);
        let mut matcher = Matcher::default();
        let mut greedy_fails = 0;
        for case in 0..4000 {
            let (events, truth) = random_case(&mut random, case % 2 == 1);
            let best = tried(&events, &truth);
            assert_eq!(found(&mut matcher, &events, &truth), best, "{events:?} {truth:?}");
            greedy_fails += usize::from(greedy(&events, &truth) != best);
        }
        assert!(greedy_fails > 400, "canary: cases that need no thought: {greedy_fails} of 4000 did");
        assert_eq!(matcher.cut_clusters, 0);
    }

    /// Each truth event takes the first event that it can.
    fn greedy(events: &[i64], truth: &[(i64, i64)]) -> (usize, i64) {
        let (mut next, mut pairs, mut errors) = (0, 0, 0);
        for (t, tolerance) in truth {
            if let Some(i) = (next..events.len()).find(|i| (events[*i] - t).abs() <= *tolerance) {
                (next, pairs, errors) = (i + 1, pairs + 1, errors + (events[i] - t).abs());
            }
        }
        (pairs, errors)
    }

    #[test]
    fn clusters_that_are_cut_lose_next_to_nothing() {
        let mut random = Random(4);
        let mut matcher = Matcher { most_cells: 12, ..Matcher::default() };
        let (mut pairs, mut best) = (0, 0);
        for case in 0..2000 {
            let (events, truth) = random_case(&mut random, case % 2 == 1);
            pairs += found(&mut matcher, &events, &truth).0;
            best += tried(&events, &truth).0;
        }
        assert!(pairs <= best && pairs * 100 > best * 98, "{pairs} of {best}");
        assert!(matcher.cut_clusters > 100, "canary: {} were cut", matcher.cut_clusters);
    }
}
