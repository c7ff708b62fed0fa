#import trigger/tile_rate.wgsl
// Log light between two samples of a block: straight, or along a cubic that also goes by the samples before and after
// them. Twin: cpu/trigger.rs, curve.

// Whether it is a cubic.
override CURVE: bool = false;
// Straight pieces that stand for it.
const PIECES: u32 = 4u;

// How log light runs from one sample to the next: its slopes there, per interval.
struct Run {
    start: f32,
    change: f32,
    slope_start: f32,
    slope_end: f32,
};

// The mean of the changes before and after a sample, at most three times the lesser of them: what rises at three samples
// in a row rises between them, and next to a pixel that rests nothing swings.
fn slope_within(before: f32, after: f32) -> f32 {
    let most = 3.0 * min(abs(before), abs(after));
    return clamp(0.5 * (before + after), -most, most);
}

// At the end of a row of samples: of the parabola whose slope at the other end of the interval is `other`.
fn slope_at_end(change: f32, other: f32) -> f32 {
    return clamp(2.0 * change - other, min(0.0, 3.0 * change), max(0.0, 3.0 * change));
}

// From `l0` to `l1`; `before` the one and `after` the other, where the block has such samples.
fn run_of(before: f32, l0: f32, l1: f32, after: f32, has_before: bool, has_after: bool) -> Run {
    let change = l1 - l0;
    var slope_start = change;
    var slope_end = change;
    if (has_before) {
        slope_start = slope_within(l0 - before, change);
    }
    if (has_after) {
        slope_end = slope_within(change, after - l1);
    }
    if (!has_before && has_after) {
        slope_start = slope_at_end(change, slope_end);
    }
    if (has_before && !has_after) {
        slope_end = slope_at_end(change, slope_start);
    }
    return Run(l0, change, slope_start, slope_end);
}

// Where the `piece`th of a run's pieces ends.
fn end_of(run: Run, piece: u32, l1: f32) -> f32 {
    if (piece + 1u == PIECES) {
        return l1;
    }
    let u = f32(piece + 1u) / f32(PIECES);
    let square = 3.0 * run.change - 2.0 * run.slope_start - run.slope_end;
    let cube = run.slope_start + run.slope_end - 2.0 * run.change;
    return run.start + u * (run.slope_start + u * (square + u * cube));
}

// Microseconds from the begin of an interval to that of its `piece`th piece.
fn begin_of(interval: u32, piece: u32) -> u32 {
    return interval / PIECES * piece + interval % PIECES * piece / PIECES;
}
