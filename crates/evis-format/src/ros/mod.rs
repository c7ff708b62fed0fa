//! ROS 2 bags in MCAP.

mod bag;
mod cdr;
mod export;
mod mcap;
mod message;

pub use export::{McapExport, export_mcap};
pub(crate) use mcap::{MAGIC, McapReader, McapWriter};
