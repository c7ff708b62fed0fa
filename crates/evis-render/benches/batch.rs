//! Cost per camera over the batch: the table of `make bench-batch`, in Markdown.
//!
//! 1 to 256 environments of one camera at 64x64, 1 to 16 at 346x260, by `--quality standard` and by `native` at 500 Hz with 4
//! samples. Every environment shows the same, so that a camera of a large batch has the same work as a single one. Rows are
//! measured in turn, several times, and the least counts: of time on all cores, which other work on the machine changes little,
//! and of time on the wall.

#[allow(dead_code, reason = "other benchmarks ask for more")]
#[path = "support/measure.rs"]
mod measure;

use std::sync::Arc;

use evis_render::gpu::work::Counts;
use evis_render::scene::{Scene, Variant};
use evis_render::{EngineError, Gpu, Method, Quality, RunConfig, Simulator, quality};

use measure::{Series, measure};

/// Whatever ends a measurement.
type Failure = Box<dyn std::error::Error>;

const SCENE: &str = "spinner";
/// Stream of a repetition, and before the first one: four blocks of decoupled sampling, 32 instants of 500 Hz.
const STEPS_US: [i64; 2] = [65_536, 64_000];
const REPETITIONS: i64 = 3;
const SIZES: [(&[usize], (u32, u32)); 2] = [(&[1, 4, 16, 64, 256], (64, 64)), (&[1, 4, 16], (346, 260))];

/// What a camera and a second of stream take.
struct Row {
    method: String,
    cameras: usize,
    size: (u32, u32),
    simulator: Simulator,
    step_us: i64,
    now_us: i64,
    series: Series,
    counts: [u64; 3],
    /// Bytes of luminance, 4 per pixel and sample drawn or evaluation of a pixel, and of events, 8 each.
    bytes: [u64; 2],
}

impl Row {
    /// Simulates on, and keeps the least time.
    fn measure(&mut self, gpu: &Gpu, samples: u32) -> Result<(), Failure> {
        let before = gpu.counts();
        let step = || self.simulator.step(self.now_us + self.step_us);
        let (sample, packet) = measure::<_, EngineError>(step)?;
        self.series.push(sample);
        self.now_us += self.step_us;
        let now = gpu.counts();
        let of = |count: fn(&Counts) -> u64| count(&now) - count(&before);
        self.counts = [of(|c| c.submissions), of(|c| c.passes), of(|c| c.dispatches)];
        self.bytes = [packet.report.drawn_pixels * u64::from(4 * samples), packet.report.events * 8];
        Ok(())
    }

    /// `single`: milliseconds of a core per camera of the batch of one.
    fn line(&self, single: f64) -> String {
        let per = self.per_camera();
        let [submissions, passes, dispatches] = self.counts.map(|n| n as f64 * per);
        let [drawn, events] = self.bytes.map(|n| n as f64 * per / 1e6);
        let (width, height) = self.size;
        format!(
            "| {} | {width}×{height} | {} | {:.0} | {:.2} | {:.0} | {submissions:.0} | {passes:.0} | {dispatches:.0} | {drawn:.1} | {events:.2} |",
            self.method,
            self.cameras,
            self.cpu_ms(),
            self.cpu_ms() / single,
            self.series.wall() * 1e3 * per,
        )
    }

    /// Milliseconds of a core per camera and second of stream.
    fn cpu_ms(&self) -> f64 {
        self.series.cpu() * 1e3 * self.per_camera()
    }

    /// One over cameras times seconds of stream.
    fn per_camera(&self) -> f64 {
        1.0 / (self.cameras as f64 * self.step_us as f64 * 1e-6)
    }
}

/// `scene` in `count` environments that show the same.
fn environments(scene: &Scene, count: usize) -> Arc<Scene> {
    let mut scene = scene.clone();
    scene.cameras.truncate(1);
    Arc::new(Scene { variants: vec![Variant::default(); count], ..scene })
}

/// The settings of a method.
fn config(gpu: &Gpu, scene: &Arc<Scene>, size: (u32, u32), standard: bool) -> Result<RunConfig, Failure> {
    let base = RunConfig { size: Some(size), reference_luminance: Some(0.5), ..RunConfig::default() };
    if !standard {
        return Ok(RunConfig { rate_hz: 500.0, samples: 4, ..base });
    }
    let mut config = RunConfig { quality: Some(Quality::Standard), ..base };
    quality::settle(gpu, scene, &mut config)?;
    Ok(config)
}

fn main() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let wanted = |name: &str| {
        let named: Vec<_> = args.iter().filter(|arg| !arg.starts_with('-')).collect();
        named.is_empty() || named.iter().any(|arg| name.contains(arg.as_str()))
    };
    let gpu = Gpu::open(std::env::var("EVIS_DEVICE").ok().as_deref())?;
    let scene = evis_render::scene::builtin::load(SCENE, 0)?;
    let device = gpu.summary();
    println!(
        "{} ({}, {}); scene `{SCENE}`, least of {REPETITIONS}. Per camera and second of stream:\n",
        device.name, device.kind, device.driver
    );
    println!(
        "| method | pixels | cameras | core-ms | of one camera | wall ms | submissions | passes | dispatches | luminance, MB | events, MB |\n\
         |---|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|"
    );
    for (standard, step_us) in [true, false].into_iter().zip(STEPS_US) {
        for (counts, size) in SIZES {
            let mut rows = Vec::new();
            let mut samples = 0;
            for &cameras in counts {
                let scene = environments(&scene, cameras);
                let config = config(&gpu, &scene, size, standard)?;
                // An evaluation of decoupled sampling is one value.
                samples = if config.method == Method::Decoupled { 1 } else { config.samples };
                let method = match config.quality {
                    Some(quality) => format!("`{}` ({})", quality.name(), config.method.name()),
                    None => format!("`{}`", config.method.name()),
                };
                if !wanted(&format!("{method} {}x{}", size.0, size.1)) {
                    continue;
                }
                let mut simulator = Simulator::new(&gpu, scene, config)?;
                simulator.step(step_us)?;
                let (counts, bytes, now_us) = ([0; 3], [0; 2], step_us);
                rows.push(Row {
                    method,
                    cameras,
                    size,
                    simulator,
                    step_us,
                    now_us,
                    series: Series::default(),
                    counts,
                    bytes,
                });
            }
            for _ in 0..REPETITIONS {
                for row in &mut rows {
                    row.measure(&gpu, samples)?;
                }
            }
            let single = rows.first().map_or(1.0, Row::cpu_ms);
            for row in &rows {
                println!("{}", row.line(single));
            }
        }
    }
    Ok(())
}
