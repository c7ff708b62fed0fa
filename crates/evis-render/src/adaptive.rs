//! `native` at the pace of what is seen: each tile of a picture is rendered as often as what it may show moves, and one
//! that does not change not at all.
//!
//! Instants come in blocks of a fixed length in absolute time. What a block's tiles need is a function of the poses during
//! it, so a stream's bytes depend on nothing else. The last instant of a block is sampled everywhere: no pixel's interval
//! reaches into the next one.

use std::collections::HashMap;

use crate::area::{Area, Rect};
use crate::engine::{Context, Upload};
use crate::frame_buffers::GrowingBuffer;
use crate::gpu_scene::{DrawItem, push_item};
use crate::interval::{Group, Unit, copy_layers, encode_luminance};
use crate::pace::{Pacer, Paces, Passing, STILL, rects, tiles_along};
use crate::pass::adaptive::MEAN_BINDINGS;
use crate::pass::raster::UNIFORM_ALIGNMENT;
use crate::pass::{self, ComputePass};
use crate::sizes;
use crate::still;
use crate::targets::{LayerUse, Layers, Targets};
use crate::uniforms::MeanJob;
use crate::view::View;

/// What a draw call takes beside its vertices, and what an index takes, in pixels (measured on lavapipe).
const DRAW_PX: f64 = 100.0;
const INDEX_PX: f64 = 0.3;
/// What a rectangle takes.
const RECT_PX: f64 = 200.0;

/// The room.
pub struct AdaptiveRoom {
    pacer: Pacer,
    /// Instants of a block.
    block: u32,
    sky: bool,
    mean: ComputePass,
    jobs: GrowingBuffer,
    tiles: GrowingBuffer,
    /// Per size: the samples of the instant in work.
    scratch: Vec<Layers>,
    /// By the first view of a group: the instant that comes next, and the layers of the last one, view by view.
    kept: HashMap<usize, (i64, wgpu::Texture)>,
    drawn_pixels: u64,
    /// Instead of what poses tell: a test's pace.
    #[cfg(test)]
    pub forced: Option<u8>,
}

/// A view at an instant: what is drawn of it.
struct Look {
    view: u32,
    instant: u32,
    parts: Vec<(Rect, Vec<DrawItem>)>,
    first_tile: u32,
    tiles: u32,
}

impl AdaptiveRoom {
    /// For blocks of `block` instants within which nothing moves more than `step_px` pixels unseen.
    pub fn new(context: &Context, step_px: f64, block: u32) -> Self {
        let device = &context.gpu.device;
        let samples = context.offsets.len() as u32;
        Self {
            pacer: Pacer::new(&context.scene, &context.gpu_scene, step_px, block),
            block,
            sky: context.sky.is_some(),
            mean: crate::pass::adaptive::mean(device, samples),
            jobs: GrowingBuffer::new(device, "mean jobs", wgpu::BufferUsages::UNIFORM),
            tiles: GrowingBuffer::new(device, "tiles", wgpu::BufferUsages::STORAGE),
            scratch: Vec::new(),
            kept: HashMap::new(),
            drawn_pixels: 0,
            #[cfg(test)]
            forced: None,
        }
    }

    /// Makes room for views of the size of `targets`, the next in order.
    pub fn add_size(&mut self, context: &Context, targets: &Targets) {
        let samples = context.offsets.len() as u32;
        let (width, height) = (targets.width, targets.height);
        self.scratch.push(Layers::new(&context.gpu.device, width, height, samples, LayerUse::Rendered));
    }

    /// Pixels drawn since this was last asked.
    pub fn take_drawn_pixels(&mut self) -> u64 {
        std::mem::take(&mut self.drawn_pixels)
    }

