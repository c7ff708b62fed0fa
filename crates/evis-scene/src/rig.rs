//! Rigs: calibrated cameras that are fixed to one body, and the calibration files that say where they are.
//!
//! Files have OpenCV's convention: x right, y down, z forward, and pixel centres at whole numbers. Here axes are glTF's (x
//! right, y up, cameras look along -z), and pixel centres lie at +0.5: the way in and out converts both.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use glam::{DMat3, DMat4, DVec4};
use serde::{Deserialize, Serialize};

use crate::builder::{EventCamera, Placement, SceneBuilder};
use crate::distortion::Distortion;
use crate::error::SceneError;
use crate::lens::CalibratedLens;
use crate::model::{Lens, Trs};
use crate::rectify::{Rectification, RectifiedCamera};

/// How far a rotation in a file may be from one, entry by entry: files keep few digits.
const NEARLY_RIGID: f64 = 1e-3;

/// A camera of a rig.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigCamera {
    /// Unique name.
    pub name: String,
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// fx, fy, cx, cy in pixels; pixel centres at +0.5.
    pub intrinsics: [f64; 4],
    /// Model and coefficients, as [`Distortion::from_coefficients`] takes them; `None` for a pinhole.
    #[serde(default)]
    pub distortion: Option<(String, Vec<f64>)>,
    /// Pose in the body's axes, by rows: a rigid transform, metres.
    pub body_from_camera: [[f64; 4]; 4],
}

/// Cameras that are fixed to one body.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rig {
    /// In the order of the file.
    pub cameras: Vec<RigCamera>,
}

/// A calibration file's kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CalibrationFormat {
    /// Kalibr's `camchain.yaml`.
    Kalibr,
    /// DSEC's `cam_to_cam.yaml`.
    Dsec,
}

impl CalibrationFormat {
    /// By its name, `kalibr` or `dsec`.
    ///
    /// # Errors
    /// Another name.
    pub fn from_name(name: &str) -> Result<Self, SceneError> {
        match name {
            "kalibr" => Ok(Self::Kalibr),
            "dsec" => Ok(Self::Dsec),
            _ => {
                Err(SceneError::Rule(format!("the calibration format is '{name}'; 'kalibr' and 'dsec' work")))
            }
        }
    }
}

/// What DSEC's file says of rectified pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DsecRectification {
    /// Cameras 0 to 3 of the file.
    pub cameras: [RectifiedCamera; 4],
    /// Metres between cameras 0 and 3, and 1 and 2; `None` where there are no pairs.
    pub baselines: Option<[f64; 2]>,
}

/// A camera as both kinds of files have it.
#[derive(Debug, Deserialize)]
struct FileCamera {
    camera_model: String,
    #[serde(alias = "intrinsics")]
    camera_matrix: [f64; 4],
    distortion_model: Option<String>,
    #[serde(default)]
    distortion_coeffs: Vec<f64>,
    resolution: [u32; 2],
    #[serde(rename = "T_cn_cnm1")]
    from_previous: Option<[[f64; 4]; 4]>,
}

/// DSEC's file; what else it holds follows from this, or is of rectified pictures.
#[derive(Debug, Deserialize)]
struct DsecFile {
    intrinsics: BTreeMap<String, FileCamera>,
    extrinsics: BTreeMap<String, Vec<Vec<f64>>>,
}

impl Rig {
    /// Two cameras like `camera`, parallel and `baseline` metres apart, named `left` and `right`; the body lies in the left
    /// one.
    ///
    /// # Errors
    /// A baseline that is not above 0, a camera without size or focal lengths.
    pub fn stereo(baseline: f64, camera: &EventCamera) -> Result<Self, SceneError> {
        if !(baseline.is_finite() && baseline > 0.0) {
            return Err(SceneError::Rule(format!(
                "the baseline is {baseline}; a length above 0 works, in metres"
            )));
        }
        let (Lens::Intrinsics { fx, fy, cx, cy }, Some(size)) = (camera.lens, camera.size) else {
            return Err(SceneError::Rule("a stereo pair takes a camera with size and focal lengths".into()));
        };
        let of = |name: &str, x: f64| RigCamera {
            name: name.into(),
            size,
            intrinsics: [fx, fy, cx, cy],
            distortion: camera.distortion.map(|d| (d.name().into(), d.coefficients())),
            body_from_camera: rows(&DMat4::from_translation([x, 0.0, 0.0].into())),
        };
        Ok(Self { cameras: vec![of("left", 0.0), of("right", baseline)] })
    }

