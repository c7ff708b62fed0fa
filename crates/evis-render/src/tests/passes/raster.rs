//! The raster and label passes: what the device shows equals what rays find.
//!
//! The twin samples a pixel where the device does; both are exact about geometry but for the device's 1/256 pixel
//! grid and f32. So pixels with a sample near an edge of a triangle, of a hole or of a shadow are counted and left
//! out; everywhere else the two must agree within a tolerance that each case states.

use std::sync::Arc;

use evis_core::{LabelData, LabelFrame, LabelKind};
use evis_scene::{Lens, PixelLens, Rays, Scene, SceneState};
use glam::DVec3;

use crate::config::{Antialias, RunConfig, Shadows};
use crate::frame::pattern::Share;
use crate::pass::raster::WHOLE_PIXEL_TAPS;
use crate::tests::raster_scenes::{self as scenes, HEIGHT, WIDTH};

use crate::engine::Engine;
use crate::gpu::Gpu;
use crate::world::view;
use evis_truth::rays::{Options, Pinhole, RayCaster, TextureFilter, Textures};

/// Distance in pixels from an edge within which the device may see the other side.
const REACH: f64 = 0.02;

/// Coverage samples of `--antialias edges`: Vulkan 1.3, table "Standard sample locations", 4 samples.
const STANDARD_SAMPLES: [[f64; 2]; 4] = [[-0.125, -0.375], [0.375, -0.125], [-0.375, 0.125], [0.125, 0.375]];

#[derive(Clone, Copy)]
struct Case {
    scene: fn() -> Scene,
    /// Each turns the scene into one that the comparison must tell from it.
    canaries: &'static [fn(&mut Scene)],
    t_us: i64,
    antialias: Antialias,
    samples: u32,
    shadows: Shadows,
    /// Relative.
    tolerance: f64,
    /// Half width of the band, in pixels.
    reach: f64,
    /// Half width of the band along shadows, where there are any.
    shadow_reach: Option<f64>,
    /// Pixels whose textures are minified are compared too, not counted to the band.
    minified: bool,
    /// Most of the pixels that the band may take.
    most_band: f64,
}

impl Default for Case {
    fn default() -> Self {
        Self {
            scene: scenes::unlit,
            canaries: &[scenes::wrong_camera],
            t_us: 0,
            antialias: Antialias::Samples,
            samples: 4,
            shadows: Shadows::Maps,
            tolerance: 1e-4,
            reach: REACH,
            shadow_reach: None,
            minified: false,
            most_band: 0.25,
        }
    }
}

fn state_at(scene: &Scene, t_us: i64) -> SceneState {
    let mut state = SceneState::default();
    scene.evaluate(t_us as f64 * 1e-6, &mut state);
    state
}

/// The first camera of `scene`, from its own numbers.
fn pinhole(scene: &Scene, state: &SceneState) -> Pinhole {
    let camera = &scene.cameras[0];
    let (w, h) = (f64::from(WIDTH), f64::from(HEIGHT));
    let middle = [w / 2.0, h / 2.0];
    let (focal, center, rays) = match camera.lens {
        Lens::FieldOfView { fov_y } => ([h / (2.0 * (fov_y / 2.0).tan()); 2], middle, Rays::Central),
        Lens::Intrinsics { fx, fy, cx, cy } => ([fx, fy], [cx, cy], Rays::Central),
        Lens::Orthographic { height, far } => ([h / height; 2], middle, Rays::Parallel { far }),
    };
    Pinhole {
        world_from_camera: scene.world_from_camera(0, state).unwrap(),
        lens: PixelLens { focal, center, width: WIDTH, height: HEIGHT, near: camera.near, rays },
    }
}

/// Pixels in the order of images, with their centres.
fn centers() -> impl Iterator<Item = [f64; 2]> {
    (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| [f64::from(x) + 0.5, f64::from(y) + 0.5]))
}

/// Whether what `see` tells of an image point changes within `reach` of it.
fn changes<T: PartialEq>(at: [f64; 2], reach: f64, see: impl Fn([f64; 2]) -> T) -> bool {
    let here = see(at);
    [[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]]
        .into_iter()
        .any(|[x, y]| see([at[0] + reach * x, at[1] + reach * y]) != here)
}

