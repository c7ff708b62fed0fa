//! The engine's light against the oracle's at one instant, pixel by pixel: where events are wrong, light mostly is.

mod draw;
mod table;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use evis_core::{ConfigError, Region};
use evis_render::{Gpu, RunConfig, Shadows, Simulator};
use evis_scene::Scene;
use evis_truth::Lattice;
use evis_truth::rays::{Beam, Textures};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::eye::Eye;
use super::file::{self, VERSION};
use crate::chart::{Progress, Stage, first_environment, today};
use crate::error::ChartError;
use crate::result::DeviceNote;

/// This report's kind in JSON.
pub(super) const REPORT: &str = "light";

/// Relative difference up to which two sets of few samples agree.
const AGREE: f64 = 1e-3;

/// What light is compared with.
#[derive(Clone, Debug, PartialEq)]
pub struct LightSettings {
    /// Name of the camera; `None` takes the first.
    pub camera: Option<String>,
    /// Width and height in pixels; `None` takes the camera's own.
    pub size: Option<(u32, u32)>,
    /// Scene time in microseconds.
    pub at_us: i64,
    /// The engine's samples per pixel.
    pub samples: u32,
    /// How the engine finds shadows.
    pub shadows: Shadows,
    /// How many of the worst pixels are listed.
    pub worst: usize,
}

impl Default for LightSettings {
    fn default() -> Self {
        Self {
            camera: None,
            size: Some((160, 120)),
            at_us: 0,
            samples: 16,
            shadows: Shadows::Maps,
            worst: 10,
        }
    }
}

/// How far log light is off over some pixels: engine minus oracle of ln(Y / Y_ref + eps). Percentiles interpolate linearly.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightError {
    /// Pixels.
    pub pixels: u64,
    /// Median of the magnitude.
    pub median: f64,
    /// 95th percentile of the magnitude.
    pub p95: f64,
    /// Largest magnitude.
    pub worst: f64,
    /// Mean; positive where the engine is too bright.
    pub bias: f64,
}

impl LightError {
    /// `None` of no pixels.
    fn of(differences: impl Iterator<Item = f64>) -> Option<Self> {
        let all: Vec<f64> = differences.collect();
        let mut sizes: Vec<f64> = all.iter().map(|d| d.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let quantile = |part: f64| {
            let place = part * (sizes.len() - 1) as f64;
            let (low, high) = (sizes[place as usize], sizes[(place.ceil() as usize).min(sizes.len() - 1)]);
            low + (high - low) * place.fract()
        };
        let worst = *sizes.last()?;
        let bias = all.iter().sum::<f64>() / all.len() as f64;
        Some(Self { pixels: all.len() as u64, median: quantile(0.5), p95: quantile(0.95), worst, bias })
    }
}

/// Light of one kind of pixel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightOf {
    /// Region, or object and material.
    pub name: String,
    /// How far it is off.
    pub error: LightError,
}

/// One pixel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightPixel {
    /// Column.
    pub x: u32,
    /// Row.
    pub y: u32,
    /// Object and material in its middle.
    pub object: String,
    /// What runs through it.
    pub region: Region,
    /// Luminance of the engine.
    pub engine: f64,
    /// Luminance of the oracle.
    pub oracle: f64,
    /// Difference of log light.
    pub difference: f64,
}

/// The engine's light against the oracle's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightReport {
    /// [`VERSION`].
    pub evis_verify: u32,
    /// What it is a report of: `light`.
    pub report: String,
    /// Version of EVIS.
    pub evis: String,
    /// Day, YYYY-MM-DD.
    pub measured: String,
    /// Where it ran.
    pub device: DeviceNote,
    /// What its user calls the scene.
    pub scene: String,
    /// The camera.
    pub camera: String,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Scene time in microseconds.
    pub at_us: i64,
    /// Samples per pixel.
    pub samples: u32,
    /// How the engine found shadows.
    pub shadows: Shadows,
    /// `Y_ref` of the logarithm, the engine's own.
    pub reference_luminance: f64,
    /// `eps` of the logarithm.
    pub log_eps: f64,
    /// All pixels.
    pub all: LightError,
    /// By region, those that occur. A pixel counts as silhouette where objects or flat faces meet in it.
    pub regions: Vec<LightOf>,
    /// By object and material in the pixel's middle, of pixels that nothing runs through; those that are off most first.
    pub objects: Vec<LightOf>,
    /// The worst pixels, the worst first.
    pub worst: Vec<LightPixel>,
    /// Difference of log light, row by row.
    pub difference: Vec<f32>,
}

