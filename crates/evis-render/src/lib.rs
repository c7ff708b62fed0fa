//! EVIS engine: renders batches of views of a moving scene and simulates event sensors on them.
//!
//! Data flows one way: scene -> raster -> luminance -> trigger -> packets; pixel memory is the only loop. Modules import
//! those above them in this list:
//!
//! | module       | what it holds                                                                    |
//! |--------------|----------------------------------------------------------------------------------|
//! | [`gpu`]      | the device, its buffers, textures and limits; shader composition                  |
//! | [`config`]   | a run's settings, and the instants at which it samples                            |
//! | `pass`       | passes: bindings and pipelines, each of one shader                                |
//! | `world`      | the scene on the device: geometry, materials, views, bounds in the picture        |
//! | [`cpu`]      | twins of shaders on the host, for tests                                           |
//! | `shadow`     | what throws shadows where: light matrices, volumes, trees for shadow rays         |
//! | `frame`      | poses of an instant as shaders read them, and what changed since the last         |
//! | `raster`     | drawing: luminance layers, geometry, shadow maps                                  |
//! | `sensor`     | from luminance to events: trigger, sensor chain, host sensors, readout            |
//! | `sampling`   | when and where luminance is rendered: every instant, by motion, or warped         |
//! | `output`     | packets, frames and labels                                                        |
//! | `engine`     | submissions in flight, and the simulator over them                                |
//! | [`request`]  | what users ask for: presets and settings files                                    |
//! | [`tune`]     | a search for the cheapest settings of a scene                                     |

pub mod config;
pub mod cpu;
mod engine;
pub mod error;
mod frame;
pub mod gpu;
mod output;
mod pass;
mod raster;
pub mod request;
mod sampling;
mod sensor;
mod shadow;
pub mod tune;
mod world;

#[cfg(test)]
mod tests;

pub use config::dense::{DenseKind, DenseOutput};
pub use config::{
    Antialias, Compute, Interpolation, Method, Quality, RenderedTiles, RunConfig, Shadows, scene_sensors,
};
pub use engine::bench;
pub use engine::follower::Followers;
pub use engine::{EnvironmentLens, EnvironmentSensor, PacketStream, Simulator};
pub use error::EngineError;
/// Of [`DenseKind`].
pub use evis_representation::{Decay, Polarities};
pub use evis_scene as scene;
pub use gpu::{DeviceSummary, Gpu, list_devices};
pub use output::{
    Bodies, BodyRow, BodyTimes, DenseValues, DenseWindow, HostBodies, HostSpan, Imu, ImuConfig, ImuNoise,
    Packet, PacketReport, StageTimes, ViewPacket,
};
pub use request::{RunRequest, SamplingRequest, Settled, implausible, quality, settings};
pub use sampling::{audit, clipped};
/// The version that [`Gpu::from_device`] takes devices of.
pub use wgpu;

/// What a program that embeds the engine needs first: `use evis_render::prelude::*;`.
pub mod prelude {
    pub use evis_core::{CameraInfo, Event, Polarity, SensorConfig};

    pub use crate::{EngineError, Gpu, Packet, Quality, RunConfig, RunRequest, Simulator, ViewPacket, scene};
}
