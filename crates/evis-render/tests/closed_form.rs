//! Floor 4: the product against closed forms. Drifting gratings, step edges under the box filter, flicker, and
//! motion vectors, each with the pixel's own integral in the formula. `-- --nocapture` prints the measured figures.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::f64::consts::{PI, TAU};
use std::sync::{Arc, OnceLock};

use evis_core::{Event, LabelData, LabelKind, SensorConfig, TriggerRule};
use evis_render::{Gpu, RunConfig, Simulator};
use evis_scene::builder::{EventCamera, Labels, Placement, Sampling, SceneBuilder};
use evis_scene::motion::Path;
use evis_scene::{Image, Material, Mesh, Primitive, Scene, Trs, Wrap};
use glam::{DMat4, DQuat, DVec3};
use half::f16;

/// Focal length in pixels of every camera here; screens stand at one metre, so a metre is so many pixels.
const FOCAL: f64 = 256.0;
/// `Y_ref`; the signals are given in its units.
const REFERENCE: f32 = 1.0;

/// The device. Where `EVIS_REQUIRE_GPU=1`, its absence is a failure; elsewhere it is said aloud.
fn device() -> Option<Gpu> {
    static GPU: OnceLock<Result<Gpu, String>> = OnceLock::new();
    match GPU.get_or_init(|| Gpu::open(None).map_err(|e| e.to_string())) {
        Ok(gpu) => Some(gpu.clone()),
        Err(error) => {
            assert!(std::env::var_os("EVIS_REQUIRE_GPU").is_none_or(|v| v != "1"), "{error}");
            eprintln!("NOT RUN: {error}");
            None
        }
    }
}

// ---------------------------------------------------------------------------------------------------- the truth

/// What one pixel must fire, in order.
#[derive(Clone)]
struct Truth {
    /// Microseconds, ON or OFF.
    crossings: Vec<(f64, bool)>,
    /// From here on the closed form itself is undecided (an extremum touches a threshold), or the stream ends.
    horizon_us: f64,
}

/// How the truth is solved and where it counts as undecided.
#[derive(Clone, Copy)]
struct Solve {
    /// Thresholds, ON and OFF.
    threshold: f64,
    end_us: i64,
    /// Log units: an extremum this close to a threshold is undecided.
    band: f64,
    /// No crossing lies closer to the horizon than this.
    margin_us: f64,
}

impl Solve {
    /// Solves `log(t) = reference + k C` by bisection; `log` is the closed form at `t` seconds.
    fn truth(&self, log: &dyn Fn(f64) -> f64) -> Truth {
        // Beyond the end too: what follows it closely might come before it.
        let end = (self.end_us as f64 + self.margin_us) * 1e-6;
        let steps = (end / 0.5e-3).ceil() as usize;
        let at = |i: usize| end * i as f64 / steps as f64;
        let mut reference = log(0.0);
        let (mut before, mut l0) = (0.0, reference);
        let (mut direction, mut piece_start, mut fired) = (0.0, 0.0, false);
        let mut crossings: Vec<(f64, bool)> = Vec::new();
        let mut horizon = end;
        for i in 1..=steps {
            let (t0, t1) = (at(i - 1), at(i));
            let l1 = log(t1);
            let now = if (l1 - l0).abs() < 1e-12 { 0.0 } else { (l1 - l0).signum() };
            if now != direction {
                // An extremum, or the start of a plateau.
                let extreme = direction * peak(&|t| direction * log(t), before, t1);
                let distance = direction * (extreme - reference);
                let level = if fired && distance < self.band {
                    Some(reference)
                } else if self.threshold - distance < self.band {
                    Some(reference + direction * self.threshold)
                } else {
                    None
                };
                if direction != 0.0
                    && let Some(level) = level
                {
                    let half_way = level - direction * self.threshold / 2.0;
                    let rise = |t: f64| direction * (log(t) - half_way);
                    horizon =
                        if rise(piece_start) < 0.0 { root(&rise, piece_start, t0) } else { piece_start };
                    break;
                }
                (direction, piece_start, fired) = (now, t0, false);
            }
            loop {
                let change = l1 - reference;
                if change.abs() < self.threshold {
                    break;
                }
                let sign = change.signum();
                let level = reference + sign * self.threshold;
                crossings.push((root(&|t| sign * (log(t) - level), t0, t1) * 1e6, sign > 0.0));
                reference = level;
                fired = true;
            }
            (before, l0) = (t0, l1);
        }
        let mut horizon_us = (horizon * 1e6).min(self.end_us as f64);
        while let Some((t, _)) = crossings.iter().rev().find(|(t, _)| (t - horizon_us).abs() < self.margin_us)
        {
            horizon_us = t - 1.001 * self.margin_us;
        }
        crossings.retain(|(t, _)| *t < horizon_us);
        Truth { crossings, horizon_us: horizon_us.max(0.0) }
    }
}

