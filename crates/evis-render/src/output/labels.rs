//! Labels: their targets, their submissions, and the images that come back.

use std::sync::Arc;

use evis_core::{LabelData, LabelFrame, LabelKind, TimeGrid};
use evis_scene::Scene;

use crate::config::RunConfig;
use crate::error::EngineError;
use crate::frame::draw::{Drawing, attachment, depth_attachment, draw_surfaces};
use crate::gpu::commands::Commands;
use crate::gpu::sizes::DeviceLimits;
use crate::gpu::texture::DEPTH_FORMAT;
use crate::gpu::uniforms::LabelFrame as LabelUniform;
use crate::pass::labels::{
    APPEARANCE_FORMATS, GEOMETRY_FORMATS, LabelTargets, appearance_pipelines, targets,
};
use crate::pass::raster::{Pipelines, SceneConstants, SurfaceLayouts, WHOLE_PIXEL_TAPS};
use crate::pass::sky;
use crate::raster::context::Context;
use crate::raster::geometry::{GeometryPass, GeometryRenderer, NO_FLOW, sky_flow};
use crate::raster::shadows::MovingShadows;
use crate::sensor::group::Group;
use crate::world::distorted::Distorted;
use crate::world::gpu_scene::GpuScene;
use crate::world::view::View;

/// Everything that labels need; absent where none is asked for.
pub struct LabelRenderer {
    kinds: Vec<LabelKind>,
    wanted: LabelTargets,
    geometry: Option<GeometryRenderer>,
    appearance: Pipelines,
    sky_color: Option<wgpu::RenderPipeline>,
    background: [f64; 3],
    /// One for each distorted lens.
    maps: Vec<Arc<LabelMap>>,
}

/// One label instant of one group, on its way back.
pub struct LabelJob {
    /// Group.
    pub group: usize,
    /// Label index.
    pub index: i64,
    t_us: i64,
    next_us: i64,
    last_us: Option<i64>,
    /// What the host maps.
    pub staging: wgpu::Buffer,
    width: u32,
    height: u32,
    /// Where pixels are in it, where the lens is distorted.
    map: Option<Arc<LabelMap>>,
}

/// A target's pixels within a staging buffer.
struct Plane {
    offset: u64,
    row: u32,
    texel: u32,
}

