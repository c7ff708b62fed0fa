//! What a view does during a block of instants: which objects move and which rest, and where parts of them are.
//!
//! An object rests where everything that shaders read of it is equal at every instant of the block; it moves where anything
//! differs at any two. There is no third state ([`Activity`]): whatever decides from motion what is rendered takes
//! [`Resting`] and [`Moving`] objects, which only [`ViewMotion::activities`] makes.
//!
//! Places are computed at a few instants of the block only. [`Deviation`] bounds how far the others are from them.

use std::ops::Range;

use evis_scene::PixelLens;
use glam::{DMat4, DVec3};

use crate::frame::{FrameData, Shared};
use crate::sampling::clusters::{Hull, Pieces};
use crate::world::gpu_scene::{GpuScene, Object};

/// Steps of a block at whose ends speeds are computed.
const STEPS: usize = 8;

/// A view over a block: the instant before it, then its instants.
pub struct ViewMotion<'a> {
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
    /// All instants.
    every: Vec<usize>,
    /// Instants between which speeds are computed.
    moments: Vec<usize>,
    /// The first, the middle and the last instant.
    ends: Vec<usize>,
}

/// An object that is the same at every instant of a block.
#[derive(Clone, Copy, Debug)]
pub struct Resting(usize);

/// An object that differs at some instant of a block.
#[derive(Clone, Copy, Debug)]
pub struct Moving(usize);

/// What an object does during a block.
#[derive(Clone, Copy, Debug)]
pub enum Activity {
    /// Nothing.
    Rests(Resting),
    /// It moves, deforms or changes its emission.
    Moves(Moving),
}

impl Resting {
    /// Index of the object.
    pub const fn object(self) -> usize {
        self.0
    }
}

impl Moving {
    /// Index of the object.
    pub const fn object(self) -> usize {
        self.0
    }
}

impl Activity {
    /// Index of the object.
    pub const fn object(self) -> usize {
        match self {
            Self::Rests(Resting(object)) | Self::Moves(Moving(object)) => object,
        }
    }
}

impl<'a> ViewMotion<'a> {
    /// The frames `frames` of `data`, which keeps its trail.
    pub fn new(data: &'a FrameData, frames: Range<usize>, lens: &'a PixelLens, sky: bool) -> Self {
        let trail = &data.trail;
        let items = data.visible[frames.clone()].iter().flatten();
        let mut visible: Vec<u32> = items.flat_map(|item| item.objects.clone()).collect();
        visible.sort_unstable();
        visible.dedup();
        let last = frames.len() - 1;
        let mut moments: Vec<usize> = (0..=last).step_by((last / STEPS).max(1)).collect();
        moments.extend((moments.last() != Some(&last)).then_some(last));
        let mut ends = vec![0, last / 2, last];
        ends.dedup();
        Self {
            lens,
            camera_from_world: trail.camera_from_world[frames.clone()].iter().collect(),
            shared: trail.shared_of[frames].iter().map(|&s| &trail.shared[s]).collect(),
            visible,
            sky,
            every: (0..=last).collect(),
            moments,
            ends,
        }
    }

    /// Instants between which speeds are computed.
    pub fn moments(&self) -> &[usize] {
        &self.moments
    }

    /// The first, the middle and the last instant.
    pub fn ends(&self) -> &[usize] {
        &self.ends
    }

    /// What each object does, in order.
    pub fn activities(&self, gpu_scene: &GpuScene) -> Vec<Activity> {
        let activity = |(index, object): (usize, &Object)| {
            let equal = |pair: &[&Shared]| pair[0].is_equal(pair[1], object, index);
            match self.shared.windows(2).all(equal) {
                true => Activity::Rests(Resting(index)),
                false => Activity::Moves(Moving(index)),
            }
        };
        gpu_scene.objects.iter().enumerate().map(activity).collect()
    }

    /// Whether the camera is elsewhere at any instant.
    pub fn camera_moves(&self) -> bool {
        self.camera_from_world.iter().any(|camera| *camera != self.camera_from_world[0])
    }

    /// Whether the camera turns, or anything that lies at infinity moves for another reason.
    pub fn camera_turns(&self) -> bool {
        let axes = |camera: &DMat4| (camera.x_axis, camera.y_axis, camera.z_axis);
        self.camera_from_world.iter().any(|camera| axes(camera) != axes(self.camera_from_world[0]))
    }

