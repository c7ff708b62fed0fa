//! Pixels of decoupled sampling, followed on a device: blocks go up, events come down.

use std::fmt;
use std::hash::{BuildHasher, BuildHasherDefault, DefaultHasher};
use std::sync::{Arc, Mutex, PoisonError, Weak};

use evis_decoupled::packed::{Block, Event, PLAIN, Pixel, Scene};
use evis_decoupled::signal::pixel::UNITS;
use evis_decoupled::{Device, Devices, Error};
use wgpu::util::DeviceExt;

use crate::error::EngineError;
use crate::gpu::Gpu;
use crate::gpu::buffer::{GrowingBuffer, aligned};
use crate::gpu::commands::Commands;
use crate::gpu::readback::{map, wait_mapped};
use crate::gpu::sizes::{self, UNIFORM_ALIGNMENT};
use crate::gpu::uniforms::Turn;
use crate::pass::decoupled::{GROUP, HEAD_WORDS, PIXELS_BINDINGS, ROUNDS, SCRATCH_WORDS};
use crate::pass::{ComputePass, decoupled, group};

/// Events that fit for each pixel, of all pixels together; a block with more leaves some of its pixels to the processor.
const EVENTS_PER_PIXEL: u32 = 16;
/// Events that fit at least.
const LEAST_EVENTS: u32 = 4096;
/// Bytes that an array of a block takes at most, if rows of tiles can be followed one after the other: half of what WebGPU's
/// default limits let be bound.
const MOST_BYTES: u64 = 64 << 20;
/// Rounds beyond those in which pixels are evaluated where they surely are.
const MORE_ROUNDS: u32 = 8;

/// Of all other pixels, and of plain ones.
type Passes = [ComputePass; 2];

/// Appearances and textures on the device, by a hash of what they are.
type Shared = Mutex<Vec<(u64, Weak<wgpu::Buffer>)>>;

/// Devices on one adapter, which share its pipelines, and appearances and textures that are the same.
pub struct Followers {
    gpu: Gpu,
    passes: Arc<Passes>,
    shared: Arc<Shared>,
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
        let passes = || [false, true].map(|plain| decoupled::pixels(&gpu.device, plain));
        let passes = Arc::new(gpu.guarded(|| Ok(passes()))?);
        Ok(Self { gpu: gpu.clone(), passes, shared: Arc::default() })
    }
}

impl Devices for Followers {
    fn open(&self) -> Result<Box<dyn Device>, Error> {
        Ok(Box::new(Follower::new(self)))
    }
}

/// What is written once per block.
#[derive(Clone, Copy)]
enum Input {
    Entries,
    Words,
    Points,
    Nodes,
}

impl Input {
    const ALL: [Self; 4] = [Self::Entries, Self::Words, Self::Points, Self::Nodes];

    fn label(self) -> &'static str {
        match self {
            Self::Entries => "entries",
            Self::Words => "words",
            Self::Points => "points",
            Self::Nodes => "nodes",
        }
    }
}

/// The pixels of one view.
struct Follower {
    gpu: Gpu,
    passes: Arc<Passes>,
    job: GrowingBuffer,
    inputs: [GrowingBuffer; 4],
    shared: Arc<Shared>,
    /// What stays from block to block.
    fixed: Option<Arc<wgpu::Buffer>>,
    pixels: GrowingBuffer,
    events: GrowingBuffer,
    scratch: GrowingBuffer,
    /// Rounds, and then a first one that goes on.
    turns: GrowingBuffer,
}

impl Follower {
    fn new(of: &Followers) -> Self {
        let gpu = &of.gpu;
        use wgpu::BufferUsages as Usage;
        let new = |label, usage| GrowingBuffer::new(&gpu.device, label, usage);
        let mut turns = new("turns", Usage::UNIFORM);
        let turn =
            |round: u32| Turn { round: round % ROUNDS, first: u32::from(round == 0), ..Turn::default() };
        let all: Vec<Turn> = (0..=ROUNDS).map(turn).collect();
        turns.write(&gpu.device, &gpu.queue, &aligned(&all));
        Self {
            job: new("job", Usage::UNIFORM),
            inputs: Input::ALL.map(|input| new(input.label(), Usage::STORAGE)),
            pixels: new("pixels", Usage::STORAGE | Usage::COPY_SRC),
            events: new("events", Usage::STORAGE | Usage::COPY_SRC),
            scratch: new("scratch", Usage::STORAGE),
            turns,
            gpu: gpu.clone(),
            passes: Arc::clone(&of.passes),
            shared: Arc::clone(&of.shared),
            fixed: None,
        }
    }

