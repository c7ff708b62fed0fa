//! Shadow maps on the device: what stands still is drawn once and kept, what moves is drawn on top.

use std::sync::{Mutex, PoisonError};

use evis_core::ConfigError;
use evis_scene::Scene;

use crate::config::{RunConfig, Shadows};
use crate::frame::draw::{Drawing, Stage, depth_attachment, draw_surfaces};
use crate::gpu::commands::{Commands, Render};
use crate::gpu::texture::DEPTH_FORMAT;
use crate::gpu::variant::LightSet;
use crate::pass::raster::{Pipelines, SceneConstants, SurfaceLayouts};
use crate::pass::{self, shadow_map};
use crate::shadow::bvh::Occluders;
use crate::shadow::plan::{ShadowPlan, scene_bounds};
use crate::world::gpu_scene::{DrawItem, GpuScene};
use crate::world::image_bounds::Rect;

/// Shadow maps on the device.
///
/// What stands still is drawn once into maps that are kept; at each instant these are restored where something moved, and only
/// what moves is drawn on top. Where a light moves, everything is drawn.
pub struct ShadowMaps {
    /// What is drawn, and when.
    pub plan: ShadowPlan,
    /// What rays are cast through along shadows' borders; `None` where the maps decide alone.
    pub occluders: Option<Occluders>,
    /// All layers: by placement where nothing is redrawn, then by light.
    pub array: wgpu::TextureView,
    texture: wgpu::Texture,
    layers: Vec<wgpu::TextureView>,
    /// Maps of what stands still, by placement, then by light; absent where `array` has them, or nothing has room for them.
    still: Option<StillMaps>,
    /// Per light: what its map shows.
    shown: Mutex<Vec<Shown>>,
    pipelines: Pipelines,
    still_items: Vec<DrawItem>,
    moving_items: Vec<DrawItem>,
    all_items: Vec<DrawItem>,
}

struct StillMaps {
    texture: wgpu::Texture,
    layers: Vec<wgpu::TextureView>,
    restore: wgpu::RenderPipeline,
    group: wgpu::BindGroup,
}

/// What a map shows that is restored from another.
#[derive(Clone, Debug, Default)]
struct Shown {
    /// Layer of what stands still in it.
    still: Option<u32>,
    /// Where something else was drawn.
    drawn: Vec<Rect>,
}

impl StillMaps {
    /// Copies layer `from` of them whole into layer `to` of `maps`.
    fn copy(&self, encoder: &mut Commands, from: u32, maps: &wgpu::Texture, to: u32) {
        let at = |texture, z| wgpu::TexelCopyTextureInfo {
            texture,
            mip_level: 0,
            origin: wgpu::Origin3d { x: 0, y: 0, z },
            aspect: wgpu::TextureAspect::All,
        };
        let size = wgpu::Extent3d { depth_or_array_layers: 1, ..maps.size() };
        encoder.copy_texture_to_texture(at(&self.texture, from), at(maps, to), size);
    }
}

impl ShadowMaps {
    /// `None` where no light throws shadows.
    ///
    /// # Errors
    /// Shadows by rays of what deforms or has holes.
    pub fn new(
        device: &wgpu::Device,
        layouts: &SurfaceLayouts,
        scene: &Scene,
        gpu_scene: &GpuScene,
        config: &RunConfig,
    ) -> Result<Option<Self>, ConfigError> {
        let plan = scene_bounds(scene)
            .and_then(|bounds| ShadowPlan::new(scene, &gpu_scene.objects, bounds, config, &device.limits()));
        let Some(plan) = plan else { return Ok(None) };
        let occluders = match config.shadows.unwrap_or_default() {
            Shadows::Maps => None,
            Shadows::Rays => Some(Occluders::new(scene, gpu_scene, &plan, config.start_us)?),
        };
        let lights = plan.nodes.len() as u32;
        let count = plan.kept.filter(|_| !plan.redrawn).unwrap_or(lights);
        let texture = map_texture(device, plan.edge, count);
        let still = plan.kept.filter(|_| plan.redrawn).map(|kept| {
            let texture = map_texture(device, plan.edge, kept);
            let (restore, layout) = shadow_map::restore(device);
            let array = array_view(&texture);
            let maps = vec![wgpu::BindingResource::TextureView(&array)];
            let group = pass::group(device, "still maps", &layout, shadow_map::RESTORE_BINDINGS, maps);
            StillMaps { layers: layer_views(&texture, kept), texture, restore, group }
        });
        let constants = SceneConstants {
            lights: LightSet::new(scene, |node| plan.layer_of(node)),
            shadows: false,
            shadow_rays: occluders.is_some(),
            environment: false,
            texture_samples: 1,
            grid: 1,
            texture_taps: 1,
        };
        let pipelines = shadow_map::pipelines(device, layouts, gpu_scene.variants().into_iter(), &constants);
        Ok(Some(Self {
            plan,
            occluders,
            array: array_view(&texture),
            layers: layer_views(&texture, count),
            texture,
            shown: Mutex::new(vec![Shown::default(); lights as usize]),
            still,
            pipelines,
            still_items: gpu_scene.items(|o| !o.moving),
            moving_items: gpu_scene.items(|o| o.moving),
            all_items: gpu_scene.items(|_| true),
        }))
    }

