//! Parts of pictures in which triangles are so small that decoupled sampling leaves them to rendering.

use evis_core::{CameraInfo, SensorConfig};
use evis_scene::Scene;

use crate::config::RunConfig;
use crate::error::EngineError;
use crate::world::tiles::{TILE, tile_count};
use crate::world::view::View;

/// Tiles of a picture beyond which all of it is rendered: the rest is not worth a second engine.
const MOST: f64 = 0.9;

/// Where triangles are too small to be followed one by one.
#[derive(Debug)]
pub enum Crowds {
    /// Nowhere.
    None,
    /// In tiles.
    Tiles(CrowdedViews),
    /// In nearly all of a picture, or somewhere where tiles cannot be rendered alone: all pictures are. How many triangles.
    Whole(usize),
}

/// Tiles that are rendered.
#[derive(Debug)]
pub struct CrowdedViews {
    /// Per view, its tiles of [`TILE`] pixels, row by row.
    pub tiles: Vec<Vec<bool>>,
    /// Triangles smaller than a pixel in them, of the camera that sees most.
    pub small: usize,
    /// Part of all tiles.
    pub share: f64,
}

impl Crowds {
    /// Those of `views` of `cameras`, as `config` shows `scene`: tiles that have more than `per_pixel` small triangles for each
    /// pixel, at some time. Tiles are rendered alone where the scene says how everything moves and pixels do not depend on each
    /// other: not where a host gives poses, environments differ or a lens is distorted, and not for sensors with a readout bus
    /// or with stages that are defined on frames.
    ///
    /// # Errors
    /// Cameras that cannot be used.
    pub fn of(
        scene: &Scene,
        views: &[View],
        cameras: &[CameraInfo],
        (config, per_pixel): (&RunConfig, f64),
    ) -> Result<Self, EngineError> {
        let by_tiles = scene.host_poses.is_none()
            && scene.variants.is_empty()
            && views.iter().all(|view| view.distorted.is_none() && is_local(&view.sensor));
        if !by_tiles {
            for camera in cameras {
                let camera = scene.camera(&camera.name)?;
                if let Some(small) = evis_decoupled::crowded(scene, camera, config.size)? {
                    return Ok(Self::Whole(small));
                }
            }
            return Ok(Self::None);
        }
        let (mut tiles, mut small) = (Vec::new(), 0);
        for view in views {
            let camera = scene.camera(&cameras[view.camera].name)?;
            let none = || vec![false; tile_count(view.size())];
            let which = (TILE, per_pixel);
            let found = evis_decoupled::crowded_tiles(scene, camera, config.size, config.start_us, which)?;
            small = small.max(found.as_ref().map_or(0, |found| found.small));
            tiles.push(found.map_or_else(none, |found| found.tiles));
        }
        if small == 0 {
            return Ok(Self::None);
        }
        let all = tiles.iter().flatten();
        let share = all.clone().filter(|tile| **tile).count() as f64 / all.count().max(1) as f64;
        Ok(if share > MOST { Self::Whole(small) } else { Self::Tiles(CrowdedViews { tiles, small, share }) })
    }
}

/// Whether each of its pixels fires by itself, whatever the others do.
fn is_local(sensor: &SensorConfig) -> bool {
    !sensor.readout.has_bus() && sensor.needs_frames().is_none() && !sensor.walks_on_host()
}
