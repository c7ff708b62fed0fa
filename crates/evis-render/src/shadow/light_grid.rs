//! What may throw a shadow on a point, by where the point lies in a shadow map: of each cell of the map, which triangles are
//! seen in it from the light. A ray from a point to the light is a point of the map, so it can meet no others, and most cells
//! have a few: fewer than a ray visits nodes of a tree.

use std::ops::RangeInclusive;

use glam::{DMat4, DVec2, DVec4, Vec3};

/// Cells along a map's edge; `raster/occluders.wgsl` has the same constant.
pub const CELLS: u32 = 1024;

/// Triangles of a cell beyond which a tree is faster.
const MOST: usize = 32;

/// What stands for that in place of a number; `raster/occluders.wgsl` has the same constant.
pub const CROWDED: u32 = u32::MAX;

/// Triangles of all cells together, at most: 32 MB.
const MOST_ENTRIES: usize = 8 << 20;

/// Words of all trees and lists together: 128 MB, which every device binds. A f32 is exact up to twice as many.
const MOST_WORDS: usize = 1 << 23;

/// Cells by which triangles are larger than they are: more than rounding moves points and rays.
const MARGIN: f64 = 0.01;

/// What is nearer to a light's plane than this has no place in its map.
const LEAST_W: f64 = 1e-6;

/// Appends the cells of the map that `clip_from_world` draws to `words`, then their lists of `triangles`, each of which stands
/// at a place of `words`. Returns where they begin; `None` where there are too many.
pub fn append(
    words: &mut Vec<[u32; 4]>,
    triangles: &[(u32, [Vec3; 3])],
    clip_from_world: &DMat4,
) -> Option<u32> {
    let rows = rows(triangles, clip_from_world)?;
    let mut starts = vec![0u32; (CELLS * CELLS) as usize + 1];
    for (_, row) in &rows {
        for cell in row.clone() {
            starts[cell as usize + 1] += 1;
        }
    }
    for cell in 1..starts.len() {
        starts[cell] += starts[cell - 1];
    }
    let mut next = starts.clone();
    let mut entries = vec![0u32; starts[starts.len() - 1] as usize];
    for (triangle, row) in rows {
        for cell in row {
            entries[next[cell as usize] as usize] = triangle;
            next[cell as usize] += 1;
        }
    }
    let list = |cell: usize| &entries[starts[cell] as usize..starts[cell + 1] as usize];
    let first = words.len();
    let header = (CELLS * CELLS / 2) as usize;
    let mut lists: Vec<[u32; 4]> = Vec::new();
    let mut cells: Vec<[u32; 2]> = Vec::with_capacity(2 * header);
    for cell in 0..2 * header {
        let own = list(cell);
        // What is seen next to it is mostly the same.
        let above = cell.checked_sub(CELLS as usize);
        let same = [cell.checked_sub(1), above].into_iter().flatten().find(|other| list(*other) == own);
        cells.push(match same {
            Some(other) => cells[other],
            None if own.len() > MOST => [0, CROWDED],
            None => {
                let at = (first + header + lists.len()) as u32;
                lists.extend(
                    own.chunks(4).map(|four| std::array::from_fn(|i| four.get(i).copied().unwrap_or(0))),
                );
                [at, own.len() as u32]
            }
        });
    }
    if first + header + lists.len() >= MOST_WORDS {
        return None;
    }
    words.extend(cells.chunks_exact(2).map(|pair| [pair[0][0], pair[0][1], pair[1][0], pair[1][1]]));
    words.extend(lists);
    Some(first as u32)
}

/// The rows of cells in which each triangle is seen, in order of triangles.
fn rows(triangles: &[(u32, [Vec3; 3])], clip_from_world: &DMat4) -> Option<Vec<(u32, RangeInclusive<u32>)>> {
    let mut rows = Vec::new();
    let mut entries = 0;
    for (at, corners) in triangles {
        let clip = corners.map(|corner| *clip_from_world * corner.as_dvec3().extend(1.0));
        let polygon: Vec<DVec2> = in_front(&clip).into_iter().map(place).collect();
        for row in cells_of(&polygon) {
            entries += row.clone().count();
            if entries > MOST_ENTRIES {
                return None;
            }
            rows.push((*at, row));
        }
    }
    Some(rows)
}

