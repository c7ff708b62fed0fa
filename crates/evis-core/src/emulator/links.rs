//! What links two keyframes: how far the picture moved, whether it is the same world, and where the older one's surfaces
//! went.

use super::keyframe::Keyframe;
use super::warp::{SAME_SURFACE, is_motion};

/// Depths at least this part of one another may be of one surface at two times: it may have come nearer.
const SAME_OVER_TIME: f32 = 0.7;
/// Below this part of surfaces that are found again, nothing links two keyframes.
const LEAST_LINKED: f32 = 0.2;
/// Share of pixels that may move farther than [`Links::motion_px`] says.
const FASTEST_SHARE: f64 = 1e-3;
/// A path that bends by more than this part of its length is taken for straight: a turn by half a radian bends by a quarter, and
/// what stops or is another surface by half and more.
const SHARPEST: f32 = 0.4;
/// Pixels at which other conventions of motion vectors are tried, about.
const TRIED: usize = 4096;
/// Rounds of giving unknown pixels the motion of their neighbours.
const ROUNDS: usize = 16;

/// How the newer of two keyframes hangs together with the older.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Links {
    pub motion_px: f32,
    /// Part of all pixels that were found again.
    pub linked: f32,
    pub hint: Option<&'static str>,
}

/// Pixel that is nearest to a place, if it is in the picture.
#[inline(always)]
fn pixel_at(x: f32, y: f32, [width, height]: [usize; 2]) -> Option<usize> {
    let (x, y) = ((x + 0.5).floor(), (y + 0.5).floor());
    let inside = x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32;
    inside.then(|| y as usize * width + x as usize)
}

fn may_be_one(a: f32, b: f32, part: f32) -> bool {
    a.min(b) >= a.max(b) * part
}

impl Links {
    /// Compares the pictures; `log_floor` is added to light before its logarithm.
    pub fn find(before: &Keyframe, now: &Keyframe, canvas: [usize; 2], log_floor: f32) -> Self {
        let mut moved = Vec::with_capacity(now.back.len());
        let mut linked = 0_usize;
        for (at, motion) in now.back.iter().enumerate().filter(|(_, motion)| is_motion(**motion)) {
            moved.push(motion[0].hypot(motion[1]));
            let (x, y) = ((at % canvas[0]) as f32, (at / canvas[0]) as f32);
            let there = pixel_at(x + motion[0], y + motion[1], canvas);
            let found = |there: usize| may_be_one(before.nearness[there], now.nearness[at], SAME_OVER_TIME);
            linked += usize::from(there.is_some_and(found));
        }
        let rank = (moved.len() as f64 * (1.0 - FASTEST_SHARE)) as usize;
        let rank = rank.min(moved.len().saturating_sub(1));
        let motion_px = match moved.get(rank) {
            None => 0.0,
            Some(_) => *moved.select_nth_unstable_by(rank, f32::total_cmp).1,
        };
        let linked = linked as f32 / now.back.len().max(1) as f32;
        Self { motion_px, linked, hint: hint(before, now, canvas, log_floor) }
    }

    /// Whether nothing links the keyframes.
    pub fn is_cut(&self) -> bool {
        self.linked < LEAST_LINKED
    }
}

