//! Dense arrays of events, as networks take them: frames, counts, voxel grids, time surfaces and others, and the windows of
//! time that they are made of.
//!
//! Each function takes a [`Slice`]: events of one sensor, sorted by time, and the interval that they are seen in. It checks
//! every event that it reads, so that wrong coordinates, polarities and times end in an [`Error`] that names the event.
//! What is between `[start_us, end_us)` counts; where no interval is given, all events do.
//!
//! All arrays are row-major. Polarities are planes of their own, OFF first: plane `p` holds the events of polarity `p`.
//!
//! ```
//! use evis_core::{Event, Polarity};
//! use evis_representation::{Polarities, Slice, voxel_grid};
//!
//! let events = [Event::new(0, 1, 0, Polarity::On), Event::new(100, 2, 0, Polarity::Off)];
//! let grid = voxel_grid(&Slice::new(&events, (4, 3))?, 5, Polarities::Signed)?;
//! assert_eq!(grid.shape, [5, 3, 4]);
//! assert_eq!((grid.data[1], grid.data[4 * 12 + 2]), (1.0, -1.0));
//! # Ok::<(), evis_representation::Error>(())
//! ```

mod array;
mod averaged_timestamps;
mod binary_stack;
mod counts;
mod error;
mod event_frame;
mod event_spike_tensor;
mod scatter;
mod slice;
mod time_surface;
mod voxel_grid;
pub mod windows;

pub use array::Array;
pub use averaged_timestamps::averaged_timestamps;
pub use binary_stack::{MOST_BITS, bina_rep, binary_stack};
pub use counts::counts;
pub use error::Error;
pub use event_frame::event_frame;
pub use event_spike_tensor::{Measure, event_spike_tensor};
pub use slice::Slice;
pub use time_surface::{Decay, time_surfaces};
pub use voxel_grid::{Polarities, normalize_nonzero, voxel_grid};
pub use windows::Window;
