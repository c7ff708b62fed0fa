//! Sizes of targets, buffers and dispatches: pure functions of the input.

/// Distance between entries of a uniform buffer: WebGPU's guaranteed dynamic offset alignment.
pub const UNIFORM_ALIGNMENT: u64 = 256;

/// Pixels per prefix block; `trigger/layout.wgsl` has the same constant.
pub const BLOCK_PIXELS: u32 = 64;

/// Invocations per workgroup of the pixel passes; `trigger/layout.wgsl` has the same constant.
pub const WORKGROUP: u32 = 64;

/// Bytes that luminance layers of one submission may take: a few such targets stay in a large cache,
/// and more instants per submission no longer pay.
pub const LUMINANCE_BUDGET: u64 = 48 << 20;

/// Most instants in one submission: a pixel's `fired` has a bit for each.
pub const MAX_INSTANTS: u32 = 32;

/// A submission has several views where one alone has fewer pixels than this: a device with many processors wants more in
/// a dispatch.
pub const PARALLEL_PIXELS: u64 = 1 << 16;

/// Views share a submission only as far as it keeps so many instants: what an instant takes beside its samples, pixel memory
/// above all, is read and written once per submission.
pub const SHARED_INSTANTS: u32 = 8;

/// How views of one size share targets and submissions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Views per group; the last group may hold fewer.
    pub views_per_group: u32,
    /// Sampled instants per submission.
    pub instants: u32,
    /// Luminance layers, one per view, instant and sample.
    ///
    /// A view has layers of its own rather than a tile of an atlas: rasterisers round in target coordinates, so a
    /// tile's place would show in its pixels, and a view's bytes would depend on its neighbours.
    pub layers: u32,
}

/// What a method needs per view beside the luminance of instants.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MethodNeeds {
    /// Bytes of its widest binding.
    pub bytes: u64,
    /// Layers of its widest texture array.
    pub layers: u32,
    /// Instants that belong together, where more than one do; a power of two, at most [`MAX_INSTANTS`].
    pub block: u32,
    /// Whether groups of views would take from each other what is kept from one submission to the next: then all views that
    /// fit share one.
    pub keeps: bool,
}

/// What the device allows.
#[derive(Clone, Copy, Debug)]
pub struct DeviceLimits {
    /// Largest 2D texture edge.
    pub texture_edge: u32,
    /// Most layers of a 2D array.
    pub texture_layers: u32,
    /// Largest storage binding in bytes.
    pub storage_binding: u64,
}

impl DeviceLimits {
    /// Those of `device`.
    pub fn of(device: &wgpu::Device) -> Self {
        let limits = device.limits();
        Self {
            texture_edge: limits.max_texture_dimension_2d,
            texture_layers: limits.max_texture_array_layers,
            storage_binding: limits.max_storage_buffer_binding_size.min(limits.max_buffer_size),
        }
    }
}

/// Plans `views` views of `width` x `height` with `samples` layers per instant, at most `max_instants` at a time and whole
/// blocks of `needs.block`; `needs` is what the method takes for itself.
///
/// Returns `None` where even one view and instant does not fit the device.
pub fn plan(
    width: u32,
    height: u32,
    samples: u32,
    views: u32,
    max_instants: u32,
    needs: MethodNeeds,
    limits: DeviceLimits,
) -> Option<Plan> {
    let pixels = u64::from(padded_pixels(width, height));
    // Four bytes per pixel are the widest of the trigger's buffers: counts.
    let by_binding = limits.storage_binding / (pixels * 4).max(needs.bytes);
    if width > limits.texture_edge
        || height > limits.texture_edge
        || samples > limits.texture_layers
        || by_binding == 0
    {
        return None;
    }
    let layer_bytes = u64::from(width) * u64::from(height) * 4 * u64::from(samples);
    let by_budget = (LUMINANCE_BUDGET / layer_bytes).max(1);
    let by_layers = u64::from(limits.texture_layers / samples);
    let by_needs = u64::from(limits.texture_layers / needs.layers.max(1));
    let block = u64::from(needs.block.max(1));
    if by_layers < block {
        return None;
    }
    let most_views = by_binding
        .min((by_budget / block).max(1))
        .min(by_layers / block)
        .min(by_needs)
        .min(u64::from(views))
        .max(1);
    let instants_of = |views: u64| {
        let most = u64::from(max_instants.clamp(1, MAX_INSTANTS));
        (by_budget / views).min(by_layers / views).clamp(1, most)
    };
    // As many views as cost no instants, then as a device's processors want.
    let full = instants_of(1);
    let wanted = PARALLEL_PIXELS.div_ceil(u64::from(width) * u64::from(height));
    let fits =
        |views: u64, instants: u64| (1..=views).rev().find(|v| instants_of(*v) >= instants).unwrap_or(1);
    let views_per_group = if needs.keeps {
        most_views
    } else {
        let free = fits(most_views, full);
        free.max(fits(most_views.min(wanted), full.min(u64::from(SHARED_INSTANTS))))
    };
    let instants = instants_of(views_per_group);
    let views_per_group = views_per_group as u32;
    let instants = (instants / block * block).max(block) as u32;
    Some(Plan { views_per_group, instants, layers: views_per_group * instants * samples })
}

