//! Pixels that a device follows do what `evis-decoupled` finds in 64 bits.

use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};

use evis_core::metric::{ScoreSettings, score};
use evis_core::random::Key;
use evis_core::sensor::{Refractory, RefractoryRule};
use evis_core::{Event, SensorConfig};
use evis_decoupled::packed::{self, Block, LIGHT_ALONE, PIXELS, Textures};
use evis_decoupled::{
    Device, Devices, Error, Outcome, Settings, Stages, Stream, StreamSettings, View, ViewSensor, simulate,
};
use evis_scene::environment::Environment;
use evis_scene::motion::{Path, PathInterpolation};
use evis_scene::{Distortion, Lens, Material, Motion, Scene, TextureRef, Trs, Variant};
use evis_truth::{PixelChoice, TruthSettings};
use glam::DVec3;

use crate::engine::follower::Followers;
use crate::tests::{random_scenes, raster_scenes};

/// Where light is compared: the middle of a block.
const MIDDLE: u32 = evis_decoupled::signal::pixel::UNITS / 2;

/// What a test does to a block before it is followed, and to what comes back.
#[derive(Clone, Copy, Debug)]
enum Tampering {
    None,
    /// Pixels lie elsewhere by a part of their side.
    Shift(f32),
    /// One pixel of so many did not fit.
    Fail(u32),
    /// Arrays have no more than so many bytes.
    Room(usize),
    /// Textures have none.
    NoTextureRoom,
}

/// A device that is tampered with; it keeps how far light in the middle of blocks is from the processor's, relative to that.
struct Tampered {
    device: Box<dyn Device>,
    devices: Arc<Tampers>,
    start_us: f64,
}

#[derive(Debug)]
struct Tampers {
    devices: Arc<Followers>,
    tampering: Tampering,
    /// The scene, of which light is compared.
    light: Option<(Scene, Settings)>,
    off: Mutex<Vec<f64>>,
    /// Submissions, and those before which the device kept nothing.
    followed: Mutex<[usize; 2]>,
}

impl Tampers {
    fn new(devices: &Arc<Followers>, tampering: Tampering) -> Self {
        let devices = Arc::clone(devices);
        Self { devices, tampering, light: None, off: Mutex::default(), followed: Mutex::default() }
    }
}

/// Opens what is tampered with.
#[derive(Debug)]
struct Opens(Arc<Tampers>);

impl Devices for Opens {
    fn texture_room(&self) -> usize {
        match self.0.tampering {
            Tampering::NoTextureRoom => 0,
            _ => self.0.devices.texture_room(),
        }
    }

    fn open(&self, textures: &Textures, views: &[ViewSensor]) -> Result<Box<dyn Device>, Error> {
        let (device, devices) = (self.0.devices.open(textures, views)?, Arc::clone(&self.0));
        Ok(Box::new(Tampered { device, devices, start_us: 0.0 }))
    }
}

impl Tampered {
    fn compare(&mut self, block: &Block) -> Result<(), Error> {
        let Some((scene, settings)) = &self.devices.light else { return Ok(()) };
        let mut light = block.clone();
        // One view.
        let job = &mut light.jobs[0];
        job.flags |= LIGHT_ALONE;
        job.number = MIDDLE;
        let (length_us, dark) = (f64::from(job.length_us), 1e-3 * f64::from(job.reference_luminance));
        light.light = light.tiles.len() * PIXELS;
        let found = self.device.follow(&mut light)?.light;
        let picture = evis_decoupled::luminance(scene, settings, self.start_us + 0.5 * length_us)?;
        self.start_us += length_us;
        let (width, height) = settings.size.unwrap();
        let place = |index: usize| {
            let (first, number) = (light.tiles[index / PIXELS].first, index % PIXELS);
            let [x, y] = [(first[0], width, number % 8), (first[1], height, number / 8)]
                .map(|(v, size, beside)| (v + 0.5 * size as f32) as usize + beside);
            y * width as usize + x
        };
        // What is not followed, or failed, is below 0.
        let off = (0..).zip(&found).filter(|(_, light)| **light >= 0.0);
        let off = off
            .map(|(index, light)| ((f64::from(*light) + dark) / (picture[place(index)] + dark)).ln().abs());
        self.devices.off.lock().unwrap().extend(off);
        Ok(())
    }
}

