//! Adaptive time: each tile of a picture is rendered at the rate that the motion in it needs, and a tile in which nothing
//! changes is not rendered again.
//!
//! Instants come in blocks of a fixed length in absolute time. What a block's tiles need is a function of the poses during
//! it, so a stream's bytes depend on nothing else. The last instant of a block is sampled everywhere: no pixel's interval
//! reaches into the next one.

use std::collections::HashMap;

use crate::gpu::buffer::{GrowingBuffer, aligned};
use crate::gpu::commands::Commands;
use crate::gpu::sizes;
use crate::gpu::texture::{array, whole};
use crate::gpu::uniforms::{AuditJob, MeanJob};
use crate::pass::adaptive::{AUDIT_BINDINGS, MEAN_BINDINGS, TILE_RESOLVE_BINDINGS};
use crate::pass::raster::LUMINANCE_FORMAT;
use crate::pass::{self, ComputePass};
use crate::raster::context::{Context, Upload};
use crate::raster::layers::{LayerUse, Layers};
use crate::raster::luminance::{borrowed, copy_layers, encode_sample, encode_samples};
use crate::raster::shadows::MovingShadows;
use crate::sampling::audit::{self, AuditRun, AuditedTile, Chosen};
use crate::sampling::draw_list::InView;
use crate::sampling::tile_rate::{STILL, TileRateEstimator, TileRates};
use crate::sampling::view_motion::ViewMotion;
use crate::sensor::group::{Group, Unit};
use crate::sensor::targets::Targets;
use crate::world::gpu_scene::Part;
use crate::world::image_bounds::Rect;
use crate::world::tiles::{TILE, rects, tiles_along};
use crate::world::view::View;

/// Renders every tile of a picture as often as what it shows moves.
pub struct AdaptiveSampler {
    estimator: TileRateEstimator,
    /// Instants of a block.
    block: u32,
    sky: bool,
    mean: ComputePass,
    jobs: GrowingBuffer,
    tiles: GrowingBuffer,
    /// Per class of views: the samples of the instant in work.
    scratch: Vec<Layers>,
    /// How scratch layers come to be.
    made: LayerUse,
    /// Where coverage samples are averaged.
    resolve: Option<ComputePass>,
    /// Share of tiles that are audited.
    audit_share: f64,
    audit: ComputePass,
    audit_jobs: GrowingBuffer,
    /// Per class of views: where an audited tile is averaged.
    audit_layers: Vec<Layers>,
    /// By the first view of a group: the instant that comes next, and the layers of the last one, view by view.
    kept: HashMap<usize, (i64, wgpu::Texture)>,
    drawn_pixels: u64,
    /// Per view: the tiles that are rendered; all where it is empty.
    only: Vec<Vec<bool>>,
    /// Instead of what poses tell: how often every tile is sampled.
    pub forced: Option<u8>,
}

/// A view at an instant: what is drawn of it.
struct DrawBatch {
    view: u32,
    /// Frame within the view: 0 is the instant before the unit's first.
    k: u32,
    parts: Vec<Part>,
    first_tile: u32,
    tiles: u32,
    /// What drawing it takes, in pixels that are shaded once.
    cost: f64,
}

/// A tile that is rendered at an instant at which nothing depends on it.
struct Audit {
    rect: Rect,
    view: u32,
    /// The layers of the samples before it and after it; none is what the submission before kept.
    before: Option<u32>,
    after: u32,
    entry: AuditedTile,
}

/// One picture of an audited tile.
struct AuditBatch {
    batch: DrawBatch,
    rect: Rect,
    /// The first sample that is drawn.
    first_sample: u32,
    /// Where it comes in the atlas.
    layer: u32,
}

impl DrawBatch {
    /// Pixels that are drawn.
    fn pixels(&self) -> u64 {
        self.parts.iter().map(|(rect, _)| rect.pixels()).sum()
    }
}

/// What a submission is about.
struct Work<'a> {
    targets: &'a Targets,
    group: &'a Group,
    unit: &'a Unit,
    views: Vec<View>,
    /// Frames of a view: the instant before the first, and the instants.
    frames: u32,
    /// Instants of a block.
    length: u32,
    blocks: u32,
    frame_group: wgpu::BindGroup,
    /// Per view and block.
    tile_rates: Vec<TileRates>,
    /// Whether what still tiles showed before the first instant is kept.
    follows: bool,
    /// Whether only some tiles are rendered; the others are not read.
    partial: bool,
}

