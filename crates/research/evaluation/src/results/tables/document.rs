//! Documents as input of tables: those of data sets and of single scenes.

use std::collections::BTreeSet;

use crate::EvalError;
use crate::results::data_set::{SceneInfo, SceneQuery};
use crate::results::document::QueryResult;
use crate::results::metrics::median;
use crate::results::table::STAGES;
use serde::Deserialize;

/// Errors of the queries of one row in one column.
#[derive(Debug, Clone, PartialEq)]
pub struct ErrorCurve {
    /// The scene, or the condition.
    pub scene: String,
    /// The row.
    pub row: String,
    /// Errors of each query: position, map units, and orientation, degrees; infinite without a pose.
    pub errors: Vec<(f64, f64)>,
}

/// The parts of a document that tables use.
#[derive(Debug, Clone)]
pub struct TableData {
    /// `7scenes`, `cambridge`, `aachen`; empty for the user's own scene.
    pub(super) data_set: String,
    /// The scenes in order, and whether each is the published one.
    pub(super) scenes: Vec<(String, bool)>,
    pub(super) queries: Vec<SceneQuery>,
}

#[derive(Deserialize)]
struct ParsedDocument {
    version: u64,
    command: String,
    data: Vec<String>,
    #[serde(default)]
    scenes: Vec<SceneInfo>,
    queries: Vec<SceneQuery>,
}

impl TableData {
    /// Reads the document of `eval 7scenes`, `cambridge`, `aachen` or `scene`.
    ///
    /// # Errors
    /// [`EvalError`]: the text is not a document, or it has another command or version.
    pub fn parse(json: &str) -> Result<Self, EvalError> {
        let document: ParsedDocument =
            serde_json::from_str(json).map_err(|e| EvalError::Document(e.to_string()))?;
        if document.version != 1 {
            return Err(EvalError::Version(document.version));
        }
        let data_set = match document.command.as_str() {
            "eval 7scenes" => "7scenes",
            "eval cambridge" => "cambridge",
            "eval aachen" => "aachen",
            "eval scene" => "",
            _ => return Err(EvalError::NoTables(document.command)),
        };
        let mut queries = document.queries;
        let scenes = if document.scenes.is_empty() {
            let name = document.data.join(", ");
            for query in &mut queries {
                query.scene = Some(name.clone());
            }
            vec![(name, false)]
        } else {
            document.scenes.into_iter().map(|scene| (scene.name, scene.is_official)).collect()
        };
        if queries.iter().all(|query| !query.result.has_ground_truth) {
            return Err(EvalError::NoTruth);
        }
        Ok(Self { data_set: data_set.to_owned(), scenes, queries })
    }

    /// Rows of tables: schemes, with other distinguishing options, in the order of the document.
    pub(super) fn rows(&self) -> Vec<String> {
        let mut rows: Vec<String> = Vec::new();
        for query in &self.queries {
            let row = self.row_of(&query.result);
            if !rows.contains(&row) {
                rows.push(row);
            }
        }
        rows
    }

    /// The scheme, with score and gravity if the document has several.
    pub(super) fn row_of(&self, result: &QueryResult) -> String {
        let several = |of: fn(&QueryResult) -> String| {
            let first = self.queries.first().map(|query| of(&query.result));
            self.queries.iter().any(|query| Some(of(&query.result)) != first)
        };
        let mut row = result.scheme.clone();
        if several(|result| result.score.clone()) {
            row = format!("{row}, {}", result.score);
        }
        if let Some(gravity) = &result.variant.gravity {
            row = format!("{row}, gravity {gravity}");
        }
        row
    }

    /// Columns: scenes, or the conditions of a single scene.
    pub(super) fn columns(&self) -> Vec<String> {
        let conditions: BTreeSet<&str> =
            self.queries.iter().filter_map(|query| query.condition.as_deref()).collect();
        if conditions.is_empty() {
            self.scenes.iter().map(|(name, _)| name.clone()).collect()
        } else {
            conditions.into_iter().map(str::to_owned).collect()
        }
    }

    /// The queries with ground truth of a row and column.
    pub(super) fn cell(&self, row: &str, column: &str) -> Vec<&QueryResult> {
        let of_column = |query: &&SceneQuery| {
            query.condition.as_deref().or(query.scene.as_deref()) == Some(column)
                && query.result.has_ground_truth
        };
        let results = self.queries.iter().filter(of_column).map(|query| &query.result);
        results.filter(|result| self.row_of(result) == row).collect()
    }

    /// The errors of the queries with ground truth of every row and column.
    pub fn error_curves(&self) -> Vec<ErrorCurve> {
        let rows = self.rows();
        let of_column = |scene: String| {
            let of_row = move |row: &String| {
                let errors = self.cell(row, &scene).into_iter().map(|result| {
                    let error = result.pose_error();
                    (error.translation, error.rotation_deg)
                });
                ErrorCurve { scene: scene.clone(), row: row.clone(), errors: errors.collect() }
            };
            rows.iter().map(of_row).collect::<Vec<_>>()
        };
        let all = self.columns().into_iter().flat_map(of_column);
        all.filter(|curve| !curve.errors.is_empty()).collect()
    }

    /// Median milliseconds of each stage of every row, over all scenes; stages without times are left out.
    pub fn stage_times(&self) -> Vec<(String, Vec<(&'static str, f64)>)> {
        let of_row = |row: String| {
            let results: Vec<&QueryResult> =
                self.columns().iter().flat_map(|column| self.cell(&row, column)).collect();
            let stages = STAGES.into_iter().filter_map(|stage| {
                let times: Vec<f64> =
                    results.iter().filter_map(|result| result.ms.get(stage).copied()).collect();
                (!times.is_empty()).then(|| (stage, median(&times)))
            });
            (row, stages.collect())
        };
        self.rows().into_iter().map(of_row).collect()
    }

    /// Whether every scene is the published one.
    pub(super) fn is_official(&self, column: &str) -> bool {
        self.scenes.iter().any(|(name, official)| *official && (name == column || self.scenes.len() == 1))
    }
}
