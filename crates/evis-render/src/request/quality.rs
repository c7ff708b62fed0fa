//! Quality presets: fixed settings of sampling, the same for every scene. Nothing is rendered to choose them; what is looked at
//! is whether the method can show the scene, and whether its triangles are far smaller than pixels.

use evis_scene::{AlphaMode, Scene};

use crate::config::{Antialias, Interpolation, Method, Quality, RenderedTiles, RunConfig, Shadows};
use crate::error::EngineError;
use crate::gpu::Gpu;
use crate::world::crowds::Crowds;
use crate::world::view::{self, View};

/// Bytes that a picture of coverage samples may take, 8 for each: 1920x1080 pixels have 100 of them then.
const COVERAGE_BYTES: u64 = 2 << 30;

/// What presets take shadow rays for, at most: trees of so many triangles take 2.5 s and 72 MB (22 November 2026, two cores).
const MOST_TRIANGLES: usize = 1 << 20;

const MOST_MOVING: usize = 64;

impl Quality {
    /// Its settings.
    pub const fn sampling(self) -> SamplingSettings {
        match self {
            Self::Draft => SamplingSettings {
                decoupled: Some(DecoupledSettings { step_px: 2.0, crowded: 1.0, beside_gpu: false }),
                ..SamplingSettings::coverage(1.0, 16, 2)
            },
            Self::Standard => SamplingSettings {
                decoupled: Some(DecoupledSettings { step_px: 1.0, crowded: 1.0, beside_gpu: false }),
                ..SamplingSettings::coverage(0.5, 16, 4)
            },
            Self::High => SamplingSettings {
                decoupled: Some(DecoupledSettings { step_px: 0.5, crowded: 8.0, beside_gpu: true }),
                fixed_rate_hz: 2000.0,
                ..SamplingSettings::with_rays(0.3, 144)
            },
            Self::Reference => SamplingSettings {
                rate_hz: 8000.0,
                fixed_rate_hz: 4000.0,
                ..SamplingSettings::with_rays(0.15, 256)
            },
        }
    }

    /// F1 within 1 ms that it reached by `method`, and where: measured, not promised.
    pub const fn measured(self, method: &Method) -> &'static str {
        match (self, method) {
            (Self::Draft, Method::Decoupled) => {
                "F1 (1 ms) 0.96 to 0.99 on the built-in scenes at 640x480, ideal sensor"
            }
            (_, Method::Decoupled) => {
                "F1 (1 ms) 0.98 to 0.99 on the built-in scenes at 640x480, ideal sensor"
            }
            (Self::Draft, _) => "F1 (1 ms) 0.77 to 0.97 on the built-in scenes at 640x480, ideal sensor",
            (Self::Standard, _) => "F1 (1 ms) 0.88 to 0.98 on the built-in scenes at 640x480, ideal sensor",
            (Self::High, _) => "F1 (1 ms) 0.98 to 0.99 on the built-in scenes at 640x480, ideal sensor",
            (Self::Reference, _) => "F1 (1 ms) above 0.98 on the built-in scenes at 640x480, ideal sensor",
        }
    }
}

/// How pixels are sampled in space and time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SamplingSettings {
    /// Pixels that anything may move between two samples of it; `None` samples everything at the rate.
    pub step_px: Option<f64>,
    /// The finest rate.
    pub rate_hz: f64,
    /// The rate at which everything is sampled where tiles cannot have rates of their own: with distorted lenses.
    pub fixed_rate_hz: f64,
    /// What a sample is.
    pub antialias: Antialias,
    /// Samples per pixel.
    pub samples: u32,
    /// Places at which each reads a texture, along each side.
    pub texture_taps: u32,
    /// Whether shadow borders are found by rays, where the user leaves that open and the scene allows it.
    pub rays: bool,
    /// Where [`Method::Decoupled`] takes the place of all that, if scene and sensors allow it.
    pub decoupled: Option<DecoupledSettings>,
}

/// Decoupled sampling of a preset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DecoupledSettings {
    /// [`RunConfig::adaptive_px`].
    pub step_px: f64,
    /// [`RenderedTiles::triangles_per_pixel`]: beyond it rendering is cheaper.
    pub crowded: f64,
    /// It takes the place of rendering on a graphics card, too, not only of a software driver.
    pub beside_gpu: bool,
}

