//! Of what may throw a shadow, nothing is left out.

use super::*;
use crate::scene::contour::area;
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
    lighting.prepare(&mut clock, &block).unwrap();
    let (mut compared, mut darkened, mut off, mut canary) = (0, 0, 0, 0);
    let mut tile = TileLight::default();
    let u = 0.3;
    for (row, column) in (0..lists.row_count()).flat_map(|r| (0..lists.columns).map(move |c| (r, c))) {
        let entries = &lists.row(&world, row)[column].entries;
        lighting.enter_tile(&mut tile, entries, [column, row]);
        for (number, entry) in entries.iter().enumerate() {
            let record = &lists.records[entry.record as usize];
            lighting.ready(&mut tile, record, entry.record, number);
            lighting.shade_slot(&mut tile, record, entry.record, number);
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
