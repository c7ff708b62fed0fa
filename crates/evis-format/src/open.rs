//! The reader or writer of a file, by its format.

use std::path::Path;

use evis_core::format::FormatError;

use crate::format::Format;
use crate::read::{EventReader, ReadOptions};
use crate::recognise::recognise;
use crate::write::{EventWriter, WriteOptions};
use crate::{aedat, dsec, es, hdf5, numpy, prophesee, ros, text};

/// Opens the file at `path`, whatever its format is.
///
/// # Errors
/// A file that cannot be read, of a format that is not read, or damaged within its header.
pub fn open(path: &Path, options: &ReadOptions) -> Result<Box<dyn EventReader>, FormatError> {
    let Some(format) = recognise(path)? else {
        let formats: Vec<_> = Format::ALL.iter().map(|format| format.description()).collect();
        return Err(FormatError::corrupt(
            path,
            "its content is of no known event format",
            format!("give one of: {}", formats.join("; ")),
        ));
    };
    let reader: Box<dyn EventReader> = match format {
        Format::Evt3 | Format::Evt2 => Box::new(prophesee::RawReader::open(path, options)?),
        Format::Dat => Box::new(prophesee::DatReader::open(path, options)?),
        Format::Aedat4 => Box::new(aedat::Aedat4Reader::open(path, options)?),
        Format::Aedat2 => {
            return Err(FormatError::invalid(
                path,
                "AEDAT 2.0 is written and not read",
                "convert it to AEDAT 4.0 with DV, or export it from jAER",
            ));
        }
        Format::Text | Format::TextZip => Box::new(text::TextReader::open(path, format, options)?),
        Format::Npz => Box::new(numpy::NpzReader::open(path, options)?),
        Format::Npy => Box::new(numpy::NpyReader::open(path, options)?),
        Format::Hdf5 => Box::new(hdf5::Hdf5Reader::open(path, options)?),
        Format::Mcap => Box::new(ros::McapReader::open(path, options)?),
        Format::Es => Box::new(es::EsReader::open(path)?),
        Format::Dsec => Box::new(dsec::DsecReader::open(path, options)?),
    };
    Ok(reader)
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
    check_size(path, format, options.size)?;
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
        Format::Mcap => Box::new(ros::McapWriter::create(path, options)?),
        Format::Es => Box::new(es::EsWriter::create(path, options)?),
        Format::Hdf5 => Box::new(hdf5::Hdf5Writer::create(path, options)?),
        Format::Dsec => Box::new(dsec::DsecWriter::create(path, options)?),
    };
    Ok(writer)
}

/// Refuses a sensor that is larger than those of `format`.
pub(crate) fn check_size(
    path: &Path,
    format: Format,
    (width, height): (u32, u32),
) -> Result<(), FormatError> {
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
    Ok(())
}
