//! Stages of sensors on a device, for light that pixels of decoupled sampling have found there: light stays, events come down.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use evis_core::Event;
use evis_core::SensorConfig;
use evis_core::emulator::tiled::Losses;
use evis_core::random::Key;
use evis_decoupled::packed::{LIGHT_BEGINS, Seen};
use evis_decoupled::{Error, ViewSensor};

use crate::config::dense::DenseOutput;
use crate::gpu::Gpu;
use crate::gpu::commands::Commands;
use crate::gpu::readback::{map, read, wait_mapped};
use crate::gpu::sizes::{self, DeviceLimits, MethodNeeds, Plan};
use crate::gpu::texture::{array, whole};
use crate::gpu::uniforms::Status;
use crate::output::dense;
use crate::output::packet::DenseWindow;
use crate::pass::raster::LUMINANCE_FORMAT;
use crate::raster::layers::LayerUse;
use crate::sensor::chain::GroupChain;
use crate::sensor::dense::DenseArrays;
use crate::sensor::group::{Group, Slot, Times};
use crate::sensor::passes::{TriggerPasses, share_passes};
use crate::sensor::step::encode_trigger;
use crate::sensor::targets::Targets;
use crate::sensor::trigger::{clear_tallies, steps_at};
use crate::sensor::unpack;

/// Numbers of light in a row of its texture, and rows in a layer, as powers of two; `chain/own_times.wgsl` has the same constant.
pub(crate) const LIGHT_SHIFT: u32 = 10;
const LIGHT_SIDE: u32 = 1 << LIGHT_SHIFT;
/// Bytes that must be there behind light that is kept.
pub(super) const LIGHT_ROW_BYTES: u64 = 4 * LIGHT_SIDE as u64;
/// Events that a group's buffer holds at first.
const FIRST_CAPACITY: u32 = 1 << 16;

/// Dense arrays that stages have made, until packets carry them.
#[derive(Debug, Default)]
pub(super) struct MadeArrays {
    /// By view of the stream, windows in order; `None` of a view whose events come to the host.
    views: Vec<Option<VecDeque<DenseWindow>>>,
    /// Events in them.
    events: u64,
}

impl MadeArrays {
    /// The windows of view `view` that end by `until_us`; `None` where none are made.
    pub fn take(&mut self, view: usize, until_us: i64) -> Option<Vec<DenseWindow>> {
        let windows = self.views.get_mut(view)?.as_mut()?;
        let count = windows.iter().take_while(|window| window.end_us <= until_us).count();
        Some(windows.drain(..count).collect())
    }

    /// Whether arrays are made of the events of view `view`.
    pub fn makes(&self, view: usize) -> bool {
        self.views.get(view).is_some_and(Option::is_some)
    }

    /// How many events there were since it was asked last.
    pub fn take_count(&mut self) -> u64 {
        std::mem::take(&mut self.events)
    }
}

/// Which arrays are wanted of events, and where they go.
pub(super) type Wanted<'a> = (DenseOutput, &'a Arc<Mutex<MadeArrays>>);

/// The stages of views.
pub(super) struct Stages {
    gpu: Gpu,
    dense: Option<DenseArrays>,
    made: Arc<Mutex<MadeArrays>>,
    passes: TriggerPasses,
    /// By class of views.
    targets: Vec<Targets>,
    groups: Vec<Stage>,
    /// By view of the stream: index of its group, and its place there.
    places: Vec<Option<[usize; 2]>>,
    /// Light, number by number.
    light: wgpu::Texture,
    /// How many numbers there are of it, and how many there may be before they are taken.
    light_count: u32,
    most_light: u32,
}

/// Views that go through stages together.
struct Stage {
    group: Group,
    views: Vec<ViewSensor>,
    /// What each pixel sees, a layer per view.
    seen: wgpu::TextureView,
    slot: Slot,
    /// Views whose pixels begin.
    beginning: Vec<Option<Beginning>>,
    /// Per view, stream time before which all of its events are there.
    complete_us: Vec<i64>,
}

/// How the pixels of a view begin.
#[derive(Clone, Copy)]
struct Beginning {
    /// When, in microseconds of the stream.
    t_us: i64,
    /// Number of their first light.
    first: u32,
    /// What is frozen in them, and their noise, are others than before.
    redrawn: bool,
}

/// When blocks of a group's views are, as its views have it, and in whole microseconds of the stream.
struct Blocks {
    words: Vec<[u32; 4]>,
    spans_us: Vec<Option<(i64, i64)>>,
    base_us: i64,
    end_us: i64,
}

