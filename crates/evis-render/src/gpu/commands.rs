//! Recording commands: every pass has a label, is a span of `tracing`, and is counted. Where a trace is written and the
//! device has timestamps, the passes' times on the device are in it too.

use std::ops::{Deref, DerefMut};

use tracing::span::EnteredSpan;

use crate::gpu::Gpu;

/// Passes of a submission whose times are taken: two queries each, and a set has no more than this.
const MOST_TIMED: u32 = wgpu::QUERY_SET_MAX_QUERIES / 2;

/// Queries of the passes of a command buffer.
struct Timed {
    queries: wgpu::QuerySet,
    labels: Vec<String>,
}

/// A command encoder that labels, traces and counts its passes.
pub struct Commands {
    encoder: wgpu::CommandEncoder,
    timed: Option<Timed>,
    passes: u64,
    dispatches: u64,
}

impl Deref for Commands {
    type Target = wgpu::CommandEncoder;

    fn deref(&self) -> &Self::Target {
        &self.encoder
    }
}

impl DerefMut for Commands {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.encoder
    }
}

impl Commands {
    /// Starts a command buffer.
    pub fn new(gpu: &Gpu, label: &str) -> Self {
        let timed = gpu.clock.as_ref().map(|_| Timed {
            queries: gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some(label),
                ty: wgpu::QueryType::Timestamp,
                count: 2 * MOST_TIMED,
            }),
            labels: Vec::new(),
        });
        let descriptor = wgpu::CommandEncoderDescriptor { label: Some(label) };
        Self { encoder: gpu.device.create_command_encoder(&descriptor), timed, passes: 0, dispatches: 0 }
    }

    /// Begins a compute pass.
    pub fn compute(&mut self, label: &str) -> Compute<'_> {
        let span = tracing::trace_span!("compute pass", pass = label).entered();
        self.passes += 1;
        let timestamp_writes =
            self.timed.as_mut().and_then(|timed| timed.next(label)).map(|(query_set, begin, end)| {
                wgpu::ComputePassTimestampWrites {
                    query_set,
                    beginning_of_pass_write_index: Some(begin),
                    end_of_pass_write_index: Some(end),
                }
            });
        let descriptor = wgpu::ComputePassDescriptor { label: Some(label), timestamp_writes };
        let pass = self.encoder.begin_compute_pass(&descriptor);
        Compute { pass, dispatches: &mut self.dispatches, _span: span }
    }

    /// Begins a render pass into `colors` and `depth`.
    pub fn render(
        &mut self,
        label: &str,
        colors: &[Option<wgpu::RenderPassColorAttachment<'_>>],
        depth: wgpu::RenderPassDepthStencilAttachment<'_>,
    ) -> Render<'_> {
        let span = tracing::trace_span!("render pass", pass = label).entered();
        self.passes += 1;
        let timestamp_writes =
            self.timed.as_mut().and_then(|timed| timed.next(label)).map(|(query_set, begin, end)| {
                wgpu::RenderPassTimestampWrites {
                    query_set,
                    beginning_of_pass_write_index: Some(begin),
                    end_of_pass_write_index: Some(end),
                }
            });
        let pass = self.encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some(label),
            color_attachments: colors,
            depth_stencil_attachment: Some(depth),
            timestamp_writes,
            ..Default::default()
        });
        Render { pass, _span: span }
    }

    /// Submits what was recorded.
    pub fn submit(mut self, gpu: &Gpu) -> wgpu::SubmissionIndex {
        let _span =
            tracing::trace_span!("submit", passes = self.passes, dispatches = self.dispatches).entered();
        gpu.counters.add(self.passes, self.dispatches);
        let timed = self.timed.take().filter(|timed| !timed.labels.is_empty());
        let Some((clock, timed)) = gpu.clock.as_ref().zip(timed) else {
            return gpu.queue.submit([self.encoder.finish()]);
        };
        let queries = 2 * timed.labels.len() as u32;
        let buffer = |usage| {
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("pass times"),
                size: u64::from(queries) * u64::from(wgpu::QUERY_SIZE),
                usage: usage | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let resolved = buffer(wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC);
        let staging = buffer(wgpu::BufferUsages::MAP_READ);
        self.encoder.resolve_query_set(&timed.queries, 0..queries, &resolved, 0);
        self.encoder.copy_buffer_to_buffer(&resolved, 0, &staging, 0, staging.size());
        let submission = gpu.queue.submit([self.encoder.finish()]);
        clock.expect(staging, timed.labels);
        submission
    }
}

impl Timed {
    /// Queries of the next pass; `None` where the set is full.
    fn next(&mut self, label: &str) -> Option<(&wgpu::QuerySet, u32, u32)> {
        let index = self.labels.len() as u32;
        if index == MOST_TIMED {
            return None;
        }
        self.labels.push(label.to_owned());
        Some((&self.queries, 2 * index, 2 * index + 1))
    }
}

/// A compute pass being recorded.
pub struct Compute<'e> {
    pass: wgpu::ComputePass<'e>,
    dispatches: &'e mut u64,
    _span: EnteredSpan,
}

impl Compute<'_> {
    /// Records a dispatch of `pipeline`, with `group` at `offsets` as its group 0.
    pub fn dispatch(
        &mut self,
        pipeline: &wgpu::ComputePipeline,
        group: &wgpu::BindGroup,
        offsets: &[u32],
        (x, y, z): (u32, u32, u32),
    ) {
        *self.dispatches += 1;
        self.pass.set_pipeline(pipeline);
        self.pass.set_bind_group(0, group, offsets);
        self.pass.dispatch_workgroups(x, y, z);
    }

    /// The same of as many workgroups as `counts` says at byte `at`, along each axis.
    pub fn dispatch_indirect(
        &mut self,
        pipeline: &wgpu::ComputePipeline,
        group: &wgpu::BindGroup,
        offsets: &[u32],
        (counts, at): (&wgpu::Buffer, u64),
    ) {
        *self.dispatches += 1;
        self.pass.set_pipeline(pipeline);
        self.pass.set_bind_group(0, group, offsets);
        self.pass.dispatch_workgroups_indirect(counts, at);
    }
}

/// A render pass being recorded.
pub struct Render<'e> {
    pass: wgpu::RenderPass<'e>,
    _span: EnteredSpan,
}

impl<'e> Deref for Render<'e> {
    type Target = wgpu::RenderPass<'e>;

    fn deref(&self) -> &Self::Target {
        &self.pass
    }
}

impl DerefMut for Render<'_> {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.pass
    }
}
