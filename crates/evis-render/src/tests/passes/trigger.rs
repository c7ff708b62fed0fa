//! Each pass equals its CPU twin, with planted boundary cases and a canary.

use evis_core::trigger::PixelState;
use evis_core::{SensorConfig, TriggerRule};

use crate::config::Interpolation;
use crate::config::grid::SampleGrid;
use crate::cpu::trigger::{PIECES, curve, log_luminance, walk, walk_curves};
use crate::gpu::Gpu;
use crate::gpu::commands::Commands;
use crate::gpu::readback::{map, wait_mapped};
use crate::gpu::sizes::Plan;
use crate::gpu::uniforms::{PixelMemory, Status, ViewSensor};
use crate::raster::layers::LayerUse;
use crate::sensor::group::{Group, Slot, Unit};
use crate::sensor::passes::{Blocks, TriggerPasses};
use crate::sensor::step::encode_trigger;
use crate::sensor::targets::Targets;
use crate::sensor::trigger::trigger_steps;
use crate::world::tiles::{tile_at, tile_count, tiles_along};

const WIDTH: u32 = 70;
const HEIGHT: u32 = 9;
const VIEWS: u32 = 2;
const SAMPLES: u32 = 3;
const INSTANTS: u32 = 5;
/// Instants of a block, where tiles have rates.
const BLOCK: u32 = 8;

/// A small hash to (0, 1): test inputs only.
fn noise(i: u32) -> f32 {
    let mut h = i.wrapping_mul(0x9E37_79B9) ^ 0x85EB_CA6B;
    h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    h = (h ^ (h >> 12)).wrapping_mul(0x297A_2D39);
    ((h ^ (h >> 15)) >> 8) as f32 / (1u32 << 24) as f32
}

fn layers() -> Vec<Vec<f32>> {
    layers_of(INSTANTS, SAMPLES)
}

/// Luminance of every layer: smooth noise over four decades, with planted black, huge and constant pixels.
fn layers_of(instants: u32, samples: u32) -> Vec<Vec<f32>> {
    (0..VIEWS * instants * samples)
        .map(|layer| {
            let (instant, view) = (layer / samples % instants, layer / samples / instants);
            (0..WIDTH * HEIGHT)
                .map(|pixel| match pixel % 16 {
                    0 => 0.0,
                    1 => 1e38,
                    2 => 0.5,
                    3 if instant == 2 => 0.0,
                    _ => {
                        let level = noise(pixel * 31 + view) * 4.0 - 2.0;
                        let change = (noise(pixel * 7 + instant * 977 + view) - 0.5) * 1.5;
                        10f32.powf(level) * change.exp() * (1.0 + 0.1 * noise(layer * 131 + pixel))
                    }
                })
                .collect()
        })
        .collect()
}

struct Ran {
    status: Status,
    offsets: Vec<u32>,
    records: Vec<[u32; 2]>,
    memory: Vec<PixelMemory>,
}

fn run(
    gpu: &Gpu,
    rule: TriggerRule,
    layers: &[Vec<f32>],
    sensors: &[ViewSensor],
    grid: &SampleGrid,
    capacity: u32,
    unknown: bool,
) -> Ran {
    let unit = Unit { group: 0, first: 0, instants: INSTANTS };
    run_unit(gpu, (rule, SAMPLES, unknown, Blocks::NONE), layers, sensors, grid, capacity, &unit, &[])
}

