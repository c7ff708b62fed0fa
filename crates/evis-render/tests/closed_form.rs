//! The product against closed forms. Drifting gratings, step edges under the box filter, flicker, and
//! motion vectors, each with the pixel's own integral in the formula. `-- --nocapture` prints the measured figures.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::f64::consts::{PI, TAU};
use std::sync::{Arc, OnceLock};

use evis_core::closed_form::{self, Flicker, FlickerShape, Footprint, PixelLight, Signal, Sinusoid};
use evis_core::{Event, LabelData, LabelKind, Polarity, SensorConfig, TriggerRule};
use evis_render::{Gpu, Interpolation, RunConfig, Simulator};
use evis_scene::builder::{EventCamera, Labels, Placement, Sampling, SceneBuilder};
use evis_scene::motion::{Curve, Path, WaveShape, Waveform};
use evis_scene::primitive::Shape;
use evis_scene::{
    Image, Material, Mesh, MorphTarget, Motion, Node, Primitive, Scene, Skin, TextureRef, Trs, Wrap,
};
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
    end_us: i64,
    /// Log units: an extremum this close to a threshold is undecided.
    band: f64,
    /// No crossing lies closer to the horizon than this.
    margin_us: f64,
}

impl Solve {
    fn truth(&self, light: &PixelLight) -> Truth {
        let [end_s, margin_s] = [self.end_us as f64, self.margin_us].map(|us| us * 1e-6);
        // Beyond the end too: what follows it closely might come before it.
        let sensor = SensorConfig::default();
        let solved = closed_form::solve(light, &sensor, f64::from(REFERENCE), end_s + margin_s).unwrap();
        let horizon_us = 1e6 * solved.horizon_s(end_s, self.band, margin_s);
        let crossings = solved.crossings.iter().map(|c| (c.t_s * 1e6, c.polarity == Polarity::On));
        Truth { crossings: crossings.filter(|c| c.0 < horizon_us).collect(), horizon_us }
    }
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
    /// |time error|, sorted.
    errors_us: Vec<f64>,
}

/// What a comparison must keep to.
struct Limits {
    median_us: f64,
    p95_us: f64,
    excluded: f64,
}

