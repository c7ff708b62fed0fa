//! What a writer demands of events before it writes them.

use std::path::{Path, PathBuf};

use evis_core::Event;
use evis_core::format::FormatError;

use crate::format::Format;
use crate::packet::{Packet, Trigger};

/// Checks that events continue a stream and fit a format.
pub(crate) struct Check {
    path: PathBuf,
    format: Format,
    width: u32,
    height: u32,
    earliest_us: i64,
    latest_us: i64,
    most_id: i16,
    last_us: i64,
    last_trigger_us: i64,
    count: u64,
}

impl Check {
    /// For a format that holds `earliest_us <= t <= latest_us`, and triggers of ids up to `most_id`.
    pub(crate) fn new(
        path: &Path,
        format: Format,
        size: (u32, u32),
        (earliest_us, latest_us): (i64, i64),
        most_id: i16,
    ) -> Self {
        Self {
            path: path.into(),
            format,
            width: size.0,
            height: size.1,
            earliest_us,
            latest_us,
            most_id,
            last_us: i64::MIN,
            last_trigger_us: i64::MIN,
            count: 0,
        }
    }

    /// Refuses events that go back in time, lie outside of the image or do not fit the format.
    pub(crate) fn events(&mut self, events: &[Event]) -> Result<(), FormatError> {
        let mut wrong = false;
        let mut last_us = self.last_us;
        for e in events {
            wrong |= (e.t < last_us)
                | (u32::from(e.x) >= self.width)
                | (u32::from(e.y) >= self.height)
                | (e.p as u16 > 1);
            last_us = e.t;
        }
        let first = events.first().map_or(self.earliest_us, |event| event.t);
        if wrong || first < self.earliest_us || (!events.is_empty() && last_us > self.latest_us) {
            return Err(self.explain(events));
        }
        self.last_us = last_us;
        self.count += events.len() as u64;
        Ok(())
    }

    fn explain(&self, events: &[Event]) -> FormatError {
        let mut last_us = self.last_us;
        for (index, e) in events.iter().enumerate() {
            let index = self.count + index as u64;
            let (what, remedy) = if u32::from(e.x) >= self.width || u32::from(e.y) >= self.height {
                let Self { width, height, .. } = self;
                (
                    format!("x {}, y {} lies outside of {width}x{height}", e.x, e.y),
                    "give the sensor's size".into(),
                )
            } else if !matches!(e.p, 0 | 1) {
                (format!("has polarity {}", e.p), "ON is 1 and OFF is 0".into())
            } else if e.t < last_us {
                (
                    format!("at {} us is earlier than {last_us} us before it", e.t),
                    "sort the events by time".into(),
                )
            } else if e.t < self.earliest_us || e.t > self.latest_us {
                (format!("is at {} us", e.t), self.time_remedy())
            } else {
                last_us = e.t;
                continue;
            };
            return FormatError::invalid(&self.path, format!("event {index} {what}"), remedy);
        }
        FormatError::invalid(&self.path, "an event does not fit", self.time_remedy())
    }

    fn time_remedy(&self) -> String {
        format!(
            "{} holds times from {} to {} us: cut the stream, shift its times, or choose another format",
            self.format, self.earliest_us, self.latest_us
        )
    }

    /// Refuses triggers that do not fit the format.
    pub(crate) fn triggers(&mut self, triggers: &[Trigger]) -> Result<(), FormatError> {
        for trigger in triggers {
            let Trigger { p, t, id, .. } = *trigger;
            let (what, remedy) = if t < self.earliest_us || t > self.latest_us {
                (format!("is at {t} us"), self.time_remedy())
            } else if t < self.last_trigger_us {
                (
                    format!("at {t} us is earlier than {} us before it", self.last_trigger_us),
                    "sort them by time".into(),
                )
            } else if !(0..=self.most_id).contains(&id) {
                (format!("has id {id}"), format!("{} holds ids from 0 to {}", self.format, self.most_id))
            } else if !matches!(p, 0 | 1) {
                (format!("has value {p}"), "rising is 1 and falling is 0".into())
            } else {
                self.last_trigger_us = t;
                continue;
            };
            return Err(FormatError::invalid(&self.path, format!("a trigger {what}"), remedy));
        }
        Ok(())
    }

    /// As [`Check::triggers`], for formats where events and triggers share one order of time: what is
    /// written next cannot be earlier than either. Checks the events too.
    pub(crate) fn triggers_among_events(&mut self, packet: &Packet) -> Result<(), FormatError> {
        let Some(first) = packet.triggers.first() else { return self.events(&packet.events) };
        if first.t < self.last_us {
            return Err(FormatError::invalid(
                &self.path,
                format!("a trigger at {} us comes after an event at {} us", first.t, self.last_us),
                "write triggers in one packet with the events around them",
            ));
        }
        self.triggers(&packet.triggers)?;
        self.events(&packet.events)?;
        self.last_us = self.last_us.max(self.last_trigger_us);
        Ok(())
    }

    /// Refuses what the format has no place for.
    pub(crate) fn refuse(&self, count: usize, what: &str) -> Result<(), FormatError> {
        refuse(&self.path, self.format, count, what)
    }

    /// Refuses a packet that holds more than events.
    pub(crate) fn only_events(&self, packet: &Packet) -> Result<(), FormatError> {
        self.refuse(packet.frames.len(), "frames")?;
        self.refuse(packet.imu.len(), "inertial samples")?;
        self.refuse(packet.triggers.len(), "triggers")
    }
}

/// Refuses what `format` has no place for.
pub(crate) fn refuse(path: &Path, format: Format, count: usize, what: &str) -> Result<(), FormatError> {
    if count == 0 {
        return Ok(());
    }
    Err(FormatError::invalid(
        path,
        format!("{format} holds no {what}"),
        format!("leave the {what} out, or choose a format that holds them, such as .aedat4"),
    ))
}
