//! The empty file of a recording: what a header may say, groups, scalars, links and data sets without rows.

use std::io;
use std::mem::size_of;
use std::path::Path;

use rust_hdf5::{DatatypeMessage, FilterPipeline, H5File, H5Group, H5Type, Hdf5Error};

use super::units::describe;
use super::{
    BodyInfo, EVENTS_PER_CHUNK, GZIP_LEVEL, LAYOUT_VERSION, LabelType, RESERVED_NAMES, RecordingHeader,
    StateInfo, has_other_time, hash_text, is_group_name,
};
use crate::format::FormatError;
use crate::packet::{CameraInfo, LabelKind};

/// Latest event: 31 days. `ms_to_idx` has an entry per millisecond, silent ones too, so a time in the
/// wrong unit would fill the disk.
pub(super) const LATEST_US: i64 = 31 * 86_400 * 1_000_000;
/// Entries per chunk of `ms_to_idx`.
const MILLIS_PER_CHUNK: usize = 16_384;
/// Rows per chunk of times and poses.
const ROWS_PER_CHUNK: usize = 1024;
/// Largest image side: event coordinates are u16.
const LARGEST_SIDE: u32 = 65_536;

/// Whether `t` is u32: the planned duration says that it suffices.
pub(super) fn is_narrow(duration_us: Option<i64>) -> bool {
    duration_us.is_some_and(|us| us <= i64::from(u32::MAX))
}

pub(super) fn check_header(path: &Path, header: &RecordingHeader) -> Result<(), FormatError> {
    let invalid = |what: String, remedy: &str| Err(FormatError::invalid(path, what, remedy));
    if header.cameras.is_empty() {
        return invalid("a recording without a camera".into(), "give at least one camera");
    }
    for (i, camera) in header.cameras.iter().enumerate() {
        let name = &camera.name;
        if !is_group_name(name) || RESERVED_NAMES.contains(&name.as_str()) {
            return invalid(
                format!("{name:?} cannot name a camera"),
                "use a name without slash, other than events, ms_to_idx, t_offset, truth, imus, bodies, states and evis",
            );
        }
        if header.cameras.iter().take(i).any(|other| other.name == *name) {
            return invalid(format!("two cameras are named {name:?}"), "give each its own name");
        }
        if !(1..=LARGEST_SIDE).contains(&camera.width) || !(1..=LARGEST_SIDE).contains(&camera.height) {
            return invalid(
                format!("camera {name:?} has {}x{} pixels", camera.width, camera.height),
                "each side must have between 1 and 65536 pixels",
            );
        }
    }
    let unusable = |camera: &&CameraInfo| camera.distortion.as_ref().is_some_and(|own| !own.is_usable());
    if let Some(camera) = header.cameras.iter().find(unusable) {
        let coefficients = camera.distortion.as_ref().map(|own| &own.coefficients);
        return invalid(
            format!("camera {:?} has the distortion {:?}", camera.name, coefficients.unwrap_or(&Vec::new())),
            "give at most 14 coefficients, all of them finite",
        );
    }
    for (i, kind) in header.labels.iter().enumerate() {
        if header.labels.iter().take(i).any(|other| other == kind) {
            return invalid(format!("label {} is listed twice", kind.name()), "list it once");
        }
        // HDF5 stores the size of a chunk in 32 bits.
        let most = (u64::from(u32::MAX) / 4) / kind.channels() as u64;
        if let Some(c) = header.cameras.iter().find(|c| u64::from(c.width) * u64::from(c.height) > most) {
            return invalid(
                format!("label {} of camera {:?} is larger than 4 GiB a frame", kind.name(), c.name),
                "use a smaller image",
            );
        }
    }
    match header.duration_us {
        Some(us) if !(0..=LATEST_US).contains(&us) => {
            invalid(format!("a duration of {us} us"), "give between 0 and 31 days, or none")
        }
        _ => Ok(()),
    }
}

