//! PNG with a palette: a chart has few colours, and a third of the bytes holds it.

use std::collections::HashMap;

use crate::error::ChartError;

/// Colours kept: those of the lines, markers and words, and the blends at their rims.
const COLOURS: usize = 80;

type Rgb = [u8; 3];

/// `pixels`, RGB by rows, as PNG.
pub(crate) fn png(width: u32, height: u32, pixels: &[u8]) -> Result<Vec<u8>, ChartError> {
    let failed = |e: png::EncodingError| ChartError::Draw(e.to_string());
    let (palette, index_of) = palette(pixels);
    let (colours, _) = pixels.as_chunks::<3>();
    let indices: Vec<u8> = colours.iter().map(|c| index_of.get(c).copied().unwrap_or(0)).collect();
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, width, height);
    encoder.set_color(png::ColorType::Indexed);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_palette(palette.concat());
    encoder.set_compression(png::Compression::High);
    // Differences of palette indices mean nothing.
    encoder.set_filter(png::Filter::NoFilter);
    let mut writer = encoder.write_header().map_err(failed)?;
    writer.write_image_data(&indices).map_err(failed)?;
    writer.finish().map_err(failed)?;
    Ok(out)
}

/// A palette, and for every colour the index of the nearest of it. Each new entry is the colour that the palette so far
/// serves worst, by the squared distance to it and by how often it occurs: rare markers keep their hue.
fn palette(pixels: &[u8]) -> (Vec<Rgb>, HashMap<Rgb, u8>) {
    let mut counts: HashMap<Rgb, u32> = HashMap::new();
    for colour in pixels.as_chunks::<3>().0 {
        *counts.entry(*colour).or_default() += 1;
    }
    let mut all: Vec<Served> = counts
        .into_iter()
        .map(|(colour, count)| Served { colour, count, distance: u32::MAX, index: 0 })
        .collect();
    // The colour breaks ties: the same picture gives the same bytes.
    all.sort_unstable_by_key(|served| served.colour);
    let mut kept: Vec<Rgb> = Vec::new();
    while kept.len() < COLOURS {
        let worst = all.iter().max_by_key(|s| u64::from(s.distance) * u64::from(s.count));
        let Some(next) = worst.filter(|s| s.distance > 0).map(|s| s.colour) else { break };
        for served in &mut all {
            let distance = distance(served.colour, next);
            if distance < served.distance {
                (served.distance, served.index) = (distance, kept.len() as u8);
            }
        }
        kept.push(next);
    }
    (kept, all.into_iter().map(|s| (s.colour, s.index)).collect())
}

/// A colour, and what the palette offers it.
struct Served {
    colour: Rgb,
    count: u32,
    distance: u32,
    index: u8,
}

fn distance(a: Rgb, b: Rgb) -> u32 {
    a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(b)).pow(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_colours_survive_exactly_and_many_nearly() {
        let few = [[255, 255, 255], [255, 255, 255], [0, 114, 178], [34, 34, 34]].concat();
        let back = image::load_from_memory(&png(2, 2, &few).unwrap()).unwrap().to_rgb8();
        assert_eq!(back.as_raw(), &few);
        // A thousand greys and blues, most of them once.
        let many: Vec<u8> = (0..3000).map(|k: u32| (k * k % 251) as u8 / 16 * 16 + (k % 3) as u8).collect();
        let back = image::load_from_memory(&png(40, 25, &many).unwrap()).unwrap().to_rgb8();
        let far = back.as_raw().iter().zip(&many).filter(|(a, b)| a.abs_diff(**b) > 128).count();
        assert!(far < 30, "{far}");
        assert_ne!(back.as_raw(), &many, "canary: more colours than the palette holds");
    }
}