/// Runs `unit` from a memory of zeros; `rates` are those of tiles, by view and block.
#[expect(clippy::too_many_arguments, reason = "what the passes depend on")]
fn run_unit(
    gpu: &Gpu,
    (trigger, samples, unknown, blocks): (TriggerRule, u32, bool, Blocks),
    layers: &[Vec<f32>],
    sensors: &[ViewSensor],
    grid: &SampleGrid,
    capacity: u32,
    unit: &Unit,
    tile_rates: &[u8],
) -> Ran {
    let instants = unit.instants;
    let plan = Plan { views_per_group: VIEWS, instants, layers: VIEWS * instants * samples };
    let targets = Targets::new(&gpu.device, WIDTH, HEIGHT, plan, LayerUse::Rendered, None, blocks.instants);
    if !tile_rates.is_empty() {
        let (columns, rows) = (tiles_along(WIDTH), tiles_along(HEIGHT));
        let count = tile_rates.len() as u32 / (columns * rows);
        gpu.queue.write_texture(
            targets.tile_rates.as_image_copy(),
            tile_rates,
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(columns),
                rows_per_image: Some(rows),
            },
            wgpu::Extent3d { width: columns, height: rows, depth_or_array_layers: count },
        );
    }
    for (layer, pixels) in layers.iter().enumerate() {
        gpu.queue.write_texture(
            wgpu::TexelCopyTextureInfo {
                texture: &targets.layers.texture,
                mip_level: 0,
                origin: wgpu::Origin3d { x: 0, y: 0, z: layer as u32 },
                aspect: wgpu::TextureAspect::All,
            },
            bytemuck::cast_slice(pixels),
            wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(WIDTH * 4),
                rows_per_image: Some(HEIGHT),
            },
            wgpu::Extent3d { width: WIDTH, height: HEIGHT, depth_or_array_layers: 1 },
        );
    }
    let group = Group::new(gpu, 0, &targets, vec![0, 1], sensors, None);
    let slot = Slot::new(&gpu.device, capacity, group.header_bytes());
    let rules = SensorConfig { trigger, ..Default::default() };
    let passes = TriggerPasses::new(&gpu.device, &[(&rules, samples)], unknown, blocks, None);
    let mut encoder = Commands::new(gpu, "test");
    let steps = trigger_steps(gpu, &passes, grid, &targets, &group, unit, &slot, None);
    encode_trigger(&mut encoder, &steps);
    let header = group.header_bytes();
    let status_bytes = size_of::<Status>();
    encoder.copy_buffer_to_buffer(&group.status, 0, &slot.staging, 0, status_bytes as u64);
    let offsets = 4 * (u64::from(VIEWS) + 1);
    encoder.copy_buffer_to_buffer(&group.view_offsets, 0, &slot.staging, status_bytes as u64, offsets);
    encoder.copy_buffer_to_buffer(&slot.events, 0, &slot.staging, header, u64::from(capacity) * 8);
    // The first submission writes the second memory.
    let written = &group.memory[1];
    let written = written.texture();
    let row = (WIDTH * 16).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
    let memory = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: u64::from(row * HEIGHT * VIEWS),
        usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    encoder.copy_texture_to_buffer(
        written.as_image_copy(),
        wgpu::TexelCopyBufferInfo {
            buffer: &memory,
            layout: wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(row),
                rows_per_image: Some(HEIGHT),
            },
        },
        written.size(),
    );
    let submission = encoder.submit(gpu);
    for buffer in [&slot.staging, &memory] {
        wait_mapped(gpu, &submission, &map(buffer)).unwrap();
    }
    let bytes = slot.staging.get_mapped_range(..).unwrap();
    let status: Status = bytemuck::pod_read_unaligned(&bytes[..status_bytes]);
    let offsets = bytes[status_bytes..]
        .chunks_exact(4)
        .take(VIEWS as usize + 1)
        .map(bytemuck::pod_read_unaligned)
        .collect();
    let records = bytes[header as usize..].chunks_exact(8).take(status.event_count.min(capacity) as usize);
    let records = records.map(bytemuck::pod_read_unaligned).collect();
    let memory = memory.get_mapped_range(..).unwrap();
    let pixels = |row: &[u8]| -> Vec<PixelMemory> {
        let texels = row.chunks_exact(16).take(WIDTH as usize);
        texels.map(|texel| bytemuck::pod_read_unaligned(&texel[..8])).collect()
    };
    let memory = memory.chunks_exact(row as usize).flat_map(pixels).collect();
    Ran { status, offsets, records, memory }
}

