//! File formats. HDF5 is the default one.

use std::io;
use std::path::{Path, PathBuf};

pub mod hdf5;
pub mod numpy;

use crate::event::{Event, MOST_T_US};

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
    /// What was written cannot be found any more: the file was removed or replaced meanwhile.
    #[error("{}: {source}; leave the file alone while it is written, and run again", .path.display())]
    Lost {
        /// The file.
        path: PathBuf,
        /// What happened to it.
        source: io::Error,
    },
    /// The output exists already.
    #[error("{} exists already; choose another name, or allow overwriting (`overwrite`)", .path.display())]
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
            | Self::Lost { path, .. }
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
        io::ErrorKind::InvalidInput => "name a regular file",
        io::ErrorKind::OutOfMemory => "raise the limit, or name a smaller file",
        _ => "check the path and the disk",
    }
}

/// The events of one camera, from any file that is read.
#[derive(Clone, Debug, PartialEq)]
pub struct EventFile {
    /// In order of time.
    pub events: Vec<Event>,
    /// Pixels per row, and rows; of a file that does not say, as many as there are events on.
    pub size: (u32, u32),
    /// When the recording starts and ends, microseconds; of a file that does not say, its first event and just after its
    /// last one.
    pub range: (i64, i64),
}

/// Checks what no reader hands out: events that lie outside of `(width, height)` pixels, go back in time, have a
/// polarity that is neither 0 nor 1, or times that no computation has room for. `events` begin with number `first` of
/// the file, and the one before it was at `earlier_us`.
///
/// # Errors
/// The first such event, as the end of a sentence that begins with the file's name.
pub fn check_events(
    events: &[Event],
    (width, height): (u32, u32),
    first: u64,
    mut earlier_us: i64,
) -> Result<(), String> {
    let fits = |e: &Event| {
        u32::from(e.x) < width
            && u32::from(e.y) < height
            && (0..=1).contains(&e.p)
            && (-MOST_T_US..=MOST_T_US).contains(&e.t)
    };
    // Whole blocks first, without a branch per event: most files have nothing to find.
    let block_fits = |block: &[Event]| block.iter().fold(true, |all, e| all & fits(e));
    let in_order = events.first().is_none_or(|e| earlier_us <= e.t) && events.is_sorted_by_key(|e| e.t);
    if in_order && events.chunks(1 << 12).all(block_fits) {
        return Ok(());
    }
    for (index, e) in (first..).zip(events) {
        let Event { x, y, p, t, .. } = *e;
        if u32::from(x) >= width || u32::from(y) >= height {
            return Err(format!("event {index} (x {x}, y {y}, at {t} us) lies outside of {width}x{height}"));
        }
        if !(0..=1).contains(&p) {
            return Err(format!("event {index} has the polarity {p}; 0 (OFF) and 1 (ON) exist"));
        }
        if !(-MOST_T_US..=MOST_T_US).contains(&t) {
            return Err(format!("event {index} is at {t} us; times up to {MOST_T_US} us are read"));
        }
        if earlier_us > t {
            return Err(format!("event {index} is earlier than the one before it"));
        }
        earlier_us = t;
    }
    Ok(())
}
