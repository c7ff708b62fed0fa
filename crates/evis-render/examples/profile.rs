//! Where the time of a stream goes: `profile SCENE WIDTHxHEIGHT SAMPLES MILLISECONDS [noshadow|nolight|unlit]`.

use std::sync::Arc;

use evis_render::{Gpu, RunConfig, Simulator};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().collect();
    let mut scene = evis_render::scene::source::load(&args[1], 0)?;
    match args.get(5).map(String::as_str) {
        Some("noshadow") => scene.lights.iter_mut().for_each(|l| l.casts_shadow = false),
        Some("nolight") => scene.nodes.iter_mut().for_each(|n| n.light = None),
        Some("unlit") => {
            scene.materials.iter_mut().for_each(|m| m.model = evis_render::scene::ShadingModel::Unlit);
        }
        _ => {}
    }
    let (w, h) = args[2].split_once('x').ok_or("size as WxH")?;
    let config =
        RunConfig { size: Some((w.parse()?, h.parse()?)), samples: args[3].parse()?, ..Default::default() };
    let gpu = Gpu::open(None)?;
    let loaded = std::time::Instant::now();
    let mut simulator = Simulator::new(&gpu, Arc::new(scene), config)?;
    println!("prepared in {:.0} ms", loaded.elapsed().as_secs_f64() * 1e3);
    let warm = std::time::Instant::now();
    simulator.step(1)?;
    println!("first step {:.0} ms", warm.elapsed().as_secs_f64() * 1e3);
    let until = args[4].parse::<i64>()? * 1000;
    let packet = simulator.step(until)?;
    let t = packet.report.times;
    let instants = packet.report.instants.max(1) as f64;
    println!("{:?}", packet.report);
    println!(
        "{:.2} ms per instant (host {:.2}, wait {:.2}, pack {:.2})",
        t.total_ms / instants,
        t.host_ms / instants,
        t.device_wait_ms / instants,
        t.pack_ms / instants
    );
    Ok(())
}