fn quantile(sorted: &[f64], q: f64) -> f64 {
    sorted.get((q * sorted.len() as f64) as usize).copied().unwrap_or(f64::NAN)
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
    let included: f64 = truth.iter().map(|t| t.horizon_us).sum();
    Comparison {
        expected,
        got,
        wrong_pixels,
        excluded: 1.0 - included / (truth.len() as f64 * end_us as f64),
        median_us: quantile(&sizes, 0.5),
        p95_us: quantile(&sizes, 0.95),
        bias_us,
        errors_us: sizes,
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
fn log_luminance(luminance: f64) -> f64 {
    (luminance / f64::from(REFERENCE) + f64::from(SensorConfig::default().log_eps)).ln()
}

/// Light of the pixel about an image point (x, y from the image's centre in pixels).
type Form = Box<dyn Fn(f64, f64) -> PixelLight>;

/// Centre of pixel `i` of `n`, from the image's.
fn from_center(i: u32, n: u32) -> f64 {
    f64::from(i) + 0.5 - f64::from(n) / 2.0
}

/// The truth of every pixel, row by row. Rows along the drift are alike: one is solved for all.
fn truth(size: (u32, u32), drift: Drift, solve: Solve, form: &Form) -> Vec<Truth> {
    let row = |y: u32| -> Vec<Truth> {
        let y = from_center(y, size.1);
        (0..size.0).map(|x| solve.truth(&form(from_center(x, size.0), y))).collect()
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

/// Luminance of the grating: `MEAN + SWING sin(2 pi s / period)`.
const MEAN: f64 = 0.5;
const SWING: f64 = 0.4;

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
    let weaker = PI / PER_PERIOD;
    let wave = Sinusoid {
        mean: MEAN,
        swing: SWING * (weaker.sin() / weaker).powi(2),
        cycles_per_px: [drift.angle.cos() / period, drift.angle.sin() / period],
        frequency_hz: drift.speed / period,
        phase_radians: 0.0,
        footprint,
    };
    (scene, Box::new(move |x, y| wave.pixel(x, y)))
}

/// Pixels per texel.
const PITCH: f64 = 1.5;

/// A sinusoid in a texture, and the closed form of its bilinear interpolant: the texels are what they are in 16 bits.
fn texture_grating(
    size: (u32, u32),
    drift: Drift,
    period: f64,
    footprint: Footprint,
    end_us: i64,
) -> (Arc<Scene>, Form) {
    texture_grating_read_at(&[0.0], size, drift, period, footprint, end_us)
}

/// The same, for one sample: it stands for two thirds of a texel of the whole pixel, and reads it at two places.
fn texture_grating_read_twice(
    size: (u32, u32),
    drift: Drift,
    period: f64,
    footprint: Footprint,
    end_us: i64,
) -> (Arc<Scene>, Form) {
    texture_grating_read_at(&[-0.25, 0.25], size, drift, period, footprint, end_us)
}

/// A point is read at `places` along the picture's rows, in pixels from it.
fn texture_grating_read_at(
    places: &'static [f64],
    size: (u32, u32),
    drift: Drift,
    period: f64,
    footprint: Footprint,
    end_us: i64,
) -> (Arc<Scene>, Form) {
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
    let texels = Texels::new(place, texels.iter().map(|v| v.to_f64()).collect());
    let angle = drift.angle;
    let box_of = move |f: [&dyn Fn(f64) -> f64; 2], s| box_mean(f[0], f[1], angle, s);
    let read = move |f: &dyn Fn(f64) -> f64, s: f64| {
        places.iter().map(|place| f(s + place * angle.cos())).sum::<f64>() / places.len() as f64
    };
    let mean = move |texels: &Texels, s: f64| match footprint {
        Footprint::Point => read(&|s| texels.at(s)[0], s),
        Footprint::Box => box_of([&|s| texels.at(s)[1], &|s| texels.at(s)[2]], s),
    };
    let slope = |s: f64| match footprint {
        Footprint::Point => read(&|s| texels.slope(s), s),
        Footprint::Box => box_of([&|s| texels.at(s)[0], &|s| texels.at(s)[1]], s),
    };
    // A mean of the slopes of at most three neighbours: it changes its sign once where theirs does.
    let middle = |k: usize| place(k) + 0.5 * PITCH;
    let turns: Vec<f64> = (1..count - 2)
        .map(|k| (middle(k - 1), middle(k)))
        .filter(|&(a, b)| (slope(a) < 0.0) != (slope(b) < 0.0))
        .map(|(a, b)| sign_change(&slope, a, b))
        .collect();
    let form = move |x: f64, y: f64| {
        let mut turns_s: Vec<f64> =
            turns.iter().map(|s| (drift.along(x, y, 0.0) - s) / drift.speed).collect();
        turns_s.sort_by(f64::total_cmp);
        let texels = texels.clone();
        let light = Arc::new(move |t| mean(&texels, drift.along(x, y, t)));
        PixelLight::Function { light, turns_s: turns_s.into() }
    };
    (scene, Box::new(form))
}

/// The linear interpolant of texels from `from` on, with its antiderivatives.
#[derive(Clone)]
struct Texels {
    from: f64,
    /// Value and first and second antiderivative at each texel.
    knots: Arc<[[f64; 3]]>,
}

impl Texels {
    fn new(place: impl Fn(usize) -> f64, value: Vec<f64>) -> Self {
        let mut knots = vec![[value[0], 0.0, 0.0]];
        for (k, pair) in value.windows(2).enumerate() {
            let ([_, first, second], [a, b]) = (knots[k], [pair[0], pair[1]]);
            let next = second + PITCH * first + PITCH * PITCH * (2.0 * a + b) / 6.0;
            knots.push([b, first + PITCH * (a + b) / 2.0, next]);
        }
        Self { from: place(0), knots: knots.into() }
    }

    fn find(&self, s: f64) -> usize {
        ((s - self.from) / PITCH).floor().clamp(0.0, self.knots.len() as f64 - 2.0) as usize
    }

    fn slope(&self, s: f64) -> f64 {
        let k = self.find(s);
        (self.knots[k + 1][0] - self.knots[k][0]) / PITCH
    }

    fn at(&self, s: f64) -> [f64; 3] {
        let (k, slope) = (self.find(s), self.slope(s));
        let ([value, first, second], d) = (self.knots[k], s - self.from - k as f64 * PITCH);
        [
            value + slope * d,
            first + d * (value + 0.5 * d * slope),
            second + d * (first + d * (0.5 * value + d * slope / 6.0)),
        ]
    }
}

/// Where `f` changes its sign between `a` and `b`.
fn sign_change(f: &dyn Fn(f64) -> f64, mut a: f64, mut b: f64) -> f64 {
    let negative = f(a) < 0.0;
    for _ in 0..60 {
        let middle = 0.5 * (a + b);
        *(if (f(middle) < 0.0) == negative { &mut a } else { &mut b }) = middle;
    }
    0.5 * (a + b)
}

/// Pixels per period of the gratings.
const PERIOD: f64 = 48.0;
/// 2 % of the sampling interval of 1 ms; nearly nothing excluded.
const SMOOTH: Limits = Limits { median_us: 20.0, p95_us: 150.0, excluded: 0.05 };
/// The band is what sampling an extremum at 1 kHz may miss of it.
const GRATING_BAND: f64 = 4e-3;

/// Scene and closed form of a grating: image size, drift, period, footprint, end.
type Make = fn((u32, u32), Drift, f64, Footprint, i64) -> (Arc<Scene>, Form);

struct Grating {
    make: Make,
    drift: Drift,
    samples: u32,
    end_us: i64,
}

impl Grating {
    const SIZE: (u32, u32) = (48, 12);

    fn new(make: Make, speed: f64, samples: u32) -> Self {
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
        let solve = Solve { end_us: self.end_us, band: GRATING_BAND, margin_us: 500.0 };
        compare(events, Self::SIZE, &truth(Self::SIZE, drift, solve, &form), self.end_us)
    }
}

#[test]
fn a_drifting_grating_fires_when_the_closed_form_does() {
    let Some(gpu) = device() else { return };
    let vertices = [(40.0, 4), (100.0, 1), (100.0, 4), (300.0, 4), (300.0, 16)];
    let speeds = [40.0, 100.0, 300.0];
    let texels = speeds.into_iter().flat_map(|v| [4, 16].map(|n| (v, n)));
    for (kind, make, cases) in [
        ("vertex colours", vertex_grating as Make, vertices.to_vec()),
        ("texture", texture_grating as Make, texels.collect()),
        ("texture", texture_grating_read_twice as Make, speeds.map(|v| (v, 1)).to_vec()),
    ] {
        for (speed, samples) in cases {
            let grating = Grating::new(make, speed, samples);
            let events = grating.events(&gpu);
            let name = format!("grating, {kind}, {speed} px/s, {samples} samples");
            // One sample is asked for the pixel's centre, or reads near it; what it misses of the box is printed.
            let own = if samples == 1 { Footprint::Point } else { Footprint::Box };
            let got = grating.compare(&events, own, grating.drift);
            println!("{name}: {got}");
            got.check(&SMOOTH).unwrap_or_else(|e| panic!("{name}: {e}"));
            if matches!(own, Footprint::Point) {
                println!(
                    "{name} against the box: {}",
                    grating.compare(&events, Footprint::Box, grating.drift)
                );
            }
        }
    }
}

#[test]
fn curves_between_samples_are_nearer_to_a_grating_than_lines() {
    let Some(gpu) = device() else { return };
    let grating = Grating::new(vertex_grating, 300.0, 16);
    let (scene, form) = (grating.make)(Grating::SIZE, grating.drift, PERIOD, Footprint::Box, grating.end_us);
    // Four milliseconds from sample to sample, four samples in a block: what they may miss of an extremum is more.
    let solve = Solve { end_us: grating.end_us, band: 0.05, margin_us: 2_000.0 };
    let truth = truth(Grating::SIZE, grating.drift, solve, &form);
    let [line, curve] = [Interpolation::Line, Interpolation::Curve].map(|between| {
        let config = RunConfig { adaptive_px: Some(1.3), between, ..config(grating.samples) };
        let events = run(&gpu, &scene, config, grating.end_us);
        let got = compare(&events, Grating::SIZE, &truth, grating.end_us);
        println!("grating, 4 ms from sample to sample, {between:?}: {got}");
        got
    });
    assert!(curve.expected > 1000 && curve.wrong_pixels <= line.wrong_pixels, "{curve}");
    assert!(curve.median_us < 0.2 * line.median_us, "{} and {} us", curve.median_us, line.median_us);
    assert!(curve.p95_us < 0.5 * line.p95_us, "{} and {} us", curve.p95_us, line.p95_us);
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
    let edge = closed_form::Edge {
        light_behind: left,
        light_ahead: right,
        angle_radians: drift.angle,
        position_px: start,
        speed_px_per_s: drift.speed,
    };
    (scene, Box::new(move |x, y| edge.pixel(x, y)))
}

struct Edge {
    speed: f64,
    degrees: f64,
    light: [f64; 2],
    samples: u32,
    rate_hz: f64,
}

impl Edge {
    /// Against the closed form, after `late_us` was added to every event.
    fn compare(&self, gpu: &Gpu, late_us: i64) -> Comparison {
        let size = (48, 12);
        let end_us = (33.3e6 / self.speed).round().min(300_000.0) as i64;
        let drift = Drift { speed: self.speed, angle: self.degrees.to_radians() };
        let (scene, form) = step_edge(size, drift, self.light, -14.7);
        let config = RunConfig { rate_hz: self.rate_hz, ..config(self.samples) };
        let mut events = run(gpu, &scene, config, end_us);
        events.iter_mut().for_each(|e| e.t += late_us);
        let solve = Solve { end_us, band: 4e-3, margin_us: 0.5e6 / self.speed };
        let mut expected = truth(size, drift, solve, &form);
        // A pixel that the edge parts at the start measures everything from a reference with the samples' error.
        for (i, pixel) in expected.iter_mut().enumerate() {
            let i = i as u32;
            let light = form(from_center(i % size.0, size.0), from_center(i / size.0, size.1));
            let luminance = light.luminance(0.0);
            if self.light.iter().all(|l| (l - luminance).abs() > 1e-9) {
                *pixel = Truth { crossings: Vec::new(), horizon_us: 0.0 };
            }
        }
        compare(&events, size, &expected, end_us)
    }

    /// Holds it to `p95_px`, the 95th percentile in pixels of motion; returns all errors in pixels.
    fn check(&self, gpu: &Gpu, p95_px: f64) -> Vec<f64> {
        let Self { speed, degrees, light, samples, rate_hz } = self;
        let got = self.compare(gpu, 0);
        let px = 1e-6 * speed;
        let name = format!("edge {light:?}, {speed} px/s, {degrees} deg, {samples} samples, {rate_hz} Hz");
        println!("{name}: median {:.3} px, p95 {:.3} px; {got}", got.median_us * px, got.p95_us * px);
        let limits = Limits { median_us: f64::INFINITY, p95_us: p95_px / px, excluded: 0.05 };
        got.check(&limits).unwrap_or_else(|e| panic!("{name}: {e}"));
        got.errors_us.iter().map(|e| e * px).collect()
    }
}

#[test]
fn a_step_edge_fires_where_the_closed_form_does() {
    let Some(gpu) = device() else { return };
    for samples in [4, 16] {
        let limit = if samples == 4 { 0.2 } else { 0.07 };
        // Equal samples meet an oblique edge in uneven steps: 0.19 px with 4 and 0.075 px with 16, on the average of
        // all directions, is the best that a search found any pattern to do.
        let oblique_limit = if samples == 4 { 0.2 } else { 0.12 };
        let mut all = Vec::new();
        for speed in [37.0, 100.0, 230.0] {
            for light in [[0.3, 0.1], [0.05, 0.5]] {
                // Between instants the logarithm is taken as straight: 0.23 px of motion each is too much of a
                // 1:10 edge for what 16 samples see.
                let rate_hz = if speed > 200.0 && samples == 16 { 2000.0 } else { 1000.0 };
                for (degrees, limit) in [(0.0, limit), (20.0, oblique_limit)] {
                    let edge = Edge { speed, degrees, light, samples, rate_hz };
                    all.extend(edge.check(&gpu, limit));
                }
            }
        }
        all.sort_by(f64::total_cmp);
        let [median, p95] = [0.5, 0.95].map(|q| quantile(&all, q));
        println!("edges, {samples} samples, all {}: median {median:.3} px, p95 {p95:.3} px", all.len());
        assert!(p95 < limit, "{samples} samples: {p95} px");
    }
    // What the straight line between instants costs; printed, and no more than coarsely bounded.
    let fast = Edge { speed: 230.0, degrees: 0.0, light: [0.05, 0.5], samples: 16, rate_hz: 1000.0 };
    fast.check(&gpu, 0.12);
    // Canary: 0.06 px late.
    let edge = Edge { speed: 100.0, light: [0.3, 0.1], ..fast };
    let limits = Limits { median_us: f64::INFINITY, p95_us: 700.0, excluded: 0.05 };
    println!("canary, edge 600 us late: {}", edge.compare(&gpu, 600).check(&limits).unwrap_err());
}

// ------------------------------------------------------------------------------------------------------- flicker

fn flicker_scene(waveform: Waveform) -> Arc<Scene> {
    let mut builder = SceneBuilder::new("flicker");
    let material =
        Material { emission_waveform: Some(waveform), ..Material::unlit("lamp").colored([0.6; 3]) };
    let material = builder.material(material).unwrap();
    builder
        .shape("lamp", Shape::Card { size: [4.0, 4.0] }, material, Placement::at([0.0, 0.0, -1.0]))
        .unwrap();
    finish(builder, (8, 4))
}

/// The trigger in f64 on a signal that is known at the instants only; also how close a decision came to a tie.
fn sampled_truth(sensor: &SensorConfig, instants: &[(i64, f64)]) -> (Vec<(i64, bool)>, f64) {
    let (mut events, mut closest) = (Vec::new(), f64::INFINITY);
    let mut reference = instants[0].1;
    for pair in instants.windows(2) {
        let [(t0, l0), (t1, l1)] = [pair[0], pair[1]];
        let (sign, threshold) = if l1 >= reference {
            (1.0, f64::from(sensor.threshold_on))
        } else {
            (-1.0, f64::from(sensor.threshold_off))
        };
        let steps = sign * (l1 - reference) / threshold;
        if steps > 0.5 {
            closest = closest.min((steps - steps.round()).abs() * threshold);
        }
        if steps < 1.0 {
            continue;
        }
        if sensor.trigger == TriggerRule::Latch {
            events.push((t1, sign > 0.0));
            reference = l1;
            continue;
        }
        for k in 1..=steps.floor() as i32 {
            let level = reference + sign * threshold * f64::from(k);
            let fraction = ((level - l0) / (l1 - l0)).clamp(0.0, 1.0);
            events.push((t0 + (fraction * (t1 - t0) as f64).floor() as i64, sign > 0.0));
        }
        reference += sign * threshold * steps.floor();
    }
    (events, closest)
}

/// Same count and polarities, times within a microsecond.
fn same_events(got: &[(i64, bool)], expected: &[(i64, bool)]) -> bool {
    got.len() == expected.len() && got.iter().zip(expected).all(|(a, b)| a.1 == b.1 && (a.0 - b.0).abs() <= 1)
}

#[test]
fn flicker_fires_as_its_waveform_says() {
    let Some(gpu) = device() else { return };
    let end_us = 200_000;
    // No jump falls on an instant.
    let phase = 0.105;
    for (wave, shape, frequency_hz) in [
        (WaveShape::Sine, FlickerShape::Sine, 23.0),
        (WaveShape::Square, FlickerShape::Square, 70.0),
        (WaveShape::Pwm { duty: 0.3 }, FlickerShape::Pwm { duty: 0.3 }, 110.0),
    ] {
        let waveform = Waveform { shape: wave, frequency_hz, phase, low: 0.25, high: 1.75 };
        let flicker = Flicker { shape, mean: 0.6, depth: 0.75, frequency_hz, phase_cycles: phase };
        let (name, light) = (flicker.name(), flicker.pixel(0.5, 0.5));
        let scene = flicker_scene(waveform);
        for rule in [TriggerRule::Crossing, TriggerRule::Latch] {
            // With equal thresholds a signal that returns meets its first threshold exactly: a tie, decided by
            // rounding. These two have no small multiple in common.
            let sensor = SensorConfig { trigger: rule, threshold_off: 0.2317, ..SensorConfig::default() };
            let events = run(&gpu, &scene, RunConfig { sensor: sensor.clone(), ..config(4) }, end_us);
            let instants: Vec<_> = (0..=end_us / 1000)
                .map(|k| (k * 1000, log_luminance(light.luminance(k as f64 * 1e-3))))
                .collect();
            let (mut expected, closest) = sampled_truth(&sensor, &instants);
            expected.retain(|e| e.0 < end_us);
            println!("{name}, {rule:?}: {} events per pixel, closest tie {closest:.1e}", expected.len());
            assert!(expected.len() > 20 && closest > 1e-5, "{closest}");
            for pixel in by_pixel(&events, 8, 4) {
                assert!(same_events(&pixel, &expected), "{name} {rule:?}:\n{pixel:?}\n{expected:?}");
            }
            // Canaries.
            assert!(!same_events(&expected[1..], &expected), "a missing event must be seen");
            let late: Vec<_> = expected.iter().map(|e| (e.0 + 2, e.1)).collect();
            assert!(!same_events(&late, &expected), "two microseconds must be seen");
        }
    }
    // A sine that is slow for its sampling also meets the continuous closed form.
    let waveform = Waveform { shape: WaveShape::Sine, frequency_hz: 8.0, phase: 0.1, low: 0.4, high: 1.6 };
    let events = run(&gpu, &flicker_scene(waveform), config(1), end_us);
    let solve = Solve { end_us, band: GRATING_BAND, margin_us: 500.0 };
    let flicker =
        Flicker { shape: FlickerShape::Sine, mean: 0.6, depth: 0.6, frequency_hz: 8.0, phase_cycles: 0.1 };
    let form: Form = Box::new(move |x, y| flicker.pixel(x, y));
    let expected = truth((8, 4), Drift { speed: 0.0, angle: 0.0 }, solve, &form);
    let got = compare(&events, (8, 4), &expected, end_us);
    println!("flicker, sine of 8 Hz, continuous: {got}");
    got.check(&SMOOTH).unwrap();
}

// ---------------------------------------------------------------------------------------------------------- frames

/// Mean of `light` over `[start_s, start_s + length_s]`, in 20 000 parts.
fn mean(light: &PixelLight, start_s: f64, length_s: f64) -> f64 {
    let at = |part: u32| light.luminance(start_s + (f64::from(part) + 0.5) / 20_000.0 * length_s);
    (0..20_000).map(at).sum::<f64>() / 20_000.0
}

#[test]
fn frames_are_the_mean_of_light_over_their_exposure() {
    let Some(gpu) = device() else { return };
    let waveform = Waveform { shape: WaveShape::Sine, frequency_hz: 40.0, phase: 0.1, low: 0.25, high: 1.75 };
    let flicker =
        Flicker { shape: FlickerShape::Sine, mean: 0.6, depth: 0.75, frequency_hz: 40.0, phase_cycles: 0.1 };
    let flickers: Form = Box::new(move |x, y| flicker.pixel(x, y));
    let drift = Drift { speed: 400.0, angle: 0.0 };
    let size = (24, 4);
    let (edge, edges) = step_edge(size, drift, [0.9, 0.1], -5.3);
    // An edge comes in steps of a sixteenth of a pixel, by 16 samples.
    for (scene, form, size, limit) in
        [(flicker_scene(waveform), flickers, (8, 4), 5e-4), (edge, edges, size, 0.02)]
    {
        let config =
            RunConfig { rate_hz: 6_400.0, frame_rate_hz: Some(50.0), exposure_us: 10_000, ..config(16) };
        let mut simulator = Simulator::new(&gpu, scene.clone(), config).unwrap();
        let frames = simulator.step(30_000).unwrap().views.remove(0).labels;
        assert_eq!(
            frames.iter().map(|f| (f.t_other_us, f.t_us)).collect::<Vec<_>>(),
            [(0, 5_000), (20_000, 25_000)]
        );
        // Greatest error of both frames, if they were exposed for `length_s`.
        let error = |length_s: f64| {
            let mut most = 0.0_f64;
            for frame in &frames {
                let LabelData::F32(got) = &frame.data else { panic!("{frame:?}") };
                for (i, got) in (0..).zip(got) {
                    let (x, y) = (from_center(i % size.0, size.0), from_center(i / size.0, size.1));
                    let expected = mean(&form(x, y), frame.t_other_us as f64 * 1e-6, length_s);
                    most = most.max((f64::from(*got) - expected).abs());
                }
            }
            most
        };
        println!("frames: {:.1e}", error(0.01));
        assert!(error(0.01) < limit, "{}", error(0.01));
        assert!(error(0.008) > 3.0 * limit, "canary, a shorter exposure: {}", error(0.008));
    }
}

// ------------------------------------------------------------------------------------------------ motion vectors

/// A rigid motion, in formulas of its own.
#[derive(Clone, Copy)]
struct Rigid {
    start: DVec3,
    velocity: DVec3,
    axis: DVec3,
    rate: f64,
}

impl Rigid {
    fn path(&self) -> Path {
        Path::Ballistic {
            start: Trs { translation: self.start, ..Trs::default() },
            velocity: self.velocity,
            gravity: DVec3::ZERO,
            spin_axis: self.axis,
            spin_rate: self.rate,
            launch_s: 0.0,
        }
    }

    /// Rodrigues' rotation formula.
    fn turn(&self, p: DVec3, angle: f64) -> DVec3 {
        let (sine, cosine) = angle.sin_cos();
        p * cosine + self.axis.cross(p) * sine + self.axis * (self.axis.dot(p) * (1.0 - cosine))
    }

    fn world(&self, p: DVec3, t: f64) -> DVec3 {
        self.turn(p, self.rate * t) + self.start + self.velocity * t
    }

    fn local(&self, p: DVec3, t: f64) -> DVec3 {
        self.turn(p - self.start - self.velocity * t, -self.rate * t)
    }
}

const FLOW_SIZE: (u32, u32) = (80, 60);
const BODY: Rigid = Rigid {
    start: DVec3::new(-0.02, 0.01, -1.0),
    velocity: DVec3::new(0.4, -0.25, 0.6),
    axis: DVec3::new(0.48, 0.6, 0.64),
    rate: 7.0,
};
const EYE: Rigid = Rigid {
    start: DVec3::new(0.0, 0.0, 0.0),
    velocity: DVec3::new(-0.2, 0.3, -0.4),
    axis: DVec3::new(0.0, 0.8, 0.6),
    rate: 1.5,
};
/// The second joint: its rest is to the right of the first.
const JOINT: Rigid = Rigid {
    start: DVec3::new(0.06, 0.0, -1.05),
    velocity: DVec3::new(0.1, 0.5, -0.3),
    axis: DVec3::new(0.0, 0.6, -0.8),
    rate: -9.0,
};
const JOINT_REST: DVec3 = DVec3::new(0.08, 0.0, 0.0);

/// Grid of so many cells along each edge.
const CELLS: usize = 6;

/// A card of 0.2 by 0.15 metres, skinned, morphing or both; `at` gives its vertices in the world.
struct Card {
    skinned: bool,
    morphing: bool,
}

impl Card {
    fn rest() -> Vec<DVec3> {
        let part = |k: usize| k as f64 / CELLS as f64 - 0.5;
        (0..(CELLS + 1) * (CELLS + 1))
            .map(|i| DVec3::new(0.2 * part(i % (CELLS + 1)), 0.15 * part(i / (CELLS + 1)), 0.0))
            .collect()
    }

    fn triangles() -> Vec<[usize; 3]> {
        let row = CELLS + 1;
        (0..CELLS * CELLS)
            .map(|i| i % CELLS + i / CELLS * row)
            .flat_map(|a| [[a, a + 1, a + row + 1], [a, a + row + 1, a + row]])
            .collect()
    }

    fn deltas(p: DVec3) -> [DVec3; 2] {
        [DVec3::Z * (0.03 - 3.0 * p.length_squared()), DVec3::new(0.3 * p.y, 0.2 * p.x, 0.4 * p.x)]
    }

    /// Share of the second joint.
    fn share(p: DVec3) -> f64 {
        (p.x / 0.2 + 0.5).clamp(0.0, 1.0)
    }

    fn scene(&self) -> Arc<Scene> {
        let mut scene = Scene::default();
        let texels = (0..64).map(|i| [f16::from_f64(f64::from((i + i / 8) % 2)); 4]).collect();
        scene.images.push(Image { name: "checks".into(), width: 8, height: 8, texels });
        scene.textures.push(evis_scene::Texture::new(0));
        scene.materials.push(Material {
            base_color_texture: Some(TextureRef::new(0)),
            double_sided: true,
            ..Material::unlit("card")
        });
        let rest = Self::rest();
        let f32s = |p: DVec3| p.as_vec3().to_array();
        let mut part = Primitive {
            positions: rest.iter().copied().map(f32s).collect(),
            normals: vec![[0.0, 0.0, 1.0]; rest.len()],
            uvs: [
                Some(rest.iter().map(|p| [(p.x * 5.0 + 0.5) as f32, (0.5 - p.y * 6.0) as f32]).collect()),
                None,
            ],
            indices: Self::triangles().concat().into_iter().map(|i| i as u32).collect(),
            ..Primitive::default()
        };
        if self.morphing {
            part.morph_targets = (0..2)
                .map(|k| MorphTarget {
                    positions: rest.iter().map(|&p| f32s(Self::deltas(p)[k])).collect(),
                    normals: vec![[0.0; 3]; rest.len()],
                })
                .collect();
        }
        if self.skinned {
            part.joints = Some(vec![[0, 1, 0, 0]; rest.len()]);
            let weights = |&p: &DVec3| [(1.0 - Self::share(p)) as f32, Self::share(p) as f32, 0.0, 0.0];
            part.joint_weights = Some(rest.iter().map(weights).collect());
        }
        let morph_weights = if self.morphing { vec![0.0; 2] } else { Vec::new() };
        scene.meshes.push(Mesh { name: "card".into(), primitives: vec![part], morph_weights });
        let moving = |rigid: Rigid| Motion::Path(Arc::new(rigid.path()));
        // Straight from (0, 1) to (1, -0.5) in a tenth of a second.
        let morph = self.morphing.then(|| Curve {
            times: vec![0.0, 0.1],
            values: vec![0.0, 1.0, 1.0, -0.5],
            width: 2,
            interpolation: evis_scene::motion::Interpolation::Linear,
        });
        let node =
            Node { name: "card".into(), motion: moving(BODY), mesh: Some(0), morph, ..Node::default() };
        let node = scene.add_node(node);
        if self.skinned {
            let joints = [BODY, JOINT].map(|j| scene.add_node(Node { motion: moving(j), ..Node::default() }));
            let inverse_bind = vec![DMat4::IDENTITY, DMat4::from_translation(-JOINT_REST)];
            scene.skins.push(Skin { joints: joints.to_vec(), inverse_bind });
            scene.nodes[node].skin = Some(0);
        }
        let camera = scene.add_node(Node { motion: moving(EYE), ..Node::default() });
        let (w, h) = FLOW_SIZE;
        let lens = evis_scene::Lens::Intrinsics { fx: FOCAL, fy: 250.0, cx: 37.0, cy: 31.5 };
        scene.cameras.push(evis_scene::Camera {
            width: Some(w),
            height: Some(h),
            near: 0.05,
            ..evis_scene::Camera::new("camera", camera, lens)
        });
        scene.validate().unwrap();
        Arc::new(scene)
    }

    /// Vertices before the camera at `t`.
    fn seen(&self, t: f64) -> Vec<DVec3> {
        let weights = [10.0 * t, 1.0 - 15.0 * t];
        Self::rest()
            .into_iter()
            .map(|rest| {
                let [a, b] = Self::deltas(rest);
                let p = if self.morphing { rest + a * weights[0] + b * weights[1] } else { rest };
                let world = if self.skinned {
                    let share = Self::share(rest);
                    BODY.world(p, t) * (1.0 - share) + JOINT.world(p - JOINT_REST, t) * share
                } else {
                    BODY.world(p, t)
                };
                EYE.local(world, t)
            })
            .collect()
    }

    /// What is seen through an image point at `t`, where it is at `other`, in pixels; whether it is the card.
    fn moved(&self, x: f64, y: f64, here: &[DVec3], there: &[DVec3], t: f64, other: f64) -> ([f64; 2], bool) {
        let ray = DVec3::new((x - 37.0) / FOCAL, -(y - 31.5) / 250.0, -1.0);
        let nearest = Self::triangles()
            .into_iter()
            .filter_map(|[a, b, c]| {
                // Moeller and Trumbore, from the camera's centre.
                let (e1, e2) = (here[b] - here[a], here[c] - here[a]);
                let p = ray.cross(e2);
                let q = (-here[a]).cross(e1);
                let u = (-here[a]).dot(p) / e1.dot(p);
                let v = ray.dot(q) / e1.dot(p);
                let distance = e2.dot(q) / e1.dot(p);
                let inside = u >= 0.0 && v >= 0.0 && u + v <= 1.0 && distance > 0.0;
                let point = there[a] + (there[b] - there[a]) * u + (there[c] - there[a]) * v;
                inside.then_some((distance, point))
            })
            .min_by(|a, b| a.0.total_cmp(&b.0));
        // The sky turns with the camera.
        let sky = EYE.turn(EYE.turn(ray, EYE.rate * t), -EYE.rate * other);
        let point = nearest.map_or(sky, |n| n.1);
        let pixel = [37.0 + FOCAL * point.x / -point.z, 31.5 - 250.0 * point.y / -point.z];
        (pixel, nearest.is_some())
    }
}

/// Largest difference in pixels between a flow label and the formula, over (card, sky); pixels compared and skipped.
fn flow_error(card: &Card, flow: &[f32], valid: &[u8], t: f64, other: f64) -> ([f64; 2], [usize; 2], usize) {
    let (here, there) = (card.seen(t), card.seen(other));
    let (mut worst, mut compared, mut skipped) = ([0.0_f64; 2], [0; 2], 0);
    for i in 0..(FLOW_SIZE.0 * FLOW_SIZE.1) as usize {
        let x = (i % FLOW_SIZE.0 as usize) as f64 + 0.5;
        let y = (i / FLOW_SIZE.0 as usize) as f64 + 0.5;
        let at = |dx, dy| card.moved(x + dx, y + dy, &here, &there, t, other);
        let (expected, hit) = at(0.0, 0.0);
        // At a silhouette, coverage is decided on a grid of 1/256 px.
        if [(0.01, 0.0), (-0.01, 0.0), (0.0, 0.01), (0.0, -0.01)].iter().any(|d| at(d.0, d.1).1 != hit) {
            skipped += 1;
            continue;
        }
        assert_eq!(valid[i], 1, "pixel {x}, {y}");
        let error = (f64::from(flow[2 * i]) - (expected[0] - x))
            .hypot(f64::from(flow[2 * i + 1]) - (expected[1] - y));
        let class = usize::from(!hit);
        worst[class] = worst[class].max(error);
        compared[class] += 1;
    }
    (worst, compared, skipped)
}

#[test]
fn motion_vectors_equal_the_projection_of_the_moved_points() {
    let Some(gpu) = device() else { return };
    for (name, card) in [
        ("rigid", Card { skinned: false, morphing: false }),
        ("skinned", Card { skinned: true, morphing: false }),
        ("morphing", Card { skinned: false, morphing: true }),
        ("skinned and morphing", Card { skinned: true, morphing: true }),
    ] {
        use LabelKind::{FlowBackward, FlowBackwardValid, FlowForward, FlowForwardValid};
        let labels = vec![FlowForward, FlowForwardValid, FlowBackward, FlowBackwardValid];
        let config = RunConfig { labels, rate_hz: 100.0, ..config(1) };
        let mut simulator = Simulator::new(&gpu, card.scene(), config).unwrap();
        let packet = simulator.step(50_000).unwrap();
        let find = |kind: LabelKind| {
            packet.views[0].labels.iter().find(|l| l.kind == kind && l.t_us == 20_000).unwrap()
        };
        for (kind, valid) in [(FlowForward, FlowForwardValid), (FlowBackward, FlowBackwardValid)] {
            let (frame, valid) = (find(kind), find(valid));
            let (LabelData::F32(flow), LabelData::U8(valid)) = (&frame.data, &valid.data) else { panic!() };
            assert_eq!(frame.t_other_us, if kind == FlowForward { 40_000 } else { 0 });
            let other = frame.t_other_us as f64 * 1e-6;
            let (worst, compared, skipped) = flow_error(&card, flow, valid, 0.02, other);
            println!(
                "{}, {name}: largest error {:.1e} px on {} pixels, sky {:.1e} px on {}, {skipped} silhouette \
                 pixels skipped",
                kind.name(),
                worst[0],
                compared[0],
                worst[1],
                compared[1]
            );
            assert!(worst.iter().all(|w| *w < 0.01), "{name}: {worst:?}");
            assert!(compared.iter().all(|n| *n > 500) && skipped < 40, "{compared:?} {skipped}");
            // Canary: an interval that is 1 % too long.
            let (wrong, ..) = flow_error(&card, flow, valid, 0.02, other + 0.01 * (other - 0.02));
            assert!(wrong.iter().all(|w| *w > 0.01), "canary: {wrong:?}");
        }
    }
}
