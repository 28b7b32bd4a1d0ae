//! `veiloc query send`: image in, pose out, and only sealed bytes on the way.

use std::path::PathBuf;

use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{device_rng, extract, seal};
use veiloc_query::Answer;
use veiloc_server::AnswerDocument;

use super::client::{Client, Connection};
use super::profile_cache::ProfileCache;
use crate::commands::device_args::DeviceArgs;
use crate::exit::{Exit, Failure, Outcome};
use crate::ui::Ui;

/// Seal one image, send it, print the pose.
///
/// What is sent holds descriptors and lines, never pixels or keypoints. The image is sealed once; when the service
/// is busy or the network fails, the very same bytes are sent again. Send an image once, and do not seal it in
/// another way afterwards (see docs/privacy.md, rule L7).
#[derive(clap::Args)]
pub(crate) struct Args {
    /// An image, JPEG or PNG.
    image: PathBuf,
    /// Its camera: COLMAP's model name, width, height and parameters, for example
    /// SIMPLE_RADIAL,1296,1936,2435.4,648,968,-0.034.
    #[arg(long, value_name = "MODEL,W,H,PARAMS…")]
    camera: Intrinsics,
    /// Which of the service's maps to ask.
    #[arg(long, value_name = "NAME")]
    map: String,
    #[command(flatten)]
    connection: Connection,
    #[command(flatten)]
    device: DeviceArgs,
    /// Folder to keep profiles in. Default: the user's cache folder.
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    /// Print the answer as one JSON document to stdout.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args, ui: &Ui) -> Outcome {
    check_map_name(&args.map)?;
    let client = Client::new(&args.connection, ui)?;
    let cache = ProfileCache::new(args.cache.as_deref());
    let profile = cache.profile(&client, &args.connection.server, &args.map, ui)?;
    let options = args.device.options(&profile, ui)?;
    let (features, camera) = extract(&args.image, &args.camera, &profile, &options)?;
    let found = features.keypoints.len();
    let query = seal(features, &camera, &profile, &options, &mut device_rng()?)
        .map_err(|e| Failure::refused(format!("{}: {e}", args.image.display())))?;
    query.check_sides().map_err(|e| Failure::refused(format!("{}: {e}", args.image.display())))?;
    let bytes = query.encode();
    ui.say(format!(
        "{}: {found} keypoints, {} sent as {}, {} bytes",
        args.image.display(),
        query.len(),
        args.device.scheme(),
        bytes.len()
    ));
    let answer = client.localize(&args.map, &bytes)?;
    if args.json {
        ui.json(&AnswerDocument::new(&args.map, &answer))?;
    } else {
        ui.print(line(&answer));
    }
    Ok(Exit::Success)
}

/// The name becomes part of an address.
fn check_map_name(name: &str) -> Result<(), Failure> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    if !name.is_empty() && name.chars().all(allowed) {
        return Ok(());
    }
    Err(Failure::with_help(
        format!("{name:?} names no map"),
        "names of maps are letters, digits, `-`, `_` and `.`",
    ))
}

fn line(answer: &Answer) -> String {
    let [x, y, z] = answer.center;
    let sigma = (0..3).map(|i| answer.center_covariance[i][i]).sum::<f64>().sqrt();
    let times = &answer.times;
    let total = times.queue_ms + times.retrieve_ms + times.match_ms + times.pose_ms;
    let doubts: Vec<&str> = answer.doubts.iter().map(|doubt| doubt.text.as_str()).collect();
    let doubts = if answer.trusted { String::new() } else { format!("  DOUBTFUL: {}", doubts.join("; ")) };
    format!(
        "at ({x:.3}, {y:.3}, {z:.3}) ± {sigma:.4}  {} of {} matches agree  {total:.0} ms{doubts}\n",
        answer.inliers, answer.matches
    )
}