fn sensors() -> Vec<ViewSensor> {
    [(0.2, 0.3), (0.11, 0.07)]
        .map(|(threshold_on, threshold_off)| ViewSensor {
            threshold_on,
            threshold_off,
            log_eps: 1e-3,
            inverse_reference_luminance: 1.0 / 0.7,
        })
        .to_vec()
}

/// The same sensor for the twin.
fn config_of(sensor: &ViewSensor, trigger: TriggerRule) -> SensorConfig {
    SensorConfig {
        threshold_on: sensor.threshold_on,
        threshold_off: sensor.threshold_off,
        log_eps: sensor.log_eps,
        trigger,
        ..SensorConfig::default()
    }
}

/// Distance from a decision's nearest threshold crossing below which host and device may differ: their
/// logarithms agree to a few units in the last place of values up to 90.
const BAND: f32 = 4e-5;

/// What the twin says of one pixel, and whether any of its decisions lies within the band.
fn twin(
    config: &SensorConfig,
    log_luminances: &[f32],
    times: &[u32],
) -> (Vec<(u32, bool)>, PixelState, bool) {
    let mut near = false;
    let mut state = None;
    let mut events = Vec::new();
    for (k, &l) in log_luminances.iter().enumerate() {
        // Unknown: passed by.
        if l.is_nan() {
            continue;
        }
        if let Some(PixelState { reference_log, .. }) = state {
            let change: f32 = l - reference_log;
            let threshold = if change >= 0.0 { config.threshold_on } else { config.threshold_off };
            let steps = change.abs() / threshold;
            near |= steps > 0.5 && (steps - steps.round()).abs() * threshold < BAND;
        }
        events.extend(walk(config, &mut state, &log_luminances[k..=k], &times[k..=k + 1]));
    }
    (events, state.unwrap(), near)
}

struct Comparison {
    compared: usize,
    events: usize,
    near: usize,
    flipped: usize,
    late: i64,
    wrong: Vec<String>,
}

fn compare(
    ran: &Ran,
    rule: TriggerRule,
    layers: &[Vec<f32>],
    sensors: &[ViewSensor],
    grid: &SampleGrid,
) -> Comparison {
    let times: Vec<u32> =
        std::iter::once(0).chain((0..INSTANTS).map(|k| grid.instant_us(i64::from(k)) as u32)).collect();
    let mut out = Comparison { compared: 0, events: 0, near: 0, flipped: 0, late: 0, wrong: Vec::new() };
    for view in 0..VIEWS {
        let sensor = &sensors[view as usize];
        let config = config_of(sensor, rule);
        let range = ran.offsets[view as usize] as usize..ran.offsets[view as usize + 1] as usize;
        let mut device = ran.records[range].iter().peekable();
        for pixel in 0..WIDTH * HEIGHT {
            let (x, y) = (pixel % WIDTH, pixel / WIDTH);
            let mut got = Vec::new();
            while let Some(r) = device.next_if(|r| r[1] & 0x3FF_FFFF == x | y << 13) {
                got.push((r[0], r[1] >> 26 & 1 == 1));
            }
            let lumas: Vec<f32> = (0..INSTANTS)
                .map(|k| {
                    let first = ((view * INSTANTS + k) * SAMPLES) as usize;
                    let samples = (first..first + SAMPLES as usize).map(|l| layers[l][pixel as usize]);
                    if layers[first][pixel as usize] < 0.0 {
                        return f32::NAN;
                    }
                    log_luminance(samples, 1.0 / sensor.inverse_reference_luminance, config.log_eps)
                })
                .collect();
            let (expected, state, near) = twin(&config, &lumas, &times);
            out.compared += 1;
            out.events += expected.len();
            out.near += usize::from(near);
            let same_kind = got.len() == expected.len() && got.iter().zip(&expected).all(|(a, b)| a.1 == b.1);
            if !same_kind {
                if near {
                    out.flipped += 1;
                } else {
                    out.wrong.push(format!("({x}, {y}) view {view}: {got:?}, twin {expected:?}"));
                }
                continue;
            }
            for (a, b) in got.iter().zip(&expected) {
                out.late += i64::from(a.0) - i64::from(b.0);
                if a.0.abs_diff(b.0) > 1 {
                    out.wrong.push(format!("({x}, {y}) view {view}: at {} us, twin {}", a.0, b.0));
                }
            }
            let memory = ran.memory[((view * HEIGHT + y) * WIDTH + x) as usize];
            if (memory.reference_log - state.reference_log).abs() > BAND
                || (memory.log_luminance - state.log_luminance).abs() > BAND
            {
                out.wrong.push(format!("({x}, {y}) view {view}: memory {memory:?}, twin {state:?}"));
            }
        }
        assert!(device.next().is_none(), "records of view {view} are not in pixel order");
    }
    out
}

