//! Light of keyframes that is brighter than `evis-paper` counts: `splat/prepare.wgsl` counts such pixels where a keyframe is
//! drawn, and submissions bring the counts back.

use serde::Serialize;

/// Bytes from one keyframe's count to the next: every device can bind storage at multiples of so many.
pub const CLIPPED_STRIDE: u64 = 256;

/// Bytes of a count: pixels, and bits of their largest luminance.
pub const CLIPPED_BYTES: u64 = 8;

/// Where the counts of a submission's keyframes go.
pub struct Clipping {
    /// Light above this counts as this.
    pub brightest: f32,
    /// A count every [`CLIPPED_STRIDE`] bytes, zero at first.
    pub counts: wgpu::Buffer,
}

/// A keyframe of a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ViewKeyframe {
    /// Index of the view in the engine.
    pub view: usize,
    /// Its number.
    pub keyframe: i64,
    /// Stream time in microseconds.
    pub t_us: i64,
}

/// The counts of a submission, and where they come.
pub struct ClippedRun {
    /// Group of views.
    pub group: usize,
    /// Light above this counts as this.
    pub brightest: f32,
    /// In order of their counts.
    pub entries: Vec<ViewKeyframe>,
    /// The counts.
    pub staging: wgpu::Buffer,
}

impl Clipping {
    /// For `keyframes` keyframes.
    pub fn new(device: &wgpu::Device, brightest: f32, keyframes: usize) -> Self {
        let counts = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("clipped light"),
            size: keyframes.max(1) as u64 * CLIPPED_STRIDE,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        Self { brightest, counts }
    }

    /// A buffer that the host reads, of the size of the counts.
    pub fn staging(&self, device: &wgpu::Device) -> wgpu::Buffer {
        device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("clipped light staging"),
            size: self.counts.size(),
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        })
    }
}

/// Pixels, and their largest luminance, of each count in `bytes`.
pub fn counts(bytes: &[u8]) -> impl Iterator<Item = (u32, f32)> + '_ {
    bytes.chunks_exact(CLIPPED_STRIDE as usize).map(|bytes| {
        let [pixels, bits]: [u32; 2] = bytemuck::pod_read_unaligned(&bytes[..CLIPPED_BYTES as usize]);
        (pixels, f32::from_bits(bits))
    })
}

/// Light of a camera's keyframes that was clipped.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClippedLight {
    /// Environment.
    pub environment: usize,
    /// Name of the camera.
    pub camera: String,
    /// Stream time of the first such keyframe, in microseconds.
    pub t_us: i64,
    /// Pixels of keyframes, margins included.
    pub pixels: u64,
    /// The largest luminance.
    pub luminance: f32,
    /// What it counted as.
    pub brightest: f32,
    /// `Y_ref` of the run.
    pub reference_luminance: f32,
}

impl ClippedLight {
    /// Adds it to what is known of its camera.
    pub fn add_to(self, list: &mut Vec<Self>) {
        let same = |known: &&mut Self| known.environment == self.environment && known.camera == self.camera;
        match list.iter_mut().find(same) {
            Some(known) => {
                known.t_us = known.t_us.min(self.t_us);
                known.pixels += self.pixels;
                known.luminance = known.luminance.max(self.luminance);
            }
            None => list.push(self),
        }
    }

    /// For the user.
    pub fn warning(&self) -> String {
        let Self { environment, camera, t_us, pixels, luminance, brightest, reference_luminance } = self;
        format!(
            "camera '{camera}' of environment {environment}, from {t_us} us on: {pixels} pixels of keyframes have light of up to \
             {luminance:.4e}, and evis-paper counts no more than {:.0} Y_ref = {brightest:.4e}, which they were clipped to; take \
             the `method` splat, which clips nothing, or a `reference_luminance` of {:.3e} and more",
            brightest / reference_luminance,
            // Rounded up, so that what is given suffices.
            1.001 * luminance / brightest * reference_luminance,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keyframes_of_one_camera_are_told_together() {
        let one = ClippedLight {
            environment: 0,
            camera: "eye".into(),
            t_us: 8000,
            pixels: 3,
            luminance: 2e5,
            brightest: 65_536.0,
            reference_luminance: 1.0,
        };
        let mut list = Vec::new();
        one.clone().add_to(&mut list);
        ClippedLight { t_us: 16_000, pixels: 4, luminance: 9e4, ..one.clone() }.add_to(&mut list);
        ClippedLight { environment: 1, ..one.clone() }.add_to(&mut list);
        assert_eq!(list.len(), 2);
        assert_eq!((list[0].t_us, list[0].pixels, list[0].luminance), (8000, 7, 2e5));
        assert_eq!(list[1], ClippedLight { environment: 1, ..one.clone() });
        let text = one.warning();
        for part in
            ["'eye'", "8000 us", "3 pixels", "2.0000e5", "65536 Y_ref", "a `reference_luminance` of 3.05"]
        {
            assert!(text.contains(part), "{part}: {text}");
        }
    }
}
