//! Cameras on the command line: COLMAP's text form with commas or spaces, a `cameras.txt`, or a map.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use veiloc_features::{DisplayTurn, FeatureError, display_turn};
use veiloc_geometry::Intrinsics;
use veiloc_map::MapFile;
use veiloc_map::text::text_of;
use veiloc_obfuscation::KnownCamera;
use veiloc_protocol::FocalKnowledge;

use crate::output::exit::Failure;
use crate::output::files;
use crate::output::lists::intrinsics;
use crate::output::ui::Ui;

/// The camera of all images given.
#[derive(Debug, Clone)]
pub(crate) enum CameraArg {
    /// Written out.
    Written(Intrinsics),
    /// In a file, in a folder of a COLMAP model, or that of a map's images.
    In(PathBuf),
    /// The user does not know it.
    Unknown,
}

impl FromStr for CameraArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        if text == "unknown" {
            return Ok(Self::Unknown);
        }
        let path = Path::new(text);
        let named_as_one = path.extension().is_some_and(|e| e == "txt" || e == "bin" || e == "vmap");
        if named_as_one || path.exists() {
            return Ok(Self::In(path.to_owned()));
        }
        intrinsics(text).map(Self::Written).map_err(|e| e.to_string())
    }
}

impl CameraArg {
    /// Returns the source of each image's camera, with the given knowledge of its focal length.
    ///
    /// # Errors
    /// The file cannot be read, or does not hold exactly one camera.
    pub(crate) fn source(&self, focal: FocalKnowledge) -> Result<CameraSource, Failure> {
        let intrinsics = match self {
            Self::Written(camera) => *camera,
            Self::In(path) if path.extension().is_some_and(|e| e == "vmap") => camera_of_map(path)?,
            Self::In(path) if path.is_dir() => only_camera(&path.join("cameras.txt"))?,
            Self::In(path) => only_camera(path)?,
            Self::Unknown => return Ok(CameraSource::Assumed),
        };
        Ok(CameraSource::Given(KnownCamera { intrinsics, focal }))
    }
}

/// Where the camera of an image comes from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum CameraSource {
    /// The user gave it.
    Given(KnownCamera),
    /// The focal length comes from the image's EXIF data.
    Exif,
    /// The camera is unknown; its focal length is estimated from the image size.
    Assumed,
}

impl CameraSource {
    /// Returns the camera of this image.
    ///
    /// # Errors
    /// EXIF has no focal length, or the file is not an image.
    pub(crate) fn of(self, image: &Path) -> Result<KnownCamera, FeatureError> {
        match self {
            Self::Given(camera) => Ok(camera),
            Self::Exif => KnownCamera::from_exif(image),
            Self::Assumed => KnownCamera::guessed(image),
        }
    }
}

/// Warns of images that are shown rotated or mirrored because of their EXIF orientation: the pose is that of the image
/// as it is stored. With a given camera there is no warning: it has the size of the stored image.
pub(crate) fn warn_of_turned<'a>(images: impl IntoIterator<Item = (&'a Path, CameraSource)>, ui: &Ui) {
    let (mut count, mut turned): (usize, Vec<(&Path, DisplayTurn)>) = (0, Vec::new());
    for (path, camera) in images {
        count += 1;
        if !matches!(camera, CameraSource::Given(_)) {
            turned.extend(display_turn(path).map(|turn| (path, turn)));
        }
    }
    let Some((first, turn)) = turned.first() else { return };
    let first = first.display();
    let (who, sealed) = match (turned.len(), count) {
        (1, _) => (format!("{first} is"), "It is sealed as it is stored, and its pose is"),
        (n, all) => (
            format!("{n} of {all} images are, for example {first},"),
            "They are sealed as they are stored, and their poses are",
        ),
    };
    ui.warn(format_args!(
        "warning: {who} {turn} for display, because of the EXIF orientation. {sealed} that of the stored image; turn the \
         pixels first for the pose of the image as it is displayed"
    ));
}

/// The one camera of a map's images.
fn camera_of_map(path: &Path) -> Result<Intrinsics, Failure> {
    let map = MapFile::open(path)?;
    let mut cameras: Vec<&Intrinsics> = Vec::new();
    for image in map.images() {
        if !cameras.contains(&image.camera()) {
            cameras.push(image.camera());
        }
    }
    match cameras.as_slice() {
        [camera] => Ok(**camera),
        several => Err(Failure::with_help(
            format!(
                "{}: its images have {} cameras, and exactly one is expected",
                path.display(),
                several.len()
            ),
            "`veiloc map info --images` lists them; give the one of the queries with --camera MODEL,W,H,PARAMS…",
        )),
    }
}

