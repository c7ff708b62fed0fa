//! Needs nothing: WGSL validates; layouts, bindings and constants agree; no orphan shader.

use std::collections::{BTreeMap, BTreeSet};
use std::mem::offset_of;

use evis_core::random::StreamId;
use naga::{AddressSpace, ImageClass, ImageDimension, StorageAccess, TypeInner};

use crate::pass::raster::FRAME_BINDINGS;

use crate::pass::raster::MATERIAL_BINDINGS;

use crate::gpu::shader::{self, compose};
use crate::gpu::uniforms;
use crate::gpu::variant::{Interface, LightSet, SurfaceVariant, frame_prelude, prelude};
use crate::pass::raster::SURROUNDINGS_BINDINGS;
use crate::pass::shadow_map::RESTORE_BINDINGS;
use crate::pass::{Access, Binding, adaptive, decoupled, labels, resample, splat, trigger};

fn every_feature() -> SurfaceVariant {
    SurfaceVariant {
        model: 2,
        base_texture: true,
        metallic_roughness_texture: true,
        normal_texture: true,
        occlusion_texture: true,
        emissive_texture: true,
        uv1: true,
        uv_transform: true,
        color: true,
        skinned: true,
        morphed: true,
        mask: true,
        double_sided: false,
        mirrored: false,
        emission_waveform: true,
        driven: true,
    }
}

type Groups = &'static [&'static [Binding]];
const SURFACE: Groups = &[FRAME_BINDINGS, MATERIAL_BINDINGS, SURROUNDINGS_BINDINGS];

/// Entry files, with the groups that their passes declare.
pub(super) fn entries() -> Vec<(&'static str, Groups)> {
    vec![
        ("raster/luminance.wgsl", SURFACE),
        ("raster/shadow_map.wgsl", &[FRAME_BINDINGS, MATERIAL_BINDINGS]),
        ("raster/shadow_restore.wgsl", &[RESTORE_BINDINGS]),
        ("raster/sky.wgsl", &[FRAME_BINDINGS, &[], SURROUNDINGS_BINDINGS]),
        ("raster/background.wgsl", &[]),
        (
            "labels/geometry.wgsl",
            &[FRAME_BINDINGS, MATERIAL_BINDINGS, SURROUNDINGS_BINDINGS, labels::LABEL_BINDINGS],
        ),
        ("labels/appearance.wgsl", SURFACE),
        ("labels/sky.wgsl", &[FRAME_BINDINGS, labels::SKY_FLOW_BINDINGS]),
        ("splat/prepare.wgsl", &[splat::PREPARE_BINDINGS]),
        ("splat/place.wgsl", &[splat::PLACE_BINDINGS]),
        ("splat/holes.wgsl", &[splat::HOLES_BINDINGS]),
        ("splat/accumulate.wgsl", &[splat::ACCUMULATE_BINDINGS]),
        ("splat/index.wgsl", &[splat::INDEX_BINDINGS]),
        ("splat/resolve.wgsl", &[splat::RESOLVE_BINDINGS]),
        ("splat/show.wgsl", &[splat::SHOW_BINDINGS]),
        ("resample/samples.wgsl", &[resample::SAMPLES_BINDINGS]),
        ("resample/coverage.wgsl", &[resample::COVERAGE_BINDINGS]),
        ("trigger/count.wgsl", &[trigger::COUNT_BINDINGS]),
        ("trigger/block.wgsl", &[trigger::BLOCK_BINDINGS]),
        ("trigger/scan.wgsl", &[trigger::SCAN_BINDINGS]),
        ("trigger/emit.wgsl", &[trigger::EMIT_BINDINGS]),
        ("trigger/emit_dense.wgsl", &[trigger::EMIT_DENSE_BINDINGS]),
        ("chain/dense.wgsl", &[trigger::CHAIN_DENSE_BINDINGS]),
        ("trigger/resolve.wgsl", &[trigger::RESOLVE_BINDINGS]),
        ("adaptive/mean.wgsl", &[adaptive::MEAN_BINDINGS]),
        ("adaptive/resolve.wgsl", &[adaptive::TILE_RESOLVE_BINDINGS]),
        ("adaptive/audit.wgsl", &[adaptive::AUDIT_BINDINGS]),
        ("chain/walk.wgsl", &[trigger::CHAIN_BINDINGS]),
        ("chain/begin.wgsl", &[trigger::CHAIN_BINDINGS]),
        ("chain/emit.wgsl", &[trigger::KEPT_BINDINGS]),
        ("decoupled/prepare.wgsl", &[decoupled::PIXELS_BINDINGS]),
        ("decoupled/list.wgsl", &[decoupled::PIXELS_BINDINGS]),
        ("decoupled/pixels.wgsl", &[decoupled::PIXELS_BINDINGS]),
    ]
}

