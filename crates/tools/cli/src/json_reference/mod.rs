//! The page `docs/reference/json.md`, generated from the types of the documents: one section per command, with a table of
//! all fields. Names, types and presence come from the JSON schemas of the types, meanings from their documentation.

mod page;
mod shape;

use std::collections::BTreeMap;

use schemars::generate::SchemaSettings;
use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde_json::Value;
use utoipa::ToSchema as _;
use veiloc_evaluation::attack_evaluation::{AttackDocument, AuditDocument, adversaries, inversion, sessions};
use veiloc_evaluation::results;
use veiloc_protocol::AnswerDocument;

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
    page.section("map info", &schema::<commands::map::info::Info>());
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

/// The schema of a service's answer. Its type has a description for OpenAPI 3.1, which contains JSON schemas; the crate of
/// the protocol needs no second one.
pub(crate) fn answer_schema(_: &mut SchemaGenerator) -> Schema {
    let mut named = Vec::new();
    AnswerDocument::schemas(&mut named);
    let value = |schema| serde_json::to_value(schema).unwrap_or_default();
    let named: BTreeMap<String, Value> =
        named.into_iter().map(|(name, schema)| (name, value(schema))).collect();
    let own = serde_json::to_value(<AnswerDocument as utoipa::PartialSchema>::schema()).unwrap_or_default();
    Schema::try_from(inlined(own, &named)).unwrap_or_default()
}

/// Replaces references by the schemas they name.
fn inlined(schema: Value, named: &BTreeMap<String, Value>) -> Value {
    match schema {
        Value::Object(mut object) => {
            if let Some(Value::String(reference)) = object.remove("$ref") {
                let name = reference.rsplit('/').next().unwrap_or_default();
                if let Some(Value::Object(target)) = named.get(name) {
                    // The description of the field replaces that of the type.
                    for (key, value) in target {
                        object.entry(key.clone()).or_insert_with(|| value.clone());
                    }
                }
            }
            object.into_iter().map(|(key, value)| (key, inlined(value, named))).collect()
        }
        Value::Array(all) => all.into_iter().map(|one| inlined(one, named)).collect(),
        other => other,
    }
}
