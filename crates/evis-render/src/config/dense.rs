//! Dense arrays of events that packets carry in the place of events.

use evis_core::ConfigError;
use evis_representation::{Decay, Polarities};

/// The shortest and the longest window, in microseconds.
const SHORTEST_US: i64 = 1000;
const LONGEST_US: i64 = 60_000_000;

/// Bins of a voxel grid, at most.
const MOST_BINS: u32 = 256;

/// Which array is made of the events of each window of time, and how long windows are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DenseOutput {
    /// The array.
    pub kind: DenseKind,
    /// Length of a window in microseconds; windows begin at multiples of it, in stream time.
    pub window_us: i64,
}

/// An array of `evis_representation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DenseKind {
    /// [`evis_representation::event_frame`].
    EventFrame,
    /// [`evis_representation::counts`].
    Counts,
    /// [`evis_representation::voxel_grid`], from the start of the window to its end.
    VoxelGrid {
        /// Bins.
        bins: u32,
        /// Whether each polarity has a grid of its own.
        polarities: Polarities,
        /// Whether values that are not 0 are brought to mean 0 and variance 1.
        normalize: bool,
    },
    /// [`evis_representation::time_surfaces`] at the end of the window, of the events in it.
    TimeSurface {
        /// Time constant in microseconds.
        tau_us: f64,
        /// How values fall with age.
        decay: Decay,
    },
}

impl DenseKind {
    /// Axes in front of rows and columns.
    pub fn planes(&self) -> Vec<usize> {
        match *self {
            Self::EventFrame => Vec::new(),
            Self::Counts | Self::TimeSurface { .. } => vec![2],
            Self::VoxelGrid { bins, polarities: Polarities::Signed, .. } => vec![bins as usize],
            Self::VoxelGrid { bins, polarities: Polarities::Split, .. } => vec![2, bins as usize],
        }
    }
}

impl DenseOutput {
    /// Checks its numbers.
    ///
    /// # Errors
    /// Names the one that cannot be used.
    pub fn check(&self) -> Result<(), ConfigError> {
        if !(SHORTEST_US..=LONGEST_US).contains(&self.window_us) {
            let remedy = format!("between {SHORTEST_US} and {LONGEST_US} microseconds");
            return Err(ConfigError::new("dense_window_us", self.window_us, remedy));
        }
        match self.kind {
            DenseKind::VoxelGrid { bins, .. } if !(1..=MOST_BINS).contains(&bins) => {
                Err(ConfigError::new("bins", bins, format!("between 1 and {MOST_BINS}")))
            }
            DenseKind::TimeSurface { tau_us, .. } if !(tau_us.is_finite() && tau_us > 0.0) => {
                Err(ConfigError::new("tau_us", tau_us, "a finite number of microseconds above 0"))
            }
            _ => Ok(()),
        }
    }

    /// Index of the window that `t_us` lies in.
    pub const fn window_of(&self, t_us: i64) -> i64 {
        t_us.div_euclid(self.window_us)
    }

    /// First microsecond of window `index`, and one past its last.
    pub const fn interval(&self, index: i64) -> (i64, i64) {
        (index * self.window_us, (index + 1) * self.window_us)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_is_named() {
        let of = |kind, window_us| DenseOutput { kind, window_us }.check().map_err(|e| e.what);
        let grid = |bins| DenseKind::VoxelGrid { bins, polarities: Polarities::Signed, normalize: false };
        let surface = |tau_us| DenseKind::TimeSurface { tau_us, decay: Decay::Linear };
        assert_eq!(of(DenseKind::Counts, 1000), Ok(()));
        assert_eq!(of(DenseKind::Counts, 999), Err("dense_window_us".into()));
        assert_eq!(of(DenseKind::Counts, LONGEST_US + 1), Err("dense_window_us".into()));
        assert_eq!(of(grid(0), 1000), Err("bins".into()));
        assert_eq!(of(grid(257), 1000), Err("bins".into()));
        assert_eq!(of(surface(0.0), 1000), Err("tau_us".into()));
        assert_eq!(of(surface(f64::NAN), 1000), Err("tau_us".into()));
    }

    #[test]
    fn windows_begin_at_multiples_of_their_length() {
        let output = DenseOutput { kind: DenseKind::Counts, window_us: 5000 };
        assert_eq!([0, 4999, 5000, -1].map(|t| output.window_of(t)), [0, 0, 1, -1]);
        assert_eq!(output.interval(3), (15_000, 20_000));
    }
}
