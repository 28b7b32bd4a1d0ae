//! The description file of a network, and the network it names.

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use veiloc_features::FeatureError;
use veiloc_features::learned::{Engine, Network, Tensor};

use crate::{AttackError, DecodedDescriptors};

/// The supported version.
const VERSION: i64 = 1;
/// Maximum size of a description, bytes.
const MAX_BYTES: u64 = 1 << 16;
/// Maximum length of a descriptor.
const MAX_DIMENSION: usize = 8192;

/// Input modality of a network: which part of a query it is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum InputModality {
    /// Of a position network: all rows, descriptors and lines.
    Set,
    /// Of a position network: each row alone, its descriptor and its line.
    Row,
    /// Of a position network: each line alone.
    Line,
    /// Of an inversion network, and its default: descriptors.
    Descriptors,
    /// Of an inversion network: positions alone.
    Positions,
    /// Of an inversion network: positions, and the colour of the image at each.
    Colour,
}

impl InputModality {
    /// Numbers of a row in place of a descriptor.
    const fn dimension(self) -> Option<usize> {
        match self {
            Self::Set | Self::Row | Self::Line | Self::Descriptors => None,
            Self::Positions => Some(0),
            Self::Colour => Some(3),
        }
    }

    const fn is_of(self, kind: NetworkKind) -> bool {
        match self {
            Self::Set | Self::Row | Self::Line => matches!(kind, NetworkKind::Positions),
            Self::Descriptors | Self::Positions | Self::Colour => matches!(kind, NetworkKind::Inversion),
        }
    }
}

/// What a network predicts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum NetworkKind {
    Inversion,
    Positions,
    Neighbours,
}

impl NetworkKind {
    const fn name(self) -> &'static str {
        match self {
            Self::Inversion => "inversion",
            Self::Positions => "positions",
            Self::Neighbours => "neighbours",
        }
    }
}

/// All fields of a description; fields of another kind of network are refused.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct NetworkDescription {
    #[serde(rename = "version")]
    _version: i64,
    kind: NetworkKind,
    model: String,
    features: String,
    dimension: usize,
    pub(super) side: Option<usize>,
    pub(super) multiple: Option<usize>,
    pub(super) scheme: Option<String>,
    pub(super) input: Option<InputModality>,
}

impl NetworkDescription {
    fn parse(text: &str, expected: NetworkKind) -> Result<Self, String> {
        let table: toml::Table = toml::from_str(text).map_err(|error| error.to_string().trim().to_owned())?;
        match table.get("version").and_then(toml::Value::as_integer) {
            Some(VERSION) => {}
            Some(other) => {
                return Err(format!("it has version {other}, but only version {VERSION} is supported"));
            }
            None => return Err("it has no `version`".to_owned()),
        }
        let read: Self = table.try_into().map_err(|error| error.to_string().trim().to_owned())?;
        if read.kind != expected {
            let (found, expected) = (read.kind.name(), expected.name());
            return Err(format!(
                "it describes a network of kind {found:?}, but kind {expected:?} is required"
            ));
        }
        let plain = Path::new(&read.model).file_name().is_some_and(|own| own == read.model.as_str());
        if !plain {
            return Err(format!(
                "its model is {:?}; it must be the name of a file in the same folder",
                read.model
            ));
        }
        match read.input {
            Some(input) if !input.is_of(expected) => {
                return Err(format!("its `input` is not one of kind {:?}", expected.name()));
            }
            None if expected == NetworkKind::Positions => {
                return Err(format!(
                    "it lacks `input`, a field of descriptions of kind {:?}",
                    expected.name()
                ));
            }
            _ => {}
        }
        match read.input.and_then(InputModality::dimension) {
            Some(own) if read.dimension != own => {
                return Err(format!("its dimension is {}; with this input it must be {own}", read.dimension));
            }
            None if !(1..=MAX_DIMENSION).contains(&read.dimension) => {
                let dimension = read.dimension;
                return Err(format!("its dimension is {dimension}; it must be from 1 to {MAX_DIMENSION}"));
            }
            _ => {}
        }
        let given = [read.side.is_some(), read.multiple.is_some(), read.scheme.is_some()];
        for ((name, of), given) in OF_KINDS.into_iter().zip(given) {
            if given != (of == expected) {
                let what = if given { "has" } else { "lacks" };
                return Err(format!(
                    "it {what} `{name}`, a field of descriptions of kind {:?} only",
                    of.name()
                ));
            }
        }
        Ok(read)
    }
}

/// The kinds of networks by name, in the order of the fields.
const OF_KINDS: [(&str, NetworkKind); 3] = [
    ("side", NetworkKind::Inversion),
    ("multiple", NetworkKind::Inversion),
    ("scheme", NetworkKind::Positions),
];

/// A network with its description.
#[derive(Debug)]
pub(super) struct DescribedNetwork {
    file: PathBuf,
    model: PathBuf,
    network: Network,
    features: String,
    dimension: usize,
}

