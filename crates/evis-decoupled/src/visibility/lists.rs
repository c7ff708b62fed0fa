//! Which facets each tile of 8x8 pixels, and each pixel in it, may see during a block.
//!
//! Everything here is conservative: over a block an edge function is a quartic in time, and lies within the hull of its
//! Bernstein coefficients; what these keep out of a pixel never comes into it. Order is that of facets.

use std::sync::Arc;

use glam::{DVec3, Vec4};
use rayon::prelude::*;

use crate::Error;
use crate::scene::facets::{ALONE, CORNERS, corners, wide};
use crate::scene::screen::Depths;
use crate::scene::tiles::{LensTiles, TILE, TileView, rect};
use crate::scene::world::World;
use crate::visibility::blocks::{Clock, Span};

/// Part of the depth by which a surface must lie behind a plane to be hidden by it.
const COPLANAR: f64 = 1e-9;

/// A facet during a part of a block.
#[derive(Clone, Debug)]
pub struct Record {
    /// Index into [`World::facets`].
    pub facet: u32,
    /// Part of the block in which it holds.
    pub u: [f64; 2],
    /// Homogeneous image points as quadratics of the span's own time in [0, 1]: `[power][x z, y z, z][corner]`.
    pub points: [[[f64; CORNERS]; 3]; 3],
    /// A corner comes nearer than the near plane.
    pub crosses_near: bool,
    /// A corner goes farther than the far plane.
    pub crosses_far: bool,
    /// It shows the same side throughout.
    pub one_side: bool,
    /// Then that is its front.
    front: bool,
    /// Both sides are drawn.
    pub double_sided: bool,
    /// Its pose mirrors: the outside is where corners run clockwise.
    pub mirrored: bool,
    /// Bernstein coefficients of its edge functions, inside above 0; meaningless where it does not show one side.
    edges: [[DVec3; 5]; CORNERS],
    /// Plane of 1/depth at the start, middle and end.
    inverse_depth: [DVec3; 3],
    /// It is where it is throughout.
    pub still: bool,
    /// Box around its image: left, top, right, bottom in pixels.
    pub rect: [f64; 4],
    /// Least and greatest depth of its corners.
    depth: [f64; 2],
}

/// A record in a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Index into [`Lists::records`].
    pub record: u32,
    /// Pixels that may see it, row by row from bit 0.
    pub touches: u64,
    /// Pixels that it covers throughout the block.
    pub covers: u64,
    /// Pixels that each of its edges may enter.
    crossed: [u64; CORNERS],
    /// Pixels whose centres it covers at the start of its span.
    at_start: u64,
}

impl Entry {
    /// Takes `pixels` from it.
    fn hide(&mut self, pixels: u64) {
        self.touches &= !pixels;
        self.covers &= !pixels;
    }
}

/// What a tile may show during a block.
#[derive(Clone, Debug, Default)]
pub struct TileList {
    /// In the order of facets, then of time.
    pub entries: Vec<Entry>,
    /// Pixels that they fill throughout: what lies behind everything is not seen there.
    pub filled: u64,
}

/// Pixels of a tile that facets of one surface cover together throughout a block.
struct Sheet {
    /// Of which entries of the tile.
    entries: std::ops::Range<usize>,
    pixels: u64,
    /// All of it lies nearer than this.
    depth: f64,
}

/// What a block may show.
pub struct Lists {
    /// In the order of facets, then of time.
    pub records: Vec<Record>,
    /// Per row of tiles, the records whose boxes touch it.
    rows: Vec<Vec<u32>>,
    /// Tiles per row.
    pub columns: usize,
    /// Depths between which something is seen.
    pub depths: Depths,
    /// Where they are, of a distorted lens.
    tiles: Option<Arc<LensTiles>>,
    /// Largest error of any record in pixels, of those that could not be split far enough.
    pub worst_error_px: f64,
}

