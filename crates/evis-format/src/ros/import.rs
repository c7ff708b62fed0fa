//! A bag as a recording of EVIS: the way back from [`super::export`].

use std::path::Path;

use evis_core::format::FormatError;
use evis_core::format::hdf5::{RecordingExtras, RecordingHeader, RecordingWriter};
use evis_core::{CameraInfo, LabelData, LabelFrame, LabelKind};

use super::export::{encoding, from_ros, y_up};
use super::mcap::{EventDecoder, namespace};
use super::message::{CAMERA_INFO, IMAGE, IMU, POSE};
use super::parse::{self, EventMessage, Image, is_event_type};
use super::records::{BagReader, Record, Topic};
use crate::files::draft_path;
use crate::format::Format;
use crate::open::check_size;
use crate::packet::Packet;
use crate::work::{Halt, Work, unless_stopped};

/// What [`import_mcap`] read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BagImport {
    /// Names of the cameras in the recording.
    pub cameras: Vec<String>,
    /// Events of all cameras.
    pub events: u64,
    /// Images of all kinds.
    pub images: u64,
    /// Poses of all cameras.
    pub poses: u64,
    /// Inertial samples.
    pub imu: u64,
    /// Topics that a recording has no place for, with why.
    pub left_out: Vec<String>,
}

/// Where the messages of a topic go.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Place {
    Nowhere,
    Events(usize),
    Image(usize, LabelKind),
    Pose(usize),
    Imu(usize),
}

/// What a topic holds, by a first look at its messages.
#[derive(Default)]
struct Seen {
    messages: u64,
    /// Of events and images: pixels per row, and rows.
    size: Option<(u32, u32)>,
    /// Of images: the encoding, empty where they do not all have the same, and their times.
    encoding: String,
    times: Vec<i64>,
    /// The lens, or what is wrong with it.
    info: Option<Result<CameraInfo, String>>,
}

/// A camera of the bag.
struct Camera {
    /// What its topics begin with.
    namespace: String,
    info: CameraInfo,
    decoder: EventDecoder,
}

/// What a bag holds, and where that goes.
#[derive(Default)]
struct Content {
    /// Per topic of the bag.
    seen: Vec<Seen>,
    places: Vec<Place>,
    cameras: Vec<Camera>,
    imus: Vec<String>,
    /// Topics that go nowhere, with why.
    left_out: Vec<String>,
    /// Per topic, images that were written.
    written: Vec<usize>,
}

/// Writes the ROS 2 bag at `path` as a recording of EVIS: its topics of events with what they have under the same name, as
/// [`super::export_mcap`] writes them, and all inertial units. Where flow leads to and how long a frame was exposed is not in a
/// bag: flow leads to the next image of its kind, or the one before, and exposures are 0. `proceed` is called now and then
/// with the part that is done, 0 to 1; where it says no, nothing is at `output` that was not there before, and `None` is
/// returned.
///
/// # Errors
/// No topic of events, triggers, an output that exists (unless `overwrite`), a damaged bag, which is named with the byte, and a
/// disk that refuses.
pub fn import_mcap(
    path: &Path,
    output: &Path,
    overwrite: bool,
    mut proceed: impl FnMut(f64) -> bool,
) -> Result<Option<BagImport>, FormatError> {
    crate::files::refuse_existing(output, overwrite)?;
    let draft = draft_path(output, "draft.h5");
    let imported = unless_stopped(import(path, &draft, &mut Work::new(1, &mut proceed)));
    if !matches!(imported, Ok(Some(_))) {
        // The error, if there is one, is the one to tell.
        let _ = std::fs::remove_file(&draft);
        return imported;
    }
    std::fs::rename(&draft, output).map_err(|error| FormatError::io(output, "write", error))?;
    imported
}