impl Work<'_> {
    /// Place of a view's block in what is there per view and block.
    const fn place(&self, view: u32, block: u32) -> usize {
        (view * self.blocks + block) as usize
    }

    const fn frame_of(&self, batch: &DrawBatch) -> u32 {
        batch.view * self.frames + batch.k
    }

    /// Whether a tile with `log2_stride` is sampled at instant `number` of `block`, from 1 on.
    const fn is_due(&self, log2_stride: u8, block: u32, number: u32) -> bool {
        match log2_stride {
            // The light of static tiles was not kept.
            STILL => !self.follows && !self.partial && block == 0 && number == self.length,
            log2_stride => number.is_multiple_of(1 << log2_stride),
        }
    }

    /// What the lights see, following what is drawn.
    fn shadows(&self) -> MovingShadows<'_> {
        MovingShadows::new(&self.frame_group, &self.views, self.frames)
    }

    /// Copies what is still from the end of one block to the end of the next.
    fn carry(&self, encoder: &mut Commands, kept: Option<&wgpu::Texture>) {
        let layers = &self.targets.layers;
        for (index, tile_rates) in (0..).zip(&self.tile_rates) {
            let (view, block) = (index / self.blocks, index % self.blocks);
            let layer = view * self.unit.instants + (block + 1) * self.length - 1;
            let before = match (kept, block) {
                (Some(kept), 0) => (kept, view),
                // It was not kept, and is drawn.
                (None, 0) => continue,
                _ => (&layers.texture, layer - self.length),
            };
            let still = |x: u32, y: u32| tile_rates.tiles[(y * tile_rates.columns + x) as usize] == STILL;
            // A copy has no price beside its pixels: exactly the still tiles.
            let exact = |rect: &Rect| rect.pixels() as f64 + 1e-3;
            for rect in rects(still, TILE, (layers.width, layers.height), exact) {
                copy_layers(encoder, before, (&layers.texture, layer), 1, rect);
            }
        }
    }
}

impl AdaptiveSampler {
    /// For blocks of `block` instants within which nothing moves more than `step_px` pixels unseen.
    pub fn new(context: &Context, step_px: f64, block: u32, made: LayerUse, audit_share: f64) -> Self {
        let device = &context.gpu.device;
        let samples = context.offsets.len() as u32;
        Self {
            estimator: TileRateEstimator::new(&context.scene, &context.gpu_scene, step_px, block),
            block,
            sky: context.sky.is_some(),
            mean: crate::pass::adaptive::mean(device, samples),
            jobs: GrowingBuffer::new(device, "mean jobs", wgpu::BufferUsages::UNIFORM),
            tiles: GrowingBuffer::new(device, "tiles", wgpu::BufferUsages::STORAGE),
            scratch: Vec::new(),
            made,
            resolve: match made {
                LayerUse::Resolved(grid) => Some(crate::pass::adaptive::resolve(device, grid)),
                _ => None,
            },
            audit_share,
            audit: crate::pass::adaptive::audit(device),
            audit_jobs: GrowingBuffer::new(device, "audit jobs", wgpu::BufferUsages::UNIFORM),
            audit_layers: Vec::new(),
            kept: HashMap::new(),
            drawn_pixels: 0,
            only: Vec::new(),
            forced: None,
        }
    }

    /// Adds buffers for the class of `targets`, the next in order.
    pub fn add_class(&mut self, context: &Context, targets: &Targets) {
        let samples = context.offsets.len() as u32;
        let (width, height) = (targets.width, targets.height);
        let device = &context.gpu.device;
        self.scratch.push(Layers::new(device, width, height, samples, self.made));
        let [width, height] = if self.audit_share > 0.0 { [width, height] } else { [1; 2] };
        self.audit_layers.push(Layers::new(device, width, height, 1, LayerUse::Computed));
    }

    /// Forgets what was shown, and renders the tiles `only` of each view from now on, all where there is nothing; with
    /// `every_instant` at every instant, whether they change or not.
    pub fn restart(&mut self, only: Vec<Vec<bool>>, every_instant: bool) {
        self.kept.clear();
        self.only = only;
        self.forced = every_instant.then_some(0);
    }

