//! `native` at the pace of what is seen: each tile of a picture is rendered as often as what it may show moves, and one
//! that does not change not at all.
//!
//! Instants come in blocks of a fixed length in absolute time. What a block's tiles need is a function of the poses during
//! it, so a stream's bytes depend on nothing else. The last instant of a block is sampled everywhere: no pixel's interval
//! reaches into the next one.

use std::collections::{HashMap, HashSet};
use std::ops::Range;

use crate::area::Rect;
use crate::engine::{Context, Upload};
use crate::error::EngineError;
use crate::frame_buffers::{GrowingBuffer, aligned};
use crate::gpu_scene::{DrawItem, Part, push_item};
use crate::interval::{Group, Unit, borrowed, copy_layers, encode_luminance, encode_sample};
use crate::march::{MarchRoom, left_over};
use crate::pace::{Pacer, Paces, Passing, STILL, TILE, rects, tiles_along};
use crate::parts::InView;
use crate::pass::adaptive::{MEAN_BINDINGS, TILE_RESOLVE_BINDINGS};
use crate::pass::raster::SceneConstants;
use crate::pass::{self, ComputePass};
use crate::reuse::{Instant, Keyframe, ReuseGroups, ReuseRoom, steady};
use crate::shadow::MovingShadows;
use crate::sizes;
use crate::targets::{LayerUse, Layers, Targets};
use crate::uniforms::MeanJob;
use crate::view::View;

/// The room.
pub struct AdaptiveRoom {
    pacer: Pacer,
    /// Instants of a block.
    block: u32,
    /// Blocks from one keyframe to the next.
    blocks_per_key: u32,
    sky: bool,
    mean: ComputePass,
    jobs: GrowingBuffer,
    tiles: GrowingBuffer,
    /// Per class of views: the samples of the instant in work.
    scratch: Vec<Layers>,
    /// Light that is used again.
    reuse: Option<ReuseRoom>,
    /// How scratch layers come to be.
    made: LayerUse,
    /// Where coverage samples are averaged.
    resolve: Option<ComputePass>,
    /// What is followed instead of rendered.
    march: Option<MarchRoom>,
    /// By the first view of a group: the instant that comes next, and the layers of the last one, view by view.
    kept: HashMap<usize, (i64, wgpu::Texture)>,
    drawn_pixels: u64,
    /// Per view: which tiles are looked at; all where there is nothing.
    only: Vec<Vec<bool>>,
    /// Instead of what poses tell: a test's pace.
    #[cfg(test)]
    pub forced: Option<u8>,
}

/// A view at an instant: what is drawn of it.
struct Look {
    view: u32,
    /// Frame within the view: 0 is the instant before the unit's first.
    k: u32,
    parts: Vec<Part>,
    /// Per part: what takes its light from keyframes.
    still: Vec<Vec<DrawItem>>,
    first_tile: u32,
    tiles: u32,
}

impl Look {
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
    /// Frames of a view: the instant before the first, the instants, the keyframes.
    frames: u32,
    /// Instants of a block.
    length: u32,
    blocks: u32,
    frame_group: wgpu::BindGroup,
    /// Per view and block.
    paces: Vec<Paces>,
    /// Whether what still tiles showed before the first instant is kept.
    follows: bool,
    /// Whether only some tiles are looked at; nobody asks what the others show.
    partial: bool,
}

