//! Reads a TOML table key by key: wrong types, missing and unknown keys are told with their place.

use std::path::{Path, PathBuf};

use evis_limits::nearest;
use toml::de::{DeTable, DeValue};
use toml::{Spanned, Table, Value};

use crate::error::SceneError;
use crate::procedural::srgb;

/// Where the text came from.
pub(super) struct Source<'a> {
    /// Name of the file, for messages.
    pub file: &'a Path,
    /// Folder that relative paths start from.
    pub base: &'a Path,
    /// All of it.
    pub text: &'a str,
}

/// A table of the file.
#[derive(Clone, Debug, Default)]
pub(super) struct Place {
    /// How messages name it; empty for the file itself.
    at: String,
    /// The way to it.
    path: Vec<Step>,
}

#[derive(Clone, Debug)]
enum Step {
    Key(String),
    /// Number of a table under `[[…]]`.
    Number(usize),
}

impl Place {
    fn under(&self, at: String, steps: impl IntoIterator<Item = Step>) -> Self {
        Self { at, path: self.path.iter().cloned().chain(steps).collect() }
    }
}

impl Source<'_> {
    /// What is wrong in a table, with the line of the first of its keys that `reason` names; of the table where it names none.
    pub fn error(&self, place: &Place, reason: impl AsRef<str>) -> SceneError {
        self.error_about(place, place, reason.as_ref())
    }

    /// As [`Source::error`], where the message names `place` itself.
    fn error_about(&self, place: &Place, named: &Place, reason: &str) -> SceneError {
        let line = self.line(place, reason).map_or_else(String::new, |line| format!("line {line}: "));
        let separator = if named.at.is_empty() { "" } else { ": " };
        SceneError::invalid(self.file, format!("{line}{}{separator}{reason}", named.at))
    }

    /// From 1. The text is parsed once more, for errors alone.
    fn line(&self, place: &Place, reason: &str) -> Option<usize> {
        let whole = DeTable::parse(self.text).ok()?;
        let (mut table, mut start) = (whole.get_ref(), None);
        let mut steps = place.path.iter();
        while let Some(step) = steps.next() {
            let Step::Key(key) = step else { return None };
            let (key, value) = table.get_key_value(key.as_str())?;
            let value = match value.get_ref() {
                DeValue::Array(list) => match steps.next() {
                    Some(Step::Number(number)) => list.get(*number)?,
                    _ => return None,
                },
                _ => value,
            };
            table = value.get_ref().as_table()?;
            start = Some(first_of(table, value.span().start, key.span().start));
        }
        // Remedies name other keys.
        let cause = reason.split(';').next().unwrap_or_default();
        // Rules about the whole scene name an object.
        let object = if place.path.is_empty() { object_in(table, cause) } else { None };
        if let Some((of, from)) = object {
            (table, start) = (of, Some(from));
        }
        let at = key_in(table, cause).or(start)?;
        Some(self.text.get(..at)?.matches('\n').count() + 1)
    }
}

/// Where a table begins: a table under `[[…]]` at its header, one that is written in place at its brace, and one whose keys have
/// dots at its key.
fn first_of(table: &DeTable<'_>, own: usize, key: usize) -> usize {
    let first = table.keys().map(|key| key.span().start).min().unwrap_or(own);
    if own <= first && own > 0 { own } else { key }
}

/// Where the first key is that `cause` names: of this table, or else of those in it.
fn key_in(table: &DeTable<'_>, cause: &str) -> Option<usize> {
    let mut words =
        cause.split(|c: char| !(c.is_alphanumeric() || c == '_' || c == '-')).filter(|w| !w.is_empty());
    let own = words.find_map(|word| table.get_key_value(word));
    let value_named = || {
        let quoted = |value: &Spanned<DeValue<'_>>| {
            value.get_ref().as_str().is_some_and(|text| cause.contains(&format!("'{text}'")))
        };
        // The name of the object itself says nothing.
        table.iter().find(|(key, value)| key.get_ref() != "name" && quoted(value))
    };
    let found = own.or_else(value_named).map(|(key, _)| key.span().start);
    found.or_else(|| table.values().filter_map(|v| v.get_ref().as_table()).find_map(|t| key_in(t, cause)))
}