/// The twin's side of a comparison: a scene at one instant, and which of its pixels can be told exactly.
struct Twin<'a> {
    /// One per sample: each reads textures by its own share of the pixel.
    samples: Vec<RayCaster<'a>>,
    /// The same with shares a little smaller and larger: where these differ, it depends on how derivatives are taken which
    /// level is read. The device's are differences between pixels, off by some percent towards the horizon.
    rounded: Vec<[RayCaster<'a>; 2]>,
    /// Textures read at their base level.
    base: RayCaster<'a>,
    camera: Pinhole,
}

impl<'a> Twin<'a> {
    fn new(
        scene: &'a Scene,
        state: &SceneState,
        textures: &'a Textures,
        (shares, taps): (&[Share], u32),
        shadows: bool,
    ) -> Self {
        let with = |filter| {
            RayCaster::new(scene, state, textures, Options { filter, shadows, ..Options::default() })
        };
        Self {
            samples: shares.iter().map(|share| with(averaged(share, 1.0, taps))).collect(),
            rounded: shares.iter().map(|s| [0.92, 1.08].map(|by| with(averaged(s, by, taps)))).collect(),
            base: with(TextureFilter::BaseLevel),
            camera: pinhole(scene, state),
        }
    }

    /// Mean over samples at `offsets`.
    fn luminance(&self, offsets: &[[f64; 2]]) -> Vec<f64> {
        let mut sum = vec![0.0; (WIDTH * HEIGHT) as usize];
        for (raster, offset) in self.samples.iter().zip(offsets) {
            let sample = raster.luminance(&self.camera, &[*offset]);
            sum.iter_mut().zip(sample).for_each(|(sum, y)| *sum += y / offsets.len() as f64);
        }
        sum
    }

    /// Pixels of which some sample lies near an edge, or reads textures otherwise where its footprint is some percent larger:
    /// how large it is exactly is the driver's own (Vulkan and WebGPU leave the precision of derivatives open).
    fn band(&self, offsets: &[[f64; 2]], case: &Case) -> Vec<bool> {
        let camera = &self.camera;
        let triangle = |p: [f64; 2]| self.base.hit_at(camera, p).map(|hit| hit.triangle);
        let dark = |p: [f64; 2]| self.base.radiance_at(camera, p) == DVec3::ZERO;
        centers()
            .map(|c| {
                offsets.iter().zip(&self.rounded).any(|(o, [less, more])| {
                    let at = [c[0] + o[0], c[1] + o[1]];
                    changes(at, case.reach, triangle)
                        || case.shadow_reach.is_some_and(|reach| changes(at, reach, dark))
                        || {
                            let [less, more] = [less, more].map(|r| r.radiance_at(camera, at).element_sum());
                            let most = if case.minified { 0.1 } else { case.tolerance };
                            (less - more).abs() > most * less
                        }
                })
            })
            .collect()
    }
}

/// What the engine shows by a sample that stands for `share`, made larger.
fn averaged(share: &Share, larger: f64, taps: u32) -> TextureFilter {
    TextureFilter::Averaged {
        shift: share.shift.map(f64::from),
        size: share.size.map(|side| f64::from(side) * larger),
        taps: f64::from(taps),
    }
}

/// Not what is chosen for these samples, so that the setting is seen to reach the shader.
const TAPS: u32 = 3;

#[derive(Debug, Default)]
struct Comparison {
    compared: usize,
    band: usize,
    worst: f64,
    wrong: Vec<String>,
}

impl Comparison {
    fn add(&mut self, pixel: usize, got: f64, expected: f64, tolerance: f64, scale: f64) {
        // Darker than a fiftieth of the picture's mean, a value counts as that.
        let error = (got - expected).abs() / expected.abs().max(scale / 50.0);
        self.worst = self.worst.max(error);
        if error.is_nan() || error > tolerance {
            let (x, y) = (pixel as u32 % WIDTH, pixel as u32 / WIDTH);
            self.wrong.push(format!("({x}, {y}): {got}, twin {expected}"));
        }
    }

