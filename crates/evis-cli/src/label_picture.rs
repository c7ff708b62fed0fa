//! Labels as pictures.

use evis_core::{LabelData, LabelKind};

use crate::args::Scale;
use crate::picture::{Canvas, Rgb, hdr_picture, reference_of};

/// Where a label says nothing: sky, background, a value that is not a number.
const NOTHING: Rgb = [0, 0, 0];

/// A label of `width` by `height` pixels. HDR frames and mean luminance are divided by `reference` and tone-mapped;
/// depth is brighter the nearer it is, and flow is coloured by direction, both scaled to the label's own extremes;
/// ids have a colour each, the same in every picture; normals are (x, y, z) as (red, green, blue).
pub(crate) fn label_picture(
    kind: LabelKind,
    data: &LabelData,
    (width, height): (usize, usize),
    scale: Scale,
    reference: &mut Option<f32>,
) -> Canvas {
    let colors: Vec<Rgb> = match data {
        LabelData::F32(values) if kind == LabelKind::Hdr || kind == LabelKind::Frame => {
            let grey: Vec<f32>;
            let rgb = if kind == LabelKind::Hdr {
                values
            } else {
                grey = values.iter().flat_map(|value| [*value; 3]).collect();
                &grey
            };
            let reference = *reference.get_or_insert_with(|| reference_of(rgb));
            return hdr_picture(rgb, width, height, scale, reference);
        }
        LabelData::F32(values) => colors_of(kind, values),
        LabelData::U32(ids) => ids.iter().map(|id| color_of_id(*id)).collect(),
        LabelData::U8(flags) => {
            flags.iter().map(|flag| if *flag == 0 { NOTHING } else { [255; 3] }).collect()
        }
    };
    let mut canvas = Canvas::new(scale.length(width), scale.length(height), NOTHING);
    for y in 0..canvas.height {
        for x in 0..canvas.width {
            // Ids and depths of neighbours have no mean: a reduced picture takes the first of each block.
            let at = match scale {
                Scale::Up(k) => (y / k.max(1) as usize) * width + x / k.max(1) as usize,
                Scale::Down(k) => (y * k.max(1) as usize) * width + x * k.max(1) as usize,
            };
            canvas.set(x, y, colors.get(at).copied().unwrap_or(NOTHING));
        }
    }
    canvas
}

fn colors_of(kind: LabelKind, values: &[f32]) -> Vec<Rgb> {
    match kind.channels() {
        2 => {
            let length = |flow: &[f32]| flow.iter().map(|v| v * v).sum::<f32>().sqrt();
            let longest = values.chunks_exact(2).map(length).filter(|v| v.is_finite()).fold(0.0, f32::max);
            values.chunks_exact(2).map(|flow| color_of_flow(flow, length(flow), longest)).collect()
        }
        3 => values.chunks_exact(3).map(color_of_normal).collect(),
        _ => {
            // Of reciprocals, so that what is near has most of the range.
            let near = |depth: f32| if depth > 0.0 && depth.is_finite() { Some(1.0 / depth) } else { None };
            let (low, high) = values
                .iter()
                .filter_map(|depth| near(*depth))
                .fold((f32::INFINITY, 0.0_f32), |(low, high), v| (low.min(v), high.max(v)));
            let grey = |v: f32| if high > low { 40.0 + 215.0 * (v - low) / (high - low) } else { 255.0 };
            values.iter().map(|depth| near(*depth).map_or(NOTHING, |v| [grey(v).round() as u8; 3])).collect()
        }
    }
}

/// Hue by direction, as much of it as the flow is long; white where nothing moves.
fn color_of_flow(flow: &[f32], length: f32, longest: f32) -> Rgb {
    let &[right, down] = flow else { return NOTHING };
    if !length.is_finite() {
        return NOTHING;
    }
    let share = if longest > 0.0 { length / longest } else { 0.0 };
    hue(down.atan2(right) / std::f32::consts::TAU).map(|c| (255.0 * (1.0 - share * (1.0 - c))).round() as u8)
}