/// What the oracle sees in a pixel.
struct Seen {
    luminance: f64,
    region: Region,
    /// Index of the object in its middle; `None` for what lies behind all.
    object: Option<usize>,
}

/// Compares the light of `scene`, which its user calls `name`. `progress` is told what it is busy with and the part of that
/// which is done, from several threads, and stops the work by returning false.
///
/// # Errors
/// A setting that cannot be used, a scene without a camera, a device that fails, or a stop.
pub fn verify_light(
    gpu: &Gpu,
    name: &str,
    scene: &Scene,
    settings: &LightSettings,
    progress: &Progress<'_>,
) -> Result<LightReport, ChartError> {
    if settings.at_us < 0 {
        return Err(ConfigError::new("at", settings.at_us as f64 * 1e-3, "0 or later (milliseconds)").into());
    }
    let camera = match &settings.camera {
        Some(name) => scene.camera(name)?,
        None => 0,
    };
    let Some(camera) = scene.cameras.get(camera).map(|c| c.name.clone()) else {
        return Err(ConfigError::new("scene", name, "one with a camera").into());
    };
    let config = RunConfig {
        samples: settings.samples,
        shadows: Some(settings.shadows),
        size: settings.size,
        cameras: vec![camera],
        start_us: settings.at_us,
        ..RunConfig::default()
    };
    if !progress(Stage::Runs, 0.0) {
        return Err(ChartError::Stopped);
    }
    let scene = first_environment(scene);
    let mut simulator = Simulator::new(gpu, Arc::clone(&scene), config)?;
    let engine = simulator.luminance(0, 0)?;
    let Some(info) = simulator.cameras().first().cloned() else {
        return Err(ConfigError::new("scene", name, "one with a camera").into());
    };
    let config = simulator.config();
    let reference = config.reference_luminance.map_or(1.0, f64::from);
    let eps = f64::from(config.sensor.log_eps);

    let textures = Textures::new(&scene);
    let eye = Eye::new(&scene, &textures, &info, settings.at_us as f64)?;
    let lattices = [Lattice::First.offsets(0), Lattice::Second.offsets(0), Lattice::First.offsets(2)];
    let mut seen: Vec<Seen> = Vec::with_capacity(engine.len());
    for y in 0..info.height {
        if !progress(Stage::Truth, f64::from(y) / f64::from(info.height)) {
            return Err(ChartError::Stopped);
        }
        let row = (0..info.width).into_par_iter().map(|x| look(&eye, &lattices, [x as u16, y as u16]));
        seen.extend(row.collect::<Vec<_>>());
    }

    let log = |luminance: f64| (luminance / reference + eps).ln();
    let difference: Vec<f64> = engine.iter().zip(&seen).map(|(e, s)| log(*e) - log(s.luminance)).collect();
    let label = |object: Option<usize>| object_name(&scene, &eye, object);
    let all = LightError::of(difference.iter().copied());
    let all = all.ok_or_else(|| ConfigError::new("size", "empty", "at least one pixel"))?;
    let of_region = |region: Region| {
        let members = seen.iter().zip(&difference).filter(|(s, _)| s.region == region);
        let error = LightError::of(members.map(|(_, d)| *d))?;
        Some(LightOf { name: region.name().into(), error })
    };
    let mut by_object: BTreeMap<Option<usize>, Vec<f64>> = BTreeMap::new();
    for (s, d) in seen.iter().zip(&difference).filter(|(s, _)| s.region == Region::Interior) {
        by_object.entry(s.object).or_default().push(*d);
    }
    let mut named: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for (object, differences) in by_object {
        named.entry(label(object)).or_default().extend(differences);
    }
    let objects = named.into_iter().filter_map(|(name, differences)| {
        Some(LightOf { name, error: LightError::of(differences.into_iter())? })
    });
    let mut objects: Vec<LightOf> = objects.collect();
    objects.sort_by(|a, b| b.error.p95.total_cmp(&a.error.p95));
    let mut order: Vec<usize> = (0..difference.len()).collect();
    order.sort_by(|a, b| difference[*b].abs().total_cmp(&difference[*a].abs()));
    let pixel = |i: usize| LightPixel {
        x: i as u32 % info.width,
        y: i as u32 / info.width,
        object: label(seen[i].object),
        region: seen[i].region,
        engine: engine[i],
        oracle: seen[i].luminance,
        difference: difference[i],
    };
    Ok(LightReport {
        evis_verify: VERSION,
        report: REPORT.into(),
        evis: env!("CARGO_PKG_VERSION").into(),
        measured: today(),
        device: DeviceNote::of(gpu),
        scene: name.into(),
        camera: info.name.clone(),
        width: info.width,
        height: info.height,
        at_us: settings.at_us,
        samples: settings.samples,
        shadows: settings.shadows,
        reference_luminance: reference,
        log_eps: eps,
        all,
        regions: Region::ALL.into_iter().filter_map(of_region).collect(),
        objects,
        worst: order.into_iter().take(settings.worst).map(pixel).collect(),
        difference: difference.iter().map(|d| *d as f32).collect(),
    })
}

