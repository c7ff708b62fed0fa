//! Which convention the motion vectors of a renderer follow: found from two keyframes, once.

use super::warp::is_motion;
use crate::emulator::frames::Frames;
use crate::sensor::ConfigError;

/// Pixels at which conventions are tried, about.
const TRIED: usize = 4096;
/// Pixels that a convention is compared on, at least.
const LEAST_COMPARED: u32 = 100;
/// Two conventions are compared where they lead so many pixels apart.
const APART_PX: f32 = 1.5;
/// Mean difference of log luminance below which vectors fit.
const FITS: f64 = 0.02;
/// Added to luminance before its logarithm, relative to the picture's mean.
const FLOOR: f64 = 1e-3;

/// What [`check_motion`] found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionCheck {
    /// What x and y of the vectors must be multiplied by; 1 and 1 where the convention is right.
    pub scale: [f32; 2],
    /// The convention of the vectors, in words.
    pub convention: &'static str,
    /// Mean absolute difference of log luminance between a pixel and where the vectors as given lead from it.
    pub error_given: f64,
    /// The same with scaled vectors.
    pub error: f64,
}

impl MotionCheck {
    /// Whether the vectors may be pushed as they are.
    pub fn is_right(&self) -> bool {
        self.scale == [1.0; 2]
    }
}

/// What [`check_motion`] says of vectors that are right.
const RIGHT: &str = "pixels from this keyframe to the last one, x right, y down";

