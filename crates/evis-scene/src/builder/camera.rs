//! Event cameras to be added to a scene.

use std::f64::consts::PI;

use crate::distortion::Distortion;
use crate::model::{CameraSensor, Lens, SensorKind};

/// An event camera to be added.
#[derive(Clone, Debug, PartialEq)]
pub struct EventCamera {
    /// Unique name.
    pub name: String,
    /// Lens.
    pub lens: Lens,
    /// Pixels; `None` leaves it to the run.
    pub size: Option<[u32; 2]>,
    /// Distortion of the lens, which then has [`Lens::Intrinsics`]; `None` for a pinhole.
    pub distortion: Option<Distortion>,
    /// Near plane, metres.
    pub near: f64,
    /// ON and OFF thresholds; `None` takes the run's.
    pub thresholds: [Option<f32>; 2],
    /// The sensor; `None` takes the run's.
    pub sensor: Option<CameraSensor>,
}

impl EventCamera {
    /// 60 degrees high, near plane at 5 cm, everything else left to the run.
    pub fn new(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            lens: Lens::FieldOfView { fov_y: PI / 3.0 },
            size: None,
            distortion: None,
            near: 0.05,
            thresholds: [None; 2],
            sensor: None,
        }
    }

    /// Pixels.
    pub fn size(mut self, width: u32, height: u32) -> Self {
        self.size = Some([width, height]);
        self
    }

    /// Vertical field of view.
    pub fn fov_y_degrees(mut self, degrees: f64) -> Self {
        self.lens = Lens::FieldOfView { fov_y: degrees.to_radians() };
        self
    }

    /// Pinhole intrinsics in pixels, pixel centres at +0.5.
    pub fn intrinsics(mut self, fx: f64, fy: f64, cx: f64, cy: f64) -> Self {
        self.lens = Lens::Intrinsics { fx, fy, cx, cy };
        self
    }

    /// An orthographic camera that shows `height` metres from its lower to its upper edge, and nothing farther than `far` metres.
    pub fn orthographic(mut self, height: f64, far: f64) -> Self {
        self.lens = Lens::Orthographic { height, far };
        self
    }

    /// Distortion of the lens, for [`EventCamera::intrinsics`].
    pub fn distortion(mut self, distortion: Distortion) -> Self {
        self.distortion = Some(distortion);
        self
    }

    /// Near plane in metres.
    pub fn near(mut self, near: f64) -> Self {
        self.near = near;
        self
    }

    /// Contrast thresholds, both positive.
    pub fn thresholds(mut self, on: f32, off: f32) -> Self {
        self.thresholds = [Some(on), Some(off)];
        self
    }

    /// A preset of a sensor, by name; it is looked up when the scene is simulated.
    pub fn sensor(mut self, preset: impl Into<String>) -> Self {
        let place = format!("camera '{}', sensor", self.name);
        self.sensor = Some(CameraSensor { kind: SensorKind::Preset(preset.into()), place });
        self
    }
}
