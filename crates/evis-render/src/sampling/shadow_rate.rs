//! Where shadows of what moves fall during a block, and how fast they go there.
//!
//! A body throws its shadow as a few boxes around its parts, and faces of what is in view receive it: boxes around triangles
//! that face about one way. Light through a box of the one passes a box of the other within a short part of its way, so the
//! shadow lies in a small prism, of which the tiles are known, and goes as corners of the box do when they are carried there.
//! On a surface that is not at right angles to the light it goes farther: it slides along the light.

use std::cell::OnceCell;

use evis_scene::Eye;
use glam::{DMat3, DMat4, DVec2, DVec3};

use crate::sampling::clusters::{Face, Hull, Pieces};
use crate::sampling::coverage::Cover;
use crate::sampling::needs::Needs;
use crate::sampling::view_motion::{
    Activity, CameraDeviation, Deviations, Moving, Track, ViewMotion, reach_px,
};
use crate::shadow::volume::{Lamp, extent};
use crate::world::gpu_scene::GpuScene;
use crate::world::image_bounds::{Area, Corners, bounds, corners, outline, seen};
use crate::world::raster_lens::RasterLens;

/// Cosine of the incidence below which a shadow is not taken to slide any farther: the light that it takes away there is as
/// much less. On what is curved light comes in at every angle somewhere.
const LEAST_COSINE: f64 = 0.2;

const LEAST_COSINE_CURVED: f64 = 0.5;

/// Tiles of a shadow that are not worth a finer division.
const FEW_TILES: usize = 4;

/// A view during a block, as shadows need it.
pub struct Scenery<'a> {
    /// The view.
    pub view: &'a ViewMotion<'a>,
    gpu_scene: &'a GpuScene,
    pieces: &'a [std::sync::Arc<Pieces>],
    /// Tiles per row and column.
    tiles: (u32, u32),
    /// The camera at the first, the middle and the last instant, and when; once where it stands still.
    cameras: Vec<(&'a DMat4, f64)>,
    eyes: Vec<Eye>,
    /// How far resting points are from the interpolation between these.
    deviations: CameraDeviation,
}

impl<'a> Scenery<'a> {
    /// Of `view`, in a picture of `tiles`.
    pub fn new(
        view: &'a ViewMotion<'a>,
        gpu_scene: &'a GpuScene,
        pieces: &'a [std::sync::Arc<Pieces>],
        tiles: (u32, u32),
    ) -> Self {
        let still = !view.camera_moves();
        let ends = if still { &view.ends()[..1] } else { view.ends() };
        let cameras: Vec<_> = ends.iter().map(|&k| (view.camera_from_world[k], k as f64)).collect();
        let eyes = cameras.iter().map(|(camera, _)| view.lens.eye(&camera.inverse())).collect();
        let deviations = view.camera_deviation(ends);
        Self { view, gpu_scene, pieces, tiles, cameras, eyes, deviations }
    }

    /// Where the hull of `points`, which rest in the world, is seen during the block.
    pub fn cover(&self, points: &[DVec3]) -> Cover {
        let mut outlines = Vec::new();
        let mut border_px: f64 = 0.0;
        for (camera, _) in &self.cameras {
            outline(points, camera, self.view.lens, |at| outlines.push(at));
        }
        if self.cameras.len() > 1 {
            let start = self.cameras[0].0;
            let seen = |camera: &'a DMat4| points.iter().map(|p| camera.transform_point3(*p));
            let distance = seen(start).map(|p| self.deviations.distance.at(p)).fold(0.0, f64::max);
            for (camera, _) in &self.cameras {
                border_px = border_px.max(reach_px(seen(camera), distance, self.view.lens));
            }
        }
        Cover::new(outlines, border_px, self.tiles.0, self.tiles.1)
    }

    /// Where a part of an object is seen during the block.
    pub fn follow(&self, activity: Activity, hull: &Hull, deviations: &Deviations) -> Cover {
        let (object, view) = (activity.object(), self.view);
        match activity {
            Activity::Rests(_) => {
                let track = view.track(self.gpu_scene, activity, hull);
                self.cover(track.points())
            }
            Activity::Moves(_) if hull.is_rigid() => {
                let (mut outlines, mut border_px) = (Vec::new(), 0.0_f64);
                for (k, points) in view.track_at(self.gpu_scene, object, hull, view.ends()).iter() {
                    let camera = view.camera_from_world[k];
                    outline(points, camera, view.lens, |at| outlines.push(at));
                    let seen = points.iter().map(|p| camera.transform_point3(*p));
                    border_px = border_px.max(reach_px(seen, deviations.seen_from_ends.distance, view.lens));
                }
                Cover::new(outlines, border_px, self.tiles.0, self.tiles.1)
            }
            Activity::Moves(_) => {
                let mut area = Area::NOTHING;
                for (k, points) in view.track(self.gpu_scene, activity, hull).iter() {
                    area = area.join(seen(points, view.camera_from_world[k], view.lens));
                }
                Cover::of(&area, self.tiles.0, self.tiles.1)
            }
        }
    }

