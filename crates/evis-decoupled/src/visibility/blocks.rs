//! Blocks of time, and screen-space motion within one as quadratics.
//!
//! Borders lie on an absolute dyadic grid, joined by the times at which a scene's motion or light bends or jumps.
//! Within a block a vertex's homogeneous image point h = (x z, y z, z) is a quadratic in time through its exact places
//! at the start, middle and end. What that leaves out is measured at the quarters, near where the remainder of a smooth
//! motion is largest, on what the camera sees of the surface's box; where it exceeds [`MAX_ERROR_PX`], the surface's part of the
//! block is halved, for itself alone.

use std::collections::VecDeque;

use evis_scene::{Scene, Variant};
use glam::{DMat3, DVec3};

use crate::Error;
use crate::scene::facets::corners;
use crate::scene::screen::Screen;
use crate::scene::world::{Frame, World};

/// Largest error of what is seen of a surface's box within a block, in pixels, at the quarters of a span.
pub const MAX_ERROR_PX: f64 = 2e-3;
/// Largest error of what is seen of any facet, at any time: this is what tests hold.
pub const BOUND_PX: f64 = 1e-2;
/// Part of the picture's size beyond each of its sides in which errors count, too: what is seen moves meanwhile.
const BESIDE: f64 = 0.125;
/// Depth in metres at which errors of what lies nearer are measured.
const LEAST_DEPTH: f64 = 0.1;
/// A surface's part of a block is halved this often at most.
const MAX_HALVINGS: u32 = 6;
/// How long before a border its left-hand limit is taken, in microseconds.
const BEFORE_US: f64 = 1e-3;
/// How long after a border its right-hand limit is taken: beyond rounding, and too short for anything to move.
const AFTER_US: f64 = 1e-5;

/// A stream's first block ends at a multiple of this, in microseconds.
const FIRST_US: f64 = 2048.0;

/// A half-open interval of scene time within which nothing jumps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Block {
    /// Start in microseconds.
    pub start_us: f64,
    /// End in microseconds.
    pub end_us: f64,
    /// Light may jump at its start.
    pub jump: bool,
}

impl Block {
    /// Time at `u` in [0, 1]; 0 and 1 are the limits from within: at an edge of a square wave rounding would decide.
    pub fn at(&self, u: f64) -> f64 {
        let t_us = self.start_us + u * (self.end_us - self.start_us);
        t_us.max(self.start_us + AFTER_US).min(self.end_us - BEFORE_US)
    }

    /// Length in microseconds.
    pub fn length_us(&self) -> f64 {
        self.end_us - self.start_us
    }
}

/// The blocks that cover [start, end): borders are multiples of `length_us`, and what [`Scene::break_times`] finds; where a host moves
/// nodes, multiples from the start on, and its poses.
pub fn blocks(
    scene: &Scene,
    variant: Option<&Variant>,
    start_us: f64,
    end_us: f64,
    length_us: i64,
) -> Vec<Block> {
    let length = length_us as f64;
    let mut borders = vec![start_us, end_us];
    // What a host moves begins when it says so.
    let origin_us = if scene.host_poses.is_some() { start_us } else { 0.0 };
    let mut k = ((start_us - origin_us) / length).floor() + 1.0;
    while origin_us + k * length < end_us {
        borders.push(origin_us + k * length);
        k += 1.0;
    }
    let jumps = scene.break_times(variant, start_us, end_us);
    borders.extend_from_slice(&jumps);
    borders.extend(host_times(scene, variant, start_us, end_us));
    borders.sort_by(f64::total_cmp);
    // Nearer than two left-hand limits, two borders are one.
    borders.dedup_by(|b, a| *b - *a < 2.0 * BEFORE_US);
    borders
        .windows(2)
        .map(|w| Block {
            start_us: w[0],
            end_us: w[1],
            jump: jumps.iter().any(|j| (j - w[0]).abs() < 2.0 * BEFORE_US),
        })
        .collect()
}

/// The blocks of an environment from a time on, one after another.
///
/// They are found a part of a stream at a time, and are the same whatever its length. Where a host moves nodes, they are found
/// when it has given all poses ([`evis_scene::HostPoses::known_until_us`]) of such a part, whose length it says.
pub struct Blocks<'w, 'a> {
    world: &'w World<'a>,
    length_us: i64,
    /// See [`Blocks::new`].
    pose_step_us: i64,
    found: VecDeque<Block>,
    /// Where those end that were found.
    found_until_us: f64,
    /// Light may jump at the start of the next one, whatever the scene says.
    jump: bool,
}

