//! Streams a built-in scene for a tenth of a second and counts its events: the ten lines of the README.

use std::sync::Arc;

use evis_render::{EngineError, Gpu, RunConfig, Simulator};

fn main() -> Result<(), EngineError> {
    let name = std::env::args().nth(1).unwrap_or_else(|| "spinner".into());
    let scene = Arc::new(evis_render::scene::builtin::load(&name, 0)?);
    let gpu = Gpu::open(None)?;
    let simulator = Simulator::new(&gpu, scene, RunConfig::default())?;
    for packet in simulator.stream(100_000, 10_000)? {
        let packet = packet?;
        let on = packet.views[0].events.iter().filter(|e| e.p == 1).count();
        println!("{} us: {} events, {on} of them ON", packet.end_us, packet.report.events);
    }
    Ok(())
}
