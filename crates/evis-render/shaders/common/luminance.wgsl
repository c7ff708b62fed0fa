// Rec. ITU-R BT.709-6, item 3.2. Twin: evis_core::luminance.
const LUMINANCE_WEIGHTS: vec3<f32> = vec3<f32>(0.2126, 0.7152, 0.0722);

fn luminance(rgb: vec3<f32>) -> f32 {
    return dot(rgb, LUMINANCE_WEIGHTS);
}