impl Lists {
    /// Records of what may be in the picture during the block of `clock`.
    ///
    /// # Errors
    /// A camera without a pose.
    pub fn new(world: &World, clock: &mut Clock) -> Result<Self, Error> {
        let mut work: Vec<(usize, usize)> = Vec::new();
        let mut spans: Vec<Vec<Span>> = Vec::with_capacity(world.surfaces.len());
        let mut mirrored = Vec::with_capacity(world.surfaces.len());
        let ends = clock.ends()?;
        let depths = ends[0].depths;
        for (index, surface) in world.surfaces.iter().enumerate() {
            spans.push(clock.spans(index as u32)?);
            let pose = ends[0].world_from_node(surface.node);
            let skinned = surface.deforms && world.scene.nodes[surface.node].skin.is_some();
            mirrored.push(!skinned && pose.determinant() < 0.0);
            work.extend(surface.clusters.clone().map(|cluster| (index, cluster)));
        }
        let worst_error_px = spans.iter().flatten().map(|s| s.error_px).fold(0.0, f64::max);
        let found: Vec<Vec<Record>> = work
            .par_iter()
            .map(|&(surface, cluster)| {
                of_cluster(world, (surface, cluster), &spans[surface], mirrored[surface], &depths)
            })
            .collect();
        let mut records = Vec::with_capacity(found.iter().map(Vec::len).sum());
        records.extend(found.into_iter().flatten());
        let size = [world.lens.width, world.lens.height].map(|v| (v as usize).div_ceil(TILE));
        let mut rows = vec![Vec::new(); size[1]];
        for (index, record) in records.iter().enumerate() {
            if let Some(tiles) = &world.tiles {
                let meeting = |row: usize| tiles.row(row).iter().any(|tile| tile.meets(record.rect));
                let all = rows.iter_mut().enumerate();
                all.filter(|(row, _)| meeting(*row)).for_each(|(_, row)| row.push(index as u32));
                continue;
            }
            let [from, to] = [record.rect[1], record.rect[3]].map(|y| tile_of(y, size[1]));
            for row in &mut rows[from..=to] {
                row.push(index as u32);
            }
        }
        Ok(Self { records, rows, columns: size[0], depths, tiles: world.tiles.clone(), worst_error_px })
    }

    /// Calls `visit` with the columns of those tiles of row `row` into which something that moves may come.
    pub fn moving_columns(&self, row: usize, mut visit: impl FnMut(usize)) {
        let moving = self.rows[row].iter().map(|index| &self.records[*index as usize]).filter(|r| !r.still);
        for record in moving {
            if let Some(tiles) = &self.tiles {
                let met = tiles.row(row).iter().enumerate().filter(|(_, tile)| tile.meets(record.rect));
                met.for_each(|(column, _)| visit(column));
            } else {
                let [from, to] = [record.rect[0], record.rect[2]].map(|x| tile_of(x, self.columns));
                (from..=to).for_each(&mut visit);
            }
        }
    }

    /// Rows of tiles.
    pub fn row_count(&self) -> usize {
        self.rows.len()
    }

    /// What the tiles of row `row` may show of `world`, from left to right.
    pub fn row(&self, world: &World, row: usize) -> Vec<TileList> {
        self.row_where(world, row, |_| true)
    }

    /// The same, of those of which `wanted` says so by their column; nothing of the others.
    pub fn row_where(&self, world: &World, row: usize, wanted: impl Fn(usize) -> bool) -> Vec<TileList> {
        let mut tiles = vec![TileList::default(); self.columns];
        for &index in &self.rows[row] {
            let record = &self.records[index as usize];
            if let Some(views) = &self.tiles {
                let all = tiles.iter_mut().zip(views.row(row)).enumerate();
                for (_, (tile, view)) in all.filter(|(column, _)| wanted(*column)) {
                    let met = view.pixels != 0 && view.meets(record.rect);
                    tile.entries
                        .extend(met.then(|| record.entry_through(index, view, &self.depths)).flatten());
                }
                continue;
            }
            let [from, to] = [record.rect[0], record.rect[2]].map(|x| tile_of(x, self.columns));
            let met = tiles.iter_mut().enumerate().take(to + 1).skip(from);
            for (column, tile) in met.filter(|(column, _)| wanted(*column)) {
                if let Some(entry) = record.entry(index, [column, row], &self.depths) {
                    tile.entries.push(entry);
                }
            }
        }
        for (column, TileList { entries, filled }) in tiles.iter_mut().enumerate() {
            *filled = entries.iter().fold(0, |pixels, entry| pixels | entry.covers);
            let tiles = self.tiles.as_ref();
            let rect = tiles.map_or_else(|| rect([column, row]), |tiles| tiles.row(row)[column].rect);
            for sheet in &self.sheets(world, entries, rect) {
                *filled |= sheet.pixels;
                self.hide_behind(sheet, entries, rect);
            }
            self.hide(entries);
        }
        tiles
    }

