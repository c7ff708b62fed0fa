//! What of a view changes from one instant to the next: with a still camera under still lights, that is where something
//! moves or throws a moving shadow, and all else need not be drawn again.
//!
//! Nothing is guessed: a view is still where what its shaders read is equal byte for byte, an object where its pose and its
//! record are. So skipping changes no byte of a stream.

use std::mem::offset_of;

use evis_scene::{LightKind, Scene, SceneState};
use glam::{DMat4, DVec3};

use crate::gpu_scene::{DrawItem, GpuScene, Object};
use crate::shadow::LightView;
use crate::uniforms::{Frame, ObjectRecord};
use crate::view::PixelLens;

/// Pixels around what moves that are drawn too: samples reach half a pixel out, the rest is rounding's.
const MARGIN_PX: f64 = 2.0;
/// Texels around a shadow's border that it may reach: a look at a map takes 4x4 at most, up to two texels off its place.
const MARGIN_TEXELS: f64 = 8.0;
/// A part of a picture larger than this is not worth being drawn apart.
const LARGEST_PART: f64 = 0.7;

/// What of a view must be drawn at an instant, the rest being as it was at the instant before.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Change {
    /// Everything.
    #[default]
    All,
    /// These objects within these rectangles.
    Parts(Vec<(Rect, Vec<DrawItem>)>),
    /// Nothing.
    Nothing,
}

/// Whole pixels: from, and up to but not including.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rect {
    /// Left and upper.
    pub low: [u32; 2],
    /// Right and lower.
    pub high: [u32; 2],
}

impl Rect {
    /// All of a picture.
    pub const fn whole(width: u32, height: u32) -> Self {
        Self { low: [0, 0], high: [width, height] }
    }

    /// Width and height.
    pub const fn size(&self) -> [u32; 2] {
        [self.high[0] - self.low[0], self.high[1] - self.low[1]]
    }

    /// What of a picture of `width` and `height` lies outside of all `rects`.
    pub fn around(rects: &[Self], width: u32, height: u32) -> Vec<Self> {
        let mut rows: Vec<u32> =
            rects.iter().flat_map(|r| [r.low[1], r.high[1]]).chain([0, height]).collect();
        rows.sort_unstable();
        rows.dedup();
        let mut out = Vec::new();
        for band in rows.windows(2) {
            let [upper, lower] = [band[0], band[1]];
            let crosses = |r: &&Self| r.low[1] <= upper && lower <= r.high[1];
            let mut taken: Vec<[u32; 2]> =
                rects.iter().filter(crosses).map(|r| [r.low[0], r.high[0]]).collect();
            taken.sort_unstable();
            let mut left = 0;
            for [from, to] in taken.into_iter().chain([[width, width]]) {
                if from > left {
                    out.push(Self { low: [left, upper], high: [from, lower] });
                }
                left = left.max(to);
            }
        }
        out
    }
}

/// Part of the image plane, in pixels; nothing where `low > high`.
#[derive(Clone, Copy, Debug)]
struct Area {
    low: [f64; 2],
    high: [f64; 2],
}

impl Area {
    const NOTHING: Self = Self { low: [f64::INFINITY; 2], high: [f64::NEG_INFINITY; 2] };

    fn add(&mut self, [x, y]: [f64; 2]) {
        self.low = [self.low[0].min(x), self.low[1].min(y)];
        self.high = [self.high[0].max(x), self.high[1].max(y)];
    }

    fn join(self, other: Self) -> Self {
        Self {
            low: [0, 1].map(|i| self.low[i].min(other.low[i])),
            high: [0, 1].map(|i| self.high[i].max(other.high[i])),
        }
    }

    fn meet(self, other: Self) -> Self {
        Self {
            low: [0, 1].map(|i| self.low[i].max(other.low[i])),
            high: [0, 1].map(|i| self.high[i].min(other.high[i])),
        }
    }

    fn is_nothing(&self) -> bool {
        // Also where it is not a number.
        !(0..2).all(|i| self.low[i] <= self.high[i])
    }

