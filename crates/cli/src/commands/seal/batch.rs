//! Seals many images: selection, output files, and the summary.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;
use veiloc_client::SessionFile;
use veiloc_features::is_marked_panorama;
use veiloc_mapping::mask_file;
use veiloc_obfuscation::Sealer;
use veiloc_protocol::FocalKnowledge;

use super::panorama::seal_panorama;
use super::{Args, Attitude, Sealed, seal_one};
use crate::args::camera::{CameraSource, warn_of_turned};
use crate::commands::image_list::images_of_list;
use crate::commands::mask_args::{MaskedRegion, MaskedRegionDetector};
use crate::output::exit::{Failure, Outcome};
use crate::output::files;
use crate::output::items::{self, BatchSummary, InputError, InputErrorKind, Item};
use crate::output::lists;
use crate::output::ui::Ui;

/// One entry of `images` for each image.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct SealDocument {
    /// 1.
    version: u32,
    /// Obfuscation scheme.
    scheme: String,
    /// Number of sealed images.
    sealed: usize,
    /// Number of images that were not sealed.
    failed: usize,
    /// The images, in the order given.
    images: Vec<ImageDocument>,
}

/// An image. The fields from `out` to `focal_known` are absent when it was not sealed.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct ImageDocument {
    /// The image.
    file: String,
    /// Whether it was sealed.
    status: SealStatus,
    /// File of the sealed query, or of a panorama its rig file; absent when failed.
    #[serde(skip_serializing_if = "Option::is_none")]
    out: Option<String>,
    /// Number of keypoints found in the image; absent when failed.
    #[serde(skip_serializing_if = "Option::is_none")]
    keypoints: Option<usize>,
    /// Number of rows of the query, decoys included; absent when failed.
    #[serde(skip_serializing_if = "Option::is_none")]
    sent_rows: Option<usize>,
    /// Bytes of the sealed query; absent when failed.
    #[serde(skip_serializing_if = "Option::is_none")]
    bytes: Option<usize>,
    /// Share of the image that a mask hides; absent when nothing is hidden.
    #[serde(skip_serializing_if = "Option::is_none")]
    masked: Option<f64>,
    /// Class to number of detected and hidden objects; absent without `--hide`.
    #[serde(skip_serializing_if = "Option::is_none")]
    detections: Option<BTreeMap<String, usize>>,
    /// Model of the global descriptor that was computed from the whole image and is sent (`--image-global`); absent
    /// when there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    image_global: Option<String>,
    /// How the focal length is known, as stated in the query: `calibrated`, `exif` or `unknown`; absent when failed.
    #[serde(skip_serializing_if = "Option::is_none")]
    focal_known: Option<&'static str>,
    /// Why the image was not sealed; absent when sealed.
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<InputError>,
}

#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
enum SealStatus {
    Sealed,
    Failed,
}

/// What an image becomes.
pub(super) struct SealedFiles {
    /// Names in the folder of the output, and bytes; one with an empty name is the output itself.
    pub(super) files: Vec<(String, Vec<u8>)>,
    /// Knowledge of the focal length.
    pub(super) focal: FocalKnowledge,
    /// Number of keypoints.
    pub(super) found: usize,
    /// Rows sent.
    pub(super) sent: usize,
    /// The file that stands for all, if there are several.
    pub(super) result: Option<&'static str>,
}

impl From<Sealed> for SealedFiles {
    fn from(sealed: Sealed) -> Self {
        let Sealed { focal, bytes, found, sent, .. } = sealed;
        Self { files: vec![(String::new(), bytes)], focal, found, sent, result: None }
    }
}

impl SealedFiles {
    fn bytes(&self) -> usize {
        self.files.iter().map(|(_, bytes)| bytes.len()).sum()
    }

    fn result_in(&self, out: &Path) -> PathBuf {
        self.result.map_or_else(|| out.to_owned(), |name| out.join(name))
    }

    /// Writes the files; a failure ends the command, because the others could not be written either.
    fn write(&self, out: &Path, ui: &Ui) -> Result<(), Failure> {
        for (name, bytes) in &self.files {
            let path = if name.is_empty() { out.to_owned() } else { out.join(name) };
            if let Some(folder) = path.parent().filter(|p| !p.as_os_str().is_empty() && !p.exists()) {
                files::make_folder(folder)?;
            }
            files::write_or_print(&path, bytes, ui)?;
        }
        Ok(())
    }
}

