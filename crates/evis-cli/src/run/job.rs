//! The stream on its way into files.

use std::path::PathBuf;
use std::sync::Arc;
use std::task::Poll;
use std::time::{Duration, Instant};

use anyhow::Context;
use evis_core::LabelKind;
use evis_core::format::hdf5::{RecordingExtras, RecordingHeader, RecordingWriter};
use evis_render::{Bodies, BodyTimes, Imu, Method, Packet, RunConfig, Simulator};
use evis_scene::Scene;

use super::settings::{ImuSettings, PACKET_US};
use super::tally::Tally;
use crate::interrupt::Interrupt;
use crate::progress::{Forecast, Measured, Progress};
use crate::text;

/// A killed process loses at most what came since the last flush. By the clock: each one stores unfinished chunks again, so
/// that flushing a fast run for each part of its stream would fill the disk.
const FLUSH_EVERY: Duration = Duration::from_millis(400);

/// How often the estimate of the cost and Ctrl-C are polled.
const POLL: Duration = Duration::from_millis(20);

/// The first line is printed after this time, also without an estimate.
const MOST_WAIT: Duration = Duration::from_secs(10);

/// The settings of the run, what takes less, and how long the run takes: `cost` seconds per second of stream. That depends on
/// scene, size and device by factors of hundreds; a number that is not measured would be a guess.
pub(super) fn before_line(config: &RunConfig, duration_us: i64, cost: Option<f64>) -> String {
    let settings = config.quality.map_or_else(
        || format!("{}, set by hand", config.method.name()),
        |quality| format!("quality {} ({})", quality.name(), config.method.name()),
    );
    // Presets of decoupled sampling cost about the same: most of it goes to surfaces and pixels, whatever the step.
    let cheaper = match (config.quality, &config.method) {
        (Some(_), Method::Decoupled) => "; a smaller --size takes less".to_owned(),
        (quality, _) => quality
            .and_then(|quality| quality.cheaper())
            .map_or_else(String::new, |quality| format!("; --quality {} takes less", quality.name())),
    };
    let stream = text::seconds(duration_us);
    let Some(cost) = cost else {
        return format!(
            "{settings}: {stream} of stream; after a second of work follows how long it takes{cheaper}"
        );
    };
    format!("{settings}: {}{cheaper}", cost_line(config, duration_us, cost))
}

/// Whether labels or frames are rendered beside the events.
fn pictured(config: &RunConfig) -> bool {
    config.carried().iter().any(|kind| *kind != LabelKind::Cause)
}

/// Stream time in which each kind of picture comes once, in microseconds: over less, a measurement may miss it.
fn period_us(config: &RunConfig) -> i64 {
    if !pictured(config) {
        return 0;
    }
    let slowest_hz = config.frame_rate_hz.map_or(config.label_rate_hz, |hz| hz.min(config.label_rate_hz));
    (1e6 / slowest_hz).ceil() as i64
}

/// How long the run takes at `cost` seconds per second of stream.
fn cost_line(config: &RunConfig, duration_us: i64, cost: f64) -> String {
    let beside = if pictured(config) { ", labels and frames not counted" } else { "" };
    let total =
        text::roughly(Duration::try_from_secs_f64(cost * duration_us as f64 * 1e-6).unwrap_or(Duration::MAX));
    format!("{} of stream in {total}{beside}, by what its first part takes", text::seconds(duration_us))
}

/// How long the run takes, by what was measured.
fn forecast_line(config: &RunConfig, measured: &Measured, duration_us: i64) -> String {
    let with = if pictured(config) { "with labels and frames, " } else { "" };
    format!(
        "{with}about {} for {} of stream, by what {} to {} took",
        text::about(measured.total),
        text::seconds(duration_us),
        text::seconds(measured.from_us),
        text::seconds(measured.until_us)
    )
}

/// What moves in the stream's scene.
pub(super) struct Moving {
    scene: Arc<Scene>,
    /// One per environment.
    bodies: Vec<Bodies>,
    /// When they are sampled, where that was asked for.
    times: Option<BodyTimes>,
    /// Names of inertial measurement units, and the units, per environment.
    imu_names: Vec<String>,
    imus: Vec<Vec<Imu>>,
}