    fn size(&self) -> f64 {
        if self.is_nothing() { 0.0 } else { (self.high[0] - self.low[0]) * (self.high[1] - self.low[1]) }
    }

    fn grown(self, by: f64) -> Self {
        Self { low: self.low.map(|v| v - by), high: self.high.map(|v| v + by) }
    }

    /// The pixels that it touches; `None` for none of them.
    fn pixels(&self, lens: &PixelLens) -> Option<Rect> {
        let size = [lens.width, lens.height];
        let low = [0, 1].map(|i| self.low[i].floor().clamp(0.0, f64::from(size[i])) as u32);
        let high = [0, 1].map(|i| self.high[i].ceil().clamp(0.0, f64::from(size[i])) as u32);
        (0..2).all(|i| low[i] < high[i]).then_some(Rect { low, high })
    }
}

/// A box in the world: its corners' hull.
type Corners = [DVec3; 8];

fn corners(low: DVec3, high: DVec3) -> Corners {
    std::array::from_fn(|i| {
        let pick = |bit: usize, low: f64, high: f64| if i >> bit & 1 == 0 { low } else { high };
        DVec3::new(pick(0, low.x, high.x), pick(1, low.y, high.y), pick(2, low.z, high.z))
    })
}

fn bounds(corners: &[DVec3]) -> (DVec3, DVec3) {
    let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    corners.iter().fold(start, |(low, high), corner| (low.min(*corner), high.max(*corner)))
}

/// Where the hull of `points` is seen; the part of it that lies before the camera.
fn seen(points: &[DVec3], camera_from_world: &DMat4, lens: &PixelLens) -> Area {
    let points: Vec<DVec3> = points.iter().map(|p| camera_from_world.transform_point3(*p)).collect();
    let near = 0.5 * lens.near;
    let mut area = Area::NOTHING;
    let mut add = |point: DVec3| {
        if let Some(at) = lens.project(point) {
            area.add(at);
        }
    };
    for (i, a) in points.iter().enumerate() {
        if -a.z >= near {
            add(*a);
        }
        // What of the hull lies before the camera is the hull of its points there and of what lies between and those behind.
        for b in &points[i + 1..] {
            if (-a.z >= near) != (-b.z >= near) {
                add(a.lerp(*b, (-near - a.z) / (b.z - a.z)));
            }
        }
    }
    area
}

/// Extent of what casts, along its way from a light through a box: factors of distance (spot) or lengths (directional).
fn passage(from: (DVec3, DVec3), origin: DVec3, within: (DVec3, DVec3)) -> Option<(f64, f64)> {
    let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
    for axis in 0..3 {
        let (low, high) = (from.0[axis], from.1[axis]);
        let (near, far) = (within.0[axis] - origin[axis], within.1[axis] - origin[axis]);
        if low > 0.0 {
            enter = enter.max(near / high);
            leave = leave.min(far / low);
        } else if high < 0.0 {
            enter = enter.max(far / low);
            leave = leave.min(near / high);
        }
        // Where the sign is open, this axis says nothing.
    }
    (enter <= leave).then_some((enter, leave))
}

/// A light that throws shadows. `texel`: world size of its map's texels, at a distance of 1 for a spot light.
pub enum Lamp {
    /// From a place.
    Spot {
        /// In the world.
        position: DVec3,
        /// Metres per metre.
        texel: f64,
    },
    /// From everywhere the same way.
    Directional {
        /// The way light takes.
        along: DVec3,
        /// Metres.
        texel: f64,
    },
}

impl Lamp {
    /// The light at `node`, whose map sees `view`.
    pub fn new(scene: &Scene, state: &SceneState, node: usize, view: &LightView) -> Option<Self> {
        let light = &scene.lights[scene.nodes[node].light?];
        let world = &state.world_from_node[node];
        let texel = view.texel;
        Some(match light.kind {
            LightKind::Directional => {
                let along = (-world.z_axis.truncate()).normalize_or(DVec3::NEG_Z);
                Self::Directional { along, texel }
            }
            LightKind::Point | LightKind::Spot { .. } => {
                Self::Spot { position: world.w_axis.truncate(), texel }
            }
        })
    }

