//! Where pixels go when a picture is undistorted.

use evis_core::Event;

use crate::packet::Frame;

/// A sensor's pixels in a picture of the same size: where each goes, and where each comes from.
///
/// Places are in pixels, x right and y down from the top-left corner, with pixel centres at +0.5.
#[derive(Clone, Debug, PartialEq)]
pub struct PixelMap {
    width: u32,
    height: u32,
    /// The pixel of the picture for each of the sensor, row-major; none outside of the picture.
    to: Vec<Option<[u16; 2]>>,
    /// The place on the sensor for each pixel of the picture; none where the sensor sees nothing.
    from: Vec<Option<[f64; 2]>>,
}

impl PixelMap {
    /// For a sensor of `size` (at most 65536 to a side): `to` takes places on the sensor to places in the
    /// picture, and `from` takes them back. Both are called once per pixel.
    pub fn new(
        size: (u32, u32),
        to: impl Fn([f64; 2]) -> Option<[f64; 2]>,
        from: impl Fn([f64; 2]) -> Option<[f64; 2]>,
    ) -> Self {
        let (width, height) = size;
        let centres = || {
            (0..height).flat_map(move |y| (0..width).map(move |x| [f64::from(x) + 0.5, f64::from(y) + 0.5]))
        };
        let pixel = |[x, y]: [f64; 2]| {
            let inside = x >= 0.0 && y >= 0.0 && x < f64::from(width) && y < f64::from(height);
            inside.then_some([x as u16, y as u16])
        };
        Self {
            width,
            height,
            to: centres().map(|place| to(place).and_then(pixel)).collect(),
            from: centres().map(from).collect(),
        }
    }

    /// Pixels per row, and rows, of the sensor and of the picture.
    pub const fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// How many pixels of the sensor lie outside of the picture: their events are lost.
    pub fn lost(&self) -> usize {
        self.to.iter().filter(|to| to.is_none()).count()
    }

    pub(crate) fn events(&self, events: &mut Vec<Event>) {
        events.retain_mut(|e| {
            let at = u32::from(e.x) < self.width;
            let index = e.y as usize * self.width as usize + e.x as usize;
            let Some(&Some([x, y])) = self.to.get(index).filter(|_| at) else { return false };
            (e.x, e.y) = (x, y);
            true
        });
    }

    /// Resamples an image of the sensor's size bilinearly; black where the sensor sees nothing. An image of
    /// another size belongs to another sensor and stays.
    pub(crate) fn frame(&self, frame: &mut Frame) {
        if (frame.width, frame.height) != (self.width, self.height) {
            return;
        }
        let channels = usize::from(frame.channels.max(1));
        let value = |x: f64, y: f64, channel: usize| {
            let x = x.clamp(0.0, f64::from(self.width - 1)) as usize;
            let y = y.clamp(0.0, f64::from(self.height - 1)) as usize;
            let index = (y * self.width as usize + x) * channels + channel;
            frame.pixels.get(index).map_or(0.0, |value| f64::from(*value))
        };
        let mut pixels = Vec::with_capacity(frame.pixels.len());
        for from in &self.from {
            let seen = from.filter(|[x, y]| {
                *x >= 0.0 && *y >= 0.0 && *x < f64::from(self.width) && *y < f64::from(self.height)
            });
            let Some([x, y]) = seen else {
                pixels.extend(std::iter::repeat_n(0, channels));
                continue;
            };
            let (x, y) = (x - 0.5, y - 0.5);
            let (left, top) = (x.floor(), y.floor());
            let (right, down) = (x - left, y - top);
            for channel in 0..channels {
                let above =
                    value(left, top, channel) * (1.0 - right) + value(left + 1.0, top, channel) * right;
                let below = value(left, top + 1.0, channel) * (1.0 - right)
                    + value(left + 1.0, top + 1.0, channel) * right;
                pixels.push((above * (1.0 - down) + below * down).round() as u8);
            }
        }
        frame.pixels = pixels;
    }
}

#[cfg(test)]
mod tests {
    use evis_core::Polarity;

    use super::*;

    /// Half a pixel to the right, and one down.
    fn shifted() -> PixelMap {
        PixelMap::new((4, 3), |[x, y]| Some([x + 0.5, y + 1.0]), |[x, y]| Some([x - 0.5, y - 1.0]))
    }

    #[test]
    fn events_move_to_the_pixel_of_their_place_or_leave() {
        let event = |x, y| Event::new(i64::from(x), x, y, Polarity::On);
        let mut events = vec![event(0, 0), event(1, 1), event(2, 2), event(3, 0), event(7, 0)];
        shifted().events(&mut events);
        // The place of pixel 0 is 0.5, and goes to 1.0, which pixel 1 begins with; 3 goes out on the right.
        let places: Vec<_> = events.iter().map(|e| (e.t, e.x, e.y)).collect();
        assert_eq!(places, [(0, 1, 1), (1, 2, 2)]);
        assert_eq!(shifted().lost(), 4 + 2, "the last row, and what is left of the last column");
    }

    #[test]
    fn images_are_resampled_where_the_sensor_sees() {
        let mut frame = Frame { width: 4, height: 3, channels: 1, ..Frame::default() };
        frame.pixels = vec![10, 20, 40, 80, 0, 0, 0, 0, 0, 0, 0, 0];
        shifted().frame(&mut frame);
        assert_eq!(frame.pixels, [0, 0, 0, 0, 10, 15, 30, 60, 0, 0, 0, 0]);
        let mut other = Frame { width: 2, height: 1, channels: 1, pixels: vec![1, 2], ..Frame::default() };
        shifted().frame(&mut other);
        assert_eq!(other.pixels, [1, 2]);
    }
}
