//! Rates of shadows against rays, which share no code with them: no light that changes is overlooked, and nothing
//! goes faster than is said.

use std::sync::Arc;

use evis_scene::builder::{EventCamera, Placement, SceneBuilder, ShapeSettings, look_rotation};
use evis_scene::motion::Path;
use evis_scene::primitive::Shape;
use evis_scene::{Light, Material, Scene, Trs};
use glam::{DMat4, DQuat, DVec3};

use crate::config::RunConfig;
use crate::engine::Engine;
use crate::frame::{FrameData, FrameRequest};
use crate::sampling::tile_rate::TileRateEstimator;
use crate::sampling::view_motion::ViewMotion;
use crate::shadow::volume::Lamp;
use crate::world::gpu_scene::Object;
use crate::world::image_bounds::bounds;
use crate::world::raster_lens::RasterLens;
use crate::world::tiles::tile_at;
use crate::world::view;

const SIZE: (u32, u32) = (320, 240);
const INSTANTS: usize = 32;
const STEP_PX: f64 = 0.5;

/// Numbers from a seed (G. Steele, D. Lea, C. Flood, "Fast splittable pseudorandom number generators", 2014).
struct Dice(u64);

impl Dice {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        low + (high - low) * ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn vector(&mut self, most: [f64; 3]) -> DVec3 {
        DVec3::from(most.map(|most| self.between(-most, most)))
    }

    fn turn(&mut self) -> DQuat {
        let axis = self.vector([1.0; 3]).normalize_or(DVec3::Y);
        DQuat::from_axis_angle(axis, self.between(0.0, 3.0))
    }
}

/// Boxes and spheres that fly and turn over a floor, before a wall, among ones that stand still.
fn scene(seed: u64, camera_moves: bool) -> Scene {
    let mut dice = Dice(seed);
    let mut scene = SceneBuilder::new("shadows");
    let grey = scene.material(Material::diffuse("grey")).unwrap();
    scene.shape("floor", Shape::Plane { size: [12.0; 2] }, grey, Placement::at([0.0; 3])).unwrap();
    let wall = Placement::at([0.0, 2.0, -3.0]).turned(DQuat::from_rotation_y(dice.between(-0.5, 0.5)));
    scene.shape("wall", Shape::Card { size: [12.0, 6.0] }, grey, wall).unwrap();
    let ball = ShapeSettings::default().segments(24, 12);
    for i in 0..4 {
        let at = dice.vector([2.5, 0.3, 1.5]) + DVec3::Y * 0.4;
        let size = dice.vector([0.3; 3]).abs() + 0.2;
        let shape = if i == 0 { Shape::Sphere { radius: 0.5 } } else { Shape::Box { size: size.into() } };
        let place = Placement::at(at).turned(dice.turn());
        scene.shape_with(format!("still {i}"), shape, grey, ball, place).unwrap();
    }
    for i in 0..3 {
        let translation = dice.vector([1.5, 0.4, 1.0]) + DVec3::Y * 1.6;
        let start = Trs { translation, rotation: dice.turn(), ..Trs::default() };
        let path = Path::Chain(vec![
            Path::ConstantVelocity { start, velocity: dice.vector([4.0; 3]) },
            Path::Spin {
                start: Trs::default(),
                axis: dice.vector([1.0; 3]).normalize_or(DVec3::Y),
                rate: dice.between(0.0, 4.0),
            },
        ]);
        let size = dice.vector([0.4; 3]).abs() + 0.1;
        let shape = if i == 0 { Shape::Sphere { radius: 0.3 } } else { Shape::Box { size: size.into() } };
        scene.shape_with(format!("moving {i}"), shape, grey, ball, Placement::along(path)).unwrap();
    }
    let from = DVec3::new(dice.between(-3.0, 3.0), dice.between(3.0, 6.0), dice.between(-1.0, 4.0));
    let light = if seed.is_multiple_of(2) {
        Light::directional("lamp", 3.0)
    } else {
        Light::spot("lamp", 30.0, 60.0, 70.0)
    };
    scene.light(light.with_shadow(), Placement::looking_at(from, [0.0, 0.0, 0.0])).unwrap();
    let (eye, target) = (DVec3::new(0.0, 2.2, 6.0), DVec3::new(0.0, 0.5, 0.0));
    let rotation = look_rotation(target - eye, DVec3::Y);
    let start = Trs { translation: eye, rotation, ..Trs::default() };
    let velocity = if camera_moves { dice.vector([0.5; 3]) } else { DVec3::ZERO };
    let camera = EventCamera::new("camera").fov_y_degrees(48.0);
    scene.camera(camera, Placement::along(Path::ConstantVelocity { start, velocity })).unwrap();
    scene.build().unwrap()
}

