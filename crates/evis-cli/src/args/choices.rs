//! Words that options take: those of the values they stand for.

use std::marker::PhantomData;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Arg, Command, ValueEnum};
use evis_core::{LabelKind, Word};

/// Takes the words of `T`.
pub(super) fn words<T: Word + Send + Sync>() -> Words<T> {
    Words(PhantomData)
}

/// See [`words`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Words<T>(PhantomData<T>);

impl<T: Word + Send + Sync> Words<T> {
    fn known() -> Vec<PossibleValue> {
        T::ALL.iter().map(|value| PossibleValue::new(value.word()).help(value.about())).collect()
    }
}

impl<T: Word + Send + Sync> TypedValueParser for Words<T> {
    type Value = T;

    fn parse_ref(
        &self,
        command: &Command,
        arg: Option<&Arg>,
        value: &std::ffi::OsStr,
    ) -> Result<T, clap::Error> {
        let word = PossibleValuesParser::new(Self::known()).parse_ref(command, arg, value)?;
        T::of_word("value", &word)
            .map_err(|error| clap::Error::raw(clap::error::ErrorKind::InvalidValue, error.to_string()))
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(Self::known().into_iter()))
    }
}

/// Takes the words of labels.
pub(super) fn labels() -> PossibleValuesParser {
    PossibleValuesParser::new(LabelKind::WORDS.map(|(word, about)| PossibleValue::new(word).help(about)))
}

/// Tolerances that scores are made for.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum ToleranceArg {
    /// 0.1 ms, or 0.01 px of motion.
    #[value(name = "100us")]
    Us100,
    /// 0.3 ms, or 0.03 px of motion.
    #[value(name = "300us")]
    Us300,
    /// 1 ms, or 0.1 px of motion.
    #[value(name = "1ms")]
    Ms1,
}

impl ToleranceArg {
    /// In microseconds.
    pub(crate) const fn micros(self) -> i64 {
        match self {
            Self::Us100 => 100,
            Self::Us300 => 300,
            Self::Ms1 => 1000,
        }
    }
}

/// Background of the event picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Background {
    /// White; for paper.
    Light,
    /// Near black; for screens and slides.
    Dark,
}

#[cfg(test)]
mod tests {
    use evis_render::{Method, Quality};

    use super::*;

    #[test]
    fn words_are_taken_and_near_ones_suggested() {
        let command = Command::new("x")
            .arg(Arg::new("q").long("quality").value_parser(words::<Quality>()))
            .arg(Arg::new("m").long("method").value_parser(words::<Method>()));
        let of = |line: &str| command.clone().try_get_matches_from(line.split(' '));
        let taken = of("x --quality high --method evis-paper").unwrap();
        assert_eq!(taken.get_one::<Quality>("q"), Some(&Quality::High));
        assert_eq!(taken.get_one::<Method>("m").unwrap().name(), "evis-paper");
        let error = of("x --quality hihg").unwrap_err().to_string();
        assert!(error.contains("'hihg'") && error.contains("high") && error.contains("draft"), "{error}");
    }
}
