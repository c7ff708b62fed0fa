//! The default event file: DSEC columns in a group per camera.
//!
//! ```text
//! /<camera>/events/{x u16, y u16, t u32 or i64, p u8}   1-D, chunks of 65 536, shuffle + gzip 2
//! /<camera>/events/cause    u8, where asked for: 0 signal, 1 leak, 2 shot noise, 3 hot pixel
//! /<camera>/events/{width, height}                      i64
//! /<camera>/ms_to_idx       u64   ms_to_idx[ms] = first i with t[i] >= 1000 * ms
//! /<camera>/t_offset        i64   absolute time = t + t_offset
//! /<camera>/labels/<kind>   (T, H, W[, C]), one frame per chunk; <kind>_t_us (T), flows: <kind>_t_other_us
//! /<camera>/labels/frame    frame_t_us is an exposure's middle, frame_t_other_us its start, frame_t_end_us its end
//! /<camera>/poses/{t_us (T), position (T, 3), rotation_xyzw (T, 4)}
//! /<camera>/intrinsics/{fx, fy, cx, cy f64, width, height i64}
//! /<camera>/labels/{instance_ids u32, instance_names}   with instance labels: names of the ids
//! /<camera>/labels/{semantic_ids u32, semantic_names}   with semantic labels: names of the classes
//! /states/<name>/{names (K), t_us (N), values (N, K)}   what a host wrote of its own state
//! /bodies/{name, instance_id u32, semantic_id u32, box_min, box_max}   objects and cameras (N)
//! /bodies/semantic_name     where a class has a name
//! /bodies@bodies_hash       text, 16 hexadecimal digits: FNV-1a of the names, ids and boxes
//! /bodies/{t_us (T), position, linear_velocity, angular_velocity (T, N, 3), rotation_xyzw (T, N, 4)}
//! /evis/{seed u64, environment u32, complete u8}        attributes version, method
//! /evis/{cameras, config_toml}                          strings
//! /evis/header_hash u64                                 FNV-1a of what the writer said about the recording
//! /evis/report_json                                     u8, UTF-8 text, written at the end
//! ```
//! Every data set has the attributes `units` and `description`.
//!
//! With exactly one camera `/events`, `/ms_to_idx` and `/t_offset` are hard links to that camera's, so
//! that DSEC readers open the file unchanged. The file's attributes `width` and `height` are those of
//! the first camera.
//!
//! A truth file (see [`crate::Truth::write`]) is a recording of one camera with a group `/truth`.
//!
//! `t` is u32 where the planned duration fits (as in DSEC), and i64 where it does not or is unknown.
//!
//! Killing the writer loses at most the last second: the file then opens in h5py with `swmr=True`, and
//! plainly after [`repair`].

mod column;
mod layout;
mod reader;
mod repair;
mod store;
mod truth;
mod units;
mod whole;
mod writer;

use std::hash::Hasher as _;

use crate::fnv::Fnv;
use crate::packet::{CameraInfo, LabelData, LabelKind};

pub use reader::Recording;
pub use repair::{Hole, RepairReport, check, repair};
pub use truth::stored_sensor;
pub use whole::read_events;
pub use writer::{RecordingExtras, RecordingWriter};

/// Version of the layout, in the attribute `/evis@version`.
pub const LAYOUT_VERSION: &str = "1";

/// Rows per chunk of the event columns: the chunk of DSEC's own files.
const EVENTS_PER_CHUNK: usize = 65_536;
/// gzip level of every data set.
const GZIP_LEVEL: u32 = 2;
/// Deflate expands at most 1032 times; a data set that promises more than this cannot be in the file.
const LARGEST_EXPANSION: u64 = 1100;
/// Names that a camera may not have, since the root group uses them.
const RESERVED_NAMES: [&str; 8] =
    ["events", "ms_to_idx", "t_offset", "evis", "truth", "imus", "bodies", "states"];