/// Scales of the other conventions for pictures of `width` x `height` pixels, and their names.
fn others([width, height]: [f32; 2]) -> [([f32; 2], &'static str); 8] {
    [
        ([-1.0, -1.0], "pixels from the last keyframe to this one"),
        ([1.0, -1.0], "pixels from this keyframe to the last one, y up"),
        ([-1.0, 1.0], "pixels from the last keyframe to this one, y up"),
        ([width, height], "parts of the picture from this keyframe to the last one"),
        ([-width, -height], "parts of the picture from the last keyframe to this one"),
        ([0.5 * width, -0.5 * height], "clip space from this keyframe to the last one"),
        ([-0.5 * width, 0.5 * height], "clip space from the last keyframe to this one"),
        ([0.0, 0.0], "unrelated: the light stands still"),
    ]
}

/// Sums over the pixels on which two conventions are compared.
#[derive(Clone, Copy, Default)]
struct Compared {
    given: f64,
    other: f64,
    count: u32,
}

/// Which convention `motion` follows: x and y per pixel of the keyframe `newer`, of `size` pixels, whose last keyframe is
/// `older`. Each convention leads from pixels of the newer picture to places in the older one; the right one leads to the
/// same light.
///
/// Call it once for a renderer, with two keyframes between which a textured picture moves by some pixels.
/// [`crate::emulator::EventEmulator::push_keyframe`] takes pixels from this keyframe to the last one, x right, y down.
///
/// # Errors
/// Wrong sizes, logarithms of light, and pictures that do not tell: too few pixels that move by 1.5 pixels or more, or
/// light that fits every convention or none.
pub fn check_motion(
    older: &Frames<'_>,
    newer: &Frames<'_>,
    motion: &[f32],
    size: [usize; 2],
) -> Result<MotionCheck, ConfigError> {
    let pixels = size[0] * size[1];
    if motion.len() != 2 * pixels {
        let remedy = format!("{} (height × width × 2)", 2 * pixels);
        return Err(ConfigError::new("number of values of motion", motion.len(), remedy));
    }
    let light = |frames: &Frames<'_>| {
        frames.check(pixels)?;
        let remedy = "linear light, or integers under a transfer curve";
        frames.luminance().ok_or_else(|| ConfigError::new("light of keyframes", "logarithms", remedy))
    };
    let (before, now) = (light(older)?, light(newer)?);
    let known = || now.iter().filter(|y| y.is_finite() && **y >= 0.0).map(|y| f64::from(*y));
    let floor = (FLOOR * known().sum::<f64>() / known().count().max(1) as f64).max(f64::MIN_POSITIVE);
    let others = others(size.map(|n| n as f32));
    let mut sums = [Compared::default(); 8];
    let (vectors, _) = motion.as_chunks::<2>();
    let stride = (pixels / TRIED).max(1);
    for at in (stride / 2..pixels).step_by(stride).filter(|at| is_motion(vectors[*at])) {
        let motion = vectors[at];
        let (x, y) = ((at % size[0]) as f32, (at / size[0]) as f32);
        // The difference of light from here to where the vector leads, times `scale`.
        let error = |scale: [f32; 2]| {
            let place = super::links::pixel_at(x + motion[0] * scale[0], y + motion[1] * scale[1], size)?;
            let ratio = (f64::from(before[place]) + floor) / (f64::from(now[at]) + floor);
            (ratio > 0.0 && ratio.is_finite()).then(|| ratio.ln().abs().min(2.0))
        };
        let Some(given) = error([1.0; 2]) else { continue };
        for ((scale, _), sum) in others.iter().zip(&mut sums) {
            let apart = (motion[0] * (scale[0] - 1.0)).hypot(motion[1] * (scale[1] - 1.0));
            if apart >= APART_PX
                && let Some(other) = error(*scale)
            {
                *sum = Compared { given: sum.given + given, other: sum.other + other, count: sum.count + 1 };
            }
        }
    }
    let compared = || others.iter().zip(&sums).filter(|(_, sum)| sum.count >= LEAST_COMPARED);
    let fits = |error: f64, count: u32| error <= FITS * f64::from(count);
    let better = |sum: &Compared| !fits(sum.given, sum.count) && sum.other < 0.5 * sum.given;
    let found = compared()
        .filter(|(_, sum)| better(sum))
        .min_by(|a, b| (a.1.other / a.1.given).total_cmp(&(b.1.other / b.1.given)));
    if let Some(((scale, convention), sum)) = found {
        let count = f64::from(sum.count);
        return Ok(MotionCheck {
            scale: *scale,
            convention,
            error_given: sum.given / count,
            error: sum.other / count,
        });
    }
    // The given convention is right where another one is clearly worse.
    let worse = |sum: &Compared| !fits(sum.other, sum.count) && sum.given < 0.5 * sum.other;
    if let Some((_, sum)) = compared().find(|(_, sum)| worse(sum)) {
        let error = sum.given / f64::from(sum.count);
        return Ok(MotionCheck { scale: [1.0; 2], convention: RIGHT, error_given: error, error });
    }
    let remedy = "two keyframes between which a textured picture moves by some pixels";
    let value = match compared().next() {
        None => format!("fewer than {LEAST_COMPARED} pixels that move by {APART_PX} pixels"),
        Some(_) => "light that fits no convention better than another".into(),
    };
    Err(ConfigError::new("motion", value, remedy))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [96, 40];
    const PIXELS: usize = SIZE[0] * SIZE[1];

    fn picture(shift: [f64; 2]) -> Vec<f32> {
        let wave = |u: f64, v: f64| 0.5 + 0.2 * (u / 2.9).sin() + 0.2 * (v / 3.7 + 0.3 * u).cos();
        let at = |i: usize| wave((i % SIZE[0]) as f64 - shift[0], (i / SIZE[0]) as f64 - shift[1]) as f32;
        (0..PIXELS).map(at).collect()
    }

    fn check(vector: [f32; 2], newer: &[f32]) -> Result<MotionCheck, ConfigError> {
        let older = picture([0.0; 2]);
        let motion: Vec<f32> = (0..PIXELS).flat_map(|_| vector).collect();
        check_motion(&Frames::linear(&older), &Frames::linear(newer), &motion, SIZE)
    }

    #[test]
    fn conventions_are_named() {
        // The picture moves by (3, 2): the last keyframe lies at (-3, -2).
        let newer = picture([3.0, 2.0]);
        let right = check([-3.0, -2.0], &newer).unwrap();
        assert!(right.is_right() && right.convention == RIGHT && right.error < 0.01, "{right:?}");
        let [width, height] = SIZE.map(|n| n as f32);
        for (given, scale, named) in [
            ([3.0, 2.0], [-1.0, -1.0], "from the last keyframe to this one"),
            ([-3.0, 2.0], [1.0, -1.0], "y up"),
            ([3.0, -2.0], [-1.0, 1.0], "from the last keyframe to this one, y up"),
            ([-3.0 / width, -2.0 / height], [width, height], "parts of the picture from this"),
            ([3.0 / width, 2.0 / height], [-width, -height], "parts of the picture from the last"),
            ([-6.0 / width, 4.0 / height], [0.5 * width, -0.5 * height], "clip space from this"),
            ([6.0 / width, -4.0 / height], [-0.5 * width, 0.5 * height], "clip space from the last"),
        ] {
            let found = check(given, &newer).unwrap();
            assert_eq!(found.scale, scale, "{given:?}: {found:?}");
            assert!(found.convention.contains(named), "{given:?}: {found:?}");
            assert!(!found.is_right() && found.error < 0.5 * found.error_given, "{given:?}: {found:?}");
        }
        let still = check([-3.0, -2.0], &picture([0.0; 2])).unwrap();
        assert!(still.scale == [0.0; 2] && still.convention.contains("stands still"), "{still:?}");
    }

    #[test]
    fn pictures_that_do_not_tell_are_refused() {
        let told = |vector, newer: &[f32]| check(vector, newer).unwrap_err().to_string();
        assert!(told([0.0, 0.0], &picture([3.0, 2.0])).contains("fewer than 100 pixels"));
        assert!(told([-3.0, -2.0], &[0.5; PIXELS]).contains("no convention better"), "another picture");
        let short = check_motion(&Frames::linear(&[0.5; 4]), &Frames::linear(&[0.5; 4]), &[0.0; 6], [2, 2]);
        assert!(short.unwrap_err().to_string().contains("number of values of motion"));
        let refused = check_motion(&Frames::log(&[0.5; 4]), &Frames::log(&[0.5; 4]), &[0.0; 8], [2, 2]);
        assert!(refused.unwrap_err().to_string().contains("linear light"));
    }
}
