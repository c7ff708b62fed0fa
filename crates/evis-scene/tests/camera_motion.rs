//! Camera motion for scenes that bring none: image speeds, what stays in view, what is never touched.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::f64::consts::TAU;
use std::path::{Path as FilePath, PathBuf};

use evis_scene::builder::{EventCamera, Placement, SceneBuilder};
use evis_scene::environment::Environment;
use evis_scene::primitive::Shape;
use evis_scene::source::{self, Opening};
use evis_scene::{
    CameraMotion, CameraMotionSettings, Framing, Lens, Material, Motion, Scene, SceneError, SceneState,
    ShadingModel,
};
use glam::{DMat4, DVec2, DVec3};

const SIZE: (u32, u32) = (640, 480);

fn ask(motion: CameraMotion, speed: f64) -> CameraMotionSettings {
    CameraMotionSettings {
        motion: Some(motion),
        speed_px_per_s: Some(speed),
        size: Some(SIZE),
        ..CameraMotionSettings::default()
    }
}

fn builder() -> SceneBuilder {
    let mut scene = SceneBuilder::new("model");
    scene.material(Material { name: "m".into(), model: ShadingModel::Unlit, ..Material::default() }).unwrap();
    scene
}

fn shape(scene: &mut SceneBuilder, name: &str, shape: Shape, at: DVec3) {
    let material = scene.find_material("m").unwrap();
    scene.shape(name, shape, material, Placement::at(at)).unwrap();
}

/// A sphere, off the origin.
fn sphere(scale: f64) -> Scene {
    let mut scene = builder();
    shape(&mut scene, "ball", Shape::Sphere { radius: scale }, DVec3::new(3.0, -2.0, 5.0) * scale);
    scene.build().unwrap()
}

/// A long bar.
fn bar(scale: f64) -> Scene {
    let mut scene = builder();
    shape(&mut scene, "bar", Shape::Box { size: [4.0 * scale, 0.5 * scale, 0.5 * scale] }, DVec3::ZERO);
    scene.build().unwrap()
}

fn moved(mut scene: Scene, settings: &CameraMotionSettings) -> Scene {
    scene.move_cameras(settings).unwrap();
    scene
}

/// Pose of the first camera.
fn pose(scene: &Scene, t_s: f64) -> DMat4 {
    let mut state = SceneState::default();
    scene.evaluate(t_s, &mut state);
    scene.world_from_camera(0, &state).unwrap()
}

fn focal(scene: &Scene) -> f64 {
    let Lens::FieldOfView { fov_y } = scene.cameras[0].lens else { panic!("{:?}", scene.cameras[0].lens) };
    0.5 * f64::from(SIZE.1) / (0.5 * fov_y).tan()
}

/// Pixel of a point of the world.
fn pixel(scene: &Scene, world_from_camera: &DMat4, p: DVec3) -> DVec2 {
    let p = world_from_camera.inverse().transform_point3(p);
    assert!(p.z < 0.0, "behind the camera");
    let half = 0.5 * DVec2::new(SIZE.0.into(), SIZE.1.into());
    half + focal(scene) * DVec2::new(p.x, -p.y) / -p.z
}

/// Mean image speed over the central half of the picture, of the surface that `hit` finds along a ray of the world; an
/// implementation of its own, ray by ray.
fn image_speed(scene: &Scene, times: &[f64], hit: impl Fn(DVec3, DVec3) -> Option<DVec3>) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    let step = 1e-5;
    for &t in times {
        let camera = pose(scene, t);
        let (before, after) = (pose(scene, t - step), pose(scene, t + step));
        for y in (122..360).step_by(7) {
            for x in (162..480).step_by(7) {
                let f = focal(scene);
                let ray = DVec3::new((f64::from(x) - 320.0) / f, (240.0 - f64::from(y)) / f, -1.0);
                let (eye, ray) = (camera.w_axis.truncate(), camera.transform_vector3(ray));
                let Some(p) = hit(eye, ray) else { continue };
                sum += (pixel(scene, &after, p) - pixel(scene, &before, p)).length() / (2.0 * step);
                count += 1;
            }
        }
    }
    assert!(count > 100, "{count} rays hit");
    sum / f64::from(count)
}

