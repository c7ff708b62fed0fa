//! Speed against accuracy: a ladder of settings, each timed and each scored against truth, and what they look like.

mod axis;
mod cache;
mod canvas;
mod chart;
pub mod compare;
pub mod draw;
mod error;
pub mod front;
mod indexed;
mod ink;
mod label;
pub mod ladder;
#[cfg(test)]
mod made_up;
mod marker;
pub mod measure;
mod panel;
pub mod recommend;
pub mod result;
pub mod verify;

#[cfg(test)]
mod tests;

pub use cache::user_cache;
pub use chart::{ChartSettings, Progress, Stage, chart};
pub use draw::PictureKind;
pub use error::ChartError;
pub use ladder::{Ladder, LadderRequest, Setting};
pub use recommend::{Goal, Recommendation, shell_quoted};
pub use result::{ChartResult, Criteria, Measure, Point, SceneChart};
