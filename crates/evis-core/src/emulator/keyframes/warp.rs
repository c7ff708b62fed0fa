//! An instant between two keyframes from both, each pixel moved to where it then is: `splat` without a device.
//!
//! The same algorithm as the engine's `splat/*.wgsl`, with linear motion, one instant per thread: nothing is shared, so
//! nothing depends on how many threads there are. Positions of `splat` are whole multiples of 1/1024 pixel; colours of
//! `evis-paper` are added up in f64, where the engine has sums of integers.

use serde::{Deserialize, Serialize};

use crate::sensor::ConfigError;
use crate::simd::{self, Isa, dispatched};

/// Parts of a pixel in which positions are counted, as a power of two.
const SUBPIXEL_BITS: i32 = 10;
const SUBPIXELS: i32 = 1 << SUBPIXEL_BITS;
/// Depths at least this part of one another are taken for one surface.
pub(crate) const SAME_SURFACE: f32 = 0.95;
/// A motion vector with a component of so many pixels is none.
pub(crate) const MOTION_LIMIT: f32 = 16_384.0;
/// Pixels of a keyframe at most: an index and how near it is share 32 bits.
pub(crate) const MOST_PIXELS: usize = 1 << 24;

/// Pixels that a keyframe may show beyond each border.
pub(crate) const MOST_MARGIN: u32 = 512;

/// Softmax sharpness of `evis-paper`: importance is e^(12 · (1/z) / max(1/z)).
const SHARPNESS: f64 = 12.0;
/// What a margin shows may be nearer than all that the sensor sees; beyond this exponent, f64 would end.
const MOST_EXPONENT: f64 = 600.0;
/// A pixel with less splatted weight of colours than this is a hole of `evis-paper`.
const HOLE_BELOW: f64 = 1e-4;
/// Pixels by which the motion of nearer surfaces reaches over their antialiased fringe, for `splat` of pushed keyframes: on
/// `spinner` and `warehouse` F1 rose by 0.01 to 0.02.
const DILATION: usize = 1;

/// Which warp makes the instants between two keyframes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum WarpVariant {
    /// The nearest surface wins, and its light is read from the keyframe; where both keyframes show the same surface both
    /// count, in log light and by their distance in time; what neither shows is unknown. On scenes, points move by the exact
    /// matrices of camera and object.
    #[default]
    Splat,
    /// As the EVIS paper publishes it: linear motion, colours splatted with softmax 12 on 1/(z + 1e-3), holes below 1e-4 of a
    /// pixel, newer keyframe first, older in its holes, black where neither shows anything.
    EvisPaper,
}

impl WarpVariant {
    /// `splat` or `evis-paper`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Splat => "splat",
            Self::EvisPaper => "evis-paper",
        }
    }

    /// Pixels by which the motion of nearer surfaces reaches over their fringe.
    pub(crate) const fn dilation(self) -> usize {
        match self {
            Self::Splat => DILATION,
            Self::EvisPaper => 0,
        }
    }
}

/// How the instants between two keyframes come from both: those of a scene, and those that are pushed.
///
/// What is not given takes the defaults of where it is used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Warp {
    /// Which warp.
    pub variant: WarpVariant,
    /// Keyframes rendered per second of a scene, on a grid fixed in absolute time; 125 where not given. Keyframes that are
    /// pushed have times of their own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub keyframe_hz: Option<f64>,
    /// Instants per gap, the keyframe that ends it included, 1 to 1000. Where not given, 8 on scenes, and between pushed
    /// keyframes as many as `step_px` asks for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<u32>,
    /// Pixels that keyframes show beyond each border of the sensor, up to 512. Where not given, 32 on scenes, and 0 for pushed
    /// keyframes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub margin: Option<u32>,
    /// Pushed keyframes, where `steps` is not given: pixels that the picture moves from instant to instant, at most; 0.3 where
    /// not given. A gap in which it moves by no more than a pixel is not divided.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step_px: Option<f32>,
    /// Pushed keyframes: whether keyframes that nothing links are taken for a cut; where not given, `splat` does so, and
    /// `evis-paper` does not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detect_cuts: Option<bool>,
}

