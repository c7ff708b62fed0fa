//! What is kept of a keyframe until the next one comes.

/// An environment's last keyframe.
#[derive(Clone, Debug, Default)]
pub(crate) struct Keyframe {
    /// Pixels beyond each border.
    pub margin: u32,
    /// Since the one before it; 0: there was none, so that `back` says nothing.
    pub gap_us: i64,
    pub light: Vec<f32>,
    pub nearness: Vec<f32>,
    pub back: Vec<[f32; 2]>,
    /// Empty where it was not given.
    pub forward: Vec<[f32; 2]>,
}
