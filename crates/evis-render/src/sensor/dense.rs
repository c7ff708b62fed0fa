//! Dense arrays of events, made on the device where its sensors fire: events stay there, arrays come back.
//!
//! Each group of views has an array for every window of time that submissions in flight may write. A submission adds its
//! events to those that it overlaps; once all events of a window are there, its array is copied out and cleared.

use std::collections::VecDeque;

use crate::config::dense::{DenseKind, DenseOutput};
use crate::config::grid::SampleGrid;
use crate::error::EngineError;
use crate::gpu::Gpu;
use crate::gpu::commands::Commands;
use crate::gpu::sizes::{DeviceLimits, UNIFORM_ALIGNMENT};
use crate::gpu::uniforms::WindowBounds;
use crate::pass;
use crate::pass::trigger::{CHAIN_DENSE_BINDINGS, EMIT_DENSE_BINDINGS};
use crate::sensor::group::{Group, Slot, Times};
use crate::sensor::passes::{TriggerPasses, WalkPasses};
use crate::sensor::step::TriggerStep;
use crate::sensor::targets::Targets;

/// Windows that a submission may overlap, but for those at its ends.
const MOST_WINDOWS: i64 = 32;

/// The arrays of all groups.
pub struct DenseArrays {
    output: DenseOutput,
    /// By group; none where its events come to the host, which makes arrays of them.
    groups: Vec<Option<GroupArrays>>,
    /// By view, whether its group has some.
    views: Vec<bool>,
}

/// The arrays of a group of views.
struct GroupArrays {
    /// Windows in order, and their arrays, view by view.
    open: VecDeque<(i64, wgpu::Buffer)>,
    /// Arrays of zeros.
    spare: Vec<wgpu::Buffer>,
    /// Buffers that the host maps, and has read.
    staging: Vec<wgpu::Buffer>,
    /// A [`WindowBounds`] for each window of a submission.
    windows: wgpu::Buffer,
    /// Bytes of a view.
    view_bytes: u64,
    views: u64,
    /// Everything before this was read back.
    read_us: i64,
}

/// A window's arrays on their way to the host.
pub struct DenseReadback {
    /// Index of the group.
    pub group: usize,
    /// Index of the window.
    pub window: i64,
    /// View by view.
    pub staging: wgpu::Buffer,
}

impl DenseArrays {
    /// Prepares arrays for the groups that make their events on the device; `None` where that is none. No submission is surely longer
    /// than `longest_us`.
    pub fn new(
        gpu: &Gpu,
        output: DenseOutput,
        longest_us: f64,
        passes: &TriggerPasses,
        targets: &[Targets],
        groups: &[&Group],
    ) -> Option<Self> {
        // Places in a voxel grid are found by products of 32 bits.
        let bins = match output.kind {
            DenseKind::VoxelGrid { bins, .. } => bins,
            _ => 1,
        };
        let products_fit = output.window_us as u64 * u64::from(bins - 1) <= u64::from(u32::MAX);
        if !products_fit || longest_us > (MOST_WINDOWS * output.window_us) as f64 {
            return None;
        }
        let limits = DeviceLimits::of(&gpu.device);
        let of = |group: &&Group| {
            let fires = match &*passes.walks[group.targets] {
                WalkPasses::Ideal { .. } => true,
                WalkPasses::Chain(_) => group.chain.as_ref().is_some_and(|chain| chain.readouts.is_empty()),
                WalkPasses::Host => false,
            };
            let own = &targets[group.targets];
            let arrays = GroupArrays::new(gpu, &output, own, group.views.len() as u64);
            (fires && arrays.bytes() <= limits.storage_binding).then_some(arrays)
        };
        let arrays: Vec<_> = groups.iter().map(of).collect();
        let last = groups.iter().flat_map(|group| &group.views).max();
        let mut views = vec![false; last.map_or(0, |last| last + 1)];
        for (group, arrays) in groups.iter().zip(&arrays) {
            group.views.iter().for_each(|view| views[*view] = arrays.is_some());
        }
        views.contains(&true).then(|| Self { output, groups: arrays, views })
    }

