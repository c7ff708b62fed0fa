//! Rectification: two cameras are turned so that every point lies in the same row of both pictures, and seen through one
//! pinhole.
//!
//! The method is OpenCV's `stereoRectify` (Bouguet's), with `CALIB_ZERO_DISPARITY`:
//!
//! 1. Each camera takes half of the rotation between the two.
//! 2. The smallest rotation that lays the baseline along +x is added to both.
//! 3. The lens has one focal length and one principal point: the smaller `fy` of the two, less what barrel distortion draws in
//!    at the corners, and the place that centres the corners of the pictures, as a mean over both.
//! 4. The focal length is scaled between the one at which all of the rectified pictures is seen (`alpha` 0) and the one at which
//!    they hold all that is seen (`alpha` 1).
//!
//! Rotations equal OpenCV's. The lens differs from its by less than a hundredth, since borders are the edges of pixels here.
//! Corners 80 degrees and more from the new axis fit no pinhole: where there are any, steps 3 and 4 take the largest part
//! around the centre, in steps of a tenth, that has none.

use glam::{DMat3, DMat4, DQuat, DVec2, DVec3};

use crate::distortion::Distortion;
use crate::error::SceneError;
use crate::lens::{CalibratedLens, LensModel, PinholeLens};

/// Largest entry by which the rotation between the cameras of a rectified pair differs from none: a tenth of a pixel at f = 1000.
const PARALLEL: f64 = 1.0e-4;
/// How far a rectified pair's right camera may be off the left one's x axis, relative to the baseline.
const ASIDE: f64 = 1.0e-3;
/// Angle from the new axis, in degrees, that corners of pictures stay below.
const WIDEST: f64 = 80.0;
/// Places along each edge of a picture at which its rectified border is looked up.
const ALONG: usize = 9;
/// The least that barrel distortion leaves of the focal length.
const LEAST_FOCAL: f64 = 0.2;

/// A camera whose picture is rectified.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RectifiedCamera {
    /// Its own lens.
    pub lens: CalibratedLens,
    /// Width and height of its picture and of the rectified one, in pixels.
    pub size: [u32; 2],
    /// The rotation to the rectified axes from its own ones: x right, y up, looking along -z.
    pub rectified_from_camera: DMat3,
    /// The lens of the rectified picture.
    pub pinhole: PinholeLens,
}

/// Two cameras whose pictures are rectified, left and right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rectification {
    /// Left and right; they have one lens.
    pub cameras: [RectifiedCamera; 2],
    /// Metres from the left camera to the right one, above 0.
    pub baseline: f64,
}

impl RectifiedCamera {
    /// A camera by itself: its picture without distortion, its own one where there is none. `alpha`: see the module.
    ///
    /// # Errors
    /// An `alpha` outside of 0 to 1, a picture that cannot be rectified.
    pub fn alone(lens: CalibratedLens, size: [u32; 2], alpha: f64) -> Result<Self, SceneError> {
        check_alpha(alpha)?;
        let camera = Self { lens, size, rectified_from_camera: DMat3::IDENTITY, pinhole: lens.pinhole() };
        if lens.distortion.is_none() {
            return Ok(camera);
        }
        Ok(Self { pinhole: common_lens(&[camera], alpha)?, ..camera })
    }

    /// Where `pixel`, a place in its own picture, lies in the rectified one, which may be outside of it; `None` where the lens
    /// sees nothing, or nothing before the rectified plane. Pixel centres are at +0.5.
    pub fn rectified(&self, pixel: DVec2) -> Option<DVec2> {
        if self.is_own() {
            return Some(pixel);
        }
        self.pinhole.project(self.rectified_from_camera * self.lens.unproject(pixel)?)
    }

    /// Where `pixel`, a place in the rectified picture, lies in its own one, which may be outside of it; `None` where the lens
    /// shows nothing.
    pub fn source(&self, pixel: DVec2) -> Option<DVec2> {
        if self.is_own() {
            return Some(pixel);
        }
        self.lens.project(self.rectified_from_camera.transpose() * self.pinhole.ray(pixel))
    }

    /// The distance along the rectified axis of what `pixel` of its own picture shows at planar depth 1; `None` where the lens
    /// sees nothing, or nothing before it.
    pub fn depth_factor(&self, pixel: DVec2) -> Option<f64> {
        let seen = self.lens.unproject(pixel)?;
        let along = -(self.rectified_from_camera * seen).z;
        (seen.z < 0.0 && along > 0.0).then(|| along / -seen.z)
    }

