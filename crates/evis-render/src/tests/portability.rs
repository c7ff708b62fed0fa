//! Other backends: every shader variant is translated to SPIR-V, MSL and HLSL, and every pipeline is
//! built with the limits of other backends. No driver compiles the translations here.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt::Write as _;
use std::sync::Arc;

use evis_core::sensor::{
    Bandwidth, Curve, FilterRule, LeakLaw, Noise, NoiseReference, PRESETS, Pattern, Photoreceptor, Readout,
    Refractory, RefractoryRule, SensorConfig, Start, Times,
};
use evis_core::{LabelKind, TriggerRule, Warp};
use evis_representation::{Decay, Polarities};
use evis_scene::{Distortion, Scene};
use naga::back::{hlsl, msl, spv};
use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga::{AddressSpace, ShaderStage};

use super::layout::{entries, variants};
use super::raster_scenes;
use crate::config::dense::DenseKind;
use crate::config::{Antialias, Interpolation, Method, RunConfig, Shadows};
use crate::engine::Engine;
use crate::engine::follower::Followers;
use crate::gpu::Gpu;
use crate::gpu::shader::compose;
use crate::gpu::variant::LightSet;
use crate::pass::raster::{LUMINANCE_FORMAT, SceneConstants, SurfaceLayouts, luminance_pipelines};
use crate::pass::{Access, labels, shadow_map, sky};
use crate::sensor::passes::{Blocks, TriggerPasses};
use crate::world::view;

/// An entry point as a pipeline uses it.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Variant {
    file: String,
    entry: String,
    stage: u8,
    /// Override constants; the values as bits, so that they can be ordered.
    constants: Vec<(String, u64)>,
    text: String,
}

impl Variant {
    fn stage(&self) -> ShaderStage {
        [ShaderStage::Vertex, ShaderStage::Fragment, ShaderStage::Compute][usize::from(self.stage)]
    }

    fn value(&self, name: &str) -> Option<f64> {
        self.constants.iter().find(|(known, _)| known == name).map(|(_, bits)| f64::from_bits(*bits))
    }
}

thread_local! {
    static VARIANTS: RefCell<Option<BTreeSet<Variant>>> = const { RefCell::new(None) };
}

/// Keeps what a pipeline of this thread is built from, between the start and the end of [`recorded`].
pub(crate) fn record(file: &str, text: &str, stage: ShaderStage, entry: &str, constants: &[(&str, f64)]) {
    VARIANTS.with_borrow_mut(|variants| {
        let Some(variants) = variants else { return };
        variants.insert(Variant {
            file: file.to_owned(),
            entry: entry.to_owned(),
            stage: match stage {
                ShaderStage::Vertex => 0,
                ShaderStage::Fragment => 1,
                ShaderStage::Compute => 2,
                other => panic!("{file}: no pass has a {other:?} stage"),
            },
            constants: constants.iter().map(|(name, value)| ((*name).to_owned(), value.to_bits())).collect(),
            text: text.to_owned(),
        });
    });
}

/// The variants of all pipelines that `build` builds.
fn recorded(build: impl FnOnce()) -> BTreeSet<Variant> {
    VARIANTS.set(Some(BTreeSet::new()));
    build();
    VARIANTS.take().unwrap()
}

/// `spinner` seen through a distorted lens.
fn distorted() -> Scene {
    let mut scene = evis_scene::builtin::load("spinner", 0).unwrap();
    let distortion = Distortion::from_coefficients("radtan", &[-0.2, 0.05, 0.0, 0.0]).unwrap();
    scene.distortions.insert(scene.cameras[0].name.clone(), distortion);
    scene
}

/// Builds an engine and complains where the device does.
fn build_engine(gpu: &Gpu, scene: &Arc<Scene>, mut config: RunConfig) {
    let (views, _) = view::views(scene, &config).unwrap();
    let scope = gpu.device.push_error_scope(wgpu::ErrorFilter::Validation);
    let built = Engine::new(gpu, scene.clone(), views, &mut config);
    let error = pollster::block_on(scope.pop());
    assert!(error.is_none(), "{:?} {:?}: {error:?}", config.method, config.antialias);
    built.unwrap();
}

