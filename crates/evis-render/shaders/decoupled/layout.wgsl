// Which pixels, 1 being all others: of code that is never reached drivers make none.
override CLASS: u32 = 1u;
// Those that one facet fills throughout and into which no shadow comes.
const PLAIN: u32 = 0u;
// Those behind a distorted lens: each has a map of its own.
const BENT: u32 = 2u;
// Those that see facets with other maps than one of base colour.
const MAPPED: u32 = 3u;
// Those behind a distorted lens that do.
const BENT_MAPPED: u32 = 4u;
const CLASSES: u32 = 5u;

// What the host packs of a block (`packed` of evis-decoupled). Indices of a row of tiles count from the bases that
// its pixels name.

// What all pixels of a view share during a block.
struct Job {
    length_us: f32,
    // What the block begins at beyond a whole microsecond.
    start_us: f32,
    threshold_on: f32,
    threshold_off: f32,
    log_eps: f32,
    reference_luminance: f32,
    // 1 / depth of the planes between which something is seen.
    near: f32,
    far: f32,
    background: f32,
    lamps: u32,
    flags: u32,
    // Row of `kept` at which appearances of facets begin.
    looks: u32,
    // Number of the view's block; the unit at which light is found if that is all that is wanted.
    number: u32,
    // Row of `kept` at which the sky begins, its levels, 0 where `background` lies behind everything, and its texels that
    // a pixel in the middle of the picture is wide.
    sky: u32,
    sky_levels: u32,
    sky_texels: f32,
};

// What all pixels of a submission share.
struct Batch {
    // Pixels that were given, and those of tiles, which follow them.
    pixels: u32,
    // Events that fit.
    capacity: u32,
    // Workgroups per row of the dispatch.
    row: u32,
    // Row of `points` at which jobs begin.
    jobs: u32,
    // Row of `fixed` at which sums of texels begin.
    sums: u32,
    // Word of `scratch` at which light begins.
    light: u32,
    // Row of `fixed` at which texels of maps begin, and light from all around.
    texels: u32,
    around: u32,
    // Pixels that were given; tiles, and the first word of `words` with these.
    given: u32,
    tiles: u32,
    tile_words: u32,
    // Words of `scratch` at which begin what pixels remember, lists of entries of pixels of tiles, and those of them that failed.
    memories: u32,
    own: u32,
    failed: u32,
    pad_0: u32,
    pad_1: u32,
};

// Rows of a job: its own, then directions on the sky, then those of its lamps.
const HEAD_ROWS: u32 = 4u;
const SEEN_ROWS: u32 = 9u;
const LAMP_ROWS: u32 = 4u;
const JOB_ROWS: u32 = HEAD_ROWS + SEEN_ROWS + LAMP_ROWS * MOST_OWN;

// A facet in a tile.
struct Entry {
    // First of nine rows of `points`: by power and axis, of four corners.
    points: u32,
    facet: u32,
    flags: u32,
    // First row of `points` of its geometry, and of what its maps need, see lit.wgsl and maps.wgsl.
    light: u32,
    // Part of the block in which it holds.
    span: vec2<f32>,
    // Bits of lamps of which some arrives.
    lit: u32,
    // First of six words per lamp.
    shades: u32,
    // Emitted luminance over time.
    glow: vec4<f32>,
    // Bits of pixels of its tile that may see it, of those that it fills, and of those into which a shadow of what moves may come.
    touches: vec2<u32>,
    covers: vec2<u32>,
    moved: vec2<u32>,
    // How often a pixel that sees it is evaluated, and one into which such a shadow may come: units between evaluations, and from bit
    // STRIDE_BITS on those to which intervals are halved; 0 of what stays as it is.
    strides: u32,
    moved_strides: u32,
    // First word of its light's bounds.
    bounds: u32,
    pad: array<u32, 3>,
};

