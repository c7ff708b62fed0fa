//! Runs settings, times them, and has each scored.

use std::hash::Hasher as _;
use std::sync::Arc;
use std::task::Poll;
use std::time::{Duration, Instant};

use evis_core::Event;
use evis_core::fnv::Fnv;
use evis_core::metric::Score;
use evis_render::{Gpu, RunConfig, Simulator, quality};
use evis_scene::Scene;

use crate::error::ChartError;
use crate::ladder::Setting;
use crate::result::Point;

/// Packets are as long as those of `evis run`.
const PACKET_US: i64 = 10_000;

/// How often a run looks whether it should stop.
const LOOK: Duration = Duration::from_millis(50);

/// What is measured.
pub struct Series<'a> {
    /// Where it runs.
    pub gpu: &'a Gpu,
    /// What it renders; its first environment is measured.
    pub scene: Arc<Scene>,
    /// Settings, each with its run.
    pub runs: &'a [(Setting, RunConfig)],
    /// Simulated microseconds of each.
    pub duration_us: i64,
    /// Runs of each setting.
    pub repetitions: usize,
}

/// Scores what a run fired.
pub type Judge<'a> = dyn Fn(&[Event], &RunConfig) -> Result<Score, ChartError> + 'a;

/// One run.
struct Run {
    setup_ms: f64,
    wall_ms_per_s: f64,
    events: Vec<Event>,
    clamped: u64,
    /// As it was settled.
    config: RunConfig,
    /// Whole pictures per simulated second.
    drawn_hz: f64,
}

/// Measures every setting: all of them once, then all of them again, so that whatever else the machine does meets all
/// alike. `judge` scores the first repetition's events. `progress` is told the part that is done, and stops the work by
/// returning false.
///
/// # Errors
/// A run that fails, repetitions that differ, whatever `judge` says, or a stop.
pub fn measure(
    series: &Series<'_>,
    judge: &Judge<'_>,
    progress: &dyn Fn(f64) -> bool,
) -> Result<Vec<Point>, ChartError> {
    let work = |(_, config): &(Setting, RunConfig)| config.rate_hz * f64::from(config.samples).sqrt();
    let total = series.runs.iter().map(work).sum::<f64>() * series.repetitions as f64;
    let mut done = 0.0;
    let mut points: Vec<Point> = Vec::with_capacity(series.runs.len());
    let mut settled: Vec<RunConfig> = Vec::with_capacity(series.runs.len());
    for repetition in 0..series.repetitions {
        for (index, entry) in series.runs.iter().enumerate() {
            let (setting, config) = entry;
            let share = work(entry);
            let told = |part: f64| progress((done + share * part) / total);
            let run = run(series, settled.get(index).unwrap_or(config), &told)?;
            let hash = hash(&run.events);
            match points.get_mut(index) {
                None => {
                    let reference_luminance = config.reference_luminance;
                    settled.push(RunConfig { reference_luminance, ..run.config.clone() });
                    points.push(Point {
                        setting: setting.clone().settled(&run.config, run.drawn_hz),
                        setup_ms: run.setup_ms,
                        wall_ms_per_s: vec![run.wall_ms_per_s],
                        events: run.events.len() as u64,
                        clamped: run.clamped,
                        hash: format!("{hash:016x}"),
                        score: judge(&run.events, config)?,
                    })
                }
                Some(point) => point.repeat(&run, repetition, hash)?,
            }
            done += share;
        }
    }
    Ok(points)
}

impl Point {
    /// Adds a later repetition.
    fn repeat(&mut self, run: &Run, repetition: usize, hash: u64) -> Result<(), ChartError> {
        let found = format!("{hash:016x}");
        if found != self.hash {
            return Err(ChartError::NotRepeatable {
                label: self.setting.label(),
                repetition: repetition + 1,
                expected: self.hash.clone(),
                found,
            });
        }
        self.setup_ms = self.setup_ms.min(run.setup_ms);
        self.wall_ms_per_s.push(run.wall_ms_per_s);
        Ok(())
    }
}

