//! Camera motion for scenes in which nothing moves: an orbit, a dolly, a shake, or poses from a file.
//!
//! Speeds are image speeds in pixels per second, because models come in metres and in centimetres: the physical speed is
//! the one at which what the first camera shows of the scene, in the central half of its picture, moves so fast on
//! average. Motions are paths like any other ([`Path`]), exact at any time.

use std::path::{Path as FilePath, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

use evis_limits::nearest;
use glam::{DMat4, DVec3};

use crate::builder::still;
use crate::error::SceneError;
use crate::framing::{framing_distance, rigid};
use crate::model::{Framing, Lens, Node, Scene, Trs};
use crate::motion::{AppliedMotion, Harmonic, Motion, Path, PathInterpolation};
use crate::picture::MARGIN;
use crate::pixel_lens::PixelLens;
use crate::pose::SceneState;
use crate::procedural::uniform;
use crate::toml_scene::trajectory;
use crate::visible::image_speed;

/// Image speed where none is given, in pixels per second.
pub const DEFAULT_SPEED_PX_PER_S: f64 = 100.0;

/// Image speeds that can be asked for, in pixels per second.
const SPEEDS_PX_PER_S: std::ops::RangeInclusive<f64> = 0.01..=100_000.0;

/// Refuses image speeds that cannot be asked for.
///
/// # Errors
/// Says what it must be.
pub fn check_speed(px_per_s: f64) -> Result<f64, String> {
    if SPEEDS_PX_PER_S.contains(&px_per_s) {
        return Ok(px_per_s);
    }
    Err("it must be from 0.01 to 100000 pixels per second, such as 100".into())
}

/// Seed of the shake, the same for every run.
const SHAKE_SEED: u64 = 0x5eed_5ace;

/// Largest amplitude of a shake, as a share of the picture's shorter side. The margin of a picture ([`MARGIN`]) is made for it.
const SHAKE_SHARE: f64 = 0.04;

/// Share of the way to the nearest surface that a dolly uses.
const DOLLY_SHARE: f64 = 0.35;

/// Angles and instants at which a swept model and a motion are sampled.
const SAMPLES: u32 = 64;

/// Words of [`CameraMotion`].
const WORDS: [(&str, CameraMotion); 4] = [
    ("none", CameraMotion::None),
    ("orbit", CameraMotion::Orbit),
    ("dolly", CameraMotion::Dolly),
    ("shake", CameraMotion::Shake),
];

/// How cameras move that the scene leaves at rest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CameraMotion {
    /// Not at all.
    None,
    /// Around the model's centre, about the vertical, at a constant rate.
    Orbit,
    /// To and fro along the view axis, without touching the model.
    Dolly,
    /// Small, smooth and random turns and shifts, like those of a hand or an eye; the same in every run.
    Shake,
    /// Along the poses of a text file: rows of `t x y z qx qy qz qw`, seconds and metres, of the first camera in the world
    /// (it looks along -Z, +Y is up). A line `# unit: ns` (us, ms, s) names another unit of time.
    File(PathBuf),
}

impl FromStr for CameraMotion {
    type Err = String;

    /// A word, or a path: what has a dot or a separator in it.
    fn from_str(text: &str) -> Result<Self, String> {
        if let Some((_, motion)) = WORDS.iter().find(|(word, _)| *word == text) {
            return Ok(motion.clone());
        }
        if text.contains(['.', '/', std::path::MAIN_SEPARATOR]) {
            return Ok(Self::File(text.into()));
        }
        let near = nearest(text, WORDS.iter().map(|(word, _)| *word));
        let hint = near.map_or_else(String::new, |near| format!(" (did you mean '{near}'?)"));
        Err(format!("it must be none, orbit, dolly, shake, or a file of poses such as path.csv{hint}"))
    }
}

impl CameraMotion {
    /// Its word, or its path; [`Self::from_str`] reads it.
    pub fn name(&self) -> String {
        match self {
            Self::File(path) => path.display().to_string(),
            word => WORDS.iter().find(|(_, m)| m == word).map_or("", |(word, _)| word).to_owned(),
        }
    }
}