fn hit_sphere(center: DVec3, radius: f64) -> impl Fn(DVec3, DVec3) -> Option<DVec3> {
    move |eye, ray| {
        let (ray, from) = (ray.normalize(), eye - center);
        let b = from.dot(ray);
        let root = b * b - from.length_squared() + radius * radius;
        (root > 0.0).then(|| eye + ray * (-b - root.sqrt()))
    }
}

/// Times of one second, or of a whole period of what comes back.
fn times(scene: &Scene, motion: &CameraMotion) -> Vec<f64> {
    let n = 100;
    let span = match motion {
        CameraMotion::Dolly => {
            // The first return to the start in the same direction.
            let start = pose(scene, 0.0).w_axis.truncate();
            let side =
                |t: f64| (pose(scene, t).w_axis.truncate() - start).dot(pose(scene, 0.0).z_axis.truncate());
            let mut t = 1e-3;
            while !(side(t) > 0.0 && side(t + 1e-3) <= 0.0) {
                t += 1e-3;
                assert!(t < 100.0, "it never comes back");
            }
            t
        }
        CameraMotion::Orbit => 0.2,
        _ => 10.0,
    };
    (0..n).map(|k| span * (f64::from(k) + 0.5) / f64::from(n)).collect()
}

#[test]
fn image_speeds_are_those_asked_for_at_any_scale() {
    for scale in [0.001, 1.0, 100.0] {
        let hit = hit_sphere(DVec3::new(3.0, -2.0, 5.0) * scale, scale);
        for motion in [CameraMotion::Orbit, CameraMotion::Dolly, CameraMotion::Shake] {
            for speed in [5.0, 100.0, 900.0] {
                let scene = moved(sphere(scale), &ask(motion.clone(), speed));
                let measured = image_speed(&scene, &times(&scene, &motion), &hit);
                let told = format!("{motion:?}, scale {scale}: {measured:.1} px/s, asked for {speed}");
                assert!((measured / speed - 1.0).abs() < 0.2, "{told}");
                println!("{told}");
            }
        }
    }
}

#[test]
fn physical_speeds_follow_the_picture_and_its_size() {
    let span = |size| {
        let settings = CameraMotionSettings { size: Some(size), ..ask(CameraMotion::Orbit, 100.0) };
        let scene = moved(sphere(1.0), &settings);
        pose(&scene, 0.0).w_axis.distance(pose(&scene, 0.1).w_axis)
    };
    let ratio = span((160, 120)) / span((640, 480));
    assert!((ratio - 4.0).abs() < 0.02, "a quarter of the pixels, four times the way: {ratio}");
}

#[test]
fn an_orbit_keeps_the_model_in_view() {
    for (width, height) in [(640, 480), (240, 640), (320, 240)] {
        for scale in [0.001, 1.0, 100.0] {
            let mut scene = bar(scale);
            let still = pose(&scene, 0.0).w_axis.truncate();
            let settings =
                CameraMotionSettings { size: Some((width, height)), ..ask(CameraMotion::Orbit, 300.0) };
            scene.move_cameras(&settings).unwrap();
            let Lens::FieldOfView { fov_y } = scene.cameras[0].lens else { panic!() };
            let tan = (0.5 * fov_y).tan();
            let (mut largest, mut turned) = (0.0_f64, 0.0_f64);
            for k in 0..2000 {
                let camera = pose(&scene, f64::from(k) * 0.02);
                turned = turned.max(camera.w_axis.truncate().distance(still));
                for corner in 0..8 {
                    let sign = |bit: u32| if corner & bit > 0 { 1.0 } else { -1.0 };
                    let p = DVec3::new(2.0 * sign(1), 0.25 * sign(2), 0.25 * sign(4)) * scale;
                    let p = camera.inverse().transform_point3(p);
                    let slope = (p.x.abs() * f64::from(height) / f64::from(width)).max(p.y.abs()) / -p.z;
                    assert!(p.z < 0.0 && slope < tan, "{width}x{height}, scale {scale}, step {k}");
                    largest = largest.max(slope);
                }
            }
            assert!(turned > 3.0 * scale, "it goes all around");
            assert!(largest > 0.8 * tan, "the model fills the picture: {}", largest / tan);
        }
    }
}

