//! What throws shadows, as trees of triangles that a fragment casts rays through.
//!
//! A shadow map says whether a point is lit where its texels agree. Along a shadow's border, where they do not, a ray decides
//! (`shaders/raster/occluders.wgsl`): borders are then as sharp as the geometry, at any size of the world.
//! What never moves is one tree in world space, and sorted into the cells of the maps of lights that do not move either; each
//! mesh that moves has a tree in its own space, and a matrix per instant.

use std::collections::HashMap;
use std::ops::Range;

use evis_core::ConfigError;
use evis_scene::{AlphaMode, Scene, SceneState};
use glam::{DMat4, Vec3};

use crate::gpu::uniforms::OccluderRecord;
use crate::shadow::light_grid;
use crate::shadow::plan::{LightView, ShadowPlan, alike, states};
use crate::world::gpu_scene::{GpuScene, Object};
use crate::world::image_bounds::Extent;

/// Triangles of a leaf, at most. Three bits of a leaf's word hold the number.
const LEAF_TRIANGLES: usize = 4;

/// Where a tree ends; also the root of an empty one.
pub const END: u32 = u32::MAX;

/// Words (of four numbers) of a node and of a triangle.
const NODE_WORDS: usize = 2;

const TRIANGLE_WORDS: usize = 3;

/// Places at which a split is tried along each axis.
const BINS: usize = 16;

/// The trees of a scene.
#[derive(Clone, Debug, Default)]
pub struct Occluders {
    /// Nodes and triangles: what the device reads.
    pub words: Vec<[u32; 4]>,
    /// Per environment: root of what never moves there.
    still_roots: Vec<u32>,
    /// Per environment and light that throws shadows: where the cells of its map begin, if it has any.
    cells: Vec<Vec<Option<u32>>>,
    /// What moves.
    moving: Vec<Moving>,
}

/// A node that moves.
#[derive(Clone, Copy, Debug)]
struct Moving {
    /// One of its objects.
    object: usize,
    /// Of its tree.
    root: u32,
    /// The least and the greatest of its corners.
    extent: Extent,
}

/// The objects that move, by node: what belongs to a node moves alike.
fn moving(objects: &[Object]) -> Vec<(usize, Vec<usize>)> {
    let mut found: Vec<(usize, Vec<usize>)> = Vec::new();
    for (o, object) in objects.iter().enumerate().filter(|(_, object)| object.moving) {
        match found.iter_mut().find(|(node, _)| *node == object.node) {
            Some((_, members)) => members.push(o),
            None => found.push((object.node, vec![o])),
        }
    }
    found
}

/// Why rays do not know the shadow of `object`; `None` where they do.
pub fn ray_shadow_obstacle(scene: &Scene, object: &Object) -> Option<&'static str> {
    if object.skin.is_some() || object.morph.is_some() {
        return Some("it deforms");
    }
    (scene.materials[object.material].alpha != AlphaMode::Opaque).then_some("its material has holes")
}

