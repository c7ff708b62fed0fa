//! Submissions that had more events than their buffers hold are run again.

use std::collections::VecDeque;

use super::{Engine, Work};
use crate::error::EngineError;
use crate::gpu::uniforms::Status;
use crate::sensor::group::Unit;

impl Engine {
    /// A submission had more events than its buffer holds: nothing was written by it nor by those of its group
    /// that followed. Enlarges the buffers, or splits the submission, and runs them again.
    pub(super) fn recover(&mut self, unit: Unit, needed: u32) -> Result<(), EngineError> {
        let mut again = vec![unit];
        let mut others = VecDeque::new();
        for flight in std::mem::take(&mut self.in_flight) {
            match &flight.work {
                Work::Events { unit: later, slot, .. } if later.group == unit.group => {
                    self.wait(&flight)?;
                    slot.staging.unmap();
                    again.push(*later);
                }
                _ => others.push_back(flight),
            }
        }
        self.in_flight = others;
        self.report.reruns += again.len() as u64;
        if needed > self.most_capacity {
            let Some(halves) = unit.halves(self.block) else {
                return Err(EngineError::Device(format!(
                    "{needed} events in one instant, and this device's buffers hold {}; raise `rate_hz` or the \
                     thresholds, or render fewer cameras at once",
                    self.most_capacity
                )));
            };
            again.splice(0..1, halves);
        } else {
            self.capacity = needed.saturating_add(needed / 4).next_power_of_two().min(self.most_capacity);
        }
        let group = &mut self.groups[unit.group];
        // Every submission flipped it, and none took effect.
        let flips = again.len() - usize::from(needed > self.most_capacity);
        group.parity = (group.parity + flips) % 2;
        group.next = unit.first;
        group.clamped = 0;
        group.unknown = 0;
        group.suppressed = 0;
        self.context.gpu.queue.write_buffer(&group.status, 0, bytemuck::bytes_of(&Status::default()));
        for unit in again {
            self.submit_unit(unit)?;
        }
        // The queue of flights is in submission order again, and the oldest of this group is first of its kind.
        Ok(())
    }
}