/// Everything at an instant, for rays.
struct World {
    objects: Vec<Solid>,
    world_from_camera: DMat4,
}

/// An object's triangles, and the box around them.
struct Solid {
    triangles: Vec<[DVec3; 3]>,
    low: DVec3,
    high: DVec3,
}

impl World {
    /// The nearest triangle along a ray: how far, and which of which object.
    fn hit(&self, origin: DVec3, direction: DVec3) -> Option<(f64, [usize; 2])> {
        let meet = |[a, b, c]: &[DVec3; 3]| {
            let (e1, e2) = (*b - *a, *c - *a);
            let p = direction.cross(e2);
            let scale = 1.0 / e1.dot(p);
            let s = origin - *a;
            let q = s.cross(e1);
            let (u, v, t) = (s.dot(p) * scale, direction.dot(q) * scale, e2.dot(q) * scale);
            (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 1e-6).then_some(t)
        };
        let mut nearest: Option<(f64, [usize; 2])> = None;
        for (o, solid) in self.objects.iter().enumerate() {
            let (a, b) = ((solid.low - origin) / direction, (solid.high - origin) / direction);
            if a.min(b).max_element() > a.max(b).min_element() {
                continue;
            }
            for (index, t) in solid.triangles.iter().map(meet).enumerate() {
                if let Some(t) = t.filter(|t| nearest.is_none_or(|(other, _)| *t < other)) {
                    nearest = Some((t, [o, index]));
                }
            }
        }
        nearest
    }
}

/// A scene's block, the needs of its tiles, and its light.
struct Trial {
    worlds: Vec<World>,
    lamp: Lamp,
    ray: [f64; 4],
    moving: Vec<bool>,
    needs: Vec<f64>,
}

impl Trial {
    fn new(gpu: &crate::gpu::Gpu, scene: Scene) -> Self {
        let scene = Arc::new(scene);
        let mut config =
            RunConfig { size: Some(SIZE), reference_luminance: Some(1.0), ..RunConfig::default() };
        let (views, _) = view::views(&scene, &config).unwrap();
        let mut engine = Engine::new(gpu, scene.clone(), views.clone(), &mut config).unwrap();
        let context = engine.parts().context;
        let times_s: Vec<f64> = (0..=INSTANTS).map(|k| k as f64 * 1e-3).collect();
        let mut data = FrameData::default();
        let request = FrameRequest {
            views: &views,
            times_s: &times_s,
            shadows: context.shadows.as_ref().map(|maps| &maps.plan),
            occluders: None,
            record_ids: false,
            shadow_maps: false,
            watch: None,
            trail: true,
        };
        data.build(&scene, &context.gpu_scene, &request);
        let passing = ViewMotion::new(&data, 0..INSTANTS + 1, &views[0].lens, false);
        let estimator = TileRateEstimator::new(&scene, &context.gpu_scene, STEP_PX, INSTANTS as u32);
        let needs = estimator.needs(&context.gpu_scene, &passing);
        let objects = &context.gpu_scene.objects;
        let world = |k: usize| {
            let solid = |(object, place): (&Object, &DMat4)| {
                let primitive =
                    &scene.meshes[scene.nodes[object.node].mesh.unwrap()].primitives[object.primitive];
                let corner = |i: u32| {
                    place.transform_point3(DVec3::from(primitive.positions[i as usize].map(f64::from)))
                };
                let triangles: Vec<[DVec3; 3]> =
                    primitive.indices.chunks_exact(3).map(|t| [0, 1, 2].map(|i| corner(t[i]))).collect();
                let (low, high) = bounds(triangles.as_flattened());
                Solid { triangles, low: low - 1e-6, high: high + 1e-6 }
            };
            World {
                objects: objects.iter().zip(&passing.shared[k].world).map(solid).collect(),
                world_from_camera: passing.camera_from_world[k].inverse(),
            }
        };
        Self {
            worlds: (0..=INSTANTS).map(world).collect(),
            lamp: passing.shared[0].lamps[0],
            ray: views[0].lens.ray_from_ndc(),
            moving: objects.iter().map(|o| o.moving).collect(),
            needs,
        }
    }

