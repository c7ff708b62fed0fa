//! A whole recording of EVIS as a bag: events, camera info, images, poses, inertial samples.

use std::path::Path;

use evis_core::format::FormatError;
use evis_core::format::hdf5::Recording;
use evis_core::{CameraInfo, ImuSample, LabelData, LabelFrame, LabelKind, PoseSample};

use super::bag::Bag;
use super::mcap::{EventTopic, LATEST_US};
use super::message::{self, CAMERA_INFO, IMAGE, IMU, POSE, Pixels};
use crate::format::Format;
use crate::open::check_size;
use crate::packet::Packet;
use crate::work::{Halt, Work, unless_stopped};

/// Microseconds that are copied at once.
const US_AT_ONCE: i64 = 20_000;
/// The frame that poses are in.
const WORLD: &str = "world";

/// What [`export_mcap`] wrote.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct McapExport {
    /// Names of the cameras, as their topics have them.
    pub cameras: Vec<String>,
    /// Events of all cameras.
    pub events: u64,
    /// Images of all kinds.
    pub images: u64,
    /// Poses of all cameras.
    pub poses: u64,
    /// Inertial samples.
    pub imu: u64,
}

/// The images of one kind, of one camera.
struct Images {
    kind: LabelKind,
    place: usize,
    t_us: Vec<i64>,
    next: usize,
}

/// A camera that is copied.
struct Camera<'a> {
    index: usize,
    info: &'a CameraInfo,
    frame: String,
    events: EventTopic,
    info_topic: usize,
    /// When its camera info is sent: at the start, and with each image.
    info_us: Vec<i64>,
    images: Vec<Images>,
    pose_topic: usize,
    poses: Vec<PoseSample>,
}

/// An inertial unit that is copied.
struct Unit {
    name: String,
    place: usize,
    samples: Vec<ImuSample>,
}

/// Writes a recording of EVIS as a ROS 2 bag in MCAP. `proceed` is called now and then with the part that is done, 0 to 1; where
/// it says no, nothing is at `output` that was not there before, and `None` is returned.
///
/// Topics are `/<camera>/events`, `/<camera>/camera_info`, `/<camera>/<kind>` for images of each kind,
/// `/<camera>/pose` and `/<unit>/imu`. Stamps are the stream's times. Poses are of optical frames (x right, y down,
/// z ahead) in the frame `world`, whose z axis points up (REP 103, REP 105), as normals are.
///
/// # Errors
/// An output that exists (unless `overwrite`), a damaged recording, sensors and times that do not fit, and a disk that
/// refuses.
pub fn export_mcap(
    recording: &Recording,
    output: &Path,
    overwrite: bool,
    mut proceed: impl FnMut(f64) -> bool,
) -> Result<Option<McapExport>, FormatError> {
    unless_stopped(export(recording, output, overwrite, &mut proceed))
}

fn export(
    recording: &Recording,
    output: &Path,
    overwrite: bool,
    proceed: &mut dyn FnMut(f64) -> bool,
) -> Result<McapExport, Halt> {
    let infos = &recording.header().cameras;
    for info in infos {
        check_size(output, Format::Mcap, (info.width, info.height))?;
    }
    let mut bag = Bag::create(output, overwrite)?;
    let mut names = Vec::new();
    let mut cameras = Vec::new();
    for (index, info) in infos.iter().enumerate() {
        cameras.push(Camera::new(
            recording,
            index,
            info,
            topic_name(&info.name, &mut names),
            &mut bag,
            output,
        )?);
    }
    let mut units = Vec::new();
    for name in recording.imus()? {
        let own = topic_name(&name, &mut names);
        let place = bag.topic(format!("/{own}/imu"), &IMU)?;
        units.push(Unit { samples: recording.imu(&name)?, name: own, place });
    }
    let mut export = McapExport {
        cameras: cameras.iter().map(|camera| camera.frame.clone()).collect(),
        ..McapExport::default()
    };
    let mut last_us = 0;
    for camera in &cameras {
        last_us = last_us.max(camera.last_us());
        export.events += recording.event_count(camera.index)?;
    }
    last_us =
        units.iter().filter_map(|unit| unit.samples.last()).map(|sample| sample.t_us).fold(last_us, i64::max);
    let (mut copied, mut start_us) = (0, i64::MIN);
    let mut end_us = US_AT_ONCE;
    // Events are most of the work, where there are any.
    let steps = u64::try_from(last_us / US_AT_ONCE).unwrap_or(0) + 1;
    let mut work = Work::new(export.events + steps, proceed);
    while copied < export.events || start_us <= last_us {
        for camera in &mut cameras {
            let events = camera.copy(recording, start_us, end_us, &mut bag, &mut export)?;
            copied += events;
            work.advance(events)?;
        }
        work.advance(1)?;
        for unit in &units {
            for sample in between(&unit.samples, |sample| sample.t_us, start_us, end_us) {
                let content = message::imu(sample.t_us, &unit.name, sample.accelerometer, sample.gyroscope);
                bag.message(unit.place, stamp(output, sample.t_us)?, &content)?;
                export.imu += 1;
            }
        }
        if start_us > LATEST_US {
            break;
        }
        (start_us, end_us) = (end_us, end_us + US_AT_ONCE);
    }
    bag.finish()?;
    Ok(export)
}

