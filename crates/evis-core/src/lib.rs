//! EVIS core: events, time, sensor, trigger and file formats. Pure Rust, no GPU, no Python.
//!
//! Public time is integer microseconds (`i64`) since the stream's start; `x` runs right and `y` down
//! from the top-left pixel; polarity is ON = 1, OFF = 0.

pub mod closed_form;
pub mod emulator;
mod error;
pub mod event;
pub mod fnv;
pub mod format;
pub mod luminance;
pub mod metric;
pub mod packet;
pub mod random;
pub mod sensor;
mod simd;
pub mod stats;
pub mod time;
pub mod trigger;
pub mod truth;
pub mod words;

pub use emulator::{
    EmulatorConfig, EmulatorReport, EventEmulator, FrameData, Frames, KeyframeReport, Keyframes, MotionCheck,
    Transfer, Warp, WarpVariant, check_motion,
};
pub use event::{Cause, Event, Polarity};
pub use evis_limits as limits;
pub use packet::{CameraInfo, ImuSample, LabelData, LabelFrame, LabelKind, LensDistortion, PoseSample};
pub use sensor::{ConfigError, Exposure, Sensor, SensorConfig, Times, TriggerRule};
pub use time::TimeGrid;
pub use truth::{Region, RegionSpan, Truth};
pub use words::Word;
