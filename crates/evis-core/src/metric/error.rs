//! Why a score cannot be given; where two sides disagree, both are named.

/// Why a score cannot be given.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MetricError {
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
    /// Stream and truth come from sensors of different size.
    #[error(
        "the stream's sensor has {}x{} pixels, the truth's {}x{}; score a stream of the same camera and size",
        .stream[0], .stream[1], .truth[0], .truth[1]
    )]
    SensorSize {
        /// Width and height.
        stream: [u32; 2],
        /// Width and height.
        truth: [u32; 2],
    },
    /// Stream and truth were made with different sensors.
    #[error(
        "the stream was made with {what} = {stream}, the truth with {truth}; make one of them again with the other's"
    )]
    SensorSetting {
        /// Name of the setting.
        what: &'static str,
        /// Its value in the stream.
        stream: f32,
        /// Its value in the truth.
        truth: f32,
    },
    /// The truth knows no pixel, or none that fires.
    #[error(
        "the truth {lacks} (duration {duration_us} us, {pixels} pixels), the stream has {events} events; take a truth \
         of pixels that fire"
    )]
    EmptyTruth {
        /// What is missing, as "has no events".
        lacks: &'static str,
        /// Length of the truth in microseconds.
        duration_us: i64,
        /// Pixels of the truth.
        pixels: usize,
        /// Events of the stream.
        events: usize,
    },
    /// Events go back in time.
    #[error(
        "{side} is not sorted by time: event {index} at {t_us} us comes after one at {before_us} us; sort it by time \
         (stably, so that simultaneous events of a pixel keep their order)"
    )]
    Unsorted {
        /// "the stream" or "the truth".
        side: &'static str,
        /// Index of the first event that is earlier than the one before it.
        index: usize,
        /// Its time.
        t_us: i64,
        /// Time of the event before it.
        before_us: i64,
    },
    /// A polarity that is none.
    #[error("event {index} of {side} has polarity {polarity}; ON is 1, OFF is 0")]
    Polarity {
        /// "the stream" or "the truth".
        side: &'static str,
        /// Index of the event.
        index: usize,
        /// Its polarity.
        polarity: i16,
    },
    /// An event outside the sensor.
    #[error(
        "event {index} of {side} lies at x = {x}, y = {y}, outside the truth's sensor of {}x{} pixels; score a stream \
         of the same camera and size", .size[0], .size[1]
    )]
    OutsideSensor {
        /// "the stream" or "the truth".
        side: &'static str,
        /// Index of the event.
        index: usize,
        /// Column.
        x: u16,
        /// Row.
        y: u16,
        /// Width and height.
        size: [u32; 2],
    },
    /// A truth event outside the truth's interval.
    #[error(
        "event {index} of the truth is at {t_us} us, outside its interval [0, {duration_us}) us; truncate it"
    )]
    OutsideInterval {
        /// Index of the event.
        index: usize,
        /// Its time.
        t_us: i64,
        /// The truth's length.
        duration_us: i64,
    },
    /// A truth event at a pixel that the truth does not list.
    #[error(
        "event {index} of the truth lies at x = {x}, y = {y}, which is not among its {pixels} pixels; list it"
    )]
    UnknownPixel {
        /// Index of the event.
        index: usize,
        /// Column.
        x: u16,
        /// Row.
        y: u16,
        /// Pixels of the truth.
        pixels: usize,
    },
    /// Parts of a truth do not fit together.
    #[error("the truth contradicts itself: {0}")]
    Inconsistent(String),
    /// Images or flow fields that cannot be compared.
    #[error("{0}")]
    Image(String),
}
