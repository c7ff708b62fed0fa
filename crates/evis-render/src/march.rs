//! `march`: adaptive time in which a tile that shows one surface without edges is rendered only every few pixels of motion.
//! Such renderings are its keys. Between two of them each pixel walks its exact way through both and takes its light from
//! there; tiles of which that cannot be told for sure are rendered as ever.
//!
//! Keys lie at fixed instants of a block, and a tile's key is a function of view and instant alone: one that a restart has
//! displaced is rendered again, with the same bytes. Every tile holds its own surroundings too, so that no tile needs to know
//! when its neighbours have keys.

use std::collections::HashMap;

use wgpu::util::DeviceExt as _;

use crate::engine::{Context, map, wait_mapped};
use crate::error::EngineError;
use crate::frame::columns;
use crate::frame_buffers::{GrowingBuffer, aligned};
use crate::geometry::attachment;
use crate::gpu_scene::Part;
use crate::interval::{Drawing, depth_attachment, draw_surfaces};
use crate::pace::{Paces, STILL, TILE, tiles_along};
use crate::pass::march::{KEEP_BINDINGS, MarchPasses, PLACE_BINDINGS, PLACE_FORMAT, WALK_BINDINGS};
use crate::pass::raster::{SceneConstants, UNIFORM_ALIGNMENT};
use crate::pass::{self};
use crate::pattern;
use crate::sizes::{self, DeviceLimits};
use crate::targets::{Layers, array, whole};
use crate::uniforms::MarchJob;
use crate::view::View;

/// Pixels around a tile that its keys hold too; `march/layout.wgsl` has the same constant.
pub const APRON: u32 = 4;
/// Pixels of a key's side.
const SIDE: u32 = TILE + 2 * APRON;
/// Pixels that anything may move from key to key, at most: less than the apron, so that all that may come in is known.
const KEY_PX: f64 = 2.4;
/// Keys of a tile that are kept: the older, and the newer.
const SLOTS: u32 = 2;
/// Places per pixel and axis at which a key knows mean light; `march/layout.wgsl` has the same constant.
pub const PHASES: u32 = 4;
/// Layers that the keys of a view take.
pub const LAYERS: u32 = SLOTS * PHASES;
/// Tiles along a side, at most: ten bits each in a [`Gap::word`].
const MOST_TILES: u32 = 1 << 10;

/// Refuses pictures of `width` x `height` pixels whose keys no texture of the device holds.
///
/// # Errors
/// Names what would work.
pub fn check_size(width: u32, height: u32, limits: &DeviceLimits) -> Result<(), EngineError> {
    let most = (limits.texture_edge / SIDE).min(MOST_TILES) * TILE;
    if width.max(height) <= most {
        return Ok(());
    }
    Err(EngineError::Device(format!(
        "{width}x{height} pixels: march takes pictures of {most}x{most} pixels at most on this device; choose a smaller \
         --size, or --method native"
    )))
}

/// log2 of the instants between two keys of a tile that is looked at every `2^pace` instants of a block of `2^slowest`;
/// `None` where that would be no fewer renderings.
pub fn key_length(pace: u8, slowest: u8, step_px: f64) -> Option<u8> {
    let more = (KEY_PX / step_px).log2().floor().max(0.0) as u8;
    let length = pace.saturating_add(more).min(slowest);
    (pace != STILL && length > pace).then_some(length)
}

/// The quarters of a tile, a bit each, that a verdict says cannot be followed.
pub fn left_over(verdict: u32) -> u8 {
    (0..4).filter(|quarter| verdict >> (3 * quarter) & 7 != 0).map(|quarter| 1 << quarter).sum()
}

/// A key of a tile, and the gap that ends with it, where one does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gap {
    /// Tile, row by row.
    pub tile: u32,
    /// Where the key goes.
    pub slot: u8,
    /// The tile is looked at every `2^pace` instants.
    pub pace: u8,
    /// log2 of the instants from one key to the next.
    pub length: u8,
    /// Pixels around the tile that may come into it.
    pub reach: u8,
}

