//! placeholder
use crate::builder::SceneBuilder;
use crate::error::SceneError;
use crate::model::Scene;

pub(super) fn load(_seed: u64) -> Result<Scene, SceneError> {
    SceneBuilder::new("desk").build()
}