    /// Whether the rectified picture is its own one.
    pub fn is_own(&self) -> bool {
        self.lens.distortion.is_none()
            && self.rectified_from_camera == DMat3::IDENTITY
            && self.pinhole == self.lens.pinhole()
    }
}

impl Rectification {
    /// Of two cameras with lens and size, left and right, and the pose of the right one in the left one's axes. A pair that is
    /// rectified already stays as it is. `alpha`: see the module.
    ///
    /// # Errors
    /// An `alpha` outside of 0 to 1, pictures of different sizes, cameras at one place, a right camera that is not to the right
    /// of the left one, cameras that look away from each other.
    pub fn new(
        left: (CalibratedLens, [u32; 2]),
        right: (CalibratedLens, [u32; 2]),
        left_from_right: &DMat4,
        alpha: f64,
    ) -> Result<Self, SceneError> {
        check_alpha(alpha)?;
        let rule = |text: String| Err(SceneError::Rule(text));
        let ([width, height], [w, h]) = (left.1, right.1);
        if left.1 != right.1 {
            return rule(format!(
                "the cameras have {width}x{height} and {w}x{h} pixels; a rectified pair has one size"
            ));
        }
        let apart = left_from_right.w_axis.truncate();
        let baseline = apart.length();
        if !(baseline.is_finite() && baseline > 0.0) {
            return rule(format!(
                "the cameras are {baseline} m apart; a pair that is rectified is at two places"
            ));
        }
        if is_rectified(&left.0, &right.0, left_from_right) {
            let of = |(lens, size): (CalibratedLens, [u32; 2])| RectifiedCamera {
                lens,
                size,
                rectified_from_camera: DMat3::IDENTITY,
                pinhole: left.0.pinhole(),
            };
            return Ok(Self { cameras: [of(left), of(right)], baseline: apart.x });
        }
        let right_from_left = DQuat::from_mat4(left_from_right).normalize().inverse();
        let turned =
            if right_from_left.w < 0.0 { -right_from_left } else { right_from_left }.to_scaled_axis();
        // Half of the way from the left axes to the right ones: `half` takes the left camera's points there.
        let half = DQuat::from_scaled_axis(0.5 * turned);
        let along = half * (apart / baseline);
        if along.x < along.y.abs() || along.x <= 0.0 {
            let [x, y, z] = apart.to_array();
            return rule(format!(
                "the right camera is at ({x:.4}, {y:.4}, {z:.4}) m in the left one's axes (x right, y up); rectified rows take \
                 cameras side by side, so exchange them, or turn both"
            ));
        }
        let level = DQuat::from_rotation_arc(along, DVec3::X);
        let of = |(lens, size): (CalibratedLens, [u32; 2]), turn: DQuat| RectifiedCamera {
            lens,
            size,
            rectified_from_camera: DMat3::from_quat((level * turn).normalize()),
            pinhole: lens.pinhole(),
        };
        let [left, right] = [of(left, half), of(right, half.inverse())];
        let pinhole = common_lens(&[left, right], alpha)?;
        let cameras = [RectifiedCamera { pinhole, ..left }, RectifiedCamera { pinhole, ..right }];
        Ok(Self { cameras, baseline })
    }

    /// Pixels of disparity times metres of depth.
    pub fn disparity_depth(&self) -> f64 {
        self.cameras[0].pinhole.focal[0] * self.baseline
    }
}

fn check_alpha(alpha: f64) -> Result<(), SceneError> {
    if (0.0..=1.0).contains(&alpha) {
        return Ok(());
    }
    Err(SceneError::Rule(format!(
        "alpha is {alpha}; 0 (all of the rectified pictures is seen) to 1 (they hold all that is seen) works"
    )))
}

/// Parallel, side by side, with equal pinholes.
fn is_rectified(left: &CalibratedLens, right: &CalibratedLens, left_from_right: &DMat4) -> bool {
    let off = DMat3::from_mat4(*left_from_right) - DMat3::IDENTITY;
    let apart = left_from_right.w_axis;
    off.to_cols_array().iter().all(|off| off.abs() < PARALLEL)
        && apart.x > 0.0
        && apart.y.abs().max(apart.z.abs()) < ASIDE * apart.x
        && left == right
        && left.distortion.is_none()
}

