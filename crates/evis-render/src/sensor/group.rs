//! Views that go through a submission together: what survives it, and where its events go.

use crate::config::grid::SampleGrid;
use crate::gpu::Gpu;
use crate::gpu::commands::Commands;
use crate::gpu::sizes::{self, BLOCK_PIXELS, WORKGROUP, padded_pixels, row_stride};
use crate::gpu::texture::{array, whole};
use crate::gpu::uniforms::{BlockParams, ScanParams, Status, TriggerParams, ViewSensor};
use crate::sensor::chain::{ChainPasses, GroupChain, TALLY_WORDS};
use crate::sensor::targets::Targets;

/// Some instants of one group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unit {
    /// Index of the group.
    pub group: usize,
    /// First instant; 0 sets the reference.
    pub first: i64,
    /// Instants.
    pub instants: u32,
}

impl Unit {
    /// Time that the unit's event times count from: the instant before its first.
    pub fn base_us(&self, grid: &SampleGrid) -> i64 {
        grid.instant_us((self.first - 1).max(0))
    }

    /// Time of its last instant.
    pub fn end_us(&self, grid: &SampleGrid) -> i64 {
        grid.instant_us(self.first + i64::from(self.instants) - 1)
    }

    /// The same instants in two halves of whole blocks, where there is more than one.
    pub fn halves(&self, block: u32) -> Option<[Self; 2]> {
        let front = self.instants / 2 / block * block;
        (front > 0).then(|| {
            [
                Self { instants: front, ..*self },
                Self { first: self.first + i64::from(front), instants: self.instants - front, ..*self },
            ]
        })
    }

    /// When its instants are. Where it `begins` there is no interval before the first one.
    pub fn times(&self, grid: &SampleGrid, begins: bool) -> Times {
        let base_us = if begins { grid.instant_us(self.first) } else { self.base_us(grid) };
        let instants = self.first..self.first + i64::from(self.instants);
        Times { base_us, ends_us: instants.map(|instant| grid.instant_us(instant)).collect(), begins }
    }
}

/// When the instants of a submission are, in microseconds of the stream.
#[derive(Clone, Debug)]
pub struct Times {
    /// Time that event times count from.
    pub base_us: i64,
    /// Of each instant.
    pub ends_us: Vec<i64>,
    /// It sets memories, and no pixel fires at the first of them.
    pub begins: bool,
}

impl Times {
    /// For the trigger, with room for `capacity` events of `views` views.
    pub fn params(&self, targets: &Targets, views: u32, capacity: u32) -> TriggerParams {
        let base = self.base_us;
        let mut spans = [[0; 4]; sizes::MAX_INSTANTS as usize];
        let mut before = 0;
        for (span, end_us) in spans.iter_mut().zip(&self.ends_us) {
            let t = (end_us - base) as u32;
            let since = base + i64::from(before);
            *span = [before, t - before, since as u32, (since >> 32) as u32];
            before = t;
        }
        TriggerParams {
            width: targets.width,
            height: targets.height,
            stride: row_stride(targets.width),
            view_count: views,
            lists: targets.chain.as_ref().map_or(0, |chain| chain.list_count),
            instants: self.ends_us.len() as u32,
            event_capacity: capacity,
            first: u32::from(self.begins),
            spans,
        }
    }
}

/// Views that go through one submission, and what survives it.
pub struct Group {
    /// Index of its class, hence of its targets and passes.
    pub targets: usize,
    /// Indices of its views, in view order.
    pub views: Vec<usize>,
    /// Old and new pixel memory, in turn: what survives a submission. Of thresholds alone a layer per view, whose texels
    /// are half a `PixelMemory`, half what counting tells emitting; of a chain a layer per plane and view.
    pub memory: [wgpu::TextureView; 2],
    /// Which of them is the old one.
    pub parity: usize,
    /// Status of its last submission.
    pub status: wgpu::Buffer,
    /// Per view a texel: [`ViewSensor`].
    pub sensors: wgpu::TextureView,
    /// Where each view's events start.
    pub view_offsets: wgpu::Buffer,
    /// What the whole chain needs, where it is on.
    pub chain: Option<GroupChain>,
    /// For the prefix within blocks.
    pub block_params: wgpu::Buffer,
    /// Of each view, whether it is reset at the one instant of the submission in work; empty where none is.
    pub beginning: Vec<bool>,
    /// First instant that was not submitted yet.
    pub next: i64,
    /// `Status::clamped` as last read: the device only adds to it.
    pub clamped: u32,
    /// `Status::unknown` as last read.
    pub unknown: u32,
    /// `Status::suppressed` as last read.
    pub suppressed: u32,
}

