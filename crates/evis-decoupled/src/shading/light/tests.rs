//! Of what may throw a shadow, nothing is left out; the sky of a device is the sky.

use super::*;
use crate::scene::contour::area;
use crate::visibility::blocks::Block;
use crate::visibility::lists::Lists;

/// `scene` with its solids dented: each vertex moves along its normal, those at one place as far.
fn dented(mut scene: evis_scene::Scene) -> evis_scene::Scene {
    for primitive in scene.meshes.iter_mut().flat_map(|mesh| &mut mesh.primitives) {
        let [low, high] = bounding_box(primitive.positions.iter().map(|p| wide(*p)));
        let middle = 0.5 * (low + high);
        for position in &mut primitive.positions {
            let p = wide(*position);
            let wave = (p * DVec3::new(61.0, 47.0, 53.0)).to_array().map(f64::sin).iter().product::<f64>();
            *position = (middle + (p - middle) * (1.0 + 0.1 * wave)).as_vec3().to_array();
        }
    }
    scene
}

#[test]
fn no_facet_that_darkens_a_pixel_is_left_out() {
    let of = |name| evis_scene::builtin::load(name, 0).unwrap();
    nothing_that_darkens_is_left_out(&of("warehouse"), (96, 72), 630_784.0, 3);
    nothing_that_darkens_is_left_out(&of("desk"), (640, 480), 8_192.0, 16);
    nothing_that_darkens_is_left_out(&dented(of("desk")), (640, 480), 8_192.0, 16);
    nothing_that_darkens_is_left_out(&crate::scene::testing::solids(), (640, 480), 8_192.0, 2);
    let fast = evis_scene::Scene { speed: Some(4.0), ..dented(of("desk")) };
    nothing_that_darkens_is_left_out(&fast, (640, 480), 8_192.0, 16);
}

/// Compares every `tiles`-th tile in a block that begins at `start_us`.
fn nothing_that_darkens_is_left_out(
    scene: &evis_scene::Scene,
    size: (u32, u32),
    start_us: f64,
    tiles: usize,
) {
    let world = World::new(scene, 0, Some(size)).unwrap();
    let end_us = start_us + world.block_us(8192) as f64;
    let block = Block { start_us, end_us, jump: false };
    let mut clock = Clock::new(&world, block);
    let lists = Lists::new(&world, &mut clock).unwrap();
    let mut lighting = Lighting::new(&world, &Shared::new(scene));
    lighting.prepare(&mut clock).unwrap();
    let (mut compared, mut darkened, mut off, mut canary) = (0, 0, 0, 0);
    let mut tile = TileLight::default();
    let u = 0.3;
    for (row, column) in (0..lists.row_count()).flat_map(|r| (0..lists.columns).map(move |c| (r, c))) {
        let entries = &lists.row(&world, row)[column].entries;
        lighting.enter_tile(&mut tile, entries, [column, row]);
        for (number, entry) in entries.iter().enumerate() {
            let record = &lists.records[entry.record as usize];
            lighting.ready(&mut tile, record, entry.record, number);
            lighting.shade_slot(&mut tile, record, number);
            let slot = tile.slots[number];
            let pixel = (entry.touches.trailing_zeros() as usize * 5 + 3 * row) % 64;
            if entry.touches >> pixel & 1 == 0 || slot.lit & 1 == 0 || (5 * row + column) % tiles > 0 {
                continue;
            }
            let frame = tile.view.pixel(pixel);
            let Some(sight) = Sight::new(record, &tile.view, u, &lighting.depths) else { continue };
            let Some(fragment) = sight.at(entry.record, &frame, false) else { continue };
            let lamp = &lighting.screen_lamps[0];
            let shade = slot.shades[0];
            let near = tile.occluders[shade.from..shade.to].iter().filter(|o| o.0 >> pixel & 1 == 1);
            let kept: Vec<u32> = near.map(|o| o.1).collect();
            let dark = shade.dark >> pixel & 1 == 1;
            // Only the facet's own part: beyond it its plane may run through anything.
            let polygon = Polygon::within(fragment.crossing());
            if area(polygon.corners()) < 0.05 {
                continue;
            }
            let lines = |id: &u32| lighting.occluder(*id).lines(lamp, &sight.inverse_depth, &tile.view, u);
            let darkens = |id: &u32| {
                let shadow = crate::shading::shadow::Shadow::at(&lines(id), &frame);
                shadow.is_some_and(|s| {
                    let lines = fragment.crossing().iter().chain(s.lines());
                    area(Polygon::within(lines).corners()) > 1e-4
                })
            };
            let others = || (0..world.facets.len() as u32).filter(|id| *id != record.facet);
            let missing: Vec<u32> = others()
                .filter(|id| !dark && lighting.far[*id as usize] & 1 == 0)
                .filter(|id| !kept.contains(id) && darkens(id))
                .collect();
            assert!(missing.is_empty(), "facet {} at {frame:?} lacks {missing:?}", record.facet);
            // Both sides of solids darken what the near ones do.
            let part = |some: Vec<u32>| {
                let mut regions = Polygons::default();
                regions.push(0, polygon.corners());
                let some: Vec<[Line; 5]> = some.iter().map(lines).collect();
                Lit::default().part(Some((&regions, 0)), some.iter(), &frame).part
            };
            let brute = part(others().collect());
            let found = if dark { 0.0 } else { part(kept.clone()) };
            off += usize::from((found - brute).abs() > 0.15);
            canary += usize::from(!dark && kept[..kept.len() / 2].iter().any(darkens));
            compared += 1;
            darkened += usize::from(brute < 1.0);
        }
    }
    println!("{compared} compared, {darkened} darkened, {off} off, {canary} notice a missing one");
    assert!(compared > 100 && darkened > 20 && canary > 3);
    // Areas of slivers are counted by few samples.
    assert!(off * 50 < compared, "{off} of {compared}");
}

