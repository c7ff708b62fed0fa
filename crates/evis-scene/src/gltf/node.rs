//! Nodes in order, with their skins, lights and cameras.

use ::gltf::json;
use ::gltf::json::accessor::Type;
use ::gltf::json::camera::Type as CameraType;
use ::gltf::json::extensions::scene::khr_lights_punctual::Type as Punctual;
use ::gltf::json::validation::Checked;
use glam::{DMat4, DQuat, Vec3};
use serde_json::Value;

use super::animation::{Track, Tracks};
use super::document::{Document, element, label};
use crate::model::{Camera, Lens, Light, LightKind, Node, Scene, Skin, Trs};
use crate::motion::{Curve, Motion};

/// Appends the file's nodes, parents first, and what hangs on them. Nodes outside the file's scene stay as poses (a
/// skin may need them) and show nothing.
pub(super) fn read(document: &Document, mut tracks: Tracks, scene: &mut Scene) -> Result<(), String> {
    read_lights(document, scene)?;
    let hierarchy = Hierarchy::new(document)?;
    for &index in &hierarchy.order {
        let source = element(&document.root.nodes, "node", index, "the hierarchy")?;
        let track = tracks.remove(&index).unwrap_or_default();
        let parent = hierarchy.parent[index].map(|p| hierarchy.position[p]);
        let mut node = read_node(document, index, source, parent, track, scene)?;
        if hierarchy.shown[index] {
            if let Some(camera) = source.camera {
                read_camera(document, camera.value(), index, scene)?;
            }
        } else {
            (node.mesh, node.skin, node.light, node.morph) = (None, None, None, None);
        }
        scene.nodes.push(node);
    }
    for (i, source) in document.root.skins.iter().enumerate() {
        let skin = read_skin(document, source, &hierarchy, &label("skin", i, source.name.as_ref()))?;
        scene.skins.push(skin);
    }
    Ok(())
}

/// Who is whose child, all by the file's node indices.
struct Hierarchy {
    parent: Vec<Option<usize>>,
    /// Parents before children.
    order: Vec<usize>,
    /// Place of each node in `order`.
    position: Vec<usize>,
    /// Whether a node belongs to the file's scene.
    shown: Vec<bool>,
}

impl Hierarchy {
    fn new(document: &Document) -> Result<Self, String> {
        let nodes = &document.root.nodes;
        let count = nodes.len();
        let node_label = |i: usize| label("node", i, nodes.get(i).and_then(|n| n.name.as_ref()));
        let mut parent = vec![None; count];
        for (i, node) in nodes.iter().enumerate() {
            for child in node.children.iter().flatten() {
                let child = child.value();
                element(nodes, "node", child, &node_label(i))?;
                if let Some(other) = parent[child].replace(i) {
                    let (child, a, b) = (node_label(child), node_label(other), node_label(i));
                    return Err(format!("{child} is a child of both {a} and {b}; nodes must form a tree"));
                }
            }
        }
        let children = |i: usize| nodes[i].children.iter().flatten().rev().map(|c| c.value());
        // Depth first without recursion: a file may be deeper than the stack.
        let mut order = Vec::with_capacity(count);
        let mut open: Vec<usize> = (0..count).rev().filter(|i| parent[*i].is_none()).collect();
        while let Some(i) = open.pop() {
            order.push(i);
            open.extend(children(i));
        }
        let mut position = vec![usize::MAX; count];
        for (place, i) in order.iter().enumerate() {
            position[*i] = place;
        }
        if let Some(i) = position.iter().position(|p| *p == usize::MAX) {
            return Err(format!("{} is its own ancestor; nodes must form a tree", node_label(i)));
        }
        let mut shown = vec![document.root.scenes.is_empty(); count];
        if !document.root.scenes.is_empty() {
            let index = document.root.scene.map_or(0, |s| s.value());
            let scene = element(&document.root.scenes, "scene", index, "the file")?;
            let mut open = Vec::new();
            for root in &scene.nodes {
                element(nodes, "node", root.value(), &format!("scene {index}"))?;
                open.push(root.value());
            }
            while let Some(i) = open.pop() {
                if !std::mem::replace(&mut shown[i], true) {
                    open.extend(children(i));
                }
            }
        }
        Ok(Self { parent, order, position, shown })
    }
}

