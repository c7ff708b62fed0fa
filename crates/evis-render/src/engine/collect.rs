//! What came back of submissions: events, arrays, luminance, counts, audits.

use std::time::Instant;

use super::{Engine, InFlight, Work, milliseconds};
use crate::error::EngineError;
use crate::gpu::commands::Commands;
use crate::gpu::readback::{map, wait_mapped};
use crate::gpu::uniforms::Status;
use crate::output::dense;
use crate::sampling::audit::{AuditRun, Finding};
use crate::sampling::clipped::{self, ClippedLight, ClippedRun};
use crate::sensor::dense::DenseReadback;
use crate::sensor::group::{Slot, Unit};
use crate::sensor::host::LuminanceReadback;
use crate::sensor::unpack;

impl Engine {
    /// Reports what audits found.
    pub(super) fn take_audit(&mut self, run: &AuditRun) -> Result<(), EngineError> {
        let failed = |e: wgpu::MapRangeError| EngineError::Device(format!("cannot read audits back: {e}"));
        let words: Vec<u32> = {
            let bytes = run.staging.get_mapped_range(..).map_err(failed)?;
            bytes.chunks_exact(4).map(bytemuck::pod_read_unaligned).collect()
        };
        run.staging.unmap();
        self.report.audited += run.entries.len() as u64;
        self.report.audited_with_others += run.entries.iter().filter(|e| e.other_samples).count() as u64;
        for (entry, change, pixel) in run.changes(&words) {
            let view = &self.context.views[entry.view];
            if change <= 0.5 * view.sensor.threshold_on.min(view.sensor.threshold_off) {
                continue;
            }
            self.report.changed += 1;
            let scene = &self.context.scene;
            self.report.findings.push(Finding {
                environment: view.environment,
                camera: self.context.camera_name(view),
                pixel,
                t_us: entry.t_us,
                object: entry.node.map(|node| scene.nodes[node].name.clone()),
                skipped: entry.skipped,
                other_samples: entry.other_samples,
                change,
            });
        }
        Ok(())
    }

    /// Reports what was clipped of keyframes that were not counted yet.
    pub(super) fn take_clipped(&mut self, run: &ClippedRun) -> Result<(), EngineError> {
        let failed = |e: wgpu::MapRangeError| {
            EngineError::Device(format!("cannot read counts of clipped light back: {e}"))
        };
        let until = &mut self.clipped_until[run.group];
        let known = *until;
        {
            let bytes = run.staging.get_mapped_range(..).map_err(failed)?;
            for (entry, (pixels, luminance)) in run.entries.iter().zip(clipped::counts(&bytes)) {
                *until = (*until).max(entry.keyframe);
                if pixels == 0 || entry.keyframe <= known {
                    continue;
                }
                let view = &self.context.views[entry.view];
                self.report.clipped += u64::from(pixels);
                let light = ClippedLight {
                    environment: view.environment,
                    camera: self.context.camera_name(view),
                    t_us: entry.t_us,
                    pixels: u64::from(pixels),
                    luminance,
                    brightest: run.brightest,
                    reference_luminance: self.context.reference_luminance,
                };
                light.add_to(&mut self.report.clipped_light);
            }
        }
        run.staging.unmap();
        Ok(())
    }

    /// Takes a submission's events; false where it has to run again.
    pub(super) fn take_events(
        &mut self,
        unit: Unit,
        slot: Slot,
        predicted: u32,
    ) -> Result<bool, EngineError> {
        let _span = tracing::trace_span!("unpack events").entered();
        let packing = Instant::now();
        let group = &self.groups[unit.group];
        let header = group.header_bytes();
        let failed = |e: wgpu::MapRangeError| EngineError::Device(format!("cannot read events back: {e}"));
        let (status, offsets) = {
            let bytes = slot.staging.get_mapped_range(0..header).map_err(failed)?;
            let status: Status = bytemuck::pod_read_unaligned(&bytes[..size_of::<Status>()]);
            let offsets: Vec<u32> = bytes[size_of::<Status>()..]
                .chunks_exact(4)
                .take(group.views.len() + 1)
                .map(bytemuck::pod_read_unaligned)
                .collect();
            (status, offsets)
        };
        if status.mismatched > 0 {
            return Err(EngineError::Device(format!(
                "{} pixels fired other events than were counted: the driver computes the same expression in two \
                 ways; please report device and driver",
                status.mismatched
            )));
        }
        if status.stalled != 0 {
            slot.staging.unmap();
            return self.recover(unit, status.event_count).map(|()| false);
        }
        // Events that the device made arrays of stay there.
        let made = self.dense.as_ref().is_some_and(|own| own.makes(unit.group));
        let count = status.event_count;
        if !made {
            if count > predicted {
                self.fetch_rest(&slot, header, predicted, count)?;
            }
            self.unpack(&unit, &slot, &offsets, count)?;
        }
        slot.staging.unmap();
        self.free.push(slot);
        self.complete_us[unit.group] = unit.end_us(&self.context.grid);
        let group = &mut self.groups[unit.group];
        self.last_counts[group.targets] = count;
        self.report.events += if made { u64::from(count) } else { 0 };
        self.report.clamped += u64::from(status.clamped.wrapping_sub(group.clamped));
        group.clamped = status.clamped;
        self.report.unknown += u64::from(status.unknown.wrapping_sub(group.unknown));
        group.unknown = status.unknown;
        self.report.suppressed += u64::from(status.suppressed.wrapping_sub(group.suppressed));
        group.suppressed = status.suppressed;
        self.report.instants += u64::from(unit.instants);
        self.report.times.pack_ms += milliseconds(packing);
        if made {
            self.submit_dense(unit.group);
        }
        Ok(true)
    }

