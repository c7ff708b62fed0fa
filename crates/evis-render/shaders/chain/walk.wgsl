#import chain/pixel.wgsl
// Counts the whole chain's events and keeps each pixel's first ones; and walks pixels of many events once more, to emit
// them: one pipeline, so that both walks of a pixel are computed alike. The old memory stays until the submission is
// known to fit. Silent instants pass in a loop of their own, because software drivers execute what a pixel does when it
// wakes as often as any of some neighbours comes there, and once where none does.

// Where waking costs little, waiting for a neighbour that sleeps costs more.
fn in_step() -> bool {
    return !SEQUENTIAL && (LATCH || TIMES != 0u);
}

// The pixel's first candidate after `time`.
fn find_candidates(time: u32, block: u32) {
    if (!TIMED_NOISE) {
        return;
    }
    let lane = pixel.x % BLOCK_PIXELS;
    var low = feed[block];
    var high = feed[block + 1u];
    candidates_end = high;
    while (low < high) {
        let middle = low + (high - low) / (2u * CANDIDATE_WORDS) * CANDIDATE_WORDS;
        let other = feed[middle + 1u] & 63u;
        if (other < lane || (other == lane && feed[middle] <= time)) {
            low = middle + CANDIDATE_WORDS;
        } else {
            high = middle;
        }
    }
    candidate = low;
    load_candidate();
}

// Places in `tallies`.
fn peak_of(instant: u32) -> u32 {
    return view * TALLY_WORDS + instant;
}

fn woken_at(instant: u32) -> u32 {
    return view * TALLY_WORDS + 32u + instant;
}

fn crowded() -> u32 {
    return view * TALLY_WORDS + 64u;
}

// Where lists begin.
fn list_of_crowded() -> u32 {
    return view * params.width * params.height;
}

fn list_of_woken(instant: u32) -> u32 {
    let list = params.view_count + view * params.lists + instant % params.lists;
    return list * params.width * params.height;
}

fn enlist(tally: u32, list: u32) {
    lists[list + atomicAdd(&report.tallies[tally], 1u)] = pixel.y * params.width + pixel.x;
}

// Tells the others how many events this pixel asks for.
fn report_steps(instant: u32) {
    if (reference < BEYOND) {
        let steps = steps_of(change_at_end());
        if (steps > 0u) {
            atomicMax(&report.tallies[peak_of(instant)], steps);
        }
    }
}

fn walk(instant: u32) {
    if (LATCH || TIMES != 0u) {
        var most = 1u;
        if (TIMES == 3u) {
            if (!SEQUENTIAL && job.mode == MODE_COUNT) {
                report_steps(instant);
            }
            most = atomicLoad(&report.tallies[peak_of(instant)]);
        }
        walk_sampled(most);
    } else {
        walk_continuous();
    }
    if (TIMED_NOISE) {
        // Those that a held pixel slept through.
        while (candidate_time() < BEYOND) {
            pass_candidate();
        }
    }
}

// From `begin` on; returns whether the pixel has come to the end.
fn take_instants(begin: u32) -> bool {
    let waits = SEQUENTIAL && job.mode != MODE_EMIT;
    // A list serves another instant once its pixels have been taken: no pixel looks farther ahead.
    let stops = waits && begin + params.lists < params.instants;
    let last = select(params.instants, begin + params.lists, stops) - 1u;
    var next = begin;
    while (next <= last) {
        var at = next;
        var is_awake = false;
        while (next <= last) {
            // A view's tiles are sampled at their own rate.
            let step = step_at(pixel, view, next);
            at = sample_from(next, step);
            if (at > last) {
                break;
            }
            set_interval(at, step);
            respond(at);
            is_awake = threshold_on < BEYOND && wakes();
            if (is_awake || in_step() || (stops && at == last)) {
                break;
            }
            advance();
            next = at + 1u;
        }
        if (waits && !(is_awake && job.mode == MODE_WAKE && at == begin)) {
            if (!is_awake && !stops) {
                return true;
            }
            if (is_awake) {
                report_steps(at);
            }
            at = min(at, last);
            enlist(woken_at(at), list_of_woken(at));
            return false;
        }
        if (at <= last) {
            if (is_awake) {
                walk(at);
            }
            advance();
        }
        next = at + 1u;
    }
    return true;
}