/// What a recording says about itself; written when it is created.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordingHeader {
    /// The cameras, in the order of their indices; names are unique.
    pub cameras: Vec<CameraInfo>,
    /// Seed of all randomness.
    pub seed: u64,
    /// Sampling method, e.g. "native".
    pub method: String,
    /// Index of the environment in its batch.
    pub environment: u32,
    /// The whole configuration as TOML.
    pub config_toml: String,
    /// Planned length in microseconds; decides whether `t` is u32 or i64. `None`: unknown, so i64.
    /// Not stored: a recording that was read has `None`.
    pub duration_us: Option<i64>,
    /// Absolute time of the stream's start, in microseconds.
    pub t_offset_us: i64,
    /// The label kinds that will be written, for every camera.
    pub labels: Vec<LabelKind>,
}

impl RecordingHeader {
    /// Of these cameras, with nothing else known: no seed, method, configuration, length or labels.
    pub const fn of(cameras: Vec<CameraInfo>) -> Self {
        Self {
            cameras,
            seed: 0,
            method: String::new(),
            environment: 0,
            config_toml: String::new(),
            duration_us: None,
            t_offset_us: 0,
            labels: Vec::new(),
        }
    }

    /// What a file keeps to know its scalars and texts by: FNV-1a over all of them, numbers as their bytes.
    fn hash(&self) -> u64 {
        let mut fnv = Fnv::default();
        let mut text = |text: &str| write_text(&mut fnv, text);
        text(&self.method);
        text(&self.config_toml);
        for camera in &self.cameras {
            text(&camera.name);
        }
        for camera in &self.cameras {
            fnv.write(&[camera.width, camera.height].map(u32::to_le_bytes).concat());
            fnv.write(&[camera.fx, camera.fy, camera.cx, camera.cy].map(f64::to_le_bytes).concat());
            if let Some(distortion) = &camera.distortion {
                fnv.write(distortion.model.as_bytes());
                let bytes: Vec<u8> = distortion.coefficients.iter().flat_map(|c| c.to_le_bytes()).collect();
                fnv.write(&bytes);
            }
        }
        fnv.write(&self.seed.to_le_bytes());
        fnv.write(&self.environment.to_le_bytes());
        fnv.write(&self.t_offset_us.to_le_bytes());
        fnv.finish()
    }
}

/// Adds a text to a hash, its length first.
fn write_text(fnv: &mut Fnv, text: &str) {
    fnv.write(&(text.len() as u64).to_le_bytes());
    fnv.write(text.as_bytes());
}

/// A hash as attributes have it.
fn hash_text(hash: u64) -> String {
    format!("{hash:016x}")
}

/// Whether a group of a file can have this name.
fn is_group_name(name: &str) -> bool {
    !name.is_empty() && !matches!(name, "." | "..") && !name.contains(['/', '\0']) && name.len() <= 255
}

/// Values of a host that are stored as they are given, so many at a time.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StateInfo {
    /// Its name.
    pub name: String,
    /// Names of its values; at least one.
    pub values: Vec<String>,
}

impl StateInfo {
    /// What a file keeps to know the names of its values by: FNV-1a.
    fn hash(values: &[String]) -> u64 {
        let mut fnv = Fnv::default();
        values.iter().for_each(|name| write_text(&mut fnv, name));
        fnv.finish()
    }
}

/// What a host said of its own state.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StateSamples {
    /// What each value of a row is.
    pub names: Vec<String>,
    /// Microseconds since the stream's start, one per row.
    pub t_us: Vec<i64>,
    /// Row by row.
    pub values: Vec<f64>,
}

/// An object or a camera that a recording names and follows.
#[derive(Clone, Debug, PartialEq)]
pub struct BodyInfo {
    /// Name in the scene; need not be unique.
    pub name: String,
    /// Id in images of instances; 0 for cameras.
    pub instance_id: u32,
    /// Id in images of semantic classes; 0 where it has none.
    pub semantic_id: u32,
    /// Name of that class; empty where it has none.
    pub semantic_name: String,
    /// Lowest and highest corner, in metres in the body's axes, of what is drawn; NaN for cameras.
    pub bounds: [[f64; 3]; 2],
}