/// Settings whose engines have, between them, every pass.
fn configs() -> Vec<RunConfig> {
    let plain = RunConfig {
        labels: LabelKind::ALL.to_vec(),
        frame_rate_hz: Some(30.0),
        size: Some((64, 48)),
        // Nothing is computed on noop: a measured reference would be read from an empty image.
        reference_luminance: Some(1.0),
        ..RunConfig::default()
    };
    let adaptive = RunConfig { adaptive_px: Some(0.5), ..plain.clone() };
    vec![
        RunConfig { samples: 1, ..plain.clone() },
        plain.clone(),
        RunConfig { method: Method::Splat(Warp::default()), ..plain.clone() },
        RunConfig { method: Method::Splat(Warp::evis_paper(8)), ..plain.clone() },
        RunConfig { antialias: Antialias::Edges, samples: 16, ..plain.clone() },
        RunConfig { between: Interpolation::Curve, shadows: Some(Shadows::Rays), ..adaptive.clone() },
        RunConfig { antialias: Antialias::Edges, samples: 144, shadows: Some(Shadows::Rays), ..adaptive },
    ]
}

/// Sensors that have, with the presets, every stage of the chain in every form.
fn sensors() -> Vec<SensorConfig> {
    let refractory = |rule| Refractory { period_us: 300, rule };
    let linlog = SensorConfig {
        photoreceptor: Photoreceptor {
            curve: Curve::Linlog,
            cutoff_hz: 200.0,
            order: 2,
            filter: FilterRule::Exact,
            bandwidth: Bandwidth::Light,
            ..Photoreceptor::default()
        },
        refractory: refractory(RefractoryRule::Defer),
        readout: Readout { latency_light_us: 5.0, ..Readout::default() },
        times: Times::Even,
        ..SensorConfig::default()
    };
    let leaking = SensorConfig {
        noise: Noise { leak_hz: 2.0, leak_law: LeakLaw::Ramp, leak_jitter: 0.1, ..Noise::default() },
        pattern: Pattern { sigma: 0.03, start: Start::Phase, ..Pattern::default() },
        photoreceptor: Photoreceptor {
            cutoff_hz: 200.0,
            filter: FilterRule::Exact,
            ..Photoreceptor::default()
        },
        refractory: refractory(RefractoryRule::Hold),
        times: Times::Sample,
        ..SensorConfig::default()
    };
    let shared = SensorConfig {
        noise: Noise { shot_hz: 5.0, reference: NoiseReference::Keep, ..Noise::default() },
        refractory: refractory(RefractoryRule::Suppress),
        times: Times::Shared,
        ..SensorConfig::default()
    };
    let latch = SensorConfig { trigger: TriggerRule::Latch, ..SensorConfig::default() };
    let noisy_latch = SensorConfig { trigger: TriggerRule::Latch, ..leaking.clone() };
    let presets = PRESETS.iter().map(|preset| preset.sensor());
    presets.chain([linlog, leaking, shared, latch, noisy_latch]).collect()
}

/// Every way to add an event to a dense array.
fn dense_kinds() -> [DenseKind; 4] {
    let grid = |polarities| DenseKind::VoxelGrid { bins: 5, polarities, normalize: false };
    [
        DenseKind::Counts,
        grid(Polarities::Signed),
        grid(Polarities::Split),
        DenseKind::TimeSurface { tau_us: 1e4, decay: Decay::Linear },
    ]
}

/// Every trigger pipeline.
fn build_triggers(gpu: &Gpu) {
    for sensor in sensors() {
        if !sensor.is_ideal() && sensor.needs_frames().is_none() {
            TriggerPasses::with_own_times(&gpu.device, &[&sensor], None);
        }
        for samples in [1, 4] {
            for unknown in [false, true] {
                for (instants, between) in
                    [(1, Interpolation::Line), (16, Interpolation::Line), (16, Interpolation::Curve)]
                {
                    let blocks = Blocks { instants, between };
                    for dense in dense_kinds() {
                        TriggerPasses::new(&gpu.device, &[(&sensor, samples)], unknown, blocks, Some(&dense));
                    }
                }
            }
        }
    }
}

