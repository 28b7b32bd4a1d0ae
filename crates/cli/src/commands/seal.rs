//! `veiloc seal`: images to sealed queries, as a device does it.

use std::path::{Path, PathBuf};

use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{device_rng, extract, seal_at_most};
use veiloc_query::{Profile, Scheme};

use crate::exit::{Exit, Failure, Outcome};
use crate::files;
use crate::ui::Ui;

/// Turn images into sealed queries.
///
/// A sealed query holds descriptors and lines, never keypoints; it is all a server gets. Nothing of the file but its
/// pixels is read: no EXIF, no time, no place. Everything random comes from the operating system's generator, so
/// sealing one image twice gives two different queries; never send both (see docs/privacy.md, rule L7).
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Images, JPEG or PNG, all taken with the camera given.
    #[arg(required = true, value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// The camera: COLMAP's model name, width, height and parameters, for example
    /// SIMPLE_RADIAL,1296,1936,2435.4,648,968,-0.034.
    #[arg(long, value_name = "MODEL,W,H,PARAMS…")]
    camera: Intrinsics,
    /// The map's profile, as `veiloc map profile` writes it.
    #[arg(long, value_name = "FILE")]
    profile: PathBuf,
    /// How keypoints are hidden: dcl, dcl:horizontal, dcl:angle=DEGREES, random-lines, coordinate-permutation, or
    /// points (no protection). Default: what the profile asks for.
    #[arg(long)]
    scheme: Option<Scheme>,
    #[command(flatten)]
    amount: AmountArgs,
    /// File to write, or a folder when there are several images.
    #[arg(long, short, value_name = "OUT")]
    out: PathBuf,
}

/// How much a device sends, of its own will.
#[derive(clap::Args)]
pub(crate) struct AmountArgs {
    /// Send at most N keypoints, the strongest, cut to a size class (256, 512, 1024, 2048); what is not sent is not
    /// leaked, and the pose gets a little less exact (docs/audit.md). Default: as many as the profile asks for.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(256..=4096))]
    max_keypoints: Option<u32>,
}

impl AmountArgs {
    /// Most keypoints to send.
    pub(crate) fn most(&self) -> usize {
        self.max_keypoints.map_or(usize::MAX, |n| n as usize)
    }
}

pub(crate) fn run(args: &Args, ui: &Ui) -> Outcome {
    let mut profile = read_profile(&args.profile)?;
    if let Some(scheme) = args.scheme {
        profile = profile.with_scheme(scheme);
    }
    let scheme = profile.scheme();
    let into_folder = args.images.len() > 1 || args.out.is_dir();
    let outputs = args.images.iter().map(|image| target(image, &args.out, into_folder)).collect::<Vec<_>>();
    refuse_collisions(&args.images, &outputs)?;
    refuse_overwriting_input(args, &outputs)?;
    if into_folder {
        files::make_folder(&args.out)?;
    }

    let bar = ui.bar("Sealing", args.images.len() as u64);
    for (image, out) in args.images.iter().zip(&outputs) {
        let (features, camera) = extract(image, &args.camera, &profile)?;
        let found = features.keypoints.len();
        let query = seal_at_most(features, &camera, &profile, args.amount.most(), &mut device_rng()?)
            .map_err(|e| Failure::refused(format!("{}: {e}", image.display())))?;
        let bytes = query.encode();
        files::write(out, &bytes)?;
        ui.say(format!(
            "{}: {found} keypoints, {} sent as {scheme}, {} bytes → {}",
            image.display(),
            query.len(),
            bytes.len(),
            out.display()
        ));
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(Exit::Success)
}

/// Reads a profile file.
pub(crate) fn read_profile(path: &Path) -> Result<Profile, Failure> {
    Profile::decode(&files::read(path)?).map_err(|e| {
        Failure::with_help(
            format!("{}: {e}", path.display()),
            "export the profile again with `veiloc map profile MAP -o FILE`",
        )
    })
}

fn target(image: &Path, out: &Path, into_folder: bool) -> PathBuf {
    if !into_folder {
        return out.to_owned();
    }
    let mut name = image.file_stem().unwrap_or_default().to_owned();
    name.push(".vquery");
    out.join(name)
}

/// Two images of one name would overwrite each other's query.
fn refuse_collisions(images: &[PathBuf], outputs: &[PathBuf]) -> Result<(), Failure> {
    for (i, a) in outputs.iter().enumerate() {
        if let Some(j) = outputs[..i].iter().position(|b| a == b) {
            return Err(Failure::with_help(
                format!(
                    "{} and {} would both be written to {}",
                    images[j].display(),
                    images[i].display(),
                    a.display()
                ),
                "seal them in two calls with different --out folders",
            ));
        }
    }
    Ok(())
}

/// Nobody means to lose an image or the profile.
fn refuse_overwriting_input(args: &Args, outputs: &[PathBuf]) -> Result<(), Failure> {
    let inputs: Vec<PathBuf> =
        args.images.iter().chain([&args.profile]).filter_map(|path| path.canonicalize().ok()).collect();
    for out in outputs {
        if out.canonicalize().is_ok_and(|out| inputs.contains(&out)) {
            return Err(Failure::with_help(
                format!("{} is an input, and would be overwritten by the sealed query", out.display()),
                "choose another --out",
            ));
        }
    }
    Ok(())
}
