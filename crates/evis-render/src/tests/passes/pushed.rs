//! The emulator's warp of pushed keyframes is that of the engine, whose twin both equal.

use evis_core::WarpVariant;
use evis_core::emulator::parts::{Gap, Pictures, Scratch, Side};

use crate::cpu::splat::Instant;

use crate::cpu::splat::Source;

use crate::cpu::splat::instant;

use crate::cpu::splat::resolve;

const CANVAS: [usize; 2] = [61, 37];
const MARGIN: u32 = 4;

fn noise(i: u32) -> f32 {
    let h = (i ^ 0x5bd1_e995).wrapping_mul(0x9E37_79B9);
    let h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    ((h ^ (h >> 13)) >> 8) as f32 / (1u32 << 24) as f32
}

/// Two surfaces, one before the other, that move in different ways; some pixels are not known. The light of each is noise, or
/// linear in x and y.
fn sources(key: u32, linear: bool) -> Vec<Source> {
    (0..(CANVAS[0] * CANVAS[1]) as u32)
        .map(|i| {
            let (x, y) = (i % CANVAS[0] as u32, i / CANVAS[0] as u32);
            let near = (18 + 4 * key..34 + 4 * key).contains(&x) && (9..25).contains(&y);
            let motion = if near { [4.3, 0.4] } else { [-1.7 + 0.01 * y as f32, 0.6 * noise(i)] };
            // Neither knows it.
            let blank = (44..48).contains(&x) && (10..14).contains(&y);
            let motion = if i % 97 == 5 { [f32::NAN, 0.0] } else { motion };
            let light = match linear {
                true => {
                    0.1 + 0.004 * x as f32
                        + 0.002 * y as f32
                        + 0.05 * key as f32
                        + if near { 0.5 } else { 0.0 }
                }
                false => 0.05 + noise(i * 3 + key),
            };
            Source {
                luminance: if i % 89 == 3 || blank { -1.0 } else { light },
                nearness: if near { 1.1 } else { 0.3 + 0.001 * x as f32 },
                forward: motion,
                backward: motion.map(|d| -d),
            }
        })
        .collect()
}

#[test]
fn the_emulators_warp_is_the_engines() {
    let size = CANVAS.map(|n| n - 2 * MARGIN as usize);
    for variant in [WarpVariant::Splat, WarpVariant::EvisPaper] {
        // The emulator reads light between pixels by a cubic, the engine by lines: the same where light is linear.
        let both = [0, 1].map(|key| sources(key, variant == WarpVariant::Splat));
        let planes = both.each_ref().map(|sources| {
            let motion: fn(&Source) -> [f32; 2] =
                if std::ptr::eq(sources, &both[0]) { |s| s.forward } else { |s| s.backward };
            (
                sources.iter().map(|s| s.luminance).collect::<Vec<_>>(),
                sources.iter().map(|s| s.nearness).collect::<Vec<_>>(),
                sources.iter().map(motion).collect::<Vec<_>>(),
            )
        });
        let [older, newer] =
            planes.each_ref().map(|(light, nearness, motion)| Side { light, nearness, motion, bends: &[] });
        let pictures = Pictures { size, canvas: CANVAS, log_floor: 1e-3, reference_luminance: 1.0 };
        let gap = Gap::new(variant, &pictures, older, newer);
        let (mut scratch, mut got) = (Scratch::default(), Vec::new());
        // Colours of the engine are added up in steps of weight and of a pixel's 1024th part, those of the emulator in f64.
        let slack = if variant == WarpVariant::Splat { 2e-5 } else { 6e-3 };
        let mut unknown = 0;
        for elapsed in [0.125, 0.5, 0.8] {
            gap.instant(elapsed, &mut scratch, &mut got);
            let at = Instant {
                size,
                canvas: CANVAS,
                margin: MARGIN as i32,
                elapsed,
                log_floor: 1e-3,
                brightest: 256.0,
            };
            let sides = instant([&both[0], &both[1]], &at, variant);
            let wanted = resolve(&sides, &at, variant);
            let differs = |(got, wanted): (&f32, &f32)| match *wanted < 0.0 {
                true => !got.is_nan(),
                false => got.is_nan() || (got - wanted).abs() > slack * (wanted + 1e-3),
            };
            // Where weights are small, a step of one is much.
            let apart = got.iter().zip(&wanted).filter(|pair| differs(*pair)).count();
            assert!(apart <= got.len() / 200, "{variant:?} at {elapsed}: {apart} of {}", got.len());
            if variant == WarpVariant::Splat {
                assert_eq!(apart, 0, "{variant:?} at {elapsed}");
            }
            unknown += got.iter().filter(|light| light.is_nan()).count();
            // Canary: another instant is another picture.
            gap.instant(elapsed + 0.1, &mut scratch, &mut got);
            assert!(got.iter().zip(&wanted).filter(|pair| differs(*pair)).count() > got.len() / 2);
        }
        assert_eq!(unknown > 0, variant == WarpVariant::Splat, "{variant:?}");
    }
}