/// Shape of an input or output; `None` for a dynamic side.
pub(super) type Sides<'a> = &'a [Option<usize>];

impl DescribedNetwork {
    /// Reads a description, or the description beside an ONNX file, and the network that it names.
    pub(super) fn open(path: &Path, kind: NetworkKind) -> Result<(Self, NetworkDescription), AttackError> {
        let is_model = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("onnx"));
        let file = if is_model { path.with_extension("toml") } else { path.to_owned() };
        let refused = |reason: String| AttackError::Description { path: file.clone(), reason };
        let text = read_description(&file).map_err(refused)?;
        let description = NetworkDescription::parse(&text, kind).map_err(refused)?;
        let model = file.parent().unwrap_or(Path::new("")).join(&description.model);
        let network = Network::open(&model, Engine::default())?;
        let (features, dimension) = (description.features.clone(), description.dimension);
        Ok((Self { file, model, network, features, dimension }, description))
    }

    /// The description's file.
    pub(super) fn file(&self) -> &Path {
        &self.file
    }

    /// The descriptor kind of its training data.
    pub(super) fn features(&self) -> &str {
        &self.features
    }

    /// The descriptor length.
    pub(super) fn dimension(&self) -> usize {
        self.dimension
    }

    /// An error about the description, for checks that only one kind of network can make.
    pub(super) fn description_error(&self, reason: String) -> AttackError {
        AttackError::Description { path: self.file.clone(), reason }
    }

    fn unusable(&self, reason: String) -> AttackError {
        FeatureError::Network { path: self.model.clone(), reason }.into()
    }

    /// Refuses a network that has inputs other than these, or lacks one of these outputs.
    pub(super) fn check(&self, inputs: &[(&str, Sides<'_>)], outputs: &[&str]) -> Result<(), AttackError> {
        let [count, _] = self.network.ends();
        if count != inputs.len() {
            return Err(self.unusable(format!("it has {count} inputs, but {} are required", inputs.len())));
        }
        for (name, expected) in inputs {
            let refused = |what: &str| {
                let sides = expected.iter().map(|side| side.map_or("any".to_owned(), |s| s.to_string()));
                let sides = sides.collect::<Vec<_>>().join(", ");
                Err(self.unusable(format!("it {what} the input {name:?} with shape [{sides}]")))
            };
            let Some(own) = self.network.input_named(name) else { return refused("lacks") };
            // A dynamic side accepts any number.
            let fits = |(own, expected): (&Option<usize>, &Option<usize>)| own.is_none() || own == expected;
            if own.len() != expected.len() || !own.iter().zip(*expected).all(fits) {
                return refused("does not accept");
            }
        }
        match outputs.iter().find(|name| !self.has_output(name)) {
            Some(name) => Err(self.unusable(format!("it lacks the output {name:?}"))),
            None => Ok(()),
        }
    }

    /// Whether it has an output with this name.
    pub(super) fn has_output(&self, output: &str) -> bool {
        self.network.outputs().iter().any(|own| own == output)
    }

    /// Refuses descriptors with another length than the network's.
    pub(super) fn check_dimension(&self, descriptors: &DecodedDescriptors) -> Result<(), AttackError> {
        let (expected, found) = (self.dimension, descriptors.dimension());
        if found == expected { Ok(()) } else { Err(AttackError::Dimensions { expected, found }) }
    }

    /// Runs the network; every output must have this shape and finite values.
    pub(super) fn run(
        &self,
        inputs: &[(&str, &Tensor)],
        outputs: &[(&str, Sides<'_>)],
    ) -> Result<Vec<Tensor>, AttackError> {
        let names: Vec<&str> = outputs.iter().map(|(name, _)| *name).collect();
        let results = self.network.run_named(inputs, &names).map_err(|error| match error {
            FeatureError::NetworkRun { reason } => self.unusable(reason),
            other => other.into(),
        })?;
        for (result, (name, expected)) in results.iter().zip(outputs) {
            let fits =
                |(own, expected): (&usize, &Option<usize>)| expected.is_none_or(|expected| *own == expected);
            if result.shape.len() != expected.len() || !result.shape.iter().zip(*expected).all(fits) {
                let shape = &result.shape;
                return Err(self.unusable(format!("its output {name:?} has the wrong shape, {shape:?}")));
            }
            if result.data.iter().any(|x| !x.is_finite()) {
                return Err(self.unusable(format!("its output {name:?} has values that are not finite")));
            }
        }
        Ok(results)
    }
}

/// The text of a description.
fn read_description(file: &Path) -> Result<String, String> {
    let mut bytes = Vec::new();
    let opened = File::open(file).and_then(|file| file.take(MAX_BYTES + 1).read_to_end(&mut bytes));
    opened.map_err(|error| format!("it cannot be read: {error}"))?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(format!("it has more than {MAX_BYTES} bytes"));
    }
    String::from_utf8(bytes).map_err(|_| "it is not UTF-8 text".to_owned())
}
