//! The whole sensor chain: generator, walk and feed against the CPU's, on the same light.

use evis_core::event::take_causes;
use evis_core::random::{Key, StreamId, philox};
use evis_core::sensor::{
    Bandwidth, Curve, FilterRule, LeakLaw, Noise, NoiseReference, PRESETS, Pattern, Photoreceptor, Readout,
    Refractory, RefractoryRule, Start,
};
use evis_core::{
    Cause, EmulatorConfig, Event, EventEmulator, FrameData, Frames, SensorConfig, Times, TriggerRule,
};
use evis_scene::{PixelLens, Rays};

use crate::config::grid::SampleGrid;
use crate::gpu::Gpu;
use crate::gpu::commands::Commands;
use crate::gpu::readback::{map, wait_mapped};
use crate::gpu::shader::compose;
use crate::gpu::sizes::Plan;
use crate::gpu::uniforms::{Status, ViewSensor};
use crate::raster::layers::LayerUse;
use crate::sensor::chain::GroupChain;
use crate::sensor::group::{Group, Slot, Unit};
use crate::sensor::passes::{Blocks, TriggerPasses};
use crate::sensor::step::encode_trigger;
use crate::sensor::targets::Targets;
use crate::sensor::trigger::trigger_steps;
use crate::sensor::unpack;
use crate::world::view::View;

const WIDTH: u32 = 83;
const HEIGHT: u32 = 17;
const PIXELS: usize = (WIDTH * HEIGHT) as usize;
const VIEWS: usize = 2;
const SEED: u64 = 5;

/// A number in (0, 1) for `a` and `b`: test inputs only.
fn random(a: usize, b: u32) -> f64 {
    f64::from(philox([a as u32, b, 77, 0], [3, 4])[0]) / 4_294_967_296.0
}

/// Light of `pixel` of `view` at `t_us`, relative to `Y_ref`: waves, steps, darkness, glare and rest.
fn light(view: usize, pixel: usize, t_us: i64) -> f32 {
    let seed = pixel + 10_000 * view;
    let t = t_us as f64 * 1e-6;
    let level = 10_f64.powf(random(seed, 0) * 3.0 - 2.0);
    let wave = (random(seed, 1) * 2.0 * (40.0 * random(seed, 2) * t + 6.0 * random(seed, 3)).sin()).exp();
    let light = match pixel % 11 {
        0 => 0.0,
        1 => level,
        2 if t_us > 20_000 => 3.0 * level,
        2 => level,
        3 => level * (1.0 + 8.0 * t),
        _ => level * wave,
    };
    light as f32
}

/// What a run of the device gave.
struct Ran {
    events: Vec<Vec<Event>>,
    status: Status,
}

fn view(index: usize, sensor: &SensorConfig) -> View {
    let lens = PixelLens {
        width: WIDTH,
        height: HEIGHT,
        focal: [50.0; 2],
        center: [30.0; 2],
        near: 0.1,
        rays: Rays::Central,
    };
    View {
        environment: index,
        camera: 0,
        node: 0,
        sensor: sensor.clone(),
        key: Key::new(SEED, index as u32, 0),
        lens,
        own_lens: lens,
        distorted: None,
    }
}

/// The device over `instants` of `grid`, cut into submissions of these lengths in turn.
fn run(
    gpu: &Gpu,
    sensor: &SensorConfig,
    grid: &SampleGrid,
    instants: u32,
    cuts: &[u32],
    light: impl Fn(usize, usize, i64) -> f32,
) -> Ran {
    run_with_lists(gpu, sensor, grid, instants, cuts, light, u32::MAX)
}

