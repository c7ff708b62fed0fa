//! Luminance of cameras with a distorted lens: a picture without distortion is rendered, and its samples are gathered by
//! the pixels that they fall into.

use std::sync::Arc;

use wgpu::util::DeviceExt as _;

use crate::error::EngineError;
use crate::frame::pattern::{self, Share};
use crate::gpu::commands::Commands;
use crate::gpu::sizes::DeviceLimits;
use crate::pass::resample::{self, COVERAGE_BINDINGS, SAMPLES_BINDINGS};
use crate::pass::{self, Binding, ComputePass};
use crate::raster::layers::{LayerUse, Layers};
use crate::world::distorted::{Cell, Distorted, EDGE_BITS, PictureSamples};

/// Bits of a texel's x and y in an entry, where a texel is one cell of four coverage samples.
const COVERAGE_EDGE_BITS: u32 = 13;

/// What makes the luminance of one lens.
pub struct Resampler {
    /// The lens.
    pub camera: Arc<Distorted>,
    /// Samples without distortion.
    pub picture: Layers,
    pass: ComputePass,
    bindings: &'static [Binding],
    /// As many rows of the camera at once as fit a binding.
    bands: Vec<Band>,
}

/// Some rows of a camera.
struct Band {
    rows: u32,
    starts: wgpu::Buffer,
    entries: wgpu::Buffer,
}

/// The samples of a picture, where samples have `offsets` and are rendered as `made` says.
pub fn picture_samples(offsets: &[[f32; 2]], made: LayerUse) -> PictureSamples {
    match made {
        // The mean of four coverage samples, which are shaded once.
        LayerUse::Resolved(grid) => PictureSamples {
            cells: vec![Cell { middle: [0.5; 2], index: 0 }],
            grid,
            edge_bits: COVERAGE_EDGE_BITS,
            size: [1.0 / f64::from(grid); 2],
        },
        LayerUse::Rendered | LayerUse::Computed => {
            // A picture that is moved by an offset is sampled at the opposite place.
            let places: Vec<[f32; 2]> = offsets.iter().map(|o| o.map(|v| -v)).collect();
            let share = |(index, (place, share)): (u32, (&[f32; 2], Share))| Cell {
                middle: [0, 1].map(|axis| 0.5 + f64::from(place[axis]) + f64::from(share.shift[axis])),
                index,
            };
            let cells = (0..).zip(places.iter().zip(pattern::shares(&places))).map(share).collect();
            let size = pattern::grid(offsets.len()).map(|n| 1.0 / n as f64);
            PictureSamples { cells, grid: 1, edge_bits: EDGE_BITS, size }
        }
    }
}

impl Resampler {
    /// Prepares `camera`, where samples have `offsets` and are rendered as `made` says.
    ///
    /// # Errors
    /// Pictures and lists of samples that do not fit the device.
    pub fn new(
        device: &wgpu::Device,
        camera: Arc<Distorted>,
        offsets: &[[f32; 2]],
        made: LayerUse,
        limits: DeviceLimits,
    ) -> Result<Self, EngineError> {
        let samples = picture_samples(offsets, made);
        let (grid, edge_bits) = (samples.grid, samples.edge_bits);
        let [width, height] = [camera.picture.width, camera.picture.height];
        let edge = width.max(height) * grid;
        let most = limits.texture_edge.min(1 << edge_bits);
        let layers = offsets.len() as u32;
        if edge > most || layers > limits.texture_layers {
            return Err(EngineError::Device(format!(
                "a camera with a distorted lens takes a picture of {width}x{height} pixels without it, {edge} texels along its \
                 longer edge, and {most} fit; choose a smaller `size` or fewer `samples`"
            )));
        }
        let footprints = camera.footprints(&samples);
        let buffer = |label, contents: &[u8]| {
            device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some(label),
                contents,
                usage: wgpu::BufferUsages::STORAGE,
            })
        };
        let bands = footprints.bands(camera.size[0], limits.storage_binding).ok_or_else(|| {
            EngineError::Device(format!(
                "the samples of a row of a camera with a distorted lens exceed a binding of this device, {} bytes; choose a \
                 smaller `size` or fewer `samples`",
                limits.storage_binding
            ))
        })?;
        let band = |(starts, range): (Vec<u32>, std::ops::Range<usize>)| {
            let entries: &[[u32; 2]] = if range.is_empty() { &[[0; 2]] } else { &footprints.entries[range] };
            Band {
                rows: (starts.len() as u32 - 2) / camera.size[0],
                starts: buffer("starts of footprints", bytemuck::cast_slice(&starts)),
                entries: buffer("samples of footprints", bytemuck::cast_slice(entries)),
            }
        };
        let bands = bands.into_iter().map(band).collect();
        let (pass, bindings) = match made {
            LayerUse::Resolved(_) => (resample::coverage(device, edge_bits), COVERAGE_BINDINGS),
            LayerUse::Rendered | LayerUse::Computed => {
                (resample::samples(device, edge_bits), SAMPLES_BINDINGS)
            }
        };
        Ok(Self { picture: Layers::new(device, width, height, layers, made), pass, bindings, bands, camera })
    }

    /// Records the mean of the samples of every pixel into `layer`.
    pub fn encode_gather(&self, device: &wgpu::Device, encoder: &mut Commands, layer: &wgpu::TextureView) {
        let pictures = self.picture.multisampled.as_ref().unwrap_or(&self.picture.array);
        for band in &self.bands {
            let resources = vec![
                band.starts.as_entire_binding(),
                band.entries.as_entire_binding(),
                wgpu::BindingResource::TextureView(pictures),
                wgpu::BindingResource::TextureView(layer),
            ];
            let group = pass::group(device, "resample", &self.pass.layout, self.bindings, resources);
            let workgroups = (self.camera.size[0].div_ceil(8), band.rows.div_ceil(8), 1);
            self.pass.encode(encoder, &group, &[], workgroups);
        }
    }
}
