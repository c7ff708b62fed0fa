#import chain/pixel.wgsl
// Count, emit and peak of the whole chain: one pipeline, so that both walks of a pixel are computed alike. The old memory
// stays until the submission is known to fit.

// The pixel's first strike after `time`.
fn find_strikes(time: u32, block: u32) {
    if (!STRIKES) {
        return;
    }
    let lane = pixel.x % BLOCK_PIXELS;
    var low = feed[block];
    var high = feed[block + 1u];
    strikes_end = high;
    while (low < high) {
        let middle = low + (high - low) / (2u * STRIKE_WORDS) * STRIKE_WORDS;
        let other = feed[middle + 1u] & 63u;
        if (other < lane || (other == lane && feed[middle] <= time)) {
            low = middle + STRIKE_WORDS;
        } else {
            high = middle;
        }
    }
    strike = low;
}

fn peak_of(instant: u32) -> u32 {
    return view * 32u + instant;
}

// Tells the others how many events this pixel asks for at an instant that its memory has come to, where it is sampled.
fn report_peak(instant: u32) {
    let step = step_at(pixel, view, instant);
    if (sample_from(instant, step) != instant) {
        return;
    }
    set_interval(instant, step);
    respond(instant);
    report_steps(instant);
}

// Tells the others how many events this pixel asks for.
fn report_steps(instant: u32) {
    if (threshold_on < BEYOND && reference < BEYOND) {
        let steps = steps_of(change_at_end());
        if (steps > 0u) {
            atomicMax(&report.peaks[peak_of(instant)], steps);
        }
    }
}

fn take_interval(instant: u32, step: u32) {
    set_interval(instant, step);
    respond(instant);
    if (threshold_on < BEYOND && wakes()) {
        if (LATCH || TIMES != 0u) {
            var most = 1u;
            if (TIMES == 3u) {
                if (!SEQUENTIAL && job.mode == MODE_COUNT) {
                    report_steps(instant);
                }
                most = atomicLoad(&report.peaks[peak_of(instant)]);
            }
            walk_sampled(most);
        } else {
            walk_continuous();
        }
    }
    if (STRIKES) {
        // Those that a held pixel slept through.
        for (; strike < strikes_end && strike_time() < BEYOND; strike += STRIKE_WORDS) {}
    }
    advance();
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

@compute @workgroup_size(WORKGROUP)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(workgroup_id) workgroup: vec3<u32>) {
    if (report.status.stalled != 0u) {
        return;
    }
    index = (id.z * params.height + id.y) * params.stride + id.x;
    // A workgroup is a block.
    let block = (workgroup.z * params.height + workgroup.y) * (params.stride / BLOCK_PIXELS) + workgroup.x;
    if (id.x >= params.width) {
        if (job.mode == MODE_COUNT) {
            cells[index] = 0u;
        }
        return;
    }
    let emits = job.mode == MODE_EMIT;
    if (emits) {
        find_room(block);
        if (room == 0u) {
            return;
        }
    }
    load_pixel(id, workgroup);
    load_memory(job.first != 0u);
    if (job.mode == MODE_PEAK) {
        report_peak(job.first);
        return;
    }
    // A pixel's first interval may have begun before the job's first instant.
    let first_step = step_at(pixel, view, job.first);
    find_strikes(params.spans[sample_from(job.first, first_step) + 1u - first_step].x, block);
    var next = job.first;
    while (next < job.end) {
        // A view's tiles are sampled at their own pace.
        let step = step_at(pixel, view, next);
        let at = sample_from(next, step);
        next = at + 1u;
        if (at < job.end) {
            take_interval(at, step);
        }
    }
    if (emits) {
        if (written != room) {
            atomicAdd(&report.status.mismatched, 1u);
        }
        return;
    }
    let last = job.end == params.instants;
    let end = params.spans[job.end - 1u];
    if (job.first == 0u) {
        cells[index] = written;
    } else {
        cells[index] += written;
    }
    store_memory(last, end.x + end.y);
    if (clamped != 0u) {
        atomicAdd(&report.status.clamped, clamped);
    }
    if (unknown != 0u) {
        atomicAdd(&report.status.unknown, unknown);
    }
    if (suppressed != 0u) {
        atomicAdd(&report.status.suppressed, suppressed);
    }
    if (SEQUENTIAL && !last) {
        report_peak(job.end);
    }
}