/// An image to seal.
struct SealJob {
    item: Item,
    camera: CameraSource,
    out: PathBuf,
    /// The mask's file.
    mask: Option<PathBuf>,
}

pub(super) fn run(
    args: &Args,
    sealer: &Sealer,
    hiding: &MaskedRegionDetector,
    mut session: Option<&mut SessionFile>,
    ui: &Ui,
) -> Outcome {
    let jobs = jobs(args, ui)?;
    let scheme = sealer.options().scheme().to_string();
    let of_image = sealer.image_global().map(|own| own.model().name().to_owned());
    let beside = of_image.as_ref().map_or_else(String::new, |name| format!(" with {name} of the image"));
    let items: Vec<Item> = jobs.iter().map(|job| job.item.clone()).collect();
    let mut tally = BatchSummary::begin("sealed", &items, ui);
    if !args.panorama {
        warn_of_turned(jobs.iter().map(|job| (job.item.path.as_path(), job.camera)), ui);
    }
    let stage = (jobs.len() > 1).then(|| ui.stage("Sealing", jobs.len() as u64));
    let mut images = Vec::new();
    for job in &jobs {
        let name = job.item.path.display().to_string();
        let sealed = if let Some(fault) = &job.item.fault {
            Err(fault.clone())
        } else if !args.panorama && is_marked_panorama(&job.item.path) {
            Err(InputError::new(
                InputErrorKind::Unfit,
                "it is an equirectangular panorama, as its metadata says; seal it with --panorama",
            ))
        } else {
            match hiding.of(&job.item.path, job.mask.as_deref()) {
                Ok(hidden) => {
                    let mask = hidden.mask.as_ref();
                    let sealed = if args.panorama {
                        seal_panorama(&job.item.path, sealer, mask)?
                    } else {
                        let gravity = args.device.gravity();
                        let attitude =
                            Attitude { orientation: args.session.camera_orientation(gravity), gravity };
                        let session = session.as_deref_mut();
                        seal_one(&job.item.path, job.camera, sealer, mask, attitude, session)?
                            .map(SealedFiles::from)
                    };
                    sealed.map(|sealed| (sealed, hidden))
                }
                Err(fault) => Err(fault),
            }
        };
        match &sealed {
            Ok((sealed, hidden)) => {
                sealed.write(&job.out, ui)?;
                let line = format!(
                    "{name}: {}{} keypoints, {} sent as {scheme}{beside}, {} bytes → {}",
                    hidden.description(),
                    sealed.found,
                    sealed.sent,
                    sealed.bytes(),
                    if files::is_standard(&job.out) {
                        "stdout".into()
                    } else {
                        sealed.result_in(&job.out).display().to_string()
                    }
                );
                match &stage {
                    Some(stage) => stage.suspend(|| ui.info(line)),
                    None => ui.info(line),
                }
            }
            Err(fault) => tally.failed(&name, fault),
        }
        images.push(document_of(name, &job.out, sealed, of_image.as_ref()));
        if let Some(stage) = &stage {
            stage.advance(1);
        }
    }
    if let Some(stage) = &stage {
        stage.finish();
    }
    let failed = tally.failures();
    let sealed = jobs.len() - failed;
    if args.json {
        ui.json(&SealDocument { version: 1, scheme, sealed, failed, images })?;
    }
    tally.end(sealed, "", args.skip, ui)
}

fn document_of(
    file: String,
    out: &Path,
    sealed: Result<(SealedFiles, MaskedRegion), InputError>,
    of_image: Option<&String>,
) -> ImageDocument {
    let (status, sealed, hidden, error) = match sealed {
        Ok((sealed, hidden)) => (SealStatus::Sealed, Some(sealed), hidden, None),
        Err(fault) => (SealStatus::Failed, None, MaskedRegion::default(), Some(fault)),
    };
    ImageDocument {
        file,
        status,
        out: sealed.as_ref().map(|sealed| sealed.result_in(out).display().to_string()),
        keypoints: sealed.as_ref().map(|s| s.found),
        sent_rows: sealed.as_ref().map(|s| s.sent),
        bytes: sealed.as_ref().map(SealedFiles::bytes),
        masked: hidden.share(),
        detections: hidden.found.map(|found| found.into_iter().collect()),
        image_global: sealed.as_ref().and(of_image).cloned(),
        focal_known: sealed.as_ref().map(|s| s.focal.name()),
        error,
    }
}