/// Row length of the per-pixel buffers: whole prefix blocks, so that a block never spans two rows.
pub const fn row_stride(width: u32) -> u32 {
    width.next_multiple_of(BLOCK_PIXELS)
}

/// Entries per view of the per-pixel buffers.
pub const fn padded_pixels(width: u32, height: u32) -> u32 {
    row_stride(width) * height
}

/// Workgroups per axis for `items` invocations of `workgroup` each, within the limit of 65 535 per axis.
pub const fn dispatch(items: u32, workgroup: u32) -> (u32, u32) {
    let groups = items.div_ceil(workgroup);
    if groups <= 65_535 { (groups, 1) } else { (65_535, groups.div_ceil(65_535)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: DeviceLimits =
        DeviceLimits { texture_edge: 8192, texture_layers: 256, storage_binding: 128 << 20 };

    #[test]
    fn one_vga_view_gets_several_instants() {
        let plan = plan(640, 480, 4, 1, 32, MethodNeeds::default(), LIMITS).unwrap();
        assert_eq!(plan.views_per_group, 1);
        assert!(plan.instants > 4 && plan.layers == plan.instants * 4);
    }

    #[test]
    fn every_plan_fits_the_device() {
        for (w, h) in [(1, 1), (64, 64), (346, 260), (640, 480), (1280, 720), (8192, 8192), (8192, 1)] {
            for samples in [1, 4, 16, 256] {
                for views in [1, 2, 7, 64, 1000] {
                    let Some(plan) = plan(w, h, samples, views, 32, MethodNeeds::default(), LIMITS) else {
                        assert!(w * h > 8192 * 1024, "{w}x{h} should fit");
                        continue;
                    };
                    assert!(plan.layers <= 256 && plan.instants >= 1 && plan.views_per_group >= 1);
                    let counts = u64::from(plan.views_per_group) * u64::from(padded_pixels(w, h)) * 4;
                    assert!(counts <= LIMITS.storage_binding, "{plan:?} {w}x{h}");
                }
            }
        }
        assert!(plan(8193, 1, 1, 1, 32, MethodNeeds::default(), LIMITS).is_none());
    }

    #[test]
    fn views_of_a_batch_keep_the_instants_of_a_single_one() {
        let limits = DeviceLimits { texture_layers: 2048, ..LIMITS };
        let of = |w, h, samples, views, limits, needs| plan(w, h, samples, views, 32, needs, limits).unwrap();
        let free = MethodNeeds::default();
        // What a camera costs beside its samples is shared by as many instants, however many cameras there are.
        for (w, h, samples) in [(346, 260, 4), (640, 480, 4), (1280, 720, 1), (64, 64, 16)] {
            let alone = of(w, h, samples, 1, limits, free);
            for views in [2, 16, 256] {
                let batch = of(w, h, samples, views, limits, free);
                assert!(
                    batch.instants >= alone.instants.min(SHARED_INSTANTS),
                    "{w}x{h}: {batch:?}, {alone:?}"
                );
            }
        }
        assert_eq!(of(346, 260, 4, 16, limits, free), Plan { views_per_group: 1, instants: 32, layers: 128 });
        // Small pictures go many at a time.
        let small = of(64, 64, 4, 256, limits, free);
        assert_eq!((small.views_per_group, small.instants), (16, 32));
        // Where a group's keyframes are in the way of another's, all go together.
        let keeping = MethodNeeds { keeps: true, ..free };
        assert_eq!(of(346, 260, 1, 16, limits, keeping).views_per_group, 16);
    }

    #[test]
    fn dispatches_cover_their_items() {
        for items in [1, 64, 65, 65_535 * 64, 65_535 * 64 + 1, 50_000_000] {
            let (x, y) = dispatch(items, 64);
            assert!(x <= 65_535 && y <= 65_535 && u64::from(x) * u64::from(y) * 64 >= u64::from(items));
        }
    }
}