    /// Pixels drawn since this was last asked.
    pub fn take_drawn_pixels(&mut self) -> u64 {
        std::mem::take(&mut self.drawn_pixels)
    }

    /// What decides how often tiles are sampled.
    #[cfg(test)]
    pub fn estimator(&mut self) -> &mut TileRateEstimator {
        &mut self.estimator
    }

    /// Records what makes the luminance of `unit`: a layer per view and instant, of which tiles that are not sampled there
    /// are left as they were.
    pub fn encode(
        &mut self,
        context: &mut Context,
        encoder: &mut Commands,
        targets: &Targets,
        group: &Group,
        unit: &Unit,
    ) -> Option<AuditRun> {
        let views = context.views_at(&group.views);
        // The instant before the first is where things come from.
        let times: Vec<i64> = (-1..i64::from(unit.instants))
            .map(|k| (unit.first + k).max(0))
            .map(|instant| context.grid.instant_us(instant))
            .collect();
        let frame_group =
            context.upload_frames_as(&views, &times, Upload { trail: true, ..Default::default() });
        let kept = self.kept.remove(&group.views[0]);
        // Views that are not reset show again what they showed at this instant.
        let again = i64::from(!group.beginning.is_empty());
        let follows = kept.as_ref().is_some_and(|(next, _)| *next == unit.first + again);
        let kept = kept.map(|(_, texture)| texture);
        let tile_rates =
            tracing::trace_span!("rates of tiles").in_scope(|| self.tile_rates(context, &views, group, unit));
        let (frames, length) = (frames_of(unit), self.block_of(group, unit));
        let work = Work {
            targets,
            group,
            unit,
            views,
            frames,
            length,
            blocks: unit.instants / length,
            frame_group,
            tile_rates,
            follows,
            partial: !self.only.is_empty(),
        };
        write_tile_rates(context, targets, &work.tile_rates, length);
        let mut tiles = Vec::new();
        let batches = self.batches(context, &work, &mut tiles);
        self.drawn_pixels += batches.iter().map(DrawBatch::pixels).sum::<u64>();
        let (audits, audit_batches) = self.audits(context, &work, &batches, &mut tiles);
        let means = self.upload(context, &work, (&batches, &audit_batches), &tiles);
        let atlas = (!audits.is_empty()).then(|| AuditAtlas::new(&context.gpu.device, audits.len() as u32));
        self.draw(context, encoder, &work, &means, &batches, (&audit_batches, atlas.as_ref()));
        let before = kept.as_ref().filter(|_| follows);
        work.carry(encoder, before);
        let run = atlas.map(|atlas| self.compare(context, encoder, &work, audits, &atlas, before));
        self.keep(context, encoder, &work, kept);
        run
    }