impl Blocks {
    /// By place, from starts and ends in microseconds of the stream; a view without one rests.
    fn new(spans_us: &[Option<[f64; 2]>]) -> Self {
        let whole = |t_us: f64| (t_us + 0.5).floor() as i64;
        let firsts = spans_us.iter().flatten().map(|[from, _]| from.floor() as i64);
        let base_us = firsts.min().unwrap_or(0);
        let word = |span: &Option<[f64; 2]>| {
            let Some([from, to]) = *span else { return [0; 4] };
            let [rest, length] = [from - from.floor(), to - from].map(|v| (v as f32).to_bits());
            [(from.floor() as i64 - base_us) as u32, rest, length, (whole(to) - base_us) as u32]
        };
        let in_stream = |span: &Option<[f64; 2]>| span.map(|[from, to]| (whole(from), whole(to)));
        let spans: Vec<_> = spans_us.iter().map(in_stream).collect();
        let end_us = spans.iter().flatten().map(|(_, end)| *end).max().unwrap_or(base_us);
        Self { words: spans_us.iter().map(word).collect(), spans_us: spans, base_us, end_us }
    }

    fn times(&self, begins: bool) -> Times {
        Times { base_us: self.base_us, ends_us: vec![self.end_us], begins }
    }
}

/// What is locked for a moment only.
pub(super) fn lock(made: &Mutex<MadeArrays>) -> MutexGuard<'_, MadeArrays> {
    made.lock().unwrap_or_else(PoisonError::into_inner)
}

fn failed(error: impl std::fmt::Display) -> Error {
    Error::Device(error.to_string())
}

/// A view's sensor and key.
fn sensing(view: &ViewSensor) -> (&SensorConfig, Key) {
    (&view.sensor, view.key)
}

impl Stages {
    /// Those of the `views` of a stream whose sensors have more stages than thresholds, in continuous time; `None` where there are
    /// none, or a view of them does not fit the device.
    /// Events become arrays where these are `wanted`, no block is longer than `longest_us`, and they leave their
    /// sensor at once. Stages take light when there are more than `most_light` numbers of it.
    pub fn new(
        gpu: &Gpu,
        views: &[ViewSensor],
        wanted: Option<Wanted>,
        (longest_us, most_light): (f64, u32),
    ) -> Option<Self> {
        let device = &gpu.device;
        let mut classes: Vec<Vec<usize>> = Vec::new();
        for (index, view) in views.iter().enumerate() {
            if view.sensor.is_ideal() || view.sensor.needs_frames().is_some() {
                continue;
            }
            let alike = |class: &&mut Vec<usize>| {
                let first = &views[class[0]];
                first.size == view.size && share_passes(&first.sensor, &view.sensor)
            };
            match classes.iter_mut().find(alike) {
                Some(class) => class.push(index),
                None => classes.push(vec![index]),
            }
        }
        if classes.is_empty() {
            return None;
        }
        let sensors: Vec<&SensorConfig> = classes.iter().map(|class| &views[class[0]].sensor).collect();
        let kind = wanted.map(|(output, _)| output.kind);
        let passes = TriggerPasses::with_own_times(device, &sensors, kind.as_ref());
        let mut own = Self {
            gpu: gpu.clone(),
            dense: None,
            made: wanted.map_or_else(Default::default, |(_, made)| Arc::clone(made)),
            passes,
            targets: Vec::new(),
            groups: Vec::new(),
            places: vec![None; views.len()],
            light: light(device, 1),
            light_count: 0,
            most_light,
        };
        for (number, class) in classes.iter().enumerate() {
            let [width, height] = views[class[0]].size;
            let plan = &own.passes.chain(number)?.plan;
            let needs = MethodNeeds {
                bytes: plan.view_bytes(width, height),
                layers: plan.planes.count,
                keeps: true,
                ..MethodNeeds::default()
            };
            let limits = DeviceLimits::of(device);
            let sizes = sizes::plan(width, height, 1, class.len() as u32, 1, needs, limits)?;
            // Light lies elsewhere.
            let sizes = Plan { layers: 1, ..sizes };
            own.targets.push(Targets::new(device, width, height, sizes, LayerUse::Computed, Some(plan), 1));
            for members in class.chunks(sizes.views_per_group as usize) {
                for (place, view) in members.iter().enumerate() {
                    own.places[*view] = Some([own.groups.len(), place]);
                }
                let views = members.iter().map(|view| (*view, views[*view].clone())).collect();
                own.groups.push(Stage::new(gpu, &own.passes, (number, &own.targets[number]), views)?);
            }
        }
        if let Some((output, _)) = wanted {
            let groups: Vec<&Group> = own.groups.iter().map(|stage| &stage.group).collect();
            own.dense = DenseArrays::new(gpu, output, longest_us, &own.passes, &own.targets, &groups);
        }
        let makes = |view: usize| own.dense.as_ref().is_some_and(|dense| dense.makes_view(view));
        *lock(&own.made) = MadeArrays {
            views: (0..views.len()).map(|view| makes(view).then(VecDeque::new)).collect(),
            events: 0,
        };
        Some(own)
    }