    /// Pixels that the facets of a surface cover together.
    ///
    /// Where every edge that may enter a pixel has a neighbour beyond it that shows the same side and may be there, too, the
    /// surface has no border in the pixel at any time: it covers all of it throughout if it covers any place of it at any time.
    /// The tile sees no more than `rect`.
    fn sheets(&self, world: &World, entries: &[Entry], rect: [f64; 4]) -> Vec<Sheet> {
        let record = |entry: &Entry| &self.records[entry.record as usize];
        let surface = |entry: &Entry| world.facets[record(entry).facet as usize].surface;
        let mut sheets = Vec::new();
        let mut first = 0;
        for own in entries.chunk_by(|a, b| surface(a) == surface(b)) {
            let at = first..first + own.len();
            first = at.end;
            if own.len() < 2 || own.iter().all(|entry| entry.at_start == 0) {
                continue;
            }
            // All facets of a surface have the same spans.
            let mut spans: Vec<[f64; 2]> = Vec::new();
            for entry in own {
                let u = record(entry).u;
                if !spans.contains(&u) {
                    spans.push(u);
                }
            }
            let times: f64 = spans.iter().map(|u| u[1] - u[0]).sum();
            let within = |u: [f64; 2]| self.within_span(world, own, u, rect);
            let pixels = if times < 1.0 { 0 } else { spans.into_iter().fold(u64::MAX, |p, u| p & within(u)) };
            if pixels != 0 {
                let seen = own.iter().filter(|entry| entry.touches & pixels != 0);
                let depth = seen.map(|entry| record(entry).depth[1]).fold(0.0, f64::max);
                sheets.push(Sheet { entries: at, pixels, depth });
            }
        }
        sheets
    }

    /// Pixels that the entries `own` of one surface cover throughout their span `u`.
    fn within_span(&self, world: &World, own: &[Entry], u: [f64; 2], rect: [f64; 4]) -> u64 {
        let record = |entry: &Entry| &self.records[entry.record as usize];
        let entries = || own.iter().filter(|entry| record(entry).u == u);
        let mut pixels = entries().fold(0, |pixels, entry| pixels | entry.at_start);
        for entry in entries() {
            let here = record(entry);
            if !here.goes_on(rect, &self.depths) {
                pixels &= !entry.touches;
                continue;
            }
            for (edge, other) in world.neighbors[here.facet as usize].into_iter().enumerate() {
                let mut open = entry.crossed[edge] & entry.touches & pixels;
                if open != 0
                    && other != ALONE
                    && let Ok(at) = own.binary_search_by(|entry| {
                        let there = record(entry);
                        there.facet.cmp(&other).then(there.u[0].total_cmp(&u[0]))
                    })
                    && record(&own[at]).front == here.front
                {
                    open &= !own[at].touches;
                }
                pixels &= !open;
            }
        }
        pixels
    }

    /// Takes from each entry the pixels in which `sheet` hides it; the tile sees no more than `rect`.
    fn hide_behind(&self, sheet: &Sheet, entries: &mut [Entry], rect: [f64; 4]) {
        for (number, entry) in entries.iter_mut().enumerate() {
            if entry.touches & sheet.pixels != 0
                && !sheet.entries.contains(&number)
                && self.records[entry.record as usize].is_beyond(sheet.depth, rect)
            {
                entry.hide(sheet.pixels);
            }
        }
    }

    /// Takes from each entry the pixels in which another one hides it throughout.
    fn hide(&self, tile: &mut Vec<Entry>) {
        for front in 0..tile.len() {
            let covers = tile[front].covers;
            if covers == 0 {
                continue;
            }
            let occluder = &self.records[tile[front].record as usize];
            for (back, entry) in tile.iter_mut().enumerate() {
                if back != front && entry.touches & covers != 0 {
                    let hidden = &self.records[entry.record as usize];
                    if occluder.hides(hidden) {
                        entry.hide(covers);
                    }
                }
            }
        }
        tile.retain(|entry| entry.touches != 0);
    }
}