/// The part of a triangle in clip space that lies before the light.
fn in_front(corners: &[DVec4; 3]) -> Vec<DVec4> {
    let mut kept = Vec::new();
    for (i, a) in corners.iter().enumerate() {
        let b = corners[(i + 1) % 3];
        if a.w >= LEAST_W {
            kept.push(*a);
        }
        if (a.w >= LEAST_W) != (b.w >= LEAST_W) {
            kept.push(a.lerp(b, (LEAST_W - a.w) / (b.w - a.w)));
        }
    }
    kept
}

/// Where a point of clip space lies, in cells from the upper left.
fn place(clip: DVec4) -> DVec2 {
    let ndc = clip.truncate().truncate() / clip.w;
    f64::from(CELLS) * DVec2::new(0.5 + 0.5 * ndc.x, 0.5 - 0.5 * ndc.y)
}

/// The cells that a convex polygon touches, row by row.
fn cells_of(polygon: &[DVec2]) -> Vec<RangeInclusive<u32>> {
    let last = f64::from(CELLS - 1);
    // From `low` to `high` as whole cells, if any.
    let cells = |low: f64, high: f64| {
        let (low, high) = ((low - MARGIN).floor(), (high + MARGIN).floor());
        (high >= 0.0 && low <= last).then(|| low.max(0.0) as u32..=high.min(last) as u32)
    };
    let extent = |of: fn(&DVec2) -> f64| {
        let all = polygon.iter().map(of);
        (all.clone().fold(f64::INFINITY, f64::min), all.fold(f64::NEG_INFINITY, f64::max))
    };
    let (top, bottom) = extent(|p| p.y);
    let Some(rows) = cells(top, bottom) else { return Vec::new() };
    let across = |row: u32| {
        let (from, to) = (f64::from(row) - MARGIN, f64::from(row + 1) + MARGIN);
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for (i, a) in polygon.iter().enumerate() {
            let b = polygon[(i + 1) % polygon.len()];
            if a.y.max(b.y) < from || a.y.min(b.y) > to {
                continue;
            }
            for y in [a.y.clamp(from, to), b.y.clamp(from, to)] {
                let x =
                    if a.y == b.y { [a.x, b.x] } else { [a.x + (b.x - a.x) * ((y - a.y) / (b.y - a.y)); 2] };
                low = low.min(x[0]).min(x[1]);
                high = high.max(x[0]).max(x[1]);
            }
        }
        let row = row * CELLS;
        cells(low, high).map(|cells| row + cells.start()..=row + cells.end())
    };
    rows.filter_map(across).collect()
}

#[cfg(test)]
mod tests {
    use glam::{DMat4, DVec3};

    use super::*;

    /// Numbers in 0..1 from a counter.
    fn dice(n: u32) -> f64 {
        let mut x = n.wrapping_mul(0x9e37_79b9) ^ 0x85eb_ca6b;
        x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
        x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
        f64::from(x >> 8) / f64::from(1 << 24)
    }

    fn point(n: u32) -> DVec3 {
        DVec3::new(dice(3 * n), dice(3 * n + 1), dice(3 * n + 2)) - 0.5
    }