fn draws_surfaces(file: &str) -> bool {
    compose(file, "").contains("VertexIn")
}

/// The interface that the file's pass asks for.
fn interface(file: &str) -> Interface {
    let shades = compose(file, "").contains("fn surface_radiance(");
    Interface { normal_label: file.starts_with("labels/appearance"), shades }
}

fn parse(file: &str, variant: &SurfaceVariant, interface: Interface) -> naga::Module {
    let prelude = if draws_surfaces(file) {
        prelude(variant, interface, &LightSet::of([(0, 0), (1, -1), (2, 1)]))
    } else {
        frame_prelude(3)
    };
    let text = compose(file, &prelude);
    naga::front::wgsl::parse_str(&text).unwrap_or_else(|e| panic!("{file}: {}", e.emit_to_string(&text)))
}

pub(super) fn variants() -> Vec<SurfaceVariant> {
    let mut out = vec![SurfaceVariant::default(), every_feature()];
    for model in 0..3 {
        for bit in 0..10 {
            let mut v = SurfaceVariant { model, ..Default::default() };
            *[
                &mut v.base_texture,
                &mut v.normal_texture,
                &mut v.emissive_texture,
                &mut v.color,
                &mut v.skinned,
                &mut v.morphed,
                &mut v.mask,
                &mut v.emission_waveform,
                &mut v.metallic_roughness_texture,
                &mut v.uv_transform,
            ][bit] = true;
            out.push(v);
        }
    }
    out
}

#[test]
fn every_shader_validates_in_every_variant() {
    let mut validator =
        naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::all());
    let mut validated = 0;
    for (file, _) in entries() {
        let cases = if draws_surfaces(file) { variants() } else { vec![SurfaceVariant::default()] };
        for variant in &cases {
            for normal_label in [false, true] {
                let module = parse(file, variant, Interface { normal_label, ..interface(file) });
                validator.validate(&module).unwrap_or_else(|e| panic!("{file} {variant:?}: {e:?}"));
                validated += 1;
            }
        }
    }
    assert!(validated > 100);
}

#[test]
fn no_shader_is_an_orphan() {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/shaders");
    let mut on_disk = BTreeSet::new();
    for folder in std::fs::read_dir(root).unwrap() {
        let folder = folder.unwrap();
        for file in std::fs::read_dir(folder.path()).unwrap() {
            let name = file.unwrap().file_name();
            on_disk.insert(format!("{}/{}", folder.file_name().to_string_lossy(), name.to_string_lossy()));
        }
    }
    let listed: BTreeSet<_> = shader::FILES.iter().map(|(n, _)| (*n).to_owned()).collect();
    assert_eq!(on_disk, listed);

    let texts: BTreeMap<_, _> = shader::FILES.iter().copied().collect();
    let mut reached = BTreeSet::new();
    let mut open: Vec<&str> = entries().iter().map(|(f, _)| *f).collect();
    while let Some(file) = open.pop() {
        if reached.insert(file.to_owned()) {
            open.extend(shader::imports(texts[file]));
        }
    }
    assert_eq!(reached, listed, "a file that no pass reaches is dead");
}

