//! The tables of `docs/reference/json.md`, and the check of a document against them.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use serde_json::Value;

/// Fields of a command's document: the path `a.b[].c` to its description in the tables.
pub type Fields = BTreeMap<String, Field>;

#[derive(Debug, Clone)]
pub struct Field {
    /// `number`, `string[]`, `map of integer`.
    pub kind: String,
    /// Whether it may be absent.
    pub optional: bool,
    /// Whether it may be `null`.
    pub nullable: bool,
    /// Whether it may be a list without entries.
    pub may_be_empty: bool,
}

/// The page.
pub fn page() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/reference/json.md");
    fs::read_to_string(path).expect("docs/reference/json.md")
}

/// Every table of the page, by command.
pub fn tables() -> BTreeMap<String, Fields> {
    let mut tables: BTreeMap<String, Fields> = BTreeMap::new();
    let mut command = None;
    for line in page().lines() {
        if let Some(heading) = line.strip_prefix("## ") {
            command = quoted(heading).map(str::to_owned);
        }
        let (Some(command), Some(cells)) = (&command, cells(line)) else { continue };
        let [name, kind, meaning] = cells[..] else { panic!("three cells are expected: {line}") };
        if name == "field" || name.starts_with('-') {
            continue;
        }
        let name = quoted(name).unwrap_or_default();
        let shared = kind.split_once(", as ").or(kind.split_once("with the fields of ")).map(|(_, of)| of);
        let mut fields = tables.remove(command).unwrap_or_default();
        if let Some(place) = shared {
            let suffix = "[]".repeat(kind.split(", ").next().unwrap_or_default().matches("[]").count());
            let prefix = if name.is_empty() { String::new() } else { format!("{name}{suffix}.") };
            let own = BTreeMap::from([(command.clone(), fields.clone())]);
            let known = fields_of(place, &tables).or_else(|| fields_of(place, &own));
            let known = known.unwrap_or_else(|| panic!("{command}: {name}: {place} comes later, or never"));
            fields.extend(known.into_iter().map(|(name, field)| (format!("{prefix}{name}"), field)));
        }
        if !name.is_empty() {
            assert!(!meaning.is_empty(), "{command}: {name} has no meaning");
            let field = Field {
                kind: kind.split(", ").next().unwrap_or_default().replace(" or null", ""),
                optional: kind.contains(", optional"),
                nullable: kind.contains(" or null") || meaning.contains("null"),
                may_be_empty: meaning.contains("may be empty"),
            };
            assert!(fields.insert(name.to_owned(), field).is_none(), "{command}: {name} occurs twice");
        }
        tables.insert(command.clone(), fields);
    }
    tables
}

/// The fields below a place, as the page names it: `` `PATH` of `SECTION` `` or `` `SECTION` ``.
fn fields_of(place: &str, tables: &BTreeMap<String, Fields>) -> Option<Fields> {
    let (path, section) = place.split_once(" of ").map_or((None, place), |(path, of)| (quoted(path), of));
    let fields = tables.get(quoted(section)?)?;
    let prefix = path.map_or_else(String::new, |path| format!("{path}."));
    let below =
        fields.iter().filter_map(|(name, f)| Some((name.strip_prefix(&prefix)?.to_owned(), f.clone())));
    Some(below.collect())
}

fn quoted(text: &str) -> Option<&str> {
    text.strip_prefix('`')?.strip_suffix('`')
}

fn cells(line: &str) -> Option<Vec<&str>> {
    let inside = line.strip_prefix('|')?.strip_suffix('|')?;
    Some(inside.split('|').map(str::trim).collect())
}

/// Differences between a command's documents and its table: fields that are not in the table, values of another type,
/// `null`s that it does not allow, fields that are absent although the table does not call them optional, and lists without
/// any entry in all documents.
pub fn mistakes(fields: &Fields, documents: &[Value]) -> Vec<String> {
    let mut check =
        Check { fields, wrong: BTreeSet::new(), with_entries: BTreeSet::new(), empty: BTreeSet::new() };
    for document in documents {
        check.object("", document);
    }
    for name in check.empty.difference(&check.with_entries) {
        check.wrong.insert(format!("{name} never had an entry"));
    }
    check.wrong.into_iter().collect()
}

struct Check<'a> {
    fields: &'a Fields,
    wrong: BTreeSet<String>,
    /// Lists of objects that had entries, and those that had none.
    with_entries: BTreeSet<String>,
    empty: BTreeSet<String>,
}

impl Check<'_> {
    /// `prefix` ends with a dot, unless it is empty.
    fn object(&mut self, prefix: &str, value: &Value) {
        let Some(object) = value.as_object() else {
            self.wrong.insert(format!("{prefix} is no object"));
            return;
        };
        for (name, inner) in object {
            self.field(&format!("{prefix}{name}"), inner);
        }
        let own = self.fields.iter().filter_map(|(name, field)| Some((name.strip_prefix(prefix)?, field)));
        for (name, field) in own.filter(|(name, _)| !name.contains('.')) {
            if !field.optional && !object.contains_key(name) {
                self.wrong.insert(format!("{prefix}{name} is absent"));
            }
        }
    }

    fn field(&mut self, path: &str, value: &Value) {
        let Some(field) = self.fields.get(path) else {
            self.wrong.insert(format!("{path} is not in docs/reference/json.md"));
            return;
        };
        if value.is_null() {
            if !field.nullable {
                self.wrong.insert(format!("{path} is null, and docs/reference/json.md does not say when"));
            }
            return;
        }
        if !is_of(value, &field.kind, field.nullable) {
            self.wrong.insert(format!("{path} is no {}: {value}", field.kind));
            return;
        }
        match (field.kind.as_str(), value.as_array()) {
            ("object", _) => self.object(&format!("{path}."), value),
            ("object[]", Some(entries)) => {
                let lists = if entries.is_empty() { &mut self.empty } else { &mut self.with_entries };
                if !field.may_be_empty {
                    lists.insert(path.to_owned());
                }
                for entry in entries {
                    self.object(&format!("{path}[]."), entry);
                }
            }
            _ => {}
        }
    }
}

/// Whether a value has a type; null elements are those that are not finite.
fn is_of(value: &Value, kind: &str, nullable: bool) -> bool {
    if let Some(inner) = kind.strip_prefix("map of ") {
        return value.as_object().is_some_and(|o| o.values().all(|v| is_of(v, inner, nullable)));
    }
    if let Some((inner, size)) = kind.strip_suffix(']').and_then(|k| k.split_once('[')) {
        // The outermost list comes first: `number[6][6]`.
        let (size, rest) =
            size.split_once("][").map_or((size, String::new()), |(n, rest)| (n, format!("[{rest}]")));
        let inner = format!("{}{rest}", inner.trim_start_matches('(').trim_end_matches(')'));
        return value.as_array().is_some_and(|all| {
            size.parse().map_or(true, |n: usize| n == all.len()) && all.iter().all(|v| is_of(v, &inner, true))
        });
    }
    match kind {
        _ if value.is_null() => nullable,
        "object" => value.is_object(),
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "integer" => value.is_u64() || value.is_i64(),
        "number" => value.is_number(),
        _ => false,
    }
}
