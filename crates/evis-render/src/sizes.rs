//! Sizes of targets, buffers and dispatches: pure functions of the input.

/// Pixels per prefix block; `trigger/layout.wgsl` has the same constant.
pub const BLOCK_PIXELS: u32 = 64;
/// Invocations per workgroup of the pixel passes; `trigger/layout.wgsl` has the same constant.
pub const WORKGROUP: u32 = 64;
/// Bytes that luminance layers of one submission may take: a few such targets stay in a large cache,
/// and more instants per submission no longer pay.
pub const LUMINANCE_BUDGET: u64 = 48 << 20;
/// Most instants in one submission.
pub const MAX_INSTANTS: u32 = 32;

/// How views of one size share targets and submissions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Tile columns of the atlas.
    pub columns: u32,
    /// Tile rows of the atlas.
    pub rows: u32,
    /// Views per group; the last group may hold fewer.
    pub views_per_group: u32,
    /// Sampled instants per submission.
    pub instants: u32,
    /// Target layers, one per instant and sample.
    pub layers: u32,
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

/// Plans `views` views of `width` x `height` with `samples` layers per instant.
///
/// Returns `None` where even one view does not fit: its edge exceeds the device's texture limit,
/// or the samples of one instant exceed its layers.
pub fn plan(width: u32, height: u32, samples: u32, views: u32, limits: DeviceLimits) -> Option<Plan> {
    if width > limits.texture_edge || height > limits.texture_edge || samples > limits.texture_layers {
        return None;
    }
    let pixels = u64::from(padded_pixels(width, height));
    let view_bytes = pixels * 4 * u64::from(samples);
    // 8 bytes of pixel memory per pixel is the widest per-pixel binding.
    let by_binding = (limits.storage_binding / (pixels * 8)).max(1);
    let by_budget = (LUMINANCE_BUDGET / view_bytes).max(1);
    let by_atlas = u64::from(limits.texture_edge / width) * u64::from(limits.texture_edge / height);
    let views_per_group = by_binding.min(by_budget).min(by_atlas).min(u64::from(views)).max(1) as u32;
    let columns = views_per_group
        .min(limits.texture_edge / width)
        .min((f64::from(views_per_group) * f64::from(height) / f64::from(width)).sqrt().ceil() as u32)
        .max(1);
    let rows = views_per_group.div_ceil(columns);
    let (columns, rows) = if rows * height > limits.texture_edge {
        let rows = limits.texture_edge / height;
        (views_per_group.div_ceil(rows), rows)
    } else {
        (columns, rows)
    };
    let group_bytes = view_bytes * u64::from(views_per_group);
    let instants = (LUMINANCE_BUDGET / group_bytes)
        .clamp(1, u64::from(MAX_INSTANTS))
        .min(u64::from(limits.texture_layers / samples)) as u32;
    Some(Plan { columns, rows, views_per_group, instants, layers: instants * samples })
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
        let plan = plan(640, 480, 4, 1, LIMITS).unwrap();
        assert_eq!((plan.columns, plan.rows, plan.views_per_group), (1, 1, 1));
        assert!(plan.instants > 4 && plan.layers == plan.instants * 4);
    }

    #[test]
    fn every_plan_fits_the_device() {
        for (w, h) in [(1, 1), (64, 64), (346, 260), (640, 480), (1280, 720), (8192, 8192), (8192, 1)] {
            for samples in [1, 4, 16, 256] {
                for views in [1, 2, 7, 64, 1000] {
                    let plan = plan(w, h, samples, views, LIMITS).unwrap();
                    assert!(plan.columns * w <= 8192 && plan.rows * h <= 8192, "{plan:?} {w}x{h}");
                    assert!(plan.columns * plan.rows >= plan.views_per_group, "{plan:?}");
                    assert!(plan.layers <= 256 && plan.instants >= 1);
                }
            }
        }
        assert!(plan(8193, 1, 1, 1, LIMITS).is_none());
    }

    #[test]
    fn dispatches_cover_their_items() {
        for items in [1, 64, 65, 65_535 * 64, 65_535 * 64 + 1, 50_000_000] {
            let (x, y) = dispatch(items, 64);
            assert!(x <= 65_535 && y <= 65_535 && u64::from(x) * u64::from(y) * 64 >= u64::from(items));
        }
    }
}