/// The same with room for so many lists of pixels that wake.
fn run_with_lists(
    gpu: &Gpu,
    sensor: &SensorConfig,
    grid: &SampleGrid,
    instants: u32,
    cuts: &[u32],
    light: impl Fn(usize, usize, i64) -> f32,
    lists: u32,
) -> Ran {
    let longest = cuts.iter().copied().max().unwrap();
    let plan = Plan { views_per_group: VIEWS as u32, instants: longest, layers: VIEWS as u32 * longest };
    let passes = TriggerPasses::new(&gpu.device, &[(sensor, 1)], true, Blocks::NONE, None);
    let chain = passes.chain(0).expect("more than thresholds");
    let mut targets =
        Targets::new(&gpu.device, WIDTH, HEIGHT, plan, LayerUse::Rendered, Some(&chain.plan), 1);
    if let Some(chain) = &mut targets.chain {
        chain.list_count = chain.list_count.min(lists);
    }
    let views: Vec<View> = (0..VIEWS).map(|v| view(v, sensor)).collect();
    let own: Vec<_> = views.iter().map(View::sensing).collect();
    let group_chain = GroupChain::new(gpu, &chain.plan, [WIDTH, HEIGHT], &own, 1.0);
    let sensors = vec![ViewSensor::default(); VIEWS];
    let mut group = Group::new(gpu, 0, &targets, (0..VIEWS).collect(), &sensors, Some((chain, group_chain)));
    let mut ran = Ran { events: vec![Vec::new(); VIEWS], status: Status::default() };
    let mut first = 0;
    // The first instant is a unit of its own.
    for cut in std::iter::once(1).chain(cuts.iter().copied().cycle()) {
        let count = cut.min(instants - first as u32);
        if count == 0 {
            break;
        }
        let unit = Unit { group: 0, first, instants: count };
        for v in 0..VIEWS {
            for k in 0..count {
                let t_us = grid.instant_us(first + i64::from(k));
                let pixels: Vec<f32> = (0..PIXELS).map(|p| light(v, p, t_us)).collect();
                gpu.queue.write_texture(
                    wgpu::TexelCopyTextureInfo {
                        texture: &targets.layers.texture,
                        mip_level: 0,
                        origin: wgpu::Origin3d { x: 0, y: 0, z: v as u32 * count + k },
                        aspect: wgpu::TextureAspect::All,
                    },
                    bytemuck::cast_slice(&pixels),
                    wgpu::TexelCopyBufferLayout {
                        offset: 0,
                        bytes_per_row: Some(WIDTH * 4),
                        rows_per_image: Some(HEIGHT),
                    },
                    wgpu::Extent3d { width: WIDTH, height: HEIGHT, depth_or_array_layers: 1 },
                );
            }
        }
        let mut slot = Slot::new(&gpu.device, 1 << 20, group.header_bytes());
        let words = group.chain.as_mut().unwrap().feed(unit.base_us(grid), unit.end_us(grid));
        slot.feed(gpu, &words);
        let mut encoder = Commands::new(gpu, "test");
        encoder.clear_buffer(&group.status, size_of::<Status>() as u64, None);
        let steps = trigger_steps(gpu, &passes, grid, &targets, &group, &unit, &slot, None);
        encode_trigger(&mut encoder, &steps);
        let (header, status_bytes) = (group.header_bytes(), size_of::<Status>());
        encoder.copy_buffer_to_buffer(&group.status, 0, &slot.staging, 0, status_bytes as u64);
        let offsets = 4 * (VIEWS as u64 + 1);
        encoder.copy_buffer_to_buffer(&group.view_offsets, 0, &slot.staging, status_bytes as u64, offsets);
        encoder.copy_buffer_to_buffer(&slot.events, 0, &slot.staging, header, slot.events.size());
        let submission = encoder.submit(gpu);
        wait_mapped(gpu, &submission, &map(&slot.staging)).unwrap();
        let bytes = slot.staging.get_mapped_range(..).unwrap();
        let status: Status = bytemuck::pod_read_unaligned(&bytes[..status_bytes]);
        assert_eq!((status.stalled, status.mismatched), (0, 0));
        let offsets: Vec<u32> =
            bytes[status_bytes..].chunks_exact(4).take(VIEWS + 1).map(bytemuck::pod_read_unaligned).collect();
        let records: Vec<[u32; 2]> = bytes[header as usize..]
            .chunks_exact(8)
            .take(status.event_count as usize)
            .map(bytemuck::pod_read_unaligned)
            .collect();
        for (v, range) in offsets.windows(2).enumerate() {
            let mut fired =
                unpack::events(&records[range[0] as usize..range[1] as usize], unit.base_us(grid), true);
            match group.chain.as_mut().unwrap().readouts.get_mut(v) {
                Some(readout) => {
                    readout.pass(&mut fired, unit.end_us(grid), &mut ran.events[v]);
                }
                None => {
                    fired.sort_by_key(Event::order);
                    ran.events[v].extend(fired);
                }
            }
        }
        ran.status = status;
        group.parity = 1 - group.parity;
        first += i64::from(count);
    }
    ran
}

