//! From one file to another.

use std::sync::Arc;

use evis_core::Event;
use evis_core::format::FormatError;

use crate::packet::Packet;
use crate::pixel_map::PixelMap;
use crate::read::{Between, EventReader};
use crate::write::EventWriter;

/// What happens to a stream on its way.
#[derive(Clone, Debug, PartialEq)]
pub struct ConvertOptions {
    /// The first microsecond that is kept.
    pub start_us: i64,
    /// The first microsecond after those that are kept.
    pub end_us: i64,
    /// Where the pixels go, for a sensor of the map's size. Applied before the crop.
    pub undistort: Option<Arc<PixelMap>>,
    /// The part of the sensor that is kept: x, y, width, height. Applied before the flips.
    pub crop: Option<[u32; 4]>,
    /// Mirror left and right.
    pub flip_x: bool,
    /// Mirror top and bottom.
    pub flip_y: bool,
    /// Leave out what is no event.
    pub events_only: bool,
    /// Added to all times, microseconds, after the cut.
    pub shift_us: i64,
    /// Of a damaged input, keep what comes before the damage.
    pub until_damage: bool,
}

impl Default for ConvertOptions {
    fn default() -> Self {
        Self {
            start_us: i64::MIN,
            end_us: i64::MAX,
            undistort: None,
            crop: None,
            flip_x: false,
            flip_y: false,
            events_only: false,
            shift_us: 0,
            until_damage: false,
        }
    }
}

impl ConvertOptions {
    /// The size of the output for an input of this size.
    pub fn size(&self, size: (u32, u32)) -> (u32, u32) {
        self.crop.map_or(size, |[_, _, width, height]| (width, height))
    }

    /// Whether the crop lies within a sensor of this size.
    pub fn fits(&self, (width, height): (u32, u32)) -> bool {
        self.crop.is_none_or(|[x, y, w, h]| {
            w > 0
                && h > 0
                && u64::from(x) + u64::from(w) <= width.into()
                && u64::from(y) + u64::from(h) <= height.into()
        })
    }

    fn apply(&self, (width, height): (u32, u32), packet: &mut Packet) {
        if self.events_only {
            packet.triggers.clear();
            packet.frames.clear();
            packet.imu.clear();
        }
        if let Some(map) = &self.undistort {
            map.events(&mut packet.events);
            packet.frames.iter_mut().for_each(|frame| map.frame(frame));
        }
        if let Some([left, top, w, h]) = self.crop {
            let x = |e: &Event| u32::from(e.x).wrapping_sub(left);
            let y = |e: &Event| u32::from(e.y).wrapping_sub(top);
            packet.events.retain(|e| x(e) < w && y(e) < h);
            for e in &mut packet.events {
                (e.x, e.y) = (x(e) as u16, y(e) as u16);
            }
        }
        let (width, height) = self.size((width, height));
        if self.flip_x {
            packet.events.iter_mut().for_each(|e| e.x = (width - 1 - u32::from(e.x)) as u16);
        }
        if self.flip_y {
            packet.events.iter_mut().for_each(|e| e.y = (height - 1 - u32::from(e.y)) as u16);
        }
        if self.shift_us != 0 {
            let shift = |t: &mut i64| *t = t.saturating_add(self.shift_us);
            packet.events.iter_mut().for_each(|e| shift(&mut e.t));
            packet.triggers.iter_mut().for_each(|e| shift(&mut e.t));
            packet.imu.iter_mut().for_each(|e| shift(&mut e.t));
            for frame in &mut packet.frames {
                shift(&mut frame.start_us);
                shift(&mut frame.end_us);
            }
        }
        if self.crop.is_some() || self.flip_x || self.flip_y {
            // Images follow the sensor, where they are as large as it.
            for frame in &mut packet.frames {
                self.reframe(frame);
            }
        }
    }

    fn reframe(&self, frame: &mut crate::packet::Frame) {
        let channels = usize::from(frame.channels.max(1));
        let [left, top, w, h] = self.crop.unwrap_or([0, 0, frame.width, frame.height]);
        if u64::from(left) + u64::from(w) > frame.width.into()
            || u64::from(top) + u64::from(h) > frame.height.into()
        {
            return;
        }
        let mut pixels = Vec::with_capacity(w as usize * h as usize * channels);
        for row in 0..h {
            let y = top + if self.flip_y { h - 1 - row } else { row };
            for column in 0..w {
                let x = left + if self.flip_x { w - 1 - column } else { column };
                let at = (y as usize * frame.width as usize + x as usize) * channels;
                pixels.extend_from_slice(frame.pixels.get(at..at + channels).unwrap_or_default());
            }
        }
        (frame.width, frame.height, frame.pixels) = (w, h, pixels);
    }
}

/// What a conversion wrote.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Converted {
    /// Events.
    pub events: u64,
    /// Triggers.
    pub triggers: u64,
    /// Images.
    pub frames: u64,
    /// Inertial samples.
    pub imu: u64,
    /// How the input is damaged, where [`ConvertOptions::until_damage`] ended there.
    pub damage: Option<String>,
}

/// Copies what `options` keep from `reader`, whose sensor has `size`, to `writer`, and finishes the file.
/// `proceed` is called now and then with the part of the input that has been read, where it is known; where it says
/// no, the file ends there.
///
/// # Errors
/// As [`EventReader::read_packet`] and [`EventWriter::write`].
pub fn convert(
    reader: Box<dyn EventReader>,
    mut writer: Box<dyn EventWriter>,
    size: (u32, u32),
    options: &ConvertOptions,
    mut proceed: impl FnMut(Option<f64>) -> bool,
) -> Result<Converted, FormatError> {
    let mut reader = Between::new(reader, options.start_us, options.end_us)?;
    let (mut packet, mut converted) = (Packet::default(), Converted::default());
    loop {
        match reader.read_packet(&mut packet) {
            Ok(true) => {}
            Ok(false) => break,
            Err(error) if options.until_damage && matches!(error, FormatError::Corrupt { .. }) => {
                converted.damage = Some(error.to_string());
                break;
            }
            Err(error) => return Err(error),
        }
        if !proceed(reader.part()) {
            break;
        }
        options.apply(size, &mut packet);
        writer.write(&packet)?;
        converted.events += packet.events.len() as u64;
        converted.triggers += packet.triggers.len() as u64;
        converted.frames += packet.frames.len() as u64;
        converted.imu += packet.imu.len() as u64;
    }
    writer.finish()?;
    Ok(converted)
}
