//! What a run delivers: packets of events, with labels and frames.

pub mod bodies;
pub mod dense;
pub mod frames;
pub mod imu;
pub mod labels;
pub mod packet;
pub mod poses;

pub use bodies::{Bodies, BodyRow, BodyTimes, HostBodies, HostSpan};
pub use imu::{Imu, ImuConfig, ImuNoise};
pub use packet::{DenseValues, DenseWindow, Packet, PacketReport, StageTimes, ViewPacket};