/// The emulator on the same light; events are marked with their causes, as the device's are.
fn emulate(
    sensor: &SensorConfig,
    grid: &SampleGrid,
    instants: u32,
    light: impl Fn(usize, usize, i64) -> f32,
) -> (Vec<Vec<Event>>, u64) {
    let mut emulator = EventEmulator::new(EmulatorConfig {
        width: WIDTH,
        height: HEIGHT,
        batch: VIEWS,
        seed: SEED,
        sensor: sensor.clone(),
        threads: 1,
        causes: true,
        ..EmulatorConfig::default()
    })
    .unwrap();
    let mut out = vec![Vec::new(); VIEWS];
    for k in 0..instants {
        let t_us = grid.instant_us(i64::from(k));
        let frame: Vec<f32> = (0..VIEWS)
            .flat_map(|v| (0..PIXELS).map(move |p| (v, p)))
            .map(|(v, p)| light(v, p, t_us))
            .collect();
        let frame: Vec<f32> = frame.into_iter().map(|y| if y < 0.0 { f32::NAN } else { y }).collect();
        let frames = Frames { data: FrameData::Linear(&frame), channels: 1 };
        let mut lists = emulator.push(&frames, t_us).unwrap();
        for ((out, list), causes) in out.iter_mut().zip(&mut lists).zip(emulator.causes()) {
            assert_eq!(list.len(), causes.len());
            let marked = list.iter().zip(causes).map(|(e, c)| e.with_cause(Cause::ALL[usize::from(*c)]));
            out.extend(marked);
        }
    }
    (out, emulator.total_report().suppressed)
}

/// How two streams of one sensor differ.
#[derive(Debug, Default)]
struct Difference {
    events: usize,
    pixels: usize,
    /// Pixels whose polarities, in order, are not the same.
    flipped: usize,
    /// Events of the others whose times are more than a microsecond apart.
    late: usize,
    /// Events of theirs that are the same to the microsecond.
    same: usize,
    /// Those of them that have another cause.
    other_cause: usize,
}

impl Difference {
    /// One pixel in 200 may have another sequence, one event in 200 another time: f32 here, f64 there, and a time that
    /// falls to the other side of a draw's 2^12 us takes another draw.
    fn is_close(&self) -> bool {
        let few = self.flipped * 200 <= self.pixels && self.late * 200 <= self.events;
        few && self.other_cause * 200 <= self.events
            && self.events > 300
            && self.same * 100 > self.events * 95
    }
}

/// Time, polarity and cause of an event.
type Fired = (i64, i16, u8);

/// Events, pixel by pixel.
fn by_pixel(events: &[Event]) -> Vec<Vec<Fired>> {
    let mut out = vec![Vec::new(); PIXELS];
    for event in events {
        out[usize::from(event.y) * WIDTH as usize + usize::from(event.x)].push((
            event.t,
            event.p,
            take_causes(&mut [*event])[0],
        ));
    }
    out
}

/// Changes of light, relative, by which the emulator is asked how near it was to another answer.
const LADDER: [f32; 3] = [1e-6, 1e-5, 1e-4];
/// What rounding in f32 may stand for: a logarithm of 5 has a spacing of 5e-7, and filters and references add some up.
const BAND: f32 = 1e-5;

/// Per pixel how `a` and `b` differ: 2 by another order of polarities, 1 by a time more than a microsecond away.
fn differences(a: &[Vec<Event>], b: &[Vec<Event>]) -> Vec<u8> {
    let pair = |(a, b): (Vec<Fired>, Vec<Fired>)| {
        if !a.iter().map(|e| e.1).eq(b.iter().map(|e| e.1)) {
            return 2;
        }
        u8::from(a.iter().zip(&b).any(|(a, b)| a.0.abs_diff(b.0) > 1))
    };
    a.iter().zip(b).flat_map(|(a, b)| by_pixel(a).into_iter().zip(by_pixel(b)).map(pair)).collect()
}

