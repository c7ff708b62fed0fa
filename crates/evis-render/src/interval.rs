//! One submission: some instants of a group of views, from poses to events in a staging buffer.

use crate::area::Rect;
use crate::audit::AuditRun;
use crate::chain::{ChainPasses, GroupChain, TALLY_WORDS, Walk};
use crate::engine::Context;
use crate::geometry::attachment;
use crate::gpu::Gpu;
use crate::gpu_scene::{Draw, DrawItem, Part};
use crate::grid::SampleGrid;
use crate::method::Sampling;
use crate::pass::raster::Pipelines;
use crate::pass::trigger::{
    BLOCK_BINDINGS, CHAIN_BINDINGS, COUNT_BINDINGS, EMIT_BINDINGS, KEPT_BINDINGS, RESOLVE_BINDINGS,
    SCAN_BINDINGS, TriggerPasses, WalkPasses,
};
use crate::pass::{self, ComputePass};
use crate::sizes::{self, BLOCK_PIXELS, WORKGROUP, padded_pixels, row_stride};
use crate::targets::{Layers, Targets, array, whole};
use crate::uniforms::{BlockParams, ScanParams, Status, TriggerParams, ViewSensor};
use crate::variant::INSTANCE_SLOT;

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

    fn params(&self, grid: &SampleGrid, targets: &Targets, views: u32, capacity: u32) -> TriggerParams {
        let base = self.base_us(grid);
        let mut spans = [[0; 4]; sizes::MAX_INSTANTS as usize];
        let mut before = 0;
        for (i, span) in spans.iter_mut().enumerate().take(self.instants as usize) {
            let t = (grid.instant_us(self.first + i as i64) - base) as u32;
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
            instants: self.instants,
            event_capacity: capacity,
            first: u32::from(self.first == 0),
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
    sensors: wgpu::TextureView,
    /// Where each view's events start.
    pub view_offsets: wgpu::Buffer,
    /// What the whole chain needs, where it is on.
    pub chain: Option<GroupChain>,
    block_params: wgpu::Buffer,
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
            let usage = wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::COPY_SRC;
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
            next: 0,
            clamped: 0,
            unknown: 0,
            suppressed: 0,
        };
        let block_count = (pixels / u64::from(BLOCK_PIXELS)) as u32;
        let row = sizes::dispatch(block_count, WORKGROUP).0 * WORKGROUP;
        let queue = &gpu.queue;
        queue.write_texture(
            sensor_texels.as_image_copy(),
            bytemuck::cast_slice(sensors),
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(size_of_val(sensors) as u32),
                rows_per_image: None,
            },
            sensor_texels.size(),
        );
        queue.write_buffer(&group.block_params, 0, bytemuck::bytes_of(&BlockParams { block_count, row }));
        group
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
    params: wgpu::Buffer,
    scan_params: wgpu::Buffer,
    /// When noise may strike (chain only).
    feed: Option<wgpu::Buffer>,
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
                label: Some("strikes"),
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

/// Records one interval: the table of contents of a submission.
#[expect(clippy::too_many_arguments, reason = "the rooms of an interval, in order")]
pub fn encode(
    context: &mut Context,
    sampling: &mut Sampling,
    encoder: &mut wgpu::CommandEncoder,
    targets: &Targets,
    group: &Group,
    unit: &Unit,
    slot: &Slot,
    predicted: u32,
) -> Option<AuditRun> {
    // What the pixels see at every instant, by whatever method.
    let audit = sampling.encode(context, encoder, targets, group, unit);
    // What they feel.
    let steps = trigger_steps(&context.gpu, &context.trigger, &context.grid, targets, group, unit, slot);
    clear_tallies(encoder, group);
    encode_trigger(encoder, &steps);
    // What the host gets.
    let header = size_of::<Status>() as u64;
    encoder.copy_buffer_to_buffer(&group.status, 0, &slot.staging, 0, header);
    let offsets = 4 * (group.views.len() as u64 + 1);
    encoder.copy_buffer_to_buffer(&group.view_offsets, 0, &slot.staging, header, offsets);
    let bytes = u64::from(predicted.min(slot.capacity)) * 8;
    encoder.copy_buffer_to_buffer(&slot.events, 0, &slot.staging, group.header_bytes(), bytes);
    audit
}

