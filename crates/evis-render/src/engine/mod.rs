//! The engine: batches of views, submissions in flight, and what came back of them.

pub mod bench;
mod build;
mod collect;
pub(crate) mod decoupled;
pub mod follower;
mod recover;
mod reset;
pub mod simulator;
pub(crate) mod stages;
pub mod submission;

#[cfg(test)]
pub(crate) use build::classes;
pub use simulator::{EnvironmentLens, EnvironmentSensor, PacketStream, Simulator};

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::time::Instant;

use evis_core::event::take_causes;
use evis_core::{Event, LabelFrame, PoseSample, TimeGrid};

use crate::error::EngineError;
use crate::gpu::commands::Commands;
use crate::gpu::readback::{map, wait_mapped};
use crate::output::frames::FrameRenderer;
use crate::output::labels::{LabelJob, LabelRenderer};
use crate::output::packet::{DenseWindow, Packet, PacketReport, StageTimes, ViewPacket};
use crate::output::poses::CameraPoses;
use crate::raster::context::Context;
use crate::raster::readback::mean_luminance;
use crate::sampling::audit::AuditRun;
use crate::sampling::clipped::ClippedRun;
use crate::sampling::{Readbacks, Sampling};
use crate::sensor::chain::CANDIDATE_WORDS;
use crate::sensor::dense::{DenseArrays, DenseReadback};
use crate::sensor::group::{Group, Slot, Unit};
use crate::sensor::host::{HostWalk, LuminanceReadback};
use crate::sensor::passes::{TriggerPasses, WalkPasses};
use crate::sensor::targets::Targets;

/// Submissions in flight: the device works on one while the host prepares the next and unpacks the last.
const RING: usize = 3;

/// Submissions are kept near this long, so that a stop, which is seen between them, is seen soon. How instants are
/// grouped never shows in the events.
const SUBMISSION_MS: f64 = 400.0;

/// What came back of one view and was not yet delivered.
#[derive(Default)]
struct Arrived {
    events: Vec<Event>,
    labels: Vec<LabelFrame>,
    poses: Vec<PoseSample>,
    dense: Vec<DenseWindow>,
}

enum Work {
    Events {
        unit: Unit,
        slot: Slot,
        predicted: u32,
        audit: Option<PendingAudit>,
    },
    Labels(LabelJob),
    /// Light for pixels that the host walks.
    LuminanceReadback(LuminanceReadback),
    /// Arrays of a window whose events are all there.
    Dense(DenseReadback),
}

/// What tells that a buffer can be read.
type Mapped = Receiver<Result<(), wgpu::BufferAsyncError>>;

/// Audits of a submission, on their way.
type PendingAudit = (AuditRun, Mapped);

struct InFlight {
    work: Work,
    submitted: Instant,
    submission: wgpu::SubmissionIndex,
    mapped: Mapped,
    /// Counts of clipped light, on their way.
    clipped: Option<(ClippedRun, Mapped)>,
}

/// The engine.
pub struct Engine {
    context: Context,
    passes: TriggerPasses,
    sampling: Sampling,
    targets: Vec<Targets>,
    groups: Vec<Group>,
    label_renderer: Option<LabelRenderer>,
    frame_renderer: Option<FrameRenderer>,
    host_walk: HostWalk,
    /// Where packets carry arrays in the place of events, and the device makes them for a group at least.
    dense: Option<DenseArrays>,
    label_grid: TimeGrid,
    /// Instants that no submission parts.
    block: u32,
    in_flight: VecDeque<InFlight>,
    free: Vec<Slot>,
    capacity: u32,
    most_capacity: u32,
    /// Words of candidates that a submission may have.
    most_feed: u64,
    /// Events of the last submission, by class.
    last_counts: Vec<u32>,
    /// Measured milliseconds per instant of a group, of late.
    instant_ms: f64,
    collected: Option<Instant>,
    /// Per group: events before this are complete.
    complete_us: Vec<i64>,
    /// Per group: the keyframe up to which clipped light is counted. Some are drawn more than once.
    clipped_until: Vec<i64>,
    next_label: i64,
    next_label_group: usize,
    labels_complete: i64,
    poses: CameraPoses,
    arrived: Vec<Arrived>,
    delivered_us: i64,
    report: PacketReport,
    stop: Arc<AtomicBool>,
    /// Whether events carry why they fired.
    caused: bool,
    /// Whether it makes events; else only labels and frames.
    fires: bool,
}