impl<'a> Camera<'a> {
    fn new(
        recording: &Recording,
        index: usize,
        info: &'a CameraInfo,
        name: String,
        bag: &mut Bag,
        output: &Path,
    ) -> Result<Self, FormatError> {
        let events = EventTopic::new(bag, output, &name, &name, (info.width, info.height))?;
        let info_topic = bag.topic(format!("/{name}/camera_info"), &CAMERA_INFO)?;
        let mut images = Vec::new();
        for kind in recording.label_kinds(index)?.iter().copied().filter(|kind| kind.is_image()) {
            let place = bag.topic(format!("/{name}/{}", kind.name()), &IMAGE)?;
            images.push(Images { kind, place, t_us: recording.label_times(index, kind)?, next: 0 });
        }
        let mut info_us: Vec<i64> = images.iter().flat_map(|images| images.t_us.clone()).chain([0]).collect();
        info_us.sort_unstable();
        info_us.dedup();
        let pose_topic = bag.topic(format!("/{name}/pose"), &POSE)?;
        let poses = recording.poses(index)?;
        Ok(Self { index, info, frame: name, events, info_topic, info_us, images, pose_topic, poses })
    }

    /// The latest time of what it has beside events.
    fn last_us(&self) -> i64 {
        let images = self.info_us.last().copied();
        images.into_iter().chain(self.poses.last().map(|pose| pose.t_us)).max().unwrap_or(0)
    }

    /// Copies what lies in `[start_us, end_us)`; returns the number of events.
    fn copy(
        &mut self,
        recording: &Recording,
        start_us: i64,
        end_us: i64,
        bag: &mut Bag,
        export: &mut McapExport,
    ) -> Result<u64, FormatError> {
        for &t_us in between(&self.info_us, |t_us| *t_us, start_us, end_us) {
            bag.message(self.info_topic, t_us, &message::camera_info(t_us, &self.frame, self.info))?;
        }
        for pose in between(&self.poses, |pose| pose.t_us, start_us, end_us) {
            let (position, rotation) = in_ros(pose);
            let t_us = stamp(recording.path(), pose.t_us)?;
            bag.message(self.pose_topic, t_us, &message::pose(t_us, WORLD, position, rotation))?;
            export.poses += 1;
        }
        for images in &mut self.images {
            while images.t_us.get(images.next).is_some_and(|t_us| *t_us < end_us) {
                let frame = recording.label(self.index, images.kind, images.next)?;
                let t_us = stamp(recording.path(), frame.t_us)?;
                let (encoding, bytes) = pixels(frame);
                let pixels = Pixels { size: (self.info.width, self.info.height), encoding, bytes: &bytes };
                bag.message(images.place, t_us, &message::image(t_us, &self.frame, &pixels))?;
                images.next += 1;
                export.images += 1;
            }
        }
        let events = recording.events_between(self.index, start_us, end_us)?;
        let count = events.len() as u64;
        self.events.gather(&Packet { events, ..Packet::default() }, bag)?;
        // So that messages of all topics are nearly in the order of time.
        self.events.flush(bag)?;
        Ok(count)
    }
}

/// The part of `all`, sorted by time, in `[start_us, end_us)`.
fn between<T>(all: &[T], t_us: impl Fn(&T) -> i64, start_us: i64, end_us: i64) -> &[T] {
    let from = all.partition_point(|each| t_us(each) < start_us);
    let to = all.partition_point(|each| t_us(each) < end_us);
    all.get(from..to).unwrap_or_default()
}

/// A time that stamps hold.
fn stamp(path: &Path, t_us: i64) -> Result<i64, FormatError> {
    if (0..=LATEST_US).contains(&t_us) {
        return Ok(t_us);
    }
    Err(FormatError::invalid(
        path,
        format!("something in it is at {t_us} us"),
        format!("{} holds times from 0 to {LATEST_US} us", Format::Mcap),
    ))
}

