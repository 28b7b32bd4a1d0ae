//! What an evaluation on a data set of several places found: the document of `veiloc eval 7scenes`, `cambridge` and `aachen`.

use serde::{Deserialize, Serialize};

use crate::results::document::{MapSummary, QueryResult, SchemeSummary};

/// The document. Its `schemes` and `queries` are those of [`Evaluation`](crate::results::Evaluation), each with its place.
#[derive(Debug, Clone, Serialize)]
pub struct DataSetEvaluation {
    /// Version of this document; a field is never removed or given another meaning under the same number.
    pub version: u32,
    /// The command, as `eval 7scenes`.
    pub command: &'static str,
    /// Names of the places.
    pub data: Vec<String>,
    /// What it was run with, and on what.
    pub run: RunFacts,
    /// Seed of every random choice.
    pub seed: u64,
    /// The places, in the order they were evaluated in.
    pub places: Vec<PlaceFacts>,
    /// One entry a place, condition and row of the table.
    pub schemes: Vec<PlaceSummary>,
    /// One entry a place, row and query.
    pub queries: Vec<PlaceQuery>,
}

/// What an evaluation was run with, and on what.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunFacts {
    /// Version of this program.
    pub veiloc: String,
    /// The command line, word by word.
    pub command_line: Vec<String>,
    /// Operating system and architecture.
    pub system: String,
    /// Cores that a program may use.
    pub cores: usize,
    /// Queries that were localized at the same time.
    pub jobs: usize,
}

/// A place of a data set.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct PlaceFacts {
    /// Its name.
    pub name: String,
    /// Whether it is the published place, whole, so that figures of others are of the same images.
    pub is_official: bool,
    /// Queries.
    pub queries: usize,
    /// What was left out or decided while reading, a sentence each.
    pub remarks: Vec<String>,
    /// The map.
    pub map: Option<MapSummary>,
}

/// A row of the table of one place.
#[derive(Debug, Clone, Serialize)]
pub struct PlaceSummary {
    /// The place.
    pub place: String,
    /// What the queries were taken under, where the data set tells them apart.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub condition: Option<String>,
    /// The figures.
    #[serde(flatten)]
    pub summary: SchemeSummary,
}

/// A query of one place under one row.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlaceQuery {
    /// The place; absent in documents of one place.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place: Option<String>,
    /// What it was taken under, where the data set tells queries apart.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub condition: Option<String>,
    /// What it came to.
    #[serde(flatten)]
    pub result: QueryResult,
}
