//! Truth and scores.

use std::path::PathBuf;
use std::sync::Arc;

use evis_core::format::hdf5::stored_sensor;
use evis_core::metric::{self, EndpointError, Frame, MetricError, Score, ScoreSettings};
use evis_core::{Region, RegionSpan, SensorConfig};
use numpy::ndarray::{Array2, ArrayView3};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, ToPyArray};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::engine;
use crate::errors::Failure;
use crate::events::{self, EventCd};
use crate::gil::Detach;

impl From<MetricError> for Failure {
    fn from(error: MetricError) -> Self {
        Self::Config(error.to_string())
    }
}

/// What a truth knows.
#[pyclass(frozen, module = "evis._evis")]
pub(crate) struct Truth(Arc<evis_core::Truth>);

/// Thresholds and eps.
type SensorNumbers = (f32, f32, f32);

fn sensor_config((threshold_on, threshold_off, log_eps): SensorNumbers) -> SensorConfig {
    SensorConfig { threshold_on, threshold_off, log_eps, ..SensorConfig::default() }
}

fn regions(codes: Option<PyReadonlyArray1<'_, u8>>) -> PyResult<Vec<Region>> {
    let Some(codes) = codes else { return Ok(Vec::new()) };
    let region = |code: &u8| {
        Region::from_code(*code)
            .ok_or_else(|| Failure::Config(format!("a region is {code}; it must be 0 to 3")).into())
    };
    codes.as_array().iter().map(region).collect()
}

fn codes(regions: impl Iterator<Item = Region>) -> Vec<u8> {
    regions.map(|r| r as u8).collect()
}

fn column<T: Copy + numpy::Element>(values: Option<PyReadonlyArray1<'_, T>>) -> Vec<T> {
    values.map(|v| v.as_array().to_vec()).unwrap_or_default()
}

#[pymethods]
impl Truth {
    #[new]
    #[pyo3(signature = (
        *, camera, sensor, reference_luminance, duration_us, events, pixels, speed, event_region, span_start,
        span_t_us, span_region, provenance
    ))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python, one per column")]
    fn new(
        camera: &Bound<'_, PyDict>,
        sensor: SensorNumbers,
        reference_luminance: f64,
        duration_us: i64,
        events: PyReadonlyArray1<'_, EventCd>,
        pixels: Option<PyReadonlyArray2<'_, u16>>,
        speed: Option<PyReadonlyArray1<'_, f32>>,
        event_region: Option<PyReadonlyArray1<'_, u8>>,
        span_start: Option<PyReadonlyArray1<'_, u32>>,
        span_t_us: Option<PyReadonlyArray1<'_, i64>>,
        span_region: Option<PyReadonlyArray1<'_, u8>>,
        provenance: String,
    ) -> PyResult<Self> {
        let events = events::as_events(&events)?.to_vec();
        let mut truth = evis_core::Truth::from_events(
            events,
            engine::camera_info(camera)?,
            sensor_config(sensor),
            reference_luminance,
            duration_us,
        );
        if let Some(pixels) = pixels {
            let rows = pixels.as_array().rows().into_iter().map(|row| row.to_vec().try_into().ok()).collect();
            let rows: Option<Vec<[u16; 2]>> = rows;
            truth.pixels = rows.ok_or_else(|| Failure::Config("pixels must have the shape (N, 2)".into()))?;
        }
        truth.speed = column(speed);
        truth.event_region = regions(event_region)?;
        truth.span_start = column(span_start);
        let (span_t_us, span_region) = (column(span_t_us), regions(span_region)?);
        if span_t_us.len() != span_region.len() {
            return Err(Failure::Config("span_t_us and span_region differ in length".into()).into());
        }
        let spans = span_t_us.into_iter().zip(span_region);
        truth.spans = spans.map(|(t_us, region)| RegionSpan { t_us, region }).collect();
        truth.provenance = provenance;
        truth.check().map_err(Failure::from)?;
        Ok(Self(Arc::new(truth)))
    }

    /// A truth file, or camera `camera` of a recording.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf, camera: Option<&str>) -> PyResult<Self> {
        Ok(Self(Arc::new(py.detach_engine(|| evis_core::Truth::load(&path, camera))?)))
    }

    fn save(&self, py: Python<'_>, path: PathBuf, overwrite: bool) -> PyResult<()> {
        py.detach_engine(|| self.0.write(&path, overwrite))
    }

    #[getter]
    fn camera<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        engine::camera_dict(py, &self.0.camera)
    }

    /// threshold_on, threshold_off, log_eps.
    #[getter]
    fn sensor(&self) -> SensorNumbers {
        let sensor = &self.0.sensor;
        (sensor.threshold_on, sensor.threshold_off, sensor.log_eps)
    }

    #[getter]
    fn reference_luminance(&self) -> f64 {
        self.0.reference_luminance
    }

    #[getter]
    fn duration_us(&self) -> i64 {
        self.0.duration_us
    }

    #[getter]
    fn sampled_hz(&self) -> Option<f64> {
        self.0.sampled_hz()
    }

    #[getter]
    fn provenance(&self) -> &str {
        &self.0.provenance
    }

    fn events<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        events::into_numpy(py, self.0.events.clone()).into_any()
    }

    fn pixels<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u16>>> {
        let values = self.0.pixels.as_flattened().to_vec();
        let pixels = Array2::from_shape_vec((self.0.pixels.len(), 2), values);
        Ok(pixels.map_err(|e| Failure::Engine(e.to_string()))?.to_pyarray(py))
    }

    fn speed<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f32>> {
        self.0.speed.to_pyarray(py)
    }

    fn event_region<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u8>> {
        PyArray1::from_vec(py, codes(self.0.event_region.iter().copied()))
    }

    fn span_start<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u32>> {
        self.0.span_start.to_pyarray(py)
    }

    fn span_t_us<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        PyArray1::from_vec(py, self.0.spans.iter().map(|s| s.t_us).collect())
    }

    fn span_region<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u8>> {
        PyArray1::from_vec(py, codes(self.0.spans.iter().map(|s| s.region)))
    }
}

