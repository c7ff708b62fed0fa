//! The folder layout of DSEC: events per camera, rectification maps, flow and disparity as 16-bit PNG, and
//! calibration.
//!
//! ```text
//! events/<left|right>/events.h5            /events/{x, y, t, p}, /ms_to_idx, /t_offset
//! events/<left|right>/rectify_map.h5       /rectify_map (H, W, 2) f32: the rectified x, y of each pixel
//! flow/forward/NNNNNN.png                  x · 128 + 2^15, y · 128 + 2^15, validity; of the left camera
//! flow/forward_timestamps.txt              from, to in microseconds
//! disparity/event/NNNNNN.png               disparity · 256, 0 where unknown; of the left camera
//! disparity/timestamps.txt                 microseconds
//! calibration/cam_to_cam.yaml
//! ```
//! Sources: <https://dsec.ifi.uzh.ch/data-format/> and the loaders in `uzh-rpg/DSEC`.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use evis_core::format::FormatError;
use evis_core::format::hdf5::{Recording, RecordingHeader, RecordingWriter};
use evis_core::{CameraInfo, Event, LabelData, LabelKind, PoseSample};
use rust_hdf5::{H5File, Hdf5Error};

use crate::files::draft_path;
use crate::hdf5::{Hdf5Reader, Hdf5Writer};
use crate::packet::Packet;
use crate::read::{EventReader, ReadOptions, StreamInfo};
use crate::work::{Halt, Work, unless_stopped};
use crate::write::{EventWriter, WriteOptions};

/// Microseconds of events that are copied at once.
const US_AT_ONCE: i64 = 20_000;
/// Events whose writing takes about as long as that of an image, for progress.
const EVENTS_PER_IMAGE: u64 = 200_000;
/// Largest angle between the cameras of a rectified pair, radians: a tenth of a pixel at f = 1000.
const PARALLEL: f64 = 1.0e-4;

/// The names that the cameras have in DSEC.
const EYES: [&str; 2] = ["left", "right"];

/// Cameras of a folder of this layout, with their files; none for any other folder.
pub(crate) fn cameras(folder: &Path) -> Vec<(String, PathBuf)> {
    let file = |eye: &str| folder.join("events").join(eye).join("events.h5");
    EYES.iter().map(|eye| ((*eye).to_owned(), file(eye))).filter(|(_, file)| file.is_file()).collect()
}

/// Reads the events of one camera of a folder.
pub(crate) struct DsecReader(Hdf5Reader, StreamInfo);

impl DsecReader {
    pub(crate) fn open(folder: &Path, options: &ReadOptions) -> Result<Self, FormatError> {
        let cameras = cameras(folder);
        let names: Vec<String> = cameras.iter().map(|(name, _)| name.clone()).collect();
        let chosen = match &options.camera {
            Some(camera) => cameras.iter().find(|(name, _)| name == camera),
            None if cameras.len() > 1 => None,
            None => cameras.first(),
        };
        let Some((camera, file)) = chosen else {
            let what = match (&options.camera, names.as_slice()) {
                (_, []) => {
                    "it is a folder without events/left/events.h5 or events/right/events.h5".to_owned()
                }
                (Some(camera), _) => format!("there is no camera {camera}"),
                (None, _) => format!("there are {} cameras", names.len()),
            };
            let remedy = if names.is_empty() {
                "give a file, or a folder of DSEC's layout".to_owned()
            } else {
                format!("choose one of {}", names.join(", "))
            };
            return Err(FormatError::invalid(folder, what, remedy));
        };
        let map = H5File::options().no_locking().open(file.with_file_name("rectify_map.h5"));
        let shape = map.and_then(|map| Ok(map.dataset("rectify_map")?.shape())).unwrap_or_default();
        let of_map = match shape.as_slice() {
            &[height, width, 2] => u32::try_from(width).ok().zip(u32::try_from(height).ok()),
            _ => None,
        };
        // The camera's file has one camera, whatever it is called there.
        let options = ReadOptions { camera: None, size: of_map.or(options.size) };
        let reader = Hdf5Reader::open(file, &options)?;
        let mut info = reader.info().clone();
        info.format = crate::format::Format::Dsec;
        info.cameras = names;
        info.camera = Some(camera.clone());
        Ok(Self(reader, info))
    }
}