impl Device for Tampered {
    fn room(&self) -> usize {
        match self.devices.tampering {
            Tampering::Room(bytes) => bytes,
            _ => self.device.room(),
        }
    }

    fn follow(&mut self, block: &mut Block) -> Result<packed::Found, Error> {
        self.compare(block)?;
        let mut followed = self.devices.followed.lock().unwrap();
        *followed = [followed[0] + 1, followed[1] + usize::from(block.kept_from == 0)];
        drop(followed);
        if let Tampering::Shift(part) = self.devices.tampering {
            block.pixels.iter_mut().for_each(|pixel| pixel.centre[0] += part);
            block.tiles.iter_mut().for_each(|tile| tile.first[0] += part);
        }
        if let Tampering::Fail(count) = self.devices.tampering {
            let mut number = 0;
            for tile in &mut block.tiles {
                for (pixels, returned) in tile.pixels.iter().zip(&mut tile.returned) {
                    for pixel in (0..32).filter(|pixel| pixels >> pixel & 1 == 1) {
                        *returned |= if number % count == 0 { 1 << pixel } else { 0 };
                        number += 1;
                    }
                }
            }
        }
        let found = self.device.follow(block)?;
        if let Tampering::Fail(count) = self.devices.tampering {
            block.pixels.iter_mut().step_by(count as usize).for_each(|pixel| pixel.failed = 1);
        }
        Ok(found)
    }

    fn stages(&mut self) -> Option<&mut dyn Stages> {
        self.device.stages()
    }
}

fn settings(size: (u32, u32)) -> Settings {
    Settings { size: Some(size), duration_us: 50_000, ..Settings::default() }
}

/// `devices` are opened once per test: drivers that keep nothing on disk compile their passes each time.
fn followed(
    devices: &Arc<Followers>,
    scene: &Scene,
    settings: &Settings,
    tampering: Tampering,
) -> (Outcome, Vec<f64>) {
    let light = matches!(tampering, Tampering::None).then(|| (scene.clone(), settings.clone()));
    let tampers = Arc::new(Tampers { light, ..Tampers::new(devices, tampering) });
    let outcome = simulated(&tampers, scene, settings);
    let mut off = std::mem::take(&mut *tampers.off.lock().unwrap());
    off.sort_by(f64::total_cmp);
    (outcome, off)
}

fn opened(tampers: &Arc<Tampers>) -> Option<Arc<dyn Devices>> {
    Some(Arc::new(Opens(Arc::clone(tampers))))
}

fn simulated(tampers: &Arc<Tampers>, scene: &Scene, settings: &Settings) -> Outcome {
    simulate(scene, &Settings { devices: opened(tampers), ..settings.clone() }).unwrap()
}

/// Asserts that `outcome` is what the processor made of the same, `own`, most of it on a device; how far apart events are, in
/// microseconds and sorted.
fn assert_alike(name: &str, own: &Outcome, outcome: &Outcome) -> Vec<i64> {
    let report = &outcome.report;
    let (pixels, same, apart) = alike(&own.events, &outcome.events);
    println!(
        "{name}: {} events of {pixels} pixels, {same} of them alike, {} us apart (median; 99 %: {}); {} of {} evaluations on the \
         device, {} pixels left out",
        own.events.len(),
        quantile(&apart, 0.5),
        quantile(&apart, 0.99),
        report.on_device,
        report.evaluations,
        report.refollowed
    );
    assert!(own.events.len() > 500 && 100 * same > 98 * pixels, "{name}: {same} of {pixels}");
    assert!(quantile(&apart, 0.5) <= 20 && quantile(&apart, 0.99) <= 1000, "{name}");
    assert!(2 * report.on_device > report.evaluations, "{name}: {report:?}");
    apart
}

/// Times and polarities of each pixel.
fn by_pixel(events: &[Event]) -> BTreeMap<(u16, u16), Vec<(i64, i16)>> {
    let mut out: BTreeMap<_, Vec<_>> = BTreeMap::new();
    events.iter().for_each(|e| out.entry((e.x, e.y)).or_default().push((e.t, e.p)));
    out
}

