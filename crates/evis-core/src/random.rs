//! Counter-based randomness: Philox4x32-10 (Salmon, Moraes, Dror, Shaw: Parallel random numbers: as easy as 1, 2, 3,
//! SC 2011).
//!
//! A draw is a function of (seed, environment, camera, pixel, stream, epoch, draw) and of nothing else: not of the step,
//! the batch's order, the number of threads or what was drawn before. Only 32-bit integers are used, so that a shader
//! can draw the same bits.

/// Length of an epoch as a power of two, in microseconds: 2^14 us, so that a time within an epoch is 14 bits of a draw.
pub const EPOCH_SHIFT: u32 = 14;

/// Microseconds of an epoch.
pub const EPOCH_US: i64 = 1 << EPOCH_SHIFT;

/// Mixes the bits of a word: the finaliser of SplitMix64 (Steele, Lea, Flood: Fast splittable pseudorandom number
/// generators, 2014). A bijection that keeps 0.
#[must_use]
pub const fn mix(word: u64) -> u64 {
    let z = (word ^ (word >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// What a draw is for; different streams never share a counter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum StreamId {
    /// Fixed pattern of thresholds.
    Pattern = 1,
    /// Which pixels are dead, and which are hot.
    Defects = 2,
    /// Where the reference starts.
    Start = 3,
    /// Leak and shot noise.
    Noise = 4,
    /// What each of those noise events is.
    NoiseMark = 5,
    /// Events of hot pixels.
    Hot = 6,
    /// Jitter of the leak's slope.
    LeakJitter = 7,
    /// Jitter of the latency.
    Latency = 8,
    /// Brownian motion of the `diffusion` trigger.
    Diffusion = 9,
    /// Draws of [`crate::SensorConfig`] ranges.
    Sample = 10,
    /// Noise of the photoreceptor.
    Receptor = 11,
    /// Noise and bias of inertial measurement units.
    Imu = 12,
}

/// The key of one camera of one environment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Key([u32; 2]);

impl Key {
    /// The key of `camera` in `environment` under `seed`.
    pub const fn new(seed: u64, environment: u32, camera: u32) -> Self {
        // One more round of the generator keeps neighbouring environments from sharing anything.
        let mixed = philox([environment, camera, 0x4556_4953, 0], [seed as u32, (seed >> 32) as u32]);
        Self([mixed[0], mixed[1]])
    }

    /// The two words that a shader takes.
    pub const fn words(self) -> [u32; 2] {
        self.0
    }

    /// Four words for `pixel`, `stream`, `epoch` and `draw`.
    #[inline(always)]
    pub const fn draw(self, pixel: u32, stream: StreamId, epoch: i64, draw: u32) -> [u32; 4] {
        // The stream takes the epoch's top byte: 2^56 epochs are longer than any clock.
        let high = ((epoch >> 32) as u32 & 0x00ff_ffff) | ((stream as u32) << 24);
        philox([pixel, epoch as u32, high, draw], self.0)
    }
}

/// Philox4x32-10.
#[inline(always)]
pub const fn philox(counter: [u32; 4], key: [u32; 2]) -> [u32; 4] {
    let [mut a, mut b, mut c, mut d] = counter;
    let [mut low, mut high] = key;
    let mut round = 0;
    while round < 10 {
        let first = a as u64 * 0xd251_1f53;
        let second = c as u64 * 0xcd9e_8d57;
        (a, b, c, d) =
            ((second >> 32) as u32 ^ b ^ low, second as u32, (first >> 32) as u32 ^ d ^ high, first as u32);
        low = low.wrapping_add(0x9e37_79b9);
        high = high.wrapping_add(0xbb67_ae85);
        round += 1;
    }
    [a, b, c, d]
}

/// Uniform in (0, 1): the middle of one of 2^32 equal parts, so that neither end is ever drawn.
#[inline(always)]
pub fn unit(word: u32) -> f64 {
    (f64::from(word) + 0.5) * (1.0 / 4_294_967_296.0)
}

/// Uniform in (0, 1), exact in f32 and so the same on every device: the middle of one of 2^23 equal parts.
#[inline(always)]
pub fn unit_f32(word: u32) -> f32 {
    ((word >> 9) as f32 + 0.5) * (1.0 / 8_388_608.0)
}

/// A pair of independent standard normals (Box and Muller, Ann. Math. Stat. 29, 1958).
#[inline]
pub fn normals(first: u32, second: u32) -> (f64, f64) {
    let radius = (-2.0 * unit(first).ln()).sqrt();
    let (sin, cos) = (std::f64::consts::TAU * unit(second)).sin_cos();
    (radius * cos, radius * sin)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn philox_gives_the_published_answers() {
        // Known answers of the authors' library, Random123, file kat_vectors, philox4x32 10.
        let answers = [
            ([0; 4], [0; 2], [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]),
            ([u32::MAX; 4], [u32::MAX; 2], [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]),
            (
                [0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344],
                [0xa409_3822, 0x299f_31d0],
                [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1],
            ),
        ];
        for (counter, key, expected) in answers {
            assert_eq!(philox(counter, key), expected);
            // Canary: one bit of the counter changes the answer.
            assert_ne!(philox([counter[0] ^ 1, counter[1], counter[2], counter[3]], key), expected);
        }
    }

    #[test]
    fn every_part_of_the_key_matters() {
        let base = Key::new(7, 1, 2).draw(3, StreamId::Noise, 4, 5);
        let others = [
            Key::new(8, 1, 2).draw(3, StreamId::Noise, 4, 5),
            Key::new(7 + (1 << 32), 1, 2).draw(3, StreamId::Noise, 4, 5),
            Key::new(7, 2, 2).draw(3, StreamId::Noise, 4, 5),
            Key::new(7, 1, 3).draw(3, StreamId::Noise, 4, 5),
            Key::new(7, 1, 2).draw(4, StreamId::Noise, 4, 5),
            Key::new(7, 1, 2).draw(3, StreamId::Hot, 4, 5),
            Key::new(7, 1, 2).draw(3, StreamId::Noise, 5, 5),
            Key::new(7, 1, 2).draw(3, StreamId::Noise, 4 + (1 << 33), 5),
            Key::new(7, 1, 2).draw(3, StreamId::Noise, 4, 6),
        ];
        assert!(others.iter().all(|other| *other != base));
        assert_eq!(Key::new(7, 1, 2).draw(3, StreamId::Noise, 4, 5), base);
    }

    #[test]
    fn normals_have_mean_0_and_variance_1() {
        let key = Key::new(1, 0, 0);
        let (mut sum, mut squares, mut beyond) = (0.0, 0.0, 0);
        let count = 200_000;
        for pixel in 0..count / 2 {
            let [a, b, ..] = key.draw(pixel, StreamId::Pattern, 0, 0);
            let (first, second) = normals(a, b);
            for value in [first, second] {
                sum += value;
                squares += value * value;
                beyond += u32::from(value.abs() > 1.959_964);
            }
        }
        let n = f64::from(count);
        // Five standard errors each.
        assert!((sum / n).abs() < 5.0 / n.sqrt(), "{}", sum / n);
        assert!((squares / n - 1.0).abs() < 5.0 * (2.0 / n).sqrt(), "{}", squares / n);
        assert!((f64::from(beyond) / n - 0.05).abs() < 5.0 * (0.05 * 0.95 / n).sqrt(), "{beyond}");
    }
}