/// No pixel of a chain has asked for events or woken yet.
pub fn clear_tallies(encoder: &mut wgpu::CommandEncoder, group: &Group) {
    if group.chain.is_some() {
        encoder.clear_buffer(&group.status, size_of::<Status>() as u64, None);
    }
}

/// Copies `rect` of layers, from one texture's first to the other's: `count` of them.
pub fn copy_layers(
    encoder: &mut wgpu::CommandEncoder,
    from: (&wgpu::Texture, u32),
    to: (&wgpu::Texture, u32),
    count: u32,
    rect: Rect,
) {
    let place = |(texture, layer): (_, u32)| wgpu::TexelCopyTextureInfo {
        texture,
        mip_level: 0,
        origin: wgpu::Origin3d { x: rect.low[0], y: rect.low[1], z: layer },
        aspect: wgpu::TextureAspect::All,
    };
    let [width, height] = rect.size();
    let size = wgpu::Extent3d { width, height, depth_or_array_layers: count };
    encoder.copy_texture_to_texture(place(from), place(to), size);
}

/// Renders `frame`, or `parts` of it, sample by sample, into the layers from `first_layer` on; what lies outside of the
/// parts is left as cleared.
pub fn encode_luminance(
    context: &Context,
    encoder: &mut wgpu::CommandEncoder,
    layers: &Layers,
    frame_group: &wgpu::BindGroup,
    frame: u32,
    first_layer: u32,
    parts: Option<&[Part]>,
) {
    let everything =
        || vec![(Rect::whole(layers.width, layers.height), &context.frame_data.visible[frame as usize][..])];
    let parts = parts.map_or_else(everything, borrowed);
    encode_samples(context, encoder, (layers, first_layer), frame_group, (frame, 0), &parts);
}

/// Renders the samples of `parts` of `frame`, from `first_sample` on, into the layers from `first_layer` on.
pub fn encode_samples(
    context: &Context,
    encoder: &mut wgpu::CommandEncoder,
    (layers, first_layer): (&Layers, u32),
    frame_group: &wgpu::BindGroup,
    (frame, first_sample): (u32, u32),
    parts: &[(Rect, &[DrawItem])],
) {
    for (sample, layer) in (0..context.offsets.len() as u32).zip(&layers.each[first_layer as usize..]) {
        let into = (layers, first_layer + sample);
        encode_sample(context, encoder, into, frame_group, (frame, first_sample + sample), parts);
        if let Some(samples) = &layers.multisampled {
            encode_resolve(context, encoder, layers, samples, layer);
        }
    }
}

/// `parts`, as [`encode_sample`] takes them.
pub fn borrowed(parts: &[Part]) -> Vec<(Rect, &[DrawItem])> {
    parts.iter().map(|(rect, items)| (*rect, &items[..])).collect()
}