/// Where `f`, negative at `a` and not at `b`, becomes 0.
fn root(f: &dyn Fn(f64) -> f64, mut a: f64, mut b: f64) -> f64 {
    for _ in 0..60 {
        let middle = 0.5 * (a + b);
        *(if f(middle) < 0.0 { &mut a } else { &mut b }) = middle;
    }
    0.5 * (a + b)
}

/// Largest value of `f`, which has one peak in `[a, b]`.
fn peak(f: &dyn Fn(f64) -> f64, mut a: f64, mut b: f64) -> f64 {
    for _ in 0..60 {
        let (low, high) = (a + (b - a) / 3.0, b - (b - a) / 3.0);
        *(if f(low) < f(high) { &mut a } else { &mut b }) = if f(low) < f(high) { low } else { high };
    }
    f(0.5 * (a + b))
}

// ----------------------------------------------------------------------------------------------- the comparison

/// A stream held against the truth: per pixel, in order.
struct Comparison {
    /// Crossings that the truth has before the horizons.
    expected: usize,
    /// Events that came before them.
    got: usize,
    /// Pixels whose sequence of polarities differs.
    wrong_pixels: usize,
    /// Share of pixels times duration beyond the horizons.
    excluded: f64,
    /// Quantiles of |time error| in microseconds.
    median_us: f64,
    p95_us: f64,
    /// Mean time error.
    bias_us: f64,
}

/// What a comparison must keep to.
struct Limits {
    median_us: f64,
    p95_us: f64,
    excluded: f64,
}

fn by_pixel(events: &[Event], width: u32, height: u32) -> Vec<Vec<(i64, bool)>> {
    let mut pixels = vec![Vec::new(); (width * height) as usize];
    for e in events {
        pixels[usize::from(e.y) * width as usize + usize::from(e.x)].push((e.t, e.p == 1));
    }
    pixels
}

fn compare(events: &[Event], size: (u32, u32), truth: &[Truth], end_us: i64) -> Comparison {
    let (mut expected, mut got, mut wrong_pixels, mut errors) = (0, 0, 0, Vec::new());
    for (pixel, truth) in by_pixel(events, size.0, size.1).iter().zip(truth) {
        let count = pixel.partition_point(|(t, _)| (*t as f64) < truth.horizon_us);
        let fired = &pixel[..count];
        expected += truth.crossings.len();
        got += fired.len();
        if fired.iter().map(|e| e.1).eq(truth.crossings.iter().map(|c| c.1)) {
            // Times are floored to the microsecond.
            errors.extend(fired.iter().zip(&truth.crossings).map(|(e, c)| e.0 as f64 + 0.5 - c.0));
        } else {
            wrong_pixels += 1;
        }
    }
    let bias_us = errors.iter().sum::<f64>() / errors.len() as f64;
    let mut sizes: Vec<f64> = errors.iter().map(|e| e.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let quantile = |q: f64| sizes.get((q * sizes.len() as f64) as usize).copied().unwrap_or(f64::NAN);
    let included: f64 = truth.iter().map(|t| t.horizon_us).sum();
    Comparison {
        expected,
        got,
        wrong_pixels,
        excluded: 1.0 - included / (truth.len() as f64 * end_us as f64),
        median_us: quantile(0.5),
        p95_us: quantile(0.95),
        bias_us,
    }
}

impl Comparison {
    fn check(&self, limits: &Limits) -> Result<(), String> {
        let fault = if self.expected == 0 {
            "nothing was compared"
        } else if self.wrong_pixels > 0 || self.got != self.expected {
            "other events than the closed form's"
        } else if self.excluded >= limits.excluded {
            "too much is excluded"
        } else if self.median_us.is_nan() || self.median_us >= limits.median_us {
            "median time error"
        } else if self.p95_us.is_nan() || self.p95_us >= limits.p95_us {
            "95th percentile of the time error"
        } else {
            return Ok(());
        };
        Err(format!("{fault}: {self}"))
    }
}

impl std::fmt::Display for Comparison {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{} events of {}, {} wrong pixels, {:.1} % excluded, |error| median {:.1} us, p95 {:.1} us, bias {:+.1} us",
            self.got,
            self.expected,
            self.wrong_pixels,
            100.0 * self.excluded,
            self.median_us,
            self.p95_us,
            self.bias_us
        )
    }
}

