//! Values of options: each checked alone, so that the message names the option, the value, and what would work.

use evis_core::Transfer;
use evis_core::metric::MAX_TOLERANCE_US;
use evis_core::stats::Stimulus;
use evis_render::ImuNoise;
use evis_truth::PixelChoice;

/// Longest stream and latest start in seconds: 31 days, the most that a recording holds.
const MAX_SECONDS: f64 = 2_678_400.0;

/// Largest width or height of a view in pixels.
const MAX_SIZE: u32 = 8192;

/// Whole-number enlargement or reduction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scale {
    Up(u32),
    Down(u32),
}

fn number(text: &str) -> Option<f64> {
    text.trim().parse::<f64>().ok().filter(|v| v.is_finite())
}

/// Microseconds of seconds.
pub(crate) fn to_us(seconds: f64) -> i64 {
    (seconds * 1.0e6).round() as i64
}

/// A number that `fits`; the message completes "invalid value 'X' for '--flag <V>': ".
fn checked(text: &str, remedy: &str, fits: impl Fn(f64) -> bool) -> Result<f64, String> {
    number(text).filter(|v| fits(*v)).ok_or_else(|| format!("it must be {remedy}"))
}

pub(super) fn positive_seconds(text: &str) -> Result<f64, String> {
    checked(text, "a number of seconds above 0 (at least 0.000001, at most 2678400), such as 0.5", |v| {
        (1.0e-6..=MAX_SECONDS).contains(&v)
    })
}

pub(super) fn start_seconds(text: &str) -> Result<f64, String> {
    checked(text, "a number of seconds from 0 to 2678400, such as 0.5", |v| (0.0..=MAX_SECONDS).contains(&v))
}

pub(super) fn speed(text: &str) -> Result<f64, String> {
    checked(text, "a factor from 0.000001 to 1000000, such as 0.25", |v| (1e-6..=1e6).contains(&v))
}

pub(super) fn rate_hz(text: &str) -> Result<f64, String> {
    checked(text, "a number of Hz above 0 and at most 1000000, such as 1000", |v| v > 0.0 && v <= 1.0e6)
}

/// A value of [`ImuNoise`]: its place among the keys, and the number.
pub(super) fn imu_noise(text: &str) -> Result<(usize, f64), String> {
    let known = || ImuNoise::KEYS.join(", ");
    let (key, value) =
        text.split_once('=').ok_or_else(|| format!("it must be KEY=VALUE; keys are {}", known()))?;
    let place = ImuNoise::KEYS.iter().position(|known| *known == key.trim()).ok_or_else(|| {
        let near = evis_core::limits::nearest(key.trim(), ImuNoise::KEYS.into_iter());
        let hint = near.map_or_else(String::new, |near| format!(" (did you mean {near}?)"));
        format!("there is no '{key}'{hint}; keys are {}", known())
    })?;
    checked(value, "a number, 0 or more", |v| v >= 0.0).map(|value| (place, value))
}

pub(super) fn threshold(text: &str) -> Result<f32, String> {
    checked(text, "a number of log units, at least 0.001 and at most 100, such as 0.2", |v| {
        // Compared as f32: that is what the sensor sees.
        (1.0e-3_f32..=100.0).contains(&(v as f32))
    })
    .map(|v| v as f32)
}

pub(super) fn positive(text: &str) -> Result<f32, String> {
    checked(text, "a finite number above 0, such as 0.001", |v| (v as f32).is_finite() && v as f32 > 0.0)
        .map(|v| v as f32)
}

pub(super) fn window_ms(text: &str) -> Result<f64, String> {
    checked(text, "a number of milliseconds from 0.001 to 1000000, such as 20", |v| {
        (1.0e-3..=1.0e6).contains(&v)
    })
}

pub(super) fn fps(text: &str) -> Result<f64, String> {
    checked(text, "a number of frames per second from 0.1 to 1000, such as 30", |v| {
        (0.1..=1000.0).contains(&v)
    })
}

pub(super) fn slow(text: &str) -> Result<f64, String> {
    checked(text, "a factor from 0.001 to 100000, such as 4", |v| (1.0e-3..=1.0e5).contains(&v))
}

pub(super) fn budget_ms(text: &str) -> Result<f64, String> {
    checked(text, "a number of milliseconds above 0, such as 1000", |v| v > 0.0)
}

pub(super) fn render_ms(text: &str) -> Result<f64, String> {
    checked(text, "a number of milliseconds from 0 to 1000000, such as 10", |v| (0.0..=1.0e6).contains(&v))
}

pub(super) fn f1_share(text: &str) -> Result<f64, String> {
    checked(text, "above 0 and at most 1, such as 0.98", |v| v > 0.0 && v <= 1.0)
}

pub(super) fn repetitions(text: &str) -> Result<usize, String> {
    text.trim()
        .parse::<usize>()
        .ok()
        .filter(|n| (1..=1000).contains(n))
        .ok_or_else(|| "it must be a whole number from 1 to 1000, such as 3".into())
}

pub(super) fn truth_pixels(text: &str) -> Result<PixelChoice, String> {
    let count = || text.trim().parse::<usize>().ok().filter(|n| *n >= 1).map(PixelChoice::Count);
    if text.trim() == "all" { Some(PixelChoice::All) } else { count() }
        .ok_or_else(|| "it must be a whole number above 0, such as 1000, or the word all".into())
}

