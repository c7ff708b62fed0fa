//! Rigs and calibration files: OpenCV's convention in and out, scenes of them, and what is refused.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::path::Path;

use evis_scene::builder::{EventCamera, Placement, SceneBuilder};
use evis_scene::{CalibrationFormat, Distortion, Lens, Material, Rig, Scene, SceneState};
use glam::{DMat4, DVec3};

/// As Kalibr writes it: the second camera lies 0.11 m to the right of the first and 0.02 m below it, and is turned by 0.05 rad
/// to the left.
const CAMCHAIN: &str = "
cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0002, -0.0003]
  distortion_model: radtan
  intrinsics: [458.654, 457.296, 367.215, 248.375]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
  timeshift_cam_imu: 0.001
cam1:
  T_cn_cnm1:
  - [0.9987502603949663, 0.0, 0.04997916927067833, -0.10986252864344629]
  - [0.0, 1.0, 0.0, -0.02]
  - [-0.04997916927067833, 0.0, 0.9987502603949663, 0.005497708619774616]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs: [0.01, -0.02, 0.003, 0.0004]
  distortion_model: equidistant
  intrinsics: [457.587, 456.134, 379.999, 255.238]
  resolution: [752, 480]
  rostopic: /cam1/image_raw
";

fn pose(rig: &Rig, camera: usize) -> DMat4 {
    DMat4::from_cols_array_2d(&rig.cameras[camera].body_from_camera).transpose()
}

#[test]
fn a_camchain_is_read_in_opencvs_convention() {
    let rig = Rig::parse(CAMCHAIN).unwrap();
    let [first, second] = &rig.cameras[..] else { panic!() };
    assert_eq!((first.name.as_str(), first.size), ("cam0", [752, 480]));
    // Pixel centres lie at +0.5 here.
    assert_eq!(first.intrinsics, [458.654, 457.296, 367.715, 248.875]);
    assert_eq!(second.distortion, Some(("fisheye".into(), vec![0.01, -0.02, 0.003, 0.0004])));
    assert_eq!(pose(&rig, 0), DMat4::IDENTITY);
    let place = pose(&rig, 1).transform_point3(DVec3::ZERO);
    let close = |a: DVec3, b: DVec3| (a - b).length() < 1e-9;
    assert!(close(place, DVec3::new(0.11, -0.02, 0.0)), "right and, with y up, down: {place}");
    assert!(!close(place, DVec3::new(0.11, 0.02, 0.0)), "canary: y down");
    let ahead = pose(&rig, 1).transform_vector3(DVec3::NEG_Z);
    let [left, right] = [-1.0, 1.0].map(|way| DVec3::new(way * (0.05_f64).sin(), 0.0, -(0.05_f64).cos()));
    assert!(close(ahead, left) && !close(ahead, right), "{ahead}");
    // A point straight ahead of the second camera, in the first one's OpenCV axes and back through the file's matrix.
    let point = pose(&rig, 1).transform_point3(DVec3::new(0.0, 0.0, -3.0));
    let [x, y, z] = [point.x, -point.y, -point.z];
    let (c, s) = (0.9987502603949663, 0.04997916927067833);
    let there = [c * x + s * z - 0.10986252864344629, y - 0.02, -s * x + c * z + 0.005497708619774616];
    assert!(close(DVec3::from(there), DVec3::new(0.0, 0.0, 3.0)), "{there:?}");
}

#[test]
fn calibrations_survive_both_files() {
    let rig = Rig::parse(CAMCHAIN).unwrap();
    let same = |a: &Rig, b: &Rig| {
        a.cameras.len() == b.cameras.len()
            && a.cameras.iter().zip(&b.cameras).all(|(a, b)| {
                let numbers = a.body_from_camera.as_flattened().iter().zip(b.body_from_camera.as_flattened());
                let close = |(x, y): (&f64, &f64)| (x - y).abs() < 1e-9;
                a.size == b.size
                    && a.intrinsics.iter().zip(&b.intrinsics).all(close)
                    && a.distortion == b.distortion
                    && numbers.into_iter().all(close)
            })
    };
    let kalibr = Rig::parse(&rig.text(CalibrationFormat::Kalibr).unwrap()).unwrap();
    assert!(same(&rig, &kalibr), "{kalibr:?}");
    let dsec = rig.text(CalibrationFormat::Dsec).unwrap();
    assert!(
        dsec.contains("T_21:") && dsec.contains("camera_matrix: [458.654, 457.296, 367.215, 248.375]"),
        "{dsec}"
    );
    let mut dsec = Rig::parse(&dsec).unwrap();
    // Two cameras stand for DSEC's four: events and frames.
    assert_eq!(dsec.cameras.len(), 4);
    dsec.cameras = vec![dsec.cameras[0].clone(), dsec.cameras[3].clone()];
    assert!(same(&rig, &dsec), "{dsec:?}");
    let mut other = rig.clone();
    other.cameras[1].body_from_camera[0][3] += 1e-6;
    assert!(!same(&rig, &other), "canary");
}