    /// Refuses what no binding can hold.
    fn check(&self, what: &str, bytes: u64) -> Result<(), Error> {
        let most = self.gpu.device.limits().max_storage_buffer_binding_size;
        // Buffers that grow do so to powers of two, and are bound as a whole.
        if bytes.next_power_of_two() <= most {
            return Ok(());
        }
        Err(Error::Device(format!(
            "the {what} take {} MB, and a binding of {} holds {}; choose a smaller picture or smaller textures, \
             or let the processor follow pixels",
            bytes >> 20,
            self.gpu.summary().name,
            most >> 20
        )))
    }

    fn write(&mut self, input: Input, bytes: &[u8]) -> Result<(), Error> {
        self.check(input.label(), bytes.len() as u64)?;
        self.inputs[input as usize].write(&self.gpu.device, &self.gpu.queue, bytes);
        Ok(())
    }

    /// The first `bytes` of buffers, one after the other.
    fn read(&self, parts: &[(&GrowingBuffer, u64)]) -> Result<Vec<u8>, Error> {
        let staging = self.gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("followed pixels"),
            size: parts.iter().map(|(_, bytes)| bytes).sum(),
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut commands = Commands::new(&self.gpu, "read followed pixels");
        let mut at = 0;
        for (buffer, bytes) in parts {
            commands.copy_buffer_to_buffer(buffer.get(), 0, &staging, at, *bytes);
            at += bytes;
        }
        let submission = commands.submit(&self.gpu);
        wait_mapped(&self.gpu, &submission, &map(&staging)).map_err(refused)?;
        let mapped = staging.get_mapped_range(..);
        let bytes = mapped.map_err(|error| Error::Device(format!("cannot read what came back: {error}")))?;
        Ok(bytes.to_vec())
    }

    /// Sends `block` up, and says how many events fit.
    fn send(&mut self, block: &mut Block) -> Result<u32, Error> {
        self.write(Input::Entries, bytemuck::cast_slice(&block.entries))?;
        self.write(Input::Words, bytemuck::cast_slice(&block.words))?;
        self.write(Input::Points, bytemuck::cast_slice(&block.points))?;
        self.write(Input::Nodes, bytemuck::cast_slice(&block.nodes))?;
        let count = block.pixels.len() as u32;
        let capacity = (EVENTS_PER_PIXEL * count).max(LEAST_EVENTS);
        let sizes = [
            u64::from(SCRATCH_WORDS * count) * 4,
            u64::from(HEAD_WORDS) * 4 + u64::from(capacity) * size_of::<Event>() as u64,
        ];
        self.check("intermediate values", sizes[0])?;
        self.check("events", sizes[1])?;
        let (device, queue) = (&self.gpu.device, &self.gpu.queue);
        self.scratch.reserve(device, sizes[0]);
        self.events.reserve(device, sizes[1]);
        (block.job.capacity, block.job.row) = (capacity, sizes::dispatch(count, GROUP).0);
        self.job.write(device, queue, bytemuck::bytes_of(&block.job));
        self.pixels.write(device, queue, bytemuck::cast_slice(&block.pixels));
        Ok(capacity)
    }