fn run(series: &Series<'_>, config: &RunConfig, progress: &dyn Fn(f64) -> bool) -> Result<Run, ChartError> {
    if !progress(0.0) {
        return Err(ChartError::Stopped);
    }
    let started = Instant::now();
    let mut config = config.clone();
    quality::settle(series.gpu, &series.scene, &mut config)?;
    let simulator = Simulator::new(series.gpu, Arc::clone(&series.scene), config)?;
    let setup = started.elapsed();

    let settled = simulator.config().clone();
    let pixels: u64 = simulator.cameras().iter().map(|c| u64::from(c.width) * u64::from(c.height)).sum();
    let pixels = pixels.max(1) as f64 * simulator.environments() as f64;

    let started = Instant::now();
    let mut events = Vec::new();
    let (mut clamped, mut drawn) = (0, 0);
    let mut stream = simulator.stream(series.duration_us, PACKET_US)?;
    loop {
        match stream.poll_next(LOOK) {
            Poll::Pending => {}
            Poll::Ready(None) => break,
            Poll::Ready(Some(packet)) => {
                let mut packet = packet?;
                clamped += packet.report.clamped;
                drawn += packet.report.drawn_pixels;
                if let Some(view) = packet.views.first_mut() {
                    events.append(&mut view.events);
                }
                if !progress(packet.end_us as f64 / series.duration_us as f64) {
                    return Err(ChartError::Stopped);
                }
                continue;
            }
        }
        if !progress(0.0) {
            return Err(ChartError::Stopped);
        }
    }
    let wall_ms = started.elapsed().as_secs_f64() * 1.0e3;
    Ok(Run {
        setup_ms: setup.as_secs_f64() * 1.0e3,
        wall_ms_per_s: wall_ms / (series.duration_us as f64 * 1.0e-6),
        events,
        clamped,
        config: settled,
        drawn_hz: drawn as f64 / pixels / (series.duration_us as f64 * 1.0e-6),
    })
}

/// Of what events say.
fn hash(events: &[Event]) -> u64 {
    let mut fnv = Fnv::default();
    for event in events {
        fnv.write(&event.t.to_le_bytes());
        fnv.write(&event.x.to_le_bytes());
        fnv.write(&event.y.to_le_bytes());
        fnv.write(&event.p.to_le_bytes());
    }
    fnv.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::made_up;
    use evis_core::Polarity;

    #[test]
    fn hashes_see_every_field() {
        let event = Event::new(5, 1, 2, Polarity::On);
        // The published value of the empty string.
        assert_eq!(hash(&[]), 0xcbf2_9ce4_8422_2325);
        for other in [
            Event::new(6, 1, 2, Polarity::On),
            Event::new(5, 2, 2, Polarity::On),
            Event::new(5, 1, 1, Polarity::On),
            Event::new(5, 1, 2, Polarity::Off),
        ] {
            assert_ne!(hash(&[event]), hash(&[other]));
        }
        let same = Event::new(5, 1, 2, Polarity::On);
        assert_eq!(hash(&[event]), hash(&[same]));
    }

    #[test]
    fn repetitions_that_differ_are_an_error() {
        let mut point = made_up::scene_chart("x").points.remove(0);
        point.hash = format!("{:016x}", 7);
        let run = Run {
            setup_ms: 1.0,
            wall_ms_per_s: 5.0,
            events: vec![],
            clamped: 0,
            config: RunConfig::default(),
            drawn_hz: 1.0,
        };
        point.repeat(&run, 1, 7).unwrap();
        assert_eq!((point.wall_ms_per_s.last(), point.setup_ms), (Some(&5.0), 1.0));
        let error = point.repeat(&run, 2, 8).unwrap_err().to_string();
        assert!(error.contains("125 Hz ×1") && error.contains("repetition 3"), "{error}");
    }
}
