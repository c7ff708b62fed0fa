#import trigger/sample.wgsl
#import trigger/between.wgsl
#import trigger/decide.wgsl
// Visits the instants at which a pixel fires, through the same decision as the counting pass, and hands each event to `put`,
// which the file that imports this one has. Between two of them the reference stays as it is, so all others can be passed over.

// View by view, instant by instant.
@group(0) @binding(2) var means: texture_storage_2d_array<r32float, read>;
@group(0) @binding(3) var memory_in: texture_storage_2d_array<rgba32uint, read>;
@group(0) @binding(4) var memory_out: texture_storage_2d_array<rgba32uint, read>;
@group(0) @binding(7) var<storage, read_write> status: Status;

fn mean_at(pixel: vec2<u32>, view: u32, instant: u32) -> f32 {
    return textureLoad(means, pixel, view * params.instants + instant).r;
}

// From `l0`, after instant `start - 1`, to `l1` at instant `last`; `first` is what the submission began with.
fn run_around(
    sensor: ViewSensor, pixel: vec2<u32>, view: u32, start: u32, last: u32, l0: f32, l1: f32, first: f32
) -> Run {
    if (!CURVE) {
        return Run();
    }
    let step = last + 1u - start;
    let has_before = start % BLOCK_INSTANTS != 0u;
    let has_after = (last + 1u) % BLOCK_INSTANTS != 0u;
    var before = l0;
    if (has_before && start == step) {
        before = first;
    } else if (has_before) {
        before = log_luminance_of(sensor, mean_at(pixel, view, start - step - 1u));
    }
    var after = l1;
    if (has_after) {
        after = log_luminance_of(sensor, mean_at(pixel, view, last + step));
    }
    return run_of(before, l0, l1, after, has_before, has_after);
}

// Events of pixel `id` of the view `workgroup.z`; does nothing where the submission did not fit.
fn visit(id: vec3<u32>, workgroup: vec3<u32>) {
    if (status.stalled != 0u || id.x >= params.width) {
        return;
    }
    let counted = textureLoad(memory_out, id.xy, id.z);
    let count = counted.w;
    if (count == 0u) {
        return;
    }
    let sensor = sensor_of(workgroup.z);
    let place = place_of(id);
    let memory = memory_of(textureLoad(memory_in, id.xy, id.z));
    var reference_log = memory.reference_log;
    if (params.first == 1u) {
        reference_log = log_luminance_of(sensor, mean_at(id.xy, id.z, 0u));
    }
    var written = 0u;
    for (var left = counted.z; left != 0u; left &= left - 1u) {
        let k = firstTrailingBit(left);
        var before = memory.log_luminance;
        // The last instant at which the pixel was known, as the counting pass had it.
        let start = k + 1u - step_at(id.xy, id.z, k);
        var last = start;
        while (last != 0u && is_unknown(mean_at(id.xy, id.z, last - 1u))) {
            last--;
        }
        if (last != 0u) {
            before = log_luminance_of(sensor, mean_at(id.xy, id.z, last - 1u));
        }
        let now = log_luminance_of(sensor, mean_at(id.xy, id.z, k));
        let span = span_between(start, k);
        let run = run_around(sensor, id.xy, id.z, start, k, before, now, memory.log_luminance);
        var l = before;
        for (var piece = 0u; piece < select(1u, PIECES, CURVE); piece++) {
            var piece_end = now;
            var begins = 0u;
            var length = span.y;
            if (CURVE) {
                piece_end = end_of(run, piece, now);
                begins = begin_of(span.y, piece);
                length = begin_of(span.y, piece + 1u) - begins;
            }
            let decision = decide(sensor, PixelMemory(reference_log, l), piece_end);
            for (var i = 1u; i <= decision.count && written < count; i++) {
                let t = span.x + begins + fire_time(decision, i, length);
                put(place, written, t, decision.polarity);
                written++;
            }
            reference_log = decision.reference_log;
            l = piece_end;
        }
    }
    if (written != count) {
        atomicAdd(&status.mismatched, 1u);
    }
}
