//! Truth: the events that a converged oracle says a sensor fires, and what it knows about each.
//!
//! A truth knows some pixels of one camera over `[0, duration_us)`. Scores (see [`crate::metric`]) look at these
//! pixels only, scale their tolerances by the local image speed, and break down by [`Region`].

use serde::{Deserialize, Serialize};

use crate::event::Event;
use crate::packet::CameraInfo;
use crate::sensor::SensorConfig;

/// What happens in a pixel. Where several hold, the first of the list
/// disoccluded, shadow edge, silhouette, interior names it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum Region {
    /// One surface fills the pixel.
    #[default]
    Interior = 0,
    /// The outline of an object, or the sky's edge, runs through the pixel.
    Silhouette = 1,
    /// What the pixel shows was hidden, or out of the picture, a moment ago.
    Disoccluded = 2,
    /// The border of a cast shadow runs through the pixel.
    ShadowEdge = 3,
}

impl Region {
    /// All regions, in the order of their numbers.
    pub const ALL: [Self; 4] = [Self::Interior, Self::Silhouette, Self::Disoccluded, Self::ShadowEdge];

    /// Name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Interior => "interior",
            Self::Silhouette => "silhouette",
            Self::Disoccluded => "disoccluded",
            Self::ShadowEdge => "shadow_edge",
        }
    }

    /// The region of number `code`; `None` above 3.
    pub const fn from_code(code: u8) -> Option<Self> {
        match code {
            0 => Some(Self::Interior),
            1 => Some(Self::Silhouette),
            2 => Some(Self::Disoccluded),
            3 => Some(Self::ShadowEdge),
            _ => None,
        }
    }
}

/// From `t_us` on, until the next span of the same pixel, a pixel lies in `region`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RegionSpan {
    /// Stream time in microseconds.
    pub t_us: i64,
    /// Where the pixel lies from then on.
    pub region: Region,
}

/// Events known to be right, for some pixels of one camera over `[0, duration_us)`.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// The camera.
    pub camera: CameraInfo,
    /// Thresholds and `eps` that the events were made with, NaN where unknown; the trigger rule is the crossing of the
    /// continuous signal.
    pub sensor: SensorConfig,
    /// `Y_ref` in `ln(Y / Y_ref + eps)`; NaN where unknown.
    pub reference_luminance: f64,
    /// Length in microseconds.
    pub duration_us: i64,
    /// The pixels (x, y) that this truth knows, ordered by y, then x; each once. A pixel without events is known to
    /// be silent.
    pub pixels: Vec<[u16; 2]>,
    /// Events at these pixels in canonical order, `0 <= t < duration_us`.
    pub events: Vec<Event>,
    /// Local image speed at each event, in pixels per second; 0 or NaN where unknown: then no tolerance is scaled.
    /// As long as `events`, or empty.
    pub speed: Vec<f32>,
    /// Region of each event. As long as `events`, or empty: all interior.
    pub event_region: Vec<Region>,
    /// `span_start[i]..span_start[i + 1]` are the spans of pixel i: `pixels.len() + 1` of them, or empty.
    pub span_start: Vec<u32>,
    /// Per pixel in order of time; the first one starts at 0.
    pub spans: Vec<RegionSpan>,
    /// Where it comes from (scene, settings, samples, estimated error): JSON, for people and for the cache.
    pub provenance: String,
}

impl Truth {
    /// Takes events that are known to be right as truth: all pixels of the camera, no image speeds, all interior.
    pub fn from_events(
        events: Vec<Event>,
        camera: CameraInfo,
        sensor: SensorConfig,
        reference_luminance: f64,
        duration_us: i64,
    ) -> Self {
        let side = |pixels: u32| u16::try_from(pixels.saturating_sub(1)).unwrap_or(u16::MAX);
        let pixels = if camera.width == 0 || camera.height == 0 {
            Vec::new()
        } else {
            (0..=side(camera.height)).flat_map(|y| (0..=side(camera.width)).map(move |x| [x, y])).collect()
        };
        Self {
            camera,
            sensor,
            reference_luminance,
            duration_us,
            pixels,
            events,
            speed: Vec::new(),
            event_region: Vec::new(),
            span_start: Vec::new(),
            spans: Vec::new(),
            provenance: String::new(),
        }
    }

    /// The rate of exact light that these are the events of; `None` for a truth, which has no rate. What is sampled is
    /// written and scored as a truth is, and its provenance tells it from one.
    pub fn sampled_hz(&self) -> Option<f64> {
        let provenance: serde_json::Value = serde_json::from_str(&self.provenance).ok()?;
        provenance.pointer("/settings/sampled_hz")?.as_f64()
    }

    /// Index into [`Truth::pixels`] of pixel (x, y).
    pub fn pixel_index(&self, x: u16, y: u16) -> Option<usize> {
        self.pixels.binary_search_by_key(&(y, x), |[x, y]| (*y, *x)).ok()
    }

    /// Region of pixel `index` at `t_us`.
    pub fn region_at(&self, index: usize, t_us: i64) -> Region {
        let (Some(&from), Some(&to)) = (self.span_start.get(index), self.span_start.get(index + 1)) else {
            return Region::Interior;
        };
        let spans = self.spans.get(from as usize..to as usize).unwrap_or(&[]);
        let next = spans.partition_point(|s| s.t_us <= t_us);
        next.checked_sub(1).map_or(Region::Interior, |i| spans[i].region)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_hold_from_their_span_to_the_next() {
        let span = |t_us, region| RegionSpan { t_us, region };
        let truth = Truth {
            camera: CameraInfo::uncalibrated("c", (4, 4)),
            sensor: SensorConfig::default(),
            reference_luminance: 1.0,
            duration_us: 100,
            pixels: vec![[3, 0], [1, 2]],
            events: Vec::new(),
            speed: Vec::new(),
            event_region: Vec::new(),
            span_start: vec![0, 1, 3],
            spans: vec![span(0, Region::Silhouette), span(0, Region::Interior), span(50, Region::ShadowEdge)],
            provenance: String::new(),
        };
        assert_eq!((truth.pixel_index(3, 0), truth.pixel_index(1, 2)), (Some(0), Some(1)));
        assert_eq!(truth.pixel_index(2, 1), None);
        assert_eq!(truth.region_at(0, 99), Region::Silhouette);
        assert_eq!((truth.region_at(1, 49), truth.region_at(1, 50)), (Region::Interior, Region::ShadowEdge));
        assert!(Region::ALL.into_iter().all(|r| Region::from_code(r as u8) == Some(r)));
    }
}
