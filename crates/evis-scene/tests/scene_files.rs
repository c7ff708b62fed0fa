//! Scene files: the same as builder calls, clear about mistakes, and never a panic.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::path::{Path, PathBuf};

use evis_scene::builder::{EventCamera, Labels, Placement, SceneBuilder, ShapeSettings};
use evis_scene::motion::{PathInterpolation, WaveShape, Waveform};
use evis_scene::primitive::Shape;
use evis_scene::procedural::{PATTERNS, Pattern, Procedural, srgb};
use evis_scene::toml_scene::{load, parse};
use evis_scene::{
    BodyMass, Collider, Dynamics, Lens, Light, LightFactors, Material, MaterialFactors, Motion, RigidBody,
    Scene, SceneError, Trs, Variant,
};
use glam::{DMat4, DQuat, DVec3};

const DOCUMENT: &str = include_str!("../../../docs/scene-files.md");

/// The TOML blocks of the document.
fn blocks() -> Vec<&'static str> {
    DOCUMENT.split("```toml\n").skip(1).filter_map(|rest| rest.split("```").next()).collect()
}

fn example() -> &'static str {
    blocks().into_iter().find(|block| block.starts_with("name = ")).expect("the complete example")
}

/// A folder of its own under the build's, emptied by the next run that takes the same name.
fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::create_dir_all(&folder).expect("a writable build folder");
    folder
}

fn read(text: &str) -> Result<Scene, SceneError> {
    parse(text, "")
}

fn message(text: &str) -> String {
    read(text).err().map_or_else(|| "no error".into(), |e| e.to_string())
}

#[test]
fn the_documented_example_is_a_scene() {
    let scene = read(example()).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(scene.name, "still life");
    assert_eq!(scene.duration_s, Some(3.0));
    assert_eq!(scene.background, srgb(0x202830));
    assert_eq!(scene.cameras.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(), ["left", "hand"]);
    assert_eq!(scene.cameras[1].threshold_on, Some(0.25));
    assert_eq!(scene.lights.len(), 2);
    let seeds: Vec<_> = scene.variants.iter().map(|v| (v.seed_offset, v.time_offset_s)).collect();
    assert_eq!(seeds, [(0, 0.0), (1, 0.2), (2, 0.4), (100, 0.0)]);
    assert_eq!(scene.variants[3].node_offsets.len(), 2);
    assert!(scene.nodes.iter().enumerate().all(|(i, n)| n.parent.is_none_or(|p| p < i)));
}

#[test]
fn every_documented_fragment_has_only_keys_that_exist() {
    assert!(blocks().len() >= 5, "the document has lost its fragments");
    for block in blocks() {
        // The files that a fragment names are not there, and that is the only thing wrong with it.
        let message = message(block);
        let fine = ["no error", "cannot read", "nothing to draw"];
        let fine = fine.iter().any(|m| message.contains(m));
        assert!(fine, "{message}\n{block}");
    }
    for (name, _) in PATTERNS {
        assert!(DOCUMENT.contains(&format!("`{name}`")), "pattern {name} is not documented");
    }
}

/// The part of a scene that can be compared as text.
fn shown(scene: &Scene) -> String {
    format!("{scene:#?}")
}

