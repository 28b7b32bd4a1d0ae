//! Lists of images: one name per line, optionally with a camera after it as in hloc.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use veiloc_geometry::{CameraModel, Intrinsics, IntrinsicsError};
use veiloc_map::text::text_of;

use crate::output::exit::Failure;
use crate::output::files;

/// A line of a list.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ListedImage {
    /// Name of the image, relative to the folder of the images; it may contain spaces, as in COLMAP.
    pub name: String,
    /// Its camera, if the list has one.
    pub camera: Option<Intrinsics>,
    /// Line number, from 1.
    pub line: usize,
}

/// Reads a list of names with or without cameras; empty lines and lines that begin with `#` are ignored.
///
/// # Errors
/// The file cannot be read, is not text, has no name or one name twice, or has an invalid camera.
pub(crate) fn read_with_cameras(path: &Path) -> Result<Vec<ListedImage>, Failure> {
    let refused = |what: String, help: &str| Failure::with_help(format!("{}: {what}", path.display()), help);
    let text = text_of(files::read(path)?)
        .map_err(|_| refused("is not text".to_owned(), "give a text file with one image name per line"))?;
    let mut listed = Vec::new();
    let mut seen = BTreeSet::new();
    for (line, words) in (1..).zip(text.lines().map(str::trim)) {
        if words.is_empty() || words.starts_with('#') {
            continue;
        }
        let (name, camera) = name_and_camera(words);
        let camera = camera.map(intrinsics).transpose().map_err(|e| {
            refused(
                format!("line {line}: {e}"),
                "a name may be followed by its camera, MODEL W H PARAMS…, and by nothing else",
            )
        })?;
        if !seen.insert(name) {
            return Err(refused(format!("{name} occurs twice"), "list every image once"));
        }
        listed.push(ListedImage { name: name.to_owned(), camera, line });
    }
    if listed.is_empty() {
        return Err(refused(
            "names no image".to_owned(),
            "write one image name per line, relative to the folder of the images",
        ));
    }
    Ok(listed)
}

/// Reads a list of names for a command that gets its cameras from another source: a camera in the list would be
/// ignored, and is refused.
///
/// # Errors
/// As [`read_with_cameras`], and if a line has a camera.
pub(crate) fn read_list(path: &Path) -> Result<Vec<String>, Failure> {
    let listed = read_with_cameras(path)?;
    if let Some(with) = listed.iter().find(|l| l.camera.is_some()) {
        return Err(Failure::with_help(
            format!(
                "{}: line {}: a camera follows the name, and it would not be used: cameras are those of \
                 the COLMAP model",
                path.display(),
                with.line
            ),
            "check that the model's cameras are correct, and give a list of names only",
        ));
    }
    Ok(listed.into_iter().map(|l| l.name).collect())
}

/// Returns the folder that the names of a list are relative to.
///
/// # Errors
/// Not exactly one folder is given.
pub(crate) fn single_folder(given: &[PathBuf]) -> Result<&Path, Failure> {
    match given {
        [folder] if folder.is_dir() => Ok(folder),
        [file] => Err(Failure::with_help(
            format!("--list needs a folder, and {} is not a folder", file.display()),
            "give the folder that the names of the list are relative to",
        )),
        _ => Err(Failure::with_help(
            "--list needs exactly one folder, and several inputs are given",
            "give only the folder that the names of the list are relative to",
        )),
    }
}

/// Parses a camera: `MODEL,W,H,PARAMS…` or, as in hloc, `MODEL W H PARAMS…`.
///
/// # Errors
/// The text is not a camera.
pub(crate) fn intrinsics(text: &str) -> Result<Intrinsics, IntrinsicsError> {
    text.parse()
}

/// Splits `name MODEL W H PARAMS…`. A model is recognized by its spelling in capitals, so that an unknown model is not
/// taken for a part of the name, and a known model in small letters too.
fn name_and_camera(line: &str) -> (&str, Option<&str>) {
    line.match_indices(char::is_whitespace)
        .map(|(at, _)| (line[..at].trim_end(), line[at..].trim_start()))
        .find(|(_, rest)| is_camera(rest))
        .map_or((line, None), |(name, rest)| (name, Some(rest)))
}