/// Tries other conventions of motion vectors: names the one that explains the light far better, if there is one.
fn hint(before: &Keyframe, now: &Keyframe, canvas: [usize; 2], log_floor: f32) -> Option<&'static str> {
    let (width, height) = (canvas[0] as f32, canvas[1] as f32);
    let tries: [(f32, f32, &str); 8] = [
        (-1.0, -1.0, "with both signs changed (they point from the last keyframe to this one)"),
        (1.0, -1.0, "with y's sign changed (theirs runs up)"),
        (-1.0, 1.0, "with x's sign changed"),
        (width, height, "times width and height (they are parts of the picture)"),
        (
            -width,
            -height,
            "times -width and -height (they are parts of the picture, from the last keyframe to this one)",
        ),
        (0.5 * width, -0.5 * height, "times width / 2 and -height / 2 (they are in clip space)"),
        (
            -0.5 * width,
            0.5 * height,
            "times -width / 2 and height / 2 (they are in clip space, from the last keyframe to this one)",
        ),
        (0.0, 0.0, "if there were none (the light stands still)"),
    ];
    // Sums of the given vectors' error and of the other's, over the pixels where the two differ.
    let mut errors = [(0.0_f64, 0.0_f64, 0_u32); 8];
    let stride = (now.back.len() / TRIED).max(1);
    for at in (stride / 2..now.back.len()).step_by(stride) {
        let motion = now.back[at];
        if !is_motion(motion) || now.light[at].is_nan() {
            continue;
        }
        let (x, y) = ((at % canvas[0]) as f32, (at / canvas[0]) as f32);
        let error = |scale: (f32, f32)| {
            let light = before.light[pixel_at(x + motion[0] * scale.0, y + motion[1] * scale.1, canvas)?];
            let ratio = (light + log_floor) / (now.light[at] + log_floor);
            (light >= 0.0 && ratio > 0.0).then(|| f64::from(ratio.ln().abs().min(2.0)))
        };
        let Some(given) = error((1.0, 1.0)) else { continue };
        for ((sx, sy, _), sum) in tries.iter().zip(&mut errors) {
            let apart = (motion[0] * (sx - 1.0)).hypot(motion[1] * (sy - 1.0));
            if apart >= 1.5
                && let Some(other) = error((*sx, *sy))
            {
                *sum = (sum.0 + given, sum.1 + other, sum.2 + 1);
            }
        }
    }
    let better =
        |sum: &(f64, f64, u32)| sum.2 >= 100 && sum.0 > 0.02 * f64::from(sum.2) && sum.1 < 0.5 * sum.0;
    let all = tries.iter().zip(&errors).filter(|(_, sum)| better(sum));
    all.min_by(|a, b| (a.1.1 / a.1.0).total_cmp(&(b.1.1 / b.1.0))).map(|(found, _)| found.2)
}

/// Where the older keyframe's surfaces are at the newer one, per pixel; NaN where that is not known.
///
/// What was given comes first. Else the newer keyframe's vectors are turned around where both show the same surface; what
/// the newer one does not show goes on as before, or as its neighbours on the same surface do.
pub(crate) fn forward_motion(before: &Keyframe, now: &Keyframe, canvas: [usize; 2]) -> Vec<[f32; 2]> {
    const NONE: [f32; 2] = [f32::NAN; 2];
    let mut out = vec![NONE; before.back.len()];
    // The newer pixel, plus 1, that was nearest to a pixel of the older one; the nearer surface first.
    let mut from = vec![0_u32; before.back.len()];
    for (at, motion) in now.back.iter().enumerate().filter(|(_, motion)| is_motion(**motion)) {
        let (x, y) = ((at % canvas[0]) as f32, (at / canvas[0]) as f32);
        let Some(there) = pixel_at(x + motion[0], y + motion[1], canvas) else { continue };
        let nearness = now.nearness[at];
        let nearer = from[there] == 0 || nearness > now.nearness[from[there] as usize - 1];
        if nearer && may_be_one(before.nearness[there], nearness, SAME_OVER_TIME) {
            from[there] = at as u32 + 1;
        }
    }
    for (at, (out, from)) in out.iter_mut().zip(&from).enumerate() {
        if *from != 0 {
            let source = *from as usize - 1;
            let [x, y] = now.back[source];
            *out = refined(at, [-x, -y], now.nearness[source], now, canvas);
        }
    }
    let mut unknown: Vec<usize> = (0..out.len()).filter(|at| out[*at][0].is_nan()).collect();
    spread(&mut out, &mut unknown, before, canvas);
    if before.gap_us > 0 && now.gap_us > 0 {
        let longer = -(now.gap_us as f64 / before.gap_us as f64) as f32;
        for at in &unknown {
            let motion = before.back[*at];
            if is_motion(motion) {
                out[*at] = motion.map(|d| d * longer);
            }
        }
        unknown.retain(|at| out[*at][0].is_nan());
    }
    for _ in 1..ROUNDS {
        if unknown.is_empty() {
            break;
        }
        spread(&mut out, &mut unknown, before, canvas);
    }
    for (out, given) in out.iter_mut().zip(&before.forward) {
        if is_motion(*given) {
            *out = *given;
        }
    }
    out
}

