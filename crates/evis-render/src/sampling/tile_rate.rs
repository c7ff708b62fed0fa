//! How often each tile of a picture is sampled, from how far what it may show moves between two instants. Poses alone decide.
//!
//! A view's picture is divided into tiles of [`TILE`] pixels, its time into blocks of instants. Within a block a tile is
//! sampled every 1, 2, 4, ... instants, and at the block's end. A tile is not sampled at all only if everything that its
//! shaders read is equal at every instant of the block: see [`crate::sampling::view_motion`].
//!
//! Speeds are bounds where bodies move (hulls of their parts), and estimates where the camera does (rays through a grid of
//! places, as deep as boxes around what stands there allow). They choose how often a tile is sampled, never whether. What is
//! hidden counts too: occlusion is not considered.

use std::sync::Arc;

use evis_scene::{PixelLens, PixelRay, Scene};
use glam::{DMat4, DVec2, DVec3};

use crate::gpu::uniforms::{LightRecord, ObjectRecord};
use crate::sampling::clusters::{Hull, Pieces, pieces};
use crate::sampling::needs::Needs;
use crate::sampling::shadow_rate::{Receiver, Scenery, shadows};
use crate::sampling::view_motion::{
    Activity, CameraDeviation, Deviations, Moving, Resting, Track, ViewMotion, reach_px,
};
use crate::world::gpu_scene::GpuScene;
use crate::world::image_bounds::{Area, Extent, MARGIN_PX, bounds, seen};
use crate::world::tiles::{TILE, tile_range, tiles_along};

/// The rate of a tile that does not change.
pub const STILL: u8 = u8::MAX;

/// How much the logarithm of a light may change between two samples: a tenth of the usual threshold. Steps in pixels that
/// are smaller numbers hold for light too, so that a step of next to nothing samples every instant of whatever changes.
const LIGHT_STEP: f64 = 0.02;

/// How often each tile of a view is sampled during a block.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TileRates {
    /// Tiles per row.
    pub columns: u32,
    /// Per tile, row by row: every `2^log2_stride` instants; [`STILL`] for never.
    pub tiles: Vec<u8>,
}

impl TileRates {
    /// The same, if only some tiles are rendered.
    pub fn restricted(mut self, only: Option<&Vec<bool>>) -> Self {
        for (log2_stride, _) in
            self.tiles.iter_mut().zip(only.into_iter().flatten()).filter(|(_, only)| !**only)
        {
            *log2_stride = STILL;
        }
        self
    }
}

/// Decides how often tiles are sampled.
pub struct TileRateEstimator {
    pieces: Vec<Arc<Pieces>>,
    /// Pixels that anything may move between two samples.
    step_px: f64,
    /// log2 of the instants of a block.
    slowest: u8,
    /// A canary of the tests: what is taken for still.
    #[cfg(test)]
    pub overlooks: Option<Overlook>,
}

/// Motion that a canary overlooks.
#[cfg(test)]
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Overlook {
    /// What rests, but moves at other times, under a camera that moves.
    Paused,
    /// What is back at the same pose at the instants between which speeds are computed.
    Vibrating,
    /// Shadows of what moves.
    Shadows,
    /// Joints and morph weights.
    Deformation,
}

impl TileRateEstimator {
    /// For blocks of `block` instants, a power of two.
    pub fn new(scene: &Scene, gpu_scene: &GpuScene, step_px: f64, block: u32) -> Self {
        Self {
            pieces: pieces(scene, gpu_scene),
            step_px,
            slowest: block.trailing_zeros() as u8,
            #[cfg(test)]
            overlooks: None,
        }
    }

    /// How often the tiles of one view are sampled during one block.
    pub fn tile_rates(&self, gpu_scene: &GpuScene, view: &ViewMotion<'_>) -> TileRates {
        let needs = self.required(gpu_scene, view);
        let tiles = needs.tiles.into_iter().map(|need| self.log2_stride(need)).collect();
        TileRates { columns: needs.columns, tiles }
    }