    /// What stands still at a place of the picture: the triangle, the point, and the cosine at which light comes in.
    fn seen(&self, k: usize, [x, y]: [f64; 2]) -> Option<([usize; 2], DVec3, f64)> {
        let world = &self.worlds[k];
        let ndc = [2.0 * x / f64::from(SIZE.0) - 1.0, 1.0 - 2.0 * y / f64::from(SIZE.1)];
        let [a, b, c, d] = self.ray;
        let direction = DVec3::new(a * ndc[0] + c, b * ndc[1] + d, -1.0);
        let direction = world.world_from_camera.transform_vector3(direction);
        let eye = world.world_from_camera.w_axis.truncate();
        let (t, index) = world.hit(eye, direction)?;
        let [object, triangle] = index;
        let [p, q, r] = world.objects[object].triangles[triangle];
        let normal = (q - p).cross(r - p).normalize();
        let normal = if normal.dot(direction) > 0.0 { -normal } else { normal };
        let point = eye + t * direction + 1e-6 * normal;
        (!self.moving[object]).then(|| (index, point, -normal.dot(self.lamp.direction(point))))
    }

    fn lit(&self, k: usize, point: DVec3) -> bool {
        match self.lamp {
            Lamp::Spot { position, .. } => {
                self.worlds[k].hit(point, position - point).is_none_or(|(t, _)| t >= 1.0)
            }
            Lamp::Directional { along, .. } => self.worlds[k].hit(point, -along).is_none(),
        }
    }

    fn tile([x, y]: [f64; 2]) -> usize {
        tile_at(SIZE.0, x as u32, y as u32)
    }

    /// Places whose light changes, and those of them in tiles that are not rendered.
    fn changes(&self, needs: &[f64]) -> (usize, usize) {
        let (mut changed, mut missed) = (0, 0);
        for (x, y) in (0..SIZE.1 / 2).flat_map(|y| (0..SIZE.0 / 2).map(move |x| (x, y))) {
            let at = [f64::from(2 * x) + 0.5, f64::from(2 * y) + 0.5];
            let Some((_, point, cosine)) = self.seen(0, at) else { continue };
            let now = self.lit(0, point);
            if cosine > 0.0 && [INSTANTS / 2, INSTANTS].iter().any(|&k| self.lit(k, point) != now) {
                changed += 1;
                missed += usize::from(needs[Self::tile(at)] <= 0.0);
            }
        }
        (changed, missed)
    }

    /// Where in row `y` a shadow's border is on one triangle, between `left` and `right`.
    fn border(&self, k: usize, y: f64, left: f64, right: f64) -> Option<(f64, bool, [usize; 2])> {
        let look = |x: f64| self.seen(k, [x, y]).map(|(index, point, _)| (index, self.lit(k, point)));
        let ((index, lit), (other, dark)) = (look(left)?, look(right)?);
        if index != other || lit == dark {
            return None;
        }
        let (mut low, mut high) = (left, right);
        for _ in 0..16 {
            let middle = (low + high) / 2.0;
            let (at, now) = look(middle)?;
            if at != index {
                return None;
            }
            if now == lit { low = middle } else { high = middle }
        }
        Some((low, lit, index))
    }