    /// How far a moving object may be from its tracks.
    pub fn deviations(&self, activity: Activity) -> Deviations {
        match activity {
            Activity::Rests(_) => Deviations::default(),
            Activity::Moves(moving) => self.view.deviations(moving, &self.pieces[moving.object()]),
        }
    }

    /// How the picture of a point that stands still goes about when the camera is at `index`: pixels per instant.
    fn drift(&self, index: usize, point: DVec3) -> DVec2 {
        let next = (index + 1).min(self.cameras.len() - 1);
        if next == 0 {
            return DVec2::ZERO;
        }
        let [(a, from), (b, to)] = [self.cameras[next - 1], self.cameras[next]];
        let lens = self.view.lens;
        let see = |camera: &DMat4| {
            let place = lens.project(lens.before_camera(camera.transform_point3(point)));
            place.unwrap_or(DVec2::NAN)
        };
        (see(b) - see(a)) / (to - from)
    }

    /// How much faster it may go at some instant: pixels per instant.
    fn shake_px(&self, camera: &DMat4, point: DVec3) -> f64 {
        let speed = self.deviations.speed.at(self.cameras[0].0.transform_point3(point));
        reach_px(std::iter::once(camera.transform_point3(point)), speed, self.view.lens)
    }
}

/// Whether a camera may look from between `low` and `high`: the near plane of an orthographic one may cut anything.
fn may_lie_between(eye: &Eye, low: DVec3, high: DVec3) -> bool {
    match *eye {
        Eye::At(eye) => (low - eye).max(eye - high).max_element() <= 0.0,
        Eye::Along(_) => true,
    }
}

/// How far outlines of something go in an instant.
#[derive(Clone, Copy)]
struct Motion {
    /// All of it.
    way: DVec3,
    /// How much farther, any way.
    rest: f64,
}

impl Motion {
    /// From what each of several parts does in each of several steps: its way, and how much farther it goes.
    fn new(steps: &[(DVec3, f64)]) -> Self {
        let way = steps.iter().map(|(way, _)| *way).sum::<DVec3>() / steps.len() as f64;
        Self { way, rest: steps.iter().map(|(by, rest)| by.distance(way) + rest).fold(0.0, f64::max) }
    }

    /// Of outlines of what is in a part of an object: as points of its track go, or as `all` of the object.
    fn of(track: &Track<'_>, deviations: &Deviations, all: Self) -> Self {
        if track.is_fixed() {
            return Self { way: DVec3::ZERO, rest: 0.0 };
        }
        let steps: Vec<(DVec3, f64)> = track
            .steps()
            .flat_map(|(from, to, instants)| {
                from.iter().zip(to).map(move |(a, b)| ((*b - *a) / instants, deviations.world.speed))
            })
            .collect();
        let own = Self::new(&steps);
        if own.rest < all.rest { own } else { all }
    }
}

/// Something in view, over the block.
pub struct Receiver<'a> {
    activity: Activity,
    extent: (DVec3, DVec3),
    /// Where it is seen.
    cover: Cover,
    pieces: &'a Pieces,
    deviations: Deviations,
    faces: OnceCell<Vec<PlacedFace>>,
}

struct PlacedFace {
    middle: DVec3,
    /// Points whose hull holds it.
    corners: Vec<DVec3>,
    /// Its extents along axes of the box and of the world.
    slabs: [(DVec3, [f64; 2]); 6],
    /// Unit normals of what is in it.
    normals: Vec<DVec3>,
    cover: Cover,
    motion: Motion,
    /// Whether nobody sees its inside.
    solid: bool,
}

impl<'a> Receiver<'a> {
    /// An object in view.
    pub fn new(scenery: &Scenery<'a>, activity: Activity) -> Self {
        let pieces: &'a Pieces = &scenery.pieces[activity.object()];
        let deviations = scenery.deviations(activity);
        let track = scenery.view.track(scenery.gpu_scene, activity, &pieces.whole);
        let (low, high) = bounds(track.points());
        let extent = (low - deviations.world.distance, high + deviations.world.distance);
        let cover = scenery.follow(activity, &pieces.whole, &deviations);
        Self { activity, extent, cover, pieces, deviations, faces: OnceCell::new() }
    }