    /// Runs rounds of those pixels that are `plain`, or are not, until none goes on, from event number `used` on; how many events
    /// there are then.
    fn run(&mut self, block: &Block, plain: bool, mut used: u32) -> Result<u32, Error> {
        let is_own = |pixel: &Pixel| (pixel.flags & PLAIN != 0) == plain;
        let own = (0..).zip(&block.pixels).filter(|(_, pixel)| is_own(pixel));
        let numbers: Vec<u32> = own.clone().map(|(number, _)| number).collect();
        let most = own.map(|(_, pixel)| UNITS / pixel.stride.max(1)).max().unwrap_or(0);
        let device = &self.gpu.device;
        self.scratch.write(device, &self.gpu.queue, bytemuck::cast_slice(&numbers));
        let pass = &self.passes[usize::from(plain)];
        let nothing = || Error::Device("nothing was loaded to it".into());
        let fixed = self.fixed.as_deref().ok_or_else(nothing)?;
        let before = [&self.job].into_iter().chain(&self.inputs).map(GrowingBuffer::get);
        let after = [&self.pixels, &self.events, &self.scratch].map(GrowingBuffer::get);
        let buffers = before.chain([fixed]).chain(after);
        let mut resources: Vec<_> = buffers.map(wgpu::Buffer::as_entire_binding).collect();
        resources.push(wgpu::BindingResource::Buffer(wgpu::BufferBinding {
            buffer: self.turns.get(),
            offset: 0,
            size: wgpu::BufferSize::new(size_of::<Turn>() as u64),
        }));
        let group = group(device, pass.file, &pass.layout, PIXELS_BINDINGS, resources);
        // An even number, see `ROUNDS`.
        let rounds = ((most + MORE_ROUNDS) / 2 * 2).min(ROUNDS);
        let (mut going_on, mut first) = (numbers.len() as u32, 0);
        while going_on > 0 {
            let mut head = vec![0; HEAD_WORDS as usize];
            (head[0], head[1]) = (used, going_on);
            self.gpu.queue.write_buffer(self.events.get(), 0, bytemuck::cast_slice(&head));
            let (columns, rows) = sizes::dispatch(going_on, GROUP);
            // Rows are as long as `Job::row` says, if there are several.
            let columns = if rows == 1 { columns } else { block.job.row };
            let mut commands = Commands::new(&self.gpu, "follow pixels");
            for round in 0..rounds {
                let turn = if round == 0 { first } else { round };
                let offset = turn * UNIFORM_ALIGNMENT as u32;
                pass.encode(&mut commands, &group, &[offset], (columns, rows, 1));
            }
            commands.submit(&self.gpu);
            let head = self.read(&[(&self.events, u64::from(HEAD_WORDS) * 4)])?;
            let word = |k: u32| bytemuck::pod_read_unaligned::<u32>(&head[4 * k as usize..][..4]);
            (used, going_on, first) = (word(0), word(1 + rounds), ROUNDS);
        }
        Ok(used)
    }
}

fn refused(error: EngineError) -> Error {
    Error::Device(error.to_string())
}

impl Device for Follower {
    fn load(&mut self, scene: &Scene) -> Result<(), Error> {
        let bytes: &[u8] = bytemuck::cast_slice(&scene.rows);
        self.check("textures", bytes.len() as u64)?;
        let hash = BuildHasherDefault::<DefaultHasher>::default().hash_one(bytes);
        let mut shared = self.shared.lock().unwrap_or_else(PoisonError::into_inner);
        shared.retain(|(_, buffer)| buffer.strong_count() > 0);
        let known = shared.iter().find(|(known, _)| *known == hash).and_then(|(_, buffer)| buffer.upgrade());
        let buffer = known.unwrap_or_else(|| {
            let buffer = Arc::new(self.gpu.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some("textures"),
                contents: bytes,
                usage: wgpu::BufferUsages::STORAGE,
            }));
            shared.push((hash, Arc::downgrade(&buffer)));
            buffer
        });
        self.fixed = Some(buffer);
        Ok(())
    }

    fn room(&self) -> usize {
        MOST_BYTES.min(self.gpu.device.limits().max_storage_buffer_binding_size / 2) as usize
    }

    fn follow(&mut self, block: &mut Block) -> Result<Vec<Event>, Error> {
        let _span = tracing::trace_span!("follow pixels", pixels = block.pixels.len()).entered();
        let capacity = self.send(block)?;
        let used = self.run(block, true, 0)?;
        let used = self.run(block, false, used)?.min(capacity);
        let head = u64::from(HEAD_WORDS) * 4;
        let pixels = size_of_val(&block.pixels[..]) as u64;
        let bytes = self.read(&[
            (&self.pixels, pixels),
            (&self.events, head + u64::from(used) * size_of::<Event>() as u64),
        ])?;
        let (pixels, events) = bytes.split_at(pixels as usize);
        block.pixels = bytemuck::pod_collect_to_vec::<u8, Pixel>(pixels);
        Ok(bytemuck::pod_collect_to_vec(&events[head as usize..]))
    }
}
