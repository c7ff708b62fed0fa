//! How an instant is sampled: a method fills the luminance layers of the instants, and the trigger knows nothing of it.

pub mod adaptive;
pub mod audit;
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
use crate::sampling::adaptive::AdaptiveRoom;
use crate::sampling::audit::AuditRun;
use crate::sampling::native::NativeRoom;
use crate::sampling::splat::SplatRoom;
use crate::sensor::group::{Group, Unit};
use crate::sensor::targets::Targets;

/// The room between scene and trigger, by method.
pub enum Sampling {
    /// Every instant is rendered, a layer per sample.
    Native(NativeRoom),
    /// The same, each tile of a picture as often as what it shows moves.
    Adaptive(Box<AdaptiveRoom>),
    /// Keyframes are rendered, and what lies between is splatted.
    Splat(Box<SplatRoom>),
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
    ) -> Option<AuditRun> {
        match self {
            Self::Native(room) => room.encode(context, encoder, targets, group, unit),
            Self::Adaptive(room) => return room.encode(context, encoder, targets, group, unit),
            Self::Splat(room) => room.encode(context, encoder, targets, group, unit),
        }
        None
    }

    /// Forgets what was shown. In adaptive time, only the tiles `only` of each view are rendered from now on; with
    /// `every_instant` at every instant.
    pub fn restart(&mut self, only: Vec<Vec<bool>>, every_instant: bool) {
        match self {
            Self::Native(room) => *room = NativeRoom::default(),
            Self::Adaptive(room) => room.restart(only, every_instant),
            // Keyframes are kept by their numbers: such a stream is never restarted.
            Self::Splat(_) => {}
        }
    }

    /// Pixels drawn since this was last asked, each by all of its samples.
    pub fn take_drawn_pixels(&mut self) -> u64 {
        match self {
            Self::Native(room) => std::mem::take(&mut room.drawn_pixels),
            Self::Adaptive(room) => room.take_drawn_pixels(),
            Self::Splat(room) => room.take_drawn_pixels(),
        }
    }

    /// Keyframes drawn since this was last asked.
    pub fn take_keyframes(&mut self) -> u64 {
        match self {
            Self::Native(_) | Self::Adaptive(_) => 0,
            Self::Splat(room) => room.take_keyframes(),
        }
    }
}