impl Gap {
    /// For the shaders.
    pub fn word(&self, columns: u32) -> u32 {
        let fields = [
            (self.tile % columns, 0),
            (self.tile / columns, 10),
            (u32::from(self.slot), 20),
            (u32::from(self.pace), 21),
            (u32::from(self.length), 25),
            (u32::from(self.reach), 29),
        ];
        fields.into_iter().map(|(value, shift)| value << shift).sum()
    }
}

/// A view's keys at an instant.
pub struct KeyLook {
    /// View of the group.
    pub view: u32,
    /// Block of the unit.
    pub block: u32,
    /// Instant of the block: 0 is the one before its first, with which no gap ends.
    pub number: u32,
    /// Frame within the view: 0 is the instant before the unit's first.
    pub k: u32,
    /// Tiles that keep a key.
    pub keys: Vec<Gap>,
    /// Place of the verdict about the first one's gap.
    pub verdict: u32,
}

/// What a unit's tiles do.
pub struct MarchPlan {
    /// In order of time.
    pub looks: Vec<KeyLook>,
    /// Per view and block, per tile: log2 of the instants between keys, where it has any.
    pub lengths: Vec<Vec<Option<u8>>>,
    /// Per view and block, per tile: places of the verdicts of its gaps, in order.
    verdicts: Vec<Vec<Vec<u32>>>,
    count: u32,
}

impl MarchPlan {
    /// Place of the verdict about the gap of `tile` in which instant `number` of a block lies, from 1 on.
    pub fn verdict(&self, paces: usize, tile: usize, number: u32) -> Option<u32> {
        let length = self.lengths[paces][tile]?;
        Some(self.verdicts[paces][tile][((number - 1) >> length) as usize])
    }
}

/// The keys of a group's views.
struct Store {
    /// Per slot a layer for each phase along y; a texel has those along x.
    means: wgpu::TextureView,
    places: wgpu::TextureView,
    /// Per view and tile: the instant of its last key, and its slot.
    held: Vec<Option<(i64, u8)>>,
}

/// The room.
pub struct MarchRoom {
    passes: MarchPasses,
    step_px: f64,
    sample_of: wgpu::Buffer,
    first_records: GrowingBuffer,
    jobs: GrowingBuffer,
    tiles: GrowingBuffer,
    motions: GrowingBuffer,
    verdicts: GrowingBuffer,
    staging: Option<wgpu::Buffer>,
    /// Per class of views: places of the picture in work.
    places: Vec<wgpu::TextureView>,
    /// By the first view of a group.
    stores: HashMap<usize, Store>,
    /// Quarters of tiles that were followed so far, then those that were not, by each reason.
    #[cfg(test)]
    pub told: [u64; 4],
}

/// What a submission's passes read.
pub struct MarchGroups {
    place: wgpu::BindGroup,
    keep: wgpu::BindGroup,
    walk: wgpu::BindGroup,
}

