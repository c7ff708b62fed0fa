//! Pixels of decoupled sampling, followed on a device: blocks go up, events come down.

use std::fmt;
use std::ops::Range;
use std::sync::{Arc, Mutex, OnceLock};

use evis_decoupled::packed::{self, Block, Event, Found, Pixel, Textures};
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
use crate::pass::decoupled::{CLASSES, GROUP, HEAD_WORDS, PIXELS_BINDINGS, ROUNDS, SCRATCH_WORDS};
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
/// Rounds beyond those in which pixels are evaluated where they surely are.
const MORE_ROUNDS: u32 = 8;

/// By class, made when there are first pixels of it.
type Passes = [OnceLock<ComputePass>; CLASSES];

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
        let passes = Arc::new(Passes::default());
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
        let mut follower = Follower::new(self, textures)?;
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
    if let Some(pass) = passes[class].get() {
        return Ok(pass);
    }
    let pass = gpu.guarded(|| Ok(decoupled::pixels(&gpu.device, class)))?;
    Ok(passes[class].get_or_init(|| pass))
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
    pixels: GrowingBuffer,
    events: GrowingBuffer,
    scratch: GrowingBuffer,
    /// Rounds, and then a first one that goes on.
    turns: GrowingBuffer,
    /// Of sensors.
    stages: Option<Stages>,
}

