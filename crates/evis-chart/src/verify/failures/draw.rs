//! The suite as a picture.
use super::FailureReport;
use crate::canvas::{Canvas, Drawing};
use crate::error::ChartError;
use plotters::backend::DrawingBackend;
pub(super) struct Figure;
impl Drawing for Figure {
    fn size(&self) -> [f64; 2] { [10.0, 10.0] }
    fn draw<DB: DrawingBackend>(&self, _: &Canvas<DB>) -> Result<(), ChartError> { Ok(()) }
}
pub(super) fn figure(_: &FailureReport) -> Result<Figure, ChartError> { Ok(Figure) }
