//! The folder layout of DSEC: events per camera, rectification maps, flow and disparity as 16-bit PNG, and
//! calibration.
//!
//! ```text
//! events/<left|right>/events.h5            /events/{x, y, t, p}, /ms_to_idx, /t_offset
//! events/<left|right>/rectify_map.h5       /rectify_map (H, W, 2) f32: the rectified x, y of each pixel
//! flow/forward/NNNNNN.png                  x · 128 + 2^15, y · 128 + 2^15, validity; of the rectified left camera
//! flow/forward_timestamps.txt              from, to in microseconds
//! disparity/event/NNNNNN.png               disparity · 256, 0 where unknown; of the rectified left camera
//! disparity/timestamps.txt                 microseconds
//! calibration/cam_to_cam.yaml
//! ```
//! Events are those of the sensor's own pixels. Pixel centres lie at whole numbers.
//!
//! Sources: <https://dsec.ifi.uzh.ch/data-format/> and the loaders in `uzh-rpg/DSEC`.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use evis_core::format::FormatError;
use evis_core::format::hdf5::{Recording, RecordingHeader, RecordingWriter};
use evis_core::{CameraInfo, Event, LabelData, LabelKind, PoseSample};
use evis_scene::{DsecRectification, RectifiedCamera, Rig, RigCamera};
use glam::{DMat4, DQuat, DVec2, DVec3};
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
/// Largest entry by which a pair's relative pose may differ from its first one, in metres and as a rotation: cameras of one rig
/// differ by rounding.
const FIXED: f64 = 1.0e-6;
/// What a map has where the lens sees nothing: outside of the picture, for every reader.
const NOWHERE: [f32; 2] = [-1.0; 2];

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
    let infos: Vec<&CameraInfo> = order.iter().filter_map(|&camera| cameras.get(camera)).collect();
    let mut export = DsecExport::default();
    let calibration = calibrate(recording, &order, &infos, &mut export.notes)?;
    let stereo = calibration.as_ref().and_then(|of| Some((of.left(), of.rectification.baselines?[0])));
    for (kind, wanted) in [(LabelKind::FlowForward, true), (LabelKind::Depth, stereo.is_some())] {
        if wanted && recording.label_kinds(left)?.contains(&kind) {
            parts += recording.label_times(left, kind)?.len() as u64 * EVENTS_PER_IMAGE;
        }
    }
    let mut work = Work::new(parts, proceed);
    for (number, (&camera, eye)) in order.iter().zip(EYES).enumerate() {
        let Some(info) = cameras.get(camera) else { continue };
        let own = new_folder(folder, eye, true)?;
        export.events += write_events(recording, camera, info, &own.join("events.h5"), &mut work)?;
        if let Some(calibration) = &calibration {
            let rectified = if number == 0 { calibration.left() } else { calibration.right() };
            write_map(&own.join("rectify_map.h5"), rectified)?;
        }
        export.cameras.push((info.name.clone(), eye));
    }
    let sources = calibration.as_ref().map(|of| Sources::new(of.left()));
    export.flows = write_flow(recording, left, sources.as_ref(), folder, &mut work)?;
    let has_depth = recording.label_kinds(left)?.contains(&LabelKind::Depth);
    match (stereo, &sources, has_depth) {
        (Some((camera, baseline)), Some(sources), true) => {
            let scale = camera.pinhole.focal[0] * baseline;
            export.disparities = write_disparity(recording, left, sources, scale, folder, &mut work)?;
        }
        (.., false) => export.notes.push("no disparity: the recording has no depth".into()),
        _ if order.len() == 1 => export.notes.push("no disparity: the recording has one camera".into()),
        // Why there is no pair was said.
        _ => export.notes.push("no disparity: there is no rectified pair".into()),
    }
    if let Some(of) = &calibration {
        let folder = folder.join("calibration");
        make_folder(&folder)?;
        let text = of.rig.dsec_text(Some(&of.rectification));
        let text = text.map_err(|error| {
            FormatError::invalid(recording.path(), error.to_string(), "record one camera, or two")
        })?;
        write_file(&folder.join("cam_to_cam.yaml"), text.as_bytes())?;
    }
    Ok(export)
}

/// The cameras, and how they are rectified.
struct Calibration {
    rig: Rig,
    rectification: DsecRectification,
}

impl Calibration {
    const fn left(&self) -> &RectifiedCamera {
        &self.rectification.cameras[0]
    }

    const fn right(&self) -> &RectifiedCamera {
        &self.rectification.cameras[3]
    }
}