pub(super) fn creation_error(path: &Path, error: &Hdf5Error) -> FormatError {
    if let Hdf5Error::Io(source) = error {
        return FormatError::io(path, "create", io::Error::new(source.kind(), source.to_string()));
    }
    // The crate hides the system's error inside a private type; its text ends in "(os error N)".
    let text = error.to_string();
    let code = text.rsplit_once("(os error ").and_then(|(_, rest)| rest.trim_end_matches(')').parse().ok());
    match code {
        Some(code) => FormatError::io(path, "create", io::Error::from_raw_os_error(code)),
        None => FormatError::invalid(path, format!("cannot be laid out ({text})"), "check names and sizes"),
    }
}

/// Writes the empty file: groups, scalars, links and data sets without rows.
pub(super) fn lay_out(
    path: &Path,
    header: &RecordingHeader,
    extra: impl FnOnce(&H5File) -> Result<(), Hdf5Error>,
) -> Result<(), Hdf5Error> {
    let file = H5File::create(path)?;
    match fill(&file, header).and_then(|()| extra(&file)) {
        Ok(()) => file.close_no_sync(),
        Err(error) => {
            // Dropped, the crate would try to finalize the file and print that it cannot.
            std::mem::forget(file);
            Err(error)
        }
    }
}

fn fill(file: &H5File, header: &RecordingHeader) -> Result<(), Hdf5Error> {
    if let Some(first) = header.cameras.first() {
        file.set_attr_numeric("width", &i64::from(first.width))?;
        file.set_attr_numeric("height", &i64::from(first.height))?;
    }
    for camera in &header.cameras {
        lay_out_camera(file, camera, header)?;
    }
    if let [only] = header.cameras.as_slice() {
        let root = file.root_group();
        for name in ["events", "ms_to_idx", "t_offset"] {
            root.link(name, &format!("/{}/{name}", only.name))?;
        }
    }

    let evis = file.create_group("evis")?;
    evis.set_attr_string("version", LAYOUT_VERSION)?;
    evis.set_attr_string("method", &header.method)?;
    scalar(&evis, "seed", header.seed)?;
    scalar(&evis, "environment", header.environment)?;
    scalar(&evis, "complete", 0_u8)?;
    scalar(&evis, "header_hash", header.hash())?;
    let names: Vec<&str> = header.cameras.iter().map(|c| c.name.as_str()).collect();
    strings(&evis, "cameras", &names)?;
    strings(&evis, "config_toml", &[&header.config_toml])?;
    rows::<u8>(&evis, "report_json", EVENTS_PER_CHUNK, &[])
}