    /// Which tiles are audited, and what is drawn for it, in order of time and view.
    fn audits(
        &self,
        context: &Context,
        work: &Work<'_>,
        batches: &[DrawBatch],
        tiles: &mut Vec<u32>,
    ) -> (Vec<Audit>, Vec<AuditBatch>) {
        let (mut audits, mut drawn) = (Vec::new(), Vec::new());
        let begins = work.group.begins(work.unit);
        if self.audit_share <= 0.0 || work.partial || self.forced.is_some() || begins {
            return (audits, drawn);
        }
        let price = self.made.pixel_price();
        let redrawn = context.shadows.as_ref().is_some_and(|shadows| shadows.plan.is_redrawn());
        for (v, view) in (0..).zip(&work.views) {
            let (width, height) = (view.lens.width, view.lens.height);
            for block in 0..work.blocks {
                let of = &work.tile_rates[work.place(v, block)];
                let within = |batch: &&DrawBatch| batch.view == v && (batch.k - 1) / work.length == block;
                let own_work: f64 = batches.iter().filter(within).map(|batch| batch.cost).sum();
                let known = block > 0 || work.follows;
                // Between two samples of which the first is kept.
                let audited: Vec<bool> = of.tiles.iter().map(|rate| known && *rate > 0).collect();
                let absolute = (work.unit.first - 1) / i64::from(work.length) + i64::from(block);
                let frame_of = |number: u32| v * work.frames + block * work.length + number;
                let rect_of = |tile: usize| {
                    let [x, y] = audit::corner(tile, of.columns);
                    Rect { low: [x, y], high: [(x + TILE).min(width), (y + TILE).min(height)] }
                };
                // Shadow maps that are drawn at each instant cost more than a tile: then only instants that are rendered anyway.
                let rendered: Vec<u32> = if redrawn {
                    batches.iter().filter(within).map(|batch| batch.k - block * work.length).collect()
                } else {
                    (1..work.length).collect()
                };
                let pick = |tile: usize, word: u64| {
                    let rate = of.tiles[tile];
                    let between =
                        || rendered.iter().filter(|n| **n < work.length && !work.is_due(rate, u32::MAX, **n));
                    let count = between().count() as u64;
                    let number = *between().nth((word % count.max(1)) as usize)?;
                    Some((number, InView::new(context, view, frame_of(number)).cost(&rect_of(tile), price)))
                };
                let identity = (view.environment, view.camera);
                let chosen = audit::choose(self.audit_share, identity, absolute, &audited, own_work, pick);
                for Chosen { tile, number, other_samples } in chosen {
                    if audits.len() == audit::MOST_AUDITS {
                        break;
                    }
                    let (rect, rate) = (rect_of(tile), of.tiles[tile]);
                    let [before, after] = audit::around(rate, work.length, number);
                    // The stream's own samples are there already at the instants around it.
                    let instants = [number, before, after];
                    let instants = if other_samples { &instants[..] } else { &instants[..1] };
                    let first_sample = if other_samples { context.offsets.len() as u32 } else { 0 };
                    for (layer, number) in (3 * audits.len() as u32..).zip(instants) {
                        let items = InView::new(context, view, frame_of(*number)).items(&rect);
                        let batch = DrawBatch {
                            view: v,
                            k: block * work.length + number,
                            parts: vec![(rect, items)],
                            first_tile: tiles.len() as u32,
                            tiles: 1,
                            cost: 0.0,
                        };
                        drawn.push(AuditBatch { batch, rect, first_sample, layer });
                    }
                    tiles.push((tile as u32 % of.columns) | (tile as u32 / of.columns) << 16);
                    let instant = work.unit.first - 1 + i64::from(block * work.length + number);
                    let object = InView::new(context, view, frame_of(number)).nearest(&rect);
                    let entry = AuditedTile {
                        view: work.group.views[v as usize],
                        corner: rect.low,
                        t_us: context.grid.instant_us(instant),
                        node: object.map(|object| context.gpu_scene.objects[object as usize].node),
                        skipped: rate == STILL,
                        other_samples,
                    };
                    let layer = |number: u32| v * work.unit.instants + block * work.length + number - 1;
                    let before = (block > 0 || before > 0).then(|| layer(before));
                    audits.push(Audit { rect, view: v, before, after: layer(after), entry });
                }
            }
        }
        drawn.sort_by_key(|audit| (audit.batch.k, audit.batch.view));
        (audits, drawn)
    }