/// What is asked of [`Scene::move_cameras`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraMotionSettings {
    /// `None` moves the camera only where the scene brings neither a camera nor any motion: around a model
    /// ([`CameraMotion::Orbit`]), before a picture ([`CameraMotion::Shake`]).
    pub motion: Option<CameraMotion>,
    /// Mean image speed at the centre of the picture in pixels per second; `None` for
    /// [`DEFAULT_SPEED_PX_PER_S`].
    pub speed_px_per_s: Option<f64>,
    /// Name of the camera by which the motion is made; the others move along as if fixed to it. `None` for the first.
    pub camera: Option<String>,
    /// Width and height of the camera in pixels; `None` for its own.
    pub size: Option<(u32, u32)>,
}

/// A motion that has been found: the camera goes through `world_from_base * path(t) * base_from_world * its own pose`.
struct Move {
    world_from_base: DMat4,
    path: Path,
    description: String,
}

/// `scene` with its cameras moved as [`Scene::move_cameras`] does; the same scene where that changes nothing.
///
/// # Errors
/// As [`Scene::move_cameras`].
pub fn moved(scene: &Arc<Scene>, settings: &CameraMotionSettings) -> Result<Arc<Scene>, SceneError> {
    let asked = settings.motion.is_some() || settings.speed_px_per_s.is_some();
    if !asked && (scene.camera_motion.is_some() || scene.default_motion().is_none()) {
        return Ok(Arc::clone(scene));
    }
    let mut scene = Scene::clone(scene);
    scene.move_cameras(settings)?;
    Ok(Arc::new(scene))
}

impl Scene {
    /// Moves cameras that rest, as `settings` say; by default only the one of a scene that has neither a camera of its own
    /// nor any motion, and `warnings` says so. The camera of a picture is fitted to the view's size first. What was done
    /// is kept in [`Scene::camera_motion`].
    ///
    /// # Errors
    /// A speed that is not 0.01 to 100000 pixels per second, or that nothing takes; a camera that moves by itself; a
    /// dolly that has no way to go; an orbit around a picture; a file that cannot be read (named, with line and
    /// column).
    pub fn move_cameras(&mut self, settings: &CameraMotionSettings) -> Result<(), SceneError> {
        let speed = settings.speed_px_per_s.unwrap_or(DEFAULT_SPEED_PX_PER_S);
        check_speed(speed)
            .map_err(|reason| SceneError::Rule(format!("the camera speed is {speed} px/s; {reason}")))?;
        // Twice the same: a scene that has been moved by default is not moved again.
        if settings.motion.is_none() && settings.speed_px_per_s.is_none() && self.camera_motion.is_some() {
            return Ok(());
        }
        self.fit_picture(settings.size);
        let by_default = settings.motion.is_none();
        let motion = match &settings.motion {
            Some(motion) => motion.clone(),
            None => match self.default_motion() {
                Some(motion) => motion,
                None if settings.speed_px_per_s.is_some() => {
                    return rule(format!(
                        "a camera speed of {speed} px/s moves nothing here: the scene has a camera or a motion of its own; \
                         add a camera motion (orbit, dolly or shake)"
                    ));
                }
                None => return Ok(()),
            },
        };
        if let (Some(speed), CameraMotion::None | CameraMotion::File(_)) = (settings.speed_px_per_s, &motion)
        {
            return rule(format!(
                "the camera motion {} takes no speed ({speed} px/s); leave it out, or take orbit, dolly or shake",
                motion.name()
            ));
        }
        let mut applied = AppliedMotion {
            motion: motion.name(),
            speed_px_per_s: settings.speed_px_per_s,
            by_default,
            description: "the camera rests".into(),
        };
        if motion != CameraMotion::None {
            self.check_rest()?;
            let first = settings.camera.as_deref().map_or(Ok(0), |name| self.camera(name))?;
            let found = match &motion {
                CameraMotion::File(path) => self.file_motion(path, first, settings.size)?,
                motion => {
                    applied.speed_px_per_s = Some(speed);
                    self.found_motion(motion, first, settings.size, speed)?
                }
            };
            applied.description.clone_from(&found.description);
            self.attach(&found);
        }
        if by_default {
            let what = match self.framing {
                Some(Framing::Picture { .. }) => "a still picture: the camera shakes before it",
                _ => "no camera and no motion in the scene: the camera orbits the model",
            };
            let name = motion.name();
            self.warnings
                .push(format!("{what} at about {speed} px/s (camera motion {name}; none keeps it at rest)"));
        }
        self.camera_motion = Some(applied);
        Ok(())
    }