    /// Records what makes the luminance of `unit`: a layer per view and instant, of which tiles that are not sampled there
    /// are left as they were.
    pub fn encode(
        &mut self,
        context: &mut Context,
        encoder: &mut wgpu::CommandEncoder,
        targets: &Targets,
        group: &Group,
        unit: &Unit,
    ) {
        let views = context.views_of(group);
        // The instant before the first is where things come from.
        let times: Vec<i64> = (-1..i64::from(unit.instants))
            .map(|k| context.grid.instant_us((unit.first + k).max(0)))
            .collect();
        let frame_group =
            context.upload_frames_as(&views, &times, Upload { trail: true, ..Default::default() });
        let first_view = group.views[0];
        let kept = self.kept.remove(&first_view);
        let follows = kept.as_ref().is_some_and(|(next, _)| *next == unit.first);
        let paces = self.paces(context, &views, unit);
        write_paces(context, targets, &paces, self.block_of(unit));

        let mut tiles = Vec::new();
        let looks = self.looks(context, &views, unit, &paces, follows, &mut tiles);
        self.drawn_pixels +=
            looks.iter().flat_map(|look| &look.parts).map(|(rect, _)| rect.pixels()).sum::<u64>();
        let groups = self.upload(context, targets, group, unit, &looks, &tiles);

        let frames = unit.instants + 1;
        let mut shadows_at = None;
        for (number, look) in looks.iter().enumerate() {
            let k = look.instant + 1;
            if shadows_at != Some(k) {
                context.encode_moving_shadows(encoder, &frame_group, &views, frames, k);
                shadows_at = Some(k);
            }
            let frame = look.view * frames + k;
            let scratch = &self.scratch[group.targets];
            encode_luminance(context, encoder, scratch, &frame_group, frame, 0, Some(&look.parts));
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&self.mean.pipeline);
            pass.set_bind_group(0, &groups, &[number as u32 * UNIFORM_ALIGNMENT as u32]);
            let (x, y) = sizes::dispatch(look.tiles, 1);
            pass.dispatch_workgroups(x, y, 1);
        }
        let kept = kept.map(|(_, texture)| texture);
        self.carry(encoder, targets, unit, &paces, kept.as_ref().filter(|_| follows));
        self.keep(context, encoder, targets, group, unit, kept);
    }

    /// Instants of a block of `unit`: the stream's first instant has a submission of its own.
    const fn block_of(&self, unit: &Unit) -> u32 {
        if unit.first == 0 { 1 } else { self.block }
    }

    /// Per view and block.
    fn paces(&self, context: &Context, views: &[View], unit: &Unit) -> Vec<Paces> {
        let length = self.block_of(unit);
        let blocks = unit.instants / length;
        let frames = unit.instants as usize + 1;
        let mut paces = Vec::new();
        for (v, view) in views.iter().enumerate() {
            let (columns, rows) = (tiles_along(view.lens.width), tiles_along(view.lens.height));
            for block in 0..blocks {
                let all = |pace| Paces { columns, tiles: vec![pace; (columns * rows) as usize] };
                if unit.first == 0 {
                    paces.push(all(0));
                    continue;
                }
                #[cfg(test)]
                if let Some(pace) = self.forced {
                    paces.push(all(pace));
                    continue;
                }
                let start = v * frames + (block * length) as usize;
                let range = start..start + length as usize + 1;
                let passing = Passing::new(&context.frame_data, range, &view.lens, self.sky);
                paces.push(self.pacer.paces(&context.gpu_scene, &passing));
            }
        }
        paces
    }

    /// What is drawn, in order of time, then view; the numbers of its tiles go to `tiles`.
    fn looks(
        &self,
        context: &Context,
        views: &[View],
        unit: &Unit,
        paces: &[Paces],
        follows: bool,
        tiles: &mut Vec<u32>,
    ) -> Vec<Look> {
        let length = self.block_of(unit);
        let blocks = unit.instants / length;
        let frames = unit.instants + 1;
        let mut looks = Vec::new();
        for block in 0..blocks {
            // By view, then by how often the instants come: rectangles, for the objects where they are at the block's end.
            let mut plans: Vec<HashMap<u32, Vec<Rect>>> = vec![HashMap::new(); views.len()];
            // A tile of pace p is sampled where 2^p divides this.
            for number in 1..=length {
                let instant = block * length + number - 1;
                // Nobody has kept what still tiles showed.
                let still_too = number == length && block == 0 && !follows;
                for (v, view) in (0..).zip(views) {
                    let of = &paces[(v * blocks + block) as usize];
                    let active = |pace: u8| match pace {
                        STILL => still_too,
                        pace => number.trailing_zeros() >= u32::from(pace),
                    };
                    if !of.tiles.iter().any(|pace| active(*pace)) {
                        continue;
                    }
                    let frame = v * frames + instant + 1;
                    let areas = areas(context, view, frame);
                    let size = (view.lens.width, view.lens.height);
                    let rects = plans[v as usize].entry(number.trailing_zeros()).or_insert_with(|| {
                        let active = |x, y| active(of.tiles[(y * of.columns + x) as usize]);
                        rects(active, size, |rect| cost(rect, &areas))
                    });
                    let first_tile = tiles.len() as u32;
                    for (index, pace) in (0..).zip(&of.tiles) {
                        if active(*pace) {
                            tiles.push((index % of.columns) | (index / of.columns) << 16);
                        }
                    }
                    let parts = rects.iter().map(|rect| (*rect, items(rect, &areas))).collect();
                    let count = tiles.len() as u32 - first_tile;
                    looks.push(Look { view: v, instant, parts, first_tile, tiles: count });
                }
            }
        }
        looks
    }

    /// What the means are made from.
    fn upload(
        &mut self,
        context: &Context,
        targets: &Targets,
        group: &Group,
        unit: &Unit,
        looks: &[Look],
        tiles: &[u32],
    ) -> wgpu::BindGroup {
        let (device, queue) = (&context.gpu.device, &context.gpu.queue);
        let mut bytes = vec![0; looks.len().max(1) * UNIFORM_ALIGNMENT as usize];
        for (slot, look) in bytes.chunks_exact_mut(UNIFORM_ALIGNMENT as usize).zip(looks) {
            let job = MeanJob {
                first: look.first_tile,
                count: look.tiles,
                row: sizes::dispatch(look.tiles, 1).0,
                layer: look.view * unit.instants + look.instant,
            };
            slot[..size_of::<MeanJob>()].copy_from_slice(bytemuck::bytes_of(&job));
        }
        self.jobs.write(device, queue, &bytes);
        self.tiles.write(device, queue, bytemuck::cast_slice(tiles));
        let resources = vec![
            pass::part(self.jobs.get(), 0, size_of::<MeanJob>() as u64),
            self.tiles.get().as_entire_binding(),
            wgpu::BindingResource::TextureView(&self.scratch[group.targets].array),
            wgpu::BindingResource::TextureView(&targets.layers.array),
        ];
        pass::group(device, "mean", &self.mean.layout, MEAN_BINDINGS, resources)
    }

    /// Copies what is still from the end of one block to the end of the next.
    fn carry(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        targets: &Targets,
        unit: &Unit,
        paces: &[Paces],
        kept: Option<&wgpu::Texture>,
    ) {
        let length = self.block_of(unit);
        let blocks = unit.instants / length;
        let layers = &targets.layers;
        for (index, paces) in (0..).zip(paces) {
            let (view, block) = (index / blocks, index % blocks);
            let layer = view * unit.instants + (block + 1) * length - 1;
            let before = match (kept, block) {
                (Some(kept), 0) => (kept, view),
                // Drawn, since nobody has it.
                (None, 0) => continue,
                _ => (&layers.texture, layer - length),
            };
            let still = |x: u32, y: u32| paces.tiles[(y * paces.columns + x) as usize] == STILL;
            // A copy has no price beside its pixels: exactly the still tiles.
            let exact = |rect: &Rect| rect.pixels() as f64 + 1e-3;
            for rect in rects(still, (layers.width, layers.height), exact) {
                copy_layers(encoder, before, (&layers.texture, layer), 1, rect);
            }
        }
    }

    /// Keeps the last instant for the next submission.
    fn keep(
        &mut self,
        context: &Context,
        encoder: &mut wgpu::CommandEncoder,
        targets: &Targets,
        group: &Group,
        unit: &Unit,
        spare: Option<wgpu::Texture>,
    ) {
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

/// Tells the trigger the paces of blocks of `length` instants; what is still is looked at when they end.
fn write_paces(context: &Context, targets: &Targets, paces: &[Paces], length: u32) {
    let slowest = length.trailing_zeros() as u8;
    let bytes: Vec<u8> = paces.iter().flat_map(|p| p.tiles.iter().map(|pace| (*pace).min(slowest))).collect();
    let (columns, rows) = (tiles_along(targets.width), tiles_along(targets.height));
    context.gpu.queue.write_texture(
        targets.paces.as_image_copy(),
        &bytes,
        wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(columns), rows_per_image: Some(rows) },
        wgpu::Extent3d { width: columns, height: rows, depth_or_array_layers: paces.len() as u32 },
    );
}

