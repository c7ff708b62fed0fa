//! Radiance and OpenEXR files in; linear RGB out.

use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use evis_limits::Budget;
use image::codecs::hdr::HdrDecoder;
use image::codecs::openexr::OpenExrDecoder;
use image::{DynamicImage, ImageDecoder};

use super::equirect::check_size;
use crate::error::SceneError;

/// Width, height and texels, row-major from the top.
type Picture = (usize, usize, Vec<[f32; 3]>);

/// Reads a `.hdr` or `.exr` file.
pub(super) fn read(path: &Path, warnings: &mut Vec<String>) -> Result<Picture, SceneError> {
    let budget = Budget::default();
    let bytes = evis_limits::read_file(path, &budget)
        .map_err(|source| SceneError::Io { path: path.to_path_buf(), source })?;
    decode_guarded(path, &bytes, &budget, warnings).map_err(|reason| SceneError::invalid(path, reason))
}

/// The decoders are outside code and this build checks for overflow: what they take for impossible must not take
/// a program down that only opened a file.
fn decode_guarded(
    path: &Path,
    bytes: &[u8],
    budget: &Budget,
    warnings: &mut Vec<String>,
) -> Result<Picture, String> {
    catch_unwind(AssertUnwindSafe(|| decode(path, bytes, budget, warnings)))
        .unwrap_or_else(|_| Err("is damaged: its decoder gave up; export it again".into()))
}

fn decode(path: &Path, bytes: &[u8], budget: &Budget, warnings: &mut Vec<String>) -> Result<Picture, String> {
    let damaged = |error: image::ImageError| {
        format!("is truncated, damaged or of an unsupported kind ({error}); export it again as plain RGB")
    };
    if bytes.starts_with(b"#?") {
        // Not strict: `#?RGBE` is as common a first line as `#?RADIANCE`.
        let decoder = HdrDecoder::new_nonstrict(Cursor::new(bytes)).map_err(damaged)?;
        if let Some(exposure) = decoder.metadata().exposure.filter(|e| *e != 1.0) {
            warnings.push(format!(
                "environment '{}': its EXPOSURE of {exposure} is not applied, as in other programs; an intensity \
                 of {} gives back the original radiance",
                path.display(),
                exposure.recip()
            ));
        }
        read_rgb(decoder, budget)?.map_err(damaged)
    } else if bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
        // OpenEXR colours are premultiplied, so they are the radiance whatever alpha says.
        let decoder = OpenExrDecoder::with_alpha_preference(Cursor::new(bytes), Some(false));
        read_rgb(decoder.map_err(damaged)?, budget)?.map_err(damaged)
    } else if bytes.is_empty() {
        Err("is empty; a Radiance .hdr or an OpenEXR .exr map is needed".into())
    } else {
        Err("is neither a Radiance .hdr nor an OpenEXR .exr file; convert the map to one of them".into())
    }
}

/// Outer error: a size that is refused before memory is taken (a header can announce anything).
fn read_rgb(
    decoder: impl ImageDecoder,
    budget: &Budget,
) -> Result<Result<Picture, image::ImageError>, String> {
    let (width, height) = decoder.dimensions();
    let (width, height) = (width as usize, height as usize);
    check_size(width, height)?;
    // What is decoded, its texels, and the cubes that are made of them.
    let texels = (width as u64).saturating_mul(height as u64);
    budget.take(decoder.total_bytes(), "the map")?;
    budget.take_values::<[[f32; 3]; 2]>(texels, "the map")?;
    Ok(DynamicImage::from_decoder(decoder).map(|image| {
        let raw = image.into_rgb32f().into_raw();
        (width, height, raw.as_chunks::<3>().0.to_vec())
    }))
}

#[cfg(test)]
mod tests {
    use image::{DynamicImage, ImageFormat, Rgb32FImage};

    use super::*;

    #[test]
    fn damaged_files_never_panic() {
        let picture = DynamicImage::ImageRgb32F(Rgb32FImage::from_fn(32, 16, |x, y| {
            image::Rgb([x as f32, y as f32, 0.5])
        }));
        let mut state = 11_u64;
        let mut random = |below: usize| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 33) as usize % below
        };
        for format in [ImageFormat::Hdr, ImageFormat::OpenExr] {
            let mut bytes = Cursor::new(Vec::new());
            picture.write_to(&mut bytes, format).unwrap();
            let bytes = bytes.into_inner();
            let (mut good, mut bad) = (0, 0);
            for round in 0..3000 {
                let mut damaged = bytes.clone();
                for _ in 0..round % 4 {
                    // Half of them in the header, where a byte does most harm.
                    let at =
                        if random(2) == 0 { random(damaged.len().min(400)) } else { random(damaged.len()) };
                    damaged[at] = random(256) as u8;
                }
                match decode_guarded(Path::new("damaged"), &damaged, &Budget::default(), &mut Vec::new()) {
                    Ok((width, height, texels)) => {
                        assert_eq!(texels.len(), width * height);
                        good += 1;
                    }
                    Err(reason) => {
                        assert!(!reason.is_empty());
                        bad += 1;
                    }
                }
            }
            assert!(good > 700 && bad > 300, "{format:?}: {good} good, {bad} bad: nothing was tested");
        }
    }
}