impl EventReader for DsecReader {
    fn info(&self) -> &StreamInfo {
        &self.1
    }

    fn read_packet(&mut self, packet: &mut Packet) -> Result<bool, FormatError> {
        self.0.read_packet(packet)
    }

    fn part(&self) -> Option<f64> {
        self.0.part()
    }

    fn seek(&mut self, t_us: i64) -> Result<(), FormatError> {
        self.0.seek(t_us)
    }
}

/// Writes events alone, as those of a folder's left camera.
pub(crate) struct DsecWriter(Hdf5Writer);

impl DsecWriter {
    pub(crate) fn create(folder: &Path, options: &WriteOptions) -> Result<Self, FormatError> {
        let own = new_folder(folder, EYES[0], options.overwrite)?;
        Ok(Self(Hdf5Writer::create(&own.join("events.h5"), &WriteOptions { overwrite: true, ..*options })?))
    }
}

impl EventWriter for DsecWriter {
    fn write(&mut self, packet: &Packet) -> Result<(), FormatError> {
        self.0.write(packet)
    }

    fn write_events(&mut self, events: &[Event]) -> Result<(), FormatError> {
        self.0.write_events(events)
    }

    fn finish(self: Box<Self>) -> Result<(), FormatError> {
        Box::new(self.0).finish()
    }
}

/// What [`export_dsec`] wrote.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DsecExport {
    /// Names in the recording and in the folder.
    pub cameras: Vec<(String, &'static str)>,
    /// Events of all cameras.
    pub events: u64,
    /// Flow images.
    pub flows: usize,
    /// Disparity images.
    pub disparities: usize,
    /// Why something is missing, if it is.
    pub notes: Vec<String>,
}

/// Writes a recording of EVIS as a folder in DSEC's layout. The first camera, or the one named
/// `left`, is the left one; a second one is the right one. `proceed` is called now and then with the part that is done, 0 to 1;
/// where it says no, `folder` is what it was before, and `None` is returned.
///
/// # Errors
/// A damaged recording, more than two cameras, a folder that exists (unless `overwrite`), and a disk that refuses.
pub fn export_dsec(
    recording: &Recording,
    folder: &Path,
    overwrite: bool,
    mut proceed: impl FnMut(f64) -> bool,
) -> Result<Option<DsecExport>, FormatError> {
    if folder.exists() && !overwrite {
        return Err(FormatError::Exists { path: folder.into() });
    }
    let draft = Draft::new(folder)?;
    let Some(export) = unless_stopped(export(recording, &draft.0, &mut proceed))? else { return Ok(None) };
    draft.finish(folder)?;
    Ok(Some(export))
}

/// A folder under another name, whose content takes its own when it is complete.
struct Draft(PathBuf);

impl Draft {
    fn new(folder: &Path) -> Result<Self, FormatError> {
        let draft = draft_path(folder, "draft");
        // What a run left that was killed.
        if draft.exists() {
            fs::remove_dir_all(&draft).map_err(|error| FormatError::io(&draft, "write", error))?;
        }
        make_folder(&draft)?;
        Ok(Self(draft))
    }

    /// Gives the folder its name, or moves its files over those of an old one.
    fn finish(self, folder: &Path) -> Result<(), FormatError> {
        fn moved(from: &Path, to: &Path) -> std::io::Result<()> {
            if !to.is_dir() {
                return fs::rename(from, to);
            }
            for entry in fs::read_dir(from)? {
                let entry = entry?;
                let to = to.join(entry.file_name());
                if entry.file_type()?.is_dir() {
                    moved(&entry.path(), &to)?
                } else {
                    fs::rename(entry.path(), to)?
                }
            }
            Ok(())
        }
        moved(&self.0, folder).map_err(|error| FormatError::io(folder, "write", error))
    }
}

