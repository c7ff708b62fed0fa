//! What every submission reads: the scene on the device, its views, pipelines, and the frames in work.

use std::sync::Arc;

use evis_core::SensorConfig;
use evis_scene::Scene;

use crate::config::grid::SampleGrid;
use crate::frame::draw::Stage;
use crate::frame::upload::FrameBuffers;
use crate::frame::{FrameData, FrameRequest};
use crate::gpu::Gpu;
use crate::gpu::uniforms::ViewSensor;
use crate::pass::ComputePass;
use crate::pass::raster::{Pipelines, SurfaceLayouts};
use crate::raster::resample::Resampler;
use crate::raster::shadow_maps::ShadowMaps;
use crate::shadow::plan::ShadowPlan;
use crate::world::gpu_scene::GpuScene;
use crate::world::view::View;

/// What an upload of frames brings beside them.
#[derive(Clone, Copy, Default)]
pub(crate) struct Upload {
    /// The numbers of records in place of the ids of objects.
    pub record_ids: bool,
    /// What changes from instant to instant: the group's first view and the first instant.
    pub watch: Option<(usize, i64)>,
    /// Where everything was.
    pub trail: bool,
}

/// What every submission reads.
pub struct Context {
    pub(crate) gpu: Gpu,
    pub(crate) scene: Arc<Scene>,
    pub(crate) gpu_scene: GpuScene,
    pub(crate) layouts: SurfaceLayouts,
    pub(crate) views: Vec<View>,
    pub(crate) grid: SampleGrid,
    pub(crate) start_us: i64,
    /// Sample offsets in pixels; one, at the centre, for `--antialias edges`, whose places lie on a grid.
    pub(crate) offsets: Vec<[f32; 2]>,
    /// The offsets of audits that look between them, as many; they are numbered after these.
    pub(crate) other_offsets: Vec<[f32; 2]>,
    pub(crate) luminance: Pipelines,
    pub(crate) sky: Option<wgpu::RenderPipeline>,
    /// Clears a part of a luminance picture.
    pub(crate) background: wgpu::RenderPipeline,
    /// Averages coverage samples.
    pub(crate) resolve: ComputePass,
    /// One for each distorted lens.
    pub(crate) resamplers: Vec<Resampler>,
    pub(crate) surroundings: wgpu::BindGroup,
    pub(crate) background_luminance: f64,
    /// `Y_ref` of every pixel.
    pub(crate) reference_luminance: f32,
    pub(crate) shadows: Option<ShadowMaps>,
    pub(crate) frame_data: FrameData,
    pub(crate) frame_buffers: FrameBuffers,
    /// Whether what is as it was at the instant before is copied, not drawn; a test compares both.
    pub(crate) skips_still: bool,
}

impl Context {
    /// Scene time of stream time `t_us`, in seconds.
    pub(crate) fn scene_time_s(&self, t_us: i64) -> f64 {
        (self.start_us + t_us) as f64 * 1e-6
    }

    /// Name of the camera of `view`.
    pub(crate) fn camera_name(&self, view: &View) -> String {
        let camera = self.scene.cameras.iter().find(|camera| camera.node == view.node);
        camera.map_or_else(String::new, |camera| camera.name.clone())
    }

    /// What renders `view`, where its lens is distorted.
    pub(crate) fn resampler(&self, view: &View) -> Option<&Resampler> {
        let own = view.distorted.as_ref()?;
        self.resamplers.iter().find(|resampler| resampler.camera == *own)
    }

    /// First record of frame `frame`.
    pub(crate) fn object_base(&self, frame: u32) -> u32 {
        frame * self.gpu_scene.objects.len() as u32
    }

    /// In pixels, of sample `sample`; those of audits with other samples come after the own ones.
    pub(crate) fn sample_offset(&self, sample: u32) -> [f32; 2] {
        let sample = sample as usize;
        let other = || self.other_offsets[sample - self.offsets.len()];
        self.offsets.get(sample).copied().unwrap_or_else(other)
    }

    /// Offsets of frame `frame` in its uniform buffer, and of what `sample` stands for; none stands for the whole pixel.
    pub(crate) fn frame_offsets(&self, frame: u32, sample: Option<u32>) -> [u32; 2] {
        self.frame_buffers.offsets(frame, sample)
    }

    /// What draws of `frame_group` read.
    pub(crate) fn stage<'a>(&'a self, frame_group: &'a wgpu::BindGroup) -> Stage<'a> {
        Stage { scene: &self.gpu_scene, buffers: &self.frame_buffers, frame_group }
    }

    /// What the trigger reads of the sensors of the views `indices`.
    pub(crate) fn view_sensors(&self, indices: &[usize]) -> Vec<ViewSensor> {
        let of = |&v: &usize| {
            let SensorConfig { threshold_on, threshold_off, log_eps, .. } = self.views[v].sensor;
            let inverse_reference_luminance = 1.0 / self.reference_luminance;
            ViewSensor { threshold_on, threshold_off, log_eps, inverse_reference_luminance }
        };
        indices.iter().map(of).collect()
    }

    /// The views `indices`.
    pub(crate) fn views_at(&self, indices: &[usize]) -> Vec<View> {
        indices.iter().map(|&v| self.views[v].clone()).collect()
    }

    /// Evaluates `views` at `times_us` and uploads the result; returns group 0.
    pub(crate) fn upload_frames(&mut self, views: &[View], times_us: &[i64]) -> wgpu::BindGroup {
        self.upload_frames_as(views, times_us, Upload::default())
    }

    /// The same, with what `upload` asks for.
    pub(crate) fn upload_frames_as(
        &mut self,
        views: &[View],
        times_us: &[i64],
        upload: Upload,
    ) -> wgpu::BindGroup {
        self.build_frames(views, times_us, upload);
        self.frame_buffers.upload(&self.gpu, &self.layouts, &self.gpu_scene.morph_data, &self.frame_data)
    }

    /// The same, without the way to the device: for what poses alone tell.
    pub(crate) fn build_frames(&mut self, views: &[View], times_us: &[i64], upload: Upload) {
        let times_s: Vec<f64> = times_us.iter().map(|&t| self.scene_time_s(t)).collect();
        let plan = self.shadows.as_ref().map(|s| &s.plan);
        let redrawn = plan.is_some_and(ShadowPlan::is_redrawn);
        let occluders = self.shadows.as_ref().and_then(|s| s.occluders.as_ref());
        let request = FrameRequest {
            views,
            times_s: &times_s,
            shadows: plan,
            occluders,
            record_ids: upload.record_ids,
            shadow_maps: redrawn,
            watch: upload.watch,
            trail: upload.trail,
        };
        self.frame_data.build(&self.scene, &self.gpu_scene, &request);
    }
}