fn read_node(
    document: &Document,
    index: usize,
    source: &json::Node,
    parent: Option<usize>,
    track: Track,
    scene: &mut Scene,
) -> Result<Node, String> {
    let what = label("node", index, source.name.as_ref());
    let motion = match source.matrix {
        Some(matrix) => Motion::Fixed(DMat4::from_cols_array(&matrix.map(f64::from))),
        None => Motion::Fixed(rest(source).matrix()),
    };
    let Track { translation, rotation, scale, weights } = track;
    let motion = if translation.is_some() || rotation.is_some() || scale.is_some() {
        let rest = match source.matrix {
            Some(matrix) => {
                let (scale, rotation, translation) =
                    DMat4::from_cols_array(&matrix.map(f64::from)).to_scale_rotation_translation();
                Trs { translation, rotation, scale }
            }
            None => rest(source),
        };
        Motion::Animated { rest, translation, rotation, scale }
    } else {
        motion
    };
    let mesh = source.mesh.map(|m| m.value());
    let targets = match mesh {
        Some(mesh) => element(&scene.meshes, "mesh", mesh, &what)?.morph_weights.len(),
        None => 0,
    };
    let own_weights = source.weights.as_ref().filter(|_| targets > 0);
    let own_weights = own_weights.map(|w| Curve::constant(w.iter().map(|v| f64::from(*v)).collect()));
    if let Some(skin) = source.skin {
        element(&document.root.skins, "skin", skin.value(), &what)?;
    }
    let light =
        source.extensions.as_ref().and_then(|e| e.khr_lights_punctual.as_ref()).map(|l| l.light.value());
    if let Some(light) = light {
        element(&scene.lights, "light", light, &what)?;
    }
    Ok(Node {
        name: source.name.clone().unwrap_or_default(),
        parent,
        motion,
        mesh,
        skin: source.skin.map(|s| s.value()).filter(|_| mesh.is_some()),
        light,
        morph: weights.or(own_weights),
        instance_id: 0,
        semantic_id: read_class(document, index, &what, scene),
    })
}

/// The semantic class in a node's extras (custom properties in Blender): `semantic_id`, and `semantic_name` beside it.
/// Extras belong to whoever wrote them: what cannot be used is ignored, with a warning.
fn read_class(document: &Document, index: usize, what: &str, scene: &mut Scene) -> u32 {
    let extra = |key: &str| document.value.pointer(&format!("/nodes/{index}/extras/{key}"));
    let (id, name) = (extra("semantic_id"), extra("semantic_name"));
    let Some(value) = id else {
        if let Some(name) = name {
            let takes = "it takes a semantic_id beside it";
            scene.warnings.push(format!("{what}: extras: semantic_name is {name} and ignored: {takes}"));
        }
        return 0;
    };
    let Some(id) = value.as_u64().and_then(|id| u32::try_from(id).ok()) else {
        let takes = "it takes a whole number from 0 to 4294967295";
        scene.warnings.push(format!("{what}: extras: semantic_id is {value} and ignored: {takes}"));
        return 0;
    };
    if let Some(name) = name.and_then(Value::as_str).filter(|name| id > 0 && !name.is_empty()) {
        let known = scene.class_names.entry(id).or_insert_with(|| name.to_owned());
        if known != name {
            scene.warnings.push(format!(
                "{what}: class {id} is '{name}' here and '{known}' elsewhere; '{known}' counts"
            ));
        }
    }
    id
}

fn rest(source: &json::Node) -> Trs {
    let vector = |v: Option<[f32; 3]>, default: Vec3| v.map_or(default, Vec3::from_array).as_dvec3();
    let rotation = source.rotation.map_or(DQuat::IDENTITY, |q| DQuat::from_array(q.0.map(f64::from)));
    let length = rotation.length();
    Trs {
        translation: vector(source.translation, Vec3::ZERO),
        // Files hold f32 quaternions; a unit one keeps the matrix free of scale.
        rotation: if length > 0.0 { rotation / length } else { DQuat::IDENTITY },
        scale: vector(source.scale, Vec3::ONE),
    }
}

