//! Files and folders on the command line: their content, errors of single files, and the summary.
//!
//! Commands with several inputs treat each on its own: missing files are reported before the work begins, a bad file
//! does not stop the others, and a summary at the end counts the results.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use serde::Serialize;
use veiloc_features::{IMAGE_EXTENSIONS, IMAGE_FORMATS};
use veiloc_mapping::image_file;

use crate::output::exit::{Exit, Failure, Outcome, remedy_of_io};
use crate::output::files;
use crate::output::ui::Ui;

/// The kind of file that a command looks for in a folder.
pub(crate) struct InputKind {
    /// Its name, in the singular.
    pub what: &'static str,
    /// Its file extensions, lower case.
    pub endings: &'static [&'static str],
}

/// Extensions of images that are not read, lower case, and the name of their format.
const UNREAD_FORMATS: [(&str, &str); 7] = [
    ("jxl", "JPEG XL"),
    ("tif", "TIFF"),
    ("tiff", "TIFF"),
    ("avif", "AVIF"),
    ("bmp", "BMP"),
    ("gif", "GIF"),
    ("dng", "DNG"),
];

/// Images in the supported formats.
pub(crate) const IMAGES: InputKind =
    InputKind { what: "JPEG, PNG, WebP or HEIC file", endings: IMAGE_EXTENSIONS };
/// The output of `veiloc seal`.
pub(crate) const SEALED: InputKind = InputKind { what: "sealed query (.vquery)", endings: &["vquery"] };

/// An input file.
#[derive(Debug, Clone)]
pub(crate) struct Item {
    /// Its path; `-` for stdin.
    pub path: PathBuf,
    /// Its path relative to the given folder, or its file name if the file itself was given. With several inputs the
    /// name of the folder comes first, so that files of two folders do not collide.
    pub below: PathBuf,
    /// The same without the folder's own name: the name in data sets.
    name: String,
    /// Its error, as far as it is known without reading the file.
    pub fault: Option<InputError>,
}

impl Item {
    /// Returns its path relative to the folder in which it was found, without the folder's own name: the name in data
    /// sets and masks.
    pub(crate) fn name(&self) -> &str {
        &self.name
    }
}

/// Why an input has no result.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct InputError {
    /// Kind of the error, for programs.
    pub kind: InputErrorKind,
    /// The problem and the remedy, for people.
    pub message: String,
}

/// Kinds of errors, for programs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub(crate) enum InputErrorKind {
    /// The file does not exist.
    Missing,
    /// The file cannot be read, or a folder contains nothing of use.
    Unreadable,
    /// The file has another format or is truncated.
    Damaged,
    /// The file is intact, but cannot be used here.
    Unfit,
}

impl InputError {
    /// Returns an error of this kind; the message states the problem and the remedy.
    pub(crate) fn new(kind: InputErrorKind, message: impl std::fmt::Display) -> Self {
        Self { kind, message: message.to_string() }
    }

    /// Converts an I/O error of a file.
    pub(crate) fn of_io(error: &io::Error) -> Self {
        let kind = match error.kind() {
            io::ErrorKind::NotFound => InputErrorKind::Missing,
            _ => InputErrorKind::Unreadable,
        };
        Self::new(kind, format_args!("{error}; {}", remedy_of_io(error.kind())))
    }

    /// Returns the message, with the name of the file in it exactly once.
    pub(crate) fn of(&self, name: &str) -> String {
        if contains_file_name(&self.message, name) {
            self.message.clone()
        } else {
            format!("{name}: {}", self.message)
        }
    }
}

/// Returns whether a message names a file: the name must occur alone or at the end of a path, not within another name.
fn contains_file_name(message: &str, name: &str) -> bool {
    let continues_name = |c: char| c.is_alphanumeric() || "-_".contains(c);
    !name.is_empty()
        && message.match_indices(name).any(|(at, _)| {
            let before = message[..at].chars().next_back();
            let mut rest = message[at + name.len()..].chars();
            let ends = match rest.next() {
                // The end of a sentence, or another extension of the name.
                Some('.') => !rest.next().is_some_and(continues_name),
                Some(next) => !continues_name(next) && next != '/',
                None => true,
            };
            ends && !before.is_some_and(|c| continues_name(c) || c == '.')
        })
}