/// Places of the border of the part of a picture that is `part` of it, with which edges they are on: left, right, top, bottom.
fn border([width, height]: [u32; 2], part: f64) -> impl Iterator<Item = (DVec2, [bool; 4])> {
    let size = DVec2::new(width.into(), height.into());
    let last = ALONG - 1;
    (0..ALONG * ALONG).filter_map(move |at| {
        let (i, j) = (at % ALONG, at / ALONG);
        let edges = [i == 0, i == last, j == 0, j == last];
        let across = DVec2::new(i as f64, j as f64) / last as f64 - 0.5;
        edges.contains(&true).then_some((size * (0.5 + across * part), edges))
    })
}

fn is_corner([left, right, top, bottom]: [bool; 4]) -> bool {
    (left || right) && (top || bottom)
}

/// Where the rectified picture of focal length 1 shows `pixel`, from its principal point; none `WIDEST` from the axis.
fn slope(camera: &RectifiedCamera, pixel: DVec2) -> Option<DVec2> {
    let seen = camera.rectified_from_camera * camera.lens.unproject(pixel)?;
    (-seen.z > WIDEST.to_radians().cos()).then(|| DVec2::new(seen.x, -seen.y) / -seen.z)
}

/// Focal length and principal point for all of `cameras`: steps 3 and 4 of the module.
fn common_lens(cameras: &[RectifiedCamera], alpha: f64) -> Result<PinholeLens, SceneError> {
    // By camera, the border of its largest part that fits.
    let fits = |tenths: u32| {
        let part = 0.1 * f64::from(tenths);
        let of = |camera: &RectifiedCamera| {
            border(camera.size, part)
                .map(|(pixel, edges)| Some((slope(camera, pixel)?, edges)))
                .collect::<Option<Vec<_>>>()
        };
        Some((part, cameras.iter().map(of).collect::<Option<Vec<_>>>()?))
    };
    let Some((part, borders)) = (1..=10).rev().find_map(fits) else {
        let angles: Vec<String> = cameras
            .iter()
            .map(|camera| {
                let axis = (camera.rectified_from_camera * DVec3::NEG_Z).dot(DVec3::NEG_Z);
                format!("{:.0}", axis.clamp(-1.0, 1.0).acos().to_degrees())
            })
            .collect();
        return Err(SceneError::Rule(format!(
            "the cameras look {} degrees away from the axis of their rectified pictures, which show less than {WIDEST} degrees to \
             either side; turn the cameras towards each other, or to where both look across the line between them",
            angles.join(" and ")
        )));
    };
    let focal = cameras.iter().map(|camera| undistorted_focal(camera, part)).fold(f64::INFINITY, f64::min);
    let centres = cameras.iter().zip(&borders).map(|(camera, border)| {
        let corners = border.iter().filter(|(_, edges)| is_corner(*edges)).map(|(slope, _)| *slope);
        let [width, height] = camera.size;
        DVec2::new(width.into(), height.into()) * 0.5 - corners.sum::<DVec2>() * (0.25 * focal)
    });
    let center = centres.sum::<DVec2>() / cameras.len() as f64;
    // Scales at which the edges of what is seen come to those of the picture.
    let (mut seen, mut held) = (0.0_f64, f64::INFINITY);
    for (camera, border) in cameras.iter().zip(&borders) {
        let [width, height] = camera.size.map(f64::from);
        let room = [center.x, width - center.x, center.y, height - center.y];
        for (edge, room) in room.into_iter().enumerate() {
            let outwards = |slope: &DVec2| [-slope.x, slope.x, -slope.y, slope.y][edge] * focal;
            let own = border.iter().filter(|(_, edges)| edges[edge]);
            let inner = own.map(|(slope, _)| outwards(slope)).fold(f64::INFINITY, f64::min);
            let outer = border.iter().map(|(slope, _)| outwards(slope)).fold(0.0, f64::max);
            if !(room > 0.0 && inner > 0.0) {
                return Err(SceneError::Rule(
                    "the pictures of the cameras have too little in common to be rectified; turn the cameras towards each other"
                        .into(),
                ));
            }
            seen = seen.max(room / inner);
            held = held.min(room / outer);
        }
    }
    let focal = focal * (seen * (1.0 - alpha) + held * alpha);
    if !(focal.is_finite() && focal > 0.0) {
        return Err(SceneError::Rule(format!(
            "the rectified pictures have the focal length {focal} px; lenses of the usual kind work"
        )));
    }
    Ok(PinholeLens { focal: [focal; 2], center: center.into() })
}

