#import decoupled/layout.wgsl
// The mean of a texture over a parallelogram, by sums of texels along its edges: `Textures::mean` of evis-decoupled, which
// says how. Sums are along rows, also where columns would be fewer.

const ONE_PLACE: f32 = 0.01;
const SPACING: f32 = 2.0;
const MOST_PARTS: u32 = 8u;
const GAUSS: f32 = 0.28867513;
const FLAT: f32 = 1e-6;
const MOST_TEXTURE_LINES: f32 = 128.0;
const POINT: f32 = 0.02;
const DENSITY: f32 = 2.5;
const MOST_PLACES: f32 = 16.0;
const BLUR: f32 = 0.02;

const WRAP_REPEAT: u32 = 0u;
const WRAP_CLAMP: u32 = 1u;

// Sums of a level along rows.
struct Lines {
    start: u32,
    // Texels after which a line repeats, or ends.
    period: i32,
    // Texels before the first that are kept of clamped lines.
    border: i32,
    count: i32,
    // How lines go on beyond the last one.
    wrap: u32,
};

struct TextureHead {
    // Row of `fixed` of the first level.
    levels: u32,
    level_count: u32,
    wrap_u: u32,
    wrap_v: u32,
    steps: bool,
    mean: vec3<f32>,
    // What the greatest number of its texels stands for.
    most: f32,
};

var<private> lines: Lines;
var<private> steps: bool;
// Where places count from.
var<private> from_column: i32;
var<private> from_row: i32;

fn remainder(index: i32, size: i32) -> i32 {
    let r = index % size;
    return select(r, r + size, r < 0);
}

fn wrapped(index: i32, size: i32, wrap: u32) -> i32 {
    if (wrap == WRAP_REPEAT) {
        return remainder(index, size);
    }
    if (wrap == WRAP_CLAMP) {
        return clamp(index, 0, size - 1);
    }
    let i = remainder(index, 2 * size);
    return select(2 * size - 1 - i, i, i < size);
}

fn head_of(texture: u32) -> TextureHead {
    let row = 2u * texture;
    let words = bitcast<vec4<u32>>(fixed[row]);
    return TextureHead(
        words.x,
        words.y,
        words.z & 3u,
        (words.z >> 2u) & 3u,
        (words.z & 16u) != 0u,
        fixed[row + 1u].xyz,
        fixed[row + 1u].w,
    );
}

fn size_of(head: TextureHead, level: u32) -> vec2<i32> {
    return bitcast<vec4<i32>>(fixed[head.levels + 2u * level]).xy;
}

fn lines_of(head: TextureHead, level: u32) -> Lines {
    let words = bitcast<vec4<u32>>(fixed[head.levels + 2u * level + 1u]);
    return Lines(batch.sums + words.x, i32(words.y), i32(words.z), i32(words.w), head.wrap_v);
}

fn line_start(line: i32) -> u32 {
    return lines.start + u32(wrapped(line, lines.count, lines.wrap) * (lines.period + 3));
}

// Integral of the signal of two lines from their beginning to a place, `v` of the way from one to the other.
fn upto(above: u32, below: u32, x: f32, v: f32) -> vec3<f32> {
    let whole = floor(max(x, 0.0));
    let w = x - whole;
    let u = 1.0 - w;
    let weights = select(vec3<f32>(0.5 * u * u, 0.5 + w * u, 0.5 * w * w), vec3<f32>(u, w, 0.0), steps);
    let column = i32(whole) + from_column;
    let turns = column / lines.period;
    let k = u32(column - turns * lines.period);
    let a = fixed[above + k].xyz * weights.x + fixed[above + k + 1u].xyz * weights.y
        + fixed[above + k + 2u].xyz * weights.z;
    let a_whole = a + fixed[above + u32(lines.period)].xyz * f32(turns);
    if (steps) {
        return a_whole;
    }
    let b = fixed[below + k].xyz * weights.x + fixed[below + k + 1u].xyz * weights.y
        + fixed[below + k + 2u].xyz * weights.z;
    let b_whole = b + fixed[below + u32(lines.period)].xyz * f32(turns);
    return a_whole * (1.0 - v) + b_whole * v;
}

