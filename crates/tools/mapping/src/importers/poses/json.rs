//! JSON documents of other programs, with errors that name the field.

use std::path::Path;

use serde_json::Value;
use veiloc_geometry::nalgebra::Matrix4;

use super::posed_input::{faulty, text};
use crate::error::MappingError;

/// Reads a JSON document. Numbers that are not finite, as Python writes them, become texts, which no reader takes for numbers.
///
/// # Errors
/// The place of what is not JSON.
pub(super) fn document(path: &Path) -> Result<Value, MappingError> {
    let content = text(path)?;
    serde_json::from_str(&content)
        .or_else(|error| serde_json::from_str(&with_quoted_words(&content)).map_err(|_| error))
        .map_err(|error| {
            let (line, column) = (error.line(), error.column());
            let message = error.to_string();
            let reason = message.rsplit_once(" at line ").map_or(message.as_str(), |(reason, _)| reason);
            faulty(path, format!("is not JSON: line {line} column {column}: {reason}"))
        })
}

/// The text with quotation marks around `NaN` and `Infinity`, with a sign or not, that are outside of texts.
fn with_quoted_words(content: &str) -> String {
    let mut quoted = String::with_capacity(content.len());
    let mut rest = content;
    let (mut in_text, mut is_escaped) = (false, false);
    while let Some(c) = rest.chars().next() {
        let word = ["NaN", "-NaN", "Infinity", "-Infinity"].into_iter().find(|word| rest.starts_with(word));
        if let Some(word) = word.filter(|_| !in_text) {
            quoted.extend(["\"", word, "\""]);
            rest = &rest[word.len()..];
            continue;
        }
        if c == '"' && !is_escaped {
            in_text = !in_text;
        }
        is_escaped = c == '\\' && !is_escaped;
        quoted.push(c);
        rest = &rest[c.len_utf8()..];
    }
    quoted
}

/// A value of a document, with its place for messages.
#[derive(Clone, Copy)]
pub(super) struct Json<'a> {
    pub(super) path: &'a Path,
    pub(super) value: &'a Value,
    /// The place in the document: `frames[3]`.
    pub(super) place: &'a str,
}

impl<'a> Json<'a> {
    pub(super) fn fault(&self, reason: impl std::fmt::Display) -> MappingError {
        let separator = if self.place.is_empty() { "" } else { ": " };
        faulty(self.path, format!("{}{separator}{reason}", self.place))
    }

    /// The number of a field; `None` if it is absent.
    pub(super) fn number(&self, key: &str) -> Result<Option<f64>, MappingError> {
        match self.value.get(key) {
            None | Some(Value::Null) => Ok(None),
            // instant-ngp's older scripts write numbers as text.
            Some(value) => value
                .as_f64()
                .or_else(|| value.as_str()?.trim().parse().ok())
                .filter(|number: &f64| number.is_finite())
                .map(Some)
                .ok_or_else(|| self.fault(format!("{key} is {value}, which is not a number"))),
        }
    }

    /// The number of a field that must be there.
    pub(super) fn needed(&self, key: &str) -> Result<f64, MappingError> {
        self.number(key)?.ok_or_else(|| self.fault(format!("{key} is missing")))
    }

    /// The text of a field that must be there.
    pub(super) fn text(&self, key: &str) -> Result<&'a str, MappingError> {
        let value = self.value.get(key).and_then(Value::as_str);
        value.ok_or_else(|| self.fault(format!("{key} is missing, or not a text")))
    }

    /// The numbers of a field, nested or not, row by row; `None` if it is absent.
    pub(super) fn numbers(&self, key: &str) -> Result<Option<Vec<f64>>, MappingError> {
        let Some(value) = self.value.get(key) else { return Ok(None) };
        let mut numbers = Vec::new();
        flatten(value, &mut numbers)
            .then_some(Some(numbers))
            .ok_or_else(|| self.fault(format!("{key} is not an array of finite numbers")))
    }

    /// Exactly `N` numbers of a field that must be there.
    pub(super) fn array<const N: usize>(&self, key: &str) -> Result<[f64; N], MappingError> {
        let numbers = self.numbers(key)?.ok_or_else(|| self.fault(format!("{key} is missing")))?;
        let found = numbers.len();
        numbers.try_into().map_err(|_| self.fault(format!("{key} has {found} numbers, and {N} are expected")))
    }

    /// A 4 × 4 matrix, or its first three rows, row by row.
    pub(super) fn matrix(&self, key: &str) -> Result<Option<Matrix4<f64>>, MappingError> {
        let Some(mut numbers) = self.numbers(key)? else { return Ok(None) };
        if numbers.len() == 12 {
            numbers.extend([0.0, 0.0, 0.0, 1.0]);
        }
        if numbers.len() != 16 {
            return Err(self.fault(format!("{key} is not a matrix of 3 × 4 or 4 × 4 numbers")));
        }
        Ok(Some(Matrix4::from_row_slice(&numbers)))
    }
}

/// Appends all numbers of nested arrays; false if something is no finite number.
fn flatten(value: &Value, numbers: &mut Vec<f64>) -> bool {
    match value {
        Value::Array(values) => values.iter().all(|value| flatten(value, numbers)),
        value => value.as_f64().filter(|n| n.is_finite()).map(|n| numbers.push(n)).is_some(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_of_python_is_read_and_other_faults_have_a_place() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let read = |content: &[u8]| {
            let path = folder.path().join("a.json");
            std::fs::write(&path, content).expect("written");
            document(&path).map_err(|error| error.to_string())
        };
        let value = read(br#"{"NaN": "\"NaN, -Infinity", "a": [NaN, -Infinity, 1]}"#).expect("JSON");
        assert_eq!(value["NaN"], "\"NaN, -Infinity");
        assert_eq!(value["a"], serde_json::json!(["NaN", "-Infinity", 1]));
        let json = Json { path: Path::new("a"), value: &value, place: "" };
        assert!(json.numbers("a").is_err());
        let utf16: Vec<u8> = "\u{feff}{\"a\": 1}".encode_utf16().flat_map(u16::to_le_bytes).collect();
        assert_eq!(read(&utf16).expect("JSON")["a"], 1);
        for (content, place) in [
            ("{\n \"a\": [1,]}", "a.json: is not JSON: line 2 column 10: trailing comma"),
            ("{\"a\": [NaN, 1}", "line 1 column 8"),
        ] {
            let error = read(content.as_bytes()).expect_err("no JSON");
            assert!(error.contains(place), "{error}");
        }
    }
}
