//! ROS 2 bags in MCAP.

mod bag;
mod cdr;
mod export;
mod import;
mod mcap;
mod message;
mod parse;
mod records;

pub use export::{McapExport, export_mcap};
pub use import::{BagImport, import_mcap};
pub(crate) use mcap::{MAGIC, McapReader, McapWriter};
