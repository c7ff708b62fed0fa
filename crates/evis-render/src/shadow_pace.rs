//! Where shadows of what moves fall during a block, and how fast they go there.
//!
//! A body throws its shadow as a few boxes around its parts, and faces of what is in view receive it: boxes around triangles
//! that face about one way. Light through a box of the one passes a box of the other within a short part of its way, so the
//! shadow lies in a small prism, of which the tiles are known, and goes as corners of the box do when they are carried there.
//! On a surface that is not at right angles to the light it goes farther: it slides along the light.

use std::cell::OnceCell;

use glam::{DMat3, DMat4, DVec2, DVec3};

use crate::area::{Corners, bounds, corners, outline};
use crate::cover::Cover;
use crate::gpu_scene::GpuScene;
use crate::lamp::{Lamp, extent};
use crate::pace::{Needs, Passing, places};
use crate::pieces::{Extent, Face, Pieces};
use crate::view::PixelLens;

/// Cosine of the incidence below which a shadow is not taken to slide any farther: the light that it takes away there is as
/// much less. On what is curved light comes in at every angle somewhere.
const LEAST_COSINE: f64 = 0.2;
const LEAST_COSINE_CURVED: f64 = 0.5;
/// Tiles of a shadow that are not worth being told apart.
const FEW_TILES: usize = 4;

/// A view during a block, as shadows need it.
pub struct Scenery<'a> {
    /// The view.
    pub view: &'a Passing<'a>,
    /// Moments at which things are looked at.
    pub moments: &'a [usize],
    /// Tiles per row and column.
    pub tiles: (u32, u32),
    /// The camera at the first, the middle and the last moment, and when; once where it stands still.
    cameras: Vec<(&'a DMat4, f64)>,
    eyes: Vec<DVec3>,
}

impl<'a> Scenery<'a> {
    /// At `moments`.
    pub fn new(view: &'a Passing<'a>, moments: &'a [usize], tiles: (u32, u32)) -> Self {
        let at = thirds(moments.len()).map(|i| moments[i]);
        let mut cameras = at.map(|k| (view.camera_from_world[k], k as f64)).to_vec();
        cameras.dedup_by(|a, b| a.0 == b.0);
        let eyes = cameras.iter().map(|(camera, _)| camera.inverse().w_axis.truncate()).collect();
        Self { view, moments, tiles, cameras, eyes }
    }

    /// Where the hull of `points` is seen during the block.
    pub fn cover(&self, points: &[DVec3]) -> Cover {
        let mut outlines = Vec::new();
        for (camera, _) in &self.cameras {
            outline(points, camera, self.view.lens, |at| outlines.push(at));
        }
        Cover::new(outlines, self.tiles.0, self.tiles.1)
    }

    /// Where a box is seen during the block that is at `places` at the moments.
    pub fn follow(&self, places: &[Corners]) -> Cover {
        let mut outlines = Vec::new();
        for i in thirds(places.len()) {
            let camera = self.view.camera_from_world[self.moments[i]];
            outline(&places[i], camera, self.view.lens, |at| outlines.push(at));
        }
        Cover::new(outlines, self.tiles.0, self.tiles.1)
    }

    /// Corners of a box of object `o` at the moments; once where it stands still.
    fn places(&self, o: usize, extent: &Extent) -> Vec<Corners> {
        let of = |k: usize| self.view.shared[k].world[o];
        let still = self.moments.iter().all(|&k| of(k) == of(self.moments[0]));
        places(self.view, if still { &self.moments[..1] } else { self.moments }, o, extent)
    }

    /// Where the box is seen whose corners [`Self::places`] tells.
    fn see(&self, places: &[Corners]) -> Cover {
        if let [still] = places { self.cover(still) } else { self.follow(places) }
    }

    /// How the picture of a point that stands still goes about when the camera is at `index`: pixels per instant.
    fn drift(&self, index: usize, point: DVec3) -> DVec2 {
        let next = (index + 1).min(self.cameras.len() - 1);
        if next == 0 {
            return DVec2::ZERO;
        }
        let [(a, from), (b, to)] = [self.cameras[next - 1], self.cameras[next]];
        let see = |camera: &DMat4| {
            let p = camera.transform_point3(point);
            let [x, y] = self.view.lens.focal;
            DVec2::new(x * p.x, -y * p.y) / (-p.z).max(0.5 * self.view.lens.near)
        };
        (see(b) - see(a)) / (to - from)
    }

