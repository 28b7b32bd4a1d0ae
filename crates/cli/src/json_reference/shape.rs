//! A JSON schema without references, reduced to what the page shows.

use std::fmt;

use serde_json::{Map, Value};

/// A type, whether it may be null, and its values if they are enumerated.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Shape {
    pub(super) kind: Kind,
    pub(super) nullable: bool,
    /// Enumerated values, each with its meaning.
    pub(super) values: Vec<(String, String)>,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) enum Kind {
    /// `string`, `number`, `integer`, `boolean` or `any`.
    Scalar(String),
    Object(Vec<Field>),
    /// The length if it is fixed.
    List(Box<Shape>, Option<u64>),
    /// An object whose names are data.
    Map(Box<Shape>),
}

/// A field of an object.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Field {
    pub(super) name: String,
    pub(super) meaning: String,
    pub(super) optional: bool,
    pub(super) shape: Shape,
}

impl Shape {
    pub(super) fn of(schema: &Value) -> Self {
        let mut alternatives: Vec<&Value> =
            ["anyOf", "oneOf"].iter().filter_map(|key| schema[*key].as_array()).flatten().collect();
        let all = alternatives.len();
        alternatives.retain(|schema| schema["type"] != "null");
        let mut nullable = alternatives.len() < all;
        if let Some(first) = alternatives.first() {
            let mut shape = Self::of(first);
            for other in &alternatives[1..] {
                shape.merge(Self::of(other));
            }
            shape.nullable |= nullable;
            return shape;
        }
        let types: Vec<&str> = match &schema["type"] {
            Value::String(one) => vec![one],
            Value::Array(several) => several.iter().filter_map(Value::as_str).collect(),
            _ if schema["const"].is_null() && schema["enum"].is_null() => vec!["any"],
            _ => vec!["string"],
        };
        nullable |= types.contains(&"null");
        let name = types.into_iter().find(|name| *name != "null").unwrap_or("null");
        let kind = match name {
            "object" => match (&schema["properties"], &schema["additionalProperties"]) {
                (Value::Object(properties), _) => Kind::Object(fields(properties, &schema["required"])),
                (_, inner) => Kind::Map(Box::new(Self::of(inner))),
            },
            "array" => {
                let fixed = schema["minItems"].as_u64().filter(|least| schema["maxItems"] == *least);
                // Of a tuple, what its first is.
                let item = if schema["prefixItems"].is_array() {
                    &schema["prefixItems"][0]
                } else {
                    &schema["items"]
                };
                Kind::List(Box::new(Self::of(item)), fixed)
            }
            scalar => Kind::Scalar(scalar.to_owned()),
        };
        let meaning = text(schema);
        let constants = schema["const"].as_str().into_iter().map(|value| (value.to_owned(), meaning.clone()));
        let listed = schema["enum"].as_array().into_iter().flatten().filter_map(Value::as_str);
        let values = constants.chain(listed.map(|value| (value.to_owned(), String::new()))).collect();
        Self { kind, nullable, values }
    }

    /// Adds an alternative: the fields of both objects, the values of both enumerations.
    fn merge(&mut self, other: Self) {
        self.nullable |= other.nullable;
        self.values.extend(other.values);
        if let (Kind::Object(own), Kind::Object(others)) = (&mut self.kind, other.kind) {
            for field in others {
                match own.iter_mut().find(|f| f.name == field.name) {
                    Some(same) => same.shape.merge(field.shape),
                    None => own.push(Field { optional: true, ..field }),
                }
            }
        }
    }

    /// The object inside lists and `Option`, with the suffix of its path.
    pub(super) fn object(&self) -> Option<(&[Field], String)> {
        match &self.kind {
            Kind::Object(fields) => Some((fields, String::new())),
            Kind::List(inner, _) => inner.object().map(|(fields, suffix)| (fields, format!("[]{suffix}"))),
            Kind::Scalar(_) | Kind::Map(_) => None,
        }
    }

    /// The meanings of enumerated values, also of those in lists.
    pub(super) fn values(&self) -> &[(String, String)] {
        match &self.kind {
            Kind::List(inner, _) => inner.values(),
            _ => &self.values,
        }
    }
}

/// `number or null`, `string[]`, `map of number`.
impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.kind {
            Kind::Scalar(name) => f.write_str(name)?,
            Kind::Object(_) => f.write_str("object")?,
            Kind::Map(inner) => write!(f, "map of {inner}")?,
            Kind::List(..) => {
                // From the outermost list to the innermost.
                let (mut inner, mut sizes) = (self, String::new());
                while let Kind::List(next, size) = &inner.kind {
                    sizes += &size.map_or_else(|| "[]".to_owned(), |n| format!("[{n}]"));
                    inner = next;
                }
                if inner.nullable {
                    write!(f, "({inner}){sizes}")?;
                } else {
                    write!(f, "{inner}{sizes}")?;
                }
            }
        }
        if self.nullable { f.write_str(" or null") } else { Ok(()) }
    }
}

/// Fields: those that are always there in the order of the type, then the others by name.
fn fields(properties: &Map<String, Value>, required: &Value) -> Vec<Field> {
    let required: Vec<&str> = required.as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    let others = properties.keys().map(String::as_str).filter(|name| !required.contains(name));
    let field = |name: &str, optional: bool| {
        let schema = &properties[name];
        let mut shape = Shape::of(schema);
        // An optional field is left out instead of being null.
        shape.nullable &= !optional;
        Field { name: name.to_owned(), meaning: text(schema), optional, shape }
    };
    required.iter().map(|name| field(name, false)).chain(others.map(|name| field(name, true))).collect()
}

/// The documentation of a type or field, in one line and without links to items. That of an optional object may be at the
/// alternative that is not null.
pub(super) fn text(schema: &Value) -> String {
    let alternatives = ["anyOf", "oneOf"].iter().filter_map(|key| schema[*key].as_array()).flatten();
    let mut texts = std::iter::once(schema).chain(alternatives).filter_map(|s| s["description"].as_str());
    texts.next().unwrap_or_default().replace('\n', " ").replace("[`", "`").replace("`]", "`")
}