/// How alike two streams are: pixels that fire, those of them that fire the same polarities in both, and how far apart the
/// events of those are, in microseconds and sorted.
fn alike(one: &[Event], other: &[Event]) -> (usize, usize, Vec<i64>) {
    let [one, other] = [by_pixel(one), by_pixel(other)];
    let places: std::collections::BTreeSet<_> = one.keys().chain(other.keys()).collect();
    let (mut same, mut apart) = (0, Vec::new());
    for place in &places {
        if let (Some(a), Some(b)) = (one.get(*place), other.get(*place))
            && a.iter().map(|e| e.1).eq(b.iter().map(|e| e.1))
        {
            same += 1;
            apart.extend(a.iter().zip(b).map(|(a, b)| (a.0 - b.0).abs()));
        }
    }
    apart.sort_unstable();
    (places.len(), same, apart)
}

/// The value below which `part` of them lie.
fn quantile<T: Copy + Default>(sorted: &[T], part: f64) -> T {
    sorted.get((part * sorted.len() as f64) as usize).copied().unwrap_or_default()
}

#[test]
fn a_device_finds_the_light_and_the_events_that_the_processor_finds() {
    let Some(gpu) = crate::tests::device() else { return };
    let devices = Arc::new(Followers::new(&gpu).unwrap());
    let plain = ["spinner", "desk", "street", "warehouse"].map(|name| (name, false));
    for (name, under_sky) in plain.into_iter().chain([("street", true)]) {
        let mut scene = evis_scene::builtin::load(name, 0).unwrap();
        if under_sky {
            scene.environment = Some(Environment { rotation: 0.7, ..Environment::studio() });
        }
        let settings = settings((120, 90));
        let own = simulate(&scene, &settings).unwrap();
        let (outcome, light) = followed(&devices, &scene, &settings, Tampering::None);
        let apart = assert_alike(&format!("{name}, sky {under_sky}"), &own, &outcome);
        println!("light off by {:.1e} (99 %: {:.1e})", quantile(&light, 0.5), quantile(&light, 0.99));
        assert!(light.len() > 500 && quantile(&light, 0.5) < 1e-3 && quantile(&light, 0.99) < 0.02, "{name}");
        // Canary: pixels that lie a twentieth of their side beside their place.
        if under_sky || (name != "spinner" && name != "street") {
            continue;
        }
        let (moved, _) = followed(&devices, &scene, &settings, Tampering::Shift(0.05));
        let (_, _, beside) = alike(&own.events, &moved.events);
        let [found, seen] = [&apart, &beside].map(|apart| quantile(apart, 0.9));
        assert!(seen > 2 * found.max(50), "{name}: 90 % within {seen} us, and {found} in place");
    }
}

#[test]
fn random_scenes_fire_on_a_device_as_on_the_processor() {
    let Some(gpu) = crate::tests::device() else { return };
    let devices = Arc::new(Followers::new(&gpu).unwrap());
    let (mut pixels, mut same, mut apart, mut seen) = (0, 0, Vec::new(), 0);
    for seed in 0..12 {
        let mut scene = random_scenes::scene(seed);
        // One environment, as it is.
        scene.variants.clear();
        let settings = settings((48, 36));
        let Ok(own) = simulate(&scene, &settings) else { continue };
        let (outcome, _) = followed(&devices, &scene, &settings, Tampering::None);
        let (own_pixels, own_same, own_apart) = alike(&own.events, &outcome.events);
        println!(
            "{seed}: {} of {} evaluations on the device, {} left out; {own_same} of {own_pixels} pixels alike, {} us apart",
            outcome.report.on_device,
            outcome.report.evaluations,
            outcome.report.refollowed,
            quantile(&own_apart, 0.5)
        );
        seen += usize::from(outcome.report.on_device > 0);
        pixels += own_pixels;
        same += own_same;
        apart.extend(own_apart);
    }
    apart.sort_unstable();
    println!(
        "{same} of {pixels} pixels alike, {} us apart, 99 %: {}",
        quantile(&apart, 0.5),
        quantile(&apart, 0.99)
    );
    assert!(seen > 8 && pixels > 8000, "{seen} {pixels}");
    assert!(100 * same > 97 * pixels, "{same} of {pixels}");
    assert!(quantile(&apart, 0.5) <= 20 && quantile(&apart, 0.99) <= 1500);
}