fn access_of(module: &naga::Module, variable: &naga::GlobalVariable) -> Access {
    match (variable.space, &module.types[variable.ty].inner) {
        (AddressSpace::Uniform, _) => Access::Uniform,
        (AddressSpace::Storage { access }, _) if access.contains(StorageAccess::STORE) => Access::Write,
        (AddressSpace::Storage { .. }, _) => Access::Read,
        (_, TypeInner::Sampler { comparison: true }) => Access::ComparisonSampler,
        (_, TypeInner::Sampler { comparison: false }) => Access::Sampler,
        (_, TypeInner::Image { dim, arrayed, class }) => match (dim, arrayed, class) {
            (ImageDimension::Cube, ..) => Access::Cube,
            (_, true, ImageClass::Depth { .. }) => Access::DepthLayers,
            (_, true, ImageClass::Storage { format, access }) => {
                use naga::StorageFormat::{R32Float, R32Uint, Rgba32Float, Rgba32Uint};
                match (format, access.contains(StorageAccess::STORE)) {
                    (R32Float, false) => Access::ReadLayers,
                    (Rgba32Uint, false) => Access::ReadLayersWords,
                    (R32Float, true) => Access::StorageLayers,
                    (Rgba32Float, true) => Access::StorageLayersRgba,
                    (Rgba32Uint, true) => Access::StorageLayersWords,
                    (R32Uint, false) => Access::ReadLayersWord,
                    (R32Uint, true) => Access::UpdateLayersWord,
                    other => panic!("{:?}: {other:?}", variable.name),
                }
            }
            (_, _, ImageClass::Storage { .. }) => Access::StorageLayer,
            (_, true, ImageClass::Sampled { kind: naga::ScalarKind::Uint, .. }) => Access::UintLayers,
            (_, _, ImageClass::Sampled { kind: naga::ScalarKind::Uint, .. }) => Access::UintPicture,
            (_, _, ImageClass::Sampled { multi: true, .. }) => Access::Multisampled,
            (_, true, _) => Access::Layers,
            _ => Access::Texture,
        },
        other => panic!("{:?}: {other:?}", variable.name),
    }
}

#[test]
fn bindings_are_what_the_shaders_say() {
    for (file, groups) in entries() {
        let module = parse(file, &every_feature(), interface(file));
        let mut found = 0;
        for (_, variable) in module.global_variables.iter() {
            let Some(place) = variable.binding else { continue };
            let name = variable.name.as_deref().unwrap_or_default();
            let declared = groups
                .get(place.group as usize)
                .and_then(|g| g.iter().find(|b| b.binding == place.binding))
                .unwrap_or_else(|| panic!("{file}: {name} at {place:?} is not declared"));
            let access = match declared.access {
                Access::DynamicUniform => Access::Uniform,
                // What filters is not in the shader's type.
                Access::Picture => Access::Texture,
                Access::PointSampler => Access::Sampler,
                other => other,
            };
            assert_eq!((declared.name, access), (name, access_of(&module, variable)), "{file} {place:?}");
            found += 1;
        }
        assert_eq!(found > 0, !groups.is_empty(), "{file} binds what it declares");
    }
}

/// Field names, offsets and size of `name` as naga sees them in `file`.
fn wgsl_struct(file: &str, name: &str) -> (Vec<(String, u32)>, u32) {
    let module = parse(file, &every_feature(), interface(file));
    let (_, ty) = module
        .types
        .iter()
        .find(|(_, t)| t.name.as_deref() == Some(name))
        .unwrap_or_else(|| panic!("{file} has no struct {name}"));
    let TypeInner::Struct { members, span } = &ty.inner else { panic!("{name} is no struct") };
    (members.iter().map(|m| (m.name.clone().unwrap_or_default(), m.offset)).collect(), *span)
}

macro_rules! same_layout {
    ($file:literal, $wgsl:literal, $rust:ty { $($field:ident),* $(,)? }) => {{
        let (fields, size) = wgsl_struct($file, $wgsl);
        let rust = vec![$((stringify!($field).to_owned(), offset_of!($rust, $field) as u32)),*];
        assert_eq!(rust, fields, "{}", $wgsl);
        assert_eq!(size_of::<$rust>() as u32, size, "{}", $wgsl);
    }};
}