    /// Whether nothing that is drawn, no light and none of `cameras` (by name; empty for all) ever moves or changes.
    pub fn rests(&self, cameras: &[String]) -> bool {
        let mut counts = vec![false; self.nodes.len()];
        let mut mark = |node: usize| {
            if let Some(counts) = counts.get_mut(node) {
                *counts = true;
            }
        };
        for (index, node) in self.nodes.iter().enumerate() {
            if node.mesh.is_some() || node.light.is_some() {
                mark(index);
            }
            let skin = node.skin.and_then(|s| self.skins.get(s));
            skin.into_iter().flat_map(|skin| &skin.joints).for_each(|joint| mark(*joint));
        }
        let seen = self.cameras.iter().filter(|camera| cameras.is_empty() || cameras.contains(&camera.name));
        seen.for_each(|camera| mark(camera.node));
        // Parents come before children, so children mark them on the way back.
        for index in (0..self.nodes.len()).rev() {
            if let (true, Some(parent)) = (counts[index], self.nodes[index].parent) {
                counts[parent] = true;
            }
        }
        let rests =
            |node: &Node| node.motion.rests() && node.morph.as_ref().is_none_or(|curve| curve.rests());
        let waves = self
            .lights
            .iter()
            .map(|l| &l.waveform)
            .chain(self.materials.iter().map(|m| &m.emission_waveform));
        self.nodes.iter().zip(&counts).all(|(node, counts)| !counts || rests(node))
            && waves.flatten().all(|wave| wave.rests())
    }

    /// How the camera of a scene that brings neither a camera nor any motion moves.
    fn default_motion(&self) -> Option<CameraMotion> {
        let [_] = self.cameras[..] else { return None };
        match self.framing? {
            _ if !self.rests(&[]) => None,
            Framing::Model => Some(CameraMotion::Orbit),
            Framing::Picture { .. } => Some(CameraMotion::Shake),
        }
    }

    /// Refuses cameras that move by themselves.
    fn check_rest(&self) -> Result<(), SceneError> {
        if self.cameras.is_empty() {
            return rule("there is no camera to move; add one".into());
        }
        for camera in &self.cameras {
            let mut at = Some(camera.node);
            while let Some(node) = at.and_then(|n| self.nodes.get(n)) {
                if !node.motion.rests() {
                    return rule(format!(
                        "camera '{}' moves by itself; a camera motion is for cameras that rest: leave it out",
                        camera.name
                    ));
                }
                at = node.parent;
            }
        }
        Ok(())
    }

    /// Pose of camera `camera` at scene time 0, without scale.
    fn resting_pose(&self, camera: usize) -> Result<DMat4, SceneError> {
        let mut state = SceneState::default();
        self.evaluate(0.0, &mut state);
        self.world_from_camera(camera, &state)
            .ok_or_else(|| SceneError::Rule(format!("camera {camera} does not exist or has no direction")))
    }