#[test]
fn a_file_and_builder_calls_give_equal_scenes() {
    let text = r##"
        name = "both"
        duration_s = 2
        background = "#102030"
        ambient = [0.5, 0.25, 0.125]
        [[textures]]
        name = "t"
        pattern = "checker"
        size = 16
        seed = 3
        [[materials]]
        name = "m"
        model = "metallic_roughness"
        texture = "t"
        metallic = 0.25
        roughness = 0.5
        emissive = [1, 1, 1]
        emissive_strength = 2
        waveform = { shape = "square", frequency_hz = 50 }
        [[primitives]]
        name = "ball"
        shape = "sphere"
        radius = 0.5
        segments = [8, 4]
        uv_repeat = [2, 1]
        material = "m"
        semantic_id = 7
        parent = "cart"
        position = [0, 1, 0]
        motion = { kind = "spin", degrees_per_s = 180, axis = [0, 2, 0] }
        [[nodes]]
        name = "cart"
        position = [1, 0, 0]
        motion = { kind = "constant_velocity", velocity = [1, 0, 0] }
        [dynamics]
        gravity = [0, -1.6, 0]
        rate_hz = 500
        substeps = 8
        [[primitives]]
        name = "rock"
        shape = "box"
        size = [1, 2, 3]
        material = "m"
        position = [5, 0, 0]
        [primitives.rigid_body]
        mass = 2
        friction = 0.25
        restitution = 0.75
        velocity = [1, 2, 3]
        spin_axis = [0, 0, 2]
        spin_degrees_per_s = 180
        launch_s = 0.5
        [[primitives]]
        name = "wall"
        shape = "card"
        size = [1, 2]
        material = "m"
        position = [9, 0, 0]
        rigid_body = { fixed = true, shape = "box", size = [1, 2, 0.5] }
        [[lights]]
        name = "spot"
        kind = "spot"
        intensity = 5
        inner_degrees = 10
        outer_degrees = 20
        casts_shadow = true
        position = [0, 3, 0]
        look_at = [0, 0, 0]
        [[cameras]]
        name = "eye"
        size = [32, 24]
        fov_y_degrees = 45
        threshold_on = 0.5
        threshold_off = 0.25
        motion = { kind = "keys", times_s = [0, 1], positions = [[0, 0, 2], [0, 0, 3]] }
        position = [0, 0.5, 0]
        [[environments]]
        [[environments]]
        time_offset_s = 1.5
        offsets.cart = { position = [0, 0, 1] }
        materials.m = { color = [0.5, 0.25, 1], roughness = 0.75 }
        lights.spot = { intensity = 2, on = false }
        cameras.eye = { fx = 40, cx = 15 }
        [[environments]]
        cameras.eye = { orthographic_height = 3, far = 20 }
    "##;
    let from_file = read(text).unwrap_or_else(|e| panic!("{e}"));

    let build = |radius: f64| -> Result<Scene, SceneError> {
        let mut scene = SceneBuilder::new("both");
        scene.duration_s(2.0)?.background(srgb(0x102030))?.ambient([0.5, 0.25, 0.125])?;
        let t = scene.procedural("t", &Procedural::new(Pattern::Checker, 16, 3), Default::default())?;
        let flicker =
            Waveform { shape: WaveShape::Square, frequency_hz: 50.0, phase: 0.0, low: 0.0, high: 1.0 };
        let m = Material::glossy("m", 0.25, 0.5).textured(t).emitting([2.0; 3], Some(flicker));
        let m = scene.material(m)?;
        let start = Trs { translation: DVec3::X, ..Trs::default() };
        let drive = evis_scene::motion::Path::ConstantVelocity { start, velocity: DVec3::X };
        let cart = scene.node("cart", Placement::along(drive))?;
        let start = Trs { translation: DVec3::Y, ..Trs::default() };
        let spin = evis_scene::motion::Path::Spin { start, axis: DVec3::Y, rate: std::f64::consts::PI };
        let labels = Labels { semantic_id: 7, instance_id: 0 };
        let settings = ShapeSettings { labels, ..ShapeSettings::default().segments(8, 4).repeat(2.0, 1.0) };
        scene.shape_with("ball", Shape::Sphere { radius }, m, settings, Placement::along(spin).on(cart))?;
        let gravity = DVec3::new(0.0, -1.6, 0.0);
        scene.dynamics(Dynamics { gravity, rate_hz: 500.0, substeps: 8 })?;
        let rock = RigidBody::thrown([1.0, 2.0, 3.0])
            .mass(BodyMass::Kilograms(2.0))
            .surface(0.25, 0.75)
            .spinning(DVec3::Z * 2.0, std::f64::consts::PI)
            .launched(0.5);
        let place = Placement::at([5.0, 0.0, 0.0]).as_body(rock);
        scene.shape("rock", Shape::Box { size: [1.0, 2.0, 3.0] }, m, place)?;
        let wall = RigidBody::fixed().collider(Collider::Box { size: [1.0, 2.0, 0.5] });
        let place = Placement::at([9.0, 0.0, 0.0]).as_body(wall);
        scene.shape("wall", Shape::Card { size: [1.0, 2.0] }, m, place)?;
        let spot = Light::spot("spot", 5.0, 10.0, 20.0).with_shadow();
        scene.light(spot, Placement::looking_at([0.0, 3.0, 0.0], [0.0; 3]))?;
        let keys = evis_scene::motion::Path::Keys {
            times: vec![0.0, 1.0],
            positions: vec![DVec3::Z * 2.0, DVec3::Z * 3.0],
            rotations: vec![DQuat::IDENTITY; 2],
            velocities: vec![],
            interpolation: PathInterpolation::Linear,
        };
        let eye = EventCamera::new("eye").size(32, 24).fov_y_degrees(45.0).thresholds(0.5, 0.25);
        scene.camera(eye, Placement::at([0.0, 0.5, 0.0]).moving(keys))?;
        scene.variant(Variant::default())?;
        let node_offsets = vec![(cart, DMat4::from_translation(DVec3::Z))];
        let mut other = Variant { seed_offset: 1, time_offset_s: 1.5, node_offsets, ..Variant::default() };
        for material in scene.find_materials("m")? {
            let own = scene.scene().materials[material].factors();
            let factors = MaterialFactors { base_color: [0.5, 0.25, 1.0], roughness: 0.75, ..own };
            other = other.with_material(material, factors);
        }
        let spot = LightFactors { color: [1.0; 3], intensity: 2.0, on: false };
        let lens = Lens::Intrinsics { fx: 40.0, fy: 40.0, cx: 15.0, cy: 12.0 };
        scene.variant(other.with_light(0, spot).with_lens(0, lens))?;
        let above = Lens::Orthographic { height: 3.0, far: 20.0 };
        scene.variant(Variant { seed_offset: 2, ..Variant::default() }.with_lens(0, above))?;
        scene.build()
    };
    let from_code = build(0.5).unwrap_or_else(|e| panic!("{e}"));
    assert!(shown(&from_file) == shown(&from_code), "{:#?}\n{:#?}", from_file.nodes, from_code.nodes);
    // Canary: another radius is another scene.
    assert!(build(0.25).is_ok_and(|other| shown(&other) != shown(&from_file)));
}