/// The calibration of the left and the right camera, or of one; `notes` says why something of it is missing.
fn calibrate(
    recording: &Recording,
    order: &[usize],
    infos: &[&CameraInfo],
    notes: &mut Vec<String>,
) -> Result<Option<Calibration>, FormatError> {
    let apart = match order {
        [left, right] => relative_pose(recording, *left, *right)?,
        _ => Ok(DMat4::IDENTITY),
    };
    let left_from_right = *apart.as_ref().unwrap_or(&DMat4::IDENTITY);
    let rig = Rig {
        cameras: infos
            .iter()
            .zip([DMat4::IDENTITY, left_from_right])
            .map(|(info, pose)| rig_camera(info, pose))
            .collect(),
    };
    let no_pair =
        |reason: &str| format!("the cameras are no rectified pair, each is undistorted by itself: {reason}");
    let pair = match apart {
        Ok(_) => rig.check().and_then(|()| rig.dsec_rectification()).map_err(|error| error.to_string()),
        Err(reason) => Err(reason.to_owned()),
    };
    let rectification = match (pair, infos.len()) {
        (Ok(pair), _) => Ok(pair),
        (Err(reason), 2) => {
            let alone = [0, 0, 1, 1].map(|index| rig.rectify_alone(index));
            let [a, b, c, d] = alone;
            let cameras = (|| Ok::<_, evis_scene::SceneError>([a?, b?, c?, d?]))();
            if cameras.is_ok() {
                notes.push(no_pair(&reason));
            }
            cameras.map(|cameras| DsecRectification { cameras, baselines: None }).map_err(|e| e.to_string())
        }
        (Err(reason), _) => Err(reason),
    };
    Ok(match rectification {
        Ok(rectification) => Some(Calibration { rig, rectification }),
        Err(reason) => {
            notes.push(format!("no rectify_map.h5 and no cam_to_cam.yaml: {reason}"));
            None
        }
    })
}

fn rig_camera(info: &CameraInfo, body_from_camera: DMat4) -> RigCamera {
    RigCamera {
        name: info.name.clone(),
        size: [info.width, info.height],
        intrinsics: [info.fx, info.fy, info.cx, info.cy],
        distortion: info.distortion.as_ref().map(|of| (of.model.clone(), of.coefficients.clone())),
        body_from_camera: body_from_camera.transpose().to_cols_array_2d(),
    }
}

/// The right camera's pose in the left one's axes, or why there is none.
fn relative_pose(
    recording: &Recording,
    left: usize,
    right: usize,
) -> Result<Result<DMat4, &'static str>, FormatError> {
    Ok(fixed_pose(&recording.poses(left)?, &recording.poses(right)?))
}

/// The same, of poses at the same times.
fn fixed_pose(left: &[PoseSample], right: &[PoseSample]) -> Result<DMat4, &'static str> {
    let mut between = left
        .iter()
        .zip(right)
        .filter(|(left, right)| left.t_us == right.t_us)
        .map(|(left, right)| world_from_camera(left).inverse() * world_from_camera(right));
    let first = between.next().ok_or("the recording has no poses of both at one time")?;
    if between.all(|other| first.abs_diff_eq(other, FIXED)) {
        Ok(first)
    } else {
        Err("they move against each other")
    }
}

