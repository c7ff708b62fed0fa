//! Event files of other programs, read and written packet by packet in constant memory.
//!
//! [`open`] recognises a file by its content and returns an [`EventReader`]; [`create`] returns an
//! [`EventWriter`] for a [`Format`]. [`convert`] copies one to the other.
//!
//! Times are integer microseconds, `x` runs right and `y` down from the top-left pixel, polarity is ON = 1,
//! OFF = 0, whatever the file's own convention is. Round trips are exact; what a format cannot hold is
//! refused before it is written.

mod aedat;
mod check;
mod convert;
mod dsec;
mod es;
mod files;
mod format;
mod hdf5;
mod numpy;
mod open;
mod packet;
mod pixel_map;
mod prophesee;
mod read;
mod recognise;
mod ros;
mod text;
mod whole;
mod work;
mod write;

pub use convert::{ConvertOptions, Converted, convert};
pub use dsec::{DsecExport, export_dsec};
pub use format::Format;
pub use open::{create, open};
pub use packet::{AedatImuSample, Frame, Packet, Trigger};
pub use pixel_map::PixelMap;
pub use read::{Between, EventReader, Extent, ReadOptions, StreamInfo, measure};
pub use recognise::recognise;
pub use ros::{BagImport, McapExport, export_mcap, import_mcap};
pub use whole::read_events;
pub use write::{EventWriter, WriteOptions};

pub use evis_core::Event;
pub use evis_core::format::{EventFile, FormatError};