// From `from_us` to `to_us` since the base, at which it sees light of this number.
fn take_own_part(from_us: u32, to_us: u32, number: u32, changes: bool) {
    set_own_interval(from_us, to_us);
    var y = -1.0;
    if (changes) {
        y = light_of(number);
    }
    respond_to(y);
    sees = true;
    if (threshold_on < BEYOND && wakes()) {
        walk(0u);
    }
    advance();
}

// Through the view's block.
fn take_own_parts(own: OwnTimes) {
    let count = max(own.parts, 1u);
    let jumps = (own.flags & LIGHT_JUMPS) != 0u;
    var now = own_time(0u, count);
    // Part 0 is a jump: light was as before until the start.
    for (var part = select(1u, 0u, jumps); part <= count; part++) {
        var end = now + 1u;
        if (part > 0u) {
            end = select(own_time(part, count), block_word(3u), part == count);
        }
        if (end > now) {
            take_own_part(now, end, own.first + part, part == 0u || own.parts > 0u);
            now = end;
        }
    }
}

// Where the pixel's events go, and how many were counted: up to the next pixel's.
fn find_room(block: u32) {
    let within = cells[index];
    place = block_offsets[block] + within;
    if ((index + 1u) % BLOCK_PIXELS != 0u) {
        room = cells[index + 1u] - within;
    } else if (index + 1u < pixels()) {
        room = block_offsets[block + 1u] - place;
    } else {
        room = report.status.event_count - place;
    }
}

// Through the view's block, where times are the pixel's own; returns where that ends.
fn take_block(block: u32) -> u32 {
    let own = own_times();
    if ((own.flags & LIGHT_RESTS) != 0u) {
        return 0u;
    }
    // What is remembered are ages at the end of the view's last block, where this one begins.
    let begin = own_time(0u, 1u);
    moved += i32(begin);
    fired += i32(begin);
    find_candidates(begin, block);
    take_own_parts(own);
    return block_word(3u);
}

// Through all instants from the first one of the dispatch on; returns whether the pixel has come to the end.
fn take_all_instants(block: u32) -> bool {
    let begin = job.instant;
    // A pixel's first interval may have begun before the first instant.
    let first_step = step_at(pixel, view, begin);
    find_candidates(params.spans[sample_from(begin, first_step) + 1u - first_step].x, block);
    return take_instants(begin);
}

fn take_pixel(at: vec2<u32>, of_view: u32) {
    load_pixel(at, of_view);
    let block = index / BLOCK_PIXELS;
    let wakes_here = job.mode == MODE_WAKE;
    let emits = job.mode == MODE_EMIT;
    written = 0u;
    if (emits) {
        find_room(block);
    }
    if (wakes_here) {
        written = cells[index];
    }
    load_memory(wakes_here);
    var is_done = true;
    var end = 0u;
    if (OWN_TIMES) {
        end = take_block(block);
    } else {
        is_done = take_all_instants(block);
        let last = params.spans[params.instants - 1u];
        end = last.x + last.y;
    }
    if (emits) {
        if (written != room) {
            atomicAdd(&report.status.mismatched, 1u);
        }
        return;
    }
    cells[index] = written;
    store_memory(is_done, end);
    if (is_done && written > KEPT) {
        enlist(crowded(), list_of_crowded());
    }
}

@compute @workgroup_size(WORKGROUP)
fn main(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
) {
    if (report.status.stalled != 0u) {
        return;
    }
    view = workgroup.z;
    // Of a row, or of a list.
    var end = params.width;
    var list = 0u;
    if (job.mode != MODE_COUNT) {
        let emits = job.mode == MODE_EMIT;
        end = atomicLoad(&report.tallies[select(woken_at(job.instant), crowded(), emits)]);
        list = select(list_of_woken(job.instant), list_of_crowded(), emits);
    } else if (id.x >= params.width) {
        cells[(id.z * params.height + id.y) * params.stride + id.x] = 0u;
    }
    for (var item = id.x; item < end; item += workgroups.x * WORKGROUP) {
        var at = vec2<u32>(item, id.y);
        if (job.mode != MODE_COUNT) {
            let place = lists[list + item];
            at = vec2<u32>(place % params.width, place / params.width);
        }
        take_pixel(at, workgroup.z);
    }
    if (job.mode == MODE_EMIT) {
        return;
    }
    if (clamped != 0u) {
        atomicAdd(&report.status.clamped, clamped);
    }
    if (unknown != 0u) {
        atomicAdd(&report.status.unknown, unknown);
    }
    if (suppressed != 0u) {
        atomicAdd(&report.status.suppressed, suppressed);
    }
}
