#import decoupled/layout.wgsl
// Convex polygons in the pixel, in three lists, out of which others are cut. The third keeps what is seen of all facets.

const LIST_CORNERS: u32 = 72u;
const LIST_POLYGONS: u32 = 14u;
const ALL_CORNERS: u32 = 3u * LIST_CORNERS;
const ALL_POLYGONS: u32 = 3u * LIST_POLYGONS;
const KEPT: u32 = 2u;
// Corners of a polygon in work.
const MOST_CORNERS: u32 = 14u;
// Part of a line's change over the pixel by which rounding may move it.
const TOUCHING: f32 = 2e-6;

var<private> list_corners: array<vec2<f32>, ALL_CORNERS>;
var<private> list_ends: array<u32, ALL_POLYGONS>;
var<private> list_count: array<u32, 3>;
// Corners in the list, those of an unfinished polygon included.
var<private> list_used: array<u32, 3>;
// Half planes whose intersection is cut out.
var<private> cutters: array<vec3<f32>, 7>;
var<private> parts: array<vec2<f32>, 28>;
var<private> part_count: array<u32, 2>;

struct Moments {
    area: f32,
    first: vec2<f32>,
    // Of x x, x y and y y.
    second: vec3<f32>,
};

const NO_VARIANCE: f32 = 1e-9;

// A parallelogram about `middle` that has the moments of an area.
struct Sides {
    middle: vec2<f32>,
    along: vec2<f32>,
    down: vec2<f32>,
};

fn sides_of(m: Moments) -> Sides {
    let at = m.first / m.area;
    let v = m.second / m.area - vec3<f32>(at.x * at.x, at.x * at.y, at.y * at.y);
    // Cholesky: a unit square has the variance 1/12 along each side.
    let l = sqrt(max(v.x, NO_VARIANCE));
    let across = v.y / l;
    let n = sqrt(max(v.z - across * across, 0.0));
    let side = sqrt(12.0);
    return Sides(at, vec2<f32>(side * l, side * across), vec2<f32>(0.0, side * n));
}

fn whole_pixel() -> Moments {
    return Moments(1.0, vec2<f32>(0.0), vec3<f32>(1.0 / 12.0, 0.0, 1.0 / 12.0));
}

fn minus_moments(a: Moments, b: Moments) -> Moments {
    return Moments(a.area - b.area, a.first - b.first, a.second - b.second);
}

fn clear_list(list: u32) {
    list_count[list] = 0u;
    list_used[list] = 0u;
}

fn push_corner(list: u32, corner: vec2<f32>) {
    if (list_used[list] == LIST_CORNERS) {
        failed = true;
        return;
    }
    list_corners[list * LIST_CORNERS + list_used[list]] = corner;
    list_used[list] += 1u;
}

// Where the polygon in work of a list begins.
fn polygon_start(list: u32, polygon: u32) -> u32 {
    if (polygon == 0u) {
        return 0u;
    }
    return list_ends[list * LIST_POLYGONS + polygon - 1u];
}

// Ends a polygon, and forgets what has no area.
fn close_polygon(list: u32) {
    let start = polygon_start(list, list_count[list]);
    if (list_used[list] - start < 3u) {
        list_used[list] = start;
        return;
    }
    if (list_count[list] == LIST_POLYGONS) {
        failed = true;
        list_used[list] = start;
        return;
    }
    list_ends[list * LIST_POLYGONS + list_count[list]] = list_used[list];
    list_count[list] += 1u;
}

// Polygons `first` up to `end` of a list.
struct Range {
    list: u32,
    first: u32,
    end: u32,
};

fn all_of(list: u32) -> Range {
    return Range(list, 0u, list_count[list]);
}

// Where the corners of a polygon begin, and where they end.
fn corners_of(list: u32, polygon: u32) -> vec2<u32> {
    let ends = vec2<u32>(polygon_start(list, polygon), list_ends[list * LIST_POLYGONS + polygon]);
    return ends + list * LIST_CORNERS;
}

fn copy_polygon(corners: vec2<u32>, to: u32) {
    for (var c = corners.x; c < corners.y; c++) {
        push_corner(to, list_corners[c]);
    }
    close_polygon(to);
}