    fn assert_equal(&self, what: &str, most_band: f64) {
        let pixels = (WIDTH * HEIGHT) as usize;
        eprintln!("{what}: {} compared, {} in the band, worst {:.2e}", self.compared, self.band, self.worst);
        assert!(
            self.wrong.is_empty(),
            "{what}: {} of {} wrong, worst {}; {:?}",
            self.wrong.len(),
            self.compared,
            self.worst,
            &self.wrong[..self.wrong.len().min(5)]
        );
        assert!(self.compared + self.band == pixels);
        let share = self.band as f64 / pixels as f64;
        assert!(share > 0.0 && share < most_band, "{what}: {share} of the pixels in the band");
    }

    fn assert_different(&self, what: &str) {
        assert!(
            self.wrong.len() * 200 > self.compared,
            "{what} was not seen: {} of {} wrong",
            self.wrong.len(),
            self.compared
        );
    }
}

fn engine(gpu: &Gpu, scene: &Arc<Scene>, config: &mut RunConfig) -> Engine {
    let (views, _) = view::views(scene, config).unwrap();
    Engine::new(gpu, scene.clone(), views, config).unwrap()
}

/// The twin's luminance of `scene` against `image`.
fn compare(scene: &Scene, image: &[f64], offsets: &[[f64; 2]], case: &Case) -> Comparison {
    let (state, textures) = (state_at(scene, case.t_us), Textures::new(scene));
    let shares = match case.antialias {
        Antialias::Samples => {
            crate::frame::pattern::shares(&offsets.iter().map(|o| o.map(|v| v as f32)).collect::<Vec<_>>())
        }
        // Each place of the grid stands for its cell, and lies beside its middle.
        Antialias::Edges if case.minified => {
            let side = (case.samples / 4).isqrt();
            let to_middle = |(i, o): (u32, &[f64; 2])| Share {
                shift: [0, 1].map(|axis| (middle(side, [i % side, i / side])[axis] - o[axis]) as f32),
                size: [1.0 / side as f32; 2],
            };
            (0..).zip(offsets).map(to_middle).collect()
        }
        // Of one colour each.
        Antialias::Edges => vec![Share::WHOLE; offsets.len()],
    };
    let twin = Twin::new(scene, &state, &textures, (&shares, TAPS), case.shadow_reach.is_some());
    let expected = twin.luminance(offsets);
    let mean = expected.iter().sum::<f64>() / expected.len() as f64;
    let mut out = Comparison::default();
    for (pixel, near) in twin.band(offsets, case).into_iter().enumerate() {
        if near {
            out.band += 1;
        } else {
            out.compared += 1;
            out.add(pixel, image[pixel], expected[pixel], case.tolerance, mean);
        }
    }
    out
}

/// The middle of a cell of a grid in the pixel, from its centre.
fn middle(side: u32, cell: [u32; 2]) -> [f64; 2] {
    cell.map(|i| (f64::from(i) + 0.5) / f64::from(side) - 0.5)
}

/// The four coverage samples around each place of a grid in the pixel; within surfaces, where each reads textures.
fn coverage(case: &Case) -> Vec<[f64; 2]> {
    let side = (case.samples / 4).isqrt();
    let cells = (0..side * side).map(|i| [i % side, i / side]);
    let places = cells.clone().map(|cell| middle(side, cell));
    let beside = |[column, row]: [u32; 2]| {
        let [x, y] = middle(side, [column, row]);
        [x + y / f64::from(side), y - x / f64::from(side)]
    };
    let around = |place: [f64; 2]| {
        STANDARD_SAMPLES.map(|o| [0, 1].map(|axis| place[axis] + o[axis] / f64::from(side)))
    };
    if case.minified { cells.map(beside).collect() } else { places.flat_map(around).collect() }
}