fn import(path: &Path, draft: &Path, work: &mut Work) -> Result<BagImport, Halt> {
    let mut bag = BagReader::open(path)?;
    let mut content = Content::default();
    each_message(&mut bag, work, 0.0, |bag, place| content.look(bag, place))?;
    content.assign(bag.topics());
    if content.cameras.is_empty() {
        let remedy = "give a bag with event_camera_msgs/msg/EventPacket in evt3";
        return Err(FormatError::invalid(path, "there is no topic of events", remedy).into());
    }
    let extras = RecordingExtras { imus: content.imus.clone(), ..RecordingExtras::default() };
    let mut writer = RecordingWriter::create_with_extras(draft, &content.header(), &extras, true)?;
    let mut import = BagImport {
        cameras: content.cameras.iter().map(|camera| camera.info.name.clone()).collect(),
        left_out: std::mem::take(&mut content.left_out),
        ..BagImport::default()
    };
    bag.begin()?;
    let (mut packet, mut failed) = (Packet::default(), None);
    let written = each_message(&mut bag, work, 0.5, |bag, place| {
        packet.clear();
        content.read(place, bag.message(), &mut packet)?;
        let wrote = content.write(place, bag.message(), &packet, &mut writer, &mut import)?;
        wrote.map_err(|error| match error {
            // Such as events that go back in time: the bag is at fault.
            FormatError::Invalid { what, .. } => what,
            error => failed.insert(error).to_string(),
        })
    });
    // A disk that refuses is no damage of the bag.
    if let Some(error) = failed {
        return Err(error.into());
    }
    written?;
    writer.finish("{}")?;
    Ok(import)
}

/// Calls `read` for each message, with the place of its topic; `from` is the part of the work that was done before, which is half
/// of it or nothing.
fn each_message(
    bag: &mut BagReader,
    work: &mut Work,
    from: f64,
    mut read: impl FnMut(&BagReader, usize) -> Result<(), String>,
) -> Result<(), Halt> {
    let mut part = -1.0;
    loop {
        let step = bag.step()?;
        // Once per chunk, where the bag has chunks.
        if bag.part() != part {
            part = bag.part();
            work.at(from + 0.5 * part)?;
        }
        let read = match step {
            Ok(Record::End) => return Ok(()),
            Ok(Record::Other) => Ok(()),
            Ok(Record::Message(place)) => read(bag, place),
            Err(what) => Err(what),
        };
        read.map_err(|what| bag.damaged(&what))?;
    }
}

/// What a camera or a unit is called whose topics begin with `namespace`.
fn unit_name(namespace: &str, nameless: &str) -> String {
    match namespace.trim_matches('/') {
        "" => nameless.into(),
        name => name.replace('/', "_"),
    }
}

/// `name`, or with the least number from 2 on behind it that makes it one that is not `taken`.
fn own_name(name: String, mut taken: impl FnMut(&str) -> bool) -> String {
    if !taken(&name) {
        return name;
    }
    (2_u32..).map(|n| format!("{name}_{n}")).find(|own| !taken(own)).unwrap_or(name)
}

impl Content {
    /// Takes a first look at a message.
    fn look(&mut self, bag: &BagReader, place: usize) -> Result<(), String> {
        let Some(topic) = bag.topics().get(place) else { return Ok(()) };
        if self.seen.len() <= place {
            self.seen.resize_with(place + 1, Seen::default);
        }
        let Some(seen) = self.seen.get_mut(place) else { return Ok(()) };
        let first = seen.messages == 0;
        seen.messages += 1;
        let bytes = bag.message();
        if is_event_type(&topic.kind) {
            if first {
                seen.size = Some(EventMessage::parse(bytes)?.size);
            }
        } else if topic.kind == IMAGE.name {
            let image = Image::parse(bytes)?;
            if first {
                (seen.size, seen.encoding) = (Some(image.size), image.encoding.to_owned());
            } else if seen.size != Some(image.size) || seen.encoding != image.encoding {
                seen.encoding.clear();
            }
            seen.times.push(image.stamp_us);
        } else if topic.kind == CAMERA_INFO.name && first {
            seen.info = Some(parse::camera_info(bytes, ""));
        }
        Ok(())
    }