/// fy, less what barrel distortion draws in at the corners of the picture's part, to the first order.
fn undistorted_focal(camera: &RectifiedCamera, part: f64) -> f64 {
    let fy = camera.lens.focal[1];
    let bend = match camera.lens.distortion {
        None => 0.0,
        Some(Distortion::RadialTangential { radial: [k1, ..], .. }) => k1,
        // The angle is the radius less a third of its cube.
        Some(Distortion::Fisheye { radial: [k1, ..] }) => k1 - 1.0 / 3.0,
    };
    let [width, height] = camera.size.map(|edge| part * f64::from(edge));
    let square = (width * width + height * height) / (4.0 * fy * fy);
    fy * (1.0 + bend.min(0.0) * square).max(LEAST_FOCAL)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [u32; 2] = [640, 480];

    fn lens(model: &str, coefficients: &[f64], focal: f64) -> CalibratedLens {
        let distortion =
            (model != "none").then(|| Distortion::from_coefficients(model, coefficients).unwrap());
        CalibratedLens::new([focal, focal * 1.01], [322.0, 238.0], distortion).unwrap()
    }

    fn lenses() -> [CalibratedLens; 3] {
        [
            lens("none", &[], 420.0),
            lens("radtan", &[-0.31, 0.09, 1.1e-3, -7e-4, -0.01], 410.0),
            lens("fisheye", &[0.02, -0.011, 0.004, -0.0007], 400.0),
        ]
    }

    /// The right camera, turned inwards and rolled, and not quite at the left one's height.
    fn converging() -> DMat4 {
        let turn = DQuat::from_euler(glam::EulerRot::YXZ, 0.12, 0.03, -0.05);
        DMat4::from_rotation_translation(turn, DVec3::new(0.1, 0.012, -0.008))
    }

    fn points() -> impl Iterator<Item = DVec3> {
        (0..200).map(|i| {
            let at = |k: u32| f64::from((i * 2654 + k * 977) % 1000) / 1000.0 - 0.5;
            DVec3::new(0.5 * at(1), 0.5 * at(2), -1.0) * (1.0 + 4.0 * (at(3) + 0.5))
        })
    }

    #[test]
    fn points_lie_in_one_row_and_their_disparity_tells_the_depth() {
        let left_from_right = converging();
        for left in lenses() {
            for right in lenses() {
                let pair = Rectification::new((left, SIZE), (right, SIZE), &left_from_right, 0.0).unwrap();
                let [a, b] = pair.cameras;
                let mut seen = 0;
                for point in points() {
                    let there = left_from_right.inverse().transform_point3(point);
                    let (Some(p), Some(q)) = (left.project(point), right.project(there)) else { continue };
                    let (p, q) = (a.rectified(p).unwrap(), b.rectified(q).unwrap());
                    let depth = -(a.rectified_from_camera * point).z;
                    assert!((p.y - q.y).abs() < 1e-6, "{p} {q}");
                    assert!((p.x - q.x - pair.disparity_depth() / depth).abs() < 1e-6, "{p} {q} {depth}");
                    seen += 1;
                }
                assert!(seen > 150, "{seen}");
                let unrectified = points().filter_map(|point| {
                    let there = left_from_right.inverse().transform_point3(point);
                    Some((left.project(point)?.y - right.project(there)?.y).abs())
                });
                assert!(unrectified.fold(0.0, f64::max) > 5.0, "canary");
            }
        }
    }

    #[test]
    fn pictures_go_there_and_back_and_depths_along() {
        for lens in lenses() {
            let pair = Rectification::new((lens, SIZE), (lens, SIZE), &converging(), 0.0).unwrap();
            for camera in pair.cameras {
                for (x, y) in [(0.5, 0.5), (639.5, 0.5), (320.0, 240.0), (100.25, 400.75)] {
                    let pixel = DVec2::new(x, y);
                    let Some(source) = camera.source(pixel) else { panic!("{pixel}") };
                    assert!((camera.rectified(source).unwrap() - pixel).length() < 1e-6, "{pixel} {source}");
                    // With alpha 0, all of the rectified picture is seen.
                    assert!(
                        source.x > -0.01 && source.x < 640.01 && source.y > -0.01 && source.y < 480.01,
                        "{source}"
                    );
                    let ray = camera.lens.planar_ray(source).unwrap().0;
                    let depth = -(camera.rectified_from_camera * ray).z;
                    assert!((camera.depth_factor(source).unwrap() - depth).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn alpha_chooses_between_what_is_seen_and_what_is_held() {
        let [_, radtan, fisheye] = lenses();
        for lens in [radtan, fisheye] {
            let at = |alpha| Rectification::new((lens, SIZE), (lens, SIZE), &converging(), alpha).unwrap();
            let [seen, between, held] = [0.0, 0.5, 1.0].map(|alpha| at(alpha).cameras[0].pinhole);
            assert!(seen.focal[0] > between.focal[0] && between.focal[0] > held.focal[0]);
            assert_eq!(seen.center, held.center);
            for camera in at(1.0).cameras {
                let inside = border(SIZE, 1.0).all(|(pixel, _)| {
                    let at = camera.rectified(pixel).unwrap();
                    at.cmpge(DVec2::splat(-1e-6)).all() && at.cmple(DVec2::new(640.0, 480.0) + 1e-6).all()
                });
                assert!(inside, "they hold all that is seen");
            }
        }
    }

    #[test]
    fn a_rectified_pair_stays_as_it_is() {
        let [pinhole, radtan, _] = lenses();
        let apart = DMat4::from_translation(DVec3::new(0.1, 0.0, 0.0));
        let pair = Rectification::new((pinhole, SIZE), (pinhole, SIZE), &apart, 0.0).unwrap();
        assert!(pair.cameras.iter().all(RectifiedCamera::is_own));
        assert_eq!(pair.disparity_depth(), 42.0);
        let bent = Rectification::new((radtan, SIZE), (radtan, SIZE), &apart, 0.0).unwrap();
        assert!(!bent.cameras[0].is_own(), "canary");
        assert!(RectifiedCamera::alone(pinhole, SIZE, 0.0).unwrap().is_own());
        let alone = RectifiedCamera::alone(radtan, SIZE, 0.0).unwrap();
        assert_eq!(alone.rectified_from_camera, DMat3::IDENTITY);
        assert!((alone.pinhole.focal[0] - bent.cameras[0].pinhole.focal[0]).abs() < 1e-9);
    }

    #[test]
    fn wide_lenses_take_the_part_that_fits_a_pinhole() {
        let wide = lens("fisheye", &[0.0; 4], 200.0);
        let pair = Rectification::new((wide, SIZE), (wide, SIZE), &converging(), 0.0).unwrap();
        let corner = pair.cameras[0].lens.unproject(DVec2::splat(0.5)).unwrap();
        assert!(corner.z > -(80.0_f64).to_radians().cos(), "canary: the whole picture does not fit");
        assert!(pair.cameras[0].source(DVec2::splat(0.5)).is_some());
        // What lies behind the rectified plane has no place in the picture.
        let behind = lens("fisheye", &[0.0; 4], 120.0);
        let pair = Rectification::new((behind, SIZE), (behind, SIZE), &converging(), 0.0).unwrap();
        assert_eq!(pair.cameras[0].rectified(DVec2::splat(0.5)), None);
        // Nor what the model does not reach.
        let folds = lens("radtan", &[-0.6], 300.0);
        let pair = Rectification::new((folds, SIZE), (folds, SIZE), &converging(), 0.0).unwrap();
        assert_eq!(pair.cameras[1].rectified(DVec2::splat(0.5)), None);
        assert!(pair.cameras[1].rectified(DVec2::new(320.0, 240.0)).is_some());
    }

    #[test]
    fn pairs_that_cannot_be_rectified_say_why() {
        let [pinhole, ..] = lenses();
        let refused = |left_from_right: DMat4, right: [u32; 2], alpha: f64, message: &str| {
            let error = Rectification::new((pinhole, SIZE), (pinhole, right), &left_from_right, alpha);
            let text = error.unwrap_err().to_string();
            assert!(text.contains(message), "{text}");
        };
        let at = |x: f64, y: f64, degrees: f64| {
            DMat4::from_rotation_translation(
                DQuat::from_rotation_y(degrees.to_radians()),
                DVec3::new(x, y, 0.0),
            )
        };
        refused(at(0.0, 0.0, 5.0), SIZE, 0.0, "0 m apart");
        refused(at(f64::NAN, 0.0, 0.0), SIZE, 0.0, "NaN m apart");
        refused(at(-0.1, 0.0, 0.0), SIZE, 0.0, "exchange them");
        refused(at(0.01, 0.1, 0.0), SIZE, 0.0, "side by side");
        refused(at(0.1, 0.0, 0.0), [320, 240], 0.0, "640x480 and 320x240");
        refused(at(0.1, 0.0, 0.0), SIZE, 1.5, "alpha is 1.5");
        refused(at(0.1, 0.0, 0.0), SIZE, f64::NAN, "alpha is NaN");
        refused(at(0.1, 0.0, -178.0), SIZE, 0.0, "0 and 178 degrees away");
        refused(at(0.1, 0.0, 178.0), SIZE, 0.0, "0 and 178 degrees away");
    }
}
