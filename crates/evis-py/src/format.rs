//! Event files of other programs: reader and writer.

use std::path::PathBuf;
use std::sync::Mutex;

use evis_format::{EventReader, EventWriter, Format, Packet, ReadOptions, Trigger, WriteOptions};
use numpy::PyReadonlyArray1;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::errors::Failure;
use crate::events::{self, EventCd};
use crate::gil::{Detach, lock, lock_unpoisoned};

/// Start and end of the exposure, width, height, channels, pixels.
type FrameParts<'py> = (i64, i64, u32, u32, u8, Bound<'py, PyBytes>);
/// Time, then temperature, acceleration, rotation and magnetic field.
type ImuRow = (i64, [f32; 10]);
/// Events, triggers as bytes of `EventExtTrigger`, frames, inertial samples.
type PacketParts<'py> = (Bound<'py, PyAny>, Bound<'py, PyBytes>, Vec<FrameParts<'py>>, Vec<ImuRow>);

/// The name of the format of the file at `path`, from its content.
#[pyfunction]
pub(crate) fn recognise_format(py: Python<'_>, path: PathBuf) -> PyResult<Option<&'static str>> {
    Ok(py.detach_engine(|| evis_format::recognise(&path))?.map(Format::name))
}

/// The name of the format that a file of this name would have.
#[pyfunction]
pub(crate) fn format_of_ending(path: PathBuf) -> Option<&'static str> {
    Format::of_ending(&path).map(Format::name)
}

/// Names and descriptions of all formats.
#[pyfunction]
pub(crate) fn file_formats() -> Vec<(&'static str, &'static str)> {
    Format::ALL.iter().map(|format| (format.name(), format.description())).collect()
}

/// A file of events that is read packet by packet.
#[pyclass(frozen, module = "evis._evis")]
pub(crate) struct EventFileReader {
    reader: Mutex<Box<dyn EventReader>>,
}

#[pymethods]
impl EventFileReader {
    #[new]
    #[pyo3(signature = (path, *, camera=None, size=None))]
    fn new(
        py: Python<'_>,
        path: PathBuf,
        camera: Option<String>,
        size: Option<(u32, u32)>,
    ) -> PyResult<Self> {
        let options = ReadOptions { camera, size };
        let reader = py.detach_engine(|| evis_format::open(&path, &options))?;
        Ok(Self { reader: Mutex::new(reader) })
    }

    #[getter]
    fn format(&self) -> &'static str {
        lock(&self.reader).info().format.name()
    }

    #[getter]
    fn size(&self) -> Option<(u32, u32)> {
        lock(&self.reader).info().size
    }

    #[getter]
    fn cameras(&self) -> Vec<String> {
        lock(&self.reader).info().cameras.clone()
    }

    #[getter]
    fn camera(&self) -> Option<String> {
        lock(&self.reader).info().camera.clone()
    }

    #[getter]
    fn t_offset_us(&self) -> i64 {
        lock(&self.reader).info().t_offset_us
    }

    #[getter]
    fn properties(&self) -> Vec<(String, String)> {
        lock(&self.reader).info().properties.clone()
    }

    /// The next packet; `None` at the end.
    fn read<'py>(&self, py: Python<'py>) -> PyResult<Option<PacketParts<'py>>> {
        let packet = py.detach_engine(|| {
            let mut packet = Packet::default();
            let more = lock_unpoisoned(&self.reader)?.read_packet(&mut packet)?;
            Ok::<_, Failure>(more.then_some(packet))
        })?;
        let Some(packet) = packet else { return Ok(None) };
        let triggers: Vec<u8> = packet.triggers.iter().flat_map(trigger_bytes).collect();
        let frames = packet
            .frames
            .iter()
            .map(|f| (f.start_us, f.end_us, f.width, f.height, f.channels, PyBytes::new(py, &f.pixels)));
        let imu = packet.imu.iter().map(|s| {
            let ([ax, ay, az], [gx, gy, gz], [mx, my, mz]) = (s.acceleration, s.rotation, s.magnetic);
            (s.t, [s.temperature, ax, ay, az, gx, gy, gz, mx, my, mz])
        });
        let (frames, imu) = (frames.collect(), imu.collect());
        let events = events::into_numpy(py, packet.events).into_any();
        Ok(Some((events, PyBytes::new(py, &triggers), frames, imu)))
    }

    /// All events that are left.
    fn read_events<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let all = py.detach_engine(|| {
            let mut reader = lock_unpoisoned(&self.reader)?;
            let (mut all, mut packet) = (Vec::new(), Packet::default());
            while reader.read_packet(&mut packet)? {
                all.append(&mut packet.events);
            }
            Ok::<_, Failure>(all)
        })?;
        Ok(events::into_numpy(py, all).into_any())
    }

    /// Moves so that everything at `t_us` and later is still to come.
    fn seek(&self, py: Python<'_>, t_us: i64) -> PyResult<()> {
        py.detach_engine(|| Ok::<_, Failure>(lock_unpoisoned(&self.reader)?.seek(t_us)?))
    }
}