fn check(name: &str, case: Case) {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = Arc::new((case.scene)());
    let mut config = RunConfig {
        samples: case.samples,
        antialias: case.antialias,
        texture_taps: Some(TAPS),
        shadows: Some(case.shadows),
        reference_luminance: Some(1.0),
        ..RunConfig::default()
    };
    let mut engine = engine(&gpu, &scene, &mut config);
    let image = engine.luminance(0, case.t_us).unwrap();
    let offsets: Vec<[f64; 2]> = match case.antialias {
        // The device moves the picture by the offset: it samples at the opposite point.
        Antialias::Samples => engine.offsets().iter().map(|o| o.map(|v| -f64::from(v))).collect(),
        Antialias::Edges => coverage(&case),
    };
    compare(&scene, &image, &offsets, &case).assert_equal(name, case.most_band);
    for (i, canary) in case.canaries.iter().enumerate() {
        let mut wrong = Scene::clone(&scene);
        canary(&mut wrong);
        compare(&wrong, &image, &offsets, &case).assert_different(&format!("{name}: canary {i}"));
    }
}

#[test]
fn unlit_surfaces_equal_their_twin() {
    let canaries: &[fn(&mut Scene)] = &[scenes::wrong_texture_transform, scenes::wrong_camera];
    check("unlit", Case { canaries, ..Case::default() });
}

#[test]
fn diffuse_surfaces_equal_their_twin() {
    let canaries: &[fn(&mut Scene)] = &[scenes::wrong_light, scenes::wrong_occlusion, scenes::wrong_waveform];
    check("diffuse", Case { scene: scenes::diffuse, canaries, t_us: 3_700, ..Case::default() });
}

#[test]
fn metallic_roughness_surfaces_equal_their_twin() {
    let canaries: &[fn(&mut Scene)] =
        &[scenes::wrong_bitangent, scenes::wrong_roughness, scenes::wrong_occlusion];
    check("glossy", Case { scene: scenes::glossy, canaries, ..Case::default() });
}

#[test]
fn image_based_light_equals_its_twin() {
    let canaries: &[fn(&mut Scene)] =
        &[scenes::wrong_environment_rotation, scenes::wrong_environment_intensity];
    check("environment", Case { scene: scenes::environment, canaries, tolerance: 0.003, ..Case::default() });
    let canaries: &[fn(&mut Scene)] = &[scenes::wrong_environment_intensity];
    check("furnace", Case { scene: scenes::furnace, canaries, tolerance: 0.003, ..Case::default() });
}

#[test]
fn orthographic_cameras_equal_their_twin() {
    let canaries: &[fn(&mut Scene)] = &[scenes::wrong_camera, scenes::wrong_roughness, scenes::wrong_planes];
    check("orthographic", Case { scene: scenes::orthographic_glossy, canaries, ..Case::default() });
    let canaries: &[fn(&mut Scene)] = &[scenes::wrong_environment_rotation];
    let sky = Case { scene: scenes::orthographic_environment, tolerance: 0.003, ..Case::default() };
    check("orthographic, sky", Case { canaries, ..sky });
    let canaries: &[fn(&mut Scene)] = &[scenes::wrong_caster];
    let shadow = Case { scene: scenes::orthographic_sunlight, shadow_reach: Some(REACH), ..Case::default() };
    check("orthographic, shadow", Case { canaries, shadows: Shadows::Rays, ..shadow });
}

#[test]
fn masked_surfaces_equal_their_twin() {
    let canaries: &[fn(&mut Scene)] = &[scenes::wrong_cutoff];
    check("masked", Case { scene: scenes::masked, canaries, reach: 0.05, ..Case::default() });
}

#[test]
fn deformed_surfaces_equal_their_twin() {
    let canaries: &[fn(&mut Scene)] = &[scenes::wrong_morph, scenes::wrong_bind, scenes::wrong_bitangent];
    check("deformed", Case { scene: scenes::deformed, canaries, t_us: 30_000, ..Case::default() });
}

#[test]
fn shadows_equal_their_twin() {
    let canaries: &[fn(&mut Scene)] = &[scenes::wrong_caster];
    // Rays know a shadow's border as well as the rasteriser knows any other.
    for (shadows, reach) in [(Shadows::Maps, 0.12), (Shadows::Rays, REACH)] {
        let case = Case { canaries, shadows, shadow_reach: Some(reach), ..Case::default() };
        check(&format!("still shadow, {shadows:?}"), Case { scene: scenes::sunlight, ..case });
        check(&format!("low sun, {shadows:?}"), Case { scene: scenes::evening, ..case });
        let spot = Case { scene: scenes::moving_spotlight, t_us: 12_000, ..case };
        check(&format!("moving shadow, {shadows:?}"), spot);
    }
}