    fn faces(&self, scenery: &Scenery<'_>) -> &[PlacedFace] {
        let object = self.activity.object();
        let world = DMat3::from_mat4(scenery.view.shared[0].world[object]);
        // Normals go by the inverse transpose; what is flattened to nothing has none.
        let turn = world.inverse().transpose();
        let turned = |n: &DVec3| (turn * *n).normalize_or_zero();
        let [x, y, z] = DVec3::AXES;
        let axes = [x, y, z, turned(&x), turned(&y), turned(&z)];
        let all = motion(scenery, self.pieces, self.activity, &self.deviations);
        // A closed surface with all cameras outside shows no insides.
        let closed = self.pieces.swing.is_finite();
        let (low, high) = self.extent;
        let inside = |eye: &Eye| may_lie_between(eye, low, high);
        let solid = closed && !scenery.eyes.iter().any(inside);
        let place = |face: &Face| {
            let track = scenery.view.track(scenery.gpu_scene, self.activity, &face.hull);
            let motion = Motion::of(&track, &self.deviations, all);
            let cover = scenery.follow(self.activity, &face.hull, &self.deviations);
            let corners = track.into_points();
            let slab = |axis: DVec3| {
                let [low, high] = extent(&corners, axis);
                (axis, [low - self.deviations.world.distance, high + self.deviations.world.distance])
            };
            PlacedFace {
                middle: corners.iter().sum::<DVec3>() / corners.len() as f64,
                slabs: axes.map(slab),
                normals: face.normals.iter().map(turned).collect(),
                cover,
                motion,
                solid,
                corners,
            }
        };
        let shown = |face: &PlacedFace| face.cover.count() > 0 && face.is_seen(scenery);
        self.faces.get_or_init(|| self.pieces.faces.iter().map(place).filter(shown).collect())
    }
}

impl PlacedFace {
    /// Whether it may be before the camera's eyes and no inside.
    fn is_seen(&self, scenery: &Scenery<'_>) -> bool {
        let front = |n: &DVec3, p: &DVec3| scenery.eyes.iter().any(|eye| n.dot(eye.toward(*p)) <= 0.0);
        !self.solid || self.normals.iter().any(|n| self.corners.iter().any(|p| front(n, p)))
    }

    /// Per normal that faces both the light and the camera somewhere: along which way, and how far per metre along it, a
    /// shadow slides.
    fn slopes(&self, scenery: &Scenery<'_>, lamp: &Lamp) -> Vec<DVec3> {
        let least = if self.normals.len() > 1 { LEAST_COSINE_CURVED } else { LEAST_COSINE };
        let slope = |n: &DVec3| {
            let sides = |p: &DVec3| {
                let lit = n.dot(lamp.direction(*p));
                let seen = |eye: &Eye| {
                    let seen = n.dot(eye.toward(*p));
                    lit * seen > 0.0 && !(self.solid && lit > 0.0)
                };
                scenery.eyes.iter().any(seen)
            };
            let cosine = n.dot(lamp.direction(self.middle));
            let cosine = cosine.abs().max(least).copysign(cosine);
            self.corners.iter().any(sides).then(|| *n / cosine)
        };
        self.normals.iter().filter_map(slope).collect()
    }
}

/// How outlines of an object move, wherever they are.
fn motion(scenery: &Scenery<'_>, pieces: &Pieces, activity: Activity, deviations: &Deviations) -> Motion {
    let (object, view) = (activity.object(), scenery.view);
    if !pieces.whole.is_rigid() {
        return Motion { way: DVec3::ZERO, rest: f64::INFINITY };
    }
    let step = |pair: &[usize]| {
        let [before, now] = [pair[0], pair[1]].map(|k| &view.shared[k].world[object]);
        let instants = (pair[1] - pair[0]) as f64;
        if before == now {
            return (DVec3::ZERO, deviations.world.speed);
        }
        let [from, to] = [before, now].map(|world| world.transform_point3(pieces.middle));
        // Its turn in its own frame at the first moment.
        let by = DMat3::from_mat4(before.inverse() * *now) - DMat3::IDENTITY;
        let turn = 0.5 * (by - by.transpose());
        let turn = DVec3::new(turn.y_axis.z, turn.z_axis.x, turn.x_axis.y).abs();
        let bend = 0.5 * (by + by.transpose());
        let bend = bend.to_cols_array().iter().map(|v| v * v).sum::<f64>().sqrt();
        // An infinite swing times no turn is none.
        let turned: f64 = (0..3).filter(|&i| turn[i] > 0.0).map(|i| turn[i] * pieces.swing[i]).sum();
        // No less than the greatest singular value.
        let axes = DMat3::from_mat4(*before);
        let gram = (axes.transpose() * axes).to_cols_array_2d();
        let scale = gram.iter().map(|row| row.iter().map(|v| v.abs()).sum()).fold(0.0, f64::max).sqrt();
        let rest = scale * (turned + bend * pieces.radius) / instants + deviations.world.speed;
        ((to - from) / instants, rest)
    };
    let steps: Vec<(DVec3, f64)> = view.moments().windows(2).map(step).collect();
    Motion::new(&steps)
}

