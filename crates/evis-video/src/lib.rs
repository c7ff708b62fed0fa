//! EVIS video: films, folders of pictures and arrays of frames become events.
//!
//! [`FrameSource`] gives frames and their times, whatever they come from; [`VideoStream`] puts a sensor behind it;
//! [`convert`] writes what that fires to a recording. Memory does not depend on how long it lasts.

mod convert;
mod error;
mod ffmpeg;
mod folder;
mod npy;
mod picture;
mod source;
mod times;

pub use convert::{FrameEvents, Progress, Upsampler, VideoConfig, VideoReport, VideoStream, convert};
pub use error::VideoError;
pub use ffmpeg::FFMPEG_VARIABLE;
pub use picture::{Picture, Values};
pub use source::{FrameSource, SourceConfig, TimedFrame, clock_of, name as transfer_name, transfer};
pub use times::{Clock, Times, read_times};