/// How near each pixel that differs between `device` and `cpu` was to another answer: the least rung of [`LADDER`] by
/// which the emulator's own light must change for it to differ as much. Pixels per rung; last, those beyond all.
fn nearness(
    sensor: &SensorConfig,
    grid: &SampleGrid,
    instants: u32,
    device: &[Vec<Event>],
    cpu: &[Vec<Event>],
) -> [usize; LADDER.len() + 1] {
    let mut open = differences(device, cpu);
    let mut found = [0; LADDER.len() + 1];
    let step = grid.instant_us(1);
    for (found, change) in found.iter_mut().zip(LADDER) {
        // Of the first instant, of every other one, of every other pair, and at random; up and down.
        for pattern in 0..8_u32 {
            if open.iter().all(|d| *d == 0) {
                break;
            }
            let nudged = |view: usize, pixel: usize, t_us: i64| {
                let k = ((t_us + step / 2) / step) as u32;
                let up = match pattern / 2 {
                    0 => k == 0,
                    1 => k.is_multiple_of(2),
                    2 => k % 4 < 2,
                    _ => random(pixel + 10_000 * view, 1000 + k) < 0.5,
                };
                let sign = if up == (pattern % 2 == 0) { 1.0 } else { -1.0 };
                light(view, pixel, t_us) * (1.0 + sign * change)
            };
            let (other, _) = emulate(sensor, grid, instants, nudged);
            for (open, differs) in open.iter_mut().zip(differences(&other, cpu)) {
                if *open > 0 && differs >= *open {
                    *found += 1;
                    *open = 0;
                }
            }
        }
    }
    found[LADDER.len()] = open.iter().filter(|d| **d > 0).count();
    found
}

/// Pixels of [`nearness`] that were not within [`BAND`] of another answer.
fn beyond_band(found: &[usize; LADDER.len() + 1]) -> usize {
    let within = LADDER.iter().filter(|rung| **rung <= BAND).count();
    found[within..].iter().sum()
}

fn compare(device: &[Vec<Event>], cpu: &[Vec<Event>]) -> Difference {
    let mut found = Difference::default();
    for (device, cpu) in device.iter().zip(cpu) {
        found.events += cpu.len();
        for (a, b) in by_pixel(device).iter().zip(&by_pixel(cpu)) {
            found.pixels += 1;
            if !a.iter().map(|e| e.1).eq(b.iter().map(|e| e.1)) {
                found.flipped += 1;
                continue;
            }
            for (a, b) in a.iter().zip(b) {
                found.late += usize::from(a.0.abs_diff(b.0) > 1);
                found.same += usize::from(a.0 == b.0);
                found.other_cause += usize::from(a.0 == b.0 && a.2 != b.2);
            }
        }
    }
    found
}

