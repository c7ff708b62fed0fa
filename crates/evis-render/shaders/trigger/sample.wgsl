#import common/unknown.wgsl
#import trigger/layout.wgsl
// From a pixel's light to the logarithm that its thresholds see. Twin: cpu/trigger.rs, log_luminance.

@group(0) @binding(0) var<uniform> params: TriggerParams;
// A texel per view. Per-pixel data are textures because software drivers read a storage buffer lane by lane.
@group(0) @binding(1) var sensors: texture_2d<f32>;

// Luminance beyond this is treated as this: no infinity reaches the logarithm.
const LUMINANCE_LIMIT: f32 = 1e30;

fn sensor_of(view: u32) -> ViewSensor {
    let s = textureLoad(sensors, vec2<u32>(view, 0u), 0);
    return ViewSensor(s.x, s.y, s.z, s.w);
}

fn memory_of(texel: vec4<u32>) -> PixelMemory {
    return PixelMemory(bitcast<f32>(texel.x), bitcast<f32>(texel.y));
}

fn log_luminance_of(sensor: ViewSensor, mean: f32) -> f32 {
    let y = clamp(mean, 0.0, LUMINANCE_LIMIT);
    return log(y * sensor.inverse_reference_luminance + sensor.log_eps);
}
