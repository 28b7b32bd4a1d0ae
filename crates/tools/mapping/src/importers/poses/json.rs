//! JSON documents of other programs, with errors that name the field.

use std::path::Path;

use serde_json::Value;
use veiloc_geometry::nalgebra::Matrix4;

use super::posed_input::{faulty, text};
use crate::error::MappingError;

/// Reads a JSON document.
pub(super) fn document(path: &Path) -> Result<Value, MappingError> {
    serde_json::from_str(&text(path)?).map_err(|e| faulty(path, format!("is not JSON: {e}")))
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