/// The object of the file whose name `cause` quotes first, and where it begins.
fn object_in<'t, 'i>(whole: &'t DeTable<'i>, cause: &str) -> Option<(&'t DeTable<'i>, usize)> {
    let lists = whole.values().filter_map(|value| match value.get_ref() {
        DeValue::Array(list) => Some(list),
        _ => None,
    });
    let tables = lists.flat_map(|list| list.iter()).filter_map(|value| {
        let table = value.get_ref().as_table()?;
        let name = table.get("name")?.get_ref().as_str()?;
        Some((cause.find(&format!("'{name}'"))?, table, value.span().start))
    });
    tables.min_by_key(|(at, ..)| *at).map(|(_, table, start)| (table, start))
}

/// A table while it is read. [`Keys::finish`] refuses what nobody asked for.
pub(super) struct Keys<'a> {
    source: &'a Source<'a>,
    table: &'a Table,
    place: Place,
    asked: Vec<&'static str>,
}

impl<'a> Keys<'a> {
    /// Of a whole file.
    pub fn new(source: &'a Source<'a>, table: &'a Table) -> Self {
        Self::of(source, table, Place::default())
    }

    fn of(source: &'a Source<'a>, table: &'a Table, place: Place) -> Self {
        Self { source, table, place, asked: Vec::new() }
    }

    pub fn error(&self, reason: impl AsRef<str>) -> SceneError {
        self.source.error(&self.place, reason)
    }

    /// Puts the place before what a builder had to say.
    pub fn locate(&self, error: SceneError) -> SceneError {
        locate(self.source, &self.place, error)
    }

    pub fn place(&self) -> &Place {
        &self.place
    }

    pub fn at(&self) -> &str {
        &self.place.at
    }

