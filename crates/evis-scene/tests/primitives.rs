//! Shapes made by code: closed, outward, of the right size, with pictures that stand upright.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::collections::HashMap;
use std::f64::consts::PI;

use evis_scene::Primitive;
use evis_scene::primitive::{MAX_SEGMENTS, Shape, append};
use glam::{DMat4, DVec3, Vec3};

const BOX: Shape = Shape::Box { size: [1.0, 2.0, 3.0] };
const SPHERE: Shape = Shape::Sphere { radius: 0.7 };
const CYLINDER: Shape = Shape::Cylinder { radius: 0.5, height: 2.0 };
const CAPSULE: Shape = Shape::Capsule { radius: 0.4, height: 1.2 };
const CARD: Shape = Shape::Card { size: [2.0, 1.0] };
const PLANE: Shape = Shape::Plane { size: [2.0, 3.0] };

fn build(shape: Shape, segments: Option<[u32; 2]>) -> Primitive {
    shape.build(segments, [1.0; 2]).expect("a good shape")
}

fn position(p: &Primitive, i: u32) -> DVec3 {
    Vec3::from(p.positions[i as usize]).as_dvec3()
}

fn triangles(p: &Primitive) -> impl Iterator<Item = [u32; 3]> {
    p.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]])
}

fn area(p: &Primitive) -> f64 {
    triangles(p).map(|t| face_normal(p, t).length() / 2.0).sum()
}

/// By the divergence theorem: right only for closed, outward surfaces.
fn volume(p: &Primitive) -> f64 {
    triangles(p).map(|[a, b, c]| position(p, a).dot(position(p, b).cross(position(p, c))) / 6.0).sum()
}

fn face_normal(p: &Primitive, [a, b, c]: [u32; 3]) -> DVec3 {
    (position(p, b) - position(p, a)).cross(position(p, c) - position(p, a))
}

/// Edges that do not have exactly one partner in the other direction; vertices are told apart by their exact bits.
fn open_edges(p: &Primitive) -> usize {
    let key = |i: u32| p.positions[i as usize].map(|v| (v + 0.0).to_bits());
    let mut edges: HashMap<_, i32> = HashMap::new();
    for [a, b, c] in triangles(p) {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            *edges.entry((key(from), key(to))).or_default() += 1;
            *edges.entry((key(to), key(from))).or_default() -= 1;
        }
    }
    edges.values().filter(|balance| **balance != 0).count()
}

fn check_basics(p: &Primitive) -> Result<(), String> {
    let n = p.positions.len();
    let tangents = p.tangents.as_ref().ok_or("tangents")?;
    let uvs = p.uvs[0].as_ref().ok_or("uvs")?;
    if [p.normals.len(), tangents.len(), uvs.len()] != [n; 3] {
        return Err("lengths differ".into());
    }
    for triangle in triangles(p) {
        let face = face_normal(p, triangle);
        if face.length() < 1e-12 {
            return Err("a triangle has no area".into());
        }
        for i in triangle {
            let normal = Vec3::from(p.normals[i as usize]).as_dvec3();
            if (normal.length() - 1.0).abs() > 1e-6 {
                return Err("a normal is not a unit".into());
            }
            // On a coarse sphere a vertex normal leans away from its faces, but never by more than this.
            if face.normalize().dot(normal) < 0.8 {
                return Err(format!("winding and normal disagree: {}", face.normalize().dot(normal)));
            }
            let [x, y, z, w] = tangents[i as usize];
            let tangent = Vec3::new(x, y, z).as_dvec3();
            if w != 1.0 || (tangent.length() - 1.0).abs() > 1e-6 || tangent.dot(normal).abs() > 1e-6 {
                return Err("a tangent is no unit in the surface".into());
            }
        }
        // The tangent points along growing u, and normal x tangent along falling v.
        let [a, b, c] = triangle.map(|i| i as usize);
        let (du, dv) =
            ([uvs[b][0] - uvs[a][0], uvs[c][0] - uvs[a][0]], [uvs[b][1] - uvs[a][1], uvs[c][1] - uvs[a][1]]);
        let det = f64::from(du[0] * dv[1] - du[1] * dv[0]);
        let (e1, e2) = (
            position(p, triangle[1]) - position(p, triangle[0]),
            position(p, triangle[2]) - position(p, triangle[0]),
        );
        let along_u = (e1 * f64::from(dv[1]) - e2 * f64::from(dv[0])) / det;
        let along_v = (e2 * f64::from(du[0]) - e1 * f64::from(du[1])) / det;
        let tangent = Vec3::from_slice(&tangents[a][..3]).as_dvec3();
        let bitangent = Vec3::from(p.normals[a]).as_dvec3().cross(tangent);
        if along_u.normalize().dot(tangent) < 0.7 || along_v.normalize().dot(bitangent) > -0.7 {
            return Err(format!("texture axes: u {along_u} v {along_v} at {}", position(p, triangle[0])));
        }
    }
    Ok(())
}