    /// As shadow.rs draws a map from the origin along -z, as wide as it is deep.
    fn spot() -> DMat4 {
        DMat4::from_cols_array_2d(&[
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, -1.0],
            [0.0, 0.0, 0.01, 0.0],
        ])
    }

    /// The same from far away: 10 by 10 by 10.
    fn sun() -> DMat4 {
        DMat4::from_scale_rotation_translation(
            DVec3::new(0.2, 0.2, 0.1),
            Default::default(),
            DVec3::new(0.0, 0.0, 0.5),
        )
    }

    fn meets(triangle: &[Vec3; 3], from: DVec3, to: DVec3) -> bool {
        let [a, b, c] = triangle.map(|v| v.as_dvec3());
        let (e1, e2, direction) = (b - a, c - a, to - from);
        let p = direction.cross(e2);
        let scale = 1.0 / e1.dot(p);
        let s = from - a;
        let q = s.cross(e1);
        let (u, v, t) = (s.dot(p) * scale, direction.dot(q) * scale, e2.dot(q) * scale);
        u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 && t < 1.0
    }

    /// Twin of `follow_still`: the list of the cell in which `at` is seen; `None` where it is too long.
    fn list(words: &[[u32; 4]], first: u32, clip_from_world: &DMat4, at: DVec3) -> Option<Vec<u32>> {
        let place = place(*clip_from_world * at.extend(1.0));
        let cell = place.y as u32 * CELLS + place.x as u32;
        let pair = words[(first + cell / 2) as usize];
        let [start, count] = if cell & 1 == 1 { [pair[2], pair[3]] } else { [pair[0], pair[1]] };
        (count != CROWDED)
            .then(|| (0..count).map(|i| words[(start + i / 4) as usize][(i % 4) as usize]).collect())
    }

    #[test]
    fn a_ray_to_the_light_meets_nothing_that_is_not_listed() {
        // Large and small, some behind the light.
        let triangles: Vec<(u32, [Vec3; 3])> = (0..400)
            .map(|i| {
                let at = point(4 * i) * 10.0 + DVec3::new(0.0, 0.0, -3.0);
                let size = if i % 7 == 0 { 8.0 } else { 0.5 };
                let corner = |k| (at + point(4 * i + k) * size).as_vec3();
                (1000 + 3 * i, [corner(1), corner(2), corner(3)])
            })
            .collect();
        for (clip, toward) in [(spot(), DVec3::ZERO), (sun(), DVec3::INFINITY)] {
            let mut words = vec![[7; 4]; 5];
            let first = append(&mut words, &triangles, &clip).unwrap();
            assert_eq!((first, words[4]), (5, [7; 4]));
            let (mut met, mut listed, mut asked) = (0, 0, 0);
            for n in 0..4000 {
                let at = point(50_000 + n) * DVec3::new(6.0, 6.0, 3.0) - DVec3::Z * 3.2;
                let seen = place(clip * at.extend(1.0));
                if seen.min_element() < 0.0 || seen.max_element() >= f64::from(CELLS) {
                    continue;
                }
                let light = if toward.is_finite() { toward } else { at + DVec3::Z * 20.0 };
                let own = list(&words, first, &clip, at).unwrap();
                for (place, triangle) in &triangles {
                    if meets(triangle, at, light) {
                        assert!(own.contains(place), "ray {n} meets {place}: {own:?}");
                        met += 1;
                    }
                }
                listed += own.len();
                asked += 1;
            }
            assert!(met > 1000 && asked > 1000, "{met} of {asked}");
            // Behind a spot light lies more than before it: of what is listed, most is met or lies behind the point.
            assert!(listed < 20 * asked, "{listed} for {asked} rays through 400 triangles");
        }
    }

    #[test]
    fn crowds_are_left_to_the_tree() {
        let one = (0, [Vec3::new(0.0, 0.0, -2.0), Vec3::new(0.1, 0.0, -2.0), Vec3::new(0.0, 0.1, -2.0)]);
        for (count, crowded) in [(MOST, false), (MOST + 1, true)] {
            let mut words = Vec::new();
            let first = append(&mut words, &vec![one; count], &spot()).unwrap();
            let at = DVec3::new(0.02, 0.02, -2.5);
            assert_eq!(list(&words, first, &spot(), at).is_none(), crowded);
            let beside = list(&words, first, &spot(), DVec3::new(-1.0, -1.0, -2.5));
            assert_eq!(beside, Some(Vec::new()));
        }
    }

    #[test]
    fn polygons_touch_the_cells_that_they_cross() {
        let cells = |polygon: &[[f64; 2]]| {
            let polygon: Vec<DVec2> = polygon.iter().map(|p| DVec2::from(*p)).collect();
            cells_of(&polygon)
                .into_iter()
                .flatten()
                .map(|cell| (cell % CELLS, cell / CELLS))
                .collect::<Vec<_>>()
        };
        assert_eq!(cells(&[[2.5, 3.5], [2.6, 3.5], [2.5, 3.6]]), [(2, 3)]);
        assert_eq!(cells(&[[0.5, 0.5], [1.5, 1.5], [0.5, 1.5]]), [(0, 0), (1, 0), (0, 1), (1, 1)]);
        // Along a border both sides.
        assert_eq!(cells(&[[4.0, 1.2], [4.0, 1.8], [4.0, 1.5]]), [(3, 1), (4, 1)]);
        // Outside, and reaching in.
        assert_eq!(cells(&[[-9.0, 1.0], [-2.0, 1.0], [-2.0, 3.0]]), []);
        let most = f64::from(CELLS);
        assert_eq!(cells(&[[most - 0.5, 0.5], [most + 5.0, 0.5], [most + 5.0, 0.7]]), [(CELLS - 1, 0)]);
        assert_eq!(cells(&[]), []);
    }
}
