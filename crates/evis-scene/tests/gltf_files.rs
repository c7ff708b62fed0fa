//! Files: what is read from good ones, and what is said about bad ones.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use std::io::Cursor;
use std::path::Path;

use common::{Glb, Random, pack};
use evis_scene::gltf::{Options, load, read};
use evis_scene::{AlphaMode, Lens, LightKind, Scene, SceneError, SceneState, ShadingModel, Wrap};
use half::f16;
use serde_json::{Value, json};

fn parse(bytes: &[u8]) -> Result<Scene, SceneError> {
    read(bytes, Path::new(""), &Options::default())
}

fn png() -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let image =
        image::RgbaImage::from_fn(4, 2, |x, y| image::Rgba([188, (x * 60) as u8, (y * 90) as u8, 255]));
    image::DynamicImage::ImageRgba8(image).write_to(&mut bytes, image::ImageFormat::Png).expect("in memory");
    bytes.into_inner()
}

/// A file that uses everything; tests break copies of it.
fn rich() -> (Glb, Value) {
    let mut glb = Glb::default();
    let positions = glb.floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0], "VEC3");
    let normals = glb.floats(&[0.0, 0.0, 1.0].repeat(4), "VEC3");
    let uvs = glb.floats(&[0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0], "VEC2");
    let indices = glb.indices(&[0, 1, 2, 3]);
    let colors = glb.accessor(&[255, 0, 51, 255].repeat(4), 5121, "VEC4", 4);
    let joints = glb.accessor(&[0, 1, 0, 0].repeat(4), 5121, "VEC4", 4);
    let weights = glb.floats(&[0.5, 0.5, 0.0, 0.0].repeat(4), "VEC4");
    let mut bind = [0.0; 16];
    for i in 0..4 {
        bind[5 * i] = 1.0;
    }
    let bind = glb.floats(&bind.repeat(2), "MAT4");
    let (sparse_at, sparse_to) = (glb.view(&[3, 0]), glb.view(&[0, 0, 0, 64].repeat(3)));
    glb.accessors.push(json!({"componentType": 5126, "type": "VEC3", "count": 4,
        "sparse": {"count": 1, "indices": {"bufferView": sparse_at, "componentType": 5123},
                   "values": {"bufferView": sparse_to}}}));
    let sparse = glb.accessors.len() - 1;
    let times = glb.floats(&[0.0, 1.0], "SCALAR");
    let turns = glb.floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0], "VEC4");
    let image = glb.view(&png());
    let transform = json!({"KHR_texture_transform": {"offset": [0.5, 0.0], "texCoord": 1}});
    let rest = json!({
        "extensionsUsed": ["KHR_lights_punctual", "KHR_texture_transform", "KHR_materials_unlit",
                           "KHR_materials_emissive_strength", "KHR_materials_clearcoat"],
        "extensionsRequired": ["KHR_texture_transform"],
        "extensions": {"KHR_lights_punctual": {"lights": [
            {"type": "spot", "intensity": 20.0, "spot": {"innerConeAngle": 0.1}}, {"type": "point", "range": 3.0}]}},
        "scene": 0,
        "scenes": [{"nodes": [0, 3]}, {"nodes": [5]}],
        "nodes": [
            {"name": "root", "children": [1, 2]},
            {"mesh": 0, "skin": 0, "extensions": {"KHR_lights_punctual": {"light": 0}}},
            {"camera": 0, "translation": [0, 0, 5]},
            {"name": "bone", "children": [4], "camera": 1},
            {"name": "tip", "matrix": [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,2,0,1]},
            {"name": "elsewhere", "mesh": 0, "camera": 0}],
        "cameras": [
            {"name": "eye", "type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1, "aspectRatio": 1.5}},
            {"name": "eye", "type": "orthographic",
             "orthographic": {"xmag": 2.0, "ymag": 1.0, "znear": 1.0, "zfar": 3.0}}],
        "skins": [{"joints": [3, 4], "inverseBindMatrices": bind}],
        "meshes": [{"name": "sail", "weights": [0.25], "primitives": [
            {"attributes": {"POSITION": positions, "NORMAL": normals, "TEXCOORD_0": uvs, "TEXCOORD_1": uvs,
                            "COLOR_0": colors, "JOINTS_0": joints, "WEIGHTS_0": weights},
             "indices": indices, "mode": 5, "material": 0, "targets": [{"POSITION": sparse}]},
            {"attributes": {"POSITION": positions}, "mode": 1}]}],
        "materials": [
            {"name": "cloth", "alphaMode": "BLEND", "doubleSided": true,
             "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 0}},
             "normalTexture": {"index": 0, "scale": 0.5, "extensions": transform},
             "emissiveFactor": [1.0, 0.5, 0.0],
             "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 8.0}}},
            {"extensions": {"KHR_materials_unlit": {}}, "alphaMode": "MASK", "alphaCutoff": 0.25}],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [{"wrapS": 33071, "wrapT": 33648, "magFilter": 9728}],
        "images": [{"bufferView": image, "mimeType": "image/png"}],
        "animations": [{"samplers": [{"input": times, "output": turns}],
                        "channels": [{"sampler": 0, "target": {"node": 3, "path": "rotation"}}]}],
    });
    (glb, rest)
}

#[test]
fn everything_in_a_rich_file_arrives() {
    let (glb, rest) = rich();
    let scene = parse(&glb.bytes(&rest)).expect("valid");
    let names: Vec<_> = scene.nodes.iter().map(|n| n.name.as_str()).collect();
    assert_eq!(names, ["root", "", "", "bone", "tip", "elsewhere"]);
    assert_eq!(scene.nodes[4].parent, Some(3));
    assert_eq!((scene.nodes[1].mesh, scene.nodes[5].mesh), (Some(0), None), "only the chosen scene is drawn");
    assert_eq!((scene.nodes[1].instance_id, scene.duration_s), (1, Some(1.0)));

    let primitive = &scene.meshes[0].primitives[0];
    assert_eq!(scene.meshes[0].primitives.len(), 1, "lines are left out");
    assert_eq!(primitive.indices, [0, 1, 2, 1, 3, 2]);
    let colors = primitive.colors.as_ref().expect("colours");
    assert_eq!(colors[2], [1.0, 0.0, 0.2, 1.0]);
    assert_eq!(primitive.joints.as_ref().expect("joints")[0], [0, 1, 0, 0]);
    assert_eq!(primitive.morph_targets[0].positions, [[0.0; 3], [0.0; 3], [0.0; 3], [2.0; 3]]);
    assert_eq!(scene.meshes[0].morph_weights, [0.25]);
    let tangents = primitive.tangents.as_ref().expect("made for the normal map");
    assert!(tangents.iter().all(|t| (t[0] - 1.0).abs() < 1e-6 && t[3] == 1.0), "{tangents:?}");

    let cloth = &scene.materials[0];
    assert_eq!((cloth.alpha, cloth.double_sided, cloth.normal_scale), (AlphaMode::Mask(0.5), true, 0.5));
    assert_eq!(cloth.emissive, [8.0, 4.0, 0.0]);
    let normal = cloth.normal_texture.expect("normal map");
    assert_eq!((normal.uv_set, normal.transform), (1, [1.0, 0.0, 0.5, 0.0, 1.0, 0.0]));
    assert_eq!(
        (scene.materials[1].model, scene.materials[1].alpha),
        (ShadingModel::Unlit, AlphaMode::Mask(0.25))
    );

    // One file image, used as colour and as data: two images.
    assert_eq!((scene.images.len(), scene.textures.len()), (2, 2));
    let red = |texture: usize| scene.images[scene.textures[texture].image].texels[0][0];
    let decoded = f16::from_f64(((188.0 / 255.0 + 0.055) / 1.055_f64).powf(2.4));
    assert_eq!(red(cloth.base_color_texture.expect("colour").texture), decoded);
    assert_eq!(red(normal.texture), f16::from_f64(188.0 / 255.0));
    let texture = scene.textures[normal.texture];
    assert_eq!((texture.wrap_u, texture.wrap_v, texture.nearest), (Wrap::Clamp, Wrap::Mirror, true));

    assert_eq!(scene.lights.len(), 2);
    assert!(matches!(scene.lights[0].kind, LightKind::Spot { inner, outer } if inner == 0.1 && outer > 0.7));
    assert_eq!(scene.lights[1].range, Some(3.0));

    let names: Vec<_> = scene.cameras.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["eye", "eye_2"]);
    assert_eq!((scene.cameras[0].aspect, scene.cameras[0].node), (Some(1.5), 2));
    assert_eq!(scene.cameras[1].lens, Lens::Orthographic { height: 2.0, far: 3.0 });
    assert_eq!((scene.cameras[1].aspect, scene.cameras[1].near), (Some(2.0), 1.0));

    for part in ["KHR_materials_clearcoat", "blended", "lines"] {
        assert!(scene.warnings.iter().any(|w| w.contains(part)), "{part}: {:?}", scene.warnings);
    }

    // Skinned to two joints that stand still at first: (p + p + (0, 2, 0)) / 2.
    let (low, high) = scene.bounds(0.0).expect("drawn");
    let near = |a: glam::DVec3, b: [f64; 3]| (a - glam::DVec3::from_array(b)).length() < 1e-9;
    assert!(near(low, [0.0, 1.0, 0.0]) && near(high, [1.5, 2.5, 0.5]), "{low} {high}");
    let mut state = SceneState::default();
    scene.evaluate(1.0, &mut state);
    let mut joints = Vec::new();
    scene.joint_matrices(0, &state, &mut joints);
    assert!((joints[1].w_axis.y + 2.0).abs() < 1e-9, "turned upside down: {}", joints[1]);
}