impl SamplingSettings {
    /// Coverage samples, one in four shaded.
    pub const fn coverage(step_px: f64, samples: u32, texture_taps: u32) -> Self {
        Self {
            step_px: Some(step_px),
            rate_hz: 4000.0,
            fixed_rate_hz: 1000.0,
            antialias: Antialias::Edges,
            samples,
            texture_taps,
            rays: false,
            decoupled: None,
        }
    }

    /// With shadows as sharp as what throws them.
    pub const fn with_rays(step_px: f64, samples: u32) -> Self {
        Self { rays: true, ..Self::coverage(step_px, samples, 4) }
    }

    /// Those of [`Quality::High`], with intervals of decoupled sampling that are so long.
    pub const fn decoupled(step_px: f64) -> Self {
        Self {
            decoupled: Some(DecoupledSettings { step_px, crowded: 8.0, beside_gpu: true }),
            ..Quality::High.sampling()
        }
    }

    /// The same, by rendering.
    pub const fn rendered(self) -> Self {
        Self { decoupled: None, ..self }
    }

    /// Sets them in `config`, as far as `scene` and device allow. Returns what differs and why, for the user.
    ///
    /// # Errors
    /// Cameras that do not exist or cannot be used.
    pub fn apply(
        &self,
        gpu: Option<&Gpu>,
        scene: &Scene,
        config: &mut RunConfig,
    ) -> Result<Vec<String>, EngineError> {
        let (views, cameras) = view::views(scene, config)?;
        let mut notes = Vec::new();
        config.method = Method::Native;
        config.rendered_tiles = None;
        let software = gpu.is_none_or(|gpu| gpu.summary().kind == "cpu");
        let decoupled = self.decoupled.filter(|decoupled| software || decoupled.beside_gpu);
        if decoupled.is_some() || gpu.is_none() {
            match evis_decoupled::unsupported(scene) {
                None => {
                    let crowds = match (gpu, decoupled) {
                        (Some(_), Some(own)) => Crowds::of(scene, &views, &cameras, (config, own.crowded))?,
                        _ => Crowds::None,
                    };
                    config.method = Method::Decoupled;
                    match crowds {
                        Crowds::None => {}
                        Crowds::Tiles(found) => {
                            config.rendered_tiles = decoupled.zip(self.step_px).map(|(own, step_px)| {
                                RenderedTiles { triangles_per_pixel: own.crowded, step_px }
                            });
                            notes.push(format!(
                                "{:.0} % of the picture by rendering: decoupled sampling would follow {} triangles \
                                 smaller than a pixel there one by one, as the method decoupled still does",
                                (100.0 * found.share).ceil(),
                                found.small
                            ));
                        }
                        Crowds::Whole(small) => {
                            config.method = Method::Native;
                            notes.push(format!(
                                "sampled by rendering: decoupled sampling would follow {small} triangles smaller than a \
                                 pixel one by one, as the method decoupled still does"
                            ));
                        }
                    }
                    if decoupled.is_none() {
                        notes
                            .push("decoupled sampling on the CPU, since there is no device to render".into());
                    }
                }
                // What renders on graphics cards anyway says nothing.
                Some(_) if decoupled.is_some_and(|decoupled| !decoupled.beside_gpu) => {}
                Some(limit) => notes.push(format!("sampled by rendering: decoupled sampling has no {limit}")),
            }
        }
        config.rate_hz = self.rate_hz;
        config.antialias = self.antialias;
        config.samples = self.samples;
        config.texture_taps = Some(self.texture_taps);
        let step_px = self.step_px.filter(|_| config.method == Method::Native);
        let own = decoupled.filter(|_| config.method == Method::Decoupled);
        config.adaptive_px = step_px.or(own.map(|own| own.step_px));
        config.between = if step_px.is_some() { Interpolation::Curve } else { Interpolation::Line };
        let framed = views.iter().find_map(|view| view.sensor.needs_frames());
        if config.method == Method::Decoupled
            && let Some(stage) = framed
        {
            notes.push(format!(
                "the sensor takes {} frames per second, since its `{stage}` is defined on frames",
                self.rate_hz
            ));
        }
        if config.method == Method::Native && views.iter().any(|view| view.distorted.is_some()) {
            (config.adaptive_px, config.between) = (None, Interpolation::Line);
            config.rate_hz = self.fixed_rate_hz;
            notes.push(format!(
                "every pixel is sampled {} times per second: a camera has a distorted lens",
                self.fixed_rate_hz
            ));
        } else if config.method == Method::Native
            && !views.is_empty()
            && views.iter().all(|view| view.sensor.walks_on_host())
        {
            (config.adaptive_px, config.between) = (None, Interpolation::Line);
            notes.push(format!(
                "every pixel is sampled {} times per second: the sensor model runs on the host and takes every instant",
                self.rate_hz
            ));
        }
        let edge = gpu.map_or(u32::MAX, |gpu| gpu.device.limits().max_texture_dimension_2d);
        let grid = largest_grid(&views, edge);
        if config.antialias == Antialias::Edges && config.coverage_grid() > grid {
            config.samples = 4 * grid * grid;
            notes.push(format!(
                "{} samples per pixel instead of {}: larger pictures of them do not fit",
                config.samples, self.samples
            ));
        }
        if config.shadows.is_none() {
            let limit = if self.rays { ray_shadow_limit(scene) } else { None };
            let rays = self.rays && limit.is_none();
            config.shadows = Some(if rays { Shadows::Rays } else { Shadows::Maps });
            notes.extend(limit.map(|limit| format!("shadows by maps instead of rays: {limit}")));
        }
        Ok(notes)
    }
}

