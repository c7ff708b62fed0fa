//! The audit pass equals its twin.

use crate::cpu::audit::change;
use crate::gpu::commands::Commands;

use crate::cpu::audit::unpack;
use crate::gpu::sizes::UNIFORM_ALIGNMENT;
use crate::gpu::uniforms::AuditJob;
use crate::pass;
use crate::pass::adaptive::{AUDIT_BINDINGS, audit};
use crate::raster::layers::{LayerUse, Layers};
use crate::world::tiles::TILE;

use crate::tests::random_scenes::Dice;

/// Pixels within the picture of each audited tile.
const SIZES: [[u32; 2]; 6] = [[16, 16], [16, 16], [16, 16], [8, 16], [16, 7], [1, 1]];

#[test]
fn audits_equal_their_twin() {
    let Some(gpu) = crate::tests::device() else { return };
    let (device, queue) = (&gpu.device, &gpu.queue);
    let mut dice = Dice(7);
    let count = (TILE * TILE) as usize;
    let mut tile = || (0..count).map(|_| dice.between(-6.0, 3.0).exp() as f32).collect::<Vec<f32>>();
    let mut luminance: Vec<[Vec<f32>; 3]> = SIZES.iter().map(|_| [tile(), tile(), tile()]).collect();
    // One that is the same at all three, one that lies between both samples, one that is dark and below 0.
    let still = luminance[0][0].clone();
    luminance[0] = [still.clone(), still.clone(), still];
    let [now, before, after] = &mut luminance[1];
    now.iter_mut().zip(before).zip(after).for_each(|((now, a), b)| *now = 0.5 * (*a + *b));
    luminance[2][0].fill(-1.0);
    luminance[2][1].fill(0.0);
    let layers = Layers::new(device, TILE, TILE, 3 * SIZES.len() as u32, LayerUse::Computed);
    for (layer, values) in (0..).zip(luminance.iter().flatten()) {
        queue.write_texture(
            wgpu::TexelCopyTextureInfo {
                texture: &layers.texture,
                mip_level: 0,
                origin: wgpu::Origin3d { x: 0, y: 0, z: layer },
                aspect: wgpu::TextureAspect::All,
            },
            bytemuck::cast_slice(values),
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(4 * TILE), rows_per_image: None },
            wgpu::Extent3d { width: TILE, height: TILE, depth_or_array_layers: 1 },
        );
    }
    let offset = 1e-3;
    let jobs: Vec<AuditJob> = (0..).zip(SIZES).map(|(slot, size)| AuditJob { size, slot, offset }).collect();
    let bytes = crate::gpu::buffer::aligned(&jobs);
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
    let mut encoder = Commands::new(&gpu, "test");
    for slot in 0..jobs.len() as u32 {
        pass.encode_tiles(&mut encoder, &group, slot, 1);
    }
    encoder.submit(&gpu);
    let words = crate::tests::read(&gpu, &changes);
    let mut differ = 0;
    for ((size, word), luminance) in SIZES.iter().zip(&words).zip(&luminance) {
        let at = |layer: usize, x: u32, y: u32| luminance[layer][(y * TILE + x) as usize];
        let twin = change(*size, offset, at);
        // Logarithms of host and device differ by some units in the last place, which may choose another pixel too.
        let near = unpack(*word).0 - unpack(twin).0;
        assert!(near.abs() < 2e-4, "{size:?}: {:?} and {:?}", unpack(*word), unpack(twin));
        differ += usize::from((unpack(change(*size, 0.1, at)).0 - unpack(*word).0).abs() > 1e-3);
    }
    assert_eq!([0, 1, 2].map(|i| words[i] >> 8), [0; 3], "still, between both samples, as dark as black");
    assert!(words[3..5].iter().all(|word| unpack(*word).0 > 0.5), "{words:?}");
    assert!(differ >= 2, "canary: another offset");
}