#[test]
fn trigger_passes_equal_their_twin() {
    let Some(gpu) = crate::tests::device() else { return };
    let layers = layers();
    let sensors = sensors();
    let grid = SampleGrid::new(1000.0 / 3.0, 1).unwrap();
    for rule in [TriggerRule::Crossing, TriggerRule::Latch] {
        let ran = run(&gpu, rule, &layers, &sensors, &grid, 1 << 16, false);
        assert_eq!((ran.status.stalled, ran.status.mismatched), (0, 0));
        let got = compare(&ran, rule, &layers, &sensors, &grid);
        assert!(got.wrong.is_empty(), "{rule:?}: {} wrong, first {}", got.wrong.len(), got.wrong[0]);
        assert!(got.events > 5000 || rule == TriggerRule::Latch && got.events > 1000, "{}", got.events);
        assert_eq!(got.compared as u32, WIDTH * HEIGHT * VIEWS);
        // The band is there, it is small, and times have no bias to one side.
        assert!(got.near > 0 && got.near < got.compared / 20, "{} near of {}", got.near, got.compared);
        assert!(got.flipped <= got.near);
        assert!(got.late.unsigned_abs() as usize <= got.events / 100, "bias {} us", got.late);
    }
}

#[test]
fn canary_the_comparison_rejects_a_wrong_threshold_and_a_shift() {
    let Some(gpu) = crate::tests::device() else { return };
    let layers = layers();
    let sensors = sensors();
    let grid = SampleGrid::new(1000.0 / 3.0, 1).unwrap();
    let mut ran = run(&gpu, TriggerRule::Crossing, &layers, &sensors, &grid, 1 << 16, false);
    let mut wrong = sensors.clone();
    wrong[1].threshold_off *= 1.01;
    assert!(!compare(&ran, TriggerRule::Crossing, &layers, &wrong, &grid).wrong.is_empty());
    for record in &mut ran.records {
        record[0] += 2;
    }
    assert!(!compare(&ran, TriggerRule::Crossing, &layers, &sensors, &grid).wrong.is_empty());
}

/// What the twin says of a pixel that is sampled at its tile's rates, block by block.
fn twin_of_blocks(
    config: &SensorConfig,
    lumas: &[f32],
    tile_rates: &[u8],
    times: &[u32],
    between: Interpolation,
) -> Vec<(u32, bool)> {
    let mut state = Some(PixelState { reference_log: 0.0, log_luminance: 0.0 });
    let walk = if between == Interpolation::Curve { walk_curves } else { walk };
    let mut events = Vec::new();
    for (block, log2_stride) in tile_rates.iter().enumerate() {
        let begin = block * BLOCK as usize;
        let step = 1 << log2_stride;
        let at: Vec<usize> = (begin + step - 1..begin + BLOCK as usize).step_by(step).collect();
        let sampled: Vec<f32> = at.iter().map(|k| lumas[*k]).collect();
        // `times` begins with the instant before the first.
        let sampled_at: Vec<u32> =
            std::iter::once(times[begin]).chain(at.iter().map(|k| times[k + 1])).collect();
        events.extend(walk(config, &mut state, &sampled, &sampled_at));
    }
    events
}

