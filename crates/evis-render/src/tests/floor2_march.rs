//! Floor 2: `march/keep.wgsl` and `march/walk.wgsl` on pictures whose light is known everywhere and at any time.

use glam::{DAffine2, DMat2, DVec2};

use crate::gpu::Gpu;
use crate::march::{Gap, left_over};
use crate::pass::march::{KEEP_BINDINGS, PLACE_FORMAT, WALK_BINDINGS};
use crate::pass::raster::LUMINANCE_FORMAT;
use crate::pass::{self, ComputePass};
use crate::targets::{array, whole};
use crate::uniforms::MarchJob;

const WIDTH: u32 = 64;
const HEIGHT: u32 = 48;
const COLUMNS: u32 = 4;
const TILES: u32 = 12;
/// log2 of the instants of the gap.
const LENGTH: u8 = 2;
const CELLS: u32 = 4;

/// A flat picture that moves.
struct Shot {
    /// Pixel from picture, at each frame.
    motion: fn(u32) -> DAffine2,
    /// Light of the picture, at each frame.
    light: fn(DVec2, u32) -> f64,
    /// The object that a pixel shows.
    number: fn(DVec2, u32) -> f32,
}

fn waves(at: DVec2, _: u32) -> f64 {
    1.0 + 0.5 * (at.x * 0.6).sin() * (at.y * 0.45).cos()
}

const STILL: Shot = Shot { motion: |_| DAffine2::IDENTITY, light: waves, number: |_, _| 1.0 };

/// Turns by 0.02 radians, grows by 3 percent and slides by (1.1, -0.7) pixels in the gap, all around the middle.
fn turn(frame: u32) -> DAffine2 {
    let part = f64::from(frame) / f64::from(1 << LENGTH);
    let middle = DVec2::new(32.0, 24.0);
    let linear = DMat2::from_angle(0.02 * part) * (1.0 + 0.03 * part);
    DAffine2::from_mat2_translation(linear, middle - linear * middle + DVec2::new(1.1, -0.7) * part)
}