impl Occluders {
    /// Of `scene`, whose streams start at `start_us` of its time, and of what `plan` draws maps of.
    ///
    /// # Errors
    /// Something deforms or has holes cut into it: such casters are not in trees.
    pub fn new(
        scene: &Scene,
        gpu_scene: &GpuScene,
        plan: &ShadowPlan,
        start_us: i64,
    ) -> Result<Self, ConfigError> {
        let objects = &gpu_scene.objects;
        for object in objects {
            if let Some(why) = ray_shadow_obstacle(scene, object) {
                let name = &scene.nodes[object.node].name;
                let remedy =
                    format!("`maps` in this scene: rays do not know the shadow of {name:?}, since {why}");
                return Err(ConfigError::new("shadows", "rays", remedy));
            }
        }
        let mut trees = Self::default();
        let local = |o: usize| {
            let object = &objects[o];
            let mesh = scene.nodes[object.node].mesh;
            mesh.map(|m| &scene.meshes[m].primitives[object.primitive])
        };
        let triangles = |o: usize, place: &DMat4| -> Vec<[Vec3; 3]> {
            let Some(primitive) = local(o) else { return Vec::new() };
            let corner = |i: u32| {
                place.transform_point3(Vec3::from(primitive.positions[i as usize]).as_dvec3()).as_vec3()
            };
            primitive.indices.chunks_exact(3).map(|t| [corner(t[0]), corner(t[1]), corner(t[2])]).collect()
        };
        let states = states(scene, start_us);
        // Environments that place everything alike share a tree.
        let still: Vec<usize> = (0..objects.len()).filter(|&o| !objects[o].moving).collect();
        let nodes: Vec<usize> = still.iter().map(|&o| objects[o].node).collect();
        let mut roots = Vec::new();
        for (state, placement) in states.iter().zip(alike(&states, &nodes)) {
            if placement as usize == roots.len() {
                let world = still.iter().flat_map(|&o| triangles(o, &state.world_from_node[objects[o].node]));
                let world = world.collect();
                roots.push(trees.push(world));
            }
            trees.still_roots.push(roots[placement as usize]);
        }
        trees.sort_into_cells(scene, plan, &states);
        let mut roots = HashMap::new();
        for (node, members) in moving(objects) {
            let mesh = || members.iter().flat_map(|&o| triangles(o, &DMat4::IDENTITY)).collect();
            let root = *roots.entry(scene.nodes[node].mesh).or_insert_with(|| trees.push(mesh()));
            let extents = members.iter().filter_map(|&o| objects[o].extent);
            let join = |a: Extent, b: Extent| (a.0.min(b.0), a.1.max(b.1));
            let extent = extents.reduce(join).unwrap_or_default();
            trees.moving.push(Moving { object: members[0], root, extent });
        }
        Ok(trees)
    }

    /// Root of what never moves in `environment`.
    pub fn still_root(&self, environment: usize) -> u32 {
        self.still_roots.get(environment).copied().unwrap_or(END)
    }

    /// Lists what never moves for the lights that do not either, in each of `states`.
    fn sort_into_cells(&mut self, scene: &Scene, plan: &ShadowPlan, states: &[SceneState]) {
        // Environments share what is alike.
        let mut done: Vec<(u32, DMat4, Option<u32>)> = Vec::new();
        for (environment, state) in states.iter().enumerate() {
            let root = self.still_roots[environment];
            let mut of = |(view, moves): (LightView, &bool)| {
                let clip = view.clip_from_world;
                if *moves || root == END {
                    return None;
                }
                if let Some((.., cells)) =
                    done.iter().find(|(tree, other, _)| *tree == root && *other == clip)
                {
                    return *cells;
                }
                let triangles = leaves(&self.words, root);
                let cells = light_grid::append(&mut self.words, &triangles, &clip);
                done.push((root, clip, cells));
                cells
            };
            let cells = plan.matrices(scene, state).zip(plan.light_moves()).map(&mut of).collect();
            self.cells.push(cells);
        }
    }

    /// Where the cells of the map of light `layer` begin in `environment`; 0 where it has none.
    pub fn cells(&self, environment: usize, layer: u32) -> u32 {
        let of = self.cells.get(environment).and_then(|of| of.get(layer as usize)).copied();
        of.flatten().unwrap_or_default()
    }

