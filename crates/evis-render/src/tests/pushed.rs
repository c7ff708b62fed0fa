//! The emulator's warp of pushed keyframes is the splat of the engine: both equal one twin.

use evis_core::WarpConfig;
use evis_core::emulator::Filter;
use evis_core::emulator::parts::{Gap, Pictures, Scratch, Side};

use crate::cpu::splat::{Instant, Source, instant, resolve};
use crate::splat_config::{Carrier, Motion, SplatConfig};

const CANVAS: [usize; 2] = [61, 37];
const MARGIN: u32 = 4;

fn noise(i: u32) -> f32 {
    let h = (i ^ 0x5bd1_e995).wrapping_mul(0x9E37_79B9);
    let h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    ((h ^ (h >> 13)) >> 8) as f32 / (1u32 << 24) as f32
}

/// Two surfaces, one before the other, that move in different ways; some pixels are not known.
fn sources(key: u32) -> Vec<Source> {
    (0..(CANVAS[0] * CANVAS[1]) as u32)
        .map(|i| {
            let (x, y) = (i % CANVAS[0] as u32, i / CANVAS[0] as u32);
            let near = (18 + 4 * key..34 + 4 * key).contains(&x) && (9..25).contains(&y);
            let motion = if near { [4.3, 0.4] } else { [-1.7 + 0.01 * y as f32, 0.6 * noise(i)] };
            let motion = if i % 97 == 5 { [f32::NAN, 0.0] } else { motion };
            Source {
                luminance: if i % 89 == 3 { -1.0 } else { 0.05 + noise(i * 3 + key) },
                nearness: if near { 1.1 } else { 0.3 + 0.001 * x as f32 },
                forward: motion,
                backward: motion.map(|d| -d),
            }
        })
        .collect()
}

#[test]
fn the_emulators_warp_is_the_engines_splat() {
    let size = CANVAS.map(|n| n - 2 * MARGIN as usize);
    let both = [sources(0), sources(1)];
    let base = SplatConfig { margin: MARGIN, motion: Motion::Linear, ..SplatConfig::default() };
    let paper = SplatConfig { margin: MARGIN, ..SplatConfig::evis_paper(30.0, 8) };
    let configs = [
        base,
        SplatConfig { blend: false, ..base },
        SplatConfig { blend: false, nearest: false, ..base },
        SplatConfig { carrier: Carrier::Colour, ..base },
        paper,
    ];
    for config in configs {
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
            planes.each_ref().map(|(light, nearness, motion)| Side { light, nearness, motion });
        let warp = WarpConfig {
            margin: MARGIN,
            carrier: config.carrier,
            filter: Filter::Bilinear,
            nearest: config.nearest,
            blend: config.blend,
            dilate: config.dilate,
            sharpness: config.sharpness,
            hole_below: config.hole_below,
            fill: config.fill,
            ..WarpConfig::default()
        };
        let pictures = Pictures { size, canvas: CANVAS, log_floor: 1e-3, reference_luminance: 1.0 };
        let gap = Gap::new(&warp, &pictures, older, newer);
        let (mut scratch, mut got) = (Scratch::default(), Vec::new());
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
            let sides = instant([&both[0], &both[1]], &at, &config);
            let wanted = resolve(&sides, &at, &config);
            let differs = |(got, wanted): (&f32, &f32)| match *wanted < 0.0 {
                true => !got.is_nan(),
                false => got.is_nan() || (got - wanted).abs() > 2e-5 * (wanted + 1e-3),
            };
            // A weight of colours may round to the other side where exponentials differ in their last place.
            let apart = got.iter().zip(&wanted).filter(|pair| differs(*pair)).count();
            assert!(apart <= got.len() / 200, "{config:?} at {elapsed}: {apart} of {}", got.len());
            if config.carrier == Carrier::Index {
                assert_eq!(apart, 0, "{config:?} at {elapsed}");
            }
            unknown += got.iter().filter(|light| light.is_nan()).count();
            // Canary: another instant is another picture.
            gap.instant(elapsed + 0.1, &mut scratch, &mut got);
            assert!(got.iter().zip(&wanted).filter(|pair| differs(*pair)).count() > got.len() / 2);
        }
        assert_eq!(unknown > 0, config.fill.is_none(), "{config:?}");
    }
}
