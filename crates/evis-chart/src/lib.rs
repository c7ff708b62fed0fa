//! Speed against accuracy: a ladder of settings, each timed and each scored against truth, and what they look like.

mod cache;
mod chart;
pub mod compare;
pub mod draw;
mod error;
pub mod front;
pub mod ladder;
#[cfg(test)]
mod made_up;
pub mod measure;
mod panel;
mod plot;
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
