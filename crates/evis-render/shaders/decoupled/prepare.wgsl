#import decoupled/layout.wgsl
// Prepares the pixels of tiles: what each of them may see, how often it is evaluated, whether bounds prove it quiet; and counts all pixels
// by class and entries. A workgroup takes a tile, or as many pixels that were given. Twins: `Evaluator::activity` and
// `Evaluator::stays_within` of evis-decoupled.

// What 32 bits leave of bounds, and of the levels that they are compared with, as a part of these.
const LEVEL_SLACK: f32 = 1e-5;

// Entries of pixels.
var<workgroup> counts: array<u32, 64>;

// The more frequent evaluation of two, see Entry.
fn closer(a: u32, b: u32) -> u32 {
    if (a == 0u || b == 0u) {
        return max(a, b);
    }
    let stride = min(a & STRIDE_MASK, b & STRIDE_MASK);
    return stride | (min(a >> STRIDE_BITS, b >> STRIDE_BITS) << STRIDE_BITS);
}

// Least and most luminance that an entry sends into the pixel, of which it is known which shadows it has there.
fn range_of(entry: u32) -> vec2<f32> {
    let at = base.words + entries[entry].bounds;
    var sum = vec2<f32>(bitcast<f32>(words[at]), bitcast<f32>(words[at + 1u]));
    for (var lamp = 0u; lamp < job.lamps; lamp++) {
        let shade = entries[entry].shades + SHADE_WORDS * lamp;
        let own = at + 2u + 2u * lamp;
        let light = vec2<f32>(bitcast<f32>(words[own]), bitcast<f32>(words[own + 1u]));
        let part = select(light, vec2<f32>(min(light.x, 0.0), max(light.y, 0.0)), has_pixel(shade + 2u));
        sum += select(part, vec2<f32>(0.0), has_pixel(shade));
    }
    return sum;
}

fn is_shadowed(entry: u32) -> bool {
    for (var lamp = 0u; lamp < job.lamps; lamp++) {
        if (has_pixel(entries[entry].shades + SHADE_WORDS * lamp + 2u)) {
            return true;
        }
    }
    return false;
}

// Begins what pixel `number` of a tile remembers, or takes it from the host, where either is needed. No light is between the levels of one
// that begins here.
fn enter_memory(tile: Tile, at: u32) {
    if (has_bit(tile.begins, number)) {
        remember(at, Memory(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, BEGINS, 0u));
    }
    if (has_bit(tile.given, number)) {
        let below = (1u << (number % 32u)) - 1u;
        let rank = select(countOneBits(tile.given.x & below), countOneBits(tile.given.x) + countOneBits(tile.given.y & below), number >= 32u);
        let first = base.words + tile.memories + MEMORY_WORDS * rank;
        for (var k = 0u; k < MEMORY_WORDS; k++) {
            scratch[at + k] = words[first + k];
        }
    }
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let tile_number = group.y * batch.row + group.x;
    if (tile_number >= batch.tiles) {
        let index = (tile_number - batch.tiles) * 64u + local;
        if (index < batch.given) {
            atomicAdd(&events.buckets[bucket_of(pixels[index].flags, pixels[index].own_count)], 1u);
        }
        return;
    }
    let tile = tile_at(tile_number);
    let index = batch.given + tile_number * 64u + local;
    enter_row(tile.bases);
    number = local;
    let alone = (job.flags & LIGHT_ALONE) != 0u;
    let jumps = (job.flags & JUMPS) != 0u && !alone;
    let memory_word = memory_of(index);
    let follows = has_bit(tile.pixels, number);
    var own_count = 0u;
    var strides = 0u;
    var flags = select(IS_BENT, 0u, tile.frames == NO_FRAMES);
    var memory = Memory(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0u, 0u);
    if (follows) {
        enter_memory(tile, memory_word);
        memory = memory_at(memory_word);
    }
    var is_quiet = follows && !alone;
    let low = memory.below + (TOLERANCE + LEVEL_SLACK) * (abs(memory.below) + dark_floor());
    let high = memory.above - (TOLERANCE + LEVEL_SLACK) * (abs(memory.above) + dark_floor());
    var is_plain = false;
    for (var k = 0u; follows && k < tile.entry_count; k++) {
        let entry = base.entries + tile.entries + k;
        if (!has_bit(entries[entry].touches, number)) {
            continue;
        }
        own_count += 1u;
        strides = closer(strides, entries[entry].strides);
        if (has_bit(entries[entry].moved, number)) {
            strides = closer(strides, entries[entry].moved_strides);
        }
        flags |= select(0u, IS_MAPPED, (entries[entry].flags & HAS_MAPS) != 0u);
        is_plain = own_count == 1u && has_bit(entries[entry].covers, number) && !is_shadowed(entry);
        if (is_quiet) {
            is_quiet = (entries[entry].flags & BOUNDED) != 0u;
            if (is_quiet) {
                let range = range_of(entry);
                is_quiet = low < range.x && range.y < high;
            }
        }
    }
    if (follows && !has_bit(tile.filled, number)) {
        strides = closer(strides, tile.background_strides);
        is_quiet = is_quiet && job.sky_levels == 0u && low < job.background && job.background < high;
    }
    flags |= select(0u, IS_PLAIN, is_plain);
    // Nothing is proved of a pixel that stays as it is: it must jump.
    is_quiet = is_quiet && strides != 0u;
    let returned = follows && has_bit(tile.returned, number);
    let idle = !follows || returned || is_quiet || (strides == 0u && !jumps && !alone);
    if (idle) {
        own_count = 0u;
    }
    counts[local] = own_count;
    workgroupBarrier();
    var own = tile.own;
    for (var k = 0u; k < local; k++) {
        own += counts[k];
    }
    if (alone) {
        scratch[batch.light + index - batch.given] = bitcast<u32>(NOT_FOUND);
    }
    if (returned) {
        give_back(index);
    } else if (is_quiet) {
        memory.flags = RESTED;
        remember(memory_word, memory);
        atomicAdd(&events.quiet, 1u);
    }
    pixels[index].flags = IDLE;
    if (idle) {
        return;
    }
    var at = batch.own + own;
    for (var k = 0u; k < tile.entry_count; k++) {
        let entry = base.entries + tile.entries + k;
        if (has_bit(entries[entry].touches, number)) {
            scratch[at] = (tile.entries + k) | select(0u, COVERS, has_bit(entries[entry].covers, number));
            at += 1u;
        }
    }
    // What went before was still, otherwise.
    if (memory.number + 1u != job.number) {
        memory.flags &= ~HAS_BEFORE;
    }
    let offset = vec2<f32>(f32(number % 8u), f32(number / 8u));
    pixels[index] = Pixel(
        tile.first + offset,
        own,
        own_count,
        number,
        tile.bases,
        strides & STRIDE_MASK,
        strides >> STRIDE_BITS,
        memory,
        flags,
        0u,
        0u,
        tile.frames + 6u * number,
    );
    atomicAdd(&events.buckets[bucket_of(flags, own_count)], 1u);
}