/// Expands the inputs in their order: a file as it is, a folder to the wanted files in it and its sub-folders, sorted
/// by path. Hidden files and folders are left out.
pub(crate) fn expand_inputs(given: &[PathBuf], input_kind: &InputKind) -> Vec<Item> {
    let mut items = Vec::new();
    for path in given {
        if !path.is_dir() {
            let below = path.file_name().map_or_else(|| path.clone(), PathBuf::from);
            items.push(check_file(path.clone(), &below, Path::new("")));
            continue;
        }
        let mut inside = Vec::new();
        let walked = walk(path, input_kind.endings, &mut BTreeSet::new(), &mut inside);
        let fault = match walked {
            Err((at, error)) => {
                let InputError { kind, message } = InputError::of_io(&error);
                Some(InputError::new(kind, format_args!("{}: {message}", at.display())))
            }
            Ok(()) if inside.is_empty() => {
                let unread = if input_kind.what == IMAGES.what { unread_images(path) } else { None };
                let what = input_kind.what;
                let message = match unread {
                    Some(unread) => format!("contains no {what}, but {unread}; convert them to JPEG or PNG"),
                    None => format!("contains no {what}; give a folder that contains some, or the files"),
                };
                Some(InputError::new(InputErrorKind::Unreadable, message))
            }
            Ok(()) => None,
        };
        inside.sort();
        let above = match path.file_name() {
            Some(name) if given.len() > 1 => PathBuf::from(name),
            _ => PathBuf::new(),
        };
        if let Some(fault) = fault {
            let name = path.display().to_string();
            items.push(Item { path: path.clone(), below: above.clone(), name, fault: Some(fault) });
        }
        for file in inside {
            let below = file.strip_prefix(path).unwrap_or(&file).to_owned();
            items.push(check_file(file, &below, &above));
        }
    }
    items
}

/// As [`expand_inputs`] for images, and warns of images in the folders that are left out because of their format.
pub(crate) fn expand_images(given: &[PathBuf], ui: &Ui) -> Vec<Item> {
    let items = expand_inputs(given, &IMAGES);
    for folder in given.iter().filter(|path| path.is_dir()) {
        // A folder without any image that can be read is an error, which names them.
        let is_empty = items.iter().any(|item| item.path == *folder && item.fault.is_some());
        if let Some(unread) = unread_images(folder).filter(|_| !is_empty) {
            ui.warn(format_args!(
                "{}: {unread} left out, because only {IMAGE_FORMATS} is read; convert them to JPEG or PNG",
                folder.display()
            ));
        }
    }
    items
}

/// Counts the images in a folder and its sub-folders that are not read because of their format, for example
/// `3 TIFF files and 1 AVIF file`; `None` without any.
fn unread_images(folder: &Path) -> Option<String> {
    let endings = UNREAD_FORMATS.map(|(ending, _)| ending);
    let mut found = Vec::new();
    walk(folder, &endings, &mut BTreeSet::new(), &mut found).ok()?;
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for path in &found {
        let format = UNREAD_FORMATS.iter().find(|(ending, _)| has_ending(path, &[ending]));
        *counts.entry(format?.1).or_default() += 1;
    }
    let words: Vec<String> = counts
        .iter()
        .map(|(format, n)| format!("{n} {format} file{}", if *n == 1 { "" } else { "s" }))
        .collect();
    match words.as_slice() {
        [] => None,
        [one] => Some(one.clone()),
        [most @ .., last] => Some(format!("{} and {last}", most.join(", "))),
    }
}

/// Returns the files of a list: its names in a folder, in the spelling that the files have.
pub(crate) fn files_of_list<'a>(folder: &Path, names: impl IntoIterator<Item = &'a str>) -> Vec<Item> {
    names
        .into_iter()
        .map(|name| check_file(image_file(folder, name), Path::new(name), Path::new("")))
        .collect()
}

