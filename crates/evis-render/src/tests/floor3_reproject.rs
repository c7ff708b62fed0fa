//! Floors 2 and 3: keyframes of light against their twin, light from them against light that was shaded, and bytes.

use crate::config::{Method, RunConfig};
use crate::cpu::reuse::Cells;
use crate::engine::Engine;
use crate::gpu::Gpu;
use crate::method::Sampling;
use crate::view;

use super::adaptive_streams::{
    apart, assert_neighbours_change_no_byte, assert_packets_and_reruns_change_no_byte, engine, force, run,
    scene,
};

fn config(method: Method) -> RunConfig {
    RunConfig {
        size: Some((128, 96)),
        rate_hz: 1000.0,
        adaptive_px: Some(0.3),
        samples: 4,
        reference_luminance: Some(1.0),
        method,
        ..Default::default()
    }
}

/// Layer `layer` of a texture of 32-bit texels, rows of which are a multiple of 256 bytes long.
fn texels(gpu: &Gpu, texture: &wgpu::Texture, layer: u32) -> Vec<u32> {
    let size = texture.size();
    let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: u64::from(size.width * size.height) * 4,
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC,
        mapped_at_creation: false,
    });
    let mut encoder = gpu.device.create_command_encoder(&Default::default());
    encoder.copy_texture_to_buffer(
        wgpu::TexelCopyTextureInfo {
            origin: wgpu::Origin3d { x: 0, y: 0, z: layer },
            ..texture.as_image_copy()
        },
        wgpu::TexelCopyBufferInfo {
            buffer: &buffer,
            layout: wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(size.width * 4),
                rows_per_image: None,
            },
        },
        wgpu::Extent3d { depth_or_array_layers: 1, ..size },
    );
    gpu.queue.submit([encoder.finish()]);
    super::read(gpu, &buffer)
}

#[test]
fn a_keyframes_means_are_their_twins() {
    let Some(gpu) = super::device() else { return };
    let mut engine = engine(&gpu, &scene("street"), &config(Method::Reproject));
    engine.deliver(1_000, 1_000).unwrap();
    let Sampling::Adaptive(room) = engine.parts().1 else { panic!("not in adaptive time") };
    let [lights, keys, means] = room.reuse().unwrap().textures(0).unwrap().map(|t| texels(&gpu, t, 0));
    let lights: Vec<f32> = lights.into_iter().map(f32::from_bits).collect();
    let (width, cells) = (128 * 4, Cells { width: 128 * 4, lights: &lights, keys: &keys });
    let (mut known, mut apart) = (0, 0);
    for (place, mean) in means.into_iter().map(f32::from_bits).enumerate() {
        let twin = cells.mean_at(place % width, place / width, 4, 0.02);
        assert_eq!(mean < 0.0, twin < 0.0, "{place}");
        assert!((mean - twin).abs() <= 1e-6 * twin.abs(), "{place}: {mean} and {twin}");
        known += usize::from(mean >= 0.0);
        apart += usize::from(mean < 0.0);
    }
    assert!(known > width * 100 && apart > width * 20, "{known} known, {apart} not");
}

#[test]
fn light_from_keyframes_is_the_light_that_would_be_shaded() {
    let Some(gpu) = super::device() else { return };
    for name in ["spinner", "street", "warehouse"] {
        let scene = scene(name);
        // 16 samples; keyframes are 32 ms apart.
        let at = |method: Method, instant: i64| {
            let config = RunConfig { samples: 16, ..config(method) };
            let mut engine = engine(&gpu, &scene, &config);
            force(&mut engine, 0);
            // The block that begins at instant 17.
            engine.instants(17, 16).unwrap().swap_remove((instant - 17) as usize)
        };
        let (shaded, later, reused) =
            (at(Method::Native, 18), at(Method::Native, 32), at(Method::Reproject, 18));
        let [median, most] = apart(&reused, &shaded, [0.5, 0.9]);
        let [far] = apart(&reused, &later, [0.5]);
        assert!(median < 0.03 && most < 0.2, "{name}: {median:.4}, {most:.4}");
        assert!(far > 2.0 * median, "{name}: canary {far:.4} beside {median:.4}");
    }
}

#[test]
fn packets_reruns_and_neighbours_change_no_byte() {
    let Some(gpu) = super::device() else { return };
    for name in ["spinner", "street"] {
        let alone = scene(name);
        let config = config(Method::Reproject);
        let ran = run(&gpu, &alone, &config, 64_000);
        let (keyframes, expected) = (ran.keyframes, ran.events);
        // At 0, 32 and 64 ms.
        assert!(expected[0].len() > 100 && keyframes == 3, "{name}: {keyframes} keyframes");
        assert_packets_and_reruns_change_no_byte(&gpu, &alone, &config, &expected);
        assert_neighbours_change_no_byte(&gpu, &alone, &config, &expected[0]);
    }
}

#[test]
fn what_reproject_cannot_do_is_refused() {
    let Some(gpu) = super::device() else { return };
    let refused = |config: RunConfig| {
        let mut config = config;
        if let Err(error) = config.check() {
            return error.to_string();
        }
        let scene = scene("desk");
        let (views, _) = view::views(&scene, &config).unwrap();
        Engine::new(&gpu, scene, views, &mut config).err().map_or(String::new(), |error| error.to_string())
    };
    let own = || config(Method::Reproject);
    let wide = gpu.device.limits().max_texture_dimension_2d / 4 + 1;
    for (config, words) in [
        (RunConfig { adaptive_px: None, ..own() }, ["adaptive_px", "reproject"]),
        (RunConfig { samples: 6, ..own() }, ["samples is 6", "multiple of 4"]),
        (RunConfig { size: Some((wide, 8)), ..own() }, ["keyframes of reproject", "--size"]),
    ] {
        let error = refused(config);
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    }
}

#[test]
fn where_the_camera_stands_still_it_is_native() {
    let Some(gpu) = super::device() else { return };
    let desk = scene("desk");
    let ran = run(&gpu, &desk, &config(Method::Reproject), 16_000);
    let (count, keyframes) = (ran.events[0].len(), ran.keyframes);
    assert!(count > 100 && keyframes == 0, "{count} events, {keyframes} keyframes");
}
