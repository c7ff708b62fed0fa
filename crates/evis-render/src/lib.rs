//! EVIS engine: renders batches of views of a moving scene and simulates event sensors on them.
//!
//! Data flows one way: scene -> raster -> luminance -> trigger -> packets; pixel memory is the only loop.

#[doc(hidden)]
mod adaptive;
mod area;
pub mod audit;
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
pub mod quality;
pub mod request;
mod scene_sensor;
pub mod settings;
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
pub mod tune;
mod uniforms;
mod unpack;
mod variant;
mod view;
mod view_motion;

#[cfg(test)]
mod tests;

pub use config::{Antialias, Between, Method, Quality, RunConfig, Shadows};
pub use error::EngineError;
pub use evis_scene as scene;
pub use gpu::{DeviceSummary, Gpu, list_devices};
pub use packet::{Packet, PacketReport, StageTimes, ViewPacket};
pub use request::SamplingRequest;
pub use scene_sensor::scene_sensors;
pub use simulator::{PacketStream, Simulator};