#[test]
fn places_look_for_shadows_beside_their_middles() {
    // Within surfaces: the band is as wide as what a place covers.
    let edges =
        Case { antialias: Antialias::Edges, shadows: Shadows::Rays, minified: true, ..Case::default() };
    let case = Case { tolerance: 1e-3, reach: 0.3, shadow_reach: Some(0.03), ..edges };
    for samples in [16, 36] {
        let canaries: &[fn(&mut Scene)] = &[scenes::wrong_caster];
        check(
            &format!("shadow, aa edges, {samples}"),
            Case { scene: scenes::sunlight, samples, canaries, ..case },
        );
    }
}

#[test]
fn rays_are_refused_where_a_caster_deforms() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = Arc::new(scenes::deformed());
    let mut lit = Scene::clone(&scene);
    lit.lights.iter_mut().for_each(|l| l.casts_shadow = true);
    let mut config = RunConfig { shadows: Some(Shadows::Rays), ..RunConfig::default() };
    let (views, _) = view::views(&lit, &config).unwrap();
    let message = Engine::new(&gpu, Arc::new(lit), views, &mut config).err().map(|e| e.to_string());
    assert!(message.as_ref().is_some_and(|m| m.contains("maps") && m.contains("deforms")), "{message:?}");
}

#[test]
fn covered_parts_of_pixels_equal_their_twin() {
    let case = Case { scene: scenes::plain, antialias: Antialias::Edges, tolerance: 1e-5, ..Case::default() };
    check("aa edges", case);
    check("aa edges, 16 samples", Case { samples: 16, ..case });
    check("aa edges, 36 samples", Case { samples: 36, ..case });
    check("aa samples", Case { antialias: Antialias::Samples, ..case });
}

#[test]
fn distant_textures_resemble_their_twin() {
    // The device takes the footprint from differences over a quad, the twin its exact slope; near the plane's horizon they
    // are farthest apart (worst measured: 0.122, at three of 1719 pixels; by the longer axis alone, blurred, below 0.1).
    let canaries: &[fn(&mut Scene)] = &[scenes::wrong_texture_transform];
    check(
        "minified",
        Case { scene: scenes::minified, canaries, tolerance: 0.13, minified: true, ..Case::default() },
    );
    // Quads are of places there: worst measured 0.147, at two of 1613 pixels.
    let edges = Case { antialias: Antialias::Edges, samples: 16, ..Case::default() };
    check(
        "minified, aa edges",
        Case { scene: scenes::minified, canaries, tolerance: 0.16, minified: true, ..edges },
    );
}

/// Label instants: 0, 20 ms.
const LABEL_US: i64 = 20_000;

fn label(labels: &[LabelFrame], kind: LabelKind, t_us: i64) -> &LabelData {
    &labels
        .iter()
        .find(|l| l.kind == kind && l.t_us == t_us)
        .unwrap_or_else(|| panic!("{kind:?} at {t_us}"))
        .data
}

fn floats(labels: &[LabelFrame], kind: LabelKind, t_us: i64) -> &[f32] {
    match label(labels, kind, t_us) {
        LabelData::F32(v) => v,
        other => panic!("{kind:?}: {other:?}"),
    }
}

fn ids(labels: &[LabelFrame], kind: LabelKind, t_us: i64) -> &[u32] {
    match label(labels, kind, t_us) {
        LabelData::U32(v) => v,
        other => panic!("{kind:?}: {other:?}"),
    }
}

fn mask(labels: &[LabelFrame], kind: LabelKind, t_us: i64) -> &[u8] {
    match label(labels, kind, t_us) {
        LabelData::U8(v) => v,
        other => panic!("{kind:?}: {other:?}"),
    }
}

fn render_labels(gpu: &Gpu, scene: &Arc<Scene>) -> Vec<LabelFrame> {
    let mut config = RunConfig {
        samples: 1,
        rate_hz: 50.0,
        label_rate_hz: 50.0,
        labels: LabelKind::ALL.into_iter().filter(|kind| *kind != LabelKind::Frame).collect(),
        reference_luminance: Some(1.0),
        ..RunConfig::default()
    };
    let mut engine = engine(gpu, scene, &mut config);
    engine.deliver(2 * LABEL_US, 2 * LABEL_US).unwrap().views.remove(0).labels
}

