//! Words that users write for values: one list for the command line, Python and messages.

use crate::error::ConfigError;
use crate::limits::nearest;

/// A value that users choose by a word.
pub trait Word: Copy + 'static {
    /// All of them, in the order in which help lists them.
    const ALL: &'static [Self];

    /// The word.
    fn word(self) -> &'static str;

    /// What it means, in a line.
    fn about(self) -> &'static str;

    /// The value of `word`, which is one of setting `what`.
    ///
    /// # Errors
    /// A word that is none; the message lists those that are, and the nearest.
    fn of_word(what: &str, word: &str) -> Result<Self, ConfigError> {
        Self::ALL.iter().copied().find(|value| value.word() == word).ok_or_else(|| {
            let known: Vec<_> = Self::ALL.iter().map(|value| value.word()).collect();
            unknown(what, word, &known)
        })
    }
}

/// The error of a word that is not among `known`.
pub(crate) fn unknown(what: &str, word: &str, known: &[&str]) -> ConfigError {
    let quoted: Vec<_> = known.iter().map(|word| format!("'{word}'")).collect();
    let hint = did_you_mean(word, known.iter().copied());
    ConfigError::new(what, format!("'{word}'"), format!("{}{hint}", quoted.join(" or ")))
}

/// ` (did you mean 'x'?)`, where one of `known` is near `word`.
pub fn did_you_mean<'w>(word: &str, known: impl Iterator<Item = &'w str>) -> String {
    nearest(word, known).map_or_else(String::new, |near| format!(" (did you mean '{near}'?)"))
}

/// Number of the line of `text` that byte `at` stands in, from 1.
pub fn line_of(text: &str, at: usize) -> usize {
    text.get(..at).unwrap_or(text).matches('\n').count() + 1
}

/// `message`, which serde gives of a text, with the nearest key where one is unknown.
pub fn of_serde(message: &str) -> String {
    let mut quoted = message.split('`').skip(1).step_by(2);
    match quoted.next() {
        Some(key) if message.starts_with("unknown field") => {
            let known: Vec<_> = quoted.collect();
            let hint = did_you_mean(key, known.iter().copied());
            let hint = if hint.is_empty() { format!("; it takes {}", known.join(", ")) } else { hint };
            format!("unknown key '{key}'{hint}")
        }
        _ => plain_types(&message.replace('`', "'")),
    }
}

/// `message` of serde, in which a type that a value should have is named as users name it.
fn plain_types(message: &str) -> String {
    let Some((before, wanted)) = message.rsplit_once("expected ") else { return message.to_owned() };
    let plain = match wanted {
        "f32" | "f64" => "a number",
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number, 0 or more",
        "i8" | "i16" | "i32" | "i64" => "a whole number",
        "a boolean" => "true or false",
        other => other,
    };
    format!("{before}expected {plain}")
}

/// Implements [`Word`] for an enum: variant, word, what it means.
#[macro_export]
macro_rules! words {
    ($type:ty { $($variant:expr => $word:literal, $about:literal;)+ }) => {
        impl $crate::words::Word for $type {
            const ALL: &'static [Self] = &[$($variant),+];

            fn word(self) -> &'static str {
                $(if self == $variant {
                    return $word;
                })+
                ""
            }

            fn about(self) -> &'static str {
                $(if self == $variant {
                    return $about;
                })+
                ""
            }
        }
    };
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::TriggerRule;

    #[test]
    fn types_are_named_as_users_name_them() {
        for (wanted, plain) in [("f32", "a number"), ("u64", "a whole number, 0 or more"), ("a map", "a map")]
        {
            let message = format!("invalid type: string \"a\", expected {wanted}");
            assert_eq!(of_serde(&message), format!("invalid type: string \"a\", expected {plain}"));
        }
        assert_eq!(of_serde("it ends early"), "it ends early");
    }

    #[test]
    fn words_are_those_that_files_have() {
        for rule in TriggerRule::ALL {
            assert_eq!(serde_json::to_value(rule).unwrap(), rule.word());
            assert_eq!(TriggerRule::of_word("trigger", rule.word()).unwrap(), *rule);
            assert!(!rule.about().is_empty());
        }
        let error = TriggerRule::of_word("trigger", "crosing").unwrap_err().to_string();
        assert!(error.contains("did you mean 'crossing'") && error.contains("'latch'"), "{error}");
    }
}