/// A bright square of 10 pixels that moves by (x, y) = `motion(pixel)` in a gap, before a dark ground that stands; the newer
/// keyframe knows nothing.
fn square(motion: impl Fn([f32; 2]) -> [f32; 2]) -> [Vec<Source>; 2] {
    let older = (0..CANVAS[0] * CANVAS[1]).map(|i| {
        let (x, y) = (i % CANVAS[0], i / CANVAS[0]);
        if (20..30).contains(&x) && (12..22).contains(&y) {
            Source {
                luminance: 1.0,
                nearness: 1.0,
                forward: motion([x as f32, y as f32]),
                ..Source::default()
            }
        } else {
            Source { luminance: 0.1, nearness: 0.3, ..Source::default() }
        }
    });
    let older: Vec<_> = older.collect();
    let newer = vec![Source { luminance: -1.0, ..Source::default() }; older.len()];
    [older, newer]
}

/// The instant halfway: luminance per pixel, negative where unknown.
fn halfway(both: &[Vec<Source>; 2]) -> Vec<f32> {
    let size = CANVAS.map(|n| n - 2 * MARGIN as usize);
    let variant = WarpVariant::Splat;
    let at = Instant {
        size,
        canvas: CANVAS,
        margin: MARGIN as i32,
        elapsed: 0.5,
        log_floor: 1e-3,
        brightest: 256.0,
    };
    resolve(&instant([&both[0], &both[1]], &at, variant), &at, variant)
}

#[test]
fn outlines_neither_grow_nor_vanish_between_keyframes() {
    for tenths in 0..100 {
        let f = [tenths % 10, tenths / 10].map(|n| n as f32 / 10.0);
        let light = halfway(&square(|_| f.map(|f| 2.0 * f)));
        let shown = light.iter().filter(|y| **y > 0.9).count();
        // A pixel is the square's where the square's pixel covers its centre: as many as in the keyframe, at any offset,
        // half a pixel both ways included.
        assert_eq!(shown, 100, "{f:?}");
        let unknown = light.iter().filter(|y| **y < 0.0).count();
        assert!(unknown <= 19, "{f:?}: {unknown} unknown, where the square was at most");
    }
}

#[test]
fn no_crack_opens_where_a_surface_grows() {
    let light = halfway(&square(|[x, y]| [x - 25.0, y - 17.0].map(|d| 1.2 * d)));
    let width = CANVAS[0] - 2 * MARGIN as usize;
    let rows: Vec<&[f32]> = light.chunks_exact(width).collect();
    let shown: Vec<_> = rows.iter().filter(|row| row.iter().any(|y| *y > 0.9)).collect();
    // 10 pixels, 1.6 times as far apart halfway; less half a pixel of the last at each side.
    assert!((14..=16).contains(&shown.len()), "{}", shown.len());
    for row in shown {
        let first = row.iter().position(|y| *y > 0.9).unwrap();
        let last = row.iter().rposition(|y| *y > 0.9).unwrap();
        assert!((14..=16).contains(&(last + 1 - first)), "{first} {last}");
        assert!(row[first..=last].iter().all(|y| *y > 0.9), "no hole and no ground within");
    }
}