/// How much paths bend within the gap, per pixel of the older and of the newer keyframe: the older one's surfaces lie on
/// parabolas through where they were at the keyframe before it, if that is known. 0 where it is not.
pub(crate) fn bends(
    before: &Keyframe,
    now: &Keyframe,
    forward: &[[f32; 2]],
    canvas: [usize; 2],
) -> [Vec<[f32; 2]>; 2] {
    if before.gap_us == 0 || now.gap_us == 0 {
        return Default::default();
    }
    let ratio = (before.gap_us as f64 / now.gap_us as f64) as f32;
    let older: Vec<[f32; 2]> = before
        .back
        .iter()
        .zip(forward)
        .map(|(back, ahead)| {
            if !is_motion(*back) || !is_motion(*ahead) {
                return [0.0; 2];
            }
            let bend = [0, 1].map(|axis| (back[axis] + ratio * ahead[axis]) / (ratio * (1.0 + ratio)));
            let length = |d: [f32; 2]| d[0].hypot(d[1]);
            let sharpest = SHARPEST * length(*ahead).max(length(*back) / ratio);
            if length(bend) <= sharpest { bend } else { [0.0; 2] }
        })
        .collect();
    let newer = now.back.iter().enumerate().map(|(at, back)| {
        let (x, y) = ((at % canvas[0]) as f32, (at / canvas[0]) as f32);
        let there = if is_motion(*back) { pixel_at(x + back[0], y + back[1], canvas) } else { None };
        let there =
            there.filter(|there| may_be_one(before.nearness[*there], now.nearness[at], SAME_OVER_TIME));
        there.map_or([0.0; 2], |there| older[there])
    });
    let newer = newer.collect();
    [older, newer]
}

/// The vector from the older pixel `at` whose turned-around one is read where it points to, between the newer one's pixels
/// of one surface; `first` as it is where they are of several.
fn refined(at: usize, first: [f32; 2], nearness: f32, now: &Keyframe, canvas: [usize; 2]) -> [f32; 2] {
    let (x, y) = ((at % canvas[0]) as f32, (at / canvas[0]) as f32);
    let mut motion = first;
    for _ in 0..3 {
        let (px, py) = (x + motion[0], y + motion[1]);
        let (left, top) = (px.floor(), py.floor());
        let inside =
            left >= 0.0 && top >= 0.0 && left + 1.0 < canvas[0] as f32 && top + 1.0 < canvas[1] as f32;
        if !inside {
            return motion;
        }
        let (fx, fy) = (px - left, py - top);
        let corner = top as usize * canvas[0] + left as usize;
        let mut sum = [0.0_f32; 2];
        for (other, weight) in [
            (corner, (1.0 - fx) * (1.0 - fy)),
            (corner + 1, fx * (1.0 - fy)),
            (corner + canvas[0], (1.0 - fx) * fy),
            (corner + canvas[0] + 1, fx * fy),
        ] {
            let back = now.back[other];
            if !is_motion(back) || !may_be_one(now.nearness[other], nearness, SAME_SURFACE) {
                return first;
            }
            sum = [sum[0] - weight * back[0], sum[1] - weight * back[1]];
        }
        motion = sum;
    }
    // No motion turns around where the picture folds.
    let apart = (motion[0] - first[0]).hypot(motion[1] - first[1]);
    if apart < 1.0 { motion } else { first }
}

