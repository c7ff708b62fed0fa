//! Speed against accuracy: a ladder of settings, each timed and each scored against truth, and what they look like.

mod axis;
mod canvas;
pub mod draw;
mod error;
pub mod front;
mod label;
pub mod ladder;
#[cfg(test)]
mod made_up;
mod marker;
pub mod result;

#[cfg(test)]
mod tests;

pub use draw::{Look, PictureKind};
pub use error::ChartError;
pub use ladder::{Ladder, Setting};
pub use result::{ChartResult, Goal, Lens, Measure, Point, Recommendation, SceneChart};