fn tile_of(pixel: f64, count: usize) -> usize {
    ((pixel.max(0.0) as usize) / TILE).min(count - 1)
}

/// Quadratic through three values at 0, 1/2 and 1, by power.
pub fn powers<T>([a, b, c]: [T; 3]) -> [T; 3]
where
    T: Copy + std::ops::Mul<f64, Output = T> + std::ops::Add<Output = T>,
{
    [a, a * -3.0 + b * 4.0 + c * -1.0, a * 2.0 + b * -4.0 + c * 2.0]
}

/// Homogeneous image points as quadratics of time, `[power][x z, y z, z][corner]`, about `centre`: rows by power and axis.
pub fn rows_about(points: &[[[f64; CORNERS]; 3]; 3], centre: [f64; 2]) -> [[f32; CORNERS]; 9] {
    std::array::from_fn(|row| {
        let (power, axis) = (row / 3, row % 3);
        let offset = centre.get(axis).copied().unwrap_or(0.0);
        std::array::from_fn(|k| (points[power][axis][k] - offset * points[power][2][k]) as f32)
    })
}

/// Bernstein coefficients of the same quadratic.
fn bernstein([a, b, c]: [DVec3; 3]) -> [DVec3; 3] {
    [a, b * 2.0 - (a + c) * 0.5, c]
}

/// Whether all `points` are outside one side of the picture, nearer than the near plane, or farther than the far one.
fn outside(points: impl Iterator<Item = DVec3> + Clone, seen: [f64; 4], depths: &Depths) -> bool {
    let all = |f: &dyn Fn(DVec3) -> bool| points.clone().all(f);
    all(&|p| p.z < depths.near)
        || all(&|p| p.z > depths.far)
        || all(&|p| p.x < seen[0] * p.z)
        || all(&|p| p.y < seen[1] * p.z)
        || all(&|p| p.x > seen[2] * p.z)
        || all(&|p| p.y > seen[3] * p.z)
}

fn of_cluster(
    world: &World,
    (surface, cluster): (usize, usize),
    spans: &[Span],
    mirrored: bool,
    depths: &Depths,
) -> Vec<Record> {
    let seen = world.seen();
    let s = &world.surfaces[surface];
    let cluster = &world.clusters[cluster];
    let primitive = world.primitive(surface as u32);
    let mut out = Vec::new();
    for (index, span) in spans.iter().enumerate() {
        if !s.deforms {
            let [low, high] = cluster.bounds;
            let hull = corners(low, high).map(|p| bernstein(span.places.of(0, p)));
            if outside(hull.into_iter().flatten(), seen, depths) {
                continue;
            }
        }
        for facet in cluster.facets.clone() {
            let h =
                world.facets[facet].corners.map(|c| span.places.of(c, wide(primitive.positions[c as usize])));
            if let Some(mut record) = Record::new(h, depths, s.double_sided, mirrored)
                && record.rect[0] < seen[2]
                && record.rect[1] < seen[3]
                && record.rect[2] > seen[0]
                && record.rect[3] > seen[1]
            {
                record.facet = facet as u32;
                record.u = span.u;
                out.push((facet, index, record));
            }
        }
    }
    out.sort_by_key(|(facet, span, _)| (*facet, *span));
    out.into_iter().map(|(.., record)| record).collect()
}

