//! What a stream carries beside events: cameras, labels and poses.

use serde::{Deserialize, Serialize};

use crate::error::ConfigError;
use crate::words::unknown;

/// A camera of a recording.
///
/// Pixel centres lie at +0.5, so the principal point of a centred camera is (width / 2, height / 2);
/// exports for OpenCV, ROS and DSEC subtract 0.5 from `cx` and `cy`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraInfo {
    /// Unique name within the recording; also the HDF5 group's name.
    pub name: String,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Focal length in pixels, horizontal.
    pub fx: f64,
    /// Focal length in pixels, vertical.
    pub fy: f64,
    /// Principal point, pixels from the left edge.
    pub cx: f64,
    /// Principal point, pixels from the top edge.
    pub cy: f64,
    /// Distortion of the lens; `None` for a pinhole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distortion: Option<LensDistortion>,
}

impl CameraInfo {
    /// A camera of `size` pixels whose lens has this focal length and principal point in pixels, and distorts as a model, by name,
    /// does with these coefficients.
    pub fn new(
        name: impl Into<String>,
        (width, height): (u32, u32),
        [fx, fy]: [f64; 2],
        [cx, cy]: [f64; 2],
        distortion: Option<(&str, Vec<f64>)>,
    ) -> Self {
        let distortion =
            distortion.map(|(model, coefficients)| LensDistortion { model: model.to_owned(), coefficients });
        Self { name: name.into(), width, height, fx, fy, cx, cy, distortion }
    }

    /// A camera whose lens is not known, or orthographic: focal lengths and principal point are NaN.
    pub fn uncalibrated(name: impl Into<String>, (width, height): (u32, u32)) -> Self {
        Self::new(name, (width, height), [f64::NAN; 2], [f64::NAN; 2], None)
    }
}

/// Of OpenCV's rational model, with thin prisms and a tilted sensor.
const MOST_COEFFICIENTS: usize = 14;

/// How a lens departs from a pinhole: a model, and its coefficients in OpenCV's order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LensDistortion {
    /// `radtan` (k1 k2 p1 p2 k3 k4 k5 k6) or `fisheye` (Kannala-Brandt, k1 to k4).
    pub model: String,
    /// As many as the model has; missing ones at the end are 0.
    pub coefficients: Vec<f64>,
}

impl LensDistortion {
    /// Whether there are no more coefficients than any model has, all of them finite.
    pub fn is_usable(&self) -> bool {
        self.coefficients.len() <= MOST_COEFFICIENTS
            && self.coefficients.iter().all(|value| value.is_finite())
    }
}

/// Which label an image carries. Labels are one sample at the pixel's centre.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LabelKind {
    /// Planar z in metres, +inf where nothing: f32 (H, W).
    Depth,
    /// Pixels from this label's time to the next one's, anchored here: f32 (H, W, 2), x right, y down.
    FlowForward,
    /// Where [`LabelKind::FlowForward`] is defined: u8 (H, W), 1 or 0.
    FlowForwardValid,
    /// Pixels from this label's time back to the one before, anchored here: f32 (H, W, 2).
    FlowBackward,
    /// Where [`LabelKind::FlowBackward`] is defined: u8 (H, W), 1 or 0.
    FlowBackwardValid,
    /// Instance id, 0 where nothing: u32 (H, W).
    Instance,
    /// Semantic id, 0 where nothing or unlabelled: u32 (H, W).
    Semantic,
    /// Unit surface normal in world axes, facing the camera; 0 where nothing: f32 (H, W, 3).
    Normal,
    /// Linear, scene-referred RGB: f32 (H, W, 3).
    Hdr,
    /// Mean linear luminance over an exposure, stamped at its middle: f32 (H, W). No label, but it travels with them.
    Frame,
    /// Why each event fired: u8 per event, a number of [`crate::Cause`]. No image, and so not in [`LabelKind::ALL`].
    Cause,
}

impl LabelKind {
    /// All kinds of images, in file order.
    pub const ALL: [Self; 10] = [
        Self::Depth,
        Self::FlowForward,
        Self::FlowForwardValid,
        Self::FlowBackward,
        Self::FlowBackwardValid,
        Self::Instance,
        Self::Semantic,
        Self::Normal,
        Self::Hdr,
        Self::Frame,
    ];