/// Pixels from instant to instant where neither `steps` nor `step_px` is given.
const USUAL_STEP_PX: f32 = 0.3;
/// Keyframes per second of a scene where none are given.
const USUAL_KEYFRAME_HZ: f64 = 125.0;
/// Instants per gap of a scene where none are given: the EVIS paper's.
const USUAL_STEPS: u32 = 8;
/// Pixels beyond each border of a scene's pictures where none are given.
const USUAL_MARGIN: u32 = 32;

impl Warp {
    /// Variant `variant`, everything else where it is used.
    pub const fn of(variant: WarpVariant) -> Self {
        Self { variant, keyframe_hz: None, steps: None, margin: None, step_px: None, detect_cuts: None }
    }

    /// As the EVIS paper publishes it, with `steps` instants per gap.
    pub fn evis_paper(steps: u32) -> Self {
        Self { variant: WarpVariant::EvisPaper, steps: Some(steps), ..Self::default() }
    }

    /// The same with `keyframe_hz` keyframes per second and `steps` instants per gap.
    pub const fn at(self, keyframe_hz: f64, steps: u32) -> Self {
        Self { keyframe_hz: Some(keyframe_hz), steps: Some(steps), ..self }
    }

    /// Checks it for keyframes of a scene.
    ///
    /// # Errors
    /// Names the first value that cannot be used, and what would work.
    pub fn check_scene(&self) -> Result<(), ConfigError> {
        for (what, given) in
            [("step_px", self.step_px.is_some()), ("detect_cuts", self.detect_cuts.is_some())]
        {
            if given {
                return Err(ConfigError::new(what, "set", "not set: it is for keyframes that are pushed"));
            }
        }
        self.check_gap()?;
        let (keyframe_hz, steps) = (self.scene_keyframe_hz(), self.scene_steps());
        if !(keyframe_hz.is_finite() && keyframe_hz > 0.0 && keyframe_hz <= 1e6) {
            return Err(ConfigError::new("keyframe_hz", keyframe_hz, "above 0 and at most 1000000 Hz"));
        }
        if keyframe_hz * f64::from(steps) > 1e6 {
            let remedy = format!(
                "at most {} at {keyframe_hz} keyframes per second: instants are whole microseconds",
                (1e6 / keyframe_hz).floor(),
            );
            return Err(ConfigError::new("steps", steps, remedy));
        }
        Ok(())
    }

    /// Checks it for keyframes that are pushed.
    ///
    /// # Errors
    /// Names the first value that cannot be used, and what would work.
    pub fn check_push(&self) -> Result<(), ConfigError> {
        if let Some(keyframe_hz) = self.keyframe_hz {
            let remedy = "not set: keyframes that are pushed have times of their own";
            return Err(ConfigError::new("keyframe_hz", keyframe_hz, remedy));
        }
        self.check_gap()?;
        let step_px = self.push_step_px();
        if !(0.01..=100.0).contains(&step_px) {
            return Err(ConfigError::new("step_px", step_px, "between 0.01 and 100 pixels"));
        }
        Ok(())
    }

    /// Keyframes of a scene per second.
    pub fn scene_keyframe_hz(&self) -> f64 {
        self.keyframe_hz.unwrap_or(USUAL_KEYFRAME_HZ)
    }

    /// Instants per gap of a scene.
    pub fn scene_steps(&self) -> u32 {
        self.steps.unwrap_or(USUAL_STEPS)
    }

    /// Pixels beyond each border of a scene's keyframes.
    pub fn scene_margin(&self) -> u32 {
        self.margin.unwrap_or(USUAL_MARGIN)
    }

    /// Pixels beyond each border of pushed keyframes.
    pub fn push_margin(&self) -> u32 {
        self.margin.unwrap_or(0)
    }

    /// Pixels from instant to instant of pushed keyframes.
    pub(crate) fn push_step_px(&self) -> f32 {
        self.step_px.unwrap_or(USUAL_STEP_PX)
    }

    /// Whether pushed keyframes that nothing links are taken for a cut.
    pub(crate) fn detects_cuts(&self) -> bool {
        self.detect_cuts.unwrap_or(self.variant == WarpVariant::Splat)
    }

