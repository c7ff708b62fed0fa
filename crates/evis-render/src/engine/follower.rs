//! Pixels of decoupled sampling, followed on a device: blocks go up, events come down.

use std::fmt;
use std::ops::Range;
use std::sync::{Arc, Mutex, OnceLock};

use evis_decoupled::packed::{self, Block, Event, Failed, Found, Memory, PIXELS, Pixel, Textures, Tile};
use evis_decoupled::signal::pixel::UNITS;
use evis_decoupled::{Device, Devices, Error, ViewSensor};
use wgpu::util::DeviceExt;

use crate::config::dense::DenseOutput;
use crate::engine::stages::{LIGHT_ROW_BYTES, MadeArrays, Stages};
use crate::error::EngineError;
use crate::gpu::Gpu;
use crate::gpu::buffer::{GrowingBuffer, aligned};
use crate::gpu::commands::Commands;
use crate::gpu::readback::read;
use crate::gpu::sizes::{self, UNIFORM_ALIGNMENT};
use crate::gpu::uniforms::{Batch, Turn};
use crate::pass::decoupled::{
    AXES, CLASSES, GROUP, HEAD_WORDS, PIXELS_BINDINGS, ROUNDS, SCRATCH_WORDS, TOTAL_WORDS,
};
use crate::pass::{ComputePass, decoupled, group};

/// Events that fit for each pixel, of all pixels together; where there are more, the block is followed again with room for them.
const EVENTS_PER_PIXEL: u32 = 16;
/// Bytes that an array of a block takes at most, if rows of tiles can be followed one after the other: half of what WebGPU's
/// default limits let be bound.
const MOST_BYTES: u64 = 64 << 20;
/// See [`Followers::most_light`]: 128 MB.
const MOST_LIGHT: u32 = 32 << 20;
/// Two blocks: views whose blocks begin within one of another view go through stages together.
const LONGEST_US: f64 = 2.0 * 32_768.0;
/// Bytes of the workgroups of a round, of all classes.
const GROUPS_BYTES: u64 = CLASSES as u64 * AXES as u64 * size_of::<u32>() as u64;
/// Rounds beyond those in which pixels are evaluated where they surely are.
const MORE_ROUNDS: u32 = 8;

/// Those that go before, and by class, made when there are first pixels of it.
struct Passes {
    prepare: ComputePass,
    list: ComputePass,
    follow: [OnceLock<ComputePass>; CLASSES],
}

/// Devices on one adapter, which share its pipelines.
pub struct Followers {
    gpu: Gpu,
    passes: Arc<Passes>,
    /// See [`EVENTS_PER_PIXEL`].
    pub(crate) events_per_pixel: u32,
    /// Whether stages of sensors are on the device.
    pub(crate) has_stages: bool,
    /// Numbers of light that stay there before they take it.
    pub(crate) most_light: u32,
    /// What arrays are wanted of events, and what was made of them.
    dense: Option<(DenseOutput, Arc<Mutex<MadeArrays>>)>,
}

impl fmt::Debug for Followers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Followers({})", self.gpu.summary().name)
    }
}

impl Followers {
    /// Those of `gpu`.
    ///
    /// # Errors
    /// What the device refuses.
    pub fn new(gpu: &Gpu) -> Result<Self, EngineError> {
        let of_all = || Ok((decoupled::prepare(&gpu.device), decoupled::list(&gpu.device)));
        let (prepare, list) = gpu.guarded(of_all)?;
        let passes = Arc::new(Passes { prepare, list, follow: Default::default() });
        for class in [decoupled::PLAIN, decoupled::OTHERS] {
            pass_of(gpu, &passes, class)?;
        }
        Ok(Self {
            gpu: gpu.clone(),
            passes,
            events_per_pixel: EVENTS_PER_PIXEL,
            has_stages: true,
            most_light: MOST_LIGHT,
            dense: None,
        })
    }

    /// The same, which leave arrays in `made` in the place of events that leave a sensor with stages at once.
    pub(super) fn with_dense(mut self, output: DenseOutput, made: &Arc<Mutex<MadeArrays>>) -> Self {
        self.dense = Some((output, Arc::clone(made)));
        self
    }