fn read_skin(
    document: &Document,
    source: &json::Skin,
    hierarchy: &Hierarchy,
    what: &str,
) -> Result<Skin, String> {
    let joint = |j: &json::Index<json::Node>| element(&hierarchy.position, "node", j.value(), what).copied();
    let joints: Vec<usize> = source.joints.iter().map(joint).collect::<Result<_, _>>()?;
    let inverse_bind = match source.inverse_bind_matrices {
        None => vec![DMat4::IDENTITY; joints.len()],
        Some(accessor) => {
            let elements = document.elements(accessor.value(), &[Type::Mat4], what)?;
            let matrix = |m: [f32; 16]| DMat4::from_cols_array(&m.map(f64::from));
            let mut matrices: Vec<_> = elements.vectors::<16>(false).into_iter().map(matrix).collect();
            if matrices.len() < joints.len() {
                let count = matrices.len();
                return Err(format!("{what} has {} joints, but {count} inverse bind matrices", joints.len()));
            }
            matrices.truncate(joints.len());
            matrices
        }
    };
    Ok(Skin { joints, inverse_bind })
}

fn read_lights(document: &Document, scene: &mut Scene) -> Result<(), String> {
    let extension = document.root.extensions.as_ref().and_then(|e| e.khr_lights_punctual.as_ref());
    for (i, source) in extension.iter().flat_map(|e| &e.lights).enumerate() {
        let what = label("light", i, source.name.as_ref());
        let kind = match (source.type_, &source.spot) {
            (Checked::Valid(Punctual::Directional), _) => LightKind::Directional,
            (Checked::Valid(Punctual::Point), _) => LightKind::Point,
            (Checked::Valid(Punctual::Spot), Some(spot)) => {
                LightKind::Spot { inner: spot.inner_cone_angle, outer: spot.outer_cone_angle }
            }
            (Checked::Valid(Punctual::Spot), None) => {
                return Err(format!("{what} is a spot without cone angles"));
            }
            (Checked::Invalid, _) => {
                return Err(format!("{what} has an unknown type; directional, point and spot work"));
            }
        };
        scene.lights.push(Light {
            color: source.color,
            range: source.range,
            casts_shadow: kind != LightKind::Point,
            ..Light::new(source.name.clone().unwrap_or_default(), kind, source.intensity)
        });
    }
    Ok(())
}

/// Appends the camera of the node that is pushed next.
fn read_camera(document: &Document, index: usize, node: usize, scene: &mut Scene) -> Result<(), String> {
    let user = label("node", node, document.root.nodes.get(node).and_then(|n| n.name.as_ref()));
    let source = element(&document.root.cameras, "camera", index, &user)?;
    let what = label("camera", index, source.name.as_ref());
    let (lens, aspect, near) = match (source.type_, &source.perspective, &source.orthographic) {
        (Checked::Valid(CameraType::Perspective), Some(p), _) => {
            let lens = Lens::FieldOfView { fov_y: f64::from(p.yfov) };
            (lens, p.aspect_ratio.map(f64::from), f64::from(p.znear))
        }
        (Checked::Valid(CameraType::Orthographic), _, Some(o)) => {
            let far = f64::from(o.zfar);
            let lens = Lens::Orthographic { height: 2.0 * f64::from(o.ymag).abs(), far };
            // glTF allows a near plane at 0.
            (lens, Some(f64::from(o.xmag / o.ymag).abs()), f64::from(o.znear).max(1e-6 * far))
        }
        _ => return Err(format!("{what} has no lens of its type; perspective and orthographic work")),
    };
    let node_name = document.root.nodes.get(node).and_then(|n| n.name.as_ref());
    let name = source.name.as_ref().or(node_name).cloned().unwrap_or_else(|| "camera".into());
    scene.cameras.push(Camera {
        aspect: aspect.filter(|a| a.is_finite() && *a > 0.0),
        near,
        ..Camera::new(name, scene.nodes.len(), lens)
    });
    Ok(())
}