    /// The motion of camera `first` that has an image speed of `speed_px_per_s`.
    fn found_motion(
        &mut self,
        motion: &CameraMotion,
        first: usize,
        size: Option<(u32, u32)>,
        speed_px_per_s: f64,
    ) -> Result<Move, SceneError> {
        let bounds = self.bounds_over_time();
        let center = bounds.map(|(low, high)| 0.5 * (low + high));
        if *motion == CameraMotion::Orbit {
            match self.framing {
                Some(Framing::Picture { .. }) => {
                    return rule(
                        "a picture has no back to orbit around; take the camera motion shake or dolly".into(),
                    );
                }
                Some(Framing::Model) => self.frame_orbit(center.unwrap_or_default(), size),
                None => {}
            }
        }
        let pose = self.resting_pose(first)?;
        let lens = PixelLens::new(&self.cameras[first], size);
        let mut points = self.visible_points(&lens, &pose, 0.0);
        let depth = mean_depth(&lens, &points).unwrap_or_else(|| {
            let center = center.map_or(0.0, |c| -pose.inverse().transform_point3(c).z);
            if center > lens.near { center } else { 1.0 }
        });
        if points.is_empty() {
            points = lens.plane(depth);
        }
        let clearance = || -> Result<f64, SceneError> {
            let eyes = (0..self.cameras.len()).map(|k| Ok(self.resting_pose(k)?.w_axis.truncate()));
            let eyes = eyes.collect::<Result<Vec<_>, SceneError>>()?;
            Ok(self.clearance(&eyes) - lens.near_reach())
        };
        match motion {
            CameraMotion::Orbit => {
                // The model's centre; for a camera that does not look there, what it looks at.
                let seen =
                    |c: &DVec3| lens.sees(pose.inverse().transform_point3(*c)).is_some_and(|p| lens.shows(p));
                let pivot =
                    center.filter(seen).unwrap_or_else(|| pose.transform_point3(DVec3::NEG_Z * depth));
                let base = DMat4::from_translation(pivot);
                let spin = |rate| Path::Spin { start: Trs::default(), axis: DVec3::Y, rate };
                let measured =
                    measured(&lens, &points, &(base.inverse() * pose), &spin(1.0), [0.0].into_iter());
                let rate = speed_px_per_s / usable(measured, "an orbit")?;
                Ok(Move {
                    world_from_base: base,
                    path: spin(rate),
                    description: format!(
                        "turns about the vertical through ({}) by {} degrees per second",
                        [pivot.x, pivot.y, pivot.z].map(short).join(", "),
                        short(rate.to_degrees())
                    ),
                })
            }
            CameraMotion::Dolly => {
                let clearance = clearance()?;
                let amplitude = match self.framing {
                    Some(Framing::Picture { .. }) => depth * 1.75 * MARGIN,
                    _ => DOLLY_SHARE * clearance,
                };
                if !(amplitude.is_finite() && amplitude > 0.0) {
                    return rule(format!(
                        "a dolly has no way to go: {}; take the camera motion orbit or shake",
                        if clearance.is_finite() {
                            "a camera touches a surface with its near plane"
                        } else {
                            "nothing is drawn that the camera could come near to"
                        }
                    ));
                }
                let term = Harmonic {
                    frequency_hz: 1.0,
                    phase: 0.0,
                    translation: DVec3::NEG_Z * amplitude,
                    rotation: DVec3::ZERO,
                };
                let path = Path::Harmonic { start: Trs::default(), terms: vec![term] };
                let times = (0..SAMPLES).map(|k| (f64::from(k) + 0.5) / f64::from(SAMPLES));
                let measured = measured(&lens, &points, &DMat4::IDENTITY, &path, times);
                let rate = speed_px_per_s / usable(measured, "a dolly")?;
                Ok(Move {
                    world_from_base: pose,
                    path: at_rate(path, rate),
                    description: format!(
                        "moves {} m to and fro along the view axis, {} times per second",
                        short(amplitude),
                        short(rate)
                    ),
                })
            }
            _ => {
                // Larger speeds are faster, not wider.
                let amplitude_px = (SHAKE_SHARE * lens.size().min_element()).min(speed_px_per_s / 8.0);
                let path = shake(&lens, amplitude_px, depth.min(0.3 * clearance()?.max(0.0) / SHAKE_SHARE));
                // Long enough for the mean not to depend on it; a golden ratio apart, so that no sine is in step.
                let times = (0..8 * SAMPLES).map(|k| f64::from(k) / 1.618_033_988_749_895);
                let measured = measured(&lens, &points, &DMat4::IDENTITY, &path, times);
                let rate = speed_px_per_s / usable(measured, "a shake")?;
                Ok(Move {
                    world_from_base: pose,
                    path: at_rate(path, rate),
                    description: format!(
                        "turns and shifts by up to {} pixels, {} to {} times per second",
                        short(amplitude_px),
                        short(SHAKE_HZ[0][0] * rate),
                        short(SHAKE_HZ[2][1] * rate)
                    ),
                })
            }
        }
    }

