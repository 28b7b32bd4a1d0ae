//! `veiloc query send`: takes an image or session and prints its pose; only sealed bytes are sent.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Serialize;
use veiloc_client::{Answer, AnswerDocument, AnswerState, ClientError, LocalizeRequest, PositionHint, Step};
use veiloc_features::FeatureError;
use veiloc_protocol::ProfileId;

use super::connection::{Connection, failure};
use super::session;
use crate::args::camera::{CameraArg, warn_of_turned};
use crate::args::progressive_args::ProgressiveArgs;
use crate::commands::device_args::DeviceArgs;
use crate::commands::localize::document::answer_text;
use crate::commands::mask_args::MaskArgs;
use crate::commands::seal::{Attitude, GIVE_CAMERA, extract, seal};
use crate::commands::session_args::{self, SessionArgs};
use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::ui::Ui;

/// Seal one image, send it, and print the pose.
///
/// The query contains descriptors and lines, never pixels or keypoints. The image is sealed once; if the service is
/// busy or the network fails, the same bytes are sent again. Send an image once, and do not seal it again in another
/// way (see docs/reference/privacy-rules.md, rule L7).
///
/// With `--progressive` only as many rows are sent as a trusted pose needs.
///
/// With `--rig` the previously sealed queries of a session are sent unchanged, and the pose is that of the device. Queries that
/// were not sealed in one session are refused: their lines would give keypoints away.
///
/// The exit code is 0 for a trusted pose, 4 for a doubtful one, and 1 for none.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// An image: JPEG, PNG, WebP or HEIC.
    #[arg(required_unless_present = "rig")]
    image: Option<PathBuf>,
    /// A session instead: a JSON file that names up to 32 sealed queries with the pose of each camera on the device and
    /// its standard deviations (docs/reference/formats.md). Gives one pose of the device.
    #[arg(long, value_name = "FILE",
        conflicts_with_all = ["image", "camera", "scheme", "max_keypoints", "max_image_side", "profile_id", "focal_known", "gravity", "image_global", "pack", "pack_id", "send", "session", "progressive", "mask", "hide"])]
    rig: Option<PathBuf>,
    /// The camera: COLMAP's model name, width, height and parameters, for example
    /// SIMPLE_RADIAL,1296,1936,2435.4,648,968,-0.034; a COLMAP cameras.txt with one camera; a map (.vmap) whose images
    /// share one camera, for an image of that camera; or `unknown`, which assumes a focal length and marks it as unknown. Default: the focal length in the image's EXIF data.
    #[arg(long, value_name = "MODEL,W,H,PARAMS…|FILE|unknown")]
    camera: Option<CameraArg>,
    /// Name of the service's map.
    #[arg(long, value_name = "NAME")]
    map: String,
    /// Id of the map's profile as the operator publishes it, 32 hexadecimal digits: nothing is sealed or sent when the
    /// service has another profile, by which it could recognize this device. Default: any profile; one that changed
    /// since the last query is reported.
    #[arg(long, value_name = "HEX")]
    profile_id: Option<ProfileId>,
    #[command(flatten)]
    connection: Connection,
    #[command(flatten)]
    device: DeviceArgs,
    #[command(flatten)]
    session: SessionArgs,
    #[command(flatten)]
    mask: MaskArgs,
    #[command(flatten)]
    progressive: ProgressiveArgs,
    /// Send the approximate camera position in map units, for example from GPS: a mean and a standard deviation along
    /// each axis. Default: not sent.
    #[arg(long, value_name = "X,Y,Z,SD", allow_hyphen_values = true)]
    near: Option<PositionHint>,
    /// Request a trusted pose only: the service withholds a doubtful pose, and still reports the reasons for doubt.
    #[arg(long)]
    trusted_only: bool,
    /// Print the answer as one JSON document to stdout.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args, ui: &Arc<Ui>) -> Outcome {
    let mut request = LocalizeRequest::default();
    request.trusted_only = args.trusted_only;
    request.near = args.near;
    let QueryResponse { answer, steps } = match (&args.rig, &args.image) {
        (Some(rig), _) => {
            let answer = session::send(rig, &args.map, || args.connection.client(None, ui), &request, ui)?;
            QueryResponse { answer, steps: None }
        }
        (None, Some(image)) => send(image, args, &request, ui)?,
        (None, None) => return Err(Failure::refused("neither an image nor a session is given")),
    };
    if args.json {
        ui.json(&Document { answer: AnswerDocument::new(&answer), steps })?;
    } else {
        ui.print(format!("{}  {}\n", answer.state(), answer_text(&answer)));
    }
    Ok(match (answer.state(), &answer.pose) {
        (AnswerState::Trusted, _) => Exit::Success,
        (AnswerState::Doubtful, Some(_)) => Exit::Doubtful,
        (AnswerState::Doubtful, None) => Exit::Refused,
    })
}