    /// Instants from each moment to the next.
    fn instants(&self) -> impl Iterator<Item = f64> + '_ {
        self.moments.windows(2).map(|pair| (pair[1] - pair[0]) as f64)
    }
}

/// The first, the middle and the last of so many: what lies between them lies within their hull.
const fn thirds(count: usize) -> [usize; 3] {
    [0, count / 2, count - 1]
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

    /// Of outlines of what is in a box of an object at `places`: as corners of the box go, or as `all` of the object.
    fn of(scenery: &Scenery<'_>, places: &[Corners], all: Self) -> Self {
        if places.len() == 1 {
            return Self { way: DVec3::ZERO, rest: 0.0 };
        }
        let pairs = places.windows(2).zip(scenery.instants());
        let steps: Vec<(DVec3, f64)> = pairs
            .flat_map(|(pair, instants)| (0..8).map(move |i| ((pair[1][i] - pair[0][i]) / instants, 0.0)))
            .collect();
        let own = Self::new(&steps);
        if own.rest < all.rest { own } else { all }
    }
}

/// How the picture of `point` goes when it goes along each of `ways`, in pixels per metre.
fn go<const N: usize>(camera: &DMat4, lens: &PixelLens, point: DVec3, ways: [DVec3; N]) -> [DVec2; N] {
    let p = camera.transform_point3(point);
    let depth = (-p.z).max(0.5 * lens.near);
    ways.map(|way| {
        let v = camera.transform_vector3(way);
        let [x, y] = lens.focal.map(|focal| focal / (depth * depth));
        DVec2::new(x * (v.x * depth + p.x * v.z), -y * (v.y * depth + p.y * v.z))
    })
}

/// Something in view, over the block.
pub struct Receiver<'a> {
    object: usize,
    extent: Extent,
    /// Where it is seen.
    cover: Cover,
    pieces: &'a Pieces,
    faces: OnceCell<Vec<PlacedFace>>,
}

struct PlacedFace {
    middle: DVec3,
    /// Corners of its box.
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
    /// Object `o` of `gpu_scene`; `None` where it deforms.
    pub fn new(scenery: &Scenery<'_>, gpu_scene: &GpuScene, pieces: &'a Pieces, o: usize) -> Option<Self> {
        let all = scenery.places(o, &gpu_scene.objects[o].extent?);
        let extent = bounds(all.as_flattened());
        Some(Self { object: o, extent, cover: scenery.see(&all), pieces, faces: OnceCell::new() })
    }

