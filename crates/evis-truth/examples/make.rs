//! Times a truth: `make SCENE WIDTHxHEIGHT MILLISECONDS PIXELS [second]`.

use std::time::Instant;

use evis_truth::{Lattice, PixelChoice, TruthSettings, truth};

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let scene = evis_scene::source::load(&args[0], 0).expect("a scene");
    let (w, h) = args[1].split_once('x').expect("WxH");
    let settings = TruthSettings {
        size: Some((w.parse().expect("W"), h.parse().expect("H"))),
        duration_us: args[2].parse::<i64>().expect("ms") * 1000,
        pixels: PixelChoice::Count(args[3].parse().expect("pixels")),
        lattice: if args.len() > 4 { Lattice::Second } else { Lattice::First },
        ..Default::default()
    };
    let started = Instant::now();
    let truth = truth(&scene, &settings, &|_| true).expect("a truth");
    let mut regions = [0; 4];
    for r in &truth.event_region {
        regions[*r as usize] += 1;
    }
    println!(
        "{} px, {} events, regions {regions:?}, {:.1} s\n{}",
        truth.pixels.len(),
        truth.events.len(),
        started.elapsed().as_secs_f64(),
        truth.provenance
    );
}