#[test]
fn what_a_device_cannot_follow_the_processor_does_and_runs_give_the_same_bytes() {
    let Some(gpu) = crate::tests::device() else { return };
    let devices = Arc::new(Followers::new(&gpu).unwrap());
    let scene = evis_scene::builtin::load("warehouse", 0).unwrap();
    let settings = settings((96, 72));
    let own = simulate(&scene, &settings).unwrap();
    let (none, _) = followed(&devices, &scene, &settings, Tampering::Fail(1));
    assert!(none.events == own.events, "nothing on the device is what the processor finds, to the byte");
    assert_eq!((none.report.on_device, none.report.evaluations), (0, own.report.evaluations));
    let [one, other] = [(); 2].map(|()| followed(&devices, &scene, &settings, Tampering::None).0);
    assert!(one.events == other.events && one.report.on_device > 0, "two runs");
    // Every third pixel by the processor: no event is lost and none comes twice.
    let (mixed, _) = followed(&devices, &scene, &settings, Tampering::Fail(3));
    let (pixels, same, _) = alike(&own.events, &mixed.events);
    assert!(mixed.report.refollowed > 500 && 100 * same > 98 * pixels, "{same} of {pixels}");
}

#[test]
fn bounds_prove_the_same_pixels_quiet_on_a_device() {
    let Some(gpu) = crate::tests::device() else { return };
    let devices = Arc::new(Followers::new(&gpu).unwrap());
    // Plain surfaces under a sun, some of which spin: a pixel is quiet through many blocks, and goes on when an edge comes.
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../evis-decoupled/examples/plain.toml");
    let scene = evis_scene::source::load(file, 0).unwrap();
    let settings = Settings { duration_us: 130_000, ..settings((96, 72)) };
    let own = simulate(&scene, &settings).unwrap();
    let outcome = simulated(&Arc::new(Tampers::new(&devices, Tampering::None)), &scene, &settings);
    assert_alike("plain", &own, &outcome);
    let [here, there] = [&own, &outcome].map(|run| run.report.quiet);
    println!("{here} and {there} quiet of {} pixels' blocks", own.report.pixel_blocks);
    assert!(4 * here > own.report.pixel_blocks, "{here} quiet");
    assert!(here.abs_diff(there) * 200 < here, "{here} and {there} are quiet");
    // After the first block, in which a device finds each pixel's reference: those that were quiet are evaluated where they go on.
    let first = Settings { duration_us: 2048, ..settings };
    let [own_first, first] = [
        simulate(&scene, &first).unwrap(),
        simulated(&Arc::new(Tampers::new(&devices, Tampering::None)), &scene, &first),
    ]
    .map(|run| run.report.evaluations);
    let counts = [own.report.evaluations - own_first, outcome.report.evaluations - first];
    assert_as_often("plain", counts, 1000);
}

/// Asserts that two evaluate pixels as often, but for one of `part` times: what pixels remember between blocks decides how often.
fn assert_as_often(name: &str, [here, there]: [u64; 2], part: u64) {
    println!("{name}: evaluated {here} and {there} times");
    assert!(here.abs_diff(there) * part < here, "{name}: {here} and {there}");
}

#[test]
fn what_pixels_remember_is_of_the_block_before_alone() {
    let Some(gpu) = crate::tests::device() else { return };
    let devices = Arc::new(Followers::new(&gpu).unwrap());
    // A camera that stands between two ways: pixels rest for some blocks, and go on from where they were.
    let mut scene = evis_scene::builtin::load("spinner", 0).unwrap();
    let node = scene.cameras[0].node;
    let mut state = evis_scene::SceneState::default();
    scene.evaluate(0.0, &mut state);
    let (_, rotation, start) = state.world_from_node[node].to_scale_rotation_translation();
    let way = rotation * DVec3::new(0.06, 0.02, -0.06);
    scene.nodes[node].parent = None;
    scene.nodes[node].motion = Motion::Path(
        Path::Keys {
            times: vec![0.0, 0.02, 0.08, 0.1],
            positions: [0.0, 1.0, 1.0, 2.0].map(|part| start + way * part).to_vec(),
            rotations: vec![rotation; 4],
            velocities: Vec::new(),
            interpolation: PathInterpolation::Linear,
        }
        .into(),
    );
    let settings = Settings { duration_us: 100_000, ..settings((96, 72)) };
    let own = simulate(&scene, &settings).unwrap();
    let outcome = simulated(&Arc::new(Tampers::new(&devices, Tampering::None)), &scene, &settings);
    assert_alike("stop and go", &own, &outcome);
    assert_as_often("stop and go", [&own, &outcome].map(|run| run.report.evaluations), 10_000);
}

