//! Twin of `splat/*.wgsl`: the same algorithm in f32 and integers, one pixel after another, one view.

use evis_core::WarpVariant;

/// Parts of a pixel in which positions are counted.
pub const SUBPIXELS: i32 = 1024;

const WEIGHT_STEPS: f32 = 4096.0;
const LIGHT_HALF_BITS: u32 = 19;
const LIGHT_HALF: f32 = 524_288.0;
const WEIGHT_UNIT: f32 = 1.0 / 256.0;

const SHARPNESS: f32 = 12.0;

const HOLE_WEIGHT: f32 = 1e-4 * WEIGHT_STEPS;

const SAME_SURFACE: f32 = 0.95;

/// Bits of 16 384 pixels.
const MOTION_LIMIT_BITS: u32 = 0x4680_0000;

const NOT_A_NUMBER: u32 = 0x7F80_0000;

/// A keyframe pixel, as the splat passes read it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Source {
    /// Negative: unknown.
    pub luminance: f32,
    /// 1 / (depth + 1e-3).
    pub nearness: f32,
    /// Pixels to where it is at the next keyframe.
    pub forward: [f32; 2],
    /// Pixels to where it is at the last one.
    pub backward: [f32; 2],
}

/// A keyframe's pictures, row-major, and its width.
#[derive(Clone, Debug, Default)]
pub struct Pictures {
    /// Pixels per row.
    pub width: usize,
    /// Luminance, a picture per sample.
    pub samples: Vec<Vec<f32>>,
    /// 1 / depth.
    pub inverse_depth: Vec<f32>,
    /// Flow to the next keyframe, and to the last.
    pub flow: Vec<[f32; 4]>,
}

/// One instant between two keyframes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instant {
    /// Target pixels: the sensor's.
    pub size: [usize; 2],
    /// Keyframe pixels.
    pub canvas: [usize; 2],
    /// Keyframe pixels beyond each border.
    pub margin: i32,
    /// Part of the gap that has passed.
    pub elapsed: f32,
    /// Added to luminance before a logarithm.
    pub log_floor: f32,
    /// Most light that colours can add up.
    pub brightest: f32,
}

/// What a side adds up at each target pixel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sums {
    /// Bits of the nearest 1 / depth, plus 1; 0 for none.
    pub keys: Vec<u32>,
    /// Weight, or index word.
    pub words: Vec<u32>,
    /// Light times weight.
    pub light: Vec<u64>,
}

/// Where a source is: position in [`SUBPIXELS`] with a bit below each coordinate, whether it reaches beyond the pixel that its
/// centre is in; depth key.
pub type Placed = Option<([i32; 2], u32)>;

fn inverse_depth(x: f32) -> f32 {
    match x.to_bits() {
        NOT_A_NUMBER => 1e6,
        bits if bits < NOT_A_NUMBER => x.min(1e6),
        _ => 0.0,
    }
}

/// `splat/prepare.wgsl`.
pub fn prepare(pictures: &Pictures) -> Vec<Source> {
    (0..pictures.inverse_depth.len())
        .map(|i| {
            let light = || pictures.samples.iter().map(|s| s[i]);
            let known = light().all(|y| y.to_bits() & NOT_A_NUMBER != NOT_A_NUMBER);
            let sum: f32 = light().map(|y| y.clamp(0.0, 1e30)).fold(0.0, |a, b| a + b);
            let depth = inverse_depth(pictures.inverse_depth[i]);
            let [fx, fy, bx, by] = pictures.flow[i];
            Source {
                luminance: if known { (sum * (1.0 / pictures.samples.len() as f32)).min(1e30) } else { -1.0 },
                nearness: depth / (1.0 + 1e-3 * depth),
                forward: [fx, fy],
                backward: [bx, by],
            }
        })
        .collect()
}

/// What `splat/prepare.wgsl` counts: pixels of `sources` above `brightest`, and their largest luminance, 0 where there are none.
pub fn clipped(sources: &[Source], brightest: f32) -> (u32, f32) {
    let above = sources.iter().map(|s| s.luminance).filter(|luminance| *luminance > brightest);
    above.fold((0, 0.0), |(pixels, largest), luminance| (pixels + 1, largest.max(luminance)))
}

