//! Every rule of a scene, broken once.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::sync::Arc;

use evis_scene::motion::{Curve, Path, WaveShape, Waveform};
use evis_scene::{
    Camera, Image, Lens, Light, LightKind, Material, Mesh, MorphTarget, Motion, Node, Primitive, Scene, Skin,
    Texture, TextureRef, Trs, Variant,
};
use glam::{DMat4, DVec3};
use half::f16;

fn triangle() -> Primitive {
    Primitive {
        positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        indices: vec![0, 1, 2],
        ..Primitive::default()
    }
}

fn camera(name: &str) -> Camera {
    Camera::new(name, 0, Lens::FieldOfView { fov_y: 1.0 })
}

fn good() -> Scene {
    Scene {
        nodes: vec![
            Node { name: "base".into(), mesh: Some(0), ..Node::default() },
            Node {
                name: "arm".into(),
                parent: Some(0),
                mesh: Some(0),
                skin: Some(0),
                light: Some(0),
                ..Node::default()
            },
            Node { name: "hand".into(), parent: Some(1), mesh: Some(0), instance_id: 2, ..Node::default() },
        ],
        meshes: vec![Mesh { name: "tile".into(), primitives: vec![triangle()], morph_weights: vec![] }],
        materials: vec![Material::default()],
        textures: vec![Texture::new(0)],
        images: vec![Image { name: "dot".into(), width: 1, height: 1, texels: vec![[f16::ONE; 4]] }],
        skins: vec![Skin { joints: vec![0], inverse_bind: vec![DMat4::IDENTITY] }],
        lights: vec![Light::point("lamp", 1.0)],
        cameras: vec![camera("eye"), camera("eye"), camera("eye_2"), camera("")],
        ..Scene::default()
    }
}

#[test]
fn what_may_be_left_out_is_filled_in() {
    let mut scene = good();
    scene.validate().expect("valid");
    assert_eq!(scene.nodes.iter().map(|n| n.instance_id).collect::<Vec<_>>(), [1, 3, 2]);
    let names: Vec<_> = scene.cameras.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["eye", "eye_3", "eye_2", "camera"]);
    assert_eq!(scene.meshes[0].primitives[0].normals, [[0.0, 0.0, 1.0]; 3]);
    assert!(scene.warnings.is_empty());
    // A second time nothing changes.
    let first = format!("{scene:?}");
    scene.validate().expect("still valid");
    assert_eq!(format!("{scene:?}"), first);
}

#[test]
fn shared_vertices_are_split_for_flat_normals_and_given_normals_are_kept() {
    let mut scene = good();
    let folded = &mut scene.meshes[0].primitives[0];
    folded.positions.push([0.0, 0.0, -1.0]);
    folded.indices.extend([0, 2, 3]);
    folded.colors = Some(vec![[0.0; 4], [0.1; 4], [0.2; 4], [0.3; 4]]);
    let smooth = Primitive {
        normals: vec![[0.0, 0.0, 2.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]],
        ..folded.clone()
    };
    scene.meshes[0].primitives.push(smooth);
    scene.validate().expect("valid");
    let [flat, smooth] = &scene.meshes[0].primitives[..] else { panic!("two primitives") };
    assert_eq!(flat.indices, [0, 1, 2, 3, 4, 5]);
    assert_eq!(flat.normals[..3], [[0.0, 0.0, 1.0]; 3]);
    assert_eq!(flat.normals[3..], [[-1.0, 0.0, 0.0]; 3]);
    assert_eq!(flat.colors.as_ref().map(|c| c[5]), Some([0.3; 4]));
    assert_eq!(smooth.normals, [[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]]);
    assert_eq!(smooth.indices.len(), 6);
}

#[test]
fn triangles_without_area_are_dropped_with_a_warning_unless_they_may_open() {
    let mut scene = good();
    scene.meshes[0].primitives[0].indices.extend([1, 1, 2]);
    let line = Primitive { positions: vec![[0.0; 3], [1.0; 3], [2.0; 3]], ..triangle() };
    scene.meshes[0].primitives.push(line.clone());
    scene.validate().expect("valid");
    let counts: Vec<_> = scene.meshes[0].primitives.iter().map(|p| p.indices.len()).collect();
    assert_eq!(counts, [3, 0]);
    assert!(
        scene.warnings[0].contains("2 triangles") && scene.warnings[0].contains("tile"),
        "{:?}",
        scene.warnings
    );

    let target =
        MorphTarget { positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0; 3]], normals: vec![[0.0; 3]; 3] };
    scene.meshes[0].primitives = vec![Primitive { morph_targets: vec![target], ..line.clone() }];
    scene.validate().expect("valid");
    assert_eq!(scene.meshes[0].primitives[0].indices.len(), 3);
    assert_eq!(scene.meshes[0].morph_weights, [0.0]);

    scene.meshes[0] = Mesh { primitives: vec![line], ..Mesh::default() };
    assert!(scene.validate().expect_err("nothing left").to_string().contains("nothing to draw"));
}