    /// Samples per instant that each tile requires; infinite where poses do not tell.
    pub fn needs(&self, gpu_scene: &GpuScene, view: &ViewMotion<'_>) -> Vec<f64> {
        self.required(gpu_scene, view).tiles
    }

    fn required(&self, gpu_scene: &GpuScene, view: &ViewMotion<'_>) -> Needs {
        let lens = view.lens;
        let (columns, rows) = (tiles_along(lens.width), tiles_along(lens.height));
        let mut needs = Needs::everywhere(columns, rows, self.need_of_lights(view));
        if needs.tiles.iter().all(|need| need.is_infinite()) {
            return needs;
        }
        let activities = view.activities(gpu_scene);
        let (mut resting, mut moving) = (Vec::new(), Vec::new());
        for activity in &activities {
            match *activity {
                Activity::Rests(object) => resting.push(object),
                Activity::Moves(object) => moving.push(object),
            }
        }
        #[cfg(test)]
        let shadows = match self.overlooks {
            None => true,
            Some(Overlook::Paused) => {
                resting.retain(|object| !gpu_scene.objects[object.object()].moving);
                true
            }
            Some(Overlook::Vibrating) => {
                let at = |k: &usize, o: usize| view.shared[*k].world[o];
                let back = |o: usize| view.moments().iter().all(|k| at(k, o) == at(&0, o));
                moving.retain(|object| !back(object.object()));
                true
            }
            Some(Overlook::Shadows) => false,
            Some(Overlook::Deformation) => {
                moving.retain(|object| gpu_scene.objects[object.object()].extent.is_some());
                true
            }
        };
        #[cfg(not(test))]
        let shadows = true;
        if view.camera_moves() {
            self.camera(gpu_scene, view, &resting, &mut needs);
        }
        self.bodies(gpu_scene, view, &moving, &mut needs);
        if shadows {
            self.shadows(gpu_scene, view, &activities, &moving, &mut needs);
        }
        needs
    }

    fn light_step(&self) -> f64 {
        LIGHT_STEP.min(self.step_px)
    }

    /// `need`: samples per instant.
    fn log2_stride(&self, need: f64) -> u8 {
        if need == 0.0 {
            return STILL;
        }
        // Also 0 where the need is not a number.
        (-need.log2()).floor().clamp(0.0, f64::from(self.slowest)) as u8
    }

    /// Samples per instant that changing lights require, everywhere.
    fn need_of_lights(&self, view: &ViewMotion<'_>) -> f64 {
        let mut need: f64 = 0.0;
        for pair in view.shared.windows(2) {
            if pair[0].light_factors != pair[1].light_factors {
                // A host changed one, in a step.
                return f64::INFINITY;
            }
            for (a, b) in pair[0].lights.iter().zip(&pair[1].lights).filter(|(a, b)| a != b) {
                need = need.max(light_change(a, b) / self.light_step()).max(f64::MIN_POSITIVE);
            }
        }
        need
    }

    /// What moves, deforms or glows by itself.
    fn bodies(&self, gpu_scene: &GpuScene, view: &ViewMotion<'_>, moving: &[Moving], needs: &mut Needs) {
        let scenery = Scenery::new(view, gpu_scene, &self.pieces, (needs.columns, needs.rows));
        for &body in moving.iter().filter(|body| view.visible.contains(&(body.object() as u32))) {
            let o = body.object();
            let glow =
                view.shared.windows(2).map(|pair| glow_change(&pair[0].records[o], &pair[1].records[o]));
            let glow = glow.fold(0.0, f64::max) / self.light_step();
            let activity = Activity::Moves(body);
            let deviations = scenery.deviations(activity);
            for part in &self.pieces[o].boxes {
                let track = view.track(gpu_scene, activity, part);
                let see = |(k, points): (usize, &[DVec3])| depths(view.camera_from_world[k], points);
                let speed = if moving_cut(view.lens, track.iter().map(see)) {
                    f64::INFINITY
                } else {
                    speed(view, &track, &deviations)
                };
                let cover = scenery.follow(activity, part, &deviations);
                needs.add(cover.tiles(), (speed / self.step_px).max(glow));
            }
        }
    }