impl Drop for Draft {
    fn drop(&mut self) {
        // Gone, where it has taken its name.
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn export(
    recording: &Recording,
    folder: &Path,
    proceed: &mut dyn FnMut(f64) -> bool,
) -> Result<DsecExport, Halt> {
    let cameras = &recording.header().cameras;
    let order: Vec<usize> = match cameras.as_slice() {
        [_] => vec![0],
        [a, b] if a.name == EYES[1] || b.name == EYES[0] => vec![1, 0],
        [_, _] => vec![0, 1],
        _ => {
            let what = format!("it has {} cameras", cameras.len());
            let remedy = "DSEC has a left and a right one: record those";
            return Err(FormatError::invalid(recording.path(), what, remedy).into());
        }
    };
    let left = order.first().copied().unwrap_or_default();
    let mut parts = 0;
    for &camera in &order {
        parts += recording.event_count(camera)?;
    }
    let pair = order.get(1).map(|&right| Pair::of(recording, left, right)).transpose()?.flatten();
    let rectified = pair.as_ref().is_some_and(Pair::is_rectified);
    for (kind, wanted) in [(LabelKind::FlowForward, true), (LabelKind::Depth, rectified)] {
        if wanted && recording.label_kinds(left)?.contains(&kind) {
            parts += recording.label_times(left, kind)?.len() as u64 * EVENTS_PER_IMAGE;
        }
    }
    let mut work = Work::new(parts, proceed);
    let mut export = DsecExport::default();
    for (&camera, eye) in order.iter().zip(EYES) {
        let Some(info) = cameras.get(camera) else { continue };
        let own = new_folder(folder, eye, true)?;
        export.events += write_events(recording, camera, info, &own.join("events.h5"), &mut work)?;
        if info.distortion.is_none() {
            write_map(&own.join("rectify_map.h5"), info)?;
        } else {
            export.notes.push(format!(
                "no rectify_map.h5 of {0}, and no rectified cameras in cam_to_cam.yaml: the lens of {0} is distorted",
                info.name
            ));
        }
        export.cameras.push((info.name.clone(), eye));
    }
    export.flows = write_flow(recording, left, folder, &mut work)?;
    let has_depth = recording.label_kinds(left)?.contains(&LabelKind::Depth);
    match (&pair, order.len(), has_depth) {
        (Some(pair), _, true) if rectified => {
            export.disparities = write_disparity(recording, left, pair, folder, &mut work)?;
        }
        (_, _, false) => export.notes.push("no disparity: the recording has no depth".into()),
        (_, 1, _) => export.notes.push("no disparity: the recording has one camera".into()),
        (None, ..) => export.notes.push("no disparity: the recording has no poses".into()),
        _ => export.notes.push("no disparity: the cameras are not a rectified pair".into()),
    }
    let calibration = folder.join("calibration");
    make_folder(&calibration)?;
    let infos: Vec<&CameraInfo> = order.iter().filter_map(|&camera| cameras.get(camera)).collect();
    write_file(&calibration.join("cam_to_cam.yaml"), calibration_yaml(&infos, pair.as_ref()).as_bytes())?;
    Ok(export)
}

/// Makes the folder of a camera's events.
fn new_folder(folder: &Path, eye: &str, overwrite: bool) -> Result<PathBuf, FormatError> {
    if folder.exists() && !overwrite {
        return Err(FormatError::Exists { path: folder.into() });
    }
    let own = folder.join("events").join(eye);
    make_folder(&own)?;
    Ok(own)
}

fn make_folder(path: &Path) -> Result<(), FormatError> {
    fs::create_dir_all(path).map_err(|error| FormatError::io(path, "create", error))
}

fn write_file(path: &Path, bytes: &[u8]) -> Result<(), FormatError> {
    fs::write(path, bytes).map_err(|error| FormatError::io(path, "write", error))
}

/// A recording of one camera is a file of DSEC's: its columns lie at the root too.
fn write_events(
    recording: &Recording,
    camera: usize,
    info: &CameraInfo,
    path: &Path,
    work: &mut Work,
) -> Result<u64, Halt> {
    let count = recording.event_count(camera)?;
    let header = RecordingHeader {
        cameras: vec![info.clone()],
        labels: Vec::new(),
        // Times of 32 bits, as DSEC has them, where they fit.
        duration_us: recording
            .events_between(camera, 0xFFFF_F000, i64::MAX)?
            .is_empty()
            .then_some(0xFFFF_F000),
        ..recording.header().clone()
    };
    let mut writer = RecordingWriter::create(path, &header, true)?;
    let (mut written, mut start_us) = (0, 0);
    while written < count {
        let end_us = start_us + US_AT_ONCE;
        let events = recording.events_between(camera, start_us, end_us)?;
        writer.write_events(0, &events)?;
        written += events.len() as u64;
        work.advance(events.len() as u64)?;
        start_us = end_us;
        if start_us > 31 * 86_400 * 1_000_000 {
            break;
        }
    }
    writer.finish("{}")?;
    Ok(written)
}

/// Of a pinhole: every pixel lies where it is.
fn write_map(path: &Path, info: &CameraInfo) -> Result<(), FormatError> {
    let (width, height) = (info.width as usize, info.height as usize);
    let map: Vec<f32> =
        (0..height).flat_map(|y| (0..width).flat_map(move |x| [x as f32, y as f32])).collect();
    let write = || -> Result<(), Hdf5Error> {
        let file = H5File::create(path)?;
        file.new_dataset::<f32>().shape([height, width, 2]).create("rectify_map")?.write_raw(&map)?;
        file.close()
    };
    write().map_err(|error| FormatError::io(path, "write", std::io::Error::other(error.to_string())))
}

fn encode_png(
    path: &Path,
    size: (u32, u32),
    color: png::ColorType,
    values: &[u16],
) -> Result<(), FormatError> {
    let encode = || -> Result<Vec<u8>, png::EncodingError> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, size.0, size.1);
        encoder.set_color(color);
        encoder.set_depth(png::BitDepth::Sixteen);
        let mut writer = encoder.write_header()?;
        let data: Vec<u8> = values.iter().flat_map(|value| value.to_be_bytes()).collect();
        writer.write_image_data(&data)?;
        writer.finish()?;
        Ok(bytes)
    };
    let bytes = encode().map_err(|error| FormatError::io(path, "write", std::io::Error::other(error)))?;
    write_file(path, &bytes)
}

