#import decoupled/layout.wgsl
// Lists the pixels that are followed for their first round: class by class, those with as many entries side by side.

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let index = (group.y * batch.row + group.x) * 64u + local;
    if (index == 0u) {
        var first = 0u;
        for (var kind = 0u; kind < CLASSES; kind++) {
            var count = 0u;
            for (var k = 0u; k < COUNTS; k++) {
                count += atomicLoad(&events.buckets[kind * COUNTS + k]);
            }
            atomicStore(&events.firsts[kind], first);
            atomicStore(&events.going_on[kind * (ROUNDS + 1u)], count);
            atomicStore(&events.groups[groups_at(0u, kind)], (count + 63u) / 64u);
            first += count;
        }
    }
    if (index >= batch.pixels || (pixels[index].flags & IDLE) != 0u) {
        return;
    }
    let bucket = bucket_of(pixels[index].flags, pixels[index].own_count);
    var slot = atomicAdd(&events.listed[bucket], 1u);
    for (var k = 0u; k < bucket; k++) {
        slot += atomicLoad(&events.buckets[k]);
    }
    scratch[slot] = index;
}