// ---------------------------------------------------------------------------------------------- scenes and runs

/// How a screen moves: pixels per second along a direction, radians from x towards y (down).
#[derive(Clone, Copy, Debug)]
struct Drift {
    speed: f64,
    angle: f64,
}

impl Drift {
    /// Coordinate of an image point (from the principal point) along the drift, on the screen at `t` seconds.
    fn along(&self, x: f64, y: f64, t: f64) -> f64 {
        x * self.angle.cos() + y * self.angle.sin() - self.speed * t
    }

    fn placement(&self) -> Placement {
        let turn = DQuat::from_rotation_z(-self.angle);
        let start = Trs { translation: DVec3::new(0.0, 0.0, -1.0), rotation: turn, scale: DVec3::ONE };
        Placement::along(Path::ConstantVelocity { start, velocity: turn * DVec3::X * (self.speed / FOCAL) })
    }
}

/// A screen before a still camera: a strip of quads along local x with the given vertex positions (pixels), colours
/// and texture coordinates.
fn screen(size: (u32, u32), drift: Drift, image: Option<Image>, strips: &[(f64, f32, f32)]) -> Arc<Scene> {
    let mut builder = SceneBuilder::new("closed form");
    let mut material = Material::unlit("screen");
    if let Some(image) = image {
        let clamp = Sampling { wrap_u: Wrap::Clamp, wrap_v: Wrap::Clamp, nearest: false };
        material = material.textured(builder.texture(image, clamp).unwrap());
    }
    let material = builder.material(material).unwrap();
    let half_height = 2.0 * f64::from(size.0 + size.1) / FOCAL;
    let mut part = Primitive { material, ..Primitive::default() };
    let (mut uvs, mut colors) = (Vec::new(), Vec::new());
    for &(at, color, u) in strips {
        for y in [-half_height, half_height] {
            part.positions.push([(at / FOCAL) as f32, y as f32, 0.0]);
            part.normals.push([0.0, 0.0, 1.0]);
            colors.push([color, color, color, 1.0]);
            uvs.push([u, 0.5]);
        }
    }
    for i in 0..strips.len() as u32 - 1 {
        let [a, b, c, d] = [2 * i, 2 * i + 2, 2 * i + 3, 2 * i + 1];
        // Two vertices at one place part the colours of an edge.
        if strips[i as usize].0 < strips[i as usize + 1].0 {
            part.indices.extend([a, b, c, a, c, d]);
        }
    }
    part.colors = Some(colors);
    part.uvs[0] = Some(uvs);
    let mesh = builder.mesh(Mesh { primitives: vec![part], ..Mesh::default() }).unwrap();
    builder.object("screen", mesh, Labels::default(), drift.placement()).unwrap();
    finish(builder, size)
}

fn finish(mut builder: SceneBuilder, size: (u32, u32)) -> Arc<Scene> {
    let camera = EventCamera::new("camera").size(size.0, size.1);
    let center = [f64::from(size.0) / 2.0, f64::from(size.1) / 2.0];
    let camera = camera.intrinsics(FOCAL, FOCAL, center[0], center[1]);
    builder.camera(camera, Placement::default()).unwrap();
    let mut scene = builder.build().unwrap();
    scene.validate().unwrap();
    Arc::new(scene)
}

fn config(samples: u32) -> RunConfig {
    RunConfig { samples, reference_luminance: Some(REFERENCE), ..RunConfig::default() }
}

fn run(gpu: &Gpu, scene: &Arc<Scene>, config: RunConfig, end_us: i64) -> Vec<Event> {
    let mut simulator = Simulator::new(gpu, scene.clone(), config).unwrap();
    simulator.step(end_us).unwrap().views.remove(0).events
}

/// `ln(Y / Y_ref + eps)` with the sensor's own constants.
fn log_luma(luminance: f64) -> f64 {
    (luminance / f64::from(REFERENCE) + f64::from(SensorConfig::default().log_eps)).ln()
}

fn threshold() -> f64 {
    f64::from(SensorConfig::default().threshold_on)
}

/// Luminance at an image point (x, y from the image's centre in pixels) and a time in seconds.
type Form = Box<dyn Fn(f64, f64, f64) -> f64>;