#[test]
fn a_gltf_with_files_beside_it_is_read_and_missing_ones_are_named() {
    let folder = std::env::temp_dir().join(format!("evis-gltf-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a temporary folder");
    let (glb, mut rest) = rich();
    rest["images"] = json!([{"uri": "my%20cloth.png"}]);
    let mut json = glb.json(&rest);
    json["buffers"][0]["uri"] = "mesh.bin".into();
    let path = folder.join("sail.gltf");
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).expect("writable");
    write("sail.gltf", json.to_string().as_bytes());
    let error = load(&path, &Options::default()).expect_err("no buffer").to_string();
    assert!(error.contains("sail.gltf") && error.contains("mesh.bin"), "{error}");
    write("mesh.bin", &glb.binary);
    let error = load(&path, &Options::default()).expect_err("no texture").to_string();
    assert!(error.contains("my cloth.png") && error.contains("image 0"), "{error}");
    write("my cloth.png", &png());
    let scene = load(&path, &Options::default()).expect("complete");
    assert_eq!((scene.name.as_str(), scene.images.len()), ("sail", 2));
    // A part of another scene is not completed, and need not be complete.
    let part = load(&path, &Options { standalone: false, ..Options::default() }).expect("complete");
    assert_eq!(part.nodes[1].instance_id, 0);
    let error = load(&folder.join("none.glb"), &Options::default()).expect_err("no file").to_string();
    assert!(error.contains("none.glb"), "{error}");
    std::fs::remove_dir_all(&folder).expect("removable");
}

