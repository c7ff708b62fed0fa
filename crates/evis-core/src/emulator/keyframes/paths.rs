//! Paths through a gap of which motion is known from one fine step to the next: integrated, as by the dense mode of the EVIS
//! paper, instead of one vector that is scaled by the elapsed part.

use rayon::prelude::*;

use super::warp::is_motion;

/// Rounds in which a step forward is found in a field that leads back, at most.
const ROUNDS: usize = 6;
/// Rounds end where the place moves by less: a fraction of the unit in which positions are counted.
const CLOSE_PX: f32 = 1e-4;
/// A path that ends farther from where motion vectors lead has come upon another surface.
const STRAY_PX: f32 = 1.0;

/// The motion fields of one gap: field `k`, counted from 1, has for each pixel of fine step `k` where its surface was at fine
/// step `k - 1`; step 0 is the older keyframe.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fields<'a> {
    /// One after the other.
    pub vectors: &'a [[f32; 2]],
    pub canvas: [usize; 2],
    /// Whether the threads of the pool that this runs in share the work.
    pub shared: bool,
}

/// How far each pixel is from where it began, after each fine step.
#[derive(Clone, Debug, Default)]
pub(crate) struct Paths {
    steps: Vec<Vec<[f32; 2]>>,
    /// Which left the picture or came upon a vector that is none.
    pub broken: Vec<bool>,
}

/// The vector between the pixels around a place; `None` outside of the picture, and where one of them is none.
#[inline(always)]
fn sampled(field: &[[f32; 2]], [x, y]: [f32; 2], [width, height]: [usize; 2]) -> Option<[f32; 2]> {
    let inside = |v: f32, n: usize| v >= -0.5 && v < n as f32 - 0.5;
    if !inside(x, width) || !inside(y, height) {
        return None;
    }
    // The outer half of a border's pixel is like its centre.
    let (x, y) = (x.clamp(0.0, (width - 1) as f32), y.clamp(0.0, (height - 1) as f32));
    let (left, top) = (x.floor(), y.floor());
    let (fx, fy) = (x - left, y - top);
    let corner = top as usize * width + left as usize;
    let mut sum = [0.0_f32; 2];
    for (at, weight) in [
        (corner, (1.0 - fx) * (1.0 - fy)),
        (corner + 1, fx * (1.0 - fy)),
        (corner + width, (1.0 - fx) * fy),
        (corner + width + 1, fx * fy),
    ] {
        if weight > 0.0 {
            let vector = field[at];
            if !is_motion(vector) {
                return None;
            }
            sum = [sum[0] + weight * vector[0], sum[1] + weight * vector[1]];
        }
    }
    Some(sum)
}

/// The step from a place to where its surface is one fine step later, `field` leading back from there: the fixed point of
/// `p' = p - field(p')`, looked for from `guess` on.
#[inline(always)]
fn inverted(field: &[[f32; 2]], [x, y]: [f32; 2], guess: [f32; 2], canvas: [usize; 2]) -> Option<[f32; 2]> {
    let mut step = guess;
    for _ in 0..ROUNDS {
        let next = sampled(field, [x + step[0], y + step[1]], canvas)?.map(|d| -d);
        let moved = (next[0] - step[0]).abs().max((next[1] - step[1]).abs());
        step = next;
        if moved < CLOSE_PX {
            break;
        }
    }
    Some(step)
}

