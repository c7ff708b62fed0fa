//! Targets and per-pixel buffers of the views of one size; groups of views share them in turn.

use crate::chain::ChainPlan;
use crate::pace::tiles_along;
use crate::pass::raster::{DEPTH_FORMAT, LUMINANCE_FORMAT};
use crate::sizes::{BLOCK_PIXELS, Plan, padded_pixels};

/// Luminance layers, and what is needed to render into them.
pub struct Layers {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// All layers, for the trigger.
    pub array: wgpu::TextureView,
    /// The texture behind it.
    pub texture: wgpu::Texture,
    /// One view per layer, to render into.
    pub each: Vec<wgpu::TextureView>,
    /// Shared by all layers, which are rendered one after another: it stays in the cache.
    pub depth: wgpu::TextureView,
    /// Four coverage samples, for `--aa edges`: of a picture that is `grid` times as large along each side.
    pub multisampled: Option<wgpu::TextureView>,
    /// What `multisampled` and `depth` are larger by.
    pub grid: u32,
}

/// How layers come to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LayerUse {
    /// Rendered, a sample each.
    Rendered,
    /// Rendered at so many places along each side of a pixel with four coverage samples each, all of which a compute pass
    /// averages.
    Resolved(u32),
    /// Written by a compute pass.
    Computed,
}

impl LayerUse {
    /// What a pixel takes in one pass, in pixels that are shaded once.
    pub const fn pixel_price(self) -> f64 {
        match self {
            Self::Resolved(grid) => (grid * grid) as f64,
            Self::Rendered | Self::Computed => 1.0,
        }
    }
}

impl Layers {
    /// Allocates `count` layers.
    pub fn new(device: &wgpu::Device, width: u32, height: u32, count: u32, made: LayerUse) -> Self {
        let (edges, grid) = match made {
            LayerUse::Resolved(grid) => (true, grid),
            _ => (false, 1),
        };
        let sample_count = if edges { 4 } else { 1 };
        let texture = |label, format, layers, sample_count, usage: wgpu::TextureUsages| {
            let grid = if usage.contains(wgpu::TextureUsages::COPY_SRC) { 1 } else { grid };
            let (width, height) = (grid * width, grid * height);
            device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d { width, height, depth_or_array_layers: layers },
                mip_level_count: 1,
                sample_count,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage,
                view_formats: &[],
            })
        };
        let attachment = wgpu::TextureUsages::RENDER_ATTACHMENT;
        let sampled = wgpu::TextureUsages::TEXTURE_BINDING;
        let copied = wgpu::TextureUsages::COPY_SRC | wgpu::TextureUsages::COPY_DST;
        let usage = attachment | sampled | copied | wgpu::TextureUsages::STORAGE_BINDING;
        let all = texture("luminance", LUMINANCE_FORMAT, count, 1, usage);
        let (array, each) = (whole(&all), each(&all));
        let depth =
            texture("depth", DEPTH_FORMAT, 1, sample_count, attachment).create_view(&Default::default());
        let multisampled = edges.then(|| {
            texture("coverage samples", LUMINANCE_FORMAT, 1, 4, attachment | sampled)
                .create_view(&Default::default())
        });
        Self { width, height, array, texture: all, each, depth, multisampled, grid }
    }
}

impl Layers {
    /// `count` layers of the same size and format, to copy into and out of.
    pub fn like(&self, device: &wgpu::Device, count: u32) -> wgpu::Texture {
        let usage = wgpu::TextureUsages::COPY_SRC | wgpu::TextureUsages::COPY_DST;
        array(device, "kept luminance", [self.width, self.height, count], LUMINANCE_FORMAT, usage)
    }
}

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
    /// Paces of tiles, a layer per view and block; one texel where every pixel is always sampled.
    pub paces: wgpu::Texture,
    /// The same, for the trigger.
    pub paces_view: wgpu::TextureView,
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
        let paces = array(
            device,
            "paces",
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
            paces_view: whole(&paces),
            paces,
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

/// A texture array of `[width, height, layers]`.
pub fn array(
    device: &wgpu::Device,
    label: &str,
    [width, height, layers]: [u32; 3],
    format: wgpu::TextureFormat,
    usage: wgpu::TextureUsages,
) -> wgpu::Texture {
    device.create_texture(&wgpu::TextureDescriptor {
        label: Some(label),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: layers },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage,
        view_formats: &[],
    })
}

/// All layers of `texture`.
pub fn whole(texture: &wgpu::Texture) -> wgpu::TextureView {
    texture.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        ..Default::default()
    })
}

/// Each layer of `texture`.
pub fn each(texture: &wgpu::Texture) -> Vec<wgpu::TextureView> {
    let layer = |base_array_layer| {
        texture.create_view(&wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2),
            base_array_layer,
            array_layer_count: Some(1),
            ..Default::default()
        })
    };
    (0..texture.depth_or_array_layers()).map(layer).collect()
}

/// Bytes of a row of a luminance layer in a buffer.
pub const fn row_bytes(width: u32) -> u32 {
    (width * 4).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT)
}

impl Layers {
    /// Bytes of `count` layers in a buffer.
    pub fn host_bytes(&self, count: u32) -> u64 {
        u64::from(row_bytes(self.width)) * u64::from(self.height) * u64::from(count)
    }

    /// Records the way of the first `count` layers into `buffer`.
    pub fn encode_read(&self, encoder: &mut wgpu::CommandEncoder, buffer: &wgpu::Buffer, count: u32) {
        let (width, height) = (self.width, self.height);
        encoder.copy_texture_to_buffer(
            self.texture.as_image_copy(),
            wgpu::TexelCopyBufferInfo {
                buffer,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(row_bytes(width)),
                    rows_per_image: Some(height),
                },
            },
            wgpu::Extent3d { width, height, depth_or_array_layers: count },
        );
    }
}
