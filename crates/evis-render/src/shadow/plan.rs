//! Which lights throw shadows, and the matrices that fit their maps to the world, not to the view, so that a shadow's edge
//! moves only with its light and its caster.

use evis_scene::{LightKind, PixelLens, Scene, SceneState};
use glam::{DMat4, DVec3, DVec4};

use crate::config::RunConfig;
use crate::world::gpu_scene::{Object, moves, place};
use crate::world::image_bounds::{Corners, Rect, corners};
use crate::world::transform::rigid;

/// Bytes that maps of what stands still may take, of all environments together; beyond, they are drawn again and again.
const STILL_BYTES: u64 = 1 << 30;

/// Texels along a map's edge for each pixel along a picture's, where nothing else is asked for.
const TEXELS_PER_PIXEL: f64 = 12.8;

/// Texels around what is drawn into a map that it may change: rounding's.
const MARGIN_TEXELS: f64 = 2.0;

/// The lights that throw shadows, and whether their maps change.
#[derive(Clone, Debug)]
pub struct ShadowPlan {
    /// Nodes of the lights, in layer order.
    pub nodes: Vec<usize>,
    /// Texels per edge of a map.
    pub edge: u32,
    /// Per environment: which of the ways in which what stands still is placed.
    pub placements: Vec<u32>,
    /// Layers of one map per light and placement; `None` where there is no room for them.
    pub kept: Option<u32>,
    /// Whether maps are drawn as instants and environments come, one environment at a time; else all are drawn at once.
    pub redrawn: bool,
    /// Per light: whether it moves.
    light_moves: Vec<bool>,
    /// Bounds of the world over the run.
    bounds: (DVec3, DVec3),
}

impl ShadowPlan {
    /// `None` where no light throws shadows. `bounds` holds everything that is ever drawn.
    pub fn new(
        scene: &Scene,
        objects: &[Object],
        bounds: (DVec3, DVec3),
        config: &RunConfig,
        limits: &wgpu::Limits,
    ) -> Option<Self> {
        let nodes: Vec<usize> = scene
            .nodes
            .iter()
            .enumerate()
            .filter(|(_, node)| {
                node.light.is_some_and(|l| {
                    let light = &scene.lights[l];
                    light.casts_shadow && light.kind != LightKind::Point
                })
            })
            .map(|(index, _)| index)
            .collect();
        if nodes.is_empty() {
            return None;
        }
        let light_moves: Vec<bool> = nodes.iter().map(|&node| moves(scene, node)).collect();
        let moving_light = light_moves.contains(&true);
        let edge = config.shadow_map.unwrap_or_else(|| usual_edge(scene, config, nodes.len(), moving_light));
        let edge = edge.min(limits.max_texture_dimension_2d);
        let still = objects.iter().filter(|o| !o.moving).map(|o| o.node);
        let still: Vec<usize> = still.chain(nodes.iter().copied()).collect();
        let placements = alike(&states(scene, config.start_us), &still);
        let layers = (1 + placements.iter().max().copied().unwrap_or(0)) * nodes.len() as u32;
        let fits = layers <= limits.max_texture_array_layers
            && u64::from(layers) * u64::from(edge).pow(2) * 4 <= STILL_BYTES;
        let redrawn = moving_light || !fits || objects.iter().any(|o| o.moving);
        Some(Self { nodes, edge, placements, kept: fits.then_some(layers), redrawn, light_moves, bounds })
    }

    /// Whether maps are drawn as instants and environments come.
    pub const fn is_redrawn(&self) -> bool {
        self.redrawn
    }

    /// Per light that throws shadows: whether it moves.
    pub fn light_moves(&self) -> &[bool] {
        &self.light_moves
    }

    /// First layer of the maps that `environment` is drawn with.
    pub fn layer_base(&self, environment: usize) -> u32 {
        if self.redrawn { 0 } else { self.placements[environment] * self.nodes.len() as u32 }
    }

    /// Layer of the light at `node`, within a frame.
    pub fn layer_of(&self, node: usize) -> Option<u32> {
        self.nodes.iter().position(|&n| n == node).map(|i| i as u32)
    }

    /// What of the map that `view` draws is changed by `objects` that move, where `world` has them.
    pub fn moved_texels(&self, view: &LightView, objects: &[Object], world: &[DMat4]) -> Vec<Rect> {
        let of = |(object, world): (&Object, &DMat4)| match place(object, world) {
            None => Some(Rect::whole(self.edge, self.edge)),
            Some(corners) => view.texels(&corners, self.edge),
        };
        objects.iter().zip(world).filter(|(object, _)| object.moving).filter_map(of).collect()
    }