const BALL: &str = "[[materials]]\nname = 'm'\n[[primitives]]\nname = 'ball'\nshape = 'sphere'\nradius = 1\nmaterial = 'm'\n";

#[test]
fn mistakes_are_named_with_their_place_and_the_remedy() {
    let ball = |more: &str| format!("{BALL}{more}");
    let body = |body: &str| format!("duration_s = 1\n{BALL}rigid_body = {body}");
    for (text, expected) in [
        ("nmae = 'x'".into(), vec!["unknown key 'nmae' at the top level", "did you mean 'name'?"]),
        (ball("positon = [0, 0, 0]"), vec!["unknown key 'positon' in [[primitives]] 'ball'", "'position'"]),
        (ball("zzz = 1"), vec!["unknown key 'zzz'", "it takes", "uv_repeat"]),
        (BALL.replace("radius", "radus"), vec!["'ball'", "'radius' is missing", "there is 'radus'"]),
        (BALL.replace("= 1", "= 'big'"), vec!["[[primitives]] 'ball': radius is", "big", "a number"]),
        (BALL.replace("= 1", "= -1"), vec!["[[primitives]] 'ball'", "radius of a sphere is -1", "between"]),
        (BALL.replace("'sphere'", "'spere'"), vec!["shape is", "spere", "did you mean \"sphere\"?"]),
        (BALL.replace("material = 'm'", "material = 'n'"), vec!["'ball'", "no material named 'n'", "there is m"]),
        (ball("parent = 'bal'"), vec!["no object named 'bal'", "ball"]),
        (ball("parent = 'ball'"), vec!["circle"]),
        (ball("segments = [1, 1]"), vec!["segments of a sphere are [1, 1]", "between 3 and 1024"]),
        (ball("look_at = [0, 0, 0]"), vec!["look_at", "the position itself"]),
        (ball("look_at = [0, 0, 1]\nrotation = [0, 0, 0, 1]"), vec!["rotation and look_at exclude each other"]),
        (ball("rotation = [0, 0, 0, 2]"), vec!["length 2.0000", "unit quaternion"]),
        (ball("scale = 0"), vec!["'ball'", "scale", "other than 0"]),
        (ball("motion = { kind = 'spin' }"), vec!["'ball', motion", "'degrees_per_s' is missing"]),
        (ball("motion = { kind = 'spin', degrees_per_s = 1, rate = 2 }"), vec!["unknown key 'rate'", "motion"]),
        (ball("motion = { kind = 'spin', degrees_per_s = 1, axis = [0, 0, 0] }"), vec!["'ball'", "axis is", "not zero"]),
        (ball("motion = { kind = 'chain', motions = [] }"), vec!["motions is missing or empty"]),
        (
            ball("motion = { kind = 'keys', times_s = [1, 0], positions = [[0, 0, 0], [0, 0, 1]] }"),
            vec!["time 0 s of a path comes after 1 s"],
        ),
        (
            ball("motion = { kind = 'trajectory', file = 'none.csv' }"),
            vec!["cannot read", "none.csv"],
        ),
        (body("{ friction = -1 }"), vec!["[[primitives]] 'ball': friction is -1", "between 0 and 100"]),
        (body("{ mass = -2 }"), vec!["'ball': mass is -2", "between"]),
        (body("{ density = nan }"), vec!["'ball': density is NaN"]),
        (body("{ density = 1, mass = 1 }"), vec!["'ball', rigid_body: density and mass exclude each other"]),
        (body("{ restitution = 1.5 }"), vec!["restitution is 1.5", "between 0 and 1"]),
        (body("{ shape = 'bix' }"), vec!["'ball', rigid_body: shape is", "did you mean \"box\"?"]),
        (body("{ shape = 'box' }"), vec!["rigid_body: the key 'size' is missing"]),
        (body("{ shape = 'sphere', radius = 0 }"), vec!["'ball': radius of its collider is 0", "between"]),
        (body("{ shape = 'box', size = [1, nan, 1] }"), vec!["size of its collider is NaN"]),
        (body("{ shape = 'mesh' }"), vec!["'ball': its collider is a mesh, which has no mass", "hull"]),
        (body("{ shape = 'half_space' }"), vec!["its collider is a half_space"]),
        (body("{ velocity = [0, inf, 0] }"), vec!["'ball': velocity is", "finite"]),
        (body("{ velocity = [0, 1e5, 0] }"), vec!["length of velocity is 100000", "1000"]),
        (body("{ spin_axis = [0, 0, 0] }"), vec!["spin_axis is", "not zero"]),
        (body("{ launch_s = -1 }"), vec!["launch_s is -1", "0 or more"]),
        (body("{ veloctiy = [0, 0, 0] }"), vec!["unknown key 'veloctiy' in [[primitives]] 'ball', rigid_body", "'velocity'"]),
        (body("{ fixed = true, velocity = [0, 0, 0] }"), vec!["unknown key 'velocity'", "rigid_body"]),
        (body("{}\nmotion = { kind = 'spin', degrees_per_s = 9 }"), vec!["'ball': it has a motion and is a rigid body"]),
        (body("{}").replace("duration_s", "#"), vec!["'ball' is a rigid body, and the scene has no duration_s"]),
        (body("{}\nscale = [1, 2, 1]"), vec!["'ball': its scale is [1, 2, 1]", "no sphere of a sphere", "hull"]),
        (
            body("{}\nparent = 'p'\n[[nodes]]\nname = 'p'\nmotion = { kind = 'spin', degrees_per_s = 9 }"),
            vec!["'ball' hangs on 'p', which moves"],
        ),
        (
            body("{}\nparent = 'p'\nrotation_degrees = [0, 0, 30]\n[[nodes]]\nname = 'p'\nscale = [1, 2, 1]"),
            vec!["'ball' is skewed by the scales above it"],
        ),
        (
            body("{}\nparent = 'p'\n[[nodes]]\nname = 'p'\nrigid_body = { shape = 'sphere', radius = 1 }"),
            vec!["'ball' hangs on the rigid body 'p' and is one itself"],
        ),
        (
            body("{}\n[[environments]]\noffsets.ball = { position = [0, 1, 0] }"),
            vec!["an environment has an offset for 'ball'", "leave it out"],
        ),
        ("[dynamics]\nrate_hz = 10".into(), vec!["[dynamics]: rate_hz is 10", "between 100 and 100000"]),
        ("[dynamics]\nsubsteps = 0".into(), vec!["[dynamics]: substeps is 0", "between 1 and 64"]),
        ("[dynamics]\ngravity = [0, nan, 0]".into(), vec!["[dynamics]: gravity is"]),
        ("[dynamics]\ngravitiy = [0, 1, 0]".into(), vec!["unknown key 'gravitiy' in [dynamics]", "'gravity'"]),
        ("[[cameras]]\nname = 'c'\nfov_y_degrees = 180".into(), vec!["[[cameras]] 'c': fov_y_degrees is 180", "179"]),
        ("[[cameras]]\nname = 'c'\nfov_y_degrees = -60".into(), vec!["line 3: [[cameras]] 'c': fov_y_degrees is -60; it"]),
        ("[[cameras]]\nname = 'c'\nthreshold_on = 0".into(), vec!["threshold_on is 0", "above 0"]),
        ("[[cameras]]\nname = 'c'\nsize = [0, 4]".into(), vec!["size is [0, 4]", "8192"]),
        ("[[cameras]]\nname = 'c'\nfx = 100".into(), vec!["'cx' is missing"]),
        ("[[cameras]]\nname = 'c'\nsize = [8, 8]\nfx = 100\nfov_y_degrees = 60".into(), vec!["fov_y_degrees and fx exclude"]),
        ("[[cameras]]\nname = 'c'\nfov_y_degrees = 9\northographic_height = 1\nfar = 9".into(), vec!["fov_y_degrees and orthographic_height exclude"]),
        ("[[cameras]]\nname = 'c'\northographic_height = 1".into(), vec!["'far' is missing"]),
        ("[[cameras]]\nname = 'c'\nfov_y_degrees = 9\nfar = 9".into(), vec!["far is given without orthographic_height"]),
        ("[[cameras]]\nname = 'c'\northographic_height = -1\nfar = 9".into(), vec!["orthographic_height is -1", "metres"]),
        ("[[cameras]]\nname = 'c'\northographic_height = 1\nfar = 0.01".into(), vec!["far is 0.01 and near 0.05"]),
        (
            "[[cameras]]\nname = 'c'\northographic_height = 1\nfar = 9\ndistortion = { model = 'fisheye' }".into(),
            vec!["distortion is given without focal lengths"],
        ),
        ("[[cameras]]\nname = 'c'\n[[cameras]]\nname = 'c'".into(), vec!["two cameras are named 'c'"]),
        ("[[lights]]\nname = 'l'\nkind = 'point'\nintensity = -3".into(), vec!["[[lights]] 'l': intensity is -3", "candela"]),
        ("[[lights]]\nname = 'l'\nkind = 'point'\nintensity = 1\ncasts_shadow = true".into(), vec!["point light"]),
        (
            "[[lights]]\nname = 'l'\nkind = 'point'\nintensity = 1\nwaveform = { shape = 'pwm', frequency_hz = 5, duty = 1 }".into(),
            vec!["duty is 1"],
        ),
        ("[[lights]]\nkind = 'point'\nintensity = 1".into(), vec!["[[lights]] number 1: the key 'name' is missing"]),
        ("[[textures]]\nname = 't'\npattern = 'brick'".into(), vec!["pattern is", "did you mean \"bricks\"?"]),
        ("[[textures]]\nname = 't'\npattern = 'wood'\nsize = 8".into(), vec!["size of a procedural texture is 8", "16"]),
        ("[[textures]]\nname = 't'\npattern = 'wood'\nfile = 'x.png'".into(), vec!["file and pattern exclude"]),
        ("[[materials]]\nname = 'm'\ntexture = 'none'".into(), vec!["[[materials]] 'm'", "no texture named 'none'"]),
        ("[[materials]]\nname = 'm'\nmodel = 'metallic_roughness'\nroughness = 2".into(), vec!["roughness is 2", "0 and 1"]),
        ("[[materials]]\nname = 'm'\ncolor = '#12345g'".into(), vec!["color is", "#rrggbb"]),
        ("[[materials]]\nname = 'm'\nroughnes = 1".into(), vec!["unknown key 'roughnes' in [[materials]] 'm'"]),
        ("[[environments]]\ncount = 0".into(), vec!["count is 0", "65536"]),
        ("[[environments]]\noffsets.x = { position = [0, 0, 1] }".into(), vec!["no object named 'x'"]),
        ("[[environments]]\ntime_offset_s = -1".into(), vec!["time_offset_s is -1"]),
        ("[[environments]]\nmaterials.x = { color = [1, 1, 1] }".into(), vec!["no material named 'x'"]),
        ("[[environments]]\nlights.x = { on = false }".into(), vec!["no light named 'x'"]),
        ("[[environments]]\ncameras.x = { fov_y_degrees = 9 }".into(), vec!["no camera named 'x'"]),
        (
            "[[lights]]\nname = 'l'\nkind = 'point'\nintensity = 1\n[[environments]]\nlights.l = { intensity = -2 }".into(),
            vec!["[[environments]] number 1", "light 'l'", "intensity is -2"],
        ),
        (
            "[[cameras]]\nname = 'c'\n[[environments]]\ncameras.c = { fov_y_degrees = 200 }".into(),
            vec!["camera 'c'", "fov_y_degrees is 200"],
        ),
        (
            "[[cameras]]\nname = 'c'\n[[environments]]\ncameras.c = { }".into(),
            vec!["[[environments]] number 1, cameras 'c'", "it has no lens"],
        ),
        (
            "[[materials]]\nname = 'm'\n[[environments]]\nmaterials.m = { roughnes = 1 }".into(),
            vec!["unknown key 'roughnes'", "did you mean 'roughness'?"],
        ),
        ("duration_s = 0".into(), vec!["duration_s is 0", "above 0"]),
        ("duration_s = inf".into(), vec!["duration_s is inf"]),
        ("background = [1, 2]".into(), vec!["background is [1, 2]", "three linear numbers"]),
        ("materials = 3".into(), vec!["materials is 3", "[[materials]]"]),
        ("a = = 1".into(), vec!["line 1"]),
    ] {
        let message = message(&text);
        for part in expected {
            assert!(message.contains(part), "{text}\n=> {message}\nlacks {part}");
        }
    }
    // Canary: the bases of all these are fine.
    assert!(read(BALL).is_ok());
    assert!(read(&body("{}")).is_ok_and(|scene| scene.check_simulated().is_err()));
    assert!(
        read(&body("{ fixed = true }").replace("duration_s", "#")).is_ok_and(|s| s.check_simulated().is_ok())
    );
}

