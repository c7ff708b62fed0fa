#import chain/leak.wgsl
#import chain/response.wgsl
// The first instant of a stream: it sets memories, and no pixel fires.

const STREAM_START: u32 = 3u;

// The first sample sets the reference.
fn begin_pixel(first_light: u32) {
    begin_response(first_light);
    reference = input;
    if (PHASE_START && threshold_on < BEYOND) {
        let part = unit(draw(key, number(), STREAM_START, 0u, 0u, 0u).x);
        reference = input - (part * (threshold_on + threshold_off) - threshold_off);
    }
    fired = -i32(OLD - 1u);
    polarity = 2u;
    slope = steady;
    moved_at(0.0);
}

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(workgroup_id) workgroup: vec3<u32>) {
    cells[(id.z * params.height + id.y) * params.stride + id.x] = 0u;
    if (report.status.stalled != 0u || id.x >= params.width) {
        return;
    }
    load_pixel(id.xy, workgroup.z);
    if (OWN_TIMES) {
        let own = own_times();
        if ((own.flags & LIGHT_BEGINS) == 0u) {
            load_memory(false);
            store_memory(true, 0u);
            return;
        }
        set_own_interval(block_word(0u), block_word(0u));
        begin_pixel(own.first);
        store_memory(true, start);
        return;
    }
    set_interval(0u, 1u);
    begin_pixel(0u);
    store_memory(true, 0u);
}
