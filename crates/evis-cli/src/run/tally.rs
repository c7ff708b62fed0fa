//! Counts and times of a run.

use std::time::Duration;

use evis_core::{CameraInfo, LabelKind};
use evis_render::{Packet, PacketReport, StageTimes};
use serde::Serialize;

/// Counts of a view.
#[derive(Clone, Debug, Serialize)]
pub(super) struct ViewTally {
    pub(super) environment: usize,
    pub(super) camera: String,
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) events: u64,
    pub(super) on: u64,
    pub(super) off: u64,
    pub(super) labels: u64,
}

impl ViewTally {
    pub(super) fn pixels(&self) -> f64 {
        f64::from(self.width) * f64::from(self.height)
    }
}

/// Counts and times of the run so far.
pub(super) struct Tally {
    pub(super) views: Vec<ViewTally>,
    pub(super) cameras: usize,
    pub(super) report: PacketReport,
    pub(super) packets: u64,
    /// Frames beside the events, of all views.
    pub(super) frames: u64,
    pub(super) end_us: i64,
    pub(super) write: Duration,
}

impl Tally {
    pub(super) fn new(environments: usize, cameras: &[CameraInfo]) -> Self {
        let of = |environment, c: &CameraInfo| ViewTally {
            environment,
            camera: c.name.clone(),
            width: c.width,
            height: c.height,
            events: 0,
            on: 0,
            off: 0,
            labels: 0,
        };
        Self {
            views: (0..environments).flat_map(|e| cameras.iter().map(move |c| of(e, c))).collect(),
            cameras: cameras.len(),
            report: PacketReport::default(),
            packets: 0,
            frames: 0,
            end_us: 0,
            write: Duration::ZERO,
        }
    }

    pub(super) fn add(&mut self, packet: &Packet, write: Duration) {
        for view in &packet.views {
            if let Some(tally) = self.views.get_mut(view.environment * self.cameras + view.camera) {
                let on = view.events.iter().filter(|e| e.p == 1).count() as u64;
                tally.events += view.events.len() as u64;
                tally.on += on;
                tally.off += view.events.len() as u64 - on;
                tally.labels += view.labels.len() as u64;
                let frames = view.labels.iter().filter(|label| label.kind == LabelKind::Frame);
                self.frames += frames.count() as u64;
            }
        }
        let (sum, new) = (&mut self.report, &packet.report);
        sum.events += new.events;
        sum.dropped += new.dropped;
        sum.suppressed += new.suppressed;
        sum.clamped += new.clamped;
        sum.instants += new.instants;
        sum.reruns += new.reruns;
        sum.audited += new.audited;
        sum.audited_with_others += new.audited_with_others;
        sum.changed += new.changed;
        sum.findings.extend_from_slice(&new.findings);
        sum.drawn_pixels += new.drawn_pixels;
        sum.on_device += new.on_device;
        sum.refollowed += new.refollowed;
        sum.resting += new.resting;
        // The same in every packet.
        sum.rendered_tiles = new.rendered_tiles;
        sum.keyframes += new.keyframes;
        sum.clipped += new.clipped;
        for light in &new.clipped_light {
            light.clone().add_to(&mut sum.clipped_light);
        }
        sum.unknown += new.unknown;
        add_times(&mut sum.times, &new.times);
        self.packets += 1;
        self.end_us = packet.end_us;
        self.write += write;
    }
}

fn add_times(sum: &mut StageTimes, new: &StageTimes) {
    sum.host_ms += new.host_ms;
    sum.device_wait_ms += new.device_wait_ms;
    sum.pack_ms += new.pack_ms;
    sum.total_ms += new.total_ms;
}