    /// A border in row `y`, and how far it goes to the right per row; only where it is straight.
    fn edge(&self, k: usize, y: f64, left: f64, right: f64) -> Option<(f64, f64, bool, [usize; 2])> {
        let (at, lit, index) = self.border(k, y, left, right)?;
        let beside = |dy: f64| {
            let (x, other, there) = self.border(k, y + dy, left - 1.0, right + 1.0)?;
            (other == lit && there == index).then_some(x)
        };
        let (above, below) = (beside(-0.25)?, beside(0.25)?);
        ((above + below - 2.0 * at).abs() < 2e-3).then_some((at, 2.0 * (below - above), lit, index))
    }

    /// For borders at instant `k`: how fast each goes across itself, and how fast its tile expects; pixels per instant.
    fn speeds(&self, k: usize) -> Vec<(f64, f64)> {
        const LATER: usize = 2;
        let mut found = Vec::new();
        for (x, y) in (1..SIZE.1 / 4).flat_map(|y| (2..SIZE.0 - 3).map(move |x| (x, 4 * y))) {
            let (x, y) = (f64::from(x) + 0.5, f64::from(y) + 0.5);
            let Some((at, slant, lit, index)) = self.edge(k, y, x, x + 1.0) else { continue };
            let Some((later, slant_later, lit_later, there)) = self.edge(k + LATER, y, x - 1.0, x + 2.0)
            else {
                continue;
            };
            let cosine = self.seen(k, [at, y]).map_or(0.0, |(_, _, cosine)| cosine);
            let straight = (slant - slant_later).abs() < 0.05 * (1.0 + slant.abs());
            let curved = self.worlds[0].objects[index[0]].triangles.len() > 12;
            let least = if curved { 0.5 } else { 0.2 };
            if lit == lit_later && there == index && straight && cosine > least {
                let speed = (later - at).abs() / slant.hypot(1.0) / LATER as f64;
                found.push((speed, self.needs[Self::tile([at, y])] * STEP_PX));
            }
        }
        found
    }
}

#[test]
fn no_moving_shadow_is_missed_and_none_goes_faster_than_its_tiles_expect() {
    let Some(gpu) = crate::tests::device() else { return };
    let (mut changed, mut silent, mut active, mut tiles) = (0, 0, 0, 0);
    let mut borders = Vec::new();
    for seed in 0..12 {
        let camera_moves = seed % 4 == 3;
        let trial = Trial::new(&gpu, scene(seed, camera_moves));
        let (places, missed) = trial.changes(&trial.needs);
        assert_eq!(missed, 0, "seed {seed}: of {places} places whose light changes");
        changed += places;
        // Canary: tiles a column off.
        let shifted: Vec<f64> = [&trial.needs[1..], &[0.0]].concat();
        silent += trial.changes(&shifted).1;
        if !camera_moves {
            active += trial.needs.iter().filter(|need| **need > 0.0).count();
            tiles += trial.needs.len();
            for k in [0, INSTANTS - 2] {
                for (speed, expected) in trial.speeds(k) {
                    assert!(speed <= 1.02 * expected + 1e-3, "seed {seed}: {speed}, expected {expected}");
                    borders.push(expected / speed.max(1e-3));
                }
            }
        }
    }
    borders.sort_by(f64::total_cmp);
    let median = borders[borders.len() / 2];
    assert!(changed > 300 && silent > 15, "{changed} places, {silent} missed by the canary");
    // Canary: half the speeds would not do.
    assert!(borders.len() > 150 && borders[0] < 2.0, "{} borders, at best {}", borders.len(), borders[0]);
    // And they are no excuse to look everywhere.
    assert!(
        active < tiles / 2 && median < 3.0,
        "{active} of {tiles} tiles, {median} times as fast as they go"
    );
}