/// The one camera of a COLMAP `cameras.txt`: lines of `CAMERA_ID MODEL W H PARAMS…`.
fn only_camera(path: &Path) -> Result<Intrinsics, Failure> {
    let refused =
        |reason: String, help: &str| Failure::with_help(format!("{}: {reason}", path.display()), help);
    let text = text_of(files::read(path)?).map_err(|_| {
        refused(
            "is not text".to_owned(),
            "give a map (.vmap) or a cameras.txt; `colmap model_converter --output_type TXT` converts a binary model",
        )
    })?;
    let mut cameras: Vec<Intrinsics> = Vec::new();
    for (number, line) in (1..).zip(text.lines().map(str::trim)) {
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let camera = match line.split_once(char::is_whitespace) {
            Some((id, camera)) if id.parse::<u32>().is_ok() => camera,
            _ => line,
        };
        let camera = intrinsics(camera)
            .map_err(|e| refused(format!("line {number}: {e}"), "give a cameras.txt as COLMAP writes it"))?;
        if !cameras.contains(&camera) {
            cameras.push(camera);
        }
    }
    match cameras.as_slice() {
        [camera] => Ok(*camera),
        [] => Err(refused("holds no camera".to_owned(), "give a cameras.txt as COLMAP writes it")),
        several => Err(refused(
            format!("holds {} cameras, and exactly one is expected", several.len()),
            "write the camera of each image after its name into a list (name MODEL W H PARAMS…), and give \
             the list with --list instead of --camera",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: &str = "SIMPLE_RADIAL,1600,1200,1469.2,800,600,-0.0353019";

    fn camera(text: &str) -> Result<Intrinsics, Failure> {
        match CameraArg::from_str(text).expect("a camera").source(FocalKnowledge::Exif)? {
            CameraSource::Given(KnownCamera { intrinsics, focal: FocalKnowledge::Exif }) => Ok(intrinsics),
            other => panic!("{other:?}"),
        }
    }

    fn in_file(text: &str) -> Result<Intrinsics, Failure> {
        let folder = tempfile::tempdir().expect("temporary folder");
        std::fs::write(folder.path().join("cameras.txt"), text).expect("written");
        let of_folder = camera(&folder.path().to_string_lossy());
        let of_file = camera(&folder.path().join("cameras.txt").to_string_lossy());
        assert_eq!(of_folder.ok(), of_file.as_ref().ok().copied());
        of_file
    }

    #[test]
    fn camera_text_forms_are_equivalent() {
        let camera: Intrinsics = CAMERA.parse().expect("a camera");
        let with_spaces = CAMERA.replace(',', " ");
        for text in [CAMERA, &with_spaces, &CAMERA.replace(',', ", "), &format!("  {with_spaces}\t")] {
            assert!(matches!(text.parse(), Ok(CameraArg::Written(c)) if c == camera), "{text}");
        }
        let file = format!("# Camera list\n#   CAMERA_ID, MODEL, …\n1 {with_spaces}\n\n7 {with_spaces}\n");
        assert_eq!(in_file(&file).expect("one camera, twice"), camera);
        assert_eq!(in_file(&with_spaces).expect("without an id"), camera);
        assert_eq!(in_file(&format!("\u{feff}1 {with_spaces}")).expect("a byte order mark"), camera);
    }

    #[test]
    fn invalid_cameras_are_refused_with_remedy() {
        let check_refusal = |text: &str, words: &[&str]| {
            let Err(Failure::Refused { report }) = in_file(text) else { panic!("{text} was taken") };
            let message = format!("{report:?}");
            assert!(words.iter().all(|word| message.contains(word)), "{message}");
        };
        check_refusal(
            "1 PINHOLE 4 3 1 1 2 2\n2 PINHOLE 8 6 1 1 4 3\n",
            &["cameras.txt", "2 cameras", "--list"],
        );
        check_refusal("# nothing\n", &["no camera"]);
        check_refusal("1 PINHOLE 4 3 1 1 2\n", &["line 1"]);
        assert!("nonsense".parse::<CameraArg>().is_err());
        assert!(matches!(camera("no/such/cameras.txt"), Err(Failure::Refused { .. })));
        let unknown = "unknown".parse::<CameraArg>().expect("a word").source(FocalKnowledge::Calibrated);
        assert!(matches!(unknown, Ok(CameraSource::Assumed)), "an assumed camera is never calibrated");
    }
}
