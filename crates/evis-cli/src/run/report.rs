//! What a run has done.

use std::path::PathBuf;
use std::time::Duration;

use evis_render::{Antialias, DeviceSummary, Method, RunConfig, Shadows};
use serde::Serialize;

use super::job::Job;
use super::settings::Settings;
use super::tally::ViewTally;
use crate::warnings::Warnings;
use crate::{scene_source, text};

/// Milliseconds of work per stage, summed over the run.
#[derive(Debug, Serialize)]
struct Milliseconds {
    setup: f64,
    host: f64,
    device_wait: f64,
    pack: f64,
    packets: f64,
    write: f64,
}

/// What `--report` and `--json` tell.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    pub(super) outputs: Vec<PathBuf>,
    pub(super) interrupted: bool,
    pub(super) device: DeviceSummary,
    pub(super) settings: Settings,
    pub(super) stream_s: f64,
    pub(super) wall_s: f64,
    /// Stream seconds per second of work.
    pub(super) real_time_factor: f64,
    pub(super) events: u64,
    pub(super) on: u64,
    pub(super) off: u64,
    /// Per second of work.
    pub(super) events_per_second: f64,
    /// Per second of stream time.
    pub(super) events_per_stream_second: f64,
    /// Lost to the readout's rate limit.
    pub(super) dropped: u64,
    /// Lost to refractory periods.
    pub(super) suppressed: u64,
    pub(super) clamped: u64,
    /// How instants were sampled.
    pub(super) method: &'static str,
    pub(super) instants: u64,
    /// Pixels drawn, all views and instants, each by all of its samples.
    pub(super) drawn_pixels: u64,
    /// Tiles of 16x16 pixels that decoupled sampling leaves to rendering.
    pub(super) rendered_tiles: u64,
    /// Of the pixels drawn, those that compute passes of decoupled sampling have evaluated; and pixels that they left to the
    /// processor, and pixels of tiles in which nothing changed, counted in each block of time.
    pub(super) on_device: u64,
    pub(super) refollowed: u64,
    pub(super) resting: u64,
    pub(super) keyframes: u64,
    /// Pixels of keyframes that were brighter than the method counts.
    pub(super) clipped: u64,
    /// Pixels and instants that the method could not know.
    pub(super) unknown: u64,
    pub(super) reruns: u64,
    /// Tiles that were skipped or sampled less often, and were rendered once more to compare.
    pub(super) audited: u64,
    /// Of those: tiles that were compared by samples at other places than those of the stream.
    pub(super) audited_with_others: u64,
    /// Of the audited ones: tiles in which light had changed by more than half a threshold.
    pub(super) changed: u64,
    pub(super) packets: u64,
    /// Beside the events, of all views.
    pub(super) frames: u64,
    milliseconds: Milliseconds,
    pub(super) views: Vec<ViewTally>,
    pub(super) warnings: Vec<String>,
}

impl Report {
    pub(super) fn new(
        settings: &Settings,
        device: &DeviceSummary,
        job: &Job,
        warnings: &Warnings,
        setup: Duration,
        wall: Duration,
        interrupted: bool,
    ) -> Self {
        let tally = &job.tally;
        let wall_s = wall.as_secs_f64();
        let stream_s = tally.end_us as f64 / 1.0e6;
        let (on, off) = tally.views.iter().fold((0, 0), |(on, off), v| (on + v.on, off + v.off));
        let per = |n: u64, s: f64| if s > 0.0 { n as f64 / s } else { 0.0 };
        let times = tally.report.times;
        Self {
            outputs: job.outputs.clone(),
            interrupted,
            device: device.clone(),
            settings: settings.clone(),
            stream_s,
            wall_s,
            real_time_factor: if wall_s > 0.0 { stream_s / wall_s } else { 0.0 },
            events: on + off,
            on,
            off,
            events_per_second: per(on + off, wall_s),
            events_per_stream_second: per(on + off, stream_s),
            dropped: tally.report.dropped,
            suppressed: tally.report.suppressed,
            clamped: tally.report.clamped,
            method: settings.run.method.name(),
            instants: tally.report.instants,
            drawn_pixels: tally.report.drawn_pixels,
            rendered_tiles: tally.report.rendered_tiles,
            on_device: tally.report.on_device,
            refollowed: tally.report.refollowed,
            resting: tally.report.resting,
            keyframes: tally.report.keyframes,
            clipped: tally.report.clipped,
            unknown: tally.report.unknown,
            reruns: tally.report.reruns,
            audited: tally.report.audited,
            audited_with_others: tally.report.audited_with_others,
            changed: tally.report.changed,
            packets: tally.packets,
            frames: tally.frames,
            milliseconds: Milliseconds {
                setup: setup.as_secs_f64() * 1.0e3,
                host: times.host_ms,
                device_wait: times.device_wait_ms,
                pack: times.pack_ms,
                packets: times.total_ms,
                write: tally.write.as_secs_f64() * 1.0e3,
            },
            views: tally.views.clone(),
            warnings: warnings.0.clone(),
        }
    }