    /// What moves, where `world` (per object) has it.
    pub fn records<'a>(&'a self, world: &'a [DMat4]) -> impl Iterator<Item = OccluderRecord> + 'a {
        self.moving.iter().map(|&Moving { object, root, extent: (low, high) }| {
            let place = &world[object];
            let middle = place.transform_point3(0.5 * (low + high));
            let reach = crate::world::image_bounds::corners(low, high)
                .map(|corner| place.transform_point3(corner).distance(middle))
                .into_iter()
                .fold(0.0, f64::max);
            // Wider than rounding.
            let reach = reach * 1.0001 + 1e-5 * (1.0 + middle.abs().max_element());
            let sphere = [middle.x as f32, middle.y as f32, middle.z as f32, reach as f32];
            // What is flattened to nothing throws no shadow.
            let (inverse, root) =
                if place.determinant() == 0.0 { (DMat4::IDENTITY, END) } else { (place.inverse(), root) };
            let [object_row_0, object_row_1, object_row_2] = crate::world::transform::rows(&inverse);
            let [pad_0, pad_1, pad_2] = [0; 3];
            OccluderRecord { sphere, object_row_0, object_row_1, object_row_2, root, pad_0, pad_1, pad_2 }
        })
    }

    /// Every ray visits trees alone, and asks for what moves within `reach`.
    #[cfg(test)]
    pub fn forget_cells(&mut self, reach: f64) {
        self.cells.clear();
        for moving in &mut self.moving {
            moving.extent = (glam::DVec3::splat(-reach), glam::DVec3::splat(reach));
        }
    }

    /// Things that move.
    pub fn moving_count(&self) -> u32 {
        self.moving.len() as u32
    }

    /// Adds a tree and returns its root.
    fn push(&mut self, triangles: Vec<[Vec3; 3]>) -> u32 {
        if triangles.is_empty() {
            return END;
        }
        let root = self.words.len() as u32;
        let mut items: Vec<Item> = triangles.into_iter().map(Item::new).collect();
        let node = Node::new(&mut items, 0);
        self.push_node(&node, &items, END);
        root
    }

    /// Adds `node` and all below it, in the order in which a ray visits them. `skip`: where a ray goes on that misses the node.
    fn push_node(&mut self, node: &Node, items: &[Item], skip: u32) {
        let leaf_at = (self.words.len() + NODE_WORDS) as u32;
        let leaf = if node.children.is_some() { 0 } else { leaf_at << 3 | node.items.len() as u32 };
        // Wider than rounding in the shader's slab test can miss.
        let margin = node.bounds.low.abs().max(node.bounds.high.abs()).max_element() * 4e-6;
        let (low, high) = (node.bounds.low - margin, node.bounds.high + margin);
        self.words.push([low.x.to_bits(), low.y.to_bits(), low.z.to_bits(), skip]);
        self.words.push([high.x.to_bits(), high.y.to_bits(), high.z.to_bits(), leaf]);
        match &node.children {
            Some(children) => {
                let [front, back] = &**children;
                self.push_node(front, items, leaf_at + front.words as u32);
                self.push_node(back, items, skip);
            }
            None => {
                for item in &items[node.items.clone()] {
                    let [a, b, c] = item.corners;
                    let edge = |v: Vec3| [v.x.to_bits(), v.y.to_bits(), v.z.to_bits(), 0];
                    self.words.extend([edge(a), edge(b - a), edge(c - a)]);
                }
            }
        }
    }
}

/// The triangles of the tree at `root`, and where each stands.
fn leaves(words: &[[u32; 4]], root: u32) -> Vec<(u32, [Vec3; 3])> {
    let corner = |at: u32| {
        let [x, y, z, _] = words[at as usize].map(f32::from_bits);
        Vec3::new(x, y, z)
    };
    let mut found = Vec::new();
    let mut at = root;
    while at != END {
        let high = words[at as usize + 1];
        let (count, first) = (high[3] & 7, high[3] >> 3);
        for place in (0..count).map(|i| first + i * TRIANGLE_WORDS as u32) {
            let a = corner(place);
            found.push((place, [a, a + corner(place + 1), a + corner(place + 2)]));
        }
        // As if every ray met every node.
        at = if count == 0 { at + NODE_WORDS as u32 } else { words[at as usize][3] };
    }
    found
}