/// Glossy cards that spin at rates of their own under a sun and a narrow lamp, so that each flashes at another time.
fn plates() -> evis_scene::Scene {
    use evis_scene::motion::Path;
    use evis_scene::{Camera, Lens, LightKind, Motion, Node, Trs, primitive::Shape};
    let mut scene = evis_scene::Scene { ambient: [0.1; 3], ..Default::default() };
    scene.materials.push(Material {
        model: ShadingModel::MetallicRoughness,
        roughness: 0.3,
        metallic: 0.0,
        double_sided: true,
        ..Material::default()
    });
    let mut next = crate::scene::testing::numbers(5);
    for k in 0..60 {
        let card = Shape::Card { size: [0.3, 0.3] }.build(None, [1.0; 2]).unwrap();
        let translation = DVec3::new(f64::from(k % 10) * 0.35 - 1.6, f64::from(k / 10) * 0.35 - 0.9, 0.0);
        let rotation = glam::DQuat::from_rotation_y(6.0 * next());
        let start = Trs { translation, rotation, ..Trs::default() };
        let path = Path::Spin { start, axis: DVec3::Y, rate: 0.2 + 8.0 * next() * next() };
        crate::scene::testing::add(&mut scene, card, Motion::Path(path.into()));
    }
    let spot = LightKind::Spot { inner: 0.02, outer: 0.05 };
    for (number, (kind, intensity)) in [(LightKind::Directional, 2.0), (spot, 30.0)].into_iter().enumerate() {
        scene
            .lights
            .push(evis_scene::Light { casts_shadow: true, ..evis_scene::Light::new("", kind, intensity) });
        let start = Trs { translation: DVec3::new(0.5, 0.4, 3.0), ..Trs::default() };
        let path = Path::Spin { start, axis: DVec3::new(0.5, 1.0, 0.0).normalize(), rate: 0.4 };
        scene.add_node(Node { light: Some(number), motion: Motion::Path(path.into()), ..Node::default() });
    }
    let camera = Motion::Fixed(glam::DMat4::from_translation(DVec3::Z * 3.0));
    let node = scene.add_node(Node { motion: camera, ..Node::default() });
    scene.cameras.push(Camera::new("camera", node, Lens::FieldOfView { fov_y: 0.7 }));
    scene
}

