//! Textures that luminance is rendered into, a layer per sample and instant.

use crate::gpu::commands::Commands;
use crate::gpu::texture::{DEPTH_FORMAT, array, each, row_bytes, whole};
use crate::pass::raster::LUMINANCE_FORMAT;

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
    /// Four coverage samples, for `--antialias edges`: of a picture that is `grid` times as large along each side.
    pub multisampled: Option<wgpu::TextureView>,
    /// What `multisampled` and `depth` are larger by.
    pub grid: u32,
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

impl Layers {
    /// Pixels of a layer.
    pub fn pixels(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }

    /// Bytes of `count` layers in a buffer.
    pub fn host_bytes(&self, count: u32) -> u64 {
        u64::from(row_bytes(self.width)) * u64::from(self.height) * u64::from(count)
    }

    /// Records the way of the first `count` layers into `buffer`.
    pub fn encode_read(&self, encoder: &mut Commands, buffer: &wgpu::Buffer, count: u32) {
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
