//! Which formats there are, their names and endings.

use std::path::Path;

/// A file format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Format {
    /// Prophesee RAW, EVT 3.0.
    Evt3,
    /// Prophesee RAW, EVT 2.0.
    Evt2,
    /// Prophesee DAT, version 2.
    Dat,
    /// iniVation AEDAT 4.0.
    Aedat4,
    /// jAER's AEDAT 2.0; written only.
    Aedat2,
    /// Text, `t x y p` per line with t in seconds.
    Text,
    /// The same, zipped.
    TextZip,
    /// Columns t, x, y and p in an archive of `NumPy` arrays.
    Npz,
    /// A `NumPy` array of events.
    Npy,
    /// HDF5: EVIS's own recordings, which are written; DSEC, RVT, `event_utils`, M3ED and v2e, which are read.
    Hdf5,
    /// ROS 2 bags in MCAP with `event_camera_msgs` in EVT 3.0.
    Mcap,
    /// Event Stream, version 2, of DVS events.
    Es,
    /// A folder in the layout of DSEC; see [`crate::export_dsec`] for writing.
    Dsec,
}

impl Format {
    /// All of them.
    pub const ALL: [Self; 13] = [
        Self::Evt3,
        Self::Evt2,
        Self::Dat,
        Self::Aedat4,
        Self::Aedat2,
        Self::Text,
        Self::TextZip,
        Self::Npz,
        Self::Npy,
        Self::Hdf5,
        Self::Mcap,
        Self::Es,
        Self::Dsec,
    ];

    /// Those that are written and read as one file of events: what tests and fuzzing go through. HDF5 is a
    /// recording of its own, AEDAT 2.0 is written only, and DSEC is a folder.
    pub const BOTH_WAYS: [Self; 10] = [
        Self::Evt3,
        Self::Evt2,
        Self::Dat,
        Self::Aedat4,
        Self::Text,
        Self::TextZip,
        Self::Npz,
        Self::Npy,
        Self::Mcap,
        Self::Es,
    ];

    /// The name that `--format` takes.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Evt3 => "evt3",
            Self::Evt2 => "evt2",
            Self::Dat => "dat",
            Self::Aedat4 => "aedat4",
            Self::Aedat2 => "aedat2",
            Self::Text => "text",
            Self::TextZip => "text-zip",
            Self::Npz => "npz",
            Self::Npy => "npy",
            Self::Hdf5 => "hdf5",
            Self::Mcap => "mcap",
            Self::Es => "es",
            Self::Dsec => "dsec",
        }
    }

    /// What it is, for people.
    pub const fn description(self) -> &'static str {
        match self {
            Self::Evt3 => "Prophesee RAW, EVT 3.0",
            Self::Evt2 => "Prophesee RAW, EVT 2.0",
            Self::Dat => "Prophesee DAT",
            Self::Aedat4 => "AEDAT 4.0",
            Self::Aedat2 => "AEDAT 2.0 (jAER)",
            Self::Text => "text, t x y p",
            Self::TextZip => "zipped text, t x y p",
            Self::Npz => "NumPy archive of columns",
            Self::Npy => "NumPy array of events",
            Self::Hdf5 => "HDF5",
            Self::Mcap => "ROS 2 bag (MCAP)",
            Self::Es => "Event Stream",
            Self::Dsec => "DSEC folder",
        }
    }

    /// The format of this name.
    pub fn of_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name() == name)
    }

    /// The format that a new file at `path` would have by its ending; `.raw` is EVT 3.0.
    pub fn of_ending(path: &Path) -> Option<Self> {
        let ending = path.extension()?.to_string_lossy().to_ascii_lowercase();
        Some(match ending.as_str() {
            "raw" => Self::Evt3,
            "dat" => Self::Dat,
            "aedat4" => Self::Aedat4,
            "aedat" | "aedat2" => Self::Aedat2,
            "txt" | "csv" => Self::Text,
            "zip" => Self::TextZip,
            "npz" => Self::Npz,
            "npy" => Self::Npy,
            "h5" | "hdf5" => Self::Hdf5,
            "mcap" => Self::Mcap,
            "es" => Self::Es,
            _ => return None,
        })
    }
}

impl std::fmt::Display for Format {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.description())
    }
}