    /// The motion of camera `first` along the poses of `file`.
    fn file_motion(
        &mut self,
        file: &FilePath,
        first: usize,
        size: Option<(u32, u32)>,
    ) -> Result<Move, SceneError> {
        let path = trajectory::load_plain(file, PathInterpolation::Linear)?;
        let pose = self.resting_pose(first)?;
        let end_s = path.end_s().unwrap_or(0.0);
        let lens = PixelLens::new(&self.cameras[first], size);
        let sees = |k: u32| {
            let world_from_camera = path.matrix(end_s * f64::from(k) / 16.0);
            !self.visible_points(&lens, &world_from_camera, 0.0).is_empty()
        };
        if let Some((low, high)) = self.bounds(0.0)
            && !(0..=16).any(sees)
        {
            let c = 0.5 * (low + high);
            self.warnings.push(format!(
                "'{}' never turns the camera towards anything: poses are those of a camera that looks along its -Z, +Y up, in \
                 the world, where the scene lies around ({})",
                file.display(),
                [c.x, c.y, c.z].map(short).join(", ")
            ));
        }
        if end_s > 0.0 {
            let end_s = end_s / self.speed.unwrap_or(1.0);
            self.duration_s = Some(self.duration_s.map_or(end_s, |own| own.max(end_s)));
        }
        // In the first camera's own frame, so that it passes through the file's poses exactly.
        let path = Path::Chain(vec![path, still(trs(&pose.inverse()))]);
        Ok(Move {
            world_from_base: DMat4::IDENTITY,
            path,
            description: format!("follows the poses of {} for {} s", file.display(), short(end_s)),
        })
    }

    /// Moves the framing camera, along its view axis, to where it sees the whole model from everywhere on its orbit.
    fn frame_orbit(&mut self, center: DVec3, size: Option<(u32, u32)>) {
        let Ok(pose) = self.resting_pose(0) else { return };
        let (mut radius, mut low, mut high) = (0.0_f64, 0.0_f64, 0.0_f64);
        for t_s in self.framing_times() {
            self.visit_points(t_s, |p| {
                let p = p - center;
                radius = radius.max(p.x.hypot(p.z));
                (low, high) = (low.min(p.y), high.max(p.y));
            });
        }
        let (rotation, camera) = (trs(&pose).rotation, &mut self.cameras[0]);
        let (width, height) = camera.pixels(size);
        let Lens::FieldOfView { fov_y } = camera.lens else { return };
        let rim = (0..SAMPLES).flat_map(|k| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / f64::from(SAMPLES)).sin_cos();
            // The polygon is drawn around the circle.
            let r = radius / (std::f64::consts::PI / f64::from(SAMPLES)).cos();
            [low, high].map(|y| DVec3::new(r * cos, y, r * sin))
        });
        let distance = framing_distance(rotation, 0.5 * fov_y, f64::from(width) / f64::from(height), rim);
        camera.near = distance * 0.01;
        let pose = Trs { translation: center + rotation * DVec3::Z * distance, rotation, scale: DVec3::ONE };
        if let Some(node) = self.nodes.get_mut(camera.node) {
            node.motion = Motion::Fixed(pose.matrix());
        }
    }

    /// Lets all cameras take part in `found`, as if they were fixed to each other.
    fn attach(&mut self, found: &Move) {
        let mut state = SceneState::default();
        self.evaluate(0.0, &mut state);
        for index in 0..self.cameras.len() {
            let Some(world_from_camera) = self.world_from_camera(index, &state) else { continue };
            let parent = self.cameras[index].node;
            // The node's own scale is taken out; where it cannot be, the camera leaves the node.
            let inverse = state.world_from_node.get(parent).map(DMat4::inverse).filter(DMat4::is_finite);
            let rig = self.add_node(Node {
                name: "camera rig".into(),
                parent: inverse.and(Some(parent)),
                motion: Motion::Fixed(inverse.unwrap_or(DMat4::IDENTITY) * found.world_from_base),
                ..Node::default()
            });
            let moving = self.add_node(Node {
                name: "camera motion".into(),
                parent: Some(rig),
                motion: Motion::Path(Arc::new(found.path.clone())),
                ..Node::default()
            });
            let node = self.add_node(Node {
                name: "moving camera".into(),
                parent: Some(moving),
                motion: Motion::Fixed(found.world_from_base.inverse() * world_from_camera),
                ..Node::default()
            });
            self.cameras[index].node = node;
        }
    }
}

/// Bands of the three sines of each degree of freedom of a shake, in Hz.
const SHAKE_HZ: [[f64; 2]; 3] = [[1.1, 1.7], [1.9, 2.7], [2.9, 3.9]];