/// Adds what shadows of a moving object require that may move on `receivers` during the block.
pub fn shadows(
    scenery: &Scenery<'_>,
    caster: Moving,
    receivers: &[Receiver<'_>],
    needs: &mut Needs,
    step_px: f64,
) {
    let activity = Activity::Moves(caster);
    let pieces = &scenery.pieces[caster.object()];
    let deviations = scenery.deviations(activity);
    let all = motion(scenery, pieces, activity, &deviations);
    let placed = |hull: &Hull| {
        let track = scenery.view.track(scenery.gpu_scene, activity, hull);
        let (low, high) = bounds(track.points());
        let by = DVec3::splat(deviations.world.distance);
        (corners(low - by, high + by), Motion::of(&track, &deviations, all))
    };
    let whole = placed(&pieces.whole);
    let parts: Vec<(Corners, Motion)> = pieces.casters.iter().map(placed).collect();
    for lamp in &scenery.view.shared[0].lamps {
        let grown = |(corners, motion): &(Corners, Motion)| Some((lamp.grown(corners)?, *motion));
        let reached = receivers.iter().filter(|r| lamp.shadow(&whole.0, r.extent).is_some());
        let Some(whole) = grown(&whole) else {
            reached.for_each(|receiver| needs.add(receiver.cover.tiles(), f64::INFINITY));
            continue;
        };
        // A light in a box of a body is in the body's too.
        let parts: Vec<(Corners, Motion)> = parts.iter().filter_map(grown).collect();
        for receiver in reached {
            for face in receiver.faces(scenery) {
                let Some((cover, prism)) = fall(scenery, lamp, &whole.0, face) else { continue };
                let slopes = face.slopes(scenery, lamp);
                let need = |motion: &Motion, prism: &Prism| {
                    speed(scenery, lamp, prism, motion, face, &slopes) / step_px
                };
                let most = need(&whole.1, &prism);
                if cover.count() <= FEW_TILES || needs.meets(&cover, most) {
                    needs.add(cover.tiles(), most);
                    continue;
                }
                for (part, motion) in &parts {
                    if let Some((cover, prism)) = fall(scenery, lamp, part, face) {
                        needs.add(cover.tiles(), need(motion, &prism));
                    }
                }
            }
        }
    }
}

/// Corners of what light goes through, and how much longer what goes across it is there than where it is thrown.
type Prism = [(DVec3, f64); 16];

/// Where the shadow of `caster` may fall on `face`, in the picture and in the world.
fn fall(scenery: &Scenery<'_>, lamp: &Lamp, caster: &Corners, face: &PlacedFace) -> Option<(Cover, Prism)> {
    let reach = lamp.reach(caster, &face.slabs)?;
    let prism: Prism = std::array::from_fn(|i| {
        let by = reach[i / 8];
        (lamp.carry(caster[i % 8], by), lamp.growth(by))
    });
    let cover = scenery.cover(&prism.map(|(point, _)| point)).meet(&face.cover);
    (cover.count() > 0).then_some((cover, prism))
}

/// How fast a shadow goes in the picture within the hull of `prism` on `face`: pixels per instant. What throws it goes as
/// `motion` says, which at each corner of the prism is so many times as far.
fn speed(
    scenery: &Scenery<'_>,
    lamp: &Lamp,
    prism: &Prism,
    motion: &Motion,
    face: &PlacedFace,
    slopes: &[DVec3],
) -> f64 {
    let mut fastest: f64 = 0.0;
    for (point, growth) in prism {
        let along = lamp.direction(*point);
        let (right, up) = along.any_orthonormal_pair();
        let way = *growth * motion.way;
        let rest = growth * motion.rest;
        for (index, (camera, _)) in scenery.cameras.iter().enumerate() {
            let drift = scenery.drift(index, *point);
            let shake_px = scenery.shake_px(camera, *point);
            let [across, up_px, right_px, ahead] = [way, up, right, along].map(|by| {
                let [at, by] = [camera.transform_point3(*point), camera.transform_vector3(by)];
                scenery.view.lens.image_motion(at, by)
            });
            for slope in slopes {
                // Along the light to where the surface is.
                let known = drift + across + slope.dot(face.motion.way - way) * ahead;
                // Which way the rest goes is not known: the greatest singular value.
                let [a, b] = [right_px - slope.dot(right) * ahead, up_px - slope.dot(up) * ahead];
                let (aa, bb) = (a.length_squared(), b.length_squared());
                let most = (0.5 * (aa + bb + (aa - bb).hypot(2.0 * a.dot(b)))).sqrt();
                let face_rest = face.motion.rest * slope.length() * ahead.length();
                fastest = fastest.max(known.length() + rest * most + face_rest + shake_px);
            }
        }
    }
    fastest
}