/// Renders sample `sample` of `parts` of `frame` into layer `layer` of `layers`, or its coverage samples.
pub fn encode_sample(
    context: &Context,
    encoder: &mut wgpu::CommandEncoder,
    (layers, layer): (&Layers, u32),
    frame_group: &wgpu::BindGroup,
    (frame, sample): (u32, u32),
    parts: &[(Rect, &[DrawItem])],
) {
    let color = layers.multisampled.as_ref().unwrap_or(&layers.each[layer as usize]);
    let background = wgpu::Color { r: context.background_luminance, g: 0.0, b: 0.0, a: 0.0 };
    let mut color = attachment(color, background);
    let mut depth = depth_attachment(&layers.depth, wgpu::StoreOp::Discard);
    // Clearing takes a software driver as long as the whole picture is large, whatever is drawn of it then.
    let drawn: u64 = parts.iter().map(|(rect, _)| rect.pixels()).sum();
    let clears = 2 * drawn >= Rect::whole(layers.width, layers.height).pixels();
    if !clears {
        color.ops.load = wgpu::LoadOp::Load;
        depth.depth_ops = Some(wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store });
    }
    let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("luminance"),
        color_attachments: &[Some(color)],
        depth_stencil_attachment: Some(depth),
        ..Default::default()
    });
    // A shifted viewport samples the pixel elsewhere: no second set of matrices.
    let offset = context.sample_offset(sample);
    let grid = layers.grid;
    let [width, height] = [layers.width, layers.height].map(|edge| (grid * edge) as f32);
    pass.set_viewport(offset[0], offset[1], width, height, 0.0, 1.0);
    for (rect, items) in parts {
        let [width, height] = rect.size();
        pass.set_scissor_rect(grid * rect.low[0], grid * rect.low[1], grid * width, grid * height);
        if !clears {
            pass.set_pipeline(&context.background);
            pass.draw(0..3, 0..1);
        }
        let what = Drawing { items, frame, sample: Some(sample), first_record: context.object_base(frame) };
        let surroundings = Some(&context.surroundings);
        draw_surfaces(context, &mut pass, &context.luminance, frame_group, surroundings, &what);
        if let Some(sky) = &context.sky {
            pass.set_pipeline(sky);
            pass.set_bind_group(0, frame_group, &context.frame_offsets(frame, Some(sample)));
            pass.set_bind_group(2, &context.surroundings, &[]);
            pass.draw(0..3, 0..1);
        }
    }
}

/// Reverse z: cleared to 0, the far plane.
pub fn depth_attachment(
    view: &wgpu::TextureView,
    store: wgpu::StoreOp,
) -> wgpu::RenderPassDepthStencilAttachment<'_> {
    wgpu::RenderPassDepthStencilAttachment {
        view,
        depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store }),
        stencil_ops: None,
    }
}

/// What [`draw_surfaces`] draws.
pub struct Drawing<'a> {
    /// In order.
    pub items: &'a [DrawItem],
    /// Frame, for group 0.
    pub frame: u32,
    /// Sample of the pixel that this draws; none for the whole of it.
    pub sample: Option<u32>,
    /// Record of the first object.
    pub first_record: u32,
}

/// Draws surfaces, changing no more state than it must.
pub fn draw_surfaces(
    context: &Context,
    pass: &mut wgpu::RenderPass<'_>,
    pipelines: &Pipelines,
    frame_group: &wgpu::BindGroup,
    surroundings: Option<&wgpu::BindGroup>,
    what: &Drawing<'_>,
) {
    let scene = &context.gpu_scene;
    for (slot, buffer) in scene.vertices.iter().enumerate() {
        if let Some(buffer) = buffer {
            pass.set_vertex_buffer(slot as u32, buffer.slice(..));
        }
    }
    pass.set_vertex_buffer(INSTANCE_SLOT as u32, context.frame_buffers.instances.get().slice(..));
    pass.set_index_buffer(scene.indices.slice(..), wgpu::IndexFormat::Uint32);
    pass.set_bind_group(0, frame_group, &context.frame_offsets(what.frame, what.sample));
    if let Some(surroundings) = surroundings {
        pass.set_bind_group(2, surroundings, &[]);
    }
    let mut last: Option<&Draw> = None;
    for item in what.items {
        let draw = &scene.draws[item.draw as usize];
        if last.is_none_or(|l| l.variant != draw.variant) {
            pass.set_pipeline(&pipelines[&draw.variant]);
        }
        if last.is_none_or(|l| l.material != draw.material) {
            pass.set_bind_group(1, &scene.materials[draw.material], &[]);
        }
        let records = item.objects.start + what.first_record..item.objects.end + what.first_record;
        pass.draw_indexed(draw.indices.clone(), draw.base_vertex, records);
        last = Some(draw);
    }
}

fn encode_resolve(
    context: &Context,
    encoder: &mut wgpu::CommandEncoder,
    layers: &Layers,
    samples: &wgpu::TextureView,
    layer: &wgpu::TextureView,
) {
    let resolve = &context.trigger.resolve;
    let resources =
        vec![wgpu::BindingResource::TextureView(samples), wgpu::BindingResource::TextureView(layer)];
    let group = pass::group(&context.gpu.device, "resolve", &resolve.layout, RESOLVE_BINDINGS, resources);
    let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
    pass.set_pipeline(&resolve.pipeline);
    pass.set_bind_group(0, &group, &[]);
    pass.dispatch_workgroups(layers.width.div_ceil(8), layers.height.div_ceil(8), 1);
}