    /// Records the comparison of what `atlas` holds with the samples before and after it.
    fn compare(
        &mut self,
        context: &Context,
        encoder: &mut Commands,
        work: &Work<'_>,
        audits: Vec<Audit>,
        atlas: &AuditAtlas,
        kept: Option<&wgpu::Texture>,
    ) -> AuditRun {
        let (device, queue) = (&context.gpu.device, &context.gpu.queue);
        let job = |(slot, audit): (u32, &Audit)| AuditJob {
            size: audit.rect.size(),
            slot,
            offset: work.views[audit.view as usize].sensor.log_eps * context.reference_luminance,
        };
        let jobs: Vec<AuditJob> = (0..).zip(&audits).map(job).collect();
        self.audit_jobs.write(device, queue, &aligned(&jobs));
        let bytes = 4 * audits.len() as u64;
        let buffer = |label, usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: bytes,
                usage,
                mapped_at_creation: false,
            })
        };
        let changes = buffer("audit changes", wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC);
        let staging = buffer("audit staging", wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST);
        let resources = vec![
            pass::part(self.audit_jobs.get(), 0, size_of::<AuditJob>() as u64),
            wgpu::BindingResource::TextureView(&atlas.array),
            changes.as_entire_binding(),
        ];
        let group = pass::group(device, "audit", &self.audit.layout, AUDIT_BINDINGS, resources);
        let layers = &work.targets.layers;
        for (slot, audit) in (0..).zip(&audits) {
            if !audit.entry.other_samples {
                let before = match (audit.before, kept) {
                    (None, Some(kept)) => (kept, audit.view),
                    (before, _) => (&layers.texture, before.unwrap_or(audit.after)),
                };
                atlas.take(encoder, before, audit.rect, 3 * slot + 1);
                atlas.take(encoder, (&layers.texture, audit.after), audit.rect, 3 * slot + 2);
            }
            self.audit.encode_tiles(encoder, &group, slot, 1);
        }
        encoder.copy_buffer_to_buffer(&changes, 0, &staging, 0, bytes);
        AuditRun { entries: audits.into_iter().map(|audit| audit.entry).collect(), staging }
    }

    /// Records `batches`: their samples, and their means; and audited tiles where they come in order of time, into `atlas`.
    fn draw(
        &self,
        context: &Context,
        encoder: &mut Commands,
        work: &Work<'_>,
        means: &MeanGroups,
        batches: &[DrawBatch],
        (audits, atlas): (&[AuditBatch], Option<&AuditAtlas>),
    ) {
        let mut shadows = work.shadows();
        let mut slots = (0..).zip(audits).peekable();
        let mut audit = |shadows: &mut MovingShadows<'_>, encoder: &mut _, until: (u32, u32)| {
            while let Some((slot, audit)) =
                slots.next_if(|(_, audit)| (audit.batch.k, audit.batch.view) <= until)
            {
                let Some(atlas) = atlas else { continue };
                shadows.show(context, encoder, audit.batch.view, audit.batch.k);
                let (into, job) = ((&means.audit, &means.audit_resolve), batches.len() as u32 + slot);
                self.draw_one(context, encoder, work, into, (&audit.batch, audit.first_sample), job);
                let own = &self.audit_layers[work.group.targets];
                atlas.take(encoder, (&own.texture, 0), audit.rect, audit.layer);
            }
        };
        for (job, batch) in (0..).zip(batches) {
            if let Some(before) = batch.k.checked_sub(1) {
                audit(&mut shadows, encoder, (before, u32::MAX));
            }
            shadows.show(context, encoder, batch.view, batch.k);
            self.draw_one(context, encoder, work, (&means.mean, &means.resolve), (batch, 0), job);
            audit(&mut shadows, encoder, (batch.k, batch.view));
        }
        audit(&mut shadows, encoder, (u32::MAX, u32::MAX));
    }

    /// Records the samples of `batch` from `first_sample` on, and their means into the layers of the groups `into`: of samples, and of coverage samples.
    fn draw_one(
        &self,
        context: &Context,
        encoder: &mut Commands,
        work: &Work<'_>,
        into: (&wgpu::BindGroup, &Option<wgpu::BindGroup>),
        (batch, first_sample): (&DrawBatch, u32),
        job: u32,
    ) {
        let scratch = &self.scratch[work.group.targets];
        let (frame_group, frame) = (&work.frame_group, work.frame_of(batch));
        let parts = borrowed(&batch.parts);
        if let (Some(resolve), Some(resolving)) = (&self.resolve, into.1) {
            encode_sample(context, encoder, (scratch, 0), frame_group, (frame, first_sample), &parts);
            resolve.encode_tiles(encoder, resolving, job, batch.tiles);
        } else {
            encode_samples(context, encoder, (scratch, 0), frame_group, (frame, first_sample), &parts);
            self.mean.encode_tiles(encoder, into.0, job, batch.tiles);
        }
    }

    /// Instants of a block of `unit`: an instant at which views begin has a submission of its own.
    const fn block_of(&self, group: &Group, unit: &Unit) -> u32 {
        if group.begins(unit) { 1 } else { self.block }
    }

    /// Per view and block.
    fn tile_rates(&self, context: &Context, views: &[View], group: &Group, unit: &Unit) -> Vec<TileRates> {
        let length = self.block_of(group, unit);
        let blocks = unit.instants / length;
        let frames = frames_of(unit) as usize;
        let mut tile_rates = Vec::new();
        for (v, view) in views.iter().enumerate() {
            let only = self.only.get(group.views[v]);
            let (columns, rows) = (tiles_along(view.lens.width), tiles_along(view.lens.height));
            for block in 0..blocks {
                let count = (columns * rows) as usize;
                let all = |log2_stride| TileRates { columns, tiles: vec![log2_stride; count] };
                if group.begins(unit) {
                    let goes_on = group.beginning.get(v) == Some(&false);
                    tile_rates.push(all(if goes_on { STILL } else { 0 }).restricted(only));
                    continue;
                }
                if let Some(log2_stride) = self.forced {
                    tile_rates.push(all(log2_stride).restricted(only));
                    continue;
                }
                let start = v * frames + (block * length) as usize;
                let range = start..start + length as usize + 1;
                let passing = ViewMotion::new(&context.frame_data, range, &view.lens, self.sky);
                let mut own = self.estimator.tile_rates(&context.gpu_scene, &passing);
                // No sample may stand for the light between two others.
                if view.sensor.walks_on_host() {
                    own.tiles.fill(0);
                }
                tile_rates.push(own.restricted(only));
            }
        }
        tile_rates
    }

    /// What is drawn, in order of time, then view; the numbers of its tiles go to `tiles`.
    fn batches(&self, context: &Context, work: &Work<'_>, tiles: &mut Vec<u32>) -> Vec<DrawBatch> {
        let mut batches = Vec::new();
        for block in 0..work.blocks {
            // By view, then by how often the instants come: rectangles, for the objects where they are at the block's end.
            let mut plans: Vec<HashMap<u32, Vec<Rect>>> = vec![HashMap::new(); work.views.len()];
            for number in 1..=work.length {
                let k = block * work.length + number;
                for (v, view) in (0..).zip(&work.views) {
                    let of = &work.tile_rates[work.place(v, block)];
                    let active = |log2_stride: u8| work.is_due(log2_stride, block, number);
                    if !of.tiles.iter().any(|log2_stride| active(*log2_stride)) {
                        continue;
                    }
                    let in_view = InView::new(context, view, v * work.frames + k);
                    let size = (view.lens.width, view.lens.height);
                    let rects = plans[v as usize].entry(number.trailing_zeros()).or_insert_with(|| {
                        let chosen = |x: u32, y: u32| active(of.tiles[(y * of.columns + x) as usize]);
                        in_view.rects(chosen, TILE, size, self.made.pixel_price())
                    });
                    let first_tile = tiles.len() as u32;
                    for (index, log2_stride) in (0..).zip(&of.tiles) {
                        if active(*log2_stride) {
                            tiles.push((index % of.columns) | (index / of.columns) << 16);
                        }
                    }
                    let parts = rects.iter().map(|rect| (*rect, in_view.items(rect))).collect();
                    let price = self.made.pixel_price();
                    let cost = rects.iter().map(|rect| in_view.cost(rect, price)).sum();
                    let count = tiles.len() as u32 - first_tile;
                    batches.push(DrawBatch { view: v, k, parts, first_tile, tiles: count, cost });
                }
            }
        }
        batches
    }

    /// What the means are made from.
    fn upload(
        &mut self,
        context: &Context,
        work: &Work<'_>,
        (batches, audits): (&[DrawBatch], &[AuditBatch]),
        tiles: &[u32],
    ) -> MeanGroups {
        let (device, queue) = (&context.gpu.device, &context.gpu.queue);
        let job = |batch: &DrawBatch, layer: u32| MeanJob {
            first: batch.first_tile,
            count: batch.tiles,
            row: sizes::dispatch(batch.tiles, 1).0,
            layer,
        };
        // The instant before the first is never drawn.
        let layer_of = |batch: &DrawBatch| batch.view * work.unit.instants + batch.k - 1;
        let mut jobs: Vec<MeanJob> = batches.iter().map(|batch| job(batch, layer_of(batch))).collect();
        jobs.extend(audits.iter().map(|audit| job(&audit.batch, 0)));
        self.jobs.write(device, queue, &aligned(&jobs));
        self.tiles.write(device, queue, bytemuck::cast_slice(tiles));
        let scratch = &self.scratch[work.group.targets];
        let view = wgpu::BindingResource::TextureView;
        let resources = |from, into| {
            let job = pass::part(self.jobs.get(), 0, size_of::<MeanJob>() as u64);
            vec![job, self.tiles.get().as_entire_binding(), view(from), view(into)]
        };
        let groups = |into| {
            let resolve =
                self.resolve.as_ref().zip(scratch.multisampled.as_ref()).map(|(resolve, samples4)| {
                    let resources = resources(samples4, into);
                    pass::group(device, "tile resolve", &resolve.layout, TILE_RESOLVE_BINDINGS, resources)
                });
            let mean = resources(&scratch.array, into);
            (pass::group(device, "mean", &self.mean.layout, MEAN_BINDINGS, mean), resolve)
        };
        let (mean, resolve) = groups(&work.targets.layers.array);
        let (audit, audit_resolve) = groups(&self.audit_layers[work.group.targets].array);
        MeanGroups { mean, resolve, audit, audit_resolve }
    }

    /// Keeps the last instant for the next submission.
    fn keep(
        &mut self,
        context: &Context,
        encoder: &mut Commands,
        work: &Work<'_>,
        spare: Option<wgpu::Texture>,
    ) {
        let &Work { targets, group, unit, .. } = work;
        let count = group.views.len() as u32;
        let layers = &targets.layers;
        // A group's views never change.
        let texture = spare.unwrap_or_else(|| layers.like(&context.gpu.device, count));
        for view in 0..count {
            let last = view * unit.instants + unit.instants - 1;
            copy_layers(
                encoder,
                (&layers.texture, last),
                (&texture, view),
                1,
                Rect::whole(layers.width, layers.height),
            );
        }
        self.kept.insert(group.views[0], (unit.first + i64::from(unit.instants), texture));
    }
}

