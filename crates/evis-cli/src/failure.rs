//! Which exit code an error deserves.

use std::io::ErrorKind;

use evis_chart::ChartError;
use evis_core::ConfigError;
use evis_core::format::FormatError;
use evis_render::EngineError;
use evis_truth::TruthError;
use evis_video::VideoError;

use crate::options;

/// Something that the user can put right: exit code 2.
#[derive(Debug)]
pub(crate) struct BadInput(String);

impl std::fmt::Display for BadInput {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for BadInput {}

/// An error that the user can put right.
pub(crate) fn bad_input(message: impl Into<String>) -> anyhow::Error {
    anyhow::Error::new(BadInput(message.into()))
}

/// The message with its causes, with options in place of settings. Library messages often quote their cause already; it is not
/// said twice.
pub(crate) fn describe(error: &anyhow::Error) -> String {
    let of_scene = error.chain().any(|cause| {
        cause.is::<evis_scene::SceneError>()
            || matches!(cause.downcast_ref(), Some(EngineError::Scene(_)))
            || matches!(cause.downcast_ref(), Some(TruthError::Scene(_)))
            || matches!(cause.downcast_ref(), Some(ChartError::Scene(_)))
    });
    let named = if of_scene { options::in_scene_text } else { options::in_text };
    let mut text = String::new();
    for cause in error.chain() {
        let cause = config_error(cause).map_or_else(|| named(&cause.to_string()), options::refused);
        if text.is_empty() {
            text = cause;
        } else if !text.contains(&cause) {
            text.push_str(": ");
            text.push_str(&cause);
        }
    }
    text
}

/// The refused setting, where `cause` is one.
fn config_error<'e>(cause: &'e (dyn std::error::Error + 'static)) -> Option<&'e ConfigError> {
    if let Some(EngineError::Config(error)) = cause.downcast_ref() {
        return Some(error);
    }
    if let Some(ChartError::Config(error)) = cause.downcast_ref() {
        return Some(error);
    }
    if let Some(TruthError::Config(error)) = cause.downcast_ref() {
        return Some(error);
    }
    if let Some(VideoError::Config(error)) = cause.downcast_ref() {
        return Some(error);
    }
    cause.downcast_ref()
}

/// 2 where the user can put it right (input, paths, space, devices), 1 otherwise.
pub(crate) fn exit_code(error: &anyhow::Error) -> i32 {
    if error.chain().any(is_bad_input) { 2 } else { 1 }
}

fn is_bad_input(cause: &(dyn std::error::Error + 'static)) -> bool {
    cause.is::<BadInput>()
        || cause.is::<ConfigError>()
        || cause.is::<evis_core::metric::MetricError>()
        || matches!(
            cause.downcast_ref(),
            Some(FormatError::Exists { .. } | FormatError::Corrupt { .. } | FormatError::Invalid { .. })
        )
        || cause.is::<evis_scene::SceneError>()
        // What was wrong with a frame lies within the error, which passes its message through.
        || match cause.downcast_ref() {
            Some(VideoError::Format(error)) => is_bad_input(error),
            Some(_) => true,
            None => false,
        }
        || matches!(cause.downcast_ref(), Some(TruthError::Config(_) | TruthError::Scene(_)))
        || matches!(
            cause.downcast_ref(),
            Some(
                ChartError::Config(_)
                    | ChartError::Scene(_)
                    | ChartError::Silent { .. }
                    | ChartError::Score(_)
                    | ChartError::Unreachable(_)
                    | ChartError::Invalid { .. }
            )
        )
        || match cause.downcast_ref() {
            Some(EngineError::Format(error)) => is_bad_input(error),
            Some(error) => {
                matches!(error, EngineError::Config(_) | EngineError::Scene(_) | EngineError::NoDevice)
            }
            None => false,
        }
        || cause.downcast_ref::<std::io::Error>().is_some_and(|io| {
            matches!(
                io.kind(),
                ErrorKind::NotFound
                    | ErrorKind::PermissionDenied
                    | ErrorKind::AlreadyExists
                    | ErrorKind::IsADirectory
                    | ErrorKind::NotADirectory
                    | ErrorKind::ReadOnlyFilesystem
                    | ErrorKind::StorageFull
                    | ErrorKind::QuotaExceeded
                    | ErrorKind::FileTooLarge
                    | ErrorKind::OutOfMemory
                    | ErrorKind::InvalidInput
            )
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::Context;

    #[test]
    fn a_cause_is_told_once() {
        let io = std::io::Error::other("disk on fire");
        let scene = evis_scene::SceneError::Io { path: "a.glb".into(), source: io };
        let error = anyhow::Error::new(scene).context("while loading");
        assert_eq!(describe(&error), "while loading: cannot read a.glb: disk on fire");
    }

    #[test]
    fn errors_name_options() {
        let exists = evis_core::format::FormatError::Exists { path: "a.h5".into() };
        let told = describe(&anyhow::Error::new(exists));
        assert_eq!(told, "a.h5 exists already; choose another name, or allow overwriting (--force)");
        let scene = evis_scene::SceneError::Rule("`start` is no key of a camera".into());
        assert_eq!(describe(&EngineError::Scene(scene).into()), "scene: `start` is no key of a camera");
    }

    #[test]
    fn what_the_user_can_put_right_exits_with_2() {
        let io = |kind| anyhow::Error::new(std::io::Error::from(kind)).context("cannot write x.h5");
        assert_eq!(exit_code(&bad_input("x")), 2);
        assert_eq!(exit_code(&Err::<(), _>(bad_input("x")).context("while").unwrap_err()), 2);
        assert_eq!(exit_code(&EngineError::Config(evis_core::ConfigError::new("a", 1, "2")).into()), 2);
        assert_eq!(exit_code(&io(ErrorKind::StorageFull)), 2);
        assert_eq!(exit_code(&io(ErrorKind::BrokenPipe)), 1);
        assert_eq!(exit_code(&EngineError::NoDevice.into()), 2);
        assert_eq!(exit_code(&EngineError::Device("lost".into()).into()), 1);
    }
}