#[test]
fn data_uris_hold_buffers() {
    let json = json!({"asset": {"version": "2.0"}, "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, "uri":
            "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]});
    let scene = parse(json.to_string().as_bytes()).expect("valid");
    let primitive = &scene.meshes[0].primitives[0];
    assert_eq!(primitive.positions, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    assert_eq!(primitive.normals, [[0.0, 0.0, 1.0]; 3], "flat normals are made");
}

#[test]
fn a_file_without_camera_is_framed_whole() {
    let mut glb = Glb::default();
    let triangle = glb.floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0], "VEC3");
    let times = glb.floats(&[0.0, 1.0], "SCALAR");
    let moved = glb.floats(&[-5.0, 0.0, 0.0, 5.0, 2.0, 0.0], "VEC3");
    let bytes = glb.bytes(&json!({
        "nodes": [{"mesh": 0}], "meshes": [{"primitives": [{"attributes": {"POSITION": triangle}}]}],
        "animations": [{"samplers": [{"input": times, "output": moved}],
                        "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}]}]}));
    let mut scene = parse(&bytes).expect("valid");
    let camera = scene.camera("default").expect("added");
    let mut state = SceneState::default();
    let mut widest = 0.0_f64;
    for k in 0..=20 {
        scene.evaluate(f64::from(k) / 20.0, &mut state);
        let world = scene.world_from_camera(camera, &state).expect("rigid");
        let (low, high) = scene.bounds(f64::from(k) / 20.0).expect("drawn");
        for corner in 0..8 {
            let pick = |i: usize| if corner >> i & 1 == 1 { high[i] } else { low[i] };
            let p = world.inverse().transform_point3(glam::DVec3::new(pick(0), pick(1), pick(2)));
            let tan = (22.5_f64).to_radians().tan();
            assert!(p.z < -scene.cameras[camera].near);
            widest = widest.max((p.y / -p.z / tan).abs()).max((p.x / -p.z / tan / (4.0 / 3.0)).abs());
        }
    }
    assert!((0.8..1.0).contains(&widest), "the scene fills {widest} of the picture");
    assert!(scene.needs_light());
    scene.add_default_light();
    assert!(!scene.needs_light() && scene.validate().is_ok());
}

/// Breaks the rich file's JSON at `pointer` and says what the error must tell.
#[test]
fn bad_files_get_clear_errors() {
    let (glb, rest) = rich();
    let good = glb.json(&rest);
    assert!(parse(&pack(&good, &glb.binary)).is_ok());
    let huge = json!(u64::MAX);
    let cases = [
        ("/accessors/0/count", json!(5), "accessor 0"),
        ("/accessors/0/count", huge.clone(), "accessor 0"),
        ("/accessors/0/count", json!(-1), "-1"),
        ("/accessors/0/count", json!(0), "0 positions"),
        ("/accessors/0/byteOffset", huge.clone(), "buffer view 0"),
        ("/accessors/0/bufferView", json!(99), "buffer view 99"),
        ("/accessors/0/type", json!("VEC2"), "Vec3"),
        ("/accessors/0/componentType", json!(1), "unknown type"),
        ("/accessors/1/count", json!(3), "3 elements for 4 positions"),
        ("/accessors/8/count", huge.clone(), "would take"),
        ("/accessors/8/sparse/count", json!(100), "accessor 8"),
        ("/accessors/8/sparse/indices/bufferView", json!(77), "buffer view 77"),
        ("/accessors/8/count", json!(3), "element 3 of 3"),
        ("/bufferViews/0/byteLength", huge.clone(), "buffer view 0"),
        ("/bufferViews/0/byteOffset", huge.clone(), "buffer view 0"),
        ("/bufferViews/0/buffer", json!(3), "buffer 3"),
        ("/bufferViews/0/byteStride", json!(0), "stride"),
        ("/buffers/0/byteLength", huge, "buffer 0"),
        ("/buffers/0/uri", json!("https://example.org/a.bin"), "data URIs"),
        ("/meshes/0/primitives/0/attributes/POSITION", json!(1234), "accessor 1234"),
        ("/meshes/0/primitives/0/material", json!(9), "material 9"),
        ("/meshes/0/primitives/0/mode", json!(9), "mode"),
        ("/meshes/0/weights", json!([1, 2, 3, 4]), "morph weights"),
        ("/nodes/0/children", json!([1, 2, 0]), "own ancestor"),
        ("/nodes/4/children", json!([3]), "own ancestor"),
        ("/nodes/4/children", json!([1]), "child of both"),
        ("/nodes/0/children", json!([88]), "node 88"),
        ("/nodes/1/mesh", json!(5), "mesh 5"),
        ("/nodes/1/skin", json!(5), "skin 5"),
        ("/nodes/2/camera", json!(5), "camera 5"),
        ("/nodes/1/extensions/KHR_lights_punctual/light", json!(5), "light 5"),
        ("/scenes/0/nodes", json!([44]), "node 44"),
        ("/scene", json!(7), "scene 7"),
        ("/skins/0/joints", json!([3, 66]), "node 66"),
        ("/skins/0/joints", json!([3, 4, 0]), "inverse bind"),
        ("/skins/0/joints", json!([3]), "joint 1"),
        ("/cameras/0/perspective/yfov", json!(4.0), "field of view"),
        ("/cameras/0/perspective/znear", json!(0.0), "near"),
        ("/materials/0/normalTexture/index", json!(12), "texture 12"),
        ("/textures/0/source", json!(12), "image 12"),
        ("/textures/0/sampler", json!(12), "sampler 12"),
        ("/images/0/bufferView", json!(0), "image 0"),
        ("/animations/0/channels/0/sampler", json!(3), "sampler 3"),
        ("/animations/0/channels/0/target/node", json!(30), "node 30"),
        ("/animations/0/samplers/0/input", json!(0), "Scalar"),
        ("/animations/0/samplers/0/interpolation", json!("CUBICSPLINE"), "curve"),
        ("/extensionsRequired", json!(["KHR_draco_mesh_compression"]), "KHR_draco_mesh_compression"),
        ("/extensionsRequired", json!(["EXT_meshopt_compression"]), "EXT_meshopt_compression"),
        ("/asset/version", json!("1.0"), "1.0"),
        ("/extensions/KHR_lights_punctual/lights/0/type", json!("laser"), "directional, point and spot"),
        ("/scenes/0/nodes", json!([3]), "nothing to draw"),
    ];
    for (pointer, value, part) in cases {
        let mut json = good.clone();
        let (parent, key) = pointer.rsplit_once('/').expect("a path");
        let slot = json.pointer_mut(parent).unwrap_or_else(|| panic!("no {parent}"));
        match slot {
            Value::Array(list) => list[key.parse::<usize>().expect("an index")] = value,
            other => other[key] = value,
        }
        match parse(&pack(&json, &glb.binary)) {
            Err(error) => assert!(error.to_string().contains(part), "{pointer}: {error}"),
            Ok(_) => panic!("{pointer} was accepted"),
        }
    }
}

#[test]
fn bad_containers_get_clear_errors() {
    let (glb, rest) = rich();
    let good = glb.bytes(&rest);
    let mut old = good.clone();
    old[4] = 1;
    let mut chunk = good.clone();
    chunk[16..20].copy_from_slice(b"WHAT");
    for (bytes, part) in [
        (&b""[..], "0 bytes"),
        (b"hello, this is no model", "68 65 6c 6c"),
        (&good[..10], "truncated"),
        (&good[..good.len() / 2], "truncated"),
        (&old, "version 1"),
        (&chunk, "WHAT"),
        (b"{\"asset\": {\"version\": \"2.0\"}", "JSON"),
        (b"{}", "version"),
        (b"{\"asset\": {\"version\": \"2.0\"}}", "nothing to draw"),
    ] {
        let error = parse(bytes).expect_err("bad").to_string();
        assert!(error.contains(part), "{error}");
    }
}

#[test]
fn nan_positions_are_refused_with_the_name_of_the_mesh() {
    let (mut glb, rest) = rich();
    glb.binary[0..4].copy_from_slice(&f32::NAN.to_le_bytes());
    let error = parse(&glb.bytes(&rest)).expect_err("NaN").to_string();
    assert!(error.contains("sail") && error.contains("NaN"), "{error}");
}

#[test]
fn no_damage_makes_the_reader_panic() {
    let (glb, rest) = rich();
    let good = glb.bytes(&rest);
    for end in 0..good.len() {
        assert!(parse(&good[..end]).is_err(), "cut at {end}");
    }
    let mut random = Random(11);
    let json_end = 20 + u32::from_le_bytes([good[12], good[13], good[14], good[15]]) as usize;
    let (mut accepted, mut refused) = (0, 0);
    for round in 0..6000 {
        let mut bytes = good.clone();
        for _ in 0..=random.below(3) {
            // Half of the damage hits the JSON's digits, where it changes meaning and not just syntax.
            let at =
                if round % 2 == 0 { random.below(bytes.len()) } else { 20 + random.below(json_end - 20) };
            if round % 2 == 1 && bytes[at].is_ascii_digit() {
                bytes[at] = b'0' + random.below(10) as u8;
            } else if round % 2 == 0 {
                bytes[at] = random.next() as u8;
            }
        }
        match parse(&bytes) {
            Ok(scene) => {
                accepted += 1;
                let mut state = SceneState::default();
                scene.evaluate(0.3, &mut state);
                scene.bounds(0.3);
            }
            Err(_) => refused += 1,
        }
    }
    assert!(
        accepted > 100 && refused > 1000,
        "{accepted} accepted, {refused} refused: the damage tests too little"
    );
}

#[test]
fn extras_of_nodes_give_classes_and_what_cannot_be_used_is_said() {
    let scene = |extras: Value| {
        let (glb, mut rest) = rich();
        rest["nodes"][1]["extras"] = extras;
        // A second node of the same class, in the scene of its own that the file has.
        rest["nodes"][4]["extras"] = json!({"semantic_id": 7, "semantic_name": "other"});
        parse(&glb.bytes(&rest)).expect("valid")
    };
    let named = scene(json!({"semantic_id": 7, "semantic_name": "sail", "price": 3}));
    assert_eq!(named.nodes[1].semantic_id, 7);
    assert_eq!(named.class_names.get(&7).map(String::as_str), Some("sail"));
    let told = named.warnings.join("\n");
    assert!(told.contains("class 7 is 'other' here and 'sail' elsewhere"), "{told}");
    for (extras, expected) in [
        (json!({"semantic_id": -1}), "semantic_id is -1 and ignored"),
        (json!({"semantic_id": "sail"}), "semantic_id is \"sail\" and ignored"),
        (json!({"semantic_id": 4_294_967_296_u64}), "semantic_id is 4294967296 and ignored"),
        (json!({"semantic_name": "sail"}), "semantic_name is \"sail\" and ignored: it takes a semantic_id"),
    ] {
        let scene = scene(extras);
        assert_eq!(scene.nodes[1].semantic_id, 0);
        assert!(scene.warnings.iter().any(|warning| warning.contains(expected)), "{:?}", scene.warnings);
    }
    for silent in [json!({"semantic_id": 0}), json!("text"), json!({"semantic_id": 7, "semantic_name": ""})] {
        assert!(!scene(silent).warnings.iter().any(|warning| warning.contains("ignored: it takes")));
    }
}