/// A pixel's mean light: with few samples where two independent sets of them agree, with many elsewhere.
fn look(eye: &Eye<'_>, lattices: &[Vec<[f64; 2]>; 3], [x, y]: [u16; 2]) -> Seen {
    let corner = [f64::from(x), f64::from(y)];
    let at = |[u, v]: [f64; 2]| [corner[0] + 0.5 + u, corner[1] + 0.5 + v];
    // All rays of a pixel share one look for what they can meet.
    let beam = Beam::new(&eye.caster, &eye.pinhole, corner, corner.map(|v| v + 1.0));
    let (mut shapes, mut kinds) = (BTreeSet::new(), BTreeSet::new());
    let mut sum = |offsets: &[[f64; 2]]| -> f64 {
        let light = offsets.iter().map(|o| {
            let (light, kind) = beam.look(at(*o));
            shapes.insert((kind.object, kind.face));
            kinds.insert(kind);
            light
        });
        light.sum()
    };
    let [first, second, many] = lattices;
    let [a, b] = [first, second].map(|offsets| (sum(offsets), offsets.len() as f64));
    let mean = (a.0 + b.0) / (a.1 + b.1);
    let apart = (a.0 / a.1 - b.0 / b.1).abs();
    let luminance = if apart > AGREE * mean { sum(many) / many.len() as f64 } else { mean };
    let region = match (shapes.len(), kinds.len()) {
        (0 | 1, 0 | 1) => Region::Interior,
        (0 | 1, _) => Region::ShadowEdge,
        _ => Region::Silhouette,
    };
    let object = eye.caster.hit_at(&eye.pinhole, at([0.0, 0.0])).map(|hit| hit.object);
    Seen { luminance, region, object }
}

/// Node and material of an object.
fn object_name(scene: &Scene, eye: &Eye<'_>, object: Option<usize>) -> String {
    let Some(object) = object.and_then(|i| eye.caster.geometry().matter().objects.get(i)) else {
        return "background".into();
    };
    let node = scene.nodes.get(object.node).map_or("", |node| node.name.as_str());
    let primitive = scene.meshes.get(object.mesh).and_then(|m| m.primitives.get(object.primitive));
    let material = primitive.and_then(|p| scene.materials.get(p.material)).map_or("", |m| m.name.as_str());
    format!("{node} / {material}")
}

impl LightReport {
    /// JSON in one line.
    ///
    /// # Errors
    /// None that could be put right.
    pub fn to_json(&self) -> Result<String, ChartError> {
        file::to_json(self)
    }

    /// Reads what [`LightReport::to_json`] wrote; `path` names it in errors.
    ///
    /// # Errors
    /// No JSON, another report, or one of another version.
    pub fn from_json(text: &str, path: &Path) -> Result<Self, ChartError> {
        file::from_json(text, REPORT, path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_told_by_magnitude_and_bias_by_sign() {
        let error = LightError::of([0.1, -0.3, 0.2, 0.0].into_iter()).unwrap();
        assert_eq!((error.pixels, error.worst), (4, 0.3));
        assert!((error.median - 0.15).abs() < 1e-12 && error.bias.abs() < 1e-12, "{error:?}");
        assert!((error.p95 - 0.285).abs() < 1e-12, "{error:?}");
        assert!(LightError::of(std::iter::empty()).is_none());
        let brighter = LightError::of([0.1, -0.3, 0.2, 0.4].into_iter()).unwrap();
        assert!((brighter.bias - 0.1).abs() < 1e-12, "canary");
    }
}
