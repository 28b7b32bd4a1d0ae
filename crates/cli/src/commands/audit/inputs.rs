//! What an audit is given: photographs, folders of them, and files of keypoints.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use veiloc_eval::audit::{
    AttackKind, KeypointPicture, PictureGroup, keypoints_of_photographs, photographs, read_keypoints,
};
use veiloc_mapping::Progress;
use veiloc_query::ExtractionLimits;

use crate::exit::Failure;
use crate::ui::Ui;

/// Pictures with their keypoints, in groups, and where the photographs lie.
pub(super) struct Inputs {
    groups: Vec<Group>,
}

struct Group {
    name: String,
    /// The picture, and its file where it is a photograph.
    pictures: Vec<(KeypointPicture, Option<PathBuf>)>,
}

impl Inputs {
    /// Reads everything; of a folder the first `most` photographs. Photographs that are given one by one are one group.
    pub(super) fn read(
        paths: &[PathBuf],
        most: usize,
        limits: ExtractionLimits,
        progress: &dyn Progress,
        ui: &Ui,
    ) -> Result<Self, Failure> {
        let mut groups: Vec<Group> = Vec::new();
        let mut loose: Vec<PathBuf> = Vec::new();
        for path in paths {
            if path.is_dir() {
                let mut inside = photographs(std::slice::from_ref(path))?;
                if inside.len() > most {
                    ui.say(format!("{}: the first {most} of {} photographs", path.display(), inside.len()));
                    inside.truncate(most);
                }
                groups.push(group(display_name(path), inside, limits, progress)?);
            } else if holds_keypoints(path) {
                let pictures = read_keypoints(path)?;
                if pictures.len() > most {
                    ui.say(format!("{}: the first {most} of {} pictures", path.display(), pictures.len()));
                }
                let pictures = pictures.into_iter().map(|picture| (picture, None)).collect();
                groups.push(Group { name: display_name(path), pictures });
            } else {
                loose.push(path.clone());
            }
        }
        if !loose.is_empty() {
            if loose.len() > most {
                return Err(Failure::with_help(
                    format!("{} photographs are given, and {most} pictures would be attacked", loose.len()),
                    format!("say --pictures {} to attack all of them", loose.len()),
                ));
            }
            let name = if loose.len() == 1 {
                display_name(&loose[0])
            } else {
                format!("{} photographs", loose.len())
            };
            groups.push(group(name, loose, limits, progress)?);
        }
        let mut inputs = Self { groups };
        inputs.drop_empty(ui)?;
        Ok(inputs)
    }

    /// A picture without keypoints sends nothing that could be attacked.
    fn drop_empty(&mut self, ui: &Ui) -> Result<(), Failure> {
        let mut first = None;
        for group in &mut self.groups {
            group.pictures.retain(|(picture, _)| {
                let empty = picture.keypoints.is_empty();
                if empty {
                    ui.say(format!("{}: no keypoint in it, left out", picture.name));
                    first.get_or_insert_with(|| picture.name.clone());
                }
                !empty
            });
        }
        self.groups.retain(|group| !group.pictures.is_empty());
        match first {
            Some(name) if self.groups.is_empty() => Err(Failure::with_help(
                format!("{name}: no keypoint in it, so there is nothing that could be attacked"),
                "give a sharp picture with some texture in it",
            )),
            _ => Ok(()),
        }
    }

    /// For the evaluation.
    pub(super) fn groups(&self) -> Vec<PictureGroup> {
        let pictures = |g: &Group| g.pictures.iter().map(|(picture, _)| picture.clone()).collect();
        self.groups.iter().map(|g| PictureGroup { name: g.name.clone(), pictures: pictures(g) }).collect()
    }

    /// Attacks that these inputs allow and that end in reasonable time.
    pub(super) fn default_attacks(&self) -> Vec<AttackKind> {
        let map = |g: &Group| g.pictures.len() > 1 && g.pictures.iter().all(|(p, _)| p.descriptors.is_some());
        let mut attacks = vec![AttackKind::Prior, AttackKind::ClosedForm, AttackKind::ClosedFormInformed];
        if !self.groups.is_empty() && self.groups.iter().all(map) {
            attacks.push(AttackKind::Transfer);
        }
        attacks.push(AttackKind::Graph);
        attacks
    }

    /// The photograph behind a picture; `None` where there is none.
    pub(super) fn photograph(&self, group: usize, index: usize) -> Option<PathBuf> {
        self.groups.get(group)?.pictures.get(index)?.1.clone()
    }
}

fn group(
    name: String,
    files: Vec<PathBuf>,
    limits: ExtractionLimits,
    progress: &dyn Progress,
) -> Result<Group, Failure> {
    let mut pictures = keypoints_of_photographs(&files, limits, progress)?;
    // Two folders may hold files of one name; then the paths tell them apart.
    let mut names = BTreeSet::new();
    if !pictures.iter().all(|p| names.insert(p.name.clone())) {
        for (picture, file) in pictures.iter_mut().zip(&files) {
            picture.name = file.display().to_string();
        }
    }
    Ok(Group { name, pictures: pictures.into_iter().zip(files.into_iter().map(Some)).collect() })
}

fn display_name(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
}

/// Whether a file is one of keypoints, by its name.
fn holds_keypoints(path: &Path) -> bool {
    let name = display_name(path).to_ascii_lowercase();
    let name = name.strip_suffix(".gz").unwrap_or(&name);
    [".jsonl", ".json", ".ndjson"].iter().any(|ending| name.ends_with(ending))
}