#[test]
fn an_orbit_is_exact_and_about_the_vertical_through_the_centre() {
    let scene = moved(sphere(1.0), &ask(CameraMotion::Orbit, 100.0));
    let center = DVec3::new(3.0, -2.0, 5.0);
    let start = pose(&scene, 0.0);
    let eye = |t: f64| pose(&scene, t).w_axis.truncate() - center;
    let flat = |v: DVec3| DVec2::new(v.x, v.z);
    let rate = flat(eye(0.0)).angle_to(flat(eye(1.0)));
    for t in [0.0, 0.37, 2.0, 11.0, 1000.25] {
        assert!((eye(t).length() - eye(0.0).length()).abs() < 1e-9 && (eye(t).y - eye(0.0).y).abs() < 1e-9);
        let angle = flat(eye(0.0)).angle_to(flat(eye(t)));
        assert!(((angle - rate * t) / TAU - ((angle - rate * t) / TAU).round()).abs() < 1e-9, "{t}");
        // The centre stays in the middle of the picture.
        let middle = pixel(&scene, &pose(&scene, t), center);
        assert!((middle - DVec2::new(320.0, 240.0)).length() < 1e-6, "{middle}");
    }
    assert!(rate.abs() > 0.05 && start != pose(&scene, 1.0));
}

#[test]
fn a_dolly_never_enters_the_model() {
    for scale in [0.001, 1.0, 100.0] {
        let scene = moved(bar(scale), &ask(CameraMotion::Dolly, 2000.0));
        let still = pose(&bar(scale), 0.0);
        let half = DVec3::new(2.0, 0.25, 0.25) * scale;
        let (mut nearest, mut longest) = (f64::INFINITY, 0.0_f64);
        for k in 0..5000 {
            let eye = pose(&scene, f64::from(k) * 0.0013).w_axis.truncate();
            nearest = nearest.min((eye.abs() - half).max(DVec3::ZERO).length());
            let way = eye - still.w_axis.truncate();
            assert!(way.cross(still.z_axis.truncate()).length() < 1e-9 * scale, "along the view axis");
            longest = longest.max(way.length());
        }
        let free = (still.w_axis.truncate().abs() - half).max(DVec3::ZERO).length();
        assert!(nearest > scene.cameras[0].near && nearest > 0.5 * free, "{nearest} of {free}");
        assert!(longest > 0.3 * free, "{longest} of {free}");
    }
}

#[test]
fn a_dolly_in_a_chamber_touches_no_wall() {
    // A camera in a box: free by 0.5 behind, by 1.5 before.
    let mut scene = builder();
    let material = Material {
        name: "inside".into(),
        model: ShadingModel::Unlit,
        double_sided: true,
        ..Material::default()
    };
    let material = scene.material(material).unwrap();
    scene.shape("walls", Shape::Box { size: [4.0, 4.0, 2.0] }, material, Placement::default()).unwrap();
    scene.camera(EventCamera::new("own"), Placement::at([0.0, 0.0, 0.5])).unwrap();
    let scene = moved(scene.build().unwrap(), &ask(CameraMotion::Dolly, 100.0));
    let z: Vec<f64> = (0..2000).map(|k| pose(&scene, f64::from(k) * 0.003).w_axis.z).collect();
    let farthest = z.iter().fold(0.0_f64, |far, z| far.max(z.abs()));
    assert!(farthest < 0.9, "{farthest}");
    assert!(z.iter().any(|z| *z > 0.6) && z.iter().any(|z| *z < 0.4));
}

fn picture(name: &str, width: u32, height: u32) -> PathBuf {
    let path = std::env::temp_dir().join(format!("evis_scene_{}_{name}", std::process::id()));
    let image = image::RgbImage::from_fn(width, height, |x, y| {
        image::Rgb([(x * 7 % 256) as u8, (y * 11 % 256) as u8, 188])
    });
    image::DynamicImage::ImageRgb8(image).save(&path).unwrap();
    path
}