/// A part of a tree that is being made.
struct Node {
    bounds: Bounds,
    /// What is below it.
    items: Range<usize>,
    children: Option<Box<[Self; 2]>>,
    /// Words that it takes.
    words: usize,
}

impl Node {
    /// Sorts `items`, the first of which is number `first`.
    fn new(items: &mut [Item], first: usize) -> Self {
        let bounds = items.iter().fold(Bounds::EMPTY, |b, item| b.join(&item.bounds));
        let range = first..first + items.len();
        match split(items) {
            None => {
                let words = NODE_WORDS + items.len() * TRIANGLE_WORDS;
                Self { bounds, items: range, children: None, words }
            }
            Some(middle) => {
                let (front, back) = items.split_at_mut(middle);
                let children = [Self::new(front, first), Self::new(back, first + middle)];
                let words = NODE_WORDS + children[0].words + children[1].words;
                Self { bounds, items: range, children: Some(Box::new(children)), words }
            }
        }
    }
}

/// A triangle to be put into a tree.
#[derive(Clone, Copy, Debug)]
struct Item {
    corners: [Vec3; 3],
    bounds: Bounds,
}

impl Item {
    fn new(corners: [Vec3; 3]) -> Self {
        let [a, b, c] = corners;
        Self { corners, bounds: Bounds { low: a.min(b).min(c), high: a.max(b).max(c) } }
    }
}

#[derive(Clone, Copy, Debug)]
struct Bounds {
    low: Vec3,
    high: Vec3,
}

impl Bounds {
    const EMPTY: Self = Self { low: Vec3::INFINITY, high: Vec3::NEG_INFINITY };

