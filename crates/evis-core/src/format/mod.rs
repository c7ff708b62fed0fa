//! File formats. HDF5 is the default one.

use std::io;
use std::path::{Path, PathBuf};

pub mod hdf5;

/// Why a file could not be written or read: which one, what is wrong, and what would work.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FormatError {
    /// The operating system refused.
    #[error("cannot {action} {}: {source}; {}", .path.display(), io_remedy(.source))]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried, as a verb: "create", "write", "read".
        action: &'static str,
        /// The reason that the system gave.
        source: io::Error,
    },
    /// The output exists already.
    #[error("{} exists already; choose another name, or allow overwriting (--force)", .path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The file's content cannot be understood.
    #[error("{} cannot be read: {what}; {remedy}", .path.display())]
    Corrupt {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
        /// What would work.
        remedy: String,
    },
    /// What was asked for does not fit the file or the format.
    #[error("{}: {what}; {remedy}", .path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What was refused, with its value.
        what: String,
        /// What would work.
        remedy: String,
    },
}

impl FormatError {
    /// An error of the operating system while doing `action` (a verb) to `path`.
    pub fn io(path: &Path, action: &'static str, source: io::Error) -> Self {
        Self::Io { path: path.into(), action, source }
    }

    /// `path` holds something that cannot be understood; both texts complete a sentence.
    pub fn corrupt(path: &Path, what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Corrupt { path: path.into(), what: what.into(), remedy: remedy.into() }
    }

    /// A request that `path` cannot serve; both texts complete a sentence.
    pub fn invalid(path: &Path, what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Invalid { path: path.into(), what: what.into(), remedy: remedy.into() }
    }

    /// The file that the error is about.
    pub fn path(&self) -> &Path {
        match self {
            Self::Io { path, .. }
            | Self::Exists { path }
            | Self::Corrupt { path, .. }
            | Self::Invalid { path, .. } => path,
        }
    }
}

/// What a user can do about an error of the operating system.
fn io_remedy(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::StorageFull => "free space on that disk, or write to another one",
        io::ErrorKind::QuotaExceeded | io::ErrorKind::FileTooLarge => {
            "write to a disk that allows files of this size"
        }
        io::ErrorKind::PermissionDenied => "choose a folder that you may write to, or change its permissions",
        io::ErrorKind::ReadOnlyFilesystem => "choose a folder on a disk that can be written to",
        io::ErrorKind::NotFound => "check the path: the folder must exist",
        io::ErrorKind::IsADirectory => "name a file, not a folder",
        _ => "check the path and the disk",
    }
}