/// A component of flow: 128 steps per pixel around 2^15; `None` where it does not fit.
fn flow_value(pixels: f32) -> Option<u16> {
    let value = (f64::from(pixels) * 128.0 + 32_768.0).round();
    (pixels.is_finite() && (0.0..=65_535.0).contains(&value)).then_some(value as u16)
}

fn write_flow(recording: &Recording, camera: usize, folder: &Path, work: &mut Work) -> Result<usize, Halt> {
    let kinds = recording.label_kinds(camera)?;
    if !kinds.contains(&LabelKind::FlowForward) {
        return Ok(0);
    }
    let own = folder.join("flow").join("forward");
    make_folder(&own)?;
    let has_mask = kinds.contains(&LabelKind::FlowForwardValid);
    let Some(info) = recording.header().cameras.get(camera) else { return Ok(0) };
    let mut times = String::from("# from_timestamp_us, to_timestamp_us\n");
    let mut written = 0;
    for index in 0..recording.label_times(camera, LabelKind::FlowForward)?.len() {
        work.advance(EVENTS_PER_IMAGE)?;
        let frame = recording.label(camera, LabelKind::FlowForward, index)?;
        // The last image of a stream has no flow: nothing comes after it.
        let LabelData::F32(flow) = &frame.data else { continue };
        if frame.t_other_us <= frame.t_us {
            continue;
        }
        let mask = if has_mask {
            Some(recording.label(camera, LabelKind::FlowForwardValid, index)?.data)
        } else {
            None
        };
        let valid = |pixel: usize| match &mask {
            Some(LabelData::U8(mask)) => mask.get(pixel).is_some_and(|valid| *valid != 0),
            _ => true,
        };
        let mut values = Vec::with_capacity(flow.len() / 2 * 3);
        for (pixel, [x, y]) in flow.as_chunks().0.iter().enumerate() {
            match (valid(pixel), flow_value(*x), flow_value(*y)) {
                (true, Some(x), Some(y)) => values.extend([x, y, 1]),
                _ => values.extend([0, 0, 0]),
            }
        }
        encode_png(
            &own.join(format!("{written:06}.png")),
            (info.width, info.height),
            png::ColorType::Rgb,
            &values,
        )?;
        let _ = writeln!(times, "{}, {}", frame.t_us, frame.t_other_us);
        written += 1;
    }
    write_file(&folder.join("flow").join("forward_timestamps.txt"), times.as_bytes())?;
    Ok(written)
}