#[test]
fn a_mirrored_seam_gets_two_tangents() {
    let mut scene = good();
    scene.materials[0].normal_texture = Some(TextureRef::new(0));
    // Two quads left and right of x = 0, with the image mirrored at the seam.
    scene.meshes[0].primitives[0] = Primitive {
        positions: vec![[-1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]],
        normals: vec![[0.0, 0.0, 1.0]; 4],
        uvs: [Some(vec![[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]]), None],
        indices: vec![0, 1, 2, 1, 3, 2],
        ..Primitive::default()
    };
    scene.validate().expect("valid");
    let p = &scene.meshes[0].primitives[0];
    assert_eq!(p.positions.len(), 6, "the two vertices of the seam are doubled");
    let tangents = p.tangents.as_ref().expect("made");
    for (t, (expected, w)) in [([1.0, 0.0, 0.0], 1.0_f32), ([-1.0, 0.0, 0.0], -1.0)].iter().enumerate() {
        for corner in &p.indices[3 * t..3 * t + 3] {
            let got = tangents[*corner as usize];
            assert!(
                (0..3).all(|k| (got[k] - expected[k]).abs() < 1e-6) && got[3] == *w,
                "triangle {t}: {got:?}"
            );
        }
    }
}

#[test]
fn an_absent_uv_set_becomes_one_texel() {
    let mut scene = good();
    scene.materials[0].emissive_texture = Some(TextureRef { uv_set: 1, ..TextureRef::new(0) });
    scene.validate().expect("valid");
    assert_eq!(scene.meshes[0].primitives[0].uvs, [None, Some(vec![[0.0; 2]; 3])]);
}

#[test]
fn bounds_follow_motion() {
    let mut scene = good();
    scene.nodes.truncate(1);
    let path = Path::ConstantVelocity { start: Trs::default(), velocity: DVec3::Z };
    scene.nodes[0].motion = path.into();
    scene.validate().expect("valid");
    assert_eq!(scene.bounds(3.0), Some((DVec3::new(0.0, 0.0, 3.0), DVec3::new(1.0, 1.0, 3.0))));
    assert_eq!(Scene::default().bounds(0.0), None);
}