impl Group {
    /// Allocates for `views` (indices) of one class.
    pub fn new(
        gpu: &Gpu,
        targets_index: usize,
        targets: &Targets,
        views: Vec<usize>,
        sensors: &[ViewSensor],
        chain: Option<(&ChainPasses, GroupChain)>,
    ) -> Self {
        let buffer = |label, size, usage| {
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage: usage | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let storage = wgpu::BufferUsages::STORAGE;
        let pixels = u64::from(padded_pixels(targets.width, targets.height)) * views.len() as u64;
        let tallies = if chain.is_some() { 4 * u64::from(TALLY_WORDS) * views.len() as u64 } else { 0 };
        let view_count = views.len() as u32;
        let memory = || {
            let (format, layers) = match &chain {
                Some((passes, _)) => (wgpu::TextureFormat::R32Uint, passes.plan.planes.count),
                None => (wgpu::TextureFormat::Rgba32Uint, 1),
            };
            let size = [targets.width, targets.height, layers * view_count];
            let usage = wgpu::TextureUsages::STORAGE_BINDING
                | wgpu::TextureUsages::COPY_SRC
                | wgpu::TextureUsages::COPY_DST;
            whole(&array(&gpu.device, "pixel memory", size, format, usage))
        };
        let sensor_texels = array(
            &gpu.device,
            "sensors",
            [view_count, 1, 1],
            wgpu::TextureFormat::Rgba32Float,
            wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        );
        let group = Self {
            targets: targets_index,
            memory: [memory(), memory()],
            parity: 0,
            status: buffer(
                "status",
                size_of::<Status>() as u64 + tallies,
                storage | wgpu::BufferUsages::COPY_SRC,
            ),
            sensors: sensor_texels.create_view(&Default::default()),
            view_offsets: buffer(
                "view offsets",
                4 * (views.len() as u64 + 1),
                storage | wgpu::BufferUsages::COPY_SRC,
            ),
            block_params: buffer(
                "block params",
                size_of::<BlockParams>() as u64,
                wgpu::BufferUsages::UNIFORM,
            ),
            views,
            chain: chain.map(|(_, chain)| chain),
            beginning: Vec::new(),
            next: 0,
            clamped: 0,
            unknown: 0,
            suppressed: 0,
        };
        let block_count = (pixels / u64::from(BLOCK_PIXELS)) as u32;
        let row = sizes::dispatch(block_count, WORKGROUP).0 * WORKGROUP;
        group.write_sensors(gpu, sensors);
        gpu.queue.write_buffer(&group.block_params, 0, bytemuck::bytes_of(&BlockParams { block_count, row }));
        group
    }

    /// Says what the sensors of its views are from the next submission on.
    pub fn write_sensors(&self, gpu: &Gpu, sensors: &[ViewSensor]) {
        let texels = self.sensors.texture();
        gpu.queue.write_texture(
            texels.as_image_copy(),
            bytemuck::cast_slice(sensors),
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(size_of_val(sensors) as u32),
                rows_per_image: None,
            },
            texels.size(),
        );
    }

    /// Whether `unit` sets memories, and no pixel fires at its first instant.
    pub const fn begins(&self, unit: &Unit) -> bool {
        unit.first == 0 || !self.beginning.is_empty()
    }

    /// Records that views that are reset keep what the trigger has just written, and the others what they had.
    pub fn keep_beginning(&self, encoder: &mut Commands) {
        let (old, new) = (self.memory[self.parity].texture(), self.memory[1 - self.parity].texture());
        let views = self.views.len();
        let size = wgpu::Extent3d { depth_or_array_layers: 1, ..old.size() };
        for layer in 0..old.size().depth_or_array_layers {
            // A layer per plane and view.
            if self.beginning.get(layer as usize % views) != Some(&true) {
                continue;
            }
            let place = |texture| wgpu::TexelCopyTextureInfo {
                texture,
                mip_level: 0,
                origin: wgpu::Origin3d { x: 0, y: 0, z: layer },
                aspect: wgpu::TextureAspect::All,
            };
            encoder.copy_texture_to_texture(place(new), place(old), size);
        }
    }

    /// Bytes before the events in a staging buffer: status and view offsets.
    pub fn header_bytes(&self) -> u64 {
        (size_of::<Status>() as u64 + 4 * (self.views.len() as u64 + 1)).next_multiple_of(8)
    }
}

/// Where a submission's events go: a device buffer, and one that the host maps.
pub struct Slot {
    /// Events on the device.
    pub events: wgpu::Buffer,
    /// Status, view offsets, events for the host.
    pub staging: wgpu::Buffer,
    /// For walks.
    pub params: wgpu::Buffer,
    /// For offsets of blocks.
    pub scan_params: wgpu::Buffer,
    /// Noise candidates (chain only).
    pub feed: Option<wgpu::Buffer>,
    /// Events that fit.
    pub capacity: u32,
    header_capacity: u64,
}

impl Slot {
    /// Allocates for `capacity` events after `header` bytes.
    pub fn new(device: &wgpu::Device, capacity: u32, header: u64) -> Self {
        let buffer = |label, size, usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage,
                mapped_at_creation: false,
            })
        };
        let copy_to = wgpu::BufferUsages::COPY_DST;
        let uniform = wgpu::BufferUsages::UNIFORM | copy_to;
        Self {
            events: buffer(
                "events",
                u64::from(capacity) * 8,
                wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
            ),
            staging: buffer(
                "events for the host",
                header + u64::from(capacity) * 8,
                wgpu::BufferUsages::MAP_READ | copy_to,
            ),
            params: buffer("trigger params", size_of::<TriggerParams>() as u64, uniform),
            scan_params: buffer("scan params", size_of::<ScanParams>() as u64, uniform),
            feed: None,
            capacity,
            header_capacity: header,
        }
    }

    /// Hands `words` over to the chain.
    pub fn feed(&mut self, gpu: &Gpu, words: &[u32]) {
        let bytes = size_of_val(words) as u64;
        if self.feed.as_ref().is_none_or(|feed| feed.size() < bytes) {
            self.feed = Some(gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("candidates"),
                // Half as much again: the next one is a little longer now and then.
                size: (bytes + bytes / 2).next_multiple_of(4),
                usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            }));
        }
        if let Some(feed) = &self.feed {
            gpu.queue.write_buffer(feed, 0, bytemuck::cast_slice(words));
        }
    }

    /// Whether it has room for `capacity` events after `header` bytes.
    pub fn fits(&self, capacity: u32, header: u64) -> bool {
        self.capacity >= capacity && self.header_capacity >= header
    }
}
