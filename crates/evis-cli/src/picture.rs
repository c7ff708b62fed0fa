//! Pictures: canvas, colours, tone curve, and a small font for time stamps.

use evis_core::Event;
use evis_core::luminance::luminance;

use crate::args::{Background, Scale};

/// An RGB colour as stored in picture files.
pub(crate) type Rgb = [u8; 3];

/// Colours of the event picture. ON and OFF differ in hue along blue-yellow, which every common colour
/// vision tells apart, and in lightness from each other and from the background, so that a grey print
/// shows them too (Okabe and Ito, "Color Universal Design", 2008; blue darkened for the light background).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Palette {
    pub(crate) background: Rgb,
    pub(crate) on: Rgb,
    pub(crate) off: Rgb,
    pub(crate) text: Rgb,
}

impl Palette {
    pub(crate) const fn new(background: Background) -> Self {
        match background {
            Background::Light => {
                Self { background: [255, 255, 255], on: [230, 159, 0], off: [0, 66, 120], text: [70, 70, 70] }
            }
            Background::Dark => Self {
                background: [18, 18, 18],
                on: [240, 228, 66],
                off: [60, 130, 200],
                text: [200, 200, 200],
            },
        }
    }
}

/// A picture, row-major from the top.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Canvas {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) pixels: Vec<Rgb>,
}

impl Canvas {
    pub(crate) fn new(width: usize, height: usize, fill: Rgb) -> Self {
        Self { width, height, pixels: vec![fill; width.saturating_mul(height)] }
    }

    /// Colours one pixel; outside the canvas nothing happens.
    pub(crate) fn set(&mut self, x: usize, y: usize, color: Rgb) {
        if x < self.width
            && let Some(pixel) = self.pixels.get_mut(y * self.width + x)
        {
            *pixel = color;
        }
    }

    /// Copies `other` with its top-left corner at (`x`, `y`).
    pub(crate) fn paste(&mut self, other: &Self, x: usize, y: usize) {
        for (row, line) in other.pixels.chunks_exact(other.width.max(1)).enumerate() {
            for (column, color) in line.iter().enumerate() {
                self.set(x + column, y + row, *color);
            }
        }
    }

    /// Writes `text` in a 3x5 font at twice its size, top-left corner at (`x`, `y`).
    pub(crate) fn write(&mut self, text: &str, x: usize, y: usize, color: Rgb) {
        for (k, c) in text.chars().enumerate() {
            for (row, bits) in glyph(c).into_iter().enumerate() {
                for column in (0..3).filter(|column| bits & (4 >> column) != 0) {
                    for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                        self.set(x + k * GLYPH_STEP + column * 2 + dx, y + row * 2 + dy, color);
                    }
                }
            }
        }
    }

    /// All bytes, R G B.
    pub(crate) fn bytes(&self) -> Vec<u8> {
        self.pixels.as_flattened().to_vec()
    }
}

/// Pixels from one glyph to the next.
pub(crate) const GLYPH_STEP: usize = 8;
/// Height of a line of text with its margins.
pub(crate) const TEXT_LINE: usize = 16;

/// Rows of three bits, the left one highest.
const fn glyph(c: char) -> [u8; 5] {
    match c {
        '0' => [7, 5, 5, 5, 7],
        '1' => [2, 6, 2, 2, 7],
        '2' => [7, 1, 7, 4, 7],
        '3' => [7, 1, 7, 1, 7],
        '4' => [5, 5, 7, 1, 1],
        '5' => [7, 4, 7, 1, 7],
        '6' => [7, 4, 7, 5, 7],
        '7' => [7, 1, 1, 2, 2],
        '8' => [7, 5, 7, 5, 7],
        '9' => [7, 5, 7, 1, 7],
        '.' => [0, 0, 0, 0, 2],
        's' => [3, 4, 2, 1, 6],
        'O' => [7, 5, 5, 5, 7],
        'N' => [5, 7, 7, 7, 5],
        'F' => [7, 4, 6, 4, 4],
        _ => [0; 5],
    }
}

impl Scale {
    /// Length of `n` sensor pixels in picture pixels.
    pub(crate) fn length(self, n: usize) -> usize {
        match self {
            Self::Up(k) => n.saturating_mul(k as usize),
            Self::Down(k) => n.div_ceil(k.max(1) as usize),
        }
    }
}

/// The event picture: each pixel shows the polarity of its last event.
pub(crate) fn event_picture(
    events: &[Event],
    width: usize,
    height: usize,
    scale: Scale,
    palette: &Palette,
) -> Canvas {
    let mut canvas = Canvas::new(scale.length(width), scale.length(height), palette.background);
    for event in events {
        let color = if event.p == 1 { palette.on } else { palette.off };
        let (x, y) = (usize::from(event.x), usize::from(event.y));
        if x >= width || y >= height {
            continue;
        }
        match scale {
            Scale::Up(k) => {
                let k = k as usize;
                for (dx, dy) in (0..k * k).map(|i| (i % k, i / k)) {
                    canvas.set(x * k + dx, y * k + dy, color);
                }
            }
            Scale::Down(k) => canvas.set(x / k.max(1) as usize, y / k.max(1) as usize, color),
        }
    }
    canvas
}

/// Luminance that is shown as pure white, in units of the reference.
const WHITE: f32 = 4.0;