/// A response, with the steps of a progressive query.
struct QueryResponse {
    answer: Answer,
    steps: Option<Vec<StepDocument>>,
}

/// The answer of the service, as over HTTP ([http.md](http.md)). Without a pose the command ends with 1 and prints no
/// document.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct Document {
    #[serde(flatten)]
    answer: AnswerDocument,
    /// The messages that were sent; absent without `--progressive`.
    #[serde(skip_serializing_if = "Option::is_none")]
    steps: Option<Vec<StepDocument>>,
}

/// A step of a progressive query.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct StepDocument {
    /// Number of rows sent, including those of the steps before.
    rows: usize,
    /// Bytes of the message.
    bytes: usize,
    /// State of its answer: `trusted`, `doubtful` or `not-found`.
    state: &'static str,
}

/// Seals an image and requests its pose.
fn send(
    image: &Path,
    args: &Args,
    request: &LocalizeRequest,
    ui: &Arc<Ui>,
) -> Result<QueryResponse, Failure> {
    let source = args.device.camera(args.camera.as_ref())?;
    warn_of_turned([(image, source)], ui);
    let camera = source.of(image).map_err(|error| match error {
        FeatureError::NoFocal { path, reason } => {
            Failure::with_help(format!("{}: {reason}", path.display()), GIVE_CAMERA)
        }
        error => error.into(),
    })?;
    // An unusable mask or detector ends the command before any request.
    let hidden = args.mask.open()?.of(image, args.mask.file());
    let hidden = hidden.map_err(|fault| Failure::refused(fault.of(&image.display().to_string())))?;
    let client = args.connection.client(args.profile_id.map(|id| (args.map.as_str(), id)), ui)?;
    let profile = client.profile(&args.map).map_err(failure)?;
    ui.info(format!("map {}: profile {}", args.map, profile.id()));
    let pack_of_map = || {
        let pack = client.pack(&args.map).map_err(failure)?;
        ui.info(format!("map {}: pack {}", args.map, pack.id()));
        Ok(pack)
    };
    let sealer = args.device.sealer(&profile, pack_of_map, ui)?;
    let gravity = args.device.gravity();
    let attitude = Attitude { orientation: args.session.camera_orientation(gravity), gravity };
    let mut session = args.session.open()?;
    let extracted = extract(&sealer, image, camera, hidden.mask.as_ref(), attitude)?;
    let keypoints = extracted.features().keypoints.len();
    let query = seal(&sealer, extracted, session.as_mut()).map_err(|error| match error {
        ClientError::Seal(error) => Failure::refused(format!("{}: {error}", image.display())),
        error => session_args::failure(&error),
    })?;
    let of_image = sealer.image_global();
    let beside =
        of_image.map_or_else(String::new, |own| format!(" with {} of the image", own.model().name()));
    ui.info(format!(
        "{}: {}{} keypoints, {} {} as {}{}, {} bytes",
        image.display(),
        hidden.description(),
        keypoints,
        query.len(),
        if args.progressive.stop_criterion().is_some() { "sealed" } else { "sent" },
        args.device.scheme(),
        beside,
        query.encode().len()
    ));
    let refused = |error| match error {
        // Nothing was sent: the error names the image, not the service.
        ClientError::UnbalancedAnchors(unbalanced) => {
            Failure::refused(format!("{}: {unbalanced}", image.display()))
        }
        error => failure(error),
    };
    let Some(enough) = args.progressive.stop_criterion() else {
        let answer = client.localize_with(&args.map, &query, request).map_err(refused)?;
        return Ok(QueryResponse { answer, steps: None });
    };
    let found = client.localize_progressive(&args.map, &query, &profile, enough, request);
    let found = found.map_err(refused)?;
    ui.info(format!(
        "{} of {} rows in {} step{}, {} bytes",
        found.rows(),
        query.len(),
        found.steps.len(),
        if found.steps.len() == 1 { "" } else { "s" },
        found.bytes()
    ));
    let document =
        |step: &Step| StepDocument { rows: step.rows, bytes: step.bytes, state: step.outcome.name() };
    Ok(QueryResponse { answer: found.answer, steps: Some(found.steps.iter().map(document).collect()) })
}