#[test]
fn a_device_sees_through_distorted_lenses() {
    let Some(gpu) = crate::tests::device() else { return };
    let devices = Arc::new(Followers::new(&gpu).unwrap());
    let under_sky = |name| Scene {
        environment: Some(Environment::studio()),
        ..evis_scene::builtin::load(name, 0).unwrap()
    };
    for (name, mut scene) in [
        ("street", under_sky("street")),
        ("warehouse", under_sky("warehouse")),
        ("maps", moving(raster_scenes::diffuse())),
    ] {
        let camera = &mut scene.cameras[0];
        camera.lens = Lens::Intrinsics { fx: 90.0, fy: 91.0, cx: 61.0, cy: 44.0 };
        (camera.width, camera.height) = (Some(120), Some(90));
        let distortion = Distortion::from_coefficients("radtan", &[-0.28, 0.07, 1e-3, -2e-3]).unwrap();
        scene.distortions.insert(camera.name.clone(), distortion);
        let settings = settings((120, 90));
        let outcome = simulated(&Arc::new(Tampers::new(&devices, Tampering::None)), &scene, &settings);
        assert_alike(name, &simulate(&scene, &settings).unwrap(), &outcome);
        let report = outcome.report;
        assert!(name != "maps" || 10 * report.on_device > 9 * report.evaluations, "{report:?}");
        // Canary: the lens matters.
        scene.distortions.clear();
        let plain = simulate(&scene, &settings).unwrap();
        let (pixels, same, _) = alike(&plain.events, &outcome.events);
        assert!(100 * same < 90 * pixels, "{name}: {same} of {pixels} without distortion");
    }
}

#[test]
fn a_device_finds_the_light_of_sensors_with_more_stages() {
    let Some(gpu) = crate::tests::device() else { return };
    // Light comes down: of sensors that take frames, and where stages do not fit the device.
    let mut devices = Followers::new(&gpu).unwrap();
    devices.has_stages = false;
    let devices = Arc::new(devices);
    let warehouse = evis_scene::builtin::load("warehouse", 0).unwrap();
    // A lamp that is switched on and off, and a glow that follows a sine.
    let blinking = moving(raster_scenes::diffuse());
    for (name, scene) in [
        ("dvxplorer-like", &warehouse),
        ("davis346", &warehouse),
        ("v2e", &warehouse),
        ("dvxplorer-like", &blinking),
        ("v2e", &blinking),
    ] {
        let sensor = SensorConfig::preset(name).unwrap();
        let settings = Settings { sensor, ..settings((64, 48)) };
        let own = simulate(scene, &settings).unwrap();
        let run = |tampering| simulated(&Arc::new(Tampers::new(&devices, tampering)), scene, &settings);
        let outcome = run(Tampering::None);
        assert_alike(name, &own, &outcome);
        // In continuous time, and with frames.
        if name != "davis346" && std::ptr::eq(scene, &warehouse) {
            // Canary: pixels that lie a fifth of their side beside their place.
            let (pixels, same, _) = alike(&own.events, &run(Tampering::Shift(0.2)).events);
            assert!(100 * same < 90 * pixels, "{name}: {same} of {pixels} beside their place");
            let none = run(Tampering::Fail(1));
            assert!(
                none.events == own.events,
                "{name}: nothing on the device is the processor's, to the byte"
            );
            assert_eq!((none.report.on_device, none.report.evaluations), (0, own.report.evaluations));
            // Other pixels lie beside each: that says nothing of which the device can follow.
            let few = run(Tampering::Room(200_000));
            assert!(few.events == outcome.events, "{name}: a row or two at a time");
            assert_eq!(few.report.refollowed, outcome.report.refollowed, "{name}");
        }
    }
}