    fn join(&self, other: &Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    fn center(&self) -> Vec3 {
        0.5 * (self.low + self.high)
    }

    /// Half of the surface.
    fn area(&self) -> f32 {
        let d = (self.high - self.low).max(Vec3::ZERO);
        d.x * d.y + d.y * d.z + d.z * d.x
    }
}

/// Sorts `items` into two parts and returns where the second starts, by the surface area heuristic over bins (I. Wald, "On
/// fast Construction of SAH-based Bounding Volume Hierarchies", 2007); `None` for a leaf.
fn split(items: &mut [Item]) -> Option<usize> {
    if items.len() <= LEAF_TRIANGLES {
        return None;
    }
    let centers = items.iter().fold(Bounds::EMPTY, |b, item| {
        let c = item.bounds.center();
        b.join(&Bounds { low: c, high: c })
    });
    let size = centers.high - centers.low;
    let mut best: Option<(f32, usize, usize)> = None;
    for axis in 0..3 {
        if size[axis] <= 0.0 {
            continue;
        }
        let mut bins = [(0_usize, Bounds::EMPTY); BINS];
        for item in &*items {
            let (count, bounds) = &mut bins[bin(item, axis, &centers)];
            *count += 1;
            *bounds = bounds.join(&item.bounds);
        }
        for at in 1..BINS {
            let side = |bins: &[(usize, Bounds)]| {
                bins.iter().fold((0, Bounds::EMPTY), |(n, b), (count, bounds)| (n + count, b.join(bounds)))
            };
            let ((n, left), (m, right)) = (side(&bins[..at]), side(&bins[at..]));
            if n == 0 || m == 0 {
                continue;
            }
            let cost = n as f32 * left.area() + m as f32 * right.area();
            if best.is_none_or(|(least, ..)| cost < least) {
                best = Some((cost, axis, at));
            }
        }
    }
    // All centres in one place: any halves will do.
    let Some((_, axis, at)) = best else { return Some(items.len() / 2) };
    items.sort_by_key(|item| bin(item, axis, &centers) >= at);
    Some(items.iter().take_while(|item| bin(item, axis, &centers) < at).count())
}

fn bin(item: &Item, axis: usize, centers: &Bounds) -> usize {
    let share = (item.bounds.center()[axis] - centers.low[axis]) / (centers.high[axis] - centers.low[axis]);
    ((share * BINS as f32) as usize).min(BINS - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corner(word: [u32; 4]) -> Vec3 {
        let [x, y, z, _] = word.map(f32::from_bits);
        Vec3::new(x, y, z)
    }

    fn meets([a, b, c]: [Vec3; 3], origin: Vec3, direction: Vec3) -> bool {
        let (e1, e2) = (b - a, c - a);
        let p = direction.cross(e2);
        let scale = 1.0 / e1.dot(p);
        let s = origin - a;
        let q = s.cross(e1);
        let (u, v, t) = (s.dot(p) * scale, direction.dot(q) * scale, e2.dot(q) * scale);
        u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0
    }

    /// Twin of `follow` in `raster/occluders.wgsl`: whether a ray meets anything, and nodes visited.
    fn walk(trees: &Occluders, root: u32, origin: Vec3, direction: Vec3) -> (bool, usize) {
        let (mut at, mut nodes) = (root, 0);
        while at != END {
            nodes += 1;
            let (low, high) = (trees.words[at as usize], trees.words[at as usize + 1]);
            let (a, b) = ((corner(low) - origin) / direction, (corner(high) - origin) / direction);
            let (enter, leave) = (a.min(b).max_element().max(0.0), a.max(b).min_element());
            if enter > leave {
                at = low[3];
                continue;
            }
            let (count, first) = (high[3] & 7, (high[3] >> 3) as usize);
            for i in 0..count as usize {
                let word = |k| corner(trees.words[first + i * TRIANGLE_WORDS + k]);
                if meets([word(0), word(0) + word(1), word(0) + word(2)], origin, direction) {
                    return (true, nodes);
                }
            }
            at = if count == 0 { at + NODE_WORDS as u32 } else { low[3] };
        }
        (false, nodes)
    }

    /// Numbers in 0..1 from a counter.
    fn dice(n: u32) -> f32 {
        let mut x = n.wrapping_mul(0x9e37_79b9) ^ 0x85eb_ca6b;
        x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
        x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
        (x >> 8) as f32 / (1 << 24) as f32
    }

    #[test]
    fn a_tree_tells_what_every_triangle_tells_and_visits_few_nodes() {
        let point = |n: u32| Vec3::new(dice(3 * n), dice(3 * n + 1), dice(3 * n + 2));
        let triangles: Vec<[Vec3; 3]> = (0..500)
            .map(|i| {
                let at = point(4 * i) * 10.0;
                [at, at + point(4 * i + 1) * 0.6, at + point(4 * i + 2) * 0.6]
            })
            .collect();
        let mut trees = Occluders::default();
        assert_eq!(trees.push(Vec::new()), END, "nothing has no tree");
        // Another tree before it: roots are not all 0.
        trees.push(triangles[..7].to_vec());
        let root = trees.push(triangles.clone());
        let (mut hits, mut visited, rays) = (0, 0, 2000);
        for n in 0..rays {
            let origin = point(10_000 + 2 * n) * 12.0 - 1.0;
            let direction = (point(10_001 + 2 * n) - 0.5).normalize();
            let every = triangles.iter().any(|t| meets(*t, origin, direction));
            let (found, nodes) = walk(&trees, root, origin, direction);
            assert_eq!(found, every, "ray {n}");
            hits += u32::from(found);
            visited += nodes;
        }
        assert!((100..1900).contains(&hits), "{hits} of {rays} rays meet something: no test of both answers");
        assert!(visited < 60 * rays as usize, "{visited} nodes for {rays} rays through 500 triangles");
        // Canary: the other tree is another one.
        let wrong = (0..rays).filter(|n| {
            let origin = point(10_000 + 2 * n) * 12.0 - 1.0;
            let direction = (point(10_001 + 2 * n) - 0.5).normalize();
            walk(&trees, 0, origin, direction).0 != walk(&trees, root, origin, direction).0
        });
        assert!(wrong.count() > 50);
    }
}
