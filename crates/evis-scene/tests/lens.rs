//! Calibrated lenses against closed-form values: OpenCV's formulas, round trips, Jacobians, the region of validity.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::f64::consts::FRAC_PI_2;

use evis_scene::{CalibratedLens, Distortion, LensModel, PinholeLens};
use glam::{DVec2, DVec3};

const FOCAL: [f64; 2] = [310.0, 305.5];
const CENTER: [f64; 2] = [172.3, 131.9];

fn lens(model: &str, coefficients: &[f64]) -> CalibratedLens {
    let distortion = Distortion::from_coefficients(model, coefficients).unwrap();
    CalibratedLens::new(FOCAL, CENTER, Some(distortion)).unwrap()
}

fn lenses() -> Vec<CalibratedLens> {
    vec![
        CalibratedLens::new(FOCAL, CENTER, None).unwrap(),
        lens("radtan", &[-0.37, 0.14, 1.2e-3, -7e-4, -0.02]),
        lens("radtan", &[0.2, 0.03, -1e-3, 2e-3]),
        lens("radtan", &[0.3, -0.1, 5e-4, 1e-3, 0.01, 0.55, -0.03, 0.02]),
        lens("fisheye", &[0.02, -0.011, 0.004, -0.0007]),
        lens("fisheye", &[]),
    ]
}

/// Pixels over the picture and a margin around it.
fn pixels() -> impl Iterator<Item = DVec2> {
    (0..40 * 32).map(|i| DVec2::new(f64::from(i % 40) * 9.3 - 8.0, f64::from(i / 40) * 8.9 - 7.0))
}

#[test]
fn projections_equal_opencvs_formulas() {
    let point = DVec3::new(0.31, -0.22, -1.0);
    let (x, y) = (0.31, 0.22);
    let u: f64 = x * x + y * y;
    let (k1, k2, p1, p2, k3) = (-0.37, 0.14, 1.2e-3, -7e-4, -0.02);
    let radial = 1.0 + k1 * u + k2 * u * u + k3 * u * u * u;
    let xd = x * radial + 2.0 * p1 * x * y + p2 * (u + 2.0 * x * x);
    let yd = y * radial + p1 * (u + 2.0 * y * y) + 2.0 * p2 * x * y;
    let expected = DVec2::new(FOCAL[0] * xd + CENTER[0], FOCAL[1] * yd + CENTER[1]);
    let close = |a: DVec2, b: DVec2| (a - b).length() < 1e-9;
    assert!(close(lenses()[1].project(point).unwrap(), expected));
    assert!(!close(lenses()[2].project(point).unwrap(), expected), "canary");

    let [k1, k2, k3, k4] = [0.02, -0.011, 0.004, -0.0007];
    let (r, t) = (u.sqrt(), u.sqrt().atan());
    let td = t + k1 * t.powi(3) + k2 * t.powi(5) + k3 * t.powi(7) + k4 * t.powi(9);
    let expected = DVec2::new(FOCAL[0] * x * td / r + CENTER[0], FOCAL[1] * y * td / r + CENTER[1]);
    assert!(close(lenses()[4].project(point).unwrap(), expected));
    assert!(!close(lenses()[5].project(point).unwrap(), expected), "canary");
}