/// The four pixels around a position, x fastest, with their weights in 1 / [`SUBPIXELS`]²; `None` outside.
fn taps(q: [i32; 2], size: [usize; 2]) -> [Option<(usize, u32)>; 4] {
    let base = q.map(|v| v >> 10);
    let f = q.map(|v| (v & (SUBPIXELS - 1)) as u32);
    let g = f.map(|v| SUBPIXELS as u32 - v);
    let weights = [g[0] * g[1], f[0] * g[1], g[0] * f[1], f[0] * f[1]];
    std::array::from_fn(|i| {
        let p = [base[0] + (i as i32 & 1), base[1] + (i as i32 >> 1)];
        let inside = p.iter().zip(size).all(|(&p, n)| p >= 0 && (p as usize) < n);
        inside.then(|| (p[1] as usize * size[0] + p[0] as usize, weights[i]))
    })
}

/// The position of a placed source.
pub fn position(place: [i32; 2]) -> [i32; 2] {
    place.map(|v| v >> 1)
}

/// Whether a coordinate is nearer to the second of the two pixels around it.
fn is_past_half(q: i32) -> bool {
    q & (SUBPIXELS - 1) >= SUBPIXELS / 2
}

/// The pixels that a placed source reaches, with their weights; `None` for the others.
fn reached(place: [i32; 2], size: [usize; 2]) -> [Option<(usize, u32)>; 4] {
    let q = position(place);
    let wanted = |axis: usize, second: bool| place[axis] & 1 == 1 || is_past_half(q[axis]) == second;
    let taps = taps(q, size);
    std::array::from_fn(|i| {
        taps[i].filter(|(_, weight)| *weight > 0 && wanted(0, i & 1 == 1) && wanted(1, i >> 1 == 1))
    })
}

/// Whether an index reaches beyond the pixel that its centre is in, see `splat/place.wgsl`.
fn reaches(sources: &[Source], i: usize, q: [i32; 2], canvas: [usize; 2]) -> [bool; 2] {
    let pixel = [(i % canvas[0]) as i32, (i / canvas[0]) as i32];
    std::array::from_fn(|axis| {
        let mut beside = pixel;
        beside[axis] += if is_past_half(q[axis]) { -1 } else { 1 };
        let inside = beside.iter().zip(canvas).all(|(&p, n)| p >= 0 && (p as usize) < n);
        let (own, other) =
            (sources[i].nearness, || sources[beside[1] as usize * canvas[0] + beside[0] as usize]);
        inside && own.min(other().nearness) >= own.max(other().nearness) * SAME_SURFACE
    })
}

fn is_hole(variant: WarpVariant, word: u32) -> bool {
    match variant {
        WarpVariant::EvisPaper => (word as f32) < HOLE_WEIGHT,
        WarpVariant::Splat => word == 0,
    }
}

fn nearness_of(key: u32) -> f32 {
    f32::from_bits(key - 1)
}

/// `splat/place.wgsl` with linear motion, side 0 (older) or 1; `other` is the side whose holes alone count.
pub fn place(
    sources: &[Source],
    side: usize,
    at: &Instant,
    variant: WarpVariant,
    other: Option<&Sums>,
    sums: &mut Sums,
) -> Vec<Placed> {
    let pixels = at.size[0] * at.size[1];
    *sums = Sums { keys: vec![0; pixels], words: vec![0; pixels], light: vec![0; pixels] };
    let moved = if side == 0 { at.elapsed } else { 1.0 - at.elapsed };
    sources
        .iter()
        .enumerate()
        .map(|(i, source)| {
            let motion = if side == 0 { source.forward } else { source.backward };
            let is_motion = motion.iter().all(|d| d.to_bits() & 0x7FFF_FFFF < MOTION_LIMIT_BITS);
            if !is_motion || source.luminance < 0.0 {
                return None;
            }
            let pixel = [(i % at.canvas[0]) as i32, (i / at.canvas[0]) as i32];
            let q: [i32; 2] = std::array::from_fn(|axis| {
                let d = (motion[axis] * moved * SUBPIXELS as f32 + 0.5).floor() as i32;
                (pixel[axis] - at.margin) * SUBPIXELS + d
            });
            let reaches = match variant {
                WarpVariant::EvisPaper => [true; 2],
                WarpVariant::Splat => reaches(sources, i, q, at.canvas),
            };
            let place = std::array::from_fn(|axis| q[axis] * 2 + i32::from(reaches[axis]));
            let key = source.nearness.max(0.0).to_bits() + 1;
            let mut seen = false;
            for (p, _) in reached(place, at.size).into_iter().flatten() {
                if other.is_none_or(|o| is_hole(variant, o.words[p])) {
                    sums.keys[p] = sums.keys[p].max(key);
                    seen = true;
                }
            }
            seen.then_some((place, key))
        })
        .collect()
}

