//! iniVation's AEDAT 4.0, and jAER's AEDAT 2.0.

mod aedat2;
mod compression;
mod flatbuffer;
mod header;
mod reader;
mod writer;

pub(crate) use aedat2::Aedat2Writer;
pub(crate) use reader::Aedat4Reader;
pub(crate) use writer::Aedat4Writer;