// Integral over the height of an edge, which does not lead up, of what lies to the left of it.
fn edge_sum(start: vec2<f32>, by: vec2<f32>, scale: f32) -> vec3<f32> {
    var sum = vec3<f32>(0.0);
    if (by.y < FLAT) {
        return sum;
    }
    let slope = by.x / by.y;
    let lean = abs(slope);
    let end = start.y + by.y;
    var y = start.y;
    var row = i32(floor(y));
    var below = line_start(from_row + row);
    while (y < end && !failed) {
        let above = below;
        below = line_start(from_row + row + 1);
        let next = min(f32(row + 1), end);
        let height = next - y;
        let x = start.x + slope * (y - start.y);
        let v = y - f32(row);
        // One place, or pairs of Gauss.
        var places = 1u;
        var part = height;
        if (lean * height * height * height * scale >= ONE_PLACE) {
            let parts = min(u32(lean * height / SPACING), MOST_PARTS) + 1u;
            places = 2u * parts;
            part = height / f32(parts);
        }
        spend(1u + places);
        for (var k = 0u; k < places; k++) {
            let middle = part * (f32(k / 2u) + 0.5);
            let off = select(select(-GAUSS, GAUSS, k % 2u == 1u), 0.0, places == 1u) * part;
            let weight = select(0.5, 1.0, places == 1u) * part;
            sum += upto(above, below, x + slope * (middle + off), v + middle + off) * weight;
        }
        y = next;
        row += 1;
    }
    return sum;
}

// A texel of the level whose rows `lines` are.
fn texel_at(head: TextureHead, size: vec2<i32>, x: i32, y: i32) -> vec3<f32> {
    let column = u32(wrapped(x, size.x, head.wrap_u) + lines.border);
    let at = lines.start + u32(wrapped(y, size.y, head.wrap_v) * (lines.period + 3)) + column;
    return fixed[at + 1u].xyz - fixed[at].xyz;
}

// Between texels' middles, less the mean.
fn texels_at(head: TextureHead, size: vec2<i32>, at: vec2<f32>) -> vec3<f32> {
    if (head.steps) {
        let k = vec2<i32>(floor(at + 0.5));
        return texel_at(head, size, k.x, k.y);
    }
    let k = vec2<i32>(floor(at));
    let w = at - floor(at);
    let upper = mix(texel_at(head, size, k.x, k.y), texel_at(head, size, k.x + 1, k.y), w.x);
    let lower = mix(texel_at(head, size, k.x, k.y + 1), texel_at(head, size, k.x + 1, k.y + 1), w.x);
    return mix(upper, lower, w.y);
}

// Places along an axis of a footprint, and from one to the next.
fn places_along(axis: vec2<f32>) -> vec3<f32> {
    let texels = length(axis);
    if (texels < POINT) {
        return vec3<f32>(1.0, 0.0, 0.0);
    }
    let count = clamp(ceil(1.0 + DENSITY * texels), 2.0, MOST_PLACES);
    return vec3<f32>(count, axis / (sqrt(1.0 - 1.0 / (count * count)) * count));
}

// Mean over a grid of places about `middle`, from texels' middles.
fn mean_of_places(head: TextureHead, level: u32, middle: vec2<f32>, p: vec2<f32>, q: vec2<f32>) -> vec3<f32> {
    let size = size_of(head, level);
    let along = places_along(p);
    let down = places_along(q);
    let start = middle - 0.5 * ((along.x - 1.0) * along.yz + (down.x - 1.0) * down.yz);
    var sum = vec3<f32>(0.0);
    // No number at all counts as any.
    let rows = min(u32(down.x), u32(MOST_PLACES));
    let columns = min(u32(along.x), u32(MOST_PLACES));
    spend(rows * (columns + 1u));
    for (var j = 0u; j < rows; j++) {
        for (var i = 0u; i < columns; i++) {
            sum += texels_at(head, size, start + f32(i) * along.yz + f32(j) * down.yz);
        }
    }
    return head.mean + sum / (along.x * down.x);
}

