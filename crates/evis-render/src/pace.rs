//! How often each part of a picture must be looked at: from how far everything that it may show moves between two
//! instants, which poses alone tell.
//!
//! A view's picture is divided into tiles of [`TILE`] pixels, its time into blocks of instants. Within a block a tile is
//! looked at every 1, 2, 4, ... instants, and at the block's end. What does not change at all is not looked at.
//!
//! Speeds are bounds where bodies move (corners of boxes around their parts), and estimates where the camera does (rays
//! through a grid of places, as deep as boxes around what stands there allow). What is hidden counts too: nothing here
//! knows what hides it.

use std::ops::Range;
use std::sync::Arc;

use evis_scene::Scene;
use glam::{DMat4, DVec3};

use crate::area::{Area, Corners, Rect, corners, seen};
use crate::cover::Cover;
use crate::frame::{FrameData, Shared};
use crate::gpu_scene::GpuScene;
use crate::pieces::{Extent, Pieces, pieces};
use crate::shadow_pace::{Receiver, Scenery, shadows};
use crate::uniforms::LightRecord;
use crate::view::PixelLens;

/// Pixels along a tile's side; `common/tile.wgsl` has the same constant.
pub const TILE: u32 = 16;
/// The pace of a tile that does not change.
pub const STILL: u8 = u8::MAX;
/// How much the logarithm of a light may change between two looks: a tenth of the usual threshold. Steps in pixels that are
/// smaller numbers hold for light too, so that a step of next to nothing looks at every instant of whatever changes.
const LIGHT_STEP: f64 = 0.02;
/// Moments of a block at which speeds are taken, beside its start.
const MOMENTS: usize = 8;
/// A view over a block: the moment before it, then its instants.
pub struct Passing<'a> {
    /// Pixels and lens.
    pub lens: &'a PixelLens,
    /// Where the camera is.
    pub camera_from_world: Vec<&'a DMat4>,
    /// All else.
    pub shared: Vec<&'a Shared>,
    /// Objects that are in view at any of them, in order.
    pub visible: Vec<u32>,
    /// Whether something is seen at infinity that a turn of the camera moves.
    pub sky: bool,
}

impl<'a> Passing<'a> {
    /// The frames `frames` of `data`, which was asked for its trail.
    pub fn new(data: &'a FrameData, frames: Range<usize>, lens: &'a PixelLens, sky: bool) -> Self {
        let trail = &data.trail;
        let items = data.visible[frames.clone()].iter().flatten();
        let mut visible: Vec<u32> = items.flat_map(|item| item.objects.clone()).collect();
        visible.sort_unstable();
        visible.dedup();
        Self {
            lens,
            camera_from_world: trail.camera_from_world[frames.clone()].iter().collect(),
            shared: trail.shared_of[frames].iter().map(|&s| &trail.shared[s]).collect(),
            visible,
            sky,
        }
    }
}

/// How often each tile of a view is looked at during a block.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Paces {
    /// Tiles per row.
    pub columns: u32,
    /// Per tile, row by row: every `2^pace` instants; [`STILL`] for never.
    pub tiles: Vec<u8>,
}

impl Paces {
    /// The same, if only some tiles are looked at.
    pub fn restricted(mut self, only: Option<&Vec<bool>>) -> Self {
        for (pace, _) in self.tiles.iter_mut().zip(only.into_iter().flatten()).filter(|(_, only)| !**only) {
            *pace = STILL;
        }
        self
    }
}

/// Tiles along `pixels`.
pub const fn tiles_along(pixels: u32) -> u32 {
    pixels.div_ceil(TILE)
}

/// Tells paces.
pub struct Pacer {
    pieces: Vec<Option<Arc<Pieces>>>,
    /// Pixels that anything may move between two looks.
    step_px: f64,
    /// log2 of the instants of a block.
    slowest: u8,
}

impl Pacer {
    /// For blocks of `block` instants, a power of two.
    pub fn new(scene: &Scene, gpu_scene: &GpuScene, step_px: f64, block: u32) -> Self {
        Self { pieces: pieces(scene, gpu_scene), step_px, slowest: block.trailing_zeros() as u8 }
    }

