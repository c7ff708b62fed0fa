//! How a file's content tells its format.

use std::io::Read;
use std::path::Path;

use evis_core::format::FormatError;
use evis_core::limits::open_regular;

use crate::format::Format;
use crate::{dsec, es, hdf5, prophesee, ros, text};

/// Bytes at the start of a file that tell its format.
const HEAD: u64 = 64 << 10;

/// The format of the file at `path`, from its content; `None` where it is none of them.
///
/// # Errors
/// A file that cannot be read.
pub fn recognise(path: &Path) -> Result<Option<Format>, FormatError> {
    if path.is_dir() {
        return Ok((!dsec::cameras(path).is_empty()).then_some(Format::Dsec));
    }
    let mut head = Vec::new();
    open_regular(path)
        .and_then(|file| file.take(HEAD).read_to_end(&mut head))
        .map_err(|error| FormatError::io(path, "read", error))?;
    Ok(of_head(&head).or_else(|| text::archive_format(path, &head)))
}

fn of_head(head: &[u8]) -> Option<Format> {
    if head.starts_with(b"#!AER-DAT4") {
        Some(Format::Aedat4)
    } else if head.starts_with(b"#!AER-DAT2") {
        Some(Format::Aedat2)
    } else if head.starts_with(b"\x93NUMPY") {
        Some(Format::Npy)
    } else if head.starts_with(ros::MAGIC) {
        Some(Format::Mcap)
    } else if head.starts_with(es::MAGIC) {
        Some(Format::Es)
    } else if [0, 512, 1024, 2048, 4096]
        .into_iter()
        .any(|at| head.get(at..).is_some_and(|bytes| bytes.starts_with(hdf5::SIGNATURE)))
    {
        Some(Format::Hdf5)
    } else if head.starts_with(b"%") {
        prophesee::format_of_header(head)
    } else {
        text::looks_like_text(head).then_some(Format::Text)
    }
}