fn level_of(p: vec2<f32>, q: vec2<f32>, levels: u32) -> u32 {
    let xx = p.x * p.x + q.x * q.x;
    let xy = p.x * p.y + q.x * q.y;
    let yy = p.y * p.y + q.y * q.y;
    let shorter = 0.5 * (xx + yy) - sqrt(0.25 * (xx - yy) * (xx - yy) + xy * xy);
    let texel = max(max(shorter, 0.0) * BLUR / 3.0 + 1.0, (xx + yy) / (MOST_TEXTURE_LINES * MOST_TEXTURE_LINES));
    var level = 0u;
    var squared = 4.0;
    while (squared <= texel && level + 1u < levels) {
        level += 1u;
        squared *= 4.0;
    }
    return level;
}

// The part of an axis that is left without a level's own blur.
fn without_blur(axis: vec2<f32>, own: f32) -> vec2<f32> {
    let squared = dot(axis, axis);
    return axis * sqrt(max(squared - own, 0.0) / max(squared, 1e-30));
}

// Mean of texture `texture` over the parallelogram about `at` with the sides `p` and `q`, in base texels from the corner of
// the first one.
fn texture_mean(texture: u32, at: vec2<f32>, p: vec2<f32>, q: vec2<f32>) -> vec3<f32> {
    let head = head_of(texture);
    if (head.level_count == 0u) {
        return vec3<f32>(1.0);
    }
    let level = level_of(p, q, head.level_count);
    let scale = vec2<f32>(size_of(head, level)) / vec2<f32>(size_of(head, 0u));
    let texel = 1.0 / max(min(scale.x, scale.y), 1e-9);
    let own = select(3.0, 1.0, head.steps) * (texel * texel - 1.0);
    let a = without_blur(p, own) * scale;
    let b = without_blur(q, own) * scale;
    let middle = at * scale - 0.5;
    let extent = abs(a) + abs(b);
    let is_point = !head.steps && extent.x < POINT && extent.y < POINT;
    lines = lines_of(head, level);
    steps = head.steps;
    // Half of its sides, in the direction in which they lead down.
    let one = a * select(-0.5, 0.5, a.y >= 0.0);
    let other = b * select(-0.5, 0.5, b.y >= 0.0);
    let area = 4.0 * (one.x * other.y - one.y * other.x);
    let middle_of = at * scale - select(0.5, 0.0, head.steps);
    let outer = vec2<f32>(abs(one.x) + abs(other.x), one.y + other.y);
    let corner = floor(middle_of - outer);
    var kept = true;
    from_column = i32(corner.x);
    if (lines.border == 0) {
        from_column = remainder(from_column, lines.period);
    } else {
        from_column += lines.border;
        kept = from_column >= 0 && f32(from_column) + 2.0 * outer.x + 2.0 < f32(lines.period);
    }
    from_row = i32(corner.y);
    if (is_point || !kept || !(abs(area) >= 1e-6) || outer.y > MOST_TEXTURE_LINES) {
        return mean_of_places(head, level, middle, a, b);
    }
    // Its two ways down from the upper corner to the lower one.
    let top = middle_of - one - other - corner;
    let edge_scale = 1.0 / abs(area);
    // One after the other along both, in either order.
    var sides = array<vec2<f32>, 2>(2.0 * one, 2.0 * other);
    var total = vec3<f32>(0.0);
    for (var k = 0u; k < 4u; k++) {
        let by = sides[(k + k / 2u) % 2u];
        let start = select(top, top + sides[k / 2u], k % 2u == 1u);
        total += select(-1.0, 1.0, k < 2u) * edge_sum(start, by, edge_scale);
    }
    return head.mean + total / area;
}