    /// The paces of one view during one block.
    pub fn paces(&self, gpu_scene: &GpuScene, view: &Passing<'_>) -> Paces {
        let needs = self.tell(gpu_scene, view);
        let tiles = needs.tiles.into_iter().map(|need| self.pace(need)).collect();
        Paces { columns: needs.columns, tiles }
    }

    /// Looks per instant that each tile asks for; without end where poses do not tell.
    pub fn needs(&self, gpu_scene: &GpuScene, view: &Passing<'_>) -> Vec<f64> {
        self.tell(gpu_scene, view).tiles
    }

    fn tell(&self, gpu_scene: &GpuScene, view: &Passing<'_>) -> Needs {
        let lens = view.lens;
        let (columns, rows) = (tiles_along(lens.width), tiles_along(lens.height));
        let count = (columns * rows) as usize;
        let lights = self.need_of_lights(view);
        let deforms = view.visible.iter().any(|&o| self.pieces[o as usize].is_none());
        if lights.is_infinite() || deforms {
            return Needs { columns, rows, tiles: vec![f64::INFINITY; count] };
        }
        let mut needs = Needs { columns, rows, tiles: vec![lights; count] };
        let last = view.shared.len() - 1;
        let stride = (last / MOMENTS).max(1);
        let moments: Vec<usize> = (0..=last).step_by(stride).collect();
        if view.camera_from_world.iter().any(|c| *c != view.camera_from_world[0]) {
            self.camera(gpu_scene, view, &moments, &mut needs);
        }
        self.bodies(gpu_scene, view, &moments, &mut needs);
        needs
    }

    fn light_step(&self) -> f64 {
        LIGHT_STEP.min(self.step_px)
    }

    /// `need`: looks per instant.
    fn pace(&self, need: f64) -> u8 {
        if need == 0.0 {
            return STILL;
        }
        // Also 0 where the need is not a number.
        (-need.log2()).floor().clamp(0.0, f64::from(self.slowest)) as u8
    }

    /// Looks per instant that the lights and the surroundings ask for, everywhere.
    fn need_of_lights(&self, view: &Passing<'_>) -> f64 {
        let mut need: f64 = 0.0;
        for pair in view.shared.windows(2) {
            for (a, b) in pair[0].lights.iter().zip(&pair[1].lights) {
                need = need.max(light_change(a, b) / self.light_step());
            }
        }
        need
    }

    /// What moves or glows by itself, and the shadows that it throws.
    fn bodies(&self, gpu_scene: &GpuScene, view: &Passing<'_>, moments: &[usize], needs: &mut Needs) {
        let first = view.shared[0];
        let moved: Vec<usize> =
            (0..gpu_scene.objects.len()).filter(|&o| Shared::moves(&view.shared, o)).collect();
        let scenery = Scenery::new(view, moments, (needs.columns, needs.rows));
        let receivers: Vec<Receiver<'_>> = if moved.is_empty() || first.lamps.is_empty() {
            Vec::new()
        } else {
            let receiver = |o: &u32| {
                let o = *o as usize;
                Receiver::new(&scenery, gpu_scene, self.pieces[o].as_deref()?, o)
            };
            view.visible.iter().filter_map(receiver).collect()
        };
        for &o in &moved {
            let Some(pieces) = &self.pieces[o] else {
                needs.everywhere(f64::INFINITY);
                return;
            };
            let glow = view.shared.windows(2).map(|pair| {
                log_change(pair[0].records[o].emission_factor, pair[1].records[o].emission_factor)
            });
            let glow = glow.fold(0.0, f64::max) / self.light_step();
            if view.visible.contains(&(o as u32)) {
                for piece in &pieces.boxes {
                    let places = places(view, moments, o, piece);
                    let speed = speed(view, moments, &places);
                    needs.add(scenery.follow(&places).tiles(), (speed / self.step_px).max(glow));
                }
            }
            shadows(&scenery, pieces, o, &receivers, needs, self.step_px);
        }
    }

    /// What stands still in the world and moves in the picture, because the camera does.
    fn camera(&self, gpu_scene: &GpuScene, view: &Passing<'_>, moments: &[usize], needs: &mut Needs) {
        let lens = view.lens;
        let start = view.camera_from_world[0];
        let mut grid = DepthGrid::new(lens, needs.columns, needs.rows);
        for &o in &view.visible {
            let object = &gpu_scene.objects[o as usize];
            let Some(pieces) = self.pieces[o as usize].as_ref().filter(|_| !object.moving) else {
                continue;
            };
            let world = &view.shared[0].world[o as usize];
            let camera_from_object = *start * *world;
            for piece in &pieces.boxes {
                let places = corners(piece.0, piece.1).map(|c| world.transform_point3(c));
                // Wherever it comes during the block, there something changes.
                let mut area = Area::NOTHING;
                for &k in moments {
                    area = area.join(seen(&places, view.camera_from_world[k], lens));
                }
                needs.add(tiles_of(area, needs.columns, needs.rows), f64::MIN_POSITIVE);
                grid.add(&seen(&places, start, lens), piece, &camera_from_object);
            }
        }
        let steps: Vec<(f64, DMat4)> = moments
            .windows(2)
            .map(|pair| (pair[1] - pair[0]) as f64)
            .zip(moments[1..].iter().map(|&k| *view.camera_from_world[k] * start.inverse()))
            .collect();
        grid.speeds(lens, &steps, view.sky, needs, self.step_px);
    }
}