/// Returns a file with its error if it cannot be opened.
fn check_file(path: PathBuf, below: &Path, above: &Path) -> Item {
    let fault = if files::is_standard(&path) { None } else { error_of_path(&path) };
    Item { path, below: above.join(below), name: below.display().to_string(), fault }
}

/// Returns the displayed name of each item: its name in its folder, or its path if two folders have files of the same
/// name.
pub(crate) fn names(items: &[Item]) -> Vec<String> {
    let mut seen = BTreeSet::new();
    if items.iter().all(|item| seen.insert(item.name.as_str())) {
        return items.iter().map(|item| item.name.clone()).collect();
    }
    items.iter().map(|item| item.path.display().to_string()).collect()
}

fn error_of_path(path: &Path) -> Option<InputError> {
    match fs::metadata(path) {
        Ok(m) if m.is_dir() => Some(InputError::of_io(&io::ErrorKind::IsADirectory.into())),
        // A pipe can be opened only once, by its reader.
        Ok(m) if m.is_file() => File::open(path).err().map(|e| InputError::of_io(&e)),
        Ok(_) => None,
        Err(error) => Some(InputError::of_io(&error)),
    }
}

/// Collects the files with these extensions in a folder and its sub-folders; a symbolic link to a parent folder is followed once.
fn walk(
    folder: &Path,
    endings: &[&str],
    seen: &mut BTreeSet<PathBuf>,
    found: &mut Vec<PathBuf>,
) -> Result<(), (PathBuf, io::Error)> {
    let here = |e| (folder.to_owned(), e);
    if !seen.insert(folder.canonicalize().map_err(here)?) {
        return Ok(());
    }
    for entry in fs::read_dir(folder).map_err(here)? {
        let entry = entry.map_err(here)?;
        if entry.file_name().to_string_lossy().starts_with('.') {
            continue;
        }
        let path = entry.path();
        if path.is_dir() {
            walk(&path, endings, seen, found)?;
        } else if has_ending(&path, endings) {
            found.push(path);
        }
    }
    Ok(())
}

fn has_ending(path: &Path, endings: &[&str]) -> bool {
    path.extension().is_some_and(|e| {
        e.to_str().is_some_and(|e| endings.iter().any(|known| e.eq_ignore_ascii_case(known)))
    })
}

/// Like [`expand_images`], but a file that cannot be read ends the command.
///
/// # Errors
/// Names all files that cannot be read.
pub(crate) fn expand_readable(given: &[PathBuf], ui: &Ui) -> Result<Vec<Item>, Failure> {
    let items = expand_images(given, ui);
    refuse_bad(&items)?;
    Ok(items)
}

/// Ends a command that needs all its files.
///
/// # Errors
/// Names all files that cannot be read.
pub(crate) fn refuse_bad(items: &[Item]) -> Result<(), Failure> {
    let bad = known_errors(items);
    match bad.as_slice() {
        [] => Ok(()),
        [one] => Err(Failure::refused(&one.message)),
        several => Err(Failure::refused(format_args!(
            "{} of {} files cannot be read:\n{}",
            several.len(),
            items.len(),
            folded(several).join("\n")
        ))),
    }
}

/// An input that cannot be used, and the message that names it.
struct NamedError {
    name: String,
    message: String,
}

impl NamedError {
    fn new(name: &str, error: &InputError) -> Self {
        Self { name: name.to_owned(), message: error.of(name) }
    }
}

fn known_errors(items: &[Item]) -> Vec<NamedError> {
    let named = |item: &Item| {
        item.fault.as_ref().map(|error| NamedError::new(&item.path.display().to_string(), error))
    };
    items.iter().filter_map(named).collect()
}

/// One line for each message; inputs with the same message share one line, which names them all.
fn folded(errors: &[NamedError]) -> Vec<String> {
    let without_name = |error: &NamedError| error.message.replacen(&error.name, "", 1);
    let mut groups: Vec<(String, Vec<&NamedError>)> = Vec::new();
    for error in errors {
        let key = without_name(error);
        match groups.iter_mut().find(|(known, _)| *known == key) {
            Some((_, group)) => group.push(error),
            None => groups.push((key, vec![error])),
        }
    }
    let line = |(_, group): (String, Vec<&NamedError>)| match group.as_slice() {
        [first, second, others @ ..] => {
            let count = others.len() + 1;
            let names: Vec<&str> = std::iter::once(second).chain(others).map(|e| e.name.as_str()).collect();
            let inputs = if count == 1 { "1 other".to_owned() } else { format!("{count} others") };
            format!("{} (also {inputs}: {})", first.message, names.join(", "))
        }
        group => group.iter().map(|error| error.message.as_str()).collect(),
    };
    groups.into_iter().map(line).collect()
}