    /// Makes room for `count` more numbers of light; the number of the first. They take whole rows.
    fn reserve(&mut self, count: u32) -> Result<u32, Error> {
        let first = self.light_count;
        let row = u64::from(LIGHT_SIDE);
        let needed = (u64::from(first) + u64::from(count)).next_multiple_of(row);
        let layers = needed.div_ceil(row * row);
        let most = u64::from(self.gpu.device.limits().max_texture_array_layers);
        if layers > most || needed > u64::from(u32::MAX) {
            return Err(Error::Device(format!(
                "light of a block takes {} million numbers, and a texture of {} holds {} million; choose a smaller picture or slower motion, \
                 or let the processor follow pixels",
                needed >> 20,
                self.gpu.summary().name,
                most
            )));
        }
        let known = self.light.depth_or_array_layers();
        if layers > u64::from(known) {
            let grown = light(&self.gpu.device, layers.next_power_of_two().min(most) as u32);
            let mut commands = Commands::new(&self.gpu, "light that stays");
            commands.copy_texture_to_texture(
                self.light.as_image_copy(),
                grown.as_image_copy(),
                self.light.size(),
            );
            commands.submit(&self.gpu);
            self.light = grown;
        }
        self.light_count = needed as u32;
        Ok(first)
    }

    /// Records that `count` numbers of light are kept, which lie from byte `offset` of `buffer` on, with a row more behind them; the
    /// number of the first.
    pub fn keep(
        &mut self,
        commands: &mut Commands,
        (buffer, offset): (&wgpu::Buffer, u64),
        count: u32,
    ) -> Result<u32, Error> {
        let first = self.reserve(count)?;
        for (row, rows, texture) in parts(&self.light, first, count) {
            let layout = rows_at(offset + u64::from(row) * LIGHT_ROW_BYTES, LIGHT_ROW_BYTES as u32);
            let source = wgpu::TexelCopyBufferInfo { buffer, layout };
            commands.copy_buffer_to_texture(source, texture, rows);
        }
        Ok(first)
    }

    /// The same of light from here.
    fn write(&mut self, light: &[f32]) -> Result<u32, Error> {
        let count = light.len() as u32;
        let first = self.reserve(count)?;
        let mut rows_of = light.to_vec();
        rows_of.resize(light.len().next_multiple_of(LIGHT_SIDE as usize), 0.0);
        for (row, rows, texture) in parts(&self.light, first, count) {
            let values = &rows_of[(row * LIGHT_SIDE) as usize..][..(rows.height * LIGHT_SIDE) as usize];
            let layout = rows_at(0, LIGHT_ROW_BYTES as u32);
            self.gpu.queue.write_texture(texture, bytemuck::cast_slice(values), layout, rows);
        }
        Ok(first)
    }
}

impl evis_decoupled::Stages for Stages {
    fn has(&self, view: usize, own: &ViewSensor) -> bool {
        let place = self.places.get(view).copied().flatten();
        place.is_some_and(|[group, place]| share_passes(&self.groups[group].views[place].sensor, &own.sensor))
    }

    fn light_count(&self) -> u32 {
        self.light_count
    }

    fn is_full(&self) -> bool {
        self.light_count > self.most_light
    }

    fn begin(&mut self, view: usize, own: &ViewSensor, t_us: i64, light: &[f32]) -> Result<(), Error> {
        let Some([index, place]) = self.places[view] else { return Ok(()) };
        let first = self.write(light)?;
        let stage = &mut self.groups[index];
        let known = &stage.views[place];
        let redrawn = known.sensor != own.sensor || known.key != own.key;
        stage.views[place] = own.clone();
        stage.beginning[place] = Some(Beginning { t_us, first, redrawn });
        Ok(())
    }

