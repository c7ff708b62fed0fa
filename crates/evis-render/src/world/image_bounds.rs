//! Parts of a picture: whole pixels, and where on the image plane things lie.

use evis_scene::PixelLens;
use glam::{DMat4, DVec3};

/// Pixels around what moves that it may change: samples reach half a pixel out, the rest is rounding's.
pub const MARGIN_PX: f64 = 2.0;

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

    /// What holds both.
    pub fn join(&self, other: &Self) -> Self {
        Self {
            low: [0, 1].map(|i| self.low[i].min(other.low[i])),
            high: [0, 1].map(|i| self.high[i].max(other.high[i])),
        }
    }

    /// How many.
    pub fn pixels(&self) -> u64 {
        let [width, height] = self.size();
        u64::from(width) * u64::from(height)
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
pub struct Area {
    /// Left and upper.
    pub low: [f64; 2],
    /// Right and lower.
    pub high: [f64; 2],
}

impl Area {
    /// No part.
    pub const NOTHING: Self = Self { low: [f64::INFINITY; 2], high: [f64::NEG_INFINITY; 2] };

    /// All of any picture.
    pub const EVERYTHING: Self = Self { low: [f64::NEG_INFINITY; 2], high: [f64::INFINITY; 2] };

    /// Where `rect` is.
    pub fn of(rect: &Rect) -> Self {
        Self { low: rect.low.map(f64::from), high: rect.high.map(f64::from) }
    }

    /// Takes a point in.
    pub fn add(&mut self, [x, y]: [f64; 2]) {
        self.low = [self.low[0].min(x), self.low[1].min(y)];
        self.high = [self.high[0].max(x), self.high[1].max(y)];
    }

    /// What holds both.
    pub fn join(self, other: Self) -> Self {
        Self {
            low: [0, 1].map(|i| self.low[i].min(other.low[i])),
            high: [0, 1].map(|i| self.high[i].max(other.high[i])),
        }
    }

    /// What lies in both.
    pub fn meet(self, other: Self) -> Self {
        Self {
            low: [0, 1].map(|i| self.low[i].max(other.low[i])),
            high: [0, 1].map(|i| self.high[i].min(other.high[i])),
        }
    }

    /// Whether nothing lies in it.
    pub fn is_nothing(&self) -> bool {
        // Also where it is not a number.
        !(0..2).all(|i| self.low[i] <= self.high[i])
    }

    /// Square pixels.
    pub fn size(&self) -> f64 {
        if self.is_nothing() { 0.0 } else { (self.high[0] - self.low[0]) * (self.high[1] - self.low[1]) }
    }

    /// With a border of `by` pixels.
    pub fn grown(self, by: f64) -> Self {
        Self { low: self.low.map(|v| v - by), high: self.high.map(|v| v + by) }
    }

    /// The pixels that it touches; `None` for none of them.
    pub fn pixels(&self, lens: &PixelLens) -> Option<Rect> {
        let size = [lens.width, lens.height];
        let low = [0, 1].map(|i| self.low[i].floor().clamp(0.0, f64::from(size[i])) as u32);
        let high = [0, 1].map(|i| self.high[i].ceil().clamp(0.0, f64::from(size[i])) as u32);
        (0..2).all(|i| low[i] < high[i]).then_some(Rect { low, high })
    }
}

/// A box in the world: its corners' hull.
pub type Corners = [DVec3; 8];

/// The corners of a box.
pub fn corners(low: DVec3, high: DVec3) -> Corners {
    std::array::from_fn(|i| {
        let pick = |bit: usize, low: f64, high: f64| if i >> bit & 1 == 0 { low } else { high };
        DVec3::new(pick(0, low.x, high.x), pick(1, low.y, high.y), pick(2, low.z, high.z))
    })
}

/// The box around points.
pub fn bounds(corners: &[DVec3]) -> (DVec3, DVec3) {
    let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    corners.iter().fold(start, |(low, high), corner| (low.min(*corner), high.max(*corner)))
}

/// Where the hull of `points` is seen; the part of it that lies before the camera.
pub fn seen(points: &[DVec3], camera_from_world: &DMat4, lens: &PixelLens) -> Area {
    let mut area = Area::NOTHING;
    outline(points, camera_from_world, lens, |at| area.add(at));
    area
}

/// Points of the image plane whose hull is that of what is seen of the hull of `points`.
pub fn outline(points: &[DVec3], camera_from_world: &DMat4, lens: &PixelLens, mut add: impl FnMut([f64; 2])) {
    let points: Vec<DVec3> = points.iter().map(|p| camera_from_world.transform_point3(*p)).collect();
    let near = 0.5 * lens.near;
    let mut add = |point: DVec3| {
        if let Some(at) = lens.project(point) {
            add(at.into());
        }
    };
    if points.iter().all(|p| -p.z >= near) {
        points.iter().copied().for_each(add);
        return;
    }
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
}

/// A box: least and greatest coordinates.
pub type Extent = (DVec3, DVec3);

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
}