#[test]
fn every_broken_rule_is_named() {
    type Break = fn(&mut Scene);
    let cases: Vec<(Break, &str)> = vec![
        (|s| s.nodes[0].parent = Some(2), "node 0 'base' is its own ancestor"),
        (|s| s.nodes[0].parent = Some(0), "node 0 'base' is its own ancestor"),
        (
            |s| (s.nodes[1].parent, s.nodes[0].parent) = (None, Some(1)),
            "comes before its parent, node 1 'arm'",
        ),
        (|s| s.nodes[0].parent = Some(9), "parent 9"),
        (|s| s.nodes[2].mesh = Some(4), "node 2 'hand' refers to mesh 4, but there are 1"),
        (|s| s.nodes[2].skin = Some(4), "skin 4"),
        (|s| s.nodes[2].light = Some(4), "light 4"),
        (|s| s.nodes[2].motion = Motion::Fixed(DMat4::NAN), "not finite"),
        (
            |s| {
                s.nodes[2].motion =
                    Motion::Path(Arc::new(Path::Spin { start: Trs::default(), axis: DVec3::ZERO, rate: 1.0 }))
            },
            "axis",
        ),
        (|s| s.nodes[2].morph = Some(Curve::constant(vec![1.0])), "driven by 1 weights"),
        (|s| s.nodes[2].morph = Some(Curve::default()), "no keys"),
        (|s| s.skins[0].joints.push(1), "2 joints and 1 inverse"),
        (|s| s.skins[0].joints[0] = 7, "skin 0 refers to node 7"),
        (|s| s.skins[0].inverse_bind[0].x_axis.x = f64::NAN, "inverse bind matrix 0"),
        (|s| s.textures[0].image = 3, "texture 0 refers to image 3"),
        (|s| s.images[0].texels.clear(), "holds 0 texels"),
        (|s| s.images[0].width = 0, "0x1"),
        (|s| s.materials[0].base_color_texture = Some(TextureRef::new(5)), "texture 5"),
        (
            |s| s.materials[0].base_color_texture = Some(TextureRef { uv_set: 2, ..TextureRef::new(0) }),
            "UV set 2",
        ),
        (|s| s.materials[0].roughness = f32::NAN, "NaN"),
        (|s| s.materials[0].emissive[1] = -1.0, "negative"),
        (|s| s.background[0] = f32::INFINITY, "background"),
        (|s| s.meshes[0].primitives[0].material = 1, "mesh 0 'tile', primitive 0 refers to material 1"),
        (
            |s| s.meshes[0].primitives[0].positions[1][2] = f32::NAN,
            "'tile', primitive 0: position 1 is [1.0, 0.0, NaN]",
        ),
        (|s| s.meshes[0].primitives[0].normals = vec![[0.0; 3]], "1 normals for 3 positions"),
        (|s| s.meshes[0].primitives[0].uvs[0] = Some(vec![[f32::INFINITY; 2]; 3]), "texture coordinate 0"),
        (|s| s.meshes[0].primitives[0].colors = Some(vec![]), "0 colours"),
        (|s| s.meshes[0].primitives[0].joints = Some(vec![[0; 4]; 3]), "together"),
        (
            |s| {
                (s.meshes[0].primitives[0].joints, s.meshes[0].primitives[0].joint_weights) =
                    (Some(vec![[1; 4]; 3]), Some(vec![[1.0; 4]; 3]))
            },
            "joint 1 of a skin that has 1",
        ),
        (|s| s.meshes[0].primitives[0].morph_targets.push(MorphTarget::default()), "morph target 0"),
        (|s| s.meshes[0].primitives[0].indices[1] = 3, "index 3 for 3 vertices"),
        (|s| s.meshes[0].primitives[0].indices.push(0), "4 indices"),
        (|s| s.meshes[0].morph_weights.push(1.0), "morph weights"),
        (|s| s.lights[0].intensity = -1.0, "light 0 'lamp' has intensity -1"),
        (|s| s.lights[0].kind = LightKind::Spot { inner: 0.5, outer: 0.5 }, "cone"),
        (|s| s.lights[0].range = Some(0.0), "range"),
        (
            |s| {
                s.lights[0].waveform = Some(Waveform {
                    shape: WaveShape::Sine,
                    frequency_hz: -1.0,
                    phase: 0.0,
                    low: 0.0,
                    high: 1.0,
                })
            },
            "frequency_hz is -1",
        ),
        (|s| s.cameras[0].node = 8, "camera 'eye' refers to node 8"),
        (|s| s.cameras[0].lens = Lens::FieldOfView { fov_y: 3.2 }, "field of view of 3.2"),
        (|s| s.cameras[0].lens = Lens::Orthographic { height: 0.0, far: 9.0 }, "0 m high"),
        (|s| s.cameras[0].lens = Lens::Orthographic { height: 1.0, far: 0.001 }, "0.001 m deep"),
        (|s| s.cameras[0].lens = Lens::Intrinsics { fx: 0.0, fy: 1.0, cx: 0.0, cy: 0.0 }, "focal"),
        (|s| s.cameras[0].near = 0.0, "near"),
        (|s| s.cameras[0].width = Some(0), "0 pixels"),
        (|s| s.cameras[0].threshold_on = Some(0.0), "threshold 0"),
        (|s| s.duration_s = Some(-2.0), "duration_s is -2"),
        (
            |s| s.variants.push(Variant { node_offsets: vec![(5, DMat4::IDENTITY)], ..Variant::default() }),
            "variant 0 refers to node 5",
        ),
        (|s| s.variants.push(Variant { time_offset_s: f64::NAN, ..Variant::default() }), "time offset"),
        (|s| s.nodes.iter_mut().for_each(|n| n.mesh = None), "nothing to draw"),
    ];
    for (i, (break_it, part)) in cases.into_iter().enumerate() {
        let mut scene = good();
        break_it(&mut scene);
        match scene.validate() {
            Err(error) => assert!(error.to_string().contains(part), "case {i}, '{part}': {error}"),
            Ok(()) => panic!("case {i} was accepted: {part}"),
        }
    }
}