    /// Name of the data set and of the Python key.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Depth => "depth",
            Self::FlowForward => "flow_forward",
            Self::FlowForwardValid => "flow_forward_valid",
            Self::FlowBackward => "flow_backward",
            Self::FlowBackwardValid => "flow_backward_valid",
            Self::Instance => "instance",
            Self::Semantic => "semantic",
            Self::Normal => "normal",
            Self::Hdr => "hdr",
            Self::Frame => "frame",
            Self::Cause => "cause",
        }
    }

    /// Words that labels are asked for by, with what they mean. `flow` stands for both directions and their masks.
    pub const WORDS: [(&'static str, &'static str); 11] = [
        ("depth", "planar depth in metres"),
        ("flow", "optical flow, forward and backward, with masks"),
        ("instance", "instance ids"),
        ("semantic", "semantic ids"),
        ("normal", "surface normals in world axes"),
        ("hdr", "linear RGB frames"),
        ("cause", "why each event fired: signal, leak, shot noise or hot pixel; a column beside the events"),
        ("flow_forward", "flow to the next label"),
        ("flow_forward_valid", "where it is defined"),
        ("flow_backward", "flow back to the label before"),
        ("flow_backward_valid", "where it is defined"),
    ];

    /// The kinds that `words` ask for, in file order, each once.
    ///
    /// # Errors
    /// A word that is none of [`Self::WORDS`].
    pub fn asked(words: &[String]) -> Result<Vec<Self>, ConfigError> {
        let mut kinds = Vec::new();
        for word in words {
            match word.as_str() {
                "flow" => kinds.extend(Self::ALL.iter().filter(|kind| kind.name().starts_with("flow_"))),
                "frame" => {
                    let remedy = "left out: frames come with `frame_rate_hz`, and need no label";
                    return Err(ConfigError::new("labels", "'frame'", remedy));
                }
                word if Self::WORDS.iter().any(|(known, _)| *known == word) => {
                    kinds.extend(Self::ALL.iter().chain([&Self::Cause]).filter(|kind| kind.name() == word));
                }
                word => return Err(unknown("labels", word, &Self::WORDS.map(|(known, _)| known))),
            }
        }
        kinds.sort_unstable();
        kinds.dedup();
        Ok(kinds)
    }

    /// Whether it is an image.
    pub const fn is_image(self) -> bool {
        !matches!(self, Self::Cause)
    }

    /// Values per pixel.
    pub const fn channels(self) -> usize {
        match self {
            Self::FlowForward | Self::FlowBackward => 2,
            Self::Normal | Self::Hdr => 3,
            _ => 1,
        }
    }
}

/// Pixels of a label, row-major, channels innermost.
#[derive(Clone, Debug, PartialEq)]
pub enum LabelData {
    /// Depth, flow, normals, HDR.
    F32(Vec<f32>),
    /// Ids.
    U32(Vec<u32>),
    /// Masks.
    U8(Vec<u8>),
}

/// One label image.
#[derive(Clone, Debug, PartialEq)]
pub struct LabelFrame {
    /// What it shows.
    pub kind: LabelKind,
    /// When, in microseconds.
    pub t_us: i64,
    /// The other end of a flow's interval, or the start of a frame's exposure, which ends as long after `t_us`;
    /// microseconds, equal to `t_us` for every other label.
    pub t_other_us: i64,
    /// Pixels, `height * width * kind.channels()` of them.
    pub data: LabelData,
}

/// What an inertial measurement unit measures at one time, in its own axes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImuSample {
    /// Microseconds.
    pub t_us: i64,
    /// Specific force in m/s^2: acceleration less gravity. At rest it points up, and is as long as gravity.
    pub accelerometer: [f64; 3],
    /// Angular rate in rad/s.
    pub gyroscope: [f64; 3],
}

/// Pose of a camera or body at one time: `world_from_body`, metres, glTF axes (+Y up, cameras look along -Z).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseSample {
    /// Microseconds.
    pub t_us: i64,
    /// Position in metres.
    pub position: [f64; 3],
    /// Unit quaternion, (x, y, z, w).
    pub rotation: [f64; 4],
}
