//! How an instant is sampled: a method fills the luminance layers of the instants, and the trigger knows nothing of it.

pub mod adaptive;
pub mod audit;
pub mod clipped;
pub mod clusters;
pub mod coverage;
pub mod draw_list;
pub mod keyframes;
pub mod native;
pub mod needs;
pub mod shadow_rate;
pub mod splat;
pub mod tile_rate;
pub mod view_motion;

use crate::gpu::commands::Commands;
use crate::raster::context::Context;
use crate::sampling::adaptive::AdaptiveSampler;
use crate::sampling::audit::AuditRun;
use crate::sampling::clipped::ClippedRun;
use crate::sampling::native::NativeSampler;
use crate::sampling::splat::SplatSampler;
use crate::sensor::group::{Group, Unit};
use crate::sensor::targets::Targets;

/// What fills the luminance layers, by method.
pub enum Sampling {
    /// Every instant is rendered, a layer per sample.
    Native(NativeSampler),
    /// The same, each tile of a picture as often as what it shows moves.
    Adaptive(Box<AdaptiveSampler>),
    /// Keyframes are rendered, and what lies between is splatted.
    Splat(Box<SplatSampler>),
}

/// What a submission brings back of its sampling, beside luminance.
#[derive(Default)]
pub struct Readbacks {
    /// Audits of what was skipped.
    pub audit: Option<AuditRun>,
    /// Light of keyframes that was clipped.
    pub clipped: Option<ClippedRun>,
}

impl Sampling {
    /// Records what makes the luminance of every view of `group` at every instant of `unit`: instant k of view v, sample
    /// s, in layer `(v * instants + k) * samples + s`.
    pub fn encode(
        &mut self,
        context: &mut Context,
        encoder: &mut Commands,
        targets: &Targets,
        group: &Group,
        unit: &Unit,
    ) -> Readbacks {
        let mut readbacks = Readbacks::default();
        match self {
            Self::Native(sampler) => sampler.encode(context, encoder, targets, group, unit),
            Self::Adaptive(sampler) => {
                readbacks.audit = sampler.encode(context, encoder, targets, group, unit);
            }
            Self::Splat(sampler) => {
                readbacks.clipped = sampler.encode(context, encoder, targets, group, unit);
            }
        }
        readbacks
    }

    /// Forgets what was shown. In adaptive time, only the tiles `only` of each view are rendered from now on; with
    /// `every_instant` at every instant.
    pub fn restart(&mut self, only: Vec<Vec<bool>>, every_instant: bool) {
        match self {
            Self::Native(sampler) => *sampler = NativeSampler::default(),
            Self::Adaptive(sampler) => sampler.restart(only, every_instant),
            // Keyframes are kept by their numbers: such a stream is never restarted.
            Self::Splat(_) => {}
        }
    }

    /// Pixels drawn since this was last asked, each by all of its samples.
    pub fn take_drawn_pixels(&mut self) -> u64 {
        match self {
            Self::Native(sampler) => std::mem::take(&mut sampler.drawn_pixels),
            Self::Adaptive(sampler) => sampler.take_drawn_pixels(),
            Self::Splat(sampler) => sampler.take_drawn_pixels(),
        }
    }

    /// Keyframes drawn since this was last asked.
    pub fn take_keyframes(&mut self) -> u64 {
        match self {
            Self::Native(_) | Self::Adaptive(_) => 0,
            Self::Splat(sampler) => sampler.take_keyframes(),
        }
    }
}
