//! EVIS scenes: what the world holds and where everything is at any time.
//!
//! Right-handed, metres, glTF axes (+Y up); cameras look along -Z. Colours are linear, scene-referred,
//! Rec. 709 primaries. Nothing here knows about a GPU: the raster engine and the oracles read the same data.

mod bodies;
pub mod builder;
pub mod builtin;
pub mod camera_motion;
mod digest;
pub mod distortion;
mod drive;
pub mod environment;
pub mod error;
mod factors;
mod file;
mod framing;
mod geometry;
pub mod gltf;
pub mod host_poses;
pub mod image;
mod interpolate;
mod intrinsics;
pub mod lens;
pub mod model;
pub mod motion;
pub mod picture;
mod pixel_lens;
mod plausible;
pub mod pose;
pub mod primitive;
pub mod procedural;
pub mod rectify;
pub mod rig;
pub mod rigid_body;
pub mod source;
pub mod steps;
pub mod texture;
pub mod toml_scene;
pub mod track;
mod transform;
mod validate;
mod visible;

pub use bodies::BodyPose;
pub use camera_motion::{CameraMotion, CameraMotionSettings};
pub use digest::digest;
pub use distortion::Distortion;
pub use drive::HostNames;
pub use error::SceneError;
pub use factors::{LightChange, LightFactors, MaterialChange, MaterialFactors};
pub use framing::{deformed, rigid, rigid_or_unrotated};
pub use host_poses::{HostJump, HostPoses, HostStep, VisibleSteps};
pub use lens::{CalibratedLens, LensModel, PinholeLens};
pub use model::*;
pub use motion::{AppliedMotion, Motion};
pub use pixel_lens::{Eye, PixelLens, PixelRay, Rays};
pub use pose::SceneState;
pub use rectify::{Rectification, RectifiedCamera};
pub use rig::{CalibrationFormat, DsecRectification, Rig, RigCamera};
pub use rigid_body::{BodyKind, BodyMass, Collider, Dynamics, RigidBody};
pub use track::HostPose;
