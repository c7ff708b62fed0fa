//! Every pipeline and bind group of the built-in scenes builds on `wgpu`'s `noop` backend, so a wrong declaration
//! fails where there is no driver. `portability.rs` builds every other variant, with the limits of other backends.

use std::sync::Arc;

use evis_core::{LabelKind, Warp};

use crate::config::{Antialias, Method, RunConfig};
use crate::gpu::Gpu;
use crate::world::view;

fn methods() -> [Method; 3] {
    [Method::Native, Method::Splat(Warp::default()), Method::Splat(Warp::evis_paper(8))]
}

#[test]
fn every_pipeline_builds_without_a_driver() {
    let gpu = Gpu::noop().unwrap();
    for (name, _) in evis_scene::builtin::names() {
        let scene = Arc::new(evis_scene::builtin::load(name, 0).unwrap());
        for antialias in [Antialias::Samples, Antialias::Edges] {
            for method in methods() {
                let mut config = RunConfig {
                    method,
                    antialias,
                    labels: LabelKind::ALL.to_vec(),
                    size: Some((32, 24)),
                    // Nothing is computed on noop: a measured reference would be read from an empty image.
                    reference_luminance: Some(1.0),
                    ..Default::default()
                };
                let (views, _) = view::views(&scene, &config).unwrap();
                let scope = gpu.device.push_error_scope(wgpu::ErrorFilter::Validation);
                crate::engine::Engine::new(&gpu, scene.clone(), views, &mut config).unwrap();
                let error = pollster::block_on(scope.pop());
                assert!(error.is_none(), "{name} {method:?}: {error:?}");
            }
        }
    }
}