#[test]
fn errors_name_the_line_of_the_key() {
    let file = |body: &str| {
        format!(
            "duration_s = 1\n\n[dynamics]\nrate_hz = 500\n\n[[materials]]\nname = 'm'\n\n[[primitives]]\nname = 'floor'\n\
             shape = 'plane'\nsize = [1, 1]\nmaterial = 'm'\n\n[[primitives]] # line 15\nname = 'ball'\nshape = 'sphere'\n\
             radius = 1\nmaterial = 'm'\n{body}\n\n[[cameras]]\nname = 'c'\n"
        )
    };
    for (body, expected) in [
        ("rigid_body = { mass = -2 }", "line 20: [[primitives]] 'ball': mass is -2"),
        ("rigid_body.friction = 1\nrigid_body.mass = -2", "line 21: [[primitives]] 'ball': mass is -2"),
        (
            "\n[primitives.rigid_body]\nfriction = 0.1\ndensity = nan",
            "line 23: [[primitives]] 'ball': density is NaN",
        ),
        (
            "\n[primitives.rigid_body]\nshape = 'box'",
            "line 21: [[primitives]] 'ball', rigid_body: the key 'size' is missing",
        ),
        ("rigid_body = { }\nrotation = [0, 0, 0, 2]", "line 21: [[primitives]] 'ball': rotation is"),
        ("rigid_body = { velocity = [0, inf, 0] }", "line 20: [[primitives]] 'ball': velocity is"),
        ("rigid_body = { }\nparent = 'bell'", "line 21: [[primitives]] 'ball': no object named 'bell'"),
        ("rigid_body = { }\nscale = [1, 2, 1]", "line 21: 'ball': its scale is [1, 2, 1]"),
        (
            "rigid_body = { }\n[[environments]]\noffsets.bell = { }",
            "line 22: [[environments]] number 1, offsets 'bell': no object",
        ),
        ("rigid_body = { }\nrigidbody = 1", "line 21: unknown key 'rigidbody' in [[primitives]] 'ball'"),
        (
            "motion = { kind = 'spin' }",
            "line 20: [[primitives]] 'ball', motion: the key 'degrees_per_s' is missing",
        ),
        (
            "[[lights]]\nname = 'sun'\nkind = 'point'\nintensity = 1\nwaveform = { shape = 'pwm',\nfrequency_hz = 5, duty = 1 }",
            "line 25: [[lights]] 'sun': duty is 1",
        ),
        ("[[cameras]]\nfov_y_degrees = 50", "line 20: [[cameras]] number 1: the key 'name' is missing"),
    ] {
        let message = message(&file(body));
        assert!(message.contains(expected), "{body}\n=> {message}\nlacks {expected}");
    }
    let dynamics = message(&file("").replace("rate_hz = 500", "rate_hz = 5"));
    assert!(dynamics.contains("line 4: [dynamics]: rate_hz is 5"), "{dynamics}");
    // Canary.
    assert!(read(&file("rigid_body = { mass = 2 }")).is_ok());
}