// A tile, whose pixels are prepared here.
struct Tile {
    // Its first pixel's middle, from the picture's centre.
    first: vec2<f32>,
    // Bits of pixels to follow, of those that see nothing of what lies behind everything, of those never followed, followed by the
    // host since, and given back.
    pixels: vec2<u32>,
    filled: vec2<u32>,
    begins: vec2<u32>,
    given: vec2<u32>,
    returned: vec2<u32>,
    // First word of what those remember that are given.
    memories: u32,
    // First of its entries, and how many.
    entries: u32,
    entry_count: u32,
    bases: u32,
    // Where lists of its pixels' entries begin.
    own: u32,
    // Index of the view, and the number of its first pixel there.
    view: u32,
    place: u32,
    // As an entry's.
    background_strides: u32,
    // First of six rows per pixel, of a distorted lens.
    frames: u32,
    pad: u32,
};

const TILE_WORDS: u32 = 22u;
const MEMORY_WORDS: u32 = 8u;
// Words of a pixel that failed: its number, and what it remembers.
const FAILED_WORDS: u32 = 1u + MEMORY_WORDS;
const NO_FRAMES: u32 = 0xffffffffu;
const STRIDE_BITS: u32 = 16u;
const STRIDE_MASK: u32 = (1u << STRIDE_BITS) - 1u;

// What a pixel remembers between blocks.
struct Memory {
    // Light at the end of a block, and at a time before that, counted from there.
    last: f32,
    before_us: f32,
    before: f32,
    // Of the reference: logarithm, and the luminances at which it fires next.
    log: f32,
    above: f32,
    below: f32,
    flags: u32,
    // Number of that block.
    number: u32,
};

// A pixel, given or prepared here, and what becomes of it.
struct Pixel {
    // From the picture's centre.
    centre: vec2<f32>,
    // First word of its entries, and how many.
    own: u32,
    own_count: u32,
    // Number in its tile.
    number: u32,
    // Five words: where its row's entries, words and points begin, the number of its job, and where its light begins.
    bases: u32,
    // Units between evaluations; then the least to which intervals are halved, or where light is wanted throughout the block
    // the number within its row at which its own begins.
    stride: u32,
    least: u32,
    // At the start of the block, then as far as it is followed.
    memory: Memory,
    flags: u32,
    evaluations: u32,
    // Something did not fit: what became of it counts for nothing.
    failed: u32,
    // First of six rows of `points`, of a distorted lens: the matrix to points of the pixel, and its inverse.
    frame: u32,
};

const ROUNDS: u32 = 64u;
// Of each round, and of the one after the last, of each class.
const ROUND_COUNTS: u32 = CLASSES * (ROUNDS + 1u);
// Workgroups that these take, along each axis.
const GROUP_COUNTS: u32 = 3u * ROUND_COUNTS;

struct Turn {
    // In which each pixel is evaluated once at most.
    round: u32,
    // 1: of the first round of a block.
    first: u32,
    pad_0: u32,
    pad_1: u32,
};

struct Event {
    pixel: u32,
    // Whole microseconds of the block, times two, and 1 of ON.
    word: u32,
};

// Pixels of a class by how many entries they have: those that take as long are listed side by side.
const COUNTS: u32 = 32u;
const BUCKETS: u32 = CLASSES * COUNTS;

struct Events {
    used: atomic<u32>,
    // Evaluations of pixels of tiles, those of them that are quiet, and those that failed.
    evaluations: atomic<u32>,
    quiet: atomic<u32>,
    failed: atomic<u32>,
    // Pixels to evaluate, by round.
    going_on: array<atomic<u32>, ROUND_COUNTS>,
    groups: array<atomic<u32>, GROUP_COUNTS>,
    // Where the pixels of each class are listed; how many have as many entries, and how many of those are listed.
    firsts: array<atomic<u32>, CLASSES>,
    buckets: array<atomic<u32>, BUCKETS>,
    listed: array<atomic<u32>, BUCKETS>,
    fired: array<Event>,
};