    fn check_gap(&self) -> Result<(), ConfigError> {
        if let Some(steps) = self.steps.filter(|steps| !(1..=1000).contains(steps)) {
            return Err(ConfigError::new("steps", steps, "between 1 and 1000, or not given"));
        }
        if let Some(margin) = self.margin.filter(|margin| *margin > MOST_MARGIN) {
            return Err(ConfigError::new("margin", margin, format!("between 0 and {MOST_MARGIN} pixels")));
        }
        Ok(())
    }
}

/// One keyframe of a gap, seen from the other: what is splatted.
#[derive(Clone, Copy, Debug)]
pub struct Side<'a> {
    /// Light per pixel; NaN or negative where unknown.
    pub light: &'a [f32],
    /// 1 / (depth + 1e-3), 0 where nothing is.
    pub nearness: &'a [f32],
    /// Pixels to where each surface is at the other keyframe; not a number where that is not known.
    pub motion: &'a [[f32; 2]],
    /// What is added to straight paths, per pixel: at 1/K, 2/K, … of the way these K − 1; between two of them, and the ends,
    /// what lies between.
    pub bends: &'a [Vec<[f32; 2]>],
}

/// A part of the way that a side's pixels go, and what paths add to it there: up to two pictures by their weights.
#[derive(Clone, Copy, Debug)]
struct Moved<'a> {
    part: f32,
    bends: [(f32, &'a [[f32; 2]]); 2],
}

impl<'a> Moved<'a> {
    fn new(side: &Side<'a>, part: f32) -> Self {
        let place = part * (side.bends.len() + 1) as f32;
        let before = place.floor();
        let bends = |step: usize| -> &'a [[f32; 2]] {
            // The ends bend nowhere.
            step.checked_sub(1).and_then(|step| side.bends.get(step)).map_or(&[], Vec::as_slice)
        };
        let step = before as usize;
        let bends = [(1.0 - (place - before), bends(step)), (place - before, bends(step + 1))];
        Self { part, bends }
    }

    /// How far pixel `at`, whose whole way is `motion`, has moved.
    #[inline(always)]
    fn of(&self, at: usize, motion: [f32; 2]) -> [f32; 2] {
        let mut moved = motion.map(|d| d * self.part);
        for (weight, bends) in self.bends {
            if let Some(bend) = bends.get(at) {
                moved = [moved[0] + weight * bend[0], moved[1] + weight * bend[1]];
            }
        }
        moved
    }
}

/// Sizes of a gap's pictures and what its pixels get.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pictures {
    /// Sensor pixels, width and height.
    pub size: [usize; 2],
    /// Keyframe pixels: the sensor's and a margin around.
    pub canvas: [usize; 2],
    /// Light beside which none is dark: `eps · Y_ref`.
    pub log_floor: f32,
    /// `Y_ref`.
    pub reference_luminance: f32,
}

/// Where a source is, and whether it reaches beyond the pixel that its centre is in, along each axis.
type Place = ([i32; 2], [bool; 2]);

/// A side with what all instants of the gap have in common.
struct Prepared<'a> {
    side: Side<'a>,
    /// Bits of the nearness, plus 1; 0 where a pixel goes nowhere.
    keys: Vec<u32>,
    /// Whether all pixels within two of a pixel show its surface, and are known: light between them needs no look at each.
    /// Empty where colours are splatted.
    plain: Vec<bool>,
    /// Of each pixel's colour; empty where none are splatted.
    importance: Vec<f64>,
}

/// The gap between two keyframes.
pub struct Gap<'a> {
    variant: WarpVariant,
    margin: i32,
    pictures: Pictures,
    older: Prepared<'a>,
    newer: Prepared<'a>,
    isa: Isa,
}

/// Memory of one thread; any number of instants may use it, one after the other.
#[derive(Debug, Default)]
pub struct Scratch {
    older: Sums,
    newer: Sums,
    rows: [Vec<f32>; 2],
}

/// What a side amounts to at each sensor pixel.
#[derive(Debug, Default)]
struct Sums {
    /// Nearest key.
    depth: Vec<u32>,
    /// An index with how near it is before it.
    word: Vec<u32>,
    /// Weight, and light times weight.
    colours: Vec<[f64; 2]>,
}