#[test]
fn a_pinhole_projects_by_its_intrinsics() {
    let pinhole = PinholeLens { focal: FOCAL, center: CENTER };
    let point = DVec3::new(0.3, -0.2, -2.5);
    let expected = DVec2::new(CENTER[0] + FOCAL[0] * 0.3 / 2.5, CENTER[1] + FOCAL[1] * 0.2 / 2.5);
    assert!((pinhole.project(point).unwrap() - expected).length() < 1e-12);
    assert_eq!(pinhole.project(-point), None, "behind");
    assert_eq!(pinhole.project(point.with_z(f64::NAN)), None);
    // What it computes in closed form is what the general way gives.
    let general = General(pinhole);
    for pixel in pixels() {
        let (own, other) = (pinhole.planar_ray(pixel).unwrap(), general.planar_ray(pixel).unwrap());
        assert!((own.0 - other.0).length() < 1e-12);
        assert!(own.1.iter().zip(other.1).all(|(a, b)| (*a - b).length() < 1e-15), "{own:?} {other:?}");
        assert_eq!(pinhole.project(own.0), general.project(own.0));
    }
    let wider = General(PinholeLens { focal: [FOCAL[0] * 0.99, FOCAL[1]], center: CENTER });
    let at = |lens: &dyn LensModel| lens.planar_ray(DVec2::ZERO).unwrap().0;
    assert!((at(&pinhole) - at(&wider)).length() > 1e-3, "canary");
}

/// A pinhole by what every lens has.
struct General(PinholeLens);

impl LensModel for General {
    fn project_with_jacobian(&self, point: DVec3) -> Option<(DVec2, [DVec2; 3])> {
        self.0.project_with_jacobian(point)
    }

    fn unproject(&self, pixel: DVec2) -> Option<DVec3> {
        self.0.unproject(pixel)
    }
}

#[test]
fn every_pixel_that_is_seen_projects_back_to_itself() {
    for lens in lenses() {
        let mut seen = 0;
        for pixel in pixels() {
            let Some(direction) = lens.unproject(pixel) else { continue };
            seen += 1;
            assert!((direction.length() - 1.0).abs() < 1e-12);
            let there = lens.project(direction * 3.7).unwrap();
            assert!((there - pixel).length() < 1e-7, "{lens:?}: {pixel} and {there}");
        }
        assert!(seen > 1000, "{lens:?}: {seen}");
    }
    let [a, b] = [1, 2].map(|i| lenses()[i]);
    let there = b.project(a.unproject(DVec2::new(20.0, 20.0)).unwrap()).unwrap();
    assert!((there - DVec2::new(20.0, 20.0)).length() > 1.0, "canary: another lens");
}

#[test]
fn jacobians_equal_differences() {
    let difference = |lens: &CalibratedLens, point: DVec3, way: DVec3| {
        let h = 1e-6;
        (lens.project(point + way * h).unwrap() - lens.project(point - way * h).unwrap()) / (2.0 * h)
    };
    for lens in lenses() {
        for point in [DVec3::new(0.2, 0.13, -0.9), DVec3::new(-0.4, -0.3, -1.4), DVec3::new(0.0, 0.1, -2.0)] {
            let (_, columns) = lens.project_with_jacobian(point).unwrap();
            for (column, way) in columns.into_iter().zip([DVec3::X, DVec3::Y, DVec3::Z]) {
                let expected = difference(&lens, point, way);
                assert!((column - expected).length() < 1e-5, "{lens:?} {point}: {column} and {expected}");
                let elsewhere = difference(&lens, point * DVec3::new(1.0, 1.0, 1.1), way);
                assert!((column - elsewhere).length() > 1e-5 || column.length() < 1e-5, "canary");
            }
        }
        let pixel = DVec2::new(61.0, 200.0);
        let (ray, per_pixel) = lens.planar_ray(pixel).unwrap();
        let right = lens.planar_ray(pixel + DVec2::X * 1e-4).unwrap().0;
        assert!(((right - ray).truncate() * 1e4 - per_pixel[0]).length() < 1e-6, "{lens:?}");
    }
}