impl Work<'_> {
    /// Place of a view's block in what is there per view and block.
    const fn place(&self, view: u32, block: u32) -> usize {
        (view * self.blocks + block) as usize
    }

    const fn frame_of(&self, look: &Look) -> u32 {
        look.view * self.frames + look.k
    }

    /// Whether a tile of `pace` is sampled at instant `number` of `block`, from 1 on.
    const fn is_due(&self, pace: u8, block: u32, number: u32) -> bool {
        match pace {
            // Nobody has kept what still tiles showed.
            STILL => !self.follows && !self.partial && block == 0 && number == self.length,
            pace => number.is_multiple_of(1 << pace),
        }
    }

    /// What the lights see, following what is drawn.
    fn shadows(&self) -> MovingShadows<'_> {
        MovingShadows::new(&self.frame_group, &self.views, self.frames)
    }

    /// Copies what is still from the end of one block to the end of the next.
    fn carry(&self, encoder: &mut wgpu::CommandEncoder, kept: Option<&wgpu::Texture>) {
        let layers = &self.targets.layers;
        for (index, paces) in (0..).zip(&self.paces) {
            let (view, block) = (index / self.blocks, index % self.blocks);
            let layer = view * self.unit.instants + (block + 1) * self.length - 1;
            let before = match (kept, block) {
                (Some(kept), 0) => (kept, view),
                // Drawn, since nobody has it.
                (None, 0) => continue,
                _ => (&layers.texture, layer - self.length),
            };
            let still = |x: u32, y: u32| paces.tiles[(y * paces.columns + x) as usize] == STILL;
            // A copy has no price beside its pixels: exactly the still tiles.
            let exact = |rect: &Rect| rect.pixels() as f64 + 1e-3;
            for rect in rects(still, TILE, (layers.width, layers.height), exact) {
                copy_layers(encoder, before, (&layers.texture, layer), 1, rect);
            }
        }
    }
}

impl AdaptiveRoom {
    /// For blocks of `block` instants within which nothing moves more than `step_px` pixels unseen. With `reuse`, light is
    /// used again: of keyframes so many blocks apart. With `march`, tiles without edges are followed.
    pub fn new(
        context: &Context,
        step_px: f64,
        block: u32,
        made: LayerUse,
        reuse: Option<(&SceneConstants, u32)>,
        march: Option<&SceneConstants>,
    ) -> Self {
        let device = &context.gpu.device;
        let samples = context.offsets.len() as u32;
        Self {
            pacer: Pacer::new(&context.scene, &context.gpu_scene, step_px, block),
            block,
            blocks_per_key: reuse.map_or(1, |(_, blocks)| blocks),
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
            reuse: reuse.map(|(constants, _)| ReuseRoom::new(context, constants)),
            march: march.map(|constants| MarchRoom::new(context, constants, step_px)),
            kept: HashMap::new(),
            drawn_pixels: 0,
            only: Vec::new(),
            #[cfg(test)]
            forced: None,
        }
    }

    /// Makes room for the class of `targets`, the next in order.
    pub fn add_class(&mut self, context: &Context, targets: &Targets) {
        let samples = context.offsets.len() as u32;
        let (width, height) = (targets.width, targets.height);
        let device = &context.gpu.device;
        self.scratch.push(Layers::new(device, width, height, samples, self.made));
        if let Some(reuse) = &mut self.reuse {
            reuse.add_class(device, width, height);
        }
        if let Some(march) = &mut self.march {
            march.add_class(device, width, height);
        }
    }

    /// Forgets what was shown, and looks at the tiles `only` of each view from now on; at all where there is nothing.
    pub fn begin_again(&mut self, only: Vec<Vec<bool>>) {
        self.kept.clear();
        self.only = only;
    }

    /// Pixels drawn since this was last asked.
    pub fn take_drawn_pixels(&mut self) -> u64 {
        std::mem::take(&mut self.drawn_pixels)
    }

    /// What decides how often tiles are sampled.
    #[cfg(test)]
    pub fn pacer(&mut self) -> &mut Pacer {
        &mut self.pacer
    }

    /// Where light comes from that is used again.
    #[cfg(test)]
    pub fn reuse(&self) -> Option<&ReuseRoom> {
        self.reuse.as_ref()
    }

    /// Quarters of tiles that were followed so far, then those that were not, by each reason.
    #[cfg(test)]
    pub fn followed(&self) -> [u64; 4] {
        self.march.as_ref().map_or([0; 4], |march| march.told)
    }