    /// The lights' views, in layer order.
    pub fn matrices<'a>(
        &'a self,
        scene: &'a Scene,
        state: &'a SceneState,
    ) -> impl Iterator<Item = LightView> + 'a {
        self.nodes.iter().filter_map(move |&node| {
            let light = &scene.lights[scene.nodes[node].light?];
            let world = state.world_from_node[node];
            Some(match light.kind {
                LightKind::Spot { outer, .. } => self.spot(&world, f64::from(outer)),
                _ => self.directional(&world),
            })
        })
    }

    fn corners_of_world(&self) -> Corners {
        corners(self.bounds.0, self.bounds.1)
    }

    fn directional(&self, world_from_light: &DMat4) -> LightView {
        let mut world_from_light = rigid(world_from_light);
        world_from_light.w_axis = DVec4::W;
        let light_from_world = world_from_light.inverse();
        let (mut low, mut high) = (DVec3::splat(f64::INFINITY), DVec3::splat(f64::NEG_INFINITY));
        for corner in self.corners_of_world() {
            let p = light_from_world.transform_point3(corner);
            low = low.min(p);
            high = high.max(p);
        }
        // Square, so that a texel has one size; a margin keeps the filter inside.
        let half = ((high - low).truncate().max_element() / 2.0).max(1e-6) * 1.01;
        let center = (low + high) / 2.0;
        let depth = (high.z - low.z).max(1e-6) * 1.02;
        // z: 1 at the nearest corner (largest z, towards the light), 0 behind the farthest.
        let far = center.z - depth / 2.0;
        let clip_from_light = DMat4::from_cols(
            DVec4::new(1.0 / half, 0.0, 0.0, 0.0),
            DVec4::new(0.0, 1.0 / half, 0.0, 0.0),
            DVec4::new(0.0, 0.0, 1.0 / depth, 0.0),
            DVec4::new(-center.x / half, -center.y / half, -far / depth, 1.0),
        );
        LightView {
            clip_from_world: clip_from_light * light_from_world,
            texel: 2.0 * half / f64::from(self.edge),
        }
    }

    fn spot(&self, world_from_light: &DMat4, outer: f64) -> LightView {
        let light_from_world = rigid(world_from_light).inverse();
        // The cone touches the map's edge; a small margin keeps the filter inside.
        let tangent = outer.min(1.5).tan() * 1.02;
        let near = self
            .corners_of_world()
            .iter()
            .map(|c| -light_from_world.transform_point3(*c).z)
            .fold(0.0, f64::max)
            .max(1e-3)
            * 1e-3;
        let clip_from_light = DMat4::from_cols(
            DVec4::new(1.0 / tangent, 0.0, 0.0, 0.0),
            DVec4::new(0.0, 1.0 / tangent, 0.0, 0.0),
            DVec4::new(0.0, 0.0, 0.0, -1.0),
            DVec4::new(0.0, 0.0, near, 0.0),
        );
        LightView {
            clip_from_world: clip_from_light * light_from_world,
            texel: 2.0 * tangent / f64::from(self.edge),
        }
    }
}

/// One shadow map's view.
#[derive(Clone, Copy, Debug)]
pub struct LightView {
    /// Reverse z.
    pub clip_from_world: DMat4,
    /// World size of a texel per unit of clip w.
    pub texel: f64,
}

impl LightView {
    /// Texels of a map of `edge` that a box may change, whose corners in the world are `corners`; all where it reaches behind
    /// the light, nothing where it lies outside.
    pub fn texels(&self, corners: &Corners, edge: u32) -> Option<Rect> {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        let most = f64::from(edge);
        for corner in corners {
            let clip = self.clip_from_world * corner.extend(1.0);
            if clip.w <= 1e-9 {
                return Some(Rect::whole(edge, edge));
            }
            for (axis, ndc) in [clip.x / clip.w, -clip.y / clip.w].into_iter().enumerate() {
                let at = (0.5 * ndc + 0.5) * most;
                low[axis] = low[axis].min(at);
                high[axis] = high[axis].max(at);
            }
        }
        let low = low.map(|v| (v - MARGIN_TEXELS).floor().clamp(0.0, most) as u32);
        let high = high.map(|v| (v + MARGIN_TEXELS).ceil().clamp(0.0, most) as u32);
        (low[0] < high[0] && low[1] < high[1]).then_some(Rect { low, high })
    }
}

/// Texels of a map's edge: so many that in a room or on a street a texel is about as large as a pixel of the scene's largest
/// picture, rendered or not: no stream depends on what is rendered beside it. Fewer where there are many maps, or where all of
/// them must be drawn at every instant.
fn usual_edge(scene: &Scene, config: &RunConfig, lights: usize, light_moves: bool) -> u32 {
    let longest = |camera| {
        let lens = PixelLens::new(camera, config.size);
        lens.width.max(lens.height)
    };
    let longest = scene.cameras.iter().map(longest).max().unwrap_or(1);
    let octave = (TEXELS_PER_PIXEL * f64::from(longest)).log2().round();
    let most = match lights {
        0..=2 if !light_moves => 8192.0,
        0..=8 if !light_moves => 4096.0,
        _ => 2048.0,
    };
    octave.exp2().clamp(1024.0, most) as u32
}