    /// Where `hull`, a part of an object, is in the world: once where the object rests, else at the instants between which
    /// speeds are computed; at every instant where it deforms.
    pub fn track(&self, gpu_scene: &GpuScene, activity: Activity, hull: &Hull) -> Track<'_> {
        let instants = match activity {
            Activity::Rests(_) => &self.every[..1],
            Activity::Moves(_) if hull.is_rigid() => &self.moments,
            Activity::Moves(_) => &self.every,
        };
        self.track_at(gpu_scene, activity.object(), hull, instants)
    }

    /// The same, at chosen instants.
    pub fn track_at<'b>(
        &self,
        gpu_scene: &GpuScene,
        object: usize,
        hull: &Hull,
        instants: &'b [usize],
    ) -> Track<'b> {
        let count = hull.count();
        let mut points = Vec::with_capacity(count * instants.len());
        for &k in instants {
            hull.place(&gpu_scene.objects[object], object, self.shared[k], &mut points);
        }
        Track { instants, count, points }
    }

    /// Where a moving object may be between the instants of its tracks, in the world and as the camera sees it.
    pub fn deviations(&self, moving: Moving, pieces: &Pieces) -> Deviations {
        let object = moving.object();
        let Hull::Rigid((low, high)) = pieces.whole else {
            // Its tracks have every instant.
            return Deviations::default();
        };
        let points = crate::world::image_bounds::corners(low, high);
        let world: Vec<DMat4> = self.shared.iter().map(|shared| shared.world[object]).collect();
        let seen: Vec<DMat4> = world.iter().zip(&self.camera_from_world).map(|(w, c)| **c * *w).collect();
        Deviations {
            world: Deviation::new(&world, &self.moments, &points),
            seen: Deviation::new(&seen, &self.moments, &points),
            seen_from_ends: Deviation::new(&seen, &self.ends, &points),
        }
    }

    /// How far a resting point may be, as the camera sees it, from the interpolation between `chosen` instants.
    pub fn camera_deviation(&self, chosen: &[usize]) -> CameraDeviation {
        let start = self.camera_from_world[0];
        let from_start: Vec<DMat4> =
            self.camera_from_world.iter().map(|camera| **camera * start.inverse()).collect();
        let mut most = CameraDeviation::default();
        deviations(&from_start, chosen, |now, step| {
            most.distance = most.distance.largest(&LinearBound::new(now));
            most.speed = most.speed.largest(&LinearBound::new(step));
        });
        most
    }
}

/// Where the points of a part's hull are in the world at some instants of a block.
pub struct Track<'a> {
    instants: &'a [usize],
    count: usize,
    points: Vec<DVec3>,
}

impl Track<'_> {
    /// Each instant, and the points there.
    pub fn iter(&self) -> impl Iterator<Item = (usize, &[DVec3])> {
        // A primitive without triangles has no points.
        self.instants.iter().copied().zip(self.points.chunks_exact(self.count.max(1)))
    }

    /// The points at consecutive instants, and how many instants lie from the one to the other.
    pub fn steps(&self) -> impl Iterator<Item = (&[DVec3], &[DVec3], f64)> {
        let pairs = self.iter().zip(self.iter().skip(1));
        pairs.map(|((from, a), (to, b))| (a, b, (to - from) as f64))
    }

    /// Whether it is one place, for all instants.
    pub const fn is_fixed(&self) -> bool {
        self.instants.len() == 1
    }

    /// All points at all instants.
    pub fn points(&self) -> &[DVec3] {
        &self.points
    }

    /// The same.
    pub fn into_points(self) -> Vec<DVec3> {
        self.points
    }
}

/// [`Deviation`]s of a moving object.
#[derive(Clone, Copy, Default)]
pub struct Deviations {
    /// In the world, from the interpolation between moments.
    pub world: Deviation,
    /// In the camera's space, from the interpolation between moments.
    pub seen: Deviation,
    /// In the camera's space, from the interpolation between the first, the middle and the last instant.
    pub seen_from_ends: Deviation,
}