/// Scores events; returns JSON.
#[pyfunction]
pub(crate) fn score(
    py: Python<'_>,
    events: PyReadonlyArray1<'_, EventCd>,
    truth: &Truth,
    tolerances_us: Vec<i64>,
    sensor: Option<SensorNumbers>,
    size: Option<[u32; 2]>,
) -> PyResult<String> {
    let events = events::as_events(&events)?;
    let settings = ScoreSettings { tolerances_us, sensor: sensor.map(sensor_config), size };
    py.detach_engine(|| {
        let score = metric::score(events, &truth.0, &settings)?;
        serde_json::to_string(&score).map_err(|e| Failure::Engine(e.to_string()))
    })
}

/// The table of a score that is given as JSON.
#[pyfunction]
pub(crate) fn score_table(json: &str) -> PyResult<String> {
    let score: Score = serde_json::from_str(json)
        .map_err(|e| Failure::Format(format!("this is not the JSON of a score: {e}")))?;
    Ok(score.to_string())
}

/// threshold_on, threshold_off and log_eps of a camera in the settings of a recording, NaN where they are not.
#[pyfunction]
pub(crate) fn sensor_of_settings(config_toml: &str, camera: &str) -> SensorNumbers {
    let (sensor, _) = stored_sensor(config_toml, camera);
    (sensor.threshold_on, sensor.threshold_off, sensor.log_eps)
}

#[pyfunction]
pub(crate) fn voxel_l1(
    py: Python<'_>,
    events: PyReadonlyArray1<'_, EventCd>,
    truth: &Truth,
) -> PyResult<Option<f64>> {
    let events = events::as_events(&events)?;
    py.detach_engine(|| metric::voxel_l1(events, &truth.0))
}

/// Pictures are f32 (H, W, C), contiguous.
fn frame<'a>(array: &ArrayView3<'a, f32>) -> Result<Frame<'a>, Failure> {
    let (height, width, channels) = array.dim();
    let values = array.to_slice().ok_or_else(|| Failure::Config("a picture is not contiguous".into()))?;
    Ok(Frame::new(values, height, width, channels)?)
}

#[pyfunction]
pub(crate) fn ssim(
    py: Python<'_>,
    picture: PyReadonlyArray3<'_, f32>,
    reference: PyReadonlyArray3<'_, f32>,
    data_range: f64,
) -> PyResult<f64> {
    let (picture, reference) = (picture.as_array(), reference.as_array());
    py.detach_engine(|| Ok::<_, Failure>(metric::ssim(frame(&picture)?, frame(&reference)?, data_range)?))
}

#[pyfunction]
pub(crate) fn mse(
    py: Python<'_>,
    picture: PyReadonlyArray3<'_, f32>,
    reference: PyReadonlyArray3<'_, f32>,
) -> PyResult<f64> {
    let (picture, reference) = (picture.as_array(), reference.as_array());
    py.detach_engine(|| Ok::<_, Failure>(metric::mse(frame(&picture)?, frame(&reference)?)?))
}

#[pyfunction]
pub(crate) fn psnr(
    py: Python<'_>,
    picture: PyReadonlyArray3<'_, f32>,
    reference: PyReadonlyArray3<'_, f32>,
    data_range: f64,
) -> PyResult<f64> {
    let (picture, reference) = (picture.as_array(), reference.as_array());
    py.detach_engine(|| Ok::<_, Failure>(metric::psnr(frame(&picture)?, frame(&reference)?, data_range)?))
}

/// Vectors (N, 2) and a mask (N,); returns a dictionary.
#[pyfunction]
pub(crate) fn endpoint_error<'py>(
    py: Python<'py>,
    flow: PyReadonlyArray2<'py, f32>,
    reference: PyReadonlyArray2<'py, f32>,
    mask: Option<PyReadonlyArray1<'py, bool>>,
) -> PyResult<Bound<'py, PyDict>> {
    let mask = mask.as_ref().map(|m| m.as_slice()).transpose()?;
    let (flow, reference) = (flow.as_slice()?, reference.as_slice()?);
    let EndpointError { pixels, mean, median, below_1px, below_3px, below_5px } =
        py.detach_engine(|| metric::endpoint_error(flow.as_chunks().0, reference.as_chunks().0, mask))?;
    let dict = PyDict::new(py);
    dict.set_item("pixels", pixels)?;
    dict.set_item("mean", mean)?;
    dict.set_item("median", median)?;
    dict.set_item("below_1px", below_1px)?;
    dict.set_item("below_3px", below_3px)?;
    dict.set_item("below_5px", below_5px)?;
    Ok(dict)
}