/// A visible object: how it is drawn, where it is seen, and what it takes.
struct Placed {
    draw: u32,
    object: u32,
    area: Area,
    price: f64,
}

/// What is in view in a frame, in drawing order.
fn areas(context: &Context, view: &View, frame: u32) -> Vec<Placed> {
    let data = &context.frame_data;
    let camera = &data.trail.camera_from_world[frame as usize];
    let shared = &data.trail.shared[data.trail.shared_of[frame as usize]];
    let scene = &context.gpu_scene;
    data.visible[frame as usize]
        .iter()
        .flat_map(|item| item.objects.clone().map(move |object| (item.draw, object)))
        .map(|(draw, object)| {
            let area = still::place(&scene.objects[object as usize], &shared.world[object as usize])
                .map_or(Area::EVERYTHING, |corners| still::own_area(&corners, camera, &view.lens));
            let price = DRAW_PX + INDEX_PX * scene.draws[draw as usize].indices.len() as f64;
            Placed { draw, object, area, price }
        })
        .collect()
}

/// What drawing `rect` takes, in pixels.
fn cost(rect: &Rect, areas: &[Placed]) -> f64 {
    let within = Area::of(rect);
    let objects: f64 = areas.iter().filter(|p| !p.area.meet(within).is_nothing()).map(|p| p.price).sum();
    RECT_PX + rect.pixels() as f64 + objects
}

/// What is drawn within `rect`.
fn items(rect: &Rect, areas: &[Placed]) -> Vec<DrawItem> {
    let within = Area::of(rect);
    let mut items: Vec<DrawItem> = Vec::new();
    for placed in areas.iter().filter(|p| !p.area.meet(within).is_nothing()) {
        push_item(&mut items, placed.draw, placed.object);
    }
    items
}