/// The left camera's view of the right one.
struct Pair {
    /// Position of the right camera in the left one's axes: x right, y down, z forward, metres.
    position: [f64; 3],
    /// Rotation to the left camera's axes from the right one's, the same axes.
    rotation: [[f64; 3]; 3],
    left: CameraInfo,
    right: CameraInfo,
}

/// The matrix of a unit quaternion (x, y, z, w).
fn matrix([x, y, z, w]: [f64; 4]) -> [[f64; 3]; 3] {
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

fn transposed_times(a: [[f64; 3]; 3], b: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| (0..3).map(|k| a[k][i] * b[k][j]).sum()))
}

/// glTF's camera axes have y up and z back.
const SIGN: [f64; 3] = [1.0, -1.0, -1.0];

impl Pair {
    fn of(recording: &Recording, left: usize, right: usize) -> Result<Option<Self>, FormatError> {
        let (left_poses, right_poses) = (recording.poses(left)?, recording.poses(right)?);
        let cameras = &recording.header().cameras;
        let (Some(a), Some(b), Some(left), Some(right)) =
            (left_poses.first(), right_poses.first(), cameras.get(left), cameras.get(right))
        else {
            return Ok(None);
        };
        let (position, rotation) = relative(a, b);
        Ok(Some(Self { position, rotation, left: left.clone(), right: right.clone() }))
    }

    fn baseline(&self) -> f64 {
        self.position[0]
    }

    /// Parallel, side by side, with equal lenses.
    fn is_rectified(&self) -> bool {
        let Self { left: a, right: b, .. } = self;
        let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let angles = self.rotation.iter().flatten().zip(identity.iter().flatten());
        let aside = self.position[1].abs().max(self.position[2].abs());
        angles.into_iter().all(|(is, should)| (is - should).abs() < PARALLEL)
            && self.baseline() > 0.0
            && aside < 1.0e-3 * self.baseline()
            && (a.fx, a.fy, a.cx, a.cy) == (b.fx, b.fy, b.cx, b.cy)
            && a.distortion.is_none()
            && b.distortion.is_none()
    }
}

fn relative(left: &PoseSample, right: &PoseSample) -> ([f64; 3], [[f64; 3]; 3]) {
    let (a, b) = (matrix(left.rotation), matrix(right.rotation));
    let apart = [0, 1, 2].map(|k| right.position[k] - left.position[k]);
    let position = [0, 1, 2].map(|i| SIGN[i] * (0..3).map(|k| a[k][i] * apart[k]).sum::<f64>());
    let rotation = transposed_times(a, b);
    (position, [0, 1, 2].map(|i| [0, 1, 2].map(|j| SIGN[i] * rotation[i][j] * SIGN[j])))
}