#[test]
fn curves_between_samples_equal_their_twin() {
    let Some(gpu) = crate::tests::device() else { return };
    let sensors = sensors();
    let grid = SampleGrid::new(1000.0 / 3.0, 1).unwrap();
    let blocks = Blocks { instants: BLOCK, between: Interpolation::Curve };
    let unit = Unit { group: 0, first: 1 + 3 * i64::from(BLOCK), instants: 2 * BLOCK };
    let layers = layers_of(unit.instants, 1);
    let base = unit.base_us(&grid);
    let times: Vec<u32> =
        (-1..i64::from(unit.instants)).map(|k| (grid.instant_us(unit.first + k) - base) as u32).collect();
    let tiles = tile_count((WIDTH, HEIGHT)) as u32;
    let tile_rates: Vec<u8> = (0..VIEWS * 2 * tiles).map(|tile| (tile % 4) as u8).collect();
    for rule in [TriggerRule::Crossing, TriggerRule::Latch] {
        let ran =
            run_unit(&gpu, (rule, 1, false, blocks), &layers, &sensors, &grid, 1 << 18, &unit, &tile_rates);
        assert_eq!((ran.status.stalled, ran.status.mismatched), (0, 0));
        let (mut events, mut bent, mut other, mut pixels) = (0, 0, 0, 0);
        for view in 0..VIEWS {
            let sensor = &sensors[view as usize];
            let config = config_of(sensor, rule);
            let range = ran.offsets[view as usize] as usize..ran.offsets[view as usize + 1] as usize;
            let records = &ran.records[range];
            for pixel in 0..WIDTH * HEIGHT {
                let (x, y) = (pixel % WIDTH, pixel / WIDTH);
                let of_pixel = records.iter().filter(|r| r[1] & 0x3FF_FFFF == x | y << 13);
                let got: Vec<(u32, bool)> = of_pixel.map(|r| (r[0], r[1] >> 26 & 1 == 1)).collect();
                let lumas: Vec<f32> = (0..unit.instants)
                    .map(|k| {
                        let y = layers[(view * unit.instants + k) as usize][pixel as usize];
                        let y_ref = 1.0 / sensor.inverse_reference_luminance;
                        log_luminance(std::iter::once(y), y_ref, config.log_eps)
                    })
                    .collect();
                let tile = tile_at(WIDTH, x, y) as u32;
                let of_tile = [0, 1].map(|block| tile_rates[((2 * view + block) * tiles + tile) as usize]);
                // A latch fires at samples, whatever lies between them.
                let ways = [Interpolation::Curve, Interpolation::Line];
                let mut twins =
                    ways.map(|between| twin_of_blocks(&config, &lumas, &of_tile, &times, between));
                if rule == TriggerRule::Latch {
                    twins.reverse();
                }
                let [expected, unlike] = twins;
                let alike = |a: &[(u32, bool)], b: &[(u32, bool)]| {
                    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.1 == b.1 && a.0.abs_diff(b.0) <= 1)
                };
                pixels += 1;
                events += got.len();
                other += usize::from(!alike(&got, &expected));
                bent += usize::from(!alike(&got, &unlike));
            }
        }
        assert!(events > if rule == TriggerRule::Latch { 4_000 } else { 20_000 }, "{rule:?}: {events}");
        // Within rounding of a threshold or a microsecond host and device may differ.
        assert!(other * 50 < pixels, "{rule:?}: {other} of {pixels} pixels");
        assert!(bent * 3 > pixels, "{rule:?}, canary: {bent} pixels are unlike the other way");
    }
}

