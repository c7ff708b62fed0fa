// Logarithm and exponential from sums and products alone: drivers' own differ by more than a threshold forgives once a
// filter has summed them up. Twin: evis_core's simd.rs.

fn precise_ln(x: f32) -> f32 {
    let bits = bitcast<i32>(x);
    let exponent = (bits - 0x3f3504f3) >> 23u;
    let m = bitcast<f32>(bits - (exponent << 23u));
    let s = (m - 1.0) / (m + 1.0);
    let z = s * s;
    let tail = z * (1.0 / 3.0 + z * (1.0 / 5.0 + z * (1.0 / 7.0 + z * (1.0 / 9.0))));
    let k = f32(exponent);
    return k * 0.6933594 + (2.0 * s + (2.0 * s * tail - k * 2.121944e-4));
}

fn precise_exp(power: f32) -> f32 {
    let x = clamp(power, -87.0, 88.0);
    let k = round(x * 1.442695);
    let f = (x - k * 0.6933594) + k * 2.121944e-4;
    let series = 1.0
        + f * (1.0 + f * (0.5 + f * (1.0 / 6.0 + f * (1.0 / 24.0 + f * (1.0 / 120.0 + f * (1.0 / 720.0))))));
    return series * bitcast<f32>((i32(k) + 127) << 23u);
}
