//! The page `docs/reference/json.md`, generated from the types of the documents: one section per command, with a table of
//! all fields. Names, types and presence come from the JSON schemas of the types, meanings from their documentation.

mod page;
mod shape;

use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde_json::Value;
use veiloc_evaluation::attack_evaluation::{AttackDocument, AuditDocument, adversaries, inversion, sessions};
use veiloc_evaluation::results;

use self::page::Page;
use crate::commands;

/// The page; an error lists the fields that lack documentation.
///
/// # Errors
/// The problems, one per line.
pub fn json_reference() -> Result<String, String> {
    let mut page = Page::new(include_str!("intro.md"));
    page.section("seal", &schema::<commands::seal::batch::SealDocument>());
    page.section("models", &schema::<commands::models::ModelListDocument>());
    page.section("localize", &schema::<commands::localize::document::LocalizeDocument>());
    page.section("localize --rig", &schema::<commands::localize::rig::RigDocument>());
    page.section("map info", &schema::<commands::map::facts::Info>());
    page.section("map anchors", &schema::<veiloc_protocol::ContentAnchors>());
    page.section("map split", &schema::<commands::map::split::SplitDocument<'_>>());
    page.section("map publish", &schema::<commands::map::publish::PublishedDocument<'_>>());
    page.section("map fetch", &schema::<commands::map::publish::FetchedDocument<'_>>());
    page.section("map versions", &schema::<commands::map::publish::VersionsDocument<'_>>());
    page.section("token list", &schema::<commands::token::ListDocument>());
    page.section("query send", &schema::<commands::query::send::Document>());
    page.section("eval scene", &schema::<results::EvaluationDocument>());
    page.section("eval dataset", &schema::<results::DataSetEvaluation>());
    page.section("eval sessions", &schema::<sessions::SessionsDocument>());
    page.section("eval adversaries", &schema::<adversaries::AdversariesDocument>());
    page.section("attack", &schema::<AttackDocument>());
    page.section("audit", &schema::<AuditDocument>());
    page.section("demo", &schema::<crate::demo::DemoDocument>());
    page.section("eval inversion", &schema::<inversion::InversionDocument>());
    page.finish()
}

/// The schema of a type as it is written, without references.
fn schema<T: JsonSchema>() -> Value {
    let settings = SchemaSettings::draft2020_12().for_serialize().with(|s| s.inline_subschemas = true);
    settings.into_generator().into_root_schema_for::<T>().to_value()
}
