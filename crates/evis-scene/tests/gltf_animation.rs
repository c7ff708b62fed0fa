//! World matrices of animated nodes against an evaluation that shares no code with the crate: plain arrays, rotations
//! as axis and angle, splines as polynomials, read straight from the file's numbers.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use std::path::Path;

use common::{Glb, Random};
use evis_scene::SceneState;
use evis_scene::gltf::{Options, read};
use serde_json::{Value, json};

type Matrix = [[f64; 4]; 4];

/// Row-major product.
fn product(a: &Matrix, b: &Matrix) -> Matrix {
    let mut out = [[0.0; 4]; 4];
    for (i, row) in out.iter_mut().enumerate() {
        for (j, cell) in row.iter_mut().enumerate() {
            *cell = (0..4).map(|k| a[i][k] * b[k][j]).sum();
        }
    }
    out
}

/// Hamilton product of (x, y, z, w).
fn hamilton(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    [
        a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
        a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
        a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
        a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
    ]
}

fn normalized(q: [f64; 4]) -> [f64; 4] {
    let n = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    q.map(|v| v / n)
}

/// From `a` the fraction `u` of the turn that leads to `b`, about that turn's own axis.
fn turned(a: [f64; 4], b: [f64; 4], u: f64) -> [f64; 4] {
    let (a, b) = (normalized(a), normalized(b));
    let mut turn = hamilton([-a[0], -a[1], -a[2], a[3]], b);
    if turn[3] < 0.0 {
        turn = turn.map(|v| -v);
    }
    let sine = (turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2]).sqrt();
    let half = sine.atan2(turn[3]) * u;
    let along = if sine > 0.0 { half.sin() / sine } else { u };
    hamilton(a, [turn[0] * along, turn[1] * along, turn[2] * along, half.cos()])
}

struct Keys {
    rule: &'static str,
    times: Vec<f32>,
    values: Vec<f32>,
    width: usize,
}

impl Keys {
    fn at(&self, t: f64, rotation: bool) -> Vec<f64> {
        let n = self.times.len();
        let spline = self.rule == "CUBICSPLINE";
        let row = |r: usize| -> Vec<f64> {
            self.values[r * self.width..(r + 1) * self.width].iter().map(|v| f64::from(*v)).collect()
        };
        let value = |k: usize| row(if spline { 3 * k + 1 } else { k });
        let mut k = 0;
        while k + 1 < n && f64::from(self.times[k + 1]) <= t {
            k += 1;
        }
        let out = if t <= f64::from(self.times[0]) || k + 1 == n {
            value(k)
        } else {
            let (t0, t1) = (f64::from(self.times[k]), f64::from(self.times[k + 1]));
            let u = (t - t0) / (t1 - t0);
            let (a, b) = (value(k), value(k + 1));
            match self.rule {
                "STEP" => a,
                "LINEAR" if rotation => {
                    let q = |v: &[f64]| [v[0], v[1], v[2], v[3]];
                    turned(q(&a), q(&b), u).to_vec()
                }
                "LINEAR" => a.iter().zip(&b).map(|(a, b)| a + (b - a) * u).collect(),
                _ => {
                    // p(u) = a + m u + c u^2 + d u^3 from its values and slopes at both ends.
                    let (m0, m1) = (row(3 * k + 2), row(3 * (k + 1)));
                    (0..self.width)
                        .map(|i| {
                            let (m0, m1) = (m0[i] * (t1 - t0), m1[i] * (t1 - t0));
                            let c = 3.0 * (b[i] - a[i]) - 2.0 * m0 - m1;
                            let d = 2.0 * (a[i] - b[i]) + m0 + m1;
                            a[i] + u * (m0 + u * (c + u * d))
                        })
                        .collect()
                }
            }
        };
        if rotation { normalized([out[0], out[1], out[2], out[3]]).to_vec() } else { out }
    }
}

fn composed(t: &[f64], q: &[f64], s: &[f64]) -> Matrix {
    let [x, y, z, w] = [q[0], q[1], q[2], q[3]];
    let r = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ];
    let row = |i: usize| [r[i][0] * s[0], r[i][1] * s[1], r[i][2] * s[2], t[i]];
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}

fn random_keys(random: &mut Random, rule: &'static str, kind: &str) -> Keys {
    let width = if kind == "rotation" { 4 } else { 3 };
    let n = 3 + random.below(6);
    let mut t = random.unit() as f32;
    let times: Vec<f32> = (0..n)
        .map(|_| {
            t += 0.02 + random.unit() as f32;
            t
        })
        .collect();
    let rows = if rule == "CUBICSPLINE" { 3 } else { 1 };
    let mut values = Vec::new();
    for _ in 0..n {
        for row in 0..rows {
            let mut v: Vec<f64> = (0..width).map(|_| 2.0 * random.unit() - 1.0).collect();
            let is_value = rows == 1 || row == 1;
            if kind == "rotation" && is_value {
                v = normalized([v[0], v[1], v[2], v[3]]).to_vec();
            }
            if kind == "scale" && is_value {
                v = v.iter().map(|v| 1.5 + v).collect();
            }
            values.extend(v.iter().map(|v| *v as f32));
        }
    }
    Keys { rule, times, values, width }
}

