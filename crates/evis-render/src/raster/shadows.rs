//! Shadow maps follow what is drawn.

use crate::error::EngineError;
use crate::frame::{FrameData, FrameRequest};
use crate::gpu::commands::Commands;
use crate::raster::context::Context;
use crate::world::view::View;

/// Lets maps follow what is drawn: the views of an upload, each at `instants` instants.
pub struct MovingShadows<'a> {
    frame_group: &'a wgpu::BindGroup,
    views: &'a [View],
    /// Of these, each once: their maps come in this order.
    environments: Vec<usize>,
    instants: u32,
    /// Environment and instant that the maps show.
    shown: Option<(usize, u32)>,
}

impl<'a> MovingShadows<'a> {
    /// Nothing is shown yet.
    pub fn new(frame_group: &'a wgpu::BindGroup, views: &'a [View], instants: u32) -> Self {
        let mut environments: Vec<usize> = views.iter().map(|v| v.environment).collect();
        environments.dedup();
        Self { frame_group, views, environments, instants, shown: None }
    }

    /// Draws the maps that `view` needs at instant `k`, where they are not drawn.
    pub fn show(&mut self, context: &Context, encoder: &mut Commands, view: u32, k: u32) {
        let Some(maps) = context.shadows.as_ref().filter(|maps| maps.plan.redrawn) else { return };
        let environment = self.views[view as usize].environment;
        if self.shown.replace((environment, k)) == Some((environment, k)) {
            return;
        }
        let Some(e) = self.environments.iter().position(|other| *other == environment) else { return };
        let lights = maps.plan.nodes.len();
        let frames = self.views.len() * self.instants as usize;
        for light in 0..lights {
            let map = (e * self.instants as usize + k as usize) * lights + light;
            let first = FrameData::shadow_record(frames, context.gpu_scene.objects.len(), map);
            let moved = &context.frame_data.moved_texels[map];
            let stage = context.stage(self.frame_group);
            maps.encode_instant(stage, encoder, environment, light, first, moved);
        }
    }
}

/// Draws the maps of what stands still, once for every way in which it is placed.
///
/// # Errors
/// The device may fail.
pub fn draw_still_maps(context: &mut Context) -> Result<(), EngineError> {
    let Some(maps) = context.shadows.take() else { return Ok(()) };
    if maps.keeps() {
        // One view per placement, at the start, is enough to place every caster.
        let mut views: Vec<View> = Vec::new();
        for view in &context.views {
            if maps.plan.placements[view.environment] as usize == views.len() {
                views.push(view.clone());
            }
        }
        let request = FrameRequest {
            views: &views,
            times_s: &[context.scene_time_s(0)],
            shadows: Some(&maps.plan),
            occluders: maps.occluders.as_ref(),
            record_ids: false,
            shadow_maps: true,
            watch: None,
            trail: false,
        };
        context.frame_data.build(&context.scene, &context.gpu_scene, &request);
        let group = context.frame_buffers.upload(
            &context.gpu,
            &context.layouts,
            &context.gpu_scene.morph_data,
            &context.frame_data,
        );
        let mut encoder = Commands::new(&context.gpu, "still shadow maps");
        let objects = context.gpu_scene.objects.len();
        maps.encode_kept(context.stage(&group), &mut encoder, |map| {
            FrameData::shadow_record(views.len(), objects, map)
        });
        encoder.submit(&context.gpu);
        // So that this counts as preparation, and not as the first instant's work.
        context.gpu.device.poll(wgpu::PollType::wait_indefinitely())?;
    }
    context.shadows = Some(maps);
    Ok(())
}
