//! Decoding of image files to linear light.

use std::io::Cursor;
use std::path::Path;

use ::image::ImageDecoder as _;
use evis_limits::Budget;
use half::f16;

use crate::error::SceneError;
use crate::model::Image;

/// What the integers of an image file stand for. Files of floats are linear in either case.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Transfer {
    /// Colour, encoded as in IEC 61966-2-1; alpha is linear.
    Srgb,
    /// Data (normals, roughness, masks) or colour that is linear already.
    Linear,
}

/// Largest width and height that is decoded.
pub const MAX_EDGE: u32 = 16_384;

/// IEC 61966-2-1: linear light of an encoded value in [0, 1].
pub fn linear_from_srgb(encoded: f64) -> f64 {
    if encoded <= 0.040_45 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

/// Every value of an integer sample with maximum `max`, decoded exactly and rounded once.
fn table(max: u32, transfer: Transfer) -> Vec<f16> {
    (0..=max)
        .map(|i| f64::from(i) / f64::from(max))
        .map(|v| f16::from_f64(if transfer == Transfer::Srgb { linear_from_srgb(v) } else { v }))
        .collect()
}

/// Decodes PNG, JPEG, GIF (first frame), Radiance or OpenEXR bytes.
///
/// # Errors
/// Says why the bytes are no usable image.
pub fn decode(name: &str, bytes: &[u8], transfer: Transfer) -> Result<Image, String> {
    decode_within(name, bytes, transfer, &Budget::default())
}

/// As [`decode`]; its memory comes out of `budget`.
///
/// # Errors
/// As [`decode`], and an image that is larger than what is left.
pub fn decode_within(name: &str, bytes: &[u8], transfer: Transfer, budget: &Budget) -> Result<Image, String> {
    let mut reader = ::image::ImageReader::new(Cursor::new(bytes))
        .with_guessed_format()
        .map_err(|e| format!("image '{name}': {e}"))?;
    if reader.format().is_none() {
        return Err(format!(
            "image '{name}' is of no known kind; PNG, JPEG, GIF, TIFF, Radiance and OpenEXR work"
        ));
    }
    let mut limits = ::image::Limits::default();
    limits.max_image_width = Some(MAX_EDGE);
    limits.max_image_height = Some(MAX_EDGE);
    limits.max_alloc = Some(budget.left().min(2 << 30));
    reader.limits(limits);
    let unusable = |e| format!("image '{name}' cannot be decoded: {e}");
    let decoder = reader.into_decoder().map_err(unusable)?;
    let (width, height) = decoder.dimensions();
    if width == 0 || height == 0 {
        return Err(format!("image '{name}' has no pixels"));
    }
    // What is decoded, the same with four channels, and the texels that stay.
    let what = format!("image '{name}' of {width}x{height}");
    let texels = u64::from(width) * u64::from(height);
    let colour = decoder.color_type();
    let four = texels * 4 * u64::from(colour.bytes_per_pixel() / colour.channel_count().max(1));
    let passing = decoder.total_bytes().saturating_add(four);
    budget.take_values::<[f16; 4]>(texels, &what)?;
    budget.take(passing, &what)?;
    let decoded = ::image::DynamicImage::from_decoder(decoder).map_err(unusable)?;
    budget.give_back(passing);
    use ::image::DynamicImage as D;
    let texels = match decoded {
        D::ImageRgb32F(_) | D::ImageRgba32F(_) => decoded
            .into_rgba32f()
            .pixels()
            .map(|p| p.0.map(|v| f16::from_f32(v.clamp(0.0, 65_504.0))))
            .collect(),
        D::ImageLuma16(_) | D::ImageLumaA16(_) | D::ImageRgb16(_) | D::ImageRgba16(_) => {
            let (colour, data) = (table(65_535, transfer), table(65_535, Transfer::Linear));
            let texel = |p: [u16; 4]| {
                [colour[p[0] as usize], colour[p[1] as usize], colour[p[2] as usize], data[p[3] as usize]]
            };
            decoded.into_rgba16().pixels().map(|p| texel(p.0)).collect()
        }
        other => {
            let (colour, data) = (table(255, transfer), table(255, Transfer::Linear));
            let texel = |p: [u8; 4]| {
                [colour[p[0] as usize], colour[p[1] as usize], colour[p[2] as usize], data[p[3] as usize]]
            };
            other.into_rgba8().pixels().map(|p| texel(p.0)).collect()
        }
    };
    Ok(Image { name: name.to_owned(), width, height, texels })
}

/// Reads and decodes an image file.
///
/// # Errors
/// A file that cannot be read, or is no usable image.
pub fn load(path: &Path, transfer: Transfer) -> Result<Image, SceneError> {
    let budget = Budget::default();
    let bytes = evis_limits::read_file(path, &budget)
        .map_err(|source| SceneError::Io { path: path.to_owned(), source })?;
    let name = path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    decode_within(&name, &bytes, transfer, &budget).map_err(|reason| SceneError::invalid(path, reason))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn png(image: ::image::DynamicImage) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, ::image::ImageFormat::Png).expect("an image in memory can be written");
        bytes.into_inner()
    }

    #[test]
    fn srgb_follows_the_standard() {
        // IEC 61966-2-1: both branches, and the ends.
        for (encoded, linear) in [
            (0.0, 0.0),
            (1.0, 1.0),
            (0.04, 0.04 / 12.92),
            (0.5, 0.214_041_140_482_232_55),
            (0.735_356_983_052_449_8, 0.5),
        ] {
            assert!((linear_from_srgb(encoded) - linear).abs() < 1e-9, "{encoded}");
        }
        assert!((linear_from_srgb(0.5) - 0.5_f64.powf(2.2)).abs() > 1e-3, "a plain power is not sRGB");
    }

    #[test]
    fn eight_and_sixteen_bit_images_decode_alike_and_alpha_stays_linear() {
        let eight = ::image::RgbaImage::from_pixel(2, 1, ::image::Rgba([188, 255, 0, 128]));
        let sixteen =
            ::image::ImageBuffer::from_pixel(2, 1, ::image::Rgba([188 * 257_u16, 65_535, 0, 128 * 257]));
        for image in [::image::DynamicImage::ImageRgba8(eight), ::image::DynamicImage::ImageRgba16(sixteen)] {
            let bytes = png(image);
            let srgb = decode("a", &bytes, Transfer::Srgb).expect("valid").texels[1];
            let expected = [linear_from_srgb(188.0 / 255.0), 1.0, 0.0, 128.0 / 255.0].map(f16::from_f64);
            assert_eq!(srgb, expected);
            let data = decode("a", &bytes, Transfer::Linear).expect("valid").texels[1];
            assert_eq!(data[0], f16::from_f64(188.0 / 255.0));
            assert_ne!(data, srgb);
        }
    }

    #[test]
    fn broken_images_are_refused() {
        let good = png(::image::DynamicImage::ImageRgba8(::image::RgbaImage::new(4, 4)));
        assert!(decode("a", &good, Transfer::Srgb).is_ok());
        for bytes in [&[][..], b"hello", &good[..good.len() / 2]] {
            let reason = decode("brick.png", bytes, Transfer::Srgb).expect_err("broken");
            assert!(reason.contains("brick.png"), "{reason}");
        }
    }
}
