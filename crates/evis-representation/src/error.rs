//! Why there is no representation: what is wrong, with which value, and what works.

/// Why a representation or a window cannot be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A setting.
    #[error("{what} is {value}; it must be {remedy}")]
    Setting {
        /// Its name.
        what: &'static str,
        /// Its value.
        value: String,
        /// What would work.
        remedy: String,
    },
    /// An event outside of the sensor.
    #[error(
        "event {index} lies at x = {x}, y = {y}, outside of the sensor of {}x{} pixels; give the size of the sensor that \
         fired it", .size.0, .size.1
    )]
    OutsideSensor {
        /// Index of the event.
        index: usize,
        /// Column.
        x: u16,
        /// Row.
        y: u16,
        /// Width and height.
        size: (u32, u32),
    },
    /// A polarity that is none.
    #[error("event {index} has polarity {polarity}; it must be 1 for ON, and 0 or -1 for OFF")]
    Polarity {
        /// Index of the event.
        index: usize,
        /// Its polarity.
        polarity: i16,
    },
    /// Events go back in time.
    #[error(
        "event {index} is at {t_us} us, after one at {before_us} us; sort the events by time, stably, so that simultaneous \
         events of a pixel keep their order"
    )]
    Unsorted {
        /// Index of the first event that is earlier than the one before it.
        index: usize,
        /// Its time.
        t_us: i64,
        /// Time of the event before it.
        before_us: i64,
    },
    /// A time that is too far from 0.
    #[error("event {index} is at {t_us} us; times must be within {} us of 0", evis_core::event::MOST_T_US)]
    Time {
        /// Index of the event.
        index: usize,
        /// Its time.
        t_us: i64,
    },
    /// The array would be too large.
    #[error("an array of {shape} values is too large: {reason}")]
    TooLarge {
        /// Its shape, as "5 x 720 x 1280".
        shape: String,
        /// What it would take, and what is allowed.
        reason: String,
    },
}

impl Error {
    /// An error about setting `what` with `value`; `remedy` completes "it must be …".
    pub(crate) fn setting(
        what: &'static str,
        value: impl std::fmt::Display,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Setting { what, value: value.to_string(), remedy: remedy.into() }
    }
}