/// Every surface pipeline: what materials and meshes differ in, under few and many lights, with and without shadows and
/// an environment.
fn build_surfaces(gpu: &Gpu) {
    let device = &gpu.device;
    let layouts = SurfaceLayouts::new(device);
    let label = labels::label_layout(device);
    let sky_flow = labels::sky_flow_layout(device);
    let three = LightSet::of([(0, 0), (1, -1), (2, 1)]);
    let many = LightSet::of((0..20).map(|n| (n % 3, -1)));
    let plain = SceneConstants {
        lights: LightSet::default(),
        shadows: false,
        shadow_rays: false,
        environment: false,
        texture_samples: 1,
        grid: 1,
        texture_taps: 2,
    };
    let coverage = SceneConstants { texture_samples: 8, grid: 4, texture_taps: 4, ..plain };
    let scenes = [
        plain,
        SceneConstants { lights: three, shadows: true, ..plain },
        SceneConstants { lights: three, shadows: true, shadow_rays: true, environment: true, ..coverage },
        SceneConstants { lights: many, environment: true, ..coverage },
    ];
    for scene in &scenes {
        let variants = || variants().into_iter();
        for samples in [1, 4] {
            luminance_pipelines(device, &layouts, variants(), scene, samples);
        }
        labels::geometry_pipelines(device, &layouts, &label, variants(), scene, [true; 3]);
        for normal in [false, true] {
            labels::appearance_pipelines(device, &layouts, variants(), scene, [true, normal]);
        }
        shadow_map::pipelines(device, &layouts, variants(), scene);
        let lights = scene.lights.count;
        let target = labels::targets(labels::GEOMETRY_FORMATS, [false, true, false]);
        sky::flow_pipeline(device, &layouts.frame, &sky_flow, &target, lights);
        for (entry, format) in
            [("fs_luminance", LUMINANCE_FORMAT), ("fs_color", labels::APPEARANCE_FORMATS[0])]
        {
            sky::pipeline(device, &layouts, entry, &[Some(format.into())], 1, lights);
        }
    }
    sky::background(device, 0.25, 4);
    shadow_map::restore(device);
}

/// Every pipeline that an engine builds for itself.
fn build_engines(gpu: &Gpu) {
    let scene = Arc::new(evis_scene::builtin::load("spinner", 0).unwrap());
    for config in configs() {
        build_engine(gpu, &scene, config);
    }
    let bent = Arc::new(distorted());
    for antialias in [Antialias::Samples, Antialias::Edges] {
        build_engine(gpu, &bent, RunConfig { antialias, ..configs()[1].clone() });
    }
    // Several environments, a moving light and its shadow maps.
    let lit = raster_scenes::moving_spotlight();
    let variants = vec![evis_scene::Variant::default(); 3];
    let lit = Arc::new(Scene { variants, ..lit });
    for shadows in [Shadows::Maps, Shadows::Rays] {
        build_engine(gpu, &lit, RunConfig { shadows: Some(shadows), ..configs()[1].clone() });
    }
    Followers::with_all_passes(gpu).unwrap();
}

/// Every pipeline that the product can build.
fn build_all(gpu: &Gpu) {
    let scope = gpu.device.push_error_scope(wgpu::ErrorFilter::Validation);
    build_triggers(gpu);
    build_surfaces(gpu);
    let error = pollster::block_on(scope.pop());
    assert!(error.is_none(), "{error:?}");
    build_engines(gpu);
}

/// A variant ready to be translated: parsed, checked without any optional capability, its constants filled in.
struct Resolved {
    module: naga::Module,
    info: naga::valid::ModuleInfo,
}