/// Disparity of a depth: 256 steps per pixel, 0 where it is unknown or does not fit.
fn disparity_value(depth: f32, fx_baseline: f64) -> u16 {
    let value = (fx_baseline / f64::from(depth) * 256.0).round();
    if depth > 0.0 && (1.0..=65_535.0).contains(&value) { value as u16 } else { 0 }
}

fn write_disparity(
    recording: &Recording,
    camera: usize,
    pair: &Pair,
    folder: &Path,
    work: &mut Work,
) -> Result<usize, Halt> {
    let own = folder.join("disparity").join("event");
    make_folder(&own)?;
    let times = recording.label_times(camera, LabelKind::Depth)?;
    for index in 0..times.len() {
        work.advance(EVENTS_PER_IMAGE)?;
        let frame = recording.label(camera, LabelKind::Depth, index)?;
        let LabelData::F32(depth) = &frame.data else { continue };
        let scale = pair.left.fx * pair.baseline();
        let values: Vec<u16> = depth.iter().map(|depth| disparity_value(*depth, scale)).collect();
        let size = (pair.left.width, pair.left.height);
        encode_png(&own.join(format!("{index:06}.png")), size, png::ColorType::Grayscale, &values)?;
    }
    let text: String = times.iter().map(|t| format!("{t}\n")).collect();
    write_file(&folder.join("disparity").join("timestamps.txt"), text.as_bytes())?;
    Ok(times.len())
}