impl Fields<'_> {
    /// Fine steps of the gap.
    pub fn count(&self) -> usize {
        self.vectors.len() / (self.canvas[0] * self.canvas[1])
    }

    fn each(&self) -> impl DoubleEndedIterator<Item = &[[f32; 2]]> {
        self.vectors.chunks_exact(self.canvas[0] * self.canvas[1])
    }

    /// Of the newer keyframe's pixels, which lead to `ends` as far as that is known.
    pub fn back(&self, ends: Option<&[[f32; 2]]>) -> Paths {
        self.walked(self.each().rev(), ends, |field, place, _| sampled(field, place, self.canvas))
    }

    /// Of the older keyframe's pixels, which lead to `ends`.
    pub fn forward(&self, ends: &[[f32; 2]]) -> Paths {
        self.walked(self.each(), Some(ends), |field, place, last| inverted(field, place, last, self.canvas))
    }

    /// Takes `step`s through `fields`, with the place and the last step. Where there is none, the last one is taken again; the
    /// first one is the even part of the way to `ends`.
    fn walked<'f>(
        &self,
        fields: impl Iterator<Item = &'f [[f32; 2]]>,
        ends: Option<&[[f32; 2]]>,
        step: impl Fn(&[[f32; 2]], [f32; 2], [f32; 2]) -> Option<[f32; 2]> + Sync,
    ) -> Paths {
        let width = self.canvas[0];
        let pixels = width * self.canvas[1];
        let even = 1.0 / self.count() as f32;
        let mut broken = vec![false; pixels];
        let mut steps: Vec<Vec<[f32; 2]>> = Vec::with_capacity(self.count());
        for field in fields {
            let mut next = vec![[0.0_f32; 2]; pixels];
            let row = |(y, (next, broken)): (usize, (&mut [[f32; 2]], &mut [bool]))| {
                for (x, (next, broken)) in next.iter_mut().zip(broken).enumerate() {
                    let at = y * width + x;
                    let moved = |back: usize| match steps.len().checked_sub(back) {
                        Some(k) => steps[k][at],
                        None => [0.0; 2],
                    };
                    let (here, before) = (moved(1), moved(2));
                    let last = match (steps.is_empty(), ends) {
                        (true, Some(ends)) => ends[at].map(|d| d * even),
                        (true, None) => [f32::NAN; 2],
                        (false, _) => [here[0] - before[0], here[1] - before[1]],
                    };
                    let place = [x as f32 + here[0], y as f32 + here[1]];
                    let taken = step(field, place, last);
                    *broken |= taken.is_none();
                    let [dx, dy] = taken.unwrap_or(last);
                    *next = [here[0] + dx, here[1] + dy];
                }
            };
            if self.shared {
                next.par_chunks_mut(width).zip(broken.par_chunks_mut(width)).enumerate().for_each(row);
            } else {
                next.chunks_mut(width).zip(broken.chunks_mut(width)).enumerate().for_each(row);
            }
            steps.push(next);
        }
        Paths { steps, broken }
    }
}

impl Paths {
    /// Where they end.
    pub fn ends(&self) -> Vec<[f32; 2]> {
        self.steps.last().cloned().unwrap_or_default()
    }

    /// Gives each pixel the path of another one.
    pub fn pick(&mut self, from: &[usize]) {
        for step in &mut self.steps {
            *step = from.iter().map(|at| step[*at]).collect();
        }
    }

    /// What they add to straight ones to `ends` after each fine step but the last, and how many end elsewhere: these are
    /// straight. The others are bent so that they end there.
    pub fn bends(mut self, ends: &[[f32; 2]]) -> (Vec<Vec<[f32; 2]>>, usize) {
        let count = self.steps.len() as f32;
        let Some(last) = self.steps.pop() else { return Default::default() };
        // Not so where one of the two is not known.
        let apart = last.iter().zip(ends).map(|(last, end)| (last[0] - end[0]).hypot(last[1] - end[1]));
        let follows: Vec<bool> = apart.map(|apart| apart <= STRAY_PX).collect();
        for (k, step) in (1..).zip(&mut self.steps) {
            let part = k as f32 / count;
            for (at, step) in step.iter_mut().enumerate() {
                *step = match follows[at] {
                    true => [step[0] - part * last[at][0], step[1] - part * last[at][1]],
                    false => [0.0; 2],
                };
            }
        }
        let strayed = (0..ends.len()).filter(|at| is_motion(ends[*at]) && !follows[*at]).count();
        (self.steps, strayed)
    }
}

#[cfg(test)]
mod tests {
    use super::super::links::forward_motion;
    use super::super::links::tests::{turned, turning};
    use super::*;

    const CANVAS: [usize; 2] = [64, 48];
    const PIXELS: usize = CANVAS[0] * CANVAS[1];
    const STEPS: usize = 8;

    /// Fields of a picture that has turned by `angles[k]` at fine step k.
    fn turning_by(angles: &[f32]) -> Vec<[f32; 2]> {
        angles.windows(2).flat_map(|pair| turning(pair[1] - pair[0], CANVAS).back).collect()
    }

    /// Mean distance from the truth, within 18 pixels of the middle, after fine step `k`: of straight paths, of the older
    /// keyframe's through `vectors`, and of the newer one's.
    fn errors(vectors: &[[f32; 2]], angles: &[f32], k: usize) -> [f32; 3] {
        let whole = angles[STEPS];
        let picture = turning(whole, CANVAS);
        let forward = forward_motion(&picture, &picture, CANVAS);
        let fields = Fields { vectors, canvas: CANVAS, shared: false };
        let (older, _) = fields.forward(&forward).bends(&forward);
        let (newer, _) = fields.back(Some(&picture.back)).bends(&picture.back);
        let mut sums = [0.0_f32; 3];
        let mut count = 0.0;
        for at in 0..PIXELS {
            let (x, y) = ((at % CANVAS[0]) as f32, (at / CANVAS[0]) as f32);
            if (x - 31.5).hypot(y - 23.5) > 18.0 {
                continue;
            }
            let off = |turn: f32, part: f32, motion: [f32; 2], bend: [f32; 2]| {
                let there = turned(at, turn, CANVAS);
                let found = [x + part * motion[0] + bend[0], y + part * motion[1] + bend[1]];
                (found[0] - there[0]).hypot(found[1] - there[1])
            };
            let part = k as f32 / STEPS as f32;
            let each = [
                off(angles[k], part, forward[at], [0.0; 2]),
                off(angles[k], part, forward[at], older[k - 1][at]),
                off(angles[k] - whole, 1.0 - part, picture.back[at], newer[STEPS - k - 1][at]),
            ];
            for (sum, error) in sums.iter_mut().zip(each) {
                *sum += error;
            }
            count += 1.0;
        }
        sums.map(|sum| sum / count)
    }