#[test]
fn files_are_found_beside_the_scene_file_and_named_when_they_are_not() {
    let folder = folder("scene_files");
    let scene_file = folder.join("walk.toml");
    std::fs::write(folder.join("walk.csv"), "# t, x\n1000,1,2,3,0,0,0,1\n2000,1,2,4,0,0,0,1\n")
        .expect("write");
    let camera =
        "[[cameras]]\nname = 'c'\nmotion = { kind = 'trajectory', file = 'walk.csv', time_unit = 'ms' }\n";
    std::fs::write(&scene_file, format!("{BALL}{camera}")).expect("write");
    let scene = load(&scene_file).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(scene.name, "walk");
    let Motion::Path(path) = &scene.nodes[scene.cameras[0].node].motion else { panic!("no path") };
    let evis_scene::motion::Path::Keys { times, positions, .. } = path.as_ref() else { panic!("{path:?}") };
    assert_eq!((times.as_slice(), positions[1]), ([0.0, 1.0].as_slice(), DVec3::new(1.0, 2.0, 4.0)));

    let absent = load(folder.join("absent.toml")).err().map_or_else(String::new, |e| e.to_string());
    assert!(absent.contains("cannot read") && absent.contains("absent.toml"), "{absent}");
    std::fs::write(&scene_file, "nmae = 1").expect("write");
    let wrong = load(&scene_file).err().map_or_else(String::new, |e| e.to_string());
    assert!(wrong.contains("walk.toml: line 1: unknown key 'nmae'"), "{wrong}");
}

