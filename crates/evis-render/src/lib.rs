//! EVIS engine: renders batches of views of a moving scene and feels them as event sensors would.
//!
//! Data flows one way: scene -> raster -> luminance -> trigger -> packets; pixel memory is the only loop.

#[doc(hidden)]
mod adaptive;
mod area;
pub mod auto;
pub mod bench;
mod chain;
pub mod config;
mod cover;
pub mod cpu;
mod engine;
pub mod error;
mod exposure;
mod frame;
mod frame_buffers;
mod geometry;
pub mod gpu;
mod gpu_scene;
pub mod grid;
mod host_walk;
mod interval;
mod keyframes;
mod labels;
mod lamp;
mod method;
mod needs;
mod occluders;
mod pace;
pub mod packet;
mod parts;
mod pass;
pub mod pattern;
mod pieces;
mod pilot;
pub mod plan;
mod scene_sensor;
pub mod search;
mod shader;
mod shadow;
mod shadow_cells;
mod shadow_pace;
pub mod simulator;
pub mod sizes;
mod splat;
mod still;
mod targets;
mod tiles;
mod uniforms;
mod unpack;
mod variant;
mod view;
mod view_motion;

#[cfg(test)]
mod tests;

pub use auto::{Chosen, Target};
pub use config::{Antialias, Between, Method, RunConfig, Shadows};
pub use error::EngineError;
pub use evis_scene as scene;
pub use gpu::{DeviceSummary, Gpu, list_devices};
pub use packet::{Packet, PacketReport, StageTimes, ViewPacket};
pub use plan::Plan;
pub use scene_sensor::scene_sensors;
pub use simulator::{PacketStream, Simulator};
