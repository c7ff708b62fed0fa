//! Resets of single environments; the others continue.

use evis_core::{ConfigError, SensorConfig};
use evis_scene::PixelLens;

use crate::error::EngineError;
use crate::gpu::commands::Commands;
use crate::gpu::readback::{map, wait_mapped};
use crate::sampling::Sampling;
use crate::sensor::chain::GroupChain;
use crate::sensor::group::{Slot, Unit};
use crate::sensor::passes::{WalkPasses, share_passes};
use crate::sensor::step::encode_trigger;
use crate::sensor::trigger::{clear_tallies, trigger_steps};
use crate::world::view::reseed;

use super::Engine;

impl Engine {
    /// Whether environments can be reset at the stream's present time.
    ///
    /// # Errors
    /// A method with keyframes, pixels that see frames, and a present that lies between two samples or behind one.
    pub fn check_reset(&self) -> Result<(), ConfigError> {
        if matches!(self.sampling, Sampling::Splat(_)) {
            let remedy = "of a simulator with the method native: keyframes reach beyond the present";
            return Err(ConfigError::new("reset", "with keyframes", remedy));
        }
        if self.context.views.iter().any(|view| !view.sensor.exposure.is_off()) {
            let remedy = "of sensors without an exposure: theirs reaches beyond the present";
            return Err(ConfigError::new("reset", "with an exposure", remedy));
        }
        let now_us = self.delivered_us;
        let grid = &self.context.grid;
        // What is in work or known belongs to the present, and nothing to later.
        let is_there = |next: i64| match next {
            0 => now_us == 0,
            next => grid.instant_us(next - 1) == now_us,
        };
        if !self.groups.iter().all(|group| is_there(group.next)) {
            let apart_us = grid.instant_us(i64::from(self.block));
            let remedy =
                format!("at the end of a step to a multiple of {apart_us} us, which came to its end");
            return Err(ConfigError::new("reset", format!("at {now_us} us"), remedy));
        }
        Ok(())
    }

    /// Whether view `view` can have `sensor` from a reset on.
    ///
    /// # Errors
    /// One that needs other passes.
    pub fn check_sensor(&self, view: usize, sensor: &SensorConfig) -> Result<(), ConfigError> {
        if share_passes(&self.context.views[view].sensor, sensor) {
            return Ok(());
        }
        Err(other_stages())
    }

    /// Resets environments at the stream's present time: their pixels take the light of that time as their reference, and
    /// what they had, or had on their way, is gone. `seeds`: of what is random in them from now on, as they are drawn for a
    /// simulator of this seed; the old ones where it is empty. `sensors` and `lenses`: of views of these environments from now on.
    /// Nothing of other environments changes.
    ///
    /// # Errors
    /// As [`Engine::check_reset`] and [`Engine::check_sensor`]; the device may fail.
    pub fn reset(
        &mut self,
        environments: &[usize],
        seeds: &[u64],
        sensors: &[(usize, SensorConfig)],
        lenses: &[(usize, PixelLens)],
    ) -> Result<(), EngineError> {
        self.check_reset()?;
        for (view, sensor) in sensors {
            self.check_sensor(*view, sensor)?;
        }
        while !self.in_flight.is_empty() {
            self.collect_oldest()?;
        }
        reseed(&mut self.context.views, &self.context.scene, environments, seeds);
        for (view, sensor) in sensors {
            self.context.views[*view].sensor = sensor.clone();
        }
        for (view, lens) in lenses {
            self.context.views[*view].lens = *lens;
            self.context.views[*view].own_lens = *lens;
        }
        for group in 0..self.groups.len() {
            let begins = |view: &usize| environments.contains(&self.context.views[*view].environment);
            let beginning: Vec<bool> = self.groups[group].views.iter().map(begins).collect();
            if beginning.contains(&true) {
                let other_sensors = sensors.iter().any(|(view, _)| self.groups[group].views.contains(view));
                if other_sensors {
                    let own = self.context.view_sensors(&self.groups[group].views);
                    self.groups[group].write_sensors(&self.context.gpu, &own);
                }
                self.begin_views(group, beginning, other_sensors || !seeds.is_empty())?;
            }
        }
        Ok(())
    }

