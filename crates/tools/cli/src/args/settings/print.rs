//! A setting as lines of a file.

use std::ffi::OsString;
use std::fmt::Write as _;

use super::error::SettingsError;
use super::kind::Kind;
use super::secret::{MASK, masked};
use super::{Origin, Setting, variable};

/// `key = value # where from`; of a flag without value a comment.
pub(super) fn lines(setting: &Setting) -> Result<String, SettingsError> {
    if setting.values.is_empty() {
        // What the help says of its absence, if it does.
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
        Ok(written(setting.kind, &shown))
    };
    let values: Vec<String> = setting.absolute().map(&mut shown).collect::<Result<_, _>>()?;
    let value = if setting.several { format!("[{}]", values.join(", ")) } else { values.concat() };
    let origin = match &setting.origin {
        Origin::Default => "default".to_owned(),
        // A name of a file may hold anything, a comment of TOML not.
        Origin::File { path, line } => format!("{}, line {line}", path.display().to_string().escape_debug()),
        Origin::Variable(_) => variable(&setting.key),
        Origin::Flag => format!("--{}", setting.key),
    };
    let remark = if hidden { "; write the secret in place of ***" } else { "" };
    Ok(format!("{} = {value} # {origin}{remark}\n", setting.key))
}

/// A value in TOML.
fn written(kind: Kind, value: &str) -> String {
    match kind {
        Kind::Switch => value.to_owned(),
        Kind::Integer => value.trim_start_matches('+').to_owned(),
        // Rust's own form of a number is one of TOML's.
        Kind::Number => value.parse::<f64>().map_or_else(|_| quoted(value), |number| format!("{number:?}")),
        Kind::Text => quoted(value),
    }
}

/// A basic string of TOML.
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