    /// Shadows of what moves, in view or not, on what is in view.
    fn shadows(
        &self,
        gpu_scene: &GpuScene,
        view: &ViewMotion<'_>,
        activities: &[Activity],
        moving: &[Moving],
        needs: &mut Needs,
    ) {
        if moving.is_empty() || view.shared[0].lamps.is_empty() {
            return;
        }
        let scenery = Scenery::new(view, gpu_scene, &self.pieces, (needs.columns, needs.rows));
        let receivers: Vec<Receiver<'_>> =
            view.visible.iter().map(|o| Receiver::new(&scenery, activities[*o as usize])).collect();
        for &caster in moving {
            shadows(&scenery, caster, &receivers, needs, self.step_px);
        }
    }

    /// What rests in the world and moves in the picture, because the camera does.
    fn camera(&self, gpu_scene: &GpuScene, view: &ViewMotion<'_>, resting: &[Resting], needs: &mut Needs) {
        let lens = view.lens;
        let (columns, rows) = (needs.columns, needs.rows);
        let moments = view.moments();
        let ends = [moments[0], moments[moments.len() - 1]];
        let mut grid = DepthGrid::new(lens, columns, rows);
        for &object in resting.iter().filter(|object| view.visible.contains(&(object.object() as u32))) {
            let (o, pieces) = (object.object(), &self.pieces[object.object()]);
            let activity = Activity::Rests(object);
            // Wherever it is seen during the block, there something changes.
            let whole = view.track(gpu_scene, activity, &pieces.whole);
            let mut area = Area::NOTHING;
            for camera in &view.camera_from_world {
                area = area.join(seen(whole.points(), camera, lens));
            }
            needs.add(tiles_of(area.grown(MARGIN_PX), columns, rows), f64::MIN_POSITIVE);
            let world = &view.shared[0].world[o];
            for part in &pieces.boxes {
                let points = view.track(gpu_scene, activity, part);
                // What deforms rests in its box in the world.
                let (extent, world) = match part {
                    Hull::Rigid(extent) => (*extent, *world),
                    Hull::Deforming(_) => (bounds(points.points()), DMat4::IDENTITY),
                };
                let by_time = moments.iter().map(|&k| depths(view.camera_from_world[k], points.points()));
                if moving_cut(lens, by_time) {
                    needs.add(tiles_of(area.grown(MARGIN_PX), columns, rows), f64::INFINITY);
                }
                for camera in ends.map(|k| view.camera_from_world[k]) {
                    grid.add(&seen(points.points(), camera, lens), &extent, &(*camera * world));
                }
            }
        }
        if view.sky && view.camera_turns() {
            needs.tiles.iter_mut().for_each(|need| *need = need.max(f64::MIN_POSITIVE));
        }
        let start = view.camera_from_world[0].inverse();
        let steps: Vec<(f64, DMat4)> = moments
            .windows(2)
            .map(|pair| (pair[1] - pair[0]) as f64)
            .zip(moments[1..].iter().map(|&k| *view.camera_from_world[k] * start))
            .collect();
        grid.speeds(lens, &steps, &view.camera_deviation(moments), view.sky, needs, self.step_px);
    }
}

/// Rate of change of a surface's log emission: infinite where a host changes its material in a step.
fn glow_change(a: &ObjectRecord, b: &ObjectRecord) -> f64 {
    let factors = |record: &ObjectRecord| (record.base_metallic, record.emissive_roughness);
    if factors(a) == factors(b) { log_change(a.emission_factor, b.emission_factor) } else { f64::INFINITY }
}

/// How the logarithm of a light changes: without end where it moves.
fn light_change(a: &LightRecord, b: &LightRecord) -> f64 {
    let place = |l: &LightRecord| (l.position_kind, l.direction_range, l.spot, l.shadow_clip_from_world);
    if place(a) != place(b) {
        return f64::INFINITY;
    }
    (0..3).map(|i| log_change(a.radiance_shadow[i], b.radiance_shadow[i])).fold(0.0, f64::max)
}