#[test]
fn stages_on_a_device_take_light_that_stays_there() {
    let Some(gpu) = crate::tests::device() else { return };
    let devices = Arc::new(Followers::new(&gpu).unwrap());
    let warehouse = evis_scene::builtin::load("warehouse", 0).unwrap();
    let blinking = moving(raster_scenes::diffuse());
    let preset = |name| SensorConfig::preset(name).unwrap();
    // A photoreceptor of two poles, a leak and its jitter, all noise; and a pixel that is held while it rests.
    let mut noisy = preset("dvxplorer-like");
    noisy.noise.shot_hz = 5.0;
    noisy.noise.leak_hz = 2.0;
    noisy.noise.leak_jitter = 0.1;
    let resting = |rule| Refractory { period_us: 3000, rule };
    noisy.refractory = resting(RefractoryRule::Suppress);
    let held = SensorConfig { refractory: resting(RefractoryRule::Hold), ..SensorConfig::default() };
    for (name, sensor, scene) in [
        ("dvxplorer-like", preset("dvxplorer-like"), &warehouse),
        ("gen4-like", preset("gen4-like"), &warehouse),
        ("noisy", noisy, &blinking),
        ("held", held, &blinking),
    ] {
        let settings = Settings { sensor, ..settings((64, 48)) };
        let own = simulate(scene, &settings).unwrap();
        let tampers = |tampering| Arc::new(Tampers::new(&devices, tampering));
        let outcome = simulated(&tampers(Tampering::None), scene, &settings);
        assert_alike(name, &own, &outcome);
        let losses = [own.report.losses.suppressed, outcome.report.losses.suppressed];
        assert!(losses[0].abs_diff(losses[1]) * 50 <= losses[0], "{name}: {losses:?}");
        // Light that the processor finds goes through the same stages.
        let none = simulated(&tampers(Tampering::Fail(1)), scene, &settings);
        let (pixels, same, found) = alike(&own.events, &none.events);
        println!("{name}: light of the processor: {same} of {pixels} alike, {} us", quantile(&found, 0.99));
        assert!(1000 * same > 995 * pixels && quantile(&found, 0.99) <= 1, "{name}: {same} of {pixels}");
        assert_eq!((none.report.on_device, none.report.evaluations), (0, own.report.evaluations));
        // A row of tiles or two at a time, whose light is taken at once.
        if name == "noisy" {
            let mut few = Followers::new(&gpu).unwrap();
            few.most_light = 1;
            let few = Arc::new(Tampers::new(&Arc::new(few), Tampering::Room(120_000)));
            let again = simulated(&few, scene, &settings);
            assert!(again.events == outcome.events, "{name}: a row or two at a time");
            let followed = few.followed.lock().unwrap()[0];
            assert!(followed > 20, "{name}: {followed} followed");
        }
    }
}

/// `scene`, before a camera that moves and turns, with its first object spinning.
fn moving(mut scene: Scene) -> Scene {
    let turning = |motion: &Motion, velocity: DVec3, axis: DVec3, rate: f64| {
        let Motion::Fixed(pose) = motion else { panic!("{motion:?}") };
        let (scale, rotation, translation) = pose.to_scale_rotation_translation();
        let start = Trs { translation, rotation, scale };
        let spin = Path::Spin { start: Trs::default(), axis, rate };
        Motion::Path(Path::Chain(vec![Path::ConstantVelocity { start, velocity }, spin]).into())
    };
    let (camera, object) =
        (scene.cameras[0].node, scene.nodes.iter().position(|n| n.mesh.is_some()).unwrap());
    let velocity = DVec3::new(0.5, 0.2, -0.3);
    for (node, velocity, rate) in [(camera, velocity, 0.3), (object, DVec3::ZERO, 3.0)] {
        let motion =
            turning(&scene.nodes[node].motion, velocity, DVec3::new(0.2, 1.0, 0.1).normalize(), rate);
        scene.nodes[node].motion = motion;
    }
    scene
}