    fn sense(&mut self, views: &[Seen], more: &[f32]) -> Result<(Vec<Vec<Event>>, Losses), Error> {
        let _span = tracing::trace_span!("stages of sensors", views = views.len()).entered();
        self.write(more)?;
        let light = whole(&self.light);
        let mut fired = vec![Vec::new(); views.len()];
        let mut losses = Losses::default();
        for index in 0..self.groups.len() {
            let Self { gpu, passes, targets, groups, places, dense, made, .. } = &mut *self;
            let stage = &mut groups[index];
            let targets = &mut targets[stage.group.targets];
            // In the place of what is rendered, and of how often tiles are: see `chain/own_times.wgsl`.
            targets.layers.array = light.clone();
            targets.tile_rates_view = stage.seen.clone();
            stage.begin_views(gpu, passes, (targets, index), dense.as_ref())?;
            let mut of = vec![None; stage.views.len()];
            for (number, seen) in views.iter().enumerate() {
                if let Some([group, place]) = places[seen.view]
                    && group == index
                {
                    of[place] = Some(number);
                }
            }
            if of.iter().all(Option::is_none) {
                continue;
            }
            let own: Vec<Option<&Seen>> =
                of.iter().map(|number| number.map(|number| &views[number])).collect();
            let (events, lost) = stage.take(gpu, passes, (targets, index), &own, (dense.as_mut(), made))?;
            losses.add(lost);
            for (number, events) in of.iter().zip(events) {
                if let Some(number) = number {
                    fired[*number] = events;
                }
            }
        }
        self.light_count = 0;
        Ok((fired, losses))
    }
}

/// Rows of so many bytes, from byte `offset` of a buffer on.
fn rows_at(offset: u64, bytes: u32) -> wgpu::TexelCopyBufferLayout {
    wgpu::TexelCopyBufferLayout { offset, bytes_per_row: Some(bytes), rows_per_image: None }
}

/// A texture of light, of so many layers.
fn light(device: &wgpu::Device, layers: u32) -> wgpu::Texture {
    let usage =
        wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::COPY_DST | wgpu::TextureUsages::COPY_SRC;
    array(device, "light that stays", [LIGHT_SIDE, LIGHT_SIDE, layers], LUMINANCE_FORMAT, usage)
}

/// Rows of `count` numbers from number `first` on, which begins a row, layer by layer: the number of the first row, how many, and where
/// they lie.
fn parts(
    texture: &wgpu::Texture,
    first: u32,
    count: u32,
) -> impl Iterator<Item = (u32, wgpu::Extent3d, wgpu::TexelCopyTextureInfo<'_>)> {
    let (from, rows) = (first / LIGHT_SIDE, count.div_ceil(LIGHT_SIDE));
    let mut row = 0;
    std::iter::from_fn(move || {
        (row < rows).then(|| {
            let (y, z) = ((from + row) % LIGHT_SIDE, (from + row) / LIGHT_SIDE);
            let height = (rows - row).min(LIGHT_SIDE - y);
            let size = wgpu::Extent3d { width: LIGHT_SIDE, height, depth_or_array_layers: 1 };
            let origin = wgpu::Origin3d { x: 0, y, z };
            let place = wgpu::TexelCopyTextureInfo { origin, ..texture.as_image_copy() };
            let part = (row, size, place);
            row += height;
            part
        })
    })
}

impl Stage {
    /// `None` where there are no passes of class `class`.
    fn new(
        gpu: &Gpu,
        passes: &TriggerPasses,
        (class, targets): (usize, &Targets),
        views: Vec<(usize, ViewSensor)>,
    ) -> Option<Self> {
        let own = passes.chain(class)?;
        let (members, views): (Vec<usize>, Vec<ViewSensor>) = views.into_iter().unzip();
        let size @ [width, height] = [targets.width, targets.height];
        let sensors: Vec<_> = views.iter().map(sensing).collect();
        let reference = views.first()?.reference_luminance;
        let chain = GroupChain::new(gpu, &own.plan, size, &sensors, reference);
        let count = views.len();
        // Thresholds and all else of views are the chain's.
        let thresholds = vec![Default::default(); count];
        let group = Group::new(gpu, class, targets, members, &thresholds, Some((own, chain)));
        let seen = array(
            &gpu.device,
            "what pixels see",
            [width, height, count as u32],
            wgpu::TextureFormat::Rg32Uint,
            wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        );
        let slot = Slot::new(&gpu.device, FIRST_CAPACITY, group.header_bytes());
        Some(Self {
            group,
            seen: whole(&seen),
            slot,
            beginning: vec![None; count],
            complete_us: vec![0; count],
            views,
        })
    }

