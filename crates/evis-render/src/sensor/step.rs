//! Dispatches from luminance to events, one after the other.

use crate::gpu::commands::Commands;
use crate::pass::ComputePass;
use crate::sensor::chain::Walk;
use crate::sensor::group::Group;
use crate::sensor::targets::Targets;

/// One dispatch of the trigger.
pub struct TriggerStep<'a> {
    /// What runs.
    pub pipeline: &'a wgpu::ComputePipeline,
    /// What it reads and writes.
    pub bindings: wgpu::BindGroup,
    /// How many, along each axis.
    pub workgroups: (u32, u32, u32),
}

impl<'a> TriggerStep<'a> {
    /// `pass` over all pixels of `group`.
    pub fn over_pixels(
        pass: &'a ComputePass,
        bindings: wgpu::BindGroup,
        targets: &Targets,
        group: &Group,
    ) -> Self {
        let workgroups = Walk::Count.workgroups([targets.width, targets.height], group.views.len() as u32);
        Self { pipeline: &pass.pipeline, bindings, workgroups }
    }
}

/// Records `steps` in order.
pub fn encode_trigger(encoder: &mut Commands, steps: &[TriggerStep<'_>]) {
    let mut pass = encoder.compute("trigger");
    for step in steps {
        pass.dispatch(step.pipeline, &step.bindings, &[], step.workgroups);
    }
}