#[test]
fn every_shape_is_sound_at_every_tessellation() {
    for shape in [PLANE, CARD, BOX, SPHERE, CYLINDER, CAPSULE] {
        for segments in [None, Some([8, 5]), Some([33, 16])] {
            let p = build(shape, segments);
            check_basics(&p).unwrap_or_else(|e| panic!("{shape:?} {segments:?}: {e}"));
        }
    }
    // Canaries: a turned triangle, a turned normal and a mirrored picture are each rejected.
    let mut wrong = build(BOX, None);
    wrong.indices.swap(0, 1);
    assert!(check_basics(&wrong).is_err());
    let mut wrong = build(SPHERE, None);
    wrong.normals[100] = wrong.normals[100].map(|v| -v);
    assert!(check_basics(&wrong).is_err());
    let mut wrong = build(CARD, None);
    wrong.uvs[0].iter_mut().flatten().for_each(|uv| uv[0] = 1.0 - uv[0]);
    assert!(check_basics(&wrong).is_err());
}

#[test]
fn solids_are_closed_to_the_bit() {
    for shape in [SPHERE, CYLINDER, CAPSULE] {
        for segments in [None, Some([7, 4]), Some([64, 33])] {
            assert_eq!(open_edges(&build(shape, segments)), 0, "{shape:?} {segments:?}");
        }
    }
    assert_eq!(open_edges(&build(BOX, Some([3, 3]))), 0);
    // Canary: a card has four open edges.
    assert_eq!(open_edges(&build(CARD, None)), 8);
}

#[test]
fn areas_and_volumes_are_those_of_the_shape() {
    let fine = Some([512, 256]);
    let close = |got: f64, want: f64| assert!((got / want - 1.0).abs() < 2e-4, "{got} for {want}");
    close(area(&build(PLANE, Some([3, 2]))), 6.0);
    close(area(&build(CARD, None)), 2.0);
    close(area(&build(BOX, None)), 22.0);
    close(volume(&build(BOX, None)), 6.0);
    let (r, h) = (0.5, 2.0);
    close(volume(&build(CYLINDER, fine)), PI * r * r * h);
    close(area(&build(CYLINDER, fine)), 2.0 * PI * r * (h + r));
    let r: f64 = 0.7;
    close(volume(&build(SPHERE, fine)), 4.0 / 3.0 * PI * r.powi(3));
    close(area(&build(SPHERE, fine)), 4.0 * PI * r * r);
    let (r, h): (f64, f64) = (0.4, 1.2);
    close(volume(&build(CAPSULE, fine)), 4.0 / 3.0 * PI * r.powi(3) + PI * r * r * h);
    close(area(&build(CAPSULE, fine)), 4.0 * PI * r * r + 2.0 * PI * r * h);
}