// Job.
const JUMPS: u32 = 1u;
const PARALLEL: u32 = 2u;
const LIGHT_ALONE: u32 = 4u;
const SENSES: u32 = 8u;
// Entry.
const DOUBLE_SIDED: u32 = 1u;
const MIRRORED: u32 = 2u;
const CROSSES_NEAR: u32 = 4u;
const CROSSES_FAR: u32 = 8u;
const UNLIT: u32 = 16u;
const HAS_MAPS: u32 = 32u;
// What it sends itself changes.
const GLOWS_APART: u32 = 64u;
// Its light is found at several places of each part of a pixel.
const SHARP: u32 = 128u;
// Its light has bounds.
const BOUNDED: u32 = 256u;
// What a pixel remembers.
const HAS_BEFORE: u32 = 1u;
const RESTED: u32 = 2u;
const BEGINS: u32 = 4u;
// Pixel.
const IS_PLAIN: u32 = 8u;
const IS_BENT: u32 = 16u;
const IS_MAPPED: u32 = 32u;
// It is not followed.
const IDLE: u32 = 64u;
// An entry of a pixel that it fills throughout.
const COVERS: u32 = 0x80000000u;

const MOST_OWN: u32 = 8u;
// Words of a lamp's shadows of an entry.
const SHADE_WORDS: u32 = 6u;
const UNITS: u32 = 3072u;
const TAU: f32 = 6.283185307179586;
// As in `signal/path.rs`: a block as short as this, in microseconds, is a cut; and light that levels are crossed on may be off by such a
// part of itself.
const INSTANT_US: f32 = 2.0;
const TOLERANCE: f32 = 0.004;
// Light, where it is all that is wanted, of a pixel that is not followed, or failed.
const NOT_FOUND: f32 = -1.0;

@group(0) @binding(0) var<uniform> batch: Batch;
@group(0) @binding(1) var<storage, read> entries: array<Entry>;
@group(0) @binding(2) var<storage, read> words: array<u32>;
@group(0) @binding(3) var<storage, read> points: array<vec4<f32>>;
// What stays from block to block: appearances of facets, and the sky.
@group(0) @binding(4) var<storage, read> kept: array<vec4<f32>>;
// Textures, and sums of texels.
@group(0) @binding(5) var<storage, read> fixed: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> pixels: array<Pixel>;
@group(0) @binding(7) var<storage, read_write> events: Events;
// Pixels to evaluate in even rounds and in odd ones; then where each of them is; then light that is wanted.
@group(0) @binding(8) var<storage, read_write> scratch: array<u32>;
@group(0) @binding(9) var<uniform> turn: Turn;

struct Bases {
    entries: u32,
    words: u32,
    points: u32,
    // Row of `points` at which directions on the sky begin, and lamps.
    seen: u32,
    lamps: u32,
    // Word of `scratch`.
    light: u32,
};

// The pixel in work.
var<private> base: Bases;
var<private> job: Job;
var<private> centre: vec2<f32>;
// Rows of the maps of a pixel behind a distorted lens.
var<private> to_pixel: mat3x3<f32>;
var<private> from_pixel: mat3x3<f32>;
var<private> number: u32;
// It is one of a tile, prepared here.
var<private> is_of_tile: bool;
var<private> failed: bool;
// Iterations of loops so far, of an evaluation. Software drivers end every loop of 8 pixels early, and report nothing, once all their
// loops together had 65535 iterations. A pixel that needs more than its own share is the processor's: which pixels are does not depend
// on those beside them.
var<private> spent: u32;
const MOST_SPENT: u32 = 8000u;

// Counts iterations that follow.
fn spend(count: u32) {
    spent += count;
    failed = failed || spent > MOST_SPENT;
}

// Goes to the row of tiles whose bases are at word `at`, and to its job.
fn enter_row(at: u32) {
    let row = batch.jobs + words[at + 3u] * JOB_ROWS;
    let seen = row + HEAD_ROWS;
    base = Bases(words[at], words[at + 1u], words[at + 2u], seen, seen + SEEN_ROWS, batch.light + words[at + 4u]);
    let a = points[row];
    let b = points[row + 1u];
    let c = points[row + 2u];
    let d = points[row + 3u];
    let numbers = bitcast<vec4<u32>>(c);
    let others = bitcast<vec4<u32>>(d);
    job = Job(
        a.x, a.y, a.z, a.w, b.x, b.y, b.z, b.w, c.x, numbers.y, numbers.z, numbers.w, others.x, others.y, others.z, d.w
    );
}

