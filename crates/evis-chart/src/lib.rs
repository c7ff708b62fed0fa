//! Speed against accuracy: a ladder of settings, each timed and each scored against truth, and what they look like.

mod axis;
mod canvas;
mod chart;
pub mod draw;
mod error;
pub mod front;
mod label;
pub mod ladder;
#[cfg(test)]
mod made_up;
mod marker;
pub mod measure;
pub mod result;

#[cfg(test)]
mod tests;

pub use chart::{ChartSettings, Progress, Stage, chart};
pub use draw::{Look, PictureKind};
pub use error::ChartError;
pub use ladder::{Ladder, Setting};
pub use result::{ChartResult, Goal, Lens, Measure, Point, Recommendation, SceneChart};