    /// What is made.
    pub const fn output(&self) -> &DenseOutput {
        &self.output
    }

    /// Whether the events of view `view` become arrays here.
    pub fn makes_view(&self, view: usize) -> bool {
        self.views.get(view).is_some_and(|makes| *makes)
    }

    /// Whether the events of `group` become arrays here.
    pub fn makes(&self, group: usize) -> bool {
        self.groups[group].is_some()
    }

    /// Instants of a submission at most, but for whole blocks.
    pub fn most_instants(&self, grid: &SampleGrid) -> i64 {
        ((MOST_WINDOWS * self.output.window_us) as f64 / grid.longest_interval_us()) as i64
    }

    /// Steps that add the events of a submission of `group`, which has this index, to the windows that it overlaps: where a sensor
    /// is thresholds alone as they fire, of others the events that `slot` has.
    pub fn steps<'a>(
        &mut self,
        gpu: &Gpu,
        passes: &'a TriggerPasses,
        times: &Times,
        targets: &Targets,
        (group, index): (&Group, usize),
        slot: &Slot,
    ) -> Vec<TriggerStep<'a>> {
        let Self { output, groups, .. } = self;
        let (Some(own), Some(pass)) = (&mut groups[index], &passes.dense[group.targets]) else {
            return Vec::new();
        };
        let base_us = times.base_us;
        let end_us = times.ends_us.last().copied().unwrap_or(base_us);
        // A time may be rounded down to the submission's base, and the last instant is part of it.
        let windows = output.window_of(base_us)..=output.window_of(end_us);
        let first = *windows.start();
        // A step takes two.
        own.open_until(gpu, *windows.end() + 1, first);
        let mut steps = Vec::new();
        for window in windows.step_by(2) {
            let place = (window - first) as u64 * UNIFORM_ALIGNMENT;
            let (start_us, end_us) = output.interval(window);
            let bounds = WindowBounds { start: (start_us - base_us) as i32, end: (end_us - base_us) as i32 };
            gpu.queue.write_buffer(&own.windows, place, bytemuck::bytes_of(&bounds));
            let Some(at) = own.open.iter().position(|(index, _)| *index == window) else { continue };
            let [dense, after] = [at, at + 1].map(|at| own.open[at].1.as_entire_binding());
            let interval = pass::part(&own.windows, place, size_of::<WindowBounds>() as u64);
            let texture = wgpu::BindingResource::TextureView;
            let (declared, resources) = match &*passes.walks[group.targets] {
                WalkPasses::Ideal { .. } => (
                    EMIT_DENSE_BINDINGS,
                    vec![
                        slot.params.as_entire_binding(),
                        texture(&group.sensors),
                        texture(targets.mean_layers()),
                        texture(&group.memory[group.parity]),
                        texture(&group.memory[1 - group.parity]),
                        group.status.as_entire_binding(),
                        interval,
                        dense,
                        after,
                        texture(&targets.tile_rates_view),
                    ],
                ),
                _ => (
                    CHAIN_DENSE_BINDINGS,
                    vec![
                        slot.params.as_entire_binding(),
                        targets.counts.as_entire_binding(),
                        targets.prefixes.as_entire_binding(),
                        targets.block_sums.as_entire_binding(),
                        group.status.as_entire_binding(),
                        slot.events.as_entire_binding(),
                        interval,
                        dense,
                        after,
                    ],
                ),
            };
            let bindings = pass::group(&gpu.device, "dense", &pass.layout, declared, resources);
            steps.push(TriggerStep::over_pixels(pass, bindings, targets, group));
        }
        steps
    }

    /// Records copies of the arrays of `group` whose windows end by `complete_us`, all of whose events are there. What is
    /// recorded must be submitted after what adds to them.
    pub fn read(
        &mut self,
        gpu: &Gpu,
        encoder: &mut Commands,
        group: usize,
        complete_us: i64,
    ) -> Vec<DenseReadback> {
        let Some(own) = &mut self.groups[group] else { return Vec::new() };
        let mut read = Vec::new();
        let is_whole = |(window, _): &mut (i64, wgpu::Buffer)| self.output.interval(*window).1 <= complete_us;
        while let Some((window, dense)) = own.open.pop_front_if(is_whole) {
            let bytes = own.bytes();
            let staging = own.staging.pop().unwrap_or_else(|| {
                gpu.device.create_buffer(&wgpu::BufferDescriptor {
                    label: Some("dense arrays for the host"),
                    size: bytes,
                    usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
                    mapped_at_creation: false,
                })
            });
            encoder.copy_buffer_to_buffer(&dense, 0, &staging, 0, bytes);
            encoder.clear_buffer(&dense, 0, None);
            own.spare.push(dense);
            read.push(DenseReadback { group, window, staging });
        }
        read
    }

    /// Gives each view's place in its group, the window, and the words of its array.
    ///
    /// # Errors
    /// Memory that cannot be read.
    pub fn take(
        &mut self,
        readback: DenseReadback,
        mut use_view: impl FnMut(usize, i64, &[u32]),
    ) -> Result<(), EngineError> {
        let Some(own) = &mut self.groups[readback.group] else { return Ok(()) };
        {
            let bytes = readback
                .staging
                .get_mapped_range(..)
                .map_err(|e| EngineError::Device(format!("cannot read dense arrays back: {e}")))?;
            for (place, view) in bytes.chunks_exact(own.view_bytes as usize).enumerate() {
                let words = bytemuck::try_cast_slice(view)
                    .map_err(|e| EngineError::Device(format!("dense arrays came back misaligned: {e}")))?;
                use_view(place, readback.window, words);
            }
        }
        readback.staging.unmap();
        own.read_us = self.output.interval(readback.window).1;
        own.staging.push(readback.staging);
        Ok(())
    }

    /// Whether all windows of `group` that end by `until_us` were read back.
    pub fn is_read(&self, group: usize, until_us: i64) -> bool {
        let (start_us, _) = self.output.interval(self.output.window_of(until_us));
        self.groups[group].as_ref().is_none_or(|own| own.read_us >= start_us)
    }

    /// Records that nothing has fired in view `place` of `group` so far.
    pub fn clear(&self, encoder: &mut Commands, group: usize, place: usize) {
        let Some(own) = &self.groups[group] else { return };
        for (_, dense) in &own.open {
            encoder.clear_buffer(dense, place as u64 * own.view_bytes, Some(own.view_bytes));
        }
    }
}