impl MarchRoom {
    /// For what is drawn of the scene, no more than `step_px` apart.
    pub fn new(context: &Context, constants: &SceneConstants, step_px: f64) -> Self {
        let device = &context.gpu.device;
        let samples = context.offsets.len();
        let grid = pattern::grid(samples).map(|cells| cells as u32);
        let places: Vec<[f32; 2]> = context.offsets.iter().map(|o| o.map(|v| -v)).collect();
        let mut sample_of = [0u32; 64];
        for (sample, [x, y]) in (0..).zip(pattern::cells(&places)) {
            sample_of[(y * grid[0] + x) as usize] = sample;
        }
        let buffer = |label, usage| GrowingBuffer::new(device, label, usage);
        Self {
            passes: MarchPasses::new(
                device,
                &context.layouts,
                &context.gpu_scene.variants(),
                constants,
                grid,
            ),
            step_px,
            sample_of: device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some("samples of cells"),
                contents: bytemuck::cast_slice(&sample_of),
                usage: wgpu::BufferUsages::UNIFORM,
            }),
            first_records: buffer("first records", wgpu::BufferUsages::UNIFORM),
            jobs: buffer("march jobs", wgpu::BufferUsages::UNIFORM),
            tiles: buffer("march tiles", wgpu::BufferUsages::STORAGE),
            motions: buffer("motions", wgpu::BufferUsages::STORAGE),
            verdicts: buffer("verdicts", wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC),
            staging: None,
            places: Vec::new(),
            stores: HashMap::new(),
            #[cfg(test)]
            told: [0; 4],
        }
    }

    /// Makes room for views of `width` x `height` pixels, the next class in order.
    pub fn add_class(&mut self, device: &wgpu::Device, width: u32, height: u32) {
        let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::STORAGE_BINDING;
        self.places.push(whole(&array(device, "places", [width, height, 1], PLACE_FORMAT, usage)));
    }

    /// What is rendered, kept and followed during a unit of blocks of `length` instants that begins after `before`: from the
    /// paces of its views and blocks.
    pub fn plan(
        &mut self,
        device: &wgpu::Device,
        first_view: usize,
        views: &[View],
        paces: &[Paces],
        length: u32,
        before: i64,
    ) -> MarchPlan {
        let lens = &views[0].lens;
        let (columns, rows) = (tiles_along(lens.width), tiles_along(lens.height));
        let tiles = (columns * rows) as usize;
        let store = self.stores.entry(first_view).or_insert_with(|| {
            let layers = views.len() as u32 * SLOTS;
            let usage = wgpu::TextureUsages::STORAGE_BINDING;
            let layers_of = |layers| {
                let size = [columns * SIDE, rows * SIDE, layers];
                whole(&array(device, "keys", size, PLACE_FORMAT, usage))
            };
            Store {
                means: layers_of(layers * PHASES),
                places: layers_of(layers),
                held: vec![None; views.len() * tiles],
            }
        });
        let slowest = length.trailing_zeros() as u8;
        let step_px = self.step_px;
        let followed = |p: &Paces| -> Vec<Option<u8>> {
            let of = |(&pace, &relit): (&u8, &bool)| key_length(pace, slowest, step_px).filter(|_| !relit);
            p.tiles.iter().zip(&p.relit).map(of).collect()
        };
        let lengths: Vec<Vec<Option<u8>>> = paces.iter().map(followed).collect();
        let blocks = paces.len() / views.len();
        let mut verdicts = vec![vec![Vec::new(); tiles]; paces.len()];
        let mut looks = Vec::new();
        let mut count = 0;
        for block in 0..blocks {
            for number in 0..=length {
                let k = block as u32 * length + number;
                let now = before + i64::from(k);
                for view in 0..views.len() {
                    let of = view * blocks + block;
                    let verdict = count;
                    let mut keys = Vec::new();
                    for (tile, every) in lengths[of].iter().enumerate() {
                        let Some(every) = *every else { continue };
                        let held = &mut store.held[view * tiles + tile];
                        // A block's first keys are those that the one before left, where it did.
                        let due = if number == 0 {
                            held.is_none_or(|(at, _)| at != now)
                        } else {
                            number.is_multiple_of(1 << every)
                        };
                        if !due {
                            continue;
                        }
                        let pace = paces[of].tiles[tile];
                        let slot = held.map_or(0, |(_, slot)| 1 - slot);
                        *held = Some((now, slot));
                        let reach = (step_px * f64::from(1 << (every - pace))).ceil() as u8 + 1;
                        let reach = reach.min(APRON as u8);
                        keys.push(Gap { tile: tile as u32, slot, pace, length: every, reach });
                        if number > 0 {
                            verdicts[of][tile].push(count);
                            count += 1;
                        }
                    }
                    if !keys.is_empty() {
                        let (view, block) = (view as u32, block as u32);
                        looks.push(KeyLook { view, block, number, k, keys, verdict });
                    }
                }
            }
        }
        MarchPlan { looks, lengths, verdicts, count }
    }

    /// Uploads what the passes of `plan` need.
    #[expect(clippy::too_many_arguments, reason = "all that a key is made of")]
    pub fn upload(
        &mut self,
        context: &Context,
        first_view: usize,
        views: &[View],
        class: usize,
        scratch: &Layers,
        layers: &wgpu::TextureView,
        plan: &MarchPlan,
        (frames, instants): (u32, u32),
    ) -> Option<MarchGroups> {
        let (device, queue) = (&context.gpu.device, &context.gpu.queue);
        let store = self.stores.get(&first_view)?;
        let data = &context.frame_data;
        let objects = context.gpu_scene.objects.len();
        let columns_of = tiles_along(views[0].lens.width);
        let mut words: Vec<u32> = Vec::new();
        let mut jobs = Vec::new();
        let mut records = Vec::new();
        for look in &plan.looks {
            let View { lens, sensor, .. } = &views[look.view as usize];
            let frame = look.view * frames + look.k;
            records.push(context.object_base(frame));
            let world_from_camera = data.trail.camera_from_world[frame as usize].inverse();
            let axis = |v: glam::DVec4| [v.x as f32, v.y as f32, v.z as f32, 0.0];
            let count = look.keys.len() as u32;
            jobs.push(MarchJob {
                world_from_camera_right: axis(world_from_camera.x_axis),
                world_from_camera_up: axis(world_from_camera.y_axis),
                world_from_camera_back: axis(world_from_camera.z_axis),
                ray: lens.ray().map(|v| v as f32),
                first: words.len() as u32,
                count,
                row: sizes::dispatch(count, 1).0,
                frame,
                matrices: 1 + objects as u32,
                view: look.view,
                // Frame 0 has none, and nothing asks for it.
                layer: (look.view * instants + look.k).wrapping_sub(1),
                verdict: look.verdict,
                half_size: [lens.width, lens.height].map(|v| v as f32 / 2.0),
                dark: sensor.log_eps * context.reference_luminance,
                pad: 0,
            });
            words.extend(look.keys.iter().map(|key| key.word(columns_of)));
        }
        let mut motions: Vec<[[f32; 4]; 4]> =
            Vec::with_capacity(views.len() * frames as usize * (1 + objects));
        for (frame, camera) in data.trail.camera_from_world.iter().enumerate() {
            let lens = &views[frame / frames as usize].lens;
            motions.push(columns(&(lens.clip_from_camera() * *camera)));
            let own = &data.instances[frame * objects..(frame + 1) * objects];
            motions.extend(own.iter().map(|record| record.clip_from_object));
        }
        self.first_records.write(device, queue, &aligned(&records));
        self.jobs.write(device, queue, &aligned(&jobs));
        self.tiles.write(device, queue, bytemuck::cast_slice(&words));
        self.motions.write(device, queue, bytemuck::cast_slice(&motions));
        self.verdicts.write(device, queue, bytemuck::cast_slice(&vec![0u32; plan.count as usize]));
        let view = wgpu::BindingResource::TextureView;
        let with = |rest: Vec<_>| {
            let mut all = vec![
                pass::part(self.jobs.get(), 0, size_of::<MarchJob>() as u64),
                self.tiles.get().as_entire_binding(),
                self.motions.get().as_entire_binding(),
            ];
            all.extend(rest);
            all
        };
        let verdicts = || self.verdicts.get().as_entire_binding();
        let kept = || vec![view(&store.means), view(&store.places)];
        let mut keep = vec![view(&scratch.array), view(&self.places[class])];
        keep.extend(kept());
        keep.push(self.sample_of.as_entire_binding());
        let walk = [kept(), vec![view(layers), verdicts()]].concat();
        let passes = &self.passes;
        let place = vec![pass::part(self.first_records.get(), 0, size_of::<u32>() as u64)];
        Some(MarchGroups {
            place: pass::group(device, "places", &passes.place_layout, PLACE_BINDINGS, place),
            keep: pass::group(device, "keep", &passes.keep.layout, KEEP_BINDINGS, with(keep)),
            walk: pass::group(device, "walk", &passes.walk.layout, WALK_BINDINGS, with(walk)),
        })
    }

    /// Records what follows the rendering of the `number`th look of the plan: its tiles are kept, and the gaps that end with
    /// it are judged and walked.
    #[expect(clippy::too_many_arguments, reason = "what a key is made of, in order")]
    pub fn encode(
        &self,
        context: &Context,
        encoder: &mut wgpu::CommandEncoder,
        frame_group: &wgpu::BindGroup,
        groups: &MarchGroups,
        (class, scratch): (usize, &Layers),
        frame: u32,
        parts: &[Part],
        (number, look): (u32, &KeyLook),
    ) {
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("places"),
            color_attachments: &[Some(attachment(&self.places[class], wgpu::Color::TRANSPARENT))],
            depth_stencil_attachment: Some(depth_attachment(&scratch.depth, wgpu::StoreOp::Store)),
            ..Default::default()
        });
        pass.set_bind_group(3, &groups.place, &[number * UNIFORM_ALIGNMENT as u32]);
        for (rect, items) in parts {
            let [width, height] = rect.size();
            pass.set_scissor_rect(rect.low[0], rect.low[1], width, height);
            let what = Drawing { items, frame, sample: None, first_record: context.object_base(frame) };
            let surroundings = Some(&context.surroundings);
            draw_surfaces(context, &mut pass, &self.passes.places, frame_group, surroundings, &what);
        }
        drop(pass);
        let tiles = look.keys.len() as u32;
        self.passes.keep.encode_tiles(encoder, &groups.keep, number, tiles);
        if look.number > 0 {
            self.passes.walk.encode_tiles(encoder, &groups.walk, number, tiles);
        }
    }

    /// Submits `encoder` and waits for what was said about every gap of `plan`: see [`left_over`].
    ///
    /// # Errors
    /// The device may fail.
    pub fn verdicts(
        &mut self,
        context: &Context,
        mut encoder: wgpu::CommandEncoder,
        plan: &MarchPlan,
    ) -> Result<Vec<u32>, EngineError> {
        let bytes = u64::from(plan.count) * 4;
        let fits = |buffer: &wgpu::Buffer| buffer.size() >= bytes;
        let staging = match self.staging.take().filter(fits) {
            Some(staging) => staging,
            None => context.gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("verdicts for the host"),
                size: bytes.next_power_of_two(),
                usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            }),
        };
        encoder.copy_buffer_to_buffer(self.verdicts.get(), 0, &staging, 0, bytes);
        let submission = context.gpu.queue.submit([encoder.finish()]);
        let mapped = map(&staging);
        wait_mapped(&context.gpu, &submission, &mapped)?;
        let told: Vec<u32> = {
            let range = staging
                .get_mapped_range(0..bytes)
                .map_err(|e| EngineError::Device(format!("cannot read verdicts back: {e}")))?;
            range.chunks_exact(4).map(bytemuck::pod_read_unaligned).collect()
        };
        staging.unmap();
        self.staging = Some(staging);
        #[cfg(test)]
        for quarter in 0..4 {
            for why in told.iter().map(|verdict| verdict >> (3 * quarter) & 7) {
                self.told[0] += u64::from(why == 0);
                for bit in 0..3 {
                    self.told[bit + 1] += u64::from(why >> bit & 1);
                }
            }
        }
        Ok(told)
    }
}
