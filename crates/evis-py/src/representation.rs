//! Dense arrays of events, moved into NumPy.

use evis_representation::{Array, Decay, Error, Measure, Polarities, Slice};
use numpy::{Element, PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArray1};
use pyo3::prelude::*;

use crate::errors::Failure;
use crate::events::{self, EventCd};
use crate::gil::Detach;

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        Self::Config(error.to_string())
    }
}

/// What all representations are made of: events, width and height, the first microsecond and one past the last, and whether the
/// events are known to be sorted by time.
type Source<'py> = (PyReadonlyArray1<'py, EventCd>, (u32, u32), (Option<i64>, Option<i64>), bool);

/// Makes an array without the GIL, and moves it into NumPy.
fn make<'py, T>(
    py: Python<'py>,
    source: &Source<'py>,
    work: impl FnOnce(&Slice<'_>) -> Result<Array<T>, Error> + Send,
) -> PyResult<Bound<'py, PyArrayDyn<T>>>
where
    T: Element + Send,
{
    let (events, size, (start_us, end_us), sorted) = source;
    let events = events::as_events(events)?;
    let array = py.detach_pure(|| {
        let slice = Slice::new(events, *size)?;
        let slice = match (start_us, end_us) {
            (None, None) => slice,
            _ if *sorted => slice.between_sorted(*start_us, *end_us)?,
            _ => slice.between(*start_us, *end_us)?,
        };
        work(&slice)
    })?;
    PyArray1::from_vec(py, array.data).reshape(array.shape)
}

fn unknown(what: &str, value: &str, names: &str) -> Failure {
    Failure::Config(format!("{what} is '{value}'; it must be {names}"))
}

/// By its word.
pub(crate) fn polarities(word: &str) -> Result<Polarities, Failure> {
    match word {
        "signed" => Ok(Polarities::Signed),
        "split" => Ok(Polarities::Split),
        _ => Err(unknown("polarity", word, "'signed' or 'split'")),
    }
}

/// By its word.
pub(crate) fn decay(word: &str) -> Result<Decay, Failure> {
    match word {
        "exponential" => Ok(Decay::Exponential),
        "linear" => Ok(Decay::Linear),
        _ => Err(unknown("decay", word, "'exponential' or 'linear'")),
    }
}

/// Sums of polarities, int32 (H, W).
#[pyfunction]
pub(crate) fn event_frame<'py>(
    py: Python<'py>,
    source: Source<'py>,
) -> PyResult<Bound<'py, PyArrayDyn<i32>>> {
    make(py, &source, evis_representation::event_frame)
}

/// Numbers of events, int32 (2, H, W).
#[pyfunction]
pub(crate) fn counts<'py>(py: Python<'py>, source: Source<'py>) -> PyResult<Bound<'py, PyArrayDyn<i32>>> {
    make(py, &source, evis_representation::counts)
}

/// A voxel grid, float32 (B, H, W) or (2, B, H, W).
#[pyfunction]
pub(crate) fn voxel_grid<'py>(
    py: Python<'py>,
    source: Source<'py>,
    bins: usize,
    polarity: &str,
    normalize: bool,
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    let polarities = self::polarities(polarity)?;
    make(py, &source, |slice| {
        let mut grid = evis_representation::voxel_grid(slice, bins, polarities)?;
        if normalize {
            evis_representation::normalize_nonzero(&mut grid.data);
        }
        Ok(grid)
    })
}

/// An event spike tensor, float32 (2, B, H, W).
#[pyfunction]
pub(crate) fn event_spike_tensor<'py>(
    py: Python<'py>,
    source: Source<'py>,
    bins: usize,
    measure: &str,
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    let measure = match measure {
        "time" => Measure::Time,
        "count" => Measure::Count,
        "polarity" => Measure::Polarity,
        _ => return Err(unknown("measure", measure, "'time', 'count' or 'polarity'").into()),
    };
    make(py, &source, |slice| evis_representation::event_spike_tensor(slice, bins, measure))
}

/// Time surfaces, float32 (T, 2, H, W).
#[pyfunction]
pub(crate) fn time_surfaces<'py>(
    py: Python<'py>,
    source: Source<'py>,
    at_us: Vec<i64>,
    tau_us: f64,
    decay: &str,
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    let decay = self::decay(decay)?;
    make(py, &source, |slice| evis_representation::time_surfaces(slice, &at_us, tau_us, decay))
}

/// Mean times, float32 (2, H, W).
#[pyfunction]
pub(crate) fn averaged_timestamps<'py>(
    py: Python<'py>,
    source: Source<'py>,
    empty: f32,
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    make(py, &source, |slice| evis_representation::averaged_timestamps(slice, empty))
}

/// Which pixels fired in each part of time, uint8 (B, 2, H, W).
#[pyfunction]
pub(crate) fn binary_stack<'py>(
    py: Python<'py>,
    source: Source<'py>,
    bins: usize,
) -> PyResult<Bound<'py, PyArrayDyn<u8>>> {
    make(py, &source, |slice| evis_representation::binary_stack(slice, bins))
}

/// Bina-Rep frames, float32 (F, 2, H, W).
#[pyfunction]
pub(crate) fn bina_rep<'py>(
    py: Python<'py>,
    source: Source<'py>,
    frames: usize,
    bits: usize,
) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
    make(py, &source, |slice| evis_representation::bina_rep(slice, frames, bits))
}