/// Verdicts, and the light of every instant of the gap but its last.
fn follow(gpu: &Gpu, shot: &Shot) -> (Vec<u32>, Vec<Vec<f32>>) {
    use wgpu::util::DeviceExt as _;
    let (device, queue) = (&gpu.device, &gpu.queue);
    let usage =
        wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::COPY_DST | wgpu::TextureUsages::COPY_SRC;
    let texture = |size, format| array(device, "march", size, format, usage);
    let buffer = |bytes: &[u8], usage| {
        device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: None,
            contents: bytes,
            usage: usage | wgpu::BufferUsages::COPY_SRC,
        })
    };
    let frames = 1 << LENGTH;
    let samples = texture([WIDTH, HEIGHT, CELLS * CELLS], LUMINANCE_FORMAT);
    let places = texture([WIDTH, HEIGHT, 1], PLACE_FORMAT);
    let (across, down) = (COLUMNS * 24, TILES / COLUMNS * 24);
    let kept_means = texture([across, down, 8], PLACE_FORMAT);
    let kept_places = texture([across, down, 2], PLACE_FORMAT);
    let layers = texture([WIDTH, HEIGHT, frames], LUMINANCE_FORMAT);
    // Clip from picture: pixels, then -1 to 1 with y up.
    let motions: Vec<[[f32; 4]; 4]> = (0..=frames)
        .flat_map(|frame| {
            let m = (shot.motion)(frame);
            let clip =
                |v: DVec2| [(v.x * 2.0 / f64::from(WIDTH)) as f32, (v.y * -2.0 / f64::from(HEIGHT)) as f32];
            let [[a, b], [c, d]] = [clip(m.matrix2.x_axis), clip(m.matrix2.y_axis)];
            let [x, y] = clip(m.translation);
            let own = [[a, b, 0.0, 0.0], [c, d, 0.0, 0.0], [0.0; 4], [x - 1.0, y + 1.0, 0.5, 1.0]];
            // The sky's, and two objects'.
            [[[0.0; 4]; 4], own, own]
        })
        .collect();
    let motions = buffer(bytemuck::cast_slice(&motions), wgpu::BufferUsages::STORAGE);
    let sample_of: Vec<u32> = (0..64).collect();
    let sample_of = buffer(bytemuck::cast_slice(&sample_of), wgpu::BufferUsages::UNIFORM);
    let verdicts = buffer(&[0; 4 * TILES as usize], wgpu::BufferUsages::STORAGE);
    let cells = [("COLUMNS", f64::from(CELLS)), ("ROWS", f64::from(CELLS))];
    let keep = ComputePass::new(device, "march/keep.wgsl", KEEP_BINDINGS, &cells);
    let walk = ComputePass::new(device, "march/walk.wgsl", WALK_BINDINGS, &[]);
    let pixels = || (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| DVec2::new(f64::from(x), f64::from(y))));
    let put = |texture: &wgpu::Texture, layer: u32, values: &[f32]| {
        let texel = values.len() as u32 / (WIDTH * HEIGHT) * 4;
        queue.write_texture(
            wgpu::TexelCopyTextureInfo {
                origin: wgpu::Origin3d { x: 0, y: 0, z: layer },
                ..texture.as_image_copy()
            },
            bytemuck::cast_slice(values),
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(WIDTH * texel),
                rows_per_image: None,
            },
            wgpu::Extent3d { width: WIDTH, height: HEIGHT, depth_or_array_layers: 1 },
        );
    };
    for (slot, frame) in [(0u8, 0), (1, frames)] {
        let back = (shot.motion)(frame).inverse();
        for cell in 0..CELLS * CELLS {
            let shift =
                (DVec2::new(f64::from(cell % CELLS), f64::from(cell / CELLS)) + 0.5) / f64::from(CELLS);
            let light: Vec<f32> =
                pixels().map(|p| (shot.light)(back.transform_point2(p + shift), frame) as f32).collect();
            put(&samples, cell, &light);
        }
        let shown: Vec<f32> = pixels()
            .flat_map(|p| {
                let at = back.transform_point2(p + 0.5);
                [at.x as f32, at.y as f32, 0.0, (shot.number)(p, frame)]
            })
            .collect();
        put(&places, 0, &shown);
        let words: Vec<u32> = (0..TILES)
            .map(|tile| Gap { tile, slot, pace: 0, length: LENGTH, reach: 4 }.word(COLUMNS))
            .collect();
        let words = buffer(bytemuck::cast_slice(&words), wgpu::BufferUsages::STORAGE);
        let job = MarchJob {
            count: TILES,
            row: TILES,
            frame,
            matrices: 3,
            layer: frame.wrapping_sub(1),
            half_size: [WIDTH as f32 / 2.0, HEIGHT as f32 / 2.0],
            dark: 1e-3,
            ..Default::default()
        };
        let job = buffer(bytemuck::bytes_of(&job), wgpu::BufferUsages::UNIFORM);
        let all = [&samples, &places, &kept_means, &kept_places, &layers].map(whole);
        let [samples, places, kept_means, kept_places, layers] =
            all.each_ref().map(wgpu::BindingResource::TextureView);
        let common = || {
            vec![
                pass::part(&job, 0, size_of::<MarchJob>() as u64),
                words.as_entire_binding(),
                motions.as_entire_binding(),
            ]
        };
        let keeps = [samples, places, kept_means.clone(), kept_places.clone(), sample_of.as_entire_binding()];
        let walks = [kept_means, kept_places, layers, verdicts.as_entire_binding()];
        let runs = [
            (&keep, KEEP_BINDINGS, [common(), keeps.to_vec()].concat(), true),
            (&walk, WALK_BINDINGS, [common(), walks.to_vec()].concat(), frame > 0),
        ];
        let mut encoder = device.create_command_encoder(&Default::default());
        for (what, bindings, resources, due) in runs {
            let group = pass::group(device, "march", &what.layout, bindings, resources);
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&what.pipeline);
            pass.set_bind_group(0, &group, &[0]);
            if due {
                pass.dispatch_workgroups(TILES, 1, 1);
            }
        }
        queue.submit([encoder.finish()]);
    }
    let light = device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: u64::from(WIDTH * HEIGHT * frames) * 4,
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&Default::default());
    encoder.copy_texture_to_buffer(
        layers.as_image_copy(),
        wgpu::TexelCopyBufferInfo {
            buffer: &light,
            layout: wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(WIDTH * 4),
                rows_per_image: Some(HEIGHT),
            },
        },
        layers.size(),
    );
    queue.submit([encoder.finish()]);
    let light: Vec<f32> = super::read(gpu, &light).into_iter().map(f32::from_bits).collect();
    let light = light.chunks_exact((WIDTH * HEIGHT) as usize).map(<[f32]>::to_vec).collect();
    (super::read(gpu, &verdicts), light)
}

/// Mean light of a pixel at a frame, over 16 x 16 places.
fn truth(shot: &Shot, pixel: DVec2, frame: u32) -> f64 {
    let back = (shot.motion)(frame).inverse();
    let place = |i: u32| (DVec2::new(f64::from(i % 16), f64::from(i / 16)) + 0.5) / 16.0;
    (0..256).map(|i| (shot.light)(back.transform_point2(pixel + place(i)), frame)).sum::<f64>() / 256.0
}

