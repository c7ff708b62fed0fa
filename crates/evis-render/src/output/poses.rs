//! Poses of cameras, at the label rate.

use evis_core::{PoseSample, TimeGrid};
use evis_scene::{Scene, SceneState};

use crate::world::transform::rigid;
use crate::world::view::View;

/// Where each view's camera is at every label instant, in order.
pub struct CameraPoses {
    grid: TimeGrid,
    next: i64,
    start_us: i64,
    state: SceneState,
}

impl CameraPoses {
    /// From the begin of a stream that starts at `start_us` of scene time.
    pub fn new(grid: TimeGrid, start_us: i64) -> Self {
        Self { grid, next: 0, start_us, state: SceneState::default() }
    }

    /// The next instants before `until_us` of stream time: hands on each view's poses.
    pub fn take(
        &mut self,
        scene: &Scene,
        views: &[View],
        until_us: i64,
        mut each: impl FnMut(usize, PoseSample),
    ) {
        let mut t_us = self.grid.instant_us(self.next);
        while t_us < until_us {
            let time_s = (self.start_us + t_us) as f64 * 1e-6;
            let mut environment = usize::MAX;
            for (index, view) in views.iter().enumerate() {
                if view.environment != environment {
                    environment = view.environment;
                    scene.evaluate_variant(scene.variants.get(environment), time_s, &mut self.state);
                }
                let world = rigid(&self.state.world_from_node[view.node]);
                let (_, rotation, position) = world.to_scale_rotation_translation();
                each(
                    index,
                    PoseSample { t_us, position: position.to_array(), rotation: rotation.to_array() },
                );
            }
            self.next += 1;
            t_us = self.grid.instant_us(self.next);
        }
    }
}