/// `EventExtTrigger`: p <i2 @0, t <i8 @8, id <i2 @16, 24 bytes.
fn trigger_bytes(trigger: &Trigger) -> [u8; 24] {
    let mut bytes = [0; 24];
    bytes[..2].copy_from_slice(&trigger.p.to_le_bytes());
    bytes[8..16].copy_from_slice(&trigger.t.to_le_bytes());
    bytes[16..18].copy_from_slice(&trigger.id.to_le_bytes());
    bytes
}

/// A file of events that is being written.
#[pyclass(frozen, module = "evis._evis")]
pub(crate) struct EventFileWriter {
    /// `None` once it is finished or abandoned.
    writer: Mutex<Option<Box<dyn EventWriter>>>,
}

fn finished() -> Failure {
    Failure::Engine("this file is finished; open another one to write more".into())
}

#[pymethods]
impl EventFileWriter {
    #[new]
    #[pyo3(signature = (path, *, format, size, overwrite))]
    fn new(py: Python<'_>, path: PathBuf, format: &str, size: (u32, u32), overwrite: bool) -> PyResult<Self> {
        let format = Format::of_name(format)
            .ok_or_else(|| Failure::Config(format!("format is '{format}'; see evis.formats()")))?;
        let options = WriteOptions { size, overwrite };
        let writer = py.detach_engine(|| evis_format::create(&path, format, &options))?;
        Ok(Self { writer: Mutex::new(Some(writer)) })
    }

    /// Appends EventCD events, and triggers as (t, id, rising).
    #[pyo3(signature = (events, triggers=Vec::new()))]
    fn write(
        &self,
        py: Python<'_>,
        events: PyReadonlyArray1<'_, EventCd>,
        triggers: Vec<(i64, i16, bool)>,
    ) -> PyResult<()> {
        let events = events::as_events(&events)?;
        py.detach_engine(|| {
            let mut writer = lock_unpoisoned(&self.writer)?;
            let writer = writer.as_mut().ok_or_else(finished)?;
            if triggers.is_empty() {
                return Ok::<_, Failure>(writer.write_events(events)?);
            }
            let triggers = triggers.into_iter().map(|(t, id, rising)| Trigger::new(t, id, rising)).collect();
            Ok(writer.write(&Packet { events: events.to_vec(), triggers, ..Packet::default() })?)
        })
    }

    /// Ends the file and gives it its name.
    fn finish(&self, py: Python<'_>) -> PyResult<()> {
        py.detach_engine(|| {
            let writer = lock_unpoisoned(&self.writer)?.take().ok_or_else(finished)?;
            Ok::<_, Failure>(writer.finish()?)
        })
    }

    /// Leaves no file.
    fn abandon(&self, py: Python<'_>) -> PyResult<()> {
        py.detach_engine(|| {
            drop(lock(&self.writer).take());
            Ok::<_, Failure>(())
        })
    }
}