/// Every stage, alone and in company.
fn sensors() -> Vec<(String, SensorConfig)> {
    let plain = SensorConfig::default();
    let receptor = |photoreceptor| SensorConfig { photoreceptor, ..plain.clone() };
    let noise = |noise| SensorConfig { noise, ..plain.clone() };
    let pole = Photoreceptor { cutoff_hz: 60.0, ..Photoreceptor::default() };
    let refractory = |rule| SensorConfig {
        refractory: Refractory { period_us: 1700, rule },
        pattern: Pattern { sigma: 0.03, ..Pattern::default() },
        noise: Noise { shot_hz: 40.0, shot_light_share: 0.5, ..Noise::default() },
        ..plain.clone()
    };
    let times = |times| SensorConfig { times, ..refractory(RefractoryRule::Suppress) };
    let mut all: Vec<(&str, SensorConfig)> = vec![
        ("dark light", receptor(Photoreceptor { dark_light: 0.05, ..Photoreceptor::default() })),
        ("linlog", receptor(Photoreceptor { curve: Curve::Linlog, ..Photoreceptor::default() })),
        ("one pole", receptor(pole)),
        ("two poles", receptor(Photoreceptor { order: 2, ..pole })),
        ("Euler", receptor(Photoreceptor { filter: FilterRule::Euler, ..pole })),
        ("two Euler poles", receptor(Photoreceptor { filter: FilterRule::Euler, order: 2, ..pole })),
        (
            "light-dependent pole",
            receptor(Photoreceptor { bandwidth: Bandwidth::Light, bandwidth_offset: 0.02, ..pole }),
        ),
        (
            "two light-dependent poles",
            receptor(Photoreceptor { bandwidth: Bandwidth::Light, order: 2, dark_light: 0.01, ..pole }),
        ),
        (
            "pattern",
            SensorConfig {
                pattern: Pattern { sigma: 0.04, dead_share: 0.1, start: Start::Phase, ..Pattern::default() },
                ..plain.clone()
            },
        ),
        (
            "dead pixels",
            SensorConfig { pattern: Pattern { dead_share: 0.3, ..Pattern::default() }, ..plain.clone() },
        ),
        ("leak", noise(Noise { leak_hz: 30.0, ..Noise::default() })),
        (
            "jittered leak",
            noise(Noise { leak_hz: 25.0, leak_jitter: 0.1, leak_spread_decades: 0.2, ..Noise::default() }),
        ),
        ("leak at random", noise(Noise { leak_hz: 20.0, leak_law: LeakLaw::Poisson, ..Noise::default() })),
        (
            "leaking pole",
            SensorConfig { noise: Noise { leak_hz: 20.0, ..Noise::default() }, ..receptor(pole) },
        ),
        (
            "shot noise",
            noise(Noise {
                shot_hz: 50.0,
                shot_light_share: 0.9,
                shot_light_offset: 0.1,
                reference: NoiseReference::Signal,
                ..Noise::default()
            }),
        ),
        ("bursts", noise(Noise { shot_hz: 50.0, burst_events: 1.0, alternation: 0.9, ..Noise::default() })),
        (
            "recovery",
            noise(Noise { shot_hz: 90.0, shot_recovery_us: 9000.0, burst_events: 0.5, ..Noise::default() }),
        ),
        (
            "recovery in a refractory pixel",
            SensorConfig {
                noise: Noise {
                    shot_hz: 90.0,
                    shot_recovery_us: 9000.0,
                    alternation: 0.3,
                    ..Noise::default()
                },
                ..refractory(RefractoryRule::Hold)
            },
        ),
        ("hot pixels", noise(Noise { hot_share: 0.1, hot_hz: 900.0, ..Noise::default() })),
        ("suppress", refractory(RefractoryRule::Suppress)),
        ("defer", refractory(RefractoryRule::Defer)),
        ("hold", refractory(RefractoryRule::Hold)),
        ("latch", SensorConfig { trigger: TriggerRule::Latch, ..refractory(RefractoryRule::Defer) }),
        ("latch and hold", SensorConfig { trigger: TriggerRule::Latch, ..refractory(RefractoryRule::Hold) }),
        ("times of samples", times(Times::Sample)),
        ("even times", times(Times::Even)),
        ("shared times", times(Times::Shared)),
        ("shared times alone", SensorConfig { times: Times::Shared, ..plain.clone() }),
        ("few events", SensorConfig { most_events: 2, ..plain.clone() }),
        (
            "readout",
            SensorConfig {
                readout: Readout {
                    latency_us: 300.0,
                    latency_light_us: 40.0,
                    jitter_us: 80.0,
                    tick_us: 4,
                    ..Readout::default()
                },
                ..plain
            },
        ),
    ];
    all.extend(PRESETS.iter().map(|preset| (preset.name, preset.sensor())));
    all.into_iter()
        .filter(|(_, sensor)| !sensor.is_ideal() && !sensor.walks_on_host())
        .map(|(name, sensor)| (name.to_owned(), sensor))
        .collect()
}