impl LabelRenderer {
    /// `None` where no label is asked for.
    #[expect(
        clippy::too_many_arguments,
        reason = "a constructor that reads everything that is prepared before it, once"
    )]
    pub fn new(
        device: &wgpu::Device,
        layouts: &SurfaceLayouts,
        scene: &Scene,
        gpu_scene: &GpuScene,
        views: &[View],
        config: &RunConfig,
        constants: &SceneConstants,
        limits: DeviceLimits,
    ) -> Result<Option<Self>, EngineError> {
        let mut kinds = config.labels.clone();
        // Frames are made elsewhere, and causes are no images.
        kinds.retain(|kind| kind.is_image() && *kind != LabelKind::Frame);
        if kinds.is_empty() {
            return Ok(None);
        }
        for view in views {
            // Of a distorted lens, the picture that is rendered.
            let edge = view.lens.width.max(view.lens.height);
            if edge > limits.texture_edge {
                let text =
                    format!("{edge} pixels exceed this device's largest texture, {}", limits.texture_edge);
                return Err(EngineError::Device(text));
            }
        }
        kinds.sort_unstable();
        kinds.dedup();
        let has = |kind: LabelKind| kinds.contains(&kind);
        let flow = has(LabelKind::FlowForward)
            || has(LabelKind::FlowBackward)
            || has(LabelKind::FlowForwardValid)
            || has(LabelKind::FlowBackwardValid);
        let ids = has(LabelKind::Instance) || has(LabelKind::Semantic);
        let wanted = LabelTargets {
            geometry: [has(LabelKind::Depth), flow, ids],
            appearance: [has(LabelKind::Hdr), has(LabelKind::Normal)],
        };
        let variants = || gpu_scene.variants().into_iter();
        // A label is one sample at the pixel's centre: it stands for a whole pixel.
        let constants =
            SceneConstants { texture_samples: 1, grid: 1, texture_taps: WHOLE_PIXEL_TAPS, ..*constants };
        let geometry = wanted
            .any_geometry()
            .then(|| GeometryRenderer::new(device, layouts, gpu_scene, &constants, wanted.geometry));
        let appearance = if wanted.any_appearance() {
            appearance_pipelines(device, layouts, variants(), &constants, wanted.appearance)
        } else {
            Pipelines::new()
        };
        let visible = scene.environment.as_ref().is_some_and(|e| e.visible);
        let sky_color = (visible && wanted.appearance[0]).then(|| {
            let mut targets = targets(APPEARANCE_FORMATS, wanted.appearance);
            if let Some(normal) = &mut targets[1] {
                // The sky has no normal.
                normal.write_mask = wgpu::ColorWrites::empty();
            }
            sky::pipeline(device, layouts, "fs_color", &targets, 1, constants.lights.count)
        });
        Ok(Some(Self {
            kinds,
            wanted,
            geometry,
            appearance,
            sky_color,
            background: scene.background.map(f64::from),
            maps: Vec::new(),
        }))
    }

    /// Where the pixels of `views`, which have one lens, lie in a picture without distortion, where the lens is distorted.
    fn map(&mut self, views: &[View], limits: DeviceLimits) -> Option<Arc<LabelMap>> {
        let camera = views[0].distorted.as_ref()?;
        if let Some(known) = self.maps.iter().find(|map| map.camera == *camera) {
            return Some(Arc::clone(known));
        }
        let [width, height] = [camera.picture.width, camera.picture.height];
        let fits = |scale: &u32| {
            let (_, bytes) = self.planes(width * scale, height * scale, 0);
            let edge = width.max(height) * scale;
            bytes * views.len() as u64 <= DENSE_BYTES && edge <= limits.texture_edge
        };
        let scale = (1..=DENSEST).rev().find(fits).unwrap_or(1);
        let map = Arc::new(LabelMap::new(Arc::clone(camera), scale));
        self.maps.push(Arc::clone(&map));
        Some(map)
    }

    /// Targets in order: geometry, then appearance; `None` where absent.
    fn formats(&self) -> [Option<wgpu::TextureFormat>; 5] {
        let g = |i: usize| self.wanted.geometry[i].then_some(GEOMETRY_FORMATS[i]);
        let a = |i: usize| self.wanted.appearance[i].then_some(APPEARANCE_FORMATS[i]);
        [g(0), g(1), g(2), a(0), a(1)]
    }

    /// Where each target of view `view` of a job lies, and the bytes of one view.
    fn planes(&self, width: u32, height: u32, view: usize) -> ([Option<Plane>; 5], u64) {
        let mut bytes = 0;
        let mut planes = self.formats().map(|format| {
            format.map(|format| {
                let texel = format.block_copy_size(None).unwrap_or(0);
                let row = (width * texel).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
                let plane = Plane { offset: bytes, row, texel };
                bytes += u64::from(row) * u64::from(height);
                plane
            })
        });
        for plane in planes.iter_mut().flatten() {
            plane.offset += bytes * view as u64;
        }
        (planes, bytes)
    }

    /// Submits label `index` of the views of `group`.
    pub fn submit(
        &mut self,
        context: &mut Context,
        group: &Group,
        group_index: usize,
        index: i64,
        grid: &TimeGrid,
    ) -> (LabelJob, wgpu::SubmissionIndex) {
        let views = context.views_at(&group.views);
        let map = self.map(&views, DeviceLimits::of(&context.gpu.device));
        let scale = map.as_ref().map_or(1, |map| map.scale);
        let [width, height] = [views[0].lens.width, views[0].lens.height].map(|edge| edge * scale);
        let t_us = grid.instant_us(index);
        let next_us = grid.instant_us(index + 1);
        let last_us = (index > 0).then(|| grid.instant_us(index - 1));
        // Three frames per view: now, next, last.
        let frame_group = context.upload_frames(&views, &[t_us, next_us, last_us.unwrap_or(t_us)]);
        let objects = context.gpu_scene.objects.len() as u32;
        let label = LabelUniform {
            next_offset: objects,
            last_offset: 2 * objects,
            half_size: [views[0].lens.width, views[0].lens.height].map(|edge| edge as f32 / 2.0),
        };
        let others = [next_us, last_us.unwrap_or(t_us)];
        let skies: Vec<_> = views.iter().map(|view| sky_flow(context, view, others)).collect();
        let groups = self.geometry.as_mut().map(|renderer| renderer.upload(context, &label, &skies));

        let device = &context.gpu.device;
        let textures = self.formats().map(|format| {
            format.map(|format| {
                device.create_texture(&wgpu::TextureDescriptor {
                    label: Some("label"),
                    size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
                    mip_level_count: 1,
                    sample_count: 1,
                    dimension: wgpu::TextureDimension::D2,
                    format,
                    usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
                    view_formats: &[],
                })
            })
        });
        let target_views =
            textures.each_ref().map(|t| t.as_ref().map(|t| t.create_view(&Default::default())));
        let depth = device
            .create_texture(&wgpu::TextureDescriptor {
                label: Some("label depth"),
                size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: DEPTH_FORMAT,
                usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
                view_formats: &[],
            })
            .create_view(&Default::default());
        let (_, view_bytes) = self.planes(width, height, 0);
        let staging = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("labels for the host"),
            size: view_bytes * views.len() as u64,
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = Commands::new(&context.gpu, "labels");
        let mut shadows = MovingShadows::new(&frame_group, &views, 3);
        for view in 0..views.len() {
            let frame = view as u32 * 3;
            let [inverse_depth, flow, ids, color, normal] = target_views.each_ref().map(Option::as_ref);
            if let (Some(renderer), Some(groups)) = (&self.geometry, &groups) {
                let targets = [inverse_depth, flow, ids];
                let what = GeometryPass { frame, sky: view as u32, targets, depth: &depth };
                renderer.encode(context, &mut encoder, &frame_group, groups, &what);
            }
            if self.wanted.any_appearance() {
                shadows.show(context, &mut encoder, view as u32, 0);
                self.encode_appearance(context, &mut encoder, &frame_group, [color, normal], &depth, frame);
            }
            let (planes, _) = self.planes(width, height, view);
            for (texture, plane) in textures.iter().zip(planes) {
                if let (Some(texture), Some(plane)) = (texture, plane) {
                    encoder.copy_texture_to_buffer(
                        texture.as_image_copy(),
                        wgpu::TexelCopyBufferInfo {
                            buffer: &staging,
                            layout: wgpu::TexelCopyBufferLayout {
                                offset: plane.offset,
                                bytes_per_row: Some(plane.row),
                                rows_per_image: Some(height),
                            },
                        },
                        texture.size(),
                    );
                }
            }
        }
        let submission = encoder.submit(&context.gpu);
        (
            LabelJob { group: group_index, index, t_us, next_us, last_us, staging, width, height, map },
            submission,
        )
    }

    fn encode_appearance(
        &self,
        context: &Context,
        encoder: &mut Commands,
        frame_group: &wgpu::BindGroup,
        targets: [Option<&wgpu::TextureView>; 2],
        depth: &wgpu::TextureView,
        frame: u32,
    ) {
        let [r, g, b] = self.background;
        let clears = [wgpu::Color { r, g, b, a: 1.0 }, wgpu::Color::TRANSPARENT];
        let attachments: [_; 2] = std::array::from_fn(|i| targets[i].map(|view| attachment(view, clears[i])));
        let depth = depth_attachment(depth, wgpu::StoreOp::Discard);
        let mut pass = encoder.render("appearance labels", &attachments, depth);
        let what = Drawing {
            items: &context.frame_data.visible[frame as usize],
            frame,
            sample: None,
            first_record: context.object_base(frame),
        };
        draw_surfaces(
            context.stage(frame_group),
            &mut pass,
            &self.appearance,
            Some(&context.surroundings),
            &what,
        );
        if let Some(sky) = &self.sky_color {
            pass.set_pipeline(sky);
            pass.set_bind_group(0, frame_group, &context.frame_offsets(frame, None));
            pass.set_bind_group(2, &context.surroundings, &[]);
            pass.draw(0..3, 0..1);
        }
    }

    /// The images of a finished job, per view (index), in the order of their kinds.
    pub fn take(
        &self,
        _context: &Context,
        group: &Group,
        job: LabelJob,
    ) -> Result<Vec<(usize, Vec<LabelFrame>)>, EngineError> {
        let bytes = job
            .staging
            .get_mapped_range(..)
            .map_err(|e| EngineError::Device(format!("cannot read labels back: {e}")))?;
        let mut out = Vec::new();
        for (slot, &view) in group.views.iter().enumerate() {
            let (planes, _) = self.planes(job.width, job.height, slot);
            let [inverse_depth, flow, ids, color, normal] = planes.map(|plane| {
                let (width, height, map) = (job.width, job.height, job.map.as_deref());
                plane.map(|plane| Pixels { bytes: &bytes, plane, width, height, map })
            });
            let frames = self.kinds.iter().filter_map(|&kind| {
                let forward = matches!(kind, LabelKind::FlowForward | LabelKind::FlowForwardValid);
                let backward = matches!(kind, LabelKind::FlowBackward | LabelKind::FlowBackwardValid);
                let at = if forward { 0 } else { 2 };
                // Nothing lies before the stream.
                let defined = forward || job.last_us.is_some();
                let data = match kind {
                    LabelKind::Depth => LabelData::F32(
                        inverse_depth
                            .as_ref()?
                            .texels::<f32>()
                            .map(|v| if v > 0.0 { 1.0 / v } else { f32::INFINITY })
                            .collect(),
                    ),
                    LabelKind::FlowForward | LabelKind::FlowBackward => LabelData::F32(
                        flow.as_ref()?
                            .flows()
                            .flat_map(
                                |v| if defined && is_flow(v[at]) { [v[at], v[at + 1]] } else { [0.0; 2] },
                            )
                            .collect(),
                    ),
                    LabelKind::FlowForwardValid | LabelKind::FlowBackwardValid => LabelData::U8(
                        flow.as_ref()?.flows().map(|v| u8::from(defined && is_flow(v[at]))).collect(),
                    ),
                    LabelKind::Instance => {
                        LabelData::U32(ids.as_ref()?.texels::<[u32; 2]>().map(|v| v[0]).collect())
                    }
                    LabelKind::Semantic => {
                        LabelData::U32(ids.as_ref()?.texels::<[u32; 2]>().map(|v| v[1]).collect())
                    }
                    LabelKind::Normal => LabelData::F32(
                        normal.as_ref()?.texels::<[f32; 4]>().flat_map(|v| [v[0], v[1], v[2]]).collect(),
                    ),
                    LabelKind::Hdr => LabelData::F32(
                        color.as_ref()?.texels::<[f32; 4]>().flat_map(|v| [v[0], v[1], v[2]]).collect(),
                    ),
                    LabelKind::Frame | LabelKind::Cause => return None,
                };
                let t_other_us = if forward {
                    job.next_us
                } else if backward {
                    job.last_us.unwrap_or(job.t_us)
                } else {
                    job.t_us
                };
                Some(LabelFrame { kind, t_us: job.t_us, t_other_us, data })
            });
            out.push((view, frames.collect()));
        }
        Ok(out)
    }
}