/// Where the corners of a box in object `o` are at the `moments`.
pub fn places(view: &Passing<'_>, moments: &[usize], o: usize, (low, high): &Extent) -> Vec<Corners> {
    let corners = corners(*low, *high);
    moments.iter().map(|&k| corners.map(|c| view.shared[k].world[o].transform_point3(c))).collect()
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

/// How fast the fastest of points goes that are at `places` at the `moments`: pixels per instant.
fn speed(view: &Passing<'_>, moments: &[usize], places: &[Corners]) -> f64 {
    let mut speed: f64 = 0.0;
    let mut last: Option<(usize, [Option<[f64; 2]>; 8])> = None;
    for (&k, places) in moments.iter().zip(places) {
        let now = places.map(|p| {
            let p = view.camera_from_world[k].transform_point3(p);
            (-p.z >= 0.5 * view.lens.near).then(|| view.lens.project(p)).flatten()
        });
        if let Some((before, was)) = last {
            for pair in was.iter().zip(&now) {
                speed = speed.max(match pair {
                    (Some(a), Some(b)) => (a[0] - b[0]).hypot(a[1] - b[1]) / (k - before) as f64,
                    // Behind the camera and before it.
                    (None, None) => 0.0,
                    _ => f64::INFINITY,
                });
            }
        }
        last = Some((k, now));
    }
    speed
}

/// Looks per instant that each tile asks for.
pub struct Needs {
    columns: u32,
    rows: u32,
    tiles: Vec<f64>,
}

impl Needs {
    fn everywhere(&mut self, need: f64) {
        self.tiles.iter_mut().for_each(|tile| *tile = tile.max(need));
    }

    /// In `tiles`.
    fn add(&mut self, tiles: impl Iterator<Item = (u32, u32)>, need: f64) {
        for (x, y) in tiles {
            let tile = &mut self.tiles[(y * self.columns + x) as usize];
            *tile = tile.max(need);
        }
    }

    /// In the tiles of `cover`, on which a shadow may move: light may change there.
    pub fn add_shadow(&mut self, cover: &Cover, need: f64) {
        self.add(cover.tiles(), need.max(f64::MIN_POSITIVE));
    }

    /// Whether all tiles of `cover` ask for as much anyway.
    pub fn meets(&self, cover: &Cover, need: f64) -> bool {
        cover.tiles().all(|(x, y)| self.tiles[(y * self.columns + x) as usize] >= need)
    }
}

/// The tiles that `area` touches.
fn tiles_of(area: Area, columns: u32, rows: u32) -> impl Iterator<Item = (u32, u32)> {
    let range = |axis: usize, count: u32| {
        if area.is_nothing() { 0..0 } else { tile_range(area.low[axis], area.high[axis], count) }
    };
    let (across, down) = (range(0, columns), range(1, rows));
    down.flat_map(move |y| across.clone().map(move |x| (x, y)))
}

/// Which of `count` tiles in a row or column are touched by what lies from `low` to `high`, which are infinite and in reverse
/// where nothing does.
pub fn tile_range(low: f64, high: f64, count: u32) -> Range<u32> {
    let (tile, count) = (f64::from(TILE), f64::from(count));
    let from = (low / tile).floor().clamp(0.0, count);
    let to = (high / tile).floor().clamp(-1.0, count - 1.0) + 1.0;
    from as u32..to as u32
}

/// Depths at which something may stand, along rays through tiles' corners, edges' middles and centres.
struct DepthGrid {
    /// Places per row.
    columns: u32,
    rows: u32,
    /// Through each place, with z = -1.
    rays: Vec<DVec3>,
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
            let at = [
                (f64::from(x) * half).min(f64::from(lens.width)),
                (f64::from(y) * half).min(f64::from(lens.height)),
            ];
            DVec3::new(
                (at[0] - lens.center[0]) / lens.focal[0],
                (lens.center[1] - at[1]) / lens.focal[1],
                -1.0,
            )
        };
        let rays: Vec<DVec3> = (0..rows).flat_map(|y| (0..columns).map(move |x| ray(x, y))).collect();
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
        let origin = object_from_camera.w_axis.truncate();
        let tile_rows = (self.rows - 1) / 2;
        for (x, y) in tiles_of(*area, self.tile_columns, tile_rows) {
            let mut hit = false;
            for (i, j) in (0..3).flat_map(|j| (0..3).map(move |i| (i, j))) {
                let place = ((2 * y + j) * self.columns + 2 * x + i) as usize;
                if flat {
                    continue;
                }
                let along = object_from_camera.transform_vector3(self.rays[place]);
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
    fn speeds(&self, lens: &PixelLens, steps: &[(f64, DMat4)], sky: bool, needs: &mut Needs, step_px: f64) {
        let speed = |ray: DVec3, depths: [f64; 2]| {
            let mut most: f64 = 0.0;
            let ends = (depths[0] <= depths[1]).then_some(depths);
            let finite = ends.into_iter().flatten().map(|depth| (ray * depth, 1.0));
            for (point, w) in finite.chain(sky.then_some((ray, 0.0))) {
                let mut last = lens.project(ray);
                for (instants, step) in steps {
                    let now = (*step * point.extend(w)).truncate();
                    let now = if -now.z > 0.0 { lens.project(now) } else { None };
                    most = most.max(match (last, now) {
                        (Some(a), Some(b)) => (a[0] - b[0]).hypot(a[1] - b[1]) / instants,
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

/// Rectangles that hold all squares of `side` pixels for which `active` is true and few others. `cost` tells what drawing
/// one takes, in pixels.
pub fn rects(
    active: impl Fn(u32, u32) -> bool,
    side: u32,
    (width, height): (u32, u32),
    cost: impl Fn(&Rect) -> f64,
) -> Vec<Rect> {
    let (columns, rows) = (width.div_ceil(side), height.div_ceil(side));
    let mut open: Vec<[u32; 3]> = Vec::new();
    let mut found: Vec<[u32; 4]> = Vec::new();
    for y in 0..=rows {
        let mut runs: Vec<[u32; 2]> = Vec::new();
        for x in (0..columns).filter(|&x| y < rows && active(x, y)) {
            match runs.last_mut() {
                Some(run) if run[1] == x => run[1] += 1,
                _ => runs.push([x, x + 1]),
            }
        }
        // A run that goes on below makes its rectangle higher.
        let mut next = Vec::new();
        for [from, to, since] in open {
            match runs.iter().position(|run| *run == [from, to]) {
                Some(i) => {
                    runs.swap_remove(i);
                    next.push([from, to, since]);
                }
                None => found.push([from, since, to, y]),
            }
        }
        next.extend(runs.into_iter().map(|[from, to]| [from, to, y]));
        open = next;
    }
    let rect = |[x0, y0, x1, y1]: [u32; 4]| Rect {
        low: [x0 * side, y0 * side],
        high: [(x1 * side).min(width), (y1 * side).min(height)],
    };
    let mut all: Vec<(Rect, f64)> = Vec::new();
    for tiles in found {
        let mut now = rect(tiles);
        let mut own = cost(&now);
        // Joins with whatever is cheaper drawn together.
        while let Some((i, joined, price)) = all.iter().enumerate().find_map(|(i, (other, theirs))| {
            let joined = now.join(other);
            let price = cost(&joined);
            (price <= own + theirs).then_some((i, joined, price))
        }) {
            all.swap_remove(i);
            (now, own) = (joined, price);
        }
        all.push((now, own));
    }
    all.into_iter().map(|(rect, _)| rect).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens() -> PixelLens {
        PixelLens { width: 70, height: 50, focal: [80.0, 80.0], center: [35.0, 25.0], near: 0.05 }
    }

    fn needs(lens: &PixelLens) -> Needs {
        let (columns, rows) = (tiles_along(lens.width), tiles_along(lens.height));
        {
            let count = (columns * rows) as usize;
            Needs { columns, rows, tiles: vec![0.0; count] }
        }
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
        grid.speeds(&lens, &[(4.0, right), (2.0, start)], false, &mut wanted, 0.5);
        for need in &wanted.tiles {
            assert!((need - 0.6 / 0.5).abs() < 1e-9, "{need}");
        }
        // A turn moves everything, the sky too, by about the focal length times the angle.
        let turn = DMat4::from_rotation_y(0.01);
        let mut wanted = needs(&lens);
        DepthGrid::new(&lens, 5, 4).speeds(&lens, &[(1.0, turn)], true, &mut wanted, 1.0);
        let center = wanted.tiles[(2 * wanted.columns + 2) as usize];
        assert!((0.8..0.9).contains(&center) && wanted.tiles[0] > center, "{:?}", wanted.tiles);
        // Nothing is there and nothing is asked for.
        let mut wanted = needs(&lens);
        DepthGrid::new(&lens, 5, 4).speeds(&lens, &[(1.0, turn)], false, &mut wanted, 1.0);
        assert!(wanted.tiles.iter().all(|need| *need == 0.0));
    }

    #[test]
    fn paces_are_powers_of_two_and_never_too_slow() {
        let pacer = Pacer { pieces: Vec::new(), step_px: 1.0, slowest: 4 };
        for (need, pace) in
            [(0.0, STILL), (1e-300, 4), (0.06, 4), (0.0625, 4), (0.07, 3), (0.5, 1), (0.51, 0)]
        {
            assert_eq!(pacer.pace(need), pace, "{need}");
        }
        assert_eq!(pacer.pace(f64::INFINITY), 0);
        assert_eq!(pacer.pace(f64::NAN), 0);
    }

    #[test]
    fn rectangles_hold_what_is_active_and_join_where_that_is_cheaper() {
        // An L, and a tile apart.
        let active = |x: u32, y: u32| matches!((x, y), (0, 0..=3) | (1..=2, 3) | (5, 0));
        let exact = |rect: &Rect| rect.pixels() as f64 + 1e-3;
        let apart = rects(active, TILE, (90, 60), exact);
        assert_eq!(apart.iter().map(Rect::pixels).sum::<u64>(), 16 * 16 * 3 + 3 * 16 * 12 + 10 * 16);
        let cover = |rects: &[Rect], x: u32, y: u32| {
            rects.iter().any(|r| r.low[0] <= x && x < r.high[0] && r.low[1] <= y && y < r.high[1])
        };
        for (x, y) in (0..6).flat_map(|x| (0..4).map(move |y| (x, y))) {
            assert_eq!(cover(&apart, x * TILE, y * TILE), active(x, y), "{x} {y}");
        }
        let joined = rects(active, TILE, (90, 60), |rect| rect.pixels() as f64 + 1e6);
        assert_eq!(joined, [Rect::whole(90, 60)]);
    }
}
