//! Curves, paths and waveforms against formulas written another way.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use evis_scene::motion::{Curve, Interpolation, Motion, Path, PathInterpolation, WaveShape, Waveform};
use evis_scene::{Material, Mesh, Node, Scene, SceneState, Skin, Trs, Variant};
use glam::{DMat3, DMat4, DQuat, DVec3, DVec4};

fn close(a: DMat4, b: DMat4, tolerance: f64) -> bool {
    let scale = 1.0 + b.to_cols_array().iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    a.to_cols_array().iter().zip(b.to_cols_array()).all(|(x, y)| (x - y).abs() <= tolerance * scale)
}

fn assert_close(a: DMat4, b: DMat4) {
    assert!(close(a, b, 1e-12), "{a}\n{b}");
    // Canary: the comparison must see a micrometre.
    let moved = DMat4::from_translation(DVec3::new(0.0, 1e-6, 0.0)) * b;
    assert!(!close(moved, b, 1e-12) || b.to_cols_array().iter().any(|v| v.abs() > 1e5));
}

/// Rotation about an axis by Rodrigues' formula.
fn rodrigues(axis: DVec3, angle: f64) -> DMat3 {
    let k = DMat3::from_cols(
        DVec3::new(0.0, axis.z, -axis.y),
        DVec3::new(-axis.z, 0.0, axis.x),
        DVec3::new(axis.y, -axis.x, 0.0),
    );
    DMat3::IDENTITY + k * angle.sin() + k * k * (1.0 - angle.cos())
}

fn compose(rotation: DMat3, scale: DVec3, translation: DVec3) -> DMat4 {
    DMat4::from_cols(
        (rotation.x_axis * scale.x).extend(0.0),
        (rotation.y_axis * scale.y).extend(0.0),
        (rotation.z_axis * scale.z).extend(0.0),
        translation.extend(1.0),
    )
}

fn start() -> (Trs, DMat3) {
    let axis = DVec3::new(1.0, 2.0, 2.0) / 3.0;
    let trs = Trs {
        translation: DVec3::new(0.3, -1.2, 4.0),
        rotation: DQuat::from_axis_angle(axis, 0.7),
        scale: DVec3::new(1.0, 2.0, 0.5),
    };
    (trs, rodrigues(axis, 0.7))
}

#[test]
fn curves_follow_gltf_appendix_c() {
    let times = vec![0.5, 1.0, 3.0];
    let linear = Curve {
        times: times.clone(),
        values: vec![0.0, 10.0, 1.0, 20.0, 5.0, 0.0],
        width: 2,
        interpolation: Interpolation::Linear,
    };
    let at = |c: &Curve, t: f64| {
        let mut out = [f64::NAN; 2];
        c.sample(t, &mut out);
        out
    };
    assert_eq!(at(&linear, -7.0), [0.0, 10.0]);
    assert_eq!(at(&linear, 0.75), [0.5, 15.0]);
    assert_eq!(at(&linear, 1.0), [1.0, 20.0]);
    assert_eq!(at(&linear, 2.0), [3.0, 10.0]);
    assert_eq!(at(&linear, 99.0), [5.0, 0.0]);
    let step = Curve { interpolation: Interpolation::Step, ..linear };
    assert_eq!(at(&step, 0.999_999), [0.0, 10.0]);
    assert_eq!(at(&step, 1.0), [1.0, 20.0]);
    assert_eq!(at(&step, 2.999_999), [1.0, 20.0]);
    assert_eq!(at(&step, 3.0), [5.0, 0.0]);

    // A spline through a cubic polynomial with its true slopes is that polynomial.
    let p = |t: f64| 2.0 - t + 0.5 * t * t - 0.25 * t * t * t;
    let dp = |t: f64| -1.0 + t - 0.75 * t * t;
    let spline = Curve {
        values: times
            .iter()
            .flat_map(|&t| [dp(t), 2.0 * dp(t), p(t), 2.0 * p(t), dp(t), 2.0 * dp(t)])
            .collect(),
        times,
        width: 2,
        interpolation: Interpolation::CubicSpline,
    };
    spline.check().expect("valid");
    for k in 0..=100 {
        let t = 0.5 + 2.5 * f64::from(k) / 100.0;
        let [a, b] = at(&spline, t);
        assert!((a - p(t)).abs() < 1e-12 && (b - 2.0 * p(t)).abs() < 1e-12, "{t}: {a} {b}");
    }
    assert_eq!(at(&spline, 4.0)[0], p(3.0));
}