impl Moving {
    /// Objects of `scene`, and the cameras of `simulator`, `rate_hz` times per second; and `imus` in every environment.
    pub(super) fn new(
        scene: Arc<Scene>,
        simulator: &Simulator,
        rate_hz: Option<f64>,
        imus: &[ImuSettings],
    ) -> anyhow::Result<Self> {
        let start_us = simulator.config().start_us;
        let cameras = || simulator.cameras().iter().map(|camera| camera.name.as_str());
        let bodies = (0..simulator.environments())
            .map(|environment| Bodies::new(&scene, cameras(), environment, start_us))
            .collect::<Result<_, _>>()?;
        let imu_names = imus.iter().map(|imu| imu.name.clone()).collect();
        let units =
            |environment| imus.iter().map(|imu| imu.unit(&scene, simulator.config(), environment)).collect();
        let imus = (0..simulator.environments()).map(units).collect::<anyhow::Result<_>>()?;
        Ok(Self { scene, bodies, times: rate_hz.map(BodyTimes::new).transpose()?, imu_names, imus })
    }
}

/// The stream on its way into the files.
pub(super) struct Job {
    pub(super) moving: Moving,
    /// One per environment, as are `outputs` and `writers`.
    pub(super) headers: Vec<RecordingHeader>,
    pub(super) tally: Tally,
    pub(super) outputs: Vec<PathBuf>,
    pub(super) overwrite: bool,
    /// Made when the first packet is there: a run that fails at the start leaves no file.
    pub(super) writers: Vec<RecordingWriter>,
    pub(super) flushed: Instant,
}

impl Job {
    /// Streams `duration_us` into the files; tells whether it was interrupted.
    pub(super) fn stream(&mut self, simulator: Simulator, duration_us: i64) -> anyhow::Result<bool> {
        let interrupt = Interrupt::listen();
        let progress = Progress::new(u64::try_from(duration_us).unwrap_or(0));
        let config = simulator.config().clone();
        let mut forecast = Forecast::over(period_us(&config));
        let started = Instant::now();
        // The first line comes before the first packet, as soon as there is an estimate.
        let mut unpriced = true;
        let mut pending = config.method == Method::Decoupled;
        let mut packets = simulator.stream(duration_us, PACKET_US)?;
        loop {
            let next = packets.poll_next(POLL);
            let cost = packets.cost();
            match cost {
                Some(cost) if unpriced && !forecast.told => {
                    unpriced = false;
                    // Labels and frames are measured once a few have come.
                    forecast.told = !pictured(&config);
                    progress.line(&if pending {
                        before_line(&config, duration_us, Some(cost))
                    } else {
                        cost_line(&config, duration_us, cost)
                    });
                    pending = false;
                }
                None if pending && (next.is_ready() || started.elapsed() > MOST_WAIT) => {
                    progress.line(&before_line(&config, duration_us, None));
                    pending = false;
                }
                _ => {}
            }
            let packet = match next {
                Poll::Pending if interrupt.asked() && self.tally.packets > 0 => break,
                Poll::Pending => continue,
                Poll::Ready(None) => break,
                Poll::Ready(Some(packet)) => packet?,
            };
            let writing = Instant::now();
            tracing::trace_span!("write").in_scope(|| self.write(&packet))?;
            self.tally.add(&packet, writing.elapsed());
            let elapsed = started.elapsed();
            if let Some(measured) = forecast.at(packet.end_us, elapsed, duration_us) {
                progress.line(&forecast_line(&config, &measured, duration_us));
            }
            progress.stream(packet.end_us, self.tally.report.events, elapsed);
            if interrupt.asked() {
                break;
            }
        }
        Ok(interrupt.asked() && self.tally.end_us < duration_us)
    }

    /// Closes the files with `report_json` in them.
    pub(super) fn finish(&mut self, report_json: &str) -> anyhow::Result<()> {
        let writing = Instant::now();
        let _span = tracing::trace_span!("finish files").entered();
        self.create_writers()?;
        for writer in self.writers.drain(..) {
            writer.finish(report_json)?;
        }
        self.tally.write += writing.elapsed();
        Ok(())
    }