/// DSEC's calibration: cameras 0 and 3 see events, left and right; 1 and 2 are the frame cameras beside
/// them, which here are the same. Rectified cameras are there where they are these: nothing is rectified here.
fn calibration_yaml(cameras: &[&CameraInfo], pair: Option<&Pair>) -> String {
    let mut text = String::from("intrinsics:\n");
    let right = cameras.get(1).or(cameras.first());
    let numbered = [("cam0", cameras.first()), ("cam1", cameras.first()), ("cam2", right), ("cam3", right)];
    let rectified = numbered.map(|(name, camera)| (name.replace("cam", "camRect"), camera));
    let plain = numbered.map(|(name, camera)| (name.to_owned(), camera));
    let is_rectified = cameras.iter().all(|c| c.distortion.is_none()) && pair.is_none_or(Pair::is_rectified);
    for (name, camera) in plain.into_iter().chain(rectified.into_iter().filter(|_| is_rectified)) {
        let Some(c) = camera else { continue };
        // Pixel centres lie at whole numbers there.
        let (cx, cy) = (c.cx - 0.5, c.cy - 0.5);
        let (model, coefficients) = match &c.distortion {
            Some(of) => (
                if of.model == "fisheye" { "equidistant" } else { of.model.as_str() },
                of.coefficients.clone(),
            ),
            None => ("radtan", vec![0.0; 4]),
        };
        let _ = writeln!(
            text,
            "  {name}:\n    camera_model: pinhole\n    camera_matrix: [{:?}, {:?}, {cx:?}, {cy:?}]\n    \
             distortion_coeffs: {coefficients:?}\n    distortion_model: {model}\n    resolution: [{}, {}]",
            c.fx, c.fy, c.width, c.height
        );
    }
    let rows = |rows: Vec<Vec<f64>>| rows.iter().map(|row| format!("    - {row:?}\n")).collect::<String>();
    let identity = |n: usize| {
        (0..n).map(|i| (0..n).map(|j| f64::from(u8::from(i == j))).collect()).collect::<Vec<Vec<f64>>>()
    };
    text += "extrinsics:\n";
    // T_21 takes points from camera 1's axes to camera 2's.
    let t_21 = pair.map_or_else(
        || identity(4),
        |pair| {
            let mut rows: Vec<Vec<f64>> = (0..3)
                .map(|i| {
                    let mut row: Vec<f64> = (0..3).map(|k| pair.rotation[k][i]).collect();
                    row.push(-(0..3).map(|k| pair.rotation[k][i] * pair.position[k]).sum::<f64>());
                    row
                })
                .collect();
            rows.push(vec![0.0, 0.0, 0.0, 1.0]);
            rows
        },
    );
    for (name, matrix) in [("T_10", identity(4)), ("T_21", t_21), ("T_32", identity(4))] {
        let _ = write!(text, "  {name}:\n{}", rows(matrix));
    }
    for camera in (0..4).filter(|_| is_rectified) {
        let _ = write!(text, "  R_rect{camera}:\n{}", rows(identity(3)));
    }
    if let Some(pair) = pair.filter(|pair| pair.is_rectified()) {
        let c = &pair.left;
        let q = vec![
            vec![1.0, 0.0, 0.0, -(c.cx - 0.5)],
            vec![0.0, 1.0, 0.0, -(c.cy - 0.5)],
            vec![0.0, 0.0, 0.0, c.fx],
            vec![0.0, 0.0, 1.0 / pair.baseline(), 0.0],
        ];
        let _ = write!(text, "disparity_to_depth:\n  cams_03:\n{}", rows(q.clone()));
        let _ = write!(text, "  cams_12:\n{}", rows(q));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_those_of_dsec() {
        assert_eq!(
            [0.0, 1.0, -1.5, 255.99, 256.0, f32::NAN].map(flow_value),
            [Some(32_768), Some(32_896), Some(32_576), Some(65_535), None, None]
        );
        assert_eq!(disparity_value(2.0, 20.0), 2560);
        assert_eq!([f32::INFINITY, 0.0, -1.0, 1e-9].map(|depth| disparity_value(depth, 20.0)), [0; 4]);
    }

    #[test]
    fn calibrations_have_the_distortion_of_their_cameras() {
        let distortion =
            evis_core::LensDistortion { model: "fisheye".into(), coefficients: vec![0.1, 0.2, 0.0, 0.0] };
        let plain = CameraInfo {
            name: "left".into(),
            width: 4,
            height: 3,
            fx: 5.0,
            fy: 5.0,
            cx: 2.0,
            cy: 1.5,
            distortion: None,
        };
        let bent = CameraInfo { distortion: Some(distortion), ..plain.clone() };
        let lines = |camera: &CameraInfo, line: &str| {
            calibration_yaml(&[camera], None).lines().filter(|l| l.trim() == line).count()
        };
        let own = ["distortion_model: equidistant", "distortion_coeffs: [0.1, 0.2, 0.0, 0.0]"];
        assert_eq!(own.map(|line| lines(&bent, line)), [4, 4]);
        let rectified = |camera: &CameraInfo| {
            let text = calibration_yaml(&[camera], None);
            [text.matches("camRect").count(), text.matches("R_rect").count()]
        };
        assert_eq!(rectified(&bent), [0, 0], "nobody has rectified its pictures");
        assert_eq!(rectified(&plain), [4, 4]);
        assert_eq!(own.map(|line| lines(&plain, line)), [0, 0], "canary");
        assert_eq!(lines(&plain, "distortion_coeffs: [0.0, 0.0, 0.0, 0.0]"), 8);
    }

    #[test]
    fn the_right_camera_lies_to_the_right() {
        // Both turned by 90 degrees about y: the left camera's right is the world's -z.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let pose = |z| PoseSample { t_us: 0, position: [1.0, 2.0, z], rotation: [0.0, half, 0.0, half] };
        let (position, rotation) = relative(&pose(3.0), &pose(2.5));
        assert!((position[0] - 0.5).abs() < 1e-12 && position[1].abs() + position[2].abs() < 1e-12);
        assert!((0..3).all(|k| (rotation[k][k] - 1.0).abs() < 1e-12));
    }
}
