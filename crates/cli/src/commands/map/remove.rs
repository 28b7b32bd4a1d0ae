//! `veiloc map remove`: removes images from a map.

use std::path::PathBuf;

use veiloc_mapping::VocabularyUpdate;

use super::edit::MapEdit;
use super::facts::InfoOutput;
use super::self_test::FinishArgs;
use crate::output::exit::Outcome;
use crate::output::stages::Stages;
use crate::output::targets::OutFile;
use crate::output::ui::Ui;

/// Remove images from a map, with their keypoints and the points that only they observe.
///
/// The vocabulary stays, so that queries sealed for the map remain valid. Its words are means of descriptors of many
/// images, including the removed ones. With --retrain it is trained again on the remaining images: then no removed
/// descriptor contributes to it, but the profile changes, and devices must fetch it again.
#[derive(clap::Args)]
pub(crate) struct RemoveArgs {
    /// The map.
    map: PathBuf,
    /// Names of the images.
    #[arg(required = true, value_name = "NAME")]
    names: Vec<String>,
    /// Train the vocabulary again on the remaining images; devices must then fetch the profile again.
    #[arg(long)]
    retrain: bool,
    #[command(flatten)]
    finish: FinishArgs,
    /// The map file to write. Default: the map itself.
    #[arg(long, short, value_name = "FILE")]
    out: Option<OutFile>,
    /// Print facts about the map as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &RemoveArgs, ui: &Ui) -> Outcome {
    let edit = MapEdit::begin(&args.map, args.out.as_deref(), ui)?;
    let mut model = edit.read()?;
    let words = if args.retrain { VocabularyUpdate::Retrain } else { VocabularyUpdate::Keep };
    let profile = model.profile.id();
    veiloc_mapping::remove(&mut model, &args.names, words, &Stages::new(ui))?;
    let mut warnings = Vec::new();
    args.finish.finish(&mut model, &mut warnings, edit.out, ui)?;
    edit.write(&model)?;
    ui.info(match words {
        VocabularyUpdate::Keep => {
            "The images still contribute to the words of the vocabulary, which are means of descriptors \
             of many images and are published in the profile. --retrain trains the vocabulary without \
             these images. Copies and backups of the old map still contain the images' keypoints."
        }
        VocabularyUpdate::Retrain if model.profile.id() == profile => {
            "The profile is unchanged: nothing in it was trained on the images. Copies and backups of the \
             old map still contain the images' keypoints."
        }
        VocabularyUpdate::Retrain => {
            "The vocabulary was trained again without the images, so the map has a new profile: publish \
             it, and let devices fetch it; queries sealed with the old one are refused. Copies and \
             backups of the old map still contain the images' keypoints."
        }
    });
    InfoOutput { json: args.json, warnings, ..InfoOutput::default() }.print(edit.out, ui)
}