impl<'w, 'a> Blocks<'w, 'a> {
    /// From `start_us` on; borders are multiples of `most_us`, or of a shorter length where motion is fast
    /// ([`World::block_us`]), what [`Scene::break_times`] finds, and the first multiple of `FIRST_US`. Where a host moves nodes, poses are
    /// known at every multiple of `pose_step_us` after `start_us`, and borders lie there: then they are where they would be
    /// had the stream begun at any of them.
    pub fn new(world: &'w World<'a>, start_us: i64, most_us: i64, pose_step_us: i64) -> Self {
        let length_us = world.block_us(most_us);
        let mut made = Self {
            world,
            length_us,
            pose_step_us,
            found: VecDeque::new(),
            found_until_us: start_us as f64,
            jump: false,
        };
        made.find();
        // What comes first is waited for: it takes a block of its own.
        if let Some(&whole) = made.found.front().filter(|_| world.scene.host_poses.is_none()) {
            let border = ((whole.start_us / FIRST_US).floor() + 1.0) * FIRST_US;
            if border + FIRST_US < whole.end_us {
                made.found[0] = Block { start_us: border, jump: false, ..whole };
                made.found.push_front(Block { end_us: border, ..whole });
            }
        }
        made
    }

    /// Where the next one starts.
    pub fn start_us(&self) -> f64 {
        self.found.front().map_or(self.found_until_us, |block| block.start_us)
    }

    /// The next one; where a host's poses are not known yet, a short one in which nothing moves.
    pub fn peek(&self) -> Block {
        let start_us = self.start_us();
        let rest = Block { start_us, end_us: start_us + FIRST_US, jump: false };
        self.found.front().copied().unwrap_or(rest)
    }

    /// Takes the next one; `None` where a host's poses are not known yet.
    pub fn pop(&mut self) -> Option<Block> {
        if self.found.is_empty() {
            self.find();
        }
        let block = self.found.pop_front()?;
        Some(Block { jump: block.jump | std::mem::take(&mut self.jump), ..block })
    }

    /// Whether light may jump where the next one starts; not yet known, and taken for no, of what a host moves.
    pub fn next_jumps(&mut self) -> bool {
        if self.found.is_empty() {
            self.find();
        }
        self.jump || self.found.front().is_some_and(|block| block.jump)
    }

    /// Says that at the start of the next one things are elsewhere all at once.
    pub fn jump(&mut self) {
        self.jump = true;
    }

    /// Finds those from where the last ones end to the next multiple of the length.
    fn find(&mut self) {
        let from_us = self.found_until_us;
        let length = self.length_us as f64;
        let World { scene, variant, .. } = self.world;
        // A border that is no multiple may lie as near to one as two borders can.
        let mut end_us = (((from_us + 2.0 * BEFORE_US) / length).floor() + 1.0) * length;
        if let Some(host) = &scene.host_poses {
            end_us = from_us + self.pose_step_us as f64;
            if end_us > host.known_until_us() as f64 {
                return;
            }
        }
        self.found.extend(blocks(scene, *variant, from_us, end_us, self.length_us));
        self.found_until_us = end_us;
        let near = [from_us - 2.0 * BEFORE_US, from_us + 2.0 * BEFORE_US];
        self.found[0].jump |= !scene.break_times(*variant, near[0], near[1]).is_empty();
    }
}

/// Times in (start, end), in microseconds, at which what a host moves has a pose, and its motion bends.
fn host_times(scene: &Scene, variant: Option<&Variant>, start_us: f64, end_us: f64) -> Vec<f64> {
    let tracks = (0..scene.nodes.len()).filter_map(|node| scene.track_of(variant, node));
    tracks.flat_map(|track| track.times(start_us, end_us)).collect()
}

/// Where one surface's vertices go during a part of a block.
#[derive(Clone, Debug)]
pub struct Span {
    /// Part of the block, in its u.
    pub u: [f64; 2],
    /// Where vertices are at the start, middle and end of the span.
    pub places: Places,
    /// Error at the quarters, in pixels; above [`MAX_ERROR_PX`] where halving did not suffice.
    pub error_px: f64,
}

/// Homogeneous image points at three times.
#[derive(Clone, Debug)]
pub enum Places {
    /// Of a rigid surface: screen from its own space.
    Rigid(Box<[Screen; 3]>),
    /// Of a deforming one: per vertex.
    Vertices(Vec<[DVec3; 3]>),
}

