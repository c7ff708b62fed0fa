//! A plain loop on this thread: a function is called for every packet, and ends the run when it has seen enough.
//!
//! `cargo run --release --workspace --locked --example callback`

use std::ops::ControlFlow;
use std::sync::Arc;

use evis_render::prelude::*;

/// Runs it.
pub fn main() -> Result<(), EngineError> {
    let scene = Arc::new(scene::builtin::load("spinner", 0)?);
    let gpu = Gpu::open(None)?;
    let config = RunConfig { size: Some((160, 120)), ..RunConfig::default() };
    let mut simulator = Simulator::new(&gpu, scene, config)?;

    let mut on_event = {
        let mut per_polarity = [0_u64; 2];
        move |event: &Event| {
            per_polarity[usize::from(event.p == 1)] += 1;
            per_polarity
        }
    };
    let end_us = simulator.run_until(1_000_000, 5_000, |packet| {
        let Some([off, on]) = packet.views[0].events.iter().map(&mut on_event).last() else {
            return ControlFlow::Continue(());
        };
        println!("{} us: {off} OFF and {on} ON events so far", packet.end_us);
        if off + on < 500 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    })?;
    assert_eq!(end_us, simulator.now_us());
    // A run that was ended goes on where it was.
    let packet = simulator.step(end_us + 5_000)?;
    println!("{} us: {} more", packet.end_us, packet.views[0].events.len());
    Ok(())
}