fn resolve(variant: &Variant) -> Result<Resolved, String> {
    let place = |e: &dyn std::fmt::Display| format!("{} {}: {e}", variant.file, variant.entry);
    let module =
        naga::front::wgsl::parse_str(&variant.text).map_err(|e| place(&e.emit_to_string(&variant.text)))?;
    let mut validator = Validator::new(ValidationFlags::all(), Capabilities::empty());
    let info = validator.validate(&module).map_err(|e| place(&e.emit_to_string(&variant.text)))?;
    let constants: HashMap<String, f64> =
        variant.constants.iter().map(|(name, bits)| (name.clone(), f64::from_bits(*bits))).collect();
    let entry = Some((variant.stage(), &*variant.entry));
    let (module, info) = naga::back::pipeline_constants::process_overrides(
        &module,
        &info,
        entry,
        &constants.into_iter().collect(),
    )
    .map_err(|e| place(&e))?;
    Ok(Resolved { module: module.into_owned(), info: info.into_owned() })
}

/// The SPIR-V capabilities that wgpu allows on a Vulkan device opened without optional features (wgpu-hal 30.0.1,
/// `vulkan/adapter.rs`).
const SPIRV_CAPABILITIES: [spv::Capability; 7] = [
    spv::Capability::Shader,
    spv::Capability::Matrix,
    spv::Capability::Sampled1D,
    spv::Capability::Image1D,
    spv::Capability::ImageQuery,
    spv::Capability::DerivativeControl,
    spv::Capability::StorageImageExtendedFormats,
];

/// Lengths of the translations to SPIR-V, in words, and to MSL and HLSL, in bytes.
fn translate(variant: &Variant) -> Result<[usize; 3], String> {
    let place = |language: &str, e: &dyn std::fmt::Display| {
        format!("{} {} in {language}: {e}", variant.file, variant.entry)
    };
    let Resolved { module, info } = &resolve(variant)?;
    let entry = (variant.stage(), variant.entry.clone());

    let options = spv::Options {
        capabilities: Some(SPIRV_CAPABILITIES.into_iter().collect()),
        ..spv::Options::default()
    };
    let pipeline = spv::PipelineOptions { shader_stage: entry.0, entry_point: entry.1.clone() };
    let words = spv::write_vec(module, info, &options, Some(&pipeline)).map_err(|e| place("SPIR-V", &e))?;

    // Metal 2.3 came with macOS 11, the first system for Apple silicon.
    let options = msl::Options { lang_version: (2, 3), ..msl::Options::default() };
    let pipeline = msl::PipelineOptions { entry_point: Some(entry.clone()), ..Default::default() };
    let (metal, found) =
        msl::write_string(module, info, &options, &pipeline).map_err(|e| place("MSL", &e))?;
    for name in found.entry_point_names {
        name.map_err(|e| place("MSL", &e))?;
    }

    // What FXC takes, which comes with Windows; DXC takes more.
    let options = hlsl::Options { shader_model: hlsl::ShaderModel::V5_1, ..hlsl::Options::default() };
    let pipeline = hlsl::PipelineOptions { entry_point: Some(entry) };
    let mut text = String::new();
    let found = hlsl::Writer::new(&mut text, &options, &pipeline)
        .write(module, info, None)
        .map_err(|e| place("HLSL", &e))?;
    for name in found.entry_point_names {
        name.map_err(|e| place("HLSL", &e))?;
    }
    Ok([words.len(), metal.len(), text.len()])
}

/// Override constants that choose among code paths by number, with what they may be.
const CHOICES: [(&str, &[f64]); 5] = [
    ("FILTER", &[0.0, 1.0, 2.0, 3.0]),
    ("REFRACTORY", &[0.0, 1.0, 2.0, 3.0]),
    ("TIMES", &[0.0, 1.0, 2.0, 3.0]),
    ("TRIGGER_RULE", &[0.0, 1.0]),
    ("SHADING_MODEL", &[0.0, 1.0, 2.0]),
];