impl Follower {
    fn new(of: &Followers, textures: &Textures) -> Result<Self, Error> {
        let gpu = &of.gpu;
        use wgpu::BufferUsages as Usage;
        let new = |label, usage| GrowingBuffer::new(&gpu.device, label, usage);
        let mut turns = new("turns", Usage::UNIFORM);
        let turn =
            |round: u32| Turn { round: round % ROUNDS, first: u32::from(round == 0), ..Turn::default() };
        let all: Vec<Turn> = (0..=ROUNDS).map(turn).collect();
        turns.write(&gpu.device, &gpu.queue, &aligned(&all));
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
            pixels: new("pixels", Usage::STORAGE | Usage::COPY_SRC),
            events: new("events", Usage::STORAGE | Usage::COPY_SRC),
            scratch: new("scratch", Usage::STORAGE | Usage::COPY_SRC),
            turns,
            stages: None,
            gpu: gpu.clone(),
            passes: Arc::clone(&of.passes),
            events_per_pixel: of.events_per_pixel,
        })
    }

    fn write(&mut self, input: Input, bytes: &[u8]) -> Result<(), Error> {
        check(&self.gpu, input.label(), bytes.len() as u64)?;
        self.inputs[input as usize].write(&self.gpu.device, &self.gpu.queue, bytes);
        Ok(())
    }

    /// Sends `block` up, but for its pixels.
    fn send(&mut self, block: &Block) -> Result<(), Error> {
        let (points, jobs): (&[u8], &[u8]) =
            (bytemuck::cast_slice(&block.points), bytemuck::cast_slice(&block.jobs));
        let both = (points.len() + jobs.len()) as u64;
        check(&self.gpu, Input::Points.label(), both)?;
        self.inputs[Input::Points as usize].reserve(&self.gpu.device, both);
        self.write(Input::Points, points)?;
        // Jobs lie after the points.
        let buffer = self.inputs[Input::Points as usize].get();
        self.gpu.queue.write_buffer(buffer, points.len() as u64, jobs);
        self.write(Input::Entries, bytemuck::cast_slice(&block.entries))?;
        self.write(Input::Words, bytemuck::cast_slice(&block.words))?;
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

    /// Follows `block`, which was sent, with room for `capacity` events; how many there are.
    fn run(&mut self, block: &Block, capacity: u32) -> Result<u32, Error> {
        let count = block.pixels.len() as u32;
        let light = SCRATCH_WORDS * count;
        let sizes = [light_bytes(block).end + LIGHT_ROW_BYTES, event_bytes(capacity)];
        check(&self.gpu, "intermediate values", sizes[0])?;
        check(&self.gpu, "events", sizes[1])?;
        let (device, queue) = (&self.gpu.device, &self.gpu.queue);
        self.scratch.reserve(device, sizes[0]);
        self.events.reserve(device, sizes[1]);
        self.pixels.write(device, queue, bytemuck::cast_slice(&block.pixels));
        let (columns, _) = sizes::dispatch(count, GROUP);
        let jobs = block.points.len() as u32;
        // Class by class.
        let mut numbers: [Vec<u32>; CLASSES] = Default::default();
        for (number, pixel) in (0..).zip(&block.pixels) {
            numbers[class_of(pixel)].push(number);
        }
        // Pixels that take as long lie side by side: those beside each other wait for the slowest.
        for own in &mut numbers {
            own.sort_by_key(|number| block.pixels[*number as usize].own_count);
        }
        let mut going_on = numbers.each_ref().map(|own| own.len() as u32);
        let lists = std::array::from_fn(|class| going_on.iter().take(class).sum());
        let batch = Batch { pixels: count, capacity, row: columns, jobs, light, lists, ..self.places };
        self.batch.write(device, queue, bytemuck::bytes_of(&batch));
        self.scratch.write(device, queue, bytemuck::cast_slice(&numbers.concat()));
        let mut passes = Vec::new();
        for class in (0..CLASSES).filter(|class| going_on[*class] > 0) {
            let pass = pass_of(&self.gpu, &self.passes, class).map_err(refused)?;
            passes.push((class, pass, self.bind(pass)));
        }
        let most = block.pixels.iter().map(|pixel| UNITS / pixel.stride.max(1)).max().unwrap_or(0);
        // An even number, see `ROUNDS`.
        let rounds = ((most + MORE_ROUNDS) / 2 * 2).min(ROUNDS);
        let (mut used, mut first) = (0, 0);
        while going_on != [0; CLASSES] {
            let mut head = vec![0; HEAD_WORDS as usize];
            head[0] = used;
            for (class, going_on) in going_on.into_iter().enumerate() {
                head[count_at(class, 0)] = going_on;
            }
            self.gpu.queue.write_buffer(self.events.get(), 0, bytemuck::cast_slice(&head));
            let mut commands = Commands::new(&self.gpu, "follow pixels");
            for round in 0..rounds {
                let turn = if round == 0 { first } else { round };
                let offset = turn * UNIFORM_ALIGNMENT as u32;
                for (class, pass, group) in passes.iter().filter(|(class, ..)| going_on[*class] > 0) {
                    let (own, rows) = sizes::dispatch(going_on[*class], GROUP);
                    // Rows are as long as `Batch::row` says, if there are several.
                    let own = if rows == 1 { own } else { columns };
                    pass.encode(&mut commands, group, &[offset], (own, rows, 1));
                }
            }
            let head = [(self.events.get(), 0..u64::from(HEAD_WORDS) * 4)];
            let head = read(&self.gpu, commands, &head).map_err(refused)?;
            let word = |at: usize| bytemuck::pod_read_unaligned::<u32>(&head[4 * at..][..4]);
            (used, first) = (word(0), ROUNDS);
            going_on = std::array::from_fn(|class| word(count_at(class, rounds)));
        }
        Ok(used)
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
    1 + class * (ROUNDS as usize + 1) + round as usize
}

/// Where light that is wanted of `block` lies among intermediate values: behind what is known of pixels between rounds.
fn light_bytes(block: &Block) -> Range<u64> {
    let from = u64::from(SCRATCH_WORDS) * 4 * block.pixels.len() as u64;
    from..from + 4 * block.light as u64
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
        let _span = tracing::trace_span!("follow pixels", pixels = block.pixels.len()).entered();
        self.send(block)?;
        let mut capacity = (self.events_per_pixel * block.pixels.len() as u32).max(1);
        let mut used = self.run(block, capacity)?;
        // Pixels stop where an event does not fit: there may be more of them than were counted. Those for which no binding has room
        // are the processor's.
        while used > capacity && fits(&self.gpu, event_bytes(used.saturating_mul(2))) {
            capacity = used.saturating_mul(2);
            used = self.run(block, capacity)?;
        }
        let used = used.min(capacity);
        let pixels = size_of_val(&block.pixels[..]);
        let mut commands = Commands::new(&self.gpu, "read followed pixels");
        let mut light = light_bytes(block);
        let mut light_at = 0;
        if let Some(stages) = self.stages.as_mut().filter(|_| block.light_stays) {
            let from = (self.scratch.get(), light.start);
            light_at = stages.keep(&mut commands, from, block.light as u32)?;
            light.end = light.start;
        }
        let light_size = (light.end - light.start) as usize;
        let parts = [
            (self.pixels.get(), 0..pixels as u64),
            (self.scratch.get(), light),
            (self.events.get(), 0..event_bytes(used)),
        ];
        let bytes = read(&self.gpu, commands, &parts).map_err(refused)?;
        let (pixels, bytes) = bytes.split_at(pixels);
        let (light, events) = bytes.split_at(light_size);
        block.pixels = bytemuck::pod_collect_to_vec::<u8, Pixel>(pixels);
        let light = bytemuck::pod_collect_to_vec::<u8, f32>(light);
        let events = bytemuck::pod_collect_to_vec(&events[event_bytes(0) as usize..]);
        Ok(Found { events, light, light_at })
    }

    fn stages(&mut self) -> Option<&mut dyn evis_decoupled::Stages> {
        self.stages.as_mut().map(|stages| stages as _)
    }
}
