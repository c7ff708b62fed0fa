//! The dispatches that make events of luminance layers: count, prefixes of blocks, scan, emit.

use crate::config::grid::SampleGrid;
use crate::gpu::Gpu;
use crate::gpu::commands::Commands;
use crate::gpu::sizes::{self, BLOCK_PIXELS, WORKGROUP, row_stride};
use crate::gpu::uniforms::{ScanParams, Status};
use crate::pass::trigger::{
    BLOCK_BINDINGS, CHAIN_BINDINGS, COUNT_BINDINGS, EMIT_BINDINGS, KEPT_BINDINGS, SCAN_BINDINGS,
};
use crate::pass::{self, ComputePass};
use crate::sensor::chain::{ChainPasses, Walk};
use crate::sensor::dense::DenseArrays;
use crate::sensor::group::{Group, Slot, Times, Unit};
use crate::sensor::passes::{TriggerPasses, WalkPasses};
use crate::sensor::step::TriggerStep;
use crate::sensor::targets::Targets;

/// Clears what pixels of a chain report: no events, and none active yet.
pub fn clear_tallies(encoder: &mut Commands, group: &Group) {
    if group.chain.is_some() {
        encoder.clear_buffer(&group.status, size_of::<Status>() as u64, None);
    }
}

/// Count, prefix, scan, emit; dense arrays in the place of events where `dense` makes them of the group.
#[expect(clippy::too_many_arguments, reason = "what the passes read and write")]
pub fn trigger_steps<'a>(
    gpu: &Gpu,
    passes: &'a TriggerPasses,
    grid: &SampleGrid,
    targets: &Targets,
    group: &Group,
    unit: &Unit,
    slot: &Slot,
    dense: Option<&mut DenseArrays>,
) -> Vec<TriggerStep<'a>> {
    let times = unit.times(grid, group.begins(unit));
    steps_at(gpu, passes, &times, targets, (group, unit.group), slot, dense)
}

/// The same at any times; the group and its index.
pub fn steps_at<'a>(
    gpu: &Gpu,
    passes: &'a TriggerPasses,
    times: &Times,
    targets: &Targets,
    (group, index): (&Group, usize),
    slot: &Slot,
    dense: Option<&mut DenseArrays>,
) -> Vec<TriggerStep<'a>> {
    let dense = dense.filter(|own| own.makes(index));
    let (device, queue) = (&gpu.device, &gpu.queue);
    let views = group.views.len() as u32;
    let stride = row_stride(targets.width);
    let blocks_per_view = stride / BLOCK_PIXELS * targets.height;
    let params = times.params(targets, views, slot.capacity);
    queue.write_buffer(&slot.params, 0, bytemuck::bytes_of(&params));
    let scan = ScanParams {
        block_count: blocks_per_view * views,
        blocks_per_view,
        view_count: views,
        // Where arrays are made as pixels fire, there is no list that events must fit.
        event_capacity: if dense.is_some() && group.chain.is_none() { u32::MAX } else { slot.capacity },
    };
    queue.write_buffer(&slot.scan_params, 0, bytemuck::bytes_of(&scan));

    let (counting, emitting) = match &*passes.walks[group.targets] {
        WalkPasses::Host => (Vec::new(), Vec::new()),
        WalkPasses::Ideal { count, emit } => ideal_walks(device, (count, emit), targets, group, slot),
        WalkPasses::Chain(chain) => chain_walks(device, chain, targets, group, times, slot),
    };
    let block = pass::group(
        device,
        "block",
        &passes.block.layout,
        BLOCK_BINDINGS,
        vec![
            group.block_params.as_entire_binding(),
            targets.counts.as_entire_binding(),
            targets.prefixes.as_entire_binding(),
            targets.block_sums.as_entire_binding(),
        ],
    );
    let scan = pass::group(
        device,
        "scan",
        &passes.scan.layout,
        SCAN_BINDINGS,
        vec![
            slot.scan_params.as_entire_binding(),
            targets.block_sums.as_entire_binding(),
            group.view_offsets.as_entire_binding(),
            group.status.as_entire_binding(),
        ],
    );
    let (block_x, block_y) = sizes::dispatch(blocks_per_view * views, WORKGROUP);
    let mut steps = counting;
    steps.push(TriggerStep {
        pipeline: &passes.block.pipeline,
        bindings: block,
        workgroups: (block_x, block_y, 1),
    });
    steps.push(TriggerStep { pipeline: &passes.scan.pipeline, bindings: scan, workgroups: (1, 1, 1) });
    let Some(own) = dense else {
        steps.extend(emitting);
        return steps;
    };
    if group.chain.is_some() {
        steps.extend(emitting);
    }
    steps.extend(own.steps(gpu, passes, times, targets, (group, index), slot));
    steps
}

