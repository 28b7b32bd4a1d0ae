//! Inputs of an audit: images, folders of images, and files of keypoints.

use std::path::{Path, PathBuf};

use veiloc_datasets::problem_files::{KeypointImage, keypoints_of_images, read_keypoints};
use veiloc_evaluation::attack_evaluation::{Attack, ImageGroup};
use veiloc_features::{Extractor, Progress};
use veiloc_protocol::ExtractionLimits;

use crate::output::exit::Failure;
use crate::output::items::{self, Item};
use crate::output::ui::Ui;

/// Images with their keypoints, in groups, and the paths of their files.
pub(super) struct Inputs {
    groups: Vec<Group>,
}

struct Group {
    name: String,
    /// The image, and its file if it has one.
    images: Vec<(KeypointImage, Option<PathBuf>)>,
}

impl Inputs {
    /// Reads all inputs; of a folder and its sub-folders only the first `limit` images. Images that are given one by
    /// one form one group.
    pub(super) fn read(
        paths: &[PathBuf],
        limit: usize,
        extractor: &dyn Extractor,
        limits: ExtractionLimits,
        progress: &dyn Progress,
        ui: &Ui,
    ) -> Result<Self, Failure> {
        let given: Vec<Vec<Item>> =
            paths.iter().map(|path| items::expand_images(std::slice::from_ref(path), ui)).collect();
        items::refuse_bad(&given.concat())?;
        let (mut files, mut given) = (Vec::new(), given);
        for path in paths.iter().filter(|path| holds_keypoints(path) && !path.is_dir()) {
            let images: Vec<KeypointImage> = read_keypoints(path)?;
            files.push(with_images(path, images, &mut given));
        }
        let mut files = files.into_iter();
        let mut groups: Vec<Group> = Vec::new();
        let mut loose: Vec<Item> = Vec::new();
        for (path, mut inside) in paths.iter().zip(given) {
            if path.is_dir() {
                if inside.is_empty() {
                    continue;
                }
                if inside.len() > limit {
                    ui.info(format!("{}: the first {limit} of {} images", path.display(), inside.len()));
                    inside.truncate(limit);
                }
                groups.push(group(display_name(path), &inside, extractor, limits, progress)?);
            } else if holds_keypoints(path) {
                let Some(group) = files.next() else { continue };
                if group.images.len() > limit {
                    ui.info(format!(
                        "{}: the first {limit} of {} images",
                        path.display(),
                        group.images.len()
                    ));
                }
                groups.push(group);
            } else {
                loose.append(&mut inside);
            }
        }
        if !loose.is_empty() {
            if loose.len() > limit {
                return Err(Failure::with_help(
                    format!("{} images are given, and only {limit} would be attacked", loose.len()),
                    format!("give --limit {} to attack all of them", loose.len()),
                ));
            }
            let name = if loose.len() == 1 {
                display_name(&loose[0].path)
            } else {
                format!("{} images", loose.len())
            };
            groups.push(group(name, &loose, extractor, limits, progress)?);
        }
        let mut inputs = Self { groups };
        inputs.drop_empty(ui)?;
        Ok(inputs)
    }

    /// Drops images without keypoints: they send nothing that could be attacked.
    fn drop_empty(&mut self, ui: &Ui) -> Result<(), Failure> {
        let mut first = None;
        for group in &mut self.groups {
            group.images.retain(|(image, _)| {
                let empty = image.keypoints.is_empty();
                if empty {
                    ui.info(format!("{}: no keypoints found, left out", image.name));
                    first.get_or_insert_with(|| image.name.clone());
                }
                !empty
            });
        }
        self.groups.retain(|group| !group.images.is_empty());
        match first {
            Some(name) if self.groups.is_empty() => Err(Failure::with_help(
                format!("{name}: no keypoints found, so there is nothing to attack"),
                "give a sharp image with some texture",
            )),
            _ => Ok(()),
        }
    }

    /// Returns the groups for the evaluation.
    pub(super) fn groups(&self) -> Vec<ImageGroup> {
        let images = |g: &Group| g.images.iter().map(|(image, _)| image.clone()).collect();
        self.groups.iter().map(|g| ImageGroup { name: g.name.clone(), images: images(g) }).collect()
    }

    /// Returns the attacks that these inputs allow and that end in reasonable time.
    pub(super) fn default_attacks(&self) -> Vec<Attack> {
        let map = |g: &Group| g.images.len() > 1 && g.images.iter().all(|(p, _)| p.descriptors.is_some());
        // Realistic attackers come first, then attackers with an oracle's neighbours.
        let mut attacks = vec![Attack::PRIOR];
        if !self.groups.is_empty() {
            attacks.push(Attack::RESTING_CAMERA);
        }
        if !self.groups.is_empty() && self.groups.iter().all(map) {
            attacks.push(Attack::TRANSFER);
        }
        attacks.extend([Attack::CLOSED_FORM, Attack::CLOSED_FORM_INFORMED, Attack::GRAPH]);
        attacks
    }

    /// Returns the file of an image; `None` if it has none.
    pub(super) fn file_of(&self, group: usize, index: usize) -> Option<PathBuf> {
        self.groups.get(group)?.images.get(index)?.1.clone()
    }
}

/// Reads a file of keypoints and finds their images: images of the same name among `given`, which then are not attacked
/// separately, and otherwise images of the same name beside the file.
fn with_images(path: &Path, images: Vec<KeypointImage>, given: &mut [Vec<Item>]) -> Group {
    let mut files: Vec<Option<PathBuf>> = Vec::new();
    for image in &images {
        let named = Path::new(&image.name);
        let among = given.iter_mut().find_map(|inside| {
            let at = inside.iter().position(|item| item.path.ends_with(named))?;
            Some(inside.remove(at).path)
        });
        let beside = || path.parent().map(|folder| folder.join(named)).filter(|file| file.is_file());
        files.push(among.or_else(beside));
    }
    Group { name: display_name(path), images: images.into_iter().zip(files).collect() }
}

fn group(
    name: String,
    items: &[Item],
    extractor: &dyn Extractor,
    limits: ExtractionLimits,
    progress: &dyn Progress,
) -> Result<Group, Failure> {
    let files: Vec<PathBuf> = items.iter().map(|item| item.path.clone()).collect();
    let mut images = keypoints_of_images(&files, extractor, limits, progress)?;
    for (image, name) in images.iter_mut().zip(items::names(items)) {
        image.name = name;
    }
    Ok(Group { name, images: images.into_iter().zip(files.into_iter().map(Some)).collect() })
}

fn display_name(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
}

/// Returns whether a file holds keypoints, judged by its name.
fn holds_keypoints(path: &Path) -> bool {
    let name = display_name(path).to_ascii_lowercase();
    let name = name.strip_suffix(".gz").unwrap_or(&name);
    [".jsonl", ".json", ".ndjson"].iter().any(|ending| name.ends_with(ending))
}
