//! Luminance of cameras with a distorted lens: a picture without distortion is rendered, and its samples are gathered by
//! the pixels that they fall into.

use std::sync::Arc;

use wgpu::util::DeviceExt as _;

use crate::error::EngineError;
use crate::frame::pattern;
use crate::gpu::sizes::DeviceLimits;
use crate::pass::resample::{self, COVERAGE_BINDINGS, SAMPLES_BINDINGS};
use crate::pass::{self, Binding, ComputePass};
use crate::raster::layers::{LayerUse, Layers};
use crate::world::distorted::{Distorted, EDGE_BITS, PictureSamples, SamplePlace};

/// Bits of a texel's x and y in an entry for coverage samples, of which a texel has four.
const COVERAGE_EDGE_BITS: u32 = 13;

/// Places of a texel's four coverage samples, in sixteenths (Vulkan 1.3, "Standard sample locations"; Direct3D and Metal have
/// the same).
const COVERAGE_PLACES: [[f64; 2]; 4] = [[6.0, 2.0], [14.0, 6.0], [2.0, 10.0], [10.0, 14.0]];

/// What makes the luminance of one lens.
pub struct Resampler {
    /// The lens.
    pub camera: Arc<Distorted>,
    /// Samples without distortion.
    pub picture: Layers,
    pass: ComputePass,
    bindings: &'static [Binding],
    starts: wgpu::Buffer,
    entries: wgpu::Buffer,
}

/// The samples of a picture, where samples have `offsets` and are rendered as `made` says.
pub fn picture_samples(offsets: &[[f32; 2]], made: LayerUse) -> PictureSamples {
    match made {
        LayerUse::Resolved(grid) => {
            let place = |(index, at): (u32, [f64; 2])| SamplePlace { within: at.map(|v| v / 16.0), index };
            let places = (0..).zip(COVERAGE_PLACES).map(place).collect();
            PictureSamples { places, grid, edge_bits: COVERAGE_EDGE_BITS, cell: [1.0 / f64::from(grid); 2] }
        }
        LayerUse::Rendered | LayerUse::Computed => {
            // A picture that is moved by an offset is sampled at the opposite place.
            let place =
                |(index, o): (u32, &[f32; 2])| SamplePlace { within: o.map(|v| 0.5 - f64::from(v)), index };
            let cell = pattern::grid(offsets.len()).map(|n| 1.0 / n as f64);
            PictureSamples {
                places: (0..).zip(offsets).map(place).collect(),
                grid: 1,
                edge_bits: EDGE_BITS,
                cell,
            }
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
                 longer edge, and {most} fit; choose a smaller --size or fewer --samples"
            )));
        }
        let footprints = camera.footprints(&samples);
        let bytes = 8 * footprints.entries.len() as u64;
        if bytes > limits.storage_binding {
            return Err(EngineError::Device(format!(
                "the samples of a distorted lens take {bytes} bytes, and a binding of this device holds {}; choose a \
                 smaller --size or fewer --samples",
                limits.storage_binding
            )));
        }
        let buffer = |label, contents: &[u8]| {
            device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some(label),
                contents,
                usage: wgpu::BufferUsages::STORAGE,
            })
        };
        let entries: &[[u32; 2]] =
            if footprints.entries.is_empty() { &[[0; 2]] } else { &footprints.entries };
        let (pass, bindings) = match made {
            LayerUse::Resolved(_) => (resample::coverage(device, edge_bits), COVERAGE_BINDINGS),
            LayerUse::Rendered | LayerUse::Computed => {
                (resample::samples(device, edge_bits), SAMPLES_BINDINGS)
            }
        };
        Ok(Self {
            picture: Layers::new(device, width, height, layers, made),
            pass,
            bindings,
            starts: buffer("starts of footprints", bytemuck::cast_slice(&footprints.starts)),
            entries: buffer("samples of footprints", bytemuck::cast_slice(entries)),
            camera,
        })
    }

    /// Records the mean of the samples of every pixel into `layer`.
    pub fn encode_gather(
        &self,
        device: &wgpu::Device,
        encoder: &mut wgpu::CommandEncoder,
        layer: &wgpu::TextureView,
    ) {
        let pictures = self.picture.multisampled.as_ref().unwrap_or(&self.picture.array);
        let resources = vec![
            self.starts.as_entire_binding(),
            self.entries.as_entire_binding(),
            wgpu::BindingResource::TextureView(pictures),
            wgpu::BindingResource::TextureView(layer),
        ];
        let group = pass::group(device, "resample", &self.pass.layout, self.bindings, resources);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&self.pass.pipeline);
        pass.set_bind_group(0, &group, &[]);
        let [width, height] = self.camera.size;
        pass.dispatch_workgroups(width.div_ceil(8), height.div_ceil(8), 1);
    }
}