#[test]
fn the_chain_is_the_emulators() {
    let Some(gpu) = crate::tests::device() else { return };
    let grid = SampleGrid::new(1000.0, 1).unwrap();
    let mut failed = Vec::new();
    let mut rungs = [0; LADDER.len() + 1];
    for (name, sensor) in sensors() {
        let (cpu, suppressed) = emulate(&sensor, &grid, 60, light);
        let ran = run(&gpu, &sensor, &grid, 60, &[7, 1, 12], light);
        let got = compare(&ran.events, &cpu);
        let near = nearness(&sensor, &grid, 60, &ran.events, &cpu);
        if beyond_band(&near) > 0 {
            failed.push(format!("{name}: {near:?} pixels by {LADDER:?} and beyond"));
        }
        rungs.iter_mut().zip(near).for_each(|(sum, n)| *sum += n);
        if !got.is_close() || ran.status.suppressed.abs_diff(suppressed as u32) > 20 {
            failed.push(format!("{name}: {got:?}, {} for {suppressed} suppressed", ran.status.suppressed));
        }
    }
    println!(
        "pixels that differ, by the change of light that explains them, {LADDER:?} and beyond: {rungs:?}"
    );
    assert!(failed.is_empty(), "{failed:#?}");
    assert!(rungs.iter().sum::<usize>() > 0, "the band is empty: nothing was near it");
}

#[test]
fn few_lists_of_pixels_that_wake_change_no_byte() {
    let Some(gpu) = crate::tests::device() else { return };
    let grid = SampleGrid::new(1000.0, 1).unwrap();
    let sensor = SensorConfig::preset("v2e").unwrap();
    let expected = run(&gpu, &sensor, &grid, 60, &[32], light);
    assert!(expected.events[0].len() > 1000);
    for lists in [2, 3, 31] {
        let few = run_with_lists(&gpu, &sensor, &grid, 60, &[32], light, lists);
        assert!(few.events == expected.events && few.status == expected.status, "{lists} lists");
    }
}

#[test]
fn canary_the_comparison_rejects_other_sensors() {
    let Some(gpu) = crate::tests::device() else { return };
    let grid = SampleGrid::new(1000.0, 1).unwrap();
    let mut rejected = 0;
    for name in ["openeb", "v2e-noisy"] {
        let sensor = SensorConfig::preset(name).unwrap();
        let ran = run(&gpu, &sensor, &grid, 30, &[12], light);
        let (same, _) = emulate(&sensor, &grid, 30, light);
        assert!(compare(&ran.events, &same).is_close());
        let mutations: [fn(&mut SensorConfig); 5] = [
            |sensor| sensor.threshold_on *= 1.02,
            |sensor| sensor.photoreceptor.cutoff_hz *= 1.02,
            |sensor| sensor.pattern.sigma *= 1.1,
            |sensor| sensor.noise.hot_share += 0.01,
            |sensor| sensor.noise.leak_hz += 3.0,
        ];
        for mutate in mutations {
            let mut other = sensor.clone();
            mutate(&mut other);
            // Hot pixels are drawn from the same words: those that are new have no rate to show it with.
            other.noise.hot_hz = 1000.0 * f32::from(u8::from(other.noise.hot_share > 0.0));
            let (events, _) = emulate(&other, &grid, 30, light);
            let got = compare(&ran.events, &events);
            assert!(!got.is_close(), "{name}: {got:?}");
            let near = nearness(&other, &grid, 30, &ran.events, &events);
            assert!(beyond_band(&near) > 0, "{name}: {near:?}");
            rejected += 1;
        }
    }
    assert_eq!(rejected, 10);
}

/// Light that never changes.
fn rest(view: usize, pixel: usize, _: i64) -> f32 {
    10_f64.powf(random(pixel + 10_000 * view, 0) * 2.0 - 2.0) as f32
}

/// Sensors whose every event at rest is noise.
fn noises() -> Vec<(&'static str, SensorConfig)> {
    let of = |noise| SensorConfig { noise, ..SensorConfig::default() };
    let shot = Noise { shot_hz: 20.0, ..Noise::default() };
    vec![
        ("shot", of(shot)),
        ("dim", of(Noise { shot_light_share: 0.8, shot_light_offset: 0.1, on_share: 0.3, ..shot })),
        ("spread", of(Noise { shot_spread_decades: 0.3, shot_per_threshold: true, ..shot })),
        ("bursts", of(Noise { burst_events: 1.5, burst_us: 800.0, alternation: 0.8, ..shot })),
        ("hot", of(Noise { hot_share: 0.1, hot_hz: 400.0, ..Noise::default() })),
        (
            "leak",
            of(Noise {
                leak_hz: 20.0,
                leak_law: LeakLaw::Poisson,
                leak_spread_decades: 0.2,
                reference: NoiseReference::Signal,
                ..Noise::default()
            }),
        ),
        (
            "refractory",
            SensorConfig {
                refractory: Refractory { period_us: 3000, rule: RefractoryRule::Hold },
                pattern: Pattern { sigma: 0.02, dead_share: 0.1, ..Pattern::default() },
                ..of(shot)
            },
        ),
    ]
}

