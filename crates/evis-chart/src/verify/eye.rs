//! The oracle's eye at one instant: what reports need of rays beyond truths.

use evis_core::CameraInfo;
use evis_scene::{PixelLens, Scene, SceneState};
use evis_truth::rays::{Options, Pinhole, RayCaster, SplitSum, TextureFilter, Textures};

use crate::error::ChartError;

/// As the oracle sees: textures' base level, shadows by rays.
const OPTIONS: Options =
    Options { filter: TextureFilter::BaseLevel, shadows: true, split_sum: SplitSum::Tabulated };

/// Rays from one camera at one instant.
pub(super) struct Eye<'a> {
    pub caster: RayCaster<'a>,
    pub pinhole: Pinhole,
}

impl<'a> Eye<'a> {
    /// `camera` of `scene` at `t_us` of the scene's time; `textures` are those of `scene`.
    pub(super) fn new(
        scene: &'a Scene,
        textures: &'a Textures,
        camera: &CameraInfo,
        t_us: f64,
    ) -> Result<Self, ChartError> {
        let index = scene.camera(&camera.name)?;
        let mut state = SceneState::default();
        scene.evaluate(t_us * 1e-6, &mut state);
        let pose = scene.world_from_camera(index, &state);
        let (Some(world_from_camera), Some(own)) = (pose, scene.cameras.get(index)) else {
            return Err(ChartError::Truth(format!("camera '{}' has no usable pose", camera.name)));
        };
        let own = PixelLens::new(own, Some((camera.width, camera.height)));
        let lens = if own.is_parallel() {
            // Recordings have no intrinsics of it.
            own
        } else {
            PixelLens { focal: [camera.fx, camera.fy], center: [camera.cx, camera.cy], ..own }
        };
        let pinhole = Pinhole { world_from_camera, lens };
        Ok(Self { caster: RayCaster::new(scene, &state, textures, OPTIONS), pinhole })
    }

    /// Luminance at an offset in pixels from the middle of pixel (x, y).
    pub(super) fn luminance(&self, [x, y]: [u16; 2], [u, v]: [f64; 2]) -> f64 {
        self.caster.look(&self.pinhole, [f64::from(x) + 0.5 + u, f64::from(y) + 0.5 + v]).0
    }
}
