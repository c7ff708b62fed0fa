//! Files with positions for errors, and drafts that become files when they are finished.

use std::fs::{self, File};
use std::io::{BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use evis_core::format::FormatError;
use evis_core::limits::open_regular;

/// What a user can do about a damaged file.
pub(crate) const COPY_AGAIN: &str = "copy it again from its source; what comes before that byte can be read";

/// An open file, and where its next byte comes from.
pub(crate) struct Input {
    path: PathBuf,
    file: File,
    length: u64,
    at: u64,
}

impl Input {
    pub(crate) fn open(path: &Path) -> Result<Self, FormatError> {
        let open = || {
            let file = open_regular(path)?;
            let length = file.metadata()?.len();
            Ok((file, length))
        };
        let (file, length) = open().map_err(|error| FormatError::io(path, "read", error))?;
        Ok(Self { path: path.into(), file, length, at: 0 })
    }

    /// Bytes of the whole file.
    pub(crate) const fn length(&self) -> u64 {
        self.length
    }

    /// Offset of the next byte.
    pub(crate) const fn at(&self) -> u64 {
        self.at
    }

    /// The part of the file before the next byte, 0 to 1.
    pub(crate) fn part(&self) -> f64 {
        self.at as f64 / self.length.max(1) as f64
    }

    pub(crate) fn seek(&mut self, at: u64) -> Result<(), FormatError> {
        self.at = self
            .file
            .seek(SeekFrom::Start(at))
            .map_err(|error| FormatError::io(&self.path, "read", error))?;
        Ok(())
    }

    /// Replaces `block` by the next `size` bytes, fewer at the end of the file.
    pub(crate) fn read_block(&mut self, block: &mut Vec<u8>, size: usize) -> Result<(), FormatError> {
        block.clear();
        // A file may shrink while it is read, and a size may come from a damaged file: `take` allocates no
        // more than there is.
        let read = (&mut self.file).take(size as u64).read_to_end(block);
        self.at += read.map_err(|error| FormatError::io(&self.path, "read", error))? as u64;
        Ok(())
    }

    /// Fills `bytes` with the next ones, and returns how many there are: fewer at the end of the file.
    pub(crate) fn read_into(&mut self, bytes: &mut [u8]) -> Result<usize, FormatError> {
        let mut filled = 0;
        while let Some(rest) = bytes.get_mut(filled..).filter(|rest| !rest.is_empty()) {
            match self.file.read(rest) {
                Ok(0) => break,
                Ok(count) => filled += count,
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => return Err(FormatError::io(&self.path, "read", error)),
            }
        }
        self.at += filled as u64;
        Ok(filled)
    }

    /// The file is damaged at byte `at`; `what` completes "at byte N, ".
    pub(crate) fn damaged(&self, at: u64, what: &str) -> FormatError {
        damaged(&self.path, at, what)
    }
}

/// `path` is damaged at byte `at`; `what` completes "at byte N, ".
pub(crate) fn damaged(path: &Path, at: u64, what: &str) -> FormatError {
    FormatError::corrupt(path, format!("at byte {at}, {what}"), COPY_AGAIN)
}

/// A file under another name, which takes its own when it is finished: a failure leaves no half-written
/// file, and an old one lives until its successor stands.
pub(crate) struct Output {
    path: PathBuf,
    draft: PathBuf,
    file: Option<BufWriter<File>>,
}

impl Output {
    pub(crate) fn create(path: &Path, overwrite: bool) -> Result<Self, FormatError> {
        refuse_existing(path, overwrite)?;
        let draft = draft_path(path, "draft");
        let file = File::create(&draft).map_err(|error| FormatError::io(path, "create", error))?;
        Ok(Self { path: path.into(), draft, file: Some(BufWriter::with_capacity(1 << 18, file)) })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    pub(crate) fn write(&mut self, bytes: &[u8]) -> Result<(), FormatError> {
        let Self { path, file, .. } = self;
        let written = file.as_mut().map_or(Ok(()), |file| file.write_all(bytes));
        written.map_err(|error| FormatError::io(path, "write", error))
    }

    /// Writes `bytes` at offset `at`, and goes back to the end.
    pub(crate) fn patch(&mut self, at: u64, bytes: &[u8]) -> Result<(), FormatError> {
        let Self { path, file, .. } = self;
        let Some(file) = file else { return Ok(()) };
        let mut patch = || {
            file.seek(SeekFrom::Start(at))?;
            file.write_all(bytes)?;
            file.seek(SeekFrom::End(0))
        };
        patch().map(|_| ()).map_err(|error| FormatError::io(path, "write", error))
    }

    /// Gives the file its name.
    pub(crate) fn finish(mut self) -> Result<(), FormatError> {
        let Some(mut file) = self.file.take() else { return Ok(()) };
        let result = file.flush().and_then(|()| {
            drop(file);
            fs::rename(&self.draft, &self.path)
        });
        result.map_err(|error| {
            // The first error is the one to report.
            let _ = fs::remove_file(&self.draft);
            FormatError::io(&self.path, "write", error)
        })
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        if self.file.take().is_some() {
            let _ = fs::remove_file(&self.draft);
        }
    }
}

/// The name of a temporary file beside `path`.
pub(crate) fn draft_path(path: &Path, ending: &str) -> PathBuf {
    let name = path.file_name().map_or_else(Default::default, |name| name.to_string_lossy());
    path.with_file_name(format!(".{name}.{ending}"))
}

/// Refuses an output that exists, or that is no regular file.
pub(crate) fn refuse_existing(path: &Path, overwrite: bool) -> Result<(), FormatError> {
    match fs::metadata(path) {
        Ok(existing) if !existing.is_file() => Err(FormatError::invalid(
            path,
            "the output is not a regular file",
            "name a new file, or an old one to overwrite",
        )),
        Ok(_) if !overwrite => Err(FormatError::Exists { path: path.into() }),
        _ => Ok(()),
    }
}

/// Little- and big-endian numbers at an offset; `None` past the end.
pub(crate) fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    bytes.get(at..)?.first_chunk().map(|chunk| u16::from_le_bytes(*chunk))
}

/// As [`u16_at`].
pub(crate) fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..)?.first_chunk().map(|chunk| u32::from_le_bytes(*chunk))
}

/// As [`u16_at`].
pub(crate) fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    bytes.get(at..)?.first_chunk().map(|chunk| u64::from_le_bytes(*chunk))
}
