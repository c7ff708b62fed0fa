//! The messages that are read.

use evis_core::{CameraInfo, ImuSample, LensDistortion};

use super::message::EVENT_PACKET;
use crate::files::{u16_at, u32_at, u64_at};

/// Numbers and texts of a record or a message, one after the other.
pub(super) struct Fields<'a> {
    bytes: &'a [u8],
    at: usize,
    /// CDR aligns numbers to their size, from here.
    origin: Option<usize>,
}

impl<'a> Fields<'a> {
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0, origin: None }
    }

    /// A message in CDR, behind its stamp in microseconds and the name of its frame.
    fn of_message(bytes: &'a [u8]) -> Option<(i64, Self)> {
        // Two bytes of encoding, little-endian CDR, and two of options.
        if bytes.get(..2)? != [0, 1] {
            return None;
        }
        let mut fields = Self { bytes, at: 4, origin: Some(4) };
        let (seconds, nanoseconds) = (fields.u32()? as i32, fields.u32()?);
        fields.text()?;
        Some((i64::from(seconds) * 1_000_000 + i64::from(nanoseconds / 1000), fields))
    }

    /// Offset of the next byte.
    pub const fn at(&self) -> usize {
        self.at
    }

    /// Leaves out `count` bytes.
    pub fn skip(&mut self, count: usize) {
        self.at = self.at.saturating_add(count);
    }

    fn take(&mut self, size: usize) -> Option<&'a [u8]> {
        if let Some(origin) = self.origin {
            self.at = origin + (self.at - origin).next_multiple_of(size.clamp(1, 8));
        }
        self.bytes(size)
    }

    pub fn bytes(&mut self, size: usize) -> Option<&'a [u8]> {
        let bytes = self.bytes.get(self.at..self.at.checked_add(size)?)?;
        self.at += size;
        Some(bytes)
    }

    pub fn u16(&mut self) -> Option<u16> {
        u16_at(self.take(2)?, 0)
    }

    pub fn u32(&mut self) -> Option<u32> {
        u32_at(self.take(4)?, 0)
    }

    pub fn u64(&mut self) -> Option<u64> {
        u64_at(self.take(8)?, 0)
    }

    fn f64s<const N: usize>(&mut self) -> Option<[f64; N]> {
        let mut out = [0.0; N];
        for value in &mut out {
            *value = f64::from_bits(self.u64()?);
        }
        Some(out)
    }

    pub fn text(&mut self) -> Option<&'a str> {
        let length = self.u32()? as usize;
        let text = std::str::from_utf8(self.bytes(length)?).ok()?;
        Some(text.trim_end_matches('\0'))
    }

    /// A sequence of bytes.
    fn sequence(&mut self) -> Option<&'a [u8]> {
        let length = self.u32()? as usize;
        self.bytes(length)
    }
}

/// Whether messages of this type carry events.
pub(super) fn is_event_type(kind: &str) -> bool {
    [EVENT_PACKET.name, "event_array_msgs/msg/EventArray"].contains(&kind)
}

/// A message is not of its type; `kind` with its article.
fn no_message(kind: &str) -> String {
    format!("a message is no {kind} in little-endian CDR")
}

/// A message of events.
pub(super) struct EventMessage<'a> {
    pub stamp_us: i64,
    /// Pixels per row, and rows.
    pub size: (u32, u32),
    pub encoding: &'a str,
    pub events: &'a [u8],
}

impl<'a> EventMessage<'a> {
    pub fn parse(bytes: &'a [u8]) -> Result<Self, String> {
        let parsed = || {
            let (stamp_us, mut fields) = Fields::of_message(bytes)?;
            let (height, width) = (fields.u32()?, fields.u32()?);
            let _sequence = fields.u64()?;
            let _time_base = fields.u64()?;
            let encoding = fields.text()?;
            let _big_endian = fields.bytes(1)?;
            Some(Self { stamp_us, size: (width, height), encoding, events: fields.sequence()? })
        };
        let message = parsed().ok_or_else(|| no_message("EventPacket"))?;
        let (width, height) = message.size;
        if !(1..=2048).contains(&width) || !(1..=2048).contains(&height) {
            return Err(format!("a sensor would have {width}x{height} pixels"));
        }
        Ok(message)
    }
}

