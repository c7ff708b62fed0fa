//! Frames of light in the place of light: an exposure under way is a sum per pixel, and a frame when it ends.

use super::frames::{BLOCK, Source, TILE};
use super::workers::Threads;

/// What an environment whose pixels see frames remembers of light, `Y / Y_ref`.
#[derive(Clone, Debug)]
pub(crate) struct Exposing {
    /// When its first light came, since the start or the last reset: exposures that begin earlier are not made.
    pub since_us: Option<i64>,
    /// Light at the last sample; NaN where unknown.
    pub last: Vec<f32>,
    /// Light at the sample that is being pushed.
    pub next: Vec<f32>,
    /// Of the exposure under way, the part that is over: the integral of light by its weight. NaN where light was unknown,
    /// at however short a part of it.
    pub sum: Vec<f64>,
    pub frame: Vec<f32>,
}

impl Exposing {
    pub fn new(pixels: usize) -> Self {
        Self {
            since_us: None,
            last: vec![0.0; pixels],
            next: vec![0.0; pixels],
            sum: vec![0.0; pixels],
            frame: vec![0.0; pixels],
        }
    }

    /// Reads the sample that is being pushed, and says whether it is light: nothing that outlives a push changes.
    pub fn load(&mut self, threads: Threads<'_>, source: &Source<'_>, eps: f32) -> bool {
        let mut parts: Vec<_> = self.next.chunks_mut(TILE).map(|next| (next, true)).enumerate().collect();
        threads.each(&mut parts, |(index, (next, is_light))| {
            for (block, next) in next.chunks_mut(BLOCK).enumerate() {
                let mut light = [f32::NAN; BLOCK];
                source.load_light(*index * TILE + block * BLOCK, eps, &mut light);
                let own = &light[..next.len()];
                *is_light &= !own.iter().any(|light| *light < 0.0 || *light > f32::MAX);
                next.copy_from_slice(own);
            }
        });
        parts.iter().all(|(_, (_, is_light))| *is_light)
    }

    /// Adds `[before, after]` of the last and the next light to the exposure under way; where that ends, its frame is made.
    pub fn add(&mut self, threads: Threads<'_>, [before, after]: [f64; 2], ends: bool) {
        let samples = self.last.chunks(TILE).zip(self.next.chunks(TILE));
        let sums = self.sum.chunks_mut(TILE).zip(self.frame.chunks_mut(TILE));
        let mut parts: Vec<_> = samples.zip(sums).collect();
        threads.each(&mut parts, |((last, next), (sum, frame))| {
            for ((sum, last), next) in sum.iter_mut().zip(*last).zip(*next) {
                *sum += before * f64::from(*last) + after * f64::from(*next);
            }
            if ends {
                for (frame, sum) in frame.iter_mut().zip(sum.iter_mut()) {
                    *frame = std::mem::take(sum) as f32;
                }
            }
        });
    }
}