impl Places {
    /// Image points of vertex `vertex`, at `position` in the surface's own space, at the three times.
    pub fn of(&self, vertex: u32, position: DVec3) -> [DVec3; 3] {
        match self {
            Self::Rigid(screens) => screens.each_ref().map(|screen| screen.point(position)),
            Self::Vertices(vertices) => vertices[vertex as usize],
        }
    }
}

/// A scene at the times that a block needs, each evaluated once.
pub struct Clock<'w, 'a> {
    world: &'w World<'a>,
    block: Block,
    /// By u in units of 1 / 2^(MAX_HALVINGS + 2).
    frames: std::collections::BTreeMap<u32, Frame>,
}

const UNITS: u32 = 1 << (MAX_HALVINGS + 2);

impl<'w, 'a> Clock<'w, 'a> {
    /// The scene during `block`.
    pub fn new(world: &'w World<'a>, block: Block) -> Self {
        Self { world, block, frames: Default::default() }
    }

    /// The scene at `unit` of [`UNITS`] of the block.
    fn frame(&mut self, unit: u32) -> Result<&Frame, Error> {
        use std::collections::btree_map::Entry;
        let t_us = self.block.at(f64::from(unit) / f64::from(UNITS));
        Ok(match self.frames.entry(unit) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(slot) => slot.insert(self.world.frame(t_us)?),
        })
    }

    /// The scene at the start and at the end of the block.
    ///
    /// # Errors
    /// A camera without a pose.
    pub fn ends(&mut self) -> Result<[Frame; 2], Error> {
        Ok([self.frame(0)?.clone(), self.frame(UNITS)?.clone()])
    }

    /// The scene at the start, middle and end of the block.
    ///
    /// # Errors
    /// A camera without a pose.
    pub fn thirds(&mut self) -> Result<[Frame; 3], Error> {
        Ok([self.frame(0)?.clone(), self.frame(UNITS / 2)?.clone(), self.frame(UNITS)?.clone()])
    }

    /// Motion of surface `surface` during the block.
    ///
    /// # Errors
    /// A camera without a pose.
    pub fn spans(&mut self, surface: u32) -> Result<Vec<Span>, Error> {
        let mut out = Vec::with_capacity(1);
        self.split(surface, [0, UNITS], &mut out)?;
        Ok(out)
    }

    fn split(&mut self, surface: u32, [from, to]: [u32; 2], out: &mut Vec<Span>) -> Result<(), Error> {
        let quarter = (to - from) / 4;
        let units = [0, 1, 2, 3, 4].map(|k| from + k * quarter);
        let s = &self.world.surfaces[surface as usize];
        let (places, error_px) = if s.deforms {
            let mut at = Vec::with_capacity(5);
            for unit in units {
                let world = self.world;
                let frame = self.frame(unit)?;
                let vertices = world.vertices(surface, frame);
                let screen = frame.screen_from_world;
                at.push(vertices.into_iter().map(|(p, _)| screen.point(p)).collect::<Vec<_>>());
            }
            let near = self.frame(from)?.depths.near;
            let error = (0..at[0].len())
                .map(|v| [0, 1, 2, 3, 4].map(|k| at[k][v]))
                .map(|h| left_out(h, near))
                .fold(0.0, f64::max);
            (Places::Vertices((0..at[0].len()).map(|v| [at[0][v], at[2][v], at[4][v]]).collect()), error)
        } else {
            let node = s.node;
            let [low, high] = s.bounds;
            let mut at = [Screen::default(); 5];
            for (slot, unit) in at.iter_mut().zip(units) {
                let frame = self.frame(unit)?;
                *slot = frame.screen_from_world.after(&frame.world_from_node(node));
            }
            let near = self.frame(from)?.depths.near;
            let h = corners(low, high).map(|p| at.map(|screen| screen.point(p)));
            let mut error = h.map(|h| left_out(h, near)).into_iter().fold(0.0, f64::max);
            // Rays that are parallel have nothing behind them.
            if error > MAX_ERROR_PX && !at[0].is_parallel() {
                error = left_out_in_view(&h, self.world.seen(), near);
            }
            (Places::Rigid(Box::new([at[0], at[2], at[4]])), error)
        };
        if error_px > MAX_ERROR_PX && quarter > 1 {
            let middle = (from + to) / 2;
            self.split(surface, [from, middle], out)?;
            return self.split(surface, [middle, to], out);
        }
        let u = [from, to].map(|v| f64::from(v) / f64::from(UNITS));
        out.push(Span { u, places, error_px });
        Ok(())
    }
}