/// Steps that count, and steps that emit.
type Walks<'a> = (Vec<TriggerStep<'a>>, Vec<TriggerStep<'a>>);

/// Count and emit of thresholds alone.
fn ideal_walks<'a>(
    device: &wgpu::Device,
    (count, emit): (&'a ComputePass, &'a ComputePass),
    targets: &Targets,
    group: &Group,
    slot: &Slot,
) -> Walks<'a> {
    let (old, new) = (&group.memory[group.parity], &group.memory[1 - group.parity]);
    let texture = wgpu::BindingResource::TextureView;
    let counting = pass::group(
        device,
        "count",
        &count.layout,
        COUNT_BINDINGS,
        vec![
            slot.params.as_entire_binding(),
            texture(&group.sensors),
            texture(&targets.layers.array),
            texture(old),
            texture(new),
            targets.counts.as_entire_binding(),
            group.status.as_entire_binding(),
            texture(&targets.means),
            texture(&targets.tile_rates_view),
        ],
    );
    let emitting = pass::group(
        device,
        "emit",
        &emit.layout,
        EMIT_BINDINGS,
        vec![
            slot.params.as_entire_binding(),
            texture(&group.sensors),
            texture(targets.mean_layers()),
            texture(old),
            texture(new),
            targets.prefixes.as_entire_binding(),
            targets.block_sums.as_entire_binding(),
            group.status.as_entire_binding(),
            slot.events.as_entire_binding(),
            texture(&targets.tile_rates_view),
        ],
    );
    let walk = |pass, bindings| vec![TriggerStep::over_pixels(pass, bindings, targets, group)];
    (walk(count, counting), walk(emit, emitting))
}

/// Count and emit of the whole chain. An instant at which pixels begin is a unit of its own: nothing fires there.
fn chain_walks<'a>(
    device: &wgpu::Device,
    chain: &'a ChainPasses,
    targets: &Targets,
    group: &Group,
    times: &Times,
    slot: &Slot,
) -> Walks<'a> {
    let (old, new) = (&group.memory[group.parity], &group.memory[1 - group.parity]);
    // Both have what a chain needs where there is one.
    let (Some(own), Some(shared)) = (&group.chain, &targets.chain) else { return (Vec::new(), Vec::new()) };
    let feed = slot.feed.as_ref().unwrap_or(&own.views);
    let size = [targets.width, targets.height];
    let walk = |pass: &'a ComputePass, walk: Walk| {
        let bindings = pass::group(
            device,
            "chain",
            &pass.layout,
            CHAIN_BINDINGS,
            vec![
                slot.params.as_entire_binding(),
                chain.step(walk),
                chain.sensor(),
                wgpu::BindingResource::TextureView(&targets.layers.array),
                own.views.as_entire_binding(),
                feed.as_entire_binding(),
                wgpu::BindingResource::TextureView(old),
                wgpu::BindingResource::TextureView(new),
                // The emitting walk finds its counts in their prefixes: one binding less.
                if walk == Walk::Emit { &targets.prefixes } else { &targets.counts }.as_entire_binding(),
                targets.block_sums.as_entire_binding(),
                group.status.as_entire_binding(),
                slot.events.as_entire_binding(),
                wgpu::BindingResource::TextureView(&targets.tile_rates_view),
                shared.kept.as_entire_binding(),
                shared.lists.as_entire_binding(),
                wgpu::BindingResource::TextureView(&own.frozen),
            ],
        );
        let workgroups = walk.workgroups(size, group.views.len() as u32);
        TriggerStep { pipeline: &pass.pipeline, bindings, workgroups }
    };
    let counting = if times.begins {
        vec![walk(&chain.begin, Walk::Count)]
    } else {
        chain.counting(times.ends_us.len() as u32).into_iter().map(|step| walk(&chain.walk, step)).collect()
    };
    let copying = pass::group(
        device,
        "kept events",
        &chain.emit.layout,
        KEPT_BINDINGS,
        vec![
            slot.params.as_entire_binding(),
            targets.counts.as_entire_binding(),
            targets.prefixes.as_entire_binding(),
            targets.block_sums.as_entire_binding(),
            group.status.as_entire_binding(),
            shared.kept.as_entire_binding(),
            slot.events.as_entire_binding(),
        ],
    );
    let emitting =
        vec![TriggerStep::over_pixels(&chain.emit, copying, targets, group), walk(&chain.walk, Walk::Emit)];
    (counting, emitting)
}