/// The truth of every pixel, row by row. Rows along the drift are alike: one is solved for all.
fn truth(size: (u32, u32), drift: Drift, solve: Solve, luminance: &Form) -> Vec<Truth> {
    let from_center = |i: u32, n: u32| f64::from(i) + 0.5 - f64::from(n) / 2.0;
    let row = |y: u32| -> Vec<Truth> {
        let y = from_center(y, size.1);
        let pixel = |x| solve.truth(&|t| log_luma(luminance(from_center(x, size.0), y, t)));
        (0..size.0).map(pixel).collect()
    };
    if drift.angle == 0.0 {
        return vec![row(0); size.1 as usize].concat();
    }
    (0..size.1).flat_map(row).collect()
}

/// Mean of `f(x cos a + y sin a)` over the unit square about a point, from `f`'s first and second antiderivatives.
fn box_mean(first: &dyn Fn(f64) -> f64, second: &dyn Fn(f64) -> f64, angle: f64, s: f64) -> f64 {
    let (a, b) = (0.5 * angle.cos().abs(), 0.5 * angle.sin().abs());
    if b < 1e-9 {
        return first(s + a) - first(s - a);
    }
    (second(s + a + b) - second(s + a - b) - second(s - a + b) + second(s - a - b)) / (4.0 * a * b)
}

// ----------------------------------------------------------------------------------------------------- gratings

/// Over what a pixel takes its mean.
#[derive(Clone, Copy, PartialEq)]
enum Footprint {
    /// The pixel's area.
    Box,
    /// Its centre: what one sample is asked for.
    Point,
}

/// Luminance of the grating: `MEAN + SWING sin(2 pi s / period)`.
const MEAN: f64 = 0.5;
const SWING: f64 = 0.4;

fn sinc(x: f64) -> f64 {
    if x == 0.0 { 1.0 } else { x.sin() / x }
}

/// First and last coordinate along the drift that the image shows, pixels.
fn reach(size: (u32, u32), drift: Drift, end_us: i64) -> [f64; 2] {
    let half =
        0.5 * f64::from(size.0) * drift.angle.cos() + 0.5 * f64::from(size.1) * drift.angle.sin() + 2.0;
    [-half - drift.speed * end_us as f64 * 1e-6, half]
}

/// A sinusoid in vertex colours, and its closed form: linear interpolation between vertices and the pixel's box each
/// weaken the sinusoid by a known factor.
fn vertex_grating(
    size: (u32, u32),
    drift: Drift,
    period: f64,
    footprint: Footprint,
    end_us: i64,
) -> (Arc<Scene>, Form) {
    const PER_PERIOD: f64 = 256.0;
    let pitch = period / PER_PERIOD;
    let [from, to] = reach(size, drift, end_us).map(|s| (s / pitch).round() as i32);
    let strips: Vec<_> = (from..=to)
        .map(|k| {
            let value = MEAN + SWING * (TAU * f64::from(k) / PER_PERIOD).sin();
            (f64::from(k) * pitch, value as f32, 0.0)
        })
        .collect();
    let scene = screen(size, drift, None, &strips);
    let mut swing = SWING * sinc(PI / PER_PERIOD).powi(2);
    if footprint == Footprint::Box {
        swing *= sinc(PI * drift.angle.cos() / period) * sinc(PI * drift.angle.sin() / period);
    }
    let form = move |x: f64, y: f64, t: f64| MEAN + swing * (TAU * drift.along(x, y, t) / period).sin();
    (scene, Box::new(form))
}