fn lay_out_camera(file: &H5File, camera: &CameraInfo, header: &RecordingHeader) -> Result<(), Hdf5Error> {
    let (width, height) = (i64::from(camera.width), i64::from(camera.height));
    let group = file.create_group(&camera.name)?;
    let events = group.create_group("events")?;
    rows::<u16>(&events, "x", EVENTS_PER_CHUNK, &[])?;
    rows::<u16>(&events, "y", EVENTS_PER_CHUNK, &[])?;
    if is_narrow(header.duration_us) {
        rows::<u32>(&events, "t", EVENTS_PER_CHUNK, &[])?;
    } else {
        rows::<i64>(&events, "t", EVENTS_PER_CHUNK, &[])?;
    }
    rows::<u8>(&events, "p", EVENTS_PER_CHUNK, &[])?;
    if header.labels.contains(&LabelKind::Cause) {
        rows::<u8>(&events, "cause", EVENTS_PER_CHUNK, &[])?;
    }
    scalar(&events, "width", width)?;
    scalar(&events, "height", height)?;
    rows::<u64>(&group, "ms_to_idx", MILLIS_PER_CHUNK, &[])?;
    scalar(&group, "t_offset", header.t_offset_us)?;

    let intrinsics = group.create_group("intrinsics")?;
    for (name, value) in [("fx", camera.fx), ("fy", camera.fy), ("cx", camera.cx), ("cy", camera.cy)] {
        scalar(&intrinsics, name, value)?;
    }
    scalar(&intrinsics, "width", width)?;
    scalar(&intrinsics, "height", height)?;
    if let Some(distortion) = &camera.distortion {
        strings(&intrinsics, "distortion_model", &[&distortion.model])?;
        let count = distortion.coefficients.len();
        let coefficients =
            intrinsics.new_dataset::<f64>().shape([count]).create("distortion_coefficients")?;
        describe(&coefficients, "distortion_coefficients")?;
        coefficients.write_raw(&distortion.coefficients)?;
    }

    let poses = group.create_group("poses")?;
    rows::<i64>(&poses, "t_us", ROWS_PER_CHUNK, &[])?;
    rows::<f64>(&poses, "position", ROWS_PER_CHUNK, &[3])?;
    rows::<f64>(&poses, "rotation_xyzw", ROWS_PER_CHUNK, &[4])?;

    let labels = group.create_group("labels")?;
    for &kind in header.labels.iter().filter(|kind| kind.is_image()) {
        let mut frame = vec![camera.height as usize, camera.width as usize];
        if kind.channels() > 1 {
            frame.push(kind.channels());
        }
        match LabelType::of(kind) {
            LabelType::F32 => rows::<f32>(&labels, kind.name(), 1, &frame)?,
            LabelType::U32 => rows::<u32>(&labels, kind.name(), 1, &frame)?,
            LabelType::U8 => rows::<u8>(&labels, kind.name(), 1, &frame)?,
        }
        rows::<i64>(&labels, &format!("{}_t_us", kind.name()), ROWS_PER_CHUNK, &[])?;
        if has_other_time(kind) {
            rows::<i64>(&labels, &format!("{}_t_other_us", kind.name()), ROWS_PER_CHUNK, &[])?;
        }
        if kind == LabelKind::Frame {
            rows::<i64>(&labels, "frame_t_end_us", ROWS_PER_CHUNK, &[])?;
        }
    }
    Ok(())
}

pub(super) fn lay_out_imus(file: &H5File, names: &[String]) -> Result<(), Hdf5Error> {
    if names.is_empty() {
        return Ok(());
    }
    let imus = file.create_group("imus")?;
    for name in names {
        let group = imus.create_group(name)?;
        rows::<i64>(&group, "t_us", ROWS_PER_CHUNK, &[])?;
        rows::<f64>(&group, "accelerometer", ROWS_PER_CHUNK, &[3])?;
        rows::<f64>(&group, "gyroscope", ROWS_PER_CHUNK, &[3])?;
    }
    Ok(())
}

pub(super) fn lay_out_states(file: &H5File, states: &[StateInfo]) -> Result<(), Hdf5Error> {
    if states.is_empty() {
        return Ok(());
    }
    let group = file.create_group("states")?;
    for StateInfo { name, values } in states {
        let group = group.create_group(name)?;
        strings(&group, "names", &values.iter().map(String::as_str).collect::<Vec<_>>())?;
        store_hash(&group, "names_hash", StateInfo::hash(values))?;
        rows::<i64>(&group, "t_us", ROWS_PER_CHUNK, &[])?;
        // Chunks of a MiB or so.
        let per_chunk = (EVENTS_PER_CHUNK / values.len()).clamp(1, ROWS_PER_CHUNK);
        rows::<f64>(&group, "values", per_chunk, &[values.len()])?;
    }
    Ok(())
}