#[test]
fn host_and_shader_structs_have_one_layout() {
    // A frame is followed by its lights: one struct in WGSL, two on the host.
    let (mut fields, size) = wgsl_struct("raster/luminance.wgsl", "Frame");
    assert_eq!(fields.pop(), Some(("lights".to_owned(), size_of::<uniforms::Frame>() as u32)));
    assert_eq!(u64::from(size), crate::pass::raster::frame_bytes(3));
    let head = [
        ("world_from_camera_right", offset_of!(uniforms::Frame, world_from_camera_right)),
        ("world_from_camera_up", offset_of!(uniforms::Frame, world_from_camera_up)),
        ("world_from_camera_back", offset_of!(uniforms::Frame, world_from_camera_back)),
        ("ray", offset_of!(uniforms::Frame, ray)),
        ("depth", offset_of!(uniforms::Frame, depth)),
        ("background", offset_of!(uniforms::Frame, background)),
        ("ambient", offset_of!(uniforms::Frame, ambient)),
        ("shadow_layer_base", offset_of!(uniforms::Frame, shadow_layer_base)),
        ("occluder_root", offset_of!(uniforms::Frame, occluder_root)),
        ("occluder_first", offset_of!(uniforms::Frame, occluder_first)),
        ("occluder_count", offset_of!(uniforms::Frame, occluder_count)),
    ];
    assert_eq!(fields, head.map(|(name, offset)| (name.to_owned(), offset as u32)));
    same_layout!(
        "raster/luminance.wgsl",
        "InstanceRecord",
        uniforms::InstanceRecord { clip_from_object, world_row_0, world_row_1, world_row_2 }
    );
    same_layout!(
        "raster/luminance.wgsl",
        "ObjectRecord",
        uniforms::ObjectRecord {
            joint_base,
            morph_weight_base,
            morph_data_base,
            morph_target_count,
            morph_vertex_count,
            instance_id,
            semantic_id,
            emission_factor,
            base_metallic,
            emissive_roughness,
        }
    );
    same_layout!(
        "raster/luminance.wgsl",
        "Material",
        uniforms::MaterialUniform { base_color, emissive, factors, uv_rows }
    );
    same_layout!(
        "raster/luminance.wgsl",
        "Light",
        uniforms::LightRecord {
            position_kind,
            direction_range,
            radiance_shadow,
            spot,
            shadow_clip_from_world
        }
    );
    same_layout!(
        "raster/luminance.wgsl",
        "OccluderRecord",
        uniforms::OccluderRecord {
            sphere,
            object_row_0,
            object_row_1,
            object_row_2,
            root,
            pad_0,
            pad_1,
            pad_2
        }
    );
    same_layout!("raster/luminance.wgsl", "Share", crate::frame::pattern::Share { shift, size });
    use evis_decoupled::packed;
    // Jobs are read row by row: their own numbers, then directions on the sky, then lamps.
    let (fields, size) = wgsl_struct("decoupled/pixels.wgsl", "Job");
    let own = [
        ("length_us", offset_of!(packed::Job, length_us)),
        ("start_us", offset_of!(packed::Job, start_us)),
        ("threshold_on", offset_of!(packed::Job, threshold_on)),
        ("threshold_off", offset_of!(packed::Job, threshold_off)),
        ("log_eps", offset_of!(packed::Job, log_eps)),
        ("reference_luminance", offset_of!(packed::Job, reference_luminance)),
        ("near", offset_of!(packed::Job, near)),
        ("far", offset_of!(packed::Job, far)),
        ("background", offset_of!(packed::Job, background)),
        ("lamps", offset_of!(packed::Job, lamps)),
        ("flags", offset_of!(packed::Job, flags)),
        ("looks", offset_of!(packed::Job, looks)),
        ("number", offset_of!(packed::Job, number)),
        ("sky", offset_of!(packed::Job, sky)),
        ("sky_levels", offset_of!(packed::Job, sky_levels)),
        ("sky_texels", offset_of!(packed::Job, sky_texels)),
    ];
    assert_eq!(fields, own.map(|(name, offset)| (name.to_owned(), offset as u32)));
    let rows = |name| constant("decoupled/pixels.wgsl", name) as usize * size_of::<[f32; 4]>();
    assert_eq!([rows("HEAD_ROWS"), size as usize], [offset_of!(packed::Job, seen); 2]);
    assert_eq!(rows("HEAD_ROWS") + rows("SEEN_ROWS"), offset_of!(packed::Job, own));
    assert_eq!(rows("LAMP_ROWS"), size_of::<packed::Lamp>());
    assert_eq!(3 * size_of::<[f32; 4]>(), offset_of!(packed::Lamp, wave));
    same_layout!(
        "decoupled/pixels.wgsl",
        "Batch",
        uniforms::Batch {
            pixels,
            capacity,
            row,
            jobs,
            sums,
            light,
            texels,
            around,
            given,
            tiles,
            tile_words,
            memories,
            own,
            failed,
            pad_0,
            pad_1
        }
    );
    same_layout!(
        "decoupled/pixels.wgsl",
        "Entry",
        packed::Entry {
            points,
            facet,
            flags,
            light,
            span,
            lit,
            shades,
            glow,
            touches,
            covers,
            moved,
            strides,
            moved_strides,
            bounds,
            pad
        }
    );
    same_layout!(
        "decoupled/pixels.wgsl",
        "Tile",
        packed::Tile {
            first,
            pixels,
            filled,
            begins,
            given,
            returned,
            memories,
            entries,
            entry_count,
            bases,
            own,
            view,
            place,
            background_strides,
            frames,
            pad
        }
    );
    same_layout!(
        "decoupled/pixels.wgsl",
        "Memory",
        packed::Memory { last, before_us, before, log, above, below, flags, number }
    );
    same_layout!(
        "decoupled/pixels.wgsl",
        "Pixel",
        packed::Pixel {
            centre,
            own,
            own_count,
            number,
            bases,
            stride,
            least,
            memory,
            flags,
            evaluations,
            failed,
            frame,
        }
    );
    same_layout!("decoupled/pixels.wgsl", "Event", packed::Event { pixel, word });
    same_layout!("decoupled/pixels.wgsl", "Turn", uniforms::Turn { round, first, pad_0, pad_1 });
    same_layout!(
        "labels/geometry.wgsl",
        "LabelFrame",
        uniforms::LabelFrame { next_offset, last_offset, half_size }
    );
    same_layout!(
        "labels/sky.wgsl",
        "SkyFlow",
        uniforms::SkyFlow { next_clip_from_world, last_clip_from_world, half_size, pad }
    );
    same_layout!(
        "trigger/count.wgsl",
        "TriggerParams",
        uniforms::TriggerParams {
            width,
            height,
            stride,
            view_count,
            lists,
            instants,
            event_capacity,
            first,
            spans,
        }
    );
    same_layout!(
        "trigger/count.wgsl",
        "ViewSensor",
        uniforms::ViewSensor { threshold_on, threshold_off, log_eps, inverse_reference_luminance }
    );
    same_layout!("chain/dense.wgsl", "WindowBounds", uniforms::WindowBounds { start, end });
    same_layout!("trigger/count.wgsl", "PixelMemory", uniforms::PixelMemory { reference_log, log_luminance });
    same_layout!(
        "trigger/count.wgsl",
        "Status",
        uniforms::Status { stalled, event_count, clamped, mismatched, unknown, suppressed }
    );
    same_layout!(
        "splat/prepare.wgsl",
        "KeyParams",
        uniforms::KeyParams { width, height, view, margin, brightest, pad_0, pad_1, pad_2 }
    );
    same_layout!(
        "splat/place.wgsl",
        "SplatParams",
        uniforms::SplatParams {
            width,
            height,
            canvas_width,
            canvas_height,
            margin,
            view_count,
            transform_base,
            objects,
            side,
            slot,
            moved,
            elapsed,
            first_layer,
            layers_per_view,
            index_bits,
            log_floor,
            brightest,
            pad_0,
            pad_1,
            pad_2,
        }
    );
    same_layout!("adaptive/mean.wgsl", "MeanJob", uniforms::MeanJob { first, count, row, layer });
    same_layout!("adaptive/audit.wgsl", "AuditJob", uniforms::AuditJob { size, slot, offset });
    same_layout!("adaptive/resolve.wgsl", "MeanJob", uniforms::MeanJob { first, count, row, layer });
    same_layout!("chain/walk.wgsl", "ChainStep", uniforms::ChainStep { mode, instant, pad });
    same_layout!(
        "chain/walk.wgsl",
        "ChainSensor",
        uniforms::ChainSensor {
            log_eps,
            dark_light,
            full_scale,
            knee,
            below_knee,
            bandwidth_offset,
            bandwidth_least,
            bandwidth_most,
            leak_jitter,
            latency_light_us,
        }
    );
    same_layout!("trigger/block.wgsl", "BlockParams", uniforms::BlockParams { block_count, row });
    same_layout!(
        "trigger/scan.wgsl",
        "ScanParams",
        uniforms::ScanParams { block_count, blocks_per_view, view_count, event_capacity }
    );
}