/// Turns and shifts by at most `amplitude_px` along each axis at the centre of the picture, for surfaces at `depth`, and half as
/// much more in its corners, by turning about the view axis and moving along it.
fn shake(lens: &PixelLens, amplitude_px: f64, depth: f64) -> Path {
    let per_metre = lens.pixels_per_metre(depth).max_element();
    let half_diagonal = 0.5 * lens.size().length();
    let [turn, shift] = [depth, 1.0].map(|arm| 0.5 * amplitude_px / (per_metre * arm));
    let [roll, advance] = [0.25 * amplitude_px / half_diagonal, 0.25 * amplitude_px * depth / half_diagonal];
    let axes: [(DVec3, DVec3); 6] = [
        (DVec3::X * shift, DVec3::ZERO),
        (DVec3::Y * shift, DVec3::ZERO),
        (DVec3::Z * advance, DVec3::ZERO),
        (DVec3::ZERO, DVec3::X * turn),
        (DVec3::ZERO, DVec3::Y * turn),
        (DVec3::ZERO, DVec3::Z * roll),
    ];
    let mut terms = Vec::new();
    for (axis, (translation, rotation)) in (0_u32..).zip(axes) {
        let draw = |band: u32, what: u32| f64::from(uniform(SHAKE_SEED, axis, band, what));
        let bands = (0_u32..)
            .zip(SHAKE_HZ)
            .map(|(band, [low, high])| (low + (high - low) * draw(band, 0), draw(band, 1)));
        let bands: Vec<(f64, f64)> = bands.collect();
        // Each sine has the same part in the speed, and all amplitudes together are the one asked for.
        let sum: f64 = bands.iter().map(|(hz, _)| hz.recip()).sum();
        terms.extend(bands.into_iter().map(|(frequency_hz, phase)| {
            let share = frequency_hz.recip() / sum;
            Harmonic { frequency_hz, phase, translation: translation * share, rotation: rotation * share }
        }));
    }
    Path::Harmonic { start: Trs::default(), terms }
}

/// The path, `rate` times as fast.
fn at_rate(path: Path, rate: f64) -> Path {
    let Path::Harmonic { start, mut terms } = path else { return path };
    terms.iter_mut().for_each(|term| term.frequency_hz *= rate);
    Path::Harmonic { start, terms }
}

/// Image speed of `points`, in the frame of a resting camera, along `path`.
fn measured(
    lens: &PixelLens,
    points: &[DVec3],
    base_from_camera: &DMat4,
    path: &Path,
    times_s: impl Iterator<Item = f64>,
) -> Option<f64> {
    let camera_from_base = base_from_camera.inverse();
    image_speed(lens, points, |t_s| camera_from_base * path.matrix(t_s) * *base_from_camera, times_s)
}

fn usable(speed: Option<f64>, what: &str) -> Result<f64, SceneError> {
    match speed {
        Some(speed) if speed.is_finite() && speed > 0.0 => Ok(speed),
        _ => rule(format!("{what} moves nothing that the camera sees; take another camera motion")),
    }
}

/// Mean depth of the points that show in the central half of the picture, else of all; `None` where there is none.
fn mean_depth(lens: &PixelLens, points: &[DVec3]) -> Option<f64> {
    let central: Vec<&DVec3> =
        points.iter().filter(|p| lens.sees(**p).is_some_and(|at| lens.is_central(at))).collect();
    let all: Vec<&DVec3> = if central.is_empty() { points.iter().collect() } else { central };
    (!all.is_empty()).then(|| all.iter().map(|p| -p.z).sum::<f64>() / all.len() as f64)
}

/// A rigid matrix as translation and rotation.
fn trs(matrix: &DMat4) -> Trs {
    let matrix = rigid(matrix).unwrap_or(*matrix);
    let (_, rotation, translation) = matrix.to_scale_rotation_translation();
    Trs { translation, rotation, scale: DVec3::ONE }
}

/// Four digits are enough for people.
fn short(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let digits = (3 - value.abs().log10().floor() as i32).clamp(0, 12) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

fn rule<T>(reason: String) -> Result<T, SceneError> {
    Err(SceneError::Rule(reason))
}
