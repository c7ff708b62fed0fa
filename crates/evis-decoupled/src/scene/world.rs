//! A scene, flattened: convex planar facets on surfaces, and where nodes are at a time.

use std::collections::HashMap;
use std::f64::consts::TAU;
use std::sync::Arc;

use evis_scene::motion::Path;
use evis_scene::{Eye, Motion, PixelLens, Primitive, Scene, SceneState, Variant, rigid_or_unrotated};
use glam::{DMat4, DVec3};

use crate::Error;
use crate::hash::Words;
use crate::scene::facets::{CORNERS, Facet, bounding_box, corners, facets, neighbors, places, wide};
use crate::scene::holes::Holes;
use crate::scene::screen::{Depths, Screen};
use crate::scene::tiles::{LensTiles, TileView};

/// Facets that are culled together.
const CLUSTER: usize = 64;
/// Periods of an analytic motion in a block, at most.
const MOST_PERIODS: f64 = 0.125;
/// The shortest block in microseconds.
pub const LEAST_BLOCK_US: i64 = 64;
/// Part of a solid's diagonal by which a neighbour may rise above a facet's plane.
const FLAT: f64 = 1e-6;

/// A primitive of a node.
#[derive(Clone, Debug)]
pub struct Surface {
    /// Index into [`Scene::nodes`].
    pub node: usize,
    /// Index into [`Scene::meshes`].
    pub mesh: usize,
    /// Index into the mesh's primitives.
    pub primitive: usize,
    /// Index into [`Scene::materials`].
    pub material: usize,
    /// Skin or morph targets move its vertices.
    pub deforms: bool,
    /// It may be elsewhere, or shaped otherwise, at another time.
    pub moves: bool,
    /// Both sides are drawn.
    pub double_sided: bool,
    /// It has an inside: each edge has another that runs against it.
    pub closed: bool,
    /// It is one convex solid: no part of it shadows what faces the lamp.
    pub convex: bool,
    /// Its clusters in [`World::clusters`].
    pub clusters: std::ops::Range<usize>,
    /// Box around its vertices in its own space; of deforming ones, as modelled.
    pub bounds: [DVec3; 2],
}

/// Neighbouring facets of one surface.
#[derive(Clone, Debug)]
pub struct Cluster {
    /// Its facets in [`World::facets`].
    pub facets: std::ops::Range<usize>,
    /// Box around them in the surface's space.
    pub bounds: [DVec3; 2],
}

/// How many times as far as everything is at first the depth lies that [`Screen`] takes for one beyond everything.
const BEYOND: f64 = 8.0;

/// A scene as one camera sees it.
pub struct World<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Its environment: whose clock and offsets count.
    pub variant: Option<&'a Variant>,
    /// Index into [`Scene::cameras`].
    pub camera: usize,
    /// Its pixels, without distortion; focal lengths and centre are those of [`Frame::lens`].
    pub lens: PixelLens,
    /// How far from the camera everything is at the scene's start, at most, in metres.
    farthest: f64,
    /// Where tiles lie on the picture of that, where its lens is distorted.
    pub tiles: Option<Arc<LensTiles>>,
    /// As it was asked for.
    size: Option<(u32, u32)>,
    /// Of its masked primitives, what is left.
    holes: Arc<Holes>,
    /// Primitives of nodes, in node order.
    pub surfaces: Vec<Surface>,
    /// Groups of facets, in surface order.
    pub clusters: Vec<Cluster>,
    /// Convex polygons, in surface order, then in that of their first triangle.
    pub facets: Vec<Facet>,
    /// Per facet and edge, the facet of the same surface beyond it, or [`crate::scene::facets::ALONE`].
    pub neighbors: Vec<[u32; CORNERS]>,
    /// Per node: whether it may be elsewhere, or shaped otherwise, at another time.
    pub moving_nodes: Vec<bool>,
}

/// A scene at a time.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Poses, weights and factors.
    pub state: SceneState,
    /// From the world to the space of homogeneous image points.
    pub screen_from_world: Screen,
    /// Depths of image points between which something is seen.
    pub depths: Depths,
    /// From where the camera looks.
    pub eye: Eye,
    /// The camera's lens.
    pub lens: PixelLens,
}