/// Sets the sampling of the preset that `config` names, if it names one.
///
/// # Errors
/// As [`SamplingSettings::apply`].
pub fn settle<'a>(
    gpu: impl Into<Option<&'a Gpu>>,
    scene: &Scene,
    config: &mut RunConfig,
) -> Result<(), EngineError> {
    if let Some(quality) = config.quality {
        quality.sampling().apply(gpu.into(), scene, config)?;
    }
    Ok(())
}

/// The finest grid of [`Antialias::Edges`] whose pictures fit.
fn largest_grid(views: &[View], texture_edge: u32) -> u32 {
    let fits = |view: &View| {
        // Of a distorted lens, this is the picture that is rendered.
        let (width, height) = (view.lens.width, view.lens.height);
        let by_bytes = COVERAGE_BYTES / (4 * 8 * u64::from(width) * u64::from(height)).max(1);
        (texture_edge / width.max(height)).min(by_bytes.isqrt() as u32)
    };
    views.iter().map(fits).min().unwrap_or(1).max(1)
}

/// Why presets leave shadows to maps; `None` where rays hold all casters, and those are few enough.
fn ray_shadow_limit(scene: &Scene) -> Option<String> {
    let (mut moving, mut triangles) = (0, 0);
    for (index, node) in scene.nodes.iter().enumerate() {
        let Some(mesh) = node.mesh else { continue };
        for primitive in &scene.meshes[mesh].primitives {
            triangles += primitive.indices.len() / 3;
            let deforms = node.skin.is_some() || !primitive.morph_targets.is_empty();
            let masked = scene.materials[primitive.material].alpha != AlphaMode::Opaque;
            if deforms || masked {
                let why = if deforms { "it deforms" } else { "its material has holes" };
                return Some(format!("{:?}: {why}", node.name));
            }
        }
        moving += usize::from(crate::world::gpu_scene::moves(scene, index));
    }
    (moving > MOST_MOVING)
        .then(|| format!("{moving} objects move"))
        .or_else(|| (triangles > MOST_TRIANGLES).then(|| format!("there are {triangles} triangles")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_settings_that_can_run_and_cost_more_from_one_to_the_next() {
        let mut last = 0.0;
        for quality in Quality::ALL {
            let sampling = quality.sampling();
            let work = f64::from(sampling.samples) / sampling.step_px.unwrap();
            assert!(work > last, "{quality:?}");
            last = work;
            let config = RunConfig {
                adaptive_px: sampling.step_px,
                between: Interpolation::Curve,
                rate_hz: sampling.rate_hz,
                antialias: sampling.antialias,
                samples: sampling.samples,
                texture_taps: Some(sampling.texture_taps),
                ..RunConfig::default()
            };
            config.check().unwrap();
        }
    }

    #[test]
    fn rays_are_left_where_casters_deform_or_have_holes() {
        let rigid = evis_scene::builtin::load("desk", 0).unwrap();
        assert_eq!(ray_shadow_limit(&rigid), None);
        let mut masked = rigid.clone();
        masked.materials[0].alpha = AlphaMode::Mask(0.5);
        assert!(ray_shadow_limit(&masked).unwrap().contains("holes"));
        let mut skinned = rigid;
        let node = skinned.nodes.iter().position(|node| node.mesh.is_some()).unwrap();
        skinned.nodes[node].skin = Some(0);
        assert!(ray_shadow_limit(&skinned).unwrap().contains("deforms"));
    }
}