/// A `sensor_msgs/msg/Image`.
pub(super) struct Image<'a> {
    pub stamp_us: i64,
    /// Pixels per row, and rows.
    pub size: (u32, u32),
    pub encoding: &'a str,
    big_endian: bool,
    step: u32,
    data: &'a [u8],
}

impl<'a> Image<'a> {
    pub fn parse(bytes: &'a [u8]) -> Result<Self, String> {
        let parsed = || {
            let (stamp_us, mut fields) = Fields::of_message(bytes)?;
            let (height, width) = (fields.u32()?, fields.u32()?);
            let encoding = fields.text()?;
            let big_endian = fields.bytes(1)? != [0];
            let step = fields.u32()?;
            Some(Self {
                stamp_us,
                size: (width, height),
                encoding,
                big_endian,
                step,
                data: fields.sequence()?,
            })
        };
        parsed().ok_or_else(|| no_message("Image"))
    }

    /// Its pixels of `bytes` bytes each, row-major, without gaps; says what they are where they are not that.
    pub fn pixels(&self, bytes: u64) -> Result<&'a [u8], String> {
        let (width, height) = (u64::from(self.size.0), u64::from(self.size.1));
        let row = width * bytes;
        // Two sides of 32 bits and 16 bytes would not fit.
        if row.checked_mul(height) != Some(self.data.len() as u64) || row != u64::from(self.step) {
            return Err(format!(
                "an image of {width}x{height} in {} has {} bytes, {} per row",
                self.encoding,
                self.data.len(),
                self.step
            ));
        }
        if self.big_endian && bytes > 1 {
            return Err("an image is big-endian, and only little-endian ones are read".into());
        }
        Ok(self.data)
    }
}

/// A `sensor_msgs/msg/Imu`.
pub(super) fn imu(bytes: &[u8]) -> Result<ImuSample, String> {
    let parsed = || {
        let (t_us, mut fields) = Fields::of_message(bytes)?;
        // Orientation, and its covariance.
        fields.f64s::<13>()?;
        let gyroscope = fields.f64s()?;
        fields.f64s::<9>()?;
        Some(ImuSample { t_us, accelerometer: fields.f64s()?, gyroscope })
    };
    parsed().ok_or_else(|| no_message("Imu"))
}

/// A `geometry_msgs/msg/PoseStamped`: time, position, rotation (x, y, z, w).
pub(super) fn pose(bytes: &[u8]) -> Result<(i64, [f64; 3], [f64; 4]), String> {
    let parsed = || {
        let (t_us, mut fields) = Fields::of_message(bytes)?;
        Some((t_us, fields.f64s()?, fields.f64s()?))
    };
    parsed().ok_or_else(|| no_message("PoseStamped"))
}

/// A `sensor_msgs/msg/CameraInfo`, as that of the camera `name`; the inverse of [`super::message::camera_info`].
pub(super) fn camera_info(bytes: &[u8], name: &str) -> Result<CameraInfo, String> {
    let parsed = || {
        let (_, mut fields) = Fields::of_message(bytes)?;
        let (height, width) = (fields.u32()?, fields.u32()?);
        let model = fields.text()?;
        let count = fields.u32()?;
        let coefficients =
            (0..count).map(|_| fields.f64s::<1>().map(|[value]| value)).collect::<Option<_>>()?;
        Some((width, height, model, coefficients, fields.f64s::<9>()?))
    };
    let (width, height, model, coefficients, k): (_, _, _, Vec<f64>, _) =
        parsed().ok_or_else(|| no_message("CameraInfo"))?;
    let [fx, _, cx, _, fy, cy, ..] = k;
    let model = match model {
        // What says that there is none.
        "plumb_bob" | "" if coefficients.iter().all(|value| *value == 0.0) => None,
        "plumb_bob" | "rational_polynomial" => Some("radtan"),
        "equidistant" => Some("fisheye"),
        other => return Err(format!("a lens is distorted as '{other}', which is not read")),
    };
    let distortion = model.map(|model| LensDistortion { model: model.into(), coefficients });
    if let Some(unusable) = distortion.as_ref().filter(|distortion| !distortion.is_usable()) {
        return Err(format!(
            "it has the distortion coefficients {:?}, which cannot be",
            unusable.coefficients
        ));
    }
    Ok(CameraInfo { name: name.into(), width, height, fx, fy, cx: cx + 0.5, cy: cy + 0.5, distortion })
}
