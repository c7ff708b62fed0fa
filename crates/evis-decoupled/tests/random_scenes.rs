//! Random scenes against exact samples: what is seen must be in its tile's list, and areas must be right.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::sync::Arc;

use evis_decoupled::scene::screen::Depths;
use evis_decoupled::scene::tiles::TILE;
use evis_decoupled::scene::world::World;
use evis_decoupled::visibility::blocks::{Block, Clock};
use evis_decoupled::visibility::lists::Lists;
use evis_decoupled::{Settings, luminance, simulate};
use evis_scene::motion::Path;
use evis_scene::primitive::Shape;
use evis_scene::{Lens, Material, Mesh, Motion, Node, Primitive, Scene, ShadingModel, Trs};
use evis_truth::{PixelChoice, TruthSettings};
use glam::{DQuat, DVec3};

mod common;

use common::{add_of, camera};

const SIZE: [usize; 2] = [40, 32];

/// Numbers in [0, 1), by the finaliser of SplitMix64.
struct Dice(u64);

impl Dice {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let v = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let v = (v ^ (v >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((v ^ (v >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    fn vector(&mut self, size: f64) -> DVec3 {
        DVec3::new(self.between(-size, size), self.between(-size, size), self.between(-size, size))
    }
}

/// Unlit triangles and quads, each of its own colour, that move and turn before a camera that does too.
fn scene(seed: u64, count: usize, motion: f64) -> Scene {
    let mut dice = Dice(seed);
    let mut scene = Scene { background: [0.05; 3], ..Scene::default() };
    let spin = |dice: &mut Dice, place: DVec3, rate: f64| {
        let axis = dice.vector(1.0).normalize_or(DVec3::Y);
        let start = Trs { translation: place, ..Trs::default() };
        let velocity = dice.vector(2.0 * motion);
        Motion::Path(Arc::new(Path::Chain(vec![
            Path::ConstantVelocity { start, velocity },
            Path::Spin {
                start: Trs { rotation: DQuat::IDENTITY, ..Trs::default() },
                axis,
                rate: rate * motion,
            },
        ])))
    };
    let turning = spin(&mut dice, DVec3::ZERO, 0.5);
    let node = scene.add_node(Node { motion: turning, ..Node::default() });
    scene.cameras.push(camera(node, Lens::FieldOfView { fov_y: 0.9 }));
    for i in 0..count {
        let luminance = (dice.between(-2.0, 1.5)).exp() as f32;
        scene.materials.push(Material {
            model: ShadingModel::Unlit,
            base_color: [luminance, luminance, luminance, 1.0],
            double_sided: dice.unit() < 0.5,
            ..Material::default()
        });
        // Large ones that cross the near plane, small ones, slivers, and some in one plane.
        let large = i % 12 == 0;
        let size = if large { 8.0 } else { [0.25, 0.5, 0.1][i % 3] };
        let thin = if i % 5 == 1 && !large { 0.02 } else { 1.0 };
        let corner = |x: f64, y: f64| [(size * x) as f32, (size * thin * y) as f32, 0.0];
        let positions = vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
        let indices = if i % 3 == 0 { vec![0, 1, 2] } else { vec![0, 1, 2, 0, 2, 3] };
        let normals = vec![[0.0, 0.0, 1.0]; 4];
        let primitive = Primitive { material: i, positions, normals, indices, ..Primitive::default() };
        scene.meshes.push(Mesh { primitives: vec![primitive], ..Mesh::default() });
        let depth = dice.between(1.0, 6.0);
        let place = DVec3::new(dice.between(-0.7, 0.7) * depth, dice.between(-0.5, 0.5) * depth, -depth);
        let motion = if large {
            // A floor below the camera that reaches behind it.
            let start = Trs {
                translation: DVec3::new(0.0, dice.between(-1.6, -0.8), -3.0),
                rotation: DQuat::from_rotation_x(-1.5 + dice.between(-0.1, 0.1)),
                ..Trs::default()
            };
            Motion::Path(Arc::new(Path::ConstantVelocity { start, velocity: dice.vector(motion) }))
        } else if i % 7 == 3 {
            // In the plane of others, and facing the camera.
            Motion::Fixed(glam::DMat4::from_translation(DVec3::new(place.x, place.y, -4.0)))
        } else {
            spin(&mut dice, place, 6.0)
        };
        scene.add_node(Node { mesh: Some(i), motion, ..Node::default() });
    }
    scene
}

/// The same through an orthographic camera, whose planes cut some of it.
fn orthographic(mut scene: Scene) -> Scene {
    for camera in &mut scene.cameras {
        camera.lens = Lens::Orthographic { height: 3.0, far: 5.0 };
        camera.near = 0.8;
    }
    scene
}

/// Facets at a time, by exact poses: homogeneous corners, and how they are drawn.
fn exact(world: &World, t_us: f64) -> Vec<(u32, [DVec3; 4], bool)> {
    let frame = world.frame(t_us).expect("the camera has a pose");
    let vertices: Vec<Vec<DVec3>> = (0..world.surfaces.len() as u32)
        .map(|s| {
            let of = |(p, _): (DVec3, DVec3)| frame.screen_from_world.point(p);
            world.vertices(s, &frame).into_iter().map(of).collect()
        })
        .collect();
    world
        .facets
        .iter()
        .enumerate()
        .map(|(i, f)| {
            let surface = f.surface as usize;
            let h = f.corners.map(|c| vertices[surface][c as usize]);
            (i as u32, h, world.surfaces[surface].double_sided)
        })
        .collect()
}

/// The facet that is seen at image point (x, y), by one over its depth; of equal ones the first.
fn seen(facets: &[(u32, [DVec3; 4], bool)], at: [f64; 2], depths: &Depths) -> Option<u32> {
    let d = DVec3::new(at[0], at[1], 1.0);
    let mut best: Option<(f64, u32)> = None;
    for (id, h, double) in facets {
        let volume = h[0].dot(h[1].cross(h[3]));
        if volume == 0.0 || (volume > 0.0 && !double) {
            continue;
        }
        let inside = (0..4).all(|k| h[k].cross(h[(k + 1) % 4]).dot(d) * volume.signum() >= 0.0);
        let w = (h[1].cross(h[3]) + h[3].cross(h[0]) + h[0].cross(h[1])).dot(d) / volume;
        let between = w <= 1.0 / depths.near && w >= 1.0 / depths.far;
        if inside && between && best.is_none_or(|b| w > b.0 * (1.0 + 1e-10)) {
            best = Some((w, *id));
        }
    }
    best.map(|b| b.1)
}

/// Solids and an open sheet, each unlit, that spin before a floor of many facets which reaches behind a camera that turns.
fn solids(seed: u64, motion: f64) -> Scene {
    let mut dice = Dice(seed);
    let mut scene = Scene { background: [0.05; 3], ..Scene::default() };
    let turning = |dice: &mut Dice, translation: DVec3, rate: f64| {
        let axis = dice.vector(1.0).normalize_or(DVec3::Y);
        let start = Trs { translation, ..Trs::default() };
        Motion::Path(Arc::new(Path::Spin { start, axis, rate: rate * motion }))
    };
    let camera_motion = turning(&mut dice, DVec3::ZERO, 0.5);
    let node = scene.add_node(Node { motion: camera_motion, ..Node::default() });
    scene.cameras.push(camera(node, Lens::FieldOfView { fov_y: 0.9 }));
    for i in 0..9 {
        let (shape, segments) = match i % 4 {
            0 => (Shape::Sphere { radius: dice.between(0.3, 0.8) }, [16, 8]),
            1 => (Shape::Box { size: [dice.between(0.3, 1.2), 0.6, 0.4] }, [2, 2]),
            2 => (Shape::Capsule { radius: 0.2, height: dice.between(0.3, 1.0) }, [12, 4]),
            _ => (Shape::Card { size: [1.2, 0.9] }, [5, 4]),
        };
        let material =
            Material { model: ShadingModel::Unlit, double_sided: i % 4 == 3, ..Material::default() };
        let depth = dice.between(1.5, 5.0);
        let place = DVec3::new(dice.between(-0.5, 0.5) * depth, dice.between(-0.4, 0.4) * depth, -depth);
        add_of(&mut scene, (shape, Some(segments)), material, turning(&mut dice, place, 5.0));
    }
    let start = Trs { translation: DVec3::new(0.0, -1.0, 0.0), ..Trs::default() };
    let floor = Motion::Path(Arc::new(Path::ConstantVelocity { start, velocity: dice.vector(motion) }));
    let material = Material { model: ShadingModel::Unlit, ..Material::default() };
    add_of(&mut scene, (Shape::Plane { size: [12.0, 12.0] }, Some([6, 6])), material, floor);
    scene
}

/// What samples of a scene found.
#[derive(Default)]
struct Seen {
    samples: usize,
    /// Of what its tile's list lacks.
    missing: usize,
    /// The same if the list lacked one entry more.
    canary: usize,
    /// In pixels that are said to be filled, and of these where no single facet fills the pixel, and where nothing is seen.
    filled: usize,
    together: usize,
    empty: usize,
    /// Scenes, and their facets that were seen.
    scenes: usize,
    kinds: std::collections::BTreeSet<(usize, u32)>,
}

impl Seen {
    /// Looks through pixels of `scene` at `side` by `side` places each, at twelve times of a block.
    fn add(&mut self, scene: &Scene, side: usize) {
        let world = World::new(scene, 0, Some((SIZE[0] as u32, SIZE[1] as u32))).unwrap();
        let block = Block { start_us: 16_384.0, end_us: 32_768.0, jump: false };
        let mut clock = Clock::new(&world, block);
        let lists = Lists::new(&world, &mut clock).unwrap();
        let rows: Vec<_> = (0..lists.row_count()).map(|r| lists.row(&world, r)).collect();
        self.scenes += 1;
        for k in 0..12 {
            let t_us = block.start_us + block.length_us() * f64::from(k) / 11.5;
            let (facets, depths) = (exact(&world, t_us), world.frame(t_us).unwrap().depths);
            for (x, y) in (0..SIZE[1] * side).flat_map(|y| (0..SIZE[0] * side).map(move |x| (x, y))) {
                // Off the grid, so that edges are met everywhere.
                let off = [0, 1].map(|a| [0.37, 0.61][(a + k as usize) % 2]);
                let at = [0, 1].map(|a| ([x, y][a] as f64 + off[a]) / side as f64);
                let [column, row] = [x / side, y / side];
                let tile = &rows[row / TILE][column / TILE];
                let bit = (row % TILE) * TILE + column % TILE;
                let facet = seen(&facets, at, &depths);
                if tile.filled >> bit & 1 == 1 {
                    self.filled += 1;
                    self.together += usize::from(tile.entries.iter().all(|e| e.covers >> bit & 1 == 0));
                    self.empty += usize::from(facet.is_none());
                }
                let Some(facet) = facet else { continue };
                let listed = |left_out: usize| {
                    tile.entries.iter().enumerate().any(|(i, e)| {
                        i != left_out
                            && lists.records[e.record as usize].facet == facet
                            && e.touches >> bit & 1 == 1
                    })
                };
                self.samples += 1;
                self.kinds.insert((self.scenes, facet));
                self.missing += usize::from(!listed(usize::MAX));
                // Canary: lists that lack one entry.
                self.canary += usize::from(!listed((x + y) % tile.entries.len().max(1)));
            }
        }
    }
}

#[test]
fn what_is_seen_is_in_its_tile_s_list() {
    let mut all = Seen::default();
    for seed in 0..8 {
        let scene = scene(seed, 60, if seed % 2 == 0 { 1.0 } else { 4.0 });
        all.add(&if seed < 6 { scene } else { orthographic(scene) }, 4);
    }
    let Seen { samples, missing, canary, filled, empty, kinds, .. } = all;
    println!(
        "{samples} samples of {} facets, {missing} missing, {canary} if an entry lacks; {filled} filled",
        kinds.len()
    );
    assert!(samples > 100_000 && kinds.len() > 60, "{} facets", kinds.len());
    assert_eq!([missing, empty], [0; 2], "of {samples}");
    assert!(canary > 1000, "{canary}");
}

#[test]
fn what_a_surface_hides_is_not_seen() {
    let mut all = Seen::default();
    for seed in 20..28 {
        let scene = solids(seed, if seed % 2 == 0 { 1.0 } else { 4.0 });
        all.add(&if seed < 26 { scene } else { orthographic(scene) }, 2);
    }
    let Seen { samples, missing, canary, filled, together, empty, .. } = all;
    println!(
        "{samples} samples, {missing} missing, {canary} if an entry lacks; {filled} filled, {together} by several, {empty} empty"
    );
    assert_eq!([missing, empty], [0; 2], "of {samples}");
    assert!(samples > 100_000 && canary > 1000 && together > 10_000, "{samples} {canary} {together}");
}

#[test]
fn areas_are_those_of_4096_exact_samples() {
    areas(10..16, &|scene| scene);
}

#[test]
fn areas_through_an_orthographic_camera_are_those_of_exact_samples() {
    areas(16..20, &orthographic);
}

fn areas(seeds: std::ops::Range<u64>, seen_by: &dyn Fn(Scene) -> Scene) {
    let (mut squares, mut worst, mut count, mut canary) = (0.0, 0.0_f64, 0.0_f64, 0.0_f64);
    for seed in seeds {
        let scene = seen_by(scene(seed, 40, 1.0));
        let t_us = 20_992.0;
        let settings = Settings { size: Some((SIZE[0] as u32, SIZE[1] as u32)), ..Default::default() };
        let picture = luminance(&scene, &settings, t_us).unwrap();
        let world = World::new(&scene, 0, settings.size).unwrap();
        let (facets, depths) = (exact(&world, t_us), world.frame(t_us).unwrap().depths);
        let light = |facet: Option<u32>| {
            let of = |f: u32| {
                let surface = world.facets[f as usize].surface as usize;
                f64::from(scene.materials[world.surfaces[surface].material].base_color[0])
            };
            facet.map_or(f64::from(scene.background[0]), of)
        };
        for (i, found) in picture.iter().enumerate() {
            let (x, y) = (i % SIZE[0], i / SIZE[0]);
            let corners = [[0.01, 0.01], [0.99, 0.01], [0.5, 0.5], [0.01, 0.99], [0.99, 0.99]];
            let corners = corners.map(|[u, v]| seen(&facets, [x as f64 + u, y as f64 + v], &depths));
            if corners.iter().all(|c| *c == corners[0]) && i % 16 > 0 {
                continue;
            }
            // A lattice: 4181 points of the Fibonacci family.
            let (n, g) = (4181, 2584);
            let mean = (0..n)
                .map(|k| {
                    let u = (k as f64 + 0.5) / f64::from(n);
                    let v = ((k * g % n) as f64 + 0.5) / f64::from(n);
                    light(seen(&facets, [x as f64 + u, y as f64 + v], &depths))
                })
                .sum::<f64>()
                / f64::from(n);
            let error = (found / mean).ln().abs();
            squares += error * error;
            count += 1.0;
            worst = worst.max(error);
            let middle = light(corners[2]);
            canary += (middle / mean).ln().powi(2);
        }
    }
    let (rms, canary) = ((squares / count).sqrt(), (canary / count).sqrt());
    println!("{count} pixels: error of ln Y {rms:.5} RMS, {worst:.4} worst; one sample {canary:.3} RMS");
    assert!(count > 300.0 && rms < 0.004 && worst < 0.08, "{rms} {worst}");
    assert!(canary > 0.1, "one sample per pixel is no area: {canary}");
}

fn events(scene: &Scene, duration_us: i64, threads: usize) -> Vec<evis_core::Event> {
    let settings = Settings {
        size: Some((SIZE[0] as u32, SIZE[1] as u32)),
        duration_us,
        reference_luminance: Some(1.0),
        block_us: 16_384,
        ..Default::default()
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool of threads");
    pool.install(|| simulate(scene, &settings).expect("a usable scene").events)
}

#[test]
fn neither_threads_nor_the_length_of_a_stream_change_an_event() {
    let scene = scene(3, 40, 1.0);
    let all = events(&scene, 50_000, 1);
    assert!(all.len() > 2000, "{} events", all.len());
    assert_eq!(events(&scene, 50_000, 3), all, "threads");
    let half = events(&scene, 23_456, 2);
    let begin: Vec<_> = all.iter().copied().filter(|e| e.t < 23_456).collect();
    assert_eq!(half, begin, "length");
    // Canary: another scene has other events.
    assert_ne!(events(&self::scene(4, 40, 1.0), 50_000, 1), all);
}

#[test]
fn still_pixels_never_fire_while_others_do() {
    // Nothing moves, then one facet out of many does.
    let mut still = scene(5, 40, 0.0);
    assert_eq!(events(&still, 100_000, 2), []);
    let world = World::new(&still, 0, Some((SIZE[0] as u32, SIZE[1] as u32))).unwrap();
    let frame = world.frame(0.0).unwrap();
    // The nearest of those in view.
    let (mover, _) = (0..world.surfaces.len())
        .map(|s| (s, frame.screen_from_world.point(world.vertices(s as u32, &frame)[0].0)))
        .filter(|(_, h)| h.z > 0.5 && (0.2..0.8).contains(&(h.x / h.z / SIZE[0] as f64)))
        .min_by(|a, b| a.1.z.total_cmp(&b.1.z))
        .unwrap();
    let node = world.surfaces[mover].node;
    let place = frame.world_from_node(node);
    drop(world);
    let (_, rotation, translation) = place.to_scale_rotation_translation();
    let start = Trs { translation, rotation, ..Trs::default() };
    let velocity = DVec3::new(0.3, 0.0, 0.0);
    still.nodes[node].motion = Motion::Path(Arc::new(Path::ConstantVelocity { start, velocity }));
    let world = World::new(&still, 0, Some((SIZE[0] as u32, SIZE[1] as u32))).unwrap();
    let swept: Vec<[f64; 4]> = {
        let boxes = [0.0, 100_000.0].map(|t| {
            let frame = world.frame(t).unwrap();
            world.vertices(mover as u32, &frame).into_iter().map(move |(p, _)| {
                let h = frame.screen_from_world.point(p);
                [h.x / h.z, h.y / h.z, h.x / h.z, h.y / h.z]
            })
        });
        boxes.into_iter().flatten().collect()
    };
    let around = swept.iter().fold([f64::INFINITY, f64::INFINITY, 0.0, 0.0], |a: [f64; 4], b| {
        [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])]
    });
    let fired = events(&still, 100_000, 2);
    assert!(!fired.is_empty(), "the mover fires");
    for e in fired {
        let (x, y) = (f64::from(e.x), f64::from(e.y));
        let near = x + 1.0 >= around[0] && x <= around[2] && y + 1.0 >= around[1] && y <= around[3];
        assert!(near, "{e:?} outside {around:?}");
    }
}

/// Light that jumps where a block ends would fire there.
#[test]
fn events_gather_at_no_border_of_a_block() {
    const BLOCK_US: i64 = 32_768;
    let duration_us = 3 * BLOCK_US;
    let scenes = [("spinner", (320, 240), 600), ("street", (160, 120), 60)];
    let (mut own, mut truth) = (Vec::new(), Vec::new());
    for (name, size, pixels) in scenes {
        let scene = &evis_scene::builtin::load(name, 0).unwrap();
        let settings = TruthSettings {
            size: Some(size),
            duration_us,
            reference_luminance: Some(0.5),
            pixels: PixelChoice::Count(pixels),
            ..TruthSettings::default()
        };
        let known = evis_truth::truth(scene, &settings, &|_| true).unwrap();
        let settings =
            Settings { size: Some(size), duration_us, reference_luminance: Some(0.5), ..Settings::default() };
        assert_eq!(settings.block_us, BLOCK_US, "{name}");
        let fired = simulate(scene, &settings).unwrap().events;
        own.extend(fired.iter().filter(|e| known.pixels.contains(&[e.x, e.y])).map(|e| e.t));
        truth.extend(known.events.iter().map(|e| e.t));
    }
    // Within so much of a border between two blocks.
    let share = |times: &[i64], around_us: i64| {
        let near = |t: &&i64| {
            let border = (**t + BLOCK_US / 2) / BLOCK_US * BLOCK_US;
            (**t - border).abs() < around_us && border > 0 && border < duration_us
        };
        times.iter().filter(near).count() as f64 / times.len() as f64
    };
    let borders: Vec<i64> = (0..own.len() as i64 / 100).map(|k| (1 + k % 2) * BLOCK_US).collect();
    let burst = [&own[..], &borders].concat();
    for around_us in [BLOCK_US / 20, BLOCK_US / 200, 20] {
        let [of_own, of_truth, of_burst] = [&own, &truth, &burst].map(|times| share(times, around_us));
        println!(
            "within {around_us} us: {of_own:.4} of {} events, {of_truth:.4} of {} of truth",
            own.len(),
            truth.len()
        );
        assert!((of_own - of_truth).abs() < 0.005, "within {around_us} us: {of_own} and {of_truth}");
        assert!(of_burst - of_truth > 0.005, "a burst at borders is not seen: {of_burst} and {of_truth}");
    }
    assert!(truth.len() > 2000, "{} events", truth.len());
}