#[test]
#[should_panic(expected = "Status")]
fn canary_a_swapped_field_is_seen() {
    #[repr(C)]
    struct Swapped {
        event_count: u32,
        stalled: u32,
        clamped: u32,
        mismatched: u32,
        unknown: u32,
        suppressed: u32,
    }
    same_layout!(
        "trigger/count.wgsl",
        "Status",
        Swapped { stalled, event_count, clamped, mismatched, unknown, suppressed }
    );
}

/// A scalar constant of `file`.
fn constant(file: &str, name: &str) -> f64 {
    let values = constants(file, name);
    assert_eq!(values.len(), 1, "{name} is a vector");
    values[0]
}

/// The components of a constant of `file`.
fn constants(file: &str, name: &str) -> Vec<f64> {
    let module = parse(file, &every_feature(), interface(file));
    let (_, constant) = module
        .constants
        .iter()
        .find(|(_, c)| c.name.as_deref() == Some(name))
        .unwrap_or_else(|| panic!("{file} has no constant {name}"));
    let value = |expression: &naga::Expression| match *expression {
        naga::Expression::Literal(naga::Literal::U32(v)) => f64::from(v),
        naga::Expression::Literal(naga::Literal::I32(v)) => f64::from(v),
        naga::Expression::Literal(naga::Literal::F32(v)) => f64::from(v),
        ref other => panic!("{name}: {other:?}"),
    };
    match &module.global_expressions[constant.init] {
        naga::Expression::Compose { components, .. } => {
            components.iter().map(|c| value(&module.global_expressions[*c])).collect()
        }
        scalar => vec![value(scalar)],
    }
}