#[test]
fn patches_say_what_places_of_their_facets_do() {
    let of = |name| evis_scene::builtin::load(name, 0).unwrap();
    let scenes = [
        ("warehouse", of("warehouse")),
        ("desk", of("desk")),
        ("street", of("street")),
        ("solids", crate::scene::testing::solids()),
        ("plates", plates()),
    ];
    let mut next = crate::scene::testing::numbers(11);
    let mut unlike = 0;
    for (name, scene) in &scenes {
        let world = World::new(scene, 0, Some((160, 120))).unwrap();
        let shared = Shared::new(scene);
        let mut lighting = Lighting::new(&world, &shared);
        let mut tile = TileLight::default();
        let (mut offs, mut others, mut canary) = (Vec::new(), 0, 0);
        let length_us = world.block_us(32_768) as f64;
        for number in [3.0, 4.0] {
            let [start_us, end_us] = [number, number + 1.0].map(|border| border * length_us);
            let mut clock = Clock::new(&world, Block { start_us, end_us, jump: false });
            let lists = Lists::new(&world, &mut clock).unwrap();
            lighting.prepare(&mut clock).unwrap();
            for (row, column) in (0..lists.row_count()).flat_map(|r| (0..lists.columns).map(move |c| (r, c)))
            {
                let entries = &lists.row(&world, row)[column].entries;
                lighting.enter_tile(&mut tile, entries, [column, row]);
                for (slot, entry) in entries.iter().enumerate() {
                    let record = &lists.records[entry.record as usize];
                    lighting.ready(&mut tile, record, entry.record, slot);
                    let Slot { patch, range: [low, high], .. } = tile.slots[slot];
                    others += usize::from(patch.is_none());
                    let u = next();
                    let sight = Sight::new(record, &tile.view, u, &lighting.depths);
                    let (Some(sight), true) = (sight, patch.is_some() && record.u == [0.0, 1.0]) else {
                        continue;
                    };
                    let places =
                        std::array::from_fn(|_| [0, 1].map(|k| low[k] + next() * (high[k] - low[k])));
                    let side = if sight.front { 1.0 } else { -1.0 };
                    let facet = lighting.lit_facet((record.facet, side), u, places[0]);
                    let points = facet.points(&places);
                    let (pixel, frame) = (0, tile.view.pixel(0));
                    let part =
                        Part { slot, sight: &sight, moments: &Moments::PIXEL, regions: None, pixel, frame };
                    let base =
                        lighting.answers[world.facets[record.facet as usize].surface as usize].mean_base;
                    let base = base.as_vec3().max(glam::Vec3::splat(0.05)).extend(1.0);
                    let mut sums = [[0.0_f32; 2]; 4];
                    for own in 0..=lighting.own.len() {
                        let exact = facet.response(&points, own, &shared.around).rows();
                        for (k, sum) in sums.iter_mut().enumerate() {
                            let at = Instant { moment: 0, u, t_s: 0.0 };
                            let answers = lighting.answers(&mut tile, &part, places[k], &at);
                            sum[0] += lighting.answer(&tile, &answers, own).dot(base);
                            sum[1] += Vec4::from_array(exact[k]).dot(base);
                        }
                    }
                    let off = |[found, exact]: [f32; 2]| (found - exact).abs() / (exact + 0.01);
                    offs.extend(sums.map(off));
                    canary += usize::from(off([sums[0][0], sums[1][1]]) > 0.01);
                }
            }
        }
        offs.sort_unstable_by(f32::total_cmp);
        let at = |part: f64| offs[(part * (offs.len() - 1) as f64) as usize];
        println!(
            "{name}: {} places, {others} without patches; off by {:.5}, 99.9 %: {:.5}, at most {:.5}; {canary}",
            offs.len(),
            at(0.5),
            at(0.999),
            at(1.0)
        );
        assert!(offs.len() > 1000 && at(0.999) < 0.005 && at(1.0) < 0.05, "{name}");
        unlike += canary;
    }
    assert!(unlike > 10_000, "{unlike} unlike their neighbours");
}

#[test]
fn the_sky_that_a_device_has_goes_on_beyond_edges_of_faces() {
    use evis_scene::environment::{CubeMap, Environment, FACES, cube_coordinates};
    let noise = |k: usize| half::f16::from_f64(0.1 + ((k * 7919) % 101) as f64 / 50.0);
    let level = |size: usize| {
        (0..FACES * size * size).map(|k| [noise(3 * k), noise(3 * k + 1), noise(k), half::f16::ONE])
    };
    let sky = CubeMap { size: 4, levels: vec![level(4).collect(), level(2).collect(), level(1).collect()] };
    let environment = Environment { sky, intensity: 1.5, ..Environment::studio() };
    let scene = evis_scene::Scene { environment: Some(environment.clone()), ..Default::default() };
    let packed = packed::pack_sky(&scene).unwrap();
    let word = |row: usize, k: usize| packed.rows[row][k].to_bits() as usize;
    let number = |index: usize| f64::from(packed.rows.as_flattened()[4 * packed.levels as usize + index]);
    // As `sky_level` of decoupled/sky.wgsl.
    let seen = |level: usize, direction: DVec3| {
        let (face, s, t) = cube_coordinates(direction);
        let size = word(level, 1);
        let place = [s, t].map(|v| (v + 1.0) * 0.5 * size as f64 + 0.5);
        let [x, y] = place.map(|v| (v as usize).min(size));
        let first = word(level, 0) + (face * (size + 2) + y) * (size + 2) + x;
        let [w, v] = [place[0] - x as f64, place[1] - y as f64];
        let row = |first: usize| number(first) * (1.0 - w) + number(first + 1) * w;
        row(first) * (1.0 - v) + row(first + size + 2) * v
    };
    let mut beyond = 0;
    for k in 0..4000 {
        let f = f64::from(k);
        let direction = DVec3::new((f * 0.7).sin(), (f * 1.3).cos(), (f * 2.9).sin());
        for level in 0..3 {
            let color = environment.sky.sample(direction, level as f64);
            let expected = 1.5 * material::LUMINANCE.dot(wide(color));
            assert!((seen(level, direction) - expected).abs() < 1e-5, "{direction} on level {level}");
        }
        let (_, s, t) = cube_coordinates(direction);
        beyond += usize::from(s.abs().max(t.abs()) > 0.75);
    }
    assert!(beyond > 1000, "{beyond} near edges");
}