/// Effect of bad files on the exit code.
#[derive(clap::Args, Debug, Clone, Copy)]
pub(crate) struct SkipArgs {
    /// Ignore unusable files in the exit code, as long as one file is usable. They are reported in any case.
    #[arg(long)]
    skip_bad: bool,
}

impl SkipArgs {
    /// Returns whether bad files are ignored.
    pub(crate) const fn ignores_failures(self) -> bool {
        self.skip_bad
    }
}

/// Counts the results of a command's inputs.
pub(crate) struct BatchSummary {
    /// The verb of the summary, as in `8 of 10 sealed`.
    verb: &'static str,
    total: usize,
    errors: Vec<NamedError>,
}

impl BatchSummary {
    /// Reports missing and unreadable inputs before the work begins.
    pub(crate) fn begin(verb: &'static str, items: &[Item], ui: &Ui) -> Self {
        let known = known_errors(items);
        if items.len() > 1 && !known.is_empty() {
            ui.info(format_args!(
                "{} of {} cannot be read:{}",
                known.len(),
                items.len(),
                indented(&folded(&known))
            ));
        }
        Self { verb, total: items.len(), errors: Vec::new() }
    }

    /// Counts an input without result.
    pub(crate) fn failed(&mut self, name: &str, fault: &InputError) {
        self.errors.push(NamedError::new(name, fault));
    }

    /// Returns the number of inputs that have no result because of their own error.
    pub(crate) fn failures(&self) -> usize {
        self.errors.len()
    }

    /// Prints the summary and returns the exit code: `done` is the number of successful inputs, and `remark` is about
    /// others that also have a result.
    ///
    /// # Errors
    /// The error of the only input, if it has one.
    pub(crate) fn end(&self, done: usize, remark: &str, skip: SkipArgs, ui: &Ui) -> Outcome {
        if let ([only], 1) = (self.errors.as_slice(), self.total) {
            return Err(Failure::refused(&only.message));
        }
        let summary = format!("{done} of {} {}{remark}", self.total, self.verb);
        if !self.errors.is_empty() {
            ui.warn(format_args!(
                "{summary}; {} could not be used:{}",
                self.errors.len(),
                indented(&folded(&self.errors))
            ));
        } else if self.total > 1 {
            ui.info(summary);
        }
        let all_well = self.errors.is_empty() || skip.skip_bad;
        Ok(if done > 0 && all_well { Exit::Success } else { Exit::Refused })
    }
}