#[test]
fn constants_agree() {
    use crate::gpu::sizes::{BLOCK_PIXELS, MAX_INSTANTS, WORKGROUP};
    assert_eq!(constant("trigger/count.wgsl", "WORKGROUP"), f64::from(WORKGROUP));
    assert_eq!(constant("trigger/block.wgsl", "BLOCK_PIXELS"), f64::from(BLOCK_PIXELS));
    assert_eq!(constant("trigger/count.wgsl", "TILE"), f64::from(crate::world::tiles::TILE));
    assert_eq!(constant("trigger/count.wgsl", "PIECES"), crate::cpu::trigger::PIECES as f64);
    assert_eq!(constant("adaptive/mean.wgsl", "TILE"), f64::from(crate::world::tiles::TILE));
    assert_eq!(constant("adaptive/audit.wgsl", "SCALE"), f64::from(crate::cpu::audit::SCALE));
    assert_eq!(constant("adaptive/audit.wgsl", "PIXEL_BITS"), f64::from(crate::cpu::audit::PIXEL_BITS));
    let weights = evis_core::luminance::LUMINANCE_WEIGHTS.map(|weight| f64::from(weight as f32));
    assert_eq!(constants("raster/luminance.wgsl", "LUMINANCE_WEIGHTS"), weights);
    assert_eq!(constant("raster/luminance.wgsl", "OCCLUDERS_END"), f64::from(crate::shadow::bvh::END));
    let cells = f64::from(crate::shadow::light_grid::CELLS);
    assert_eq!(constant("raster/luminance.wgsl", "OCCLUDER_CELLS"), cells);
    let crowded = f64::from(crate::shadow::light_grid::CROWDED);
    assert_eq!(constant("raster/luminance.wgsl", "OCCLUDERS_CROWDED"), crowded);
    let splat_constants = [
        ("SPLAT_WORKGROUP", f64::from(splat::SPLAT_WORKGROUP)),
        ("HOLE_TILE", f64::from(splat::HOLE_TILE)),
        ("SUM_PLANES", splat::SUM_PLANES as f64),
        ("SUBPIXELS", f64::from(crate::cpu::splat::SUBPIXELS)),
    ];
    for (name, value) in splat_constants {
        assert_eq!(constant("splat/place.wgsl", name), value, "{name}");
    }
    let limit = f64::from(evis_core::trigger::MAX_EVENTS_PER_INTERVAL);
    assert_eq!(constant("trigger/count.wgsl", "MAX_EVENTS_PER_INTERVAL"), limit);
    let chain_constants = [
        ("VIEW_WORDS", f64::from(crate::sensor::chain::VIEW_WORDS)),
        ("BLOCK_WORD", crate::sensor::chain::BLOCK_WORD as f64),
        ("LIGHT_SHIFT", f64::from(crate::engine::stages::LIGHT_SHIFT)),
        ("LIGHT_PARTS", evis_decoupled::packed::LIGHT_PARTS.into()),
        ("LIGHT_JUMPS", evis_decoupled::packed::LIGHT_JUMPS.into()),
        ("LIGHT_RESTS", evis_decoupled::packed::LIGHT_RESTS.into()),
        ("LIGHT_BEGINS", evis_decoupled::packed::LIGHT_BEGINS.into()),
        ("CANDIDATE_WORDS", f64::from(crate::sensor::chain::CANDIDATE_WORDS)),
        ("OLD", f64::from(crate::config::OLD_US)),
        ("TALLY_WORDS", f64::from(crate::sensor::chain::TALLY_WORDS)),
        ("STREAM_START", StreamId::Start as u32 as f64),
        ("STREAM_LEAK_JITTER", StreamId::LeakJitter as u32 as f64),
        ("EPOCH_SHIFT", f64::from(evis_core::random::EPOCH_SHIFT)),
        ("JITTER_SHIFT", f64::from(evis_core::emulator::parts::JITTER_SHIFT)),
    ];
    for (name, value) in chain_constants {
        let file = if name == "STREAM_START" { "chain/begin.wgsl" } else { "chain/walk.wgsl" };
        assert_eq!(constant(file, name), value, "{name}");
    }
    use evis_decoupled::image::texture;
    use evis_decoupled::packed;
    use evis_decoupled::shading::{light, material};
    use evis_decoupled::signal::{knots, path, pixel};
    let decoupled_constants = [
        ("MOST_OWN", packed::MOST_OWN as f64),
        ("JUMPS", packed::JUMPS.into()),
        ("PARALLEL", packed::PARALLEL.into()),
        ("LIGHT_ALONE", packed::LIGHT_ALONE.into()),
        ("SENSES", packed::SENSES.into()),
        ("PARTS", knots::PARTS.into()),
        ("KNOT_TOLERANCE", f64::from(knots::TOLERANCE as f32)),
        ("DOUBLE_SIDED", packed::DOUBLE_SIDED.into()),
        ("MIRRORED", packed::MIRRORED.into()),
        ("CROSSES_NEAR", packed::CROSSES_NEAR.into()),
        ("CROSSES_FAR", packed::CROSSES_FAR.into()),
        ("UNLIT", packed::UNLIT.into()),
        ("HAS_MAPS", packed::HAS_MAPS.into()),
        ("GLOWS_APART", packed::GLOWS_APART.into()),
        ("SHARP", packed::SHARP.into()),
        ("BOUNDED", packed::BOUNDED.into()),
        ("IS_PLAIN", packed::PLAIN.into()),
        ("IS_BENT", packed::BENT.into()),
        ("IS_MAPPED", packed::MAPPED.into()),
        ("STRIDE_BITS", packed::STRIDE_BITS.into()),
        ("NO_FRAMES", packed::NO_FRAMES.into()),
        ("TILE_WORDS", (size_of::<packed::Tile>() / size_of::<u32>()) as f64),
        ("MEMORY_WORDS", packed::MEMORY_WORDS as f64),
        ("FAILED_WORDS", (size_of::<packed::Failed>() / size_of::<u32>()) as f64),
        ("COUNTS", decoupled::COUNTS.into()),
        ("LIT_OFFSET", f64::from(light::GAUSS as f32)),
        ("GEOMETRY_ROWS", packed::GEOMETRY_ROWS as f64),
        ("TANGENT_ROWS", packed::TANGENT_ROWS as f64),
        ("MATERIAL_ROW", packed::MAPPED_ROWS as f64 - 2.0),
        ("EMISSION_ROW", packed::MAPPED_ROWS as f64 - 1.0),
        ("EYE_ROWS", packed::EYE_ROWS as f64),
        ("LIGHT_ROWS", packed::LIGHT_ROWS as f64),
        ("MAP_PLACES", light::PLACES.into()),
        ("SPLIT_SUM", material::SPLIT_SUM as f64),
        ("LEAST_ALPHA", f64::from(material::LEAST_ALPHA as f32)),
        ("LEAST_COSINE", f64::from(material::LEAST_COSINE as f32)),
        ("HAS_BEFORE", packed::HAS_BEFORE.into()),
        ("RESTED", packed::RESTED.into()),
        ("BEGINS", packed::BEGINS.into()),
        ("COVERS", packed::COVERS.into()),
        ("SHADE_WORDS", packed::SHADE_WORDS as f64),
        ("CASTER_WORDS", packed::CASTER_WORDS as f64),
        ("LOOK_ROWS", packed::LOOK_ROWS as f64),
        ("JOB_ROWS", packed::JOB_ROWS as f64),
        ("UNITS", pixel::UNITS.into()),
        ("INSTANT_US", path::INSTANT_US),
        ("SKY_DENSITY", light::SKY_DENSITY),
        ("SKY_PLACES", light::SKY_PLACES.into()),
        ("ONE_PLACE", texture::ONE_PLACE.into()),
        ("SPACING", texture::SPACING.into()),
        ("MOST_PARTS", texture::MOST_PARTS.into()),
        ("MOST_TEXTURE_LINES", texture::MOST_LINES),
        ("POINT", f64::from(texture::POINT as f32)),
        ("BLUR", f64::from(texture::BLUR as f32)),
        ("DENSITY", texture::DENSITY),
        ("MOST_PLACES", texture::MOST),
        ("ROUNDS", decoupled::ROUNDS.into()),
        ("STATE_WORDS", decoupled::STATE_WORDS.into()),
        ("PLAIN", decoupled::PLAIN as f64),
        ("BENT", decoupled::BENT as f64),
        ("MAPPED", decoupled::MAPPED as f64),
        ("BENT_MAPPED", decoupled::BENT_MAPPED as f64),
        ("CLASSES", decoupled::CLASSES as f64),
    ];
    for (name, value) in decoupled_constants {
        assert_eq!(constant("decoupled/pixels.wgsl", name), value, "{name}");
    }
    // The counter of events, and a number for each class, round, and the one after the last.
    let events = wgsl_struct("decoupled/pixels.wgsl", "Events").0;
    let at = |name: &str| events.iter().find(|(field, _)| field == name).map(|(_, at)| *at);
    let groups = decoupled::TOTAL_WORDS + decoupled::CLASSES as u32 * (decoupled::ROUNDS + 1);
    let words = [("going_on", decoupled::TOTAL_WORDS), ("groups", groups), ("fired", decoupled::HEAD_WORDS)];
    words.iter().for_each(|(name, words)| assert_eq!(at(name), Some(4 * words), "{name}"));
    // Times of the instants and of the one before them fit the uniform.
    let params = uniforms::TriggerParams::default();
    assert_eq!(MAX_INSTANTS as usize, params.spans.len());
    const { assert!(MAX_INSTANTS <= u32::BITS, "trigger/count.wgsl keeps one bit per instant") };
}

