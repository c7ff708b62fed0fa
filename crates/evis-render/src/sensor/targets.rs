//! Targets and per-pixel buffers of the views of one size; groups of views share them in turn.

use crate::gpu::sizes::{BLOCK_PIXELS, Plan, padded_pixels};
use crate::gpu::texture::{array, whole};
use crate::pass::raster::LUMINANCE_FORMAT;
use crate::raster::layers::{LayerUse, Layers};
use crate::sensor::chain::ChainPlan;
use crate::world::tiles::tiles_along;

/// What every group of views of one size fills and reads.
pub struct Targets {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// How views share submissions.
    pub plan: Plan,
    /// Luminance of the instants.
    pub layers: Layers,
    /// Events per pixel of the submission in work.
    pub counts: wgpu::Buffer,
    /// Means of samples, a layer per view and instant; one texel where there is one sample, and for a chain.
    pub means: wgpu::TextureView,
    /// Samples per view and instant.
    pub samples: u32,
    /// Exclusive prefix within blocks.
    pub prefixes: wgpu::Buffer,
    /// Sums, then offsets, of blocks.
    pub block_sums: wgpu::Buffer,
    /// What a chain walks with, where there is one.
    pub chain: Option<ChainTargets>,
    /// Rates of tiles, a layer per view and block; one texel where every pixel is always sampled.
    pub tile_rates: wgpu::Texture,
    /// The same, for the trigger.
    pub tile_rates_view: wgpu::TextureView,
}

/// What a chain has beside the trigger's buffers, while a submission is in work.
pub struct ChainTargets {
    /// The first events of each pixel.
    pub kept: wgpu::Buffer,
    /// Pixels that are walked once more, then those that wake, list by list.
    pub lists: wgpu::Buffer,
    /// Lists of pixels that wake, per view.
    pub list_count: u32,
}

impl Targets {
    /// Allocates for `plan`, with blocks of `block` instants.
    pub fn new(
        device: &wgpu::Device,
        width: u32,
        height: u32,
        plan: Plan,
        made: LayerUse,
        chain: Option<&ChainPlan>,
        block: u32,
    ) -> Self {
        let pixels = u64::from(plan.views_per_group) * u64::from(padded_pixels(width, height));
        let storage = |label, entries: u64| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: entries * 4,
                usage: wgpu::BufferUsages::STORAGE,
                mapped_at_creation: false,
            })
        };
        let (columns, rows, blocks) = match block {
            1 => (1, 1, 1),
            _ => (
                tiles_along(width),
                tiles_along(height),
                plan.views_per_group * (plan.instants / block).max(1),
            ),
        };
        let tile_rates = array(
            device,
            "tile_rates",
            [columns, rows, blocks],
            wgpu::TextureFormat::R8Uint,
            wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        );
        let samples = plan.layers / (plan.views_per_group * plan.instants);
        let means =
            if chain.is_some() || samples == 1 { [1; 3] } else { [width, height, plan.layers / samples] };
        let means = array(device, "means", means, LUMINANCE_FORMAT, wgpu::TextureUsages::STORAGE_BINDING);
        let chain = chain.map(|of| {
            let list = 4 * u64::from(plan.views_per_group) * u64::from(width) * u64::from(height);
            let most = device.limits().max_storage_buffer_binding_size.min(device.limits().max_buffer_size);
            // One is of crowded pixels; two let a pixel look at its next instant.
            let fit = (most / list).saturating_sub(1).max(2);
            let wanted = if of.sequential { u64::from(plan.instants) } else { 0 };
            let lists = wanted.min(fit) as u32;
            ChainTargets {
                kept: storage("kept events", 2 * u64::from(of.kept.max(1)) * pixels),
                lists: storage("lists of pixels", (1 + u64::from(lists)) * list / 4),
                list_count: lists,
            }
        });
        Self {
            width,
            height,
            plan,
            chain,
            tile_rates_view: whole(&tile_rates),
            tile_rates,
            samples,
            means: whole(&means),
            layers: Layers::new(device, width, height, plan.layers, made),
            counts: storage("counts", pixels),
            prefixes: storage("prefixes", pixels),
            block_sums: storage("block sums", pixels / u64::from(BLOCK_PIXELS)),
        }
    }
}

impl Targets {
    /// A layer per view and instant: the only sample, or what counting wrote.
    pub fn mean_layers(&self) -> &wgpu::TextureView {
        if self.samples > 1 { &self.means } else { &self.layers.array }
    }
}