#[test]
fn a_device_lights_surfaces_with_maps() {
    let Some(gpu) = crate::tests::device() else { return };
    let devices = Arc::new(Followers::new(&gpu).unwrap());
    let (mut under_sky, mut parallel) = (raster_scenes::glossy(), raster_scenes::glossy());
    under_sky.environment = Some(Environment { rotation: 0.7, ..Environment::studio() });
    parallel.cameras[0].lens = Lens::Orthographic { height: 2.4, far: 10.0 };
    let settings = settings((96, 72));
    for (name, scene, least_f1) in [
        ("diffuse", raster_scenes::diffuse(), 0.99),
        ("glossy", raster_scenes::glossy(), 0.955),
        ("sky", under_sky, 0.965),
        ("parallel", parallel, 0.93),
    ] {
        let scene = moving(scene);
        let own = simulate(&scene, &settings).unwrap();
        let (outcome, light) = followed(&devices, &scene, &settings, Tampering::None);
        let [middle, most] = [0.5, 0.99].map(|part| quantile(&light, part));
        println!("{name}: light off by {middle:.1e} (99 %: {most:.1e})");
        assert!(light.len() > 500 && middle < 2e-4 && most < 5e-3, "{name}");
        assert!(
            10 * outcome.report.on_device > 9 * outcome.report.evaluations,
            "{name}: {:?}",
            outcome.report
        );
        if name == "diffuse" {
            assert_alike(name, &own, &outcome);
        }
        // Both shade the same places at the same times, a device with maps in 16 bits per channel.
        let truth_settings = TruthSettings {
            size: settings.size,
            duration_us: settings.duration_us,
            pixels: PixelChoice::Count(1500),
            reference_luminance: Some(own.reference_luminance as f32),
            ..TruthSettings::default()
        };
        let truth = evis_truth::truth(&scene, &truth_settings, &|_| true).unwrap();
        let f1 = |events: &[Event]| {
            score(events, &truth, &ScoreSettings::default()).unwrap().at(1000).unwrap().plain.f1
        };
        let [on_device, on_processor] = [&outcome.events, &own.events].map(|events| f1(events));
        println!("{name}: F1 {on_device:.4} and {on_processor:.4} of {} events", truth.events.len());
        assert!(truth.events.len() > 150 && on_device.min(on_processor) > least_f1, "{name}");
        assert!(on_device > on_processor - 0.005, "{name}");
        // Canary: each of the maps counts.
        let maps: [fn(&mut Material) -> &mut Option<TextureRef>; 4] = [
            |m| &mut m.normal_texture,
            |m| &mut m.metallic_roughness_texture,
            |m| &mut m.occlusion_texture,
            |m| &mut m.emissive_texture,
        ];
        for map in maps.iter().filter(|_| name == "glossy") {
            let mut other = scene.clone();
            other.materials.iter_mut().for_each(|material| *map(material) = None);
            let without = f1(&simulate(&other, &settings).unwrap().events);
            assert!(without < on_device - 0.1, "{name}: {without}");
        }
    }
    // Maps for which there is no room leave what has them to the processor.
    let scene = moving(raster_scenes::glossy());
    let own = simulate(&scene, &settings).unwrap();
    let tampers = Arc::new(Tampers::new(&devices, Tampering::NoTextureRoom));
    let outcome = simulated(&tampers, &scene, &settings);
    let (pixels, same, _) = alike(&own.events, &outcome.events);
    assert!(2 * outcome.report.on_device < outcome.report.evaluations, "{:?}", outcome.report);
    assert!(1000 * same > 995 * pixels, "{same} of {pixels}");
}

#[test]
fn small_buffers_change_no_byte() {
    let Some(gpu) = crate::tests::device() else { return };
    let mut devices = Arc::new(Followers::new(&gpu).unwrap());
    let scene = evis_scene::builtin::load("warehouse", 0).unwrap();
    let settings = settings((96, 72));
    let run = |devices: &Arc<Followers>, tampering| {
        let tampers = Arc::new(Tampers::new(devices, tampering));
        let outcome = simulated(&tampers, &scene, &settings);
        let followed = *tampers.followed.lock().unwrap();
        (outcome, followed)
    };
    let (whole, [submissions, empty]) = run(&devices, Tampering::None);
    assert!(whole.events.len() > 500 && submissions == 3 && empty == 1, "{submissions} {empty}");
    // A row of tiles or two at a time; what is kept goes up more than once.
    let (apart, [submissions, empty]) = run(&devices, Tampering::Room(400_000));
    assert!(apart.events == whole.events, "{submissions} submissions");
    assert!(submissions > 9 && empty > 3, "{submissions} {empty}");
    // Room for one event.
    Arc::get_mut(&mut devices).unwrap().events_per_pixel = 0;
    let (again, _) = run(&devices, Tampering::None);
    assert!(again.events == whole.events);
    assert_eq!(again.report.refollowed, whole.report.refollowed);
}