    /// The same, ready for distorted lenses and maps too.
    #[cfg(test)]
    pub(crate) fn with_all_passes(gpu: &Gpu) -> Result<Self, EngineError> {
        let own = Self::new(gpu)?;
        for class in [decoupled::BENT, decoupled::MAPPED, decoupled::BENT_MAPPED] {
            pass_of(gpu, &own.passes, class)?;
        }
        Ok(own)
    }
}

impl Devices for Followers {
    fn texture_room(&self) -> usize {
        half_a_binding(&self.gpu) as usize
    }

    fn open(&self, textures: &Textures, views: &[ViewSensor]) -> Result<Box<dyn Device>, Error> {
        let mut follower = Follower::new(self, textures, views)?;
        if self.has_stages {
            let wanted = self.dense.as_ref().map(|(output, made)| (*output, made));
            let new = || Ok(Stages::new(&self.gpu, views, wanted, (LONGEST_US, self.most_light)));
            follower.stages = self.gpu.guarded(new).map_err(refused)?;
        }
        Ok(Box::new(follower))
    }
}

/// The pass of a class.
fn pass_of<'p>(gpu: &Gpu, passes: &'p Passes, class: usize) -> Result<&'p ComputePass, EngineError> {
    if let Some(pass) = passes.follow[class].get() {
        return Ok(pass);
    }
    let pass = gpu.guarded(|| Ok(decoupled::pixels(&gpu.device, class)))?;
    Ok(passes.follow[class].get_or_init(|| pass))
}

/// Which pipeline a pixel has, see [`decoupled::pixels`].
fn class_of(pixel: &Pixel) -> usize {
    match pixel.flags {
        flags if flags & (packed::BENT | packed::MAPPED) == packed::BENT | packed::MAPPED => {
            decoupled::BENT_MAPPED
        }
        flags if flags & packed::BENT != 0 => decoupled::BENT,
        flags if flags & packed::MAPPED != 0 => decoupled::MAPPED,
        flags if flags & packed::PLAIN != 0 => decoupled::PLAIN,
        _ => decoupled::OTHERS,
    }
}

/// Which classes of pixels `block` may have.
fn classes_of(block: &Block) -> [bool; CLASSES] {
    let mut has = [false; CLASSES];
    let has_maps = block.entries.iter().any(|entry| entry.flags & packed::HAS_MAPS != 0);
    block.pixels.iter().for_each(|pixel| has[class_of(pixel)] = true);
    for tile in &block.tiles {
        let (classes, mapped) = match tile.frames {
            packed::NO_FRAMES => (&[decoupled::PLAIN, decoupled::OTHERS][..], decoupled::MAPPED),
            _ => (&[decoupled::BENT][..], decoupled::BENT_MAPPED),
        };
        classes.iter().for_each(|class| has[*class] = true);
        has[mapped] |= has_maps;
    }
    has
}

/// Units between evaluations of the pixel of `block` that has the fewest of them.
fn least_stride(block: &Block) -> Option<u32> {
    let of_entries = block.entries.iter().flat_map(|entry| [entry.strides, entry.moved_strides]);
    let of_tiles = of_entries.chain(block.tiles.iter().map(|tile| tile.background_strides));
    let of_tiles = of_tiles.map(packed::stride_of).filter(|stride| *stride > 0);
    block.pixels.iter().map(|pixel| pixel.stride.max(1)).chain(of_tiles).min()
}

/// Where in the words of intermediate values what is.
#[derive(Clone, Copy)]
struct Places {
    light: u64,
    memories: u64,
    own: u64,
    failed: u64,
    end: u64,
}

impl Places {
    fn new(block: &Block) -> Self {
        let words = |bytes: usize| (bytes / size_of::<u32>()) as u64;
        let prepared = block.tiles.len() * PIXELS;
        let light = u64::from(SCRATCH_WORDS) * block.pixel_count() as u64;
        let memories = light + block.light as u64;
        let own = memories + words(prepared * size_of::<Memory>());
        let failed = own + block.own as u64;
        // Behind light that stays there is a row more.
        let end = failed + words(prepared * size_of::<Failed>()) + LIGHT_ROW_BYTES / size_of::<u32>() as u64;
        Self { light, memories, own, failed, end }
    }
}