#[test]
fn pictures_stand_upright_on_every_side() {
    // Where the picture's centre, right edge and lower edge are: front of a card and of a box, top of both.
    let at = |p: &Primitive, uv: [f32; 2], near: DVec3| {
        let uvs = p.uvs[0].as_ref().expect("uvs");
        let found = (0..p.positions.len()).filter(|i| uvs[*i] == uv);
        found
            .map(|i| position(p, i as u32))
            .min_by(|a, b| a.distance(near).total_cmp(&b.distance(near)))
            .expect("uv")
    };
    let card = build(CARD, None);
    assert_eq!(at(&card, [0.0, 0.0], DVec3::ZERO), DVec3::new(-1.0, 0.5, 0.0), "top left, seen from +Z");
    assert_eq!(at(&card, [1.0, 1.0], DVec3::ZERO), DVec3::new(1.0, -0.5, 0.0));
    let plane = build(PLANE, None);
    assert_eq!(at(&plane, [0.0, 0.0], DVec3::ZERO), DVec3::new(-1.0, 0.0, -1.5), "top is far");
    let cube = build(BOX, None);
    assert_eq!(at(&cube, [1.0, 0.0], DVec3::new(0.5, 1.0, 1.6)), DVec3::new(0.5, 1.0, 1.5), "front");
    for face in 0..4 {
        let uvs = &cube.uvs[0].as_ref().expect("uvs")[4 * [0, 1, 4, 5][face]..][..4];
        let corners = &cube.positions[4 * [0, 1, 4, 5][face]..][..4];
        assert!(
            uvs.iter().zip(corners).all(|(uv, p)| (uv[1] == 0.0) == (p[1] > 0.0)),
            "side {face}: v runs down"
        );
    }
    let sphere = build(SPHERE, None);
    assert!(at(&sphere, [0.5, 0.5], DVec3::Z).distance(DVec3::Z * 0.7) < 1e-6, "middle faces +Z");
    assert!(at(&sphere, [0.75, 0.5], DVec3::Z).distance(DVec3::X * 0.7) < 1e-6, "u runs to the right");
    let repeated = CARD.build(None, [3.0, 2.0]).expect("card");
    assert_eq!(repeated.uvs[0].as_ref().and_then(|uvs| uvs.last().copied()), Some([3.0, 2.0]));
}

#[test]
fn welding_keeps_surfaces_outward_even_when_mirrored() {
    let mut whole = Primitive::default();
    let part = build(SPHERE, None);
    append(&mut whole, &part, DMat4::from_translation(DVec3::X * 5.0));
    append(&mut whole, &part, DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0)));
    let one = volume(&part);
    assert!((volume(&whole) / (2.0 * one) - 1.0).abs() < 1e-5);
    assert_eq!(open_edges(&whole), 0);
    assert_eq!(whole.positions.len(), whole.uvs[0].as_ref().map_or(0, Vec::len));
    for t in triangles(&whole) {
        let normal = Vec3::from(whole.normals[t[0] as usize]).as_dvec3();
        assert!(face_normal(&whole, t).normalize().dot(normal) > 0.8);
    }
}

#[test]
fn sizes_and_segments_out_of_range_are_told() {
    for (shape, segments, repeat, expected) in [
        (Shape::Sphere { radius: 0.0 }, None, 1.0, "radius of a sphere is 0"),
        (Shape::Sphere { radius: f64::NAN }, None, 1.0, "radius of a sphere is NaN"),
        (Shape::Box { size: [1.0, -2.0, 1.0] }, None, 1.0, "size of a box is -2"),
        (SPHERE, Some([2, 8]), 1.0, "segments of a sphere are [2, 8]"),
        (PLANE, Some([1, MAX_SEGMENTS + 1]), 1.0, "between 1 and 1024"),
        (PLANE, None, f64::INFINITY, "uv_repeat"),
    ] {
        let message = shape.build(segments, [repeat; 2]).err().map_or_else(String::new, |e| e.to_string());
        assert!(message.contains(expected), "{shape:?}: {message}");
    }
}
