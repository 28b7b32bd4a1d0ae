//! Text of the page.

use std::fmt::Write as _;

use serde_json::Value;

use super::shape::{Field, Shape, text};

/// Objects with fewer fields are repeated, not referred to.
const MIN_SHARED_FIELDS: usize = 5;

/// An object whose fields are already in a table.
struct Known {
    fields: Vec<Field>,
    /// Path and section, as the page refers to it.
    place: String,
}

pub(super) struct Page {
    text: String,
    known: Vec<Known>,
    problems: Vec<String>,
}

impl Page {
    pub(super) fn new(intro: &str) -> Self {
        Self { text: intro.to_owned(), known: Vec::new(), problems: Vec::new() }
    }

    /// Adds the section of a command.
    pub(super) fn section(&mut self, command: &str, schema: &Value) {
        let shape = Shape::of(schema);
        let description = text(schema);
        let _ = write!(
            self.text,
            "\n## `{command}`\n\n{description}\n\n| field | type | meaning |\n|---|---|---|\n"
        );
        let Some((fields, _)) = shape.object() else {
            self.problems.push(format!("{command}: is no object"));
            return;
        };
        if let Some((known, extra)) = self.known_part(fields) {
            self.row("", &format!("with the fields of {known}"), "");
            self.rows(command, "", &extra);
        } else {
            self.rows(command, "", fields);
        }
        self.remember(fields, format!("`{command}`"));
    }

    fn rows(&mut self, command: &str, prefix: &str, fields: &[Field]) {
        for field in fields {
            let name = format!("{prefix}{}", field.name);
            let mut meaning = field.meaning.clone();
            for (value, about) in field.shape.values() {
                let about = about.trim_end_matches('.');
                let about = if about.is_empty() { String::new() } else { format!(": {}", lower(about)) };
                let _ = write!(meaning, " `{value}`{about};");
            }
            if meaning.ends_with(';') {
                meaning.truncate(meaning.len() - 1);
                meaning.push('.');
            }
            if meaning.is_empty() || meaning.contains('|') {
                self.problems.push(format!("{command}: {name} has no documentation, or `|` in it"));
            }
            let optional = if field.optional { ", optional" } else { "" };
            let kind = format!("{}{optional}", field.shape);
            let Some((inner, suffix)) = field.shape.object() else {
                self.row(&name, &kind, &meaning);
                continue;
            };
            let path = format!("{name}{suffix}");
            match self.known_part(inner) {
                Some((known, extra)) if extra.is_empty() => {
                    self.row(&name, &format!("{kind}, as {known}"), &meaning);
                }
                Some((known, extra)) => {
                    self.row(&name, &format!("{kind}, with the fields of {known}"), &meaning);
                    self.rows(command, &format!("{path}."), &extra);
                }
                None => {
                    self.row(&name, &kind, &meaning);
                    self.rows(command, &format!("{path}."), inner);
                }
            }
            self.remember(inner, format!("`{path}` of `{command}`"));
        }
    }

    fn row(&mut self, name: &str, kind: &str, meaning: &str) {
        let name = if name.is_empty() { String::new() } else { format!("`{name}`") };
        let _ = writeln!(self.text, "| {name} | {kind} | {meaning} |");
    }

    /// The largest known object whose fields are all among these, and the other fields.
    fn known_part(&self, fields: &[Field]) -> Option<(String, Vec<Field>)> {
        let within = self.known.iter().filter(|known| known.fields.iter().all(|f| fields.contains(f)));
        let known = within.max_by_key(|known| known.fields.len())?;
        let extra = fields.iter().filter(|f| !known.fields.contains(f)).cloned().collect();
        Some((known.place.clone(), extra))
    }

    fn remember(&mut self, fields: &[Field], place: String) {
        let is_known = self.known.iter().any(|known| {
            known.fields.len() == fields.len() && known.fields.iter().all(|f| fields.contains(f))
        });
        if fields.len() >= MIN_SHARED_FIELDS && !is_known {
            self.known.push(Known { fields: fields.to_vec(), place });
        }
    }

    pub(super) fn finish(self) -> Result<String, String> {
        if self.problems.is_empty() { Ok(self.text) } else { Err(self.problems.join("\n")) }
    }
}

/// With a small first letter, unless the first word is a name.
fn lower(text: &str) -> String {
    let mut letters = text.chars();
    let Some(first) = letters.next() else { return String::new() };
    let rest = letters.as_str();
    let is_name = rest.chars().next().is_some_and(char::is_uppercase);
    if is_name { text.to_owned() } else { first.to_lowercase().chain(rest.chars()).collect() }
}
