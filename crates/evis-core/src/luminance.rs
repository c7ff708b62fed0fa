//! Luminance of linear light with the primaries and white point of sRGB.

/// Parts of R, G and B in the luminance; Rec. ITU-R BT.709-6, item 3.2.
pub const LUMINANCE_WEIGHTS: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Luminance of linear R, G and B.
pub fn luminance([r, g, b]: [f64; 3]) -> f64 {
    let [of_r, of_g, of_b] = LUMINANCE_WEIGHTS;
    of_r * r + of_g * g + of_b * b
}
