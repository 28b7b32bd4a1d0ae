//! Prints a setting as lines of a TOML file.

use std::ffi::OsString;
use std::fmt::Write as _;

use super::error::SettingsError;
use super::kind::ValueKind;
use super::secret::{MASK, masked};
use super::{Setting, SettingOrigin, variable};

/// `key = value # origin`; a comment for a flag without value.
pub(super) fn lines(setting: &Setting) -> Result<String, SettingsError> {
    if setting.values.is_empty() {
        // The help text's own description of an absent value, if there is one.
        let absence = setting.help.split_once("Default: ").map_or("none", |(_, rest)| rest);
        let absence = absence.split_once(". ").map_or(absence, |(first, _)| first).trim_end_matches('.');
        return Ok(format!("# {} is not given: {}\n", setting.key, absence.replace('\n', " ")));
    }
    let text = |value: OsString| {
        value.into_string().map_err(|_| SettingsError::NotText { key: setting.key.clone() })
    };
    let mut hidden = false;
    let mut shown = |value: OsString| {
        let value = text(value)?;
        let shown = masked(&value, setting.address);
        hidden |= shown.contains(MASK);
        Ok(toml_value(setting.kind, &shown))
    };
    let values: Vec<String> = setting.absolute().map(&mut shown).collect::<Result<_, _>>()?;
    let value = if setting.several { format!("[{}]", values.join(", ")) } else { values.concat() };
    let origin = match &setting.origin {
        SettingOrigin::Default => "default".to_owned(),
        // A file name may contain any character; a TOML comment may not.
        SettingOrigin::File { path, line } => {
            format!("{}, line {line}", path.display().to_string().escape_debug())
        }
        SettingOrigin::Variable(_) => variable(&setting.key),
        SettingOrigin::Flag => format!("--{}", setting.key),
    };
    let remark = if hidden { "; write the secret in place of ***" } else { "" };
    Ok(format!("{} = {value} # {origin}{remark}\n", setting.key))
}

/// A value in TOML.
fn toml_value(kind: ValueKind, value: &str) -> String {
    match kind {
        ValueKind::Switch => value.to_owned(),
        ValueKind::Integer => value.trim_start_matches('+').to_owned(),
        // Rust's debug form of a number is valid TOML.
        ValueKind::Number => {
            value.parse::<f64>().map_or_else(|_| quoted(value), |number| format!("{number:?}"))
        }
        ValueKind::Text => quoted(value),
    }
}

/// A TOML basic string.
fn quoted(text: &str) -> String {
    let mut quoted = String::from('"');
    for c in text.chars() {
        match c {
            '"' | '\\' => quoted.extend(['\\', c]),
            c if c.is_control() => {
                let _ = write!(quoted, "\\u{:04X}", c as u32);
            }
            c => quoted.push(c),
        }
    }
    quoted + "\""
}