#[test]
fn broken_curves_are_refused_and_never_panic() {
    let good =
        Curve { times: vec![0.0, 1.0], values: vec![0.0; 6], width: 3, interpolation: Interpolation::Linear };
    assert!(good.check().is_ok());
    let broken = [
        Curve { times: vec![], ..good.clone() },
        Curve { times: vec![0.0, 0.0], ..good.clone() },
        Curve { times: vec![0.0, f64::NAN], ..good.clone() },
        Curve { values: vec![0.0; 5], ..good.clone() },
        Curve { values: vec![f64::INFINITY; 6], ..good.clone() },
        Curve { interpolation: Interpolation::CubicSpline, ..good.clone() },
        Curve { width: usize::MAX, ..good },
    ];
    for (i, curve) in broken.iter().enumerate() {
        assert!(curve.check().is_err(), "case {i}");
        if curve.width <= 4 {
            for t in [-1.0, 0.0, 0.5, 1.0, 2.0, f64::NAN] {
                curve.sample(t, &mut [0.0; 2]);
                curve.rotation(t);
            }
        }
    }
}

#[test]
fn rotations_turn_at_constant_rate_along_the_shorter_arc() {
    let axis = DVec3::new(2.0, -1.0, 2.0) / 3.0;
    for total in [1e-7, 1e-3, 0.02, 1.0, 3.1] {
        let b = DQuat::from_axis_angle(axis, total);
        for sign in [1.0, -1.0] {
            let values = vec![0.0, 0.0, 0.0, 1.0, sign * b.x, sign * b.y, sign * b.z, sign * b.w];
            let curve =
                Curve { times: vec![1.0, 3.0], values, width: 4, interpolation: Interpolation::Linear };
            for u in [0.0, 0.1, 0.37, 0.5, 0.93, 1.0] {
                let q = curve.rotation(1.0 + 2.0 * u);
                let expected = rodrigues(axis, total * u);
                let error = (DMat3::from_quat(q) - expected)
                    .to_cols_array()
                    .iter()
                    .fold(0.0_f64, |m, v| m.max(v.abs()));
                assert!(error < 1e-14 + 1e-10 * total, "{total} {u}: {error:e}");
            }
        }
    }
}

#[test]
fn analytic_paths_match_their_formulas() {
    let (trs, r) = start();
    let axis = DVec3::new(0.0, 0.6, -0.8);
    let v = DVec3::new(1.0, -2.0, 3.0);
    for k in 0..50 {
        let t = -3.0 + 0.31 * f64::from(k);
        let path = Path::ConstantVelocity { start: trs, velocity: v };
        assert_close(path.matrix(t), compose(r, trs.scale, trs.translation + v * t));

        let path = Path::Spin { start: trs, axis, rate: 2.5 };
        assert_close(path.matrix(t), compose(rodrigues(axis, 2.5 * t) * r, trs.scale, trs.translation));

        let gravity = DVec3::new(0.1, -9.81, 0.0);
        let path = Path::Ballistic {
            start: trs,
            velocity: v,
            gravity,
            spin_axis: axis,
            spin_rate: -4.0,
            launch_s: 1.0,
        };
        let f = if t < 1.0 { 0.0 } else { t - 1.0 };
        let p = trs.translation + v * f + gravity * f * f / 2.0;
        assert_close(path.matrix(t), compose(rodrigues(axis, -4.0 * f) * r, trs.scale, p));

        let path = Path::FigureEight { start: trs, size: [2.0, 0.7], period_s: 6.0, look_at: None };
        let w = TAU / 6.0;
        let p = trs.translation
            + r * DVec3::new(2.0 * (w * t).sin(), 0.0, 0.7 * 2.0 * (w * t).sin() * (w * t).cos());
        assert_close(path.matrix(t), compose(r, trs.scale, p));

        let chain = Path::Chain(vec![
            Path::Spin { start: Trs::default(), axis, rate: 1.0 },
            Path::ConstantVelocity { start: Trs::default(), velocity: v },
        ]);
        assert_close(chain.matrix(t), compose(rodrigues(axis, t), DVec3::ONE, rodrigues(axis, t) * (v * t)));
    }
}

