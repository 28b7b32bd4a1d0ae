//! `veiloc query send`: image in, pose out, and only sealed bytes on the way.

use std::path::PathBuf;
use std::sync::Arc;

use veiloc_client::{Answer, AnswerDocument, ClientError, Intrinsics, seal_image};

use super::connection::{Connection, failure};
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
    /// Print the answer as one JSON document to stdout.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args, ui: &Arc<Ui>) -> Outcome {
    let client = args.connection.client(ui)?;
    let profile = client.profile(&args.map).map_err(failure)?;
    let options = args.device.options(&profile, ui)?;
    let sealed = seal_image(&args.image, &args.camera, &profile, &options)?;
    ui.say(format!(
        "{}: {} keypoints, {} sent as {}, {} bytes",
        args.image.display(),
        sealed.keypoints,
        sealed.query.len(),
        args.device.scheme(),
        sealed.query.encode().len()
    ));
    let answer = client.localize(&args.map, &sealed.query).map_err(|error| match error {
        // Not sent: which image it is matters more than which service.
        ClientError::Lopsided(lopsided) => Failure::refused(format!("{}: {lopsided}", args.image.display())),
        error => failure(error),
    })?;
    if args.json {
        ui.json(&AnswerDocument::new(&args.map, &answer))?;
    } else {
        ui.print(line(&answer));
    }
    Ok(Exit::Success)
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
