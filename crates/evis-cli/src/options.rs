//! Options of the command line that set what libraries call by other names.

use evis_core::ConfigError;

/// Fields of a request, and the options that set them.
const FLAGS: [(&str, &str); 35] = [
    ("animation", "--animation"),
    ("settings", "--settings"),
    ("sensor", "--sensor"),
    ("set", "--set"),
    ("quality", "--quality"),
    ("method", "--method"),
    ("rate_hz", "--rate"),
    ("adaptive_px", "--adaptive"),
    ("samples", "--samples"),
    ("antialias", "--antialias"),
    ("texture_taps", "--texture-taps"),
    ("shadows", "--shadows"),
    ("compute", "--compute"),
    ("shadow_map", "--shadow-map"),
    ("keyframe_hz", "--keyframe-rate"),
    ("steps", "--steps"),
    ("margin", "--margin"),
    ("audit", "--audit"),
    ("cameras", "--camera"),
    ("size", "--size"),
    ("start", "--start"),
    ("seed", "--seed"),
    ("labels", "--labels"),
    ("label_rate_hz", "--label-rate"),
    ("pose_rate_hz", "--pose-rate"),
    ("imu rate", "--imu-rate"),
    ("frame_rate_hz", "--frame-rate"),
    ("exposure_us", "--exposure-ms"),
    ("camera_motion", "--camera-motion"),
    ("camera_speed", "--camera-speed"),
    ("reference_luminance", "--reference-luminance"),
    ("threshold_on", "--threshold-on"),
    ("threshold_off", "--threshold-off"),
    ("log_eps", "--log-eps"),
    ("device", "--device"),
];

/// What concerns files, films and charts, and the options that say it. No scene has such keys.
const FILE_FLAGS: [(&str, &str); 12] = [
    ("output", "--output"),
    ("overwrite", "--force"),
    ("memory_limit", "--memory-limit"),
    ("allow_outside", "--allow-outside"),
    ("fps", "--fps"),
    ("timestamps", "--timestamps"),
    ("transfer", "--transfer"),
    ("upsampler", "--upsample"),
    ("events_only", "--events-only"),
    ("budget_ms", "--budget"),
    ("target_f1", "--target-f1"),
    ("rates_hz", "--rates"),
];

/// The option that sets a field of a request.
pub(crate) fn flag(field: &str) -> Option<&'static str> {
    FLAGS.iter().find(|(known, _)| *known == field).map(|(_, flag)| *flag)
}

/// `text` with options in place of the settings that it names between backticks.
pub(crate) fn in_text(text: &str) -> String {
    replaced(text, |field| flag(field).or_else(|| file_flag(field)))
}

/// The message of a setting that was refused, with options in place of what libraries call it.
pub(crate) fn refused(ConfigError { what, value, remedy }: &ConfigError) -> String {
    let what = flag(what).or_else(|| file_flag(what)).unwrap_or(what);
    format!("{what} is {value}; it must be {}", in_text(remedy))
}

/// `text` about a scene with options in place of [`FILE_FLAGS`]: all other names are keys of the scene.
pub(crate) fn in_scene_text(text: &str) -> String {
    replaced(text, file_flag)
}

fn file_flag(field: &str) -> Option<&'static str> {
    FILE_FLAGS.iter().find(|(known, _)| *known == field).map(|(_, flag)| *flag)
}

fn replaced(text: &str, flag: impl Fn(&str) -> Option<&'static str>) -> String {
    let part = |(index, part): (usize, &str)| match (index % 2, flag(part)) {
        (0, _) => part.to_owned(),
        (_, Some(flag)) => flag.to_owned(),
        (_, None) => format!("`{part}`"),
    };
    text.split('`').enumerate().map(part).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_flag_is_an_option_of_run() {
        let mut command = crate::args::help::command("evis-rs");
        command.build();
        let run = command.find_subcommand("run").unwrap();
        let known: Vec<_> = run.get_arguments().filter_map(|arg| arg.get_long()).collect();
        for (field, flag) in FLAGS {
            assert!(known.contains(&flag.trim_start_matches('-')), "{field}: {flag}");
        }
        assert!(!known.contains(&"rate-hz"), "canary");
        let subs = command.get_subcommands().flat_map(|sub| sub.get_arguments());
        let all: Vec<_> = subs.filter_map(|arg| arg.get_long()).collect();
        for (field, flag) in FILE_FLAGS {
            assert!(all.contains(&flag.trim_start_matches('-')), "{field}: {flag}");
        }
    }

    #[test]
    fn texts_name_options() {
        assert_eq!(
            in_text("raise `rate_hz`, or allow it (`overwrite`)"),
            "raise --rate, or allow it (--force)"
        );
        let error = ConfigError::new("target_f1", 2, "below `rate_hz`, or `other`");
        assert_eq!(refused(&error), "--target-f1 is 2; it must be below --rate, or `other`");
        let scene = in_scene_text("`rate_hz` is no key; `allow_outside` does so");
        assert_eq!(scene, "`rate_hz` is no key; --allow-outside does so");
    }
}