#[test]
fn points_beyond_the_fold_are_shown_nowhere() {
    // 1 - 3 * 0.4 r^2 = 0.
    let barrel = lens("radtan", &[-0.4]);
    let fold = (1.0_f64 / 1.2).sqrt();
    assert!((barrel.largest_angle() - fold.atan()).abs() < 1e-9);
    let at = |radius: f64| DVec3::new(radius, 0.0, -1.0);
    assert!(barrel.project(at(fold - 1e-3)).is_some());
    assert_eq!(barrel.project(at(fold + 1e-3)), None);
    // The formula alone would show it inside of the picture.
    assert_eq!(barrel.project(at(2.0)), None);
    let most = FOCAL[0] * fold * (1.0 - 0.4 * fold * fold);
    assert!(barrel.unproject(DVec2::new(CENTER[0] + most - 0.1, CENTER[1])).is_some());
    assert_eq!(barrel.unproject(DVec2::new(CENTER[0] + most + 0.1, CENTER[1])), None);
    assert_eq!(barrel.project(DVec3::new(0.0, 0.0, 1.0)), None, "behind");
    // A fisheye sees behind its own plane, but not beyond half a turn.
    let fisheye = lens("fisheye", &[]);
    let sideways = fisheye.project(DVec3::new(1.0, 0.0, 0.2)).unwrap();
    assert!((sideways.x - CENTER[0] - FOCAL[0] * (FRAC_PI_2 + 0.2_f64.atan())).abs() < 1e-9);
    assert_eq!(fisheye.unproject(DVec2::new(CENTER[0] + FOCAL[0] * 3.2, CENTER[1])), None);
    // A pole of the rational model.
    let pole = lens("radtan", &[0.0, 0.0, 0.0, 0.0, 0.0, -1.0]);
    assert!((pole.largest_angle() - FRAC_PI_2 / 2.0).abs() < 1e-6, "{}", pole.largest_angle());
}

#[test]
fn coefficients_keep_opencvs_order_and_bad_ones_are_refused() {
    let eight = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0];
    assert_eq!(Distortion::from_coefficients("radtan", &eight).unwrap().coefficients(), eight);
    let refused = |model, of: &[f64]| Distortion::from_coefficients(model, of).unwrap_err().to_string();
    assert!(refused("radial", &[]).contains("'radial'"));
    assert!(refused("fisheye", &eight).contains("8 coefficients"));
    assert!(refused("radtan", &[f64::NAN]).contains("NaN"));
    assert!(CalibratedLens::new([0.0, 1.0], [0.0; 2], None).is_err());
}

#[test]
fn scene_files_give_cameras_distortions_and_name_what_is_wrong() {
    let scene = |camera: &str| {
        let text = format!(
            "[[materials]]\nname = \"white\"\n[[primitives]]\nname = \"wall\"\nshape = \"card\"\nsize = [1.0, 1.0]\n\
             material = \"white\"\n[[cameras]]\nname = \"eye\"\n{camera}\n"
        );
        evis_scene::toml_scene::parse(&text, std::path::Path::new(""))
    };
    let with = |distortion: &str| scene(&format!("size = [64, 48]\nfx = 60.0\ndistortion = {distortion}"));
    let found = with("{ model = \"radtan\", k1 = -0.3, p2 = 1e-3, k3 = 0.01 }").unwrap();
    let expected = Distortion::from_coefficients("radtan", &[-0.3, 0.0, 0.0, 1e-3, 0.01]).unwrap();
    assert_eq!(found.distortions["eye"], expected);
    // Another size sees the same field.
    let (own, half) = (found.calibrated_lens(0, 64, 48).unwrap(), found.calibrated_lens(0, 32, 24).unwrap());
    let point = DVec3::new(0.2, 0.1, -1.0);
    assert!((own.project(point).unwrap() - 2.0 * half.project(point).unwrap()).length() < 1e-9);
    assert!((own.project(point).unwrap() - half.project(point).unwrap()).length() > 1.0, "canary");
    for (result, words) in [
        (with("{ model = \"omni\" }"), "radtan"),
        (with("{ k1 = 0.1 }"), "model"),
        (with("{ model = \"fisheye\", k5 = 0.1 }"), "k5"),
        (with("{ model = \"fisheye\", k1 = nan }"), "NaN"),
        (with("0.3"), "table"),
        (scene("distortion = { model = \"fisheye\" }"), "focal"),
    ] {
        let error = result.unwrap_err().to_string();
        assert!(error.contains(words), "{words}: {error}");
    }
}