impl BodyInfo {
    /// The objects among `bodies` by instance id: each id once, with the name of the first that has it.
    pub fn instances(bodies: &[Self]) -> Vec<(u32, &str)> {
        named(bodies.iter().map(|body| (body.instance_id, body.name.as_str())))
    }

    /// The semantic classes of `bodies` that have a name, by id.
    pub fn classes(bodies: &[Self]) -> Vec<(u32, &str)> {
        let classes = bodies.iter().map(|body| (body.semantic_id, body.semantic_name.as_str()));
        named(classes.filter(|(_, name)| !name.is_empty()))
    }

    /// What a file keeps to know its list of bodies by: FNV-1a over all that is stored of them, numbers as their bytes.
    fn hash(bodies: &[Self]) -> u64 {
        let mut fnv = Fnv::default();
        let classes_are_stored = !Self::classes(bodies).is_empty();
        for body in bodies {
            let class = if classes_are_stored { body.semantic_name.as_str() } else { "" };
            write_text(&mut fnv, &body.name);
            write_text(&mut fnv, class);
            fnv.write(&[body.instance_id, body.semantic_id].map(u32::to_le_bytes).concat());
            fnv.write(&body.bounds.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>());
        }
        fnv.finish()
    }
}

/// Ids in order, each once with its first name; 0 labels nothing.
fn named<'a>(names: impl Iterator<Item = (u32, &'a str)>) -> Vec<(u32, &'a str)> {
    let mut named: Vec<_> = names.filter(|(id, _)| *id > 0).collect();
    named.sort_by_key(|(id, _)| *id);
    named.dedup_by_key(|(id, _)| *id);
    named
}

/// Where a body is at one time, and how it moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodySample {
    /// World from body, metres.
    pub position: [f64; 3],
    /// World from body, unit quaternion (x, y, z, w).
    pub rotation: [f64; 4],
    /// m/s of the body's origin, in world axes.
    pub linear_velocity: [f64; 3],
    /// rad/s in world axes.
    pub angular_velocity: [f64; 3],
}

/// The bodies of a recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bodies {
    /// One for each.
    pub infos: Vec<BodyInfo>,
    /// When they were sampled, in microseconds.
    pub t_us: Vec<i64>,
    /// For each time, one for each body.
    pub samples: Vec<Vec<BodySample>>,
}

/// Element type of a label data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LabelType {
    F32,
    U32,
    U8,
}

impl LabelType {
    const fn of(kind: LabelKind) -> Self {
        match kind {
            LabelKind::Depth
            | LabelKind::FlowForward
            | LabelKind::FlowBackward
            | LabelKind::Normal
            | LabelKind::Hdr
            | LabelKind::Frame => Self::F32,
            LabelKind::Instance | LabelKind::Semantic => Self::U32,
            LabelKind::FlowForwardValid | LabelKind::FlowBackwardValid | LabelKind::Cause => Self::U8,
        }
    }

    /// As `NumPy` calls it.
    const fn name(self) -> &'static str {
        match self {
            Self::F32 => "float32",
            Self::U32 => "uint32",
            Self::U8 => "uint8",
        }
    }

    fn matches(self, data: &LabelData) -> bool {
        matches!(
            (self, data),
            (Self::F32, LabelData::F32(_)) | (Self::U32, LabelData::U32(_)) | (Self::U8, LabelData::U8(_))
        )
    }
}

/// Whether a label has a second time: the other end of a flow's interval, the start of an exposure.
const fn has_other_time(kind: LabelKind) -> bool {
    matches!(
        kind,
        LabelKind::FlowForward
            | LabelKind::FlowForwardValid
            | LabelKind::FlowBackward
            | LabelKind::FlowBackwardValid
            | LabelKind::Frame
    )
}