// Takes the maps of a pixel behind a distorted lens from the rows of `points` from `row` on.
fn enter_frame(row: u32) {
    to_pixel = mat3x3<f32>(points[row].xyz, points[row + 1u].xyz, points[row + 2u].xyz);
    from_pixel = mat3x3<f32>(points[row + 3u].xyz, points[row + 4u].xyz, points[row + 5u].xyz);
}

fn is_bent() -> bool {
    return CLASS == BENT || CLASS == BENT_MAPPED;
}

fn sees_maps() -> bool {
    return CLASS == MAPPED || CLASS == BENT_MAPPED;
}

// A homogeneous image point about the pixel's centre.
fn about_pixel(h: vec3<f32>) -> vec3<f32> {
    if (is_bent()) {
        return h * to_pixel;
    }
    return vec3<f32>(h.xy - centre * h.z, h.z);
}

// The image point about the picture's centre at a place in the pixel.
fn image_point(at: vec2<f32>) -> vec3<f32> {
    if (is_bent()) {
        return vec3<f32>(at, 1.0) * from_pixel;
    }
    return vec3<f32>(centre + at, 1.0);
}

// 1 / depth, as facets have it, of the plane at a depth.
fn depth_plane(inverse: f32) -> vec3<f32> {
    if (is_bent()) {
        return from_pixel[2] * inverse;
    }
    return vec3<f32>(0.0, 0.0, inverse);
}

// Homogeneous image point of a lamp about the picture's centre, and its weight: 1 for a place, 0 for a direction.
fn lamp_at(lamp: u32, u: f32) -> vec4<f32> {
    let row = base.lamps + LAMP_ROWS * lamp;
    return points[row] + u * (points[row + 1u] + u * points[row + 2u]);
}

fn lamp_strength(lamp: u32, u: f32) -> f32 {
    return wave_at(points[base.lamps + LAMP_ROWS * lamp + 3u], u);
}

// Luminance that counts as none.
fn dark_floor() -> f32 {
    return job.log_eps * job.reference_luminance;
}

// Whether a loop of `count` iterations, two or more, has them: no loop before it was ended early.
fn loops_run(count: u32) -> bool {
    var turns = 0u;
    for (var k = 0u; k < count; k++) {
        turns += 1u;
    }
    return turns == count;
}

// Where it is counted how many workgroups pixels of a class take in a round.
fn groups_at(round: u32, kind: u32) -> u32 {
    return 3u * (round * CLASSES + kind);
}

// Its class, as CLASS has it.
fn class_of(flags: u32) -> u32 {
    let bent = (flags & IS_BENT) != 0u;
    if ((flags & IS_MAPPED) != 0u) {
        return select(MAPPED, BENT_MAPPED, bent);
    }
    return select(select(1u, PLAIN, (flags & IS_PLAIN) != 0u), BENT, bent);
}

fn bucket_of(flags: u32, own_count: u32) -> u32 {
    return class_of(flags) * COUNTS + min(own_count, COUNTS - 1u);
}

// Word of `scratch` with what pixel `index`, of a tile, remembers.
fn memory_of(index: u32) -> u32 {
    return batch.memories + (index - batch.given) * MEMORY_WORDS;
}

fn memory_at(at: u32) -> Memory {
    return Memory(
        bitcast<f32>(scratch[at]),
        bitcast<f32>(scratch[at + 1u]),
        bitcast<f32>(scratch[at + 2u]),
        bitcast<f32>(scratch[at + 3u]),
        bitcast<f32>(scratch[at + 4u]),
        bitcast<f32>(scratch[at + 5u]),
        scratch[at + 6u],
        scratch[at + 7u],
    );
}