    /// Reads a calibration file, whichever kind it is. The body lies in its first camera.
    ///
    /// # Errors
    /// A file that cannot be read, or holds something else.
    pub fn load(path: &Path) -> Result<Self, SceneError> {
        let text = crate::file::text(path).map_err(|source| SceneError::Io { path: path.into(), source })?;
        Self::parse(&text).map_err(|error| match error {
            SceneError::Rule(reason) => SceneError::invalid(path, reason),
            other => other,
        })
    }

    /// The same, from a file's text.
    ///
    /// # Errors
    /// A text that is neither kind's, models that are not known, numbers that cannot be used.
    pub fn parse(text: &str) -> Result<Self, SceneError> {
        let is_dsec = text.lines().any(|line| line.starts_with("extrinsics:"));
        let rig = if is_dsec { Self::parse_dsec(text)? } else { Self::parse_kalibr(text)? };
        if rig.cameras.is_empty() {
            return Err(SceneError::Rule("it has no camera; a camchain has cam0, cam1, ...".into()));
        }
        rig.check()?;
        Ok(rig)
    }

    fn parse_kalibr(text: &str) -> Result<Self, SceneError> {
        let file: BTreeMap<String, FileCamera> =
            serde_norway::from_str(text).map_err(|error| unusable(&error))?;
        let mut first_from_camera = DMat4::IDENTITY;
        let mut cameras = Vec::with_capacity(file.len());
        for index in 0..file.len() {
            let name = format!("cam{index}");
            let camera = file.get(&name).ok_or_else(|| {
                let known: Vec<_> = file.keys().map(String::as_str).collect();
                SceneError::Rule(format!(
                    "it has {} and no {name}; cameras are numbered from 0",
                    known.join(", ")
                ))
            })?;
            match (&camera.from_previous, index) {
                (Some(rows), 1..) => first_from_camera *= matrix(&name, "T_cn_cnm1", rows)?.inverse(),
                (None, 1..) => {
                    return Err(SceneError::Rule(format!("{name} has no T_cn_cnm1: its place is not known")));
                }
                (_, 0) => {}
            }
            cameras.push(camera.rig_camera(&name, &first_from_camera)?);
        }
        Ok(Self { cameras })
    }

    fn parse_dsec(text: &str) -> Result<Self, SceneError> {
        let file: DsecFile = serde_norway::from_str(text).map_err(|error| unusable(&error))?;
        let mut first_from_camera = DMat4::IDENTITY;
        let mut cameras = Vec::new();
        for index in 0_usize.. {
            let name = format!("cam{index}");
            let Some(camera) = file.intrinsics.get(&name) else { break };
            if let Some(previous) = index.checked_sub(1) {
                let key = format!("T_{index}{previous}");
                let given = file.extrinsics.get(&key).and_then(|rows| square(rows)).ok_or_else(|| {
                    SceneError::Rule(format!(
                        "extrinsics has no {key} of 4x4 numbers: {name}'s place is not known"
                    ))
                })?;
                first_from_camera *= matrix(&name, &key, &given)?.inverse();
            }
            cameras.push(camera.rig_camera(&name, &first_from_camera)?);
        }
        Ok(Self { cameras })
    }

    /// Checks every number.
    ///
    /// # Errors
    /// The first that cannot be used.
    pub fn check(&self) -> Result<(), SceneError> {
        for camera in &self.cameras {
            let name = &camera.name;
            if self.cameras.iter().filter(|other| other.name == *name).count() > 1 {
                return Err(SceneError::Rule(format!(
                    "two cameras of a rig are named '{name}'; each needs its own name"
                )));
            }
            matrix(name, "body_from_camera", &camera.body_from_camera)?;
            camera.event_camera()?;
        }
        Ok(())
    }

    /// The text of a calibration file.
    ///
    /// # Errors
    /// As [`Rig::check`]; for DSEC, other than one, two or four cameras.
    pub fn text(&self, format: CalibrationFormat) -> Result<String, SceneError> {
        self.check()?;
        match format {
            CalibrationFormat::Kalibr => Ok(self.kalibr()),
            CalibrationFormat::Dsec => self.dsec(),
        }
    }

    fn kalibr(&self) -> String {
        let mut text = String::new();
        for (index, camera) in self.cameras.iter().enumerate() {
            let others: Vec<usize> = (0..self.cameras.len()).filter(|other| *other != index).collect();
            let _ = writeln!(text, "cam{index}:");
            if let Some(previous) = index.checked_sub(1) {
                let _ = write!(text, "  T_cn_cnm1:\n{}", listed(&self.between(previous, index), "  "));
            }
            let _ = writeln!(text, "  cam_overlaps: {others:?}");
            text += &camera.entries("intrinsics", "  ");
            let _ = writeln!(text, "  rostopic: /{}", camera.name);
        }
        text
    }