/// A power of two above the brightest of `sources`.
fn light_scale(sources: &[Source], at: &Instant) -> f32 {
    let bits = largest(sources, |s| s.luminance).to_bits();
    let within = bits.clamp(0x0080_0000, at.brightest.to_bits().max(0x0080_0000));
    f32::from_bits(((within >> 23) + 1) << 23)
}

/// Largest 1 / depth that the sensor itself sees.
fn nearest(sources: &[Source], at: &Instant) -> f32 {
    let margin = at.margin as usize;
    let rows = sources.chunks_exact(at.canvas[0]).skip(margin).take(at.size[1]);
    rows.map(|row| largest(&row[margin..margin + at.size[0]], |s| s.nearness)).fold(0.0, f32::max)
}

fn largest(sources: &[Source], of: impl Fn(&Source) -> f32) -> f32 {
    sources.iter().map(of).fold(0.0, f32::max)
}

/// `splat/accumulate.wgsl`.
pub fn accumulate(
    sources: &[Source],
    placed: &[Placed],
    at: &Instant,
    other: Option<&Sums>,
    sums: &mut Sums,
) {
    let scale = light_scale(sources, at);
    let sharpness = SHARPNESS / nearest(sources, at).max(1e-30);
    for (source, placed) in sources.iter().zip(placed) {
        let Some((place, key)) = *placed else { continue };
        let halves = source.luminance.min(at.brightest) / scale * LIGHT_HALF;
        let high = halves as u32;
        let low = ((halves - high as f32) * LIGHT_HALF + 0.5) as u32;
        let light = u64::from(low) + (u64::from(high) << LIGHT_HALF_BITS);
        for (p, bilinear) in taps(position(place), at.size).into_iter().flatten() {
            if bilinear == 0 || other.is_some_and(|o| !is_hole(WarpVariant::EvisPaper, o.words[p])) {
                continue;
            }
            let front = nearness_of(sums.keys[p]);
            let importance = ((nearness_of(key) - front).min(0.0) * sharpness).exp();
            let weight = (bilinear as f32 * WEIGHT_UNIT * importance + 0.5) as u32;
            sums.words[p] = sums.words[p].wrapping_add(weight);
            sums.light[p] = sums.light[p].wrapping_add(u64::from(weight) * light);
        }
    }
}

/// `splat/index.wgsl`; returns the bits that an index takes.
pub fn index(placed: &[Placed], at: &Instant, sums: &mut Sums) -> u32 {
    let bits = u32::BITS - (placed.len() as u32).leading_zeros();
    let most = (1u32 << (32 - bits)) - 1;
    for (source, placed) in placed.iter().enumerate() {
        let Some((place, key)) = *placed else { continue };
        for (p, weight) in reached(place, at.size).into_iter().flatten() {
            if nearness_of(key) >= nearness_of(sums.keys[p]) * SAME_SURFACE {
                let near = ((weight as f32 * (most as f32 / 1_048_576.0)) as u32).clamp(1, most);
                sums.words[p] = sums.words[p].max(near << bits | source as u32);
            }
        }
    }
    bits
}