/// The tone curve for one channel `value` in units of the reference luminance: extended Reinhard,
/// `c (1 + c / 16) / (1 + c)` with white at 4 (Reinhard et al. 2002, equation 4, per channel), then the sRGB
/// transfer (IEC 61966-2-1). A scene's log-mean, 0.18, comes out at 8-bit 109.
pub(crate) fn tone(value: f32) -> u8 {
    let c = if value.is_nan() { 0.0 } else { value.clamp(0.0, WHITE) };
    let linear = (c * (1.0 + c / (WHITE * WHITE)) / (1.0 + c)).clamp(0.0, 1.0);
    let encoded = if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    (encoded * 255.0).round() as u8
}

/// The HDR frame `rgb` (three values per pixel) divided by `reference` and tone-mapped.
pub(crate) fn hdr_picture(rgb: &[f32], width: usize, height: usize, scale: Scale, reference: f32) -> Canvas {
    let mut canvas = Canvas::new(scale.length(width), scale.length(height), [0; 3]);
    let pixel = |x: usize, y: usize| -> [f32; 3] {
        let at = (y * width + x) * 3;
        rgb.get(at..at + 3).and_then(|p| p.try_into().ok()).unwrap_or_default()
    };
    for y in 0..canvas.height {
        for x in 0..canvas.width {
            let color = match scale {
                Scale::Up(k) => pixel(x / k.max(1) as usize, y / k.max(1) as usize),
                Scale::Down(k) => {
                    // Light adds up in linear space: averaged before the tone curve.
                    let k = k.max(1) as usize;
                    let (x1, y1) = ((x * k + k).min(width), (y * k + k).min(height));
                    let mut sum = [0.0_f32; 3];
                    for (sx, sy) in (y * k..y1).flat_map(|sy| (x * k..x1).map(move |sx| (sx, sy))) {
                        for (sum, c) in sum.iter_mut().zip(pixel(sx, sy)) {
                            *sum += c;
                        }
                    }
                    let count = ((x1 - x * k) * (y1 - y * k)).max(1) as f32;
                    sum.map(|c| c / count)
                }
            };
            canvas.set(x, y, color.map(|c| tone(c / reference)));
        }
    }
    canvas
}

/// The luminance that brings the log-mean of `rgb` to 0.18, for recordings that do not say theirs.
pub(crate) fn reference_of(rgb: &[f32]) -> f32 {
    let mut sum = 0.0_f64;
    let mut count = 0_u64;
    for pixel in rgb.chunks_exact(3) {
        if let [r, g, b] = *pixel {
            let luminance = luminance([r, g, b].map(f64::from));
            if luminance.is_finite() {
                sum += luminance.max(1.0e-6).ln();
                count += 1;
            }
        }
    }
    if count == 0 { 1.0 } else { ((sum / count as f64).exp() / 0.18) as f32 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evis_core::Polarity;

    fn grey(colour: Rgb) -> f64 {
        luminance(colour.map(f64::from))
    }

    #[test]
    fn polarities_differ_also_when_printed_grey() {
        for background in [Background::Light, Background::Dark] {
            let p = Palette::new(background);
            for (a, b) in [(p.on, p.off), (p.on, p.background), (p.off, p.background)] {
                assert!((grey(a) - grey(b)).abs() > 60.0, "{background:?}: {a:?} {b:?}");
            }
            assert!(grey(p.on) > grey(p.off), "ON is the brighter one");
        }
    }

    #[test]
    fn the_last_event_of_a_pixel_is_shown() {
        let p = Palette::new(Background::Light);
        let events = [
            Event::new(0, 1, 0, Polarity::On),
            Event::new(1, 1, 0, Polarity::Off),
            Event::new(2, 3, 1, Polarity::On),
            Event::new(3, 9, 9, Polarity::On),
        ];
        let up = event_picture(&events, 4, 2, Scale::Up(2), &p);
        assert_eq!((up.width, up.height), (8, 4));
        assert_eq!((up.pixels[2], up.pixels[11], up.pixels[0]), (p.off, p.off, p.background));
        assert_eq!(up.pixels[3 * 8 + 7], p.on);
        let down = event_picture(&events, 4, 2, Scale::Down(2), &p);
        assert_eq!((down.width, down.height, &down.pixels[..]), (2, 1, &[p.off, p.on][..]));
    }

    #[test]
    fn the_tone_curve_is_monotonic_and_total() {
        assert_eq!(
            (tone(0.0), tone(WHITE), tone(f32::INFINITY), tone(f32::NAN), tone(-1.0)),
            (0, 255, 255, 0, 0)
        );
        let values: Vec<_> = (0..400).map(|k| tone(k as f32 * 0.01)).collect();
        assert!(values.is_sorted());
        assert_eq!(tone(0.18), 109);
    }

    #[test]
    fn reduced_frames_average_light() {
        let rgb = [0.0, 0.0, 0.0, 0.36, 0.36, 0.36];
        let canvas = hdr_picture(&rgb, 2, 1, Scale::Down(2), 1.0);
        assert_eq!(canvas.pixels, [[tone(0.18); 3]]);
        assert!((reference_of(&[0.5; 6]) - 0.5 / 0.18).abs() < 1e-4);
    }
}