/// What the quadratic through `h` at 0, 1/2 and 1 leaves out of `h` at 1/4 and 3/4.
fn remainders(h: &[DVec3; 5]) -> [DVec3; 2] {
    // Lagrange's polynomials there.
    let first = h[0] * 0.375 + h[2] * 0.75 - h[4] * 0.125;
    let second = h[0] * -0.125 + h[2] * 0.75 + h[4] * 0.375;
    [h[1] - first, h[3] - second]
}

/// How far, in pixels, an image point `h` is from one that is off by `d`; what is nearer than `near` counts as if it were there.
fn miss(h: DVec3, d: DVec3, near: f64) -> f64 {
    let z = h.z.max(near).max(LEAST_DEPTH);
    let (x, y) = (h.x / z, h.y / z);
    (d.x - x * d.z).hypot(d.y - y * d.z) / z
}

/// How far, in pixels, the quadratic through `h` at 0, 1/2 and 1 is from `h` at 1/4 and 3/4.
fn left_out(h: [DVec3; 5], near: f64) -> f64 {
    let [first, second] = remainders(&h);
    miss(h[1], first, near).max(miss(h[3], second, near))
}

/// The same of what is seen of a box in the picture `seen` and beside it, from its corners' image points at the five times.
///
/// Image points before central rays, and what the quadratic leaves out of them, are affine in space. In pixels that is a quotient, and
/// largest at the corners of what is seen: of the parts of the box's faces in view, and where the view begins inside of it.
fn left_out_in_view(box_corners: &[[DVec3; 5]; 8], seen: [f64; 4], near: f64) -> f64 {
    let near = near.max(LEAST_DEPTH);
    let [left, top, right, bottom] = seen;
    let [beside, above] = [BESIDE * (right - left), BESIDE * (bottom - top)];
    let view = [left - beside, top - above, right + beside, bottom + above];
    // By time: how far inside of each side of the view a point is.
    let sides: [&dyn Fn(DVec3) -> f64; 5] = [
        &|h| h.z - near,
        &|h| h.x - view[0] * h.z,
        &|h| h.y - view[1] * h.z,
        &|h| view[2] * h.z - h.x,
        &|h| view[3] * h.z - h.y,
    ];
    let mut worst = 0.0_f64;
    let mut add = |corner: &[DVec3; 5], time: usize| {
        let of = |d: DVec3| miss(corner[time], d, near);
        worst = remainders(corner).map(of).into_iter().fold(worst, f64::max);
    };
    let between = |a: &[DVec3; 5], b: &[DVec3; 5], part: f64| -> [DVec3; 5] {
        std::array::from_fn(|k| a[k] + (b[k] - a[k]) * part)
    };
    let mut polygon = Vec::new();
    let mut rest = Vec::new();
    for time in 0..5 {
        for face in FACES_OF_BOX {
            polygon.clear();
            polygon.extend(face.map(|corner| box_corners[corner]));
            for side in sides {
                rest.clear();
                for (k, a) in polygon.iter().enumerate() {
                    let b = &polygon[(k + 1) % polygon.len()];
                    let [own, next] = [a, b].map(|corner| side(corner[time]));
                    if own >= 0.0 {
                        rest.push(*a);
                    }
                    if (own >= 0.0) != (next >= 0.0) {
                        rest.push(between(a, b, own / (own - next)));
                    }
                }
                std::mem::swap(&mut polygon, &mut rest);
            }
            polygon.iter().for_each(|corner| add(corner, time));
        }
        // Where the view begins, as parts of the box's edges.
        let [origin, along @ ..] = [0, 1, 2, 4].map(|corner| &box_corners[corner]);
        let from_parts = DMat3::from_cols_array_2d(&along.map(|h| (h[time] - origin[time]).to_array()));
        if from_parts.determinant() == 0.0 {
            continue;
        }
        let to_parts = from_parts.inverse();
        for [x, y] in [[0, 1], [2, 1], [2, 3], [0, 3]].map(|sides| sides.map(|side| view[side])) {
            let parts = to_parts * (DVec3::new(x, y, 1.0) * near - origin[time]);
            if (parts.cmpge(DVec3::ZERO) & parts.cmple(DVec3::ONE)).all() {
                let place = |k: usize| {
                    let [s, t, r] = along.map(|h| h[k] - origin[k]);
                    origin[k] + s * parts.x + t * parts.y + r * parts.z
                };
                add(&std::array::from_fn(place), time);
            }
        }
    }
    worst
}