impl Record {
    /// From corners' homogeneous image points at the start, middle and end; `None` where nothing of it is seen.
    fn new(h: [[DVec3; 3]; CORNERS], depths: &Depths, double_sided: bool, mirrored: bool) -> Option<Self> {
        let hull = h.map(bernstein);
        let all = hull.iter().flatten().map(|p| p.z);
        let depth = [all.clone().fold(f64::INFINITY, f64::min), all.fold(f64::NEG_INFINITY, f64::max)];
        if !depth[1].is_finite() || depth[1] < depths.near || depth[0] > depths.far {
            return None;
        }
        let at = [0, 1, 2].map(|k| h.map(|corner| corner[k]));
        // Negative where corners run counter-clockwise towards the camera.
        let volume = at.map(|[a, b, _, d]| a.dot(b.cross(d)));
        let bend = (volume[0] - 2.0 * volume[1] + volume[2]).abs();
        let least = volume.iter().copied().fold(f64::INFINITY, f64::min);
        let most = volume.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let one_side = least - bend > 0.0 || most + bend < 0.0;
        let front = if mirrored { least - bend > 0.0 } else { most + bend < 0.0 };
        if one_side && !front && !double_sided {
            return None;
        }
        let sign = if most + bend < 0.0 { -1.0 } else { 1.0 };
        let mut edges = [[DVec3::ZERO; 5]; CORNERS];
        if one_side {
            for (k, edge) in edges.iter_mut().enumerate() {
                let (p, q) = (hull[k], hull[(k + 1) % CORNERS]);
                let c = |i: usize, j: usize| p[i].cross(q[j]);
                let e = [
                    c(0, 0),
                    (c(0, 1) + c(1, 0)) * 0.5,
                    (c(0, 2) + c(1, 1) * 4.0 + c(2, 0)) / 6.0,
                    (c(1, 2) + c(2, 1)) * 0.5,
                    c(2, 2),
                ];
                // Of the size of pixels.
                let scale = e.iter().map(|v| v.x.abs() + v.y.abs()).fold(0.0, f64::max);
                if scale > 0.0 {
                    *edge = e.map(|v| v * (sign / scale));
                }
            }
        }
        let inverse_depth = [0, 1, 2].map(|k| {
            let [a, b, _, d] = at[k];
            (b.cross(d) + d.cross(a) + a.cross(b)) / volume[k]
        });
        let crosses_near = depth[0] < depths.near;
        let crosses_far = depth[1] > depths.far;
        let rect = swept_rect(&hull, depths.near)?;
        let still = h.iter().all(|[a, b, c]| a == b && b == c);
        let p = h.map(|h| if still { [h[0], DVec3::ZERO, DVec3::ZERO] } else { powers(h) });
        let points = std::array::from_fn(|power| {
            std::array::from_fn(|axis| std::array::from_fn(|corner| p[corner][power][axis]))
        });
        Some(Self {
            facet: 0,
            u: [0.0, 1.0],
            points,
            crosses_near,
            crosses_far,
            one_side,
            front,
            double_sided,
            mirrored,
            edges,
            inverse_depth,
            still,
            rect,
            depth,
        })
    }

    fn whole_block(&self) -> bool {
        self.u == [0.0, 1.0]
    }

    /// Its entry in the tile at (column, row); `None` where no pixel of it may see it.
    fn entry(&self, index: u32, tile: [usize; 2], depths: &Depths) -> Option<Entry> {
        let rect = rect(tile);
        let whole = self.whole_block() && self.goes_on(rect, depths);
        let [left, top, ..] = rect;
        self.entry_at((index, whole), ([left, top], 0.0), self.pixels_of_rect(left, top), &self.edges)
    }

    /// The same of a tile of a distorted lens.
    fn entry_through(&self, index: u32, view: &TileView, depths: &Depths) -> Option<Entry> {
        let edges = self.edges.map(|edge| edge.map(|line| view.line(line)));
        let whole = self.whole_block() && self.goes_on(view.rect, depths);
        self.entry_at((index, whole), ([-0.5 * TILE as f64; 2], view.margin), view.pixels, &edges)
    }

    /// Its entry in a tile whose left top corner is at (`left`, `top`) in the coordinates of `edges`, among the pixels `touches`,
    /// which lie elsewhere by `margin` at most. `whole` says that nothing but its edges ends it there, at any time.
    fn entry_at(
        &self,
        (index, whole): (u32, bool),
        ([left, top], margin): ([f64; 2], f64),
        mut touches: u64,
        edges: &[[DVec3; 5]; CORNERS],
    ) -> Option<Entry> {
        let half = 0.5 * TILE as f64;
        let middle = DVec3::new(left + half, top + half, 1.0);
        let (mut covers, mut at_start, mut crossed) = (u64::MAX, u64::MAX, [0; CORNERS]);
        if !whole {
            covers = 0;
        }
        if self.one_side {
            for (edge, crossed) in edges.iter().zip(&mut crossed) {
                let (mut most, mut least) = (f64::NEG_INFINITY, f64::INFINITY);
                for e in edge {
                    let (value, reach) = (e.dot(middle), (half + margin) * (e.x.abs() + e.y.abs()));
                    most = most.max(value + reach);
                    least = least.min(value - reach);
                }
                if most < 0.0 {
                    return None;
                }
                if least < 0.0 {
                    let pixels = pixels_of_edge(edge, left, top, margin);
                    touches &= pixels.within;
                    covers &= pixels.throughout;
                    at_start &= pixels.at_start;
                    *crossed = pixels.within & !pixels.throughout;
                }
            }
        }
        let (covers, at_start) = (covers & touches, at_start & touches);
        (touches != 0).then_some(Entry { record: index, touches, covers, crossed, at_start })
    }