    /// `native, 4 samples, 1000 instants`, of a run that drew `drawn` pictures' pixels.
    fn rendered_line(&self, run: &RunConfig, drawn: f64) -> String {
        let shaded = if run.antialias == Antialias::Edges { ", 1 in 4 shaded" } else { "" };
        let rays = if run.shadows == Some(Shadows::Rays) { ", shadows by rays" } else { "" };
        let mut line = format!("{}, {} samples{shaded}{rays}, ", self.method, run.samples);
        if let Some(px) = run.adaptive_px {
            let hz = if self.stream_s > 0.0 { drawn / self.stream_s } else { 0.0 };
            let curves = if run.takes_curves() { ", curves between them" } else { "" };
            line += &format!(
                "every {px} px at up to {} Hz{curves}, {hz:.0} pictures' pixels per second, ",
                run.rate_hz
            );
        }
        line + &format!("{} instants", text::grouped(self.instants))
    }

    /// `native, 1000 instants`, `splat 30 Hz ×8, 31 keyframes, 241 instants, 17 pixels unknown`.
    fn method_line(&self) -> String {
        let instants = text::grouped(self.instants);
        match self.settings.run.method.keyframes() {
            None => {
                let run = &self.settings.run;
                let drawn =
                    self.drawn_pixels as f64 / self.views.iter().map(ViewTally::pixels).sum::<f64>().max(1.0);
                if run.method == Method::Decoupled {
                    let rendered = match self.rendered_tiles {
                        0 => String::new(),
                        tiles => format!("; {} tiles rendered", text::grouped(tiles)),
                    };
                    let device = match self.on_device {
                        0 => String::new(),
                        count => format!(
                            "; {:.1} % of them on the device, {} pixels of a block left to the processor",
                            100.0 * count as f64 / self.drawn_pixels.max(1) as f64,
                            text::grouped(self.refollowed)
                        ),
                    };
                    format!(
                        "{}, {drawn:.0} evaluations of a pixel, each at its own times{device}{rendered}",
                        self.method
                    )
                } else {
                    self.rendered_line(run, drawn)
                }
            }
            Some((keyframe_hz, steps)) => format!(
                "{} {keyframe_hz} Hz ×{steps}, {} keyframes, {instants} instants, {} pixels unknown",
                self.method,
                text::grouped(self.keyframes),
                text::grouped(self.unknown)
            ),
        }
    }

    /// What matters, in four lines.
    pub(super) fn summary(&self) -> String {
        let lines = [self.files_line(), self.events_line(), self.time_line(), self.quality_line()];
        lines.join("\n")
    }

    fn files_line(&self) -> String {
        let file = match self.outputs.as_slice() {
            [first, .., last] => {
                format!("{} to {} ({} files)", first.display(), last.display(), self.outputs.len())
            }
            outputs => outputs.iter().map(|output| output.display().to_string()).collect(),
        };
        let first = self.views.iter().filter(|view| view.environment == 0);
        let cameras: Vec<_> =
            first.map(|view| format!("{} {}x{}", view.camera, view.width, view.height)).collect();
        format!("file     {file}  ({})", cameras.join(", "))
    }

    fn events_line(&self) -> String {
        format!(
            "events   {}, {}/s of stream, {:.1} % ON",
            text::grouped(self.events),
            text::short(self.events_per_stream_second),
            text::percent(self.on, self.events)
        )
    }

    fn time_line(&self) -> String {
        let stopped = if self.interrupted { " (interrupted; the file is complete up to here)" } else { "" };
        let factor = text::significant(self.real_time_factor);
        format!(
            "time     {} s of stream{stopped} in {} s, {factor} × real time",
            self.stream_s,
            text::measured(self.wall_s)
        )
    }

    /// What is in force, and what was measured for it: on this scene, or nothing.
    fn quality_line(&self) -> String {
        let run = &self.settings.run;
        let Some(quality) = run.quality else {
            return format!("quality  {}, set by hand", self.method);
        };
        let scene = &self.settings.scene;
        let built_in = scene_source::builtins().iter().any(|(name, _)| name == scene);
        let measured = if built_in && self.settings.speed == 1.0 {
            quality.measured(&run.method).to_owned()
        } else {
            format!("not measured on this scene; `chart {scene}` measures it")
        };
        format!("quality  {} ({}); {measured}", quality.name(), self.method)
    }

    /// Everything else, for `--verbose`.
    pub(super) fn details(&self) -> String {
        let mut lines = Vec::new();
        for view in &self.views {
            lines.push(format!(
                "view     {}, {} {}x{}: {} events, {} label images",
                view.environment,
                view.camera,
                view.width,
                view.height,
                text::grouped(view.events),
                text::grouped(view.labels)
            ));
        }
        lines.push(format!("device   {}", self.device.name));
        lines.push(format!("method   {}", self.method_line()));
        if let Some(rate_hz) = self.settings.run.frame_rate_hz {
            lines.push(format!(
                "frames   {}, each {} ms at {rate_hz} Hz",
                text::grouped(self.frames),
                self.settings.run.exposure_us as f64 * 1e-3
            ));
        }
        lines.push(format!("work     {} events per second", text::short(self.events_per_second)));
        let ms = &self.milliseconds;
        lines.push(format!(
            "stages   setup {:.0} ms, host {:.0} ms, device wait {:.0} ms, pack {:.0} ms, write {:.0} ms",
            ms.setup, ms.host, ms.device_wait, ms.pack, ms.write
        ));
        lines.join("\n")
    }
}