/// Largest |u - 0.5| and |v - 0.5| that the views' corners show over `times`.
fn farthest(
    scene: &Scene,
    (width, height): (u32, u32),
    half: [f64; 2],
    times: impl Iterator<Item = f64>,
) -> f64 {
    let Lens::FieldOfView { fov_y } = scene.cameras[0].lens else { panic!() };
    let tan = DVec2::new(f64::from(width) / f64::from(height), 1.0) * (0.5 * fov_y).tan();
    let mut farthest = 0.0_f64;
    for t in times {
        let camera = pose(scene, t);
        for k in 0..4 {
            let corner =
                DVec2::new(if k & 1 > 0 { tan.x } else { -tan.x }, if k & 2 > 0 { tan.y } else { -tan.y });
            let (eye, ray) = (camera.w_axis.truncate(), camera.transform_vector3(corner.extend(-1.0)));
            let on = eye - ray * (eye.z / ray.z);
            assert!(ray.z < 0.0 && on.z.abs() < 1e-9);
            farthest = farthest.max((0.5 * on.x / half[0]).abs()).max((0.5 * on.y / half[1]).abs());
        }
    }
    farthest
}

#[test]
fn a_moving_camera_never_shows_the_border_of_a_picture() {
    for (name, width, height) in [("wide.png", 300, 100), ("square.png", 128, 128), ("high.jpg", 60, 200)] {
        let path = picture(name, width, height);
        for size in [None, Some((640, 480)), Some((1280, 320)), Some((240, 600))] {
            for (motion, speed) in [
                (None, None),
                (Some(CameraMotion::Shake), Some(1.0)),
                (Some(CameraMotion::Shake), Some(20_000.0)),
                (Some(CameraMotion::Dolly), Some(300.0)),
            ] {
                let shown = format!("{name} at {size:?}, {motion:?}");
                let camera_motion =
                    CameraMotionSettings { motion, speed_px_per_s: speed, size, camera: None };
                let scene =
                    source::open(&path.to_string_lossy(), &Opening { camera_motion, ..Opening::default() })
                        .unwrap();
                let Some(Framing::Picture { half_size }) = scene.framing else {
                    panic!("{:?}", scene.framing)
                };
                let pixels = scene.cameras[0].pixels(size);
                // Odd steps, over a minute.
                let seen = farthest(&scene, pixels, half_size, (0..12_000).map(|k| f64::from(k) * 0.005_237));
                assert!(seen < 0.5, "{shown}: {seen}");
                assert!(seen > 0.42, "{shown}: nearly all of it is shown, {seen}");
            }
        }
        std::fs::remove_file(path).unwrap();
    }
}

#[test]
fn pictures_are_linear_light_and_shake_at_the_speed_asked_for() {
    let path = picture("speed.png", 640, 480);
    let scene = source::load(&path.to_string_lossy(), 0).unwrap();
    let blue = scene.images[0].texels[0][2].to_f64();
    assert!((blue - evis_scene::image::linear_from_srgb(188.0 / 255.0)).abs() < 1e-3, "{blue}");
    assert_eq!(scene.materials[0].model, ShadingModel::Unlit);
    for speed in [20.0, 100.0, 2000.0] {
        let scene = moved(scene.clone(), &ask(CameraMotion::Shake, speed));
        let measured = image_speed(&scene, &times(&scene, &CameraMotion::Shake), |eye, ray| {
            Some(eye - ray * (eye.z / ray.z))
        });
        assert!((measured / speed - 1.0).abs() < 0.2, "{measured} px/s, asked for {speed}");
    }
    std::fs::remove_file(path).unwrap();
}

#[test]
fn radiance_is_taken_as_it_is() {
    let path = std::env::temp_dir().join(format!("evis_scene_{}_light.exr", std::process::id()));
    let light = image::Rgb32FImage::from_fn(16, 8, |x, _| {
        image::Rgb([x as f32, 20.0, if x == 3 { f32::NAN } else { 0.25 }])
    });
    image::DynamicImage::ImageRgb32F(light).save(&path).unwrap();
    let scene = source::load(&path.to_string_lossy(), 0).unwrap();
    std::fs::remove_file(path).unwrap();
    assert_eq!(scene.images[0].texels[5].map(f32::from), [5.0, 20.0, 0.25, 1.0]);
    assert_eq!(scene.images[0].texels[3].map(f32::from), [3.0, 20.0, 0.0, 1.0]);
    assert!(scene.warnings[0].contains("not finite"), "{:?}", scene.warnings);
}