#[derive(Debug, Default)]
struct LabelComparison {
    pictures: Comparison,
    flow_pixels: f64,
    /// Flow vectors compared: of surfaces, of the sky; and pixels without one.
    flows: [usize; 3],
}

/// What the twin says of `scene` against `labels` at `t_us`. `flow_scene` moves what is seen in `scene`.
fn compare_labels(scene: &Scene, flow_scene: &Scene, labels: &[LabelFrame], t_us: i64) -> LabelComparison {
    let textures = Textures::new(scene);
    let at = |scene: &Scene, t: i64| {
        let state = state_at(scene, t);
        (pinhole(scene, &state), state)
    };
    let (camera, state) = at(scene, t_us);
    let twin = Twin::new(scene, &state, &textures, (&[Share::WHOLE], WHOLE_PIXEL_TAPS), false);
    let raster = &twin.samples[0];
    let expected = raster.labels(&camera);
    let color = raster.color(&camera, &[[0.0; 2]]);
    let mean = color.iter().map(|c| c.element_sum() / 3.0).sum::<f64>() / color.len() as f64;
    let flow = |t: i64| {
        let (other_camera, other_state) = at(flow_scene, t);
        let other = evis_truth::rays::geometry::Geometry::new(flow_scene, &other_state);
        raster.flow(&camera, &other, &other_camera)
    };
    let flows = [
        (LabelKind::FlowForward, LabelKind::FlowForwardValid, Some(flow(t_us + LABEL_US))),
        (LabelKind::FlowBackward, LabelKind::FlowBackwardValid, (t_us > 0).then(|| flow(t_us - LABEL_US))),
    ];
    let mut out = LabelComparison::default();
    let near = twin.band(&[[0.0; 2]], &Case::default());
    for (pixel, _) in near.iter().enumerate().filter(|(_, near)| !**near) {
        let pictures = &mut out.pictures;
        pictures.compared += 1;
        let depth = floats(labels, LabelKind::Depth, t_us)[pixel];
        match expected.depth[pixel].is_finite() {
            true => pictures.add(pixel, f64::from(depth), expected.depth[pixel], 1e-4, 0.0),
            false if depth == f32::INFINITY => {}
            false => pictures.wrong.push(format!("{pixel}: depth {depth} of nothing")),
        }
        let got =
            (ids(labels, LabelKind::Instance, t_us)[pixel], ids(labels, LabelKind::Semantic, t_us)[pixel]);
        if got != (expected.instance[pixel], expected.semantic[pixel]) {
            pictures.wrong.push(format!("{pixel}: ids {got:?}, twin {}", expected.instance[pixel]));
        }
        let triple = |kind| {
            let v = &floats(labels, kind, t_us)[3 * pixel..3 * pixel + 3];
            DVec3::new(f64::from(v[0]), f64::from(v[1]), f64::from(v[2]))
        };
        let normal = triple(LabelKind::Normal);
        if (normal - expected.normal[pixel]).length() > 1e-3 {
            pictures.wrong.push(format!("{pixel}: normal {normal}, twin {}", expected.normal[pixel]));
        }
        let hdr = triple(LabelKind::Hdr);
        for (got, expected) in hdr.to_array().into_iter().zip(color[pixel].to_array()) {
            pictures.add(pixel, got, expected, 0.005, mean);
        }
        for (kind, valid, expected_flow) in &flows {
            let got = &floats(labels, *kind, t_us)[2 * pixel..2 * pixel + 2];
            let got = [f64::from(got[0]), f64::from(got[1])];
            let valid = mask(labels, *valid, t_us)[pixel];
            match expected_flow.as_ref().and_then(|flow| flow[pixel]) {
                Some([x, y]) => {
                    let error = (got[0] - x).hypot(got[1] - y);
                    // A point nearly beside the other camera has a depth that f32 knows to 1e-7 of its distance,
                    // and a flow that goes as one over that depth.
                    let allowed = 0.01 + 1e-8 * (x * x + y * y);
                    out.flow_pixels = out.flow_pixels.max(if x.hypot(y) < 100.0 { error } else { 0.0 });
                    if valid != 1 || error.is_nan() || error > allowed {
                        pictures.wrong.push(format!("{pixel}: {kind:?} {got:?} ({valid}), twin {x} {y}"));
                    }
                    out.flows[usize::from(expected.instance[pixel] == 0)] += 1;
                }
                None => {
                    if valid != 0 || got != [0.0; 2] {
                        pictures.wrong.push(format!("{pixel}: {kind:?} {got:?} ({valid}), twin has none"));
                    }
                    out.flows[2] += 1;
                }
            }
        }
    }
    out.pictures.band = near.iter().filter(|near| **near).count();
    out
}