/// One dispatch of the trigger.
pub struct TriggerStep<'a> {
    pipeline: &'a wgpu::ComputePipeline,
    bindings: wgpu::BindGroup,
    workgroups: (u32, u32, u32),
}

/// Records `steps` in order.
pub fn encode_trigger(encoder: &mut wgpu::CommandEncoder, steps: &[TriggerStep<'_>]) {
    let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
    for step in steps {
        let (x, y, z) = step.workgroups;
        pass.set_pipeline(step.pipeline);
        pass.set_bind_group(0, &step.bindings, &[]);
        pass.dispatch_workgroups(x, y, z);
    }
}

/// Count, prefix, scan, emit.
pub fn trigger_steps<'a>(
    gpu: &Gpu,
    passes: &'a TriggerPasses,
    grid: &SampleGrid,
    targets: &Targets,
    group: &Group,
    unit: &Unit,
    slot: &Slot,
) -> Vec<TriggerStep<'a>> {
    let (device, queue) = (&gpu.device, &gpu.queue);
    let views = group.views.len() as u32;
    let stride = row_stride(targets.width);
    let blocks_per_view = stride / BLOCK_PIXELS * targets.height;
    let params = unit.params(grid, targets, views, slot.capacity);
    queue.write_buffer(&slot.params, 0, bytemuck::bytes_of(&params));
    let scan = ScanParams {
        block_count: blocks_per_view * views,
        blocks_per_view,
        view_count: views,
        event_capacity: slot.capacity,
    };
    queue.write_buffer(&slot.scan_params, 0, bytemuck::bytes_of(&scan));

    let (counting, emitting) = match &*passes.walks[group.targets] {
        WalkPasses::Host => (Vec::new(), Vec::new()),
        WalkPasses::Ideal { count, emit } => ideal_walks(device, (count, emit), targets, group, slot),
        WalkPasses::Chain(chain) => chain_walks(device, chain, targets, group, unit, slot),
    };
    let block = pass::group(
        device,
        "block",
        &passes.block.layout,
        BLOCK_BINDINGS,
        vec![
            group.block_params.as_entire_binding(),
            targets.counts.as_entire_binding(),
            targets.prefixes.as_entire_binding(),
            targets.block_sums.as_entire_binding(),
        ],
    );
    let scan = pass::group(
        device,
        "scan",
        &passes.scan.layout,
        SCAN_BINDINGS,
        vec![
            slot.scan_params.as_entire_binding(),
            targets.block_sums.as_entire_binding(),
            group.view_offsets.as_entire_binding(),
            group.status.as_entire_binding(),
        ],
    );
    let (block_x, block_y) = sizes::dispatch(blocks_per_view * views, WORKGROUP);
    let mut steps = counting;
    steps.push(TriggerStep {
        pipeline: &passes.block.pipeline,
        bindings: block,
        workgroups: (block_x, block_y, 1),
    });
    steps.push(TriggerStep { pipeline: &passes.scan.pipeline, bindings: scan, workgroups: (1, 1, 1) });
    steps.extend(emitting);
    steps
}

/// Steps that count, and steps that emit.
type Walks<'a> = (Vec<TriggerStep<'a>>, Vec<TriggerStep<'a>>);

/// `pass` over all pixels of `group`.
fn over_pixels<'a>(
    pass: &'a ComputePass,
    bindings: wgpu::BindGroup,
    targets: &Targets,
    group: &Group,
) -> TriggerStep<'a> {
    let workgroups = Walk::Count.workgroups([targets.width, targets.height], group.views.len() as u32);
    TriggerStep { pipeline: &pass.pipeline, bindings, workgroups }
}