// Appends a list to those that are kept.
fn keep_list(list: u32) -> Range {
    let first = list_count[KEPT];
    spend(list_count[list] + list_used[list]);
    for (var polygon = 0u; polygon < list_count[list] && !failed; polygon++) {
        copy_polygon(corners_of(list, polygon), KEPT);
    }
    return Range(KEPT, first, list_count[KEPT]);
}

fn push_part(part: u32, corner: vec2<f32>) {
    if (part_count[part] == MOST_CORNERS) {
        failed = true;
        return;
    }
    parts[part * MOST_CORNERS + part_count[part]] = corner;
    part_count[part] += 1u;
}

// What of part `source` lies inside `line` goes to the other part, what lies outside to list `rest`.
fn cut_part(source: u32, line: vec3<f32>, rest: u32) {
    let into = 1u - source;
    part_count[into] = 0u;
    let count = part_count[source];
    var a = parts[source * MOST_CORNERS + count - 1u];
    var va = line_at(line, a);
    for (var k = 0u; k < count; k++) {
        let b = parts[source * MOST_CORNERS + k];
        let vb = line_at(line, b);
        if ((va >= 0.0) != (vb >= 0.0)) {
            let p = a + (va / (va - vb)) * (b - a);
            push_part(into, p);
            push_corner(rest, p);
        }
        if (vb >= 0.0) {
            push_part(into, b);
        } else {
            push_corner(rest, b);
        }
        a = b;
        va = vb;
    }
    close_polygon(rest);
}

// What of the polygons of `range` lies outside of the intersection of the first `lines` cutters goes to list `to`.
fn subtract_from(range: Range, to: u32, lines: u32) {
    clear_list(to);
    for (var polygon = range.first; polygon < range.end && !failed; polygon++) {
        let corners = corners_of(range.list, polygon);
        let count = corners.y - corners.x;
        // Each line meets all corners, and cuts a polygon that it gave one more; corners are copied.
        spend(1u + count + lines * (2u * count + lines + 2u));
        var crossing = 0u;
        var beside = false;
        for (var k = 0u; k < lines && !beside; k++) {
            let line = cutters[k];
            let touching = TOUCHING * (abs(line.x) + abs(line.y));
            var inside = false;
            var outside = false;
            for (var c = corners.x; c < corners.y; c++) {
                let v = line_at(line, list_corners[c]);
                inside |= v > touching;
                outside |= v < -touching;
            }
            beside = !inside;
            crossing |= select(0u, 1u << k, outside);
        }
        if (beside) {
            copy_polygon(corners, to);
            continue;
        }
        if (crossing == 0u) {
            continue;
        }
        part_count[0] = 0u;
        for (var c = corners.x; c < corners.y; c++) {
            push_part(0u, list_corners[c]);
        }
        var current = 0u;
        for (var k = 0u; k < lines; k++) {
            if (((crossing >> k) & 1u) == 0u) {
                continue;
            }
            cut_part(current, cutters[k], to);
            current = 1u - current;
            if (part_count[current] < 3u) {
                break;
            }
        }
    }
}

fn moments_of(list: u32) -> Moments {
    var m = Moments(0.0, vec2<f32>(0.0), vec3<f32>(0.0));
    spend(list_count[list] + list_used[list]);
    for (var polygon = 0u; polygon < list_count[list]; polygon++) {
        let corners = corners_of(list, polygon);
        var a = list_corners[corners.y - 1u];
        for (var c = corners.x; c < corners.y; c++) {
            let b = list_corners[c];
            let turn = a.x * b.y - b.x * a.y;
            m.area += 0.5 * turn;
            m.first += turn * (a + b) / 6.0;
            m.second += turn * vec3<f32>(
                (a.x * a.x + a.x * b.x + b.x * b.x) / 12.0,
                (a.x * b.y + 2.0 * (a.x * a.y + b.x * b.y) + b.x * a.y) / 24.0,
                (a.y * a.y + a.y * b.y + b.y * b.y) / 12.0,
            );
            a = b;
        }
    }
    return m;
}