    /// Finds where the topics go.
    fn assign(&mut self, topics: &[Topic]) {
        self.seen.resize_with(topics.len(), Seen::default);
        self.places = vec![Place::Nowhere; topics.len()];
        self.written = vec![0; topics.len()];
        for (place, topic) in topics.iter().enumerate().filter(|(_, topic)| is_event_type(&topic.kind)) {
            self.places[place] = self.camera_of(topics, topic, place);
        }
        for (place, topic) in topics.iter().enumerate() {
            if is_event_type(&topic.kind) || self.seen[place].messages == 0 {
                continue;
            }
            let (to, why) = self.place_of(topic, place);
            self.places[place] = to;
            if let Some(why) = why {
                self.left_out.push(format!("{} ({why})", topic.name));
            }
        }
    }

    /// Adds the camera of a topic of events.
    fn camera_of(&mut self, topics: &[Topic], topic: &Topic, place: usize) -> Place {
        let namespace = namespace(&topic.name).to_owned();
        let of_lens = topics.iter().position(|other| {
            other.kind == CAMERA_INFO.name && other.name.strip_prefix(&namespace) == Some("camera_info")
        });
        let lens = match of_lens.and_then(|lens| self.seen[lens].info.clone()) {
            Some(Ok(lens)) => Some(lens),
            Some(Err(what)) => {
                self.left_out.push(format!("the lens of {}: {what}", topic.name));
                None
            }
            None => None,
        };
        let Some(size) = self.seen[place].size.or(lens.as_ref().map(|lens| (lens.width, lens.height))) else {
            return Place::Nowhere;
        };
        if check_size(Path::new(&topic.name), Format::Mcap, size).is_err() {
            self.left_out.push(format!("{} (a sensor of {}x{})", topic.name, size.0, size.1));
            return Place::Nowhere;
        }
        let taken = |name: &str| self.cameras.iter().any(|camera| camera.info.name == name);
        let name = own_name(unit_name(&namespace, "camera"), taken);
        let lens = lens.filter(|lens| (lens.width, lens.height) == size);
        let info = CameraInfo::uncalibrated(name.clone(), size);
        let info = lens.map_or(info, |lens| CameraInfo { name, ..lens });
        self.cameras.push(Camera { namespace, info, decoder: EventDecoder::default() });
        Place::Events(self.cameras.len() - 1)
    }

    /// Where a topic goes that has no events, and why it goes nowhere where that is to be said.
    fn place_of(&mut self, topic: &Topic, place: usize) -> (Place, Option<String>) {
        let seen = &self.seen[place];
        if topic.kind == IMU.name {
            let own = unit_name(topic.name.strip_suffix("imu").unwrap_or(&topic.name), "imu");
            let own = own_name(own, |name| self.imus.iter().any(|imu| imu == name));
            self.imus.push(own);
            return (Place::Imu(self.imus.len() - 1), None);
        }
        let own = |camera: &Camera| topic.name.strip_prefix(camera.namespace.as_str()).map(str::to_owned);
        let found =
            self.cameras.iter().enumerate().find_map(|(index, camera)| {
                own(camera).filter(|own| !own.contains('/')).map(|own| (index, own))
            });
        let Some((camera, own)) = found else { return (Place::Nowhere, Some(topic.kind.clone())) };
        let size = self.cameras.get(camera).map(|camera| (camera.info.width, camera.info.height));
        match topic.kind.as_str() {
            kind if kind == CAMERA_INFO.name && own == "camera_info" => (Place::Nowhere, None),
            kind if kind == POSE.name && own == "pose" => (Place::Pose(camera), None),
            kind if kind == IMAGE.name => {
                let mut kinds = LabelKind::ALL.into_iter();
                match kinds.find(|kind| kind.name() == own && encoding(*kind) == seen.encoding) {
                    Some(kind) if seen.size == size => (Place::Image(camera, kind), None),
                    Some(_) => (Place::Nowhere, Some("images of another size than the camera's".into())),
                    None if seen.encoding.is_empty() => {
                        (Place::Nowhere, Some("images of several sizes or encodings".into()))
                    }
                    None => (Place::Nowhere, Some(format!("images in {}", seen.encoding))),
                }
            }
            kind => (Place::Nowhere, Some(kind.to_owned())),
        }
    }