impl<'a> World<'a> {
    /// Flattens `scene` as camera `camera` sees it, at `size` pixels or the camera's own size.
    ///
    /// # Errors
    /// A camera that does not exist, or whose lens, size or pose cannot be used.
    pub fn new(scene: &'a Scene, camera: usize, size: Option<(u32, u32)>) -> Result<Self, Error> {
        Self::of_variant(scene, None, camera, size, &Holes::of(scene, size)?, &[])
    }

    /// As [`World::new`], in one of the scene's environments; `holes` are of the scene. What is prepared for a lens is taken from
    /// `others` that have it.
    ///
    /// # Errors
    /// As [`World::new`].
    pub fn of_variant(
        scene: &'a Scene,
        variant: Option<&'a Variant>,
        camera: usize,
        size: Option<(u32, u32)>,
        holes: &Arc<Holes>,
        others: &[Self],
    ) -> Result<Self, Error> {
        let lens = scene.pixel_lens(variant, camera, size, f64::INFINITY)?;
        let moving_nodes = moving_nodes(scene);
        let tiles = match others.iter().find(|other| other.camera == camera && other.lens == lens) {
            Some(other) => other.tiles.clone(),
            None => LensTiles::new(scene, variant, camera, &lens)?.map(Arc::new),
        };
        let mut world = Self {
            scene,
            variant,
            camera,
            lens,
            farthest: 0.0,
            tiles,
            size,
            holes: Arc::clone(holes),
            surfaces: Vec::new(),
            clusters: Vec::new(),
            facets: Vec::new(),
            neighbors: Vec::new(),
            moving_nodes,
        };
        for (index, node) in scene.nodes.iter().enumerate() {
            let Some((mesh_index, mesh)) = node.mesh.and_then(|m| Some((m, scene.meshes.get(m)?))) else {
                continue;
            };
            for number in 0..mesh.primitives.len() {
                world.add(index, mesh_index, number, holes.primitive(scene, mesh_index, number));
            }
        }
        world.farthest = world.farthest(&world.frame(0.0)?);
        Ok(world)
    }

    /// Distance of the farthest corner of a surface's box from the camera.
    fn farthest(&self, frame: &Frame) -> f64 {
        let node = self.scene.cameras[self.camera].node;
        let camera = frame.world_from_node(node).w_axis.truncate();
        let mut most = 0.0_f64;
        for (index, surface) in self.surfaces.iter().enumerate() {
            let far = |point: DVec3| point.distance(camera);
            let own = if surface.deforms {
                self.vertices(index as u32, frame).iter().map(|(place, _)| far(*place)).fold(0.0, f64::max)
            } else {
                let pose = frame.world_from_node(surface.node);
                let [low, high] = surface.bounds;
                corners(low, high).map(|p| far(pose.transform_point3(p))).into_iter().fold(0.0, f64::max)
            };
            most = most.max(own);
        }
        most
    }

    fn add(&mut self, node: usize, mesh: usize, index: usize, primitive: &Primitive) {
        let Some(material) = self.scene.materials.get(primitive.material) else { return };
        let skinned = self.scene.nodes[node].skin.is_some() && primitive.joints.is_some();
        let deforms = skinned || !primitive.morph_targets.is_empty();
        let surface = self.surfaces.len() as u32;
        let first_cluster = self.clusters.len();
        let facets = facets(primitive, surface, !deforms);
        let places = places(primitive);
        // What is at one place in the mesh may be at several under a skeleton.
        let vertex = |v: u32| if deforms { v } else { places.get(v as usize).copied().unwrap_or(v) };
        let first_facet = self.facets.len() as u32;
        let beyond = neighbors(&facets, first_facet, vertex);
        let closed = is_closed(&primitive.indices, &places);
        let convex = closed && !deforms && is_convex(&facets, &beyond, first_facet, primitive);
        self.neighbors.extend(beyond);
        for group in facets.chunks(CLUSTER) {
            let start = self.facets.len();
            let bounds = bounding_box(
                group.iter().flat_map(|f| f.corners).map(|c| wide(primitive.positions[c as usize])),
            );
            self.facets.extend_from_slice(group);
            self.clusters.push(Cluster { facets: start..self.facets.len(), bounds });
        }
        self.surfaces.push(Surface {
            node,
            mesh,
            primitive: index,
            material: primitive.material,
            deforms,
            moves: self.moving_nodes[node],
            double_sided: material.double_sided,
            closed,
            convex,
            clusters: first_cluster..self.clusters.len(),
            bounds: bounding_box(primitive.positions.iter().map(|p| wide(*p))),
        });
    }