    /// Keyframes drawn since this was last asked.
    pub fn take_keyframes(&mut self) -> u64 {
        self.reuse.as_mut().map_or(0, ReuseRoom::take_keyframes)
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
    ) -> Result<(), EngineError> {
        let views = context.views_of(group);
        // The instant before the first is where things come from.
        let times: Vec<i64> = (-1..i64::from(unit.instants))
            .map(|k| (unit.first + k).max(0))
            .chain(self.keys(unit).map(|key| key * self.between_keys()))
            .map(|instant| context.grid.instant_us(instant))
            .collect();
        let frame_group =
            context.upload_frames_as(&views, &times, Upload { trail: true, ..Default::default() });
        let kept = self.kept.remove(&group.views[0]);
        let follows = kept.as_ref().is_some_and(|(next, _)| *next == unit.first);
        let kept = kept.map(|(_, texture)| texture);
        let paces = self.paces(context, &views, group, unit);
        let (frames, length) = (self.frames(unit), self.block_of(unit));
        let work = Work {
            targets,
            group,
            unit,
            views,
            frames,
            length,
            blocks: unit.instants / length,
            frame_group,
            paces,
            follows,
            partial: !self.only.is_empty(),
        };
        write_paces(context, targets, &work.paces, length);
        match self.march.take() {
            Some(mut march) => {
                let done = self.encode_marched(context, encoder, &work, &mut march);
                self.march = Some(march);
                done?;
            }
            None => self.encode_rendered(context, encoder, &work),
        }
        work.carry(encoder, kept.as_ref().filter(|_| follows));
        self.keep(context, encoder, &work, kept);
        Ok(())
    }

    /// Records `work`: every tile is rendered at its pace.
    fn encode_rendered(&mut self, context: &Context, encoder: &mut wgpu::CommandEncoder, work: &Work<'_>) {
        let reused = self.reused(context, work);
        let mut tiles = Vec::new();
        let looks = self.looks(context, work, &reused, &mut tiles);
        self.drawn_pixels += looks.iter().map(Look::pixels).sum::<u64>();
        let means = self.upload(context, work, &looks, &tiles);
        if self.reuse.is_some() {
            let plan = self.plan_reuse(context, work, &reused, &looks);
            self.draw_reused(context, encoder, work, &means, plan.as_ref(), &looks);
        } else {
            self.draw(context, encoder, work, &means, &looks, |_, _, _| {});
        }
    }