    fn dsec(&self) -> Result<String, SceneError> {
        let rectification = self.dsec_rectification().ok();
        self.dsec_text(rectification.as_ref())
    }

    /// Where cameras 0 to 3 of DSEC's file are in the rig: 0 and 3 see events, left and right, 1 and 2 are the frame cameras
    /// beside them.
    fn dsec_order(&self) -> Result<[usize; 4], SceneError> {
        match self.cameras.len() {
            1 => Ok([0; 4]),
            2 => Ok([0, 0, 1, 1]),
            4 => Ok([0, 1, 2, 3]),
            count => Err(SceneError::Rule(format!(
                "the rig has {count} cameras; DSEC's file takes one, two or four"
            ))),
        }
    }

    /// The rectified pictures of DSEC's file: cameras 0 and 3 are a pair, and 1 and 2; a rig of one camera has its picture without
    /// distortion. All of the rectified pictures is seen.
    ///
    /// # Errors
    /// As [`Rig::rectify`]; other than one, two or four cameras.
    pub fn dsec_rectification(&self) -> Result<DsecRectification, SceneError> {
        let [a, b, c, d] = self.dsec_order()?;
        if a == d {
            return Ok(DsecRectification { cameras: [self.rectify_alone(a)?; 4], baselines: None });
        }
        let [outer, inner] = [self.rectify(a, d, 0.0)?, self.rectify(b, c, 0.0)?];
        let cameras = [outer.cameras[0], inner.cameras[0], inner.cameras[1], outer.cameras[1]];
        Ok(DsecRectification { cameras, baselines: Some([outer.baseline, inner.baseline]) })
    }

    /// The text of DSEC's file, with the rectified pictures where there are any.
    ///
    /// # Errors
    /// Other than one, two or four cameras.
    pub fn dsec_text(&self, rectification: Option<&DsecRectification>) -> Result<String, SceneError> {
        let order = self.dsec_order()?;
        let rectified: &[RectifiedCamera] = rectification.map_or(&[], |of| &of.cameras);
        let mut text = String::from("extrinsics:\n");
        for index in 1..4 {
            let rows = listed(&self.between(order[index - 1], order[index]), "  ");
            let _ = write!(text, "  T_{index}{}:\n{rows}", index - 1);
        }
        for (index, camera) in rectified.iter().enumerate() {
            let _ = writeln!(text, "  R_rect{index}:");
            for row in opencv_rotation(&camera.rectified_from_camera) {
                let _ = writeln!(text, "  - {row:?}");
            }
        }
        text += "intrinsics:\n";
        for (index, camera) in order.into_iter().enumerate() {
            let _ = write!(text, "  cam{index}:\n{}", self.cameras[camera].entries("camera_matrix", "    "));
        }
        for (index, camera) in rectified.iter().enumerate() {
            let ([fx, fy], [cx, cy]) = (camera.pinhole.focal, camera.pinhole.center);
            let seen = RigCamera {
                name: String::new(),
                size: camera.size,
                intrinsics: [fx, fy, cx, cy],
                distortion: None,
                body_from_camera: rows(&DMat4::IDENTITY),
            };
            let _ = write!(text, "  camRect{index}:\n{}", seen.entries("camera_matrix", "    "));
        }
        if let Some((of, [outer, inner])) = rectification.and_then(|of| Some((of, of.baselines?))) {
            text += "disparity_to_depth:\n";
            for (pair, camera, baseline) in [("cams_03", 0, outer), ("cams_12", 1, inner)] {
                let _ = writeln!(text, "  {pair}:");
                for row in depth_from_disparity(&of.cameras[camera], baseline) {
                    let _ = writeln!(text, "  - {row:?}");
                }
            }
        }
        Ok(text)
    }

    /// How the pictures of cameras `left` and `right` (indices) are rectified. `alpha`: see [`crate::rectify`].
    ///
    /// # Errors
    /// As [`Rectification::new`]; cameras that do not exist or cannot be used.
    pub fn rectify(&self, left: usize, right: usize, alpha: f64) -> Result<Rectification, SceneError> {
        let pose = |index: usize| {
            let camera = self.lens(index)?.1;
            matrix(&camera.name, "body_from_camera", &camera.body_from_camera)
        };
        let left_from_right = pose(left)?.inverse() * pose(right)?;
        let of = |index: usize| self.lens(index).map(|(lens, camera)| (lens, camera.size));
        Rectification::new(of(left)?, of(right)?, &left_from_right, alpha)
    }