fn world_from_camera(pose: &PoseSample) -> DMat4 {
    let rotation = DQuat::from_array(pose.rotation).normalize();
    DMat4::from_rotation_translation(rotation, DVec3::from(pose.position))
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

/// Where the middle of a pixel lies.
fn middle(pixel: usize, width: usize) -> DVec2 {
    DVec2::new((pixel % width) as f64, (pixel / width) as f64) + 0.5
}

/// The rectified place of every pixel.
fn write_map(path: &Path, camera: &RectifiedCamera) -> Result<(), FormatError> {
    let [width, height] = camera.size.map(|edge| edge as usize);
    let place = |pixel: usize| {
        let place = camera.rectified(middle(pixel, width));
        place.map_or(NOWHERE, |place| (place - 0.5).as_vec2().to_array())
    };
    let map: Vec<f32> = (0..width * height).flat_map(place).collect();
    let write = || -> Result<(), Hdf5Error> {
        let file = H5File::create(path)?;
        file.new_dataset::<f32>().shape([height, width, 2]).create("rectify_map")?.write_raw(&map)?;
        file.close()
    };
    write().map_err(|error| FormatError::io(path, "write", std::io::Error::other(error.to_string())))
}

/// Where a pixel of a rectified picture comes from.
struct Source {
    /// The pixel that holds its middle.
    pixel: usize,
    /// That pixel's depth along the rectified axis over the one along its own.
    depth_factor: f64,
    /// Where its middle is in the rectified picture.
    place: DVec2,
}

/// For each pixel of a rectified picture, where it comes from.
struct Sources {
    camera: RectifiedCamera,
    pixels: Vec<Option<Source>>,
}

impl Sources {
    fn new(camera: &RectifiedCamera) -> Self {
        let [width, height] = camera.size.map(|edge| edge as usize);
        let end = DVec2::new(width as f64, height as f64);
        let source = |pixel: usize| {
            let at = camera.source(middle(pixel, width))?;
            let inside = at.cmpge(DVec2::ZERO).all() && at.cmplt(end).all();
            let pixel = inside.then(|| at.y as usize * width + at.x as usize)?;
            let own = middle(pixel, width);
            let (depth_factor, place) = (camera.depth_factor(own)?, camera.rectified(own)?);
            Some(Source { pixel, depth_factor, place })
        };
        Self { camera: *camera, pixels: (0..width * height).map(source).collect() }
    }

    /// Flow in the rectified picture of what moves by `flow` pixels in its own one.
    fn flow(&self, source: &Source, flow: [f32; 2]) -> Option<[f32; 2]> {
        let own = middle(source.pixel, self.camera.size[0] as usize);
        let to = self.camera.rectified(own + DVec2::from(flow.map(f64::from)))?;
        Some((to - source.place).as_vec2().to_array())
    }
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

fn write_flow(
    recording: &Recording,
    camera: usize,
    sources: Option<&Sources>,
    folder: &Path,
    work: &mut Work,
) -> Result<usize, Halt> {
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
        let flow = flow.as_chunks::<2>().0;
        let known = |pixel: usize| flow.get(pixel).copied().filter(|_| valid(pixel));
        let rectified = |pixel: usize| match sources {
            Some(sources) => {
                let source = sources.pixels.get(pixel)?.as_ref()?;
                sources.flow(source, known(source.pixel)?)
            }
            // Without a calibration, in the camera's own picture.
            None => known(pixel),
        };
        for pixel in 0..flow.len() {
            match rectified(pixel).map(|flow| flow.map(flow_value)) {
                Some([Some(x), Some(y)]) => values.extend([x, y, 1]),
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

/// Disparity of a depth: 256 steps per pixel, 0 where it is unknown or does not fit.
fn disparity_value(depth: f64, fx_baseline: f64) -> u16 {
    let value = (fx_baseline / depth * 256.0).round();
    if depth > 0.0 && (1.0..=65_535.0).contains(&value) { value as u16 } else { 0 }
}

fn write_disparity(
    recording: &Recording,
    camera: usize,
    sources: &Sources,
    fx_baseline: f64,
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
        let value =
            |source: &Source| depth.get(source.pixel).map(|depth| f64::from(*depth) * source.depth_factor);
        let disparity = |source: &Option<Source>| {
            source.as_ref().and_then(value).map_or(0, |depth| disparity_value(depth, fx_baseline))
        };
        let values: Vec<u16> = sources.pixels.iter().map(disparity).collect();
        let [width, height] = sources.camera.size;
        let name = format!("{index:06}.png");
        encode_png(&own.join(name), (width, height), png::ColorType::Grayscale, &values)?;
    }
    let text: String = times.iter().map(|t| format!("{t}\n")).collect();
    write_file(&folder.join("disparity").join("timestamps.txt"), text.as_bytes())?;
    Ok(times.len())
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
        assert_eq!([f64::INFINITY, 0.0, -1.0, 1e-9].map(|depth| disparity_value(depth, 20.0)), [0; 4]);
    }

    #[test]
    fn cameras_that_move_against_each_other_are_no_pair() {
        // Both turned by 90 degrees about y: the left camera's right is the world's -z.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let pose = |t_us, z| PoseSample { t_us, position: [1.0, 2.0, z], rotation: [0.0, half, 0.0, half] };
        let left = [pose(0, 3.0), pose(1000, 4.0)];
        let fixed = fixed_pose(&left, &[pose(0, 2.5), pose(1000, 3.5)]).unwrap();
        assert!(fixed.abs_diff_eq(DMat4::from_translation(DVec3::new(0.5, 0.0, 0.0)), 1e-12), "{fixed}");
        assert!(fixed_pose(&left, &[pose(0, 2.5), pose(1000, 3.4)]).unwrap_err().contains("move"));
        assert!(fixed_pose(&left, &[pose(500, 2.5)]).unwrap_err().contains("no poses"));
    }
}