pub(super) fn lay_out_bodies(
    file: &H5File,
    header: &RecordingHeader,
    bodies: &[BodyInfo],
) -> Result<(), Hdf5Error> {
    if bodies.is_empty() {
        return Ok(());
    }
    for (kind, [ids_name, names_name], named) in [
        (LabelKind::Instance, ["instance_ids", "instance_names"], BodyInfo::instances(bodies)),
        (LabelKind::Semantic, ["semantic_ids", "semantic_names"], BodyInfo::classes(bodies)),
    ] {
        if !header.labels.contains(&kind) || named.is_empty() {
            continue;
        }
        let (ids, names): (Vec<u32>, Vec<&str>) = named.into_iter().unzip();
        for camera in &header.cameras {
            let labels = file.root_group().group(&format!("{}/labels", camera.name))?;
            values(&labels, ids_name, &ids, &[ids.len()])?;
            strings(&labels, names_name, &names)?;
        }
    }
    let (count, group) = (bodies.len(), file.create_group("bodies")?);
    strings(&group, "name", &bodies.iter().map(|body| body.name.as_str()).collect::<Vec<_>>())?;
    let ids = |id: fn(&BodyInfo) -> u32| bodies.iter().map(id).collect::<Vec<_>>();
    values(&group, "instance_id", &ids(|body| body.instance_id), &[count])?;
    values(&group, "semantic_id", &ids(|body| body.semantic_id), &[count])?;
    if !BodyInfo::classes(bodies).is_empty() {
        let classes: Vec<_> = bodies.iter().map(|body| body.semantic_name.as_str()).collect();
        strings(&group, "semantic_name", &classes)?;
    }
    for (name, side) in [("box_min", 0), ("box_max", 1)] {
        let corners: Vec<f64> = bodies.iter().flat_map(|body| body.bounds[side]).collect();
        values(&group, name, &corners, &[count, 3])?;
    }
    store_hash(&group, "bodies_hash", BodyInfo::hash(bodies))?;
    // Chunks of a MiB or so, however many bodies there are.
    let per_chunk = (EVENTS_PER_CHUNK / count).clamp(1, ROWS_PER_CHUNK);
    rows::<i64>(&group, "t_us", ROWS_PER_CHUNK, &[])?;
    rows::<f64>(&group, "position", per_chunk, &[count, 3])?;
    rows::<f64>(&group, "rotation_xyzw", per_chunk, &[count, 4])?;
    rows::<f64>(&group, "linear_velocity", per_chunk, &[count, 3])?;
    rows::<f64>(&group, "angular_velocity", per_chunk, &[count, 3])
}

/// A hash as an attribute: as text, since numbers among the attributes of a group cannot be read back.
fn store_hash(group: &H5Group, name: &str, hash: u64) -> Result<(), Hdf5Error> {
    let text = hash_text(hash);
    let kind = DatatypeMessage::fixed_string_utf8(text.len() as u32);
    group.set_attr_typed(name, kind, text.into_bytes())
}

/// A single value.
pub(super) fn scalar<T: H5Type>(group: &H5Group, name: &str, value: T) -> Result<(), Hdf5Error> {
    let dataset = group.new_dataset::<T>().scalar().create(name)?;
    describe(&dataset, name)?;
    dataset.write_raw(&[value])
}

/// Texts.
pub(super) fn strings(group: &H5Group, name: &str, texts: &[&str]) -> Result<(), Hdf5Error> {
    describe(&group.write_vlen_strings(name, texts)?, name)
}

/// Values that are known at once.
fn values<T: H5Type>(group: &H5Group, name: &str, values: &[T], shape: &[usize]) -> Result<(), Hdf5Error> {
    let dataset = group.new_dataset::<T>().shape(shape).create(name)?;
    describe(&dataset, name)?;
    dataset.write_raw(values)
}

/// An empty data set of rows shaped `frame`, unlimited along the first axis.
fn rows<T: H5Type>(
    group: &H5Group,
    name: &str,
    rows_per_chunk: usize,
    frame: &[usize],
) -> Result<(), Hdf5Error> {
    let with = |first: usize| -> Vec<usize> { std::iter::once(first).chain(frame.iter().copied()).collect() };
    let most: Vec<Option<usize>> = std::iter::once(None).chain(frame.iter().copied().map(Some)).collect();
    // Shuffling single bytes changes nothing, but every data set then has the same pipeline.
    let dataset = group
        .new_dataset::<T>()
        .shape(with(0))
        .chunk(&with(rows_per_chunk))
        .max_shape(&most)
        .filter_pipeline(FilterPipeline::shuffle_deflate(size_of::<T>() as u32, GZIP_LEVEL))
        .create(name)?;
    describe(&dataset, name)
}