    /// What the tile at (column, row) sees of the picture without distortion.
    pub fn tile(&self, place: [usize; 2]) -> TileView {
        self.tiles.as_ref().map_or_else(|| TileView::of_pinhole(place), |tiles| tiles.tile(place).clone())
    }

    /// What any pixel sees of that picture: left, top, right, bottom.
    pub fn seen(&self) -> [f64; 4] {
        let whole = [0.0, 0.0, f64::from(self.lens.width), f64::from(self.lens.height)];
        self.tiles.as_ref().map_or(whole, |tiles| tiles.seen)
    }

    /// The primitive of surface `surface`.
    pub fn primitive(&self, surface: u32) -> &Primitive {
        let s = &self.surfaces[surface as usize];
        self.holes.primitive(self.scene, s.mesh, s.primitive)
    }

    /// The scene at `t_us` microseconds of its own time.
    ///
    /// # Errors
    /// A camera without a pose at that time.
    pub fn frame(&self, t_us: f64) -> Result<Frame, Error> {
        let mut state = SceneState::default();
        self.scene.evaluate_variant(self.variant, t_us * 1e-6, &mut state);
        let pose = state.world_from_node.get(self.scene.cameras[self.camera].node).map(rigid_or_unrotated);
        let Some(world_from_camera) = pose else {
            let name = &self.scene.cameras[self.camera].name;
            return Err(Error::Camera(format!("camera '{name}' has no pose at {t_us} us")));
        };
        let lens = self.scene.pixel_lens(self.variant, self.camera, self.size, t_us)?;
        // Of a lens without a far plane it is not used.
        let beyond = BEYOND * self.farthest.max(lens.far());
        Ok(Frame {
            screen_from_world: Screen::from_camera(&lens, beyond).after(&world_from_camera.inverse()),
            depths: Depths::new(&lens, beyond),
            eye: lens.eye(&world_from_camera),
            lens,
            state,
        })
    }

    /// Seconds of the scene's own clock at `t_us`: its speed, and the environment's offset.
    pub fn scene_seconds(&self, t_us: f64) -> f64 {
        t_us * 1e-6 * self.scene.speed.unwrap_or(1.0) + self.variant.map_or(0.0, |v| v.time_offset_s)
    }

    /// The longest block, a power of two of microseconds and `most_us` at most, in which no analytic motion goes through more
    /// than an eighth of its period: poses at a few times of a block then tell how it moves.
    pub fn block_us(&self, most_us: i64) -> i64 {
        let periods_per_us = fastest_hz(self.scene) * self.scene.speed.unwrap_or(1.0) * 1e-6;
        let mut length_us = most_us;
        while length_us > LEAST_BLOCK_US && length_us as f64 * periods_per_us > MOST_PERIODS {
            length_us /= 2;
        }
        length_us
    }

    /// World positions and unit normals of all vertices of surface `surface`, and whether its pose mirrors.
    pub fn vertices(&self, surface: u32, frame: &Frame) -> Vec<(DVec3, DVec3)> {
        let primitive = self.primitive(surface);
        let s = &self.surfaces[surface as usize];
        let weights = frame.state.morph_weights.get(s.node).map_or(&[][..], Vec::as_slice);
        let world_from_vertex = self.world_from_vertices(surface, frame);
        let blends = self.blends(surface);
        let own = primitive.positions.len() - blends.len();
        let mut vertices: Vec<(DVec3, DVec3)> = (0..own)
            .map(|v| {
                let mut position = wide(primitive.positions[v]);
                let mut normal = primitive.normals.get(v).map_or(DVec3::Z, |n| wide(*n));
                // glTF 2.0, 3.7.2.2: base + sum of weight * displacement.
                for (target, weight) in primitive.morph_targets.iter().zip(weights) {
                    let weight = f64::from(*weight);
                    position += target.positions.get(v).map_or(DVec3::ZERO, |d| wide(*d)) * weight;
                    normal += target.normals.get(v).map_or(DVec3::ZERO, |d| wide(*d)) * weight;
                }
                let matrix = world_from_vertex(v);
                (matrix.transform_point3(position), normal_under(&matrix, normal))
            })
            .collect();
        for (corners, weights) in blends {
            let of = || corners.iter().map(|c| vertices[*c as usize]).zip(weights);
            let position = of().map(|((position, _), weight)| position * *weight).sum();
            let normal: DVec3 = of().map(|((_, normal), weight)| normal * *weight).sum();
            vertices.push((position, normal.normalize_or(DVec3::Z)));
        }
        vertices
    }

