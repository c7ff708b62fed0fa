//! Pixels whose light does not change, from rays.

use evis_core::Truth;
use evis_scene::Scene;
use evis_truth::rays::Textures;
use rayon::prelude::*;

use crate::error::ChartError;
use crate::verify::eye::Eye;

/// Times at which every pixel is compared.
const TIMES: u32 = 64;
/// Rays per pixel along each side, and how far from its middle they go, in pixels: a hair beyond the pixel, for what
/// passes between two times.
const SIDE: usize = 5;
const REACH: f64 = 0.75;
/// Relative difference of the same light computed twice.
const SAME: f64 = 1e-9;

/// For every pixel of `truth`: whether truth is silent there, and the same light is seen through all of it at all times.
pub(super) fn still(scene: &Scene, truth: &Truth) -> Result<Vec<bool>, ChartError> {
    let mut quiet = vec![true; truth.pixels.len()];
    for event in &truth.events {
        if let Some(entry) = truth.pixel_index(event.x, event.y).and_then(|i| quiet.get_mut(i)) {
            *entry = false;
        }
    }
    let textures = Textures::new(scene);
    let step = 2.0 * REACH / (SIDE - 1) as f64;
    let offset = |i: usize| [i % SIDE, i / SIDE].map(|k| k as f64 * step - REACH);
    let mut first: Vec<Vec<f64>> = Vec::new();
    for k in 0..TIMES {
        let t_us = truth.duration_us as f64 * f64::from(k) / f64::from(TIMES - 1);
        let eye = Eye::new(scene, &textures, &truth.camera, t_us)?;
        let light = |pixel: &[u16; 2]| -> Vec<f64> {
            (0..SIDE * SIDE).map(|i| eye.luminance(*pixel, offset(i))).collect()
        };
        let pairs = truth.pixels.par_iter().zip(&quiet);
        let now: Vec<Vec<f64>> =
            pairs.map(|(pixel, quiet)| if *quiet { light(pixel) } else { Vec::new() }).collect();
        if k == 0 {
            first = now;
            continue;
        }
        for ((quiet, now), first) in quiet.iter_mut().zip(&now).zip(&first) {
            *quiet &= now.iter().zip(first).all(|(a, b)| (a - b).abs() <= SAME * b.abs());
        }
    }
    Ok(quiet)
}