    /// Takes the `count` events of `unit` that `slot` brought, whose views begin at `offsets`.
    fn unpack(&mut self, unit: &Unit, slot: &Slot, offsets: &[u32], count: u32) -> Result<(), EngineError> {
        let failed = |e: wgpu::MapRangeError| EngineError::Device(format!("cannot read events back: {e}"));
        let (base_us, end_us) = (unit.base_us(&self.context.grid), unit.end_us(&self.context.grid));
        let group = &mut self.groups[unit.group];
        let header = group.header_bytes();
        let end = header + u64::from(count) * 8;
        let bytes;
        let records: &[[u32; 2]] = if count == 0 {
            &[]
        } else {
            bytes = slot.staging.get_mapped_range(header..end).map_err(failed)?;
            bytemuck::try_cast_slice(&bytes)
                .map_err(|e| EngineError::Device(format!("events came back misaligned: {e}")))?
        };
        match group.chain.as_mut().filter(|chain| !chain.readouts.is_empty()) {
            None => {
                let (span_us, views) = ((end_us - base_us) as u32, group.views.iter().copied());
                unpack::views(records, offsets, base_us, span_us, self.caused, views, |v, e| {
                    unpack::append(&mut self.arrived[v].events, e)
                });
            }
            Some(chain) => {
                let parts = offsets.windows(2).map(|w| &records[w[0] as usize..w[1] as usize]);
                for ((readout, records), v) in chain.readouts.iter_mut().zip(parts).zip(&group.views) {
                    let mut fired = unpack::events(records, base_us, self.caused);
                    self.report.dropped += readout.pass(&mut fired, end_us, &mut self.arrived[*v].events);
                }
            }
        }
        Ok(())
    }

    /// Lets the arrays of windows whose events are all there come to the host.
    fn submit_dense(&mut self, group: usize) {
        let Some(own) = &mut self.dense else { return };
        let submitted = Instant::now();
        let gpu = &self.context.gpu;
        let mut encoder = Commands::new(gpu, "dense arrays");
        let read = own.read(gpu, &mut encoder, group, self.complete_us[group]);
        if read.is_empty() {
            return;
        }
        let submission = encoder.submit(gpu);
        for readback in read {
            let mapped = map(&readback.staging);
            self.in_flight.push_back(InFlight {
                work: Work::Dense(readback),
                submitted,
                submission: submission.clone(),
                mapped,
                clipped: None,
            });
        }
    }

    /// Takes the arrays of a window.
    pub(super) fn take_dense(&mut self, readback: DenseReadback) -> Result<(), EngineError> {
        let Some(own) = &mut self.dense else { return Ok(()) };
        let packing = Instant::now();
        let (views, output) = (&self.groups[readback.group].views, *own.output());
        own.take(readback, |place, window, words| {
            let view = views[place];
            let made = dense::of_words(&output, window, words, self.context.views[view].size());
            self.arrived[view].dense.push(made);
        })?;
        self.report.times.pack_ms += milliseconds(packing);
        Ok(())
    }

    /// Runs the sensor model of the host on what a submission brought.
    pub(super) fn take_luminance(&mut self, readback: LuminanceReadback) -> Result<(), EngineError> {
        let _span = tracing::trace_span!("sensor on the host").entered();
        let packing = Instant::now();
        let unit = readback.unit;
        let group = &self.groups[unit.group];
        for fired in self.host_walk.take(&self.context, &self.targets[group.targets], group, readback)? {
            self.arrived[fired.view].events.extend(fired.events);
            self.report.clamped += fired.report.clamped;
            self.report.unknown += fired.report.unknown;
            self.report.suppressed += fired.report.suppressed;
            self.report.dropped += fired.report.dropped;
        }
        let exposure = &self.context.views[group.views[0]].sensor.exposure;
        self.complete_us[unit.group] = exposure.known_us(unit.end_us(&self.context.grid));
        self.report.instants += u64::from(unit.instants);
        self.report.times.pack_ms += milliseconds(packing);
        Ok(())
    }

    /// More events came than were predicted: copies the rest too.
    fn fetch_rest(&self, slot: &Slot, header: u64, have: u32, count: u32) -> Result<(), EngineError> {
        slot.staging.unmap();
        let mut encoder = Commands::new(&self.context.gpu, "rest of the events");
        let (from, bytes) = (u64::from(have) * 8, u64::from(count - have) * 8);
        encoder.copy_buffer_to_buffer(&slot.events, from, &slot.staging, header + from, bytes);
        let submission = encoder.submit(&self.context.gpu);
        let mapped = map(&slot.staging);
        wait_mapped(&self.context.gpu, &submission, &mapped)
    }
}
