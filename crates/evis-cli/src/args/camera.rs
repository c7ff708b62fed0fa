//! `--camera-motion` and `--camera-speed`, of every command that simulates a scene, and `--animation`.

use clap::Args;
use evis_scene::camera_motion::check_speed;
use evis_scene::{CameraMotion, CameraMotionSettings};

/// What of a file plays.
#[derive(Debug, Default, Args)]
pub(crate) struct AnimationArgs {
    /// Animation of a glTF file to play, by name or number [default: the first]
    ///
    /// Numbers count from 0. `info` names the others of a file that has several.
    #[arg(long, value_name = "NAME", help_heading = "Scene", hide_short_help = true)]
    pub(crate) animation: Option<String>,
}

impl AnimationArgs {
    /// The flag, where it was given.
    pub(crate) fn given(&self) -> Option<&'static str> {
        self.animation.as_ref().map(|_| "--animation")
    }
}

/// How cameras move that the scene leaves at rest.
#[derive(Debug, Default, Args)]
pub(crate) struct CameraArgs {
    /// Move cameras that rest: none, orbit, dolly, shake or a file of poses
    ///
    /// orbit goes around the model, dolly to and fro, shake as a hand or an eye does. A file has rows of t x y z qx qy qz qw.
    /// [default: none; orbit for a file with neither a camera nor any motion; shake for a picture]
    #[arg(long, value_name = "MOTION", allow_hyphen_values = true, help_heading = "Scene")]
    pub(crate) camera_motion: Option<CameraMotion>,

    /// Mean image speed of that motion in pixels per second [default: 100]
    ///
    /// At the centre of the picture, of what the camera shows while it orbits, dollies or shakes.
    #[arg(long, value_name = "PX_PER_S", value_parser = speed, allow_hyphen_values = true, help_heading = "Scene", hide_short_help = true)]
    pub(crate) camera_speed: Option<f64>,
}

impl CameraArgs {
    /// The settings for views of `size` pixels, by the camera `camera`.
    pub(crate) fn settings(&self, size: Option<(u32, u32)>, camera: Option<&String>) -> CameraMotionSettings {
        CameraMotionSettings {
            motion: self.camera_motion.clone(),
            speed_px_per_s: self.camera_speed,
            camera: camera.cloned(),
            size,
        }
    }

    /// The first flag that was given.
    pub(crate) fn given(&self) -> Option<&'static str> {
        let motion = self.camera_motion.as_ref().map(|_| "--camera-motion");
        motion.or(self.camera_speed.map(|_| "--camera-speed"))
    }
}

fn speed(text: &str) -> Result<f64, String> {
    let speed = text
        .trim()
        .parse()
        .map_err(|_| "it must be a number of pixels per second, such as 100".to_owned())?;
    check_speed(speed)
}