impl Sums {
    fn clear(&mut self, pixels: usize, variant: WarpVariant) {
        let (indices, colours) = match variant {
            WarpVariant::Splat => (pixels, 0),
            WarpVariant::EvisPaper => (0, pixels),
        };
        for plane in [&mut self.depth, &mut self.word] {
            plane.clear();
            plane.resize(indices, 0);
        }
        self.colours.clear();
        self.colours.resize(colours, [0.0; 2]);
    }

    /// Whether no colours are at a pixel.
    #[inline(always)]
    fn is_hole(&self, p: usize) -> bool {
        self.colours[p][0] < HOLE_BELOW
    }
}

/// Whether a vector moves a pixel.
#[inline(always)]
pub(crate) fn is_motion(motion: [f32; 2]) -> bool {
    motion[0].abs() < MOTION_LIMIT && motion[1].abs() < MOTION_LIMIT
}

fn nearness_of(key: u32) -> f32 {
    f32::from_bits(key.wrapping_sub(1))
}

/// Whether two points at these nearnesses may be on one surface.
#[inline(always)]
fn same_surface(a: f32, b: f32) -> bool {
    a.min(b) >= a.max(b) * SAME_SURFACE
}

impl<'a> Prepared<'a> {
    fn new(side: Side<'a>, variant: WarpVariant, pictures: &Pictures) -> Self {
        let width = pictures.canvas[0];
        let pixels = side.light.iter().zip(side.nearness).zip(side.motion);
        let keys = pixels
            .map(|((light, nearness), motion)| {
                let placed = *light >= 0.0 && is_motion(*motion);
                if placed { nearness.max(0.0).to_bits().wrapping_add(1) } else { 0 }
            })
            .collect();
        match variant {
            WarpVariant::Splat => Self { side, keys, plain: plain(&side, width), importance: Vec::new() },
            WarpVariant::EvisPaper => {
                Self { side, keys, plain: Vec::new(), importance: importance(&side, pictures) }
            }
        }
    }
}

/// e^(12 · nearness / largest nearness) of every pixel; the largest one is of what the sensor sees, so that a margin changes
/// no weight.
fn importance(side: &Side<'_>, pictures: &Pictures) -> Vec<f64> {
    let [width, height] = pictures.size;
    let margin = (pictures.canvas[0] - width) / 2;
    let rows = side.nearness.chunks_exact(pictures.canvas[0]).skip(margin).take(height);
    let seen = rows.flat_map(|row| &row[margin..margin + width]);
    let largest = seen.fold(0.0_f32, |largest, nearness| largest.max(*nearness));
    let sharpness = SHARPNESS / f64::from(largest.max(1e-30));
    side.nearness.iter().map(|nearness| (f64::from(*nearness) * sharpness).min(MOST_EXPONENT).exp()).collect()
}

/// Where a source that has moved is, in parts of a pixel of the sensor.
#[inline(always)]
fn place(x: usize, y: usize, margin: i32, moved: [f32; 2]) -> [i32; 2] {
    let at = |pixel: usize, d: f32| {
        // Motion is below 2^14 pixels, or the key is 0: far from the ends of an i32. The conversion saturates.
        let d = (d * SUBPIXELS as f32 + 0.5).floor() as i32;
        ((pixel as i32).wrapping_sub(margin) << SUBPIXEL_BITS).wrapping_add(d)
    };
    [at(x, moved[0]), at(y, moved[1])]
}

/// Whether a coordinate is nearer to the second of the two pixels around it.
#[inline(always)]
fn is_past_half(q: i32) -> bool {
    q & (SUBPIXELS - 1) >= SUBPIXELS / 2
}