#[test]
fn only_what_brings_neither_camera_nor_motion_is_moved_by_default() {
    let default = CameraMotionSettings { size: Some(SIZE), ..CameraMotionSettings::default() };
    let orbit = moved(sphere(1.0), &default);
    let applied = orbit.camera_motion.clone().unwrap();
    assert!(
        applied.by_default && applied.motion == "orbit" && applied.speed_px_per_s == Some(100.0),
        "{applied:?}"
    );
    assert!(orbit.warnings.len() == 1 && orbit.warnings[0].contains("orbits the model at about 100 px/s"));
    assert!(!orbit.rests(&[]));
    // Once more: the same.
    let again = moved(orbit.clone(), &default);
    assert_eq!((again.nodes.len(), again.warnings.len()), (orbit.nodes.len(), 1));

    // A camera of its own.
    let mut own = builder();
    shape(&mut own, "ball", Shape::Sphere { radius: 1.0 }, DVec3::ZERO);
    own.camera(EventCamera::new("own"), Placement::looking_at([0.0, 1.0, 4.0], DVec3::ZERO)).unwrap();
    let own = own.build().unwrap();
    let still = moved(own.clone(), &default);
    assert!(still.camera_motion.is_none() && still.warnings.is_empty() && still.rests(&[]));
    // On request.
    for motion in [CameraMotion::Orbit, CameraMotion::Dolly, CameraMotion::Shake] {
        let scene = moved(own.clone(), &ask(motion.clone(), 100.0));
        assert!(!scene.rests(&[]) && !scene.camera_motion.as_ref().unwrap().by_default);
        let speed = image_speed(&scene, &times(&scene, &motion), hit_sphere(DVec3::ZERO, 1.0));
        assert!((speed / 100.0 - 1.0).abs() < 0.2, "{motion:?}: {speed}");
    }

    // A motion of its own.
    let mut moving = builder();
    let material = moving.find_material("m").unwrap();
    let spin = evis_scene::motion::Path::Spin { start: Default::default(), axis: DVec3::Y, rate: 1.0 };
    moving
        .shape("bar", Shape::Box { size: [1.0, 2.0, 3.0] }, material, Placement::default().moving(spin))
        .unwrap();
    let moving = moved(moving.build().unwrap(), &default);
    assert!(moving.camera_motion.is_none() && moving.warnings.is_empty() && !moving.rests(&[]));

    // Nothing, because it was asked for.
    let none = moved(
        sphere(1.0),
        &CameraMotionSettings { motion: Some(CameraMotion::None), ..CameraMotionSettings::default() },
    );
    assert!(none.rests(&[]) && none.camera_motion.unwrap().motion == "none");
}

#[test]
fn a_motion_of_equal_keys_is_rest() {
    let curve = |values: Vec<f64>| evis_scene::motion::Curve {
        times: vec![0.0, 1.0],
        values,
        width: 3,
        interpolation: evis_scene::motion::Interpolation::Linear,
    };
    let mut scene = sphere(1.0);
    let mut animate = |values| {
        scene.nodes[0].motion = Motion::Animated {
            rest: Default::default(),
            translation: Some(curve(values)),
            rotation: None,
            scale: None,
        };
        scene.rests(&[])
    };
    assert!(animate(vec![1.0, 2.0, 3.0, 1.0, 2.0, 3.0]));
    assert!(!animate(vec![1.0, 2.0, 3.0, 1.0, 2.0, 3.1]));
}