#[test]
fn a_figure_eight_looks_at_its_target_upright() {
    let target = DVec3::new(1.0, -3.0, 2.0);
    let path =
        Path::FigureEight { start: Trs::default(), size: [3.0, 1.0], period_s: 4.0, look_at: Some(target) };
    for k in 0..40 {
        let m = path.matrix(0.1 * f64::from(k));
        let eye = m.w_axis.truncate();
        let view = m.inverse() * target.extend(1.0);
        assert!(view.x.abs() < 1e-12 && view.y.abs() < 1e-12, "off centre: {view}");
        assert!((view.z + (target - eye).length()).abs() < 1e-12, "behind: {view}");
        assert!(m.x_axis.y.abs() < 1e-12 && m.y_axis.y > 0.0, "not upright: {m}");
        assert!((m.determinant() - 1.0).abs() < 1e-12);
    }
    let straight_down =
        Path::FigureEight { start: Trs::default(), size: [0.0; 2], period_s: 1.0, look_at: Some(-DVec3::Y) };
    let m = straight_down.matrix(0.3);
    assert!(m.is_finite() && ((m * DVec4::NEG_Z).truncate() + DVec3::Y).length() < 1e-12);
    let nowhere = Path::FigureEight {
        start: Trs::default(),
        size: [0.0; 2],
        period_s: 1.0,
        look_at: Some(DVec3::ZERO),
    };
    assert_close(nowhere.matrix(0.3), DMat4::IDENTITY);
}

fn keys(interpolation: PathInterpolation) -> (Vec<f64>, Vec<DVec3>, Path) {
    let times = vec![0.0, 0.4, 1.0, 1.7, 3.0];
    let positions: Vec<_> = times
        .iter()
        .map(|t: &f64| DVec3::new((1.3 * t).sin(), t * t, 1.0 - 0.5 * t + (2.0 * t).cos()))
        .collect();
    let rotations = times.iter().map(|t| DQuat::from_axis_angle(DVec3::Y, 0.5 * t)).collect();
    let velocities = times
        .iter()
        .map(|t: &f64| DVec3::new(1.3 * (1.3 * t).cos(), 2.0 * t, -0.5 - 2.0 * (2.0 * t).sin()))
        .collect();
    let path = Path::Keys {
        times: times.clone(),
        positions: positions.clone(),
        rotations,
        velocities,
        interpolation,
    };
    path.check().expect("valid");
    (times, positions, path)
}

