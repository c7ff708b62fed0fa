//! Events by pixel: a counting sort, which keeps their order within a pixel.

use crate::event::Event;
use crate::truth::{Region, Truth};

/// A table of this many entries finds a pixel at once; larger areas are searched.
const LARGEST_TABLE: usize = 1 << 26;
/// In the table: not among the truth's pixels.
const UNKNOWN: u32 = u32::MAX;

/// Below this image speed a tolerance grows: 0.1 px per millisecond.
const FULL_SPEED: f64 = 100.0;
/// And no further than this many times.
const MOST_SCALE: f64 = 10.0;

/// Time and polarity of an event in one number, ordered by time.
#[derive(Clone, Copy, Default)]
pub(super) struct Mark(i64);

impl Mark {
    fn new(event: &Event) -> Self {
        Self(event.t << 1 | i64::from(event.p))
    }

    pub fn t_us(self) -> i64 {
        self.0 >> 1
    }

    pub fn is_on(self) -> bool {
        self.0 & 1 == 1
    }
}

/// A truth event with what is known of it.
#[derive(Clone, Copy, Default)]
pub(super) struct Known {
    pub mark: Mark,
    /// By how much its tolerance is scaled.
    pub scale: f32,
    pub region: Region,
}

/// Items grouped by pixel of the truth.
pub(super) struct ByPixel<T> {
    start: Vec<u32>,
    items: Vec<T>,
    pub ignored_unknown_pixel: u64,
    pub ignored_outside_interval: u64,
}

impl<T> ByPixel<T> {
    pub fn pixel(&self, index: usize) -> &[T] {
        match (self.start.get(index), self.start.get(index + 1)) {
            (Some(&from), Some(&to)) => self.items.get(from as usize..to as usize).unwrap_or_default(),
            _ => &[],
        }
    }

    pub fn len(&self) -> usize {
        self.items.len()
    }
}

/// Finds a pixel's index in the truth.
pub(super) enum PixelIndex<'a> {
    Table { width: usize, index: Vec<u32> },
    Search(&'a Truth),
}

impl<'a> PixelIndex<'a> {
    pub fn new(truth: &'a Truth) -> Self {
        let (width, height) = (truth.camera.width as usize, truth.camera.height as usize);
        if width * height > LARGEST_TABLE {
            return Self::Search(truth);
        }
        let mut index = vec![UNKNOWN; width * height];
        for (i, [x, y]) in (0..).zip(&truth.pixels) {
            if let Some(entry) = index.get_mut(usize::from(*y) * width + usize::from(*x)) {
                *entry = i;
            }
        }
        Self::Table { width, index }
    }

    pub fn knows(&self, event: &Event) -> bool {
        self.of(event) != UNKNOWN
    }

    fn of(&self, event: &Event) -> u32 {
        match self {
            Self::Table { width, index } => {
                index.get(usize::from(event.y) * width + usize::from(event.x)).copied().unwrap_or(UNKNOWN)
            }
            Self::Search(truth) => {
                truth.pixel_index(event.x, event.y).and_then(|i| u32::try_from(i).ok()).unwrap_or(UNKNOWN)
            }
        }
    }
}

/// Groups the events of a checked stream that truth can say something about.
pub(super) fn stream_by_pixel(events: &[Event], truth: &Truth) -> ByPixel<Mark> {
    let inside = crate::event::slice_time(events, 0, truth.duration_us);
    let mut sorted = sort(inside, truth, |_, event| Mark::new(event));
    sorted.ignored_outside_interval = (events.len() - inside.len()) as u64;
    sorted
}

/// Groups the events of a checked truth.
pub(super) fn truth_by_pixel(truth: &Truth) -> ByPixel<Known> {
    sort(&truth.events, truth, |i, event| Known {
        mark: Mark::new(event),
        scale: truth.speed.get(i).map_or(1.0, |v| tolerance_scale(*v)),
        region: truth.event_region.get(i).copied().unwrap_or_default(),
    })
}

/// max(1, min(100 px/s / speed, 10)): see [`super`].
fn tolerance_scale(speed: f32) -> f32 {
    if speed.is_finite() && speed > 0.0 {
        (FULL_SPEED / f64::from(speed)).clamp(1.0, MOST_SCALE) as f32
    } else {
        1.0
    }
}

fn sort<T: Copy + Default>(events: &[Event], truth: &Truth, item: impl Fn(usize, &Event) -> T) -> ByPixel<T> {
    let pixel_index = PixelIndex::new(truth);
    let pixels = truth.pixels.len();
    // One entry more than there are pixels, and one before: filled from entry i + 1 on, it ends as the starts.
    let mut start = vec![0_u32; pixels + 2];
    let mut unknown = 0;
    for event in events {
        match start.get_mut(pixel_index.of(event) as usize + 2) {
            Some(count) => *count += 1,
            None => unknown += 1,
        }
    }
    let mut sum = 0;
    for count in &mut start {
        sum += *count;
        *count = sum;
    }
    let mut items = vec![T::default(); sum as usize];
    for (i, event) in events.iter().enumerate() {
        if let Some(next) = start.get_mut(pixel_index.of(event) as usize + 1)
            && let Some(place) = items.get_mut(*next as usize)
        {
            *place = item(i, event);
            *next += 1;
        }
    }
    start.pop();
    ByPixel { start, items, ignored_unknown_pixel: unknown, ignored_outside_interval: 0 }
}
