//! A folder of pictures, in the order of their names.

use std::cmp::Ordering;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use evis_core::format::FormatError;
use evis_core::limits::{Budget, open_regular};
use image::{DynamicImage, ImageDecoder, ImageReader, Limits};

use crate::error::VideoError;
use crate::picture::{Picture, Values};
use crate::times::Times;

/// Endings that are read.
const ENDINGS: [&str; 6] = ["png", "exr", "tif", "tiff", "jpg", "jpeg"];

/// The name under which a folder has the times of its pictures.
pub(crate) const TIMES_NAME: &str = "timestamps.txt";

/// The pictures of a folder.
#[derive(Debug)]
pub(crate) struct Folder {
    /// In order.
    pub files: Vec<PathBuf>,
    read: usize,
}

impl Folder {
    /// Lists the pictures of `path`; those that `times` names, in its order, where it names any.
    pub fn open(path: &Path, times: Option<&Times>) -> Result<Self, VideoError> {
        let mut files = Vec::new();
        for entry in std::fs::read_dir(path).map_err(|error| FormatError::io(path, "read", error))? {
            let file = entry.map_err(|error| FormatError::io(path, "read", error))?.path();
            let hidden = file.file_name().is_none_or(|name| name.to_string_lossy().starts_with('.'));
            if !hidden && ending(&file).is_some_and(|ending| ENDINGS.contains(&ending.as_str())) {
                files.push(file);
            }
        }
        files.sort_by(|a, b| natural(&a.to_string_lossy(), &b.to_string_lossy()));
        if let Some(Times { names, .. }) = times
            && !names.is_empty()
        {
            // Lists often name `images/0001.png` from the folder above.
            let mut named = Vec::with_capacity(names.len());
            for name in names {
                let last = Path::new(name).file_name();
                let Some(file) = files.iter().find(|file| file.file_name() == last) else {
                    let what = format!("there is no picture '{name}', which the times name");
                    return Err(FormatError::invalid(path, what, "name pictures of this folder").into());
                };
                named.push(file.clone());
            }
            files = named;
        }
        if files.is_empty() {
            let what = format!("it holds no picture ({})", ENDINGS.join(", "));
            return Err(
                FormatError::invalid(path, what, "name a folder of frames, a film or a .npy file").into()
            );
        }
        // A mixture is more likely an accident than a film.
        let kind = files.first().and_then(|file| ending(file));
        if let Some(other) = files.iter().find(|file| !alike(ending(file).as_deref(), kind.as_deref())) {
            let what = format!(
                "it holds pictures of several kinds: {} and {}",
                files.first().map_or_else(String::new, |file| name(file)),
                name(other)
            );
            return Err(FormatError::invalid(path, what, "keep the frames in a folder of their own").into());
        }
        Ok(Self { files, read: 0 })
    }

    /// The next picture.
    pub fn next(&mut self) -> Result<Option<Picture>, VideoError> {
        let Some(file) = self.files.get(self.read) else { return Ok(None) };
        let picture = decode(file, self.read)?;
        self.read += 1;
        Ok(Some(picture))
    }
}

fn alike(a: Option<&str>, b: Option<&str>) -> bool {
    let group = |ending| match ending {
        Some("tif" | "tiff") => "tiff",
        Some("jpg" | "jpeg") => "jpeg",
        Some("png") => "png",
        _ => "exr",
    };
    group(a) == group(b)
}

fn ending(path: &Path) -> Option<String> {
    path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase())
}

fn name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Names in the order of the numbers in them: 2 before 10.
fn natural(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (a.as_bytes(), b.as_bytes());
    loop {
        match (left, right) {
            ([], []) => return a.cmp(b),
            ([], _) => return Ordering::Less,
            (_, []) => return Ordering::Greater,
            ([p, ..], [q, ..]) if p.is_ascii_digit() && q.is_ascii_digit() => {
                let number = |text: &[u8]| text.iter().take_while(|c| c.is_ascii_digit()).count();
                let (m, n) = (number(left), number(right));
                let (one, other) = (&left[..m], &right[..n]);
                let digits =
                    |text: &'_ [u8]| text.iter().skip_while(|c| **c == b'0').copied().collect::<Vec<_>>();
                let (one, other) = (digits(one), digits(other));
                let order = one.len().cmp(&other.len()).then_with(|| one.cmp(&other));
                if order != Ordering::Equal {
                    return order;
                }
                (left, right) = (&left[m..], &right[n..]);
            }
            ([p, l @ ..], [q, r @ ..]) => {
                if p != q {
                    return p.cmp(q);
                }
                (left, right) = (l, r);
            }
        }
    }
}

fn decode(path: &Path, index: usize) -> Result<Picture, VideoError> {
    let corrupt = |what: &dyn std::fmt::Display| {
        let what = format!("frame {index}: {what}");
        FormatError::corrupt(path, what, "store it again as PNG, TIFF or OpenEXR (R, G and B channels)")
    };
    let mut reader = open_regular(path)
        .and_then(|file| ImageReader::new(BufReader::new(file)).with_guessed_format())
        .map_err(|error| FormatError::io(path, "read", error))?;
    let mut limits = Limits::default();
    limits.max_image_width = Some(65_536);
    limits.max_image_height = Some(65_536);
    // Beside what is decoded there is what its pixels become.
    let budget = Budget::default();
    limits.max_alloc = Some(budget.left() / 2);
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(|error| corrupt(&error))?;
    budget.take(decoder.total_bytes().saturating_mul(2), "its picture").map_err(|error| corrupt(&error))?;
    let image = DynamicImage::from_decoder(decoder).map_err(|error| corrupt(&error))?;
    let (width, height) = (image.width(), image.height());
    let (channels, values) = match image {
        DynamicImage::ImageLuma8(image) => (1, Values::U8(image.into_raw())),
        DynamicImage::ImageLumaA8(_) => (1, Values::U8(image.into_luma8().into_raw())),
        DynamicImage::ImageRgb8(image) => (3, Values::U8(image.into_raw())),
        DynamicImage::ImageRgba8(_) => (3, Values::U8(image.into_rgb8().into_raw())),
        DynamicImage::ImageLuma16(image) => (1, Values::U16(image.into_raw())),
        DynamicImage::ImageLumaA16(_) => (1, Values::U16(image.into_luma16().into_raw())),
        DynamicImage::ImageRgb16(image) => (3, Values::U16(image.into_raw())),
        DynamicImage::ImageRgba16(_) => (3, Values::U16(image.into_rgb16().into_raw())),
        DynamicImage::ImageRgb32F(image) => (3, Values::F32(image.into_raw())),
        DynamicImage::ImageRgba32F(_) => (3, Values::F32(image.into_rgb32f().into_raw())),
        other => return Err(corrupt(&format!("pixels of kind {:?} are not read", other.color())).into()),
    };
    Ok(Picture { width, height, channels, values })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_count() {
        let mut names = ["b1", "a10.png", "a2.png", "a02.png", "a1.png", "a"];
        names.sort_by(|a, b| natural(a, b));
        assert_eq!(names, ["a", "a1.png", "a02.png", "a2.png", "a10.png", "b1"]);
        let mut plain = names;
        plain.sort_unstable();
        assert_ne!(plain, names, "canary: letters alone give another order");
    }
}