/// A name that a topic may have, letters, digits and underscores, unlike those before it.
fn topic_name(name: &str, taken: &mut Vec<String>) -> String {
    let mut own: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    if !own.starts_with(|c: char| c.is_ascii_alphabetic()) {
        own.insert_str(0, "camera_");
    }
    while taken.contains(&own) {
        own.push('x');
    }
    taken.push(own.clone());
    own
}

/// Pixels as bytes, and the encoding's name.
fn pixels(frame: LabelFrame) -> (&'static str, Vec<u8>) {
    let kind = frame.kind;
    let bytes = match frame.data {
        LabelData::F32(mut values) => {
            if kind == LabelKind::Normal {
                for [x, y, z] in values.as_chunks_mut().0 {
                    [*x, *y, *z] = z_up([*x, *y, *z]);
                }
            }
            values.iter().flat_map(|value| value.to_le_bytes()).collect()
        }
        LabelData::U32(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        LabelData::U8(values) => values,
    };
    (encoding(kind), bytes)
}

/// The encoding of images of `kind`.
pub(super) const fn encoding(kind: LabelKind) -> &'static str {
    match kind {
        LabelKind::FlowForwardValid | LabelKind::FlowBackwardValid | LabelKind::Cause => "8UC1",
        LabelKind::Instance | LabelKind::Semantic => "32SC1",
        _ => match kind.channels() {
            1 => "32FC1",
            2 => "32FC2",
            _ => "32FC3",
        },
    }
}

/// From axes with y up to axes with z up, a quarter turn about x.
fn z_up<T: std::ops::Neg<Output = T>>([x, y, z]: [T; 3]) -> [T; 3] {
    [x, -z, y]
}

/// The inverse of [`z_up`].
pub(super) fn y_up<T: std::ops::Neg<Output = T>>([x, y, z]: [T; 3]) -> [T; 3] {
    [x, z, -y]
}

/// The inverse of [`in_ros`].
pub(super) fn from_ros(t_us: i64, position: [f64; 3], rotation: [f64; 4]) -> PoseSample {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let turned = product(rotation, [-1.0, 0.0, 0.0, 0.0]);
    PoseSample { t_us, position: y_up(position), rotation: product([-half, 0.0, 0.0, half], turned) }
}

/// Position and rotation of the optical frame in a world with z up.
fn in_ros(pose: &PoseSample) -> ([f64; 3], [f64; 4]) {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let turned = product([half, 0.0, 0.0, half], pose.rotation);
    // Half a turn about x: from cameras that look along -z with y up.
    (z_up(pose.position), product(turned, [1.0, 0.0, 0.0, 0.0]))
}

/// The product of two quaternions (x, y, z, w).
fn product([ax, ay, az, aw]: [f64; 4], [bx, by, bz, bw]: [f64; 4]) -> [f64; 4] {
    [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topics_have_names_of_their_own_that_ros_takes() {
        let mut taken = Vec::new();
        let own: Vec<_> = ["left", "a b", "a-b", "2"].map(|name| topic_name(name, &mut taken)).into();
        assert_eq!(own, ["left", "a_b", "a_bx", "camera_2"]);
    }

    #[test]
    fn a_camera_at_rest_looks_along_y_of_a_world_with_z_up() {
        let pose = PoseSample { t_us: 0, position: [1.0, 2.0, 3.0], rotation: [0.0, 0.0, 0.0, 1.0] };
        let (position, q) = in_ros(&pose);
        assert_eq!(position, [1.0, -3.0, 2.0]);
        // The optical axes in the world: x right, y down, z ahead.
        let turned = |v: [f64; 3]| {
            let conjugate = [-q[0], -q[1], -q[2], q[3]];
            let [x, y, z, _] = product(product(q, [v[0], v[1], v[2], 0.0]), conjugate);
            [x, y, z].map(|value| value.round() as i32)
        };
        assert_eq!(turned([1.0, 0.0, 0.0]), [1, 0, 0]);
        assert_eq!(turned([0.0, 1.0, 0.0]), [0, 0, -1]);
        assert_eq!(turned([0.0, 0.0, 1.0]), [0, 1, 0]);
        let pose = PoseSample { rotation: [0.1, -0.7, 0.5, 0.5], ..pose };
        let (position, rotation) = in_ros(&pose);
        let back = from_ros(0, position, rotation);
        assert_eq!(back.position, pose.position);
        let error = back.rotation.iter().zip(&pose.rotation).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(error < 1e-15, "{back:?}");
    }
}