/// Calls `each` with the index and the bilinear weight of the pixels around `q` that are within `size`; along an axis that
/// it does not reach along, of that pixel only which its centre is in.
#[inline(always)]
fn for_taps((q, reaches): Place, size: [usize; 2], mut each: impl FnMut(usize, u32)) {
    let base = q.map(|v| v >> SUBPIXEL_BITS);
    let mut f = q.map(|v| (v & (SUBPIXELS - 1)) as u32);
    let mut g = f.map(|v| (SUBPIXELS as u32).wrapping_sub(v));
    for axis in [0, 1] {
        if !reaches[axis] {
            let other = if is_past_half(q[axis]) { &mut g } else { &mut f };
            other[axis] = 0;
        }
    }
    let weights =
        [g[0].wrapping_mul(g[1]), f[0].wrapping_mul(g[1]), g[0].wrapping_mul(f[1]), f[0].wrapping_mul(f[1])];
    let (width, height) = (size[0] as i32, size[1] as i32);
    let first = (base[1] as isize).wrapping_mul(width as isize).wrapping_add(base[0] as isize);
    if base[0] >= 0 && base[1] >= 0 && base[0] < width - 1 && base[1] < height - 1 {
        let first = first as usize;
        each(first, weights[0]);
        each(first.wrapping_add(1), weights[1]);
        each(first.wrapping_add(size[0]), weights[2]);
        each(first.wrapping_add(size[0]).wrapping_add(1), weights[3]);
        return;
    }
    if base[0] < -1 || base[1] < -1 || base[0] >= width || base[1] >= height {
        return;
    }
    for (i, weight) in weights.into_iter().enumerate() {
        let (right, down) = ((i & 1) as i32, (i >> 1) as i32);
        let (x, y) = (base[0] + right, base[1] + down);
        if x >= 0 && y >= 0 && x < width && y < height {
            each(y as usize * size[0] + x as usize, weight);
        }
    }
}

impl<'a> Gap<'a> {
    /// A gap between the keyframes `older` and `newer`, all of whose pictures have `pictures.canvas` pixels.
    pub fn new(variant: WarpVariant, pictures: &Pictures, older: Side<'a>, newer: Side<'a>) -> Self {
        Self {
            variant,
            // The same along both axes.
            margin: ((pictures.canvas[0] - pictures.size[0]) / 2) as i32,
            pictures: *pictures,
            older: Prepared::new(older, variant, pictures),
            newer: Prepared::new(newer, variant, pictures),
            isa: Isa::detect(),
        }
    }

    /// Light of each sensor pixel when the part `elapsed` of the gap has passed; NaN where it is not known.
    pub fn instant(&self, elapsed: f32, scratch: &mut Scratch, out: &mut Vec<f32>) {
        let Scratch { older, newer, rows } = scratch;
        let moved = [Moved::new(&self.older.side, elapsed), Moved::new(&self.newer.side, 1.0 - elapsed)];
        match self.variant {
            WarpVariant::Splat => {
                self.splat(&self.newer, &moved[1], newer);
                self.splat(&self.older, &moved[0], older);
            }
            WarpVariant::EvisPaper => {
                self.splat_colours(&self.newer, &moved[1], None, newer);
                self.splat_colours(&self.older, &moved[0], Some(newer), older);
            }
        }
        let [width, height] = self.pictures.size;
        out.clear();
        out.resize(width * height, f32::NAN);
        for row in rows.iter_mut() {
            row.resize(width, f32::NAN);
        }
        let [a, b] = rows;
        for (y, out) in out.chunks_exact_mut(width).enumerate() {
            self.look(y, &moved, (older, newer), (a, b));
            blend_by(self.isa, a, b, elapsed, self.pictures.log_floor, out);
            if self.variant == WarpVariant::EvisPaper {
                for light in out {
                    *light = if light.is_nan() { 0.0 } else { *light };
                }
            }
        }
    }

    /// Splats one side: depths first, then what is nearest.
    fn splat(&self, from: &Prepared<'_>, moved: &Moved<'_>, sums: &mut Sums) {
        let size = self.pictures.size;
        sums.clear(size[0] * size[1], self.variant);
        let Sums { depth, word, .. } = sums;
        self.for_sources(from, moved, |_, key, place| {
            for_taps(place, size, |p, weight| {
                if weight > 0 && depth[p] < key {
                    depth[p] = key;
                }
            });
        });
        let bits = index_bits(from.keys.len());
        let most = (1_u32 << (32 - bits)) - 1;
        let scale = most as f32 / 1_048_576.0;
        self.for_sources(from, moved, |source, key, place| {
            let nearness = nearness_of(key);
            for_taps(place, size, |p, weight| {
                if weight > 0 && nearness >= nearness_of(depth[p]) * SAME_SURFACE {
                    let near = ((weight as f32 * scale) as u32).clamp(1, most);
                    word[p] = word[p].max((near << bits) | source as u32);
                }
            });
        });
    }