#[test]
fn real_trajectories_are_read() {
    use std::io::Write;
    let Some(assets) = std::env::var_os("EVIS_ASSETS") else {
        // Straight to the stream: the test harness hides what its own macros print.
        let _ = writeln!(std::io::stderr(), "not run: EVIS_ASSETS is not set");
        return;
    };
    for (file, seconds) in [("poster_6dof.csv", 1.0), ("quadrotor_circles.csv", 1.0)] {
        let text = format!(
            "{BALL}[[cameras]]\nname = 'c'\nmotion = {{ kind = 'trajectory', file = 'trajectories/{file}', time_unit = 'ns', interpolation = 'catmull_rom' }}"
        );
        let scene = parse(&text, &assets).unwrap_or_else(|e| panic!("{e}"));
        let Motion::Path(path) = &scene.nodes[scene.cameras[0].node].motion else { panic!("no path") };
        let evis_scene::motion::Path::Keys { times, rotations, .. } = path.as_ref() else {
            panic!("{path:?}")
        };
        assert!(times.len() > 100 && times[0] == 0.0 && times.last().is_some_and(|t| *t > seconds), "{file}");
        assert!(rotations.iter().all(|q| q.is_normalized()));
    }
}

/// A generator for the mutations below; the tests are the same on every run.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self, below: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) as usize) % below.max(1)
    }
}