    /// The picture of camera `index` without distortion, all of which is seen; its own one where there is none.
    ///
    /// # Errors
    /// As [`RectifiedCamera::alone`]; a camera that does not exist or cannot be used.
    pub fn rectify_alone(&self, index: usize) -> Result<RectifiedCamera, SceneError> {
        let (lens, camera) = self.lens(index)?;
        RectifiedCamera::alone(lens, camera.size, 0.0)
    }

    fn lens(&self, index: usize) -> Result<(CalibratedLens, &RigCamera), SceneError> {
        let count = self.cameras.len();
        let missing = || SceneError::Rule(format!("there is no camera {index}; the rig has {count}"));
        let camera = self.cameras.get(index).ok_or_else(missing)?;
        let [fx, fy, cx, cy] = camera.intrinsics;
        let lens = CalibratedLens::new([fx, fy], [cx, cy], camera.event_camera()?.distortion)?;
        Ok((lens, camera))
    }

    /// Takes points from camera `from` to camera `to`, in OpenCV's axes.
    fn between(&self, from: usize, to: usize) -> DMat4 {
        let [from, to] = [from, to].map(|index| from_rows(&self.cameras[index].body_from_camera));
        flip(&(to.inverse() * from))
    }
}

impl RigCamera {
    /// The camera, for a scene.
    ///
    /// # Errors
    /// A distortion that cannot be used.
    pub fn event_camera(&self) -> Result<EventCamera, SceneError> {
        let [fx, fy, cx, cy] = self.intrinsics;
        let camera = EventCamera::new(&self.name).size(self.size[0], self.size[1]).intrinsics(fx, fy, cx, cy);
        let distortion = self.distortion.as_ref().map(|(model, k)| Distortion::from_coefficients(model, k));
        let named = |error: SceneError| SceneError::Rule(format!("camera '{}': {error}", self.name));
        let camera = EventCamera { distortion: distortion.transpose().map_err(named)?, ..camera };
        crate::builder::check_camera(&camera)?;
        Ok(camera)
    }

    fn entries(&self, matrix: &str, indent: &str) -> String {
        let [fx, fy, cx, cy] = self.intrinsics;
        let (model, coefficients) = match &self.distortion {
            None => ("radtan", vec![0.0; 4]),
            Some((model, k)) if model == "fisheye" => ("equidistant", padded(k, 4)),
            // Kalibr's model has four coefficients; more are written as OpenCV orders them.
            Some((model, k)) => (model.as_str(), padded(k, 4)),
        };
        let lines = [
            "camera_model: pinhole".to_owned(),
            format!("{matrix}: {:?}", [fx, fy, cx - 0.5, cy - 0.5]),
            format!("distortion_coeffs: {coefficients:?}"),
            format!("distortion_model: {model}"),
            format!("resolution: {:?}", self.size),
        ];
        lines.iter().map(|line| format!("{indent}{line}\n")).collect()
    }
}

impl FileCamera {
    fn rig_camera(&self, name: &str, first_from_camera: &DMat4) -> Result<RigCamera, SceneError> {
        let unknown = |what: &str, value: &str, works: &str| {
            SceneError::Rule(format!("{name} has the {what} '{value}'; {works}"))
        };
        if self.camera_model != "pinhole" {
            return Err(unknown(
                "camera_model",
                &self.camera_model,
                "'pinhole' works, with any distortion model",
            ));
        }
        let model = match self.distortion_model.as_deref() {
            None | Some("none") => None,
            Some("radtan" | "plumb_bob" | "rational_polynomial") => Some("radtan"),
            Some("equidistant" | "fisheye") => Some("fisheye"),
            Some(other) => {
                return Err(unknown("distortion_model", other, "'radtan', 'equidistant' and 'none' work"));
            }
        };
        let [fx, fy, cx, cy] = self.camera_matrix;
        let given = self.distortion_coeffs.iter().any(|k| *k != 0.0) || model == Some("fisheye");
        let distortion =
            model.filter(|_| given).map(|model| (model.to_owned(), self.distortion_coeffs.clone()));
        Ok(RigCamera {
            name: name.into(),
            size: self.resolution,
            intrinsics: [fx, fy, cx + 0.5, cy + 0.5],
            distortion,
            body_from_camera: rows(&flip(first_from_camera)),
        })
    }
}