#[test]
fn a_stereo_rig_stays_a_rig() {
    let mut scene = builder();
    shape(&mut scene, "ball", Shape::Sphere { radius: 1.0 }, DVec3::ZERO);
    // On a scaled node: cameras have no scale, whatever carries them.
    let rig = scene.node("rig", Placement::at([0.0, 0.5, 5.0]).scaled([2.0, 3.0, 0.5])).unwrap();
    for (name, x) in [("left", -0.1), ("right", 0.1)] {
        scene.camera(EventCamera::new(name), Placement::at([x, 0.0, 0.0]).on(rig)).unwrap();
    }
    let scene = scene.build().unwrap();
    let both = |scene: &Scene, t| {
        let mut state = SceneState::default();
        scene.evaluate(t, &mut state);
        [0, 1].map(|k| scene.world_from_camera(k, &state).unwrap())
    };
    let [left, right] = both(&scene, 0.0);
    let between = left.inverse() * right;
    for motion in [CameraMotion::Orbit, CameraMotion::Dolly, CameraMotion::Shake] {
        let scene = moved(scene.clone(), &ask(motion.clone(), 100.0));
        let mut moved = 0.0_f64;
        for t in [0.1, 0.7, 3.3] {
            let [l, r] = both(&scene, t);
            assert!((l.inverse() * r).abs_diff_eq(between, 1e-9), "{motion:?} at {t}");
            moved = moved.max((l.w_axis - left.w_axis).length());
        }
        assert!(moved > 1e-3, "{motion:?}: canary");
    }
}

#[test]
fn the_same_settings_give_the_same_bytes() {
    let settings = |motion| CameraMotionSettings { motion, ..CameraMotionSettings::default() };
    for motion in [None, Some(CameraMotion::Dolly), Some(CameraMotion::Shake)] {
        let make = || moved(bar(1.0), &settings(motion.clone()));
        assert_eq!(format!("{:?}", make()), format!("{:?}", make()));
        for t in [0.123, 7.5] {
            assert_eq!(
                pose(&make(), t).to_cols_array().map(f64::to_bits),
                pose(&make(), t).to_cols_array().map(f64::to_bits)
            );
        }
    }
    let shake = |speed| format!("{:?}", moved(bar(1.0), &ask(CameraMotion::Shake, speed)).nodes);
    assert_ne!(shake(100.0), shake(101.0), "canary");
}

#[test]
fn cameras_follow_the_poses_of_a_file() {
    let path = std::env::temp_dir().join(format!("evis_scene_{}_poses.csv", std::process::id()));
    let file = || ask_file(&path);
    // Half a turn about y: it looks along +Z.
    std::fs::write(&path, "# unit: ms\nt,x,y,z,qx,qy,qz,qw\n100,1,2,3,0,0,0,1\n600,2,-2,0,0,1,0,0\n")
        .unwrap();
    let scene = moved(sphere(1.0), &file());
    assert!(pose(&scene, 0.0).abs_diff_eq(DMat4::from_translation(DVec3::new(1.0, 2.0, 3.0)), 1e-9));
    let end = pose(&scene, 0.5);
    assert!(end.w_axis.truncate().distance(DVec3::new(2.0, -2.0, 0.0)) < 1e-9 && end.z_axis.z < -0.999);
    assert_eq!(scene.duration_s, Some(0.5));
    assert!(!scene.rests(&[]) && scene.camera_motion.as_ref().unwrap().speed_px_per_s.is_none());
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);

    std::fs::write(&path, "0 500 0 0 0 0 0 1\n1 501 0 0 0 0 0 1\n").unwrap();
    let away = moved(sphere(1.0), &file());
    assert!(away.warnings[0].contains("never turns the camera towards anything"), "{:?}", away.warnings);

    for (text, expected) in [
        ("0 0 0 0 0 0 0 1\n1 0 0 x 0 0 0 1\n", "line 2, column 7: 'x' is not a number"),
        ("0 0 0 0 0 0 0 1\n  1, 0, 0, 0, 0, 0, 0\n", "line 2, column 3: 7 columns; it takes 8"),
        ("# unit: weeks\n0 0 0 0 0 0 0 1\n", "line 1, column 9: the unit of time is 'weeks'"),
        ("0 0 0 0 0 0 0 1\n5000000 0 0 1 0 0 0 1\n", "line '# unit: ns'"),
        ("", "no pose"),
    ] {
        std::fs::write(&path, text).unwrap();
        let reason = sphere(1.0).move_cameras(&file()).unwrap_err().to_string();
        assert!(reason.contains(expected) && reason.contains("poses.csv"), "{text:?}: {reason}");
    }
    std::fs::remove_file(&path).unwrap();
    assert!(matches!(sphere(1.0).move_cameras(&file()), Err(SceneError::Io { .. })));
}