/// Bytes of so many words.
fn bytes_of(words: Range<u64>) -> Range<u64> {
    let word = size_of::<u32>() as u64;
    words.start * word..words.end * word
}

/// What a device remembers of the pixels of a view: a buffer, made when it is first needed, and its pixels.
struct ViewMemory {
    buffer: OnceLock<wgpu::Buffer>,
    pixels: u64,
}

impl ViewMemory {
    fn get(&self, gpu: &Gpu) -> &wgpu::Buffer {
        self.buffer.get_or_init(|| {
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("what pixels remember"),
                size: self.pixels * size_of::<Memory>() as u64,
                usage: wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        })
    }
}

const _: () = assert!(
    SCRATCH_WORDS as usize * size_of::<u32>() + size_of::<Memory>() + size_of::<Failed>()
        <= 2 * packed::PREPARED_BYTES,
    "what is known of a pixel fits where a block's other arrays do"
);

/// What came of a block.
#[derive(Clone, Copy, Default)]
struct Totals {
    used: u32,
    evaluations: u32,
    quiet: u32,
    failed: u32,
}

/// What is written once per block.
#[derive(Clone, Copy)]
enum Input {
    Entries,
    Words,
    Points,
}

impl Input {
    const ALL: [Self; 3] = [Self::Entries, Self::Words, Self::Points];

    fn label(self) -> &'static str {
        match self {
            Self::Entries => "entries",
            Self::Words => "words",
            Self::Points => "points",
        }
    }
}

/// The pixels of a stream's views.
struct Follower {
    gpu: Gpu,
    passes: Arc<Passes>,
    events_per_pixel: u32,
    batch: GrowingBuffer,
    inputs: [GrowingBuffer; 3],
    /// What stays from block to block.
    kept: GrowingBuffer,
    textures: wgpu::Buffer,
    /// Where what is in them begins.
    places: Batch,
    /// By view.
    memories: Vec<ViewMemory>,
    pixels: GrowingBuffer,
    events: GrowingBuffer,
    scratch: GrowingBuffer,
    /// Rounds, and then a first one that goes on.
    turns: GrowingBuffer,
    /// Workgroups of a round, by class.
    groups: GrowingBuffer,
    /// Of sensors.
    stages: Option<Stages>,
}