/// `scene` at `start_us` of its time, per environment.
pub fn states(scene: &Scene, start_us: i64) -> Vec<SceneState> {
    (0..scene.variants.len().max(1))
        .map(|environment| {
            let mut state = SceneState::default();
            scene.evaluate_variant(scene.variants.get(environment), start_us as f64 * 1e-6, &mut state);
            state
        })
        .collect()
}

/// Numbers the ways in which `states` place `nodes`, in order of first appearance.
pub fn alike(states: &[SceneState], nodes: &[usize]) -> Vec<u32> {
    let mut numbers: Vec<u32> = Vec::new();
    for (e, state) in states.iter().enumerate() {
        let same = |other: &SceneState| {
            nodes.iter().all(|&node| other.world_from_node[node] == state.world_from_node[node])
        };
        let next = numbers.iter().max().map_or(0, |last| last + 1);
        numbers.push(states[..e].iter().position(same).map_or(next, |other| numbers[other]));
    }
    numbers
}

/// Bounds of everything over the scene's duration, from samples in time. Where a host moves something, it is not known how far it
/// will go: half the diagonal more on each side. What leaves them throws no shadow of a directional light.
pub fn scene_bounds(scene: &Scene) -> Option<(DVec3, DVec3)> {
    const SAMPLES: u32 = 64;
    let duration = scene.duration_s.unwrap_or(10.0);
    (0..=SAMPLES)
        .filter_map(|i| scene.bounds(duration * f64::from(i) / f64::from(SAMPLES)))
        .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
        .map(|(low, high)| {
            let more = if scene.host_poses.is_some() { 0.5 * (high - low).length() } else { 0.0 };
            (low - more, high + more)
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan() -> ShadowPlan {
        ShadowPlan {
            nodes: vec![0],
            edge: 2048,
            placements: vec![0],
            kept: Some(1),
            redrawn: false,
            light_moves: vec![false],
            bounds: (DVec3::splat(-2.0), DVec3::new(2.0, 3.0, 4.0)),
        }
    }

    #[test]
    fn every_corner_of_the_world_is_inside_a_directional_map() {
        let plan = plan();
        let light = DMat4::from_rotation_x(-1.0) * DMat4::from_rotation_y(0.4);
        let view = plan.directional(&light);
        for corner in plan.corners_of_world() {
            let clip = view.clip_from_world * corner.extend(1.0);
            assert!(clip.x.abs() <= 1.0 && clip.y.abs() <= 1.0 && (0.0..=1.0).contains(&clip.z), "{clip}");
        }
        // Towards the light is nearer: larger z.
        let toward = light.z_axis.truncate();
        let a = view.clip_from_world.transform_point3(DVec3::ZERO);
        let b = view.clip_from_world.transform_point3(toward * 0.1);
        assert!(b.z > a.z);
    }

    #[test]
    fn a_spot_map_covers_its_cone() {
        let view = plan().spot(&DMat4::from_translation(DVec3::new(0.0, 5.0, 0.0)), 0.6);
        let edge = DVec3::new(0.6f64.tan(), 5.0, -1.0);
        let clip = view.clip_from_world * edge.extend(1.0);
        let x = clip.x / clip.w;
        assert!((0.9..1.0).contains(&x), "{x}");
    }

    #[test]
    fn what_a_box_changes_of_a_map_holds_all_of_its_points() {
        let plan = plan();
        let lamp = DMat4::from_translation(DVec3::new(0.0, 5.0, 0.0)) * DMat4::from_rotation_x(-1.2);
        for view in [plan.spot(&lamp, 0.9), plan.directional(&lamp)] {
            let (low, high) = (DVec3::new(-0.4, 0.1, -2.0), DVec3::new(0.3, 0.9, -1.5));
            let rect = view.texels(&corners(low, high), 2048).unwrap();
            assert!(rect.pixels() < 2048 * 2048 / 4, "{rect:?}");
            for i in 0..1000 {
                let part = |k: u32| f64::from((i * k) % 997) / 996.0;
                let point = low + (high - low) * DVec3::new(part(31), part(17), part(7));
                let clip = view.clip_from_world * point.extend(1.0);
                let at = [clip.x / clip.w, -clip.y / clip.w].map(|ndc| (0.5 * ndc + 0.5) * 2048.0);
                let inside = (0..2).all(|axis| {
                    f64::from(rect.low[axis]) <= at[axis] && at[axis] <= f64::from(rect.high[axis])
                });
                assert!(inside, "{point} at {at:?}, {rect:?}");
            }
        }
        let spot = plan.spot(&lamp, 0.9);
        let beside = |x: f64| corners(DVec3::new(x, 0.0, -2.0), DVec3::new(x + 0.1, 0.5, -1.0));
        assert_eq!(spot.texels(&beside(40.0), 2048), None);
        let around = corners(DVec3::splat(-9.0), DVec3::splat(9.0));
        assert_eq!(spot.texels(&around, 2048), Some(Rect::whole(2048, 2048)), "the lamp is in it");
    }
}
