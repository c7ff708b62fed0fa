//! Errors of requests, with the names that settings have on the command line.

use evis_render::EngineError;

use crate::failure::bad_input;
use crate::options::refused;

/// `error` of a request, with options in place of fields.
pub(crate) fn named(error: EngineError) -> anyhow::Error {
    match error {
        EngineError::Config(error) => bad_input(refused(&error)),
        other => other.into(),
    }
}

#[cfg(test)]
mod tests {
    use evis_core::ConfigError;

    use super::*;

    #[test]
    fn messages_name_options() {
        let error =
            ConfigError::new("exposure_us", "5000 us", "left out, or given with `frame_rate_hz`, `x`");
        let told = named(error.into()).to_string();
        assert_eq!(told, "--exposure-ms is 5000 us; it must be left out, or given with --frame-rate, `x`");
        let scene = named(evis_scene::SceneError::Rule("`rate_hz`".into()).into()).to_string();
        assert!(scene.contains("`rate_hz`"), "what is no setting keeps its names: {scene}");
    }
}