    /// Splats the colours of one side, in the order of its pixels; only into the holes of another one where there is one.
    fn splat_colours(
        &self,
        from: &Prepared<'_>,
        moved: &Moved<'_>,
        holes_of: Option<&Sums>,
        sums: &mut Sums,
    ) {
        let [width, height] = self.pictures.size;
        sums.clear(width * height, self.variant);
        let canvas = self.pictures.canvas[0];
        let margin = f64::from(self.margin);
        let rows = from.keys.chunks_exact(canvas).zip(from.side.motion.chunks_exact(canvas));
        for (row, (keys, motions)) in rows.enumerate() {
            for (column, (key, motion)) in keys.iter().zip(motions).enumerate() {
                if *key == 0 {
                    continue;
                }
                let source = row * canvas + column;
                let [dx, dy] = moved.of(source, *motion);
                let (x, y) = (column as f64 - margin + f64::from(dx), row as f64 - margin + f64::from(dy));
                let (left, top) = (x.floor(), y.floor());
                let (fx, fy) = (x - left, y - top);
                let (importance, light) = (from.importance[source], f64::from(from.side.light[source]));
                for (x, y, bilinear) in [
                    (left, top, (1.0 - fx) * (1.0 - fy)),
                    (left + 1.0, top, fx * (1.0 - fy)),
                    (left, top + 1.0, (1.0 - fx) * fy),
                    (left + 1.0, top + 1.0, fx * fy),
                ] {
                    let inside = x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64;
                    if !inside || bilinear == 0.0 {
                        continue;
                    }
                    let p = y as usize * width + x as usize;
                    if holes_of.is_none_or(|other| other.is_hole(p)) {
                        let weight = bilinear * importance;
                        let [sum, lights] = sums.colours[p];
                        sums.colours[p] = [sum + weight, lights + weight * light];
                    }
                }
            }
        }
    }

    /// Calls `each` with the number, the key and the place of every source that goes somewhere.
    #[inline(always)]
    fn for_sources(&self, from: &Prepared<'_>, moved: &Moved<'_>, mut each: impl FnMut(usize, u32, Place)) {
        let width = self.pictures.canvas[0];
        let margin = self.margin;
        let rows = from.keys.chunks_exact(width).zip(from.side.motion.chunks_exact(width));
        for (y, (keys, motions)) in rows.enumerate() {
            let first = y * width;
            for (x, (key, motion)) in keys.iter().zip(motions).enumerate() {
                if *key != 0 {
                    let at = first.wrapping_add(x);
                    let q = place(x, y, margin, moved.of(at, *motion));
                    let reaches = if from.plain[at] { [true; 2] } else { self.reaches(from, (x, y), q) };
                    each(at, *key, (q, reaches));
                }
            }
        }
    }

    /// Whether an index reaches beyond the pixel that its centre is in, along each axis: where the keyframe shows its surface
    /// on that side too. So no crack opens where pixels move apart, and no outline grows between keyframes.
    fn reaches(&self, from: &Prepared<'_>, (x, y): (usize, usize), q: [i32; 2]) -> [bool; 2] {
        let [width, height] = self.pictures.canvas;
        let nearness = from.side.nearness;
        let own = nearness[y * width + x];
        let beside = |at: usize, second: bool| if second { at.checked_sub(1) } else { Some(at + 1) };
        let column = beside(x, is_past_half(q[0])).filter(|x| *x < width);
        let row = beside(y, is_past_half(q[1])).filter(|y| *y < height);
        [
            column.is_some_and(|x| same_surface(own, nearness[y * width + x])),
            row.is_some_and(|y| same_surface(own, nearness[y * width + x])),
        ]
    }