impl Follower {
    fn new(of: &Followers, textures: &Textures, views: &[ViewSensor]) -> Result<Self, Error> {
        let gpu = &of.gpu;
        use wgpu::BufferUsages as Usage;
        let new = |label, usage| GrowingBuffer::new(&gpu.device, label, usage);
        let mut turns = new("turns", Usage::UNIFORM);
        let turn =
            |round: u32| Turn { round: round % ROUNDS, first: u32::from(round == 0), ..Turn::default() };
        let all: Vec<Turn> = (0..=ROUNDS).map(turn).collect();
        turns.write(&gpu.device, &gpu.queue, &aligned(&all));
        let mut groups = new("workgroups of a round", Usage::INDIRECT);
        groups.reserve(&gpu.device, GROUPS_BYTES);
        let texels: &[u8] = bytemuck::cast_slice(&textures.rows);
        check(gpu, "textures", texels.len() as u64)?;
        // A binding is never empty.
        let contents = if texels.is_empty() { &[0; size_of::<[f32; 4]>()] } else { texels };
        Ok(Self {
            batch: new("batch", Usage::UNIFORM),
            inputs: Input::ALL.map(|input| new(input.label(), Usage::STORAGE)),
            kept: new("kept", Usage::STORAGE | Usage::COPY_SRC),
            textures: gpu.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some("textures"),
                contents,
                usage: Usage::STORAGE,
            }),
            places: Batch {
                sums: textures.sums,
                texels: textures.texels,
                around: textures.around,
                ..Batch::default()
            },
            memories: views
                .iter()
                .map(|view| ViewMemory { buffer: OnceLock::new(), pixels: pixels_of(view) })
                .collect(),
            pixels: new("pixels", Usage::STORAGE | Usage::COPY_SRC),
            events: new("events", Usage::STORAGE | Usage::COPY_SRC),
            scratch: new("scratch", Usage::STORAGE | Usage::COPY_SRC),
            turns,
            groups,
            stages: None,
            gpu: gpu.clone(),
            passes: Arc::clone(&of.passes),
            events_per_pixel: of.events_per_pixel,
        })
    }

    /// Writes `parts` into an input, one behind the other.
    fn write(&mut self, input: Input, parts: [&[u8]; 2]) -> Result<(), Error> {
        let [first, second] = parts.map(|part| part.len() as u64);
        check(&self.gpu, input.label(), first + second)?;
        let (device, queue) = (&self.gpu.device, &self.gpu.queue);
        let buffer = &mut self.inputs[input as usize];
        buffer.reserve(device, first + second);
        for (at, part) in [0, first].into_iter().zip(parts).filter(|(_, part)| !part.is_empty()) {
            queue.write_buffer(buffer.get(), at, part);
        }
        Ok(())
    }

    /// Sends `block` up, but for its pixels.
    fn send(&mut self, block: &Block) -> Result<(), Error> {
        use bytemuck::cast_slice;
        self.write(Input::Entries, [cast_slice(&block.entries), &[]])?;
        self.write(Input::Words, [cast_slice(&block.words), cast_slice(&block.tiles)])?;
        self.write(Input::Points, [cast_slice(&block.points), cast_slice(&block.jobs)])?;
        let row = size_of::<[f32; 4]>() as u64;
        let from = u64::from(block.kept_from) * row;
        check(&self.gpu, "appearances of facets and the sky", from + block.kept.len() as u64 * row)?;
        let (device, queue) = (&self.gpu.device, &self.gpu.queue);
        if let Some(old) = self.kept.write_after(device, queue, from, bytemuck::cast_slice(&block.kept)) {
            let mut commands = Commands::new(&self.gpu, "what a device keeps");
            commands.copy_buffer_to_buffer(&old, 0, self.kept.get(), 0, from);
            commands.submit(&self.gpu);
        }
        Ok(())
    }

    /// Records copies of what the pixels of the tiles of `block` remember: to where they are followed, or `back`.
    fn copy_memories(&self, commands: &mut Commands, block: &Block, back: bool) {
        let bytes = size_of::<Memory>() as u64;
        let own = |tile: &Tile| u64::from(tile.place) * bytes;
        let mut at = Places::new(block).memories * size_of::<u32>() as u64;
        // Tiles that lie side by side are copied together.
        let follows = |a: &Tile, b: &Tile| a.view == b.view && a.place + PIXELS as u32 == b.place;
        for tiles in block.tiles.chunk_by(follows) {
            let (first, size) = (&tiles[0], (tiles.len() * PIXELS) as u64 * bytes);
            let kept = (self.memories[first.view as usize].get(&self.gpu), own(first));
            let work = (self.scratch.get(), at);
            let (from, to) = if back { (work, kept) } else { (kept, work) };
            commands.copy_buffer_to_buffer(from.0, from.1, to.0, to.1, size);
            at += size;
        }
    }

    /// Follows `block`, which was sent, with room for `capacity` events; what came of it.
    fn run(&mut self, block: &Block, capacity: u32) -> Result<Totals, Error> {
        let count = block.pixel_count() as u32;
        let places = Places::new(block);
        let scratch = bytes_of(0..places.end).end;
        let pixels = u64::from(count) * size_of::<Pixel>() as u64;
        check(&self.gpu, "intermediate values", scratch)?;
        check(&self.gpu, "pixels", pixels)?;
        check(&self.gpu, "events", event_bytes(capacity))?;
        let (device, queue) = (&self.gpu.device, &self.gpu.queue);
        self.scratch.reserve(device, scratch);
        self.events.reserve(device, event_bytes(capacity));
        self.pixels.reserve(device, pixels);
        self.pixels.write(device, queue, bytemuck::cast_slice(&block.pixels));
        let (columns, lines) = sizes::dispatch(count, GROUP);
        let [light, memories, own, failed] =
            [places.light, places.memories, places.own, places.failed].map(|word| word as u32);
        let batch = Batch {
            pixels: count,
            capacity,
            row: columns,
            jobs: block.points.len() as u32,
            light,
            given: block.pixels.len() as u32,
            tiles: block.tiles.len() as u32,
            tile_words: block.words.len() as u32,
            memories,
            own,
            failed,
            ..self.places
        };
        self.batch.write(device, queue, bytemuck::bytes_of(&batch));
        let mut head = vec![0_u32; HEAD_WORDS as usize];
        begin_rounds(&mut head);
        queue.write_buffer(self.events.get(), 0, bytemuck::cast_slice(&head));
        let has = classes_of(block);
        let mut passes = Vec::new();
        for class in (0..CLASSES).filter(|class| has[*class]) {
            let pass = pass_of(&self.gpu, &self.passes, class).map_err(refused)?;
            passes.push((class, pass, self.bind(pass)));
        }
        let most = least_stride(block).map_or(0, |stride| UNITS / stride);
        // An even number, see `ROUNDS`.
        let rounds = ((most + MORE_ROUNDS) / 2 * 2).min(ROUNDS);
        let mut commands = Commands::new(&self.gpu, "follow pixels");
        self.copy_memories(&mut commands, block, false);
        for pass in [&self.passes.prepare, &self.passes.list] {
            // A workgroup for each tile, and for as many pixels that were given.
            pass.encode(&mut commands, &self.bind(pass), &[0], (columns, lines, 1));
        }
        let mut first = 0;
        loop {
            for round in 0..rounds {
                let turn = if round == 0 { first } else { round };
                let offset = turn * UNIFORM_ALIGNMENT as u32;
                let counted = (groups_at(round) * size_of::<u32>()) as u64;
                let (events, groups) = (self.events.get(), self.groups.get());
                commands.copy_buffer_to_buffer(events, counted, groups, 0, GROUPS_BYTES);
                for (class, pass, group) in &passes {
                    let counts = (groups, GROUPS_BYTES / CLASSES as u64 * *class as u64);
                    pass.encode_indirect(&mut commands, group, &[offset], counts);
                }
            }
            let head = read(&self.gpu, commands, &[(self.events.get(), bytes_of(0..u64::from(HEAD_WORDS)))]);
            let mut head = bytemuck::pod_collect_to_vec::<u8, u32>(&head.map_err(refused)?);
            let going_on: [u32; CLASSES] = std::array::from_fn(|class| head[count_at(class, rounds)]);
            if going_on == [0; CLASSES] {
                return Ok(Totals { used: head[0], evaluations: head[1], quiet: head[2], failed: head[3] });
            }
            // The first round of what follows is the one after these.
            begin_rounds(&mut head);
            for (class, going_on) in going_on.into_iter().enumerate() {
                head[count_at(class, 0)] = going_on;
                head[groups_at(0) + class * AXES as usize] = going_on.div_ceil(GROUP);
            }
            self.gpu.queue.write_buffer(self.events.get(), 0, bytemuck::cast_slice(&head));
            (commands, first) = (Commands::new(&self.gpu, "follow pixels"), ROUNDS);
        }
    }

    /// What `pass` reads and writes.
    fn bind(&self, pass: &ComputePass) -> wgpu::BindGroup {
        let before =
            [&self.batch].into_iter().chain(&self.inputs).chain([&self.kept]).map(GrowingBuffer::get);
        let after = [&self.pixels, &self.events, &self.scratch].map(GrowingBuffer::get);
        let buffers = before.chain([&self.textures]).chain(after);
        let mut resources: Vec<_> = buffers.map(wgpu::Buffer::as_entire_binding).collect();
        resources.push(wgpu::BindingResource::Buffer(wgpu::BufferBinding {
            buffer: self.turns.get(),
            offset: 0,
            size: wgpu::BufferSize::new(size_of::<Turn>() as u64),
        }));
        group(&self.gpu.device, pass.file, &pass.layout, PIXELS_BINDINGS, resources)
    }
}

