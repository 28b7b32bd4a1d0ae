//! Results on a data set of several scenes: the document of `veiloc eval dataset`.

use serde::Serialize;

use crate::results::document::{MapSummary, QueryResult, SchemeSummary};

/// Its `schemes` and `queries` are those of `eval scene`, each with its scene.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct DataSetEvaluation {
    /// Version of this document.
    pub version: u32,
    /// The command: `eval dataset 7scenes`, `eval dataset cambridge`, `eval dataset aachen` or `eval dataset aachen-v1.1`.
    pub command: &'static str,
    /// Names of the scenes.
    pub data: Vec<String>,
    /// Program and machine of the run.
    pub run: RunInfo,
    /// Seed of every random choice.
    pub seed: u64,
    /// The scenes, in the order of evaluation.
    pub scenes: Vec<SceneInfo>,
    /// One entry per scene, condition and row of the table.
    pub schemes: Vec<SceneSummary>,
    /// One entry per scene, row and query.
    pub queries: Vec<SceneQuery>,
}

/// Program and machine of a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RunInfo {
    /// Version of this program.
    pub veiloc: String,
    /// The command line, word by word.
    pub command_line: Vec<String>,
    /// Operating system and architecture.
    pub system: String,
    /// Number of cores available to the program.
    pub cores: usize,
    /// Number of queries that were localized in parallel; with more than one, times are those of a busy machine.
    pub jobs: usize,
}

/// A scene of a data set.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SceneInfo {
    /// Name of the scene.
    pub name: String,
    /// Whether it is the complete published scene, so that published figures refer to the same images.
    pub is_official: bool,
    /// Number of queries.
    pub queries: usize,
    /// What was left out or assumed while reading, one sentence each.
    pub remarks: Vec<String>,
    /// The map; null if it was not built.
    pub map: Option<MapSummary>,
}

/// A row of the table of one scene.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SceneSummary {
    /// The scene.
    pub scene: String,
    /// The figures.
    #[serde(flatten)]
    pub summary: SchemeSummary,
}

/// A query of one scene under one row.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SceneQuery {
    /// The scene.
    pub scene: String,
    /// The result.
    #[serde(flatten)]
    pub result: QueryResult,
}