/// Files below `folder`, and what they hold.
fn sources(folder: &std::path::Path, into: &mut Vec<(String, String)>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, into);
        } else {
            into.push((path.to_string_lossy().into_owned(), std::fs::read_to_string(&path).unwrap()));
        }
    }
}

/// What `text` makes on a device without a name that a debugger or a trace could show, and passes that are no spans.
fn unnamed(text: &str) -> Vec<&'static str> {
    const NAMELESS: [&str; 6] = [
        "label: None",
        "Descriptor::default()",
        "create_command_encoder(",
        "begin_compute_pass(",
        "begin_render_pass(",
        ".finish()",
    ];
    NAMELESS.into_iter().filter(|pattern| text.contains(pattern)).collect()
}

#[test]
fn every_pass_pipeline_and_buffer_has_a_label() {
    let mut files = Vec::new();
    sources(std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/src")), &mut files);
    let mut checked = 0;
    for (path, text) in files.iter().filter(|(path, _)| !path.contains("/tests/")) {
        // The one place that begins passes: `Commands::compute` and `Commands::render` take a label.
        let allowed: &[&str] = if path.ends_with("gpu/commands.rs") {
            &["create_command_encoder(", "begin_compute_pass(", "begin_render_pass(", ".finish()"]
        } else {
            &[]
        };
        let found: Vec<_> = unnamed(text).into_iter().filter(|pattern| !allowed.contains(pattern)).collect();
        assert!(found.is_empty(), "{path}: {found:?}; name it, and take passes from gpu::commands::Commands");
        checked += usize::from(text.contains("Commands"));
    }
    assert!(checked > 15, "{checked} files record commands");
    // Canary: both ways to leave a name out.
    assert_eq!(unnamed("create_buffer(&wgpu::BufferDescriptor { label: None, size })"), ["label: None"]);
    assert_eq!(
        unnamed("device.create_sampler(&wgpu::SamplerDescriptor::default())"),
        ["Descriptor::default()"]
    );
}
