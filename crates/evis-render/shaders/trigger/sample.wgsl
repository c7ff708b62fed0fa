#import trigger/layout.wgsl
// Mean of a pixel's samples in linear light, then the logarithm. Twin: cpu/trigger.rs, log_luma.

override SAMPLES: u32 = 1;
// Whether a method may leave a pixel unknown, by a luminance below 0; such an instant passes the pixel by.
override MAY_BE_UNKNOWN: bool = false;

@group(0) @binding(0) var<uniform> params: TriggerParams;
@group(0) @binding(1) var<storage, read> sensors: array<ViewSensor>;
@group(0) @binding(2) var luminance_layers: texture_2d_array<f32>;

// Luminance beyond this is treated as this: no infinity reaches the logarithm.
const LUMINANCE_LIMIT: f32 = 1e30;

fn log_luma_at(sensor: ViewSensor, pixel: vec2<u32>, view: u32, instant: u32) -> f32 {
    let layer = (view * params.instants + instant) * SAMPLES;
    var sum = 0.0;
    for (var s = 0u; s < SAMPLES; s++) {
        sum += textureLoad(luminance_layers, pixel, layer + s, 0).r;
    }
    let y = clamp(sum * (1.0 / f32(SAMPLES)), 0.0, LUMINANCE_LIMIT);
    return log(y * sensor.inverse_reference_luminance + sensor.log_eps);
}

fn is_unknown(pixel: vec2<u32>, view: u32, instant: u32) -> bool {
    if (!MAY_BE_UNKNOWN) {
        return false;
    }
    return textureLoad(luminance_layers, pixel, (view * params.instants + instant) * SAMPLES, 0).r < 0.0;
}
