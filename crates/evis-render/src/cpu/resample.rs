//! Twin of `resample/samples.wgsl` and `resample/coverage.wgsl`.

use crate::world::distorted::Footprints;

/// The pixels of a camera with a distorted lens; `luminance(x, y, index)` is a sample of the picture without distortion.
pub fn resample(
    footprints: &Footprints,
    edge_bits: u32,
    luminance: impl Fn(u32, u32, u32) -> f32,
) -> Vec<f32> {
    let mask = (1 << edge_bits) - 1;
    let mean = |range: &[u32]| {
        footprints.entries[range[0] as usize..range[1] as usize].iter().fold(0.0, |sum, [texel, weight]| {
            let (x, y, index) = (texel & mask, texel >> edge_bits & mask, texel >> (2 * edge_bits));
            sum + luminance(x, y, index) * f32::from_bits(*weight)
        })
    };
    footprints.starts.windows(2).map(mean).collect()
}