/// Count and emit of thresholds alone.
fn ideal_walks<'a>(
    device: &wgpu::Device,
    (count, emit): (&'a ComputePass, &'a ComputePass),
    targets: &Targets,
    group: &Group,
    slot: &Slot,
) -> Walks<'a> {
    let (old, new) = (&group.memory[group.parity], &group.memory[1 - group.parity]);
    let texture = wgpu::BindingResource::TextureView;
    let counting = pass::group(
        device,
        "count",
        &count.layout,
        COUNT_BINDINGS,
        vec![
            slot.params.as_entire_binding(),
            texture(&group.sensors),
            texture(&targets.layers.array),
            texture(old),
            texture(new),
            targets.counts.as_entire_binding(),
            group.status.as_entire_binding(),
            texture(&targets.means),
            texture(&targets.paces_view),
        ],
    );
    let emitting = pass::group(
        device,
        "emit",
        &emit.layout,
        EMIT_BINDINGS,
        vec![
            slot.params.as_entire_binding(),
            texture(&group.sensors),
            texture(targets.mean_layers()),
            texture(old),
            texture(new),
            targets.prefixes.as_entire_binding(),
            targets.block_sums.as_entire_binding(),
            group.status.as_entire_binding(),
            slot.events.as_entire_binding(),
            texture(&targets.paces_view),
        ],
    );
    let walk = |pass, bindings| vec![over_pixels(pass, bindings, targets, group)];
    (walk(count, counting), walk(emit, emitting))
}

/// Count and emit of the whole chain. A stream's first instant is a unit of its own: nothing fires there.
fn chain_walks<'a>(
    device: &wgpu::Device,
    chain: &'a ChainPasses,
    targets: &Targets,
    group: &Group,
    unit: &Unit,
    slot: &Slot,
) -> Walks<'a> {
    let (old, new) = (&group.memory[group.parity], &group.memory[1 - group.parity]);
    // Both have what a chain needs where there is one.
    let (Some(own), Some(shared)) = (&group.chain, &targets.chain) else { return (Vec::new(), Vec::new()) };
    let feed = slot.feed.as_ref().unwrap_or(&own.views);
    let size = [targets.width, targets.height];
    let walk = |pass: &'a ComputePass, walk: Walk| {
        let bindings = pass::group(
            device,
            "chain",
            &pass.layout,
            CHAIN_BINDINGS,
            vec![
                slot.params.as_entire_binding(),
                chain.step(walk),
                chain.sensor(),
                wgpu::BindingResource::TextureView(&targets.layers.array),
                own.views.as_entire_binding(),
                feed.as_entire_binding(),
                wgpu::BindingResource::TextureView(old),
                wgpu::BindingResource::TextureView(new),
                // The emitting walk finds its counts in their prefixes: one binding less.
                if walk == Walk::Emit { &targets.prefixes } else { &targets.counts }.as_entire_binding(),
                targets.block_sums.as_entire_binding(),
                group.status.as_entire_binding(),
                slot.events.as_entire_binding(),
                wgpu::BindingResource::TextureView(&targets.paces_view),
                shared.kept.as_entire_binding(),
                shared.lists.as_entire_binding(),
                wgpu::BindingResource::TextureView(&own.frozen),
            ],
        );
        let workgroups = walk.workgroups(size, group.views.len() as u32);
        TriggerStep { pipeline: &pass.pipeline, bindings, workgroups }
    };
    let counting = if unit.first == 0 {
        vec![walk(&chain.begin, Walk::Count)]
    } else {
        chain.counting(unit.instants).into_iter().map(|step| walk(&chain.walk, step)).collect()
    };
    let copying = pass::group(
        device,
        "kept events",
        &chain.emit.layout,
        KEPT_BINDINGS,
        vec![
            slot.params.as_entire_binding(),
            targets.counts.as_entire_binding(),
            targets.prefixes.as_entire_binding(),
            targets.block_sums.as_entire_binding(),
            group.status.as_entire_binding(),
            shared.kept.as_entire_binding(),
            slot.events.as_entire_binding(),
        ],
    );
    let emitting = vec![over_pixels(&chain.emit, copying, targets, group), walk(&chain.walk, Walk::Emit)];
    (counting, emitting)
}