/// Returns the images with their cameras and output files.
fn jobs(args: &Args, ui: &Ui) -> Result<Vec<SealJob>, Failure> {
    let with_cameras = images(args, ui)?;
    let several =
        with_cameras.len() > 1 || args.list.is_some() || args.images.iter().any(|path| path.is_dir());
    let ends_in_slash = args.out.as_os_str().to_string_lossy().ends_with(['/', std::path::MAIN_SEPARATOR]);
    let into_folder = several || ends_in_slash || args.out.is_dir() || args.panorama;
    let standard = files::is_standard(&args.out);
    if several && args.device.has_gravity() {
        return Err(Failure::with_help(
            "--gravity is for one image, and several are given",
            "seal each image in a separate call, with the direction measured when it was taken",
        ));
    }
    if several && args.mask.has_mask() {
        return Err(Failure::with_help(
            "--mask is for one image, and several are given",
            "give the folder of their masks with --masks, or seal each image in a separate call",
        ));
    }
    if several && args.session.has_orientation() {
        return Err(Failure::with_help(
            "--orientation is for one image, and several are given",
            "seal each image in a separate call, with --session and its orientation",
        ));
    }
    if standard && (several || args.json || args.panorama) {
        return Err(Failure::with_help(
            "--out -: stdout can hold one sealed query and nothing else",
            "give a folder with --out",
        ));
    }
    let jobs: Vec<SealJob> = with_cameras
        .into_iter()
        .map(|(item, camera)| {
            let into_folder = into_folder && !standard;
            let out = if into_folder {
                args.out.join(item.below.with_extension(if args.panorama { "" } else { "vquery" }))
            } else {
                args.out.to_path_buf()
            };
            let mask = match &args.masks {
                Some(folder) => Some(mask_file(folder, item.name())),
                None => args.mask.file().map(Path::to_owned),
            };
            SealJob { item, camera, out, mask }
        })
        .collect();
    refuse_collisions(&jobs)?;
    refuse_overwriting_input(args, &jobs)?;
    if into_folder && !standard {
        if jobs.iter().any(|job| job.item.fault.is_none()) {
            files::make_folder(&args.out)?;
        }
    } else if let Some(missing) = args.out.parent().filter(|p| !p.as_os_str().is_empty() && !p.is_dir()) {
        // The folder of a single output file is not created: a typing error would put the query into an unexpected
        // folder.
        return Err(Failure::with_help(
            format!("{}: there is no folder {}", args.out.display(), missing.display()),
            "create the folder, or choose another --out",
        ));
    }
    Ok(jobs)
}

/// Returns the images, each with its camera.
fn images(args: &Args, ui: &Ui) -> Result<Vec<(Item, CameraSource)>, Failure> {
    if args.images.iter().any(|path| files::is_standard(path)) {
        return Err(Failure::with_help("-: images are not read from stdin", "give a file or a folder"));
    }
    let Some(list) = &args.list else {
        let camera = args.device.camera(args.camera.as_ref())?;
        return Ok(items::expand_images(&args.images, ui).into_iter().map(|item| (item, camera)).collect());
    };
    images_of_list(list, lists::single_folder(&args.images)?, &args.device, args.camera.as_ref())
}

/// Two images of the same name would overwrite each other's query.
fn refuse_collisions(jobs: &[SealJob]) -> Result<(), Failure> {
    for (i, a) in jobs.iter().enumerate() {
        if let Some(b) = jobs[..i].iter().find(|b| a.out == b.out) {
            return Err(Failure::with_help(
                format!(
                    "{} and {} would both be written to {}",
                    b.item.path.display(),
                    a.item.path.display(),
                    a.out.display()
                ),
                "give their common parent folder, which preserves the sub-folders, or seal them in two \
                 calls with different --out folders",
            ));
        }
    }
    Ok(())
}

/// Refuses an output that overwrites an image, the profile or a list.
fn refuse_overwriting_input(args: &Args, jobs: &[SealJob]) -> Result<(), Failure> {
    let masks = jobs.iter().filter_map(|job| job.mask.as_ref());
    let images = jobs.iter().map(|job| &job.item.path);
    let given = images.chain(masks).chain([&args.profile]).chain(&args.list).chain(args.mask.detector());
    let inputs: Vec<PathBuf> = given.filter_map(|path| path.canonicalize().ok()).collect();
    for job in jobs {
        if job.out.canonicalize().is_ok_and(|out| inputs.contains(&out)) {
            return Err(Failure::with_help(
                format!("{} is an input, and would be overwritten by the sealed query", job.out.display()),
                "choose another --out",
            ));
        }
    }
    Ok(())
}
