//! Keyframes with motion vectors: pictures of the instants between two of them, made from both.

mod last_keyframe;
mod links;
mod motion_check;
mod paths;
mod push;
mod scratch_pool;
mod warp;

pub(super) use last_keyframe::Keyframe;
pub use motion_check::{MotionCheck, check_motion};
pub use push::{Cut, KeyframeReport, Keyframes, WARN_GAP_PX};
pub(super) use scratch_pool::ScratchPool;
pub(super) use warp::MOST_MARGIN;
pub use warp::{Gap, Pictures, Scratch, Side, Warp, WarpVariant};