impl SceneBuilder {
    /// A body `name` that carries the cameras of `rig`; returns its node. Hang nodes on it to carry more.
    ///
    /// # Errors
    /// As [`Rig::check`]; names that are taken.
    pub fn rig(
        &mut self,
        name: impl Into<String>,
        rig: &Rig,
        placement: Placement,
    ) -> Result<usize, SceneError> {
        self.rig_like(name, rig, &EventCamera::new("camera"), placement)
    }

    /// As [`SceneBuilder::rig`], with near plane, thresholds and sensor of `like`.
    ///
    /// # Errors
    /// As [`SceneBuilder::rig`].
    pub fn rig_like(
        &mut self,
        name: impl Into<String>,
        rig: &Rig,
        like: &EventCamera,
        placement: Placement,
    ) -> Result<usize, SceneError> {
        rig.check()?;
        let body = self.node(name, placement)?;
        for camera in &rig.cameras {
            let placement = Placement { pose: camera.into(), ..Placement::default() }.on(body);
            let EventCamera { name, lens, size, distortion, .. } = camera.event_camera()?;
            self.camera(EventCamera { name, lens, size, distortion, ..like.clone() }, placement)?;
        }
        Ok(body)
    }
}

fn unusable(error: &serde_norway::Error) -> SceneError {
    SceneError::Rule(format!("it is no camchain of Kalibr and no cam_to_cam of DSEC ({error})"))
}

/// OpenCV's axes for glTF's, and the way back: y and z turn round.
fn flip(transform: &DMat4) -> DMat4 {
    let sign = DMat4::from_diagonal(DVec4::new(1.0, -1.0, -1.0, 1.0));
    sign * *transform * sign
}

/// By rows, in OpenCV's axes.
fn opencv_rotation(rotation: &DMat3) -> [[f64; 3]; 3] {
    let rows = rows(&flip(&DMat4::from_mat3(*rotation)));
    // No minus before a zero.
    [0, 1, 2].map(|i| [0, 1, 2].map(|k| rows[i][k] + 0.0))
}

/// OpenCV's Q: homogeneous places in the rectified axes from x, y, disparity and 1.
fn depth_from_disparity(camera: &RectifiedCamera, baseline: f64) -> [[f64; 4]; 4] {
    let ([fx, fy], [cx, cy]) = (camera.pinhole.focal, camera.pinhole.center);
    let tall = fx / fy;
    [
        [1.0, 0.0, 0.0, -(cx - 0.5)],
        [0.0, tall, 0.0, -(cy - 0.5) * tall],
        [0.0, 0.0, 0.0, fx],
        [0.0, 0.0, 1.0 / baseline, 0.0],
    ]
}

fn rows(matrix: &DMat4) -> [[f64; 4]; 4] {
    matrix.transpose().to_cols_array_2d()
}

fn from_rows(rows: &[[f64; 4]; 4]) -> DMat4 {
    DMat4::from_cols_array_2d(rows).transpose()
}

fn square(rows: &[Vec<f64>]) -> Option<[[f64; 4]; 4]> {
    let rows: Vec<[f64; 4]> = rows.iter().map(|row| row.as_slice().try_into().ok()).collect::<Option<_>>()?;
    rows.try_into().ok()
}

/// `rows` as a rigid transform: its rotation, which files round, is made one.
fn matrix(camera: &str, key: &str, rows: &[[f64; 4]; 4]) -> Result<DMat4, SceneError> {
    let given = from_rows(rows);
    let rigid = crate::framing::rigid(&given).filter(|rigid| {
        given.is_finite() && (*rigid - given).to_cols_array().iter().all(|v| v.abs() < NEARLY_RIGID)
    });
    rigid.ok_or_else(|| {
        SceneError::Rule(format!(
            "{key} of {camera} is {rows:?}; it takes a rotation and a translation in metres, as four rows"
        ))
    })
}

fn padded(coefficients: &[f64], least: usize) -> Vec<f64> {
    let mut all = coefficients.to_vec();
    while all.len() > least && all.last() == Some(&0.0) {
        all.pop();
    }
    all.resize(all.len().max(least), 0.0);
    all
}

fn listed(matrix: &DMat4, indent: &str) -> String {
    rows(matrix).iter().map(|row| format!("{indent}- {row:?}\n")).collect()
}

/// The pose of a camera on its body.
impl From<&RigCamera> for Trs {
    fn from(camera: &RigCamera) -> Self {
        let (_, rotation, translation) = from_rows(&camera.body_from_camera).to_scale_rotation_translation();
        Self { translation, rotation, ..Self::default() }
    }
}