impl GroupArrays {
    fn new(gpu: &Gpu, output: &DenseOutput, targets: &Targets, views: u64) -> Self {
        let pixels = u64::from(targets.width) * u64::from(targets.height);
        // Of a frame, polarities apart: the host takes their difference.
        let planes = match output.kind {
            DenseKind::EventFrame => 2,
            _ => output.kind.planes().iter().product::<usize>() as u64,
        };
        let windows = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("windows of dense arrays"),
            size: (MOST_WINDOWS as u64 + 2) * UNIFORM_ALIGNMENT,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        Self {
            open: VecDeque::new(),
            spare: Vec::new(),
            staging: Vec::new(),
            windows,
            view_bytes: 4 * planes * pixels,
            views,
            read_us: 0,
        }
    }

    const fn bytes(&self) -> u64 {
        self.view_bytes * self.views
    }

    /// Opens what is not open up to window `last`; where nothing is, from window `first` on.
    fn open_until(&mut self, gpu: &Gpu, last: i64, first: i64) {
        let next = self.open.back().map_or(first, |(window, _)| window + 1);
        for window in next..=last {
            let bytes = self.bytes();
            let dense = self.spare.pop().unwrap_or_else(|| {
                gpu.device.create_buffer(&wgpu::BufferDescriptor {
                    label: Some("dense arrays"),
                    size: bytes,
                    usage: wgpu::BufferUsages::STORAGE
                        | wgpu::BufferUsages::COPY_SRC
                        | wgpu::BufferUsages::COPY_DST,
                    mapped_at_creation: false,
                })
            });
            self.open.push_back((window, dense));
        }
    }
}
