//! What links two keyframes: how far the picture moved, whether it is the same world, and where the older one's surfaces
//! went.

use super::last_keyframe::Keyframe;
use super::warp::{SAME_SURFACE, is_motion};

/// Depths at least this part of one another may be of one surface at two times: it may have come nearer.
const SAME_OVER_TIME: f32 = 0.7;
/// Below this part of surfaces that are found again, nothing links two keyframes.
const LEAST_LINKED: f32 = 0.2;
/// Share of pixels that may move farther than [`Links::motion_px`] says.
const FASTEST_SHARE: f64 = 1e-3;
/// Rounds of giving unknown pixels the motion of their neighbours.
const ROUNDS: usize = 16;

/// How the newer of two keyframes hangs together with the older.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Links {
    pub motion_px: f32,
    /// Part of all pixels that were found again.
    pub linked: f32,
}

/// Pixel that is nearest to a place, if it is in the picture.
#[inline(always)]
pub(super) fn pixel_at(x: f32, y: f32, [width, height]: [usize; 2]) -> Option<usize> {
    let (x, y) = ((x + 0.5).floor(), (y + 0.5).floor());
    let inside = x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32;
    inside.then(|| y as usize * width + x as usize)
}

fn may_be_one(a: f32, b: f32, part: f32) -> bool {
    a.min(b) >= a.max(b) * part
}

impl Links {
    /// Compares the pictures.
    pub fn find(before: &Keyframe, now: &Keyframe, canvas: [usize; 2]) -> Self {
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
        Self { motion_px, linked }
    }

    /// Whether nothing links the keyframes.
    pub fn is_cut(&self) -> bool {
        self.linked < LEAST_LINKED
    }
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
}
