//! Events of an ideal sensor from a scene.

use std::sync::atomic::AtomicBool;

use evis_core::Event;
use evis_core::event::take_causes;
use evis_scene::{Scene, Variant};
use rayon::prelude::*;

use crate::Error;
use crate::run::device::Loaded;
use crate::run::pixels::{Pixels, Turn, follow};
use crate::run::settings::{Report, Settings};
use crate::scene::holes::Holes;
use crate::scene::tiles::{PIXELS, TILE};
use crate::scene::world::World;
use crate::shading::light::{Lighting, Shared};
use crate::signal::pixel::{Evaluator, UNITS, Work};
use crate::visibility::blocks::{Block, Blocks, Clock, blocks};
use crate::visibility::lists::Lists;

/// Events, and what they took.
pub struct Outcome {
    /// In canonical order.
    pub events: Vec<Event>,
    /// The `Y_ref` that they were made with.
    pub reference_luminance: f64,
    /// What it took.
    pub report: Report,
}

/// What `scene` makes an ideal sensor fire in [0, duration).
///
/// # Errors
/// A setting or a camera that cannot be used.
pub fn simulate(scene: &Scene, settings: &Settings) -> Result<Outcome, Error> {
    settings.check()?;
    let world = World::new(scene, settings.camera, settings.size)?;
    let shared = Shared::new(scene);
    let mut lighting = Lighting::new(&world, &shared);
    let end_us = (settings.start_us + settings.duration_us) as f64;
    let mut blocks = Blocks::new(&world, settings.start_us, settings.most_us(), settings.block_us);
    let first = blocks.peek();
    let seen = match settings.reference_luminance {
        Some(_) => None,
        None => Some(picture(&world, &mut lighting, first, first.start_us)?),
    };
    let measured = || seen.as_deref().map_or(1.0, reference_luminance);
    let reference = settings.reference_luminance.unwrap_or_else(measured);
    let mut pixels = Pixels::new((&world, 0), settings, reference, &[])?;
    let views = [pixels.own().clone()];
    let mut device = Loaded::open(settings.devices.as_ref(), (scene, &shared), &views)?;
    if let Some(seen) = &seen {
        pixels.begin(&world, seen, first.start_us);
    }
    let mut events = Vec::new();
    while blocks.start_us() < end_us
        && let Some(block) = blocks.pop()
    {
        let jumps_next = blocks.next_jumps();
        let (world, lighting, pixels) = (&world, &mut lighting, &mut pixels);
        let turn = Turn { world, lighting, pixels, block, jumps_next };
        let found = follow(vec![turn], device.as_mut(), &AtomicBool::new(false))?;
        events.extend(found.into_iter().flatten().flatten());
    }
    events.retain(|e| (0..settings.duration_us).contains(&e.t));
    // Blocks may meet within a microsecond.
    events.sort_by_key(Event::order);
    take_causes(&mut events);
    Ok(Outcome { events, reference_luminance: reference, report: pixels.report(&lighting) })
}

/// Mean luminance of every pixel at `t_us` of scene time (rounded to 1/3072 of a block), row by row: what [`simulate`] crosses thresholds with.
///
/// # Errors
/// As [`simulate`].
pub fn luminance(scene: &Scene, settings: &Settings, t_us: f64) -> Result<Vec<f64>, Error> {
    luminance_of(scene, None, settings, t_us)
}

/// As [`luminance`], in one of the scene's environments.
///
/// # Errors
/// As [`simulate`].
pub fn luminance_of(
    scene: &Scene,
    variant: Option<&Variant>,
    settings: &Settings,
    t_us: f64,
) -> Result<Vec<f64>, Error> {
    settings.check()?;
    let world = World::of_variant(
        scene,
        variant,
        settings.camera,
        settings.size,
        &Holes::of(scene, settings.size)?,
        &[],
    )?;
    let mut lighting = Lighting::new(&world, &Shared::new(scene));
    let length_us = world.block_us(settings.block_us);
    let length = length_us as f64;
    let from = (t_us / length).floor() * length;
    let around = blocks(scene, variant, from, from + length, length_us);
    let inside = around.into_iter().find(|b| (b.start_us..b.end_us).contains(&t_us));
    let block = inside.unwrap_or(Block { start_us: from, end_us: from + length, jump: false });
    picture(&world, &mut lighting, block, t_us)
}

/// Mean luminance of every pixel at `t_us`, which is in `block`, row by row.
///
/// # Errors
/// A camera without a pose.
pub(crate) fn picture(
    world: &World,
    lighting: &mut Lighting,
    block: Block,
    t_us: f64,
) -> Result<Vec<f64>, Error> {
    let mut clock = Clock::new(world, block);
    let lists = Lists::new(world, &mut clock)?;
    lighting.prepare(&mut clock, &block)?;
    let evaluator = Evaluator { world, lists: &lists, lighting, block };
    let part = (t_us - block.start_us) / block.length_us();
    let unit = (part.clamp(0.0, 1.0) * f64::from(UNITS)).round() as u32;
    let width = world.lens.width as usize;
    let mut out = vec![0.0; width * world.lens.height as usize];
    out.par_chunks_mut(width * TILE).enumerate().for_each(|(row, out)| {
        let mut work = Work::default();
        for (column, list) in lists.row(world, row).iter().enumerate() {
            let tile = &list.entries[..];
            evaluator.enter_tile(&mut work, list, [column, row]);
            let place = |pixel: usize| (column * TILE + pixel % TILE, pixel / TILE);
            let height = out.len() / width;
            let seen = world.tile([column, row]).pixels;
            let inside = |pixel: &usize| {
                seen >> *pixel & 1 == 1 && place(*pixel).0 < width && place(*pixel).1 < height
            };
            for pixel in (0..PIXELS).filter(inside) {
                evaluator.activity(&mut work, tile, pixel);
                evaluator.expect(&mut work, pixel, 1);
            }
            for pixel in (0..PIXELS).filter(inside) {
                let (x, y) = place(pixel);
                evaluator.enter_pixel(&mut work, pixel);
                out[y * width + x] = evaluator.luminance(&mut work, tile, unit);
            }
        }
    });
    Ok(out)
}

/// What sends less than this part of a picture's mean luminance is dark: what rounding leaves of areas that shadows cover.
const DARK: f64 = 1e-5;

/// `Y_ref` that brings the log-mean of what is lit in `picture` to 0.18.
pub(crate) fn reference_luminance(picture: &[f64]) -> f64 {
    let bright = || picture.iter().filter(|y| **y > 0.0 && y.is_finite());
    let mean = bright().sum::<f64>() / bright().count().max(1) as f64;
    let (sum, count) = bright()
        .filter(|y| **y > DARK * mean)
        .fold((0.0, 0_u64), |(sum, count), y| (sum + y.ln(), count + 1));
    let reference = (sum / count.max(1) as f64).exp() / 0.18;
    if count > 0 && reference.is_finite() && reference > 0.0 { reference } else { 1.0 }
}