#[test]
fn labels_equal_their_twin() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = Arc::new(scenes::moving(2.5));
    let labels = render_labels(&gpu, &scene);
    for t_us in [0, LABEL_US] {
        let got = compare_labels(&scene, &scene, &labels, t_us);
        got.pictures.assert_equal(&format!("labels at {t_us} us"), 0.25);
        let [surface, sky, none] = got.flows;
        eprintln!(
            "flow: worst {:.1e} px; {surface} of surfaces, {sky} of the sky, {none} without",
            got.flow_pixels
        );
        let compared = got.pictures.compared;
        assert!(surface > 150 && sky > 300 && surface + sky + none == 2 * compared);
        assert_eq!(none, if t_us == 0 { compared } else { 0 }, "nothing lies before the first label");
    }
    // Canaries: each of these changes what a label should say.
    type Change = fn(&mut Scene);
    let changes: [(&str, Change); 3] =
        [("morph", scenes::wrong_morph), ("bind", scenes::wrong_bind), ("camera", scenes::wrong_camera)];
    for (name, change) in changes {
        let mut other = Scene::clone(&scene);
        change(&mut other);
        compare_labels(&scene, &other, &labels, LABEL_US).pictures.assert_different(name);
    }
    let mut other = Scene::clone(&scene);
    for normal in other.meshes.iter_mut().flat_map(|m| &mut m.primitives).flat_map(|p| &mut p.normals) {
        *normal = [normal[0], normal[2], normal[1]];
    }
    compare_labels(&other, &scene, &labels, 0).pictures.assert_different("swapped normals");
}

#[test]
fn labels_of_an_orthographic_camera_equal_their_twin() {
    let Some(gpu) = crate::tests::device() else { return };
    let scene = Arc::new(scenes::orthographic(scenes::moving(2.5), 2.5, [0.1, 12.0]));
    let labels = render_labels(&gpu, &scene);
    for t_us in [0, LABEL_US] {
        let got = compare_labels(&scene, &scene, &labels, t_us);
        got.pictures.assert_equal(&format!("orthographic labels at {t_us} us"), 0.25);
        let [surface, sky, none] = got.flows;
        assert!(surface > 150 && sky == 0 && none > 300, "{surface}, {sky}, {none}: the sky has no flow");
    }
    let mut other = Scene::clone(&scene);
    scenes::wrong_camera(&mut other);
    compare_labels(&scene, &other, &labels, LABEL_US).pictures.assert_different("camera");
}

#[test]
fn what_lies_behind_the_other_camera_has_no_flow() {
    let Some(gpu) = crate::tests::device() else { return };
    // 86 degrees from one label to the next: half of what is seen is then beside or behind the camera.
    let scene = Arc::new(scenes::moving(75.0));
    let labels = render_labels(&gpu, &scene);
    // At the second label only the sky is left.
    for (t_us, none_by_time) in [(0, WIDTH * HEIGHT), (LABEL_US, 0)] {
        let got = compare_labels(&scene, &scene, &labels, t_us);
        assert!(got.pictures.wrong.is_empty(), "at {t_us}: {:?}", got.pictures.wrong);
        let [surface, sky, none] = got.flows;
        eprintln!("fast turn: {surface} of surfaces, {sky} of the sky, {none} without");
        assert!(sky > 200 && none > none_by_time as usize + 200, "at {t_us}: {surface} {sky} {none}");
        assert!(t_us > 0 || surface > 50, "{surface}");
    }
}
