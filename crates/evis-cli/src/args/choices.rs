//! Words that options take.

use clap::ValueEnum;
use evis_core::closed_form::convergence::Variant;
use evis_core::{LabelKind, TriggerRule};
use evis_render::{Antialias, Between, Quality, Shadows};
use evis_truth::Lattice;

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum MethodArg {
    /// Instants are rendered.
    Native,
    /// Surfaces are followed in continuous time, on the CPU; each pixel is evaluated at its own times.
    Decoupled,
    /// Keyframes are rendered; what lies between is splatted from both.
    Splat,
    /// As the EVIS paper publishes it: linear motion, colours, latch, black holes.
    EvisPaper,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum QualityArg {
    /// A sample per pixel of motion, 16 coverage samples.
    Draft,
    /// A sample per half pixel of motion, 16 coverage samples.
    Standard,
    /// A sample per 0.3 pixels of motion, 144 coverage samples, shadow rays where the scene allows them.
    High,
    /// A sample per 0.15 pixels of motion, 256 coverage samples, shadow rays where the scene allows them.
    Reference,
}

impl From<QualityArg> for Quality {
    fn from(quality: QualityArg) -> Self {
        match quality {
            QualityArg::Draft => Self::Draft,
            QualityArg::Standard => Self::Standard,
            QualityArg::High => Self::High,
            QualityArg::Reference => Self::Reference,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum TriggerArg {
    /// Every threshold crossing, at its own time.
    Crossing,
    /// At most one event per pixel and sample, at the sample's time.
    Latch,
    /// Every crossing between two samples, counted from the first of them.
    Difference,
}

impl From<TriggerArg> for TriggerRule {
    fn from(arg: TriggerArg) -> Self {
        match arg {
            TriggerArg::Crossing => Self::Crossing,
            TriggerArg::Latch => Self::Latch,
            TriggerArg::Difference => Self::Difference,
        }
    }
}

/// Triggers that `verify` knows.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum VariantArg {
    /// Every crossing, by linear interpolation of log luminance.
    Crossing,
    /// At most one event per pixel and sample, at the sample's time.
    Latch,
}

impl From<VariantArg> for Variant {
    fn from(arg: VariantArg) -> Self {
        match arg {
            VariantArg::Crossing => Self::Crossing,
            VariantArg::Latch => Self::Latch,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum AntialiasArg {
    /// Visibility and shading at every sample.
    Samples,
    /// Visibility at every sample, shading at one in four.
    Edges,
}

impl From<AntialiasArg> for Antialias {
    fn from(arg: AntialiasArg) -> Self {
        match arg {
            AntialiasArg::Samples => Self::Samples,
            AntialiasArg::Edges => Self::Edges,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum BetweenArg {
    /// Straight.
    Line,
    /// Along a cubic that also goes by the sample before and the one after.
    Curve,
}

impl From<BetweenArg> for Between {
    fn from(arg: BetweenArg) -> Self {
        match arg {
            BetweenArg::Line => Self::Line,
            BetweenArg::Curve => Self::Curve,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum ShadowsArg {
    /// By maps fitted to the world.
    Maps,
    /// By rays along their borders.
    Rays,
}

impl From<ShadowsArg> for Shadows {
    fn from(arg: ShadowsArg) -> Self {
        match arg {
            ShadowsArg::Maps => Self::Maps,
            ShadowsArg::Rays => Self::Rays,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum LatticeArg {
    /// One family of samples.
    First,
    /// Another one, independent of it.
    Second,
}

impl From<LatticeArg> for Lattice {
    fn from(arg: LatticeArg) -> Self {
        match arg {
            LatticeArg::First => Self::First,
            LatticeArg::Second => Self::Second,
        }
    }
}

/// Tolerances that scores are made for.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum ToleranceArg {
    /// 0.1 ms, or 0.01 px of motion.
    #[value(name = "100us")]
    Us100,
    /// 0.3 ms, or 0.03 px of motion.
    #[value(name = "300us")]
    Us300,
    /// 1 ms, or 0.1 px of motion.
    #[value(name = "1ms")]
    Ms1,
}

impl ToleranceArg {
    /// In microseconds.
    pub(crate) const fn micros(self) -> i64 {
        match self {
            Self::Us100 => 100,
            Self::Us300 => 300,
            Self::Ms1 => 1000,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum LabelArg {
    /// Planar depth in metres.
    Depth,
    /// Optical flow, forward and backward, with masks.
    Flow,
    /// Instance ids.
    Instance,
    /// Semantic ids.
    Semantic,
    /// Surface normals in world axes.
    Normal,
    /// Linear RGB frames.
    Hdr,
    /// Why each event fired: signal, leak, shot noise or hot pixel; a column beside the events.
    Cause,
}

impl LabelArg {
    /// The label images that this word stands for.
    pub(crate) const fn kinds(self) -> &'static [LabelKind] {
        match self {
            Self::Depth => &[LabelKind::Depth],
            Self::Flow => &[
                LabelKind::FlowForward,
                LabelKind::FlowForwardValid,
                LabelKind::FlowBackward,
                LabelKind::FlowBackwardValid,
            ],
            Self::Instance => &[LabelKind::Instance],
            Self::Semantic => &[LabelKind::Semantic],
            Self::Normal => &[LabelKind::Normal],
            Self::Hdr => &[LabelKind::Hdr],
            Self::Cause => &[LabelKind::Cause],
        }
    }
}

/// Kinds of `labels` in file order, each once.
pub(crate) fn label_kinds(labels: &[LabelArg]) -> Vec<LabelKind> {
    let all = LabelKind::ALL.into_iter().chain([LabelKind::Cause]);
    all.filter(|kind| labels.iter().any(|l| l.kinds().contains(kind))).collect()
}

/// Background of the event picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Background {
    /// White; for paper.
    Light,
    /// Near black; for screens and slides.
    Dark,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flow_means_both_directions_and_their_masks() {
        assert_eq!(label_kinds(&[]), []);
        assert_eq!(
            label_kinds(&[LabelArg::Hdr, LabelArg::Flow, LabelArg::Hdr]),
            [
                LabelKind::FlowForward,
                LabelKind::FlowForwardValid,
                LabelKind::FlowBackward,
                LabelKind::FlowBackwardValid,
                LabelKind::Hdr
            ]
        );
    }
}