fn remember(at: u32, memory: Memory) {
    scratch[at] = bitcast<u32>(memory.last);
    scratch[at + 1u] = bitcast<u32>(memory.before_us);
    scratch[at + 2u] = bitcast<u32>(memory.before);
    scratch[at + 3u] = bitcast<u32>(memory.log);
    scratch[at + 4u] = bitcast<u32>(memory.above);
    scratch[at + 5u] = bitcast<u32>(memory.below);
    scratch[at + 6u] = memory.flags;
    scratch[at + 7u] = memory.number;
}

// Gives pixel `index`, of a tile, back to the host, with what it remembers.
fn give_back(index: u32) {
    let at = batch.failed + FAILED_WORDS * atomicAdd(&events.failed, 1u);
    scratch[at] = index;
    // No loop: a driver may end it early.
    remember(at + 1u, memory_at(memory_of(index)));
}

fn tile_at(number: u32) -> Tile {
    let at = batch.tile_words + number * TILE_WORDS;
    return Tile(
        bitcast<vec2<f32>>(vec2<u32>(words[at], words[at + 1u])),
        vec2<u32>(words[at + 2u], words[at + 3u]),
        vec2<u32>(words[at + 4u], words[at + 5u]),
        vec2<u32>(words[at + 6u], words[at + 7u]),
        vec2<u32>(words[at + 8u], words[at + 9u]),
        vec2<u32>(words[at + 10u], words[at + 11u]),
        words[at + 12u],
        words[at + 13u],
        words[at + 14u],
        words[at + 15u],
        words[at + 16u],
        words[at + 17u],
        words[at + 18u],
        words[at + 19u],
        words[at + 20u],
        words[at + 21u],
    );
}

fn has_bit(mask: vec2<u32>, pixel: u32) -> bool {
    return ((select(mask.x, mask.y, pixel >= 32u) >> (pixel % 32u)) & 1u) == 1u;
}

fn has_pixel(word: u32) -> bool {
    return ((words[base.words + word + number / 32u] >> (number % 32u)) & 1u) == 1u;
}

// Middle, half of the range, and cycles at the start of the block and during it.
fn wave_at(wave: vec4<f32>, u: f32) -> f32 {
    return max(wave.x + wave.y * sin(TAU * fract(wave.z + wave.w * u)), 0.0);
}

fn line_at(line: vec3<f32>, p: vec2<f32>) -> f32 {
    return line.x * p.x + line.y * p.y + line.z;
}

// 1 where `line` is not negative in all of the pixel, -1 where it is negative there, 0 where it crosses the pixel.
fn side_of(line: vec3<f32>) -> i32 {
    let far = reach(line);
    if (line.z < -far) {
        return -1;
    }
    return select(1, 0, line.z < far);
}

// Greatest distance of its values in the pixel from that at the centre.
fn reach(line: vec3<f32>) -> f32 {
    return 0.5 * (abs(line.x) + abs(line.y));
}

// Four corners about the pixel's centre, of nine rows that begin at `row`.
fn corners_at(row: u32, v: f32) -> array<vec3<f32>, 4> {
    let at = base.points + row;
    let x = points[at] + v * (points[at + 3u] + v * points[at + 6u]);
    let y = points[at + 1u] + v * (points[at + 4u] + v * points[at + 7u]);
    let z = points[at + 2u] + v * (points[at + 5u] + v * points[at + 8u]);
    return array<vec3<f32>, 4>(
        about_pixel(vec3<f32>(x.x, y.x, z.x)),
        about_pixel(vec3<f32>(x.y, y.y, z.y)),
        about_pixel(vec3<f32>(x.z, y.z, z.z)),
        about_pixel(vec3<f32>(x.w, y.w, z.w)),
    );
}

// a x b; nothing where both are one corner, whatever products are rounded to.
fn edge_of(a: vec3<f32>, b: vec3<f32>) -> vec3<f32> {
    return select(cross(a, b), vec3<f32>(0.0), all(a == b));
}
