//! What a flag takes: its type in TOML, the check of a value, and where in it a path is.

use std::any::TypeId;
use std::error::Error as _;
use std::ffi::{OsStr, OsString};
use std::num::{NonZeroU32, NonZeroUsize};
use std::path::Path;

use clap::{Arg, ArgAction, Command};

use super::error::SettingsError;
use super::{Origin, alone, joined};

/// The type of a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// On or off.
    Switch,
    Integer,
    /// With or without decimal point.
    Number,
    Text,
}

impl Kind {
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

    /// In words, with an example.
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

/// A switch as a variable may say it.
pub(super) fn fit(value: &OsStr) -> OsString {
    match value.to_str() {
        Some("1") => "true".into(),
        Some("0") => "false".into(),
        _ => value.to_owned(),
    }
}

/// Whether the flag takes this value, asked of the flag itself.
pub(super) fn check(argument: &Arg, kind: Kind, value: &OsStr, origin: &Origin) -> Result<(), SettingsError> {
    let wrong = |reason: String| {
        let place = match origin {
            Origin::File { path, line } => format!("{}, line {line}", path.display()),
            Origin::Variable(name) => name.clone(),
            Origin::Flag | Origin::Default => "the command line".to_owned(),
        };
        let key = argument.get_long().unwrap_or_default().to_owned();
        SettingsError::Value { place, key, reason }
    };
    if kind == Kind::Switch {
        let known = ["true", "false"].iter().any(|known| fit(value) == *known);
        return if known { Ok(()) } else { Err(wrong("`true` or `false` is expected".to_owned())) };
    }
    let mut word = OsString::from(format!("--{}=", argument.get_long().unwrap_or_default()));
    word.push(value);
    let command = Command::new("").no_binary_name(true).disable_help_flag(true).arg(alone(argument.clone()));
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

/// Whether the value is an address, or several, by what it is called in the help.
pub(super) fn is_address(argument: &Arg) -> bool {
    argument.get_value_names().is_some_and(|names| names.iter().any(|name| name.contains("URL")))
}

/// Where in a value a path is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Paths {
    Nowhere,
    /// All of it.
    Whole,
    /// Behind `NAME=`.
    Named,
    /// Behind `unix:`, if it begins with that.
    Socket,
}

impl Paths {
    /// By what the value is called in the help.
    pub(super) fn of(argument: &Arg) -> Self {
        let name =
            argument.get_value_names().and_then(|names| names.first()).map_or("", |name| name.as_str());
        match name {
            "FILE" | "DIR" => Self::Whole,
            "NAME=FILE" => Self::Named,
            name if name.contains("unix:") => Self::Socket,
            _ => Self::Nowhere,
        }
    }

    /// The value with its path joined to a folder, unless it is absolute.
    pub(super) fn join(self, base: &Path, value: &OsStr) -> OsString {
        let behind = |separator: char, text: &str| match text.split_once(separator) {
            Some((name, path)) if !path.is_empty() => {
                let mut value = OsString::from(format!("{name}{separator}"));
                value.push(joined(base, Path::new(path)));
                value
            }
            _ => text.into(),
        };
        match (self, value.to_str()) {
            (Self::Whole, _) if !value.is_empty() => joined(base, Path::new(value)).into(),
            (Self::Named, Some(text)) => behind('=', text),
            (Self::Socket, Some(text)) if text.starts_with("unix:") => behind(':', text),
            _ => value.to_owned(),
        }
    }
}