#[test]
fn no_text_makes_it_panic() {
    // Small pictures, so that thousands of variations stay fast.
    let base = example().replace("size = 256", "size = 16").replace("size = 128", "size = 16");
    assert!(read(&base).is_ok());
    let odd = [
        "nan",
        "inf",
        "-inf",
        "-1",
        "0",
        "1e308",
        "-9223372036854775808",
        "9223372036854775807",
        "1e-320",
        "''",
        "'\u{1F980}'",
        "[]",
        "[[]]",
        "{}",
        "true",
        "1979-05-27",
        "[nan, nan, nan]",
        "[1e308, 1e308, 1e308]",
        "[0, 0, 0, 0]",
        "{ kind = 'chain', motions = [{ kind = 'chain', motions = [{}] }] }",
        "\"#gggggg\"",
        "\"\"\"",
    ];
    let lines: Vec<&str> = base.lines().collect();
    let mut numbers = Numbers(1);
    let (mut good, mut bad) = (0, 0);
    let mut count = |text: &str| match read(text) {
        Ok(_) => good += 1,
        Err(error) => {
            assert!(!error.to_string().is_empty());
            bad += 1;
        }
    };
    // Every value replaced by every odd one; every line left out.
    for (i, line) in lines.iter().enumerate() {
        let replaced = |with: &str| {
            let mut all = lines.clone();
            all[i] = with;
            all.join("\n")
        };
        count(&replaced(""));
        if let Some((key, _)) = line.split_once('=') {
            for value in odd {
                count(&replaced(&format!("{key}= {value}")));
            }
        }
    }
    // Cuts and changed bytes anywhere.
    for _ in 0..400 {
        let mut bytes = base.clone().into_bytes();
        match numbers.next(3) {
            0 => bytes.truncate(numbers.next(bytes.len())),
            1 => {
                let at = numbers.next(bytes.len());
                bytes.drain(at..(at + numbers.next(40)).min(base.len()));
            }
            _ => {
                for _ in 0..=numbers.next(6) {
                    let at = numbers.next(bytes.len());
                    let odd = b"\n\"'[]{}=.,#x0 -_e\\\xff";
                    bytes[at] = odd[numbers.next(odd.len())];
                }
            }
        }
        count(&String::from_utf8_lossy(&bytes));
    }
    count(&"[".repeat(100_000));
    count(&format!("a = {}", "[".repeat(10_000)));
    count(&format!("motion = {}", "{ motions = [".repeat(500)));
    count("\u{feff}\0");
    assert!(good > 20 && bad > 500, "{good} good, {bad} bad: the variations have lost their variety");
}

