//! A scene at any time, ready for rays; what never moves is prepared once.

use std::sync::{Arc, OnceLock};

use evis_scene::{
    CalibratedLens, LensModel, Motion, PixelLens, Scene, SceneError, SceneState, rigid, rigid_or_unrotated,
};
use glam::DVec3;

use crate::rays::{
    Geometry, Matter, Options, Pinhole, RayCaster, SceneCamera, SplitSum, TextureFilter, Textures,
};
use crate::settings::TruthSettings;

/// Rays as the oracle casts them: textures are their base level, shadows are sharp.
const OPTIONS: Options =
    Options { filter: TextureFilter::BaseLevel, shadows: true, split_sum: SplitSum::Tabulated };

/// A scene over time, seen by one camera.
pub struct Clock<'a> {
    scene: &'a Scene,
    textures: &'a Textures,
    matter: Arc<Matter>,
    /// Per node, see [`moving_nodes`].
    moves: Vec<bool>,
    camera: usize,
    pinhole: Pinhole,
    lens: Option<CalibratedLens>,
    start_us: i64,
    /// Times at which every pixel is sampled, in order, each prepared when it is first needed.
    shared: Vec<(i64, OnceLock<Arc<Moment<'a>>>)>,
}

/// A scene at one time.
pub struct Moment<'a> {
    /// Casts rays.
    pub caster: RayCaster<'a>,
    /// Where the camera is.
    pub camera: SceneCamera,
}

impl<'a> Clock<'a> {
    /// `scene` as its camera number `camera` sees it.
    ///
    /// # Errors
    /// A camera without a usable lens.
    pub fn new(
        scene: &'a Scene,
        textures: &'a Textures,
        camera: usize,
        settings: &TruthSettings,
    ) -> Result<Self, SceneError> {
        let mut state = SceneState::default();
        scene.evaluate_variant(scene.variants.first(), settings.start_us as f64 * 1e-6, &mut state);
        let moves = moving_nodes(scene);
        let matter = Arc::new(Matter::new(scene, &state, |node| moves[node]));
        let pinhole = pinhole(scene, camera, settings)?;
        let lens = distorted_lens(scene, camera, &pinhole)?;
        let start_us = settings.start_us;
        Ok(Self { scene, textures, matter, moves, camera, pinhole, lens, start_us, shared: Vec::new() })
    }

    /// From now on, the scene at `times`, which ascend, is prepared once and kept.
    pub fn share(&mut self, times: impl Iterator<Item = i64>) {
        self.shared = times.map(|t_us| (t_us, OnceLock::new())).collect();
    }

    /// The camera's picture and lens, posed as at the start.
    pub fn pinhole(&self) -> &Pinhole {
        &self.pinhole
    }

    /// The scene `t_us` microseconds after the stream's start.
    pub fn at(&self, t_us: f64) -> Arc<Moment<'a>> {
        let whole = t_us as i64;
        if whole as f64 == t_us
            && let Ok(slot) = self.shared.binary_search_by_key(&whole, |shared| shared.0)
        {
            return self.shared[slot].1.get_or_init(|| Arc::new(self.prepare(t_us))).clone();
        }
        Arc::new(self.prepare(t_us))
    }

    fn prepare(&self, t_us: f64) -> Moment<'a> {
        let mut state = SceneState::default();
        let t_s = (self.start_us as f64 + t_us) * 1e-6;
        self.scene.evaluate_variant(self.scene.variants.first(), t_s, &mut state);
        let geometry = Geometry::at(&self.matter, self.scene, &state);
        let node = self.scene.cameras[self.camera].node;
        let world_from_camera =
            state.world_from_node.get(node).map_or(self.pinhole.world_from_camera, rigid_or_unrotated);
        Moment {
            caster: RayCaster::with_geometry(self.scene, &state, self.textures, OPTIONS, geometry),
            camera: SceneCamera { pinhole: Pinhole { world_from_camera, ..self.pinhole }, lens: self.lens },
        }
    }

    /// Times within the stream's first `duration_us` microseconds, from its start and ascending, at which motion or light bends
    /// or jumps. At a jump everything is still as it was.
    pub fn break_times(&self, duration_us: i64) -> Vec<f64> {
        let start_us = self.start_us as f64;
        let first = self.scene.variants.first();
        let times = self.scene.break_times(first, start_us - 0.5, start_us + duration_us as f64);
        times.into_iter().map(|t_us| t_us - start_us).collect()
    }

    /// Whether any light moves.
    pub fn lights_move(&self) -> bool {
        self.scene.nodes.iter().zip(&self.moves).any(|(node, moves)| node.light.is_some() && *moves)
    }

    /// Whether the camera, every light and every material stay as they are at the start.
    pub fn only_objects_change(&self) -> bool {
        let node = self.scene.cameras[self.camera].node;
        !self.moves[node]
            && !self.lights_move()
            && self.scene.lights.iter().all(|l| l.waveform.is_none())
            && self.scene.materials.iter().all(|m| m.emission_waveform.is_none() && !m.driven)
            && self.scene.host_poses.as_ref().is_none_or(|host| host.lights().is_empty())
    }

    /// Shortest period of any light or material, in microseconds.
    pub fn shortest_period_us(&self) -> Option<f64> {
        let lights = self.scene.lights.iter().filter_map(|l| l.waveform);
        let materials = self.scene.materials.iter().filter_map(|m| m.emission_waveform);
        lights
            .chain(materials)
            .map(|w| 1e6 / w.frequency_hz)
            .filter(|p| p.is_finite() && *p > 0.0)
            .reduce(f64::min)
    }
}