    /// Records `looks` whose light is used again where `plan` knows it.
    fn draw_reused(
        &mut self,
        context: &Context,
        encoder: &mut wgpu::CommandEncoder,
        work: &Work<'_>,
        means: &MeanGroups,
        plan: Option<&ReusePlan>,
        looks: &[Look],
    ) {
        let scratch = &self.scratch[work.group.targets];
        let (Some(reuse), Some(resolve), Some(resolving)) = (&mut self.reuse, &self.resolve, &means.resolve)
        else {
            return;
        };
        let frame_group = &work.frame_group;
        let samples = context.offsets.len() as u32;
        let mut shadows = work.shadows();
        let mut keyframes = plan.into_iter().flat_map(|plan| &plan.keyframes).zip(0..).peekable();
        for (number, look) in (0..).zip(looks) {
            let frame = work.frame_of(look);
            if let Some(plan) = plan {
                let due = |block: u32| block <= (look.k - 1) / work.length;
                while let Some(((_, keyframe), entry)) = keyframes.next_if(|((block, _), _)| due(*block)) {
                    shadows.show(context, encoder, keyframe.view, keyframe.frame % work.frames);
                    reuse.encode_keyframe(
                        context,
                        encoder,
                        frame_group,
                        &plan.groups,
                        work.group.targets,
                        work.group.views[0],
                        keyframe,
                        entry,
                    );
                }
            }
            shadows.show(context, encoder, look.view, look.k);
            let job = number * means.jobs_per_look;
            let parts = borrowed(&look.parts);
            for sample in 0..samples {
                let known = |pass: &mut wgpu::RenderPass<'_>, part: usize| {
                    if let Some(plan) = plan {
                        let place = (frame, sample, number);
                        reuse.draw(context, pass, frame_group, &plan.groups, &look.still[part], place);
                    }
                };
                encode_sample(
                    context,
                    encoder,
                    (scratch, sample),
                    frame_group,
                    (frame, sample),
                    &parts,
                    known,
                );
                resolve.encode_tiles(encoder, resolving, job + 1 + sample, look.tiles);
            }
            if samples > 1 {
                self.mean.encode_tiles(encoder, &means.mean, job, look.tiles);
            }
        }
    }

    /// Records the luminance of `work`: first the keys of tiles, and what is followed between them; then, once it is known
    /// which tiles cannot be followed, everything else.
    fn encode_marched(
        &mut self,
        context: &Context,
        encoder: &mut wgpu::CommandEncoder,
        work: &Work<'_>,
        march: &mut MarchRoom,
    ) -> Result<(), EngineError> {
        let views = &work.views;
        let device = &context.gpu.device;
        let first_view = work.group.views[0];
        let plan = march.plan(device, first_view, views, &work.paces, work.length, work.unit.first - 1);

        let mut tiles = Vec::new();
        let mut keys = Vec::new();
        for key in &plan.looks {
            let p = work.place(key.view, key.block);
            let paces = &work.paces[p];
            let lens = &views[key.view as usize].lens;
            let mut squares = Squares::new(lens.width, lens.height);
            let mut felt = vec![0; paces.tiles.len()];
            for gap in &key.keys {
                squares.add(gap.tile, ALL_QUARTERS, 1);
                if key.number > 0 {
                    felt[gap.tile as usize] = ALL_QUARTERS;
                }
            }
            if key.number > 0 {
                for (tile, pace) in paces.tiles.iter().enumerate() {
                    if plan.lengths[p][tile].is_none() && work.is_due(*pace, key.block, key.number) {
                        squares.add(tile as u32, ALL_QUARTERS, 0);
                        felt[tile] = ALL_QUARTERS;
                    }
                }
            }
            keys.push(look(context, work, (key.view, key.k), &squares, &felt, &mut tiles));
        }
        let mut told = Vec::new();
        if !keys.is_empty() {
            let means = self.upload(context, work, &keys, &tiles);
            let size_index = work.group.targets;
            let scratch = &self.scratch[size_index];
            let groups = march.upload(
                context,
                first_view,
                views,
                size_index,
                scratch,
                &work.targets.layers.array,
                &plan,
                (work.frames, work.unit.instants),
            );
            let mut early = device.create_command_encoder(&Default::default());
            self.draw(context, &mut early, work, &means, &keys, |encoder, number, look| {
                if let Some(groups) = &groups {
                    march.encode(
                        context,
                        encoder,
                        &work.frame_group,
                        groups,
                        (size_index, &self.scratch[size_index]),
                        work.frame_of(look),
                        &look.parts,
                        (number, &plan.looks[number as usize]),
                    );
                }
            });
            told = march.verdicts(context, early, &plan)?;
        }

        let had_keys: HashSet<(u32, u32, u32)> =
            plan.looks.iter().map(|key| (key.view, key.block, key.number)).collect();
        let mut tiles = Vec::new();
        let mut rest = Vec::new();
        for block in 0..work.blocks {
            for number in 1..=work.length {
                for view in 0..views.len() as u32 {
                    let p = work.place(view, block);
                    let paces = &work.paces[p];
                    let lens = &views[view as usize].lens;
                    let mut squares = Squares::new(lens.width, lens.height);
                    let mut felt = vec![0; paces.tiles.len()];
                    for (tile, pace) in paces.tiles.iter().enumerate() {
                        let quarters = match plan.lengths[p][tile] {
                            None if had_keys.contains(&(view, block, number)) => 0,
                            Some(every) if number.is_multiple_of(1 << every) => 0,
                            _ if !work.is_due(*pace, block, number) => 0,
                            None => ALL_QUARTERS,
                            Some(_) => {
                                plan.verdict(p, tile, number).map_or(0, |at| left_over(told[at as usize]))
                            }
                        };
                        if quarters != 0 {
                            felt[tile] = quarters;
                            squares.add(tile as u32, quarters, 0);
                        }
                    }
                    if felt.iter().any(|quarters| *quarters != 0) {
                        let k = block * work.length + number;
                        rest.push(look(context, work, (view, k), &squares, &felt, &mut tiles));
                    }
                }
            }
        }
        let means = self.upload(context, work, &rest, &tiles);
        self.draw(context, encoder, work, &means, &rest, |_, _, _| {});
        self.drawn_pixels += keys.iter().chain(&rest).map(Look::pixels).sum::<u64>();
        Ok(())
    }

    /// Records `looks`: their samples, and their means; `then` records what follows each of them.
    fn draw(
        &self,
        context: &Context,
        encoder: &mut wgpu::CommandEncoder,
        work: &Work<'_>,
        means: &MeanGroups,
        looks: &[Look],
        mut then: impl FnMut(&mut wgpu::CommandEncoder, u32, &Look),
    ) {
        let scratch = &self.scratch[work.group.targets];
        let mut shadows = work.shadows();
        for (number, look) in (0..).zip(looks) {
            shadows.show(context, encoder, look.view, look.k);
            let frame = work.frame_of(look);
            let (frame_group, job) = (&work.frame_group, number * means.jobs_per_look);
            if let (Some(resolve), Some(resolving)) = (&self.resolve, &means.resolve) {
                let parts = borrowed(&look.parts);
                encode_sample(context, encoder, (scratch, 0), frame_group, (frame, 0), &parts, |_, _| {});
                resolve.encode_tiles(encoder, resolving, job, look.tiles);
            } else {
                encode_luminance(context, encoder, scratch, frame_group, frame, 0, Some(&look.parts));
                if look.tiles > 0 {
                    self.mean.encode_tiles(encoder, &means.mean, job, look.tiles);
                }
            }
            then(encoder, number, look);
        }
    }

    /// Instants of a block of `unit`: the stream's first instant has a submission of its own.
    const fn block_of(&self, unit: &Unit) -> u32 {
        if unit.first == 0 { 1 } else { self.block }
    }

    /// Per view and block.
    fn paces(&self, context: &Context, views: &[View], group: &Group, unit: &Unit) -> Vec<Paces> {
        let length = self.block_of(unit);
        let blocks = unit.instants / length;
        let frames = self.frames(unit) as usize;
        let mut paces = Vec::new();
        for (v, view) in views.iter().enumerate() {
            let only = self.only.get(group.views[v]);
            let (columns, rows) = (tiles_along(view.lens.width), tiles_along(view.lens.height));
            for block in 0..blocks {
                let count = (columns * rows) as usize;
                let all = |pace| Paces { columns, tiles: vec![pace; count], relit: vec![false; count] };
                if unit.first == 0 {
                    paces.push(all(0).restricted(only));
                    continue;
                }
                #[cfg(test)]
                if let Some(pace) = self.forced {
                    paces.push(all(pace).restricted(only));
                    continue;
                }
                let start = v * frames + (block * length) as usize;
                let range = start..start + length as usize + 1;
                let passing = Passing::new(&context.frame_data, range, &view.lens, self.sky);
                let mut own = self.pacer.paces(&context.gpu_scene, &passing);
                // No sample may stand for the light between two others.
                if view.sensor.walks_on_host() {
                    own.tiles.fill(0);
                }
                paces.push(own.restricted(only));
            }
        }
        paces
    }

    /// Instants from one keyframe to the next.
    fn between_keys(&self) -> i64 {
        i64::from(self.block * self.blocks_per_key)
    }

    /// The keyframes around the instants of `unit`.
    fn keys(&self, unit: &Unit) -> Range<i64> {
        if self.reuse.is_none() {
            return 0..0;
        }
        let last = unit.first + i64::from(unit.instants) - 1;
        let every = self.between_keys();
        (unit.first - 1).max(0) / every..(last.max(1) + every - 1) / every + 1
    }

    /// Frames of a view in a submission: the instant before the first, the instants, the keyframes.
    fn frames(&self, unit: &Unit) -> u32 {
        let keys = self.keys(unit);
        1 + unit.instants + (keys.end - keys.start) as u32
    }

    /// Per view and block: whose light is used again, and from where.
    fn reused(&self, context: &Context, work: &Work<'_>) -> Vec<Option<Reused>> {
        let &Work { unit, length, blocks, frames, .. } = work;
        let keys = self.keys(unit);
        if keys.is_empty() {
            return Vec::new();
        }
        let trail = &context.frame_data.trail;
        let of = |v: u32, block: u32| {
            let older = (unit.first + i64::from(block * length) - 1).max(0) / self.between_keys();
            let start = v * frames;
            let frame_of = |key: i64| start + 1 + unit.instants + (key - keys.start) as u32;
            let around = [frame_of(older), frame_of(older + 1)];
            let block = start + block * length..=start + (block + 1) * length;
            let all = || block.clone().chain(around).map(|frame| frame as usize);
            // Where the camera stands still, nothing that stands still is rendered again anyway.
            let camera = &trail.camera_from_world[around[0] as usize];
            if all().all(|frame| trail.camera_from_world[frame] == *camera) {
                return None;
            }
            Some(Reused { steady: steady(trail, &context.gpu_scene.objects, all())?, keyframes: [older, older + 1], frames: around })
        };
        (0..work.views.len() as u32)
            .flat_map(|v| (0..blocks).map(move |block| (v, block)))
            .map(|(v, b)| of(v, b))
            .collect()
    }

    /// Which keyframes a submission draws, and what its instants read of them.
    fn plan_reuse(
        &mut self,
        context: &Context,
        work: &Work<'_>,
        reused: &[Option<Reused>],
        looks: &[Look],
    ) -> Option<ReusePlan> {
        let views = &work.views;
        let every = self.between_keys();
        let reuse = self.reuse.as_mut()?;
        if reused.iter().all(Option::is_none) {
            return None;
        }
        let first_view = work.group.views[0];
        let lens = &views[0].lens;
        reuse.open(&context.gpu.device, first_view, views.len() as u32, [lens.width, lens.height]);
        let mut keyframes = Vec::new();
        let mut instants = Vec::new();
        for look in looks {
            let block = (look.k - 1) / work.length;
            let Some(of) = &reused[work.place(look.view, block)] else {
                // Nothing is looked up.
                instants.push(Instant::default());
                continue;
            };
            for (number, frame) in of.keyframes.into_iter().zip(of.frames) {
                if reuse.claim(first_view, look.view, number) {
                    keyframes.push((block, Keyframe { view: look.view, number, frame }));
                }
            }
            let us = |instant: i64| context.grid.instant_us(instant) as f64;
            let [older, newer] = of.keyframes.map(|number| us(number * every));
            let now = us(work.unit.first + i64::from(look.k) - 1);
            instants.push(Instant {
                view: look.view,
                frame: work.frame_of(look),
                around: of.frames,
                keyframes: of.keyframes,
                weight: ((now - older) / (newer - older)) as f32,
            });
        }
        let drawn: Vec<Keyframe> = keyframes.iter().map(|(_, keyframe)| *keyframe).collect();
        let groups = reuse.upload(context, first_view, views, &instants, &drawn)?;
        Some(ReusePlan { groups, keyframes })
    }

    /// What is drawn, in order of time, then view; the numbers of its tiles go to `tiles`.
    fn looks(
        &self,
        context: &Context,
        work: &Work<'_>,
        reused: &[Option<Reused>],
        tiles: &mut Vec<u32>,
    ) -> Vec<Look> {
        let mut looks = Vec::new();
        for block in 0..work.blocks {
            // By view, then by how often the instants come: rectangles, for the objects where they are at the block's end.
            let mut plans: Vec<HashMap<u32, Vec<(Rect, bool)>>> = vec![HashMap::new(); work.views.len()];
            for number in 1..=work.length {
                let k = block * work.length + number;
                for (v, view) in (0..).zip(&work.views) {
                    let of = &work.paces[work.place(v, block)];
                    let reused = reused.get(work.place(v, block)).and_then(Option::as_ref);
                    let active = |pace: u8| work.is_due(pace, block, number);
                    if !of.tiles.iter().any(|pace| active(*pace)) {
                        continue;
                    }
                    let in_view = InView::new(context, view, v * work.frames + k);
                    let size = (view.lens.width, view.lens.height);
                    let rects = plans[v as usize].entry(number.trailing_zeros()).or_insert_with(|| {
                        let at = |x: u32, y: u32| (y * of.columns + x) as usize;
                        let chosen = |relit: bool| {
                            let chosen = |x, y| {
                                active(of.tiles[at(x, y)])
                                    && (reused.is_none() || of.relit[at(x, y)] == relit)
                            };
                            in_view.rects(chosen, TILE, size, self.made.pixel_price())
                        };
                        // What is lit anew first: where rectangles overlap, the first one stays.
                        let anew = chosen(true).into_iter().map(|rect| (rect, true));
                        match reused {
                            None => anew.collect(),
                            Some(_) => {
                                anew.chain(chosen(false).into_iter().map(|rect| (rect, false))).collect()
                            }
                        }
                    });
                    let first_tile = tiles.len() as u32;
                    for (index, pace) in (0..).zip(&of.tiles) {
                        if active(*pace) {
                            tiles.push(tile_word(index, of.columns, ALL_QUARTERS));
                        }
                    }
                    let (mut parts, mut still) = (Vec::new(), Vec::new());
                    for (rect, anew) in rects.iter() {
                        let all = in_view.items(rect);
                        let known = reused.filter(|_| !anew);
                        still.push(known.map_or(Vec::new(), |of| of.still(context, &all)));
                        parts.push((*rect, all));
                    }
                    let count = tiles.len() as u32 - first_tile;
                    looks.push(Look { view: v, k, parts, still, first_tile, tiles: count });
                }
            }
        }
        looks
    }

    /// What the means are made from.
    fn upload(&mut self, context: &Context, work: &Work<'_>, looks: &[Look], tiles: &[u32]) -> MeanGroups {
        let (device, queue) = (&context.gpu.device, &context.gpu.queue);
        let samples = context.offsets.len() as u32;
        // Per look: the mean of its samples, then what each of them is the mean of, where it is one.
        let jobs_per_look = if self.reuse.is_some() { 1 + samples } else { 1 };
        let job = |look: &Look, pass: u32| MeanJob {
            first: look.first_tile,
            count: look.tiles,
            row: sizes::dispatch(look.tiles, 1).0,
            layer: match pass {
                1.. if samples > 1 => pass - 1,
                // The instant before the first has no layer, and no tiles.
                _ => (look.view * work.unit.instants + look.k).wrapping_sub(1),
            },
        };
        let jobs: Vec<MeanJob> =
            looks.iter().flat_map(|look| (0..jobs_per_look).map(move |pass| job(look, pass))).collect();
        self.jobs.write(device, queue, &aligned(&jobs));
        self.tiles.write(device, queue, bytemuck::cast_slice(tiles));
        let scratch = &self.scratch[work.group.targets];
        let view = wgpu::BindingResource::TextureView;
        let resources = |from, to| {
            let job = pass::part(self.jobs.get(), 0, size_of::<MeanJob>() as u64);
            vec![job, self.tiles.get().as_entire_binding(), view(from), view(to)]
        };
        let layers = &work.targets.layers.array;
        let mean = resources(&scratch.array, layers);
        let resolve = self.resolve.as_ref().zip(scratch.multisampled.as_ref()).map(|(resolve, samples4)| {
            let to = if samples > 1 { &scratch.array } else { layers };
            let resources = resources(samples4, to);
            pass::group(device, "tile resolve", &resolve.layout, TILE_RESOLVE_BINDINGS, resources)
        });
        let mean = pass::group(device, "mean", &self.mean.layout, MEAN_BINDINGS, mean);
        MeanGroups { mean, resolve, jobs_per_look }
    }

    /// Keeps the last instant for the next submission.
    fn keep(
        &mut self,
        context: &Context,
        encoder: &mut wgpu::CommandEncoder,
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

/// All quarters of a tile: the upper left, the upper right, the lower left, the lower right.
const ALL_QUARTERS: u8 = 15;

/// Parts of a picture that are rendered, in squares of as many pixels as software drivers shade at once.
struct Squares {
    columns: u32,
    rows: u32,
    chosen: Vec<bool>,
}

impl Squares {
    /// Pixels along a side.
    const SIDE: u32 = 4;
    /// Squares along a quarter of a tile.
    const QUARTER: u32 = TILE / 2 / Self::SIDE;

    /// None of a picture's.
    fn new(width: u32, height: u32) -> Self {
        let (columns, rows) =
            (tiles_along(width) * 2 * Self::QUARTER, tiles_along(height) * 2 * Self::QUARTER);
        Self { columns, rows, chosen: vec![false; (columns * rows) as usize] }
    }

    /// Adds `quarters` of a tile, and `around` squares on every side.
    fn add(&mut self, tile: u32, quarters: u8, around: u32) {
        let tiles = self.columns / (2 * Self::QUARTER);
        for quarter in (0..4).filter(|quarter| quarters >> quarter & 1 != 0) {
            let column = (tile % tiles * 2 + quarter % 2) * Self::QUARTER;
            let row = (tile / tiles * 2 + quarter / 2) * Self::QUARTER;
            for y in row.saturating_sub(around)..(row + Self::QUARTER + around).min(self.rows) {
                let line = (y * self.columns) as usize;
                let from = column.saturating_sub(around) as usize;
                let to = (column + Self::QUARTER + around).min(self.columns) as usize;
                self.chosen[line + from..line + to].fill(true);
            }
        }
    }
}

/// The `squares` of a view at frame `k`; the means of the quarters of tiles that are `felt` are wanted, and their numbers go
/// to `tiles`.
fn look(
    context: &Context,
    work: &Work<'_>,
    (view, k): (u32, u32),
    squares: &Squares,
    felt: &[u8],
    tiles: &mut Vec<u32>,
) -> Look {
    let lens = &work.views[view as usize].lens;
    let columns = tiles_along(lens.width);
    let in_view = InView::new(context, &work.views[view as usize], view * work.frames + k);
    let active = |x: u32, y: u32| squares.chosen[(y * squares.columns + x) as usize];
    let parts = in_view.parts(active, Squares::SIDE, (lens.width, lens.height), 1.0);
    let first_tile = tiles.len() as u32;
    for (index, quarters) in (0..).zip(felt).filter(|(_, quarters)| **quarters != 0) {
        tiles.push(tile_word(index, columns, *quarters));
    }
    let tiles = tiles.len() as u32 - first_tile;
    Look { view, k, parts, still: Vec::new(), first_tile, tiles }
}

/// A tile, the means of whose `quarters` are wanted, for `adaptive/tiles.wgsl`.
fn tile_word(index: u32, columns: u32, quarters: u8) -> u32 {
    (index % columns) | (index / columns) << 16 | u32::from(ALL_QUARTERS & !quarters) << 28
}

/// What means read and write: of samples, and of coverage samples.
struct MeanGroups {
    mean: wgpu::BindGroup,
    resolve: Option<wgpu::BindGroup>,
    jobs_per_look: u32,
}

/// Whose light is used again during a block of a view, and from where.
struct Reused {
    /// Per object: whether it stands still.
    steady: Vec<bool>,
    /// Numbers of the keyframes around the block.
    keyframes: [i64; 2],
    /// Their frames.
    frames: [u32; 2],
}

impl Reused {
    /// What of `all` takes its light from keyframes: nothing that moves, nothing that has holes.
    fn still(&self, context: &Context, all: &[DrawItem]) -> Vec<DrawItem> {
        let mut still = Vec::new();
        for item in all.iter().filter(|item| !context.gpu_scene.draws[item.draw as usize].variant.mask) {
            for object in item.objects.clone().filter(|&object| self.steady[object as usize]) {
                push_item(&mut still, item.draw, object);
            }
        }
        still
    }
}

/// What a submission uses again.
struct ReusePlan {
    groups: ReuseGroups,
    /// With the block at whose begin each is drawn.
    keyframes: Vec<(u32, Keyframe)>,
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
