#import common/mean.wgsl
#import trigger/sample.wgsl
#import trigger/between.wgsl
#import trigger/decide.wgsl
// Counts each pixel's events over the instants of a submission and writes its next memory beside the old one.
// The old memory stays until the submission is known to fit: that is what lets it run again.

// View by view, instant by instant, sample by sample.
@group(0) @binding(2) var luminance_layers: texture_storage_2d_array<r32float, read>;
@group(0) @binding(3) var memory_in: texture_storage_2d_array<rgba32uint, read>;
// Also for the emitting pass of the submission: z, bit k, that the pixel fires at instant k; w, its count.
@group(0) @binding(4) var memory_out: texture_storage_2d_array<rgba32uint, write>;
@group(0) @binding(5) var<storage, read_write> counts: array<u32>;
@group(0) @binding(6) var<storage, read_write> status: Status;
// With several samples, their means, so that the emitting pass reads one layer per instant.
@group(0) @binding(7) var means: texture_storage_2d_array<r32float, write>;

// Mean of a pixel's samples in linear light; below 0 where it is unknown.
fn mean_at(pixel: vec2<u32>, view: u32, instant: u32) -> f32 {
    let place = view * params.instants + instant;
    let mean = mean_of_samples(pixel, place * SAMPLES);
    if (SAMPLES > 1u) {
        textureStore(means, pixel, place, vec4<f32>(mean, 0.0, 0.0, 0.0));
    }
    return mean;
}

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(workgroup_id) workgroup: vec3<u32>) {
    if (status.stalled != 0u) {
        return;
    }
    let index = (id.z * params.height + id.y) * params.stride + id.x;
    if (id.x >= params.width) {
        counts[index] = 0u;
        return;
    }
    let sensor = sensor_of(workgroup.z);
    var state = memory_of(textureLoad(memory_in, id.xy, id.z));
    var count = 0u;
    var fires = 0u;
    var clamped = 0u;
    var unknown = 0u;
    var begin = 0u;
    if (params.first == 1u) {
        let l = log_luminance_of(sensor, mean_at(id.xy, id.z, 0u));
        state = PixelMemory(l, l);
        begin = 1u;
    }
    // A view's tiles are sampled at their own rate, block by block.
    let length = select(BLOCK_INSTANTS, params.instants, BLOCK_INSTANTS == 1u);
    for (; begin < params.instants; begin += length) {
        let step = step_at(id.xy, id.z, begin);
        let end = min(begin + length, params.instants);
        if (CURVE) {
            var before = state.log_luminance;
            var at = sample_from(begin, step);
            var l = log_luminance_of(sensor, mean_at(id.xy, id.z, at));
            for (; at < end; at += step) {
                let is_last = at + step >= end;
                var after = l;
                if (!is_last) {
                    after = log_luminance_of(sensor, mean_at(id.xy, id.z, at + step));
                }
                let start = state.log_luminance;
                let run = run_of(before, start, l, after, at >= begin + step, !is_last);
                for (var piece = 0u; piece < PIECES; piece++) {
                    let piece_end = end_of(run, piece, l);
                    let decision = decide(sensor, state, piece_end);
                    clamped += u32(decision.clamped);
                    fires |= u32(decision.count != 0u) << at;
                    count += decision.count;
                    state = PixelMemory(decision.reference_log, piece_end);
                }
                before = start;
                l = after;
            }
            continue;
        }
        for (var at = sample_from(begin, step); at < end; at += step) {
            let mean = mean_at(id.xy, id.z, at);
            if (is_unknown(mean)) {
                unknown++;
                continue;
            }
            let l = log_luminance_of(sensor, mean);
            let decision = decide(sensor, state, l);
            clamped += u32(decision.clamped);
            fires |= u32(decision.count != 0u) << at;
            count += decision.count;
            state = PixelMemory(decision.reference_log, l);
        }
    }
    if (clamped != 0u) {
        atomicAdd(&status.clamped, clamped);
    }
    if (unknown != 0u) {
        atomicAdd(&status.unknown, unknown);
    }
    counts[index] = count;
    let next = vec2<u32>(bitcast<u32>(state.reference_log), bitcast<u32>(state.log_luminance));
    textureStore(memory_out, id.xy, id.z, vec4<u32>(next, fires, count));
}