    /// Says what the pixels of the view at `place` see.
    fn write_seen(&self, gpu: &Gpu, place: usize, pixels: &[[u32; 2]]) {
        let texture = self.seen.texture();
        let origin = wgpu::Origin3d { x: 0, y: 0, z: place as u32 };
        let size = wgpu::Extent3d { depth_or_array_layers: 1, ..texture.size() };
        let layout = rows_at(0, size.width * size_of::<[u32; 2]>() as u32);
        let place = wgpu::TexelCopyTextureInfo { origin, ..texture.as_image_copy() };
        gpu.queue.write_texture(place, bytemuck::cast_slice(pixels), layout, size);
    }

    /// Lets views begin that are to; nothing has fired in them so far.
    fn begin_views(
        &mut self,
        gpu: &Gpu,
        passes: &TriggerPasses,
        (targets, index): (&Targets, usize),
        dense: Option<&DenseArrays>,
    ) -> Result<(), Error> {
        if self.beginning.iter().all(Option::is_none) {
            return Ok(());
        }
        let beginning = std::mem::replace(&mut self.beginning, vec![None; self.views.len()]);
        let redrawn: Vec<bool> = beginning.iter().map(|own| own.is_some_and(|own| own.redrawn)).collect();
        if redrawn.contains(&true)
            && let (Some(passes), Some(chain)) = (passes.chain(self.group.targets), &mut self.group.chain)
        {
            let (own, first): (Vec<_>, _) = (self.views.iter().map(sensing).collect(), &self.views[0]);
            let fresh = GroupChain::new(gpu, &passes.plan, first.size, &own, first.reference_luminance);
            chain.reset_views(fresh, &redrawn);
        }
        let pixels = targets.width * targets.height;
        let mut commands = Commands::new(gpu, "reset of dense arrays");
        for (place, own) in beginning.iter().enumerate().filter_map(|(k, own)| Some((k, (*own)?))) {
            let numbers = own.first..own.first + pixels;
            let seen: Vec<_> = numbers.map(|number| [number, LIGHT_BEGINS]).collect();
            self.write_seen(gpu, place, &seen);
            if let Some(dense) = dense {
                dense.clear(&mut commands, index, place);
            }
        }
        commands.submit(gpu);
        // Some microsecond of length: what has none rests.
        let span = |own: &Option<Beginning>| own.map(|own| [own.t_us as f64, own.t_us as f64 + 1.0]);
        let blocks = Blocks::new(&beginning.iter().map(span).collect::<Vec<_>>());
        self.run(gpu, passes, (targets, index), (&blocks, true), None)?;
        Ok(())
    }

    /// Takes the light of blocks of views, by place.
    fn take(
        &mut self,
        gpu: &Gpu,
        passes: &TriggerPasses,
        (targets, index): (&Targets, usize),
        views: &[Option<&Seen>],
        (mut dense, made): (Option<&mut DenseArrays>, &Mutex<MadeArrays>),
    ) -> Result<(Vec<Vec<Event>>, Losses), Error> {
        for (place, seen) in views.iter().enumerate().filter_map(|(k, seen)| Some((k, (*seen)?))) {
            self.write_seen(gpu, place, &seen.pixels);
        }
        let spans: Vec<_> = views.iter().map(|seen| seen.map(|seen| seen.span_us)).collect();
        let blocks = Blocks::new(&spans);
        let chain = self.group.chain.as_mut();
        let feed = chain.map(|chain| chain.feed_within(blocks.base_us, |place| blocks.spans_us[place]));
        if let Some(words) = &feed {
            self.slot.feed(gpu, words);
        }
        let (status, bytes) =
            self.run(gpu, passes, (targets, index), (&blocks, false), dense.as_deref_mut())?;
        let losses = Losses {
            clamped: status.clamped.into(),
            suppressed: status.suppressed.into(),
            ..Losses::default()
        };
        for (complete_us, seen) in self.complete_us.iter_mut().zip(views) {
            *complete_us = seen.map_or(*complete_us, |seen| seen.span_us[1].floor() as i64);
        }
        if let Some(dense) = dense.filter(|dense| dense.makes(index)) {
            lock(made).events += u64::from(status.event_count);
            self.collect(gpu, (dense, made), (targets, index))?;
            return Ok((vec![Vec::new(); views.len()], losses));
        }
        let (offsets, records) = bytes.split_at(4 * (views.len() + 1));
        let offsets: Vec<u32> = bytemuck::pod_collect_to_vec(offsets);
        let records: Vec<[u32; 2]> = bytemuck::pod_collect_to_vec(records);
        let of =
            |ends: &[u32]| unpack::events(&records[ends[0] as usize..ends[1] as usize], blocks.base_us, true);
        Ok((offsets.windows(2).map(of).collect(), losses))
    }

