// glTF 2.0, appendix B.3: GGX, height-correlated Smith, Schlick.
const PI: f32 = 3.14159265358979;

// Specular term D * V for a surface of roughness squared `alpha`.
fn ggx_specular(alpha: f32, n_l: f32, n_v: f32, n_h: f32) -> f32 {
    let a2 = alpha * alpha;
    let f = (n_h * a2 - n_h) * n_h + 1.0;
    let d = a2 / (PI * f * f);
    let v = n_l * sqrt(n_v * n_v * (1.0 - a2) + a2) + n_v * sqrt(n_l * n_l * (1.0 - a2) + a2);
    return d * 0.5 / max(v, 1e-7);
}

fn schlick(f0: vec3<f32>, v_h: f32) -> vec3<f32> {
    let x = clamp(1.0 - v_h, 0.0, 1.0);
    let x2 = x * x;
    return f0 + (1.0 - f0) * (x2 * x2 * x);
}