    /// Resets the views of `group` that `beginning` names; what is frozen in them is drawn again where they have other keys or
    /// sensors (`redrawn`).
    fn begin_views(&mut self, group: usize, beginning: Vec<bool>, redrawn: bool) -> Result<(), EngineError> {
        let views = self.groups[group].views.clone();
        for (view, _) in views.iter().zip(&beginning).filter(|(_, begins)| **begins) {
            self.arrived[*view].events.clear();
            self.host_walk.reset(*view, &self.context.views[*view])?;
        }
        if let Some(own) = &self.dense {
            let mut encoder = Commands::new(&self.context.gpu, "reset of dense arrays");
            let begun = beginning.iter().enumerate().filter(|(_, begins)| **begins);
            begun.for_each(|(place, _)| own.clear(&mut encoder, group, place));
            encoder.submit(&self.context.gpu);
        }
        let class = self.groups[group].targets;
        if let (Some(passes), Some(chain)) = (self.passes.chain(class), &mut self.groups[group].chain) {
            let targets = &self.targets[class];
            let own: Vec<_> = views.iter().map(|&v| self.context.views[v].sensing()).collect();
            let (size, reference) = ([targets.width, targets.height], self.context.reference_luminance);
            if redrawn {
                let fresh = GroupChain::new(&self.context.gpu, &passes.plan, size, &own, reference);
                chain.reset_views(fresh, &beginning);
            } else {
                // What is frozen stays, and noise is a function of time.
                chain.clear_readout(&own, &beginning);
            }
        }
        if self.groups[group].next == 0 {
            // The stream's first instant is still to come.
            return Ok(());
        }
        self.groups[group].beginning = beginning;
        let unit = Unit { group, first: self.groups[group].next - 1, instants: 1 };
        let done = self.submit_beginning(unit);
        self.groups[group].beginning.clear();
        done
    }

    /// Renders the instant of `unit` once more, for views that begin with it, and sets their memory.
    fn submit_beginning(&mut self, unit: Unit) -> Result<(), EngineError> {
        let Self { context, passes, sampling, targets, groups, .. } = self;
        let group = &groups[unit.group];
        let targets = &targets[group.targets];
        let mut encoder = Commands::new(&context.gpu, "reset");
        // Nothing is audited where something begins.
        let _ = sampling.encode(context, &mut encoder, targets, group, &unit);
        if matches!(*passes.walks[group.targets], WalkPasses::Host) {
            let readback = self.host_walk.encode(&context.gpu, &mut encoder, targets, group, unit)?;
            let submission = encoder.submit(&context.gpu);
            let mapped = map(&readback.staging);
            wait_mapped(&context.gpu, &submission, &mapped)?;
            // First light fires nothing.
            self.host_walk.take(context, targets, group, readback)?;
            return Ok(());
        }
        let header = group.header_bytes();
        let fits = |slot: &Slot| slot.fits(self.capacity, header);
        let slot = match self.free.iter().position(fits) {
            Some(index) => self.free.swap_remove(index),
            None => Slot::new(&context.gpu.device, self.capacity, header),
        };
        let steps = trigger_steps(&context.gpu, passes, &context.grid, targets, group, &unit, &slot, None);
        clear_tallies(&mut encoder, group);
        encode_trigger(&mut encoder, &steps);
        group.keep_beginning(&mut encoder);
        encoder.submit(&context.gpu);
        self.free.push(slot);
        Ok(())
    }
}

/// Of a sensor that needs other passes than its view has.
pub(super) fn other_stages() -> ConfigError {
    let remedy = "the simulator's own with other numbers for thresholds, their spread, bandwidth, leak, noise, refractory \
                  period, latency or bus: stages that are on stay on, and what is off stays off";
    ConfigError::new(
        "sensor",
        "one of other stages, or with another number that all environments share",
        remedy,
    )
}