    /// How the last vertices of a surface with a skeleton follow others of it, where its holes are cut out; those of other
    /// surfaces are carried as all are.
    fn blends(&self, surface: u32) -> &[([u32; 3], [f64; 3])] {
        let s = &self.surfaces[surface as usize];
        let skinned = self.scene.nodes[s.node].skin.is_some() && self.primitive(surface).joints.is_some();
        if skinned { self.holes.blends(s.mesh, s.primitive) } else { &[] }
    }

    /// World tangents of all vertices of surface `surface`, of any length, and the bitangent's sign; empty where it has none.
    pub fn tangents(&self, surface: u32, frame: &Frame) -> Vec<(DVec3, f64)> {
        let Some(tangents) = &self.primitive(surface).tangents else { return Vec::new() };
        let world_from_vertex = self.world_from_vertices(surface, frame);
        let carried = |(v, tangent): (usize, &[f32; 4])| tangent_under(&world_from_vertex(v), *tangent);
        let blends = self.blends(surface);
        let own = tangents.len().saturating_sub(blends.len());
        let mut tangents: Vec<_> = tangents[..own].iter().enumerate().map(carried).collect();
        for (corners, weights) in blends {
            let of = |corner: u32| tangents.get(corner as usize).copied().unwrap_or((DVec3::ZERO, 1.0));
            let tangent = corners.iter().zip(weights).map(|(c, weight)| of(*c).0 * *weight).sum();
            tangents.push((tangent, of(corners[0]).1));
        }
        tangents
    }

    /// The matrix that carries a vertex of surface `surface` to the world.
    fn world_from_vertices(&self, surface: u32, frame: &Frame) -> impl Fn(usize) -> DMat4 + '_ {
        let primitive = self.primitive(surface);
        let s = &self.surfaces[surface as usize];
        let skin = self.scene.nodes[s.node].skin.filter(|_| primitive.joints.is_some());
        let mut joints = Vec::new();
        if let Some(skin) = skin {
            self.scene.joint_matrices(skin, &frame.state, &mut joints);
        }
        let world = frame.world_from_node(s.node);
        move |v| {
            if skin.is_none() {
                return world;
            }
            let of = |i: u16| joints.get(usize::from(i)).copied().unwrap_or(DMat4::IDENTITY);
            let indices = primitive.joints.as_ref().and_then(|j| j.get(v)).copied();
            let weights = primitive.joint_weights.as_ref().and_then(|w| w.get(v)).copied();
            let pairs = indices.unwrap_or_default().into_iter().zip(weights.unwrap_or_default());
            pairs.fold(DMat4::ZERO, |sum, (i, w)| sum + of(i) * f64::from(w))
        }
    }
}

impl Frame {
    /// Pose of node `node`.
    pub fn world_from_node(&self, node: usize) -> DMat4 {
        self.state.world_from_node.get(node).copied().unwrap_or(DMat4::IDENTITY)
    }
}

/// A normal carried by `matrix`: the cofactor matrix keeps it at right angles to the surface, whatever the scale, and
/// its sign keeps the outside outside (glTF 2.0, 3.7.4).
pub fn normal_under(matrix: &DMat4, normal: DVec3) -> DVec3 {
    let [x, y, z] = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(|c| c.truncate());
    let carried = y.cross(z) * normal.x + z.cross(x) * normal.y + x.cross(y) * normal.z;
    let sign = if x.dot(y.cross(z)) < 0.0 { -1.0 } else { 1.0 };
    (carried * sign).normalize_or(DVec3::Z)
}