fn indented(lines: &[String]) -> String {
    lines.iter().flat_map(|line| ["\n  ", line.as_str()]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tree(files: &[&str]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().expect("temporary folder");
        for file in files {
            let path = folder.path().join(file);
            fs::create_dir_all(path.parent().expect("a parent")).expect("folder");
            fs::write(path, "x").expect("written");
        }
        folder
    }

    fn below(items: &[Item]) -> Vec<String> {
        items.iter().map(|i| i.below.to_string_lossy().replace('\\', "/")).collect()
    }

    #[test]
    fn folders_expand_to_matching_files() {
        let folder =
            tree(&["camB/1.PNG", "camA/2.jpg", "camA/1.jpeg", "notes.txt", ".thumbs/1.jpg", "0.png"]);
        let items = expand_inputs(&[folder.path().to_owned()], &IMAGES);
        assert_eq!(below(&items), ["0.png", "camA/1.jpeg", "camA/2.jpg", "camB/1.PNG"]);
        assert!(items.iter().all(|i| i.fault.is_none() && i.path.is_file()));
        assert_eq!(names(&items), below(&items));
    }

    #[test]
    fn files_of_two_folders_do_not_collide() {
        let folder = tree(&["camA/1.jpg", "camB/1.jpg", "2.jpg"]);
        let given = ["camA", "camB", "2.jpg"].map(|name| folder.path().join(name));
        let items = expand_inputs(&given, &IMAGES);
        assert_eq!(below(&items), ["camA/1.jpg", "camB/1.jpg", "2.jpg"]);
        assert_eq!(names(&items)[1], given[1].join("1.jpg").display().to_string());
        assert_eq!(names(&items[1..]), ["1.jpg", "2.jpg"]);
    }

    #[test]
    fn missing_inputs_are_known_before_work() {
        let folder = tree(&["a.jpg", "empty/notes.txt"]);
        let given = ["a.jpg", "b.jpg", "empty"].map(|name| folder.path().join(name));
        let items = expand_inputs(&given, &IMAGES);
        let kinds: Vec<_> = items.iter().map(|i| i.fault.as_ref().map(|f| f.kind)).collect();
        assert_eq!(kinds, [None, Some(InputErrorKind::Missing), Some(InputErrorKind::Unreadable)]);
        let Err(Failure::Refused { report }) = refuse_bad(&items) else { panic!("two are bad") };
        let message = format!("{report:?}");
        assert!(
            message.contains("2 of 3") && message.contains("b.jpg") && message.contains("no JPEG, PNG"),
            "{message}"
        );
    }

    #[test]
    fn images_of_other_formats_are_counted() {
        let folder = tree(&["a.jpg", "b.TIFF", "sub/c.tif", "sub/d.avif", "notes.txt", ".thumbs/e.avif"]);
        assert_eq!(unread_images(folder.path()).as_deref(), Some("1 AVIF file and 2 TIFF files"));
        let folder = tree(&["a.avif"]);
        let items = expand_inputs(&[folder.path().to_owned()], &IMAGES);
        let message = items[0].fault.as_ref().expect("nothing to read").message.clone();
        assert!(message.contains("no JPEG, PNG, WebP or HEIC file, but 1 AVIF file"), "{message}");
        assert_eq!(unread_images(tree(&["a.jpg", "b.txt"]).path()), None);
    }

    #[test]
    fn equal_messages_share_one_line() {
        let error = |name: &str, message: &str| {
            NamedError::new(name, &InputError::new(InputErrorKind::Unfit, message))
        };
        let errors = [
            error("a/1.jpg", "a/1.jpg: it has no EXIF"),
            error("a/2.jpg", "the file is empty"),
            error("a/3.jpg", "a/3.jpg: it has no EXIF"),
            error("a/4.jpg", "it has no EXIF"),
        ];
        let lines = folded(&errors);
        assert_eq!(
            lines,
            ["a/1.jpg: it has no EXIF (also 2 others: a/3.jpg, a/4.jpg)", "a/2.jpg: the file is empty"]
        );
    }

    #[test]
    fn errors_name_their_file_exactly_once() {
        for (name, message, named) in [
            ("1.jpg", "21.jpg: is no image", false),
            ("1.jpg", "1.jpg.txt: is no image", false),
            ("1.jpg", "the image is 1.jpg.", true),
            ("1.jpg", "photos/1.jpg: is no image", true),
            ("a", "a file that cannot be read", true),
            ("a", "no such file", false),
            ("photos", "photos/1.jpg: is no image", false),
            ("b/c d.jpg", "\"b/c d.jpg\" is no image", true),
            ("", "is no image", false),
        ] {
            let shown = InputError::new(InputErrorKind::Damaged, message).of(name);
            let expected = if named { message.to_owned() } else { format!("{name}: {message}") };
            assert_eq!(shown, expected);
        }
    }

    #[cfg(unix)]
    #[test]
    fn links_to_parent_folders_are_followed_once() {
        let folder = tree(&["a/1.jpg"]);
        std::os::unix::fs::symlink(folder.path(), folder.path().join("a/up")).expect("a link");
        assert_eq!(below(&expand_inputs(&[folder.path().to_owned()], &IMAGES)), ["a/1.jpg"]);
    }
}