/// Largest error of the logarithm of light over the quarters that were followed, away from the picture's border (what a
/// pixel there is made from lies in part beyond it), and how many these are.
fn error((verdicts, light): &(Vec<u32>, Vec<Vec<f32>>), truth_of: &Shot) -> (f64, u32) {
    let mut worst: f64 = 0.0;
    let mut followed = 0;
    for (tile, verdict) in (0..).zip(verdicts) {
        for quarter in (0..4).filter(|quarter| left_over(*verdict) >> quarter & 1 == 0) {
            followed += 1;
            let corner = [tile % COLUMNS * 16 + quarter % 2 * 8, tile / COLUMNS * 16 + quarter / 2 * 8];
            for frame in 1..1 << LENGTH {
                for (x, y) in (0..64).map(|i| (corner[0] + i % 8, corner[1] + i / 8)) {
                    if x < 5 || y < 5 || x >= WIDTH - 5 || y >= HEIGHT - 5 {
                        continue;
                    }
                    let seen = f64::from(light[frame as usize - 1][(y * WIDTH + x) as usize]);
                    let wanted = truth(truth_of, DVec2::new(f64::from(x), f64::from(y)), frame);
                    worst = worst.max((seen / wanted).ln().abs());
                }
            }
        }
    }
    (worst, followed)
}

#[test]
fn what_is_followed_has_the_light_that_it_would_have_if_rendered() {
    let Some(gpu) = super::device() else { return };
    let slide =
        Shot { motion: |frame| DAffine2::from_translation(DVec2::new(0.7, 0.0) * f64::from(frame)), ..STILL };
    for (name, shot) in [("still", STILL), ("slide", slide), ("turn", Shot { motion: turn, ..STILL })] {
        let found = follow(&gpu, &shot);
        let (worst, followed) = error(&found, &shot);
        // What enters and what leaves is followed too, but for corners where it does both.
        let lost = if name == "turn" { 4 } else { 0 };
        assert!(followed >= 4 * TILES - lost, "{name}: {followed} followed, {:?}", found.0);
        assert!(worst < 2e-3, "{name}: {worst:.5}");
        if name != "still" {
            let (canary, _) = error(&found, &STILL);
            assert!(canary > 0.1, "{name}: canary {canary:.4}");
        }
    }
}

#[test]
fn light_that_changes_where_nothing_moves_goes_evenly() {
    let Some(gpu) = super::device() else { return };
    // By 6 percent in the gap, in a straight line.
    let shot =
        Shot { light: |at, frame| waves(at, 0) * (1.0 + 0.01 * f64::from(frame)), motion: turn, ..STILL };
    let found = follow(&gpu, &shot);
    let (worst, followed) = error(&found, &shot);
    assert!(followed >= 4 * TILES - 4, "{followed} followed");
    assert!(worst < 2e-3, "{worst:.5}");
}

#[test]
fn what_cannot_be_told_is_left_over() {
    let Some(gpu) = super::device() else { return };
    let of = |shot: &Shot| -> Vec<u8> {
        let (verdicts, _) = follow(&gpu, shot);
        verdicts.iter().flat_map(|v| (0..4).map(move |quarter| (v >> (3 * quarter) & 7) as u8)).collect()
    };
    // A border between two objects in column 32, where quarters end: those on both sides know of it.
    let border = of(&Shot { number: |p, _| if p.x < 32.0 { 1.0 } else { 2.0 }, ..STILL });
    for (index, why) in border.iter().enumerate() {
        let column = index / 4 % COLUMNS as usize * 2 + index % 2;
        assert_eq!(why & 1 != 0, column == 3 || column == 4, "quarter column {column}: {why}");
    }
    // A spot that the older key has not.
    let spot = of(&Shot {
        light: |at, frame| {
            waves(at, 0) * if frame > 0 && at.distance(DVec2::new(20.0, 4.0)) < 1.0 { 2.0 } else { 1.0 }
        },
        ..STILL
    });
    let marked: Vec<usize> = (0..spot.len()).filter(|&i| spot[i] != 0).collect();
    assert_eq!(marked, [4], "the upper left quarter of the second tile");
    assert_eq!(spot[4], 4, "its light differs");
    // 30 pixels: farther than a key knows.
    let far =
        Shot { motion: |frame| DAffine2::from_translation(DVec2::new(7.5, 0.0) * f64::from(frame)), ..STILL };
    assert!(of(&far).iter().all(|why| why & 2 != 0));
}