#[test]
fn noise_at_rest_is_the_emulators_to_the_last_event() {
    let Some(gpu) = crate::tests::device() else { return };
    for (rate_hz, instants) in [(30.0, 9), (300.0, 90), (3000.0, 900)] {
        let grid = SampleGrid::new(rate_hz, 1).unwrap();
        for (name, sensor) in noises() {
            let (cpu, suppressed) = emulate(&sensor, &grid, instants, rest);
            let ran = run(&gpu, &sensor, &grid, instants, &[5, 32, 1], rest);
            assert!(cpu[0].len() > 1000, "{name}: {}", cpu[0].len());
            assert!(ran.events == cpu, "{name} at {rate_hz} Hz");
            assert_eq!(u64::from(ran.status.suppressed), suppressed);
            assert!(cpu[0] != cpu[1], "canary: environments differ");
        }
    }
}

#[test]
fn unknown_light_leaves_the_pixel_and_its_noise() {
    let Some(gpu) = crate::tests::device() else { return };
    let grid = SampleGrid::new(1000.0, 1).unwrap();
    // The first instant is known, as it always is.
    let patchy = |view: usize, pixel: usize, t_us: i64| {
        let gone = t_us > 0 && random(pixel, (t_us / 7000) as u32) < 0.4;
        if gone { -1.0 } else { light(view, pixel, t_us) }
    };
    for name in ["v2e-noisy", "gen4-like", "evis", "openeb"] {
        let mut sensor = SensorConfig::preset(name).unwrap();
        sensor.noise.shot_hz = 20.0;
        let (cpu, _) = emulate(&sensor, &grid, 40, patchy);
        let ran = run(&gpu, &sensor, &grid, 40, &[9, 4], patchy);
        let got = compare(&ran.events, &cpu);
        assert!(got.is_close() && ran.status.unknown > 10_000, "{name}: {got:?} {}", ran.status.unknown);
        let known = run(&gpu, &sensor, &grid, 40, &[9, 4], light);
        assert!(!compare(&known.events, &cpu).is_close(), "canary: {name}");
        assert_eq!(known.status.unknown, 0);
    }
}

/// Whether `got` events of a Poisson process of mean `expected` are within five standard deviations of it.
fn is_met(got: usize, expected: f64) -> bool {
    (got as f64 - expected).abs() < 5.0 * expected.sqrt()
}

#[test]
fn every_noise_rate_is_met_at_every_sampling_rate() {
    let Some(gpu) = crate::tests::device() else { return };
    let grey = |_: usize, _: usize, _: i64| 0.5;
    let pixels = (PIXELS * VIEWS) as f64;
    for (rate_hz, instants) in [(30.0, 31), (300.0, 301), (3000.0, 3001)] {
        let grid = SampleGrid::new(rate_hz, 1).unwrap();
        let count = |sensor: &SensorConfig| -> Vec<Event> {
            run(&gpu, sensor, &grid, instants, &[32], grey).events.concat()
        };
        let of = |noise| SensorConfig { noise, ..SensorConfig::default() };
        // One second each.
        let shot =
            count(&of(Noise { shot_hz: 8.0, shot_light_share: 0.5, on_share: 0.25, ..Noise::default() }));
        let expected = pixels * 8.0 * (1.0 - 0.5 * 0.5);
        assert!(is_met(shot.len(), expected), "shot noise at {rate_hz} Hz: {} for {expected}", shot.len());
        assert!(!is_met(shot.len(), 1.06 * expected), "canary");
        let on = shot.iter().filter(|event| event.p == 1).count();
        assert!(is_met(on, 0.25 * expected), "{on} ON events");

        let leak = Noise { leak_hz: 8.0, leak_law: LeakLaw::Poisson, ..Noise::default() };
        let random_leak = count(&of(leak)).len();
        assert!(is_met(random_leak, 8.0 * pixels), "random leak at {rate_hz} Hz: {random_leak}");
        // A ramp is regular: one period after the other, the last one cut off.
        let ramp = count(&of(Noise { leak_hz: 8.5, leak_jitter: 0.05, leak_law: LeakLaw::Ramp, ..leak }));
        let share = ramp.len() as f64 / pixels / 8.0;
        assert!((share - 1.0).abs() < 0.01 && ramp.iter().all(|event| event.p == 1), "ramp: {share}");

        let hot = count(&of(Noise { hot_share: 0.05, hot_hz: 200.0, ..Noise::default() }));
        let expected = pixels * 0.05;
        let mut places: Vec<_> = hot.iter().map(|event| (event.x, event.y)).collect();
        places.sort_unstable();
        places.dedup();
        // Both views have their own: a few fall together.
        assert!(is_met(places.len(), expected * (1.0 - 0.05 / 4.0)), "{} hot pixels", places.len());
        assert!((hot.len() as f64 / (200.0 * expected) - 1.0).abs() < 5.0 / expected.sqrt(), "{}", hot.len());
    }
}