/// Audited tiles of a submission: each at its instant, before it and after it.
struct AuditAtlas {
    texture: wgpu::Texture,
    array: wgpu::TextureView,
}

impl AuditAtlas {
    fn new(device: &wgpu::Device, tiles: u32) -> Self {
        let usage = wgpu::TextureUsages::COPY_DST | wgpu::TextureUsages::STORAGE_BINDING;
        let texture = array(device, "audited tiles", [TILE, TILE, 3 * tiles], LUMINANCE_FORMAT, usage);
        Self { array: whole(&texture), texture }
    }

    /// Copies `rect` of a layer to layer `to`.
    fn take(&self, encoder: &mut Commands, (texture, layer): (&wgpu::Texture, u32), rect: Rect, to: u32) {
        let place = |texture, [x, y]: [u32; 2], z| wgpu::TexelCopyTextureInfo {
            texture,
            mip_level: 0,
            origin: wgpu::Origin3d { x, y, z },
            aspect: wgpu::TextureAspect::All,
        };
        let [width, height] = rect.size();
        let size = wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
        encoder.copy_texture_to_texture(
            place(texture, rect.low, layer),
            place(&self.texture, [0, 0], to),
            size,
        );
    }
}

/// What means read and write: of samples, and of coverage samples.
struct MeanGroups {
    mean: wgpu::BindGroup,
    resolve: Option<wgpu::BindGroup>,
    /// The same, into the layers of an audit.
    audit: wgpu::BindGroup,
    audit_resolve: Option<wgpu::BindGroup>,
}

/// Frames of a view in a submission: the instant before the first, and the instants.
const fn frames_of(unit: &Unit) -> u32 {
    1 + unit.instants
}

/// Writes the tile rates of blocks of `length` instants for the trigger; static tiles are sampled at the end of each block.
fn write_tile_rates(context: &Context, targets: &Targets, tile_rates: &[TileRates], length: u32) {
    let slowest = length.trailing_zeros() as u8;
    let bytes: Vec<u8> = tile_rates
        .iter()
        .flat_map(|p| p.tiles.iter().map(|log2_stride| (*log2_stride).min(slowest)))
        .collect();
    let (columns, rows) = (tiles_along(targets.width), tiles_along(targets.height));
    context.gpu.queue.write_texture(
        targets.tile_rates.as_image_copy(),
        &bytes,
        wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(columns), rows_per_image: Some(rows) },
        wgpu::Extent3d { width: columns, height: rows, depth_or_array_layers: tile_rates.len() as u32 },
    );
}
