//! The value of a flag: its TOML type, its check, and the position of a path in it.

use std::any::TypeId;
use std::error::Error as _;
use std::ffi::{OsStr, OsString};
use std::num::{NonZeroU32, NonZeroUsize};
use std::path::Path;

use clap::{Arg, ArgAction, Command};

use super::error::SettingsError;
use super::{SettingOrigin, resolve_path, unconstrained};

/// The type of a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ValueKind {
    /// On or off.
    Switch,
    Integer,
    /// A number with or without decimal point.
    Number,
    Text,
}

impl ValueKind {
    pub(super) fn of(argument: &Arg) -> Self {
        if matches!(argument.get_action(), ArgAction::SetTrue) {
            return Self::Switch;
        }
        let of = argument.get_value_parser().type_id();
        let integers = [
            TypeId::of::<u16>(),
            TypeId::of::<u32>(),
            TypeId::of::<u64>(),
            TypeId::of::<usize>(),
            TypeId::of::<NonZeroU32>(),
            TypeId::of::<NonZeroUsize>(),
        ];
        if integers.iter().any(|integer| of == *integer) {
            Self::Integer
        } else if of == TypeId::of::<f64>() || of == TypeId::of::<f32>() {
            Self::Number
        } else {
            Self::Text
        }
    }

    /// Describes the type in words, with an example.
    pub(super) const fn expected(self, several: bool) -> &'static str {
        match (self, several) {
            (Self::Switch, _) => "`true` or `false`",
            (Self::Integer, _) => "a whole number, such as `8`",
            (Self::Number, _) => "a number, such as `2.5`",
            (Self::Text, false) => "a text in quotation marks, such as `\"name\"`",
            (Self::Text, true) => "a list of texts, such as `[\"one\", \"two\"]`",
        }
    }
}

/// Normalizes the value of a switch in a variable.
pub(super) fn normalize(value: &OsStr) -> OsString {
    match value.to_str() {
        Some("1") => "true".into(),
        Some("0") => "false".into(),
        _ => value.to_owned(),
    }
}

/// Checks the value with the flag's own parser.
pub(super) fn check(
    argument: &Arg,
    kind: ValueKind,
    value: &OsStr,
    origin: &SettingOrigin,
) -> Result<(), SettingsError> {
    let wrong = |reason: String| {
        let location = match origin {
            SettingOrigin::File { path, line } => format!("{}, line {line}", path.display()),
            SettingOrigin::Variable(name) => name.clone(),
            SettingOrigin::Flag | SettingOrigin::Default => "the command line".to_owned(),
        };
        let key = argument.get_long().unwrap_or_default().to_owned();
        SettingsError::Value { location, key, reason }
    };
    if kind == ValueKind::Switch {
        let known = ["true", "false"].iter().any(|known| normalize(value) == *known);
        return if known { Ok(()) } else { Err(wrong("`true` or `false` is expected".to_owned())) };
    }
    let mut word = OsString::from(format!("--{}=", argument.get_long().unwrap_or_default()));
    word.push(value);
    let command =
        Command::new("").no_binary_name(true).disable_help_flag(true).arg(unconstrained(argument.clone()));
    match command.try_get_matches_from([word]) {
        Ok(_) => Ok(()),
        Err(error) => {
            let possible: Vec<String> =
                argument.get_possible_values().iter().map(|value| value.get_name().to_owned()).collect();
            Err(wrong(match error.source() {
                Some(source) => source.to_string(),
                None if possible.is_empty() => "a value is expected".to_owned(),
                None => format!("one of {} is expected", possible.join(", ")),
            }))
        }
    }
}

/// Returns whether the value is one or several addresses, judged by its value name in the help.
pub(super) fn is_address(argument: &Arg) -> bool {
    argument.get_value_names().is_some_and(|names| names.iter().any(|name| name.contains("URL")))
}

/// The position of a path in a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PathPosition {
    NoPath,
    /// The whole value is a path.
    Whole,
    /// The path follows `NAME=`.
    Named,
    /// The path follows the prefix `unix:`.
    Socket,
}

impl PathPosition {
    /// Derives it from the value name in the help.
    pub(super) fn of(argument: &Arg) -> Self {
        let name =
            argument.get_value_names().and_then(|names| names.first()).map_or("", |name| name.as_str());
        match name {
            "FILE" | "DIR" => Self::Whole,
            "NAME=FILE" => Self::Named,
            name if name.contains("unix:") => Self::Socket,
            _ => Self::NoPath,
        }
    }

    /// Resolves the path in the value against a folder, unless it is absolute.
    pub(super) fn join(self, base: &Path, value: &OsStr) -> OsString {
        let resolve_after = |separator: char, text: &str| match text.split_once(separator) {
            Some((name, path)) if !path.is_empty() => {
                let mut value = OsString::from(format!("{name}{separator}"));
                value.push(resolve_path(base, Path::new(path)));
                value
            }
            _ => text.into(),
        };
        match (self, value.to_str()) {
            (Self::Whole, _) if !value.is_empty() => resolve_path(base, Path::new(value)).into(),
            (Self::Named, Some(text)) => resolve_after('=', text),
            (Self::Socket, Some(text)) if text.starts_with("unix:") => resolve_after(':', text),
            _ => value.to_owned(),
        }
    }
}
