//! The engine's stages one by one, for `benches/`. Hidden: no part of the public interface.

use std::sync::Arc;
use std::time::{Duration, Instant};

use evis_scene::Scene;

use crate::config::RunConfig;
use crate::engine::{Engine, Parts};
use crate::error::EngineError;
use crate::gpu::Gpu;
use crate::gpu::commands::Commands;
use crate::gpu::readback::{map, wait_mapped};
use crate::sensor::group::{Slot, Unit};
use crate::sensor::{step, trigger};
use crate::world::view;

/// How far a submission goes; each includes those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Poses, matrices, uploads.
    Prepare,
    /// And luminance.
    Raster,
    /// And events per pixel.
    Count,
    /// And where each pixel's events go.
    Prefix,
    /// And events; and dense arrays of them, where the configuration has any.
    Emit,
    /// And their copy into mapped memory.
    Readback,
}

impl Stage {
    /// All, in order.
    pub const ALL: [Self; 6] =
        [Self::Prepare, Self::Raster, Self::Count, Self::Prefix, Self::Emit, Self::Readback];

    /// Dispatches of the trigger, `all` of them: some that count, two that place, and those that emit: of a chain two.
    const fn trigger_steps(self, all: usize, chain: bool) -> usize {
        match self {
            Self::Prepare | Self::Raster => 0,
            Self::Count => all - 3 - chain as usize,
            Self::Prefix => all - 1 - chain as usize,
            Self::Emit | Self::Readback => all,
        }
    }
}

/// An engine whose submissions stop where a benchmark says.
pub struct Stages {
    engine: Engine,
    slot: Slot,
}

impl Stages {
    /// Prepares the first camera of `scene`, with room for `capacity` events.
    ///
    /// # Errors
    /// As [`crate::Simulator::new`].
    pub fn new(
        gpu: &Gpu,
        scene: Arc<Scene>,
        mut config: RunConfig,
        capacity: u32,
    ) -> Result<Self, EngineError> {
        config.check()?;
        let (views, _) = view::views(&scene, &config)?;
        let mut engine = Engine::new(gpu, scene, views, &mut config)?;
        let Parts { context, groups, .. } = engine.parts();
        let slot = Slot::new(&context.gpu.device, capacity, groups[0].header_bytes());
        Ok(Self { engine, slot })
    }

    /// Instants that go into one submission.
    pub fn instants_per_submission(&mut self) -> u32 {
        let Parts { targets, groups, .. } = self.engine.parts();
        targets[groups[0].targets].plan.instants
    }

    /// Runs the submission of `instants` instants from `first` on up to `stage`, and waits for it. Pixel memory goes
    /// on only where `commit` says so: each stage of the same instants then starts from the same memory.
    ///
    /// # Errors
    /// The device may fail.
    pub fn run(
        &mut self,
        first: i64,
        instants: u32,
        stage: Stage,
        commit: bool,
    ) -> Result<Duration, EngineError> {
        let started = Instant::now();
        let slot = &mut self.slot;
        let Parts { context, passes, sampling, targets, groups, dense } = self.engine.parts();
        let group = &mut groups[0];
        let targets = &targets[group.targets];
        let instants = if first == 0 && group.chain.is_some() { 1 } else { instants };
        let unit = Unit { group: 0, first, instants };
        if let Some(chain) = group.chain.as_mut().filter(|_| stage >= Stage::Count) {
            let (base_us, end_us) = (unit.base_us(&context.grid), unit.end_us(&context.grid));
            slot.feed(&context.gpu, &chain.feed(base_us, end_us));
        }
        let mut encoder = Commands::new(&context.gpu, "stages");
        if stage >= Stage::Raster {
            sampling.encode(context, &mut encoder, targets, group, &unit);
        } else {
            let views = context.views_at(&group.views);
            let times: Vec<i64> =
                (0..instants).map(|i| context.grid.instant_us(first + i64::from(i))).collect();
            context.upload_frames(&views, &times);
        }
        if stage >= Stage::Count {
            let (gpu, grid) = (&context.gpu, &context.grid);
            let is_whole = stage >= Stage::Emit;
            let mut dense = dense.filter(|_| is_whole);
            let own = dense.as_deref_mut();
            let steps = trigger::trigger_steps(gpu, passes, grid, targets, group, &unit, slot, own);
            let chain = group.chain.is_some();
            let count = if is_whole { steps.len() } else { stage.trigger_steps(steps.len(), chain) };
            trigger::clear_tallies(&mut encoder, group);
            step::encode_trigger(&mut encoder, &steps[..count]);
            if let Some(dense) = dense {
                dense.read(gpu, &mut encoder, 0, unit.base_us(grid));
            }
        }
        if stage == Stage::Readback {
            encoder.copy_buffer_to_buffer(
                &slot.events,
                0,
                &slot.staging,
                group.header_bytes(),
                slot.events.size(),
            );
        }
        let submission = encoder.submit(&context.gpu);
        if stage == Stage::Readback {
            let mapped = map(&slot.staging);
            wait_mapped(&context.gpu, &submission, &mapped)?;
            slot.staging.unmap();
        } else {
            context
                .gpu
                .device
                .poll(wgpu::PollType::Wait { submission_index: Some(submission), timeout: None })?;
        }
        if commit {
            group.parity = 1 - group.parity;
        }
        Ok(started.elapsed())
    }
}
