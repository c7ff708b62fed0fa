//! EVIS engine: renders batches of views of a moving scene and feels them as event sensors would.
//!
//! Data flows one way: scene -> raster -> luminance -> trigger -> packets; `PixelMemory` is the only loop.

pub mod config;
pub mod cpu;
pub mod error;
pub mod gpu;
pub mod packet;
pub mod simulator;

pub use config::{Antialias, Method, RunConfig};
pub use error::EngineError;
pub use evis_scene as scene;
pub use gpu::{DeviceSummary, Gpu, list_devices};
pub use packet::{Packet, PacketReport, StageTimes, ViewPacket};
pub use simulator::{PacketStream, Simulator};
