//! `veiloc models`: lists the known models of features and global descriptors, and whether their files exist.

use std::fmt::Write as _;

use crate::args::feature_args::models;
use serde::Serialize;
use veiloc_features::learned::{GlobalModelFiles, ModelFile};

use crate::output::exit::{Exit, Outcome};
use crate::output::ui::Ui;

/// List the known models of learned features and global descriptors, with the source and licence of their network
/// files, and whether the files exist.
///
/// Files are searched in the folders of the environment variable VEILOC_MODELS, and in each in the sub-folder with the
/// model's name. Nothing is downloaded. Other ONNX networks of the same form can be used with a .toml file that
/// describes them (docs/results/features.md).
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Print one JSON document to stdout.
    #[arg(long)]
    json: bool,
}

/// Known models, and whether their network files exist.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct ModelListDocument {
    /// 1.
    version: u32,
    /// Searched folders, from VEILOC_MODELS.
    folders: Vec<String>,
    /// Models of learned features.
    models: Vec<ModelDocument>,
    /// Models of global descriptors, which are computed from whole images.
    globals: Vec<GlobalDocument>,
}

/// A model of global descriptors, which are computed from whole images.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct GlobalDocument {
    /// Name, as `--global` and `--image-global` take it.
    name: String,
    /// Short description.
    about: String,
    /// Source of its files.
    source: String,
    /// The command that makes its files from the downloaded ones; absent when none is needed.
    #[serde(skip_serializing_if = "Option::is_none")]
    export: Option<String>,
    /// Licence of its files.
    licence: String,
    /// For each of its networks the accepted file names, the preferred one first.
    files: Vec<Vec<String>>,
    /// For each of its networks the file that was found; null when there is none.
    found: Vec<Option<String>>,
    /// Number of elements of a vector, which is also its number of bytes.
    dimension: usize,
}

impl GlobalDocument {
    fn of(found: &GlobalModelFiles<'_>) -> Self {
        let GlobalModelFiles { description, files } = found;
        Self {
            name: description.name().to_owned(),
            about: description.about().to_owned(),
            source: description.source().to_owned(),
            export: description.export().map(str::to_owned),
            licence: description.licence().to_owned(),
            files: description.files().map(<[String]>::to_vec).collect(),
            found: files.iter().map(|f| f.as_ref().map(|path| path.display().to_string())).collect(),
            dimension: description.model().dim(),
        }
    }

    fn line(&self) -> String {
        let mut text =
            format!("{}: {}; {} numbers; {}\n", self.name, self.about, self.dimension, self.licence);
        for (names, found) in self.files.iter().zip(&self.found) {
            let _ = match found {
                Some(file) => writeln!(text, "  there: {file}"),
                None => {
                    writeln!(text, "  not found: {}", missing(names, &self.source, self.export.as_deref()))
                }
            };
        }
        text
    }
}

/// Describes the accepted files, their source, and the command that makes them.
fn missing(files: &[String], source: &str, export: Option<&str>) -> String {
    let made = export.map_or_else(String::new, |export| format!("; {export}"));
    format!("{}, from {source}{made}", files.join(" or "))
}

/// One model.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct ModelDocument {
    /// Name, as `--features` takes it.
    name: String,
    /// Short description.
    about: String,
    /// Source of its file.
    source: String,
    /// The command that makes its file from the downloaded one; absent when none is needed.
    #[serde(skip_serializing_if = "Option::is_none")]
    export: Option<String>,
    /// Licence of its file.
    licence: String,
    /// Accepted file names, the preferred one first.
    files: Vec<String>,
    /// The file that was found; null when there is none.
    file: Option<String>,
    /// Number of elements of a descriptor, which is also its number of bytes.
    dimension: usize,
}

impl ModelDocument {
    fn of(found: &ModelFile<'_>) -> Self {
        let ModelFile { description, file } = found;
        Self {
            name: description.name().to_owned(),
            about: description.about().to_owned(),
            source: description.source().to_owned(),
            export: description.export().map(str::to_owned),
            licence: description.licence().to_owned(),
            files: description.files().to_vec(),
            file: file.as_ref().map(|path| path.display().to_string()),
            dimension: description.kind().dim(),
        }
    }

    fn line(&self) -> String {
        let file = match &self.file {
            Some(file) => format!("there: {file}"),
            None => format!("not found: {}", missing(&self.files, &self.source, self.export.as_deref())),
        };
        format!("{}: {}; {} numbers; {}\n  {file}\n", self.name, self.about, self.dimension, self.licence)
    }
}

pub(crate) fn run(args: &Args, ui: &Ui) -> Outcome {
    let models = models();
    let folders: Vec<String> = models.folders().iter().map(|folder| folder.display().to_string()).collect();
    let all: Vec<ModelDocument> = models.all().map(|found| ModelDocument::of(&found)).collect();
    let globals: Vec<GlobalDocument> = models.globals().map(|found| GlobalDocument::of(&found)).collect();
    if args.json {
        ui.json(&ModelListDocument { version: 1, folders, models: all, globals })?;
        return Ok(Exit::Success);
    }
    let mut text = "sift: built in; 128 numbers\n".to_owned();
    for model in &all {
        text += &model.line();
    }
    text += "global descriptors of whole images, in addition to vlad, which is computed from the sent \
             local descriptors:\n";
    for model in &globals {
        text += &model.line();
    }
    let looked = if folders.is_empty() {
        "no folder; VEILOC_MODELS is not set".to_owned()
    } else {
        folders.join(", ")
    };
    let _ = writeln!(text, "looked for in: {looked}");
    ui.print(text);
    Ok(Exit::Success)
}