/// A sinusoid in a texture, and the closed form of its bilinear interpolant: the texels are what they are in 16 bits.
fn texture_grating(
    size: (u32, u32),
    drift: Drift,
    period: f64,
    footprint: Footprint,
    end_us: i64,
) -> (Arc<Scene>, Form) {
    const PITCH: f64 = 1.5;
    let [from, to] = reach(size, drift, end_us).map(|s| (s / PITCH).round());
    let count = (to - from) as usize;
    // The centre of texel k.
    let place = move |k: usize| (from + k as f64 + 0.5) * PITCH;
    let texels: Vec<f16> =
        (0..count).map(|k| f16::from_f64(MEAN + SWING * (TAU * place(k) / period).sin())).collect();
    let image = Image {
        name: "grating".into(),
        width: count as u32,
        height: 1,
        texels: texels.iter().map(|&v| [v, v, v, f16::ONE]).collect(),
    };
    let scene = screen(size, drift, Some(image), &[(from * PITCH, 1.0, 0.0), (to * PITCH, 1.0, 1.0)]);
    let value: Vec<f64> = texels.iter().map(|v| v.to_f64()).collect();
    // First and second antiderivatives at the knots.
    let (mut first, mut second) = (vec![0.0; count], vec![0.0; count]);
    for k in 1..count {
        let (a, b) = (value[k - 1], value[k]);
        first[k] = first[k - 1] + PITCH * (a + b) / 2.0;
        second[k] = second[k - 1] + PITCH * first[k - 1] + PITCH * PITCH * (2.0 * a + b) / 6.0;
    }
    let find = move |s: f64| {
        let k = ((s - place(0)) / PITCH).floor().clamp(0.0, count as f64 - 2.0) as usize;
        (k, s - place(k))
    };
    let slope = move |value: &[f64], k: usize| (value[k + 1] - value[k]) / PITCH;
    let form = move |x: f64, y: f64, t: f64| {
        let s = drift.along(x, y, t);
        if footprint == Footprint::Point {
            let (k, d) = find(s);
            return value[k] + slope(&value, k) * d;
        }
        let first_at = |s: f64| {
            let (k, d) = find(s);
            first[k] + d * (value[k] + 0.5 * d * slope(&value, k))
        };
        let second_at = |s: f64| {
            let (k, d) = find(s);
            second[k] + d * (first[k] + d * (0.5 * value[k] + d * slope(&value, k) / 6.0))
        };
        box_mean(&first_at, &second_at, drift.angle, s)
    };
    (scene, Box::new(form))
}

/// Pixels per period of the gratings.
const PERIOD: f64 = 48.0;
/// 2 % of the sampling interval of 1 ms; nearly nothing excluded.
const SMOOTH: Limits = Limits { median_us: 20.0, p95_us: 150.0, excluded: 0.05 };
/// The band is what sampling an extremum at 1 kHz may miss of it.
const GRATING_BAND: f64 = 4e-3;

struct Grating {
    make: fn((u32, u32), Drift, f64, Footprint, i64) -> (Arc<Scene>, Form),
    drift: Drift,
    samples: u32,
    end_us: i64,
}

impl Grating {
    const SIZE: (u32, u32) = (48, 12);

    fn new(
        make: fn((u32, u32), Drift, f64, Footprint, i64) -> (Arc<Scene>, Form),
        speed: f64,
        samples: u32,
    ) -> Self {
        // The fastest also moves obliquely.
        let drift = Drift { speed, angle: if speed > 200.0 { f64::to_radians(30.0) } else { 0.0 } };
        Self { make, drift, samples, end_us: if speed > 200.0 { 150_000 } else { 300_000 } }
    }

    fn events(&self, gpu: &Gpu) -> Vec<Event> {
        let (scene, _) = (self.make)(Self::SIZE, self.drift, PERIOD, Footprint::Box, self.end_us);
        run(gpu, &scene, config(self.samples), self.end_us)
    }

    fn compare(&self, events: &[Event], footprint: Footprint, drift: Drift) -> Comparison {
        let (_, form) = (self.make)(Self::SIZE, drift, PERIOD, footprint, self.end_us);
        let solve =
            Solve { threshold: threshold(), end_us: self.end_us, band: GRATING_BAND, margin_us: 500.0 };
        compare(events, Self::SIZE, &truth(Self::SIZE, drift, solve, &form), self.end_us)
    }
}

#[test]
fn a_drifting_grating_fires_when_the_closed_form_does() {
    let Some(gpu) = device() else { return };
    let vertices = [(40.0, 4), (100.0, 1), (100.0, 4), (300.0, 4), (300.0, 16)];
    let texels = [40.0, 100.0, 300.0].into_iter().flat_map(|v| [1, 4, 16].map(|n| (v, n)));
    for (kind, make, cases) in [
        ("vertex colours", vertex_grating as fn(_, _, _, _, _) -> _, vertices.to_vec()),
        ("texture", texture_grating as fn(_, _, _, _, _) -> _, texels.collect()),
    ] {
        for (speed, samples) in cases {
            let grating = Grating::new(make, speed, samples);
            let events = grating.events(&gpu);
            let name = format!("grating, {kind}, {speed} px/s, {samples} samples");
            // One sample is asked for the pixel's centre; what it misses of the box is printed.
            let own = if samples == 1 { Footprint::Point } else { Footprint::Box };
            let got = grating.compare(&events, own, grating.drift);
            println!("{name}: {got}");
            got.check(&SMOOTH).unwrap_or_else(|e| panic!("{name}: {e}"));
            if samples == 1 {
                println!(
                    "{name} against the box: {}",
                    grating.compare(&events, Footprint::Box, grating.drift)
                );
            }
        }
    }
}