/// Where it is counted how many pixels of a class go on in a round.
fn count_at(class: usize, round: u32) -> usize {
    TOTAL_WORDS as usize + class * (ROUNDS as usize + 1) + round as usize
}

/// Where the workgroups of a round are counted, class by class.
fn groups_at(round: u32) -> usize {
    count_at(CLASSES, 0) + (round as usize * CLASSES) * AXES as usize
}

/// Clears what is counted for rounds.
fn begin_rounds(head: &mut [u32]) {
    head[count_at(0, 0)..groups_at(0)].fill(0);
    for groups in head[groups_at(0)..groups_at(ROUNDS + 1)].chunks_exact_mut(AXES as usize) {
        groups.copy_from_slice(&[0, 1, 1]);
    }
}

/// Pixels of all tiles of a view.
fn pixels_of(view: &ViewSensor) -> u64 {
    let tiles: u64 =
        view.size.map(|side| u64::from(side).div_ceil(packed::TILE as u64)).into_iter().product();
    tiles * PIXELS as u64
}

/// Bytes of `count` events, and of what lies before them.
fn event_bytes(count: u32) -> u64 {
    u64::from(HEAD_WORDS) * 4 + u64::from(count) * size_of::<Event>() as u64
}

/// Half of the bytes that a binding can hold.
fn half_a_binding(gpu: &Gpu) -> u64 {
    gpu.device.limits().max_storage_buffer_binding_size / 2
}

