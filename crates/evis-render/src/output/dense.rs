//! Dense arrays of the events of windows of time, as packets carry them.

use evis_core::Event;
use evis_representation::{
    Array, Error, Slice, counts, event_frame, normalize_nonzero, time_surfaces, voxel_grid,
};

use crate::config::dense::{DenseKind, DenseOutput};
use crate::error::EngineError;
use crate::output::packet::{DenseValues, DenseWindow, Packet};

/// What a device made of a view's events in window `index`: see `trigger/dense.wgsl`.
pub fn of_words(output: &DenseOutput, index: i64, words: &[u32], (width, height): (u32, u32)) -> DenseWindow {
    let (start_us, end_us) = output.interval(index);
    let mut shape = output.kind.planes();
    shape.extend([height as usize, width as usize]);
    let values = match output.kind {
        DenseKind::EventFrame => {
            let (off, on) = words.split_at(words.len() / 2);
            let data = on.iter().zip(off).map(|(on, off)| on.wrapping_sub(*off) as i32).collect();
            DenseValues::I32(Array { shape, data })
        }
        DenseKind::Counts => {
            DenseValues::I32(Array { shape, data: words.iter().map(|word| *word as i32).collect() })
        }
        DenseKind::VoxelGrid { normalize, .. } => {
            let mut data: Vec<f32> = words.iter().copied().map(f32::from_bits).collect();
            if normalize {
                normalize_nonzero(&mut data);
            }
            DenseValues::F32(Array { shape, data })
        }
        DenseKind::TimeSurface { tau_us, decay } => {
            let value = |word: &u32| match word {
                0 => 0.0,
                // The place of the microsecond in the window, and one.
                since => decay.value((output.window_us - i64::from(since - 1)) as f64, tau_us) as f32,
            };
            DenseValues::F32(Array { shape, data: words.iter().map(value).collect() })
        }
    };
    DenseWindow { start_us, end_us, values }
}

/// The array of sorted `events`, as far as they lie in window `index`.
fn of_events(
    output: &DenseOutput,
    index: i64,
    events: &[Event],
    size: (u32, u32),
) -> Result<DenseWindow, Error> {
    let (start_us, end_us) = output.interval(index);
    let slice = Slice::new(events, size)?.between_sorted(Some(start_us), Some(end_us))?;
    let values = match output.kind {
        DenseKind::EventFrame => DenseValues::I32(event_frame(&slice)?),
        DenseKind::Counts => DenseValues::I32(counts(&slice)?),
        DenseKind::VoxelGrid { bins, polarities, normalize } => {
            let mut grid = voxel_grid(&slice, bins as usize, polarities)?;
            if normalize {
                normalize_nonzero(&mut grid.data);
            }
            DenseValues::F32(grid)
        }
        DenseKind::TimeSurface { tau_us, decay } => {
            let mut surface = time_surfaces(&slice, &[end_us], tau_us, decay)?;
            // Of one time.
            surface.shape.remove(0);
            DenseValues::F32(surface)
        }
    };
    Ok(DenseWindow { start_us, end_us, values })
}

/// Makes arrays of the events of packets, where no device did.
pub struct HostArrays {
    output: DenseOutput,
    /// Size of each view.
    sizes: Vec<(u32, u32)>,
    /// Per view: events of the window that has begun.
    waiting: Vec<Vec<Event>>,
}

impl HostArrays {
    /// For views of `sizes`.
    pub fn new(output: DenseOutput, sizes: Vec<(u32, u32)>) -> Self {
        Self { output, waiting: vec![Vec::new(); sizes.len()], sizes }
    }

    /// Puts the arrays of the windows that end in `packet` in the place of its events.
    ///
    /// # Errors
    /// Arrays larger than memory.
    pub fn replace_events(&mut self, packet: &mut Packet) -> Result<(), EngineError> {
        let windows = self.output.window_of(packet.start_us)..self.output.window_of(packet.end_us);
        for ((view, waiting), size) in packet.views.iter_mut().zip(&mut self.waiting).zip(&self.sizes) {
            if view.dense.is_some() {
                continue;
            }
            waiting.append(&mut view.events);
            let made = windows.clone().map(|window| of_events(&self.output, window, waiting, *size));
            let made = made.collect::<Result<Vec<_>, _>>();
            view.dense = Some(made.map_err(|error| EngineError::Device(error.to_string()))?);
            let (begun_us, _) = self.output.interval(windows.end);
            waiting.drain(..waiting.partition_point(|event| event.t < begun_us));
        }
        Ok(())
    }
}