    /// The hull of what `caster` may darken within `receiver`; `None` where nothing.
    fn shadow(&self, caster: &Corners, receiver: (DVec3, DVec3)) -> Option<Vec<DVec3>> {
        let (low, high) = bounds(caster);
        match *self {
            Self::Spot { position, texel } => {
                // Along the axis a distance is no more than in space.
                let away = caster.iter().map(|c| c.distance(position)).fold(0.0, f64::max);
                let grow = DVec3::splat(MARGIN_TEXELS * texel * away);
                let (low, high) = (low - grow, high + grow);
                if (low - position).max(position - high).max_element() <= 0.0 {
                    // The light is inside.
                    return Some(corners(receiver.0, receiver.1).to_vec());
                }
                let (enter, leave) = passage((low - position, high - position), position, receiver)?;
                let both = [enter.max(1.0), leave];
                (both[0] <= both[1]).then(|| {
                    let far = both.map(|s| if s.is_finite() { s } else { 1e6 });
                    let corners = corners(low, high);
                    far.iter().flat_map(|s| corners.map(|c| position + *s * (c - position))).collect()
                })
            }
            Self::Directional { along, texel } => {
                let grow = DVec3::splat(MARGIN_TEXELS * texel);
                let (low, high) = (low - grow, high + grow);
                // Lengths t with low + t along <= receiver's high and high + t along >= its low, per axis.
                let (mut enter, mut leave) = (0.0_f64, 1e6_f64);
                for axis in 0..3 {
                    let step = along[axis];
                    let (a, b) = (receiver.0[axis] - high[axis], receiver.1[axis] - low[axis]);
                    if step.abs() < 1e-12 {
                        if a > 0.0 || b < 0.0 {
                            return None;
                        }
                        continue;
                    }
                    let (first, last) = if step > 0.0 { (a / step, b / step) } else { (b / step, a / step) };
                    enter = enter.max(first);
                    leave = leave.min(last);
                }
                (enter <= leave).then(|| {
                    let corners = corners(low, high);
                    [enter, leave].iter().flat_map(|t| corners.map(|c| c + *t * along)).collect()
                })
            }
        }
    }
}

/// A view as it was at the last instant.
#[derive(Default)]
struct Seen {
    /// What shaders read of it, less what only says where other things lie.
    frame: Vec<u8>,
    world: Vec<DMat4>,
    records: Vec<ObjectRecord>,
}

/// Compares each instant of a view with the one before it.
#[derive(Default)]
pub struct StillWatch {
    seen: Vec<Seen>,
    /// The group, and the instant whose predecessor is kept.
    kept: Option<(usize, i64)>,
    /// Whether that is the one that comes now.
    follows: bool,
    /// Whether any view was as still as the instant before.
    calm: bool,
    /// A canary of the tests: shadows are taken for still.
    #[cfg(test)]
    pub overlooks_shadows: bool,
}

/// A view at an instant, for [`StillWatch::compare`].
#[derive(Clone, Copy)]
pub struct Moment<'a> {
    /// Number of the view within its group.
    pub view: usize,
    /// Its lens.
    pub lens: &'a PixelLens,
    /// Where it is.
    pub camera_from_world: &'a DMat4,
    /// [`Frame`] and lights, as uploaded.
    pub frame: &'a [u8],
    /// Poses of the objects.
    pub world: &'a [DMat4],
    /// Records of the objects.
    pub records: &'a [ObjectRecord],
    /// What is in view.
    pub visible: &'a [DrawItem],
    /// Lights that throw shadows.
    pub lamps: &'a [Lamp],
}

impl StillWatch {
    /// Begins a submission of the instants from `first` on, of the `views` views of `group`.
    pub fn begin(&mut self, group: usize, views: usize, first: i64) {
        self.follows = self.kept == Some((group, first));
        self.kept = None;
        self.calm = false;
        self.seen.resize_with(views, Seen::default);
    }