    fn header(&self) -> RecordingHeader {
        let kinds = self.places.iter().filter_map(|place| match place {
            Place::Image(_, kind) => Some(*kind),
            _ => None,
        });
        let mut labels: Vec<LabelKind> = kinds.collect();
        labels.sort_unstable();
        labels.dedup();
        let cameras = self.cameras.iter().map(|camera| camera.info.clone()).collect();
        RecordingHeader { labels, ..RecordingHeader::of(cameras) }
    }

    /// Decodes a message of events.
    fn read(&mut self, place: usize, bytes: &[u8], packet: &mut Packet) -> Result<(), String> {
        let Some(Place::Events(camera)) = self.places.get(place) else { return Ok(()) };
        let Some(camera) = self.cameras.get_mut(*camera) else { return Ok(()) };
        camera.decoder.message(bytes, packet)
    }

    /// Writes a message, whose events are in `packet`; the outer error says what is wrong with it.
    fn write(
        &mut self,
        place: usize,
        bytes: &[u8],
        packet: &Packet,
        writer: &mut RecordingWriter,
        import: &mut BagImport,
    ) -> Result<Result<(), FormatError>, String> {
        Ok(match self.places.get(place).copied().unwrap_or(Place::Nowhere) {
            Place::Nowhere => Ok(()),
            Place::Events(camera) => {
                import.events += packet.events.len() as u64;
                if !packet.triggers.is_empty() {
                    return Err(
                        "there are triggers, which a recording does not hold: leave them out with `events_only`".into()
                    );
                }
                writer.write_events(camera, &packet.events)
            }
            Place::Image(camera, kind) => {
                let Some(frame) = self.label(place, kind, &Image::parse(bytes)?)? else { return Ok(Ok(())) };
                import.images += 1;
                writer.write_label(camera, &frame)
            }
            Place::Pose(camera) => {
                let (t_us, position, rotation) = parse::pose(bytes)?;
                import.poses += 1;
                writer.write_pose(camera, &from_ros(t_us, position, rotation))
            }
            Place::Imu(unit) => {
                import.imu += 1;
                writer.write_imu(unit, &[parse::imu(bytes)?])
            }
        })
    }

    /// The next image of a topic.
    fn label(&mut self, place: usize, kind: LabelKind, image: &Image) -> Result<Option<LabelFrame>, String> {
        let (Some(seen), Some(next)) = (self.seen.get(place), self.written.get_mut(place)) else {
            return Ok(None);
        };
        let (t_us, index) = (image.stamp_us, *next);
        *next += 1;
        let before = index.checked_sub(1).and_then(|before| seen.times.get(before)).copied();
        let t_other_us = match kind {
            // The last one leads as far as the one before it.
            LabelKind::FlowForward | LabelKind::FlowForwardValid => match seen.times.get(index + 1) {
                Some(next) => *next,
                None => before.map_or(t_us, |before| t_us.saturating_add(t_us.saturating_sub(before))),
            },
            LabelKind::FlowBackward | LabelKind::FlowBackwardValid => before.unwrap_or(t_us),
            _ => t_us,
        };
        let bytes = image.pixels(if encoding(kind) == "8UC1" { 1 } else { 4 * kind.channels() as u64 })?;
        let words = || bytes.as_chunks().0.iter();
        let data = match encoding(kind) {
            "8UC1" => LabelData::U8(bytes.to_vec()),
            "32SC1" => LabelData::U32(words().map(|word| u32::from_le_bytes(*word)).collect()),
            _ => LabelData::F32(words().map(|word| f32::from_le_bytes(*word)).collect()),
        };
        let data = match data {
            LabelData::F32(mut values) if kind == LabelKind::Normal => {
                for normal in values.as_chunks_mut().0 {
                    *normal = y_up(*normal);
                }
                LabelData::F32(values)
            }
            data => data,
        };
        Ok(Some(LabelFrame { kind, t_us, t_other_us, data }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_namespaces_and_differ() {
        assert_eq!(["/left/", "/a/b/", "/"].map(|n| unit_name(n, "camera")), ["left", "a_b", "camera"]);
        let own = own_name("a".into(), |name| ["a", "a_2"].contains(&name));
        assert_eq!(own, "a_3");
    }
}