    fn pixels_of_rect(&self, left: f64, top: f64) -> u64 {
        let range = |low: f64, high: f64, start: f64| {
            let from = (low - start).floor().clamp(0.0, TILE as f64) as u32;
            let to = (high - start).ceil().clamp(0.0, TILE as f64) as u32;
            if from < to { (0xff_u64 >> (8 - (to - from))) << from } else { 0 }
        };
        let columns = range(self.rect[0], self.rect[2], left);
        let rows = range(self.rect[1], self.rect[3], top);
        (0..TILE).filter(|y| rows >> y & 1 == 1).fold(0, |mask, y| mask | columns << (8 * y))
    }

    /// Whether nothing of `other` is seen where this covers.
    fn hides(&self, other: &Self) -> bool {
        if !other.whole_block() || other.depth[1] < self.depth[0] {
            return false;
        }
        let (mut all_coplanar, mut behind) = (true, true);
        for corner in 0..CORNERS {
            let f = [0.0, 0.5, 1.0].map(|v| other.point(corner, v));
            let f = [0, 1, 2].map(|k| self.inverse_depth[k].dot(f[k]) - 1.0);
            let bend = (f[0] - 2.0 * f[1] + f[2]).abs();
            all_coplanar &= f.iter().all(|f| f.abs() < COPLANAR);
            behind &= f.iter().all(|f| *f - bend > -COPLANAR);
        }
        // Of facets in one plane the first is seen.
        behind && (!all_coplanar || self.facet < other.facet)
    }

    /// Whether it shows one side throughout its span, and image points in `rect` show nothing of it that a plane of the camera
    /// cuts.
    fn goes_on(&self, rect: [f64; 4], depths: &Depths) -> bool {
        let clear = |crosses: bool, of: &dyn Fn([f64; 2]) -> bool| !crosses || of(self.inverse_depths(rect));
        self.one_side
            && clear(self.crosses_near, &|[_, most]| most < (1.0 - COPLANAR) / depths.near)
            && clear(self.crosses_far, &|[least, _]| least > (1.0 + COPLANAR) / depths.far)
    }

    /// Whether what image points in `rect` show of it lies farther than `depth`.
    fn is_beyond(&self, depth: f64, rect: [f64; 4]) -> bool {
        self.depth[0] > depth || self.one_side && self.inverse_depths(rect)[1] < (1.0 - COPLANAR) / depth
    }

    /// Least and greatest 1/depth of its plane over `rect` during its span; it shows one side.
    fn inverse_depths(&self, rect: [f64; 4]) -> [f64; 2] {
        let mut range = [f64::INFINITY, f64::NEG_INFINITY];
        for [x, y] in [[0, 1], [2, 1], [0, 3], [2, 3]] {
            let q = self.inverse_depth.map(|plane| plane.dot(DVec3::new(rect[x], rect[y], 1.0)));
            let bend = (q[0] - 2.0 * q[1] + q[2]).abs();
            let [least, most] = [f64::min, f64::max].map(|of: fn(f64, f64) -> f64| of(of(q[0], q[1]), q[2]));
            range = [range[0].min(least - bend), range[1].max(most + bend)];
        }
        range
    }

    /// Homogeneous image point of `corner` at `v` of its span.
    pub(crate) fn point(&self, corner: usize, v: f64) -> DVec3 {
        let [p, q, r] = &self.points;
        DVec3::from_array([0, 1, 2].map(|axis| p[axis][corner] + v * (q[axis][corner] + v * r[axis][corner])))
    }
}

/// Pixels of a tile by where they lie of an edge during a block.
struct EdgePixels {
    /// Inside, in part or at some time, maybe.
    within: u64,
    /// Inside throughout.
    throughout: u64,
    /// Their centres inside at the start.
    at_start: u64,
}