/// How far points of a rigid body are from the straight interpolation between their places at chosen instants.
#[derive(Clone, Copy, Default, Debug)]
pub struct Deviation {
    /// Metres, at most.
    pub distance: f64,
    /// Metres by which that changes from one instant to the next, at most.
    pub speed: f64,
}

impl Deviation {
    /// Of what lies within the hull of `points`, placed by a matrix per instant. The deviation of a point is an affine function
    /// of it, so none is larger than those of the hull's corners.
    fn new(matrices: &[DMat4], chosen: &[usize], points: &[DVec3]) -> Self {
        let mut most = Self::default();
        deviations(matrices, chosen, |now, step| {
            for point in points {
                most.distance = most.distance.max(now.transform_point3(*point).length());
                most.speed = most.speed.max(step.transform_point3(*point).length());
            }
        });
        most
    }
}

/// Calls `each` for every instant with its matrix less the interpolation between the `chosen` ones around it, and with how
/// much that is more than at the instant before.
fn deviations(matrices: &[DMat4], chosen: &[usize], mut each: impl FnMut(&DMat4, &DMat4)) {
    for pair in chosen.windows(2) {
        let ([first, last], steps) = ([matrices[pair[0]], matrices[pair[1]]], (pair[1] - pair[0]) as f64);
        let mut before = DMat4::ZERO;
        for (k, matrix) in matrices.iter().enumerate().take(pair[1] + 1).skip(pair[0] + 1) {
            let t = (k - pair[0]) as f64 / steps;
            let now = if k == pair[1] { DMat4::ZERO } else { *matrix - (first * (1.0 - t) + last * t) };
            each(&now, &(now - before));
            before = now;
        }
    }
}

/// [`Deviation`] of resting points under a moving camera.
#[derive(Clone, Copy, Default)]
pub struct CameraDeviation {
    /// Metres.
    pub distance: LinearBound,
    /// Metres per instant.
    pub speed: LinearBound,
}

/// A bound on the length of an affine map's value: `offset + slope * |point|`, for points in the camera's space at the
/// block's start.
#[derive(Clone, Copy, Default)]
pub struct LinearBound {
    /// Metres.
    pub offset: f64,
    /// Metres per metre.
    pub slope: f64,
}

impl LinearBound {
    fn new(matrix: &DMat4) -> Self {
        let axes = [matrix.x_axis, matrix.y_axis, matrix.z_axis];
        // The Frobenius norm bounds the spectral one.
        let slope = axes.iter().map(|axis| axis.truncate().length_squared()).sum::<f64>().sqrt();
        Self { offset: matrix.w_axis.truncate().length(), slope }
    }

    const fn largest(&self, other: &Self) -> Self {
        Self { offset: self.offset.max(other.offset), slope: self.slope.max(other.slope) }
    }

    /// At a point.
    pub fn at(&self, point: DVec3) -> f64 {
        self.offset + self.slope * point.length()
    }
}

/// Pixels within which the picture of a point lies that is no more than `distance` metres from one of the hull of `points`, all
/// in the camera's space. Infinite where that may lie beside the camera.
///
/// With depths `d` and `e` of the two, where rays are central, `|x/d - y/e| <= (|x - y| + |y/e| |d - e|) / d`.
pub fn reach_px(points: impl Iterator<Item = DVec3>, distance: f64, lens: &PixelLens) -> f64 {
    if distance == 0.0 {
        return 0.0;
    }
    let plane = 0.5 * lens.near;
    if lens.is_parallel() {
        let farthest = points.map(|point| -point.z).fold(f64::NEG_INFINITY, f64::max);
        let scale = lens.focal[0].max(lens.focal[1]);
        return if farthest + distance < plane { 0.0 } else { scale * distance };
    }
    let (mut nearest, mut farthest, mut steepest) = (f64::INFINITY, f64::NEG_INFINITY, 0.0_f64);
    for point in points {
        nearest = nearest.min(-point.z);
        farthest = farthest.max(-point.z);
        steepest = steepest.max(point.truncate().length() / (-point.z).max(plane));
    }
    if farthest + distance < plane {
        // Behind the camera.
        return 0.0;
    }
    if distance > plane && nearest < plane + distance {
        return f64::INFINITY;
    }
    let depth = (nearest - distance).max(lens.near);
    lens.focal[0].max(lens.focal[1]) * distance * (1.0 + steepest) / depth
}