#[test]
fn a_curve_rises_where_samples_rise_and_rests_beside_rest() {
    // Where three samples in a row rise, whatever comes after; beside rest nothing swings.
    for (before, at, after) in [
        (Some(0.0), [1.0, 1.1], Some(9.0)),
        (Some(-5.0), [1.0, 1.1], Some(1.2)),
        (None, [1.0, 1.1], Some(9.0)),
        (Some(-5.0), [1.0, 1.1], None),
    ] {
        let ends = curve(before, at, after);
        let all = [&[at[0]], &ends[..]].concat();
        assert!(all.is_sorted() && ends[PIECES - 1] == at[1], "{before:?} {after:?}: {ends:?}");
    }
    assert_eq!(curve(Some(-5.0), [1.0, 1.0], Some(9.0)), [1.0; PIECES]);
    assert_eq!(curve(Some(0.0), [0.0, 1.0], Some(1.0)), [0.15625, 0.5, 0.84375, 1.0]);
    assert_eq!(curve(None, [0.0, 1.0], None), [0.25, 0.5, 0.75, 1.0]);
    // Parabolas are exact but where they turn: x^2 at 1, 2, 3, 4.
    assert_eq!(curve(Some(1.0), [4.0, 9.0], Some(16.0)), [5.0625, 6.25, 7.5625, 9.0]);
    assert_eq!(curve(None, [4.0, 9.0], Some(16.0)), [5.0625, 6.25, 7.5625, 9.0]);
    assert_eq!(curve(Some(1.0), [4.0, 9.0], None), [5.0625, 6.25, 7.5625, 9.0]);
}

#[test]
fn an_unknown_instant_leaves_the_pixel_as_it_was() {
    let Some(gpu) = crate::tests::device() else { return };
    let (sensors, grid) = (sensors(), SampleGrid::new(1000.0 / 3.0, 1).unwrap());
    let mut layers = layers();
    let mut planted = 0;
    for (layer, pixels) in layers.iter_mut().enumerate() {
        // The first instant sets the reference: it is always known. Some pixels are unknown twice, some to the end.
        let instant = layer as u32 / SAMPLES % INSTANTS;
        for (pixel, y) in pixels.iter_mut().enumerate() {
            let unknown = match pixel % 7 {
                0 => instant == 2,
                1 => instant == 1 || instant == 2,
                2 => instant >= 3,
                _ => false,
            };
            if unknown {
                *y = -1.0;
                planted += u32::from((layer as u32).is_multiple_of(SAMPLES));
            }
        }
    }
    for rule in [TriggerRule::Crossing, TriggerRule::Latch] {
        let ran = run(&gpu, rule, &layers, &sensors, &grid, 1 << 18, true);
        assert_eq!((ran.status.mismatched, ran.status.unknown), (0, planted), "{rule:?}");
        let got = compare(&ran, rule, &layers, &sensors, &grid);
        assert!(got.wrong.is_empty(), "{rule:?}: {} wrong, first {}", got.wrong.len(), got.wrong[0]);
        let black = run(&gpu, rule, &layers, &sensors, &grid, 1 << 18, false);
        assert_eq!(black.status.unknown, 0);
        assert!(
            !compare(&black, rule, &layers, &sensors, &grid).wrong.is_empty(),
            "canary: black is not unknown"
        );
    }
}

#[test]
fn a_full_buffer_stalls_and_writes_nothing() {
    let Some(gpu) = crate::tests::device() else { return };
    let grid = SampleGrid::new(1000.0, 1).unwrap();
    let ran = run(&gpu, TriggerRule::Crossing, &layers(), &sensors(), &grid, 64, false);
    assert_eq!(ran.status.stalled, 1);
    assert!(ran.status.event_count > 64, "the host learns how many events there are");
    assert!(ran.records.iter().all(|r| *r == [0, 0]), "nothing was emitted");
}
