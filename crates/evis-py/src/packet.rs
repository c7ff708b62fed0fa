//! A packet as Python sees it: arrays that own what the engine made.

use evis_core::{Event, LabelData, LabelFrame, LabelKind, PoseSample};
use evis_render::{DenseValues, DenseWindow, PacketReport};
use numpy::ndarray::{Array1, Array2};
use numpy::{IntoPyArray, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::errors::Failure;
use crate::events;

/// Everything that happened in `[start_us, end_us)`.
#[pyclass(frozen, get_all, module = "evis._evis")]
pub(crate) struct Packet {
    start_us: i64,
    end_us: i64,
    views: Vec<Py<View>>,
    report: Py<PyDict>,
    /// What a host said of its time.
    host: Option<Py<HostSpan>>,
}

/// What a host said of the time of a packet.
#[pyclass(frozen, module = "evis._evis")]
pub(crate) struct HostSpan(pub(crate) evis_render::HostSpan);

/// One camera of one environment.
#[pyclass(frozen, get_all, module = "evis._evis")]
pub(crate) struct View {
    environment: usize,
    camera: usize,
    events: Py<PyAny>,
    /// Start, end and array of each window.
    dense: Option<Vec<(i64, i64, Py<PyAny>)>>,
    causes: Py<PyAny>,
    labels: Vec<Py<Label>>,
    poses: Py<PyAny>,
}

/// One label image.
#[pyclass(frozen, get_all, module = "evis._evis")]
pub(crate) struct Label {
    kind: &'static str,
    t_us: i64,
    t_other_us: i64,
    data: Py<PyAny>,
}

/// Converts `packet`; `sizes` are (width, height) per camera. `host`: what a host said of its time.
pub(crate) fn convert(
    py: Python<'_>,
    packet: evis_render::Packet,
    sizes: &[(u32, u32)],
    host: Option<evis_render::HostSpan>,
) -> PyResult<Packet> {
    let views = packet.views.into_iter().map(|view| {
        let size = *sizes.get(view.camera).ok_or_else(|| {
            Failure::Engine(format!(
                "a packet speaks of camera {}, and there are {}",
                view.camera,
                sizes.len()
            ))
        })?;
        let labels = view.labels.into_iter().map(|frame| Py::new(py, label(py, frame, size)?));
        let view = View {
            environment: view.environment,
            camera: view.camera,
            dense: view
                .dense
                .map(|windows| windows.into_iter().map(|window| dense(py, window)).collect())
                .transpose()?,
            events: events::into_numpy(py, view.events).into_any().unbind(),
            causes: view.causes.into_pyarray(py).into_any().unbind(),
            labels: labels.collect::<PyResult<_>>()?,
            poses: poses(py, &view.poses)?,
        };
        Py::new(py, view)
    });
    Ok(Packet {
        start_us: packet.start_us,
        end_us: packet.end_us,
        views: views.collect::<PyResult<_>>()?,
        report: report(py, &packet.report)?,
        host: host.map(|span| Py::new(py, HostSpan(span))).transpose()?,
    })
}

/// `frame` as an array of shape (H, W) or (H, W, C), moved without a copy.
pub(crate) fn label(py: Python<'_>, frame: LabelFrame, (width, height): (u32, u32)) -> PyResult<Label> {
    let (height, width, channels) = (height as usize, width as usize, frame.kind.channels());
    let shape = if channels == 1 { vec![height, width] } else { vec![height, width, channels] };
    let data = match frame.data {
        LabelData::F32(values) => values.into_pyarray(py).reshape(shape)?.into_any(),
        LabelData::U32(values) => values.into_pyarray(py).reshape(shape)?.into_any(),
        LabelData::U8(values) => values.into_pyarray(py).reshape(shape)?.into_any(),
    };
    Ok(Label { kind: frame.kind.name(), t_us: frame.t_us, t_other_us: frame.t_other_us, data: data.unbind() })
}

/// Start, end, and the array, moved without a copy.
fn dense(py: Python<'_>, window: DenseWindow) -> PyResult<(i64, i64, Py<PyAny>)> {
    let array = match window.values {
        DenseValues::I32(array) => array.data.into_pyarray(py).reshape(array.shape)?.into_any(),
        DenseValues::F32(array) => array.data.into_pyarray(py).reshape(array.shape)?.into_any(),
    };
    Ok((window.start_us, window.end_us, array.unbind()))
}

/// `(t_us (N,) i8, position (N, 3) f8, rotation (N, 4) f8)`.
pub(crate) fn poses(py: Python<'_>, poses: &[PoseSample]) -> PyResult<Py<PyAny>> {
    let t_us: Array1<i64> = poses.iter().map(|pose| pose.t_us).collect();
    let positions: Array2<f64> = poses.iter().map(|pose| pose.position).collect::<Vec<_>>().into();
    let rotations: Array2<f64> = poses.iter().map(|pose| pose.rotation).collect::<Vec<_>>().into();
    let tuple = (t_us.into_pyarray(py), positions.into_pyarray(py), rotations.into_pyarray(py));
    Ok(tuple.into_pyobject(py)?.into_any().unbind())
}

fn report(py: Python<'_>, report: &PacketReport) -> PyResult<Py<PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("events", report.events)?;
    dict.set_item("dropped", report.dropped)?;
    dict.set_item("suppressed", report.suppressed)?;
    dict.set_item("clamped", report.clamped)?;
    dict.set_item("instants", report.instants)?;
    dict.set_item("drawn_pixels", report.drawn_pixels)?;
    dict.set_item("rendered_tiles", report.rendered_tiles)?;
    dict.set_item("on_device", report.on_device)?;
    dict.set_item("refollowed", report.refollowed)?;
    dict.set_item("resting", report.resting)?;
    dict.set_item("keyframes", report.keyframes)?;
    dict.set_item("clipped", report.clipped)?;
    let clipped: Vec<String> =
        report.clipped_light.iter().map(evis_render::clipped::ClippedLight::warning).collect();
    dict.set_item("clipped_light", clipped)?;
    dict.set_item("unknown", report.unknown)?;
    dict.set_item("reruns", report.reruns)?;
    dict.set_item("audited", report.audited)?;
    dict.set_item("audited_with_others", report.audited_with_others)?;
    dict.set_item("changed", report.changed)?;
    let findings: Vec<String> = report.findings.iter().map(evis_render::audit::Finding::warning).collect();
    dict.set_item("findings", findings)?;
    dict.set_item("host_ms", report.times.host_ms)?;
    dict.set_item("device_wait_ms", report.times.device_wait_ms)?;
    dict.set_item("pack_ms", report.times.pack_ms)?;
    dict.set_item("total_ms", report.times.total_ms)?;
    Ok(dict.unbind())
}

/// NumPy dtype of a label's values (the comments of [`LabelKind`] are the source).
pub(crate) fn dtype(kind: LabelKind) -> &'static str {
    match kind {
        LabelKind::Instance | LabelKind::Semantic => "<u4",
        LabelKind::FlowForwardValid | LabelKind::FlowBackwardValid | LabelKind::Cause => "|u1",
        LabelKind::Depth
        | LabelKind::FlowForward
        | LabelKind::FlowBackward
        | LabelKind::Normal
        | LabelKind::Hdr
        | LabelKind::Frame => "<f4",
    }
}

/// `(array, address)`: the array that `events` became, and where the vector lay before.
pub(crate) fn events_with_address(py: Python<'_>, events: Vec<Event>) -> PyResult<Bound<'_, PyTuple>> {
    let address = events.as_ptr() as usize;
    (events::into_numpy(py, events), address).into_pyobject(py)
}
