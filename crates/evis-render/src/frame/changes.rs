//! What of a view changes from one instant to the next: with a still camera under still lights, that is where something
//! moves or throws a moving shadow, and all else need not be drawn again.
//!
//! Nothing is guessed: a view is still where what its shaders read is equal byte for byte, an object where its pose and its
//! record are. So skipping changes no byte of a stream.

use std::mem::offset_of;

use evis_scene::PixelLens;
use glam::{DMat4, DVec3};

use crate::gpu::uniforms::{Frame, ObjectRecord};
use crate::shadow::volume::Lamp;
use crate::world::gpu_scene::{DrawItem, GpuScene, Part, place, push_item};
use crate::world::image_bounds::{Area, Corners, MARGIN_PX, bounds, seen};

/// A part of a picture larger than this is not worth being drawn apart.
const LARGEST_PART: f64 = 0.7;

/// What of a view must be drawn at an instant, the rest being as it was at the instant before.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Change {
    /// Everything.
    #[default]
    All,
    /// These objects within these rectangles.
    Parts(Vec<Part>),
    /// Nothing.
    Nothing,
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
    any_static: bool,
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
        self.any_static = false;
        self.seen.resize_with(views, Seen::default);
    }

    /// Whether keeping the last instant may pay: some view was still.
    pub const fn any_static(&self) -> bool {
        self.any_static
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
        self.any_static |= same;
        let change = if same && (k > 0 || self.follows) { change(scene, last, now) } else { Change::All };
        last.frame = frame;
        last.world.clear();
        last.world.extend_from_slice(now.world);
        last.records.clear();
        last.records.extend_from_slice(now.records);
        change
    }
}

/// The pixels that something between `corners` may change.
pub fn own_area(corners: &Corners, camera_from_world: &DMat4, lens: &PixelLens) -> Area {
    seen(corners, camera_from_world, lens).grown(MARGIN_PX)
}

fn change(scene: &GpuScene, last: &Seen, now: &Moment<'_>) -> Change {
    // Joints and morph weights are not compared.
    let deforms = |o: usize| scene.objects[o].extent.is_none() && scene.objects[o].moving;
    let same = |o: usize| {
        !deforms(o) && last.world.get(o) == now.world.get(o) && last.records.get(o) == now.records.get(o)
    };
    let moved: Vec<usize> = (0..scene.objects.len()).filter(|o| !same(*o)).collect();
    if moved.is_empty() && last.world.len() == now.world.len() {
        return Change::Nothing;
    }
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
        let own = own_area(&corners, now.camera_from_world, now.lens);
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
            push_item(&mut items, item.draw, o);
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