/// A tangent carried by `matrix`, and the sign of its bitangent.
pub fn tangent_under(matrix: &DMat4, [x, y, z, w]: [f32; 4]) -> (DVec3, f64) {
    // glTF 2.0, 3.7.2.1: the bitangent is cross(normal, tangent) w in the mesh's own space.
    let sign = if matrix.determinant() < 0.0 { -f64::from(w) } else { f64::from(w) };
    (matrix.transform_vector3(wide([x, y, z])), sign)
}

/// Whether each directed edge of triangles, by the `places` of its ends, has one against it.
fn is_closed(indices: &[u32], places: &[u32]) -> bool {
    let mut open: HashMap<[u32; 2], i64, Words> = HashMap::default();
    for t in indices.as_chunks::<3>().0 {
        let [Some(a), Some(b), Some(c)] = t.map(|v| places.get(v as usize).copied()) else { return false };
        for (from, to) in [(a, b), (b, c), (c, a)] {
            if from != to {
                *open.entry([from, to]).or_default() += 1;
                *open.entry([to, from]).or_default() -= 1;
            }
        }
    }
    open.values().all(|n| *n == 0)
}

/// Whether the rigid closed `facets`, numbered from `first`, with these neighbours, are one convex solid.
///
/// A closed surface in one piece is convex if every edge of it is, but for those of [`FLAT`].
fn is_convex(facets: &[Facet], neighbors: &[[u32; CORNERS]], first: u32, primitive: &Primitive) -> bool {
    let place = |vertex: u32| wide(primitive.positions[vertex as usize]);
    let [low, high] = bounding_box(facets.iter().flat_map(|f| f.corners).map(place));
    let flat = FLAT * (high - low).length();
    let mut reached = vec![false; facets.len()];
    let mut waiting: Vec<usize> = (0..facets.len().min(1)).collect();
    while let Some(number) = waiting.pop() {
        if std::mem::replace(&mut reached[number], true) {
            continue;
        }
        let corners = facets[number].corners.map(place);
        let normal = (corners[1] - corners[0]).cross(corners[3] - corners[0]).normalize_or_zero();
        for (edge, other) in neighbors[number].into_iter().enumerate() {
            if corners[edge] == corners[(edge + 1) % CORNERS] {
                continue;
            }
            let Some(other) = other.checked_sub(first).map(|k| k as usize).filter(|k| *k < facets.len())
            else {
                return false;
            };
            if facets[other].corners.into_iter().any(|c| (place(c) - corners[0]).dot(normal) > flat) {
                return false;
            }
            waiting.push(other);
        }
    }
    reached.into_iter().all(|reached| reached)
}

/// The highest frequency of an analytic motion, those of a node's ancestors added to its own, in hertz of the scene's clock.
pub fn fastest_hz(scene: &Scene) -> f64 {
    let mut hz: Vec<f64> = Vec::with_capacity(scene.nodes.len());
    for node in &scene.nodes {
        let inherited = node.parent.and_then(|p| hz.get(p)).copied().unwrap_or(0.0);
        let own = match &node.motion {
            Motion::Path(path) => path_hz(path),
            Motion::Fixed(_) | Motion::Animated { .. } | Motion::Driven(_) => 0.0,
        };
        hz.push(inherited + own);
    }
    hz.into_iter().fold(0.0, f64::max)
}

/// Between keys a path is a polynomial, or turns by half a turn at most.
fn path_hz(path: &Path) -> f64 {
    match path {
        Path::ConstantVelocity { .. } | Path::Keys { .. } => 0.0,
        Path::Spin { rate, .. } | Path::Ballistic { spin_rate: rate, .. } => rate.abs() / TAU,
        // Its z runs twice as fast as its x.
        Path::FigureEight { period_s, .. } => 2.0 / period_s.abs(),
        Path::Harmonic { terms, .. } => terms.iter().map(|t| t.frequency_hz.abs()).fold(0.0, f64::max),
        Path::Chain(paths) => paths.iter().map(path_hz).sum(),
    }
}