pub(super) fn crop(text: &str) -> Result<PixelChoice, String> {
    let numbers: Option<Vec<u32>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x, y, width, height]) if width > 0 && height > 0 => {
            Ok(PixelChoice::Crop { x, y, width, height })
        }
        _ => Err(
            "it must be four whole numbers, first column, first row, columns and rows, such as 40,30,80,60"
                .into(),
        ),
    }
}

pub(super) fn sample_count(text: &str) -> Result<u32, String> {
    text.trim()
        .parse::<u32>()
        .ok()
        .filter(|n| (1..=256).contains(n))
        .ok_or_else(|| "it must be a whole number from 1 to 256, such as 4".into())
}

fn whole(text: &str, low: u32, high: u32, example: u32) -> Result<u32, String> {
    text.trim()
        .parse::<u32>()
        .ok()
        .filter(|n| (low..=high).contains(n))
        .ok_or_else(|| format!("it must be a whole number from {low} to {high}, such as {example}"))
}

pub(super) fn texture_taps(text: &str) -> Result<u32, String> {
    whole(text, 1, 16, 4)
}

pub(super) fn shadow_map(text: &str) -> Result<u32, String> {
    whole(text, 64, 16_384, 2048)
}

pub(super) fn step_count(text: &str) -> Result<u32, String> {
    whole(text, 1, 1000, 8)
}

pub(super) fn margin_pixels(text: &str) -> Result<u32, String> {
    whole(text, 0, 512, 32)
}

/// Up to `i64::MAX`: the settings are stored as TOML, whose integers are signed.
pub(super) fn seed(text: &str) -> Result<u64, String> {
    text.trim()
        .parse::<u64>()
        .ok()
        .filter(|n| i64::try_from(*n).is_ok())
        .ok_or_else(|| "it must be a whole number from 0 to 9223372036854775807".into())
}

pub(super) fn tolerance_us(text: &str) -> Result<i64, String> {
    text.trim()
        .parse::<i64>()
        .ok()
        .filter(|us| (1..=MAX_TOLERANCE_US).contains(us))
        .ok_or_else(|| format!("it must be a whole number from 1 to {MAX_TOLERANCE_US}, such as 1000"))
}

pub(super) fn stimulus(text: &str) -> Result<Stimulus, String> {
    let numbers = text.split_once(',').and_then(|(hz, contrast)| Some((number(hz)?, number(contrast)?)));
    let (hz, contrast) = numbers.ok_or("it must be HZ,CONTRAST, such as 10,0.5")?;
    Stimulus::new(hz, contrast).map_err(|error| error.to_string())
}

pub(super) fn transfer(text: &str) -> Result<Transfer, String> {
    evis_video::transfer(text.trim()).map_err(|error| format!("it must be {}", error.remedy))
}

pub(super) fn size(text: &str) -> Result<(u32, u32), String> {
    let side = |s: &str| s.trim().parse::<u32>().ok().filter(|n| (1..=MAX_SIZE).contains(n));
    text.split_once(['x', 'X', '×'])
        .and_then(|(width, height)| Some((side(width)?, side(height)?)))
        .ok_or_else(|| {
            format!("it must be WIDTHxHEIGHT in pixels, each from 1 to {MAX_SIZE}, such as 640x480")
        })
}

pub(super) fn scale(text: &str) -> Result<Scale, String> {
    let factor = |s: &str| s.trim().parse::<u32>().ok().filter(|n| (1..=16).contains(n));
    match text.split_once('/') {
        Some((one, n)) if one.trim() == "1" => factor(n).map(Scale::Down),
        Some(_) => None,
        None if text.trim() == "0.5" => Some(Scale::Down(2)),
        None if text.trim() == "0.25" => Some(Scale::Down(4)),
        None => factor(text).map(Scale::Up),
    }
    .ok_or_else(|| "it must be a whole number from 1 to 16, or 1/2 to 1/16".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_checked_at_the_door() {
        assert_eq!(size("640x480"), Ok((640, 480)));
        for bad in ["640", "0x480", "640x0", "640x-1", "9000x9", "axb", "640x480x3", ""] {
            assert!(size(bad).is_err(), "{bad}");
        }
        assert_eq!(positive_seconds("0.25"), Ok(0.25));
        for bad in ["0", "-1", "nan", "inf", "1e99", "1s", "1e-9"] {
            assert!(positive_seconds(bad).is_err(), "{bad}");
        }
        assert_eq!(threshold("0.001"), Ok(0.001));
        for bad in ["0", "-0.2", "nan", "1e-9"] {
            assert!(threshold(bad).is_err(), "{bad}");
        }
        assert!(seed("18446744073709551615").is_err() && seed("-1").is_err() && seed("7") == Ok(7));
        assert_eq!(
            (scale("2"), scale("1/4"), scale("0.5")),
            (Ok(Scale::Up(2)), Ok(Scale::Down(4)), Ok(Scale::Down(2)))
        );
        assert!(scale("0").is_err() && scale("2/3").is_err() && scale("1/0").is_err());
    }
}