fn color_of_normal(normal: &[f32]) -> Rgb {
    match *normal {
        [x, y, z] if x != 0.0 || y != 0.0 || z != 0.0 => [x, y, z].map(|v| ((v + 1.0) * 127.5).round() as u8),
        _ => NOTHING,
    }
}

/// Ids in a row differ most: hues a golden section apart, of three lightnesses.
fn color_of_id(id: u32) -> Rgb {
    if id == 0 {
        return NOTHING;
    }
    let light = [255.0, 200.0, 150.0][(id % 3) as usize];
    hue((f64::from(id) * 0.618_033_988_749_895).fract() as f32)
        .map(|c| (light * (0.25 + 0.75 * c)).round() as u8)
}

/// A saturated colour; 0 and 1 are both red.
fn hue(turn: f32) -> [f32; 3] {
    [0.0, 2.0, 4.0].map(|from| {
        let apart = (turn.rem_euclid(1.0) * 6.0 - from).rem_euclid(6.0);
        (2.0 - apart.min(6.0 - apart)).clamp(0.0, 1.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(kind: LabelKind, data: &LabelData, size: (usize, usize), scale: Scale) -> Canvas {
        label_picture(kind, data, size, scale, &mut Some(1.0))
    }

    #[test]
    fn near_is_bright_and_the_sky_is_black() {
        let depth = LabelData::F32(vec![1.0, 2.0, 4.0, f32::INFINITY]);
        let picture = drawn(LabelKind::Depth, &depth, (4, 1), Scale::Up(1));
        assert_eq!(picture.pixels, [[255; 3], [112; 3], [40; 3], NOTHING]);
    }

    #[test]
    fn flow_has_the_hue_of_its_direction() {
        let flow = LabelData::F32(vec![2.0, 0.0, 0.0, 0.0, -1.0, 0.0, f32::NAN, 0.0]);
        let picture = drawn(LabelKind::FlowForward, &flow, (4, 1), Scale::Up(1));
        // Right is red, still is white, left at half the length is half of cyan.
        assert_eq!(picture.pixels, [[255, 0, 0], [255; 3], [128, 255, 255], NOTHING]);
    }

    #[test]
    fn ids_and_normals_have_colours_of_their_own_and_nothing_is_black() {
        let ids = LabelData::U32(vec![0, 1, 2, 3, 1, 70_000]);
        let picture = drawn(LabelKind::Instance, &ids, (6, 1), Scale::Up(1));
        let &[nothing, one, two, three, again, last] = picture.pixels.as_slice() else { unreachable!() };
        assert_eq!((nothing, one), (NOTHING, again));
        let mut different = vec![one, two, three, last, NOTHING];
        different.sort_unstable();
        different.dedup();
        assert_eq!(different.len(), 5);
        let normals = LabelData::F32(vec![1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0]);
        let picture = drawn(LabelKind::Normal, &normals, (3, 1), Scale::Up(1));
        assert_eq!(picture.pixels, [[255, 128, 128], [128, 0, 128], NOTHING]);
    }

    #[test]
    fn pictures_are_scaled_by_whole_pixels_and_frames_are_toned() {
        let ids = LabelData::U32(vec![1, 2, 3, 4]);
        let large = drawn(LabelKind::Semantic, &ids, (2, 2), Scale::Up(2));
        assert_eq!((large.width, large.height), (4, 4));
        let corners = [0, 3, 12, 15].map(|at| large.pixels[at]);
        assert_eq!(corners, [1, 2, 3, 4].map(color_of_id));
        let small = drawn(LabelKind::Semantic, &ids, (2, 2), Scale::Down(2));
        assert_eq!(small.pixels, [color_of_id(1)]);
        let frame = drawn(LabelKind::Frame, &LabelData::F32(vec![0.0, 0.18]), (2, 1), Scale::Up(1));
        assert_eq!(frame.pixels, [[0; 3], [109; 3]]);
    }
}