    /// Collects the arrays of windows all of whose events are there.
    fn collect(
        &self,
        gpu: &Gpu,
        (dense, made): (&mut DenseArrays, &Mutex<MadeArrays>),
        (targets, index): (&Targets, usize),
    ) -> Result<(), Error> {
        let complete_us = self.complete_us.iter().copied().min().unwrap_or(0);
        let mut commands = Commands::new(gpu, "dense arrays");
        let read = dense.read(gpu, &mut commands, index, complete_us);
        if read.is_empty() {
            return Ok(());
        }
        let submission = commands.submit(gpu);
        let output = *dense.output();
        for readback in read {
            wait_mapped(gpu, &submission, &map(&readback.staging)).map_err(failed)?;
            let taken = dense.take(readback, |place, window, words| {
                let made_of = dense::of_words(&output, window, words, (targets.width, targets.height));
                if let Some(Some(windows)) = lock(made).views.get_mut(self.group.views[place]) {
                    windows.push_back(made_of);
                }
            });
            taken.map_err(failed)?;
        }
        Ok(())
    }

    /// Goes through the stages; the status, and bytes of view offsets and, unless they become `dense` arrays, events.
    fn run(
        &mut self,
        gpu: &Gpu,
        passes: &TriggerPasses,
        (targets, index): (&Targets, usize),
        (blocks, begins): (&Blocks, bool),
        mut dense: Option<&mut DenseArrays>,
    ) -> Result<(Status, Vec<u8>), Error> {
        if let Some(chain) = &mut self.group.chain {
            chain.write_blocks(gpu, blocks.words.iter().copied());
        }
        let header = size_of::<Status>() as u64;
        let offsets = 4 * (self.views.len() as u64 + 1);
        loop {
            gpu.queue.write_buffer(&self.group.status, 0, bytemuck::bytes_of(&Status::default()));
            let mut commands = Commands::new(gpu, "stages of sensors");
            let times = blocks.times(begins);
            let steps = steps_at(
                gpu,
                passes,
                &times,
                targets,
                (&self.group, index),
                &self.slot,
                dense.as_deref_mut(),
            );
            clear_tallies(&mut commands, &self.group);
            encode_trigger(&mut commands, &steps);
            let head = [(&self.group.status, 0..header), (&self.group.view_offsets, 0..offsets)];
            let bytes = read(gpu, commands, &head).map_err(failed)?;
            let status: Status = bytemuck::pod_read_unaligned(&bytes[..header as usize]);
            if status.mismatched > 0 {
                return Err(failed(format!(
                    "{} pixels fired other events than were counted: the driver computes the same expression in two ways; \
                     please report device and driver",
                    status.mismatched
                )));
            }
            if status.stalled != 0 {
                self.grow(gpu, status.event_count)?;
                continue;
            }
            self.group.parity = 1 - self.group.parity;
            let mut all = bytes[header as usize..].to_vec();
            if status.event_count > 0 && !dense.as_ref().is_some_and(|dense| dense.makes(index)) {
                let events = [(&self.slot.events, 0..u64::from(status.event_count) * 8)];
                let commands = Commands::new(gpu, "events of stages");
                all.extend(read(gpu, commands, &events).map_err(failed)?);
            }
            return Ok((status, all));
        }
    }

    /// Makes room for `count` events; what candidates there are stays.
    fn grow(&mut self, gpu: &Gpu, count: u32) -> Result<(), Error> {
        let most = DeviceLimits::of(&gpu.device).storage_binding / 8;
        if u64::from(count) > most {
            return Err(failed(format!(
                "{count} events in one block, and this device's buffers hold {most}; raise the thresholds, or follow fewer \
                 cameras at once"
            )));
        }
        let capacity = u64::from(count.saturating_add(count / 4).next_power_of_two()).min(most) as u32;
        let feed = self.slot.feed.take();
        self.slot = Slot::new(&gpu.device, capacity, self.group.header_bytes());
        self.slot.feed = feed;
        Ok(())
    }
}