    /// Whether keeping the last instant may pay: some view was still.
    pub const fn is_calm(&self) -> bool {
        self.calm
    }

    /// The instant before `next` of `group` is kept.
    pub fn keep(&mut self, group: usize, next: i64) {
        self.kept = Some((group, next));
    }

    /// What must be drawn of `now`, instant `k` of the submission; the next instant is compared with it.
    pub fn compare(&mut self, scene: &GpuScene, k: usize, now: &Moment<'_>) -> Change {
        let Some(last) = self.seen.get_mut(now.view) else { return Change::All };
        let mut frame = now.frame.to_vec();
        // Where the records of moving casters lie among others' is not what is seen.
        let first_occluder = offset_of!(Frame, occluder_first);
        if let Some(bytes) = frame.get_mut(first_occluder..first_occluder + size_of::<u32>()) {
            bytes.fill(0);
        }
        #[cfg(test)]
        let now = &Moment { lamps: if self.overlooks_shadows { &[] } else { now.lamps }, ..*now };
        let same = last.frame == frame;
        self.calm |= same;
        let change = if same && (k > 0 || self.follows) { change(scene, last, now) } else { Change::All };
        last.frame = frame;
        last.world.clear();
        last.world.extend_from_slice(now.world);
        last.records.clear();
        last.records.extend_from_slice(now.records);
        change
    }
}

fn change(scene: &GpuScene, last: &Seen, now: &Moment<'_>) -> Change {
    let same = |o: usize| last.world.get(o) == now.world.get(o) && last.records.get(o) == now.records.get(o);
    let moved: Vec<usize> = (0..scene.objects.len()).filter(|o| !same(*o)).collect();
    if moved.is_empty() && last.world.len() == now.world.len() {
        return Change::Nothing;
    }
    let place = |object: &Object, world: &DMat4| {
        let (low, high) = object.extent?;
        Some(corners(low, high).map(|c| world.transform_point3(c)))
    };
    // Both where it was and where it is.
    let mut boxes = Vec::new();
    for o in moved {
        for world in [last.world.get(o), now.world.get(o)] {
            let Some(corners) = world.and_then(|world| place(&scene.objects[o], world)) else {
                return Change::All;
            };
            boxes.push(corners);
        }
    }
    let see = |points: &[DVec3]| seen(points, now.camera_from_world, now.lens);
    let mut areas: Vec<Area> = boxes.iter().map(|corners| see(corners)).collect();
    let visible = || now.visible.iter().flat_map(|item| item.objects.clone().map(move |o| (item, o)));
    let mut places = Vec::new();
    for (_, o) in visible() {
        let object = &scene.objects[o as usize];
        let Some(corners) = now.world.get(o as usize).and_then(|world| place(object, world)) else {
            return Change::All;
        };
        let own = see(&corners).grown(MARGIN_PX);
        places.push(own);
        let receiver = bounds(&corners);
        for shadow in now.lamps.iter().flat_map(|lamp| boxes.iter().filter_map(|b| lamp.shadow(b, receiver)))
        {
            let darkened = see(&shadow).meet(own);
            areas.push(darkened);
        }
    }
    let whole = Area { low: [0.0; 2], high: [f64::from(now.lens.width), f64::from(now.lens.height)] };
    let areas = gather(areas.into_iter().map(|area| area.grown(MARGIN_PX).meet(whole)));
    if areas.iter().map(Area::size).sum::<f64>() > LARGEST_PART * whole.size() {
        return Change::All;
    }
    let mut parts = Vec::new();
    for area in areas {
        let Some(rect) = area.pixels(now.lens) else { continue };
        let mut items: Vec<DrawItem> = Vec::new();
        for ((item, o), own) in visible().zip(&places) {
            if own.meet(area).is_nothing() {
                continue;
            }
            match items.last_mut() {
                Some(last) if last.draw == item.draw && last.objects.end == o => last.objects.end += 1,
                _ => items.push(DrawItem { draw: item.draw, objects: o..o + 1 }),
            }
        }
        parts.push((rect, items));
    }
    if parts.is_empty() { Change::Nothing } else { Change::Parts(parts) }
}