fn is_flow(component: f32) -> bool {
    component.abs() < NO_FLOW
}

/// A plane's texels, row by row, without the padding of rows.
struct Pixels<'a> {
    bytes: &'a [u8],
    plane: Plane,
    width: u32,
    height: u32,
    map: Option<&'a LabelMap>,
}

impl<'a> Pixels<'a> {
    /// The texel of every pixel; zeros where a lens shows nothing.
    fn texels<T: bytemuck::AnyBitPattern>(&self) -> impl Iterator<Item = T> + use<'a, T> {
        let (bytes, texel) = (self.bytes, self.plane.texel as usize);
        let (offset, row) = (self.plane.offset as usize, self.plane.row as usize);
        let read = move |x: usize, y: usize| {
            let start = offset + y * row + x * texel;
            bytemuck::pod_read_unaligned(&bytes[start..start + texel])
        };
        let map = self.map;
        let [columns, rows] = map.map_or([self.width, self.height], |map| map.camera.size);
        (0..rows as usize).flat_map(move |y| {
            (0..columns as usize).map(move |x| match map {
                None => read(x, y),
                Some(map) => match map.texels[y * columns as usize + x] {
                    Some([x, y]) => read(x.into(), y.into()),
                    None => T::zeroed(),
                },
            })
        })
    }

    /// Flow of every pixel, forward and backward, in pixels of the camera.
    fn flows(&self) -> impl Iterator<Item = [f32; 4]> + use<'a> {
        let map = self.map;
        (0..).zip(self.texels::<[f32; 4]>()).map(move |(pixel, flow)| match map {
            None => flow,
            Some(map) => map.flow(pixel, flow),
        })
    }
}