/// Whether a binding can hold a buffer that grows to so many bytes: it does so to powers of two, and is bound as a whole.
fn fits(gpu: &Gpu, bytes: u64) -> bool {
    bytes.next_power_of_two() <= gpu.device.limits().max_storage_buffer_binding_size
}

/// Refuses what no binding can hold.
fn check(gpu: &Gpu, what: &str, bytes: u64) -> Result<(), Error> {
    if fits(gpu, bytes) {
        return Ok(());
    }
    let most = gpu.device.limits().max_storage_buffer_binding_size;
    Err(Error::Device(format!(
        "the {what} take {} MB, and a binding of {} holds {}; choose a smaller picture or smaller textures, or let the \
         processor follow pixels",
        bytes >> 20,
        gpu.summary().name,
        most >> 20
    )))
}

fn refused(error: EngineError) -> Error {
    Error::Device(error.to_string())
}

impl Device for Follower {
    fn room(&self) -> usize {
        MOST_BYTES.min(half_a_binding(&self.gpu)) as usize
    }

    fn follow(&mut self, block: &mut Block) -> Result<Found, Error> {
        let _span = tracing::trace_span!("follow pixels", pixels = block.pixel_count()).entered();
        self.send(block)?;
        let mut capacity = (self.events_per_pixel * block.pixel_count() as u32).max(1);
        let mut totals = self.run(block, capacity)?;
        // Pixels stop where an event does not fit: there may be more of them than were counted. Those for which no binding has room
        // are the processor's.
        while totals.used > capacity && fits(&self.gpu, event_bytes(totals.used.saturating_mul(2))) {
            capacity = totals.used.saturating_mul(2);
            totals = self.run(block, capacity)?;
        }
        let used = totals.used.min(capacity);
        let places = Places::new(block);
        let mut commands = Commands::new(&self.gpu, "read followed pixels");
        self.copy_memories(&mut commands, block, true);
        let mut light = bytes_of(places.light..places.light + block.light as u64);
        let mut light_at = 0;
        if let Some(stages) = self.stages.as_mut().filter(|_| block.light_stays) {
            let from = (self.scratch.get(), light.start);
            light_at = stages.keep(&mut commands, from, block.light as u32)?;
            light.end = light.start;
        }
        let failed = bytes_of(places.failed..places.end).start;
        let parts = [
            (self.pixels.get(), 0..size_of_val(&block.pixels[..]) as u64),
            (self.scratch.get(), light),
            (self.scratch.get(), failed..failed + u64::from(totals.failed) * size_of::<Failed>() as u64),
            (self.events.get(), event_bytes(0)..event_bytes(used)),
        ];
        let bytes = read(&self.gpu, commands, &parts).map_err(refused)?;
        let mut bytes = &bytes[..];
        let mut next = parts
            .into_iter()
            .map(|(_, range)| bytes.split_off(..(range.end - range.start) as usize).unwrap_or_default());
        let mut part = || next.next().unwrap_or_default();
        block.pixels = bytemuck::pod_collect_to_vec::<u8, Pixel>(part());
        Ok(Found {
            light: bytemuck::pod_collect_to_vec(part()),
            failed: bytemuck::pod_collect_to_vec(part()),
            events: bytemuck::pod_collect_to_vec(part()),
            light_at,
            evaluations: totals.evaluations.into(),
            quiet: totals.quiet.into(),
        })
    }

    fn stages(&mut self) -> Option<&mut dyn evis_decoupled::Stages> {
        self.stages.as_mut().map(|stages| stages as _)
    }
}