    /// The file's name, for messages.
    pub fn file_name(&self) -> std::path::Display<'a> {
        self.source.file.display()
    }

    /// Folder that relative paths start from.
    pub fn base(&self) -> &'a Path {
        self.source.base
    }

    pub fn get(&mut self, key: &'static str) -> Option<&'a Value> {
        if !self.asked.contains(&key) {
            self.asked.push(key);
        }
        self.table.get(key)
    }

    pub fn has(&mut self, key: &'static str) -> bool {
        self.get(key).is_some()
    }

    fn read<T>(
        &mut self,
        key: &'static str,
        takes: &str,
        convert: impl FnOnce(&'a Value) -> Option<T>,
    ) -> Result<Option<T>, SceneError> {
        let Some(value) = self.get(key) else { return Ok(None) };
        match convert(value) {
            Some(converted) => Ok(Some(converted)),
            None => Err(self.error(format!("{key} is {}; it takes {takes}", shown(value)))),
        }
    }

    pub fn number(&mut self, key: &'static str) -> Result<Option<f64>, SceneError> {
        self.read(key, "a number", number)
    }

    pub fn number_or(&mut self, key: &'static str, default: f64) -> Result<f64, SceneError> {
        Ok(self.number(key)?.unwrap_or(default))
    }

    pub fn numbers<const N: usize>(&mut self, key: &'static str) -> Result<Option<[f64; N]>, SceneError> {
        self.read(key, &format!("{N} numbers in brackets"), numbers)
    }

    /// A list of rows of `N` numbers.
    pub fn rows<const N: usize>(&mut self, key: &'static str) -> Result<Option<Vec<[f64; N]>>, SceneError> {
        let takes = format!("a list of lists of {N} numbers");
        self.read(key, &takes, |v| v.as_array()?.iter().map(numbers).collect())
    }

    pub fn list(&mut self, key: &'static str) -> Result<Option<Vec<f64>>, SceneError> {
        self.read(key, "a list of numbers", |v| v.as_array()?.iter().map(number).collect())
    }

    pub fn integer(&mut self, key: &'static str, max: u64) -> Result<Option<u64>, SceneError> {
        self.integer_or_else(key, max, &format!("a whole number between 0 and {max}"))
    }

    /// The same, where messages say that it takes something else too.
    pub fn integer_or_else(
        &mut self,
        key: &'static str,
        max: u64,
        takes: &str,
    ) -> Result<Option<u64>, SceneError> {
        self.read(key, takes, |v| whole(v, max))
    }

    /// Two whole numbers that fit 32 bits.
    pub fn pair(&mut self, key: &'static str) -> Result<Option<[u32; 2]>, SceneError> {
        self.read(key, "two whole numbers in brackets", |v| match v.as_array()?.as_slice() {
            [a, b] => Some([u32::try_from(a.as_integer()?).ok()?, u32::try_from(b.as_integer()?).ok()?]),
            _ => None,
        })
    }

    pub fn flag(&mut self, key: &'static str) -> Result<Option<bool>, SceneError> {
        self.read(key, "true or false", Value::as_bool)
    }

    pub fn text(&mut self, key: &'static str) -> Result<Option<&'a str>, SceneError> {
        self.read(key, "a text in quotes", Value::as_str)
    }

    /// A list of texts.
    pub fn texts(&mut self, key: &'static str) -> Result<Option<Vec<String>>, SceneError> {
        self.read(key, "a list of texts in quotes", |v| {
            v.as_array()?.iter().map(|text| text.as_str().map(str::to_owned)).collect()
        })
    }

    /// Linear RGB, or an sRGB colour as "#rrggbb".
    pub fn color(&mut self, key: &'static str) -> Result<Option<[f32; 3]>, SceneError> {
        self.read(key, "three linear numbers in brackets, or an sRGB colour as \"#rrggbb\"", color)
    }

    pub fn colors(&mut self, key: &'static str) -> Result<Option<[[f32; 3]; 2]>, SceneError> {
        self.read(key, "two colours, each three linear numbers or \"#rrggbb\"", |v| {
            match v.as_array()?.as_slice() {
                [a, b] => Some([color(a)?, color(b)?]),
                _ => None,
            }
        })
    }

    /// One of a few words.
    pub fn choice<T: Copy>(
        &mut self,
        key: &'static str,
        options: &[(&str, T)],
    ) -> Result<Option<T>, SceneError> {
        let words: Vec<_> = options.iter().map(|(word, _)| format!("\"{word}\"")).collect();
        let takes = format!("one of {}", words.join(", "));
        let near =
            self.get(key).and_then(Value::as_str).and_then(|w| nearest(w, options.iter().map(|(o, _)| *o)));
        let takes = near.map_or(takes.clone(), |near| format!("{takes} (did you mean \"{near}\"?)"));
        self.read(key, &takes, |v| {
            let word = v.as_str()?;
            options.iter().find(|(option, _)| *option == word).map(|(_, value)| *value)
        })
    }

    /// A path, made absolute by the scene file's folder.
    pub fn file(&mut self, key: &'static str) -> Result<Option<PathBuf>, SceneError> {
        let base = self.source.base;
        self.read(key, "a path in quotes", |v| v.as_str().filter(|p| !p.is_empty()).map(|p| base.join(p)))
    }

    pub fn table(&mut self, key: &'static str) -> Result<Option<Keys<'a>>, SceneError> {
        let table = self.read(key, "a table", Value::as_table)?;
        let at = if self.at().is_empty() { format!("[{key}]") } else { format!("{}, {key}", self.at()) };
        let place = self.place.under(at, [Step::Key(key.into())]);
        Ok(table.map(|table| Keys::of(self.source, table, place)))
    }

    /// The tables of `[[key]]`, each named by its number, or its `name` where it has one.
    pub fn tables(&mut self, key: &'static str) -> Result<Vec<Keys<'a>>, SceneError> {
        let takes = format!("tables, each under [[{key}]]");
        let tables = self
            .read(key, &takes, |v| v.as_array()?.iter().map(Value::as_table).collect::<Option<Vec<_>>>())?;
        let prefix =
            if self.at().is_empty() { format!("[[{key}]]") } else { format!("{}, {key}", self.at()) };
        let named = |(i, table): (usize, &'a Table)| {
            let at = match table.get("name").and_then(Value::as_str) {
                Some(name) => format!("{prefix} '{name}'"),
                None => format!("{prefix} number {}", i + 1),
            };
            Keys::of(self.source, table, self.place.under(at, [Step::Key(key.into()), Step::Number(i)]))
        };
        Ok(tables.unwrap_or_default().into_iter().enumerate().map(named).collect())
    }

    /// Every key with its table, for tables whose keys are names of the user's.
    pub fn named_tables(&mut self, key: &'static str) -> Result<Vec<(&'a str, Keys<'a>)>, SceneError> {
        let Some(outer) = self.table(key)? else { return Ok(Vec::new()) };
        let each = outer.table.iter().map(|(name, value)| match value.as_table() {
            Some(table) => {
                let at = format!("{} '{name}'", outer.at());
                let place = outer.place.under(at, [Step::Key(name.clone())]);
                Ok((name.as_str(), Keys::of(self.source, table, place)))
            }
            None => Err(outer.error(format!("{name} is {}; it takes a table", shown(value)))),
        });
        each.collect()
    }

    /// Every key with its whole number, for tables whose keys are names of the user's.
    pub fn named_integers(&mut self, key: &'static str, max: u64) -> Result<Vec<(&'a str, u64)>, SceneError> {
        let Some(outer) = self.table(key)? else { return Ok(Vec::new()) };
        let each = outer.table.iter().map(|(name, value)| {
            let number = whole(value, max).ok_or_else(|| {
                let value = shown(value);
                outer.error(format!("{name} is {value}; it takes a whole number between 0 and {max}"))
            })?;
            Ok((name.as_str(), number))
        });
        each.collect()
    }

    /// Unwraps a key that must be there.
    pub fn needs<T>(&self, key: &'static str, value: Option<T>) -> Result<T, SceneError> {
        value.ok_or_else(|| {
            let unread = self.table.keys().filter(|k| !self.asked.contains(&k.as_str()));
            let near = nearest(key, unread.map(String::as_str));
            let hint =
                near.map_or_else(String::new, |near| format!(" (there is '{near}': did you mean '{key}'?)"));
            self.error(format!("the key '{key}' is missing{hint}"))
        })
    }

    /// Refuses keys that exclude each other.
    pub fn at_most_one(&mut self, keys: &[&'static str]) -> Result<(), SceneError> {
        let given: Vec<_> = keys.iter().filter(|key| self.has(key)).copied().collect();
        if given.len() > 1 {
            return Err(self.error(format!("{} exclude each other; give one of them", given.join(" and "))));
        }
        Ok(())
    }

    /// Refuses keys that nobody asked for.
    pub fn finish(self) -> Result<(), SceneError> {
        let Some(unknown) = self.table.keys().find(|key| !self.asked.contains(&key.as_str())) else {
            return Ok(());
        };
        let place =
            if self.at().is_empty() { "at the top level".to_owned() } else { format!("in {}", self.at()) };
        let help = match nearest(unknown, self.asked.iter().copied()) {
            Some(near) => format!("did you mean '{near}'?"),
            None => format!("it takes {}", self.asked.join(", ")),
        };
        let reason = format!("unknown key '{unknown}' {place}; {help}");
        Err(self.source.error_about(&self.place, &Place::default(), &reason))
    }
}

/// Puts the place before what a builder had to say; other files' errors name their own place.
pub(super) fn locate(source: &Source<'_>, place: &Place, error: SceneError) -> SceneError {
    match error {
        SceneError::Rule(message) => {
            // The builder starts with the object's name, which `at` ends with.
            let message = match message.split_once(": ") {
                Some((name, rest)) if place.at.ends_with(name) => rest,
                _ => &message,
            };
            source.error(place, message)
        }
        unknown @ SceneError::Unknown { .. } => source.error(place, unknown.to_string()),
        other => other,
    }
}

fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Integer(i) => Some(*i as f64),
        Value::Float(f) => Some(*f),
        _ => None,
    }
}

fn whole(value: &Value, max: u64) -> Option<u64> {
    u64::try_from(value.as_integer()?).ok().filter(|n| *n <= max)
}

fn numbers<const N: usize>(value: &Value) -> Option<[f64; N]> {
    let list: Option<Vec<f64>> = value.as_array()?.iter().map(number).collect();
    list?.try_into().ok()
}

fn color(value: &Value) -> Option<[f32; 3]> {
    if let Some(text) = value.as_str() {
        let digits =
            text.strip_prefix('#').filter(|d| d.len() == 6 && d.bytes().all(|b| b.is_ascii_hexdigit()))?;
        return u32::from_str_radix(digits, 16).ok().map(srgb);
    }
    numbers::<3>(value).map(|c| c.map(|v| v as f32))
}

/// A value as a message shows it: short.
fn shown(value: &Value) -> String {
    let text = value.to_string();
    if text.chars().count() <= 60 {
        return text;
    }
    format!("{}…", text.chars().take(57).collect::<String>())
}
