//! Writing: one trait.

use std::path::Path;

use evis_core::Event;
use evis_core::format::FormatError;

use crate::format::Format;
use crate::packet::Packet;
use crate::{aedat, es, hdf5, mcap, numpy, prophesee, text};

/// Writes a file packet by packet, in constant memory. The file has its name once it is finished; a writer
/// that is dropped before leaves nothing.
pub trait EventWriter: Send {
    /// Appends a packet.
    ///
    /// # Errors
    /// What the format cannot hold, events that go back in time or lie outside of the image (then nothing
    /// of the packet is written), and a disk that refuses.
    fn write(&mut self, packet: &Packet) -> Result<(), FormatError>;

    /// Appends events alone; as [`EventWriter::write`].
    ///
    /// # Errors
    /// As [`EventWriter::write`].
    fn write_events(&mut self, events: &[Event]) -> Result<(), FormatError>;

    /// Ends the file and gives it its name.
    ///
    /// # Errors
    /// A disk that refuses.
    fn finish(self: Box<Self>) -> Result<(), FormatError>;
}

/// How a file is written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WriteOptions {
    /// Pixels per row, and rows.
    pub size: (u32, u32),
    /// Replace a file that exists.
    pub overwrite: bool,
}

/// Creates a file of `format` at `path`.
///
/// # Errors
/// An output that exists, a folder that cannot be written to, and a size that the format cannot hold.
pub fn create(
    path: &Path,
    format: Format,
    options: &WriteOptions,
) -> Result<Box<dyn EventWriter>, FormatError> {
    if format == Format::Dsec {
        return Err(FormatError::invalid(
            path,
            "a folder in DSEC's layout holds a whole recording",
            "convert an HDF5 recording of EVIS with --format dsec",
        ));
    }
    let (width, height) = options.size;
    let most = match format {
        Format::Evt3 | Format::Evt2 | Format::Mcap => 2048,
        Format::Dat => 1 << 14,
        Format::Aedat4 => 1 << 15,
        Format::Es => (1 << 16) - 1,
        _ => 1 << 16,
    };
    if width == 0 || height == 0 || width > most || height > most {
        return Err(FormatError::invalid(
            path,
            format!("a sensor of {width}x{height} does not fit"),
            format!("{format} holds sizes from 1x1 to {most}x{most}"),
        ));
    }
    let writer: Box<dyn EventWriter> = match format {
        Format::Evt3 => Box::new(prophesee::Evt3Writer::create(path, options)?),
        Format::Evt2 => Box::new(prophesee::Evt2Writer::create(path, options)?),
        Format::Dat => Box::new(prophesee::DatWriter::create(path, options)?),
        Format::Aedat4 => Box::new(aedat::Aedat4Writer::create(path, options)?),
        Format::Aedat2 => Box::new(aedat::Aedat2Writer::create(path, options)?),
        Format::Text => Box::new(text::TextWriter::create(path, options)?),
        Format::TextZip => Box::new(text::ZipWriter::create(path, options)?),
        Format::Npz => Box::new(numpy::NpzWriter::create(path, options)?),
        Format::Npy => Box::new(numpy::NpyWriter::create(path, options)?),
        Format::Mcap => Box::new(mcap::McapWriter::create(path, options)?),
        Format::Es => Box::new(es::EsWriter::create(path, options)?),
        Format::Hdf5 | Format::Dsec => Box::new(hdf5::Hdf5Writer::create(path, options)?),
    };
    Ok(writer)
}