/// Corners of a box's faces, as [`corners`] has them.
const FACES_OF_BOX: [[usize; 4]; 6] =
    [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];

#[cfg(test)]
mod tests {
    use super::*;

    fn warehouse() -> Scene {
        evis_scene::builtin::load("warehouse", 0).unwrap()
    }

    #[test]
    fn a_hosts_steps_and_poses_are_borders() {
        let mut scene = evis_scene::builtin::load("spinner", 0).unwrap();
        let host = scene.drive(&["square".into()], 700).unwrap();
        let world = World::new(&scene, 0, Some((8, 6))).unwrap();
        let mut found = Blocks::new(&world, 700, 8192, 10_000);
        assert_eq!(found.pop(), None, "nothing is known yet");
        let pose = |t_us: i64| evis_scene::HostPose::new(t_us, [0.0, 0.0, -2.8], [0.0, 0.0, 0.0, 1.0], None);
        let step =
            evis_scene::HostStep { poses: &[(0, 0, vec![pose(3700), pose(20_700)])], ..Default::default() };
        host.advance(&step, 20_700).unwrap();
        let all = |found: &mut Blocks| std::iter::from_fn(|| found.pop()).collect::<Vec<_>>();
        let first = all(&mut found);
        let borders: Vec<f64> = first.iter().map(|b| b.end_us).collect();
        assert_eq!(borders, [3700.0, 8892.0, 10_700.0, 18_892.0, 20_700.0]);
        assert!(first.iter().all(|b| !b.jump));
        // What is hidden is gone all at once.
        let visible = [(0, 0, vec![(25_700, false), (30_700, true)])];
        host.advance(&evis_scene::HostStep { visible: &visible, ..Default::default() }, 30_700).unwrap();
        let jumps = all(&mut found).iter().filter(|b| b.jump).map(|b| b.start_us).collect::<Vec<_>>();
        assert_eq!(jumps, [20_700.0, 25_700.0]);
    }

    #[test]
    fn borders_are_absolute_and_joined_by_jumps() {
        let scene = warehouse();
        let all = blocks(&scene, None, 0.0, 1e6, 8192);
        let later = blocks(&scene, None, 300_000.0, 700_000.0, 8192);
        // What begins later has the same borders inside.
        for b in &later[1..] {
            assert!(all.iter().any(|a| a.start_us == b.start_us), "{b:?}");
        }
        assert!(all.windows(2).all(|w| w[0].end_us == w[1].start_us));
        // The beacon: 4 Hz, 0.3 of a cycle lit.
        for jump in [75_000.0, 250_000.0] {
            let found = all.iter().find(|b| (b.start_us - jump).abs() < 0.01).map(|b| b.jump);
            assert_eq!(found, Some(true), "{jump}");
        }
        assert!(!all[1].jump);
        // One after another they are the same, wherever a stream begins.
        let world = World::new(&scene, 0, Some((8, 6))).unwrap();
        for (start_us, first_ends_us) in [(0, Some(2048.0)), (300_000, None), (250_000, None)] {
            let mut found = Blocks::new(&world, start_us, 8192, 1);
            let mut wanted = blocks(&scene, None, start_us as f64, 500_000.0, 8192);
            // But for the first one, where there is room for a short one before it.
            if let Some(border) = first_ends_us {
                let rest = Block { start_us: border, jump: false, ..wanted[0] };
                wanted[0].end_us = border;
                wanted.insert(1, rest);
            }
            for (index, want) in wanted[..wanted.len() - 1].iter().enumerate() {
                let next = found.pop().unwrap();
                // A whole run does not know what was before it.
                let jump = if index == 0 { next.jump } else { want.jump };
                assert_eq!(next, Block { jump, ..*want });
                assert!(start_us != 250_000 || index > 0 || next.jump);
            }
        }
        // Four turns a block would look like rest.
        let spinner = evis_scene::builtin::load("spinner", 0).unwrap();
        let fast = spinner.clone().at_speed(400.0).unwrap();
        let [usual, short] =
            [&spinner, &fast].map(|s| World::new(s, 0, Some((8, 6))).unwrap().block_us(32_768));
        assert!(usual == 32_768 && short <= 1024, "{usual}, {short}");
        let fast = scene.clone().at_speed(4.0).unwrap();
        assert!(fast.break_times(None, 0.0, 1e6).iter().any(|t| (t - 18_750.0).abs() < 0.01));
        // An environment whose clock is ahead meets them earlier.
        let ahead = Variant { time_offset_s: 0.05, ..Variant::default() };
        let early = scene.break_times(Some(&ahead), 0.0, 1e6);
        assert!(early.iter().any(|t| (t - 25_000.0).abs() < 0.01), "{early:?}");
    }