/// Gives pixels of `unknown` the mean motion of their neighbours on the same surface, if some is known.
fn spread(out: &mut [[f32; 2]], unknown: &mut Vec<usize>, before: &Keyframe, [width, height]: [usize; 2]) {
    let found: Vec<[f32; 2]> = unknown
        .iter()
        .map(|at| {
            let (x, y) = (at % width, at / width);
            let (mut sum, mut count) = ([0.0_f32; 2], 0.0_f32);
            for y in y.saturating_sub(1)..(y + 2).min(height) {
                for x in x.saturating_sub(1)..(x + 2).min(width) {
                    let other = y * width + x;
                    let motion = out[other];
                    if !motion[0].is_nan()
                        && may_be_one(before.nearness[other], before.nearness[*at], SAME_SURFACE)
                    {
                        sum = [sum[0] + motion[0], sum[1] + motion[1]];
                        count += 1.0;
                    }
                }
            }
            // 0 / 0 where there is none.
            sum.map(|d| d / count)
        })
        .collect();
    for (at, motion) in unknown.iter().zip(found) {
        out[*at] = motion;
    }
    unknown.retain(|at| out[*at][0].is_nan());
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A picture that turns by `radians` a gap around its middle; where each pixel was at the last keyframe.
    pub fn turning(radians: f32, canvas: [usize; 2]) -> Keyframe {
        let back = (0..canvas[0] * canvas[1])
            .map(|at| {
                let turned = turned(at, -radians, canvas);
                [turned[0] - (at % canvas[0]) as f32, turned[1] - (at / canvas[0]) as f32]
            })
            .collect();
        let pixels = canvas[0] * canvas[1];
        Keyframe {
            gap_us: 33_333,
            light: vec![0.5; pixels],
            nearness: vec![0.5; pixels],
            back,
            ..Keyframe::default()
        }
    }

    pub fn turned(at: usize, radians: f32, canvas: [usize; 2]) -> [f32; 2] {
        let middle = canvas.map(|n| (n as f32 - 1.0) / 2.0);
        let (x, y) = ((at % canvas[0]) as f32 - middle[0], (at / canvas[0]) as f32 - middle[1]);
        let (sin, cos) = radians.sin_cos();
        [middle[0] + x * cos - y * sin, middle[1] + x * sin + y * cos]
    }

    #[test]
    fn curved_paths_follow_a_turn_where_straight_ones_cut_it_short() {
        let canvas = [64, 48];
        for (radians, straight_off, curved_off) in
            [(0.1, 0.015, 0.0015), (0.2, 0.06, 0.009), (0.4, 0.24, 0.06)]
        {
            let picture = turning(radians, canvas);
            let forward = forward_motion(&picture, &picture, canvas);
            let [older, newer] = bends(&picture, &picture, &forward, canvas);
            let mut errors = [0.0_f32, 0.0, 0.0];
            let mut count = 0.0;
            for at in 0..canvas[0] * canvas[1] {
                let (x, y) = ((at % canvas[0]) as f32, (at / canvas[0]) as f32);
                let middle = [31.5, 23.5];
                let radius = (x - middle[0]).hypot(y - middle[1]);
                if radius > 18.0 {
                    continue;
                }
                let off = |turn: f32, motion: [f32; 2], bend: [f32; 2]| {
                    let there = turned(at, turn, canvas);
                    let found = [x + 0.5 * motion[0] - 0.25 * bend[0], y + 0.5 * motion[1] - 0.25 * bend[1]];
                    (found[0] - there[0]).hypot(found[1] - there[1])
                };
                let half = radians / 2.0;
                let each = [
                    off(half, forward[at], [0.0; 2]),
                    off(half, forward[at], older[at]),
                    off(-half, picture.back[at], newer[at]),
                ];
                for (sum, error) in errors.iter_mut().zip(each) {
                    *sum += error;
                }
                count += 1.0;
            }
            let [straight, from, to] = errors.map(|sum| sum / count);
            assert!((straight / straight_off - 1.0).abs() < 0.05, "{radians}: {straight}");
            assert!(from < curved_off && to < curved_off, "{radians}: {from} {to}");
        }
    }

    #[test]
    fn what_stops_or_has_no_past_goes_straight() {
        let canvas = [16, 12];
        let pixels = canvas[0] * canvas[1];
        let moved = |dx: f32| Keyframe {
            gap_us: 10_000,
            nearness: vec![0.5; pixels],
            back: vec![[dx, 0.0]; pixels],
            ..Keyframe::default()
        };
        let straight = |bends: [Vec<[f32; 2]>; 2]| bends.iter().flatten().all(|bend| *bend == [0.0; 2]);
        let ahead = vec![[3.0_f32, 0.0]; pixels];
        assert!(straight(bends(&moved(-3.0), &moved(-3.0), &ahead, canvas)), "it goes on evenly");
        assert!(straight(bends(&moved(0.0), &moved(-3.0), &ahead, canvas)), "it has just begun to move");
        assert!(straight(bends(&moved(f32::NAN), &moved(-3.0), &ahead, canvas)));
        assert!(straight(bends(&Keyframe { gap_us: 0, ..moved(-2.0) }, &moved(-3.0), &ahead, canvas)));
        let [older, newer] = bends(&moved(-2.0), &moved(-3.0), &ahead, canvas);
        assert_eq!((older[40], newer[40]), ([0.5, 0.0], [0.5, 0.0]), "canary: it grows faster");
        // Half as long a gap before: 2 pixels in half the time.
        let before = Keyframe { gap_us: 5_000, ..moved(-2.0) };
        let [older, _] = bends(&before, &moved(-3.0), &ahead, canvas);
        assert!((older[40][0] - (-2.0 + 1.5) / 0.75).abs() < 1e-6, "{:?}", older[40]);
    }
}
