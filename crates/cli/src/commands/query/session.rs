//! `veiloc query send --rig`: sends the sealed queries of a session unchanged.

use std::path::Path;
use std::sync::Arc;

use veiloc_client::{Answer, Client, ClientError, LocalizeRequest, RigMessage};

use super::connection::failure;
use crate::commands::rig_file;
use crate::output::exit::Failure;
use crate::output::ui::Ui;

/// The remedy for frames of several sessions.
const ONE_SESSION: &str = "take other images, and seal them with `veiloc seal --session FILE --orientation …`, or those of \
                           one moment with `veiloc seal --rig-cameras`; if they are of one session that had to place its \
                           anchors anew, add its \"session\", as `veiloc seal --json` prints it, to each frame of the rig file";

/// Reads a rig file and its queries, and requests the pose of the device. The client is created last.
pub(super) fn send(
    rig: &Path,
    map: &str,
    client: impl FnOnce() -> Result<Client, Failure>,
    request: &LocalizeRequest,
    ui: &Arc<Ui>,
) -> Result<Answer, Failure> {
    let frames = rig_file::read(rig)?.into_iter().map(|named| named.sealed).collect();
    let message = RigMessage { frames };
    let client = client()?;
    ui.info(format!(
        "{}: {} sealed queries, {} bytes",
        rig.display(),
        message.frames.len(),
        message.encode().len()
    ));
    client.localize_rig(map, &message, request).map_err(|error| match error {
        // Nothing was sent: the error names the session, not the service.
        ClientError::UnbalancedAnchors(unbalanced) => {
            Failure::refused(format!("{}: {unbalanced}", rig.display()))
        }
        ClientError::SeparateAnchors(separate) => {
            Failure::with_help(format!("{}: {separate}", rig.display()), ONE_SESSION)
        }
        error => failure(error),
    })
}
