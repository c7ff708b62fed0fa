//! Parts of a picture: rectangles around what is wanted of it, and what is drawn in each.

use crate::frame::changes;
use crate::raster::context::Context;
use crate::world::gpu_scene::{DrawItem, Part, place, push_item};
use crate::world::image_bounds::{Area, Rect};
use crate::world::tiles::rects;
use crate::world::view::View;

/// What a draw call takes beside its vertices, and what an index takes, in pixels (measured on lavapipe).
const DRAW_PX: f64 = 100.0;

const INDEX_PX: f64 = 0.3;

/// What a rectangle takes.
const RECT_PX: f64 = 200.0;

/// What is in view in a frame, in drawing order.
pub struct InView(Vec<Placed>);

/// A visible object: how it is drawn, where it is seen, and what it takes.
struct Placed {
    draw: u32,
    object: u32,
    area: Area,
    price: f64,
}

impl InView {
    /// In frame `frame`, of `view`, of those that were uploaded last, with their trail.
    pub fn new(context: &Context, view: &View, frame: u32) -> Self {
        let data = &context.frame_data;
        let camera = &data.trail.camera_from_world[frame as usize];
        let shared = &data.trail.shared[data.trail.shared_of[frame as usize]];
        let scene = &context.gpu_scene;
        let placed = data.visible[frame as usize]
            .iter()
            .flat_map(|item| item.objects.clone().map(move |object| (item.draw, object)))
            .map(|(draw, object)| {
                let area = place(&scene.objects[object as usize], &shared.world[object as usize])
                    .map_or(Area::EVERYTHING, |corners| changes::own_area(&corners, camera, &view.lens));
                let price = DRAW_PX + INDEX_PX * scene.draws[draw as usize].indices.len() as f64;
                Placed { draw, object, area, price }
            })
            .collect();
        Self(placed)
    }

    /// Rectangles that hold all squares of `side` pixels that are `active`, and are cheap to draw, where each of their
    /// pixels takes `pixel_price`.
    pub fn rects(
        &self,
        active: impl Fn(u32, u32) -> bool,
        side: u32,
        size: (u32, u32),
        pixel_price: f64,
    ) -> Vec<Rect> {
        rects(active, side, size, |rect| self.cost(rect, pixel_price))
    }

    /// What is drawn within `rect`.
    pub fn items(&self, rect: &Rect) -> Vec<DrawItem> {
        let mut items: Vec<DrawItem> = Vec::new();
        for placed in self.within(rect) {
            push_item(&mut items, placed.draw, placed.object);
        }
        items
    }

    /// [`Self::rects`], with what is drawn in each.
    pub fn parts(
        &self,
        active: impl Fn(u32, u32) -> bool,
        side: u32,
        size: (u32, u32),
        pixel_price: f64,
    ) -> Vec<Part> {
        let rects = self.rects(active, side, size, pixel_price);
        rects.into_iter().map(|rect| (rect, self.items(&rect))).collect()
    }

    /// What drawing `rect` takes, in pixels that are shaded once.
    pub fn cost(&self, rect: &Rect, pixel_price: f64) -> f64 {
        let objects: f64 = self.within(rect).map(|placed| placed.price).sum();
        RECT_PX + pixel_price * rect.pixels() as f64 + objects
    }

    /// The nearest object that may be seen within `rect`.
    pub fn nearest(&self, rect: &Rect) -> Option<u32> {
        self.within(rect).next().map(|placed| placed.object)
    }

    fn within(&self, rect: &Rect) -> impl Iterator<Item = &Placed> {
        let within = Area::of(rect);
        self.0.iter().filter(move |placed| !placed.area.meet(within).is_nothing())
    }
}
