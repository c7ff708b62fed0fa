//! The evaluator's light against rays: `light SCENE WIDTHxHEIGHT PIXELS [SECONDS]`.
//!
//! Both find the mean luminance of pixels at three times; rays by 987 samples of a lattice. Prints errors of
//! ln(Y / Y_ref + 1e-3) and the worst pixels.

use evis_decoupled::{Settings, luminance};
use evis_scene::{PixelLens, SceneState, source};
use evis_truth::Lattice;
use evis_truth::rays::{Options, Pinhole, RayCaster, SplitSum, TextureFilter, Textures};

struct Sample {
    found: f64,
    exact: f64,
    /// 0 inside surfaces, 1 at edges, 2 at shadows' edges.
    class: usize,
    what: String,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let usage = "usage: light SCENE WIDTHxHEIGHT PIXELS [SECONDS]";
    let (name, size) = (args.first().ok_or(usage)?, args.get(1).ok_or(usage)?);
    let (w, h) = size.split_once('x').ok_or(usage)?;
    let (width, height): (u32, u32) = (w.parse()?, h.parse()?);
    let count: usize = args.get(2).ok_or(usage)?.parse()?;
    let start: f64 = args.get(3).map_or(Ok(0.0), |v| v.parse())?;
    let scene = source::load(name, 0)?;
    let settings = Settings { size: Some((width, height)), ..Default::default() };
    let textures = Textures::new(&scene);
    let offsets = Lattice::Second.offsets(1);
    let mut all = Vec::new();
    for part in [0.011, 0.0437, 0.0891] {
        // A time at which pixels are evaluated.
        let t_s = ((start + part) * 1e6 / 16.0).round() * 16e-6;
        let picture = luminance(&scene, &settings, t_s * 1e6)?;
        let mut state = SceneState::default();
        scene.evaluate(t_s, &mut state);
        let options =
            Options { filter: TextureFilter::BaseLevel, shadows: true, split_sum: SplitSum::Tabulated };
        let caster = RayCaster::new(&scene, &state, &textures, options);
        let open = Options { shadows: false, ..options };
        let open = RayCaster::new(&scene, &state, &textures, open);
        let pinhole = Pinhole {
            world_from_camera: scene.world_from_camera(0, &state).ok_or("no pose")?,
            lens: PixelLens::new(&scene.cameras[0], settings.size),
        };
        for i in 0..count {
            let f = i as f64 + part * 1e4;
            let x = ((f * 0.754_877_666).fract() * f64::from(width)) as usize;
            let y = ((f * 0.569_840_291).fract() * f64::from(height)) as usize;
            let mut kinds = Vec::new();
            let sum: f64 = offsets
                .iter()
                .map(|o| {
                    let at = [x as f64 + 0.5 + o[0], y as f64 + 0.5 + o[1]];
                    let (light, kind) = caster.look(&pinhole, at);
                    if !kinds.contains(&kind) {
                        kinds.push(kind);
                    }
                    light
                })
                .sum();
            let shadowed =
                kinds.iter().any(|k| kinds.iter().any(|o| o.object == k.object && o.shadows != k.shadows));
            let objects = kinds.iter().any(|k| k.object != kinds[0].object || k.face != kinds[0].face);
            let class = if shadowed { 2 } else { usize::from(objects) };
            let middle = [x as f64 + 0.5, y as f64 + 0.5];
            let hit = caster.hit_at(&pinhole, middle);
            let node =
                hit.map_or("sky", |h| &scene.nodes[caster.geometry().matter().objects[h.object].node].name);
            let unshadowed = offsets
                .iter()
                .map(|o| open.look(&pinhole, [middle[0] + o[0], middle[1] + o[1]]).0)
                .sum::<f64>()
                / offsets.len() as f64;
            all.push(Sample {
                found: picture[y * width as usize + x],
                exact: sum / offsets.len() as f64,
                class,
                what: format!("({x}, {y}) at {t_s:.4} s: {node}, unshadowed {unshadowed:.3}"),
            });
        }
    }
    let y_ref = all.iter().map(|a| a.exact).sum::<f64>() / all.len() as f64 / 0.3;
    let error = |a: &Sample| (a.found / y_ref + 1e-3).ln() - (a.exact / y_ref + 1e-3).ln();
    for (class, what) in ["inside surfaces", "edges", "shadow edges"].into_iter().enumerate() {
        let mut errors: Vec<f64> = all.iter().filter(|a| a.class == class).map(|a| error(a).abs()).collect();
        errors.sort_by(f64::total_cmp);
        let n = errors.len().max(1);
        let at = |p: f64| errors.get(((n - 1) as f64 * p) as usize).copied().unwrap_or(0.0);
        let rms = (errors.iter().map(|e| e * e).sum::<f64>() / n as f64).sqrt();
        let bias = all.iter().filter(|a| a.class == class).map(error).sum::<f64>() / n as f64;
        println!(
            "{what:>16}: {:5} pixels, RMS {rms:.4}, median {:.4}, p90 {:.4}, p99 {:.4}, worst {:.3}, mean {bias:+.4}",
            errors.len(),
            at(0.5),
            at(0.9),
            at(0.99),
            at(1.0)
        );
    }
    all.sort_by(|a, b| error(b).abs().total_cmp(&error(a).abs()));
    for a in all.iter().take(24) {
        println!("  {:9.4} for {:9.4} ({:+.3}), class {}, {}", a.found, a.exact, error(a), a.class, a.what);
    }
    Ok(())
}
