//! Results on a data set of several scenes: the document of `veiloc eval 7scenes`, `cambridge` and `aachen`.

use serde::{Deserialize, Serialize};

use crate::results::document::{MapSummary, QueryResult, SchemeSummary};

/// The document. Its `schemes` and `queries` are those of [`EvaluationDocument`](crate::results::EvaluationDocument),
/// each with its scene.
#[derive(Debug, Clone, Serialize)]
pub struct DataSetEvaluation {
    /// Version of this document; a field is never removed or given another meaning under the same number.
    pub version: u32,
    /// The command, for example `eval 7scenes`.
    pub command: &'static str,
    /// Names of the scenes.
    pub data: Vec<String>,
    /// Program and machine of the run.
    pub run: RunInfo,
    /// Seed of every random choice.
    pub seed: u64,
    /// The scenes, in the order of evaluation.
    pub places: Vec<SceneInfo>,
    /// One entry per scene, condition and row of the table.
    pub schemes: Vec<SceneSummary>,
    /// One entry per scene, row and query.
    pub queries: Vec<SceneQuery>,
}

/// Program and machine of a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunInfo {
    /// Version of this program.
    pub veiloc: String,
    /// The command line, word by word.
    pub command_line: Vec<String>,
    /// Operating system and architecture.
    pub system: String,
    /// Number of cores available to the program.
    pub cores: usize,
    /// Queries that were localized in parallel.
    pub jobs: usize,
}

/// A scene of a data set.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct SceneInfo {
    /// Its name.
    pub name: String,
    /// Whether it is the complete published scene, so that published figures refer to the same images.
    pub is_official: bool,
    /// Number of queries.
    pub queries: usize,
    /// What was left out or assumed while reading, one sentence each.
    pub remarks: Vec<String>,
    /// The map.
    pub map: Option<MapSummary>,
}

/// A row of the table of one scene.
#[derive(Debug, Clone, Serialize)]
pub struct SceneSummary {
    /// The scene.
    pub place: String,
    /// Condition of the queries, if the data set distinguishes conditions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub condition: Option<String>,
    /// The figures.
    #[serde(flatten)]
    pub summary: SchemeSummary,
}

/// A query of one scene under one row.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneQuery {
    /// The scene; absent in documents of one scene.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place: Option<String>,
    /// Condition of the query, if the data set distinguishes conditions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub condition: Option<String>,
    /// The result.
    #[serde(flatten)]
    pub result: QueryResult,
}
