//! `convert --undistort`: the lens of a recording or of a calibration file, and where its pixels go without distortion.

use std::path::Path;

use evis_core::format::hdf5::Recording;
use evis_format::PixelMap;
use evis_scene::{CalibratedLens, Distortion, LensModel, Rig};

use crate::failure::bad_input;

/// The lens of camera `name` of a recording of EVIS, or of its only one.
pub(crate) fn of_recording(path: &Path, name: Option<&str>) -> anyhow::Result<CalibratedLens> {
    let recording = Recording::open(path).map_err(|_| {
        bad_input(format!(
            "{} does not say which lens it was recorded with; name Kalibr's or DSEC's calibration file with --calibration",
            path.display()
        ))
    })?;
    let cameras = &recording.header().cameras;
    let Some(camera) = cameras.iter().find(|camera| name.is_none_or(|name| camera.name == name)) else {
        return Err(bad_input(format!("{} has no camera {}", path.display(), name.unwrap_or_default())));
    };
    let Some(of) = &camera.distortion else {
        return Err(bad_input(format!(
            "the lens of camera {} has no distortion; leave --undistort out",
            camera.name
        )));
    };
    let distortion = Distortion::from_coefficients(&of.model, &of.coefficients)?;
    Ok(CalibratedLens::new([camera.fx, camera.fy], [camera.cx, camera.cy], Some(distortion))?)
}

/// The lens of camera `name` of a calibration file, or of its only one, for a sensor of `size`.
pub(crate) fn of_calibration(
    path: &Path,
    name: Option<&str>,
    size: (u32, u32),
) -> anyhow::Result<CalibratedLens> {
    let rig = Rig::load(path)?;
    let names = rig.cameras.iter().map(|camera| camera.name.as_str()).collect::<Vec<_>>().join(", ");
    let camera = match (name, rig.cameras.as_slice()) {
        (Some(name), cameras) => cameras.iter().find(|camera| camera.name == name).ok_or_else(|| {
            bad_input(format!("--calibration-camera {name} is not in {}: {names}", path.display()))
        })?,
        (None, [only]) => only,
        (None, _) => {
            return Err(bad_input(format!(
                "{} has cameras {names}; choose one with --calibration-camera",
                path.display()
            )));
        }
    };
    let [width, height] = camera.size;
    if (width, height) != size {
        return Err(bad_input(format!(
            "camera {} of {} has {width}x{height} pixels, and the events {}x{}; calibrate the sensor at its own size",
            camera.name,
            path.display(),
            size.0,
            size.1
        )));
    }
    let Some((model, coefficients)) = &camera.distortion else {
        return Err(bad_input(format!(
            "the lens of camera {} has no distortion; leave --undistort out",
            camera.name
        )));
    };
    let [fx, fy, cx, cy] = camera.intrinsics;
    Ok(CalibratedLens::new([fx, fy], [cx, cy], Some(Distortion::from_coefficients(model, coefficients)?))?)
}

/// Where the pixels of a sensor of `size` behind `lens` go in the picture of a pinhole with its focal lengths and centre.
pub(crate) fn pixel_map(lens: &CalibratedLens, size: (u32, u32)) -> anyhow::Result<PixelMap> {
    let pinhole = CalibratedLens::new(lens.focal, lens.center, None)?;
    let through = |from: &CalibratedLens, to: &CalibratedLens, place: [f64; 2]| {
        to.project(from.unproject(place.into())?).map(|place| [place.x, place.y])
    };
    Ok(PixelMap::new(size, |place| through(lens, &pinhole, place), |place| through(&pinhole, lens, place)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_straight_without_the_lens() -> anyhow::Result<()> {
        let barrel = Distortion::from_coefficients("radtan", &[-0.3, 0.05, 0.001, 0.0])?;
        let lens = CalibratedLens::new([60.0, 60.0], [32.0, 24.0], Some(barrel))?;
        let pinhole = CalibratedLens::new([60.0, 60.0], [32.0, 24.0], None)?;
        let map = pixel_map(&lens, (64, 48))?;
        assert_eq!(map.size(), (64, 48));
        // Barrel distortion draws pixels inwards: without it, those at the corners leave the picture.
        assert!(map.lost() > 0 && map.lost() < 64 * 48 / 3, "{}", map.lost());
        assert_eq!(pixel_map(&pinhole, (64, 48))?.lost(), 0, "canary: a pinhole loses nothing");
        Ok(())
    }
}