fn ask_file(path: &FilePath) -> CameraMotionSettings {
    CameraMotionSettings { motion: Some(CameraMotion::File(path.into())), ..CameraMotionSettings::default() }
}

#[test]
fn bad_settings_say_what_works() {
    for bad in [0.0, -5.0, f64::NAN, f64::INFINITY, 1e9, 1e-9] {
        let reason = sphere(1.0).move_cameras(&ask(CameraMotion::Orbit, bad)).unwrap_err().to_string();
        assert!(reason.contains(&bad.to_string()) && reason.contains("0.01 to 100000"), "{reason}");
    }
    let reason = sphere(1.0).move_cameras(&ask(CameraMotion::None, 10.0)).unwrap_err().to_string();
    assert!(reason.contains("takes no speed"), "{reason}");
    let speed_alone = CameraMotionSettings { speed_px_per_s: Some(10.0), ..CameraMotionSettings::default() };
    let mut street = evis_scene::builtin::load("street", 0).unwrap();
    let reason = street.move_cameras(&speed_alone).unwrap_err().to_string();
    assert!(reason.contains("moves nothing here"), "{reason}");
    let reason = street.move_cameras(&ask(CameraMotion::Orbit, 10.0)).unwrap_err().to_string();
    assert!(reason.contains("moves by itself"), "{reason}");
    assert!(sphere(1.0).move_cameras(&speed_alone).is_ok());
    let nobody = CameraMotionSettings { camera: Some("lefft".into()), ..ask(CameraMotion::Orbit, 10.0) };
    assert!(sphere(1.0).move_cameras(&nobody).unwrap_err().to_string().contains("lefft"));

    let path = picture("orbit.png", 32, 24);
    let mut flat = source::load(&path.to_string_lossy(), 0).unwrap();
    std::fs::remove_file(path).unwrap();
    assert!(
        flat.move_cameras(&ask(CameraMotion::Orbit, 10.0))
            .unwrap_err()
            .to_string()
            .contains("shake or dolly")
    );

    for (word, expected) in
        [("orbti", "'orbit'"), ("shakes", "'shake'"), ("", "none, orbit, dolly"), ("Dolly", "'dolly'")]
    {
        let reason = word.parse::<CameraMotion>().unwrap_err();
        assert!(reason.contains(expected), "{word}: {reason}");
    }
    assert_eq!("a/b".parse(), Ok(CameraMotion::File("a/b".into())));
    assert_eq!("path.csv".parse(), Ok(CameraMotion::File("path.csv".into())));
    assert_eq!("none".parse(), Ok(CameraMotion::None));
}

#[test]
fn what_shows_nothing_is_refused_or_moved_all_the_same() {
    // A sky alone: turning moves it, a dolly has no way to go.
    let mut sky = Scene { environment: Some(Environment::studio()), ..Scene::default() };
    let node = sky.add_node(evis_scene::Node::default());
    let mut camera = sphere(1.0).cameras.remove(0);
    camera.node = node;
    sky.cameras.push(camera);
    assert!(!moved(sky.clone(), &ask(CameraMotion::Shake, 100.0)).rests(&[]));
    let reason = sky.move_cameras(&ask(CameraMotion::Dolly, 100.0)).unwrap_err().to_string();
    assert!(reason.contains("nothing is drawn"), "{reason}");
}

#[test]
fn damaged_pictures_are_refused() {
    let path = picture("damaged.png", 32, 24);
    let good = std::fs::read(&path).unwrap();
    assert!(source::load(&path.to_string_lossy(), 0).is_ok());
    for bytes in [&good[..good.len() / 2], b"no picture", b""] {
        std::fs::write(&path, bytes).unwrap();
        let reason = source::load(&path.to_string_lossy(), 0).unwrap_err().to_string();
        assert!(reason.contains("damaged.png"), "{reason}");
    }
    std::fs::remove_file(path).unwrap();
    assert!(matches!(source::load("missing.png", 0), Err(SceneError::Io { .. })));
}