fn log_change(a: f32, b: f32) -> f64 {
    if a == b { 0.0 } else { (f64::from(a) / f64::from(b)).ln().abs() }
}

/// Planar depths of `points` of the world.
fn depths(camera_from_world: &DMat4, points: &[DVec3]) -> Vec<f64> {
    points.iter().map(|p| -camera_from_world.transform_point3(*p).z).collect()
}

/// Whether a plane of an orthographic camera cuts the hull of points of these depths at some time, and where it does so changes:
/// the border of the cut moves though its points may go along the rays and move nowhere in the picture.
fn moving_cut(lens: &PixelLens, depths: impl Iterator<Item = Vec<f64>>) -> bool {
    if !lens.is_parallel() {
        return false;
    }
    let times: Vec<Vec<f64>> = depths.collect();
    let all = || times.iter().flatten().copied();
    let (low, high) = (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
    let cuts = |plane: f64| low < plane && plane < high;
    (cuts(lens.near) || cuts(lens.far())) && times.windows(2).any(|pair| pair[0] != pair[1])
}

/// How fast the fastest point of a part goes: pixels per instant. Infinite where it passes the camera.
fn speed(view: &ViewMotion<'_>, track: &Track<'_>, deviations: &Deviations) -> f64 {
    let see = |k: usize, p: &DVec3| view.camera_from_world[k].transform_point3(*p);
    let plane = 0.5 * view.lens.near;
    let mut fastest: f64 = 0.0;
    let mut before: Option<(usize, &[DVec3])> = None;
    for (k, points) in track.iter() {
        if let Some((last, were)) = before {
            let pairs = || were.iter().zip(points).map(|(a, b)| (see(last, a), see(k, b)));
            let is_behind = |p: DVec3| p.z > -plane;
            // What is behind the camera all the way is not seen.
            if !pairs().all(|(a, b)| is_behind(a) && is_behind(b)) {
                for (a, b) in pairs() {
                    fastest = fastest.max(match (view.lens.project(a), view.lens.project(b)) {
                        (Some(p), Some(q)) if !is_behind(a) && !is_behind(b) => {
                            (p.x - q.x).hypot(p.y - q.y) / (k - last) as f64
                        }
                        _ => f64::INFINITY,
                    });
                }
            }
        }
        let shake_px = reach_px(points.iter().map(|p| see(k, p)), deviations.seen.speed, view.lens);
        fastest = fastest.max(shake_px);
        before = Some((k, points));
    }
    fastest
}

/// The tiles that `area` touches.
fn tiles_of(area: Area, columns: u32, rows: u32) -> impl Iterator<Item = (u32, u32)> {
    let range = |axis: usize, count: u32| {
        if area.is_nothing() { 0..0 } else { tile_range(area.low[axis], area.high[axis], count) }
    };
    let (across, down) = (range(0, columns), range(1, rows));
    down.flat_map(move |y| across.clone().map(move |x| (x, y)))
}

/// Depths at which something may stand, along rays through tiles' corners, edges' middles and centres.
struct DepthGrid {
    /// Places per row.
    columns: u32,
    rows: u32,
    /// Through each place.
    rays: Vec<PixelRay>,
    /// Least and greatest.
    depths: Vec<[f64; 2]>,
    /// Of what stands between the rays of a tile.
    between: Vec<[f64; 2]>,
    tile_columns: u32,
    near: f64,
}

const NO_DEPTH: [f64; 2] = [f64::INFINITY, f64::NEG_INFINITY];

impl DepthGrid {
    fn new(lens: &PixelLens, tile_columns: u32, tile_rows: u32) -> Self {
        let (columns, rows) = (2 * tile_columns + 1, 2 * tile_rows + 1);
        let half = f64::from(TILE) / 2.0;
        let ray = |x: u32, y: u32| {
            let at = DVec2::new(f64::from(x) * half, f64::from(y) * half);
            lens.ray(at.min(DVec2::new(lens.width.into(), lens.height.into())))
        };
        let rays: Vec<PixelRay> = (0..rows).flat_map(|y| (0..columns).map(move |x| ray(x, y))).collect();
        Self {
            columns,
            rows,
            depths: vec![NO_DEPTH; rays.len()],
            rays,
            between: vec![NO_DEPTH; (tile_columns * tile_rows) as usize],
            tile_columns,
            near: lens.near,
        }
    }

    /// `piece` of an object is seen within `area`.
    fn add(&mut self, area: &Area, piece: &Extent, camera_from_object: &DMat4) {
        if area.is_nothing() {
            return;
        }
        let middle = -camera_from_object.transform_point3((piece.0 + piece.1) / 2.0).z;
        let object_from_camera = camera_from_object.inverse();
        let flat = !object_from_camera.is_finite();
        let tile_rows = (self.rows - 1) / 2;
        for (x, y) in tiles_of(*area, self.tile_columns, tile_rows) {
            let mut hit = false;
            for (i, j) in (0..3).flat_map(|j| (0..3).map(move |i| (i, j))) {
                let place = ((2 * y + j) * self.columns + 2 * x + i) as usize;
                if flat {
                    continue;
                }
                let origin = object_from_camera.transform_point3(self.rays[place].origin);
                let along = object_from_camera.transform_vector3(self.rays[place].direction);
                if let Some([near, far]) = through(piece, origin, along, self.near) {
                    hit = true;
                    let depths = &mut self.depths[place];
                    *depths = [depths[0].min(near), depths[1].max(far)];
                }
            }
            if !hit {
                let between = &mut self.between[(y * self.tile_columns + x) as usize];
                let middle = middle.max(self.near);
                *between = [between[0].min(middle), between[1].max(middle)];
            }
        }
    }

    /// Adds what each tile asks for when the camera goes through `steps`: their lengths in instants, and the camera after
    /// each as seen from before all.
    /// `deviations`: how far points may be from the straight interpolation between the steps.
    fn speeds(
        &self,
        lens: &PixelLens,
        steps: &[(f64, DMat4)],
        deviations: &CameraDeviation,
        sky: bool,
        needs: &mut Needs,
        step_px: f64,
    ) {
        // Parallel rays see one point of the sky, and any turn exchanges it.
        let turns = |(_, step): &(f64, DMat4)| step.transform_vector3(DVec3::Z) != DVec3::Z;
        let exchanged =
            lens.is_parallel() && sky && (deviations.speed.slope > 0.0 || steps.iter().any(turns));
        let sky = sky && !lens.is_parallel();
        let speed = |ray: PixelRay, depths: [f64; 2]| {
            let mut most: f64 = if exchanged { f64::INFINITY } else { 0.0 };
            let ends = (depths[0] <= depths[1]).then_some(depths);
            let finite = ends.into_iter().flatten().map(|depth| (ray.at(depth), 1.0));
            for (point, w) in finite.chain(sky.then_some((ray.direction, 0.0))) {
                let mut last = lens.project(ray.at(1.0));
                // At infinity offsets do not count.
                let shake = if w == 0.0 {
                    deviations.speed.slope * ray.direction.length()
                } else {
                    deviations.speed.at(point)
                };
                let shake_px = reach_px(std::iter::once(point), shake, lens);
                for (instants, step) in steps {
                    let now = (*step * point.extend(w)).truncate();
                    let now = lens.project(now);
                    most = most.max(match (last, now) {
                        (Some(a), Some(b)) => (a.x - b.x).hypot(a.y - b.y) / instants + shake_px,
                        _ => f64::INFINITY,
                    });
                    last = now;
                }
            }
            most
        };
        let at: Vec<f64> =
            self.rays.iter().zip(&self.depths).map(|(ray, depths)| speed(*ray, *depths)).collect();
        for (index, need) in needs.tiles.iter_mut().enumerate() {
            let (x, y) = (index as u32 % self.tile_columns, index as u32 / self.tile_columns);
            let place = |i: u32, j: u32| ((2 * y + j) * self.columns + 2 * x + i) as usize;
            let mut fastest = (0..3)
                .flat_map(|j| (0..3).map(move |i| (i, j)))
                .map(|(i, j)| at[place(i, j)])
                .fold(0.0, f64::max);
            let between = self.between[index];
            if between[0] <= between[1] {
                fastest = fastest.max(speed(self.rays[place(1, 1)], between));
            }
            *need = need.max(fastest / step_px);
        }
    }
}

/// From where to where a ray from `origin` along `along` runs through a box, beyond `near`.
fn through((low, high): &Extent, origin: DVec3, along: DVec3, near: f64) -> Option<[f64; 2]> {
    let (mut enter, mut leave) = (near, f64::INFINITY);
    for axis in 0..3 {
        let (a, b) = ((low[axis] - origin[axis]) / along[axis], (high[axis] - origin[axis]) / along[axis]);
        if along[axis] == 0.0 {
            if origin[axis] < low[axis] || origin[axis] > high[axis] {
                return None;
            }
            continue;
        }
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    (enter <= leave).then_some([enter, leave])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::image_bounds::corners;

    fn lens() -> PixelLens {
        let rays = evis_scene::Rays::Central;
        PixelLens { width: 70, height: 50, focal: [80.0, 80.0], center: [35.0, 25.0], near: 0.05, rays }
    }

    fn needs(lens: &PixelLens) -> Needs {
        Needs::everywhere(tiles_along(lens.width), tiles_along(lens.height), 0.0)
    }

    #[test]
    fn a_camera_that_moves_past_a_wall_sees_it_move_as_far_as_its_depth_says() {
        let lens = lens();
        let mut grid = DepthGrid::new(&lens, tiles_along(lens.width), tiles_along(lens.height));
        let wall = (DVec3::new(-9.0, -9.0, -2.0), DVec3::new(9.0, 9.0, -2.0));
        let start = DMat4::IDENTITY;
        let corners = corners(wall.0, wall.1);
        grid.add(&seen(&corners, &start, &lens), &wall, &start);
        // 3 cm to the right in 4 instants, then back in 2: 80 * 0.03 / 2 pixels, in 2 instants.
        let right = DMat4::from_translation(DVec3::new(-0.03, 0.0, 0.0));
        let mut wanted = needs(&lens);
        grid.speeds(
            &lens,
            &[(4.0, right), (2.0, start)],
            &CameraDeviation::default(),
            false,
            &mut wanted,
            0.5,
        );
        for need in &wanted.tiles {
            assert!((need - 0.6 / 0.5).abs() < 1e-9, "{need}");
        }
        // A turn moves everything, the sky too, by about the focal length times the angle.
        let turn = DMat4::from_rotation_y(0.01);
        let mut wanted = needs(&lens);
        DepthGrid::new(&lens, 5, 4).speeds(
            &lens,
            &[(1.0, turn)],
            &CameraDeviation::default(),
            true,
            &mut wanted,
            1.0,
        );
        let center = wanted.tiles[(2 * wanted.columns + 2) as usize];
        assert!((0.8..0.9).contains(&center) && wanted.tiles[0] > center, "{:?}", wanted.tiles);
        // Nothing is there and nothing is asked for.
        let mut wanted = needs(&lens);
        DepthGrid::new(&lens, 5, 4).speeds(
            &lens,
            &[(1.0, turn)],
            &CameraDeviation::default(),
            false,
            &mut wanted,
            1.0,
        );
        assert!(wanted.tiles.iter().all(|need| *need == 0.0));
    }

    #[test]
    fn rates_are_powers_of_two_and_never_too_slow() {
        let estimator = TileRateEstimator { pieces: Vec::new(), step_px: 1.0, slowest: 4, overlooks: None };
        for (need, log2_stride) in
            [(0.0, STILL), (1e-300, 4), (0.06, 4), (0.0625, 4), (0.07, 3), (0.5, 1), (0.51, 0)]
        {
            assert_eq!(estimator.log2_stride(need), log2_stride, "{need}");
        }
        assert_eq!(estimator.log2_stride(f64::INFINITY), 0);
        assert_eq!(estimator.log2_stride(f64::NAN), 0);
    }
}