/// What `variants` leave out: entry files, entry points, and values of override constants.
fn left_out(variants: &BTreeSet<Variant>) -> Vec<String> {
    let mut missing = Vec::new();
    for (file, _) in entries() {
        let of_file: Vec<_> = variants.iter().filter(|v| v.file == file).collect();
        let Some(first) = of_file.first() else {
            missing.push(format!("{file} is built by no pipeline"));
            continue;
        };
        let mut module = naga::front::wgsl::parse_str(&first.text).unwrap();
        // What is imported and not used chooses nothing.
        naga::compact::compact(&mut module, naga::compact::KeepUnused::No);
        for entry in &module.entry_points {
            if !variants.iter().any(|v| v.file == file && v.entry == entry.name) {
                missing.push(format!("{file} {} is in no pipeline", entry.name));
            }
        }
        for (_, constant) in module.overrides.iter() {
            let name = constant.name.as_deref().unwrap_or_default();
            let values: BTreeSet<u64> =
                of_file.iter().filter_map(|v| v.value(name)).map(f64::to_bits).collect();
            let wanted: &[f64] = match module.types[constant.ty].inner {
                naga::TypeInner::Scalar(naga::Scalar::BOOL) => &[0.0, 1.0],
                _ => CHOICES.iter().find(|(known, _)| *known == name).map_or(&[], |(_, values)| values),
            };
            let unseen: Vec<_> = wanted.iter().filter(|value| !values.contains(&value.to_bits())).collect();
            if !unseen.is_empty() {
                missing.push(format!("{file}: {name} is never {unseen:?}"));
            }
        }
    }
    missing
}

#[test]
fn every_variant_is_translated_to_spirv_msl_and_hlsl() {
    let gpu = Gpu::noop().unwrap();
    let variants = recorded(|| build_all(&gpu));
    assert_eq!(left_out(&variants), Vec::<String>::new());
    let mut files = BTreeMap::<&str, usize>::new();
    for variant in &variants {
        let lengths = translate(variant).unwrap_or_else(|e| panic!("{e}"));
        assert!(lengths.iter().all(|length| *length > 50), "{} {lengths:?}", variant.file);
        *files.entry(&variant.file).or_default() += 1;
    }
    eprintln!("{} variants: {files:?}", variants.len());
    // Canary: without what a class of sensors needs, the list says so.
    let few = variants.iter().filter(|v| v.value("LINLOG") != Some(1.0)).cloned().collect();
    assert!(left_out(&few).iter().any(|text| text.contains("LINLOG")), "{:?}", left_out(&few));
}

