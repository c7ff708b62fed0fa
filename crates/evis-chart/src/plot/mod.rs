//! Drawing: a canvas of SVG and PNG, with axes, labels, markers and colours. It knows nothing of events.

pub(crate) mod axis;
pub(crate) mod canvas;
pub(crate) mod indexed;
pub(crate) mod ink;
pub(crate) mod label;
pub(crate) mod marker;
