//! How an instant is sampled: a method fills the luminance layers of the instants, and the trigger knows nothing of it.

use crate::engine::Context;
use crate::interval::{Group, Unit, encode_luminance};
use crate::splat::SplatRoom;
use crate::targets::Targets;
use crate::view::View;

/// The room between scene and trigger, by method.
pub enum Sampling {
    /// Every instant is rendered, a layer per sample.
    Native,
    /// Keyframes are rendered, and what lies between is splatted.
    Splat(Box<SplatRoom>),
}

impl Sampling {
    /// Records what makes the luminance of every view of `group` at every instant of `unit`: instant k of view v, sample
    /// s, in layer `(v * instants + k) * samples + s`.
    pub fn encode(
        &mut self,
        context: &mut Context,
        encoder: &mut wgpu::CommandEncoder,
        targets: &Targets,
        group: &Group,
        unit: &Unit,
    ) {
        match self {
            Self::Native => render(context, encoder, targets, group, unit),
            Self::Splat(room) => room.encode(context, encoder, targets, group, unit),
        }
    }

    /// Keyframes drawn since this was last asked.
    pub fn take_keyframes(&mut self) -> u64 {
        match self {
            Self::Native => 0,
            Self::Splat(room) => room.take_drawn(),
        }
    }
}

/// `native`: every instant of every view, sample by sample.
fn render(
    context: &mut Context,
    encoder: &mut wgpu::CommandEncoder,
    targets: &Targets,
    group: &Group,
    unit: &Unit,
) {
    let views: Vec<View> = group.views.iter().map(|&v| context.views[v].clone()).collect();
    let times: Vec<i64> =
        (0..unit.instants).map(|k| context.grid.instant_us(unit.first + i64::from(k))).collect();
    // Where everything is, at every instant.
    let frame_group = context.upload_frames(&views, &times);
    let samples = context.offsets.len() as u32;
    for k in 0..unit.instants {
        // What the lights see, where casters or lights move.
        context.encode_moving_shadows(encoder, &frame_group, &views, unit.instants, k);
        // What the cameras see, one luminance layer per sample.
        for view in 0..views.len() as u32 {
            let frame = view * unit.instants + k;
            encode_luminance(context, encoder, &targets.layers, &frame_group, frame, frame * samples);
        }
    }
}