#[test]
fn canary_what_a_backend_lacks_is_seen() {
    let of = |text: &str| Variant {
        file: "canary".into(),
        entry: "main".into(),
        stage: 2,
        constants: Vec::new(),
        text: text.into(),
    };
    // Doubles need an optional feature.
    let doubles = of("@compute @workgroup_size(1) fn main() { var x: f64 = 1.0lf; x += 1.0lf; }");
    assert!(translate(&doubles).unwrap_err().contains("canary"));
    // 64-bit atomics need a later Metal, and a feature.
    let atomics = of("@group(0) @binding(0) var<storage, read_write> a: atomic<u64>;
        @compute @workgroup_size(1) fn main() { atomicMax(&a, 1lu); }");
    assert!(translate(&atomics).is_err());
    let fine = of("@group(0) @binding(0) var<storage, read_write> a: atomic<u32>;
        @compute @workgroup_size(1) fn main() { atomicMax(&a, 1u); }");
    translate(&fine).unwrap();
}

/// Limits of devices that EVIS should run on.
fn limits() -> Vec<(&'static str, wgpu::Limits)> {
    let least = wgpu::Limits::default();
    vec![
        ("WebGPU's defaults", least.clone()),
        // wgpu-hal 30.0.1, `dx12/adapter.rs`: resource binding tier 1 at feature level 12.
        (
            "DirectX 12, resource binding tier 1",
            wgpu::Limits {
                max_texture_dimension_1d: 16384,
                max_texture_dimension_2d: 16384,
                max_texture_array_layers: 2048,
                max_bind_groups: 8,
                max_sampled_textures_per_shader_stage: 104,
                max_samplers_per_shader_stage: 16,
                max_storage_buffers_per_shader_stage: 16,
                max_storage_textures_per_shader_stage: 16,
                max_uniform_buffers_per_shader_stage: 14,
                max_uniform_buffer_binding_size: 64 << 10,
                max_buffer_size: i32::MAX as u64,
                max_storage_buffer_binding_size: (i32::MAX - 3) as u64,
                max_vertex_buffers: 16,
                max_vertex_attributes: 30,
                max_inter_stage_shader_variables: 31,
                max_color_attachment_bytes_per_sample: 128,
                max_compute_workgroup_storage_size: 32768,
                max_compute_invocations_per_workgroup: 1024,
                max_compute_workgroup_size_x: 1024,
                max_compute_workgroup_size_y: 1024,
                ..least.clone()
            },
        ),
        // wgpu-hal 30.0.1, `metal/adapter.rs`: family Apple 7, which is M1. A buffer may be as large as half of the smallest
        // memory, 8 GB; buffers of all kinds share 29 places.
        (
            "Apple silicon",
            wgpu::Limits {
                max_texture_dimension_1d: 16384,
                max_texture_dimension_2d: 16384,
                max_texture_array_layers: 2048,
                max_bind_groups: 8,
                max_sampled_textures_per_shader_stage: 96,
                max_samplers_per_shader_stage: 16,
                max_storage_buffers_per_shader_stage: 29,
                max_storage_textures_per_shader_stage: 32,
                max_uniform_buffers_per_shader_stage: 29,
                max_buffers_and_acceleration_structures_per_shader_stage: 29,
                max_uniform_buffer_binding_size: 4 << 30,
                max_buffer_size: 4 << 30,
                max_storage_buffer_binding_size: 4 << 30,
                max_vertex_buffers: 16,
                max_vertex_attributes: 31,
                max_inter_stage_shader_variables: 31,
                min_uniform_buffer_offset_alignment: 32,
                min_storage_buffer_offset_alignment: 32,
                max_color_attachment_bytes_per_sample: 64,
                max_compute_workgroup_storage_size: 32768,
                max_compute_invocations_per_workgroup: 1024,
                max_compute_workgroup_size_x: 1024,
                max_compute_workgroup_size_y: 1024,
                max_compute_workgroup_size_z: 1024,
                ..least
            },
        ),
    ]
}

#[test]
fn every_pipeline_builds_with_the_limits_of_other_backends() {
    for (name, limits) in limits() {
        let gpu = Gpu::noop_with(limits.clone()).unwrap_or_else(|e| panic!("{name}: {e}"));
        // What is asked of a device beyond WebGPU's defaults is the size of textures and buffers, which engines choose.
        if limits == wgpu::Limits::default() {
            build_all(&gpu);
        } else {
            assert!(gpu.device.limits().max_texture_array_layers > 256, "{name}");
            build_engines(&gpu);
        }
    }
}

#[test]
#[should_panic(expected = "workgroup")]
fn canary_a_limit_below_what_a_pass_needs_is_seen() {
    let limits = wgpu::Limits { max_compute_invocations_per_workgroup: 32, ..wgpu::Limits::default() };
    build_engines(&Gpu::noop_exactly(limits).unwrap());
}

/// What an entry point asks of a device.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Resources {
    workgroup: [u32; 3],
    workgroup_bytes: u32,
    storage_buffers: usize,
    storage_textures: usize,
    textures: usize,
    uniforms: usize,
}

/// Bytes of workgroup memory that the entry point of `resolved` uses.
fn workgroup_bytes(Resolved { module, info }: &Resolved) -> u32 {
    let used = info.get_entry_point(0);
    let variables = module
        .global_variables
        .iter()
        .filter(|(handle, variable)| variable.space == AddressSpace::WorkGroup && !used[*handle].is_empty());
    variables.map(|(_, variable)| module.types[variable.ty].inner.size(module.to_ctx())).sum()
}

/// What each file's passes ask for, the most of all variants.
fn resources(variants: &BTreeSet<Variant>) -> BTreeMap<String, Resources> {
    let mut out = BTreeMap::<String, Resources>::new();
    for (file, groups) in entries() {
        let declared = || groups.iter().flat_map(|group| group.iter());
        let count = |wanted: &[Access]| declared().filter(|b| wanted.contains(&b.access)).count();
        use Access::*;
        let found = Resources {
            storage_buffers: count(&[Read, Write]),
            storage_textures: count(&[
                ReadLayers,
                ReadLayersWords,
                ReadLayersWord,
                UpdateLayersWord,
                StorageLayer,
                StorageLayers,
                StorageLayersRgba,
                StorageLayersWords,
            ]),
            textures: count(&[
                Texture,
                Layers,
                Multisampled,
                Cube,
                DepthLayers,
                Picture,
                UintPicture,
                UintLayers,
            ]),
            uniforms: count(&[Uniform, DynamicUniform]),
            ..Resources::default()
        };
        out.insert(file.to_owned(), found);
    }
    for variant in variants.iter().filter(|v| v.stage() == ShaderStage::Compute) {
        let resolved = resolve(variant).unwrap_or_else(|e| panic!("{e}"));
        let bytes = workgroup_bytes(&resolved);
        let of_file = out.get_mut(&variant.file).unwrap();
        of_file.workgroup = resolved.module.entry_points[0].workgroup_size;
        of_file.workgroup_bytes = of_file.workgroup_bytes.max(bytes);
    }
    out
}

/// Names of passes in the table of the documents, sorted; then their numbers.
fn table(resources: &BTreeMap<String, Resources>) -> String {
    let mut out = String::from(
        "| shader | workgroup | workgroup memory, bytes | storage buffers | storage textures | textures | uniform buffers |\n\
         |---|---|---|---|---|---|---|\n",
    );
    for (file, r) in resources {
        let [x, y, z] = r.workgroup;
        let workgroup = if z == 0 { "draws".to_owned() } else { format!("{x}×{y}×{z}") };
        let _ = writeln!(
            out,
            "| `{file}` | {workgroup} | {} | {} | {} | {} | {} |",
            r.workgroup_bytes, r.storage_buffers, r.storage_textures, r.textures, r.uniforms
        );
    }
    out
}

#[test]
fn the_documents_state_what_shaders_ask_of_a_device() {
    let gpu = Gpu::noop().unwrap();
    // Passes that draw have no workgroups: their numbers are those that they declare.
    let resources = resources(&recorded(|| {
        build_triggers(&gpu);
        build_engines(&gpu);
    }));
    let compute = resources.values().filter(|r| r.workgroup != [0; 3]).count();
    assert_eq!(compute, entries().iter().filter(|(file, _)| compose(file, "").contains("@compute")).count());
    let limits = wgpu::Limits::default();
    for (file, r) in &resources {
        assert!(r.workgroup_bytes <= limits.max_compute_workgroup_storage_size, "{file}");
        assert!(
            r.workgroup.iter().product::<u32>() <= limits.max_compute_invocations_per_workgroup,
            "{file}"
        );
        assert!(r.storage_buffers <= limits.max_storage_buffers_per_shader_stage as usize, "{file}");
        assert!(r.storage_textures <= limits.max_storage_textures_per_shader_stage as usize, "{file}");
    }
    assert!(resources["trigger/scan.wgsl"].workgroup_bytes > 0, "a scan shares sums");
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/portability.md");
    let text = std::fs::read_to_string(path).unwrap();
    let (begin, end) = ("<!-- shader resources: begin -->\n", "<!-- shader resources: end -->");
    let (before, rest) = text.split_once(begin).expect("the table's begin is marked");
    let (stated, after) = rest.split_once(end).expect("the table's end is marked");
    let measured = format!("\n{}\n", table(&resources));
    if std::env::var_os("EVIS_BLESS").is_some() {
        std::fs::write(path, format!("{before}{begin}{measured}{end}{after}")).unwrap();
        return;
    }
    assert!(
        stated == measured,
        "docs/portability.md is stale: run `EVIS_BLESS=1 cargo test --release --workspace --locked --lib \
         the_documents_state_what_shaders_ask_of_a_device`; the table is now\n{measured}"
    );
}

#[test]
fn canary_workgroup_memory_is_counted() {
    let text = "var<workgroup> used: array<vec4<f32>, 64>; var<workgroup> unused: array<f32, 64>;
        @compute @workgroup_size(64) fn main(@builtin(local_invocation_index) i: u32) { used[i] = vec4(1.0); }";
    let variant = Variant {
        file: "canary".into(),
        entry: "main".into(),
        stage: 2,
        constants: Vec::new(),
        text: text.into(),
    };
    assert_eq!(workgroup_bytes(&resolve(&variant).unwrap()), 1024);
}
