//! The tables of `docs/reference/json.md`, and the check of a document against them.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use serde_json::Value;

/// Fields of a command's document: the path `a.b[].c` to its description in the tables.
pub type Fields = BTreeMap<String, Field>;

#[derive(Debug, Clone)]
pub struct Field {
    /// Whether it may be absent.
    pub optional: bool,
    /// Whether it may be `null`.
    pub nullable: bool,
}

/// Every table of the page, by command.
pub fn tables() -> BTreeMap<String, Fields> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../docs/reference/json.md");
    let text = fs::read_to_string(&path).expect("docs/reference/json.md");
    let mut tables: BTreeMap<String, Fields> = BTreeMap::new();
    let mut own_names: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    let mut command = None;
    for line in text.lines() {
        if let Some(heading) = line.strip_prefix("## ") {
            command = heading.strip_prefix('`').and_then(|h| h.strip_suffix('`')).map(str::to_owned);
        }
        let (Some(command), Some(cells)) = (&command, cells(line)) else { continue };
        let [field, unit, meaning] = cells[..] else { panic!("three cells are expected: {line}") };
        let Some(field) = field.strip_prefix('`').and_then(|f| f.strip_suffix('`')) else { continue };
        assert!(!meaning.is_empty(), "{command}: {field} has no meaning");
        let own = Field { optional: meaning.contains("absent"), nullable: meaning.contains("null") };
        let mut add = |name: String, field: Field| {
            let own = own_names.entry(command.clone()).or_default();
            assert!(own.insert(name.clone()), "{command}: {name} occurs twice");
            tables.entry(command.clone()).or_default().insert(name, field);
        };
        match unit.strip_prefix("as `").and_then(|u| u.strip_suffix('`')) {
            None => add(field.to_owned(), own),
            Some(other) => {
                let fields =
                    tables.get(other).unwrap_or_else(|| panic!("{other} comes later, or never")).clone();
                let mut add = |name: String, field: Field| {
                    tables.entry(command.clone()).or_default().insert(name, field);
                };
                for (name, inner) in fields {
                    let inner = Field { optional: inner.optional || own.optional, ..inner };
                    // `.` stands for the document itself.
                    add(if field == "." { name } else { format!("{field}.{name}") }, inner);
                }
            }
        }
    }
    tables
}

fn cells(line: &str) -> Option<Vec<&str>> {
    let inside = line.strip_prefix('|')?.strip_suffix('|')?;
    Some(inside.split('|').map(str::trim).collect())
}

/// Differences between a command's documents and its table: fields that are not in the table, `null`s that it does not
/// allow, and fields that never occur although the table does not call them optional.
pub fn mistakes(fields: &Fields, documents: &[Value]) -> Vec<String> {
    let mut seen = BTreeSet::new();
    let mut wrong = BTreeSet::new();
    for document in documents {
        walk("", document, fields, &mut seen, &mut wrong);
    }
    for (name, field) in fields {
        if !field.optional && !seen.contains(name) {
            wrong.insert(format!("{name} never came"));
        }
    }
    wrong.into_iter().collect()
}

fn walk(
    path: &str,
    value: &Value,
    fields: &Fields,
    seen: &mut BTreeSet<String>,
    wrong: &mut BTreeSet<String>,
) {
    match value {
        Value::Object(object) => {
            // Object keys that are data.
            let any = format!("{path}.*");
            if fields.contains_key(&any) {
                seen.insert(any.clone());
                for inner in object.values() {
                    walk(&any, inner, fields, seen, wrong);
                }
                return;
            }
            for (name, inner) in object {
                let at = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
                walk(&at, inner, fields, seen, wrong);
            }
        }
        Value::Array(entries) if entries.iter().any(Value::is_object) => {
            for entry in entries {
                walk(&format!("{path}[]"), entry, fields, seen, wrong);
            }
        }
        _ => {
            // The elements of an empty list are unknown.
            let empty = value.as_array().is_some_and(Vec::is_empty);
            if empty && fields.keys().any(|name| name.starts_with(&format!("{path}[]."))) {
                return;
            }
            match fields.get(path) {
                None => _ = wrong.insert(format!("{path} is not in docs/reference/json.md")),
                Some(field) if value.is_null() && !field.nullable => {
                    wrong.insert(format!("{path} is null, and docs/reference/json.md does not say when"));
                }
                Some(_) => {}
            }
            seen.insert(path.to_owned());
        }
    }
}