fn is_camera(text: &str) -> bool {
    let mut words = text.split_whitespace();
    let is_model = |word: &str| {
        if CameraModel::is_name(word) {
            return true;
        }
        word.starts_with(|c: char| c.is_ascii_uppercase())
            && word.chars().all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_')
    };
    let size = |word: Option<&str>| word.is_some_and(|w| w.parse::<f64>().is_ok_and(|side| side >= 0.0));
    words.next().is_some_and(is_model) && size(words.next()) && size(words.next())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list_file(text: impl AsRef<[u8]>) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("list");
        files::write(&path, text.as_ref()).expect("written");
        (folder, path)
    }

    /// Lines of Aachen's `day_time_queries_with_intrinsics.txt`, as hloc reads it, and a name with a space.
    const HLOC: &str = "\
# queries
query/day/nexus4/IMG_20140520_182846.jpg SIMPLE_RADIAL 1600 1200 1469.2 800 600 -0.0353019
query/day/milestone/2011-12-17_14-28-15_257.jpg SIMPLE_RADIAL 1024 768 977.494 512 384 0.0476376

  b/c d.jpg PINHOLE 640 480 500 500 320 240\r
a GIRL 3 of 4.jpg
";

    #[test]
    fn cameras_after_names_are_read() {
        let (_folder, path) = list_file(HLOC);
        let listed = read_with_cameras(&path).expect("a list");
        let names: Vec<&str> = listed.iter().map(|l| l.name.as_str()).collect();
        assert_eq!(
            names,
            [
                "query/day/nexus4/IMG_20140520_182846.jpg",
                "query/day/milestone/2011-12-17_14-28-15_257.jpg",
                "b/c d.jpg",
                "a GIRL 3 of 4.jpg"
            ]
        );
        let camera = |text: &str| Some(text.parse::<Intrinsics>().expect("a camera"));
        assert_eq!(listed[0].camera, camera("SIMPLE_RADIAL,1600,1200,1469.2,800,600,-0.0353019"));
        assert_eq!(listed[2].camera, camera("PINHOLE,640,480,500,500,320,240"));
        assert_eq!((listed[3].camera, listed[3].line), (None, 6));
    }

    #[test]
    fn lists_of_other_programs_are_read() {
        let text = "\u{feff}a.jpg pinhole 640.0 480.0 500 500 320 240\r\na girl 3 of 4.jpg\r\n";
        let (_folder, path) = list_file(text);
        let listed = read_with_cameras(&path).expect("a list");
        assert_eq!(listed[0].name, "a.jpg", "the byte order mark is no part of the name");
        assert_eq!(listed[0].camera, "PINHOLE,640,480,500,500,320,240".parse().ok());
        assert_eq!((listed[1].name.as_str(), listed[1].camera), ("a girl 3 of 4.jpg", None));
    }

    #[test]
    fn unused_cameras_are_refused() {
        let (_folder, path) = list_file(HLOC);
        let Err(Failure::Refused { report }) = read_list(&path) else { panic!("dropped") };
        // The report breaks lines.
        let message = format!("{report:?}").split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(message.contains("line 2") && message.contains("names only"), "{message}");
        let (_folder, path) = list_file("a.jpg\nb c.jpg\r\n");
        assert_eq!(read_list(&path).expect("names"), ["a.jpg", "b c.jpg"]);
    }

    #[test]
    fn invalid_lists_are_refused() {
        for text in [
            "\n# nothing\n".as_bytes(),
            b"a.jpg\nb.jpg\na.jpg\n",
            b"a.jpg PINHOLE 640 480 1 1 1 1\na.jpg PINHOLE 640 480 2 2 1 1\n",
            b"a.jpg SPHERICAL 640 480 1 1 1 1 0\n",
            b"a.jpg PINHOLE 640 480 1 1 1\n",
            &[0xff, 0xfe],
        ] {
            let (_folder, path) = list_file(text);
            assert!(read_with_cameras(&path).is_err(), "{}", String::from_utf8_lossy(text));
        }
    }
}