/// Joins areas until joining any two would add more than it saves.
fn gather(areas: impl Iterator<Item = Area>) -> Vec<Area> {
    /// What drawing one more area costs, in pixels: its objects' vertices are transformed again.
    const EACH: f64 = 4000.0;
    let mut all: Vec<Area> = Vec::new();
    for mut area in areas.filter(|area| !area.is_nothing()) {
        while let Some(i) = all.iter().position(|a| a.join(area).size() <= a.size() + area.size() + EACH) {
            area = area.join(all.swap_remove(i));
        }
        all.push(area);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_lies_around_rectangles_and_they_tile_the_picture() {
        let rect = |x0, y0, x1, y1| Rect { low: [x0, y0], high: [x1, y1] };
        for rects in [
            vec![],
            vec![rect(0, 0, 13, 9)],
            vec![rect(2, 3, 5, 6)],
            vec![rect(0, 2, 4, 9), rect(4, 0, 13, 2)],
            vec![rect(1, 1, 6, 6), rect(3, 4, 12, 8), rect(7, 2, 8, 3)],
        ] {
            let mut covered = [0; 13 * 9];
            let around = Rect::around(&rects, 13, 9);
            for Rect { low, high } in &around {
                for at in (low[1]..high[1]).flat_map(|y| (low[0]..high[0]).map(move |x| y * 13 + x)) {
                    covered[at as usize] += 1;
                }
            }
            for (at, count) in (0u32..).zip(covered) {
                let (x, y) = (at % 13, at / 13);
                let inside = rects
                    .iter()
                    .any(|r| (r.low[0]..r.high[0]).contains(&x) && (r.low[1]..r.high[1]).contains(&y));
                assert_eq!(count, u32::from(!inside), "{rects:?} at {x}, {y}: {around:?}");
            }
        }
    }

    #[test]
    fn shadows_fall_where_light_through_the_caster_falls() {
        // Points between a lamp and a receiver, through a caster, in a fixed order: each is inside the hull's bounds.
        let (low, high) = (DVec3::new(-0.3, 1.0, 0.2), DVec3::new(0.4, 1.6, 0.9));
        let receiver = (DVec3::new(-6.0, -0.1, -5.0), DVec3::new(7.0, 0.1, 8.0));
        for lamp in [
            Lamp::Spot { position: DVec3::new(1.0, 4.0, -0.5), texel: 0.0 },
            Lamp::Spot { position: DVec3::new(0.1, 1.9, 0.5), texel: 0.0 },
            Lamp::Directional { along: DVec3::new(0.3, -0.9, 0.4), texel: 0.0 },
        ] {
            let hull = bounds(&lamp.shadow(&corners(low, high), receiver).unwrap());
            let mut fallen = 0;
            for i in 0..1000 {
                let part = |digit: i32| f64::from(i / 10_i32.pow(digit as u32) % 10) / 9.0;
                let through = low + (high - low) * DVec3::new(part(0), part(1), part(2));
                let way = match lamp {
                    Lamp::Spot { position, .. } => through - position,
                    Lamp::Directional { along, .. } => along,
                };
                let ground = through - way * (through.y / way.y);
                if way.y < 0.0 && ground.cmpge(receiver.0).all() && ground.cmple(receiver.1).all() {
                    fallen += 1;
                    assert!((ground - hull.0).min_element() > -1e-9, "{ground} outside of {hull:?}");
                    assert!((hull.1 - ground).min_element() > -1e-9, "{ground} outside of {hull:?}");
                }
            }
            assert!(fallen > 300, "{fallen}");
        }
        // Behind the caster is no shadow.
        let above = (DVec3::new(-1.0, 4.5, -1.0), DVec3::new(1.0, 5.0, 1.0));
        let spot = Lamp::Spot { position: DVec3::new(1.0, 4.0, -0.5), texel: 0.0 };
        assert!(spot.shadow(&corners(low, high), above).is_none());
    }
}