    /// What the older and the newer side show in row `y`; both the same where one is taken, NaN where nothing is.
    fn look(&self, y: usize, moved: &[Moved<'_>; 2], sums: (&Sums, &Sums), rows: (&mut [f32], &mut [f32])) {
        let splat = self.variant == WarpVariant::Splat;
        let width = self.pictures.size[0];
        for (x, (a, b)) in rows.0.iter_mut().zip(rows.1).enumerate() {
            let p = y * width + x;
            let newer = self.seen(&self.newer, &moved[1], sums.1, (x, y, p));
            let older = if newer.is_none() || splat {
                self.seen(&self.older, &moved[0], sums.0, (x, y, p))
            } else {
                None
            };
            (*a, *b) = match (older, newer) {
                (None, None) => (f32::NAN, f32::NAN),
                (Some((only, _)), None) | (None, Some((only, _))) => (only, only),
                (Some((old, far)), Some((new, near))) => {
                    if splat && near < far * SAME_SURFACE {
                        (old, old)
                    } else if !splat || far < near * SAME_SURFACE {
                        (new, new)
                    } else {
                        (old, new)
                    }
                }
            };
        }
    }

    /// Light and nearness of what a side shows at a pixel.
    #[inline(always)]
    fn seen(
        &self,
        from: &Prepared<'_>,
        moved: &Moved<'_>,
        sums: &Sums,
        (x, y, p): (usize, usize, usize),
    ) -> Option<(f32, f32)> {
        match self.variant {
            WarpVariant::EvisPaper => {
                let [weight, light] = sums.colours[p];
                // Of nearness nothing is asked: the newer side comes first.
                (weight >= HOLE_BELOW).then(|| ((light / weight) as f32, 0.0))
            }
            WarpVariant::Splat => {
                let (key, word) = (sums.depth[p], sums.word[p]);
                if key == 0 || word == 0 {
                    return None;
                }
                let source = word & ((1 << index_bits(from.keys.len())) - 1);
                Some((self.gathered(from, moved, source as usize, (x, y)), nearness_of(key)))
            }
        }
    }

    /// Light of a source, read between its keyframe's pixels as far from it as the pixel is from where it is now; across
    /// an edge its own.
    #[inline(always)]
    fn gathered(&self, from: &Prepared<'_>, moved: &Moved<'_>, source: usize, (x, y): (usize, usize)) -> f32 {
        let [width, height] = self.pictures.canvas;
        let Side { light, nearness, motion, .. } = &from.side;
        let own_y = source / width;
        let own_x = source - own_y * width;
        let q = place(own_x, own_y, self.margin, moved.of(source, motion[source]));
        let offset = |at: usize, q: i32| ((at as i32) << SUBPIXEL_BITS).wrapping_sub(q);
        let (dx, dy) = (offset(x, q[0]), offset(y, q[1]));
        let part = |d: i32| (d & (SUBPIXELS - 1)) as f32 * (1.0 / SUBPIXELS as f32);
        let (fx, fy) = (part(dx), part(dy));
        // Within a pixel of the source, for the taps of a splat reach no farther.
        let (left, top) = (own_x as i32 + (dx >> SUBPIXEL_BITS), own_y as i32 + (dy >> SUBPIXEL_BITS));
        if from.plain[source] {
            // Two pixels from any border: nothing wraps.
            let corner = (top as usize).wrapping_mul(width).wrapping_add(left as usize);
            let four = |at: usize| light.get(at..).and_then(|row| row.first_chunk::<4>()).copied();
            // A cubic keeps the contrast of fine texture that lines between four pixels would take and give back.
            let first = corner.wrapping_sub(width).wrapping_sub(1);
            let row = |down: usize| four(first.wrapping_add(width.wrapping_mul(down))).unwrap_or_default();
            return cubic([row(0), row(1), row(2), row(3)], fx, fy);
        }
        let column = |right: i32| (left + right).clamp(0, width as i32 - 1) as usize;
        let row = |down: i32| (top + down).clamp(0, height as i32 - 1) as usize;
        let (own, own_nearness) = (light[source], nearness[source]);
        let (top, bottom) = (row(0) * width, row(1) * width);
        let (left, right) = (column(0), column(1));
        let beside = |at: usize| {
            let known = same_surface(own_nearness, nearness[at]) && light[at] >= 0.0;
            if known { light[at] } else { own }
        };
        (1.0 - fx) * (1.0 - fy) * beside(top + left)
            + fx * (1.0 - fy) * beside(top + right)
            + (1.0 - fx) * fy * beside(bottom + left)
            + fx * fy * beside(bottom + right)
    }
}

/// Weights of four neighbours at the part `f` of the way from the second to the third.
#[inline(always)]
fn catmull_rom(f: f32) -> [f32; 4] {
    let (f2, f3) = (f * f, f * f * f);
    [
        0.5 * (2.0 * f2 - f - f3),
        0.5 * (2.0 - 5.0 * f2 + 3.0 * f3),
        0.5 * (f + 4.0 * f2 - 3.0 * f3),
        0.5 * (f3 - f2),
    ]
}

/// Light between the four pixels in the middle of sixteen. The spline overshoots: never beyond those four.
#[inline(always)]
fn cubic(rows: [[f32; 4]; 4], fx: f32, fy: f32) -> f32 {
    let (wx, wy) = (catmull_rom(fx), catmull_rom(fy));
    let along = |row: &[f32; 4]| (wx[0] * row[0] + wx[1] * row[1]) + (wx[2] * row[2] + wx[3] * row[3]);
    let sum = (wy[0] * along(&rows[0]) + wy[1] * along(&rows[1]))
        + (wy[2] * along(&rows[2]) + wy[3] * along(&rows[3]));
    let [_, [_, a, b, _], [_, c, d, _], _] = rows;
    sum.max(a.min(b).min(c.min(d))).min(a.max(b).max(c.max(d)))
}

/// Which pixels have a whole neighbourhood of one surface, see [`Prepared::plain`].
fn plain(side: &Side<'_>, width: usize) -> Vec<bool> {
    const REACH: usize = 2;
    let pixels = side.nearness.len();
    let height = pixels / width.max(1);
    let mut out = vec![false; pixels];
    if width <= 2 * REACH || height <= 2 * REACH {
        return out;
    }
    // Least and most nearness along rows; an unknown pixel has a range that no surface has.
    let mut ranges = vec![(0.0_f32, f32::INFINITY); pixels];
    let mut known = vec![(0.0_f32, f32::INFINITY); width];
    for (y, ranges) in ranges.chunks_exact_mut(width).enumerate() {
        let row = y * width..(y + 1) * width;
        let pairs = side.nearness[row.clone()].iter().zip(&side.light[row]);
        for (known, (nearness, light)) in known.iter_mut().zip(pairs) {
            *known = if *light >= 0.0 { (*nearness, *nearness) } else { (0.0, f32::INFINITY) };
        }
        for (range, window) in ranges[REACH..].iter_mut().zip(known.windows(2 * REACH + 1)) {
            *range = window.iter().fold((f32::INFINITY, 0.0_f32), |a, b| (a.0.min(b.0), a.1.max(b.1)));
        }
    }
    for y in REACH..height - REACH {
        for x in REACH..width - REACH {
            let at = y * width + x;
            let column = (0..=2 * REACH).map(|k| ranges[at + k * width - REACH * width]);
            let (least, most) = column.fold((f32::INFINITY, 0.0_f32), |a, b| (a.0.min(b.0), a.1.max(b.1)));
            out[at] = same_surface(least, most);
        }
    }
    out
}

/// Bits that the number of one of `pixels` pixels takes.
const fn index_bits(pixels: usize) -> u32 {
    u32::BITS - (pixels as u32).leading_zeros()
}

/// Blends two rows in the logarithm that pixels get.
#[inline(always)]
fn blend_body(older: &[f32], newer: &[f32], elapsed: f32, log_floor: f32, out: &mut [f32]) {
    for ((older, newer), out) in older.iter().zip(newer).zip(out) {
        let floor = if log_floor > 1e-30 { log_floor } else { 1e-30 };
        let (a, b) = (simd::ln(older + floor), simd::ln(newer + floor));
        let light = simd::exp(a + (b - a) * elapsed) - floor;
        let light = if light > 0.0 { light } else { 0.0 };
        // Also where both are NaN: the logarithm would make a number of it.
        *out = if older.to_bits() == newer.to_bits() { *newer } else { light };
    }
}
dispatched!(fn blend_by(older: &[f32], newer: &[f32], elapsed: f32, log_floor: f32, out: &mut [f32]) = blend_body);
