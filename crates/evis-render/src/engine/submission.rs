//! One submission: some instants of a group of views, from poses to events in a staging buffer.

use crate::gpu::commands::Commands;
use crate::gpu::uniforms::Status;
use crate::raster::context::Context;
use crate::sampling::{Readbacks, Sampling};
use crate::sensor::dense::DenseArrays;
use crate::sensor::group::{Group, Slot, Unit};
use crate::sensor::passes::TriggerPasses;
use crate::sensor::step::encode_trigger;
use crate::sensor::targets::Targets;
use crate::sensor::trigger::{clear_tallies, trigger_steps};

/// Records one interval: the table of contents of a submission.
#[expect(clippy::too_many_arguments, reason = "what an interval is recorded from, in order")]
pub fn encode(
    context: &mut Context,
    passes: &TriggerPasses,
    sampling: &mut Sampling,
    encoder: &mut Commands,
    targets: &Targets,
    group: &Group,
    unit: &Unit,
    slot: &Slot,
    dense: Option<&mut DenseArrays>,
    predicted: u32,
) -> Readbacks {
    // Luminance of every pixel at every instant, by whatever method.
    let readbacks = tracing::trace_span!("sampling", instants = unit.instants)
        .in_scope(|| sampling.encode(context, encoder, targets, group, unit));
    // Events of it, or arrays of them.
    let steps = trigger_steps(&context.gpu, passes, &context.grid, targets, group, unit, slot, dense);
    clear_tallies(encoder, group);
    encode_trigger(encoder, &steps);
    // Counts, offsets and events to the host.
    let header = size_of::<Status>() as u64;
    encoder.copy_buffer_to_buffer(&group.status, 0, &slot.staging, 0, header);
    let offsets = 4 * (group.views.len() as u64 + 1);
    encoder.copy_buffer_to_buffer(&group.view_offsets, 0, &slot.staging, header, offsets);
    let bytes = u64::from(predicted.min(slot.capacity)) * 8;
    encoder.copy_buffer_to_buffer(&slot.events, 0, &slot.staging, group.header_bytes(), bytes);
    readbacks
}
