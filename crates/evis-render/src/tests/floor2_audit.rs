//! Floor 2: the audit pass equals its twin.

use crate::cpu::audit::{change, unpack};
use crate::pass::adaptive::{AUDIT_BINDINGS, audit};
use crate::pass::{self, raster::UNIFORM_ALIGNMENT};
use crate::targets::{LayerUse, Layers};
use crate::tiles::TILE;
use crate::uniforms::AuditJob;

use super::random_scenes::Dice;

const SIZE: [u32; 2] = [40, 23];

#[test]
fn audits_equal_their_twin() {
    let Some(gpu) = super::device() else { return };
    let (device, queue) = (&gpu.device, &gpu.queue);
    let mut dice = Dice(7);
    let count = (SIZE[0] * SIZE[1]) as usize;
    let mut luminance: Vec<Vec<f32>> = (0..3)
        .map(|_| (0..count).map(|_| dice.between(-6.0, 3.0).exp() as f32).collect())
        .collect();
    // A tile that is the same at all three, one that lies between both samples, one that is dark and below 0.
    for (x, y) in (0..TILE).flat_map(|y| (0..TILE).map(move |x| (x, y))) {
        let i = (y * SIZE[0] + x) as usize;
        luminance[1][i] = luminance[0][i];
        luminance[2][i] = luminance[0][i];
        let i = i + TILE as usize;
        luminance[0][i] = 0.5 * (luminance[1][i] + luminance[2][i]);
        if y + TILE < SIZE[1] {
            let i = ((y + TILE) * SIZE[0] + x) as usize;
            (luminance[0][i], luminance[1][i]) = (-1.0, 0.0);
        }
    }
    let layers = Layers::new(device, SIZE[0], SIZE[1], 3, LayerUse::Computed);
    for (layer, values) in (0..).zip(&luminance) {
        queue.write_texture(
            wgpu::TexelCopyTextureInfo {
                texture: &layers.texture,
                mip_level: 0,
                origin: wgpu::Origin3d { x: 0, y: 0, z: layer },
                aspect: wgpu::TextureAspect::All,
            },
            bytemuck::cast_slice(values),
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * SIZE[0]), rows_per_image: None },
            wgpu::Extent3d { width: SIZE[0], height: SIZE[1], depth_or_array_layers: 1 },
        );
    }
    let corners = [[0, 0], [16, 0], [32, 0], [0, 16], [16, 16], [32, 16]];
    let offset = 1e-3;
    let jobs: Vec<AuditJob> =
        (0..).zip(corners).map(|(slot, corner)| AuditJob { corner, slot, offset }).collect();
    let bytes = crate::frame_buffers::aligned(&jobs);
    assert_eq!(bytes.len() as u64, jobs.len() as u64 * UNIFORM_ALIGNMENT);
    let buffer = |size, usage| {
        device.create_buffer(&wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false })
    };
    let uniforms = buffer(bytes.len() as u64, wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST);
    queue.write_buffer(&uniforms, 0, &bytes);
    let changes = buffer(4 * jobs.len() as u64, wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC);
    let pass = audit(device);
    let group = pass::group(
        device,
        "audit",
        &pass.layout,
        AUDIT_BINDINGS,
        vec![
            pass::part(&uniforms, 0, size_of::<AuditJob>() as u64),
            wgpu::BindingResource::TextureView(&layers.array),
            changes.as_entire_binding(),
        ],
    );
    let mut encoder = device.create_command_encoder(&Default::default());
    for slot in 0..jobs.len() as u32 {
        pass.encode_tiles(&mut encoder, &group, slot, 1);
    }
    queue.submit([encoder.finish()]);
    let words = super::read(&gpu, &changes);
    let at = |layer: usize, x: u32, y: u32| {
        (x < SIZE[0] && y < SIZE[1]).then(|| luminance[layer][(y * SIZE[0] + x) as usize])
    };
    let mut differ = 0;
    for (corner, word) in corners.iter().zip(&words) {
        let twin = change(*corner, offset, at);
        // Logarithms of host and device differ by some units in the last place, which may choose another pixel too.
        let near = unpack(*word).0 - unpack(twin).0;
        assert!(near.abs() < 2e-4, "{corner:?}: {:?} and {:?}", unpack(*word), unpack(twin));
        differ += usize::from(unpack(change(*corner, 0.1, at)).0 - unpack(*word).0 < -1e-3);
    }
    assert_eq!([words[0] >> 8, words[1] >> 8], [0, 0], "still, and between both samples");
    assert!(words[2..].iter().all(|word| unpack(*word).0 > 0.5), "{words:?}");
    assert!(differ > 2, "canary: another offset");
}
