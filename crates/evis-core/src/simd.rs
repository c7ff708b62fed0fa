//! Vector arithmetic without intrinsics: the same scalar code, compiled for several instruction sets and chosen at run
//! time. Rust neither fuses nor reorders floating-point operations, so all of them agree bit for bit.

/// An instruction set that the kernels are compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Isa {
    /// What every processor of this target has.
    Portable,
    /// x86-64 with AVX2: 8 lanes.
    Avx2,
    /// x86-64 with AVX-512 F, BW, DQ and VL: 16 lanes.
    Avx512,
}

impl Isa {
    /// The widest set that this processor has.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            let wide = is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512vl");
            if wide {
                return Self::Avx512;
            }
            if is_x86_feature_detected!("avx2") {
                return Self::Avx2;
            }
        }
        Self::Portable
    }

    /// Every set that this processor has, the plainest first.
    #[cfg(test)]
    pub fn supported() -> Vec<Self> {
        match Self::detect() {
            Self::Portable => vec![Self::Portable],
            Self::Avx2 => vec![Self::Portable, Self::Avx2],
            Self::Avx512 => vec![Self::Portable, Self::Avx2, Self::Avx512],
        }
    }
}

/// Declares `$name(isa, …)`, which runs the `#[inline(always)]` function `$body` compiled for `isa`; in its place `$wide` where
/// there is AVX2, and `$widest` where there is AVX-512.
macro_rules! dispatched {
    ($(#[$meta:meta])* $visibility:vis fn $name:ident($($arg:ident: $type:ty),* $(,)?) $(-> $out:ty)? = $body:expr) => {
        $crate::simd::dispatched!(
            $(#[$meta])* $visibility fn $name($($arg: $type),*) $(-> $out)? = $body, wide $body, widest $body
        );
    };
    ($(#[$meta:meta])* $visibility:vis fn $name:ident($($arg:ident: $type:ty),* $(,)?) $(-> $out:ty)? = $body:expr, wide $wide:expr, widest $widest:expr) => {
        $(#[$meta])*
        #[allow(clippy::too_many_arguments, reason = "it passes on what the body takes")]
        $visibility fn $name(isa: $crate::simd::Isa, $($arg: $type),*) $(-> $out)? {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                #[allow(clippy::too_many_arguments, reason = "it passes on what the body takes")]
                fn avx2($($arg: $type),*) $(-> $out)? {
                    $wide($($arg),*)
                }
                #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
                #[allow(clippy::too_many_arguments, reason = "it passes on what the body takes")]
                fn avx512($($arg: $type),*) $(-> $out)? {
                    $widest($($arg),*)
                }
                match isa {
                    $crate::simd::Isa::Portable => {}
                    // SAFETY: `Isa::detect` saw these features on this processor; nothing else makes these values
                    // but tests, which take them from `Isa::supported`.
                    $crate::simd::Isa::Avx2 => return unsafe { avx2($($arg),*) },
                    // SAFETY: as above.
                    $crate::simd::Isa::Avx512 => return unsafe { avx512($($arg),*) },
                }
            }
            let _ = isa;
            $body($($arg),*)
        }
    };
}
pub(crate) use dispatched;

/// Natural logarithm of a positive, normal `x`, within two units in the last place of the result or 1e-7, whichever is
/// more.
///
/// `x = 2^k · m` with `m` in [sqrt(1/2), sqrt(2)); `ln m = 2 artanh((m - 1) / (m + 1))` by its series, whose rest beyond
/// the fifth term is below 3e-9 there.
#[inline(always)]
pub fn ln(x: f32) -> f32 {
    const ROOT_HALF: i32 = 0x3f35_04f3;
    let bits = x.to_bits() as i32;
    let exponent = bits.wrapping_sub(ROOT_HALF) >> 23;
    let m = f32::from_bits(bits.wrapping_sub(exponent << 23) as u32);
    let s = (m - 1.0) / (m + 1.0);
    let z = s * s;
    let tail = z * (1.0 / 3.0 + z * (1.0 / 5.0 + z * (1.0 / 7.0 + z * (1.0 / 9.0))));
    let k = exponent as f32;
    // ln 2 in two parts; the first has few bits, so its product with k is exact.
    k * 0.693_359_4 + (2.0 * s + (2.0 * s * tail - k * 2.121_944_4e-4))
}

/// `e^x`; beyond [-87, 88], where f32 ends, the value at that end. Relative error below 3e-7.
#[inline(always)]
pub fn exp(x: f32) -> f32 {
    let x = if x < -87.0 { -87.0 } else { x };
    let x = if x > 88.0 { 88.0 } else { x };
    // Round to nearest by the magic constant: adding it leaves no room for a fraction.
    const MAGIC: f32 = 12_582_912.0;
    let shifted = x * std::f32::consts::LOG2_E + MAGIC;
    let k = shifted - MAGIC;
    let f = (x - k * 0.693_359_4) + k * 2.121_944_4e-4;
    let series = 1.0
        + f * (1.0 + f * (0.5 + f * (1.0 / 6.0 + f * (1.0 / 24.0 + f * (1.0 / 120.0 + f * (1.0 / 720.0))))));
    // The sum's last bits are the whole number.
    let power = shifted.to_bits().wrapping_sub(MAGIC.to_bits()).wrapping_add(127);
    series * f32::from_bits(power << 23)
}

/// Whole part of `x` in [0, 2^30]; what is outside goes to the nearer end, NaN to the upper one.
#[inline(always)]
pub fn whole(x: f32) -> u32 {
    const MOST: f32 = 1_073_741_824.0;
    let x = if x < MOST { x } else { MOST };
    let x = if x > 0.0 { x } else { 0.0 };
    // SAFETY: `x` is a number between 0 and 2^30. (The checked conversion is not vectorised.)
    unsafe { x.to_int_unchecked::<i32>() as u32 }
}

/// Whether each of 64 flags is set, as bits; a flag is 0 or 1.
#[inline(always)]
pub fn bits_of(flags: &[u8; 64]) -> u64 {
    let mut mask = 0;
    for (i, eight) in flags.as_chunks::<8>().0.iter().enumerate() {
        // The product gathers bit 0 of byte j in bit 56 + j.
        let gathered = u64::from_le_bytes(*eight).wrapping_mul(0x0102_0408_1020_4080) >> 56;
        mask |= gathered << (8 * i);
    }
    mask
}

#[cfg(test)]
mod tests {
    use super::*;

    #[inline(always)]
    fn ln_all(x: &[f32], out: &mut [f32]) {
        for (x, out) in x.iter().zip(out) {
            *out = ln(*x);
        }
    }
    dispatched!(fn ln_by(x: &[f32], out: &mut [f32]) = ln_all);

    #[inline(always)]
    fn exp_all(x: &[f32], out: &mut [f32]) {
        for (x, out) in x.iter().zip(out) {
            *out = exp(*x);
        }
    }
    dispatched!(fn exp_by(x: &[f32], out: &mut [f32]) = exp_all);

    #[test]
    fn ln_keeps_its_bound_on_every_instruction_set() {
        // All exponents with a stride through the mantissas, and every value next to 1.
        let mut x: Vec<f32> = (0x0080_0000..0x7f80_0000).step_by(1013).map(f32::from_bits).collect();
        x.extend((0x3f70_0000..0x3f90_0000).map(f32::from_bits));
        let mut reference = vec![0.0; x.len()];
        ln_by(Isa::Portable, &x, &mut reference);
        let mut worst: f64 = 0.0;
        for (x, got) in x.iter().zip(&reference) {
            let expected = f64::from(*x).ln();
            let ulp = f64::from((expected as f32).abs().next_up()) - f64::from((expected as f32).abs());
            let bound = (2.0 * ulp).max(1e-7);
            worst = worst.max((f64::from(*got) - expected).abs() / bound);
        }
        assert!(worst <= 1.0, "{worst} of the bound");
        assert!(worst > 0.1, "canary: a bound that is never approached says nothing, {worst}");
        for isa in Isa::supported() {
            let mut got = vec![0.0; x.len()];
            ln_by(isa, &x, &mut got);
            let same = got.iter().zip(&reference).all(|(a, b)| a.to_bits() == b.to_bits());
            assert!(same, "{isa:?}");
        }
    }

    #[test]
    fn exp_keeps_its_bound_on_every_instruction_set() {
        let x: Vec<f32> = (-870_000..880_000).map(|i| i as f32 * 1e-4).collect();
        let mut reference = vec![0.0; x.len()];
        exp_by(Isa::Portable, &x, &mut reference);
        let error = x.iter().zip(&reference).map(|(x, got)| {
            let expected = f64::from(*x).exp();
            (f64::from(*got) - expected).abs() / expected
        });
        let worst = error.fold(0.0, f64::max);
        assert!(worst < 3e-7 && worst > 1e-8, "{worst}");
        assert_eq!(exp(0.0), 1.0);
        assert_eq!((exp(-1e30), exp(1e30)), (exp(-87.0), exp(88.0)));
        for isa in Isa::supported() {
            let mut got = vec![0.0; x.len()];
            exp_by(isa, &x, &mut got);
            assert!(got.iter().zip(&reference).all(|(a, b)| a.to_bits() == b.to_bits()), "{isa:?}");
        }
    }

    #[test]
    fn flags_become_bits_in_order() {
        for seed in [0_u64, u64::MAX, 1, 1 << 63, 0x1234_5678_9abc_def0] {
            let flags: [u8; 64] = std::array::from_fn(|i| (seed >> i & 1) as u8);
            assert_eq!(bits_of(&flags), seed);
        }
    }
}