/// Light of the splatted source, read between its keyframe's pixels.
fn gathered(sources: &[Source], placed: &[Placed], at: &Instant, p: usize, number: usize) -> f32 {
    let Some((place, _)) = placed[number] else { return -1.0 };
    let q = position(place);
    let own = sources[number];
    let p = [(p % at.size[0]) as i32, (p / at.size[0]) as i32];
    let source = [(number % at.canvas[0]) as i32, (number / at.canvas[0]) as i32];
    let from: [f32; 2] = std::array::from_fn(|a| (p[a] * SUBPIXELS - q[a]) as f32 * (1.0 / SUBPIXELS as f32));
    let f = from.map(|v| v - v.floor());
    (0..4)
        .map(|i| {
            let corner = [i & 1, i >> 1];
            let beside: [i32; 2] = std::array::from_fn(|a| {
                (source[a] + from[a].floor() as i32 + corner[a]).clamp(0, at.canvas[a] as i32 - 1)
            });
            let other = sources[beside[1] as usize * at.canvas[0] + beside[0] as usize];
            let apart = own.nearness.min(other.nearness) < own.nearness.max(other.nearness) * SAME_SURFACE;
            let light = if apart || other.luminance < 0.0 { own.luminance } else { other.luminance };
            let weight = |a: usize| if corner[a] == 1 { f[a] } else { 1.0 - f[a] };
            weight(0) * weight(1) * light
        })
        .fold(0.0, |a, b| a + b)
}

/// One side of an instant: its sources, where they are, what they add up to.
pub struct Side<'a> {
    /// Of its keyframe.
    pub sources: &'a [Source],
    /// At the instant.
    pub placed: Vec<Placed>,
    /// At the target's pixels.
    pub sums: Sums,
}

/// `splat/resolve.wgsl` for sensor pixels of one target pixel each: luminance, negative where unknown.
pub fn resolve(sides: &[Side<'_>; 2], at: &Instant, variant: WarpVariant) -> Vec<f32> {
    let seen = |side: &Side<'_>, p: usize| -> Option<(f32, f32)> {
        let (key, word) = (side.sums.keys[p], side.sums.words[p]);
        if key == 0 || word == 0 || is_hole(variant, word) {
            return None;
        }
        let luminance = match variant {
            WarpVariant::EvisPaper => {
                let scale = light_scale(side.sources, at);
                let light =
                    (side.sums.light[p] >> 32) as f32 * 4_294_967_296.0 + side.sums.light[p] as u32 as f32;
                (light / word as f32 * (1.0 / LIGHT_HALF) * (1.0 / LIGHT_HALF) * scale).min(scale)
            }
            WarpVariant::Splat => {
                let bits = u32::BITS - (side.placed.len() as u32).leading_zeros();
                let number = (word & ((1 << bits) - 1)) as usize;
                gathered(side.sources, &side.placed, at, p, number)
            }
        };
        Some((luminance, nearness_of(key)))
    };
    let splat = variant == WarpVariant::Splat;
    (0..at.size[0] * at.size[1])
        .map(|p| match (seen(&sides[0], p), seen(&sides[1], p)) {
            (None, None) if splat => -1.0,
            (None, None) => 0.0,
            (Some((only, _)), None) | (None, Some((only, _))) => only,
            (Some(older), Some(newer)) => {
                if splat && newer.1 < older.1 * SAME_SURFACE {
                    older.0
                } else if !splat || older.1 < newer.1 * SAME_SURFACE {
                    newer.0
                } else {
                    let [a, b] = [older.0, newer.0].map(|l| (l + at.log_floor).ln());
                    ((a + (b - a) * at.elapsed).exp() - at.log_floor).max(0.0)
                }
            }
        })
        .collect()
}

/// An instant from the sources of its older and newer keyframe, moved linearly.
pub fn instant<'a>(sources: [&'a [Source]; 2], at: &Instant, variant: WarpVariant) -> [Side<'a>; 2] {
    let carry = |side: usize, other: Option<&Sums>| {
        let sources = sources[side];
        let mut sums = Sums::default();
        let placed = place(sources, side, at, variant, other, &mut sums);
        match variant {
            WarpVariant::EvisPaper => accumulate(sources, &placed, at, other, &mut sums),
            WarpVariant::Splat => {
                index(&placed, at, &mut sums);
            }
        }
        Side { sources, placed, sums }
    };
    let newer = carry(1, None);
    let older = carry(0, (variant == WarpVariant::EvisPaper).then_some(&newer.sums));
    [older, newer]
}
