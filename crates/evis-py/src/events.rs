//! Events as a NumPy structured array, moved and never copied.

use std::mem::ManuallyDrop;

use evis_core::Event;
use numpy::{Element, PyArray1, PyArrayDescr, PyReadonlyArray1};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyDict;

/// [`Event`] under a name of this crate, so that it can be a NumPy element.
#[repr(transparent)]
#[derive(Clone, Copy)]
pub(crate) struct EventCd(Event);

// SAFETY: `Event` is `repr(C)`, plain data, 16 bytes, with x, y, p, t at offsets 0, 2, 4, 8 (tested in
// evis-core), which is what `get_dtype` declares; it holds no Python object.
unsafe impl Element for EventCd {
    const IS_COPY: bool = true;

    fn get_dtype(py: Python<'_>) -> Bound<'_, PyArrayDescr> {
        event_dtype(py).unwrap_or_else(|error| {
            // Only a broken NumPy gets here, and the trait leaves no other way out.
            panic!("NumPy refuses the EventCD dtype: {error}")
        })
    }

    fn clone_ref(&self, _py: Python<'_>) -> Self {
        *self
    }
}

/// Metavision's `EventCD`: `x <u2 @0, y <u2 @2, p <i2 @4, t <i8 @8`, 16 bytes.
pub(crate) fn event_dtype(py: Python<'_>) -> PyResult<Bound<'_, PyArrayDescr>> {
    static DTYPE: PyOnceLock<Py<PyArrayDescr>> = PyOnceLock::new();
    let dtype = DTYPE.get_or_try_init(py, || -> PyResult<_> {
        let layout = PyDict::new(py);
        layout.set_item("names", ["x", "y", "p", "t"])?;
        layout.set_item("formats", ["<u2", "<u2", "<i2", "<i8"])?;
        layout.set_item("offsets", [0, 2, 4, 8])?;
        layout.set_item("itemsize", 16)?;
        Ok(PyArrayDescr::new(py, layout)?.unbind())
    })?;
    Ok(dtype.bind(py).clone())
}

/// Moves `events` into a NumPy array; the array's base is a capsule that owns the vector.
pub(crate) fn into_numpy(py: Python<'_>, events: Vec<Event>) -> Bound<'_, PyArray1<EventCd>> {
    let mut events = ManuallyDrop::new(events);
    // SAFETY: `EventCd` is a transparent wrapper of `Event`, so pointer, length and capacity describe
    // the same allocation with the same layout; the original vector is never dropped.
    let events = unsafe {
        Vec::from_raw_parts(events.as_mut_ptr().cast::<EventCd>(), events.len(), events.capacity())
    };
    PyArray1::from_vec(py, events)
}

/// The events of a contiguous EventCD array, without a copy.
pub(crate) fn as_events<'a>(array: &'a PyReadonlyArray1<'_, EventCd>) -> PyResult<&'a [Event]> {
    let events = array.as_slice()?;
    // SAFETY: as above, the same memory under the wrapped type's name; `Event` allows any bit pattern.
    Ok(unsafe { std::slice::from_raw_parts(events.as_ptr().cast::<Event>(), events.len()) })
}