#[test]
fn a_wrong_stream_is_refused() {
    let Some(gpu) = device() else { return };
    let grating = Grating::new(texture_grating, 100.0, 4);
    let events = grating.events(&gpu);
    let check = |events: &[Event], drift| grating.compare(events, Footprint::Box, drift).check(&SMOOTH);
    check(&events, grating.drift).unwrap();
    let faster = Drift { speed: 1.01 * grating.drift.speed, ..grating.drift };
    println!("canary, 1 % too fast: {}", check(&events, faster).unwrap_err());
    let mut shifted = events.clone();
    shifted.iter_mut().for_each(|e| e.t += 30);
    println!("canary, 30 us late: {}", check(&shifted, grating.drift).unwrap_err());
    let mut missing = events.clone();
    missing.remove(events.len() / 2);
    println!("canary, one event missing: {}", check(&missing, grating.drift).unwrap_err());
    let mut flipped = events.clone();
    flipped[events.len() / 2].p ^= 1;
    println!("canary, one polarity wrong: {}", check(&flipped, grating.drift).unwrap_err());
    println!("canary, nothing at all: {}", check(&[], grating.drift).unwrap_err());
}

// ------------------------------------------------------------------------------------------------- the step edge

/// Two half-planes and the closed form: the pixel's area on either side.
fn step_edge(size: (u32, u32), drift: Drift, [left, right]: [f64; 2], start: f64) -> (Arc<Scene>, Form) {
    let far = 400.0;
    let [l, r] = [left as f32, right as f32];
    let scene = screen(size, drift, None, &[(-far, l, 0.0), (start, l, 0.0), (start, r, 0.0), (far, r, 0.0)]);
    let form = move |x: f64, y: f64, t: f64| {
        let s = drift.along(x, y, t) - start;
        let covered = box_mean(&|s| s.max(0.0), &|s| 0.5 * s.max(0.0).powi(2), drift.angle, s);
        left + (right - left) * covered
    };
    (scene, Box::new(form))
}

#[test]
fn a_step_edge_fires_where_the_closed_form_does() {
    let Some(gpu) = device() else { return };
    let size = (48, 12);
    for samples in [4, 16] {
        // Pixels of motion.
        let limit = if samples == 4 { 0.2 } else { 0.07 };
        for (speed, end_us) in [(37.0, 400_000), (100.0, 250_000), (230.0, 150_000)] {
            for degrees in [0.0, 20.0] {
                for light in [[0.3, 0.1], [0.05, 0.5]] {
                    let drift = Drift { speed, angle: f64::to_radians(degrees) };
                    let (scene, form) = step_edge(size, drift, light, -14.7);
                    let events = run(&gpu, &scene, config(samples), end_us);
                    // A pixel that the edge parts at the start or the end is judged by what it should fire before
                    // or after by more than the tolerance in time.
                    let solve =
                        Solve { threshold: threshold(), end_us, band: 4e-3, margin_us: 0.5e6 / speed };
                    let mut expected = truth(size, drift, solve, &form);
                    // The reference of a pixel that the edge parts at the start has the samples' own error.
                    for (i, pixel) in expected.iter_mut().enumerate() {
                        let (x, y) = (i as u32 % size.0, i as u32 / size.0);
                        let x = f64::from(x) + 0.5 - f64::from(size.0) / 2.0;
                        let y = f64::from(y) + 0.5 - f64::from(size.1) / 2.0;
                        let luminance = form(x, y, 0.0);
                        if light.iter().all(|l| (l - luminance).abs() > 1e-9) {
                            *pixel = Truth { crossings: Vec::new(), horizon_us: 0.0 };
                        }
                    }
                    let got = compare(&events, size, &expected, end_us);
                    let pixels = got.p95_us * 1e-6 * speed;
                    let name = format!("edge {light:?}, {speed} px/s, {degrees} deg, {samples} samples");
                    println!("{name}: p95 {pixels:.3} px; {got}");
                    let limits =
                        Limits { median_us: f64::INFINITY, p95_us: limit / speed * 1e6, excluded: 0.1 };
                    if let Err(e) = got.check(&limits) {
                        println!("FAIL {e}");
                    }
                }
            }
        }
    }
}