impl Moment<'_> {
    /// Boxes of what is not still, each grown by `part` of its size.
    pub fn moving_boxes(&self, part: f64) -> Vec<(DVec3, DVec3)> {
        let grown = |(low, high): (DVec3, DVec3)| {
            let margin = (high - low) * part + 1e-6;
            (low - margin, high + margin)
        };
        self.caster.geometry().moving_boxes().map(grown).collect()
    }
}

/// Per node: whether it may be elsewhere, or shaped otherwise, at another time.
fn moving_nodes(scene: &Scene) -> Vec<bool> {
    let mut moves: Vec<bool> = Vec::with_capacity(scene.nodes.len());
    for node in &scene.nodes {
        let own = !matches!(node.motion, Motion::Fixed(_)) || node.morph.is_some();
        let inherited = node.parent.and_then(|p| moves.get(p)).copied().unwrap_or(false);
        moves.push(own || inherited);
    }
    for (index, node) in scene.nodes.iter().enumerate() {
        let skin = node.skin.and_then(|s| scene.skins.get(s));
        if skin.is_some_and(|s| s.joints.iter().any(|j| moves.get(*j).copied().unwrap_or(false))) {
            moves[index] = true;
        }
    }
    moves
}

/// Lens of camera `camera` in pixels, at the size that `settings`, the camera or the defaults say.
fn pinhole(scene: &Scene, camera: usize, settings: &TruthSettings) -> Result<Pinhole, SceneError> {
    let (variant, start_us) = (scene.variants.first(), settings.start_us as f64);
    let lens = scene.pixel_lens(variant, camera, settings.size, start_us)?;
    let mut state = SceneState::default();
    scene.evaluate_variant(variant, start_us * 1e-6, &mut state);
    let camera = &scene.cameras[camera];
    let Some(world_from_camera) = state.world_from_node.get(camera.node).and_then(rigid) else {
        return Err(SceneError::Rule(format!("camera '{}' has no usable pose", camera.name)));
    };
    Ok(Pinhole { world_from_camera, lens })
}

/// The lens of camera `camera`, where it is distorted.
fn distorted_lens(
    scene: &Scene,
    camera: usize,
    pinhole: &Pinhole,
) -> Result<Option<CalibratedLens>, SceneError> {
    let name = &scene.cameras[camera].name;
    if !scene.distortions.contains_key(name) {
        return Ok(None);
    }
    let PixelLens { width, height, .. } = pinhole.lens;
    let lens = scene.calibrated_lens_in(scene.variants.first(), camera, width, height)?;
    for (x, y) in (0..=height).flat_map(|y| (0..=width).map(move |x| (x, y))) {
        if lens.planar_ray([x.into(), y.into()].into()).is_none() {
            return Err(SceneError::Rule(format!(
                "camera '{name}': its lens sees nothing at pixel ({x}, {y}), or behind its own plane; truth takes a lens \
                 that covers the picture, below 180 degrees: choose a smaller picture or a longer focal length"
            )));
        }
    }
    Ok(Some(lens))
}
