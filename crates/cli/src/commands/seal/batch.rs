//! Seals many images: selection, output files, and the summary.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;
use veiloc_features::is_marked_panorama;
use veiloc_mapping::mask_file;
use veiloc_obfuscation::Sealer;
use veiloc_protocol::{FocalKnowledge, Scheme, SessionTag};

use super::panorama::seal_panorama;
use super::rig::Rig;
use super::{Args, Attitude, RIG, Sealed, seal_one};
use crate::args::camera::{CameraSource, warn_of_turned};
use crate::commands::image_list::images_of_list;
use crate::commands::mask_args::{MaskedRegion, MaskedRegionDetector};
use crate::commands::session_args::OpenSession;
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
    /// The rig file of the images; absent without `--rig-cameras`.
    #[serde(skip_serializing_if = "Option::is_none")]
    rig: Option<String>,
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
    /// Class to number of detected and hidden objects, of `people` to the number of regions; absent without `--hide`.
    #[serde(skip_serializing_if = "Option::is_none")]
    detections: Option<BTreeMap<String, usize>>,
    /// Model of the global descriptor that was computed from the whole image and is sent (`--image-global`); absent
    /// when there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    image_global: Option<String>,
    /// The session in which it was sealed, by its name on this device: `session` of a rig file; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    session: Option<String>,
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
    /// Its session.
    pub(super) session: Option<SessionTag>,
}

impl From<Sealed> for SealedFiles {
    fn from(sealed: Sealed) -> Self {
        let Sealed { focal, bytes, found, sent, session, .. } = sealed;
        Self { files: vec![(String::new(), bytes)], focal, found, sent, result: None, session }
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
    mut session: Option<OpenSession>,
    ui: &Ui,
) -> Outcome {
    let rig = Rig::read(args)?;
    let jobs = jobs(args, rig.as_ref(), ui)?;
    let scheme = sealer.options().scheme();
    if rig.is_some() && session.is_none() && matches!(scheme, Scheme::Dcl(_)) {
        session = Some(OpenSession::of_call()?);
    }
    let scheme = scheme.to_string();
    let of_image = sealer.image_global().map(|own| own.model().name().to_owned());
    let beside = of_image.as_ref().map_or_else(String::new, |name| format!(" with {name} of the image"));
    let items: Vec<Item> = jobs.iter().map(|job| job.item.clone()).collect();
    let mut tally = BatchSummary::begin("sealed", &items, ui);
    if !args.panorama {
        warn_of_turned(jobs.iter().map(|job| (job.item.path.as_path(), job.camera)), ui);
    }
    let stage = (jobs.len() > 1).then(|| ui.stage("Sealing", jobs.len() as u64));
    let (mut images, mut on_rig) = (Vec::new(), Vec::new());
    for (number, job) in jobs.iter().enumerate() {
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
                        let orientation = match &rig {
                            Some(rig) => rig.orientation(number),
                            None => args.session.camera_orientation(gravity),
                        };
                        let attitude = Attitude { orientation, gravity };
                        let session = session.as_mut();
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
                on_rig.push((number, sealed.session));
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
    // Last: without it the others are no answerable query.
    let rig = rig.filter(|_| sealed > 0).map(|rig| {
        let path = args.out.join(RIG);
        files::write_or_print(&path, &rig.file(&on_rig)?, ui)?;
        ui.info(format!("{}: {sealed} cameras", path.display()));
        Ok::<_, Failure>(path.display().to_string())
    });
    let rig = rig.transpose()?;
    if args.json {
        ui.json(&SealDocument { version: 1, scheme, rig, sealed, failed, images })?;
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
        session: sealed.as_ref().and_then(|s| s.session).map(|session| session.to_string()),
        focal_known: sealed.as_ref().map(|s| s.focal.name()),
        error,
    }
}

/// Returns the images with their cameras and output files.
fn jobs(args: &Args, rig: Option<&Rig>, ui: &Ui) -> Result<Vec<SealJob>, Failure> {
    let with_cameras = images(args, rig, ui)?;
    let several =
        with_cameras.len() > 1 || args.list.is_some() || args.images.iter().any(|path| path.is_dir());
    let ends_in_slash = args.out.as_os_str().to_string_lossy().ends_with(['/', std::path::MAIN_SEPARATOR]);
    let into_folder = several || ends_in_slash || args.out.is_dir() || args.panorama || rig.is_some();
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
    if several && args.session.has_orientation() && rig.is_none() {
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
        .enumerate()
        .map(|(number, (item, camera))| {
            let into_folder = into_folder && !standard;
            let out = if let Some(rig) = rig {
                args.out.join(rig.query_name(number))
            } else if into_folder {
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
fn images(args: &Args, rig: Option<&Rig>, ui: &Ui) -> Result<Vec<(Item, CameraSource)>, Failure> {
    if args.images.iter().any(|path| files::is_standard(path)) {
        return Err(Failure::with_help("-: images are not read from stdin", "give a file or a folder"));
    }
    if let Some(list) = &args.list {
        let folder = lists::single_folder(&args.images)?;
        return images_of_list(list, folder, &args.device, args.camera.as_ref());
    }
    let items = items::expand_images(&args.images, ui);
    if let Some(rig) = rig {
        return rig.images(items, args);
    }
    let camera = args.device.camera(args.camera.as_ref())?;
    Ok(items.into_iter().map(|item| (item, camera)).collect())
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