#[test]
fn dsecs_file_has_the_rectified_cameras() {
    let rig = Rig::parse(CAMCHAIN).unwrap();
    let counts = |rig: &Rig| {
        let text = rig.text(CalibrationFormat::Dsec).unwrap();
        ["  camRect", "  R_rect", "disparity_to_depth:", "  cams_"].map(|key| text.matches(key).count())
    };
    assert_eq!(counts(&rig), [4, 4, 1, 2]);
    let text = rig.text(CalibrationFormat::Dsec).unwrap();
    let lines = |line: &str| text.lines().filter(|l| l.trim() == line).count();
    assert_eq!(lines("distortion_model: equidistant"), 2, "the right one's and its frame camera's");
    assert_eq!(lines("distortion_coeffs: [0.01, -0.02, 0.003, 0.0004]"), 2);
    assert_eq!(lines("distortion_coeffs: [0.0, 0.0, 0.0, 0.0]"), 4, "the rectified ones'");
    let pair = rig.rectify(0, 1, 0.0).unwrap();
    // Pixel centres lie at whole numbers there.
    let ([fx, fy], [cx, cy]) = (pair.cameras[0].pinhole.focal, pair.cameras[0].pinhole.center);
    assert_eq!(lines(&format!("camera_matrix: {:?}", [fx, fy, cx - 0.5, cy - 0.5])), 4);
    assert_eq!(lines(&format!("- {:?}", [1.0, 0.0, 0.0, 0.5 - cx])), 2);
    assert_eq!(lines(&format!("- {:?}", [0.0, 0.0, 1.0 / pair.baseline, 0.0])), 2);
    assert!((pair.baseline - (0.11_f64.powi(2) + 0.02_f64.powi(2)).sqrt()).abs() < 1e-9);
    // One camera by itself; four of which two are pairs; and two that are none.
    assert_eq!(counts(&Rig { cameras: rig.cameras[..1].to_vec() }), [4, 4, 0, 0]);
    let four = Rig::parse(&text).unwrap();
    let between = Rig { cameras: vec![four.cameras[0].clone(), four.cameras[3].clone()] };
    assert_eq!(between.rectify(0, 1, 0.0).unwrap().baseline, four.rectify(0, 3, 0.0).unwrap().baseline);
    assert_eq!(counts(&four), [4, 4, 1, 2]);
    let mut swapped = rig.clone();
    swapped.cameras.swap(0, 1);
    assert_eq!(counts(&swapped), [0; 4], "canary: the right one is on the left");
    assert!(rig.rectify(0, 2, 0.0).unwrap_err().to_string().contains("no camera 2"));
}

fn world_poses(scene: &Scene) -> Vec<DMat4> {
    let mut state = SceneState::default();
    scene.evaluate(0.3, &mut state);
    scene.cameras.iter().map(|camera| state.world_from_node[camera.node]).collect()
}