#[test]
fn keyed_paths_match_independent_splines() {
    let (times, p, catmull) = keys(PathInterpolation::CatmullRom);
    let (_, _, linear) = keys(PathInterpolation::Linear);
    let (_, _, hermite) = keys(PathInterpolation::Hermite);
    let position = |path: &Path, t: f64| path.matrix(t).w_axis.truncate();
    for k in 0..=300 {
        let t = 3.0 * f64::from(k) / 300.0;
        let i = times.iter().rposition(|&key| key <= t).unwrap_or(0).min(times.len() - 2);
        let (ta, tb) = (times[i], times[i + 1]);
        let line = p[i] + (p[i + 1] - p[i]) * ((t - ta) / (tb - ta));
        assert!((position(&linear, t) - line).length() < 1e-12);
        // Barry and Goldman's pyramid, for spans with a neighbour on both sides.
        if i > 0 && i + 2 < times.len() {
            let mix = |a: DVec3, b: DVec3, ta: f64, tb: f64| (a * (tb - t) + b * (t - ta)) / (tb - ta);
            let knot = &times[i - 1..];
            let a: Vec<_> = (0..3).map(|j| mix(p[i - 1 + j], p[i + j], knot[j], knot[j + 1])).collect();
            let b: Vec<_> = (0..2).map(|j| mix(a[j], a[j + 1], knot[j], knot[j + 2])).collect();
            let c = mix(b[0], b[1], knot[1], knot[2]);
            assert!((position(&catmull, t) - c).length() < 1e-12, "{t}");
            // Canary: it is not the line.
            if (t - ta).min(tb - t) > 0.1 {
                assert!((line - c).length() > 1e-4, "{t}");
            }
        }
        // De Casteljau on the Bezier points of the same Hermite span.
        let v = |t: f64| DVec3::new(1.3 * (1.3 * t).cos(), 2.0 * t, -0.5 - 2.0 * (2.0 * t).sin());
        let third = (tb - ta) / 3.0;
        let mut points = vec![p[i], p[i] + v(ta) * third, p[i + 1] - v(tb) * third, p[i + 1]];
        while points.len() > 1 {
            points = points.windows(2).map(|w| w[0].lerp(w[1], (t - ta) / (tb - ta))).collect();
        }
        assert!((position(&hermite, t) - points[0]).length() < 1e-12, "{t}");
        // All turn alike.
        assert_close(
            DMat4::from_mat3(DMat3::from_mat4(catmull.matrix(t))),
            compose(rodrigues(DVec3::Y, 0.5 * t), DVec3::ONE, DVec3::ZERO),
        );
    }
    for path in [&catmull, &linear, &hermite] {
        assert_close(path.matrix(-5.0), path.matrix(0.0));
        assert_close(path.matrix(50.0), path.matrix(3.0));
    }
}

#[test]
fn catmull_rom_reproduces_quadratic_motion_to_its_ends() {
    let f = |t: f64| DVec3::new(1.0 + t, 2.0 * t * t - t, -t * t);
    let times = vec![-1.0, 0.0, 0.3, 2.0];
    let path = Path::Keys {
        positions: times.iter().map(|&t| f(t)).collect(),
        rotations: vec![DQuat::IDENTITY; 4],
        times,
        velocities: vec![],
        interpolation: PathInterpolation::CatmullRom,
    };
    for k in 0..=60 {
        let t = -1.0 + 0.05 * f64::from(k);
        assert!((path.matrix(t).w_axis.truncate() - f(t)).length() < 1e-12, "{t}");
    }
}

#[test]
fn broken_paths_are_refused_and_never_panic() {
    let broken = [
        Path::Keys {
            times: vec![0.0, 1.0],
            positions: vec![DVec3::ZERO],
            rotations: vec![],
            velocities: vec![],
            interpolation: PathInterpolation::Hermite,
        },
        Path::Keys {
            times: vec![],
            positions: vec![],
            rotations: vec![],
            velocities: vec![],
            interpolation: PathInterpolation::CatmullRom,
        },
        Path::Spin { start: Trs::default(), axis: DVec3::ZERO, rate: 1.0 },
        Path::FigureEight { start: Trs::default(), size: [1.0; 2], period_s: 0.0, look_at: None },
        Path::ConstantVelocity { start: Trs::default(), velocity: DVec3::NAN },
    ];
    for path in broken {
        for t in [-1.0, 0.0, 0.5, 2.0] {
            path.matrix(t);
        }
        assert!(Motion::Path(Arc::new(path)).check().is_err());
    }
}