#[test]
fn the_generator_gives_the_published_answers_on_the_device() {
    let Some(gpu) = crate::tests::device() else { return };
    let main = "
        @group(0) @binding(0) var<storage, read_write> words: array<vec4<u32>>;
        @compute @workgroup_size(1)
        fn main() {
            words[0] = philox(vec4<u32>(0u), vec2<u32>(0u));
            words[1] = philox(vec4<u32>(0xffffffffu), vec2<u32>(0xffffffffu));
            words[2] = philox(
                vec4<u32>(0x243f6a88u, 0x85a308d3u, 0x13198a2eu, 0x03707344u), vec2<u32>(0xa4093822u, 0x299f31d0u));
            let low = 0x89abcdefu;
            words[3] = draw(vec2<u32>(words[0].x, words[1].y), 77u, 7u, low, 0x12345u, 3u);
            words[4] = vec4<u32>(bitcast<u32>(unit(0u)), bitcast<u32>(unit(0xffffffffu)), 0u, 0u);
        }";
    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: None,
        source: wgpu::ShaderSource::Wgsl((compose("chain/philox.wgsl", "") + main).into()),
    });
    let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: None,
        layout: None,
        module: &module,
        entry_point: Some("main"),
        compilation_options: Default::default(),
        cache: None,
    });
    let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: 80,
        usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
        mapped_at_creation: false,
    });
    let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: None,
        layout: &pipeline.get_bind_group_layout(0),
        entries: &[wgpu::BindGroupEntry { binding: 0, resource: buffer.as_entire_binding() }],
    });
    let mut encoder = Commands::new(&gpu, "test");
    encoder.compute("philox").dispatch(&pipeline, &group, &[], (1, 1, 1));
    encoder.submit(&gpu);
    let got = crate::tests::read(&gpu, &buffer);
    // Known answers of the authors' library, Random123, file kat_vectors, philox4x32 10.
    let known = [
        0x6627_e8d5,
        0xe169_c58d,
        0xbc57_ac4c,
        0x9b00_dbd8,
        0x408f_276d,
        0x41c8_3b0e,
        0xa20b_c7c6,
        0x6d54_51fd,
        0xd16c_fe09,
        0x94fd_cceb,
        0x5001_e420,
        0x2412_6ea1,
    ];
    assert_eq!(got[..12], known);
    // The key that the device used is made of its own words: the CPU's draw from the same.
    let t_us = (0x12345_i64 << 32) | 0x89ab_cdef;
    let epoch = t_us >> evis_core::random::EPOCH_SHIFT;
    let high = ((epoch >> 32) as u32 & 0x00ff_ffff) | ((StreamId::LeakJitter as u32) << 24);
    let expected = philox([77, epoch as u32, high, 3], [known[0], known[5]]);
    assert_eq!(got[12..16], expected);
    assert_ne!(got[12..16], philox([77, epoch as u32, high, 4], [known[0], known[5]]), "canary");
    assert_eq!(got[16..18], [0, u32::MAX].map(|word| evis_core::random::unit_f32(word).to_bits()));
}