#[test]
fn scenes_carry_rigs_on_bodies_that_move() {
    let folder = std::env::temp_dir().join(format!("evis-rig-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("camchain.yaml"), CAMCHAIN).unwrap();
    let text = r#"
        [[materials]]
        name = "white"
        model = "unlit"

        [[primitives]]
        name = "wall"
        shape = "card"
        size = [2.0, 2.0]
        material = "white"

        [[rigs]]
        name = "head"
        calibration = "camchain.yaml"
        cameras = ["left", "right"]
        near = 0.2
        position = [0.0, 1.0, 3.0]
        motion = { kind = "spin", axis = [0.0, 1.0, 0.0], degrees_per_s = 30.0 }

        [[rigs]]
        name = "pair"
        baseline = 0.12
        cameras = ["near", "far"]
        size = [64, 48]
        fx = 55.0
        distortion = { model = "fisheye", k1 = 0.01 }
        parent = "head"
    "#;
    let scene = evis_scene::toml_scene::parse(text, &folder).unwrap();
    std::fs::remove_dir_all(&folder).unwrap();
    let names: Vec<&str> = scene.cameras.iter().map(|camera| camera.name.as_str()).collect();
    assert_eq!(names, ["left", "right", "near", "far"]);
    assert_eq!(scene.cameras[0].near, 0.2);
    assert_eq!(scene.distortions["right"].name(), "fisheye");
    assert_eq!(scene.distortions["far"], Distortion::from_coefficients("fisheye", &[0.01]).unwrap());
    let Lens::Intrinsics { fx, cx, .. } = scene.cameras[3].lens else { panic!() };
    assert_eq!((fx, cx), (55.0, 32.0));
    let rig = Rig::parse(CAMCHAIN).unwrap();
    let poses = world_poses(&scene);
    let apart = |a: DMat4, b: DMat4| (a - b).to_cols_array().iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    assert!(
        apart(poses[0].inverse() * poses[1], pose(&rig, 1)) < 1e-9,
        "extrinsics hold while the body moves"
    );
    assert!(apart(poses[0].inverse() * poses[1], pose(&rig, 1).inverse()) > 0.01, "canary: the other way");
    let baseline = poses[2].inverse() * poses[3];
    assert!(apart(baseline, DMat4::from_translation(DVec3::new(0.12, 0.0, 0.0))) < 1e-12);

    // The builder gives the same.
    let mut builder = SceneBuilder::new("rig");
    let white = builder.material(Material::unlit("white")).unwrap();
    let card = evis_scene::primitive::Shape::Card { size: [2.0, 2.0] };
    builder.shape("wall", card, white, Placement::default()).unwrap();
    builder.rig("head", &rig, Placement::at(DVec3::new(0.0, 1.0, 3.0))).unwrap();
    let built = builder.build().unwrap();
    let poses = world_poses(&built);
    assert!(apart(poses[0].inverse() * poses[1], pose(&rig, 1)) < 1e-9);
}

#[test]
fn what_is_no_calibration_is_refused_with_a_remedy() {
    let refused = |from: &str, to: &str| {
        let text = CAMCHAIN.replacen(from, to, 1);
        assert_ne!(text, CAMCHAIN);
        Rig::parse(&text).unwrap_err().to_string()
    };
    assert!(refused("camera_model: pinhole", "camera_model: omni").contains("'omni'"));
    assert!(refused("radtan", "ds").contains("'ds'"));
    assert!(refused("T_cn_cnm1", "T_other").contains("T_cn_cnm1"));
    assert!(refused("cam1:", "cam2:").contains("no cam1"));
    assert!(refused("[0.0, 1.0, 0.0, -0.02]", "[0.0, 2.0, 0.0, -0.02]").contains("rotation"));
    assert!(refused("[458.654,", "[-458.654,").contains("fx"));
    assert!(refused("[752, 480]", "[752]").contains("camchain"));
    for text in ["", "1", "extrinsics: 3", "cam0: [", "{}"] {
        assert!(Rig::parse(text).is_err(), "{text}");
    }
    assert!(Rig::load(Path::new("/nowhere/camchain.yaml")).is_err());
    let camera = EventCamera::new("c").size(64, 48).intrinsics(50.0, 50.0, 32.0, 24.0);
    assert!(Rig::stereo(0.0, &camera).unwrap_err().to_string().contains("baseline"));
    assert!(Rig::stereo(0.1, &EventCamera::new("c")).unwrap_err().to_string().contains("focal"));
    let three = Rig { cameras: [Rig::stereo(0.1, &camera).unwrap().cameras, vec![]].concat() };
    assert!(three.text(CalibrationFormat::Dsec).is_ok());
    assert!(CalibrationFormat::from_name("ros").is_err());
}