#[test]
fn real_files_come_together() {
    use std::io::Write;
    let Some(assets) = std::env::var_os("EVIS_ASSETS") else {
        let _ = writeln!(std::io::stderr(), "not run: EVIS_ASSETS is not set");
        return;
    };
    let text = "
        [environment_map]
        file = 'environments/empty_warehouse_01_1k.hdr'
        intensity = 2
        rotation_degrees = 90
        visible = false
        [[textures]]
        name = 'picture'
        file = 'gltf/Avocado/Avocado_baseColor.png'
        [[materials]]
        name = 'picture'
        texture = 'picture'
        [[primitives]]
        name = 'card'
        shape = 'card'
        size = [1, 1]
        material = 'picture'
        [[gltf]]
        name = 'fox'
        file = 'gltf/Fox.glb'
        animation = 'Run'
        scale = 0.01
        position = [1, 0, 0]
        semantic_id = 5
        [[gltf]]
        name = 'box'
        file = 'gltf/BoxAnimated.glb'
        [[cameras]]
        name = 'rider'
        parent = 'b_Head_05'
    ";
    let scene = parse(text, &assets).unwrap_or_else(|e| panic!("{e}"));
    let fox = scene.nodes.iter().position(|n| n.name == "fox").expect("the fox");
    let mut state = evis_scene::SceneState::default();
    scene.evaluate(0.25, &mut state);
    let rider = state.world_from_node[scene.cameras[0].node].w_axis;
    assert!(rider.truncate().distance(DVec3::X) < 2.0 && rider.y > 0.2, "on the fox's head: {rider}");
    assert!(scene.nodes.iter().any(|n| n.parent == Some(fox)));
    assert!(scene.nodes.iter().any(|n| n.skin.is_some() && n.semantic_id == 5));
    let environment = scene.environment.as_ref().expect("the map");
    assert_eq!((environment.intensity, environment.visible), (2.0, false));
    assert!((environment.rotation - std::f32::consts::FRAC_PI_2).abs() < 1e-6);
    assert!(scene.duration_s.is_some_and(|d| d > 1.0), "the longer animation counts: {:?}", scene.duration_s);
    let names: Vec<_> = scene.nodes.iter().filter(|n| n.mesh.is_some()).map(|n| n.instance_id).collect();
    assert!(names.iter().all(|id| *id > 0), "{names:?}");
    // A node of a file that exists twice cannot be meant.
    let twice = text.replace("[[cameras]]", "[[gltf]]\nname = 'fox2'\nfile = 'gltf/Fox.glb'\n[[cameras]]");
    let message = parse(&twice, &assets).err().map_or_else(String::new, |e| e.to_string());
    assert!(message.contains("more than one node is named 'b_Head_05'"), "{message}");
}

#[test]
fn classes_have_names_that_stand_for_their_ids() {
    let classes = "[classes]\nfloor = 1\n'traffic light' = 12\n";
    let scene =
        read(&format!("{classes}{BALL}semantic_id = 'traffic light'")).unwrap_or_else(|e| panic!("{e}"));
    let names: Vec<_> = scene.class_names.iter().map(|(id, name)| (*id, name.as_str())).collect();
    assert_eq!(names, [(1, "floor"), (12, "traffic light")]);
    let ball = scene.nodes.iter().find(|node| node.name == "ball").unwrap_or_else(|| panic!("the ball"));
    assert_eq!(ball.semantic_id, 12);
    for (text, expected) in [
        (
            format!("{classes}{BALL}semantic_id = 'flor'"),
            "'ball': no class named 'flor'; there is floor, traffic light (did you mean 'floor'?)",
        ),
        (format!("{BALL}semantic_id = 'floor'"), "no class named 'floor'; there is none"),
        (
            format!("{BALL}semantic_id = -2"),
            "semantic_id is -2; it takes a whole number between 0 and 4294967295",
        ),
        (format!("{BALL}semantic_id = 1.5"), "or the name of a class in [classes]"),
        (format!("[classes]\nfloor = 'one'\n{BALL}"), "[classes]: floor is \"one\""),
        (format!("[classes]\nfloor = 0\n{BALL}"), "class 'floor' has the id 0"),
        (format!("[classes]\na = 3\nb = 3\n{BALL}"), "'a' and 'b' both have the id 3"),
    ] {
        assert!(message(&text).contains(expected), "{expected}\n{}", message(&text));
    }
}

#[test]
fn a_scene_without_a_camera_gets_one() {
    let scene = read(BALL).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(scene.cameras.len(), 1);
    assert!(message("[[cameras]]\nname = 'c'").contains("nothing to draw"));
}