/// Where the pixels of a tile lie of an edge.
fn pixels_of_edge(edge: &[DVec3; 5], left: f64, top: f64, margin: f64) -> EdgePixels {
    // What rounding to 32 bits may add; edges are of unit gradient, about.
    const SLACK: f32 = 1e-4;
    let mut most = [Vec4::NEG_INFINITY; TILE * TILE / 4];
    let mut least = [Vec4::INFINITY; TILE * TILE / 4];
    let mut first = [Vec4::ZERO; TILE * TILE / 4];
    for (k, e) in edge.iter().enumerate() {
        let corner = e.dot(DVec3::new(left + 0.5, top + 0.5, 1.0)) as f32;
        let (a, b) = (e.x as f32, e.y as f32);
        let reach = (0.5 + margin as f32) * (a.abs() + b.abs());
        let off = margin as f32 * (a.abs() + b.abs());
        let across = Vec4::new(0.0, 1.0, 2.0, 3.0) * a;
        for y in 0..TILE {
            let start = corner + b * y as f32;
            for (half, across) in [across, across + 4.0 * a].into_iter().enumerate() {
                let value = start + across;
                let slot = 2 * y + half;
                most[slot] = most[slot].max(value + reach);
                least[slot] = least[slot].min(value - reach);
                if k == 0 {
                    first[slot] = value - off;
                }
            }
        }
    }
    let bits = |values: &[Vec4; TILE * TILE / 4], least: f32| {
        let of = |(k, v): (usize, &Vec4)| u64::from(v.cmpge(Vec4::splat(least)).bitmask()) << (4 * k);
        values.iter().enumerate().map(of).fold(0, |a, b| a | b)
    };
    EdgePixels { within: bits(&most, -SLACK), throughout: bits(&least, SLACK), at_start: bits(&first, SLACK) }
}

/// Box around the image of a hull; `None` where all of it is nearer than `near`.
fn swept_rect(hull: &[[DVec3; 3]; CORNERS], near: f64) -> Option<[f64; 4]> {
    let mut rect = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    let mut add = |p: DVec3| {
        let (x, y) = (p.x / p.z, p.y / p.z);
        rect = [rect[0].min(x), rect[1].min(y), rect[2].max(x), rect[3].max(y)];
    };
    let points: Vec<DVec3> = hull.iter().flatten().copied().collect();
    let mut clipped = false;
    for p in &points {
        if p.z >= near {
            add(*p);
        } else {
            clipped = true;
        }
    }
    if clipped {
        // The part of a hull beyond a plane is the hull of its points there and of where segments between two pass it.
        for (i, a) in points.iter().enumerate() {
            for b in &points[i + 1..] {
                if (a.z >= near) != (b.z >= near) {
                    let mut p = *a + (*b - *a) * ((near - a.z) / (b.z - a.z));
                    p.z = near;
                    add(p);
                }
            }
        }
    }
    rect[0].is_finite().then_some(rect)
}

impl Record {
    /// How far, in pixels, what is seen near image point `at` at the start moves until the end of the span.
    pub fn motion_px(&self, at: [f64; 2]) -> f64 {
        let from = [0, 1, 2, 3].map(|k| self.point(k, 0.0));
        let to = [0, 1, 2, 3].map(|k| self.point(k, 1.0));
        let d = DVec3::new(at[0], at[1], 1.0);
        let across = from[1].cross(from[3]);
        let weights = [across.dot(d), from[3].cross(from[0]).dot(d), from[0].cross(from[1]).dot(d)];
        let sum: f64 = weights.iter().sum();
        // A point of the facet, whatever lies at `at`.
        let [s, t] = [weights[1], weights[2]].map(|w| {
            let w = w / sum;
            if w.is_finite() { w.clamp(0.0, 1.0) } else { 0.5 }
        });
        let place = |h: &[DVec3; 4]| h[0] + (h[1] - h[0]) * s + (h[3] - h[0]) * t;
        let (a, b) = (place(&from), place(&to));
        let near = self.depth[0].max(1e-3).min(a.z.abs().max(1e-3));
        let (za, zb) = (a.z.max(near), b.z.max(near));
        (b.x / zb - a.x / za).hypot(b.y / zb - a.y / za)
    }
}