    fn faces(&self, scenery: &Scenery<'_>) -> &[PlacedFace] {
        let world = DMat3::from_mat4(scenery.view.shared[0].world[self.object]);
        // Normals go by the inverse transpose; what is flattened to nothing has none.
        let turn = world.inverse().transpose();
        let turned = |n: &DVec3| (turn * *n).normalize_or_zero();
        let [x, y, z] = DVec3::AXES;
        let axes = [x, y, z, turned(&x), turned(&y), turned(&z)];
        let all = motion(scenery, self.pieces, self.object);
        // A closed surface with all cameras outside shows no insides.
        let closed = self.pieces.swing.is_finite();
        let (low, high) = self.extent;
        let inside = |eye: &DVec3| (low - *eye).max(*eye - high).max_element() <= 0.0;
        let solid = closed && !scenery.eyes.iter().any(inside);
        let place = |face: &Face| {
            let places = scenery.places(self.object, &face.extent);
            let motion = Motion::of(scenery, &places, all);
            let cover = scenery.see(&places);
            let corners = places.into_flattened();
            PlacedFace {
                middle: corners.iter().sum::<DVec3>() / corners.len() as f64,
                slabs: axes.map(|axis| (axis, extent(&corners, axis))),
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
        let front = |n: &DVec3, p: &DVec3| scenery.eyes.iter().any(|eye| n.dot(*p - *eye) <= 0.0);
        !self.solid || self.normals.iter().any(|n| self.corners.iter().any(|p| front(n, p)))
    }

    /// Per normal that faces both the light and the camera somewhere: along which way, and how far per metre along it, a
    /// shadow slides.
    fn slopes(&self, scenery: &Scenery<'_>, lamp: &Lamp) -> Vec<DVec3> {
        let least = if self.normals.len() > 1 { LEAST_COSINE_CURVED } else { LEAST_COSINE };
        let slope = |n: &DVec3| {
            let sides = |p: &DVec3| {
                let lit = n.dot(lamp.direction(*p));
                let seen = |eye: &DVec3| {
                    let seen = n.dot(*p - *eye);
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

/// How outlines of object `o` move, wherever they are.
fn motion(scenery: &Scenery<'_>, pieces: &Pieces, o: usize) -> Motion {
    let step = |(pair, instants): (&[usize], f64)| {
        let [before, now] = [pair[0], pair[1]].map(|k| &scenery.view.shared[k].world[o]);
        if before == now {
            return (DVec3::ZERO, 0.0);
        }
        let [from, to] = [before, now].map(|world| world.transform_point3(pieces.middle));
        // Its turn in its own frame at the first moment.
        let by = DMat3::from_mat4(before.inverse() * *now) - DMat3::IDENTITY;
        let turn = 0.5 * (by - by.transpose());
        let turn = DVec3::new(turn.y_axis.z, turn.z_axis.x, turn.x_axis.y).abs();
        let bend = 0.5 * (by + by.transpose());
        let bend = bend.to_cols_array().iter().map(|v| v * v).sum::<f64>().sqrt();
        // Without end times nothing is nothing.
        let turned: f64 = (0..3).filter(|&i| turn[i] > 0.0).map(|i| turn[i] * pieces.swing[i]).sum();
        // No less than the greatest singular value.
        let axes = DMat3::from_mat4(*before);
        let gram = (axes.transpose() * axes).to_cols_array_2d();
        let scale = gram.iter().map(|row| row.iter().map(|v| v.abs()).sum()).fold(0.0, f64::max).sqrt();
        ((to - from) / instants, scale * (turned + bend * pieces.radius) / instants)
    };
    let steps: Vec<(DVec3, f64)> = scenery.moments.windows(2).zip(scenery.instants()).map(step).collect();
    Motion::new(&steps)
}

/// Adds what shadows of object `o` ask for that may move on `receivers` during the block.
pub fn shadows(
    scenery: &Scenery<'_>,
    pieces: &Pieces,
    o: usize,
    receivers: &[Receiver<'_>],
    needs: &mut Needs,
    step_px: f64,
) {
    let all = motion(scenery, pieces, o);
    let caster = |extent: &Extent| {
        let places = places(scenery.view, scenery.moments, o, extent);
        let (low, high) = bounds(places.as_flattened());
        (corners(low, high), Motion::of(scenery, &places, all))
    };
    let whole = caster(&pieces.extent);
    let parts: Vec<(Corners, Motion)> = pieces.casters.iter().map(caster).collect();
    for lamp in &scenery.view.shared[0].lamps {
        let grown = |(corners, motion): &(Corners, Motion)| Some((lamp.grown(corners)?, *motion));
        let reached = receivers.iter().filter(|r| lamp.shadow(&whole.0, r.extent).is_some());
        let Some(whole) = grown(&whole) else {
            reached.for_each(|receiver| needs.add_shadow(&receiver.cover, f64::INFINITY));
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
                    needs.add_shadow(&cover, most);
                    continue;
                }
                for (part, motion) in &parts {
                    if let Some((cover, prism)) = fall(scenery, lamp, part, face) {
                        needs.add_shadow(&cover, need(motion, &prism));
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
            let [across, up_px, right_px, ahead] =
                go(camera, scenery.view.lens, *point, [way, up, right, along]);
            for slope in slopes {
                // Along the light to where the surface is.
                let known = drift + across + slope.dot(face.motion.way - way) * ahead;
                // Which way the rest goes is not known: the greatest singular value.
                let [a, b] = [right_px - slope.dot(right) * ahead, up_px - slope.dot(up) * ahead];
                let (aa, bb) = (a.length_squared(), b.length_squared());
                let most = (0.5 * (aa + bb + (aa - bb).hypot(2.0 * a.dot(b)))).sqrt();
                let face_rest = face.motion.rest * slope.length() * ahead.length();
                fastest = fastest.max(known.length() + rest * most + face_rest);
            }
        }
    }
    fastest
}