    #[test]
    fn paths_through_fields_follow_a_turn_where_straight_ones_cut_it_short() {
        for (radians, straight_off, older_off) in [(0.1, 0.015, 3e-5), (0.2, 0.06, 4e-4), (0.4, 0.239, 5e-3)]
        {
            let angles = std::array::from_fn::<f32, 9, _>(|k| radians * k as f32 / STEPS as f32);
            let [straight, older, newer] = errors(&turning_by(&angles), &angles, STEPS / 2);
            assert!((straight / straight_off - 1.0).abs() < 0.05, "{radians}: {straight}");
            assert!(older < older_off && newer < 1e-5, "{radians}: {older} {newer}");
        }
    }

    #[test]
    fn paths_through_fields_follow_a_turn_that_speeds_up() {
        let angles = std::array::from_fn::<f32, 9, _>(|k| 0.4 * (k as f32 / STEPS as f32).powi(2));
        let vectors = turning_by(&angles);
        let reversed: Vec<[f32; 2]> = vectors.chunks_exact(PIXELS).rev().flatten().copied().collect();
        for k in 1..STEPS {
            let [straight, older, newer] = errors(&vectors, &angles, k);
            assert!(straight > 0.5 && older < 0.01 && newer < 1e-5, "{k}: {straight} {older} {newer}");
            // Canary: the newest field first.
            let [_, older, newer] = errors(&reversed, &angles, k);
            assert!(older > straight && newer > straight, "{k}: {older} {newer}");
        }
    }

    #[test]
    fn a_field_is_read_between_pixels_that_have_vectors() {
        let canvas = [4, 3];
        let mut field: Vec<[f32; 2]> = (0..12).map(|at| [(at % 4) as f32, (at / 4) as f32 * 10.0]).collect();
        assert_eq!(sampled(&field, [1.25, 0.5], canvas), Some([1.25, 5.0]));
        assert_eq!(sampled(&field, [3.4, -0.4], canvas), Some([3.0, 0.0]));
        for outside in [[3.5, 0.0], [-0.6, 0.0], [0.0, 2.5], [f32::NAN, 0.0], [0.0, f32::INFINITY]] {
            assert_eq!(sampled(&field, outside, canvas), None, "{outside:?}");
        }
        field[5][1] = f32::NAN;
        assert_eq!(sampled(&field, [1.25, 0.5], canvas), None);
        // What it does not touch does not matter.
        assert_eq!(sampled(&field, [2.0, 1.0], canvas), Some([2.0, 10.0]));
        assert_eq!(sampled(&field, [1.0, 0.0], canvas), Some([1.0, 0.0]));
    }

    #[test]
    fn the_last_step_goes_on_where_there_is_no_vector() {
        let canvas = [16, 1];
        let still = vec![[0.0_f32, 0.0]; 16];
        let mut middle = vec![[-2.0_f32, 0.0]; 16];
        middle[6] = [f32::NAN, 0.0];
        let vectors = [still, middle, vec![[-3.0_f32, 0.0]; 16]].concat();
        let fields = Fields { vectors: &vectors, canvas, shared: false };
        let paths = fields.back(None);
        let after = |paths: &Paths, at: usize| paths.steps.iter().map(|step| step[at][0]).collect::<Vec<_>>();
        assert_eq!((after(&paths, 10), paths.broken[10]), (vec![-3.0, -5.0, -5.0], false));
        assert_eq!((after(&paths, 9), paths.broken[9]), (vec![-3.0, -6.0, -6.0], true));
        assert_eq!((after(&paths, 1), paths.broken[1]), (vec![-3.0, -6.0, -9.0], true), "out of the picture");
        // Nothing is known of the first step but the whole.
        let nothing = vec![[f32::NAN; 2]; 48];
        let fields = Fields { vectors: &nothing, canvas, shared: false };
        assert_eq!(after(&fields.back(Some(&[[-6.0, 0.0]; 16])), 8), [-2.0, -4.0, -6.0]);
        assert!(fields.back(None).ends()[8][0].is_nan());
    }
}
