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
    simulate_resting(scene, settings, true)
}

/// The same; tiles of which nothing changes are left out if they may `rest`.
fn simulate_resting(scene: &Scene, settings: &Settings, rests: bool) -> Result<Outcome, Error> {
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
    pixels.set_rests(rests);
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
    lighting.prepare(&mut clock)?;
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

#[cfg(test)]
mod tests {
    use evis_core::SensorConfig;
    use evis_scene::motion::{Curve, Interpolation, Path, WaveShape, Waveform};
    use evis_scene::primitive::Shape;
    use evis_scene::{Material, Motion, Primitive, ShadingModel, Trs};
    use glam::{DMat4, DVec3};

    use super::*;
    use crate::scene::testing::{add, numbers, solids};

    /// Still solids on a floor before a camera that stands, two that cross the picture, or throw a shadow into it from beside it, and one
    /// that shines by itself and is elsewhere at once.
    fn crossed(seed: u32) -> Scene {
        let mut scene = solids();
        let mut next = numbers(seed.wrapping_mul(747_796_405).wrapping_add(1));
        let mut between = |low: f64, high: f64| low + (high - low) * next();
        let mut movers = 0;
        for node in &mut scene.nodes {
            let Motion::Path(path) = &node.motion else { continue };
            let (Path::Spin { start, .. } | Path::ConstantVelocity { start, .. }) = **path else { continue };
            movers += usize::from(node.mesh.is_some());
            node.motion = if node.mesh.is_some() && movers <= 2 {
                let side = if between(-1.0, 1.0) < 0.0 { -1.0 } else { 1.0 };
                let place = DVec3::new(side * between(1.0, 2.5), between(0.2, 1.2), between(-1.5, 0.5));
                let velocity = DVec3::new(-side * between(3.0, 12.0), between(-0.3, 0.3), between(-2.0, 2.0));
                let start = Trs { translation: place, ..start };
                Motion::Path(std::sync::Arc::new(Path::ConstantVelocity { start, velocity }))
            } else {
                Motion::Fixed(DMat4::from_scale_rotation_translation(
                    start.scale,
                    start.rotation,
                    start.translation,
                ))
            };
        }
        let material = scene.materials.len();
        scene.materials.push(Material { model: ShadingModel::Unlit, ..Material::default() });
        let step = Curve {
            times: vec![0.0, between(0.05, 0.1), between(0.11, 0.15)],
            values: (0..3).flat_map(|_| [between(-0.8, 0.8), between(0.2, 1.0), -0.5]).collect(),
            width: 3,
            interpolation: Interpolation::Step,
        };
        let motion =
            Motion::Animated { rest: Trs::default(), translation: Some(step), rotation: None, scale: None };
        let shape = Shape::Box { size: [0.2; 3] }.build(None, [1.0; 2]).unwrap();
        add(&mut scene, Primitive { material, ..shape }, motion);
        if seed.is_multiple_of(3) {
            let (shape, frequency_hz) = (WaveShape::Pwm { duty: 0.3 }, between(8.0, 20.0));
            let wave = Waveform { shape, frequency_hz, phase: 0.0, low: 0.2, high: 1.0 };
            scene.materials[1].emissive = [0.5; 3];
            scene.materials[1].emission_waveform = Some(wave);
        }
        scene
    }

    #[test]
    fn tiles_that_rest_change_no_event() {
        let mut refractory = SensorConfig::default();
        refractory.refractory.period_us = 200;
        let sensors = [
            SensorConfig::default(),
            refractory,
            SensorConfig::preset("gen4-like").unwrap(),
            SensorConfig::preset("v2e").unwrap(),
        ];
        let (mut rested, mut all, mut events) = (0, 0, 0);
        for seed in 0..4 {
            let scene = crossed(seed);
            let sensor = sensors[seed as usize % sensors.len()].clone();
            let settings =
                Settings { sensor, size: Some((48, 40)), duration_us: 180_000, ..Settings::default() };
            let [left_out, followed] =
                [true, false].map(|rests| simulate_resting(&scene, &settings, rests).unwrap());
            assert_eq!(left_out.events, followed.events, "{seed}");
            assert_eq!(left_out.report.pixel_blocks, followed.report.pixel_blocks);
            assert_eq!(left_out.report.entries, followed.report.entries);
            assert_eq!(followed.report.resting, 0);
            rested += left_out.report.resting;
            all += left_out.report.pixel_blocks;
            events += left_out.events.len();
        }
        assert!(
            5 * rested > all && 10 * rested < 9 * all && events > 2000,
            "{rested} of {all} rest, {events} events"
        );
    }
}
