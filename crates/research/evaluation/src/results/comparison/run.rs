//! A run to compare, read from the document of `eval scene` or `eval pose`.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde_json::Value;

use crate::EvalError;
use crate::results::metrics::{PoseErrors, Threshold};

/// Commands whose documents can be compared.
const COMMANDS: [&str; 5] = ["eval scene", "eval pose", "eval 7scenes", "eval cambridge", "eval aachen"];

/// Name and seed.
type Key = (String, u64);

/// Queries of one row of a run's table.
pub(super) type Row = BTreeMap<Key, Query>;

/// Result of one query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Query {
    pub(super) error: PoseErrors,
    /// Total time of all stages.
    pub(super) ms: f64,
}

/// Results of an evaluation, read from its document.
#[derive(Debug, Clone)]
pub struct Run {
    pub(super) data: Vec<String>,
    /// Translation and degrees, as in the document's own recall.
    pub(super) thresholds: Vec<Threshold>,
    /// Rows by their display names.
    pub(super) rows: BTreeMap<String, Row>,
}

#[derive(Deserialize)]
struct Head {
    command: String,
    version: u64,
}

#[derive(Deserialize)]
struct Document {
    data: Vec<String>,
    schemes: Vec<Summary>,
    queries: Vec<One>,
}

#[derive(Deserialize)]
struct Summary {
    recall: BTreeMap<String, f64>,
}

#[derive(Deserialize)]
struct One {
    name: String,
    scheme: String,
    score: String,
    #[serde(default)]
    recipe: Option<String>,
    prior: bool,
    fixed_hypotheses: Option<usize>,
    #[serde(default)]
    gravity: Option<String>,
    /// Set in documents of several scenes.
    #[serde(default)]
    scene: Option<String>,
    #[serde(default = "yes")]
    has_ground_truth: bool,
    seed: u64,
    rotation_error_deg: Option<f64>,
    translation_error: Option<f64>,
    ms: BTreeMap<String, f64>,
}

const fn yes() -> bool {
    true
}

impl One {
    /// Display name of its row.
    fn row(&self) -> String {
        let mut row = vec![self.scheme.clone()];
        if let Some(recipe) = &self.recipe {
            row.push(recipe.clone());
        } else {
            row.push(self.score.clone());
            row.extend((!self.prior).then(|| "no prior".to_owned()));
            row.extend(self.fixed_hypotheses.map(|n| format!("{n} hypotheses")));
        }
        row.extend(self.gravity.as_ref().map(|gravity| format!("gravity {gravity}")));
        row.extend(self.scene.clone());
        row.join(", ")
    }

    fn query(&self) -> Query {
        let error = match (self.rotation_error_deg, self.translation_error) {
            (Some(rotation_deg), Some(translation)) => PoseErrors { rotation_deg, translation },
            _ => PoseErrors::NOT_LOCALIZED,
        };
        Query { error, ms: self.ms.values().sum() }
    }
}

impl Run {
    /// Reads a document.
    ///
    /// # Errors
    /// [`EvalError`]: the text is not a document, or it has another command or version, or a query appears twice.
    pub fn parse(json: &str) -> Result<Self, EvalError> {
        let no_document = |error: serde_json::Error| EvalError::Document(error.to_string());
        let value: Value = serde_json::from_str(json).map_err(no_document)?;
        let head = Head::deserialize(&value).map_err(no_document)?;
        if !COMMANDS.contains(&head.command.as_str()) {
            return Err(EvalError::NotCompared(head.command));
        }
        if head.version != 1 {
            return Err(EvalError::Version(head.version));
        }
        let document = Document::deserialize(&value).map_err(no_document)?;
        let mut rows: BTreeMap<String, Row> = BTreeMap::new();
        for result in document.queries.iter().filter(|result| result.has_ground_truth) {
            let row = result.row();
            let key = (result.name.clone(), result.seed);
            if rows.entry(row.clone()).or_default().insert(key, result.query()).is_some() {
                return Err(EvalError::Twice { row, name: result.name.clone(), seed: result.seed });
            }
        }
        let mut thresholds: Vec<Threshold> = Vec::new();
        for text in document.schemes.iter().flat_map(|row| row.recall.keys()) {
            let threshold =
                text.parse().map_err(|_| EvalError::Document(format!("{text:?} is no threshold")))?;
            if !thresholds.contains(&threshold) {
                thresholds.push(threshold);
            }
        }
        thresholds.sort_by(|a, b| a.translation.total_cmp(&b.translation));
        Ok(Self { data: document.data, thresholds, rows })
    }

    /// Names of the evaluated data.
    pub fn data(&self) -> &[String] {
        &self.data
    }

    /// Display names of its rows.
    pub fn rows(&self) -> impl Iterator<Item = &str> {
        self.rows.keys().map(String::as_str)
    }
}