fn moving_nodes(scene: &Scene) -> Vec<bool> {
    let mut moves: Vec<bool> = Vec::with_capacity(scene.nodes.len());
    for node in &scene.nodes {
        let inherited = node.parent.and_then(|p| moves.get(p)).copied().unwrap_or(false);
        moves.push(!node.motion.is_fixed() || node.morph.is_some() || inherited);
    }
    for (index, node) in scene.nodes.iter().enumerate() {
        let skin = node.skin.and_then(|s| scene.skins.get(s));
        if skin.is_some_and(|s| s.joints.iter().any(|j| moves.get(*j).copied().unwrap_or(false))) {
            moves[index] = true;
        }
    }
    moves
}

#[cfg(test)]
mod tests {
    use evis_scene::primitive::Shape;
    use evis_scene::{Camera, Lens, Material, Node};

    use super::*;
    use crate::scene::testing;

    #[test]
    fn solids_without_hollows_are_convex() {
        let build = |shape: Shape| shape.build(None, [1.0; 2]).unwrap();
        let ball = || build(Shape::Sphere { radius: 0.5 });
        let dented = || {
            let mut made = ball();
            // All vertices at that place.
            let place = made.positions[100];
            made.positions.iter_mut().filter(|p| **p == place).for_each(|p| *p = p.map(|v| 0.9 * v));
            made
        };
        let two = || {
            let (mut made, other) = (ball(), ball());
            let count = made.positions.len() as u32;
            made.positions.extend(other.positions.iter().map(|[x, y, z]| [x + 2.0, *y, *z]));
            made.normals.extend(other.normals);
            made.indices.extend(other.indices.iter().map(|i| i + count));
            (made.uvs, made.tangents) = Default::default();
            made
        };
        let primitives = [
            (ball(), true),
            (build(Shape::Box { size: [0.1, 2.0, 0.5] }), true),
            (build(Shape::Capsule { radius: 0.1, height: 0.5 }), true),
            (build(Shape::Cylinder { radius: 0.2, height: 0.1 }), true),
            (dented(), false),
            (two(), false),
            (build(Shape::Card { size: [1.0, 1.0] }), false),
        ];
        let mut scene = Scene { materials: vec![Material::default()], ..Scene::default() };
        for (primitive, _) in &primitives {
            testing::add(&mut scene, primitive.clone(), Motion::default());
        }
        let node = scene.add_node(Node::default());
        scene.cameras.push(Camera::new("camera", node, Lens::FieldOfView { fov_y: 0.8 }));
        let world = World::new(&scene, 0, None).unwrap();
        let found: Vec<bool> = world.surfaces.iter().map(|s| s.convex).collect();
        assert_eq!(found, primitives.map(|(_, convex)| convex));
    }

    #[test]
    fn a_box_has_six_facets_and_a_bent_quad_two() {
        let scene = evis_scene::builtin::load("spinner", 0).unwrap();
        let world = World::new(&scene, 0, Some((64, 48))).unwrap();
        assert_eq!(world.facets.len(), 2, "two cards");
        let corners = |z: f32| Primitive {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, z], [0.0, 1.0, 0.0]],
            normals: vec![[0.0, 0.0, 1.0]; 4],
            indices: vec![0, 1, 2, 0, 2, 3],
            ..Primitive::default()
        };
        assert_eq!(facets(&corners(0.0), 0, true).len(), 1);
        assert_eq!(facets(&corners(0.1), 0, true).len(), 2, "not planar");
        let mut painted = corners(0.0);
        painted.uvs[0] = Some(vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 0.7]]);
        assert_eq!(facets(&painted, 0, true).len(), 2, "no affine map");
        let closed = |primitive: &Primitive| is_closed(&primitive.indices, &places(primitive));
        assert!(!closed(&corners(0.0)));
        let solid = evis_scene::primitive::Shape::Box { size: [1.0; 3] }.build(None, [1.0, 1.0]).unwrap();
        assert!(closed(&solid), "a box");
        let mut holed = solid;
        holed.indices.truncate(33);
        assert!(!closed(&holed), "a box without a triangle");
        let order = facets(&corners(0.0), 0, true)[0].corners;
        let p = order.map(|c| wide(corners(0.0).positions[c as usize]));
        assert!((p[1] - p[0]).cross(p[3] - p[0]).z > 0.0, "{order:?} is counter-clockwise");
    }
}