#[test]
fn one_submission_serves_all_views_and_their_order_changes_no_byte() {
    let Some(gpu) = crate::tests::device() else { return };
    let devices = Arc::new(Followers::new(&gpu).unwrap());
    // Of the desk things bend at times of their own in each view, so that its blocks do not begin at the same times.
    for name in ["spinner", "desk"] {
        let mut scene = evis_scene::builtin::load(name, 0).unwrap();
        let clock = |k: usize| Variant { time_offset_s: 0.053 * k as f64, ..Variant::default() };
        scene.variants = (0..5).map(clock).collect();
        let scene = Arc::new(scene);
        let (all, submissions) = streamed(&devices, &scene, &[0, 1, 2, 3, 4]);
        assert!(all.iter().all(|events| events.len() > 50) && all[0] != all[1], "{name}");
        let (turned, of_turned) = streamed(&devices, &scene, &[4, 3, 2, 1, 0]);
        assert!(turned.iter().rev().eq(&all), "{name}: the order of views");
        let (alone, of_one) = streamed(&devices, &scene, &[2]);
        assert!(alone[0] == all[2], "{name}: a view alone");
        println!(
            "{name}: {submissions} submissions of five views, {of_turned} in another order, {of_one} of one"
        );
        assert!(of_one > 2 && submissions.max(of_turned) < 2 * of_one, "{name}");
        assert!(name != "spinner" || [submissions, of_turned] == [of_one; 2], "{name}");
    }
}

#[test]
fn stages_serve_views_whose_blocks_begin_at_other_times() {
    let Some(gpu) = crate::tests::device() else { return };
    let devices = Arc::new(Followers::new(&gpu).unwrap());
    // A lamp is switched in each view at times of its own: light jumps there while others rest.
    let mut scene = moving(raster_scenes::diffuse());
    let clock = |k: usize| Variant { time_offset_s: 0.0053 * k as f64, ..Variant::default() };
    scene.variants = (0..3).map(clock).collect();
    let scene = Arc::new(scene);
    let mut sensor = SensorConfig::preset("dvxplorer-like").unwrap();
    sensor.noise.shot_hz = 5.0;
    let run = |variants: &[usize]| streamed_with(&devices, &scene, variants, &sensor).0;
    let all = run(&[0, 1, 2]);
    assert!(all.iter().all(|events| events.len() > 50) && all[0] != all[1]);
    assert!(run(&[2, 1, 0]).iter().rev().eq(&all), "the order of views");
    assert!(run(&[1])[0] == all[1], "a view alone");
}

/// Events of each view of the `variants`, and submissions.
fn streamed(devices: &Arc<Followers>, scene: &Arc<Scene>, variants: &[usize]) -> (Vec<Vec<Event>>, usize) {
    streamed_with(devices, scene, variants, &SensorConfig::default())
}

fn streamed_with(
    devices: &Arc<Followers>,
    scene: &Arc<Scene>,
    variants: &[usize],
    sensor: &SensorConfig,
) -> (Vec<Vec<Event>>, usize) {
    const UNTIL_US: i64 = 90_000;
    let tampers = Arc::new(Tampers::new(devices, Tampering::None));
    let view = |variant: &usize| View {
        camera: 0,
        variant: Some(*variant),
        sensor: sensor.clone(),
        key: Key::new(0, 0, 0),
    };
    let views: Vec<View> = variants.iter().map(view).collect();
    let mut events = vec![Vec::new(); views.len()];
    let mut complete_us = vec![0; views.len()];
    let settings = StreamSettings {
        size: Some((48, 36)),
        reference_luminance: Some(0.5),
        devices: opened(&tampers),
        ..StreamSettings::default()
    };
    let mut stream = Stream::new(Arc::clone(scene), views, &settings).unwrap();
    stream.want(UNTIL_US);
    while complete_us.iter().any(|t_us| *t_us < UNTIL_US) {
        let piece = stream.next(&AtomicBool::new(false)).unwrap().unwrap();
        let whole = |event: &Event| event.t < UNTIL_US;
        events[piece.view].extend(piece.events.into_iter().filter(whole));
        complete_us[piece.view] = piece.complete_us;
    }
    let [submissions, _] = *tampers.followed.lock().unwrap();
    (events, submissions)
}