    /// Largest error in pixels of the quadratics over places of all facets that are in the picture, and how many places and spans
    /// there were.
    fn worst(world: &World, block: Block) -> (f64, usize, usize) {
        const PLACES: [[f64; 2]; 5] = [[0.0, 0.0], [0.5, 0.5], [0.25, 0.5], [0.5, 0.25], [0.1, 0.2]];
        let mut clock = Clock::new(world, block);
        let (mut worst, mut places, mut spans) = (0.0_f64, 0, 0);
        let [left, top, right, bottom] = world.seen();
        for (index, surface) in world.surfaces.iter().enumerate() {
            let primitive = world.primitive(index as u32);
            let facets = || world.clusters[surface.clusters.clone()].iter().flat_map(|c| c.facets.clone());
            for span in clock.spans(index as u32).unwrap() {
                spans += 1;
                for k in 0..23 {
                    let v = (f64::from(k) + 0.5) / 23.0;
                    let t_us = block.at(span.u[0] + v * (span.u[1] - span.u[0]));
                    let frame = world.frame(t_us).unwrap();
                    let vertices = world.vertices(index as u32, &frame);
                    let quadratic = |[a, b, c]: [DVec3; 3]| {
                        let (l0, l1, l2) =
                            ((1.0 - v) * (1.0 - 2.0 * v), 4.0 * v * (1.0 - v), v * (2.0 * v - 1.0));
                        a * l0 + b * l1 + c * l2
                    };
                    for facet in facets().step_by(1 + facets().count() / 50) {
                        let [a, b, _, d] = world.facets[facet].corners;
                        let exact = [a, b, d].map(|c| vertices[c as usize].0);
                        let found = [a, b, d].map(|c| {
                            let place = crate::scene::facets::wide(primitive.positions[c as usize]);
                            quadratic(span.places.of(c, place))
                        });
                        for [s, t] in PLACES {
                            let at = |p: [DVec3; 3]| p[0] + (p[1] - p[0]) * s + (p[2] - p[0]) * t;
                            let (h, q) = (frame.screen_from_world.point(at(exact)), at(found));
                            let [x, y] = [h.x / h.z, h.y / h.z];
                            let is_seen = h.z > frame.depths.near
                                && (left..right).contains(&x)
                                && (top..bottom).contains(&y);
                            if is_seen {
                                worst = worst.max((q.x / q.z - x).hypot(q.y / q.z - y));
                                places += 1;
                            }
                        }
                    }
                }
            }
        }
        (worst, places, spans)
    }

    #[test]
    fn quadratics_stay_within_their_bound() {
        for name in ["warehouse", "spinner", "street"] {
            let scene = evis_scene::builtin::load(name, 0).unwrap();
            // Twenty times as fast, so that records split; most of the street goes straight.
            for (speed, length_us) in [(1.0, 8192.0), (1.0, 32_768.0), (20.0, 8192.0)] {
                let block = Block { start_us: 40_960.0, end_us: 40_960.0 + length_us, jump: false };
                let scene = scene.clone().at_speed(speed).unwrap();
                let world = World::new(&scene, 0, Some((320, 240))).unwrap();
                let (error, places, spans) = worst(&world, block);
                let surfaces = world.surfaces.len();
                assert!(error < BOUND_PX, "{name} at {speed}, {length_us} us: {error} px");
                assert!(places > 100, "{name}: {places} places are seen");
                // What lies beside the camera or behind it splits nothing.
                let splits = speed > 1.0 && name != "street";
                assert_eq!(spans > surfaces, splits, "{name} at {speed}: {spans} spans of {surfaces}");
            }
        }
        // Canary: without splitting the bound does not hold.
        let scene = evis_scene::builtin::load("spinner", 0).unwrap().at_speed(100.0).unwrap();
        let world = World::new(&scene, 0, Some((320, 240))).unwrap();
        let frames = [0.0, 0.25, 0.5, 0.75, 1.0].map(|u| world.frame(40_960.0 + 8192.0 * u).unwrap());
        let node = world.surfaces[1].node;
        let h = frames
            .map(|f| f.screen_from_world.after(&f.world_from_node(node)).point(world.surfaces[1].bounds[0]));
        assert!(left_out(h, 0.01) > BOUND_PX);
    }
}