/// Texels of the label pictures of a distorted lens along each side of a pixel, at most: a label is that of the nearest one to
/// the pixel's centre, at most an eighth of a pixel away along either axis.
const DENSEST: u32 = 4;

/// Bytes of label pictures of a distorted lens on their way to the host, at most, where they need not be larger.
const DENSE_BYTES: u64 = 128 << 20;

/// Where the pixels of a camera with a distorted lens lie in a label picture without distortion.
struct LabelMap {
    camera: Arc<Distorted>,
    /// Texels along each side of a pixel of the picture.
    scale: u32,
    /// Per pixel of the camera; `None` where its lens shows nothing.
    texels: Vec<Option<[u16; 2]>>,
}

impl LabelMap {
    fn new(camera: Arc<Distorted>, scale: u32) -> Self {
        let [width, height] = camera.size;
        let end = [camera.picture.width * scale - 1, camera.picture.height * scale - 1];
        let texel = |x: u32, y: u32| {
            let at = camera.source([f64::from(x) + 0.5, f64::from(y) + 0.5].into())?;
            Some([0, 1].map(|k| ((at[k] * f64::from(scale)).max(0.0) as u32).min(end[k]) as u16))
        };
        let texels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let texels = texels.map(|(x, y)| texel(x, y)).collect();
        Self { camera, scale, texels }
    }

    /// Flow in pixels of the camera, of flow in the picture.
    fn flow(&self, pixel: usize, flow: [f32; 4]) -> [f32; 4] {
        let Some(texel) = self.texels[pixel] else { return [NO_FLOW; 4] };
        let here = texel.map(|v| (f64::from(v) + 0.5) / f64::from(self.scale));
        let from = self.camera.pixel(here);
        let way = |[x, y]: [f32; 2]| {
            if !is_flow(x) {
                return [NO_FLOW; 2];
            }
            let there = self.camera.pixel([here[0] + f64::from(x), here[1] + f64::from(y)]);
            match (from, there) {
                (Some(from), Some(there)) => (there - from).to_array().map(|v| v as f32),
                _ => [NO_FLOW; 2],
            }
        };
        let ([a, b], [c, d]) = (way([flow[0], flow[1]]), way([flow[2], flow[3]]));
        [a, b, c, d]
    }
}