#[test]
fn world_matrices_equal_an_independent_evaluation_at_ten_thousand_times() {
    let mut random = Random(7);
    for rule in ["LINEAR", "STEP", "CUBICSPLINE"] {
        let mut glb = Glb::default();
        let triangle = glb.floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0], "VEC3");
        let (mut channels, mut samplers): (Vec<Value>, Vec<Value>) = (Vec::new(), Vec::new());
        let mut tracks = Vec::new();
        // The file lists the child first: order in the file is not order in the tree.
        for node in 0..3 {
            for kind in ["translation", "rotation", "scale"] {
                let keys = random_keys(&mut random, rule, kind);
                let input = glb.floats(&keys.times, "SCALAR");
                let output = glb.floats(&keys.values, if kind == "rotation" { "VEC4" } else { "VEC3" });
                channels.push(json!({"sampler": samplers.len(), "target": {"node": node, "path": kind}}));
                samplers.push(json!({"input": input, "output": output, "interpolation": rule}));
                tracks.push(keys);
            }
        }
        let bytes = glb.bytes(&json!({
            "scene": 0, "scenes": [{"nodes": [2]}],
            "nodes": [{"name": "hand", "mesh": 0}, {"name": "arm", "children": [0]}, {"name": "body", "children": [1]}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": triangle}}]}],
            "animations": [{"channels": channels, "samplers": samplers}],
        }));
        let scene = read(&bytes, Path::new(""), &Options::default()).expect("valid");
        let hand = scene.nodes.iter().position(|n| n.name == "hand").expect("the node exists");
        let end = scene.duration_s.expect("animated");
        let last = tracks.iter().map(|k| f64::from(*k.times.last().expect("keys"))).fold(0.0, f64::max);
        assert_eq!(end, last);

        let expected = |t: f64| {
            let of = |n: usize| {
                composed(
                    &tracks[3 * n].at(t, false),
                    &tracks[3 * n + 1].at(t, true),
                    &tracks[3 * n + 2].at(t, false),
                )
            };
            product(&product(&of(2), &of(1)), &of(0))
        };
        let mut state = SceneState::default();
        let mut worst = 0.0_f64;
        let mut canary = 0.0_f64;
        for _ in 0..10_000 {
            let t = (1.2 * random.unit() - 0.1) * end;
            scene.evaluate(t, &mut state);
            let got = state.world_from_node[hand].to_cols_array_2d();
            let error = |want: &Matrix| {
                let scale = want.iter().flatten().fold(0.0_f64, |m, v| m.max(v.abs()));
                let cells = (0..16).map(|k| (got[k % 4][k / 4] - want[k / 4][k % 4]).abs());
                cells.fold(0.0, f64::max) / scale
            };
            worst = worst.max(error(&expected(t)));
            canary = canary.max(error(&expected(t + 1e-4)));
        }
        assert!(worst < 1e-9, "{rule}: relative error {worst:e}");
        assert!(canary > 1e-6, "{rule}: the comparison does not see a tenth of a millisecond");
    }
}

#[test]
fn weights_are_animated_and_the_animation_is_chosen_by_name_or_index() {
    let mut glb = Glb::default();
    let triangle = glb.floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0], "VEC3");
    let times = glb.floats(&[0.0, 2.0], "SCALAR");
    let weights = glb.floats(&[0.0, 1.0, 1.0, 0.5], "SCALAR");
    let moved = glb.floats(&[0.0, 0.0, 0.0, 4.0, 0.0, 0.0], "VEC3");
    let rest = json!({
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": triangle},
            "targets": [{"POSITION": triangle}, {"POSITION": triangle}]}]}],
        "animations": [
            {"name": "grow", "samplers": [{"input": times, "output": weights}],
             "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}},
                          {"sampler": 0, "target": {"path": "pointer"}}]},
            {"samplers": [{"input": times, "output": moved}],
             "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}]},
        ],
    });
    let bytes = glb.bytes(&rest);
    let load = |animation: Option<&str>| {
        let options = Options { animation: animation.map(str::to_owned), ..Options::default() };
        read(&bytes, Path::new(""), &options)
    };
    let mut state = SceneState::default();
    let scene = load(None).expect("valid");
    scene.evaluate(0.5, &mut state);
    assert_eq!(state.morph_weights[0], [0.25, 0.875]);
    assert!(scene.warnings.iter().any(|w| w.contains("move no node")), "{:?}", scene.warnings);
    assert!(
        scene.warnings.iter().any(|w| w.contains("'grow' plays") && w.ends_with("the file: 1")),
        "others"
    );
    assert_eq!((scene.animation.as_deref(), scene.animations.join(", ")), (Some("grow"), "grow, 1".into()));
    let scene = load(Some("1")).expect("valid");
    assert_eq!((scene.animation.as_deref(), scene.animations.len()), (Some("1"), 2));
    assert!(!scene.warnings.iter().any(|w| w.contains("plays")), "it was chosen: {:?}", scene.warnings);
    scene.evaluate(0.5, &mut state);
    assert_eq!(state.morph_weights[0], [0.0, 0.0]);
    assert_eq!(state.world_from_node[0].w_axis.x, 1.0);
    let error = load(Some("run")).expect_err("no such animation").to_string();
    assert!(error.contains("'run'") && error.contains("grow, 1"), "{error}");
}