/// What an engine is made of, for benches and tests.
pub(crate) struct Parts<'a> {
    pub context: &'a mut Context,
    pub passes: &'a TriggerPasses,
    pub sampling: &'a mut Sampling,
    pub targets: &'a [Targets],
    pub groups: &'a mut [Group],
    pub dense: Option<&'a mut DenseArrays>,
}

impl Engine {
    /// What `bench` measures stage by stage.
    pub(crate) fn parts(&mut self) -> Parts<'_> {
        let Self { context, passes, sampling, targets, groups, dense, .. } = self;
        Parts { context, passes, sampling, targets, groups, dense: dense.as_mut() }
    }

    /// Starts with buffers of `capacity` events, never more than `most`: tests make them overflow.
    #[cfg(test)]
    pub fn limit_buffers(&mut self, capacity: u32, most: u32) {
        self.capacity = capacity;
        self.most_capacity = most;
    }

    /// Lets a submission have this many words of candidates: tests make it split.
    #[cfg(test)]
    pub fn limit_feed(&mut self, words: u64) {
        self.most_feed = words;
    }

    /// Set, it ends a delivery after the submission in work with [`EngineError::Stopped`]; nothing is lost, the
    /// next delivery goes on from there.
    pub fn stop(&self) -> &Arc<AtomicBool> {
        &self.stop
    }

    /// What view `view` shows at stream time `t_us`, as its pixels integrate it: mean luminance over the samples, row-major
    /// from the top. The stream is left as it is.
    pub fn luminance(&mut self, view: usize, t_us: i64) -> Result<Vec<f64>, EngineError> {
        let Some(group) = self.groups.iter().find(|group| group.views.contains(&view)) else {
            return Err(EngineError::Device(format!("there is no view {view}")));
        };
        mean_luminance(&mut self.context, &self.targets[group.targets].layers, view, t_us)
    }

    /// What the method makes of instants `first..first + instants` of the first view: a picture each, from the mean of
    /// its samples.
    #[cfg(test)]
    pub fn instants(&mut self, first: i64, instants: u32) -> Result<Vec<Vec<f32>>, EngineError> {
        let (group, unit) = (&self.groups[0], Unit { group: 0, first, instants });
        let targets = &self.targets[group.targets];
        let mut encoder = Commands::new(&self.context.gpu, "instants");
        self.sampling.encode(&mut self.context, &mut encoder, targets, group, &unit);
        let samples = targets.plan.layers / (targets.plan.instants * targets.plan.views_per_group);
        let groups = (instants as usize, samples as usize);
        let means = crate::raster::readback::read_means(&self.context, encoder, &targets.layers, groups)?;
        Ok(means.into_iter().map(|mean| mean.into_iter().map(|light| light as f32).collect()).collect())
    }

    /// Where the older side's pixels were last placed: x, y, depth key, in planes over the keyframe.
    #[cfg(test)]
    pub fn splat_store(&self) -> Option<&crate::sampling::splat::Store> {
        match &self.sampling {
            Sampling::Splat(sampler) => sampler.store(0),
            Sampling::Native(_) | Sampling::Adaptive(_) => None,
        }
    }

    /// Sample offsets in pixels, in layer order.
    #[cfg(test)]
    pub fn offsets(&self) -> &[[f32; 2]] {
        &self.context.offsets
    }

    /// Stream time of the last instant that is sampled for everything before `until_us`.
    pub fn needed_us(&self, until_us: i64) -> i64 {
        let grid = &self.context.grid;
        let block = i64::from(self.block);
        let last = grid.first_at_or_after(until_us).max(0);
        grid.instant_us(last.div_euclid(block) * block + if last % block > 0 { block } else { 0 })
    }

    /// Stream time up to which packets were delivered.
    pub fn now_us(&self) -> i64 {
        self.delivered_us
    }

    /// Restarts the stream of an engine whose sensors are ideal and that has no frames, `start_us` into the scene's time. In
    /// adaptive time it renders the tiles `only` of each view from then on (all where there is nothing), and other pixels fire
    /// anything or nothing; with `every_instant` at every instant, whether they change or not.
    pub fn restart(
        &mut self,
        start_us: i64,
        only: Vec<Vec<bool>>,
        every_instant: bool,
    ) -> Result<(), EngineError> {
        while !self.in_flight.is_empty() {
            self.collect_oldest()?;
        }
        self.context.start_us = start_us;
        self.sampling.restart(only, every_instant);
        self.groups.iter_mut().for_each(|group| group.next = 0);
        self.complete_us.fill(0);
        self.clipped_until.fill(i64::MIN);
        self.arrived.iter_mut().for_each(|arrived| *arrived = Arrived::default());
        (self.next_label, self.next_label_group, self.labels_complete) = (0, 0, 0);
        self.poses = CameraPoses::new(self.label_grid, start_us);
        (self.delivered_us, self.report) = (0, PacketReport::default());
        Ok(())
    }

    /// Renders the tiles `only` of each view for events, in adaptive time, from the start on: other pixels fire anything or nothing.
    /// Labels and frames are whole.
    pub fn restrict(&mut self, only: Vec<Vec<bool>>) {
        self.sampling.restart(only, false);
    }

    /// Delivers `[now, until_us)`, submitting ahead as far as `horizon_us`.
    pub fn deliver(&mut self, until_us: i64, horizon_us: i64) -> Result<Packet, EngineError> {
        self.context.gpu.check_not_lost()?;
        self.deliver_parts(until_us, horizon_us).map_err(|error| {
            // Whatever fails once the device is lost fails for that.
            self.context.gpu.check_not_lost().err().unwrap_or(error)
        })
    }

    fn deliver_parts(&mut self, until_us: i64, horizon_us: i64) -> Result<Packet, EngineError> {
        let _span = tracing::trace_span!("deliver", until_us).entered();
        let started = Instant::now();
        loop {
            while self.in_flight.len() < RING && self.submit_next(horizon_us)? {}
            if self.is_complete(until_us) {
                break;
            }
            if self.stop.load(Ordering::Relaxed) {
                return Err(EngineError::Stopped);
            }
            self.collect_oldest()?;
        }
        self.expose_frames(until_us)?;
        let packing = Instant::now();
        let Context { scene, views, .. } = &self.context;
        self.poses.take(scene, views, until_us, |view, pose| self.arrived[view].poses.push(pose));
        let mut packet = Packet { start_us: self.delivered_us, end_us: until_us, ..Default::default() };
        for (index, (view, arrived)) in self.context.views.iter().zip(&mut self.arrived).enumerate() {
            let count = arrived.events.partition_point(|e| e.t < until_us);
            let rest = arrived.events.split_off(count);
            let labels = arrived.labels.partition_point(|l| l.t_us < until_us);
            let mut events = std::mem::replace(&mut arrived.events, rest);
            let windows = arrived.dense.partition_point(|window| window.end_us <= until_us);
            let made = arrived.dense.drain(..windows).collect();
            let causes = if self.caused { take_causes(&mut events) } else { Vec::new() };
            packet.views.push(ViewPacket {
                environment: view.environment,
                camera: view.camera,
                events,
                dense: self.dense.as_ref().filter(|own| own.makes_view(index)).map(|_| made),
                causes,
                labels: arrived.labels.drain(..labels).collect(),
                poses: std::mem::take(&mut arrived.poses),
            });
        }
        self.delivered_us = until_us;
        packet.report = std::mem::take(&mut self.report);
        packet.report.keyframes = self.sampling.take_keyframes();
        packet.report.drawn_pixels = self.sampling.take_drawn_pixels();
        packet.report.events += packet.views.iter().map(|v| v.events.len() as u64).sum::<u64>();
        packet.report.times.pack_ms += milliseconds(packing);
        packet.report.times.total_ms = milliseconds(started);
        Ok(packet)
    }

    /// Frames whose middle lies before `until_us`.
    fn expose_frames(&mut self, until_us: i64) -> Result<(), EngineError> {
        let Some(renderer) = &mut self.frame_renderer else { return Ok(()) };
        while let Some(frames) = renderer.expose(&mut self.context, until_us, &self.stop)? {
            for (arrived, frame) in self.arrived.iter_mut().zip(frames) {
                let at = arrived.labels.partition_point(|l| (l.t_us, l.kind) <= (frame.t_us, frame.kind));
                arrived.labels.insert(at, frame);
            }
        }
        Ok(())
    }

    fn is_complete(&self, until_us: i64) -> bool {
        let labels_wanted =
            if self.label_renderer.is_some() { self.label_grid.first_at_or_after(until_us) } else { 0 };
        let is_read = |group: usize| self.dense.as_ref().is_none_or(|own| own.is_read(group, until_us));
        let is_there = |(group, complete_us): (usize, &i64)| *complete_us >= until_us && is_read(group);
        let fired = !self.fires || self.complete_us.iter().enumerate().all(is_there);
        fired && self.labels_complete >= labels_wanted
    }

    /// Submits the earliest work that is left before `horizon_us`; false where there is none.
    fn submit_next(&mut self, horizon_us: i64) -> Result<bool, EngineError> {
        let started = Instant::now();
        let grid = self.context.grid;
        // Each group's next instant and its last one: where pixels see frames, light is needed for longer.
        let left = self.groups.iter().enumerate().map(|(g, group)| {
            let exposure = &self.context.views[group.views[0]].sensor.exposure;
            (g, group.next, grid.first_at_or_after(exposure.needed_us(horizon_us)))
        });
        let due = left.filter(|(_, next, last)| self.fires && next <= last).min_by_key(|(_, next, _)| *next);
        let label_us = self.label_grid.instant_us(self.next_label);
        let label_due = self.label_renderer.is_some()
            && label_us < horizon_us
            && due.is_none_or(|(_, next, _)| label_us <= grid.instant_us(next));
        if label_due {
            self.submit_label()?;
        } else if let Some((group, next, last)) = due {
            let planned = f64::from(self.targets[self.groups[group].targets].plan.instants);
            let most = (SUBMISSION_MS / self.instant_ms.max(1e-3)).clamp(1.0, planned) as i64;
            let most = self.dense.as_ref().map_or(most, |own| most.min(own.most_instants(&grid)));
            let block = i64::from(self.block);
            // The first instant of a chain has a pass of its own, and so has the one before the first block.
            let alone = next == 0 && (block > 1 || self.groups[group].chain.is_some());
            let whole = |instants: i64| (instants / block).max(1) * block;
            let left = last - next + block;
            let instants = if alone { 1 } else { whole(most).min(whole(left)) };
            let unit = Unit { group, first: next, instants: instants as u32 };
            self.submit_unit(unit)?;
        } else {
            return Ok(false);
        }
        self.report.times.host_ms += milliseconds(started);
        Ok(true)
    }

    fn submit_unit(&mut self, unit: Unit) -> Result<(), EngineError> {
        let _span = tracing::trace_span!("prepare submission", first = unit.first, instants = unit.instants)
            .entered();
        let group = &mut self.groups[unit.group];
        if matches!(*self.passes.walks[group.targets], WalkPasses::Host) {
            return self.submit_luminance(unit);
        }
        let submitted = Instant::now();
        let (base_us, end_us) = (unit.base_us(&self.context.grid), unit.end_us(&self.context.grid));
        let feed = group.chain.as_mut().map(|chain| chain.feed(base_us, end_us));
        if let Some(words) = feed.as_ref().filter(|words| words.len() as u64 > self.most_feed) {
            let Some(halves) = unit.halves(self.block) else {
                return Err(EngineError::Device(format!(
                    "an instant has {} candidates of noise events, and this device's buffers hold {}; lower the rates of \
                     the sensor's noise, raise `rate_hz`, or render fewer cameras at once",
                    words.len() / CANDIDATE_WORDS as usize,
                    self.most_feed / u64::from(CANDIDATE_WORDS)
                )));
            };
            return halves.into_iter().try_for_each(|half| self.submit_unit(half));
        }
        let header = group.header_bytes();
        let mut slot = match self.free.iter().position(|s| s.fits(self.capacity, header)) {
            Some(index) => self.free.swap_remove(index),
            None => {
                // Smaller ones are from before the capacity grew.
                self.free.clear();
                Slot::new(&self.context.gpu.device, self.capacity, header)
            }
        };
        if let Some(words) = &feed {
            slot.feed(&self.context.gpu, words);
        }
        // Half as much again as the last one had: a second copy is needed only where events surge.
        let last = self.last_counts[group.targets];
        let predicted = (last / 2 * 3).saturating_add(4096).min(slot.capacity);
        // Events that the device makes arrays of stay there.
        let stay = self.dense.as_ref().is_some_and(|own| own.makes(unit.group));
        let predicted = if stay { 0 } else { predicted };
        let mut encoder = Commands::new(&self.context.gpu, "events");
        let Readbacks { audit, clipped } = submission::encode(
            &mut self.context,
            &self.passes,
            &mut self.sampling,
            &mut encoder,
            &self.targets[group.targets],
            group,
            &unit,
            &slot,
            self.dense.as_mut(),
            predicted,
        );
        let submission = encoder.submit(&self.context.gpu);
        let mapped = map(&slot.staging);
        let audit = audit.map(|run| {
            let mapped = map(&run.staging);
            (run, mapped)
        });
        let clipped = clipped.map(pending);
        group.parity = 1 - group.parity;
        group.next = unit.first + i64::from(unit.instants);
        self.in_flight.push_back(InFlight {
            work: Work::Events { unit, slot, predicted, audit },
            submitted,
            submission,
            mapped,
            clipped,
        });
        Ok(())
    }

    /// Submits the luminance that the sensor model on the host takes.
    fn submit_luminance(&mut self, unit: Unit) -> Result<(), EngineError> {
        let submitted = Instant::now();
        let group = &mut self.groups[unit.group];
        let targets = &self.targets[group.targets];
        let mut encoder = Commands::new(&self.context.gpu, "light for the host");
        // Every instant of every tile is sampled: there is nothing to audit.
        let sampled = self.sampling.encode(&mut self.context, &mut encoder, targets, group, &unit);
        let readback = self.host_walk.encode(&self.context.gpu, &mut encoder, targets, group, unit)?;
        let submission = encoder.submit(&self.context.gpu);
        let mapped = map(&readback.staging);
        let clipped = sampled.clipped.map(pending);
        group.next = unit.first + i64::from(unit.instants);
        self.in_flight.push_back(InFlight {
            work: Work::LuminanceReadback(readback),
            submitted,
            submission,
            mapped,
            clipped,
        });
        Ok(())
    }

    fn submit_label(&mut self) -> Result<(), EngineError> {
        let _span = tracing::trace_span!("prepare labels").entered();
        let submitted = Instant::now();
        let Some(renderer) = &mut self.label_renderer else { return Ok(()) };
        let group = self.next_label_group;
        let (job, submission) =
            renderer.submit(&mut self.context, &self.groups[group], group, self.next_label, &self.label_grid);
        let mapped = map(&job.staging);
        let work = Work::Labels(job);
        self.in_flight.push_back(InFlight { work, submitted, submission, mapped, clipped: None });
        self.next_label_group += 1;
        if self.next_label_group == self.groups.len() {
            self.next_label_group = 0;
            self.next_label += 1;
        }
        Ok(())
    }

    /// Waits for the oldest submission and takes what it brought.
    fn collect_oldest(&mut self) -> Result<(), EngineError> {
        let Some(oldest) = self.in_flight.pop_front() else {
            return Err(EngineError::Device("nothing is in flight, and the interval is not complete".into()));
        };
        let waiting = Instant::now();
        tracing::trace_span!("wait for device").in_scope(|| self.wait(&oldest))?;
        if let Some(clock) = &self.context.gpu.clock {
            clock.report();
        }
        self.report.times.device_wait_ms += milliseconds(waiting);
        // The device works in order: on this one since it was submitted, or since the one before it was done.
        let began = self.collected.map_or(oldest.submitted, |done| done.max(oldest.submitted));
        self.collected = Some(Instant::now());
        if let Work::Events { unit, .. } | Work::LuminanceReadback(LuminanceReadback { unit, .. }) =
            &oldest.work
        {
            self.instant_ms = 0.5 * (self.instant_ms + milliseconds(began) / f64::from(unit.instants));
        }
        // Also where the submission has to run again: what its keyframes' slots still hold is not drawn then.
        if let Some((run, mapped)) = &oldest.clipped {
            wait_mapped(&self.context.gpu, &oldest.submission, mapped)?;
            self.take_clipped(run)?;
        }
        match oldest.work {
            Work::Events { unit, slot, predicted, audit } => {
                if self.take_events(unit, slot, predicted)?
                    && let Some((run, mapped)) = audit
                {
                    wait_mapped(&self.context.gpu, &oldest.submission, &mapped)?;
                    self.take_audit(&run)?;
                }
                Ok(())
            }
            Work::LuminanceReadback(readback) => self.take_luminance(readback),
            Work::Dense(readback) => self.take_dense(readback),
            Work::Labels(job) => {
                let packing = Instant::now();
                let renderer = self.label_renderer.as_mut();
                let label = job.index;
                let last_group = job.group + 1 == self.groups.len();
                if let Some(renderer) = renderer {
                    for (view, labels) in renderer.take(&self.context, &self.groups[job.group], job)? {
                        self.arrived[view].labels.extend(labels);
                    }
                }
                if last_group {
                    self.labels_complete = label + 1;
                }
                self.report.times.pack_ms += milliseconds(packing);
                Ok(())
            }
        }
    }

    fn wait(&self, flight: &InFlight) -> Result<(), EngineError> {
        wait_mapped(&self.context.gpu, &flight.submission, &flight.mapped)
    }
}

impl Drop for Engine {
    fn drop(&mut self) {
        // Nothing of ours may still run when the caller's device is handed on.
        let _ = self.context.gpu.device.poll(wgpu::PollType::wait_indefinitely());
    }
}

/// Counts of clipped light, and what tells that they came.
fn pending(run: ClippedRun) -> (ClippedRun, Mapped) {
    let mapped = map(&run.staging);
    (run, mapped)
}

fn milliseconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

impl StageTimes {
    /// Adds another packet's.
    pub fn add(&mut self, other: &Self) {
        self.host_ms += other.host_ms;
        self.device_wait_ms += other.device_wait_ms;
        self.pack_ms += other.pack_ms;
        self.total_ms += other.total_ms;
    }
}
