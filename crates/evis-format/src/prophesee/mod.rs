//! Prophesee's files: RAW in EVT 2.0 and EVT 3.0, and DAT.
//!
//! Layouts: Prophesee's documentation of the EVT 2.0, EVT 3.0 and DAT file formats.

mod dat;
mod evt2;
mod evt3;
mod header;
mod raw;

pub(crate) use dat::{DatReader, DatWriter};
pub(crate) use evt3::{Decoder as Evt3Decoder, Encoder as Evt3Encoder};
pub(crate) use header::format_of_header;
pub(crate) use raw::{Evt2Writer, Evt3Writer, RawReader};
