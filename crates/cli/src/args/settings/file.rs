//! The settings file: TOML whose keys are the flags.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::{ArgAction, Command};
use toml::de::{DeTable, DeValue};
use veiloc_map::text::read_text;

use super::error::SettingsError;
use super::is_setting;
use super::kind::ValueKind;

/// Content of a settings file.
#[derive(Debug, Default)]
pub(super) struct SettingsFile {
    path: PathBuf,
    entries: BTreeMap<String, Entry>,
}

/// Value of one key.
#[derive(Debug)]
pub(super) struct Entry {
    pub(super) line: usize,
    pub(super) values: Vec<String>,
}

impl SettingsFile {
    pub(super) fn get(&self, key: &str) -> Option<&Entry> {
        self.entries.get(key)
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The folder that relative paths are relative to.
    pub(super) fn folder(&self) -> PathBuf {
        let absolute = std::path::absolute(&self.path).unwrap_or_else(|_| self.path.clone());
        absolute.parent().unwrap_or(Path::new("")).to_owned()
    }
}

/// Reads the file and checks it against the flags of `command`.
pub(super) fn read(path: &Path, command: &Command) -> Result<SettingsFile, SettingsError> {
    let text =
        read_text(path).map_err(|source| SettingsError::Unreadable { path: path.to_owned(), source })?;
    parse(&text, path, command)
}

pub(super) fn parse(text: &str, path: &Path, command: &Command) -> Result<SettingsFile, SettingsError> {
    // `get` instead of indexing: a wrong span of the TOML parser must not cause a panic.
    let line = |at: usize| 1 + text.get(..at).map_or(0, |before| before.matches('\n').count());
    let table = DeTable::parse(text).map_err(|error| SettingsError::Syntax {
        path: path.to_owned(),
        line: line(error.span().map_or(0, |span| span.start)),
        reason: error.message().lines().next().unwrap_or("this is not TOML").to_owned(),
    })?;
    let mut found = SettingsFile { path: path.to_owned(), entries: BTreeMap::new() };
    for (key, value) in table.get_ref() {
        let line = line(key.span().start);
        let key = key.get_ref().as_ref();
        let Some(argument) = command.get_arguments().find(|a| is_setting(a) && a.get_long() == Some(key))
        else {
            return Err(SettingsError::UnknownKey {
                path: path.to_owned(),
                line,
                key: key.to_owned(),
                remedy: suggestion(key, command),
            });
        };
        let kind = ValueKind::of(argument);
        let several = matches!(argument.get_action(), ArgAction::Append);
        let one = |value: &DeValue<'_>| {
            scalar(kind, value).ok_or_else(|| SettingsError::WrongType {
                path: path.to_owned(),
                line,
                key: key.to_owned(),
                found: type_name(value),
                expected: kind.expected(several).to_owned(),
            })
        };
        let values = match value.get_ref() {
            DeValue::Array(values) if several => {
                values.iter().map(|value| one(value.get_ref())).collect::<Result<_, _>>()?
            }
            value => vec![one(value)?],
        };
        found.entries.insert(key.to_owned(), Entry { line, values });
    }
    Ok(found)
}

/// Converts a value to the flag's text form; `None` if the type is wrong.
fn scalar(kind: ValueKind, value: &DeValue<'_>) -> Option<String> {
    match (kind, value) {
        (ValueKind::Switch, DeValue::Boolean(is_on)) => Some(is_on.to_string()),
        (ValueKind::Integer | ValueKind::Number, DeValue::Integer(number)) => {
            let digits = number.as_str();
            i64::from_str_radix(digits, number.radix()).ok().map(|number| number.to_string())
        }
        (ValueKind::Number, DeValue::Float(number)) => {
            number.as_str().parse::<f64>().ok().map(|number| number.to_string())
        }
        (ValueKind::Text, DeValue::String(text)) => Some(text.clone().into_owned()),
        _ => None,
    }
}

/// Describes a TOML type in words.
fn type_name(value: &DeValue<'_>) -> &'static str {
    match value {
        DeValue::String(_) => "a text",
        DeValue::Integer(_) => "a whole number",
        DeValue::Float(_) => "a number with a point",
        DeValue::Boolean(_) => "true or false",
        DeValue::Datetime(_) => "a date",
        DeValue::Array(_) => "a list",
        DeValue::Table(_) => "a section",
    }
}

/// Suggests a key for an unknown one.
fn suggestion(key: &str, command: &Command) -> String {
    let plain = |key: &str| key.to_lowercase().replace(['_', '-', ' '], "");
    let keys: Vec<&str> =
        command.get_arguments().filter(|a| is_setting(a)).filter_map(|a| a.get_long()).collect();
    let meant = keys.iter().find(|known| plain(known) == plain(key)).or_else(|| {
        let near = |known: &&&str| known.starts_with(key) || key.starts_with(**known);
        keys.iter().filter(near).min_by_key(|known| known.len().abs_diff(key.len()))
    });
    match meant {
        Some(known) => format!("did you mean `{known}`?"),
        None => format!(
            "the keys are the flags of `veiloc {} --help` without dashes before them",
            command.get_name()
        ),
    }
}