    /// A map for scenes without shadows: a binding may not be empty.
    pub fn empty(device: &wgpu::Device) -> wgpu::TextureView {
        array_view(&map_texture(device, 1, 1))
    }

    /// Draws every map whole from now on: what a test compares with.
    #[cfg(test)]
    pub fn keep_nothing(&mut self) {
        self.still = None;
    }

    /// Makes the map of `light` in `environment` for one instant, whose records start at `first`; what moves changes `moved`
    /// of it. Maps are shared by all instants and environments: what reads them is recorded before the next call.
    pub fn encode_instant(
        &self,
        stage: Stage<'_>,
        encoder: &mut Commands,
        environment: usize,
        light: usize,
        first: u32,
        moved: &[Rect],
    ) {
        let target = &self.layers[light];
        match &self.still {
            Some(still) if !self.plan.light_moves()[light] => {
                let layer = self.plan.placements[environment] * self.plan.nodes.len() as u32 + light as u32;
                let now = Shown { still: Some(layer), drawn: moved.to_vec() };
                let mut shown = self.shown.lock().unwrap_or_else(PoisonError::into_inner);
                let before = std::mem::replace(&mut shown[light], now);
                let edge = self.plan.edge;
                let whole = Rect::whole(edge, edge);
                let mut stale = before.drawn;
                if before.still != Some(layer) || stale.contains(&whole) {
                    still.copy(encoder, layer, &self.texture, light as u32);
                    stale.clear();
                }
                let mut pass = begin(encoder, target, wgpu::LoadOp::Load);
                pass.set_pipeline(&still.restore);
                pass.set_bind_group(0, &still.group, &[]);
                for rect in &stale {
                    let [width, height] = rect.size();
                    pass.set_scissor_rect(rect.low[0], rect.low[1], width, height);
                    pass.draw(0..3, layer..layer + 1);
                }
                pass.set_scissor_rect(0, 0, edge, edge);
                self.draw(stage, &mut pass, &self.moving_items, first);
            }
            _ => {
                let mut pass = begin(encoder, target, wgpu::LoadOp::Clear(0.0));
                self.draw(stage, &mut pass, &self.all_items, first);
            }
        }
    }

    /// The maps of what stands still, which are drawn once: by placement, then by light.
    fn kept(&self) -> &[wgpu::TextureView] {
        match &self.still {
            Some(still) => &still.layers,
            None if !self.plan.redrawn => &self.layers,
            None => &[],
        }
    }

    /// Whether anything that stands still has a map that is kept.
    pub fn keeps(&self) -> bool {
        !self.kept().is_empty()
    }

    /// Draws what stands still into the maps that are kept, once for every way in which it is placed: map `map` from the
    /// records that start at `first(map)`.
    pub fn encode_kept(&self, stage: Stage<'_>, encoder: &mut Commands, first: impl Fn(usize) -> u32) {
        for (map, target) in self.kept().iter().enumerate() {
            let mut pass = begin(encoder, target, wgpu::LoadOp::Clear(0.0));
            self.draw(stage, &mut pass, &self.still_items, first(map));
        }
        // Most runs have one placement, and need no other copy.
        if let Some(still) = &self.still {
            let lights = 0..self.plan.nodes.len() as u32;
            lights.clone().for_each(|light| still.copy(encoder, light, &self.texture, light));
            *self.shown.lock().unwrap_or_else(PoisonError::into_inner) =
                lights.map(|light| Shown { still: Some(light), drawn: Vec::new() }).collect();
        }
    }

    fn draw(&self, stage: Stage<'_>, pass: &mut wgpu::RenderPass<'_>, items: &[DrawItem], first: u32) {
        let what = Drawing { items, frame: 0, sample: None, first_record: first };
        draw_surfaces(stage, pass, &self.pipelines, None, &what);
    }
}

fn begin<'e>(encoder: &'e mut Commands, target: &wgpu::TextureView, load: wgpu::LoadOp<f32>) -> Render<'e> {
    let mut attachment = depth_attachment(target, wgpu::StoreOp::Store);
    attachment.depth_ops = Some(wgpu::Operations { load, store: wgpu::StoreOp::Store });
    encoder.render("shadow map", &[], attachment)
}

fn layer_views(texture: &wgpu::Texture, count: u32) -> Vec<wgpu::TextureView> {
    (0..count)
        .map(|layer| {
            texture.create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(wgpu::TextureViewDimension::D2),
                base_array_layer: layer,
                array_layer_count: Some(1),
                ..Default::default()
            })
        })
        .collect()
}

fn map_texture(device: &wgpu::Device, edge: u32, layers: u32) -> wgpu::Texture {
    device.create_texture(&wgpu::TextureDescriptor {
        label: Some("shadow maps"),
        size: wgpu::Extent3d { width: edge, height: edge, depth_or_array_layers: layers },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: DEPTH_FORMAT,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT
            | wgpu::TextureUsages::TEXTURE_BINDING
            | wgpu::TextureUsages::COPY_SRC
            | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    })
}

fn array_view(texture: &wgpu::Texture) -> wgpu::TextureView {
    texture.create_view(&wgpu::TextureViewDescriptor {
        dimension: Some(wgpu::TextureViewDimension::D2Array),
        ..Default::default()
    })
}
