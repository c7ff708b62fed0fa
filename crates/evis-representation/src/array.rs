//! What representations are made into.

use evis_core::limits::Budget;

use crate::error::Error;

/// A dense array, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Array<T> {
    /// Lengths of its dimensions, the innermost last.
    pub shape: Vec<usize>,
    /// Its values, as many as the product of the lengths.
    pub data: Vec<T>,
}

impl<T: Clone + Default> Array<T> {
    /// An array of zeros.
    ///
    /// # Errors
    /// [`Error::TooLarge`], where it takes more than the memory limit of the process.
    pub(crate) fn zeros(shape: &[usize]) -> Result<Self, Error> {
        let names: Vec<String> = shape.iter().map(usize::to_string).collect();
        let too_large = |reason| Error::TooLarge { shape: names.join(" x "), reason };
        let count = shape.iter().try_fold(1_usize, |product, length| product.checked_mul(*length));
        let count = count.ok_or_else(|| too_large("no machine has that memory".into()))?;
        Budget::default()
            .take_values::<T>(count as u64, "it")
            .map_err(|error| too_large(error.to_string()))?;
        Ok(Self { shape: shape.to_vec(), data: vec![T::default(); count] })
    }
}