#[test]
fn waveforms_have_their_shapes() {
    let sine = Waveform { shape: WaveShape::Sine, frequency_hz: 50.0, phase: 0.0, low: 0.2, high: 1.0 };
    for k in 0..200 {
        let t = 0.000_37 * f64::from(k) - 0.02;
        assert!((sine.factor(t) - (0.6 + 0.4 * (100.0 * PI * t).sin())).abs() < 1e-12);
    }
    assert!((Waveform { phase: 0.25, ..sine }.factor(0.0) - 1.0).abs() < 1e-12);
    let square = Waveform { shape: WaveShape::Square, ..sine };
    assert_eq!(
        [0.0, 0.0099, 0.0101, 0.0199, 0.0201, -0.0001].map(|t| square.factor(t)),
        [1.0, 1.0, 0.2, 0.2, 1.0, 0.2]
    );
    let pwm = Waveform { shape: WaveShape::Pwm { duty: 0.1 }, ..sine };
    assert_eq!([0.0, 0.0019, 0.0021, 0.0199].map(|t| pwm.factor(t)), [1.0, 1.0, 0.2, 0.2]);
    assert_eq!(Waveform { low: -1.0, ..square }.factor(0.015), 0.0);
    assert!(pwm.check().is_ok());
    assert!(Waveform { shape: WaveShape::Pwm { duty: 1.5 }, ..sine }.check().is_err());
}

#[test]
fn a_scene_is_evaluated_with_parents_variants_weights_and_factors() {
    let wave = Waveform { shape: WaveShape::Square, frequency_hz: 1.0, phase: 0.0, low: 0.0, high: 2.0 };
    let moving = Motion::Path(Arc::new(Path::ConstantVelocity { start: Trs::default(), velocity: DVec3::X }));
    let weights = Curve {
        times: vec![0.0, 2.0],
        values: vec![0.0, 1.0, 1.0, 0.0],
        width: 2,
        interpolation: Interpolation::Linear,
    };
    let turned = DMat4::from_rotation_y(1.0);
    let scene = Scene {
        nodes: vec![
            Node { motion: moving, ..Node::default() },
            Node {
                parent: Some(0),
                motion: Motion::Fixed(turned),
                mesh: Some(0),
                morph: Some(weights),
                ..Node::default()
            },
            Node { mesh: Some(0), ..Node::default() },
        ],
        meshes: vec![Mesh { morph_weights: vec![0.25, 0.75], ..Mesh::default() }],
        materials: vec![
            Material { emission_waveform: Some(wave), ..Material::default() },
            Material::default(),
        ],
        skins: vec![Skin { joints: vec![1], inverse_bind: vec![turned.inverse()] }],
        ..Scene::default()
    };
    let mut state = SceneState::default();
    scene.evaluate(0.5, &mut state);
    assert_close(state.world_from_node[1], DMat4::from_translation(DVec3::X * 0.5) * turned);
    assert_eq!(state.morph_weights, [vec![], vec![0.25, 0.75], vec![0.25, 0.75]]);
    assert_eq!(state.emission_factor, [0.0, 1.0]);
    let memory = state.morph_weights[1].as_ptr();

    let offset = DMat4::from_rotation_z(0.3);
    let variant = Variant { time_offset_s: 0.75, node_offsets: vec![(0, offset)], ..Variant::default() };
    scene.evaluate_variant(Some(&variant), 0.5, &mut state);
    assert_close(state.world_from_node[1], offset * DMat4::from_translation(DVec3::X * 1.25) * turned);
    assert_eq!(state.morph_weights[1], [0.625, 0.375]);
    assert_eq!(state.emission_factor, [2.0, 1.0]);
    assert_eq!(state.morph_weights[1].as_ptr(), memory, "memory is reused");

    let mut joints = vec![DMat4::ZERO; 9];
    scene.evaluate(2.0, &mut state);
    scene.joint_matrices(0, &state, &mut joints);
    assert_eq!(joints.len(), 1);
    assert_close(joints[0], DMat4::from_translation(DVec3::X * 2.0));
    scene.joint_matrices(7, &state, &mut joints);
    assert!(joints.is_empty());
}