    fn create_writers(&mut self) -> anyhow::Result<()> {
        let files = self.outputs.iter().zip(&self.headers).zip(&self.moving.bodies);
        for ((path, header), bodies) in files.skip(self.writers.len()) {
            let (bodies, imus) = (bodies.infos().to_vec(), self.moving.imu_names.clone());
            let extras = RecordingExtras { imus, bodies, ..RecordingExtras::default() };
            self.writers.push(RecordingWriter::create_with_extras(path, header, &extras, self.overwrite)?);
        }
        Ok(())
    }

    fn write(&mut self, packet: &Packet) -> anyhow::Result<()> {
        self.create_writers()?;
        for view in &packet.views {
            let writer = self
                .writers
                .get_mut(view.environment)
                .with_context(|| format!("the engine sent environment {}, one too many", view.environment))?;
            writer.write_caused_events(view.camera, &view.events, &view.causes)?;
            for label in &view.labels {
                writer.write_label(view.camera, label)?;
            }
            for pose in &view.poses {
                writer.write_pose(view.camera, pose)?;
            }
        }
        let Moving { scene, bodies, times, imus, .. } = &mut self.moving;
        for t_us in times.as_mut().map_or_else(Vec::new, |times| times.advance(packet.end_us)) {
            for (bodies, writer) in bodies.iter_mut().zip(&mut self.writers) {
                writer.write_bodies(t_us, &bodies.at(scene, t_us))?;
            }
        }
        for (imus, writer) in imus.iter_mut().zip(&mut self.writers) {
            for (index, imu) in imus.iter_mut().enumerate() {
                writer.write_imu(index, &imu.advance(scene, packet.end_us))?;
            }
        }
        if self.flushed.elapsed() >= FLUSH_EVERY {
            for writer in &mut self.writers {
                writer.flush()?;
            }
            self.flushed = Instant::now();
        }
        Ok(())
    }

    /// After an error: files that hold nothing are removed, the others closed as incomplete.
    pub(super) fn give_up(&mut self, error: anyhow::Error) -> anyhow::Error {
        let created: Vec<_> = self.outputs.iter().take(self.writers.len()).collect();
        // A writer that goes stores what it holds, as far as it still can.
        self.writers.clear();
        if self.tally.packets == 0 {
            for path in created {
                // The first error is the one to tell.
                let _ = std::fs::remove_file(path);
            }
            return error;
        }
        let kept: Vec<_> = created.iter().map(|path| path.display().to_string()).collect();
        if kept.is_empty() {
            return error;
        }
        let until = text::seconds(self.tally.end_us);
        error.context(format!("{} ended before its time, at about {until}", kept.join(", ")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evis_render::Quality;

    #[test]
    fn what_is_in_force_is_said_before_the_first_work_and_how_long_it_takes_once_it_is_measured() {
        let line = |quality| before_line(&RunConfig { quality, ..RunConfig::default() }, 2_000_000, None);
        assert_eq!(
            line(Some(Quality::Standard)),
            "quality standard (native): 2 s of stream; after a second of work follows how long it takes; --quality draft takes less"
        );
        assert!(!line(Some(Quality::Draft)).contains("takes less"), "nothing is cheaper than draft");
        assert!(line(None).starts_with("native, set by hand: 2 s of stream"));
        let mut config =
            RunConfig { method: Method::Decoupled, quality: Some(Quality::Draft), ..RunConfig::default() };
        let sampled = |config: &RunConfig, cost| before_line(config, 2_000_000, Some(cost));
        assert_eq!(
            sampled(&config, 78.0),
            "quality draft (decoupled): 2 s of stream in about 3 min, by what its first part takes; a smaller --size takes less"
        );
        config.labels.push(LabelKind::Depth);
        assert_eq!(
            sampled(&config, 4.9),
            "quality draft (decoupled): 2 s of stream in a few seconds, labels and frames not counted, by what its first part takes; a smaller --size takes less"
        );
        let measured = Measured { from_us: 10_000, until_us: 30_000, total: Duration::from_secs(150) };
        assert_eq!(
            forecast_line(&RunConfig::default(), &measured, 2_000_000),
            "about 2 min for 2 s of stream, by what 0.01 s to 0.03 s took"
        );
        assert!(
            forecast_line(&config, &measured, 2_000_000).starts_with("with labels and frames, about 2 min")
        );
        assert_eq!((period_us(&RunConfig::default()), period_us(&config)), (0, 20_000));
        config.frame_rate_hz = Some(30.0);
        assert_eq!(period_us(&config), 33_334);
    }
}
